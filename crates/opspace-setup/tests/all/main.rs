//! Tests of the files of new robots, and of the findings about machines.

mod arm_templates;
mod machine;
mod random_servo_arm;
mod static_identification;

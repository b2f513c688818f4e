//! Tests of the files of new robots.

mod arm_templates;
mod random_servo_arm;
mod static_identification;

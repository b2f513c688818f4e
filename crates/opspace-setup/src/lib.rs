//! Files of a new robot: its robot.toml, with the values of a template or assumed ones if requested, a first task, and the
//! identification of its servos; and what the machine lacks that is to control it.

pub mod arm_shape;
pub mod arm_template;
pub mod assumed_bodies;
pub mod assumed_drives;
pub mod first_motion;
pub mod first_task;
pub mod identify;
#[cfg(unix)]
pub mod machine;
pub mod new_robot;
pub mod robot_template;

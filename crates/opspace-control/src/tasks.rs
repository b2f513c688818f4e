//! Tasks: the two traits, Cartesian tasks and joint tasks.

pub mod axes;
pub(crate) mod axis_feedback;
pub mod cartesian;
pub mod cartesian_parameters;
pub mod cartesian_target;
pub mod controlled_frame;
pub mod coordinate;
pub mod coordinate_task;
pub mod damping;
pub mod damping_zone;
pub mod force;
pub mod gains;
pub mod impedance;
pub mod joint_parameters;
pub mod joint_target;
pub mod joint_task;
pub mod posture;
pub mod selected_joints;
pub mod singular_escape;
pub mod swivel;
pub mod task;
pub mod task_axes;
pub mod tracking;
pub mod when_limited;

//! Experiments: a task executed by a simulated or real robot, or replayed from a log.

mod capabilities;
pub mod collision;
pub(crate) mod compliance;
pub mod couplings;
pub mod error;
pub mod execute;
pub mod experiment;
pub mod log_header;
mod logged_capsules;
pub mod member;
pub mod membership;
mod on_driver;
mod path_bounds;
mod path_dynamics;
pub mod physics;
pub(crate) mod real_robot;
pub mod replay;
pub mod result_files;
pub mod robot_logs;
pub(crate) mod rollout;
pub mod scenario;
mod segments;
mod start;
pub(crate) mod start_positions;
mod transformer;
mod viewer_scene;

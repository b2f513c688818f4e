//! Experiments: a task executed by a simulated or real robot, or replayed from a log.

mod capabilities;
pub mod collision;
mod comparisons;
pub(crate) mod compliance;
pub mod coupled_experiment;
pub mod coupled_logs;
pub(crate) mod coupling_expectations;
pub mod error;
pub mod execute;
pub(crate) mod expectations;
pub mod experiment;
pub mod log_header;
mod logged_capsules;
pub mod membership;
mod on_driver;
mod path_bounds;
mod path_dynamics;
pub mod physics;
pub(crate) mod real_robot;
pub mod replay;
pub mod result_files;
pub(crate) mod rollout;
mod start;
pub(crate) mod start_positions;
mod transformer;
mod viewer_scene;

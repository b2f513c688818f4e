//! Experiments: a task executed by a simulated or real robot, or replayed from a log.

mod capabilities;
pub mod collision;
mod coupled_drivers;
pub mod coupled_experiment;
pub mod coupled_logs;
pub mod coupled_run;
pub mod coupled_summary;
pub mod error;
pub mod execute;
pub mod experiment;
pub mod folder;
pub mod log_header;
pub mod membership;
mod on_driver;
mod path_bounds;
mod path_dynamics;
pub mod physics;
mod real_robot;
pub mod replay;
pub mod result_files;
pub(crate) mod rollout;
pub mod shard;
mod start;
pub mod suite_rows;
pub mod summary;
mod transformer;
mod viewer_scene;

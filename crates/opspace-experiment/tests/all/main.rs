//! Tests of files, preflight, experiments, metrics and reports.

mod collision_views;
mod collisions;
mod diagnostics;
mod drives;
mod log_header;
mod margins;
mod metrics;
mod overrides;
mod panicking_task;
mod physics;
mod random_servos;
mod real_robot;
mod recorded;
mod report;
mod robot_file;
mod run_figures;
mod segments;
mod servo_gain;
mod singular_postures;
mod source;
mod streamed;
mod task_kinds;
mod task_metrics;
mod unreached_goals;
mod velocity_robot;
mod velocity_source;

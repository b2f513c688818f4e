//! Robot, task and experiment files: reading, and descriptions of the mistakes in them.

pub(crate) mod body;
pub mod collision;
pub mod controller_kind;
pub mod expectation;
pub mod experiment_file;
pub mod explain;
pub mod interface;
pub mod joint_layers;
pub(crate) mod layered_path;
pub mod link;
pub(crate) mod missing;
pub mod mount;
pub(crate) mod numbers;
pub mod origin;
pub mod overrides;
pub(crate) mod renamed;
pub mod required_keys;
pub mod robot;
pub mod robot_part;
pub(crate) mod sensor_loads;
pub mod source;
pub(crate) mod strict;
pub mod task;
pub mod task_kinds;
pub mod toml_path;
pub mod tool;

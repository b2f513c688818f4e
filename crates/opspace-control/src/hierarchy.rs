//! Strict task priorities: the priority levels and the null space that each level leaves.

pub mod contact_condition;
pub(crate) mod displaced_task;
pub(crate) mod escape;
pub(crate) mod held_back;
pub(crate) mod joint_standstill;
pub(crate) mod mobility_spectrum;
pub(crate) mod preview;
pub(crate) mod priority_level;
pub mod rank;
pub(crate) mod saddle;
pub(crate) mod standstill;
pub(crate) mod task_hierarchy;
pub mod task_parameters;
pub(crate) mod task_schedule;
pub mod task_set;

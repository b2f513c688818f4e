//! Kinematics and dynamics: identities on random trees, foreign programs, URDF texts.

mod allocation;
mod batch;
mod common;
#[path = "../../../opspace-log/tests/all/counting/mod.rs"]
mod counting;
mod floating;
mod identities;
mod mujoco;
mod oracle;
mod pinocchio;
mod samples;
mod states;
mod suspicion;
mod trees;
mod urdf;

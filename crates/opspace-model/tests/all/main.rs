//! Tests of kinematics and dynamics: identities on random trees, reference numbers of other programs, URDF texts.

mod allocation;
mod batch;
mod collision;
mod common;
mod floating;
mod identities;
mod mujoco;
mod oracle;
mod pinocchio;
mod states;

mod trees;
mod urdf;
mod urdf_rs;
mod warnings;

#[global_allocator]
static ALLOCATOR: opspace_testing::allocation::CountingAllocator =
    opspace_testing::allocation::CountingAllocator;

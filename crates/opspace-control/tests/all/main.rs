//! Tasks, hierarchy, limits, references and controllers on small arms.

mod admittance;
mod allocation;
mod collisions;
mod common;
mod damped_limits;
mod files;
mod force_control;
mod hierarchy;
mod impedance;
mod inverse_kinematics;
mod law;
mod limited_motion;
mod limits;
mod limits_allocation;
mod out_of_reach;
mod path_reference;
mod published_goals;
mod pushed_joints;
mod qp;
mod qp_allocation;
mod reference_allocation;
mod references;
mod singular_escape;
mod singularity;
mod standstill;
mod streamed_targets;
mod subjects;
mod switching;
mod swivel;
mod tasks_in_code;
mod varying_stiffness;
mod when_limited;
mod zones;

#[global_allocator]
static ALLOCATOR: opspace_testing::allocation::CountingAllocator =
    opspace_testing::allocation::CountingAllocator;

//! Tests of simulated arms: drives, bus, environment, energy.

mod arm;
mod bodies;
mod bus;
mod common;
mod contacts;

mod drives;
mod energy;
mod environment;
mod external;
mod gear;
mod held_object;
mod ideal;
mod motors_and_loads;
mod probe;
mod setpoint_limits;
mod simulation;
mod stability;
mod velocity;
mod work;

#[global_allocator]
static ALLOCATOR: opspace_testing::allocation::CountingAllocator =
    opspace_testing::allocation::CountingAllocator;

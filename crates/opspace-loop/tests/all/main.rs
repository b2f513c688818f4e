//! Tests of the control loop, its supervision and its execution, with scripted robots.

mod allocation;
mod borrowed;
mod clock;
mod collision_detector;
mod common;
mod continuous;
mod device_fault;
mod dropout;
mod friction_observer;
mod ground_truth;
mod high_pass;
mod limited_stops;
mod measurement;
mod oscillation;
mod panic;
mod parts;
mod real_time;
mod setpoints;
mod shells;
mod stop;
mod supervision;
mod together;
mod torques;
mod units;
mod unsolved_limits;
mod velocity;
mod watchdog;

#[global_allocator]
static ALLOCATOR: opspace_testing::allocation::CountingAllocator =
    opspace_testing::allocation::CountingAllocator;

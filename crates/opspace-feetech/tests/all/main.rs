//! Tests of the servo bus, its driver and its simulation.

mod arm;
mod bus;
mod calibration;
mod common;
mod faults;
#[cfg(target_os = "linux")]
mod port;
mod protocol;
mod registers;
mod servo;
mod start;

#[global_allocator]
static ALLOCATOR: opspace_testing::allocation::CountingAllocator =
    opspace_testing::allocation::CountingAllocator;

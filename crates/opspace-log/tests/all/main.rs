//! Tests of recording and reading logs, and of damaged logs.

mod common;
mod damage;
mod recorder;
mod round_trip;
mod tools;

#[global_allocator]
static ALLOCATOR: opspace_testing::allocation::CountingAllocator =
    opspace_testing::allocation::CountingAllocator;

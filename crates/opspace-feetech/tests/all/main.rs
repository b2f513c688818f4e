//! Tests of the servo bus, its driver and its simulation.

mod protocol;
mod registers;

#[global_allocator]
static ALLOCATOR: opspace_testing::allocation::CountingAllocator =
    opspace_testing::allocation::CountingAllocator;

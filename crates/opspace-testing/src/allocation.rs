//! An allocator that counts, thread by thread: the test harness has threads of its own.
#![expect(unsafe_code, reason = "an allocator can't be written without")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::hint::black_box;

/// Requests to the allocator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Count {
    /// Number of allocations, reallocations included.
    pub allocations: usize,
    /// Number of frees.
    pub frees: usize,
    /// Size of the largest piece, bytes.
    pub largest: usize,
}

thread_local! {
    static COUNT: Cell<Count> = const { Cell::new(Count { allocations: 0, frees: 0, largest: 0 }) };
}

/// The system's allocator, with a count of requests for each thread; a test binary makes it its `#[global_allocator]`.
pub struct CountingAllocator;

fn note(change: impl FnOnce(&mut Count)) {
    // Fails only while a thread ends.
    let _ = COUNT.try_with(|cell| {
        let mut count = cell.get();
        change(&mut count);
        cell.set(count);
    });
}

fn note_allocation(size: usize) {
    note(|count| {
        count.allocations += 1;
        count.largest = count.largest.max(size);
    });
}

// SAFETY: everything is passed on to the system's allocator.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        note_allocation(layout.size());
        // SAFETY: the caller's promise is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        note_allocation(layout.size());
        // SAFETY: the caller's promise is passed on.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        note_allocation(size);
        // SAFETY: the caller's promise is passed on.
        unsafe { System.realloc(block, layout, size) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        note(|count| count.frees += 1);
        // SAFETY: the caller's promise is passed on.
        unsafe { System.dealloc(block, layout) }
    }
}

/// Number of allocations of this thread so far.
#[must_use]
pub fn allocations_so_far() -> usize {
    COUNT.get().allocations
}

/// Returns the result of `work`, and its requests to the allocator on this thread.
///
/// # Panics
/// If [`CountingAllocator`] is not the global allocator of this binary.
pub fn counted<T>(work: impl FnOnce() -> T) -> (T, Count) {
    let unused = allocations_so_far();
    drop(black_box(Box::new(0_u8)));
    assert!(allocations_so_far() > unused, "this binary does not declare the counting allocator");
    let before = COUNT.get();
    COUNT.set(Count { largest: 0, ..before });
    let result = work();
    let after = COUNT.get();
    let count = Count {
        allocations: after.allocations - before.allocations,
        frees: after.frees - before.frees,
        largest: after.largest,
    };
    (result, count)
}

/// Number of allocations of `work` on this thread.
pub fn allocations(work: impl FnOnce()) -> usize {
    counted(work).1.allocations
}

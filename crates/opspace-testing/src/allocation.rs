//! Allocator that counts requests per thread, because the test harness has threads of its own.
#![expect(unsafe_code, reason = "an allocator can't be written without")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::hint::black_box;

/// Numbers of requests to the allocator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Count {
    /// Number of allocations, including reallocations.
    pub allocations: usize,
    /// Number of deallocations.
    pub frees: usize,
    /// Size of the largest allocation, bytes.
    pub largest: usize,
}

thread_local! {
    static COUNT: Cell<Count> = const { Cell::new(Count { allocations: 0, frees: 0, largest: 0 }) };
    static HELD: Cell<Held> = const { Cell::new(Held { now: 0, most: 0 }) };
}

/// Size of all blocks that a thread has allocated and not freed, bytes; negative if it freed blocks of other threads.
#[derive(Clone, Copy)]
struct Held {
    now: isize,
    most: isize,
}

/// System allocator that counts the requests of each thread; a test binary must declare it as its
/// `#[global_allocator]`.
pub struct CountingAllocator;

fn note(change: impl FnOnce(&mut Count)) {
    // This fails only while a thread ends.
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
    note_held(size, 0);
}

/// Notes that blocks of `more` bytes were allocated and blocks of `less` bytes freed.
fn note_held(more: usize, less: usize) {
    let _ = HELD.try_with(|cell| {
        let Held { now, most } = cell.get();
        let now = now.wrapping_add_unsigned(more).wrapping_sub_unsigned(less);
        cell.set(Held { now, most: most.max(now) });
    });
}

// SAFETY: all requests are forwarded to the system allocator.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        note_allocation(layout.size());
        // SAFETY: the caller guarantees the same conditions.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        note_allocation(layout.size());
        // SAFETY: the caller guarantees the same conditions.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        note_allocation(size);
        note_held(0, layout.size());
        // SAFETY: the caller guarantees the same conditions.
        unsafe { System.realloc(block, layout, size) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        note(|count| count.frees += 1);
        note_held(0, layout.size());
        // SAFETY: the caller guarantees the same conditions.
        unsafe { System.dealloc(block, layout) }
    }
}

/// Number of allocations of this thread so far.
#[must_use]
pub fn allocations_so_far() -> usize {
    COUNT.get().allocations
}

/// Returns the result of `work`, and the requests of this thread to the allocator during `work`.
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

/// Number of allocations that `work` makes on this thread.
pub fn allocations(work: impl FnOnce()) -> usize {
    counted(work).1.allocations
}

/// Returns the result of `work`, and the most memory that this thread held in addition to before `work`, bytes.
///
/// # Panics
/// As [`counted`].
pub fn most_held<T>(work: impl FnOnce() -> T) -> (T, usize) {
    let before = HELD.get();
    HELD.set(Held { most: before.now, ..before });
    let (result, _) = counted(work);
    let most = HELD.get().most.wrapping_sub(before.now);
    (result, most.try_into().unwrap_or(0))
}

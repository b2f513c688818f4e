//! No algorithm allocates once its scratch is there: a counting allocator against each of them.
#![expect(unsafe_code, reason = "a global allocator can't be had without")]
#![expect(clippy::unwrap_used, reason = "a test")]

use nalgebra::Matrix6xX;
use opspace_model::{
    Data, Model, OperationalSpace, aba, center_of_mass, coriolis, frame_bias_acceleration, frame_jacobian,
    frame_placement, frame_velocity, kinetic_energy, potential_energy, rnea, update,
};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::hint::black_box;

thread_local! {
    /// This thread's only: the test harness has threads of its own.
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

struct Counting;

fn count() {
    ALLOCATIONS.with(|n| n.set(n.get() + 1));
}

// SAFETY: every call goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        unsafe { System.alloc(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        unsafe { System.realloc(pointer, layout, size) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count();
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// How often `f` allocates, reallocates or frees.
fn allocations(f: impl FnOnce()) -> usize {
    let before = ALLOCATIONS.with(Cell::get);
    f();
    ALLOCATIONS.with(Cell::get) - before
}

#[test]
fn the_counter_counts() {
    // One to allocate, one to free.
    assert_eq!(allocations(|| drop(black_box(vec![1.0; 7]))), 2);
}

#[test]
fn no_algorithm_allocates() {
    for (robot, tip) in [("panda_arm7", "panda_hand_tcp"), ("g1_29dof", "left_rubber_hand"), ("ur5", "tool0")]
    {
        let path = format!("{}/../../tests/oracles/pinocchio/urdf/{robot}.urdf", env!("CARGO_MANIFEST_DIR"));
        let model = Model::from_urdf(&std::fs::read_to_string(path).unwrap()).unwrap().model;
        let tip = model.frame(tip).unwrap();
        let n = model.n();
        let mut data = Data::new(&model);
        let mut jacobian = Matrix6xX::zeros(n);
        let mut space = OperationalSpace::new(n);
        let q: Vec<f64> = (0..n).map(|i| 0.3 + 0.07 * i as f64).collect();
        let (dq, ddq, tau) = (vec![0.2; n], vec![-1.5; n], vec![2.0; n]);

        let mut shares = [f64::NAN; 3];
        let count = allocations(|| {
            assert!(update(&model, &mut data, &q, &dq));
            coriolis(&model, &mut data);
            rnea(&model, &mut data, &ddq);
            aba(&model, &mut data, &tau);
            black_box(frame_placement(&model, &data, tip));
            black_box(frame_velocity(&model, &data, tip));
            black_box(frame_bias_acceleration(&model, &data, tip));
            black_box(kinetic_energy(&model, &data) + potential_energy(&model, &data));
            black_box(center_of_mass(&model, &data));
            frame_jacobian(&model, &data, tip, &mut jacobian);
            // Undamped, damped in all directions but the most mobile, and with a direction lost altogether.
            space.update(&data.mass_matrix_factor, &jacobian, 6, 0.0);
            shares[0] = space.weakest_share;
            space.update(&data.mass_matrix_factor, &jacobian, 3, 0.999);
            shares[1] = space.weakest_share;
            jacobian.row_mut(1).fill(0.0);
            space.update(&data.mass_matrix_factor, &jacobian, 6, 1e-3);
            shares[2] = space.weakest_share;
        });
        assert_eq!(shares[0], 1.0, "{robot}: the plain branch was taken");
        assert!(0.0 < shares[1] && shares[1] < 1.0, "{robot}: the damped branch was taken");
        assert!(shares[2].abs() < 1e-9, "{robot}: a direction was lost");
        assert_eq!(count, 0, "{robot}");
    }
}

/// A state that isn't finite is refused by the factor, without allocating on the way.
#[test]
fn a_bad_state_does_not_allocate_either() {
    let path = format!("{}/../../tests/oracles/pinocchio/urdf/ur5.urdf", env!("CARGO_MANIFEST_DIR"));
    let model = Model::from_urdf(&std::fs::read_to_string(path).unwrap()).unwrap().model;
    let mut data = Data::new(&model);
    let q = vec![f64::NAN; model.n()];
    let count = allocations(|| assert!(!update(&model, &mut data, &q, &q)));
    assert_eq!(count, 0);
}

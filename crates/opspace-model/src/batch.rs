//! Evaluation of many states at once: one in each lane of a SIMD register.
//!
//! The algorithms are the same, to the line: [`Model::splat`](crate::Model::splat) makes a model whose numbers are
//! [`Lanes`], and everything computed with it is computed for [`COUNT`] states side by side. For sweeps over states:
//! workspaces, calibration, identification. `RUSTFLAGS="-C target-cpu=x86-64-v3"` makes the registers twice as wide.
//!
//! ```
//! # let urdf = include_str!("../urdf/ur5e.urdf");
//! use opspace_model::{batch::{self, Lanes}, Data, Model, forward_kinematics, gravity};
//!
//! let model = Model::from_urdf(urdf)?.model.splat::<Lanes>();
//! let mut data = Data::new(&model);
//! let states = [[0.1; 6], [0.2; 6], [0.3; 6], [0.4; 6]];
//! let mut q = [Lanes::from([0.0; batch::COUNT]); 6];
//! batch::gather(&states.each_ref().map(|q| &q[..]), &mut q);
//! forward_kinematics(&model, &mut data, &q);
//! gravity(&model, &mut data);
//! let mut torque = [0.0; 6];
//! batch::extract(data.gravity.as_slice(), 2, &mut torque); // of the third state
//! # Ok::<(), opspace_model::UrdfError>(())
//! ```

use nalgebra::SimdValue;

/// [`COUNT`] numbers side by side.
pub type Lanes = simba::simd::WideF64x4;

/// Number of states evaluated at once.
pub const COUNT: usize = 4;

/// Puts the entries of [`COUNT`] vectors side by side.
///
/// # Panics
/// If a vector is shorter than `out`.
pub fn gather(vectors: &[&[f64]; COUNT], out: &mut [Lanes]) {
    for (i, lanes) in out.iter_mut().enumerate() {
        *lanes = Lanes::from([vectors[0][i], vectors[1][i], vectors[2][i], vectors[3][i]]);
    }
}

/// Copies one of the vectors that stand side by side to `out`.
///
/// # Panics
/// If `lane` isn't below [`COUNT`], or `out` is longer than `vectors`.
pub fn extract(vectors: &[Lanes], lane: usize, out: &mut [f64]) {
    for (i, x) in out.iter_mut().enumerate() {
        *x = vectors[i].extract(lane);
    }
}

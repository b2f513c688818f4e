//! Evaluation of several states at once, one in each lane of a SIMD register.
//!
//! The algorithms are those for a single state: [`Model::splat`](crate::Model::splat) returns a model whose numbers are
//! [`Lanes`], and each algorithm then computes its results for [`COUNT`] states at once. This suits computations over
//! many states, such as workspace analysis, calibration and identification. `RUSTFLAGS="-C target-cpu=x86-64-v3"`
//! doubles the width of the registers.
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

/// [`COUNT`] numbers in one SIMD value, one per lane.
pub type Lanes = simba::simd::WideF64x4;

/// Number of states evaluated at once.
pub const COUNT: usize = 4;

/// Packs [`COUNT`] vectors into lanes: entry i of vector k is in lane k of `out[i]`.
///
/// # Panics
/// If a vector is shorter than `out`.
pub fn gather(vectors: &[&[f64]; COUNT], out: &mut [Lanes]) {
    for (i, lanes) in out.iter_mut().enumerate() {
        *lanes = Lanes::from([vectors[0][i], vectors[1][i], vectors[2][i], vectors[3][i]]);
    }
}

/// Copies the vector in lane `lane` of `vectors` to `out`.
///
/// # Panics
/// If `lane` is not below [`COUNT`], or if `out` is longer than `vectors`.
pub fn extract(vectors: &[Lanes], lane: usize, out: &mut [f64]) {
    for (i, x) in out.iter_mut().enumerate() {
        *x = vectors[i].extract(lane);
    }
}

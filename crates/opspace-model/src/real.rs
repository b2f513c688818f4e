//! What the algorithms compute with: one number, or one in each lane of a SIMD register.

use nalgebra::SimdRealField;

/// `f64`, or several of them side by side ([`Lanes`](crate::batch::Lanes)). All algorithms without a branch on values are
/// written for both; the number of one state is the default everywhere.
pub trait Real: SimdRealField<Element = f64> + Copy {}

impl<T: SimdRealField<Element = f64> + Copy> Real for T {}

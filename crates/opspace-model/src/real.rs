//! Scalar type of the algorithms: one number, or several numbers in the lanes of a SIMD register.
//!
//! ```
//! use opspace_model::{Data, Model, Real, crba, forward_kinematics};
//!
//! /// Written once, for one state or for several side by side.
//! fn inertia_of_first_joint<T: Real>(model: &Model<T>, q: &[T]) -> T {
//!     let mut data = Data::new(model);
//!     forward_kinematics(model, &mut data, q);
//!     crba(model, &mut data);
//!     data.mass_matrix[(0, 0)]
//! }
//! ```

use nalgebra::SimdRealField;
use std::f64::consts::FRAC_2_PI;

/// Scalar type of the algorithms: `f64` (the default), or several `f64` in lanes (`batch::Lanes`, with feature `simd`).
/// All algorithms that do not branch on values are generic over it.
pub trait Real: SimdRealField<Element = f64> + Copy {}

impl<T: SimdRealField<Element = f64> + Copy> Real for T {}

/// π/2 as the sum of two parts. The first part has enough trailing zero bits that its multiples up to 2^20 are exact.
const HALF_PI: [f64; 2] = [1.5707963267341256, 6.077100506506192e-11];

/// Returns the sine and cosine of an angle (rad), with an absolute error of at most 2 ε (ε = 2^-52) for angles up to
/// 1e6.
///
/// It has no branch and no function call, so that a loop over joints is vectorized; the standard library's function
/// would take as long as the rest of forward kinematics. The result is the same on every machine.
#[inline]
pub(crate) fn sin_cos<T: Real>(angle: T) -> (T, T) {
    let constant = T::splat;
    // Rounds to the nearest multiple of `unit` (1, 2 or 4), ties to even: in the sum with `shift`, the last binary
    // digit has the value `unit`.
    let round_to = |unit: f64, x: T| {
        let shift = constant(unit * 1.5 * (1_u64 << 52) as f64);
        (x + shift) - shift
    };
    // angle = n π/2 + x with |x| ≤ π/4.
    let n = round_to(1.0, angle * constant(FRAC_2_PI));
    let x = (angle - n * constant(HALF_PI[0])) - n * constant(HALF_PI[1]);
    let square = x * x;
    // Taylor series; the omitted terms are below rounding.
    let series = |last: f64, terms: &[f64]| {
        terms.iter().fold(constant(last), |sum, &term| sum * square + constant(term))
    };
    let sin_x = x + x * square * series(SINE[0], &SINE[1..]);
    let cos_x = T::one() + square * series(COSINE[0], &COSINE[1..]);
    // Sine s and cosine c of n π/2. If n is odd, `even` is the adjacent multiple of 4, s = ±1 and c = 0. If n is even,
    // s = 0 and c = ±1.
    let even = round_to(2.0, n);
    let s = n - even;
    let from_four = even - round_to(4.0, even);
    let c = (T::one() - s * s) - from_four * from_four * constant(0.5);
    (s * cos_x + c * sin_x, c * cos_x - s * sin_x)
}

/// Coefficients of x³, x⁵, ... x¹⁵ in sin x, the highest order first: (−1)^k / (2k + 1)!.
const SINE: [f64; 7] = [
    -1.0 / 1_307_674_368_000.0,
    1.0 / 6_227_020_800.0,
    -1.0 / 39_916_800.0,
    1.0 / 362_880.0,
    -1.0 / 5_040.0,
    1.0 / 120.0,
    -1.0 / 6.0,
];

/// Coefficients of x², x⁴, ... x¹⁶ in cos x, the highest order first: (−1)^k / (2k)!.
const COSINE: [f64; 8] = [
    1.0 / 20_922_789_888_000.0,
    -1.0 / 87_178_291_200.0,
    1.0 / 479_001_600.0,
    -1.0 / 3_628_800.0,
    1.0 / 40_320.0,
    -1.0 / 720.0,
    1.0 / 24.0,
    -1.0 / 2.0,
];

#[cfg(test)]
mod tests {
    use super::sin_cos;

    /// Compared: sine and cosine, and those of the standard library, for angles within a few turns and up to 1e6 rad.
    #[test]
    fn sine_and_cosine_are_accurate_to_last_places() {
        let angles = (-200_000..200_000).map(|i| f64::from(i) * 1.234_567e-4);
        let far = (-2_000..2_000).map(|i| f64::from(i) * 499.9);
        for angle in angles.chain(far) {
            let (s, c) = sin_cos(angle);
            let (s_known, c_known) = angle.sin_cos();
            let error = (s - s_known).abs().max((c - c_known).abs());
            assert!(error <= 2.0 * f64::EPSILON, "{angle}: off by {error:e}");
        }
        assert_eq!(sin_cos(0.0), (0.0, 1.0));
        assert!(sin_cos(f64::NAN).0.is_nan() && sin_cos(f64::INFINITY).1.is_nan());
    }
}

//! Accelerations by the damping that a transformer leaves to the joints, or takes away from them.
//!
//! The damping is not known exactly: the drive of joint j adds a torque within the interval tⱼ, which accelerates joint i by
//! (M⁻¹)ᵢⱼ tⱼ. The limits hold with any torque of the intervals. For a bound that is approached with q̈ᵢ > 0, what counts is
//!
//! ```text
//! Σⱼ max(0, (M⁻¹)ᵢⱼ tⱼ)
//! ```
//!
//! without the torque by which joint i itself opposes its motion, which brings it to a limit no sooner.

use nalgebra::DMatrix;
use opspace_model::Data;

/// Accelerations by damping.
pub(crate) struct Drag {
    /// M⁻¹.
    inverse: DMatrix<f64>,
    /// Least and largest acceleration of each joint, not above and not below zero, rad/s² or m/s² (n).
    accelerations: Vec<[f64; 2]>,
}

impl Drag {
    /// Creates accelerations of zero for n joints.
    pub(crate) fn new(n: usize) -> Self {
        Self { inverse: DMatrix::zeros(n, n), accelerations: vec![[0.0; 2]; n] }
    }

    /// Computes the accelerations in the state of `data`, by torques within these intervals (n; Nm or N).
    pub(crate) fn update(&mut self, data: &Data, intervals: &[[f64; 2]]) {
        if intervals.is_empty() {
            return;
        }
        self.inverse.fill_with_identity();
        data.mass_matrix_factor.solve_matrix(&mut self.inverse);
        self.accelerations.fill([0.0; 2]);
        for (j, (column, torques)) in self.inverse.column_iter().zip(intervals).enumerate() {
            let of_others = self.accelerations.iter_mut().zip(column.iter()).enumerate();
            of_others.filter(|(i, _)| *i != j).for_each(|(_, (sum, mobility))| add(sum, *mobility, *torques));
            let v = data.dq[j];
            let driving = [if v < 0.0 { torques[0] } else { 0.0 }, if v > 0.0 { torques[1] } else { 0.0 }];
            add(&mut self.accelerations[j], column[j], driving);
        }
    }

    /// Least and largest acceleration of each joint by damping, not above and not below zero, rad/s² or m/s² (n).
    pub(crate) fn accelerations(&self) -> &[[f64; 2]] {
        &self.accelerations
    }
}

/// Adds `factor` times an interval to an interval around zero.
pub(crate) fn add(sum: &mut [f64; 2], factor: f64, interval: [f64; 2]) {
    let [a, b] = interval.map(|end| factor * end);
    sum[0] += a.min(b).min(0.0);
    sum[1] += a.max(b).max(0.0);
}

/// Returns the interval of Σ `factors`ᵢ aᵢ, for aᵢ within `intervals`.
pub(crate) fn combined(factors: &[f64], intervals: &[[f64; 2]]) -> [f64; 2] {
    let mut sum = [0.0; 2];
    factors.iter().zip(intervals).for_each(|(factor, interval)| add(&mut sum, *factor, *interval));
    sum
}

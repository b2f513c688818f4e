//! Accelerations by the damping that a transformer leaves to the joints, or takes away from them.
//!
//! The damping is not known exactly: the drive of joint j adds a torque within the interval tⱼ, which accelerates joint i by
//! (M⁻¹)ᵢⱼ tⱼ. The limits hold with any torque of the intervals. For a bound that is approached with q̈ᵢ > 0, what counts is
//!
//! ```text
//! Σⱼ max(0, (M⁻¹)ᵢⱼ tⱼ)
//! ```
//!
//! without the torque by which joint i itself opposes its motion, which brings it to a limit no sooner. For the distance of a pair,
//! or the speed of a task, with the gradient g it is
//!
//! ```text
//! Σⱼ max(0, (gᵀ M⁻¹)ⱼ tⱼ)
//! ```

use nalgebra::DMatrix;
use opspace_model::Data;

/// Accelerations by damping.
pub(crate) struct Drag {
    /// M⁻¹.
    inverse: DMatrix<f64>,
    /// Least and largest acceleration of each joint, not above and not below zero, rad/s² or m/s² (n).
    accelerations: Vec<[f64; 2]>,
    /// Intervals of the torques, Nm or N (n); zero if there are none.
    torques: Vec<[f64; 2]>,
    is_damped: bool,
}

impl Drag {
    /// Creates accelerations of zero for n joints.
    pub(crate) fn new(n: usize) -> Self {
        let none = vec![[0.0; 2]; n];
        Self { inverse: DMatrix::zeros(n, n), accelerations: none.clone(), torques: none, is_damped: false }
    }

    /// Computes the accelerations in the state of `data`, by torques within these intervals (n; Nm or N).
    pub(crate) fn update(&mut self, data: &Data, intervals: &[[f64; 2]]) {
        self.is_damped = !intervals.is_empty();
        if !self.is_damped {
            return;
        }
        self.torques.copy_from_slice(intervals);
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

    /// Least and largest acceleration of gᵀ q̇ by damping, not above and not below zero, for the gradient g (n).
    pub(crate) fn along(&self, gradient: &[f64]) -> [f64; 2] {
        let mut sum = [0.0; 2];
        if self.is_damped {
            for (column, torques) in self.inverse.column_iter().zip(&self.torques) {
                let mobility: f64 = column.iter().zip(gradient).map(|(m, g)| m * g).sum();
                add(&mut sum, mobility, *torques);
            }
        }
        sum
    }
}

/// Adds `factor` times an interval to an interval around zero.
fn add(sum: &mut [f64; 2], factor: f64, interval: [f64; 2]) {
    let [a, b] = interval.map(|end| factor * end);
    sum[0] += a.min(b).min(0.0);
    sum[1] += a.max(b).max(0.0);
}

#[cfg(test)]
mod tests {
    use super::*;
    use opspace_model::{Model, update};

    /// Relative rounding error.
    const ROUNDING: f64 = 1e-12;

    /// Compared: the accelerations of joints and of a gradient by all corners of the intervals, with the bounds. Those of a gradient
    /// are reached; those of a joint too, but for the torque by which it opposes its motion.
    #[test]
    fn bounds_are_those_of_the_worst_corner() {
        let urdf = include_str!("../../../opspace-model/urdf/ur5e.urdf");
        let model = Model::from_urdf(urdf).expect("a robot").model;
        let (q, dq) = ([0.3, -1.2, 1.4, 0.4, 0.9, -0.2], [0.5, -0.8, 0.2, 1.0, -0.4, 0.7]);
        let mut data = Data::new(&model);
        assert!(update(&model, &mut data, &q, &dq));
        let intervals: Vec<[f64; 2]> = dq.iter().map(|v| [-9.0 * v, 4.0 * v]).collect();
        let intervals: Vec<[f64; 2]> = intervals.into_iter().map(|[a, b]| [a.min(b), a.max(b)]).collect();
        let mut drag = Drag::new(6);
        drag.update(&data, &intervals);
        let gradient = [0.2, -0.5, 0.7, 0.1, -0.3, 0.4];
        let (mut of_joints, mut along) = (vec![[0.0_f64; 2]; 6], [0.0_f64; 2]);
        for corner in 0..1_u32 << 6 {
            let torque = |j: usize| intervals[j][(corner >> j & 1) as usize];
            let mut acceleration: Vec<f64> = (0..6).map(torque).collect();
            data.mass_matrix_factor.solve(&mut acceleration);
            let of_gradient: f64 = acceleration.iter().zip(gradient).map(|(a, g)| a * g).sum();
            along = [along[0].min(of_gradient), along[1].max(of_gradient)];
            for (i, bound) in of_joints.iter_mut().enumerate() {
                let own = if torque(i) * dq[i] < 0.0 { drag.inverse[(i, i)] * torque(i) } else { 0.0 };
                let others = acceleration[i] - own;
                *bound = [bound[0].min(others), bound[1].max(others)];
            }
        }
        let near = |a: [f64; 2], b: [f64; 2]| {
            a.into_iter().zip(b).all(|(a, b)| (a - b).abs() < ROUNDING * (1.0 + b.abs()))
        };
        assert!(near(drag.along(&gradient), along), "{:?} {along:?}", drag.along(&gradient));
        for (bound, expected) in drag.accelerations().iter().zip(of_joints) {
            assert!(near(*bound, expected), "{bound:?} {expected:?}");
        }
    }
}

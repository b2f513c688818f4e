//! Bound on the acceleration and the speed along a path.
//!
//! ```text
//! gaining max(s̈, 0) + braking max(−s̈, 0) + squared_speed ṡ² ≤ 1
//! ```

/// Bound on the acceleration s̈ and the speed ṡ along a path:
///
/// ```text
/// gaining max(s̈, 0) + braking max(−s̈, 0) + squared_speed ṡ² ≤ 1
/// ```
///
/// It is convex in (s̈, ṡ), so that the moving average that limits the jerk keeps it. The torque of a joint along a path is
/// τ = a(s) s̈ + b(s) ṡ² + g(s) (Bobrow, Dubowsky and Gibson 1985, equation 10).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AccelerationBound {
    /// Coefficient of s̈ > 0, at least 0, s²/m.
    pub gaining_s2_per_m: f64,
    /// Coefficient of −s̈ > 0, at least 0, s²/m.
    pub braking_s2_per_m: f64,
    /// Coefficient of ṡ², at least 0, s²/m².
    pub squared_speed_s2_per_m2: f64,
}

impl AccelerationBound {
    /// Returns the left side of the bound: at most 1 if the bound is kept.
    #[must_use]
    pub fn usage(&self, speed_m_per_s: f64, acceleration_m_per_s2: f64) -> f64 {
        self.gaining_s2_per_m * acceleration_m_per_s2.max(0.0)
            + self.braking_s2_per_m * (-acceleration_m_per_s2).max(0.0)
            + self.squared_speed_s2_per_m2 * speed_m_per_s * speed_m_per_s
    }

    /// Returns a bound that keeps both this one and `other`.
    #[must_use]
    pub fn max(&self, other: &Self) -> Self {
        Self {
            gaining_s2_per_m: self.gaining_s2_per_m.max(other.gaining_s2_per_m),
            braking_s2_per_m: self.braking_s2_per_m.max(other.braking_s2_per_m),
            squared_speed_s2_per_m2: self.squared_speed_s2_per_m2.max(other.squared_speed_s2_per_m2),
        }
    }

    /// Adds the bounds of a list to those of another one, each to the one at the same place.
    pub fn merge(bounds: &mut Vec<Self>, others: &[Self]) {
        let known = bounds.len().min(others.len());
        bounds.iter_mut().zip(others).for_each(|(bound, other)| *bound = bound.max(other));
        bounds.extend_from_slice(&others[known..]);
    }
}

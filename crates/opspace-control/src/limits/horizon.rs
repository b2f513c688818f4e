//! Horizon at which velocities and positions must be within their limits.
//!
//! ```text
//! h = max(0.02 s, 5 T)        T: control period
//! ```

/// Default of the horizon of the acceleration bounds at short control periods, s: velocity noise must not make the bounds
/// jump, and an arm needs much longer to brake.
pub const HORIZON_S: f64 = 0.02;

/// Shortest horizon of the acceleration bounds in control periods: with a horizon of one period, a torque that acts a
/// period late would exceed them by its whole effect.
pub(crate) const HORIZON_PERIODS: f64 = 5.0;

/// Returns the default horizon of the acceleration bounds for a control period, s.
#[must_use]
pub fn horizon_s(period_s: f64) -> f64 {
    HORIZON_S.max(HORIZON_PERIODS * period_s)
}

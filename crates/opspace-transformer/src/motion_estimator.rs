//! Estimate of a joint's position and velocity from positions, as a transformer without a model of the arm uses it.
//!
//! By default the position is the measured one and the velocity a low-passed difference, as in
//! [`estimator`](crate::estimator). Where drives limit the acceleration of setpoints, noise of the velocity must not reach
//! the setpoint: a setpoint that follows the velocity has the acceleration noise β σ/T², with the noise σ of the position.
//! Then both are estimated by a steady-state Kalman filter for a joint with random acceleration (Kalata, *The tracking
//! index*, IEEE Trans. Aerospace and Electronic Systems 20(2), 1984):
//!
//! ```text
//! q⁻ = q + T v        q = q⁻ + α (y − q⁻)        v = v + (β/T) (y − q⁻)        β = 2 (2 − α) − 4 √(1 − α)
//! ```
//!
//! Its velocity lags by T (α/β − 1/2) at constant acceleration.

/// Largest gain β: that of a filter which takes positions as exact would be 2.
const LARGEST: f64 = 0.8;

/// Gains of the estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum MotionGains {
    /// Low-pass of the difference.
    Difference { gain: f64 },
    /// Kalman filter.
    Filter { position: f64, velocity: f64 },
}

impl MotionGains {
    /// Returns a filter for positions with this rms noise (rad, m) every `period_s` (s), whose velocity has an acceleration noise
    /// of at most `acceleration_noise` (rad/s², m/s²).
    pub(crate) fn of_limited(noise: f64, acceleration_noise: f64, period_s: f64) -> Self {
        let velocity = (acceleration_noise * period_s * period_s / noise).min(LARGEST);
        // β = 2 (2 − α) − 4 √(1 − α), solved for α: with r = √(1 − α), β = 2 (1 − r)².
        let rest = 1.0 - (0.5 * velocity).sqrt();
        Self::Filter { position: 1.0 - rest * rest, velocity }
    }
}

/// Estimate of one joint.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MotionEstimator {
    gains: MotionGains,
    period_s: f64,
    /// Position, rad (m); NaN before the first.
    pub(crate) position: f64,
    /// Velocity, rad/s (m/s).
    pub(crate) velocity: f64,
}

impl MotionEstimator {
    pub(crate) fn new(gains: MotionGains, period_s: f64) -> Self {
        Self { gains, period_s, position: f64::NAN, velocity: 0.0 }
    }

    /// Starts the estimate at this motion.
    pub(crate) fn start(&mut self, position: f64, velocity: f64) {
        (self.position, self.velocity) = (position, velocity);
    }

    /// Updates the estimate with a position measured `periods` periods after the last one. A position that is not finite changes no velocity.
    pub(crate) fn update(&mut self, periods: u64, position: f64) {
        let elapsed_s = periods as f64 * self.period_s;
        let change = position - self.position;
        if !change.is_finite() {
            self.position = position;
            return;
        }
        match self.gains {
            MotionGains::Difference { gain } => {
                let gain = if periods == 1 { gain } else { 1.0 - (1.0 - gain).powf(periods as f64) };
                self.velocity += gain * (change / elapsed_s - self.velocity);
                self.position = position;
            }
            MotionGains::Filter { position: to_position, velocity } => {
                let innovation = change - elapsed_s * self.velocity;
                self.position += elapsed_s * self.velocity + to_position * innovation;
                self.velocity += velocity / elapsed_s * innovation;
            }
        }
    }

    /// Position `periods` periods ago: the one that was estimated then, `estimated`, or that of a motion at the present velocity.
    /// The difference of two estimates is α/β times as noisy as the velocity.
    pub(crate) fn before(&self, periods: u32, estimated: f64) -> f64 {
        match self.gains {
            MotionGains::Difference { .. } => estimated,
            MotionGains::Filter { .. } => self.position - f64::from(periods) * self.period_s * self.velocity,
        }
    }

    pub(crate) fn reset(&mut self) {
        *self = Self::new(self.gains, self.period_s);
    }
}

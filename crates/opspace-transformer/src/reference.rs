//! Motion of a joint's reference.

use crate::motion_estimator::{MotionEstimator, MotionGains};

/// Motion of a joint's reference, estimated as that of the joint is. Position and velocity are relative to the estimate: only
/// the acceleration matters.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reference {
    /// Velocity, rad/s (m/s); zero without a reference.
    pub(crate) velocity: f64,
    /// Acceleration since the last sample, rad/s² (m/s²).
    pub(crate) acceleration: f64,
    /// Velocity that the estimate lacks, because it lags behind, rad/s (m/s).
    pub(crate) anticipated: f64,
    /// Position that it lacks, rad (m).
    ahead: f64,
    estimate: MotionEstimator,
}

impl Reference {
    pub(crate) fn new(gains: MotionGains, period_s: f64) -> Self {
        let mut estimate = MotionEstimator::new(gains, period_s);
        estimate.start(0.0, 0.0);
        Self { velocity: 0.0, acceleration: 0.0, anticipated: 0.0, ahead: 0.0, estimate }
    }

    pub(crate) fn advance(&mut self, acceleration: f64, period_s: f64) {
        let before = self.anticipated;
        self.acceleration = acceleration;
        self.anticipated += period_s * acceleration;
        self.ahead += 0.5 * period_s * (before + self.anticipated);
        self.estimate.update(1, self.ahead);
        self.anticipated -= self.estimate.velocity;
        self.ahead -= self.estimate.position;
        self.estimate.start(0.0, 0.0);
    }

    /// Ends the reference: the joint goes on at the velocity that it has.
    pub(crate) fn end(&mut self) {
        [self.velocity, self.acceleration, self.anticipated, self.ahead] = [0.0; 4];
    }
}

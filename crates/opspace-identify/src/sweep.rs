//! To and fro at a constant speed: what holds a joint back, without its inertia.

use crate::friction::ConstantVelocityRun;
use crate::gains::Gains;
use crate::session::Record;

/// A joint's way to and fro at a constant speed.
pub(crate) struct Sweep {
    /// Rad/s (m/s).
    pub speed: f64,
    /// How far from the middle the joint has long been at that speed, rad (m).
    pub half: f64,
    /// What was asked and measured on the way.
    pub record: Record,
}

impl Sweep {
    /// Half the difference of a quantity between both directions, over the same positions.
    fn half_difference(&self, quantity: impl Fn(&Record, usize) -> f64, period_s: f64) -> Option<f64> {
        let record = &self.record;
        let mut sums = [(0.0, 0.0); 2];
        // The first leg only leads to where the others begin.
        let turned = record.asked.windows(2).position(|w| w[1] < w[0])?;
        for k in turned..record.asked.len() - 1 {
            let v = (record.asked[k + 1] - record.asked[k]) / period_s;
            if record.position[k].abs() < self.half && (v.abs() - self.speed).abs() < 1e-6 * self.speed {
                let (sum, count) = &mut sums[usize::from(v > 0.0)];
                *sum += quantity(record, k);
                *count += 1.0;
            }
        }
        let [(back, m), (forth, n)] = sums;
        (m > 0.0 && n > 0.0).then(|| 0.5 * (forth / n - back / m))
    }

    /// How far the joint is behind its set-point, rad (m).
    pub fn lag(&self, period_s: f64) -> Option<f64> {
        self.half_difference(|record, k| record.asked[k] - record.position[k], period_s)
    }

    /// Friction at this speed: of the measured torque, else of how far the joint lags beyond what grows with speed.
    pub fn friction(&self, gains: &Gains, lag: Lag, period_s: f64) -> Option<ConstantVelocityRun> {
        let torque = if self.record.torque.is_empty() {
            gains.drive.kv * gains.drive.kp * (self.lag(period_s)? - lag.per_speed * self.speed)
        } else {
            self.half_difference(|record, k| record.torque[k], period_s)?
        };
        Some(ConstantVelocityRun { speed: self.speed, torque })
    }
}

/// How far a joint is behind its set-point at constant speed: a part that Coulomb friction makes, and one that grows with
/// speed, which the servo makes and in which viscous friction can't be told apart.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Lag {
    /// Rad (m).
    pub at_rest: f64,
    /// s.
    pub per_speed: f64,
}

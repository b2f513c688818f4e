//! Motion back and forth at a constant speed, which shows friction without the effect of inertia.

use crate::friction::ConstantVelocityRun;
use crate::gains::{Gains, Lag};
use crate::session::Record;

/// Motion of a joint back and forth at a constant speed.
pub(crate) struct Sweep {
    /// Speed, rad/s (m/s).
    pub speed: f64,
    /// Half of the range about the middle in which the joint moves steadily at that speed, rad (m).
    pub half: f64,
    /// Setpoints and measurements of the motion.
    pub record: Record,
}

impl Sweep {
    /// Returns half the difference of a quantity between the two directions, over the same positions; `None` if one
    /// direction is missing.
    fn half_difference(&self, quantity: impl Fn(&Record, usize) -> f64, period_s: f64) -> Option<f64> {
        let record = &self.record;
        let mut sums = [(0.0, 0.0); 2];
        // The first leg only moves to the start of the other legs.
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

    /// Speed of the joint, rad/s (m/s). It is not that of the setpoint where the gravity torque, and with it the lag, changes
    /// over the motion.
    pub fn measured_speed(&self, period_s: f64) -> Option<f64> {
        let velocity = |record: &Record, k: usize| (record.position[k + 1] - record.position[k]) / period_s;
        self.half_difference(velocity, period_s)
    }

    /// Lag of the joint behind its setpoint, rad (m).
    pub fn lag(&self, period_s: f64) -> Option<f64> {
        self.half_difference(|record, k| record.asked[k] - record.position[k], period_s)
    }

    /// Returns the friction at this speed: from the measured torque, or otherwise from the lag minus its part
    /// proportional to speed.
    pub fn friction(&self, gains: &Gains, lag: Lag, period_s: f64) -> Option<ConstantVelocityRun> {
        let torque = if self.record.torque.is_empty() {
            gains.drive.kv
                * gains.drive.kp
                * (self.lag(period_s)? - lag.per_speed * self.measured_speed(period_s)?)
        } else {
            self.half_difference(|record, k| record.torque[k], period_s)?
        };
        Some(ConstantVelocityRun { speed: self.speed, torque })
    }
}

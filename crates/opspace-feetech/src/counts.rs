//! Counts of a servo and angles of its joint.

use std::f64::consts::TAU;

/// Counts of a turn of the servo.
pub const COUNTS_PER_TURN: u16 = 4096;

/// Angle of one count, rad.
pub const RAD_PER_COUNT: f64 = TAU / COUNTS_PER_TURN as f64;

/// Relation between the counts of a servo and the angle of its joint: q = sign · (count − zero) · 2π/4096.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CountScale {
    /// Count at which the joint's angle is 0.
    pub zero: f64,
    /// 1, or −1 if the counts decrease where the angle increases.
    pub sign: f64,
    /// Smallest count that is commanded.
    pub min: i32,
    /// Largest count that is commanded.
    pub max: i32,
}

impl CountScale {
    /// Returns the angle (rad) at a count.
    #[must_use]
    pub fn angle(&self, count: i32) -> f64 {
        self.sign * (f64::from(count) - self.zero) * RAD_PER_COUNT
    }

    /// Returns the velocity (rad/s) of a velocity in counts/s.
    #[must_use]
    pub fn velocity(&self, counts_per_s: f64) -> f64 {
        self.sign * counts_per_s * RAD_PER_COUNT
    }

    /// Returns the count nearest to an angle (rad) within the range, and true if the angle lies beyond the range. An angle
    /// that is not finite has no count.
    #[must_use]
    pub fn count(&self, angle: f64) -> Option<(i32, bool)> {
        let count = (self.zero + self.sign * angle / RAD_PER_COUNT).round();
        if !count.is_finite() {
            return None;
        }
        let (min, max) = (f64::from(self.min), f64::from(self.max));
        Some((count.clamp(min, max) as i32, count < min || count > max))
    }

    /// Smallest and largest angle that is commanded, rad.
    #[must_use]
    pub fn range(&self) -> (f64, f64) {
        let (a, b) = (self.angle(self.min), self.angle(self.max));
        (a.min(b), a.max(b))
    }
}

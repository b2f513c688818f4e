//! Division of physics steps in which a joint turns far.
//!
//! Forces that depend on the posture and on the velocity change while a joint turns. A step of the plant knows them in its middle only, and
//! gains energy if they change much, most where an arm is nearly singular: its joints then turn fast. Real arms turn less by orders of
//! magnitude in a step of 50 µs.

/// Largest turn of a joint in a step, rad (m).
const LARGEST_TURN: f64 = 0.01;

/// Largest number of parts of a physics step.
const MOST_PARTS: f64 = 100.0;

/// Velocities from which the turn in a step is predicted.
pub(crate) struct Turns {
    /// Velocities before the last step, rad/s (m/s), and its length, s.
    before: Vec<f64>,
    last_s: f64,
}

impl Turns {
    /// Returns that of `n` joints at rest.
    pub fn new(n: usize) -> Self {
        Self { before: vec![0.0; n], last_s: 1.0 }
    }

    /// Returns the length of the next step (s) at the velocities `dq` (rad/s, m/s), if `left_s` (s) are left of a physics step of
    /// `dt_s` (s).
    pub fn part_s(&mut self, dq: &[f64], dt_s: f64, left_s: f64) -> f64 {
        let ratio = dt_s / self.last_s;
        let speeds =
            dq.iter().zip(&self.before).map(|(now, before)| now.abs() + ratio * (now - before).abs());
        let fastest = speeds.fold(0.0, f64::max);
        let part_s = (LARGEST_TURN / fastest).max(dt_s / MOST_PARTS);
        self.last_s = if part_s < left_s { part_s.min(0.5 * left_s) } else { left_s };
        self.before.copy_from_slice(dq);
        self.last_s
    }
}

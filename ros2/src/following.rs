//! Detection of a robot that does not follow its setpoints, as with an inactive controller.

use std::time::Duration;

/// Motion of a joint below which it is at rest, rad or m.
const REST: f64 = 2e-4;

/// Time for which no joint moves while a setpoint moves away.
const PATIENCE: Duration = Duration::from_millis(500);

/// Watch of the motion of joints and setpoints. Allocates nothing after it is built.
#[derive(Clone, Debug)]
pub struct FollowWatch {
    limit: f64,
    /// Positions and setpoints since which no joint has moved, and their time, s.
    q: Vec<f64>,
    setpoint: Vec<f64>,
    since_s: Option<f64>,
}

impl FollowWatch {
    /// Returns a watch of n joints, for setpoints that move by more than `limit` (rad or m).
    #[must_use]
    pub fn new(n: usize, limit: f64) -> Self {
        Self { limit, q: vec![0.0; n], setpoint: vec![0.0; n], since_s: None }
    }

    /// Returns true if a setpoint has moved by more than the limit for half a second in which no joint moved. `q` and
    /// `setpoint` are the positions and the setpoints in force (n) at `time_s` (s).
    pub fn is_left_behind(&mut self, time_s: f64, q: &[f64], setpoint: &[f64]) -> bool {
        let moved = |from: &[f64], to: &[f64]| {
            from.iter().zip(to).map(|(from, to)| (to - from).abs()).fold(0.0, f64::max)
        };
        match self.since_s {
            Some(since_s) if moved(&self.q, q) <= REST => {
                moved(&self.setpoint, setpoint) > self.limit && time_s - since_s > PATIENCE.as_secs_f64()
            }
            _ => {
                self.q.copy_from_slice(q);
                self.setpoint.copy_from_slice(setpoint);
                self.since_s = Some(time_s);
                false
            }
        }
    }
}

//! Detection of a robot that does not follow its commands, as with an inactive controller.

use std::time::Duration;

/// Motion of a joint below which it is at rest, rad or m.
const REST: f64 = 2e-4;

/// Time for which no joint moves while a command changes.
const PATIENCE: Duration = Duration::from_millis(500);

/// Watch of the motion of joints and the change of commands. Allocates nothing after it is built.
#[derive(Clone, Debug)]
pub struct FollowWatch {
    limit: f64,
    /// Positions and commands since which no joint has moved, and their time, s.
    q: Vec<f64>,
    command: Vec<f64>,
    since_s: Option<f64>,
}

impl FollowWatch {
    /// Returns a watch of n joints, for commands that change by more than `limit` (rad, rad/s or Nm; m, m/s or N).
    #[must_use]
    pub fn new(n: usize, limit: f64) -> Self {
        Self { limit, q: vec![0.0; n], command: vec![0.0; n], since_s: None }
    }

    /// Begins anew, as in a hold.
    pub fn restart(&mut self) {
        self.since_s = None;
    }

    /// Returns true if a command has changed by more than the limit in half a second or more in which no joint moved. `q` and
    /// `command` are the positions and the commands in force (n) at `time_s` (s).
    pub fn is_left_behind(&mut self, time_s: f64, q: &[f64], command: &[f64]) -> bool {
        let changed = |from: &[f64], to: &[f64]| {
            from.iter().zip(to).map(|(from, to)| (to - from).abs()).fold(0.0, f64::max)
        };
        match self.since_s {
            Some(since_s) if changed(&self.q, q) <= REST => {
                changed(&self.command, command) > self.limit && time_s - since_s > PATIENCE.as_secs_f64()
            }
            _ => {
                self.q.copy_from_slice(q);
                self.command.copy_from_slice(command);
                self.since_s = Some(time_s);
                false
            }
        }
    }
}

//! Commands of a simulated arm from their reception until they act.

use nalgebra::DVector;

/// Commands that were received, and those of them that do not act yet.
pub(crate) struct CommandQueue {
    pending: Vec<Pending>,
    /// Number of the last command.
    number: u64,
    /// Values of the last command with values (n).
    last: DVector<f64>,
    /// True if a command with values was received.
    has_values: bool,
}

/// Command that has not taken effect yet.
#[derive(Clone, Debug)]
struct Pending {
    acts_at: Option<u64>,
    number: u64,
    values: DVector<f64>,
}

impl CommandQueue {
    /// Returns the queue of an arm of `n` joints, with space for `most` commands that do not act yet.
    pub fn new(n: usize, most: usize) -> Self {
        let pending = Pending { acts_at: None, number: 0, values: DVector::zeros(n) };
        Self { pending: vec![pending; most], number: 0, last: DVector::zeros(n), has_values: false }
    }

    /// Accepts a command with values, which acts at the servo tick `acts_at`.
    pub fn command(&mut self, values: &[f64], acts_at: u64) {
        self.number += 1;
        self.has_values = true;
        self.last.copy_from_slice(values);
        self.send(acts_at);
    }

    /// Accepts a hold command, and returns its number.
    pub fn hold(&mut self) -> u64 {
        self.number += 1;
        self.number
    }

    /// Lets the last values act again at the servo tick `acts_at`, after `change`, as the command that was accepted last; nothing
    /// without values.
    pub fn repeat(&mut self, acts_at: u64, change: impl FnOnce(&mut DVector<f64>)) {
        if self.has_values {
            change(&mut self.last);
            self.send(acts_at);
        }
    }

    /// Drops all commands that do not act yet.
    pub fn clear(&mut self) {
        self.pending.iter_mut().for_each(|pending| pending.acts_at = None);
    }

    /// Passes the number and values of each command that acts from this servo tick on to `act`.
    pub fn take_due(&mut self, servo_tick: u64, mut act: impl FnMut(u64, &DVector<f64>)) {
        for pending in &mut self.pending {
            if pending.acts_at.is_some_and(|tick| tick <= servo_tick) {
                pending.acts_at = None;
                act(pending.number, &pending.values);
            }
        }
    }

    /// Queues the last values as a command that acts at `acts_at`.
    fn send(&mut self, acts_at: u64) {
        let free = self.pending.iter().position(|pending| pending.acts_at.is_none());
        let pending = &mut self.pending[free.unwrap_or(0)];
        pending.acts_at = Some(acts_at);
        pending.number = self.number;
        pending.values.copy_from(&self.last);
    }
}

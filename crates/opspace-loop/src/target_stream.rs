//! Targets from another thread: a bounded ring of rows, of which the newest wins.

use opspace_control::{InputHandle, TargetError, Targets, TaskHandle};
use rtrb::{Consumer, Producer, RingBuffer};

/// Rows that the ring holds: a sender that is faster than the control loop loses rows only beyond so many per cycle.
const ROWS: usize = 16;

/// The sending end, for any thread.
pub struct TargetSender {
    targets: Targets,
    ring: Producer<f64>,
    /// Number of writes so far: stamps of rows under way.
    writes: f64,
}

/// The receiving end, for the thread of the control loop.
pub struct TargetReceiver {
    ring: Consumer<f64>,
    row: Vec<f64>,
    /// Numbers of the last writes received, by task.
    seen: Vec<f64>,
}

/// A stream of targets with the layout of `targets`.
#[must_use]
pub fn target_stream(targets: &Targets) -> (TargetSender, TargetReceiver) {
    let width = targets.row().len();
    let (producer, consumer) = RingBuffer::new(ROWS * width);
    let sender = TargetSender { targets: targets.clone(), ring: producer, writes: 0.0 };
    let seen = vec![f64::NAN; targets.tasks()];
    (sender, TargetReceiver { ring: consumer, row: targets.row().to_vec(), seen })
}

impl TargetSender {
    /// Targets whose handles this sender takes.
    #[must_use]
    pub fn targets(&self) -> &Targets {
        &self.targets
    }

    /// Sends inputs of a task. They are stamped when the control loop receives them. Allocates nothing unless it fails.
    /// `false` if the ring is full: the control loop takes none, or too many were sent within a cycle.
    ///
    /// # Errors
    /// As [`Targets::write`].
    pub fn send(
        &mut self,
        task: &TaskHandle,
        inputs: &[(&InputHandle, &[f64])],
    ) -> Result<bool, TargetError> {
        self.targets.write(task, self.writes + 1.0, inputs)?;
        self.writes += 1.0;
        Ok(self.push())
    }

    /// Returns true if the receiving end is gone: the run is over.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.ring.is_abandoned()
    }

    /// Asks the robot to be held, or to go on.
    pub fn send_hold(&mut self, hold: bool) -> bool {
        self.targets.hold(hold);
        self.push()
    }

    /// Chooses a prepared task set by its number.
    pub fn send_task_set(&mut self, number: u32) -> bool {
        self.targets.choose_task_set(number);
        self.push()
    }

    fn push(&mut self) -> bool {
        let Ok(chunk) = self.ring.write_chunk_uninit(self.targets.row().len()) else { return false };
        chunk.fill_from_iter(self.targets.row().iter().copied());
        true
    }
}

impl TargetReceiver {
    /// Brings `targets` up to date with the newest row, its new inputs stamped with `clock_s` (s, the robot's clock).
    /// Allocates and locks nothing.
    pub fn receive(&mut self, clock_s: f64, targets: &mut Targets) {
        let width = self.row.len();
        let rows = self.ring.slots().checked_div(width).unwrap_or(0);
        for _ in 0..rows {
            let Ok(chunk) = self.ring.read_chunk(width) else { return };
            for (slot, value) in self.row.iter_mut().zip(chunk) {
                *slot = value;
            }
        }
        if rows > 0 {
            targets.merge(&self.row, &mut self.seen, clock_s);
        }
    }
}

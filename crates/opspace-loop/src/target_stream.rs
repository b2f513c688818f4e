//! Targets from another thread, through a bounded ring buffer of rows; the newest row is used.

use opspace_control::{InputHandle, TargetError, Targets, TaskHandle};
use rtrb::{Consumer, Producer, RingBuffer};

/// Capacity of the ring in rows: rows are lost only if more than this are sent within one control cycle.
const ROWS: usize = 16;

/// Sending end, for any thread.
pub struct TargetSender {
    targets: Targets,
    ring: Producer<f64>,
    /// Number of writes so far; it stamps the rows.
    writes: f64,
}

/// Receiving end, for the thread of the control loop.
pub struct TargetReceiver {
    ring: Consumer<f64>,
    row: Vec<f64>,
    /// Number of the last write received, by task.
    seen: Vec<f64>,
}

/// Returns a stream of targets with the layout of `targets`.
#[must_use]
pub fn target_stream(targets: &Targets) -> (TargetSender, TargetReceiver) {
    let width = targets.row().len();
    let (producer, consumer) = RingBuffer::new(ROWS * width);
    let sender = TargetSender { targets: targets.clone(), ring: producer, writes: 0.0 };
    let seen = vec![f64::NAN; targets.tasks()];
    (sender, TargetReceiver { ring: consumer, row: targets.row().to_vec(), seen })
}

impl TargetSender {
    /// Targets whose handles this sender accepts.
    #[must_use]
    pub fn targets(&self) -> &Targets {
        &self.targets
    }

    /// Sends inputs of a task. They are stamped when the control loop receives them. Allocates nothing unless it fails.
    /// Returns `false` if the ring is full: the control loop receives nothing, or too many rows were sent within a
    /// cycle.
    ///
    /// # Errors
    /// Errors of [`Targets::write`].
    pub fn send(
        &mut self,
        task: &TaskHandle,
        inputs: &[(&InputHandle, &[f64])],
    ) -> Result<bool, TargetError> {
        self.targets.write(task, self.writes + 1.0, inputs)?;
        self.writes += 1.0;
        Ok(self.push())
    }

    /// Returns true if the receiving end was dropped: the run is over.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.ring.is_abandoned()
    }

    /// Requests that the robot is held, or that control continues. Returns `false` if the ring is full.
    pub fn send_hold(&mut self, hold: bool) -> bool {
        self.targets.hold(hold);
        self.push()
    }

    /// Selects a prepared task set by its number. Returns `false` if the ring is full.
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
    /// Updates `targets` with the newest row; new inputs are stamped with `clock_s` (s, robot's clock). Allocates and
    /// locks nothing.
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

//! Log as a robot: it returns the logged samples, and keeps the commands.

use crate::error::LogError;
use crate::inputs::LoggedInputs;
use crate::recording::{Column, Recording};
use opspace_backend::signal_names::{DQ_DESIRED, Q_DESIRED, STOP_REQUESTED, TORQUE_DESIRED};
use opspace_backend::{Backend, Capabilities, Command, CommandKind, DeviceFault, Layout, Sample};
use std::ops::Range;

/// Robot whose measurements are those of a log. It does not move by commands: from the first one that differs from the
/// log on, a run on it shows only what the commands would have been.
pub struct ReplayBackend<'a> {
    inputs: LoggedInputs<'a>,
    capabilities: Capabilities,
    /// Logged commands (n); `None` if the log has none.
    logged: Option<Column<'a>>,
    cycles: usize,
    command: Vec<f64>,
    /// Times of the first and the last sample on the robot's clock, s.
    began_s: Option<f64>,
    time_s: f64,
    parted_s: Option<f64>,
    /// True if the last command differs; that of a stop is no command of the log's cycle.
    differs: bool,
}

impl<'a> ReplayBackend<'a> {
    /// Returns the robot of a log. Its capabilities are those of the robot that was logged.
    ///
    /// # Errors
    /// If the log lacks a signal that `capabilities` declares.
    pub fn new(recording: &'a Recording, capabilities: Capabilities) -> Result<Self, LogError> {
        let without_targets = Layout { channel: String::new(), signals: Vec::new() };
        let tick = recording.tick()?;
        let n = capabilities.joints.len();
        let written = match capabilities.command {
            CommandKind::Position => Q_DESIRED,
            CommandKind::Velocity => DQ_DESIRED,
            CommandKind::Torque => TORQUE_DESIRED,
        };
        let logged = tick.signal(written).filter(|column| column.elements().len() == n);
        Ok(Self {
            inputs: LoggedInputs::new(recording, &capabilities, &without_targets)?,
            capabilities,
            logged,
            cycles: 0,
            command: Vec::with_capacity(n),
            began_s: None,
            time_s: 0.0,
            parted_s: None,
            differs: false,
        })
    }

    /// Last command (n); empty before the first one and while the robot is held.
    #[must_use]
    pub fn command(&self) -> &[f64] {
        &self.command
    }

    /// Time of the first command that differs from the logged one in any bit, s after the first sample; `None` if all
    /// are equal. The last setpoint of a stop is not compared: the log has the command that it replaces.
    #[must_use]
    pub fn parted_s(&self) -> Option<f64> {
        self.parted_s
    }
}

impl ReplayBackend<'_> {
    /// Notes that the commands differ from this cycle on.
    fn part(&mut self) {
        let began_s = self.began_s.unwrap_or(self.time_s);
        self.parted_s.get_or_insert(self.time_s - began_s);
    }
}

impl Backend for ReplayBackend<'_> {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        if std::mem::take(&mut self.differs) {
            self.part();
        }
        let Some(read) = self.inputs.read_next(sample) else {
            return Err(DeviceFault::new(0, "the log ends"));
        };
        self.cycles += 1;
        self.time_s = sample.time_s;
        self.began_s.get_or_insert(sample.time_s);
        read
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        self.command.clear();
        let values = match command {
            Command::Hold => return Ok(()),
            Command::Torque(values) | Command::Velocity(values) | Command::Position(values) => values,
        };
        if command.kind() != Some(self.capabilities.command) {
            return Err(DeviceFault::new(1, "the robot of this log accepts other commands"));
        }
        self.command.extend_from_slice(values);
        let equal = self.logged.as_ref().is_some_and(|logged| {
            let row = logged.row(self.cycles.saturating_sub(1));
            row.iter().zip(&self.command).all(|(was, is)| was.to_bits() == is.to_bits())
        });
        self.differs = !equal;
        Ok(())
    }

    fn stop(&mut self) {
        self.command.clear();
        self.differs = false;
    }
}

/// Logged targets and stop requests, cycle by cycle, for tasks that may differ from those of the log.
pub struct LoggedTargets<'a> {
    stop_requested: Option<Column<'a>>,
    /// Columns of the log, and where they stand in a row of targets.
    columns: Vec<(Range<usize>, Column<'a>)>,
    cycles: usize,
    next: usize,
    row: Vec<f64>,
}

impl<'a> LoggedTargets<'a> {
    /// Returns the targets of the log that `layout` has too, by name and length. All other elements of a row keep the
    /// values of `row`.
    ///
    /// # Errors
    /// If the log has no control cycles.
    pub fn new(recording: &'a Recording, layout: &Layout, row: &[f64]) -> Result<Self, LogError> {
        let tick = recording.tick()?;
        let known = layout.signals.iter().filter_map(|signal| {
            let column =
                tick.signal(&signal.name).filter(|column| column.elements().len() == signal.len())?;
            Some((layout.columns(&signal.name)?, column))
        });
        Ok(Self {
            stop_requested: tick.signal(STOP_REQUESTED),
            columns: known.collect(),
            cycles: tick.len(),
            next: 0,
            row: row.to_vec(),
        })
    }

    /// Returns the row of targets of the next cycle, and true if a stop was requested in it; `None` at the end of the
    /// log.
    pub fn next_row(&mut self) -> Option<(&[f64], bool)> {
        let k = self.next;
        if k >= self.cycles {
            return None;
        }
        self.next += 1;
        for (range, column) in &self.columns {
            self.row[range.clone()].copy_from_slice(column.row(k));
        }
        Some((&self.row, self.stop_requested.as_ref().is_some_and(|column| column.row(k)[0] != 0.0)))
    }
}

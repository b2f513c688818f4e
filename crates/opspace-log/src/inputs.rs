//! Logged inputs of a run: samples, targets, stop requests and device faults, in order.
//!
//! A replay passes them to the same control loop.

use crate::error::LogError;
use crate::outcome::OutcomeRecord;
use crate::recording::{ChannelData, Column, Recording};
use opspace_backend::signal_names::{
    self, DEVICE_FAILED, DEVICE_LIMITED, DQ_MEASURED, JOINT_TORQUE, MOTOR_TORQUE, Q, RAW, STATUS,
    STOP_REQUESTED,
};
use opspace_backend::{Capabilities, DeviceFault, Layout, Sample, Status};

/// Logged inputs of a run, row by row.
pub struct LoggedInputs<'a> {
    columns: Columns<'a>,
    targets: Vec<Column<'a>>,
    device_fault: DeviceFault,
    next: usize,
    sample: Sample,
    target_row: Vec<f64>,
}

/// Inputs of one control cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoggedInput<'a> {
    /// Sample of the cycle, or the device fault that prevented it.
    pub read: Result<&'a Sample, &'a DeviceFault>,
    /// Row of targets.
    pub targets: &'a [f64],
    /// True if a stop was requested in this cycle.
    pub stop_requested: bool,
}

struct Columns<'a> {
    tick: &'a ChannelData,
    stop_requested: Column<'a>,
    device_failed: Column<'a>,
    q: Column<'a>,
    dq: Option<Column<'a>>,
    motor_torque: Option<Column<'a>>,
    joint_torque: Option<Column<'a>>,
    status: Option<[Column<'a>; 2]>,
    wrenches: Vec<Column<'a>>,
}

impl<'a> LoggedInputs<'a> {
    /// Returns the logged inputs of a robot with these capabilities and targets.
    ///
    /// # Errors
    /// If the log lacks one of the signals.
    pub fn new(
        recording: &'a Recording,
        capabilities: &Capabilities,
        targets: &Layout,
    ) -> Result<Self, LogError> {
        Self::of_segment(recording, &OutcomeRecord::of(recording), capabilities, targets)
    }

    /// Returns the logged inputs of a segment of a log with this outcome, which the whole log has.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn of_segment(
        segment: &'a Recording,
        outcome: &OutcomeRecord,
        capabilities: &Capabilities,
        targets: &Layout,
    ) -> Result<Self, LogError> {
        let tick = segment.tick()?;
        let signal = |name: &str, length: usize| {
            let found = tick.signal(name).filter(|column| column.elements().len() == length);
            found.ok_or_else(|| LogError::NoSignal { name: name.to_owned() })
        };
        let n = capabilities.joints.len();
        let optional = |measured: bool, name| measured.then(|| signal(name, n)).transpose();
        let status = || Ok::<_, LogError>([signal(STATUS, 1)?, signal(DEVICE_LIMITED, 1)?]);
        let sensors = capabilities.force_sensors.iter();
        let columns = Columns {
            tick,
            stop_requested: signal(STOP_REQUESTED, 1)?,
            device_failed: signal(DEVICE_FAILED, 1)?,
            q: signal(Q, n)?,
            dq: optional(capabilities.measures_velocity, DQ_MEASURED)?,
            motor_torque: optional(capabilities.measures_motor_torque, MOTOR_TORQUE)?,
            joint_torque: optional(capabilities.measures_joint_torque, JOINT_TORQUE)?,
            status: capabilities.reports_status.then(status).transpose()?,
            wrenches: sensors
                .map(|s| signal(&signal_names::of(&s.name, RAW), 6))
                .collect::<Result<_, _>>()?,
        };
        let signals = targets.signals.iter();
        Ok(Self {
            columns,
            targets: signals.map(|s| signal(&s.name, s.len())).collect::<Result<_, _>>()?,
            // A truncated log has no outcome, so its device fault is unknown.
            device_fault: outcome.device_fault.clone().unwrap_or_else(|| DeviceFault::new(0, "unknown")),
            next: 0,
            sample: Sample::new(capabilities),
            target_row: Vec::with_capacity(targets.width()),
        })
    }

    /// Fills `sample` with that of the next cycle, or returns the device fault that prevented it; `None` at the end of
    /// the log. It allocates only for a fault.
    pub(crate) fn read_next(&mut self, sample: &mut Sample) -> Option<Result<(), DeviceFault>> {
        let k = self.next;
        if k >= self.columns.tick.len() {
            return None;
        }
        self.next += 1;
        if self.columns.device_failed.row(k)[0] != 0.0 {
            return Some(Err(self.device_fault.clone()));
        }
        self.columns.read(k, sample);
        Some(Ok(()))
    }

    /// Returns the inputs of the next cycle; `None` at the end of the log.
    pub fn next_input(&mut self) -> Option<LoggedInput<'_>> {
        let k = self.next;
        if k >= self.columns.tick.len() {
            return None;
        }
        self.next += 1;
        let failed = self.columns.device_failed.row(k)[0] != 0.0;
        if !failed {
            self.columns.read(k, &mut self.sample);
        }
        self.target_row.clear();
        for column in &self.targets {
            self.target_row.extend_from_slice(column.row(k));
        }
        Some(LoggedInput {
            read: if failed { Err(&self.device_fault) } else { Ok(&self.sample) },
            targets: &self.target_row,
            stop_requested: self.columns.stop_requested.row(k)[0] != 0.0,
        })
    }
}

impl Columns<'_> {
    fn read(&self, k: usize, sample: &mut Sample) {
        sample.time_s = self.tick.time_s[k];
        sample.q.copy_from_slice(self.q.row(k));
        let optional = [
            (&mut sample.dq, &self.dq),
            (&mut sample.motor_torque, &self.motor_torque),
            (&mut sample.joint_torque, &self.joint_torque),
        ];
        for (to, from) in optional {
            if let (Some(to), Some(from)) = (to, from) {
                to.copy_from_slice(from.row(k));
            }
        }
        if let Some([word, limited]) = &self.status {
            // The number was converted from a u32.
            sample.status = Some(Status::new(word.row(k)[0] as u32, limited.row(k)[0] != 0.0));
        }
        for (to, from) in sample.wrenches.iter_mut().zip(&self.wrenches) {
            to.copy_from_slice(from.row(k));
        }
    }
}

//! Test doubles: robot, controller, and servos of a velocity robot.

use super::{PERIOD_S, START};
use nalgebra::DVector;
use opspace_backend::{
    Backend, Capabilities, Command, CommandKind, DeviceFault, Observable, Sample, SignalRecorder,
};
use opspace_control::{ControlInput, Controller, Measurement};
use opspace_model::Data;
use opspace_transformer::Transformer;
use std::ops::Range;

/// Call that a robot received.
#[derive(Clone, Debug, PartialEq)]
pub enum Received {
    Positions(DVector<f64>),
    Velocities(DVector<f64>),
    Torques(DVector<f64>),
    Hold,
    Stop,
}

impl From<Command<'_>> for Received {
    fn from(command: Command<'_>) -> Self {
        match command {
            Command::Position(q) => Self::Positions(DVector::from_column_slice(q)),
            Command::Velocity(dq) => Self::Velocities(DVector::from_column_slice(dq)),
            Command::Torque(tau) => Self::Torques(DVector::from_column_slice(tau)),
            Command::Hold => Self::Hold,
        }
    }
}

/// Robot whose samples are a function of the cycle number, counted from the first read. Commands do not move it.
pub struct Scripted<F> {
    pub capabilities: Capabilities,
    pub script: F,
    /// Cycles that can't be read.
    pub unreadable: Range<u64>,
    /// Cycle in which a command is rejected.
    pub refused: Option<u64>,
    /// Fault that is reported in these cycles.
    pub device_fault: DeviceFault,
    /// Calls of `write` and `stop`, in their order.
    pub received: Vec<Received>,
    /// Cycle of each of them.
    pub received_in: Vec<u64>,
    /// Number of reads so far.
    pub reads: u64,
}

impl<F: FnMut(u64, &mut Sample)> Scripted<F> {
    pub fn new(capabilities: Capabilities, script: F) -> Self {
        Self {
            capabilities,
            script,
            unreadable: 0..0,
            refused: None,
            device_fault: DeviceFault::new(4711, "the drive of the elbow is too hot"),
            received: Vec::new(),
            received_in: Vec::new(),
            reads: 0,
        }
    }

    fn cycle(&self) -> u64 {
        self.reads.saturating_sub(1)
    }

    fn record(&mut self, received: Received) {
        self.received.push(received);
        self.received_in.push(self.cycle());
    }
}

impl<F: FnMut(u64, &mut Sample)> Backend for Scripted<F> {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        let cycle = self.reads;
        self.reads += 1;
        if self.unreadable.contains(&cycle) {
            return Err(self.device_fault.clone());
        }
        (self.script)(cycle, sample);
        Ok(())
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        self.record(command.into());
        if self.refused == Some(self.cycle()) { Err(self.device_fault.clone()) } else { Ok(()) }
    }

    fn stop(&mut self) {
        self.record(Received::Stop);
    }
}

/// Script of a robot at rest at [`START`].
pub fn at_rest(cycle: u64, sample: &mut Sample) {
    sample.time_s = cycle as f64 * PERIOD_S;
    sample.q.copy_from_slice(&START);
}

/// Controller made from a function.
pub struct Commanded<F> {
    pub kind: CommandKind,
    pub command: F,
}

impl<F: FnMut(&Data, &Measurement, &mut [f64]) + Send> Commanded<F> {
    pub fn torques(command: F) -> Self {
        Self { kind: CommandKind::Torque, command }
    }
}

impl<F: FnMut(&Data, &Measurement, &mut [f64]) + Send> Controller for Commanded<F> {
    fn command_kind(&self) -> CommandKind {
        self.kind
    }

    fn start(&mut self, _input: &ControlInput<'_>) {}

    fn update(&mut self, input: &ControlInput<'_>, command: &mut [f64]) {
        (self.command)(input.data, input.measurement, command);
    }
}

impl<F> Observable for Commanded<F> {
    fn record(&self, _out: &mut SignalRecorder<'_>) {}
}

/// Transformer for velocity servos τ = kv (q̇_d − q̇).
pub struct VelocityServo {
    damping: [f64; 2],
}

impl VelocityServo {
    pub fn new(damping: [f64; 2]) -> Self {
        Self { damping }
    }
}

impl Transformer for VelocityServo {
    fn takes(&self) -> CommandKind {
        CommandKind::Velocity
    }

    fn transform(&mut self, data: &Data, torque: &[f64], command: &mut [f64]) {
        for (i, command) in command.iter_mut().enumerate() {
            *command = torque[i] / self.damping[i] + data.dq[i];
        }
    }
}

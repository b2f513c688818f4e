//! Run of a control loop: duration, stop requests, computation time of a step, rows for a sink, and outcome.
//!
//! [`Run::cycle`] is called once per interface cycle, by [`drive`](crate::drive()) or by a robot's own callback.

use crate::control_loop::ControlLoop;
use crate::fault::Fault;
use crate::phase::Phase;
use crate::target_stream::TargetReceiver;
use opspace_backend::signal_names::{RESPONSE_TIME, SAMPLE_INTERVAL, TIMING_CHANNEL, TORQUE_DESIRED};
use opspace_backend::{
    Command, DEVICE_FAILED, DeviceFault, EXTERNAL, GroundTruth, Layout, MAX_DELAY_CYCLES, SERVO,
    STOP_REQUESTED, Sample, Signal, SignalRecorder, Sink, TICK, TICK_TIME, TIMING, TRUTH, TruthLayouts,
    TruthRow,
};
use opspace_control::Targets;
use std::borrow::Borrow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Duration over which rows are recorded after an unplanned stop, s.
const AFTERMATH_S: f64 = 0.2;

/// Outcome of a run.
#[derive(Clone, Debug, PartialEq)]
pub enum RunOutcome {
    /// The run lasted as long as planned.
    Completed,
    /// A fault stopped the run.
    Faulted {
        /// Cause of the stop.
        fault: Fault,
        /// Time since the start of control, s.
        time_s: f64,
    },
    /// A stop was requested, or the run was finished before it was over.
    Interrupted {
        /// Time since the start of control, s.
        time_s: f64,
    },
}

/// Flag of a stop request, borrowed or shared.
type Request<'a> = Box<dyn Borrow<AtomicBool> + Send + Sync + 'a>;

/// Control loop that runs for a limited time and records its rows in a sink.
///
/// The sink and the flags of its stop requests are borrowed or owned. A `Run<'static>` owns them: a program that is called
/// once per cycle can keep it.
pub struct Run<'a> {
    control: ControlLoop,
    targets: Targets,
    sink: Box<dyn Sink + 'a>,
    stop_request: Option<Request<'a>>,
    abort_request: Option<Request<'a>>,
    stream: Option<TargetReceiver>,
    duration_cycles: u64,
    aftermath_cycles: u64,
    outcome: Option<RunOutcome>,
    /// True if a row was recorded since the last call of the sink's `between_ticks`.
    recorded: bool,
    /// Arrival of the last sample.
    arrived: Option<Instant>,
    /// Row of `timing` of the last cycle, with its time (s), until the command is written.
    timing: Option<(f64, [f64; 3])>,
    history: History,
    row: Vec<f64>,
    servo_row: Vec<f64>,
    servo_signals: Vec<Signal>,
}

impl<'a> Run<'a> {
    /// Returns a run with `duration_s` (s) of control. Its rows have the layouts of [`layouts`](Self::layouts); the sink is
    /// one, or a `&mut` to one.
    #[must_use]
    pub fn new(control: ControlLoop, duration_s: f64, sink: impl Sink + 'a) -> Self {
        let period_s = control.capabilities().period_s;
        let cycles = |seconds: f64| (seconds / period_s).round() as u64;
        let targets = control.targets();
        Self {
            row: vec![0.0; tick_layout(&control).width()],
            servo_row: Vec::new(),
            servo_signals: Vec::new(),
            history: History::new(control.model().n()),
            duration_cycles: cycles(duration_s),
            aftermath_cycles: cycles(AFTERMATH_S),
            outcome: None,
            recorded: false,
            arrived: None,
            timing: None,
            stop_request: None,
            abort_request: None,
            stream: None,
            control,
            targets,
            sink: Box::new(sink),
        }
    }

    /// Adds a stop request, a `&AtomicBool` or an `Arc<AtomicBool>`: once it is true, the run ends safely.
    #[must_use]
    pub fn with_stop_request(self, request: impl Borrow<AtomicBool> + Send + Sync + 'a) -> Self {
        Self { stop_request: Some(Box::new(request)), ..self }
    }

    /// Adds a second stop request, for a stop that takes too long: once `request` is true, the run is over, and the
    /// robot's own stop follows at once.
    #[must_use]
    pub fn with_abort_request(self, request: impl Borrow<AtomicBool> + Send + Sync + 'a) -> Self {
        Self { abort_request: Some(Box::new(request)), ..self }
    }

    /// Layouts of the rows, by channel number: [`TICK`] and [`TIMING`], and for a simulation [`TRUTH`], [`SERVO`] and
    /// [`EXTERNAL`].
    #[must_use]
    pub fn layouts(control: &ControlLoop, truth: Option<TruthLayouts>) -> Vec<Layout> {
        let mut layouts = vec![tick_layout(control), timing_layout()];
        if let Some(truth) = truth {
            let TruthLayouts { truth, mut servo, external, .. } = truth;
            servo.signals =
                SignalRecorder::describe(|out| record_servo(control, &servo.signals, &[], &[], out));
            layouts.extend([truth, servo]);
            layouts.extend(external);
        }
        layouts
    }

    /// Allocates memory for the rows of a simulation. Called once, before the first cycle.
    pub fn prepare_truth(&mut self, truth: &dyn GroundTruth) {
        let n = self.control.model().n();
        let servo = truth.layouts().servo;
        self.servo_row = vec![0.0; n + servo.width()];
        self.servo_signals = servo.signals;
    }

    /// Targets of the next cycle.
    pub fn targets(&mut self) -> &mut Targets {
        &mut self.targets
    }

    /// Receives targets from another thread from now on.
    pub fn set_target_stream(&mut self, receiver: TargetReceiver) {
        self.stream = Some(receiver);
    }

    /// Row of the last cycle, in the layout [`TICK`] of [`layouts`](Self::layouts).
    #[must_use]
    pub fn row(&self) -> &[f64] {
        &self.row
    }

    /// Control loop of the run.
    #[must_use]
    pub fn control(&self) -> &ControlLoop {
        &self.control
    }

    /// Computes one interface cycle and returns the command for the robot, if there is one. Write at most one command
    /// per cycle. Call it as soon as the sample has arrived.
    pub fn cycle(&mut self, sample: &Sample) -> Option<Command<'_>> {
        let arrived = Instant::now();
        self.between_cycles();
        let before = self.arrived.replace(arrived);
        let interval_ns = before.map_or(f64::NAN, |before| (arrived - before).as_nanos() as f64);
        if is_set(self.abort_request.as_ref()) {
            self.end_without_cycles(|time_s| RunOutcome::Interrupted { time_s });
        }
        if self.is_over() {
            return None;
        }
        let (stopped, is_ending) = (self.is_stopped(), self.outcome.is_some());
        let stop_requested = !is_ending && is_set(self.stop_request.as_ref());
        if let Some(stream) = &mut self.stream {
            stream.receive(sample.time_s, &mut self.targets);
        }
        let began = Instant::now();
        let step = self.control.step(sample, &self.targets);
        let (faulted, control_cycles) = (step.fault.is_some(), step.control_cycles);
        let elapsed_ns = began.elapsed().as_nanos() as f64;
        self.record([flag(stop_requested), 0.0]);
        if !(faulted || is_ending) {
            let response_ns = arrived.elapsed().as_nanos() as f64;
            self.timing = Some((self.control.clock_s(), [elapsed_ns, interval_ns, response_ns]));
        }
        if stopped {
            self.aftermath_cycles -= 1;
            return None;
        }
        if is_ending {
            return self.outgoing();
        }
        if faulted {
            self.end_faulted();
        } else if stop_requested {
            let _ = self.control.stop();
            self.outcome = Some(RunOutcome::Interrupted { time_s: self.time_s() });
        } else if control_cycles >= self.duration_cycles && self.control.result().phase != Phase::Rest {
            let _ = self.control.stop();
            self.outcome = Some(RunOutcome::Completed);
        }
        self.outgoing()
    }

    /// Stops because the robot could not be read. Returns the last command for the robot if its state is known.
    pub fn fail(&mut self, fault: DeviceFault) -> Option<Command<'_>> {
        if self.outcome.is_some() {
            self.control.abandon();
            self.aftermath_cycles = 0;
            return None;
        }
        let _ = self.control.fail(fault);
        self.record([0.0, 1.0]);
        self.end_faulted();
        self.outgoing()
    }

    /// Stops because the robot rejected the command of this cycle. A second row of the cycle records the fault, and no
    /// further command may be written. If the robot rejects a setpoint of a stop, its own stop follows, and the outcome remains.
    pub fn refuse(&mut self, fault: DeviceFault) {
        if self.outcome.is_some() {
            self.control.abandon();
            return;
        }
        let _ = self.control.fail(fault);
        self.record([0.0, 1.0]);
        self.end_faulted();
    }

    /// Notes that the command of this cycle was just written, for the response time. Without this call, it ends with the computation.
    pub fn command_written(&mut self) {
        if let (Some((_, [_, _, response_ns])), Some(arrived)) = (&mut self.timing, self.arrived) {
            *response_ns = arrived.elapsed().as_nanos() as f64;
        }
    }

    /// Lets the sink work between two cycles: call it after the command was written. The next cycle calls it otherwise.
    pub fn between_cycles(&mut self) {
        if let Some((time_s, row)) = self.timing.take() {
            self.sink.row(TIMING, time_s, &row);
        }
        if std::mem::take(&mut self.recorded) {
            self.sink.between_ticks();
        }
    }

    /// Ends the run after a panic in a part of the loop: nothing more is computed or recorded. The inputs of the cycle
    /// of the panic are not recorded, unless the panic came after the row, from the sink. A replay recomputes the cycles
    /// before it.
    pub fn abandon(&mut self) {
        self.end_without_cycles(|time_s| RunOutcome::Faulted { fault: Fault::Panicked, time_s });
    }

    /// Ends the run because the robot's own stop failed. A fault that stopped the run before remains its outcome.
    pub fn stop_failed(&mut self, fault: DeviceFault) {
        if !matches!(self.outcome, Some(RunOutcome::Faulted { .. })) {
            self.outcome = Some(RunOutcome::Faulted { fault: Fault::Device(fault), time_s: self.time_s() });
        }
        self.end_without_cycles(|time_s| RunOutcome::Interrupted { time_s });
    }

    /// Ends the run without further cycles, with this outcome at this time (s) unless there is one already.
    fn end_without_cycles(&mut self, outcome: impl FnOnce(f64) -> RunOutcome) {
        if self.outcome.is_none() {
            self.outcome = Some(outcome(self.time_s()));
        }
        self.control.abandon();
        self.aftermath_cycles = 0;
    }

    /// Records the rows of a simulation of the last read. Each servo row gets the desired torque of the command in
    /// effect.
    pub fn record_truth(&mut self, truth: &dyn GroundTruth) {
        let Self { control, sink, history, servo_signals, servo_row, .. } = self;
        truth.visit(&mut |row| match row {
            TruthRow::State { time_s, row } => sink.row(TRUTH, time_s, row),
            TruthRow::External { time_s, row } => sink.row(EXTERNAL, time_s, row),
            TruthRow::Servo { time_s, command, row } => {
                let torque = history.get(command);
                record_servo(control, servo_signals, torque, row, &mut SignalRecorder::sampling(servo_row));
                sink.row(SERVO, time_s, servo_row);
            }
            _ => {}
        });
    }

    /// Returns true once the robot must be in its safe state: call its own stop.
    #[must_use]
    pub fn is_stopped(&self) -> bool {
        self.outcome.is_some() && self.control.result().phase == Phase::Stopped
    }

    /// Returns true once no further cycle is needed.
    #[must_use]
    pub fn is_over(&self) -> bool {
        match self.outcome {
            None => false,
            Some(RunOutcome::Completed) => self.is_stopped(),
            Some(_) => self.is_stopped() && self.aftermath_cycles == 0,
        }
    }

    /// Outcome, once the robot is stopped.
    #[must_use]
    pub fn outcome(&self) -> Option<&RunOutcome> {
        self.outcome.as_ref()
    }

    /// Ends the run and returns its outcome; a run that was not stopped yet is interrupted.
    #[must_use]
    pub fn finish(mut self) -> RunOutcome {
        self.end()
    }

    /// Ends the run as [`finish`](Self::finish) does, and drops its sink, for an owner that cannot part with it.
    pub fn end(&mut self) -> RunOutcome {
        if let Some((time_s, row)) = self.timing.take() {
            self.sink.row(TIMING, time_s, &row);
        }
        self.sink = Box::new(());
        let time_s = self.time_s();
        self.outcome.get_or_insert(RunOutcome::Interrupted { time_s }).clone()
    }

    /// Time since the start of control, s.
    fn time_s(&self) -> f64 {
        self.control.measurement().time_s
    }

    fn end_faulted(&mut self) {
        if let Some(fault) = self.control.result().fault.cloned() {
            self.outcome = Some(RunOutcome::Faulted { fault, time_s: self.time_s() });
        }
    }

    /// Returns the command of this cycle and counts it.
    fn outgoing(&mut self) -> Option<Command<'_>> {
        if self.control.result().command.is_some() {
            self.history.push(self.control.torque_desired());
        }
        self.control.result().command
    }

    /// Records the row of a cycle; it begins with the run's own signals.
    fn record(&mut self, own: [f64; 2]) {
        let mut out = SignalRecorder::sampling(&mut self.row);
        record_tick(&self.control, &self.targets, own, &mut out);
        self.sink.row(TICK, self.control.clock_s(), &self.row);
        self.recorded = true;
    }
}

fn is_set(request: Option<&Request<'_>>) -> bool {
    request.is_some_and(|request| (**request).borrow().load(Ordering::Relaxed))
}

fn flag(value: bool) -> f64 {
    f64::from(u8::from(value))
}

/// Writes the row of a cycle: the run's own signals, then the loop's row, then its targets.
fn record_tick(control: &ControlLoop, targets: &Targets, own: [f64; 2], out: &mut SignalRecorder<'_>) {
    let [stop_requested, device_failed] = own;
    out.scalar(STOP_REQUESTED, "1", stop_requested);
    out.scalar(DEVICE_FAILED, "1", device_failed);
    out.block(&control.layout().signals, control.row());
    out.block(&targets.layout().signals, targets.row());
}

fn tick_layout(control: &ControlLoop) -> Layout {
    let record = |out: &mut SignalRecorder<'_>| record_tick(control, &control.targets(), [0.0; 2], out);
    Layout { channel: control.layout().channel.clone(), signals: SignalRecorder::describe(record) }
}

fn timing_layout() -> Layout {
    let signals = [TICK_TIME, SAMPLE_INTERVAL, RESPONSE_TIME].map(|name| Signal::scalar(name, "ns"));
    Layout { channel: TIMING_CHANNEL.to_owned(), signals: signals.into() }
}

/// Writes the row of a servo tick: the desired torque, then the signals of the simulation.
fn record_servo(
    control: &ControlLoop,
    signals: &[Signal],
    torque_desired: &[f64],
    row: &[f64],
    out: &mut SignalRecorder<'_>,
) {
    let joints = &control.capabilities().joints;
    out.signal(TORQUE_DESIRED, &control.units().torque, joints, torque_desired);
    out.block(signals, row);
}

/// Desired torques of the last commands, for the servo rows.
struct History {
    commands: u64,
    torques: Vec<Vec<f64>>,
    none: Vec<f64>,
}

impl History {
    /// A command acts after the longest delay and less than a cycle of jitter, and until the next one does.
    const DEPTH: usize = MAX_DELAY_CYCLES as usize + 3;

    fn new(n: usize) -> Self {
        let none = vec![f64::NAN; n];
        Self { commands: 0, torques: vec![none.clone(); Self::DEPTH], none }
    }

    fn push(&mut self, torque: &[f64]) {
        self.commands += 1;
        self.torques[Self::slot(self.commands)].copy_from_slice(torque);
    }

    /// Desired torque of the command with that number; NaN for `None`, and for an older one than the last [`DEPTH`](Self::DEPTH).
    fn get(&self, command: Option<u64>) -> &[f64] {
        let kept = command.filter(|number| number + Self::DEPTH as u64 > self.commands);
        kept.map_or(&self.none, |number| &self.torques[Self::slot(number)])
    }

    fn slot(command: u64) -> usize {
        usize::try_from(command % Self::DEPTH as u64).unwrap_or(0)
    }
}

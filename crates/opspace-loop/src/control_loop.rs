//! The way of one tick: read, observe, control, compensate, command, record.
//!
//! Nothing here allocates, locks or formats after the start; what a tick did goes to a [`Sink`] as one row
//! of numbers.
//!
//! Cycles in which no sample came are told from the robot's clock. A few are bridged: time goes on, and so do
//! references. After more the robot is held until it stands still; then estimates begin anew, references join their paths
//! from where the robot is, and torques come in as at the start.

use crate::backend::{Backend, Command};
use crate::fault::Fault;
use crate::robot::Trace;
use crate::safety::SafetyParameters;
use crate::supervisor::Continuity;
use nalgebra::DVector;
use opspace_backend::GravityBy;
use opspace_backend::{CommandKind, Layout, Row, Signal};
use opspace_backend::{SERVO, Sink, TICK, TRUTH};
use opspace_control::{ControlInput, Controller, Measurement, Targets};
use opspace_model::{Data, Model};
use opspace_transformer::friction::FrictionCompensation;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// How long the loop goes on recording after a stop, s.
const AFTERMATH_S: f64 = 0.2;

/// What a tick belongs to: the `phase` signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// The robot holds itself; sensors are tared.
    Rest,
    /// The controller commands.
    Control,
    /// After a stop: the robot is in its safe state.
    Stopped,
    /// After a dropout: the robot is held until it stands still.
    Held,
    /// The controller commands again, its torques coming in.
    Resuming,
}

impl Phase {
    /// Its number in a log.
    #[must_use]
    pub fn code(self) -> f64 {
        match self {
            Self::Rest => 0.0,
            Self::Control => 1.0,
            Self::Stopped => 2.0,
            Self::Held => 3.0,
            Self::Resuming => 4.0,
        }
    }
}

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Ending {
    /// It lasted as long as it was to last.
    Completed,
    /// It was stopped by a fault.
    Faulted {
        /// The cause.
        fault: Fault,
        /// When, s from the controller's start.
        time_s: f64,
    },
    /// It was asked to stop.
    Interrupted {
        /// When, s from the controller's start.
        time_s: f64,
    },
}

/// A controller on a robot.
pub struct ControlLoop<'a> {
    model: &'a Model,
    data: Data,
    backend: &'a mut dyn Backend,
    controller: &'a mut dyn Controller,
    friction: FrictionCompensation,
    /// Friction compensation of this cycle, Nm or N (n).
    feedforward_torque: DVector<f64>,
    targets: Targets,
    torque_limits: DVector<f64>,
    safety: SafetyParameters,
    command: DVector<f64>,
    torque_desired: DVector<f64>,
    saturated: DVector<f64>,
    history: History,
    row: Vec<f64>,
    servo_row: Vec<f64>,
    phase: Phase,
    /// When torques began to come in, s.
    ramp_from_s: f64,
    standstill: Standstill,
    fault: Option<Fault>,
}

/// Whether a robot that is held stands still: whether it has hardly moved for a while.
struct Standstill {
    held_from_s: f64,
    /// Where it was (n), and when, s.
    q: DVector<f64>,
    from_s: f64,
}

impl Standstill {
    /// How long it must not move, s.
    const LASTS_S: f64 = 0.05;
    /// What is no movement, rad (m): a mean speed of 0.02 rad/s, some ten counts of a coarse encoder.
    const MOVES: f64 = 1e-3;

    fn begin(&mut self, measurement: &Measurement) {
        self.held_from_s = measurement.time_s;
        self.look_again(measurement);
    }

    fn look_again(&mut self, measurement: &Measurement) {
        self.q.copy_from(&measurement.q);
        self.from_s = measurement.time_s;
    }

    /// The joint that moves most, if any does.
    fn moving(&self, measurement: &Measurement) -> Option<usize> {
        let moved = |joint: &usize| (measurement.q[*joint] - self.q[*joint]).abs();
        let joint = (0..self.q.len()).max_by(|a, b| moved(a).total_cmp(&moved(b)))?;
        (moved(&joint) > Self::MOVES).then_some(joint)
    }
}

/// The desired torques of the last commands, by which the drives' rows are told what was asked of them
/// when: a command may act up to one interface period after it was given.
struct History {
    commands: u64,
    torques: [DVector<f64>; History::DEPTH],
}

impl History {
    const DEPTH: usize = 4;

    fn new(n: usize) -> Self {
        Self { commands: 0, torques: std::array::from_fn(|_| DVector::from_element(n, f64::NAN)) }
    }

    fn push(&mut self, torque: &DVector<f64>) {
        self.commands += 1;
        let slot = self.slot(self.commands);
        self.torques[slot].copy_from(torque);
    }

    fn get(&self, command: u64) -> &DVector<f64> {
        &self.torques[self.slot(command)]
    }

    fn slot(&self, command: u64) -> usize {
        usize::try_from(command % History::DEPTH as u64).unwrap_or(0)
    }
}

impl<'a> ControlLoop<'a> {
    /// A loop about to start. `torque_limits` (n; Nm, N) bound what is asked of the motors.
    #[must_use]
    pub fn new(
        model: &'a Model,
        backend: &'a mut dyn Backend,
        controller: &'a mut dyn Controller,
        friction: FrictionCompensation,
        torque_limits: &[f64],
        safety: SafetyParameters,
    ) -> Self {
        let n = model.n();
        let nan = DVector::from_element(n, f64::NAN);
        let mut new = Self {
            model,
            data: Data::new(model),
            backend,
            controller,
            friction,
            feedforward_torque: DVector::zeros(n),
            targets: Targets::none(),
            torque_limits: DVector::from_column_slice(torque_limits),
            safety,
            command: nan.clone(),
            torque_desired: nan,
            saturated: DVector::zeros(n),
            history: History::new(n),
            row: Vec::new(),
            servo_row: Vec::new(),
            phase: Phase::Rest,
            ramp_from_s: 0.0,
            standstill: Standstill { held_from_s: 0.0, q: DVector::zeros(n), from_s: 0.0 },
            fault: None,
        };
        let layouts = new.layouts();
        new.row = vec![0.0; layouts[TICK].width()];
        new.servo_row = vec![0.0; layouts.get(SERVO).map_or(0, Layout::width)];
        new
    }

    /// The channels that [`run`](Self::run) fills, by channel number: [`TICK`], and [`TRUTH`] and [`SERVO`]
    /// where the robot knows them.
    #[must_use]
    pub fn layouts(&self) -> Vec<Layout> {
        let joints: Vec<String> = self.model.joints().iter().map(|j| j.name.clone()).collect();
        let mut signals = vec![
            Signal::scalar("phase", "1"),
            Signal::scalar("fault", "1"),
            Signal::scalar("tick_time", "ns"),
        ];
        signals.extend(self.backend.sensing().signals(&joints));
        let command_unit = match self.controller.command_kind() {
            CommandKind::Torque => "Nm",
            CommandKind::Position => "rad",
        };
        signals.push(Signal::new("command", command_unit, &joints));
        signals.push(Signal::new("torque_desired", "Nm", &joints));
        signals.push(Signal::new("torque_saturated", "1", &joints));
        signals.extend(self.backend.signals());
        signals.extend(self.controller.signals());
        let mut layouts = vec![Layout { channel: "tick".to_owned(), signals }];
        if let Some(traces) = self.backend.traces() {
            let mut servo = traces.servo;
            servo.signals.insert(0, Signal::new("torque_desired", "Nm", &joints));
            layouts.push(traces.truth);
            layouts.push(servo);
        }
        layouts
    }

    /// Runs from rest for `duration_s` of control, or until a fault, or until `interrupt` is set. Whatever
    /// happens, the robot is left in its safe state and every tick is in the sink.
    pub fn run(&mut self, duration_s: f64, interrupt: &AtomicBool, sink: &mut dyn Sink) -> Ending {
        let period_s = self.backend.facts().period_s;
        let periods = |seconds: f64| (seconds / period_s).round() as u64;
        let ending = self
            .rest(periods(self.safety.tare_s.get()), interrupt, sink)
            .and_then(|()| self.control(periods(duration_s), interrupt, sink))
            .map_or_else(|ending| ending, |()| Ending::Completed);
        self.backend.stop(&self.data);
        self.phase = Phase::Stopped;
        self.torque_desired.fill(f64::NAN);
        self.command.fill(f64::NAN);
        self.history.push(&self.torque_desired);
        if ending != Ending::Completed {
            self.aftermath(periods(AFTERMATH_S), sink);
        }
        ending
    }

    /// The robot holds itself while its sensors are tared.
    fn rest(&mut self, periods: u64, interrupt: &AtomicBool, sink: &mut dyn Sink) -> Result<(), Ending> {
        let mut passed = 0;
        while passed < periods {
            let observed = self.observe(sink);
            passed = passed.saturating_add(self.periods());
            self.backend.sensing_mut().tare();
            self.finish_tick(observed, interrupt, sink)?;
        }
        Ok(())
    }

    fn control(&mut self, periods: u64, interrupt: &AtomicBool, sink: &mut dyn Sink) -> Result<(), Ending> {
        self.phase = Phase::Control;
        let mut passed = 0;
        while passed < periods {
            let commanded = self.observe(sink).and_then(|began| {
                if passed == 0 {
                    self.start();
                }
                self.act().map(|()| began)
            });
            passed = passed.saturating_add(self.periods());
            self.finish_tick(commanded, interrupt, sink)?;
        }
        Ok(())
    }

    /// How many interface periods the present sample came after the last, the first one included.
    fn periods(&self) -> u64 {
        self.backend.sensing().continuity().missed().saturating_add(1)
    }

    /// Commands, unless the robot must be held.
    fn act(&mut self) -> Result<(), Fault> {
        let measurement = self.backend.sensing().measurement();
        if let Continuity::Broken { .. } = self.backend.sensing().continuity() {
            self.phase = Phase::Held;
            self.standstill.begin(measurement);
        }
        if self.phase == Phase::Held {
            if !self.stands_still()? {
                return self.hold();
            }
            self.resume();
        }
        let since_s = self.backend.sensing().measurement().time_s - self.ramp_from_s;
        if self.phase == Phase::Resuming && since_s >= self.safety.torque_ramp_s.get() {
            self.phase = Phase::Control;
        }
        self.command()
    }

    /// Whether the robot that is held has stood still for long enough.
    fn stands_still(&mut self) -> Result<bool, Fault> {
        let measurement = self.backend.sensing().measurement();
        let period_s = self.backend.facts().period_s;
        // Half a period: times are multiples of one, rounded.
        let looked_s = measurement.time_s - self.standstill.from_s + 0.5 * period_s;
        if looked_s < Standstill::LASTS_S.max(2.0 * period_s) {
            return Ok(false);
        }
        let Some(joint) = self.standstill.moving(measurement) else {
            return Ok(true);
        };
        let held_s = measurement.time_s - self.standstill.held_from_s;
        if held_s > self.safety.longest_dropout_s.get() {
            return Err(Fault::NotHeld { joint, held_s });
        }
        self.standstill.look_again(measurement);
        Ok(false)
    }

    /// Leaves the robot as it is, without a command of the controller's.
    fn hold(&mut self) -> Result<(), Fault> {
        self.with_input(|controller, input, _| controller.observe_while_held(input));
        self.command.fill(f64::NAN);
        self.torque_desired.fill(f64::NAN);
        self.saturated.fill(0.0);
        self.backend.hold()?;
        self.history.push(&self.torque_desired);
        Ok(())
    }

    /// Lets the controller command again, from where the robot is held.
    fn resume(&mut self) {
        self.phase = Phase::Resuming;
        self.ramp_from_s = self.backend.sensing().measurement().time_s;
        self.with_input(|controller, input, _| controller.resume(input));
    }

    /// Reads on for a while, so that the log shows how the robot stopped.
    fn aftermath(&mut self, periods: u64, sink: &mut dyn Sink) {
        for _ in 0..periods {
            if self.backend.read().is_err() {
                return;
            }
            self.record_traces(sink);
            // The fault that stopped the run may last: the rows say what is still measured.
            let _ = self.backend.observe(self.model, &mut self.data);
            self.record_tick(f64::NAN, sink);
            sink.between_ticks();
        }
    }

    fn start(&mut self) {
        self.backend.sensing_mut().begin();
        self.with_input(|controller, input, _| controller.start(input));
    }

    /// Calls `use_input` with the controller, its input in this cycle and the command.
    fn with_input(&mut self, use_input: impl FnOnce(&mut dyn Controller, &ControlInput<'_>, &mut [f64])) {
        let sensing = self.backend.sensing();
        let input = ControlInput {
            model: self.model,
            data: &self.data,
            measurement: sensing.measurement(),
            feedforward_torque: self.feedforward_torque.as_slice(),
            targets: &self.targets,
            clock_s: sensing.clock_s(),
        };
        use_input(self.controller, &input, self.command.as_mut_slice());
    }

    /// Waits for the tick and brings measurement and `data` up to date; gives the instant when the
    /// computation began.
    fn observe(&mut self, sink: &mut dyn Sink) -> Result<Instant, Fault> {
        let read = self.backend.read();
        self.record_traces(sink);
        read?;
        let began = Instant::now();
        self.backend.observe(self.model, &mut self.data)?;
        Ok(began)
    }

    /// The controller's command, and what the robot is told.
    fn command(&mut self) -> Result<(), Fault> {
        if self.controller.command_kind() == CommandKind::Torque {
            let dq = &self.backend.sensing().measurement().dq;
            for (i, (torque, &dq)) in self.feedforward_torque.iter_mut().zip(dq).enumerate() {
                *torque = self.friction.torque(i, dq);
            }
        }
        self.with_input(|controller, input, command| controller.update(input, command));
        match self.controller.command_kind() {
            CommandKind::Torque => {
                self.shape_torque();
                self.backend.command(&self.data, Command::Torque(self.torque_desired.as_slice()))?;
            }
            CommandKind::Position => {
                self.backend.command(&self.data, Command::Position(self.command.as_slice()))?;
            }
        }
        self.history.push(&self.torque_desired);
        Ok(())
    }

    /// τ_s = clamp(τ_eff + n̂), equation (11) of the paper, with τ_eff coming in from holding still.
    fn shape_torque(&mut self) {
        let facts = self.backend.facts();
        let measurement = self.backend.sensing().measurement();
        let ramp_s = self.safety.torque_ramp_s.get();
        let since_s = measurement.time_s - self.ramp_from_s;
        let share = if since_s < ramp_s { since_s / ramp_s } else { 1.0 };
        for i in 0..self.command.len() {
            let holding = match facts.gravity_by {
                GravityBy::Controller => self.data.gravity[i],
                GravityBy::Robot => 0.0,
            };
            let ramped =
                if share < 1.0 { holding + share * (self.command[i] - holding) } else { self.command[i] };
            let torque = ramped + self.feedforward_torque[i];
            let limit = self.torque_limits[i];
            // NaN passes: the backend refuses it by name.
            self.torque_desired[i] = torque.clamp(-limit, limit);
            self.saturated[i] = f64::from(u8::from(torque.abs() > limit));
        }
    }

    /// Records the tick and says whether the run goes on.
    fn finish_tick(
        &mut self,
        result: Result<Instant, Fault>,
        interrupt: &AtomicBool,
        sink: &mut dyn Sink,
    ) -> Result<(), Ending> {
        let time_s = self.backend.sensing().measurement().time_s;
        let (nanoseconds, ending) = match result {
            Ok(began) => (began.elapsed().as_nanos() as f64, None),
            Err(fault) => {
                self.fault = Some(fault);
                (f64::NAN, Some(Ending::Faulted { fault, time_s }))
            }
        };
        self.record_tick(nanoseconds, sink);
        sink.between_ticks();
        match ending {
            Some(ending) => Err(ending),
            None if interrupt.load(Ordering::Relaxed) => Err(Ending::Interrupted { time_s }),
            None => Ok(()),
        }
    }

    fn record_tick(&mut self, nanoseconds: f64, sink: &mut dyn Sink) {
        let mut row = Row::new(&mut self.row);
        row.put_one(self.phase.code());
        row.put_one(self.fault.map_or(0.0, |f| f64::from(f.code())));
        row.put_one(nanoseconds);
        self.backend.sensing().sample_row(&mut row);
        row.put(self.command.as_slice());
        row.put(self.torque_desired.as_slice());
        row.put(self.saturated.as_slice());
        self.backend.sample(&mut row);
        self.controller.sample(&mut row);
        debug_assert_eq!(row.remaining(), 0, "signals and samples must agree");
        sink.row(TICK, self.backend.sensing().clock_s(), &self.row);
    }

    fn record_traces(&mut self, sink: &mut dyn Sink) {
        let (history, servo_row) = (&self.history, &mut self.servo_row);
        self.backend.visit_traces(&mut |trace| match trace {
            Trace::Truth { time_s, row } => sink.row(TRUTH, time_s, row),
            Trace::Servo { time_s, command, row } => {
                let mut full = Row::new(servo_row);
                full.put(history.get(command).as_slice());
                full.put(row);
                sink.row(SERVO, time_s, servo_row);
            }
        });
    }
}

//! Control cycle: computes a command from a sample.
//!
//! [`ControlLoop::step`] depends only on sample, targets and its own state. It uses no robot, thread, clock or sink,
//! and it does not allocate, lock or format.
//!
//! # Where limits act
//!
//! | | where | limits | signals |
//! |---|---|---|---|
//! | 1 | references | speed, acceleration and jerk of generated motion; age of streamed targets | `TASK.target_stale` |
//! | 2 | controller | joint position, speed, acceleration, torque, its rate; task speed | `limited`, `limits_solver` |
//! | 3 | loop | torque ramp; τ_s = clamp(τ_eff + n̂), equation (K11) | `phase`, `torque_saturated` |
//! | 4 | guard | distance of setpoints; following error; watchdogs of torque, power and oscillation | `setpoint_clamped`, `fault` |
//! | 5 | device | limits of the robot itself | `device_limited`, `fault` |
//!
//! The limits of row 2 have an order of priority; its torque limits include the friction compensation n̂ of row 3.
//!
//! # Stops
//!
//! The table in [`stops`] says what is sent at a stop, and what stops the robot.
//!
//! # Missed cycles
//!
//! Missed cycles are detected from the robot's clock. Up to `max_missed_cycles` of them are tolerated: time and
//! references continue. After more, the robot is held until it stands still. Then the estimates start anew, the
//! references are approached again from the robot's position, and torques ramp in as at the start.

pub mod stops;

use crate::collision_detector::Collision;
use crate::external_torque::ExternalTorque;
use crate::fault::Fault;
use crate::guard::Guard;
use crate::loop_config::{LoopConfig, LoopError};
use crate::phase::{Phase, Standstill};
use crate::reference_motion::ReferenceMotion;
use crate::state_estimator::StateEstimator;
use crate::watchdog::Watchdog;
use nalgebra::DVector;
use opspace_backend::signal_names::{COMMAND, FAULT, PHASE, TICK_CHANNEL, TORQUE_DESIRED, TORQUE_SATURATED};
use opspace_backend::{
    Capabilities, Command, CommandKind, GravityCompensation, Layout, Observable, Sample, SignalRecorder,
};
use opspace_control::{ControlInput, Controller, Measurement, Targets};
use opspace_model::{Data, JointUnits, Model};
use opspace_transformer::{FrictionCompensation, Transformer};

/// Result of a cycle.
#[derive(Clone, Copy, Debug)]
#[must_use]
#[non_exhaustive]
pub struct Step<'a> {
    /// Command for the robot; `None` at rest and after a stop.
    pub command: Option<Command<'a>>,
    /// Phase of the robot after the cycle.
    pub phase: Phase,
    /// Fault that caused a stop, if any.
    pub fault: Option<&'a Fault>,
    /// Number of interface cycles missed before this one.
    pub missed_cycles: u64,
    /// Number of interface cycles since the first cycle of control, including missed ones.
    pub control_cycles: u64,
}

/// Control loop: a controller with state estimation, friction compensation, transformer and supervision.
pub struct ControlLoop {
    state: State,
    capabilities: Capabilities,
    units: JointUnits,
    controller: Box<dyn Controller>,
    transformer: Box<dyn Transformer>,
    guard: Option<Guard>,
    friction: FrictionCompensation,
    external_torque: Option<ExternalTorque>,
    /// Motion that the references ask for.
    reference: ReferenceMotion,
    torque_limits: Vec<f64>,
    ramp_s: f64,
    rest_cycles: u64,
    passed_cycles: u64,
    phase: Phase,
    held: bool,
    /// Start of the torque ramp, s.
    ramp_from_s: f64,
    standstill: Standstill,
    fault: Option<Fault>,
    /// Duration of a stop so far, s.
    stopping_s: f64,
    /// Controller's command (n).
    command: DVector<f64>,
    torque_desired: DVector<f64>,
    saturated: DVector<f64>,
    outgoing: Outgoing,
    layout: Layout,
    row: Vec<f64>,
}

/// Inputs of a controller.
struct State {
    model: Model,
    data: Data,
    estimator: StateEstimator,
    /// Friction compensation n̂ (n; Nm, N).
    feedforward_torque: DVector<f64>,
    /// Intervals of the torques of the joints' damping (n; Nm, N); empty if there are none.
    damping_torque: Vec<[f64; 2]>,
}

impl State {
    fn input<'a>(&'a self, targets: &'a Targets) -> ControlInput<'a> {
        ControlInput {
            model: &self.model,
            data: &self.data,
            measurement: self.estimator.measurement(),
            feedforward_torque: self.feedforward_torque.as_slice(),
            damping_torque: &self.damping_torque,
            targets,
            clock_s: self.estimator.clock_s(),
        }
    }
}

/// Kind of command of the last cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outgoing {
    None,
    Hold,
    Torque,
    Setpoint,
}

impl ControlLoop {
    /// Returns a loop before its first cycle.
    ///
    /// # Errors
    /// If the parts are not compatible.
    pub fn new(config: LoopConfig) -> Result<Self, LoopError> {
        config.check()?;
        let external_torque = ExternalTorque::new(&config)?;
        let LoopConfig { model, capabilities, controller, transformer, safety, .. } = config;
        let (n, period_s) = (model.n(), capabilities.period_s);
        let nan = DVector::from_element(n, f64::NAN);
        let estimator = {
            let forces = config.estimated_forces.len();
            let sensors = config.sensors;
            StateEstimator::new(&model, &capabilities, &config.estimator, &safety, sensors, forces)?
        };
        let speeds: Vec<f64> = model.joints().iter().map(|joint| joint.limits.velocity).collect();
        let added_inertia = transformer.added_inertia();
        let watchdog =
            Watchdog::new(&safety.watchdog, &config.torque_limits, &speeds, added_inertia, period_s);
        let guard = Guard::new(
            capabilities.command,
            &model,
            &config.servo_gains,
            &config.torque_limits,
            &config.setpoint_limits,
            watchdog,
            period_s,
        );
        let mut new = Self {
            standstill: Standstill::new(n, period_s, safety.max_dropout_s.get()),
            ramp_s: safety.torque_ramp_s.get(),
            rest_cycles: (safety.tare_s.get() / period_s).round() as u64,
            passed_cycles: 0,
            phase: Phase::Rest,
            held: false,
            ramp_from_s: 0.0,
            fault: None,
            stopping_s: 0.0,
            row: Vec::new(),
            layout: Layout { channel: TICK_CHANNEL.to_owned(), signals: Vec::new() },
            units: model.joint_units(),
            state: State {
                data: Data::new(&model),
                estimator,
                feedforward_torque: DVector::zeros(n),
                damping_torque: vec![[0.0; 2]; if transformer.is_damped() { n } else { 0 }],
                model,
            },
            command: nan.clone(),
            torque_desired: nan,
            saturated: DVector::zeros(n),
            outgoing: Outgoing::None,
            torque_limits: config.torque_limits,
            reference: ReferenceMotion::new(config.friction.joints()),
            friction: config.friction,
            external_torque,
            capabilities,
            controller,
            transformer,
            guard,
        };
        new.layout.signals = new.signals();
        new.row = vec![0.0; new.layout.width()];
        Ok(new)
    }

    /// Computes one cycle with the targets of this cycle (see [`targets`](Self::targets)). Allocates nothing.
    pub fn step(&mut self, sample: &Sample, targets: &Targets) -> Step<'_> {
        self.outgoing = Outgoing::None;
        let result = match self.phase {
            // The fault that stopped the run may persist; the rows record what is still measured.
            Phase::Stopped => self.observe(sample).or(Ok(())),
            Phase::Stopping => {
                let _ = self.observe(sample);
                self.come_to_rest();
                Ok(())
            }
            Phase::Rest if self.passed_cycles < self.rest_cycles => self.rest(sample),
            _ => self.control(sample, targets),
        };
        match result {
            Ok(()) => {
                self.fill_row();
                self.result()
            }
            Err(fault) => self.stop_for(fault),
        }
    }

    /// Result of the last cycle.
    pub fn result(&self) -> Step<'_> {
        let setpoint = self.guard.as_ref().map_or(&[][..], Guard::setpoint);
        let command = match self.outgoing {
            Outgoing::None => None,
            Outgoing::Hold => Some(Command::Hold),
            Outgoing::Torque => Some(Command::Torque(self.torque_desired.as_slice())),
            Outgoing::Setpoint => Some(Command::new(self.capabilities.command, setpoint)),
        };
        Step {
            command,
            phase: self.phase,
            fault: self.fault.as_ref(),
            missed_cycles: self.state.estimator.missed(),
            control_cycles: self.passed_cycles.saturating_sub(self.rest_cycles),
        }
    }

    /// Properties of the robot and its interface.
    #[must_use]
    pub fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    /// Model of the robot.
    #[must_use]
    pub fn model(&self) -> &Model {
        &self.state.model
    }

    /// Units of the joint quantities.
    pub(crate) fn units(&self) -> &JointUnits {
        &self.units
    }

    /// Returns targets for this loop's tasks, as configured.
    #[must_use]
    pub fn targets(&self) -> Targets {
        self.controller.targets()
    }

    /// Measurement of the last cycle.
    #[must_use]
    pub fn measurement(&self) -> &Measurement {
        self.state.estimator.measurement()
    }

    /// Time of the last sample on the robot's clock, s.
    #[must_use]
    pub fn clock_s(&self) -> f64 {
        self.state.estimator.clock_s()
    }

    /// Torques that the last command should produce (n; Nm, N); NaN if the controller commanded none.
    #[must_use]
    pub fn torque_desired(&self) -> &[f64] {
        self.torque_desired.as_slice()
    }

    /// Signals of [`row`](Self::row).
    #[must_use]
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Row of the last cycle: sample, measurement, command, tasks. It is filled before a stop is computed.
    #[must_use]
    pub fn row(&self) -> &[f64] {
        &self.row
    }

    /// Averages the force sensors' readings while the robot holds itself at rest.
    fn rest(&mut self, sample: &Sample) -> Result<(), Fault> {
        let observed = self.observe(sample);
        self.count_cycles();
        let State { model, data, estimator, .. } = &mut self.state;
        estimator.rest(model, data);
        observed
    }

    fn control(&mut self, sample: &Sample, targets: &Targets) -> Result<(), Fault> {
        let first = self.phase == Phase::Rest;
        if first {
            self.phase = Phase::Control;
            self.rest_cycles = self.passed_cycles;
        }
        let acted = self.observe(sample).and_then(|()| {
            if first {
                self.state.estimator.begin();
                self.controller.start(&self.state.input(targets));
            }
            self.act(targets)
        });
        self.count_cycles();
        acted
    }

    fn count_cycles(&mut self) {
        self.passed_cycles =
            self.passed_cycles.saturating_add(self.state.estimator.missed().saturating_add(1));
    }

    /// Updates measurement and model, and runs the watchdogs.
    fn observe(&mut self, sample: &Sample) -> Result<(), Fault> {
        let State { model, data, estimator, .. } = &mut self.state;
        estimator.observe(sample, model, data, &mut *self.transformer, self.held)?;
        match &mut self.guard {
            Some(guard) => guard.watch(estimator.measurement(), estimator.missed()),
            None => Ok(()),
        }
    }

    /// Computes the command, or a hold if the robot must be held.
    fn act(&mut self, targets: &Targets) -> Result<(), Fault> {
        let asked_to_hold = targets.is_held();
        if self.state.estimator.is_lost() || asked_to_hold {
            // The robot stands still after a hold: it does not go on retracting.
            collision_fault(self.external_torque.as_ref().and_then(ExternalTorque::retracts_from))?;
            self.phase = Phase::Held;
            self.standstill.begin(self.state.estimator.measurement());
        }
        if self.phase == Phase::Held {
            if asked_to_hold || !self.standstill.is_reached(self.state.estimator.measurement())? {
                return self.hold(targets);
            }
            self.phase = Phase::Resuming;
            self.ramp_from_s = self.measurement().time_s;
            self.controller.resume(&self.state.input(targets));
        }
        if self.phase == Phase::Resuming && self.ramp_passed_s() >= self.ramp_s {
            self.phase = Phase::Control;
        }
        self.command(targets)
    }

    fn ramp_passed_s(&self) -> f64 {
        self.measurement().time_s - self.ramp_from_s
    }

    /// Holds the robot, without a command of the controller.
    fn hold(&mut self, targets: &Targets) -> Result<(), Fault> {
        self.controller.observe_while_held(&self.state.input(targets));
        self.friction.reset();
        self.reference.end();
        if !self.held {
            // The transformer is not told what the drives do in a hold.
            self.transformer.reset();
        }
        if let Some(external) = &mut self.external_torque {
            external.reset(self.state.estimator.measurement_mut());
        }
        self.command.fill(f64::NAN);
        self.torque_desired.fill(f64::NAN);
        self.saturated.fill(0.0);
        self.held = true;
        if let Some(guard) = &mut self.guard {
            let estimator = &self.state.estimator;
            guard.check_following(estimator.measurement(), estimator.missed())?;
            guard.hold();
        }
        self.outgoing = Outgoing::Hold;
        Ok(())
    }

    fn command(&mut self, targets: &Targets) -> Result<(), Fault> {
        self.observe_external_torque()?;
        let kind = if self.is_reacting() { CommandKind::Torque } else { self.controller.command_kind() };
        if kind == CommandKind::Torque {
            self.compensate_friction();
            let State { data, damping_torque, .. } = &mut self.state;
            self.transformer.damping_torque(data.dq.as_slice(), damping_torque);
        }
        self.update_command(targets);
        if let Some(error) = self.controller.unsolved_limits() {
            return Err(Fault::UnsolvedLimits { error });
        }
        if let Some(stale) = self.controller.stale_target() {
            return Err(Fault::StaleTarget { task: stale.task, age_s: stale.age_s });
        }
        if kind == CommandKind::Torque {
            self.announce_reference(targets);
            self.shape_torque();
        }
        if kind != self.controller.command_kind() {
            // The signal has the unit of the controller's commands.
            self.command.fill(f64::NAN);
        }
        let estimator = &self.state.estimator;
        let (measurement, missed) = (estimator.measurement(), estimator.missed());
        let Some(guard) = &mut self.guard else {
            check_finite(self.torque_desired.as_slice())?;
            self.held = false;
            self.transformer.sent(&self.state.data, self.torque_desired.as_slice());
            self.outgoing = Outgoing::Torque;
            return Ok(());
        };
        guard.check_following(measurement, missed)?;
        guard.begin(measurement);
        if kind == CommandKind::Torque {
            let torque = self.torque_desired.as_slice();
            check_finite(torque)?;
            guard.expect_torque(torque);
            self.transformer.transform(&self.state.data, torque, guard.setpoint_mut());
            guard.keep_within_reach(measurement);
            guard.keep_within_limits(missed);
        } else {
            check_finite(self.command.as_slice())?;
            guard.take(self.command.as_slice(), measurement, missed)?;
            guard.keep_within_limits(missed);
        }
        guard.finish(missed);
        self.held = false;
        self.transformer.sent(&self.state.data, guard.setpoint());
        self.outgoing = Outgoing::Setpoint;
        Ok(())
    }

    /// Updates the observers of external torques. A collision is a fault once the run ends for it.
    fn observe_external_torque(&mut self) -> Result<(), Fault> {
        let State { model, data, estimator, .. } = &mut self.state;
        let Some(external) = &mut self.external_torque else { return Ok(()) };
        let missed = estimator.missed();
        let torque = &self.torque_desired;
        collision_fault(external.update(model, data, estimator.measurement_mut(), torque, missed))
    }

    /// True since a collision to which the robot reacts without its controller.
    fn is_reacting(&self) -> bool {
        self.external_torque.as_ref().is_some_and(ExternalTorque::is_reacting)
    }

    /// Computes the controller's command; after a collision, the torques of the reaction.
    fn update_command(&mut self, targets: &Targets) {
        let Some(external) = self.external_torque.as_mut().filter(|external| external.is_reacting()) else {
            self.controller.update(&self.state.input(targets), self.command.as_mut_slice());
            return;
        };
        external.reaction_torque(&self.state.data, &mut self.command);
        self.controller.observe_while_held(&self.state.input(targets));
        for i in 0..self.command.len() {
            self.command[i] += self.holding_torque(i);
        }
    }

    fn compensate_friction(&mut self) {
        let State { estimator, feedforward_torque, .. } = &mut self.state;
        let Measurement { q, dq, .. } = estimator.measurement();
        self.friction.advance(q.as_slice());
        for (i, (torque, &dq)) in feedforward_torque.iter_mut().zip(dq.iter()).enumerate() {
            *torque = self.friction.torque(i, dq);
        }
        if let Some(external) = &mut self.external_torque {
            external.compensate(feedforward_torque);
        }
    }

    /// Announces the motion of the references to the transformer, and to the friction compensation of the next cycle.
    fn announce_reference(&mut self, targets: &Targets) {
        let anticipates = self.transformer.uses_reference_motion();
        let reference = &mut self.reference;
        reference.begin();
        let velocity = reference.velocity.as_mut_slice();
        let is_known = match self.external_torque.as_ref().filter(|external| external.is_reacting()) {
            Some(external) => {
                external.reaction_velocity(velocity);
                true
            }
            None => {
                let is_used = self.friction.follows_reference() || anticipates;
                is_used && self.controller.reference_velocity(&self.state.input(targets), velocity)
            }
        };
        if is_known {
            let periods = self.state.estimator.missed().saturating_add(1);
            let commanded = if self.is_reacting() { None } else { self.controller.commanded_acceleration() };
            let share = self.ramped_share();
            self.reference.finish(periods as f64 * self.capabilities.period_s, commanded, share);
            self.friction.set_reference_velocity(self.reference.velocity.as_slice());
        } else {
            self.reference.end();
        }
        if anticipates {
            let ReferenceMotion { velocity, acceleration, .. } = &self.reference;
            self.transformer.set_reference_motion(velocity.as_slice(), acceleration.as_slice());
        }
    }

    /// Share of the command beyond the torques that hold the arm, while torques ramp in; 1 afterwards.
    fn ramped_share(&self) -> f64 {
        let passed_s = self.ramp_passed_s();
        if passed_s < self.ramp_s { passed_s / self.ramp_s } else { 1.0 }
    }

    /// Computes τ_s = clamp(τ_eff + n̂), equation (K11); τ_eff ramps in from the torques that hold the arm.
    fn shape_torque(&mut self) {
        let share = self.ramped_share();
        for i in 0..self.command.len() {
            let holding = self.holding_torque(i);
            let ramped =
                if share < 1.0 { holding + share * (self.command[i] - holding) } else { self.command[i] };
            let torque = ramped + self.state.feedforward_torque[i];
            let limit = self.torque_limits[i];
            // NaN passes the clamp and is reported as a fault later.
            self.torque_desired[i] = torque.clamp(-limit, limit);
            self.saturated[i] = f64::from(u8::from(torque.abs() > limit));
        }
    }

    /// Torque that holds a joint at rest, Nm or N.
    fn holding_torque(&self, joint: usize) -> f64 {
        match self.capabilities.gravity_compensated_by {
            GravityCompensation::Controller => self.state.data.gravity[joint],
            GravityCompensation::Robot => 0.0,
        }
    }

    fn fill_row(&mut self) {
        let mut row = std::mem::take(&mut self.row);
        self.sample(&mut row);
        self.row = row;
    }
}

impl Observable for ControlLoop {
    fn record(&self, out: &mut SignalRecorder<'_>) {
        let (joints, units) = (&self.capabilities.joints, &self.units);
        let command_units = match self.controller.command_kind() {
            CommandKind::Torque => &units.torque,
            CommandKind::Velocity => &units.velocity,
            CommandKind::Position => &units.position,
        };
        out.scalar(PHASE, "1", self.phase.code());
        out.scalar(FAULT, "1", self.fault.as_ref().map_or(0.0, |fault| f64::from(fault.code())));
        self.state.estimator.record(out);
        out.signal(COMMAND, command_units, joints, self.command.as_slice());
        out.signal(TORQUE_DESIRED, &units.torque, joints, self.torque_desired.as_slice());
        out.signal(TORQUE_SATURATED, "1", joints, self.saturated.as_slice());
        if let Some(external) = &self.external_torque {
            external.record(out);
        }
        if let Some(guard) = &self.guard {
            guard.record(out);
        }
        self.controller.record(out);
    }
}

/// Checks that all commands are finite.
fn check_finite(command: &[f64]) -> Result<(), Fault> {
    match command.iter().position(|value| !value.is_finite()) {
        Some(joint) => Err(Fault::CommandNotFinite { joint }),
        None => Ok(()),
    }
}

/// Returns the collision, if there is one, as a fault.
fn collision_fault(collision: Option<Collision>) -> Result<(), Fault> {
    match collision {
        Some(Collision { joint, torque, threshold }) => Err(Fault::Collision { joint, torque, threshold }),
        None => Ok(()),
    }
}

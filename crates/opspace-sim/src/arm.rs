//! The simulated arm behind its interface: drives at servo rate, everything else at the interface rate.
//!
//! At interface tick k the encoders are read; the command written then acts from `delay` servo ticks later
//! until the next one does. Between two interface ticks nothing is seen of the arm but by its own drives, nor at ticks
//! whose cycle the [bus](crate::bus) loses.

use crate::bus::Bus;
use crate::error::SimulationError;
use crate::force_sensor::SimulatedForceSensor;
use crate::friction::LuGre;
use crate::motor::Motor;
use crate::plant::{Plant, PlantParts};
use crate::random::{Stream, generator};
use crate::setup::{Setup, Timing};
use nalgebra::DVector;
use opspace_backend::{CommandKind, Layout, Signal};
use opspace_backend::{Sample, Setpoints};
use opspace_loop::{Facts, Fault, PositionRobot, Robot, TorqueRobot, Trace, Traces};
use opspace_model::{Data, FrameId, Model, gravity, kinematics};
use opspace_transformer::{JointParameters, ServoLaw, ServoMemory};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// An arm with a servo, or with torque drives, that can be read and commanded once every interface period.
pub struct SimulatedArm {
    facts: Facts,
    plant: Plant,
    timing: Timing,
    bus: Bus,
    encoders: Vec<Option<f64>>,
    torque_limits: Option<DVector<f64>>,
    servos: Vec<Servo>,
    active: Active,
    pending: [Pending; 2],
    commands: u64,
    braked: bool,
    sensors: Vec<(FrameId, SimulatedForceSensor)>,
    torque_noise: (f64, ChaCha8Rng),
    position: DVector<f64>,
    asked: DVector<f64>,
    interval_torque: DVector<f64>,
    log: TraceLog,
}

/// A joint's drive and what it remembers.
#[derive(Clone, Debug)]
struct Servo {
    law: ServoLaw,
    memory: ServoMemory,
}

/// What is in force: set-points (rad, m), or torques of a torque robot.
#[derive(Clone, Debug)]
struct Active {
    command: u64,
    values: DVector<f64>,
    /// Where interpolated set-points come from.
    before: DVector<f64>,
    /// Servo ticks since it came in force.
    age: u32,
    set_points: Setpoints,
}

impl Active {
    fn take(&mut self, command: u64, values: &DVector<f64>, ratio: u32) {
        // A second one at the same tick goes from where the first would have gone from.
        if let Some(age) = self.age.checked_sub(1) {
            self.age = age;
            for i in 0..values.len() {
                self.before[i] = self.set_point(i, ratio);
            }
        }
        self.values.copy_from(values);
        self.command = command;
        self.age = 0;
    }

    /// The set-point of a joint at this servo tick.
    fn set_point(&self, joint: usize, ratio: u32) -> f64 {
        self.set_points.at(self.before[joint], self.values[joint], self.age, ratio)
    }
}

/// A command on its way to the drives.
#[derive(Clone, Debug)]
struct Pending {
    acts_at: Option<u64>,
    number: u64,
    values: DVector<f64>,
}

/// What the interface periods since the last sample left behind.
struct TraceLog {
    joints: Vec<String>,
    contacts: Vec<String>,
    truth: Vec<f64>,
    truth_width: usize,
    servo: Vec<f64>,
    servo_commands: Vec<u64>,
}

impl SimulatedArm {
    /// Puts the arm together, at rest at its start, holding itself: a position robot by its servo, a torque
    /// robot by its brakes.
    ///
    /// # Errors
    /// Parameters that contradict each other, named by their key.
    pub fn new(setup: Setup) -> Result<Self, SimulationError> {
        let Setup { simulated, profile, .. } = &setup;
        let n = setup.model.n();
        setup.check()?;
        let timing = setup.timing()?;
        let dt = 1.0 / simulated.physics_hz.get();
        let start = DVector::from_column_slice(&setup.start);
        let model = setup.true_model();
        let holding = holding_torque(&model, &setup.start);

        let limit = |j: &JointParameters| j.torque_limit_nm.get();
        let scale = &simulated.scale;
        let motor_start = match setup.facts.command {
            CommandKind::Position => holding.clone(),
            CommandKind::Torque => DVector::zeros(n),
        };
        let current_loop = simulated.current_loop_hz.map(|hz| hz.get());
        let contacts = setup.contacts(&model);
        let plant = Plant::new(PlantParts {
            friction: (setup.true_friction().into_iter())
                .map(|friction| LuGre::new(friction, &simulated.bristle, scale.friction.get()))
                .collect(),
            motors: motor_start.iter().map(|&torque| Motor::new(current_loop, dt, torque)).collect(),
            end_stop: simulated.end_stop.clone(),
            brake: simulated.brake.clone(),
            brake_torque: DVector::from_iterator(
                n,
                setup.joints.iter().map(|j| limit(j) * simulated.brake.slips_at_torque_limits.get()),
            ),
            contacts,
            q: start.clone(),
            model,
        });
        let encoders: Vec<Option<f64>> = (setup.joints.iter())
            .map(|j| simulated.encoder_quantisation.then(|| j.rotor.resolution_rad()))
            .collect();
        let position = DVector::from_fn(n, |i, _| encode(start[i], encoders[i]));
        let mut active = Active {
            command: 0,
            values: DVector::zeros(n),
            before: DVector::zeros(n),
            age: profile.ratio.get(),
            set_points: setup.facts.set_points,
        };
        let mut servos = Vec::new();
        for (joint, law) in setup.true_servos(timing.servo_period_s)?.into_iter().enumerate() {
            let (memory, set_point) = law.rest(position[joint], holding[joint]);
            if setup.facts.command == CommandKind::Position {
                active.values[joint] = set_point;
            }
            servos.push(Servo { law, memory });
        }
        let sensors = setup.simulated_sensors(timing.servo_period_s);
        let pending = Pending { acts_at: None, number: 0, values: DVector::zeros(n) };
        let mut arm = Self {
            facts: setup.facts.clone(),
            timing,
            bus: Bus::new(&simulated.bus, setup.seed),
            torque_limits: simulated
                .torque_saturation
                .then(|| DVector::from_iterator(n, setup.joints.iter().map(limit))),
            encoders,
            servos,
            active,
            pending: [pending.clone(), pending],
            commands: 0,
            braked: false,
            sensors,
            torque_noise: (simulated.torque_noise_nm.get(), generator(setup.seed, Stream::MotorTorque)),
            position,
            asked: DVector::zeros(n),
            interval_torque: motor_start,
            log: TraceLog::new(&setup),
            plant,
        };
        if setup.facts.command == CommandKind::Torque {
            arm.brake();
        }
        Ok(arm)
    }

    /// State and physics.
    #[must_use]
    pub fn plant(&self) -> &Plant {
        &self.plant
    }

    /// One interface period: `ratio` servo ticks and the physics between them.
    fn advance(&mut self) {
        for _ in 0..self.timing.ratio {
            self.take_pending();
            self.servo_tick();
            self.run_physics();
            self.timing.servo_tick += 1;
        }
    }

    fn take_pending(&mut self) {
        for pending in &mut self.pending {
            if pending.acts_at.is_some_and(|tick| tick <= self.timing.servo_tick) {
                pending.acts_at = None;
                self.active.take(pending.number, &pending.values, self.timing.ratio);
                if self.facts.command == CommandKind::Torque && !self.braked {
                    self.plant.release();
                }
            }
        }
    }

    /// The drives read their encoders and ask their motors.
    fn servo_tick(&mut self) {
        self.read_encoders();
        for (i, servo) in self.servos.iter_mut().enumerate() {
            let torque = match self.facts.command {
                CommandKind::Position => {
                    let set_point = self.active.set_point(i, self.timing.ratio);
                    servo.law.step(&mut servo.memory, set_point, self.position[i])
                }
                CommandKind::Torque => self.active.values[i],
            };
            self.asked[i] = match &self.torque_limits {
                Some(limits) => torque.clamp(-limits[i], limits[i]),
                None => torque,
            };
        }
        self.active.age = self.active.age.saturating_add(1);
    }

    fn run_physics(&mut self) {
        let steps = self.timing.physics_per_servo;
        let dt = self.timing.servo_period_s / f64::from(steps);
        let begin_s = self.timing.time_s(self.timing.servo_tick);
        let slot = self.log.servo_slot(self.active.command);
        for step in 0..steps {
            self.plant.step(begin_s + f64::from(step) * dt, dt, self.asked.as_slice());
            for (sum, torque) in slot.iter_mut().zip(self.plant.motor_torque()) {
                *sum += torque / f64::from(steps);
            }
        }
        for (frame, sensor) in &mut self.sensors {
            sensor.follow(&self.plant.contact_wrench(*frame));
        }
    }

    fn read_encoders(&mut self) {
        for (i, y) in self.position.iter_mut().enumerate() {
            *y = encode(self.plant.q()[i], self.encoders[i]);
        }
    }

    /// The motors' mean torque since the last sample; what they gave at rest at the first.
    fn average_torque(&mut self) {
        let rows = self.log.servo_commands.len();
        if rows == 0 {
            return;
        }
        self.interval_torque.fill(0.0);
        for row in self.log.servo.chunks_exact(self.interval_torque.len()) {
            self.interval_torque.iter_mut().zip(row).for_each(|(sum, torque)| *sum += torque);
        }
        self.interval_torque /= rows as f64;
    }

    fn measure(&mut self, sample: &mut Sample) {
        self.read_encoders();
        sample.time_s = self.timing.time_s(self.timing.servo_tick);
        sample.q.copy_from_slice(self.position.as_slice());
        self.average_torque();
        let (noise, random) = &mut self.torque_noise;
        if let Some(measured) = &mut sample.motor_torque {
            for (to, torque) in measured.iter_mut().zip(&self.interval_torque) {
                let white: f64 = StandardNormal.sample(random);
                *to = torque + *noise * white;
            }
        }
        for (to, (_, sensor)) in sample.wrenches.iter_mut().zip(&mut self.sensors) {
            let wrench = sensor.read();
            to[..3].copy_from_slice(wrench.linear.as_slice());
            to[3..].copy_from_slice(wrench.angular.as_slice());
        }
    }

    /// Takes a command given at the present interface tick.
    fn accept(&mut self, values: &[f64]) {
        self.commands += 1;
        let acts_at = Some(self.timing.servo_tick + u64::from(self.timing.delay + self.bus.late()));
        // A second command at the same tick takes the place of the first; else one of the two is free.
        let same = self.pending.iter().position(|p| p.acts_at == acts_at);
        let free = self.pending.iter().position(|p| p.acts_at.is_none());
        let pending = &mut self.pending[same.or(free).unwrap_or(0)];
        pending.acts_at = acts_at;
        pending.number = self.commands;
        pending.values.copy_from_slice(values);
    }
}

impl Robot for SimulatedArm {
    fn facts(&self) -> &Facts {
        &self.facts
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), Fault> {
        self.log.clear();
        loop {
            if self.timing.started {
                self.advance();
            }
            self.timing.started = true;
            self.log.truth(&self.plant);
            let finite = self.plant.q().iter().chain(self.plant.dq().iter()).all(|v| v.is_finite());
            if !finite {
                return Err(Fault::Diverged);
            }
            if self.bus.passes(self.timing.time_s(self.timing.servo_tick)) {
                self.measure(sample);
                return Ok(());
            }
        }
    }

    fn traces(&self) -> Option<Traces> {
        Some(self.log.layouts())
    }

    fn visit_traces(&self, visit: &mut dyn FnMut(Trace<'_>)) {
        let (n, ratio) = (self.log.joints.len(), u64::from(self.timing.ratio));
        let rows = self.log.servo_commands.iter().zip(self.log.servo.chunks_exact(n));
        let mut rows = (self.timing.servo_tick - rows.len() as u64..).zip(rows);
        // Each period's rows of the drives, then the truth at its end.
        let truths = self.log.truth.chunks_exact(self.log.truth_width);
        let first = self.timing.servo_tick - (truths.len() as u64 - 1) * ratio;
        for (tick, truth) in (first..).step_by(self.timing.ratio as usize).zip(truths) {
            for (servo_tick, (&command, row)) in rows.by_ref().take(self.timing.ratio as usize) {
                visit(Trace::Servo { time_s: self.timing.time_s(servo_tick), command, row });
            }
            visit(Trace::Truth { time_s: self.timing.time_s(tick), row: truth });
        }
    }
}

impl PositionRobot for SimulatedArm {
    fn set_positions(&mut self, q_desired: &[f64]) -> Result<(), Fault> {
        if self.facts.command != CommandKind::Position {
            return Err(Fault::WrongCommand);
        }
        self.accept(q_desired);
        Ok(())
    }
}

impl TorqueRobot for SimulatedArm {
    fn set_torques(&mut self, tau: &[f64]) -> Result<(), Fault> {
        if self.facts.command != CommandKind::Torque {
            return Err(Fault::WrongCommand);
        }
        self.braked = false;
        self.accept(tau);
        Ok(())
    }

    fn brake(&mut self) {
        self.braked = true;
        self.plant.brake();
        self.pending.iter_mut().for_each(|p| p.acts_at = None);
        self.active.values.fill(0.0);
        if self.commands > 0 {
            self.commands += 1;
        }
        self.active.command = self.commands;
    }
}

impl TraceLog {
    fn new(setup: &Setup) -> Self {
        /// Cycles that may be lost in a row, beside dropouts, before room must be made for them.
        const LOST: usize = 64;
        let joints: Vec<String> = setup.model.joints().iter().map(|j| j.name.clone()).collect();
        let n = joints.len();
        let silent_s: f64 = setup.simulated.bus.dropouts.iter().map(|d| d.duration_s.get()).sum();
        let periods = (silent_s / setup.profile.period_s()).ceil() as usize + LOST;
        let rows = periods * setup.profile.ratio.get() as usize;
        let truth_width = 2 * n + 3 * setup.surroundings.len();
        Self {
            truth: Vec::with_capacity(periods * truth_width),
            truth_width,
            servo: Vec::with_capacity(rows * n),
            servo_commands: Vec::with_capacity(rows),
            contacts: setup.surroundings.iter().map(|(name, _)| name.clone()).collect(),
            joints,
        }
    }

    fn layouts(&self) -> Traces {
        let mut truth = vec![Signal::new("q", "rad", &self.joints), Signal::new("dq", "rad/s", &self.joints)];
        truth.extend(self.contacts.iter().map(|c| Signal::new(format!("{c}.force"), "N", &["x", "y", "z"])));
        let servo = vec![Signal::new("motor_torque", "Nm", &self.joints)];
        Traces {
            truth: Layout { channel: "truth".to_owned(), signals: truth },
            servo: Layout { channel: "servo".to_owned(), signals: servo },
        }
    }

    fn clear(&mut self) {
        self.servo_commands.clear();
        self.servo.clear();
        self.truth.clear();
    }

    /// Room for the motors' torques of the next servo period, all zero.
    fn servo_slot(&mut self, command: u64) -> &mut [f64] {
        let begin = self.servo.len();
        self.servo_commands.push(command);
        self.servo.resize(begin + self.joints.len(), 0.0);
        &mut self.servo[begin..]
    }

    /// The truth at the end of a period.
    fn truth(&mut self, plant: &Plant) {
        self.truth.extend_from_slice(plant.q().as_slice());
        self.truth.extend_from_slice(plant.dq().as_slice());
        plant.contacts().iter().for_each(|contact| self.truth.extend_from_slice(contact.force().as_slice()));
    }
}

/// A position as an encoder of this resolution gives it.
fn encode(q: f64, resolution: Option<f64>) -> f64 {
    match resolution {
        Some(step) => (q / step).round() * step,
        None => q,
    }
}

/// The torques that carry the arm at rest.
fn holding_torque(model: &Model, q: &[f64]) -> DVector<f64> {
    let mut data = Data::new(model);
    kinematics(model, &mut data, q, &vec![0.0; model.n()]);
    gravity(model, &mut data);
    data.gravity
}

//! Drives of one arm: convert commands to torques on the links.
//!
//! The table of the [crate] describes their behaviour without commands.

use crate::drivetrain::Drivetrain;
use nalgebra::DVector;
use opspace_backend::{CommandKind, Setpoints};
use opspace_transformer::{ServoLaw, ServoState, SetpointAverage};

/// Parts of one arm that run at servo rate or faster.
pub(crate) struct Drives {
    takes: CommandKind,
    has_brakes: bool,
    mode: Mode,
    drivetrains: Vec<Drivetrain>,
    servos: Vec<Servo>,
    torque_limits: Option<DVector<f64>>,
    ratio: u32,
    active: Active,
    pending: [Pending; 2],
    /// Number of the last command.
    commands: u64,
    /// Values of the last command with values (n).
    last: DVector<f64>,
    /// True if a command with values was received.
    commanded: bool,
    position: DVector<f64>,
    /// Positions that the interface reports (n; rad, m).
    reported: DVector<f64>,
    asked: DVector<f64>,
    limited: bool,
}

/// Source of the motor torques.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    /// No motor torque: brakes hold the arm.
    Braked,
    /// Servos.
    Servo,
    /// Commanded torques.
    Torque,
}

/// Servo of a joint, with its state.
#[derive(Clone, Debug)]
struct Servo {
    law: ServoLaw,
    memory: ServoState,
    average: SetpointAverage,
}

impl Servo {
    /// Returns a servo at rest at `position` (rad, m) with this torque (Nm, N), and its setpoint.
    fn at_rest(law: ServoLaw, position: f64, torque: f64) -> (Self, f64) {
        let mut servo = Self { law, memory: ServoState::default(), average: law.setpoint_average() };
        let setpoint = servo.rest(position, torque);
        (servo, setpoint)
    }

    /// Sets the servo to rest, and returns its setpoint.
    fn rest(&mut self, position: f64, torque: f64) -> f64 {
        let (memory, setpoint) = self.law.rest(position, torque);
        self.memory = memory;
        self.average.rest(setpoint);
        setpoint
    }
}

/// Command in effect.
#[derive(Clone, Debug)]
struct Active {
    /// Number of the command; `None` while the robot holds itself.
    command: Option<u64>,
    /// Setpoints, or commanded torques of a torque robot (n).
    values: DVector<f64>,
    /// Setpoints from which interpolation starts (n).
    before: DVector<f64>,
    /// Servo ticks since the command took effect.
    age: u32,
    setpoints: Setpoints,
}

impl Active {
    fn take(&mut self, command: u64, values: &DVector<f64>, ratio: u32) {
        // A second command at the same servo tick interpolates from the start of the first one.
        if let Some(age) = self.age.checked_sub(1) {
            self.age = age;
            for i in 0..values.len() {
                self.before[i] = self.setpoint(i, ratio);
            }
        }
        self.values.copy_from(values);
        self.command = Some(command);
        self.age = 0;
    }

    /// Replaces the command at once, without interpolation.
    fn replace(&mut self, command: Option<u64>, value: impl FnMut(usize) -> f64) {
        let mut value = value;
        self.values.iter_mut().enumerate().for_each(|(i, to)| *to = value(i));
        self.before.copy_from(&self.values);
        self.command = command;
    }

    /// Returns the setpoint of a joint at this servo tick.
    fn setpoint(&self, joint: usize, ratio: u32) -> f64 {
        self.setpoints.at(self.before[joint], self.values[joint], self.age, ratio)
    }
}

/// Command that has not taken effect yet.
#[derive(Clone, Debug)]
struct Pending {
    acts_at: Option<u64>,
    number: u64,
    values: DVector<f64>,
}

/// Parts of [`Drives`].
pub(crate) struct DrivesConfig {
    pub takes: CommandKind,
    pub has_brakes: bool,
    pub setpoints: Setpoints,
    /// Servo ticks per interface cycle.
    pub servo_ticks_per_cycle: u32,
    pub drivetrains: Vec<Drivetrain>,
    pub laws: Vec<ServoLaw>,
    pub torque_limits: Option<DVector<f64>>,
    /// Start positions (n; rad, m).
    pub q: Vec<f64>,
    /// Torques that hold the arm at the start (n; Nm, N).
    pub holding: DVector<f64>,
}

impl Drives {
    /// Returns drives that hold an arm at rest.
    pub fn new(config: DrivesConfig) -> Self {
        let DrivesConfig { takes, has_brakes, q, holding, .. } = config;
        let n = q.len();
        let position = DVector::from_fn(n, |i, _| config.drivetrains[i].read_encoder(q[i]));
        let rest = |(i, law): (usize, ServoLaw)| Servo::at_rest(law, position[i], holding[i]);
        let (servos, setpoints): (Vec<Servo>, Vec<f64>) =
            config.laws.into_iter().enumerate().map(rest).unzip();
        let braked = has_brakes && takes != CommandKind::Position;
        let values = match takes {
            CommandKind::Position => DVector::from_vec(setpoints),
            CommandKind::Torque if !braked => DVector::from_vec(setpoints),
            CommandKind::Torque | CommandKind::Velocity => DVector::zeros(n),
        };
        let pending = Pending { acts_at: None, number: 0, values: DVector::zeros(n) };
        let mut drives = Self {
            takes,
            has_brakes,
            mode: if braked { Mode::Braked } else { Mode::Servo },
            drivetrains: config.drivetrains,
            servos,
            torque_limits: config.torque_limits,
            ratio: config.servo_ticks_per_cycle,
            active: Active {
                command: None,
                values,
                before: DVector::zeros(n),
                age: config.servo_ticks_per_cycle,
                setpoints: config.setpoints,
            },
            pending: [pending.clone(), pending],
            commands: 0,
            last: DVector::zeros(n),
            commanded: false,
            position,
            reported: DVector::zeros(n),
            asked: DVector::zeros(n),
            limited: false,
        };
        if braked {
            drives.engage_brakes(&q);
        }
        drives
    }

    /// Accepts a command with values, which acts at the servo tick `acts_at`.
    pub fn command(&mut self, values: &[f64], acts_at: u64) {
        self.commands += 1;
        self.commanded = true;
        self.last.copy_from_slice(values);
        self.send(acts_at);
    }

    /// Accepts a hold command. Brakes, or the servos of a torque robot, hold the arm at once; other robots get a
    /// setpoint that acts at the servo tick `acts_at`. `q` is the true position (n; rad, m).
    pub fn hold(&mut self, q: &[f64], acts_at: u64) {
        self.commands += 1;
        if self.takes == CommandKind::Torque || self.has_brakes_in_use() {
            self.hold_itself(q, Some(self.commands));
        } else if self.commanded {
            if self.takes == CommandKind::Velocity {
                self.last.fill(0.0);
            }
            self.send(acts_at);
        }
    }

    /// Enters the safe state. `q` is the true position (n; rad, m).
    pub fn stop(&mut self, q: &[f64]) {
        if self.takes != CommandKind::Position {
            self.hold_itself(q, None);
        }
    }

    fn has_brakes_in_use(&self) -> bool {
        self.has_brakes && self.takes != CommandKind::Position
    }

    /// Holds the arm from now on; pending commands are dropped.
    fn hold_itself(&mut self, q: &[f64], command: Option<u64>) {
        self.pending.iter_mut().for_each(|pending| pending.acts_at = None);
        if self.has_brakes_in_use() {
            self.mode = Mode::Braked;
            self.active.replace(command, |_| 0.0);
            self.engage_brakes(q);
        } else if self.takes == CommandKind::Velocity {
            self.active.replace(command, |_| 0.0);
        } else if self.mode == Mode::Servo {
            self.active.command = command;
        } else {
            self.mode = Mode::Servo;
            let Self { servos, active, position, asked, .. } = self;
            active.replace(command, |i| servos[i].rest(position[i], asked[i]));
        }
    }

    fn engage_brakes(&mut self, q: &[f64]) {
        self.drivetrains.iter_mut().zip(q).for_each(|(joint, &q)| joint.engage_brake(q));
    }

    /// Queues the last values as a command that acts at `acts_at`.
    fn send(&mut self, acts_at: u64) {
        // The delay is at most one interface period and the jitter less than one, so at most two commands are pending.
        let free = self.pending.iter().position(|pending| pending.acts_at.is_none());
        let pending = &mut self.pending[free.unwrap_or(0)];
        pending.acts_at = Some(acts_at);
        pending.number = self.commands;
        pending.values.copy_from(&self.last);
    }

    /// Number of the command in effect; `None` while the robot holds itself without a command (servos or brakes).
    pub fn command_in_force(&self) -> Option<u64> {
        self.active.command
    }

    /// Runs a servo tick: pending commands take effect, the drives read their encoders at `q` (n; rad, m) and set the
    /// motors' inputs.
    pub fn servo_tick(&mut self, q: &[f64], servo_tick: u64) {
        self.read_encoders(q);
        self.take_pending(servo_tick);
        for (i, servo) in self.servos.iter_mut().enumerate() {
            let torque = match self.mode {
                Mode::Braked => 0.0,
                Mode::Torque => self.active.values[i],
                Mode::Servo => {
                    let setpoint = servo.average.step(self.active.setpoint(i, self.ratio));
                    servo.law.step(&mut servo.memory, setpoint, self.position[i])
                }
            };
            self.asked[i] = match &self.torque_limits {
                Some(limits) => torque.clamp(-limits[i], limits[i]),
                None => torque,
            };
            self.limited |= self.asked[i] != torque;
        }
        self.active.age = self.active.age.saturating_add(1);
    }

    fn take_pending(&mut self, servo_tick: u64) {
        for index in 0..self.pending.len() {
            let pending = &mut self.pending[index];
            if pending.acts_at.is_some_and(|tick| tick <= servo_tick) {
                pending.acts_at = None;
                self.active.take(pending.number, &pending.values, self.ratio);
                self.leave_hold();
            }
        }
    }

    /// Leaves the hold: releases the brakes and lets commands act.
    fn leave_hold(&mut self) {
        if self.mode == Mode::Braked {
            self.drivetrains.iter_mut().for_each(Drivetrain::release_brake);
            for (servo, &position) in self.servos.iter_mut().zip(&self.position) {
                servo.rest(position, 0.0);
            }
        }
        self.mode = match self.takes {
            CommandKind::Torque => Mode::Torque,
            CommandKind::Position | CommandKind::Velocity => Mode::Servo,
        };
    }

    /// Runs a physics step of `dt_s` (s) at the true `q` (n; rad, m) and `dq` (n; rad/s, m/s): writes the torques on
    /// the links (n; Nm, N).
    pub fn step(&mut self, q: &[f64], dq: &[f64], dt_s: f64, torques: &mut [f64]) {
        for (i, joint) in self.drivetrains.iter_mut().enumerate() {
            torques[i] = joint.step(q[i], dq[i], dt_s, self.asked[i]);
        }
    }

    /// Motor torques during the last physics step, Nm or N.
    pub fn motor_torques(&self) -> impl Iterator<Item = f64> {
        self.drivetrains.iter().map(Drivetrain::motor_torque)
    }

    /// Torques during the last physics step that the motor currents stand for, Nm or N.
    pub fn current_torques(&self) -> impl Iterator<Item = f64> {
        self.drivetrains.iter().map(Drivetrain::current_torque)
    }

    /// Torques on the links during the last physics step, Nm or N.
    pub fn joint_torques(&self) -> impl Iterator<Item = f64> {
        self.drivetrains.iter().map(Drivetrain::joint_torque)
    }

    fn read_encoders(&mut self, q: &[f64]) {
        for (to, (joint, &q)) in self.position.iter_mut().zip(self.drivetrains.iter().zip(q)) {
            *to = joint.read_encoder(q);
        }
    }

    /// Returns the positions that the interface reports (n; rad, m), with the links at `q` (n; rad, m).
    pub fn positions(&mut self, q: &[f64]) -> &[f64] {
        self.read_encoders(q);
        for (to, (joint, &q)) in self.reported.iter_mut().zip(self.drivetrains.iter().zip(q)) {
            *to = joint.read_interface_encoder(q);
        }
        self.reported.as_slice()
    }

    /// Writes the velocities that the interface reports (n; rad/s, m/s), with the links at velocities `dq` (n; rad/s,
    /// m/s).
    pub fn velocities(&self, dq: &[f64], reported: &mut [f64]) {
        for ((to, joint), &dq) in reported.iter_mut().zip(&self.drivetrains).zip(dq) {
            *to = joint.interface_velocity(dq);
        }
    }

    /// Returns true if a drive's torque limit was active since the last call.
    pub fn take_limited(&mut self) -> bool {
        std::mem::take(&mut self.limited)
    }
}

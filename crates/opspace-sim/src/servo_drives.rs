//! Drives of a robot that accepts positions or velocities: its servos follow setpoints at servo rate.
//!
//! The table of the [crate] describes their behaviour without commands.

use crate::command_queue::CommandQueue;
use crate::motors::Motors;
use crate::servo::JointServo;
use crate::setpoint_check::SetpointCheck;
use nalgebra::DVector;
use opspace_backend::{CommandKind, DeviceFault, Setpoints};
use opspace_transformer::ServoLaw;

/// Servos of one arm, with the setpoints in effect.
pub(crate) struct ServoDrives {
    takes: CommandKind,
    /// True if brakes hold the arm without commands: those of a velocity robot.
    has_brakes: bool,
    braked: bool,
    servos: Vec<JointServo>,
    /// Servo ticks per interface cycle.
    ratio: u32,
    active: Active,
    queue: CommandQueue,
    check: Option<SetpointCheck>,
    /// Steps of the setpoints (n; rad, m), 0 for exact ones; empty if all are exact.
    steps: Vec<f64>,
    /// Rounded setpoints (n).
    rounded: Vec<f64>,
}

/// Setpoints in effect.
#[derive(Clone, Debug)]
struct Active {
    /// Number of the command; `None` while the robot holds itself.
    command: Option<u64>,
    /// Setpoints (n).
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

    /// Replaces the command by setpoints of zero at once, without interpolation.
    fn replace_by_zero(&mut self, command: Option<u64>) {
        self.values.fill(0.0);
        self.before.copy_from(&self.values);
        self.command = command;
    }

    /// Returns the setpoint of a joint at this servo tick.
    fn setpoint(&self, joint: usize, ratio: u32) -> f64 {
        self.setpoints.at(self.before[joint], self.values[joint], self.age, ratio)
    }
}

/// Parts of [`ServoDrives`].
pub(crate) struct ServoDrivesConfig {
    /// Kind of the setpoints: positions or velocities.
    pub takes: CommandKind,
    pub has_brakes: bool,
    pub setpoints: Setpoints,
    /// Servo ticks per interface cycle.
    pub servo_ticks_per_cycle: u32,
    pub laws: Vec<ServoLaw>,
    /// Torques that hold the arm at the start (n; Nm, N).
    pub holding: DVector<f64>,
    pub check: Option<SetpointCheck>,
    /// Steps of the setpoints (n; rad, m), 0 for exact ones; empty if all are exact.
    pub steps: Vec<f64>,
    /// Commands that do not act yet; none at first.
    pub queue: CommandQueue,
}

impl ServoDrives {
    /// Returns drives that hold an arm at rest at `q` (n; rad, m).
    pub fn new(config: ServoDrivesConfig, motors: &mut Motors, q: &[f64]) -> Self {
        let ServoDrivesConfig { takes, holding, .. } = config;
        let n = q.len();
        let rest = |(i, law): (usize, ServoLaw)| JointServo::at_rest(law, motors.position()[i], holding[i]);
        let (servos, setpoints): (Vec<JointServo>, Vec<f64>) =
            config.laws.into_iter().enumerate().map(rest).unzip();
        let has_brakes = config.has_brakes && takes == CommandKind::Velocity;
        let values = match takes {
            CommandKind::Position => DVector::from_vec(setpoints),
            _ => DVector::zeros(n),
        };
        if has_brakes {
            motors.engage_brakes(q);
        }
        Self {
            takes,
            has_brakes,
            braked: has_brakes,
            servos,
            ratio: config.servo_ticks_per_cycle,
            active: Active {
                command: None,
                values,
                before: DVector::zeros(n),
                age: config.servo_ticks_per_cycle,
                setpoints: config.setpoints,
            },
            queue: config.queue,
            check: config.check,
            rounded: vec![0.0; config.steps.len()],
            steps: config.steps,
        }
    }

    /// Kind of the setpoints.
    pub fn takes(&self) -> CommandKind {
        self.takes
    }

    /// Begins an interface cycle.
    pub fn begin_cycle(&mut self) {
        if let Some(check) = &mut self.check {
            check.begin_cycle();
        }
    }

    /// 1 for each joint whose setpoint of the last cycle was beyond a limit (n); empty without limits.
    pub fn limited(&self) -> &[f64] {
        self.check.as_ref().map_or(&[][..], SetpointCheck::limited)
    }

    /// Accepts setpoints, which act at the servo tick `acts_at`.
    pub fn command(&mut self, values: &[f64], acts_at: u64) -> Result<(), DeviceFault> {
        let values = match &mut self.check {
            Some(check) => check.apply(values)?,
            None => values,
        };
        for ((rounded, &value), &step) in self.rounded.iter_mut().zip(values).zip(&self.steps) {
            *rounded = if step > 0.0 { (value / step).round() * step } else { value };
        }
        let values = if self.steps.is_empty() { values } else { &self.rounded };
        self.queue.command(values, acts_at);
        Ok(())
    }

    /// Accepts a hold command. Brakes hold the arm at `q` (n; rad, m) at once; without brakes, the last positions, or velocities
    /// of zero, act at the servo tick `acts_at`.
    pub fn hold(&mut self, motors: &mut Motors, q: &[f64], acts_at: u64) {
        if let Some(check) = &mut self.check {
            check.restart();
        }
        let number = self.queue.hold();
        if self.has_brakes {
            return self.hold_itself(motors, q, Some(number));
        }
        let is_velocity = self.takes == CommandKind::Velocity;
        self.queue.repeat(acts_at, |values| {
            if is_velocity {
                values.fill(0.0);
            }
        });
    }

    /// Enters the safe state, with the links at `q` (n; rad, m).
    pub fn stop(&mut self, motors: &mut Motors, q: &[f64]) {
        if self.takes == CommandKind::Velocity {
            self.hold_itself(motors, q, None);
        }
    }

    /// Holds the arm of a velocity robot from now on; commands that do not act yet are dropped.
    fn hold_itself(&mut self, motors: &mut Motors, q: &[f64], command: Option<u64>) {
        self.queue.clear();
        self.active.replace_by_zero(command);
        if self.has_brakes {
            self.braked = true;
            motors.engage_brakes(q);
        }
    }

    /// Number of the command in effect; `None` while the robot holds itself without a command (servos or brakes).
    pub fn command_in_force(&self) -> Option<u64> {
        self.active.command
    }

    /// Runs a servo tick: setpoints take effect, the drives read their encoders at `q` (n; rad, m) and ask the motors.
    pub fn servo_tick(&mut self, motors: &mut Motors, q: &[f64], servo_tick: u64) {
        motors.read_encoders(q);
        let Self { servos, active, queue, braked, ratio, .. } = self;
        queue.take_due(servo_tick, |number, values| {
            active.take(number, values, *ratio);
            if std::mem::take(braked) {
                motors.release_brakes();
                for (servo, &position) in servos.iter_mut().zip(motors.position()) {
                    servo.rest(position, 0.0);
                }
            }
        });
        match *braked {
            true => motors.ask(|_, _| 0.0),
            false => motors.ask(|i, position| servos[i].step(active.setpoint(i, *ratio), position)),
        }
        active.age = active.age.saturating_add(1);
    }
}

//! Drives of a robot that accepts torques: these go straight to the motors. Without commands, brakes hold the arm, or position
//! servos if it has none.
//!
//! The table of the [crate] describes their behaviour without commands.

use crate::command_queue::CommandQueue;
use crate::motors::Motors;
use crate::servo::JointServo;
use nalgebra::DVector;
use opspace_transformer::ServoLaw;

/// Torque commands of one arm, and the means that hold it without them.
pub(crate) struct TorqueDrives {
    hold: Hold,
    /// True while the arm is held.
    is_held: bool,
    /// Number of the command in effect; `None` while the robot holds itself.
    active: Option<u64>,
    /// Commanded torques (n; Nm, N).
    torques: DVector<f64>,
    queue: CommandQueue,
}

/// Means that hold the arm without commands.
enum Hold {
    Brakes,
    /// Position servos, with their setpoints (n; rad, m).
    Servos(Vec<JointServo>, Vec<f64>),
}

impl TorqueDrives {
    /// Returns drives whose brakes hold an arm at rest at `q` (n; rad, m).
    pub fn with_brakes(motors: &mut Motors, q: &[f64], queue: CommandQueue) -> Self {
        motors.engage_brakes(q);
        Self::held_by(Hold::Brakes, q.len(), queue)
    }

    /// Returns drives whose position servos hold an arm at rest with the torques `holding` (n; Nm, N).
    pub fn with_servos(
        motors: &Motors,
        laws: Vec<ServoLaw>,
        holding: &DVector<f64>,
        queue: CommandQueue,
    ) -> Self {
        let rest = |(i, law)| JointServo::at_rest(law, motors.position()[i], holding[i]);
        let (servos, setpoints) = laws.into_iter().enumerate().map(rest).unzip();
        Self::held_by(Hold::Servos(servos, setpoints), holding.len(), queue)
    }

    fn held_by(hold: Hold, n: usize, queue: CommandQueue) -> Self {
        Self { hold, is_held: true, active: None, torques: DVector::zeros(n), queue }
    }

    /// Accepts torques (n; Nm, N), which act at the servo tick `acts_at`.
    pub fn command(&mut self, torques: &[f64], acts_at: u64) {
        self.queue.command(torques, acts_at);
    }

    /// Accepts a hold command: the arm is held at `q` (n; rad, m) at once.
    pub fn hold(&mut self, motors: &mut Motors, q: &[f64]) {
        let number = self.queue.hold();
        self.hold_itself(motors, q, Some(number));
    }

    /// Enters the safe state, with the links at `q` (n; rad, m).
    pub fn stop(&mut self, motors: &mut Motors, q: &[f64]) {
        self.hold_itself(motors, q, None);
    }

    /// Holds the arm from now on; commands that do not act yet are dropped.
    fn hold_itself(&mut self, motors: &mut Motors, q: &[f64], command: Option<u64>) {
        self.queue.clear();
        self.active = command;
        match &mut self.hold {
            Hold::Brakes => motors.engage_brakes(q),
            Hold::Servos(servos, setpoints) if !self.is_held => {
                for (i, (servo, setpoint)) in servos.iter_mut().zip(setpoints).enumerate() {
                    *setpoint = servo.rest(motors.position()[i], motors.asked()[i]);
                }
            }
            Hold::Servos(..) => {}
        }
        self.is_held = true;
    }

    /// Number of the command in effect; `None` while the robot holds itself without a command (servos or brakes).
    pub fn command_in_force(&self) -> Option<u64> {
        self.active
    }

    /// Runs a servo tick: torques take effect, the drives read their encoders at `q` (n; rad, m) and ask the motors.
    pub fn servo_tick(&mut self, motors: &mut Motors, q: &[f64], servo_tick: u64) {
        motors.read_encoders(q);
        let Self { hold, is_held, active, torques, queue } = self;
        queue.take_due(servo_tick, |number, values| {
            torques.copy_from(values);
            *active = Some(number);
            if std::mem::take(is_held) && matches!(hold, Hold::Brakes) {
                motors.release_brakes();
            }
        });
        match hold {
            _ if !*is_held => motors.ask(|i, _| torques[i]),
            Hold::Brakes => motors.ask(|_, _| 0.0),
            Hold::Servos(servos, setpoints) => {
                motors.ask(|i, position| servos[i].step(setpoints[i], position));
            }
        }
    }
}

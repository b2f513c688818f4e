//! Motors of a simulated arm with their drivetrains and encoders: what every kind of robot has.

use crate::drivetrain::Drivetrain;
use crate::implicit_step::ImplicitStep;
use crate::own_gravity::OwnGravity;
use crate::plant::JointTorque;
use nalgebra::DVector;

/// Drivetrains of one arm, with the torques that their motors are asked for.
pub(crate) struct Motors {
    drivetrains: Vec<Drivetrain>,
    limits: Option<DVector<f64>>,
    /// Positions that the drives have measured (n; rad, m).
    position: DVector<f64>,
    /// Positions that the interface reports (n; rad, m).
    reported: DVector<f64>,
    /// Torques that the motors are asked for, within the limits (n; Nm, N).
    asked: DVector<f64>,
    limited: bool,
    own_gravity: Option<OwnGravity>,
    implicit: ImplicitStep,
}

impl Motors {
    /// Returns motors at rest, with the links at `q` (n; rad, m). `limits` are the torque limits of the drives (n; Nm, N).
    pub fn new(drivetrains: Vec<Drivetrain>, limits: Option<DVector<f64>>, q: &[f64]) -> Self {
        let n = q.len();
        let position = DVector::from_fn(n, |i, _| drivetrains[i].read_encoder(q[i]));
        let (reported, asked) = (DVector::zeros(n), DVector::zeros(n));
        let (limited, own_gravity, implicit) = (false, None, ImplicitStep::default());
        Self { drivetrains, limits, position, reported, asked, limited, own_gravity, implicit }
    }

    /// Lets the drives compensate gravity.
    pub fn compensating(self, own_gravity: Option<OwnGravity>) -> Self {
        Self { own_gravity, ..self }
    }

    /// Compensates gravity at the positions that the drives have measured, if they do that.
    pub fn compensate_gravity(&mut self) {
        if let Some(own) = &mut self.own_gravity {
            own.compensate(&mut self.drivetrains, self.position.as_slice());
        }
    }

    /// Positions that the drives have measured (n; rad, m).
    pub fn position(&self) -> &[f64] {
        self.position.as_slice()
    }

    /// Torques that the motors are asked for (n; Nm, N).
    pub fn asked(&self) -> &[f64] {
        self.asked.as_slice()
    }

    /// Engages the brakes, with the links at `q` (n; rad, m).
    pub fn engage_brakes(&mut self, q: &[f64]) {
        self.drivetrains.iter_mut().zip(q).for_each(|(joint, &q)| joint.engage_brake(q));
    }

    pub fn release_brakes(&mut self) {
        self.drivetrains.iter_mut().for_each(Drivetrain::release_brake);
    }

    /// Reads the encoders of the drives, with the links at `q` (n; rad, m).
    pub fn read_encoders(&mut self, q: &[f64]) {
        for (to, (joint, &q)) in self.position.iter_mut().zip(self.drivetrains.iter().zip(q)) {
            *to = joint.read_encoder(q);
        }
    }

    /// Asks the motors for torques (Nm, N), within the limits of the drives. `torque` gets a joint and its measured position
    /// (rad, m).
    pub fn ask(&mut self, mut torque: impl FnMut(usize, f64) -> f64) {
        for i in 0..self.asked.len() {
            let torque = torque(i, self.position[i]);
            self.asked[i] = match &self.limits {
                Some(limits) => torque.clamp(-limits[i], limits[i]),
                None => torque,
            };
            self.limited |= self.asked[i] != torque;
        }
    }

    /// Runs the current loops for a physics step.
    pub fn drive(&mut self) {
        for (joint, &asked) in self.drivetrains.iter_mut().zip(&self.asked) {
            joint.drive(asked);
        }
    }

    /// Begins a step of `dt_s` (s) at the true `q` (n; rad, m) and `dq` (n; rad/s, m/s): writes what acts on the links
    /// (n).
    pub fn begin_step(&mut self, q: &[f64], dq: &[f64], dt_s: f64, torques: &mut [JointTorque]) {
        self.implicit = ImplicitStep::default();
        for (i, joint) in self.drivetrains.iter_mut().enumerate() {
            torques[i] = joint.begin_step(q[i], dq[i], dt_s);
        }
    }

    /// True if a joint is integrated implicitly in the present step.
    pub fn is_implicit(&self) -> bool {
        self.drivetrains.iter().any(Drivetrain::is_implicit)
    }

    /// Revises what acts on the links (n) for the velocities `dq` (n; rad/s, m/s) at the end of a step of `dt_s` (s). Returns
    /// true if something changes.
    pub fn revise_step(&mut self, dq: &[f64], dt_s: f64, torques: &mut [JointTorque]) -> bool {
        self.implicit.revise(&mut self.drivetrains, dq, dt_s, torques)
    }

    /// Ends a step of `dt_s` (s) with the true `dq` (n; rad/s, m/s).
    pub fn end_step(&mut self, dq: &[f64], dt_s: f64) {
        self.drivetrains.iter_mut().zip(dq).for_each(|(joint, &dq)| joint.end_step(dq, dt_s));
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

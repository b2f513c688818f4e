//! The arm itself: rigid bodies moved by motors and contacts, held back by friction and end stops.

use crate::friction::LuGre;
use crate::integrator::RungeKutta;
use crate::motor::Motor;
use crate::parameters::{BrakeParameters, EndStopParameters};
use crate::surroundings::Surrounding;
use nalgebra::{DVector, Matrix6xX, Vector3};
use opspace_model::{
    Data, Force, FrameId, Limits, Model, frame_jacobian, frame_placement, frame_velocity, kinematics,
};

/// What touches one frame of the arm.
#[derive(Clone, Debug)]
pub struct Contact {
    frame: FrameId,
    surrounding: Surrounding,
    jacobian: Matrix6xX<f64>,
    force: Vector3<f64>,
}

impl Contact {
    /// A surrounding at a frame of a robot of `n` joints.
    #[must_use]
    pub fn new(frame: FrameId, surrounding: Surrounding, n: usize) -> Self {
        Self { frame, surrounding, jacobian: Matrix6xX::zeros(n), force: Vector3::zeros() }
    }

    /// The force on the robot during the last step, world axes, N.
    #[must_use]
    pub fn force(&self) -> &Vector3<f64> {
        &self.force
    }
}

/// The parts of a [`Plant`].
pub struct PlantParts {
    /// The true rigid bodies.
    pub model: Model,
    /// One a joint.
    pub friction: Vec<LuGre>,
    /// One a joint.
    pub motors: Vec<Motor>,
    /// For all joints.
    pub end_stop: EndStopParameters,
    /// For all joints.
    pub brake: BrakeParameters,
    /// Torque at which each joint's brake slips, Nm.
    pub brake_torque: DVector<f64>,
    /// What touches it.
    pub contacts: Vec<Contact>,
    /// Where it starts, at rest, rad or m.
    pub q: DVector<f64>,
}

/// State and physics of the arm, stepped at a fixed rate.
pub struct Plant {
    parts: PlantParts,
    dq: DVector<f64>,
    braked: bool,
    /// Where each brake fell in.
    braked_at: DVector<f64>,
    integrator: RungeKutta,
    data: Data,
    torque: DVector<f64>,
    motor_torque: DVector<f64>,
}

impl Plant {
    /// At rest.
    ///
    /// # Panics
    /// If the parts are not one a joint.
    #[must_use]
    pub fn new(parts: PlantParts) -> Self {
        let n = parts.model.n();
        assert!([parts.friction.len(), parts.motors.len(), parts.q.len()].iter().all(|&l| l == n));
        let zero = DVector::zeros(n);
        Self {
            dq: zero.clone(),
            braked: false,
            braked_at: zero.clone(),
            integrator: RungeKutta::new(&parts.model),
            data: Data::new(&parts.model),
            torque: zero.clone(),
            motor_torque: zero,
            parts,
        }
    }

    /// True joint positions, rad or m.
    #[must_use]
    pub fn q(&self) -> &DVector<f64> {
        &self.parts.q
    }

    /// True joint velocities, rad/s or m/s.
    #[must_use]
    pub fn dq(&self) -> &DVector<f64> {
        &self.dq
    }

    /// The true rigid bodies.
    #[must_use]
    pub fn model(&self) -> &Model {
        &self.parts.model
    }

    /// What touches it.
    #[must_use]
    pub fn contacts(&self) -> &[Contact] {
        &self.parts.contacts
    }

    /// The motors' torque at the joints, mean over the last step, Nm.
    #[must_use]
    pub fn motor_torque(&self) -> &DVector<f64> {
        &self.motor_torque
    }

    /// Lets the brakes fall in where the joints stand.
    pub fn brake(&mut self) {
        if !self.braked {
            self.braked = true;
            self.braked_at.copy_from(&self.parts.q);
        }
    }

    /// Lifts the brakes.
    pub fn release(&mut self) {
        self.braked = false;
    }

    /// Moves on by `dt` (s) from the time `t` (s from the controller's start), with `asked` (n; Nm) asked of
    /// the motors. Motor torque, friction, stops and contacts are held over the step; the rigid bodies are
    /// integrated to fourth order.
    pub fn step(&mut self, t: f64, dt: f64, asked: &[f64]) {
        for (i, &asked) in asked.iter().enumerate() {
            let motor = self.parts.motors[i].step(asked);
            let friction = self.parts.friction[i].step(self.dq[i], dt);
            let stop = self.end_stop(&self.parts.model.joints()[i].limits, i);
            self.motor_torque[i] = motor;
            self.torque[i] = motor - friction + stop + self.brake_torque(i);
        }
        self.touch(t);
        self.integrator.step(&self.parts.model, &mut self.parts.q, &mut self.dq, self.torque.as_slice(), dt);
    }

    /// The wrench of all contacts on the body that carries `frame`, at its origin and in its axes (N, Nm).
    /// Of the last step.
    #[must_use]
    pub fn contact_wrench(&mut self, frame: FrameId) -> Force {
        let model = &self.parts.model;
        kinematics(model, &mut self.data, self.parts.q.as_slice(), self.dq.as_slice());
        let sensor = frame_placement(model, &self.data, frame);
        let body = model.frame_info(frame).body;
        let mut wrench = Force::zero();
        for contact in &self.parts.contacts {
            if model.frame_info(contact.frame).body == body {
                let at = frame_placement(model, &self.data, contact.frame).translation;
                wrench.linear += contact.force;
                wrench.angular += (at - sensor.translation).cross(&contact.force);
            }
        }
        Force {
            linear: sensor.rotation.tr_mul(&wrench.linear),
            angular: sensor.rotation.tr_mul(&wrench.angular),
        }
    }

    /// Adds the contacts' joint torques Jᵀ F at time `t`.
    fn touch(&mut self, t: f64) {
        if self.parts.contacts.is_empty() {
            return;
        }
        let model = &self.parts.model;
        kinematics(model, &mut self.data, self.parts.q.as_slice(), self.dq.as_slice());
        for contact in &mut self.parts.contacts {
            let x = frame_placement(model, &self.data, contact.frame).translation;
            let v = frame_velocity(model, &self.data, contact.frame).linear;
            contact.force = contact.surrounding.force(t, &x, &v);
            frame_jacobian(model, &self.data, contact.frame, &mut contact.jacobian);
            for i in 0..self.torque.len() {
                let column: Vector3<f64> = contact.jacobian.fixed_view::<3, 1>(0, i).into_owned();
                self.torque[i] += column.dot(&contact.force);
            }
        }
    }

    fn end_stop(&self, limits: &Limits, i: usize) -> f64 {
        let q = self.parts.q[i];
        let depth = (limits.lower - q).max(0.0) - (q - limits.upper).max(0.0);
        if depth == 0.0 {
            return 0.0;
        }
        let stop = &self.parts.end_stop;
        let torque = stop.stiffness_nm_per_rad.get() * depth - stop.damping_nms_per_rad.get() * self.dq[i];
        // A stop pushes back; it doesn't hold on to a joint that leaves it.
        if depth > 0.0 { torque.max(0.0) } else { torque.min(0.0) }
    }

    fn brake_torque(&self, i: usize) -> f64 {
        if !self.braked {
            return 0.0;
        }
        let brake = &self.parts.brake;
        let spring = brake.stiffness_nm_per_rad.get() * (self.braked_at[i] - self.parts.q[i]);
        let limit = self.parts.brake_torque[i];
        (spring - brake.damping_nms_per_rad.get() * self.dq[i]).clamp(-limit, limit)
    }
}

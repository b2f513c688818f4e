//! Observers of torques that no model of the arm predicts: friction that the compensation leaves, and contact.

use crate::collision_detector::{Collision, CollisionDetector, CollisionReaction, ExpectedContact};
use crate::driving_torque::DrivingTorque;
use crate::estimated_force::EstimatedForce;
use crate::loop_config::LoopConfig;
use crate::retraction::Retraction;
use nalgebra::{DVector, Matrix6xX, Vector6};
use opspace_backend::signal_names::{
    COLLISION_CHANGE, COLLISION_CHANGE_THRESHOLD, COLLISION_DETECTED, COLLISION_THRESHOLD, COLLISION_TORQUE,
    FRICTION_OBSERVER, RESIDUAL, WRENCH, WRENCH_AXES,
};
use opspace_backend::{Observable, SignalRecorder};
use opspace_control::Measurement;
use opspace_control::context::separate_sensors;
use opspace_model::{
    Data, Force, FrameId, JointUnits, Model, UnknownFrame, frame_jacobian, generalized_momentum,
};
use opspace_transformer::FrictionObserver;

/// Rate at which the momentum decays while the robot is compliant after a collision, 1/s: motion at 0.25 m/s ends within
/// 5 cm, and a hand that pushes the robot away feels little of it.
const COMPLIANT_DAMPING_PER_S: f64 = 5.0;

/// Observers of external torques, for a loop that has at least one. Allocates only when it is created.
pub(crate) struct ExternalTorque {
    joints: Vec<String>,
    units: JointUnits,
    period_s: f64,
    driving: DrivingTorque,
    sensors: Vec<(usize, FrameId)>,
    jacobian: Matrix6xX<f64>,
    /// Torques Jᵀ F of the measured wrenches (n; Nm, N).
    sensed: DVector<f64>,
    /// Friction compensation n̂ of the last command (n; Nm, N).
    compensation: DVector<f64>,
    known: DVector<f64>,
    friction: Option<FrictionObserver>,
    forces: Vec<EstimatedForce>,
    collision: Option<CollisionDetector>,
    /// First collision, if there was one.
    collided: Option<Collision>,
    retraction: Option<Retraction>,
}

impl ExternalTorque {
    /// Returns the observers of a loop; `None` if it has none.
    ///
    /// # Errors
    /// If a force sensor is on a frame that the model does not have.
    pub(crate) fn new(config: &LoopConfig) -> Result<Option<Self>, UnknownFrame> {
        let LoopConfig { model, capabilities, friction_observer, estimated_forces, collision, .. } = config;
        if friction_observer.is_none() && estimated_forces.is_empty() && collision.is_none() {
            return Ok(None);
        }
        let n = model.n();
        let zero = DVector::zeros(n);
        let retraction = match collision.as_ref().map(|detector| detector.reaction) {
            Some(CollisionReaction::Retract(parameters)) => {
                Some(Retraction::new(&parameters, model, &config.torque_limits))
            }
            _ => None,
        };
        let frames = capabilities.force_sensors.iter().map(|sensor| model.frame_id(&sensor.frame));
        Ok(Some(Self {
            joints: capabilities.joints.clone(),
            units: model.joint_units(),
            period_s: capabilities.period_s,
            driving: DrivingTorque::new(n, capabilities, config.command_delay_s),
            sensors: separate_sensors(model, frames.collect::<Result<Vec<_>, _>>()?),
            jacobian: Matrix6xX::zeros(n),
            sensed: zero.clone(),
            compensation: zero.clone(),
            known: zero,
            friction: friction_observer.clone(),
            forces: estimated_forces.clone(),
            collision: collision.clone(),
            collided: None,
            retraction,
        }))
    }

    /// Updates the observers with a sample, `missed` cycles after the previous one. `commanded` are the torques of the last
    /// command (n; Nm, N). Writes the estimated forces into the measurement, after those of the sensors.
    /// Returns the collision for which the run ends in this cycle.
    pub(crate) fn update(
        &mut self,
        model: &Model,
        data: &mut Data,
        measurement: &mut Measurement,
        commanded: &DVector<f64>,
        missed: u64,
    ) -> Option<Collision> {
        generalized_momentum(model, data);
        let elapsed_s = missed.saturating_add(1) as f64 * self.period_s;
        self.driving.update(data, measurement, commanded);
        let driving = self.driving.mean();
        for force in &mut self.forces {
            force.update(model, data, elapsed_s, driving, &mut self.known);
        }
        self.sensed.fill(0.0);
        for &(sensor, frame) in &self.sensors {
            frame_jacobian(model, data, frame, &mut self.jacobian);
            let Force { linear: force, angular: moment } = measurement.wrenches[sensor];
            let wrench = Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
            self.sensed.gemv_tr(1.0, &self.jacobian, &wrench, 1.0);
        }
        if let Some(friction) = &mut self.friction {
            self.known.copy_from(driving);
            self.known += &self.sensed;
            self.known -= &self.compensation;
            friction.update(elapsed_s, &data.momentum, &self.known);
        }
        self.write_forces(measurement);
        let detector = self.collision.as_mut()?;
        self.known.copy_from(driving);
        if detector.expected == ExpectedContact::Sensed {
            self.known += &self.sensed;
        }
        let found = detector.update(data, elapsed_s, self.driving.motor(), &mut self.known);
        let is_first = self.collided.is_none() && found.is_some();
        self.collided = self.collided.or(found);
        let collided = self.collided?;
        match (detector.reaction, &mut self.retraction) {
            (CollisionReaction::Stop, _) => Some(collided),
            (CollisionReaction::Retract(_), Some(retraction)) => {
                if is_first {
                    retraction.begin(&data.q);
                }
                retraction.update(elapsed_s, detector.excess());
                retraction.is_over().then_some(collided)
            }
            _ => None,
        }
    }

    /// Returns the collision from which the arm is retracting, if it is.
    pub(crate) fn retracts_from(&self) -> Option<Collision> {
        self.collided.filter(|_| self.retraction.is_some())
    }

    /// True since a collision after which the controller commands no more.
    pub(crate) fn is_reacting(&self) -> bool {
        self.collided.is_some()
    }

    /// Computes the torques of the reaction to a collision, except those that hold the arm at rest (n; Nm, N). They damp the
    /// motion, or retract the arm.
    pub(crate) fn reaction_torque(&mut self, data: &Data, torque: &mut DVector<f64>) {
        match &mut self.retraction {
            Some(retraction) => retraction.torque(data, torque),
            None => {
                for (torque, momentum) in torque.iter_mut().zip(&data.momentum) {
                    *torque = -COMPLIANT_DAMPING_PER_S * momentum;
                }
            }
        }
    }

    /// Writes the joint velocities that the reaction asks for (n; rad/s, m/s).
    pub(crate) fn reaction_velocity(&self, velocity: &mut [f64]) {
        match &self.retraction {
            Some(retraction) => velocity.copy_from_slice(retraction.velocity().as_slice()),
            None => velocity.fill(0.0),
        }
    }

    fn write_forces(&self, measurement: &mut Measurement) {
        let first = measurement.wrenches.len() - self.forces.len();
        let estimated = measurement.wrenches[first..].iter_mut();
        estimated.zip(&self.forces).for_each(|(wrench, force)| *wrench = force.force());
    }

    /// Adds the observed friction to the compensation n̂ of this cycle (n; Nm, N).
    pub(crate) fn compensate(&mut self, compensation: &mut DVector<f64>) {
        self.compensation.copy_from(compensation);
        // After a collision it would oppose the contact.
        if let Some(friction) = self.friction.as_ref().filter(|_| !self.is_reacting()) {
            *compensation += friction.torque();
        }
    }

    /// Starts all observers anew; the estimated forces in the measurement are zero.
    pub(crate) fn reset(&mut self, measurement: &mut Measurement) {
        self.forces.iter_mut().for_each(EstimatedForce::reset);
        if let Some(detector) = &mut self.collision {
            detector.reset();
        }
        self.write_forces(measurement);
        if let Some(friction) = &mut self.friction {
            friction.reset();
        }
    }
}

impl Observable for ExternalTorque {
    fn record(&self, out: &mut SignalRecorder<'_>) {
        if let Some(friction) = &self.friction {
            out.signal(FRICTION_OBSERVER, &self.units.torque, &self.joints, friction.torque().as_slice());
        }
        if let Some(detector) = &self.collision {
            let (joints, unit) = (&self.joints, &self.units.torque);
            out.signal(COLLISION_TORQUE, unit, joints, detector.residual().as_slice());
            out.signal(COLLISION_THRESHOLD, unit, joints, detector.threshold().as_slice());
            if let Some(fast) = detector.fast() {
                out.signal(COLLISION_CHANGE, unit, joints, fast.change().as_slice());
                out.signal(COLLISION_CHANGE_THRESHOLD, unit, joints, fast.threshold().as_slice());
            }
            out.scalar(COLLISION_DETECTED, "1", f64::from(u8::from(self.is_reacting())));
        }
        for force in &self.forces {
            let Force { linear, angular } = force.force();
            let wrench = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z];
            out.signal((&force.name, WRENCH), "N,Nm", &WRENCH_AXES, &wrench);
            out.signal(
                (&force.name, RESIDUAL),
                &self.units.torque,
                &self.joints,
                force.residual().as_slice(),
            );
        }
    }
}

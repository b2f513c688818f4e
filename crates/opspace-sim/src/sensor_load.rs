//! Weight and inertia of the part of an arm beyond a force sensor.

use crate::parameters::SensorLoadParameters;
use nalgebra::Vector3;
use opspace_model::{Data, Force, FrameId, Model, frame_placement, frame_velocity, kinematics};

/// Point mass that a force sensor bears.
#[derive(Clone, Debug)]
pub(crate) struct SensorLoad {
    mass: f64,
    centre: Vector3<f64>,
    model: Model,
    data: Data,
    frame: FrameId,
    period_s: f64,
    /// Velocity of the mass at the end of the last period, world axes, m/s.
    velocity: Vector3<f64>,
}

impl SensorLoad {
    /// Returns the load of a sensor in a frame of an arm at rest, read every `period_s` (s).
    pub fn new(parameters: &SensorLoadParameters, model: Model, frame: FrameId, period_s: f64) -> Self {
        Self {
            mass: parameters.mass_kg.get(),
            centre: Vector3::from(parameters.centre_m),
            data: Data::new(&model),
            model,
            frame,
            period_s,
            velocity: Vector3::zeros(),
        }
    }

    /// Returns the mean wrench (sensor axes; N, Nm) of weight and inertia on the sensor over a period that ends at `q` (n;
    /// rad, m) with the velocity `dq` (n; rad/s, m/s): the acceleration is the difference of velocities.
    pub fn wrench(&mut self, q: &[f64], dq: &[f64]) -> Force {
        kinematics(&self.model, &mut self.data, q, dq);
        let rotation = frame_placement(&self.model, &self.data, self.frame).rotation;
        let frame = frame_velocity(&self.model, &self.data, self.frame);
        let velocity = frame.linear + frame.angular.cross(&(rotation * self.centre));
        let acceleration = (velocity - self.velocity) / self.period_s;
        self.velocity = velocity;
        let linear = rotation.tr_mul(&((self.model.gravity() - acceleration) * self.mass));
        Force { linear, angular: self.centre.cross(&linear) }
    }
}

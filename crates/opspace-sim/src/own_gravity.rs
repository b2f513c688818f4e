//! Compensation of gravity by the drives of a robot.

use crate::drivetrain::Drivetrain;
use nalgebra::DVector;
use opspace_model::{Data, Model, forward_kinematics, gravity};

/// Torques by which the drives of a robot compensate its weight: that of *its* model, with the declared tools. Loads that
/// the model does not have keep their weight.
#[derive(Clone, Debug)]
pub(crate) struct OwnGravity {
    model: Model,
    data: Data,
}

impl OwnGravity {
    pub fn new(model: Model) -> Self {
        Self { data: Data::new(&model), model }
    }

    /// Torques at the positions `q` (n; rad, m) that the drives have measured (n; Nm, N).
    pub fn torques(&mut self, q: &[f64]) -> &DVector<f64> {
        forward_kinematics(&self.model, &mut self.data, q);
        gravity(&self.model, &mut self.data);
        &self.data.gravity
    }

    /// Sets the torques of the drives, from the positions `q` (n; rad, m) that they have measured.
    pub fn compensate(&mut self, drivetrains: &mut [Drivetrain], q: &[f64]) {
        let torques = self.torques(q);
        drivetrains.iter_mut().zip(torques.iter()).for_each(|(joint, &torque)| joint.compensate(torque));
    }
}

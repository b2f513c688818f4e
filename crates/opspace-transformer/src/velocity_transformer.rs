//! Conversion of torques to velocities: the first of the two consecutive transformers of the paper, alone.

use crate::servo::ServoGains;
use crate::transformer::Transformer;
use opspace_backend::CommandKind;
use opspace_model::Data;

/// Transformer of the paper for the inner velocity loop, for robots that accept velocities.
///
/// The cascade of equation (K9), `τ = kv [kp (q_desired − q) − q̇]`, has the inner loop `τ = kv (q̇_desired − q̇)`.
/// Solved for its setpoint, it is the inner stage of equation (K10):
///
/// ```text
/// q̇_desired = kv⁻¹ τ + q̇
/// ```
///
/// An integral of the velocity loop is not included: its torque adds to the desired one. Torque is exact at the
/// instant of the measurement; over a held setpoint the drive sees other velocities, which acts as an added inertia.
#[derive(Clone, Debug)]
pub struct VelocityTransformer {
    gains: Vec<ServoGains>,
}

impl VelocityTransformer {
    /// Returns the transformer for joints whose velocity loops have these gains; of each, the damping kv is used.
    #[must_use]
    pub fn new(gains: Vec<ServoGains>) -> Self {
        Self { gains }
    }
}

impl Transformer for VelocityTransformer {
    fn takes(&self) -> CommandKind {
        CommandKind::Velocity
    }

    fn transform(&mut self, data: &Data, torque: &[f64], velocity_desired: &mut [f64]) {
        for (i, gains) in self.gains.iter().enumerate() {
            velocity_desired[i] = torque[i] / gains.damping + data.dq[i];
        }
    }
}

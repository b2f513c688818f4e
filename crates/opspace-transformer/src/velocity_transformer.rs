//! Conversion of torques to velocities: the first of the paper's two consecutive transformers.

use crate::servo_gains::ServoGains;
use crate::transformer::Transformer;
use opspace_backend::CommandKind;
use opspace_model::Data;

/// Transformer of the paper for the inner velocity loop, for robots that accept velocities.
///
/// The cascade of equation (K9), `τ = kv [kp (q_d − q) − q̇]`, has the inner loop `τ = kv (q̇_d − q̇)`.
/// Its inverse is the inner stage of equation (K10):
///
/// ```text
/// q̇_d = kv⁻¹ τ + q̇
/// ```
///
/// The integral of a velocity loop is not included: its torque adds to the desired one. The torque is exact at the
/// instant of the measurement. While the setpoint is held, the drive measures other velocities, which acts like an
/// added inertia.
#[derive(Clone, Debug)]
pub struct VelocityTransformer {
    gains: Vec<ServoGains>,
}

impl VelocityTransformer {
    /// Returns the transformer for joints whose velocity loops have these gains (n); only the damping kv of each is
    /// used.
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

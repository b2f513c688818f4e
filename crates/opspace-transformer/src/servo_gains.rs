//! Equivalent gains of a servo.

/// Equivalent gains of a servo; integral, filters and delays are neglected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ServoGains {
    /// Torque per position error, Nm/rad (N/m): `kv kp` of a cascade. Zero for a velocity servo, which has no position
    /// setpoint; check [`ServoParameters::takes`](crate::ServoParameters::takes) before dividing by it.
    pub stiffness: f64,
    /// Torque per velocity, opposing it, Nms/rad (Ns/m): `kv` of a cascade and of a velocity servo.
    pub damping: f64,
}

impl ServoGains {
    /// Gain of the position loop around the velocity loop, 1/s: `kp` of a cascade, zero for a velocity servo.
    #[must_use]
    pub fn position_loop(&self) -> f64 {
        self.stiffness / self.damping
    }
}

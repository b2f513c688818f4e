//! A joint's drive: at each servo tick, from set-point and encoder to the torque asked of the motor.

use opspace_backend::CascadedServo;
use std::f64::consts::TAU;

/// The cascaded servo of equation (9) with its own filtered finite-difference velocity:
/// `τ = kv [kp (q_desired − y) − w]`, `w += a ((y − y₋)/Ts − w)`.
#[derive(Clone, Debug)]
pub struct Servo {
    kp: f64,
    kv: f64,
    gain: f64,
    period_s: f64,
    last: f64,
    velocity: f64,
}

impl Servo {
    /// At rest at `y` (rad); the scales are truth over belief.
    #[must_use]
    pub fn new(servo: &CascadedServo, kp_scale: f64, kv_scale: f64, period_s: f64, y: f64) -> Self {
        Self {
            kp: kp_scale * servo.kp_per_s.get(),
            kv: kv_scale * servo.kv_nms_per_rad.get(),
            gain: 1.0 - (-TAU * servo.velocity_filter_hz.get() * period_s).exp(),
            period_s,
            last: y,
            velocity: 0.0,
        }
    }

    /// The torque (Nm) for the set-point and the encoder's position `y` (rad) at this servo tick.
    pub fn torque(&mut self, q_desired: f64, y: f64) -> f64 {
        self.observe(y);
        self.kv * (self.kp * (q_desired - y) - self.velocity)
    }

    /// Keeps the velocity filter going at a tick at which another source commands the motor.
    pub fn observe(&mut self, y: f64) {
        self.velocity += self.gain * ((y - self.last) / self.period_s - self.velocity);
        self.last = y;
    }

    /// The set-point at which the servo at rest at `y` produces `torque`.
    #[must_use]
    pub fn holding(&self, y: f64, torque: f64) -> f64 {
        y + torque / (self.kv * self.kp)
    }
}

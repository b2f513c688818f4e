//! Point mass that advances by the midpoint steps of the plant: see [`Midpoint`](crate::Midpoint).

use nalgebra::SVector;

/// Point mass in D dimensions.
#[derive(Clone, Debug)]
pub(crate) struct Body<const D: usize> {
    position: SVector<f64, D>,
    velocity: SVector<f64, D>,
    /// Acceleration of the last step, m/s².
    acceleration: SVector<f64, D>,
}

impl<const D: usize> Body<D> {
    /// Returns a mass that passes a point (m) with a velocity (m/s) in the middle of a step of `dt` (s).
    pub fn passing(point: SVector<f64, D>, velocity: SVector<f64, D>, dt: f64) -> Self {
        Self { position: point - velocity * (0.5 * dt), velocity, acceleration: SVector::zeros() }
    }

    /// Predicts position (m) and velocity (m/s) in the middle of the next step of `dt` (s).
    pub fn middle(&self, dt: f64) -> (SVector<f64, D>, SVector<f64, D>) {
        (self.position + self.velocity * (0.5 * dt), self.velocity + self.acceleration * (0.5 * dt))
    }

    /// Advances by a step of `dt` (s) with the acceleration in its middle (m/s²).
    pub fn advance(&mut self, acceleration: SVector<f64, D>, dt: f64) {
        self.position += (self.velocity + acceleration * (0.5 * dt)) * dt;
        self.velocity += acceleration * dt;
        self.acceleration = acceleration;
    }

    /// Position, m.
    pub fn position(&self) -> SVector<f64, D> {
        self.position
    }

    /// Velocity, m/s.
    pub fn velocity(&self) -> SVector<f64, D> {
        self.velocity
    }
}

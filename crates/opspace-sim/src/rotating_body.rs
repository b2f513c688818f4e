//! Rotation of a free rigid body by the midpoint steps of the plant: see [`Midpoint`](crate::Midpoint).
//!
//! ```text
//! R_m = exp(h/2 ω) R        ω_m = R_m I⁻¹ R_mᵀ (L + h/2 M)        R ← exp(h ω_m) R        L ← L + h M
//! ```
//!
//! L is the angular momentum in world axes, which is thus conserved exactly without moments. The order is two.

use nalgebra::{UnitQuaternion, Vector3};

/// Orientation and angular momentum of a rigid body.
#[derive(Clone, Debug)]
pub(crate) struct RotatingBody {
    /// Principal moments of inertia about the centre of mass, in the axes of the body, kg m².
    inertia: Vector3<f64>,
    orientation: UnitQuaternion<f64>,
    /// Angular momentum in world axes, kg m²/s.
    momentum: Vector3<f64>,
    /// Moment of the last step, world axes, Nm.
    moment: Vector3<f64>,
}

impl RotatingBody {
    /// Returns a body at rest whose axes are those of the world, with principal moments of inertia (kg m²).
    pub fn at_rest(inertia: Vector3<f64>) -> Self {
        let zero = Vector3::zeros();
        Self { inertia, orientation: UnitQuaternion::identity(), momentum: zero, moment: zero }
    }

    /// Predicts orientation and angular velocity (world axes, rad/s) in the middle of the next step of `dt` (s).
    pub fn middle(&self, dt: f64) -> (UnitQuaternion<f64>, Vector3<f64>) {
        let orientation = self.rotated(&self.angular_velocity(), 0.5 * dt);
        (orientation, self.velocity(&orientation, &(self.momentum + self.moment * (0.5 * dt))))
    }

    /// Advances by a step of `dt` (s) with the moment in its middle (world axes, Nm).
    pub fn advance(&mut self, moment: Vector3<f64>, dt: f64) {
        let (middle, _) = self.middle(dt);
        let velocity = self.velocity(&middle, &(self.momentum + moment * (0.5 * dt)));
        self.orientation = self.rotated(&velocity, dt);
        self.momentum += moment * dt;
        self.moment = moment;
    }

    /// Orientation: rotates from the axes of the body to those of the world.
    pub fn orientation(&self) -> UnitQuaternion<f64> {
        self.orientation
    }

    /// Angular velocity, world axes, rad/s.
    pub fn angular_velocity(&self) -> Vector3<f64> {
        self.velocity(&self.orientation, &self.momentum)
    }

    fn velocity(&self, orientation: &UnitQuaternion<f64>, momentum: &Vector3<f64>) -> Vector3<f64> {
        let own = orientation.inverse_transform_vector(momentum);
        orientation.transform_vector(&own.component_div(&self.inertia))
    }

    fn rotated(&self, velocity: &Vector3<f64>, time_s: f64) -> UnitQuaternion<f64> {
        let mut rotated = UnitQuaternion::from_scaled_axis(velocity * time_s) * self.orientation;
        rotated.renormalize();
        rotated
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Symmetric top of 0.02 kg m² across and 0.03 kg m² along its axis z, after `duration_s` with steps of `dt` (s).
    fn top(momentum: Vector3<f64>, dt: f64, duration_s: f64) -> RotatingBody {
        let mut top = RotatingBody::at_rest(Vector3::new(0.02, 0.02, 0.03));
        top.momentum = momentum;
        for _ in 0..(duration_s / dt).round() as u32 {
            top.advance(Vector3::zeros(), dt);
        }
        top
    }

    /// Compared: the axis of a top without moments, and its precession about the angular momentum L with the rate |L|/I, I
    /// across the axis. Halving the step divides the error by four.
    #[test]
    fn free_top_precesses() {
        const DURATION_S: f64 = 0.7;
        let momentum = Vector3::new(0.02, -0.01, 0.08);
        let precession = UnitQuaternion::from_scaled_axis(momentum * (DURATION_S / 0.02));
        let expected = precession * Vector3::z();
        let errors = [4e-3, 2e-3, 1e-3].map(|dt| {
            let top = top(momentum, dt, DURATION_S);
            assert_eq!(top.momentum, momentum, "it is conserved exactly");
            (top.orientation() * Vector3::z() - expected).norm()
        });
        assert!((expected - Vector3::z()).norm() > 0.3, "it moves: {expected}");
        for pair in errors.windows(2) {
            let order = (pair[0] / pair[1]).log2();
            assert!((1.9..2.1).contains(&order), "order {order}: {errors:?}");
        }
    }

    /// Compared: angle and angular velocity of a body under a constant moment about a principal axis, and ½ M/I t² and M/I t,
    /// which the steps give exactly.
    #[test]
    fn constant_moment_accelerates() {
        let mut body = RotatingBody::at_rest(Vector3::new(0.02, 0.03, 0.04));
        let (moment, dt) = (Vector3::new(0.0, 0.012, 0.0), 1e-3);
        for _ in 0..1000 {
            body.advance(moment, dt);
        }
        // Rounding of a thousand steps.
        let tolerance = 1000.0 * f64::EPSILON;
        assert!((body.angular_velocity() - Vector3::new(0.0, 0.4, 0.0)).norm() < tolerance);
        let angle = body.orientation().scaled_axis();
        assert!((angle - Vector3::new(0.0, 0.2, 0.0)).norm() < tolerance, "{angle}");
    }
}

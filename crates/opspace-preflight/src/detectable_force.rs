//! Smallest forces that an estimated force sensor can show.

use super::case::PreflightCase;
use super::diagnostic::short;
use nalgebra::Matrix6xX;
use opspace_loop::estimated_force::DAMPED_BELOW;
use opspace_model::{OperationalSpace, frame_jacobian};
use std::fmt;

/// Forces that an estimated force sensor cannot show, in world axes at the start of the task.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct DetectableForce {
    /// Name of the sensor.
    pub sensor: String,
    /// Error of the force at rest that static friction can cause, Σ |J̄| Fs, along x, y and z, N.
    pub at_rest_n: [f64; 3],
    /// Error of the force if all joints have 30 % more friction while they move than the nominal Coulomb friction, N.
    pub moving_n: [f64; 3],
    /// Three standard deviations of the noise of the motor torques, N; zero if the robot has no simulated noise.
    pub noise_n: [f64; 3],
}

impl fmt::Display for DetectableForce {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { sensor, at_rest_n, moving_n, noise_n } = self;
        let list = |values: &[f64; 3]| values.map(short).join(", ");
        write!(
            f,
            "estimated force '{sensor}', at the start, in x, y, z: static friction hides up to {} N at rest; friction 30 % off \
             adds up to {} N in motion; noise {} N",
            list(at_rest_n),
            list(moving_n),
            list(noise_n)
        )
    }
}

/// Error of the friction that is assumed for motion, relative.
const FRICTION_ERROR: f64 = 0.3;

/// Computes the smallest forces of all estimated sensors.
pub(super) fn detectable_forces_of(case: &PreflightCase<'_>) -> Vec<DetectableForce> {
    let robot = case.experiment.robot();
    let (joints, frames) = (robot.joints(), &robot.sensors[robot.file.force_sensor.len()..]);
    let noise = robot.file.simulated.as_ref().map_or(0.0, |simulated| simulated.torque_noise_nm.get());
    let period_s = case.experiment.profile().1.period_s();
    let force = |(name, frame): &(String, _)| {
        let parameters = &robot.file.estimated_force[name];
        let mut jacobian = Matrix6xX::zeros(case.model.n());
        frame_jacobian(case.model, &case.data, *frame, &mut jacobian);
        let mut space = OperationalSpace::new(case.model.n());
        space.update(&case.data.mass_matrix_factor, &jacobian, 3, DAMPED_BELOW);
        let share = |axis: usize, joint: usize| space.jbar_transpose[(axis, joint)].abs();
        let sum = |axis: usize, torque: &dyn Fn(usize) -> f64| -> f64 {
            (0..joints.len()).map(|joint| share(axis, joint) * torque(joint)).sum()
        };
        // White noise of one cycle through the low-pass of the observer: half of its gain remains of the variance.
        let gain = parameters.observer_rad_per_s.get() * period_s;
        let deviation = noise * (gain / (2.0 + gain)).sqrt();
        DetectableForce {
            sensor: name.clone(),
            at_rest_n: [0, 1, 2].map(|axis| sum(axis, &|joint| joints[joint].friction.static_nm.get())),
            moving_n: [0, 1, 2]
                .map(|axis| sum(axis, &|joint| FRICTION_ERROR * joints[joint].friction.coulomb_nm.get())),
            noise_n: [0, 1, 2].map(|axis| {
                let squares = (0..joints.len()).map(|joint| share(axis, joint).powi(2));
                3.0 * deviation * squares.sum::<f64>().sqrt()
            }),
        }
    };
    frames.iter().map(force).collect()
}

//! Measurement of a robot, the input of its controller.

use nalgebra::DVector;
use opspace_model::Force;

/// Measurement of one control cycle, in the same form for every backend. n is the number of joints.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// Time on the robot's clock since the controller was started, s.
    pub time_s: f64,
    /// Measured joint positions, rad or m (n).
    pub q: DVector<f64>,
    /// Joint velocities estimated by the backend, rad/s or m/s (n).
    pub dq: DVector<f64>,
    /// Measured motor torque at the joint (motor current times torque constant), Nm (n): mean over the last cycle.
    /// `None` if the robot does not measure it.
    pub motor_torque: Option<DVector<f64>>,
    /// Wrenches that act ON the robot at the force sensors, in the order in which the robot declares them: world axes,
    /// at the sensor frame's origin, tared at start (N, Nm).
    pub wrenches: Vec<Force>,
}

impl Measurement {
    /// Creates a measurement of zeros for `n` joints and `sensors` force sensors.
    #[must_use]
    pub fn new(n: usize, sensors: usize, motor_torque: bool) -> Self {
        Self {
            time_s: 0.0,
            q: DVector::zeros(n),
            dq: DVector::zeros(n),
            motor_torque: motor_torque.then(|| DVector::zeros(n)),
            wrenches: vec![Force::zero(); sensors],
        }
    }
}

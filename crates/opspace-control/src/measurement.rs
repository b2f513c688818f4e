//! Measurement of a robot, as its controller receives it.

use nalgebra::DVector;
use opspace_model::Force;

/// Measurement of one control cycle, the same from every backend. n is the number of joints.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// Time on the robot's clock since the controller was started, s.
    pub time_s: f64,
    /// Joint positions as measured, rad or m (n).
    pub q: DVector<f64>,
    /// Joint velocities as estimated by the backend, rad/s or m/s (n).
    pub dq: DVector<f64>,
    /// Motor torque at the joint as measured (motor current times torque constant), Nm (n): the mean since the last
    /// cycle. `None` if this robot doesn't measure it.
    pub motor_torque: Option<DVector<f64>>,
    /// Wrenches of the force sensors, in the order in which the robot declares them: world axes, at the
    /// sensor frame's origin, ON the robot, tared at start (N, Nm).
    pub wrenches: Vec<Force>,
}

impl Measurement {
    /// All zero, with room for `n` joints and `sensors` force sensors.
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

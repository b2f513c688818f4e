//! The measurements of one interface cycle.

use crate::capabilities::Capabilities;

/// Raw measurements of a robot at one interface cycle. Joints and force sensors are in the order of the robot's
/// [`Capabilities`]. An optional quantity is present either in every sample or in none.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Sample {
    /// Time on the robot's monotonic clock, s. Its zero is arbitrary. A time that is not finite, that does not increase, or
    /// that is more than an hour ahead of the last one ends the run.
    pub time_s: f64,
    /// Joint positions, rad or m (n). Those of joints without limits may be within one turn.
    pub q: Vec<f64>,
    /// Joint velocities, rad/s or m/s (n).
    pub dq: Option<Vec<f64>>,
    /// Motor torques at the joints (motor current times torque constant), Nm or N (n): the mean since the last sample,
    /// without the gravity torques that the robot adds itself.
    pub motor_torque: Option<Vec<f64>>,
    /// Torques measured at the joints, Nm or N (n).
    pub joint_torque: Option<Vec<f64>>,
    /// Raw readings of the force sensors, each in the sensor's axes: the wrench that acts ON the robot, as fx, fy, fz
    /// (N), mx, my, mz (Nm).
    pub wrenches: Vec<[f64; 6]>,
    /// Status reported by the robot.
    pub status: Option<Status>,
}

/// Status reported by a robot in a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Status {
    /// Status word of the device.
    pub word: u32,
    /// True if the device modified the last command to respect its own limits.
    pub command_limited: bool,
}

impl Status {
    /// Returns a status.
    #[must_use]
    pub fn new(word: u32, command_limited: bool) -> Self {
        Self { word, command_limited }
    }
}

impl Sample {
    /// Returns a sample of zeros, allocated for all quantities that the robot declares as measured.
    #[must_use]
    pub fn new(capabilities: &Capabilities) -> Self {
        let n = capabilities.joints.len();
        let zeros = |measured: bool| measured.then(|| vec![0.0; n]);
        Self {
            time_s: 0.0,
            q: vec![0.0; n],
            dq: zeros(capabilities.measures_velocity),
            motor_torque: zeros(capabilities.measures_motor_torque),
            joint_torque: zeros(capabilities.measures_joint_torque),
            wrenches: vec![[0.0; 6]; capabilities.force_sensors.len()],
            status: capabilities.reports_status.then(Status::default),
        }
    }

    /// Copies another sample of the same robot; quantities that this sample does not contain are skipped. A quantity
    /// that only this sample contains becomes NaN, a status that only this sample contains is unchanged. Does not
    /// allocate.
    ///
    /// # Panics
    /// If the lengths of two arrays differ.
    pub fn copy_from(&mut self, other: &Self) {
        fn copy(to: &mut Option<Vec<f64>>, from: &Option<Vec<f64>>) {
            match (to, from) {
                (Some(to), Some(from)) => to.copy_from_slice(from),
                (Some(to), None) => to.fill(f64::NAN),
                (None, _) => {}
            }
        }
        self.time_s = other.time_s;
        self.q.copy_from_slice(&other.q);
        copy(&mut self.dq, &other.dq);
        copy(&mut self.motor_torque, &other.motor_torque);
        copy(&mut self.joint_torque, &other.joint_torque);
        self.wrenches.copy_from_slice(&other.wrenches);
        if let (Some(to), Some(from)) = (&mut self.status, other.status) {
            *to = from;
        }
    }
}

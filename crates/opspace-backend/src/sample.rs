//! The measurements of one interface cycle.

/// Raw measurements of a robot at one interface cycle, in the order of its joints and force sensors.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Sample {
    /// The robot's monotonic clock, s.
    pub time_s: f64,
    /// Joint positions, rad or m (n).
    pub q: Vec<f64>,
    /// Mean motor torques since the last sample, Nm or N (n); `None` if the robot does not measure them.
    pub motor_torque: Option<Vec<f64>>,
    /// Force sensor readings, raw, in each sensor's axes, ON the robot: fx, fy, fz (N), mx, my, mz (Nm).
    pub wrenches: Vec<[f64; 6]>,
}

impl Sample {
    /// A sample of zeros for `n` joints and `sensors` force sensors.
    #[must_use]
    pub fn new(n: usize, motor_torque: bool, sensors: usize) -> Self {
        Self {
            time_s: 0.0,
            q: vec![0.0; n],
            motor_torque: motor_torque.then(|| vec![0.0; n]),
            wrenches: vec![[0.0; 6]; sensors],
        }
    }
}

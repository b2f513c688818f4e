//! Parameters of a joint that are known before its static identification.

/// Parameters of a joint that are known before its static identification.
#[derive(Clone, Debug)]
pub struct StaticParameters {
    /// Index of the joint in the robot's order.
    pub joint: usize,
    /// Position limits of all joints, lower and upper (n; rad, m).
    pub limits: Vec<[f64; 2]>,
    /// Resolution of the joint position, rad (m).
    pub resolution: f64,
    /// Resolution of setpoints, rad (m); 0 if they are exact.
    pub setpoint_resolution: f64,
    /// Declared stiffness of the servo, Nm/rad (N/m).
    pub stiffness: f64,
    /// Time by which the drive's mean position under a setpoint is before the next sample, in comparison with its mean setpoint, s: half
    /// of a control cycle and of a servo tick for setpoints that are held, a servo tick for interpolated ones, less their delay.
    pub lead_s: f64,
    /// Declared damping of the servo against its own velocity, Nms/rad (Ns/m). It acts like viscous friction.
    pub damping: f64,
}

//! Keys of robot.toml without a default: each with its meaning, its typical range, and where one finds it.

/// Key of robot.toml without a default.
pub struct Required {
    /// Path below the file, the joint, the profile or the servo.
    pub path: &'static [&'static str],
    /// Meaning, with unit.
    pub(crate) meaning: &'static str,
    /// Typical range, with units; empty if there is none.
    typical: &'static str,
    /// Place where one finds the value.
    pub(crate) found: &'static str,
}

const fn required(
    path: &'static [&'static str],
    meaning: &'static str,
    typical: &'static str,
    found: &'static str,
) -> Required {
    Required { path, meaning, typical, found }
}

impl Required {
    /// Meaning and typical range.
    pub(crate) fn about(&self) -> String {
        match self.typical {
            "" => self.meaning.to_owned(),
            typical => format!("{}; {typical}", self.meaning),
        }
    }

    /// Line of a robot.toml in which the value is still missing.
    pub fn line(&self) -> String {
        let key = self.path.last().copied().unwrap_or_default();
        format!("{:<29} # {}\n", format!("# {key} ="), self.meaning)
    }
}

/// All keys without a default.
pub fn all() -> impl Iterator<Item = &'static Required> {
    let servos = OF_SERVO.iter().chain(&OF_VELOCITY_SERVO);
    let single = [&SETPOINTS, &VELOCITY_LIMIT];
    OF_FILE.iter().chain(single).chain(&OF_JOINT).chain(&OF_PROFILE).chain(servos)
}

pub(crate) const OF_FILE: [Required; 3] = [
    required(
        &["interface", "command"],
        "accepted command: \"position\", \"velocity\" or \"torque\"",
        "",
        "manual of the robot's interface",
    ),
    required(
        &["interface", "gravity_compensated_by"],
        "\"controller\", or \"robot\" if the robot adds the torques that bear its weight",
        "",
        "manual of the robot's interface; position robots: \"controller\"",
    ),
    required(
        &["interface", "measured"],
        "[\"position\"], or [\"position\", \"motor-current\"]",
        "",
        "manual of the robot's interface",
    ),
];

pub(crate) const SETPOINTS: Required = required(
    &["interface", "setpoints"],
    "\"held\" until the next setpoint, or \"interpolated\" by the drives",
    "",
    "manual of the robot's interface",
);

pub(crate) const OF_JOINT: [Required; 5] = [
    required(
        &["torque_limit_nm"],
        "torque limit of the drive at the joint, Nm (N)",
        "typically 5 to 500 Nm",
        "data sheet of the arm; peak torque of the motor times gear ratio; effort in the URDF",
    ),
    required(
        &["rotor", "inertia_kg_m2"],
        "inertia of all parts that turn at motor speed, kg m²",
        "typically 1e-7 to 1e-3",
        "data sheet of the motor",
    ),
    required(
        &["rotor", "gear_ratio"],
        "motor turns per joint turn (prismatic: motor radians per metre)",
        "typically 1 to 200",
        "data sheet of the gear",
    ),
    required(
        &["friction", "coulomb_nm"],
        "Coulomb friction, Nm (N)",
        "typically 1 to 8 % of the torque limit; 0 for none",
        "`opspace identify`; <dynamics friction> in the URDF",
    ),
    required(
        &["friction", "viscous_nms_per_rad"],
        "viscous friction, Nms/rad (Ns/m)",
        "typically 0 to 5 % of the torque limit per rad/s",
        "`opspace identify`; <dynamics damping> in the URDF",
    ),
];

pub(crate) const VELOCITY_LIMIT: Required = required(
    &["velocity_limit_rad_per_s"],
    "largest speed, rad/s (m/s)",
    "typically 1 to 6 rad/s; the URDF has none",
    "data sheet of the arm; velocity in the joint's <limit> in the URDF",
);

pub(crate) const OF_PROFILE: [Required; 2] = [
    required(
        &["servo_hz"],
        "rate of the servo loops, Hz",
        "typically 500 to 20000",
        "data sheet of the drives; the rate of the interface if unknown",
    ),
    required(
        &["servo_ticks_per_cycle"],
        "servo ticks per command, a whole number",
        "typically 1 to 10",
        "servo_hz over the rate of the interface",
    ),
];

pub(crate) const OF_SERVO: [Required; 3] = [
    required(
        &["cascaded", "kp_per_s"],
        "gain of the position loop, 1/s",
        "typically 10 to 100",
        "`opspace identify`; settings of the drives",
    ),
    required(
        &["cascaded", "kv_nms_per_rad"],
        "gain of the velocity loop, Nms/rad (Ns/m)",
        "typically 60 to 300 times the inertia at the joint",
        "`opspace identify`; settings of the drives",
    ),
    required(
        &["cascaded", "velocity_filter_hz"],
        "low-pass filter of the servo's velocity, Hz",
        "typically 100 to 1000",
        "`opspace identify`; settings of the drives",
    ),
];

pub(crate) const OF_VELOCITY_SERVO: [Required; 2] = [
    required(
        &["kv_nms_per_rad"],
        "gain of the velocity loop, Nms/rad (Ns/m)",
        "typically 60 to 300 times the inertia at the joint",
        "`opspace identify`; settings of the drives",
    ),
    required(
        &["velocity_filter_hz"],
        "low-pass filter of the servo's velocity, Hz",
        "typically 100 to 1000",
        "`opspace identify`; settings of the drives",
    ),
];

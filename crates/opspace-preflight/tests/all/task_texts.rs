//! Texts of tasks without findings, in which `ROBOTS` is the folder of the robots.

/// A hand that moves.
pub const HAND: &str = r#"
robot = "ROBOTS/asimo-arm"
duration_s = 2.0
settle_s = 0.5
priority = ["hand", "rest"]
start_rad = { shoulder_pitch = -0.45, shoulder_roll = -0.35, shoulder_yaw = 0.25, elbow = -1.35 }
friction_compensation = { gain = 1.0 }

[task.hand.cartesian]
frame = "hand"
axes = { x = "motion", y = "motion", z = "motion" }
gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }
reference.point-to-point = { position = { offset_m = [0.05, 0.0, 0.05] }, duration_s = 1.0 }

[task.rest.joint-posture]
frequency_rad_per_s = 6.0
damping_ratio = 0.8
"#;

/// Two links of 1 m in the x-z plane that rest.
pub const TIP: &str = r#"
robot = "ROBOTS/planar-2-link"
duration_s = 2.0
settle_s = 0.5
priority = ["tip"]
start_rad = { shoulder = 0.6, elbow = 1.2 }

[task.tip.cartesian]
frame = "tip"
axes = { x = "motion", z = "motion" }
gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }
reference = "hold"
"#;

/// The hand of inverse kinematics presses down, on nothing yet.
pub const PRESS: &str = r#"
robot = "ROBOTS/asimo-arm"
duration_s = 1.5
settle_s = 1.0
priority = ["hand", "rest"]
start_rad = { shoulder_pitch = -0.45, shoulder_roll = -0.35, shoulder_yaw = 0.25, elbow = -1.35 }

[task.hand.cartesian]
frame = "hand"
axes = { x = "motion", y = "motion", z = "force" }
gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }
reference = "hold"
force = { sensor = "wrist", target_n = { z = 20.0 }, admittance_ns_per_m = 100.0 }

[task.rest.joint-posture]
frequency_rad_per_s = 6.0
damping_ratio = 0.8
"#;

/// A table of a stiffness (N/m) below this hand.
pub fn table(stiffness: f64) -> String {
    format!(
        "[environment.table.wall]\nframe = \"hand\"\npoint_m = [0.0, 0.0, -0.164]\nnormal = [0.0, 0.0, 1.0]\n\
         stiffness_n_per_m = {stiffness:?}\ndamping_ns_per_m = 5.0"
    )
}

//! Task sets of a hand, and of a hand and an upper arm.

/// Characteristic length of the files below, m.
pub const LENGTH_M: f64 = 0.4;

pub const POSE: &str = r#"
priority = ["hand", "rest"]
[task.hand.cartesian]
frame = "hand"
axes = { x = "motion", y = "motion", z = "motion", rx = "motion", ry = "motion", rz = "motion" }
reference = "hold"
gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }
characteristic_length_m = 0.4
[task.rest.joint-posture]
frequency_rad_per_s = 9.0
damping_ratio = 0.8
"#;

pub const ELBOW: &str = r#"
priority = ["hand", "elbow", "rest"]
[task.hand.cartesian]
frame = "hand"
axes = { x = "motion", y = "motion", z = "motion" }
reference = "hold"
gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }
[task.elbow.cartesian]
frame = "upper"
axes = { z = "motion" }
reference = "hold"
gains = { frequency_rad_per_s = 11.0, damping_ratio = 1.0 }
[task.rest.joint-posture]
frequency_rad_per_s = 9.0
damping_ratio = 0.8
"#;

pub const DAMPED: &str = r#"
priority = ["hand", "rest"]
[task.hand.cartesian]
frame = "hand"
axes = { x = "motion", y = "motion", z = "motion" }
reference = "hold"
gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }
[task.rest.joint-damping]
damping_nms_per_rad = 3.0
"#;

pub const COMPLIANT: &str = r#"
priority = ["hand", "rest"]
[task.hand.cartesian]
frame = "hand"
axes = { x = "compliant", y = "motion", z = "motion", rz = "compliant" }
reference = "hold"
gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }
force = { sensor = "wrist", filter_hz = 100.0 }
characteristic_length_m = 0.4
[task.rest.joint-posture]
frequency_rad_per_s = 9.0
damping_ratio = 0.8
"#;

/// Returns the file without limits.
pub fn without_limits(text: &str) -> String {
    format!("limits.enforce = false\n{text}")
}

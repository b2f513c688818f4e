//! Arms with elastic gears.

use std::path::{Path, PathBuf};

/// An arm with the stiffness of its gears, Nm/rad: those of the suite `servos-matrix`.
pub struct Arm {
    pub folder: &'static str,
    pub frame: &'static str,
    /// Length that scales rotations to displacements, and sizes of motions, m.
    pub reach_m: f64,
    pub gears: &'static [(&'static str, f64)],
}

pub const ARMS: [Arm; 2] = [
    Arm {
        folder: "panda",
        frame: "flange",
        reach_m: 0.9,
        gears: &[
            ("joint1", 20e3),
            ("joint2", 16e3),
            ("joint3", 12e3),
            ("joint4", 10e3),
            ("joint5", 8e3),
            ("joint6", 6e3),
            ("joint7", 5e3),
        ],
    },
    Arm {
        folder: "ur5e",
        frame: "flange",
        reach_m: 0.95,
        gears: &[
            ("base", 20e3),
            ("shoulder", 15e3),
            ("elbow", 12e3),
            ("wrist_1", 8e3),
            ("wrist_2", 6e3),
            ("wrist_3", 5e3),
        ],
    },
];

/// Damping of a gear, as a share of its stiffness, s.
const GEAR_DAMPING_S: f64 = 0.25e-3;

impl Arm {
    /// File of the robot.
    pub fn file(&self) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../robots").join(self.folder).join("robot.toml")
    }

    /// Setting that makes the gears elastic, with `scale` times their stiffness.
    pub fn elastic_gears(&self, scale: f64) -> String {
        let gears = self.gears.iter().map(|(joint, stiffness)| {
            let stiffness = scale * stiffness;
            let damping = GEAR_DAMPING_S * stiffness;
            format!("{joint} = {{ stiffness_nm_per_rad = {stiffness:.1}, damping_nms_per_rad = {damping} }}")
        });
        format!("robot.simulated.gear={{ {} }}", gears.collect::<Vec<_>>().join(", "))
    }
}

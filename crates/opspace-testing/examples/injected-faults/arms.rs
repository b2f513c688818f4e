//! Arms of the tasks, with what they bear in a posture.

use nalgebra::{Matrix6xX, Vector3};
use opspace_experiment::{Files, RobotDefinition};
use opspace_model::{Data, frame_jacobian, frame_placement, update};
use std::path::{Path, PathBuf};

/// Arm of the repository, or of the examples.
pub struct Arm {
    pub name: &'static str,
    folder: &'static str,
    pub frame: &'static str,
    /// Link of the URDF that carries a tool.
    pub link: &'static str,
    /// Axes of translation and rotation that a task can control.
    pub axes: &'static [&'static str],
    /// Size of its motions, m.
    pub size_m: f64,
    /// Posture about which it starts, rad.
    pub usual: &'static [f64],
}

pub const ARMS: [Arm; 4] = [
    Arm {
        name: "panda",
        folder: "../../robots/panda",
        frame: "flange",
        link: "flange",
        axes: &["x", "y", "z", "rx", "ry", "rz"],
        size_m: 0.1,
        usual: &[0.0, -0.8, 0.0, -2.3, 0.0, 1.5, 0.8],
    },
    Arm {
        name: "ur5e",
        folder: "../../robots/ur5e",
        frame: "flange",
        link: "flange",
        axes: &["x", "y", "z", "rx", "ry", "rz"],
        size_m: 0.1,
        usual: &[0.0, -1.5, -1.6, -1.5, 1.6, 0.0],
    },
    Arm {
        name: "asimo-arm",
        folder: "../../robots/asimo-arm",
        frame: "hand",
        link: "hand",
        axes: &["x", "y", "z"],
        size_m: 0.05,
        usual: &[-0.45, -0.35, 0.25, -1.35],
    },
    Arm {
        name: "planar-4-link",
        folder: "examples/rest",
        frame: "tip",
        link: "tip",
        axes: &["x", "z"],
        size_m: 0.15,
        usual: &[0.6, 0.8, 0.7, 0.6],
    },
];

impl Arm {
    /// File of the robot.
    pub fn file(&self) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join(self.folder).join("robot.toml")
    }

    pub fn robot(&self, settings: &[String]) -> RobotDefinition {
        RobotDefinition::load(Files::Disk, &self.file(), settings)
            .unwrap_or_else(|e| panic!("{e}: {settings:?}"))
    }
}

/// State of an arm in a posture.
pub struct Posture {
    robot: RobotDefinition,
    data: Data,
    jacobian: Matrix6xX<f64>,
    /// Position of the arm's frame, m.
    pub position: Vector3<f64>,
}

impl Posture {
    pub fn new(arm: &Arm, settings: &[String], q: &[f64]) -> Self {
        let robot = arm.robot(settings);
        let mut data = Data::new(&robot.model);
        assert!(update(&robot.model, &mut data, q, &vec![0.0; q.len()]), "a posture");
        let frame = robot.model.frame_id(arm.frame).expect("a frame");
        let mut jacobian = Matrix6xX::zeros(q.len());
        frame_jacobian(&robot.model, &data, frame, &mut jacobian);
        let position = frame_placement(&robot.model, &data, frame).translation;
        Self { robot, data, jacobian, position }
    }

    /// Force along a direction that the frame can exert until a joint reaches its torque limit, N.
    pub fn largest_force_n(&self, direction: &Vector3<f64>) -> f64 {
        let limits = self.robot.torque_limits();
        let joints = self.jacobian.column_iter().zip(self.data.gravity.iter()).zip(&limits);
        let of_joint = joints.map(|((column, gravity), limit)| {
            let lever = column.fixed_rows::<3>(0).dot(direction);
            let left = limit - gravity * lever.signum();
            if lever.abs() < 1e-9 { f64::INFINITY } else { left / lever.abs() }
        });
        of_joint.fold(f64::INFINITY, f64::min)
    }

    /// Mass in the frame's origin that the arm can hold, kg.
    pub fn largest_mass_kg(&self) -> f64 {
        self.largest_force_n(&Vector3::z()) / 9.81
    }
}

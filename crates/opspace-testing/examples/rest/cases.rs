//! Random tasks with a constant goal, on arms with and without friction, rotors, noise and a posture.

use crate::search::{Goal, Kept, Search};
use nalgebra::{UnitQuaternion, Vector3};
use opspace_backend::CommandKind;
use opspace_control::CollisionLimits;
use opspace_experiment::{Experiment, Files, RunOptions, TaskDefinition};
use opspace_model::Model;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::{Path, PathBuf};

/// Time at which the reference reaches its goal, s.
pub const ARRIVAL_S: f64 = 1.0;
/// Time after [`ARRIVAL_S`] within which the arm comes to rest, s.
pub const SETTLING_S: f64 = 5.0;
/// Time over which the arm at rest is observed, s.
pub const OBSERVED_S: f64 = 2.0;

/// An arm of the repository or of this folder.
struct Arm {
    folder: PathBuf,
    frame: &'static str,
    /// Axes of a task of the position, and of the position and orientation.
    axes: [&'static [&'static str]; 2],
    /// Length that scales rotations to displacements, m.
    reach_m: f64,
}

fn arm(number: usize) -> Arm {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let robots = root.join("../../robots");
    let all: [&'static [&'static str]; 2] = [&["x", "y", "z"], &["x", "y", "z", "rx", "ry", "rz"]];
    match number {
        0 => Arm { folder: robots.join("panda"), frame: "flange", axes: all, reach_m: 0.9 },
        1 => Arm { folder: robots.join("ur5e"), frame: "flange", axes: all, reach_m: 0.95 },
        _ => Arm {
            folder: root.join("examples/rest"),
            frame: "tip",
            axes: [&["x", "z"], &["x", "z", "ry"]],
            reach_m: 1.6,
        },
    }
}

/// Properties of a case.
#[derive(Clone, Copy, Debug)]
pub struct Kind {
    arm: usize,
    pub backend: CommandKind,
    pose: bool,
    pub posture: bool,
    rotors: bool,
    pub friction: bool,
    pub noise: bool,
}

/// A case with its goals, relative to the start pose.
pub struct Case {
    pub number: usize,
    pub kind: Kind,
    arm: Arm,
    pub model: Model,
    start: Vec<f64>,
    unreachable: Goal,
    reachable: Goal,
    task: String,
    settings: Vec<String>,
}

/// Goal of an experiment.
pub enum GoalKind {
    Unreachable,
    Reachable,
    /// The pose of the arm at this start posture.
    At(Vec<f64>),
}

impl Kind {
    /// Properties of the case of this number: arm, robot and axes in turn, all others at random.
    pub fn new(number: usize, random: &mut ChaCha8Rng) -> Self {
        Self {
            arm: number % 3,
            backend: if (number / 3).is_multiple_of(2) { CommandKind::Torque } else { CommandKind::Position },
            pose: (number / 6) % 2 == 1,
            posture: random.random(),
            rotors: random.random(),
            friction: random.random(),
            noise: random.random(),
        }
    }
}

impl Case {
    /// Creates the case of this number and seed.
    pub fn new(number: usize, seed: u64) -> Self {
        let mut random =
            ChaCha8Rng::seed_from_u64(seed.wrapping_mul(0x9e37_79b9).wrapping_add(number as u64));
        let kind = Kind::new(number, &mut random);
        let arm = arm(kind.arm);
        let robot =
            opspace_experiment::RobotDefinition::load(Files::Disk, &arm.folder.join("robot.toml"), &[])
                .expect("a robot of the repository");
        let model = robot.model.clone();
        let mut search = Search::new(&model, arm.frame, arm.axes[usize::from(kind.pose)], arm.reach_m);
        let start = search.inner_posture(&mut random, 0.8);
        let reachable = search.goal_at(&start.clone(), &mut random);
        let unreachable = search.unreachable(&start, &mut random);
        let rotors: Vec<f64> = robot.joints().iter().map(|joint| joint.rotor.inertia_kg_m2.get()).collect();
        let (task, settings) = text(&kind, &arm, &model, &rotors);
        Self { number, kind, arm, model, start, unreachable, reachable, task, settings }
    }

    /// Experiment of this kind.
    pub fn experiment(&self, goal: &GoalKind) -> Experiment {
        let (start, goal) = match goal {
            GoalKind::Unreachable => (&self.start, self.unreachable),
            GoalKind::Reachable => (&self.start, self.reachable),
            GoalKind::At(q) => {
                (q, Goal { position: Vector3::zeros(), orientation: UnitQuaternion::identity() })
            }
        };
        let [x, y, z] = goal.position.into();
        let mut goals = format!("position = {{ offset_m = [{x}, {y}, {z}] }}");
        if self.kind.pose {
            let (roll, pitch, yaw) = goal.orientation.euler_angles();
            goals += &format!(", orientation = {{ offset_rpy_rad = [{roll}, {pitch}, {yaw}] }}");
        }
        let joints = self.model.joints().iter().zip(start);
        let starts: Vec<String> = joints.map(|(joint, q)| format!("{} = {q}", joint.name)).collect();
        let text = self.task.replace("GOAL", &goals).replace("START", &starts.join(", "));
        let source = opspace_experiment::Source::new("rest.toml", text);
        let task = TaskDefinition::from_sources(source, |_| -> Result<_, opspace_experiment::FileError> {
            unreachable!("the task has no path")
        })
        .unwrap_or_else(|error| panic!("{error}"));
        let robot = opspace_experiment::RobotDefinition::load(
            Files::Disk,
            &self.arm.folder.join("robot.toml"),
            &self.settings,
        )
        .unwrap_or_else(|error| panic!("{error}"));
        let options = RunOptions { backend: self.kind.backend, ..RunOptions::default() };
        Experiment::new(robot, task, options, Vec::new()).unwrap_or_else(|error| panic!("{error}"))
    }

    pub fn describe(&self) -> String {
        let Kind { arm, backend, pose, posture, rotors, friction, noise, .. } = self.kind;
        let yes = |flag: bool, name: &str| if flag { format!(" {name}") } else { String::new() };
        format!(
            "{} {}{}{}{}{}{}",
            ["panda", "ur5e", "planar"][arm],
            if backend == CommandKind::Torque { "torque" } else { "position" },
            if pose { " 6D" } else { " 3D" },
            yes(posture, "posture"),
            yes(rotors, "rotors"),
            yes(friction, "friction"),
            yes(noise, "noise"),
        )
    }

    /// Error of the task at a posture with the unreachable goal, and the least error that a local descent from there
    /// finds that keeps the distances of `collision` or those at `q`, m.
    pub fn residual(&self, q: &[f64], collision: Option<&CollisionLimits>) -> (f64, f64) {
        let axes = self.arm.axes[usize::from(self.kind.pose)];
        let mut search = Search::new(&self.model, self.arm.frame, axes, self.arm.reach_m);
        let target = search.target(&self.start, self.unreachable);
        let own = search.error(q, &target).norm();
        search.collision = collision.map(Kept::new);
        (own, search.descend(q.to_vec(), &target).1)
    }
}

/// Text of the task file without start and goal, and the settings of the robot file.
fn text(kind: &Kind, arm: &Arm, model: &Model, rotors: &[f64]) -> (String, Vec<String>) {
    let joints: Vec<&str> = model.joints().iter().map(|joint| joint.name.as_str()).collect();
    let axes: Vec<String> =
        arm.axes[usize::from(kind.pose)].iter().map(|axis| format!("{axis} = \"motion\"")).collect();
    let mut text = format!(
        "robot = \"unused\"\nduration_s = {}\nseed = 1\npriority = [\"hand\"{}]\n",
        ARRIVAL_S + SETTLING_S + OBSERVED_S,
        if kind.posture { ", \"rest\"" } else { "" },
    );
    if kind.friction {
        text += "friction_compensation = { gain = 0.8 }\n";
    }
    text += "start_rad = { START }\n";
    text += &format!(
        "[task.hand.cartesian]\nframe = \"{}\"\naxes = {{ {} }}\ngains = {{ frequency_rad_per_s = 20.0, damping_ratio = \
         1.0 }}\nreference.point-to-point = {{ GOAL, duration_s = {ARRIVAL_S} }}\n",
        arm.frame,
        axes.join(", "),
    );
    if kind.posture {
        text += "[task.rest.joint-posture]\nfrequency_rad_per_s = 6.0\ndamping_ratio = 1.0\n";
    }
    let mut settings = Vec::new();
    for (joint, rotor) in joints.into_iter().zip(rotors) {
        if !kind.friction {
            let none =
                "{ coulomb_nm = 0.0, static_nm = 0.0, stribeck_rad_per_s = 0.06, viscous_nms_per_rad = 0.0 }";
            settings.push(format!("robot.joint.{joint}.friction={none}"));
        }
        if !kind.noise {
            settings.push(format!("robot.joint.{joint}.rotor.encoder_counts_per_turn=1000000000"));
        }
        if !kind.rotors && kind.backend == CommandKind::Torque {
            settings.push(format!("robot.joint.{joint}.rotor.inertia_kg_m2={}", 0.1 * rotor));
        }
    }
    if !kind.noise {
        settings.push("robot.simulated.torque_noise_nm=0.0".to_owned());
    }
    (text, settings)
}

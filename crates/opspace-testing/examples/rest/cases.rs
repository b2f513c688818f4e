//! Random tasks with a constant goal, on arms with and without friction, rotors, noise and a posture.

use nalgebra::{DMatrix, DVector, Matrix6xX, Rotation3, UnitQuaternion, Vector3, Vector6};
use opspace_backend::CommandKind;
use opspace_control::CollisionLimits;
use opspace_experiment::{Experiment, Files, RunOptions, TaskDefinition};
use opspace_model::collision::{CollisionData, collision_distances, distance_gradient};
use opspace_model::{Data, Model, frame_jacobian, update};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::{Path, PathBuf};

/// Time at which the reference reaches its goal, s.
pub const ARRIVAL_S: f64 = 1.0;
/// Time after [`ARRIVAL_S`] within which the arm comes to rest, s.
pub const SETTLING_S: f64 = 5.0;
/// Time over which the arm at rest is observed, s.
pub const OBSERVED_S: f64 = 2.0;

/// Number of descents from random postures that look for a posture at the goal.
const DESCENTS: usize = 30;

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

#[derive(Clone, Copy, Debug)]
struct Goal {
    position: Vector3<f64>,
    orientation: UnitQuaternion<f64>,
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

/// Distances that a search keeps.
struct Kept<'a> {
    limits: &'a CollisionLimits,
    data: CollisionData,
}

impl<'a> Kept<'a> {
    fn new(limits: &'a CollisionLimits) -> Self {
        Self { limits, data: CollisionData::new(&limits.geometry) }
    }

    /// Pairs closer than the margin in the state of `data`: by how much (m), and the gradient of the distance.
    fn violated(&mut self, model: &Model, data: &Data) -> Vec<(f64, DVector<f64>)> {
        let Self { limits, data: distances } = self;
        let margin_m = limits.margin_m;
        collision_distances(&limits.geometry, model, data, margin_m, distances);
        let pairs = distances.near().map(|(pair, proximity)| {
            let mut gradient = DVector::zeros(model.n());
            distance_gradient(&limits.geometry, model, data, pair, proximity, gradient.as_mut_slice());
            (margin_m - proximity.distance_m, gradient)
        });
        pairs.collect()
    }
}

/// Weight of the distances that a search keeps, relative to the error of the task.
const KEPT: f64 = 30.0;

/// Search for postures at a goal, within the position limits.
struct Search<'a> {
    collision: Option<Kept<'a>>,
    model: &'a Model,
    data: Data,
    frame: opspace_model::FrameId,
    rows: Vec<usize>,
    length_m: f64,
}

impl<'a> Search<'a> {
    fn new(model: &'a Model, frame: &str, axes: &[&str], length_m: f64) -> Self {
        let all = ["x", "y", "z", "rx", "ry", "rz"];
        Self {
            collision: None,
            model,
            data: Data::new(model),
            frame: model.frame_id(frame).expect("a frame"),
            rows: axes.iter().map(|axis| all.iter().position(|x| x == axis).expect("an axis")).collect(),
            length_m,
        }
    }

    /// Position limits with the margin that the controller keeps.
    fn range(&self, i: usize) -> (f64, f64) {
        let limits = &self.model.joints()[i].limits;
        (limits.lower.max(-6.2) + 0.01, limits.upper.min(6.2) - 0.01)
    }

    /// Random posture within the given fraction of the joint ranges, at most 2 rad from the centre.
    fn inner_posture(&self, random: &mut impl Rng, fraction: f64) -> Vec<f64> {
        (0..self.model.n())
            .map(|i| {
                let (lower, upper) = self.range(i);
                let half = (0.5 * fraction * (upper - lower)).min(2.0);
                0.5 * (lower + upper) + half * random.random_range(-1.0..1.0)
            })
            .collect()
    }

    fn pose(&mut self, q: &[f64]) -> Goal {
        assert!(update(self.model, &mut self.data, q, &vec![0.0; q.len()]));
        let placement = opspace_model::frame_placement(self.model, &self.data, self.frame);
        let rotation = Rotation3::from_matrix_unchecked(placement.rotation);
        Goal { position: placement.translation, orientation: UnitQuaternion::from_rotation_matrix(&rotation) }
    }

    /// The goal in the world.
    fn target(&mut self, start: &[f64], goal: Goal) -> Goal {
        let pose = self.pose(start);
        Goal { position: pose.position + goal.position, orientation: goal.orientation * pose.orientation }
    }

    /// Error of the controlled rows, rotations scaled by the length.
    fn error(&mut self, q: &[f64], target: &Goal) -> Vector6<f64> {
        let pose = self.pose(q);
        let turn = (target.orientation * pose.orientation.inverse()).scaled_axis() * self.length_m;
        let far = target.position - pose.position;
        let mut error = Vector6::zeros();
        for (k, &row) in self.rows.iter().enumerate() {
            error[k] = if row < 3 { far[row] } else { turn[row - 3] };
        }
        error
    }

    /// Error and kept distances at a posture: the error of the rows, then by how much each pair is too close, weighted;
    /// with the derivatives (one row each).
    fn residuals(&mut self, q: &[f64], target: &Goal) -> (DVector<f64>, DMatrix<f64>) {
        let (n, error) = (q.len(), self.error(q, target));
        let mut jacobian = Matrix6xX::zeros(n);
        frame_jacobian(self.model, &self.data, self.frame, &mut jacobian);
        let violated =
            self.collision.as_mut().map(|kept| kept.violated(self.model, &self.data)).unwrap_or_default();
        let count = self.rows.len();
        let mut values = DVector::zeros(count + violated.len());
        let mut rows = DMatrix::zeros(values.len(), n);
        for (r, &row) in self.rows.iter().enumerate() {
            values[r] = error[r];
            rows.row_mut(r).copy_from(&(jacobian.row(row) * if row < 3 { 1.0 } else { self.length_m }));
        }
        for (k, (depth, gradient)) in violated.iter().enumerate() {
            values[count + k] = KEPT * depth;
            rows.row_mut(count + k).copy_from(&(gradient.transpose() * KEPT));
        }
        (values, rows)
    }

    /// Levenberg-Marquardt steps with clamped joints; returns the posture and the norm of its error.
    fn descend(&mut self, mut q: Vec<f64>, target: &Goal) -> (Vec<f64>, f64) {
        let n = q.len();
        let (mut values, mut rows) = self.residuals(&q, target);
        let mut best = values.norm();
        let mut damping = 1e-3;
        for _ in 0..300 {
            let gradient = rows.transpose() * &values;
            let held: Vec<bool> = (0..n)
                .map(|i| {
                    let (lower, upper) = self.range(i);
                    (q[i] >= upper && gradient[i] > 0.0) || (q[i] <= lower && gradient[i] < 0.0)
                })
                .collect();
            let free = DMatrix::from_fn(rows.nrows(), n, |r, c| if held[c] { 0.0 } else { rows[(r, c)] });
            let right: DVector<f64> = free.transpose() * &values;
            let normal = free.transpose() * &free + DMatrix::identity(n, n) * damping;
            let step = normal.cholesky().expect("positive definite").solve(&right);
            let next: Vec<f64> = (0..n)
                .map(|i| {
                    let (lower, upper) = self.range(i);
                    (q[i] + step[i].clamp(-0.3, 0.3)).clamp(lower, upper)
                })
                .collect();
            let there = self.residuals(&next, target);
            let reached = there.0.norm();
            if reached < best {
                let small = best - reached < 1e-12;
                (q, best, damping) = (next, reached, (damping * 0.3).max(1e-9));
                (values, rows) = there;
                if small {
                    break;
                }
            } else {
                damping *= 5.0;
                if damping > 1e6 {
                    break;
                }
            }
        }
        let error = self.error(&q, target).norm();
        (q, error)
    }

    /// Offset of a goal that is reached by a posture near the start.
    fn goal_at(&mut self, start: &[f64], random: &mut impl Rng) -> Goal {
        let near: Vec<f64> = (0..start.len())
            .map(|i| {
                let (lower, upper) = self.range(i);
                (start[i] + random.random_range(-0.4..0.4)).clamp(lower + 0.2, upper - 0.2)
            })
            .collect();
        let (from, to) = (self.pose(start), self.pose(&near));
        Goal {
            position: to.position - from.position,
            orientation: to.orientation * from.orientation.inverse(),
        }
    }

    /// Offset of a goal that no descent from random postures reaches.
    fn unreachable(&mut self, start: &[f64], random: &mut ChaCha8Rng) -> Goal {
        loop {
            let posture = self.inner_posture(random, 1.0);
            let pose = self.pose(&posture);
            let direction = Vector3::from_fn(|_, _| random.random_range(-1.0..1.0));
            let from = self.pose(start);
            let mut goal = Goal {
                position: pose.position + direction * random.random_range(0.0..self.length_m) - from.position,
                orientation: pose.orientation * from.orientation.inverse(),
            };
            if !self.rows.contains(&1) {
                goal.position.y = 0.0;
            }
            let target = self.target(start, goal);
            let reached = (0..DESCENTS).any(|descent| {
                let q = if descent == 0 { start.to_vec() } else { self.inner_posture(random, 1.0) };
                self.descend(q, &target).1 < 0.01
            });
            if !reached {
                return goal;
            }
        }
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

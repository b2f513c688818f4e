//! Brisk motion to random goals on elastic gears, within reach or not: the transformer that a real arm gets, beside the
//! torque robot.

use crate::arms::{ARMS, Arm};
use crate::search::Search;
use nalgebra::Vector3;
use opspace_backend::CommandKind;
use opspace_backend::signal_names::{DQ, Q};
use opspace_experiment::{
    Experiment, FileError, Files, Progress, RobotDefinition, RunOptions, Source, TaskDefinition,
};
use opspace_log::Recording;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;
use std::fmt;
use std::io::Cursor;

/// Duration of a run, s.
const DURATION_S: f64 = 9.0;
/// Time at the end in which the arm is at rest, s.
const REST_S: f64 = 1.0;
/// True speed below which a joint is at rest, beyond a step of its encoder per cycle, rad/s.
const REST_RAD_PER_S: f64 = 1e-3;

/// Half-widths of the intervals of gains, as fractions of them.
const WIDTHS: [f64; 4] = [0.02, 0.05, 0.15, 0.3];

/// A goal for an arm.
pub struct Brisk {
    arm: &'static Arm,
    settings: Vec<String>,
    task: String,
    name: String,
}

impl Brisk {
    /// Returns the goal of this number and seed. With `is_uncertain`, the robot does not measure current, and its gains are wrong by
    /// what its file states at most: at an end of their interval in two of three.
    pub fn new(number: usize, seed: u64, is_uncertain: bool) -> Self {
        let mut random =
            ChaCha8Rng::seed_from_u64(seed.wrapping_mul(0x9e37_79b9).wrapping_add(number as u64));
        let arm = &ARMS[number % ARMS.len()];
        let is_pose = (number / ARMS.len()) % 2 == 1;
        let axes: &[&str] = if is_pose { &["x", "y", "z", "rx", "ry", "rz"] } else { &["x", "y", "z"] };
        let robot = RobotDefinition::load(Files::Disk, &arm.file(), &[]).expect("a robot of the repository");
        let model = robot.model.clone();
        let mut search = Search::new(&model, arm.frame, axes, arm.reach_m);
        let start = search.inner_posture(&mut random, 0.8);
        let is_near = random.random_bool(0.4);
        let goal = if is_near {
            search.goal_at(&start.clone(), &mut random)
        } else {
            let posture = search.inner_posture(&mut random, 1.0);
            let mut goal = search.offset(&start, &posture);
            goal.position += Vector3::from_fn(|_, _| 0.5 * arm.reach_m * random.random_range(-1.0..1.0));
            goal
        };
        let duration_s: f64 = random.random_range(0.6..3.0);
        let frequency: f64 = if random.random() { 10.0 } else { 20.0 };
        let [x, y, z] = goal.position.into();
        let mut goals = format!("position = {{ offset_m = [{x}, {y}, {z}] }}");
        if is_pose {
            let (roll, pitch, yaw) = goal.orientation.euler_angles();
            goals += &format!(", orientation = {{ offset_rpy_rad = [{roll}, {pitch}, {yaw}] }}");
        }
        let joints = model.joints().iter().zip(&start);
        let starts: Vec<String> = joints.map(|(joint, q)| format!("{} = {q}", joint.name)).collect();
        let axes: Vec<String> = axes.iter().map(|axis| format!("{axis} = \"motion\"")).collect();
        let task = format!(
            "robot = \"unused\"\nduration_s = {DURATION_S}\nseed = {seed}\npriority = [\"hand\", \"rest\"]\n\
             friction_compensation = {{ gain = 0.8 }}\nstart_rad = {{ {} }}\n\
             [task.hand.cartesian]\nframe = \"{}\"\naxes = {{ {} }}\n\
             gains = {{ frequency_rad_per_s = {frequency:.1}, damping_ratio = 1.0 }}\n\
             reference.point-to-point = {{ {goals}, duration_s = {duration_s} }}\n\
             [task.rest.joint-posture]\nfrequency_rad_per_s = 6.325\ndamping_ratio = 1.0\n",
            starts.join(", "),
            arm.frame,
            axes.join(", "),
        );
        let is_elastic: bool = random.random();
        let mut settings = vec!["robot.interface.gears=\"elastic\"".to_owned()];
        if is_elastic {
            settings.push(arm.elastic_gears(1.0));
        }
        let mut drives = String::new();
        if is_uncertain {
            let width = WIDTHS[random.random_range(0..WIDTHS.len())];
            let mut error = || match random.random_range(0..3) {
                0 => -width,
                1 => width,
                _ => width * random.random_range(-1.0..1.0),
            };
            let (kp, kv) = (1.0 + error(), 1.0 + error());
            let uncertainty = format!("servo.joint_defaults.cascaded.gain_uncertainty={width:?}");
            settings.push("robot.interface.measured=[\"position\"]".to_owned());
            settings.push(format!("robot.profile.{}.{uncertainty}", robot.file.default_profile));
            settings.push(format!("robot.simulated.true_over_nominal={{ kp = {kp:?}, kv = {kv:?} }}"));
            drives = format!(" within {width}: kp x {kp:.2}, kv x {kv:.2}");
        }
        let name = format!(
            "{:5} {} {frequency:2} rad/s {duration_s:.2} s {}{}{drives}",
            arm.folder,
            if is_pose { "6D" } else { "3D" },
            if is_near { "near" } else { "far " },
            if is_elastic { " elastic" } else { "" },
        );
        Self { arm, settings, task, name }
    }

    /// Writes the task and its settings as files.
    pub fn write(&self, folder: &str, number: usize) {
        let robot = self.arm.file();
        let robot = robot.parent().and_then(|folder| folder.canonicalize().ok()).expect("a folder");
        let text = self.task.replace("\"unused\"", &format!("{robot:?}"));
        std::fs::write(format!("{folder}/{number}.toml"), text).expect("written");
        std::fs::write(format!("{folder}/{number}.set"), self.settings.join("\n")).expect("written");
    }

    fn run(&self, backend: CommandKind) -> FinalMotion {
        let source = Source::new("brisk.toml", self.task.clone());
        let task = TaskDefinition::from_sources(source, |_| -> Result<_, FileError> {
            unreachable!("the task has no path")
        })
        .unwrap_or_else(|error| panic!("{error}"));
        let robot = RobotDefinition::load(Files::Disk, &self.arm.file(), &self.settings)
            .unwrap_or_else(|error| panic!("{error}"));
        let limits: Vec<_> = robot.model.joints().iter().map(|joint| joint.limits).collect();
        let steps: Vec<f64> = robot
            .joints()
            .iter()
            .map(|joint| {
                TAU / (f64::from(joint.rotor.encoder_counts_per_turn.get()) * joint.rotor.gear_ratio.get())
            })
            .collect();
        let options = RunOptions { backend, ..RunOptions::default() };
        let experiment =
            Experiment::new(robot, task, options, Vec::new()).unwrap_or_else(|error| panic!("{error}"));
        let finished = experiment.run(Cursor::new(Vec::new()), &Progress::default()).expect("a run");
        let log = Recording::from_bytes(finished.sink.get_ref()).expect("a log");
        let truth = log.channel("truth").expect("the true state");
        let (q, dq) = (truth.signal(Q).expect("positions"), truth.signal(DQ).expect("velocities"));
        let tick = log.tick().expect("rows");
        let from = (truth.len() as f64 * (1.0 - REST_S / DURATION_S)) as usize;
        let period_s = DURATION_S / tick.len() as f64;
        let mut ending = FinalMotion { fault: finished.record.fault.clone(), crossed: None, moves: 0.0 };
        for k in 0..truth.len() {
            for (i, limits) in limits.iter().enumerate() {
                let (q, v) = (q.row(k)[i], dq.row(k)[i]);
                if v.abs() > limits.velocity {
                    let over = v.abs() / limits.velocity - 1.0;
                    ending.cross(i, over, "speed");
                }
                let outside = (q - limits.upper).max(limits.lower - q);
                if outside > 0.0 {
                    ending.cross(i, outside, "position");
                }
                if k >= from {
                    ending.moves = ending.moves.max((v.abs() - steps[i] / period_s) / REST_RAD_PER_S);
                }
            }
        }
        ending
    }
}

/// Motion and limits of a run.
struct FinalMotion {
    fault: Option<String>,
    /// Limit that was exceeded the most, and by how much.
    crossed: Option<(f64, String)>,
    /// Speed at the end over that at rest.
    moves: f64,
}

impl FinalMotion {
    fn cross(&mut self, joint: usize, over: f64, limit: &str) {
        if self.crossed.as_ref().is_none_or(|(most, _)| over > *most) {
            self.crossed = Some((over, format!("{limit} of joint {} exceeded by {over:.2e}", joint + 1)));
        }
    }
}

impl fmt::Display for FinalMotion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(fault) = &self.fault {
            write!(f, "STOPPED {fault}; ")?;
        }
        if let Some((_, crossed)) = &self.crossed {
            write!(f, "{crossed}; ")?;
        }
        if self.moves > 1.0 { write!(f, "moves {:.1} mrad/s", self.moves) } else { write!(f, "rests") }
    }
}

/// Differences of the position robot from the torque robot at a goal.
pub struct Compared {
    pub line: String,
    pub is_stopped: bool,
    pub crosses: bool,
    pub moves: bool,
}

impl Compared {
    pub fn of(number: usize, seed: u64, is_uncertain: bool) -> Self {
        let goal = Brisk::new(number, seed, is_uncertain);
        if let Ok(folder) = std::env::var("REST_LOG") {
            goal.write(&folder, number);
        }
        let [position, torque] = [CommandKind::Position, CommandKind::Torque].map(|kind| goal.run(kind));
        let is_stopped = position.fault.is_some() && torque.fault.is_none();
        let crosses = position.crossed.is_some() && torque.crossed.is_none();
        let moves = !is_stopped && position.moves > 1.0 && torque.moves <= 1.0 && torque.fault.is_none();
        let line = format!("{number:3} {:42} {position} | torque robot: {torque}", goal.name);
        Self { line, is_stopped, crosses, moves }
    }
}

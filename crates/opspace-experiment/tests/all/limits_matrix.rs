//! Every controller within every kind of limit, with every kind of task, on two robots, from random postures to random goals.
//!
//! Compared: what was measured and commanded, with the limits; joints whose references rest, with their starts; the path of
//! a hand that a limit slows down, with the commanded line; the end of each run, with its goal.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use crate::coupled_common::project;
use nalgebra::Vector3;
use opspace_backend::CommandKind;
use opspace_backend::signal_names::{PHASE, TORQUE_DESIRED};
use opspace_experiment::{Code, ControllerKind, Experiment, Files, Progress, RunOptions, Summary};
use opspace_log::Recording;
use opspace_loop::Phase;
use opspace_model::{Data, frame_placement, kinematics};
use std::fmt::Write as _;
use std::io::Cursor;

/// Controllers, each with the robot that it commands.
const CONTROLLERS: [(ControllerKind, CommandKind); 4] = [
    (ControllerKind::Osc, CommandKind::Torque),
    (ControllerKind::Osc, CommandKind::Position),
    (ControllerKind::Ik, CommandKind::Position),
    (ControllerKind::IkLead, CommandKind::Position),
];

/// Robots, each with its hand.
const ROBOTS: [(&str, &str); 2] = [("panda", "flange"), ("ur5e", "flange")];

/// Largest deviation of a joint whose reference rests, rad: servos sag under gravity, and torques ramp in.
const REST_RAD: f64 = 0.01;

/// Measured speed above the fraction of the limit that controllers use, relative to it: servos overshoot.
const OVERSHOOT: f64 = 0.08;

/// Distance of a hand from the line on which a limit slows it down, m.
const LINE_M: f64 = 0.01;

/// Largest error at the end of a run with a goal within limits, rad and m: servos sag under gravity, and joints stick.
const END: f64 = 0.025;

/// Rounding of numbers in the log.
const ROUNDING: f64 = 1e-6;

/// Numbers from 0 to 1 (a linear congruential generator, Knuth's MMIX).
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn between(&mut self, least: f64, most: f64) -> f64 {
        least + (most - least) * self.next()
    }

    /// A sign.
    fn sign(&mut self) -> f64 {
        if self.next() < 0.5 { -1.0 } else { 1.0 }
    }
}

/// Arm at a start, whose joints have these names and limits.
struct Arm {
    robot: &'static str,
    hand: &'static str,
    joints: Vec<String>,
    upper: Vec<f64>,
    start: Vec<f64>,
}

/// Result of a run.
struct Outcome {
    recording: Recording,
    summary: Summary,
    experiment: Experiment,
    place: String,
}

impl Arm {
    /// Draws a start in the middle of the ranges, with bent elbow and wrist.
    fn draw(robot: &'static str, hand: &'static str, numbers: &mut Numbers) -> Self {
        let start = if robot == "panda" { "start_rad = { joint4 = -2.0, joint6 = 1.9 }\n" } else { "" };
        let text = format!(
            "robot = {:?}\n{start}duration_s = 1.0\npriority = [\"a\"]\n[task.a.joint-tracking]\n\
             gains = {{ frequency_rad_per_s = 15.0, damping_ratio = 1.0 }}\nreference = \"hold\"\n",
            project("robots").join(robot)
        );
        let experiment = load(&text, ControllerKind::Osc, CommandKind::Position);
        let links = experiment.robot().model.joints();
        let bent: &[f64] = match robot {
            "panda" => &[0.0, -0.3, 0.0, -2.0, 0.0, 1.9, 0.6],
            _ => &[0.0, -1.3, 1.5, -1.7, -1.4, 0.3],
        };
        Self {
            robot,
            hand,
            joints: links.iter().map(|joint| joint.name.clone()).collect(),
            upper: links.iter().map(|joint| joint.limits.upper).collect(),
            start: bent.iter().map(|q| q + numbers.between(-0.3, 0.3)).collect(),
        }
    }

    /// Text of a task file with these tasks, in their order of priority.
    fn task(&self, priority: &str, tasks: &str, duration_s: f64) -> String {
        let mut text = format!(
            "robot = {:?}\nduration_s = {duration_s:?}\nsettle_s = 0.1\npriority = {priority}\nstart_rad = {{ ",
            project("robots").join(self.robot)
        );
        for (name, q) in self.joints.iter().zip(&self.start) {
            let comma = if *name == self.joints[0] { "" } else { ", " };
            let _ = write!(text, "{comma}{name} = {q:?}");
        }
        text + " }\n" + tasks
    }

    /// Text of a task that moves joints by offsets.
    fn joints_by(&self, offsets: &[(usize, f64)], duration_s: f64, run_s: f64) -> String {
        let offsets: Vec<String> =
            offsets.iter().map(|(joint, by)| format!("{} = {by:?}", self.joints[*joint])).collect();
        let task = format!(
            "[task.arm.joint-tracking]\ngains = {{ frequency_rad_per_s = 15.0, damping_ratio = 1.0 }}\n\
             reference.point-to-point = {{ goal = {{ offset_rad = {{ {} }} }}, duration_s = {duration_s:?} }}\n",
            offsets.join(", ")
        );
        self.task("[\"arm\"]", &task, run_s)
    }

    /// Text of a task that moves the hand along a line, and turns it if `turn_rad` is given.
    fn hand_by(&self, offset_m: Vector3<f64>, turn_rad: Option<f64>, duration_s: f64, run_s: f64) -> String {
        let (axes, turn) = match turn_rad {
            Some(turn) => (
                ", rx = \"motion\", ry = \"motion\", rz = \"motion\"",
                format!(", orientation = {{ offset_rpy_rad = [0.0, 0.0, {turn:?}] }}"),
            ),
            None => ("", String::new()),
        };
        let task = format!(
            "[task.hand.cartesian]\nframe = \"{}\"\naxes = {{ x = \"motion\", y = \"motion\", z = \"motion\"{axes} }}\n\
             gains = {{ frequency_rad_per_s = 15.0, damping_ratio = 1.0 }}\n\
             reference.point-to-point = {{ position = {{ offset_m = {:?} }}{turn}, duration_s = {duration_s:?} }}\n\
             [task.rest.joint-posture]\nfrequency_rad_per_s = 5.0\ndamping_ratio = 1.0\n",
            self.hand,
            offset_m.as_slice()
        );
        self.task("[\"hand\", \"rest\"]", &task, run_s)
    }

    /// Runs a task with each controller and these settings.
    fn run(&self, text: &str, settings: &[String], check: &mut impl FnMut(&Outcome)) {
        for (controller, backend) in CONTROLLERS {
            let experiment = load_with(text, controller, backend, settings);
            let result = experiment.run(Cursor::new(Vec::new()), &Progress::default()).unwrap();
            let recording = Recording::from_bytes(&result.sink.into_inner()).unwrap();
            let summary = experiment.summary(&recording, &result.record, None);
            let place = format!("{} {controller:?} {backend:?} {settings:?}\n{text}", self.robot);
            let outcome = Outcome { recording, summary, experiment, place };
            outcome.check_limits();
            check(&outcome);
        }
    }
}

fn load(text: &str, controller: ControllerKind, backend: CommandKind) -> Experiment {
    load_with(text, controller, backend, &[])
}

fn load_with(
    text: &str,
    controller: ControllerKind,
    backend: CommandKind,
    settings: &[String],
) -> Experiment {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("task.toml");
    std::fs::write(&path, text).unwrap();
    let options = RunOptions { backend, controller, ..RunOptions::default() };
    Experiment::load(Files::Disk, &path, None, options, settings).unwrap_or_else(|e| panic!("{e}\n{text}"))
}

impl Outcome {
    /// Rows of a signal in the cycles in which the controller commands.
    fn rows(&self, signal: &str) -> Vec<Vec<f64>> {
        let tick = self.recording.channel("tick").unwrap();
        let signal = tick.signal(signal).unwrap_or_else(|| panic!("no {signal}"));
        let phase = tick.signal(PHASE).unwrap();
        let controls = |k: &usize| phase.row(*k)[0] == Phase::Control.code();
        (0..tick.len()).filter(controls).map(|k| signal.row(k).to_vec()).collect()
    }

    fn is_osc(&self) -> bool {
        self.experiment.options().controller == ControllerKind::Osc
    }

    /// Checks that the run was complete, and that positions, speeds and commands were within limits.
    fn check_limits(&self) {
        let place = &self.place;
        assert_eq!(self.summary.faulted, None, "{place}");
        let limits = self.experiment.robot().joint_limits();
        for (q, dq) in self.rows("q").iter().zip(self.rows("dq")) {
            for joint in 0..q.len() {
                assert!((limits.lower[joint]..=limits.upper[joint]).contains(&q[joint]), "{q:?} {place}");
                let most = 0.9 * limits.velocity[joint] * (1.0 + OVERSHOOT);
                assert!(dq[joint].abs() <= most, "joint {joint}: {} of {most} rad/s: {place}", dq[joint]);
            }
        }
        if self.is_osc() {
            for torque in self.rows(TORQUE_DESIRED) {
                for (joint, torque) in torque.iter().enumerate() {
                    assert!(
                        torque.abs() <= limits.torque[joint] + ROUNDING,
                        "{torque} of joint {joint}: {place}"
                    );
                }
            }
            return;
        }
        let (q, period_s) = (self.rows("ik.q"), self.experiment.capabilities().period_s);
        for (joint, (velocity, most)) in limits.velocity.iter().zip(&limits.acceleration).enumerate() {
            let q: Vec<f64> = q.iter().map(|q| q[joint]).collect();
            for (k, q) in q.windows(3).enumerate() {
                let (speed, before) = ((q[2] - q[1]) / period_s, (q[1] - q[0]) / period_s);
                assert!(speed.abs() <= 0.9 * velocity + ROUNDING, "{k}: {speed}: {place}");
                let acceleration = (speed - before) / period_s;
                let most = most + ROUNDING / period_s;
                assert!(acceleration.abs() <= most, "cycle {k}, joint {joint}: {acceleration}: {place}");
            }
        }
    }

    /// Checks that all joints but those that move stay where they started.
    fn check_rest(&self, start: &[f64], moving: &[usize]) {
        for (joint, start) in start.iter().enumerate().filter(|(joint, _)| !moving.contains(joint)) {
            let most = self.rows("q").iter().fold(0.0_f64, |most, q| most.max((q[joint] - start).abs()));
            assert!(most <= REST_RAD, "joint {joint} rests, and moves by {most}: {}", self.place);
        }
    }

    /// Checks the positions of joints at the end.
    fn check_end(&self, goals: &[(usize, f64)]) {
        let q = self.rows("q");
        for &(joint, goal) in goals {
            let error = (q[q.len() - 1][joint] - goal).abs();
            assert!(error <= END, "joint {joint} ends {error} from {goal}: {}", self.place);
        }
    }

    /// Positions of the hand, m.
    fn hand(&self, hand: &str) -> Vec<Vector3<f64>> {
        let model = &self.experiment.robot().model;
        let frame = model.frame_id(hand).unwrap();
        let mut data = Data::new(model);
        let still = vec![0.0; model.n()];
        let place = |q: &Vec<f64>| {
            kinematics(model, &mut data, q, &still);
            frame_placement(model, &data, frame).translation
        };
        self.rows("q").iter().map(place).collect()
    }

    /// Checks that the hand keeps to the line from its start along `offset_m`, and ends there.
    fn check_line(&self, hand: &str, offset_m: Vector3<f64>) {
        let path = self.hand(hand);
        let along = offset_m.normalize();
        for at in &path {
            let way = at - path[0];
            let aside = (way - along * way.dot(&along)).norm();
            assert!(aside <= LINE_M, "{aside} m beside the line: {}", self.place);
        }
        let error = (path[path.len() - 1] - path[0] - offset_m).norm();
        assert!(error <= END, "ends {error} m away: {}", self.place);
    }

    /// Checks that a note names exactly these joints, by the limit of each kind.
    fn check_named(&self, code: Code, position: &[&str], speed: &[&str]) {
        let found: Vec<_> = self.summary.findings.of(code).collect();
        let [finding] = found[..] else { panic!("{:?}: {}", self.summary.findings, self.place) };
        assert_eq!(finding.causes.position_limits, position, "{finding}: {}", self.place);
        assert_eq!(finding.causes.speed_limits, speed, "{finding}: {}", self.place);
    }
}

/// Joint tracking that is too fast for a joint: the others rest, the note names it, and it ends at its goal.
#[test]
fn joint_tracking_keeps_speed_limits() {
    let mut numbers = Numbers(501);
    for (robot, hand) in ROBOTS {
        let arm = Arm::draw(robot, hand, &mut numbers);
        let (joint, by) = (0, 2.2 * numbers.sign());
        let text = arm.joints_by(&[(joint, by)], 0.5, 2.5);
        arm.run(&text, &[], &mut |run| {
            run.check_rest(&arm.start, &[joint]);
            run.check_end(&[(joint, arm.start[joint] + by)]);
            run.check_named(Code::ReferenceLimited, &[], &[&arm.joints[joint]]);
        });
    }
}

/// A joint that is too fast, and a slow one: one factor slows both down with inverse kinematics, and the note names both. The
/// torque controller slows down the fast one only.
#[test]
fn notes_name_all_joints_that_deviate() {
    let mut numbers = Numbers(508);
    for (robot, hand) in ROBOTS {
        let arm = Arm::draw(robot, hand, &mut numbers);
        let slow = arm.joints.len() - 1;
        let text = arm.joints_by(&[(0, 2.2 * numbers.sign()), (slow, 0.6 * numbers.sign())], 0.6, 1.5);
        arm.run(&text, &[], &mut |run| {
            run.check_rest(&arm.start, &[0, slow]);
            let finding = run.summary.findings.of(Code::ReferenceLimited).next().unwrap();
            assert!(finding.causes.speed_limits.contains(&arm.joints[0]), "{finding}: {}", run.place);
            let mut expected = vec![arm.joints[0].clone()];
            expected.extend((!run.is_osc()).then(|| arm.joints[slow].clone()));
            let named: Vec<String> = finding.deviations.keys().cloned().collect();
            assert_eq!(named, expected, "{finding}: {}", run.place);
            assert!(run.is_osc() || finding.message.contains(&expected.join(", ")), "{finding}");
        });
    }
}

/// Joint tracking with a goal beyond the range of a joint, beside one within it.
#[test]
fn joint_tracking_keeps_position_limits() {
    let mut numbers = Numbers(502);
    for (robot, hand) in ROBOTS {
        let arm = Arm::draw(robot, hand, &mut numbers);
        // The elbow of the Panda and the one of the UR5e, which other limits of the task do not stop before.
        let joint = if robot == "panda" { 3 } else { 2 };
        let upper = arm.upper[joint];
        let end = if robot == "panda" { upper } else { 2.6 };
        let other = (0, 0.5 * numbers.sign());
        let offset = end + 0.25 - arm.start[joint];
        let text = arm.joints_by(&[(joint, offset), other], 2.0, 3.5);
        // A narrower range of the UR5e, as its own is a whole turn.
        let margin = upper - end + 0.01;
        let settings = [format!("limits.position_margin_rad={margin:?}")];
        arm.run(&text, &settings, &mut |run| {
            run.check_rest(&arm.start, &[joint, other.0]);
            run.check_end(&[(joint, end - 0.01), (other.0, arm.start[other.0] + other.1)]);
            run.check_named(Code::GoalNotReached, &[&arm.joints[joint]], &[]);
        });
    }
}

/// Joint tracking beyond a declared acceleration, and beyond a torque.
#[test]
fn joint_tracking_keeps_acceleration_and_torque_limits() {
    let mut numbers = Numbers(503);
    for (robot, hand) in ROBOTS {
        let arm = Arm::draw(robot, hand, &mut numbers);
        let by = 1.0 * numbers.sign();
        let text = arm.joints_by(&[(0, by)], 0.7, 3.0);
        let torque_nm = if robot == "panda" { 18.0 } else { 45.0 };
        let name = &arm.joints[0];
        for setting in [
            format!("robot.joint.{name}.acceleration_limit_rad_per_s2=3.0"),
            format!("robot.joint.{name}.torque_limit_nm={torque_nm:?}"),
        ] {
            arm.run(&text, &[setting], &mut |run| {
                run.check_rest(&arm.start, &[0]);
                run.check_end(&[(0, arm.start[0] + by)]);
            });
        }
    }
}

/// Jumps of several joints at once: those that rest do so, and all others end at their goals.
#[test]
fn joint_jumps_are_followed() {
    let mut numbers = Numbers(504);
    for (robot, hand) in ROBOTS {
        let arm = Arm::draw(robot, hand, &mut numbers);
        let offsets: Vec<(usize, f64)> =
            [0, 2, 4].into_iter().map(|joint| (joint, numbers.between(0.3, 0.8) * numbers.sign())).collect();
        let goals: Vec<(usize, f64)> =
            offsets.iter().map(|&(joint, by)| (joint, arm.start[joint] + by)).collect();
        let text = arm.joints_by(&offsets, 0.002, 2.0);
        arm.run(&text, &[], &mut |run| {
            if !run.is_osc() {
                run.check_rest(&arm.start, &[0, 2, 4]);
            }
            run.check_end(&goals);
        });
    }
}

/// Lines that are too fast for joints, of positions and of poses.
#[test]
fn hands_keep_to_lines_at_speed_limits() {
    let mut numbers = Numbers(505);
    for (robot, hand) in ROBOTS {
        let arm = Arm::draw(robot, hand, &mut numbers);
        for turn in [None, Some(0.0)] {
            let offset = Vector3::new(numbers.between(-0.12, -0.06), numbers.between(0.1, 0.2), 0.05);
            let text = arm.hand_by(offset, turn, 0.8, 2.5);
            let settings = ["limits.velocity_fraction=0.25".to_owned()];
            arm.run(&text, &settings, &mut |run| run.check_line(hand, offset));
        }
    }
}

/// Jumps of the target, of positions and of poses.
#[test]
fn hands_follow_jumps() {
    let mut numbers = Numbers(506);
    for (robot, hand) in ROBOTS {
        let arm = Arm::draw(robot, hand, &mut numbers);
        for turn in [None, Some(0.8)] {
            let offset = Vector3::new(-0.05, numbers.between(0.12, 0.2) * numbers.sign(), 0.05);
            let text = arm.hand_by(offset, turn, 0.002, 2.5);
            arm.run(&text, &[], &mut |run| {
                let path = run.hand(hand);
                let error = (path[path.len() - 1] - path[0] - offset).norm();
                assert!(error <= END, "ends {error} m away: {}", run.place);
            });
        }
    }
}

/// A posture beyond the range of a joint, below a hand that holds its place.
#[test]
fn postures_keep_position_limits() {
    let mut numbers = Numbers(507);
    let arm = Arm::draw("panda", "flange", &mut numbers);
    let task = "[task.hand.cartesian]\nframe = \"flange\"\naxes = { x = \"motion\", y = \"motion\", z = \"motion\" }\n\
                gains = { frequency_rad_per_s = 15.0, damping_ratio = 1.0 }\nreference = \"hold\"\n\
                [task.rest.joint-posture]\nfrequency_rad_per_s = 5.0\ndamping_ratio = 1.0\n\
                posture_rad = { joint6 = 4.2, joint7 = -3.2 }\n";
    let text = arm.task("[\"hand\", \"rest\"]", task, 3.0);
    arm.run(&text, &[], &mut |run| {
        let path = run.hand("flange");
        let most = path.iter().fold(0.0_f64, |most, at| most.max((at - path[0]).norm()));
        assert!(most <= LINE_M, "the hand moves by {most} m: {}", run.place);
    });
}

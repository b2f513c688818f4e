//! Friction compensation: arms come to rest, and compliant axes do not stick.

use crate::cli_common::project;
use crate::common::{self, load, measure, run, torque};
use opspace_backend::CommandKind;
use opspace_backend::signal_names::{DQ, TRUTH_CHANNEL};
use opspace_experiment::{
    Experiment, FileError, Files, Metrics, RobotDefinition, RunOptions, Source, TaskDefinition,
};
use std::path::Path;

/// Compared with compensation of 0.8 of the friction that follows the velocity, on each kind of robot: force of the
/// operator and position error are not larger, and the motion of the hand is not smaller, by more than 1 %. The desired
/// torques above 8 Hz, of which that law has 0.25 Nm, are below 0.1 Nm.
#[test]
fn compliant_hand_neither_chatters_nor_sticks() {
    for backend in [CommandKind::Position, CommandKind::Velocity, CommandKind::Torque] {
        let options = RunOptions { backend, ..torque("a-med") };
        let options = RunOptions { transformer: None, ..options };
        let velocity = ["friction_compensation.follows=velocity", "friction_compensation.gain=0.8"];
        let [new, compared] =
            [&[][..], &velocity[..]].map(|settings| measure(&load("compliant-x", options.clone(), settings)));
        let chatter = |metrics: &Metrics| metrics.torque_chatter_rms_nm.expect("torques");
        assert!(chatter(&new) < 0.1, "{backend:?}: {} Nm", chatter(&new));
        assert!(chatter(&compared) > 0.15, "{backend:?}: {} Nm", chatter(&compared));
        let force = [&new, &compared].map(|metrics| metrics.hand_force_rms_n.expect("an operator"));
        assert!(force[0] < 1.01 * force[1], "{backend:?}: {force:?} N");
        let motion = [&new, &compared].map(|metrics| metrics.hand_motion_rms_m.expect("an operator"));
        assert!(motion[0] > 0.99 * motion[1], "{backend:?}: {motion:?} m");
        let error = [&new, &compared].map(|metrics| metrics.pose.position_rms_m.expect("a position"));
        assert!(error[0] < 1.01 * error[1], "{backend:?}: {error:?} m");
    }
}

/// Checks the true speed of a UR5e without noise, from 3 s after its reference has reached a goal, for several postures and
/// goals: it must be below 1 mrad/s. With compensation that follows the velocity, the arm moves faster.
#[test]
fn arm_with_friction_comes_to_rest_at_its_goal() {
    let mut restless = 0;
    for case in 0..4 {
        let mut angle = 10.0 * f64::from(case);
        let mut near = |centre: f64| {
            angle += 2.0;
            centre + 0.3 * f64::sin(angle)
        };
        let start = [near(0.2), near(-1.2), near(1.4), near(-1.5), near(-1.4), near(0.0)];
        let goal = [near(0.0), near(0.0), near(0.0)].map(|offset| 0.2 * offset);
        let backend = if case % 2 == 0 { CommandKind::Position } else { CommandKind::Torque };
        let speed = speed_at_goal(backend, start, goal, "");
        assert!(speed < 1e-3, "case {case}: {speed} rad/s");
        restless += u32::from(speed_at_goal(backend, start, goal, ", follows = \"velocity\"") > 1e-3);
    }
    assert!(restless > 0, "the test can tell rest from motion");
}

fn speed_at_goal(backend: CommandKind, start: [f64; 6], goal: [f64; 3], law: &str) -> f64 {
    let joints = ["base", "shoulder", "elbow", "wrist_1", "wrist_2", "wrist_3"];
    let starts: Vec<String> = joints.iter().zip(start).map(|(joint, q)| format!("{joint} = {q:?}")).collect();
    let text = format!(
        "robot = \"unused\"\nduration_s = 5.0\npriority = [\"hand\", \"rest\"]\nfriction_compensation = {{ gain = 0.8{law} }}\n\
         start_rad = {{ {} }}\n[task.hand.cartesian]\nframe = \"flange\"\naxes = {{ x = \"motion\", y = \"motion\", z = \
         \"motion\" }}\ngains = {{ frequency_rad_per_s = 20.0, damping_ratio = 1.0 }}\nreference.point-to-point = {{ position \
         = {{ offset_m = {goal:?} }}, duration_s = 1.0 }}\n[task.rest.joint-posture]\nfrequency_rad_per_s = 6.0\n\
         damping_ratio = 1.0\n",
        starts.join(", ")
    );
    let task = TaskDefinition::from_sources(Source::new("rest.toml", text), |_| -> Result<_, FileError> {
        unreachable!("the task has no path")
    })
    .unwrap_or_else(|e| panic!("{e}"));
    let mut settings: Vec<String> = joints
        .iter()
        .map(|joint| format!("robot.joint.{joint}.rotor.encoder_counts_per_turn=1000000000"))
        .collect();
    settings.push("robot.simulated.torque_noise_nm=0.0".to_owned());
    let path = project("robots/ur5e/robot.toml");
    let robot =
        RobotDefinition::load(Files::Disk, Path::new(&path), &settings).unwrap_or_else(|e| panic!("{e}"));
    let options = RunOptions { backend, ..RunOptions::default() };
    let experiment = Experiment::new(robot, task, options, Vec::new()).unwrap_or_else(|e| panic!("{e}"));
    let run = run(&experiment);
    let truth = run.channel(TRUTH_CHANNEL);
    let dq = truth.signal(DQ).expect("true velocities");
    (0..dq.len())
        .filter(|&k| truth.time_s[k] > 4.0)
        .flat_map(|k| dq.row(k))
        .fold(0.0, |m: f64, v| m.max(v.abs()))
}

/// Compared: position errors with the friction observer and without it while the hand moves and where it rests; through
/// the transformers at both rates and as a torque robot, with friction that is 0.7 and 1.3 times the nominal one. With the
/// observer, errors are at most a fifth, and the desired torques at rest have no oscillation.
#[test]
fn friction_observer_takes_the_error_of_wrong_friction() {
    for (friction, profile, backend) in [
        (0.7, "b-soft", CommandKind::Position),
        (1.3, "a-med", CommandKind::Position),
        (1.3, "b-soft", CommandKind::Torque),
    ] {
        let friction = format!("friction={friction}");
        let errors = ["", "friction_compensation.observer_rad_per_s=60"].map(|observer| {
            let friction = format!("true_over_nominal.{friction}");
            let robot = common::robot(&[&format!("robot.simulated.{friction}")]);
            let settings: Vec<&str> = [observer].into_iter().filter(|setting| !setting.is_empty()).collect();
            let task = common::task("cartesian-tracking", &settings);
            let options = RunOptions { backend, duration_s: Some(4.0), ..common::torque(profile) };
            let options = RunOptions { transformer: None, ..options };
            let metrics = measure(&common::experiment(robot, task, options));
            metrics.pose.position_rms_m.expect("a position")
        });
        assert!(errors[1] < 0.2 * errors[0], "{friction}, {profile}, {backend:?}: {errors:?} m");
    }
}

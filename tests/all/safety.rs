//! Starts and stops of the simulated arm: no jump at the start, and a stop at rest for any cause.
//!
//! Compared in all tests: the true motion of the arm in the log, and the bounds of a safe start and stop. The tests
//! of opspace-loop contain a scripted robot for faults that a simulation does not have.

use crate::common::{Run, experiment, ik, load, osc, positions, robot, run, run_with, task, torque, torques};
use nalgebra::DVector;
use opspace_backend::CommandKind;
use opspace_backend::quantity::NonNegative;
use opspace_experiment::{ControllerKind, Experiment, RobotDefinition, RunOptions, Source};
use opspace_loop::{ControlLoop, Fault, LoopConfig, LoopError, Phase, RunOutcome};
use opspace_model::{Data, Model, kinematics, potential_energy};
use opspace_sim::EnvironmentObjectParameters;

const START: [f64; 4] = [-0.45, -0.35, 0.25, -1.35];
const STOPPED: f64 = 2.0;

/// Experiment of one second without friction compensation, on the arm with its own parameters.
fn holding_experiment(options: RunOptions) -> Experiment {
    let options = RunOptions { duration_s: Some(1.0), ..options };
    load("gravity-compensation", options, &["settle_s=0", "friction_compensation.gain=0"])
}

fn with_duration(duration_s: f64, from: &Experiment) -> Experiment {
    let options = RunOptions { duration_s: Some(duration_s), ..from.options().clone() };
    experiment(from.robot().clone(), from.task().clone(), options)
}

/// Gradient of the potential energy: joint torques against gravity, computed without a dynamics algorithm.
fn weight(model: &Model, q: &[f64]) -> DVector<f64> {
    const STEP: f64 = 1e-5;
    let mut data = Data::new(model);
    let mut height = |q: &[f64]| {
        kinematics(model, &mut data, q, &vec![0.0; q.len()]);
        potential_energy(model, &data)
    };
    DVector::from_fn(q.len(), |i, _| {
        let mut moved = q.to_vec();
        moved[i] += STEP;
        let above = height(&moved);
        moved[i] -= 2.0 * STEP;
        (above - height(&moved)) / (2.0 * STEP)
    })
}

/// Index of the first control cycle.
fn first(run: &Run) -> usize {
    run.signal("tick", "phase").rows().position(|p| p[0] == 1.0).expect("control began")
}

/// Compared: the first setpoint, and the setpoint at which the servos hold the weight according to the potential
/// energy; the true speed during the start, and a slow human motion.
#[test]
fn start_from_hold_has_no_jump() {
    for options in [osc("a-med"), osc("b-soft"), torque("a-med")] {
        let experiment = load("cartesian-tracking", RunOptions { duration_s: Some(2.0), ..options }, &[]);
        let run = run(&experiment);
        let k = first(&run);
        // At the actual position, because brakes yield slightly.
        let weight = weight(&experiment.robot().model, run.signal("truth", "q").row(k));
        let torque = run.signal("tick", "torque_desired").row(k);
        for j in 0..4 {
            // An encoder count is 4 µrad, which changes the weight torque by less than 1e-4 Nm.
            assert!((torque[j] - weight[j]).abs() < 1e-4, "joint {j}: {} for {}", torque[j], weight[j]);
        }
        if let Some(setpoint) = run.channel("tick").signal("q_desired") {
            let q = run.signal("tick", "q").row(k);
            for (j, servo) in experiment.robot().servos(experiment.profile().1).iter().enumerate() {
                let gains = servo.gains(experiment.profile().1.servo_period_s());
                let lead = weight[j] / gains.stiffness;
                let jump = setpoint.row(k)[j] - q[j] - lead;
                assert!(jump.abs() < 1e-6, "joint {j} jumps by {jump} rad");
            }
        }
        let speed = run.signal("truth", "dq");
        let period_s = experiment.profile().1.period_s();
        let soon = k + (0.05 / period_s) as usize;
        let fastest = (k..soon).flat_map(|k| speed.row(k)).fold(0.0, |max: f64, v| max.max(v.abs()));
        // The release of the weight by the brakes causes most of this speed.
        assert!(fastest < 0.03, "{fastest} rad/s within 50 ms");
    }
}

/// Compared: the logged desired torque of a controller that demands 5 Nm more from the first cycle on, and a linear
/// increase from the weight torque over 0.2 s.
#[test]
fn torque_ramps_in_linearly() {
    for options in [osc("a-med"), torque("a-med")] {
        let experiment = with_duration(0.25, &holding_experiment(options));
        let controller = Box::new(torques(|data, _, tau| {
            tau.iter_mut().zip(&data.gravity).for_each(|(tau, g)| *tau = g + 5.0);
        }));
        let run = run_with(&experiment, controller, None);
        let (command, desired) = (run.signal("tick", "command"), run.signal("tick", "torque_desired"));
        let begin = first(&run);
        let mut shares = Vec::new();
        for k in begin..command.len() {
            let t = run.channel("tick").time_s[k];
            let share = (t / 0.2).min(1.0);
            for j in 0..4 {
                let expected = command.row(k)[j] - 5.0 * (1.0 - share);
                let found = desired.row(k)[j];
                assert!((found - expected).abs() < 1e-9, "at {t} s: {found} for {expected}");
            }
            shares.push(share);
        }
        assert_eq!(shares[0], 0.0);
        assert_eq!(shares.last(), Some(&1.0));
    }
}

/// Checks that a run was stopped for a cause, that its log contains the cause, and that the arm is at rest.
fn check_stop(experiment: &Experiment, run: &Run, name: &str) -> Fault {
    let RunOutcome::Faulted { fault, time_s } = &run.ending else { panic!("{name}: {:?}", run.ending) };
    let (phase, code) = (run.signal("tick", "phase"), run.signal("tick", "fault"));
    let found = code.rows().position(|c| c[0] != 0.0).expect("the fault is in the log");
    let logged_s = run.channel("tick").time_s[found];
    assert!((logged_s - *time_s).abs() < 2e-3, "{name}: at {time_s} s, logged at {logged_s} s");
    assert!((found..code.len()).all(|k| code.row(k)[0] == f64::from(fault.code())), "{name}: latched");
    assert!((found + 1..phase.len()).all(|k| Phase::is_after_stop(phase.row(k)[0])), "{name}: stopped");
    check_at_rest(experiment, run, name);
    let text = fault.describe(&experiment.robot().model);
    assert!(!text.contains("joint 0") && !text.contains("joint 3"), "named by name: {text}");
    fault.clone()
}

/// Checks that the log continues for 0.2 s after the stop, that the arm is at rest at the end, and that it is held:
/// it has not moved away from where it came to rest.
fn check_at_rest(experiment: &Experiment, run: &Run, name: &str) {
    /// Largest remaining speed of a joint, rad/s.
    const STILL: f64 = 0.03;
    /// Largest braking distance from 1 to 2 rad/s: a position servo with kp = 25/s stops within a distance of
    /// speed/kp.
    const STOPPING_RAD: f64 = 0.1;
    let phase = run.signal("tick", "phase");
    let stop = phase.rows().position(|p| p[0] == STOPPED).expect("it was stopped");
    let last = run.channel("truth").len() - 1;
    let ticks = (0.2 / experiment.profile().1.period_s()).round() as usize;
    // The last of several setpoints of a stop has a row of its own.
    let rows = phase.len() - stop;
    assert!(rows == ticks || rows == ticks + 1, "{name}: 0.2 s of aftermath, {rows}");
    let (q, dq) = (run.signal("truth", "q"), run.signal("truth", "dq"));
    let left = dq.row(last).iter().fold(0.0, |max: f64, v| max.max(v.abs()));
    assert!(left < STILL, "{name}: {left} rad/s after 0.2 s");
    for (now, then) in q.row(last).iter().zip(q.row(stop)) {
        assert!((now - then).abs() < STOPPING_RAD, "{name}: went on by {} rad", now - then);
    }
}

#[test]
fn joint_limit_stops_the_arm() {
    for options in [osc("a-med"), osc("b-soft"), torque("a-med")] {
        let mut robot = robot(&[]);
        robot.file.safety.limit_margin_rad = NonNegative::default();
        let still = with_duration(3.0, &holding_experiment(options));
        let experiment = experiment(robot, still.task().clone(), still.options().clone());
        // Opens the elbow at up to 1.5 rad/s until it reaches its limit of 0.
        let controller = Box::new(torques(|data, measurement, tau| {
            tau.copy_from_slice(data.gravity.as_slice());
            tau[3] += 12.0 - 6.0 * measurement.dq[3];
        }));
        let run = run_with(&experiment, controller, None);
        let fault = check_stop(&experiment, &run, "joint limit");
        assert!(matches!(fault, Fault::JointLimit { joint: 3, .. }), "{fault:?}");
        assert!(fault.describe(&experiment.robot().model).contains("'elbow'"));
    }
}

/// The robot with a lower velocity limit, rad/s.
fn slow_robot(limit: f64) -> RobotDefinition {
    let robot = robot(&[]);
    let urdf = robot.urdf.text().replace("velocity=\"8\"", &format!("velocity=\"{limit}\""));
    RobotDefinition::from_sources(robot.source, Source::new("asimo-arm.urdf", urdf))
        .unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn excess_speed_stops_the_arm() {
    for options in [osc("a-med"), osc("b-soft"), torque("a-med"), torque("b-soft")] {
        let still = holding_experiment(options);
        let experiment = experiment(slow_robot(1.0), still.task().clone(), still.options().clone());
        let controller = Box::new(torques(|data, _, tau| {
            tau.copy_from_slice(data.gravity.as_slice());
            tau[0] -= 15.0;
        }));
        let run = run_with(&experiment, controller, None);
        let fault = check_stop(&experiment, &run, "speed");
        let Fault::Speed { joint, dq, limit } = fault else { panic!("{fault:?}") };
        // The setpoints of a position robot's joint are not faster than its limit; another joint that swings is.
        assert!(joint == 0 || experiment.options().backend == CommandKind::Position, "joint {joint}");
        assert!(limit == 1.0 && dq.abs() > 1.0 && dq.abs() < 1.5, "caught at once: {dq} rad/s");
    }
}

#[test]
fn setpoint_jump_is_refused() {
    let experiment = holding_experiment(osc("a-med"));
    let controller = Box::new(positions(|_, measurement, q| {
        q.copy_from_slice(&START);
        q[3] += if measurement.time_s > 0.3 { 1.0 } else { 0.0 };
    }));
    let run = run_with(&experiment, controller, None);
    let fault = check_stop(&experiment, &run, "jump");
    assert!(matches!(fault, Fault::FollowingError { joint: 3, .. }), "{fault:?}");
    let moved = run.signal("truth", "q").rows().map(|q| (q[3] - START[3]).abs()).fold(0.0, f64::max);
    assert!(moved < 0.01, "the arm never saw it: {moved} rad");
}

#[test]
fn blocked_arm_is_stopped() {
    let still = holding_experiment(osc("a-med"));
    let mut task = task("gravity-compensation", &["settle_s=0"]);
    task.file.environment.clear();
    // The hand is at z = -0.157 m; the shoulder moves it up against a ceiling.
    let wall: EnvironmentObjectParameters = serde_json::from_str(
        r#"{ "wall": { "frame": "hand", "point_m": [0.0, 0.0, -0.12], "normal": [0.0, 0.0, -1.0],
             "stiffness_n_per_m": 50000.0, "damping_ns_per_m": 100.0 } }"#,
    )
    .expect("a wall");
    task.file.environment.insert("wall".to_owned(), wall);
    let still = with_duration(3.0, &still);
    let experiment = experiment(still.robot().clone(), task, still.options().clone());
    let controller = Box::new(positions(|_, measurement, q| {
        q.copy_from_slice(&START);
        q[0] -= 0.3 * (measurement.time_s - 0.2).max(0.0);
    }));
    let run = run_with(&experiment, controller, None);
    let fault = check_stop(&experiment, &run, "blocked");
    let Fault::FollowingError { joint: 0, error, limit } = fault else { panic!("{fault:?}") };
    assert!(error > limit && error < 1.05 * limit, "caught at once: {error} of {limit} rad");
    let pushed = run.signal("truth", "wall.force").rows().any(|f| f[2] < -20.0);
    assert!(pushed, "the ceiling was met");
}

#[test]
fn nan_command_stops_a_moving_arm() {
    for options in [osc("a-med"), osc("b-soft"), torque("a-med")] {
        let experiment = holding_experiment(options);
        let controller = Box::new(torques(|data, measurement, tau| {
            tau.copy_from_slice(data.gravity.as_slice());
            tau[0] -= 12.0;
            if measurement.time_s > 0.5 {
                tau[2] = f64::NAN;
            }
        }));
        let run = run_with(&experiment, controller, None);
        let fault = check_stop(&experiment, &run, "not a number");
        assert_eq!(fault, Fault::CommandNotFinite { joint: 2 });
        let k = run.signal("tick", "phase").rows().position(|p| p[0] == STOPPED).expect("stopped");
        let speed = run.signal("truth", "dq").row(k)[0].abs();
        assert!(speed > 0.3, "it was moving: {speed} rad/s");
        let motor = run.signal("servo", "motor_torque").rows();
        assert!(motor.flatten().all(|t| t.is_finite()), "it never reached the motors");
    }
}

#[test]
fn torque_robot_refuses_position_commands() {
    let experiment = holding_experiment(torque("a-med"));
    let controller = Box::new(positions(|_, _, q| q.copy_from_slice(&START)));
    let config = experiment.loop_config().unwrap_or_else(|e| panic!("{e}"));
    let refused = ControlLoop::new(LoopConfig { controller, ..config }).err();
    let (gives, takes) = (CommandKind::Position, CommandKind::Torque);
    assert_eq!(refused, Some(LoopError::Kind { part: "controller", gives, takes }));
    let text = Experiment::new(
        experiment.robot().clone(),
        experiment.task().clone(),
        RunOptions { controller: ControllerKind::Ik, ..experiment.options().clone() },
        Vec::new(),
    )
    .expect_err("refused before it starts")
    .to_string();
    assert!(text.contains("'ik'") && text.contains("torque robot"), "{text}");
}

#[test]
fn interrupt_stops_a_moving_arm() {
    for (options, extra) in [
        (osc("a-med"), 0),
        (osc("a-med"), 1),
        (osc("b-soft"), 0),
        (torque("a-med"), 1),
        (ik("b-soft", ControllerKind::Ik), 0),
    ] {
        let experiment = load("cartesian-tracking", RunOptions { duration_s: Some(4.0), ..options }, &[]);
        let rest_s = experiment.robot().file.safety.tare_s.get();
        let period_s = experiment.profile().1.period_s();
        // In the middle of a stroke, after an even or an odd number of commands.
        let ticks = ((rest_s + 2.25) / period_s).round() as u64 + extra;
        let controller = experiment.controller().unwrap_or_else(|e| panic!("{e}"));
        let run = run_with(&experiment, controller, Some(ticks));
        let RunOutcome::Interrupted { time_s } = &run.ending else { panic!("{:?}", run.ending) };
        // The request arrives after the command of a cycle was written, so the next cycle is the last.
        let expected_s = 2.25 + extra as f64 * period_s;
        assert!((time_s - expected_s).abs() < 1e-9, "in the next cycle: {time_s} s");
        assert!(run.signal("tick", "fault").rows().all(|f| f[0] == 0.0), "no fault");
        // The last command is the stop, which has no desired torque.
        let asked = run.signal("servo", "torque_desired");
        assert!(asked.row(asked.len() - 1)[0].is_nan(), "the stop was overtaken by the command before it");
        check_at_rest(&experiment, &run, "interrupt");
    }
}

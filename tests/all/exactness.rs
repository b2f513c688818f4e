//! Exactness of the paper's transformer under its conditions, and its errors otherwise, compared with errors
//! predicted from the timing of servo and interface.

use crate::common::{Run, experiment, ideal, load, osc, robot, run, task};
use nalgebra::{Matrix2, Vector2};
use opspace_experiment::{Experiment, RunOptions};
use opspace_loop::RunOutcome;
use opspace_transformer::{CascadedServo, ProfileParameters, ServoParameters};
use std::f64::consts::TAU;

/// Bound on rounding of kv kp (q_desired − q): for kv kp < 5000 Nm/rad and |q| < 2 rad it is below 1e-11 Nm.
const EXACT_NM: f64 = 1e-9;

fn cascade(servo: &ServoParameters) -> CascadedServo {
    let ServoParameters::Cascaded(servo) = servo else { panic!("the robot has cascades") };
    *servo
}

/// Cartesian tracking on ideal drives; the transformer uses the same velocity as the servo.
fn exact(profile: &str, duration_s: f64, settings: &[String]) -> Experiment {
    let settings: Vec<&str> = settings.iter().map(String::as_str).collect();
    let mut robot = ideal(robot(&settings));
    let own = robot.file.profile.get_mut(profile).expect("the profile");
    let filter_hz = cascade(&own.servo["elbow"]).velocity_filter_hz;
    assert!(own.servo.values().all(|s| cascade(s).velocity_filter_hz == filter_hz));
    own.estimator.velocity_filter_hz = filter_hz;
    let options = RunOptions { duration_s: Some(duration_s), ..osc(profile) };
    experiment(robot, task("cartesian-tracking", &["settle_s=0"]), options)
}

/// Largest |τ_servo − τ_s| over all servo ticks and joints after the first command, Nm. On ideal drives the motor
/// torque equals the servo torque.
fn largest_error(run: &Run) -> f64 {
    let desired = run.signal("servo", "torque_desired").rows();
    let actual = run.signal("servo", "motor_torque").rows();
    desired
        .zip(actual)
        .flat_map(|(d, a)| d.iter().zip(a).map(|(d, a)| (a - d).abs()))
        .filter(|e| e.is_finite())
        .fold(0.0, f64::max)
}

/// Compared: torques that the simulated servos produce from positions, and desired torques before any transformer.
/// Only equation (K10) and the code of the simulated servo connect them.
#[test]
fn servo_rate_setpoints_give_exact_torques() {
    for (profile, duration_s) in [("a-med", 2.5), ("b-soft", 8.0)] {
        let run =
            run(&exact(profile, duration_s, &[format!("robot.profile.{profile}.servo_ticks_per_cycle=1")]));
        assert_eq!(run.ending, RunOutcome::Completed);
        let compared = run.signal("servo", "torque_desired").rows().filter(|d| d[0].is_finite()).count();
        let servo_hz = if profile == "a-med" { 5000.0 } else { 1000.0 };
        assert!(compared as f64 >= duration_s * servo_hz - 2.0, "{profile}: only {compared} servo ticks");
        let error = largest_error(&run);
        assert!(error < EXACT_NM, "{profile}: {error} Nm");
    }
}

/// Compared: the same torques with one of the conditions violated in each case; the test above would fail.
#[test]
fn each_exactness_condition_is_necessary() {
    let ratio = "robot.profile.b-soft.servo_ticks_per_cycle=1".to_owned();
    let held = run(&exact("b-soft", 2.0, &["robot.profile.b-soft.servo_ticks_per_cycle=2".to_owned()]));
    let delayed =
        run(&exact("b-soft", 2.0, &[ratio.clone(), "robot.profile.b-soft.delay_servo_ticks=1".to_owned()]));
    let stiffer =
        run(&exact("b-soft", 2.0, &[ratio.clone(), "robot.simulated.true_over_nominal.kp=1.01".to_owned()]));
    let other_filter =
        run(&load("cartesian-tracking", RunOptions { duration_s: Some(2.0), ..osc("b-soft") }, &[&ratio]));
    for (name, run) in [("ratio", held), ("delay", delayed), ("kp", stiffer), ("filter", other_filter)] {
        let error = largest_error(&run);
        assert!(error > 0.1, "{name}: only {error} Nm");
    }
}

/// Artificial damping and inertia of the paper's transformer, computed only from the timing (first order in a
/// period), with the velocity v and the acceleration a at the interface cycle:
///
/// ```text
/// mean(τ_motor) − τ_desired = −b v − m a
/// b = kv kp t̄        t̄ = (d + (R − 1)/2) Ts, the mean age of the measurement while its command acts
/// m = kv (t_e + t̄ − t_w) + kv kp ⟨t²⟩/2
/// ```
///
/// where t_e and t_w are the lags of the velocities in the interface and in the servo. Each is the lag of a finite
/// difference (half its period) plus that of a first-order low-pass filter, (1 − α)/α periods.
fn artefacts(profile: &ProfileParameters, joint: &str) -> (f64, f64) {
    let servo = cascade(&profile.servo[joint]);
    let (kp, kv) = (servo.kp_per_s.get(), servo.kv_nms_per_rad.get());
    let (ratio, delay) = (profile.servo_ticks_per_cycle.get(), profile.delay());
    let servo_period_s = 1.0 / profile.servo_hz.get();
    let lag = |period_s: f64, filter_hz: f64| {
        let alpha = 1.0 - (-TAU * filter_hz * period_s).exp();
        period_s * (0.5 + (1.0 - alpha) / alpha)
    };
    let ages = || (0..ratio).map(|j| f64::from(delay + j) * servo_period_s);
    let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / f64::from(ratio);
    let (age, age_squared) = (mean(&mut ages()), mean(&mut ages().map(|t| t * t)));
    let estimate = lag(servo_period_s * f64::from(ratio), profile.estimator.velocity_filter_hz.get());
    let own = lag(servo_period_s, servo.velocity_filter_hz.get());
    (kv * kp * age, kv * (estimate + age - own) + 0.5 * kv * kp * age_squared)
}

/// Least-squares fit of the torque error of one joint, averaged over the time during which a command acts, to −v and
/// −a at the interface cycle of the command: (b, m) and the explained fraction of the error.
fn regress(run: &Run, profile: &ProfileParameters, joint: usize) -> (f64, f64, f64) {
    let (ratio, period_s) = (profile.servo_ticks_per_cycle.get() as usize, profile.period_s());
    let delay = profile.delay() as usize;
    let desired = run.signal("servo", "torque_desired");
    let actual = run.signal("servo", "motor_torque");
    let (truth_s, speed) = (&run.channel("truth").time_s, run.signal("truth", "dq"));
    let first = truth_s.partition_point(|&t| t < 1.5 - 1e-9);
    let offset = (run.channel("servo").time_s.partition_point(|&t| t < truth_s[first] - 1e-9), first);
    let (mut normal, mut right, mut size) = (Matrix2::zeros(), Vector2::zeros(), 0.0);
    let mut rows = Vec::new();
    for k in first..truth_s.len() - 1 {
        let servo = offset.0 + (k - offset.1) * ratio + delay;
        if servo + ratio > desired.len() {
            break;
        }
        let error: f64 = (servo..servo + ratio)
            .map(|s| (actual.row(s)[joint] - desired.row(servo)[joint]) / ratio as f64)
            .sum();
        let acceleration = (speed.row(k + 1)[joint] - speed.row(k - 1)[joint]) / (2.0 * period_s);
        rows.push((Vector2::new(-speed.row(k)[joint], -acceleration), error));
    }
    for (x, error) in &rows {
        normal += x * x.transpose();
        right += x * *error;
        size += error * error;
    }
    let solution = normal.lu().solve(&right).expect("v and a differ");
    let left: f64 = rows.iter().map(|(x, error)| (error - x.dot(&solution)).powi(2)).sum();
    (solution[0], solution[1], 1.0 - left / size)
}

/// Compared: a regression over simulated motion, and the formulas above, which contain only the timing of the
/// simulator. Without encoder quantisation and current loop, which the formulas do not include.
#[test]
fn held_setpoint_adds_predicted_damping_and_inertia() {
    // Terms of higher order in a period, and jumps of friction at reversals.
    const DAMPING: f64 = 0.03;
    const INERTIA: f64 = 0.05;
    for (name, delay) in [("a-med", 0), ("a-med", 3), ("b-soft", 0)] {
        let robot = ideal(robot(&[&format!("robot.profile.{name}.delay_servo_ticks={delay}")]));
        let options = RunOptions { duration_s: Some(6.0), ..osc(name) };
        let experiment = experiment(robot, task("joint-tracking", &[]), options);
        let run = run(&experiment);
        assert_eq!(run.ending, RunOutcome::Completed);
        let profile = experiment.profile().1;
        for (j, joint) in experiment.robot().model.joints().iter().enumerate() {
            let (b, m) = artefacts(profile, &joint.name);
            let (found_b, found_m, explained) = regress(&run, profile, j);
            let case = format!("{name}, delay {delay}, {}", joint.name);
            assert!((found_b / b - 1.0).abs() < DAMPING, "{case}: damping {found_b} for {b}");
            assert!((found_m / m - 1.0).abs() < INERTIA, "{case}: inertia {found_m} for {m}");
            assert!(explained > 0.99, "{case}: explains only {explained}");
        }
    }
}

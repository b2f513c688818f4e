//! Extrapolating transformer against drives simulated independently, on joints that move as prescribed.
#![expect(clippy::unwrap_used, reason = "a test")]

use super::emulation::{CASE, Case, Drives, POSITION_SERVOS, RATIO, SERVO_S, VELOCITY_SERVOS, model, sample};
use nalgebra::DVector;
use opspace_backend::quantity::Positive;
use opspace_backend::{CommandKind, GravityCompensation, Setpoints};
use opspace_model::Data;
use opspace_transformer::drive_timing::DriveTiming;
use opspace_transformer::estimator::VelocityEstimator;
use opspace_transformer::moving_joint::{MovingJoint, SampledDrive};
use opspace_transformer::{
    EstimatorParameters, ExtrapolatingTransformer, ExtrapolationSetup, GainAdaptationParameters, Gears,
    RemainingDamping, ServoLaw, ServoParameters, SetpointNoise, Transformer,
};
use std::collections::VecDeque;
use std::f64::consts::TAU;

/// Relative rounding error of a torque.
const EXACT: f64 = 1e-9;

fn setup(case: Case) -> ExtrapolationSetup {
    ExtrapolationSetup {
        servos: case.servo.parameters(),
        torque_limits: vec![10.0; 2],
        remaining_damping: vec![RemainingDamping::default(); 2],
        timing: DriveTiming {
            servo_period_s: SERVO_S,
            servo_ticks_per_cycle: RATIO,
            delay: case.delay,
            setpoints: case.setpoints,
        },
        estimator: EstimatorParameters {
            velocity_filter_hz: Positive::literal(80.0),
            ..EstimatorParameters::default()
        },
        gravity_compensated_by: GravityCompensation::Controller,
        has_brakes: case.has_brakes,
        gears: Gears::Elastic,
        antiresonance_hz: None,
        setpoint_noise: Vec::new(),
        current: case.current.then(GainAdaptationParameters::usual),
    }
}

/// Relative error of the mean torques of the intervals in which setpoints act, after `skipped` cycles, on joints that move
/// along `motion`: position at a time (s). The torques swing with
/// this amplitude.
fn error(case: Case, skipped: usize, swing: f64, motion: impl Fn(f64) -> f64) -> f64 {
    let model = model(false);
    let mut data = Data::new(&model);
    let mut transformer = ExtrapolatingTransformer::new(&setup(case)).unwrap();
    let takes = case.servo.takes();
    let mut drives = Drives::new(case);
    let starts = drives.q;
    let mut sample = sample(takes, case.current);
    let rest = if takes == CommandKind::Velocity { [0.0; 2] } else { starts };
    let (mut from, mut to, mut new) = (rest, rest, DVector::from_column_slice(&rest));
    let mut ramp = RATIO;
    let mut waiting = VecDeque::new();
    let (mut asked, mut torques) = (Vec::new(), Vec::new());
    for k in 0..1200_u32 {
        let time_s = |tick: u32| f64::from(k * RATIO + tick) * SERVO_S;
        sample.q.copy_from_slice(&starts.map(|q| q + motion(time_s(0))));
        assert!(transformer.observe(&sample).is_none());
        let t = time_s(0);
        let tau = [0.5 + swing * (TAU * 0.7 * t).sin(), 0.2 + 0.4 * swing * (TAU * 1.1 * t).sin()];
        transformer.transform(&data, &tau, new.as_mut_slice());
        transformer.sent(&data, new.as_slice());
        waiting.push_back((k * RATIO + case.delay, [new[0], new[1]]));
        data.q.copy_from_slice(&sample.q);
        asked.push(tau);
        let mut mean = [0.0; 2];
        for tick in 0..RATIO {
            if let Some((_, acting)) = waiting.pop_front_if(|(acts_at, _)| *acts_at == k * RATIO + tick) {
                (from, to, ramp) = (to, acting, 0);
            }
            ramp = (ramp + 1).min(RATIO);
            let share = match case.setpoints {
                Setpoints::Held => 1.0,
                Setpoints::Interpolated => f64::from(ramp) / f64::from(RATIO),
            };
            drives.q = starts.map(|q| q + motion(time_s(tick)));
            let torque = [0, 1].map(|i| drives.torque(i, from[i] + share * (to[i] - from[i])));
            torques.push(torque);
            mean = [0, 1].map(|i| mean[i] + torque[i] / f64::from(RATIO));
        }
        if let Some(measured) = &mut sample.motor_torque {
            measured.copy_from_slice(&mean);
        }
    }
    let (mut wrong, mut all) = (0.0, 0.0);
    let windows = torques[case.delay as usize..].chunks_exact(RATIO as usize);
    for (asked, window) in asked.iter().zip(windows).skip(skipped) {
        for i in 0..2 {
            let mean = window.iter().map(|t| t[i]).sum::<f64>() / f64::from(RATIO);
            wrong += (mean - asked[i]).powi(2);
            all += asked[i].powi(2);
        }
    }
    (wrong / all).sqrt()
}

/// Compared: mean torques of joints at a constant velocity, and the desired ones, for all servos, setpoints and delays.
#[test]
fn mean_torque_is_exact_at_constant_velocity() {
    for servo in POSITION_SERVOS.into_iter().chain(VELOCITY_SERVOS) {
        for setpoints in [Setpoints::Held, Setpoints::Interpolated] {
            for delay in [0, 2, RATIO, 2 * RATIO + 3] {
                let case = Case { servo, setpoints, delay, ..CASE };
                let error = error(case, 400, 0.0, |t| 0.3 * t);
                assert!(error < EXACT, "{case:?}: {error:e}");
            }
        }
    }
}

/// Compared: errors of an oscillating joint whose gains are told wrong, without and with current.
#[test]
fn current_corrects_wrong_gains() {
    let motion = |t: f64| 0.2 * (TAU * 0.9 * t).sin() + 0.05 * (TAU * 2.3 * t).sin();
    for delay in [0, 3, 2 * RATIO + 3] {
        let nominal = error(Case { current: true, delay, ..CASE }, 600, 1.0, motion);
        for gain_scale in [0.6, 0.9, 1.1, 1.4] {
            let case = Case { gain_scale, delay, ..CASE };
            let without = error(case, 600, 1.0, motion);
            let with = error(Case { current: true, ..case }, 600, 1.0, motion);
            // Over several cycles, the motion that is extrapolated errs more than the gains.
            let is_small = delay > RATIO || with < 0.2 * without;
            assert!(with < 1.2 * nominal && with < without && is_small, "{case:?}: {with} and {without}");
        }
    }
}

/// Largest error of the mean torques (Nm) that a drive with this servo produces for a constant torque of 2 Nm, after a
/// second at 0.3 rad/s.
fn error_at_constant_velocity(servo: &ServoParameters, timing: DriveTiming) -> f64 {
    let model = model(false);
    let data = Data::new(&model);
    let period_s = timing.period_s();
    let mut transformer = ExtrapolatingTransformer::new(&ExtrapolationSetup {
        servos: vec![servo.clone(); 2],
        timing,
        ..setup(CASE)
    })
    .unwrap();
    let velocity = VelocityEstimator::new(2, &setup(CASE).estimator, period_s);
    let sample = sample(CommandKind::Position, false);
    let mut arm = MovingJoint::new(&mut transformer, &data, 0, velocity, sample);
    let law = ServoLaw::new(servo, timing.servo_period_s).unwrap();
    let mut drive = SampledDrive::new(law, timing, 0.0, 0.0);
    let cycles = (1.2 / period_s) as u32;
    let settled = (1.0 / period_s) as u32;
    let mut worst = 0.0_f64;
    for cycle in 0..cycles {
        let at = |tick: u32| 0.3 * (f64::from(cycle) * period_s + f64::from(tick) * timing.servo_period_s);
        let setpoint = arm.cycle(at(0), 0.0, |_| 2.0);
        for tick in 0..timing.servo_ticks_per_cycle {
            drive.step(setpoint, at(tick));
        }
        let mean = drive.end_cycle(setpoint);
        if cycle > settled {
            worst = worst.max((mean - 2.0).abs());
        }
    }
    worst
}

/// Compared: mean torques of drives that feed the setpoint's velocity forward or filter setpoints, and the desired ones.
#[test]
fn feed_forward_and_filters_are_inverted_exactly() {
    let cascade = "kp_per_s = 40.0, kv_nms_per_rad = 10.0, velocity_filter_hz = 300.0";
    for more in [
        "velocity_feed_forward = 1.0",
        "velocity_feed_forward = 0.7",
        "setpoint_filter = { first-order = { cutoff_hz = 100.0 } }",
        "setpoint_filter = { first-order = { cutoff_hz = 20.0 } }",
        "setpoint_filter = { second-order = { natural_frequency_hz = 100.0, damping_ratio = 1.0 } }",
        "setpoint_filter = { second-order = { natural_frequency_hz = 20.0, damping_ratio = 0.7 } }",
        "setpoint_filter = { first-order = { cutoff_hz = 50.0 } }, velocity_feed_forward = 1.0",
        "setpoint_filter = { moving-average = { time_s = 0.001 } }",
        "setpoint_filter = { moving-average = { time_s = 0.01 } }",
        "setpoint_filter = { moving-average = { time_s = 0.005, second_time_s = 0.004 } }, velocity_feed_forward = 1.0",
    ] {
        let servo: ServoParameters = toml::from_str(&format!("cascaded = {{ {cascade}, {more} }}")).unwrap();
        for setpoints in [Setpoints::Held, Setpoints::Interpolated] {
            for delay in [0, 2, 12] {
                let timing = DriveTiming { servo_period_s: 4e-4, servo_ticks_per_cycle: 5, delay, setpoints };
                let error = error_at_constant_velocity(&servo, timing);
                assert!(error < EXACT, "{more} {setpoints:?} {delay}: {error:e}");
            }
        }
    }
}

/// Compared: noise of the setpoints' acceleration behind positions with a rounding error, at a constant velocity, and the limits of the drive.
#[test]
fn noise_of_positions_stays_within_limits_of_setpoints() {
    let cascade =
        "kp_per_s = 10.0, kv_nms_per_rad = 90.0, velocity_filter_hz = 600.0, velocity_feed_forward = 1.0";
    let servo: ServoParameters = toml::from_str(&format!("cascaded = {{ {cascade} }}")).unwrap();
    let timing = DriveTiming {
        servo_period_s: 2e-4,
        servo_ticks_per_cycle: 5,
        delay: 0,
        setpoints: Setpoints::Interpolated,
    };
    let resolution = 3.5e-5;
    for (acceleration_limit, jerk_limit, largest) in
        [(10.0, None, 1.0), (10.0, Some(5000.0), 1.0), (1000.0, Some(5000.0), 1.0), (20.0, None, 2.0)]
    {
        let noise =
            SetpointNoise { position_noise: resolution / 12f64.sqrt(), acceleration_limit, jerk_limit };
        let mut transformer = ExtrapolatingTransformer::new(&ExtrapolationSetup {
            servos: vec![servo.clone(); 2],
            timing,
            setpoint_noise: vec![Some(noise); 2],
            ..setup(CASE)
        })
        .unwrap();
        let (model, mut setpoints) = (model(false), Vec::new());
        let data = Data::new(&model);
        let velocity = VelocityEstimator::new(2, &setup(CASE).estimator, 1e-3);
        let sample = sample(CommandKind::Position, false);
        let mut arm = MovingJoint::new(&mut transformer, &data, 0, velocity, sample);
        for cycle in 0..3000 {
            let position = 0.3137e-3 * f64::from(cycle);
            setpoints.push(arm.cycle((position / resolution).round() * resolution, 0.0, |_| 2.0));
        }
        let accelerations = setpoints[1000..].windows(3).map(|x| (x[2] - 2.0 * x[1] + x[0]) / 1e-6);
        let rms = (accelerations.map(|a| a * a).sum::<f64>() / 1998.0).sqrt();
        assert!(rms < largest && rms > 0.3 * largest, "{noise:?}: {rms}");
    }
}

//! Impedance of drives with their transformers.
#![expect(clippy::unwrap_used, reason = "a test")]

use super::emulation::{SERVO_S, model, sample};
use nalgebra::Complex;
use opspace_backend::quantity::Positive;
use opspace_backend::{CommandKind, GravityCompensation, Setpoints};
use opspace_model::{Data, update};
use opspace_transformer::drive_timing::DriveTiming;
use opspace_transformer::estimator::VelocityEstimator;
use opspace_transformer::impedance::impedance;
use opspace_transformer::impulse_response::ImpulseResponse;
use opspace_transformer::moving_joint::MovingJoint;

use opspace_transformer::{
    CascadedServo, EstimatorParameters, ExtrapolatingTransformer, ExtrapolationSetup,
    GainAdaptationParameters, Gears, PaperTransformer, RemainingDamping, ServoLaw, ServoParameters,
    SetpointFilter, Transformer,
};
use std::f64::consts::TAU;

const KP: f64 = 40.0;
const KV: f64 = 10.0;
const FILTER_HZ: f64 = 300.0;
const ESTIMATOR_HZ: f64 = 100.0;

/// Rounding error of an impedance, relative to the damping of the servo.
const ROUNDING: f64 = 1e-4;

/// Tolerance of a share of the desired torque: what a response leaves out at its end.
const SHARE: f64 = 5e-3;

fn servo() -> ServoParameters {
    let [kp, kv, filter_hz] = [KP, KV, FILTER_HZ].map(positive);
    ServoParameters::Cascaded(CascadedServo::new(kp, kv, filter_hz))
}

fn timing(ratio: u32, delay: u32, setpoints: Setpoints) -> DriveTiming {
    DriveTiming { servo_period_s: 0.4 * SERVO_S, servo_ticks_per_cycle: ratio, delay, setpoints }
}

fn positive(value: f64) -> Positive {
    Positive::try_from(value).unwrap()
}

fn estimator(hz: f64) -> EstimatorParameters {
    EstimatorParameters { velocity_filter_hz: positive(hz), ..EstimatorParameters::default() }
}

fn measure(
    servo: &ServoParameters,
    estimator_hz: f64,
    transformer: &mut dyn Transformer,
    timing: DriveTiming,
    current: bool,
    hz: &[f64],
) -> Vec<(f64, Complex<f64>)> {
    let model = model(false);
    let mut data = Data::new(&model);
    assert!(update(&model, &mut data, &[0.1, 0.2], &[0.0; 2]));
    let estimator = estimator(estimator_hz);
    let law = ServoLaw::new(servo, timing.servo_period_s).unwrap();
    hz.iter()
        .flat_map(|&hz| {
            let mut arm = Some(MovingJoint::new(
                &mut *transformer,
                &data,
                0,
                VelocityEstimator::new(2, &estimator, timing.period_s()),
                sample(CommandKind::Position, current),
            ));
            impedance(|| arm.take().unwrap(), law, timing, &[hz])
        })
        .collect()
}

fn low_pass(s: Complex<f64>, period_s: f64, cutoff_hz: f64) -> Complex<f64> {
    let pole = (-TAU * cutoff_hz * period_s).exp();
    let back = (-s * period_s).exp();
    (1.0 - pole) * (1.0 - back) / (period_s * (1.0 - pole * back)) / s
}

/// Compared: impedance of the paper's transformer, measured and from the transfer functions of its parts.
#[test]
fn impedance_of_paper_transformer_matches_transfer_functions() {
    for (ratio, delay) in [(1, 0), (5, 0), (5, 2)] {
        let timing = timing(ratio, delay, Setpoints::Held);
        let (ts, t) = (timing.servo_period_s, timing.period_s());
        let mut paper = PaperTransformer::new(vec![servo().gains(ts); 2]);
        for (hz, z) in measure(&servo(), ESTIMATOR_HZ, &mut paper, timing, false, &[3.0, 20.0, 90.0, 180.0]) {
            let s = Complex::new(0.0, TAU * hz);
            // The torque is held for a servo period; its phase counts from the middle of the period.
            let hold = (-s * f64::from(delay) * ts).exp() * (1.0 - (-s * t).exp())
                / (f64::from(ratio) * (1.0 - (-s * ts).exp()));
            let drive = KV * (KP / s + low_pass(s, ts, FILTER_HZ));
            let added = KV * (KP / s + low_pass(s, t, ESTIMATOR_HZ)) * hold;
            let expected = (drive - added) * (-s * 0.5 * ts).exp();
            assert!((z - expected).norm() < 1e-6 * drive.norm(), "{ratio} {delay} {hz}: {z} {expected}");
        }
    }
}

/// Response of a drive behind a setpoint filter. Compared: its sum with the torque that was asked for, which the extrapolation
/// gives altogether, and its first element, all of the torque without the filter and less with it. Equation (K10) gives a drive without
/// filter all of it at once too.
#[test]
fn torque_response_is_that_of_an_inverted_drive() {
    let filters = [None, Some(20.0), Some(50.0)];
    let filters = filters.map(|hz| hz.map(|hz| SetpointFilter::FirstOrder { cutoff_hz: positive(hz) }));
    let model = model(false);
    let mut data = Data::new(&model);
    assert!(update(&model, &mut data, &[0.1, 0.2], &[0.0; 2]));
    let timing = timing(5, 0, Setpoints::Held);
    for setpoint_filter in filters {
        let [kp, kv, filter_hz] = [KP, KV, FILTER_HZ].map(positive);
        let cascade = CascadedServo { setpoint_filter, ..CascadedServo::new(kp, kv, filter_hz) };
        let servo = ServoParameters::Cascaded(cascade);
        let law = ServoLaw::new(&servo, timing.servo_period_s).unwrap();
        let extrapolation = ExtrapolatingTransformer::new(&setup(&servo, ESTIMATOR_HZ, timing)).unwrap();
        let paper = PaperTransformer::new(vec![servo.gains(timing.servo_period_s); 2]);
        let transformers: [Box<dyn Transformer>; 2] = [Box::new(extrapolation), Box::new(paper)];
        let [extrapolated, held] = transformers.map(|mut transformer| {
            let velocity = VelocityEstimator::new(2, &estimator(ESTIMATOR_HZ), timing.period_s());
            let sample = sample(CommandKind::Position, false);
            let mut arm = MovingJoint::new(&mut *transformer, &data, 0, velocity, sample);
            ImpulseResponse::new(&mut arm, law, timing).torque
        });
        let sum: f64 = extrapolated.iter().sum();
        assert!((sum - 1.0).abs() < SHARE, "{setpoint_filter:?}: {extrapolated:?}");
        let is_at_once = |response: &[f64]| (response[0] - 1.0).abs() < SHARE && response.len() == 1;
        let is_plain = setpoint_filter.is_none();
        assert_eq!(is_at_once(&extrapolated), is_plain, "{setpoint_filter:?}: {extrapolated:?}");
        assert_eq!(is_at_once(&held), is_plain, "{setpoint_filter:?}: {held:?}");
    }
}

fn setup(servo: &ServoParameters, estimator_hz: f64, timing: DriveTiming) -> ExtrapolationSetup {
    ExtrapolationSetup {
        servos: vec![servo.clone(); 2],
        torque_limits: vec![100.0; 2],
        remaining_damping: vec![RemainingDamping::default(); 2],
        timing,
        estimator: estimator(estimator_hz),
        gravity_compensated_by: GravityCompensation::Controller,
        has_brakes: false,
        gears: Gears::Elastic,
        antiresonance_hz: None,
        setpoint_noise: Vec::new(),
        current: None,
    }
}

/// Random numbers between two others.
fn random_numbers(seed: u64) -> impl FnMut(f64, f64) -> f64 {
    let mut state = seed;
    move |low, high| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * (state >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// Drive and estimator with random parameters: servo, estimator cut-off (Hz), timing.
fn random_drive(random: &mut impl FnMut(f64, f64) -> f64) -> (ServoParameters, f64, DriveTiming) {
    let servo_hz = random(1e3, 8e3);
    let ratio = random(1.0, 10.99) as u32;
    let interface_hz = servo_hz / f64::from(ratio);
    let kp = positive(random(15.0, 60.0).min(interface_hz / 10.0));
    let kv = positive(random(3.0, 100.0));
    let filter_hz = positive(random(0.05, 0.3) * servo_hz);
    let servo = ServoParameters::Cascaded(CascadedServo::new(kp, kv, filter_hz));
    let timing = DriveTiming {
        servo_period_s: 1.0 / servo_hz,
        servo_ticks_per_cycle: ratio,
        delay: random(0.0, f64::from(ratio) + 0.99) as u32,
        setpoints: if random(0.0, 1.0) < 0.5 { Setpoints::Held } else { Setpoints::Interpolated },
    };
    (servo, random(0.05, 0.4) * interface_hz, timing)
}

/// Checks the real part of the impedance up to half of the Nyquist frequency of the interface, beyond which sampling alone
/// makes servos active: not negative without current. With current, which takes away the added inertia below
/// [`SETTLED_HZ`](opspace_transformer::extrapolating_transformer::SETTLED_HZ), it may be as low as a quarter of kv.
#[test]
fn extrapolation_is_passive() {
    let mut random = random_numbers(12_345);
    for _ in 0..60 {
        let (servo, estimator_hz, timing) = random_drive(&mut random);
        let setup = setup(&servo, estimator_hz, timing);
        for current in [false, true] {
            let current_setup = ExtrapolationSetup {
                current: current.then(GainAdaptationParameters::usual),
                ..setup.clone()
            };
            let mut extrapolation = ExtrapolatingTransformer::new(&current_setup).unwrap();
            let nyquist = 0.5 / timing.period_s();
            let hz = [0.01, 0.02, 0.04, 0.06, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5].map(|x| x * nyquist);
            let z = measure(&servo, estimator_hz, &mut extrapolation, timing, current, &hz);
            let worst = z.iter().min_by(|a, b| a.1.re.total_cmp(&b.1.re)).unwrap();
            let kv = servo.gains(timing.servo_period_s).damping;
            let least = worst.1.re / kv;
            let allowed = if current { 0.25 } else { 0.0 };
            assert!(least > -allowed - ROUNDING, "{timing:?}: {least} kv at {} Hz", worst.0);
        }
    }
}

/// Largest real part that the least damping leaves with the gains at the upper end of their interval, at the lowest frequency, as a
/// fraction of kv: what the estimate of the velocity lacks there.
const LEFT_AT_THE_EDGE: f64 = 0.07;

/// Drives of random parameters whose true gains are at the ends of intervals of 0 to 30 %: with the damping that is left to them,
/// extrapolation does not drive the joint at any frequency. With the largest kp the damping at the lowest frequency is zero: less
/// would not do. A drive that takes a setpoint at each servo tick, without delay, is excepted: above some hundred hertz, the filter of
/// its velocity and that of the estimate differ, and nothing else damps.
#[test]
fn gains_within_their_interval_do_not_drive_the_joint() {
    let mut random = random_numbers(54_321);
    for _ in 0..40 {
        let (servo, estimator_hz, timing) = random_drive(&mut random);
        if timing.servo_ticks_per_cycle == 1 && timing.delay == 0 {
            continue;
        }
        let half_width = random(0.0, 0.3);
        let remaining = servo.remaining_damping(half_width);
        let setup = ExtrapolationSetup {
            remaining_damping: vec![remaining; 2],
            ..setup(&servo, estimator_hz, timing)
        };
        let nyquist = 0.5 / timing.period_s();
        let hz = [0.01, 0.03, 0.06, 0.1, 0.2, 0.3, 0.4, 0.5].map(|x| x * nyquist);
        for (kp, kv) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
            let truth = servo.scaled(1.0 + kp * half_width, 1.0 + kv * half_width);
            let mut extrapolation = ExtrapolatingTransformer::new(&setup).unwrap();
            let z = measure(&truth, estimator_hz, &mut extrapolation, timing, false, &hz);
            let damping = truth.gains(timing.servo_period_s).damping;
            let worst = z.iter().min_by(|a, b| a.1.re.total_cmp(&b.1.re)).unwrap();
            let least = worst.1.re / damping;
            let case = format!("{timing:?}, {half_width}, {kp}, {kv}");
            assert!(least > -ROUNDING, "{case}: {least} kv at {} Hz", worst.0);
            let slow = z[0].1.re / damping;
            assert!(kp < 0.0 || slow < LEFT_AT_THE_EDGE, "{case}: {slow} kv at {} Hz", z[0].0);
        }
    }
}

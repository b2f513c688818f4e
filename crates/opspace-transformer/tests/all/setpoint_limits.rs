//! Limits of the sequence of setpoints, against sequences whose differences are known.
#![expect(clippy::unwrap_used, reason = "a test")]

use opspace_backend::CommandKind;
use opspace_transformer::{JointSetpointLimits, SetpointLimit, SetpointLimitParameters, SetpointStream};

const PERIOD_S: f64 = 1e-3;
const VELOCITY: f64 = 2.0;
const ACCELERATION: f64 = 10.0;
const JERK: f64 = 5000.0;

fn limits(text: &str) -> JointSetpointLimits {
    toml::from_str(text).unwrap()
}

fn all() -> JointSetpointLimits {
    limits("velocity_rad_per_s = 2.0\nacceleration_rad_per_s2 = 10.0\njerk_rad_per_s3 = 5000.0")
}

/// Setpoints of a rest at 0.3, and then of constant `jerk` up to `acceleration`, which lasts up to `velocity`: each
/// difference is summed up.
fn profile(jerk: f64, acceleration: f64, velocity: f64) -> Vec<f64> {
    let (mut q, mut v, mut a) = (0.3, 0.0, 0.0_f64);
    let mut setpoints = vec![q];
    for _ in 0..400 {
        a = (a + jerk * PERIOD_S).min(acceleration).min((velocity - v) / PERIOD_S);
        v += a * PERIOD_S;
        q += v * PERIOD_S;
        setpoints.push(q);
    }
    setpoints
}

fn first_exceeded(limits: &JointSetpointLimits, setpoints: &[f64]) -> Option<SetpointLimit> {
    let mut stream = SetpointStream::new(limits, CommandKind::Position, PERIOD_S);
    setpoints.iter().find_map(|&setpoint| {
        let exceeded = stream.exceeds(setpoint);
        stream.take(setpoint);
        exceeded
    })
}

/// Compared: sequences at each limit, and a thousandth beyond it. The end of the acceleration exceeds the jerk, so that
/// only limits of velocity and acceleration are set where it counts.
#[test]
fn differences_are_those_of_the_profile() {
    let more = 1.001;
    assert_eq!(first_exceeded(&all(), &profile(JERK, ACCELERATION, f64::INFINITY)[..200]), None);
    let beyond = profile(JERK * more, ACCELERATION, f64::INFINITY);
    assert_eq!(first_exceeded(&all(), &beyond), Some(SetpointLimit::Jerk));
    let beyond = profile(JERK, ACCELERATION * more, f64::INFINITY);
    assert_eq!(first_exceeded(&all(), &beyond), Some(SetpointLimit::Acceleration));
    let without_jerk = limits("velocity_rad_per_s = 2.0\nacceleration_rad_per_s2 = 10.0");
    assert_eq!(first_exceeded(&without_jerk, &profile(JERK, ACCELERATION, VELOCITY)), None);
    let beyond = profile(JERK, ACCELERATION, VELOCITY * more);
    assert_eq!(first_exceeded(&without_jerk, &beyond), Some(SetpointLimit::Velocity));
    assert_eq!(first_exceeded(&JointSetpointLimits::default(), &beyond), None);
}

/// Checks that every difference of the clamped setpoints of a step is within its limit, that the step is approached, and
/// that setpoints within the limits are unchanged, bit for bit.
#[test]
fn clamped_setpoints_are_within_limits() {
    let mut stream = SetpointStream::new(&all(), CommandKind::Position, PERIOD_S);
    stream.take(0.3);
    let mut setpoints = vec![0.3; 4];
    for _ in 0..250 {
        let clamped = stream.clamp(0.8);
        assert_eq!(stream.exceeds(clamped), None);
        stream.take(clamped);
        setpoints.push(clamped);
    }
    let differences = |values: &[f64]| -> Vec<f64> {
        values.windows(2).map(|pair| (pair[1] - pair[0]) / PERIOD_S).collect()
    };
    let largest = |values: &[f64]| values.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
    let velocities = differences(&setpoints);
    let accelerations = differences(&velocities);
    assert!(largest(&velocities) <= VELOCITY * (1.0 + 1e-6), "{}", largest(&velocities));
    assert!(largest(&accelerations) <= ACCELERATION * (1.0 + 1e-6), "{}", largest(&accelerations));
    assert!(largest(&differences(&accelerations)) <= JERK * (1.0 + 1e-6));
    assert!((0.55..0.8).contains(&setpoints[250]), "{}", setpoints[250]);
    let mut stream = SetpointStream::new(&all(), CommandKind::Position, PERIOD_S);
    for setpoint in profile(JERK, ACCELERATION, f64::INFINITY).into_iter().take(200) {
        assert_eq!(stream.clamp(setpoint).to_bits(), setpoint.to_bits());
        stream.take(setpoint);
    }
}

/// Compared: the velocity of a velocity robot's setpoint, which is the setpoint itself, and its differences.
#[test]
fn velocity_setpoints_are_not_differentiated() {
    let stream = || {
        let mut stream = SetpointStream::new(&all(), CommandKind::Velocity, PERIOD_S);
        stream.take(1.0);
        stream
    };
    assert_eq!(stream().exceeds(1.0), None);
    assert_eq!(stream().exceeds(3.0), Some(SetpointLimit::Velocity));
    assert_eq!(stream().exceeds(1.011), Some(SetpointLimit::Acceleration));
    assert_eq!(stream().exceeds(1.009), Some(SetpointLimit::Jerk));
    assert_eq!(stream().exceeds(1.0049), None);
    let clamped = stream().clamp(3.0);
    assert!((clamped - (1.0 + JERK * PERIOD_S * PERIOD_S)).abs() < 1e-12, "{clamped}");
    let first = SetpointStream::new(&all(), CommandKind::Velocity, PERIOD_S);
    assert_eq!(first.exceeds(2.1), Some(SetpointLimit::Velocity));
    assert_eq!(first.clamp(2.1), 2.0);
}

/// Checks that a drive that keeps its setpoint is at rest there, and that after a restart any position is accepted.
#[test]
fn kept_setpoint_is_at_rest() {
    let mut stream = SetpointStream::new(&all(), CommandKind::Position, PERIOD_S);
    profile(JERK, ACCELERATION, f64::INFINITY)[..50].iter().for_each(|&setpoint| stream.take(setpoint));
    let last = profile(JERK, ACCELERATION, f64::INFINITY)[49];
    assert_eq!(stream.exceeds(last), Some(SetpointLimit::Acceleration), "in motion");
    stream.keep();
    assert_eq!(stream.exceeds(last), None, "at rest");
    assert_eq!(stream.exceeds(last + 1.0), Some(SetpointLimit::Velocity));
    stream.restart();
    assert_eq!(stream.exceeds(last + 1.0), None);
}

#[test]
fn limits_are_above_zero_and_reactions_are_known() {
    let refused = |text: &str| toml::from_str::<SetpointLimitParameters>(text).unwrap_err().to_string();
    let zero = refused("reaction = \"clamp\"\njoint.elbow = { velocity_rad_per_s = 0.0 }");
    assert!(zero.contains("expected a number above 0, got 0"), "{zero}");
    let unknown = refused("reaction = \"ignore\"\njoint = {}");
    assert!(["clamp", "refuse", "stop"].iter().all(|name| unknown.contains(name)), "{unknown}");
}

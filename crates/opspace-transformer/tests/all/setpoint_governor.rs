//! Setpoints within limits, against the check that drives make.

use opspace_backend::CommandKind;
use opspace_backend::quantity::Positive;
use opspace_transformer::setpoint_governor::GovernedSetpoint;
use opspace_transformer::setpoint_limits::{JointSetpointLimits, SetpointStream};

const PERIOD_S: f64 = 1e-3;

fn limits(values: [Option<f64>; 3]) -> JointSetpointLimits {
    let [velocity, acceleration, jerk] = values.map(|v| v.map(Positive::literal));
    let mut limits = JointSetpointLimits::default();
    limits.velocity_rad_per_s = velocity;
    limits.acceleration_rad_per_s2 = acceleration;
    limits.jerk_rad_per_s3 = jerk;
    limits
}

/// Pseudo-random numbers from 0 to 1.
fn random(mut state: u64) -> impl FnMut() -> f64 {
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// Checks that no setpoint of a violent random command exceeds a limit, for position and velocity robots.
#[test]
fn governed_setpoints_exceed_no_limit() {
    let mut random = random(7);
    for takes in [CommandKind::Position, CommandKind::Velocity] {
        for values in [
            [Some(2.0), Some(10.0), Some(5000.0)],
            [Some(2.0), Some(10.0), None],
            [Some(0.5), None, Some(300.0)],
            [None, Some(3.0), Some(40.0)],
            [Some(1.0), None, None],
        ] {
            let limits = limits(values);
            let mut governor = GovernedSetpoint::new(&limits, takes, PERIOD_S);
            let mut drive = SetpointStream::new(&limits, takes, PERIOD_S);
            let (mut target, mut noise) = (0.0, 0.0);
            for cycle in 0..20_000 {
                if random() < 0.005 {
                    target = 4.0 * random() - 2.0;
                    noise = 0.1 * random().powi(4);
                }
                let desired = if cycle == 0 { 0.0 } else { target + noise * (random() - 0.5) };
                let setpoint = governor.follow(desired);
                assert!(drive.exceeds(setpoint).is_none(), "{takes:?} {values:?} cycle {cycle}");
                governor.take(setpoint);
                drive.take(setpoint);
            }
        }
    }
}

/// Compared: setpoints of a command within the limits, and the command; and the last setpoints of a constant one.
#[test]
fn governor_follows_what_is_within_limits() {
    let limits = limits([Some(2.0), Some(10.0), Some(5000.0)]);
    let mut governor = GovernedSetpoint::new(&limits, CommandKind::Position, PERIOD_S);
    let mut off = 0.0_f64;
    for cycle in 0..3000 {
        let t = f64::from(cycle) * PERIOD_S;
        // At most 1.6 rad/s and 3.2 rad/s².
        let desired = 0.8 * (1.0 - (2.0 * t).cos());
        let setpoint = governor.follow(desired);
        governor.take(setpoint);
        off = off.max((setpoint - desired).abs());
    }
    assert!(off < 1e-5, "{off}");
    for _ in 0..3000 {
        let setpoint = governor.follow(0.3);
        governor.take(setpoint);
    }
    let rest = governor.follow(0.3);
    assert!((rest - 0.3).abs() < 1e-5, "{}", rest - 0.3);
}

/// Compared, for random limits: the overshoot of a step, and a hundredth of it; the times that a setpoint passes a target which
/// stops suddenly, and one. A braking distance without the time in which the acceleration builds up overshoots again and again.
#[test]
fn governed_setpoints_do_not_oscillate() {
    const TARGET: f64 = 0.2;
    const OVERSHOOT: f64 = 0.01 * TARGET;
    const REST: f64 = 1e-6;
    let mut random = random(11);
    let mut between = |low: f64, high: f64| 10_f64.powf(low + (high - low) * random());
    for case in 0..200 {
        let velocity = between(-0.3, 0.7);
        let acceleration = between(0.7, 3.3);
        let jerk = acceleration * between(0.7, 3.5);
        let limits = limits([velocity, acceleration, jerk].map(Some));
        let mut governor = GovernedSetpoint::new(&limits, CommandKind::Position, PERIOD_S);
        governor.take(0.0);
        // The target is there at once, or after 0.2 s.
        let is_step = case % 2 == 0;
        let ramp_s = if is_step { PERIOD_S } else { 0.2 };
        let (mut most, mut last, mut side, mut passes) = (0.0_f64, 0.0, -1.0, 0);
        for cycle in 1..60_000 {
            let t = f64::from(cycle) * PERIOD_S;
            last = governor.follow(TARGET * (t / ramp_s).min(1.0));
            governor.take(last);
            most = most.max(last);
            if t > ramp_s && side * (last - TARGET) < -OVERSHOOT {
                (side, passes) = (-side, passes + 1);
            }
        }
        let name = format!("V {velocity} A {acceleration} J {jerk}, step {is_step}");
        assert!((last - TARGET).abs() < REST, "{name}: {last}");
        assert!(!is_step || most < TARGET + OVERSHOOT, "{name}: {most}");
        assert!(passes <= 1, "{name}: {passes}");
    }
}

/// A desired setpoint that is not a number does not become one.
#[test]
fn governor_passes_what_is_not_a_number() {
    for takes in [CommandKind::Position, CommandKind::Velocity] {
        for values in
            [[Some(2.0), Some(10.0), Some(5000.0)], [Some(2.0), Some(10.0), None], [Some(1.0), None, None]]
        {
            let mut governor = GovernedSetpoint::new(&limits(values), takes, PERIOD_S);
            governor.take(0.0);
            assert!(governor.follow(f64::NAN).is_nan(), "{takes:?} {values:?}");
        }
    }
}

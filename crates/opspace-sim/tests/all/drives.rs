//! Tests of motor and friction against their formulas.

use crate::common::{parsed, robot};
use opspace_sim::friction::LuGre;
use opspace_sim::motor::Motor;
use opspace_sim::parameters::BristleParameters;
use opspace_transformer::{FrictionCompensation, FrictionCompensationParameters, FrictionParameters};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Compared: mean and final torque of each step, and the differential equation τ̇ = ω (asked − τ) integrated with a
/// hundred thousand Euler steps.
#[test]
fn motor_follows_first_order_lag_exactly() {
    const FINE: u32 = 100_000;
    /// First-order error of the Euler integration.
    const TOLERANCE: f64 = 1e-4;
    let (hz, dt, start) = (1000.0, 5e-5, 2.0);
    let mut motor = Motor::new(Some(hz), dt, start);
    let mut torque = start;
    for asked in [7.0, 7.0, -3.0, 0.5, 0.5] {
        let fine = dt / f64::from(FINE);
        let mut sum = 0.0;
        for _ in 0..FINE {
            sum += torque;
            torque += TAU * hz * (asked - torque) * fine;
        }
        let mean = motor.step(asked);
        let expected = sum / f64::from(FINE);
        assert!((mean - expected).abs() < TOLERANCE, "{mean} for {expected}");
    }
    // A step of ten time constants ends at the commanded torque.
    let mut slow = Motor::new(Some(hz), 10.0 / (TAU * hz), 0.0);
    slow.step(5.0);
    assert!((slow.step(5.0) - 5.0).abs() < 1e-4);
    assert_eq!(Motor::new(None, dt, start).step(7.0), 7.0, "without a current loop at once");
}

fn friction() -> (FrictionParameters, BristleParameters) {
    let friction =
        parsed("coulomb_nm = 1.8\nstatic_nm = 2.34\nstribeck_rad_per_s = 0.06\nviscous_nms_per_rad = 2.0");
    let bristle = robot().simulated.bristle_of(&friction);
    (friction, bristle)
}

const DT: f64 = 5e-5;

/// Compensated fraction of friction.
const GAIN: f64 = 0.8;

/// Compared: steady friction at constant speed, and Stribeck's curve.
#[test]
fn steady_friction_follows_stribeck_curve() {
    let (parameters, bristle) = friction();
    for scale in [1.0, 0.5] {
        for v in [-2.0, -0.3, -0.05, 0.01, 0.06, 0.2, 1.0, 6.0_f64] {
            let mut joint = LuGre::new(&parameters, &bristle, scale);
            // Ten bristle lengths of travel.
            let steps = (10.0 * 2.34 / 4000.0 / (v.abs() * DT)).ceil() as u32;
            let settled = (0..steps).map(|_| joint.step(v, DT)).last().expect("a step");
            let curve = (1.8 + (2.34 - 1.8) * (-(v / 0.06) * (v / 0.06)).exp()) * v.signum() + 2.0 * v;
            assert!((settled - scale * curve).abs() < 1e-3, "at {v}: {settled} for {}", scale * curve);
        }
    }
}

/// Compared: steady friction under a load of either sign, and Stribeck's curve with a tenth of the load added to Coulomb friction.
#[test]
fn friction_grows_with_the_load() {
    let (parameters, bristle) = friction();
    for (v, load) in [(0.3, 4.0), (-0.3, 4.0), (1.0, -12.0), (-2.0, 0.0_f64)] {
        let mut joint = LuGre::new(&parameters, &bristle, 1.0).with_friction_per_load(0.1);
        joint.set_load(load);
        let settled = (0..40_000).map(|_| joint.step(v, DT)).last().expect("a step");
        let stribeck = 1.8 + 0.1 * load.abs() + (2.34 - 1.8) * (-(v / 0.06) * (v / 0.06)).exp();
        let expected = stribeck * v.signum() + 2.0 * v;
        assert!((settled - expected).abs() < 1e-3, "at {v} with {load}: {settled} for {expected}");
    }
}

/// Compared: torque per displacement far below breakaway, and the bristle stiffness σ₀.
#[test]
fn presliding_friction_is_a_spring() {
    let (parameters, bristle) = friction();
    let mut joint = LuGre::new(&parameters, &bristle, 1.0);
    // Moves slowly over 1 % of the breakaway displacement, then rests: damping and viscous friction are zero.
    let (v, steps) = (1e-4, 1200);
    for _ in 0..steps {
        joint.step(v, DT);
    }
    let displacement = v * DT * f64::from(steps);
    let stiffness = joint.step(0.0, DT) / displacement;
    assert!((stiffness / 4000.0 - 1.0).abs() < 0.01, "{stiffness} Nm/rad");
    for _ in 0..steps {
        joint.step(-v, DT);
    }
    let left = joint.step(0.0, DT);
    // At 1 % of the breakaway displacement the hysteresis is 1 %.
    assert!(left.abs() < 0.02 * 4000.0 * displacement, "a spring gives back: {left} Nm left");
}

/// Compared: the drift of a mass under a torque just below and just above static friction.
#[test]
fn joint_breaks_away_at_static_friction() {
    let drift = |torque: f64| {
        let (parameters, bristle) = friction();
        let mut joint = LuGre::new(&parameters, &bristle, 1.0);
        let (mut q, mut v, inertia) = (0.0, 0.0, 0.3);
        for step in 0..20_000 {
            // The torque ramps up over half a second, then stays constant for half a second.
            let asked = torque * (f64::from(step) / 10_000.0).min(1.0);
            v += (asked - joint.step(v, DT)) / inertia * DT;
            q += v * DT;
        }
        q
    };
    // The bristles deflect by Fs/σ₀ = 0.6 mrad; their curve is flat near breakaway.
    let (stuck, slid) = (drift(0.97 * 2.34), drift(1.03 * 2.34));
    assert!(stuck < 0.02, "sticks: {stuck} rad");
    assert!(slid > 10.0 * stuck.max(0.002), "slides: {slid} rad, stuck {stuck} rad");
    assert!((drift(-1.03 * 2.34) + slid).abs() < 1e-9, "the same either way");
}

/// Checks that friction scaled by zero gives no torque.
#[test]
fn zero_friction_gives_no_torque() {
    let (parameters, bristle) = friction();
    let mut joint = LuGre::new(&parameters, &bristle, 0.0);
    assert!([-1.0, 0.0, 0.01, 3.0].iter().all(|&v| joint.step(v, DT) == 0.0));
}

/// Speed at rest, of a mass under LuGre friction and its compensation from samples at 1 kHz, after it had 5 s to come to
/// rest from a push. `law` is an entry of the compensation's parameters.
fn speed_at_rest(inertia: f64, friction: &FrictionParameters, bristle: &BristleParameters, law: &str) -> f64 {
    const TICKS_PER_SAMPLE: u32 = 20;
    let compensation: FrictionCompensationParameters = parsed(&format!("gain = {GAIN:?}\n{law}"));
    let mut compensation = FrictionCompensation::new([friction].into_iter(), &compensation);
    let mut joint = LuGre::new(friction, bristle, 1.0);
    // The uncompensated Coulomb friction takes one second for this speed.
    let push = (1.0 - GAIN) * friction.coulomb_nm.get() / inertia;
    let (mut q, mut v, mut torque, mut last) = (0.0, push, 0.0, 0.0_f64);
    for tick in 0..120_000 {
        if tick % TICKS_PER_SAMPLE == 0 {
            compensation.advance(&[q]);
            torque = compensation.torque(0, v);
        }
        v += (torque - joint.step(v, DT)) / inertia * DT;
        q += v * DT;
        if tick >= 100_000 {
            last = last.max(v.abs());
        }
    }
    last
}

/// Checks that a joint with random friction, bristles and inertia comes to rest under the compensation, if its
/// presliding displacement is large enough for the bristles. Compensation that follows the velocity makes the heaviest friction oscillate.
#[test]
fn compensated_joint_comes_to_rest() {
    /// Speed below which a joint is at rest, rad/s; each push is faster.
    const REST: f64 = 1e-3;
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let mut between = |low: f64, high: f64| low * (high / low).powf(random.random_range(0.0..1.0));
    let mut oscillating = 0;
    for case in 0..40 {
        let (coulomb, inertia) = (between(0.1, 8.0), between(0.05, 5.0));
        let (stiction, stiffness) = (between(1.0, 1.4), between(1000.0, 10_000.0));
        // The smallest displacement for which the bristles take what the compensation supplies, or more.
        let least = (GAIN * stiction).sqrt() * coulomb / stiffness;
        let presliding = least * between(1.0, 3.0);
        let friction: FrictionParameters = parsed(&format!(
            "coulomb_nm = {coulomb:?}\nstatic_nm = {:?}\nstribeck_rad_per_s = 0.06\nviscous_nms_per_rad = \
             {coulomb:?}\npresliding_rad = {presliding:?}",
            stiction * coulomb
        ));
        let bristle = format!(
            "stiffness_nm_per_rad = {stiffness:?}\ndamping_nms_per_rad = {:?}\ndamping_fade_velocity_rad_per_s = 0.1",
            stiffness / 200.0
        );
        let bristle: BristleParameters = parsed(&bristle);
        let speed = speed_at_rest(inertia, &friction, &bristle, "follows = \"displacement\"");
        assert!(speed < REST, "case {case}: {speed} rad/s, {friction:?}, {inertia} kg m², {bristle:?}");
        let compared = speed_at_rest(inertia, &friction, &bristle, "follows = \"velocity\"");
        oscillating += u32::from(compared > REST);
    }
    assert!(oscillating > 5, "the test can tell rest from oscillation: {oscillating}");
}

//! Tests of the paper's transformer, its velocity estimator and friction compensation, against their equations.

use opspace_backend::{Capabilities, CommandKind, Measured, Sample, Setpoints};
use opspace_model::{Data, Inertia, Joint, JointKind, Limits, Model, Placement};
use opspace_transformer::{
    CurrentFeedback, DeclaredProperties, EstimatorParameters, FrictionCompensation,
    FrictionCompensationParameters, FrictionParameters, Gears, PaperTransformer, ServoGains, Transformer,
    TransformerName, VelocityEstimator, VelocityTransformer,
};
use std::f64::consts::TAU;

/// Rounding of the few operations of equation (K10), relative to positions of order 1.
const ROUNDING: f64 = 8.0 * f64::EPSILON;

/// Rounding of some hundred steps of a filter, rad/s.
const FILTERED: f64 = 1e-12;

/// Remainder of the filter's transient, rad/s.
const SETTLED: f64 = 1e-9;

const PERIOD_S: f64 = 1e-3;

/// Two massless joints: the transformer uses only q and dq of the data.
fn two_joints() -> Model {
    let mut model = Model::new("two");
    for name in ["first", "second"] {
        let joint = Joint { name: name.into(), kind: JointKind::Continuous, limits: Limits::NONE };
        model.add_body(None, Placement::identity(), joint, Inertia::zero());
    }
    model
}

fn parsed<T: serde::de::DeserializeOwned>(text: &str) -> T {
    toml::from_str(text).unwrap_or_else(|e| panic!("{e}"))
}

/// Equivalent gains of two servos: kp 50/s and kv 90 Nms/rad, kp 40/s and kv 30 Nms/rad.
fn servos() -> Vec<ServoGains> {
    [(50.0, 90.0), (40.0, 30.0)].map(|(kp, kv)| ServoGains { stiffness: kp * kv, damping: kv }).to_vec()
}

fn estimator() -> EstimatorParameters {
    parsed("velocity_filter_hz = 150.0")
}

const STATES: [([f64; 2], [f64; 2], [f64; 2]); 3] = [
    ([0.3, -1.2], [0.7, -2.1], [12.0, -7.5]),
    ([-1.9, 0.05], [-4.0, 0.001], [-40.0, 0.3]),
    ([1.1, 1.4], [0.0, 3.3], [0.0, 19.0]),
];

fn transformed_by(transformer: &mut dyn Transformer, q: [f64; 2], dq: [f64; 2], tau: [f64; 2]) -> [f64; 2] {
    let mut data = Data::new(&two_joints());
    data.q.copy_from_slice(&q);
    data.dq.copy_from_slice(&dq);
    let mut command = [0.0; 2];
    transformer.transform(&data, &tau, &mut command);
    command
}

fn transformed(q: [f64; 2], dq: [f64; 2], tau: [f64; 2]) -> [f64; 2] {
    transformed_by(&mut PaperTransformer::new(servos()), q, dq, tau)
}

/// Compared: the setpoint of the transformer's two loops, and equation (K10) as one fraction.
#[test]
fn paper_transformer_matches_equation_k10() {
    for (q, dq, tau) in STATES {
        let found = transformed(q, dq, tau);
        for (i, (kp, kv)) in [(50.0, 90.0), (40.0, 30.0)].into_iter().enumerate() {
            let expected = (tau[i] + kv * dq[i] + kv * kp * q[i]) / (kv * kp);
            assert!((found[i] - expected).abs() <= ROUNDING * 4.0, "{} for {expected}", found[i]);
        }
    }
}

/// Compared: the torque of equation (K9) at the transformer's setpoint, and the torque given to the transformer.
#[test]
fn paper_transformer_inverts_equation_k9() {
    for (q, dq, tau) in STATES {
        let found = transformed(q, dq, tau);
        for (i, (kp, kv)) in [(50.0, 90.0), (40.0, 30.0)].into_iter().enumerate() {
            let torque = kv * (kp * (found[i] - q[i]) - dq[i]);
            assert!((torque - tau[i]).abs() <= ROUNDING * kp * kv, "{torque} for {}", tau[i]);
        }
    }
}

/// Compared: the velocity setpoint, and the outer loop's kp (q_desired − q) at the position setpoint of (K10).
#[test]
fn velocity_transformer_is_inner_stage_of_k10() {
    let mut inner = VelocityTransformer::new(servos());
    assert_eq!(inner.takes(), CommandKind::Velocity);
    for (q, dq, tau) in STATES {
        let (found, both) = (transformed_by(&mut inner, q, dq, tau), transformed(q, dq, tau));
        for (i, kp) in [50.0, 40.0].into_iter().enumerate() {
            let expected = kp * (both[i] - q[i]);
            assert!((found[i] - expected).abs() <= ROUNDING * kp, "{} for {expected}", found[i]);
        }
    }
}

/// Compared: the torque of the inner loop of (K9) at the transformer's setpoint, and the torque given to the
/// transformer.
#[test]
fn velocity_transformer_inverts_velocity_loop() {
    for (q, dq, tau) in STATES {
        let found = transformed_by(&mut VelocityTransformer::new(servos()), q, dq, tau);
        for (i, kv) in [90.0, 30.0].into_iter().enumerate() {
            let torque = kv * (found[i] - dq[i]);
            assert!((torque - tau[i]).abs() <= ROUNDING * kv * 10.0, "{torque} for {}", tau[i]);
        }
    }
}

/// Compared: the torque of a velocity loop with 0.8 times the nominal kv, after correction by measured current, and the
/// desired torque.
#[test]
fn current_feedback_corrects_velocity_gain() {
    const CYCLES: usize = 100;
    let inner = Box::new(VelocityTransformer::new(servos()));
    let mut transformer = CurrentFeedback::new(inner, &[100.0, 100.0], 5, 0);
    assert_eq!(transformer.takes(), CommandKind::Velocity);
    let capabilities = Capabilities::new(["first", "second"], CommandKind::Velocity, PERIOD_S)
        .measuring(&[Measured::MotorCurrent]);
    let mut sample = Sample::new(&capabilities);
    let data = Data::new(&two_joints());
    let (tau, mut command) = ([12.0, -7.5], [0.0; 2]);
    let mut torque = [0.0; 2];
    for _ in 0..CYCLES {
        transformer.observe(&sample);
        transformer.transform(&data, &tau, &mut command);
        transformer.sent(&data, &command);
        torque = [0, 1].map(|i| 0.8 * [90.0, 30.0][i] * command[i]);
        if let Some(measured) = &mut sample.motor_torque {
            measured.copy_from_slice(&torque);
        }
    }
    for i in 0..2 {
        assert!((torque[i] - tau[i]).abs() < SETTLED, "{} for {}", torque[i], tau[i]);
    }
}

/// Compared: the estimator's recursion, and its filter written out as a sum over all past differences.
#[test]
fn velocity_is_filtered_difference() {
    let y = |k: i32| 0.5 * (0.03 * f64::from(k)).sin();
    let mut estimate = VelocityEstimator::new(1, &estimator(), PERIOD_S);
    let keep = (-TAU * 150.0 * PERIOD_S).exp();
    for k in 0..80 {
        let found = estimate.update(&[y(k)])[0];
        let expected: f64 =
            (1..=k).map(|j| (1.0 - keep) * keep.powi(k - j) * (y(j) - y(j - 1)) / PERIOD_S).sum();
        assert!((found - expected).abs() < FILTERED, "{k}: {found} for {expected}");
    }
}

/// Compared: the estimate of a steady motion, and its speed.
#[test]
fn steady_motion_is_estimated_exactly() {
    let mut estimate = VelocityEstimator::new(1, &estimator(), PERIOD_S);
    let last = (0..200).map(|k| estimate.update(&[0.2 + 1.7 * f64::from(k) * PERIOD_S])[0]).last();
    assert!(last.is_some_and(|v| (v - 1.7).abs() < SETTLED), "{last:?}");
}

fn friction(coulomb: f64, viscous: f64, presliding: f64) -> FrictionParameters {
    parsed(&format!(
        "coulomb_nm = {coulomb:?}\nstatic_nm = 9.0\nstribeck_rad_per_s = 0.06\nviscous_nms_per_rad = {viscous:?}\n\
         presliding_rad = {presliding:?}"
    ))
}

/// Compared: n̂ that follows the velocity, and `gain (Fc tanh(q̇/v₀) + Fv q̇)` with tanh from exponentials.
#[test]
fn friction_compensation_by_velocity_matches_its_formula() {
    let joints = [friction(1.8, 2.0, 0.001), friction(1.1, 1.2, 0.001)];
    let parameters: FrictionCompensationParameters =
        parsed("gain = 0.8\nsmoothing_rad_per_s = 0.04\nfollows = \"velocity\"");
    let compensation = FrictionCompensation::new(joints.iter(), &parameters);
    for v in [-3.0, -0.04, -0.001, 0.0, 0.02, 0.5_f64] {
        let (up, down) = ((v / 0.04).exp(), (-v / 0.04).exp());
        let sign = (up - down) / (up + down);
        for (i, (coulomb, viscous)) in [(1.8, 2.0), (1.1, 1.2)].into_iter().enumerate() {
            let expected = 0.8 * (coulomb * sign + viscous * v);
            assert!((compensation.torque(i, v) - expected).abs() < 1e-13, "joint {i} at {v}");
        }
    }
}

/// Compared: n̂ along a motion with a reversal, and `gain (Fc z/δ + Fv q̇)` with the deflections z integrated in small
/// steps.
#[test]
fn friction_compensation_follows_the_displacement() {
    const STEPS: i32 = 100_000;
    /// First-order error of the integration.
    const TOLERANCE: f64 = 1e-4;
    let presliding = 0.002;
    let mut compensation = FrictionCompensation::new(
        [friction(1.8, 2.0, presliding)].iter(),
        &parsed("gain = 0.5\nfollows = \"displacement\""),
    );
    let (mut position, mut deflection) = (0.3, 0.0);
    compensation.advance(&[position]);
    for motion in [0.001, 0.004, 0.0, -0.0005, -0.003, 0.0, 0.1] {
        position += motion;
        compensation.advance(&[position]);
        let step = motion / f64::from(STEPS);
        for _ in 0..STEPS {
            deflection += step - step.abs() * deflection / presliding;
        }
        let (torque, expected) =
            (compensation.torque(0, 0.1), 0.5 * (1.8 * deflection / presliding + 2.0 * 0.1));
        assert!((torque - expected).abs() < TOLERANCE, "{torque} instead of {expected} at {position}");
    }
    compensation.reset();
    compensation.advance(&[0.7]);
    assert_eq!(compensation.torque(0, 0.0), 0.0, "begins at rest");
}

/// With its default, n̂ follows the reference where that moves, whatever the displacement, and the displacement at rest.
/// The measured velocity has a part in viscous friction alone. A third of the friction is left uncompensated.
#[test]
fn friction_compensation_by_reference_matches_its_formula() {
    const PRESLIDING: f64 = 0.002;
    let joints = [friction(1.8, 2.0, PRESLIDING)];
    let mut compensation = FrictionCompensation::new(joints.iter(), &parsed("smoothing_rad_per_s = 0.04"));
    assert!(compensation.follows_reference());
    compensation.advance(&[0.3]);
    compensation.advance(&[0.3 - 0.5 * PRESLIDING]);
    let bristles = (-0.5_f64).exp() - 1.0;
    for (reference, dq) in [(0.0, 0.0), (0.0, 0.02), (0.01, -0.3), (-0.04, 0.0), (2.0, 0.1)] {
        compensation.set_reference_velocity(&[reference]);
        let direction = f64::tanh(reference / 0.04);
        let direction = direction + (1.0 - direction.abs()) * bristles;
        let (torque, expected) = (compensation.torque(0, dq), 0.65 * (1.8 * direction + 2.0 * dq));
        assert!((torque - expected).abs() < 1e-12, "{torque} instead of {expected} at {reference}");
    }
    compensation.reset();
    compensation.advance(&[0.7]);
    assert_eq!(compensation.torque(0, 0.0), 0.0, "begins at rest");
}

/// Compared: the energy that n̂ supplies in a cycle of amplitude A, and 4 γ Fc (A − δ tanh(A/δ)). Viscous friction is
/// zero.
#[test]
fn friction_compensation_supplies_the_energy_of_its_bristles() {
    const STEPS: i32 = 5000;
    let (gain, coulomb, presliding) = (0.8, 1.8, 0.001);
    for amplitude in [0.2, 1.0, 1.5, 4.0, 100.0_f64].map(|ratio| ratio * presliding) {
        let joints = [friction(coulomb, 0.0, presliding)];
        let mut compensation =
            FrictionCompensation::new(joints.iter(), &parsed("gain = 0.8\nfollows = \"displacement\""));
        let position = |k: i32| amplitude * (std::f64::consts::TAU * f64::from(k) / f64::from(STEPS)).sin();
        let mut supplied = 0.0;
        // The first cycles start at rest and differ.
        for k in 0..10 * STEPS {
            compensation.advance(&[position(k)]);
            let before = compensation.torque(0, 0.0);
            compensation.advance(&[position(k + 1)]);
            let mean = 0.5 * (before + compensation.torque(0, 0.0));
            if k >= 9 * STEPS {
                supplied += mean * (position(k + 1) - position(k));
            }
        }
        let expected = 4.0 * gain * coulomb * (amplitude - presliding * (amplitude / presliding).tanh());
        let tolerance = 1e-3 * gain * coulomb * amplitude;
        assert!((supplied - expected).abs() < tolerance, "A = {amplitude}: {supplied} J, {expected} J");
    }
}

/// The table in the documentation of `best`, and the reasons for the choice.
#[test]
fn best_transformer_emulates_rigid_gears_only() {
    use Gears::{Elastic, Rigid};
    use Setpoints::{Held, Interpolated};
    for (setpoints, delay_servo_ticks, measures_current, gears, expected, reason) in [
        (Held, None, true, Rigid, "paper", "delay of setpoints is unknown"),
        (Held, Some(1), true, Rigid, "emulation+current", "gears are declared rigid"),
        (Interpolated, Some(0), true, Rigid, "interpolating+current", "gears are declared rigid"),
        (Held, Some(1), true, Elastic, "extrapolation+current", "gears are not declared rigid"),
        (Interpolated, Some(1), false, Elastic, "extrapolation", "motor current is not measured"),
    ] {
        let robot = DeclaredProperties { setpoints, delay_servo_ticks, measures_current, gears };
        let (best, why) = TransformerName::best(&robot);
        assert_eq!(best.as_str(), expected, "{robot:?}");
        assert!(why.contains(reason), "{robot:?}: {why}");
    }
    assert_eq!(Gears::default(), Elastic, "unknown gears may be elastic");
}

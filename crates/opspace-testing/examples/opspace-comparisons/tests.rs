//! Both forms on a mass with a servo, which are integrated here in small steps.
#![expect(clippy::unwrap_used, reason = "a test")]

use crate::extensions;
use crate::literal_transformer::{LiteralError, LiteralTransformer};
use opspace_backend::{Capabilities, CommandKind, Sample};
use opspace_experiment::{Experiment, Files, RunOptions};
use opspace_model::{Data, Inertia, Joint, JointKind, Limits, Model, Placement};
use opspace_transformer::{ClosedLoopModel, IdentificationError, Transformer};
use std::f64::consts::TAU;
use std::path::Path;

const INERTIA: f64 = 0.4;
const VISCOUS: f64 = 2.0;
const KP: f64 = 40.0;
const KV: f64 = 60.0;

/// Largest error of the torque by the delay of half a period of a held setpoint, relative.
const HELD_SETPOINT: f64 = 0.05;

/// Tolerance of floating-point solutions.
const EXACT: f64 = 1e-6;

/// Closed loop T of a mass with viscous friction under the cascade of equation (K9), and open loop H of the mass.
fn joint(zeros: &str) -> ClosedLoopModel {
    let text = format!(
        "closed_loop = {{ numerator = {zeros}, denominator = [{}, {}, {INERTIA}] }}\n\
         open_loop = {{ numerator = [1.0], denominator = [0.0, {VISCOUS}, {INERTIA}] }}\n\
         from_hz = 0.1\nto_hz = 20.0",
        KV * KP,
        KV + VISCOUS
    );
    toml::from_str(&text).unwrap()
}

fn measured() -> ClosedLoopModel {
    joint(&format!("[{}]", KV * KP))
}

/// Error of the servo's torque relative to the desired one, rms over rms: a sine on the mass alone, `pushed` by an
/// unknown torque.
fn error(measured_position: bool, pushed: f64) -> f64 {
    const PERIOD_S: f64 = 1e-3;
    const STEPS: u32 = 50;
    let mut transformer = LiteralTransformer::new(&[measured()], measured_position, PERIOD_S).unwrap();
    let mut model = Model::new("mass");
    let kind = JointKind::Continuous;
    let wheel = Joint { name: "joint".into(), kind, limits: Limits::NONE };
    model.add_body(None, Placement::identity(), wheel, Inertia::zero());
    let mut data = Data::new(&model);
    let (mut q, mut dq, mut q_desired) = (0.3, 0.0, [0.0]);
    let mut sample = Sample::new(&Capabilities::new(["joint"], CommandKind::Position, PERIOD_S));
    let (mut off, mut size) = (0.0, 0.0);
    for k in 0..4000 {
        let t = f64::from(k) * PERIOD_S;
        let tau = 3.0 * (TAU * 1.5 * t).sin();
        data.q[0] = q;
        sample.q[0] = q;
        transformer.observe(&sample);
        transformer.transform(&data, &[tau], &mut q_desired);
        let mut mean = 0.0;
        for _ in 0..STEPS {
            let torque = KV * (KP * (q_desired[0] - q) - dq);
            mean += torque / f64::from(STEPS);
            dq += (torque + pushed - VISCOUS * dq) / INERTIA * PERIOD_S / f64::from(STEPS);
            q += dq * PERIOD_S / f64::from(STEPS);
        }
        off += (mean - tau).powi(2);
        size += tau * tau;
    }
    (off / size).sqrt()
}

/// Compared: torque of both forms on a free, uncoupled joint, and the desired torque, up to the delay of half a period
/// by which a held setpoint lags.
#[test]
fn both_forms_produce_torque_on_free_joint() {
    for measured_position in [true, false] {
        let error = error(measured_position, 0.0);
        assert!(error < HELD_SETPOINT, "{measured_position}: {error}");
    }
}

/// Checks an unknown torque with a sixth of the desired torque's amplitude: T doesn't include it, so both forms neglect
/// the motion that it causes.
#[test]
fn both_forms_miss_motion_by_external_torque() {
    for measured_position in [true, false] {
        let (alone, pushed) = (error(measured_position, 0.0), error(measured_position, 0.5));
        assert!(pushed > 3.0 * alone, "{measured_position}: {pushed}, {alone} alone");
    }
}

/// Compared: setpoints of the second form at two measured positions.
#[test]
fn second_form_ignores_measured_position() {
    let setpoint = |q: f64| {
        let mut transformer = LiteralTransformer::new(&[measured()], false, 1e-3).unwrap();
        let mut model = Model::new("mass");
        let wheel = Joint { name: "joint".into(), kind: JointKind::Continuous, limits: Limits::NONE };
        model.add_body(None, Placement::identity(), wheel, Inertia::zero());
        let mut data = Data::new(&model);
        data.q[0] = q;
        let mut q_desired = [0.0];
        transformer.transform(&data, &[1.0], &mut q_desired);
        q_desired[0]
    };
    assert_eq!(setpoint(0.0), setpoint(0.7));
}

#[test]
fn non_invertible_loop_is_refused_with_reason() {
    let refused = |joint: &ClosedLoopModel| {
        LiteralTransformer::new(std::slice::from_ref(joint), true, 1e-3).unwrap_err().1
    };
    // A zero in the right half-plane.
    let behind = joint(&format!("[{}, -20.0]", KV * KP));
    assert!(matches!(refused(&behind), LiteralError::Unstable { at } if (at - 120.0).abs() < EXACT));
    let zero = IdentificationError::Zero { what: "closed_loop.numerator" };
    assert_eq!(refused(&joint("[0.0]")), zero.into());
    let mut steep = measured();
    steep.closed_loop.denominator.push(1e-3);
    assert_eq!(refused(&steep), LiteralError::Improper { excess: 1 });
}

/// Checks that the program has its transformers, and that an arm of several joints is refused.
#[test]
fn literal_transformers_are_for_one_joint() {
    let extensions = extensions();
    let joint = "{closed_loop={numerator=[1.0],denominator=[1.0,0.02,6.6e-5]},\
                 open_loop={numerator=[1.0],denominator=[0.0,2.0,0.3]},from_hz=0.5,to_hz=50.0}";
    let joints = ["shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow"];
    let all: Vec<String> = joints.iter().map(|name| format!("{name}={joint}")).collect();
    let settings = [format!("robot.profile.a-med.identified={{{}}}", all.join(","))];
    let task = Path::new("tasks/compliant-x.toml");
    for name in [
        "identified-literal",
        "identified-literal+current",
        "identified-open-loop",
        "identified-open-loop+current",
    ] {
        let options = RunOptions { transformer: Some(name.into()), ..RunOptions::default() };
        let read = Experiment::load_with(&extensions, Files::Embedded, task, None, options, &settings);
        let refused = read.unwrap_err().to_string();
        assert!(refused.contains("a single joint"), "{name}: {refused}");
    }
}

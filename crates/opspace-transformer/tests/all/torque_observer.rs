//! Tests of the velocity observer of torque robots, on a double pendulum that is simulated exactly.

use nalgebra::{Matrix3, Rotation3, Vector3};
use opspace_backend::{Capabilities, CommandKind, GravityCompensation, Sample};
use opspace_model::{Data, Inertia, Joint, JointKind, Limits, Model, Placement, aba, kinematics, update};
use opspace_transformer::{
    EstimatorParameters, FrictionCompensation, FrictionCompensationParameters, FrictionParameters,
    TorqueObserver, TorqueObserverSetup, Transformer, VelocityEstimator,
};
use std::f64::consts::TAU;

const PERIOD_S: f64 = 1e-3;
/// Delays until a torque acts, s.
const DELAYS_S: [f64; 4] = [0.0, 2e-4, PERIOD_S, 3.2 * PERIOD_S];
const RESOLUTION_RAD: f64 = 4e-6;

/// Simulation steps per interface cycle.
const STEPS: u32 = 100;

/// Two links that swing about horizontal axes.
fn double_pendulum() -> Model {
    let mut model = Model::new("double");
    let link = Inertia {
        mass: 2.0,
        com: Vector3::new(0.3, 0.05, 0.0),
        rotational: Matrix3::from_diagonal_element(0.02),
    };
    let joint = |name: &str| Joint { name: name.into(), kind: JointKind::Continuous, limits: Limits::NONE };
    let sideways = Rotation3::from_euler_angles(TAU / 4.0, 0.0, 0.0).into_inner();
    let origin = Placement { rotation: sideways, ..Placement::identity() };
    let first = model.add_body(None, origin, joint("first"), link);
    let end = Placement { translation: Vector3::new(0.4, 0.0, 0.0), ..Placement::identity() };
    model.add_body(Some(first), end, joint("second"), link);
    model
}

fn observer(model: &Model, delay_s: f64) -> TorqueObserver {
    let setup = TorqueObserverSetup {
        friction: FrictionCompensation::none(model.n()),
        resolution_rad: vec![RESOLUTION_RAD; model.n()],
        period_s: PERIOD_S,
        delay_s,
        gravity_compensated_by: GravityCompensation::Controller,
    };
    TorqueObserver::new(&setup, model)
}

/// Commanded torques at a cycle, Nm.
fn torque(cycle: u32) -> [f64; 2] {
    let t = f64::from(cycle) * PERIOD_S;
    [6.0 * (TAU * 1.3 * t).sin(), 2.0 * (TAU * 2.1 * t).cos()]
}

/// Error of the observed and of the filtered velocity, rms over the cycles from `settled` on, rad/s. `load` is a torque on
/// the first joint that the observer does not know, over cycles.
fn errors(
    delay_s: f64,
    load: impl Fn(u32) -> f64,
    settled: u32,
    is_lost: impl Fn(u32) -> bool,
) -> (f64, f64) {
    let model = double_pendulum();
    let mut observer = observer(&model, delay_s);
    let mut filter = VelocityEstimator::new(2, &EstimatorParameters::default(), PERIOD_S);
    let (mut truth, mut data) = (Data::new(&model), Data::new(&model));
    let (mut q, mut dq) = ([0.0; 2], [0.0; 2]);
    let capabilities = Capabilities::new(["first", "second"], CommandKind::Torque, PERIOD_S);
    let mut sample = Sample::new(&capabilities);
    let (mut observed, mut filtered, mut count, mut missed) = (0.0, 0.0, 0.0, 0);
    // Torques of all cycles; in lost ones the last command remains.
    let mut commanded: Vec<[f64; 2]> = Vec::new();
    for cycle in 0..3000 {
        if is_lost(cycle) {
            commanded.push(commanded.last().copied().unwrap_or_default());
            missed += 1;
        } else {
            sample.q = q.map(|q| (q / RESOLUTION_RAD).round() * RESOLUTION_RAD).to_vec();
            if missed > 0 {
                observer.missed(missed);
            }
            let by_filter = filter.update_after(missed + 1, &sample.q).to_vec();
            missed = 0;
            let by_observer = observer.observe(&sample).unwrap_or(&by_filter).to_vec();
            if cycle >= settled {
                for i in 0..2 {
                    observed += (by_observer[i] - dq[i]).powi(2);
                    filtered += (by_filter[i] - dq[i]).powi(2);
                }
                count += 2.0;
            }
            assert!(update(&model, &mut data, &sample.q, &by_observer));
            commanded.push(torque(cycle));
            observer.sent(&data, &torque(cycle));
        }
        let dt = PERIOD_S / f64::from(STEPS);
        for step in 0..STEPS {
            let sent_s = f64::from(cycle) * PERIOD_S + f64::from(step) * dt - delay_s + 1e-9;
            let acting = if sent_s < 0.0 { [0.0; 2] } else { commanded[(sent_s / PERIOD_S) as usize] };
            kinematics(&model, &mut truth, &q, &dq);
            aba(&model, &mut truth, &[acting[0] + load(cycle), acting[1]]);
            for i in 0..2 {
                q[i] += dt * (dq[i] + 0.5 * dt * truth.ddq[i]);
                dq[i] += dt * truth.ddq[i];
            }
        }
    }
    ((observed / count).sqrt(), (filtered / count).sqrt())
}

/// Compared: errors of the observed and of the filtered velocity, where the observer knows all torques.
#[test]
fn observer_follows_known_torques() {
    for delay_s in DELAYS_S {
        let (observed, filtered) = errors(delay_s, |_| 0.0, 200, |_| false);
        assert!(observed < 0.1 * filtered, "{delay_s} s: {observed} rad/s, filter {filtered} rad/s");
    }
}

/// Compared: errors of the observed and of the filtered velocity under a load that the observer does not know: 3 Nm that
/// change sign twice a second.
#[test]
fn observer_follows_an_unknown_load() {
    let load = |cycle: u32| if (cycle / 250).is_multiple_of(2) { 3.0 } else { -3.0 };
    let (observed, filtered) = errors(DELAYS_S[1], load, 200, |_| false);
    assert!(observed < filtered, "{observed} rad/s, filter {filtered} rad/s");
}

/// Compared: errors where every seventh cycle and one stretch of ten are lost, and the torque stays in force meanwhile.
#[test]
fn observer_predicts_over_missed_cycles() {
    let is_lost = |cycle: u32| cycle % 7 == 3 || (1000..1010).contains(&cycle);
    let (observed, filtered) = errors(DELAYS_S[1], |_| 0.0, 200, is_lost);
    assert!(observed < 0.1 * filtered, "{observed} rad/s, filter {filtered} rad/s");
}

/// Checks that there is no estimate in the first cycle, nor after a cycle without a command, and that it begins anew.
#[test]
fn observer_begins_with_a_command() {
    let model = double_pendulum();
    let mut observer = observer(&model, DELAYS_S[1]);
    let mut data = Data::new(&model);
    assert!(update(&model, &mut data, &[0.0; 2], &[0.0; 2]));
    let capabilities = Capabilities::new(["first", "second"], CommandKind::Torque, PERIOD_S);
    let mut sample = Sample::new(&capabilities);
    assert_eq!(observer.observe(&sample), None);
    let held = data.gravity.clone();
    observer.sent(&data, &[held[0] + 5.0, held[1]]);
    let moving = observer.observe(&sample).expect("an estimate").to_vec();
    assert!(moving[0] > 0.0, "{moving:?}");
    assert_eq!(observer.observe(&sample), None, "nothing was sent");
    sample.q = vec![0.1, 0.2];
    assert_eq!(observer.observe(&sample), None);
    observer.sent(&data, held.as_slice());
    let resting = observer.observe(&sample).expect("an estimate").to_vec();
    assert!(resting.iter().all(|dq| dq.abs() < 1e-6), "{resting:?}");
}

/// Friction that stops a joint within less than half a period does not make the estimate oscillate. Compared: estimates of
/// a joint that its static friction holds, under a constant torque, with that friction as a velocity. With the friction at
/// the beginning of each period, the estimate alternated.
#[test]
fn strong_friction_is_no_oscillation() {
    let model = double_pendulum();
    let joint = "coulomb_nm = 4.0\nstatic_nm = 4.0\nviscous_nms_per_rad = 2000.0\n";
    let friction: FrictionParameters = toml::from_str(joint).expect("friction");
    let whole: FrictionCompensationParameters =
        toml::from_str("gain = 1.0\nfollows = \"velocity\"").expect("compensation");
    let setup = TorqueObserverSetup {
        friction: FrictionCompensation::new([&friction, &friction].into_iter(), &whole),
        resolution_rad: vec![RESOLUTION_RAD; 2],
        period_s: PERIOD_S,
        delay_s: 0.0,
        gravity_compensated_by: GravityCompensation::Controller,
    };
    let mut observer = TorqueObserver::new(&setup, &model);
    let mut data = Data::new(&model);
    assert!(update(&model, &mut data, &[0.0; 2], &[0.0; 2]));
    assert!(2000.0 * PERIOD_S > 2.0 * data.mass_matrix[(1, 1)], "the friction is strong");
    let capabilities = Capabilities::new(["first", "second"], CommandKind::Torque, PERIOD_S);
    let sample = Sample::new(&capabilities);
    let pushed = [data.gravity[0], data.gravity[1] + 1.0];
    let mut before = None;
    for cycle in 0..200 {
        if let Some(dq) = observer.observe(&sample) {
            let step = (dq[1] - before.unwrap_or(dq[1])).abs();
            assert!(cycle < 100 || step < 1e-5, "cycle {cycle}: a step of {step} rad/s");
            before = Some(dq[1]);
        }
        observer.sent(&data, &pushed);
    }
}

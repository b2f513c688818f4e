//! The emulating transformer against servos that are run tick by tick here, on their own: written down from equation
//! (9) of the paper, not taken from the emulation.
#![expect(clippy::unwrap_used, reason = "a test")]

use nalgebra::{DVector, Matrix3, Vector3};
use opspace_backend::{
    EmulatingTransformer, EmulationSetup, FrictionCompensation, FrictionCompensationParameters,
    FrictionParameters, GravityBy, Sample, ServoParameters, Transformer,
};
use opspace_control::Measurement;
use opspace_model::{Data, Inertia, Joint, JointKind, Limits, Model, Placement, update};
use std::f64::consts::TAU;
use std::ops::Range;

const SERVO_S: f64 = 1e-3;
const RATIO: u32 = 5;
const KP: [f64; 2] = [25.0, 20.0];
const KV: [f64; 2] = [40.0, 8.0];
const FILTER_HZ: f64 = 200.0;

/// What an observer that starts without an error leaves of one, by rounding: relative to torques, and of velocities in m/s.
const EXACT: f64 = 1e-6;

/// Two joints along the same line, one upon the other: M is the same everywhere, and couples them.
fn model() -> Model {
    let mut model = Model::new("lifts").with_gravity(Vector3::zeros());
    for (i, mass) in [0.3, 0.2].into_iter().enumerate() {
        let joint = Joint { name: format!("lift_{i}"), kind: JointKind::Prismatic, limits: Limits::NONE };
        let inertia =
            Inertia { mass, com: Vector3::zeros(), rotational: Matrix3::from_diagonal_element(1e-3) };
        model.add_body(i.checked_sub(1), Placement::identity(), joint, inertia);
    }
    model
}

fn servos() -> Vec<ServoParameters> {
    let servo = |i: usize| {
        format!(
            "cascaded = {{ kp_per_s = {}, kv_nms_per_rad = {}, velocity_filter_hz = {FILTER_HZ} }}",
            KP[i], KV[i]
        )
    };
    (0..2).map(|i| toml::from_str(&servo(i)).unwrap()).collect()
}

fn transformer(delay: u32, current: bool) -> EmulatingTransformer {
    let none: FrictionParameters = toml::from_str(
        "coulomb_nm = 0.0\nstatic_nm = 0.0\nstribeck_rad_per_s = 0.1\nviscous_nms_per_rad = 0.0",
    )
    .unwrap();
    let friction = [none.clone(), none];
    EmulatingTransformer::new(&EmulationSetup {
        servos: servos(),
        friction: FrictionCompensation::new(friction.iter(), &FrictionCompensationParameters::default()),
        resolution_rad: vec![1e-9; 2],
        torque_limits: vec![1e3; 2],
        servo_period_s: SERVO_S,
        ratio: RATIO,
        delay,
        gravity_by: GravityBy::Controller,
        current,
    })
}

/// The two masses and their drives, one servo period after the other.
struct Drives {
    kp_scale: f64,
    q: [f64; 2],
    dq: [f64; 2],
    seen: [f64; 2],
    velocity: [f64; 2],
}

impl Drives {
    fn tick(&mut self, set_point: Option<&DVector<f64>>) -> [f64; 2] {
        let share = 1.0 - (-TAU * FILTER_HZ * SERVO_S).exp();
        let mut torque = [0.0; 2];
        for i in 0..2 {
            self.velocity[i] += share * ((self.q[i] - self.seen[i]) / SERVO_S - self.velocity[i]);
            self.seen[i] = self.q[i];
            if let Some(qd) = set_point {
                torque[i] = KV[i] * (self.kp_scale * KP[i] * (qd[i] - self.q[i]) - self.velocity[i]);
            }
        }
        // M = [0.5 0.2; 0.2 0.2].
        let det = 0.5 * 0.2 - 0.2 * 0.2;
        let ddq = [(0.2 * torque[0] - 0.2 * torque[1]) / det, (0.5 * torque[1] - 0.2 * torque[0]) / det];
        for ((q, dq), ddq) in self.q.iter_mut().zip(&mut self.dq).zip(ddq) {
            *q += SERVO_S * (*dq + 0.5 * SERVO_S * ddq);
            *dq += SERVO_S * ddq;
        }
        torque
    }
}

/// Desired torques, and the mean torques of the intervals in which each set-point acted; how far the velocities that the
/// transformer tells are from the true ones, at most. Nothing is sent in ticks that are `missed`.
fn run(delay: u32, current: bool, kp_scale: f64, missed: Range<i32>) -> (Vec<[f64; 2]>, Vec<[f64; 2]>, f64) {
    let model = model();
    let mut data = Data::new(&model);
    let mut transformer = transformer(delay, current);
    let mut drives = Drives { kp_scale, q: [0.1, -0.2], dq: [0.0; 2], seen: [0.1, -0.2], velocity: [0.0; 2] };
    let mut sample = Sample {
        time_s: 0.0,
        q: DVector::zeros(2),
        motor_torque: current.then(|| DVector::zeros(2)),
        wrenches: Vec::new(),
    };
    let mut measurement = Measurement::new(2, 0, current);
    let (mut old, mut new) = (None, DVector::zeros(2));
    let (mut asked, mut torques, mut off) = (Vec::new(), Vec::new(), 0.0_f64);
    for k in 0..400 {
        sample.q.copy_from_slice(&drives.q);
        let dq = transformer.observe(&sample).unwrap();
        off = off.max((dq[0] - drives.dq[0]).abs()).max((dq[1] - drives.dq[1]).abs());
        measurement.q.copy_from(&sample.q);
        measurement.dq.copy_from(dq);
        assert!(update(&model, &mut data, measurement.q.as_slice(), measurement.dq.as_slice()));
        let t = f64::from(k) * SERVO_S * f64::from(RATIO);
        let tau = [(TAU * 0.7 * t).sin(), 0.4 * (TAU * 1.1 * t).sin()];
        if !missed.contains(&k) {
            transformer.transform(&data, &measurement, &tau, new.as_mut_slice());
            transformer.sent(&data, new.as_slice());
        }
        asked.push(tau);
        let mut mean = DVector::zeros(2);
        for tick in 0..RATIO {
            let set_point = if tick < delay { old.as_ref() } else { Some(&new) };
            let torque = drives.tick(set_point);
            torques.push(torque);
            mean += DVector::from_column_slice(&torque) / f64::from(RATIO);
        }
        if let Some(measured) = &mut sample.motor_torque {
            measured.copy_from(&mean);
        }
        old = Some(new.clone());
    }
    let windows = torques[delay as usize..].chunks_exact(RATIO as usize);
    let means = windows.map(|w| [0, 1].map(|i| w.iter().map(|t| t[i]).sum::<f64>() / f64::from(RATIO)));
    (asked, means.collect(), off)
}

/// Root mean square of actual − asked over that of asked, after half a second.
fn error(asked: &[[f64; 2]], actual: &[[f64; 2]]) -> f64 {
    let pairs = || asked.iter().zip(actual).skip(100).flat_map(|(a, b)| a.iter().zip(b));
    let off: f64 = pairs().map(|(a, b)| (a - b).powi(2)).sum();
    (off / pairs().map(|(a, _)| a * a).sum::<f64>()).sqrt()
}

/// Mean torques of a servo that is as believed against what was asked for, for every delay up to a whole interval; and
/// the velocity between position readings 5 ms apart against the true one.
#[test]
fn mean_torques_are_the_desired_ones() {
    for delay in 0..=RATIO {
        for current in [false, true] {
            let (asked, means, off) = run(delay, current, 1.0, 0..0);
            let error = error(&asked, &means);
            assert!(error < EXACT, "delay {delay}, current {current}: {error}");
            assert!(off < EXACT, "delay {delay}: {off} m/s");
        }
    }
}

/// The velocities told while set-points fail to come, and the drives hold the last one, against the true ones.
#[test]
fn the_estimate_goes_on_while_set_points_are_missed() {
    for delay in [0, 2, RATIO] {
        let (_, _, off) = run(delay, false, 1.0, 200..230);
        assert!(off < EXACT, "delay {delay}: {off} m/s");
    }
}

/// A position loop that is stiffer, or softer, than believed: torque errors with the motor current made use of against
/// those without.
#[test]
fn measured_currents_make_up_for_a_wrong_gain() {
    for kp_scale in [0.8, 1.1] {
        let [without, with] = [false, true].map(|current| {
            let (asked, means, _) = run(0, current, kp_scale, 0..0);
            error(&asked, &means)
        });
        assert!(with < 0.5 * without && without > 0.1, "{kp_scale}: {with} with, {without} without");
    }
}

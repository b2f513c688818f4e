//! Stability of a task law with an emulated velocity drive, with inertias and gains other than the nominal ones.
#![expect(clippy::unwrap_used, reason = "a test")]

use nalgebra::{Matrix3, Vector3};
use opspace_backend::{Capabilities, CommandKind, GravityCompensation, Measured, Sample, Setpoints};
use opspace_model::{Data, Inertia, Joint, JointKind, Limits, Model, Placement, update};
use opspace_transformer::{
    EmulatingTransformer, EmulationSetup, FrictionCompensation, FrictionCompensationParameters,
    FrictionParameters, RemainingDamping, TorqueObjective, Transformer,
};
use std::f64::consts::TAU;

const MASS: f64 = 0.3;
const SERVO_HZ: f64 = 1000.0;

/// Natural frequency of the critically damped task law, in radians per interface cycle.
const TASK_RAD_PER_CYCLE: f64 = 0.03;

/// Largest remainder of a displacement of 1 after thirty time constants of the task law.
const SETTLED: f64 = 1e-3;

/// Displacement, as a multiple of the initial one, that only an unstable loop reaches.
const GONE: f64 = 1e3;

/// Velocity drive and its interface.
#[derive(Clone, Copy, Debug)]
struct Case {
    /// Ratio of the velocity loop's bandwidth to the servo rate.
    bandwidth: f64,
    ratio: u32,
    delay: u32,
    setpoints: Setpoints,
    current: bool,
    mass_scale: f64,
    kv_scale: f64,
}

impl Case {
    fn kv(self) -> f64 {
        TAU * self.bandwidth * SERVO_HZ * MASS
    }

    fn setup(self) -> EmulationSetup {
        let none: FrictionParameters = toml::from_str(
            "coulomb_nm = 0.0\nstatic_nm = 0.0\nstribeck_rad_per_s = 0.1\nviscous_nms_per_rad = 0.0",
        )
        .unwrap();
        let servo = format!(
            "velocity = {{ kv_nms_per_rad = {}, velocity_filter_hz = {} }}",
            self.kv(),
            0.12 * SERVO_HZ
        );
        EmulationSetup {
            servos: vec![toml::from_str(&servo).unwrap()],
            friction: FrictionCompensation::new([none].iter(), &FrictionCompensationParameters::default()),
            resolution_rad: vec![TAU / 1.6e6],
            inertias: vec![MASS],
            torque_limits: vec![1e6],
            remaining_damping: vec![RemainingDamping::default()],
            servo_period_s: 1.0 / SERVO_HZ,
            servo_ticks_per_cycle: self.ratio,
            delay: self.delay,
            setpoints: self.setpoints,
            matching: if self.setpoints == Setpoints::Held {
                TorqueObjective::IntervalMean
            } else {
                TorqueObjective::PerTick
            },
            gravity_compensated_by: GravityCompensation::Controller,
            has_brakes: false,
            current: self.current,
            adapt_gains: None,
        }
    }

    /// Returns the largest displacement in the last tenth of a run that begins at rest with a displacement of 1.
    fn remaining_displacement(self) -> f64 {
        let mut model = Model::new("lift").with_gravity(Vector3::zeros());
        let joint = Joint { name: "lift".to_owned(), kind: JointKind::Prismatic, limits: Limits::NONE };
        let inertia =
            Inertia { mass: MASS, com: Vector3::zeros(), rotational: Matrix3::from_diagonal_element(1e-3) };
        model.add_body(None, Placement::identity(), joint, inertia);
        let mut data = Data::new(&model);
        let mut transformer = EmulatingTransformer::new(&self.setup()).unwrap();
        let period_s = f64::from(self.ratio) / SERVO_HZ;
        let capabilities = Capabilities::new(["lift"], CommandKind::Velocity, period_s);
        let capabilities =
            if self.current { capabilities.measuring(&[Measured::MotorCurrent]) } else { capabilities };
        let mut sample = Sample::new(&capabilities);
        let omega = TASK_RAD_PER_CYCLE / period_s;
        let (mass, kv) = (self.mass_scale * MASS, self.kv_scale * self.kv());
        let keep = (-TAU * 0.12_f64).exp();
        let (mut q, mut dq, mut seen, mut w) = (1.0_f64, 0.0, 1.0, 0.0);
        let (mut from, mut to, mut age) = (0.0, 0.0, self.ratio);
        let cycles = (30.0 / TASK_RAD_PER_CYCLE) as u32;
        let mut left = 0.0_f64;
        for cycle in 0..cycles {
            if q.abs() > GONE {
                return q.abs();
            }
            sample.q[0] = q;
            let velocity = [transformer.observe(&sample).unwrap()[0]];
            assert!(update(&model, &mut data, &[q], &velocity));
            let torque = -MASS * omega * (omega * q + 2.0 * velocity[0]);
            let mut new = [0.0];
            transformer.transform(&data, &[torque], &mut new);
            transformer.sent(&data, &new);
            let mut mean = 0.0;
            for tick in 0..=self.ratio {
                if tick == self.delay {
                    if age > 0 {
                        from = self.setpoints.at(from, to, age - 1, self.ratio);
                    }
                    (to, age) = (new[0], 0);
                }
                if tick == self.ratio {
                    break;
                }
                w = keep * w + (1.0 - keep) * (q - seen) * SERVO_HZ;
                seen = q;
                let torque = kv * (self.setpoints.at(from, to, age, self.ratio) - w);
                age += 1;
                mean += torque / f64::from(self.ratio);
                let ddq = torque / mass;
                q += (dq + 0.5 * ddq / SERVO_HZ) / SERVO_HZ;
                dq += ddq / SERVO_HZ;
            }
            if let Some(measured) = &mut sample.motor_torque {
                measured[0] = mean;
            }
            if 10 * cycle >= 9 * cycles {
                left = left.max(q.abs());
            }
        }
        left
    }
}

/// Largest kv T/I, with nominal inertia I and interface period T, at which the loop is stable with half and twice the
/// inertia. Above it, the emulation of a position cascade loses stability in the same cases.
const ROBUST: f64 = 0.14;

fn cases() -> impl Iterator<Item = Case> {
    let of = |bandwidth: f64, ratio: u32| {
        [0, ratio / 2, ratio].into_iter().flat_map(move |delay| {
            [Setpoints::Held, Setpoints::Interpolated].into_iter().flat_map(move |setpoints| {
                [false, true].map(|current| Case {
                    bandwidth,
                    ratio,
                    delay,
                    setpoints,
                    current,
                    mass_scale: 1.0,
                    kv_scale: 1.0,
                })
            })
        })
    };
    let drives =
        [0.004, 0.008, 0.02, 0.04].into_iter().flat_map(|b| [1, 2, 5, 10].map(move |ratio| (b, ratio)));
    drives.flat_map(move |(bandwidth, ratio)| of(bandwidth, ratio))
}

/// Checks that a task law brings displacements to zero, for velocity loops of 0.4 to 4 % of the servo rate, delays up
/// to a whole interval and gains of 0.8 to 1.25 times the nominal ones.
#[test]
fn task_law_brings_velocity_robot_to_rest() {
    for case in cases() {
        for kv_scale in [0.8, 1.0, 1.25] {
            let case = Case { kv_scale, ..case };
            let left = case.remaining_displacement();
            assert!(left < SETTLED, "{case:?}: {left}");
        }
    }
}

/// Checks robots with half and twice the nominal inertia.
#[test]
fn wrong_inertia_still_brings_velocity_robot_to_rest() {
    let mut count = 0;
    for case in cases().filter(|case| TAU * case.bandwidth * f64::from(case.ratio) < ROBUST) {
        for (mass_scale, kv_scale) in [(0.5, 0.8), (0.5, 1.25), (2.0, 0.8), (2.0, 1.25)] {
            let case = Case { mass_scale, kv_scale, ..case };
            let left = case.remaining_displacement();
            assert!(left < SETTLED, "{case:?}: {left}");
            count += 1;
        }
    }
    assert!(count > 200, "{count} cases");
}

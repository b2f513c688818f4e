//! Arms, states and task sets for the tests.

#![allow(dead_code, reason = "each test uses some of it")]

pub mod stacks;

use nalgebra::{DMatrix, DVector, Matrix3, Matrix6xX, Unit, Vector3};
use opspace_backend::Observable;
use opspace_backend::quantity::Positive;
use opspace_control::{
    Compensation, ControlContext, ControlError, ControlInput, JointLimits, LimitParameters, Measurement,
    Targets, TaskParameters, TaskSetParameters,
};
use opspace_model::model::rotation_z_to;
use opspace_model::{Data, Inertia, Joint, JointKind, Limits, Model, Placement};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::sync::LazyLock;

/// A revolute joint and its link, as in a URDF: axis and inertia in axes that are parallel to the world's at q = 0.
pub struct Link {
    pub name: &'static str,
    pub axis: [f64; 3],
    pub origin: [f64; 3],
    pub mass: f64,
    pub com: [f64; 3],
    pub inertia: [f64; 3],
    pub limits: [f64; 2],
    pub rotor: f64,
}

/// Builds a serial arm from its links; all lengths are multiplied by `length`. Its frames are one per link, with the
/// link's name, and those in `frames` (name, link, position).
pub fn arm(links: &[Link], frames: &[(&str, usize, [f64; 3])], length: f64) -> Model {
    let body = |i: usize| rotation_z_to(&Unit::new_normalize(Vector3::from(links[i].axis)));
    let mut model = Model::new("arm").with_gravity(Vector3::new(0.0, 0.0, -9.81 * length));
    for (i, link) in links.iter().enumerate() {
        let before = if i == 0 { Matrix3::identity() } else { body(i - 1) };
        let [lower, upper] = link.limits;
        let joint = Joint {
            name: link.name.to_owned(),
            kind: JointKind::Revolute,
            limits: Limits { lower, upper, ..Limits::NONE },
        };
        let origin = Placement {
            rotation: before.transpose() * body(i),
            translation: before.transpose() * Vector3::from(link.origin) * length,
        };
        let inertia = Matrix3::from_diagonal(&Vector3::from(link.inertia)) * (length * length);
        let inertia = Inertia {
            mass: link.mass,
            com: body(i).transpose() * Vector3::from(link.com) * length,
            rotational: body(i).transpose() * inertia * body(i),
        };
        model.add_body(i.checked_sub(1), origin, joint, inertia);
    }
    let own = (0..links.len()).map(|i| (links[i].name, i, [0.0; 3]));
    for (name, i, place) in own.chain(frames.iter().copied()) {
        let placement = Placement {
            rotation: body(i).transpose(),
            translation: body(i).transpose() * Vector3::from(place) * length,
        };
        model.add_frame(name, Some(i), placement);
    }
    let rotors: Vec<f64> = links.iter().map(|link| link.rotor * length * length).collect();
    model.with_rotor_inertia(&rotors)
}

/// Start posture of the four-joint arm.
pub const Q0: [f64; 4] = [-0.45, -0.35, 0.25, -1.35];

/// A four-joint arm of human proportions: shoulder pitch, roll, yaw and elbow.
pub fn four_joints() -> Model {
    four_joints_in(1.0)
}

/// The four-joint arm with lengths in units of 1/`length` m.
pub fn four_joints_in(length: f64) -> Model {
    let (pitch, roll, yaw) = ([0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
    let link = |name, axis, origin, mass, com, inertia, limits: [f64; 2], rotor| Link {
        name,
        axis,
        origin,
        mass,
        com,
        inertia,
        limits: limits.map(f64::to_radians),
        rotor,
    };
    let small = [6e-4; 3];
    let links = [
        link("shoulder_pitch", pitch, [0.0; 3], 0.55, [0.0, 0.02, 0.0], small, [-180.0, 60.0], 0.230),
        link("shoulder_roll", roll, [0.0; 3], 0.55, [0.0, 0.0, -0.01], small, [-110.0, 10.0], 0.230),
        link(
            "shoulder_yaw",
            yaw,
            [0.0; 3],
            1.25,
            [0.0, 0.0, -0.13],
            [6e-3, 6e-3, 1.2e-3],
            [-90.0, 90.0],
            0.09,
        ),
        link(
            "elbow",
            pitch,
            [0.0, 0.0, -0.235],
            1.45,
            [0.005, 0.0, -0.125],
            [8e-3, 8e-3, 1.3e-3],
            [-130.0, 0.0],
            0.09,
        ),
    ];
    arm(&links, &[("hand", 3, [0.0, 0.0, -0.275]), ("wrist", 3, [0.0, 0.01, -0.245])], length)
}

/// A seven-joint arm with offsets in all directions, so that no term is zero by symmetry.
pub fn seven_joints() -> Model {
    seven_joints_in(1.0)
}

/// The seven-joint arm with lengths in units of 1/`length` m.
pub fn seven_joints_in(length: f64) -> Model {
    let names = ["j1", "j2", "j3", "j4", "j5", "j6", "j7"];
    let axes = [
        [0.0, 0.0, 1.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.0, -1.0, 0.0],
        [0.1, 0.0, 1.0],
        [0.0, 1.0, 0.2],
        [1.0, 0.0, 0.0],
    ];
    let links: Vec<Link> = (0..7)
        .map(|i| {
            let k = i as f64;
            Link {
                name: names[i],
                axis: axes[i],
                origin: [0.02 + 0.01 * k, -0.015 * (k - 3.0), 0.2 - 0.015 * k],
                mass: 3.0 - 0.35 * k,
                com: [0.01 * (k - 2.0), 0.02, 0.08 - 0.01 * k],
                inertia: [0.02 - 0.002 * k, 0.021 - 0.002 * k, 0.01],
                limits: [-2.5, 2.5],
                rotor: 0.05,
            }
        })
        .collect();
    arm(&links, &[("hand", 6, [0.05, 0.02, 0.1]), ("upper", 3, [0.03, 0.05, 0.04])], length)
}

/// A task set in the format of a task file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct File {
    pub priority: Vec<String>,
    #[serde(default)]
    pub compensation: Compensation,
    pub unused_damping_per_s: Option<Positive>,
    #[serde(default)]
    pub limits: LimitParameters,
    pub task: BTreeMap<String, TaskParameters>,
}

impl File {
    pub fn read(text: &str) -> Self {
        toml::from_str(text).unwrap_or_else(|e| panic!("{e}"))
    }

    pub fn task_set(&self) -> TaskSetParameters<'_> {
        let defaults = TaskSetParameters::new(&self.priority, &self.task);
        TaskSetParameters {
            compensation: self.compensation,
            unused_damping_per_s: self.unused_damping_per_s.unwrap_or(defaults.unused_damping_per_s),
            limits: self.limits,
            ..defaults
        }
    }
}

/// Context of a robot with one force sensor at the frame `sensor`, a period of 1 ms and no limits.
pub fn control_context(model: &Model, sensor: &str) -> ControlContext {
    let frame = model.frame_id(sensor).expect("the sensor's frame exists");
    ControlContext {
        period_s: 1e-3,
        command_delay_s: 0.0,
        sensors: vec![("wrist".to_owned(), frame)],
        estimated_sensors: 0,
        gravity_by_robot: false,
        limits: JointLimits::none(model.n()),
        collision: None,
    }
}

/// Limits of `n` joints that no motion of the tests reaches, but that are finite, so that they are bounds of the programs.
pub fn unreached_limits(n: usize) -> JointLimits {
    JointLimits {
        lower: vec![-1e2; n],
        upper: vec![1e2; n],
        velocity: vec![1e4; n],
        acceleration: vec![1e6; n],
        torque: vec![1e5; n],
        torque_rate: vec![1e9; n],
    }
}

/// Returns `Data` and measurement at a state.
pub fn at_state(model: &Model, q: &[f64], dq: &[f64], time_s: f64) -> (Data, Measurement) {
    let mut data = Data::new(model);
    assert!(opspace_model::update(model, &mut data, q, dq), "the mass matrix is positive definite");
    let mut measurement = Measurement::new(model.n(), 1, false);
    measurement.q.copy_from_slice(q);
    measurement.dq.copy_from_slice(dq);
    measurement.time_s = time_s;
    (data, measurement)
}

/// Controller input without feedforward torques and streamed targets.
pub fn input<'a>(model: &'a Model, data: &'a Data, measurement: &'a Measurement) -> ControlInput<'a> {
    static NO_TARGETS: LazyLock<Targets> = LazyLock::new(Targets::none);
    static NO_FEEDFORWARD: [f64; 32] = [0.0; 32];
    ControlInput::new(model, data, measurement, &NO_FEEDFORWARD[..model.n()], &NO_TARGETS)
}

/// Reproducible pseudo-random numbers in [-1, 1].
pub struct Numbers(u64);

impl Numbers {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    pub fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    pub fn vector(&mut self, n: usize, size: f64) -> Vec<f64> {
        (0..n).map(|_| size * self.next()).collect()
    }
}

/// Jacobian of a frame, newly allocated.
pub fn jacobian(model: &Model, data: &Data, frame: &str) -> DMatrix<f64> {
    let mut j = Matrix6xX::zeros(model.n());
    opspace_model::frame_jacobian(model, data, model.frame_id(frame).expect("frame"), &mut j);
    DMatrix::from_fn(6, model.n(), |r, c| j[(r, c)])
}

/// Joint accelerations under torques, by the articulated-body algorithm.
pub fn accelerations(model: &Model, data: &Data, tau: &[f64]) -> DVector<f64> {
    let mut data = data.clone();
    opspace_model::aba(model, &mut data, tau);
    data.ddq
}

/// Linear and angular acceleration of a frame under torques, world axes.
pub fn frame_acceleration(model: &Model, data: &Data, frame: &str, tau: &[f64]) -> DVector<f64> {
    let bias = opspace_model::frame_bias_acceleration(model, data, model.frame_id(frame).expect("frame"));
    let caused = jacobian(model, data, frame) * accelerations(model, data, tau);
    let bias: Vec<f64> = bias.linear.iter().chain(bias.angular.iter()).copied().collect();
    caused + DVector::from_vec(bias)
}

/// Returns the error that occurs when the torque controller of a file is built for a model with a sensor at `hand`.
pub fn build_error(model: &Model, text: &str) -> ControlError {
    let file = File::read(text);
    let built = opspace_control::OperationalSpaceController::new(
        model,
        &file.task_set(),
        &control_context(model, "hand"),
    );
    built.err().expect("the stack is wrong")
}

/// An arm of six or seven joints with lengths, axes and masses from `numbers`, a frame `hand` at its end and a frame
/// `upper` on its fourth link.
pub fn random_arm(n: usize, numbers: &mut Numbers) -> Model {
    const NAMES: [&str; 20] = [
        "j1", "j2", "j3", "j4", "j5", "j6", "j7", "j8", "j9", "j10", "j11", "j12", "j13", "j14", "j15",
        "j16", "j17", "j18", "j19", "j20",
    ];
    let links: Vec<Link> = (0..n)
        .map(|i| {
            // Links become lighter towards the end of the arm.
            let weight = (1.0 - 0.12 * i as f64).max(0.1);
            let mut random = || 0.5 + 0.5 * numbers.next();
            let [a, b, c, d, e, f] = [0; 6].map(|_| random());
            Link {
                name: NAMES[i],
                axis: [a - 0.5, b - 0.5, if i % 2 == 0 { 1.0 } else { 0.3 * c }],
                origin: [0.1 * d - 0.05, 0.1 * e - 0.05, 0.1 + 0.15 * f],
                mass: weight * (1.0 + 3.0 * a),
                com: [0.05 * b, 0.05 * c, 0.02 + 0.08 * d],
                inertia: [0.02, 0.015 + 0.01 * e, 0.01 + 0.005 * f].map(|x| weight * x),
                limits: [-2.5, 2.5],
                rotor: 0.02 + 0.08 * d,
            }
        })
        .collect();
    arm(&links, &[("hand", n - 1, [0.05, 0.02, 0.1]), ("upper", 3, [0.03, 0.05, 0.08])], 1.0)
}

/// Returns the values of a signal.
pub fn sampled(observable: &dyn Observable, name: &str) -> Vec<f64> {
    let signals = observable.signals();
    let mut values = vec![0.0; signals.iter().map(|s| s.len()).sum()];
    observable.sample(&mut values);
    let place = signals.iter().position(|s| s.name == name).expect("the signal exists");
    let first: usize = signals[..place].iter().map(|s| s.len()).sum();
    values[first..first + signals[place].len()].to_vec()
}

impl Numbers {
    /// Returns an integer from 0 to `count` − 1.
    pub fn below(&mut self, count: usize) -> usize {
        ((0.5 + 0.5 * self.next()) * count as f64) as usize
    }

    /// Returns a number between `low` and `high`.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (0.5 + 0.5 * self.next())
    }

    pub fn vector3(&mut self, size: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| size * self.next())
    }

    /// Returns a placement with a random orientation and a position whose coordinates are at most `size`.
    pub fn placement(&mut self, size: f64) -> Placement {
        Placement::from_rpy([0; 3].map(|_| 1.5 * self.next()), [0; 3].map(|_| size * self.next()))
    }
}

/// An arm of `n` joints (at most 9) with random axes, offsets and inertias. Its frames besides the links, all rotated:
/// `hand` and `wrist` on the last link, `mid` on the middle link, and `base` on the base, which is rotated too.
pub fn any_arm(n: usize, numbers: &mut Numbers) -> Model {
    const NAMES: [&str; 9] = ["j1", "j2", "j3", "j4", "j5", "j6", "j7", "j8", "j9"];
    let links: Vec<Link> = (NAMES[..n].iter())
        .map(|&name| Link {
            name,
            axis: loop {
                let axis = numbers.vector3(1.0);
                if axis.norm() > 0.3 {
                    break axis.into();
                }
            },
            origin: numbers.vector3(0.2).into(),
            mass: numbers.between(0.5, 3.0),
            com: numbers.vector3(0.1).into(),
            inertia: [0; 3].map(|_| numbers.between(0.01, 0.03)),
            limits: [-2.5, 2.5],
            rotor: numbers.between(0.02, 0.1),
        })
        .collect();
    let mut model = arm(&links, &[], 1.0).with_base(numbers.placement(0.3));
    for (name, body) in [("hand", Some(n - 1)), ("wrist", Some(n - 1)), ("mid", Some(n / 2)), ("base", None)]
    {
        model.add_frame(name, body, numbers.placement(0.15));
    }
    model
}

/// Returns a motion as six numbers, linear part first.
pub fn six(motion: &opspace_model::Motion) -> nalgebra::Vector6<f64> {
    let (v, w) = (&motion.linear, &motion.angular);
    nalgebra::Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
}

/// Integrates joint accelerations `ddq` (n) over one period by semi-implicit Euler, and updates `data` to the new
/// state.
pub fn step(
    model: &Model,
    data: &mut Data,
    measurement: &mut Measurement,
    ddq: &DVector<f64>,
    period_s: f64,
) {
    measurement.dq.axpy(period_s, ddq, 1.0);
    let dq = measurement.dq.clone();
    measurement.q.axpy(period_s, &dq, 1.0);
    measurement.time_s += period_s;
    let (q, dq) = (measurement.q.as_slice(), measurement.dq.as_slice());
    assert!(opspace_model::update(model, data, q, dq), "the mass matrix is positive definite");
}

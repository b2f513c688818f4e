//! The swivel angle: its derivatives, its singularities, and a task that controls it.

use crate::common::{self, Link, Numbers, arm, at_state, control_context, sampled, seven_joints};
use nalgebra::{Matrix6xX, Vector3};
use opspace_control::tasks::swivel::FADE;
use opspace_control::{
    Axes, AxisGains, AxisMode, CartesianParameters, CartesianTask, Compensation, Controller, Coordinate,
    CoordinateGains, LimitParameters, OperationalSpaceController, ScalarGoal, ScalarPointToPoint,
    ScalarReference, SwivelAngle, SwivelParameters, TaskParameters, TaskSet,
};
use opspace_model::{Data, Model, aba, frame_placement, update};

/// Step of the central differences, rad. Their error is proportional to its square, plus rounding errors divided by it.
const STEP: f64 = 1e-5;

/// Tolerance of the differences, relative to the derivative; the third derivatives are of the order of the cube of the
/// inverse distance from a singularity.
const OF_DIFFERENCES: f64 = 1e-5;

fn panda() -> Model {
    let urdf = include_str!("../../../../robots/panda/panda.urdf");
    Model::from_urdf(urdf).expect("the URDF").model
}

const FRAMES: [&str; 3] = ["link2", "link4", "link6"];

const DIRECTION: Vector3<f64> = Vector3::new(0.3, -0.2, 1.0);

fn angle(model: &Model) -> SwivelAngle {
    SwivelAngle::new(model, FRAMES, DIRECTION).expect("the frames exist")
}

/// Returns a posture within the Panda's limits and joint velocities of up to 1 rad/s.
fn state(model: &Model, numbers: &mut Numbers) -> (Vec<f64>, Vec<f64>) {
    let q = model.joints().iter().map(|joint| {
        let (lower, upper) = (joint.limits.lower, joint.limits.upper);
        0.5 * (lower + upper) + 0.45 * (upper - lower) * numbers.next()
    });
    let q: Vec<f64> = q.collect();
    let dq = numbers.vector(model.n(), 1.0);
    (q, dq)
}

fn moved(q: &[f64], dq: &[f64], time_s: f64) -> Vec<f64> {
    q.iter().zip(dq).map(|(q, dq)| q + time_s * dq).collect()
}

/// Returns the sine of the angle between the line from shoulder to wrist and the direction, or the line from shoulder
/// to elbow, whichever is smaller.
fn distance(model: &Model, data: &Data) -> f64 {
    let [shoulder, elbow, wrist] =
        FRAMES.map(|name| frame_placement(model, data, model.frame_id(name).expect("a frame")).translation);
    let line = wrist - shoulder;
    let sine = |x: Vector3<f64>| line.cross(&x).norm() / (line.norm() * x.norm());
    sine(elbow - shoulder).min(sine(DIRECTION))
}

fn data_at(model: &Model, q: &[f64], dq: &[f64]) -> Data {
    let mut data = Data::new(model);
    assert!(update(model, &mut data, q, dq));
    data
}

/// Compared, on random postures of the Panda: J q̇ with the central difference of the angle along q + q̇ t, and J̇ q̇
/// with the central difference of J q̇. The first uses only the value, the second only J.
#[test]
fn jacobian_and_bias_equal_central_differences() {
    let model = panda();
    let angle = angle(&model);
    let mut numbers = Numbers::new(7);
    let rate = |q: &[f64], dq: &[f64]| {
        let data = data_at(&model, q, dq);
        let mut jacobian = Matrix6xX::zeros(model.n());
        angle.jacobian(&model, &data, &mut jacobian);
        jacobian.row(0).iter().zip(dq).map(|(j, dq)| j * dq).sum::<f64>()
    };
    let mut compared = 0;
    for _ in 0..200 {
        let (q, dq) = state(&model, &mut numbers);
        let data = data_at(&model, &q, &dq);
        if distance(&model, &data) < FADE {
            continue;
        }
        compared += 1;
        let [after, before] = [STEP, -STEP].map(|step| moved(&q, &dq, step));
        let value = |q: &[f64]| angle.value(&model, &data_at(&model, q, &dq))[0];
        let differenced = angle.difference(0, value(&after), value(&before)) / (2.0 * STEP);
        let analytic = rate(&q, &dq);
        assert!(
            (analytic - differenced).abs() < OF_DIFFERENCES * (1.0 + analytic.abs()),
            "{analytic} {differenced}"
        );
        let differenced = (rate(&after, &dq) - rate(&before, &dq)) / (2.0 * STEP);
        let analytic = angle.bias(&model, &data)[0];
        assert!(
            (analytic - differenced).abs() < OF_DIFFERENCES * (1.0 + analytic.abs()),
            "{analytic} {differenced}"
        );
    }
    assert!(compared > 180, "few postures are near a singularity: {compared}");
}

/// Compared: the angle with the rotation of the elbow about the line from shoulder to wrist, by Rodrigues' formula: the
/// component of the direction perpendicular to the line, rotated by the angle, points to the elbow.
#[test]
fn angle_rotates_reference_direction_to_elbow() {
    let model = panda();
    let angle = angle(&model);
    let mut numbers = Numbers::new(11);
    for _ in 0..50 {
        let (q, dq) = state(&model, &mut numbers);
        let data = data_at(&model, &q, &dq);
        let [shoulder, elbow, wrist] = FRAMES
            .map(|name| frame_placement(&model, &data, model.frame_id(name).expect("a frame")).translation);
        let axis = nalgebra::Unit::new_normalize(wrist - shoulder);
        let perpendicular = |x: Vector3<f64>| (x - *axis * axis.dot(&x)).normalize();
        let value = angle.value(&model, &data)[0];
        let rotated = nalgebra::Rotation3::from_axis_angle(&axis, value) * perpendicular(DIRECTION);
        assert!((rotated - perpendicular(elbow - shoulder)).norm() < 1e-12);
    }
}

/// An arm of four joints whose elbow lies on the line from shoulder to wrist at q = 0.
fn straight_arm() -> Model {
    let link = |name: &'static str, axis: [f64; 3], length: f64| Link {
        name,
        axis,
        origin: [0.0, 0.0, length],
        mass: 1.0,
        com: [0.0, 0.0, 0.1],
        inertia: [0.02, 0.02, 0.01],
        limits: [-3.0, 3.0],
        rotor: 0.01,
    };
    let (x, y, z) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
    let links = [link("yaw", z, 0.3), link("roll", x, 0.0), link("upper", z, 0.0), link("lower", y, 0.4)];
    arm(&links, &[("wrist", 3, [0.0, 0.0, 0.35])], 1.0)
}

/// For bends of the elbow down to zero, value, Jacobian and bias are finite; the Jacobian is zero with the arm
/// straight; and the torque of a task far from its reference is finite and vanishes with the bend.
#[test]
fn straight_arm_gives_finite_torque() {
    const TORQUE_OF_NOTHING_NM: f64 = 1e-9;
    // With a forearm of 0.35 m and an upper arm of 0.4 m, |p|/|a| is then half of the fade threshold.
    const UNDEFINED_RAD: f64 = 0.5 * FADE * 0.75 / 0.35;
    let model = straight_arm();
    let context = control_context(&model, "wrist");
    let frames = ["upper", "lower", "wrist"];
    let angle = SwivelAngle::new(&model, frames, Vector3::x()).expect("the frames exist");
    let mut jacobian = Matrix6xX::zeros(model.n());
    for bend in [0.0, 1e-9, 1e-4, 0.04, 0.06, 0.08, 0.3] {
        let undefined = bend < UNDEFINED_RAD;
        let q = [0.2, 0.3, 0.4, bend];
        let data = data_at(&model, &q, &[1.0, -0.5, 0.7, 0.3]);
        angle.jacobian(&model, &data, &mut jacobian);
        let (value, bias) = (angle.value(&model, &data)[0], angle.bias(&model, &data)[0]);
        assert!(value.is_finite() && bias.is_finite() && jacobian.iter().all(|j| j.is_finite()), "{bend}");
        assert_eq!(jacobian.amax() == 0.0, undefined, "{bend}: {jacobian}");

        let gains = CoordinateGains::new(10.0, 1.0).expect("good gains");
        let parameters = SwivelParameters {
            direction: [1.0, 0.0, 0.0],
            ..SwivelParameters::new("upper", "lower", "wrist", gains)
        };
        let tasks = TaskSet::builder(&model, &context)
            .from_parameters("elbow", &TaskParameters::Swivel(Box::new(parameters)))
            .expect("a good task")
            .build();
        let limits = LimitParameters { enforce: false, ..LimitParameters::default() };
        let mut controller =
            OperationalSpaceController::from_tasks(&model, tasks, &context, Compensation::Bias, &limits);
        let (data, measurement) = at_state(&model, &[0.2, 0.3, 1.4, 0.8], &[0.0; 4], 0.0);
        controller.start(&common::input(&model, &data, &measurement));
        let (data, measurement) = at_state(&model, &q, &[0.0; 4], 1e-3);
        let mut torque = [0.0; 4];
        controller.update(&common::input(&model, &data, &measurement), &mut torque);
        let beside: Vec<f64> = torque.iter().zip(&data.bias).map(|(torque, bias)| torque - bias).collect();
        let largest = beside.iter().fold(0.0, |most: f64, torque| most.max(torque.abs()));
        assert!(largest.is_finite(), "{bend}");
        assert_eq!(largest < TORQUE_OF_NOTHING_NM, undefined, "{bend}: {largest} Nm");
    }
}

/// The three vectors of the angle are parallel: the elbow on the line, the direction along it, or the wrist at the
/// shoulder.
#[test]
fn jacobian_is_zero_if_angle_is_undefined() {
    let model = seven_joints();
    let mut jacobian = Matrix6xX::zeros(model.n());
    // A frame that is used twice is on the line and at its end.
    for frames in [["upper", "upper", "hand"], ["upper", "hand", "hand"], ["upper", "hand", "upper"]] {
        let angle = SwivelAngle::new(&model, frames, Vector3::z()).expect("the frames exist");
        let data = data_at(&model, &[0.3; 7], &[1.0; 7]);
        angle.jacobian(&model, &data, &mut jacobian);
        assert!(jacobian.iter().all(|j| *j == 0.0), "{frames:?}");
        assert_eq!(angle.bias(&model, &data)[0], 0.0, "{frames:?}");
        assert!(angle.value(&model, &data)[0].is_finite(), "{frames:?}");
    }
}

/// Compared: the angle two seconds after the start of a motion by half a radian, from the controller's signal and from
/// the coordinate itself, with the goal; and the hand's pose, which has higher priority, with that at the start.
#[test]
fn swivel_task_moves_elbow_but_not_hand() {
    const SETTLED: f64 = 2e-3;
    let model = panda();
    let context = control_context(&model, "link7");
    let gains = AxisGains::new(20.0, 1.0).expect("good gains");
    let hand = CartesianParameters::new("link7", Axes::pose(AxisMode::Motion), gains);
    let hand = CartesianTask::new("hand", &hand, &model, &context).expect("a good task");
    let [shoulder, elbow, wrist] = FRAMES;
    let gains = CoordinateGains::new(10.0, 1.0).expect("good gains");
    let goal = ScalarGoal::Offset(0.5);
    let reference = ScalarReference::PointToPoint(ScalarPointToPoint {
        goal,
        duration_s: 1.5.try_into().expect("positive"),
        start_s: Default::default(),
    });
    let swivel = SwivelParameters { reference, ..SwivelParameters::new(shoulder, elbow, wrist, gains) };
    let tasks = TaskSet::builder(&model, &context)
        .task(Box::new(hand))
        .and_then(|tasks| tasks.from_parameters("elbow", &TaskParameters::Swivel(Box::new(swivel))))
        .expect("good tasks")
        .build();
    let limits = LimitParameters::default();
    let mut controller =
        OperationalSpaceController::from_tasks(&model, tasks, &context, Compensation::Bias, &limits);
    let q = [0.1, 0.4, -0.2, -1.6, 0.3, 1.9, 0.5];
    let (mut data, mut measurement) = at_state(&model, &q, &[0.0; 7], 0.0);
    let angle = SwivelAngle::new(&model, FRAMES, Vector3::z()).expect("the frames exist");
    let begin = angle.value(&model, &data)[0];
    let frame = model.frame_id("link7").expect("a frame");
    let pose = frame_placement(&model, &data, frame);
    controller.start(&common::input(&model, &data, &measurement));
    let mut torque = [0.0; 7];
    for cycle in 0..2500 {
        measurement.time_s = f64::from(cycle) * 1e-3;
        assert!(update(&model, &mut data, measurement.q.as_slice(), measurement.dq.as_slice()));
        controller.update(&common::input(&model, &data, &measurement), &mut torque);
        aba(&model, &mut data, &torque);
        measurement.dq += &data.ddq * 1e-3;
        measurement.q += &measurement.dq * 1e-3;
    }
    let now = angle.value(&model, &data)[0];
    assert!((now - begin - 0.5).abs() < SETTLED, "{begin} to {now}");
    assert!((sampled(&controller, "elbow.value")[0] - now).abs() < 1e-12);
    let moved = frame_placement(&model, &data, frame).translation - pose.translation;
    assert!(moved.norm() < SETTLED, "{moved}");
}

//! Commands within the robot's limits, against the tasks' own torques where no limit is in the way, against an independent
//! cascade of least squares where one is, and against the motion that forward dynamics makes of them.

mod common;

use common::{
    File, Link, Numbers, accelerations, arm, at_state, facts, frame_acceleration, jacobian, random_arm,
    sampled, seven_joints,
};
use nalgebra::{DMatrix, DVector, Vector3};
use opspace_control::limits::HORIZON_S;
use opspace_control::{
    Controller, JointLimits, Measurement, Observable, OperationalSpaceController, RobotFacts,
};
use opspace_model::{
    Data, Model, Motion, aba, frame_bias_acceleration, frame_placement, frame_velocity, update,
};

/// Two solutions of one programme, by methods with tolerances of 1e-9 and smaller, relative to their size.
const SOLVERS: f64 = 1e-6;

/// By what share of itself a bound is widened between levels, some times over, and so how far a command may be beyond it.
const ROUNDING: f64 = 1e-8;

/// How near to a bound a command stands that a level above wanted there: what the widening between levels lets the lower
/// ones do where rows are nearly parallel.
const MET: f64 = 1e-4;

/// A length by which rotations are weighed, m, that the files below share.
const LENGTH_M: f64 = 0.4;

const POSE: &str = r#"
priority = ["hand", "rest"]
[task.hand.cartesian]
frame = "hand"
axes = { x = "motion", y = "motion", z = "motion", rx = "motion", ry = "motion", rz = "motion" }
reference = "hold"
gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }
characteristic_length_m = 0.4
[task.rest.joint-posture]
frequency_rad_per_s = 9.0
damping_ratio = 0.8
"#;

const ELBOW: &str = r#"
priority = ["hand", "elbow", "rest"]
[task.hand.cartesian]
frame = "hand"
axes = { x = "motion", y = "motion", z = "motion" }
reference = "hold"
gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }
[task.elbow.cartesian]
frame = "upper"
axes = { z = "motion" }
reference = "hold"
gains = { frequency_rad_per_s = 11.0, damping_ratio = 1.0 }
[task.rest.joint-posture]
frequency_rad_per_s = 9.0
damping_ratio = 0.8
"#;

const DAMPED: &str = r#"
priority = ["hand", "rest"]
[task.hand.cartesian]
frame = "hand"
axes = { x = "motion", y = "motion", z = "motion" }
reference = "hold"
gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }
[task.rest.joint-damping]
damping_nms_per_rad = 3.0
"#;

const COMPLIANT: &str = r#"
priority = ["hand", "rest"]
[task.hand.cartesian]
frame = "hand"
axes = { x = "compliant", y = "motion", z = "motion", rz = "compliant" }
reference = "hold"
gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }
force = { sensor = "wrist", filter_hz = 100.0 }
characteristic_length_m = 0.4
[task.rest.joint-posture]
frequency_rad_per_s = 9.0
damping_ratio = 0.8
"#;

const HAND_POSE: &[usize] = &[0, 1, 2, 3, 4, 5];

/// A stack, how many joints its arm has, and the rows of its levels: frames and axes.
struct Case {
    text: &'static str,
    joints: usize,
    levels: &'static [(&'static str, &'static [usize])],
}

const CASES: [Case; 7] = [
    Case { text: POSE, joints: 7, levels: &[("hand", HAND_POSE)] },
    Case { text: ELBOW, joints: 7, levels: &[("hand", &[0, 1, 2]), ("upper", &[2])] },
    Case { text: DAMPED, joints: 7, levels: &[("hand", &[0, 1, 2])] },
    Case { text: COMPLIANT, joints: 7, levels: &[("hand", &[0, 1, 2, 5])] },
    Case { text: ELBOW, joints: 6, levels: &[("hand", &[0, 1, 2]), ("upper", &[2])] },
    Case { text: DAMPED, joints: 6, levels: &[("hand", &[0, 1, 2])] },
    Case { text: COMPLIANT, joints: 6, levels: &[("hand", &[0, 1, 2, 5])] },
];

/// The same file without limits.
fn without_limits(text: &str) -> String {
    format!("limits = {{ enforce = false }}\n{text}")
}

/// An arm on its way: where it was started, and where it is.
struct Scene {
    model: Model,
    start: Vec<f64>,
    data: Data,
    measurement: Measurement,
}

impl Scene {
    /// A random arm that has moved by some `far`, rad.
    fn new(joints: usize, far: f64, numbers: &mut Numbers) -> Self {
        let model = random_arm(joints, numbers);
        let start = numbers.vector(joints, 1.2);
        let q: Vec<f64> = start.iter().map(|q| q + far * numbers.next()).collect();
        let dq = numbers.vector(joints, 1.0);
        let (data, mut measurement) = at_state(&model, &q, &dq, 0.1);
        let force = numbers.vector(6, 10.0);
        measurement.wrenches[0].linear.copy_from_slice(&force[..3]);
        measurement.wrenches[0].angular.copy_from_slice(&force[3..]);
        Self { model, start, data, measurement }
    }

    fn robot(&self) -> RobotFacts {
        facts(&self.model, "hand")
    }

    /// A controller that was started where the scene was.
    fn controller(&self, text: &str, limits: &JointLimits) -> OperationalSpaceController {
        let (file, mut robot) = (File::read(text), self.robot());
        robot.limits = limits.clone();
        let mut controller =
            OperationalSpaceController::new(&self.model, &file.stack(), &robot).expect("a good stack");
        let (data, mut measurement) = at_state(&self.model, &self.start, &vec![0.0; self.model.n()], 0.0);
        measurement.wrenches.clone_from(&self.measurement.wrenches);
        controller.start(&self.model, &data, &measurement);
        controller
    }

    fn torque(&self, controller: &mut OperationalSpaceController) -> DVector<f64> {
        let mut tau = DVector::zeros(self.model.n());
        controller.update(&self.model, &self.data, &self.measurement, tau.as_mut_slice());
        tau
    }

    fn unlimited(&self, text: &str) -> DVector<f64> {
        self.torque(&mut self.controller(&without_limits(text), &JointLimits::none(self.model.n())))
    }

    /// What the arm was commanded when it was started: gravity's torque there.
    fn before(&self) -> DVector<f64> {
        at_state(&self.model, &self.start, &vec![0.0; self.model.n()], 0.0).0.gravity
    }
}

/// The torques of a stack without limits against those of the whole cascade with limits that are never reached, also
/// where the tasks damp directions near a singularity.
#[test]
fn limits_out_of_reach_change_nothing() {
    let mut numbers = Numbers::new(11);
    let mut damped = 0;
    for case in &CASES {
        for threshold in ["0.001", "0.1", "1.0"] {
            for _ in 0..8 {
                let scene = Scene::new(case.joints, 0.3, &mut numbers);
                let singular = format!("reference = \"hold\"\nsingularity_threshold = {threshold}");
                let text = case.text.replace("reference = \"hold\"", &singular);
                let n = case.joints;
                let limits = JointLimits {
                    lower: vec![-1e2; n],
                    upper: vec![1e2; n],
                    velocity: vec![1e4; n],
                    acceleration: vec![1e6; n],
                    torque: vec![1e5; n],
                    torque_rate: vec![1e9; n],
                };
                let mut controller = scene.controller(&text, &limits);
                controller.without_shortcut();
                let (tau, unlimited) = (scene.torque(&mut controller), scene.unlimited(&text));
                let off = (&tau - &unlimited).amax();
                assert!(off < SOLVERS * unlimited.amax(), "{text}: off by {off} Nm of {unlimited}");
                assert!(sampled(&controller, "limited").iter().all(|&at| at == 0.0));
                damped += usize::from(sampled(&controller, "hand.weakest_share") < vec![1.0]);
            }
        }
    }
    assert!(damped > 20, "only {damped} poses were near a singularity");
}

/// A level as an independent reader of the documentation would write it: |J x + b − a|² in the metric WᵀΛW, with x the
/// joint accelerations.
struct Rows {
    jacobian: DMatrix<f64>,
    bias: DVector<f64>,
    asked: DVector<f64>,
    metric: DMatrix<f64>,
}

impl Rows {
    /// The levels of a case, with what their frames' accelerations are under the torques of the stack without limits.
    fn of(scene: &Scene, case: &Case, unlimited: &DVector<f64>) -> Vec<Self> {
        let mass_inverse = scene.data.mass_matrix.clone().try_inverse().expect("M is regular");
        let mut nullspace = DMatrix::identity(case.joints, case.joints);
        let mut levels = Vec::new();
        for (frame, axes) in case.levels {
            let mut rows = Self::new(scene, frame, axes, unlimited);
            let projected = &rows.jacobian * &nullspace;
            let mobility = &projected * &mass_inverse * projected.transpose();
            let inertia = mobility.try_inverse().expect("no singularity");
            nullspace -= &mass_inverse * projected.transpose() * &inertia * &projected;
            // Along where the task would be going after the horizon; aside of it, at right angles in the metric Λ, weighs
            // ten times as much.
            let frame = scene.model.frame(frame).expect("frame");
            let velocity = pick(axes, &six(frame_velocity(&scene.model, &scene.data, frame)));
            let heading = velocity + &rows.asked * HORIZON_S;
            let momentum = &inertia * &heading;
            let still = 2e-3 * 2e-3 * inertia.trace();
            let ahead = 99.0 / (heading.dot(&momentum) + still);
            rows.metric = inertia * 100.0 - &momentum * momentum.transpose() * ahead;
            levels.push(rows);
        }
        levels
    }

    fn new(scene: &Scene, frame: &str, axes: &[usize], unlimited: &DVector<f64>) -> Self {
        let (model, data) = (&scene.model, &scene.data);
        let whole = jacobian(model, data, frame);
        let jacobian =
            DMatrix::from_fn(axes.len(), model.n(), |r, c| row_scale(axes[r]) * whole[(axes[r], c)]);
        let id = model.frame(frame).expect("frame");
        let metric = DMatrix::zeros(axes.len(), axes.len());
        let bias = pick(axes, &six(frame_bias_acceleration(model, data, id)));
        let asked = pick(axes, &frame_acceleration(model, data, frame, unlimited.as_slice()));
        Self { jacobian, bias, asked, metric }
    }
}

/// By what a row is multiplied.
fn row_scale(axis: usize) -> f64 {
    if axis < 3 { 1.0 } else { LENGTH_M }
}

/// Rows of a task among all six of a motion.
fn pick(axes: &[usize], whole: &DVector<f64>) -> DVector<f64> {
    DVector::from_iterator(axes.len(), axes.iter().map(|&i| row_scale(i) * whole[i]))
}

fn six(m: Motion) -> DVector<f64> {
    DVector::from_iterator(6, m.linear.iter().chain(m.angular.iter()).copied())
}

/// Bounds on joint accelerations and torques.
struct Bounds {
    acceleration: [DVector<f64>; 2],
    torque: [DVector<f64>; 2],
}

impl Bounds {
    /// What the limits leave at the scene's state, by their documentation: no position limits.
    fn new(scene: &Scene, limits: &JointLimits) -> Self {
        let (n, dq, before) = (scene.model.n(), &scene.data.dq, scene.before());
        let side = |sign: f64| {
            let acceleration = DVector::from_fn(n, |i, _| {
                let by_speed = (sign * 0.9 * limits.velocity[i] - dq[i]) / HORIZON_S;
                sign * limits.acceleration[i].min(sign * by_speed)
            });
            let torque = DVector::from_fn(n, |i, _| {
                let reach = sign * before[i] + limits.torque_rate[i] * 1e-3;
                sign * limits.torque[i].min(reach)
            });
            (acceleration, torque)
        };
        let ((a, t), (b, u)) = (side(-1.0), side(1.0));
        Self { acceleration: [a, b], torque: [t, u] }
    }

    /// By how much a motion under torques is beyond the bounds, relative to its size.
    fn excess(&self, ddq: &DVector<f64>, tau: &DVector<f64>) -> f64 {
        let beyond = |[lower, upper]: &[DVector<f64>; 2], x: &DVector<f64>| {
            (lower - x).max().max((x - upper).max()) / (1.0 + x.amax())
        };
        beyond(&self.acceleration, ddq).max(beyond(&self.torque, tau))
    }
}

/// The smallest |E w − f| with w ≥ 0: Lawson and Hanson, *Solving least squares problems*, 1974, ch. 23. Columns of E have
/// length one.
fn non_negative_distance(e: &DMatrix<f64>, f: &DVector<f64>) -> f64 {
    let mut w = DVector::zeros(e.ncols());
    let mut passive: Vec<usize> = Vec::new();
    let rest = |w: &DVector<f64>| f - e * w;
    for _ in 0..3 * e.ncols() {
        let slope = e.tr_mul(&rest(&w));
        let others = (0..w.len()).filter(|i| !passive.contains(i));
        let Some(steepest) = others.max_by(|&i, &k| slope[i].total_cmp(&slope[k])) else { break };
        if slope[steepest] < 1e-12 * f.norm() {
            break;
        }
        passive.push(steepest);
        loop {
            let factors = e.select_columns(&passive).svd(true, true);
            let best = factors.solve(f, 1e-12).expect("both factors were asked for");
            let step = |(&i, &z): (&usize, &f64)| if z <= 0.0 { w[i] / (w[i] - z) } else { 1.0 };
            let reach = passive.iter().zip(&best).map(step).fold(1.0, f64::min);
            for (&i, z) in passive.iter().zip(&best) {
                w[i] += reach * (z - w[i]);
            }
            if reach >= 1.0 {
                break;
            }
            passive.retain(|&i| w[i] > 1e-12 * f.norm());
            (0..w.len()).filter(|i| !passive.contains(i)).for_each(|i| w[i] = 0.0);
        }
    }
    rest(&w).norm()
}

/// By how much each level's residual, then the distance to the `posture` in kinetic energy, could still fall at `ddq`
/// (Karush, Kuhn and Tucker): what of its gradient neither the rows above nor the bounds that are met hold back, with the
/// gradient and what it would be at rest. Scaled to unit inertia.
fn slopes(
    scene: &Scene,
    levels: &[Rows],
    posture: &DVector<f64>,
    bounds: &Bounds,
    ddq: &DVector<f64>,
) -> Vec<[f64; 3]> {
    let (n, m) = (scene.model.n(), &scene.data.mass_matrix);
    let unscale = DMatrix::from_diagonal(&m.diagonal().map(|x| 1.0 / x.sqrt()));
    let torque = m * ddq + &scene.data.bias;
    let mut held: Vec<DVector<f64>> = Vec::new();
    for i in 0..n {
        for (bound, value, row) in [
            (&bounds.acceleration, ddq[i], unscale.column(i).into_owned()),
            (&bounds.torque, torque[i], &unscale * m.column(i)),
        ] {
            let near = MET * (1.0 + value.abs());
            let inward = row.normalize();
            if value < bound[0][i] + near {
                held.push(inward.clone());
            }
            if value > bound[1][i] - near {
                held.push(-inward);
            }
        }
    }
    let held = if held.is_empty() { DMatrix::zeros(n, 0) } else { DMatrix::from_columns(&held) };
    let mut free = DMatrix::<f64>::identity(n, n);
    let mut slopes = Vec::new();
    for level in 0..=levels.len() {
        let gradient_at = |ddq: &DVector<f64>| match levels.get(level) {
            Some(rows) => {
                let residual = &rows.jacobian * ddq + &rows.bias - &rows.asked;
                (&rows.jacobian * &unscale).tr_mul(&(&rows.metric * residual))
            }
            None => &unscale * m * (ddq - posture),
        };
        let (gradient, at_rest) = (gradient_at(ddq), gradient_at(&DVector::zeros(n)).norm());
        let mut normals = free.tr_mul(&held);
        normals.column_iter_mut().for_each(|mut c| c /= c.norm().max(1e-9));
        slopes.push([non_negative_distance(&normals, &free.tr_mul(&gradient)), gradient.norm(), at_rest]);
        if let Some(rows) = levels.get(level) {
            // What doesn't move this level's rows: the smallest eigenvalues of their square.
            let square = &rows.jacobian * &unscale * &free;
            let spectrum = square.tr_mul(&square).symmetric_eigen();
            let mut order: Vec<usize> = (0..free.ncols()).collect();
            order.sort_by(|&i, &k| spectrum.eigenvalues[i].total_cmp(&spectrum.eigenvalues[k]));
            free = &free * spectrum.eigenvectors.select_columns(&order[..free.ncols() - rows.asked.len()]);
        }
    }
    slopes
}

/// Limits that bind on a scene, and that some motion near the one asked for respects: random ones of torque, torque rate,
/// velocity and acceleration.
fn binding_limits(scene: &Scene, unlimited: &DVector<f64>, numbers: &mut Numbers) -> JointLimits {
    let n = scene.model.n();
    let ddq = accelerations(&scene.model, &scene.data, unlimited.as_slice());
    let (size, share) = (ddq.amax(), 0.5 + 0.3 * numbers.next());
    let possible = DVector::from_fn(n, |i, _| share * ddq[i] + 0.2 * size * numbers.next());
    let tau = &scene.data.mass_matrix * &possible + &scene.data.bias;
    // Many limits leave the lower levels nothing, few do.
    let rare = if numbers.next() > 0.0 { 0.8 } else { 0.1 };
    let mut limits = JointLimits::none(n);
    for i in 0..n {
        let mut limit = |of: &mut f64, least: f64| {
            if numbers.next() > rare {
                *of = 1.05 * least + 0.01;
            }
        };
        limit(&mut limits.acceleration[i], possible[i].abs());
        let v = scene.data.dq[i] + HORIZON_S * possible[i];
        limit(&mut limits.velocity[i], v.abs() / 0.9);
        limit(&mut limits.torque[i], tau[i].abs());
        limits.torque_rate[i] = 1e9;
        limit(&mut limits.torque_rate[i], (tau[i] - scene.before()[i]).abs() / 1e-3);
    }
    limits
}

/// Runs `check` on random scenes with limits that bind, of each stack: scene, case, limits, the torque without limits and
/// the controller after its tick, with its torque.
fn on_bound_scenes(
    seed: u64,
    count: usize,
    mut check: impl FnMut(&Scene, &Case, &JointLimits, &DVector<f64>, &OperationalSpaceController, &DVector<f64>),
) {
    let mut numbers = Numbers::new(seed);
    for case in &CASES {
        let mut limited = 0;
        while limited < count {
            let scene = Scene::new(case.joints, 0.3, &mut numbers);
            let mut unbound = scene.controller(&without_limits(case.text), &JointLimits::none(case.joints));
            let unlimited = scene.torque(&mut unbound);
            let regular = case
                .levels
                .iter()
                .zip(["hand", "elbow"])
                .all(|(_, name)| sampled(&unbound, &format!("{name}.weakest_share")) == [1.0]);
            if !regular {
                continue;
            }
            let limits = binding_limits(&scene, &unlimited, &mut numbers);
            let mut controller = scene.controller(case.text, &limits);
            let tau = scene.torque(&mut controller);
            if controller.is_limited() {
                limited += 1;
                check(&scene, case, &limits, &unlimited, &controller, &tau);
            }
        }
    }
}

/// The gradient of each level's documented residual against what the bounds and the levels above hold back of it: nothing
/// is left by which it could fall. Of the last level, whose metric is M, what is left bounds the distance to the optimum.
#[test]
fn each_level_is_as_near_as_the_limits_and_the_levels_above_allow() {
    let mut missed = [0; 3];
    on_bound_scenes(12, 12, |scene, case, limits, unlimited, controller, tau| {
        assert_eq!(sampled(controller, "limits_solver"), [1.0], "the active set");
        let ddq = accelerations(&scene.model, &scene.data, tau.as_slice());
        let posture = accelerations(&scene.model, &scene.data, unlimited.as_slice());
        let levels = Rows::of(scene, case, unlimited);
        let bounds = Bounds::new(scene, limits);
        let found = slopes(scene, &levels, &posture, &bounds, &ddq);
        for (k, [left, whole, at_rest]) in found.iter().enumerate() {
            assert!(*left < SOLVERS * at_rest, "{}: level {k} could fall by {left} of {whole}", case.text);
            missed[k] += usize::from(*whole > 1.0);
        }
        let excess = bounds.excess(&ddq, tau);
        assert!(excess < SOLVERS, "{}: beyond a bound by {excess} of its size", case.text);
    });
    assert!(missed[0] > 40 && missed[1] > 40 && missed[2] > 15, "levels that limits hold off: {missed:?}");
}

/// The stack's text with its first level alone.
fn first_level(text: &str) -> String {
    let first = text.split("[task.").nth(1).expect("the file has a task");
    format!("priority = [\"hand\"]\n[task.{first}")
}

/// The acceleration of the first level's rows with the other levels below it, and without them.
#[test]
fn no_level_takes_from_one_above_it_where_limits_bind() {
    let mut moved = 0;
    on_bound_scenes(13, 10, |scene, case, limits, _, _, tau| {
        let alone = scene.torque(&mut scene.controller(&first_level(case.text), limits));
        let (frame, axes) = case.levels[0];
        let rows = |tau: &DVector<f64>| {
            pick(axes, &frame_acceleration(&scene.model, &scene.data, frame, tau.as_slice()))
        };
        let (with, without) = (rows(tau), rows(&alone));
        let off = (&with - &without).amax();
        assert!(off < SOLVERS * (1.0 + with.amax()), "{}: {with} for {without}", case.text);
        moved += usize::from((tau - alone).amax() > 0.1);
    });
    assert!(moved > 15, "the levels below do something: {moved}");
}

/// The logged signals against the bounds at which the command stands, each bound seen from both sides of its tolerance.
#[test]
fn what_limits_a_joint_is_a_signal() {
    let mut seen = [0; 4];
    on_bound_scenes(14, 8, |scene, _, limits, _, controller, tau| {
        assert_eq!(sampled(controller, "limits_solver"), [1.0], "the active set");
        let ddq = accelerations(&scene.model, &scene.data, tau.as_slice());
        let bounds = Bounds::new(scene, limits);
        for (i, limited) in sampled(controller, "limited").into_iter().enumerate() {
            let at = |[lower, upper]: &[DVector<f64>; 2], x: f64, near: f64| {
                let near = near * (1.0 + x.abs());
                x < lower[i] + near || x > upper[i] - near
            };
            let value = |near: f64| {
                f64::from(u8::from(at(&bounds.acceleration, ddq[i], near)))
                    + 2.0 * f64::from(u8::from(at(&bounds.torque, tau[i], near)))
            };
            assert!(limited == value(1e-7) || limited == value(1e-5), "joint {i}: {limited}");
            seen[limited as usize] += 1;
        }
    });
    assert!(seen[..3].iter().all(|&count| count > 20), "each kind occurs: {seen:?}");

    let scene = Scene::new(7, 0.3, &mut Numbers::new(15));
    let mut controller = scene.controller(POSE, &JointLimits::none(7));
    scene.torque(&mut controller);
    assert!(!controller.is_limited() && sampled(&controller, "limits_solver") == [0.0]);
    assert_eq!(sampled(&controller, "limited"), [0.0; 7]);
    let without = scene.controller(&without_limits(POSE), &JointLimits::none(7));
    assert!(without.signals().iter().all(|signal| !signal.name.starts_with("limit")));
}

/// Where the tasks above leave nothing free: limits that bind against the first levels' acceleration without the posture.
#[test]
fn a_level_without_freedom_changes_nothing() {
    let full = ELBOW.replace("z = \"motion\" }\nreference = \"hold\"\ngains = { frequency_rad_per_s = 14.0", 
        "z = \"motion\", rx = \"motion\", ry = \"motion\", rz = \"motion\" }\nreference = \"hold\"\ngains = { frequency_rad_per_s = 14.0");
    let mut numbers = Numbers::new(16);
    for (joints, text) in [(6, POSE), (7, full.as_str())] {
        let mut limited = 0;
        while limited < 20 {
            let scene = Scene::new(joints, 0.3, &mut numbers);
            let unlimited = scene.unlimited(text);
            let limits = binding_limits(&scene, &unlimited, &mut numbers);
            let rest = text.find("[task.rest").expect("a posture");
            let alone = text[..rest].replace(", \"rest\"", "");
            let mut with = scene.controller(text, &limits);
            with.without_shortcut();
            let tau = scene.torque(&mut with);
            assert_eq!(sampled(&with, "limits_solver"), [1.0], "the active set");
            let regular = sampled(&with, "hand.weakest_share") == [1.0]
                && (joints == 6 || sampled(&with, "elbow.weakest_share") == [1.0]);
            let ddq = accelerations(&scene.model, &scene.data, tau.as_slice());
            let excess = Bounds::new(&scene, &limits).excess(&ddq, &tau);
            assert!(excess < SOLVERS, "beyond a bound by {excess} of its size");
            if regular && with.is_limited() {
                limited += 1;
                let off = (&tau - scene.torque(&mut scene.controller(&alone, &limits))).amax();
                assert!(off < SOLVERS * (1.0 + tau.amax()), "off by {off} Nm of {tau}");
            }
        }
    }
}

/// An arm under its law, integrated at 1 kHz with torques held.
struct Run {
    model: Model,
    controller: OperationalSpaceController,
    data: Data,
    measurement: Measurement,
    tau: DVector<f64>,
}

const PERIOD_S: f64 = 1e-3;

impl Run {
    fn new(model: Model, text: &str, limits: &JointLimits, q: &[f64], dq: &[f64]) -> Self {
        let (file, mut robot) = (File::read(text), facts(&model, "hand"));
        robot.limits = limits.clone();
        let mut controller =
            OperationalSpaceController::new(&model, &file.stack(), &robot).expect("a good stack");
        let (data, measurement) = at_state(&model, q, dq, 0.0);
        controller.start(&model, &data, &measurement);
        let tau = DVector::zeros(model.n());
        Self { model, controller, data, measurement, tau }
    }

    fn step(&mut self) {
        let seen = &mut self.measurement;
        assert!(update(&self.model, &mut self.data, seen.q.as_slice(), seen.dq.as_slice()));
        self.controller.update(&self.model, &self.data, seen, self.tau.as_mut_slice());
        assert!(self.tau.iter().all(|t| t.is_finite()), "{} at {} s", self.tau, seen.time_s);
        aba(&self.model, &mut self.data, self.tau.as_slice());
        seen.q.axpy(PERIOD_S, &seen.dq, 1.0);
        seen.q.axpy(0.5 * PERIOD_S * PERIOD_S, &self.data.ddq, 1.0);
        seen.dq.axpy(PERIOD_S, &self.data.ddq, 1.0);
        seen.time_s += PERIOD_S;
    }

    fn hand(&self) -> (Vector3<f64>, Vector3<f64>) {
        let hand = self.model.frame("hand").expect("hand");
        let velocity = frame_velocity(&self.model, &self.data, hand).linear;
        (frame_placement(&self.model, &self.data, hand).translation, velocity)
    }
}

/// Limits that the seven-joint arm can work with.
fn workable() -> JointLimits {
    JointLimits {
        lower: vec![-1.6; 7],
        upper: vec![1.6; 7],
        velocity: vec![2.5; 7],
        torque: vec![120.0, 120.0, 80.0, 80.0, 30.0, 30.0, 30.0],
        ..JointLimits::none(7)
    }
}

const REACHED: [f64; 7] = [0.3, 0.7, -0.4, 0.9, 0.2, -0.8, 0.5];

/// Starts that no robot should be in: beyond the ends of ranges and faster than allowed. What is commanded is always a
/// number within the torque limits and their rate; after a second everything is inside, and stays there.
#[test]
fn what_starts_beyond_its_limits_is_led_back() {
    let (limits, mut numbers) = (workable(), Numbers::new(17));
    let mut beyond = 0;
    for text in [POSE, ELBOW, DAMPED] {
        for _ in 0..3 {
            let q = REACHED.map(|q| q + 0.2 * numbers.next());
            let far: Vec<f64> =
                q.iter().map(|&q| if numbers.next() > 0.3 { 1.8 * q.signum() } else { q }).collect();
            let dq = numbers.vector(7, 5.0);
            beyond +=
                far.iter().filter(|q| q.abs() > 1.6).count() + dq.iter().filter(|v| v.abs() > 2.5).count();
            let mut run = Run::new(seven_joints(), text, &limits, &far, &dq);
            let mut before = run.data.gravity.clone();
            for tick in 0..1500 {
                run.step();
                for i in 0..7 {
                    let (t, limit) = (run.tau[i], limits.torque[i]);
                    assert!(t.abs() <= limit * (1.0 + ROUNDING), "joint {i}: {t} Nm of {limit}");
                    let step = (t - before[i].clamp(-limit, limit)).abs();
                    assert!(step <= 0.1 * limit + 2.0 * ROUNDING * limit, "joint {i}: a step of {step} Nm");
                    let (q, v) = (run.measurement.q[i], run.measurement.dq[i]);
                    if tick > 1000 {
                        assert!(
                            q.abs() < 1.6 && v.abs() < 2.5,
                            "joint {i} at tick {tick}: {q} rad, {v} rad/s"
                        );
                    }
                }
                before.copy_from(&run.tau);
            }
        }
    }
    assert!(beyond > 30, "{beyond} joints start beyond a limit");
}

/// A robot that was commanded more than it may be: at once within the limit, whatever the rate.
#[test]
fn a_torque_beyond_its_limit_comes_back_at_once() {
    let (model, q) = (seven_joints(), [0.3, 1.2, -0.4, 0.9, 0.2, -0.8, 0.5]);
    let gravity = at_state(&model, &q, &[0.0; 7], 0.0).0.gravity;
    let limits = JointLimits {
        torque: gravity.iter().map(|g| 0.5 * g.abs() + 0.1).collect(),
        torque_rate: vec![1.0; 7],
        ..JointLimits::none(7)
    };
    let mut run = Run::new(model, DAMPED, &limits, &q, &[0.0; 7]);
    run.step();
    for i in 0..7 {
        assert!(
            run.tau[i].abs() <= limits.torque[i] * (1.0 + ROUNDING),
            "joint {i}: {} of {}",
            run.tau[i],
            limits.torque[i]
        );
        assert!(gravity[i].abs() < 0.5 || gravity[i].abs() > limits.torque[i]);
    }
}

/// A hand that is sent to where the arm's joints can't follow: every joint against the end of its range.
#[test]
fn joints_stop_at_the_ends_of_their_ranges() {
    let mut stopped = 0;
    for (text, offset) in
        [(POSE, "[0.5, -0.4, -0.3]"), (ELBOW, "[-0.6, 0.5, 0.2]"), (DAMPED, "[0.4, 0.6, -0.5]")]
    {
        let reference = format!(
            "reference.point-to-point = {{ position = {{ offset_m = {offset} }}, duration_s = 0.4 }}"
        );
        let text = text.replacen("reference = \"hold\"", &reference, 1);
        let limits = JointLimits {
            lower: REACHED.map(|q| q - 0.25).to_vec(),
            upper: REACHED.map(|q| q + 0.25).to_vec(),
            ..workable()
        };
        let mut run = Run::new(seven_joints(), &text, &limits, &REACHED, &[0.0; 7]);
        let (mut worst, mut jump, mut before) = (f64::NEG_INFINITY, 0.0_f64, run.tau.clone());
        for tick in 0..1500 {
            before.copy_from(&run.tau);
            run.step();
            if tick > 1300 {
                jump = jump.max((&before - &run.tau).amax());
            }
            // Ranges are narrowed by a margin of 0.01 rad.
            worst = worst.max((&run.measurement.q - DVector::from(REACHED.to_vec())).amax() - 0.24);
        }
        assert!(worst < 1e-4, "{text}: {worst} rad beyond");
        stopped += (0..7).filter(|&i| (run.measurement.q[i] - REACHED[i]).abs() > 0.239).count();
        // Pressed against their ends, not beating against them.
        assert!(jump < 0.05, "{text}: torques change by {jump} Nm from tick to tick");
    }
    assert!(stopped > 5, "joints stand at the ends of their ranges: {stopped}");
}

/// Where a hand would be with the joints displaced, from where it is.
fn way_to(offset: &[f64; 7]) -> Vector3<f64> {
    let model = seven_joints();
    let hand = |q: &[f64]| {
        let data = at_state(&model, q, &[0.0; 7], 0.0).0;
        frame_placement(&model, &data, model.frame("hand").expect("hand")).translation
    };
    let q: Vec<f64> = REACHED.iter().zip(offset).map(|(q, d)| q + d).collect();
    hand(&q) - hand(&REACHED)
}

/// How a hand moves that is asked for far more than it may do: the largest speed (m/s), the largest angle (°) between its
/// velocity and the straight way while it is faster than 0.1 m/s, and what is left of the way after `seconds`.
fn hurried(limits: &JointLimits, more: &str, duration_s: f64, seconds: f64) -> (f64, f64, f64) {
    let way = way_to(&[0.3, -0.2, 0.1, 0.4, -0.2, 0.3, 0.1]);
    let offset = way.as_slice();
    let reference = format!(
        "reference.point-to-point = {{ position = {{ offset_m = {offset:?} }}, duration_s = {duration_s} }}"
    );
    let text = DAMPED.replacen("reference = \"hold\"", &format!("{reference}\n{more}"), 1);
    let mut run = Run::new(seven_joints(), &text, limits, &REACHED, &[0.0; 7]);
    let (start, _) = run.hand();
    let (mut fastest, mut aside, mut limited) = (0.0_f64, 0.0_f64, 0);
    for _ in 0..(seconds / PERIOD_S) as usize {
        run.step();
        let (_, velocity) = run.hand();
        let left = start + way - run.hand().0;
        fastest = fastest.max(velocity.norm());
        if velocity.norm() > 0.1 && left.norm() > 0.05 {
            aside = aside.max(velocity.angle(&way));
        }
        limited += usize::from(run.controller.is_limited());
    }
    assert!(limited > 50, "{limited} ticks were limited");
    (fastest, aside.to_degrees(), (start + way - run.hand().0).norm())
}

/// Limits that are in the way of a hurry alone.
fn generous() -> JointLimits {
    JointLimits { lower: vec![-3.0; 7], upper: vec![3.0; 7], velocity: vec![20.0; 7], ..workable() }
}

/// How far from the straight way a hand may be driven by limits that slowing down alone would respect: the weight of what
/// leads aside is ten times, not infinitely, that of what slows down.
const ASIDE_DEG: f64 = 10.0;

/// The hand's speed against the limit of its task, and its direction against the straight way.
#[test]
fn a_hand_keeps_its_speed_limit_and_its_direction() {
    for duration_s in [0.2, 0.5] {
        let (fastest, aside, left) = hurried(&generous(), "speed_limit_m_per_s = 0.3", duration_s, 2.5);
        assert!(fastest < 0.3 * 1.02 && fastest > 0.29, "{fastest} m/s");
        assert!(aside < ASIDE_DEG, "{aside} degrees");
        assert!(left < 1e-4, "{left} m are left");
    }
}

/// The direction of the hand's velocity against the straight way where joints are too slow, too weak, or must not
/// accelerate as asked; and that it gets there.
#[test]
fn limits_slow_a_hand_down_rather_than_lead_it_aside() {
    for limits in [
        JointLimits { velocity: vec![0.6; 7], ..generous() },
        JointLimits { acceleration: vec![4.0; 7], ..generous() },
        JointLimits { torque: vec![60.0, 60.0, 30.0, 30.0, 5.0, 5.0, 5.0], ..generous() },
    ] {
        let (_, aside, left) = hurried(&limits, "", 0.2, 2.5);
        assert!(aside < ASIDE_DEG, "{aside} degrees under {limits:?}");
        assert!(left < 1e-4, "{left} m are left under {limits:?}");
    }
}

/// The same arm held at one state for half a second: with a load that saturates a joint meanwhile, its integral stands where
/// one that has just begun stands; without the load it has grown.
#[test]
fn integrals_stand_still_while_a_limit_is_in_force() {
    let motion =
        DAMPED.replace("damping_ratio = 1.0 }", "damping_ratio = 1.0, integral_per_s = 5.0 }").replacen(
            "reference = \"hold\"",
            "reference.sinusoid.x = [{ amplitude_m = 0.0, frequency_hz = 1.0, offset_m = 0.1 }]",
            1,
        );
    let force = COMPLIANT
        .replace("x = \"compliant\"", "x = \"force\"")
        .replace("filter_hz = 100.0 }", "target_n = { x = 8.0 } }");
    for text in [motion, force] {
        let limits =
            JointLimits { torque: vec![300.0; 7], torque_rate: vec![1e9; 7], ..JointLimits::none(7) };
        let after = |ticks: usize, load: f64| {
            let mut run = Run::new(seven_joints(), &text, &limits, &REACHED, &[0.0; 7]);
            let (mut tau, mut seen) = (DVector::zeros(7), run.measurement.clone());
            seen.time_s = 2.0;
            for tick in 0..=ticks {
                // More than the motor of the second joint has, then nothing.
                seen.added_torque[1] = if tick == 0 || tick == ticks { 0.0 } else { load };
                run.controller.update(&run.model, &run.data, &seen, tau.as_mut_slice());
                assert_eq!(run.controller.is_limited(), seen.added_torque[1] != 0.0);
            }
            tau
        };
        // Two ticks integrate: the first, and the one in which the limit comes to be known.
        let (begun, held, free) = (after(1, 0.0), after(500, 400.0), after(500, 0.0));
        let size = (&free - &begun).amax();
        assert!(size > 1.0, "half a second of integral is {size} Nm");
        let off = (&held - &begun).amax();
        assert!(off < 3.0 * size / 500.0, "{text}: {off} Nm beside {size} Nm");
    }
}

/// What isn't a number, wherever it is measured: the command isn't one either, for the backend to refuse; there is no
/// panic, and after another start the command is a number again.
#[test]
fn what_is_not_a_number_gives_no_command() {
    type Break = fn(&mut Measurement);
    let breaks: [Break; 4] =
        [|m| m.q[2] = f64::NAN, |m| m.dq[5] = f64::NAN, |m| m.dq[0] = f64::INFINITY, |m| m.q.fill(f64::NAN)];
    for text in [POSE, ELBOW, DAMPED, COMPLIANT] {
        for spoil in breaks {
            let mut run = Run::new(seven_joints(), text, &workable(), &REACHED, &[0.0; 7]);
            run.step();
            let good = run.measurement.clone();
            let mut bad = good.clone();
            spoil(&mut bad);
            for _ in 0..3 {
                // Whether M can be factored is for the backend to judge.
                let _ = update(&run.model, &mut run.data, bad.q.as_slice(), bad.dq.as_slice());
                run.controller.update(&run.model, &run.data, &bad, run.tau.as_mut_slice());
                assert!(run.tau.iter().any(|t| !t.is_finite()), "{text}: {}", run.tau);
                assert_eq!(sampled(&run.controller, "limits_solver"), [3.0], "no solver");
            }
            let (q, dq) = (good.q.as_slice(), good.dq.as_slice());
            assert!(update(&run.model, &mut run.data, q, dq));
            run.controller.start(&run.model, &run.data, &good);
            run.measurement = good;
            run.step();
            assert!(
                run.tau.iter().zip(&workable().torque).all(|(t, limit)| t.abs() <= limit * (1.0 + ROUNDING))
            );
        }
        let mut run = Run::new(seven_joints(), text, &workable(), &REACHED, &[0.0; 7]);
        for added in [f64::NAN, f64::INFINITY, -f64::INFINITY] {
            run.measurement.added_torque[3] = added;
            run.controller.update(&run.model, &run.data, &run.measurement, run.tau.as_mut_slice());
        }
    }
}

/// The same without another start: what isn't a number is over with its tick, whatever the law remembers of what it
/// senses and misses. Without limits, a wrench that is lost for a tick against a controller that wasn't asked in that tick.
#[test]
fn what_is_not_a_number_is_forgotten() {
    type Break = fn(&mut Measurement);
    const LOST: usize = 0;
    let breaks: [Break; 5] = [
        |m| {
            m.wrenches[0].linear.fill(f64::NAN);
            m.wrenches[0].angular.fill(f64::NAN);
        },
        |m| m.wrenches[0].linear.y = f64::NAN,
        |m| m.wrenches[0].angular.z = f64::INFINITY,
        |m| m.q[2] = f64::NAN,
        |m| m.dq.fill(f64::NAN),
    ];
    let force = COMPLIANT
        .replace("x = \"compliant\"", "x = \"force\"")
        .replace("filter_hz = 100.0 }", "target_n = { x = 8.0 } }");
    let both = force.replace(
        "damping_ratio = 1.0 }",
        "damping_ratio = 1.0, integral_per_s = 5.0, integral_limit_m = 0.1 }",
    );
    for (text, limits) in [(both, Some(workable())), (without_limits(&force), None)] {
        let robot_limits = limits.clone().unwrap_or_else(|| JointLimits::none(7));
        let command = |run: &mut Run, seen: &Measurement| {
            // Whether M can be factored is for the backend to judge.
            let _ = update(&run.model, &mut run.data, seen.q.as_slice(), seen.dq.as_slice());
            run.controller.update(&run.model, &run.data, seen, run.tau.as_mut_slice());
        };
        for (kind, spoil) in breaks.into_iter().enumerate() {
            let [mut run, mut spared] =
                [(); 2].map(|()| Run::new(seven_joints(), &text, &robot_limits, &REACHED, &[0.0; 7]));
            let mut seen = run.measurement.clone();
            for tick in 0..20 {
                seen.time_s = PERIOD_S * f64::from(tick);
                seen.q[1] = REACHED[1] + 1e-4 * f64::from(tick);
                seen.wrenches[0].linear.x = f64::from(tick);
                if tick == 10 {
                    let mut bad = seen.clone();
                    spoil(&mut bad);
                    command(&mut run, &bad);
                    assert!(run.tau.iter().any(|t| !t.is_finite()), "case {kind}: {}", run.tau);
                    continue;
                }
                command(&mut run, &seen);
                assert!(run.tau.iter().all(|t| t.is_finite()), "case {kind}, tick {tick}: {}", run.tau);
                command(&mut spared, &seen);
            }
            if kind == LOST && limits.is_none() {
                assert_eq!(run.tau, spared.tau);
            }
        }
    }
}

/// Ranges of no width: the joints stay where they are, whatever is asked of the hand.
#[test]
fn a_range_of_no_width_holds_its_joint() {
    let limits = JointLimits { lower: REACHED.to_vec(), upper: REACHED.to_vec(), ..workable() };
    let reference =
        "reference.point-to-point = { position = { offset_m = [0.2, 0.1, -0.1] }, duration_s = 0.2 }";
    let text = POSE.replacen("reference = \"hold\"", reference, 1);
    let mut run = Run::new(seven_joints(), &text, &limits, &REACHED, &[0.0; 7]);
    for _ in 0..500 {
        run.step();
    }
    let away = (0..7).map(|i| (run.measurement.q[i] - REACHED[i]).abs()).fold(0.0, f64::max);
    assert!(away < 1e-4, "{away} rad from where the range is");
}

/// Two joints in a plane, pressed for speed, torque and range at once: they stay within all three.
#[test]
fn a_planar_arm_keeps_its_limits() {
    let link = |name, origin| Link {
        name,
        axis: [0.0, 1.0, 0.0],
        origin,
        mass: 1.0,
        com: [0.0, 0.0, -0.2],
        inertia: [0.01, 0.01, 0.002],
        limits: [-3.0, 3.0],
        rotor: 0.01,
    };
    let model = || {
        arm(
            &[link("shoulder", [0.0; 3]), link("elbow", [0.0, 0.0, -0.4])],
            &[("hand", 1, [0.0, 0.0, -0.4])],
            1.0,
        )
    };
    let text = r#"
        priority = ["hand"]
        [task.hand.cartesian]
        frame = "hand"
        axes = { x = "motion", z = "motion" }
        reference.point-to-point = { position = { offset_m = [0.3, 0.0, 0.3] }, duration_s = 0.1 }
        gains = { frequency_rad_per_s = 20.0, damping_ratio = 1.0 }
    "#;
    let limits = JointLimits {
        lower: vec![-0.5, -1.5],
        upper: vec![0.5, -0.2],
        velocity: vec![2.0; 2],
        torque: vec![9.0, 4.0],
        ..JointLimits::none(2)
    };
    let mut run = Run::new(model(), text, &limits, &[0.1, -0.7], &[0.0; 2]);
    let mut limited = 0;
    for _ in 0..2000 {
        run.step();
        limited += usize::from(run.controller.is_limited());
        for i in 0..2 {
            let (q, v, t) = (run.measurement.q[i], run.measurement.dq[i], run.tau[i]);
            assert!(q > limits.lower[i] && q < limits.upper[i], "joint {i}: {q} rad");
            assert!(v.abs() < limits.velocity[i], "joint {i}: {v} rad/s");
            assert!(t.abs() <= limits.torque[i] * (1.0 + ROUNDING), "joint {i}: {t} Nm");
        }
    }
    assert!(limited > 100, "{limited} ticks were limited");
}

/// A hand faster than its speed limit and joints too weak to brake it as asked: it is braked as hard as they can, against
/// the time that its own law alone takes.
#[test]
fn a_hand_that_is_too_fast_is_braked_as_hard_as_torques_allow() {
    let slow_law = DAMPED.replace("frequency_rad_per_s = 14.0", "frequency_rad_per_s = 0.5");
    let until_slow = |more: &str| {
        let text = slow_law.replacen("reference = \"hold\"", &format!("reference = \"hold\"\n{more}"), 1);
        let limits = JointLimits { torque: vec![60.0, 70.0, 30.0, 30.0, 8.0, 8.0, 8.0], ..generous() };
        let mut run =
            Run::new(seven_joints(), &text, &limits, &REACHED, &[1.5, 1.5, 1.5, -1.5, 0.0, 0.0, 0.0]);
        let first = run.hand().1.norm();
        (0..2000).find(|_| {
            run.step();
            run.hand().1.norm() < 0.5 * first
        })
    };
    let (with, without) = (until_slow("speed_limit_m_per_s = 0.1"), until_slow(""));
    assert!(
        with.is_some_and(|with| without.is_none_or(|without| 2 * with < without)),
        "{with:?}, {without:?} ticks"
    );
}

/// An arm that can't even hold itself, with noise in its velocities: how the torques change from tick to tick, against the
/// size of the noise.
#[test]
fn noise_in_the_velocity_is_no_direction() {
    let jump = |text: &str, noise: f64| {
        let gravity = at_state(&seven_joints(), &REACHED, &[0.0; 7], 0.0).0.gravity;
        let limits = JointLimits {
            torque: gravity.iter().map(|g| 0.9 * g.abs() + 0.01).collect(),
            torque_rate: vec![1e9; 7],
            ..JointLimits::none(7)
        };
        let mut run = Run::new(seven_joints(), text, &limits, &REACHED, &[0.0; 7]);
        let (mut numbers, mut worst) = (Numbers::new(18), 0.0_f64);
        let mut before: Option<DVector<f64>> = None;
        for _ in 0..200 {
            run.measurement.dq.copy_from_slice(&numbers.vector(7, noise));
            assert!(update(&run.model, &mut run.data, &REACHED, run.measurement.dq.as_slice()));
            run.controller.update(&run.model, &run.data, &run.measurement, run.tau.as_mut_slice());
            assert!(run.controller.is_limited());
            if let Some(before) = before.replace(run.tau.clone()) {
                worst = worst.max((&run.tau - before).amax());
            }
        }
        worst
    };
    for text in [POSE, ELBOW, DAMPED] {
        let (noisy, quiet) = (jump(text, 1e-3), jump(text, 1e-4));
        assert!(quiet < 0.2 * noisy + 1e-6, "{text}: {quiet} Nm for a tenth of what gives {noisy} Nm");
    }
}

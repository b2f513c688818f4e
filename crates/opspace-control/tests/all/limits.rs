//! Commands within the robot's limits, compared with the task torques if no limit is active, otherwise with an
//! independent hierarchy of least-squares problems.

use crate::common::stacks::{COMPLIANT, DAMPED, ELBOW, LENGTH_M, POSE, without_limits};
use crate::common::{
    self, File, Numbers, accelerations, at_state, control_context, frame_acceleration, jacobian, random_arm,
    sampled, unreached_limits,
};
use nalgebra::{DMatrix, DVector};
use opspace_backend::Observable;
use opspace_control::limits::horizon::HORIZON_S;
use opspace_control::{ControlContext, Controller, JointLimits, Measurement, OperationalSpaceController};
use opspace_model::{Data, Model, Motion, frame_bias_acceleration, frame_velocity};

// Tolerances are ten times the largest measured error.
/// Torques of the same optimum computed in two ways, relative to their size: measured 5.2e-15.
const TORQUES: f64 = 5e-14;
/// Remaining slope of a level's error at its optimum, relative to that at zero acceleration: measured 1.9e-8.
const SLOPES: f64 = 2e-7;
/// Violation of a bound, relative to its size: measured 7.0e-9.
const EXCESS: f64 = 7e-8;
/// Acceleration of a level with and without the levels below it, relative to its size: measured 4.1e-9.
const LEVELS: f64 = 4e-8;

/// Relative distance from a bound below which a command counts as being at the bound.
const AT_BOUND: f64 = 1e-6;

/// Excess of a task's speed after the horizon, relative to its limit, because bounds are widened between levels.
const REACHED: f64 = 1e-3;

/// Distance from a bound that a level above has reached: the widening between levels lets the lower levels use it if
/// rows are nearly parallel.
const MET: f64 = 1e-4;

const HAND_POSE: &[usize] = &[0, 1, 2, 3, 4, 5];

/// A task set, the number of joints of its arm, and the frames and axes of its levels.
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

/// A moving arm: its start posture and its current state.
pub struct Scene {
    pub model: Model,
    pub start: Vec<f64>,
    pub data: Data,
    pub measurement: Measurement,
}

impl Scene {
    /// Creates a random arm that has moved by at most `far`, rad.
    pub fn new(joints: usize, far: f64, numbers: &mut Numbers) -> Self {
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

    fn robot(&self) -> ControlContext {
        control_context(&self.model, "hand")
    }

    /// Returns a controller that was started at the scene's start.
    pub fn controller(&self, text: &str, limits: &JointLimits) -> OperationalSpaceController {
        let (file, mut robot) = (File::read(text), self.robot());
        robot.limits = limits.clone();
        let mut controller =
            OperationalSpaceController::new(&self.model, &file.task_set(), &robot).expect("a good stack");
        let (data, mut measurement) = at_state(&self.model, &self.start, &vec![0.0; self.model.n()], 0.0);
        measurement.wrenches.clone_from(&self.measurement.wrenches);
        controller.start(&common::input(&self.model, &data, &measurement));
        controller
    }

    pub fn torque(&self, controller: &mut OperationalSpaceController) -> DVector<f64> {
        let mut tau = DVector::zeros(self.model.n());
        controller.update(&common::input(&self.model, &self.data, &self.measurement), tau.as_mut_slice());
        tau
    }

    pub fn unlimited(&self, text: &str) -> DVector<f64> {
        self.torque(&mut self.controller(&without_limits(text), &JointLimits::none(self.model.n())))
    }

    /// Commanded torques at the start: gravity torques.
    fn before(&self) -> DVector<f64> {
        at_state(&self.model, &self.start, &vec![0.0; self.model.n()], 0.0).0.gravity
    }
}

/// Compared: the torques of a task set without limits with those of all QPs with limits that are never reached, also if
/// the tasks damp directions near a singularity.
#[test]
fn unreached_limits_change_nothing() {
    let mut numbers = Numbers::new(11);
    let mut damped = 0;
    for case in &CASES {
        for threshold in ["0.001", "0.1", "1.0"] {
            for _ in 0..8 {
                let scene = Scene::new(case.joints, 0.3, &mut numbers);
                let singular = format!("reference = \"hold\"\nsingularity_threshold = {threshold}");
                let text = case.text.replace("reference = \"hold\"", &singular);
                let limits = unreached_limits(case.joints);
                let mut controller = scene.controller(&text, &limits);
                controller.always_solve();
                let (tau, unlimited) = (scene.torque(&mut controller), scene.unlimited(&text));
                let off = (&tau - &unlimited).amax();
                assert!(off < TORQUES * unlimited.amax(), "{text}: off by {off} Nm of {unlimited}");
                assert!(sampled(&controller, "limited").iter().all(|&at| at == 0.0));
                damped += usize::from(sampled(&controller, "hand.min_singular_gain") < vec![1.0]);
            }
        }
    }
    assert!(damped > 20, "only {damped} poses were near a singularity");
}

/// A level, implemented from the documentation: |J x + b − a|² in the metric WᵀΛW, where x are the joint accelerations.
pub struct Rows {
    pub jacobian: DMatrix<f64>,
    pub bias: DVector<f64>,
    pub asked: DVector<f64>,
    metric: DMatrix<f64>,
}

impl Rows {
    /// Returns the levels of a case, with the accelerations of their frames under the torques without limits.
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
            // Errors perpendicular, in the metric Λ, to the predicted direction of motion have ten times the weight of
            // errors along it.
            let frame = scene.model.frame_id(frame).expect("frame");
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

    pub fn new(scene: &Scene, frame: &str, axes: &[usize], unlimited: &DVector<f64>) -> Self {
        let (model, data) = (&scene.model, &scene.data);
        let whole = jacobian(model, data, frame);
        let jacobian =
            DMatrix::from_fn(axes.len(), model.n(), |r, c| row_scale(axes[r]) * whole[(axes[r], c)]);
        let id = model.frame_id(frame).expect("frame");
        let metric = DMatrix::zeros(axes.len(), axes.len());
        let bias = pick(axes, &six(frame_bias_acceleration(model, data, id)));
        let asked = pick(axes, &frame_acceleration(model, data, frame, unlimited.as_slice()));
        Self { jacobian, bias, asked, metric }
    }
}

/// Scale of a row.
pub fn row_scale(axis: usize) -> f64 {
    if axis < 3 { 1.0 } else { LENGTH_M }
}

/// Selects the rows of a task from all six of a motion.
pub fn pick(axes: &[usize], whole: &DVector<f64>) -> DVector<f64> {
    DVector::from_iterator(axes.len(), axes.iter().map(|&i| row_scale(i) * whole[i]))
}

pub fn six(m: Motion) -> DVector<f64> {
    DVector::from_iterator(6, m.linear.iter().chain(m.angular.iter()).copied())
}

/// Bounds on joint accelerations and torques.
pub struct Bounds {
    pub acceleration: [DVector<f64>; 2],
    pub torque: [DVector<f64>; 2],
}

impl Bounds {
    /// Computes the documented bounds at the scene's state; there are no position limits.
    pub fn new(scene: &Scene, limits: &JointLimits) -> Self {
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

    /// Returns the violation of the bounds by a motion under torques, relative to its size.
    pub fn excess(&self, ddq: &DVector<f64>, tau: &DVector<f64>) -> f64 {
        let beyond = |[lower, upper]: &[DVector<f64>; 2], x: &DVector<f64>| {
            (lower - x).max().max((x - upper).max()) / (1.0 + x.amax())
        };
        beyond(&self.acceleration, ddq).max(beyond(&self.torque, tau))
    }
}

/// Returns the minimum of |E w − f| with w ≥ 0: Lawson and Hanson, *Solving least squares problems*, 1974, ch. 23.
/// Columns of E have length one.
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

/// Checks optimality at `ddq` (Karush, Kuhn and Tucker) of each level's residual, then of the distance to the `posture`
/// in kinetic energy. For each, returns the part of the gradient that neither the rows above nor the active bounds
/// balance, the gradient, and the gradient at zero acceleration. Scaled to unit inertia.
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
            // The null space of this level's rows: the smallest eigenvalues of their square.
            let square = &rows.jacobian * &unscale * &free;
            let spectrum = square.tr_mul(&square).symmetric_eigen();
            let mut order: Vec<usize> = (0..free.ncols()).collect();
            order.sort_by(|&i, &k| spectrum.eigenvalues[i].total_cmp(&spectrum.eigenvalues[k]));
            free = &free * spectrum.eigenvectors.select_columns(&order[..free.ncols() - rows.asked.len()]);
        }
    }
    slopes
}

/// Returns random limits of torque, torque rate, velocity and acceleration that are active in a scene, and that a
/// motion near the desired one satisfies.
pub fn binding_limits(scene: &Scene, unlimited: &DVector<f64>, numbers: &mut Numbers) -> JointLimits {
    let n = scene.model.n();
    let ddq = accelerations(&scene.model, &scene.data, unlimited.as_slice());
    let (size, share) = (ddq.amax(), 0.5 + 0.3 * numbers.next());
    let possible = DVector::from_fn(n, |i, _| share * ddq[i] + 0.2 * size * numbers.next());
    let tau = &scene.data.mass_matrix * &possible + &scene.data.bias;
    // With many limits, the lower levels have no freedom; with few limits, they have.
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

/// Runs `check` on random scenes of each task set with active limits. Its arguments: scene, case, limits, torque
/// without limits, and the controller after its cycle, with its torque.
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
                .all(|(_, name)| sampled(&unbound, &format!("{name}.min_singular_gain")) == [1.0]);
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

/// The bounds and the levels above balance the gradient of each level's documented residual, so that the residual
/// cannot decrease. For the last level, whose metric is M, the unbalanced part bounds the distance to the optimum. In
/// one of some three hundred scenes the proximal steps of a level end with a thousand times that slope.
#[test]
fn each_level_is_optimal_within_limits_and_priorities() {
    let (mut missed, mut inexact) = ([0; 3], 0);
    on_bound_scenes(12, 12, |scene, case, limits, unlimited, controller, tau| {
        assert_eq!(sampled(controller, "limits_solver"), [1.0], "the active set");
        let ddq = accelerations(&scene.model, &scene.data, tau.as_slice());
        let posture = accelerations(&scene.model, &scene.data, unlimited.as_slice());
        let levels = Rows::of(scene, case, unlimited);
        let bounds = Bounds::new(scene, limits);
        let found = slopes(scene, &levels, &posture, &bounds, &ddq);
        for (k, [left, whole, at_rest]) in found.iter().enumerate() {
            inexact += usize::from(*left > SLOPES * at_rest);
            assert!(*left < 1e3 * SLOPES * at_rest, "{}: level {k} could fall by {left}", case.text);
            missed[k] += usize::from(*whole > 1.0);
        }
        let excess = bounds.excess(&ddq, tau);
        assert!(excess < EXCESS, "{}: beyond a bound by {excess} of its size", case.text);
    });
    assert!(inexact <= 1, "{inexact} levels beyond {SLOPES}");
    assert!(missed[0] > 40 && missed[1] > 40 && missed[2] > 15, "levels that limits hold off: {missed:?}");
}

/// Returns the task set's text with only its first level.
pub fn first_level(text: &str) -> String {
    let first = text.split("[task.").nth(1).expect("the file has a task");
    format!("priority = [\"hand\"]\n[task.{first}")
}

/// Compared: the acceleration of the first level's rows with and without the other levels.
#[test]
fn lower_levels_do_not_affect_higher_at_limits() {
    let mut moved = 0;
    on_bound_scenes(13, 10, |scene, case, limits, _, _, tau| {
        let alone = scene.torque(&mut scene.controller(&first_level(case.text), limits));
        let (frame, axes) = case.levels[0];
        let rows = |tau: &DVector<f64>| {
            pick(axes, &frame_acceleration(&scene.model, &scene.data, frame, tau.as_slice()))
        };
        let (with, without) = (rows(tau), rows(&alone));
        let off = (&with - &without).amax();
        assert!(off < LEVELS * (1.0 + with.amax()), "{}: {with} for {without}", case.text);
        moved += usize::from((tau - alone).amax() > 0.1);
    });
    assert!(moved > 15, "the levels below do something: {moved}");
}

/// Compared: the logged signals with the bounds that the command reaches, at both ends of the tolerance.
#[test]
fn active_limit_is_logged_per_joint() {
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
            assert!(
                limited == value(AT_BOUND / 10.0) || limited == value(AT_BOUND * 10.0),
                "joint {i}: {limited}"
            );
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

/// Tasks that leave no null space. Compared: the torques at active limits with and without the posture.
#[test]
fn level_without_freedom_changes_nothing() {
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
            with.always_solve();
            let tau = scene.torque(&mut with);
            assert_eq!(sampled(&with, "limits_solver"), [1.0], "the active set");
            let regular = sampled(&with, "hand.min_singular_gain") == [1.0]
                && (joints == 6 || sampled(&with, "elbow.min_singular_gain") == [1.0]);
            let ddq = accelerations(&scene.model, &scene.data, tau.as_slice());
            let excess = Bounds::new(&scene, &limits).excess(&ddq, &tau);
            assert!(excess < EXCESS, "beyond a bound by {excess} of its size");
            if regular && with.is_limited() {
                limited += 1;
                let off = (&tau - scene.torque(&mut scene.controller(&alone, &limits))).amax();
                assert!(off < TORQUES * (1.0 + tau.amax()), "off by {off} Nm of {tau}");
            }
        }
    }
}

/// Compared: after the horizon, the speed of each of eighteen tasks that exceeds its limit, with this limit; each task has a
/// bound of its own, also the last one.
#[test]
fn every_task_of_many_has_its_speed_bound() {
    let (limit, mut numbers) = (1e-3, Numbers::new(42));
    let model = random_arm(19, &mut numbers);
    let frames: Vec<String> = model.joints().iter().skip(2).map(|joint| joint.name.clone()).collect();
    let tasks: Vec<String> =
        ["hand"].into_iter().chain(frames.iter().rev().map(String::as_str)).map(str::to_owned).collect();
    let names: Vec<String> = (0..tasks.len()).map(|k| format!("\"task{k}\"")).collect();
    let mut text = format!("priority = [{}]\n", names.join(", "));
    for (k, frame) in tasks.iter().enumerate() {
        text += &format!(
            "[task.task{k}.cartesian]\nframe = \"{frame}\"\naxes = {{ x = \"motion\" }}\nreference = \"hold\"\ngains = \
             {{ frequency_rad_per_s = 1.0, damping_ratio = 0.1 }}\nspeed_limit_m_per_s = {limit:e}\n"
        );
    }
    let (start, dq) = (numbers.vector(19, 1.2), numbers.vector(19, 1.0));
    let file = File::read(&text);
    let robot = control_context(&model, "hand");
    let mut controller =
        OperationalSpaceController::new(&model, &file.task_set(), &robot).expect("independent axes");
    let (data, measurement) = at_state(&model, &start, &[0.0; 19], 0.0);
    controller.start(&common::input(&model, &data, &measurement));
    let (data, measurement) = at_state(&model, &start, &dq, 1e-3);
    let mut tau = [0.0; 19];
    controller.update(&common::input(&model, &data, &measurement), &mut tau);
    let mut fast = 0;
    for frame in &tasks {
        let id = model.frame_id(frame).expect("a frame");
        let before = frame_velocity(&model, &data, id).linear.x;
        let after = before + HORIZON_S * frame_acceleration(&model, &data, frame, &tau)[0];
        fast += usize::from(before.abs() > 2.0 * limit);
        assert!(
            after * before.signum() < limit * (1.0 + REACHED),
            "{frame}: {before} m/s becomes {after} m/s"
        );
    }
    assert_eq!(fast, 18, "all tasks are too fast");
}

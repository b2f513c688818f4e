//! Tasks that limits keep from their desired acceleration: weights, scaled tasks, and what limits take. Optima are compared
//! with those of Clarabel for programs that are built from the documentation.

use crate::common::stacks::{COMPLIANT, DAMPED, ELBOW, POSE, without_limits};
use crate::common::{
    self, File, Numbers, accelerations, at_state, build_error, control_context, frame_acceleration, jacobian,
    sampled, seven_joints, unreached_limits,
};
use crate::limited_motion::{REACHED, ROUNDING, Run, moderate_limits};
use crate::limits::{Bounds, Rows, Scene, binding_limits, first_level, pick, six};
use nalgebra::{DMatrix, DVector, Vector3};
use opspace_backend::Observable;
use opspace_control::limits::horizon::HORIZON_S;
use opspace_control::qp::interior_point::InteriorPoint;
use opspace_control::qp::quadratic_program::QuadraticProgram;
use opspace_control::{Controller, JointLimits, OperationalSpaceController};
use opspace_model::frame_velocity;

const SCALED: &str = "when_limited = \"scaled\"";

/// Returns a task set whose first task has more keys.
fn with(text: &str, keys: &str) -> String {
    text.replacen("reference = \"hold\"", &format!("reference = \"hold\"\n{keys}"), 1)
}

/// Motion of a hand whose reference runs along a straight line, much faster than its limits allow.
struct Line {
    /// Largest distance from the line, m.
    aside_m: f64,
    /// Distance from the goal at the end, m.
    left_m: f64,
    /// Distance that the hand moves in the last second, m.
    creep_m: f64,
    /// Number of limited cycles.
    limited: usize,
}

impl Line {
    /// Moves a hand for `seconds`. No joint exceeds its limits of position, speed and torque.
    fn new(limits: &JointLimits, way: &Vector3<f64>, keys: &str, seconds: f64) -> Self {
        let offset = way.as_slice();
        let reference = format!(
            "reference.point-to-point = {{ position = {{ offset_m = {offset:?} }}, duration_s = 0.3 }}\n{keys}"
        );
        let text = DAMPED.replacen("reference = \"hold\"", &reference, 1);
        let mut run = Run::new(seven_joints(), &text, limits, &REACHED, &[0.0; 7]);
        let (start, direction) = (run.hand().0, way.normalize());
        let (mut found, mut late) = (Self { aside_m: 0.0, left_m: 0.0, creep_m: 0.0, limited: 0 }, start);
        let cycles = (1e3 * seconds) as usize;
        for cycle in 0..cycles {
            run.step();
            let moved = run.hand().0 - start;
            found.aside_m = found.aside_m.max((moved - direction * direction.dot(&moved)).norm());
            found.limited += usize::from(run.controller.is_limited());
            for i in 0..7 {
                let (q, v, t) = (run.measurement.q[i], run.measurement.dq[i], run.tau[i]);
                assert!(q <= limits.upper[i] && q >= limits.lower[i], "joint {i}: {q} rad");
                assert!(v.abs() <= limits.velocity[i], "joint {i}: {v} rad/s");
                assert!(t.abs() <= limits.torque[i] * (1.0 + ROUNDING), "joint {i}: {t} Nm");
            }
            if cycle + 1000 == cycles {
                late = run.hand().0;
            }
        }
        found.left_m = (start + way - run.hand().0).norm();
        found.creep_m = (run.hand().0 - late).norm();
        found
    }
}

/// Distance from a goal at which it is reached, m: measured at most 1.2e-10. The other goals are missed by 26 mm and more.
const LEFT_M: f64 = 1e-4;

/// Compared: the largest distance of the hand from a straight line with least squares and with a scaled task, whose joints
/// are too slow or too weak for its reference: 6.2 and 0.063 mm with slow joints, 0.90 and 0.13 mm with weak ones.
#[test]
fn scaled_task_stays_on_its_line() {
    let mut numbers = Numbers::new(5);
    let ways: Vec<Vector3<f64>> = (0..8).map(|_| Vector3::from_fn(|_, _| 0.3 * numbers.next())).collect();
    let slow = JointLimits { velocity: vec![0.4; 7], ..moderate_limits() };
    let weak = JointLimits { torque: vec![60.0, 60.0, 30.0, 30.0, 5.0, 5.0, 5.0], ..moderate_limits() };
    for (limits, least_m, most_m) in [(slow, 4e-3, 1e-4), (weak, 5e-4, 2e-4)] {
        let (mut plain_m, mut scaled_m, mut reached) = (0.0_f64, 0.0_f64, 0);
        for way in &ways {
            let [plain, scaled] = ["", SCALED].map(|keys| Line::new(&limits, way, keys, 3.0));
            // The other goals are out of reach.
            if plain.left_m < LEFT_M {
                assert!(scaled.left_m < LEFT_M, "{} m are left", scaled.left_m);
                assert!(scaled.aside_m <= 1.1 * plain.aside_m, "{} of {} m", scaled.aside_m, plain.aside_m);
                plain_m = plain_m.max(plain.aside_m);
                scaled_m = scaled_m.max(scaled.aside_m);
                reached += usize::from(scaled.limited > 50);
            }
        }
        assert!(reached >= 4, "{reached} goals are reached");
        assert!(plain_m > least_m && scaled_m < most_m, "{plain_m} and {scaled_m} m");
    }
}

/// Compared: hands with goals that joint limits exclude, with least squares and with a scaled task. The scaled task stops on
/// its line; with least squares, the hand goes on along the limit: 61 and 2.1 mm beside the line, 14 and 0.6 mm in the last
/// second.
#[test]
fn scaled_task_stops_on_its_line_at_position_limits() {
    let mut numbers = Numbers::new(6);
    let limits = JointLimits {
        lower: REACHED.map(|q| q - 0.25).to_vec(),
        upper: REACHED.map(|q| q + 0.25).to_vec(),
        ..moderate_limits()
    };
    let [mut plain, mut scaled] = [[0.0_f64; 2]; 2];
    for _ in 0..8 {
        let way = Vector3::from_fn(|_, _| 0.6 * numbers.next());
        for (found, keys) in [(&mut plain, ""), (&mut scaled, SCALED)] {
            let line = Line::new(&limits, &way, keys, 4.0);
            assert!(line.left_m > 0.05, "{} m are left", line.left_m);
            found[0] = found[0].max(line.aside_m);
            found[1] = found[1].max(line.creep_m);
        }
    }
    assert!(scaled[0] < 0.1 * plain[0], "aside: {} and {} m", scaled[0], plain[0]);
    assert!(scaled[1] < 0.2 * plain[1], "in the last second: {} and {} m", scaled[1], plain[1]);
}

/// Cost of deviations y from desired accelerations: aside² |y|²_G less what lies along h, or for a scaled task
/// A² |y + t h/|h||²_G + t².
struct Cost {
    /// y = rows q̈ − desired.
    rows: DMatrix<f64>,
    desired: DVector<f64>,
    metric: DMatrix<f64>,
    heading: DVector<f64>,
    /// Energy that is added to that of the heading.
    still: f64,
    /// Weight of deviations that do not lie along the heading.
    aside: f64,
    scaled: bool,
}

impl Cost {
    /// |h| and G h/|h|.
    fn direction(&self) -> (f64, DVector<f64>) {
        let momentum = &self.metric * &self.heading;
        let size = (self.heading.dot(&momentum) + self.still).sqrt();
        (size, momentum / size)
    }

    /// Quadratic form of (y, t); t is absent without scaling.
    fn form(&self) -> DMatrix<f64> {
        let (k, weight) = (self.desired.len(), self.aside * self.aside);
        let (size, direction) = self.direction();
        if !self.scaled {
            return &self.metric * weight - &direction * direction.transpose() * (weight - 1.0);
        }
        let mut form = (&self.metric * weight).resize(k + 1, k + 1, 0.0);
        form.view_mut((0, k), (k, 1)).copy_from(&(&direction * weight));
        form.view_mut((k, 0), (1, k)).copy_from(&(direction.transpose() * weight));
        form[(k, k)] = weight * self.heading.dot(&direction) / size + 1.0;
        form
    }

    /// Cost of joint accelerations, with the best reduction.
    fn of(&self, ddq: &DVector<f64>) -> f64 {
        let y = &self.rows * ddq - &self.desired;
        let (form, k) = (self.form(), y.len());
        if !self.scaled {
            return y.dot(&(&form * &y));
        }
        let (size, _) = self.direction();
        let slope = form.view((0, k), (k, 1)).dot(&y);
        let t = (-slope / form[(k, k)]).clamp(0.0, size / HORIZON_S);
        let whole = y.push(t);
        whole.dot(&(&form * &whole))
    }

    /// Lowest cost within bounds, by Clarabel; `None` if it does not converge. A small part of the distance from `near` in kinetic energy makes the optimum
    /// unique.
    fn lowest(&self, scene: &Scene, bounds: &Bounds, near: &DVector<f64>) -> Option<f64> {
        let (n, m) = (scene.model.n(), &scene.data.mass_matrix);
        let unscale = DMatrix::from_diagonal(&m.diagonal().map(|x| 1.0 / x.sqrt()));
        let variables = n + usize::from(self.scaled);
        let mut map =
            (&self.rows * &unscale).resize(self.desired.len() + usize::from(self.scaled), variables, 0.0);
        let mut offset = self.desired.clone();
        if self.scaled {
            map[(self.desired.len(), n)] = 1.0;
            offset = offset.push(0.0);
        }
        let form = self.form();
        let mut program = QuadraticProgram::new(variables, 2 * n + 1);
        program.hessian = map.tr_mul(&(&form * &map));
        program.gradient = -map.tr_mul(&(&form * &offset));
        let small = 1e-10 * program.hessian.trace();
        let mass = &unscale * m * &unscale * small;
        let mut block = program.hessian.view_mut((0, 0), (n, n));
        block += &mass;
        let pull = &mass * (unscale.map_diagonal(|x| 1.0 / x).component_mul(near));
        let mut head = program.gradient.rows_mut(0, n);
        head -= pull;
        let torque = m * &unscale;
        for i in 0..n {
            program.row_mut(i).fill(0.0);
            program.row_mut(i)[i] = unscale[(i, i)];
            program.row_mut(n + i).fill(0.0);
            program.row_mut(n + i)[..n].copy_from_slice(torque.row(i).transpose().as_slice());
            (program.lower[i], program.upper[i]) = (bounds.acceleration[0][i], bounds.acceleration[1][i]);
            let bias = scene.data.bias[i];
            program.lower[n + i] = bounds.torque[0][i] - bias;
            program.upper[n + i] = bounds.torque[1][i] - bias;
        }
        program.row_mut(2 * n).fill(0.0);
        (program.lower[2 * n], program.upper[2 * n]) = (f64::NEG_INFINITY, f64::INFINITY);
        if self.scaled {
            program.row_mut(2 * n)[n] = 1.0;
            (program.lower[2 * n], program.upper[2 * n]) = (0.0, self.direction().0 / HORIZON_S);
        }
        let mut solver = InteriorPoint::new(variables, 2 * n + 1).expect("a small program");
        solver.solve(&program).ok()?;
        Some(self.of(&(&unscale * DVector::from_column_slice(&solver.x()[..n]))))
    }
}

/// Excess of a cost over the lowest one, relative to the cost at rest: ten times the largest measured one.
const COSTS: f64 = 1.7e-6;

/// Checks on random scenes with active limits that the first level of a task set has the lowest cost within the bounds.
fn check_optimum(text: &str, joints: usize, seed: u64, cost: impl Fn(&Scene, &DVector<f64>) -> Cost) {
    let (mut numbers, mut limited, mut deviating, mut unsolved) = (Numbers::new(seed), 0, 0, 0);
    while limited < 20 {
        let scene = Scene::new(joints, 0.3, &mut numbers);
        let mut unbound = scene.controller(&without_limits(text), &JointLimits::none(joints));
        let unlimited = scene.torque(&mut unbound);
        let signals: Vec<String> = unbound.signals().into_iter().map(|signal| signal.name).collect();
        let is_regular =
            |name: &String| !name.ends_with("min_singular_gain") || sampled(&unbound, name) == [1.0];
        if !signals.iter().all(is_regular) {
            continue;
        }
        let limits = binding_limits(&scene, &unlimited, &mut numbers);
        let mut controller = scene.controller(text, &limits);
        let tau = scene.torque(&mut controller);
        if !controller.is_limited() {
            continue;
        }
        assert_eq!(sampled(&controller, "limits_solver"), [1.0], "the active set");
        let ddq = accelerations(&scene.model, &scene.data, tau.as_slice());
        let free = accelerations(&scene.model, &scene.data, unlimited.as_slice());
        let (cost, bounds) = (cost(&scene, &free), Bounds::new(&scene, &limits));
        assert!(bounds.excess(&ddq, &tau) < 1e-7, "{text}: beyond a bound");
        let (found, Some(lowest)) = (cost.of(&ddq), cost.lowest(&scene, &bounds, &free)) else {
            unsolved += 1;
            continue;
        };
        let whole = cost.of(&DVector::zeros(joints)).max(lowest);
        assert!(
            found - lowest < COSTS * whole,
            "{text}: a cost of {found}, lowest {lowest}, at rest {whole}"
        );
        limited += 1;
        deviating += usize::from(lowest > 1e-6 * whole);
    }
    assert!(unsolved <= 5, "Clarabel did not converge in {unsolved} scenes");
    assert!(deviating > 5, "{deviating} scenes in which the first level deviates");
}

/// Cost of the rows of a hand with weights.
fn hand_cost(
    scene: &Scene,
    axes: &[usize],
    weights: &[f64],
    aside: f64,
    scaled: bool,
    free: &DVector<f64>,
) -> Cost {
    let (model, data) = (&scene.model, &scene.data);
    let tau = &data.mass_matrix * free + &data.bias;
    let rows = Rows::new(scene, "hand", axes, &tau);
    let mass_inverse = data.mass_matrix.clone().try_inverse().expect("M is regular");
    let mobility = &rows.jacobian * mass_inverse * rows.jacobian.transpose();
    let weights = DMatrix::from_diagonal(&DVector::from_column_slice(weights));
    let metric = &weights * mobility.try_inverse().expect("no singularity") * &weights;
    let hand = model.frame_id("hand").expect("a frame");
    let mut heading = pick(axes, &six(frame_velocity(model, data, hand))) + &rows.asked * HORIZON_S;
    if scaled && axes == [0, 1, 2, 5] {
        // Compliant axes are not scaled.
        (heading[0], heading[3]) = (0.0, 0.0);
    }
    let still = 2e-3 * 2e-3 * metric.trace();
    let desired = &rows.asked - &rows.bias;
    Cost { rows: rows.jacobian, desired, metric, heading, still, aside, scaled }
}

/// Compared: the cost of the hand's deviations with the lowest one, for weighted and for scaled tasks.
#[test]
fn weighted_and_scaled_tasks_are_optimal() {
    let pose: &[usize] = &[0, 1, 2, 3, 4, 5];
    let (even, uneven) = ([1.0; 6], [0.5, 5.0, 1.0, 20.0, 1.0, 0.5]);
    let weight = "weight = { x = 0.5, y = 5.0, rx = 20.0, rz = 0.5 }";
    let both = format!("{weight}\n{SCALED}");
    check_optimum(&with(POSE, weight), 7, 21, |s, free| hand_cost(s, pose, &uneven, 10.0, false, free));
    check_optimum(&with(POSE, SCALED), 7, 22, |s, free| hand_cost(s, pose, &even, 100.0, true, free));
    check_optimum(&with(POSE, &both), 7, 23, |s, free| hand_cost(s, pose, &uneven, 100.0, true, free));
    check_optimum(&with(DAMPED, SCALED), 6, 24, |s, free| {
        hand_cost(s, &[0, 1, 2], &[1.0; 3], 100.0, true, free)
    });
    let far = "weight = [100.0, 1.0, 1.0]";
    check_optimum(&with(DAMPED, far), 6, 25, |s, free| {
        hand_cost(s, &[0, 1, 2], &[100.0, 1.0, 1.0], 10.0, false, free)
    });
    check_optimum(&with(COMPLIANT, SCALED), 7, 26, |s, free| {
        hand_cost(s, &[0, 1, 2, 5], &[1.0; 4], 100.0, true, free)
    });
    let lateral = format!("limits.lateral_weight = 40.0\n{DAMPED}");
    check_optimum(&lateral, 7, 27, |s, free| hand_cost(s, &[0, 1, 2], &[1.0; 3], 40.0, false, free));
}

/// All joints, which follow a reference.
const JOINTS: &str = r#"
priority = ["all"]
[task.all.joint-tracking]
reference = "hold"
gains = { frequency_rad_per_s = 9.0, damping_ratio = 0.8 }
"#;

/// Compared: the cost of the joints' deviations with the lowest one, for weighted and for scaled tasks of all joints.
#[test]
fn weighted_and_scaled_joints_are_optimal() {
    let weight = "weight = { j1 = 0.3, j4 = 20.0 }";
    let uneven = [0.3, 1.0, 1.0, 20.0, 1.0, 1.0, 1.0];
    let cost = |scene: &Scene, weights: [f64; 7], scaled: bool, free: &DVector<f64>| {
        let weights = DMatrix::from_diagonal(&DVector::from_column_slice(&weights));
        let metric = &weights * &scene.data.mass_matrix * &weights;
        let heading = &scene.data.dq + free * HORIZON_S;
        let still = 0.01 * 0.01 * scene.data.mass_matrix.trace();
        let (rows, desired) = (DMatrix::identity(7, 7), free.clone());
        // Without scaling, no direction is preferred.
        let aside = if scaled { 100.0 } else { 1.0 };
        Cost { rows, desired, metric, heading, still, aside, scaled }
    };
    check_optimum(&with(JOINTS, weight), 7, 31, |s, free| cost(s, uneven, false, free));
    check_optimum(&with(JOINTS, SCALED), 7, 32, |s, free| cost(s, [1.0; 7], true, free));
    check_optimum(&with(JOINTS, &format!("{weight}\n{SCALED}")), 7, 33, |s, free| {
        cost(s, uneven, true, free)
    });
}

/// Compared: the torques of tasks with and without weights and scaling, in cycles without active limits: bit for bit, and up
/// to rounding if all programs are solved nevertheless.
#[test]
fn options_change_nothing_within_limits() {
    let mut numbers = Numbers::new(41);
    let n = 7;
    let limits = unreached_limits(n);
    for text in [POSE, ELBOW, JOINTS] {
        let weight = if text == JOINTS { "weight = { j2 = 7.0 }" } else { "weight = { x = 7.0 }" };
        for keys in [weight, SCALED, &format!("{weight}\n{SCALED}")] {
            for _ in 0..4 {
                let scene = Scene::new(n, 0.3, &mut numbers);
                let plain = scene.torque(&mut scene.controller(text, &limits));
                let mut controller = scene.controller(&with(text, keys), &limits);
                assert_eq!(scene.torque(&mut controller), plain, "{keys}");
                let mut controller = scene.controller(&with(text, keys), &limits);
                controller.always_solve();
                let off = (scene.torque(&mut controller) - &plain).amax();
                assert!(off < 1e-11 * (1.0 + plain.amax()), "{keys}: off by {off} Nm");
            }
        }
    }
}

/// Compared: the acceleration of a scaled or weighted first level with and without the levels below.
#[test]
fn lower_levels_do_not_affect_scaled_ones() {
    let (mut numbers, mut limited) = (Numbers::new(42), 0);
    for keys in [SCALED, "weight = { x = 10.0 }"] {
        for text in [with(ELBOW, keys), with(POSE, keys)] {
            let axes: &[usize] = if text.contains("rx") { &[0, 1, 2, 3, 4, 5] } else { &[0, 1, 2] };
            for _ in 0..12 {
                let scene = Scene::new(7, 0.3, &mut numbers);
                let unlimited = scene.unlimited(&text);
                let limits = binding_limits(&scene, &unlimited, &mut numbers);
                let mut controller = scene.controller(&text, &limits);
                let tau = scene.torque(&mut controller);
                let alone = scene.torque(&mut scene.controller(&first_level(&text), &limits));
                let rows = |tau: &DVector<f64>| {
                    pick(axes, &frame_acceleration(&scene.model, &scene.data, "hand", tau.as_slice()))
                };
                let off = (rows(&tau) - rows(&alone)).amax();
                if sampled(&controller, "hand.min_singular_gain") == [1.0] && controller.is_limited() {
                    assert!(off < 1e-6 * (1.0 + rows(&tau).amax()), "{keys}: {off} m/s²");
                    limited += 1;
                }
            }
        }
    }
    assert!(limited > 20, "{limited} scenes");
}

/// Compared: what limits take from the axes of a hand whose x axis has a large weight, or a small one, with what they take from
/// it with equal weights.
#[test]
fn limits_take_from_axes_of_small_weight() {
    let taken = |keys: &str| {
        let (mut numbers, mut sums) = (Numbers::new(47), [0.0; 3]);
        for _ in 0..60 {
            let scene = Scene::new(7, 0.3, &mut numbers);
            let unlimited = scene.unlimited(DAMPED);
            let limits = binding_limits(&scene, &unlimited, &mut numbers);
            let mut controller = scene.controller(&with(DAMPED, keys), &limits);
            scene.torque(&mut controller);
            let slack = sampled(&controller, "hand.slack");
            sums.iter_mut().zip(slack).for_each(|(sum, slack)| *sum += slack.abs());
        }
        sums
    };
    let [even, heavy, light] = ["", "weight = { x = 50.0 }", "weight = { x = 0.02 }"].map(taken);
    assert!(heavy[0] < 0.5 * even[0] && heavy[1] > 0.7 * even[1], "{even:?} {heavy:?}");
    assert!(light[0] > even[0] && light[1] < even[1] && light[2] < even[2], "{even:?} {light:?}");
}

/// Compared: the logged slack with the difference of the accelerations that the commands without and with limits cause, by
/// forward dynamics; it is zero in the next free cycle.
#[test]
fn slack_is_what_limits_take() {
    let (mut numbers, mut some, mut least) = (Numbers::new(43), 0, f64::INFINITY);
    let frames = [("hand", "hand"), ("elbow", "upper")];
    for _ in 0..30 {
        let scene = Scene::new(7, 0.3, &mut numbers);
        let unlimited = scene.unlimited(ELBOW);
        let limits = binding_limits(&scene, &unlimited, &mut numbers);
        let mut controller = scene.controller(ELBOW, &limits);
        let tau = scene.torque(&mut controller);
        for (task, frame) in frames {
            let rows =
                |tau: &DVector<f64>| frame_acceleration(&scene.model, &scene.data, frame, tau.as_slice());
            let taken = rows(&unlimited) - rows(&tau);
            let axes = if task == "hand" { 0..3 } else { 2..3 };
            let slack = sampled(&controller, &format!("{task}.slack"));
            let size = 1.0 + rows(&unlimited).amax();
            for (axis, value) in slack.iter().enumerate() {
                let expected = if axes.contains(&axis) { taken[axis] } else { 0.0 };
                assert!((value - expected).abs() < 1e-10 * size, "{task} {axis}: {value} for {expected}");
            }
            some += usize::from(slack.iter().any(|value| value.abs() > 0.1));
        }
        let lost = DVector::from_vec(sampled(&controller, "rest.slack"));
        let moved = jacobian(&scene.model, &scene.data, "hand").rows(0, 3) * &lost;
        if sampled(&controller, "hand.min_singular_gain") == [1.0] {
            assert!(moved.amax() < 1e-9 * (1.0 + lost.amax()), "the null space of the hand: {moved}");
        }
        least = least.min(if controller.is_limited() { lost.amax() } else { f64::INFINITY });
        let mut free = scene.controller(ELBOW, &JointLimits::none(7));
        scene.torque(&mut free);
        assert!(!free.is_limited());
        for signal in ["hand.slack", "elbow.slack", "rest.slack"] {
            assert!(sampled(&free, signal).iter().all(|value| *value == 0.0), "{signal}");
        }
    }
    assert!(some > 15 && least < f64::INFINITY, "{some} levels with slack");
}

/// The slack of a limited cycle is reset by the free cycle after it.
#[test]
fn slack_ends_with_the_limit() {
    let (model, file) = (seven_joints(), File::read(DAMPED));
    let mut robot = control_context(&model, "hand");
    robot.limits = JointLimits { velocity: vec![1.0; 7], ..JointLimits::none(7) };
    let mut controller =
        OperationalSpaceController::new(&model, &file.task_set(), &robot).expect("a good stack");
    let (data, measurement) = at_state(&model, &REACHED, &[0.0; 7], 0.0);
    controller.start(&common::input(&model, &data, &measurement));
    for (speed, is_limited) in [(0.0, false), (1.5, true), (0.0, false)] {
        let (data, measurement) = at_state(&model, &REACHED, &[speed; 7], 0.01);
        controller.update(&common::input(&model, &data, &measurement), &mut [0.0; 7]);
        assert_eq!(controller.is_limited(), is_limited, "at {speed} rad/s");
        for signal in ["hand.slack", "rest.slack"] {
            assert_eq!(
                sampled(&controller, signal).iter().any(|value| *value != 0.0),
                is_limited,
                "{signal}"
            );
        }
    }
}

/// Compared: the accelerations of joints beyond their speed limit with those that bring them to it within the horizon of the
/// file.
#[test]
fn horizon_of_the_file_brakes_joints() {
    for (keys, horizon_s) in
        [("", HORIZON_S), ("limits.horizon_s = 0.05", 0.05), ("limits.horizon_s = 0.005", 0.005)]
    {
        let scene = Scene::new(7, 0.0, &mut Numbers::new(44));
        let limits = JointLimits { velocity: vec![1e-3; 7], ..JointLimits::none(7) };
        let text = format!("{keys}\n{DAMPED}");
        let tau = scene.torque(&mut scene.controller(&text, &limits));
        let ddq = accelerations(&scene.model, &scene.data, tau.as_slice());
        for (a, v) in ddq.iter().zip(&scene.data.dq) {
            let after = v + horizon_s * a;
            assert!(after.abs() < 0.9e-3 * (1.0 + 1e-6), "{keys}: {after} rad/s after {horizon_s} s");
        }
    }
}

/// Compared: differences of the accelerations with three dampings of unused motion, which are proportional to the damping and
/// move no hand.
#[test]
fn unused_damping_of_the_file_brakes_the_null_space() {
    let scene = Scene::new(7, 0.3, &mut Numbers::new(46));
    let hand = first_level(DAMPED);
    let mut controller = scene.controller(&hand, &JointLimits::none(7));
    scene.torque(&mut controller);
    assert_eq!(sampled(&controller, "hand.min_singular_gain"), [1.0], "no damped direction");
    let [default, ten, thirty, fifty] = ["", "10.0", "30.0", "50.0"].map(|damping| {
        let key =
            if damping.is_empty() { String::new() } else { format!("unused_damping_per_s = {damping}\n") };
        let tau = scene.torque(&mut scene.controller(&format!("{key}{hand}"), &JointLimits::none(7)));
        accelerations(&scene.model, &scene.data, tau.as_slice())
    });
    assert_eq!(default, ten, "the default");
    let (near, far) = (&thirty - &ten, &fifty - &ten);
    assert!((&near * 2.0 - &far).amax() < 1e-9 * far.amax() && far.amax() > 1.0, "{near} {far}");
    assert!((jacobian(&scene.model, &scene.data, "hand").rows(0, 3) * &far).amax() < 1e-9 * far.amax());
}

/// Compared: the smallest gain near a singular pose for damping zones: that of the default values is the default, and a wider
/// zone damps more.
#[test]
fn damping_zone_of_the_file_damps() {
    // A nearly straight arm.
    let gain = |keys: &str| {
        let model = seven_joints();
        let (file, robot) = (File::read(&with(POSE, keys)), control_context(&model, "hand"));
        let mut controller =
            OperationalSpaceController::new(&model, &file.task_set(), &robot).expect("a good stack");
        let (data, measurement) = at_state(&model, &[0.3, 0.02, -0.4, 0.03, 0.2, 0.02, 0.5], &[0.0; 7], 0.0);
        controller.start(&common::input(&model, &data, &measurement));
        controller.update(&common::input(&model, &data, &measurement), &mut [0.0; 7]);
        sampled(&controller, "hand.min_singular_gain")[0]
    };
    let zone = |at_rest: f64| format!("damping_zone = {{ at_rest = {at_rest} }}");
    let all = "damping_zone = { at_rest = 0.005, most = 0.3, full_demand_m_per_s2 = 4.0 }";
    assert_eq!(gain(""), gain(all));
    assert_eq!(gain(""), gain("damping_zone = {}"));
    assert!(gain(&zone(0.3)) < 0.9 * gain(""), "{} {}", gain(&zone(0.3)), gain(""));
}

/// Values out of range are refused with their key and the reason.
#[test]
fn values_out_of_range_are_refused() {
    let model = seven_joints();
    let hand = |keys: &str| with(POSE, keys);
    for (text, key, words) in [
        (hand("weight = { x = 101.0 }"), "task.hand.cartesian.weight", "at most 100 times"),
        (
            with(JOINTS, "weight = { j1 = 0.1, j2 = 20.0 }"),
            "task.all.joint-tracking.weight",
            "at most 100 times",
        ),
        (with(JOINTS, "weight = { j9 = 2.0 }"), "task.all.joint-tracking.weight.j9", "j9"),
        (
            with(JOINTS, "joints = [\"j1\"]\nweight = { j2 = 2.0 }"),
            "task.all.joint-tracking.weight.j2",
            "not in the task",
        ),
        (hand("damping_zone = { at_rest = 0.4 }"), "task.hand.cartesian.damping_zone", "above `most`"),
        (hand("damping_zone = { most = 1.5 }"), "task.hand.cartesian.damping_zone", "above 1"),
        (
            hand("damping_zone = {}\nsingularity_threshold = 0.1"),
            "task.hand.cartesian.damping_zone",
            "singularity_threshold",
        ),
        (
            hand("damping_zone = {}\nsingularities = \"plain\""),
            "task.hand.cartesian.damping_zone",
            "singularities",
        ),
        (format!("limits.horizon_s = 0.004\n{POSE}"), "limits.horizon_s", "five control periods"),
        (format!("limits.horizon_s = 0.6\n{POSE}"), "limits.horizon_s", "0.5 s"),
        (format!("limits.lateral_weight = 0.5\n{POSE}"), "limits.lateral_weight", "from 1"),
        (format!("limits.lateral_weight = 200.0\n{POSE}"), "limits.lateral_weight", "100"),
        (
            format!("unused_damping_per_s = 300.0\n{POSE}"),
            "unused_damping_per_s",
            "a fifth of the control rate",
        ),
    ] {
        let error = build_error(&model, &text);
        assert_eq!(error.key(), key, "{error}");
        assert!(error.to_string().contains(words), "{error}");
    }
}

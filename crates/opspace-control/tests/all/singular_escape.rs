//! Escape from singular poses, as an option: goals along a lost direction are reached, unreachable ones leave the arm at
//! rest, and limits and tasks of higher priority are kept.

use crate::common::{self, File, Link, Numbers, any_arm, arm, at_state, control_context, sampled};
use nalgebra::{DVector, Matrix6xX, SymmetricEigen, Vector3, Vector6};
use opspace_control::{Controller, JointLimits, OperationalSpaceController, orientation};
use opspace_model::{Data, FrameId, Model, Placement, aba, frame_jacobian, frame_placement, update};
use opspace_testing::allocation::allocations;

/// Rounding of positions, velocities and accelerations, relative to values of 1 to 100; matrices are nearly singular.
const ROUNDING: f64 = 1e-6;

/// Motion of an arm whose escape is refused, rad: it settles under the part of the demand that is not lost.
const UNMOVED_RAD: f64 = 1e-3;

/// Speed of this arm at the end, rad/s.
const AT_REST_RAD_PER_S: f64 = 1e-4;

/// Motion of an arm that escaped, rad, at least.
const MOVED_RAD: f64 = 0.1;

const PERIOD_S: f64 = 1e-3;

/// Time within which a goal must be reached, s.
const LONGEST_S: f64 = 10.0;

/// Time for which an arm must stay at its goal, s.
const STAYS_S: f64 = 0.3;

/// Angle by which a joint is off at most, as by the noise of its encoder, rad.
const NOISE_RAD: f64 = 1e-5;

/// An arm in a singular pose with a goal for its frame `hand`.
struct Case {
    model: Model,
    limits: JointLimits,
    start: Vec<f64>,
    /// Displacement (m) and rotation vector (rad) from the start to the goal.
    goal: Vector6<f64>,
    /// Axes of the task.
    axes: &'static str,
    /// Names of the tasks in order of priority, and the text of the others.
    priority: &'static str,
    others: &'static str,
}

/// Result of a case.
#[derive(Debug, Default)]
struct Outcome {
    reached: bool,
    escaped_s: f64,
    /// Largest violation of a limit, in its unit.
    violation: f64,
    /// Largest motion of a joint, rad.
    moved_rad: f64,
    /// Speed of the fastest joint at the end, rad/s.
    speed: f64,
    /// Torques of all cycles, as bits.
    torques: Vec<u64>,
    /// Largest deviation of the first joint's acceleration from that which the task FIRST demands, rad/s².
    first_off_rad_per_s2: f64,
}

const POSE: &str =
    "x = \"motion\", y = \"motion\", z = \"motion\", rx = \"motion\", ry = \"motion\", rz = \"motion\"";
const POSITION: &str = "x = \"motion\", y = \"motion\", z = \"motion\"";
const PLANE: &str = "x = \"motion\", z = \"motion\"";
const REST: &str = "[task.rest.joint-posture]\nfrequency_rad_per_s = 6.0\ndamping_ratio = 1.0\n";
const FIRST: &str = "[task.first.joint-tracking]\njoints = [\"j1\"]\nreference = \"hold\"\n\
    gains = { frequency_rad_per_s = 20.0, damping_ratio = 1.0 }\n";

impl Case {
    fn rotates(&self) -> bool {
        self.axes == POSE
    }

    fn text(&self, option: bool) -> String {
        let [x, y, z] = [0, 1, 2].map(|i| self.goal[i]);
        let turn = nalgebra::Rotation3::from_scaled_axis(self.goal.fixed_rows::<3>(3).into_owned());
        let (roll, pitch, yaw) = turn.euler_angles();
        let turn = if self.rotates() {
            format!(", orientation = {{ offset_rpy_rad = [{roll}, {pitch}, {yaw}] }}")
        } else {
            String::new()
        };
        let option = if option { "escape = \"nullspace-step\"\n" } else { "" };
        format!(
            "priority = [{}]\n[task.hand.cartesian]\nframe = \"hand\"\naxes = {{ {} }}\nreference.point-to-point = {{ position \
             = {{ offset_m = [{x}, {y}, {z}] }}{turn}, duration_s = 1.0 }}\ngains = {{ frequency_rad_per_s = 20.0, \
             damping_ratio = 1.0 }}\n{option}{}",
            self.priority, self.axes, self.others
        )
    }

    fn controller(&self, option: bool) -> OperationalSpaceController {
        let file = File::read(&self.text(option));
        let mut context = control_context(&self.model, "hand");
        context.limits = self.limits.clone();
        OperationalSpaceController::new(&self.model, &file.task_set(), &context)
            .unwrap_or_else(|e| panic!("{e}"))
    }

    fn hand(&self) -> FrameId {
        self.model.frame_id("hand").expect("hand")
    }

    /// Pose of the goal.
    fn goal(&self) -> Placement {
        let (data, _) = at_state(&self.model, &self.start, &vec![0.0; self.model.n()], 0.0);
        let mut goal = frame_placement(&self.model, &data, self.hand());
        goal.translation += self.goal.fixed_rows::<3>(0);
        goal.rotation = orientation::exp(&self.goal.fixed_rows::<3>(3).into_owned()) * goal.rotation;
        goal
    }

    /// Error at a pose of the hand, m and rad.
    fn error(&self, goal: &Placement, data: &Data) -> Vector6<f64> {
        let hand = frame_placement(&self.model, data, self.hand());
        let away = goal.translation - hand.translation;
        let turn = orientation::log(&(goal.rotation * hand.rotation.transpose()));
        let turn = if self.rotates() { turn } else { Vector3::zeros() };
        Vector6::new(away.x, away.y, away.z, turn.x, turn.y, turn.z)
    }

    /// Returns true if Newton's method from random postures finds one within the limits at the goal.
    fn is_reachable(&self) -> bool {
        let (n, goal) = (self.model.n(), self.goal());
        let rows = if self.rotates() { 6 } else { 3 };
        let mut numbers = Numbers::new(77);
        (0..60).any(|_| {
            let mut q: Vec<f64> = self.start.iter().map(|q| q + 1.5 * numbers.next()).collect();
            for _ in 0..60 {
                let (data, _) = at_state(&self.model, &q, &vec![0.0; n], 0.0);
                let error = self.error(&goal, &data);
                if error.norm() < 1e-6 {
                    break;
                }
                let error = error.rows(0, rows).into_owned();
                let j = common::jacobian(&self.model, &data, "hand").rows(0, rows).into_owned();
                let mut damped = &j * j.transpose();
                (0..rows).for_each(|i| damped[(i, i)] += 1e-6 + 0.01 * error.norm_squared());
                let step = j.transpose() * damped.lu().solve(&error).expect("regular");
                q.iter_mut().zip(&step).for_each(|(q, step)| *q += step.clamp(-0.5, 0.5));
            }
            let (data, _) = at_state(&self.model, &q, &vec![0.0; n], 0.0);
            let margin = 0.02;
            let within =
                |i: usize| (self.limits.lower[i] + margin..self.limits.upper[i] - margin).contains(&q[i]);
            self.error(&goal, &data).norm() < 1e-6 && (0..n).all(within)
        })
    }

    /// Moves the arm, with four steps of forward dynamics per control cycle, until it stays at the goal.
    fn run(&self, option: bool, duration_s: f64) -> Outcome {
        let (model, n, goal) = (&self.model, self.model.n(), self.goal());
        let mut controller = self.controller(option);
        let (mut q, mut dq, mut tau) = (self.start.clone(), vec![0.0; n], vec![0.0; n]);
        let (mut data, mut out, mut time_s, mut stayed_s) = (Data::new(model), Outcome::default(), 0.0, 0.0);
        while time_s < duration_s && stayed_s < STAYS_S {
            let (seen, measurement) = at_state(model, &q, &dq, time_s);
            let input = common::input(model, &seen, &measurement);
            if time_s == 0.0 {
                controller.start(&input);
            }
            controller.update(&input, &mut tau);
            let demanded = 400.0 * (self.start[0] - q[0]) - 40.0 * dq[0];
            let first = common::accelerations(model, &seen, &tau)[0];
            out.first_off_rad_per_s2 = out.first_off_rad_per_s2.max((first - demanded).abs());
            out.torques.extend(tau.iter().map(|t| t.to_bits()));
            if option && sampled(&controller, "hand.escape")[0] != 0.0 {
                out.escaped_s += PERIOD_S;
            }
            for _ in 0..4 {
                assert!(update(model, &mut data, &q, &dq), "{dq:?}");
                aba(model, &mut data, &tau);
                for i in 0..n {
                    dq[i] += 0.25 * PERIOD_S * data.ddq[i];
                    q[i] += 0.25 * PERIOD_S * dq[i];
                }
            }
            for i in 0..n {
                let over = (q[i] - self.limits.upper[i]).max(self.limits.lower[i] - q[i]);
                let fast = dq[i].abs() - self.limits.velocity[i];
                let strong = tau[i].abs() - self.limits.torque[i];
                out.violation = out.violation.max(over).max(fast).max(strong);
                out.moved_rad = out.moved_rad.max((q[i] - self.start[i]).abs());
            }
            out.speed = dq.iter().fold(0.0, |m, v| v.abs().max(m));
            time_s += PERIOD_S;
            let error = self.error(&goal, &data);
            let is_there = error.fixed_rows::<3>(0).norm() < 1e-3 && error.fixed_rows::<3>(3).norm() < 5e-3;
            stayed_s = if is_there { stayed_s + PERIOD_S } else { 0.0 };
        }
        out.reached = stayed_s >= STAYS_S;
        out
    }

    /// Displaces every joint by noise.
    fn with_noise(mut self, numbers: &mut Numbers) -> Self {
        self.start.iter_mut().for_each(|q| *q += NOISE_RAD * numbers.next());
        self
    }
}

/// The UR5e with its rotors, and its limits.
fn ur5e() -> (Model, JointLimits) {
    let mut model =
        Model::from_urdf(include_str!("../../../../robots/ur5e/ur5e.urdf")).expect("the URDF").model;
    model.add_frame("hand", Some(5), Placement::from_rpy([0.0; 3], [0.0; 3]));
    let model = model.with_rotor_inertia(&[0.714, 0.714, 0.714, 0.255, 0.255, 0.255]);
    let limits = JointLimits::of(&model);
    (model, limits)
}

/// Determinant of the Jacobian of six joints.
fn determinant(model: &Model, q: &[f64]) -> f64 {
    let (data, _) = at_state(model, q, &vec![0.0; q.len()], 0.0);
    common::jacobian(model, &data, "hand").determinant()
}

/// A pose of six joints that becomes exactly singular by moving one joint from the pose `q`.
fn singular_pose(model: &Model, mut q: Vec<f64>, joint: usize) -> Option<Vec<f64>> {
    let at = |k: usize| -2.4 + 0.08 * k as f64;
    let mut sign_at = |x: f64| {
        q[joint] = x;
        determinant(model, &q) > 0.0
    };
    let signs: Vec<bool> = (0..=60).map(|k| sign_at(at(k))).collect();
    let k = (1..=60).find(|&k| signs[k] != signs[k - 1])?;
    let (mut low, mut high) = (at(k - 1), at(k));
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if sign_at(middle) == signs[k] { high = middle } else { low = middle }
    }
    q[joint] = high;
    Some(q)
}

/// A singular pose of an arm of six joints, found by moving `joint`, and a goal along the lost direction, on the side to
/// which the null space curves. `size` is the length of the longest way, m and rad.
fn six_joints(
    (model, limits): (Model, JointLimits),
    numbers: &mut Numbers,
    joint: usize,
    size: f64,
) -> Option<Case> {
    let start = singular_pose(&model, numbers.vector(6, 2.0), joint)?;
    let (data, _) = at_state(&model, &start, &[0.0; 6], 0.0);
    let j = common::jacobian(&model, &data, "hand");
    let weakest = |matrix: nalgebra::DMatrix<f64>| -> DVector<f64> {
        let spectrum = SymmetricEigen::new(matrix);
        spectrum.eigenvectors.column(spectrum.eigenvalues.imin()).into_owned()
    };
    let (u, s) = (weakest(&j * j.transpose()), weakest(j.transpose() * &j));
    let moved: Vec<f64> = start.iter().zip(&s).map(|(q, s)| q + 1e-4 * s).collect();
    let (data, _) = at_state(&model, &moved, &[0.0; 6], 0.0);
    let curvature = ((common::jacobian(&model, &data, "hand") - j).transpose() * &u).dot(&s);
    let way = size * numbers.between(0.2, 1.0) * if curvature < 0.0 { -1.0 } else { 1.0 };
    let goal = Vector6::from_fn(|i, _| way * u[i]);
    Some(Case { model, limits, start, goal, axes: POSE, priority: "\"hand\"", others: "" })
}

/// The pose in which the hand of an arm is farthest from a point, found by gradient ascent from a random one, and the
/// direction to the hand.
fn stretched(model: &Model, from: &Vector3<f64>, numbers: &mut Numbers) -> (Vec<f64>, Vector3<f64>) {
    let (n, hand) = (model.n(), model.frame_id("hand").expect("hand"));
    let (mut q, mut jacobian) = (numbers.vector(n, 1.5), Matrix6xX::zeros(n));
    let mut direction = Vector3::zeros();
    for _ in 0..10_000 {
        let (data, _) = at_state(model, &q, &vec![0.0; n], 0.0);
        direction = (frame_placement(model, &data, hand).translation - from).normalize();
        frame_jacobian(model, &data, hand, &mut jacobian);
        for (q, column) in q.iter_mut().zip(jacobian.column_iter()) {
            *q += direction.dot(&column.fixed_rows::<3>(0));
        }
    }
    (q, direction)
}

/// A random arm of `n` joints that is stretched out, with a goal on the line to its base, or beyond its reach.
fn random_arm(n: usize, numbers: &mut Numbers, outward: bool) -> Case {
    let model = any_arm(n, numbers);
    let (data, _) = at_state(&model, &vec![0.0; n], &vec![0.0; n], 0.0);
    let base = frame_placement(&model, &data, model.frame_id("j1").expect("first")).translation;
    let (start, direction) = stretched(&model, &base, numbers);
    let limits = JointLimits {
        lower: start.iter().map(|q| q - 2.0).collect(),
        upper: start.iter().map(|q| q + 2.0).collect(),
        velocity: vec![3.0; n],
        torque: vec![150.0; n],
        ..JointLimits::none(n)
    };
    let way = direction * numbers.between(0.02, 0.2) * if outward { 1.0 } else { -1.0 };
    let goal = Vector6::new(way.x, way.y, way.z, 0.0, 0.0, 0.0);
    let others = REST;
    Case { model, limits, start, goal, axes: POSITION, priority: "\"hand\", \"rest\"", others }
}

/// A planar arm of three or four joints along a line, with a goal on this line.
fn planar(n: usize, numbers: &mut Numbers, outward: bool) -> Case {
    const NAMES: [&str; 4] = ["j1", "j2", "j3", "j4"];
    let links: Vec<Link> = (0..n)
        .map(|i| Link {
            name: NAMES[i],
            axis: [0.0, 1.0, 0.0],
            origin: [0.0, 0.0, if i == 0 { 0.0 } else { 0.4 }],
            mass: 3.0 - 0.5 * i as f64,
            com: [0.0, 0.0, 0.2],
            inertia: [0.04; 3],
            limits: [-2.8, 2.8],
            rotor: 0.1,
        })
        .collect();
    let model = arm(&links, &[("hand", n - 1, [0.0, 0.0, 0.3])], 1.0);
    let limits = JointLimits { velocity: vec![3.0; n], torque: vec![100.0; n], ..JointLimits::of(&model) };
    let mut start = vec![0.0; n];
    start[0] = numbers.between(-1.5, 1.5);
    let way = numbers.between(0.02, 0.25) * if outward { 1.0 } else { -1.0 };
    let goal = Vector6::new(way * start[0].sin(), 0.0, way * start[0].cos(), 0.0, 0.0, 0.0);
    let (priority, others) = if n == 3 { ("\"hand\"", "") } else { ("\"first\", \"hand\"", FIRST) };
    Case { model, limits, start, goal, axes: PLANE, priority, others }
}

/// The Panda without its position limits, stretched out, with a goal nearer to its base.
fn panda(numbers: &mut Numbers) -> Case {
    let mut model =
        Model::from_urdf(include_str!("../../../../robots/panda/panda.urdf")).expect("the URDF").model;
    model.add_frame("hand", Some(6), Placement::from_rpy([0.0; 3], [0.0, 0.0, 0.107]));
    let model = model.with_rotor_inertia(&[0.6, 0.6, 0.5, 0.5, 0.2, 0.2, 0.2]);
    let free = JointLimits::none(7);
    let limits = JointLimits { lower: free.lower, upper: free.upper, ..JointLimits::of(&model) };
    let (start, direction) = stretched(&model, &Vector3::new(0.0, 0.0, 0.333), numbers);
    let way = -direction * numbers.between(0.02, 0.2);
    let goal = Vector6::new(way.x, way.y, way.z, 0.0, 0.0, 0.0);
    Case { model, limits, start, goal, axes: POSITION, priority: "\"hand\", \"rest\"", others: REST }
}

/// An arm whose three wrist axes intersect, the first and the last of them parallel, to be rotated about the axis that is
/// lost.
fn wrist(numbers: &mut Numbers) -> Case {
    let link = |name, axis, z, mass, rotor| Link {
        name,
        axis,
        origin: [0.0, 0.0, z],
        mass,
        com: [0.0, 0.0, 0.5 * z],
        inertia: [0.02; 3],
        limits: [-2.8, 2.8],
        rotor,
    };
    let (roll, pitch) = ([0.0, 0.0, 1.0], [0.0, 1.0, 0.0]);
    let links = [
        link("j1", roll, 0.2, 4.0, 0.5),
        link("j2", pitch, 0.1, 4.0, 0.5),
        link("j3", pitch, 0.4, 3.0, 0.4),
        link("j4", roll, 0.2, 1.5, 0.1),
        link("j5", pitch, 0.2, 1.0, 0.1),
        link("j6", roll, 0.0, 0.5, 0.1),
    ];
    let model = arm(&links, &[("hand", 5, [0.0, 0.0, 0.0])], 1.0);
    let limits = JointLimits { velocity: vec![3.0; 6], torque: vec![100.0; 6], ..JointLimits::of(&model) };
    let start = vec![
        2.0 * numbers.next(),
        numbers.between(-0.5, 0.5),
        numbers.between(0.8, 1.8),
        numbers.next(),
        0.0,
        numbers.next(),
    ];
    let (data, _) = at_state(&model, &start, &[0.0; 6], 0.0);
    let j = common::jacobian(&model, &data, "hand");
    let axis = |joint: usize| j.fixed_view::<3, 1>(3, joint).into_owned();
    let turn = axis(3).cross(&axis(4)) * numbers.between(0.1, 0.8);
    let goal = Vector6::new(0.0, 0.0, 0.0, turn.x, turn.y, turn.z);
    Case { model, limits, start, goal, axes: POSE, priority: "\"hand\"", others: "" }
}

/// Runs the reachable ones of `count` cases, every second one with noise, and checks that limits are kept. Returns how many
/// there are, how many reach their goals, and how many escape.
fn outcomes(count: usize, seed: u64, make: impl Fn(&mut Numbers) -> Option<Case>) -> [usize; 3] {
    let (mut numbers, mut noise) = (Numbers::new(seed), Numbers::new(99));
    let cases: Vec<Case> = (0..count).filter_map(|_| make(&mut numbers)).collect();
    let mut counts = [0; 3];
    for (number, case) in cases.into_iter().filter(Case::is_reachable).enumerate() {
        let case = if number % 2 == 1 { case.with_noise(&mut noise) } else { case };
        let out = case.run(true, LONGEST_S);
        assert!(out.violation < ROUNDING, "case {number}: a limit is exceeded by {}", out.violation);
        counts[0] += 1;
        counts[1] += usize::from(out.reached);
        counts[2] += usize::from(out.escaped_s > 0.0);
    }
    counts
}

/// Compared: the number of goals that are reached within 10 s, with 95 % of the reachable ones, and the number of escapes
/// with a half of them: goals along the lost direction of straight elbows, wrists above shoulders, and screws of wrists.
#[test]
fn six_joints_reach_goals_along_lost_directions() {
    let kinds = [(2, 0.2), (1, 0.2)];
    let [mut cases, mut reached, mut escaped] = [0; 3];
    for (joint, size) in kinds {
        let counts = outcomes(16, 5, |numbers| six_joints(ur5e(), numbers, joint, size));
        (cases, reached, escaped) = (cases + counts[0], reached + counts[1], escaped + counts[2]);
    }
    assert!(cases > 20, "{cases} cases");
    assert!(20 * reached >= 19 * cases, "{reached} of {cases} goals are reached");
    assert!(2 * escaped > cases, "{escaped} of {cases} arms escape");
}

/// Compared: the same with all goals, for planar arms, one of them below a task that holds its first joint, for random
/// redundant arms, and for the Panda, whose postures are held by a task below.
#[test]
fn stretched_arms_reach_goals_towards_their_base() {
    type Make<'a> = &'a dyn Fn(&mut Numbers) -> Case;
    let kinds: [(&str, Make<'_>); 5] = [
        ("planar, three joints", &|numbers| planar(3, numbers, false)),
        ("planar, four joints", &|numbers| planar(4, numbers, false)),
        ("random, six joints", &|numbers| random_arm(6, numbers, false)),
        ("random, seven joints", &|numbers| random_arm(7, numbers, false)),
        ("Panda", &panda),
    ];
    for (name, make) in kinds {
        let counts = outcomes(8, 11, |numbers| Some(make(numbers)));
        assert_eq!(counts, [counts[0]; 3], "{name}: cases, goals reached, escapes");
        assert!(counts[0] > 5, "{name}: {} cases", counts[0]);
    }
}

/// Compared: the same for a wrist with two parallel axes, which the law itself mostly leaves: the rotation has a part that
/// the arm can control.
#[test]
fn aligned_wrist_rotates_about_lost_axis() {
    let [cases, reached, _] = outcomes(10, 3, |numbers| Some(wrist(numbers)));
    assert!(cases > 5 && reached == cases, "{reached} of {cases}");
}

/// Compared: motion, final speed and escapes of stretched arms with goals beyond their reach, with zero.
#[test]
fn arm_stays_at_rest_at_unreachable_goal() {
    let mut numbers = Numbers::new(21);
    for number in 0..12 {
        let case = match number % 4 {
            0 => planar(3, &mut numbers, true),
            1 => planar(4, &mut numbers, true),
            2 => random_arm(6, &mut numbers, true),
            _ => random_arm(7, &mut numbers, true),
        };
        let case = if number % 3 == 2 { case.with_noise(&mut numbers) } else { case };
        let out = case.run(true, 3.0);
        assert!(out.escaped_s == 0.0, "case {number} escapes for {} s", out.escaped_s);
        assert!(out.moved_rad < UNMOVED_RAD, "case {number} moves by {} rad", out.moved_rad);
        assert!(out.speed < AT_REST_RAD_PER_S, "case {number} moves at {} rad/s", out.speed);
    }
}

/// Compared: the same case with and without the option: without it, the arm stays where it is.
#[test]
fn arm_without_option_stays_in_singular_pose() {
    let mut case = planar(3, &mut Numbers::new(4), false);
    // Exactly singular also in floating-point numbers; the arm is upright.
    case.start.fill(0.0);
    case.goal = Vector6::new(0.0, 0.0, -0.1, 0.0, 0.0, 0.0);
    let [with, without] = [true, false].map(|option| case.run(option, 5.0));
    assert!(with.reached && !without.reached);
    assert!(without.moved_rad < ROUNDING && with.moved_rad > MOVED_RAD, "{without:?}");
}

/// Compared: all torques of a motion that passes no singular pose, with and without the option, bit for bit.
#[test]
fn option_changes_nothing_in_regular_poses() {
    let mut case = planar(3, &mut Numbers::new(4), false);
    (case.start[1], case.start[2]) = (0.9, 0.6);
    let [with, without] = [true, false].map(|option| case.run(option, 2.0));
    assert!(with.torques.len() > 1000 && with.torques == without.torques);
}

/// Compared: the acceleration of a joint that a task of higher priority holds, with the one that this task demands, in all
/// cycles, while the task below escapes.
#[test]
fn escape_does_not_affect_task_above() {
    let mut numbers = Numbers::new(31);
    for number in 0..4 {
        let mut case = match number % 2 {
            0 => planar(4, &mut numbers, false),
            _ => random_arm(7, &mut numbers, false),
        };
        (case.priority, case.others) = ("\"first\", \"hand\"", FIRST);
        let out = case.run(true, LONGEST_S);
        assert!(out.reached && out.escaped_s > 0.0, "case {number}: {} s", out.escaped_s);
        let off = out.first_off_rad_per_s2;
        assert!(off < ROUNDING, "case {number}: {off} rad/s²");
    }
}

/// No cycle allocates: neither the search for a way out, nor its preview, nor the escape.
#[test]
fn escape_allocates_nothing() {
    for case in [planar(4, &mut Numbers::new(4), false), random_arm(7, &mut Numbers::new(4), false)] {
        let (model, n) = (&case.model, case.model.n());
        let mut controller = case.controller(true);
        let (mut q, mut dq, mut tau) = (case.start.clone(), vec![0.0; n], vec![0.0; n]);
        let (mut data, mut escaped) = (Data::new(model), 0);
        for cycle in 0..2500 {
            let (seen, measurement) = at_state(model, &q, &dq, f64::from(cycle) * PERIOD_S);
            let input = common::input(model, &seen, &measurement);
            if cycle == 0 {
                controller.start(&input);
            }
            let count = allocations(|| controller.update(&input, &mut tau));
            assert_eq!(count, 0, "in cycle {cycle}");
            escaped += usize::from(sampled(&controller, "hand.escape")[0] != 0.0);
            assert!(update(model, &mut data, &q, &dq));
            aba(model, &mut data, &tau);
            for i in 0..n {
                dq[i] += PERIOD_S * data.ddq[i];
                q[i] += PERIOD_S * dq[i];
            }
        }
        assert!(escaped > 50, "{escaped} cycles of an escape");
    }
}

/// The option of a task whose singular directions are not damped is an error in the file.
#[test]
fn escape_needs_damping() {
    let case = planar(3, &mut Numbers::new(4), false);
    let text = case.text(true).replace("escape =", "singularities = \"plain\"\nescape =");
    let error = common::build_error(&case.model, &text);
    assert_eq!(error.key(), "task.hand.cartesian.escape");
    let unknown = case.text(true).replace("nullspace-step", "jump");
    let message = toml::from_str::<File>(&unknown).expect_err("an unknown value").to_string();
    assert!(message.contains("none") && message.contains("nullspace-step"), "{message}");
}

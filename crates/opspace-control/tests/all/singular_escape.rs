//! Escape from singular poses, as an option: goals along a lost direction are reached, unreachable ones leave the arm at
//! rest, and limits and tasks of higher priority are kept.

use crate::common::{self, File, Link, Numbers, any_arm, arm, at_state, control_context, sampled};
use nalgebra::{DVector, Matrix6xX, SymmetricEigen, Vector3, Vector6};
use opspace_control::{Controller, JointLimits, OperationalSpaceController, orientation};
use opspace_model::{Data, FrameId, Model, Placement, aba, frame_jacobian, frame_placement, update};
use opspace_testing::allocation::allocations;

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

/// What became of a case.
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
    /// Largest motion of the first joint, rad.
    first_moved_rad: f64,
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
            out.first_moved_rad = out.first_moved_rad.max((q[0] - self.start[0]).abs());
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

/// The Panda without the position limits that keep its elbow from being straight, with an exactly straight elbow, and a goal
/// nearer to its shoulder.
fn straight_panda(numbers: &mut Numbers) -> Case {
    let mut model =
        Model::from_urdf(include_str!("../../../../robots/panda/panda.urdf")).expect("the URDF").model;
    model.add_frame("hand", Some(6), Placement::from_rpy([0.0; 3], [0.0, 0.0, 0.107]));
    let model = model.with_rotor_inertia(&[0.6, 0.6, 0.5, 0.5, 0.2, 0.2, 0.2]);
    let free = JointLimits::none(7);
    let limits = JointLimits { lower: free.lower, upper: free.upper, ..JointLimits::of(&model) };
    let start = vec![
        2.0 * numbers.next(),
        numbers.between(0.3, 1.0),
        numbers.next(),
        // The offsets of the elbow, 82.5 mm, between links of 316 and 384 mm.
        (0.0825_f64 / 0.316).atan() + (0.0825_f64 / 0.384).atan(),
        numbers.next(),
        numbers.between(1.0, 2.0),
        numbers.next(),
    ];
    let weakest = |q: &[f64]| {
        let (data, _) = at_state(&model, q, &[0.0; 7], 0.0);
        let j = common::jacobian(&model, &data, "hand");
        let spectrum = SymmetricEigen::new(&j * j.transpose());
        let k = spectrum.eigenvalues.imin();
        (spectrum.eigenvalues[k], spectrum.eigenvectors.column(k).into_owned(), data)
    };
    let (smallest, u, data) = weakest(&start);
    assert!(smallest < 1e-15, "the elbow is straight: {smallest}");
    let place = |name: &str| frame_placement(&model, &data, model.frame_id(name).expect("link")).translation;
    let inward = place("link3") - place("link5");
    let sign = (u[0] * inward.x + u[1] * inward.y + u[2] * inward.z).signum();
    let way = sign * numbers.between(0.03, 0.15);
    let goal = Vector6::from_fn(|i, _| way * u[i]);
    Case { model, limits, start, goal, axes: POSE, priority: "\"hand\", \"rest\"", others: REST }
}

/// Runs the reachable cases, with and without noise, and returns how many there are and how many reach their goals.
fn count(name: &str, cases: impl Iterator<Item = Case>) -> [usize; 3] {
    let mut numbers = Numbers::new(99);
    let mut counts = [0; 3];
    for (number, case) in cases.filter(Case::is_reachable).enumerate() {
        let case = if number % 2 == 1 { case.with_noise(&mut numbers) } else { case };
        let out = case.run(true, LONGEST_S);
        assert!(out.violation < 1e-6, "{name} {number}: a limit is exceeded by {}", out.violation);
        counts[0] += 1;
        counts[1] += usize::from(out.reached);
        counts[2] += usize::from(out.escaped_s > 0.0);
    }
    println!("{name}: {} cases, {} reached, {} escaped", counts[0], counts[1], counts[2]);
    counts
}

#[test]
fn explore() {
    let n: usize = std::env::var("COUNT").map_or(10, |n| n.parse().unwrap());
    let only = std::env::var("ONLY").unwrap_or_default();
    let run = |name: &str, make: &dyn Fn(&mut Numbers) -> Option<Case>| {
        if name.contains(&only) {
            let mut numbers = Numbers::new(5);
            count(name, (0..n).filter_map(|_| make(&mut numbers)));
        }
    };
    run("ur5e elbow", &|r| six_joints(ur5e(), r, 2, 0.2));
    run("ur5e shoulder", &|r| six_joints(ur5e(), r, 1, 0.2));
    run("ur5e wrist", &|r| six_joints(ur5e(), r, 4, 0.7));
    run("planar 3", &|r| Some(planar(3, r, false)));
    run("planar 4", &|r| Some(planar(4, r, false)));
    run("random 6", &|r| Some(random_arm(6, r, false)));
    run("random 7", &|r| Some(random_arm(7, r, false)));
    run("panda", &|r| Some(straight_panda(r)));
}

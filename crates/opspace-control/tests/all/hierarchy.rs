//! Random task sets on random arms: the effects of each level on itself and on the others, computed by forward dynamics
//! (the articulated-body algorithm) and by the formulas in this file.

use crate::common::{
    self, File, Numbers, accelerations, any_arm, at_state, control_context, jacobian, sampled, six,
};
use nalgebra::{DMatrix, DVector, Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3, Vector6};
use opspace_control::{Controller, OperationalSpaceController, Reason};
use opspace_model::{
    Data, Model, Placement, center_of_mass, com_bias_acceleration, com_jacobian, com_velocity,
    frame_bias_acceleration, frame_placement, frame_velocity,
};
use std::f64::consts::TAU;
use std::fmt::Write;

/// Tolerance of an acceleration or a torque that is computed in two ways, relative to the largest joint acceleration or
/// torque; both invert matrices with condition numbers of up to 1e4.
const ROUNDING: f64 = 1e-9;

/// Tolerance of two formulas for the same power, relative to the sum of the magnitudes of their terms.
const POWER: f64 = 1e-10;

/// Least ratio of the smallest to the largest singular value of all stacked rows in a regular state: its square is
/// compatible with [`ROUNDING`].
const REGULAR: f64 = 0.02;

/// Smallest effect that counts: far above rounding, far below the accelerations that the tasks desire (1 to 100).
const EFFECT: f64 = 1e-3;

/// Number of regular task sets in each test.
const COUNT: usize = 400;

/// Time of the state in which the law is evaluated, s after the start: the sinusoids are faded in by then.
const TIME_S: f64 = 0.37;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Mode {
    Motion,
    Compliant,
    Free,
}

#[derive(Clone, Debug)]
enum What {
    Frame(&'static str),
    Relative(&'static str, &'static str),
    CenterOfMass,
    Joints(Vec<usize>),
}

#[derive(Clone, Copy, Debug)]
enum Lie {
    World,
    Rpy([f64; 3]),
    TaskFrame,
    Base,
    Of(&'static str),
}

/// Description of a task, from which both the file and the expected values are computed.
#[derive(Clone, Debug)]
struct Task {
    name: String,
    what: What,
    lie: Lie,
    modes: [Mode; 6],
    omega: f64,
    zeta: f64,
    compliance: f64,
    /// Axis (0 to 2), amplitude (m) and frequency (Hz).
    wave: (usize, f64, f64),
}

/// Rows of a task in a state.
struct TaskLaw {
    /// J and J̇ q̇.
    jacobian: DMatrix<f64>,
    bias: DVector<f64>,
    /// Desired acceleration a*.
    wanted: DVector<f64>,
    /// Acceleration of the reference; `None` for compliant rows.
    reference: Vec<Option<f64>>,
}

/// The task of all joints below the other tasks.
#[derive(Clone, Copy, Debug)]
enum Rest {
    Nothing,
    Damping(f64),
    Posture(f64, f64),
    Tracking(f64, f64),
}

const AXES: [&str; 6] = ["x", "y", "z", "rx", "ry", "rz"];

impl Task {
    fn random(name: String, model: &Model, numbers: &mut Numbers) -> Self {
        let n = model.n();
        let what = match numbers.below(8) {
            0..4 => What::Frame(["hand", "mid", "hand", "wrist"][numbers.below(4)]),
            4 => What::Relative("hand", "mid"),
            5 => What::Relative(["wrist", "mid"][numbers.below(2)], "base"),
            6 => What::CenterOfMass,
            _ => {
                let first = numbers.below(n - 1);
                What::Joints((first..n).step_by(1 + numbers.below(3)).take(1 + numbers.below(3)).collect())
            }
        };
        let lie = match numbers.below(5) {
            0 => Lie::World,
            1 => Lie::Rpy(numbers.vector3(1.5).into()),
            2 => Lie::TaskFrame,
            3 => Lie::Base,
            _ => Lie::Of(["mid", "hand", "j2"][numbers.below(3)]),
        };
        let mut modes = [Mode::Free; 6];
        for mode in &mut modes[..3] {
            *mode = [Mode::Motion, Mode::Compliant, Mode::Motion, Mode::Free, Mode::Free, Mode::Free]
                [numbers.below(6)];
        }
        if n >= 6 && !matches!(what, What::CenterOfMass) {
            match numbers.below(4) {
                0 => modes[3..].fill(Mode::Motion),
                1 => modes[3 + numbers.below(3)] = Mode::Motion,
                2 => modes[3 + numbers.below(3)] = Mode::Compliant,
                _ => {}
            }
        }
        Self {
            name,
            what,
            lie,
            modes,
            omega: numbers.between(5.0, 15.0),
            zeta: numbers.between(0.4, 1.2),
            // Fixed for the centre of mass.
            compliance: 2.0,
            wave: (numbers.below(3), numbers.between(0.01, 0.1), numbers.between(0.3, 1.5)),
        }
    }

    fn rows(&self) -> usize {
        match &self.what {
            What::Joints(joints) => joints.len(),
            _ => self.active_axes().count(),
        }
    }

    fn active_axes(&self) -> impl Iterator<Item = usize> + '_ {
        (0..6).filter(|&axis| self.modes[axis] != Mode::Free)
    }

    fn text(&self) -> String {
        let Self { name, omega, zeta, .. } = self;
        let gains = format!("gains = {{ frequency_rad_per_s = {omega:e}, damping_ratio = {zeta:e} }}\n");
        if let What::Joints(joints) = &self.what {
            let names: Vec<String> = joints.iter().map(|j| format!("\"j{}\"", j + 1)).collect();
            let joints = names.join(", ");
            return format!(
                "[task.{name}.joint-tracking]\njoints = [{joints}]\nreference = \"hold\"\n{gains}"
            );
        }
        let mut text = match &self.what {
            What::CenterOfMass => format!("[task.{name}.center-of-mass]\n"),
            What::Frame(frame) => format!("[task.{name}.cartesian]\nframe = \"{frame}\"\n"),
            What::Relative(frame, from) => {
                format!("[task.{name}.cartesian]\nframe = \"{frame}\"\nrelative_to = \"{from}\"\n")
            }
            What::Joints(_) => String::new(),
        };
        let mode = |axis: usize| if self.modes[axis] == Mode::Motion { "motion" } else { "compliant" };
        let axes: Vec<String> =
            self.active_axes().map(|a| format!("{} = \"{}\"", AXES[a], mode(a))).collect();
        let axes_frame = match self.lie {
            Lie::World => "\"world\"".to_owned(),
            Lie::Base => "\"base\"".to_owned(),
            Lie::TaskFrame => "\"task-frame\"".to_owned(),
            Lie::Of(frame) => format!("{{ frame = \"{frame}\" }}"),
            Lie::Rpy([r, p, y]) => format!("{{ rpy_rad = [{r:e}, {p:e}, {y:e}] }}"),
        };
        let (axis, amplitude, frequency) = self.wave;
        let axis = AXES[axis];
        write!(
            text,
            "axes = {{ {} }}\naxes_frame = {axes_frame}\n{gains}singularity_threshold = 1e-6\n\
             reference.sinusoid = {{ ramp_s = 0.1, {axis} = [{{ amplitude_m = {amplitude:e}, frequency_hz = {frequency:e} }}] }}\n",
            axes.join(", ")
        )
        .expect("a string takes all");
        text
    }

    /// Task axes in the coordinates of the controlled frame.
    fn axes(&self, model: &Model, data: &Data) -> Matrix3<f64> {
        let of = |frame: &str| frame_placement(model, data, model.frame_id(frame).expect("frame")).rotation;
        let seen = |rotation: Matrix3<f64>| match self.what {
            What::Relative(_, from) => of(from).transpose() * rotation,
            _ => rotation,
        };
        match (self.lie, &self.what) {
            (Lie::World, _) | (Lie::TaskFrame, What::CenterOfMass | What::Joints(_)) => Matrix3::identity(),
            (Lie::Rpy([r, p, y]), _) => *Rotation3::from_euler_angles(r, p, y).matrix(),
            (Lie::TaskFrame, What::Frame(frame) | What::Relative(frame, _)) => seen(of(frame)),
            (Lie::Base, _) => seen(of("base")),
            (Lie::Of(frame), _) => seen(of(frame)),
        }
    }

    /// Pose, velocity, J and J̇ q̇ of the controlled frame, in its coordinates.
    fn motion(&self, model: &Model, data: &Data) -> (Placement, Vector6<f64>, DMatrix<f64>, Vector6<f64>) {
        let id = |frame: &str| model.frame_id(frame).expect("frame");
        match &self.what {
            What::Frame(frame) => (
                frame_placement(model, data, id(frame)),
                six(&frame_velocity(model, data, id(frame))),
                jacobian(model, data, frame),
                six(&frame_bias_acceleration(model, data, id(frame))),
            ),
            What::CenterOfMass => {
                let mut rows = nalgebra::Matrix3xX::zeros(model.n());
                com_jacobian(model, &mut data.clone(), &mut rows);
                let mut jacobian = DMatrix::zeros(6, model.n());
                jacobian.rows_mut(0, 3).copy_from(&rows);
                let linear = |v: Vector3<f64>| Vector6::new(v.x, v.y, v.z, 0.0, 0.0, 0.0);
                (
                    Placement {
                        rotation: Matrix3::identity(),
                        translation: center_of_mass(model, data).expect("mass"),
                    },
                    linear(com_velocity(model, data)),
                    jacobian,
                    linear(com_bias_acceleration(model, data)),
                )
            }
            What::Relative(frame, from) => {
                // p = Rᵀ r, where r is the vector between the origins in the world, differentiated twice by the product
                // rule.
                let place = |frame: &str| frame_placement(model, data, id(frame));
                let speed = |frame: &str| frame_velocity(model, data, id(frame));
                let bias = |frame: &str| frame_bias_acceleration(model, data, id(frame));
                let turned = place(from).rotation.transpose();
                let (omega, alpha) = (speed(from).angular, bias(from).angular);
                let r = place(frame).translation - place(from).translation;
                let (dr, ddr) =
                    (speed(frame).linear - speed(from).linear, bias(frame).linear - bias(from).linear);
                let (w, dw) = (speed(frame).angular - omega, bias(frame).angular - alpha);
                let seen = dr - omega.cross(&r);
                let linear = ddr - alpha.cross(&r) - omega.cross(&dr) - omega.cross(&seen);
                let both = |linear: Vector3<f64>, angular: Vector3<f64>| {
                    let (v, w) = (turned * linear, turned * angular);
                    Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
                };
                let (of_frame, of_from) = (jacobian(model, data, frame), jacobian(model, data, from));
                let mut rows = DMatrix::zeros(6, model.n());
                for (i, mut column) in rows.column_iter_mut().enumerate() {
                    let [f, o] = [&of_frame, &of_from].map(|j| {
                        let part = |row| Vector3::new(j[(row, i)], j[(row + 1, i)], j[(row + 2, i)]);
                        (part(0), part(3))
                    });
                    column.copy_from(&both(f.0 - o.0 - o.1.cross(&r), f.1 - o.1));
                }
                let placement =
                    Placement { rotation: turned * place(frame).rotation, translation: turned * r };
                (placement, both(seen, w), rows, both(linear, dw - omega.cross(&w)))
            }
            What::Joints(_) => unreachable!("joints have no pose"),
        }
    }

    /// Returns the law of the task's rows as if there were no task above.
    fn law(&self, model: &Model, start: &Data, data: &Data) -> TaskLaw {
        let (stiffness, damping) = (self.omega * self.omega, 2.0 * self.zeta * self.omega);
        if let What::Joints(joints) = &self.what {
            let rows = DMatrix::from_fn(joints.len(), model.n(), |r, c| f64::from(u8::from(joints[r] == c)));
            let wanted = joints.iter().map(|&j| stiffness * (start.q[j] - data.q[j]) - damping * data.dq[j]);
            return TaskLaw {
                jacobian: rows,
                bias: DVector::zeros(joints.len()),
                wanted: DVector::from_iterator(joints.len(), wanted),
                reference: vec![Some(0.0); joints.len()],
            };
        }
        let (home, ..) = self.motion(model, start);
        let (pose, velocity, jacobian, bias) = self.motion(model, data);
        let axes = self.axes(model, data);
        let in_axes = |v: &Vector6<f64>| -> Vector6<f64> {
            let (v, w) = (axes.tr_mul(&v.fixed_rows::<3>(0)), axes.tr_mul(&v.fixed_rows::<3>(3)));
            Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
        };
        // The sinusoid is along an axis at its start orientation.
        let (axis, amplitude, frequency) = self.wave;
        let direction = self.axes(model, start).column(axis).into_owned();
        let (w, (sin, cos)) = (TAU * frequency, (TAU * frequency * TIME_S).sin_cos());
        let along = |size: f64| -> Vector6<f64> {
            let v = direction * size;
            in_axes(&Vector6::new(v.x, v.y, v.z, 0.0, 0.0, 0.0))
        };
        let reference_velocity = along(amplitude * w * cos);
        let reference_acceleration = along(-amplitude * w * w * sin);
        let to = home.translation + direction * (amplitude * sin) - pose.translation;
        let turn = axes.transpose() * home.rotation * pose.rotation.transpose() * axes;
        let turning = (3..6).filter(|&i| self.modes[i] == Mode::Motion);
        let angle = match turning.clone().count() {
            1 => {
                // Only the part of the rotation about this axis.
                let q = UnitQuaternion::from_matrix(&turn).into_inner();
                let q = if q.w < 0.0 { -q } else { q };
                let axis = turning.clone().next().expect("one") - 3;
                let about = Quaternion::new(q.w, 0.0, 0.0, q.imag()[axis]).normalize();
                Vector3::ith(axis, 2.0 * about.imag().z.asin())
            }
            _ => Rotation3::from_matrix_unchecked(turn).scaled_axis(),
        };
        let to = axes.tr_mul(&to);
        let error = Vector6::new(to.x, to.y, to.z, angle.x, angle.y, angle.z);
        let (velocity, bias) = (in_axes(&velocity), in_axes(&bias));
        let wanted = |axis: usize| match self.modes[axis] {
            Mode::Motion => {
                reference_acceleration[axis]
                    + damping * (reference_velocity[axis] - velocity[axis])
                    + stiffness * error[axis]
            }
            _ => -self.compliance * velocity[axis],
        };
        let active_axes: Vec<usize> = self.active_axes().collect();
        let (rows, n) = (active_axes.len(), model.n());
        let column = |c: usize| in_axes(&Vector6::from_fn(|r, _| jacobian[(r, c)]));
        let reference =
            |&axis: &usize| (self.modes[axis] == Mode::Motion).then_some(reference_acceleration[axis]);
        TaskLaw {
            jacobian: DMatrix::from_fn(rows, n, |r, c| column(c)[active_axes[r]]),
            bias: DVector::from_fn(rows, |r, _| bias[active_axes[r]]),
            wanted: DVector::from_fn(rows, |r, _| wanted(active_axes[r])),
            reference: active_axes.iter().map(reference).collect(),
        }
    }
}

impl Rest {
    fn random(numbers: &mut Numbers) -> Self {
        let (omega, zeta) = (numbers.between(2.0, 8.0), numbers.between(0.3, 1.0));
        [Self::Nothing, Self::Damping(omega), Self::Posture(omega, zeta), Self::Tracking(omega, zeta)]
            [numbers.below(4)]
    }

    fn text(self) -> String {
        let gains = |w: f64, z: f64| format!("frequency_rad_per_s = {w:e}, damping_ratio = {z:e}");
        match self {
            Self::Nothing => String::new(),
            Self::Damping(d) => format!("[task]\nrest.joint-damping = {{ damping_nms_per_rad = {d:e} }}\n"),
            Self::Posture(w, z) => format!("[task]\nrest.joint-posture = {{ {} }}\n", gains(w, z)),
            Self::Tracking(w, z) => format!(
                "[task]\nrest.joint-tracking = {{ reference = \"hold\", gains = {{ {} }} }}\n",
                gains(w, z)
            ),
        }
    }

    /// Desired joint accelerations without tasks above, rad/s².
    fn desired_acceleration(self, start: &Data, data: &Data) -> DVector<f64> {
        match self {
            // The controller's own damping, and the arm's own velocity-dependent torques.
            Self::Nothing => {
                let torque = &data.gravity - &data.bias;
                let own = data.mass_matrix.clone().cholesky().expect("M is positive definite").solve(&torque);
                own - &data.dq * 10.0
            }
            Self::Damping(d) => {
                let torque = &data.dq * -d;
                data.mass_matrix.clone().cholesky().expect("M is positive definite").solve(&torque)
            }
            Self::Posture(w, z) | Self::Tracking(w, z) => {
                (&start.q - &data.q) * (w * w) - &data.dq * (2.0 * z * w)
            }
        }
    }
}

/// A task set on an arm, the start state and the current one.
struct Case {
    model: Model,
    tasks: Vec<Task>,
    rest: Rest,
    start: Data,
    data: Data,
    /// Laws of the tasks. `wanted` of compliant rows includes what the tasks above do about their deviations.
    laws: Vec<TaskLaw>,
}

/// Returns the joint accelerations of least kinetic energy that give the rows of all tasks these accelerations, as a
/// difference from `rest` (n).
fn least(
    data: &Data,
    laws: &[TaskLaw],
    rest: &DVector<f64>,
    accelerations: impl Fn(&TaskLaw) -> DVector<f64>,
) -> DVector<f64> {
    let (n, m) = (rest.len(), &data.mass_matrix);
    let rows: usize = laws.iter().map(|law| law.jacobian.nrows()).sum();
    // [M Jᵀ; J 0] [q̈; −λ] = [M q̈_rest; a* − J̇ q̇].
    let mut system = DMatrix::zeros(n + rows, n + rows);
    let mut right = DVector::zeros(n + rows);
    system.view_mut((0, 0), (n, n)).copy_from(m);
    right.rows_mut(0, n).copy_from(&(m * rest));
    let mut first = n;
    for law in laws {
        let count = law.jacobian.nrows();
        system.view_mut((first, 0), (count, n)).copy_from(&law.jacobian);
        system.view_mut((0, first), (n, count)).copy_from(&law.jacobian.transpose());
        right.rows_mut(first, count).copy_from(&(accelerations(law) - &law.bias));
        first += count;
    }
    system.full_piv_lu().solve(&right).expect("regular").rows(0, n).into_owned()
}

impl Case {
    /// Creates a case; `None` if the arm cannot perform the tasks or is too close to a singular pose.
    fn random(numbers: &mut Numbers) -> Option<Self> {
        // Arms with more joints are drawn more often, because they allow more levels.
        let n = [4, 5, 6, 7, 8, 8, 9, 9][numbers.below(8)];
        let model = any_arm(n, numbers);
        let mut tasks = Vec::new();
        let mut left = n;
        for level in 0..[1, 2, 3, 4, 4, 4, 4][numbers.below(7)] {
            let task = Task::random(format!("level{level}"), &model, numbers);
            if (1..=left).contains(&task.rows()) {
                left -= task.rows();
                tasks.push(task);
            }
        }
        let rest = Rest::random(numbers);
        let q = numbers.vector(n, 1.5);
        let (start, _) = at_state(&model, &q, &vec![0.0; n], 0.0);
        let q: Vec<f64> = q.iter().map(|q| q + 0.15 * numbers.next()).collect();
        let (data, _) = at_state(&model, &q, &numbers.vector(n, 1.0), TIME_S);
        let laws: Vec<_> = tasks.iter().map(|task| task.law(&model, &start, &data)).collect();
        let mut case = Self { model, tasks, rest, start, data, laws };
        if !case.is_regular() {
            return None;
        }
        case.add_deviations();
        case.is_possible().then_some(case)
    }

    /// Compliant rows are decoupled from the references of the tasks above, but not from their feedback.
    fn add_deviations(&mut self) {
        let zero = DVector::zeros(self.model.n());
        for level in 1..self.laws.len() {
            let (above, rest) = self.laws.split_at_mut(level);
            let law = &mut rest[0];
            let commanded = least(&self.data, above, &zero, |law| law.wanted.clone());
            let intended = least(&self.data, above, &zero, |law| {
                DVector::from_iterator(law.reference.len(), law.reference.iter().map(|a| a.unwrap_or(0.0)))
            });
            let felt = &law.jacobian * (commanded - intended);
            for (row, _) in law.reference.iter().enumerate().filter(|(_, reference)| reference.is_none()) {
                law.wanted[row] += felt[row];
            }
        }
    }

    fn is_regular(&self) -> bool {
        let n = self.model.n();
        let rows: usize = self.laws.iter().map(|law| law.jacobian.nrows()).sum();
        if rows == 0 {
            return false;
        }
        let Some(factor) = self.data.mass_matrix.clone().cholesky() else { return false };
        let mut all = DMatrix::zeros(n, rows);
        let mut first = 0;
        for (task, law) in self.tasks.iter().zip(&self.laws) {
            let half = factor.l().solve_lower_triangular(&law.jacobian.transpose()).expect("regular");
            all.columns_mut(first, half.ncols()).copy_from(&half);
            // The mobility that the levels above leave to the joints must exceed the damping threshold of joint tasks,
            // which cannot be configured.
            if matches!(task.what, What::Joints(_)) && first > 0 {
                let above = all.columns(0, first).into_owned();
                let Some(inverse) = (above.tr_mul(&above)).try_inverse() else { return false };
                let left = &half - &above * inverse * above.tr_mul(&half);
                let least = left.tr_mul(&left).symmetric_eigenvalues().min();
                if least < 2e-3 * half.norm_squared() {
                    return false;
                }
            }
            first += half.ncols();
        }
        let values = all.singular_values();
        values.min() > REGULAR * values.max()
    }

    fn is_possible(&self) -> bool {
        let Some(ran) = self.run(self.tasks.len(), true) else { return false };
        (self.tasks.iter())
            .filter(|task| !matches!(task.what, What::Joints(_)))
            .all(|task| sampled(&ran.controller, &format!("{}.min_singular_gain", task.name)) == [1.0])
    }

    /// Runs the first `levels` of the task set, with or without the task of all joints.
    fn run(&self, levels: usize, with_rest: bool) -> Option<Ran> {
        // Damping of zero: without a joint task, the controller damps what the tasks leave.
        let rest = if with_rest { self.rest } else { Rest::Damping(0.0) };
        let mut names: Vec<String> = self.tasks[..levels].iter().map(|t| format!("\"{}\"", t.name)).collect();
        if !matches!(rest, Rest::Nothing) {
            names.push("\"rest\"".to_owned());
        }
        let mut text = format!("priority = [{}]\nlimits.enforce = false\n", names.join(", "));
        text.push_str(&rest.text());
        if names.is_empty() {
            text.push_str("[task]\n");
        }
        self.tasks[..levels].iter().for_each(|task| text.push_str(&task.text()));
        let file = File::read(&text);
        let robot = control_context(&self.model, "hand");
        let mut controller = match OperationalSpaceController::new(&self.model, &file.task_set(), &robot) {
            Ok(controller) => controller,
            Err(error) => {
                let known = matches!(error.reason(), Reason::RankDeficient { .. });
                assert!(known, "{error}\n{text}");
                return None;
            }
        };
        let n = self.model.n();
        let (data, measurement) = at_state(&self.model, self.start.q.as_slice(), &vec![0.0; n], 0.0);
        controller.start(&common::input(&self.model, &data, &measurement));
        Some(self.evaluate(controller, &self.data))
    }

    /// Computes the torques in a state.
    fn evaluate(&self, mut controller: OperationalSpaceController, data: &Data) -> Ran {
        let (data, measurement) = at_state(&self.model, data.q.as_slice(), data.dq.as_slice(), TIME_S);
        let mut tau = vec![0.0; self.model.n()];
        controller.update(&common::input(&self.model, &data, &measurement), &mut tau);
        let ddq = accelerations(&self.model, &data, &tau);
        Ran { controller, tau: DVector::from_vec(tau), ddq }
    }

    /// Returns the acceleration of a task's rows.
    fn task_acceleration(&self, level: usize, ran: &Ran) -> DVector<f64> {
        let law = &self.laws[level];
        &law.jacobian * &ran.ddq + &law.bias
    }
}

struct Ran {
    controller: OperationalSpaceController,
    tau: DVector<f64>,
    ddq: DVector<f64>,
}

/// Returns `count` cases, each with its index among all cases that were drawn.
fn cases(seed: u64, count: usize) -> impl Iterator<Item = (usize, Case)> {
    let mut numbers = Numbers::new(seed);
    (0..40 * count).filter_map(move |i| Case::random(&mut numbers).map(|case| (i, case))).take(count)
}

/// Counts the kinds of cases in the other tests: every kind of task and axes must occur, at the first level and below.
#[test]
fn random_task_sets_cover_every_kind() {
    let mut kinds = std::collections::BTreeMap::new();
    for (_, case) in cases(10, COUNT) {
        let mut saw = |kind: String| *kinds.entry(kind).or_insert(0) += 1;
        saw(format!("{} levels", case.tasks.len()));
        saw(format!("rest: {:?}", case.rest).replace(|c: char| !c.is_alphabetic(), ""));
        for (level, task) in case.tasks.iter().enumerate() {
            let word = |text: String| text.split('(').next().unwrap_or_default().to_owned();
            let place = if level == 0 { "on top" } else { "below" };
            saw(format!("{} {place}", word(format!("{:?}", task.what))));
            if !matches!(task.what, What::Joints(_)) {
                saw(word(format!("{:?}", task.lie)));
                let turns = task.modes[3..].iter().filter(|mode| **mode == Mode::Motion).count();
                saw(format!("{turns} turns"));
            }
        }
    }
    let missing = kinds.values().any(|&count| count < 10);
    // 4 numbers of levels, 4 joint tasks, 4 kinds of tasks at 2 positions, 5 kinds of axes, 0, 1 or 3 rotations.
    assert!(kinds.len() == 24 && !missing, "{kinds:?}");
}

/// Compared: the acceleration of each task in a task set that ends with this task, with that in the whole task set.
#[test]
fn lower_levels_do_not_accelerate_higher_levels() {
    let (mut seen, mut moved) = (0, 0);
    for (i, case) in cases(11, COUNT) {
        let whole = case.run(case.tasks.len(), true).expect("a stack that was possible");
        for level in 0..case.tasks.len() {
            let alone = case.run(level + 1, false).expect("a stack that was possible");
            let size = whole.ddq.amax().max(alone.ddq.amax()).max(1.0);
            let off =
                (case.task_acceleration(level, &whole) - case.task_acceleration(level, &alone)).amax() / size;
            assert!(off < ROUNDING, "case {i}, level {level}: {off} of {size} rad/s²\n{:?}", case.tasks);
            seen += 1;
            moved += usize::from((&whole.ddq - &alone.ddq).amax() > EFFECT * size);
        }
    }
    assert!(
        seen > 200 && 2 * moved > seen,
        "{moved} of {seen} levels had one below them that moved something"
    );
}

/// Compared: the acceleration of every task with a* of its law: the effects of all other levels on it are compensated,
/// except those of feedback above on compliant rows. Without the level's own torque it would differ.
#[test]
fn every_level_follows_its_control_law() {
    let (mut lower, mut disturbed) = (0, 0);
    for (i, case) in cases(12, COUNT) {
        let whole = case.run(case.tasks.len(), true).expect("a stack that was possible");
        for (level, TaskLaw { wanted, .. }) in case.laws.iter().enumerate() {
            let size = whole.ddq.amax().max(wanted.amax()).max(1.0);
            let off = (case.task_acceleration(level, &whole) - wanted).amax() / size;
            assert!(off < ROUNDING, "case {i}, level {level}: {off} of {size}\n{:?}", case.tasks);
            if level > 0 {
                let above = case.run(level, false).expect("a stack that was possible");
                let caused = &case.laws[level].jacobian * &above.ddq;
                lower += 1;
                disturbed += usize::from(caused.amax() > EFFECT * size);
            }
        }
    }
    assert!(lower > 80 && 2 * disturbed > lower, "{disturbed} of {lower} levels were disturbed from above");
}

/// Compared: the torques of a task set with Gauss' principle of least constraint. Among all joint accelerations that
/// give every row its a*, the result is the one nearest, in the metric of M, to the desired one of the task of all
/// joints.
#[test]
fn feasible_task_set_satisfies_gauss_principle() {
    for (i, case) in cases(13, COUNT) {
        let rest = case.rest.desired_acceleration(&case.start, &case.data);
        let ddq = least(&case.data, &case.laws, &rest, |law| law.wanted.clone());
        let expected = &case.data.mass_matrix * ddq + &case.data.bias;
        let tau = case.run(case.tasks.len(), true).expect("a stack that was possible").tau;
        let off = (&tau - &expected).amax() / expected.amax().max(1.0);
        assert!(off < ROUNDING, "case {i}: off by {off} of {expected}\n{:?} {:?}", case.tasks, case.rest);
    }
}

/// Compared: the power of the torques that a level adds, in a motion that does not move the levels above, with the
/// power of the level's force in the motion of its axes.
#[test]
fn task_torque_power_equals_task_force_power() {
    let (mut seen, mut lower) = (0, 0);
    let mut numbers = Numbers::new(15);
    for (i, case) in cases(14, COUNT) {
        let n = case.model.n();
        let level = numbers.below(case.tasks.len());
        if matches!(case.tasks[level].what, What::Joints(_)) {
            continue;
        }
        // A random velocity without the part that moves the tasks above.
        let mut dq = DVector::from_vec(numbers.vector(n, 1.0));
        let above: usize = case.laws[..level].iter().map(|law| law.jacobian.nrows()).sum();
        if above == n {
            continue;
        }
        let mut rows = DMatrix::zeros(above, n);
        let mut first = 0;
        for TaskLaw { jacobian, .. } in &case.laws[..level] {
            rows.rows_mut(first, jacobian.nrows()).copy_from(jacobian);
            first += jacobian.nrows();
        }
        if above > 0 {
            let inverse = (&rows * rows.transpose()).try_inverse().expect("regular");
            dq -= rows.transpose() * (inverse * (&rows * &dq));
        }
        let (state, _) = at_state(&case.model, case.data.q.as_slice(), dq.as_slice(), TIME_S);
        let run = |levels: usize| {
            let ran = case.run(levels, false).expect("a stack that was possible");
            case.evaluate(ran.controller, &state)
        };
        let with = run(level + 1);
        let added = if level > 0 { &with.tau - run(level).tau } else { &with.tau - &state.bias };
        let force = sampled(&with.controller, &format!("{}.force", case.tasks[level].name));
        let velocity = &case.laws[level].jacobian * &dq;
        let of_force: Vec<f64> =
            case.tasks[level].active_axes().zip(velocity.iter()).map(|(axis, v)| force[axis] * v).collect();
        let size = with.tau.component_mul(&dq).abs().sum() + of_force.iter().map(|p| p.abs()).sum::<f64>();
        let (in_joints, active_axes) = (added.dot(&dq), of_force.iter().sum::<f64>());
        let off = (in_joints - active_axes).abs() / size.max(1.0);
        assert!(
            off < POWER,
            "case {i}, level {level}: {in_joints} W in the joints, {active_axes} W in the task"
        );
        seen += 1;
        lower += usize::from(level > 0);
    }
    assert!(seen > 60 && lower > 20, "{seen} levels, {lower} of them below others");
}

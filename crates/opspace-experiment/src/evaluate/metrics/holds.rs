//! Causes that hold a task away from its reference, at one state of a run.
//!
//! A task at rest is held if the commanded joint accelerations α = M⁻¹ (τ − h) hardly accelerate it towards its
//! reference, although its feedback demands it: k e · (J α + J̇ q̇) is a small part of |k e|². Friction and contact do not
//! hold a task in this sense: there the command demands the motion, but the robot does not move.

use super::near_pairs::NearPairs;
use crate::evaluate::direction::direction;
use crate::run::experiment::Experiment;
use nalgebra::{DMatrix, DVector, Matrix6xX, SymmetricEigen, Vector6};
use opspace_backend::GravityCompensation;
use opspace_control::tasks::task::DEFAULT_INVERSION;
use opspace_control::{Task, TaskSet};
use opspace_model::{Data, OperationalSpace, update};

/// Largest fraction of the demanded acceleration that the command of a held task contains, and largest gain of a
/// direction that counts as lost.
const HELD: f64 = 0.5;

/// Least acceleration that limits take from a task that they hold back from a moving reference, relative to the spring term of
/// its feedback.
const LEAST_TAKEN: f64 = 0.1;

/// Highest speed of a task at rest in its rows, m/s (rotations are scaled to m), or of a joint, rad/s or m/s.
pub(super) const MAX_SPEED: f64 = 0.05;

/// Largest ratio of damping to spring in the feedback of a task at rest.
const AT_REST: f64 = 0.3;

/// Largest distance of a joint at rest from the position limit that holds it, rad or m: model errors and friction keep
/// it away from there.
const AT_LIMIT: f64 = 0.1;

/// Smallest effect of a joint's limit on a task, relative to the joint with the largest one.
const MIN_EFFECT: f64 = 0.1;

/// Largest number of iterations of a decomposition: finite matrices of six rows need some fifty.
const MAX_ITERATIONS: usize = 1000;

/// Measurements and commands of a control cycle; all slices have n elements.
pub(super) struct Cycle<'a> {
    pub(super) q: &'a [f64],
    pub(super) dq: &'a [f64],
    /// Torque that the controller commanded, without friction compensation, Nm or N.
    pub(super) torque: &'a [f64],
    /// True for each joint whose torque or torque rate is at a bound.
    pub(super) at_torque: &'a [bool],
    /// True for each joint whose acceleration is at a bound.
    pub(super) at_acceleration: &'a [bool],
}

/// Error of a row of a task that follows a reference, in the unit of the row.
pub(super) type RowErrors = [Option<f64>; 6];

/// Causes that hold a task.
#[derive(Clone, Debug, Default)]
pub(super) struct Hold {
    /// Joints at their position limits.
    pub(super) position: Vec<usize>,
    /// Joints at their speed or acceleration limits.
    pub(super) speed: Vec<usize>,
    /// Joints at their limits of torque or torque rate.
    pub(super) torque: Vec<usize>,
    /// Pairs of links or obstacles whose distance is kept.
    pub(super) distances: Vec<usize>,
    /// Direction of the error, along which the arm is nearly singular.
    pub(super) singular_along: Option<String>,
    /// Places of the tasks of higher priority.
    pub(super) overridden_by: Vec<usize>,
}

impl Hold {
    /// Returns true if a limit of a joint is among the causes.
    pub(super) fn is_at_limits(&self) -> bool {
        [&self.position, &self.speed, &self.torque].iter().any(|joints| !joints.is_empty())
    }

    /// Adds the causes of another part of the same task.
    pub(super) fn merge(&mut self, other: Self) {
        let lists = [
            (&mut self.position, other.position),
            (&mut self.speed, other.speed),
            (&mut self.torque, other.torque),
            (&mut self.distances, other.distances),
            (&mut self.overridden_by, other.overridden_by),
        ];
        for (list, added) in lists {
            for item in added {
                if !list.contains(&item) {
                    list.push(item);
                }
            }
        }
        self.singular_along = self.singular_along.take().or(other.singular_along);
    }
}

/// Returns the joints that inverse kinematics clips in a cycle, at the positions `q` (n): those with a bit in `limited` (n).
/// A joint near an end of its range is at a position limit.
pub(super) fn clipped(experiment: &Experiment, q: &[f64], limited: &[f64]) -> Hold {
    let mut hold = Hold::default();
    let margin = experiment.task().file.limits.position_margin_rad.get();
    for (joint, link) in experiment.robot().model.joints().iter().enumerate() {
        let (lower, upper) = (link.limits.lower + margin, link.limits.upper - margin);
        let is_near = upper - q[joint] < AT_LIMIT || q[joint] - lower < AT_LIMIT;
        if limited[joint] > 0.0 {
            if is_near { hold.position.push(joint) } else { hold.speed.push(joint) }
        }
    }
    hold
}

/// Returns true if limits take a considerable acceleration `taken` from a joint with the spring term `wanted`, rad/s² or m/s².
pub(super) fn is_taken(wanted: f64, taken: f64) -> bool {
    wanted != 0.0 && taken.abs() > LEAST_TAKEN * wanted.abs()
}

/// State of the arm in a control cycle.
pub(super) struct HeldState<'a> {
    experiment: &'a Experiment,
    data: Data,
    /// Commanded joint accelerations (n).
    alpha: DVector<f64>,
    /// Velocities of the joints (n).
    dq: DVector<f64>,
    q: DVector<f64>,
    at_acceleration: Vec<bool>,
    at_torque: Vec<bool>,
    /// Pairs at the distance that the controller keeps; `None` if it keeps none.
    near: Option<NearPairs<'a>>,
}

impl<'a> HeldState<'a> {
    pub(super) fn new(experiment: &'a Experiment) -> Self {
        let model = &experiment.robot().model;
        let zero = DVector::zeros(model.n());
        Self {
            experiment,
            data: Data::new(model),
            alpha: zero.clone(),
            dq: zero.clone(),
            q: zero,
            at_acceleration: Vec::new(),
            at_torque: Vec::new(),
            near: NearPairs::new(experiment),
        }
    }

    /// Computes the state of a cycle; returns false if it is not finite.
    pub(super) fn update(&mut self, cycle: &Cycle<'_>) -> bool {
        let model = &self.experiment.robot().model;
        if !update(model, &mut self.data, cycle.q, cycle.dq) {
            return false;
        }
        self.q.copy_from_slice(cycle.q);
        self.dq.copy_from_slice(cycle.dq);
        self.at_acceleration = cycle.at_acceleration.to_vec();
        self.at_torque = cycle.at_torque.to_vec();
        self.alpha.copy_from_slice(cycle.torque);
        self.alpha -= &self.data.bias;
        if self.experiment.robot().file.interface.gravity_compensated_by == GravityCompensation::Robot {
            self.alpha += &self.data.gravity;
        }
        self.data.mass_matrix_factor.solve(self.alpha.as_mut_slice());
        if let Some(near) = &mut self.near {
            near.update(model, &self.data);
        }
        self.alpha.iter().all(|a| a.is_finite())
    }

    /// Inertia of a joint with all others at rest, kg m² or kg.
    pub(super) fn inertia(&self, joint: usize) -> f64 {
        self.data.mass_matrix[(joint, joint)]
    }

    /// Returns the causes for each task of at most six rows, `None` for one that is not held. `errors` has the errors of
    /// each task, in order of priority.
    pub(super) fn of_tasks(&self, set: &TaskSet, errors: &[RowErrors]) -> Vec<Option<Hold>> {
        let n = self.q.len();
        let mut freedom: DMatrix<f64> = DMatrix::identity(n, n);
        // Null space of the tasks above each task.
        let mut spaces: Vec<DMatrix<f64>> = Vec::new();
        let mut holds = Vec::new();
        for ((task, typical), errors) in set.tasks().zip(set.typical_mobilities()).zip(errors) {
            spaces.push(freedom.clone());
            let level = self.level(task, typical.dynamic, errors);
            holds.push(level.hold(&spaces));
            level.reduce(&mut freedom);
        }
        holds
    }

    fn level<'b>(&'b self, task: &'b dyn Task, typical: f64, errors: &RowErrors) -> Level<'b> {
        let model = &self.experiment.robot().model;
        let mut jacobian = Matrix6xX::zeros(self.q.len());
        task.jacobian(model, &self.data, &mut jacobian);
        let velocity = &jacobian * &self.dq;
        let (mut wanted, mut damping) = (Vector6::zeros(), Vector6::zeros());
        for row in 0..task.rows() {
            let (Some(error), Some(gains)) = (errors[row], task.gains(row)) else { continue };
            wanted[row] = gains.stiffness_per_s2 * error * task.row_unit(row).1;
            damping[row] = gains.damping_per_s * velocity[row];
        }
        let commanded = &jacobian * &self.alpha + task.bias(model, &self.data);
        let speed = velocity.norm();
        Level { state: self, task, typical, jacobian, speed, wanted, damping, commanded }
    }

    /// Returns what keeps a task of at most six rows from a moving reference: the limits that take the accelerations `taken`
    /// from its rows, and the direction of its errors, if the arm is nearly singular along it. `place` is the place of the
    /// task in the set.
    pub(super) fn of_moving_task(
        &self,
        set: &TaskSet,
        place: usize,
        errors: &RowErrors,
        taken: &Vector6<f64>,
    ) -> Hold {
        let n = self.q.len();
        let mut freedom: DMatrix<f64> = DMatrix::identity(n, n);
        let mut hold = Hold::default();
        for (k, (task, typical)) in set.tasks().zip(set.typical_mobilities()).enumerate() {
            let level = self.level(task, typical.dynamic, if k == place { errors } else { &NO_ERRORS });
            if k < place {
                level.reduce(&mut freedom);
                continue;
            }
            if level.wanted.norm() > 0.0 && level.gain(&DMatrix::identity(n, n)) < HELD {
                let error = level.wanted.normalize();
                hold.singular_along = Some(direction(error.as_slice(), &task.row_names()));
            }
            if taken.norm() > LEAST_TAKEN * level.wanted.norm() && taken.norm() > 0.0 {
                let zero = Vector6::zeros();
                let level = Level { wanted: *taken, damping: zero, commanded: zero, ..level };
                level.add_limits(&freedom, &mut hold);
            }
            break;
        }
        hold
    }

    /// Direction in which a task can be moved least, below the tasks above it; `place` is the place of the task in the set.
    pub(super) fn weakest_direction(&self, set: &TaskSet, place: usize) -> Option<String> {
        let n = self.q.len();
        let mut freedom: DMatrix<f64> = DMatrix::identity(n, n);
        for (k, (task, typical)) in set.tasks().zip(set.typical_mobilities()).enumerate() {
            let level = self.level(task, typical.dynamic, &NO_ERRORS);
            if k == place {
                return level.weakest_direction(&freedom);
            }
            level.reduce(&mut freedom);
        }
        None
    }

    /// Returns the limits that take accelerations `taken` from a task of all joints with the spring terms `wanted` (n; rad/s²
    /// or m/s²).
    pub(super) fn of_moving_joints(&self, wanted: &[f64], taken: &[f64]) -> Hold {
        let mut hold = Hold::default();
        let push = DVector::from_column_slice(taken);
        for (joint, (wanted, taken)) in wanted.iter().zip(taken).enumerate() {
            if is_taken(*wanted, *taken) {
                self.add_limit(joint, &push, &mut hold);
            }
        }
        hold
    }

    /// Returns the causes for each joint of a task of all joints. `wanted` and `damping` are the spring and damper terms
    /// of its feedback (n; rad/s² or m/s²); `above` is the number of tasks above.
    pub(super) fn of_joints(&self, wanted: &[f64], damping: &[f64], above: usize) -> Vec<Option<Hold>> {
        let push = DVector::from_column_slice(wanted);
        let hold = |joint: usize| {
            let demand = wanted[joint];
            let is_held = demand != 0.0
                && self.dq[joint].abs() <= MAX_SPEED
                && damping[joint].abs() <= AT_REST * demand.abs()
                && self.alpha[joint] * demand.signum() <= HELD * demand.abs();
            if !is_held {
                return None;
            }
            let mut hold = Hold::default();
            self.add_limit(joint, &push, &mut hold);
            let lists = [&hold.position, &hold.speed, &hold.torque, &hold.distances];
            let is_limited = lists.iter().any(|list| !list.is_empty());
            if !is_limited {
                hold.overridden_by = (0..above).collect();
            }
            Some(hold)
        };
        (0..self.q.len()).map(hold).collect()
    }

    /// Adds the limits of a joint that hold a task which pushes the joints with `push` (n).
    fn add_limit(&self, joint: usize, push: &DVector<f64>, hold: &mut Hold) {
        let sign = push[joint].signum();
        if self.at_torque[joint] {
            hold.torque.push(joint);
        } else if self.at_acceleration[joint] {
            if let Some(pair) = self.near.as_ref().and_then(|near| near.against(joint, push)) {
                if !hold.distances.contains(&pair) {
                    hold.distances.push(pair);
                }
                return;
            }
            let limits = &self.experiment.robot().model.joints()[joint].limits;
            let margin = self.experiment.task().file.limits.position_margin_rad.get();
            let end = if sign > 0.0 { limits.upper - margin } else { limits.lower + margin };
            let is_near = (end - self.q[joint]) * sign < AT_LIMIT;
            if is_near { hold.position.push(joint) } else { hold.speed.push(joint) }
        }
    }
}

/// Task of at most six rows at a state.
struct Level<'a> {
    state: &'a HeldState<'a>,
    task: &'a dyn Task,
    typical: f64,
    /// Jacobian of the rows (6 × n).
    jacobian: Matrix6xX<f64>,
    /// Norm of the velocities of the rows.
    speed: f64,
    /// Spring term of the feedback, on the rows that follow a reference.
    wanted: Vector6<f64>,
    /// Damper term of the feedback.
    damping: Vector6<f64>,
    /// Commanded acceleration of the rows.
    commanded: Vector6<f64>,
}

impl Level<'_> {
    /// Returns the causes; `spaces` are the null spaces of the tasks above each task up to this one.
    fn hold(&self, spaces: &[DMatrix<f64>]) -> Option<Hold> {
        let demand = self.wanted.norm();
        let is_held = demand > 0.0
            && self.speed <= MAX_SPEED
            && self.damping.norm() <= AT_REST * demand
            && self.commanded.dot(&self.wanted) <= HELD * demand * demand;
        if !is_held {
            return None;
        }
        let mut hold = Hold::default();
        // The first null space in which the direction of the error is lost.
        let lost = spaces.iter().position(|freedom| self.gain(freedom) < HELD);
        match lost {
            Some(0) => {
                let error = self.wanted / demand;
                hold.singular_along = Some(direction(error.as_slice(), &self.task.row_names()));
            }
            Some(place) => hold.overridden_by.push(place - 1),
            None => {}
        }
        self.add_limits(spaces.last()?, &mut hold);
        Some(hold)
    }

    /// Projected Jacobian, and Λ in the null space `freedom`.
    fn space(&self, freedom: &DMatrix<f64>) -> (Matrix6xX<f64>, OperationalSpace) {
        let product = &self.jacobian * freedom;
        let mut projected = Matrix6xX::zeros(freedom.ncols());
        projected.copy_from(&product);
        let mut space = OperationalSpace::new(freedom.ncols());
        let inversion = self.task.inversion();
        let inversion = if inversion.is_for_control() { inversion } else { DEFAULT_INVERSION };
        let factor = &self.state.data.mass_matrix_factor;
        let (rows, typical) = (self.task.rows(), Some(self.typical));
        space.update_inertia(factor, &projected, rows, inversion, typical, Some(&self.wanted));
        (projected, space)
    }

    /// Part of the demanded acceleration that the damped inverse in the null space `freedom` leaves.
    fn gain(&self, freedom: &DMatrix<f64>) -> f64 {
        let (mut projected, space) = self.space(freedom);
        let mobility = self.state.data.mass_matrix_factor.mobility(&mut projected);
        self.wanted.dot(&(mobility * (space.task_inertia * self.wanted))) / self.wanted.norm_squared()
    }

    /// Direction in which the task can be moved least in the null space `freedom`.
    fn weakest_direction(&self, freedom: &DMatrix<f64>) -> Option<String> {
        let mut projected = Matrix6xX::zeros(freedom.ncols());
        projected.copy_from(&(&self.jacobian * freedom));
        let mobility = self.state.data.mass_matrix_factor.mobility(&mut projected);
        let rows = self.task.rows();
        let mobility = mobility.view((0, 0), (rows, rows)).into_owned();
        let spectrum = SymmetricEigen::try_new(mobility, f64::EPSILON, MAX_ITERATIONS)?;
        let weakest = spectrum.eigenvectors.column(spectrum.eigenvalues.imin());
        Some(direction(weakest.as_slice(), &self.task.row_names()))
    }

    /// Adds the limits of the joints that hold the task: those at a bound that the task's force pushes against. At the
    /// least weighted residual of the task, Jᵀ Λ (a* − J α) is nonzero only at joints whose acceleration is bounded, and
    /// M⁻¹ times it only at joints whose torque is.
    fn add_limits(&self, freedom: &DMatrix<f64>, hold: &mut Hold) {
        let (projected, space) = self.space(freedom);
        let missing = self.wanted - self.damping - self.commanded;
        let push = projected.tr_mul(&(space.task_inertia * missing));
        let mut accelerated = push.clone();
        self.state.data.mass_matrix_factor.solve(accelerated.as_mut_slice());
        // A pair can hold a task without a joint at a bound of its own.
        for pair in self.state.near.iter().flat_map(|near| near.holding(&push)) {
            if !hold.distances.contains(&pair) {
                hold.distances.push(pair);
            }
        }
        let (largest, fastest) = (push.amax(), accelerated.amax());
        for joint in 0..push.len() {
            let is_pushed = push[joint].abs() > MIN_EFFECT * largest;
            let is_driven = accelerated[joint].abs() > MIN_EFFECT * fastest;
            match (self.state.at_torque[joint], self.state.at_acceleration[joint]) {
                (true, _) if is_driven => hold.torque.push(joint),
                (false, true) if is_pushed => self.state.add_limit(joint, &push, hold),
                _ => {}
            }
        }
    }

    /// Removes the task's motion from the null space of the tasks above.
    fn reduce(&self, freedom: &mut DMatrix<f64>) {
        let (projected, mut space) = self.space(freedom);
        space.compute_jbar(&self.state.data.mass_matrix_factor);
        let mut left = DMatrix::zeros(freedom.nrows(), freedom.ncols());
        space.nullspace(&projected, &mut left);
        *freedom = &*freedom * left;
    }
}

/// Norm of the rows of a task in a unit; `None` if the task has no such row.
pub(super) fn norm_in(unit: &str, task: &dyn Task, errors: &RowErrors) -> Option<f64> {
    let rows = (0..task.rows()).filter(|&row| task.row_unit(row).0 == unit);
    let squares: Vec<f64> = rows.filter_map(|row| Some(errors[row]?.powi(2))).collect();
    (!squares.is_empty()).then(|| squares.iter().sum::<f64>().sqrt())
}

/// Errors of a task of which none follows a reference.
pub(super) const NO_ERRORS: RowErrors = [None; 6];

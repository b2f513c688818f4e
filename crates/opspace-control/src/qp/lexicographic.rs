//! Tasks within limits: lexicographic least squares, one level after another.
//!
//! α are the joint accelerations that the task torques M α cause, and |y|²_Λ = yᵀ Λ y. Level k may change α in the null space of the levels
//! above: α = α_above + z + N δ, where z is the level's own demand and δ the change due to the limits. It minimises its
//! residual,
//!
//! ```text
//! min |W J_p δ|²_Λ     a_min ≤ α ≤ a_max,   τ_min ≤ M α + τ_own ≤ τ_max,   d ẋ ≤ ẋ_max
//! ```
//!
//! which the levels below do not change, since J_p N is zero there. W weights errors perpendicular to the task's
//! direction of motion ten times (or as set) as much as errors along it, which only slow the task down; weights of the
//! task's rows multiply Λ on both sides. A [scaled](crate::qp::level_cost) level keeps its direction. A level that limits
//! hold back also has a [resistance](crate::limits::resistance) in its cost. Among solutions with equal residual, proximal
//! steps, min |W J_p δ|²_Λ + ε |δ − δ_before|²_M, select the one nearest to the demand in kinetic energy: if no limit is
//! active, δ is exactly zero. The last level, of all joints, minimises this norm itself, and
//! removes the part of the other levels' δ that does not affect their rows.
//!
//! If the bounds on accelerations and speeds are infeasible, they are first widened as little as possible (least
//! squares; torque bounds are never widened): a joint that starts beyond its position limit returns as hard as its
//! torque allows. Where the widened bounds meet in one point, it is the solution of all levels.
//!
//! Sources: Kanoun, Lamiraux and Wieber, *Kinematic control of redundant manipulators: generalizing the task-priority
//! framework to inequality task*, IEEE T-RO 27(4), 2011; Escande, Mansard and Wieber, *Hierarchical quadratic
//! programming*, IJRR 33(7), 2014.

use crate::algebra::{dot, multiply};
use crate::nullspace::Nullspace;
use crate::qp::active_set::ActiveSet;
use crate::qp::interior_point::InteriorPoint;
use crate::qp::interval::Interval;
use crate::qp::level_cost::{JointSpace, Reducible, add_resistance, scale_rows, weigh_joints};
use crate::qp::quadratic_program::{QpError, QuadraticProgram, axpy};
use nalgebra::{DMatrix, DVector, Matrix6, Matrix6xX, Vector6};
use opspace_model::Data;

/// Speed above which a task has a direction, m/s. It exceeds the velocity noise of a hand at rest, whose random
/// direction would otherwise affect the torques.
const STILL: f64 = 2e-3;

/// ε of the proximal steps, relative to the trace of the task's Hessian with the usual lateral weight.
const PROXIMAL: f64 = 1e-7;

/// Lateral weight for which [`PROXIMAL`] is given: errors along the direction of a task count the same with any weight.
const USUAL_WEIGHT: f64 = 10.0;

/// ε of the proximal steps that widen bounds, relative to slacks of weight 1.
const RELAXED: f64 = 1e-7;

/// Maximum number of proximal steps. One is enough if no limit is active; otherwise each step leaves about 1e-4 of the
/// error in the task's rows.
const STEPS: usize = 3;

/// Relative change of δ below which the steps end.
const SETTLED: f64 = 1e-9;

/// Pivots of Nᵀ M, relative to M's diagonal, that are rounding errors.
const NO_FREEDOM: f64 = 1e-10;

/// Smallest pivot of Nᵀ M, relative to M's diagonal, that is large compared with its rounding error.
const CLEAR: f64 = 1e-6;

/// Largest tolerated deviation of a basis of the null space from orthogonality.
const ORTHOGONAL: f64 = 1e-10;

/// Largest tolerated violation of a bound, relative to its value plus 1.
const SLACK: f64 = 1e-9;

/// Bound on the speed of a task, or on the speed at which two objects approach each other: `row` (n) · α ≤ `upper`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SpeedBound {
    pub row: DVector<f64>,
    pub upper: f64,
}

impl SpeedBound {
    /// Returns true if α respects the bound.
    pub(crate) fn allows(&self, alpha: &[f64]) -> bool {
        dot(self.row.as_slice(), alpha) <= self.upper
    }
}

/// Solver that computed the command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Solver {
    /// No limit was active.
    Unlimited,
    /// Active-set method.
    ActiveSet,
    /// Interior-point method, after the active-set method failed.
    InteriorPoint,
    /// No solver succeeded: the torques were clipped individually.
    Clipped,
}

/// Limits of one control cycle, on α and M α.
pub(crate) struct Limits<'a> {
    /// Bounds on joint accelerations, rad/s² or m/s² (n).
    pub acceleration: &'a mut Interval,
    /// Bounds on commanded torques, Nm or N (n).
    pub torque: &'a mut Interval,
    /// τ_own, the compensation torques that are added to M α, Nm or N (n).
    pub compensation_torque: &'a DVector<f64>,
    /// Joint acceleration in addition to α, rad/s² or m/s² (n).
    pub bias_acceleration: &'a DVector<f64>,
    pub speeds: &'a mut [SpeedBound],
}

impl Limits<'_> {
    /// Returns true if α and the torques M α respect all limits.
    pub(crate) fn allow(&self, alpha: &[f64], torque: &[f64]) -> bool {
        let joints = (0..alpha.len()).all(|i| {
            self.acceleration.contains(i, alpha[i] + self.bias_acceleration[i])
                && self.torque.contains(i, torque[i] + self.compensation_torque[i])
        });
        joints && self.speeds.iter().all(|speed| speed.allows(alpha))
    }
}

/// Buffers of the hierarchical QP for one robot.
pub(crate) struct HierarchicalQp {
    program: QuadraticProgram,
    /// One solver for each [`Problem`], which starts with the rows that were active in the last one.
    active_sets: [ActiveSet; 4],
    /// Second solver; `None` without the feature `clarabel`.
    interior_point: Option<InteriorPoint>,
    /// Error of the active-set method since [`clear_unsolved`](Self::clear_unsolved) that no second solver could correct.
    unsolved: Option<QpError>,
    /// Joint acceleration α of the levels solved so far, rad/s² or m/s² (n).
    alpha: DVector<f64>,
    /// Square roots of M's diagonal, which scale joint accelerations and torques (n).
    scale: Vec<f64>,
    /// Reciprocals of `scale` (n).
    inverse_scale: Vec<f64>,
    /// Number of elements of δ: n; fewer if they are coordinates of the null space in a basis that is orthonormal in
    /// kinetic energy.
    freedom: usize,
    /// Joint accelerations for δ (n × `freedom`): N with its columns divided by `scale`, or the basis.
    nullspace: DMatrix<f64>,
    /// Torques for δ (n × `freedom`): M times `nullspace`.
    torque_rows: DMatrix<f64>,
    /// Intermediate values of the basis (n × n each).
    remaining: DMatrix<f64>,
    basis: DMatrix<f64>,
    /// M, its rows and columns divided by `scale` (n × n).
    mass: DMatrix<f64>,
    torque: DVector<f64>,
    /// Scaled solution δ of the last program (n), followed by its slack variables.
    delta: DVector<f64>,
    /// Σ N δ of the levels solved so far (n).
    displaced: DVector<f64>,
    /// Gradient of the cost at δ = 0, scaled as δ (n).
    pull: DVector<f64>,
    /// Size of the torques of the bounds of the last level.
    held: f64,
    /// Saved α while bounds are widened, or an intermediate value (n).
    asked: DVector<f64>,
    solver: Solver,
    shortcut: bool,
    /// Weight of errors perpendicular to the direction of a task, relative to errors along it.
    lateral_weight: f64,
    /// Largest reduction of a scaled level; the program then has a variable for it.
    reduction: Option<f64>,
}

/// Kind of program.
#[derive(Clone, Copy, Debug)]
enum Problem {
    /// Level of a task of at most six rows.
    Rows,
    /// Level of all joints.
    Joints,
    /// Bounds to be widened.
    Bounds,
    /// Scaled level.
    Scaled,
}

impl Problem {
    fn of(residual: &Residual<'_>) -> Self {
        match residual {
            Residual::ScaledRows { .. } | Residual::WeightedJoints { reducible: Some(_), .. } => Self::Scaled,
            Residual::Rows { .. } => Self::Rows,
            Residual::Joints | Residual::WeightedJoints { .. } => Self::Joints,
        }
    }
}

/// Residual that a level minimises.
pub(crate) enum Residual<'a> {
    /// |W J_p δ|²_Λ; `heading` is the predicted velocity of the task. Unused rows of J_p and Λ are zero.
    /// With a [resistance](crate::limits::resistance) of this weight, relative to errors across the heading, toward these
    /// joint accelerations (n).
    Rows {
        jacobian: &'a Matrix6xX<f64>,
        inertia: &'a Matrix6<f64>,
        heading: Vector6<f64>,
        resistance: Option<(f64, &'a [f64])>,
    },
    /// Rows whose predicted velocity is [reduced](crate::qp::level_cost).
    ScaledRows { jacobian: &'a Matrix6xX<f64>, inertia: &'a Matrix6<f64>, reducible: Reducible<Vector6<f64>> },
    /// |δ|²_M.
    Joints,
    /// |D N δ|²_M with weights D, or joints whose predicted velocity is reduced.
    WeightedJoints { weights: Option<&'a [f64]>, reducible: Option<Reducible<&'a [f64]>> },
}

impl Residual<'_> {
    /// Returns true if the level deviates from its demand even if no limit is active.
    fn resists(&self) -> bool {
        matches!(self, Self::Rows { resistance: Some(_), .. })
    }

    /// Returns true for the level of all joints.
    fn is_of_joints(&self) -> bool {
        matches!(self, Self::Joints | Self::WeightedJoints { .. })
    }
}

impl HierarchicalQp {
    /// Creates the buffers for `n` joints and at most `speeds` speed bounds.
    pub(crate) fn new(n: usize, speeds: usize, lateral_weight: f64) -> Self {
        // A scaled level has a constraint for its reduction.
        let (variables, constraints) = ((2 * n + speeds).max(n + 1), 2 * n + speeds + 1);
        let zero = DVector::zeros(n);
        let square = DMatrix::zeros(n, n);
        Self {
            program: QuadraticProgram::new(variables, constraints),
            active_sets: [n, n, variables, n + 1].map(|variables| ActiveSet::new(variables, constraints)),
            // Clarabel solves what the active-set method cannot: it has another algorithm, so that one error does not
            // stop both. No program of a robot has needed it yet.
            interior_point: InteriorPoint::new(variables, constraints).ok(),
            unsolved: None,
            alpha: zero.clone(),
            scale: vec![1.0; n],
            inverse_scale: vec![1.0; n],
            freedom: n,
            nullspace: square.clone(),
            torque_rows: square.clone(),
            remaining: square.clone(),
            basis: square.clone(),
            mass: square,
            torque: zero.clone(),
            delta: DVector::zeros(variables),
            displaced: zero.clone(),
            pull: zero.clone(),
            held: 0.0,
            asked: zero,
            solver: Solver::Unlimited,
            shortcut: true,
            lateral_weight,
            reduction: None,
        }
    }

    /// Error of the active-set method in this cycle that no second solver could correct, because there is none.
    pub(crate) fn unsolved(&self) -> Option<QpError> {
        self.unsolved
    }

    /// Forgets such an error.
    pub(crate) fn clear_unsolved(&mut self) {
        self.unsolved = None;
    }

    /// Makes the active-set method fail at its first step, with or without a second solver: for tests.
    pub(crate) fn fail_active_sets(&mut self, with_second_solver: bool) {
        self.active_sets.iter_mut().for_each(|solver| solver.most_iterations = 0);
        self.interior_point = self.interior_point.take().filter(|_| with_second_solver);
    }

    /// Enables or disables the shortcut, and returns true if it was enabled. Without it, every level is solved.
    pub(crate) fn replace_shortcut(&mut self, enabled: bool) -> bool {
        std::mem::replace(&mut self.shortcut, enabled)
    }

    /// Returns true if commands within the limits are kept without solving.
    pub(crate) fn has_shortcut(&self) -> bool {
        self.shortcut
    }

    /// Returns true if α and M α need no change.
    fn needs_no(&self, limits: &Limits<'_>, alpha: &[f64], torque: &[f64]) -> bool {
        self.shortcut && limits.allow(alpha, torque)
    }

    /// Resets α and the solver status, and scales M; call it before the first level.
    pub(crate) fn begin(&mut self, data: &Data) {
        self.alpha.fill(0.0);
        self.displaced.fill(0.0);
        self.solver = Solver::Unlimited;
        let n = self.scale.len();
        for (i, (scale, inverse)) in self.scale.iter_mut().zip(&mut self.inverse_scale).enumerate() {
            *scale = data.mass_matrix[(i, i)].sqrt();
            *inverse = 1.0 / *scale;
        }
        let columns = data.mass_matrix.as_slice().chunks_exact(n);
        for ((scaled, column), inverse) in
            self.mass.as_mut_slice().chunks_exact_mut(n).zip(columns).zip(&self.inverse_scale)
        {
            for ((scaled, x), row) in scaled.iter_mut().zip(column).zip(&self.inverse_scale) {
                *scaled = x * (row * inverse);
            }
        }
    }

    /// Joint acceleration α of the levels solved so far, rad/s² or m/s² (n).
    pub(crate) fn alpha(&self) -> &[f64] {
        self.alpha.as_slice()
    }

    /// Writes the torques M α into `torque` (n).
    pub(crate) fn torque_into(&self, data: &Data, torque: &mut [f64]) {
        multiply(&data.mass_matrix, self.alpha.as_slice(), torque);
    }

    /// Solver that computed the command.
    pub(crate) fn solver(&self) -> Solver {
        self.solver
    }

    /// Adds the joint accelerations `z` (n) that a level demands to α.
    pub(crate) fn add_demand(&mut self, data: &Data, z: &[f64], limits: &mut Limits<'_>) {
        // The current α is within the limits up to rounding.
        if self.solver != Solver::Unlimited {
            self.admit(data, limits);
        }
        self.alpha.iter_mut().zip(z).for_each(|(a, z)| *a += z);
    }

    /// Moves the [demand](Self::add_demand) of all joints into the bounds on their accelerations, each joint on its own. In
    /// kinetic energy, a joint at such a bound would share its deviation with the joints that are coupled to it: they would
    /// leave their references. At a torque bound it does not.
    pub(crate) fn clip_demand(&mut self, limits: &mut Limits<'_>) {
        for (i, alpha) in self.alpha.iter_mut().enumerate() {
            let (demanded, own) = (*alpha + limits.bias_acceleration[i], limits.bias_acceleration[i]);
            if limits.acceleration.contains(i, demanded) || demanded.is_nan() {
                continue;
            }
            *alpha = demanded.max(limits.acceleration.lower[i]).min(limits.acceleration.upper[i]) - own;
            // The sum may differ from the bound by its rounding.
            limits.acceleration.include(i, *alpha + own);
            self.solver = self.solver.max(Solver::ActiveSet);
        }
    }

    /// Modifies the [demand](Self::add_demand) of the level to respect the limits, in the null space `above`, and
    /// returns true if a modification was needed.
    ///
    /// # Errors
    /// An error of the solver if no solver succeeds.
    pub(crate) fn solve_level(
        &mut self,
        data: &Data,
        above: &Nullspace,
        residual: &Residual<'_>,
        limits: &mut Limits<'_>,
    ) -> Result<bool, QpError> {
        if residual.is_of_joints() {
            // Removes the part of δ that does not affect the rows of the levels above: no task demands it.
            multiply(&data.mass_matrix, self.displaced.as_slice(), self.torque.as_mut_slice());
            above.project_torque(self.torque.as_mut_slice());
            data.mass_matrix_factor.solve(self.torque.as_mut_slice());
            self.alpha -= &self.torque;
        }
        multiply(&data.mass_matrix, self.alpha.as_slice(), self.torque.as_mut_slice());
        self.held = 0.0;
        if !residual.resists() && self.needs_no(limits, self.alpha.as_slice(), self.torque.as_slice()) {
            return Ok(false);
        }
        let reduced = residual.is_of_joints() && !above.is_empty() && self.reduce(data, above);
        if !(reduced && self.solve_within(residual, limits).is_ok()) {
            self.span(data, above);
            match self.solve_within(residual, limits) {
                Err(QpError::Infeasible { .. }) => {
                    let contradicted = Problem::of(residual);
                    self.start_from_contradiction(contradicted);
                    self.relax(data, limits)?;
                    if self.leaves_one_point(contradicted) {
                        self.pose(residual);
                    } else {
                        self.solve_within(residual, limits)?;
                    }
                }
                result => result?,
            }
        }
        if let Residual::Rows { .. } = residual {
            self.measure_bounds(data);
        }
        self.displaced -= &self.alpha;
        self.displace();
        self.displaced += &self.alpha;
        Ok(true)
    }

    /// Stores the size of the torques f with which the bounds balance the gradient of the solved level, the square root
    /// of fᵀ M⁻¹ f.
    fn measure_bounds(&mut self, data: &Data) {
        let n = self.scale.len();
        let weight = self.lateral_weight * self.lateral_weight;
        for r in 0..n {
            let row = |c: usize| self.program.hessian[(r.max(c), r.min(c))] * self.delta[c];
            self.torque[r] = self.scale[r] / weight * (self.pull[r] + (0..n).map(row).sum::<f64>());
        }
        self.asked.copy_from(&self.torque);
        data.mass_matrix_factor.solve(self.asked.as_mut_slice());
        self.held = self.torque.dot(&self.asked).max(0.0).sqrt();
    }

    /// Size of the torques with which bounds held back the last level, relative to errors across its heading; 0 if no
    /// bound did, or if it is not a level of plain rows.
    pub(crate) fn held(&self) -> f64 {
        self.held
    }

    /// Minimises a residual within the limits, and writes δ into `delta`.
    fn solve_within(&mut self, residual: &Residual<'_>, limits: &Limits<'_>) -> Result<(), QpError> {
        let proximal = self.pose(residual);
        self.constrain(limits, false);
        self.iterate_proximal(Problem::of(residual), proximal)
    }

    /// Lets the widening of bounds start with the rows that contradicted each other in a program: these are the ones that
    /// it widens, and their constraints have the same numbers there.
    fn start_from_contradiction(&mut self, problem: Problem) {
        let [rows, joints, bounds, scaled] = &mut self.active_sets;
        let contradicted = match problem {
            Problem::Rows => rows,
            Problem::Joints => joints,
            // The constraint of its reduction comes after all that the bounds have.
            Problem::Scaled | Problem::Bounds => scaled,
        };
        bounds.start_from(contradicted);
    }

    /// Returns true if the widened bounds leave one point for the solution of a program, which δ then is: where one bound
    /// more than joints pushes, and the bounds determine all joints.
    fn leaves_one_point(&mut self, problem: Problem) -> bool {
        let [rows, joints, bounds, _] = &mut self.active_sets;
        let contradicted = match problem {
            Problem::Rows => rows,
            Problem::Joints => joints,
            Problem::Scaled | Problem::Bounds => return false,
        };
        bounds.balances(self.freedom) && contradicted.exchange_active(bounds, &self.program)
    }

    /// Widens the bounds to include the current α and M α, with a margin for rounding.
    fn admit(&mut self, data: &Data, limits: &mut Limits<'_>) {
        multiply(&data.mass_matrix, self.alpha.as_slice(), self.torque.as_mut_slice());
        let (acceleration, torque) = (&mut *limits.acceleration, &mut *limits.torque);
        for i in 0..self.scale.len() {
            for (interval, value) in [
                (&mut *acceleration, self.alpha[i] + limits.bias_acceleration[i]),
                (&mut *torque, self.torque[i] + limits.compensation_torque[i]),
            ] {
                let slack = SLACK * (1.0 + value.abs());
                interval.include(i, value - slack);
                interval.include(i, value + slack);
            }
        }
        for speed in limits.speeds.iter_mut() {
            let value = dot(speed.row.as_slice(), self.alpha.as_slice());
            speed.upper = speed.upper.max(value + SLACK * (1.0 + value.abs()));
        }
    }

    /// Widens the bounds as [`solve_level`](Self::solve_level) does for a level below `above` if they are infeasible.
    pub(crate) fn relax_level(
        &mut self,
        data: &Data,
        above: &Nullspace,
        limits: &mut Limits<'_>,
    ) -> Result<(), QpError> {
        multiply(&data.mass_matrix, self.alpha.as_slice(), self.torque.as_mut_slice());
        self.reduction = None;
        self.span(data, above);
        self.relax(data, limits)
    }

    /// Widens the bounds on accelerations and speeds as little as possible to make them feasible.
    fn relax(&mut self, data: &Data, limits: &mut Limits<'_>) -> Result<(), QpError> {
        let n = self.scale.len();
        let variables = 2 * n + limits.speeds.len();
        let hessian = &mut self.program.hessian;
        for c in 0..variables {
            for r in c..variables {
                let on_joints = r < n;
                let slack = f64::from(u8::from(r == c && c >= n));
                hessian[(r, c)] = if on_joints { RELAXED * self.mass[(r, c)] } else { slack };
            }
        }
        self.constrain(limits, true);
        self.pull.fill(0.0);
        self.iterate_proximal(Problem::Bounds, Some(RELAXED))?;
        // The solution is only used to widen the bounds: the level restarts from the saved α.
        self.asked.copy_from(&self.alpha);
        self.displace();
        self.admit(data, limits);
        self.alpha.copy_from(&self.asked);
        multiply(&data.mass_matrix, self.alpha.as_slice(), self.torque.as_mut_slice());
        Ok(())
    }

    /// Solves the program by proximal steps of weight ε, or in one step if `proximal` is `None`; writes δ into `delta`.
    fn iterate_proximal(&mut self, problem: Problem, proximal: Option<f64>) -> Result<(), QpError> {
        let (n, variables) = (self.scale.len(), self.program.variables());
        self.program.gradient.fill(0.0);
        self.program.gradient.as_mut_slice()[..n].copy_from_slice(self.pull.as_slice());
        self.delta.fill(0.0);
        let mut again = false;
        for _ in 0..STEPS {
            let solver = self.solve(problem, again)?;
            again = solver == Solver::ActiveSet;
            let x = match (solver, &self.interior_point) {
                (Solver::InteriorPoint, Some(interior_point)) => interior_point.x(),
                _ => self.active_sets[problem as usize].x(),
            };
            self.solver = self.solver.max(solver);
            let (mut change, mut size) = (0.0_f64, 0.0_f64);
            for (d, &x) in self.delta.iter_mut().zip(&x[..variables]) {
                change = change.max((x - *d).abs());
                size = size.max(x.abs());
                *d = x;
            }
            let Some(weight) = proximal.filter(|_| change > SETTLED * (1.0 + size)) else {
                break;
            };
            let gradient = &mut self.program.gradient.as_mut_slice()[..n];
            multiply(&self.mass, &self.delta.as_slice()[..n], gradient);
            gradient.iter_mut().zip(self.pull.iter()).for_each(|(g, pull)| *g = pull - weight * *g);
        }
        Ok(())
    }

    /// Solves the program; `again` if only its gradient has changed since the active-set method solved it.
    fn solve(&mut self, problem: Problem, again: bool) -> Result<Solver, QpError> {
        let active_set = &mut self.active_sets[problem as usize];
        if again && active_set.solve_again(&self.program).is_ok() {
            return Ok(Solver::ActiveSet);
        }
        match (active_set.solve(&self.program), &mut self.interior_point) {
            (Ok(()), _) => Ok(Solver::ActiveSet),
            (Err(error @ QpError::Infeasible { .. }), _) => Err(error),
            (Err(error), None) => {
                self.unsolved = Some(error);
                Err(error)
            }
            (Err(_), Some(interior_point)) => {
                interior_point.solve(&self.program).map(|()| Solver::InteriorPoint)
            }
        }
    }

    /// Sets α ← α + N δ.
    fn displace(&mut self) {
        let n = self.scale.len();
        let alpha = self.alpha.as_mut_slice();
        let delta = &self.delta.as_slice()[..self.freedom];
        for (column, delta) in self.nullspace.as_slice().chunks_exact(n).zip(delta) {
            axpy(*delta, column, alpha);
        }
    }

    /// Computes N and M N, for scaled δ, of the null space of the levels above as M⁻¹ Nᵀ M and Nᵀ M. Both forms are
    /// equal unless more than one of those levels is damped. A level's demand is M⁻¹ Nᵀ times its torques; with this
    /// form, δ can always cancel it.
    fn span(&mut self, data: &Data, above: &Nullspace) {
        self.project_torques(data, above);
        self.freedom = self.scale.len();
        if above.is_empty() {
            self.nullspace.as_mut_slice().fill(0.0);
            let diagonal = self.nullspace.as_mut_slice().iter_mut().step_by(self.freedom + 1);
            diagonal.zip(&self.inverse_scale).for_each(|(x, inverse)| *x = *inverse);
        } else {
            self.nullspace.as_mut_slice().copy_from_slice(self.torque_rows.as_slice());
            data.mass_matrix_factor.solve_matrix(&mut self.nullspace);
        }
    }

    /// Computes Nᵀ M for scaled δ.
    fn project_torques(&mut self, data: &Data, above: &Nullspace) {
        let n = self.scale.len();
        let columns = data.mass_matrix.as_slice().chunks_exact(n).zip(&self.inverse_scale);
        for (rows, (column, inverse)) in self.torque_rows.as_mut_slice().chunks_exact_mut(n).zip(columns) {
            rows.iter_mut().zip(column).for_each(|(row, x)| *row = x * inverse);
            above.project_torque(rows);
        }
    }

    /// Replaces δ by its coordinates in a basis of the null space and returns true, if N is a projector onto at most a
    /// third of the joints' dimensions: then Nᵀ M = Z Zᵀ, and the columns of M⁻¹ Z are a basis that is orthonormal in
    /// kinetic energy. Z is computed by Cholesky factorisation with pivoting. N of a damped level is no projector.
    fn reduce(&mut self, data: &Data, above: &Nullspace) -> bool {
        self.project_torques(data, above);
        let n = self.scale.len();
        let remaining = self.remaining.as_mut_slice();
        let columns = self.torque_rows.as_slice().chunks_exact(n);
        for (column, rows) in remaining.chunks_exact_mut(n).zip(columns) {
            for ((x, row), inverse) in column.iter_mut().zip(rows).zip(&self.inverse_scale) {
                *x = row * inverse;
            }
        }
        let mut freedom = 0;
        loop {
            let pivots = (0..n).map(|i| (i, remaining[i * n + i]));
            let (place, pivot) = pivots.fold((0, NO_FREEDOM), |a, b| if b.1 > a.1 { b } else { a });
            if pivot <= NO_FREEDOM {
                break;
            }
            if pivot < CLEAR || 3 * (freedom + 1) > n {
                return false;
            }
            let z = &mut self.basis.as_mut_slice()[freedom * n..(freedom + 1) * n];
            z.copy_from_slice(&remaining[place * n..(place + 1) * n]);
            let inverse = 1.0 / pivot.sqrt();
            z.iter_mut().for_each(|z| *z *= inverse);
            for (column, factor) in remaining.chunks_exact_mut(n).zip(&*z) {
                axpy(-factor, z, column);
            }
            freedom += 1;
        }
        let used = freedom * n;
        let basis = &mut self.basis.as_mut_slice()[..used];
        let joints = &mut self.nullspace.as_mut_slice()[..used];
        for (column, z) in joints.chunks_exact_mut(n).zip(basis.chunks_exact_mut(n)) {
            z.iter_mut().zip(&self.scale).for_each(|(z, scale)| *z *= scale);
            column.copy_from_slice(z);
            data.mass_matrix_factor.solve(column);
        }
        let is_orthonormal = joints.chunks_exact(n).enumerate().all(|(k, column)| {
            let products = basis.chunks_exact(n).map(|z| dot(z, column)).enumerate();
            products
                .into_iter()
                .all(|(l, product)| (product - f64::from(u8::from(k == l))).abs() <= ORTHOGONAL)
        });
        self.torque_rows.as_mut_slice()[..used].copy_from_slice(basis);
        self.freedom = freedom;
        freedom > 0 && is_orthonormal
    }

    /// Sets the Hessian of a residual, in the variables of [`span`](Self::span), and returns the weight of its proximal
    /// steps.
    fn pose(&mut self, residual: &Residual<'_>) -> Option<f64> {
        self.reduction = None;
        self.pull.fill(0.0);
        let Residual::Rows { jacobian, inertia, heading, resistance } = residual else {
            if !matches!(residual, Residual::Joints) {
                return self.pose_weighted_or_scaled(residual);
            }
            // A basis is orthonormal.
            let is_basis = self.freedom < self.scale.len();
            for c in 0..self.freedom {
                for r in c..self.freedom {
                    let unit = f64::from(u8::from(r == c));
                    self.program.hessian[(r, c)] = if is_basis { unit } else { self.mass[(r, c)] };
                }
            }
            return None;
        };
        let n = self.scale.len();
        let hessian = &mut self.program.hessian;
        let momentum = *inertia * heading;
        let energy = heading.dot(&momentum);
        let still = STILL * STILL * inertia.trace();
        let aside = self.lateral_weight * self.lateral_weight;
        let ahead = if energy > 0.0 { (aside - 1.0) / (energy + still) } else { 0.0 };
        let mut trace = 0.0;
        for c in 0..n {
            let right = jacobian.column(c) / self.scale[c];
            let weighed = *inertia * right * aside - momentum * (ahead * momentum.dot(&right));
            for r in c..n {
                hessian[(r, c)] = jacobian.column(r).dot(&weighed) / self.scale[r];
            }
            trace += hessian[(c, c)];
        }
        let proximal = self.approach(trace * (USUAL_WEIGHT * USUAL_WEIGHT / aside));
        if let Some((weight, passive)) = resistance {
            let deviation = self.alpha.iter().zip(*passive).zip(&self.scale).map(|((a, p), s)| (a - p) * s);
            let (hessian, scratch) = (&mut self.program.hessian, self.asked.as_mut_slice());
            add_resistance(hessian, &self.mass, aside * weight, deviation, scratch, self.pull.as_mut_slice());
        }
        Some(proximal)
    }

    /// Sets the Hessian of weighted joints or of a scaled level, and returns the weight of its proximal steps.
    fn pose_weighted_or_scaled(&mut self, residual: &Residual<'_>) -> Option<f64> {
        let n = self.scale.len();
        let trace = match residual {
            Residual::ScaledRows { jacobian, inertia, reducible } => {
                let (hessian, still) = (&mut self.program.hessian, STILL * STILL * inertia.trace());
                let (trace, most) = scale_rows(hessian, jacobian, inertia, &self.scale, reducible, still);
                self.reduction = Some(most);
                trace
            }
            Residual::WeightedJoints { weights, reducible } => {
                let accelerations = &self.nullspace.as_slice()[..self.freedom * n];
                let space =
                    JointSpace { accelerations, mass: &self.mass, scale: &self.scale, weights: *weights };
                let product = self.asked.as_mut_slice();
                let (trace, most) = weigh_joints(&mut self.program, &space, *reducible, product);
                self.reduction = most;
                trace
            }
            Residual::Rows { .. } | Residual::Joints => return None,
        };
        // A basis has no direction without a cost.
        (self.freedom == n).then(|| self.approach(trace))
    }

    /// Adds the cost of the proximal steps to a Hessian with this trace, and returns their weight.
    fn approach(&mut self, trace: f64) -> f64 {
        let (n, hessian) = (self.scale.len(), &mut self.program.hessian);
        let proximal = PROXIMAL * if trace > 0.0 { trace } else { 1.0 };
        for c in 0..n {
            for r in c..n {
                hessian[(r, c)] += proximal * self.mass[(r, c)];
            }
        }
        proximal
    }

    /// Sets the limits on δ as constraints, with a slack variable per acceleration and speed bound if `relaxed`.
    fn constrain(&mut self, limits: &Limits<'_>, relaxed: bool) {
        let n = self.scale.len();
        let constraints = 2 * n + limits.speeds.len();
        let reduction = self.reduction.filter(|_| !relaxed);
        let slacks = if relaxed { n + limits.speeds.len() } else { usize::from(reduction.is_some()) };
        self.program.resize(self.freedom + slacks, constraints + usize::from(reduction.is_some()));
        if let Some(most) = reduction {
            let row = self.program.row_mut(constraints);
            row.fill(0.0);
            row[self.freedom] = 1.0;
            (self.program.lower[constraints], self.program.upper[constraints]) = (0.0, most);
        }
        let (a, t) = (&*limits.acceleration, &*limits.torque);
        for i in 0..n {
            let (scale, inverse) = (self.scale[i], self.inverse_scale[i]);
            let at = self.alpha[i] + limits.bias_acceleration[i];
            self.set_row(i, i, scale, relaxed);
            self.program.lower[i] = (a.lower[i] - at) * scale;
            self.program.upper[i] = (a.upper[i] - at) * scale;

            let at = self.torque[i] + limits.compensation_torque[i];
            self.set_row(n + i, i, inverse, false);
            self.program.lower[n + i] = (t.lower[i] - at) * inverse;
            self.program.upper[n + i] = (t.upper[i] - at) * inverse;
        }
        for (k, speed) in limits.speeds.iter().enumerate() {
            let (alpha, nullspace) = (&self.alpha, &self.nullspace);
            let row = self.program.row_mut(2 * n + k);
            let (of_delta, slacks) = row.split_at_mut(self.freedom);
            for (x, column) in of_delta.iter_mut().zip(nullspace.as_slice().chunks_exact(n)) {
                *x = dot(speed.row.as_slice(), column);
            }
            // The row is normalised so that its slack is comparable to those of accelerations.
            let length = dot(of_delta, of_delta).sqrt().max(f64::MIN_POSITIVE);
            of_delta.iter_mut().for_each(|x| *x /= length);
            slacks.fill(0.0);
            if relaxed {
                slacks[n + k] = 1.0;
            }
            self.program.lower[2 * n + k] = f64::NEG_INFINITY;
            self.program.upper[2 * n + k] =
                (speed.upper - dot(speed.row.as_slice(), alpha.as_slice())) / length;
        }
    }
    /// Sets a constraint to the acceleration of joint i (`constraint` < n) or to its torque, times `scale`.
    fn set_row(&mut self, constraint: usize, i: usize, scale: f64, relaxed: bool) {
        let n = self.scale.len();
        let rows = if constraint < n { &self.nullspace } else { &self.torque_rows };
        let row = self.program.row_mut(constraint);
        let (of_delta, slacks) = row.split_at_mut(self.freedom);
        for (x, column) in of_delta.iter_mut().zip(rows.as_slice().chunks_exact(n)) {
            *x = column[i] * scale;
        }
        if !slacks.is_empty() {
            slacks.fill(0.0);
            if relaxed {
                slacks[i] = 1.0;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nullspace::tests::chain;
    use opspace_model::{Model, frame_jacobian, update};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// A state of a chain, a demand, and bounds that may contradict each other.
    struct Case {
        model: Model,
        data: Data,
        jacobian: Matrix6xX<f64>,
        demand: DVector<f64>,
        acceleration: Interval,
        torque: Interval,
        speeds: Vec<SpeedBound>,
    }

    impl Case {
        fn draw(rng: &mut ChaCha8Rng) -> Self {
            let n = rng.random_range(2..=8);
            let model = chain(n);
            let mut data = Data::new(&model);
            let q: Vec<f64> = (0..n).map(|_| rng.random_range(-2.0..2.0)).collect();
            assert!(update(&model, &mut data, &q, &vec![0.0; n]));
            let mut jacobian = Matrix6xX::zeros(n);
            frame_jacobian(&model, &data, model.frame_id("end").expect("frame"), &mut jacobian);
            let demand = DVector::from_fn(n, |_, _| rng.random_range(-5.0..5.0));
            let (mut acceleration, mut bounded) = (Interval::new(n), Interval::new(n));
            // The torques leave little choice, around accelerations that need not be within their bounds.
            let around = DVector::from_fn(n, |_, _| rng.random_range(-5.0..5.0));
            let torque = &data.mass_matrix * &around;
            for i in 0..n {
                let half = if rng.random_bool(0.2) { f64::INFINITY } else { rng.random_range(0.0..0.2) };
                let half = half * (1.0 + torque[i].abs());
                (bounded.lower[i], bounded.upper[i]) = (torque[i] - half, torque[i] + half);
                if rng.random_bool(0.5) {
                    let middle = around[i] + rng.random_range(-3.0..3.0);
                    acceleration.lower[i] = middle - 1.0;
                    acceleration.upper[i] = middle + 1.0;
                }
            }
            let speeds = (0..rng.random_range(0..3)).map(|_| {
                let mut row = DVector::zeros(n);
                (0..2).for_each(|_| row[rng.random_range(0..n)] = rng.random_range(-1.0..1.0));
                SpeedBound { upper: row.dot(&around) + rng.random_range(-2.0..2.0), row }
            });
            let speeds = speeds.collect();
            Self { model, data, jacobian, demand, acceleration, torque: bounded, speeds }
        }

        /// Solves a level of all rows, and returns α and the number of bounds that were met after they were widened, if any
        /// were.
        fn solve(&mut self) -> (DVector<f64>, Option<usize>) {
            let n = self.model.n();
            let cascade = &mut HierarchicalQp::new(n, 2, 10.0);
            let zero = DVector::zeros(n);
            let mut limits = Limits {
                acceleration: &mut self.acceleration,
                torque: &mut self.torque,
                compensation_torque: &zero,
                bias_acceleration: &zero,
                speeds: &mut self.speeds,
            };
            cascade.begin(&self.data);
            cascade.add_demand(&self.data, self.demand.as_slice(), &mut limits);
            let residual = Residual::Rows {
                jacobian: &self.jacobian,
                inertia: &Matrix6::identity(),
                heading: Vector6::zeros(),
                resistance: None,
            };
            let above = Nullspace::new(n, 1);
            let solved = cascade.solve_level(&self.data, &above, &residual, &mut limits);
            assert!(solved.is_ok(), "{solved:?}");
            let [_, _, widened, _] = &cascade.active_sets;
            let met = widened.multipliers().iter().filter(|x| **x != 0.0).count();
            (DVector::from_column_slice(cascade.alpha()), (widened.iterations() > 0).then_some(met))
        }
    }

    /// Compared: joint accelerations of a level whose bounds were widened until they met in one point, and those of the same
    /// level solved within these bounds, which then do not contradict each other.
    #[test]
    fn widened_bounds_that_meet_in_a_point_need_no_other_solution() {
        // Bounds are widened by 1e-9 more than they must. Between bounds that push little, that leaves 3e3 times as much.
        const TOLERANCE: f64 = 1e-4;
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let (mut points, mut others) = (0, 0);
        for case in 0..2000 {
            let mut drawn = Case::draw(&mut rng);
            let n = drawn.model.n();
            let (alpha, met) = drawn.solve();
            let Some(met) = met else { continue };
            points += usize::from(met > n);
            others += usize::from(met <= n);
            let (again, none) = drawn.solve();
            assert_eq!(none, None, "case {case}: the bounds contradict each other again");
            let error = (&again - &alpha).amax();
            assert!(error <= TOLERANCE * (1.0 + alpha.amax()), "case {case}, {met} bounds: {alpha} {again}");
        }
        assert!(points > 100 && others > 50, "{points} cases in a point, {others} others");
    }
}

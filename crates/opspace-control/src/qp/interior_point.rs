//! Interior-point method of Clarabel for the programs that [`ActiveSet`](crate::qp::active_set::ActiveSet) solves: an
//! independent implementation of another algorithm, some hundred times slower and less accurate. It is the fallback if
//! the active-set method fails, and a reference for tests.
//!
//! Clarabel (P. Goulart and Y. Chen, *Clarabel: An interior-point solver for conic programs with quadratic
//! objectives*, arXiv:2405.12762, 2024) solves
//!
//! ```text
//! min ½ xᵀ P x + qᵀ x   subject to   A x + s = b,  s ∈ {0}ᵐ × ℝ²ᵐ≥0
//! ```
//!
//! The solver is built with the first program, with dense P and A, and its data are replaced in place. Each row of our program has three
//! rows of A:
//!
//! ```text
//!  c x + s =  b   in the zero cone, for an equality
//!  c x + s =  u   in the non-negative cone, if there is an upper bound
//! −c x + s = −l   in the non-negative cone, if there is a lower bound
//! ```
//!
//! Unused rows are zero, with s = 0 in the zero cone and s = 1 in the other cone. Neither infinities nor large numbers
//! in their place reach the solver. Rows are scaled to length one and P to a largest diagonal entry of one: Clarabel's
//! own equilibration would use the data with which the solver was built.

use crate::qp::quadratic_program::{QpError, QuadraticProgram, all_finite, dot};
use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus, ZeroConeT};

/// Gap and residuals at which Clarabel stops, relative and absolute, in the scaled program. If the bounds barely
/// intersect, the error of x is of the order of the square root of the gap; the value is therefore a hundredth of
/// Clarabel's default, and is nearly always reached.
const WANTED: f64 = 1e-10;
/// Gap and residuals that are accepted if [`WANTED`] cannot be reached (Clarabel's default); Clarabel then reports
/// `AlmostSolved`.
const ACCEPTED: f64 = 1e-8;

/// Clarabel for programs up to a given size.
///
/// Its workspace (2 MB for seven joints with every limit) is built when the first program is solved, because most robots never need
/// it. That call allocates some 120 times; later ones allocate once inside Clarabel (0.11.1).
pub struct InteriorPoint {
    variables: usize,
    constraints: usize,
    workspace: Option<Workspace>,
    solution: Vec<f64>,
}

/// Clarabel with its data.
struct Workspace {
    solver: DefaultSolver<f64>,
    /// P's upper triangle by columns, n (n + 1) / 2.
    p: Vec<f64>,
    q: Vec<f64>,
    /// A by columns, 3 m × n.
    a: Vec<f64>,
    b: Vec<f64>,
    factor: Vec<f64>,
}

impl InteriorPoint {
    /// Creates a solver for programs with at most these numbers of variables and constraints.
    ///
    /// # Errors
    /// Only without the feature `clarabel`.
    pub fn new(variables: usize, constraints: usize) -> Result<Self, QpError> {
        Ok(Self { variables, constraints, workspace: None, solution: Vec::with_capacity(variables) })
    }

    /// Minimiser (n) of the last solved program. Always finite; empty before the first solution.
    #[must_use]
    pub fn x(&self) -> &[f64] {
        &self.solution
    }

    /// Solves `program`. Only Clarabel's `Solved` and `AlmostSolved` are accepted; with the tolerances used here, the
    /// latter is as accurate as `Solved` with Clarabel's default settings. With any other status, its x is a
    /// certificate or the last iterate.
    ///
    /// # Errors
    /// [`QpError`]; [`x`](Self::x) then remains the solution of an earlier program.
    pub fn solve(&mut self, program: &QuadraticProgram) -> Result<(), QpError> {
        let n = program.variables();
        if n > self.variables || program.constraints() > self.constraints {
            return Err(QpError::Unsolved("the problem exceeds the size that the solver was created for"));
        }
        let workspace = match &mut self.workspace {
            Some(workspace) => workspace,
            empty => empty.insert(Workspace::new(self.variables, self.constraints)?),
        };
        let x = workspace.solve(program)?;
        self.solution.clear();
        self.solution.extend_from_slice(&x[..n]);
        Ok(())
    }
}

impl Workspace {
    fn new(variables: usize, constraints: usize) -> Result<Self, QpError> {
        let rows = 3 * constraints;
        let p = upper_triangle(variables);
        let a = CscMatrix::new(
            rows,
            variables,
            (0..=variables).map(|j| j * rows).collect(),
            (0..variables).flat_map(|_| 0..rows).collect(),
            vec![0.0; rows * variables],
        );
        let (q, b) = (vec![0.0; variables], vec![0.0; rows]);
        let cones = [ZeroConeT(constraints), NonnegativeConeT(2 * constraints)];
        let settings = DefaultSettings {
            verbose: false,
            max_threads: 1,
            // Both options remove entries that are zero now, which cannot be replaced later.
            presolve_enable: false,
            input_sparse_dropzeros: false,
            equilibrate_enable: false,
            tol_gap_abs: WANTED,
            tol_gap_rel: WANTED,
            tol_feas: WANTED,
            reduced_tol_gap_abs: ACCEPTED,
            reduced_tol_gap_rel: ACCEPTED,
            reduced_tol_feas: ACCEPTED,
            ..DefaultSettings::default()
        };
        let solver = DefaultSolver::new(&p, &q, &a, &b, &cones, settings)
            .map_err(|_| QpError::Unsolved("Clarabel rejects the problem size"))?;
        let factor = vec![0.0; variables * variables];
        Ok(Self { solver, p: p.nzval, q, a: a.nzval, b, factor })
    }

    /// Returns the minimiser, followed by the values of unused variables.
    fn solve(&mut self, program: &QuadraticProgram) -> Result<&[f64], QpError> {
        let n = program.variables();
        program.check()?;
        program.cholesky(&mut self.factor[..n * n])?;
        self.set_cost(program);
        self.set_constraints(program);
        self.solver
            .update_data(&self.p, &self.q, &self.a, &self.b)
            .map_err(|_| QpError::Unsolved("Clarabel rejects the new data"))?;
        self.solver.solve();
        let found = &self.solver.solution;
        match found.status {
            SolverStatus::Solved | SolverStatus::AlmostSolved if all_finite(&found.x) => Ok(&found.x),
            SolverStatus::Solved | SolverStatus::AlmostSolved => Err(QpError::NotFinite),
            SolverStatus::PrimalInfeasible | SolverStatus::AlmostPrimalInfeasible => {
                Err(QpError::Infeasible { row: self.contradiction() })
            }
            SolverStatus::MaxIterations => Err(QpError::Iterations),
            SolverStatus::DualInfeasible | SolverStatus::AlmostDualInfeasible => {
                Err(QpError::Unsolved("Clarabel: dual infeasible"))
            }
            SolverStatus::NumericalError => Err(QpError::Unsolved("Clarabel: numerical error")),
            SolverStatus::InsufficientProgress => Err(QpError::Unsolved("Clarabel: insufficient progress")),
            _ => Err(QpError::Unsolved("Clarabel: stopped")),
        }
    }

    /// Sets P and q; they are the identity and zero for unused variables.
    fn set_cost(&mut self, program: &QuadraticProgram) {
        let n = program.variables();
        let largest = (0..n).map(|j| program.hessian_column(j)[0]).fold(0.0, f64::max);
        let scale = if largest > 0.0 { 1.0 / largest } else { 1.0 };
        self.p.fill(0.0);
        self.q.fill(0.0);
        for j in 0..self.q.len() {
            // Column j of the upper triangle is row j of the lower.
            let column = &mut self.p[j * (j + 1) / 2..][..=j];
            if j < n {
                for (i, entry) in column.iter_mut().enumerate() {
                    *entry = scale * program.hessian_column(i)[j - i];
                }
                self.q[j] = scale * program.gradient[j];
            } else {
                column[j] = 1.0;
            }
        }
    }

    /// Sets A and b.
    fn set_constraints(&mut self, program: &QuadraticProgram) {
        let m = self.constraints();
        self.a.fill(0.0);
        self.b[..m].fill(0.0);
        self.b[m..].fill(1.0);
        for i in 0..program.constraints() {
            let row = program.row(i);
            let length = dot(row, row).sqrt();
            let scale = if length > 0.0 { 1.0 / length } else { 1.0 };
            let (lower, upper) = (program.lower[i], program.upper[i]);
            let mut set = |at: usize, scale: f64, bound: f64| {
                for (column, c) in self.a.chunks_exact_mut(3 * m).zip(row) {
                    column[at] = scale * c;
                }
                self.b[at] = scale * bound;
            };
            if lower == upper {
                set(i, scale, upper);
                continue;
            }
            if upper.is_finite() {
                set(m + i, scale, upper);
            }
            if lower.is_finite() {
                set(2 * m + i, -scale, lower);
            }
        }
    }

    fn constraints(&self) -> usize {
        self.b.len() / 3
    }

    /// Returns the row with the largest weight in Clarabel's infeasibility certificate.
    fn contradiction(&self) -> usize {
        let weight = |&(_, a): &(usize, &f64), &(_, b): &(usize, &f64)| a.abs().total_cmp(&b.abs());
        let heaviest = self.solver.solution.z.iter().enumerate().max_by(weight);
        heaviest.map_or(0, |(at, _)| at % self.constraints())
    }
}

/// Returns the identity, n × n, with every entry of the upper triangle stored.
fn upper_triangle(n: usize) -> CscMatrix<f64> {
    CscMatrix::new(
        n,
        n,
        (0..=n).map(|j| j * (j + 1) / 2).collect(),
        (0..n).flat_map(|j| 0..=j).collect(),
        (0..n).flat_map(|j| (0..=j).map(move |i| if i == j { 1.0 } else { 0.0 })).collect(),
    )
}

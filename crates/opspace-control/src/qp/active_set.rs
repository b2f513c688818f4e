//! Dual active-set method for small, dense, strictly convex quadratic programs.
//!
//! D. Goldfarb and A. Idnani, *A numerically stable dual method for solving strictly convex quadratic programs*,
//! Mathematical Programming 27, 1983. From the unconstrained minimum, violated rows are activated one by one. Every
//! iterate is the minimum on its active rows N, with multipliers u that prove it:
//!
//! ```text
//! H x + g = N u        Nᵀ x = b        u ≥ 0 for inequalities
//! ```
//!
//! With H = L Lᵀ, L⁻¹ N = Q [R; 0] and J = L⁻ᵀ Q = [J₁ J₂], the step towards a violated row nᵀ x ≥ b changes x by t z
//! and u by −t r:
//!
//! ```text
//! d = Jᵀ n        z = J₂ d₂        r = R⁻¹ d₁
//! t₁ = min uⱼ / rⱼ over rⱼ > 0: a multiplier reaches zero, and its row is dropped
//! t₂ = (b − nᵀ x) / d₂ᵀ d₂: the row is met, and becomes active
//! ```
//!
//! If d₂ is zero, the row depends on the active ones and there is no t₂; if there is no t₁ either, no x satisfies them
//! all. Extensions of the paper: a row with two bounds is a single row; a new row transforms J₂ by a single reflection;
//! and a Newton step on the conditions above, with newly computed residuals, removes accumulated rounding errors.
//!
//! In a test with 240 000 random feasible programs, with many redundant rows and condition numbers of H from 1e6 to
//! 1e10, the method reported a failure for one; the other solutions satisfied the conditions to 2e-11.

mod factor;

use crate::qp::padded::{add_product, buffer, copy_padded, dot_padded, norm_padded, padded};
use crate::qp::quadratic_program::{QpError, QuadraticProgram, all_finite, axpy, dot};
use factor::Factor;

/// A row counts as satisfied within this fraction of the largest possible sum of its terms, |c| |x| + |bound|.
const FEASIBILITY: f64 = 1e-11;
/// Rounding error of J relative to |J|: some hundred times the machine precision. A row is dependent if its d₂ is not
/// larger.
const DEPENDENCE: f64 = 1e-13;
/// A multiplier whose decrease is below this fraction of the sum of all decreases only decreases because of rounding.
const SLOWEST: f64 = 1e-10;
/// Maximum number of iterations per variable and constraint. Usually slightly more iterations than active rows are
/// needed.
const ITERATIONS: usize = 10;

/// Newton step relative to x after which another one is taken when a program is solved
/// [again](ActiveSet::solve_again): the error of a step is far smaller than the step, but not arbitrarily.
const LONG_STEP: f64 = 1e-3;

/// Multiplier, relative to the largest one, above which a row certainly pushes the solution. What rounding leaves between
/// the rows is inversely proportional to it.
const CLEAR_PUSH: f64 = 3e-4;

/// Data of the program, with [padded](crate::qp::padded) columns.
#[derive(Debug)]
struct ProgramData {
    variables: usize,
    constraints: usize,
    /// Length of a column of H and of a row: that of a vector of variables.
    stride: usize,
    /// Length of a vector of constraints.
    tall: usize,
    /// H, all n columns.
    hessian: Vec<f64>,
    gradient: Vec<f64>,
    /// Cᵀ, n columns.
    by_variable: Vec<f64>,
    /// C, m columns: a row each. Only those of rows that have been active are set.
    rows: Vec<f64>,
}

impl ProgramData {
    fn new(n: usize, m: usize) -> Self {
        let (stride, tall) = (padded(n), padded(m));
        Self {
            variables: 0,
            constraints: 0,
            stride: 0,
            tall: 0,
            hessian: buffer(n * stride),
            gradient: buffer(stride),
            by_variable: buffer(n * tall),
            rows: buffer(m * stride),
        }
    }

    /// Copies a program, and checks that its data are finite.
    fn load(&mut self, program: &QuadraticProgram) -> Result<(), QpError> {
        let (n, m) = (program.variables(), program.constraints());
        let (stride, tall) = (padded(n), padded(m));
        let (hessian, by_variable) = (&mut self.hessian[..n * stride], &mut self.by_variable[..n * tall]);
        if (n, m) != (self.variables, self.constraints) {
            (self.variables, self.constraints, self.stride, self.tall) = (n, m, stride, tall);
            hessian.fill(0.0);
            by_variable.fill(0.0);
        }
        for j in 0..n {
            for (i, &x) in (j..).zip(program.hessian_column(j)) {
                hessian[j * stride + i] = x;
                hessian[i * stride + j] = x;
            }
        }
        for i in 0..m {
            let mut at = i;
            for &x in program.row(i) {
                by_variable[at] = x;
                at += tall;
            }
        }
        let finite = all_finite(hessian) & all_finite(by_variable);
        if finite { self.load_gradient(program) } else { Err(QpError::NotFinite) }
    }

    /// Copies the gradient of a program, and checks that it is finite.
    fn load_gradient(&mut self, program: &QuadraticProgram) -> Result<(), QpError> {
        let gradient = &program.gradient.as_slice()[..self.variables];
        copy_padded(gradient, &mut self.gradient[..self.stride]);
        if all_finite(gradient) { Ok(()) } else { Err(QpError::NotFinite) }
    }

    /// Copies a row that becomes active.
    fn load_row(&mut self, program: &QuadraticProgram, i: usize) {
        copy_padded(program.row(i), &mut self.rows[i * self.stride..(i + 1) * self.stride]);
    }

    fn row(&self, i: usize) -> &[f64] {
        &self.rows[i * self.stride..(i + 1) * self.stride]
    }
}

/// An active row: an equality at x.
#[derive(Clone, Copy, Debug)]
struct Active {
    row: usize,
    /// 1 for the lower bound, −1 for the upper bound: n = sign · c and b = sign · bound.
    sign: f64,
    b: f64,
    /// Multiplier u.
    multiplier: f64,
    equality: bool,
}

impl Active {
    fn new(program: &QuadraticProgram, row: usize, sign: f64) -> Self {
        let (lower, upper) = (program.lower[row], program.upper[row]);
        let bound = if sign > 0.0 { lower } else { upper };
        Self { row, sign, b: sign * bound, multiplier: 0.0, equality: lower == upper }
    }

    /// Returns true if the row keeps x from a smaller cost.
    fn is_superfluous(&self) -> bool {
        !self.equality && self.multiplier < 0.0
    }
}

/// A bound that x violates.
#[derive(Clone, Copy, Debug)]
struct Violation {
    row: usize,
    /// Sign as in [`Active`].
    sign: f64,
    /// Distance b − nᵀ x from the bound, in units of the row.
    gap: f64,
}

/// The solver with all its buffers: [`solve`](Self::solve) allocates nothing.
#[derive(Debug)]
pub struct ActiveSet {
    max_variables: usize,
    max_constraints: usize,
    data: ProgramData,
    factor: Factor,
    /// Current iterate x, padded.
    point: Vec<f64>,
    /// Cᵀ x, padded.
    values: Vec<f64>,
    active: Vec<Active>,
    is_active: Vec<bool>,
    /// |c| of each row, padded.
    norms: Vec<f64>,
    /// Largest d₂ that rounding causes for a dependent row with |c| = 1.
    rounding: f64,
    /// |x| of the unconstrained minimum.
    reach: f64,
    /// Largest |x| of all iterates, the scale of the rounding error of x.
    size: f64,
    /// True if the optimality conditions of the active rows hold up to rounding.
    refined: bool,
    iterations: usize,
    /// Maximum number of iterations per variable and constraint.
    pub(crate) most_iterations: usize,
    /// Active rows of the last solution, or of the last contradiction, and their signs, in the order of their activation.
    last: Vec<(usize, f64)>,
    x: Vec<f64>,
    multipliers: Vec<f64>,
}

impl ActiveSet {
    /// Creates a solver for programs with at most these numbers of variables and constraints.
    #[must_use]
    pub fn new(max_variables: usize, max_constraints: usize) -> Self {
        Self {
            max_variables,
            max_constraints,
            data: ProgramData::new(max_variables, max_constraints),
            factor: Factor::new(max_variables),
            point: buffer(padded(max_variables)),
            values: buffer(padded(max_constraints)),
            active: Vec::with_capacity(max_variables),
            is_active: vec![false; max_constraints],
            norms: buffer(padded(max_constraints)),
            rounding: 0.0,
            reach: 0.0,
            size: 0.0,
            refined: false,
            iterations: 0,
            most_iterations: ITERATIONS,
            last: Vec::with_capacity(max_variables + 1),
            x: Vec::with_capacity(max_variables),
            multipliers: Vec::with_capacity(max_constraints),
        }
    }

    /// Minimiser (n) of the last solved program. Always finite; empty before the first solution.
    #[must_use]
    pub fn x(&self) -> &[f64] {
        &self.x
    }

    /// Multipliers λ of H x + g + C λ = 0 (m): positive if the upper bound is active, negative if the lower bound is
    /// active, zero otherwise. If rows depend on each other, they are one of many solutions.
    #[must_use]
    pub fn multipliers(&self) -> &[f64] {
        &self.multipliers
    }

    /// Number of steps in the last call of [`solve`](Self::solve).
    #[must_use]
    pub fn iterations(&self) -> usize {
        self.iterations
    }

    /// Solves `program`. It starts at the minimum on the rows that were active in the last solution, or contradicted each
    /// other, which saves steps if successive programs are similar; the solution is the same up to rounding.
    ///
    /// # Errors
    /// [`QpError`]; [`x`](Self::x) then remains the solution of an earlier program.
    pub fn solve(&mut self, program: &QuadraticProgram) -> Result<(), QpError> {
        let m = program.constraints();
        self.iterations = 0;
        if program.variables() > self.max_variables || m > self.max_constraints {
            return Err(QpError::Unsolved("the problem exceeds the size that the solver was created for"));
        }
        program.check_sizes()?;
        self.data.load(program)?;
        program.check_bounds()?;
        self.start(program)?;
        for row in (0..m).filter(|&row| program.lower[row] == program.upper[row]) {
            self.activate(program, self.violation(program, row))?;
        }
        self.resume(program)?;
        self.finish(program)
    }

    /// Solves the program of the last successful call again with another gradient; all other data must be the same. The
    /// rows that were active remain so until their multipliers become negative.
    ///
    /// # Errors
    /// [`QpError`]; [`x`](Self::x) then remains the solution of an earlier program.
    pub(crate) fn solve_again(&mut self, program: &QuadraticProgram) -> Result<(), QpError> {
        self.iterations = 0;
        self.data.load_gradient(program)?;
        self.converge(program)?;
        if norm_padded(self.factor.step()) > LONG_STEP * norm_padded(&self.point) {
            self.converge(program)?;
        }
        self.finish(program)
    }

    /// Activates violated rows until there are none.
    fn finish(&mut self, program: &QuadraticProgram) -> Result<(), QpError> {
        loop {
            if let Some(violation) = self.most_violated(program) {
                self.activate(program, violation)?;
            } else if self.refined {
                return self.publish(program);
            } else {
                self.converge(program)?;
            }
        }
    }

    /// Takes at least one Newton step, until x is the minimum on the active rows.
    fn converge(&mut self, program: &QuadraticProgram) -> Result<(), QpError> {
        self.refine(program)?;
        while !self.refined {
            self.refine(program)?;
        }
        Ok(())
    }

    /// Starts at the unconstrained minimum, without active rows.
    fn start(&mut self, program: &QuadraticProgram) -> Result<(), QpError> {
        let (n, m) = (program.variables(), program.constraints());
        let ProgramData { stride, tall, hessian, gradient, by_variable, .. } = &self.data;
        self.factor.start(hessian, n)?;
        self.point.resize(*stride, 0.0);
        self.rounding = DEPENDENCE * self.factor.minimum(&gradient[..*stride], &mut self.point);
        self.reach = norm_padded(&self.point);
        self.size = self.reach;
        self.refined = false;
        self.active.clear();
        self.is_active[..m].fill(false);
        let norms = &mut self.norms[..*tall];
        norms.fill(0.0);
        for column in by_variable[..n * tall].chunks_exact((*tall).max(1)) {
            norms.iter_mut().zip(column).for_each(|(norm, c)| *norm += c * c);
        }
        norms.iter_mut().for_each(|norm| *norm = norm.sqrt());
        Ok(())
    }

    /// Returns the bound of a row that x violates most, or that is nearest to x.
    #[inline]
    fn violation(&self, program: &QuadraticProgram, row: usize) -> Violation {
        Violation::at(program, row, dot(program.row(row), &self.point))
    }

    /// Returns the bound of a row that x violates by more than rounding.
    #[inline]
    fn violated(&self, program: &QuadraticProgram, row: usize) -> Option<Violation> {
        let violation = self.violation(program, row);
        self.exceeds_rounding(program, &violation).then_some(violation)
    }

    /// Returns true if a violation is larger than rounding.
    #[inline]
    fn exceeds_rounding(&self, program: &QuadraticProgram, violation: &Violation) -> bool {
        let terms = self.norms[violation.row] * self.size + violation.bound(program).abs();
        violation.gap > 0.0 && violation.gap > FEASIBILITY * terms
    }

    /// Returns the bound that x violates most, measured as a distance.
    fn most_violated(&mut self, program: &QuadraticProgram) -> Option<Violation> {
        let tall = self.data.tall;
        self.values[..tall].fill(0.0);
        add_product(&self.data.by_variable, &self.point[..program.variables()], &mut self.values[..tall]);
        let (mut worst, mut farthest) = (None, 0.0);
        for row in 0..program.constraints() {
            let violation = Violation::at(program, row, self.values[row]);
            if violation.gap > farthest * self.norms[row]
                && !self.is_active[row]
                && self.exceeds_rounding(program, &violation)
            {
                farthest = violation.gap / self.norms[row];
                worst = Some(violation);
            }
        }
        worst
    }

    /// Moves x to the minimum on the last active rows, whatever the signs of their multipliers, and drops those whose
    /// multipliers are negative: all at once, whereas [`activate`](Self::activate) would drop one after another.
    fn resume(&mut self, program: &QuadraticProgram) -> Result<(), QpError> {
        for i in 0..self.last.len() {
            let (row, sign) = self.last[i];
            if row >= program.constraints() || self.is_active[row] {
                continue;
            }
            let mut new = Active::new(program, row, sign);
            self.data.load_row(program, row);
            let (growth, _) = self.turn_towards(program, row, sign)?;
            if let Some(growth) = growth.filter(|_| new.b.is_finite()) {
                let gap = new.b - sign * dot_padded(self.data.row(row), &self.point);
                self.step(gap / growth, &mut new, true);
                self.add(new);
            }
        }
        if self.active.iter().any(Active::is_superfluous) { self.converge(program) } else { Ok(()) }
    }

    /// Moves x onto the bound; drops blocking rows.
    fn activate(&mut self, program: &QuadraticProgram, violation: Violation) -> Result<(), QpError> {
        let Violation { row, sign, mut gap } = violation;
        let mut new = Active::new(program, row, sign);
        self.data.load_row(program, row);
        loop {
            let (growth, length) = self.turn_towards(program, row, sign)?;
            let blocking = self.blocking(SLOWEST * length);
            if growth.is_none() && blocking.is_none() {
                return self.contradiction(program, row);
            }
            let meet_at = growth.map_or(f64::INFINITY, |growth| gap / growth);
            let drop_at = blocking.map_or(f64::INFINITY, |(_, t)| t);
            let t = drop_at.min(meet_at);
            self.step(t, &mut new, growth.is_some());
            match blocking {
                Some((k, _)) if drop_at < meet_at => self.drop_row(k),
                _ => {
                    self.add(new);
                    return Ok(());
                }
            }
            gap = new.b - sign * dot_padded(self.data.row(row), &self.point);
        }
    }

    /// Computes the step towards a row, and returns how fast it decreases the distance, if the row is independent of the
    /// active ones, and the sum of all decreases of their multipliers.
    fn turn_towards(
        &mut self,
        program: &QuadraticProgram,
        row: usize,
        sign: f64,
    ) -> Result<(Option<f64>, f64), QpError> {
        self.count(program)?;
        let growth = self.factor.towards(self.data.row(row), sign);
        // n is N r plus a remainder; if the terms of N r are large relative to n, so is the rounding error of the
        // remainder.
        let terms = self.active.iter().zip(self.factor.fall()).map(|(a, r)| self.norms[a.row] * r.abs());
        let length: f64 = terms.sum();
        let independent = growth > (self.rounding * (self.norms[row] + length)).powi(2);
        Ok((independent.then_some(growth), length))
    }

    /// Takes a step of length t towards a new row; `moves` is false if it only changes multipliers.
    fn step(&mut self, t: f64, new: &mut Active, moves: bool) {
        new.multiplier += t;
        for (active, fall) in self.active.iter_mut().zip(self.factor.fall()) {
            active.multiplier -= t * fall;
        }
        if moves {
            axpy(t, self.factor.step(), &mut self.point);
            self.size = self.size.max(norm_padded(&self.point));
            self.refined = false;
        }
    }

    /// Activates the row of the last step.
    fn add(&mut self, new: Active) {
        self.factor.add();
        self.is_active[new.row] = true;
        self.active.push(new);
    }

    /// Returns the first inequality whose multiplier decreases to zero, and its t. A decrease below `slowest` is
    /// rounding (for rows of length 1).
    fn blocking(&self, slowest: f64) -> Option<(usize, f64)> {
        let (mut first, mut least) = (None, f64::INFINITY);
        for (k, (active, &fall)) in self.active.iter().zip(self.factor.fall()).enumerate() {
            let falls = self.norms[active.row] * fall > slowest;
            if falls && !active.equality && active.multiplier < least * fall {
                least = active.multiplier / fall;
                first = Some((k, least));
            }
        }
        first
    }

    fn drop_row(&mut self, k: usize) {
        self.factor.drop(k);
        let dropped = self.active.remove(k);
        self.is_active[dropped.row] = false;
    }

    /// Handles a row that depends on active rows which cannot be dropped: it is either satisfied up to rounding or
    /// infeasible.
    fn contradiction(&mut self, program: &QuadraticProgram, row: usize) -> Result<(), QpError> {
        let size = self.size;
        self.refine(program)?;
        self.size = self.size.max(size);
        self.refined = false;
        match self.violated(program, row) {
            Some(violation) => {
                self.remember();
                self.last.insert(0, (row, violation.sign));
                Err(QpError::Infeasible { row })
            }
            None => Ok(()),
        }
    }

    /// Takes one Newton step on the KKT conditions of the active rows. Rows with negative multipliers are dropped
    /// afterwards.
    fn refine(&mut self, program: &QuadraticProgram) -> Result<(), QpError> {
        self.count(program)?;
        let (data, point, active) = (&self.data, &mut self.point, &mut self.active);
        let gradient = |e: &mut [f64]| {
            e.copy_from_slice(&data.gradient[..e.len()]);
            add_product(&data.hessian, &point[..program.variables()], e);
            for a in active.iter() {
                axpy(-a.sign * a.multiplier, data.row(a.row), e);
            }
        };
        let gap = |k: usize| active[k].b - active[k].sign * dot_padded(data.row(active[k].row), point);
        self.factor.correct(gradient, gap);
        axpy(1.0, self.factor.step(), point);
        for (a, fall) in active.iter_mut().zip(self.factor.fall()) {
            a.multiplier -= fall;
        }
        let (length, change) = (norm_padded(point), norm_padded(self.factor.step()));
        if !change.is_finite() {
            return Err(QpError::NotFinite);
        }
        // If the solution is zero, no step is small relative to it; a step within the rounding error of the first x is
        // accepted.
        let floor = f64::EPSILON * self.reach;
        self.size = floor.max(length + change);
        self.refined = change <= floor.max(length);
        self.drop_negative();
        Ok(())
    }

    /// Drops the rows with negative multipliers; sets multipliers that are negative by rounding to zero.
    fn drop_negative(&mut self) {
        let weight = |active: &Active, norms: &[f64]| norms[active.row] * active.multiplier;
        let sizes = self.active.iter().map(|active| weight(active, &self.norms).abs());
        let largest = sizes.fold(0.0, f64::max);
        for k in (0..self.active.len()).rev() {
            let active = &mut self.active[k];
            if active.equality {
                continue;
            }
            if weight(active, &self.norms) < -FEASIBILITY * largest {
                self.drop_row(k);
                self.refined = false;
            } else {
                active.multiplier = active.multiplier.max(0.0);
            }
        }
    }

    fn count(&mut self, program: &QuadraticProgram) -> Result<(), QpError> {
        if self.iterations >= self.most_iterations * (1 + program.variables() + program.constraints()) {
            return Err(QpError::Iterations);
        }
        self.iterations += 1;
        Ok(())
    }

    fn publish(&mut self, program: &QuadraticProgram) -> Result<(), QpError> {
        // With an infinite tolerance, any row would count as satisfied.
        let longest = self.norms[..program.constraints()].iter().fold(0.0, |longest: f64, c| longest.max(*c));
        let tolerances = (longest * self.size).is_finite();
        let multipliers = self.active.iter().all(|a| a.multiplier.is_finite());
        if !(tolerances && multipliers && all_finite(&self.point)) {
            return Err(QpError::NotFinite);
        }
        self.x.clear();
        self.x.extend_from_slice(&self.point[..program.variables()]);
        self.multipliers.clear();
        self.multipliers.resize(program.constraints(), 0.0);
        for active in &self.active {
            self.multipliers[active.row] = -active.sign * active.multiplier;
        }
        self.remember();
        Ok(())
    }

    /// Lets the next solution start with the rows that another solver remembers.
    pub(crate) fn start_from(&mut self, other: &Self) {
        self.last.clone_from(&other.last);
    }

    /// Returns true if one row more than `variables` is active, and each of them pushes the solution.
    pub(crate) fn balances(&self, variables: usize) -> bool {
        let push = |active: &Active| self.norms[active.row] * active.multiplier;
        let least = CLEAR_PUSH * self.active.iter().map(push).fold(0.0, f64::max);
        self.active.len() == variables + 1 && self.active.iter().all(|active| push(active) > least)
    }

    /// Replaces the active rows of the last program by those of another solver, as far as they are independent, as the start
    /// of the next program. Returns true if they determine all variables. `program` limits the number of steps.
    pub(crate) fn exchange_active(&mut self, other: &Self, program: &QuadraticProgram) -> bool {
        let (n, stride, tall) = (self.data.variables, self.data.stride, self.data.tall);
        for k in (0..self.active.len()).rev() {
            if !other.is_active[self.active[k].row] {
                self.drop_row(k);
            }
        }
        for &Active { row, sign, b, .. } in &other.active {
            if self.active.len() == n {
                break;
            }
            if self.is_active[row] {
                continue;
            }
            let (copy, column) = (&mut self.data.rows[row * stride..], &self.data.by_variable[row..]);
            copy.iter_mut().zip(column.iter().step_by(tall)).take(n).for_each(|(copy, x)| *copy = *x);
            copy[n..stride].fill(0.0);
            if let Ok((Some(_), _)) = self.turn_towards(program, row, sign) {
                self.add(Active { row, sign, b, multiplier: 0.0, equality: false });
            }
        }
        self.remember();
        self.active.len() == n
    }

    /// Stores the active rows as those that the next solution starts with.
    fn remember(&mut self) {
        self.last.clear();
        self.last.extend(self.active.iter().map(|active| (active.row, active.sign)));
    }
}

impl Violation {
    /// Returns the bound of a row that its value violates most, or that is nearest to it.
    #[inline]
    fn at(program: &QuadraticProgram, row: usize, value: f64) -> Self {
        let (below, above) = (program.lower[row] - value, value - program.upper[row]);
        let (sign, gap) = if below > above { (1.0, below) } else { (-1.0, above) };
        Self { row, sign, gap }
    }

    fn bound(&self, program: &QuadraticProgram) -> f64 {
        if self.sign > 0.0 { program.lower[self.row] } else { program.upper[self.row] }
    }
}

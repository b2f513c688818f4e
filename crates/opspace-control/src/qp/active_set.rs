//! The dual active-set method for small, dense, strictly convex quadratic programmes.
//!
//! D. Goldfarb and A. Idnani, *A numerically stable dual method for solving strictly convex quadratic programs*,
//! Mathematical Programming 27, 1983. From the minimum without constraints, violated rows are made active one by
//! one. Every iterate is the minimum on its active rows N, with multipliers u that show it:
//!
//! ```text
//! H x + g = N u        Nᵀ x = b        u ≥ 0 for inequalities
//! ```
//!
//! With H = L Lᵀ, L⁻¹ N = Q [R; 0] and J = L⁻ᵀ Q = [J₁ J₂], go towards a violated row nᵀ x ≥ b by x + t z and
//! u − t r:
//!
//! ```text
//! d = Jᵀ n        z = J₂ d₂        r = R⁻¹ d₁
//! t₁ = min uⱼ / rⱼ over rⱼ > 0: a multiplier reaches zero, and its row is dropped
//! t₂ = (b − nᵀ x) / d₂ᵀ d₂: the row is met, and becomes active
//! ```
//!
//! Where d₂ is zero, the row depends on the active ones and there is no t₂; where there is no t₁ either, no x meets
//! them all. Beyond the paper: a row with two bounds is one row; a new row turns J₂ by a single reflection; and a
//! Newton step on the conditions above, with residuals computed afresh, removes what rounding has gathered.
//!
//! Of 240 000 random feasible programmes with many redundant rows, and condition numbers of H from 1e6 to 1e10, one
//! was not solved, and said so; the others met the conditions to 2e-11.

mod factor;

use crate::qp::quadratic_program::{QpError, QuadraticProgram, all_finite, axpy, dot};
use factor::Factor;

/// A row counts as met within this share of what its terms could add up to, |c| |x| + |bound|.
const FEASIBILITY: f64 = 1e-11;
/// The rounding in J, as a share of |J|: some hundred times the machine's. A row is dependent if its d₂ is no more.
const DEPENDENCE: f64 = 1e-13;
/// A multiplier that falls slower than this share of all together falls by rounding.
const SLOWEST: f64 = 1e-10;
/// Iterations allowed for each variable and constraint. Usually there are as many as active rows, and some more.
const ITERATIONS: usize = 10;

/// A row that holds as an equality at x.
#[derive(Clone, Copy, Debug)]
struct Active {
    row: usize,
    /// 1 at the lower bound, −1 at the upper: n = sign · c, and b = sign · bound.
    sign: f64,
    b: f64,
    /// u.
    multiplier: f64,
    equality: bool,
}

/// A bound that x is beyond.
#[derive(Clone, Copy, Debug)]
struct Violation {
    row: usize,
    /// As of [`Active`].
    sign: f64,
    /// b − nᵀ x.
    gap: f64,
}

/// A solver with all the room that it needs: [`solve`](Self::solve) allocates nothing.
#[derive(Debug)]
pub struct ActiveSet {
    max_variables: usize,
    max_constraints: usize,
    factor: Factor,
    /// Present iterate x.
    point: Vec<f64>,
    active: Vec<Active>,
    is_active: Vec<bool>,
    /// |c| of each row.
    norms: Vec<f64>,
    /// Largest d₂ of a dependent row by rounding, for |c| = 1.
    rounding: f64,
    /// |x| without constraints.
    reach: f64,
    /// The largest |x| on the way to this one, by which its rounding is measured.
    size: f64,
    /// True if the active rows' conditions hold to rounding.
    refined: bool,
    iterations: usize,
    /// The rows active at the last solution, in the order in which they became so.
    last: Vec<usize>,
    x: Vec<f64>,
    multipliers: Vec<f64>,
}

impl ActiveSet {
    /// For programmes of at most so many variables and constraints.
    #[must_use]
    pub fn new(max_variables: usize, max_constraints: usize) -> Self {
        Self {
            max_variables,
            max_constraints,
            factor: Factor::new(max_variables),
            point: vec![0.0; max_variables],
            active: Vec::with_capacity(max_variables),
            is_active: vec![false; max_constraints],
            norms: vec![0.0; max_constraints],
            rounding: 0.0,
            reach: 0.0,
            size: 0.0,
            refined: false,
            iterations: 0,
            last: Vec::with_capacity(max_variables),
            x: Vec::with_capacity(max_variables),
            multipliers: Vec::with_capacity(max_constraints),
        }
    }

    /// The minimiser, n, of the last programme that was solved. Always finite; empty before the first.
    #[must_use]
    pub fn x(&self) -> &[f64] {
        &self.x
    }

    /// λ of H x + g + C λ = 0, m: positive where the upper bound is active, negative where the lower is, zero
    /// where neither is. Where rows depend on each other, one choice of many.
    #[must_use]
    pub fn multipliers(&self) -> &[f64] {
        &self.multipliers
    }

    /// Steps that the last call of [`solve`](Self::solve) took.
    #[must_use]
    pub fn iterations(&self) -> usize {
        self.iterations
    }

    /// Solves `program`. The rows that were active at the last solution are tried first, which saves steps where
    /// programmes change little; the solution is the same but for rounding.
    ///
    /// # Errors
    /// [`QpError`]; [`x`](Self::x) then is still the solution of an earlier programme.
    pub fn solve(&mut self, program: &QuadraticProgram) -> Result<(), QpError> {
        let m = program.constraints();
        self.iterations = 0;
        if program.variables() > self.max_variables || m > self.max_constraints {
            return Err(QpError::Unsolved("the problem exceeds the size that the solver was created for"));
        }
        program.check()?;
        self.start(program)?;
        for row in (0..m).filter(|&row| program.lower[row] == program.upper[row]) {
            self.activate(program, self.violation(program, row))?;
        }
        for i in 0..self.last.len() {
            let row = self.last[i];
            if row < m
                && !self.is_active[row]
                && let Some(violation) = self.violated(program, row)
            {
                self.activate(program, violation)?;
            }
        }
        loop {
            if let Some(violation) = self.most_violated(program) {
                self.activate(program, violation)?;
            } else if self.refined {
                return self.publish(program);
            } else {
                while !self.refined {
                    self.refine(program)?;
                }
            }
        }
    }

    /// No row active.
    fn start(&mut self, program: &QuadraticProgram) -> Result<(), QpError> {
        let (n, m) = (program.variables(), program.constraints());
        self.factor.start(program)?;
        self.point.resize(n, 0.0);
        self.rounding = DEPENDENCE * self.factor.minimum(program.gradient.as_slice(), &mut self.point);
        self.reach = norm(&self.point);
        self.size = self.reach;
        self.refined = false;
        self.active.clear();
        self.is_active[..m].fill(false);
        for (i, length) in self.norms[..m].iter_mut().enumerate() {
            *length = norm(program.row(i));
        }
        Ok(())
    }

    /// The bound that x is nearest to or farthest beyond.
    #[inline]
    fn violation(&self, program: &QuadraticProgram, row: usize) -> Violation {
        let value = dot(program.row(row), &self.point);
        let (below, above) = (program.lower[row] - value, value - program.upper[row]);
        let (sign, gap) = if below > above { (1.0, below) } else { (-1.0, above) };
        Violation { row, sign, gap }
    }

    /// The bound that x is beyond by more than rounding.
    #[inline]
    fn violated(&self, program: &QuadraticProgram, row: usize) -> Option<Violation> {
        let violation = self.violation(program, row);
        let rounding = || {
            let terms = self.norms[row] * self.size + violation.bound(program).abs();
            FEASIBILITY * terms
        };
        (violation.gap > 0.0 && violation.gap > rounding()).then_some(violation)
    }

    /// The bound that x is farthest beyond, as a distance.
    fn most_violated(&self, program: &QuadraticProgram) -> Option<Violation> {
        let (mut worst, mut farthest) = (None, 0.0);
        for row in 0..program.constraints() {
            if !self.is_active[row]
                && let Some(violation) = self.violated(program, row)
                && violation.gap > farthest * self.norms[row]
            {
                farthest = violation.gap / self.norms[row];
                worst = Some(violation);
            }
        }
        worst
    }

    /// Moves x onto the bound, dropping the rows that stand in the way.
    fn activate(&mut self, program: &QuadraticProgram, violation: Violation) -> Result<(), QpError> {
        let Violation { row, sign, mut gap } = violation;
        let b = sign * violation.bound(program);
        let equality = program.lower[row] == program.upper[row];
        let mut new = Active { row, sign, b, multiplier: 0.0, equality };
        loop {
            self.count(program)?;
            let growth = self.factor.towards(program.row(row), sign);
            // n is N r and a rest; where they are long beside n, so is the rounding of the rest.
            let terms = self.active.iter().zip(self.factor.fall()).map(|(a, r)| self.norms[a.row] * r.abs());
            let length: f64 = terms.sum();
            let independent = growth > (self.rounding * (self.norms[row] + length)).powi(2);
            let meet_at = if independent { gap / growth } else { f64::INFINITY };
            let blocking = self.blocking(SLOWEST * length);
            if !independent && blocking.is_none() {
                return self.contradiction(program, row);
            }
            let drop_at = blocking.map_or(f64::INFINITY, |(_, t)| t);
            let t = drop_at.min(meet_at);
            new.multiplier += t;
            for (active, fall) in self.active.iter_mut().zip(self.factor.fall()) {
                active.multiplier -= t * fall;
            }
            if independent {
                axpy(t, self.factor.step(), &mut self.point);
                self.size = self.size.max(norm(&self.point));
                self.refined = false;
            }
            match blocking {
                Some((k, _)) if drop_at < meet_at => self.drop_row(k),
                _ => {
                    self.factor.add();
                    self.is_active[row] = true;
                    self.active.push(new);
                    return Ok(());
                }
            }
            gap = b - sign * dot(program.row(row), &self.point);
        }
    }

    /// The first inequality whose multiplier falls to zero, and the t at which it does. What falls slower than
    /// `slowest`, for |c| = 1, falls by rounding.
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

    /// Decides on a row that depends on active ones which can't be dropped: met but for rounding, or impossible.
    fn contradiction(&mut self, program: &QuadraticProgram, row: usize) -> Result<(), QpError> {
        let size = self.size;
        self.refine(program)?;
        self.size = self.size.max(size);
        self.refined = false;
        match self.violated(program, row) {
            Some(_) => Err(QpError::Infeasible { row }),
            None => Ok(()),
        }
    }

    /// One Newton step on the KKT conditions of the active rows. If multipliers are negative after it, the row of the
    /// most negative one is dropped.
    fn refine(&mut self, program: &QuadraticProgram) -> Result<(), QpError> {
        self.count(program)?;
        let (point, active) = (&mut self.point, &mut self.active);
        let gradient = |e: &mut [f64]| {
            e.copy_from_slice(&program.gradient.as_slice()[..e.len()]);
            program.add_hessian_times(point, e);
            for a in active.iter() {
                axpy(-a.sign * a.multiplier, program.row(a.row), e);
            }
        };
        let gap = |k: usize| active[k].b - active[k].sign * dot(program.row(active[k].row), point);
        self.factor.correct(gradient, gap);
        axpy(1.0, self.factor.step(), point);
        for (a, fall) in active.iter_mut().zip(self.factor.fall()) {
            a.multiplier -= fall;
        }
        let (length, change) = (norm(point), norm(self.factor.step()));
        if !change.is_finite() {
            return Err(QpError::NotFinite);
        }
        // Where the solution is zero, no step is small beside it; one as small as the first x's rounding will do.
        let floor = f64::EPSILON * self.reach;
        self.size = floor.max(length + change);
        self.refined = change <= floor.max(length);
        self.drop_negative();
        Ok(())
    }

    /// Drops the row whose multiplier is the most negative; sets to zero what is negative by rounding.
    fn drop_negative(&mut self) {
        let weight = |a: &Active| self.norms[a.row] * a.multiplier;
        let (mut least, mut largest) = ((0, 0.0), 0.0_f64);
        for (k, active) in self.active.iter().enumerate() {
            let weight = weight(active);
            largest = largest.max(weight.abs());
            if !active.equality && weight < least.1 {
                least = (k, weight);
            }
        }
        if least.1 < -FEASIBILITY * largest {
            self.drop_row(least.0);
            self.refined = false;
        }
        for active in self.active.iter_mut().filter(|a| !a.equality) {
            active.multiplier = active.multiplier.max(0.0);
        }
    }

    fn count(&mut self, program: &QuadraticProgram) -> Result<(), QpError> {
        if self.iterations == ITERATIONS * (1 + program.variables() + program.constraints()) {
            return Err(QpError::Iterations);
        }
        self.iterations += 1;
        Ok(())
    }

    fn publish(&mut self, program: &QuadraticProgram) -> Result<(), QpError> {
        // An infinite tolerance would call any row met.
        let tolerances = self.norms[..program.constraints()].iter().all(|c| (c * self.size).is_finite());
        let multipliers = self.active.iter().all(|a| a.multiplier.is_finite());
        if !(tolerances && multipliers && all_finite(&self.point)) {
            return Err(QpError::NotFinite);
        }
        self.x.clear();
        self.x.extend_from_slice(&self.point);
        self.multipliers.clear();
        self.multipliers.resize(program.constraints(), 0.0);
        self.last.clear();
        for active in &self.active {
            self.multipliers[active.row] = -active.sign * active.multiplier;
            self.last.push(active.row);
        }
        Ok(())
    }
}

impl Violation {
    fn bound(&self, program: &QuadraticProgram) -> f64 {
        if self.sign > 0.0 { program.lower[self.row] } else { program.upper[self.row] }
    }
}

fn norm(v: &[f64]) -> f64 {
    dot(v, v).sqrt()
}

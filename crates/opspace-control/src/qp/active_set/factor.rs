//! The matrices J and R of the active rows N, and the steps computed with them.
//!
//! ```text
//! H = L Lᵀ        L⁻¹ N = Q [R; 0]        J = L⁻ᵀ Q = [J₁ J₂]        Jᵀ H J = I        Jᵀ N = [R; 0]
//! ```

use crate::qp::quadratic_program::{QpError, QuadraticProgram, axpy, dot};

/// Factors for n variables and q active rows.
#[derive(Debug)]
pub(super) struct Factor {
    n: usize,
    q: usize,
    /// J, n × n by columns.
    j: Vec<f64>,
    /// R, in the upper triangle of n × n by columns; initially L.
    r: Vec<f64>,
    d: Vec<f64>,
    step: Vec<f64>,
    fall: Vec<f64>,
}

impl Factor {
    pub(super) fn new(max_variables: usize) -> Self {
        let vector = vec![0.0; max_variables];
        let square = vec![0.0; max_variables * max_variables];
        Self {
            n: 0,
            q: 0,
            j: square.clone(),
            r: square,
            d: vector.clone(),
            step: vector.clone(),
            fall: vector,
        }
    }

    /// Sets J = L⁻ᵀ without active rows.
    pub(super) fn start(&mut self, program: &QuadraticProgram) -> Result<(), QpError> {
        let n = program.variables();
        (self.n, self.q) = (n, 0);
        program.cholesky(&mut self.r[..n * n])?;
        for k in 0..n {
            let column = &mut self.j[k * n..(k + 1) * n];
            column.fill(0.0);
            column[k] = self.r[k * n + k];
            for i in (0..k).rev() {
                let factor = &self.r[i * n + i..=i * n + k];
                column[i] = -factor[0] * dot(&factor[1..], &column[i + 1..=k]);
            }
        }
        Ok(())
    }

    /// Computes x = −H⁻¹ g and returns the Frobenius norm |J|. Call it directly after [`start`](Self::start).
    pub(super) fn minimum(&self, gradient: &[f64], x: &mut [f64]) -> f64 {
        x.fill(0.0);
        let mut squares = 0.0;
        for (k, column) in columns(&self.j, self.n).take(self.n).enumerate() {
            let column = &column[..=k];
            squares += dot(column, column);
            axpy(-dot(column, gradient), column, x);
        }
        squares.sqrt()
    }

    /// Computes, for n = sign · row, d = Jᵀ n, the step J₂ d₂ of x and the decrease R⁻¹ d₁ of the multipliers. Returns
    /// d₂ᵀ d₂, the increase of nᵀ x.
    pub(super) fn towards(&mut self, row: &[f64], sign: f64) -> f64 {
        let (n, q) = (self.n, self.q);
        for (d, column) in self.d[..n].iter_mut().zip(columns(&self.j, n)) {
            *d = sign * dot(column, row);
        }
        let free = &self.d[q..n];
        self.step[..n].fill(0.0);
        for (d, column) in free.iter().zip(columns(&self.j, n).skip(q)) {
            axpy(*d, column, &mut self.step[..n]);
        }
        let growth = dot(free, free);
        self.fall[..q].copy_from_slice(&self.d[..q]);
        self.solve_r();
        growth
    }

    /// Step of x (n).
    pub(super) fn step(&self) -> &[f64] {
        &self.step[..self.n]
    }

    /// Decrease of the multipliers in a step (q).
    pub(super) fn fall(&self) -> &[f64] {
        &self.fall[..self.q]
    }

    /// Activates the row of the last call of [`towards`](Self::towards). The reflection I − β v vᵀ that maps d₂ to δ e₁
    /// makes [R; 0] with d triangular, and J₂ v is the step minus δ J₂ e₁.
    pub(super) fn add(&mut self) {
        let (n, q) = (self.n, self.q);
        let v = &mut self.d[q..n];
        let length = dot(v, v).sqrt();
        let delta = -length.copysign(v[0]);
        let beta = 1.0 / (length * (length + v[0].abs()));
        let free = &mut self.j[q * n..n * n];
        let product = &mut self.step[..n];
        axpy(-delta, &free[..n], product);
        v[0] -= delta;
        for (v, column) in v.iter().zip(free.chunks_exact_mut(n)) {
            axpy(-beta * v, product, column);
        }
        v[0] = delta;
        self.r[q * n..=q * n + q].copy_from_slice(&self.d[..=q]);
        self.q += 1;
    }

    /// Removes the k-th active row. One rotation per following column makes R without its column triangular again.
    pub(super) fn drop(&mut self, k: usize) {
        self.q -= 1;
        let (n, q) = (self.n, self.q);
        for i in k..q {
            self.r.copy_within((i + 1) * n..=(i + 1) * n + i + 1, i * n);
        }
        for i in k..q {
            let (a, b) = (self.r[i * n + i], self.r[i * n + i + 1]);
            let length = a.hypot(b);
            let (cos, sin) = (a / length, b / length);
            let rotate = |a: &mut f64, b: &mut f64| (*a, *b) = (cos * *a + sin * *b, cos * *b - sin * *a);
            for column in self.r[..q * n].chunks_exact_mut(n).skip(i) {
                let (above, below) = column.split_at_mut(i + 1);
                rotate(&mut above[i], &mut below[0]);
            }
            let (left, right) = self.j[i * n..(i + 2) * n].split_at_mut(n);
            left.iter_mut().zip(right).for_each(|(a, b)| rotate(a, b));
        }
    }

    /// Computes the step of x and the decrease of u, with Δx = J y, from
    ///
    /// ```text
    /// H Δx − N Δu = −e        Nᵀ Δx = f
    /// Rᵀ y₁ = f               y₂ = −J₂ᵀ e        R Δu = y₁ + J₁ᵀ e
    /// ```
    ///
    /// with e (n), which `gradient` first writes into the step, and f, which `gap` gives for each active row.
    pub(super) fn correct(&mut self, gradient: impl FnOnce(&mut [f64]), gap: impl Fn(usize) -> f64) {
        let (n, q) = (self.n, self.q);
        let step = &mut self.step[..n];
        gradient(step);
        for (d, column) in self.d[..n].iter_mut().zip(columns(&self.j, n)) {
            *d = dot(column, step);
        }
        for i in 0..q {
            let column = &self.r[i * n..=i * n + i];
            self.fall[i] = (gap(i) - dot(column, &self.fall[..i])) / column[i];
        }
        let y = self.fall[..q].iter().copied().chain(self.d[q..n].iter().map(|d| -d));
        step.fill(0.0);
        for (y, column) in y.zip(columns(&self.j, n)) {
            axpy(y, column, step);
        }
        for (fall, d) in self.fall[..q].iter_mut().zip(&self.d) {
            *fall = -*fall - d;
        }
        self.solve_r();
    }

    /// Replaces the decrease of the multipliers by R⁻¹ times it.
    fn solve_r(&mut self) {
        for i in (0..self.q).rev() {
            let column = &self.r[i * self.n..=i * self.n + i];
            let (above, fall) = self.fall.split_at_mut(i);
            fall[0] /= column[i];
            axpy(-fall[0], column, above);
        }
    }
}

/// Columns of an n × n matrix. The chunk length is at least 1, because a length of zero panics.
fn columns(matrix: &[f64], n: usize) -> impl Iterator<Item = &[f64]> {
    matrix.chunks_exact(n.max(1))
}

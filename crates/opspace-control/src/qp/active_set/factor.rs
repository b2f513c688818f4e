//! The matrices J and R of the active rows N, and the steps computed with them.
//!
//! ```text
//! H = L Lᵀ        L⁻¹ N = Q [R; 0]        J = L⁻ᵀ Q = [J₁ J₂]        Jᵀ H J = I        Jᵀ N = [R; 0]
//! ```
//!
//! Columns and vectors of n numbers are [padded](crate::qp::padded).

use crate::qp::padded::{add_outer_product, add_product, buffer, dot_padded, padded, transposed_product};
use crate::qp::quadratic_program::{PIVOT_SHARE, QpError, axpy, dot};

/// Factors for n variables and q active rows.
#[derive(Debug)]
pub(super) struct Factor {
    n: usize,
    q: usize,
    /// Length of a padded column.
    stride: usize,
    /// J, n columns.
    j: Vec<f64>,
    /// R, in the upper triangle of n columns; initially L without its diagonal.
    r: Vec<f64>,
    d: Vec<f64>,
    step: Vec<f64>,
    fall: Vec<f64>,
}

impl Factor {
    pub(super) fn new(max_variables: usize) -> Self {
        let vector = buffer(padded(max_variables));
        let square = buffer(max_variables * padded(max_variables));
        Self {
            n: 0,
            q: 0,
            stride: 0,
            j: square.clone(),
            r: square,
            d: vector.clone(),
            step: vector.clone(),
            fall: vector,
        }
    }

    /// Sets J = L⁻ᵀ without active rows, for H with n columns.
    pub(super) fn start(&mut self, hessian: &[f64], n: usize) -> Result<(), QpError> {
        let stride = padded(n);
        (self.n, self.q, self.stride) = (n, 0, stride);
        self.r[..n * stride].copy_from_slice(&hessian[..n * stride]);
        for k in 0..n {
            let (left, right) = self.r[k * stride..n * stride].split_at_mut(stride);
            let diagonal = hessian[k * stride + k];
            let pivot = left[k];
            if pivot.is_nan() || pivot <= PIVOT_SHARE * diagonal.abs() {
                return Err(QpError::NotConvex);
            }
            let inverse = 1.0 / pivot.sqrt();
            left[..=k].fill(0.0);
            left[k + 1..n].iter_mut().for_each(|x| *x *= inverse);
            // The other columns minus their parts along column k of L.
            for (s, x) in self.step.iter_mut().zip(&left[k + 1..n]) {
                *s = -x;
            }
            add_outer_product(right, left, &self.step[..n - k - 1]);
            self.d[k] = inverse;
        }
        for k in 0..n {
            for i in 0..k {
                self.step[i] = -self.d[k] * self.r[i * stride + k];
            }
            let (left, right) = self.j.split_at_mut(k * stride);
            let column = &mut right[..stride];
            column.fill(0.0);
            column[k] = self.d[k];
            add_product(left, &self.step[..k], column);
        }
        Ok(())
    }

    /// Computes x = −H⁻¹ g and returns the Frobenius norm |J|. Call it directly after [`start`](Self::start).
    pub(super) fn minimum(&mut self, gradient: &[f64], x: &mut [f64]) -> f64 {
        let (n, length) = (self.n, self.n * self.stride);
        transposed_product(&self.j[..length], gradient, &mut self.d[..n]);
        self.d[..n].iter_mut().for_each(|d| *d = -*d);
        x.fill(0.0);
        add_product(&self.j[..length], &self.d[..n], x);
        dot_padded(&self.j[..length], &self.j[..length]).sqrt()
    }

    /// Computes, for n = sign · row, d = Jᵀ n, the step J₂ d₂ of x and the decrease R⁻¹ d₁ of the multipliers. Returns
    /// d₂ᵀ d₂, the increase of nᵀ x.
    pub(super) fn towards(&mut self, row: &[f64], sign: f64) -> f64 {
        let (n, q, stride) = (self.n, self.q, self.stride);
        transposed_product(&self.j[..n * stride], row, &mut self.d[..n]);
        self.d[..n].iter_mut().for_each(|d| *d *= sign);
        let free = &self.d[q..n];
        self.step[..stride].fill(0.0);
        add_product(&self.j[q * stride..n * stride], free, &mut self.step[..stride]);
        let growth = dot(free, free);
        self.fall[..q].copy_from_slice(&self.d[..q]);
        self.solve_r();
        growth
    }

    /// Step of x (n).
    pub(super) fn step(&self) -> &[f64] {
        &self.step[..self.stride]
    }

    /// Decrease of the multipliers in a step (q).
    pub(super) fn fall(&self) -> &[f64] {
        &self.fall[..self.q]
    }

    /// Activates the row of the last call of [`towards`](Self::towards). The reflection I − β v vᵀ that maps d₂ to δ e₁
    /// makes [R; 0] with d triangular, and J₂ v is the step minus δ J₂ e₁.
    pub(super) fn add(&mut self) {
        let (n, q, stride) = (self.n, self.q, self.stride);
        let v = &mut self.d[q..n];
        let length = dot(v, v).sqrt();
        let delta = -length.copysign(v[0]);
        let beta = 1.0 / (length * (length + v[0].abs()));
        let free = &mut self.j[q * stride..n * stride];
        let product = &mut self.step[..stride];
        axpy(-delta, &free[..stride], product);
        v[0] -= delta;
        v.iter_mut().for_each(|v| *v *= -beta);
        add_outer_product(free, product, v);
        v[0] = delta;
        self.r[q * stride..=q * stride + q].copy_from_slice(&self.d[..=q]);
        self.q += 1;
    }

    /// Removes the k-th active row. One rotation per following column makes R without its column triangular again.
    pub(super) fn drop(&mut self, k: usize) {
        self.q -= 1;
        let (q, stride) = (self.q, self.stride);
        for i in k..q {
            self.r.copy_within((i + 1) * stride..=(i + 1) * stride + i + 1, i * stride);
        }
        for i in k..q {
            let (a, b) = (self.r[i * stride + i], self.r[i * stride + i + 1]);
            let length = a.hypot(b);
            let (cos, sin) = (a / length, b / length);
            let rotate = |a: &mut f64, b: &mut f64| (*a, *b) = (cos * *a + sin * *b, cos * *b - sin * *a);
            for column in self.r[..q * stride].chunks_exact_mut(stride).skip(i) {
                let (above, below) = column.split_at_mut(i + 1);
                rotate(&mut above[i], &mut below[0]);
            }
            let (left, right) = self.j[i * stride..(i + 2) * stride].split_at_mut(stride);
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
        let (n, q, stride) = (self.n, self.q, self.stride);
        let (j, step) = (&self.j[..n * stride], &mut self.step[..stride]);
        gradient(step);
        transposed_product(j, step, &mut self.d[..n]);
        for i in 0..q {
            let column = &self.r[i * stride..=i * stride + i];
            self.fall[i] = (gap(i) - dot(column, &self.fall[..i])) / column[i];
        }
        // d becomes y, and the decrease of the multipliers R times it.
        for (fall, d) in self.fall[..q].iter_mut().zip(&mut self.d) {
            (*d, *fall) = (*fall, -*fall - *d);
        }
        self.d[q..n].iter_mut().for_each(|d| *d = -*d);
        step.fill(0.0);
        add_product(j, &self.d[..n], step);
        self.solve_r();
    }

    /// Replaces the decrease of the multipliers by R⁻¹ times it.
    fn solve_r(&mut self) {
        for i in (0..self.q).rev() {
            let column = &self.r[i * self.stride..=i * self.stride + i];
            let (above, fall) = self.fall.split_at_mut(i);
            fall[0] /= column[i];
            axpy(-fall[0], column, above);
        }
    }
}

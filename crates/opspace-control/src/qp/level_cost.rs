//! Costs of levels other than plain least squares: scaled tasks, weighted joints, and the resistance of joints.
//!
//! A scaled level has one more variable, the reduction t. With y the deviation of its accelerations (J_p δ of rows, N δ of
//! joints), v the predicted velocity, h the horizon and the metric G (D Λ D of rows, D M D of joints, with weights D),
//!
//! ```text
//! min A² |y + t v/|v|_G|²_G + t²,    0 ≤ t ≤ |v|_G/h
//! ```
//!
//! Without other deviations, y = −t v/|v| reduces the predicted velocity by the factor s = 1 − t h/|v|, at the cost
//! (1 − s)² |v|²/h². A is the weight of all other deviations.

use crate::algebra::multiply;
use crate::qp::quadratic_program::{QuadraticProgram, dot};
use nalgebra::{DMatrix, Matrix6, Matrix6xX, Vector6};

/// Weight A of the deviations of a scaled level from its direction, relative to its reduction. The optimum remains
/// continuous where the limits exclude the direction; a larger weight would be lost in the accuracy of the solver.
const DIRECTION: f64 = 100.0;

/// Share of the trace of a scaled level that determines its proximal steps: its reduction must cost more than these.
const PROXIMAL_SHARE: f64 = 100.0 / (DIRECTION * DIRECTION);

/// Speed of the joints above which they have a direction, rad/s or m/s; it exceeds the velocity noise at rest.
const STILL: f64 = 0.01;

/// Velocity that a scaled level reduces, and the horizon at which it is predicted, s.
#[derive(Clone, Copy)]
pub(crate) struct Reducible<V> {
    pub velocity: V,
    pub horizon_s: f64,
}

/// Sets the cost of a scaled task, with J_p (6 × n) and joint accelerations that are multiplied by `scale` (n), and
/// returns the trace that determines its proximal steps, and the largest reduction. The kinetic energy `still` is added
/// to that of the velocity, so that a task at rest has no direction.
pub(crate) fn scale_rows(
    hessian: &mut DMatrix<f64>,
    jacobian: &Matrix6xX<f64>,
    metric: &Matrix6<f64>,
    scale: &[f64],
    reducible: &Reducible<Vector6<f64>>,
    still: f64,
) -> (f64, f64) {
    let (n, weight) = (scale.len(), DIRECTION * DIRECTION);
    let momentum = metric * reducible.velocity;
    let energy = reducible.velocity.dot(&momentum).max(0.0);
    let size = (energy + still).max(f64::MIN_POSITIVE).sqrt();
    let mut trace = 0.0;
    for c in 0..n {
        let right = jacobian.column(c) / scale[c];
        let weighed = metric * right * weight;
        for r in c..n {
            hessian[(r, c)] = jacobian.column(r).dot(&weighed) / scale[r];
        }
        hessian[(n, c)] = weight / size * momentum.dot(&right);
        trace += hessian[(c, c)];
    }
    hessian[(n, n)] = weight * energy / (size * size) + 1.0;
    (PROXIMAL_SHARE * trace, size / reducible.horizon_s)
}

/// Joint accelerations of the variables of a level (n × k), and their metric.
pub(crate) struct JointSpace<'a> {
    pub accelerations: &'a [f64],
    /// M, its rows and columns divided by `scale` (n × n).
    pub mass: &'a DMatrix<f64>,
    /// Scale of the joint accelerations (n).
    pub scale: &'a [f64],
    /// Weights D of the joints (n); 1 if absent.
    pub weights: Option<&'a [f64]>,
}

impl JointSpace<'_> {
    /// Writes D M D x into `product` (n).
    fn weigh(&self, x: &[f64], product: &mut [f64]) {
        let factor = |i: usize| self.scale[i] * self.weights.map_or(1.0, |weights| weights[i]);
        product.fill(0.0);
        for (i, (column, x)) in self.mass.as_slice().chunks_exact(product.len()).zip(x).enumerate() {
            let x = x * factor(i);
            product.iter_mut().zip(column).for_each(|(sum, m)| *sum += m * x);
        }
        product.iter_mut().enumerate().for_each(|(i, x)| *x *= factor(i));
    }
}

/// Sets the cost of all joints, scaled if there is a velocity to reduce, and returns the trace that determines its
/// proximal steps, and the largest reduction. `product` (n) is overwritten.
pub(crate) fn weigh_joints(
    program: &mut QuadraticProgram,
    space: &JointSpace<'_>,
    reducible: Option<Reducible<&[f64]>>,
    product: &mut [f64],
) -> (f64, Option<f64>) {
    let (n, hessian) = (product.len(), &mut program.hessian);
    let columns = || space.accelerations.chunks_exact(n).enumerate();
    let weight = if reducible.is_some() { DIRECTION * DIRECTION } else { 1.0 };
    let mut trace = 0.0;
    for (c, column) in columns() {
        space.weigh(column, product);
        for (r, row) in columns().skip(c) {
            hessian[(r, c)] = weight * dot(row, product);
        }
        trace += hessian[(c, c)];
    }
    let Some(Reducible { velocity, horizon_s }) = reducible else { return (trace, None) };
    space.weigh(velocity, product);
    let energy = dot(velocity, product).max(0.0);
    let still = STILL * STILL * space.scale.iter().map(|scale| scale * scale).sum::<f64>();
    let size = (energy + still).sqrt();
    let last = columns().count();
    for (c, column) in columns() {
        hessian[(last, c)] = weight / size * dot(column, product);
    }
    hessian[(last, last)] = weight * energy / (size * size) + 1.0;
    (PROXIMAL_SHARE * trace, Some(size / horizon_s))
}

/// Adds `weight` |δ + α − α_passive|²_M to a Hessian (lower triangle, n × n), and writes its gradient at δ = 0 into
/// `pull` (n), for δ in units of 1/`scale` (n) and the accordingly scaled `mass` (n × n). `scratch` (n) is overwritten.
pub(crate) fn add_resistance(
    hessian: &mut DMatrix<f64>,
    mass: &DMatrix<f64>,
    weight: f64,
    deviation: impl Iterator<Item = f64>,
    scratch: &mut [f64],
    pull: &mut [f64],
) {
    let n = pull.len();
    for c in 0..n {
        for r in c..n {
            hessian[(r, c)] += weight * mass[(r, c)];
        }
    }
    scratch.iter_mut().zip(deviation).for_each(|(x, deviation)| *x = weight * deviation);
    multiply(mass, scratch, pull);
}

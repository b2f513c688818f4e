//! The active-set method never allocates, not even in a failure; the interior-point method allocates as documented.

use nalgebra::{DMatrix, DVector};
use opspace_control::qp::active_set::ActiveSet;
use opspace_control::qp::interior_point::InteriorPoint;
use opspace_control::qp::quadratic_program::{QpError, QuadraticProgram};
use opspace_testing::allocation::counted;

/// A program with n variables in a box and n further rows, the first of which is an equality.
fn programme(n: usize, tick: usize) -> QuadraticProgram {
    let mut program = QuadraticProgram::new(n, 2 * n);
    let a = DMatrix::from_fn(n, n, |i, k| (1.7 * (i * n + k) as f64).sin());
    program.hessian = a.tr_mul(&a) + DMatrix::identity(n, n) * 0.01;
    program.gradient = DVector::from_fn(n, |k, _| (k as f64 + tick as f64).sin());
    program.rows.fill_with_identity();
    for i in n..2 * n {
        program.row_mut(i).iter_mut().enumerate().for_each(|(k, c)| *c = (0.9 * (i * n + k) as f64).cos());
    }
    program.lower.fill(-0.3);
    program.upper.fill(0.3);
    (program.lower[n], program.upper[n]) = (0.1, 0.1);
    program
}

/// Counts allocations for programs of several sizes and with changing active rows, and after each kind of failure.
#[test]
fn active_set_allocates_nothing() {
    let mut solver = ActiveSet::new(12, 24);
    let mut steps = 0;
    for tick in 0..40 {
        for n in [1, 7, 12, 4] {
            let good = programme(n, tick);
            let [mut contradiction, mut concave, mut wrong] = [good.clone(), good.clone(), good.clone()];
            contradiction.lower[2 * n - 1] = 1e3;
            contradiction.upper[2 * n - 1] = 2e3;
            concave.hessian[(n - 1, n - 1)] = -1.0;
            wrong.rows[(0, n)] = f64::NAN;
            for (program, expected) in [
                (&good, None),
                (&contradiction, Some("infeasible")),
                (&concave, Some("not convex")),
                (&wrong, Some("not finite")),
            ] {
                let (result, count) = counted(|| solver.solve(program));
                assert_eq!(count.allocations, 0, "n = {n}, {result:?}");
                let failure = result.err().map(|error| match error {
                    QpError::Infeasible { .. } => "infeasible",
                    QpError::NotConvex => "not convex",
                    QpError::NotFinite => "not finite",
                    _ => "something else",
                });
                assert_eq!(failure, expected, "n = {n}");
                steps += solver.iterations();
            }
        }
    }
    assert!(steps > 500, "rows became active: {steps}");
}

#[test]
fn interior_point_allocates_once_per_call() {
    let mut solver = InteriorPoint::new(12, 24).expect("the sizes are possible");
    assert_eq!(solver.solve(&programme(12, 0)), Ok(()));
    for tick in 1..10 {
        for n in [1, 7, 12] {
            let program = programme(n, tick);
            let (result, count) = counted(|| solver.solve(&program));
            assert_eq!((count.allocations, result), (1, Ok(())), "n = {n}");
        }
    }
}

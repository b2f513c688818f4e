//! Two independent solvers of quadratic programs with different algorithms, compared with each other; solutions of the
//! active-set method, compared with the optimality conditions and with minima computed by hand. The random programs
//! have equalities, dependent rows, bounds that intersect in one point, and Hessians with condition numbers of up to
//! 1e8.
#![expect(clippy::unwrap_used, reason = "a test")]

use nalgebra::{DMatrix, DVector};
use opspace_control::qp::active_set::ActiveSet;
use opspace_control::qp::interior_point::InteriorPoint;
use opspace_control::qp::quadratic_program::{QpError, QuadraticProgram};
use proptest::prelude::*;
use proptest::sample::Index;
use proptest::test_runner::RngSeed;

/// Optimality conditions, relative to the terms that cancel: rounding, mainly in Cᵀ x of nearly singular active rows.
/// Ten times the largest measured value, 6.5e-14.
const CONDITIONS: f64 = 6.5e-13;
/// Difference of the two solvers' x, relative to 1 + |x|: the error of the interior-point method. Ten times the largest
/// measured value, 3.5e-9.
const AGREEMENT: f64 = 3.5e-8;
/// Difference of x for another order of the same program's rows, relative to 1 + |x|: rounding, times the square root
/// of the Hessian's condition number. Ten times the largest measured value, 8.1e-12.
const ORDER: f64 = 8e-11;
/// Tolerance for comparison with numbers computed by hand.
const ROUNDING: f64 = 16.0 * f64::EPSILON;

fn config(cases: u32) -> ProptestConfig {
    ProptestConfig { cases, rng_seed: RngSeed::Fixed(6), failure_persistence: None, ..Default::default() }
}

/// A row of C, with bounds around its value at a common feasible x.
#[derive(Clone, Debug)]
struct RowCase {
    bounds: Bounds,
    /// Linear combination of previous rows, with weights; replaces the coefficients.
    depends: Option<[(Index, f64); 2]>,
    coefficients: Vec<f64>,
    /// Distances of the lower and the upper bound from the value.
    room: [f64; 2],
}

#[derive(Clone, Copy, Debug)]
enum Bounds {
    None,
    Lower,
    Upper,
    Both,
    Equal,
}

fn row(n: usize) -> impl Strategy<Value = RowCase> {
    let bounds = prop_oneof![
        1 => Just(Bounds::None),
        2 => Just(Bounds::Lower),
        2 => Just(Bounds::Upper),
        3 => Just(Bounds::Both),
        1 => Just(Bounds::Equal),
    ];
    // A combination of one row, two rows or none (a row of zeros).
    let weighted = || (any::<Index>(), prop_oneof![1 => Just(0.0), 3 => -2.0..2.0]);
    let depends = prop::option::weighted(0.25, [weighted(), weighted()]);
    let general = (-1.0..1.0, prop::collection::vec(-1.0..1.0, n))
        .prop_map(|(scale, c)| c.iter().map(|x: &f64| x * 10.0_f64.powf(scale)).collect());
    let single = (0..n).prop_map(move |k| (0..n).map(|i| f64::from(i == k)).collect());
    let room = || prop_oneof![1 => Just(0.0), 4 => 0.0..2.0];
    (bounds, depends, prop_oneof![3 => general, 1 => single], [room(), room()])
        .prop_map(|(bounds, depends, coefficients, room)| RowCase { bounds, depends, coefficients, room })
}

/// H = Q D Qᵀ with a condition number of 10^`decades`.
fn hessian(entries: &[f64], n: usize, decades: f64) -> DMatrix<f64> {
    let q = DMatrix::from_column_slice(n, n, entries).qr().q();
    let eigenvalue = |i: usize| 10.0_f64.powf(-decades * i as f64 / (n.max(2) - 1) as f64);
    &q * DMatrix::from_diagonal(&DVector::from_fn(n, |i, _| eigenvalue(i))) * q.transpose()
}

/// A feasible program. If `at_a_point`, the feasible set is a point, a cone or a subspace, and the Hessian has the
/// largest condition numbers.
fn programme(at_a_point: bool) -> impl Strategy<Value = QuadraticProgram> {
    let decades = if at_a_point { 7.0..8.0 } else { 0.0..8.0 };
    (1..=10_usize, 0..=32_usize).prop_flat_map(move |(n, m)| {
        let vector = |length| prop::collection::vec(-1.0..1.0, length);
        (vector(n * n), vector(n), vector(n), prop::collection::vec(row(n), m), decades.clone()).prop_map(
            move |(entries, gradient, feasible, cases, decades)| {
                let mut program = QuadraticProgram::new(n, m);
                program.hessian = hessian(&entries, n, decades);
                program.gradient.copy_from_slice(&gradient);
                let spread = if at_a_point { 0.0 } else { 1.0 };
                let feasible = DVector::from_vec(feasible) * spread;
                for (i, case) in cases.iter().enumerate() {
                    set_row(&mut program, i, case, &feasible, spread);
                }
                program
            },
        )
    })
}

fn set_row(program: &mut QuadraticProgram, i: usize, case: &RowCase, feasible: &DVector<f64>, spread: f64) {
    program.row_mut(i).copy_from_slice(&case.coefficients);
    if let Some(depends) = &case.depends
        && i > 0
    {
        let sum: DVector<f64> = depends.iter().map(|(k, w)| program.rows.column(k.index(i)) * *w).sum();
        program.rows.set_column(i, &sum);
    }
    let value = program.rows.column(i).dot(feasible);
    let (lower, upper) = (value - spread * case.room[0], value + spread * case.room[1]);
    (program.lower[i], program.upper[i]) = match case.bounds {
        Bounds::None => (f64::NEG_INFINITY, f64::INFINITY),
        Bounds::Lower => (lower, f64::INFINITY),
        Bounds::Upper => (f64::NEG_INFINITY, upper),
        Bounds::Both => (lower, upper),
        Bounds::Equal => (value, value),
    };
}

/// Returns `program` with three more rows, of which a + 2 b contradicts a and b.
fn with_contradiction(program: &QuadraticProgram, a: &[f64], b: &[f64], gap: f64) -> QuadraticProgram {
    let (n, m) = (program.variables(), program.constraints());
    let mut worse = QuadraticProgram::new(n, m + 3);
    worse.hessian.copy_from(&program.hessian);
    worse.gradient.copy_from(&program.gradient);
    worse.rows.columns_mut(0, m).copy_from(&program.rows);
    worse.lower.rows_mut(0, m).copy_from(&program.lower);
    worse.upper.rows_mut(0, m).copy_from(&program.upper);
    for k in 0..n {
        worse.row_mut(m)[k] = a[k];
        worse.row_mut(m + 1)[k] = b[k];
        worse.row_mut(m + 2)[k] = a[k] + 2.0 * b[k];
    }
    for (i, [lower, upper]) in
        [[f64::NEG_INFINITY, 0.3], [-1.0, 0.5], [1.3 + gap, f64::INFINITY]].iter().enumerate()
    {
        (worse.lower[m + i], worse.upper[m + i]) = (*lower, *upper);
    }
    worse
}

fn active_set(program: &QuadraticProgram) -> (Result<(), QpError>, ActiveSet) {
    let mut solver = ActiveSet::new(program.variables(), program.constraints());
    (solver.solve(program), solver)
}

fn interior_point(program: &QuadraticProgram) -> (Result<(), QpError>, InteriorPoint) {
    let mut solver = InteriorPoint::new(program.variables(), program.constraints()).unwrap();
    (solver.solve(program), solver)
}

/// |a − b| relative to 1 + |a|.
fn distance(a: &[f64], b: &[f64]) -> f64 {
    let (a, b) = (DVector::from_column_slice(a), DVector::from_column_slice(b));
    (&a - b).norm() / (1.0 + a.norm())
}

/// Violation of the optimality conditions by x and λ: H x + g + C λ = 0, l ≤ Cᵀ x ≤ u, λ positive only if Cᵀ x = u,
/// negative only if Cᵀ x = l. Each is relative to the terms of its sum.
fn violation_of_conditions(program: &QuadraticProgram, solver: &ActiveSet) -> f64 {
    let (x, multipliers) =
        (DVector::from_column_slice(solver.x()), DVector::from_column_slice(solver.multipliers()));
    let (pull, value) = (&program.rows * &multipliers, program.rows.tr_mul(&x));
    let residual = (&program.hessian * &x + &program.gradient + pull).norm();
    let forces = multipliers.iter().enumerate().map(|(i, m)| m.abs() * program.rows.column(i).norm());
    let terms = program.hessian.norm() * x.norm() + program.gradient.norm() + forces.sum::<f64>();
    let mut worst = residual / terms.max(f64::MIN_POSITIVE);
    for (i, &multiplier) in multipliers.iter().enumerate() {
        let (lower, upper) = (program.lower[i], program.upper[i]);
        let beyond = (lower - value[i]).max(value[i] - upper).max(0.0);
        let away = match multiplier {
            m if m > 0.0 => (upper - value[i]).abs(),
            m if m < 0.0 => (value[i] - lower).abs(),
            _ => 0.0,
        };
        // The common x, and therefore the bounds, are of the order of 1.
        let terms = program.rows.column(i).norm() * (1.0 + x.norm());
        worst = worst.max(beyond.max(away) / terms.max(f64::MIN_POSITIVE));
    }
    worst
}

proptest! {
    #![proptest_config(config(1024))]

    #[test]
    fn active_set_meets_optimality_conditions(program in programme(false)) {
        let (result, solver) = active_set(&program);
        prop_assert_eq!(result, Ok(()));
        let worst = violation_of_conditions(&program, &solver);
        prop_assert!(worst < CONDITIONS, "{}", worst);
    }

    /// A solver that has solved another program starts with the active rows of that program.
    #[test]
    fn warm_start_does_not_change_the_solution(program in programme(false), change in prop::collection::vec(-0.3..0.3, 10)) {
        let (_, mut solver) = active_set(&program);
        let mut changed = program;
        changed.gradient.iter_mut().zip(&change).for_each(|(g, c)| *g += c);
        prop_assert_eq!(solver.solve(&changed), Ok(()));
        let worst = violation_of_conditions(&changed, &solver);
        prop_assert!(worst < CONDITIONS, "{}", worst);
        let (_, fresh) = active_set(&changed);
        let distance = distance(fresh.x(), solver.x());
        prop_assert!(distance < ORDER, "{}", distance);
    }
}

proptest! {
    // Only few of the programs are difficult.
    #![proptest_config(config(5_000))]

    #[test]
    fn degenerate_vertex_is_feasible(program in programme(true)) {
        let (result, solver) = active_set(&program);
        prop_assert_eq!(result, Ok(()));
        let worst = violation_of_conditions(&program, &solver);
        prop_assert!(worst < CONDITIONS, "{}", worst);
    }
}

proptest! {
    #![proptest_config(config(256))]

    #[test]
    fn active_set_and_interior_point_agree(program in programme(false)) {
        let (first, a) = active_set(&program);
        let (second, b) = interior_point(&program);
        prop_assert_eq!((first, second), (Ok(()), Ok(())));
        let distance = distance(a.x(), b.x());
        prop_assert!(distance < AGREEMENT, "{}", distance);
    }

    #[test]
    fn both_solvers_detect_infeasibility(
        program in programme(false),
        a in prop::collection::vec(-1.0..1.0, 10),
        b in prop::collection::vec(-1.0..1.0, 10),
        gap in 0.01..1.0,
    ) {
        let program = with_contradiction(&program, &a, &b, gap);
        let m = program.constraints();
        let named = |result| matches!(result, Err(QpError::Infeasible { row }) if row < m);
        let (first, second) = (active_set(&program).0, interior_point(&program).0);
        prop_assert!(named(first), "active set: {:?}", first);
        prop_assert!(named(second), "interior point: {:?}", second);
    }

    /// After a program with one NaN or infinity, the next program is solved as if there had been none.
    #[test]
    fn both_solvers_refuse_nan(
        program in programme(false),
        place in 0..5_usize,
        (i, j) in any::<(Index, Index)>(),
        wrong in prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(f64::NEG_INFINITY)],
    ) {
        let (n, m) = (program.variables(), program.constraints());
        let mut bad = program.clone();
        let (k, l) = (i.index(n), j.index(n));
        match place {
            0 => bad.hessian[(k.max(l), k.min(l))] = wrong,
            1 => bad.gradient[k] = wrong,
            2 if m > 0 => bad.rows[(k, j.index(m))] = wrong,
            3 if m > 0 => bad.lower[j.index(m)] = f64::NAN,
            4 if m > 0 => bad.upper[j.index(m)] = f64::NAN,
            _ => return Ok(()),
        }
        let (mut a, mut b) = (ActiveSet::new(n, m), InteriorPoint::new(n, m).unwrap());
        prop_assert_eq!((a.solve(&bad), b.solve(&bad)), (Err(QpError::NotFinite), Err(QpError::NotFinite)));
        prop_assert_eq!((a.solve(&program), b.solve(&program)), (Ok(()), Ok(())));
        let (fresh_a, fresh_b) = (active_set(&program).1, interior_point(&program).1);
        prop_assert_eq!((a.x(), b.x()), (fresh_a.x(), fresh_b.x()));
    }

    /// Only the leading blocks of larger arrays are read, by a larger solver; the other entries are NaN.
    #[test]
    fn only_leading_block_is_read(program in programme(false)) {
        let (n, m) = (program.variables(), program.constraints());
        let mut large = QuadraticProgram::new(n + 3, m + 5);
        large.hessian.fill(f64::NAN);
        large.gradient.fill(f64::NAN);
        large.rows.fill(f64::NAN);
        large.lower.fill(f64::NAN);
        large.upper.fill(f64::NAN);
        large.resize(n, m);
        for j in 0..n {
            // The upper triangle is not read.
            large.hessian.view_mut((j, j), (n - j, 1)).copy_from(&program.hessian.view((j, j), (n - j, 1)));
        }
        large.gradient.rows_mut(0, n).copy_from(&program.gradient);
        for i in 0..m {
            large.row_mut(i).copy_from_slice(program.row(i));
        }
        large.lower.rows_mut(0, m).copy_from(&program.lower);
        large.upper.rows_mut(0, m).copy_from(&program.upper);
        let (_, tight) = active_set(&program);
        let mut a = ActiveSet::new(n + 4, m + 7);
        let mut b = InteriorPoint::new(n + 4, m + 7).unwrap();
        prop_assert_eq!((a.solve(&large), b.solve(&large)), (Ok(()), Ok(())));
        prop_assert_eq!(a.x(), tight.x());
        prop_assert_eq!(a.multipliers(), tight.multipliers());
        let distance = distance(a.x(), b.x());
        prop_assert!(distance < AGREEMENT, "{}", distance);
    }
}

/// Program for the point nearest to (1, 2) within bounds: n = 2, rows as (coefficients, lower, upper).
fn nearest(rows: &[([f64; 2], f64, f64)]) -> QuadraticProgram {
    let mut program = QuadraticProgram::new(2, rows.len());
    program.hessian.fill_with_identity();
    program.gradient.copy_from_slice(&[-1.0, -2.0]);
    for (i, (c, lower, upper)) in rows.iter().enumerate() {
        program.row_mut(i).copy_from_slice(c);
        (program.lower[i], program.upper[i]) = (*lower, *upper);
    }
    program
}

/// Compared: minima and multipliers, including their signs, with values computed by hand.
#[test]
fn nearest_point_matches_hand_computed_minima() {
    let free = f64::INFINITY;
    type Rows<'a> = &'a [([f64; 2], f64, f64)];
    let cases: [(Rows, [f64; 2], &[f64]); 6] = [
        (&[], [1.0, 2.0], &[]),
        (&[([1.0, 1.0], -free, 1.0)], [0.0, 1.0], &[1.0]),
        (&[([1.0, 1.0], 5.0, 6.0)], [2.0, 3.0], &[-1.0]),
        (&[([1.0, 0.0], -1.0, 2.0), ([0.0, 1.0], -1.0, 0.5)], [1.0, 0.5], &[0.0, 1.5]),
        (&[([2.0, 0.0], 3.0, 3.0), ([0.0, -1.0], -free, -4.0)], [1.5, 4.0], &[-0.25, 2.0]),
        // The first row is active temporarily and is dropped before the second one is reached.
        (&[([0.0, 1.0], -free, 0.0), ([1.0, 1.0], -free, -3.0)], [-2.0, -1.0], &[0.0, 3.0]),
    ];
    for (rows, x, multipliers) in cases {
        let program = nearest(rows);
        let (result, solver) = active_set(&program);
        assert_eq!(result, Ok(()), "{rows:?}");
        assert!(distance(&x, solver.x()) < ROUNDING, "{rows:?}: {:?}", solver.x());
        assert!(
            distance(multipliers, solver.multipliers()) < ROUNDING,
            "{rows:?}: {:?}",
            solver.multipliers()
        );
        let (result, solver) = interior_point(&program);
        assert_eq!(result, Ok(()), "{rows:?}");
        assert!(distance(&x, solver.x()) < AGREEMENT, "{rows:?}: {:?}", solver.x());
    }
}

/// The error names one of the rows that contradict each other, among other rows that do not.
#[test]
fn infeasible_row_is_named() {
    let free = f64::INFINITY;
    let beside = [([1.0, 0.0], -9.0, 9.0), ([0.0, 1.0], -9.0, 9.0)];
    for contradiction in [
        [([1.0, 1.0], -free, 1.0), ([2.0, 2.0], 2.1, free)],
        [([1.0, 1.0], 1.0, 1.0), ([1.0, 1.0], 1.0 + 1e-6, free)],
        [([1.0, 1.0], 1.0, 1.0), ([-1.0, -1.0], 1.0, 1.0)],
        [([0.0, 0.0], 1.0, 2.0), ([0.0, 0.0], -1.0, 2.0)],
        [([1.0, 1.0], 2.0, 1.0), ([1.0, 0.0], -1.0, 2.0)],
    ] {
        let program = nearest(&[beside[0], contradiction[0], beside[1], contradiction[1]]);
        let row = |result| match result {
            Err(QpError::Infeasible { row }) => row,
            other => panic!("{contradiction:?}: {other:?}"),
        };
        for named in [row(active_set(&program).0), row(interior_point(&program).0)] {
            assert!(named == 1 || named == 3, "{contradiction:?}: {named}");
        }
    }
}

#[test]
fn both_solvers_refuse_indefinite_hessian() {
    for (a, b) in [(1.0, 0.0), (1.0, -1.0), (-1.0, -1.0), (0.0, 0.0)] {
        let mut program = nearest(&[([1.0, 0.0], -1.0, 1.0)]);
        program.hessian = hessian(&[0.3, 0.7, -0.2, 0.9], 2, 0.0);
        let q = DMatrix::from_column_slice(2, 2, &[0.6, 0.8, -0.8, 0.6]);
        program.hessian = &q * DMatrix::from_diagonal(&DVector::from_vec(vec![a, b])) * q.transpose();
        let expected = Err(QpError::NotConvex);
        assert_eq!((active_set(&program).0, interior_point(&program).0), (expected, expected));
    }
}

/// Finite numbers whose products overflow, in the objective and in the rows.
#[test]
fn overflow_is_an_error() {
    for (cost, row) in [(1e200, 1.0), (1e200, 1e200), (1e150, 1e160), (1e308, 1e308), (-2.0, 1e308)] {
        let mut program = nearest(&[([row, row], -1.0, 1.0)]);
        program.gradient.fill(cost);
        let (result, solver) = active_set(&program);
        assert_eq!((result, solver.x()), (Err(QpError::NotFinite), [].as_slice()), "{cost}, {row}");
    }
}

#[test]
fn empty_programs_solve_and_oversized_ones_fail() {
    let (result, solver) = active_set(&QuadraticProgram::new(0, 0));
    assert_eq!((result, solver.x()), (Ok(()), [].as_slice()));
    let (mut a, mut b) = (ActiveSet::new(1, 9), InteriorPoint::new(1, 9).unwrap());
    let program = nearest(&[]);
    for result in [a.solve(&program), b.solve(&program)] {
        assert!(matches!(result, Err(QpError::Unsolved(_))), "{result:?}");
    }
    let mut program = nearest(&[]);
    program.gradient = DVector::zeros(1);
    assert!(matches!(active_set(&program).0, Err(QpError::Unsolved(_))));
}

/// Compared: the number of steps of a warm start and of a cold start, for a program that changes slowly: the box around
/// the nearest point rotates.
#[test]
fn warm_start_saves_steps() {
    let n = 7;
    let mut program = QuadraticProgram::new(n, 2 * n);
    program.hessian = hessian(&(0..n * n).map(|i| (1.7 * i as f64).sin()).collect::<Vec<_>>(), n, 3.0);
    for i in 0..2 * n {
        let coefficient = |k: usize| if i < n { f64::from(i == k) } else { (0.9 * (i * n + k) as f64).sin() };
        program.row_mut(i).copy_from_slice(&(0..n).map(coefficient).collect::<Vec<_>>());
    }
    program.lower.fill(-0.3);
    program.upper.fill(0.3);
    let mut warm = ActiveSet::new(n, 2 * n);
    let (mut with, mut without) = (0, 0);
    for tick in 0..200 {
        program.gradient = DVector::from_fn(n, |k, _| (0.01 * f64::from(tick) + k as f64).sin());
        assert_eq!(warm.solve(&program), Ok(()));
        let (_, cold) = active_set(&program);
        assert!(distance(cold.x(), warm.x()) < ORDER);
        with += warm.iterations();
        without += cold.iterations();
    }
    assert!(with < without, "{with} against {without}");
}

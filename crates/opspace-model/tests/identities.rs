//! Laws that our algorithms must obey together, on random trees in random states: any of the joint kinds,
//! general axes, branches, rotors, a base turned and moved, gravity in any direction.
//!
//! Identities don't see a transform that all algorithms share and that is wrong: see `pinocchio.rs` for those.
#![expect(clippy::unwrap_used, reason = "a test")]

use nalgebra::{DMatrix, DVector, Matrix3, Matrix6xX, Vector3};
use opspace_model::{
    Data, FrameId, Inertia, Joint, JointKind, Limits, Model, OperationalSpace, Placement, aba, coriolis,
    frame_bias_acceleration, frame_jacobian, frame_placement, frame_velocity, kinematics, kinetic_energy,
    potential_energy, rnea, update,
};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// Relative to the size of what is compared: some thousand roundings.
const ROUNDING: f64 = 1e-12;
/// Where M is inverted; its condition stays below 1e5 here.
const INVERSE: f64 = 1e-9;
/// Central differences with [`STEP`]: half the digits cubed for the formula, the rest for cancellation.
const DIFFERENCE: f64 = 1e-7;
const STEP: f64 = 1e-5;

/// A tree with a frame off its last body, and a state.
#[derive(Clone, Debug)]
struct Case {
    model: Model,
    tip: FrameId,
    q: Vec<f64>,
    dq: Vec<f64>,
    ddq: Vec<f64>,
    tau: Vec<f64>,
}

fn triple(range: f64) -> impl Strategy<Value = [f64; 3]> {
    [-range..range, -range..range, -range..range]
}

fn placement() -> impl Strategy<Value = Placement> {
    (triple(3.0), triple(0.5)).prop_map(|(rpy, xyz)| Placement::from_rpy(rpy, xyz))
}

/// A body as eight unequal point masses would make it: its moments obey the triangle inequality.
fn inertia() -> impl Strategy<Value = Inertia> {
    (0.2..3.0, triple(0.3), triple(3.0), [0.01..0.2, 0.01..0.2, 0.01..0.2]).prop_map(
        |(mass, com, rpy, spread)| {
            let [x, y, z] = spread.map(|s: f64| s * s * mass);
            let turned = Placement::from_rpy(rpy, com);
            let rotational = Matrix3::from_diagonal(&Vector3::new(y + z, x + z, x + y));
            turned.act_inertia(&Inertia { mass, com: Vector3::zeros(), rotational })
        },
    )
}

/// A body to be put on a tree: its joint, rotor, and where it branches off.
#[derive(Clone, Debug)]
struct Part {
    kind: JointKind,
    origin: Placement,
    inertia: Inertia,
    rotor: f64,
    branch: prop::sample::Index,
}

fn part() -> impl Strategy<Value = Part> {
    let kind =
        prop_oneof![Just(JointKind::Revolute), Just(JointKind::Continuous), Just(JointKind::Prismatic)];
    (kind, placement(), inertia(), 0.0..0.5, any::<prop::sample::Index>())
        .prop_map(|(kind, origin, inertia, rotor, branch)| Part { kind, origin, inertia, rotor, branch })
}

/// The parts as a tree on `model`, a chain more often than not, so that trees are deep and branched; a frame
/// `tip` off the last.
fn grow(mut model: Model, parts: &[Part], hand: Placement) -> Model {
    let root = model.bodies().len();
    let mut rotors = model.rotor_inertia().to_vec();
    for (i, part) in parts.iter().enumerate() {
        let parent = (i > 0).then(|| root + if i % 3 == 2 { part.branch.index(i) } else { i - 1 });
        let joint = Joint { name: format!("joint{i}"), kind: part.kind, limits: Limits::NONE };
        model.add_body(parent, part.origin, joint, part.inertia);
        rotors.push(part.rotor);
    }
    model.add_frame("tip", Some(model.bodies().len() - 1), hand);
    model.with_rotor_inertia(&rotors)
}

fn case() -> impl Strategy<Value = Case> {
    let parts = prop::collection::vec(part(), 1..9);
    let state = prop::collection::vec((-3.0..3.0, -2.0..2.0, -5.0..5.0, -20.0..20.0), 9);
    (parts, placement(), placement(), triple(10.0), state).prop_map(|(parts, hand, base, gravity, state)| {
        let model =
            grow(Model::new("tree"), &parts, hand).with_base(base).with_gravity(Vector3::from(gravity));
        let column = |pick: fn(&(f64, f64, f64, f64)) -> f64| state[..parts.len()].iter().map(pick).collect();
        Case {
            tip: model.frame("tip").unwrap(),
            q: column(|s| s.0),
            dq: column(|s| s.1),
            ddq: column(|s| s.2),
            tau: column(|s| s.3),
            model,
        }
    })
}

/// All that [`update`] and [`coriolis`] compute.
fn evaluated(model: &Model, q: &[f64], dq: &[f64]) -> Data {
    let mut data = Data::new(model);
    assert!(update(model, &mut data, q, dq), "M is positive definite");
    coriolis(model, &mut data);
    data
}

fn mass_matrix(model: &Model, q: &[f64]) -> DMatrix<f64> {
    evaluated(model, q, &vec![0.0; q.len()]).mass_matrix
}

fn moved(from: &[f64], along: &[f64], by: f64) -> Vec<f64> {
    from.iter().zip(along).map(|(x, v)| x + v * by).collect()
}

fn unit(n: usize, i: usize) -> Vec<f64> {
    (0..n).map(|j| if i == j { 1.0 } else { 0.0 }).collect()
}

fn vector(values: &[f64]) -> DVector<f64> {
    DVector::from_column_slice(values)
}

/// The largest difference relative to max(1, the larger side's largest entry) is within tolerance; NaN is not.
fn close<'a>(
    a: impl IntoIterator<Item = &'a f64>,
    b: impl IntoIterator<Item = &'a f64>,
    tolerance: f64,
) -> Result<(), TestCaseError> {
    let (a, b): (Vec<f64>, Vec<f64>) = (a.into_iter().copied().collect(), b.into_iter().copied().collect());
    prop_assert_eq!(a.len(), b.len());
    let scale = a.iter().chain(&b).fold(1.0, |m: f64, x| m.max(x.abs()));
    for (i, (x, y)) in a.iter().zip(&b).enumerate() {
        prop_assert!((x - y).abs() <= tolerance * scale, "entry {}: {} against {}, scale {}", i, x, y, scale);
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig {
        failure_persistence: None,
        rng_seed: RngSeed::Fixed(7),
        ..ProptestConfig::with_cases(256)
    })]

    /// Forward dynamics of inverse dynamics against the acceleration put in.
    #[test]
    fn aba_undoes_rnea(case in case()) {
        let mut data = evaluated(&case.model, &case.q, &case.dq);
        rnea(&case.model, &mut data, &case.ddq);
        let tau = data.torque.as_slice().to_vec();
        aba(&case.model, &mut data, &tau);
        close(&data.ddq, &case.ddq, INVERSE)?;
    }

    /// ABA against M⁻¹ (τ − h) with CRBA's M, factored, and RNEA's h.
    #[test]
    fn aba_solves_the_equation_of_motion(case in case()) {
        let mut data = evaluated(&case.model, &case.q, &case.dq);
        aba(&case.model, &mut data, &case.tau);
        let mut ddq: Vec<f64> = case.tau.iter().zip(&data.bias).map(|(tau, h)| tau - h).collect();
        data.mass_matrix_factor.solve(&mut ddq);
        close(&data.ddq, &ddq, INVERSE)?;
    }

    /// Columns of CRBA's M against RNEA at one unit acceleration each, less the bias; rotors included.
    #[test]
    fn the_mass_matrix_is_what_inverse_dynamics_say(case in case()) {
        let mut data = evaluated(&case.model, &case.q, &case.dq);
        for i in 0..case.model.n() {
            rnea(&case.model, &mut data, &unit(case.model.n(), i));
            close(&(&data.torque - &data.bias), data.mass_matrix.column(i).iter(), ROUNDING)?;
        }
    }

    /// Rotors add to M's diagonal, and to nothing else of the equation of motion.
    #[test]
    fn rotors_add_to_the_diagonal(case in case()) {
        let rotors = case.model.rotor_inertia().to_vec();
        let bare = case.model.clone().with_rotor_inertia(&vec![0.0; rotors.len()]);
        let (with, without) =
            (evaluated(&case.model, &case.q, &case.dq), evaluated(&bare, &case.q, &case.dq));
        let expected = &without.mass_matrix + DMatrix::from_diagonal(&vector(&rotors));
        close(&with.mass_matrix, &expected, ROUNDING)?;
        close(&with.bias, &without.bias, 0.0)?;
        close(&with.coriolis_matrix, &without.coriolis_matrix, 0.0)?;
    }

    /// J q̇ against the frame's velocity, and both against the difference of its pose.
    #[test]
    fn the_jacobian_is_the_rate_of_the_pose(case in case()) {
        let data = evaluated(&case.model, &case.q, &case.dq);
        let mut jacobian = Matrix6xX::zeros(case.model.n());
        frame_jacobian(&case.model, &data, case.tip, &mut jacobian);
        let velocity = frame_velocity(&case.model, &data, case.tip);
        let stacked: Vec<f64> = velocity.linear.iter().chain(velocity.angular.iter()).copied().collect();
        close(&(&jacobian * vector(&case.dq)), &stacked, ROUNDING)?;

        let pose = |t: f64| {
            let data = evaluated(&case.model, &moved(&case.q, &case.dq, t), &case.dq);
            frame_placement(&case.model, &data, case.tip)
        };
        let (before, now, after) = (pose(-STEP), pose(0.0), pose(STEP));
        close(&((after.translation - before.translation) / (2.0 * STEP)), &velocity.linear, DIFFERENCE)?;
        let spin = (after.rotation - before.rotation) / (2.0 * STEP) * now.rotation.transpose();
        close(&spin, &velocity.angular.cross_matrix(), DIFFERENCE)?;
    }

    /// J̇ q̇ against the difference of the frame's velocity while q̇ stays the same.
    #[test]
    fn the_bias_acceleration_is_the_rate_of_the_velocity(case in case()) {
        let data = evaluated(&case.model, &case.q, &case.dq);
        let velocity = |t: f64| {
            let data = evaluated(&case.model, &moved(&case.q, &case.dq, t), &case.dq);
            frame_velocity(&case.model, &data, case.tip)
        };
        let rate = (velocity(STEP) - velocity(-STEP)) * (0.5 / STEP);
        let bias = frame_bias_acceleration(&case.model, &data, case.tip);
        close(&rate.linear, &bias.linear, DIFFERENCE)?;
        close(&rate.angular, &bias.angular, DIFFERENCE)?;
    }

    /// C q̇ against RNEA's bias less its gravity; C + Cᵀ against the difference of M in time.
    #[test]
    fn the_coriolis_matrix_obeys_both_its_laws(case in case()) {
        let data = evaluated(&case.model, &case.q, &case.dq);
        let coriolis = &data.coriolis_matrix;
        close(&(coriolis * vector(&case.dq)), &(&data.bias - &data.gravity), ROUNDING)?;
        let mass = |t: f64| mass_matrix(&case.model, &moved(&case.q, &case.dq, t));
        let rate = (mass(STEP) - mass(-STEP)) / (2.0 * STEP);
        close(&(coriolis + coriolis.transpose()), &rate, DIFFERENCE)?;
    }

    /// C against Christoffel's symbols from differences of M: C_ij = ½ Σ_k (∂_k M_ij + ∂_j M_ik − ∂_i M_jk) q̇_k.
    #[test]
    fn the_coriolis_matrix_is_christoffels(case in case()) {
        let n = case.model.n();
        let gradient: Vec<DMatrix<f64>> = (0..n)
            .map(|k| {
                let mass = |t: f64| mass_matrix(&case.model, &moved(&case.q, &unit(n, k), t));
                (mass(STEP) - mass(-STEP)) / (2.0 * STEP)
            })
            .collect();
        let expected = DMatrix::from_fn(n, n, |i, j| {
            (0..n).map(|k| 0.5 * (gradient[k][(i, j)] + gradient[j][(i, k)] - gradient[i][(j, k)]) * case.dq[k]).sum()
        });
        close(&evaluated(&case.model, &case.q, &case.dq).coriolis_matrix, &expected, DIFFERENCE)?;
    }

    /// Gravity torques against the gradient of the potential energy.
    #[test]
    fn gravity_is_the_gradient_of_the_potential_energy(case in case()) {
        let n = case.model.n();
        let energy = |k: usize, t: f64| {
            let q = moved(&case.q, &unit(n, k), t);
            potential_energy(&case.model, &evaluated(&case.model, &q, &case.dq))
        };
        let gradient: Vec<f64> = (0..n).map(|k| (energy(k, STEP) - energy(k, -STEP)) / (2.0 * STEP)).collect();
        close(&evaluated(&case.model, &case.q, &case.dq).gravity, &gradient, DIFFERENCE)?;
    }

    /// The bodies' kinetic energy against ½ q̇ᵀ M q̇.
    #[test]
    fn kinetic_energy_is_that_of_the_mass_matrix(case in case()) {
        let data = evaluated(&case.model, &case.q, &case.dq);
        let dq = vector(&case.dq);
        close(&[kinetic_energy(&case.model, &data)], &[0.5 * dq.dot(&(&data.mass_matrix * &dq))], ROUNDING)?;
    }

    /// The rate of all energy, by difference along ABA's motion, against the power of the torques.
    #[test]
    fn energy_changes_by_the_power_of_the_torques(case in case()) {
        let mut data = evaluated(&case.model, &case.q, &case.dq);
        aba(&case.model, &mut data, &case.tau);
        let ddq = data.ddq.as_slice().to_vec();
        let speed = vector(&ddq).amax().max(1.0);
        let step = STEP / speed;
        let energy = |t: f64| {
            let q: Vec<f64> = (0..ddq.len()).map(|i| case.q[i] + case.dq[i] * t + 0.5 * ddq[i] * t * t).collect();
            let data = evaluated(&case.model, &q, &moved(&case.dq, &ddq, t));
            kinetic_energy(&case.model, &data) + potential_energy(&case.model, &data)
        };
        let rate = (energy(step) - energy(-step)) / (2.0 * step);
        // Energies of some hundred J lose their last digits in a difference over so short a step.
        let tolerance = DIFFERENCE + f64::EPSILON * (energy(0.0).abs() + 100.0) / step;
        close(&[rate], &[vector(&case.tau).dot(&vector(&case.dq))], tolerance)?;
    }

    /// The robot with its base and gravity turned together, and moved, against itself: only its pose changes.
    #[test]
    fn turning_the_world_changes_no_torque(case in case(), world in placement()) {
        let turned = case.model.clone()
            .with_base(world * case.model.base())
            .with_gravity(world.rotation * case.model.gravity());
        let (mut here, mut there) =
            (evaluated(&case.model, &case.q, &case.dq), evaluated(&turned, &case.q, &case.dq));
        for (model, data) in [(&case.model, &mut here), (&turned, &mut there)] {
            rnea(model, data, &case.ddq);
            aba(model, data, &case.tau);
        }
        close(&here.torque, &there.torque, ROUNDING)?;
        close(&here.gravity, &there.gravity, ROUNDING)?;
        close(&here.mass_matrix, &there.mass_matrix, ROUNDING)?;
        close(&here.coriolis_matrix, &there.coriolis_matrix, ROUNDING)?;
        close(&here.ddq, &there.ddq, INVERSE)?;
        let expected = world * frame_placement(&case.model, &here, case.tip);
        let found = frame_placement(&turned, &there, case.tip);
        close(&expected.translation, &found.translation, ROUNDING)?;
        close(&expected.rotation, &found.rotation, ROUNDING)?;
    }

    /// A joint at an angle against the same joint locked there, everything else alike; against the model with it:
    /// what the others move, weigh and feel.
    #[test]
    fn a_locked_joint_is_one_that_stands_still(case in case(), at in -3.0..3.0f64, which in any::<prop::sample::Index>()) {
        let (n, which) = (case.model.n(), which.index(case.model.n()));
        let locked = case.model.locked(&[(which, at)]).unwrap();
        let (mut q, mut dq) = (case.q.clone(), case.dq.clone());
        (q[which], dq[which]) = (at, 0.0);
        let whole = evaluated(&case.model, &q, &dq);
        let left: Vec<usize> = (0..n).filter(|&i| i != which).collect();
        let pick = |values: &[f64]| -> Vec<f64> { left.iter().map(|&i| values[i]).collect() };
        let part = evaluated(&locked, &pick(&q), &pick(&dq));
        close(&part.bias, &pick(whole.bias.as_slice()), ROUNDING)?;
        let expected = DMatrix::from_fn(n - 1, n - 1, |i, j| whole.mass_matrix[(left[i], left[j])]);
        close(&part.mass_matrix, &expected, ROUNDING)?;
        let (a, b) = (frame_placement(&case.model, &whole, case.tip), frame_placement(&locked, &part, case.tip));
        close(&a.translation, &b.translation, ROUNDING)?;
        close(&a.rotation, &b.rotation, ROUNDING)?;
    }

    /// All masses and inertias times a factor against all torques times it.
    #[test]
    fn torques_scale_with_the_inertia(case in case(), factor in 0.1..10.0f64) {
        let heavy = case.model.clone().with_scaled_inertia(factor);
        let (mut light, mut scaled) =
            (evaluated(&case.model, &case.q, &case.dq), evaluated(&heavy, &case.q, &case.dq));
        rnea(&case.model, &mut light, &case.ddq);
        rnea(&heavy, &mut scaled, &case.ddq);
        close(&(light.torque * factor), &scaled.torque, ROUNDING)?;
    }

    /// J N = 0, J J̄ = 1, N N = N, Λ J M⁻¹ Jᵀ = 1, and J M⁻¹ Nᵀ = 0: nullspace torques don't move the task.
    #[test]
    fn the_nullspace_leaves_the_task_alone(case in case(), rows in 1..4usize) {
        let n = case.model.n();
        let data = evaluated(&case.model, &case.q, &case.dq);
        let mut jacobian = Matrix6xX::zeros(n);
        frame_jacobian(&case.model, &data, case.tip, &mut jacobian);
        let task = jacobian.rows(0, rows).into_owned();
        let minv_jt = data.mass_matrix.clone().cholesky().unwrap().solve(&task.transpose());
        let inverse_inertia = &task * &minv_jt;
        let spectrum = inverse_inertia.clone().symmetric_eigenvalues();
        prop_assume!(spectrum.min() > 1e-4 * spectrum.max());

        let mut space = OperationalSpace::new(n);
        space.update(&data.mass_matrix_factor, &jacobian, rows, 0.0);
        let inverse = space.jbar_transpose.rows(0, rows).transpose();
        let inertia = space.task_inertia.view((0, 0), (rows, rows));
        let nullspace = &mut DMatrix::zeros(n, n);
        space.nullspace(&jacobian, nullspace);
        let mut projected = case.tau.clone();
        space.project_torque(&jacobian, &mut projected);
        close(&projected, &(nullspace.transpose() * vector(&case.tau)), INVERSE)?;
        let nullspace = &*nullspace;
        let identity = DMatrix::identity(rows, rows);
        close(&(&task * nullspace), &DMatrix::zeros(rows, n), INVERSE)?;
        close(&(&task * inverse), &identity, INVERSE)?;
        close(&(nullspace * nullspace), nullspace, INVERSE)?;
        close(&(inertia * inverse_inertia), &identity, INVERSE)?;
        close(&(minv_jt.transpose() * nullspace.transpose()), &DMatrix::zeros(rows, n), INVERSE)?;
        prop_assert_eq!(space.weakest_share, 1.0);
    }

    /// A frame on the base stands still, whatever the joints do.
    #[test]
    fn a_frame_on_the_base_stands_still(case in case(), place in placement()) {
        let mut model = case.model.clone();
        let stand = model.add_frame("stand", None, place);
        let mut data = Data::new(&model);
        kinematics(&model, &mut data, &case.q, &case.dq);
        let mut jacobian = Matrix6xX::repeat(model.n(), f64::NAN);
        frame_jacobian(&model, &data, stand, &mut jacobian);
        prop_assert!(jacobian.iter().all(|&x| x == 0.0));
        prop_assert_eq!(frame_placement(&model, &data, stand), model.base() * place);
        prop_assert_eq!(frame_velocity(&model, &data, stand), opspace_model::Motion::zero());
    }
}

//! Identities that the algorithms must fulfil together, on random trees in random states: with a fixed or floating
//! base, and with mimic joints.
//!
//! Identities do not detect a wrong transform that all algorithms share; `pinocchio.rs` does.
#![expect(clippy::unwrap_used, reason = "a test")]

use crate::common::{
    Case, DIFFERENCE, INVERSE, ROUNDING, STEP, case, close, close_placement, config, evaluated, jacobian,
    jointed, moved, placement, plus, stacked, unit, vector,
};
use nalgebra::{DMatrix, Matrix6xX};
use opspace_model::{
    Data, Inversion, OperationalSpace, aba, bias, crba, frame_bias_acceleration, frame_jacobian,
    frame_placement, frame_velocity, generalized_momentum, gravity, kinematics, kinetic_energy,
    potential_energy, rnea, update,
};
use proptest::prelude::*;

fn mass_matrix(case: &Case) -> DMatrix<f64> {
    case.evaluated().mass_matrix
}

proptest! {
    #![proptest_config(config(384))]

    /// Compared: momentum and gradient of the kinetic energy from one pass over the bodies, with M q̇ and Cᵀ q̇ from the
    /// matrices of CRBA and of the Christoffel symbols.
    #[test]
    fn generalized_momentum_matches_mass_and_coriolis_matrices(case in case()) {
        let mut data = case.evaluated();
        generalized_momentum(&case.model, &mut data);
        close(&data.momentum, &(&data.mass_matrix * vector(&case.dq)), ROUNDING)?;
        close(&data.kinetic_energy_gradient, &(data.coriolis_matrix.tr_mul(&vector(&case.dq))), ROUNDING)?;
    }

    /// Compared: the acceleration after inverse and forward dynamics, and the original acceleration.
    #[test]
    fn aba_inverts_rnea(case in case()) {
        let mut data = case.evaluated();
        rnea(&case.model, &mut data, &case.ddq);
        let tau = data.torque.as_slice().to_vec();
        aba(&case.model, &mut data, &tau);
        close(&data.ddq, &case.ddq, INVERSE)?;
    }

    /// Compared: accelerations of ABA, and M⁻¹ (τ − h) with the factor of CRBA's M and RNEA's h.
    #[test]
    fn aba_solves_equation_of_motion(case in case()) {
        let mut data = case.evaluated();
        aba(&case.model, &mut data, &case.tau);
        let mut ddq: Vec<f64> = case.tau.iter().zip(&data.bias).map(|(tau, h)| tau - h).collect();
        data.mass_matrix_factor.solve(&mut ddq);
        close(&data.ddq, &ddq, INVERSE)?;
    }

    /// Compared: RNEA at a unit acceleration of each joint, and the bias plus the column of CRBA's M, including rotors.
    #[test]
    fn mass_matrix_matches_inverse_dynamics(case in case()) {
        let mut data = case.evaluated();
        for i in 0..case.model.n() {
            rnea(&case.model, &mut data, &unit(case.model.n(), i));
            close(&data.torque, &(&data.bias + data.mass_matrix.column(i)), ROUNDING)?;
        }
    }

    /// Compared: M, bias and C with rotors, and without them. Rotors add only to the diagonal of M.
    #[test]
    fn rotors_add_to_mass_matrix_diagonal(case in case()) {
        let rotors = case.model.rotor_inertia().to_vec();
        let bare = case.model.clone().with_rotor_inertia(&vec![0.0; rotors.len()]);
        let (with, without) =
            (case.evaluated(), evaluated(&bare, &case.q, &case.dq));
        let expected = &without.mass_matrix + DMatrix::from_diagonal(&vector(&rotors));
        close(&with.mass_matrix, &expected, ROUNDING)?;
        close(&with.bias, &without.bias, 0.0)?;
        close(&with.coriolis_matrix, &without.coriolis_matrix, 0.0)?;
    }

    /// Compared: J q̇ and the velocity of the frame; the velocity and central differences of the pose.
    #[test]
    fn jacobian_is_pose_derivative(case in case()) {
        let data = case.evaluated();
        let jacobian = jacobian(case.model.n(), |j| frame_jacobian(&case.model, &data, case.tip, j));
        let velocity = frame_velocity(&case.model, &data, case.tip);
        close(&(&jacobian * vector(&case.dq)), &stacked(&velocity), ROUNDING)?;

        let pose = |t: f64| {
            let data = case.moved(&case.dq, t).evaluated();
            frame_placement(&case.model, &data, case.tip)
        };
        let (before, now, after) = (pose(-STEP), pose(0.0), pose(STEP));
        close(&((after.translation - before.translation) / (2.0 * STEP)), &velocity.linear, DIFFERENCE)?;
        let spin = (after.rotation - before.rotation) / (2.0 * STEP) * now.rotation.transpose();
        close(&spin, &velocity.angular.cross_matrix(), DIFFERENCE)?;
    }

    /// Compared: J̇ q̇, and central differences of the velocity of the frame at constant q̇.
    #[test]
    fn bias_acceleration_is_velocity_derivative(case in case()) {
        let data = case.evaluated();
        let velocity = |t: f64| {
            let data = case.moved(&case.dq, t).evaluated();
            frame_velocity(&case.model, &data, case.tip)
        };
        let rate = (velocity(STEP) - velocity(-STEP)) * (0.5 / STEP);
        let bias = frame_bias_acceleration(&case.model, &data, case.tip);
        close(&rate.linear, &bias.linear, DIFFERENCE)?;
        close(&rate.angular, &bias.angular, DIFFERENCE)?;
    }

    /// Compared: C q̇, and RNEA's bias minus gravity; C + Cᵀ, and central differences of M in time.
    #[test]
    fn coriolis_matrix_matches_bias_and_mass_matrix_rate(case in case()) {
        let data = case.evaluated();
        let coriolis = &data.coriolis_matrix;
        close(&(coriolis * vector(&case.dq)), &(&data.bias - &data.gravity), ROUNDING)?;
        let mass = |t: f64| mass_matrix(&case.moved(&case.dq, t));
        let rate = (mass(STEP) - mass(-STEP)) / (2.0 * STEP);
        close(&(coriolis + coriolis.transpose()), &rate, DIFFERENCE)?;
    }

    /// Compared: C, and the Christoffel symbols from differences of M: C_ij = ½ Σ_k (∂_k M_ij + ∂_j M_ik − ∂_i M_jk)
    /// q̇_k.
    #[test]
    fn coriolis_matrix_matches_christoffel_symbols(case in jointed()) {
        let n = case.model.n();
        let gradient: Vec<DMatrix<f64>> = (0..n)
            .map(|k| {
                let mass = |t: f64| mass_matrix(&case.moved(&unit(n, k), t));
                (mass(STEP) - mass(-STEP)) / (2.0 * STEP)
            })
            .collect();
        let expected = DMatrix::from_fn(n, n, |i, j| {
            (0..n).map(|k| 0.5 * (gradient[k][(i, j)] + gradient[j][(i, k)] - gradient[i][(j, k)]) * case.dq[k]).sum()
        });
        close(&case.evaluated().coriolis_matrix, &expected, DIFFERENCE)?;
    }

    /// Compared: gravity torques, and the gradient of the potential energy.
    #[test]
    fn gravity_is_potential_energy_gradient(case in case()) {
        let n = case.model.n();
        let energy = |k: usize, t: f64| {
            potential_energy(&case.model, &case.moved(&unit(n, k), t).evaluated())
        };
        let gradient: Vec<f64> = (0..n).map(|k| (energy(k, STEP) - energy(k, -STEP)) / (2.0 * STEP)).collect();
        close(&case.evaluated().gravity, &gradient, DIFFERENCE)?;
    }

    /// Compared: kinetic energy, and ½ q̇ᵀ M q̇.
    #[test]
    fn kinetic_energy_matches_mass_matrix(case in case()) {
        let data = case.evaluated();
        let dq = vector(&case.dq);
        close(&[kinetic_energy(&case.model, &data)], &[0.5 * dq.dot(&(&data.mass_matrix * &dq))], ROUNDING)?;
    }

    /// Compared: the time derivative of the total energy, by central differences along the motion of ABA, and the power
    /// of the torques.
    #[test]
    fn energy_rate_equals_torque_power(case in case()) {
        let mut data = case.evaluated();
        aba(&case.model, &mut data, &case.tau);
        let ddq = data.ddq.as_slice().to_vec();
        // The step is reduced so that velocities change no more than positions do in other tests.
        let step = STEP / vector(&ddq).amax().max(1.0).sqrt();
        let energies = |t: f64| {
            let q = moved(&case.model, &case.q, &plus(&case.dq, &ddq, 0.5 * t), t);
            let data = evaluated(&case.model, &q, &plus(&case.dq, &ddq, t));
            [kinetic_energy(&case.model, &data), potential_energy(&case.model, &data)]
        };
        let rate = (energies(step).iter().sum::<f64>() - energies(-step).iter().sum::<f64>()) / (2.0 * step);
        // Cancellation error: the difference of energies of some hundred joules over this short step loses digits.
        let size = energies(0.0).iter().map(|e| e.abs()).sum::<f64>() + 100.0;
        let tolerance = DIFFERENCE + 4.0 * f64::EPSILON * size / step;
        close(&[rate], &[vector(&case.tau).dot(&vector(&case.dq))], tolerance)?;
    }

    /// Compared: the results of [`update`], and those of the single functions.
    #[test]
    fn update_equals_single_algorithms(case in case()) {
        let mut alone = case.evaluated();
        bias(&case.model, &mut alone);
        gravity(&case.model, &mut alone);
        crba(&case.model, &mut alone);
        let mut at_once = Data::new(&case.model);
        prop_assert!(update(&case.model, &mut at_once, &case.q, &case.dq));
        close(&at_once.bias, &alone.bias, ROUNDING)?;
        close(&at_once.gravity, &alone.gravity, ROUNDING)?;
        close(&at_once.mass_matrix, &alone.mass_matrix, ROUNDING)?;
    }

    /// Compared: a robot whose base and gravity are rotated together and whose base is moved, and the original robot.
    /// Only the poses differ.
    #[test]
    fn torques_are_invariant_to_world_rotation(case in case(), world in placement()) {
        let turned = case.model.clone()
            .with_base(world * case.model.base())
            .with_gravity(world.rotation * case.model.gravity());
        let (mut here, mut there) =
            (case.evaluated(), evaluated(&turned, &case.q, &case.dq));
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
        close_placement(&expected, &frame_placement(&turned, &there, case.tip), ROUNDING)?;
    }

    /// Compared: a model with a joint at rest at an angle, and the model with the joint locked there: bias and mass
    /// matrix of the other joints, and the pose of the tip.
    #[test]
    fn locked_joint_equals_joint_at_rest(
        case in case(),
        at in -3.0..3.0f64,
        which in any::<prop::sample::Index>(),
    ) {
        let (n, first, ahead) = (case.model.n(), case.first_joint(), case.surplus_coordinates());
        prop_assume!(n > first);
        let which = first + which.index(n - first);
        let locked = case.model.with_locked_joints(&[(which, at)]).unwrap();
        let (mut q, mut dq) = (case.q.clone(), case.dq.clone());
        (q[ahead + which], dq[which]) = (at, 0.0);
        let whole = evaluated(&case.model, &q, &dq);
        q.remove(ahead + which);
        let left: Vec<usize> = (0..n).filter(|&i| i != which).collect();
        let pick = |values: &[f64]| -> Vec<f64> { left.iter().map(|&i| values[i]).collect() };
        let part = evaluated(&locked, &q, &pick(&dq));
        close(&part.bias, &pick(whole.bias.as_slice()), ROUNDING)?;
        let expected = DMatrix::from_fn(n - 1, n - 1, |i, j| whole.mass_matrix[(left[i], left[j])]);
        close(&part.mass_matrix, &expected, ROUNDING)?;
        let (a, b) = (frame_placement(&case.model, &whole, case.tip), frame_placement(&locked, &part, case.tip));
        close_placement(&a, &b, ROUNDING)?;
    }

    /// Compared: torques of a robot with scaled masses and inertias, and the scaled torques of the robot.
    #[test]
    fn torques_scale_with_inertia(case in case(), factor in 0.1..10.0f64) {
        let heavy = case.model.clone().with_scaled_inertia(factor);
        let (mut light, mut scaled) =
            (case.evaluated(), evaluated(&heavy, &case.q, &case.dq));
        rnea(&case.model, &mut light, &case.ddq);
        rnea(&heavy, &mut scaled, &case.ddq);
        close(&(light.torque * factor), &scaled.torque, ROUNDING)?;
    }

    /// Checks J N = 0, J J̄ = 1, N N = N, Λ J M⁻¹ Jᵀ = 1 and J M⁻¹ Nᵀ = 0: null-space torques do not accelerate the
    /// task.
    #[test]
    fn nullspace_torques_do_not_accelerate_task(case in case(), rows in 1..4usize) {
        let n = case.model.n();
        let data = case.evaluated();
        let jacobian = jacobian(n, |j| frame_jacobian(&case.model, &data, case.tip, j));
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
        prop_assert_eq!(space.min_singular_gain, 1.0);
    }

    /// Compared: Λ and the smallest gain near a singular pose, and those by the spectrum of Λ⁻¹ with the documented
    /// formula, for thresholds between its eigenvalues. The smallest one is scaled down to zero.
    #[test]
    fn inertia_near_singular_pose_is_that_of_spectrum(
        case in case(),
        rows in 1..7usize,
        between in 0..3usize,
        scale in proptest::sample::select(vec![1.0, 1e-2, 1e-5, 1e-9, 0.0]),
    ) {
        let n = case.model.n();
        let data = case.evaluated();
        let mut jacobian = jacobian(n, |j| frame_jacobian(&case.model, &data, case.tip, j));
        let mass_matrix = data.mass_matrix.clone().cholesky().unwrap();
        let mobility = |jacobian: &Matrix6xX<f64>| {
            let task = jacobian.rows(0, rows).into_owned();
            &task * mass_matrix.solve(&task.transpose())
        };
        let spectrum = mobility(&jacobian).symmetric_eigen();
        let smallest = spectrum.eigenvectors.column(spectrum.eigenvalues.imin()).into_owned();
        let task = jacobian.rows(0, rows).into_owned();
        let lost = &smallest * (smallest.transpose() * &task) * (1.0 - scale);
        jacobian.rows_mut(0, rows).copy_from(&(task - lost));

        let spectrum = mobility(&jacobian).symmetric_eigen();
        let mut values: Vec<f64> = spectrum.eigenvalues.iter().copied().collect();
        values.sort_by(f64::total_cmp);
        // A threshold below, between or above the eigenvalues, away from those that rounding changes.
        let largest = values[rows - 1];
        prop_assume!(largest > 1e-6);
        let floor = match between {
            0 => 1e-6 * largest,
            1 => (values[0].max(1e-8 * largest) * values[(rows - 1).min(1)].max(1e-8 * largest)).sqrt(),
            _ => 2.0 * largest,
        };
        let reciprocal = |value: f64| {
            let value = value.max(0.0);
            let mu = if value < floor { floor * (1.0 - (value / floor).powi(2)) } else { 0.0 };
            if value > 0.0 { value / (value * value + mu * mu) } else { 0.0 }
        };
        let gain = values.iter().map(|value| value.max(0.0) * reciprocal(*value)).fold(1.0, f64::min);
        let inverse = DMatrix::from_diagonal(&spectrum.eigenvalues.map(reciprocal));
        let expected = &spectrum.eigenvectors * inverse * spectrum.eigenvectors.transpose();

        let mut space = OperationalSpace::new(n);
        let reference = 3.0;
        let inversion = Inversion::Damped(floor / reference);
        space.update_inertia(&data.mass_matrix_factor, &jacobian, rows, inversion, Some(reference), None);
        let inertia = space.task_inertia.view((0, 0), (rows, rows)).into_owned();
        // Relative to the slope of the formula, whose largest value is 1/floor².
        let rounding = ROUNDING * (1.0 + largest / floor) / floor.min(1.0);
        let error = (&inertia - &expected).amax();
        prop_assert!(error <= rounding, "{error:e} of {rounding:e}: {inertia} {expected} {values:?} {floor:e}");
        let error = (space.min_singular_gain - gain).abs();
        prop_assert!(error <= ROUNDING * (1.0 + largest / floor), "{error:e}: {values:?} {floor:e}");
    }

    /// Compared: Jacobian and velocity of a frame on the base during any joint motion, and zero; its pose, and its
    /// placement on the base.
    #[test]
    fn base_frame_has_zero_velocity(case in jointed(), place in placement()) {
        let mut model = case.model.clone();
        let stand = model.add_frame("stand", None, place);
        let mut data = Data::new(&model);
        kinematics(&model, &mut data, &case.q, &case.dq);
        let jacobian = jacobian(model.n(), |j| frame_jacobian(&model, &data, stand, j));
        prop_assert!(jacobian.iter().all(|&x| x == 0.0));
        prop_assert_eq!(frame_placement(&model, &data, stand), model.base() * place);
        prop_assert_eq!(frame_velocity(&model, &data, stand), opspace_model::Motion::zero());
    }
}

//! Compares every algorithm with an independent computation, on random trees with a fixed or floating base and with
//! mimic joints. The equation of motion itself is tested in `identities.rs`.
#![expect(clippy::unwrap_used, reason = "a test")]

use crate::common::{
    Case, DIFFERENCE, INVERSE, MimicTree, ROUNDING, STEP, case, close, close_placement, config, evaluated,
    first_joint, fixed, inertia, jacobian, mimic_tree, placement, plus, stacked, triple, unit, vector,
    wrench,
};
use nalgebra::{DMatrix, DVector, Matrix3, Matrix3xX, Matrix6xX, Vector3};
use opspace_model::{
    Data, FrameId, Inertia, Joint, JointKind, Limits, MassMatrixFactor, MimicConstraint, Model, Motion,
    OperationalSpace, Placement, ReduceError, UrdfErrorKind, UrdfOptions, UrdfWarningKind, aba,
    aba_derivatives, aba_external, center_of_mass, centroidal_map, centroidal_momentum, com_jacobian,
    frame_bias_acceleration, frame_jacobian, frame_jacobian_rate, frame_placement, frame_velocity,
    inertial_parameters, kinetic_energy, local_jacobian, local_jacobian_rate, mass_matrix_inverse,
    point_jacobian, potential_energy, relative_jacobian, rnea, rnea_derivatives, rnea_external,
    torque_regressor, world_jacobian, world_jacobian_rate,
};
use proptest::prelude::*;
use proptest::sample::Index;

/// Time derivative of a matrix along the motion of a case, by central differences.
fn rate(case: &Case, of: impl Fn(&Case) -> DMatrix<f64>) -> DMatrix<f64> {
    (of(&case.moved(&case.dq, STEP)) - of(&case.moved(&case.dq, -STEP))) / (2.0 * STEP)
}

/// Derivative of a vector with respect to every coordinate of q, along the axes of q̇, by central differences.
fn by_q(case: &Case, of: impl Fn(&Case) -> DVector<f64>) -> DMatrix<f64> {
    let column = |i| {
        let along = unit(case.model.n(), i);
        (of(&case.moved(&along, STEP)) - of(&case.moved(&along, -STEP))) / (2.0 * STEP)
    };
    DMatrix::from_columns(&(0..case.model.n()).map(column).collect::<Vec<_>>())
}

/// Derivative of a vector with respect to every coordinate of q̇, by central differences.
fn by_dq(case: &Case, of: impl Fn(&Case) -> DVector<f64>) -> DMatrix<f64> {
    let n = case.model.n();
    let faster = |i, by| Case { dq: plus(&case.dq, &unit(n, i), by), ..case.clone() };
    let column = |i| (of(&faster(i, STEP)) - of(&faster(i, -STEP))) / (2.0 * STEP);
    DMatrix::from_columns(&(0..n).map(column).collect::<Vec<_>>())
}

fn dense(m: Matrix6xX<f64>) -> DMatrix<f64> {
    DMatrix::from_column_slice(6, m.ncols(), m.as_slice())
}

fn tip_jacobian(case: &Case) -> Matrix6xX<f64> {
    let data = case.evaluated();
    jacobian(case.model.n(), |j| frame_jacobian(&case.model, &data, case.tip, j))
}

fn inverse_dynamics(case: &Case) -> DVector<f64> {
    let mut data = case.evaluated();
    rnea(&case.model, &mut data, &case.ddq);
    data.torque
}

fn forward_dynamics(case: &Case) -> DVector<f64> {
    let mut data = case.evaluated();
    aba(&case.model, &mut data, &case.tau);
    data.ddq
}

fn com(case: &Case) -> DVector<f64> {
    vector(center_of_mass(&case.model, &case.evaluated()).expect("it weighs something").as_slice())
}

fn com_jacobian_of(case: &Case) -> Matrix3xX<f64> {
    let mut out = Matrix3xX::repeat(case.model.n(), f64::NAN);
    com_jacobian(&case.model, &mut case.evaluated(), &mut out);
    out
}

proptest! {
    #![proptest_config(config(192))]

    /// Compared: solutions with the factor (a vector, the inverse, and a Jacobian in two steps), and those with the
    /// dense Cholesky factorization of nalgebra.
    #[test]
    fn factor_matches_dense_cholesky(case in case()) {
        let n = case.model.n();
        let mut data = case.evaluated();
        let oracle = data.mass_matrix.clone().cholesky().unwrap();

        let mut x = case.tau.clone();
        data.mass_matrix_factor.solve(&mut x);
        close(&x, &oracle.solve(&vector(&case.tau)), INVERSE)?;
        // The residual does not depend on the condition of M.
        close(&(&data.mass_matrix * vector(&x)), &case.tau, ROUNDING * vector(&x).amax().max(1.0))?;

        mass_matrix_inverse(&mut data);
        close(&data.mass_matrix_inverse, &oracle.inverse(), INVERSE)?;
        close(&(&data.mass_matrix * &data.mass_matrix_inverse), &DMatrix::identity(n, n), INVERSE)?;
        close(&data.mass_matrix_inverse, &data.mass_matrix_inverse.transpose(), ROUNDING)?;

        // One Jacobian with zero columns for the joints that do not move the tip, and one without zeros.
        let full = Matrix6xX::from_fn(n, |r, c| 1.0 + ((7 * r + c) as f64).sin());
        for j in [tip_jacobian(&case), full] {
            let mut half = j.clone();
            let mobility = data.mass_matrix_factor.mobility(&mut half);
            let expected = oracle.solve(&dense(j.clone()).transpose());
            close(&mobility, &(&j * &expected), INVERSE)?;
            data.mass_matrix_factor.finish_solve(&mut half);
            close(&half, &expected.transpose(), INVERSE)?;
        }
    }

    /// Compared: the initial and the reset factor, and the identity. A matrix that is not positive definite is refused.
    #[test]
    fn factor_keeps_identity_and_refuses_indefinite_matrix(case in case()) {
        let n = case.model.n();
        let mut factor = MassMatrixFactor::new(&case.model);
        let mut inverse = DMatrix::zeros(n, n);
        factor.inverse(&mut inverse);
        prop_assert_eq!(&inverse, &DMatrix::identity(n, n));
        let mut mass_matrix = case.evaluated().mass_matrix;
        prop_assert!(factor.update(&mass_matrix));
        let mut x = case.tau.clone();
        factor.set_identity();
        factor.solve(&mut x);
        prop_assert_eq!(&x, &case.tau);
        mass_matrix[(0, 0)] = -mass_matrix[(0, 0)];
        prop_assert!(!factor.update(&mass_matrix));
        mass_matrix[(0, 0)] = f64::NAN;
        prop_assert!(!factor.update(&mass_matrix));
    }

    /// Compared: J̇ in the three kinds of axes, and central differences of J in time; J̇ q̇, and the bias acceleration.
    #[test]
    fn jacobian_rate_matches_difference(case in case()) {
        let (model, tip, n, data) = (&case.model, case.tip, case.model.n(), case.evaluated());
        let differs = |fill: fn(&Model, &Data, FrameId, &mut Matrix6xX<f64>)| {
            rate(&case, |c| dense(jacobian(n, |j| fill(model, &c.evaluated(), tip, j))))
        };
        let aligned = jacobian(n, |j| frame_jacobian_rate(model, &data, tip, j));
        close(&aligned, &differs(frame_jacobian), DIFFERENCE)?;
        close(&jacobian(n, |j| local_jacobian_rate(model, &data, tip, j)), &differs(local_jacobian), DIFFERENCE)?;
        close(&jacobian(n, |j| world_jacobian_rate(model, &data, tip, j)), &differs(world_jacobian), DIFFERENCE)?;
        let bias = stacked(&frame_bias_acceleration(model, &data, tip));
        close(&(aligned * vector(&case.dq)), &bias, ROUNDING)?;
    }

    /// Compared: the local and the world Jacobian, and the aligned Jacobian after rotation and shift.
    #[test]
    fn local_world_and_aligned_jacobians_agree(case in case()) {
        let (model, data) = (&case.model, case.evaluated());
        let aligned = tip_jacobian(&case);
        let local = jacobian(model.n(), |j| local_jacobian(model, &data, case.tip, j));
        let world = jacobian(model.n(), |j| world_jacobian(model, &data, case.tip, j));
        let Placement { rotation, translation } = frame_placement(model, &data, case.tip);
        let (linear, angular) = (aligned.fixed_rows::<3>(0), aligned.fixed_rows::<3>(3));
        close(local.fixed_rows::<3>(0).into_owned().iter(), &(rotation.transpose() * linear), ROUNDING)?;
        close(local.fixed_rows::<3>(3).into_owned().iter(), &(rotation.transpose() * angular), ROUNDING)?;
        // The world origin is at -p relative to the tip: v + ω × (-p).
        let shifted = linear + translation.cross_matrix() * angular;
        close(world.fixed_rows::<3>(0).into_owned().iter(), &shifted, ROUNDING)?;
        close(world.fixed_rows::<3>(3).into_owned().iter(), angular.into_owned().iter(), ROUNDING)?;
    }

    /// Compared: the Jacobian of a point at zero offset, and that of the frame; at another offset, and that of a frame
    /// placed there.
    #[test]
    fn point_jacobian_matches_frame_at_point(case in case(), point in triple(0.5)) {
        let point = Vector3::from(point);
        let mut model = case.model.clone();
        let there = Placement { translation: point, ..Placement::identity() };
        let there = model.add_frame_on("there", case.tip, there);
        let data = evaluated(&model, &case.q, &case.dq);
        let at = |p: &Vector3<f64>| jacobian(model.n(), |j| point_jacobian(&model, &data, case.tip, p, j));
        prop_assert_eq!(at(&Vector3::zeros()), tip_jacobian(&case));
        close(&at(&point), &jacobian(model.n(), |j| frame_jacobian(&model, &data, there, j)), ROUNDING)?;
    }

    /// Compared: the velocity from the relative Jacobian, and central differences of the relative pose in time.
    #[test]
    fn relative_jacobian_is_relative_pose_derivative(case in case()) {
        let (model, n) = (&case.model, case.model.n());
        let pose = |case: &Case| {
            let data = case.evaluated();
            frame_placement(model, &data, case.second).inverse() * frame_placement(model, &data, case.tip)
        };
        let data = case.evaluated();
        let relative = jacobian(n, |j| relative_jacobian(model, &data, case.second, case.tip, j));
        let motion = relative * vector(&case.dq);
        let (before, now, after) =
            (pose(&case.moved(&case.dq, -STEP)), pose(&case), pose(&case.moved(&case.dq, STEP)));
        let linear = (after.translation - before.translation) / (2.0 * STEP);
        close(&motion.as_slice()[..3], &linear, DIFFERENCE)?;
        let spin = (after.rotation - before.rotation) / (2.0 * STEP) * now.rotation.transpose();
        close(&Vector3::from_column_slice(&motion.as_slice()[3..]).cross_matrix(), &spin, DIFFERENCE)?;
    }

    /// Compared: the relative Jacobian of swapped frames, and the negative original in the other frame; that of a frame
    /// relative to itself, and zero; that relative to a frame on a fixed base, and the rotated Jacobian of the frame.
    #[test]
    fn swapped_frames_reverse_relative_jacobian(case in case()) {
        let (model, n, data) = (&case.model, case.model.n(), case.evaluated());
        let relative = |from, frame| jacobian(n, |j| relative_jacobian(model, &data, from, frame, j));
        let (there, back) = (relative(case.second, case.tip), relative(case.tip, case.second));
        let Placement { rotation, translation } =
            frame_placement(model, &data, case.second).inverse() * frame_placement(model, &data, case.tip);
        let (linear, angular) = (there.fixed_rows::<3>(0), there.fixed_rows::<3>(3));
        let axes = -rotation.transpose();
        let at_second = linear + translation.cross_matrix() * angular;
        close(back.fixed_rows::<3>(0).into_owned().iter(), &(axes * at_second), ROUNDING)?;
        close(back.fixed_rows::<3>(3).into_owned().iter(), &(axes * angular), ROUNDING)?;
        close(&relative(case.tip, case.tip), &Matrix6xX::zeros(n), ROUNDING)?;
        if !model.is_floating() {
            let mut model = model.clone();
            let stand = model.add_frame("stand", None, Placement::identity());
            let from_stand = jacobian(n, |j| relative_jacobian(&model, &data, stand, case.tip, j));
            let turned = model.base().rotation.transpose() * tip_jacobian(&case).fixed_rows::<3>(0);
            close(from_stand.fixed_rows::<3>(0).into_owned().iter(), &turned, ROUNDING)?;
        }
    }

    /// Compared: every column of the Jacobian of the centre of mass, and differences of the centre of mass; the linear
    /// part of the centroidal map, and mass times this Jacobian.
    #[test]
    fn com_jacobian_is_com_gradient(case in case()) {
        let com_jacobian = com_jacobian_of(&case);
        close(&com_jacobian, &by_q(&case, com), DIFFERENCE)?;
        let mut data = case.evaluated();
        centroidal_map(&case.model, &mut data);
        let linear = data.centroidal_map.fixed_rows::<3>(0).into_owned();
        close(&linear, &(com_jacobian * case.model.total_mass()), ROUNDING)?;
    }

    /// Compared: gravity torques, and the torques that balance the weight at the centre of mass, from the transpose of
    /// its Jacobian.
    #[test]
    fn gravity_acts_at_com(case in case()) {
        let weight = case.model.gravity() * case.model.total_mass();
        close(&case.evaluated().gravity, &(com_jacobian_of(&case).transpose() * -weight), ROUNDING)?;
    }

    /// Compared: the centroidal map times q̇ and the centroidal momentum, and the sum of the momenta of all bodies.
    #[test]
    fn momentum_is_sum_over_bodies(case in case()) {
        let mut data = case.evaluated();
        centroidal_map(&case.model, &mut data);
        let momentum = centroidal_momentum(&case.model, &data);
        let momentum: Vec<f64> = momentum.linear.iter().chain(&momentum.angular).copied().collect();
        close(&(&data.centroidal_map * vector(&case.dq)), &momentum, ROUNDING)?;

        let center = center_of_mass(&case.model, &data).unwrap();
        let (mut linear, mut angular) = (Vector3::zeros(), Vector3::zeros());
        for (i, body) in case.model.bodies().iter().enumerate() {
            let Placement { rotation, .. } = data.placement[i];
            let com = data.placement[i].act_point(&body.inertia.com);
            let v = data.velocity[i].shifted_to(&(com - data.origin));
            let p = v.linear * body.inertia.mass;
            linear += p;
            angular += rotation * body.inertia.rotational * rotation.transpose() * v.angular
                + (com - center).cross(&p);
        }
        close(&momentum[..3], &linear, ROUNDING)?;
        close(&momentum[3..], &angular, ROUNDING)?;
    }

    /// Compared: inverse dynamics with wrenches at frames, and torques through the Jacobians of the frames; forward
    /// dynamics of the resulting torques, and the original accelerations.
    #[test]
    fn wrenches_act_through_jacobian_transpose(case in case(), at_tip in wrench(), at_second in wrench()) {
        let (model, n) = (&case.model, case.model.n());
        let wrenches = [(case.tip, at_tip), (case.second, at_second)];
        let mut data = case.evaluated();
        let mut through = DVector::zeros(n);
        for (frame, f) in &wrenches {
            let j = jacobian(n, |j| frame_jacobian(model, &data, *frame, j));
            through += j.transpose() * vector(&stacked(&Motion { linear: f.linear, angular: f.angular }));
        }
        rnea_external(model, &mut data, &case.ddq, &wrenches);
        close(&data.torque, &(inverse_dynamics(&case) - &through), ROUNDING)?;
        let tau = data.torque.as_slice().to_vec();
        aba_external(model, &mut data, &tau, &wrenches);
        close(&data.ddq, &case.ddq, INVERSE)?;
        close(&data.torque, &(vector(&tau) + through), ROUNDING)?;
    }

    /// Compared: ∂τ/∂q and ∂τ/∂q̇, and central differences of the torques of RNEA, for all columns.
    #[test]
    fn inverse_dynamics_derivatives_match_differences(case in case()) {
        let mut data = case.evaluated();
        rnea_derivatives(&case.model, &mut data, &case.ddq);
        close(&data.torque, &inverse_dynamics(&case), 0.0)?;
        close(&data.torque_by_q, &by_q(&case, inverse_dynamics), DIFFERENCE)?;
        close(&data.torque_by_dq, &by_dq(&case, inverse_dynamics), DIFFERENCE)?;
    }

    /// Compared: ∂q̈/∂q and ∂q̈/∂q̇, and central differences of the accelerations of ABA, for all columns.
    #[test]
    fn forward_dynamics_derivatives_match_differences(case in case()) {
        let mut data = case.evaluated();
        aba_derivatives(&case.model, &mut data, &case.tau);
        close(&data.ddq, &forward_dynamics(&case), 0.0)?;
        // Light bodies have large accelerations, whose rounding errors make the differences noisy.
        let tolerance = DIFFERENCE * data.ddq.amax().max(1.0);
        close(&data.ddq_by_q, &by_q(&case, forward_dynamics), tolerance)?;
        close(&data.ddq_by_dq, &by_dq(&case, forward_dynamics), tolerance)?;
    }

    /// Compared: the regressor times the parameters of all bodies, and RNEA without rotors.
    #[test]
    fn inverse_dynamics_are_linear_in_parameters(case in case()) {
        let rotorless = case.model.clone().with_rotor_inertia(&vec![0.0; case.model.n()]);
        let case = Case { model: rotorless, ..case };
        let parameters: Vec<f64> =
            case.model.bodies().iter().flat_map(|body| inertial_parameters(&body.inertia)).collect();
        let mut regressor = DMatrix::repeat(case.model.n(), parameters.len(), f64::NAN);
        torque_regressor(&case.model, &mut case.evaluated(), &case.ddq, &mut regressor);
        close(&(regressor * vector(&parameters)), &inverse_dynamics(&case), ROUNDING)?;
    }
}

/// Contribution to M of a body fixed to `frame`: Jᵀ m J at its centre of mass, plus Jᵀ I J for its rotation.
fn added_mass(case: &Case, frame: FrameId, load: &Inertia) -> DMatrix<f64> {
    let (model, data) = (&case.model, case.evaluated());
    let j = jacobian(model.n(), |j| point_jacobian(model, &data, frame, &load.com, j));
    let axes = frame_placement(model, &data, frame).rotation;
    let (linear, angular) = (j.fixed_rows::<3>(0), axes.transpose() * j.fixed_rows::<3>(3));
    let moved = linear.transpose() * linear * load.mass;
    let turned = angular.transpose() * load.rotational * &angular;
    DMatrix::from_column_slice(model.n(), model.n(), (moved + turned).as_slice())
}

proptest! {
    #![proptest_config(config(128))]

    /// Compared: M with payloads, and M without them plus their contributions; the model after their removal, and the
    /// original, bit by bit.
    #[test]
    fn payload_adds_its_inertia_and_detaches_exactly(case in case(), load in inertia(), other in inertia()) {
        let before = case.evaluated();
        let mut loaded = case.clone();
        loaded.model.set_payload(case.second, other);
        loaded.model.set_payload(case.tip, load);
        let expected = &before.mass_matrix
            + added_mass(&case, case.tip, &load)
            + added_mass(&case, case.second, &other);
        close(&loaded.evaluated().mass_matrix, &expected, ROUNDING)?;
        // The second payload of a frame replaces the first.
        loaded.model.set_payload(case.tip, other);
        loaded.model.set_payload(case.tip, Inertia::zero());
        loaded.model.set_payload(case.second, Inertia::zero());
        prop_assert_eq!(loaded.model.bodies(), case.model.bodies());
        prop_assert_eq!(loaded.evaluated().mass_matrix, before.mass_matrix);
    }

    /// Compared: a body with a payload, and a body whose inertia is set to the sum by [`Model::set_inertia`].
    #[test]
    fn payload_equals_merged_body_inertia(case in case(), load in inertia()) {
        let mut loaded = case.clone();
        loaded.model.set_payload(case.tip, load);
        let tip = case.model.frame(case.tip);
        let (body, carried) = (tip.body.unwrap(), tip.placement.act_inertia(&load));
        let mut heavier = case.clone();
        heavier.model.set_inertia(body, case.model.bodies()[body].inertia + carried);
        prop_assert_eq!(loaded.model.bodies(), heavier.model.bodies());
        close(&inverse_dynamics(&loaded), &inverse_dynamics(&heavier), 0.0)?;
        // A new inertia of the body does not affect the payload.
        loaded.model.set_inertia(body, load);
        loaded.model.set_payload(case.tip, Inertia::zero());
        prop_assert_eq!(loaded.model.bodies()[body].inertia, load);
    }

    /// Compared: a frame that was moved with its payload, perhaps to another body, and a frame that was created there
    /// with this payload.
    #[test]
    fn payload_moves_with_its_frame(case in case(), load in inertia(), offset in placement()) {
        let mut moved = case.clone();
        moved.model.set_payload(case.tip, load);
        moved.model.move_frame(case.tip, case.second, offset);
        let mut made = case.clone();
        let there = made.model.add_frame_on("there", case.second, offset);
        made.model.set_payload(there, load);
        prop_assert_eq!(moved.model.bodies(), made.model.bodies());
        let (a, b) = (moved.evaluated(), made.evaluated());
        prop_assert_eq!(frame_placement(&moved.model, &a, case.tip), frame_placement(&made.model, &b, there));
        let expected = frame_placement(&case.model, &a, case.second) * offset;
        close_placement(&frame_placement(&made.model, &b, there), &expected, ROUNDING)?;
        // The frame is moved back to its original place.
        let home = case.model.frame(case.tip);
        let body = moved.model.add_frame("body", home.body, Placement::identity());
        moved.model.set_payload(case.tip, Inertia::zero());
        moved.model.move_frame(case.tip, body, home.placement);
        prop_assert_eq!(moved.model.bodies(), case.model.bodies());
    }

    /// Compared: several joints locked at once, and one after the other. A payload on the body of a locked joint is
    /// kept.
    #[test]
    fn joint_locking_is_order_independent(case in case(), load in inertia(), at in [-2.0..2.0f64, -2.0..2.0]) {
        let (first, n) = (case.first_joint(), case.model.n());
        prop_assume!(n >= first + 2);
        let mut model = case.model.clone();
        model.set_payload(case.tip, load);
        let both = model.with_locked_joints(&[(n - 1, at[1]), (first, at[0])]).unwrap();
        let one_by_one = model.with_locked_joints(&[(n - 1, at[1])]).unwrap().with_locked_joints(&[(first, at[0])]).unwrap();
        let keep = |values: &[f64], ahead: usize| {
            let mut kept = values.to_vec();
            kept.remove(n - 1 + ahead);
            kept.remove(first + ahead);
            kept
        };
        let (q, dq) = (keep(&case.q, case.surplus_coordinates()), keep(&case.dq, 0));
        let (a, b) = (evaluated(&both, &q, &dq), evaluated(&one_by_one, &q, &dq));
        close(&a.mass_matrix, &b.mass_matrix, ROUNDING)?;
        close(&a.bias, &b.bias, ROUNDING)?;
        // The payload can still be removed after locking.
        let mut unloaded = both.clone();
        unloaded.set_payload(case.tip, Inertia::zero());
        let without = case.model.with_locked_joints(&[(first, at[0]), (n - 1, at[1])]).unwrap();
        prop_assert_eq!(unloaded.bodies(), without.bodies());
        prop_assert_eq!(unloaded.rotor_inertia(), without.rotor_inertia());
    }

    /// Checks the errors for joints that cannot be locked or coupled.
    #[test]
    fn invalid_reductions_name_the_joint(case in case()) {
        let (first, n, model) = (case.first_joint(), case.model.n(), &case.model);
        let rule = |leader, ratio, offset| MimicConstraint { leader, ratio, offset };
        let refused = |error: ReduceError, words: &str| {
            prop_assert!(error.to_string().contains(words), "'{}' doesn't say '{}'", error, words);
            Ok(error)
        };
        let count = format!("the model has {n} joints, numbered from 0");
        refused(model.with_locked_joints(&[(n, 0.0)]).unwrap_err(), &count)?;
        if model.is_floating() {
            let base = refused(model.with_locked_joints(&[(4, 0.0)]).unwrap_err(), "base.angular.y")?;
            prop_assert_eq!(base, ReduceError::Base { joint: "base.angular.y".into() });
        }
        prop_assume!(n > first);
        let name = || model.joints()[first].name.clone();
        let twice = refused(model.with_locked_joints(&[(first, 0.0), (first, 1.0)]).unwrap_err(), &name())?;
        prop_assert_eq!(twice, ReduceError::Repeated { joint: name() });
        let nowhere = refused(model.with_locked_joints(&[(first, f64::NAN)]).unwrap_err(), &name())?;
        prop_assert!(matches!(nowhere, ReduceError::NotFinite { value, .. } if value.is_nan()), "{}", nowhere);
        let nowhere = refused(model.with_mimic_constraints(&[(first, rule(n, 1.0, 0.0))]).unwrap_err(), &count)?;
        prop_assert_eq!(nowhere, ReduceError::NoSuchJoint { joint: n, count: n });
        let own = refused(model.with_mimic_constraints(&[(first, rule(first, 1.0, 0.0))]).unwrap_err(), &name())?;
        prop_assert_eq!(own, ReduceError::FollowsItself { joint: name() });
        for (ratio, offset) in [(f64::INFINITY, 0.0), (1.0, f64::NEG_INFINITY)] {
            let error = refused(model.with_mimic_constraints(&[(first, rule(n - 1, ratio, offset))]).unwrap_err(), &name())?;
            prop_assert!(matches!(error, ReduceError::NotFinite { value, .. } if value.is_infinite()), "{}", error);
        }
        if model.is_floating() {
            let base = refused(model.with_mimic_constraints(&[(first, rule(0, 1.0, 0.0))]).unwrap_err(), "base.linear.x")?;
            prop_assert_eq!(base, ReduceError::Base { joint: "base.linear.x".into() });
        }
        prop_assume!(n > first + 1);
        let twice = [(first, rule(first + 1, 1.0, 0.0)), (first, rule(first + 1, 2.0, 0.0))];
        prop_assert_eq!(model.with_mimic_constraints(&twice).unwrap_err(), ReduceError::Repeated { joint: name() });
        let circle = [(first, rule(first + 1, 1.0, 0.0)), (first + 1, rule(first, 2.0, 0.0))];
        let circle = model.with_mimic_constraints(&circle).unwrap_err();
        prop_assert!(matches!(circle, ReduceError::FollowsItself { .. }), "{}", circle);
    }
}

/// Returns the whole tree with all joints free, in the pose and motion of the tree with mimic joints.
fn free_tree(folded: &MimicTree) -> Case {
    let (case, map) = (&folded.case, folded.map());
    let through = |x: &[f64]| (&map * vector(x)).as_slice().to_vec();
    Case {
        model: folded.whole.clone(),
        q: folded.whole_q(&case.q),
        dq: through(&case.dq),
        ddq: through(&case.ddq),
        // Unused: many torques of the free tree correspond to the same torque on a leader.
        tau: vec![f64::NAN; folded.whole.n()],
        ..*case
    }
}

proptest! {
    #![proptest_config(config(192))]

    /// Compared: poses, velocities and Jacobians of the tree with mimic joints, and those of the free tree, with J = J'
    /// G.
    #[test]
    fn mimic_kinematics_match_constrained_free_joints(folded in mimic_tree()) {
        let (case, whole, map) = (&folded.case, free_tree(&folded), folded.map());
        let (model, free) = (&case.model, &whole.model);
        prop_assert!(model.has_mimic_constraints() && !free.has_mimic_constraints());
        let (mut a, mut b) = (case.evaluated(), whole.evaluated());
        for frame in [case.tip, case.second] {
            let place = frame_placement(model, &a, frame);
            close_placement(&place, &frame_placement(free, &b, frame), ROUNDING)?;
            let velocity = stacked(&frame_velocity(model, &a, frame));
            close(&velocity, &stacked(&frame_velocity(free, &b, frame)), ROUNDING)?;
            let bias = stacked(&frame_bias_acceleration(model, &a, frame));
            close(&bias, &stacked(&frame_bias_acceleration(free, &b, frame)), ROUNDING)?;
            for fill in [
                frame_jacobian,
                local_jacobian,
                world_jacobian,
                frame_jacobian_rate,
                local_jacobian_rate,
                world_jacobian_rate,
            ] {
                let through = jacobian(free.n(), |j| fill(free, &b, frame, j)) * &map;
                close(&jacobian(model.n(), |j| fill(model, &a, frame, j)), &through, ROUNDING)?;
            }
        }
        let relative = jacobian(free.n(), |j| relative_jacobian(free, &b, case.second, case.tip, j)) * &map;
        let found = jacobian(model.n(), |j| relative_jacobian(model, &a, case.second, case.tip, j));
        close(&found, &relative, ROUNDING)?;
        close(&com_jacobian_of(case), &(com_jacobian_of(&whole) * &map), ROUNDING)?;
        centroidal_map(model, &mut a);
        centroidal_map(free, &mut b);
        close(&a.centroidal_map, &(&b.centroidal_map * &map), ROUNDING)?;
        close(&com(case), &com(&whole), ROUNDING)?;
    }

    /// Compared: dynamics of the tree with mimic joints, and those of the free tree: M = Gᵀ M' G, C = Gᵀ C' G, h = Gᵀ
    /// h', τ = Gᵀ τ', Y = Gᵀ Y', and the energies, including rotors.
    #[test]
    fn mimic_dynamics_match_projected_free_joints(folded in mimic_tree()) {
        let (case, whole, map) = (&folded.case, free_tree(&folded), folded.map());
        let (mut a, mut b) = (case.evaluated(), whole.evaluated());
        close(&a.mass_matrix, &(map.transpose() * &b.mass_matrix * &map), ROUNDING)?;
        close(&a.coriolis_matrix, &(map.transpose() * &b.coriolis_matrix * &map), ROUNDING)?;
        close(&a.bias, &(map.transpose() * &b.bias), ROUNDING)?;
        close(&a.gravity, &(map.transpose() * &b.gravity), ROUNDING)?;
        close(&inverse_dynamics(case), &(map.transpose() * inverse_dynamics(&whole)), ROUNDING)?;
        let energies = |case: &Case, data: &Data| {
            [kinetic_energy(&case.model, data), potential_energy(&case.model, data)]
        };
        close(&energies(case, &a), &energies(&whole, &b), ROUNDING)?;
        let columns = 10 * case.model.bodies().len();
        let mut regressor = DMatrix::zeros(case.model.n(), columns);
        torque_regressor(&case.model, &mut a, &case.ddq, &mut regressor);
        let mut free = DMatrix::zeros(whole.model.n(), columns);
        torque_regressor(&whole.model, &mut b, &whole.ddq, &mut free);
        close(&regressor, &(map.transpose() * free), ROUNDING)?;
    }

    /// Compared: forward dynamics, and the dense solution (Gᵀ M' G)⁻¹ (τ − Gᵀ h'), which differs from the method of
    /// [`aba`].
    #[test]
    fn mimic_forward_dynamics_match_dense_solution(folded in mimic_tree()) {
        let (case, map) = (&folded.case, folded.map());
        let b = free_tree(&folded).evaluated();
        let mass_matrix = map.transpose() * &b.mass_matrix * &map;
        let expected = mass_matrix.cholesky().unwrap().solve(&(vector(&case.tau) - map.transpose() * &b.bias));
        close(&forward_dynamics(case), &expected, INVERSE)?;
    }

    /// Compared: derivatives of the tree with mimic joints, and those of the free tree: ∂τ/∂q = Gᵀ ∂τ'/∂q' G, and the
    /// same for q̇.
    #[test]
    fn mimic_derivatives_match_projected_free_joints(folded in mimic_tree()) {
        let (case, whole, map) = (&folded.case, free_tree(&folded), folded.map());
        let (mut a, mut b) = (case.evaluated(), whole.evaluated());
        rnea_derivatives(&case.model, &mut a, &case.ddq);
        rnea_derivatives(&whole.model, &mut b, &whole.ddq);
        close(&a.torque_by_q, &(map.transpose() * &b.torque_by_q * &map), ROUNDING)?;
        close(&a.torque_by_dq, &(map.transpose() * &b.torque_by_dq * &map), ROUNDING)?;
    }

    /// Compared: the remaining joints, and the same joints of the free tree. Names, kinds and limits are equal; rotor
    /// inertias are increased by ratio² times those of the followers.
    #[test]
    fn mimic_leaders_keep_limits_and_gain_rotors(folded in mimic_tree()) {
        let (model, whole, map, left) = (&folded.case.model, &folded.whole, folded.map(), folded.independent_joints());
        let joints: Vec<Joint> = left.iter().map(|&i| whole.joints()[i].clone()).collect();
        prop_assert_eq!(model.joints(), &joints[..]);
        let rotors: Vec<f64> = (0..model.n())
            .map(|i| map.column(i).iter().zip(whole.rotor_inertia()).map(|(g, rotor)| g * g * rotor).sum())
            .collect();
        close(model.rotor_inertia(), &rotors, ROUNDING)?;
        prop_assert_eq!(model.bodies().len(), whole.bodies().len());
        close(&[model.total_mass()], &[whole.total_mass()], 0.0)?;
    }

    /// Compared: mimic constraints applied in two steps, and all in one step.
    #[test]
    fn mimic_constraints_apply_one_after_another(folded in mimic_tree()) {
        let (&last, others) = folded.followers.split_last().unwrap();
        // The other followers do not depend on the joint that is removed first.
        let first = folded.whole.with_mimic_constraints(&[last]).unwrap();
        let number = |joint: usize| joint - usize::from(joint > last.0);
        let others: Vec<(usize, MimicConstraint)> = others
            .iter()
            .map(|&(joint, rule)| (number(joint), MimicConstraint { leader: number(rule.leader), ..rule }))
            .collect();
        let then = Case { model: first.with_mimic_constraints(&others).unwrap(), ..folded.case.clone() };
        let (a, b) = (folded.case.evaluated(), then.evaluated());
        close(&a.mass_matrix, &b.mass_matrix, ROUNDING)?;
        close(&a.bias, &b.bias, ROUNDING)?;
    }

    /// Compared: a mimic joint with ratio 0, and the joint locked at the offset.
    #[test]
    fn mimic_joint_with_zero_ratio_is_locked(
        case in fixed(),
        which in any::<(Index, Index)>(),
        offset in -2.0..2.0,
    ) {
        let n = case.model.n();
        prop_assume!(n > 1);
        let (joint, leader) = (which.0.index(n), which.1.index(n - 1));
        let rule = MimicConstraint { leader: if leader < joint { leader } else { leader + 1 }, ratio: 0.0, offset };
        let without = |values: &[f64]| [&values[..joint], &values[joint + 1..]].concat();
        let (q, dq) = (without(&case.q), without(&case.dq));
        let (folded, locked) =
            (case.model.with_mimic_constraints(&[(joint, rule)]).unwrap(), case.model.with_locked_joints(&[(joint, offset)]).unwrap());
        let (a, b) = (evaluated(&folded, &q, &dq), evaluated(&locked, &q, &dq));
        close(&a.mass_matrix, &b.mass_matrix, ROUNDING)?;
        close(&a.bias, &b.bias, ROUNDING)?;
        close(&a.coriolis_matrix, &b.coriolis_matrix, ROUNDING)?;
    }
}

/// A gripper with two fingers and a thumb. The second finger moves in the opposite direction and half as far; the thumb
/// on it rotates with its motion.
const GRIPPER: &str = r#"<robot name="gripper">
  <link name="base"><inertial><mass value="3"/>
    <inertia ixx="0.03" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.03"/></inertial></link>
  <link name="wrist"><inertial><origin xyz="0.1 0 0.2"/><mass value="2"/>
    <inertia ixx="0.02" ixy="0" ixz="0.001" iyy="0.03" iyz="0" izz="0.02"/></inertial></link>
  <link name="left"><inertial><origin xyz="0 0.02 0.03"/><mass value="0.3"/>
    <inertia ixx="0.002" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.002"/></inertial></link>
  <link name="right"><inertial><origin xyz="0 -0.02 0.03"/><mass value="0.4"/>
    <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.002"/></inertial></link>
  <link name="thumb"><inertial><origin xyz="0.05 0 0"/><mass value="0.2"/>
    <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/></inertial></link>
  <joint name="bend" type="revolute"><parent link="base"/><child link="wrist"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="50" velocity="3"/></joint>
  <joint name="grasp" type="prismatic"><parent link="wrist"/><child link="left"/><origin xyz="0 0 0.3"/>
    <axis xyz="0 1 0"/><limit lower="0" upper="0.04" effort="20" velocity="0.1"/></joint>
  <joint name="counter" type="prismatic"><parent link="wrist"/><child link="right"/><origin xyz="0 0 0.3"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="9"/>
    <mimic joint="grasp" multiplier="-0.5" offset="-0.01"/></joint>
  <joint name="close" type="revolute"><parent link="right"/><child link="thumb"/><origin xyz="0 0 0.1" rpy="0 0.3 0"/>
    <axis xyz="1 0 1"/><limit lower="-3" upper="3" effort="9" velocity="9"/>
    <mimic joint="counter" multiplier="20" offset="0.25"/></joint>
</robot>"#;

/// Compared: a URDF with enforced mimic joints, and the same URDF with all joints free at the positions prescribed by
/// the mimic rules.
#[test]
fn urdf_mimic_joints_are_enforced() -> Result<(), TestCaseError> {
    let fold = |floating_base| UrdfOptions { floating_base, enforce_mimic: true, ..UrdfOptions::default() };
    for floating_base in [false, true] {
        let free = Model::from_urdf_with(
            GRIPPER,
            UrdfOptions { floating_base, enforce_mimic: false, ..UrdfOptions::default() },
        )
        .unwrap();
        let folded = Model::from_urdf_with(GRIPPER, fold(floating_base)).unwrap();
        let mimics = |w: &&opspace_model::UrdfWarning| matches!(w.kind(), UrdfWarningKind::Mimic { .. });
        assert_eq!(free.warnings.iter().filter(mimics).count(), 2);
        assert_eq!(folded.warnings, []);
        let (free, folded) = (free.model, folded.model);
        let first = first_joint(&folded);
        let names: Vec<&str> = folded.joints()[first..].iter().map(|j| j.name.as_str()).collect();
        assert_eq!(names, ["bend", "grasp"]);
        assert_eq!(folded.joints()[first + 1].limits.upper, 0.04);

        let base = if floating_base { vec![0.1, 0.2, 0.3, 0.0, 0.6, 0.0, -0.8] } else { vec![] };
        let (bend, grasp) = (0.7, 0.03);
        let counter = -0.5 * grasp - 0.01;
        let close_q = 20.0 * counter + 0.25;
        // The children of a link are in the order of their joint names: counter with its thumb, then grasp.
        let whole_q = [&base[..], &[bend, counter, close_q, grasp]].concat();
        let q = [&base[..], &[bend, grasp]].concat();
        let (dq, whole_dq) = (vec![0.0; folded.n()], vec![0.0; free.n()]);
        let (a, b) = (evaluated(&folded, &q, &dq), evaluated(&free, &whole_q, &whole_dq));
        for link in ["wrist", "left", "right", "thumb"] {
            let place = frame_placement(&folded, &a, folded.frame_id(link).unwrap());
            close_placement(&place, &frame_placement(&free, &b, free.frame_id(link).unwrap()), ROUNDING)?;
        }
        let mut map = DMatrix::zeros(free.n(), folded.n());
        map.view_mut((0, 0), (first + 1, first + 1)).fill_with_identity();
        for (joint, ratio) in [("counter", -0.5), ("close", -10.0), ("grasp", 1.0)] {
            map[(free.joint(joint).unwrap(), first + 1)] = ratio;
        }
        close(&a.mass_matrix, &(map.transpose() * &b.mass_matrix * &map), ROUNDING)?;
        close(&a.gravity, &(map.transpose() * &b.gravity), ROUNDING)?;
    }
    Ok(())
}

/// Checks the errors for mimic joints with a missing leader or in a cycle: they name the joints and the line.
#[test]
fn invalid_mimic_joints_are_named() {
    let line_of = |text: &str, what: &str| text.lines().position(|l| l.contains(what)).unwrap() as u32 + 1;
    let fold = UrdfOptions { enforce_mimic: true, ..UrdfOptions::default() };

    let text = GRIPPER.replace("mimic joint=\"counter\"", "mimic joint=\"conter\"");
    let error = Model::from_urdf_with(&text, fold).unwrap_err();
    assert_eq!((error.line(), line_of(&text, "conter")), (Some(21), 21));
    assert_eq!(
        error.to_string(),
        "line 21: joint 'close' mimics 'conter', which is not a moving joint; the moving joints are: bend, counter, close, grasp"
    );
    assert!(matches!(error.kind(), UrdfErrorKind::UnknownLeader { .. }));

    for (leader, lines) in [("close", ["counter", "close"]), ("counter", ["counter", "counter"])] {
        // A cycle of two joints, and a joint that mimics itself; the error may name either joint.
        let text = GRIPPER.replace("mimic joint=\"grasp\"", &format!("mimic joint=\"{leader}\""));
        let error = Model::from_urdf_with(&text, fold).unwrap_err();
        let UrdfErrorKind::MimicsItself { joint } = error.kind() else { panic!("{error}") };
        assert!(lines.contains(&joint.as_str()), "{error}");
        assert_eq!(error.line(), Some(line_of(&text, &format!("joint name=\"{joint}\""))));
        assert!(error.to_string().contains(&format!("joint '{joint}' mimics itself")), "{error}");
    }
}

/// Checks that Λ and `min_singular_gain` are zero for a Jacobian that is not finite.
#[test]
fn non_finite_jacobian_gives_zero_lambda() {
    let model = chain(7);
    let data = evaluated(&model, &[0.3; 7], &[0.1; 7]);
    for bad in [f64::NAN, f64::INFINITY, 1e200] {
        let mut j = Matrix6xX::from_fn(7, |r, c| ((r + 2 * c) as f64).sin());
        j[(1, 3)] = bad;
        let mut space = OperationalSpace::new(7);
        space.update(&data.mass_matrix_factor, &j, 3, 1e-3);
        assert_eq!((space.min_singular_gain, space.task_inertia.amax()), (0.0, 0.0), "{bad}");
    }
}

/// Checks that mimic cycles are refused by an error that names a joint on the cycle, not a follower outside it, and
/// that overflowing ratios are refused.
#[test]
fn mimic_cycles_and_ratio_overflows_are_refused() {
    let model = chain(4);
    let follows = |leader: usize, ratio: f64| MimicConstraint { leader, ratio, offset: 0.0 };
    let circle = model
        .with_mimic_constraints(&[(0, follows(1, 1.0)), (1, follows(2, 1.0)), (2, follows(1, 1.0))])
        .unwrap_err();
    let ReduceError::FollowsItself { joint } = &circle else { panic!("{circle}") };
    assert!(joint == "j1" || joint == "j2", "{joint}");
    let huge = model.with_mimic_constraints(&[(1, follows(2, 1e200)), (2, follows(3, 1e200))]).unwrap_err();
    assert_eq!(huge, ReduceError::NotFinite { joint: "j1".to_owned(), value: f64::INFINITY });
    let folded = model.with_mimic_constraints(&[(1, follows(3, 1.0))]).unwrap();
    let following: Vec<bool> = folded.bodies().iter().map(|b| b.follows).collect();
    assert_eq!(following, [false, true, false, false]);
}

/// A chain of identical bodies.
fn chain(n: usize) -> Model {
    let mut model = Model::new("chain");
    for i in 0..n {
        let joint = Joint { name: format!("j{i}"), kind: JointKind::Continuous, limits: Limits::NONE };
        let inertia =
            Inertia { mass: 1.0, com: Vector3::new(0.02, 0.01, 0.1), rotational: Matrix3::identity() * 0.02 };
        model.add_body(
            i.checked_sub(1),
            Placement::from_rpy([1.1, 0.4, -0.3], [0.05, 0.02, 0.25]),
            joint,
            inertia,
        );
    }
    model
}

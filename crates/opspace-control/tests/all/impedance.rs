//! Springs, dampers and desired inertias, compared with the motion that forward dynamics computes under a force;
//! bounded decoupling; integral action; the speed limit.

use crate::common::{
    self, File, Numbers, Q0, accelerations, any_arm, at_state, control_context, four_joints, jacobian,
    sampled, six, step,
};
use nalgebra::{DMatrix, DVector, Matrix6, Rotation3, Vector3, Vector6};
use opspace_control::impedance::designed_damping;
use opspace_control::{AXIS_NAMES, Controller, Measurement, OperationalSpaceController};
use opspace_model::{
    Data, Force, Model, aba_external, frame_bias_acceleration, frame_placement, frame_velocity,
};

/// Tolerance of an acceleration or force that is computed in two ways, relative to its size; both invert matrices with
/// condition numbers around 1e4.
const ROUNDING: f64 = 1e-9;

/// Tolerance of poles, computed as eigenvalues of a non-symmetric matrix, relative to their size.
const POLES: f64 = 1e-6;

/// Random Λ and K of a task with `rows` rows; only some axes have springs if `loose`.
fn random_inertia_and_stiffness(
    numbers: &mut Numbers,
    rows: usize,
    loose: bool,
) -> (DMatrix<f64>, DMatrix<f64>) {
    let square = DMatrix::from_fn(rows, rows, |_, _| numbers.next());
    let inertia = &square * square.transpose() + DMatrix::identity(rows, rows) * 0.05;
    let mut stiffness = DMatrix::zeros(rows, rows);
    for i in 0..rows {
        let spring = numbers.between(10.0, 2000.0);
        stiffness[(i, i)] = if loose && numbers.below(3) == 0 { 0.0 } else { spring };
    }
    (inertia, stiffness)
}

fn padded(matrix: &DMatrix<f64>) -> Matrix6<f64> {
    let mut out = Matrix6::zeros();
    out.view_mut((0, 0), matrix.shape()).copy_from(matrix);
    out
}

/// D is symmetric, has no negative eigenvalue and is zero outside the task's rows. Compared: the square of L⁻¹ D L⁻ᵀ,
/// with Λ = L Lᵀ, with 4ζ² L⁻¹ K L⁻ᵀ; the D without negative eigenvalues that satisfies this is unique.
#[test]
fn designed_damping_is_square_root_of_stiffness() {
    let mut numbers = Numbers::new(31);
    for case in 0..300 {
        let rows = 1 + numbers.below(6);
        let (inertia, stiffness) = random_inertia_and_stiffness(&mut numbers, rows, true);
        let ratio = numbers.between(0.1, 2.0);
        let whole = designed_damping(&padded(&inertia), &padded(&stiffness), ratio);
        let damping = DMatrix::from_fn(rows, rows, |r, c| whole[(r, c)]);
        let size = damping.amax().max(1.0);
        assert!((whole - whole.transpose()).amax() < ROUNDING * size, "case {case}: not symmetric");
        assert!((whole - padded(&damping)).amax() < ROUNDING * size, "case {case}: beyond the task's rows");
        let least = damping.clone().symmetric_eigenvalues().min();
        assert!(least > -ROUNDING * size, "case {case}: an eigenvalue of {least} out of {size}");

        let lower = inertia.cholesky().expect("positive definite").l();
        let whitened = |matrix: &DMatrix<f64>| {
            let left = lower.solve_lower_triangular(matrix).expect("regular");
            lower.solve_lower_triangular(&left.transpose()).expect("regular")
        };
        let (d, k) = (whitened(&damping), whitened(&stiffness) * (4.0 * ratio * ratio));
        let off = (&d * &d - &k).amax() / k.amax().max(1.0);
        assert!(off < ROUNDING, "case {case}: off by {off}");
    }
}

/// The angle of each pole of Λ ẍ + D ẋ + K x = 0, an eigenvalue of the companion matrix, corresponds to the damping
/// ratio.
#[test]
fn every_mode_has_requested_damping_ratio() {
    let mut numbers = Numbers::new(32);
    for case in 0..100 {
        let rows = 1 + numbers.below(6);
        let (inertia, stiffness) = random_inertia_and_stiffness(&mut numbers, rows, false);
        let ratio = numbers.between(0.1, 0.9);
        let damping = designed_damping(&padded(&inertia), &padded(&stiffness), ratio);
        let damping = DMatrix::from_fn(rows, rows, |r, c| damping[(r, c)]);
        let inverse = inertia.clone().try_inverse().expect("positive definite");
        let mut companion = DMatrix::zeros(2 * rows, 2 * rows);
        companion.view_mut((0, rows), (rows, rows)).fill_with_identity();
        companion.view_mut((rows, 0), (rows, rows)).copy_from(&(&inverse * stiffness * -1.0));
        companion.view_mut((rows, rows), (rows, rows)).copy_from(&(inverse * damping * -1.0));
        for pole in companion.complex_eigenvalues().iter() {
            let of_pole = -pole.re / pole.norm();
            assert!(
                (of_pole - ratio).abs() < POLES,
                "case {case}: {of_pole} at {pole}, {ratio} was asked for"
            );
        }
    }
}

/// A moving hand under impedance control, displaced from its reference, with a force on it.
struct Held {
    model: Model,
    axes: &'static [usize],
    data: Data,
    measurement: Measurement,
    controller: OperationalSpaceController,
    /// Displacement of the hand, m and rad.
    away: Vector6<f64>,
    /// Displacement x − x_d, velocity ẋ, J and J̇ q̇ of the axes.
    off: DVector<f64>,
    velocity: DVector<f64>,
    jacobian: DMatrix<f64>,
    bias: DVector<f64>,
    /// Force on the axes, N and Nm.
    force: DVector<f64>,
    /// Force on another axis, which is not sensed.
    also: Option<(usize, f64)>,
}

/// Creates a case: `axes` of a random arm's hand with the parameters `keys`; the joints move at up to `speed` (rad/s).
fn held(numbers: &mut Numbers, axes: &'static [usize], keys: &str, speed: f64) -> Held {
    held_below("", numbers, axes, keys, speed)
}

/// Creates a case like [`held`] with a task `above` that has a higher priority, unless its text is empty. The limits are
/// not reached; the QPs are solved if there is a task above.
fn held_below(above: &str, numbers: &mut Numbers, axes: &'static [usize], keys: &str, speed: f64) -> Held {
    let n = 7 + numbers.below(3);
    let model = any_arm(n, numbers);
    let first = if above.is_empty() { "" } else { "\"above\", " };
    let motion: Vec<String> = axes.iter().map(|&a| format!("{} = \"motion\"", AXIS_NAMES[a])).collect();
    let text = format!(
        "priority = [{first}\"hand\", \"rest\"]\n{above}\n\
         [task.hand.cartesian]\nframe = \"hand\"\naxes = {{ {} }}\nreference = \"hold\"\nsingularity_threshold = 1e-3\n{keys}\n\
         [task.rest.joint-posture]\nfrequency_rad_per_s = 4.0\ndamping_ratio = 0.7\n",
        motion.join(", ")
    );
    let file = File::read(&text);
    let mut context = control_context(&model, "wrist");
    if !above.is_empty() {
        context.limits = common::unreached_limits(n);
    }
    let mut controller =
        OperationalSpaceController::new(&model, &file.task_set(), &context).unwrap_or_else(|e| panic!("{e}"));
    if !above.is_empty() {
        controller.always_solve();
    }
    let start = numbers.vector(n, 1.5);
    let (data, mut measurement) = at_state(&model, &start, &vec![0.0; n], 0.0);
    let hand = model.frame_id("hand").expect("hand");
    let home = frame_placement(&model, &data, hand);
    let mut force = DVector::zeros(axes.len());
    force.iter_mut().for_each(|f| *f = 10.0 * numbers.next());
    // The wrench, transformed to the sensor at the wrist.
    let q: Vec<f64> = start.iter().map(|q| q + 0.1 * numbers.next()).collect();
    let (now, mut later) = at_state(&model, &q, &numbers.vector(n, speed), 0.3);
    let mut wrench = Vector6::zeros();
    axes.iter().zip(force.iter()).for_each(|(&axis, &f)| wrench[axis] = f);
    let (linear, moment) = (wrench.fixed_rows::<3>(0).into_owned(), wrench.fixed_rows::<3>(3).into_owned());
    let wrist = model.frame_id("wrist").expect("wrist");
    let lever =
        frame_placement(&model, &now, hand).translation - frame_placement(&model, &now, wrist).translation;
    let sensed = Force { linear, angular: moment + lever.cross(&linear) };
    // The filter is initialised with this wrench, so that it does not change it.
    measurement.wrenches[0] = sensed;
    later.wrenches[0] = sensed;
    controller.start(&common::input(&model, &data, &measurement));

    let pose = frame_placement(&model, &now, hand);
    let turn = Rotation3::from_matrix_unchecked(pose.rotation * home.rotation.transpose()).scaled_axis();
    let line = pose.translation - home.translation;
    let off = Vector6::new(line.x, line.y, line.z, turn.x, turn.y, turn.z);
    let rows = |v: Vector6<f64>| DVector::from_fn(axes.len(), |r, _| v[axes[r]]);
    let all = jacobian(&model, &now, "hand");
    Held {
        axes,
        away: off,
        off: rows(off),
        velocity: rows(six(&frame_velocity(&model, &now, hand))),
        bias: rows(six(&frame_bias_acceleration(&model, &now, hand))),
        jacobian: DMatrix::from_fn(axes.len(), n, |r, c| all[(axes[r], c)]),
        data: now,
        measurement: later,
        controller,
        force,
        also: None,
        model,
    }
}

impl Held {
    /// Λ, computed by matrix inverses.
    fn inertia(&self) -> DMatrix<f64> {
        let inverse = self.data.mass_matrix.clone().try_inverse().expect("regular");
        (&self.jacobian * inverse * self.jacobian.transpose()).try_inverse().expect("regular")
    }

    /// Returns the acceleration of the axes under the controller's torques and the force; `None` near singular poses.
    fn acceleration(&mut self) -> Option<DVector<f64>> {
        let mut tau = vec![0.0; self.model.n()];
        self.controller.update(&common::input(&self.model, &self.data, &self.measurement), &mut tau);
        let hand = self.model.frame_id("hand").expect("hand");
        let mut wrench = Vector6::zeros();
        self.axes.iter().zip(self.force.iter()).for_each(|(&axis, &f)| wrench[axis] = f);
        if let Some((axis, f)) = self.also {
            wrench[axis] = f;
        }
        let force = Force {
            linear: wrench.fixed_rows::<3>(0).into_owned(),
            angular: wrench.fixed_rows::<3>(3).into_owned(),
        };
        let mut data = self.data.clone();
        aba_external(&self.model, &mut data, &tau, &[(hand, force)]);
        let regular = sampled(&self.controller, "hand.min_singular_gain") == [1.0];
        regular.then(|| &self.jacobian * &data.ddq + &self.bias)
    }
}

const LINEAR: &[usize] = &[0, 1, 2];
const SOME: &[usize] = &[0, 2];
const ALL: &[usize] = &[0, 1, 2, 3, 4, 5];

const SPRINGS: &str =
    "stiffness_n_per_m = [300.0, 500.0, 800.0], stiffness_nm_per_rad = [0, 0, 0, 20.0, 30.0, 40.0]";

fn springs(axes: &[usize]) -> DMatrix<f64> {
    let all = [300.0, 500.0, 800.0, 20.0, 30.0, 40.0];
    DMatrix::from_fn(axes.len(), axes.len(), |r, c| if r == c { all[axes[r]] } else { 0.0 })
}

/// Compared: Λ ẍ + D ẋ + K (x − x_d) with the force. D is computed like in
/// [`designed_damping_is_square_root_of_stiffness`], from Λ by matrix inverses, or is given.
#[test]
fn hand_responds_as_spring_and_damper() {
    let mut numbers = Numbers::new(33);
    let mut seen = 0;
    for case in 0..90 {
        let axes = [LINEAR, SOME, ALL][case % 3];
        let given = case % 2 == 0;
        let damping = if given {
            "damping_ns_per_m = [30.0, 40.0, 50.0], damping_nms_per_rad = [0, 0, 0, 2.0, 3.0, 4.0]"
        } else {
            "damping_ratio = 0.4"
        };
        let keys = format!("impedance = {{ {SPRINGS}, {damping} }}");
        let mut held = held(&mut numbers, axes, &keys, 1.0);
        let Some(acceleration) = held.acceleration() else { continue };
        seen += 1;
        let (inertia, stiffness) = (held.inertia(), springs(axes));
        let damping = if given {
            let all = [30.0, 40.0, 50.0, 2.0, 3.0, 4.0];
            DMatrix::from_fn(axes.len(), axes.len(), |r, c| if r == c { all[axes[r]] } else { 0.0 })
        } else {
            let lower = inertia.clone().cholesky().expect("positive definite").l();
            let left = lower.solve_lower_triangular(&stiffness).expect("regular");
            let whitened =
                lower.solve_lower_triangular(&left.transpose()).expect("regular").symmetric_eigen();
            let modes = &lower * &whitened.eigenvectors;
            &modes * DMatrix::from_diagonal(&whitened.eigenvalues.map(|k| 0.8 * k.sqrt())) * modes.transpose()
        };
        let parts = [inertia * acceleration, damping * &held.velocity, stiffness * &held.off];
        let size = parts.iter().map(DVector::amax).fold(1.0, f64::max);
        let off = (parts.iter().sum::<DVector<f64>>() - &held.force).amax() / size;
        assert!(off < ROUNDING, "case {case}: {off} of {size} N is missing");
    }
    assert!(seen > 50, "{seen} states were regular");
}

/// A hand at rest, displaced such that its springs balance a force, stays at rest; without the force it does not.
#[test]
fn pushed_hand_rests_at_spring_equilibrium() {
    let mut numbers = Numbers::new(34);
    let mut seen = 0;
    for case in 0..60 {
        let axes = [LINEAR, SOME, ALL][case % 3];
        let mut held = held(&mut numbers, axes, &format!("impedance = {{ {SPRINGS} }}"), 0.0);
        held.force = springs(axes) * &held.off;
        let Some(acceleration) = held.acceleration() else { continue };
        seen += 1;
        held.force.fill(0.0);
        let free = held.acceleration().expect("as regular as before").amax();
        let off = acceleration.amax();
        assert!(off < ROUNDING * free.max(1.0) && free > 0.1, "case {case}: {off} m/s² of {free}");
    }
    assert!(seen > 30, "{seen} states were regular");
}

/// Compared, below a task that holds another axis of the hand: Λ ẍ + D ẋ + K (x − x_d), or this with a desired inertia,
/// with the force. A further force along the axis above is balanced by its task, by an acceleration that does not take
/// place; the springs do not feel it. The QPs are solved without an active limit.
#[test]
fn springs_below_a_task_respond_as_springs() {
    const OMEGA: f64 = 9.0;
    let mut numbers = Numbers::new(37);
    let (mut seen, mut coupled) = (0, 0);
    for case in 0..120 {
        let (above, axes): (usize, &'static [usize]) =
            [(2, &[0, 1][..]), (0, &[1, 2]), (1, &[0]), (1, &[0, 2])][case % 4];
        let shaped = case % 3 == 0;
        let task = format!(
            "[task.above.cartesian]\nframe = \"hand\"\naxes = {{ {} = \"motion\" }}\nreference = \"hold\"\n\
             gains = {{ frequency_rad_per_s = {OMEGA:e}, damping_ratio = 1.0 }}\nsingularity_threshold = 1e-3",
            AXIS_NAMES[above]
        );
        let inertia = if shaped { ", inertia_kg = 3.0 }\nforce = { sensor = \"wrist\" }" } else { " }" };
        let keys = format!("impedance = {{ {SPRINGS}, damping_ns_per_m = 35.0{inertia}");
        let mut held = held_below(&task, &mut numbers, axes, &keys, 1.0);
        let jacobian = jacobian(&held.model, &held.data, "hand");
        let inverse = held.data.mass_matrix.clone().try_inverse().expect("regular");
        let mobility = &jacobian * inverse * jacobian.transpose();
        // The task above demands what its axis's velocity does not change.
        let speed = jacobian.row(above).transpose().dot(&held.data.dq);
        let demand = -OMEGA * OMEGA * held.away[above] - 2.0 * OMEGA * speed;
        let caused: f64 =
            axes.iter().zip(held.force.iter()).map(|(&axis, f)| mobility[(above, axis)] * f).sum();
        held.also = Some((above, -(demand + caused) / mobility[(above, above)]));
        let Some(acceleration) = held.acceleration() else { continue };
        if sampled(&held.controller, "above.min_singular_gain") != [1.0] {
            continue;
        }
        seen += 1;
        // Λ of the axes without the motion of the axis above.
        let inertia = if shaped {
            DMatrix::from_diagonal_element(axes.len(), axes.len(), 3.0)
        } else {
            let left = |r: usize, c: usize| {
                let (r, c) = (axes[r], axes[c]);
                mobility[(r, c)] - mobility[(r, above)] * mobility[(above, c)] / mobility[(above, above)]
            };
            DMatrix::from_fn(axes.len(), axes.len(), left).try_inverse().expect("regular")
        };
        let parts = [inertia * acceleration, 35.0 * &held.velocity, springs(axes) * &held.off];
        let size = parts.iter().map(DVector::amax).fold(1.0, f64::max);
        let off = (parts.iter().sum::<DVector<f64>>() - &held.force).amax() / size;
        assert!(off < ROUNDING, "case {case}: {off} of {size} N is missing");
        let first = axes[0];
        coupled += usize::from(mobility[(first, above)].abs() > 0.1 * mobility[(first, first)]);
    }
    assert!(seen > 60 && 2 * coupled > seen, "{coupled} of {seen} axes were coupled");
}

/// Compared: m ẍ + d ẋ + k (x − x_d) with the force, which is sensed at another point of the hand. The response is
/// independent of the arm's own inertia, which would cause a different one.
#[test]
fn shaped_inertia_determines_response_to_force() {
    let mut numbers = Numbers::new(35);
    let (mut seen, mut shaped) = (0, 0);
    for case in 0..90 {
        let axes = [LINEAR, SOME, ALL][case % 3];
        let given = case % 2 == 0;
        let damping =
            if given { "damping_ns_per_m = 35.0, damping_nms_per_rad = 2.5" } else { "damping_ratio = 0.6" };
        let keys = format!(
            "impedance = {{ {SPRINGS}, {damping}, inertia_kg = 3.0, inertia_kg_m2 = 0.2 }}\nforce = {{ sensor = \"wrist\" }}"
        );
        let mut held = held(&mut numbers, axes, &keys, 1.0);
        let Some(acceleration) = held.acceleration() else { continue };
        seen += 1;
        let stiffness = springs(axes);
        let mut apart = 0.0_f64;
        for (row, &axis) in axes.iter().enumerate() {
            let (inertia, k) = (if axis < 3 { 3.0 } else { 0.2 }, stiffness[(row, row)]);
            let damping = match (given, axis < 3) {
                (true, true) => 35.0,
                (true, false) => 2.5,
                (false, _) => 2.0 * 0.6 * (k * inertia).sqrt(),
            };
            let parts = [inertia * acceleration[row], damping * held.velocity[row], k * held.off[row]];
            let size = parts.iter().fold(1.0_f64, |size, part| size.max(part.abs()));
            let off = (parts.iter().sum::<f64>() - held.force[row]).abs() / size;
            assert!(off < ROUNDING, "case {case}, axis {axis}: {off} of {size} is missing");
            apart = apart.max((held.inertia()[(row, row)] - inertia).abs() / inertia);
        }
        shaped += usize::from(apart > 0.1);
    }
    assert!(seen > 50 && 2 * shaped > seen, "{shaped} of {seen} inertias were others");
}

/// Compared: torques with a floor below every joint's inertia with those of full decoupling; and, with a floor above
/// some of the inertias, the task force with (J (M + added inertia)⁻¹ Jᵀ)⁻¹ (a* − J̇ q̇), computed here.
#[test]
fn bounded_decoupling_raises_light_joint_inertias() {
    let mut numbers = Numbers::new(36);
    let (mut seen, mut bounded) = (0, 0);
    for case in 0..60 {
        let n = 6 + numbers.below(4);
        let model = any_arm(n, &mut numbers);
        let start = numbers.vector(n, 1.5);
        let q: Vec<f64> = start.iter().map(|q| q + 0.1 * numbers.next()).collect();
        let dq = numbers.vector(n, 1.0);
        let run = |decoupling: &str| {
            let file = File::read(&format!(
                "priority = [\"hand\", \"rest\"]\n\
                 [task.hand.cartesian]\nframe = \"hand\"\naxes = {{ x = \"motion\", y = \"motion\", z = \"motion\" }}\nreference = \"hold\"\n\
                 gains = {{ frequency_rad_per_s = 9.0, damping_ratio = 0.7 }}\n{decoupling}\n\
                 [task.rest.joint-damping]\ndamping_nms_per_rad = 1.0\n"
            ));
            let mut controller =
                OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand"))
                    .expect("a good stack");
            let (data, measurement) = at_state(&model, &start, &vec![0.0; n], 0.0);
            controller.start(&common::input(&model, &data, &measurement));
            let (data, measurement) = at_state(&model, &q, &dq, 0.4);
            let mut tau = vec![0.0; n];
            controller.update(&common::input(&model, &data, &measurement), &mut tau);
            (DVector::from_vec(tau), data, controller)
        };
        let (full, data, controller) = run("");
        if sampled(&controller, "hand.min_singular_gain") != [1.0] {
            continue;
        }
        seen += 1;
        let lightest = data.mass_matrix.diagonal().min();
        let bound = |floor: f64| format!("decoupling.bounded = {{ inertia_floor_kg_m2 = {floor:e} }}");
        let (below, ..) = run(&bound(0.999 * lightest));
        let off = (&below - &full).amax() / full.amax().max(1.0);
        assert!(off < ROUNDING, "case {case}: off by {off} of {full}");

        let floor = 5.0 * lightest;
        let (_, _, controller) = run(&bound(floor));
        let mut heavier = data.mass_matrix.clone();
        (0..n).for_each(|i| heavier[(i, i)] = heavier[(i, i)].max(floor));
        let j = jacobian(&model, &data, "hand").rows(0, 3).into_owned();
        let inverse = heavier.try_inverse().expect("regular");
        let inertia = (&j * inverse * j.transpose()).try_inverse().expect("regular");
        let hand = model.frame_id("hand").expect("hand");
        let (then, _) = at_state(&model, &start, &vec![0.0; n], 0.0);
        let off = frame_placement(&model, &then, hand).translation
            - frame_placement(&model, &data, hand).translation;
        let wanted = off * 81.0
            - frame_velocity(&model, &data, hand).linear * (1.4 * 9.0)
            - frame_bias_acceleration(&model, &data, hand).linear;
        let expected = inertia * wanted;
        let force = sampled(&controller, "hand.force");
        let off =
            (0..3).map(|i| (force[i] - expected[i]).abs()).fold(0.0, f64::max) / expected.amax().max(1.0);
        if sampled(&controller, "hand.min_singular_gain") == [1.0] && off > ROUNDING {
            panic!("case {case}: a force of {force:?} for {expected}");
        }
        let plain = &sampled(&run("").2, "hand.force")[..3];
        bounded += usize::from((0..3).any(|i| (plain[i] - expected[i]).abs() > 1e-3 * expected.amax()));
    }
    assert!(seen > 30 && 2 * bounded > seen, "{bounded} of {seen} arms had a light joint");
}

fn integrating(integral: &str) -> String {
    format!(
        "priority = [\"hand\", \"rest\"]\n\
         [task.hand.cartesian]\nframe = \"hand\"\naxes = {{ x = \"motion\", y = \"motion\", z = \"motion\" }}\nreference = \"hold\"\n\
         gains = {{ frequency_rad_per_s = 20.0, damping_ratio = 1.0{integral} }}\n\
         [task.rest.joint-posture]\nfrequency_rad_per_s = 4.0\ndamping_ratio = 1.0\n"
    )
}

/// Compared: the hand's acceleration in a constant state, cycle by cycle, with ω² times the sum of the error and its
/// bounded integral.
#[test]
fn integral_accumulates_error_up_to_its_limit() {
    let model = four_joints();
    let (per_s, limit, omega) = (3.0, 1e-3, 20.0);
    let text = integrating(&format!(", integral_per_s = {per_s:e}, integral_limit_m = {limit:e}"));
    let file = File::read(&text);
    let mut controller =
        OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand"))
            .expect("a good stack");
    let (data, measurement) = at_state(&model, &Q0, &[0.0; 4], 0.0);
    controller.start(&common::input(&model, &data, &measurement));
    let hand = model.frame_id("hand").expect("hand");
    let home = frame_placement(&model, &data, hand).translation;
    let (data, measurement) = at_state(&model, &[-0.42, -0.37, 0.2, -1.3], &[0.0; 4], 0.1);
    let error = home - frame_placement(&model, &data, hand).translation;
    for tick in 1..=50 {
        let mut tau = [0.0; 4];
        controller.update(&common::input(&model, &data, &measurement), &mut tau);
        let moved = jacobian(&model, &data, "hand").rows(0, 3) * accelerations(&model, &data, &tau);
        let sum = error.map(|e| (f64::from(tick) * 1e-3 * per_s * e).clamp(-limit, limit));
        let wanted = (error + sum) * (omega * omega);
        let off = (&moved - DVector::from_column_slice(wanted.as_slice())).amax();
        assert!(off < ROUNDING * wanted.amax().max(1.0), "tick {tick}: {moved} for {wanted}");
    }
    assert!(error.amax() * per_s * 0.05 > limit, "the limit is reached");
}

/// Returns the hand's error (m) after three seconds with unknown joint torques.
fn remaining_error(integral: &str) -> f64 {
    const UNKNOWN_NM: [f64; 4] = [1.2, -0.8, 0.5, 0.9];
    let model = four_joints();
    let file = File::read(&integrating(integral));
    let mut controller =
        OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand"))
            .expect("a good stack");
    let (mut data, mut measurement) = at_state(&model, &Q0, &[0.0; 4], 0.0);
    controller.start(&common::input(&model, &data, &measurement));
    let mut tau = [0.0; 4];
    for _ in 0..3000 {
        controller.update(&common::input(&model, &data, &measurement), &mut tau);
        let disturbed: Vec<f64> = tau.iter().zip(UNKNOWN_NM).map(|(tau, unknown)| tau + unknown).collect();
        let ddq = accelerations(&model, &data, &disturbed);
        step(&model, &mut data, &mut measurement, &ddq, 1e-3);
    }
    let error = sampled(&controller, "hand.error");
    Vector3::new(error[0], error[1], error[2]).norm()
}

/// Compared: the remaining error with an integral, without one, and with an integral whose bound is too small: the
/// bound is the difference.
#[test]
fn integral_removes_constant_disturbance() {
    let without = remaining_error("");
    let with = remaining_error(", integral_per_s = 4.0");
    let tight = remaining_error(", integral_per_s = 4.0, integral_limit_m = 0.001");
    // About ten time constants of a quarter of a second.
    assert!(without > 4e-3 && with < 1e-3 * without, "{with} m of {without} m are left");
    // The bound applies to each axis.
    assert!(
        tight < without - 0.9e-3 && tight > without - 1.1e-3 * 3.0_f64.sqrt(),
        "{tight} m of {without} m"
    );
}

/// Compared: the hand's acceleration with 2ζω (ν ẋ* − v), along and about the axes, with ẋ* computed from the error.
/// The desired velocity, not the acceleration, has the size of the limit and the direction of the error.
#[test]
fn desired_speed_is_bounded_and_keeps_direction() {
    let mut numbers = Numbers::new(37);
    let (mut seen, mut bounded) = (0, [0; 2]);
    let (omega, zeta, limits) = (8.0, 0.8, [0.15, 0.4]);
    for case in 0..120 {
        let n = 7 + numbers.below(3);
        let model = any_arm(n, &mut numbers);
        let file = File::read(&format!(
            "priority = [\"hand\", \"rest\"]\nlimits.enforce = false\n\
             [task.hand.cartesian]\nframe = \"hand\"\nreference = \"hold\"\n\
             axes = {{ x = \"motion\", y = \"motion\", z = \"motion\", rx = \"motion\", ry = \"motion\", rz = \"motion\" }}\n\
             gains = {{ frequency_rad_per_s = {omega:e}, damping_ratio = {zeta:e} }}\n\
             singularity_threshold = 1e-5\nspeed_limit_m_per_s = {:e}\nspeed_limit_rad_per_s = {:e}\n\
             [task.rest.joint-damping]\ndamping_nms_per_rad = 1.0\n",
            limits[0], limits[1]
        ));
        let mut controller =
            OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand"))
                .expect("a good stack");
        let hand = model.frame_id("hand").expect("hand");
        let start = numbers.vector(n, 1.5);
        let (data, measurement) = at_state(&model, &start, &vec![0.0; n], 0.0);
        controller.start(&common::input(&model, &data, &measurement));
        let home = frame_placement(&model, &data, hand);
        let way = numbers.between(0.01, 0.1);
        let q: Vec<f64> = start.iter().map(|q| q + way * numbers.next()).collect();
        let (data, measurement) = at_state(&model, &q, &numbers.vector(n, 0.5), 0.4);
        let mut tau = vec![0.0; n];
        controller.update(&common::input(&model, &data, &measurement), &mut tau);
        if sampled(&controller, "hand.min_singular_gain") != [1.0] {
            continue;
        }
        seen += 1;
        let pose = frame_placement(&model, &data, hand);
        let turn = Rotation3::from_matrix_unchecked(home.rotation * pose.rotation.transpose()).scaled_axis();
        let velocity = frame_velocity(&model, &data, hand);
        let moved = common::frame_acceleration(&model, &data, "hand", &tau);
        for (kind, (error, velocity)) in
            [(home.translation - pose.translation, velocity.linear), (turn, velocity.angular)]
                .into_iter()
                .enumerate()
        {
            let asked = error * (omega / (2.0 * zeta));
            bounded[kind] += usize::from(asked.norm() > limits[kind]);
            let allowed = asked * (limits[kind] / asked.norm()).min(1.0);
            let wanted = (allowed - velocity) * (2.0 * zeta * omega);
            let off = (moved.fixed_rows::<3>(3 * kind) - wanted).amax() / moved.amax().max(1.0);
            assert!(off < ROUNDING, "case {case}, kind {kind}: off by {off}");
        }
    }
    for bounded in bounded {
        assert!(seen > 60 && bounded > 15 && bounded < seen - 5, "{bounded} of {seen} were bounded");
    }
}

/// A simulated hand with a distant goal accelerates to its speed limit, not beyond it, on a straight line to the goal.
#[test]
fn distant_goal_is_approached_straight_within_speed_limit() {
    let model = four_joints();
    let limit = 0.2;
    let text = integrating("")
        .replace("reference = \"hold\"", "reference.point-to-point = { position = { offset_m = [0.12, 0.08, 0.15] }, duration_s = 1e-3 }\nspeed_limit_m_per_s = 0.2");
    let file = File::read(&text);
    let mut controller =
        OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand"))
            .expect("a good stack");
    let (mut data, mut measurement) = at_state(&model, &Q0, &[0.0; 4], 0.0);
    controller.start(&common::input(&model, &data, &measurement));
    let hand = model.frame_id("hand").expect("hand");
    let home = frame_placement(&model, &data, hand).translation;
    let line = Vector3::new(0.12, 0.08, 0.15).normalize();
    let (mut fastest, mut aside) = (0.0_f64, 0.0_f64);
    let mut tau = [0.0; 4];
    for _ in 0..2500 {
        controller.update(&common::input(&model, &data, &measurement), &mut tau);
        let ddq = accelerations(&model, &data, &tau);
        step(&model, &mut data, &mut measurement, &ddq, 1e-3);
        fastest = fastest.max(frame_velocity(&model, &data, hand).linear.norm());
        aside = aside.max((frame_placement(&model, &data, hand).translation - home).cross(&line).norm());
    }
    let left = sampled(&controller, "hand.error")[..3].iter().map(|e| e * e).sum::<f64>().sqrt();
    // Error of Euler's method per period: the period times the acceleration (4 m/s²), relative to the speed.
    assert!(fastest > 0.99 * limit && fastest < 1.01 * limit, "{fastest} m/s");
    assert!(aside < 1e-3 && left < 1e-4, "{aside} m off the line, {left} m left");
}

//! Controlled frames. Compared: velocities, accelerations and Jacobians with differences of poses along random motions
//! and with the model's own functions. Also task axes that rotate with the robot.

use crate::common::{self, File, Numbers, accelerations, any_arm, at_state, control_context, sampled, six};
use nalgebra::{DVector, Matrix3, Matrix3xX, Matrix6xX, Rotation3, Vector6};
use opspace_control::{AXIS_NAMES, ControlledFrame, Controller, OperationalSpaceController};
use opspace_model::{
    Data, Model, centroidal_map, centroidal_momentum, com_jacobian, frame_bias_acceleration, frame_placement,
    frame_velocity, relative_jacobian,
};

/// Tolerance of two formulas for the same quantity, relative to its size, at least 1.
const ROUNDING: f64 = 1e-11;

/// Step of central differences, s.
const STEP_S: f64 = 1e-4;

/// Tolerance of central differences, relative to the square of the joint velocities and similar terms (here up to 10):
/// the error of a step of 1e-4 s with a third derivative of some 1e2 per s³, and rounding.
const DIFFERENCE: f64 = 1e-5;

/// A moving arm with constant joint accelerations.
struct Motion {
    model: Model,
    q: DVector<f64>,
    dq: DVector<f64>,
    ddq: DVector<f64>,
}

impl Motion {
    fn random(numbers: &mut Numbers) -> Self {
        let n = 4 + numbers.below(6);
        let [q, dq, ddq] = [1.5, 1.0, 2.0].map(|size| DVector::from_vec(numbers.vector(n, size)));
        Self { model: any_arm(n, numbers), q, dq, ddq }
    }

    fn at(&self, time_s: f64) -> Data {
        let q = &self.q + &self.dq * time_s + &self.ddq * (0.5 * time_s * time_s);
        let dq = &self.dq + &self.ddq * time_s;
        at_state(&self.model, q.as_slice(), dq.as_slice(), 0.0).0
    }

    /// Returns the time derivative of a quantity, by central differences.
    fn rate<const N: usize>(
        &self,
        of: impl Fn(&Data) -> nalgebra::SVector<f64, N>,
    ) -> nalgebra::SVector<f64, N> {
        (of(&self.at(STEP_S)) - of(&self.at(-STEP_S))) / (2.0 * STEP_S)
    }
}

fn controlled_frames(model: &Model) -> [ControlledFrame; 6] {
    let id = |name: &str| model.frame_id(name).expect("frame");
    [
        ControlledFrame::Frame(id("hand")),
        ControlledFrame::Relative { frame: id("hand"), from: id("mid") },
        ControlledFrame::Relative { frame: id("mid"), from: id("hand") },
        ControlledFrame::Relative { frame: id("wrist"), from: id("base") },
        ControlledFrame::Relative { frame: id("j1"), from: id("wrist") },
        ControlledFrame::CenterOfMass,
    ]
}

/// Jacobian of a controlled frame.
fn jacobian(subject: ControlledFrame, model: &Model, data: &Data) -> Matrix6xX<f64> {
    let mut rows = Matrix6xX::zeros(model.n());
    subject.jacobian(model, data, &mut rows);
    rows
}

fn far<D: nalgebra::Dim, S1, S2>(
    a: &nalgebra::Matrix<f64, D, nalgebra::U1, S1>,
    b: &nalgebra::Matrix<f64, D, nalgebra::U1, S2>,
) -> f64
where
    S1: nalgebra::RawStorage<f64, D, nalgebra::U1>,
    S2: nalgebra::RawStorage<f64, D, nalgebra::U1>,
{
    let size = b.iter().fold(1.0_f64, |size, x| size.max(x.abs()));
    a.iter().zip(b.iter()).fold(0.0_f64, |off, (a, b)| off.max((a - b).abs())) / size
}

/// Compared: velocity with differences of poses, J q̇ with velocity, and J q̈ + J̇ q̇ with differences of velocities;
/// for plain frames too, which validates the comparison.
#[test]
fn velocities_and_accelerations_match_differences() {
    let mut numbers = Numbers::new(21);
    for case in 0..60 {
        let motion = Motion::random(&mut numbers);
        let (model, data) = (&motion.model, motion.at(0.0));
        for subject in controlled_frames(model) {
            let velocity = six(&subject.velocity(model, &data));
            let place = |time_s: f64| subject.placement(model, &motion.at(time_s));
            let linear = motion.rate(|data| subject.placement(model, data).translation);
            let turn = place(STEP_S).rotation * place(-STEP_S).rotation.transpose();
            let angular = Rotation3::from_matrix_unchecked(turn).scaled_axis() / (2.0 * STEP_S);
            let differences = Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z);
            let off = far(&velocity, &differences);
            assert!(off < DIFFERENCE, "case {case}, {subject:?}: velocity off by {off}");

            let rows = jacobian(subject, model, &data);
            let off = far(&(&rows * &data.dq), &velocity);
            assert!(off < ROUNDING, "case {case}, {subject:?}: J q̇ off by {off}");

            let acceleration = &rows * &motion.ddq + six(&subject.bias_acceleration(model, &data));
            let differences = motion.rate(|data| six(&subject.velocity(model, data)));
            let off = far(&acceleration, &differences);
            assert!(off < DIFFERENCE, "case {case}, {subject:?}: acceleration off by {off}");
        }
    }
}

/// Compared: a frame relative to another one with the product of the placements and with the model's relative Jacobian;
/// relative to the base with the rotated frame in the world; relative to itself with zero.
#[test]
fn relative_frame_matches_model() {
    let mut numbers = Numbers::new(22);
    for case in 0..60 {
        let motion = Motion::random(&mut numbers);
        let (model, data) = (&motion.model, motion.at(0.0));
        let [hand, mid, base] = ["hand", "mid", "base"].map(|name| model.frame_id(name).expect("frame"));
        let place = |frame| frame_placement(model, &data, frame);

        let subject = ControlledFrame::Relative { frame: hand, from: mid };
        let (seen, expected) = (subject.placement(model, &data), place(mid).inverse() * place(hand));
        let off =
            (seen.rotation - expected.rotation).amax().max(far(&seen.translation, &expected.translation));
        assert!(off < ROUNDING, "case {case}: pose off by {off}");
        let mut rows = Matrix6xX::zeros(model.n());
        relative_jacobian(model, &data, mid, hand, &mut rows);
        let off = far(&(rows * &data.dq), &six(&subject.velocity(model, &data)));
        assert!(off < ROUNDING, "case {case}: velocity off by {off}");
        assert_eq!(subject.coordinates(model, &data), place(mid).rotation);
        assert_eq!(subject.point(model, &data), place(hand).translation);

        let subject = ControlledFrame::Relative { frame: hand, from: base };
        let turned = place(base).rotation.transpose();
        for (seen, world) in [
            (subject.velocity(model, &data), frame_velocity(model, &data, hand)),
            (subject.bias_acceleration(model, &data), frame_bias_acceleration(model, &data, hand)),
        ] {
            let off = far(&seen.linear, &(turned * world.linear))
                .max(far(&seen.angular, &(turned * world.angular)));
            assert!(off < ROUNDING, "case {case}: off by {off} from what the still base sees");
        }

        let subject = ControlledFrame::Relative { frame: hand, from: hand };
        let nothing = Vector6::zeros();
        assert!(far(&six(&subject.velocity(model, &data)), &nothing) < ROUNDING, "case {case}");
        assert!(far(&six(&subject.bias_acceleration(model, &data)), &nothing) < ROUNDING, "case {case}");
        assert!(jacobian(subject, model, &data).amax() < ROUNDING, "case {case}");
    }
}

/// Compared: the motion of the centre of mass with the momentum of the whole arm, and its Jacobian with the model's
/// two.
#[test]
fn com_motion_matches_momentum() {
    let mut numbers = Numbers::new(23);
    for case in 0..60 {
        let motion = Motion::random(&mut numbers);
        let (model, mut data) = (&motion.model, motion.at(0.0));
        let (subject, mass) = (ControlledFrame::CenterOfMass, model.total_mass());
        let velocity = subject.velocity(model, &data);
        let momentum = centroidal_momentum(model, &data);
        assert!(far(&(velocity.linear * mass), &momentum.linear) < ROUNDING, "case {case}");
        assert!(velocity.angular.norm() == 0.0 && !subject.turns());

        let rows = jacobian(subject, model, &data);
        let mut expected = Matrix3xX::zeros(model.n());
        com_jacobian(model, &mut data, &mut expected);
        centroidal_map(model, &mut data);
        let off = (rows.rows(0, 3) - &expected).amax();
        assert!(off < ROUNDING, "case {case}: J off by {off} from com_jacobian");
        let off = (rows.rows(0, 3) * mass - data.centroidal_map.rows(0, 3)).amax();
        assert!(off < ROUNDING * mass.max(1.0), "case {case}: J off by {off} from the centroidal map");
        assert!(rows.rows(3, 3).amax() == 0.0);
    }
}

/// Compared: the acceleration of a task whose axes rotate with the robot, along the axes at that instant, from
/// differences of velocities under forward dynamics, with a* computed from pose and velocity. The axes rotate, so that
/// the time derivative of the velocity components in them is different.
#[test]
fn rotating_axes_are_used_at_current_orientation() {
    let mut numbers = Numbers::new(24);
    let (mut seen, mut turning) = (0, 0);
    for case in 0..400 {
        let n = 6 + numbers.below(4);
        let model = any_arm(n, &mut numbers);
        let relative = numbers.below(2) == 1;
        let (axes_frame, of) = [
            ("\"task-frame\"", "hand"),
            ("{ frame = \"j4\" }", "j4"),
            ("{ frame = \"j2\" }", "j2"),
            ("\"base\"", "base"),
        ][numbers.below(4)];
        let from = if relative { "relative_to = \"j1\"\n" } else { "" };
        let axes = [&[0, 1, 2][..], &[2, 3, 4, 5]][numbers.below(2)];
        let in_motion: Vec<String> =
            axes.iter().map(|&a: &usize| format!("{} = \"motion\"", AXIS_NAMES[a])).collect();
        let in_motion = in_motion.join(", ");
        let text = format!(
            "priority = [\"hand\", \"rest\"]\nlimits.enforce = false\n\
             [task.hand.cartesian]\nframe = \"hand\"\n{from}axes = {{ {in_motion} }}\naxes_frame = {axes_frame}\nreference = \"hold\"\n\
             gains = {{ frequency_rad_per_s = [6.0, 7.0, 8.0, 9.0, 9.0, 9.0], damping_ratio = 0.7 }}\nsingularity_threshold = 1e-3\n\
             [task.rest.joint-damping]\ndamping_nms_per_rad = 1.0\n"
        );
        let file = File::read(&text);
        let Ok(mut controller) =
            OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand"))
        else {
            continue;
        };
        let start = numbers.vector(n, 1.5);
        let (data, measurement) = at_state(&model, &start, &vec![0.0; n], 0.0);
        controller.start(&common::input(&model, &data, &measurement));
        let subject = controlled_frame(&model, relative);
        let home = subject.placement(&model, &data);
        let q: Vec<f64> = start.iter().map(|q| q + 0.15 * numbers.next()).collect();
        let (data, measurement) = at_state(&model, &q, &numbers.vector(n, 1.0), 0.4);
        let mut tau = vec![0.0; n];
        controller.update(&common::input(&model, &data, &measurement), &mut tau);
        if sampled(&controller, "hand.min_singular_gain") != [1.0] {
            continue;
        }
        seen += 1;

        // The current axes in the coordinates of the controlled frame.
        let now = axes_of(&model, &data, subject, of);
        let pose = subject.placement(&model, &data);
        let velocity = six(&subject.velocity(&model, &data));
        let in_axes = |axes: &Matrix3<f64>, v: &Vector6<f64>| -> Vector6<f64> {
            let (v, w) = (axes.tr_mul(&v.fixed_rows::<3>(0)), axes.tr_mul(&v.fixed_rows::<3>(3)));
            Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
        };
        let line = home.translation - pose.translation;
        let turn = Rotation3::from_matrix_unchecked(home.rotation * pose.rotation.transpose()).scaled_axis();
        let error = in_axes(&now, &Vector6::new(line.x, line.y, line.z, turn.x, turn.y, turn.z));
        let speed = in_axes(&now, &velocity);
        let omega = [6.0, 7.0, 8.0, 9.0, 9.0, 9.0];

        let ddq = accelerations(&model, &data, &tau);
        let motion = Motion { q: measurement.q.clone(), dq: measurement.dq.clone(), ddq, model };
        let model = &motion.model;
        let along = motion.rate(|data| in_axes(&now, &six(&subject.velocity(model, data))));
        let in_turning = motion
            .rate(|data| in_axes(&axes_of(model, data, subject, of), &six(&subject.velocity(model, data))));
        let size = along.amax().max(motion.ddq.amax()).max(1.0);
        let mut apart = 0.0_f64;
        for &axis in axes {
            let wanted = omega[axis] * omega[axis] * error[axis] - 1.4 * omega[axis] * speed[axis];
            let off = (along[axis] - wanted).abs() / size;
            assert!(off < DIFFERENCE, "case {case}, axis {axis}: {} for {wanted}\n{text}", along[axis]);
            apart = apart.max((in_turning[axis] - wanted).abs() / size);
        }
        turning += usize::from(apart > 1e2 * DIFFERENCE);
    }
    assert!(seen > 100 && 2 * turning > seen, "{turning} of {seen} turned");
}

fn controlled_frame(model: &Model, relative: bool) -> ControlledFrame {
    let [hand, j1] = ["hand", "j1"].map(|name| model.frame_id(name).expect("frame"));
    if relative { ControlledFrame::Relative { frame: hand, from: j1 } } else { ControlledFrame::Frame(hand) }
}

/// Returns the axes of a frame in the coordinates of a controlled frame.
fn axes_of(model: &Model, data: &Data, subject: ControlledFrame, frame: &str) -> Matrix3<f64> {
    let rotation = frame_placement(model, data, model.frame_id(frame).expect("frame")).rotation;
    match subject {
        ControlledFrame::Relative { from, .. } => {
            frame_placement(model, data, from).rotation.transpose() * rotation
        }
        _ => rotation,
    }
}

//! Joint motion of an arm along the reference of a task, by an inverse kinematics of the tests.

use nalgebra::{DMatrix, DVector, Matrix3, Matrix6xX};
use opspace_control::{CartesianReference, Target, Trajectory, orientation};
use opspace_experiment::Experiment;
use opspace_model::{Data, frame_jacobian, frame_placement, kinematics};

/// Joint motion along a path, one entry per step.
pub struct JointMotion {
    pub q: Vec<DVector<f64>>,
    /// Velocities that the reference demands.
    pub dq: Vec<DVector<f64>>,
    pub duration_s: f64,
    /// Largest error of the position, m.
    pub farthest_m: f64,
    pub trajectory: Trajectory,
}

/// Follows a reference with the first `rows` rows of a frame (3 for a position, 6 for a pose), until it rests:
/// q̇ = J⁺ (ẋ + 20 e) + 2 (I − J⁺ J) (q_0 − q). `None` if the error exceeds `lost_m` (m).
pub fn follow(
    experiment: &Experiment,
    reference: &CartesianReference,
    (frame, rows): (&str, usize),
    step_s: f64,
    lost_m: f64,
) -> Option<JointMotion> {
    let model = &experiment.robot().model;
    let frame = model.frame_id(frame).expect("a frame");
    let mut data = Data::new(model);
    let start = DVector::from_iterator(
        model.n(),
        model.joints().iter().map(|joint| experiment.task().file.start_rad[&joint.name]),
    );
    let mut at_q = start.clone();
    let rest = vec![0.0; model.n()];
    kinematics(model, &mut data, at_q.as_slice(), &rest);
    let home = frame_placement(model, &data, frame);
    let mut trajectory = Trajectory::new(reference);
    trajectory.start(&home, &Target::at_rest(home), &Matrix3::identity());
    let end = trajectory.at(1e6);
    let (mut q, mut dq, mut farthest_m) = (Vec::new(), Vec::new(), 0.0_f64);
    let mut jacobian = Matrix6xX::zeros(model.n());
    loop {
        let duration_s = step_s * q.len() as f64;
        let target = trajectory.at(duration_s);
        if target == end {
            return Some(JointMotion { q, dq, duration_s, farthest_m, trajectory });
        }
        kinematics(model, &mut data, at_q.as_slice(), &rest);
        frame_jacobian(model, &data, frame, &mut jacobian);
        let controlled: DMatrix<f64> = jacobian.rows(0, rows).into_owned();
        let square = &controlled * controlled.transpose();
        let inverse = controlled.transpose() * square.try_inverse().expect("a posture that is not singular");
        let velocity = DVector::from_fn(rows, |i, _| {
            if i < 3 { target.velocity.linear[i] } else { target.velocity.angular[i - 3] }
        });
        let at = frame_placement(model, &data, frame);
        let away = target.placement.translation - at.translation;
        let turn = orientation::log(&(target.placement.rotation * at.rotation.transpose()));
        farthest_m = farthest_m.max(away.norm());
        if farthest_m > lost_m {
            return None;
        }
        let error = DVector::from_fn(rows, |i, _| if i < 3 { away[i] } else { turn[i - 3] });
        let demanded = &inverse * velocity;
        let pull = 2.0 * (&start - &at_q);
        let pull = &pull - &inverse * (&controlled * &pull);
        q.push(at_q.clone());
        at_q += step_s * (&demanded + &inverse * (20.0 * error) + pull);
        dq.push(demanded);
    }
}

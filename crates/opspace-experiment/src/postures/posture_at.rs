//! Search for a posture in which a task's target is reached: inverse kinematics within the joint ranges, from several starts.

use crate::files::toml_path::dotted;
use crate::postures::own_body::OwnBody;
use crate::run::rollout::error;
use nalgebra::{DVector, Matrix6, Matrix6xX, Vector6};
use opspace_backend::quantity::Positive;
use opspace_control::references::reference::Waypoint;
use opspace_control::{
    Axes, AxisGains, AxisMode, CartesianParameters, CartesianReference, CartesianTask, ControlContext,
    ControlError, ControlInput, Measurement, OrientationGoal, PositionGoal, Targets, Task, TaskInput,
    TaskTarget,
};
use opspace_model::{Data, JointKind, Model, kinematics};
use std::f64::consts::TAU;

/// Largest error at which a goal counts as reached, m; rotations are scaled to m.
pub const REACHED_M: f64 = 1e-3;

/// Distance of the posture from the ends of the joint ranges, rad (m).
const MARGIN: f64 = 0.02;

/// Postures of the search besides the given ones.
const SPREAD: usize = 18;

/// Search for postures of a robot.
pub struct PostureSearch<'a> {
    /// Kinematics of the robot.
    pub model: &'a Model,
    /// Lower and upper end of the range of each joint, rad or m (n).
    pub ranges: Vec<(f64, f64)>,
}

impl PostureSearch<'_> {
    /// Start postures of the search: those given, and postures distributed over the joint ranges. The last one given is the
    /// position of joints without a range.
    pub fn starts(&self, given: &[&[f64]]) -> Vec<Vec<f64>> {
        let mut starts: Vec<Vec<f64>> = given.iter().map(|start| start.to_vec()).collect();
        let fallback = given.last().map_or_else(|| vec![0.0; self.ranges.len()], |start| start.to_vec());
        starts.extend((0..SPREAD).map(|k| {
            let joints = self.ranges.iter().zip(&fallback).enumerate();
            joints
                .map(|(joint, (&(lower, upper), &fallback))| {
                    // Multiples of a power of the inverse golden ratio, modulo 1, fill the interval evenly; each joint
                    // has another power.
                    let share = (0.5 + 0.618_034_f64.powi(joint as i32 + 1) * k as f64).fract();
                    if (upper - lower).is_finite() { lower + share * (upper - lower) } else { fallback }
                })
                .collect()
        }));
        starts
    }

    /// Kinematics of the posture nearest to the task's target that is found from `start`, by damped least squares
    /// (Levenberg and Marquardt). Joints that are at an end of their range and would move beyond it are excluded.
    pub fn solve(&self, task: &dyn Task, start: &[f64]) -> Data {
        const ITERATIONS: usize = 300;
        let (model, n) = (self.model, self.model.n());
        let clamped = |joint: usize, q: f64| {
            let (lower, upper) = self.ranges[joint];
            // If the margins leave no range, the middle is used.
            if lower < upper { q.clamp(lower, upper) } else { 0.5 * (lower + upper) }
        };
        let rest = vec![0.0; n];
        let mut q: Vec<f64> = start.iter().enumerate().map(|(joint, q)| clamped(joint, *q)).collect();
        let mut data = Data::new(model);
        kinematics(model, &mut data, &q, &rest);
        let mut missed = error(task, model, &data);
        let mut rows = Matrix6xX::zeros(n);
        let mut damping = 1e-3;
        for _ in 0..ITERATIONS {
            if missed.norm() < 0.1 * REACHED_M || damping > 1e9 {
                break;
            }
            task.jacobian(model, &data, &mut rows);
            (0..6)
                .filter(|&row| row >= task.rows() || !task.follows_reference(row))
                .for_each(|row| rows.row_mut(row).fill(0.0));
            let downhill = rows.tr_mul(&missed);
            for joint in 0..n {
                if clamped(joint, q[joint] + 1e-9 * downhill[joint].signum()) == q[joint] {
                    rows.column_mut(joint).fill(0.0);
                }
            }
            let square = &rows * rows.transpose();
            let damped = square + Matrix6::identity() * (damping * square.trace().max(1e-9));
            let Some(factor) = damped.cholesky() else { break };
            let step: DVector<f64> = rows.tr_mul(&factor.solve(&missed));
            let next: Vec<f64> = (0..n).map(|joint| clamped(joint, q[joint] + step[joint])).collect();
            kinematics(model, &mut data, &next, &rest);
            let after = error(task, model, &data);
            if after.norm() < missed.norm() {
                (q, missed, damping) = (next, after, (0.3 * damping).max(1e-9));
            } else {
                kinematics(model, &mut data, &q, &rest);
                damping *= 4.0;
            }
        }
        data
    }
}

/// Posture in which a frame is at a pose, or nearest to it.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct PostureAt {
    /// Joint positions, rad or m (n), rounded to four decimals.
    pub q: Vec<f64>,
    /// Remaining distance (m) and angle (rad) from the pose.
    pub missed: [f64; 2],
    /// Number of searches.
    pub tries: usize,
    /// Start positions for a task file.
    pub start_rad: String,
    /// Links that touch each other or are nearer than the robot's margin, as far as their capsules show; `None` if none are.
    pub contact: Option<[String; 2]>,
}

/// Searches for a posture within the joint limits in which a frame is at `position_m`, with the orientation `rpy_rad` (about
/// fixed axes) if it is given. The first search starts at `start` (n; rad, m), which need not be within the limits. Of the
/// postures that reach the pose, those are preferred in which no links of `own_body` are nearer than its margin, and then the
/// one whose joints are farthest from their limits.
///
/// # Errors
/// A frame that the robot does not have, or that cannot move along all axes of the pose in any posture.
pub fn posture_at(
    model: &Model,
    frame: &str,
    position_m: [f64; 3],
    rpy_rad: Option<[f64; 3]>,
    start: &[f64],
    mut own_body: Option<&mut OwnBody>,
) -> Result<PostureAt, ControlError> {
    let axes =
        if rpy_rad.is_some() { Axes::pose(AxisMode::Motion) } else { Axes::position(AxisMode::Motion) };
    let gains = AxisGains::new(10.0, 1.0)?;
    let goal = Waypoint {
        time_s: Positive::literal(1e-3),
        position: Some(PositionGoal::Absolute(position_m)),
        orientation: rpy_rad.map(OrientationGoal::Absolute),
    };
    let parameters = CartesianParameters::new(frame, axes, gains)
        .with_reference(CartesianReference::Waypoints(vec![goal]));
    let mut task = CartesianTask::new(frame, &parameters, model, &ControlContext::new(model, 1e-3))?;
    let (mut data, n) = (Data::new(model), model.n());
    kinematics(model, &mut data, start, &vec![0.0; n]);
    let mut measurement = Measurement::new(n, 0, false);
    measurement.q.copy_from_slice(start);
    let (feedforward, targets) = (vec![0.0; n], Targets::none());
    task.start(&ControlInput::new(model, &data, &measurement, &feedforward, &targets));
    measurement.time_s = 1.0;
    let control = ControlInput::new(model, &data, &measurement, &feedforward, &targets);
    task.observe(&TaskInput { control, limited: true, target: TaskTarget::none(0.0) });

    let ranges = model.joints().iter().map(|joint| {
        let (lower, upper) = joint.limits.range(joint.kind);
        let margin = MARGIN.min(0.1 * (upper - lower));
        (lower + margin, upper - margin)
    });
    let search = PostureSearch { model, ranges: ranges.collect() };
    let mut best: Option<(Quality, PostureAt)> = None;
    let starts = search.starts(&[start]);
    for start in &starts {
        let found = search.solve(&task, start);
        let joints = model.joints().iter().zip(&search.ranges).zip(found.q.iter());
        let q: Vec<f64> =
            joints.map(|((joint, range), q)| rounded(without_turns(joint.kind, *range, *q))).collect();
        let contacts = own_body.as_mut().map(|own| own.contacts(model, &mut data, &q, own.margin_m()));
        let contact = contacts.and_then(|contacts| contacts.links);
        kinematics(model, &mut data, &q, &vec![0.0; n]);
        let left = error(&task, model, &data);
        let missed = ["m", "rad"].map(|unit| norm_in(&task, &left, unit));
        let quality =
            Quality { left_m: left.norm(), is_clear: contact.is_none(), room: room(&search.ranges, &q) };
        if best.as_ref().is_none_or(|(least, _)| quality.is_better_than(least)) {
            let joints: Vec<String> = model
                .joints()
                .iter()
                .zip(&q)
                .map(|(joint, q)| format!("{} = {q:?}", dotted(std::slice::from_ref(&joint.name))))
                .collect();
            let start_rad = format!("start_rad = {{ {} }}", joints.join(", "));
            best = Some((quality, PostureAt { q, missed, tries: starts.len(), start_rad, contact }));
        }
    }
    Ok(best.map_or_else(
        || PostureAt {
            q: start.to_vec(),
            missed: [f64::INFINITY; 2],
            tries: 0,
            start_rad: String::new(),
            contact: None,
        },
        |(_, best)| best,
    ))
}

/// Quality of a posture that a search finds.
#[derive(Clone, Copy, Debug)]
struct Quality {
    /// Norm of the remaining error, m; rotations are scaled to m.
    left_m: f64,
    /// True if no links touch.
    is_clear: bool,
    /// Distance from the limits, from 0 to 1.
    room: f64,
}

impl Quality {
    fn is_better_than(&self, other: &Self) -> bool {
        let reaches = |quality: &Self| quality.left_m < REACHED_M;
        match (reaches(self), reaches(other)) {
            (true, true) if self.is_clear == other.is_clear => self.room > other.room,
            (true, true) => self.is_clear,
            _ => self.left_m < other.left_m,
        }
    }
}

/// Smallest distance of a joint from the ends of its range, over half of the range: from 0 to 1, or 1 without ranges.
fn room(ranges: &[(f64, f64)], q: &[f64]) -> f64 {
    let of = |(&(lower, upper), q): (&(f64, f64), &f64)| (q - lower).min(upper - q) / (0.5 * (upper - lower));
    ranges.iter().zip(q).map(of).filter(|room| room.is_finite()).fold(1.0, f64::min)
}

/// Norm of an error over the rows of a task with the given unit, in this unit.
pub fn norm_in(task: &dyn Task, error: &Vector6<f64>, unit: &str) -> f64 {
    let rows = (0..task.rows()).filter(|&row| task.row_unit(row).0 == unit);
    rows.map(|row| (error[row] / task.row_unit(row).1).powi(2)).sum::<f64>().sqrt()
}

/// Position without whole turns of a joint that can make them, if its range permits it.
fn without_turns(kind: JointKind, (lower, upper): (f64, f64), q: f64) -> f64 {
    let nearer = q - TAU * (q / TAU).round();
    let turns = matches!(kind, JointKind::Revolute | JointKind::Continuous);
    if turns && (lower..=upper).contains(&nearer) { nearer } else { q }
}

/// Position with four decimals.
fn rounded(q: f64) -> f64 {
    (q * 1e4).round() / 1e4
}

#[cfg(test)]
mod tests {
    use super::{Quality, REACHED_M, posture_at, room};
    use crate::files::source::Source;
    use crate::postures::own_body::OwnBody;
    use opspace_model::{Model, Placement};

    /// Two links of 1 m whose joints turn about y, on a column of 0.5 m without inertia. The elbow turns further to one side.
    const ARM: &str = r#"<robot name="arm"><link name="base"/>
        <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.5"/>
        <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="50" velocity="2"/></joint>
        <link name="upper"><inertial><origin xyz="0 0 0.5"/><mass value="1"/>
        <inertia ixx="0.1" iyy="0.1" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0 0 1"/>
        <axis xyz="0 1 0"/><limit lower="-3" upper="1.7" effort="50" velocity="2"/></joint>
        <link name="fore"><inertial><origin xyz="0 0 0.5"/><mass value="1"/>
        <inertia ixx="0.1" iyy="0.1" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="end" type="fixed"><parent link="fore"/><child link="tip"/><origin xyz="0 0 1"/></joint>
        <link name="tip"/></robot>"#;

    /// Error of the search, m and rad.
    const FOUND: f64 = 1e-3;

    fn quality(left_m: f64, is_clear: bool, room: f64) -> Quality {
        Quality { left_m, is_clear, room }
    }

    /// Checks the order of postures: those that reach, those without contact, those far from the limits.
    #[test]
    fn reach_then_contact_then_room_decide() {
        let (reached, missed) = (0.1 * REACHED_M, 10.0 * REACHED_M);
        for (better, worse) in [
            (quality(reached, false, 0.1), quality(missed, true, 0.9)),
            (quality(reached, true, 0.1), quality(reached, false, 0.9)),
            (quality(reached, true, 0.9), quality(reached, true, 0.1)),
            (quality(missed, false, 0.1), quality(2.0 * missed, true, 0.9)),
        ] {
            assert!(better.is_better_than(&worse) && !worse.is_better_than(&better), "{better:?} {worse:?}");
        }
    }

    /// Compared: the two postures of a planar arm, with the elbow at ±arccos(−0.18) or so by the law of cosines. The search
    /// begins at the one that is closer to its limit, and returns the other.
    #[test]
    fn posture_far_from_the_limits_is_returned() {
        let model = Model::from_urdf(ARM).expect("a URDF").model;
        let goal_m = [1.2, 0.0, 0.7];
        let distance_m = f64::hypot(goal_m[0], goal_m[2] - 0.5);
        let elbow = (0.5 * distance_m * distance_m - 1.0).acos();
        let shoulder = |elbow: f64| f64::atan2(goal_m[0], goal_m[2] - 0.5) - 0.5 * elbow;
        let first = [shoulder(elbow), elbow];
        let found = posture_at(&model, "tip", goal_m, None, &first, None).expect("a posture");
        assert!(found.missed[0] < FOUND, "{found:?}");
        let expected = [shoulder(-elbow), -elbow];
        let ranges = [(-2.98, 2.98), (-2.98, 1.68)];
        assert!(room(&ranges, &expected) > room(&ranges, &first));
        for (found, expected) in found.q.iter().zip(expected) {
            assert!((found - expected).abs() < FOUND, "{found} {expected}");
        }
    }

    /// Checks a place that the arm reaches only with its forearm through its column, and one beside it.
    #[test]
    fn contact_with_the_own_base_is_named() {
        let model = Model::from_urdf(ARM).expect("a URDF").model;
        let urdf = Source::new("arm.urdf", ARM.to_owned());
        let mut own_body = OwnBody::new(&model, &urdf, None, 2.0, 0.0).expect("links that can touch");
        let mut at = |goal_m: [f64; 3]| {
            posture_at(&model, "tip", goal_m, None, &[0.5, 0.5], Some(&mut own_body)).expect("a posture")
        };
        let through = at([0.0, 0.0, 0.2]);
        assert_eq!(through.contact, Some(["fore".to_owned(), "base".to_owned()]), "{through:?}");
        let beside = at([1.2, 0.0, 0.7]);
        assert_eq!(beside.contact, None, "{beside:?}");
    }

    /// Checks that an arm on a column has a floor under its base: on a wall and on a ceiling it is the surface that carries the base.
    #[test]
    fn link_below_the_base_touches_the_floor() {
        for rpy in [[0.0; 3], [0.0, 1.5, 0.0], [3.0, 0.0, 0.7]] {
            let base = Placement::from_rpy(rpy, [0.3, -0.5, 1.2]);
            let model = Model::from_urdf(ARM).expect("a URDF").model.with_base(base);
            let urdf = Source::new("arm.urdf", ARM.to_owned());
            let mut own_body = OwnBody::new(&model, &urdf, None, 2.0, 0.0).expect("links that can touch");
            let mut data = opspace_model::Data::new(&model);
            let mut contacts = |q: [f64; 2]| own_body.contacts(&model, &mut data, &q, 0.0);
            assert_eq!(contacts([1.57, 1.0]).with_floor.as_deref(), Some("fore"), "{rpy:?}");
            assert_eq!(contacts([0.5, 0.5]), super::super::own_body::Contacts::default(), "{rpy:?}");
        }
    }
}

//! A first motion of a robot: a start pose away from limits, singularities and self-contact, and a displacement of the tip
//! that the arm can do there.

use crate::assumed_drives::LARGEST_POSITION;
use nalgebra::{DMatrix, DVector, Dyn, Matrix3, Matrix6xX, SVD, Vector3};
use opspace_experiment::files::source::Source;
use opspace_experiment::postures::own_body::{Contacts, OwnBody};
use opspace_experiment::postures::tip::{arms, tip};
use opspace_model::{
    Data, FrameId, JointKind, Model, Postures, forward_kinematics, frame_jacobian, frame_placement, gravity,
};

/// Number of postures among which the start is chosen.
const POSTURES: usize = 2000;
/// Number of the best postures at which motions are tried.
const TRIED: usize = 40;
/// Fraction of the range of each joint in which the start is.
const RANGE: f64 = 0.8;
/// Displacements that are tried, m.
const DISTANCES_M: [f64; 4] = [0.1, 0.05, 0.02, 0.01];
/// Steps in which a displacement is followed.
const STEPS: usize = 20;
/// Least singular value of the Jacobian of the task over the length of the arm.
const LEAST_SINGULAR_VALUE: f64 = 0.06;
/// Largest torque that holds the arm over the torque limit.
const LARGEST_LOAD: f64 = 0.6;
/// Largest speed of a joint over its limit.
const LARGEST_SPEED: f64 = 0.4;
/// Largest speed of a joint, rad/s (m/s).
const LARGEST_JOINT_SPEED: f64 = 1.0;
/// Peak over mean speed of a minimum-jerk motion.
const PEAK_OVER_MEAN: f64 = 1.875;
/// Least distance of links over the length of the arm.
pub(crate) const LEAST_DISTANCE: f64 = 0.02;

/// Axes of a tip that a first task controls.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControlledAxes {
    /// Position and orientation.
    Pose,
    /// Position.
    Position,
    /// The axis of the motion alone.
    One,
}

/// Conditions that the postures of a first motion keep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Clearance {
    /// Links keep a distance from each other and from the floor under the base, and no load is large.
    Full,
    /// Links keep a distance from each other, and no load is large; they may be below the base.
    WithoutFloor,
    /// None: links may touch, and loads may be large.
    None,
}

/// First motion of a robot.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct FirstMotion {
    /// Start positions (n; rad, m).
    pub start: Vec<f64>,
    /// Name of the frame that moves.
    pub frame: String,
    /// Position of the frame at the start, in world axes, m.
    pub tip_m: [f64; 3],
    /// Axes that the task controls.
    pub axes: ControlledAxes,
    /// Axis of the motion: 0, 1 or 2 for x, y or z of the world.
    pub axis: usize,
    /// Displacement along the axis, m; 0 if the tip can only be held.
    pub distance_m: f64,
    /// Duration of the displacement, s.
    pub duration_s: f64,
    /// Conditions that its postures keep.
    pub clearance: Clearance,
    /// Links that touch each other or the floor at the start, as far as their capsules show.
    pub contacts: Contacts,
}

/// Search for a motion.
struct Search<'a> {
    model: &'a Model,
    frame: FrameId,
    data: Data,
    jacobian: Matrix6xX<f64>,
    /// Torque limits (n; Nm, N); infinite if unknown.
    torque_limits: &'a [f64],
    /// True for the joints that move the frame (n).
    moves: Vec<bool>,
    /// Positions of the other joints (n; rad, m).
    rest: Vec<f64>,
    /// Length of the arm, m.
    reach_m: f64,
    own_body: Option<OwnBody>,
}

/// Finds a first motion of the frame `tip`, or of the end of the longest chain of joints. `torque_limits` (n; Nm, N) are
/// infinite where they are unknown. Returns `None` if the robot has no joints, or no frame of this name.
#[must_use]
pub fn first_motion(
    model: &Model,
    urdf: &Source,
    tip_name: Option<&str>,
    torque_limits: &[f64],
) -> Option<FirstMotion> {
    let frame = match tip_name {
        Some(name) => model.frame_id(name).ok()?,
        None => tip(model)?,
    };
    let mut search = Search::new(model, urdf, frame, torque_limits, rest(model))?;
    // Other arms start at postures of their own, neither singular nor touching.
    for arm in arms(model) {
        let other = model.frame_id(&arm.to).ok().filter(|other| *other != frame);
        let Some(mut of_other) =
            other.and_then(|other| Search::new(model, urdf, other, torque_limits, search.rest.clone()))
        else {
            continue;
        };
        let is_own = |i: usize| of_other.moves[i] && !search.moves[i];
        let own: Vec<usize> = (0..model.n()).filter(|&i| is_own(i)).collect();
        if let Some(posture) = of_other.best_posture(&own) {
            search.rest = posture;
        }
    }
    for axes in search.axes() {
        // Without a posture that keeps all conditions, a place below the base is accepted, then loads and contacts.
        for clearance in [Clearance::Full, Clearance::WithoutFloor, Clearance::None] {
            if let Some(found) = search.motion(axes, clearance) {
                return Some(found);
            }
        }
    }
    let start = search.posture(0);
    Some(search.at(start, ControlledAxes::One, (0, 0.0), 1.0, Clearance::None))
}

/// Largest distance of a frame from the first joint that moves it, in some postures, m.
pub(crate) fn reach(model: &Model, frame: FrameId) -> f64 {
    let mut data = Data::new(model);
    let mut reach: f64 = 0.0;
    for number in 0..50 {
        let q = Postures::new(model, 1.0).posture(number);
        forward_kinematics(model, &mut data, &q);
        let tip = frame_placement(model, &data, frame).translation;
        let first = model.ancestors(frame).last();
        let base = first.map_or(Vector3::zeros(), |body| data.placement[body].translation);
        reach = reach.max((tip - base).norm());
    }
    reach.max(1e-3)
}

/// Positions of joints that need no others (n; rad, m): zero, or the middle of their range if zero is not in its middle half.
fn rest(model: &Model) -> Vec<f64> {
    let rest = |joint: &opspace_model::Joint| {
        let (lower, upper) = joint.limits.range(joint.kind);
        let (middle, quarter) = (0.5 * (lower + upper), 0.25 * (upper - lower));
        if middle.abs() < quarter { 0.0 } else { middle }
    };
    model.joints().iter().map(rest).collect()
}

impl<'a> Search<'a> {
    fn new(
        model: &'a Model,
        urdf: &Source,
        frame: FrameId,
        torque_limits: &'a [f64],
        rest: Vec<f64>,
    ) -> Option<Self> {
        let mut moves = vec![false; model.n()];
        model.ancestors(frame).for_each(|body| moves[model.bodies()[body].joint] = true);
        if moves.iter().all(|moves| !moves) {
            return None;
        }
        let mut search = Self {
            model,
            frame,
            data: Data::new(model),
            jacobian: Matrix6xX::zeros(model.n()),
            torque_limits,
            moves,
            rest,
            reach_m: 0.0,
            own_body: None,
        };
        search.reach_m = reach(model, frame);
        let within_m = LEAST_DISTANCE * search.reach_m;
        search.own_body = OwnBody::new(model, urdf, None, search.reach_m, within_m);
        Some(search)
    }

    /// Sets of axes that the arm may be able to control, the largest first.
    fn axes(&self) -> Vec<ControlledAxes> {
        let joints = self.moves.iter().filter(|moves| **moves).count();
        let all = [(ControlledAxes::Pose, 6), (ControlledAxes::Position, 3), (ControlledAxes::One, 1)];
        all.into_iter().filter(|(_, least)| joints >= *least).map(|(axes, _)| axes).collect()
    }

    /// Posture of this number: joints that do not move the tip are at rest.
    fn posture(&self, number: usize) -> Vec<f64> {
        let sampled = Postures::new(self.model, RANGE).posture(number);
        let position = |i: usize| match self.moves[i] {
            true => sampled[i].clamp(-LARGEST_POSITION, LARGEST_POSITION),
            false => self.rest[i].clamp(-LARGEST_POSITION, LARGEST_POSITION),
        };
        // Three decimals are enough.
        (0..sampled.len()).map(|i| (position(i) * 1000.0).round() / 1000.0).collect()
    }

    /// Returns the posture in which the arm moves best, with all joints but `own` at rest; `None` if none is good.
    fn best_posture(&mut self, own: &[usize]) -> Option<Vec<f64>> {
        for axes in self.axes() {
            for clearance in [Clearance::Full, Clearance::WithoutFloor] {
                let mut best: Option<(f64, Vec<f64>)> = None;
                for number in 0..POSTURES {
                    let sampled = self.posture(number);
                    let mut q = self.rest.clone();
                    own.iter().for_each(|&i| q[i] = sampled[i]);
                    let score = self.score(&q, axes, clearance);
                    if score > best.as_ref().map_or(0.0, |(most, _)| *most) {
                        best = Some((score, q));
                    }
                }
                if let Some((_, q)) = best {
                    return Some(q);
                }
            }
        }
        None
    }

    fn motion(&mut self, axes: ControlledAxes, clearance: Clearance) -> Option<FirstMotion> {
        let mut scored: Vec<(f64, Vec<f64>)> = Vec::new();
        for number in 0..POSTURES {
            let q = self.posture(number);
            let score = self.score(&q, axes, clearance);
            if score > 0.0 {
                scored.push((score, q));
            }
        }
        scored.sort_by(|a, b| b.0.total_cmp(&a.0));
        let farthest_m = 0.4 * self.reach_m;
        for distance_m in DISTANCES_M.into_iter().filter(|distance| *distance <= farthest_m) {
            for (_, start) in scored.iter().take(TRIED) {
                let mut ways: Vec<(f64, usize, f64)> = Vec::new();
                for (axis, sign) in (0..3).flat_map(|axis| [(axis, 1.0), (axis, -1.0)]) {
                    let duration = self.duration(start, axes, axis, sign * distance_m, clearance);
                    ways.extend(duration.map(|duration_s| (duration_s, axis, sign * distance_m)));
                }
                // The motion that needs the slowest joints.
                let best = ways.into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
                if let Some((duration_s, axis, distance)) = best {
                    return Some(self.at(start.clone(), axes, (axis, distance), duration_s, clearance));
                }
            }
        }
        None
    }

    fn at(
        &mut self,
        start: Vec<f64>,
        axes: ControlledAxes,
        (axis, distance_m): (usize, f64),
        duration_s: f64,
        clearance: Clearance,
    ) -> FirstMotion {
        let contacts = self.contacts(&start, 0.0);
        forward_kinematics(self.model, &mut self.data, &start);
        let tip_m = frame_placement(self.model, &self.data, self.frame).translation.into();
        let frame = self.model.frame(self.frame).name.clone();
        FirstMotion { start, frame, tip_m, axes, axis, distance_m, duration_s, clearance, contacts }
    }

    /// Quality of a posture from 0 to 1: the product of the distances from limits, singularities and largest loads; 0 if it
    /// cannot be used.
    fn score(&mut self, q: &[f64], axes: ControlledAxes, clearance: Clearance) -> f64 {
        let singular = self.least_singular_value(q, axes);
        if singular < LEAST_SINGULAR_VALUE {
            return 0.0;
        }
        gravity(self.model, &mut self.data);
        let loads =
            self.data.gravity.iter().zip(self.torque_limits).map(|(torque, limit)| torque.abs() / limit);
        let load = loads.fold(0.0, f64::max);
        if clearance != Clearance::None && (load > LARGEST_LOAD || !self.is_clear(q, clearance)) {
            return 0.0;
        }
        let near = self.model.joints().iter().zip(q).map(|(joint, q)| {
            let (lower, upper) = joint.limits.range(joint.kind);
            if joint.kind == JointKind::Continuous || upper <= lower {
                return 1.0;
            }
            ((q - lower).min(upper - q) / (0.25 * (upper - lower))).min(1.0)
        });
        let room =
            near.zip(&self.moves).filter(|(_, moves)| **moves).map(|(near, _)| near).fold(1.0, f64::min);
        room * (singular / (4.0 * LEAST_SINGULAR_VALUE)).min(1.0) * (1.0 - load.min(0.99))
    }

    /// True if links keep a safe distance from each other, and from the floor if that is a condition.
    fn is_clear(&mut self, q: &[f64], clearance: Clearance) -> bool {
        let contacts = self.contacts(q, LEAST_DISTANCE * self.reach_m);
        contacts.links.is_none() && (contacts.with_floor.is_none() || clearance == Clearance::WithoutFloor)
    }

    /// Links that are nearer than `within_m` to each other, or to the floor.
    fn contacts(&mut self, q: &[f64], within_m: f64) -> Contacts {
        let own_body = self.own_body.as_mut();
        own_body.map_or_else(Contacts::default, |own_body| {
            own_body.contacts(self.model, &mut self.data, q, within_m)
        })
    }

    /// Least singular value of the Jacobian of the task over the length of the arm.
    fn least_singular_value(&mut self, q: &[f64], axes: ControlledAxes) -> f64 {
        let jacobian = self.task_jacobian(q, axes, None);
        match axes {
            // One axis of the three is enough.
            ControlledAxes::One => {
                jacobian.row_iter().map(|row| row.norm()).fold(0.0, f64::max) / self.reach_m
            }
            _ => decomposed(jacobian).map_or(0.0, |svd| svd.singular_values.min()) / self.reach_m,
        }
    }

    /// Jacobian of the task; its angular rows are multiplied by a quarter of the length of the arm.
    fn task_jacobian(&mut self, q: &[f64], axes: ControlledAxes, axis: Option<usize>) -> DMatrix<f64> {
        forward_kinematics(self.model, &mut self.data, q);
        frame_jacobian(self.model, &self.data, self.frame, &mut self.jacobian);
        let mut rows = DMatrix::from(self.jacobian.rows(0, 6));
        rows.rows_mut(3, 3).scale_mut(0.25 * self.reach_m);
        match (axes, axis) {
            (ControlledAxes::Pose, _) => rows,
            (ControlledAxes::One, Some(axis)) => rows.rows(axis, 1).into_owned(),
            _ => rows.rows(0, 3).into_owned(),
        }
    }

    /// Returns the duration of a displacement; `None` if the arm cannot do it.
    fn duration(
        &mut self,
        start: &[f64],
        axes: ControlledAxes,
        axis: usize,
        distance_m: f64,
        clearance: Clearance,
    ) -> Option<f64> {
        let mut q = start.to_vec();
        forward_kinematics(self.model, &mut self.data, &q);
        let begin = frame_placement(self.model, &self.data, self.frame);
        let mut slowest = vec![0.0_f64; q.len()];
        for step in 1..=STEPS {
            let mut goal = begin.translation;
            goal[axis] += distance_m * step as f64 / STEPS as f64;
            let before = q.clone();
            for _ in 0..3 {
                let jacobian = self.task_jacobian(&q, axes, Some(axis));
                let place = frame_placement(self.model, &self.data, self.frame);
                let error =
                    self.error(axes, axis, &(goal - place.translation), &begin.rotation, &place.rotation);
                let decomposed = decomposed(jacobian)?;
                if decomposed.singular_values.min() / self.reach_m < LEAST_SINGULAR_VALUE {
                    return None;
                }
                let inverse = decomposed.pseudo_inverse(1e-9).ok()?;
                q.iter_mut().zip((inverse * error).iter()).for_each(|(q, change)| *q += change);
            }
            if self.score(&q, axes, clearance) <= 0.0 || !self.is_within_limits(&q) {
                return None;
            }
            for ((most, q), before) in slowest.iter_mut().zip(&q).zip(&before) {
                *most = most.max((q - before).abs() * STEPS as f64);
            }
        }
        let durations = slowest.iter().zip(self.model.joints()).map(|(change, joint)| {
            let speed = (LARGEST_SPEED * joint.limits.velocity).min(LARGEST_JOINT_SPEED);
            PEAK_OVER_MEAN * change / speed.max(1e-6)
        });
        let duration_s = durations.fold(1.5, f64::max);
        (duration_s <= 6.0).then(|| (duration_s * 10.0).ceil() / 10.0)
    }

    /// Error of the task: position (m), and rotation in the units of [`task_jacobian`](Self::task_jacobian).
    fn error(
        &self,
        axes: ControlledAxes,
        axis: usize,
        position: &Vector3<f64>,
        goal: &Matrix3<f64>,
        rotation: &Matrix3<f64>,
    ) -> DVector<f64> {
        let turn = goal * rotation.transpose();
        let angular = Vector3::new(
            turn[(2, 1)] - turn[(1, 2)],
            turn[(0, 2)] - turn[(2, 0)],
            turn[(1, 0)] - turn[(0, 1)],
        ) * (0.5 * 0.25 * self.reach_m);
        match axes {
            ControlledAxes::Pose => DVector::from_iterator(6, position.iter().chain(angular.iter()).copied()),
            ControlledAxes::Position => DVector::from_iterator(3, position.iter().copied()),
            ControlledAxes::One => DVector::from_element(1, position[axis]),
        }
    }

    fn is_within_limits(&self, q: &[f64]) -> bool {
        self.model.joints().iter().zip(q).zip(&self.moves).all(|((joint, q), moves)| {
            let (lower, upper) = joint.limits.range(joint.kind);
            let margin = 0.05 * (upper - lower);
            !moves || joint.kind == JointKind::Continuous || (lower + margin..=upper - margin).contains(q)
        })
    }
}

/// Largest number of steps of a decomposition: it would not end if a number is not finite.
const MAX_ITERATIONS: usize = 1000;

fn decomposed(jacobian: DMatrix<f64>) -> Option<SVD<f64, Dyn, Dyn>> {
    jacobian.try_svd(true, true, f64::EPSILON, MAX_ITERATIONS)
}

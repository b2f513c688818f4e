//! References of a joint-tracking task: q_d, q̇_d and q̈_d of each joint.
//!
//! ```text
//! point-to-point, waypoints   q_d = q₀ + s(t) (q_goal − q₀)
//! sinusoid                    q_d = q₀ + s(t) Σ (b + a sin(2π f t + φ))
//! goal                        jerk-limited motion (online)
//! ```
//!
//! s is the [minimum-jerk ramp](crate::references::ramp).
//!
//! Each starts, at time 0, at the current reference: at the start of a run this is
//! the posture of the robot, at rest; during a run it is the value of the previous reference. A [`JointOnlineGoal`]
//! also continues the velocity and acceleration; the other references start from rest. Joints that are not named keep
//! their position.

use crate::error::{ControlError, Reason};
use crate::per_joint::{PerJoint, indices};
use crate::references::online::{MotionLimits, OnlineMotion};
use crate::references::ramp::{Quintic, minimum_jerk, product};
use crate::references::streamed_joints::StreamedJointReference;
use crate::references::target::BLEND_S;
use crate::references::wave;
use crate::references::wave::{AngularWave, Wave, default_ramp_s};
use nalgebra::DVector;
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_model::{JointKind, Model};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::BTreeMap;

/// Reference of a joint-tracking task.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum JointReference {
    /// Stays at the start posture.
    Hold,
    /// Moves to one posture and stays there.
    PointToPoint(JointPointToPoint),
    /// Oscillates about the start posture.
    Sinusoid(JointSinusoid),
    /// Moves from posture to posture and stops at each.
    Waypoints(#[cfg_attr(feature = "schema", schemars(extend("minItems" = 1)))] Vec<JointWaypoint>),
    /// Moves to one posture as fast as its limits allow, from any state of motion.
    Goal(JointOnlineGoal),
    /// Follows streamed targets.
    Streamed(StreamedJointReference),
}

/// A minimum-jerk motion to one posture.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct JointPointToPoint {
    /// Goal posture.
    pub goal: JointGoal,
    /// Duration of the motion, s.
    pub duration_s: Positive,
    /// Start time of the motion, s after the start of the reference.
    #[serde(default)]
    pub start_s: NonNegative,
}

/// A waypoint, reached with minimum jerk from the previous one.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct JointWaypoint {
    /// Time of arrival, s after the start.
    pub time_s: Positive,
    /// Posture of the waypoint; joints that are not named keep their position.
    pub goal: JointGoal,
}

/// A motion to one posture as fast as the limits allow, from any state of motion at the start. The joints arrive
/// independently of each other.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct JointOnlineGoal {
    /// Goal posture.
    pub posture: JointGoal,
    /// Highest speed, rad/s (m/s for a prismatic joint).
    pub velocity_rad_per_s: PerJoint<Positive>,
    /// Highest acceleration, rad/s² (m/s²).
    pub acceleration_rad_per_s2: PerJoint<Positive>,
    /// Highest jerk, rad/s³ (m/s³).
    pub jerk_rad_per_s3: PerJoint<Positive>,
}

/// Goal posture, by joint names. A continuous joint takes the shortest way to an absolute position: that of 3.0 rad to -3.0 rad has
/// 0.28 rad.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
pub enum JointGoal {
    /// Joint positions, rad (m for a prismatic joint).
    #[serde(rename = "absolute_rad")]
    Absolute(BTreeMap<String, f64>),
    /// Offsets from the posture at the start of the run, rad (m for a prismatic joint).
    #[serde(rename = "offset_rad")]
    Offset(BTreeMap<String, f64>),
}

/// Sums of sines, added to the start posture.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct JointSinusoid {
    /// The sines of each joint, by its name.
    pub joints: BTreeMap<String, Vec<AngularWave>>,
    /// Duration over which the sines are faded in by the minimum-jerk ramp, s.
    #[serde(default = "default_ramp_s")]
    pub ramp_s: Positive,
}

/// Trajectory of a [`JointReference`].
#[derive(Clone, Debug)]
pub(crate) struct JointTrajectory {
    /// Reference at the start, rad or m (n).
    from: DVector<f64>,
    path: Path,
    /// Start time of the blend into the reference, s after the start.
    joining: Option<f64>,
    /// Fading offset of each joint's target from the reference (n).
    away: Vec<Quintic>,
}

/// Target of the joints: n positions, velocities and accelerations.
#[derive(Clone, Copy, Debug)]
pub(crate) struct JointMotion<'a> {
    /// Positions, rad (m for a prismatic joint).
    pub position: &'a [f64],
    /// Velocities, rad/s (m/s).
    pub velocity: &'a [f64],
    /// Accelerations, rad/s² (m/s²).
    pub acceleration: &'a [f64],
}

#[derive(Clone, Debug)]
enum Path {
    Legs(Vec<Leg>),
    Waves { joints: Vec<Vec<Wave>>, ramp_s: f64 },
    Online { goals: Vec<Goal>, limits: Vec<MotionLimits>, motions: Vec<OnlineMotion> },
}

#[derive(Clone, Debug)]
struct Leg {
    begin_s: f64,
    end_s: f64,
    goal: Vec<Goal>,
    from: DVector<f64>,
    to: DVector<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Goal {
    joint: usize,
    kind: JointKind,
    value: f64,
    from_home: bool,
}

impl JointTrajectory {
    /// Creates the trajectory of a reference; `key` is the path of the reference in the file.
    pub(crate) fn new(reference: &JointReference, model: &Model, key: &str) -> Result<Self, ControlError> {
        let path = match reference {
            // The task itself follows a streamed reference; without a target it holds.
            JointReference::Hold | JointReference::Streamed(_) => Path::Legs(Vec::new()),
            JointReference::PointToPoint(p) => {
                let goal = goals(&p.goal, model, &format!("{key}.point-to-point.goal"))?;
                let begin_s = p.start_s.get();
                Path::Legs(vec![Leg::new(begin_s, begin_s + p.duration_s.get(), goal, model.n())])
            }
            JointReference::Waypoints(list) => {
                let key = format!("{key}.waypoints");
                check_times(list.iter().map(|w| w.time_s.get()), &key)?;
                let mut begin_s = 0.0;
                let mut legs = Vec::with_capacity(list.len());
                for w in list {
                    let goal = goals(&w.goal, model, &format!("{key}.goal"))?;
                    legs.push(Leg::new(begin_s, w.time_s.get(), goal, model.n()));
                    begin_s = w.time_s.get();
                }
                Path::Legs(legs)
            }
            JointReference::Sinusoid(s) => {
                let mut joints = vec![Vec::new(); model.n()];
                for (joint, waves) in indices(model, &format!("{key}.sinusoid.joints"), &s.joints)? {
                    joints[joint] = waves.iter().map(Wave::from).collect();
                }
                Path::Waves { joints, ramp_s: s.ramp_s.get() }
            }
            JointReference::Goal(goal) => {
                let key = format!("{key}.goal");
                Path::Online {
                    goals: goals(&goal.posture, model, &format!("{key}.posture"))?,
                    limits: limits(goal, model, &key)?,
                    motions: vec![OnlineMotion::rest(0.0); model.n()],
                }
            }
        };
        let away = vec![Quintic::default(); model.n()];
        Ok(Self { from: DVector::zeros(model.n()), path, joining: None, away })
    }

    /// Starts now: time 0 of [`reference_at`](Self::reference_at) is this instant. Allocates nothing, so that a task
    /// can change during a run.
    ///
    /// `home` (n) is the posture at the start of the run, the base of the goals' offsets. `from` is the current
    /// reference; at the start of a run it is `home`, at rest.
    pub(crate) fn start(&mut self, home: &[f64], from: &JointMotion<'_>) {
        self.from.as_mut_slice().copy_from_slice(from.position);
        self.joining = None;
        match &mut self.path {
            Path::Legs(legs) => {
                for k in 0..legs.len() {
                    let (before, legs) = legs.split_at_mut(k);
                    let leg = &mut legs[0];
                    leg.from.copy_from(before.last().map_or(&self.from, |before| &before.to));
                    leg.to.copy_from(&leg.from);
                    for goal in &leg.goal {
                        leg.to[goal.joint] = goal.position(home, leg.from[goal.joint]);
                    }
                }
            }
            Path::Waves { .. } => {}
            Path::Online { goals, limits, motions } => {
                for (joint, (motion, limits)) in motions.iter_mut().zip(limits).enumerate() {
                    let goal = goals.iter().find(|goal| goal.joint == joint);
                    let state = [from.position[joint], from.velocity[joint], from.acceleration[joint]];
                    let to = goal.map_or(state[0], |goal| goal.position(home, state[0]));
                    *motion = OnlineMotion::new(state, to, limits);
                }
            }
        }
    }

    /// Blends from `q` (n), at rest, into the reference within [`BLEND_S`], starting `time_s` (s) after the start.
    /// Allocates nothing.
    pub(crate) fn join(&mut self, time_s: f64, q: &[f64]) {
        for (joint, q) in q.iter().enumerate() {
            let [x, v, a] = self.reference_at(joint, time_s);
            self.away[joint] = Quintic::new([q - x, -v, -a], 0.0, BLEND_S);
        }
        self.joining = Some(time_s);
    }

    /// Offset of a joint's target from the reference, `time_s` (s) after the start: position, velocity and
    /// acceleration.
    pub(crate) fn away(&self, joint: usize, time_s: f64) -> [f64; 3] {
        match self.joining {
            Some(begin_s) if time_s < begin_s + BLEND_S => self.away[joint].at(time_s - begin_s),
            _ => [0.0; 3],
        }
    }

    /// Returns true if it is a jerk-limited motion, which can start from any state of motion.
    pub(crate) fn is_online(&self) -> bool {
        matches!(self.path, Path::Online { .. })
    }

    /// Position, velocity and acceleration of a joint's reference at `time_s` after the start.
    pub(crate) fn reference_at(&self, joint: usize, time_s: f64) -> [f64; 3] {
        let start = self.from[joint];
        match &self.path {
            Path::Legs(legs) => match legs.iter().rev().find(|leg| leg.begin_s <= time_s) {
                None => [start, 0.0, 0.0],
                Some(leg) => {
                    let [s, ds, dds] = minimum_jerk(time_s - leg.begin_s, leg.end_s - leg.begin_s);
                    let (from, way) = (leg.from[joint], leg.to[joint] - leg.from[joint]);
                    [from + way * s, way * ds, way * dds]
                }
            },
            Path::Waves { joints, ramp_s } => {
                let ramp = minimum_jerk(time_s, *ramp_s);
                let [q, dq, ddq] = product(ramp, wave::sum(&joints[joint], time_s));
                [start + q, dq, ddq]
            }
            Path::Online { motions, .. } => motions[joint].at(time_s),
        }
    }
}

impl Goal {
    /// Position of the goal, for a joint that moves there from `from`.
    fn position(&self, home: &[f64], from: f64) -> f64 {
        match self.from_home {
            true => home[self.joint] + self.value,
            false => self.kind.nearest_turn(self.value, from),
        }
    }
}

impl Leg {
    fn new(begin_s: f64, end_s: f64, goal: Vec<Goal>, n: usize) -> Self {
        Self { begin_s, end_s, goal, from: DVector::zeros(n), to: DVector::zeros(n) }
    }
}

fn goals(goal: &JointGoal, model: &Model, key: &str) -> Result<Vec<Goal>, ControlError> {
    let (map, from_home, kind) = match goal {
        JointGoal::Absolute(map) => (map, false, "absolute_rad"),
        JointGoal::Offset(map) => (map, true, "offset_rad"),
    };
    let named = indices(model, &format!("{key}.{kind}"), map)?;
    let kind = |joint: usize| model.joints()[joint].kind;
    Ok(named.into_iter().map(|(joint, &value)| Goal { joint, kind: kind(joint), value, from_home }).collect())
}

fn limits(goal: &JointOnlineGoal, model: &Model, key: &str) -> Result<Vec<MotionLimits>, ControlError> {
    let velocity = goal.velocity_rad_per_s.resolve(model, &format!("{key}.velocity_rad_per_s"))?;
    let acceleration =
        goal.acceleration_rad_per_s2.resolve(model, &format!("{key}.acceleration_rad_per_s2"))?;
    let jerk = goal.jerk_rad_per_s3.resolve(model, &format!("{key}.jerk_rad_per_s3"))?;
    Ok((0..model.n())
        .map(|i| MotionLimits { velocity: velocity[i], acceleration: acceleration[i], jerk: jerk[i] })
        .collect())
}

/// Checks that there are waypoints and that their times increase. `key` is the path of their list in the file.
pub(crate) fn check_times(times: impl Iterator<Item = f64>, key: &str) -> Result<(), ControlError> {
    let mut previous_s = 0.0;
    let mut count = 0;
    for (index, time_s) in times.enumerate() {
        if time_s <= previous_s {
            return Err(ControlError::new(key, Reason::WaypointTime { index, time_s, previous_s }));
        }
        previous_s = time_s;
        count += 1;
    }
    if count == 0 { Err(ControlError::new(key, Reason::NoWaypoint)) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    const TWO_JOINTS: &str = r#"<robot name="two"><link name="base"/>
        <link name="upper"><inertial><origin xyz="0 0 -0.2"/><mass value="1"/><inertia ixx="0.01" ixy="0" ixz="0"
            iyy="0.01" iyz="0" izz="0.001"/></inertial></link>
        <link name="lower"><inertial><origin xyz="0 0 -0.2"/><mass value="1"/><inertia ixx="0.01" ixy="0" ixz="0"
            iyy="0.01" iyz="0" izz="0.001"/></inertial></link>
        <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/></joint>
        <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/>
            <origin xyz="0 0 -0.4"/><axis xyz="0 1 0"/></joint></robot>"#;

    fn begun(reference: &str, home: &[f64; 2], from: [[f64; 2]; 3]) -> JointTrajectory {
        let model = Model::from_urdf(TWO_JOINTS).expect("a robot").model;
        let reference = toml::from_str::<BTreeMap<String, JointReference>>(reference).expect("a reference");
        let mut trajectory =
            JointTrajectory::new(&reference["reference"], &model, "reference").expect("a path");
        let [position, velocity, acceleration] = &from;
        trajectory.start(home, &JointMotion { position, velocity, acceleration });
        trajectory
    }

    const GOAL: &str = "reference.goal = { posture = { offset_rad = { elbow = 0.5 } }, velocity_rad_per_s = 1.0, \
        acceleration_rad_per_s2 = { shoulder = 2.0, elbow = 4.0 }, jerk_rad_per_s3 = 20.0 }";

    /// Compared: the state at the start with the initial one, bit for bit; the motion of each joint with its limits at
    /// 500 instants; the end with home and goal. The shoulder, which is not named, returns to its initial position.
    #[test]
    fn goal_takes_over_joint_motion() {
        let from = [[0.3, -0.4], [0.6, -0.7], [1.0, 2.0]];
        let goal = begun(GOAL, &[0.1, 0.2], from);
        for (joint, acceleration) in [2.0, 4.0].into_iter().enumerate() {
            assert_eq!(goal.reference_at(joint, 0.0), from.map(|quantity| quantity[joint]));
            let step = 0.01;
            for k in 0..500 {
                let [now, next] =
                    [0.0, step].map(|ahead| goal.reference_at(joint, step * f64::from(k) + ahead));
                assert!(now[1].abs() <= 1.0 + 1e-9 && now[2].abs() <= acceleration + 1e-9, "{now:?}");
                assert!((next[2] - now[2]).abs() <= 20.0 * step + 1e-8, "{now:?}");
                let mean = (now[1] + next[1]) / 2.0 * step;
                assert!((next[0] - now[0] - mean).abs() <= 20.0 * step.powi(3) / 12.0 + 1e-9, "{now:?}");
            }
        }
        assert_eq!(goal.reference_at(0, 9.0), [0.3, 0.0, 0.0]);
        assert_eq!(goal.reference_at(1, 9.0), [0.2 + 0.5, 0.0, 0.0]);
    }

    /// References that start away from home: they start at the current position, and their offsets are relative to
    /// home.
    #[test]
    fn offsets_count_from_home() {
        let from = [[0.3, -0.4], [0.6, -0.7], [1.0, 2.0]];
        for (reference, end) in [
            ("reference = \"hold\"", [0.3, -0.4]),
            (
                "reference.point-to-point = { goal = { offset_rad = { elbow = 0.5 } }, duration_s = 1.0 }",
                [0.3, 0.2 + 0.5],
            ),
            (
                "reference.waypoints = [{ time_s = 1, goal = { offset_rad = { elbow = 0.5 } } }, \
                 { time_s = 2, goal = { absolute_rad = { shoulder = -1 } } }]",
                [-1.0, 0.2 + 0.5],
            ),
            (GOAL, [0.3, 0.2 + 0.5]),
        ] {
            let trajectory = begun(reference, &[0.1, 0.2], from);
            for joint in 0..2 {
                assert_eq!(trajectory.reference_at(joint, 0.0)[0], from[0][joint], "{reference}");
                let last = trajectory.reference_at(joint, 9.0);
                assert!(
                    (last[0] - end[joint]).abs() < 1e-15 && last[1..] == [0.0; 2],
                    "{reference}: {last:?}"
                );
            }
        }
    }

    /// Compared: the path of a continuous joint to absolute positions, and the shortest one by hand: 0.28 rad from 3.0 to -3.0,
    /// not 6, and from there on to the next waypoint. Goals within half a turn, and offsets, are taken as they are.
    #[test]
    fn continuous_joint_takes_the_shortest_way() {
        let from = [[3.0, -0.4], [0.0; 2], [0.0; 2]];
        let goal = "posture = { absolute_rad = { shoulder = -3.0 } }, velocity_rad_per_s = 1.0, acceleration_rad_per_s2 = 2.0, \
                    jerk_rad_per_s3 = 20.0";
        for (reference, end) in [
            (
                "reference.point-to-point = { goal = { absolute_rad = { shoulder = -3.0 } }, duration_s = 1.0 }",
                TAU - 3.0,
            ),
            (
                "reference.point-to-point = { goal = { absolute_rad = { shoulder = 1.0 } }, duration_s = 1.0 }",
                1.0,
            ),
            (
                "reference.point-to-point = { goal = { offset_rad = { shoulder = -6.0 } }, duration_s = 1.0 }",
                -3.0,
            ),
            (&format!("reference.goal = {{ {goal} }}"), TAU - 3.0),
            (
                "reference.waypoints = [{ time_s = 1, goal = { absolute_rad = { shoulder = -3.0 } } }, \
                 { time_s = 2, goal = { absolute_rad = { shoulder = -1.0 } } }, \
                 { time_s = 3, goal = { absolute_rad = { shoulder = 2.0 } } }]",
                TAU + 2.0,
            ),
        ] {
            let trajectory = begun(reference, &from[0], from);
            let [first, last] = [0.0, 9.0].map(|time_s| trajectory.reference_at(0, time_s)[0]);
            assert!((first - 3.0).abs() < 1e-15 && (last - end).abs() < 1e-14, "{reference}: {first} {last}");
        }
    }
}

//! References of a Cartesian task: pose, velocity and acceleration of its frame.
//!
//! ```text
//! hold                        x_d = x₀
//! point-to-point, waypoints   x_d = x₀ + s(t) (x_goal − x₀)        R_d = exp(s(t) φ) R₀
//! sinusoid                    x_d = x₀ + A s(t) Σ (b + a sin(2π f t + φ))
//! goal                        jerk-limited motion (online)
//! path, recorded, streamed    see their files
//! ```
//!
//! s is the [minimum-jerk ramp](crate::references::ramp), A the axes of the task.
//!
//! Every reference starts, at time 0, at the current target: at the start of a run this is the frame's pose, at rest;
//! during a run it is the target of the previous reference. An [`OnlineGoal`] also continues the velocity and
//! acceleration; the other references start from rest.

use crate::orientation;
use crate::references::blend::{Joining, moved};
use crate::references::goal::{OrientationGoal, PositionGoal, position, rotation};
use crate::references::online::{OnlineGoal, OnlineVector};
use crate::references::path_bounds::PathPlace;
use crate::references::path_motion::{PathMotion, TimedReference};
#[cfg(feature = "schema")]
use crate::references::path_reference::PathReference;
use crate::references::ramp::{minimum_jerk, product};
use crate::references::recorded::{RecordedMotion, RecordedPath};
use crate::references::streamed_pose::StreamedReference;
use crate::references::target::{BLEND_S, Target};
use crate::references::wave;
use crate::references::wave::{AngularWave, LinearWave, Wave, default_ramp_s};
use nalgebra::{Matrix3, Vector3};
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_model::Placement;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Reference of a Cartesian task.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum CartesianReference {
    /// Stays at the start pose.
    Hold,
    /// Moves to one pose and stays there.
    PointToPoint(PointToPoint),
    /// Oscillates about the start pose.
    Sinusoid(Sinusoid),
    /// Moves from pose to pose along straight lines and single-axis rotations, and stops at each.
    Waypoints(#[cfg_attr(feature = "schema", schemars(extend("minItems" = 1)))] Vec<Waypoint>),
    /// Moves to one pose as fast as its limits allow, from any state of motion.
    Goal(OnlineGoal),
    /// Follows lines, arcs, circles and splines with rounded corners.
    Path(#[cfg_attr(feature = "schema", schemars(with = "PathReference"))] TimedReference),
    /// Follows a recorded path.
    Recorded(RecordedPath),
    /// Follows streamed targets.
    Streamed(StreamedReference),
}

/// A minimum-jerk motion to one pose.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PointToPoint {
    /// Goal position.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "the start position")))]
    pub position: Option<PositionGoal>,
    /// Goal orientation.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "the start orientation")))]
    pub orientation: Option<OrientationGoal>,
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
pub struct Waypoint {
    /// Time of arrival, s after the start.
    pub time_s: Positive,
    /// Position of the waypoint.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the previous waypoint")))]
    pub position: Option<PositionGoal>,
    /// Orientation of the waypoint.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the previous waypoint")))]
    pub orientation: Option<OrientationGoal>,
}

/// Sums of sines along and about the task's axes, added to the start pose. The three rotations are the
/// components of one rotation vector.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Sinusoid {
    /// Sines along the first task axis.
    pub x: Vec<LinearWave>,
    /// Sines along the second task axis.
    pub y: Vec<LinearWave>,
    /// Sines along the third task axis.
    pub z: Vec<LinearWave>,
    /// Sines about the first task axis.
    pub rx: Vec<AngularWave>,
    /// Sines about the second task axis.
    pub ry: Vec<AngularWave>,
    /// Sines about the third task axis.
    pub rz: Vec<AngularWave>,
    /// Duration over which the sines are faded in by the minimum-jerk ramp, s.
    pub ramp_s: Positive,
}

impl Default for Sinusoid {
    /// No motion: no sines, and the ramp of files.
    fn default() -> Self {
        let (x, y, z, rx, ry, rz) = Default::default();
        Self { x, y, z, rx, ry, rz, ramp_s: default_ramp_s() }
    }
}

impl CartesianReference {
    /// Returns true if the reference contains a rotation. It is false for a recorded path, whose orientations are
    /// recorded with the positions even if the rotation axes are free.
    #[must_use]
    pub fn turns(&self) -> bool {
        match self {
            Self::Hold | Self::Recorded(_) | Self::Streamed(_) => false,
            Self::PointToPoint(p) => p.orientation.is_some(),
            Self::Sinusoid(s) => !(s.rx.is_empty() && s.ry.is_empty() && s.rz.is_empty()),
            Self::Waypoints(list) => list.iter().any(|w| w.orientation.is_some()),
            Self::Goal(goal) => goal.orientation.is_some(),
            Self::Path(path) => path.turns(),
        }
    }
}

/// Trajectory of a [`CartesianReference`].
#[derive(Clone, Debug)]
pub struct Trajectory {
    /// Task axes in the world at the start, one per column.
    axes: Matrix3<f64>,
    /// Target pose at the start.
    from: Placement,
    path: Path,
    joining: Option<Joining>,
}

#[derive(Clone, Debug)]
enum Path {
    Legs { goals: Vec<Goal>, legs: Vec<Leg> },
    Waves { axes: [Vec<Wave>; 6], ramp_s: f64 },
    Online(Box<OnlinePose>),
    Along(Box<PathMotion>),
    Recorded(Box<RecordedMotion>),
}

/// An online goal and the motions to it: a displacement and a rotation vector, in world axes.
#[derive(Clone, Debug)]
struct OnlinePose {
    goal: OnlineGoal,
    line: OnlineVector,
    turn: OnlineVector,
}

/// A goal pose whose offsets are not yet resolved, because the start pose is unknown.
#[derive(Clone, Copy, Debug)]
struct Goal {
    begin_s: f64,
    end_s: f64,
    position: Option<PositionGoal>,
    orientation: Option<OrientationGoal>,
}

/// A straight line (m) and a rotation vector (rad), both in world axes.
#[derive(Clone, Copy, Debug)]
struct Leg {
    begin_s: f64,
    end_s: f64,
    from: Placement,
    line: Vector3<f64>,
    turn: Vector3<f64>,
}

impl Trajectory {
    /// Creates the trajectory. It stays at the world's origin until [`start`](Self::start), and at its start if the
    /// reference is not valid.
    #[must_use]
    pub fn new(reference: &CartesianReference) -> Self {
        let goals = |goals: Vec<Goal>| Path::Legs { legs: Vec::with_capacity(goals.len()), goals };
        let path = match reference {
            // The task itself follows a streamed reference; without a target it holds.
            CartesianReference::Hold | CartesianReference::Streamed(_) => goals(Vec::new()),
            CartesianReference::PointToPoint(p) => goals(vec![Goal {
                begin_s: p.start_s.get(),
                end_s: p.start_s.get() + p.duration_s.get(),
                position: p.position,
                orientation: p.orientation,
            }]),
            CartesianReference::Waypoints(list) => {
                let begins = std::iter::once(0.0).chain(list.iter().map(|w| w.time_s.get()));
                goals(
                    (begins.zip(list))
                        .map(|(begin_s, w)| Goal {
                            begin_s,
                            end_s: w.time_s.get(),
                            position: w.position,
                            orientation: w.orientation,
                        })
                        .collect(),
                )
            }
            CartesianReference::Sinusoid(s) => Path::Waves {
                axes: [
                    s.x.iter().map(Wave::from).collect(),
                    s.y.iter().map(Wave::from).collect(),
                    s.z.iter().map(Wave::from).collect(),
                    s.rx.iter().map(Wave::from).collect(),
                    s.ry.iter().map(Wave::from).collect(),
                    s.rz.iter().map(Wave::from).collect(),
                ],
                ramp_s: s.ramp_s.get(),
            },
            CartesianReference::Goal(goal) => {
                let rest = OnlineVector::rest();
                Path::Online(Box::new(OnlinePose { goal: goal.clone(), line: rest, turn: rest }))
            }
            CartesianReference::Path(path) => {
                let motion = PathMotion::new(path, "path");
                motion.map_or_else(|_| goals(Vec::new()), |motion| Path::Along(Box::new(motion)))
            }
            CartesianReference::Recorded(path) => {
                let motion = RecordedMotion::new(path);
                motion.map_or_else(|| goals(Vec::new()), |motion| Path::Recorded(Box::new(motion)))
            }
        };
        Self { axes: Matrix3::identity(), from: Placement::identity(), path, joining: None }
    }

    /// Starts now: time 0 of [`at`](Self::at) is this instant. Allocates nothing, so that a task can change during a
    /// run.
    ///
    /// `home` is the frame's pose at the start of the run, the base of the goals' offsets; `from` is the current
    /// target; `axes` are the task axes, one per column. All are in world coordinates. At the start of a run, `from` is
    /// at rest at `home`.
    pub fn start(&mut self, home: &Placement, from: &Target, axes: &Matrix3<f64>) {
        self.axes = *axes;
        self.from = from.placement;
        self.joining = None;
        match &mut self.path {
            Path::Legs { goals, legs } => {
                legs.clear();
                let mut from = from.placement;
                for goal in goals {
                    let to = Placement {
                        translation: position(goal.position.as_ref(), axes, home, &from),
                        rotation: rotation(goal.orientation.as_ref(), axes, home, &from),
                    };
                    legs.push(Leg {
                        begin_s: goal.begin_s,
                        end_s: goal.end_s,
                        from,
                        line: to.translation - from.translation,
                        turn: orientation::log(&(to.rotation * from.rotation.transpose())),
                    });
                    from = to;
                }
            }
            Path::Waves { .. } => {}
            Path::Online(online) => online.start(home, from, axes),
            Path::Along(motion) => motion.start(&from.placement, axes),
            Path::Recorded(motion) => motion.start(&from.placement, axes),
        }
    }

    /// Blends from the target `from` into the reference, starting `time_s` (s) after the start: within [`BLEND_S`] and
    /// without a jump in velocity or acceleration. Allocates nothing.
    pub fn join(&mut self, time_s: f64, from: &Target) {
        self.joining = Some(Joining::new(time_s, BLEND_S, from, &self.reference_at(time_s)));
    }

    /// Target at `time_s` (s) after the start.
    #[must_use]
    pub fn at(&self, time_s: f64) -> Target {
        self.blended(&self.reference_at(time_s), time_s)
    }

    /// Returns the target for the value of the reference at `time_s` (s) after the start.
    pub(crate) fn blended(&self, reference: &Target, time_s: f64) -> Target {
        match &self.joining {
            Some(joining) => joining.blended(reference, time_s),
            None => *reference,
        }
    }

    /// Reference at `time_s` (s) after the start, without blending.
    #[must_use]
    pub fn reference_at(&self, time_s: f64) -> Target {
        match &self.path {
            Path::Legs { legs, .. } => match legs.iter().rev().find(|leg| leg.begin_s <= time_s) {
                None => Target::at_rest(self.from),
                Some(leg) => leg.at(time_s),
            },
            Path::Waves { axes, ramp_s } => self.swing(axes, *ramp_s, time_s),
            Path::Online(online) => moved(&self.from, online.line.at(time_s), online.turn.at(time_s)),
            Path::Along(motion) => motion.at(time_s),
            Path::Recorded(motion) => motion.at(time_s),
        }
    }

    /// Place on a path at `time_s` (s) after the start; `None` for other references.
    #[must_use]
    pub fn place_at(&self, time_s: f64) -> Option<PathPlace> {
        match &self.path {
            Path::Along(motion) => Some(motion.place_at(time_s)),
            _ => None,
        }
    }

    fn swing(&self, axes: &[Vec<Wave>; 6], ramp_s: f64, time_s: f64) -> Target {
        let ramp = minimum_jerk(time_s, ramp_s);
        let mut offset = [[Vector3::zeros(); 3]; 2];
        for (axis, waves) in axes.iter().enumerate() {
            let faded = product(ramp, wave::sum(waves, time_s));
            for (derivative, value) in offset[axis / 3].iter_mut().zip(faded) {
                derivative[axis % 3] = value;
            }
        }
        let [line, turn] = offset.map(|derivatives| derivatives.map(|v| self.axes * v));
        moved(&self.from, line, turn)
    }
}

impl OnlinePose {
    fn start(&mut self, home: &Placement, from: &Target, axes: &Matrix3<f64>) {
        let Target { placement, velocity, acceleration } = from;
        self.line = match &self.goal.position {
            None => OnlineVector::back(&velocity.linear, &acceleration.linear),
            Some((goal, limits)) => {
                let way = position(Some(goal), axes, home, placement) - placement.translation;
                OnlineVector::new(&velocity.linear, &acceleration.linear, &way, limits)
            }
        };
        // At zero, the derivatives of a rotation vector equal the angular velocity and acceleration.
        self.turn = match &self.goal.orientation {
            None => OnlineVector::back(&velocity.angular, &acceleration.angular),
            Some((goal, limits)) => {
                let to = rotation(Some(goal), axes, home, placement);
                let way = orientation::log(&(to * placement.rotation.transpose()));
                OnlineVector::new(&velocity.angular, &acceleration.angular, &way, limits)
            }
        };
    }
}

impl Leg {
    fn at(&self, time_s: f64) -> Target {
        let s = minimum_jerk(time_s - self.begin_s, self.end_s - self.begin_s);
        moved(&self.from, s.map(|s| self.line * s), s.map(|s| self.turn * s))
    }
}

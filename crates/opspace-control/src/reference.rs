//! References of a Cartesian task: where the frame should be, how fast, and with which acceleration.
//!
//! Every reference begins, at time 0, at the pose at which the controller is started.

use crate::orientation::{self, rotation_vector_rates};
use crate::quantity::{NonNegative, Positive, exactly};
use crate::ramp::{minimum_jerk, product};
use crate::wave::{self, AngularWave, LinearWave, Wave};
use nalgebra::{Matrix3, Vector3};
use opspace_model::{Motion, Placement};
use schemars::JsonSchema;
use serde::Deserialize;

/// Where a Cartesian task should lead its frame.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum CartesianReference {
    /// Stays at the start pose.
    Hold,
    /// Goes to one pose and stays there.
    PointToPoint(PointToPoint),
    /// Swings about the start pose.
    Sinusoid(Sinusoid),
    /// Goes from pose to pose, in straight lines and plain turns, and stops at each.
    Waypoints(Vec<Waypoint>),
}

/// A minimum-jerk motion to one pose.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PointToPoint {
    /// Where to; the start position if absent.
    #[serde(default)]
    pub position: Option<PositionGoal>,
    /// Which way up; the start orientation if absent.
    #[serde(default)]
    pub orientation: Option<OrientationGoal>,
    /// How long the motion takes, s.
    pub duration_s: Positive,
    /// When it sets out, s after the start; 0 if absent.
    #[serde(default)]
    pub start_s: NonNegative,
}

/// A pose to be at, reached with minimum jerk from the one before.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Waypoint {
    /// When to be there, s after the start.
    pub time_s: Positive,
    /// Where; that of the waypoint before if absent.
    #[serde(default)]
    pub position: Option<PositionGoal>,
    /// Which way up; that of the waypoint before if absent.
    #[serde(default)]
    pub orientation: Option<OrientationGoal>,
}

/// A position to reach.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, JsonSchema)]
pub enum PositionGoal {
    /// In the world, m.
    #[serde(rename = "absolute_m")]
    Absolute(#[serde(deserialize_with = "exactly")] [f64; 3]),
    /// From the start position, along the task's axes, m.
    #[serde(rename = "offset_m")]
    Offset(#[serde(deserialize_with = "exactly")] [f64; 3]),
}

/// An orientation to reach, as roll, pitch and yaw about fixed axes, in that order.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, JsonSchema)]
pub enum OrientationGoal {
    /// Against the world, rad.
    #[serde(rename = "absolute_rpy_rad")]
    Absolute(#[serde(deserialize_with = "exactly")] [f64; 3]),
    /// From the start orientation, about the task's axes, rad.
    #[serde(rename = "offset_rpy_rad")]
    Offset(#[serde(deserialize_with = "exactly")] [f64; 3]),
}

/// Sums of sines along and about the task's axes, added to the start pose. The three rotations are the
/// components of one rotation vector.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sinusoid {
    /// Along the first task axis.
    #[serde(default)]
    pub x: Vec<LinearWave>,
    /// Along the second task axis.
    #[serde(default)]
    pub y: Vec<LinearWave>,
    /// Along the third task axis.
    #[serde(default)]
    pub z: Vec<LinearWave>,
    /// About the first task axis.
    #[serde(default)]
    pub rx: Vec<AngularWave>,
    /// About the second task axis.
    #[serde(default)]
    pub ry: Vec<AngularWave>,
    /// About the third task axis.
    #[serde(default)]
    pub rz: Vec<AngularWave>,
    /// For how long the sines are faded in by the minimum-jerk ramp, s; 1 if absent.
    #[serde(default = "default_ramp_s")]
    pub ramp_s: Positive,
}

/// How long sinusoids are faded in where the file doesn't say, s.
#[must_use]
pub(crate) fn default_ramp_s() -> Positive {
    Positive::literal(1.0)
}

/// Where a frame should be and how it should move, in world axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Pose in the world.
    pub placement: Placement,
    /// Of the frame's origin (m/s) and of the frame (rad/s).
    pub velocity: Motion,
    /// The rate of change of `velocity` (m/s², rad/s²).
    pub acceleration: Motion,
}

impl Target {
    /// At rest at a pose.
    #[must_use]
    pub fn at_rest(placement: Placement) -> Self {
        Self { placement, velocity: Motion::zero(), acceleration: Motion::zero() }
    }
}

impl CartesianReference {
    /// Whether it turns the frame.
    #[must_use]
    pub fn turns(&self) -> bool {
        match self {
            Self::Hold => false,
            Self::PointToPoint(p) => p.orientation.is_some(),
            Self::Sinusoid(s) => !(s.rx.is_empty() && s.ry.is_empty() && s.rz.is_empty()),
            Self::Waypoints(list) => list.iter().any(|w| w.orientation.is_some()),
        }
    }
}

/// A [`CartesianReference`] ready to be followed.
#[derive(Clone, Debug)]
pub struct Trajectory {
    /// The task's axes in the world.
    axes: Matrix3<f64>,
    start: Placement,
    path: Path,
}

#[derive(Clone, Debug)]
enum Path {
    Legs { goals: Vec<Goal>, legs: Vec<Leg> },
    Waves { axes: [Vec<Wave>; 6], ramp_s: f64 },
}

/// A pose to reach, its offsets still from a start that isn't known.
#[derive(Clone, Copy, Debug)]
struct Goal {
    begin_s: f64,
    end_s: f64,
    position: Option<PositionGoal>,
    orientation: Option<OrientationGoal>,
}

/// A straight line and a turn about one axis, both in world axes.
#[derive(Clone, Copy, Debug)]
struct Leg {
    begin_s: f64,
    end_s: f64,
    from: Placement,
    line: Vector3<f64>,
    turn: Vector3<f64>,
}

impl Trajectory {
    /// `axes` are the task's, in the world. It stays at the world's origin until [`start`](Self::start).
    #[must_use]
    pub fn new(reference: &CartesianReference, axes: Matrix3<f64>) -> Self {
        let goals = |goals: Vec<Goal>| Path::Legs { legs: Vec::with_capacity(goals.len()), goals };
        let path = match reference {
            CartesianReference::Hold => goals(Vec::new()),
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
        };
        Self { axes, start: Placement::identity(), path }
    }

    /// Begins at `placement` (world).
    pub fn start(&mut self, placement: Placement) {
        self.start = placement;
        let Path::Legs { goals, legs } = &mut self.path else {
            return;
        };
        legs.clear();
        let mut from = placement;
        for goal in goals {
            let to = goal.resolve(&self.axes, &placement, &from);
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

    /// The target at `time_s` after the start.
    #[must_use]
    pub fn at(&self, time_s: f64) -> Target {
        match &self.path {
            Path::Legs { legs, .. } => match legs.iter().rev().find(|leg| leg.begin_s <= time_s) {
                None => Target::at_rest(self.start),
                Some(leg) => leg.at(time_s),
            },
            Path::Waves { axes, ramp_s } => self.swing(axes, *ramp_s, time_s),
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
        moved(&self.start, line, turn)
    }
}

impl Goal {
    fn resolve(&self, axes: &Matrix3<f64>, start: &Placement, before: &Placement) -> Placement {
        Placement {
            translation: match self.position {
                None => before.translation,
                Some(PositionGoal::Absolute(p)) => Vector3::from(p),
                Some(PositionGoal::Offset(p)) => start.translation + axes * Vector3::from(p),
            },
            rotation: match self.orientation {
                None => before.rotation,
                Some(OrientationGoal::Absolute(rpy)) => orientation::from_rpy(rpy),
                Some(OrientationGoal::Offset(rpy)) => {
                    axes * orientation::from_rpy(rpy) * axes.transpose() * start.rotation
                }
            },
        }
    }
}

impl Leg {
    fn at(&self, time_s: f64) -> Target {
        let s = minimum_jerk(time_s - self.begin_s, self.end_s - self.begin_s);
        moved(&self.from, s.map(|s| self.line * s), s.map(|s| self.turn * s))
    }
}

/// `from`, displaced by a line (m) and a rotation vector (rad) with their first two derivatives, in world
/// axes.
fn moved(from: &Placement, line: [Vector3<f64>; 3], turn: [Vector3<f64>; 3]) -> Target {
    let (omega, alpha) = rotation_vector_rates(&turn[0], &turn[1], &turn[2]);
    Target {
        placement: Placement {
            rotation: orientation::exp(&turn[0]) * from.rotation,
            translation: from.translation + line[0],
        },
        velocity: Motion { linear: line[1], angular: omega },
        acceleration: Motion { linear: line[2], angular: alpha },
    }
}

//! Paths of lines, arcs, circles and splines with rounded corners, in the form of the task file.
//!
//! ```text
//! x_d = p(s(t))        p: segments and corners        s(t): as fast as the limits allow, from rest to rest
//! ```

use crate::references::path_bounds::PathBounds;
use opspace_backend::quantity::{Count, NonNegative, Positive, exactly};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// A path of segments that is followed as fast as its limits allow. It begins and ends at rest.
///
/// A corner between two segments is rounded by a curve of continuous curvature, which deviates from the segments only
/// within `corner_radius_m` of the corner; with a radius of 0 the path stops in the corner. Speed and acceleration of the
/// position never exceed their limits; the jerk along the path neither. Curves are slow enough that their jerk at
/// constant speed keeps the limit too.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PathReference {
    /// Segments, each from the end of the previous one.
    #[cfg_attr(feature = "schema", schemars(extend("minItems" = 1)))]
    pub segments: Vec<PathSegment>,
    /// Start of a path in world coordinates, to which the frame first moves on a straight line. If absent, the path
    /// begins where the frame is, at [0, 0, 0]: then positions are offsets from there along the task's axes, and
    /// orientations are rotations from the orientation there, about the task's axes.
    pub start: Option<PathStart>,
    /// Highest speed, m/s.
    pub speed_m_per_s: Positive,
    /// Highest acceleration, of the direction too, m/s².
    pub acceleration_m_per_s2: Positive,
    /// Highest jerk along the path, and in curves at constant speed, m/s³.
    pub jerk_m_per_s3: Positive,
    /// Distance from a corner within which the path is rounded, m, for segments without one. With 0 the path stops in
    /// corners. At most half of the lines, arcs and spline intervals beside the corner.
    #[serde(default)]
    pub corner_radius_m: NonNegative,
    /// Highest angular speed, rad/s; required for a path with orientations.
    pub angular_speed_rad_per_s: Option<Positive>,
    /// Highest angular acceleration, rad/s²; required for a path with orientations.
    pub angular_acceleration_rad_per_s2: Option<Positive>,
    /// False (the default) for a constant speed in each segment and in each rounded corner, the highest one for its
    /// sharpest place, where the length of the segment permits it; true for the highest speed at each place that the path's
    /// limits, the joints' limits of speed, torque and acceleration and the speed limits of the task permit.
    #[serde(default)]
    pub time_optimal: bool,
    /// Number of times that the segments are passed. The last segment is followed by the first one.
    #[serde(default = "once")]
    pub repeat: Count,
    /// Bounds of the joints on the motion along the path, if it is time-optimal; not in a file, but computed for a robot.
    #[serde(skip)]
    pub bounds: PathBounds,
}

const fn once() -> Count {
    Count::literal(1)
}

/// Start of a path in world coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PathStart {
    /// Position, m.
    pub absolute_m: Triple,
    /// Orientation: roll, pitch and yaw about fixed axes, rad; required if segments have orientations. If absent, the
    /// frame keeps its orientation.
    pub absolute_rpy_rad: Option<Triple>,
}

/// Three numbers: a point, a direction, or roll, pitch and yaw.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(transparent)]
pub struct Triple(#[serde(deserialize_with = "exactly")] pub [f64; 3]);

/// A segment of a path.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum PathSegment {
    /// Straight line.
    Line(PathLine),
    /// Arc of a circle through three points.
    Arc(PathArc),
    /// Circle about an axis, or a part of one.
    Circle(PathCircle),
    /// Natural cubic spline through points, with continuous curvature.
    Spline(PathSpline),
}

/// A straight line.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PathLine {
    /// End, m.
    pub to_m: Triple,
    /// Orientation at the end: roll, pitch and yaw about fixed axes, rad. The frame rotates about one axis, by a
    /// minimum-jerk ramp over the length of the segment.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that at the start of the segment")))]
    pub rpy_rad: Option<Triple>,
    /// Distance from the end within which the corner to the next segment is rounded, m.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the path")))]
    pub corner_radius_m: Option<NonNegative>,
    /// Highest speed in this segment, m/s; at most that of the path.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the path")))]
    pub speed_m_per_s: Option<Positive>,
}

/// An arc of a circle through its start and two points.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PathArc {
    /// Point on the arc, m.
    pub via_m: Triple,
    /// End, m.
    pub to_m: Triple,
    /// Orientation at the end: roll, pitch and yaw about fixed axes, rad. The frame rotates about one axis, by a
    /// minimum-jerk ramp over the length of the segment.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that at the start of the segment")))]
    pub rpy_rad: Option<Triple>,
    /// Distance from the end within which the corner to the next segment is rounded, m.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the path")))]
    pub corner_radius_m: Option<NonNegative>,
    /// Highest speed in this segment, m/s; at most that of the path.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the path")))]
    pub speed_m_per_s: Option<Positive>,
}

/// A circle from its start, or a part of one.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PathCircle {
    /// Point on the axis, m.
    pub centre_m: Triple,
    /// Direction of the axis, about which the path turns right-handed; of any length.
    pub normal: Triple,
    /// Number of turns, also a fraction; left-handed if negative.
    pub turns: f64,
    /// Orientation at the end: roll, pitch and yaw about fixed axes, rad. The frame rotates about one axis, by a
    /// minimum-jerk ramp over the length of the segment.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that at the start of the segment")))]
    pub rpy_rad: Option<Triple>,
    /// Distance from the end within which the corner to the next segment is rounded, m.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the path")))]
    pub corner_radius_m: Option<NonNegative>,
    /// Highest speed in this segment, m/s; at most that of the path.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the path")))]
    pub speed_m_per_s: Option<Positive>,
}

/// A natural cubic spline from its start.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PathSpline {
    /// Points after the start, m.
    pub through_m: Vec<Triple>,
    /// Orientation at the end: roll, pitch and yaw about fixed axes, rad. The frame rotates about one axis, by a
    /// minimum-jerk ramp over the length of the segment.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that at the start of the segment")))]
    pub rpy_rad: Option<Triple>,
    /// Distance from the end within which the corner to the next segment is rounded, m.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the path")))]
    pub corner_radius_m: Option<NonNegative>,
    /// Highest speed in this segment, m/s; at most that of the path.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the path")))]
    pub speed_m_per_s: Option<Positive>,
}

impl PathReference {
    /// Returns true if the orientation changes along the path, or to its start.
    #[must_use]
    pub fn turns(&self) -> bool {
        self.start.is_some_and(|start| start.absolute_rpy_rad.is_some())
            || self.segments.iter().any(|segment| segment.rpy_rad().is_some())
    }
}

impl PathSegment {
    /// Orientation at the end.
    pub(crate) fn rpy_rad(&self) -> Option<[f64; 3]> {
        let rpy = match self {
            Self::Line(segment) => segment.rpy_rad,
            Self::Arc(segment) => segment.rpy_rad,
            Self::Circle(segment) => segment.rpy_rad,
            Self::Spline(segment) => segment.rpy_rad,
        };
        rpy.map(|rpy| rpy.0)
    }

    /// Radius of the corner after the segment, m.
    pub(crate) fn corner_radius_m(&self) -> Option<f64> {
        let radius = match self {
            Self::Line(segment) => segment.corner_radius_m,
            Self::Arc(segment) => segment.corner_radius_m,
            Self::Circle(segment) => segment.corner_radius_m,
            Self::Spline(segment) => segment.corner_radius_m,
        };
        radius.map(NonNegative::get)
    }

    /// Highest speed in the segment, m/s.
    pub(crate) fn speed_m_per_s(&self) -> Option<f64> {
        let speed = match self {
            Self::Line(segment) => segment.speed_m_per_s,
            Self::Arc(segment) => segment.speed_m_per_s,
            Self::Circle(segment) => segment.speed_m_per_s,
            Self::Spline(segment) => segment.speed_m_per_s,
        };
        speed.map(Positive::get)
    }
}

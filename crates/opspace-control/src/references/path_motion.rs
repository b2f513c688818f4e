//! Motion along a path: its geometry, its timing law, and the approach of a path in world coordinates.
//!
//! ```text
//! x_d = p(s(t))        ẋ_d = p′ ṡ        ẍ_d = p″ ṡ² + p′ s̈
//! ```
//!
//! p is the shape (`path_shape.rs`), s(t) the timing law (`timing_law.rs`).

use crate::error::ControlError;
use crate::orientation;
use crate::references::blend::{laid, moved};
use crate::references::path_bounds::PathPlace;
use crate::references::path_reference::PathReference;
use crate::references::path_shape::PathShape;
use crate::references::ramp::minimum_jerk;
use crate::references::target::Target;
use crate::references::timing_law::{PathLimits, TimingLaw};
use nalgebra::{Matrix3, Vector3};
use opspace_backend::quantity::Positive;
use opspace_model::Placement;
use serde::Deserialize;
use std::fmt;
use std::ops::Deref;
use std::sync::{Arc, OnceLock};

/// Length, duration and largest values of a path, without the approach of a path in world coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathSummary {
    /// Length, m.
    pub length_m: f64,
    /// Duration, s.
    pub duration_s: f64,
    /// Largest speed, m/s.
    pub speed_m_per_s: f64,
    /// Largest acceleration, m/s².
    pub acceleration_m_per_s2: f64,
    /// Largest angular speed, rad/s.
    pub angular_speed_rad_per_s: f64,
}

/// Longest duration of a path, s.
const MAX_DURATION_S: f64 = 1e6;

/// Instants at which a path is evaluated for its summary.
const INSTANTS: u32 = 2000;

/// A path, and the motion along it once it is computed. Clones share both, so that all controllers and checks of a task
/// compute the motion once. The path cannot be changed; a changed one is a new `TimedReference`.
#[derive(Clone, Deserialize)]
#[serde(from = "PathReference")]
pub struct TimedReference(Arc<(PathReference, OnceLock<Arc<TimedPath>>)>);

impl From<PathReference> for TimedReference {
    fn from(path: PathReference) -> Self {
        Self(Arc::new((path, OnceLock::new())))
    }
}

impl Deref for TimedReference {
    type Target = PathReference;

    fn deref(&self) -> &PathReference {
        &self.0.0
    }
}

impl PartialEq for TimedReference {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0) || **self == **other
    }
}

impl fmt::Debug for TimedReference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        (**self).fmt(f)
    }
}

impl TimedReference {
    /// Geometry and timing law; computed by the first call.
    fn timed(&self, key: &str) -> Result<&Arc<TimedPath>, ControlError> {
        let (path, timed) = &*self.0;
        if let Some(timed) = timed.get() {
            return Ok(timed);
        }
        let computed = Arc::new(TimedPath::compute(path, key)?);
        Ok(timed.get_or_init(|| computed))
    }

    /// Summarises the motion along the path.
    ///
    /// # Errors
    /// A path that is not valid, with the key in the reference.
    pub fn summary(&self) -> Result<PathSummary, ControlError> {
        let motion = PathMotion::new(self, "path")?;
        let duration_s = motion.path.law.duration_s();
        let mut summary = PathSummary {
            length_m: motion.path.shape.length_m(),
            duration_s,
            speed_m_per_s: 0.0,
            acceleration_m_per_s2: 0.0,
            angular_speed_rad_per_s: 0.0,
        };
        for instant in 0..=INSTANTS {
            let at = motion.along(duration_s * f64::from(instant) / f64::from(INSTANTS));
            let [speed, acceleration] = [at.velocity, at.acceleration].map(|motion| motion.linear.norm());
            summary.speed_m_per_s = summary.speed_m_per_s.max(speed);
            summary.acceleration_m_per_s2 = summary.acceleration_m_per_s2.max(acceleration);
            let angular = at.velocity.angular.norm();
            summary.angular_speed_rad_per_s = summary.angular_speed_rad_per_s.max(angular);
        }
        Ok(summary)
    }
}

/// Minimum-jerk motion to the start of a path in world coordinates.
#[derive(Clone, Copy, Debug)]
struct Approach {
    duration_s: f64,
    from: Placement,
    line: Vector3<f64>,
    turn: Vector3<f64>,
}

/// Geometry and timing law of a path.
#[derive(Debug)]
struct TimedPath {
    shape: PathShape,
    law: TimingLaw,
}

impl TimedPath {
    fn compute(path: &PathReference, key: &str) -> Result<Self, ControlError> {
        let shape = PathShape::new(path, key)?;
        let limits =
            PathLimits { acceleration: path.acceleration_m_per_s2.get(), jerk: path.jerk_m_per_s3.get() };
        let mut sections = shape.sections(path);
        let mut begin_m = 0.0;
        for section in &mut sections {
            let length_m: f64 = section.iter().map(|span| span.length).sum();
            *section = path.bounds.applied(std::mem::take(section), begin_m);
            begin_m += length_m;
        }
        let law = TimingLaw::new(&sections, &limits);
        if !law.duration_s().is_finite() || law.duration_s() > MAX_DURATION_S {
            let message = format!(
                "the path takes {} s: expected at most {MAX_DURATION_S} s; check its limits and points",
                law.duration_s()
            );
            return Err(ControlError::value(key, message));
        }
        Ok(Self { shape, law })
    }
}

/// Motion along a path. All of it is computed before the run, except its displacement to the start pose.
#[derive(Clone, Debug)]
pub(crate) struct PathMotion {
    path: Arc<TimedPath>,
    /// True if the path begins at the start pose.
    relative: bool,
    /// True if the path has orientations in world coordinates.
    oriented: bool,
    /// Highest speed, acceleration and jerk, and highest angular speed and acceleration.
    limits: [f64; 5],
    approach: Approach,
    /// Factor by which the approach lasts longer than its own limits require.
    approach_factor: f64,
    /// Rigid displacement of the path: see [`laid`].
    displacement: (Matrix3<f64>, Vector3<f64>, Matrix3<f64>),
}

impl PathMotion {
    /// Creates the motion; `key` is the path of the reference in the file.
    pub(crate) fn new(path: &TimedReference, key: &str) -> Result<Self, ControlError> {
        let timed = Arc::clone(path.timed(key)?);
        let angular = |limit: Option<Positive>| limit.map_or(f64::INFINITY, Positive::get);
        let still = Vector3::zeros();
        let approach = Approach { duration_s: 0.0, from: Placement::identity(), line: still, turn: still };
        Ok(Self {
            path: timed,
            relative: path.start.is_none(),
            oriented: path.start.is_some_and(|start| start.absolute_rpy_rad.is_some()),
            limits: [
                path.speed_m_per_s.get(),
                path.acceleration_m_per_s2.get(),
                path.jerk_m_per_s3.get(),
                angular(path.angular_speed_rad_per_s),
                angular(path.angular_acceleration_rad_per_s2),
            ],
            approach,
            approach_factor: path.bounds.approach_factor,
            displacement: (Matrix3::identity(), still, Matrix3::identity()),
        })
    }

    /// Starts at the pose `from`, with the task axes `axes`. Allocates nothing.
    pub(crate) fn start(&mut self, from: &Placement, axes: &Matrix3<f64>) {
        let world = Matrix3::identity();
        self.displacement = if self.relative {
            (*axes, from.translation, axes.tr_mul(&from.rotation))
        } else if self.oriented {
            (world, Vector3::zeros(), world)
        } else {
            (world, Vector3::zeros(), from.rotation)
        };
        let first = self.along(0.0).placement;
        let line = first.translation - from.translation;
        let turn = orientation::log(&(first.rotation * from.rotation.transpose()));
        let duration_s = if self.relative { 0.0 } else { self.approach_s(line.norm(), turn.norm()) };
        self.approach = Approach { duration_s, from: *from, line, turn };
    }

    /// Duration of the minimum-jerk motion over a distance (m) and an angle (rad) that keeps the limits. Its largest
    /// speed is 15/8, its largest acceleration 10/√3 and its largest jerk 60 of distance and duration 1.
    fn approach_s(&self, distance: f64, angle: f64) -> f64 {
        let [speed, acceleration, jerk, angular_speed, angular_acceleration] = self.limits;
        let peak = 10.0 / 3.0_f64.sqrt();
        let linear = (1.875 * distance / speed)
            .max((peak * distance / acceleration).sqrt())
            .max((60.0 * distance / jerk).cbrt());
        let angular = (1.875 * angle / angular_speed).max((peak * angle / angular_acceleration).sqrt());
        self.approach_factor * linear.max(angular)
    }

    /// Target at `time_s` (s) after the start.
    pub(crate) fn at(&self, time_s: f64) -> Target {
        let Approach { duration_s, from, line, turn } = &self.approach;
        if time_s >= *duration_s {
            return self.along(time_s - duration_s);
        }
        let w = minimum_jerk(time_s, *duration_s);
        moved(from, w.map(|w| line * w), w.map(|w| turn * w))
    }

    /// Place at `time_s` (s) after the start.
    pub(crate) fn place_at(&self, time_s: f64) -> PathPlace {
        if time_s < self.approach.duration_s {
            return PathPlace::Approach;
        }
        let [s_m, speed_m_per_s, acceleration_m_per_s2] = self.path.law.at(time_s - self.approach.duration_s);
        PathPlace::Along {
            s_m,
            speed_m_per_s,
            acceleration_m_per_s2,
            section: self.path.shape.section_at(s_m),
        }
    }

    /// Target at `time_s` (s) after the beginning of the path.
    fn along(&self, time_s: f64) -> Target {
        let (turn, shift, own) = &self.displacement;
        laid(&self.path.shape.at(self.path.law.at(time_s)), turn, shift, own)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compared: the motions of a path, of its clone, and of an equal path that was read again.
    #[test]
    fn clones_share_the_motion() {
        let text = "segments = [{ line = { to_m = [0.1, 0.0, 0.0] } }]\nspeed_m_per_s = 0.2\n\
                    acceleration_m_per_s2 = 1.0\njerk_m_per_s3 = 20.0\n";
        let read = || toml::from_str::<TimedReference>(text).expect("a path");
        let path = read();
        let again = read();
        let motion = |path: &TimedReference| Arc::clone(path.timed("path").expect("a motion"));
        let first = motion(&path);
        assert!(Arc::ptr_eq(&first, &motion(&path.clone())));
        assert!(path == again && !Arc::ptr_eq(&first, &motion(&again)));
    }
}

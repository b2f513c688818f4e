//! Bounds on the motion along a path that do not follow from the path itself, but from the robot: the limits of speed,
//! acceleration and torque of its joints.
//!
//! ```text
//! ṡ ≤ speed        gaining max(s̈, 0) + braking max(−s̈, 0) + squared_speed ṡ² ≤ 1        in each part of the path
//! ```
//!
//! They are computed before a run from the joint motion along the path.

use crate::references::acceleration_bound::AccelerationBound;
use crate::references::timing_law::Span;

/// Least number of spans of a section with bounds on accelerations: the acceleration is constant in each of them.
const LEAST_SPANS: f64 = 32.0;

/// Place of a path reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PathPlace {
    /// On the way to the start of a path in world coordinates.
    Approach,
    /// On the path.
    Along {
        /// Arc length from the start of the path, m.
        s_m: f64,
        /// Speed along the path, m/s.
        speed_m_per_s: f64,
        /// Acceleration along the path, m/s².
        acceleration_m_per_s2: f64,
        /// Number of the section of the path, from 0: a section ends where the path stops.
        section: usize,
    },
}

/// Bounds on the motion along a path.
#[derive(Clone, Debug, PartialEq)]
pub struct PathBounds {
    /// Factor by which the motion to the start of a path in world coordinates lasts longer, at least 1.
    pub approach_factor: f64,
    /// Parts of the path, in order. The first begins at the start of the path, each other one at the end of the previous
    /// one; what follows the last one has no bound.
    pub parts: Vec<PartBounds>,
}

/// Bounds on the motion in a part of a path.
#[derive(Clone, Debug, PartialEq)]
pub struct PartBounds {
    /// End of the part: arc length from the start of the path, m.
    pub end_m: f64,
    /// Highest speed, m/s; infinite if there is no bound.
    pub speed_m_per_s: f64,
    /// Bounds on acceleration and speed together: the same ones in the same order in each part of a path, for example one
    /// for each direction of each joint's torque.
    pub acceleration: Vec<AccelerationBound>,
}

impl Default for PathBounds {
    fn default() -> Self {
        Self { approach_factor: 1.0, parts: Vec::new() }
    }
}

impl PathBounds {
    /// Returns the spans of a section that begins at `begin_m`, divided where the bounds change.
    pub(crate) fn applied(&self, spans: Vec<Span>, begin_m: f64) -> Vec<Span> {
        let mut bounded = Vec::with_capacity(spans.len());
        let longest_m = spans.iter().map(|span| span.length).sum::<f64>() / LEAST_SPANS;
        let mut at_m = begin_m;
        for span in spans {
            let end_m = at_m + span.length;
            let first = self.parts.partition_point(|part| part.end_m <= at_m);
            for part in &self.parts[first..] {
                if part.end_m >= end_m {
                    break;
                }
                bounded.extend(part.applied(&span, part.end_m - at_m, longest_m));
                at_m = part.end_m;
            }
            let last = self.parts.get(self.parts.partition_point(|part| part.end_m < end_m));
            match last {
                Some(part) => bounded.extend(part.applied(&span, end_m - at_m, longest_m)),
                None => bounded.push(Span { length: end_m - at_m, ..span }),
            }
            at_m = end_m;
        }
        bounded
    }
}

impl PartBounds {
    /// Returns a span of another length (m) with these bounds too, divided into spans of at most `longest_m` if accelerations
    /// are bounded.
    fn applied(&self, span: &Span, length: f64, longest_m: f64) -> Vec<Span> {
        let count = if self.acceleration.is_empty() {
            1.0
        } else {
            (length / longest_m).ceil().clamp(1.0, LEAST_SPANS)
        };
        let mut bounds = span.bounds.clone();
        AccelerationBound::merge(&mut bounds, &self.acceleration);
        let speed = span.speed.min(self.speed_m_per_s);
        vec![Span { length: length / count, speed, bounds, ..*span }; count as usize]
    }
}

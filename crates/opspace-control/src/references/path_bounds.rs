//! Bounds on the speed along a path that do not follow from the path itself, but from the robot: its joints' speed
//! limits. They are computed before a run from the joint motion along the path.

use crate::references::timing_law::Span;

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
    },
}

/// Bounds on the motion along a path.
#[derive(Clone, Debug, PartialEq)]
pub struct PathBounds {
    /// Factor by which the motion to the start of a path in world coordinates lasts longer, at least 1.
    pub approach_factor: f64,
    /// Parts of the path, in order. The first begins at the start of the path, each other one at the end of the previous
    /// one; what follows the last one has no bound.
    pub parts: Vec<SpeedBound>,
}

/// Bound on the speed in a part of a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedBound {
    /// End of the part: arc length from the start of the path, m.
    pub end_m: f64,
    /// Highest speed, m/s; infinite if there is no bound.
    pub speed_m_per_s: f64,
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
        let mut at_m = begin_m;
        for span in spans {
            let end_m = at_m + span.length;
            let first = self.parts.partition_point(|part| part.end_m <= at_m);
            for part in &self.parts[first..] {
                if part.end_m >= end_m {
                    break;
                }
                bounded.push(Span {
                    length: part.end_m - at_m,
                    speed: span.speed.min(part.speed_m_per_s),
                    ..span
                });
                at_m = part.end_m;
            }
            let last = self.parts.get(self.parts.partition_point(|part| part.end_m < end_m));
            let speed = last.map_or(span.speed, |part| span.speed.min(part.speed_m_per_s));
            bounded.push(Span { length: end_m - at_m, speed, ..span });
            at_m = end_m;
        }
        bounded
    }
}

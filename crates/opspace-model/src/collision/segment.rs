//! Closest points of two line segments.

use nalgebra::Vector3;

/// Sine of the angle between two segments below which they count as parallel. The closest points are then not unique,
/// and the distance is constant along the common part up to this fraction of a length.
pub(crate) const PARALLEL: f64 = 1e-12;

/// Sine of the angle between two segments below which rounding errors may make the closest points of the lines seem to
/// lie on both segments. The ends are then examined too.
const NEARLY_PARALLEL: f64 = 1e-5;

/// Squared sine of the angle between two segments above which the textbook's formula loses at most four digits.
const WELL_CONDITIONED: f64 = 1e-4;

/// Line segment from `start` to `start + along`, m. Its length may be zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Segment {
    pub start: Vector3<f64>,
    pub along: Vector3<f64>,
    /// Squared length, m².
    square: f64,
}

impl Segment {
    #[inline]
    pub fn new(start: Vector3<f64>, along: Vector3<f64>) -> Self {
        Self { start, along, square: along.norm_squared() }
    }

    /// Returns the point at a fraction (0 to 1) of the length.
    #[inline]
    pub fn point(&self, fraction: f64) -> Vector3<f64> {
        self.start + self.along * fraction
    }

    /// Returns the fraction of the point that is closest to `point`; 0 if the segment has no length.
    #[inline]
    fn closest_fraction(&self, point: &Vector3<f64>) -> f64 {
        if self.square > 0.0 {
            ((point - self.start).dot(&self.along) / self.square).clamp(0.0, 1.0)
        } else {
            0.0
        }
    }

    /// Returns the distance of `point` from the segment, m.
    #[inline]
    pub fn distance(&self, point: &Vector3<f64>) -> f64 {
        (self.point(self.closest_fraction(point)) - point).norm()
    }
}

/// Returns the fractions of the lengths of `a` and `b` at which they are closest. A fraction is exactly 0 or 1 if the
/// closest point is an end. If the closest points of parallel segments are not unique, those in the middle of the
/// common part are returned.
///
/// This is the method of Ericson, *Real-Time Collision Detection*, 5.1.9, if the segments are not nearly parallel.
#[inline]
pub(crate) fn closest_fractions(a: &Segment, b: &Segment) -> [f64; 2] {
    let between = a.start - b.start;
    let mixed = a.along.dot(&b.along);
    let determinant = a.square * b.square - mixed * mixed;
    if determinant > WELL_CONDITIONED * a.square * b.square {
        let (from_a, from_b) = (a.along.dot(&between), b.along.dot(&between));
        let on_a = ((mixed * from_b - from_a * b.square) / determinant).clamp(0.0, 1.0);
        let on_b = mixed * on_a + from_b;
        return if on_b < 0.0 {
            [(-from_a / a.square).clamp(0.0, 1.0), 0.0]
        } else if on_b > b.square {
            [((mixed - from_a) / a.square).clamp(0.0, 1.0), 1.0]
        } else {
            [on_a, on_b / b.square]
        };
    }
    if a.square == 0.0 {
        return [0.0, b.closest_fraction(&a.start)];
    }
    if b.square == 0.0 {
        return [a.closest_fraction(&b.start), 0.0];
    }
    closest_if_nearly_parallel(a, b)
}

/// Returns the same fractions for segments at a small angle, at which the determinant of the textbook has few digits or
/// none.
///
/// The squared distance is a convex quadratic function of both fractions. Its minimum is that of the lines if this lies
/// on both segments, otherwise it is at an end of one of them. The minimum of the lines is computed from the cross
/// product of the directions, which is accurate at angles down to 1e-12 rad.
fn closest_if_nearly_parallel(a: &Segment, b: &Segment) -> [f64; 2] {
    let cross = a.along.cross(&b.along);
    let square_sine = cross.norm_squared();
    let square_lengths = a.square * b.square;
    if square_sine > PARALLEL * PARALLEL * square_lengths {
        let lines = closest_on_lines(a, b, &cross, square_sine);
        return match lines {
            Some(fractions) if square_sine > NEARLY_PARALLEL * NEARLY_PARALLEL * square_lengths => fractions,
            _ => closest_at_ends(a, b, lines),
        };
    }
    middle_of_common_part(a, b).unwrap_or_else(|| closest_at_ends(a, b, None))
}

/// Returns the fractions at which the lines are closest, if both are strictly within the segments.
fn closest_on_lines(a: &Segment, b: &Segment, cross: &Vector3<f64>, square_sine: f64) -> Option<[f64; 2]> {
    let inside = |fraction: &f64| *fraction > 0.0 && *fraction < 1.0;
    let on_a = (b.start - a.start).cross(&b.along).dot(cross) / square_sine;
    if !inside(&on_a) {
        return None;
    }
    // The projection on b is accurate at every angle.
    let on_b = (a.point(on_a) - b.start).dot(&b.along) / b.square;
    inside(&on_b).then_some([on_a, on_b])
}

/// Returns the closest of four candidates, each with an end of one segment, and of `other`.
fn closest_at_ends(a: &Segment, b: &Segment, other: Option<[f64; 2]>) -> [f64; 2] {
    let ends = [
        [0.0, b.closest_fraction(&a.start)],
        [1.0, b.closest_fraction(&(a.start + a.along))],
        [a.closest_fraction(&b.start), 0.0],
        [a.closest_fraction(&(b.start + b.along)), 1.0],
    ];
    let mut best = (f64::INFINITY, [0.0; 2]);
    for fractions in ends.into_iter().chain(other) {
        let square = (a.point(fractions[0]) - b.point(fractions[1])).norm_squared();
        if square < best.0 {
            best = (square, fractions);
        }
    }
    best.1
}

/// Returns the middle of the part of two parallel segments in which they are side by side; `None` if there is none.
fn middle_of_common_part(a: &Segment, b: &Segment) -> Option<[f64; 2]> {
    let first = (b.start - a.start).dot(&a.along) / a.square;
    let last = first + b.along.dot(&a.along) / a.square;
    let (lower, upper) = (first.min(last).max(0.0), first.max(last).min(1.0));
    let middle = 0.5 * (lower + upper);
    (lower <= upper).then(|| [middle, b.closest_fraction(&a.point(middle))])
}

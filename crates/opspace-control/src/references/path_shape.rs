//! Geometry of a path: position and orientation as functions of arc length, and the bounds on its motion.
//!
//! ```text
//! x = p(s)        R = exp(w(s) φ) R₀
//! |p″ ṡ² + p′ s̈| ≤ a        |p‴| ṡ³ ≤ j        w′ |φ| ṡ ≤ ω_max        |w″ ṡ² + w′ s̈| |φ| ≤ α_max
//! ```
//!
//! s is the arc length, w the [minimum-jerk ramp](crate::references::ramp) of a rotation by φ over the length of a segment.

use crate::error::ControlError;
use crate::orientation;
use crate::references::blend::moved;
use crate::references::cubic_spline::natural_spline;
use crate::references::curve::Curve;
use crate::references::path_reference::{PathReference, PathSegment};
use crate::references::ramp::minimum_jerk;
use crate::references::target::Target;
use crate::references::timing_law::Span;
use nalgebra::{Matrix3, Vector3};
use opspace_backend::quantity::Positive;
use opspace_model::Placement;
use std::f64::consts::TAU;

/// Largest number of segments, with repetitions.
const MAX_SEGMENTS: usize = 10_000;

/// Largest number of points of splines, with repetitions: the motion through as many is computed within some seconds.
const MAX_POINTS: usize = 2000;

/// Cosine of the angle between the directions before and after a corner, below which the path turns back.
const TURNS_BACK: f64 = -0.95;

/// Spans of a full circle and of a rotation along a line or an arc.
const SPANS: f64 = 48.0;

/// Largest number of spans of a piece.
const MAX_SPANS: f64 = 4096.0;

/// Points in a span at which its bounds are evaluated, besides its beginning, and the margin for places between them.
const POINTS: u32 = 4;
const MARGIN: f64 = 1.002;

/// Geometry of a path.
#[derive(Clone, Debug)]
pub(crate) struct PathShape {
    pieces: Vec<Piece>,
    /// Rotations, each from the end of the previous one; empty if the orientation is constant.
    turns: Vec<Turn>,
    /// Orientation at the start.
    rotation: Matrix3<f64>,
}

/// Part of a curve.
#[derive(Clone, Debug)]
struct Piece {
    curve: Curve,
    /// Beginning of the part in the curve, m.
    from_m: f64,
    length_m: f64,
    /// Beginning of the part in the path, m.
    begin_m: f64,
    /// Highest speed, m/s.
    speed: f64,
    /// Number that is the same for all pieces of a segment or corner.
    group: usize,
    /// True if the path stops at the end of the part.
    stops: bool,
}

/// Rotation about one axis, by a minimum-jerk ramp over arc length.
#[derive(Clone, Debug)]
struct Turn {
    begin_m: f64,
    length_m: f64,
    from: Matrix3<f64>,
    vector: Vector3<f64>,
}

impl PathShape {
    /// Creates the shape; `key` is the path of the reference in the file.
    pub(crate) fn new(path: &PathReference, key: &str) -> Result<Self, ControlError> {
        let given = path.segments.len();
        let count = given * path.repeat.get() as usize;
        if count == 0 || count > MAX_SEGMENTS {
            let message =
                format!("expected 1 to {MAX_SEGMENTS} segments with their repetitions, got {count}");
            return Err(ControlError::value(&format!("{key}.segments"), message));
        }
        let points: usize = path.segments.iter().map(points_of).sum::<usize>() * path.repeat.get() as usize;
        if points > MAX_POINTS {
            let message = format!(
                "{points} points of splines with their repetitions; at most {MAX_POINTS} are accepted: leave out points \
                 between which the path hardly bends, or use `reference.recorded` for a recorded motion"
            );
            return Err(ControlError::value(&format!("{key}.segments"), message));
        }
        let key_of = |number: usize| format!("{key}.segments.{}", number % given);
        let mut at = path.start.map_or(Vector3::zeros(), |start| Vector3::from(start.absolute_m.0));
        let mut segments: Vec<Vec<Piece>> = Vec::with_capacity(count);
        for number in 0..count {
            let segment = &path.segments[number % given];
            let curves =
                curves(segment, at).map_err(|message| ControlError::value(&key_of(number), message))?;
            at = curves.last().map_or(at, |curve| curve.at(curve.length_m())[0]);
            let own = segment.speed_m_per_s().unwrap_or(f64::INFINITY);
            let speed = own.min(path.speed_m_per_s.get());
            segments.push(curves.into_iter().map(|curve| Piece::new(curve, speed, 2 * number)).collect());
        }
        let mut shape = Self { pieces: Vec::new(), turns: Vec::new(), rotation: Matrix3::identity() };
        let mut ends_m = Vec::with_capacity(count);
        for number in 0..count {
            let own = path.segments[number % given].corner_radius_m();
            let radius_m = own.unwrap_or_else(|| path.corner_radius_m.get());
            let (before, after) = segments.split_at_mut(number + 1);
            let (before, after) = (&mut before[number], after.first_mut());
            let corner = after
                .filter(|_| radius_m > 0.0)
                .map(|after| corner(before, after, radius_m))
                .transpose()
                .map_err(|message| ControlError::value(&key_of(number), message))?;
            shape.extend(std::mem::take(before));
            let end_m = shape.length_m();
            match corner {
                Some(corner) => {
                    ends_m.push(end_m + 0.5 * corner.length_m);
                    shape.extend(vec![Piece { group: 2 * number + 1, ..corner }]);
                }
                None => {
                    ends_m.push(end_m);
                    if let Some(piece) = shape.pieces.last_mut() {
                        piece.stops = true;
                    }
                }
            }
        }
        shape
            .turn(path, &ends_m)
            .map_err(|(inner, message)| ControlError::value(&format!("{key}.{inner}"), message))?;
        Ok(shape)
    }

    /// Appends the pieces that have a length.
    fn extend(&mut self, pieces: Vec<Piece>) {
        for piece in pieces.into_iter().filter(|piece| piece.length_m > 0.0) {
            let begin_m = self.length_m();
            self.pieces.push(Piece { begin_m, ..piece });
        }
    }

    /// Sets the orientations at the ends of the segments.
    fn turn(&mut self, path: &PathReference, ends_m: &[f64]) -> Result<(), (&'static str, String)> {
        if let Some(rpy) = path.start.and_then(|start| start.absolute_rpy_rad) {
            self.rotation = orientation::from_rpy(rpy.0);
        }
        if !path.turns() {
            return Ok(());
        }
        if path.start.is_some_and(|start| start.absolute_rpy_rad.is_none()) {
            let message = "segments have orientations in the world: give `absolute_rpy_rad` of the start";
            return Err(("start", message.to_owned()));
        }
        if path.angular_speed_rad_per_s.is_none() || path.angular_acceleration_rad_per_s2.is_none() {
            let message = "the path has orientations: give `angular_speed_rad_per_s` and \
                           `angular_acceleration_rad_per_s2`";
            return Err(("segments", message.to_owned()));
        }
        let (mut begin_m, mut from) = (0.0, self.rotation);
        for (segment, end_m) in path.segments.iter().cycle().zip(ends_m) {
            let to = segment.rpy_rad().map_or(from, orientation::from_rpy);
            let vector = orientation::log(&(to * from.transpose()));
            self.turns.push(Turn { begin_m, length_m: end_m - begin_m, from, vector });
            (begin_m, from) = (*end_m, to);
        }
        Ok(())
    }

    /// Length of the path, m.
    pub(crate) fn length_m(&self) -> f64 {
        self.pieces.last().map_or(0.0, |piece| piece.begin_m + piece.length_m)
    }

    /// Pose, velocity and acceleration for the arc length `s` (m), ṡ and s̈.
    pub(crate) fn at(&self, [s, ds, dds]: [f64; 3]) -> Target {
        let k = self.pieces.partition_point(|piece| piece.begin_m <= s).saturating_sub(1);
        let piece = &self.pieces[k];
        let [position, direction, bend] = piece.curve.at(piece.from_m + (s - piece.begin_m));
        let line = [position, direction * ds, bend * (ds * ds) + direction * dds];
        let next = self.turns.partition_point(|turn| turn.begin_m <= s);
        let (rotation, turn) = match self.turns[..next].last() {
            None => (self.rotation, [Vector3::zeros(); 3]),
            Some(turn) => {
                let [w, dw, ddw] = minimum_jerk(s - turn.begin_m, turn.length_m);
                (turn.from, [w, dw * ds, ddw * ds * ds + dw * dds].map(|w| turn.vector * w))
            }
        };
        moved(&Placement { rotation, translation: Vector3::zeros() }, line, turn)
    }

    /// Number of the section at an arc length, m: sections are the parts from stop to stop.
    pub(crate) fn section_at(&self, s: f64) -> usize {
        let before = self.pieces.iter().take_while(|piece| piece.begin_m + piece.length_m <= s);
        before.filter(|piece| piece.stops).count()
    }

    /// Bounds on the motion along the path, from stop to stop.
    pub(crate) fn sections(&self, path: &PathReference) -> Vec<Vec<Span>> {
        let acceleration = path.acceleration_m_per_s2.get();
        let mut sections = Vec::new();
        let mut section: Vec<Span> = Vec::new();
        let mut pieces = self.pieces.iter().peekable();
        let mut of_group = 0;
        while let Some(piece) = pieces.next() {
            section.extend(self.spans(piece, path));
            let group_ends = pieces.peek().is_none_or(|next| next.group != piece.group);
            if group_ends && !path.time_optimal {
                let spans = &mut section[of_group..];
                let speed = spans.iter().map(|span| span.cap(acceleration)).fold(f64::INFINITY, f64::min);
                spans.iter_mut().for_each(|span| span.speed = speed);
            }
            if group_ends {
                of_group = section.len();
            }
            if piece.stops {
                sections.push(std::mem::take(&mut section));
                of_group = 0;
            }
        }
        sections
    }

    /// Bounds of a piece.
    fn spans(&self, piece: &Piece, path: &PathReference) -> Vec<Span> {
        let end_m = piece.begin_m + piece.length_m;
        let touches = |turn: &&Turn| turn.begin_m < end_m && turn.begin_m + turn.length_m > piece.begin_m;
        let turning = self.turns.iter().filter(touches).any(|turn| turn.vector.norm() > 0.0);
        if piece.curve.is_straight() && !turning {
            return vec![Span { speed: piece.speed, ..Span::free(piece.length_m) }];
        }
        let whole = piece.curve.length_m();
        let knots: Vec<f64> = match &piece.curve {
            Curve::Polynomial(polynomial) => polynomial.knots_m().collect(),
            Curve::Arc { radius_m, .. } if !turning => even(whole, whole / (TAU * radius_m)),
            _ => even(whole, 1.0),
        };
        let end_m = piece.from_m + piece.length_m;
        let inner = knots.into_iter().filter(|knot| *knot > piece.from_m && *knot < end_m);
        let bounds: Vec<f64> = std::iter::once(piece.from_m).chain(inner).chain([end_m]).collect();
        bounds
            .windows(2)
            .map(|pair| self.span(piece, pair[0] - piece.from_m, pair[1] - pair[0], path))
            .collect()
    }

    /// Bounds of a part of a piece, which begins at `along_m` and has the length `length` (m).
    fn span(&self, piece: &Piece, along_m: f64, length: f64, path: &PathReference) -> Span {
        let [mut curvature, mut third] = [0.0_f64; 2];
        let mut rates = [0.0_f64; 2];
        for point in 0..=POINTS {
            let s = along_m + length * f64::from(point) / f64::from(POINTS);
            curvature = curvature.max(piece.curve.at(piece.from_m + s)[2].norm());
            third = third.max(piece.curve.third_derivative(piece.from_m + s).norm());
            let s = piece.begin_m + s;
            let next = self.turns.partition_point(|turn| turn.begin_m <= s);
            if let Some(turn) = self.turns[..next].last() {
                let [_, dw, ddw] = minimum_jerk(s - turn.begin_m, turn.length_m);
                rates = [rates[0].max(dw * turn.vector.norm()), rates[1].max(ddw.abs() * turn.vector.norm())];
            }
        }
        let limit = |limit: Option<Positive>| limit.map_or(f64::INFINITY, Positive::get);
        let angular = limit(path.angular_speed_rad_per_s) / (MARGIN * rates[0]);
        let jerk = (path.jerk_m_per_s3.get() / (MARGIN * third)).cbrt();
        let angular_acceleration = limit(path.angular_acceleration_rad_per_s2);
        Span {
            speed: piece.speed.min(angular).min(jerk),
            curvature: MARGIN * curvature,
            cone: rates.map(|rate| MARGIN * rate / angular_acceleration),
            ..Span::free(length)
        }
    }
}

impl Piece {
    fn new(curve: Curve, speed: f64, group: usize) -> Self {
        let length_m = curve.length_m();
        Self { curve, from_m: 0.0, length_m, begin_m: 0.0, speed, group, stops: false }
    }

    /// Position and its first two derivatives at the beginning and at the end of the part.
    fn ends(&self) -> [[Vector3<f64>; 3]; 2] {
        [0.0, self.length_m].map(|s| self.curve.at(self.from_m + s))
    }
}

/// Number of points of a segment if it is a spline.
fn points_of(segment: &PathSegment) -> usize {
    match segment {
        PathSegment::Spline(spline) => spline.through_m.len(),
        _ => 0,
    }
}

/// Equal parts of a length, [`SPANS`] for each of a number of turns.
fn even(length_m: f64, turns: f64) -> Vec<f64> {
    let count = (SPANS * turns).clamp(8.0, MAX_SPANS).ceil();
    (0..count as u32).map(|k| length_m * f64::from(k) / count).collect()
}

/// Curves of a segment that begins at `from`.
fn curves(segment: &PathSegment, from: Vector3<f64>) -> Result<Vec<Curve>, String> {
    let one = |curve: Option<Curve>, message: &str| match curve {
        Some(curve) => Ok(vec![curve]),
        None => Err(message.to_owned()),
    };
    match segment {
        PathSegment::Line(line) => {
            one(Curve::line(from, Vector3::from(line.to_m.0)), "the line has no length: `to_m` is its start")
        }
        PathSegment::Arc(arc) => one(
            Curve::arc(from, Vector3::from(arc.via_m.0), Vector3::from(arc.to_m.0)),
            "the start, `via_m` and `to_m` are on one line: an arc needs three points that are not",
        ),
        PathSegment::Circle(circle) => one(
            Curve::circle(
                from,
                Vector3::from(circle.centre_m.0),
                Vector3::from(circle.normal.0),
                circle.turns,
            ),
            "no circle: its start must not be on its axis, and neither `normal` nor `turns` may be zero",
        ),
        PathSegment::Spline(spline) => {
            let rest = spline.through_m.iter().map(|point| Vector3::from(point.0));
            spline_curves(&std::iter::once(from).chain(rest).collect::<Vec<_>>())
        }
    }
}

/// Intervals of the natural cubic spline through points, whose parameter is the sum of their distances.
fn spline_curves(points: &[Vector3<f64>]) -> Result<Vec<Curve>, String> {
    if points.len() < 2 {
        return Err("`through_m` is empty: expected at least one point".to_owned());
    }
    let mut knots = vec![0.0];
    for (index, pair) in points.windows(2).enumerate() {
        let distance = (pair[1] - pair[0]).norm();
        if !distance.is_finite() || distance < 1e-9 {
            return Err(format!("point {index} of `through_m` is the same as the one before it"));
        }
        knots.push(knots[index] + distance);
    }
    let axes = [0, 1, 2]
        .map(|axis| natural_spline(&knots, &points.iter().map(|point| point[axis]).collect::<Vec<_>>()));
    let interval = |k: usize| {
        let scale = knots[k + 1] - knots[k];
        Curve::polynomial([0, 1, 2].map(|axis: usize| axes[axis][k].stretched(scale)))
    };
    Ok((0..points.len() - 1).map(interval).collect())
}

/// Rounds the corner between two segments, and shortens both.
fn corner(before: &mut [Piece], after: &mut [Piece], radius_m: f64) -> Result<Piece, String> {
    let (Some(first), Some(second)) = (before.last_mut(), after.first_mut()) else {
        return Err("a segment without curves".to_owned());
    };
    let most_m = 0.5 * first.curve.length_m().min(second.curve.length_m());
    if radius_m > most_m * (1.0 + 1e-9) {
        return Err(format!(
            "the radius of the corner at the end, {radius_m} m, is larger than half of the line, arc or spline interval \
             beside it: expected at most {most_m} m"
        ));
    }
    let [[_, to, _], [_, from, _]] = [second.ends()[0], first.ends()[1]];
    if from.dot(&to) < TURNS_BACK {
        return Err(
            "the path turns back at the end, which no corner can round: set `corner_radius_m` = 0 there, so that it \
             stops, or move a point"
                .to_owned(),
        );
    }
    first.length_m = (first.length_m - radius_m).max(0.0);
    second.from_m = radius_m;
    second.length_m -= radius_m;
    let curve = Curve::corner(&first.ends()[1], &second.ends()[0], radius_m);
    Ok(Piece::new(curve, first.speed.min(second.speed), 0))
}

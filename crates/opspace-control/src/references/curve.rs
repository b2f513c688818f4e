//! Curves in space whose parameter is arc length: lines, arcs of circles, and polynomials.
//!
//! ```text
//! p(s), p′(s), p″(s), p‴(s)        |p′| = 1
//! ```
//!
//! A polynomial p(u) is evaluated as p(u(s)), where u(s) is a table of quintics with the exact arc length, slope and
//! curvature at its knots. Its derivatives are those of this composition, so that they belong to its positions to the
//! last digits; its speed |dp/ds| is 1 within 1e-5.

use crate::references::ramp::Quintic;
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Intervals of the table of arc length of a polynomial.
const INTERVALS: usize = 64;

/// Nodes and weights of Gauss and Legendre on [-1, 1], for polynomials of degree 9.
const GAUSS: [(f64, f64); 5] = [
    (-0.906_179_845_938_664, 0.236_926_885_056_189_1),
    (-0.538_469_310_105_683_1, 0.478_628_670_499_366_5),
    (0.0, 0.568_888_888_888_888_9),
    (0.538_469_310_105_683_1, 0.478_628_670_499_366_5),
    (0.906_179_845_938_664, 0.236_926_885_056_189_1),
];

/// A curve; positions in m.
#[derive(Clone, Debug)]
pub(crate) enum Curve {
    /// Straight line; the direction has length 1.
    Line { from: Vector3<f64>, direction: Vector3<f64>, length_m: f64 },
    /// Arc of a circle from `centre + radius · radial` in the direction `tangent`; both have length 1.
    Arc { centre: Vector3<f64>, radial: Vector3<f64>, tangent: Vector3<f64>, radius_m: f64, length_m: f64 },
    /// Polynomial of degree 5.
    Polynomial(Box<Polynomial>),
}

impl Curve {
    /// Returns the line between two points; `None` if they coincide.
    pub(crate) fn line(from: Vector3<f64>, to: Vector3<f64>) -> Option<Self> {
        let length_m = (to - from).norm();
        let direction = (to - from) / length_m;
        is_length(length_m).then_some(Self::Line { from, direction, length_m })
    }

    /// Returns the arc from a point through another to a third; `None` if they are on one line or coincide.
    pub(crate) fn arc(from: Vector3<f64>, via: Vector3<f64>, to: Vector3<f64>) -> Option<Self> {
        let (b, c) = (via - from, to - from);
        let normal = b.cross(&c);
        // The sine of the angle at `from`; two points that coincide give zero or NaN.
        let sine = normal.norm() / (b.norm() * c.norm());
        if !(sine > 1e-6 && is_length((to - via).norm())) {
            return None;
        }
        let centre = from
            + (c.norm_squared() * normal.cross(&b) + b.norm_squared() * c.cross(&normal))
                / (2.0 * normal.norm_squared());
        let (radial, axis) = (from - centre, normal.normalize());
        let tangent = axis.cross(&radial);
        let end = to - centre;
        let angle = end.dot(&tangent).atan2(end.dot(&radial)).rem_euclid(TAU);
        Some(Self::round(centre, radial, tangent, angle))
    }

    /// Returns the arc about `normal` through `from` for a number of turns (left-handed if negative); `None` if the
    /// point is on the axis, or if normal or turns are zero.
    pub(crate) fn circle(
        from: Vector3<f64>,
        centre: Vector3<f64>,
        normal: Vector3<f64>,
        turns: f64,
    ) -> Option<Self> {
        let axis = normal.try_normalize(1e-9)? * turns.signum();
        // The centre of the circle is the point of the axis that is nearest to `from`.
        let centre = centre + axis * axis.dot(&(from - centre));
        let radial = from - centre;
        let angle = TAU * turns.abs();
        (is_length(radial.norm()) && angle > 1e-9)
            .then(|| Self::round(centre, radial, axis.cross(&radial), angle))
    }

    fn round(centre: Vector3<f64>, radial: Vector3<f64>, tangent: Vector3<f64>, angle: f64) -> Self {
        let radius_m = radial.norm();
        let (radial, tangent) = (radial / radius_m, tangent.normalize());
        Self::Arc { centre, radial, tangent, radius_m, length_m: radius_m * angle }
    }

    /// Returns the rounded corner between two curves, with continuous direction and curvature. `from` and `to` are the
    /// points, unit tangents and curvature vectors where it leaves the first curve and joins the second one, and
    /// `zone_m` is the distance of both from the corner.
    ///
    /// The lengths of the end tangents are free; they are those of the smallest largest curvature.
    pub(crate) fn corner(from: &[Vector3<f64>; 3], to: &[Vector3<f64>; 3], zone_m: f64) -> Self {
        let candidate = |scale: f64| {
            let state = |end: &[Vector3<f64>; 3], axis: usize| {
                [end[0][axis], end[1][axis] * scale, end[2][axis] * scale * scale]
            };
            [0, 1, 2].map(|axis| Quintic::between(state(from, axis), state(to, axis), 1.0))
        };
        let candidates = (0..=40).map(|k| candidate(zone_m * (0.8 + 0.05 * f64::from(k))));
        let sharpness =
            |axes: &[Quintic; 3]| (0..=32).map(|k| curvature(axes, f64::from(k) / 32.0)).fold(0.0, f64::max);
        let best = candidates.map(|axes| (sharpness(&axes), axes)).min_by(|a, b| a.0.total_cmp(&b.0));
        Self::polynomial(best.map_or_else(|| candidate(2.0 * zone_m), |(_, axes)| axes))
    }

    /// Returns the curve of three polynomials in u from 0 to 1, one per axis.
    pub(crate) fn polynomial(axes: [Quintic; 3]) -> Self {
        Self::Polynomial(Box::new(Polynomial::new(axes)))
    }

    /// Length, m.
    pub(crate) fn length_m(&self) -> f64 {
        match self {
            Self::Line { length_m, .. } | Self::Arc { length_m, .. } => *length_m,
            Self::Polynomial(polynomial) => polynomial.length_m,
        }
    }

    /// Returns true for a line.
    pub(crate) fn is_straight(&self) -> bool {
        matches!(self, Self::Line { .. })
    }

    /// Position (m) and its first two derivatives by arc length at `s` (m).
    pub(crate) fn at(&self, s: f64) -> [Vector3<f64>; 3] {
        match self {
            Self::Line { from, direction, .. } => [from + direction * s, *direction, Vector3::zeros()],
            Self::Arc { centre, radial, tangent, radius_m, .. } => {
                let (sin, cos) = (s / radius_m).sin_cos();
                let out = radial * cos + tangent * sin;
                [centre + out * *radius_m, tangent * cos - radial * sin, out / -radius_m]
            }
            Self::Polynomial(polynomial) => polynomial.at(s),
        }
    }

    /// Third derivative of the position by arc length at `s` (m), 1/m².
    pub(crate) fn third_derivative(&self, s: f64) -> Vector3<f64> {
        match self {
            Self::Line { .. } => Vector3::zeros(),
            Self::Arc { radius_m, .. } => self.at(s)[1] / -(radius_m * radius_m),
            Self::Polynomial(polynomial) => polynomial.third_derivative(s),
        }
    }
}

/// Returns true for a length that is not zero by rounding; false for NaN.
fn is_length(length_m: f64) -> bool {
    length_m > 1e-9
}

/// Curvature of a polynomial at u; infinite where it stops.
fn curvature(axes: &[Quintic; 3], u: f64) -> f64 {
    let [_, slope, bend] = vectors(axes, u);
    let speed = slope.norm();
    let curvature = slope.cross(&bend).norm() / (speed * speed * speed);
    if curvature.is_finite() { curvature } else { f64::INFINITY }
}

/// Position and its first two derivatives by u.
fn vectors(axes: &[Quintic; 3], u: f64) -> [Vector3<f64>; 3] {
    let [x, y, z] = [0, 1, 2].map(|axis| axes[axis].at(u));
    [0, 1, 2].map(|k| Vector3::new(x[k], y[k], z[k]))
}

/// Polynomial curve with a table of its arc length.
#[derive(Clone, Debug)]
pub(crate) struct Polynomial {
    axes: [Quintic; 3],
    /// Arc length at the beginning of each interval, m.
    begins_m: [f64; INTERVALS],
    /// u as a function of the arc length since the beginning of each interval.
    parameters: [Quintic; INTERVALS],
    length_m: f64,
}

impl Polynomial {
    fn new(axes: [Quintic; 3]) -> Self {
        let step = 1.0 / INTERVALS as f64;
        // u, du/ds = 1/|p'| and d²u/ds² = −(p'·p'')/|p'|⁴.
        let knot = |k: usize| {
            let u = k as f64 * step;
            let [_, slope, bend] = vectors(&axes, u);
            let squared = slope.norm_squared();
            [u, 1.0 / squared.sqrt(), -slope.dot(&bend) / (squared * squared)]
        };
        let mut begins_m = [0.0; INTERVALS];
        let mut parameters = [Quintic::default(); INTERVALS];
        let mut length_m = 0.0;
        for k in 0..INTERVALS {
            let speed = |node: f64| vectors(&axes, (k as f64 + 0.5 + 0.5 * node) * step)[1].norm();
            let way = GAUSS.iter().map(|(node, weight)| weight * speed(*node)).sum::<f64>() * 0.5 * step;
            begins_m[k] = length_m;
            parameters[k] = Quintic::between(knot(k), knot(k + 1), way);
            length_m += way;
        }
        Self { axes, begins_m, parameters, length_m }
    }

    /// Arc lengths at which the intervals of the table begin, and their middles, m: close where the curve is sharp.
    pub(crate) fn knots_m(&self) -> impl Iterator<Item = f64> {
        let ends = self.begins_m[1..].iter().chain([&self.length_m]);
        self.begins_m.iter().zip(ends).flat_map(|(begin, end)| [*begin, 0.5 * (begin + end)])
    }

    /// Interval of the table and the arc length in it.
    fn interval(&self, s: f64) -> (&Quintic, f64) {
        let k = self.begins_m.partition_point(|begin| *begin <= s).saturating_sub(1);
        (&self.parameters[k], s - self.begins_m[k])
    }

    fn at(&self, s: f64) -> [Vector3<f64>; 3] {
        let (parameter, along) = self.interval(s);
        let [u, du, ddu] = parameter.at(along);
        let [position, slope, bend] = vectors(&self.axes, u);
        [position, slope * du, bend * (du * du) + slope * ddu]
    }

    fn third_derivative(&self, s: f64) -> Vector3<f64> {
        let (parameter, along) = self.interval(s);
        let [u, du, ddu] = parameter.at(along);
        let [_, slope, bend] = vectors(&self.axes, u);
        let jerk = Vector3::from(self.axes.map(|axis| axis.jerk(u)));
        jerk * (du * du * du) + bend * (3.0 * du * ddu) + slope * parameter.jerk(along)
    }
}

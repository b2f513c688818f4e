//! Paths of segments. Compared: velocities and accelerations with central differences of positions and velocities; speeds,
//! accelerations and jerks with the limits; the path with its waypoints; durations with closed forms.

use nalgebra::{Matrix3, Rotation3, Vector3};
use opspace_control::{CartesianReference, Target, Trajectory};
use opspace_model::Placement;
use proptest::prelude::*;
use serde::Deserialize;
use std::fmt::Write;

#[derive(Deserialize)]
struct Only {
    reference: CartesianReference,
}

fn start() -> Placement {
    Placement::from_rpy([0.4, -0.7, 1.9], [0.3, -0.2, 0.6])
}

fn axes() -> Matrix3<f64> {
    *Rotation3::from_euler_angles(0.2, 0.5, -0.8).matrix()
}

/// A started path; `text` has its keys.
fn path(text: &str) -> Trajectory {
    let file: Only =
        toml::from_str(&format!("[reference.path]\n{text}")).unwrap_or_else(|e| panic!("{e}: {text}"));
    let mut trajectory = Trajectory::new(&file.reference);
    trajectory.start(&start(), &Target::at_rest(start()), &axes());
    trajectory
}

/// Limits of a motion: speed, acceleration, jerk, angular speed, angular acceleration.
#[derive(Clone, Copy, Debug)]
struct Limits([f64; 5]);

impl Limits {
    fn text(&self) -> String {
        let [v, a, j, w, alpha] = self.0;
        format!(
            "speed_m_per_s = {v:?}\nacceleration_m_per_s2 = {a:?}\njerk_m_per_s3 = {j:?}\n\
             angular_speed_rad_per_s = {w:?}\nangular_acceleration_rad_per_s2 = {alpha:?}\n"
        )
    }
}

fn limits() -> impl Strategy<Value = Limits> {
    (0.05..1.0, 0.3..5.0, 2.0..100.0, 0.3..3.0, 1.0..10.0).prop_map(|(v, a, j, w, alpha)| Limits([v, a, j, w, alpha]))
}

/// Waypoints at least 0.1 m apart, their corner radii as fractions of the largest one, and orientations.
#[derive(Clone, Debug)]
struct Polygon {
    points: Vec<[f64; 3]>,
    fractions: Vec<f64>,
    turns: Vec<Option<[f64; 3]>>,
}

fn polygon() -> impl Strategy<Value = Polygon> {
    let point = prop::array::uniform3(-0.4..0.4);
    let turn = prop::option::of(prop::array::uniform3(-1.0..1.0));
    prop::collection::vec((point, 0.0..1.0, turn), 2..5).prop_filter_map("close points or sharp corners", |list| {
        let points: Vec<[f64; 3]> = list.iter().map(|item| item.0).collect();
        let all: Vec<Vector3<f64>> =
            std::iter::once([0.0; 3]).chain(points.iter().copied()).map(Vector3::from).collect();
        let far = all.windows(2).all(|pair| (pair[1] - pair[0]).norm() > 0.1);
        let wide = all.windows(3).all(|three| {
            let [a, b] = [three[1] - three[0], three[2] - three[1]].map(|line| line.normalize());
            a.dot(&b) > -0.9
        });
        let (fractions, turns) = list.into_iter().map(|(_, fraction, turn)| (fraction, turn)).unzip();
        (far && wide).then_some(Polygon { points, fractions, turns })
    })
}

impl Polygon {
    fn text(&self) -> (String, Vec<f64>) {
        let mut text = String::new();
        let mut radii = Vec::new();
        let length = |k: usize| {
            let from = if k == 0 { [0.0; 3] } else { self.points[k - 1] };
            (Vector3::from(self.points[k]) - Vector3::from(from)).norm()
        };
        for (k, point) in self.points.iter().enumerate() {
            let most = if k + 1 < self.points.len() { 0.5 * length(k).min(length(k + 1)) } else { 0.0 };
            // One corner in ten is a stop.
            let radius = if self.fractions[k] < 0.1 { 0.0 } else { self.fractions[k] * most };
            write!(text, "[[reference.path.segments]]\nline = {{ to_m = {point:?}, corner_radius_m = {radius:?}")
                .expect("text");
            if let Some(turn) = &self.turns[k] {
                write!(text, ", rpy_rad = {turn:?}").expect("text");
            }
            text += " }\n";
            radii.push(radius);
        }
        (text, radii)
    }
}

/// Time at which the reference is at rest for ever, s, by bisection.
fn duration_s(trajectory: &Trajectory) -> f64 {
    let end = trajectory.at(1e6);
    let rests = |time_s: f64| trajectory.at(time_s) == end;
    let (mut low, mut high) = (0.0, 1.0);
    while !rests(high) {
        high *= 2.0;
    }
    while high - low > 1e-9 * high {
        let middle = 0.5 * (low + high);
        if rests(middle) { high = middle } else { low = middle }
    }
    high
}

/// Checks derivatives and limits at `count` instants; returns the duration, s.
fn check(trajectory: &Trajectory, limits: Limits, count: usize) -> Result<f64, TestCaseError> {
    let [v, a, j, w, alpha] = limits.0;
    let lasts_s = duration_s(trajectory);
    let h = 1e-5;
    let vector_jerk = 30.0 * j;
    for k in 0..count {
        let time_s = lasts_s * (k as f64 + 0.37) / count as f64;
        let [before, at, after] = [time_s - h, time_s, time_s + h].map(|time_s| trajectory.at(time_s));
        let difference = |part: fn(&Target) -> Vector3<f64>| (part(&after) - part(&before)) / (2.0 * h);
        let velocity = difference(|target| target.placement.translation);
        prop_assert!((velocity - at.velocity.linear).norm() < 1e-7 * (1.0 + v), "{time_s}: velocity");
        let acceleration = difference(|target| target.velocity.linear);
        let error = (acceleration - at.acceleration.linear).norm();
        prop_assert!(error < h * vector_jerk + 1e-6 * a, "{time_s} s of {lasts_s}: acceleration by {error}");
        let rotation = after.placement.rotation * before.placement.rotation.transpose();
        let omega = opspace_control::orientation::log(&rotation) / (2.0 * h);
        prop_assert!((omega - at.velocity.angular).norm() < 1e-6 * (1.0 + w), "{time_s}: angular velocity");
        let spin = difference(|target| target.velocity.angular);
        prop_assert!((spin - at.acceleration.angular).norm() < 1e-2 * (1.0 + alpha), "{time_s}: angular acceleration");
        let speed = at.velocity.linear.norm();
        prop_assert!(speed < v * (1.0 + 1e-4), "{time_s}: {speed} m/s");
        let size = at.acceleration.linear.norm();
        prop_assert!(size < a * (1.0 + 1e-4), "{time_s}: {size} m/s^2 of {a}");
        prop_assert!(at.velocity.angular.norm() < w * (1.0 + 1e-4), "{time_s}: angular speed");
        prop_assert!(at.acceleration.angular.norm() < alpha * (1.0 + 1e-4), "{time_s}: angular acceleration");
        // Jerk along the path: change of the speed's derivative.
        if speed > 1e-3 {
            let along = |target: &Target| target.acceleration.linear.dot(&target.velocity.linear.normalize());
            let jerk = (along(&after) - along(&before)) / (2.0 * h);
            prop_assert!(jerk.abs() < j * (1.0 + 1e-3) + 1e-3, "{time_s}: {jerk} m/s^3 of {j}");
        }
    }
    Ok(lasts_s)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    /// Compared: derivatives with differences, limits with the motion, the end with the last waypoint, and the distance of
    /// the path from each waypoint with its corner radius.
    #[test]
    fn polygons_keep_their_limits(polygon in polygon(), limits in limits(), time_optimal: bool) {
        let (segments, radii) = polygon.text();
        let trajectory = path(&format!("{}time_optimal = {time_optimal}\n{segments}", limits.text()));
        let lasts_s = check(&trajectory, limits, 300)?;
        let end = trajectory.at(lasts_s);
        let world = |point: &[f64; 3]| start().translation + axes() * Vector3::from(*point);
        prop_assert!((end.placement.translation - world(polygon.points.last().expect("points"))).norm() < 1e-12);
        prop_assert_eq!(end.velocity.linear.norm(), 0.0);
        let count = 4000;
        for (point, radius) in polygon.points.iter().zip(radii) {
            let away = |k: usize| {
                let at = trajectory.at(lasts_s * k as f64 / count as f64);
                (at.placement.translation - world(point)).norm()
            };
            let nearest = (0..=count).map(away).fold(f64::INFINITY, f64::min);
            let step = limits.0[0] * lasts_s / count as f64;
            prop_assert!(nearest <= radius + step, "{nearest} m from {point:?}, whose corner has {radius} m");
        }
    }
}

#[test]
fn zz_debug() {
    let t = std::time::Instant::now();
    let trajectory = path("speed_m_per_s = 0.3\nacceleration_m_per_s2 = 1.0\njerk_m_per_s3 = 20.0\ncorner_radius_m = 0.03\nsegments = [{ line = { to_m = [0.2, 0.0, 0.0] } }, { line = { to_m = [0.2, 0.2, 0.0] } }, { line = { to_m = [0.0, 0.0, 0.0] } }]\n");
    eprintln!("{:?}", t.elapsed());
    let d = duration_s(&trajectory);
    eprintln!("{d}");
    for k in 0..=60 {
        let at = trajectory.at(d * k as f64 / 60.0);
        eprintln!("{:.3} {:?} v {:.4} a {:.4}", d * k as f64 / 60.0, (axes().transpose() * (at.placement.translation - start().translation)).map(|x| (x * 1e4).round() / 1e4).as_slice(), at.velocity.linear.norm(), at.acceleration.linear.norm());
    }
}

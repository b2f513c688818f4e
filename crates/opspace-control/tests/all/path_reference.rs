//! Paths of segments. Compared: velocities and accelerations with central differences of positions and velocities; speeds,
//! accelerations and jerks with the limits; the path with its waypoints; durations with closed forms.

use nalgebra::{Matrix3, Rotation3, Vector3};
use opspace_control::{CartesianReference, Target, TimedReference, Trajectory};
use opspace_model::Placement;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
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

/// Reads a path; `text` has its keys.
fn read(text: &str) -> TimedReference {
    let file: Only =
        toml::from_str(&format!("[reference.path]\n{text}")).unwrap_or_else(|e| panic!("{e}: {text}"));
    match file.reference {
        CartesianReference::Path(path) => path,
        other => panic!("{other:?}"),
    }
}

/// A started path.
fn path(text: &str) -> Trajectory {
    let mut trajectory = Trajectory::new(&CartesianReference::Path(read(text)));
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
    (0.05..1.0, 0.3..5.0, 2.0..100.0, 0.3..3.0, 1.0..10.0)
        .prop_map(|(v, a, j, w, alpha)| Limits([v, a, j, w, alpha]))
}

/// A segment: kind, end, bulge of an arc or spline, fraction of the largest corner radius, orientation.
type Segment = (usize, [f64; 3], [f64; 3], f64, Option<[f64; 3]>);

fn segments() -> impl Strategy<Value = Vec<Segment>> {
    let point = || prop::array::uniform3(-0.4..0.4);
    let turn = prop::option::of(prop::array::uniform3(-1.0..1.0));
    prop::collection::vec((0_usize..4, point(), point(), 0.0..1.0, turn), 1..5)
}

/// Text of the segments, ends and corner radii; `None` if points are close to each other.
fn written(segments: &[Segment]) -> Option<(String, Vec<Vector3<f64>>, Vec<f64>)> {
    let mut from = Vector3::zeros();
    let (mut text, mut ends, mut chords) = (String::new(), Vec::new(), Vec::new());
    let mut shapes = Vec::new();
    for (kind, to, bulge, ..) in segments {
        let to = Vector3::from(*to);
        let via = 0.5 * (from + to) + 0.4 * Vector3::from(*bulge);
        let numbers = |point: &Vector3<f64>| format!("{:?}", point.as_slice());
        let (first, last) = match kind {
            // Lines are as frequent as curves.
            0 | 3 => {
                shapes.push(format!("line = {{ to_m = {}", numbers(&to)));
                (to - from, to - from)
            }
            1 => {
                shapes.push(format!("arc = {{ via_m = {}, to_m = {}", numbers(&via), numbers(&to)));
                (to - from, to - from)
            }
            _ => {
                let through = format!("[{}, {}]", numbers(&via), numbers(&to));
                shapes.push(format!("spline = {{ through_m = {through}"));
                (via - from, to - via)
            }
        };
        chords.push([first.norm(), last.norm()]);
        ends.push(to);
        from = to;
    }
    if chords.iter().flatten().any(|chord| *chord < 0.1) {
        return None;
    }
    let mut radii = Vec::new();
    for (k, shape) in shapes.iter().enumerate() {
        let (.., fraction, turn) = &segments[k];
        let most = chords.get(k + 1).map_or(0.0, |next| 0.5 * chords[k][1].min(next[0]));
        // One corner in ten is a stop.
        let radius = if *fraction < 0.1 { 0.0 } else { fraction * most };
        let turn = turn.map_or_else(String::new, |turn| format!(", rpy_rad = {turn:?}"));
        writeln!(text, "[[reference.path.segments]]\n{shape}, corner_radius_m = {radius:?}{turn} }}").ok()?;
        radii.push(radius);
    }
    Some((text, ends, radii))
}

/// Time at which the reference is at rest for ever, s, by bisection.
fn duration_s(trajectory: &Trajectory) -> f64 {
    let end = trajectory.at(1e6);
    let rests = |time_s: f64| trajectory.at(time_s) == end;
    let (mut low, mut high) = (0.0, 1.0);
    while !rests(high) {
        high *= 2.0;
        assert!(high < 1e6, "no end: {end:?}");
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
        prop_assert!(
            (spin - at.acceleration.angular).norm() < 1e-2 * (1.0 + alpha),
            "{time_s}: angular acceleration"
        );
        let speed = at.velocity.linear.norm();
        prop_assert!(speed < v * (1.0 + 1e-4), "{time_s}: {speed} m/s");
        let size = at.acceleration.linear.norm();
        prop_assert!(size < a * (1.0 + 1e-3), "{time_s}: {size} m/s^2 of {a}");
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
    #![proptest_config(ProptestConfig {
        failure_persistence: None,
        rng_seed: RngSeed::Fixed(11),
        ..ProptestConfig::with_cases(60)
    })]

    /// Compared: derivatives with differences, limits with the motion, the end with the last point, and the distance of the
    /// path from the end of each segment with its corner radius.
    #[test]
    fn paths_keep_their_limits(segments in segments(), limits in limits(), time_optimal: bool) {
        let Some((segments, ends, radii)) = written(&segments) else { return Err(TestCaseError::reject("close")) };
        let text = format!("{}time_optimal = {time_optimal}\n{segments}", limits.text());
        let summary = match read(&text).summary() {
            Ok(summary) => summary,
            Err(error) => {
                prop_assert!(error.to_string().contains("turns back"), "{}", error);
                return Err(TestCaseError::reject("turns back"));
            }
        };
        let trajectory = path(&text);
        let lasts_s = check(&trajectory, limits, 300)?;
        prop_assert!((lasts_s - summary.duration_s).abs() < 1e-3 * lasts_s);
        let end = trajectory.at(lasts_s);
        let world = |point: &Vector3<f64>| start().translation + axes() * point;
        prop_assert!((end.placement.translation - world(ends.last().expect("ends"))).norm() < 1e-9);
        prop_assert_eq!(end.velocity.linear.norm(), 0.0);
        let count = 4000;
        for (point, radius) in ends.iter().zip(radii) {
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

const LIMITS: &str = "speed_m_per_s = 0.3\nacceleration_m_per_s2 = 1.0\njerk_m_per_s3 = 20.0\n";

/// Compared: the duration of a line with the optimum d/v + v/a + a/j, and the speed at its middle with the limit.
#[test]
fn line_takes_least_time() {
    let trajectory = path(&format!("{LIMITS}segments = [{{ line = {{ to_m = [0.0, 0.4, 0.0] }} }}]"));
    let expected_s = 0.4 / 0.3 + 0.3 + 0.05;
    assert!((duration_s(&trajectory) - expected_s).abs() < 1e-6);
    assert!((trajectory.at(0.5 * expected_s).velocity.linear.norm() - 0.3).abs() < 1e-9);
}

/// Compared: the speed in the middle of a circle with the square root of acceleration times radius, and its length with the
/// circumference.
#[test]
fn circle_has_constant_speed() {
    let text = "speed_m_per_s = 2.0\nacceleration_m_per_s2 = 1.0\njerk_m_per_s3 = 20.0\n\
                segments = [{ circle = { centre_m = [0.0, 0.1, 0.0], normal = [0.0, 0.0, 2.0], turns = 2.0 } }]";
    let summary = read(text).summary().expect("a path");
    assert!((summary.length_m - 0.4 * std::f64::consts::PI).abs() < 1e-12);
    let trajectory = path(text);
    let speed = |part: f64| trajectory.at(part * summary.duration_s).velocity.linear.norm();
    assert!((speed(0.5) - 0.1_f64.sqrt()).abs() < 2e-3, "{}", speed(0.5));
    assert!((speed(0.45) - speed(0.55)).abs() < 1e-9);
}

/// Compared: two rounds of a square with one, and the path of a task in world coordinates with its points.
#[test]
fn path_repeats_and_starts_in_the_world() {
    let square = "corner_radius_m = 0.05\nsegments = [{ line = { to_m = [0.6, -0.7, 1.9] } }, \
                  { line = { to_m = [0.6, -0.5, 1.9] } }, { line = { to_m = [0.4, -0.5, 1.9] } }, \
                  { line = { to_m = [0.4, -0.7, 1.8] } }]";
    let world = "start = { absolute_m = [0.4, -0.7, 1.8] }\n";
    let once = read(&format!("{LIMITS}{world}{square}")).summary().expect("a path");
    let twice = read(&format!("{LIMITS}{world}repeat = 2\n{square}")).summary().expect("a path");
    assert!(twice.length_m > 1.9 * once.length_m && twice.duration_s < 2.0 * once.duration_s);
    let trajectory = path(&format!("{LIMITS}{world}{square}"));
    assert_eq!(trajectory.at(0.0).placement, start());
    let end = trajectory.at(1e3).placement;
    assert!((end.translation - Vector3::new(0.4, -0.7, 1.8)).norm() < 1e-12);
    assert!((end.rotation - start().rotation).norm() < 1e-12);
}

/// Each invalid path is refused with its key and the reason.
#[test]
fn invalid_paths_are_refused() {
    for (keys, key, reason) in [
        ("segments = []", "path.segments", "expected 1 to 10000 segments"),
        ("segments = [{ line = { to_m = [0.0, 0.0, 0.0] } }]", "path.segments.0", "no length"),
        (
            "segments = [{ arc = { via_m = [0.1, 0.0, 0.0], to_m = [0.2, 0.0, 0.0] } }]",
            "path.segments.0",
            "on one line",
        ),
        (
            "segments = [{ circle = { centre_m = [0.0, 0.0, 1.0], normal = [0.0, 0.0, 1.0], turns = 1.0 } }]",
            "path.segments.0",
            "no circle",
        ),
        ("segments = [{ spline = { through_m = [] } }]", "path.segments.0", "at least one point"),
        (
            "segments = [{ spline = { through_m = [[0.1, 0.0, 0.0], [0.1, 0.0, 0.0]] } }]",
            "path.segments.0",
            "point 1 of `through_m`",
        ),
        (
            "corner_radius_m = 0.06\nsegments = [{ line = { to_m = [0.1, 0.0, 0.0] } }, \
             { line = { to_m = [0.1, 0.5, 0.0] } }]",
            "path.segments.0",
            "at most 0.05 m",
        ),
        (
            "corner_radius_m = 0.01\nsegments = [{ line = { to_m = [0.1, 0.0, 0.0] } }, \
             { line = { to_m = [0.0, 0.0, 0.0] } }]",
            "path.segments.0",
            "turns back",
        ),
        (
            "segments = [{ line = { to_m = [0.1, 0.0, 0.0], rpy_rad = [0.1, 0.0, 0.0] } }]",
            "path.segments",
            "`angular_speed_rad_per_s`",
        ),
        (
            "start = { absolute_m = [0.0, 0.0, 0.0] }\n\
             segments = [{ line = { to_m = [0.1, 0.0, 0.0], rpy_rad = [0.1, 0.0, 0.0] } }]",
            "path.start",
            "`absolute_rpy_rad`",
        ),
    ] {
        let error = read(&format!("{LIMITS}{keys}")).summary().expect_err(keys);
        assert_eq!(error.key(), key, "{error}");
        assert!(error.to_string().contains(reason), "{error}");
    }
}

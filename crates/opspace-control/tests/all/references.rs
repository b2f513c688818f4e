//! References. Compared: velocities and accelerations with central differences of poses and velocities, and poses with
//! the shapes given in the file.

use crate::common::{self, File, Q0, at_state, control_context, four_joints};
use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};
use opspace_backend::Observable;
use opspace_control::ramp::minimum_jerk;
use opspace_control::{CartesianReference, Controller, OperationalSpaceController, Target, Trajectory};
use opspace_control::{orientation, recorded};
use opspace_model::{Motion, Placement};
use proptest::prelude::*;
use serde::Deserialize;

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

/// A path with very unequal intervals, whose first sample is not at time 0, and with quaternions of either sign.
const RECORDED: &str = "time_s,x_m,y_m,z_m,qw,qx,qy,qz
    2.0,  0.30, -0.50, 1.70,  0.9848, 0.1736,  0.0,    0.0
    2.35, 0.35, -0.45, 1.72, -0.9063, -0.4226, 0.0,    0.0
    2.6,  0.33, -0.40, 1.80,  0.8192, 0.4096,  0.3584, 0.1792
    3.3,  0.30, -0.35, 1.75,  0.6428, 0.6634,  0.2298, 0.3067
    3.9,  0.41, -0.44, 1.60,  0.8192, 0.3584, -0.1792, 0.4096";

/// Returns a trajectory that is not started.
fn read(text: &str) -> Trajectory {
    let mut file: Only = toml::from_str(text).unwrap_or_else(|e| panic!("{e}"));
    if let CartesianReference::Recorded(path) = &mut file.reference {
        path.samples = recorded::parse(RECORDED).unwrap_or_else(|e| panic!("{e}"));
    }
    Trajectory::new(&file.reference)
}

fn trajectory(text: &str) -> Trajectory {
    let mut trajectory = read(text);
    trajectory.start(&start(), &Target::at_rest(start()), &axes());
    trajectory
}

/// References; all except the last one start at the start pose.
const REFERENCES: [&str; 7] = [
    r#"reference = "hold""#,
    "[reference.point-to-point]
     position = { absolute_m = [0.1, 0.2, 0.5] }
     orientation = { offset_rpy_rad = [1.0, -0.5, 2.0] }
     start_s = 0.3
     duration_s = 1.1",
    "[reference.sinusoid]
     x = [{ amplitude_m = 0.1, frequency_hz = 0.5 }, { amplitude_m = 0.03, frequency_hz = 1.5, phase_rad = 1.0 }]
     z = [{ amplitude_m = 0.08, frequency_hz = 0.5, phase_rad = -1.5707963267948966, offset_m = 0.08 }]
     rx = [{ amplitude_rad = 0.9, frequency_hz = 0.4 }]
     rz = [{ amplitude_rad = 1.2, frequency_hz = 0.3, offset_rad = 0.2 }]
     ramp_s = 0.9",
    "[[reference.waypoints]]
     time_s = 0.5
     position = { offset_m = [0.1, 0.0, 0.0] }
     [[reference.waypoints]]
     time_s = 1.2
     orientation = { absolute_rpy_rad = [0.0, 0.3, -2.5] }
     [[reference.waypoints]]
     time_s = 1.9
     position = { absolute_m = [0.0, 0.1, 0.4] }
     orientation = { offset_rpy_rad = [0.0, 0.0, 0.0] }",
    GOAL,
    r#"reference.recorded = { file = "path.csv" }"#,
    r#"reference.recorded = { file = "path.csv", relative = false, approach_s = 0.8 }"#,
];

const GOAL: &str = "[reference.goal]
     position = { absolute_m = [0.1, -0.2, 1.4] }
     velocity_m_per_s = 0.5
     acceleration_m_per_s2 = 2.0
     jerk_m_per_s3 = 20.0
     orientation = { offset_rpy_rad = [0.6, -0.5, 1.0] }
     angular_velocity_rad_per_s = 1.0
     angular_acceleration_rad_per_s2 = 4.0
     angular_jerk_rad_per_s3 = 40.0";
const GOAL_LIMITS: [[f64; 3]; 2] = [[0.5, 2.0, 20.0], [1.0, 4.0, 40.0]];

/// Returns the target of a moving frame that is not at the start pose.
fn moving() -> Target {
    Target {
        placement: Placement::from_rpy([0.5, -0.6, 1.7], [0.1, 0.4, -0.5]),
        velocity: Motion { linear: Vector3::new(0.2, -0.25, 0.1), angular: Vector3::new(-0.4, 0.3, 0.5) },
        acceleration: Motion { linear: Vector3::new(-0.5, 0.4, 0.9), angular: Vector3::new(1.0, -1.2, 0.7) },
    }
}

/// Compares velocities and accelerations with central differences at 42 instants.
fn check_derivatives(trajectory: &Trajectory, what: &str) {
    let h = 1e-5;
    // h² times a third derivative of up to 2e3, plus rounding errors divided by h.
    let tolerance = 2e-7;
    for k in 1..43 {
        let t = 0.05 * f64::from(k) + 0.013;
        let [before, now, after] = [t - h, t, t + h].map(|t| trajectory.at(t));
        let per = 1.0 / (2.0 * h);
        let linear = (after.placement.translation - before.placement.translation) * per;
        let turn = after.placement.rotation * before.placement.rotation.transpose();
        let angular = orientation::log(&turn) * per;
        assert!((now.velocity.linear - linear).norm() < tolerance, "{what}\nat {t}");
        assert!((now.velocity.angular - angular).norm() < tolerance, "{what}\nat {t}");
        let linear = (after.velocity.linear - before.velocity.linear) * per;
        let angular = (after.velocity.angular - before.velocity.angular) * per;
        assert!((now.acceleration.linear - linear).norm() < tolerance, "{what}\nat {t}");
        assert!((now.acceleration.angular - angular).norm() < tolerance, "{what}\nat {t}");
    }
}

#[test]
fn velocities_and_accelerations_are_derivatives() {
    for text in REFERENCES {
        let mut trajectory = trajectory(text);
        check_derivatives(&trajectory, text);
        trajectory.start(&start(), &moving(), &axes());
        check_derivatives(&trajectory, text);
    }
}

/// Compared: differences of targets one millisecond apart with those that a bounded jerk allows. This detects jumps,
/// also of the acceleration, between the instants of the test of the derivatives.
#[test]
fn accelerations_are_continuous() {
    // Largest jerk, of the recorded path in its short intervals and of the ramps between waypoints.
    let (step, jerk) = (1e-3, 400.0);
    for text in REFERENCES {
        let trajectory = trajectory(text);
        for k in 0..3000 {
            let t = step * f64::from(k) - 0.1;
            let [before, after] = [t, t + step].map(|t| trajectory.at(t));
            let velocity = difference(&before.velocity, &after.velocity);
            let acceleration = difference(&before.acceleration, &after.acceleration);
            assert!(acceleration < jerk * step, "{text}\nby {acceleration} at {t}");
            assert!(velocity < 50.0 * step, "{text}\nby {velocity} at {t}");
        }
    }
}

fn difference(a: &Motion, b: &Motion) -> f64 {
    (a.linear - b.linear).norm().max((a.angular - b.angular).norm())
}

/// Compared: the target of a blended trajectory, at the start of the blend with the state that it starts from, and a
/// second later with the reference itself; in between, its derivatives with differences.
#[test]
fn reference_blend_has_no_jump() {
    /// Start of the blend, s: before the first instant at which derivatives are checked.
    const JOINED_S: f64 = 0.05;
    for text in REFERENCES {
        let alone = trajectory(text);
        let mut joined = alone.clone();
        let from = Target::at_rest(Placement::from_rpy([1.1, 0.2, -2.0], [0.5, -0.1, 0.3]));
        joined.join(JOINED_S, &from);
        let begin = joined.at(JOINED_S);
        assert!((begin.placement.translation - from.placement.translation).norm() < 1e-14, "{text}");
        assert!((begin.placement.rotation - from.placement.rotation).norm() < 1e-13, "{text}");
        assert!(difference(&begin.velocity, &Motion::zero()) < 1e-12, "{text}");
        assert!(difference(&begin.acceleration, &Motion::zero()) < 1e-11, "{text}");
        check_derivatives(&joined, text);
        for time_s in [JOINED_S + 1.0, 2.9] {
            assert_eq!(joined.at(time_s), alone.at(time_s), "{text}");
            assert_eq!(joined.reference_at(time_s), alone.at(time_s), "{text}");
        }
        joined.start(&start(), &Target::at_rest(start()), &axes());
        assert_eq!(joined.at(JOINED_S), alone.at(JOINED_S), "a start forgets it: {text}");
    }
}

/// Compared: pose, velocity and acceleration at time 0 with the start pose at rest.
#[test]
fn every_reference_starts_at_rest_at_start_pose() {
    for text in REFERENCES {
        let target = trajectory(text).at(0.0);
        assert!((target.placement.translation - start().translation).norm() < 1e-15, "{text}");
        assert!((target.placement.rotation - start().rotation).norm() < 1e-14, "{text}");
        assert!(target.velocity.linear.norm() + target.velocity.angular.norm() == 0.0, "{text}");
        assert!(target.acceleration.linear.norm() + target.acceleration.angular.norm() == 0.0, "{text}");
    }
}

#[test]
fn goals_are_reached_on_time() {
    let point = trajectory(REFERENCES[1]);
    let turned = axes() * orientation::from_rpy([1.0, -0.5, 2.0]) * axes().transpose() * start().rotation;
    for t in [1.4, 5.0] {
        let end = point.at(t).placement;
        assert!((end.translation - Vector3::new(0.1, 0.2, 0.5)).norm() < 1e-15);
        assert!((end.rotation - turned).norm() < 1e-14);
    }
    let list = trajectory(REFERENCES[3]);
    let first = list.at(0.5).placement;
    let place = start().translation + axes() * Vector3::new(0.1, 0.0, 0.0);
    assert!((first.translation - place).norm() < 1e-15 && (first.rotation - start().rotation).norm() < 1e-14);
    let second = list.at(1.2).placement;
    assert!((second.translation - place).norm() < 1e-15);
    assert!((second.rotation - orientation::from_rpy([0.0, 0.3, -2.5])).norm() < 1e-14);
    let third = list.at(9.0).placement;
    assert!((third.translation - Vector3::new(0.0, 0.1, 0.4)).norm() < 1e-15);
    assert!((third.rotation - start().rotation).norm() < 1e-14);
}

/// Goals started in motion, away from the start pose: offsets are relative to the pose at the start of the run,
/// absolute goals to the world; axes without a goal keep their pose.
#[test]
fn goals_started_in_motion_count_from_home() {
    let from = moving();
    let begun = |text: &str| {
        let mut trajectory = read(text);
        trajectory.start(&start(), &from, &axes());
        trajectory
    };
    let turned = |rpy| axes() * orientation::from_rpy(rpy) * axes().transpose() * start().rotation;
    let limits = "velocity_m_per_s = 0.5\nacceleration_m_per_s2 = 2.0\njerk_m_per_s3 = 20.0";
    let place = start().translation + axes() * Vector3::new(0.1, 0.2, -0.1);
    let offset = "position = { offset_m = [0.1, 0.2, -0.1] }";
    for (text, end) in [
        (format!("[reference.point-to-point]\n{offset}\nduration_s = 1.0"), (place, from.placement.rotation)),
        (format!("[reference.goal]\n{offset}\n{limits}"), (place, from.placement.rotation)),
        (REFERENCES[1].to_owned(), (Vector3::new(0.1, 0.2, 0.5), turned([1.0, -0.5, 2.0]))),
        (GOAL.to_owned(), (Vector3::new(0.1, -0.2, 1.4), turned([0.6, -0.5, 1.0]))),
        ("reference = \"hold\"".to_owned(), (from.placement.translation, from.placement.rotation)),
    ] {
        let begin = begun(&text).at(0.0).placement;
        assert!((begin.translation - from.placement.translation).norm() < 1e-15, "{text}");
        assert!((begin.rotation - from.placement.rotation).norm() < 1e-14, "{text}");
        let target = begun(&text).at(20.0);
        assert!((target.placement.translation - end.0).norm() < 1e-14, "{text}");
        assert!((target.placement.rotation - end.1).norm() < 1e-14, "{text}");
        assert!(difference(&target.velocity, &Motion::zero()) == 0.0, "{text}");
        assert!(difference(&target.acceleration, &Motion::zero()) == 0.0, "{text}");
    }
}

/// A goal started at rest moves along the straight line and about one axis between the poses, within the limits, and
/// arrives.
#[test]
fn online_goal_moves_straight_within_limits() {
    let goal = trajectory(GOAL);
    let (begin, end) = (goal.at(0.0).placement, goal.at(20.0).placement);
    let line = (end.translation - begin.translation).normalize();
    let axis = orientation::log(&(end.rotation * begin.rotation.transpose())).normalize();
    let step = 1e-3;
    let mut fastest = [0.0_f64; 2];
    for k in 0..4000 {
        let [now, next] = [0.0, step].map(|ahead| goal.at(step * f64::from(k) + ahead));
        let way = now.placement.translation - begin.translation;
        assert!(way.cross(&line).norm() < 1e-15 && now.velocity.angular.cross(&axis).norm() < 1e-15);
        let states = [&now, &next].map(|t| {
            [[t.velocity.linear, t.acceleration.linear], [t.velocity.angular, t.acceleration.angular]]
        });
        for (kind, [velocity, acceleration, jerk]) in GOAL_LIMITS.into_iter().enumerate() {
            let [v, a] = states[0][kind];
            let change = states[1][kind][1] - a;
            assert!(v.norm() <= velocity * (1.0 + 1e-9) && a.norm() <= acceleration * (1.0 + 1e-9));
            assert!(change.norm() <= jerk * step * (1.0 + 1e-6) + 1e-8, "{} at {k}", change.norm() / step);
            fastest[kind] = fastest[kind].max(v.norm() / velocity);
        }
    }
    // The distance is long enough to reach the full speed; a generator that is too slow would pass the checks of the
    // limits.
    assert!(fastest.iter().all(|speed| *speed > 0.999), "{fastest:?}");
}

proptest! {
    /// A goal that starts from any state of motion, at any instant of any other reference: no jump in pose, velocity or
    /// acceleration; the limits hold along and across the path; the motion ends at the goal.
    #[test]
    fn online_goal_takes_over_any_motion(
        reference in 0..REFERENCES.len(),
        after_s in 0.0..2.5,
        turn in [-2.0..2.0, -2.0..2.0, -2.0..2.0f64],
        velocity in [-1.0..1.0, -1.0..1.0, -1.0..1.0f64],
        acceleration in [-1.0..1.0, -1.0..1.0, -1.0..1.0f64],
    ) {
        let mut state = moving();
        state.placement.rotation = orientation::exp(&Vector3::from(turn));
        for (kind, [v, a, _]) in GOAL_LIMITS.into_iter().enumerate() {
            // √3: a component can be entirely along one direction. The margin of the velocity is for the acceleration's
            // contribution.
            let velocity = Vector3::from(velocity) * (0.6 * v / 3f64.sqrt());
            let acceleration = Vector3::from(acceleration) * (a / 3f64.sqrt());
            if kind == 0 {
                (state.velocity.linear, state.acceleration.linear) = (velocity, acceleration);
            } else {
                (state.velocity.angular, state.acceleration.angular) = (velocity, acceleration);
            }
        }
        for (from, within) in [(state, true), (trajectory(REFERENCES[reference]).at(after_s), false)] {
            let mut goal = read(GOAL);
            goal.start(&start(), &from, &axes());
            let begin = goal.at(0.0);
            prop_assert!((begin.placement.translation - from.placement.translation).norm() < 1e-15);
            prop_assert!((begin.placement.rotation - from.placement.rotation).norm() < 1e-14);
            prop_assert!(difference(&begin.velocity, &from.velocity) < 1e-14);
            prop_assert!(difference(&begin.acceleration, &from.acceleration) < 1e-13);
            // A state far beyond the limits causes a long displacement before it is back within them.
            let end = goal.at(1e5);
            let turned =
                axes() * orientation::from_rpy([0.6, -0.5, 1.0]) * axes().transpose() * start().rotation;
            prop_assert!((end.placement.translation - Vector3::new(0.1, -0.2, 1.4)).norm() < 1e-14);
            prop_assert!((end.placement.rotation - turned).norm() < 1e-13);
            prop_assert!(end.velocity == Motion::zero() && end.acceleration == Motion::zero());
            let line = (end.placement.translation - begin.placement.translation).normalize();
            let mut before = begin;
            for k in 1..600 {
                let now = goal.at(0.01 * f64::from(k));
                let step = now.placement.translation - before.placement.translation;
                let mean = (now.velocity.linear + before.velocity.linear) * 0.005;
                // The error of the trapezoidal rule is (0.01 s)³/12 times a jerk with three components.
                prop_assert!((step - mean).norm() < 1e-6 * 20.0 * 3f64.sqrt() / 12.0 + 1e-8);
                let change = now.acceleration.linear - before.acceleration.linear;
                prop_assert!(change.norm() <= 20.0 * 0.01 * 3f64.sqrt() * (1.0 + 1e-6));
                if within {
                    for (motion, limit) in [(now.velocity.linear, 0.5), (now.acceleration.linear, 2.0)] {
                        let along = motion.dot(&line);
                        prop_assert!(along.abs() <= limit * (1.0 + 1e-9), "{along} at {k}");
                        let across = (motion - line * along).norm();
                        prop_assert!(across <= limit * 2f64.sqrt() * (1.0 + 1e-9), "{across} at {k}");
                    }
                    // |ω| is at most the norm of the rotation vector's time derivative.
                    prop_assert!(now.velocity.angular.norm() <= 3f64.sqrt() * (1.0 + 1e-9));
                }
                before = now;
            }
        }
    }
}

/// Errors for missing and superfluous keys in a goal's table.
#[test]
fn goal_requires_its_limits() {
    let linear = "velocity_m_per_s = 0.5\nacceleration_m_per_s2 = 2.0\njerk_m_per_s3 = 20.0";
    let position = "position = { absolute_m = [0.1, -0.2, 1.4] }";
    for (text, said) in [
        (linear.to_owned(), "neither `position` nor `orientation`"),
        (
            format!("{position}\nvelocity_m_per_s = 0.5\njerk_m_per_s3 = 1"),
            "needs the limit `acceleration_m_per_s2`",
        ),
        (format!("{position}\n{linear}\nangular_jerk_rad_per_s3 = 1"), "`orientation`, which is not given"),
        (format!("{position}\n{linear}\nspeed = 1"), "unknown field `speed`"),
        (format!("{position}\nvelocity_m_per_s = 0"), "expected a number above 0"),
    ] {
        let error = toml::from_str::<Only>(&format!("[reference.goal]\n{text}")).err().map(|e| e.to_string());
        let error = error.unwrap_or_default();
        assert!(error.contains(said) && error.contains("line "), "{text}\n{error}");
    }
}

/// Compared: the path at the sample times with the samples: moved to the start pose in the task axes, and as recorded
/// after the approach is faded out.
#[test]
fn recorded_path_passes_through_its_samples() {
    let samples = recorded::parse(RECORDED).unwrap_or_else(|e| panic!("{e}"));
    let pose = |k: usize| {
        let sample = samples[k];
        let [w, x, y, z] = sample.quaternion.unwrap_or_default();
        let rotation = Rotation3::from(UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)));
        (sample.time_s - samples[0].time_s, Vector3::from(sample.position), *rotation.matrix())
    };
    let (laid, faded) = (trajectory(REFERENCES[5]), trajectory(REFERENCES[6]));
    let (_, first, first_turn) = pose(0);
    for k in 0..samples.len() {
        let (time_s, place, turn) = pose(k);
        let target = laid.at(time_s).placement;
        let wanted = start().translation + axes() * (place - first);
        assert!((target.translation - wanted).norm() < 1e-14, "sample {k}");
        let wanted = axes() * turn * first_turn.transpose() * axes().transpose() * start().rotation;
        assert!((target.rotation - wanted).norm() < 1e-14, "sample {k}");
        let target = faded.at(time_s).placement;
        if time_s >= 0.8 {
            assert!((target.translation - place).norm() < 1e-14, "sample {k}");
            assert!((target.rotation - turn).norm() < 1e-14, "sample {k}");
        }
    }
    for trajectory in [laid, faded] {
        let end = trajectory.at(1.9);
        assert!(end.velocity == Motion::zero() && end.acceleration == Motion::zero());
        assert!(trajectory.at(100.0) == end);
    }
}

/// Compared: the spline through samples of a known motion with this motion and its velocities: from rest to rest, a
/// straight line and a rotation by two revolutions about a slanted axis.
#[test]
fn recorded_path_approximates_recorded_motion() {
    let (line, axis) = (Vector3::new(0.3, -0.2, 0.5), Vector3::new(0.48, -0.6, 0.64));
    let angle = 4.0 * std::f64::consts::PI;
    let (duration_s, count) = (2.0, 100);
    let mut text = "x_m, y_m, z_m, time_s, qw, qx, qy, qz\n".to_owned();
    for k in 0..=count {
        let t = duration_s * f64::from(k) / f64::from(count);
        let s = minimum_jerk(t, duration_s)[0];
        let (p, q) = (line * s, UnitQuaternion::from_scaled_axis(axis * (angle * s)));
        text += &format!("{}, {}, {}, {t}, {}, {}, {}, {}\n", p.x, p.y, p.z, q.w, q.i, q.j, q.k);
    }
    let mut file: Only = toml::from_str(REFERENCES[5]).unwrap_or_else(|e| panic!("{e}"));
    if let CartesianReference::Recorded(path) = &mut file.reference {
        path.samples = recorded::parse(&text).unwrap_or_else(|e| panic!("{e}"));
    }
    let mut trajectory = Trajectory::new(&file.reference);
    trajectory.start(&start(), &Target::at_rest(start()), &Matrix3::identity());
    for k in 0..1000 {
        let t = duration_s * f64::from(k) / 1000.0;
        let [s, ds, _] = minimum_jerk(t, duration_s);
        let now = trajectory.at(t);
        let place = now.placement.translation - start().translation - line * s;
        // Error of a cubic spline, h⁴ times the fourth derivative: 0.02⁴ · 5/384 · (2π)⁴ · …
        assert!(place.norm() < 1e-6 && (now.velocity.linear - line * ds).norm() < 1e-4, "at {t}");
        let wanted = orientation::exp(&(axis * (angle * s))) * start().rotation;
        let off = orientation::log(&(now.placement.rotation * wanted.transpose())).norm();
        let rate = (now.velocity.angular - axis * (angle * ds)).norm();
        assert!(off < 1e-4 && rate < 1e-2, "off by {off} and {rate} at {t}");
    }
}

/// A path with two samples, from rest to rest.
#[test]
fn two_samples_make_a_path() {
    let mut file: Only = toml::from_str(REFERENCES[5]).unwrap_or_else(|e| panic!("{e}"));
    if let CartesianReference::Recorded(path) = &mut file.reference {
        path.samples =
            recorded::parse("time_s,x_m,y_m,z_m\n0,0,0,0\n2,1,0,0").unwrap_or_else(|e| panic!("{e}"));
    }
    let mut trajectory = Trajectory::new(&file.reference);
    trajectory.start(&start(), &Target::at_rest(start()), &axes());
    check_derivatives(&trajectory, "two samples");
    for t in [0.0, 0.3, 1.0, 2.0] {
        let now = trajectory.at(t).placement;
        assert!((now.rotation - start().rotation).norm() < 1e-14, "it doesn't turn");
        let mirrored = trajectory.at(2.0 - t).placement.translation + now.translation;
        let ends = start().translation * 2.0 + axes() * Vector3::x();
        assert!((mirrored - ends).norm() < 1e-14, "it is symmetric");
    }
}

#[test]
fn recorded_path_errors_name_the_line() {
    let head = "time_s,x_m,y_m,z_m,qw,qx,qy,qz\n";
    let turn = |q: &str| format!("{head}0,0,0,0,1,0,0,0\n\r\n1,0,0,0,{q}\n");
    for (text, line, said) in [
        (String::new(), Some(1), "no column `time_s`"),
        ("time_s,x_m,z_m\n0,0,0".to_owned(), Some(1), "no column `y_m`"),
        ("time_s,x_m,y_m,z_m,qw,qx,qz\n".to_owned(), Some(1), "no column `qy`"),
        ("time_s,x_m,y_m,z_m,force\n".to_owned(), Some(1), "unknown column `force`"),
        ("time_s,x_m,y_m,z_m,x_m\n".to_owned(), Some(1), "column `x_m` is given twice"),
        (head.to_owned(), None, "0 samples"),
        (format!("{head}0,0,0,0,1,0,0,0"), None, "1 samples"),
        (format!("{head}0,0,0,0,1,0,0,0\n1,0,0\n"), Some(3), "3 values for 8 columns"),
        (
            format!("{head}0,0,O,0,1,0,0,0\n"),
            Some(2),
            "column `y_m`: expected a number from -1e9 to 1e9, got 'O'",
        ),
        (
            format!("{head}0,0,0,inf,1,0,0,0\n"),
            Some(2),
            "column `z_m`: expected a number from -1e9 to 1e9, got 'inf'",
        ),
        (
            format!("{head}0,0,0,,1,0,0,0\n"),
            Some(2),
            "column `z_m`: expected a number from -1e9 to 1e9, got ''",
        ),
        (format!("{head}0,0,-1e308,0,1,0,0,0\n"), Some(2), "column `y_m`: expected a number from -1e9"),
        (
            "time_s,x_m,y_m,z_m\n0,0,0,0\n1e-10,0,0,1\n".to_owned(),
            Some(3),
            "0.0000000001 s is not after the previous 0 s, by at least 1 ns",
        ),
        (
            "time_s,x_m,y_m,z_m\n0,0,0,0\n1,0,0,0\n1,0,0,1\n".to_owned(),
            Some(4),
            "1 s is not after the previous 1 s",
        ),
        (
            "time_s,x_m,y_m,z_m\n1.7e12,0,0,0\n1.7e12,0,0,1\n".to_owned(),
            Some(2),
            "expected seconds, from -1e10 to 1e10, got '1.7e12'; divide milliseconds by 1e3",
        ),
        (
            "time_s,x_m,y_m,z_m\n1700000000.5,0,0,0\n1700000000.25,0,0,1\n".to_owned(),
            Some(3),
            "1700000000.25 s is not after the previous 1700000000.5 s",
        ),
        (turn("0.99,0,0,0"), Some(4), "length is 0.99, not 1"),
        (turn("0.7,0,0,0.7141428"), Some(4), "1.59"),
    ] {
        let error = recorded::parse(&text).expect_err(&text);
        assert_eq!(error.line, line, "{text}{error}");
        assert!(error.to_string().contains(said), "{text}{error}");
    }
    assert!(recorded::parse(&turn("-0.708,0,0,-0.706")).is_ok(), "just less than a quarter turn");
}

/// Compared: the ramp with central differences and with its end values.
#[test]
fn ramp_is_smooth() {
    let h = 1e-5;
    for k in 1..20 {
        let t = 0.1 * f64::from(k);
        let [before, now, after] = [t - h, t, t + h].map(|t| minimum_jerk(t, 2.0));
        assert!((now[1] - (after[0] - before[0]) / (2.0 * h)).abs() < 1e-9);
        assert!((now[2] - (after[1] - before[1]) / (2.0 * h)).abs() < 1e-9);
    }
    assert!(minimum_jerk(0.0, 2.0) == [0.0; 3] && minimum_jerk(2.0, 2.0) == [1.0, 0.0, 0.0]);
    assert!((minimum_jerk(1.0, 2.0)[0] - 0.5).abs() < 1e-15);
}

/// Joint references, observed through the signals of their task. Compared: the reference velocity with central
/// differences, and the end with the goals.
#[test]
fn joint_references_reach_their_goals() {
    let references = [
        ("\"hold\"", Q0),
        (
            "{ point-to-point = { goal = { absolute_rad = { elbow = -1.0 } }, start_s = 0.2, duration_s = 1.0 } }",
            [Q0[0], Q0[1], Q0[2], -1.0],
        ),
        (
            "{ waypoints = [{ time_s = 0.7, goal = { offset_rad = { elbow = 0.2, shoulder_yaw = 0.1 } } }, { time_s = 1.5, goal = { absolute_rad = { shoulder_yaw = 0.0 } } }] }",
            [Q0[0], Q0[1], 0.0, Q0[3] + 0.2],
        ),
        (
            "{ goal = { posture = { offset_rad = { elbow = 0.2, shoulder_yaw = -0.1 } }, velocity_rad_per_s = 1, acceleration_rad_per_s2 = 3, jerk_rad_per_s3 = { shoulder_pitch = 10, shoulder_roll = 10, shoulder_yaw = 10, elbow = 20 } } }",
            [Q0[0], Q0[1], Q0[2] - 0.1, Q0[3] + 0.2],
        ),
    ];
    for (reference, end) in references {
        let text = format!(
            "priority = [\"all\"]\n[task.all.joint-tracking]\nreference = {reference}\n\
             gains = {{ frequency_rad_per_s = {{ shoulder_pitch = 10, shoulder_roll = 10.0, shoulder_yaw = 9.0, elbow = 8.0 }}, damping_ratio = 1 }}"
        );
        let model = four_joints();
        let file = File::read(&text);
        let mut controller =
            OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand"))
                .unwrap_or_else(|e| panic!("{e}"));
        let (data, measurement) = at_state(&model, &Q0, &[0.0; 4], 0.0);
        controller.start(&common::input(&model, &data, &measurement));
        let mut at = |time_s: f64| {
            let mut measurement = measurement.clone();
            measurement.time_s = time_s;
            controller.update(&common::input(&model, &data, &measurement), &mut [0.0; 4]);
            let signals = controller.signals();
            let mut row = vec![0.0; signals.iter().map(|s| s.len()).sum()];
            controller.sample(&mut row);
            ["all.reference", "all.reference_velocity", "all.error"].map(|name| {
                let before = signals.iter().take_while(|s| s.name != name);
                let at = before.map(|s| s.len()).sum();
                row[at..at + 4].to_vec()
            })
        };
        let h = 1e-5;
        for k in 0..40 {
            let t = 0.05 * f64::from(k) + 0.013;
            let [before, now, after] = [t - h, t, t + h].map(&mut at);
            for i in 0..4 {
                let rate = (after[0][i] - before[0][i]) / (2.0 * h);
                assert!((now[1][i] - rate).abs() < 1e-8, "{reference}, joint {i} at {t}");
                assert!((now[2][i] - (now[0][i] - Q0[i])).abs() < 1e-15, "{reference}, error of joint {i}");
            }
        }
        let last = at(3.0);
        for i in 0..4 {
            assert!((last[0][i] - end[i]).abs() < 1e-15, "{reference}: joint {i} ends at {}", last[0][i]);
        }
    }
}

/// Compared: samples 1 ms apart whose times begin at 0, before 0, and in 2023 as seconds since 1970.
#[test]
fn times_since_1970_are_as_exact_as_times_since_zero() {
    for (first_s, first_ms) in [(0, 0), (1_700_000_000, 998), (-3, 0)] {
        let mut text = "time_s,x_m,y_m,z_m\n".to_owned();
        for k in 0..3000_i64 {
            let ms = 1000 * first_s + first_ms + k;
            let sign = if ms < 0 { "-" } else { "" };
            text += &format!("{sign}{}.{:03},0,0,0\n", ms.abs() / 1000, ms.abs() % 1000);
        }
        let samples = recorded::parse(&text).unwrap_or_else(|e| panic!("{e}"));
        for (k, sample) in samples.iter().enumerate() {
            let error_s = sample.time_s - k as f64 * 1e-3;
            assert!(error_s.abs() < 2e-15, "{first_s}: sample {k} at {} s", sample.time_s);
        }
    }
}

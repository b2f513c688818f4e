//! Time-optimal paths of random arms within the speed limits of their joints. Compared: joint speeds of an inverse
//! kinematics of this test, with steps a tenth as long as those of the preparation, with the limits; the duration with that
//! of a pass forward and one backward on a fine grid; the motion on arms whose limits don't bind with that of the path alone.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use super::path_following::follow;
use super::random_arms::RandomArm;
use super::random_servos::{Random, load};
use nalgebra::DVector;
use opspace_control::{CartesianReference, PathPlace, PathReference, TaskParameters};
use opspace_experiment::{Code, Experiment};
use opspace_preflight::diagnostics;
use std::fs;
use std::path::{Path, PathBuf};

const STEP_S: f64 = 1e-4;

/// Fraction of the velocity limits that the controller uses.
const FRACTION: f64 = 0.9;

/// Experiment of a path with the given limits and segments, on an arm whose joints have the speed limit `velocity`.
fn experiment(arm: &RandomArm, velocity: f64, path: &str) -> Experiment {
    let folder = tempfile::TempDir::new().unwrap();
    load(&task_file(folder.path(), arm, velocity, path), &[])
}

/// Writes the task of that experiment, and its robot, to a folder.
fn task_file(folder: &Path, arm: &RandomArm, velocity: f64, path: &str) -> PathBuf {
    let robot = folder.join("robot");
    fs::create_dir(&robot).unwrap();
    let urdf = arm.urdf().replace("velocity=\"6\"", &format!("velocity=\"{velocity:?}\""));
    fs::write(robot.join("arm.urdf"), urdf).unwrap();
    fs::write(robot.join("robot.toml"), arm.robot()).unwrap();
    let start: Vec<String> =
        arm.start.iter().enumerate().map(|(i, q)| format!("j{} = {q:?}", i + 1)).collect();
    let task = folder.join("task.toml");
    let text = format!(
        "robot = \"robot\"\nduration_s = 3.0\npriority = [\"tip\", \"rest\"]\nstart_rad = {{ {} }}\n\
         [task.tip.cartesian]\nframe = \"tip\"\naxes = {{ x = \"motion\", y = \"motion\", z = \"motion\" }}\n\
         gains = {{ frequency_rad_per_s = 14.0, damping_ratio = 1.0 }}\n\
         [task.tip.cartesian.reference.path]\ntime_optimal = true\n{path}\n\
         [task.rest.joint-posture]\nfrequency_rad_per_s = 6.0\ndamping_ratio = 1.0\n",
        start.join(", ")
    );
    fs::write(&task, text).unwrap();
    task
}

fn reference(experiment: &Experiment) -> &CartesianReference {
    match &experiment.task().file.task["tip"] {
        TaskParameters::Cartesian(parameters) => &parameters.reference,
        other => panic!("{other:?}"),
    }
}

/// Motion of the joints along the path, from its start to its end.
struct MotionAlongPath {
    /// Arc length (m), speed (m/s) and largest ratio of a joint's speed to its limit.
    at: Vec<[f64; 3]>,
    duration_s: f64,
}

/// Largest error of the position that is followed, m.
const FOLLOWED_M: f64 = 2e-3;

/// Follows the reference.
fn along(experiment: &Experiment) -> MotionAlongPath {
    let motion = follow(experiment, reference(experiment), ("tip", 3), STEP_S, f64::INFINITY).unwrap();
    assert!(motion.farthest_m < FOLLOWED_M, "{} m", motion.farthest_m);
    let limit = FRACTION * experiment.robot().model.joints()[0].limits.velocity;
    let place = |(step, dq): (usize, &DVector<f64>)| match motion.trajectory.place_at(STEP_S * step as f64) {
        Some(PathPlace::Along { s_m, speed_m_per_s, .. }) => [s_m, speed_m_per_s, dq.amax() / limit],
        other => panic!("{other:?}"),
    };
    let at = motion.dq.iter().enumerate().map(place).collect();
    MotionAlongPath { at, duration_s: motion.duration_s }
}

fn point(random: &mut Random) -> String {
    format!("{:?}", [0; 3].map(|_| random.between(-0.12, 0.12)))
}

/// No joint is faster than its limit, some joint comes near it, and there is no diagnostic of it.
#[test]
fn joints_keep_their_speed_limits() {
    let mut random = Random(3);
    for number in 0..6 {
        let arm = RandomArm::new(&mut random);
        let path = format!(
            "speed_m_per_s = 2.0\nacceleration_m_per_s2 = 15.0\njerk_m_per_s3 = 500.0\ncorner_radius_m = 0.02\n\
             segments = [{{ line = {{ to_m = {} }} }}, {{ spline = {{ through_m = [{}, {}] }} }}, {{ line = {{ to_m = {} }} }}]",
            point(&mut random),
            point(&mut random),
            point(&mut random),
            point(&mut random),
        );
        let experiment = experiment(&arm, 1.0, &path);
        let followed = along(&experiment);
        let highest = followed.at.iter().map(|at| at[2]).fold(0.0, f64::max);
        assert!(highest <= 1.0, "arm {number}: {highest}");
        assert!(highest > 0.85, "arm {number}: {highest}");
        let too_fast: Vec<_> =
            diagnostics(&experiment).into_iter().filter(|found| found.code == Code::JointTooFast).collect();
        assert!(too_fast.is_empty(), "arm {number}: {too_fast:?}");
    }
}

/// Fraction of a speed limit that a path uses; the rest is left to the feedback.
const FOR_MOTION: f64 = 0.95;

/// Lines whose jerk is hardly limited.
#[test]
fn lines_take_hardly_more_than_the_least_time() {
    let mut random = Random(4);
    for number in 0..4 {
        let arm = RandomArm::new(&mut random);
        let path = format!(
            "speed_m_per_s = 2.0\nacceleration_m_per_s2 = 5.0\njerk_m_per_s3 = 2000.0\nsegments = [{{ line = {{ to_m = {} }} }}]",
            point(&mut random)
        );
        let followed = along(&experiment(&arm, 1.0, &path));
        // Highest speed at each place, from the joint speeds per speed.
        let length_m = followed.at.last().unwrap()[0];
        let count = 4000;
        let step_m = length_m / f64::from(count);
        let highest = |s_m: f64| {
            let next = followed.at.partition_point(|at| at[0] < s_m).min(followed.at.len() - 2).max(1);
            let [_, speed, ratio] = followed.at[next];
            (FOR_MOTION * speed / ratio).min(2.0)
        };
        let mut x: Vec<f64> = (0..=count).map(|k| highest(step_m * f64::from(k)).powi(2)).collect();
        let last = x.len() - 1;
        (x[0], x[last]) = (0.0, 0.0);
        for k in 0..last {
            x[k + 1] = x[k + 1].min(x[k] + 2.0 * 5.0 * step_m);
        }
        for k in (0..last).rev() {
            x[k] = x[k].min(x[k + 1] + 2.0 * 5.0 * step_m);
        }
        let least_s: f64 = x.windows(2).map(|pair| 2.0 * step_m / (pair[0].sqrt() + pair[1].sqrt())).sum();
        let ratio = followed.duration_s / least_s;
        assert!(ratio > 0.999 && ratio < 1.03, "arm {number}: {} of {least_s} s", followed.duration_s);
    }
}

/// The timing of a path is not changed by limits that don't bind.
#[test]
fn slow_paths_are_unchanged() {
    let mut random = Random(5);
    let arm = RandomArm::new(&mut random);
    let path = format!(
        "speed_m_per_s = 0.1\nacceleration_m_per_s2 = 1.0\njerk_m_per_s3 = 50.0\nsegments = [{{ line = {{ to_m = {} }} }}]",
        point(&mut random)
    );
    let CartesianReference::Path(path) = reference(&experiment(&arm, 6.0, &path)).clone() else { panic!() };
    assert_eq!(path.bounds, opspace_control::PathBounds::default());
}

/// The path of a task in each of its task sets. Compared: the places in memory, since one path has one motion, however many events
/// read it again.
#[test]
fn events_share_a_path() {
    let arm = RandomArm::new(&mut Random(5));
    let path = "speed_m_per_s = 2.0\nacceleration_m_per_s2 = 5.0\njerk_m_per_s3 = 100.0\n\
                segments = [{ line = { to_m = [0.05, 0.02, 0.0] } }]";
    for time_optimal in [true, false] {
        let folder = tempfile::TempDir::new().unwrap();
        let task = task_file(folder.path(), &arm, 3.0, path);
        let events = "[[event]]\ntime_s = 1.0\nset = [\"task.rest.joint-posture.damping_ratio=0.9\"]\n\
                      [[event]]\ntime_s = 2.0\nset = [\"task.tip.cartesian.gains.damping_ratio=0.9\"]\n";
        let text = fs::read_to_string(&task).unwrap() + events;
        fs::write(&task, text.replace("time_optimal = true", &format!("time_optimal = {time_optimal}")))
            .unwrap();
        let experiment = load(&task, &[]);
        let sets = experiment.task().events.iter().map(|event| &event.task["tip"]);
        for other in sets {
            let (CartesianReference::Path(first), TaskParameters::Cartesian(other)) =
                (reference(&experiment), other)
            else {
                panic!("{other:?}")
            };
            let CartesianReference::Path(other) = &other.reference else { panic!("{other:?}") };
            assert!(std::ptr::eq::<PathReference>(&**first, &**other));
        }
    }
}

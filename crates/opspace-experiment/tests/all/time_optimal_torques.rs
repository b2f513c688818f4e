//! Time-optimal paths of arms within the limits of torque and acceleration of their joints. Compared: joint torques of the
//! rigid inverse dynamics with friction, along an inverse kinematics of this test, with the limits; the duration with that of
//! the path within speed limits alone, slowed down uniformly until it keeps the torque limits; runs of a simulation with
//! each other.
//!
//! `OPSPACE_SEED=7 cargo test --test experiment time_optimal_torques` draws other paths.
#![expect(clippy::expect_used, clippy::unwrap_used, reason = "a test that can't go on has failed")]
#![expect(clippy::print_stderr, reason = "seeds, durations and errors")]

use super::path_following::{self, JointMotion};
use super::random_arms::RandomArm;
use super::random_servos::{Random, load};
use nalgebra::{DVector, Matrix3, Vector3};
use opspace_control::{
    CartesianReference, PathBounds, Target, TaskParameters, Trajectory, ViableSpeeds, orientation,
};
use opspace_experiment::{Code, Experiment, Progress, Scenario};
use opspace_model::{Data, Model, frame_placement, gravity, kinematics, rnea};
use opspace_preflight::diagnostics;
use opspace_transformer::FrictionParameters;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

const STEP_S: f64 = 5e-4;

/// Fraction of the velocity limits that the controller uses.
const VELOCITY_FRACTION: f64 = 0.9;

/// An arm and the task with which it follows a path.
struct Arm {
    name: &'static str,
    _folder: TempDir,
    task: PathBuf,
    frame: &'static str,
    /// Number of rows of the task: 3 for a position, 6 for a pose.
    rows: usize,
}

impl Arm {
    fn new(
        name: &'static str,
        robot: &str,
        folder: TempDir,
        frame: &'static str,
        rows: usize,
        start: &str,
        rest: bool,
    ) -> Self {
        let angles = if rows == 6 { ", rx = \"motion\", ry = \"motion\", rz = \"motion\"" } else { "" };
        let (priority, posture) = if rest {
            (", \"rest\"", "[task.rest.joint-posture]\nfrequency_rad_per_s = 6.0\ndamping_ratio = 1.0\n")
        } else {
            ("", "")
        };
        let text = format!(
            "robot = \"{robot}\"\nduration_s = 3.0\npriority = [\"tip\"{priority}]\nstart_rad = {{ {start} }}\n\
             friction_compensation = {{ gain = 0.8 }}\n\
             [task.tip.cartesian]\nframe = \"{frame}\"\naxes = {{ x = \"motion\", y = \"motion\", z = \"motion\"{angles} }}\n\
             gains = {{ frequency_rad_per_s = 20.0, damping_ratio = 1.0 }}\n{posture}\
             [task.tip.cartesian.reference.path]\ntime_optimal = true\nPATH\n",
        );
        let task = folder.path().join("task.toml");
        fs::write(&task, text).unwrap();
        Self { name, _folder: folder, task, frame, rows }
    }

    fn in_repository(name: &'static str, start: &str, rest: bool) -> Self {
        let robot = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../robots").join(name);
        Self::new(name, robot.to_str().unwrap(), TempDir::new().unwrap(), "flange", 6, start, rest)
    }

    fn panda() -> Self {
        let start = "joint1 = 0.0, joint2 = -0.7854, joint3 = 0.0, joint4 = -2.3562, joint5 = 0.0, joint6 = 1.5708, \
                     joint7 = 0.7854";
        Self::in_repository("panda", start, true)
    }

    fn ur5e() -> Self {
        let start = "base = 0.0, shoulder = -1.5708, elbow = -1.5708, wrist_1 = -1.5708, wrist_2 = 1.5708, wrist_3 = 0.0";
        Self::in_repository("ur5e", start, false)
    }

    fn random(random: &mut Random) -> Self {
        let arm = RandomArm::new(random);
        let folder = TempDir::new().unwrap();
        fs::create_dir(folder.path().join("robot")).unwrap();
        fs::write(folder.path().join("robot/arm.urdf"), arm.urdf()).unwrap();
        fs::write(folder.path().join("robot/robot.toml"), arm.robot()).unwrap();
        let start: Vec<String> =
            arm.start.iter().enumerate().map(|(i, q)| format!("j{} = {q:?}", i + 1)).collect();
        Self::new("random", "robot", folder, "tip", 3, &start.join(", "), true)
    }

    /// Experiment of a path with other settings.
    fn experiment(&self, path: &str, settings: &[String]) -> Experiment {
        let text = fs::read_to_string(&self.task).unwrap().replace("PATH", path);
        let task = self.task.with_file_name("path.toml");
        fs::write(&task, text).unwrap();
        load(&task, settings)
    }
}

fn reference(experiment: &Experiment) -> CartesianReference {
    match &experiment.task().file.task["tip"] {
        TaskParameters::Cartesian(parameters) => parameters.reference.clone(),
        other => panic!("{other:?}"),
    }
}

fn bounds(experiment: &Experiment) -> PathBounds {
    match reference(experiment) {
        CartesianReference::Path(path) => path.bounds.clone(),
        other => panic!("{other:?}"),
    }
}

/// Error at which an arm cannot follow a reference: it passes near a singular posture, m.
const LOST_M: f64 = 5e-3;

/// Follows a reference. `None` if the arm cannot.
fn follow(arm: &Arm, experiment: &Experiment, reference: &CartesianReference) -> Option<JointMotion> {
    path_following::follow(experiment, reference, (arm.frame, arm.rows), STEP_S, LOST_M)
}

/// Torques of the joints at an instant.
struct Torques {
    gravity: DVector<f64>,
    inertial: DVector<f64>,
    coulomb: DVector<f64>,
    viscous: DVector<f64>,
}

impl Torques {
    /// Torques if the same motion takes `longer` times as long (n; Nm).
    fn slowed(&self, longer: f64) -> DVector<f64> {
        &self.gravity + &self.inertial / (longer * longer) + &self.coulomb + &self.viscous / longer
    }
}

/// Inverse dynamics of a followed path, with accelerations from central differences.
fn torques(model: &Model, friction: &[FrictionParameters], followed: &JointMotion) -> Vec<Torques> {
    let mut data = Data::new(model);
    (1..followed.q.len() - 1)
        .map(|k| {
            let (q, dq) = (&followed.q[k], &followed.dq[k]);
            let ddq = (&followed.dq[k + 1] - &followed.dq[k - 1]) / (2.0 * STEP_S);
            kinematics(model, &mut data, q.as_slice(), dq.as_slice());
            gravity(model, &mut data);
            rnea(model, &mut data, ddq.as_slice());
            let each = |of: fn(&FrictionParameters, f64) -> f64| {
                DVector::from_fn(model.n(), |i, _| of(&friction[i], dq[i]))
            };
            Torques {
                inertial: &data.torque - &data.gravity,
                gravity: data.gravity.clone(),
                coulomb: each(|f, dq| f.coulomb_nm.get() * dq.signum()),
                viscous: each(|f, dq| f.viscous_nms_per_rad.get() * dq),
            }
        })
        .collect()
}

/// Largest ratio of a torque to its limit, if the motion takes `longer` times as long.
fn usage(torques: &[Torques], limits: &[f64], longer: f64) -> f64 {
    let ratio = |at: &Torques| {
        let each = at.slowed(longer);
        each.iter().zip(limits).map(|(torque, limit)| torque.abs() / limit).fold(0.0, f64::max)
    };
    torques.iter().map(ratio).fold(0.0, f64::max)
}

/// A path with limits of its own that hardly bind, once around in a random plane: it never turns back.
fn drawn(random: &mut Random) -> String {
    let turn = [0; 3].map(|_| random.between(-1.5, 1.5));
    let plane = orientation::from_rpy(turn);
    let [a, b, c, d] = [1.1, 2.4, 3.7, 5.0].map(|angle: f64| {
        let (angle, radius) = (angle + random.between(-0.3, 0.3), random.between(0.06, 0.14));
        let point = plane * Vector3::new(radius * angle.cos() - 0.1, radius * angle.sin(), 0.0);
        format!("{:?}", point.as_slice())
    });
    format!(
        "speed_m_per_s = 2.0\nacceleration_m_per_s2 = 30.0\njerk_m_per_s3 = 2000.0\ncorner_radius_m = 0.02\n\
         segments = [{{ line = {{ to_m = {a} }} }}, {{ spline = {{ through_m = [{b}, {c}] }} }}, {{ line = {{ to_m = {d} }} }}]"
    )
}

/// Seeds of paths: two that remain, and one that may be given.
fn seeds() -> [u64; 3] {
    let drawn = std::env::var("OPSPACE_SEED").map_or(3, |seed| seed.parse().unwrap());
    eprintln!("OPSPACE_SEED={drawn}");
    [1, 2, drawn]
}

/// Settings with which torques do not bind.
fn unlimited(experiment: &Experiment) -> Vec<String> {
    let joints = experiment.robot().model.joints().iter();
    joints.map(|joint| format!("robot.joint.{}.torque_limit_nm=100000.0", joint.name)).collect()
}

/// Motions along a path: with the torque limits of the arm, and without any, and what they need.
struct Compared {
    experiment: Experiment,
    unlimited: Experiment,
    new: JointMotion,
    old: JointMotion,
    new_torques: Vec<Torques>,
    old_torques: Vec<Torques>,
    /// Torque limits that are in force, Nm (n).
    limits: Vec<f64>,
}

impl Compared {
    /// `None` if the arm cannot follow the path.
    fn new(arm: &Arm, path: &str, fraction: f64) -> Option<Self> {
        let weak = format!("limits.torque_fraction={fraction:?}");
        let experiment = arm.experiment(path, &[weak]);
        let unlimited = arm.experiment(path, &unlimited(&experiment));
        let model = &experiment.robot().model;
        let friction: Vec<_> = experiment.robot().joints().into_iter().map(|joint| joint.friction).collect();
        let [new, old] = [&experiment, &unlimited].map(|of| follow(arm, of, &reference(of)));
        let (new, old) = (new?, old?);
        let [new_torques, old_torques] = [&new, &old].map(|followed| torques(model, &friction, followed));
        let limits = experiment.robot().torque_limits().iter().map(|limit| fraction * limit).collect();
        Some(Self { experiment, unlimited, new, old, new_torques, old_torques, limits })
    }

    /// Largest ratio of a joint's speed to its limit.
    fn speed_usage(&self) -> f64 {
        let joints = self.experiment.robot().model.joints();
        let ratio = |dq: &DVector<f64>| {
            let each = dq
                .iter()
                .zip(joints)
                .map(|(dq, joint)| dq.abs() / (VELOCITY_FRACTION * joint.limits.velocity));
            each.fold(0.0, f64::max)
        };
        self.new.dq.iter().map(ratio).fold(0.0, f64::max)
    }

    /// Largest ratio of a joint's speed in the motion within speed limits alone to the one from which it can stop before its
    /// position limit.
    fn stopping_usage(&self) -> f64 {
        let robot = self.experiment.robot();
        let parameters = self.experiment.task().file.limits;
        let speeds = ViableSpeeds::new(&robot.model, &robot.joint_limits(), &parameters, 1e-3);
        let ratio = |(q, dq): (&DVector<f64>, &DVector<f64>)| {
            let each = dq.iter().enumerate().map(|(i, dq)| dq.abs() / speeds.highest(i, q[i], *dq > 0.0));
            each.fold(0.0, f64::max)
        };
        self.old.q.iter().zip(&self.old.dq).map(ratio).fold(0.0, f64::max)
    }

    /// Duration of the motion within speed limits alone, slowed down uniformly until it keeps the torque limits and every joint
    /// can stop before its position limit, s.
    fn uniformly_slowed_s(&self) -> f64 {
        let mut longer = self.stopping_usage().max(1.0);
        while usage(&self.old_torques, &self.limits, longer) > 1.0 {
            longer *= 1.002;
            assert!(longer < 20.0);
        }
        longer * self.old.duration_s
    }
}

/// Most paths that are drawn for an arm.
const MOST_PATHS: usize = 20;

/// Fraction of the duration without torque limits that finer parts of the path can gain.
const FINER_PARTS_GAIN: f64 = 0.05;

/// Largest fraction by which a path may take longer than the old one, slowed down uniformly.
const LONGER_THAN_UNIFORM: f64 = 0.05;

/// The torques of random paths are within their limits, some torque or speed comes near its limit, and the path takes hardly
/// longer than without torque limits and slowed down uniformly.
#[test]
fn joints_keep_their_torque_limits() {
    for seed in seeds() {
        let mut random = Random(seed);
        for (arm, fraction) in [(Arm::panda(), 0.5), (Arm::ur5e(), 0.6), (Arm::random(&mut random), 0.6)] {
            // Another path, if a random arm would pass near a singular posture.
            let paths = std::iter::repeat_with(|| drawn(&mut random)).take(MOST_PATHS);
            let mut compared = paths.filter_map(|path| Compared::new(&arm, &path, fraction));
            let compared = compared.next().expect("a path that the arm can follow");
            let [new, old] = [&compared.new_torques, &compared.old_torques]
                .map(|torques| usage(torques, &compared.limits, 1.0));
            let (new_s, old_s) = (compared.new.duration_s, compared.old.duration_s);
            let (uniform_s, speed) = (compared.uniformly_slowed_s(), compared.speed_usage());
            let parts = bounds(&compared.experiment).parts;
            let rows = parts.first().map_or(0, |part| part.acceleration.len());
            let text = format!(
                "OPSPACE_SEED={seed}, {}: without torque limits {old_s:.3} s, {old:.3} of a torque limit; with them {new_s:.3} s, \
                 {new:.3} of a torque limit, {speed:.3} of a speed limit; uniformly slowed {uniform_s:.3} s; {} parts, {rows} bounds",
                arm.name,
                parts.len()
            );
            eprintln!("{text}");
            assert!(new <= 1.0 && speed <= 1.0, "{text}");
            assert!(new.max(speed) > 0.85, "{text}");
            assert!(new_s <= uniform_s * (1.0 + LONGER_THAN_UNIFORM), "{text}");
            // Torque bounds divide the path more finely, which gains a little.
            if old > 1.05 {
                assert!(new_s > (1.0 - FINER_PARTS_GAIN) * old_s, "{text}");
            }
        }
    }
}

/// Compared: the bounds of a path whose torques are within their limits with those without torque limits.
#[test]
fn paths_within_torque_limits_are_unchanged() {
    let mut random = Random(7);
    for arm in [Arm::panda(), Arm::ur5e()] {
        let path = drawn(&mut random).replace("= 30.0", "= 1.0");
        let compared = Compared::new(&arm, &path, 1.0).unwrap();
        assert!(usage(&compared.new_torques, &compared.limits, 1.0) < 0.95, "{}", arm.name);
        assert_eq!(bounds(&compared.experiment), bounds(&compared.unlimited), "{}", arm.name);
    }
}

/// Compared: accelerations of joints with their limits.
#[test]
fn joints_keep_their_acceleration_limits() {
    let limit = 6.0;
    for arm in [Arm::panda(), Arm::ur5e()] {
        let path = drawn(&mut Random(8));
        let experiment = arm.experiment(&path, &[]);
        let names = experiment.robot().model.joints().iter().map(|joint| &joint.name);
        let settings: Vec<String> =
            names.map(|name| format!("robot.joint.{name}.acceleration_limit_rad_per_s2={limit:?}")).collect();
        let experiment = arm.experiment(&path, &settings);
        let followed = follow(&arm, &experiment, &reference(&experiment)).unwrap();
        let largest =
            followed.dq.windows(2).map(|pair| (&pair[1] - &pair[0]).amax() / STEP_S).fold(0.0, f64::max);
        eprintln!("{}: {largest:.3} of {limit} rad/s^2 in {:.3} s", arm.name, followed.duration_s);
        assert!(largest <= limit && largest > 0.85 * limit, "{}: {largest} rad/s^2", arm.name);
    }
}

/// An arm that gravity overloads gets a path, which is slow and finite.
#[test]
fn overloaded_arm_has_a_finite_path() {
    let arm = Arm::panda();
    let path = drawn(&mut Random(9));
    let followed = |fraction: f64| {
        let experiment = arm.experiment(&path, &[format!("limits.torque_fraction={fraction:?}")]);
        assert!(
            fraction > 0.2
                || diagnostics(&experiment).iter().any(|found| found.code == Code::WeightAboveLimit)
        );
        follow(&arm, &experiment, &reference(&experiment)).unwrap().duration_s
    };
    let [strong_s, weak_s] = [1.0, 0.1].map(followed);
    eprintln!("{strong_s:.3} s, overloaded {weak_s:.3} s");
    assert!(weak_s > strong_s && weak_s < 20.0 * strong_s, "{strong_s} s, {weak_s} s");
}

/// Largest error of an arm that keeps its limits, mm.
const FOLLOWED_MM: f64 = 5.0;

/// Compared: the largest error of the flange in a simulation, with the timing for the limits that are in force, and with
/// the timing for an arm without torque limits. The path begins after the torque has ramped in. On most paths of the Panda, the
/// torque leaves little to brake joint2 before its position limit.
#[test]
fn hand_stays_on_its_path() {
    for (arm, seed) in [(Arm::panda(), 1), (Arm::panda(), 2), (Arm::panda(), 4), (Arm::ur5e(), 4)] {
        let path = drawn(&mut Random(seed)).replace("= 30.0", "= 10.0").replace("= 2000.0", "= 500.0");
        let compared = Compared::new(&arm, &path, 0.4).unwrap();
        let timings = [("new.csv", &compared.experiment), ("old.csv", &compared.unlimited)];
        let [new_mm, old_mm] = timings.map(|(file, timing)| {
            record(&arm, timing, &arm.task.with_file_name(file), 1.0);
            let recorded = format!("task.tip.cartesian.reference={{ recorded = {{ file = \"{file}\" }} }}");
            let experiment = arm.experiment(&path, &["limits.torque_fraction=0.4".to_owned(), recorded]);
            let run = Scenario::from(experiment).run_without_logs(&Progress::default()).unwrap();
            let summary = run.single().unwrap();
            assert_eq!(summary.faulted, None);
            1e3 * summary.tasks["tip"].pose.position_max_m.unwrap()
        });
        eprintln!(
            "{}: largest error {new_mm:.2} mm, without torque limits in the timing {old_mm:.2} mm",
            arm.name
        );
        assert!(new_mm < FOLLOWED_MM.min(0.3 * old_mm), "{}: {new_mm} and {old_mm} mm", arm.name);
    }
}

/// Writes the positions of a reference, which begins at `begin_s` (s), to a file.
fn record(arm: &Arm, experiment: &Experiment, file: &Path, begin_s: f64) {
    let model = &experiment.robot().model;
    let start: Vec<f64> =
        model.joints().iter().map(|joint| experiment.task().file.start_rad[&joint.name]).collect();
    let mut data = Data::new(model);
    kinematics(model, &mut data, &start, &vec![0.0; model.n()]);
    let home = frame_placement(model, &data, model.frame_id(arm.frame).unwrap());
    let mut trajectory = Trajectory::new(&reference(experiment));
    trajectory.start(&home, &Target::at_rest(home), &Matrix3::identity());
    let mut rows = "time_s,x_m,y_m,z_m\n".to_owned();
    for step in 0..3000 {
        let time_s = 1e-3 * f64::from(step);
        let at = trajectory.at(time_s - begin_s).placement.translation - home.translation;
        rows += &format!("{time_s:.3},{:?},{:?},{:?}\n", at.x, at.y, at.z);
    }
    fs::write(file, rows).unwrap();
}

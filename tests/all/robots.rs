//! Robots of the project: every folder in `robots/` is valid, and its robot executes its task as a position robot and
//! as a torque robot. The values in each URDF equal those of its source.

#![expect(clippy::unwrap_used, reason = "a test")]

use crate::cli_common::{opspace, project, read};
use crate::common::measure;
use nalgebra::{DVector, Isometry3, Matrix2, Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use opspace_backend::CommandKind;
use opspace_experiment::{Experiment, Files, RobotDefinition, RunOptions, Source, TaskDefinition};
use opspace_model::{Data, Model, Placement, frame_placement, update};
use std::f64::consts::FRAC_PI_2;
use std::fs;
use std::path::{Path, PathBuf};

/// Largest difference between two computations of the same quantity, relative to max(1, largest entry): the URDFs
/// round right angles to the nearest double.
const ROUNDING: f64 = 64.0 * f64::EPSILON;

/// Robots of the project, by folder name.
fn robots() -> Vec<String> {
    let folders = fs::read_dir(project("robots")).unwrap().map(|entry| entry.unwrap().path());
    let robots = folders.filter(|folder| folder.join("robot.toml").exists());
    let mut names: Vec<String> =
        robots.map(|folder| folder.file_name().unwrap().to_str().unwrap().to_owned()).collect();
    names.sort();
    names
}

/// Path of a task for a robot: its reaching task, or else its first task by file name.
fn first_task(robot: &str) -> PathBuf {
    let files = fs::read_dir(project("tasks")).unwrap().map(|entry| entry.unwrap().path());
    let mut tasks: Vec<PathBuf> =
        files.filter(|file| file.extension().is_some_and(|e| e == "toml")).collect();
    let own = format!("{robot}-reach");
    tasks.sort_by_key(|task| (task.file_stem().is_none_or(|name| *name != *own), task.clone()));
    let is_for = |task: &PathBuf| {
        let task = TaskDefinition::load(Files::Disk, task, &[]).unwrap_or_else(|e| panic!("{e}"));
        task.robot_path().ends_with(robot)
    };
    tasks.into_iter().find(is_for).unwrap_or_else(|| panic!("no task is for {robot}"))
}

/// Checks a robot, its URDF and a task for it with `opspace check`: there must be no diagnostic.
#[test]
fn every_robot_passes_check() {
    let names = robots();
    assert!(
        ["asimo-arm", "panda", "planar-2-link", "ur5e"].iter().all(|name| names.iter().any(|n| n == name))
    );
    for name in names {
        let files = [format!("robots/{name}"), format!("robots/{name}/{name}.urdf")];
        let task = first_task(&name);
        let arguments = ["check", &files[0], &files[1], task.to_str().unwrap()];
        let ran = opspace(Path::new(&project(".")), &arguments).exits(0);
        // One line per file, six lines about the task (its gain margin, what `-v` prints, the joints first at their torque and speed
        // limits, its nearly singular postures, and the verdict), three lines about pairs if distances are kept, and one about an
        // estimated force.
        let robot = read(project(&format!("{}/robot.toml", files[0])));
        let (keeps_distances, estimates) =
            (robot.contains("\n[collision]"), robot.contains("\n[estimated_force."));
        let lines = 9 + if keeps_distances { 3 } else { 0 } + usize::from(estimates);
        let titles = ran.stdout.lines().filter(|line| !line.starts_with("    ")).count();
        assert_eq!((titles, ran.stderr.as_str()), (lines, ""), "{name}");
    }
}

/// Compared: the true path of the hand, and the reference of the task, which moves by more than 0.1 m. The error on
/// the position robot includes that of the transformer with held setpoints, the error on both robots that of
/// friction.
#[test]
fn every_robot_tracks_its_task_on_both_backends() {
    const POSITION_ROBOT_M: f64 = 0.015;
    const TORQUE_ROBOT_M: f64 = 0.005;
    for name in robots() {
        for (backend, bound) in
            [(CommandKind::Position, POSITION_ROBOT_M), (CommandKind::Torque, TORQUE_ROBOT_M)]
        {
            let options = RunOptions { backend, duration_s: Some(2.0), ..RunOptions::default() };
            let experiment = Experiment::load(Files::Disk, &first_task(&name), None, options, &[])
                .unwrap_or_else(|e| panic!("{e}"));
            let error = measure(&experiment).pose.position_rms_m.expect("the task moves a frame");
            assert!(error < bound, "{name}, {backend:?}: {error} m");
        }
    }
}

fn model(urdf: &str) -> Model {
    Model::from_urdf(urdf).unwrap_or_else(|e| panic!("{e}")).model
}

/// Loads the URDF of a robot of the project.
fn urdf(name: &str) -> Model {
    model(&read(project(&format!("robots/{name}/{name}.urdf"))))
}

fn at(model: &Model, q: &[f64]) -> Data {
    let mut data = Data::new(model);
    assert!(update(model, &mut data, q, &vec![0.0; q.len()]), "M is positive definite");
    data
}

fn pose(model: &Model, data: &Data, frame: &str) -> Placement {
    frame_placement(model, data, model.frame_id(frame).unwrap_or_else(|e| panic!("{e}")))
}

/// Joint angles for tests: none is zero, and all are different.
fn states(n: usize) -> impl Iterator<Item = Vec<f64>> {
    (0..5).map(move |state| {
        (0..n).map(|i| (1.7 * f64::from(state) + 0.9 * i as f64 + 0.4).sin() * 2.0).collect()
    })
}

#[track_caller]
fn close<'a>(
    a: impl IntoIterator<Item = &'a f64>,
    b: impl IntoIterator<Item = &'a f64>,
    tolerance: f64,
    what: &str,
) {
    let (a, b): (Vec<f64>, Vec<f64>) = (a.into_iter().copied().collect(), b.into_iter().copied().collect());
    assert_eq!(a.len(), b.len(), "{what}");
    let scale = b.iter().fold(1.0, |m: f64, x| m.max(x.abs()));
    let wrong = a.iter().zip(&b).find(|(a, b)| (*a - *b).abs() > tolerance * scale);
    assert!(wrong.is_none(), "{what}: {a:?} is not {b:?}");
}

/// Compared: the composite-rigid-body algorithm and gravity with the URDF, and the closed form in textbooks.
#[test]
fn planar_arm_matches_textbook() {
    let model = urdf("planar-2-link");
    let g = model.gravity().norm();
    for q in states(2) {
        let data = at(&model, &q);
        let (c1, c2, c12) = (q[0].cos(), q[1].cos(), (q[0] + q[1]).cos());
        let coupling = 1.0 / 3.0 + 0.5 * c2;
        let mass = Matrix2::new(5.0 / 3.0 + c2, coupling, coupling, 1.0 / 3.0);
        let weight = Vector2::new(g * (1.5 * c1 + 0.5 * c12), g * 0.5 * c12);
        let (s1, s12) = (q[0].sin(), (q[0] + q[1]).sin());
        let tip = Vector3::new(c1 + c12, 0.0, s1 + s12);
        close(data.mass_matrix.iter(), mass.iter(), ROUNDING, "M");
        close(data.gravity.iter(), weight.iter(), ROUNDING, "g");
        close(pose(&model, &data, "tip").translation.iter(), tip.iter(), ROUNDING, "tip");
    }
}

/// Compared: the project's URDF, from published tables, and the widely used URDF without its hand. Poses, masses,
/// centres of mass and inertias affect M and g; only z of link 1 does not, and it differs between the two.
#[test]
fn panda_matches_widely_used_urdf() {
    let foreign = read(project("tests/oracles/pinocchio/urdf/panda_arm7.urdf"));
    let (arm, _hand) = foreign.split_once("<joint name=\"panda_hand_joint\"").expect("it has a hand");
    let foreign = model(&(arm.to_owned() + "</robot>"));
    let ours = urdf("panda");
    for (a, b) in ours.joints().iter().zip(foreign.joints()) {
        let limits = |l: &opspace_model::Limits| [l.lower, l.upper, l.velocity, l.effort];
        assert_eq!(limits(&a.limits), limits(&b.limits), "{}", a.name);
    }
    for q in states(7) {
        let (a, b) = (at(&ours, &q), at(&foreign, &q));
        let (flange, link8) = (pose(&ours, &a, "flange"), pose(&foreign, &b, "panda_link8"));
        close(flange.translation.iter(), link8.translation.iter(), ROUNDING, "position");
        close(flange.rotation.iter(), link8.rotation.iter(), ROUNDING, "orientation");
        close(a.mass_matrix.iter(), b.mass_matrix.iter(), ROUNDING, "M");
        close(a.gravity.iter(), b.gravity.iter(), ROUNDING, "g");
    }
}

/// Row of the table of Universal Robots: a and d (m), α (rad), mass (kg), and its centre in the frame of the row (m).
type Row = (f64, f64, f64, f64, [f64; 3]);

/// "DH parameters for calculations of kinematics and dynamics", UR5e.
const UR5E: [Row; 6] = [
    (0.0, 0.1625, FRAC_PI_2, 3.761, [0.0, -0.02561, 0.00193]),
    (-0.425, 0.0, 0.0, 8.058, [0.2125, 0.0, 0.11336]),
    (-0.3922, 0.0, 0.0, 2.846, [0.15, 0.0, 0.0265]),
    (0.0, 0.1333, FRAC_PI_2, 1.37, [0.0, -0.0018, 0.01634]),
    (0.0, 0.0997, -FRAC_PI_2, 1.3, [0.0, 0.0018, 0.01634]),
    (0.0, 0.0996, 0.0, 0.365, [0.0, 0.0, -0.001159]),
];

/// Pose of the flange according to the table, and the sum of mass times centre of mass over the links, kg m.
fn from_manufacturer_table(q: &[f64]) -> (Isometry3<f64>, Vector3<f64>) {
    let mut frame = Isometry3::identity();
    let mut moment = Vector3::zeros();
    for (&(a, d, alpha, mass, centre), &angle) in UR5E.iter().zip(q) {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
        let twist = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), alpha);
        frame = frame * turn * Translation3::new(a, 0.0, d) * twist;
        moment += mass * (frame * Point3::from(centre)).coords;
    }
    (frame, moment)
}

/// Compared: the project's URDF, with link frames at the joints of the links, and the manufacturer's table, with
/// frames at the next joints: the pose of the flange, and gravity as the gradient of the table's potential energy.
/// The arm is mounted at an angle, because in upright mounting some positions of the masses affect no torque.
#[test]
fn ur5e_matches_manufacturer_table() {
    const STEP_RAD: f64 = 1e-4;
    /// Error of a central difference: step²/6 times a third derivative, which is about as large as the torque.
    const DIFFERENCE: f64 = STEP_RAD * STEP_RAD;
    let down = Vector3::new(4.0, -5.0, -7.0);
    let model = urdf("ur5e").with_gravity(down);
    for q in states(6) {
        let data = at(&model, &q);
        let (flange, table) = (pose(&model, &data, "flange"), from_manufacturer_table(&q).0);
        close(flange.translation.iter(), table.translation.vector.iter(), ROUNDING, "position");
        close(
            flange.rotation.iter(),
            table.rotation.to_rotation_matrix().matrix().iter(),
            ROUNDING,
            "orientation",
        );
        let slope = DVector::from_fn(6, |joint, _| {
            let energy = |step: f64| {
                let mut q = q.clone();
                q[joint] += step;
                -down.dot(&from_manufacturer_table(&q).1)
            };
            (energy(STEP_RAD) - energy(-STEP_RAD)) / (2.0 * STEP_RAD)
        });
        close(data.gravity.iter(), slope.iter(), DIFFERENCE, "g");
    }
}

/// The planar arm with additional lines in its robot.toml.
fn planar_with(lines: &str) -> Result<RobotDefinition, String> {
    let source = |file: &str, more: &str| {
        let path = project(&format!("robots/planar-2-link/{file}"));
        Source::new(file.to_owned(), read(&path) + more)
    };
    RobotDefinition::from_sources(source("robot.toml", lines), source("planar-2-link.urdf", ""))
        .map_err(|e| e.to_string())
}

/// Compared: a tool of mass m with its centre 0.1 m beyond the tip and with rotational inertia, and the closed form
/// of a body there: M increases by m Jᵀ J of its centre and by I about y, g by m g times the vertical motion of the
/// centre.
#[test]
fn tool_adds_inertia_and_frame() {
    let (mass, out, about_y) = (0.7, 1.1, 0.02);
    let robot = planar_with(
        "\n[tool.torch]\non = \"link_2\"\nxyz_m = [1.2, 0.0, 0.3]\nrpy_rad = [0.0, 0.5, 0.0]\nmass_kg = 0.7\n\
         com_m = [1.1, 0.0, 0.0]\ninertia_kg_m2 = [0.01, 0.0, 0.0, 0.02, 0.0, 0.015]\n",
    )
    .unwrap();
    let bare = planar_with("").unwrap();
    for q in states(2) {
        let (with, without) = (at(&robot.model, &q), at(&bare.model, &q));
        let (a, b) = (q[0], q[0] + q[1]);
        // Derivatives of the centre's x and z with respect to each joint.
        let second = Vector2::new(-out * b.sin(), out * b.cos());
        let first = second + Vector2::new(-a.sin(), a.cos());
        let j = Matrix2::from_columns(&[first, second]);
        let expected = j.transpose() * j * mass + Matrix2::from_element(about_y);
        close(&(&with.mass_matrix - &without.mass_matrix), expected.iter(), ROUNDING, "M");
        close(&(&with.gravity - &without.gravity), (j.row(1) * mass * 9.81).iter(), ROUNDING, "g");
        let tip = pose(&robot.model, &with, "link_2") * Placement::from_rpy([0.0, 0.5, 0.0], [1.2, 0.0, 0.3]);
        let torch = pose(&robot.model, &with, "torch");
        close(&torch.translation, tip.translation.iter(), ROUNDING, "position");
        close(&torch.rotation, tip.rotation.iter(), ROUNDING, "axes");
    }
}

#[test]
fn invalid_tool_is_refused_with_its_line() {
    let refused = |lines: &str| planar_with(lines).map(|_| ()).unwrap_err();
    let last = read(project("robots/planar-2-link/robot.toml")).lines().count();
    for (lines, line, message) in [
        ("\n[tool.a]\non = \"link2\"\n", 3, "the URDF has no link 'link2'"),
        ("\n[tool.tip]\non = \"link_2\"\n", 2, "the robot already has a link or tool 'tip'"),
        (
            "\n[tool.a]\non = \"tip\"\nmass_kg = 1.0\ninertia_kg_m2 = [1.0, 0.0, 0.0, 1.0, 0.0, 3.0]\n",
            5,
            "no body has the principal moments 1.000e0, 1.000e0, 3.000e0 kg m²",
        ),
        (
            "\n[tool.a]\non = \"tip\"\ninertia_kg_m2 = [1.0, 0.0, 0.0, 1.0, 0.0, 1.0]\n",
            4,
            "a body without mass has no inertia",
        ),
        ("\n[tool.a]\non = \"tip\"\nxyz_m = [0.0, 0.1]\n", 4, "expected 3 values, got 2"),
    ] {
        let error = refused(lines);
        assert!(error.contains(message), "{error}");
        assert!(error.starts_with(&format!("robot.toml:{}", last + line)), "{error}");
    }
}

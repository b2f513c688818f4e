//! Scenes: objects of the user beside the arm, their contact forces, and errors in a scene.

use crate::common::{mujoco, project};
use nalgebra::{Matrix3, Vector3};
use opspace_experiment::{Experiment, Files, RobotDefinition, RunOptions};
use opspace_model::collision::Capsule;
use opspace_model::{Inertia, Joint, JointKind, Limits, Model, Placement};
use opspace_mujoco::Mujoco;
use opspace_sim::{JointTorque, PhysicsEngine, Plant, PlantArm, PlantConfig, PlantFrame, RigidPlant};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

const STEP_S: f64 = 1e-4;
const GRAVITY: f64 = 9.81;

/// Writes a scene into a folder.
fn scene(folder: &Path, text: &str) -> PathBuf {
    let path = folder.join("scene.xml");
    fs::write(&path, text).expect("a file");
    path
}

/// A box of 2 kg that falls by 5 mm.
const BOX: &str = "<mujoco><worldbody><body pos='0.03 0.02 0.2'><freejoint/>
  <geom type='box' size='0.1 0.1 0.1' mass='2'/></body></worldbody></mujoco>";

/// Joint positions of the tray.
const TRAY: [f64; 2] = [0.0, 0.3];

/// A tray of 3 kg that a vertical joint lifts and a second one turns: two horizontal capsules, whose top is 0.095 m high. The
/// frame of its force sensor is rotated and displaced.
fn tray() -> (PlantConfig, PlantFrame, Placement) {
    let inertia =
        |mass| Inertia { mass, com: Vector3::new(0.1, 0.0, 0.0), rotational: Matrix3::identity() * 0.01 };
    let joint = |name: &str, kind| Joint { name: name.into(), kind, limits: Limits::NONE };
    let mut model = Model::new("tray");
    let lift = model.add_body(None, Placement::identity(), joint("lift", JointKind::Prismatic), inertia(1.0));
    let body =
        model.add_body(Some(lift), Placement::identity(), joint("turn", JointKind::Revolute), inertia(2.0));
    let plate = model.add_frame("plate", Some(body), Placement::identity());
    let placement = Placement::from_rpy([0.4, -0.3, 0.8], [0.05, -0.1, -0.2]);
    let sensor = model.add_frame("sensor", Some(body), placement);
    let rail = |y: f64| {
        let end = |x: f64| Vector3::new(x, y, 0.075);
        (plate, Capsule { start_m: end(-0.1), end_m: end(0.1), radius_m: 0.02 })
    };
    let arm = PlantArm {
        capsules: vec![rail(-0.05), rail(0.05)],
        sensors: vec![sensor],
        ..PlantArm::new(model, TRAY.to_vec())
    };
    let config = PlantConfig { arms: vec![arm], couplings: Vec::new(), objects: Vec::new(), step_s: STEP_S };
    (config, PlantFrame { arm: 0, frame: sensor }, placement)
}

/// Compared: the wrench of a force sensor under a box, and force and moment of the box's weight; during the impact, the force
/// along the lifting joint and mass times acceleration.
#[test]
fn force_sensor_feels_a_box() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some(mujoco) = mujoco(Some(&scene(folder.path(), BOX))) else { return };
    let (config, frame, placement) = tray();
    let mut plant = mujoco.build(config).expect("a plant");
    let (mut largest, mut worst) = (0.0_f64, 0.0_f64);
    for step in 0..20_000 {
        let spring = |i: usize| -2000.0 * (plant.q()[i] - TRAY[i]) - 100.0 * plant.dq()[i];
        let torques = [3.0 * GRAVITY + spring(0), spring(1)];
        let before = plant.dq()[0];
        plant.step(f64::from(step) * STEP_S, STEP_S, &torques.map(JointTorque::from));
        if step < 3000 {
            // The second joint turns about the vertical: the tray's axes in the world.
            let rotation = Placement::from_rpy([0.0, 0.0, plant.q()[1]], [0.0; 3]) * placement;
            let along = (rotation.rotation * plant.contact_wrench(frame).linear).z;
            let expected = 3.0 * (plant.dq()[0] - before) / STEP_S - torques[0] + 3.0 * GRAVITY;
            largest = largest.max(along.abs());
            worst = worst.max((along - expected).abs());
        }
    }
    println!("impact: {largest:.1} N, {worst:.1e} N from mass times acceleration");
    assert!(largest > 25.0 && worst < 1e-3 * largest, "{worst:e} N of {largest} N");
    let turned = Placement::from_rpy([0.0, 0.0, plant.q()[1]], [0.0, 0.0, plant.q()[0]]) * placement;
    let wrench = plant.contact_wrench(frame);
    let force = turned.rotation * wrench.linear;
    let weight = Vector3::new(0.0, 0.0, -2.0 * GRAVITY);
    assert!((force - weight).norm() < 1e-2, "{force}");
    // The box rests where it fell.
    let moment = turned.rotation * wrench.angular;
    let expected = (Vector3::new(0.03, 0.02, 0.0) - turned.translation).cross(&weight);
    assert!((moment - expected).norm() < 1e-2, "{moment} instead of {expected}");
    assert!((plant.q()[0] + 2.0 * GRAVITY / 2000.0).abs() < 1e-4, "{}", plant.q()[0]);
}

/// Settings, defaults and a keyframe of a scene that would change the arm if they applied to it, and a free box far away.
const DEFAULTS: &str = "<mujoco model='other'>
  <compiler angle='radian' settotalmass='10' inertiafromgeom='true' boundmass='3' balanceinertia='true'/>
  <option timestep='0.01' gravity='1 2 3' integrator='RK4'><flag gravity='disable' contact='disable'/></option>
  <default>
    <joint damping='5' armature='3' stiffness='10' frictionloss='2' limited='true' range='0 1' axis='1 0 0'/>
    <geom density='5000' friction='0.1' type='box'/>
  </default>
  <!-- a comment -->
  <worldbody><body pos='5 0 1'><freejoint/><geom size='0.1 0.1 0.1'/></body></worldbody>
</mujoco>";

/// Compared: the motion of an arm beside a scene, and its motion on the library's own plant.
#[test]
fn settings_of_a_scene_do_not_change_the_arm() {
    /// Rounding errors of the steps, rad.
    const TOLERANCE_RAD: f64 = 1e-10;
    let folder = tempfile::tempdir().expect("a folder");
    let Some(mujoco) = mujoco(Some(&scene(folder.path(), DEFAULTS))) else { return };
    let robot = RobotDefinition::load(Files::Disk, &project("robots/panda"), &[]).expect("a robot");
    let start = vec![0.1, -0.7, 0.2, -2.2, 0.3, 1.5, 0.7];
    let config = || PlantConfig {
        arms: vec![PlantArm::new(robot.model.clone(), start.clone())],
        couplings: Vec::new(),
        objects: Vec::new(),
        step_s: STEP_S,
    };
    let after = |mut plant: Box<dyn Plant>| {
        for step in 0..2000 {
            plant.step(
                f64::from(step) * STEP_S,
                STEP_S,
                &[1.0, -2.0, 3.0, 4.0, 1.0, 0.5, 0.2].map(JointTorque::from),
            );
        }
        plant.q().to_vec()
    };
    let own = after(Box::new(RigidPlant::new(config())));
    let other = after(mujoco.build(config()).expect("a plant"));
    for (own, other) in own.iter().zip(&other) {
        assert!((own - other).abs() < TOLERANCE_RAD, "{own} and {other}");
    }
}

/// Checks that an arm that compensates its weight stays at rest without torques, while the box falls onto it.
#[test]
fn weightless_arm_rests_in_a_scene_with_gravity() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some(mujoco) = mujoco(Some(&scene(folder.path(), BOX))) else { return };
    let (mut config, ..) = tray();
    config.arms[0].model = config.arms[0].model.clone().with_gravity(Vector3::zeros());
    let mut plant = mujoco.build(config).expect("a plant");
    let mut after = |steps: std::ops::Range<u32>| {
        steps.for_each(|step| plant.step(f64::from(step) * STEP_S, STEP_S, &[JointTorque::default(); 2]));
        plant.q()[0]
    };
    // The box falls for 32 ms.
    assert!(after(0..300).abs() < 1e-12);
    assert!(after(300..1500) < -0.01);
}

/// Checks that a state in which MuJoCo warns, because of an acceleration above 1e10, is not a number.
#[test]
fn warning_of_mujoco_ends_a_run() {
    let Some(mujoco) = mujoco(None) else { return };
    let (config, ..) = tray();
    let mut plant = mujoco.build(config).expect("a plant");
    plant.step(0.0, STEP_S, &[1e9, 0.0].map(JointTorque::from));
    assert!(plant.q()[0].is_finite());
    plant.step(STEP_S, STEP_S, &[1e12, 0.0].map(JointTorque::from));
    assert!(plant.q()[0].is_nan(), "{}", plant.q()[0]);
}

/// A mesh and a part of the scene in files beside it are found, whatever the working directory.
#[test]
fn files_of_a_scene_are_found_beside_it() {
    let folder = tempfile::tempdir().expect("a folder");
    fs::create_dir(folder.path().join("parts")).expect("a folder");
    let tetrahedron = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";
    fs::write(folder.path().join("parts/stone.obj"), tetrahedron).expect("a file");
    let part = "<mujoco><worldbody><geom type='sphere' size='0.1' pos='3 0 0'/></worldbody></mujoco>";
    fs::write(folder.path().join("part.xml"), part).expect("a file");
    let text = "<mujoco><compiler meshdir='parts'/><include file='part.xml'/>
      <asset><mesh name='stone' file='stone.obj'/></asset>
      <worldbody><body pos='2 0 0'><freejoint/><geom type='mesh' mesh='stone'/></body></worldbody></mujoco>";
    let Some(mujoco) = mujoco(Some(&scene(folder.path(), text))) else { return };
    let (config, ..) = tray();
    mujoco.build(config).expect("a plant");
}

/// Returns the error of an experiment with a scene.
fn refused(mujoco: Mujoco) -> String {
    let task = project("tasks/panda-reach.toml");
    let experiment = Experiment::load(Files::Disk, &task, None, RunOptions::default(), &[]).expect("a task");
    experiment.on_engine(Arc::new(mujoco)).expect_err("refused").to_string()
}

/// Checks that errors name the file and MuJoCo's reason, with the line of the user's file.
#[test]
fn wrong_scenes_are_refused_with_the_reason_of_mujoco() {
    let folder = tempfile::tempdir().expect("a folder");
    for (text, reasons) in [
        ("<mujoco>\n  <worldbody>\n    <geom type='cube'/>\n  </worldbody>\n</mujoco>", ["cube", "line 3"]),
        ("<mujoco>\n<worldbody>", ["refuses the scene", "=2"]),
        ("<robot/>", ["refuses the scene", "mujoco"]),
        (
            "<mujoco><worldbody><body name='arm'/></worldbody></mujoco>",
            ["with the arm in it", "repeated name 'arm'"],
        ),
        ("", ["refuses the scene", ""]),
    ] {
        let path = scene(folder.path(), text);
        let Some(mujoco) = mujoco(Some(&path)) else { return };
        let error = refused(mujoco);
        assert!(error.contains(&path.display().to_string()), "{error}");
        for reason in reasons {
            assert!(error.contains(reason), "{error}");
        }
    }
}

/// Checks the errors without MuJoCo: a file that is no library, and a scene that does not exist.
#[test]
fn missing_files_are_named() {
    let error =
        Mujoco::open(Path::new("/nonexistent/libmujoco.so"), None).expect_err("no library").to_string();
    assert!(error.contains("/nonexistent/libmujoco.so") && error.contains("pip install"), "{error}");
    if mujoco(None).is_some() {
        let error = Mujoco::find(Some(Path::new("missing.xml"))).expect_err("no scene").to_string();
        assert!(error.contains("missing.xml: the scene cannot be read"), "{error}");
    }
}

/// Checks that a scene which is no file is refused before it is opened, with and without MuJoCo.
#[cfg(unix)]
#[test]
fn scene_that_is_no_file_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let pipe = folder.path().join("pipe");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().expect("mkfifo").success());
    for (scene, kind) in
        [(pipe.as_path(), "a pipe"), ("/dev/zero".as_ref(), "a device"), (folder.path(), "a folder")]
    {
        let error = Mujoco::open("libmissing.so".as_ref(), Some(scene)).expect_err("refused").to_string();
        assert!(error.contains(&format!("this is {kind}, not a regular file")), "{error}");
    }
}

/// Checks that a file which a scene includes, directly or by another file, is refused if it is no file, with and without MuJoCo;
/// files that include one another, and a missing one, are left to MuJoCo.
#[cfg(unix)]
#[test]
fn included_file_that_is_no_file_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    assert!(std::process::Command::new("mkfifo").arg(at("pipe.xml")).status().expect("mkfifo").success());
    let write = |name: &str, included: &str| {
        let text = format!("<mujoco><worldbody/><include file=\"{included}\"/></mujoco>");
        std::fs::write(at(name), text).expect("a file");
    };
    write("middle.xml", "pipe.xml");
    write("one.xml", "other.xml");
    write("other.xml", "one.xml");
    for (included, refused) in [
        ("pipe.xml", Some("pipe.xml: the scene cannot be read: this is a pipe, not a regular file")),
        ("middle.xml", Some("pipe.xml: the scene cannot be read: this is a pipe, not a regular file")),
        ("/dev/zero", Some("/dev/zero: the scene cannot be read: this is a device, not a regular file")),
        ("one.xml", None),
        ("missing.xml", None),
    ] {
        write("scene.xml", included);
        let error = Mujoco::open("libmissing.so".as_ref(), Some(&at("scene.xml"))).expect_err("no library");
        let expected = refused.unwrap_or("MuJoCo cannot be opened");
        assert!(error.to_string().contains(expected), "{included}: {error}");
    }
}

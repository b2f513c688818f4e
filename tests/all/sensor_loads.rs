//! Loads of force sensors that follow from the links and tools beyond them.

use crate::cli_common::project;
use crate::common::{Run, run};
use nalgebra::Vector3;
use opspace_backend::CommandKind;
use opspace_experiment::{Experiment, Extensions, FileError, Files, RobotDefinition, RunOptions};
use opspace_loop::RunOutcome;
use opspace_model::{Data, forward_kinematics, frame_placement};
use std::path::Path;

const GRIPPER: &str = "robot.tool.gripper={ on = \"flange\", xyz_m = [0.0, 0.0, 0.12], mass_kg = 1.0, com_m = [0.0, 0.0, 0.05] }";

fn ur5e(settings: &[&str]) -> Result<RobotDefinition, FileError> {
    let settings: Vec<String> = settings.iter().map(|setting| (*setting).to_owned()).collect();
    RobotDefinition::load(Files::Disk, Path::new(&project("robots/ur5e")), &settings)
}

/// Turns the compliant hand of the UR5e by 0.9 rad about x, in 2.5 s of 3 s.
fn turn(backend: CommandKind, settings: &[&str]) -> (Experiment, Run) {
    let own = [
        "environment={}",
        "task.flange.cartesian.axes={ x = \"compliant\", y = \"compliant\", z = \"compliant\", rx = \"motion\", ry = \"motion\", rz = \"motion\" }",
        "task.flange.cartesian.reference={ point-to-point = { orientation = { offset_rpy_rad = [0.9, 0.0, 0.0] }, start_s = 0.2, duration_s = 2.5 } }",
    ];
    let settings: Vec<String> = own.iter().chain(settings).map(|setting| (*setting).to_owned()).collect();
    let path = project("tasks/ur5e-compliant.toml");
    let options = RunOptions { backend, duration_s: Some(3.0), ..RunOptions::default() };
    let experiment = Experiment::load(Files::Disk, Path::new(&path), None, options, &settings)
        .unwrap_or_else(|error| panic!("{error}"));
    let run = run(&experiment);
    assert_eq!(run.ending, RunOutcome::Completed);
    (experiment, run)
}

/// Compared: the largest displacement of the turned hand with a gripper of 1 kg that is stated as a tool alone, and 0.1 m, which is
/// also that of a hand without a tool: if the sensor's load lacked the gripper it would be 0.6 m; and all positions of runs in which
/// the load is stated thrice.
#[test]
fn hand_with_a_tool_does_not_drift_when_it_turns() {
    for backend in [CommandKind::Position, CommandKind::Torque] {
        let (experiment, alone) = turn(backend, &[GRIPPER]);
        let model = &experiment.robot().model;
        let flange = model.frame_id("flange").expect("a flange");
        let mut data = Data::new(model);
        let places: Vec<Vector3<f64>> = alone
            .signal("tick", "q")
            .rows()
            .map(|q| {
                forward_kinematics(model, &mut data, q);
                frame_placement(model, &data, flange).translation
            })
            .collect();
        let drift = places.iter().map(|place| (place - places[0]).norm()).fold(0.0, f64::max);
        assert!(drift < 0.1, "{backend:?}: {drift} m");
        let load = "wrist.load={ mass_kg = 1.0, centre_m = [0.0, 0.0, 0.05] }";
        let stated = [format!("robot.force_sensor.{load}"), format!("robot.simulated.force_sensor.{load}")];
        let (_, thrice) = turn(backend, &[GRIPPER, &stated[0], &stated[1]]);
        assert!(alone.signal("tick", "q").rows().eq(thrice.signal("tick", "q").rows()), "{backend:?}");
    }
}

/// Compared: the load of a sensor, and mass and centre of two tools and a tool on a tool, computed by hand; and the simulated load with
/// true masses that are 1.2 times the nominal ones.
#[test]
fn tools_beyond_a_sensor_are_combined() {
    let turned = "robot.tool.adapter={ on = \"flange\", xyz_m = [0.0, 0.0, 0.1], rpy_rad = [0.0, 1.5707963267948966, 0.0] }";
    let screwdriver = "robot.tool.screwdriver={ on = \"adapter\", mass_kg = 0.5, com_m = [0.2, 0.04, 0.0] }";
    let behind = "robot.tool.cable={ on = \"link_5\", mass_kg = 0.7 }";
    let robot =
        ur5e(&[GRIPPER, turned, screwdriver, behind, "robot.simulated.true_over_nominal.inertia=1.2"]);
    let robot = robot.unwrap_or_else(|error| panic!("{error}"));
    let load = robot.file.force_sensor["wrist"].load.expect("a load");
    // A turn about y: x of the adapter is -z of the flange.
    let centre: Vector3<f64> =
        (Vector3::new(0.0, 0.0, 0.05) + 0.5 * Vector3::new(0.0, 0.04, 0.1 - 0.2)) / 1.5;
    assert!((load.mass_kg.get() - 1.5).abs() < 1e-12, "{load:?}");
    assert!((Vector3::from(load.centre_m) - centre).norm() < 1e-12, "{load:?} {centre}");
    let simulated = robot.file.simulated.expect("a simulated robot");
    let of_sensor = simulated.force_sensor["wrist"].load.clone().expect("a load");
    assert!((of_sensor.mass_kg.get() - 1.8).abs() < 1e-12 && of_sensor.centre_m == load.centre_m);
    assert!(
        ur5e(&[]).is_ok_and(|robot| robot.file.force_sensor["wrist"].load.is_none()),
        "nothing is beyond"
    );
}

/// Checks that a stated load is accepted if it is that of the tool, and refused with both values and keys if not.
#[test]
fn load_that_differs_from_the_tool_is_refused() {
    let same = "robot.force_sensor.wrist.load={ mass_kg = 1.0, centre_m = [0.0, 0.0, 0.05] }";
    assert!(ur5e(&[GRIPPER, same]).is_ok());
    for other in ["mass_kg = 0.8, centre_m = [0.0, 0.0, 0.05]", "mass_kg = 1.0, centre_m = [0.0, 0.0, 0.06]"]
    {
        let setting = format!("robot.force_sensor.wrist.load={{ {other} }}");
        let error = ur5e(&[GRIPPER, &setting]).expect_err("two loads").to_string();
        for part in ["`force_sensor.wrist.load` is", "tool 'gripper'", "1 kg at [0, 0, 0.05] m"] {
            assert!(error.contains(part), "{error}");
        }
    }
}

/// Checks that a sensor before a joint, which moves what is beyond, gets no load and a diagnostic, unless its load is stated.
#[test]
fn moving_load_is_unknown() {
    let found = |settings: &[&str]| {
        let settings: Vec<String> = settings.iter().map(|setting| (*setting).to_owned()).collect();
        let path = project("tasks/ur5e-compliant.toml");
        let options = RunOptions::default();
        let experiment = Experiment::load(Files::Disk, Path::new(&path), None, options, &settings);
        let experiment = experiment.unwrap_or_else(|error| panic!("{error}"));
        let load = experiment.robot().file.force_sensor["wrist"].load;
        let found = opspace_preflight::start_diagnostics(&Extensions::default(), &experiment);
        let found = found.into_iter().find(|finding| finding.code.name() == "unknown-sensor-load");
        (load.is_some(), found.map(|finding| finding.message))
    };
    let before = "robot.force_sensor.wrist.frame=link_5";
    let (has_load, message) = found(&[before]);
    assert!(!has_load && message.is_some_and(|message| message.contains("link 'link_6'")));
    let stated = "robot.force_sensor.wrist.load={ mass_kg = 0.4, centre_m = [0.0, 0.0, 0.0] }";
    assert_eq!(found(&[before, stated]), (true, None));
    assert_eq!(found(&[GRIPPER]), (true, None));
}

//! Templates of common arms, on chains with their shapes.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use opspace_experiment::{FileError, RobotDefinition, Source};
use opspace_model::Model;
use opspace_setup::arm_shape::ArmShape;
use opspace_setup::arm_template::ArmTemplate;
use opspace_setup::new_robot::{DriveValues, KnownMasses, NewFiles, Part, new_files};
use std::f64::consts::FRAC_PI_2;
use std::fmt::Write as _;

/// Angle between axes below which the offset along them belongs to the next one.
const PARALLEL_RAD: f64 = 0.05;

/// URDF of an arm of a shape; the joints are named by `name`. Without a mass in the shape, each link has 1 kg.
fn arm(shape: &ArmShape, name: impl Fn(usize) -> String) -> String {
    let joints = shape.joints();
    let mass = shape.mass_kg.unwrap_or(joints as f64) / joints as f64;
    let mut text = "<robot name=\"arm\"><link name=\"base\"/>".to_owned();
    let mut parent = "base".to_owned();
    let mut offsets = shape.offsets_m.iter();
    for i in 0..joints {
        // Denavit-Hartenberg parameters at joint positions of zero. The place of the first axis, and of the frames along the first and
        // the last one, is arbitrary.
        let before = i.checked_sub(1);
        let (x, twist) = before.map_or((0.1, 0.3), |i| (shape.distances_m[i], shape.twists_rad[i]));
        let is_first =
            before.is_none_or(|pair| shape.twists_rad[..pair].iter().all(|twist| *twist < PARALLEL_RAD));
        let z = match is_first || twist < PARALLEL_RAD {
            true => 0.05,
            false => *offsets.next().unwrap() - before_in_group(shape, i - 1),
        };
        let (range, joint) = (shape.ranges_rad[i], name(i));
        let (kind, limits) = match range.is_finite() {
            true => ("revolute", format!("lower=\"{}\" upper=\"{}\"", -0.5 * range, 0.5 * range)),
            false => ("continuous", String::new()),
        };
        let inertia = 0.005 * mass;
        let _ = write!(
            text,
            "<joint name=\"{joint}\" type=\"{kind}\"><parent link=\"{parent}\"/><child link=\"l{i}\"/>\
             <origin xyz=\"{x} {} {}\" rpy=\"{twist} 0 0\"/><axis xyz=\"0 0 1\"/>\
             <limit {limits} effort=\"1\" velocity=\"1\"/></joint>\
             <link name=\"l{i}\"><inertial><origin xyz=\"0.02 0 0\"/><mass value=\"{mass}\"/>\
             <inertia ixx=\"{inertia}\" iyy=\"{inertia}\" izz=\"{inertia}\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial></link>",
            0.0, z
        );
        parent = format!("l{i}");
    }
    let _ = write!(
        text,
        "<joint name=\"end\" type=\"fixed\"><parent link=\"{parent}\"/><child link=\"tool0\"/>\
         <origin xyz=\"0.1 0.03 0\"/></joint><link name=\"tool0\"/></robot>"
    );
    text
}

/// Offset along a group of parallel axes before its last axis, which is that of joint `last`.
fn before_in_group(shape: &ArmShape, last: usize) -> f64 {
    let pairs = shape.twists_rad[..last].iter().rev();
    0.05 * pairs.take_while(|twist| **twist < PARALLEL_RAD).count() as f64
}

fn numbered(i: usize) -> String {
    format!("j{i}")
}

/// Template of this name, and its shape after a change.
fn changed(name: &str, change: impl Fn(&mut ArmShape)) -> (ArmTemplate, ArmShape) {
    let template = ArmTemplate::named(name).unwrap();
    let mut shape = template.shape.clone();
    change(&mut shape);
    (template, shape)
}

fn made(urdf: &str, template: &ArmTemplate) -> Result<NewFiles, FileError> {
    let source = Source::new("arm.urdf", urdf);
    new_files(&source, "arm.urdf", Part::default(), DriveValues::Template(template))
}

fn robot(urdf: &str, files: &NewFiles) -> RobotDefinition {
    let (toml, urdf) = (Source::new("robot.toml", &*files.robot_toml), Source::new("arm.urdf", urdf));
    RobotDefinition::from_sources(toml, urdf).unwrap_or_else(|error| panic!("{error}\n{}", files.robot_toml))
}

/// Names of the templates that fit a URDF.
fn fitting(urdf: &str) -> Vec<&'static str> {
    let model = Model::from_urdf(urdf).unwrap().model;
    ArmTemplate::fitting(&Source::new("arm.urdf", urdf), &model)
        .unwrap()
        .iter()
        .map(|template| template.name)
        .collect()
}

/// Every template fills in a complete robot file, with a source for each table: the values do not depend on names of joints.
#[test]
fn every_template_completes_a_chain_with_other_names() {
    for template in ArmTemplate::all().unwrap() {
        let names = ["first \"joint\"", "J.2", "joint2", "joint1", "e", "f", "g"];
        let urdf = arm(&template.shape, |i| names[i].replace('"', "&quot;"));
        let files = made(&urdf, &template).unwrap_or_else(|error| panic!("{}: {error}", template.name));
        let robot = robot(&urdf, &files);
        assert!(files.unmatched_joints.is_empty() && !robot.file.assumed.is_empty(), "{}", template.name);
        let limits: Vec<f64> = robot.model.joints().iter().map(|joint| joint.limits.velocity).collect();
        assert!(
            robot.torque_limits().iter().chain(&limits).all(|limit| *limit != 1.0),
            "{}: not those of the URDF",
            template.name
        );
        for section in ["[interface]", "[profile.", "[simulated]"] {
            let (before, _) = files.robot_toml.split_once(section).unwrap();
            let comment = before.trim_end().lines().last().unwrap();
            assert!(comment.starts_with('#'), "{}: {section} has no source: {comment}", template.name);
        }
        assert!(files.robot_toml.contains("[P]") && files.robot_toml.contains("[A]"));
        assert!(!files.robot_toml.contains("[template]"));
    }
}

/// Compared: the template that is recommended for an arm of a shape with the manufacturer's names of joints, and the one of that shape.
#[test]
fn every_arm_gets_its_template() {
    for template in ArmTemplate::all().unwrap() {
        let named = fitting(&arm(&template.shape, |i| template.joints[i].clone()));
        let expected =
            if template.name.starts_with("so101") { vec!["so101", "so101-12v"] } else { vec![template.name] };
        assert_eq!(named, expected);
        // Masses are not compared where a link states none that moves.
        let other = fitting(&arm(&template.shape, numbered));
        assert!(other.contains(&template.name), "{}: {other:?}", template.name);
    }
}

/// Arms whose axes are as far apart in all as those of a template, but not one by one, and arms of other ranges and masses.
#[test]
fn other_arms_get_no_template() {
    let other = |name: &str, change: &dyn Fn(&mut ArmShape)| {
        let (template, shape) = changed(name, change);
        assert_eq!(fitting(&arm(&shape, numbered)), [""; 0], "{name}: {shape:?}");
        // Names do not outweigh the geometry.
        assert_eq!(fitting(&arm(&shape, |i| template.joints[i].clone())), [""; 0], "{name}: {shape:?}");
    };
    other("ur3", &|arm| arm.distances_m = vec![0.077, 0.38, 0.0, 0.0, 0.0]);
    other("ur5", &|arm| arm.distances_m = vec![0.0, 0.46, 0.357, 0.0, 0.0]);
    other("ur5", &|arm| arm.offsets_m = vec![0.12, 0.0946]);
    other("ur5", &|arm| arm.mass_kg = Some(40.0));
    other("j2s6s200", &|arm| arm.twists_rad[4] = 1.0);
    other("j2s6s200", &|arm| arm.offsets_m[1] = 0.45);
    other("xarm7", &|arm| arm.distances_m = vec![0.03, 0.03, 0.042, 0.05, 0.027, 0.027]);
    other("so101", &|arm| arm.distances_m = vec![0.0, 0.15, 0.131, 0.0]);
    other("so101", &|arm| arm.twists_rad[0] = 0.0);
    other("panda", &|arm| arm.ranges_rad[5] = 6.0);
}

/// Names count more than the order; joints that the template does not have are locked.
#[test]
fn joints_are_matched_by_name_and_others_are_locked() {
    let template = ArmTemplate::named("panda").unwrap();
    let urdf = arm(&template.shape, |i| template.joints[i].clone());
    let finger = "<joint name=\"finger\" type=\"prismatic\"><parent link=\"tool0\"/><child link=\"tip\"/>\
                  <axis xyz=\"0 1 0\"/><limit lower=\"0.01\" upper=\"0.04\" effort=\"1\" velocity=\"1\"/></joint>\
                  <link name=\"tip\"><inertial><mass value=\"0.1\"/><inertia ixx=\"1e-4\" iyy=\"1e-4\" izz=\"1e-4\" \
                  ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial></link></robot>";
    let urdf = urdf.replace("</robot>", finger);
    let files = made(&urdf, &template).unwrap();
    assert_eq!(files.unmatched_joints, ["finger"]);
    assert!(files.robot_toml.contains("locked_joints = { finger = 0.01 }"), "{}", files.robot_toml);
    let robot = robot(&urdf, &files);
    assert_eq!(robot.model.n(), 7);
    let coulomb: Vec<f64> = robot.joints().iter().map(|joint| joint.friction.coulomb_nm.get()).collect();
    assert_eq!(coulomb, [0.273, 0.436, 0.320, 0.640, 0.420, 0.152, 0.282]);
    assert_eq!(robot.torque_limits(), [87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0]);
}

/// An error about another arm lists what differs, with the values that are expected and found.
#[test]
fn other_arms_are_refused_with_the_differences() {
    let says = |template: &ArmTemplate, urdf: &str, words: &[&str]| {
        let error = made(urdf, template).unwrap_err();
        let said = format!("{error} {}", error.help().unwrap());
        for word in words {
            assert!(said.contains(word), "{word} in {said}");
        }
    };
    let (ur5, shape) = changed("ur5", |arm| {
        arm.distances_m[1] = 0.48;
        arm.twists_rad[4] = FRAC_PI_2 - 0.5;
        arm.ranges_rad[2] = 14.0;
        arm.mass_kg = Some(40.0);
    });
    let differences = [
        "axes of 'j1' and 'j2' are 0.480 m apart, not 0.425 m",
        "axes of 'j4' and 'j5' at an angle of 61°, not 90°",
        "'j2' turns 14.00 rad, not at most 12.57 rad",
        "40.0 kg from the first joint on, not 17.0 kg",
        "--like-anyway ur5",
    ];
    says(&ur5, &arm(&shape, numbered), &differences);
    let (_, shape) = changed("ur5e", |_| ());
    let differences =
        ["0.133 m along the axis of 'j1', not 0.109 m", "template 'ur5e' (Universal Robots UR5e) fits"];
    says(&ur5, &arm(&shape, numbered), &differences);
    let (panda, shape) = changed("panda", |_| ());
    says(
        &ur5,
        &arm(&shape, numbered),
        &["7 joints in a chain (j0, j1, j2, j3, j4, j5, j6), not 6", "template 'panda'"],
    );
    let slides = arm(&ur5.shape, numbered).replacen("type=\"revolute\"", "type=\"prismatic\"", 1);
    says(&ur5, &slides, &["joint 'j0' is prismatic"]);
    // Limits as those of a narrowed FR3 fit both; then names decide.
    let (fr3, shape) = changed("fr3", |arm| arm.ranges_rad.iter_mut().for_each(|range| *range *= 0.85));
    says(&panda, &arm(&shape, |i| fr3.joints[i].clone()), &["the joints have the names of 'fr3'"]);
    made(&arm(&shape, numbered), &panda).unwrap();
    let unknown = ArmTemplate::named("ur6").unwrap_err();
    assert!(
        unknown.to_string().contains("no template 'ur6'") && unknown.help().unwrap().contains("ur10"),
        "{unknown}"
    );
}

/// Another arm gets the interface and the rates of a template as assumed values, and no value of its drives.
#[test]
fn interface_of_another_arm_is_assumed() {
    for template in ArmTemplate::all().unwrap() {
        let (_, shape) = changed("ur5", |arm| arm.distances_m[1] = 0.7);
        let urdf = arm(&shape, numbered);
        let source = Source::new("arm.urdf", &*urdf);
        let files =
            new_files(&source, "arm.urdf", Part::default(), DriveValues::InterfaceOf(&template)).unwrap();
        let (mine, own) = (robot(&urdf, &files), made(&arm(&template.shape, numbered), &template).unwrap());
        let own = robot(&arm(&template.shape, numbered), &own);
        assert!(!files.robot_toml.contains("[P]"), "{}", files.robot_toml);
        assert_eq!(mine.file.interface.command, own.file.interface.command);
        assert_eq!(mine.file.interface.measured, own.file.interface.measured);
        let rate = |robot: &RobotDefinition, name: &str| robot.file.profile[name].period_s();
        assert_eq!(rate(&mine, "default"), rate(&own, &own.file.default_profile), "{}", template.name);
        assert!(
            ["interface", "profile.default", "simulated"].iter().all(|key| mine
                .file
                .assumed
                .iter()
                .any(|a| a == key))
        );
    }
}

/// Compared: the servos that are assumed for an arm of the size of a ViperX, for one of the size of a UR5, and for a small one of
/// which the URDF has no masses.
#[test]
fn small_arms_get_hobby_servos() {
    const BUS_PERIOD_S: f64 = 0.01;
    const INDUSTRIAL_PERIOD_S: f64 = 0.001;
    let assumed = |urdf: &str| {
        let source = Source::new("arm.urdf", urdf);
        let values = DriveValues::Assumed(KnownMasses::default());
        new_files(&source, "arm.urdf", Part::default(), values).unwrap()
    };
    let of = |name: &str| {
        let template = ArmTemplate::named(name).unwrap();
        arm(&template.shape, numbered)
    };
    let massless = |urdf: &str| -> String {
        let parts =
            urdf.split("<inertial>").map(|part| part.split_once("</inertial>").map_or(part, |(_, end)| end));
        parts.collect()
    };
    for (urdf, is_hobby) in
        [(of("vx300s"), true), (of("so101"), true), (of("ur5"), false), (massless(&of("so101")), false)]
    {
        let files = assumed(&urdf);
        let robot = robot(&urdf, &files);
        let profile = &robot.file.profile["default"];
        for servo in robot.servos(profile) {
            assert_eq!(servo.name(), if is_hobby { "pid" } else { "cascaded" });
        }
        assert_eq!(profile.period_s(), if is_hobby { BUS_PERIOD_S } else { INDUSTRIAL_PERIOD_S });
        assert_eq!(files.notes.iter().any(|note| note.contains("hobby servos are assumed")), is_hobby);
        assert_eq!(robot.joints()[0].setpoint_resolution_rad.is_some(), is_hobby);
        let sizes = robot.torque_limits();
        assert!(!is_hobby || sizes.iter().all(|limit| *limit <= 33.1), "{sizes:?}");
    }
}

/// Compared: the servos of the SO-101 at both voltages, and what is published of them.
#[test]
fn so101_is_a_spring_without_damping() {
    for (name, stiffness) in [("so101", 8.9), ("so101-12v", 22.0)] {
        let template = ArmTemplate::named(name).unwrap();
        let urdf = arm(&template.shape, |i| template.joints[i].clone());
        let robot = robot(&urdf, &made(&urdf, &template).unwrap());
        let profile = robot.file.profile.values().next().unwrap();
        for servo in robot.servos(profile) {
            let gains = servo.gains(profile.servo_period_s());
            assert_eq!((servo.name(), gains.stiffness, gains.damping), ("pid", stiffness, 0.0));
        }
    }
}

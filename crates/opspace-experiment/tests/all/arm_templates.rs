//! Templates of common arms, on chains with their dimensions.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use opspace_experiment::setup::arm_template::ArmTemplate;
use opspace_experiment::setup::new_robot::{DriveValues, NewFiles, Part, new_files};
use opspace_experiment::{FileError, RobotDefinition, Source};
use std::fmt::Write as _;

/// URDF of a chain of rotating joints whose successive axes are `distances_m` apart in all; the joints are named by `name`.
fn chain(joints: usize, distances_m: f64, name: impl Fn(usize) -> String) -> String {
    let mut text = "<robot name=\"chain\"><link name=\"base\"/>".to_owned();
    let mut parent = "base".to_owned();
    for i in 0..joints {
        // The axes alternate between z and y, and a link between them is along x: their distance is that along x. The offset
        // along the axis of the joint before does not count.
        let x = if i == 0 { 0.0 } else { distances_m / (joints - 1) as f64 };
        let (origin, axis) =
            if i % 2 == 0 { (format!("{x} 0.05 0"), "0 0 1") } else { (format!("{x} 0 0.1"), "0 1 0") };
        let (joint, mass) = (name(i), 2.0 / (i + 1) as f64);
        let _ = write!(
            text,
            "<joint name=\"{joint}\" type=\"revolute\"><parent link=\"{parent}\"/><child link=\"l{i}\"/>\
             <origin xyz=\"{origin}\"/><axis xyz=\"{axis}\"/>\
             <limit lower=\"-2.8\" upper=\"2.8\" effort=\"1\" velocity=\"1\"/></joint>\
             <link name=\"l{i}\"><inertial><origin xyz=\"0.05 0 0\"/><mass value=\"{mass}\"/>\
             <inertia ixx=\"0.002\" iyy=\"0.002\" izz=\"0.002\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial></link>"
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

fn made(urdf: &str, template: &ArmTemplate) -> Result<NewFiles, FileError> {
    let source = Source::new("arm.urdf", urdf);
    new_files(&source, "arm.urdf", Part::default(), DriveValues::Template(template))
}

fn robot(urdf: &str, files: &NewFiles) -> RobotDefinition {
    let (toml, urdf) = (Source::new("robot.toml", &*files.robot_toml), Source::new("arm.urdf", urdf));
    RobotDefinition::from_sources(toml, urdf).unwrap_or_else(|error| panic!("{error}\n{}", files.robot_toml))
}

/// Every template fills in a complete robot file, with a source for each table: the values do not depend on names of joints.
#[test]
fn every_template_completes_a_chain_with_other_names() {
    for template in ArmTemplate::all().unwrap() {
        let names = ["first \"joint\"", "J.2", "joint2", "joint1", "e", "f", "g"];
        let urdf =
            chain(template.joints.len(), template.axis_distances_m, |i| names[i].replace('"', "&quot;"));
        let files = made(&urdf, &template).unwrap_or_else(|error| panic!("{}: {error}", template.name));
        let robot = robot(&urdf, &files);
        assert!(files.unmatched_joints.is_empty() && !robot.file.assumed.is_empty(), "{}", template.name);
        let limits: Vec<f64> = robot.model.joints().iter().map(|joint| joint.limits.velocity).collect();
        assert!(
            robot.torque_limits().iter().chain(&limits).all(|limit| *limit != 1.0),
            "not those of the URDF"
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

/// Names count more than the order; joints that the template does not have are locked.
#[test]
fn joints_are_matched_by_name_and_others_are_locked() {
    let template = ArmTemplate::named("panda").unwrap();
    let urdf = chain(7, template.axis_distances_m, |i| template.joints[i].clone());
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

#[test]
fn other_arms_are_refused_with_what_is_expected() {
    let template = ArmTemplate::named("ur5").unwrap();
    let says = |urdf: &str, words: &[&str]| {
        let error = made(urdf, &template).unwrap_err();
        let said = format!("{error} {}", error.help().unwrap());
        for word in words {
            assert!(said.contains(word), "{word} in {said}");
        }
    };
    let name = |i: usize| format!("j{i}");
    says(&chain(6, 1.184, name), &["0.817 m apart in all", "1.184 m", "template 'ur10' fits"]);
    says(&chain(6, 3.0, name), &["use --assume for another arm"]);
    says(
        &chain(7, 0.817, name),
        &[
            "an arm of 6 joints in a chain (shoulder_pan_joint, ",
            "has 7: j0, j1",
            "--from LINK and --to LINK",
        ],
    );
    let slides = chain(6, 0.817, name).replacen("type=\"revolute\"", "type=\"prismatic\"", 1);
    says(&slides, &["joint 'j0' is prismatic"]);
    let unknown = ArmTemplate::named("ur6").unwrap_err();
    assert!(
        unknown.to_string().contains("no template 'ur6'") && unknown.help().unwrap().contains("ur10"),
        "{unknown}"
    );
}

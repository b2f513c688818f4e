//! Models from the types of urdf-rs, compared with models from text.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use opspace_model::{Model, UrdfErrorKind, UrdfOptions};
use std::fs;
use std::path::Path;
use urdf_rs::{Joint, Robot};

const ROBOTS: [&str; 4] = ["asimo-arm", "panda", "planar-2-link", "ur5e"];

fn text(robot: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../robots").join(robot);
    fs::read_to_string(folder.join(robot).with_extension("urdf")).unwrap()
}

fn panda() -> Robot {
    urdf_rs::read_from_string(&text("panda")).unwrap()
}

/// Returns the first moving joint of the robot.
fn moving(robot: &mut Robot) -> &mut Joint {
    robot.joints.iter_mut().find(|joint| joint.joint_type != urdf_rs::JointType::Fixed).unwrap()
}

fn refused(robot: &Robot) -> UrdfErrorKind {
    let error = Model::from_urdf_rs(robot, UrdfOptions::default()).unwrap_err();
    assert_eq!(error.line(), None);
    error.kind().clone()
}

/// Compared: the models that this crate's reader and urdf-rs make of a file, fixed to the world and floating, bit by
/// bit (numbers are printed in the shortest form that reads back as the same bits).
#[test]
fn models_from_text_and_urdf_rs_are_identical() {
    for robot in ROBOTS {
        let text = text(robot);
        let parsed = urdf_rs::read_from_string(&text).unwrap();
        for floating_base in [false, true] {
            let options = UrdfOptions { floating_base, ..UrdfOptions::default() };
            let from_text = Model::from_urdf_with(&text, options).unwrap();
            let from_types = Model::from_urdf_rs(&parsed, options).unwrap();
            assert_eq!(format!("{:?}", from_types.model), format!("{:?}", from_text.model), "{robot}");
            assert_eq!(from_types.standing_kg.to_bits(), from_text.standing_kg.to_bits(), "{robot}");
            let kinds = |warnings: &[opspace_model::UrdfWarning]| {
                let mut kinds: Vec<String> = warnings.iter().map(|w| format!("{:?}", w.kind())).collect();
                kinds.sort();
                kinds
            };
            assert_eq!(kinds(&from_types.warnings), kinds(&from_text.warnings), "{robot}");
        }
    }
}

#[test]
fn nan_mass_is_refused() {
    let mut robot = panda();
    let link = robot.links.iter_mut().find(|link| link.inertial.mass.value > 0.0).unwrap();
    link.inertial.mass.value = f64::NAN;
    let expected = format!("link '{}'", link.name);
    let UrdfErrorKind::BadNumber { element, place, value, .. } = refused(&robot) else { panic!() };
    assert_eq!((element, place.as_str(), value.as_str()), (expected, "<mass value>", "NaN"));
}

#[test]
fn negative_mass_is_refused() {
    let mut robot = panda();
    robot.links[1].inertial.mass.value = -1.0;
    assert!(matches!(refused(&robot), UrdfErrorKind::NegativeMass { mass: -1.0, .. }));
}

#[test]
fn negative_inertia_is_refused() {
    let mut robot = panda();
    robot.links[1].inertial.inertia.ixx = -1.0;
    assert!(matches!(refused(&robot), UrdfErrorKind::NegativeInertia { .. }));
}

#[test]
fn infinite_origin_is_refused() {
    let mut robot = panda();
    moving(&mut robot).origin.xyz.0[1] = f64::INFINITY;
    let UrdfErrorKind::BadNumber { place, .. } = refused(&robot) else { panic!() };
    assert_eq!(place, "<origin xyz>");
}

#[test]
fn missing_parent_link_is_refused() {
    let mut robot = panda();
    moving(&mut robot).parent.link = "nowhere".to_owned();
    let UrdfErrorKind::UnknownLink { role, link, known, .. } = refused(&robot) else { panic!() };
    assert_eq!((role, link.as_str(), known.len()), ("parent", "nowhere", robot.links.len()));
}

#[test]
fn two_roots_are_refused() {
    let mut robot = panda();
    let joint = robot.joints.remove(0);
    let UrdfErrorKind::SeveralRoots { links } = refused(&robot) else { panic!() };
    assert!(links.len() == 2 && links.contains(&joint.child.link), "{links:?}");
}

#[test]
fn joint_without_limits_is_refused() {
    let mut robot = panda();
    moving(&mut robot).limit = urdf_rs::JointLimit::default();
    let UrdfErrorKind::Missing { missing, .. } = refused(&robot) else { panic!() };
    assert_eq!(missing, "<limit>");
}

#[test]
fn unknown_mimic_joint_is_refused() {
    let mut robot = panda();
    let last = robot.joints.iter_mut().rfind(|joint| joint.joint_type != urdf_rs::JointType::Fixed).unwrap();
    last.mimic = Some(urdf_rs::Mimic { joint: "nobody".to_owned(), multiplier: None, offset: None });
    let options = UrdfOptions { enforce_mimic: true, ..UrdfOptions::default() };
    let error = Model::from_urdf_rs(&robot, options).unwrap_err();
    let UrdfErrorKind::UnknownLeader { leader, .. } = error.kind() else { panic!("{error}") };
    assert_eq!((leader.as_str(), error.line()), ("nobody", None));
}

#[test]
fn duplicate_link_names_are_refused() {
    let mut robot = panda();
    robot.links[1].name = robot.links[0].name.clone();
    assert!(matches!(refused(&robot), UrdfErrorKind::DuplicateName { first_line: None, .. }));
}

#[test]
fn floating_joint_is_refused() {
    let mut robot = panda();
    moving(&mut robot).joint_type = urdf_rs::JointType::Floating;
    let UrdfErrorKind::JointType { found, .. } = refused(&robot) else { panic!() };
    assert_eq!(found, "floating");
}

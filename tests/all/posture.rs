//! `opspace model --q`: frames, Jacobian, weight and effective masses in a posture, against closed forms of the planar arm.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use crate::cli_common::{opspace, project, read, scratch};
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Rounding of a few products.
const TOLERANCE: f64 = 1e-9;

#[track_caller]
fn is_near(value: &Value, expected: f64, about: &str) {
    let value = value.as_f64().unwrap_or_else(|| panic!("{about}: {value}"));
    assert!(
        (value - expected).abs() < TOLERANCE * expected.abs().max(1.0),
        "{about}: {value}, not {expected}"
    );
}

fn posture(robot: &str, options: &[&str]) -> Value {
    let folder = scratch();
    let arguments = [&["model", robot, "--json", "-"], options].concat();
    opspace(folder.path(), &arguments).exits(0).json()["posture"].clone()
}

/// Compared: the URDF's head has the closed forms of M and g (Craig, ch. 6); position, Jacobian and mobility follow from them by
/// hand. Links of 1 m and 1 kg, q1 from x towards z.
#[test]
fn planar_arm_has_the_figures_of_the_textbook() {
    let (q1, q2) = (0.6_f64, 1.2_f64);
    let shown = posture(&project("robots/planar-2-link/planar-2-link.urdf"), &["--q", "0.6,1.2"]);
    assert_eq!((&shown["source"], &shown["frame"]), (&"--q".into(), &"tip".into()));
    let tip = shown["frames"].as_array().unwrap().iter().find(|frame| frame["name"] == "tip").unwrap();
    let (x, z) = (q1.cos() + (q1 + q2).cos(), q1.sin() + (q1 + q2).sin());
    for (axis, expected) in [x, 0.0, z].into_iter().enumerate() {
        is_near(&tip["position_m"][axis], expected, "position of the tip");
    }
    // About -y by q1 + q2.
    let half = 0.5 * (q1 + q2);
    for (i, expected) in [0.0, -half.sin(), 0.0, half.cos()].into_iter().enumerate() {
        is_near(&tip["quaternion_xyzw"][i], expected, "orientation of the tip");
    }

    let g = 9.81;
    let weight = [g * (1.5 * q1.cos() + 0.5 * (q1 + q2).cos()), g * 0.5 * (q1 + q2).cos()];
    for (i, (expected, limit)) in weight.into_iter().zip([60.0, 20.0]).enumerate() {
        is_near(&shown["joints"][i]["gravity_torque"], expected, "weight");
        is_near(&shown["joints"][i]["of_limit"], expected.abs() / limit, "of the limit");
    }

    // J M⁻¹ Jᵀ of the rows x and z, with the inverse of a 2 × 2 matrix.
    let [m11, m12, m22] = [5.0 / 3.0 + q2.cos(), 1.0 / 3.0 + 0.5 * q2.cos(), 1.0 / 3.0];
    let det = m11 * m22 - m12 * m12;
    let effective =
        |row: [f64; 2]| det / (row[0] * row[0] * m22 - 2.0 * row[0] * row[1] * m12 + row[1] * row[1] * m11);
    let (jx, jz) = ([-z, -(q1 + q2).sin()], [x, (q1 + q2).cos()]);
    is_near(&shown["effective_mass"]["x"], effective(jx), "mass in x");
    is_near(&shown["effective_mass"]["z"], effective(jz), "mass in z");
    is_near(&shown["effective_mass"]["ry"], effective([1.0, 1.0]), "inertia about y");
    for axis in ["y", "rx", "rz"] {
        assert!(shown["effective_mass"][axis].is_null(), "the arm cannot move along {axis}");
    }
    // It cannot move in y: the linear rows are singular.
    assert!(shown["jacobian"]["linear"]["condition"].is_null());
    is_near(&shown["jacobian"]["length_m"], 2.0, "reach");
}

/// Compared: singular values of a 3 × 3 Jacobian of three sliding joints along orthogonal axes are 1.
#[test]
fn three_sliding_joints_are_well_conditioned() {
    let mut urdf = "<robot name=\"r\"><link name=\"l0\"/>".to_owned();
    for (i, axis) in ["1 0 0", "0 1 0", "0 0 1"].into_iter().enumerate() {
        let (parent, child) = (i, i + 1);
        urdf += &format!(
            "<joint name=\"j{i}\" type=\"prismatic\"><parent link=\"l{parent}\"/><child link=\"l{child}\"/><axis xyz=\"{axis}\"/>\
             <limit lower=\"0\" upper=\"0.4\" effort=\"0\" velocity=\"1\"/></joint><link name=\"l{child}\"><inertial><mass value=\"2\"/>\
             <inertia ixx=\"0.01\" iyy=\"0.01\" izz=\"0.01\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial></link>"
        );
    }
    let folder = scratch();
    let path = folder.path().join("r.urdf");
    fs::write(&path, urdf + "</robot>").unwrap();
    let shown = posture(path.to_str().unwrap(), &["--q", "j1=0.1"]);
    is_near(&shown["jacobian"]["linear"]["condition"], 1.0, "condition");
    assert_eq!(shown["source"], "j1 from --q; other joints: middle of each range");
    assert_eq!(shown["q"], serde_json::json!([0.2, 0.1, 0.2]));
    for (axis, kg) in [("x", 6.0), ("y", 4.0), ("z", 2.0)] {
        is_near(&shown["effective_mass"][axis], kg, axis);
    }
    is_near(&shown["joints"][2]["gravity_torque"], 2.0 * 9.81, "weight");
    assert!(shown["joints"][2]["of_limit"].is_null(), "an effort of 0 is no limit");
    assert!(shown["jacobian"]["angular"]["condition"].is_null());
}

#[test]
fn posture_is_that_of_the_first_task_or_named() {
    let folder = scratch();
    let urdf = project("robots/planar-2-link/planar-2-link.urdf");
    opspace(folder.path(), &["new", "mine", "--urdf", &urdf, "--assume"]).exits(0);
    let text = opspace(folder.path(), &["model", "mine"]).exits(0).stdout;
    assert!(text.contains("posture: start of mine/first-task.toml"), "{text}");
    for words in ["effective mass", "condition of the Jacobian", "weight", "roll"] {
        assert!(text.contains(words), "{words} in {text}");
    }
    let task = folder.path().join("mine/first-task.toml");
    fs::write(&task, read(&task).replace("shoulder =", "shuolder =")).unwrap();
    let text = opspace(folder.path(), &["model", "mine"]).exits(0).stdout;
    assert!(text.contains("posture: middle of each range; mine/first-task.toml does not fit"), "{text}");

    let wrong = |options: &[&str], words: &[&str]| {
        let arguments = [&["model", urdf.as_str()], options].concat();
        opspace(folder.path(), &arguments).exits(2).says(words);
    };
    wrong(&["--q", "0.1"], &["--q has 1 values; the robot needs 2: shoulder, elbow"]);
    wrong(&["--q", "elbw=0.1"], &["no joint 'elbw'", "did you mean 'elbow'?", "shoulder, elbow"]);
    wrong(&["--q", "0.1,elbow=0.2"], &["not both"]);
    wrong(&["--q", "nan,0"], &["'nan' is not a finite number"]);
    wrong(&["--frame", "tipp"], &["--frame tipp", "did you mean 'tip'?"]);
    let panda = project("robots/panda");
    let outside = opspace(folder.path(), &["model", &panda, "--q", "joint4=1.0"]).exits(0).stdout;
    assert!(outside.contains("joint 'joint4' at 1 is outside its limits"), "{outside}");
    opspace(folder.path(), &["model", &urdf, "--q", "-0.1,-0.2"]).exits(0);
}

/// Compared: poses of the UR5e by forward kinematics of the printed `start_rad`, and those that were asked for.
#[test]
fn posture_is_found_for_a_place() {
    let robot = project("robots/ur5e");
    for at in ["0.4,0.2,0.3", "0.4,0.2,0.3,3.1,0.1,0.5", "-0.3,-0.4,0.5"] {
        let shown = posture(&robot, &["--at", at]);
        let frame = shown["frame"].as_str().unwrap();
        let found = shown["frames"].as_array().unwrap().iter().find(|row| row["name"] == frame).unwrap();
        let numbers: Vec<f64> = at.split(',').map(|number| number.parse().unwrap()).collect();
        let values =
            found["position_m"].as_array().unwrap().iter().chain(found["rpy_rad"].as_array().unwrap());
        for (asked, value) in numbers.iter().zip(values) {
            assert!((value.as_f64().unwrap() - asked).abs() < 2e-3, "{at}: {found}");
        }
    }
    let text = opspace(Path::new(&robot), &["model", ".", "--at", "0.4,0.2,0.3"]).exits(0).stdout;
    let line = text.lines().find(|line| line.starts_with("start_rad = { ")).unwrap();
    assert!(line.contains("base = ") && line.contains("wrist_3 = "), "{line}");
    let wrong = |at: &str, words: &[&str]| {
        opspace(Path::new(&robot), &["model", ".", "--at", at]).exits(2).says(words);
    };
    wrong("3.0,0.0,0.0", &["no posture within the joint limits", "m away"]);
    wrong("0.1,0.2", &["--at has 2 values", "x,y,z"]);
}

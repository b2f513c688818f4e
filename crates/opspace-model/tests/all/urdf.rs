//! Errors, warnings and models of the URDF reader.
#![expect(clippy::expect_used, clippy::unwrap_used, reason = "a test")]

use nalgebra::{Matrix3, Vector3};
use opspace_model::{
    Data, JointKind, Limits, Model, UrdfChanges, UrdfError, UrdfOptions, frame_placement, kinematics,
};

/// A base, an arm with two moving links, and a tool fixed to the second link. Each test changes one piece of this text.
const ARM: &str = r#"<?xml version="1.0"?>
<!-- an arm -->
<robot name="arm">
  <link name="base"/>
  <link name="upper">
    <inertial>
      <origin xyz="0 0 0.1" rpy="0 0 0"/>
      <mass value="2"/>
      <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.01"/>
    </inertial>
  </link>
  <link name="lower">
    <inertial>
      <mass value="1"/>
      <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>
    </inertial>
  </link>
  <link name="tool"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/>
    <child link="upper"/>
    <axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" velocity="3" effort="40"/>
  </joint>
  <joint name="elbow" type="prismatic">
    <origin xyz="0 0 0.3" rpy="0 0 0"/>
    <parent link="upper"/>
    <child link="lower"/>
    <axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" velocity="2" effort="20"/>
  </joint>
  <joint name="flange" type="fixed">
    <origin xyz="0 0 0.2" rpy="0 0 0"/>
    <parent link="lower"/>
    <child link="tool"/>
  </joint>
</robot>
"#;

/// Returns [`ARM`] with the first occurrence of `from` replaced by `to`.
fn arm_with(from: &str, to: &str) -> String {
    assert!(ARM.contains(from), "no {from} in the arm");
    ARM.replacen(from, to, 1)
}

/// Returns [`ARM`] with more elements at its end.
fn arm_and(more: &str) -> String {
    arm_with("</robot>", &format!("{more}</robot>"))
}

/// Returns the first line of `text` that contains `needle`.
fn line_of(text: &str, needle: &str) -> u32 {
    let before = &text[..text.find(needle).expect(needle)];
    u32::try_from(before.lines().count().max(1)).unwrap()
}

/// Asserts that the file is refused with an error that contains all these words.
fn refused(text: &str, words: &[&str]) -> UrdfError {
    let error = Model::from_urdf(text).expect_err("it should be refused");
    let said = error.to_string();
    for word in words {
        assert!(said.contains(word), "\"{said}\" doesn't say \"{word}\"");
    }
    if let Some(line) = error.line() {
        assert!(said.starts_with(&format!("line {line}: ")), "{said}");
    }
    error
}

/// Asserts that [`ARM`] with the first `from` replaced by `to` is refused, by an error that contains these words and
/// has the line of `to`.
fn refused_with(from: &str, to: &str, words: &[&str]) {
    let text = arm_with(from, to);
    let error = refused(&text, words);
    assert_eq!(error.line(), Some(line_of(&text, to)), "{error}");
}

macro_rules! refusals {
    ($($name:ident: $from:expr => $to:expr, $words:expr;)*) => { $(
        #[test]
        fn $name() {
            refused_with($from, $to, &$words);
        }
    )* };
}

const LOWER_MASS: &str = r#"<mass value="1"/>"#;
const LOWER_INERTIA: &str = r#"<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>"#;
const ELBOW_LIMIT: &str = r#"<limit lower="-1" upper="1" velocity="2" effort="20"/>"#;
const ELBOW_AXIS: &str = r#"<axis xyz="0 1 0"/>"#;
const ELBOW_ORIGIN: &str = r#"<origin xyz="0 0 0.3" rpy="0 0 0"/>"#;
const ELBOW: &str = r#"<joint name="elbow" type="prismatic">"#;

refusals! {
    // Numbers.
    refuses_non_numeric_mass: LOWER_MASS => r#"<mass value="one"/>"#,
        ["link 'lower'", "<mass value>", "\"one\"", "one finite number"];
    refuses_nan_mass: LOWER_MASS => r#"<mass value="nan"/>"#, ["link 'lower'", "<mass value>", "nan", "finite"];
    refuses_negative_mass: LOWER_MASS => r#"<mass value="-1"/>"#, ["link 'lower'", "-1 kg", "negative"];
    refuses_mass_without_value: LOWER_MASS => "<mass/>", ["link 'lower'", "no <mass value>", "<mass value=\"...\"/>"];
    refuses_infinite_moment_of_inertia: r#"izz="0.01""# => r#"izz="inf""#, ["link 'upper'", "<inertia izz>", "inf"];
    refuses_inertia_with_five_moments: LOWER_INERTIA => r#"<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0"/>"#,
        ["link 'lower'", "no <inertia izz>", "ixx ixy ixz iyy iyz izz"];
    refuses_negative_moment_of_inertia: LOWER_INERTIA =>
        r#"<inertia ixx="-0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/>"#,
        ["link 'lower'", "positive semi-definite", "-0.1"];
    refuses_inertia_indefinite_by_its_products: LOWER_INERTIA =>
        r#"<inertia ixx="0.1" ixy="0.2" ixz="0" iyy="0.1" iyz="0" izz="0.1"/>"#,
        ["link 'lower'", "positive semi-definite"];
    refuses_infinite_origin: ELBOW_ORIGIN => r#"<origin xyz="0 inf 0"/>"#,
        ["joint 'elbow'", "<origin xyz>", "three finite numbers"];
    refuses_nan_rotation: ELBOW_ORIGIN => r#"<origin rpy="0 nan 0"/>"#, ["joint 'elbow'", "<origin rpy>", "nan"];
    refuses_origin_with_four_numbers: ELBOW_ORIGIN => r#"<origin xyz="0 0 0 1"/>"#, ["joint 'elbow'", "three finite numbers"];
    refuses_quaternion: ELBOW_ORIGIN => r#"<origin quat_xyzw="0 0 0 1"/>"#, ["joint 'elbow'", "quat_xyzw", "rpy"];
    // Axes.
    refuses_zero_axis: ELBOW_AXIS => r#"<axis xyz="0 0 0"/>"#,
        ["joint 'elbow'", "axis is zero", "xyz=\"0 0 1\""];
    refuses_non_numeric_axis: ELBOW_AXIS => r#"<axis xyz="0 0 x"/>"#,
        ["joint 'elbow'", "<axis xyz>", "\"0 0 x\"", "three finite numbers"];
    refuses_axis_with_two_numbers: ELBOW_AXIS => r#"<axis xyz="0 1"/>"#, ["joint 'elbow'", "\"0 1\"", "three finite numbers"];
    refuses_infinite_axis: ELBOW_AXIS => r#"<axis xyz="0 inf 0"/>"#, ["joint 'elbow'", "three finite numbers"];
    refuses_axis_without_direction: ELBOW_AXIS => "<axis/>", ["joint 'elbow'", "no <axis xyz>", "0 0 1"];
    // Limits.
    refuses_swapped_limits: ELBOW_LIMIT => r#"<limit lower="1" upper="-1" velocity="2" effort="20"/>"#,
        ["joint 'elbow'", "lower limit 1", "upper limit -1", "swap"];
    refuses_limit_without_lower: ELBOW_LIMIT => r#"<limit upper="1" velocity="2" effort="20"/>"#,
        ["joint 'elbow'", "no <limit lower>", "<limit lower=\"...\" upper=\"...\""];
    refuses_limit_without_upper: ELBOW_LIMIT => r#"<limit lower="-1" velocity="2" effort="20"/>"#,
        ["joint 'elbow'", "no <limit upper>"];
    refuses_infinite_limit: ELBOW_LIMIT => r#"<limit lower="-inf" upper="1"/>"#,
        ["joint 'elbow'", "<limit lower>", "-inf", "finite"];
    refuses_nan_effort: ELBOW_LIMIT => r#"<limit lower="-1" upper="1" effort="nan"/>"#,
        ["joint 'elbow'", "<limit effort>", "nan"];
    // Joints.
    refuses_floating_joint: ELBOW => r#"<joint name="elbow" type="floating">"#,
        ["joint 'elbow'", "\"floating\"", "not supported", "revolute, continuous, prismatic and fixed"];
    refuses_planar_joint: ELBOW => r#"<joint name="elbow" type="planar">"#,
        ["joint 'elbow'", "\"planar\"", "not supported", "revolute, continuous, prismatic and fixed"];
    refuses_unknown_joint_type: ELBOW => r#"<joint name="elbow" type="hinge">"#,
        ["joint 'elbow'", "\"hinge\"", "not supported", "revolute, continuous, prismatic and fixed"];
    refuses_joint_without_type: ELBOW => r#"<joint name="elbow">"#, ["joint 'elbow'", "no <joint type>", "revolute"];
    refuses_joint_without_name: ELBOW => r#"<joint type="prismatic">"#, ["<joint>", "no name", "name=\"...\""];
    refuses_duplicate_joint_name: ELBOW => r#"<joint name="shoulder" type="prismatic">"#,
        ["joint 'shoulder'", "line 19", "unique"];
    refuses_duplicate_axis: ELBOW_AXIS => r#"<axis xyz="0 1 0"/><axis xyz="0 1 0"/>"#,
        ["joint 'elbow'", "more than one <axis>"];
    // Links.
    refuses_duplicate_link_name: r#"<link name="tool"/>"# => r#"<link name="base"/><link name="lower"/>"#,
        ["link 'base'", "line 4", "unique"];
    refuses_link_without_name: r#"<link name="tool"/>"# => "<link/>", ["<link>", "no name"];
    // Formats.
    refuses_xacro_expression: ELBOW_ORIGIN => r#"<origin xyz="0 0 ${length}"/>"#,
        ["xacro", "0 0 ${length}", "xacro FILE.xacro > FILE.urdf"];
    refuses_xacro_argument: LOWER_MASS => r#"<mass value="$(arg mass)"/>"#,
        ["$(arg mass)", "xacro FILE.xacro > FILE.urdf"];
    refuses_xacro_element_without_namespace: r#"<link name="tool"/>"# => r#"<xacro:tool/>"#,
        ["<xacro:", "xacro FILE.xacro > FILE.urdf"];
}

#[test]
fn refuses_moving_link_without_inertial() {
    let start = ARM.find("<link name=\"lower\">").unwrap();
    let end = start + ARM[start..].find("</link>").unwrap() + "</link>".len();
    let text = format!("{}<link name=\"lower\"/>{}", &ARM[..start], &ARM[end..]);
    let error =
        refused(&text, &["joint 'elbow'", "link 'lower'", "no mass", "<inertial>", "make the joint fixed"]);
    assert_eq!(error.line(), Some(line_of(&text, ELBOW)));
}

/// Numbers whose products could overflow: 1e9 is more than any robot has.
#[test]
fn refuses_numbers_beyond_any_robot() {
    let text = arm_with(ELBOW_ORIGIN, r#"<origin xyz="1e308 0 0" rpy="0.7 0.7 0.7"/>"#);
    let error = refused(&text, &["joint 'elbow'", "<origin xyz>", "three numbers from -1e9 to 1e9"]);
    assert_eq!(error.line(), Some(line_of(&text, r#"<origin xyz="1e308"#)));
    refused(&arm_with(ELBOW_ORIGIN, r#"<origin rpy="0 1e10 0"/>"#), &["<origin rpy>", "from -1e4 to 1e4"]);
    refused(
        &arm_with(LOWER_MASS, r#"<mass value="1e10"/>"#),
        &["<mass value>", "one number from -1e9 to 1e9"],
    );
}

/// Numbers that no file means: rounding errors in place of a mass or an axis, and angles of many turns. They have their line.
#[test]
fn refuses_numbers_that_nobody_means() {
    for (old, new, words) in [
        (LOWER_MASS, r#"<mass value="1e-300"/>"#, ["<mass value>", "1e-300", "0, or one number from 1e-15"]),
        (ELBOW_AXIS, r#"<axis xyz="0 1e-320 0"/>"#, ["<axis xyz>", "1e-320", "at least 1e-9"]),
        (ELBOW_ORIGIN, r#"<origin rpy="0 0 1e8"/>"#, ["<origin rpy>", "100000000", "from -1e4 to 1e4"]),
        (ELBOW_ORIGIN, r#"<origin rpy="1e300 0 0"/>"#, ["<origin rpy>", "1e300", "from -1e4 to 1e4"]),
    ] {
        let text = arm_with(old, new);
        assert_eq!(refused(&text, &words).line(), Some(line_of(&text, new)), "{new}");
    }
    for (old, new) in [(LOWER_MASS, r#"<mass value="1e-12"/>"#), (ELBOW_AXIS, r#"<axis xyz="0 1e-6 0"/>"#)] {
        Model::from_urdf(&arm_with(old, new)).unwrap();
    }
}

#[test]
fn refuses_moving_link_of_zero_mass() {
    refused(&arm_with(LOWER_MASS, r#"<mass value="0"/>"#), &["joint 'elbow'", "link 'lower'", "no mass"]);
}

#[test]
fn refuses_incomplete_inertial() {
    refused(&arm_with(LOWER_MASS, ""), &["link 'lower'", "no <mass>", "write <mass"]);
    refused(&arm_with(LOWER_INERTIA, ""), &["link 'lower'", "no <inertia>", "ixx"]);
}

#[test]
fn refuses_negative_mass_of_fixed_link() {
    let inertial = r#"<inertial><mass value="-1"/>
        <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial>"#;
    let text = arm_with(r#"<link name="base"/>"#, &format!(r#"<link name="base">{inertial}</link>"#));
    refused(&text, &["link 'base'", "-1 kg"]);
}

#[test]
fn refuses_joint_without_limits_parent_or_child() {
    refused(&arm_with(ELBOW_LIMIT, ""), &["joint 'elbow'", "no <limit>", "lower", "upper"]);
    refused(&arm_with(r#"<parent link="upper"/>"#, ""), &["joint 'elbow'", "no <parent>", "<parent link"]);
    refused(&arm_with(r#"<child link="lower"/>"#, ""), &["joint 'elbow'", "no <child>", "<child link"]);
}

#[test]
fn refuses_dangling_parent_or_child() {
    let known = "base, upper, lower, tool";
    let text = arm_with(r#"<parent link="upper"/>"#, r#"<parent link="uper"/>"#);
    let error = refused(&text, &["joint 'elbow'", "parent link 'uper'", "doesn't exist", known]);
    assert_eq!(error.line(), Some(line_of(&text, ELBOW)));
    let text = arm_with(r#"<child link="lower"/>"#, r#"<child link="lowr"/>"#);
    refused(&text, &["joint 'elbow'", "child link 'lowr'", "doesn't exist", known]);
}

#[test]
fn refuses_link_with_two_parents() {
    let text =
        arm_and(r#"<joint name="brace" type="fixed"><parent link="base"/><child link="lower"/></joint>"#);
    let error = refused(&text, &["link 'lower'", "'elbow' and 'brace'", "remove one"]);
    assert_eq!(error.line(), Some(line_of(&text, "brace")));
}

#[test]
fn refuses_several_roots() {
    let text = arm_and(r#"<link name="table"/><link name="lamp"/>"#);
    refused(&text, &["base, table, lamp", "one root", "fixed joints"]);
}

#[test]
fn refuses_cycles() {
    let all = r#"<joint name="loop" type="fixed"><parent link="tool"/><child link="base"/></joint>"#;
    refused(&arm_and(all), &["cycle", "base → upper → lower → tool → base", "root"]);
    let apart = r#"<link name="a"/><link name="b"/><link name="c"/>
        <joint name="ab" type="fixed"><parent link="a"/><child link="b"/></joint>
        <joint name="bc" type="fixed"><parent link="b"/><child link="c"/></joint>
        <joint name="ba" type="fixed"><parent link="b"/><child link="a"/></joint>"#;
    let said = refused(&arm_and(apart), &["cycle"]).to_string();
    assert!(said.contains("a → b → a") || said.contains("b → a → b"), "{said}");
    let itself =
        r#"<link name="a"/><joint name="aa" type="fixed"><parent link="a"/><child link="a"/></joint>"#;
    refused(&arm_and(itself), &["cycle", "a → a"]);
}

#[test]
fn refuses_robot_without_links() {
    refused(r#"<robot name="ghost"/>"#, &["line 1", "no <link>"]);
}

#[test]
fn refuses_other_formats() {
    refused(r#"<sdf version="1.9"><model name="arm"/></sdf>"#, &["SDF", "convert"]);
    refused("<html><body/></html>", &["<html>", "<robot>"]);
    refused("", &["empty", "<robot>"]);
    refused(" \n\t\n", &["empty"]);
    refused("\u{feff}", &["empty"]);
    refused("solid ascii stl\nfacet normal 0 0 1", &["not XML"]);
    refused("\u{0}\u{1}ELF", &["not XML"]);
    refused("{\"robot\": 1}", &["not XML"]);
    refused("<!-- nothing else -->", &["not XML"]);
}

#[test]
fn refuses_xacro() {
    let text = r#"<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
        <xacro:include filename="arm.xacro"/></robot>"#;
    let error = refused(text, &["<xacro:include>", "xacro FILE.xacro > FILE.urdf"]);
    assert_eq!(error.line(), Some(2));
}

#[test]
fn accepts_leftover_xacro_declaration() {
    let text =
        arm_with(r#"<robot name="arm">"#, r#"<robot name="arm" xmlns:xacro="http://ros.org/wiki/xacro">"#);
    Model::from_urdf(&text).unwrap();
}

#[test]
fn refuses_every_truncation() {
    let end = ARM.rfind("</robot>").unwrap() + "</robot>".len();
    for cut in (0..end).filter(|&i| ARM.is_char_boundary(i)) {
        refused(&ARM[..cut], &[]);
    }
    refused(&ARM[..end - "</robot>".len()], &["truncated"]);
    refused(&ARM[..end / 2], &["truncated"]);
}

#[test]
fn refuses_mismatched_tags() {
    let error = refused(&arm_with("</joint>", "</link>"), &["not well-formed", "joint", "link"]);
    assert_eq!(error.line(), Some(24));
}

#[test]
fn refuses_doctypes_and_entities() {
    let bomb = r#"<?xml version="1.0"?>
        <!DOCTYPE robot [<!ENTITY a "lol"><!ENTITY b "&a;&a;&a;&a;">]>
        <robot name="&b;"><link name="base"/></robot>"#;
    assert_eq!(refused(bomb, &["<!DOCTYPE>", "delete"]).line(), Some(2));
    let file = r#"<!DOCTYPE robot SYSTEM "file:///etc/passwd"><robot name="a"><link name="base"/></robot>"#;
    refused(file, &["<!DOCTYPE>"]);
    refused(r#"<robot name="&b;"><link name="base"/></robot>"#, &["not well-formed", "b"]);
}

#[test]
fn refuses_too_large_file() {
    let text = arm_and(&" ".repeat(16 << 20));
    assert_eq!(refused(&text, &["bytes", "16777216"]).line(), None);
}

#[test]
fn refuses_too_deep_nesting() {
    let deep = format!("<robot>\n{}{}</robot>", "<a>".repeat(200_000), "</a>".repeat(200_000));
    assert_eq!(refused(&deep, &["64 deep"]).line(), Some(2));
    refused(&"<a>".repeat(200_000), &["64 deep"]);
    refused(&format!("<?note ' ?>{}", "<a>".repeat(200_000)), &["64 deep"]);
    // Tags in comments or between quotes do not count as nesting.
    let flat = format!("<!--{}--><gazebo note='{}'/>", "<a>".repeat(100), "a>".repeat(100));
    Model::from_urdf(&arm_and(&flat)).unwrap();
}

#[test]
fn refuses_excessive_attributes() {
    let many: String = (0..10_000).map(|i| format!(" a{i}='='")).collect();
    let error = refused(&arm_and(&format!("<gazebo{many}/>")), &["64 attributes"]);
    assert_eq!(error.line(), Some(37));
}

#[test]
fn long_name_lists_are_truncated() {
    let links: String = (0..1000).map(|i| format!("<link name='l{i}'/>")).collect();
    let error = refused(&format!("<robot>{links}</robot>"), &["l0, l1,", "l99 and 900 more"]);
    assert!(error.to_string().len() < 1000);
}

#[test]
fn long_chain_is_accepted() {
    // A chain of 20 000 links is deep in the robot, but not nested in the file.
    let mut text = String::from("<robot name='snake'><link name='l0'/>");
    for i in 0..20_000 {
        let next = i + 1;
        text += &format!(
            "<link name='l{next}'/><joint name='j{i}' type='fixed'><parent link='l{i}'/><child link='l{next}'/></joint>"
        );
    }
    text += "</robot>";
    assert_eq!(Model::from_urdf(&text).unwrap().model.frames().len(), 20_001);
}

/// Returns the warnings about a file that is accepted.
fn warnings(text: &str) -> Vec<String> {
    Model::from_urdf(text).unwrap().warnings.iter().map(ToString::to_string).collect()
}

#[test]
fn valid_arm_has_no_warnings() {
    assert_eq!(warnings(ARM), [""; 0]);
}

#[test]
fn warns_of_impossible_inertia() {
    let text =
        arm_with(LOWER_INERTIA, r#"<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.05"/>"#);
    let said = warnings(&text);
    assert_eq!(said.len(), 1);
    assert!(
        said[0].starts_with("line 15: link 'lower'") && said[0].contains("triangle inequality"),
        "{said:?}"
    );
}

#[test]
fn rod_and_plate_inertias_are_possible() {
    for moments in [[0.0, 0.01, 0.01], [0.01, 0.02, 0.03], [0.0, 0.0, 0.0]] {
        let [x, y, z] = moments;
        let inertia = format!(r#"<inertia ixx="{x}" ixy="0" ixz="0" iyy="{y}" iyz="0" izz="{z}"/>"#);
        assert_eq!(warnings(&arm_with(LOWER_INERTIA, &inertia)), [""; 0]);
    }
}

/// Limits beyond those of robots are none; the range of such a joint is finite and not reversed.
#[test]
fn limits_beyond_those_of_robots_are_none() {
    for (lower, upper, range) in [
        ("-1e16", "1e16", (-1.0, 1.0)),
        ("-0.5", "1e300", (-0.5, 1.0)),
        ("5000", "1e300", (5000.0, 5002.0)),
        ("-1e300", "-5000", (-5002.0, -5000.0)),
    ] {
        let urdf = arm_with(ELBOW_LIMIT, &format!(r#"<limit lower="{lower}" upper="{upper}"/>"#));
        let said = warnings(&urdf);
        assert!(said[0].contains("joint 'elbow'") && said[0].contains("is read as no limit"), "{said:?}");
        let model = Model::from_urdf(&urdf).unwrap().model;
        let joint = &model.joints()[model.joint("elbow").unwrap()];
        assert_eq!(joint.limits.range(joint.kind), range, "{lower} to {upper}");
    }
}

#[test]
fn warns_of_equal_limits() {
    let said = warnings(&arm_with(ELBOW_LIMIT, r#"<limit lower="0.5" upper="0.5"/>"#));
    assert_eq!(
        said,
        ["line 30: joint 'elbow': lower and upper limits are both 0.5: it cannot move; is it a fixed joint?"]
    );
}

#[test]
fn warns_of_zero_effort_limit() {
    let said = warnings(&arm_with(ELBOW_LIMIT, r#"<limit lower="-1" upper="1" velocity="2" effort="0"/>"#));
    assert_eq!(said.len(), 1);
    assert!(said[0].contains("joint 'elbow'") && said[0].contains("effort limit is 0"), "{said:?}");
}

#[test]
fn mimic_joint_is_independent_with_warning() {
    let text = arm_with(ELBOW_AXIS, r#"<axis xyz="0 1 0"/><mimic joint="shoulder" multiplier="2"/>"#);
    let loaded = Model::from_urdf(&text).unwrap();
    assert_eq!(loaded.model.n(), 2);
    assert_eq!(
        loaded.warnings[0].to_string(),
        "line 29: joint 'elbow' mimics 'shoulder': the coupling is ignored and the joint moves independently"
    );
}

#[test]
fn warnings_follow_file_order() {
    let text =
        arm_with(ELBOW_LIMIT, r#"<limit lower="0.5" upper="0.5" effort="0"/><mimic joint="shoulder"/>"#)
            .replace(LOWER_INERTIA, r#"<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.05"/>"#);
    let lines: Vec<u32> = Model::from_urdf(&text).unwrap().warnings.iter().filter_map(|w| w.line()).collect();
    assert_eq!(lines, [15, 30, 30, 30]);
}

#[test]
fn missing_limits_are_infinite() {
    let model = Model::from_urdf(&arm_with(ELBOW_LIMIT, r#"<limit lower="-1" upper="1"/>"#)).unwrap().model;
    let [shoulder, elbow] = [0, 1].map(|j| model.joints()[j].limits);
    assert_eq!((shoulder.lower, shoulder.upper, shoulder.velocity, shoulder.effort), (-2.0, 2.0, 3.0, 40.0));
    assert_eq!((elbow.lower, elbow.upper), (-1.0, 1.0));
    assert_eq!((elbow.velocity, elbow.effort), (f64::INFINITY, f64::INFINITY));
}

#[test]
fn continuous_joint_has_no_position_limits() {
    let text = arm_with(r#"type="revolute""#, r#"type="continuous""#);
    let joint = Model::from_urdf(&text).unwrap().model.joints()[0].clone();
    assert_eq!(joint.kind, JointKind::Continuous);
    assert_eq!((joint.limits.lower, joint.limits.upper), (f64::NEG_INFINITY, f64::INFINITY));
    assert_eq!((joint.limits.velocity, joint.limits.effort), (3.0, 40.0));
    let without = text.replacen(r#"<limit lower="-2" upper="2" velocity="3" effort="40"/>"#, "", 1);
    assert_eq!(Model::from_urdf(&without).unwrap().model.joints()[0].limits.effort, f64::INFINITY);
}

#[test]
fn joints_are_depth_first_and_links_are_frames() {
    let branch = |name: &str, parent: &str| {
        format!(
            r#"<link name="{name}"><inertial><mass value="1"/>
            <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
            <joint name="{name}_joint" type="continuous"><parent link="{parent}"/><child link="{name}"/></joint>"#
        )
    };
    // The order in the file differs from that in the tree: z precedes a, and the deeper link comes first.
    let body = ["z", "a"].map(|n| branch(n, "hub")).concat() + &branch("b", "a") + &branch("hub", "base");
    let text = format!(r#"<robot name="tree"><link name="base"/>{body}</robot>"#);
    let model = Model::from_urdf(&text).unwrap().model;
    let joints: Vec<_> =
        model.joints().iter().zip(model.bodies()).map(|(j, b)| (j.name.as_str(), b.parent)).collect();
    let expected = [("hub_joint", None), ("a_joint", Some(0)), ("b_joint", Some(1)), ("z_joint", Some(0))];
    assert_eq!(joints, expected);
    let frames: Vec<_> = model.frames().iter().map(|f| f.name.as_str()).collect();
    assert_eq!(frames, ["base", "hub", "a", "b", "z"]);
}

/// Compared: frames at given q, and the sum of the origins and the joint motion by hand. The body frames are rotated,
/// the link frames are not.
#[test]
fn link_frame_is_independent_of_joint_axis() {
    let model = Model::from_urdf(ARM).unwrap().model;
    let mut data = Data::new(&model);
    kinematics(&model, &mut data, &[0.0, 0.25], &[0.0, 0.0]);
    let tool = frame_placement(&model, &data, model.frame_id("tool").unwrap());
    assert!((tool.translation - Vector3::new(0.0, 0.25, 0.5)).norm() < 1e-15);
    assert!((tool.rotation - Matrix3::identity()).norm() < 1e-15);
}

/// Compared: the inertia of a body merged across a fixed joint, and the parallel-axis theorem by hand.
#[test]
fn fixed_links_add_inertia_to_their_body() {
    let tool = r#"<link name="tool"><inertial><origin xyz="0.1 0 0" rpy="0 0 1.5707963267948966"/><mass value="3"/>
        <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.25"/></inertial></link>"#;
    let text =
        arm_with(r#"<link name="tool"/>"#, tool).replacen(r#"type="prismatic""#, r#"type="revolute""#, 1);
    let text = text.replacen(ELBOW_AXIS, r#"<axis xyz="0 0 2"/>"#, 1);
    let body = Model::from_urdf(&text).unwrap().model.bodies()[1].inertia;
    // 1 kg at the origin and 3 kg at (0.1, 0, 0.2): the reduced mass is 0.75 kg.
    let d = Vector3::new(0.1, 0.0, 0.2);
    let expected = Matrix3::from_diagonal(&Vector3::new(0.01 + 0.2, 0.01 + 0.1, 0.01 + 0.25))
        + (Matrix3::from_diagonal_element(d.norm_squared()) - d * d.transpose()) * 0.75;
    assert_eq!(body.mass, 4.0);
    assert!((body.com - d * 0.75).norm() < 1e-15, "{}", body.com);
    assert!((body.rotational - expected).norm() < 1e-15, "{}", body.rotational);
}

#[test]
fn links_fixed_to_base_have_no_inertia() {
    let more = r#"<link name="table"><inertial><mass value="100"/>
        <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
        <joint name="bolt" type="fixed"><parent link="base"/><child link="table"/></joint>"#;
    let model = Model::from_urdf(&arm_and(more)).unwrap().model;
    assert_eq!(model.total_mass(), 3.0);
    assert_eq!(model.frame(model.frame_id("table").unwrap()).body, None);
}

/// Checks a wheel without limits: the robot is refused, unless the wheel is locked.
#[test]
fn locked_joint_needs_no_limits() {
    let wheel = r#"<link name="wheel"/><joint name="axle" type="revolute"><parent link="base"/><child link="wheel"/></joint>"#;
    let text = arm_and(wheel);
    refused(&text, &["joint 'axle'", "no <limit>"]);
    let joints = opspace_model::urdf_joints(&text).unwrap();
    assert!(joints.iter().any(|joint| joint.name == "axle" && joint.limits == Limits::NONE));
    let locked = |name: &str| {
        Model::from_urdf_changed(
            &text,
            UrdfOptions::default(),
            &UrdfChanges { locked_joints: vec![(name.to_owned(), 0.0)], ..UrdfChanges::default() },
        )
        .map(|urdf| urdf.model.n())
    };
    assert_eq!(locked("axle").unwrap(), 2);
    assert!(locked("elbow").unwrap_err().to_string().contains("joint 'axle'"));
}

/// Checks moments that are zero but for rounding.
#[test]
fn rounding_error_is_no_negative_inertia() {
    let rounded = r#"<inertia ixx="-1e-35" ixy="0" ixz="0" iyy="1e-36" iyz="0" izz="0"/>"#;
    assert!(Model::from_urdf(&arm_with(LOWER_INERTIA, rounded)).is_ok());
    let negative = r#"<inertia ixx="-1e-16" ixy="0" ixz="0" iyy="1e-16" iyz="0" izz="0"/>"#;
    refused(&arm_with(LOWER_INERTIA, negative), &["link 'lower'", "positive semi-definite"]);
}

/// Compared: models of this crate's reader, and the numbers of urdf-rs, for several robots: joints are matched by name,
/// and frames are composed from the origins of urdf-rs.
#[test]
fn agrees_with_urdf_rs() {
    for robot in ["double_pendulum", "g1_29dof", "kinova_j2s6s200", "panda", "panda_arm7", "ur5"] {
        let text = opspace_testing::oracle::urdf(robot);
        let model = Model::from_urdf(&text).expect(robot).model;
        let theirs = urdf_rs::read_from_string(&text).unwrap();
        assert_eq!(model.name(), theirs.name);
        assert_eq!(model.frames().len(), theirs.links.len());
        let mut data = Data::new(&model);
        let zero = vec![0.0; model.n()];
        kinematics(&model, &mut data, &zero, &zero);
        let place = |name: &str| frame_placement(&model, &data, model.frame_id(name).unwrap());
        for joint in &theirs.joints {
            let origin = opspace_model::Placement::from_rpy(*joint.origin.rpy, *joint.origin.xyz);
            let expected = place(&joint.parent.link) * origin;
            let found = place(&joint.child.link);
            assert!((found.translation - expected.translation).norm() < 1e-14, "{robot} {}", joint.name);
            assert!((found.rotation - expected.rotation).norm() < 1e-14, "{robot} {}", joint.name);
            let Ok(index) = model.joint(&joint.name) else {
                assert_eq!(joint.joint_type, urdf_rs::JointType::Fixed, "{robot} {}", joint.name);
                continue;
            };
            let ours = &model.joints()[index];
            assert_eq!(
                (ours.limits.velocity, ours.limits.effort),
                (joint.limit.velocity, joint.limit.effort)
            );
            if ours.kind != JointKind::Continuous {
                assert_eq!((ours.limits.lower, ours.limits.upper), (joint.limit.lower, joint.limit.upper));
            }
        }
        let moving = |name: &str| model.frame(model.frame_id(name).unwrap()).body.is_some();
        let mass: f64 = theirs.links.iter().filter(|l| moving(&l.name)).map(|l| l.inertial.mass.value).sum();
        assert!((model.total_mass() - mass).abs() < 1e-12 * mass, "{robot}");
    }
}

mod mutations {
    use super::{ARM, Model};
    use proptest::prelude::*;

    /// One change to a text: characters removed or doubled, or a piece of URDF syntax inserted.
    #[derive(Clone, Debug)]
    enum Mutation {
        Cut(prop::sample::Index, usize),
        Double(prop::sample::Index, usize),
        Insert(prop::sample::Index, &'static str),
    }

    fn mutation() -> impl Strategy<Value = Mutation> {
        let tokens = prop::sample::select(vec![
            "<",
            ">",
            "/",
            "\"",
            "=",
            "&",
            "&#0;",
            "&lt;",
            "<!--",
            "-->",
            "<![CDATA[",
            "]]>",
            "<?",
            "?>",
            "<!",
            "nan",
            "inf",
            "-",
            "1e308",
            "-1e308",
            "1e-320",
            "0",
            "\u{0}",
            "\u{feff}",
            "é",
            "→",
            "${",
            "xmlns=\"a\" ",
            "name=\"\" ",
            "<robot>",
            "</robot>",
            "<link name=\"base\"/>",
            "<inertial>",
            "type=\"fixed\" ",
        ]);
        let place = any::<prop::sample::Index>;
        prop_oneof![
            (place(), 1..60usize).prop_map(|(at, n)| Mutation::Cut(at, n)),
            (place(), 1..200usize).prop_map(|(at, n)| Mutation::Double(at, n)),
            (place(), tokens).prop_map(|(at, token)| Mutation::Insert(at, token)),
        ]
    }

    fn apply(text: &str, mutation: &Mutation) -> String {
        let characters: Vec<char> = text.chars().collect();
        let at = |index: &prop::sample::Index| index.index(characters.len().max(1)).min(characters.len());
        let (place, drop, insert): (usize, usize, Vec<char>) = match mutation {
            Mutation::Cut(index, n) => (at(index), *n, Vec::new()),
            Mutation::Double(index, n) => {
                let start = at(index);
                (start, 0, characters[start..(start + n).min(characters.len())].to_vec())
            }
            Mutation::Insert(index, token) => (at(index), 0, token.chars().collect()),
        };
        let after = (place + drop).min(characters.len());
        characters[..place].iter().chain(&insert).chain(&characters[after..]).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig {
            failure_persistence: None,
            rng_seed: proptest::test_runner::RngSeed::Fixed(7),
            ..ProptestConfig::with_cases(4000)
        })]

        /// Checks that a corrupted file is refused with an error or gives a model with finite numbers, and never causes
        /// a panic.
        #[test]
        fn corrupted_file_never_panics(mutations in prop::collection::vec(mutation(), 1..8)) {
            let text = mutations.iter().fold(ARM.to_owned(), |text, m| apply(&text, m));
            match Model::from_urdf(&text) {
                Err(error) => prop_assert!(!error.to_string().is_empty()),
                Ok(loaded) => {
                    for body in loaded.model.bodies() {
                        prop_assert!(body.inertia.mass > 0.0);
                        prop_assert!(body.inertia.rotational.iter().all(|x| x.is_finite()));
                        prop_assert!(body.origin.rotation.iter().all(|x| x.is_finite()));
                    }
                }
            }
        }
    }
}

//! Tests of the values of a robot file that depend on each other.

use opspace_experiment::{Files, RobotDefinition, Source};
use std::path::Path;

/// Texts of the robot file and the URDF of the embedded robot.
fn files() -> (String, String) {
    let read = |name: &str| {
        let path = Path::new("robots/asimo-arm").join(name);
        Files::Embedded.read(&path).expect("an embedded file").text().to_owned()
    };
    (read("robot.toml"), read("asimo-arm.urdf"))
}

/// Checks that a servo rate whose period is infinite, or has no unit that makes sense, is refused at its line.
#[test]
fn servo_rate_is_bounded() {
    let (text, urdf) = files();
    let line = text.lines().position(|line| line.starts_with("servo_hz = ")).expect("a rate");
    for (value, shown) in
        [("1e-308", "1e-308"), ("0.0001", "1e-4"), ("50001.0", "5.0001e4"), ("1e12", "1e12")]
    {
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        lines[line] = format!("servo_hz = {value}");
        let source = Source::new("robot.toml", lines.join("\n"));
        let error = RobotDefinition::from_sources(source, Source::new("robot.urdf", urdf.as_str()));
        let error = error.expect_err(value).to_string();
        let wanted =
            format!("robot.toml:{}: a servo rate of {shown} Hz is not from 1e-3 to 5e4 Hz", line + 1);
        assert_eq!(error, wanted);
    }
}

/// Checks that a rotor whose reflected inertia is too large for the dynamics, is refused at its line.
#[test]
fn reflected_inertia_is_bounded() {
    let (text, urdf) = files();
    let rotor = text.lines().position(|line| line.starts_with("rotor = ")).expect("a rotor");
    for (value, shown) in [
        ("rotor = { inertia_kg_m2 = 1e12, gear_ratio = 100.0, encoder_counts_per_turn = 4096 }", "1e16"),
        ("rotor = { inertia_kg_m2 = 1e-5, gear_ratio = 1e12, encoder_counts_per_turn = 4096 }", "1e19"),
        ("rotor = { inertia_kg_m2 = 1.0, gear_ratio = 1e5, encoder_counts_per_turn = 4096 }", "1e10"),
    ] {
        let mut lines: Vec<&str> = text.lines().collect();
        lines[rotor] = value;
        let source = Source::new("robot.toml", lines.join("\n"));
        let error = RobotDefinition::from_sources(source, Source::new("robot.urdf", urdf.as_str()));
        let error = error.expect_err(value).to_string();
        let wanted = format!("robot.toml:{}: the rotor's inertia times gear_ratio² is {shown}", rotor + 1);
        assert!(error.starts_with(&wanted), "{error}");
    }
}

/// Checks that a number of a tool with which the dynamics would overflow is refused at its key.
#[test]
fn numbers_of_a_tool_are_bounded() {
    let (text, urdf) = files();
    let tool = "\n[tool.gripper]\non = \"LINK\"\nmass_kg = 0.5\ncom_m = [1e11, 0.0, 0.05]\n";
    let link = urdf.split("<link name=\"").last().and_then(|rest| rest.split('"').next()).expect("a link");
    let source = Source::new("robot.toml", text + &tool.replace("LINK", link));
    let error = RobotDefinition::from_sources(source, Source::new("robot.urdf", urdf.as_str()));
    let error = error.expect_err("too large").to_string();
    assert!(error.contains("1e11 is too large"), "{error}");
}

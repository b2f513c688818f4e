//! An arm of three joints on a simulated bus.

use opspace_backend::{CommandKind, Setting, Settings};
use opspace_feetech::protocol::Register;
use opspace_feetech::simulated::{
    BusOptions, SeparateJoint, SeparateJoints, ServoOptions, SimulatedBus, SimulatedServo, SimulatedTransport,
};
use opspace_feetech::{ArmConfig, FeetechArm};
use std::io::Write;
use tempfile::NamedTempFile;

pub const JOINTS: [&str; 3] = ["shoulder_lift", "elbow_flex", "wrist_flex"];
pub const IDS: [u8; 3] = [2, 3, 4];
pub const HOMING: [i32; 3] = [120, -40, 7];
pub const RANGES: [(i32, i32); 3] = [(800, 3290), (900, 3200), (850, 3000)];

/// Calibration of the arm, and of a gripper that is no joint of the robot.
pub const CALIBRATION: &str = r#"{
    "shoulder_lift": {"id": 2, "drive_mode": 0, "homing_offset": 120, "range_min": 800, "range_max": 3290},
    "elbow_flex": {"id": 3, "drive_mode": 0, "homing_offset": -40, "range_min": 900, "range_max": 3200},
    "wrist_flex": {"id": 4, "drive_mode": 1, "homing_offset": 7, "range_min": 850, "range_max": 3000},
    "gripper": {"id": 6, "drive_mode": 0, "homing_offset": 0, "range_min": 2000, "range_max": 3000}
}"#;

/// Returns the text in a file.
pub fn file(text: &str) -> NamedTempFile {
    let mut file = NamedTempFile::new().expect("a file");
    file.write_all(text.as_bytes()).expect("written");
    file
}

/// Settings of the arm at 100 Hz, with a calibration file.
pub fn settings(calibration: &NamedTempFile) -> Settings {
    let path = calibration.path().to_str().expect("a path");
    Settings::new(CommandKind::Position, JOINTS.map(str::to_owned).to_vec(), 0.01)
        .with("calibration", Setting::Text(path.to_owned()))
        .with("p", Setting::Number(16.0))
        .with("i", Setting::Number(0.0))
        .with("d", Setting::Number(32.0))
}

/// Configuration of the arm at 100 Hz, changed.
pub fn config(change: impl FnOnce(Settings) -> Settings) -> ArmConfig {
    let calibration = file(CALIBRATION);
    ArmConfig::from_settings(&change(settings(&calibration))).expect("a configuration")
}

/// The bus of the arm: its joints are pulled by weights, and the last servo turns the other way.
pub fn bus() -> SimulatedBus {
    let servos = (0..3).map(|index| {
        let mut servo = SimulatedServo::new(
            IDS[index],
            ServoOptions {
                inverted: index == 2,
                sensor_zero: 2048.0 + f64::from(HOMING[index]),
                ..ServoOptions::default()
            },
        );
        servo.set(Register::HOMING_OFFSET, HOMING[index]);
        servo.set(Register::MIN_POSITION_LIMIT, RANGES[index].0);
        servo.set(Register::MAX_POSITION_LIMIT, RANGES[index].1);
        servo
    });
    let joint = |weight_nm| SeparateJoint { weight_nm, ..SeparateJoint::default() };
    let joints = SeparateJoints::new(vec![joint(-0.6), joint(0.4), joint(0.1)], &[0.3, -0.4, 0.2]);
    SimulatedBus::new(servos.collect(), Box::new(joints), BusOptions::default())
}

/// The arm at 100 Hz on a simulated bus that was changed.
pub fn arm(change: impl FnOnce(&mut SimulatedBus)) -> FeetechArm<SimulatedTransport> {
    let mut bus = bus();
    change(&mut bus);
    FeetechArm::start(SimulatedTransport::new(bus), config(|settings| settings)).expect("an arm")
}

/// Returns the reason why the arm does not start on a bus that was changed.
pub fn refusal(change: impl FnOnce(&mut SimulatedBus)) -> String {
    let mut bus = bus();
    change(&mut bus);
    let started = FeetechArm::start(SimulatedTransport::new(bus), config(|settings| settings));
    started.err().expect("the arm does not start").to_string()
}

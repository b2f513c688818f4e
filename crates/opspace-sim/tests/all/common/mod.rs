//! Arm of the paper, loaded from its files.

#![allow(dead_code, reason = "each test uses some of it")]

pub mod stiff_arms;

use nalgebra::DVector;
use opspace_backend::{
    Backend, Capabilities, CommandKind, DeviceFault, GroundTruth, Measured, Sample, TruthRow,
};
use opspace_model::Model;
use opspace_sim::{ArmConfig, EnvironmentObjectParameters, SimulatedArm, SimulatedParameters};
use opspace_transformer::{JointParameters, ProfileParameters, ServoParameters};
use serde::Deserialize;
use std::collections::BTreeMap;

const URDF: &str = include_str!("../../../../../robots/asimo-arm/asimo-arm.urdf");
const ROBOT: &str = include_str!("../../../../../robots/asimo-arm/robot.toml");

pub const START: [f64; 4] = [-0.45, -0.35, 0.25, -1.35];

#[derive(Deserialize)]
pub struct RobotFile {
    pub joint: BTreeMap<String, JointParameters>,
    pub profile: BTreeMap<String, ProfileParameters>,
    pub simulated: SimulatedParameters,
}

pub fn robot() -> RobotFile {
    toml::from_str(ROBOT).expect("the robot file")
}

fn in_order<T: Clone>(model: &Model, by_name: &BTreeMap<String, T>) -> Vec<T> {
    model.joints().iter().map(|j| by_name[&j.name].clone()).collect()
}

/// Returns the arm with ideal motors and friction, at its start and without a rest.
pub fn setup(command: CommandKind, profile: &str) -> ArmConfig {
    let robot = robot();
    let model = Model::from_urdf(URDF).expect("the URDF").model;
    let joints = in_order(&model, &robot.joint);
    let rotors: Vec<f64> = joints.iter().map(|j| j.rotor.reflected_inertia()).collect();
    let model = model.with_rotor_inertia(&rotors);
    let profile = robot.profile[profile].clone();
    let servos: Vec<ServoParameters> = in_order(&model, &profile.servo);
    let names = model.joints().iter().map(|joint| joint.name.clone());
    let capabilities = Capabilities::new(names, command, profile.period_s())
        .measuring(&[Measured::MotorCurrent])
        .with_force_sensor("wrist", "hand")
        .simulated();
    let simulated = SimulatedParameters {
        current_loop_hz: None,
        encoder_quantisation: false,
        torque_noise_nm: Default::default(),
        ..robot.simulated
    };
    let start = START.to_vec();
    let environment = Vec::new();
    ArmConfig {
        model,
        joints,
        servos,
        profile,
        capabilities,
        simulated,
        environment,
        capsules: Vec::new(),
        external_forces: false,
        start,
        rest_s: 0.0,
        seed: 1,
    }
}

pub fn arm(setup: ArmConfig) -> SimulatedArm {
    SimulatedArm::new(setup).unwrap_or_else(|e| panic!("{e}"))
}

/// Parses a part of a file.
pub fn parsed<T: serde::de::DeserializeOwned>(text: &str) -> T {
    toml::from_str(text).unwrap_or_else(|e| panic!("{e}"))
}

/// Parses an environment object, written as in a task file below its name.
pub fn object(text: &str) -> EnvironmentObjectParameters {
    parsed(text)
}

/// Reads the next interface cycle.
pub fn read(arm: &mut SimulatedArm) -> Sample {
    try_read(arm).expect("the arm can be read")
}

/// Reads the next interface cycle; returns the sample or the fault.
pub fn try_read(arm: &mut SimulatedArm) -> Result<Sample, DeviceFault> {
    let mut sample = Sample::new(arm.capabilities());
    arm.read(&mut sample).map(|()| sample)
}

/// Returns the drives' rows of the last interface period: the command in effect (0 before the first), and the motor
/// torques (n; Nm).
pub fn servo_rows(arm: &SimulatedArm) -> Vec<(u64, DVector<f64>)> {
    let mut rows = Vec::new();
    arm.visit(&mut |row| {
        if let TruthRow::Servo { command, row, .. } = row {
            rows.push((command.unwrap_or(0), DVector::from_column_slice(row)));
        }
    });
    rows
}

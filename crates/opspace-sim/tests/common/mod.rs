//! The arm of the paper, straight from its files.

#![allow(dead_code, reason = "each test uses some of it")]

use nalgebra::DVector;
use opspace_backend::CommandKind;
use opspace_backend::MissedCycle;
use opspace_backend::{GravityBy, Sample, Setpoints};
use opspace_loop::{Facts, ForceSensor, Robot, Trace};
use opspace_model::Model;
use opspace_sim::{Setup, SimulatedArm, SimulatedParameters, SurroundingParameters};
use opspace_transformer::{JointParameters, ProfileParameters, ServoParameters};
use serde::Deserialize;
use std::collections::BTreeMap;

const URDF: &str = include_str!("../../../../robots/asimo-arm/asimo-arm.urdf");
const ROBOT: &str = include_str!("../../../../robots/asimo-arm/robot.toml");

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

/// The arm with drives that do what they are asked, with friction, at its start and without a rest.
pub fn setup(command: CommandKind, profile: &str) -> Setup {
    let robot = robot();
    let model = Model::from_urdf(URDF).expect("the URDF").model;
    let joints = in_order(&model, &robot.joint);
    let rotors: Vec<f64> = joints.iter().map(|j| j.rotor.reflected_inertia()).collect();
    let model = model.with_rotor_inertia(&rotors);
    let profile = robot.profile[profile].clone();
    let servos: Vec<ServoParameters> = in_order(&model, &profile.servo);
    let facts = Facts {
        command,
        period_s: profile.period_s(),
        set_points: Setpoints::Held,
        gravity_by: GravityBy::Controller,
        on_missed_cycle: MissedCycle::HoldLast,
        motor_torque: true,
        sensors: vec![ForceSensor {
            name: "wrist".to_owned(),
            frame: model.frame("hand").expect("the hand"),
        }],
    };
    let simulated = SimulatedParameters {
        current_loop_hz: None,
        encoder_quantisation: false,
        torque_noise_nm: Default::default(),
        ..robot.simulated
    };
    let start = START.to_vec();
    let surroundings = Vec::new();
    Setup { model, joints, servos, profile, facts, simulated, surroundings, start, rest_s: 0.0, seed: 1 }
}

pub fn arm(setup: Setup) -> SimulatedArm {
    SimulatedArm::new(setup).unwrap_or_else(|e| panic!("{e}"))
}

/// A part of a file.
pub fn parsed<T: serde::de::DeserializeOwned>(text: &str) -> T {
    toml::from_str(text).unwrap_or_else(|e| panic!("{e}"))
}

/// A surrounding as it stands in a task file below its name.
pub fn surrounding(text: &str) -> SurroundingParameters {
    parsed(text)
}

/// The next interface tick.
pub fn read(arm: &mut SimulatedArm) -> Sample {
    let mut sample = Sample::new(4, arm.facts().motor_torque, arm.facts().sensors.len());
    arm.read(&mut sample).expect("the arm can be read");
    sample
}

/// The drives' rows of the last interface period: the command in force, and the motors' torques.
pub fn servo_rows(arm: &SimulatedArm) -> Vec<(u64, DVector<f64>)> {
    let mut rows = Vec::new();
    arm.visit_traces(&mut |trace| {
        if let Trace::Servo { command, row, .. } = trace {
            rows.push((command, DVector::from_column_slice(row)));
        }
    });
    rows
}

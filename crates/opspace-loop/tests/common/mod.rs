//! A two-joint arm and a robot that does as the test says.

#![allow(dead_code, reason = "each test uses some of it")]

use nalgebra::DVector;
use opspace_backend::MissedCycle;
use opspace_backend::{CommandKind, Observable, Row, Signal};
use opspace_backend::{GravityBy, Sample, Setpoints, Sink};
use opspace_control::{ControlInput, Controller, Measurement};
use opspace_loop::{Facts, Fault, ForceSensor, PositionRobot, Robot, SafetyParameters, Sensing, TorqueRobot};
use opspace_model::{Data, Model};
use opspace_transformer::{EstimatorParameters, ServoGains};
use std::sync::{Arc, Mutex};

pub const PERIOD_S: f64 = 1e-3;

/// Two links of 0.5 m in the vertical plane: at q = 0 both stretch along x, so gravity pulls at both joints.
const URDF: &str = r#"
<robot name="two">
  <link name="base"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="40" velocity="5"/>
  </joint>
  <link name="upper"><inertial><origin xyz="0.25 0 0"/><mass value="2"/>
    <inertia ixx="0.01" iyy="0.04" izz="0.04" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="elbow" type="revolute">
    <parent link="upper"/><child link="fore"/><origin xyz="0.5 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="40" velocity="5"/>
  </joint>
  <link name="fore"><inertial><origin xyz="0.25 0 0"/><mass value="1"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
</robot>"#;

pub const START: [f64; 2] = [0.4, -0.7];
pub const LIMITS: [f64; 2] = [40.0, 20.0];

pub fn model() -> Model {
    Model::from_urdf(URDF).expect("the URDF").model
}

pub fn parsed<T: serde::de::DeserializeOwned>(text: &str) -> T {
    toml::from_str(text).unwrap_or_else(|e| panic!("{e}"))
}

/// Of servos with kp 50/s and kv 90 Nms/rad, 40/s and 30 Nms/rad.
pub fn servos() -> Vec<ServoGains> {
    [(50.0, 90.0), (40.0, 30.0)].map(|(kp, kv)| ServoGains { stiffness: kp * kv, damping: kv }).to_vec()
}

pub fn facts(command: CommandKind, model: &Model) -> Facts {
    Facts {
        command,
        period_s: PERIOD_S,
        set_points: Setpoints::Held,
        gravity_by: GravityBy::Controller,
        on_missed_cycle: MissedCycle::HoldLast,
        motor_torque: true,
        sensors: vec![ForceSensor { name: "wrist".to_owned(), frame: model.frame("fore").expect("a link") }],
    }
}

pub fn estimator() -> EstimatorParameters {
    parsed("velocity_filter_hz = 150.0")
}

/// Tared over ten ticks, with a torque ramp of 0.1 s.
pub fn safety() -> SafetyParameters {
    parsed("torque_ramp_s = 0.1\ntare_s = 0.01\nlimit_margin_rad = 0.05")
}

pub fn sensing(model: &Model, facts: Facts) -> Sensing {
    Sensing::new(model, facts, &estimator(), &safety())
}

/// What the robot was told.
#[derive(Clone, Debug, PartialEq)]
pub enum Told {
    Positions(DVector<f64>),
    Torques(DVector<f64>),
    Brake,
}

/// A robot whose samples are a function of the tick's number, counted from the first read.
pub struct Scripted<F> {
    pub facts: Facts,
    pub script: F,
    pub tick: u64,
    pub told: Arc<Mutex<Vec<Told>>>,
}

impl<F: FnMut(u64, &mut Sample) + Send> Scripted<F> {
    pub fn new(facts: Facts, script: F) -> Self {
        Self { facts, script, tick: 0, told: Arc::default() }
    }
}

/// A robot at rest at [`START`], which no command moves.
pub fn at_rest(tick: u64, sample: &mut Sample) {
    sample.time_s = tick as f64 * PERIOD_S;
    sample.q.copy_from_slice(&START);
}

impl<F: FnMut(u64, &mut Sample) + Send> Robot for Scripted<F> {
    fn facts(&self) -> &Facts {
        &self.facts
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), Fault> {
        (self.script)(self.tick, sample);
        self.tick += 1;
        Ok(())
    }
}

impl<F: FnMut(u64, &mut Sample) + Send> PositionRobot for Scripted<F> {
    fn set_positions(&mut self, q_desired: &[f64]) -> Result<(), Fault> {
        let told = Told::Positions(DVector::from_column_slice(q_desired));
        self.told.lock().expect("one thread").push(told);
        Ok(())
    }
}

impl<F: FnMut(u64, &mut Sample) + Send> TorqueRobot for Scripted<F> {
    fn set_torques(&mut self, tau: &[f64]) -> Result<(), Fault> {
        self.told.lock().expect("one thread").push(Told::Torques(DVector::from_column_slice(tau)));
        Ok(())
    }

    fn brake(&mut self) {
        self.told.lock().expect("one thread").push(Told::Brake);
    }
}

/// A controller made of a function.
pub struct Commanded<F> {
    pub kind: CommandKind,
    pub command: F,
}

impl<F: FnMut(&Data, &Measurement, &mut [f64]) + Send> Controller for Commanded<F> {
    fn command_kind(&self) -> CommandKind {
        self.kind
    }

    fn start(&mut self, _input: &ControlInput<'_>) {}

    fn update(&mut self, input: &ControlInput<'_>, command: &mut [f64]) {
        (self.command)(input.data, input.measurement, command);
    }
}

impl<F> Observable for Commanded<F> {
    fn signals(&self) -> Vec<Signal> {
        Vec::new()
    }

    fn sample(&self, _row: &mut Row<'_>) {}
}

/// The rows of the ticks: phase and fault of each.
#[derive(Default)]
pub struct Ticks(pub Vec<Vec<f64>>);

impl Sink for Ticks {
    fn row(&mut self, _channel: usize, _time_s: f64, row: &[f64]) {
        self.0.push(row.to_vec());
    }
}

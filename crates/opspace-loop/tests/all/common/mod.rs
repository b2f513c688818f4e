//! Two-joint arm, scripted robot, and record of its run.

#![allow(dead_code, unused_imports, reason = "each test uses some of it")]

pub mod cases;
mod record;
mod robot;

pub use record::{Record, Rows, columns, drive_robot, run};
pub use robot::{Commanded, Received, Scripted, VelocityServo, at_rest};

use nalgebra::DVector;
use opspace_backend::{Capabilities, CommandKind, Measured};
use opspace_control::{Controller, Measurement};
use opspace_loop::{LoopConfig, SafetyParameters};
use opspace_model::{Data, Model};
use opspace_transformer::{EstimatorParameters, Identity, PaperTransformer, ServoGains, Transformer};

pub const PERIOD_S: f64 = 1e-3;

/// Number of cycles at rest before control begins.
pub const REST: u64 = 10;

/// Number of rows in the 0.2 s after a stop.
pub const AFTERMATH: usize = 200;

/// Two links of 0.5 m in the vertical plane. At q = 0 both point along x, so that gravity acts on both joints.
pub const URDF: &str = r#"
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

/// Position gains kp of the servos, 1/s.
pub const KP: [f64; 2] = [50.0, 40.0];
/// Velocity gains kv of the servos, Nms/rad.
pub const KV: [f64; 2] = [90.0, 30.0];

pub const KINDS: [CommandKind; 3] = [CommandKind::Position, CommandKind::Velocity, CommandKind::Torque];

pub fn model() -> Model {
    Model::from_urdf(URDF).expect("the URDF").model
}

pub fn parsed<T: serde::de::DeserializeOwned>(text: &str) -> T {
    toml::from_str(text).unwrap_or_else(|e| panic!("{e}"))
}

pub fn servos() -> Vec<ServoGains> {
    (0..2).map(|i| ServoGains { stiffness: KP[i] * KV[i], damping: KV[i] }).collect()
}

/// Returns the arm's capabilities, with measured motor current and a force sensor on the forearm.
pub fn capabilities(kind: CommandKind) -> Capabilities {
    Capabilities::new(["shoulder", "elbow"], kind, PERIOD_S)
        .measuring(&[Measured::MotorCurrent])
        .with_force_sensor("wrist", "fore")
}

/// Returns a velocity estimator with the paper's cut-off frequency.
pub fn estimator() -> EstimatorParameters {
    parsed("velocity_filter_hz = 150.0")
}

/// Returns safety parameters with taring over [`REST`] cycles and a torque ramp of 0.1 s.
pub fn safety() -> SafetyParameters {
    parsed("torque_ramp_s = 0.1\ntare_s = 0.01\nlimit_margin_rad = 0.05")
}

/// Returns the configuration of a loop for a robot with these capabilities, without friction compensation.
pub fn config(capabilities: Capabilities, controller: impl Controller + 'static) -> LoopConfig {
    let transformer: Box<dyn Transformer> = match capabilities.command {
        CommandKind::Torque => Box::new(Identity),
        CommandKind::Position => Box::new(PaperTransformer::new(servos())),
        CommandKind::Velocity => Box::new(VelocityServo::new(KV)),
    };
    LoopConfig {
        transformer,
        servo_gains: servos(),
        estimator: estimator(),
        torque_limits: LIMITS.to_vec(),
        safety: safety(),
        ..LoopConfig::new(model(), capabilities, Box::new(controller))
    }
}

/// Returns a controller that balances the arm's weight and adds `extra` (Nm) at both joints.
pub fn gravity_controller(extra: f64) -> impl Controller {
    Commanded::torques(move |data, _, tau| {
        tau.iter_mut().zip(&data.gravity).for_each(|(tau, g)| *tau = g + extra);
    })
}

/// Returns a controller that commands [`START`] plus `offset` (rad), a function of time (s).
pub fn position_controller(offset: impl Fn(f64) -> f64 + Send) -> impl Controller {
    let command = move |_: &Data, measurement: &Measurement, q: &mut [f64]| {
        q.copy_from_slice(&START);
        q[1] += offset(measurement.time_s);
    };
    Commanded { kind: CommandKind::Position, command }
}

/// Returns the torques that balance the arm's weight, by hand: links of 0.5 m with their centres of mass halfway;
/// gravity acts in the direction of positive q.
pub fn gravity_at(q: &[f64]) -> DVector<f64> {
    let (first, second) = (q[0].cos(), (q[0] + q[1]).cos());
    let g = 9.81;
    let fore = 1.0 * g * 0.25 * second;
    DVector::from_vec(vec![-(2.0 * g * 0.25 * first + 1.0 * g * 0.5 * first + fore), -fore])
}

/// Returns the servos' torque for a command to a robot at rest at [`START`]; for a torque robot, the command.
pub fn servo_torque(received: &Received) -> DVector<f64> {
    match received {
        Received::Torques(tau) => tau.clone(),
        Received::Velocities(dq) => DVector::from_fn(2, |i, _| KV[i] * dq[i]),
        Received::Positions(q) => DVector::from_fn(2, |i, _| KP[i] * KV[i] * (q[i] - START[i])),
        Received::Hold | Received::Stop => panic!("{received:?} is no command of a controller"),
    }
}

/// Returns the setpoint that holds the arm at rest at `q` (rad): its offset from `q` is the weight over the servo's
/// stiffness.
pub fn holding_setpoint(q: &[f64]) -> DVector<f64> {
    let g = gravity_at(q);
    DVector::from_fn(2, |i, _| q[i] + g[i] / (KP[i] * KV[i]))
}

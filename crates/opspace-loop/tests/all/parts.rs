//! Tests that incompatible parts of a loop are rejected before the first cycle.
//!
//! Compared in all tests: the error, and the contradiction of the test's parts.

use crate::common::{KV, VelocityServo, capabilities, config, gravity_controller, position_controller};
use opspace_backend::{Capabilities, CommandKind};
use opspace_loop::{ControlLoop, LoopConfig, LoopError};

fn refusal(config: LoopConfig) -> LoopError {
    match ControlLoop::new(config) {
        Ok(_) => panic!("it is accepted"),
        Err(error) => error,
    }
}

#[test]
fn torque_robot_refuses_position_commands() {
    let (gives, takes) = (CommandKind::Position, CommandKind::Torque);
    let error = refusal(config(capabilities(takes), position_controller(|_| 0.0)));
    assert_eq!(error, LoopError::Kind { part: "controller", gives, takes });
    assert_eq!(
        error.to_string(),
        "the controller returns position commands, but the robot accepts torque commands"
    );
}

#[test]
fn position_robot_refuses_velocity_transformer() {
    let (gives, takes) = (CommandKind::Velocity, CommandKind::Position);
    let config = LoopConfig {
        transformer: Box::new(VelocityServo::new(KV)),
        ..config(capabilities(takes), gravity_controller(0.0))
    };
    assert_eq!(refusal(config), LoopError::Kind { part: "transformer", gives, takes });
}

#[test]
fn joints_in_another_order_are_refused() {
    let robot = Capabilities::new(["elbow", "shoulder"], CommandKind::Torque, 1e-3);
    let error = refusal(config(robot, gravity_controller(0.0)));
    let joints = |names: [&str; 2]| names.map(str::to_owned).to_vec();
    let [robot, model] = [joints(["elbow", "shoulder"]), joints(["shoulder", "elbow"])];
    assert_eq!(error, LoopError::Joints { robot, model });
}

#[test]
fn wrong_array_lengths_are_refused() {
    let position = || config(capabilities(CommandKind::Position), gravity_controller(0.0));
    let limits = LoopConfig { torque_limits: vec![1.0], ..position() };
    assert_eq!(refusal(limits), LoopError::Length { what: "torque_limits", found: 1, joints: 2 });
    let servos = LoopConfig { servo_gains: Vec::new(), ..position() };
    assert_eq!(refusal(servos), LoopError::Length { what: "servo_gains", found: 0, joints: 2 });
}

#[test]
fn force_sensor_on_unknown_frame_is_refused() {
    let robot = capabilities(CommandKind::Torque).with_force_sensor("foot", "sole");
    let error = refusal(config(robot, gravity_controller(0.0)));
    assert!(matches!(error, LoopError::Sensor(_)), "{error:?}");
    assert!(error.to_string().contains("sole"), "{error}");
}

//! Tests of ideal arms: rigid bodies with exactly the commanded torques.

use opspace_backend::{Backend, Capabilities, Command, CommandKind, Sample};
use opspace_model::Model;
use opspace_sim::{ArmConfig, SimulatedArm, SimulationError};

/// Rod of 2 kg with its centre of mass 0.5 m from the hinge and an inertia of 0.6 kg m² about the hinge.
const URDF: &str = r#"<robot name="pendulum"><link name="base"/>
    <joint name="hinge" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/></joint>
    <link name="rod"><inertial><origin xyz="0.5 0 0"/><mass value="2"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link></robot>"#;

fn config(command: CommandKind) -> ArmConfig {
    with_period(command, 1e-3).expect("a period")
}

fn with_period(command: CommandKind, period_s: f64) -> Result<ArmConfig, SimulationError> {
    let model = Model::from_urdf(URDF).expect("the URDF").model;
    ArmConfig::ideal(model, Capabilities::new(["hinge"], command, period_s).simulated(), Vec::new())
}

#[test]
fn invalid_period_is_refused() {
    for period_s in [0.0, -1e-3, f64::NAN, f64::INFINITY, 1e-320] {
        let refused = with_period(CommandKind::Torque, period_s).err().map(|error| error.to_string());
        assert!(refused.is_some_and(|words| words.contains("interface period")), "{period_s}");
    }
}

/// Compared: the speed of a rod that falls from the horizontal, and √(2 m g l sin q/I) by conservation of energy.
#[test]
fn rod_without_torque_conserves_energy() {
    /// Error of the integrator and of the rod's initial angle, at which the brake held it, rad/s.
    const TOLERANCE_RAD_PER_S: f64 = 1e-3;
    let mut arm = SimulatedArm::new(config(CommandKind::Torque)).expect("an arm");
    let mut sample = Sample::new(arm.capabilities());
    for _ in 0..300 {
        arm.read(&mut sample).expect("it can be read");
        arm.write(Command::Torque(&[0.0])).expect("it takes torques");
    }
    let (q, dq) = (arm.true_q()[0], arm.true_dq()[0]);
    assert!(q > 0.5, "it fell: {q} rad");
    let expected = (2.0 * 2.0 * 9.81 * 0.5 * q.sin() / 0.6).sqrt();
    assert!((dq - expected).abs() < TOLERANCE_RAD_PER_S, "{dq} rad/s, expected {expected}");
}

#[test]
fn position_arm_without_servos_is_refused() {
    let refused = SimulatedArm::new(config(CommandKind::Position)).err();
    assert_eq!(refused, Some(SimulationError::Servos { found: 0, joints: 1 }));
}

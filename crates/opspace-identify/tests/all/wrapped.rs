//! Identification of a continuous joint whose encoder counts within one turn.

use opspace_backend::quantity::Positive;
use opspace_backend::{
    Backend, Capabilities, Command, CommandKind, DeviceFault, Measured, Sample, Setpoints,
};
use opspace_identify::session::ExcitationSession;
use opspace_identify::{ExcitationPlan, KnownParameters, identify};
use opspace_model::{JointKind, Model};
use opspace_sim::{ArmConfig, SimulatedArm};
use opspace_transformer::{CascadedServo, ServoParameters};
use std::f64::consts::{PI, TAU};

const TURNTABLE: &str = r#"<robot name="turntable"><link name="base"/>
    <joint name="hinge" type="continuous"><parent link="base"/><child link="disc"/><axis xyz="0 0 1"/></joint>
    <link name="disc"><inertial><mass value="2"/>
    <inertia ixx="0.3" ixy="0" ixz="0" iyy="0.3" iyz="0" izz="0.6"/></inertial></link></robot>"#;

/// Position of the encoder at the start, rad: the joint passes half a turn in its first motion.
const START_RAD: f64 = PI - 0.01;

/// Rounding of positions near half a turn, in the gains that follow from them.
const ROUNDING: f64 = 1e-6;

/// Gains of the servo: position, 1/s, and velocity, Nms/rad; and the largest relative error of their estimates.
const KP_PER_S: f64 = 20.0;
const KV_NMS_PER_RAD: f64 = 30.0;
const ESTIMATED_WITHIN: f64 = 0.01;

/// A robot whose encoder reads `START_RAD` at the start, and whose drive takes setpoints of any turn.
struct Turned {
    arm: SimulatedArm,
    is_wrapped: bool,
}

impl Backend for Turned {
    fn capabilities(&self) -> &Capabilities {
        self.arm.capabilities()
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        self.arm.read(sample)?;
        let turned = sample.q[0] + START_RAD;
        sample.q[0] = if self.is_wrapped { (turned + PI).rem_euclid(TAU) - PI } else { turned };
        Ok(())
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        match command {
            Command::Position(q) => self.arm.write(Command::Position(&[q[0] - START_RAD])),
            other => self.arm.write(other),
        }
    }

    fn stop(&mut self) {
        self.arm.stop();
    }
}

/// Returns the gains (1/s; Nms/rad) that are identified.
fn gains(is_wrapped: bool) -> [f64; 2] {
    let servo = ServoParameters::Cascaded(CascadedServo::new(
        Positive::literal(KP_PER_S),
        Positive::literal(KV_NMS_PER_RAD),
        Positive::literal(600.0),
    ));
    let capabilities = Capabilities::new(["hinge"], CommandKind::Position, 1e-3)
        .measuring(&[Measured::MotorCurrent])
        .simulated();
    let model = Model::from_urdf(TURNTABLE).expect("a URDF").model;
    let config = ArmConfig::ideal(model, capabilities, vec![servo]).expect("an arm");
    let mut robot = Turned { arm: SimulatedArm::new(config).expect("an arm"), is_wrapped };
    let known = KnownParameters {
        joint: 0,
        servo_period_s: 2e-4,
        servo_ticks_per_cycle: 5,
        setpoints: Setpoints::Held,
        lower: START_RAD - 1.0,
        upper: START_RAD + 1.0,
        speed_limit: 5.0,
        torque_limit: 50.0,
        resolution: 1e-6,
        inertia: None,
        viscous_friction: 0.0,
    };
    let plan = ExcitationPlan { period_s: 1.0, realisations: 1, speeds: 3, ..ExcitationPlan::default() };
    let interrupted = |_ticks: u64| false;
    let mut session =
        ExcitationSession::begin(&mut robot, &[JointKind::Continuous], &interrupted).expect("a robot");
    let servo =
        identify(&mut session, &known, &plan).expect("a robot without faults").servo.expect("a servo");
    [servo.kp, servo.kv]
}

/// Compared: gains with an encoder that counts from minus to plus half a turn, and with one that goes on.
#[test]
fn encoder_within_a_turn_gives_the_same_gains() {
    let [kp, kv] = gains(false);
    let errors = [kp / KP_PER_S - 1.0, kv / KV_NMS_PER_RAD - 1.0];
    assert!(errors.iter().all(|error| error.abs() < ESTIMATED_WITHIN), "{kp} {kv}");
    let [wrapped_kp, wrapped_kv] = gains(true);
    assert!(
        (wrapped_kp / kp - 1.0).abs() < ROUNDING && (wrapped_kv / kv - 1.0).abs() < ROUNDING,
        "{wrapped_kp} {wrapped_kv}"
    );
}

//! Single requests.

use crate::common::{IDS, JOINTS, bus, file, settings};
use opspace_backend::{Backend, Command, Sample, Setting};
use opspace_feetech::bus::Bus;
use opspace_feetech::calibration::Calibration;
use opspace_feetech::protocol::Register;
use opspace_feetech::scan::scan;
use opspace_feetech::simulated::{
    BusOptions, SeparateJoint, SeparateJoints, ServoOptions, SimulatedBus, SimulatedServo, SimulatedTransport,
};
use opspace_feetech::{ArmConfig, FeetechArm};
use std::time::Duration;

/// An answer that comes after a request was repeated is not taken for one to the next request: values are right or missing.
#[test]
fn late_answers_are_not_taken_for_others() {
    for latency_ms in [40, 49, 51, 60, 80, 99, 101, 120, 149] {
        let mut simulated = bus();
        simulated.options.latency = Duration::from_millis(latency_ms);
        let expected: Vec<_> = IDS.iter().filter_map(|id| simulated.servo(*id)).cloned().collect();
        let mut bus = Bus::new(SimulatedTransport::new(simulated));
        let mut answered = 0;
        for servo in &expected {
            for register in [
                Register::MIN_POSITION_LIMIT,
                Register::MAX_POSITION_LIMIT,
                Register::HOMING_OFFSET,
                Register::ID,
            ] {
                if let Ok(value) = bus.read(servo.id(), register) {
                    assert_eq!(value, servo.get(register), "{latency_ms} ms: {}", register.name);
                    answered += 1;
                }
            }
        }
        assert_eq!(answered, 12, "{latency_ms} ms");
    }
}

#[test]
fn scan_finds_the_servos_and_changes_nothing() {
    let simulated = bus();
    let before: Vec<Vec<u8>> = simulated.servos().iter().map(|servo| servo.read(0, 56).collect()).collect();
    let mut bus = Bus::new(SimulatedTransport::new(simulated));
    let found = scan(&mut bus, 20).expect("a port");
    assert_eq!(found.iter().map(|servo| servo.id).collect::<Vec<_>>(), IDS);
    for servo in &found {
        assert_eq!((servo.model_name(), servo.firmware), (Some("STS3215"), (3, 10)));
        assert_eq!((servo.voltage_v, servo.temperature_c), (7.4, 30));
        assert!(!servo.is_torque_on && servo.flags.is_empty());
    }
    let simulated = &bus.transport().bus;
    let after: Vec<Vec<u8>> = simulated.servos().iter().map(|servo| servo.read(0, 56).collect()).collect();
    assert_eq!(before, after);
}

/// Compares positions of the arm with those of the joints behind servos that were made for its configuration.
#[test]
fn simulated_servos_of_a_configuration_have_its_angles() {
    let ranges = [(-1.2, 1.5), (-2.0, 0.5), (-9.0, 9.0)];
    let calibration = Calibration::of_simulation(JOINTS.into_iter().zip(ranges)).expect("a calibration");
    let json = calibration.to_json().expect("a text");
    assert_eq!(Calibration::from_json(&json).expect("the same"), calibration);
    let file = file(&json);
    let settings = settings(&file)
        .with("inverted", Setting::List(vec![Setting::Text("elbow_flex".into())]))
        .with("zeros_rad", Setting::List([0.15, -0.75, 0.0].map(Setting::Number).to_vec()));
    let config = ArmConfig::from_settings(&settings).expect("a configuration");
    // By hand: the ranges of the model, where half a turn is in their middle.
    for (servo, range) in config.servos.iter().zip(&ranges[..2]) {
        let (lower, upper) = servo.scale.range();
        assert!((lower - range.0).abs() < 2e-3 && (upper - range.1).abs() < 2e-3, "{lower} {upper}");
    }
    let servo = |servo| SimulatedServo::calibrated(servo, ServoOptions::default());
    let servos = config.servos.iter().map(servo).collect();
    let joints = SeparateJoints::new(vec![SeparateJoint::default(); 3], &[0.4, -1.0, 2.0]);
    let bus = SimulatedBus::new(servos, Box::new(joints), BusOptions::default());
    let mut arm = FeetechArm::start(SimulatedTransport::new(bus), config).expect("an arm");
    let mut sample = Sample::new(arm.capabilities());
    for _ in 0..200 {
        arm.read(&mut sample).expect("a sample");
        arm.write(Command::Position(&[-0.5, -0.2, 1.0])).expect("a command");
    }
    let q = arm.transport_mut().bus.joints().q();
    for ((measured, q), target) in sample.q.iter().zip(q).zip([-0.5, -0.2, 1.0]) {
        assert!((measured - q).abs() < 1e-3, "{measured} {q}");
        // Friction of 0.052 Nm at 8.9 Nm/rad.
        assert!((q - target).abs() < 0.01, "{q} {target}");
    }
}

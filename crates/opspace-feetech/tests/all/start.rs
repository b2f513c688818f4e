//! The start of an arm: what is compared, written and refused.

use crate::common::{IDS, arm, bus, config, refusal};
use opspace_backend::{Backend, Observed, ObservedTorque, Sample, Setting};
use opspace_feetech::FeetechArm;
use opspace_feetech::protocol::{ErrorFlags, Register};
use opspace_feetech::simulated::{SimulatedBus, SimulatedTransport};
use std::time::Duration;

fn set(bus: &mut SimulatedBus, register: Register, value: i32) {
    bus.servo_mut(3).expect("a servo").set(register, value);
}

#[test]
fn profile_is_written_and_torque_is_on() {
    let mut arm = arm(|_| {});
    let bus = &arm.transport_mut().bus;
    for id in IDS {
        let servo = bus.servo(id).expect("a servo");
        for (register, value) in [
            (Register::P_COEFFICIENT, 16),
            (Register::I_COEFFICIENT, 0),
            (Register::D_COEFFICIENT, 32),
            (Register::ACCELERATION, 0),
            (Register::GOAL_VELOCITY, 0),
            (Register::LOCK, 1),
            (Register::TORQUE_ENABLE, 1),
        ] {
            assert_eq!(servo.get(register), value, "{}", register.name);
        }
    }
}

/// Goals are the positions at which torque is switched on: no joint moves by more than it sags.
#[test]
fn start_does_not_pull_the_arm() {
    let mut arm = arm(|bus| bus.advance_to(Duration::from_millis(500)));
    let goals = arm.goals().to_vec();
    let positions =
        IDS.map(|id| arm.transport_mut().bus.servo(id).expect("a servo").get(Register::PRESENT_POSITION));
    for (goal, position) in goals.iter().zip(positions) {
        // Torque was off until then: the first joints have sunk while later ones were asked.
        assert!((goal - position).abs() < 60, "{goals:?} {positions:?}");
    }
}

/// A servo that holds already keeps its goal, so that it does not sag again.
#[test]
fn servo_that_holds_keeps_its_goal() {
    let held = |bus: &mut SimulatedBus| {
        for id in IDS {
            let servo = bus.servo_mut(id).expect("a servo");
            let position = servo.get(Register::PRESENT_POSITION);
            servo.set(Register::P_COEFFICIENT, 16);
            servo.set(Register::GOAL_POSITION, position);
            servo.write(Register::TORQUE_ENABLE.address, &[1]);
        }
        bus.advance_to(Duration::from_secs(2));
    };
    let mut before = bus();
    held(&mut before);
    let q = before.joints().q().to_vec();
    let mut arm = arm(held);
    let goals = arm.goals().to_vec();
    assert_eq!(goals, IDS.map(|id| before.servo(id).expect("a servo").get(Register::GOAL_POSITION)));
    let after = arm.transport_mut().bus.joints().q().to_vec();
    for (q, after) in q.iter().zip(after) {
        assert!((q - after).abs() < 1e-3, "{q} {after}");
    }
}

#[test]
fn gain_that_differs_is_refused() {
    let words =
        refusal(|bus| bus.servo_mut(3).expect("a servo").stuck = Some(Register::P_COEFFICIENT.address));
    assert_eq!(
        words,
        "servo 3 (elbow_flex) has P_Coefficient 32 after 16 was written: robot.toml and the servo do not agree"
    );
}

#[test]
fn contradictions_are_refused_before_anything_is_written() {
    let cases: [(Register, i32, &str); 6] = [
        (Register::HOMING_OFFSET, 5, "has Homing_Offset 5, but the calibration has homing_offset -40"),
        (Register::MIN_POSITION_LIMIT, 5, "the calibration has range_min 900"),
        (Register::MAX_POSITION_LIMIT, 4000, "the calibration has range_max 3200"),
        (Register::OPERATING_MODE, 1, "has Operating_Mode 1; it must be 0, position"),
        (Register::MODEL_NUMBER, 1284, "is of model 1284; the models are: 777 (STS3215)"),
        (Register::PHASE, 4, "state goal_speed_rad_per_s"),
    ];
    for (register, value, expected) in cases {
        let mut bus = bus();
        set(&mut bus, register, value);
        let mut transport = SimulatedTransport::new(bus);
        let started = FeetechArm::start(&mut transport, config(|settings| settings));
        let words = started.err().expect("refused").to_string();
        assert!(words.contains(expected), "{words}");
        for id in IDS {
            let servo = transport.bus.servo(id).expect("a servo");
            assert_eq!(servo.get(Register::P_COEFFICIENT), 32, "{}", register.name);
            assert!(!servo.is_torque_on());
        }
    }
}

#[test]
fn missing_servo_and_errors_are_named() {
    let words = refusal(|bus| bus.options.silent_ids = vec![4]);
    assert!(words.starts_with("servo 4 (wrist_flex) does not answer"), "{words}");
    assert!(words.ends_with("(code 12)"), "{words}");
    let words = refusal(|bus| bus.options.wrong_checksum = Some(2));
    assert!(words.contains("servo 2 (shoulder_lift) sends answers with wrong checksums"), "{words}");
    let words = refusal(|bus| bus.options.renamed = Some((2, 9)));
    assert!(words.contains("servo 2 (shoulder_lift) sends other answers"), "{words}");
    let words = refusal(|bus| bus.servo_mut(3).expect("a servo").options.voltage_v = 12.1);
    assert_eq!(
        words,
        "servo 3 (elbow_flex) reports a supply voltage outside its limits: 12.1 V, of 4.0 to 8.0 V (code 20)"
    );
    let words = refusal(|bus| bus.servo_mut(3).expect("a servo").flags = ErrorFlags::OVERLOAD);
    assert!(words.contains("servo 3 (elbow_flex) reports overload"), "{words}");
    let words = refusal(|bus| bus.options.gone = true);
    assert!(words.contains("the serial port is gone"), "{words}");
}

/// By hand: at 38400 baud the answers take at least three times 16 bytes of 0.26 ms.
#[test]
fn bus_that_is_slower_than_the_rate_is_refused() {
    let words = refusal(|bus| bus.options.baud_hz = 38400);
    assert!(words.starts_with("bus slower than the rate asked: 3 servos answer within 16.9 ms"), "{words}");
    assert!(words.contains("at 100 Hz it may be 7.0 ms"), "{words}");
    let words = refusal(|bus| bus.options.latency = Duration::from_millis(16));
    assert!(words.contains("latency timer"), "{words}");
}

/// Answers that come after all attempts are late, not missing.
#[test]
fn late_servo_is_told_from_a_missing_one() {
    let late = refusal(|bus| bus.options.latency = Duration::from_millis(400));
    assert!(late.starts_with("servo 2 (shoulder_lift) answers more than 50 ms after a request"), "{late}");
    assert!(late.contains("(code 15)"), "{late}");
    let missing = refusal(|bus| bus.options.silent_ids = vec![2]);
    assert!(missing.starts_with("servo 2 (shoulder_lift) does not answer"), "{missing}");
}

#[test]
fn lost_answers_do_not_prevent_the_start() {
    let arm = arm(|bus| bus.options.lost_share = 0.05);
    assert!(arm.round() < Duration::from_millis(3), "{:?}", arm.round());
}

#[test]
fn speed_and_acceleration_are_registers_and_limits() {
    let config = config(|settings| {
        settings
            .with("goal_speed_rad_per_s", Setting::Number(2.0))
            .with("acceleration_rad_per_s2", Setting::Number(10.0))
    });
    let mut bus = bus();
    for id in IDS {
        // Velocities in 50 counts/s.
        bus.servo_mut(id).expect("a servo").set(Register::PHASE, 8);
    }
    let mut arm = FeetechArm::start(SimulatedTransport::new(bus), config).expect("an arm");
    let servo = arm.transport_mut().bus.servo(3).expect("a servo");
    // By hand: 2 rad/s are 1304 counts/s, and 10 rad/s² are 6519 counts/s².
    assert_eq!((servo.get(Register::GOAL_VELOCITY), servo.get(Register::ACCELERATION)), (26, 65));
    let limits = &arm.capabilities().joint_limits;
    assert_eq!(limits[1].setpoint_velocity_rad_per_s, Some(2.0));
}

/// A servo may ignore goals while its torque is off: then it gets its goal at once after torque is on, and is not pulled to an
/// old one.
#[test]
fn servo_that_ignores_goals_without_torque_is_not_pulled() {
    let started = |is_ignoring: bool| {
        let mut arm = arm(|bus| {
            for id in IDS {
                let servo = bus.servo_mut(id).expect("a servo");
                servo.ignores_goals_without_torque = is_ignoring;
                servo.set(Register::GOAL_POSITION, 3000);
            }
        });
        let goals = arm.goals().to_vec();
        let bus = &arm.transport_mut().bus;
        assert_eq!(goals, IDS.map(|id| bus.servo(id).expect("a servo").get(Register::GOAL_POSITION)));
        bus.joints().q().to_vec()
    };
    for (ignoring, usual) in started(true).into_iter().zip(started(false)) {
        assert!((ignoring - usual).abs() < 5e-3, "{ignoring} {usual}");
    }
}

/// An arm that is observed keeps its gains and its torque: nothing is written.
#[test]
fn observed_arm_is_read_and_not_written() {
    let mut arm = FeetechArm::observe(
        SimulatedTransport::new(bus()),
        config(|settings| settings),
        ObservedTorque::AsFound,
    )
    .expect("an arm");
    let mut sample = Sample::new(arm.capabilities());
    arm.read(&mut sample).expect("a sample");
    // The joints of the bus fall without torque; it began at these angles (rad), and read at most 0.3 s later.
    for (q, begun) in sample.q.iter().zip([0.3, -0.4, 0.2]) {
        assert!((q - begun).abs() < 0.6, "{:?}", sample.q);
    }
    assert!(arm.raw(1).expect("a raw value").ends_with(" counts"));
    assert!(arm.state().expect("a state").ends_with("torque off"), "{:?}", arm.state());
    let bus = &arm.transport_mut().bus;
    for id in IDS {
        let servo = bus.servo(id).expect("a servo");
        assert_eq!((servo.get(Register::P_COEFFICIENT), servo.is_torque_on()), (32, false));
    }
}

/// Joints that are held sink at 0.3 rad/s until they lie on their ends, and only then lose their torque.
#[test]
fn released_arm_is_lowered_first() {
    let held = |bus: &mut SimulatedBus| {
        for id in IDS {
            let servo = bus.servo_mut(id).expect("a servo");
            let position = servo.get(Register::PRESENT_POSITION);
            servo.set(Register::GOAL_POSITION, position);
            servo.write(Register::TORQUE_ENABLE.address, &[1]);
        }
        bus.advance_to(Duration::from_secs(1));
    };
    let observe = |torque| {
        let mut bus = bus();
        held(&mut bus);
        FeetechArm::observe(SimulatedTransport::new(bus), config(|settings| settings), torque)
    };
    let mut arm = observe(ObservedTorque::AsFound).expect("an arm");
    let mut sample = Sample::new(arm.capabilities());
    arm.read(&mut sample).expect("a sample");
    assert!(arm.state().expect("a state").ends_with("torque on"), "{:?}", arm.state());
    let mut arm = observe(ObservedTorque::Released).expect("an arm that lies");
    assert!(IDS.iter().all(|id| !arm.transport_mut().bus.servo(*id).expect("a servo").is_torque_on()));
    arm.read(&mut sample).expect("a sample");
    assert!(arm.state().expect("a state").ends_with("torque off"), "{:?}", arm.state());
}

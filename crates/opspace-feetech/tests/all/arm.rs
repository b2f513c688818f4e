//! The arm as a robot: samples, commands, pace and end.

use crate::common::{IDS, arm, bus, config};
use opspace_backend::{Backend, Command, Measured, Sample, Setting};
use opspace_feetech::FeetechArm;
use opspace_feetech::counts::RAD_PER_COUNT;
use opspace_feetech::protocol::Register;
use opspace_feetech::simulated::{SeparateJoint, SeparateJoints, SimulatedTransport};
use opspace_testing::allocation::counted;
use std::time::Duration;

/// Angle of a joint of the simulation where the arm is at 0: the middle of the calibrated range, rad.
const MIDDLES_RAD: [f64; 3] = [
    (2045.0 - 2048.0) * RAD_PER_COUNT,
    (2050.0 - 2048.0) * RAD_PER_COUNT,
    -(1925.0 - 2048.0) * RAD_PER_COUNT,
];

/// Compares the samples with the true state of the simulated joints.
#[test]
fn samples_are_the_true_state() {
    let config = config(|settings| {
        settings
            .measuring(&[Measured::Position, Measured::Velocity, Measured::MotorCurrent])
            .with("torque_per_current_nm_per_a", Setting::Number(1.21))
    });
    let mut arm = FeetechArm::start(SimulatedTransport::new(bus()), config).expect("an arm");
    let mut sample = Sample::new(arm.capabilities());
    for cycle in 0..300 {
        arm.read(&mut sample).expect("a sample");
        if cycle == 150 {
            arm.write(Command::Position(&[0.0, 0.0, 0.0])).expect("a command");
        }
        let joints = arm.transport_mut().bus.joints();
        let (q, dq) = (joints.q(), joints.dq());
        let velocity = sample.dq.as_ref().expect("measured");
        for joint in 0..3 {
            // The state is up to the duration of the request newer than the sample: 3 ms.
            let tolerance = RAD_PER_COUNT + 5e-3 * dq[joint].abs();
            assert!((sample.q[joint] - (q[joint] - MIDDLES_RAD[joint])).abs() < tolerance, "{cycle} {joint}");
            assert!((velocity[joint] - dq[joint]).abs() < RAD_PER_COUNT + 0.2 * dq[joint].abs() + 0.1);
        }
    }
    // By hand: at rest the motors carry the weights -0.6, 0.4 and 0.1 Nm times cos q, but for friction of 0.052 Nm.
    let torque = sample.motor_torque.as_ref().expect("measured");
    let q = arm.transport_mut().bus.joints().q().to_vec();
    for (joint, weight) in [-0.6, 0.4, 0.1].into_iter().enumerate() {
        assert!((torque[joint] + weight * q[joint].cos()).abs() < 0.06, "{torque:?}");
    }
    let status = sample.status.expect("reported");
    assert_eq!(status.word.to_le_bytes(), [0, 74, 30, 0]);
    assert!(!status.command_limited);
}

#[test]
fn cycles_are_multiples_of_the_period() {
    let mut arm = arm(|_| {});
    let mut sample = Sample::new(arm.capabilities());
    arm.read(&mut sample).expect("a sample");
    let first = sample.time_s;
    for cycle in 1..100 {
        arm.write(Command::Hold).expect("held");
        arm.read(&mut sample).expect("a sample");
        assert!((sample.time_s - first - 0.01 * f64::from(cycle)).abs() < 1e-9);
    }
}

/// A program that is late finds a gap in the times, not old samples.
#[test]
fn late_program_misses_cycles() {
    let mut arm = arm(|_| {});
    let mut sample = Sample::new(arm.capabilities());
    arm.read(&mut sample).expect("a sample");
    let first = sample.time_s;
    let now = Duration::from_secs_f64(first);
    opspace_feetech::transport::Transport::wait_until(arm.transport_mut(), now + Duration::from_millis(57));
    arm.read(&mut sample).expect("a sample");
    assert!((sample.time_s - first - 0.057).abs() < 1e-9, "{}", sample.time_s - first);
    arm.read(&mut sample).expect("a sample");
    assert!((sample.time_s - first - 0.06).abs() < 1e-9, "{}", sample.time_s - first);
    assert_eq!(arm.counts().late, 4);
}

#[test]
fn goals_beyond_the_calibration_are_clamped_and_said() {
    let mut arm = arm(|_| {});
    let mut sample = Sample::new(arm.capabilities());
    arm.read(&mut sample).expect("a sample");
    arm.write(Command::Position(&[3.0, 0.0, -3.0])).expect("a command");
    arm.read(&mut sample).expect("a sample");
    assert!(sample.status.expect("reported").command_limited);
    assert_eq!(arm.goals(), [3290, 2050, 3000]);
    let goals =
        IDS.map(|id| arm.transport_mut().bus.servo(id).expect("a servo").get(Register::GOAL_POSITION));
    assert_eq!(goals, [3290, 2050, 3000]);
}

#[test]
fn wrong_commands_are_refused() {
    let mut arm = arm(|_| {});
    let before = arm.goals().to_vec();
    for command in [
        Command::Torque(&[0.0; 3]),
        Command::Velocity(&[0.0; 3]),
        Command::Position(&[0.0]),
        Command::Position(&[0.0, f64::NAN, 0.0]),
    ] {
        assert_eq!(arm.write(command).expect_err("refused").code, 1);
    }
    assert_eq!(arm.goals(), before);
}

/// A cycle allocates nothing, nor do missed cycles and the fault at their end.
#[test]
fn cycles_do_not_allocate() {
    let mut arm = arm(|_| {});
    let mut sample = Sample::new(arm.capabilities());
    arm.read(&mut sample).expect("a sample");
    let (fault, count) = counted(|| {
        for _ in 0..100 {
            arm.read(&mut sample).expect("a sample");
            arm.write(Command::Position(&[0.1, 0.2, 0.3])).expect("a command");
        }
        arm.transport_mut().bus.options.gone = false;
        arm.transport_mut().bus.options.wrong_checksum = Some(3);
        let fault = arm.read(&mut sample).expect_err("a fault");
        arm.stop();
        fault
    });
    assert_eq!(fault.code, 14);
    assert_eq!(count.allocations, 0);
}

/// A lost packet with goals is sent again at the stop, and torque stays on.
#[test]
fn stop_holds_the_last_goals() {
    let mut arm = arm(|_| {});
    let mut sample = Sample::new(arm.capabilities());
    arm.read(&mut sample).expect("a sample");
    arm.write(Command::Position(&[0.1, 0.2, 0.3])).expect("a command");
    let goals = arm.goals().to_vec();
    for id in IDS {
        arm.transport_mut().bus.servo_mut(id).expect("a servo").set(Register::GOAL_POSITION, 2000);
    }
    arm.stop();
    arm.stop();
    for (id, goal) in IDS.into_iter().zip(goals) {
        let servo = arm.transport_mut().bus.servo(id).expect("a servo");
        assert_eq!(servo.get(Register::GOAL_POSITION), goal);
        assert!(servo.is_torque_on());
    }
    assert_eq!(arm.finish(), Ok(false));
    assert!(arm.transport_mut().bus.servo(3).expect("a servo").is_torque_on());
}

/// Joints sink at the declared speed until their ends carry them; then torque is off.
#[test]
fn arm_is_lowered_and_released() {
    let config = config(|settings| {
        settings
            .with("at_end", Setting::Text("lower".into()))
            .with("lowering_speed_rad_per_s", Setting::Number(0.3))
    });
    let mut bus = bus();
    let joint =
        |weight_nm, end: (f64, f64)| SeparateJoint { weight_nm, ends_rad: end, ..SeparateJoint::default() };
    let joints = SeparateJoints::new(
        vec![joint(-0.6, (-0.7, 1.9)), joint(0.4, (-1.9, 0.5)), joint(0.0, (-1.5, 1.5))],
        &[0.3, -0.4, 0.2],
    );
    bus = opspace_feetech::simulated::SimulatedBus::new(
        bus.servos().to_vec(),
        Box::new(joints),
        bus.options.clone(),
    );
    let mut arm = FeetechArm::start(SimulatedTransport::new(bus), config).expect("an arm");
    let mut sample = Sample::new(arm.capabilities());
    for _ in 0..100 {
        arm.read(&mut sample).expect("a sample");
        arm.write(Command::Hold).expect("held");
    }
    arm.stop();
    let begun = arm.transport_mut().bus.now();
    let from = arm.transport_mut().bus.joints().q().to_vec();
    assert_eq!(arm.finish(), Ok(true));
    let bus = &arm.transport_mut().bus;
    let (lasted, q) = ((bus.now() - begun).as_secs_f64(), bus.joints().q());
    assert!((q[0] + 0.7).abs() < 1e-9 && (q[1] - 0.5).abs() < 1e-9, "{q:?}");
    // Not faster than declared: the first joint sinks by 0.9 rad or so.
    assert!(lasted > (from[0] + 0.7) / 0.3 - 0.5, "{lasted} s from {from:?}");
    assert!(lasted < 8.0, "{lasted}");
    assert!(IDS.iter().all(|id| !bus.servo(*id).expect("a servo").is_torque_on()));
}

/// A weight without an end keeps sinking: after the longest duration the arm is held.
#[test]
fn arm_that_does_not_lie_is_held() {
    let config = config(|settings| {
        settings.with("at_end", Setting::Text("lower".into())).with("lowering_s", Setting::Number(0.5))
    });
    let mut arm = FeetechArm::start(SimulatedTransport::new(bus()), config).expect("an arm");
    let mut sample = Sample::new(arm.capabilities());
    arm.read(&mut sample).expect("a sample");
    assert_eq!(arm.finish(), Ok(false));
    assert!(IDS.iter().all(|id| arm.transport_mut().bus.servo(*id).expect("a servo").is_torque_on()));
}

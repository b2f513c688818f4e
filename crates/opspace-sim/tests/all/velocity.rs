//! Tests of robots that accept joint velocities.

use crate::common::{START, arm, parsed, read, servo_rows, setup};
use nalgebra::DVector;
use opspace_backend::quantity::NonNegative;
use opspace_backend::{Backend, Command, CommandKind, Setpoints};
use opspace_model::{Data, gravity, kinematics, rnea};
use opspace_sim::{ArmConfig, Key, SimulatedArm, SimulationError};
use opspace_transformer::ServoParameters;

const KV: f64 = 90.0;

/// Returns a velocity robot without friction.
fn velocity_robot(has_brakes: bool, ki_nm_per_rad: f64) -> ArmConfig {
    let mut config = setup(CommandKind::Velocity, "a-med");
    let servo: ServoParameters = parsed(&format!(
        "velocity = {{ kv_nms_per_rad = {KV:.1}, ki_nm_per_rad = {ki_nm_per_rad:.1}, velocity_filter_hz = 600.0 }}"
    ));
    config.servos = vec![servo; 4];
    config.capabilities.has_brakes = has_brakes;
    config.simulated.true_over_nominal.friction = NonNegative::literal(0.0);
    config
}

fn holding(config: &ArmConfig, q: &DVector<f64>) -> DVector<f64> {
    let mut data = Data::new(&config.model);
    kinematics(&config.model, &mut data, q.as_slice(), &[0.0; 4]);
    gravity(&config.model, &mut data);
    data.gravity
}

fn largest_displacement(arm: &SimulatedArm) -> f64 {
    (arm.true_q() - DVector::from_column_slice(&START)).amax()
}

/// Compared: the velocity error of each joint on a velocity ramp, and the motion's torque by inverse dynamics over kv.
#[test]
fn velocity_robot_follows_a_ramp() {
    /// Lag of the filter and of the hold, 0.5 ms, times the acceleration.
    const LAG_RAD_PER_S: f64 = 1.5e-3;
    const CYCLES: u32 = 200;
    let acceleration = [2.0, -1.5, 2.5, 1.0];
    let mut config = velocity_robot(false, 0.0);
    config.capabilities.setpoints = Setpoints::Interpolated;
    let mut arm = arm(config.clone());
    let mut reached = [0.0; 4];
    for cycle in 0..CYCLES {
        read(&mut arm);
        reached = acceleration.map(|a| a * f64::from(cycle) * 1e-3);
        arm.write(Command::Velocity(&reached)).expect("it takes them");
    }
    read(&mut arm);
    let mut data = Data::new(&config.model);
    let (q, dq) = (arm.true_q(), arm.true_dq());
    kinematics(&config.model, &mut data, q.as_slice(), dq.as_slice());
    rnea(&config.model, &mut data, &acceleration);
    for joint in 0..4 {
        let error = reached[joint] - dq[joint];
        let expected = data.torque[joint] / KV;
        assert!((error - expected).abs() < LAG_RAD_PER_S, "joint {joint}: {error} for {expected}");
    }
    assert!(dq[0] > 0.2 && data.torque.amax() / KV > 10.0 * LAG_RAD_PER_S, "{dq} {}", data.torque);
}

/// Compared: the deflection of braked joints and their weight over the brakes' stiffness, before the first command,
/// after a hold and after a stop. Between them, commands move the arm.
#[test]
fn brakes_hold_a_velocity_robot() {
    /// Remainder of the brakes' oscillation.
    const SETTLED_RAD: f64 = 1e-6;
    /// Damping times the remaining velocity.
    const START_NM: f64 = 1e-3;
    const KI: f64 = 900.0;
    let config = velocity_robot(true, KI);
    let stiffness = config.simulated.brake_of(40.0).stiffness_nm_per_rad.get();
    let mut arm = arm(config.clone());
    let settle = |arm: &mut SimulatedArm| (0..400).for_each(|_| drop(read(arm)));
    settle(&mut arm);
    let start = DVector::from_column_slice(&START);
    let deflected = &start - holding(&config, &arm.true_q()) / stiffness;
    assert!((arm.true_q() - deflected).amax() < SETTLED_RAD, "{}", arm.true_q());
    let move_on = |arm: &mut SimulatedArm| {
        // Released drives start with zero integral and zero velocity.
        arm.write(Command::Velocity(&[0.1, 0.0, 0.0, 0.0])).expect("it takes them");
        read(arm);
        let first = servo_rows(arm)[0].1[0];
        assert!((first - (KV + KI * 2e-4) * 0.1).abs() < START_NM, "{first} Nm");
        for _ in 0..300 {
            arm.write(Command::Velocity(&[0.5, 0.0, 0.0, 0.0])).expect("it takes them");
            read(arm);
        }
        assert!((arm.true_dq()[0] - 0.5).abs() < 0.05, "{}", arm.true_dq());
    };
    move_on(&mut arm);
    for stops in [false, true] {
        if stops {
            arm.stop()
        } else {
            arm.write(Command::Hold).expect("held")
        }
        settle(&mut arm);
        let stood = arm.true_q();
        settle(&mut arm);
        assert!((arm.true_q() - stood).amax() < SETTLED_RAD && arm.true_dq().amax() < SETTLED_RAD);
        let torque = read(&mut arm).motor_torque.expect("measured");
        assert_eq!(torque, [0.0; 4], "the motors are off");
        move_on(&mut arm);
    }
}

/// Compared: velocities of a robot without brakes, before the first command and after a hold: zero with an integral,
/// weight over kv without one.
#[test]
fn unbraked_velocity_robot_holds_only_with_integral() {
    /// Change of the weight along the motion, and decay of the servo's integral.
    const SAG_RAD_PER_S: f64 = 5e-3;
    let mut held = arm(velocity_robot(false, 900.0));
    let config = velocity_robot(false, 0.0);
    let mut sagging = arm(config.clone());
    let run = |arm: &mut SimulatedArm, cycles: u32, command: Option<Command<'_>>| {
        for _ in 0..cycles {
            read(arm);
            if let Some(command) = command {
                arm.write(command).expect("it takes them");
            }
        }
    };
    run(&mut held, 300, None);
    assert!(largest_displacement(&held) < 1e-9 && held.true_dq().amax() < 1e-9, "{}", held.true_dq());
    run(&mut held, 300, Some(Command::Velocity(&[0.3, 0.0, 0.0, 0.2])));
    run(&mut held, 3000, Some(Command::Hold));
    assert!(largest_displacement(&held) > 0.05 && held.true_dq().amax() < 1e-3, "{}", held.true_dq());
    run(&mut sagging, 100, None);
    let expected = -holding(&config, &sagging.true_q()) / KV;
    assert!((sagging.true_dq() - &expected).amax() < SAG_RAD_PER_S, "{} {expected}", sagging.true_dq());
    assert!(expected.amax() > 5.0 * SAG_RAD_PER_S);
}

/// Checks the errors, and their keys in the files, for robots whose nominal or true servos are of the wrong kind.
#[test]
fn servo_of_another_kind_is_refused() {
    let refused = |config: ArmConfig| SimulatedArm::new(config).err().expect("refused");
    let joint = "shoulder_pitch".to_owned();
    let path = |parts: &[&str]| parts.iter().map(|part| (*part).to_owned()).collect::<Vec<_>>();

    let error = refused(setup(CommandKind::Velocity, "a-med"));
    let setpoints = CommandKind::Velocity;
    assert_eq!(error, SimulationError::ServoKind { joint: joint.clone(), truth: false, setpoints });
    assert!(error.to_string().ends_with(": velocity_servo.shoulder_pitch is missing"), "{error}");
    assert_eq!(error.key(), Key::Profile(path(&["velocity_servo", "shoulder_pitch"])));

    let mut position = velocity_robot(false, 0.0);
    position.capabilities.command = CommandKind::Position;
    let error = refused(position);
    let setpoints = CommandKind::Position;
    assert_eq!(error, SimulationError::ServoKind { joint: joint.clone(), truth: false, setpoints });
    assert!(error.to_string().contains(": servo.shoulder_pitch.cascaded, .pid"), "{error}");
    assert_eq!(error.key(), Key::Profile(path(&["servo", "shoulder_pitch"])));

    let mut misplaced = velocity_robot(false, 0.0);
    misplaced.simulated.servo.insert(joint.clone(), misplaced.servos[0].clone());
    let error = refused(misplaced);
    assert_eq!(error, SimulationError::ServoKind { joint, truth: true, setpoints });
    assert!(error.to_string().contains(": simulated.servo.shoulder_pitch.cascaded, .pid"), "{error}");
    assert_eq!(error.key(), Key::Robot(path(&["simulated", "servo", "shoulder_pitch"])));
}

/// Checks the error's key for a servo that cannot hold a torque, for each kind, nominal and true.
#[test]
fn servo_without_holding_torque_is_named() {
    /// Gain so low that the setpoint for a torque of 1 Nm exceeds the bound.
    const NO_GAIN: &str = "kv_nms_per_rad = 1e-13\nvelocity_filter_hz = 600.0";
    let joint = "shoulder_pitch".to_owned();
    let key = |config: ArmConfig| SimulatedArm::new(config).err().expect("refused").key();

    let mut nominal = velocity_robot(false, 0.0);
    nominal.servos[0] = ServoParameters::Velocity(parsed(NO_GAIN));
    assert_eq!(key(nominal), Key::Profile(vec!["velocity_servo".to_owned(), joint.clone()]));

    let mut truth = velocity_robot(false, 0.0);
    truth.simulated.velocity_servo.insert(joint.clone(), parsed(NO_GAIN));
    let expected = vec!["simulated".to_owned(), "velocity_servo".to_owned(), joint];
    assert_eq!(key(truth), Key::Robot(expected));
}

/// Compared: first torques of a joint with true servos of both kinds in one file, on a velocity and on a position
/// robot, and the gains of the servo of the robot's kind.
#[test]
fn each_robot_runs_the_true_servo_of_its_kind() {
    /// Rounding error of a position times the stiffness.
    const ROUNDING_NM: f64 = 1e-9;
    const TRUE_KV: f64 = 60.0;
    const CASCADE: [f64; 2] = [30.0, 50.0];
    let with_truths = |mut config: ArmConfig| {
        let joint = || "shoulder_pitch".to_owned();
        let velocity = format!("kv_nms_per_rad = {TRUE_KV:.1}\nvelocity_filter_hz = 600.0");
        let [kp, kv] = CASCADE;
        let position = format!(
            "cascaded = {{ kp_per_s = {kp:.1}, kv_nms_per_rad = {kv:.1}, velocity_filter_hz = 600.0 }}"
        );
        config.simulated.velocity_servo.insert(joint(), parsed(&velocity));
        config.simulated.servo.insert(joint(), parsed(&position));
        arm(config)
    };
    let first_torques = |arm: &mut SimulatedArm, command: Command<'_>| {
        read(arm);
        arm.write(command).expect("it takes them");
        read(arm);
        servo_rows(arm)[0].1.clone()
    };

    let robot = velocity_robot(true, 0.0);
    let torque = first_torques(&mut with_truths(robot), Command::Velocity(&[0.1, 0.1, 0.0, 0.0]));
    assert!((torque[0] - TRUE_KV * 0.1).abs() < ROUNDING_NM, "{torque:?}");
    assert!((torque[1] - KV * 0.1).abs() < ROUNDING_NM, "the nominal one of the next joint: {torque:?}");

    let mut setpoint = START;
    setpoint[0] += 1e-3;
    let torque =
        first_torques(&mut with_truths(setup(CommandKind::Position, "a-med")), Command::Position(&setpoint));
    let expected = CASCADE[0] * CASCADE[1] * 1e-3;
    assert!((torque[0] - expected).abs() < ROUNDING_NM, "{torque:?} for {expected}");
}

/// Checks that the servos of a torque robot without brakes hold its position before the first command and after a hold.
#[test]
fn unbraked_torque_robot_holds_by_its_servos() {
    let mut config = setup(CommandKind::Torque, "a-med");
    config.capabilities.has_brakes = false;
    let mut arm = arm(config.clone());
    (0..300).for_each(|_| drop(read(&mut arm)));
    assert!(largest_displacement(&arm) < 1e-9, "{}", largest_displacement(&arm));
    for _ in 0..100 {
        arm.write(Command::Torque(&[-5.0, 0.0, 0.0, 0.0])).expect("it takes them");
        read(&mut arm);
    }
    assert!(largest_displacement(&arm) > 0.01);
    arm.write(Command::Hold).expect("held");
    (0..1000).for_each(|_| drop(read(&mut arm)));
    assert!(arm.true_dq().amax() < 1e-4, "{}", arm.true_dq());
    let torque = DVector::from_vec(read(&mut arm).motor_torque.expect("measured"));
    // Static friction may hold a part of the weight.
    assert!((torque - holding(&config, &arm.true_q())).amax() < 2.5);
}

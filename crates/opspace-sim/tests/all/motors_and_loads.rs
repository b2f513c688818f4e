//! Cogging, torque ripple, measured motor torques, joint torque sensors and unknown loads.

use crate::common::{START, arm, parsed, read, servo_rows, setup};
use nalgebra::{DVector, Matrix6xX};
use opspace_backend::{Backend, Command, CommandKind, Measured, Sample};
use opspace_model::{Data, Placement, frame_jacobian, gravity, kinematics};
use opspace_sim::motor::AngleTorque;
use opspace_sim::{ArmConfig, Key, SimulatedArm, SimulationError};
use std::f64::consts::TAU;

/// Compared: the torque of a motor with cogging and ripple over one turn, and the sines of its angle.
#[test]
fn cogging_and_ripple_are_sines_of_motor_angle() {
    let cogging = parsed("amplitude_of_limit = 0.02\nperiods_per_motor_turn = 12");
    let ripple = parsed("amplitude = 0.05\nperiods_per_motor_turn = 3");
    let motor = AngleTorque::new(Some(&cogging), Some(&ripple), 100.0, 50.0);
    for step in 0..50 {
        let turn = f64::from(step) / 50.0;
        let torque = motor.torque(8.0, TAU * turn / 100.0);
        let expected = 8.0 * (1.0 + 0.05 * (TAU * 3.0 * turn).sin()) + (TAU * 12.0 * turn).sin();
        assert!((torque - expected).abs() < 1e-9, "{turn}: {torque} for {expected}");
    }
    let smooth = AngleTorque::new(None, None, 100.0, 50.0);
    assert_eq!(smooth.torque(8.0, 0.123), 8.0);
}

/// Compared: true motor torque minus measured torque at rest, and the cogging at the start position, which the current
/// does not show.
#[test]
fn current_does_not_show_cogging() {
    let mut config = setup(CommandKind::Position, "a-med");
    config.simulated.cogging = Some(parsed("amplitude_of_limit = 0.01\nperiods_per_motor_turn = 7"));
    let mut arm = arm(config.clone());
    read(&mut arm);
    let sample = read(&mut arm);
    let rows = servo_rows(&arm);
    let measured = sample.motor_torque.expect("measured");
    for (joint, drive) in config.joints.iter().enumerate() {
        let mean = rows.iter().map(|(_, torque)| torque[joint]).sum::<f64>() / rows.len() as f64;
        let angle = 7.0 * drive.rotor.gear_ratio.get() * START[joint];
        let cogging = 0.01 * drive.torque_limit_nm.get() * angle.sin();
        // The joint moves by some microradians, to which the cogging is sensitive.
        let error = mean - measured[joint] - cogging;
        assert!(
            error.abs() < 0.02 * drive.torque_limit_nm.get() * 0.01,
            "joint {joint}: {error} of {cogging}"
        );
    }
}

/// Returns a torque robot without lag, gravity and friction.
fn torque_robot() -> ArmConfig {
    let mut config = setup(CommandKind::Torque, "a-med");
    config.capabilities = config.capabilities.measuring(&[Measured::JointTorque]);
    config
}

/// Commands in each cycle one Nm more to the elbow, and returns the samples.
fn ramp(config: ArmConfig) -> Vec<Sample> {
    let mut arm = arm(config);
    (0..12)
        .map(|cycle| {
            let sample = read(&mut arm);
            let command = [0.0, 0.0, 0.0, f64::from(cycle)];
            arm.write(Command::Torque(&command)).expect("it is accepted");
            sample
        })
        .collect()
}

/// Compared: measured torques of a torque that grows by 1 Nm per cycle of five servo ticks, and the commands: with a
/// scale, and late by two ticks and by a cycle.
#[test]
fn measured_torque_is_scaled_and_late() {
    let elbow = |parameters: &str| -> Vec<f64> {
        let mut config = torque_robot();
        config.simulated.current_measurement = parsed(parameters);
        ramp(config).into_iter().map(|sample| sample.motor_torque.expect("measured")[3]).collect()
    };
    let same = |measured: &[f64], expected: &dyn Fn(f64) -> f64| {
        for (measured, cycle) in measured.iter().zip(0..).skip(4) {
            let expected = expected(f64::from(cycle));
            assert!((measured - expected).abs() < 1e-9, "cycle {cycle}: {measured} for {expected}");
        }
    };
    same(&elbow(""), &|cycle| cycle - 1.0);
    same(&elbow("scale = 1.05"), &|cycle| 1.05 * (cycle - 1.0));
    same(&elbow("scale = 1.05\njoint_scale = { elbow = 0.9, shoulder_yaw = 2.0 }"), &|cycle| {
        0.945 * (cycle - 1.0)
    });
    same(&elbow("delay_servo_ticks = 5"), &|cycle| cycle - 2.0);
    same(&elbow("delay_servo_ticks = 2"), &|cycle| cycle - 1.4);
    same(&elbow("delay_servo_ticks = 8"), &|cycle| cycle - 2.6);
}

/// Compared: the torque sensors of a position robot with elastic gears at rest, and its weight.
#[test]
fn joint_torque_sensor_measures_gear() {
    let mut config = setup(CommandKind::Position, "a-med");
    config.capabilities = config.capabilities.measuring(&[Measured::JointTorque]);
    for drive in &mut config.joints {
        let gear: opspace_sim::parameters::GearParameters = parsed("stiffness_nm_per_rad = 9000.0");
        drive.gear_stiffness_nm_per_rad = gear.stiffness_nm_per_rad;
    }
    let weight = weight(&config);
    let mut arm = arm(config);
    for _ in 0..50 {
        let measured = read(&mut arm).joint_torque.expect("measured");
        for joint in 0..4 {
            assert!((measured[joint] - weight[joint]).abs() < 1e-6, "{measured:?} for {weight}");
        }
    }
}

/// Compared: joint torques measured at rest, and the weight with scale and offset; the spread of noisy ones, and the noise;
/// and late ones, and those of an ideal sensor that many cycles earlier.
#[test]
fn joint_torque_sensor_has_scale_offset_noise_and_lateness() {
    let sensed = |parameters: &str, kind: CommandKind| {
        let mut config = setup(kind, "a-med");
        config.capabilities = config.capabilities.measuring(&[Measured::JointTorque]);
        config.simulated.joint_torque_measurement = parsed(parameters);
        config
    };
    let weight = weight(&setup(CommandKind::Position, "a-med"));
    let elbow = |parameters: &str, count: usize| -> Vec<f64> {
        let mut arm = arm(sensed(parameters, CommandKind::Position));
        (0..count).map(|_| read(&mut arm).joint_torque.expect("measured")[3]).collect()
    };
    let exact = elbow("", 20)[19];
    let measured = elbow("scale = 0.9\noffset_nm = { elbow = 0.5 }", 20)[19];
    assert!((measured - (0.9 * exact + 0.5)).abs() < 1e-12, "{measured} for {exact}");
    assert!((exact - weight[3]).abs() < 1e-6, "{exact} for {weight}");
    let noisy = elbow("noise_nm = 0.2", 2000);
    let variance = noisy.iter().map(|torque| (torque - exact).powi(2)).sum::<f64>() / 2000.0;
    assert!((variance.sqrt() / 0.2 - 1.0).abs() < 0.1, "{}", variance.sqrt());
    let pushed = |parameters: &str| -> Vec<f64> {
        let samples = ramp(sensed(parameters, CommandKind::Torque));
        samples.into_iter().map(|sample| sample.joint_torque.expect("measured")[3]).collect()
    };
    let (at_once, late) = (pushed(""), pushed("delay_servo_ticks = 10"));
    for cycle in 4..12 {
        assert!((late[cycle] - at_once[cycle - 2]).abs() < 1e-12, "{cycle}: {late:?} after {at_once:?}");
    }
}

/// Weight of the modelled arm at the start, Nm.
fn weight(config: &ArmConfig) -> DVector<f64> {
    let mut data = Data::new(&config.model);
    kinematics(&config.model, &mut data, &START, &[0.0; 4]);
    gravity(&config.model, &mut data);
    data.gravity
}

/// Compared: the motor torques that hold an arm with an unknown load, and the weight of the model plus Jᵀ m g at the
/// load's centre.
#[test]
fn payload_loads_only_the_true_arm() {
    let mut config = setup(CommandKind::Position, "a-med");
    let centre = [0.02, -0.05, 0.1];
    let payload = parsed("frame = \"hand\"\nmass_kg = 1.5\ncentre_m = [0.02, -0.05, 0.1]");
    config.simulated.payload.insert("box".to_owned(), payload);
    let mut model = config.model.clone();
    let hand = model.frame_id("hand").expect("a hand");
    let point = model.add_frame_on("point", hand, Placement::from_rpy([0.0; 3], centre));
    let mut data = Data::new(&model);
    kinematics(&model, &mut data, &START, &[0.0; 4]);
    let mut jacobian = Matrix6xX::zeros(4);
    frame_jacobian(&model, &data, point, &mut jacobian);
    let load = -jacobian.fixed_rows::<3>(0).transpose() * (1.5 * model.gravity());
    let expected = weight(&config) + &load;
    assert!(load.amax() > 2.0, "{load}");
    let mut arm = arm(config);
    for _ in 0..20 {
        let measured = DVector::from_vec(read(&mut arm).motor_torque.expect("measured"));
        assert!((&measured - &expected).amax() < 1e-6, "{measured} for {expected}");
    }
}

/// Checks the errors of wrong names and of a lateness beyond measure.
#[test]
fn wrong_names_are_refused_with_their_keys() {
    let refused = |change: &dyn Fn(&mut ArmConfig)| {
        let mut config = setup(CommandKind::Position, "a-med");
        change(&mut config);
        match SimulatedArm::new(config) {
            Ok(_) => panic!("it is refused"),
            Err(error) => error,
        }
    };
    let key = |path: &[&str]| Key::Robot(path.iter().map(|&part| part.to_owned()).collect());
    let error = refused(&|config| {
        let payload = parsed("frame = \"hnad\"\nmass_kg = 1.5");
        config.simulated.payload.insert("box".to_owned(), payload);
    });
    assert_eq!(error.key(), key(&["simulated", "payload", "box", "frame"]), "{error}");
    let error = refused(&|config| {
        config.simulated.current_measurement = parsed("joint_scale = { elbw = 1.0 }");
    });
    assert_eq!(error.key(), key(&["simulated", "current_measurement", "joint_scale", "elbw"]), "{error}");
    let error = refused(&|config| {
        config.simulated.current_measurement = parsed("delay_servo_ticks = 20000");
    });
    assert!(matches!(error, SimulationError::TorqueDelay { most: 10_000, .. }), "{error}");
    let sensors = ["simulated", "joint_torque_measurement"];
    let error = refused(&|config| {
        config.simulated.joint_torque_measurement = parsed("delay_servo_ticks = 20000");
    });
    assert_eq!(error.key(), key(&[&sensors[..], &["delay_servo_ticks"]].concat()), "{error}");
    for (joint, offset) in [("elbw", "1.0"), ("elbow", "inf")] {
        let error = refused(&|config| {
            config.simulated.joint_torque_measurement =
                parsed(&format!("offset_nm = {{ {joint} = {offset} }}"));
        });
        assert_eq!(error.key(), key(&[&sensors[..], &["offset_nm", joint]].concat()), "{error}");
    }
}

//! Tests of the simulated arm at its interface: timing, encoders, sensors, brakes, end stops and weight.

use crate::common::{START, arm, object, parsed, read, servo_rows, setup, try_read};
use nalgebra::{DVector, Matrix6xX, Vector3};
use opspace_backend::quantity::Positive;
use opspace_backend::{
    Backend, Command, CommandKind, GravityCompensation, GroundTruth, Measured, Sample, TruthRow,
};
use opspace_model::{
    Data, Inertia, Model, Placement, crba, frame_jacobian, frame_placement, kinematics, potential_energy,
};
use opspace_sim::{ArmConfig, Key, SimulatedArm, SimulationError, fault};
use std::f64::consts::TAU;

/// Returns the gradient of potential energy by finite differences: joint torques that hold the weight, computed without
/// a dynamics algorithm.
fn weight(model: &Model, q: &[f64]) -> DVector<f64> {
    const STEP: f64 = 1e-5;
    let mut data = Data::new(model);
    let mut height = |q: &[f64]| {
        kinematics(model, &mut data, q, &vec![0.0; q.len()]);
        potential_energy(model, &data)
    };
    DVector::from_fn(q.len(), |i, _| {
        let mut moved = q.to_vec();
        moved[i] += STEP;
        let above = height(&moved);
        moved[i] -= 2.0 * STEP;
        (above - height(&moved)) / (2.0 * STEP)
    })
}

/// Rounding of the gradient above.
const WEIGHT_NM: f64 = 1e-7;

/// Compared: the servo tick at which a setpoint changes the servos' torque, and the configured delay, for every
/// delay up to three interface cycles.
#[test]
fn command_acts_exactly_after_its_delay() {
    for command in [CommandKind::Position, CommandKind::Torque] {
        for delay in 0..=15_u32 {
            let mut setup = setup(command, "a-med");
            setup.profile.delay_servo_ticks = Some(delay);
            let mut arm = arm(setup);
            let hold = read(&mut arm);
            let give = |arm: &mut SimulatedArm, size: f64| match command {
                CommandKind::Position => {
                    let q: Vec<f64> = hold.q.iter().map(|q| q + size * 1e-3).collect();
                    arm.write(Command::Position(&q))
                }
                _ => arm.write(Command::Torque(&[size; 4])),
            };
            let mut rows = Vec::new();
            for k in 1..=6_u32 {
                give(&mut arm, f64::from(k)).expect("it takes them");
                read(&mut arm);
                rows.extend(servo_rows(&arm));
            }
            for (tick, (number, torque)) in rows.iter().enumerate() {
                let expected = (tick + 5).saturating_sub(delay as usize) / 5;
                assert_eq!(*number, expected as u64, "delay {delay}, servo tick {tick}");
                if command == CommandKind::Torque {
                    assert_eq!(torque[0], expected as f64, "delay {delay}, servo tick {tick}");
                } else if tick > 0 {
                    // A step of 1 mrad times kv kp of joint 0 is 4.8 Nm; between steps the arm hardly moves.
                    let steps = *number > rows[tick - 1].0;
                    assert_eq!(
                        torque[0] - rows[tick - 1].1[0] > 3.0,
                        steps,
                        "delay {delay}, servo tick {tick}"
                    );
                }
            }
        }
    }
}

/// Compared: motor torques and commanded torques, above and below the drives' limits.
#[test]
fn drives_respect_torque_limits() {
    let asked = [100.0, -100.0, 10.0, -100.0];
    for (saturation, expected) in [(true, [40.0, -40.0, 10.0, -22.0]), (false, asked)] {
        let mut setup = setup(CommandKind::Torque, "a-med");
        setup.simulated.torque_saturation = saturation;
        let mut arm = arm(setup);
        read(&mut arm);
        arm.write(Command::Torque(&asked)).expect("it takes them");
        let sample = read(&mut arm);
        assert_eq!(sample.motor_torque.expect("measured").as_slice(), expected);
    }
}

/// Compared: measured and true positions. They differ by at most half a count, and measured positions are whole numbers
/// of counts.
#[test]
fn encoders_quantise_positions() {
    let mut setup = setup(CommandKind::Torque, "a-med");
    setup.simulated.encoder_quantisation = true;
    let counts: Vec<f64> = setup
        .joints
        .iter()
        .map(|j| f64::from(j.rotor.encoder_counts_per_turn.get()) * j.rotor.gear_ratio.get())
        .collect();
    let mut arm = arm(setup);
    read(&mut arm);
    let mut seen = Vec::new();
    for _ in 0..100 {
        arm.write(Command::Torque(&[5.0, -3.0, 2.0, 4.0])).expect("it takes them");
        let sample = read(&mut arm);
        for (i, per_turn) in counts.iter().enumerate() {
            let turns = sample.q[i] / TAU * per_turn;
            assert!((turns - turns.round()).abs() < 1e-6, "joint {i}: {turns} counts");
            let error = (sample.q[i] - arm.true_q()[i]).abs() / TAU * per_turn;
            assert!(error <= 0.5 + 1e-6, "joint {i}: {error} counts off");
            seen.push(error);
        }
    }
    assert!(seen.iter().any(|e| *e > 0.3), "truth lies between counts");
}

/// Compared: positions after two seconds without a command, and at the start. A position robot is held by its servos, a
/// torque robot by its brakes.
#[test]
fn uncommanded_arm_holds_its_position() {
    for command in [CommandKind::Position, CommandKind::Torque] {
        let setup = setup(command, "b-soft");
        let weight = weight(&setup.model, &START);
        let mut arm = arm(setup);
        let mut last = read(&mut arm);
        for _ in 0..400 {
            last = read(&mut arm);
        }
        // The deflection of a brake is the weight over its stiffness of 20000 Nm/rad: 0.3 mrad.
        let moved = (DVector::from_vec(last.q) - DVector::from_column_slice(&START)).amax();
        assert!(moved < 5e-4, "{command:?}: {moved} rad");
        assert!(arm.true_dq().amax() < 1e-6, "{command:?} stands still");
        let torque = DVector::from_vec(last.motor_torque.expect("measured"));
        match command {
            CommandKind::Position => {
                assert!((torque - weight).amax() < WEIGHT_NM, "the servo carries the weight")
            }
            _ => assert_eq!(torque.amax(), 0.0, "the brakes carry the weight"),
        }
    }
}

/// Compared: the speed of a moving arm before and after its brakes engage.
#[test]
fn brakes_stop_and_hold_a_moving_arm() {
    let mut arm = arm(setup(CommandKind::Torque, "a-med"));
    read(&mut arm);
    for _ in 0..150 {
        arm.write(Command::Torque(&[-15.0, 0.0, 0.0, 0.0])).expect("it takes them");
        read(&mut arm);
    }
    let fast = arm.true_dq().amax();
    assert!(fast > 1.0, "{fast} rad/s");
    arm.stop();
    (0..300).for_each(|_| drop(read(&mut arm)));
    assert!(arm.true_dq().amax() < 1e-3, "{}", arm.true_dq());
    let stood = arm.true_q();
    (0..300).for_each(|_| drop(read(&mut arm)));
    assert!((arm.true_q() - stood).amax() < 1e-4);
}

/// Compared: motion without torque of a robot that compensates its own weight, on rigid and on elastic gears, and of one that
/// doesn't. Its encoders have steps, and it compensates at the positions that they read.
#[test]
fn gravity_compensating_robot_needs_no_torque() {
    /// Drift in 0.3 s by the steps of the encoders, rad.
    const DRIFT_RAD: f64 = 1e-3;
    let fallen = |gravity_compensated_by, gear: Option<&str>| {
        let mut setup = setup(CommandKind::Torque, "a-med");
        setup.capabilities.gravity_compensated_by = gravity_compensated_by;
        setup.simulated.true_over_nominal.friction = Default::default();
        setup.simulated.gear = gear.map(parsed).unwrap_or_default();
        let mut arm = arm(setup);
        hang(&mut arm, 300);
        (arm.true_q() - DVector::from_column_slice(&START)).amax()
    };
    let gear = "[shoulder_yaw]\nstiffness_nm_per_rad = 3000.0\ndamping_nms_per_rad = 2.0";
    for gear in [None, Some(gear)] {
        let moved = fallen(GravityCompensation::Robot, gear);
        assert!(moved < DRIFT_RAD, "{moved} rad");
        assert!(fallen(GravityCompensation::Controller, gear) > 0.1);
    }
}

/// Compared: the velocity that a robot which compensates its own weight gains in 10 ms with a load that its model does not have, and
/// the weight of the load over the inertia with it.
#[test]
fn compensating_robot_bears_the_weight_of_an_unknown_load() {
    /// Change of weight and inertia while the arm falls, relative to the velocity.
    const CURVATURE: f64 = 0.02;
    /// Velocity that counts as falling, rad/s.
    const FALLING: f64 = 0.05;
    let mass_kg = 1.5;
    let mut setup = setup(CommandKind::Torque, "a-med");
    setup.capabilities.gravity_compensated_by = GravityCompensation::Robot;
    setup.simulated.true_over_nominal.friction = Default::default();
    setup.simulated.payload =
        parsed(&format!("[unknown]\nframe = 'hand'\nmass_kg = {mass_kg:?}\ncentre_m = [0.0, 0.0, 0.0]"));
    let hand = setup.model.frame_id("hand").expect("the hand");
    let mut model = setup.model.clone();
    let own = model.add_frame_on("load", hand, Placement::identity());
    model.set_payload(own, Inertia { mass: mass_kg, ..Inertia::zero() });
    let mut data = Data::new(&model);
    kinematics(&model, &mut data, &START, &[0.0; 4]);
    crba(&model, &mut data);
    let mut jacobian = Matrix6xX::zeros(4);
    frame_jacobian(&model, &data, hand, &mut jacobian);
    let torque = jacobian.rows(0, 3).tr_mul(&(mass_kg * model.gravity()));
    let expected = data.mass_matrix.clone().lu().solve(&torque).expect("regular") * 0.01;
    let mut arm = arm(setup);
    // The brakes are released.
    hang(&mut arm, 3);
    let before = arm.true_dq();
    hang(&mut arm, 10);
    let gained = arm.true_dq() - before;
    assert!(expected.amax() > FALLING, "{expected}");
    assert!((&gained - &expected).amax() < CURVATURE * expected.amax(), "{gained} for {expected}");
}

/// Lets an arm hang without torque for some cycles.
fn hang(arm: &mut SimulatedArm, cycles: usize) {
    for _ in 0..cycles {
        read(arm);
        arm.write(Command::Torque(&[0.0; 4])).expect("it takes them");
    }
}

/// Compared: the depth of a joint in its end stop at full torque, and the torque over the stop's stiffness.
#[test]
fn end_stops_limit_joint_motion() {
    let mut setup = setup(CommandKind::Torque, "a-med");
    setup.start = vec![0.0, 0.0, 0.0, -0.05];
    setup.capabilities.gravity_compensated_by = GravityCompensation::Robot;
    let mut arm = arm(setup);
    read(&mut arm);
    for _ in 0..1500 {
        arm.write(Command::Torque(&[0.0, 0.0, 0.0, 22.0])).expect("it takes them");
        read(&mut arm);
    }
    let (q, dq) = (arm.true_q()[3], arm.true_dq()[3]);
    // Static friction shifts the equilibrium by up to 1.43 Nm in either direction.
    assert!((q * 2000.0 - 22.0).abs() < 1.43, "{q} rad beyond the stop");
    assert!(dq.abs() < 0.01, "{dq} rad/s");
}

/// Returns a position robot with an environment object at its hand, and a sensor without noise or bias.
fn arm_with_contact(by: &str) -> ArmConfig {
    let mut setup = setup(CommandKind::Position, "a-med");
    let quality = setup.simulated.force_sensor.get_mut("wrist").expect("the wrist");
    *quality = parsed("bandwidth_hz = 500.0\nnoise_n = 0.0\nnoise_nm = 0.0\nbias_n = 0.0\nbias_nm = 0.0");
    setup.environment = vec![("push".to_owned(), object(by))];
    setup
}

/// Compared: the sensor's reading rotated into world axes, and the configured push.
#[test]
fn force_sensor_reads_contact_in_sensor_axes() {
    let force = Vector3::new(4.0, -3.0, 2.0);
    let setup = arm_with_contact(
        "[pushes]\nframe = 'hand'\npush = [{ at_s = 0.0, duration_s = 0.4, force_n = [4.0, -3.0, 2.0] }]",
    );
    let (model, hand) = (setup.model.clone(), setup.model.frame_id("hand").expect("the hand"));
    let mut arm = arm(setup);
    let mut sample = read(&mut arm);
    for _ in 0..200 {
        sample = read(&mut arm);
    }
    let mut data = Data::new(&model);
    kinematics(&model, &mut data, arm.true_q().as_slice(), &[0.0; 4]);
    let axes = frame_placement(&model, &data, hand).rotation;
    let [linear, angular] = [0, 3].map(|i| Vector3::from_column_slice(&sample.wrenches[0][i..i + 3]));
    assert!((linear - force).norm() > 1.0, "the hand's axes are not the world's");
    // The half sine is flat at its peak, so the lag of 0.3 ms of the sensor's filter has no effect.
    assert!((axes * linear - force).norm() < 1e-3, "{}", axes * linear);
    assert!(angular.norm() < 1e-9, "a force at the sensor has no moment");
}

/// Compared: reading, true force and position of a mass that is put on after 0.1 s, and its weight; and the rows of the
/// channel `truth`.
#[test]
fn mass_weighs_on_arm_and_sensor() {
    let setup = arm_with_contact("[mass]\nframe = 'hand'\nmass_kg = 0.4\nput_on_s = 0.1");
    let (model, hand) = (setup.model.clone(), setup.model.frame_id("hand").expect("the hand"));
    let mut arm = arm(setup);
    let names: Vec<String> = arm.layouts().truth.signals.iter().map(|signal| signal.name.clone()).collect();
    assert_eq!(names, ["q", "dq", "push.force", "push.work", "push.position"]);
    let mut forces = Vec::new();
    let mut sample = read(&mut arm);
    for _ in 0..2000 {
        arm.visit(&mut |row| {
            if let TruthRow::State { time_s, row } = row {
                forces.push((time_s, [&row[8..11], &row[12..15]].concat()));
            }
        });
        sample = read(&mut arm);
    }
    let mut data = Data::new(&model);
    kinematics(&model, &mut data, arm.true_q().as_slice(), &[0.0; 4]);
    let at = frame_placement(&model, &data, hand);
    let felt = at.rotation * Vector3::from_column_slice(&sample.wrenches[0][..3]);
    assert!((felt - Vector3::new(0.0, 0.0, -0.4 * 9.81)).norm() < 0.01, "{felt}");
    let (_, last) = forces.last().expect("rows");
    assert!((last[2] + 0.4 * 9.81).abs() < 0.01, "{last:?}");
    // By hand: the spring of 100 Hz stretches by g/ω² = 0.025 mm.
    assert!((last[5] - at.translation.z + 9.81 / (TAU * 100.0).powi(2)).abs() < 1e-5, "{last:?}");
    let before = forces.iter().filter(|(time_s, _)| *time_s < 0.1);
    assert!(before.clone().count() > 10);
    before.for_each(|(_, row)| assert!(row[..3] == [0.0; 3] && row[3].is_nan(), "{row:?}"));
}

/// Compared: readings of a sensor with a load beyond it, and those of a sensor without one: at rest they differ by weight and
/// moment of the load; while the arm is pushed, by mass times gravity minus acceleration.
#[test]
fn force_sensor_reads_the_load_beyond_it() {
    const ROUNDING_N: f64 = 1e-9;
    let centre = Vector3::new(0.02, -0.01, 0.06);
    let setup = |load: &str| {
        let mut setup = arm_with_contact(
            "[pushes]\nframe = 'hand'\npush = [{ at_s = 0.2, duration_s = 0.2, force_n = [120.0, 30.0, 60.0] }]",
        );
        let quality = setup.simulated.force_sensor.get_mut("wrist").expect("the wrist");
        let text = "bandwidth_hz = 5000.0\nnoise_n = 0.0\nnoise_nm = 0.0\nbias_n = 0.0\nbias_nm = 0.0";
        *quality = parsed(&format!("{text}\n{load}"));
        setup
    };
    let plain = setup("");
    let (model, hand) = (plain.model.clone(), plain.model.frame_id("hand").expect("the hand"));
    let mut without = arm(plain);
    let mut with = arm(setup("load = { mass_kg = 0.5, centre_m = [0.02, -0.01, 0.06] }"));
    let mut data = Data::new(&model);
    // Velocity of the load in the world, by differences of its position, at each sample.
    let mut places = Vec::new();
    let mut loads = Vec::new();
    for _ in 0..500 {
        let [a, b] = [read(&mut with), read(&mut without)].map(|sample| sample.wrenches[0]);
        assert_eq!(with.true_q(), without.true_q(), "the load is part of the arm already");
        kinematics(&model, &mut data, with.true_q().as_slice(), &[0.0; 4]);
        let at = frame_placement(&model, &data, hand);
        let part = |i: usize| Vector3::from_fn(|k, _| a[i + k] - b[i + k]);
        let (force, moment) = (part(0), part(3));
        assert!((moment - centre.cross(&force)).norm() < 1e-9, "{moment}");
        places.push(at.translation + at.rotation * centre);
        loads.push(at.rotation * force);
    }
    let weight = Vector3::new(0.0, 0.0, -0.5 * 9.81);
    assert!((loads[190] - weight).norm() < 1e-3, "{}", loads[190]);
    // A tare is the mean of the first readings.
    assert!((loads[0] - weight).norm() < ROUNDING_N, "{}", loads[0]);
    let (mut largest, mut error) = (0.0_f64, 0.0_f64);
    for k in 5..places.len() - 5 {
        // Mean acceleration over ten milliseconds, and the mean of the readings there.
        let [before, now, after] = [k - 5, k, k + 5].map(|k| places[k]);
        let acceleration = (after - now * 2.0 + before) / (0.005 * 0.005);
        let share = |j: i32| (5 - j.abs()) as f64 / 25.0;
        let mean: Vector3<f64> = (-4..=4).map(|j| loads[(k as i32 + j) as usize] * share(j)).sum();
        let inertia = mean - weight;
        error = error.max((inertia + acceleration * 0.5).norm());
        largest = largest.max(inertia.norm());
    }
    // Each reading is the mean over a fifth of a millisecond, the acceleration that of all of it.
    assert!(largest > 0.5 && error < 0.1 * largest, "{largest} N, with an error of {error} N");
}

/// Compared: the noise of torque and force measurements with and without another random source.
#[test]
fn environment_does_not_change_measurement_noise() {
    let noise = |environment: Vec<(String, opspace_sim::EnvironmentObjectParameters)>| {
        let mut setup = setup(CommandKind::Position, "a-med");
        setup.simulated.torque_noise_nm = opspace_backend::quantity::NonNegative::literal(0.03);
        setup.environment = environment;
        let mut arm = arm(setup);
        // At the first tick the hand has not moved yet: the readings contain only noise and bias.
        let Sample { motor_torque, wrenches, .. } = read(&mut arm);
        (motor_torque.expect("measured"), wrenches[0])
    };
    let hand = object(
        "[spring]\nframe = 'hand'\nstiffness_n_per_m = 200.0\ndamping_ns_per_m = 15.0\nmotion.random = { rms_m = 0.04, from_hz = 0.1, to_hz = 0.7 }",
    );
    let alone = noise(Vec::new());
    let held = noise(vec![("operator".to_owned(), hand)]);
    assert!(alone == held, "{alone:?} {held:?}");
    assert!(alone.1[..3].iter().any(|f| *f != 0.0), "there is something random");
}

/// Checks that the next read after a NaN command returns a fault.
#[test]
fn diverged_state_faults() {
    let mut arm = arm(setup(CommandKind::Torque, "a-med"));
    read(&mut arm);
    arm.write(Command::Torque(&[f64::NAN; 4])).expect("it takes them");
    assert_eq!(try_read(&mut arm), Err(fault::diverged()));
}

/// Checks the faults for commands of the wrong kind or length; none of them is counted.
#[test]
fn wrong_commands_fault() {
    let mut position = arm(setup(CommandKind::Position, "a-med"));
    let mut torque = arm(setup(CommandKind::Torque, "a-med"));
    read(&mut position);
    for (command, takes) in
        [(Command::Torque(&START), CommandKind::Position), (Command::Velocity(&START), CommandKind::Position)]
    {
        assert_eq!(position.write(command), Err(fault::wrong_command(takes)));
    }
    assert_eq!(position.write(Command::Position(&START[1..])), Err(fault::wrong_length()));
    assert_eq!(torque.write(Command::Position(&START)), Err(fault::wrong_command(CommandKind::Torque)));
    position.write(Command::Position(&START)).expect("it takes them");
    read(&mut position);
    assert!(servo_rows(&position).iter().all(|(number, _)| *number == 1));
}

/// Returns the number of the command in effect in each servo period of the last read.
fn numbers(arm: &mut SimulatedArm) -> Vec<Option<u64>> {
    read(arm);
    let mut numbers = Vec::new();
    arm.ground_truth().expect("a simulation").visit(&mut |row| {
        if let TruthRow::Servo { command, .. } = row {
            numbers.push(command);
        }
    });
    numbers
}

/// Compared: an arm with a resolution of setpoints that receives exact ones, and one that receives their multiples of it.
#[test]
fn setpoints_are_rounded_to_their_resolution() {
    const STEP_RAD: f64 = 0.0015;
    let exact = setup(CommandKind::Position, "a-med");
    let mut rounding = exact.clone();
    rounding.joints[1].setpoint_resolution_rad = Some(Positive::literal(STEP_RAD));
    let (mut rounding, mut exact) = (arm(rounding), arm(exact));
    for k in 1..=5 {
        let setpoints = START.map(|q| q + 0.0007 * f64::from(k));
        let mut multiples = setpoints;
        multiples[1] = (setpoints[1] / STEP_RAD).round() * STEP_RAD;
        assert_ne!(multiples, setpoints);
        for (arm, setpoints) in [(&mut rounding, setpoints), (&mut exact, multiples)] {
            read(arm);
            arm.write(Command::Position(&setpoints)).expect("it takes them");
        }
        read(&mut rounding);
        read(&mut exact);
        assert_eq!(servo_rows(&rounding), servo_rows(&exact));
    }
}

/// Compared: a position robot that is held, and one that receives its last setpoints again. A hold before the first
/// command is counted and has no effect.
#[test]
fn hold_repeats_last_position_setpoints() {
    let mut setup = setup(CommandKind::Position, "a-med");
    setup.profile.delay_servo_ticks = Some(2);
    let (mut held, mut told) = (arm(setup.clone()), arm(setup));
    let moved = START.map(|q| q + 0.01);
    for robot in [&mut held, &mut told] {
        read(robot);
        robot.write(Command::Hold).expect("held");
        assert_eq!(numbers(robot), [None; 5]);
        robot.write(Command::Position(&moved)).expect("it takes them");
        assert_eq!(numbers(robot), [None, None, Some(2), Some(2), Some(2)]);
    }
    held.write(Command::Hold).expect("held");
    told.write(Command::Position(&moved)).expect("it takes them");
    assert_eq!(numbers(&mut held), [2, 2, 3, 3, 3].map(Some));
    read(&mut told);
    assert_eq!(servo_rows(&held), servo_rows(&told));
    // A pending setpoint still acts after a stop, and a second stop has no effect.
    for robot in [&mut held, &mut told] {
        robot.write(Command::Position(&START)).expect("it takes them");
        robot.stop();
    }
    told.stop();
    assert_eq!(numbers(&mut held), [3, 3, 4, 4, 4].map(Some));
    read(&mut told);
    assert_eq!(servo_rows(&held), servo_rows(&told));
}

/// Checks the command in effect and the motor torques of a torque robot that is held, commanded again and stopped:
/// pending torques are dropped, a hold has a number, a stop has none.
#[test]
fn hold_and_stop_brake_torque_robot_immediately() {
    let mut setup = setup(CommandKind::Torque, "a-med");
    setup.profile.delay_servo_ticks = Some(2);
    let mut arm = arm(setup);
    arm.stop();
    read(&mut arm);
    arm.write(Command::Torque(&[5.0; 4])).expect("it takes them");
    assert_eq!(numbers(&mut arm), [None, None, Some(1), Some(1), Some(1)]);
    arm.write(Command::Torque(&[6.0; 4])).expect("it takes them");
    arm.write(Command::Hold).expect("held");
    assert_eq!(numbers(&mut arm), [Some(3); 5]);
    assert!(servo_rows(&arm).iter().all(|(_, torque)| torque.amax() == 0.0));
    arm.write(Command::Torque(&[7.0; 4])).expect("it takes them");
    assert_eq!(numbers(&mut arm), [3, 3, 4, 4, 4].map(Some));
    assert_eq!(servo_rows(&arm)[4].1[0], 7.0);
    arm.write(Command::Torque(&[8.0; 4])).expect("it takes them");
    arm.stop();
    arm.stop();
    assert_eq!(numbers(&mut arm), [None; 5]);
    assert!(servo_rows(&arm).iter().all(|(_, torque)| torque.amax() == 0.0));
}

/// Compared: measured velocities and the finite difference of true positions; measured joint torques at rest and the
/// weight, which brakes hold; the status and whether a drive's limit was exceeded. A robot without these measurements
/// is checked too.
#[test]
fn optional_measurements_are_provided() {
    /// Half of the acceleration (120 rad/s²) times the period.
    const DIFFERENCE_RAD_PER_S: f64 = 0.1;
    let mut setup = setup(CommandKind::Torque, "a-med");
    setup.simulated.torque_noise_nm = opspace_backend::quantity::NonNegative::literal(0.03);
    let plain = setup.clone();
    let weight = weight(&setup.model, &START);
    setup.capabilities =
        setup.capabilities.measuring(&[Measured::Velocity, Measured::JointTorque]).with_status();
    let (mut rich, mut plain) = (arm(setup), arm(plain));
    let torque = |sample: &Sample| DVector::from_vec(sample.joint_torque.clone().expect("measured"));
    assert!((torque(&read(&mut rich)) - &weight).amax() < WEIGHT_NM);
    read(&mut plain);
    let mut before = read(&mut rich);
    read(&mut plain);
    // Only the torque of the third cycle exceeds the limit.
    for cycle in 0..5 {
        let asked = [if cycle == 2 { 41.0 } else { 20.0 }, 0.0, 0.0, 0.0];
        for robot in [&mut rich, &mut plain] {
            robot.write(Command::Torque(&asked)).expect("it takes them");
        }
        let (sample, bare) = (read(&mut rich), read(&mut plain));
        let status = sample.status.expect("reported");
        assert_eq!((status.word, status.command_limited), (0, cycle == 2));
        let dq = sample.dq.as_ref().expect("measured");
        for (joint, velocity) in dq.iter().enumerate() {
            let difference = (sample.q[joint] - before.q[joint]) / 1e-3;
            assert!((velocity - difference).abs() < DIFFERENCE_RAD_PER_S, "{velocity} {difference}");
        }
        assert_eq!(
            (bare.dq.is_some(), bare.joint_torque.is_some(), bare.status.is_some()),
            (false, false, false)
        );
        assert_eq!(
            (&bare.q, &bare.motor_torque, &bare.wrenches),
            (&sample.q, &sample.motor_torque, &sample.wrenches)
        );
        before = sample;
    }
    assert!(before.dq.expect("measured")[0] > 0.1, "it moves");
}

/// Checks the error for each set of contradictory parameters.
#[test]
fn contradictory_parameters_are_refused_by_name() {
    let refused = |change: &dyn Fn(&mut ArmConfig)| {
        let mut setup = setup(CommandKind::Position, "a-med");
        change(&mut setup);
        SimulatedArm::new(setup).err().expect("refused")
    };
    let too_long = |truth| SimulationError::Delay { delay: 161, most: 160, truth };
    assert_eq!(refused(&|s| s.profile.delay_servo_ticks = Some(161)), too_long(false));
    assert_eq!(refused(&|s| s.simulated.delay_servo_ticks = Some(161)), too_long(true));
    let rates = refused(&|s| s.simulated.physics_hz = parsed::<Wrapped>("value = 12000.0").value);
    assert_eq!(rates, SimulationError::PhysicsRate { physics_hz: 12_000.0, servo_hz: 5000.0 });
    let sensor = refused(&|s| s.simulated.force_sensor.clear());
    assert_eq!(sensor, SimulationError::UnknownSensorQuality { sensor: "wrist".to_owned() });
    let wall = "[wall]\nframe = 'hand'\npoint_m = [0.0, 0.0, 0.0]\nnormal = [0.0, 0.0, 0.0]\nstiffness_n_per_m = 1.0\ndamping_ns_per_m = 0.0";
    let flat = refused(&|s| s.environment = vec![("table".to_owned(), object(wall))]);
    assert_eq!(flat, SimulationError::Normal { object: "table".to_owned() });
    let sloped = wall.replace("normal = [0.0, 0.0, 0.0]", "normal = [0.0, 0.0, 1.0]");
    for (edge, words) in [("[0.0, 0.0, 0.0]", "no length"), ("[0.0, 0.0, -2.0]", "direction along the wall")]
    {
        let text = format!("{sloped}\nedge = {{ toward = {edge}, at_m = 0.1 }}");
        let error = refused(&|s| s.environment = vec![("table".to_owned(), object(&text))]);
        assert!(error.to_string().contains(words), "{error}");
        let key = ["environment", "table", "edge", "toward"].map(str::to_owned).to_vec();
        assert_eq!(error.key(), Key::Task(key));
    }
    let surface = "point_m = [0.0, 0.0, 0.0]\nstiffness_n_per_m = 1.0\ndamping_ns_per_m = 0.0";
    let hole = format!("[hole]\nnormal = [0.0, 0.0, 1.0]\nradius_m = 0.01\ndepth_m = 0.02\n{surface}");
    let drawer = "[drawer]\ntravel_m = 0.2\nmass_kg = 1.0\ndirection";
    let hold = "[spring]\nstiffness_n_per_m = 1.0\ndamping_ns_per_m = 0.0\nmotion";
    let probe = |axis: &str, lines: &str| {
        format!("{hold}.scripted.probe = {{ rms_m = 0.01, axis = {axis}, lines_hz = {lines}, from_s = 0.0 }}")
    };
    for (text, key, words) in [
        (format!("[cylinder]\naxis = [0.0, 0.0, 0.0]\nradius_m = 0.1\n{surface}"), "axis", "no length"),
        (format!("{hole}\nclearance_m = 0.01"), "clearance_m", "radius of the hole, 0.01 m"),
        (format!("{hole}\nclearance_m = 1e-4\nchamfer_m = 0.02"), "chamfer_m", "depth of the hole, 0.02 m"),
        ("[mass]\nmass_kg = 1.0\nfrequency_hz = 1001.0".to_owned(), "frequency_hz", "1000 Hz"),
        ("[mass]\nmass_kg = 1.0\nput_on_s = 2.0\ntaken_off_s = 2.0".to_owned(), "taken_off_s", "before"),
        (format!("{drawer} = [0.0, 0.0, 0.0]"), "direction", "no length"),
        (format!("{drawer} = [1.0, 0.0, 0.0]\nopening_m = 0.3"), "opening_m", "the travel, 0.2 m"),
        (format!("{drawer} = [1.0, 0.0, 0.0]\ngrip_stiffness_n_per_m = 1e8"), "mass_kg", "at least"),
        (
            format!("{hold} = {{ still = {{}} }}\nreleased = [{{ at_s = 2.0, until_s = 1.0 }}]"),
            "released",
            "after",
        ),
        (
            format!("{hold}.scripted.tremor = {{ rms_m = 1e-3, from_hz = 9.0, to_hz = 8.0 }}"),
            "motion.scripted.tremor",
            "below from_hz",
        ),
        (probe("[0.0, 0.0, 0.0]", "[1.0]"), "motion.scripted.probe.axis", "no length"),
        (probe("[0.0, 0.0, 1.0]", "[]"), "motion.scripted.probe.lines_hz", "1 to 24"),
        (probe("[0.0, 0.0, 1.0]", "[2.0, 1.5]"), "motion.scripted.probe.lines_hz", "1.5 Hz follows 2 Hz"),
        (probe("[0.0, 0.0, 1.0]", "[2.0, 2.0]"), "motion.scripted.probe.lines_hz", "each once"),
        (probe("[0.0, 0.0, 1.0]", "[2.0, 1001.0]"), "motion.scripted.probe.lines_hz", "1000 Hz"),
    ] {
        // The frame is the first key of the table.
        let text = text.replacen("]\n", "]\nframe = 'hand'\n", 1);
        let error = refused(&|s| s.environment = vec![("thing".to_owned(), object(&text))]);
        assert!(error.to_string().contains(words), "{error}");
        let path = ["environment", "thing"].into_iter().chain(key.split('.'));
        assert_eq!(error.key(), Key::Task(path.map(str::to_owned).collect()));
    }
    let lost = wall.replace("'hand'", "'hnad'");
    let lost = refused(&|s| s.environment = vec![("table".to_owned(), object(&lost))]);
    assert!(lost.to_string().contains("hnad"), "{lost}");
    let sensor = refused(&|s| s.capabilities.force_sensors[0].frame = "hnad".to_owned());
    assert!(matches!(sensor, SimulationError::SensorFrame { .. }), "{sensor}");
}

#[derive(serde::Deserialize)]
struct Wrapped {
    value: opspace_backend::quantity::Positive,
}

//! Joint states: order, publishers, clock and numbers.

use crate::common::{config, message, settings, text};
use opspace_backend::Measured;
use opspace_ros2::messages::JointState;
use opspace_ros2::states::{Failure, RobotState, StateReader};
use opspace_ros2::{RosConfig, RosFault};
use proptest::prelude::*;

/// Change of a message.
type Change = fn(&mut JointState);

const OWN: [u8; 16] = [1; 16];
const OTHER: [u8; 16] = [2; 16];

/// Reads messages of a publisher that arrive when their stamps say, or later by the third number (s).
fn read_all(
    reader: &mut StateReader,
    messages: &[(JointState, [u8; 16], f64)],
) -> Result<Vec<RobotState>, Failure> {
    let mut states = Vec::new();
    for (message, publisher, arrival_s) in messages {
        let mut state = RobotState::default();
        if reader.read(message, *publisher, *arrival_s, &mut state)? {
            states.push(state);
        }
    }
    Ok(states)
}

fn fault(reader: &mut StateReader, messages: &[(JointState, [u8; 16], f64)]) -> RosFault {
    read_all(reader, messages).expect_err("a fault").0
}

/// Compared: values by hand, in the order of the robot's joints.
#[test]
fn joints_are_found_by_name_whatever_the_order_and_the_other_joints() {
    let mut all = config();
    all.measures_velocity = true;
    all.effort = Some(opspace_ros2::config::EffortMeaning::JointTorque);
    let mut reader = StateReader::new(&all);
    let states = read_all(&mut reader, &[(message(5.0, 0.1, 0.2), OWN, 0.0)]).unwrap();
    assert_eq!(states[0].q, [0.1, 0.2]);
    assert_eq!(states[0].dq, [1.0, 2.0]);
    assert_eq!(states[0].effort, [10.0, 20.0]);
    // Another order in the next message.
    let mut turned = message(5.01, 0.3, 0.4);
    turned.name = ["elbow", "gripper", "wrist"].map(str::to_owned).into();
    turned.position = vec![0.3, 9.0, 0.4];
    let states = read_all(&mut reader, &[(turned, OWN, 0.01)]).unwrap();
    assert_eq!(states[0].q, [0.3, 0.4]);
}

#[test]
fn messages_of_other_joints_are_no_states() {
    let mut reader = StateReader::new(&config());
    let mut gripper = message(5.0, 0.0, 0.0);
    gripper.name = ["a", "b", "c"].map(str::to_owned).into();
    let messages =
        [(gripper.clone(), OTHER, 0.0), (message(5.0, 0.1, 0.2), OWN, 0.0), (gripper, OTHER, 0.005)];
    assert_eq!(read_all(&mut reader, &messages).unwrap().len(), 1);
    assert_eq!((reader.counts().states, reader.counts().foreign), (1, 2));
}

#[test]
fn a_joint_that_is_missing_is_named() {
    let mut reader = StateReader::new(&config());
    let mut renamed = message(5.0, 0.1, 0.2);
    renamed.name[1] = "wrist_1".to_owned();
    let (fault, details) = read_all(&mut reader, &[(renamed, OWN, 0.0)]).expect_err("a fault");
    assert_eq!((fault, details.as_str()), (RosFault::JointsMissing, "wrist of gripper, wrist_1, elbow"));
}

#[test]
fn renamed_joints_are_told_from_a_publisher_with_other_joints_between() {
    let mut other = message(5.02, 0.1, 0.2);
    other.name = ["r_gripper", "r_wrist", "r_elbow"].map(str::to_owned).into();
    // Between two states it is nothing; after them it is a fault.
    let mut reader = StateReader::new(&config());
    let first = (message(5.0, 0.1, 0.2), OWN, 0.0);
    assert!(read_all(&mut reader, &[first, (other.clone(), OWN, 0.01)]).is_ok());
    assert_eq!(fault(&mut reader, &[(other, OWN, 0.09)]), RosFault::JointsMissing);
}

#[test]
fn a_second_publisher_is_told_from_a_restarted_one_by_the_silence_before() {
    let first = (message(5.0, 0.1, 0.2), OWN, 0.0);
    let mut reader = StateReader::new(&config());
    let side_by_side = [first.clone(), (message(5.01, 0.1, 0.2), OTHER, 0.01)];
    assert_eq!(fault(&mut reader, &side_by_side), RosFault::SecondStatePublisher);
    let mut reader = StateReader::new(&config());
    let restarted = [first, (message(5.08, 0.1, 0.2), OTHER, 0.08)];
    assert_eq!(fault(&mut reader, &restarted), RosFault::DriverRestarted);
}

#[test]
fn lengths_and_numbers_that_are_wrong_are_faults() {
    let broken: [(&str, Change); 3] = [
        ("3 names and 2 positions", |message| message.position.truncate(2)),
        ("joint 'elbow' has positions that are not finite", |message| message.position[2] = f64::NAN),
        ("3 names and 0 velocities", |message| message.velocity.clear()),
    ];
    for (words, break_it) in broken {
        let velocities =
            RosConfig::from_settings(&settings().measuring(&[Measured::Position, Measured::Velocity]))
                .unwrap();
        let mut reader = StateReader::new(&velocities);
        let mut wrong = message(5.0, 0.1, 0.2);
        break_it(&mut wrong);
        let (fault, details) = read_all(&mut reader, &[(wrong, OWN, 0.0)]).expect_err("a fault");
        assert_eq!((fault, details.as_str()), (RosFault::StateMalformed, words));
    }
    // Those of another joint do not matter.
    let mut reader = StateReader::new(&config());
    let mut other = message(5.0, 0.1, 0.2);
    other.position[0] = f64::NAN;
    assert!(read_all(&mut reader, &[(other, OWN, 0.0)]).is_ok());
}

#[test]
fn stamps_are_the_clock_and_a_repeated_or_late_state_is_none() {
    let mut reader = StateReader::new(&config());
    let messages = [
        (message(5.0, 0.1, 0.0), OWN, 0.0),
        (message(5.01, 0.2, 0.0), OWN, 0.013),
        (message(5.01, 0.2, 0.0), OWN, 0.014),
        (message(5.005, 0.2, 0.0), OWN, 0.015),
        (message(5.03, 0.3, 0.0), OWN, 0.030),
    ];
    let states = read_all(&mut reader, &messages).unwrap();
    let times: Vec<f64> = states.iter().map(|state| (1e6 * state.time_s).round() / 1e6).collect();
    assert_eq!(times, [0.0, 0.01, 0.03]);
    assert_eq!((reader.counts().repeated, reader.counts().late), (1, 1));
}

#[test]
fn jumps_of_the_clock_are_faults_in_both_directions() {
    for jump_s in [3600.0, 0.3, -0.3, -3600.0] {
        let mut reader = StateReader::new(&config());
        let messages =
            [(message(5000.0, 0.1, 0.0), OWN, 0.0), (message(5000.01 + jump_s, 0.1, 0.0), OWN, 0.01)];
        assert_eq!(fault(&mut reader, &messages), RosFault::ClockJumped, "{jump_s}");
    }
}

#[test]
fn states_without_stamps_need_the_clock_of_arrivals() {
    let mut reader = StateReader::new(&config());
    let messages = [(message(0.0, 0.1, 0.0), OWN, 0.0), (message(0.0, 0.1, 0.0), OWN, 0.01)];
    assert_eq!(fault(&mut reader, &messages), RosFault::StateMalformed);
    let arrival = RosConfig::from_settings(&settings().with("clock", text("arrival"))).unwrap();
    let mut reader = StateReader::new(&arrival);
    assert_eq!(read_all(&mut reader, &messages).unwrap().len(), 2);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, rng_seed: proptest::test_runner::RngSeed::Fixed(5), ..ProptestConfig::default() })]

    /// Compared: times of arrivals with jitter of up to 3 ms and a clock that differs by 0.5 %, and the times without jitter.
    #[test]
    fn the_clock_of_arrivals_has_little_of_their_jitter(jitters in prop::collection::vec(0.0..0.003, 400), rate in 0.995..1.005f64) {
        let arrival = RosConfig::from_settings(&settings().with("clock", text("arrival"))).unwrap();
        let mut reader = StateReader::new(&arrival);
        let mut last_s = -1.0;
        for (cycle, jitter_s) in jitters.iter().enumerate() {
            let true_s = 0.01 * rate * cycle as f64;
            let mut state = RobotState::default();
            prop_assert!(reader.read(&message(0.0, 0.1, 0.2), OWN, 7.0 + true_s + jitter_s, &mut state).unwrap());
            prop_assert!(state.time_s > last_s);
            if cycle > 0 {
                let step_s = state.time_s - last_s;
                prop_assert!((step_s - 0.01).abs() < 3e-4, "{step_s}");
            }
            last_s = state.time_s;
            // It follows the arrivals: at most their jitter, and the lag of a clock that differs.
            prop_assert!((state.time_s - true_s).abs() < 0.006, "{} {true_s}", state.time_s);
        }
    }

    /// Whatever arrives: no panic, and times increase.
    #[test]
    fn times_increase_whatever_arrives(
        messages in prop::collection::vec((-1e3..1e3f64, 0.0..0.5f64, 0..4usize, any::<bool>(), 0..4usize), 1..60),
    ) {
        let mut reader = StateReader::new(&config());
        let (mut arrival_s, mut last_s) = (0.0, f64::NEG_INFINITY);
        for (stamp_s, later_s, names, is_other, values) in messages {
            arrival_s += later_s;
            let mut strange = message(stamp_s.abs(), 0.1, 0.2);
            strange.name.truncate(names);
            strange.position.truncate(values);
            let mut state = RobotState::default();
            let publisher = if is_other { OTHER } else { OWN };
            if let Ok(true) = reader.read(&strange, publisher, arrival_s, &mut state) {
                prop_assert!(state.time_s > last_s && state.q.len() == 2);
                last_s = state.time_s;
            }
        }
    }
}

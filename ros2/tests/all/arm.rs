//! The robot as a backend, on rings without a node.

use crate::common::{config, settings};
use opspace_backend::{
    Backend, Command, CommandKind, GravityCompensation, Measured, Sample, Setting, Settings,
};
use opspace_ros2::link::{Link, NodeEnd};
use opspace_ros2::states::RobotState;
use opspace_ros2::{RosArm, RosConfig, RosFault};
use opspace_testing::allocation::allocations_so_far;
use std::time::{Duration, Instant};

fn arm(config: &RosConfig) -> (RosArm, NodeEnd, Sample) {
    let (link, end) = Link::rings(config);
    let arm = RosArm::new(link, config);
    let sample = Sample::new(arm.capabilities());
    (arm, end, sample)
}

fn state(time_s: f64, q: [f64; 2]) -> RobotState {
    RobotState { time_s, interval_s: 0.0125, q: q.into(), ..RobotState::default() }
}

const WRENCH: [[f64; 6]; 1] = [[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]];

#[test]
fn the_newest_state_is_read_and_those_before_are_skipped() {
    let (mut arm, mut end, mut sample) = arm(&config());
    end.push(&state(0.0, [0.1, 0.2]), &WRENCH);
    end.push(&state(0.01, [0.3, 0.4]), &WRENCH);
    arm.read(&mut sample).unwrap();
    assert_eq!((sample.time_s, sample.q.as_slice()), (0.01, &[0.3, 0.4][..]));
    assert_eq!(sample.wrenches, WRENCH);
    assert_eq!(sample.status.unwrap().word, 12_500, "the time since the last arrival, µs");
    assert_eq!((arm.pace().count(), arm.pace().skipped), (1, 1));
}

#[test]
fn a_read_waits_for_the_state_that_another_thread_brings() {
    let (mut arm, mut end, mut sample) = arm(&config());
    let later = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(20));
        end.push(&state(0.5, [0.1, 0.2]), &WRENCH);
        end
    });
    arm.read(&mut sample).unwrap();
    assert_eq!(sample.time_s, 0.5);
    later.join().unwrap();
}

#[test]
fn silence_and_faults_end_a_read_by_their_names() {
    let (mut silent, _end, mut sample) = arm(&config());
    let began = Instant::now();
    let fault = silent.read(&mut sample).unwrap_err();
    assert_eq!((fault.code, fault.words.as_ref()), (10, "states-silent: no joint states arrive: for 0.1 s"));
    assert!(began.elapsed() >= Duration::from_millis(100));
    let (mut failed, mut end, mut sample) = arm(&config());
    end.push(&state(0.0, [0.1, 0.2]), &WRENCH);
    end.fail(RosFault::SecondCommander, "");
    end.fail(RosFault::DriverGone, "a consequence");
    let fault = failed.read(&mut sample).unwrap_err();
    assert_eq!(fault.code, RosFault::SecondCommander.code(), "the first fault is the cause");
}

#[test]
fn only_finite_commands_of_the_robots_kind_are_sent() {
    let (mut arm, mut end, _) = arm(&config());
    let mut sent = [0.0; 2];
    for wrong in [Command::Velocity(&[0.1, 0.2]), Command::Position(&[0.1, f64::NAN])] {
        assert_eq!(arm.write(wrong).unwrap_err().code, RosFault::WrongCommand.code());
    }
    assert!(!end.next_command(&mut sent));
    arm.stop();
    arm.write(Command::Hold).unwrap();
    assert!(!end.next_command(&mut sent), "before the first command nothing is sent");
    arm.write(Command::Position(&[0.1, 0.2])).unwrap();
    assert!(end.next_command(&mut sent) && sent == [0.1, 0.2]);
    arm.write(Command::Hold).unwrap();
    assert!(!end.next_command(&mut sent), "the controller keeps the position");
    arm.stop();
    assert!(end.next_command(&mut sent) && sent == [0.1, 0.2], "once more at the end");
}

/// Robot that accepts velocities or torques.
fn moving(kind: CommandKind) -> (RosArm, NodeEnd, Sample) {
    let settings = Settings::new(kind, vec!["elbow".to_owned(), "wrist".to_owned()], 0.01)
        .with("zero_effort_holds", Setting::Flag(true));
    arm(&RosConfig::from_settings(&settings).unwrap())
}

#[test]
fn velocities_and_efforts_are_zero_in_a_hold_and_after_a_stop() {
    for kind in [CommandKind::Velocity, CommandKind::Torque] {
        let (mut arm, mut end, _) = moving(kind);
        let mut sent = [9.0; 2];
        arm.stop();
        assert!(!end.next_command(&mut sent), "before the first command nothing is sent");
        for is_stop in [false, true] {
            arm.write(Command::new(kind, &[0.1, 0.2])).unwrap();
            assert!(end.next_command(&mut sent) && sent == [0.1, 0.2]);
            if is_stop {
                arm.stop();
            } else {
                arm.write(Command::Hold).unwrap();
            }
            assert!(end.next_command(&mut sent) && sent == [0.0; 2], "{kind:?}");
        }
    }
}

#[test]
fn the_last_command_is_sent_several_times_at_the_end_after_a_stop_alone() {
    for kind in [CommandKind::Position, CommandKind::Velocity, CommandKind::Torque] {
        let last = if kind == CommandKind::Position { [0.1, 0.2] } else { [0.0; 2] };
        for is_stopped in [true, false] {
            let (mut arm, mut end, _) = moving(kind);
            let mut sent = [9.0; 2];
            if is_stopped {
                arm.write(Command::new(kind, &[0.1, 0.2])).unwrap();
                arm.stop();
            }
            arm.close();
            let all: Vec<[f64; 2]> =
                std::iter::from_fn(|| end.next_command(&mut sent).then_some(sent)).collect();
            if is_stopped {
                assert!(all.len() > 2 && all[1..].iter().all(|sent| *sent == last), "{kind:?}: {all:?}");
            } else {
                assert!(all.is_empty(), "a robot that was not commanded: {all:?}");
            }
        }
    }
}

#[test]
fn a_node_that_sends_nothing_is_a_fault() {
    let (mut arm, _end, _) = arm(&config());
    let fault = (0..100).find_map(|_| arm.write(Command::Position(&[0.1, 0.2])).err());
    let fault = fault.expect("the ring is full");
    assert_eq!(fault.code, RosFault::ClientFailed.code());
    assert!(fault.words.contains("commands were not sent in time"), "{}", fault.words);
}

#[test]
fn gravity_and_brakes_are_those_that_robot_toml_states() {
    let settings = settings().with_gravity_compensated_by(GravityCompensation::Robot).with_brakes(true);
    let (arm, ..) = arm(&RosConfig::from_settings(&settings).unwrap());
    let capabilities = arm.capabilities();
    assert_eq!(capabilities.gravity_compensated_by, GravityCompensation::Robot);
    assert!(capabilities.has_brakes);
}

#[test]
fn a_robot_that_does_not_follow_is_told_unless_it_is_held() {
    for (kind, per_s) in
        [(CommandKind::Position, 1.0), (CommandKind::Velocity, 1.0), (CommandKind::Torque, 50.0)]
    {
        for is_held in [false, true] {
            let (mut arm, mut end, mut sample) = moving(kind);
            let mut fault = None;
            for cycle in 0..100 {
                let time_s = 0.01 * f64::from(cycle);
                end.push(&state(time_s, [0.1, 0.2]), &[]);
                fault = arm.read(&mut sample).err();
                if fault.is_some() {
                    break;
                }
                arm.write(Command::new(kind, &[0.1 + per_s * time_s, 0.2])).unwrap();
                if is_held && cycle % 40 == 39 {
                    arm.write(Command::Hold).unwrap();
                }
                while end.next_command(&mut [0.0; 2]) {}
            }
            let code = (!is_held).then_some(RosFault::NotFollowing.code());
            assert_eq!(fault.map(|fault| fault.code), code, "{kind:?}, held: {is_held}");
        }
    }
}

/// Compared: the counts of the allocator before and after cycles; it counts this thread.
#[test]
fn reads_and_writes_allocate_nothing() {
    let settings = settings().measuring(&[Measured::Position, Measured::Velocity]);
    let (mut arm, mut end, mut sample) = arm(&RosConfig::from_settings(&settings).unwrap());
    let mut states: Vec<RobotState> = (0..100)
        .map(|cycle| RobotState { dq: vec![0.0; 2], ..state(0.01 * f64::from(cycle), [0.1, 0.2]) })
        .collect();
    // The first cycle remembers its thread.
    let first = states.remove(0);
    end.push(&first, &WRENCH);
    arm.read(&mut sample).unwrap();
    let mut sent = [0.0; 2];
    for state in &states {
        end.push(state, &WRENCH);
        let before = allocations_so_far();
        arm.read(&mut sample).unwrap();
        arm.write(Command::Position(&[0.1, 0.2])).unwrap();
        assert_eq!(allocations_so_far(), before);
        assert!(end.next_command(&mut sent));
    }
}

//! Tests of the simulated bus: lost cycles, dropouts, late setpoints.

use crate::common::{arm, parsed, read, setup};
use opspace_backend::{Backend, Command, CommandKind, GroundTruth, TruthRow};
use opspace_sim::{ArmConfig, SimulatedArm, SimulationError};

const PERIOD_S: f64 = 1e-3;
const RATIO: usize = 5;

fn on_a_bus(bus: &str) -> ArmConfig {
    let mut setup = setup(CommandKind::Position, "a-med");
    setup.simulated.bus = parsed(bus);
    setup
}

/// Returns the times of the true rows, and the times and command numbers of the drives' rows, of the last read.
fn servo_trace(arm: &SimulatedArm) -> (Vec<f64>, Vec<(f64, u64)>) {
    let (mut truth, mut servo) = (Vec::new(), Vec::new());
    arm.visit(&mut |row| match row {
        TruthRow::State { time_s, .. } => truth.push(time_s),
        TruthRow::Servo { time_s, command, .. } => servo.push((time_s, command.unwrap_or(0))),
        _ => {}
    });
    (truth, servo)
}

/// Returns which of `periods` cycles are missed. Each setpoint is the last measured position. Checks that all rows are
/// present and in order.
fn missed(arm: &mut SimulatedArm, periods: usize) -> Vec<bool> {
    let mut missed = Vec::new();
    let (mut ticks, mut servo_ticks) = (0, 0);
    while ticks <= periods {
        let sample = read(arm);
        let (truth, servo) = servo_trace(arm);
        for time_s in &truth {
            assert!((time_s - ticks as f64 * PERIOD_S).abs() < 1e-9, "{time_s} s is tick {ticks}");
            missed.push(true);
            ticks += 1;
        }
        for (time_s, _) in &servo {
            let expected_s = servo_ticks as f64 * PERIOD_S / RATIO as f64;
            assert!((time_s - expected_s).abs() < 1e-9, "{time_s} s is servo tick {servo_ticks}");
            servo_ticks += 1;
        }
        assert_eq!(truth.last(), Some(&sample.time_s), "the sample is of the last of them");
        *missed.last_mut().expect("a tick") = false;
        arm.write(Command::Position(&sample.q)).expect("it takes them");
    }
    missed
}

/// Compared: the fraction of missed cycles and its probability; two runs with the same seed, and one with another.
#[test]
fn cycles_are_lost_at_random() {
    const PERIODS: usize = 4000;
    const SHARE: f64 = 0.2;
    let lost = |seed: u64| {
        let setup = ArmConfig { seed, ..on_a_bus("lost_cycles_share = 0.2") };
        missed(&mut arm(setup), PERIODS)
    };
    let first = lost(1);
    assert!(!first[0], "the controller starts on a good bus");
    let count = first.iter().filter(|missed| **missed).count() as f64;
    let sigma = (PERIODS as f64 * SHARE * (1.0 - SHARE)).sqrt();
    assert!((count - PERIODS as f64 * SHARE).abs() < 4.0 * sigma, "{count} of {PERIODS}");
    assert_eq!(first, lost(1));
    assert_ne!(first, lost(2));
    assert!(missed(&mut arm(on_a_bus("")), 100).iter().all(|missed| !missed), "a good bus loses none");
}

/// Compared: times of samples and of the dropout; the drives' command during the dropout, and the last one before it.
#[test]
fn dropout_blocks_samples_and_commands() {
    let mut arm =
        arm(on_a_bus("dropouts = [{ at_s = 0.0205, duration_s = 0.3 }, { at_s = 0.4, duration_s = 0.01 }]"));
    let mut commands = 0;
    let mut before_s = -PERIOD_S;
    let mut gaps = Vec::new();
    while before_s < 0.5 {
        let sample = read(&mut arm);
        let gap_s = sample.time_s - before_s;
        if gap_s > 1.5 * PERIOD_S {
            gaps.push((before_s, sample.time_s));
            let (_, servo) = servo_trace(&arm);
            assert!(servo.iter().all(|(_, command)| *command == commands), "the last one is held");
            assert_eq!(servo.len(), (gap_s / PERIOD_S).round() as usize * RATIO);
        }
        before_s = sample.time_s;
        arm.write(Command::Position(&sample.q)).expect("it takes them");
        commands += 1;
    }
    let expected = [(0.020, 0.321), (0.399, 0.410)];
    assert_eq!(gaps.len(), expected.len(), "{gaps:?}");
    for (gap, expected) in gaps.iter().zip(expected) {
        let off_s = (gap.0 - expected.0).abs().max((gap.1 - expected.1).abs());
        assert!(off_s < 1e-9, "{gap:?} for {expected:?}");
    }
}

/// Compared: the servo tick at which each setpoint acts, and its delay plus up to `jitter` ticks.
#[test]
fn jittered_setpoints_act_in_order() {
    for (delay, jitter) in [(0, 2), (3, 4), (5, 4), (13, 4)] {
        let mut setup = on_a_bus(&format!("jitter_servo_ticks = {jitter}"));
        setup.profile = parsed_profile(&setup, delay);
        let mut arm = arm(setup);
        let mut acts = Vec::new();
        let mut servo_tick = 0;
        for _ in 0..400 {
            let sample = read(&mut arm);
            for (_, command) in servo_trace(&arm).1 {
                if command as usize > acts.len() {
                    acts.push(servo_tick);
                    assert_eq!(command as usize, acts.len(), "none is left out");
                }
                servo_tick += 1;
            }
            arm.write(Command::Position(&sample.q)).expect("it takes them");
        }
        let late: Vec<usize> =
            acts.iter().enumerate().map(|(k, at)| at - k * RATIO - delay as usize).collect();
        for ticks in 0..=jitter {
            let count = late.iter().filter(|late| **late == ticks).count();
            assert!(count > 40, "delay {delay}, jitter {jitter}: {ticks} ticks late {count} times");
        }
        assert!(late.iter().all(|late| *late <= jitter), "delay {delay}, jitter {jitter}");
    }
}

/// Returns the profile with this delay.
fn parsed_profile(setup: &ArmConfig, delay: u32) -> opspace_transformer::ProfileParameters {
    let mut profile = setup.profile.clone();
    profile.delay_servo_ticks = Some(delay);
    profile
}

#[test]
fn invalid_bus_is_refused_by_name() {
    for (bus, expected) in [
        ("lost_cycles_share = 1.0", SimulationError::LostCycles { share: 1.0 }),
        (
            "dropouts = [{ at_s = 1.0, duration_s = 11.0 }]",
            SimulationError::Dropout { duration_s: 11.0, longest_s: 10.0 },
        ),
        ("jitter_servo_ticks = 5", SimulationError::Jitter { jitter: 5, ratio: 5 }),
    ] {
        let error = SimulatedArm::new(on_a_bus(bus)).err().expect("refused");
        assert_eq!(error, expected);
        let opspace_sim::Key::Robot(key) = error.key() else { panic!("{error}") };
        assert!(bus.starts_with(&key[2]) && key[..2] == ["simulated", "bus"], "{key:?}");
    }
}

//! Faults of drives under the transformers, and the time after which the watchdogs stop the arm: servos that are too stiff, a
//! current of the wrong sign, and an encoder that is stuck.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use crate::coupled_common::project;
use crate::tapped_arm::TappedArm;
use opspace_backend::{Command, CommandKind, Sample};
use opspace_experiment::{Experiment, Files, Progress, RunOptions};
use opspace_loop::run::RunOutcome;
use opspace_transformer::TransformerName;
use std::io;

/// Start of a fault of a sensor, s on the robot's clock.
const FROM_S: f64 = 1.0;

/// Fault of a drive.
#[derive(Clone, Copy, Debug, PartialEq)]
enum DriveFault {
    /// The position loops have 1.5 times their nominal gains.
    Stiff,
    /// Motor currents are reported with the wrong sign.
    Reversed,
    /// The encoder of this joint reports its last position.
    Stuck(usize),
}

impl DriveFault {
    /// Returns what the fault does to the samples from [`FROM_S`] on.
    fn on_sample(self) -> impl FnMut(&mut Sample) {
        let mut stuck_at = None;
        move |sample| match self {
            _ if sample.time_s < FROM_S => {}
            Self::Stiff => {}
            Self::Reversed => {
                sample.motor_torque.iter_mut().flatten().for_each(|torque| *torque = -*torque);
            }
            Self::Stuck(joint) => sample.q[joint] = *stuck_at.get_or_insert(sample.q[joint]),
        }
    }
}

/// Time of the stop, s after the start of control; `None` if the run completes.
fn stopped_at_s(task: &str, transformer: &str, fault: DriveFault) -> Option<f64> {
    let mut settings = vec!["duration_s=4.0".to_owned(), "settle_s=0.1".to_owned(), "expect={}".to_owned()];
    if transformer.starts_with("extrapolation") {
        settings.push("robot.interface.gears=\"elastic\"".to_owned());
    }
    if fault == DriveFault::Stiff {
        settings.push("robot.simulated.true_over_nominal.kp=1.5".to_owned());
    }
    let options = RunOptions {
        backend: CommandKind::Position,
        transformer: Some(TransformerName::from(transformer.to_owned())),
        seed: Some(2),
        ..RunOptions::default()
    };
    let path = project(&format!("tasks/{task}.toml"));
    let experiment = Experiment::load(Files::Disk, &path, None, options, &settings)
        .unwrap_or_else(|error| panic!("{error}"));
    let arm = experiment.simulated_arm().unwrap();
    let mut robot = TappedArm { arm, on_sample: fault.on_sample(), on_command: |_: Command<'_>| {} };
    let finished = experiment.run_on(&mut robot, io::sink(), &Progress::default()).unwrap();
    match finished.outcome {
        RunOutcome::Faulted { time_s, .. } => Some(time_s),
        _ => None,
    }
}

/// Stops of each task with each transformer, ms after the start of the fault: too stiff, reversed, and an encoder that is stuck, of
/// the second and of the fourth joint. These are times before the watchdog of power took the energy of the added inertia into
/// account, but for the third, which was 81. None: a run that was not stopped.
const STOPS_MS: [(&str, &str, [Option<u32>; 4]); 9] = [
    ("cartesian-tracking", "extrapolation+current", [None, Some(47), None, None]),
    ("gravity-compensation", "extrapolation+current", [None, Some(43), None, None]),
    ("compliant-x", "extrapolation+current", [None, Some(140), None, None]),
    ("panda-tracking", "extrapolation+current", [None, Some(17), Some(56), Some(357)]),
    ("ur5e-tracking", "extrapolation+current", [None, Some(16), Some(60), Some(386)]),
    ("panda-tracking", "emulation+current", [None, Some(13), Some(57), Some(352)]),
    ("panda-tracking", "extrapolation", [Some(31), Some(79), Some(25), Some(358)]),
    ("ur5e-tracking", "extrapolation", [Some(50), Some(108), Some(26), Some(392)]),
    ("ur5e-tracking", "paper", [Some(54), Some(362), Some(18), Some(422)]),
];

/// Tolerance of a stop: a control cycle of the UR5e.
const CYCLE_S: f64 = 2e-3;

#[test]
fn faults_of_drives_are_stopped_in_time() {
    let faults = [DriveFault::Stiff, DriveFault::Reversed, DriveFault::Stuck(1), DriveFault::Stuck(3)];
    for (task, transformer, stops_ms) in STOPS_MS {
        for (fault, most_ms) in faults.into_iter().zip(stops_ms) {
            let from_s = if fault == DriveFault::Stiff { 0.0 } else { FROM_S };
            let Some(most_ms) = most_ms else { continue };
            let stopped_s = stopped_at_s(task, transformer, fault).map(|at_s| at_s - from_s);
            let most_s = f64::from(most_ms) * 1e-3 + 1.5 * CYCLE_S;
            assert!(stopped_s.is_some_and(|s| s <= most_s), "{task} {transformer} {fault:?}: {stopped_s:?}");
        }
    }
}

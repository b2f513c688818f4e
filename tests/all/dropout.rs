//! Buses that lose cycles, in complete experiments: the servos hold the arm, and control resumes without a jump.
//!
//! Compared in all tests: the true motion of the arm in the log, and the motion with a good bus.

use crate::common::{self, Run, ik, load, osc, run, torque};
use opspace_experiment::evaluate::metrics::metrics;
use opspace_experiment::{ControllerKind, Experiment, RunOptions};
use opspace_log::Recording;
use opspace_loop::{Fault, Phase, RunOutcome};
use opspace_transformer::TransformerName;

/// Interval in which the bus is interrupted, s.
const DEAD: (f64, f64) = (3.0, 3.3);
const DROPOUT: &str = "robot.simulated.bus.dropouts=[{ at_s = 3.0, duration_s = 0.3 }]";

fn tracking(options: RunOptions, transformer: &str, settings: &[&str]) -> Experiment {
    let transformer = Some(TransformerName::from(transformer.to_owned()));
    let options = RunOptions { duration_s: Some(6.0), transformer, ..options };
    load("cartesian-tracking", options, settings)
}

/// Largest magnitude of a signal of a channel between two times (s).
fn largest(run: &Run, channel: &str, signal: &str, from_s: f64, to_s: f64) -> f64 {
    let rows = run.channel(channel).time_s.iter().zip(run.signal(channel, signal).rows());
    let within = rows.filter(|(t, _)| (from_s..to_s).contains(*t)).flat_map(|(_, row)| row);
    within.fold(0.0, |max: f64, v| max.max(v.abs()))
}

/// True joint positions at a time (rad; n).
fn joints(run: &Run, time_s: f64) -> Vec<f64> {
    let k = run.channel("truth").time_s.partition_point(|&t| t < time_s - 1e-9);
    run.signal("truth", "q").row(k).to_vec()
}

/// Number of cycles in a phase, and the time of the first one, s.
fn ticks(run: &Run, phase: Phase) -> (usize, f64) {
    let phases = run.signal("tick", "phase");
    let found: Vec<usize> = (0..phases.len()).filter(|&k| phases.row(k)[0] == phase.code()).collect();
    (found.len(), found.first().map_or(f64::NAN, |&k| run.channel("tick").time_s[k]))
}

/// Rms tracking error of the hand from a time on, m.
fn tracking_rms(experiment: &Experiment, recording: &Recording, from_s: f64) -> f64 {
    let mut task = experiment.task().clone();
    task.file.settle_s = serde_json::from_value(from_s.into()).expect("a time");
    let options = experiment.options().clone();
    let late = common::experiment(experiment.robot().clone(), task, options);
    metrics(&late, recording).pose.position_rms_m.expect("a Cartesian task")
}

/// Dropout of 0.3 s at the fastest instant of the stroke. Also compared: the distance that each joint continues to
/// move, and the distance of its last setpoint, (τ/kv + q̇)/kp: 40 mrad for the stiff servo and 80 mrad for the soft
/// one.
#[test]
fn dropout_is_held_and_resumed_without_jump() {
    for profile in ["a-med", "b-soft"] {
        let good = run(&tracking(osc(profile), "emulation+current", &[]));
        let experiment = tracking(osc(profile), "emulation+current", &[DROPOUT]);
        let run = run(&experiment);
        assert_eq!(run.ending, RunOutcome::Completed, "{profile}");
        let period_s = experiment.profile().1.period_s();
        let missed: f64 = run.signal("tick", "missed_cycles").rows().map(|row| row[0]).sum();
        assert!((missed * period_s - 0.3).abs() < 1.5 * period_s, "{profile}: {missed} cycles");

        // The distance that the joint continued to move, and that it then stood still.
        let [began, ended] = [DEAD.0, DEAD.1].map(|time_s| joints(&run, time_s));
        let k = run.channel("truth").time_s.partition_point(|&t| t < DEAD.0 - 1e-9);
        let (dq, tau) = (run.signal("truth", "dq").row(k), run.signal("servo", "motor_torque"));
        let tau = tau.row(k * experiment.profile().1.servo_ticks_per_cycle.get() as usize);
        let servo_s = experiment.profile().1.servo_period_s();
        for (j, servo) in experiment.robot().servos(experiment.profile().1).iter().enumerate() {
            let servo = servo.gains(servo_s);
            let lead = (tau[j] + servo.damping * dq[j]) / servo.stiffness;
            let moved = ended[j] - began[j];
            assert!(
                (moved - lead).abs() < 5e-3 + 0.2 * lead.abs(),
                "{profile}, joint {j}: {moved} for {lead} rad"
            );
        }
        let still = largest(&run, "truth", "dq", DEAD.0 + 0.25, DEAD.1);
        assert!(still < 0.01, "{profile}: {still} rad/s with the bus still dead");

        let (held, held_s) = ticks(&run, Phase::Held);
        let (resuming, resumed_s) = ticks(&run, Phase::Resuming);
        assert!((held_s - DEAD.1).abs() < 1.5 * period_s, "{profile}: held from {held_s} s");
        assert!((resumed_s - DEAD.1 - 0.05).abs() < 2.5 * period_s, "{profile}: resumed at {resumed_s} s");
        assert!((held as f64 * period_s - 0.05).abs() < 2.5 * period_s, "{profile}: {held} ticks");
        assert!((resuming as f64 * period_s - 0.2).abs() < 2.5 * period_s, "{profile}: {resuming} ticks");

        // Torques and speeds are not higher than with a good bus: saturation is at 40 and 22 Nm.
        let torque = largest(&run, "tick", "torque_desired", resumed_s, 6.0);
        let usual = largest(&good, "tick", "torque_desired", 0.0, 6.0);
        assert!(torque < 1.2 * usual, "{profile}: {torque} Nm for {usual} Nm");
        assert_eq!(largest(&run, "tick", "torque_saturated", 0.0, 6.0), 0.0);
        let speed = largest(&run, "truth", "dq", DEAD.1, 6.0);
        let usual = largest(&good, "truth", "dq", 0.0, 6.0);
        assert!(speed < 1.2 * usual, "{profile}: {speed} rad/s for {usual} rad/s");
        // Joints that friction held away from their equilibrium under gravity move by half a milliradian.
        let jolt = largest(&run, "truth", "dq", resumed_s, resumed_s + 0.02);
        assert!(jolt < 0.1, "{profile}: {jolt} rad/s within 20 ms of resuming");

        // One second later, the hand is on its path again as without the dropout.
        let [after, before] = [&run, &good].map(|run| tracking_rms(&experiment, &run.recording, 4.6));
        assert!(after < before + 1e-3, "{profile}: {after} m for {before} m");
    }
}

/// Inverse kinematics and joint references resume from the setpoints that held the arm.
#[test]
fn other_controllers_resume_without_jump() {
    for (task, options) in [
        ("cartesian-tracking", ik("a-med", ControllerKind::Ik)),
        ("cartesian-tracking", ik("b-soft", ControllerKind::IkLead)),
        ("joint-tracking", ik("a-med", ControllerKind::IkLead)),
        ("joint-tracking", osc("a-med")),
    ] {
        let options = RunOptions { duration_s: Some(5.0), ..options };
        let good = run(&load(task, options.clone(), &[]));
        let run = run(&load(task, options.clone(), &[DROPOUT]));
        assert_eq!(run.ending, RunOutcome::Completed, "{task} {options:?}");
        let resumed_s = ticks(&run, Phase::Resuming).1;
        // Setpoints do not move faster than usual, and the arm only slightly faster.
        for (channel, signal) in [("tick", "setpoint_speed"), ("truth", "dq")] {
            let [after, usual] =
                [(&run, resumed_s), (&good, 0.5)].map(|(run, t)| largest(run, channel, signal, t, 5.0));
            assert!(after < 1.3 * usual, "{task} {options:?}: {signal} of {after} for {usual} rad/s");
        }
        let end = [&run, &good].map(|run| joints(run, 4.9));
        let apart = end[0].iter().zip(&end[1]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(apart < 0.02, "{task} {options:?}: {apart} rad from the undisturbed run at its end");
    }
}

/// Dropout on a torque robot: the drives hold the last torque, the arm continues to move, and its brakes stop it.
#[test]
fn torque_robot_is_braked_before_resuming() {
    let experiment = load(
        "cartesian-tracking",
        RunOptions { duration_s: Some(6.0), ..torque("a-med") },
        &["robot.simulated.bus.dropouts=[{ at_s = 3.0, duration_s = 0.05 }]"],
    );
    let run = run(&experiment);
    assert_eq!(run.ending, RunOutcome::Completed);
    let (held, _) = ticks(&run, Phase::Held);
    assert!(held >= 50, "{held} ticks");
    let after = tracking_rms(&experiment, &run.recording, 4.6);
    assert!(after < 2e-3, "{after} m");
}

/// Compared: tracking with occasional lost cycles, which are all tolerated, and tracking without lost cycles.
#[test]
fn lost_cycles_are_tolerated() {
    for profile in ["a-med", "b-soft"] {
        let lost = "robot.simulated.bus.lost_cycles_share=0.01";
        let experiment = tracking(osc(profile), "emulation+current", &[lost]);
        let run = run(&experiment);
        assert_eq!(run.ending, RunOutcome::Completed, "{profile}");
        let missed: f64 = run.signal("tick", "missed_cycles").rows().map(|row| row[0]).sum();
        assert!(missed > 3.0, "{profile}: {missed} cycles");
        assert_eq!(ticks(&run, Phase::Held).0, 0, "{profile}: none of them in a row of four");
        let found = metrics(&experiment, &run.recording).pose.position_rms_m.expect("a Cartesian task");
        assert!(found < 3e-3, "{profile}: {found} m");
    }
}

/// Dropout longer than the maximum: the run is stopped in the position in which the arm was held.
#[test]
fn too_long_dropout_stops_the_run() {
    let dead = "robot.simulated.bus.dropouts=[{ at_s = 2.0, duration_s = 1.2 }]";
    let run = run(&tracking(osc("a-med"), "emulation+current", &[dead]));
    let RunOutcome::Faulted { fault: Fault::Dropout { silent_s, .. }, .. } = &run.ending else {
        panic!("{:?}", run.ending)
    };
    assert!((silent_s - 1.2).abs() < 2e-3, "{silent_s} s");
    let end_s = *run.channel("truth").time_s.last().expect("rows");
    let [held, stopped] = [3.1, end_s].map(|time_s| joints(&run, time_s));
    let moved = held.iter().zip(&stopped).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(moved < 2e-3, "it stayed where the servos had held it: {moved} rad");
}

/// A servo whose kp is 30 % higher than assumed by the paper's transformer is unstable: its motor power reveals this
/// before it becomes too fast.
#[test]
fn unstable_servo_faults_by_excess_power() {
    for profile in ["a-med", "b-soft"] {
        let run = run(&tracking(osc(profile), "paper", &["robot.simulated.true_over_nominal.kp=1.3"]));
        let RunOutcome::Faulted { fault, time_s } = &run.ending else { panic!("{:?}", run.ending) };
        assert!(matches!(fault, Fault::ExcessPower { .. }), "{profile}: {fault:?}");
        let speed = largest(&run, "truth", "dq", 0.0, 10.0);
        assert!(speed < 8.0, "{profile}: {speed} rad/s at {time_s} s");
        let left = largest(&run, "truth", "dq", time_s + 0.19, 10.0);
        assert!(left < 0.05, "{profile}: {left} rad/s after the stop");
    }
}

//! Every setpoint of a run is within the limits that the drives declare, to the last one, which replaces that of its cycle.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use crate::coupled_common::project;
use crate::tapped_arm::TappedArm;
use opspace_backend::quantity::Positive;
use opspace_backend::{Command, CommandKind, Sample};
use opspace_experiment::{Experiment, Files, Progress, RunOptions};
use opspace_transformer::setpoint_limits::{JointSetpointLimits, SetpointStream};
use std::io;

/// Ends of runs in the middle of a motion.
#[test]
fn no_setpoint_of_a_run_exceeds_a_limit() {
    for (limits, duration_s) in
        [([2.0, 10.0, 5000.0], 1.0), ([3.0, 100.0, 5000.0], 1.3), ([1.0, 30.0, 300.0], 0.8)]
    {
        let [v, a, j] = limits;
        let joint = format!(
            "{{ velocity_rad_per_s = {v:.1}, acceleration_rad_per_s2 = {a:.1}, jerk_rad_per_s3 = {j:.1} }}"
        );
        let mut settings: Vec<String> = (1..=7)
            .map(|k| format!("robot.profile.interface-1khz.setpoint_limits.joint.joint{k}={joint}"))
            .collect();
        settings.push("robot.profile.interface-1khz.setpoint_limits.reaction=\"refuse\"".to_owned());
        let more = ["robot.interface.gears=\"elastic\"", "settle_s=0.1", "expect={}"];
        settings.extend(more.map(str::to_owned));
        settings.push(format!("duration_s={duration_s:.1}"));
        let options = RunOptions { backend: CommandKind::Position, ..RunOptions::default() };
        let path = project("tasks/panda-tracking.toml");
        let experiment = Experiment::load(Files::Disk, &path, None, options, &settings)
            .unwrap_or_else(|error| panic!("{error}"));
        let period_s = experiment.capabilities().period_s;
        let mut declared = JointSetpointLimits::default();
        declared.velocity_rad_per_s = Some(Positive::literal(v));
        declared.acceleration_rad_per_s2 = Some(Positive::literal(a));
        declared.jerk_rad_per_s3 = Some(Positive::literal(j));
        let mut streams: Vec<SetpointStream> =
            (0..7).map(|_| SetpointStream::new(&declared, CommandKind::Position, period_s)).collect();
        let arm = experiment.simulated_arm().unwrap();
        // Number of commands, and those of them that exceed a limit.
        let (mut commands, mut beyond) = (0, Vec::new());
        let on_command = |command: Command<'_>| {
            let Command::Position(setpoints) = command else { return };
            commands += 1;
            for (stream, &setpoint) in streams.iter_mut().zip(setpoints) {
                if stream.exceeds(setpoint).is_some() {
                    beyond.push(commands);
                }
                stream.take(setpoint);
            }
        };
        let mut robot = TappedArm { arm, on_sample: |_: &mut Sample| {}, on_command };
        let finished = experiment.run_on(&mut robot, io::sink(), &Progress::default()).unwrap();
        assert!(finished.record.fault.is_none(), "{limits:?}: {:?}", finished.record.fault);
        assert!(commands > 500, "{}", commands);
        assert_eq!(beyond, [0_usize; 0], "{limits:?}, of {} commands", commands);
    }
}

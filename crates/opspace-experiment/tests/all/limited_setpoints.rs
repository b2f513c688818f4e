//! Every setpoint of a run is within the limits that the drives declare, to the last one of its stop, which rests.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use crate::coupled_common::project;
use crate::tapped_arm::TappedArm;
use opspace_backend::quantity::Positive;
use opspace_backend::{Command, CommandKind, Sample};
use opspace_experiment::{ControllerKind, Experiment, Files, Progress, RunOptions};
use opspace_testing::random::Random;
use opspace_transformer::setpoint_limits::{JointSetpointLimits, SetpointStream};
use std::io;

/// Tasks of two arms, with their profiles.
const TASKS: [(&str, &str); 6] = [
    ("tasks/panda-tracking.toml", "interface-1khz"),
    ("tasks/ur5e-tracking.toml", "rtde-500hz"),
    ("tasks/panda-reach.toml", "interface-1khz"),
    ("tasks/ur5e-compliant.toml", "rtde-500hz"),
    ("tasks/panda-press.toml", "interface-1khz"),
    ("tasks/ur5e-press.toml", "rtde-500hz"),
];

/// Speed of a setpoint at rest, rad/s: the effect of rounding is a hundredth of it.
const REST_RAD_PER_S: f64 = 1e-7;

/// Ends of runs in the middle of a motion: planned, or by a measurement that is not a number.
#[test]
fn no_setpoint_of_a_run_exceeds_a_limit() {
    let mut slow_stops = 0;
    for seed in 0..24 {
        let mut random = Random(seed);
        let (task, profile) = TASKS[random.below(TASKS.len())];
        let mut between = |low: f64, high: f64| low * (high / low).powf(random.next());
        let [v, a, j] = [between(0.5, 3.0), between(5.0, 500.0), between(100.0, 1e5)];
        let (duration_s, noise) = (between(0.4, 1.0), between(1e-8, 3e-5));
        let fails_at_s = if between(0.1, 10.0) < 1.0 { 0.5 * duration_s } else { f64::INFINITY };
        let is_ik = random.is(0.3) && !task.contains("press");
        let controller = if is_ik { ControllerKind::Ik } else { ControllerKind::Osc };
        let place = format!("{seed}: {task} {controller:?} {v} rad/s {a} rad/s² {j} rad/s³ {duration_s} s");
        let options = RunOptions { backend: CommandKind::Position, controller, ..RunOptions::default() };
        let joint = format!(
            "{{ velocity_rad_per_s = {v:?}, acceleration_rad_per_s2 = {a:?}, jerk_rad_per_s3 = {j:?} }}"
        );
        let path = project(task);
        let plain = Experiment::load(Files::Disk, &path, None, options.clone(), &[])
            .unwrap_or_else(|e| panic!("{e}"));
        let limits = format!("robot.profile.{profile}.setpoint_limits");
        let names = plain.robot().model.joints().iter().map(|joint| &joint.name);
        let mut settings: Vec<String> = names.map(|name| format!("{limits}.joint.{name}={joint}")).collect();
        let more = ["settle_s=0.1", "expect={}", "robot.interface.gears=\"elastic\""].map(str::to_owned);
        settings.extend(more);
        settings.extend([format!("{limits}.reaction=\"refuse\""), format!("duration_s={duration_s:?}")]);
        let experiment = Experiment::load(Files::Disk, &path, None, options, &settings)
            .unwrap_or_else(|error| panic!("{error}"));
        let period_s = experiment.capabilities().period_s;
        let mut declared = JointSetpointLimits::default();
        declared.velocity_rad_per_s = Some(Positive::literal(v));
        declared.acceleration_rad_per_s2 = Some(Positive::literal(a));
        declared.jerk_rad_per_s3 = Some(Positive::literal(j));
        let mut streams: Vec<SetpointStream> =
            vec![
                SetpointStream::new(&declared, CommandKind::Position, period_s);
                experiment.capabilities().joints.len()
            ];
        let arm = experiment.simulated_arm().unwrap();
        // Number of commands, those of them that exceed a limit, and the last two.
        let (mut commands, mut beyond) = (0, Vec::new());
        let mut last = [Vec::new(), Vec::new()];
        let on_command = |command: Command<'_>| {
            let Command::Position(setpoints) = command else { return };
            commands += 1;
            for (stream, &setpoint) in streams.iter_mut().zip(setpoints) {
                if stream.exceeds(setpoint).is_some() {
                    beyond.push(commands);
                }
                stream.take(setpoint);
            }
            last.rotate_left(1);
            last[1] = setpoints.to_vec();
        };
        let on_sample = |sample: &mut Sample| {
            sample.q.iter_mut().for_each(|q| *q += noise * random.between(-1.0, 1.0));
            if sample.time_s > fails_at_s {
                sample.q[0] = f64::NAN;
            }
        };
        let mut robot = TappedArm { arm, on_sample, on_command };
        let finished = experiment.run_on(&mut robot, io::sink(), &Progress::default()).unwrap();
        assert_eq!(beyond, [0_usize; 0], "{place}, of {commands} commands: {:?}", finished.record.fault);
        let planned = (0.2 * duration_s / period_s) as usize;
        assert!(commands > planned, "{place}: {commands}: {:?}", finished.record.fault);
        slow_stops += usize::from(commands as f64 * period_s > duration_s);
        for (at_end, before) in last[1].iter().zip(&last[0]) {
            let speed = (at_end - before).abs() / period_s;
            assert!(speed < REST_RAD_PER_S, "{place}: left at {speed} rad/s");
        }
    }
    assert!(slow_stops > 3, "{slow_stops} stops with more than one setpoint");
}

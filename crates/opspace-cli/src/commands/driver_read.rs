//! `opspace driver read`: the angles of a real robot that a person moves by hand.

use crate::cli::DriverReadArgs;
use crate::console::{Console, Exit, Failure, Outcome, escaped, print};
use crate::interrupt;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use opspace_backend::{Observed, ObservedTorque, Sample, Settings};
use opspace_experiment::files::origin::Kind;
use opspace_experiment::{
    Extensions, FileError, Files, Progress, RobotDefinition, RunOptions, Scenario, Source,
};
use opspace_loop::driver_calls::read_once;
use opspace_model::{Joint, JointKind};
use std::io::{self, IsTerminal};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Shortest time between two readings that are shown: the driver of a fast robot returns more.
const SHOWN: Duration = Duration::from_millis(90);

pub fn read(args: &DriverReadArgs, extensions: &Extensions, console: Console) -> Outcome {
    let (robot, settings) = robot(args, extensions)?;
    let torque = if args.release { ObservedTorque::Released } else { ObservedTorque::AsFound };
    if args.release {
        console.note("an arm whose torque is on is lowered: keep its workspace clear");
    }
    let watch = interrupt::watch();
    let mut shown = Ok(());
    robot.observe_on_driver(extensions, &settings, torque, &mut |arm| {
        // After the arm was lowered.
        let end = args.duration_s.map(|duration_s| Instant::now() + Duration::from_secs_f64(duration_s));
        shown = show(arm, robot.model.joints(), end, &watch, console);
    })?;
    shown?;
    Ok(Exit::Done)
}

/// Robot of the file, and the settings of its driver.
fn robot(args: &DriverReadArgs, extensions: &Extensions) -> Result<(RobotDefinition, Settings), Failure> {
    let path = &args.file;
    let is_robot =
        path.is_dir() || Kind::of(Source::read(Files::Disk.robot_file(path))?.text()) == Some(Kind::Robot);
    if is_robot {
        let robot = RobotDefinition::load(Files::Disk, path, &args.set)?;
        let (_, profile) = robot.profile(None)?;
        let settings = robot.driver_settings(robot.file.interface.command, profile);
        return Ok((robot, settings));
    }
    let options = RunOptions::default();
    let scenario =
        Scenario::load(extensions, Files::Disk, path, args.robot.as_deref(), None, options, &args.set)?;
    let Some(experiment) = scenario.single() else {
        let help = "name one of its robots".to_owned();
        let name = path.display().to_string();
        return Err(FileError::of_file(name, "has several robots", Some(help)).into());
    };
    Ok((experiment.robot().clone(), experiment.driver_settings()))
}

/// Shows readings until the end or a signal: in place on a terminal, otherwise a line each.
fn show(
    arm: &mut dyn Observed,
    joints: &[Joint],
    end: Option<Instant>,
    watch: &Progress,
    console: Console,
) -> Result<(), Failure> {
    let mut sample = Sample::new(arm.capabilities());
    let is_terminal = io::stdout().is_terminal();
    let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stdout());
    if is_terminal && let Ok(style) = ProgressStyle::with_template("{msg}") {
        bar.set_style(style);
        console.note("Ctrl-C ends");
    }
    let (begun, mut last) = (Instant::now(), None::<Instant>);
    let is_over = || watch.interrupt.load(Ordering::Relaxed);
    while !is_over() && end.is_none_or(|end| Instant::now() < end) {
        read_once(arm, &mut sample).map_err(|fault| Failure::Other(fault.to_string(), Exit::Failed))?;
        if is_over() || last.is_some_and(|last| last.elapsed() < SHOWN) {
            continue;
        }
        last = Some(Instant::now());
        let lines: Vec<String> = joints
            .iter()
            .zip(&sample.q)
            .enumerate()
            .map(|(index, (joint, q))| line(joint, *q, arm.raw(index)))
            .chain(arm.state())
            .collect();
        if is_terminal {
            bar.set_message(escaped(&lines.join("\n")).into_owned());
        } else {
            print(&format!("{:.1} s: {}\n", begun.elapsed().as_secs_f64(), lines.join("; ")))?;
        }
    }
    if is_terminal {
        if is_over() {
            // The terminal has printed ^C below the table, which would not be drawn in its place.
            bar.set_draw_target(ProgressDrawTarget::hidden());
            print("\n")?;
        }
        // The last reading stays.
        bar.abandon();
    }
    Ok(())
}

/// Describes the position of a joint.
fn line(joint: &Joint, q: f64, raw: Option<String>) -> String {
    let name = &joint.name;
    let mut text = match joint.kind {
        JointKind::Prismatic => format!("{name} {q:+.4} m"),
        _ => format!("{name} {q:+.4} rad ({:+.1}°)", q.to_degrees()),
    };
    text.extend(raw.map(|raw| format!(", {raw}")));
    let limits = joint.limits;
    if q < limits.lower || q > limits.upper {
        text += &format!(", OUTSIDE its limits {} to {}", limits.lower, limits.upper);
    }
    text
}

//! `opspace identify`: identification of the servos of a robot's joints by moving them.

use crate::cli::IdentifyArgs;
use crate::commands::posture::first_task;
use crate::commands::run::note_missing_real_time;
use crate::console::{Console, Exit, Failure, Outcome, render};
use crate::interrupt;
use crate::output::{pretty, write};
use crate::result_folder::{IDENTIFICATION, ROBOT_FILE, SERVO_FILE, prepare};
use crate::run_progress::style;
use indicatif::ProgressBar;
use opspace_backend::CommandKind;
use opspace_experiment::run::real_robot::positions;
use opspace_experiment::run::result_files::REPORT;
use opspace_experiment::{Extensions, Files, RobotDefinition, Source};
use opspace_identify::ExcitationPlan;
use opspace_identify::session::AbortReason;
use opspace_model::files::open_file;
use opspace_setup::identify::identification_page::identification_page;
use opspace_setup::identify::{HungWeight, IdentificationJob, IdentificationResults, Request};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

pub fn identify(args: &IdentifyArgs, extensions: &Extensions, console: Console) -> Outcome {
    let robot = RobotDefinition::load_to_identify(Files::Disk, &args.robot, &args.set)?;
    for warning in &robot.warnings {
        console.detail(&format!("{}: {warning}", robot.urdf.name()));
    }
    let default = PathBuf::from(format!("runs/identify-{}", robot.name()));
    let files = [IDENTIFICATION, REPORT, SERVO_FILE, ROBOT_FILE].map(str::to_owned);
    let inputs: Vec<PathBuf> = [robot.source.name(), robot.urdf.name()].map(PathBuf::from).into();
    let results = prepare(&args.output, &default, &files, &inputs, console)?;
    refuse_other_urdf(results.path(), &robot.urdf)?;
    let is_real = robot.file.driver.is_some() && !args.simulate;
    let identified = match is_real {
        true => identify_real_robot(&robot, args, extensions, console)?,
        false => identify_simulated_robot(robot, args, console)?,
    };
    say_results(&identified, results.path(), args, console)
}

/// Request of the command line, without start positions.
fn request(args: &IdentifyArgs) -> Request {
    Request {
        profile: args.profile.clone(),
        joint: args.joint.clone(),
        start_rad: Vec::new(),
        plan: ExcitationPlan { seed: args.seed, ..ExcitationPlan::default() },
        hung_weight: args.hang.clone().map(|(frame, mass_kg)| HungWeight { frame, mass_kg }),
    }
}

fn identify_simulated_robot(
    robot: RobotDefinition,
    args: &IdentifyArgs,
    console: Console,
) -> Result<IdentificationResults, Failure> {
    // Positions of the command line replace those of the first task.
    let first_task = first_task(&robot).and_then(|first| first.start_rad).unwrap_or_default();
    let start_rad = first_task.into_iter().chain(args.start_rad.clone()).collect();
    let identifying = IdentificationJob::new(robot, Request { start_rad, ..request(args) })?;
    let mut arm = identifying.simulated_arm()?;
    let mut with_weight = identifying.simulated_arm_with_weight()?;
    let reason = if args.simulate { "--simulate asks for it" } else { "robot.toml has no [driver]" };
    console.note(&format!("the robot is simulated: {reason}"));
    say_plan(&identifying, console);
    let watch = interrupt::watch();
    let identified = with_progress(&identifying, console, |begun| {
        let mut results = identifying.run(&mut arm, &watch, &mut *begun)?;
        if let Some(arm) = &mut with_weight {
            identifying.run_with_weight(&mut results, arm, &watch, begun)?;
        }
        Ok(results)
    });
    identified.map_err(ended_early)
}

/// Identifies the robot of `[driver]`, from the posture in which it is.
fn identify_real_robot(
    robot: &RobotDefinition,
    args: &IdentifyArgs,
    extensions: &Extensions,
    console: Console,
) -> Result<IdentificationResults, Failure> {
    if !args.start_rad.is_empty() {
        let text = "--start-rad is for simulations: a real robot, as its [driver] says, begins where it is; --simulate identifies a \
                    simulated one";
        return Err(Failure::Other(text.to_owned(), Exit::Bad));
    }
    let (_, profile) = robot.profile(args.profile.as_deref())?;
    let settings = robot.driver_settings(CommandKind::Position, profile);
    for doubt in robot.check_driver(extensions, &settings)? {
        console.note(&format!("warning: {doubt} [{}]", doubt.code));
    }
    let watch = interrupt::watch_with_robots();
    let identified = robot.with_driver(extensions, &settings, |arm| {
        let joints = robot.model.joints().iter().map(|joint| joint.name.clone());
        let start_rad = joints.zip(positions(arm)?).collect();
        let identifying = IdentificationJob::new(robot.clone(), Request { start_rad, ..request(args) })?;
        say_plan(&identifying, console);
        note_missing_real_time(robot, console)?;
        console.note("the arm moves now: keep its workspace clear; Ctrl-C stops it");
        let identified = with_progress(&identifying, console, |begun| identifying.run(arm, &watch, begun));
        let Ok(mut results) = identified else { return Ok(identified) };
        if let Some((frame, mass_kg)) = &args.hang {
            console.note(&format!("hang {} kg on '{frame}', and press Enter", mass_kg.get()));
            // Without a terminal there is nobody to wait for.
            let _ = io::stdin().read_line(&mut String::new());
            let repeated = with_progress(&identifying, console, |begun| {
                identifying.run_with_weight(&mut results, arm, &watch, begun)
            });
            if let Err(stop) = repeated {
                return Ok(Err(stop));
            }
        }
        Ok(Ok(results))
    })?;
    if let Some(state) = robot.driver(extensions)?.state_after_run(&settings) {
        console.note(&state);
    }
    identified.map_err(ended_early)
}

/// Says how each joint will move.
fn say_plan(identifying: &IdentificationJob, console: Console) {
    for (joint, motion) in identifying.planned_motions() {
        console.note(&format!("{joint} will move {motion}"));
    }
    let planned_s = identifying.planned_s();
    if planned_s > 0.0 {
        console.note(&format!("all of these motions take some {planned_s:.0} s"));
    }
}

fn ended_early(stop: AbortReason) -> Failure {
    match stop {
        AbortReason::Interrupted => {
            Failure::Other("interrupted before all joints were identified".to_owned(), Exit::Interrupted)
        }
        other => Failure::Other(other.to_string(), Exit::Failed),
    }
}

/// Writes the results and shows them.
fn say_results(
    identified: &IdentificationResults,
    folder: &Path,
    args: &IdentifyArgs,
    console: Console,
) -> Outcome {
    let written = write_results(folder, identified)?;
    let tables = || identified.tables().iter().map(|(_, table)| render(table)).collect::<Vec<_>>().join("\n");
    let text = || format!("{}\n{}", identified.verdict(), tables());
    args.output.json.print(|| pretty(&identified.json()), text)?;
    for joint in &identified.joints {
        if let Some(reason) = &joint.no_torque_mode {
            console.note(&format!("{}: torque control refused: {reason}", joint.name));
        }
        for doubt in &joint.found.doubts {
            console.note(&format!("{}: doubtful: {doubt}", joint.name));
        }
    }
    if identified.joints.iter().any(|joint| joint.found.refused.is_some() && !joint.is_static()) {
        console.note(
            "a joint that is refused may be identified in another posture: --start-rad JOINT=RAD sets it. Choose one away from \
             limits, in which the joints are weakly coupled and hold little weight",
        );
    }
    console.note(&format!(
        "identification took {:.0} s of robot time; wrote {}",
        identified.robot_s,
        written.join(", ")
    ));
    Ok(if identified.is_complete() { Exit::Done } else { Exit::Failed })
}

/// Refuses a folder with another file under the name of the copy of the URDF.
fn refuse_other_urdf(folder: &Path, urdf: &Source) -> Result<(), Failure> {
    let copy = folder.join(Path::new(urdf.name()).file_name().unwrap_or_default());
    if open_file(&copy).and_then(io::read_to_string).is_ok_and(|text| text != urdf.text()) {
        let text = format!("{}: already exists and differs from {}", copy.display(), urdf.name());
        return Err(Failure::Other(text + "; choose another folder with --out", Exit::Bad));
    }
    Ok(())
}

/// Writes all results and returns their paths.
fn write_results(folder: &Path, identified: &IdentificationResults) -> Result<Vec<String>, Failure> {
    let mut files = vec![
        (SERVO_FILE.to_owned(), identified.servo_toml()),
        (IDENTIFICATION.to_owned(), pretty(&identified.json())),
        (REPORT.to_owned(), identification_page(identified)),
    ];
    let urdf = identified.urdf_name();
    if let Some(robot) = identified.robot_toml(&urdf)? {
        files.push((ROBOT_FILE.to_owned(), robot));
        files.push((urdf, identified.urdf().to_owned()));
    }
    let mut paths = Vec::new();
    for (name, text) in files {
        let path = folder.join(name);
        write(&path, &text)?;
        paths.push(path.display().to_string());
    }
    Ok(paths)
}

/// Shows the joint that is being identified. The bar counts joints, because the duration differs between joints.
fn with_progress<T>(
    identifying: &IdentificationJob,
    console: Console,
    work: impl FnOnce(&mut dyn FnMut(&str)) -> T,
) -> T {
    if !console.shows_progress() {
        return work(&mut |_| {});
    }
    let bar = ProgressBar::new(identifying.joints() as u64);
    bar.set_style(style("{pos:>4}/{len} {wide_bar} {elapsed} {msg}"));
    bar.enable_steady_tick(Duration::from_millis(100));
    let mut done = 0;
    let result = work(&mut |joint| {
        bar.set_position(done);
        bar.set_message(joint.to_owned());
        done += 1;
    });
    bar.finish_and_clear();
    result
}

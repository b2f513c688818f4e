//! `opspace identify`: identification of the servos of a robot's joints by moving them.

use crate::cli::IdentifyArgs;
use crate::commands::posture::first_task;
use crate::console::{Console, Exit, Failure, Outcome, render};
use crate::interrupt;
use crate::output::{pretty, write};
use crate::result_folder::{IDENTIFICATION, ROBOT_FILE, SERVO_FILE, prepare};
use crate::run_progress::style;
use indicatif::ProgressBar;
use opspace_experiment::run::result_files::REPORT;
use opspace_experiment::{Files, RobotDefinition, Source};
use opspace_identify::ExcitationPlan;
use opspace_identify::session::AbortReason;
use opspace_model::files::open_file;
use opspace_setup::identify::identification_page::identification_page;
use opspace_setup::identify::{HungWeight, IdentificationJob, IdentificationResults, Request};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

pub fn identify(args: &IdentifyArgs, console: Console) -> Outcome {
    let robot = RobotDefinition::load_to_identify(Files::Disk, &args.robot, &args.set)?;
    for warning in &robot.warnings {
        console.detail(&format!("{}: {warning}", robot.urdf.name()));
    }
    let robot_paths = (robot.source.name().to_owned(), robot.urdf.name().to_owned());
    // Positions of the command line replace those of the first task.
    let first_task = first_task(&robot).and_then(|first| first.start_rad).unwrap_or_default();
    let request = Request {
        profile: args.profile.clone(),
        joint: args.joint.clone(),
        start_rad: first_task.into_iter().chain(args.start_rad.clone()).collect(),
        plan: ExcitationPlan { seed: args.seed, ..ExcitationPlan::default() },
        hung_weight: args.hang.clone().map(|(frame, mass_kg)| HungWeight { frame, mass_kg }),
    };
    let identifying = IdentificationJob::new(robot, request)?;
    let mut arm = identifying.simulated_arm()?;
    let mut with_weight = identifying.simulated_arm_with_weight()?;
    let default = PathBuf::from(format!("runs/identify-{}", identifying.robot().name()));
    let files = [IDENTIFICATION, REPORT, SERVO_FILE, ROBOT_FILE].map(str::to_owned);
    let inputs: Vec<PathBuf> = [&robot_paths.0, &robot_paths.1].map(PathBuf::from).into();
    let results = prepare(&args.output, &default, &files, &inputs, console)?;
    let folder = results.path();
    refuse_other_urdf(folder, &identifying.robot().urdf)?;
    for (joint, motion) in identifying.planned_motions() {
        console.note(&format!("{joint} will move {motion}"));
    }
    let watch = interrupt::watch();
    let identified = with_progress(&identifying, console, |begun| {
        let mut results = identifying.run(&mut arm, &watch, &mut *begun)?;
        if let Some(arm) = &mut with_weight {
            identifying.run_with_weight(&mut results, arm, &watch, begun)?;
        }
        Ok(results)
    });
    let identified = identified.map_err(|stop| match stop {
        AbortReason::Interrupted => {
            Failure::Other("interrupted before all joints were identified".to_owned(), Exit::Interrupted)
        }
        other => Failure::Other(other.to_string(), Exit::Failed),
    })?;
    let written = write_results(folder, &identified)?;
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

//! Motion of a real robot to the start position of a task, with a folder of results.

use crate::scenario_run::{LeftBehind, run_robots};
use opspace_experiment::evaluate::summary::Summary;
use opspace_experiment::extensions::Extensions;
use opspace_experiment::run::error::RunError;
use opspace_experiment::run::execute::Progress;
use opspace_experiment::run::experiment::Experiment;
use opspace_experiment::run::real_robot::positions;
use opspace_experiment::run::result_files::ResultFolder;
use opspace_experiment::run::scenario::Scenario;
use std::path::Path;

/// Opens the robot of `[driver]` and moves it slowly to the start position of the task
/// ([`Experiment::motion_to_start`]). Writes log, summary and report of the motion to `folder`. `None`
/// if the robot is already there; otherwise `begins` is called with the motion before it begins. The robot is held until the run that follows. It is watched as in [`run_on_drivers`](crate::run_on_drivers).
///
/// # Errors
/// As [`Experiment::run_on_driver`]; a robot that does not arrive.
pub fn move_to_start(
    experiment: &Experiment,
    extensions: &Extensions,
    folder: &Path,
    progress: &Progress,
    (begins, left_behind): (&dyn Fn(&Experiment), LeftBehind<'_>),
) -> Result<Option<Summary>, RunError> {
    experiment.with_driver_before_run(extensions, |backend| {
        let Some(motion) = experiment.motion_to_start(&positions(backend)?)? else { return Ok(None) };
        motion.check_robot(backend)?;
        begins(&motion);
        let folder = ResultFolder::open(folder)?;
        let summary = run_robots(
            &Scenario::from(motion),
            &mut [&mut *backend],
            &folder,
            progress,
            (&mut (), left_behind),
        )?;
        let summary = summary.robots.into_values().next();
        // A motion that was stopped says so itself.
        if summary.as_ref().is_some_and(|summary| summary.faulted.is_none() && !summary.interrupted) {
            experiment.check_start_reached(backend)?;
        }
        Ok(summary)
    })
}

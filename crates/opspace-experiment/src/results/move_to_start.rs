//! Motion of a real robot to the start position of a task, with a folder of results.

use crate::evaluate::summary::Summary;
use crate::extensions::Extensions;
use crate::results::scenario_run::LeftBehind;
use crate::run::error::RunError;
use crate::run::execute::Progress;
use crate::run::experiment::Experiment;
use crate::run::real_robot::positions;
use crate::run::result_files::ResultFolder;
use crate::run::scenario::Scenario;
use std::path::Path;

impl Experiment {
    /// Opens the robot of `[driver]` and moves it slowly to the start position of the task
    /// ([`motion_to_start`](Self::motion_to_start)). Writes log, summary and report of the motion to `folder`. `None`
    /// if the robot is already there. The robot is watched as in [`Scenario::run_on_drivers`].
    ///
    /// # Errors
    /// As [`run_on_driver`](Self::run_on_driver).
    pub fn move_to_start(
        &self,
        extensions: &Extensions,
        folder: &Path,
        progress: &Progress,
        left_behind: LeftBehind<'_>,
    ) -> Result<Option<Summary>, RunError> {
        self.with_driver(extensions, |backend| {
            let Some(motion) = self.motion_to_start(&positions(backend)?)? else { return Ok(None) };
            motion.check_robot(backend)?;
            let folder = ResultFolder::open(folder)?;
            let summary =
                Scenario::from(motion).run_robots(&mut [backend], &folder, progress, left_behind)?;
            Ok(summary.robots.into_values().next())
        })
    }
}

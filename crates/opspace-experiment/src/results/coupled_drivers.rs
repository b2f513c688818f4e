//! Execution of an experiment with several robots of which some are real: those whose robot.toml selects a driver.

use crate::evaluate::coupled_summary::CoupledSummary;
use crate::extensions::Extensions;
use crate::files::source::FileError;
use crate::preflight::checked_for_real_robot;
use crate::run::coupled_experiment::CoupledExperiment;
use crate::run::error::RunError;
use crate::run::execute::Progress;
use crate::run::result_files::ResultFolder;
use opspace_backend::Backend;

/// Function of all robots, in the order of the experiment, while they are open.
type Body<'a, T> = dyn FnMut(&mut [&mut dyn Backend]) -> Result<T, RunError> + 'a;

impl CoupledExperiment {
    /// Names of the robots that are real, because their robot.toml selects a driver.
    #[must_use]
    pub fn real_robots(&self) -> Vec<&str> {
        let real = self.members.iter().filter(|member| member.experiment.has_driver());
        real.map(|member| member.name.as_str()).collect()
    }

    /// Refuses the robots named in `real` whose margins are too small, unless that is allowed.
    ///
    /// # Errors
    /// The refusals of [`checked_for_real_robot`].
    pub fn checked_for_real_robots(mut self, real: &[String]) -> Result<Self, FileError> {
        let members = std::mem::take(&mut self.members).into_iter();
        let checked = members.map(|mut member| {
            if real.contains(&member.name) {
                member.experiment = checked_for_real_robot(member.experiment)?;
            }
            Ok(member)
        });
        self.members = checked.collect::<Result<_, FileError>>()?;
        Ok(self)
    }

    /// Runs the experiment in a folder as [`run_in_folder`](Self::run_in_folder) does, with the real robots opened by drivers in
    /// `extensions`, and the others simulated. All robots are read in one thread, each when its next cycle begins: a robot whose
    /// clock differs from those of the others misses a cycle now and then. A simulated robot waits for the real ones.
    ///
    /// # Errors
    /// As [`run_in_folder`](Self::run_in_folder); a driver that is unknown or cannot open its robot, a real robot that is not at
    /// its start position, or objects, which only a simulation has.
    pub fn run_on_drivers(
        &self,
        extensions: &Extensions,
        folder: &ResultFolder,
        progress: &Progress,
    ) -> Result<CoupledSummary, RunError> {
        if let (Some(robot), Some(object)) = (self.real_robots().first(), self.file.objects.keys().next()) {
            let message =
                format!("objects are simulated, but robot '{robot}' is real: its robot.toml has a [driver]");
            let help = Some("remove the object, or add --simulate".to_owned());
            return Err(FileError::at_key(&self.source, ["objects", object], message, help).into());
        }
        self.with_robots(extensions, Vec::new(), &mut |robots| self.run_robots(robots, folder, progress))
    }

    /// Opens the robots that follow those that are `open`, and calls `body` with all.
    fn with_robots<T>(
        &self,
        extensions: &Extensions,
        open: Vec<&mut dyn Backend>,
        body: &mut Body<'_, T>,
    ) -> Result<T, RunError> {
        let mut open = open;
        let Some(member) = self.members.get(open.len()) else { return body(&mut open) };
        if !member.experiment.has_driver() {
            let mut arm = member.experiment.simulated_arm()?;
            return self.with_robots(extensions, with(open, &mut arm), body);
        }
        member.experiment.with_driver(extensions, |robot| {
            member.experiment.compare_capabilities(robot.capabilities())?;
            member.experiment.check_start(robot)?;
            self.with_robots(extensions, with(open, robot), body)
        })
    }
}

/// Returns the robots with one more, which may be borrowed for a shorter time.
fn with<'a, 'b: 'a>(robots: Vec<&'b mut dyn Backend>, one: &'a mut dyn Backend) -> Vec<&'a mut dyn Backend> {
    robots.into_iter().map(|robot| robot as &mut dyn Backend).chain([one]).collect()
}

//! Execution of an experiment on the robot that `[driver]` of robot.toml selects.

use crate::codes::Code;
use crate::extensions::Extensions;
use crate::files::robot::RobotDefinition;
use crate::files::source::FileError;
use crate::run::error::RunError;
use crate::run::execute::{Progress, RunResult, check_real_time};
use crate::run::experiment::Experiment;
use crate::suggest::choices;
use opspace_backend::{Backend, CommandKind, Driver, DriverError, Setting, Settings};
use opspace_loop::driver_calls::stop;
use opspace_loop::{RealTime, RealTimeMode, RealTimeParameters};
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

/// Key of `[driver]` that selects the driver.
const NAME: &str = "name";
/// Keys of `[driver]` for the scheduling of the control thread, which every driver has.
const REAL_TIME: &str = "real_time";
const REAL_TIME_PRIORITY: &str = "real_time_priority";

impl Experiment {
    /// True if robot.toml selects a driver, that is, if the robot is real.
    #[must_use]
    pub fn has_driver(&self) -> bool {
        self.robot.file.driver.is_some()
    }

    /// Runs the experiment on the robot of `[driver]`, opened by a driver in `extensions`.
    ///
    /// # Errors
    /// An unknown driver, invalid driver settings, or a robot that cannot be opened; otherwise as
    /// [`run_on`](Self::run_on).
    pub fn run_on_driver<W: Write + Send + 'static>(
        &self,
        extensions: &Extensions,
        sink: W,
        progress: &Progress,
    ) -> Result<RunResult<W>, RunError> {
        self.with_driver(extensions, |backend| self.run_on(backend, sink, progress))
    }

    /// Opens the robot of `[driver]`, calls `body`, and closes the robot. After an error or a panic, the robot is stopped.
    pub fn with_driver<T>(
        &self,
        extensions: &Extensions,
        body: impl FnOnce(&mut dyn Backend) -> Result<T, RunError>,
    ) -> Result<T, RunError> {
        self.refuse_comparison_options()?;
        self.robot.with_driver(extensions, &self.driver_settings(), body)
    }

    /// Opens the robot like [`with_driver`](Self::with_driver), for a motion that a run follows: the robot is held in between.
    ///
    /// # Errors
    /// As [`with_driver`](Self::with_driver).
    pub fn with_driver_before_run<T>(
        &self,
        extensions: &Extensions,
        body: impl FnOnce(&mut dyn Backend) -> Result<T, RunError>,
    ) -> Result<T, RunError> {
        self.refuse_comparison_options()?;
        let mut settings = self.driver_settings();
        settings.is_followed = true;
        self.robot.with_driver(extensions, &settings, body)
    }

    /// Settings with which a driver opens the robot of the experiment.
    #[must_use]
    pub fn driver_settings(&self) -> Settings {
        self.robot.driver_settings(self.command_kind(), self.profile.period_s())
    }
}

impl RobotDefinition {
    /// Opens the robot of `[driver]`, calls `body`, and closes the robot. After an error or a panic, the robot is stopped.
    ///
    /// # Errors
    /// An unknown driver, invalid driver settings, or a robot that cannot be opened; the error of `body`.
    pub fn with_driver<T>(
        &self,
        extensions: &Extensions,
        settings: &Settings,
        body: impl FnOnce(&mut dyn Backend) -> Result<T, RunError>,
    ) -> Result<T, RunError> {
        let driver = self.driver(extensions)?;
        let real_time = self.real_time()?;
        if real_time.mode == RealTimeMode::Required {
            check_real_time(real_time, &RealTime::enter(real_time))?;
        }
        let (mut body, mut result) = (Some(body), None);
        let mut run = |backend: &mut dyn Backend| {
            // A driver calls this closure once.
            if let Some(body) = body.take() {
                result = Some(or_stopped(backend, body));
            }
        };
        let closed = catch_unwind(AssertUnwindSafe(|| driver.with(settings, &mut run)));
        match (result, closed) {
            (Some(Err(error)), _) => Err(error),
            (Some(Ok(done)), Ok(Ok(()))) => Ok(done),
            (Some(Ok(_)), Ok(Err(error))) => Err(RunError::AfterRun { words: error.words }),
            (Some(Ok(_)), Err(_)) => {
                let words =
                    "it panicked while it closed the robot; the message was printed to standard error";
                Err(RunError::AfterRun { words: words.to_owned() })
            }
            (None, Ok(Err(error))) => Err(self.driver_error(&error).into()),
            (None, Err(_)) => Err(RunError::Panicked { place: "the driver, while it opened the robot," }),
            (None, Ok(Ok(()))) => {
                let error = DriverError::new("the driver opened the robot but did not run it");
                Err(self.driver_error(&error).into())
            }
        }
    }

    /// Driver that `[driver]` selects.
    ///
    /// # Errors
    /// A robot without `[driver]`, or with the name of a driver that the program does not have.
    pub fn driver<'a>(&self, extensions: &'a Extensions) -> Result<&'a dyn Driver, FileError> {
        let source = &self.source;
        let Some(keys) = &self.file.driver else {
            let message = "this robot has no [driver], so it can only be simulated";
            let help = "append [driver] with the `name` of a driver (`opspace driver list`) and its settings"
                .to_owned();
            return Err(FileError::of_file(source.name(), message, Some(help)).refused(Code::MissingDriver));
        };
        let Some(Setting::Text(name)) = keys.get(NAME) else {
            let message = "[driver] has no name";
            return Err(FileError::at_key(source, "driver", message, Some("add `name = ...`".to_owned())));
        };
        let found = extensions.drivers.iter().find(|driver| driver.name() == name);
        found.map(|driver| &**driver).ok_or_else(|| {
            let known: Vec<&str> = extensions.drivers.iter().map(|driver| driver.name()).collect();
            let help = if known.is_empty() {
                "no driver is compiled in: build a program with opspace_cli::main_with, or use --simulate"
                    .to_owned()
            } else {
                choices(name, known)
            };
            let message = format!("this program has no driver '{name}'");
            FileError::at_key(source, ["driver", NAME], message, Some(help)).refused(Code::MissingDriver)
        })
    }

    /// Scheduling of the control thread that `[driver]` asks for: `real_time` and `real_time_priority`.
    ///
    /// # Errors
    /// Values that are not allowed.
    pub fn real_time(&self) -> Result<RealTimeParameters, FileError> {
        let key = |key: &str| {
            self.file.driver.iter().flatten().find(|(other, _)| *other == key).map(|(_, value)| value)
        };
        let mistake = |key: &str, message: String, help: Option<String>| {
            FileError::at_key(&self.source, ["driver", key], message, help)
        };
        let mut parameters = RealTimeParameters::default();
        match key(REAL_TIME) {
            None => {}
            Some(Setting::Text(text)) => {
                let found = RealTimeMode::ALL.into_iter().find(|mode| mode.name() == text);
                let help = || choices(text, RealTimeMode::ALL.map(RealTimeMode::name));
                let mode = found.ok_or_else(|| {
                    mistake(REAL_TIME, format!("no scheduling is called '{text}'"), Some(help()))
                })?;
                parameters = parameters.with_mode(mode);
            }
            Some(_) => {
                let message = "`real_time` must be \"auto\", \"required\" or \"off\"".to_owned();
                return Err(mistake(REAL_TIME, message, None));
            }
        }
        match key(REAL_TIME_PRIORITY) {
            None => {}
            Some(Setting::Number(number)) if number.fract() == 0.0 && (1.0..=99.0).contains(number) => {
                parameters = parameters.with_priority(*number as u8);
            }
            Some(_) => {
                let message = "`real_time_priority` must be an integer from 1 to 99".to_owned();
                return Err(mistake(REAL_TIME_PRIORITY, message, None));
            }
        }
        Ok(parameters)
    }

    /// States what this machine does not allow of the scheduling that `[driver]` asks for; `None` if it allows all.
    ///
    /// # Errors
    /// As [`real_time`](Self::real_time).
    pub fn missing_real_time(&self) -> Result<Option<String>, FileError> {
        let real_time = RealTime::enter(self.real_time()?);
        Ok((!real_time.is_complete()).then(|| real_time.text()))
    }

    /// Settings with which a driver opens the robot for these commands, at this interface period (s).
    #[must_use]
    pub fn driver_settings(&self, command: CommandKind, period_s: f64) -> Settings {
        let joints = self.model.joints().iter().map(|joint| joint.name.clone()).collect();
        let folder = Path::new(self.source.name()).parent().unwrap_or(Path::new(""));
        let settings = Settings::new(command, joints, period_s)
            .measuring(&self.file.interface.measured)
            .with_force_sensors(self.capabilities(command, period_s).force_sensors)
            .in_folder(folder);
        let keys = self
            .file
            .driver
            .iter()
            .flatten()
            .filter(|(key, _)| ![NAME, REAL_TIME, REAL_TIME_PRIORITY].contains(&key.as_str()));
        keys.fold(settings, |settings, (key, value)| settings.with(key, value.clone()))
    }

    /// Error of a driver, at its key in `[driver]`.
    pub(crate) fn driver_error(&self, error: &DriverError) -> FileError {
        match &error.key {
            Some(key) => FileError::at_key(&self.source, ["driver", key], error.words.clone(), None),
            None => FileError::at_key(&self.source, "driver", error.words.clone(), None),
        }
    }
}

/// Calls `body`; after an error or a panic, the robot is stopped.
fn or_stopped<T>(
    backend: &mut dyn Backend,
    body: impl FnOnce(&mut dyn Backend) -> Result<T, RunError>,
) -> Result<T, RunError> {
    let before = match catch_unwind(AssertUnwindSafe(|| body(backend))) {
        Ok(Ok(done)) => return Ok(done),
        Ok(Err(error)) => error,
        Err(_) => {
            RunError::Panicked { place: "a part of the program or the driver, outside the control loop," }
        }
    };
    match stop(backend) {
        Ok(()) => Err(before),
        Err(fault) => Err(RunError::NotStopped { fault, before: Box::new(before) }),
    }
}

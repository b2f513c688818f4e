//! Execution of an experiment on the robot that `[driver]` of robot.toml selects.

use crate::codes::Code;
use crate::extensions::Extensions;
use crate::files::robot::RobotDefinition;
use crate::files::source::FileError;
use crate::finding::Finding;
use crate::run::error::RunError;
use crate::run::execute::{Progress, RunResult, check_real_time};
use crate::run::experiment::Experiment;
use crate::suggest::{choices, nearest};
use opspace_backend::{
    Backend, CommandKind, Driver, DriverError, DriverWarning, Observed, ObservedTorque, Setting, Settings,
    StatedServo,
};
use opspace_loop::driver_calls::stop;
use opspace_loop::{RealTime, RealTimeMode, RealTimeParameters};
use opspace_transformer::{ProfileParameters, ServoParameters};
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

    /// Names the driver of `[driver]` and its port: `driver 'feetech', port /dev/ttyACM0`; `None` for a robot without one.
    #[must_use]
    pub fn driver_text(&self) -> Option<String> {
        let keys = self.robot.file.driver.as_ref()?;
        let text = |key: &str| match keys.get(key) {
            Some(Setting::Text(text)) => Some(text.as_str()),
            _ => None,
        };
        let port = text("port").map_or_else(String::new, |port| format!(", port {port}"));
        Some(format!("driver '{}'{port}", text(NAME)?))
    }

    /// State in which the driver leaves the robot after a run, in words; `None` if it does not say.
    #[must_use]
    pub fn state_after_run(&self, extensions: &Extensions) -> Option<String> {
        self.robot.driver(extensions).ok()?.state_after_run(&self.driver_settings())
    }

    /// Checks `[driver]` without opening the robot. Returns warnings; none for a robot without a driver.
    ///
    /// # Errors
    /// A driver that this program does not have; settings that the driver refuses, at their key; what the robot will declare
    /// otherwise than robot.toml.
    pub fn check_driver(&self, extensions: &Extensions) -> Result<Vec<Finding>, FileError> {
        if !self.has_driver() {
            return Ok(Vec::new());
        }
        let settings = self.driver_settings();
        let warnings = self.robot.check_driver(extensions, &settings)?;
        let driver = self.robot.driver(extensions)?;
        let declared = driver.capabilities(&settings);
        if let Some(declared) = declared.map_err(|error| self.robot.driver_error(driver, &error))? {
            self.compare_capabilities(&declared)?;
        }
        Ok(warnings)
    }

    /// Settings with which a driver opens the robot of the experiment.
    #[must_use]
    pub fn driver_settings(&self) -> Settings {
        self.robot.driver_settings(self.command_kind(), &self.profile)
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
            (None, Ok(Err(error))) => Err(self.driver_error(driver, &error).into()),
            (None, Err(_)) => Err(RunError::Panicked { place: "the driver, while it opened the robot," }),
            (None, Ok(Ok(()))) => {
                let error = DriverError::new("the driver opened the robot but did not run it");
                Err(self.driver_error(driver, &error).into())
            }
        }
    }

    /// Opens the robot of `[driver]` to read it without commanding it, calls `observe`, and closes it.
    ///
    /// # Errors
    /// An unknown driver or one that always commands its robot, invalid settings, or a robot that cannot be opened or lowered.
    pub fn observe_on_driver(
        &self,
        extensions: &Extensions,
        settings: &Settings,
        torque: ObservedTorque,
        observe: &mut dyn FnMut(&mut dyn Observed),
    ) -> Result<(), FileError> {
        let driver = self.driver(extensions)?;
        driver.observe(settings, torque, observe).map_err(|error| self.driver_error(driver, &error))
    }

    /// Checks `[driver]` without opening the robot, with the settings of a run. Returns warnings: those of the driver, and required
    /// scheduling that this machine does not allow. None for a robot without `[driver]`.
    ///
    /// # Errors
    /// A driver that this program does not have; settings that the driver refuses, at their key.
    pub fn check_driver(
        &self,
        extensions: &Extensions,
        settings: &Settings,
    ) -> Result<Vec<Finding>, FileError> {
        if self.file.driver.is_none() {
            return Ok(Vec::new());
        }
        let driver = self.driver(extensions)?;
        let real_time = self.real_time()?;
        let mut warnings = driver.check(settings).map_err(|error| self.driver_error(driver, &error))?;
        if let (RealTimeMode::Required, Some(missing)) = (real_time.mode, self.missing_real_time()?) {
            let words = format!(
                "`{REAL_TIME}` is \"required\", but: {missing}; `opspace doctor` says how to mend it"
            );
            warnings.push(DriverWarning::at(REAL_TIME, words));
        }
        let finding = |warning: DriverWarning| {
            let key = ["driver", &warning.key];
            Finding::new(Code::DriverDoubt, &key, warning.words, String::new()).of_robot()
        };
        Ok(warnings.into_iter().map(finding).collect())
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
        let known: Vec<&str> = extensions.drivers.iter().map(|driver| driver.name()).collect();
        let help = |name: &str| match known.as_slice() {
            [] => "no driver is compiled in: build a program with opspace_cli::main_with, or use --simulate"
                .to_owned(),
            known => choices(name, known.iter().copied()),
        };
        let name = match keys.get(NAME) {
            Some(Setting::Text(name)) => name,
            Some(_) => {
                let message = "`name` must be a string, the name of a driver";
                return Err(FileError::at_key(source, ["driver", NAME], message, Some(help(""))));
            }
            None => {
                let message = "[driver] has no `name`, which selects the driver";
                return Err(FileError::at_key(source, "driver", message, Some(help(""))));
            }
        };
        let found = extensions.drivers.iter().find(|driver| driver.name() == name);
        found.map(|driver| &**driver).ok_or_else(|| {
            let help = help(name);
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

    /// Settings with which a driver opens the robot as robot.toml declares it; `None` without a profile that is the default.
    #[must_use]
    pub fn default_driver_settings(&self) -> Option<Settings> {
        let (_, profile) = self.profile(None).ok()?;
        Some(self.driver_settings(self.file.interface.command, profile))
    }

    /// Settings with which a driver opens the robot for these commands, with this profile.
    #[must_use]
    pub fn driver_settings(&self, command: CommandKind, profile: &ProfileParameters) -> Settings {
        let period_s = profile.period_s();
        let servos = self.model.joints().iter().map_while(|joint| profile.servo.get(&joint.name));
        let servos = servos.map(|servo| stated_servo(servo, profile.servo_period_s())).collect();
        let joints = self.model.joints().iter().map(|joint| joint.name.clone()).collect();
        let folder = Path::new(self.source.name()).parent().unwrap_or(Path::new(""));
        let stated = self.capabilities(command, period_s);
        let settings = Settings::new(command, joints, period_s)
            .measuring(&self.file.interface.measured)
            .with_gravity_compensated_by(stated.gravity_compensated_by)
            .with_brakes(stated.has_brakes)
            .with_force_sensors(stated.force_sensors)
            .with_servos(servos)
            .in_folder(folder);
        let keys = self
            .file
            .driver
            .iter()
            .flatten()
            .filter(|(key, _)| ![NAME, REAL_TIME, REAL_TIME_PRIORITY].contains(&key.as_str()));
        keys.fold(settings, |settings, (key, value)| settings.with(key, value.clone()))
    }

    /// Error of a driver, at its key in `[driver]`. An unknown key that is similar to a known one is probably that one.
    pub(crate) fn driver_error(&self, driver: &dyn Driver, error: &DriverError) -> FileError {
        let Some(key) = &error.key else {
            return FileError::at_key(&self.source, "driver", error.words.clone(), None);
        };
        let known: Vec<&str> = driver.keys().iter().map(|key| key.name).collect();
        let meant = if known.contains(&key.as_str()) { None } else { nearest(key, known) };
        let help = meant.map(|meant| format!("did you mean `{meant}`?"));
        FileError::at_key(&self.source, ["driver", key], error.words.clone(), help)
    }
}

/// Servo of a joint for a driver that writes gains. What a transfer function integrates is not known.
fn stated_servo(servo: &ServoParameters, period_s: f64) -> StatedServo {
    let has_integral = match servo {
        ServoParameters::Pid(servo) => servo.integral_nm_per_rad_s.get() > 0.0,
        ServoParameters::Cascaded(servo) => servo.velocity_integral_time_s.is_some(),
        _ => true,
    };
    StatedServo { stiffness_nm_per_rad: servo.gains(period_s).stiffness, has_integral }
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

//! Transformer of an experiment: choice with its reason, requirements on the robot, and construction.

use crate::extensions::UnknownName;
use crate::files::controller_kind::ControllerKind;
use crate::files::source::FileError;
use crate::run::experiment::Experiment;
use crate::transformers::entry::{TransformerEntry, TransformerTraits};
use crate::transformers::help_of;
use crate::transformers::setup::{TransformerSetup, drive_timing, setpoint_limits};
use opspace_backend::{CommandKind, Measured};
use opspace_transformer::setpoint_limits::JointSetpointLimits;
use opspace_transformer::{
    DeclaredProperties, DriveTiming, EmulatingTransformer, Gears, Identity, ObservedTransformer, ServoGains,
    ServoParameters, TorqueObjective, TorqueObserver, TorqueObserverSetup, Transformer, TransformerName,
    VelocitySource,
};

impl Experiment {
    /// Transformer in use, which converts torques to position or velocity setpoints; `None` if commands pass
    /// unchanged.
    #[must_use]
    pub fn transformer_name(&self) -> Option<TransformerName> {
        self.uses_transformer().then(|| self.chosen_transformer().0)
    }

    /// Reason for the choice of the transformer, and what it leaves of the servos' damping.
    #[must_use]
    pub fn transformer_reason(&self) -> Option<String> {
        let reason = self.uses_transformer().then(|| self.chosen_transformer().1)?;
        let left = self.servo_damping().ok().flatten();
        Some(left.map_or(reason.clone(), |left| format!("{reason}; {left}")))
    }

    /// Requirements and properties of the transformer in use; `None` if commands pass unchanged.
    pub fn transformer_traits(&self) -> Option<TransformerTraits> {
        self.transformer_name().map(|name| self.traits_of(&name))
    }

    /// Requirements and properties of a transformer; those of one without any if the name is unknown.
    pub fn traits_of(&self, name: &TransformerName) -> TransformerTraits {
        self.task.tables.get(name.as_str()).map_or_else(TransformerTraits::default, TransformerEntry::traits)
    }

    fn uses_transformer(&self) -> bool {
        self.options.backend != CommandKind::Torque && self.options.controller == ControllerKind::Osc
    }

    pub(crate) fn chosen_transformer(&self) -> (TransformerName, String) {
        if let Some(name) = &self.options.transformer {
            return (name.clone(), "requested".to_owned());
        }
        if let Some(name) = &self.profile.transformer {
            return (name.clone(), format!("set in profile '{}'", self.profile_name));
        }
        self.default_transformer()
    }

    /// True if the transformer follows from the declared properties of the robot: none is requested or set.
    pub fn chooses_transformer(&self) -> bool {
        self.options.transformer.is_none() && self.profile.transformer.is_none()
    }

    /// Best transformer for the declared properties of the robot, and the reason.
    fn default_transformer(&self) -> (TransformerName, String) {
        TransformerName::best(&DeclaredProperties {
            setpoints: self.robot.file.interface.setpoints,
            delay_servo_ticks: self.profile.delay_servo_ticks,
            measures_current: self.measures_current(),
            gears: self.robot.gears(),
        })
    }

    /// Transformer to try in place of the one in use: the default one, or for rigid gears the one that elastic gears bear.
    pub(crate) fn other_transformer(&self) -> Option<TransformerName> {
        let used = self.transformer_name()?;
        let best = self.default_transformer().0;
        let knows_delay = self.profile.delay_servo_ticks.is_some();
        let extrapolation = TransformerName::EXTRAPOLATION.with_current(best.has_current());
        let candidates = [Some(best), knows_delay.then_some(extrapolation)];
        candidates.into_iter().flatten().find(|candidate| *candidate != used)
    }

    /// Returns the experiment with another transformer.
    ///
    /// # Errors
    /// A robot that the transformer does not suit.
    pub(crate) fn with_transformer(&self, name: &TransformerName) -> Result<Self, FileError> {
        let mut changed = self.clone();
        changed.options.transformer = Some(name.clone());
        changed.check_transformer(name)?;
        Ok(changed)
    }

    /// True if the robot measures the currents of its motors.
    #[must_use]
    pub fn measures_current(&self) -> bool {
        self.robot.file.interface.measured.contains(&Measured::MotorCurrent)
    }

    /// Entry of the table for a transformer.
    fn entry(&self, name: &TransformerName) -> Result<&TransformerEntry, FileError> {
        let unknown = |unknown: UnknownName| {
            FileError::of_file(self.task.source.name(), unknown.to_string(), Some(help_of(&unknown)))
        };
        self.task.tables.find(name.as_str()).map_err(unknown)
    }

    /// Robot for which a transformer is built.
    pub(crate) fn setup<'a>(&'a self, name: &'a TransformerName) -> Result<TransformerSetup<'a>, FileError> {
        Ok(TransformerSetup {
            name,
            robot: &self.robot,
            profile_name: &self.profile_name,
            profile: &self.profile,
            takes: self.options.backend,
            start: self.start()?,
            friction: &self.task.file.friction_compensation,
        })
    }

    /// Builds the chosen transformer.
    ///
    /// # Errors
    /// A servo that the transformer cannot invert.
    pub fn transformer(&self) -> Result<Box<dyn Transformer>, FileError> {
        let observes = self.velocity_source() == VelocitySource::Observer;
        let (name, _) = self.chosen_transformer();
        let setup = self.setup(&name)?;
        if self.options.backend == CommandKind::Torque {
            return Ok(if observes { Box::new(self.torque_observer(&setup)) } else { Box::new(Identity) });
        }
        let entry = self.entry(&name)?;
        let converting = entry.build(&setup)?;
        if !observes || entry.traits().estimates_velocity {
            return Ok(converting);
        }
        let observer = EmulatingTransformer::new(&setup.emulation(TorqueObjective::IntervalMean, false)?);
        let observer = observer.map_err(|(joint, e)| setup.joint_error(setup.servo_table(), joint, &e))?;
        Ok(Box::new(ObservedTransformer::new(observer, converting)))
    }

    /// Estimate of the joint velocities that the controller uses.
    #[must_use]
    pub fn velocity_source(&self) -> VelocitySource {
        let knows_delay = self.profile.delay_servo_ticks.is_some();
        let by_default = match self.options.backend {
            // The observer predicts with rigid gears.
            CommandKind::Torque => {
                let measures_velocity = self.robot.file.interface.measured.contains(&Measured::Velocity);
                !measures_velocity && self.robot.gears() == Gears::Rigid
            }
            CommandKind::Velocity => knows_delay,
            CommandKind::Position => self.traits_of(&self.chosen_transformer().0).estimates_velocity,
        };
        let default = if by_default { VelocitySource::Observer } else { VelocitySource::Filter };
        self.profile.estimator.velocity.unwrap_or(default)
    }

    fn torque_observer(&self, setup: &TransformerSetup<'_>) -> TorqueObserver {
        let observed = TorqueObserverSetup {
            friction: setup.whole_friction(),
            resolution_rad: self.robot.joints().iter().map(|j| j.rotor.resolution_rad()).collect(),
            period_s: self.profile.period_s(),
            delay_s: f64::from(self.profile.delay()) * self.profile.servo_period_s(),
            gravity_compensated_by: self.gravity_compensated_by(),
        };
        TorqueObserver::new(&observed, &self.robot.model)
    }

    fn takes_velocities(&self) -> bool {
        self.options.backend == CommandKind::Velocity
    }

    /// Timing of the drives.
    pub fn drive_timing(&self) -> DriveTiming {
        drive_timing(&self.robot, &self.profile)
    }

    /// Limits of the setpoints of each joint (n); empty if the drives have none.
    pub(crate) fn setpoint_limits(&self) -> Vec<JointSetpointLimits> {
        setpoint_limits(&self.robot, &self.profile)
    }

    /// Servos of the robot, in joint order.
    ///
    /// # Errors
    /// A profile without servos of the required kind.
    pub fn servos(&self) -> Result<Vec<ServoParameters>, FileError> {
        self.robot.servos_for(&self.profile_name, self.command_kind())
    }

    /// Gains of the servos that take the setpoints, joint by joint.
    ///
    /// # Errors
    /// A profile without servos of the required kind.
    pub fn servo_gains(&self) -> Result<Vec<ServoGains>, FileError> {
        let period_s = self.profile.servo_period_s();
        Ok(self.servos()?.iter().map(|servo| servo.gains(period_s)).collect())
    }

    /// Checks the transformer's additional requirements on a velocity robot.
    fn check_velocity_transformer(&self, entry: &TransformerEntry) -> Result<(), FileError> {
        let name = entry.transformer_name();
        let wrong = |key: &[&str], message: String, help: &str| {
            let own = ["profile", self.profile_name.as_str()];
            let key: Vec<&str> = own.iter().chain(key).copied().collect();
            Err(FileError::at_key(&self.robot.source, key, message, Some(help.to_owned())))
        };
        if entry.traits().needs_closed_loops {
            let message = format!(
                "transformer '{name}' inverts the measured closed loop of a position servo, which a velocity robot \
                 does not have"
            );
            let help = "use 'paper', 'emulation' or 'interpolating', with or without '+current'";
            return wrong(&[], message, help);
        }
        if self.profile.adapt_gains.is_some() {
            let message =
                format!("gains of velocity servos cannot be adapted, with transformer '{name}' or any other");
            return wrong(&["adapt_gains"], message, "omit adapt_gains; '+current' corrects wrong gains");
        }
        Ok(())
    }

    /// Checks the requirements of the chosen transformer on the robot.
    pub(crate) fn check_transformer(&self, name: &TransformerName) -> Result<(), FileError> {
        let (entry, robot) = (self.entry(name)?, &self.robot);
        let traits = entry.traits();
        let profile = |key: &[&str]| {
            let own = ["profile", &self.profile_name];
            own.iter().chain(key).map(|part| (*part).to_owned()).collect::<Vec<_>>()
        };
        let wrong = |key: Vec<String>, message: String, help: String| {
            Err(FileError::at_key(&robot.source, key, message, Some(help)))
        };
        if self.takes_velocities() {
            self.check_velocity_transformer(entry)?;
        }
        if traits.needs_current && !self.measures_current() {
            let message =
                format!("transformer '{name}' needs motor current, which this robot does not measure");
            let without = name.method();
            let help = format!("use '{without}', or add \"motor-current\" if the robot measures it");
            return wrong(vec!["interface".to_owned(), "measured".to_owned()], message, help);
        }
        if traits.needs_closed_loops && self.profile.identified.is_empty() {
            let message = format!(
                "transformer '{name}' needs the closed loop of each joint, which `opspace identify` measures"
            );
            let help = format!("add [profile.{}.identified.JOINT] for each joint", self.profile_name);
            return wrong(profile(&[]), message, help);
        }
        if self.profile.adapt_gains.is_some() && !traits.adapts_gains {
            let message = format!("gains cannot be adapted with transformer '{name}'");
            let help = "use 'emulation+current' or 'interpolating+current', or omit adapt_gains".to_owned();
            return wrong(profile(&["adapt_gains"]), message, help);
        }
        if self.profile.delay_servo_ticks.is_none() && (traits.needs_delay || traits.needs_current) {
            let message =
                format!("transformer '{name}' needs delay_servo_ticks, which this profile does not give");
            let help = "measure it, or use 'paper', which works with any delay".to_owned();
            return wrong(profile(&[]), message, help);
        }
        let observes = self.velocity_source() == VelocitySource::Observer;
        if observes && self.options.backend != CommandKind::Torque && self.profile.delay_servo_ticks.is_none()
        {
            let message =
                "the velocity observer needs delay_servo_ticks, which this profile does not give".to_owned();
            let help = "measure it, or use velocity = \"filter\"".to_owned();
            return wrong(profile(&["estimator", "velocity"]), message, help);
        }
        self.transformer().map(|_| ())
    }
}

//! Transformer of an experiment: choice with its reason, requirements on the robot, and construction.

use crate::files::controller_kind::ControllerKind;
use crate::files::source::FileError;
use crate::run::experiment::Experiment;
use nalgebra::DMatrix;
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_backend::{CommandKind, Measured, Setpoints};
use opspace_model::{Data, update};
use opspace_transformer::setpoint_limits::JointSetpointLimits;
use opspace_transformer::{
    ClosedLoopModel, CurrentFeedback, DeclaredProperties, DriveTiming, EmulatingTransformer, EmulationSetup,
    ExtrapolatingTransformer, ExtrapolationSetup, FrictionCompensation, FrictionCompensationParameters,
    FrictionLaw, GainAdaptationParameters, Gears, Identity, JointParameters, LiteralTransformer, Method,
    ObservedTransformer, PaperTransformer, ServoGains, ServoParameters, SetpointNoise, TorqueObjective,
    TorqueObserver, TorqueObserverSetup, Transformer, TransformerKind, VelocitySource, VelocityTransformer,
};
use std::f64::consts::TAU;

impl Experiment {
    /// Transformer in use, which converts torques to position or velocity setpoints; `None` if commands pass
    /// unchanged.
    #[must_use]
    pub fn transformer_kind(&self) -> Option<TransformerKind> {
        self.uses_transformer().then(|| self.chosen_transformer().0)
    }

    /// Reason for the choice of the transformer.
    #[must_use]
    pub fn transformer_reason(&self) -> Option<String> {
        self.uses_transformer().then(|| self.chosen_transformer().1)
    }

    fn uses_transformer(&self) -> bool {
        self.options.backend != CommandKind::Torque && self.options.controller == ControllerKind::Osc
    }

    pub(crate) fn chosen_transformer(&self) -> (TransformerKind, String) {
        if let Some(kind) = self.options.transformer {
            return (kind, "requested".to_owned());
        }
        if let Some(kind) = self.profile.transformer {
            return (kind, format!("set in profile '{}'", self.profile_name));
        }
        TransformerKind::best(&DeclaredProperties {
            takes: self.options.backend,
            setpoints: self.robot.file.interface.setpoints,
            delay_servo_ticks: self.profile.delay_servo_ticks,
            measures_current: self.measures_current(),
            gears: self.robot.gears(),
        })
    }

    pub(crate) fn measures_current(&self) -> bool {
        self.robot.file.interface.measured.contains(&Measured::MotorCurrent)
    }

    /// Builds the chosen transformer.
    ///
    /// # Errors
    /// A servo that the transformer cannot invert.
    pub(crate) fn transformer(&self) -> Result<Box<dyn Transformer>, FileError> {
        let observes = self.velocity_source() == VelocitySource::Observer;
        if self.options.backend == CommandKind::Torque {
            return Ok(if observes { Box::new(self.torque_observer()) } else { Box::new(Identity) });
        }
        let (TransformerKind { method, current }, _) = self.chosen_transformer();
        let joints = || self.robot.identified(&self.profile);
        let literal = |measured| {
            let transformer = LiteralTransformer::new(&joints(), measured, self.profile.period_s());
            transformer.map_err(|(joint, error)| self.joint_error("identified", joint, &error))
        };
        let plain: Box<dyn Transformer> = match method {
            Method::Paper if self.takes_velocities() => {
                Box::new(VelocityTransformer::new(self.servo_gains()?))
            }
            Method::Paper => Box::new(PaperTransformer::new(self.servo_gains()?)),
            Method::Identified => {
                let split = |(joint, of): (usize, &ClosedLoopModel)| {
                    of.split().map_err(|error| self.joint_error("identified", joint, &error))
                };
                let gains: Result<Vec<ServoGains>, FileError> =
                    joints().iter().enumerate().map(split).collect();
                Box::new(PaperTransformer::new(gains?))
            }
            Method::IdentifiedLiteral => Box::new(literal(true)?),
            Method::IdentifiedOpenLoop => Box::new(literal(false)?),
            Method::Extrapolation => {
                let extrapolating = ExtrapolatingTransformer::new(&self.extrapolation(current)?);
                Box::new(extrapolating.map_err(|(joint, e)| self.joint_error(self.servo_table(), joint, &e))?)
            }
            Method::Emulation => return self.emulating(TorqueObjective::IntervalMean, current),
            Method::Interpolating => return self.emulating(TorqueObjective::PerTick, current),
        };
        let converting: Box<dyn Transformer> = if current && method != Method::Extrapolation {
            let (ratio, delay) = (self.profile.servo_ticks_per_cycle.get(), self.profile.delay());
            Box::new(CurrentFeedback::new(plain, &self.robot.torque_limits(), ratio, delay))
        } else {
            plain
        };
        if !observes {
            return Ok(converting);
        }
        let observer = self.emulator(TorqueObjective::IntervalMean, false)?;
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
            CommandKind::Position => self.chosen_transformer().0.method.emulates_arm(),
        };
        let default = if by_default { VelocitySource::Observer } else { VelocitySource::Filter };
        self.profile.estimator.velocity.unwrap_or(default)
    }

    fn torque_observer(&self) -> TorqueObserver {
        let setup = TorqueObserverSetup {
            friction: self.whole_friction(),
            resolution_rad: self.robot.joints().iter().map(|j| j.rotor.resolution_rad()).collect(),
            period_s: self.profile.period_s(),
            delay_s: f64::from(self.profile.delay()) * self.profile.servo_period_s(),
            gravity_compensated_by: self.gravity_compensated_by(),
        };
        TorqueObserver::new(&setup, &self.robot.model)
    }

    /// Modelled friction of the joints, all of it, at the motion that they have and not at that of the references.
    fn whole_friction(&self) -> FrictionCompensation {
        let compensation = self.task.file.friction_compensation.clone();
        let whole = FrictionCompensationParameters {
            gain: NonNegative::literal(1.0),
            follows: match compensation.follows {
                FrictionLaw::Reference => FrictionLaw::Velocity,
                own => own,
            },
            ..compensation
        };
        FrictionCompensation::new(self.robot.joints().iter().map(|j| &j.friction), &whole)
    }

    fn emulating(&self, matching: TorqueObjective, current: bool) -> Result<Box<dyn Transformer>, FileError> {
        Ok(Box::new(self.emulator(matching, current)?))
    }

    fn emulator(&self, matching: TorqueObjective, current: bool) -> Result<EmulatingTransformer, FileError> {
        let emulating = EmulatingTransformer::new(&self.emulation(matching, current)?);
        emulating.map_err(|(joint, error)| self.joint_error(self.servo_table(), joint, &error))
    }

    fn takes_velocities(&self) -> bool {
        self.options.backend == CommandKind::Velocity
    }

    /// Name of the profile's table that contains the servos in use.
    fn servo_table(&self) -> &'static str {
        if self.takes_velocities() { "velocity_servo" } else { "servo" }
    }

    /// Error at a joint's entry in a table of the profile.
    fn joint_error(&self, table: &str, joint: usize, error: &dyn std::error::Error) -> FileError {
        let name = self.robot.model.joints()[joint].name.as_str();
        let help = "transformer = \"paper\" supports any servo, by its equivalent gains".to_owned();
        let key = ["profile", &self.profile_name, table, name];
        FileError::at_key(&self.robot.source, key, error.to_string(), Some(help))
    }

    fn emulation(&self, matching: TorqueObjective, current: bool) -> Result<EmulationSetup, FileError> {
        let joints = self.robot.joints();
        Ok(EmulationSetup {
            has_brakes: self.capabilities().has_brakes,
            servos: self.servos()?,
            friction: self.whole_friction(),
            resolution_rad: joints.iter().map(|j| j.rotor.resolution_rad()).collect(),
            inertias: self.inertias()?,
            torque_limits: self.robot.torque_limits(),
            servo_period_s: self.profile.servo_period_s(),
            servo_ticks_per_cycle: self.profile.servo_ticks_per_cycle.get(),
            delay: self.profile.delay(),
            setpoints: self.robot.file.interface.setpoints,
            matching,
            gravity_compensated_by: self.gravity_compensated_by(),
            current,
            adapt_gains: self.profile.adapt_gains,
        })
    }

    fn extrapolation(&self, current: bool) -> Result<ExtrapolationSetup, FileError> {
        Ok(ExtrapolationSetup {
            servos: self.servos()?,
            torque_limits: self.robot.torque_limits(),
            timing: self.drive_timing(),
            estimator: self.profile.estimator.clone(),
            gravity_compensated_by: self.gravity_compensated_by(),
            has_brakes: self.capabilities().has_brakes,
            gears: self.robot.gears(),
            antiresonance_hz: self.lowest_antiresonance_hz()?,
            setpoint_noise: self.setpoint_noise(),
            current: current.then(|| self.profile.adapt_gains.unwrap_or(GainAdaptationParameters::usual())),
        })
    }

    /// Timing of the drives.
    pub(crate) fn drive_timing(&self) -> DriveTiming {
        DriveTiming {
            servo_period_s: self.profile.servo_period_s(),
            servo_ticks_per_cycle: self.profile.servo_ticks_per_cycle.get(),
            delay: self.profile.delay(),
            setpoints: self.robot.file.interface.setpoints,
        }
    }

    /// Limits of the setpoints of each joint (n); empty if the drives have none.
    pub(crate) fn setpoint_limits(&self) -> Vec<JointSetpointLimits> {
        let Some(limits) = &self.profile.setpoint_limits else { return Vec::new() };
        let names = self.robot.model.joints().iter().map(|joint| &joint.name);
        names.map(|name| limits.joint.get(name).copied().unwrap_or_default()).collect()
    }

    /// Noise of positions that must not reach the setpoints, where drives limit their acceleration (n).
    fn setpoint_noise(&self) -> Vec<Option<SetpointNoise>> {
        let noise = |(limits, joint): (JointSetpointLimits, JointParameters)| {
            let acceleration_limit = limits.acceleration_rad_per_s2?.get();
            let declared = self.profile.estimator.position_noise_rad;
            // A rounding error is uniform over one count.
            let position_noise = declared.map_or(joint.rotor.resolution_rad() / 12f64.sqrt(), Positive::get);
            let jerk_limit = limits.jerk_rad_per_s3.map(Positive::get);
            Some(SetpointNoise { position_noise, acceleration_limit, jerk_limit })
        };
        self.setpoint_limits().into_iter().zip(self.robot.joints()).map(noise).collect()
    }

    /// Lowest frequency √(K/J)/2π of a link of inertia J on a gear of declared stiffness K, with its rotor and the other
    /// joints held at the start of the task, Hz; `None` if no stiffness is declared.
    fn lowest_antiresonance_hz(&self) -> Result<Option<f64>, FileError> {
        let model = &self.robot.model;
        let joints = self.robot.joints();
        if joints.iter().all(|joint| joint.gear_stiffness_nm_per_rad.is_none()) {
            return Ok(None);
        }
        let mass_matrix = self.data_at_start()?.mass_matrix;
        let antiresonances =
            joints.iter().zip(model.rotor_inertia()).enumerate().filter_map(|(i, (joint, rotor))| {
                let stiffness = joint.gear_stiffness_nm_per_rad?.get();
                Some((stiffness / (mass_matrix[(i, i)] - rotor)).sqrt() / TAU)
            });
        Ok(antiresonances.min_by(f64::total_cmp))
    }

    /// Inertia of each joint at the start of the task with the other joints free, 1/(M⁻¹)ᵢᵢ (n; kg m² or kg).
    fn inertias(&self) -> Result<Vec<f64>, FileError> {
        let n = self.robot.model.n();
        let mut inverse = DMatrix::identity(n, n);
        self.data_at_start()?.mass_matrix_factor.solve_matrix(&mut inverse);
        Ok(inverse.diagonal().iter().map(|mobility| 1.0 / mobility).collect())
    }

    /// Kinematics and dynamics at the start of the task, at rest.
    fn data_at_start(&self) -> Result<Data, FileError> {
        let (model, q) = (&self.robot.model, self.start()?);
        let mut data = Data::new(model);
        if !update(model, &mut data, &q, &vec![0.0; model.n()]) {
            let message = "the mass matrix is not positive definite at the start of the task";
            return Err(FileError::of_file(self.robot.urdf.name(), message, None));
        }
        Ok(data)
    }

    /// Servos of the robot, in joint order.
    ///
    /// # Errors
    /// A profile without servos of the required kind.
    pub(crate) fn servos(&self) -> Result<Vec<ServoParameters>, FileError> {
        self.robot.servos_for(&self.profile_name, self.command_kind())
    }

    pub(crate) fn servo_gains(&self) -> Result<Vec<ServoGains>, FileError> {
        let period_s = self.profile.servo_period_s();
        Ok(self.servos()?.iter().map(|servo| servo.gains(period_s)).collect())
    }

    /// Name of the first joint whose velocity loop has integral action, if any.
    fn joint_with_velocity_integral(&self) -> Option<&str> {
        let joints = self.robot.model.joints().iter().map(|joint| joint.name.as_str());
        let mut joints = joints.filter(|joint| {
            self.profile.velocity_servo.get(*joint).is_some_and(|servo| servo.ki_nm_per_rad.get() > 0.0)
        });
        joints.next()
    }

    /// Checks the transformer's additional requirements on a velocity robot.
    fn check_velocity_transformer(&self, kind: TransformerKind) -> Result<(), FileError> {
        let (name, method) = (kind.name(), kind.method);
        let wrong = |key: &[&str], message: String, help: &str| {
            let own = ["profile", self.profile_name.as_str()];
            let key: Vec<&str> = own.iter().chain(key).copied().collect();
            Err(FileError::at_key(&self.robot.source, key, message, Some(help.to_owned())))
        };
        if method.needs_identification() {
            let message = format!(
                "transformer '{name}' inverts the measured closed loop of a position servo, which a velocity robot \
                 does not have"
            );
            return wrong(
                &[],
                message,
                "use 'paper', 'emulation' or 'interpolating', with or without '+current'",
            );
        }
        if self.profile.adapt_gains.is_some() {
            let message =
                format!("gains of velocity servos cannot be adapted, with transformer '{name}' or any other");
            return wrong(&["adapt_gains"], message, "omit adapt_gains; '+current' corrects wrong gains");
        }
        match self.joint_with_velocity_integral() {
            Some(joint) if method == Method::Paper => {
                let message = format!(
                    "transformer '{name}' inverts only kv; the integral of the velocity servo of joint '{joint}' would \
                     add to every desired torque"
                );
                let help = "use 'emulation' or 'interpolating', which model the integral";
                wrong(&["velocity_servo", joint], message, help)
            }
            _ => Ok(()),
        }
    }

    /// Checks the transformer's requirements on the robot.
    pub(crate) fn check_transformer(&self, kind: TransformerKind) -> Result<(), FileError> {
        let (name, method, robot) = (kind.name(), kind.method, &self.robot);
        let interface = |key: &str| vec!["interface".to_owned(), key.to_owned()];
        let profile = |key: &[&str]| {
            let own = ["profile", &self.profile_name];
            own.iter().chain(key).map(|part| (*part).to_owned()).collect::<Vec<_>>()
        };
        let wrong = |key: Vec<String>, message: String, help: String| {
            Err(FileError::at_key(&robot.source, key, message, Some(help)))
        };
        if self.takes_velocities() {
            self.check_velocity_transformer(kind)?;
        }
        if kind.needs_current() && !self.measures_current() {
            let message =
                format!("transformer '{name}' needs motor current, which this robot does not measure");
            let without = name.trim_end_matches("+current");
            let help = format!("use '{without}', or add \"motor-current\" if the robot measures it");
            return wrong(interface("measured"), message, help);
        }
        if method == Method::Interpolating && robot.file.interface.setpoints == Setpoints::Held {
            let message = format!(
                "transformer '{name}' is for drives that interpolate setpoints, but these drives hold them"
            );
            let help =
                "use 'emulation', or set setpoints = \"interpolated\" if the drives interpolate".to_owned();
            return wrong(interface("setpoints"), message, help);
        }
        if method.needs_identification() && self.profile.identified.is_empty() {
            let message = format!(
                "transformer '{name}' needs the closed loop of each joint, which `opspace identify` measures"
            );
            let help = format!("add [profile.{}.identified.JOINT] for each joint", self.profile_name);
            return wrong(profile(&[]), message, help);
        }
        let literal = matches!(method, Method::IdentifiedLiteral | Method::IdentifiedOpenLoop);
        if literal && robot.model.n() > 1 {
            let message = format!(
                "transformer '{name}' assumes that only the motor moves the joint, which holds for a single joint; this \
                 robot has {} joints",
                robot.model.n()
            );
            let help = "use 'identified', which measures the velocity instead of predicting it".to_owned();
            return wrong(profile(&[]), message, help);
        }
        if self.profile.adapt_gains.is_some() && !(method.needs_delay() && kind.needs_current()) {
            let message = format!("gains cannot be adapted with transformer '{name}'");
            let help = "use 'emulation+current' or 'interpolating+current', or omit adapt_gains".to_owned();
            return wrong(profile(&["adapt_gains"]), message, help);
        }
        if self.profile.delay_servo_ticks.is_none() && (method.needs_delay() || kind.needs_current()) {
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

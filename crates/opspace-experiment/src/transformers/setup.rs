//! Setup of a transformer: the robot with its profile, at the start of a task.

use crate::files::robot::RobotDefinition;
use crate::files::source::FileError;
use crate::transformers::gain_interval::GainInterval;
use nalgebra::DMatrix;
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_backend::{CommandKind, GravityCompensation, Setpoints};
use opspace_model::{Data, Joint, Model, update};
use opspace_transformer::setpoint_limits::JointSetpointLimits;
use opspace_transformer::{
    ClosedLoopModel, CurrentFeedback, DriveTiming, EmulationSetup, EstimatorParameters, ExtrapolationSetup,
    FrictionCompensation, FrictionCompensationParameters, FrictionLaw, GainAdaptationParameters,
    JointParameters, ProfileParameters, RemainingDamping, ServoGains, ServoParameters, SetpointNoise,
    TorqueObjective, Transformer, TransformerName,
};
use std::f64::consts::TAU;

/// Robot for which a transformer is built, with its profile and the task's compensation of friction. Lists are in the order of
/// the model's joints (n).
#[derive(Clone, Debug)]
pub struct TransformerSetup<'a> {
    pub(crate) name: &'a TransformerName,
    pub(crate) robot: &'a RobotDefinition,
    pub(crate) profile_name: &'a str,
    pub(crate) profile: &'a ProfileParameters,
    pub(crate) takes: CommandKind,
    pub(crate) start: Vec<f64>,
    pub(crate) friction: &'a FrictionCompensationParameters,
}

impl TransformerSetup<'_> {
    /// Name under which the transformer is registered.
    #[must_use]
    pub fn name(&self) -> &TransformerName {
        self.name
    }

    /// Quantity of the setpoints that the robot accepts: position or velocity.
    #[must_use]
    pub fn takes(&self) -> CommandKind {
        self.takes
    }

    /// Rigid-body model of the robot, with rotors and tools.
    #[must_use]
    pub fn model(&self) -> &Model {
        &self.robot.model
    }

    /// Drives of the joints.
    #[must_use]
    pub fn joints(&self) -> Vec<JointParameters> {
        self.robot.joints()
    }

    /// Servos of the joints.
    ///
    /// # Errors
    /// A profile without servos of the required kind.
    pub fn servos(&self) -> Result<Vec<ServoParameters>, FileError> {
        self.robot.servos_for(self.profile_name, self.takes)
    }

    /// Equivalent gains of the servos.
    ///
    /// # Errors
    /// As [`servos`](Self::servos).
    pub fn servo_gains(&self) -> Result<Vec<ServoGains>, FileError> {
        let period_s = self.profile.servo_period_s();
        Ok(self.servos()?.iter().map(|servo| servo.gains(period_s)).collect())
    }

    /// Measured closed loops of the joints; empty if the profile has none.
    #[must_use]
    pub fn closed_loops(&self) -> Vec<ClosedLoopModel> {
        self.robot.identified(self.profile)
    }

    /// Largest torques of the drives, Nm (N).
    #[must_use]
    pub fn torque_limits(&self) -> Vec<f64> {
        self.robot.torque_limits()
    }

    /// Timing of the drives.
    #[must_use]
    pub fn timing(&self) -> DriveTiming {
        drive_timing(self.robot, self.profile)
    }

    /// Estimator of the joint velocities.
    #[must_use]
    pub fn estimator(&self) -> &EstimatorParameters {
        &self.profile.estimator
    }

    /// Limits of the setpoints of each joint (n); empty if the drives have none.
    #[must_use]
    pub fn setpoint_limits(&self) -> Vec<JointSetpointLimits> {
        setpoint_limits(self.robot, self.profile)
    }

    /// Modelled friction of the joints, all of it, at the motion that they have and not at that of the references.
    #[must_use]
    pub fn whole_friction(&self) -> FrictionCompensation {
        let compensation = self.friction.clone();
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

    /// Inertia of each joint at the start of the task with the other joints free, 1/(M⁻¹)ᵢᵢ (n; kg m² or kg).
    ///
    /// # Errors
    /// A mass matrix that is not positive definite.
    pub fn inertias(&self) -> Result<Vec<f64>, FileError> {
        let n = self.robot.model.n();
        let mut inverse = DMatrix::identity(n, n);
        self.data_at_start()?.mass_matrix_factor.solve_matrix(&mut inverse);
        Ok(inverse.diagonal().iter().map(|mobility| 1.0 / mobility).collect())
    }

    /// Setup of a transformer that emulates the arm.
    ///
    /// # Errors
    /// As [`servos`](Self::servos) and [`inertias`](Self::inertias).
    pub fn emulation(&self, matching: TorqueObjective, current: bool) -> Result<EmulationSetup, FileError> {
        let joints = self.robot.joints();
        Ok(EmulationSetup {
            has_brakes: self.has_brakes(),
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
            remaining_damping: self.remaining_damping(current)?,
            gravity_compensated_by: self.gravity_compensated_by(),
            current,
            adapt_gains: self.profile.adapt_gains,
        })
    }

    /// Setup of a transformer that extrapolates the joints.
    ///
    /// # Errors
    /// As [`servos`](Self::servos) and [`inertias`](Self::inertias).
    pub fn extrapolation(&self, current: bool) -> Result<ExtrapolationSetup, FileError> {
        Ok(ExtrapolationSetup {
            servos: self.servos()?,
            torque_limits: self.robot.torque_limits(),
            timing: self.timing(),
            estimator: self.profile.estimator.clone(),
            gravity_compensated_by: self.gravity_compensated_by(),
            has_brakes: self.has_brakes(),
            gears: self.robot.gears(),
            antiresonance_hz: self.lowest_antiresonance_hz()?,
            setpoint_noise: self.setpoint_noise(),
            remaining_damping: self.remaining_damping(current)?,
            current: current.then(|| self.profile.adapt_gains.unwrap_or(GainAdaptationParameters::usual())),
        })
    }

    /// Damping that is left to each joint (n), so that no gains of their intervals drive it; zero if measured
    /// `current` corrects them.
    ///
    /// # Errors
    /// As [`servos`](Self::servos).
    pub fn remaining_damping(&self, current: bool) -> Result<Vec<RemainingDamping>, FileError> {
        if current {
            return Ok(vec![RemainingDamping::default(); self.robot.model.n()]);
        }
        let limits = self.torque_limits().into_iter().zip(self.robot.model.joints());
        let least =
            |((servo, interval), (torque, joint)): ((&ServoParameters, GainInterval), (f64, &Joint))| {
                let width = interval.half_width;
                servo.remaining_damping(width).with_limits(width, torque, joint.limits.velocity)
            };
        Ok(self.servos()?.iter().zip(self.gain_intervals()?).zip(limits).map(least).collect())
    }

    /// Mean time from a measurement until the setpoint acts that is computed from it, s; the longest one if the delay of setpoints
    /// is unknown.
    #[must_use]
    pub fn setpoints_act_after_s(&self) -> f64 {
        let profile = self.profile;
        let ratio = profile.servo_ticks_per_cycle.get();
        let delay = profile.delay_servo_ticks.unwrap_or(ratio);
        let half = 0.5 * f64::from(ratio - 1);
        let halves = match self.robot.file.interface.setpoints {
            Setpoints::Held => half,
            // A setpoint is reached at the end of its interval.
            Setpoints::Interpolated => 2.0 * half,
        };
        (f64::from(delay) + halves) * profile.servo_period_s()
    }

    /// Intervals of the true gains of the servos (n).
    ///
    /// # Errors
    /// As [`servos`](Self::servos).
    pub fn gain_intervals(&self) -> Result<Vec<GainInterval>, FileError> {
        let place = [self.profile_name, self.servo_table()];
        let of = |(joint, servo): (&Joint, &ServoParameters)| {
            GainInterval::of(self.robot, place, &joint.name, servo)
        };
        Ok(self.robot.model.joints().iter().zip(&self.servos()?).map(of).collect())
    }

    /// Returns a transformer whose torques measured motor current corrects.
    #[must_use]
    pub fn with_current_feedback(&self, plain: Box<dyn Transformer>) -> Box<dyn Transformer> {
        let (ratio, delay) = (self.profile.servo_ticks_per_cycle.get(), self.profile.delay());
        Box::new(CurrentFeedback::new(plain, &self.torque_limits(), ratio, delay))
    }

    /// Error for a robot that the transformer does not suit, at its profile.
    #[must_use]
    pub fn refused(&self, message: String, help: &str) -> FileError {
        self.refused_at(&[], message, help)
    }

    /// Error for a joint's entry in a table of the profile, for example `servo`.
    #[must_use]
    pub fn joint_error(&self, table: &str, joint: usize, error: &dyn std::error::Error) -> FileError {
        let name = self.robot.model.joints()[joint].name.as_str();
        let help = "transformer = \"paper\" supports any servo, by its equivalent gains";
        self.refused_at(&[table, name], error.to_string(), help)
    }

    /// Error at a key of the profile.
    pub(crate) fn refused_at(&self, key: &[&str], message: String, help: &str) -> FileError {
        let own = ["profile", self.profile_name];
        let key: Vec<&str> = own.iter().chain(key).copied().collect();
        FileError::at_key(&self.robot.source, key, message, Some(help.to_owned()))
    }

    /// Name of the profile's table that contains the servos in use.
    pub(crate) fn servo_table(&self) -> &'static str {
        if self.takes == CommandKind::Velocity { "velocity_servo" } else { "servo" }
    }

    fn gravity_compensated_by(&self) -> GravityCompensation {
        self.robot.file.interface.gravity_compensated_by
    }

    fn has_brakes(&self) -> bool {
        self.robot.capabilities(self.takes, self.profile.period_s()).has_brakes
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

    /// Kinematics and dynamics at the start of the task, at rest.
    fn data_at_start(&self) -> Result<Data, FileError> {
        let model = &self.robot.model;
        let mut data = Data::new(model);
        if !update(model, &mut data, &self.start, &vec![0.0; model.n()]) {
            let message = "the mass matrix is not positive definite at the start of the task";
            return Err(FileError::of_file(self.robot.urdf.name(), message, None));
        }
        Ok(data)
    }

    /// Name of the first joint whose velocity loop has integral action, if any.
    pub(crate) fn joint_with_velocity_integral(&self) -> Option<&str> {
        let joints = self.robot.model.joints().iter().map(|joint| joint.name.as_str());
        let mut joints = joints.filter(|joint| {
            self.profile.velocity_servo.get(*joint).is_some_and(|servo| servo.ki_nm_per_rad.get() > 0.0)
        });
        joints.next()
    }
}

/// Timing of the drives of a profile.
pub(crate) fn drive_timing(robot: &RobotDefinition, profile: &ProfileParameters) -> DriveTiming {
    DriveTiming {
        servo_period_s: profile.servo_period_s(),
        servo_ticks_per_cycle: profile.servo_ticks_per_cycle.get(),
        delay: profile.delay(),
        setpoints: robot.file.interface.setpoints,
    }
}

/// Limits of the setpoints of each joint (n); empty if the drives have none.
pub(crate) fn setpoint_limits(
    robot: &RobotDefinition,
    profile: &ProfileParameters,
) -> Vec<JointSetpointLimits> {
    let Some(limits) = &profile.setpoint_limits else { return Vec::new() };
    let names = robot.model.joints().iter().map(|joint| &joint.name);
    names.map(|name| limits.joint.get(name).copied().unwrap_or_default()).collect()
}

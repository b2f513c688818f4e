//! Parameters of the force feedback of a Cartesian task, for files and code.

use crate::error::{ControlError, Reason};
use crate::tasks::admittance::AdmittanceLimits;
use crate::tasks::axes::{AXIS_NAMES, Axes, PerAxis};
use crate::tasks::gain_profile::check_points;
use nalgebra::Vector6;
use opspace_backend::quantity::{Fraction, NonNegative, Positive};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Feedback of a force sensor to the compliant and force axes.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct ForceParameters {
    /// Name of the robot's force sensor.
    pub sensor: String,
    /// Force that the environment should exert ON the robot along these axes, N.
    #[serde(default = "no_target")]
    pub target_n: PerAxis<f64>,
    /// Moment that the environment should exert ON the robot about these axes, Nm.
    #[serde(default = "no_target")]
    pub target_nm: PerAxis<f64>,
    /// Target forces of force axes as functions of time, instead of `target_n`: for each axis a list of times (s, since the
    /// task began) and forces (N), with minimum-jerk ramps between them.
    #[serde(default)]
    pub profile_n: ForceProfiles,
    /// Time over which the target of a force axis ramps in from the sensed force at the start and at contact, and from the
    /// previous target at an event, s. Streamed targets apply at once.
    #[serde(default = "default_ramp_s")]
    pub ramp_s: NonNegative,
    /// Fraction of the target that is commanded in open loop.
    #[serde(default = "whole_target")]
    pub feed_forward: PerAxis<Fraction>,
    /// Gain of the force error; by default 2 on compliant axes, and on force axes 1, or 2 ms per control period if that is
    /// less.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "depends on the mode and the control period")))]
    pub gain: Option<PerAxis<NonNegative>>,
    /// Integral gain of a force axis, 1/s: fraction of the force error that is added to the force per second.
    #[cfg_attr(feature = "schema", schemars(extend("default" = INTEGRAL_PER_S)))]
    pub integral_per_s: Option<PerAxis<NonNegative>>,
    /// Upper bound of the integral of a force axis, which prevents windup without contact, N or Nm.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "the largest magnitude of the target")))]
    pub integral_limit: Option<PerAxis<NonNegative>>,
    /// Damping of a force axis (acceleration per velocity), 1/s. It keeps stiff contact stable: see the rule in the
    /// documentation of tasks.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = format!("{FORCE_DAMPING_PER_S}, or {FORCE_DAMPING_PER_PERIOD} per control period if that is less"))))]
    pub damping_per_s: Option<PerAxis<NonNegative>>,
    /// −3 dB frequency of the low-pass filter of the sensed force, Hz.
    #[serde(default = "default_filter_hz")]
    pub filter_hz: Positive,
    /// Fraction of the sensed force that is compensated on motion axes, for example the friction of a surface along which
    /// the frame slides. Stiff contact along such an axis is unstable with it.
    #[cfg_attr(feature = "schema", schemars(extend("default" = 0.0)))]
    pub sensed_compensation: Option<PerAxis<Fraction>>,
    /// Surface on which the stability of the contact is examined before a run.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the simulated environment")))]
    pub surface: Option<SurfaceParameters>,
    /// Approach of force axes until contact is made; without it, force control begins at once.
    pub contact: Option<ContactParameters>,
    /// Passivity control of the force feedback of force axes.
    #[serde(default)]
    pub passivity: PassivityParameters,
    /// Damping B of the admittance of compliant and force axes, Ns/m: the commanded position moves with the force error
    /// divided by B. Only for inverse kinematics, whose force axes need it; a compliant axis without it holds its
    /// reference there.
    pub admittance_ns_per_m: Option<PerAxis<Positive>>,
    /// Damping of the admittance of compliant and force axes of rotation, Nms/rad. Only for inverse kinematics.
    pub admittance_nms_per_rad: Option<PerAxis<Positive>>,
    /// Limits of the motion by admittance.
    #[serde(default)]
    pub admittance_limits: AdmittanceLimits,
}

/// Target forces of force axes as functions of time, N.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ForceProfiles {
    /// Times (s) and forces (N) along the first task axis.
    #[serde(default)]
    pub x: Vec<[f64; 2]>,
    /// Times (s) and forces (N) along the second task axis.
    #[serde(default)]
    pub y: Vec<[f64; 2]>,
    /// Times (s) and forces (N) along the third task axis.
    #[serde(default)]
    pub z: Vec<[f64; 2]>,
}

/// Surface that a force axis will touch.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct SurfaceParameters {
    /// Stiffness along the axis, N/m.
    pub stiffness_n_per_m: Positive,
    /// Damping along the axis, Ns/m.
    #[serde(default)]
    pub damping_ns_per_m: NonNegative,
}

/// Approach of a force axis with a target: it moves against the desired force until the environment is touched, and again when
/// contact is lost.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct ContactParameters {
    /// Speed of the approach, m/s.
    pub approach_m_per_s: Positive,
    /// Sensed force above which contact is made, N.
    pub made_above_n: Positive,
    /// Sensed force below which contact is lost, N.
    pub lost_below_n: NonNegative,
    /// Time for which the force must be below `lost_below_n` before the axis approaches again, s.
    pub lost_after_s: NonNegative,
}

impl Default for ContactParameters {
    fn default() -> Self {
        Self {
            approach_m_per_s: Positive::literal(0.05),
            made_above_n: Positive::literal(2.0),
            lost_below_n: NonNegative::literal(0.5),
            lost_after_s: NonNegative::literal(0.05),
        }
    }
}

/// Passivity observer and controller of the force feedback of one axis.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct PassivityParameters {
    /// True if the gains are reduced when the feedback gives too much energy to the motion.
    pub enabled: bool,
    /// Energy that the feedback may give to the motion within the window before its gains are reduced, J.
    pub store_j: Positive,
    /// Time over which given energy is forgotten, s.
    pub window_s: Positive,
    /// Time over which reduced gains return, s. After a single impact it is a twentieth of this.
    pub recovery_s: Positive,
}

impl Default for PassivityParameters {
    fn default() -> Self {
        Self {
            enabled: true,
            store_j: Positive::literal(0.02),
            window_s: Positive::literal(0.25),
            recovery_s: Positive::literal(10.0),
        }
    }
}

const fn no_target() -> PerAxis<f64> {
    PerAxis::All(0.0)
}

const fn default_ramp_s() -> NonNegative {
    NonNegative::literal(0.1)
}

const fn whole_target() -> PerAxis<Fraction> {
    PerAxis::All(Fraction::literal(1.0))
}

const fn default_filter_hz() -> Positive {
    Positive::literal(100.0)
}

/// Default gain of the force error on compliant axes.
pub(crate) const COMPLIANT_GAIN: f64 = 2.0;

/// Largest default gain of the force error on force axes, and its product with the control period, s: the stable gain
/// falls with the delay of the loop.
const FORCE_GAIN: f64 = 1.0;
const FORCE_GAIN_PERIOD_S: f64 = 0.002;

/// Default integral gain of force axes, 1/s.
pub(crate) const INTEGRAL_PER_S: f64 = 20.0;

/// Largest default damping of force axes, 1/s, and its product with the control period: beyond, the delay of the loop
/// turns damping into its opposite.
const FORCE_DAMPING_PER_S: f64 = 120.0;
const FORCE_DAMPING_PER_PERIOD: f64 = 0.6;

/// Default damping of force axes with a control period of `period_s` (s), 1/s.
pub(crate) fn default_force_damping(period_s: f64) -> f64 {
    f64::min(FORCE_DAMPING_PER_S, FORCE_DAMPING_PER_PERIOD / period_s)
}

impl ForceParameters {
    /// Returns the feedback of a sensor, by name, without a target force and with the other defaults of files.
    #[must_use]
    pub fn new(sensor: impl Into<String>) -> Self {
        Self {
            sensor: sensor.into(),
            target_n: no_target(),
            target_nm: no_target(),
            profile_n: ForceProfiles::default(),
            ramp_s: default_ramp_s(),
            feed_forward: whole_target(),
            gain: None,
            integral_per_s: None,
            integral_limit: None,
            damping_per_s: None,
            filter_hz: default_filter_hz(),
            sensed_compensation: None,
            surface: None,
            contact: None,
            passivity: PassivityParameters::default(),
            admittance_ns_per_m: None,
            admittance_nms_per_rad: None,
            admittance_limits: AdmittanceLimits::default(),
        }
    }

    /// Force (N) and moment (Nm) that the environment should exert ON the robot, in the task axes; 0 on axes that are
    /// neither compliant nor in force control. With a profile it is the last force.
    #[must_use]
    pub fn target(&self, axes: &Axes) -> Vector6<f64> {
        let held = axes.force_axes();
        Vector6::from_fn(|axis, _| if held[axis] { self.target_of(axis) } else { 0.0 })
    }

    /// Target of an axis, N or Nm.
    pub(crate) fn target_of(&self, axis: usize) -> f64 {
        let targets = if axis < 3 { &self.target_n } else { &self.target_nm };
        self.profile_n.of(axis).last().map_or(targets.get(axis).unwrap_or(0.0), |&[_, force]| force)
    }

    /// Largest magnitude of an axis' target, N or Nm.
    #[must_use]
    pub fn largest_target(&self, axis: usize) -> f64 {
        let of_profile = self.profile_n.of(axis).iter().map(|&[_, force]| force.abs());
        of_profile.fold(self.target_of(axis).abs(), f64::max)
    }

    /// Damping of a force axis with a control period of `period_s` (s), 1/s.
    #[must_use]
    pub fn damping(&self, axis: usize, period_s: f64) -> f64 {
        let given = self.damping_per_s.and_then(|damping| damping.get(axis));
        given.map_or_else(|| default_force_damping(period_s), NonNegative::get)
    }

    /// Gain of the force error on a force axis with a control period of `period_s` (s).
    #[must_use]
    pub fn force_gain(&self, axis: usize, period_s: f64) -> f64 {
        let given = self.gain.and_then(|gain| gain.get(axis));
        given.map_or_else(|| f64::min(FORCE_GAIN, FORCE_GAIN_PERIOD_S / period_s), NonNegative::get)
    }

    /// Integral gain of the force error, 1/s.
    #[must_use]
    pub fn integral(&self, axis: usize) -> f64 {
        self.integral_per_s.and_then(|integral| integral.get(axis)).map_or(INTEGRAL_PER_S, NonNegative::get)
    }

    /// Checks the profiles. `key` is the path of the parameters in the file.
    pub(crate) fn check_profiles(&self, in_force_control: [bool; 6], key: &str) -> Result<(), ControlError> {
        for axis in 0..3 {
            let profile = self.profile_n.of(axis);
            let key = format!("{key}.profile_n.{}", AXIS_NAMES[axis]);
            if profile.is_empty() {
                continue;
            }
            if !in_force_control[axis] {
                return Err(ControlError::new(key, Reason::ProfileAxis));
            }
            check_points(profile).map_err(|message| ControlError::value(&key, message))?;
        }
        Ok(())
    }
}

impl ForceProfiles {
    /// Times (s) and forces (N) along an axis; none about an axis.
    pub(crate) fn of(&self, axis: usize) -> &[[f64; 2]] {
        match axis {
            0 => &self.x,
            1 => &self.y,
            2 => &self.z,
            _ => &[],
        }
    }
}

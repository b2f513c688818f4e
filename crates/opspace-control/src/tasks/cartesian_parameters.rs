//! Parameters of a Cartesian task, for files and code.

use crate::axis_mode::AxisMode;
use crate::error::{ControlError, Reason};
use crate::references::joint_reference::check_times;
use crate::references::path_motion::PathMotion;
use crate::references::reference::CartesianReference;
use crate::tasks::axes::{Axes, AxesFrameParameter, PerAxis};
use crate::tasks::controlled_frame::ControlledFrame;
use crate::tasks::damping_zone::DampingZone;
use crate::tasks::force_parameters::ForceParameters;
use crate::tasks::gains::AxisGains;
use crate::tasks::impedance::ImpedanceParameters;
use crate::tasks::singular_escape::SingularEscape;
use crate::tasks::task::DEFAULT_INVERSION;
use crate::tasks::when_limited::WhenLimited;
use nalgebra::Vector6;
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_model::{Inversion, Model};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Damping of compliant axes for which the file gives none, 1/s.
pub(crate) const COMPLIANT_DAMPING_PER_S: f64 = 2.0;

/// A frame follows a reference on some axes and is compliant on others.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct CartesianParameters {
    /// The controlled frame: a link of the URDF.
    pub frame: String,
    /// Frame in whose coordinates pose and reference are given; it can move too.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "the world")))]
    pub relative_to: Option<String>,
    /// Modes of the axes.
    pub axes: Axes,
    /// Directions of the axes: `"world"`, `"base"`, `"task-frame"`, `{ frame = "NAME" }`, or `{ rpy_rad = [...] }`
    /// relative to the world.
    #[serde(default)]
    pub axes_frame: AxesFrameParameter,
    /// Reference of the frame.
    pub reference: CartesianReference,
    /// True if a program can change gains, modes of the axes and target forces during the run, as it can with a streamed
    /// reference; the reference stays that of the file.
    #[serde(default)]
    pub tunable: bool,
    /// Gains of the motion axes, for unit mass.
    pub gains: Option<AxisGains>,
    /// Impedance of the motion axes, as a spring and a damper; instead of `gains`.
    pub impedance: Option<ImpedanceParameters>,
    /// Force feedback of the compliant and force axes. Without it, the force on compliant axes is zero, in open loop.
    pub force: Option<ForceParameters>,
    /// Damping of the compliant axes (acceleration per velocity), 1/s. That of force axes is `force.damping_per_s`.
    #[cfg_attr(feature = "schema", schemars(extend("default" = COMPLIANT_DAMPING_PER_S)))]
    pub compliant_damping_per_s: Option<PerAxis<NonNegative>>,
    /// Inertia that converts accelerations to forces.
    #[serde(default)]
    pub decoupling: Decoupling,
    /// Highest speed along the motion axes, m/s; unlimited if absent.
    pub speed_limit_m_per_s: Option<Positive>,
    /// Highest speed about the motion axes, rad/s; unlimited if absent.
    pub speed_limit_rad_per_s: Option<Positive>,
    /// Handling of singular directions, in which the arm can hardly move the frame.
    #[serde(default)]
    pub singularities: SingularityHandling,
    /// Threshold of the mobility (eigenvalue of Λ⁻¹) below which directions are damped, relative to the median of the
    /// lowest mobility over many postures. If absent, `damping_zone` applies.
    pub singularity_threshold: Option<Positive>,
    /// Zone below which directions are damped, growing with the demand; instead of `singularity_threshold`.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "`{}` without `singularity_threshold`")))]
    pub damping_zone: Option<DampingZone>,
    /// Behaviour of a task that rests in an exactly singular pose because the goal is along the lost direction: `"none"`
    /// (stay there) or `"nullspace-step"`: the arm moves in the null space, at up to 0.5 rad/s, to where it can go to the
    /// goal. Only for torque control.
    #[serde(default)]
    pub escape: SingularEscape,
    /// Characteristic length that scales rotations to displacements in the detection of singular directions, m.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "the arm's reach")))]
    pub characteristic_length_m: Option<Positive>,
    /// Weight of each axis when limits are in force: a deviation of its acceleration counts this many times in the task's
    /// kinetic energy, so that limits take from axes of small weight first. Translations and rotations are compared by
    /// their energy, not by metres and radians. A weight of ten is as strong as keeping the direction
    /// (`limits.lateral_weight`). The largest is at most 100 times the smallest. Without an active limit, weights change
    /// nothing.
    #[serde(default = "equal_weights")]
    pub weight: PerAxis<Positive>,
    /// Change of the acceleration that limits do not allow.
    #[serde(default)]
    pub when_limited: WhenLimited,
}

/// The centre of mass follows a reference on some axes. It has no orientation.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct CenterOfMassParameters {
    /// Modes of x, y and z.
    pub axes: Axes,
    /// Directions of the axes, as in a Cartesian task.
    #[serde(default)]
    pub axes_frame: AxesFrameParameter,
    /// Reference of the centre of mass.
    pub reference: CartesianReference,
    /// True if a program can change gains and modes of the axes during the run, as it can with a streamed reference; the
    /// reference stays that of the file.
    #[serde(default)]
    pub tunable: bool,
    /// Gains of the centre of mass, for unit mass.
    pub gains: AxisGains,
    /// Threshold of the mobility (eigenvalue of Λ⁻¹) below which directions are damped, relative to the median of the
    /// lowest mobility over many postures. If absent, `damping_zone` applies.
    pub singularity_threshold: Option<Positive>,
    /// Zone below which directions are damped, growing with the demand; instead of `singularity_threshold`.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "`{}` without `singularity_threshold`")))]
    pub damping_zone: Option<DampingZone>,
    /// Behaviour of a task that rests in an exactly singular pose because the goal is along the lost direction: `"none"`
    /// (stay there) or `"nullspace-step"`: the arm moves in the null space, at up to 0.5 rad/s, to where it can go to the
    /// goal. Only for torque control.
    #[serde(default)]
    pub escape: SingularEscape,
    /// Weight of each axis when limits are in force: a deviation of its acceleration counts this many times in the task's
    /// kinetic energy, so that limits take from axes of small weight first. A weight of ten is as strong as keeping the
    /// direction (`limits.lateral_weight`). The largest is at most 100 times the smallest. Without an active limit, weights
    /// change nothing.
    #[serde(default = "equal_weights")]
    pub weight: PerAxis<Positive>,
    /// Change of the acceleration that limits do not allow.
    #[serde(default)]
    pub when_limited: WhenLimited,
}

/// Inertia that converts a task's accelerations to forces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
#[non_exhaustive]
pub enum Decoupling {
    /// Λ of the arm: all axes are decoupled.
    #[default]
    Full,
    /// Λ of the arm with a lower bound on the joint inertias: larger forces for light wrists, whose friction exceeds
    /// the torques that their own inertia requires.
    Bounded {
        /// Lower bound of the diagonal of M, kg m².
        inertia_floor_kg_m2: Positive,
    },
}

/// Handling of directions in which an arm can hardly move a frame; see [`Inversion`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "schema", schemars(rename = "Singularities"))]
#[non_exhaustive]
pub enum SingularityHandling {
    /// Directions are damped smoothly below the threshold, and motion along them is braked; above it there is no
    /// damping.
    #[default]
    Damped,
    /// No damping: Λ is unchanged. For comparisons.
    #[serde(rename = "plain")]
    None,
    /// Damped least squares: all directions are damped in all configurations. For comparisons.
    #[serde(rename = "least-squares")]
    DampedLeastSquares,
    /// The condition number of Λ is clamped: torques still act in singular directions. For comparisons.
    #[serde(rename = "clamped")]
    ClampedCondition,
}

impl SingularityHandling {
    pub(crate) fn inversion(self, threshold: Option<Positive>) -> Inversion {
        let threshold = threshold.map(Positive::get);
        let fixed = threshold.unwrap_or(DEFAULT_INVERSION.threshold());
        match self {
            Self::Damped => threshold.map_or(DEFAULT_INVERSION, Inversion::Damped),
            Self::None => Inversion::Plain,
            Self::DampedLeastSquares => Inversion::LeastSquares(fixed),
            Self::ClampedCondition => Inversion::Clamped(fixed),
        }
    }
}

fn equal_weights() -> PerAxis<Positive> {
    PerAxis::All(Positive::literal(1.0))
}

impl CartesianParameters {
    /// Creates a task of `frame` that holds its start pose; all other parameters have the default values of files.
    #[must_use]
    pub fn new(frame: impl Into<String>, axes: Axes, gains: AxisGains) -> Self {
        Self {
            frame: frame.into(),
            relative_to: None,
            axes,
            axes_frame: AxesFrameParameter::World,
            reference: CartesianReference::Hold,
            tunable: false,
            gains: Some(gains),
            impedance: None,
            force: None,
            compliant_damping_per_s: None,
            decoupling: Decoupling::Full,
            speed_limit_m_per_s: None,
            speed_limit_rad_per_s: None,
            singularities: SingularityHandling::Damped,
            singularity_threshold: None,
            damping_zone: None,
            escape: SingularEscape::None,
            characteristic_length_m: None,
            weight: equal_weights(),
            when_limited: WhenLimited::LeastSquares,
        }
    }

    /// Sets the reference.
    #[must_use]
    pub fn with_reference(self, reference: CartesianReference) -> Self {
        Self { reference, ..self }
    }

    /// Returns true for each axis that follows the reference, in the order of [`AXIS_NAMES`](crate::AXIS_NAMES).
    #[must_use]
    pub fn motion_axes(&self) -> [bool; 6] {
        self.axes.with_mode(AxisMode::Motion)
    }

    /// Returns true for each compliant or force axis, in the order of [`AXIS_NAMES`](crate::AXIS_NAMES).
    #[must_use]
    pub fn force_axes(&self) -> [bool; 6] {
        self.axes.force_axes()
    }

    /// Resolves the controlled frame for a robot.
    ///
    /// # Errors
    /// An unknown frame, with its key in the file.
    pub fn controlled_frame(&self, model: &Model) -> Result<ControlledFrame, ControlError> {
        let frame =
            |key: &str, name: &str| model.frame_id(name).map_err(|unknown| ControlError::new(key, unknown));
        let led = frame("frame", &self.frame)?;
        Ok(match &self.relative_to {
            None => ControlledFrame::Frame(led),
            Some(name) => ControlledFrame::Relative { frame: led, from: frame("relative_to", name)? },
        })
    }

    /// Force (N) and moment (Nm) that the environment should exert ON the robot, in the task axes; 0 on other than
    /// compliant and force axes, and without force feedback.
    #[must_use]
    pub fn target_force(&self) -> Vector6<f64> {
        self.force.as_ref().map_or_else(Vector6::zeros, |force| force.target(&self.axes))
    }

    /// Inversion of Λ⁻¹ near singular directions. `key` is the path of the task in the file.
    pub(crate) fn inversion(&self, key: &str) -> Result<Inversion, ControlError> {
        if self.escape != SingularEscape::None && self.singularities != SingularityHandling::Damped {
            let message = "an escape needs the damping of singular directions: remove `singularities`, which has a method \
                           for comparisons"
                .to_owned();
            return Err(ControlError::value(&format!("{key}.escape"), message));
        }
        let threshold = self.singularity_threshold;
        let Some(zone) = &self.damping_zone else { return Ok(self.singularities.inversion(threshold)) };
        zone.check(threshold.is_some() || self.singularities != SingularityHandling::Damped, key)?;
        Ok(zone.inversion())
    }

    /// Returns true if a desired inertia is given.
    pub(crate) fn shapes_inertia(&self) -> bool {
        self.impedance.as_ref().is_some_and(|i| i.inertia_kg.is_some() || i.inertia_kg_m2.is_some())
    }
}

impl CenterOfMassParameters {
    /// Creates a task that holds the centre of mass at its start position.
    #[must_use]
    pub fn new(axes: Axes, gains: AxisGains) -> Self {
        Self {
            axes,
            axes_frame: AxesFrameParameter::World,
            reference: CartesianReference::Hold,
            tunable: false,
            gains,
            singularity_threshold: None,
            damping_zone: None,
            escape: SingularEscape::None,
            weight: equal_weights(),
            when_limited: WhenLimited::LeastSquares,
        }
    }

    /// Returns the parameters of the equivalent Cartesian task, whose frame is the centre of mass.
    #[must_use]
    pub fn as_cartesian(&self) -> CartesianParameters {
        CartesianParameters {
            axes_frame: self.axes_frame.clone(),
            reference: self.reference.clone(),
            tunable: self.tunable,
            singularity_threshold: self.singularity_threshold,
            damping_zone: self.damping_zone,
            escape: self.escape,
            weight: self.weight,
            when_limited: self.when_limited,
            ..CartesianParameters::new(String::new(), self.axes, self.gains)
        }
    }
}

pub(crate) fn check_reference(parameters: &CartesianParameters, key: &str) -> Result<(), ControlError> {
    match &parameters.reference {
        CartesianReference::Hold
        | CartesianReference::Sinusoid(_)
        | CartesianReference::Goal(_)
        | CartesianReference::Streamed(_) => {}
        CartesianReference::Path(path) => {
            PathMotion::new(path, &format!("{key}.path"))?;
        }
        CartesianReference::Recorded(path) => {
            if !path.is_read() {
                return Err(ControlError::new(format!("{key}.recorded"), Reason::NotRead));
            }
        }
        CartesianReference::PointToPoint(p) => {
            if p.position.is_none() && p.orientation.is_none() {
                return Err(ControlError::new(format!("{key}.point-to-point"), Reason::NoGoal));
            }
        }
        CartesianReference::Waypoints(list) => {
            let key = format!("{key}.waypoints");
            check_times(list.iter().map(|w| w.time_s.get()), &key)?;
            if list.iter().any(|w| w.position.is_none() && w.orientation.is_none()) {
                return Err(ControlError::new(key, Reason::NoGoal));
            }
        }
    }
    let turnable = parameters.axes.active_axes()[3..].contains(&true);
    if parameters.reference.turns() && !turnable {
        return Err(ControlError::new(key, Reason::OrientationOfFreeAxes));
    }
    Ok(())
}

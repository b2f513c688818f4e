//! Parameters of a task that is coupled with a task of another robot: `[task.NAME.coupled]`.

use crate::port_passivity::PortPassivityParameters;
use opspace_backend::quantity::{NonNegative, Positive, exactly};
use opspace_control::{AXIS_NAMES, Sinusoid};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A frame, or some joints, coupled with a task of another robot. Without a partner, the rows are compliant.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct CoupledParameters {
    /// The coupled frame: a link of the URDF. Either this or `joints`.
    pub frame: Option<String>,
    /// The coupled joints, at most six. Either this or `frame`.
    pub joints: Option<Vec<String>>,
    /// Axes of the frame that are coupled.
    #[cfg_attr(feature = "schema", schemars(extend("default" = DEFAULT_AXES, "minItems" = 1, "uniqueItems" = true)))]
    pub axes: Option<Vec<CoupledAxis>>,
    /// Directions of the axes: those of the world rotated by roll, pitch and yaw (fixed axes, in that order), rad. With
    /// them, robots that face different ways agree on what is forward.
    #[serde(default, deserialize_with = "exactly")]
    pub axes_rpy_rad: [f64; 3],
    /// Damping along the axes, Ns/m (of prismatic joints too).
    #[serde(default)]
    pub damping_ns_per_m: NonNegative,
    /// Damping about the axes, Nms/rad (of revolute joints too).
    #[serde(default)]
    pub damping_nms_per_rad: NonNegative,
    /// Force sensor of the robot, or one of its estimated forces; needed for measured forces and handle feedback.
    pub sensor: Option<String>,
    /// Corner frequency of the filter of the sensed force, Hz.
    #[serde(default = "hundred")]
    pub filter_hz: Positive,
    /// Side of the robot in its coupling; an experiment with several robots writes it into the task.
    pub side: Option<CouplingSide>,
    /// Law of the coupling; an experiment with several robots writes it into the task. Without it, nothing is received.
    pub teleoperation: Option<Box<TeleoperationParameters>>,
    /// Law of two robots that carry an object, instead of `teleoperation`; an experiment with several robots writes it into the
    /// task.
    pub carry: Option<Box<CarryParameters>>,
}

/// Axes that are coupled if the file names none.
pub(crate) const DEFAULT_AXES: [CoupledAxis; 3] = [CoupledAxis::X, CoupledAxis::Y, CoupledAxis::Z];

const fn hundred() -> Positive {
    Positive::literal(100.0)
}

impl CoupledParameters {
    /// Returns the parameters of a frame, with x, y and z coupled and without sensor, damping or coupling.
    #[must_use]
    pub fn of_frame(frame: impl Into<String>) -> Self {
        Self {
            frame: Some(frame.into()),
            joints: None,
            axes: None,
            axes_rpy_rad: [0.0; 3],
            damping_ns_per_m: NonNegative::default(),
            damping_nms_per_rad: NonNegative::default(),
            sensor: None,
            filter_hz: hundred(),
            side: None,
            teleoperation: None,
            carry: None,
        }
    }
}

/// Axis of a coupled frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum CoupledAxis {
    /// Along the first axis.
    X,
    /// Along the second axis.
    Y,
    /// Along the third axis.
    Z,
    /// About the first axis.
    Rx,
    /// About the second axis.
    Ry,
    /// About the third axis.
    Rz,
}

impl CoupledAxis {
    /// Index in [`AXIS_NAMES`].
    #[must_use]
    pub fn index(self) -> usize {
        self as usize
    }

    /// Name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        AXIS_NAMES[self.index()]
    }
}

/// Law of a coupling between a leader and a follower.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
#[non_exhaustive]
pub struct TeleoperationParameters {
    /// Quantity from which the leader's force is computed.
    pub reflect: Reflected,
    /// Stiffness along the axes between reference and follower, N/m.
    pub stiffness_n_per_m: NonNegative,
    /// Damping along the axes, Ns/m.
    pub damping_ns_per_m: NonNegative,
    /// Stiffness about the axes, Nm/rad.
    pub stiffness_nm_per_rad: NonNegative,
    /// Damping about the axes, Nms/rad.
    pub damping_nms_per_rad: NonNegative,
    /// Ratios of the follower to the leader.
    pub scale: CouplingScale,
    /// Feedback g of the leader's sensed force: the leader's inertia and friction appear 1 + g times smaller to the
    /// hand; the reflected force is multiplied by 1 + g. Needs a sensor of the leader.
    pub handle_feedback: NonNegative,
    /// Passivity control.
    #[cfg_attr(feature = "schema", schemars(extend("default" = { "on": {} })))]
    pub passivity: Passivity,
    /// Damping of the leader in contact, which pays for the delay of a reflected force: this ratio times the stiffness times the
    /// time after which a motion of the leader is felt.
    pub delay_damping_ratio: NonNegative,
    /// Largest such damping, Ns/m (Nms/rad).
    pub delay_damping_at_most_ns_per_m: NonNegative,
    /// Times at which the clutch is open, from and until, s after the start of control: the leader moves without the
    /// follower. When it closes, the follower continues from where it is.
    pub clutch_open_s: Vec<[f64; 2]>,
    /// Age of the last packet, measured from its arrival, above which the coupling is open, s.
    pub timeout_s: Positive,
}

impl Default for TeleoperationParameters {
    fn default() -> Self {
        Self {
            reflect: Reflected::default(),
            stiffness_n_per_m: NonNegative::literal(3000.0),
            damping_ns_per_m: NonNegative::literal(40.0),
            stiffness_nm_per_rad: NonNegative::literal(30.0),
            damping_nms_per_rad: NonNegative::literal(0.6),
            scale: CouplingScale::default(),
            handle_feedback: NonNegative::default(),
            passivity: Passivity::default(),
            delay_damping_ratio: NonNegative::literal(2.0),
            delay_damping_at_most_ns_per_m: NonNegative::literal(300.0),
            clutch_open_s: Vec::new(),
            timeout_s: Positive::literal(0.2),
        }
    }
}

/// Side of a robot in a coupling.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum CouplingSide {
    /// The operator moves it, and feels the other robot.
    Leader,
    /// Follows the leader.
    Follower,
}

/// Quantity from which the force on the leader is computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Reflected {
    /// Position of the follower: both robots are pulled to each other by the coupling's spring.
    Position,
    /// Force of the follower's spring, which includes the follower's friction and inertia.
    ControllerForce,
    /// Force that the follower's sensor measures.
    #[default]
    MeasuredForce,
    /// Wave variables; they are passive with any constant delay, but not with jitter or loss.
    Waves {
        /// Wave impedance b, Ns/m (Nms/rad for rotations).
        impedance_ns_per_m: Positive,
    },
}

impl Reflected {
    /// Name in files.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Position => "position",
            Self::ControllerForce => "controller-force",
            Self::MeasuredForce => "measured-force",
            Self::Waves { .. } => "waves",
        }
    }
}

/// Ratios of the follower's motion and force to those of the leader.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct CouplingScale {
    /// Displacement of the follower per displacement of the leader.
    pub position: Positive,
    /// Force on the leader per force on the follower.
    pub force: Positive,
}

impl Default for CouplingScale {
    fn default() -> Self {
        Self { position: Positive::literal(1.0), force: Positive::literal(1.0) }
    }
}

/// Law of two robots that carry an object together.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct CarryParameters {
    /// Line from the leader's hand to the follower's in the task axes; any length.
    #[serde(deserialize_with = "exactly")]
    pub direction: [f64; 3],
    /// Force with which each hand presses on the object along this line, N; negative: pulls. If absent, the hands keep their
    /// distance along the line too, for an object that only one of them holds at times.
    pub internal_force_n: Option<f64>,
    /// Path of the object, from where it is at the start; it stays there if absent.
    pub path: Option<Sinusoid>,
    /// Natural frequency ω of the errors of the path and of the distance, rad/s.
    #[serde(default = "default_frequency")]
    pub frequency_rad_per_s: Positive,
    /// Damping ratio ζ of these errors.
    #[serde(default = "one")]
    pub damping_ratio: Positive,
    /// Feedback of the error of the internal force.
    #[serde(default = "one_feedback")]
    pub gain: NonNegative,
    /// Integral feedback of the error of the internal force, 1/s.
    #[serde(default = "ten")]
    pub integral_per_s: NonNegative,
    /// Largest integral, N.
    #[serde(default = "twenty")]
    pub integral_limit_n: NonNegative,
    /// Time over which the internal force comes in, s.
    #[serde(default = "half")]
    pub ramp_s: NonNegative,
    /// Age of the last packet, measured from its arrival, above which the robots are no longer coupled, s.
    #[serde(default = "fifth")]
    pub timeout_s: Positive,
}

const fn default_frequency() -> Positive {
    Positive::literal(20.0)
}

const fn one() -> Positive {
    Positive::literal(1.0)
}

const fn one_feedback() -> NonNegative {
    NonNegative::literal(1.0)
}

const fn ten() -> NonNegative {
    NonNegative::literal(10.0)
}

const fn twenty() -> NonNegative {
    NonNegative::literal(20.0)
}

const fn half() -> NonNegative {
    NonNegative::literal(0.5)
}

const fn fifth() -> Positive {
    Positive::literal(0.2)
}

/// Passivity control of a coupling.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Passivity {
    /// The energies are observed and recorded, but not limited.
    Off,
    /// Limits the energy that comes out of the coupling to what went in on the other side and the store.
    On(PortPassivityParameters),
}

impl Default for Passivity {
    fn default() -> Self {
        Self::On(PortPassivityParameters::default())
    }
}

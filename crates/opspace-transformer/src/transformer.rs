//! Transformers from desired torques to commands, which allow torque control of a position or velocity robot.
//!
//! O. Khatib, P. Thaulad, T. Yoshikawa, J. Park, *Torque-Position Transformer for Task Control of Position
//! Controlled Robots*.

use crate::servo::ServoGains;
use opspace_backend::{CommandKind, Sample, Setpoints};
use opspace_model::Data;
#[cfg(feature = "schema")]
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};
#[cfg(feature = "schema")]
use std::borrow::Cow;

/// Method of converting torques to positions or velocities.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Equation (K10) of the paper; for velocity servos, its inner stage.
    Paper,
    /// Emulation of the servo over the next interval; matches the mean torque.
    Emulation,
    /// Emulation of the servo for drives that interpolate setpoints; matches the torque of each servo tick.
    Interpolating,
    /// Extrapolation of each joint at its velocity over the next interval; matches the mean torque.
    Extrapolation,
    /// Equation (K10) with the gains of a measured closed loop.
    Identified,
    /// Equation (K8) on a measured closed loop, for a single free joint.
    IdentifiedLiteral,
    /// Second form of equation (K8), which doesn't use the measured position.
    IdentifiedOpenLoop,
}

impl Method {
    /// True if the method needs a measured closed loop.
    #[must_use]
    pub fn needs_identification(self) -> bool {
        matches!(self, Self::Identified | Self::IdentifiedLiteral | Self::IdentifiedOpenLoop)
    }

    /// True if the method needs the delay until a setpoint acts.
    #[must_use]
    pub fn needs_delay(self) -> bool {
        self.emulates_arm() || self == Self::Extrapolation
    }

    /// True if the method emulates the arm with its drives.
    #[must_use]
    pub fn emulates_arm(self) -> bool {
        matches!(self, Self::Emulation | Self::Interpolating)
    }
}

/// Transformer: a method, with or without correction by measured motor current.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TransformerKind {
    /// Method of converting torques to positions or velocities.
    pub method: Method,
    /// True if measured motor current corrects it.
    pub current: bool,
}

impl TransformerKind {
    /// All transformers.
    pub const ALL: [Self; 14] = [
        Self::new(Method::Paper, false),
        Self::new(Method::Paper, true),
        Self::new(Method::Emulation, false),
        Self::new(Method::Emulation, true),
        Self::new(Method::Interpolating, false),
        Self::new(Method::Interpolating, true),
        Self::new(Method::Extrapolation, false),
        Self::new(Method::Extrapolation, true),
        Self::new(Method::Identified, false),
        Self::new(Method::Identified, true),
        Self::new(Method::IdentifiedLiteral, false),
        Self::new(Method::IdentifiedLiteral, true),
        Self::new(Method::IdentifiedOpenLoop, false),
        Self::new(Method::IdentifiedOpenLoop, true),
    ];

    /// Names of all transformers, in the order of [`ALL`](Self::ALL).
    pub const NAMES: [&'static str; Self::ALL.len()] = [
        "paper",
        "paper+current",
        "emulation",
        "emulation+current",
        "interpolating",
        "interpolating+current",
        "extrapolation",
        "extrapolation+current",
        "identified",
        "identified+current",
        "identified-literal",
        "identified-literal+current",
        "identified-open-loop",
        "identified-open-loop+current",
    ];

    const fn new(method: Method, current: bool) -> Self {
        Self { method, current }
    }

    /// Name in files, tables and on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        let place = Self::ALL.iter().position(|kind| *kind == self);
        Self::NAMES[place.unwrap_or_default()]
    }

    /// Returns the transformer of that name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        let place = Self::NAMES.iter().position(|known| *known == name);
        place.map(|place| Self::ALL[place])
    }

    /// One-line description.
    #[must_use]
    pub fn description(self) -> &'static str {
        if self.current {
            return "the same method, corrected by measured motor current";
        }
        match self.method {
            Method::Paper => "equation (K10) of the paper",
            Method::Emulation => "emulates the servo up to the next setpoint and matches the mean torque",
            Method::Interpolating => {
                "emulates the servo of drives that interpolate setpoints and matches the torque of each servo tick"
            }
            Method::Extrapolation => {
                "extrapolates each joint at its velocity up to the next setpoint and matches the mean torque"
            }
            Method::Identified => "equation (K10) with gains from a measured closed loop",
            Method::IdentifiedLiteral => {
                "equation (K8) on a measured closed loop: one joint without gravity and contact; simulation only"
            }
            Method::IdentifiedOpenLoop => {
                "second form of (K8), without the measured position: drifts; simulation only"
            }
        }
    }

    /// True if it needs measured motor current.
    #[must_use]
    pub fn needs_current(self) -> bool {
        self.current
    }

    /// Returns the best transformer for a robot with these declared properties, and the reason:
    ///
    /// | delay | gears | motor current | transformer |
    /// |---|---|---|---|
    /// | unknown | | | `paper`, which works with any delay |
    /// | known | rigid | | `emulation` or `interpolating`, with `+current` if it is measured |
    /// | known | elastic or unknown | measured | `extrapolation+current` |
    /// | known | elastic or unknown | not measured | `paper` for a position robot, `extrapolation` for a velocity robot |
    ///
    /// Emulation makes elastic gears oscillate. Extrapolation removes the damping of a position servo, so that without
    /// measured current a position loop with a gain above the nominal one drives the joint; the paper's transformer
    /// leaves a part of the damping. A wrong gain of a velocity loop only scales the torque.
    #[must_use]
    pub fn best(robot: &DeclaredProperties) -> (Self, String) {
        let DeclaredProperties { takes, setpoints, delay_servo_ticks, measures_current, gears } = *robot;
        let Some(delay) = delay_servo_ticks else {
            let why =
                "the delay of setpoints is unknown, and this transformer works with any delay".to_owned();
            return (Self::new(Method::Paper, false), why);
        };
        let current = if measures_current { "measured" } else { "not measured" };
        if gears == Gears::Elastic {
            let why = format!(
                "the gears are not declared rigid, the delay of setpoints is known ({delay} servo ticks), motor current \
                 is {current}"
            );
            if takes == CommandKind::Velocity || measures_current {
                return (Self::new(Method::Extrapolation, measures_current), why);
            }
            let why = why
                + ": this transformer keeps a part of the servo's damping, so that a wrong gain does less harm";
            return (Self::new(Method::Paper, false), why);
        }
        let (method, setpoints) = match setpoints {
            Setpoints::Held => (Method::Emulation, "held"),
            Setpoints::Interpolated => (Method::Interpolating, "interpolated"),
        };
        let why = format!(
            "the gears are declared rigid, setpoints are {setpoints}, their delay is known ({delay} servo ticks), motor \
             current is {current}"
        );
        (Self::new(method, measures_current), why)
    }
}

/// Gears between the motors and the links of a robot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Gears {
    /// Known to be rigid: each motor with its link resonates above six times the bandwidth of its velocity loop,
    /// kv/(2π inertia) in Hz.
    Rigid,
    /// Elastic, or unknown.
    #[default]
    Elastic,
}

/// Declared properties of a robot that determine its [best](TransformerKind::best) transformer.
#[derive(Clone, Copy, Debug)]
pub struct DeclaredProperties {
    /// Quantity of its setpoints: position or velocity.
    pub takes: CommandKind,
    /// Behaviour of the drives between two setpoints.
    pub setpoints: Setpoints,
    /// Delay until a setpoint acts, in servo ticks; `None` if unknown.
    pub delay_servo_ticks: Option<u32>,
    /// True if motor current is measured.
    pub measures_current: bool,
    /// Gears between motors and links.
    pub gears: Gears,
}

impl<'de> Deserialize<'de> for TransformerKind {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        Self::named(&name).ok_or_else(|| D::Error::unknown_variant(&name, &Self::NAMES))
    }
}

#[cfg(feature = "schema")]
impl JsonSchema for TransformerKind {
    fn schema_name() -> Cow<'static, str> {
        "TransformerKind".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "description": "Transformer from desired torques to setpoints.", "type": "string", "enum": Self::NAMES })
    }
}

/// Converter of desired torques to the commands that make a robot's servos produce them.
pub trait Transformer: Send {
    /// Quantity of the command that it returns and the robot accepts.
    fn takes(&self) -> CommandKind {
        CommandKind::Position
    }

    /// Processes a new sample before anything else uses it. Returns joint velocities (n; rad/s, m/s) if the transformer
    /// has a better estimate than a filtered difference of positions.
    fn observe(&mut self, _sample: &Sample) -> Option<&[f64]> {
        None
    }

    /// Returns true if the transformer uses the velocities of the references.
    fn uses_reference_velocity(&self) -> bool {
        false
    }

    /// Announces the joint velocities of the references (n; rad/s, m/s) at the present sample. They depend on time and not
    /// on the measured motion, so that their use adds no feedback.
    fn set_reference_velocity(&mut self, _velocity: &[f64]) {}

    /// Computes the command (n; Nm, N or rad/s, m/s or rad, m) that makes the servos produce `torque` (n; Nm, N) in the
    /// state of `data`. Allocates nothing.
    fn transform(&mut self, data: &Data, torque: &[f64], command: &mut [f64]);

    /// Records the command (n) that was sent to the robot, from any source.
    fn sent(&mut self, _data: &Data, _command: &[f64]) {}

    /// Reports `periods` interface periods without a sample and without a setpoint; the drives keep their last
    /// setpoint.
    fn missed(&mut self, _periods: u64) {}

    /// Resets the transformer: the next sample is treated as the first.
    fn reset(&mut self) {}
}

/// Transformer of the paper: two consecutive stages per joint, for the inner velocity loop and the outer
/// position loop of its cascaded servo.
///
/// ```text
/// q_desired = kp⁻¹ (kv⁻¹ τ + q̇) + q                                  (K10)
/// ```
///
/// Other position servos are represented by their equivalent gains. For velocity servos see
/// [`VelocityTransformer`](crate::velocity_transformer::VelocityTransformer).
#[derive(Clone, Debug)]
pub struct PaperTransformer {
    gains: Vec<ServoGains>,
}

impl PaperTransformer {
    /// Returns the transformer for servos with these equivalent gains (n).
    #[must_use]
    pub fn new(gains: Vec<ServoGains>) -> Self {
        Self { gains }
    }
}

impl Transformer for PaperTransformer {
    fn transform(&mut self, data: &Data, tau: &[f64], q_desired: &mut [f64]) {
        for (i, gains) in self.gains.iter().enumerate() {
            // Inner loop τ = kv (v_desired − q̇) times kv; then the outer loop v_desired = kp (q_desired − q).
            let kv_velocity_desired = tau[i] + gains.damping * data.dq[i];
            q_desired[i] = kv_velocity_desired / gains.stiffness + data.q[i];
        }
    }
}

//! Torques to commands: the unit that makes a position or velocity robot take torques.
//!
//! O. Khatib, P. Thaulad, T. Yoshikawa, J. Park, *Torque-Position Transformer for Task Control of Position
//! Controlled Robots*.

use crate::servo::ServoGains;
use opspace_backend::{CommandKind, Sample, Setpoints};
use opspace_model::Data;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::Error;
use serde::{Deserialize, Deserializer};
use std::borrow::Cow;

/// How torques become positions or velocities.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Equation (10) of the paper; its inner stage for velocity servos.
    Paper,
    /// The servo emulated over the next interval, its mean torque matched.
    Emulation,
    /// The same for drives that interpolate set-points, the torque of each servo tick matched.
    Interpolating,
    /// Equation (10) with the gains that a measured closed loop has.
    Identified,
    /// Equation (8) on a measured closed loop, for a single free joint.
    IdentifiedLiteral,
    /// Its second form, which doesn't look at the measured position.
    IdentifiedOpenLoop,
}

impl Method {
    /// Whether it is made from a measured closed loop.
    #[must_use]
    pub fn needs_identification(self) -> bool {
        matches!(self, Self::Identified | Self::IdentifiedLiteral | Self::IdentifiedOpenLoop)
    }

    /// Whether it must know when a set-point acts.
    #[must_use]
    pub fn needs_delay(self) -> bool {
        matches!(self, Self::Emulation | Self::Interpolating)
    }
}

/// Which transformer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TransformerKind {
    /// How torques become positions or velocities.
    pub method: Method,
    /// Whether measured motor current corrects it.
    pub current: bool,
}

impl TransformerKind {
    /// All there are.
    pub const ALL: [Self; 12] = [
        Self::new(Method::Paper, false),
        Self::new(Method::Paper, true),
        Self::new(Method::Emulation, false),
        Self::new(Method::Emulation, true),
        Self::new(Method::Interpolating, false),
        Self::new(Method::Interpolating, true),
        Self::new(Method::Identified, false),
        Self::new(Method::Identified, true),
        Self::new(Method::IdentifiedLiteral, false),
        Self::new(Method::IdentifiedLiteral, true),
        Self::new(Method::IdentifiedOpenLoop, false),
        Self::new(Method::IdentifiedOpenLoop, true),
    ];

    /// The names of all, in their order.
    pub const NAMES: [&'static str; Self::ALL.len()] = [
        "paper",
        "paper+current",
        "emulation",
        "emulation+current",
        "interpolating",
        "interpolating+current",
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

    /// Its name in files, tables and on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        let place = Self::ALL.iter().position(|kind| *kind == self);
        Self::NAMES[place.unwrap_or_default()]
    }

    /// The one of that name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        let place = Self::NAMES.iter().position(|known| *known == name);
        place.map(|place| Self::ALL[place])
    }

    /// What it does, in a line.
    #[must_use]
    pub fn about(self) -> &'static str {
        if self.current {
            return "the same, corrected by measured motor current";
        }
        match self.method {
            Method::Paper => "equation (10) of the paper",
            Method::Emulation => "the servo emulated up to the next set-point, its mean torque matched",
            Method::Interpolating => {
                "the servo emulated where drives interpolate, every tick's torque matched"
            }
            Method::Identified => "equation (10) with the gains that a measured closed loop has",
            Method::IdentifiedLiteral => {
                "equation (8) on a measured closed loop: one joint, free of gravity and contact"
            }
            Method::IdentifiedOpenLoop => "its second form, blind to the measured position: drifts",
        }
    }

    /// Whether it needs the motors' current.
    #[must_use]
    pub fn needs_current(self) -> bool {
        self.current
    }

    /// The best one for a robot that declares this of itself, and why. Without a known delay there is nothing to emulate
    /// by, and the paper's is the most forgiving.
    #[must_use]
    pub fn best(set_points: Setpoints, delay_servo_ticks: Option<u32>, current: bool) -> (Self, String) {
        let Some(delay) = delay_servo_ticks else {
            let why = "the delay of set-points isn't known, and this one bears any".to_owned();
            return (Self::new(Method::Paper, false), why);
        };
        let (method, set_points) = match set_points {
            Setpoints::Held => (Method::Emulation, "held"),
            Setpoints::Interpolated => (Method::Interpolating, "interpolated"),
        };
        let measured = if current { "measured" } else { "not measured" };
        let why = format!(
            "set-points are {set_points}, their delay is known ({delay} servo ticks), motor current is {measured}"
        );
        (Self::new(method, current), why)
    }
}

impl<'de> Deserialize<'de> for TransformerKind {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        Self::named(&name).ok_or_else(|| D::Error::unknown_variant(&name, &Self::NAMES))
    }
}

impl JsonSchema for TransformerKind {
    fn schema_name() -> Cow<'static, str> {
        "TransformerKind".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "description": "Which transformer.", "type": "string", "enum": Self::NAMES })
    }
}

/// Turns desired torques into the commands that make a robot's servos produce them.
pub trait Transformer: Send {
    /// The quantity that comes out: what the robot takes.
    fn takes(&self) -> CommandKind {
        CommandKind::Position
    }

    /// Takes in a new sample, before anything is made of it, and gives the joint velocities (rad/s, m/s; n) if it knows
    /// them better than a filtered difference of positions does.
    fn observe(&mut self, _sample: &Sample) -> Option<&[f64]> {
        None
    }

    /// Computes the command (rad, m or rad/s, m/s or Nm, N; n) that makes the servos produce `torque` (Nm, N; n) at the
    /// state of `data`. Allocates nothing.
    fn transform(&mut self, data: &Data, torque: &[f64], command: &mut [f64]);

    /// Takes the command (n) that the robot was given in the end, whoever asked for it.
    fn sent(&mut self, _data: &Data, _command: &[f64]) {}

    /// That many interface periods passed without a sample and without a set-point, the drives keeping what they had.
    fn missed(&mut self, _periods: u64) {}

    /// Begins anew with the next sample, as with the very first.
    fn reset(&mut self) {}
}

/// The paper's transformer: two consecutive ones a joint, for the inner velocity loop and the outer
/// position loop of its cascaded servo.
///
/// ```text
/// q_desired = kp⁻¹ (kv⁻¹ τ + q̇) + q                                   (10)
/// ```
///
/// Other position servos are taken for what they amount to; velocity servos have the
/// [`VelocityTransformer`](crate::velocity_transformer::VelocityTransformer).
#[derive(Clone, Debug)]
pub struct PaperTransformer {
    gains: Vec<ServoGains>,
}

impl PaperTransformer {
    /// For joints with these servos.
    #[must_use]
    pub fn new(gains: Vec<ServoGains>) -> Self {
        Self { gains }
    }
}

impl Transformer for PaperTransformer {
    fn transform(&mut self, data: &Data, tau: &[f64], q_desired: &mut [f64]) {
        for (i, gains) in self.gains.iter().enumerate() {
            // The inner loop, τ = kv (v_desired − q̇), both sides times kv; then the outer one, v_desired = kp (q_desired − q).
            let kv_velocity_desired = tau[i] + gains.damping * data.dq[i];
            q_desired[i] = kv_velocity_desired / gains.stiffness + data.q[i];
        }
    }
}

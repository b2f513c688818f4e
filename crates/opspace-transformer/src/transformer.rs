//! Transformers from desired torques to commands, which allow torque control of a position or velocity robot.
//!
//! O. Khatib, P. Thaulad, T. Yoshikawa, J. Park, *Torque-Position Transformer for Task Control of Position
//! Controlled Robots*.

use crate::servo_gains::ServoGains;
use opspace_backend::{CommandKind, Sample, Setpoints};
use opspace_model::Data;
#[cfg(feature = "schema")]
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::fmt;

/// Name of a transformer in files, tables and on the command line. A program has a table of those that it knows; `+current` at
/// the end of a name means that measured motor current corrects it.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Deserialize, Serialize)]
#[serde(transparent)]
pub struct TransformerName(Cow<'static, str>);

/// End of the name of a transformer that is corrected by measured motor current.
const WITH_CURRENT: &str = "+current";

impl TransformerName {
    /// Equation (K10) of the paper; for velocity servos, its inner stage.
    pub const PAPER: Self = Self::literal("paper");
    /// Emulation of the servo over the next interval; matches the mean torque.
    pub const EMULATION: Self = Self::literal("emulation");
    /// Emulation of the servo for drives that interpolate setpoints; matches the torque of each servo tick.
    pub const INTERPOLATING: Self = Self::literal("interpolating");
    /// Extrapolation of each joint at its velocity over the next interval; matches the mean torque.
    pub const EXTRAPOLATION: Self = Self::literal("extrapolation");
    /// Equation (K10) with the gains of a measured closed loop.
    pub const IDENTIFIED: Self = Self::literal("identified");

    /// Returns a name.
    #[must_use]
    pub const fn literal(name: &'static str) -> Self {
        Self(Cow::Borrowed(name))
    }

    /// Text of the name.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Name of the method, without the correction by measured motor current.
    #[must_use]
    pub fn method(&self) -> &str {
        self.0.strip_suffix(WITH_CURRENT).unwrap_or(&self.0)
    }

    /// True if measured motor current corrects it.
    #[must_use]
    pub fn has_current(&self) -> bool {
        self.0.ends_with(WITH_CURRENT)
    }

    /// Name of the same method with or without correction by measured motor current.
    #[must_use]
    pub fn with_current(&self, current: bool) -> Self {
        if current == self.has_current() {
            return self.clone();
        }
        let end = if current { WITH_CURRENT } else { "" };
        Self(Cow::Owned(format!("{}{end}", self.method())))
    }

    /// Returns the best transformer for a robot with these declared properties, and the reason:
    ///
    /// | delay | gears | motor current | transformer |
    /// |---|---|---|---|
    /// | unknown | | | `paper`, which works with any delay |
    /// | known | rigid | | `emulation` or `interpolating`, with `+current` if it is measured |
    /// | known | elastic or unknown | measured | `extrapolation+current` |
    /// | known | elastic or unknown | not measured | `extrapolation` |
    ///
    /// Emulation makes elastic gears oscillate. Extrapolation removes the damping of a position servo, except for the
    /// [part](crate::remaining_damping) without which gains within their interval drive the joint. The paper's transformer leaves a part
    /// that follows from the timing of the drives: too little for wrong gains, or more than they need. A wrong gain of
    /// a velocity loop only scales the torque.
    #[must_use]
    pub fn best(robot: &DeclaredProperties) -> (Self, String) {
        let DeclaredProperties { setpoints, delay_servo_ticks, measures_current, gears } = *robot;
        let Some(delay) = delay_servo_ticks else {
            let why =
                "the delay of setpoints is unknown, and this transformer works with any delay".to_owned();
            return (Self::PAPER, why);
        };
        let current = if measures_current { "measured" } else { "not measured" };
        if gears == Gears::Elastic {
            let why = format!(
                "the gears are not declared rigid, the delay of setpoints is declared ({delay} servo ticks), motor current \
                 is {current}"
            );
            return (Self::EXTRAPOLATION.with_current(measures_current), why);
        }
        let (method, setpoints) = match setpoints {
            Setpoints::Held => (Self::EMULATION, "held"),
            Setpoints::Interpolated => (Self::INTERPOLATING, "interpolated"),
        };
        let why = format!(
            "the gears are declared rigid, setpoints are {setpoints}, their delay is declared ({delay} servo ticks), motor \
             current is {current}"
        );
        (method.with_current(measures_current), why)
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

/// Declared properties of a robot that determine its [best](TransformerName::best) transformer.
#[derive(Clone, Copy, Debug)]
pub struct DeclaredProperties {
    /// Behaviour of the drives between two setpoints.
    pub setpoints: Setpoints,
    /// Delay until a setpoint acts, in servo ticks; `None` if unknown.
    pub delay_servo_ticks: Option<u32>,
    /// True if motor current is measured.
    pub measures_current: bool,
    /// Gears between motors and links.
    pub gears: Gears,
}

impl fmt::Display for TransformerName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl From<&'static str> for TransformerName {
    fn from(name: &'static str) -> Self {
        Self::literal(name)
    }
}

impl From<String> for TransformerName {
    fn from(name: String) -> Self {
        Self(Cow::Owned(name))
    }
}

#[cfg(feature = "schema")]
impl JsonSchema for TransformerName {
    fn schema_name() -> Cow<'static, str> {
        "TransformerName".into()
    }

    /// Schema without the names, which the program adds from its table.
    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "description": "Transformer from desired torques to setpoints.", "type": "string" })
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

    /// Returns true if the transformer uses the motion of the references.
    fn uses_reference_motion(&self) -> bool {
        false
    }

    /// Announces the joint velocities of the references (n; rad/s, m/s), and their accelerations (n; rad/s², m/s²) since the last
    /// sample; zero without a reference. Accelerations depend on time and not on the measured motion, so that their use adds
    /// no feedback, except that they do not exceed what limits leave of the command. Velocities depend on the measured posture,
    /// and are large near singular poses.
    fn set_reference_motion(&mut self, _velocity: &[f64], _acceleration: &[f64]) {}

    /// Inertia that the drives add to the joints at low frequency (n; kg m², kg), because the transformer knows their motion
    /// late; empty if it is not known.
    fn added_inertia(&self) -> &[f64] {
        &[]
    }

    /// Returns true if the drives add torques to the desired ones because a damping is left to the joints, or too much of it is
    /// taken away.
    fn is_damped(&self) -> bool {
        false
    }

    /// Writes the intervals of these torques at joint velocities `velocity` (n; rad/s, m/s) into `torques` (n; Nm, N), if there
    /// [are any](Self::is_damped). Must not allocate.
    fn damping_torque(&self, _velocity: &[f64], _torques: &mut [[f64; 2]]) {}

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
/// q_d = kp⁻¹ (kv⁻¹ τ + q̇) + q                                  (K10)
/// ```
///
/// Other position servos are represented by their equivalent gains. For velocity servos see
/// [`VelocityTransformer`](crate::velocity_transformer::VelocityTransformer).
///
/// A setpoint acts later than the position was measured from which it is computed. In this time t̄ a joint moves on by q̇ t̄, and the
/// damping kp kv t̄ is left to it. A gain of (1 ± u) kp changes the damping by ∓u kv.
#[derive(Clone, Debug)]
pub struct PaperTransformer {
    gains: Vec<ServoGains>,
    /// Least and largest damping of each joint (n; Nms/rad, Ns/m); empty if it is not known. The least one may be negative.
    damping: Vec<[f64; 2]>,
}

impl PaperTransformer {
    /// Returns the transformer for servos with these equivalent gains (n).
    #[must_use]
    pub fn new(gains: Vec<ServoGains>) -> Self {
        Self { gains, damping: Vec::new() }
    }

    /// Declares the mean time from a measurement until its setpoint acts, s, and the uncertainty u of each gain (n; a fraction of
    /// it). Commands don't depend on them; the [torques](Transformer::damping_torque) of the damping do.
    #[must_use]
    pub fn acting_after(self, acts_after_s: f64, gain_uncertainty: &[f64]) -> Self {
        let interval = |(gains, u): (&ServoGains, &f64)| {
            let (late, wrong) = (gains.stiffness * acts_after_s, u * gains.damping);
            [late - wrong, late + wrong]
        };
        Self { damping: self.gains.iter().zip(gain_uncertainty).map(interval).collect(), ..self }
    }
}

impl Transformer for PaperTransformer {
    fn is_damped(&self) -> bool {
        !self.damping.is_empty()
    }

    fn damping_torque(&self, velocity: &[f64], torques: &mut [[f64; 2]]) {
        for (torques, ([least, largest], v)) in torques.iter_mut().zip(self.damping.iter().zip(velocity)) {
            let [a, b] = [-least * v, -largest * v];
            *torques = [a.min(b), a.max(b)];
        }
    }

    fn transform(&mut self, data: &Data, tau: &[f64], q_desired: &mut [f64]) {
        for (i, gains) in self.gains.iter().enumerate() {
            // Inner loop τ = kv (v_desired − q̇) times kv; then the outer loop v_desired = kp (q_d − q).
            let kv_velocity_desired = tau[i] + gains.damping * data.dq[i];
            q_desired[i] = kv_velocity_desired / gains.stiffness + data.q[i];
        }
    }
}

//! Torques into positions: the unit that makes a position robot take torques.
//!
//! O. Khatib, P. Thaulad, T. Yoshikawa, J. Park, *Torque-Position Transformer for Task Control of Position
//! Controlled Robots*.

use crate::robot::Sample;
use crate::servo::{CascadedServo, ServoParameters};
use nalgebra::DVector;
use opspace_control::Measurement;
use opspace_model::Data;
use schemars::JsonSchema;
use serde::Deserialize;

/// Which transformer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum TransformerKind {
    /// Equation (10) of the paper.
    #[default]
    Paper,
    /// The servo emulated over the next interval, its mean torque matched.
    Emulation,
    /// The same, corrected by the measured motor current.
    #[serde(rename = "emulation+current")]
    EmulationCurrent,
}

impl TransformerKind {
    /// All there are.
    pub const ALL: [Self; 3] = [Self::Paper, Self::Emulation, Self::EmulationCurrent];

    /// Its name in files and tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Emulation => "emulation",
            Self::EmulationCurrent => "emulation+current",
        }
    }

    /// Whether it needs the motors' current.
    #[must_use]
    pub fn needs_current(self) -> bool {
        self == Self::EmulationCurrent
    }
}

/// Turns desired torques into the positions that make the servos produce them.
pub trait Transformer: Send {
    /// Which one it is.
    fn kind(&self) -> TransformerKind;

    /// Takes in a new sample, before anything is made of it, and gives the joint velocities (rad/s, m/s; n) if it knows
    /// them better than a filtered difference of positions does.
    fn observe(&mut self, _sample: &Sample) -> Option<&DVector<f64>> {
        None
    }

    /// The set-points (rad, m; n) that make the servos produce `tau` (Nm, N; n) at the state of
    /// `measurement`, into `q_desired`. Allocates nothing.
    fn transform(&mut self, data: &Data, measurement: &Measurement, tau: &[f64], q_desired: &mut [f64]);

    /// The set-points (rad, m; n) that the robot was given in the end, whoever asked for them.
    fn sent(&mut self, _data: &Data, _q_desired: &[f64]) {}
}

/// The paper's transformer: two consecutive ones a joint, for the inner velocity loop and the outer
/// position loop of its cascaded servo.
///
/// ```text
/// q_desired = kp⁻¹ (kv⁻¹ τ + q̇) + q                                   (10)
/// ```
#[derive(Clone, Debug)]
pub struct PaperTransformer {
    joints: Vec<(VelocityLoop, PositionLoop)>,
}

/// The inner loop, `τ = kv (v_desired − q̇)`.
#[derive(Clone, Copy, Debug)]
struct VelocityLoop {
    kv: f64,
}

/// The outer loop, `v_desired = kp (q_desired − q)`.
#[derive(Clone, Copy, Debug)]
struct PositionLoop {
    kp: f64,
}

impl VelocityLoop {
    /// The velocity set-point that makes the loop produce `tau`.
    fn invert(self, tau: f64, dq: f64) -> f64 {
        tau / self.kv + dq
    }
}

impl PositionLoop {
    /// The position set-point that makes the loop ask for `dq_desired`.
    fn invert(self, dq_desired: f64, q: f64) -> f64 {
        dq_desired / self.kp + q
    }
}

impl PaperTransformer {
    /// For joints with these servos.
    #[must_use]
    pub fn new(servos: &[ServoParameters]) -> Self {
        let joint = |servo: &ServoParameters| {
            let CascadedServo { kp_per_s, kv_nms_per_rad, .. } = *servo.cascade();
            (VelocityLoop { kv: kv_nms_per_rad.get() }, PositionLoop { kp: kp_per_s.get() })
        };
        Self { joints: servos.iter().map(joint).collect() }
    }
}

impl Transformer for PaperTransformer {
    fn kind(&self) -> TransformerKind {
        TransformerKind::Paper
    }

    fn transform(&mut self, _data: &Data, measurement: &Measurement, tau: &[f64], q_desired: &mut [f64]) {
        for (i, (velocity_loop, position_loop)) in self.joints.iter().enumerate() {
            let dq_desired = velocity_loop.invert(tau[i], measurement.dq[i]);
            q_desired[i] = position_loop.invert(dq_desired, measurement.q[i]);
        }
    }
}

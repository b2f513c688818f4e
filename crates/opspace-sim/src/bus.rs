//! Field bus between controller and drives: lost cycles and late setpoints.
//!
//! In a lost cycle neither the sample nor the setpoint is transmitted: the robot keeps its last command, and the
//! controller waits for the next sample. Before the controller starts, no cycle is lost.

use crate::random::{RngStream, generator};
use opspace_backend::quantity::{NonNegative, Positive};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Losses and delays of the bus; by default no cycle is lost or late.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct BusParameters {
    /// Probability that a cycle is lost, independent of other cycles; below 1.
    #[serde(default)]
    pub lost_cycles_share: NonNegative,
    /// Intervals in which all cycles are lost.
    #[serde(default)]
    pub dropouts: Vec<DropoutParameters>,
    /// Largest additional random delay of a setpoint, in servo ticks, unknown to the controller. It is less than
    /// `servo_ticks_per_cycle`, so that a setpoint acts before the next one.
    #[serde(default)]
    pub jitter_servo_ticks: u32,
}

/// Interval in which all cycles are lost.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct DropoutParameters {
    /// Beginning, in s after the controller's start.
    pub at_s: Positive,
    /// Duration, s; at most 10.
    pub duration_s: Positive,
}

/// Longest dropout, s. A run keeps all rows of its robot during a dropout.
pub const MAX_DROPOUT_S: f64 = 10.0;

/// Simulated bus, cycle by cycle.
#[derive(Clone, Debug)]
pub struct Bus {
    parameters: BusParameters,
    random: ChaCha8Rng,
    late: u32,
}

impl Bus {
    /// Returns the bus of a run with that seed.
    #[must_use]
    pub fn new(parameters: &BusParameters, seed: u64) -> Self {
        Self { parameters: parameters.clone(), random: generator(seed, RngStream::Bus), late: 0 }
    }

    /// Advances to the cycle at `time_s` (s after the controller's start); returns true if the cycle is not lost.
    pub fn passes(&mut self, time_s: f64) -> bool {
        let BusParameters { lost_cycles_share, dropouts, jitter_servo_ticks } = &self.parameters;
        // Both numbers are drawn in every cycle, so that losses and jitter don't affect each other.
        let draw: f64 = self.random.random_range(0.0..1.0);
        self.late = self.random.random_range(0..=*jitter_servo_ticks);
        let dead = |dropout: &DropoutParameters| {
            (dropout.at_s.get()..dropout.at_s.get() + dropout.duration_s.get()).contains(&time_s)
        };
        time_s <= 0.0 || !(draw < lost_cycles_share.get() || dropouts.iter().any(dead))
    }

    /// Delay of a setpoint of the present cycle in addition to the nominal one, in servo ticks.
    #[must_use]
    pub fn late(&self) -> u32 {
        self.late
    }
}

//! The field bus between controller and drives: cycles that get lost, and set-points that come late.
//!
//! In a cycle that is lost neither the sample nor the set-point passes: the robot goes on with what it holds, and the
//! controller waits for the next sample that comes. Until the controller starts, every cycle passes.

use crate::random::{RngStream, generator};
use opspace_backend::quantity::{NonNegative, Positive};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use schemars::JsonSchema;
use serde::Deserialize;

/// How bad the bus is; without any of it every cycle passes in time.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BusParameters {
    /// Each cycle is lost with this probability, whatever became of the one before; below 1.
    #[serde(default)]
    pub lost_cycles_share: NonNegative,
    /// Times at which the bus is dead.
    #[serde(default)]
    pub dropouts: Vec<DropoutParameters>,
    /// A set-point acts up to so many servo ticks later than after its delay, at random, which nobody tells the
    /// controller; fewer than `ratio`, so that it acts before the next one.
    #[serde(default)]
    pub jitter_servo_ticks: u32,
}

/// A time at which nothing passes.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DropoutParameters {
    /// From when on, s after the controller's start.
    pub at_s: Positive,
    /// For how long, s; at most 10.
    pub duration_s: Positive,
}

/// The longest dropout, s: a run keeps all that its robot did meanwhile.
pub const LONGEST_DROPOUT_S: f64 = 10.0;

/// A bus, cycle by cycle.
#[derive(Clone, Debug)]
pub struct Bus {
    parameters: BusParameters,
    random: ChaCha8Rng,
    late: u32,
}

impl Bus {
    /// A bus of a run with that seed.
    #[must_use]
    pub fn new(parameters: &BusParameters, seed: u64) -> Self {
        Self { parameters: parameters.clone(), random: generator(seed, RngStream::Bus), late: 0 }
    }

    /// Goes on to the cycle at `time_s`, s after the controller's start, and says whether it passes.
    pub fn passes(&mut self, time_s: f64) -> bool {
        let BusParameters { lost_cycles_share, dropouts, jitter_servo_ticks } = &self.parameters;
        // Both are drawn in every cycle, so that one leaves the other as it is.
        let draw: f64 = self.random.random_range(0.0..1.0);
        self.late = self.random.random_range(0..=*jitter_servo_ticks);
        let dead = |dropout: &DropoutParameters| {
            (dropout.at_s.get()..dropout.at_s.get() + dropout.duration_s.get()).contains(&time_s)
        };
        time_s <= 0.0 || !(draw < lost_cycles_share.get() || dropouts.iter().any(dead))
    }

    /// By how many servo ticks a set-point of the present cycle is late.
    #[must_use]
    pub fn late(&self) -> u32 {
        self.late
    }
}

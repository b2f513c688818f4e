//! Streamed references: the motion between the arrivals of targets and after the last one.
//!
//! ```text
//! extrapolated   x_d = x_k + ẋ_k Δt + ½ ẍ_k Δt² + p(t)        p: fading difference, zero after blend_s
//! generated      jerk-limited motion to x_k (online)
//! ```
//!
//! A new target never makes the reference jump. `extrapolated` follows pose + twist Δt + acceleration Δt²/2, where Δt
//! is the target's age. When a target arrives, the difference in position and velocity between the reference and this
//! motion fades along a quintic polynomial within `blend_s`; the acceleration changes as the sender's does. `generated`
//! moves to the target's pose, at rest there, within limits of velocity, acceleration and jerk.
//!
//! A target older than `timeout_s` is stale: the reference comes to rest and holds. An extrapolated reference brakes
//! within [`STOP_S`], with a velocity that is cubic in time and without a step in acceleration; a generated one brakes
//! as fast as its limits allow. After a stale target or a hold, and for the first target, the reference blends into the
//! target's motion within [`BLEND_S`](crate::references::target::BLEND_S), also without a step in acceleration.

use crate::targets::TaskTarget;
use opspace_backend::SignalRecorder;
use opspace_backend::quantity::Positive;
use opspace_backend::signal_names::{TARGET_AGE_S, TARGET_STALE};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Time in which an extrapolated reference comes to rest after its target becomes stale, s. From a constant velocity v,
/// the stopping distance is 0.125 s · v and the highest deceleration 6 1/s · v.
pub const STOP_S: f64 = 0.25;

/// Reaction to a target that is not updated in time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum OnTimeout {
    /// The reference comes to rest and holds until a fresh target arrives.
    #[default]
    Hold,
    /// A fault stops the run at once.
    Stop,
}

/// Motion between targets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum StreamedShape {
    /// Follows position, velocity and acceleration of the last target.
    #[default]
    Extrapolated,
    /// Moves to the position of the last target within limits of velocity, acceleration and jerk; the target's velocity
    /// and acceleration are not used.
    Generated,
}

pub(crate) fn default_timeout_s() -> Positive {
    Positive::literal(0.1)
}

pub(crate) fn default_blend_s() -> Positive {
    Positive::literal(0.1)
}

/// Returns the time in which differences to a new target fade, s; `None` for a generated motion. `given` lists the
/// names of the limits, with true if the file contains the limit.
///
/// # Errors
/// A key that is only valid for the other shape.
pub(crate) fn blending(
    shape: StreamedShape,
    blend_s: Option<Positive>,
    given: &[(&str, bool)],
) -> Result<Option<Positive>, String> {
    match shape {
        StreamedShape::Extrapolated => match given.iter().find(|(_, given)| *given) {
            Some((name, _)) => Err(format!("`{name}` applies only to shape = \"generated\"")),
            None => Ok(Some(blend_s.unwrap_or_else(default_blend_s))),
        },
        StreamedShape::Generated if blend_s.is_some() => {
            Err("`blend_s` applies only to shape = \"extrapolated\"".to_owned())
        }
        StreamedShape::Generated => Ok(None),
    }
}

/// Arrival of a target in a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Arrival {
    /// No target yet, or the previous one.
    Nothing,
    /// A new target. `rejoins` is true after no target or a stale one.
    Fresh { rejoins: bool },
    /// The previous target has just become stale.
    Expired,
}

/// Check of the age of a task's target.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Freshness {
    timeout_s: f64,
    on_timeout: OnTimeout,
    /// Time stamp of the current target, s.
    followed_s: Option<f64>,
    age_s: Option<f64>,
    stale: bool,
}

impl Freshness {
    pub(crate) fn new(timeout_s: Positive, on_timeout: OnTimeout) -> Self {
        Self { timeout_s: timeout_s.get(), on_timeout, followed_s: None, age_s: None, stale: false }
    }

    /// Discards the current target: the reference blends into the next fresh one.
    pub(crate) fn reset(&mut self) {
        self.followed_s = None;
    }

    pub(crate) fn update(&mut self, target: &TaskTarget<'_>) -> Arrival {
        self.age_s = target.age_s();
        self.stale = self.age_s.is_some_and(|age_s| age_s > self.timeout_s);
        if self.stale || self.age_s.is_none() {
            return if self.followed_s.take().is_some() { Arrival::Expired } else { Arrival::Nothing };
        }
        if target.stamp_s == self.followed_s {
            return Arrival::Nothing;
        }
        let rejoins = self.followed_s.is_none();
        self.followed_s = target.stamp_s;
        Arrival::Fresh { rejoins }
    }

    /// Age of a stale target that requires the robot to stop, s.
    pub(crate) fn stop_for_age_s(&self) -> Option<f64> {
        self.age_s.filter(|_| self.stale && self.on_timeout == OnTimeout::Stop)
    }

    pub(crate) fn record(&self, task: &str, out: &mut SignalRecorder<'_>) {
        out.scalar((task, TARGET_STALE), "1", f64::from(u8::from(self.stale)));
        out.scalar((task, TARGET_AGE_S), "s", self.age_s.unwrap_or(f64::NAN));
    }
}

/// Returns N values from the position `at` on, if all are finite.
pub(crate) fn given<const N: usize>(values: &[f64], at: usize) -> Option<[f64; N]> {
    let values: [f64; N] = values.get(at..at + N)?.try_into().ok()?;
    values.iter().all(|value| value.is_finite()).then_some(values)
}

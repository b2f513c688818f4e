//! Streamed references: the motion between arrivals of targets, and after the last one.
//!
//! A new target never makes the reference jump. `extrapolated` follows pose + twist Δt + acceleration Δt²/2, with Δt
//! the target's age. What the reference is away from that in position and velocity when a target arrives fades along a
//! quintic within `blend_s`; acceleration changes as the sender's does. `generated` goes to the target's pose, at rest
//! there, under limits of speed, acceleration and jerk.
//!
//! A target that is older than `timeout_s` is stale: the reference comes to rest and holds. An extrapolated one brakes
//! within [`STOP_S`], its velocity along a cubic in time and its acceleration without a step; a generated one as fast
//! as its limits allow. The next fresh target, like the first one and the first after the robot was held, is joined
//! within [`BLEND_S`](crate::references::target::BLEND_S), without a step in acceleration either.

use crate::targets::TaskTarget;
use opspace_backend::SignalRecorder;
use opspace_backend::quantity::Positive;
use opspace_backend::signal_names::{TARGET_AGE_S, TARGET_STALE};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Time in which an extrapolated reference comes to rest when its target is stale, s. From a constant speed v the way
/// is 0.125 s · v, and the highest deceleration 6 /s · v.
pub const STOP_S: f64 = 0.25;

/// Reaction to a target that is not renewed in time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum OnTimeout {
    /// The reference comes to rest and holds until a fresh target comes.
    #[default]
    Hold,
    /// The run is stopped by a fault, at once.
    Stop,
}

/// Motion between targets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum StreamedShape {
    /// Follows position, velocity and acceleration of the last target.
    #[default]
    Extrapolated,
    /// Moves to the position of the last target under limits of speed, acceleration and jerk; its velocity and
    /// acceleration are not used.
    Generated,
}

pub(crate) fn default_timeout_s() -> Positive {
    Positive::literal(0.1)
}

pub(crate) fn default_blend_s() -> Positive {
    Positive::literal(0.1)
}

/// Time in which differences to a new target fade, s; `None` for a generated motion. `given` has for each limit of the
/// file its name and true if it is there.
///
/// # Errors
/// A key that belongs to the other shape.
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
    /// None yet, or the one before.
    Nothing,
    /// A new one. `rejoins` after none, or a stale one.
    Fresh { rejoins: bool },
    /// The one before has just become stale.
    Expired,
}

/// Age of a task's target.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Freshness {
    timeout_s: f64,
    on_timeout: OnTimeout,
    /// Stamp of the target that is followed.
    followed_s: Option<f64>,
    age_s: Option<f64>,
    stale: bool,
}

impl Freshness {
    pub(crate) fn new(timeout_s: Positive, on_timeout: OnTimeout) -> Self {
        Self { timeout_s: timeout_s.get(), on_timeout, followed_s: None, age_s: None, stale: false }
    }

    /// Forgets the target that is followed: a fresh one is joined anew.
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

    /// Age of a stale target, s, for which the robot is to be stopped.
    pub(crate) fn stop_for_age_s(&self) -> Option<f64> {
        self.age_s.filter(|_| self.stale && self.on_timeout == OnTimeout::Stop)
    }

    pub(crate) fn record(&self, task: &str, out: &mut SignalRecorder<'_>) {
        out.scalar((task, TARGET_STALE), "1", f64::from(u8::from(self.stale)));
        out.scalar((task, TARGET_AGE_S), "s", self.age_s.unwrap_or(f64::NAN));
    }
}

/// N values from a place on, if all are finite.
pub(crate) fn given<const N: usize>(values: &[f64], at: usize) -> Option<[f64; N]> {
    let values: [f64; N] = values.get(at..at + N)?.try_into().ok()?;
    values.iter().all(|value| value.is_finite()).then_some(values)
}

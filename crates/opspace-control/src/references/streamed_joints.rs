//! A streamed reference of a joint-tracking task.
//!
//! ```text
//! q_d = q_k + q̇_k Δt + ½ q̈_k Δt² + p(t)        or a jerk-limited motion to q_k
//! ```
//!
//! [`streamed`](crate::references::streamed) describes both.

use crate::error::ControlError;
use crate::per_joint::PerJoint;
use crate::references::online::{MotionLimits, OnlineMotion};
use crate::references::ramp::Quintic;
use crate::references::streamed::{
    Arrival, Freshness, OnTimeout, STOP_S, StreamedShape, blending, default_blend_s, default_timeout_s,
};
use crate::references::target::BLEND_S;
use crate::targets::TaskTarget;
use opspace_backend::quantity::Positive;
use opspace_model::{JointKind, Model};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// A joint reference whose targets a program streams. Until the first target arrives, the joints hold their start
/// positions.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(with = "StreamedJointsFile"))]
#[serde(try_from = "StreamedJointsFile")]
pub struct StreamedJointReference {
    /// Age above which a target is stale, s.
    pub timeout_s: Positive,
    /// Reaction to a stale target.
    pub on_timeout: OnTimeout,
    /// Motion between targets.
    pub shape: JointShape,
}

/// Motion of joints between targets.
#[derive(Clone, Debug, PartialEq)]
pub enum JointShape {
    /// Follows the last target's position, velocity and acceleration; differences fade within `blend_s`.
    Extrapolated {
        /// Time in which the difference to a new target fades, s.
        blend_s: Positive,
    },
    /// Moves to the last target's position within limits.
    Generated {
        /// Highest speed, rad/s (m/s for a prismatic joint).
        velocity: PerJoint<Positive>,
        /// Highest acceleration, rad/s² (m/s²).
        acceleration: PerJoint<Positive>,
        /// Highest jerk, rad/s³ (m/s³).
        jerk: PerJoint<Positive>,
    },
}

impl Default for StreamedJointReference {
    fn default() -> Self {
        Self {
            timeout_s: default_timeout_s(),
            on_timeout: OnTimeout::Hold,
            shape: JointShape::Extrapolated { blend_s: default_blend_s() },
        }
    }
}

/// File format of [`StreamedJointReference`].
#[derive(Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
struct StreamedJointsFile {
    /// Age above which a target is stale, s.
    #[serde(default = "default_timeout_s")]
    timeout_s: Positive,
    /// Reaction to a stale target.
    #[serde(default)]
    on_timeout: OnTimeout,
    /// Motion between targets.
    #[serde(default)]
    shape: StreamedShape,
    /// Time in which the difference to a new target fades, s. Only with `extrapolated`.
    #[cfg_attr(feature = "schema", schemars(extend("default" = default_blend_s())))]
    blend_s: Option<Positive>,
    /// Highest speed, rad/s (m/s for a prismatic joint); only with `generated`.
    velocity_rad_per_s: Option<PerJoint<Positive>>,
    /// Highest acceleration, rad/s² (m/s²); only with `generated`.
    acceleration_rad_per_s2: Option<PerJoint<Positive>>,
    /// Highest jerk, rad/s³ (m/s³); only with `generated`.
    jerk_rad_per_s3: Option<PerJoint<Positive>>,
}

impl TryFrom<StreamedJointsFile> for StreamedJointReference {
    type Error = String;

    fn try_from(file: StreamedJointsFile) -> Result<Self, String> {
        let limits = [
            ("velocity_rad_per_s", file.velocity_rad_per_s),
            ("acceleration_rad_per_s2", file.acceleration_rad_per_s2),
            ("jerk_rad_per_s3", file.jerk_rad_per_s3),
        ];
        let given: Vec<_> = limits.iter().map(|(name, limit)| (*name, limit.is_some())).collect();
        let shape = match blending(file.shape, file.blend_s, &given)? {
            Some(blend_s) => JointShape::Extrapolated { blend_s },
            None => {
                let [velocity, acceleration, jerk] = limits.map(|(name, limit)| {
                    limit.ok_or_else(|| {
                        format!("shape = \"generated\" needs the limit `{name}`, which is missing")
                    })
                });
                JointShape::Generated { velocity: velocity?, acceleration: acceleration?, jerk: jerk? }
            }
        };
        Ok(Self { timeout_s: file.timeout_s, on_timeout: file.on_timeout, shape })
    }
}

/// Generator of a [`StreamedJointReference`]. Only [`new`](Self::new) allocates.
#[derive(Clone, Debug)]
pub(crate) struct StreamedJoints {
    blend_s: f64,
    /// Limits of each joint (n) if the motion is generated.
    limits: Option<Vec<MotionLimits>>,
    freshness: Freshness,
    /// Joints in the order of the inputs.
    joints: Vec<usize>,
    /// Kind of each joint (n).
    kinds: Vec<JointKind>,
    /// Reference of each joint (n).
    plans: Vec<Plan>,
    /// End of the blend that follows a start, a hold or a stale target, s on the robot's clock. Blends to newer targets
    /// do not end earlier.
    joined_s: f64,
}

/// Reference of one joint.
#[derive(Clone, Copy, Debug)]
#[expect(clippy::large_enum_variant, reason = "changes while running, where nothing may be allocated")]
enum Plan {
    /// Motion to rest or to a position.
    Move { begin_s: f64, motion: OnlineMotion, stopping: bool },
    /// Extrapolation of a target, with the fading offset of the reference from it.
    Follow { stamp_s: f64, raw: [f64; 3], begin_s: f64, end_s: f64, away: Quintic },
}

impl Plan {
    fn at(&self, clock_s: f64) -> [f64; 3] {
        match self {
            Self::Move { begin_s, motion, .. } => motion.at(clock_s - begin_s),
            Self::Follow { stamp_s, raw, begin_s, end_s, away } => {
                let reference = extrapolated(raw, clock_s - stamp_s);
                let away = if clock_s < *end_s { away.at(clock_s - begin_s) } else { [0.0; 3] };
                [0, 1, 2].map(|i| reference[i] + away[i])
            }
        }
    }
}

impl StreamedJoints {
    /// Creates the generator for `joints` of the robot, in the order of the inputs. `key` is the path of the reference
    /// in the file.
    pub(crate) fn new(
        reference: &StreamedJointReference,
        joints: Vec<usize>,
        model: &Model,
        key: &str,
    ) -> Result<Self, ControlError> {
        let (blend_s, limits) = match &reference.shape {
            JointShape::Extrapolated { blend_s } => (blend_s.get(), None),
            JointShape::Generated { velocity, acceleration, jerk } => {
                let velocity = velocity.resolve(model, &format!("{key}.velocity_rad_per_s"))?;
                let acceleration = acceleration.resolve(model, &format!("{key}.acceleration_rad_per_s2"))?;
                let jerk = jerk.resolve(model, &format!("{key}.jerk_rad_per_s3"))?;
                let limits = (0..model.n()).map(|i| MotionLimits {
                    velocity: velocity[i],
                    acceleration: acceleration[i],
                    jerk: jerk[i],
                });
                (0.0, Some(limits.collect()))
            }
        };
        let rest = Plan::Move { begin_s: 0.0, motion: OnlineMotion::rest(0.0), stopping: true };
        Ok(Self {
            blend_s,
            limits,
            freshness: Freshness::new(reference.timeout_s, reference.on_timeout),
            joints,
            kinds: model.joints().iter().map(|joint| joint.kind).collect(),
            plans: vec![rest; model.n()],
            joined_s: 0.0,
        })
    }

    pub(crate) fn freshness(&self) -> &Freshness {
        &self.freshness
    }

    /// Starts at the position, velocity and acceleration of each joint given by `from`. From there, the joints come to
    /// rest unless a fresh target is available.
    pub(crate) fn begin(&mut self, clock_s: f64, from: impl Fn(usize) -> [f64; 3]) {
        self.freshness.reset();
        for joint in 0..self.plans.len() {
            self.stop(joint, from(joint), clock_s);
        }
    }

    /// Position, velocity and acceleration of a joint's reference at `clock_s`, s on the robot's clock.
    pub(crate) fn at(&self, joint: usize, clock_s: f64) -> [f64; 3] {
        self.plans[joint].at(clock_s)
    }

    /// Processes the target of a cycle.
    pub(crate) fn update(&mut self, target: &TaskTarget<'_>) {
        match self.freshness.update(target) {
            Arrival::Nothing => {}
            Arrival::Expired => {
                for joint in 0..self.plans.len() {
                    let now = self.at(joint, target.clock_s);
                    self.stop(joint, now, target.clock_s);
                }
            }
            Arrival::Fresh { rejoins } => {
                if rejoins {
                    self.joined_s = target.clock_s + BLEND_S;
                }
                for place in 0..self.joints.len() {
                    self.follow(place, target, rejoins);
                }
            }
        }
    }

    /// Follows the new target of the joint at index `place` of the inputs.
    fn follow(&mut self, place: usize, target: &TaskTarget<'_>, rejoins: bool) {
        let (joint, clock_s, count) = (self.joints[place], target.clock_s, self.joints.len());
        let now = self.at(joint, clock_s);
        let value =
            |input: usize| target.values.get(input * count + place).copied().filter(|v| v.is_finite());
        // A continuous joint takes the shortest way.
        let position = value(0).map(|position| self.kinds[joint].nearest_turn(position, now[0]));
        let velocity = value(1);
        if position.is_none() && velocity.is_none() {
            if !matches!(self.plans[joint], Plan::Move { stopping: true, .. }) {
                self.stop(joint, now, clock_s);
            }
            return;
        }
        let raw = [position.unwrap_or(now[0]), velocity.unwrap_or(0.0), value(2).unwrap_or(0.0)];
        if let Some(limits) = &self.limits {
            let motion = OnlineMotion::new(now, raw[0], &limits[joint]);
            self.plans[joint] = Plan::Move { begin_s: clock_s, motion, stopping: false };
            return;
        }
        let stamp_s = target.stamp_s.unwrap_or(clock_s);
        let reference = extrapolated(&raw, clock_s - stamp_s);
        let [x, v, mut a] = [0, 1, 2].map(|i| now[i] - reference[i]);
        if let Plan::Follow { raw, .. } = &self.plans[joint]
            && !rejoins
        {
            // The sender's acceleration applies at once.
            a += reference[2] - raw[2];
        }
        let lasts_s = self.blend_s.max(self.joined_s - clock_s);
        let away = Quintic::new([x, v, a], 0.0, lasts_s);
        self.plans[joint] = Plan::Follow { stamp_s, raw, begin_s: clock_s, end_s: clock_s + lasts_s, away };
    }

    /// Brings a joint to rest from the state `from`.
    fn stop(&mut self, joint: usize, from: [f64; 3], clock_s: f64) {
        let motion = match &self.limits {
            _ if from[1..] == [0.0; 2] => OnlineMotion::rest(from[0]),
            Some(limits) => OnlineMotion::stop(from, &limits[joint]),
            None => OnlineMotion::stop_within(from, STOP_S),
        };
        self.plans[joint] = Plan::Move { begin_s: clock_s, motion, stopping: true };
    }
}

/// Extrapolates a target to `age_s` (s) after its time stamp.
fn extrapolated([x, v, a]: &[f64; 3], age_s: f64) -> [f64; 3] {
    [x + age_s * (v + 0.5 * age_s * a), v + age_s * a, *a]
}

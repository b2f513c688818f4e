//! A streamed reference of a Cartesian task.
//!
//! ```text
//! x_d = x_k + v_k Δt + ½ v̇_k Δt² + p(t)        R_d = exp(φ(t)) exp(ω_k Δt + ½ ω̇_k Δt²) R_k
//! ```
//!
//! [`streamed`](crate::references::streamed) describes this motion and the alternative, a jerk-limited motion to the pose.

use crate::orientation;
use crate::references::blend::{Joining, moved};
use crate::references::online::{MotionLimits, OnlineVector};
use crate::references::streamed::{
    Arrival, Freshness, OnTimeout, STOP_S, StreamedShape, blending, default_blend_s, default_timeout_s, given,
};
use crate::references::target::{BLEND_S, Target};
use crate::targets::TaskTarget;
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use opspace_backend::quantity::Positive;
use opspace_model::{Motion, Placement};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Tolerance of the length of a unit quaternion.
pub const QUATERNION_TOLERANCE: f64 = 1e-3;

/// A pose reference whose targets a program streams. Until the first target arrives, the frame holds its start pose.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(with = "StreamedPoseFile"))]
#[serde(try_from = "StreamedPoseFile")]
pub struct StreamedReference {
    /// Age above which a target is stale, s.
    pub timeout_s: Positive,
    /// Reaction to a stale target.
    pub on_timeout: OnTimeout,
    /// Motion between targets.
    pub shape: PoseShape,
}

/// Motion of a frame between targets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PoseShape {
    /// Follows the last target's pose, twist and acceleration; differences fade within `blend_s`.
    Extrapolated {
        /// Time in which the difference to a new target fades, s.
        blend_s: Positive,
    },
    /// Moves to the last target's pose within limits. Without `linear` the frame is not displaced, without `angular` it
    /// is not rotated.
    Generated {
        /// Limits of the displacement (m/s, m/s², m/s³).
        linear: Option<MotionLimits>,
        /// Limits of the rotation (rad/s, rad/s², rad/s³).
        angular: Option<MotionLimits>,
    },
}

impl Default for StreamedReference {
    fn default() -> Self {
        Self {
            timeout_s: default_timeout_s(),
            on_timeout: OnTimeout::Hold,
            shape: PoseShape::Extrapolated { blend_s: default_blend_s() },
        }
    }
}

/// File format of [`StreamedReference`].
#[derive(Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
struct StreamedPoseFile {
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
    /// Highest speed, m/s; only with `generated`.
    velocity_m_per_s: Option<Positive>,
    /// Highest acceleration, m/s²; only with `generated`.
    acceleration_m_per_s2: Option<Positive>,
    /// Highest jerk, m/s³; only with `generated`.
    jerk_m_per_s3: Option<Positive>,
    /// Highest angular speed, rad/s; only with `generated`.
    angular_velocity_rad_per_s: Option<Positive>,
    /// Highest angular acceleration, rad/s²; only with `generated`.
    angular_acceleration_rad_per_s2: Option<Positive>,
    /// Highest angular jerk, rad/s³; only with `generated`.
    angular_jerk_rad_per_s3: Option<Positive>,
}

impl TryFrom<StreamedPoseFile> for StreamedReference {
    type Error = String;

    fn try_from(file: StreamedPoseFile) -> Result<Self, String> {
        let linear = [
            ("velocity_m_per_s", file.velocity_m_per_s),
            ("acceleration_m_per_s2", file.acceleration_m_per_s2),
            ("jerk_m_per_s3", file.jerk_m_per_s3),
        ];
        let angular = [
            ("angular_velocity_rad_per_s", file.angular_velocity_rad_per_s),
            ("angular_acceleration_rad_per_s2", file.angular_acceleration_rad_per_s2),
            ("angular_jerk_rad_per_s3", file.angular_jerk_rad_per_s3),
        ];
        let given: Vec<_> =
            linear.iter().chain(&angular).map(|(name, limit)| (*name, limit.is_some())).collect();
        let shape = match blending(file.shape, file.blend_s, &given)? {
            Some(blend_s) => PoseShape::Extrapolated { blend_s },
            None => {
                let (linear, angular) = (limits(linear)?, limits(angular)?);
                if linear.is_none() && angular.is_none() {
                    return Err(
                        "shape = \"generated\" needs the limits `velocity_m_per_s`, `acceleration_m_per_s2` \
                                and `jerk_m_per_s3`, or those of the rotation"
                            .to_owned(),
                    );
                }
                PoseShape::Generated { linear, angular }
            }
        };
        Ok(Self { timeout_s: file.timeout_s, on_timeout: file.on_timeout, shape })
    }
}

/// Returns all three limits, or `None` if none is given.
fn limits(limits: [(&str, Option<Positive>); 3]) -> Result<Option<MotionLimits>, String> {
    if limits.iter().all(|(_, limit)| limit.is_none()) {
        return Ok(None);
    }
    let [velocity, acceleration, jerk] = limits.map(|(name, limit)| {
        limit.ok_or_else(|| format!("the limit `{name}` is missing: give all three limits or none"))
    });
    Ok(Some(MotionLimits { velocity: velocity?, acceleration: acceleration?, jerk: jerk? }))
}

/// Indices of pose, twist and acceleration in a Cartesian task's inputs.
pub(crate) const POSE: usize = 0;
pub(crate) const TWIST: usize = 7;
pub(crate) const ACCELERATION: usize = 13;

/// Generator of a [`StreamedReference`]. Allocates nothing.
#[derive(Clone, Debug)]
pub(crate) struct StreamedPose {
    shape: PoseShape,
    freshness: Freshness,
    plan: Plan,
    /// Displacement and rotation vector of [`Plan::Move`].
    line: OnlineVector,
    turn: OnlineVector,
    /// True if the reference is stopping or at rest.
    stopping: bool,
    /// End of the blend that follows a start, a hold or a stale target, s on the robot's clock. Blends to newer targets
    /// do not end earlier.
    joined_s: f64,
}

#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "changes while running, where nothing may be allocated")]
enum Plan {
    /// At rest.
    Hold(Placement),
    /// Motion from a pose along `line` and `turn`.
    Move { begin_s: f64, from: Placement },
    /// Extrapolation of a target, with the fading offset of the reference from it.
    Follow { stamp_s: f64, raw: Target, joining: Joining },
}

impl StreamedPose {
    pub(crate) fn new(reference: &StreamedReference) -> Self {
        Self {
            shape: reference.shape,
            freshness: Freshness::new(reference.timeout_s, reference.on_timeout),
            plan: Plan::Hold(Placement::identity()),
            line: OnlineVector::rest(),
            turn: OnlineVector::rest(),
            stopping: true,
            joined_s: 0.0,
        }
    }

    pub(crate) fn freshness(&self) -> &Freshness {
        &self.freshness
    }

    /// Starts at `from` and comes to rest unless a fresh target is available.
    pub(crate) fn begin(&mut self, from: &Target, clock_s: f64) {
        self.freshness.reset();
        self.stop(from, clock_s);
    }

    /// Reference at `clock_s`, s on the robot's clock.
    pub(crate) fn at(&self, clock_s: f64) -> Target {
        match &self.plan {
            Plan::Hold(placement) => Target::at_rest(*placement),
            Plan::Move { begin_s, from } => {
                let time_s = clock_s - begin_s;
                moved(from, self.line.at(time_s), self.turn.at(time_s))
            }
            Plan::Follow { stamp_s, raw, joining } => {
                joining.blended(&extrapolated(raw, clock_s - stamp_s), clock_s)
            }
        }
    }

    /// Processes the target of a cycle.
    pub(crate) fn update(&mut self, target: &TaskTarget<'_>) {
        let clock_s = target.clock_s;
        match self.freshness.update(target) {
            Arrival::Nothing => {}
            Arrival::Expired => {
                let now = self.at(clock_s);
                self.stop(&now, clock_s);
            }
            Arrival::Fresh { rejoins } => self.follow(target, rejoins),
        }
    }

    /// Follows a new target.
    fn follow(&mut self, target: &TaskTarget<'_>, rejoins: bool) {
        let clock_s = target.clock_s;
        let now = self.at(clock_s);
        let Some(raw) = read(target.values, &now.placement) else {
            if !self.stopping {
                self.stop(&now, clock_s);
            }
            return;
        };
        self.stopping = false;
        let blend_s = match self.shape {
            PoseShape::Extrapolated { blend_s } => blend_s.get(),
            PoseShape::Generated { linear, angular } => {
                self.generate(&now, &raw.placement, linear.as_ref(), angular.as_ref(), clock_s);
                return;
            }
        };
        let stamp_s = target.stamp_s.unwrap_or(clock_s);
        let reference = extrapolated(&raw, clock_s - stamp_s);
        let mut from = now;
        match &self.plan {
            // The sender's acceleration applies at once.
            Plan::Follow { stamp_s, raw, .. } if !rejoins => {
                let before = extrapolated(raw, clock_s - stamp_s).acceleration;
                from.acceleration.linear += reference.acceleration.linear - before.linear;
                from.acceleration.angular += reference.acceleration.angular - before.angular;
            }
            _ => self.joined_s = clock_s + BLEND_S,
        }
        let lasts_s = blend_s.max(self.joined_s - clock_s);
        let joining = Joining::new(clock_s, lasts_s, &from, &reference);
        self.plan = Plan::Follow { stamp_s, raw, joining };
    }

    /// Moves from `now` to the pose `to` within limits.
    fn generate(
        &mut self,
        now: &Target,
        to: &Placement,
        linear: Option<&MotionLimits>,
        angular: Option<&MotionLimits>,
        clock_s: f64,
    ) {
        let Target { placement, velocity, acceleration } = now;
        let way = to.translation - placement.translation;
        let turn = orientation::log(&(to.rotation * placement.rotation.transpose()));
        let toward =
            |velocity: &Vector3<f64>, acceleration: &Vector3<f64>, way: &Vector3<f64>, limits| match limits {
                Some(limits) => OnlineVector::new(velocity, acceleration, way, limits),
                None => OnlineVector::stop_within(velocity, acceleration, STOP_S),
            };
        self.line = toward(&velocity.linear, &acceleration.linear, &way, linear);
        // At zero, the derivatives of a rotation vector equal the angular velocity and acceleration.
        self.turn = toward(&velocity.angular, &acceleration.angular, &turn, angular);
        self.plan = Plan::Move { begin_s: clock_s, from: *placement };
    }

    /// Brings the reference to rest.
    fn stop(&mut self, now: &Target, clock_s: f64) {
        self.stopping = true;
        if now.velocity == Motion::zero() && now.acceleration == Motion::zero() {
            self.plan = Plan::Hold(now.placement);
            return;
        }
        let limits = match self.shape {
            PoseShape::Extrapolated { .. } => [None; 2],
            PoseShape::Generated { linear, angular } => [linear, angular],
        };
        let stop = |velocity, acceleration, limits: Option<MotionLimits>| match limits {
            Some(limits) => OnlineVector::stop(velocity, acceleration, &limits),
            None => OnlineVector::stop_within(velocity, acceleration, STOP_S),
        };
        self.line = stop(&now.velocity.linear, &now.acceleration.linear, limits[0]);
        self.turn = stop(&now.velocity.angular, &now.acceleration.angular, limits[1]);
        self.plan = Plan::Move { begin_s: clock_s, from: now.placement };
    }
}

/// Extrapolates a target to `age_s` (s) after its time stamp.
fn extrapolated(raw: &Target, age_s: f64) -> Target {
    let along = |velocity: &Vector3<f64>, acceleration: &Vector3<f64>| {
        let displacement = velocity * age_s + acceleration * (0.5 * age_s * age_s);
        [displacement, velocity + acceleration * age_s, *acceleration]
    };
    let line = along(&raw.velocity.linear, &raw.acceleration.linear);
    let turn = along(&raw.velocity.angular, &raw.acceleration.angular);
    moved(&raw.placement, line, turn)
}

/// Reads the target from a task's inputs; a missing position or orientation is replaced by that of `now`. `None` if
/// there is neither a pose nor a twist.
fn read(values: &[f64], now: &Placement) -> Option<Target> {
    let vector = |at: usize| given::<3>(values, at).map(Vector3::from);
    let position = vector(POSE);
    let rotation = given::<4>(values, POSE + 3).and_then(rotation);
    let velocity = [vector(TWIST), vector(TWIST + 3)];
    if position.is_none() && rotation.is_none() && velocity == [None; 2] {
        return None;
    }
    let [linear, angular] = velocity.map(Option::unwrap_or_default);
    let acceleration = [vector(ACCELERATION), vector(ACCELERATION + 3)].map(Option::unwrap_or_default);
    Some(Target {
        placement: Placement {
            rotation: rotation.unwrap_or(now.rotation),
            translation: position.unwrap_or(now.translation),
        },
        velocity: Motion { linear, angular },
        acceleration: Motion { linear: acceleration[0], angular: acceleration[1] },
    })
}

/// Returns the rotation of a quaternion (w, x, y, z); `None` if its length is not 1 within [`QUATERNION_TOLERANCE`].
fn rotation([w, x, y, z]: [f64; 4]) -> Option<Matrix3<f64>> {
    let quaternion = Quaternion::new(w, x, y, z);
    let unit = (quaternion.norm() - 1.0).abs() <= QUATERNION_TOLERANCE;
    unit.then(|| *UnitQuaternion::new_normalize(quaternion).to_rotation_matrix().matrix())
}

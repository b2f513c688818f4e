//! The swivel angle of an arm's elbow about the line from shoulder to wrist.
//!
//! With a the vector from shoulder to elbow, w that from shoulder to wrist, n = w/|w| and v a fixed direction
//! (Kreutz-Delgado, Long and Seraji, *Kinematic analysis of 7-DOF manipulators*, Int. J. Robotics Research 11(5), 1992;
//! Shimizu et al., *Analytical inverse kinematic computation for 7-DOF redundant manipulators with joint limits*, IEEE
//! Trans. Robotics 24(5), 2008):
//!
//! ```text
//! p = (I − n nᵀ) a        l = (I − n nᵀ) v        ψ = atan2(n · (l × p), l · p)
//! ψ̇ = t_p · ȧ/|p| − ((n · a) t_p/|p| − (n · v) t_l/|l|) · ẇ/|w|        t_p = n × p/|p|,  t_l = n × l/|l|
//! ```
//!
//! The angle is undefined if p, l or w is zero: with a straight arm, with the wrist along v, or with the wrist at the
//! shoulder. If |p|/|a|, |l| or |w|/|a| is below [`FADE`], Jacobian and bias fade out; they are zero below half of it.
//! The task then has no mobility, is damped to zero smoothly, and the tasks below can use its degree of freedom.

use crate::context::ControlContext;
use crate::error::ControlError;
use crate::references::ramp::minimum_jerk;
use crate::references::scalar_reference::ScalarReference;
use crate::tasks::build_task::{BuildTask, BuiltTask, TaskReference};
use crate::tasks::coordinate::Coordinate;
use crate::tasks::coordinate_task::{CoordinateGains, CoordinateTask};
use crate::tasks::damping_zone::DampingZone;
use nalgebra::{Matrix6xX, Vector3, Vector6};
use opspace_backend::quantity::{Positive, exactly};
use opspace_model::{Data, FrameId, Model, frame_bias_acceleration, frame_placement, frame_velocity};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::f64::consts::{PI, TAU};

/// Relative distance from a singularity of the angle below which its Jacobian fades out; it corresponds to a bend of
/// 2.3°.
pub const FADE: f64 = 0.04;

/// Swivel angle of three frames.
#[derive(Clone, Debug)]
pub struct SwivelAngle {
    shoulder: FrameId,
    elbow: FrameId,
    wrist: FrameId,
    direction: Vector3<f64>,
}

/// Parameters of a swivel task: `[task.NAME.swivel]`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct SwivelParameters {
    /// Frame at the shoulder: a link of the URDF.
    pub shoulder: String,
    /// Frame at the elbow.
    pub elbow: String,
    /// Frame at the wrist.
    pub wrist: String,
    /// Direction of angle zero in world axes; any length except 0.
    #[serde(default = "upwards", deserialize_with = "exactly")]
    pub direction: [f64; 3],
    /// Reference of the angle.
    pub reference: ScalarReference,
    /// Feedback of the angle.
    pub gains: CoordinateGains,
    /// Highest angular speed, rad/s; unlimited if absent.
    pub speed_limit_rad_per_s: Option<Positive>,
    /// Threshold of the mobility (eigenvalue of Λ⁻¹), relative to its median over many postures, below which the task
    /// is damped. If absent, `damping_zone` applies.
    pub singularity_threshold: Option<Positive>,
    /// Zone below which the task is damped, growing with the demand; instead of `singularity_threshold`.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "`{}` without `singularity_threshold`")))]
    pub damping_zone: Option<DampingZone>,
}

const fn upwards() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}

impl SwivelParameters {
    /// Creates a task that holds the start angle, measured from the world's z axis.
    #[must_use]
    pub fn new(shoulder: &str, elbow: &str, wrist: &str, gains: CoordinateGains) -> Self {
        Self {
            shoulder: shoulder.to_owned(),
            elbow: elbow.to_owned(),
            wrist: wrist.to_owned(),
            direction: upwards(),
            reference: ScalarReference::Hold,
            gains,
            speed_limit_rad_per_s: None,
            singularity_threshold: None,
            damping_zone: None,
        }
    }

    /// Builds the task for a robot.
    ///
    /// # Errors
    /// An unknown frame, a direction of length 0, a damping zone that is not in order.
    pub fn task(&self, name: &str, model: &Model) -> Result<CoordinateTask<SwivelAngle>, ControlError> {
        let key = format!("task.{name}.swivel");
        let angle = SwivelAngle::new(
            model,
            [&self.shoulder, &self.elbow, &self.wrist].map(String::as_str),
            Vector3::from(self.direction),
        );
        let task = CoordinateTask::new(name, angle.map_err(|error| error.below(&key))?, self.gains)
            .with_references([self.reference.clone()])
            .with_rows_key(key);
        let task = match self.speed_limit_rad_per_s {
            Some(limit) => task.with_speed_limit(limit),
            None => task,
        };
        let task = match self.singularity_threshold {
            Some(threshold) => task.with_singularity_threshold(threshold),
            None => task,
        };
        match &self.damping_zone {
            Some(zone) => task.with_damping_zone(zone),
            None => Ok(task),
        }
    }
}

/// Vectors that define the angle at a state.
struct Geometry {
    /// From shoulder to elbow, m.
    a: Vector3<f64>,
    /// n and the length of w, m.
    n: Vector3<f64>,
    reach: f64,
    /// p and l, and t_p/|p| and t_l/|l|.
    p: Vector3<f64>,
    l: Vector3<f64>,
    by_p: Vector3<f64>,
    by_l: Vector3<f64>,
    /// Fade factor: 0 near a singularity, 1 away from all.
    fade: f64,
}

impl Geometry {
    /// Creates the vectors; `None` if the fade factor is 0.
    fn new(a: Vector3<f64>, w: &Vector3<f64>, v: &Vector3<f64>) -> Option<Self> {
        let (upper_arm, reach) = (a.norm(), w.norm());
        if !(upper_arm > 0.0 && reach > 0.5 * FADE * upper_arm) {
            return None;
        }
        let n = w / reach;
        let [p, l] = [&a, v].map(|x| x - n * n.dot(x));
        let fade: f64 = [p.norm() / upper_arm, l.norm(), reach / upper_arm]
            .map(|distance| minimum_jerk(distance - 0.5 * FADE, 0.5 * FADE)[0])
            .iter()
            .product();
        let [by_p, by_l] = [p, l].map(|x| n.cross(&x) / x.norm_squared());
        (fade > 0.0).then_some(Self { a, n, reach, p, l, by_p, by_l, fade })
    }

    /// Weights of ȧ and ẇ in ψ̇, without the fade factor.
    fn weights(&self, v: &Vector3<f64>) -> [Vector3<f64>; 2] {
        let (along_a, along_v) = (self.n.dot(&self.a), self.n.dot(v));
        [self.by_p, -(self.by_p * along_a - self.by_l * along_v) / self.reach]
    }

    /// Time derivatives of the [`weights`](Self::weights), for ȧ and ẇ.
    fn weight_rates(&self, v: &Vector3<f64>, da: &Vector3<f64>, dw: &Vector3<f64>) -> [Vector3<f64>; 2] {
        let n = &self.n;
        let dreach = n.dot(dw);
        let dn = (dw - n * dreach) / self.reach;
        let (along_a, along_v) = (n.dot(&self.a), n.dot(v));
        let (dalong_a, dalong_v) = (dn.dot(&self.a) + n.dot(da), dn.dot(v));
        let dp = da - dn * along_a - n * dalong_a;
        let dl = -dn * along_v - n * dalong_v;
        // Time derivative of (n × x)/|x|².
        let rate = |x: &Vector3<f64>, dx: &Vector3<f64>, by_x: &Vector3<f64>| {
            (dn.cross(x) + n.cross(dx) - by_x * (2.0 * x.dot(dx))) / x.norm_squared()
        };
        let (dby_p, dby_l) = (rate(&self.p, &dp, &self.by_p), rate(&self.l, &dl, &self.by_l));
        let [_, by_w] = self.weights(v);
        let sum = dby_p * along_a + self.by_p * dalong_a - dby_l * along_v - self.by_l * dalong_v;
        [dby_p, -(sum + by_w * dreach) / self.reach]
    }
}

impl SwivelAngle {
    /// Creates the angle of the frames `frames` (shoulder, elbow, wrist), measured from a direction in world axes.
    ///
    /// # Errors
    /// An unknown frame, a direction of length 0.
    pub fn new(model: &Model, frames: [&str; 3], direction: Vector3<f64>) -> Result<Self, ControlError> {
        let frame = |key: &str, name: &str| model.frame_id(name).map_err(|e| ControlError::new(key, e));
        let length = direction.norm();
        if !(length > 0.0 && length.is_finite()) {
            let message = "a direction needs a length above 0".to_owned();
            return Err(ControlError::value("direction", message));
        }
        Ok(Self {
            shoulder: frame("shoulder", frames[0])?,
            elbow: frame("elbow", frames[1])?,
            wrist: frame("wrist", frames[2])?,
            direction: direction / length,
        })
    }

    /// a and w, m.
    fn vectors(&self, model: &Model, data: &Data) -> [Vector3<f64>; 2] {
        let at = |frame: FrameId| frame_placement(model, data, frame).translation;
        let shoulder = at(self.shoulder);
        [at(self.elbow) - shoulder, at(self.wrist) - shoulder]
    }

    fn geometry(&self, model: &Model, data: &Data) -> Option<Geometry> {
        let [a, w] = self.vectors(model, data);
        Geometry::new(a, &w, &self.direction)
    }
}

impl BuildTask for SwivelParameters {
    fn build(&self, name: &str, model: &Model, _context: &ControlContext) -> Result<BuiltTask, ControlError> {
        Ok(BuiltTask::rows(self.task(name, model)?))
    }

    fn reference(&self) -> Option<TaskReference<'_>> {
        Some(TaskReference::Scalar(&self.reference))
    }
}

impl Coordinate for SwivelAngle {
    fn rows(&self) -> usize {
        1
    }

    /// ψ in rad, from −π to π; 0 if it is undefined.
    fn value(&self, model: &Model, data: &Data) -> Vector6<f64> {
        let [a, w] = self.vectors(model, data);
        let reach = w.norm();
        if reach.is_nan() || reach <= 0.0 {
            return Vector6::zeros();
        }
        let n = w / reach;
        let [p, l] = [a, self.direction].map(|x| x - n * n.dot(&x));
        Vector6::x() * n.dot(&l.cross(&p)).atan2(l.dot(&p))
    }

    fn jacobian(&self, model: &Model, data: &Data, rows: &mut Matrix6xX<f64>) {
        rows.fill(0.0);
        let Some(geometry) = self.geometry(model, data) else { return };
        let [by_a, by_w] = geometry.weights(&self.direction).map(|weight| weight * geometry.fade);
        let frames = [(self.elbow, by_a), (self.wrist, by_w), (self.shoulder, -(by_a + by_w))];
        for (frame, weight) in frames {
            let point = frame_placement(model, data, frame).translation - data.origin;
            for body in model.ancestors(frame) {
                let column = model.bodies()[body].joint;
                rows[(0, column)] += weight.dot(&data.screw[body].shifted_to(&point).linear);
            }
        }
    }

    fn bias(&self, model: &Model, data: &Data) -> Vector6<f64> {
        let Some(geometry) = self.geometry(model, data) else {
            return Vector6::zeros();
        };
        let frames = [self.shoulder, self.elbow, self.wrist];
        let [shoulder, elbow, wrist] = frames.map(|frame| frame_velocity(model, data, frame).linear);
        let (da, dw) = (elbow - shoulder, wrist - shoulder);
        let [shoulder, elbow, wrist] = frames.map(|frame| frame_bias_acceleration(model, data, frame).linear);
        let (dda, ddw) = (elbow - shoulder, wrist - shoulder);
        let [by_a, by_w] = geometry.weights(&self.direction);
        let [dby_a, dby_w] = geometry.weight_rates(&self.direction, &da, &dw);
        let bias = by_a.dot(&dda) + by_w.dot(&ddw) + dby_a.dot(&da) + dby_w.dot(&dw);
        Vector6::x() * (geometry.fade * bias)
    }

    /// Difference along the shorter direction of rotation, rad.
    fn difference(&self, _row: usize, to: f64, from: f64) -> f64 {
        let difference = (to - from).rem_euclid(TAU);
        if difference > PI { difference - TAU } else { difference }
    }

    fn element(&self, _row: usize) -> (&'static str, &'static str) {
        ("swivel", "rad")
    }
}

//! Tables of metrics: of a run, of its tasks and of its joints.

use opspace_control::AXIS_NAMES;
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeMap;

/// Metrics of a run; a metric that does not apply to the run is `None`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Metrics {
    /// Errors of the pose of the first task that has some.
    #[serde(flatten)]
    pub pose: PoseErrors,
    /// Error of the first joint task, rms over time and revolute joints, rad.
    pub joint_rms_rad: Option<f64>,
    /// Contact of the first task with force axes.
    #[serde(flatten)]
    pub contact: Contact,
    /// Compliance of the first task with compliant axes.
    #[serde(flatten)]
    pub compliance: Compliance,
    /// Acceleration that limits take from the first task.
    #[serde(flatten)]
    pub slack: Slack,
    /// True force of the simulated hand over the axes that it reports, rms, N.
    pub hand_force_rms_n: Option<f64>,
    /// Error of the estimated force, norm of all components, rms over time, N; of several, the largest.
    pub estimate_rms_n: Option<f64>,
    /// Depth of the peg in the first hole of the environment at the end, m.
    pub hole_depth_m: Option<f64>,
    /// Largest opening of the first drawer of the environment, m.
    pub drawer_opening_max_m: Option<f64>,
    /// Displacement of the simulated hand's frame from the start over the axes that the hand reports, rms, m.
    pub hand_motion_rms_m: Option<f64>,
    /// Error of the motor torque at servo rate, relative to the desired torque.
    pub torque_error_servo: Option<f64>,
    /// Error of the mean motor torque over each interface interval, relative to the desired torque.
    pub torque_error_interval: Option<f64>,
    /// Error of the motor torque in the first servo period of each interface cycle, relative to the desired torque.
    pub torque_error_tick: Option<f64>,
    /// Torque error within the interface intervals, √(e_servo² − e_interval²) in Nm, relative to the ripple that a
    /// held setpoint inevitably causes there at the speeds of the run; `None` if no setpoint is held.
    pub hold_ripple: Option<f64>,
    /// Highest speed of a position setpoint, rad/s.
    pub setpoint_speed_max_rad_per_s: Option<f64>,
    /// Highest acceleration of a velocity setpoint, rad/s².
    pub setpoint_acceleration_max_rad_per_s2: Option<f64>,
    /// Number of setpoints that a drive clamped or refused because of its limits, from the start of control, of all joints;
    /// `None` if the drives have none.
    pub setpoints_limited: Option<u64>,
    /// Fraction of interface cycles in which a desired torque was saturated.
    pub torque_saturated_share: Option<f64>,
    /// Largest torque that the controller commanded to a joint, before saturation, Nm.
    pub torque_commanded_max_nm: Option<f64>,
    /// Largest change of a commanded torque from one interface cycle to the next, Nm.
    pub torque_step_max_nm: Option<f64>,
    /// Highest speed of a joint, rad/s.
    pub speed_max_rad_per_s: Option<f64>,
    /// Fraction of interface cycles in which a limit changed the command.
    pub limited_share: Option<f64>,
    /// Fraction of control cycles in which a task was damped near a singular pose.
    pub damped_fraction: Option<f64>,
    /// Smallest distance of two links, or of a link and an obstacle, that the controller keeps apart, m; at most the
    /// distance beyond which it computes none.
    pub least_distance_m: Option<f64>,
    /// Fraction of interface cycles that were missed during control.
    pub missed_fraction: Option<f64>,
    /// Desired torque above 8 Hz of the joint with the most, rms, Nm.
    pub torque_chatter_rms_nm: Option<f64>,
    /// Frequency of the largest line of that torque above 8 Hz, Hz; `None` if its spectrum only falls from 8 Hz on.
    pub torque_chatter_hz: Option<f64>,
    /// Largest `torque_error_of_limit` of a joint: the rms error of the mean motor torque relative to the torque limit.
    pub torque_error_of_limit_max: Option<f64>,
}

/// Computing times of a run; they are not reproducible.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Timing {
    /// Median duration of a control cycle with estimator, model, control and transformer, ns.
    #[serde(deserialize_with = "nan_if_null")]
    pub tick_ns_median: f64,
    /// Duration of a control cycle with estimator, model, control and transformer, 99th percentile, ns.
    #[serde(deserialize_with = "nan_if_null")]
    pub tick_ns_p99: f64,
    /// Largest duration of a control cycle with estimator, model, control and transformer, ns.
    #[serde(deserialize_with = "nan_if_null")]
    pub tick_ns_max: f64,
    /// Ratio of robot time to wall-clock time.
    pub realtime_factor: Option<f64>,
}

/// Metrics of a run as a whole, of each of its tasks, and of each joint of the robot.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Evaluation {
    /// Metrics of the run.
    pub metrics: Metrics,
    /// Metrics of the tasks that have a priority at the start, by name.
    pub tasks: BTreeMap<String, TaskMetrics>,
    /// Metrics of the joints, by name.
    pub joints: BTreeMap<String, JointMetrics>,
}

/// Metrics of one task; a metric that does not apply to the task is `None`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct TaskMetrics {
    /// Kind of the task, as in its file.
    pub kind: String,
    /// Errors of the pose.
    #[serde(flatten)]
    pub pose: PoseErrors,
    /// Error of a joint task, rms over time and revolute joints, rad.
    pub joint_rms_rad: Option<f64>,
    /// Errors of the joints of a joint task, or of the elements of a coordinate.
    pub elements: Vec<ElementError>,
    /// Contact of the force axes.
    #[serde(flatten)]
    pub contact: Contact,
    /// Compliance of the compliant axes.
    #[serde(flatten)]
    pub compliance: Compliance,
    /// Acceleration that limits take from the task.
    #[serde(flatten)]
    pub slack: Slack,
    /// Errors along single motion axes of a Cartesian task or of the centre of mass, and ranges of its motion along x, y and z, each
    /// by the name of the metric: `x_rms_m`, `rx_max_rad`, `x_range_m`. Those that the task does not have are absent.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub axes: BTreeMap<String, f64>,
}

/// Names of the errors along an axis: rms and largest.
pub(crate) fn error_names(axis: usize) -> [String; 2] {
    let unit = if axis < 3 { "m" } else { "rad" };
    ["rms", "max"].map(|quantity| format!("{}_{quantity}_{unit}", AXIS_NAMES[axis]))
}

/// Name of the range of motion along an axis of translation.
pub(crate) fn range_name(axis: usize) -> String {
    format!("{}_range_m", AXIS_NAMES[axis])
}

/// Error of a joint or of an element of a coordinate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct ElementError {
    /// Name of the joint or element.
    pub name: String,
    /// Unit of the errors.
    pub unit: String,
    /// Error, rms.
    #[serde(deserialize_with = "nan_if_null")]
    pub rms: f64,
    /// Largest magnitude of the error.
    #[serde(deserialize_with = "nan_if_null")]
    pub max: f64,
}

/// Metrics of one joint; a metric that does not apply to the run is `None`. For a prismatic joint read N for Nm.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct JointMetrics {
    /// Error of the mean motor torque over each interface interval, rms, Nm.
    pub torque_error_rms_nm: Option<f64>,
    /// `torque_error_rms_nm` relative to the torque limit of the joint.
    pub torque_error_of_limit: Option<f64>,
    /// `torque_error_rms_nm` relative to the rms of the desired torque of this joint.
    pub torque_error_of_desired: Option<f64>,
    /// Desired torque above 8 Hz, rms, Nm.
    pub torque_chatter_rms_nm: Option<f64>,
    /// Frequency of the largest line of the desired torque above 8 Hz, Hz; `None` if its spectrum only falls from 8 Hz on.
    pub torque_chatter_hz: Option<f64>,
    /// Fraction of interface cycles in which the desired torque was saturated.
    pub torque_saturated_fraction: Option<f64>,
}

/// Errors of a controlled frame over the motion axes of its task; `None` without such axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct PoseErrors {
    /// Distance from the reference, rms, m.
    pub position_rms_m: Option<f64>,
    /// Largest distance from the reference, m.
    pub position_max_m: Option<f64>,
    /// Angle from the reference, rms, rad.
    pub orientation_rms_rad: Option<f64>,
    /// Largest angle from the reference, rad.
    pub orientation_max_rad: Option<f64>,
    /// Distance from the reference at the end of the run, m; `None` if the reference moves there.
    pub position_final_m: Option<f64>,
    /// Angle from the reference at the end of the run, rad; `None` if the reference moves there.
    pub orientation_final_rad: Option<f64>,
}

/// True contact force over the force axes of a task; `None` without such axes, or without a true state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Contact {
    /// Error of the force, rms, N; `None` if the target is streamed and not logged.
    pub force_rms_n: Option<f64>,
    /// Error of the force while the references of the motion axes rest, rms, N.
    pub force_hold_rms_n: Option<f64>,
    /// Error of the force while the references of the motion axes move, rms, N.
    pub force_moving_rms_n: Option<f64>,
    /// Time from the first contact until the error has been below 1 N for half a second, s.
    pub force_settle_s: Option<f64>,
    /// Error of the force in the last half second, if the task controls a force at the end, rms, N.
    pub force_final_n: Option<f64>,
    /// Fraction of the time after settling with contact (more than 0.1 N).
    pub in_contact_fraction: Option<f64>,
    /// Time from the start of control to the first contact, s.
    pub contact_begin_s: Option<f64>,
    /// Largest force in the first second of contact, N.
    pub contact_peak_n: Option<f64>,
    /// Number of times that contact was lost.
    pub contact_losses: Option<u64>,
    /// Number of times that contact was lost later than a second after the first contact.
    pub late_contact_losses: Option<u64>,
    /// Number of times that contact was lost according to the sensor of the task.
    pub sensed_contact_losses: Option<u64>,
    /// Time for which the passivity control of the force feedback has reduced its gains, s.
    pub passivity_active_s: Option<f64>,
}

/// Motion of a controlled frame over the compliant axes of its task; `None` without such axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Compliance {
    /// Displacement along the compliant axes, each from the position at which it became compliant, rms, m.
    pub compliant_motion_rms_m: Option<f64>,
    /// Work of the environment on the robot along the compliant axes after settling, J; `None` without an object that acts on the frame.
    pub compliant_work_j: Option<f64>,
}

/// Acceleration that limits take from a task: that of the command without limits minus that of the command, norm over the
/// axes or joints of one unit, and zero for axes that are not in the task; `None` without joints of the unit, and without torque
/// control. Of a task of all joints, only the part in the null space of the other tasks counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Slack {
    /// Slack of translations and prismatic joints, rms, m/s².
    pub slack_rms_m_per_s2: Option<f64>,
    /// Slack of translations and prismatic joints, largest, m/s².
    pub slack_max_m_per_s2: Option<f64>,
    /// Slack of rotations and revolute joints, rms, rad/s².
    pub slack_rms_rad_per_s2: Option<f64>,
    /// Slack of rotations and revolute joints, largest, rad/s².
    pub slack_max_rad_per_s2: Option<f64>,
}

/// Reads a number that is written as `null` if it is not a number.
fn nan_if_null<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f64::NAN))
}

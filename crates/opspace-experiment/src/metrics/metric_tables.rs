//! Tables of metrics: of a run, of its tasks and of its joints. Each metric is declared here once.

use crate::metrics::metric::{Better, Column, Metric, Needs, metric_table};
use opspace_control::AXIS_NAMES;
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeMap;

metric_table! {
    /// Metrics of a run; a metric that does not apply to the run is `None`.
    Metrics {
        [
            /// Errors of the pose of the first task that has some.
            pose: PoseErrors
        ];
        joint_rms_rad: f64, Smaller,
            Some(Column::new("joint-rms", "joint error rms", "mrad", 1e3).needs(Needs::JointTracking).by_default()),
            "Error of the first joint task, rms over time and revolute joints, rad.";
        [
            /// Contact of the first task with force axes.
            contact: Contact
        ];
        [
            /// Compliance of the first task with compliant axes.
            compliance: Compliance
        ];
        [
            /// Response of the first task whose frame external forces push, or else of a frame that no task controls.
            response: ForceResponse
        ];
        [
            /// Acceleration that limits take from the first task.
            slack: Slack
        ];
        hand_force_rms_n: f64, Smaller,
            Some(Column::new("hand-force", "operator force rms", "N", 1.0).needs(Needs::Operator).by_default()),
            "True force of the simulated hand over the axes that it reports, rms, N.";
        estimate_rms_n: f64, Smaller, None,
            "Error of the estimated force (`[estimated_force]` of robot.toml), norm of all components against the true force of \
             the environment on its link, rms over time, N; of several, the largest.";
        hole_depth_m: f64, Larger, None,
            "Depth of the peg in the first hole of the environment at the end, m.";
        drawer_opening_max_m: f64, Neither, None,
            "Largest opening of the first drawer of the environment, m.";
        hand_motion_rms_m: f64, Neither,
            Some(Column::new("hand-motion", "hand motion rms", "mm", 1e3).needs(Needs::Operator).by_default()),
            "Displacement of the simulated hand's frame from the start over the axes that the hand reports, rms, m.";
        torque_error_servo: f64, Smaller,
            Some(Column::new("torque-error-servo", "torque error servo", "%", 1e2).needs(Needs::Torque).by_default()),
            "Motor torque minus desired torque over all joints at servo rate, rms, relative to the rms of the desired torque.";
        torque_error_interval: f64, Smaller,
            Some(Column::new("torque-error-interval", "torque error interval", "%", 1e2).needs(Needs::Torque).by_default()),
            "The same of the means over each interval between two setpoints.";
        torque_error_tick: f64, Smaller,
            Some(Column::new("torque-error-tick", "torque error tick", "%", 1e2).needs(Needs::Torque).by_default()),
            "The same in the first servo period after each control cycle.";
        hold_ripple: f64, Smaller,
            Some(Column::new("hold-ripple", "hold ripple", "×", 1.0).needs(Needs::TorqueToPosition)),
            "Torque error within the interface intervals, √(e_servo² − e_interval²) in Nm, relative to the ripple that a \
             held setpoint inevitably causes there at the speeds of the run; `None` if no setpoint is held.";
        setpoint_speed_max_rad_per_s: f64, Neither, None,
            "Highest speed of a position setpoint, rad/s.";
        setpoint_acceleration_max_rad_per_s2: f64, Neither, None,
            "Highest acceleration of a velocity setpoint, rad/s².";
        setpoints_limited: u64, Smaller, None,
            "Number of setpoints that a drive clamped or refused because of its `setpoint_limits`, of all joints and the whole \
             run; `None` if the simulated drives have no such limits.";
        setpoints_clamped: u64, Smaller, None,
            "Number of setpoints that the control loop clamped, of all joints: those further from the measured state than the servo's \
             full torque explains, and steps of a position beyond the joint's speed limit.";
        torque_saturated_share: f64, Smaller, None,
            "Fraction of interface cycles in which a desired torque was saturated.";
        torque_commanded_max_nm: f64, Neither,
            Some(Column::new("torque-max", "torque max", "N·m", 1.0).needs(Needs::Torque)),
            "Largest torque that the controller commanded to a joint, before saturation, Nm.";
        torque_step_max_nm: f64, Smaller,
            Some(Column::new("torque-step-max", "torque step max", "N·m", 1.0).needs(Needs::Torque)),
            "Largest change of a commanded torque from one interface cycle to the next, Nm.";
        speed_max_rad_per_s: f64, Neither, Some(Column::new("speed-max", "speed max", "rad/s", 1.0)),
            "Highest speed of a joint, rad/s.";
        limited_share: f64, Neither, Some(Column::new("limited", "limited", "%", 1e2)),
            "Fraction of interface cycles in which a limit changed the command.";
        damped_fraction: f64, Smaller, Some(Column::new("damped", "damped", "%", 1e2)),
            "Fraction of control cycles in which a task was damped near a singular pose.";
        least_distance_m: f64, Neither, None,
            "Smallest distance of two links, or of a link and an obstacle, that the controller keeps apart, m; at the measured \
             positions, and at most the distance beyond which it computes none.";
        missed_fraction: f64, Smaller, Some(Column::new("missed", "missed cycles", "%", 1e2)),
            "Fraction of interface cycles that were missed during control.";
        torque_chatter_rms_nm: f64, Smaller,
            Some(Column::new("torque-chatter", "desired torque above 8 Hz, rms", "N·m", 1.0)),
            "Desired torque above 8 Hz of the joint with the most, rms, Nm.";
        torque_chatter_hz: f64, Neither, None,
            "Frequency of the largest line of that torque above 8 Hz, Hz; `None` if its spectrum only falls from 8 Hz on.";
        torque_error_of_limit_max: f64, Smaller,
            Some(Column::new("torque-error-of-limit", "torque error of limit", "%", 1e2).needs(Needs::Torque)),
            "Largest `torque_error_of_limit` of a joint: the rms error of the mean motor torque relative to the torque \
             limit.";
        (
            /// Metrics that the program has added, by their keys.
            #[serde(flatten)]
            added: BTreeMap<String, Option<f64>>
        );
    }
}

impl Metrics {
    /// Returns a metric by its key, an added one too.
    #[must_use]
    pub fn get(&self, key: &str) -> Option<f64> {
        self.value(key).or_else(|| self.added.get(key).copied().flatten())
    }
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

impl Timing {
    /// Rows of the computing times that have a column.
    #[must_use]
    pub fn rows() -> Vec<Metric> {
        let cycle = Column::new("tick-time", "cycle time", "µs", 1e-3).by_default();
        let rate = Column::new("real-time", "times real time", "", 1.0).by_default();
        vec![
            Metric::row(
                "tick_ns_median",
                Better::Smaller,
                Some(cycle),
                "Median duration of a control cycle, ns.",
            ),
            Metric::row(
                "realtime_factor",
                Better::Larger,
                Some(rate),
                "Ratio of robot time to wall-clock time.",
            ),
        ]
    }

    /// Returns one of these by its key.
    #[must_use]
    pub fn value(&self, key: &str) -> Option<f64> {
        match key {
            "tick_ns_median" => Some(self.tick_ns_median),
            "realtime_factor" => self.realtime_factor,
            _ => None,
        }
    }
}

/// Metrics of a run as a whole, of each of its tasks, and of each joint of the robot.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Evaluation {
    /// Metrics of the run.
    pub metrics: Metrics,
    /// Metrics of the tasks that have a priority at the start, by name.
    pub tasks: BTreeMap<String, TaskMetrics>,
    /// Response to external forces of frames that no Cartesian task controls, by the name of the frame: metrics along the axes of
    /// the world by their names, `x_force_max_n`.
    pub frames: BTreeMap<String, BTreeMap<String, f64>>,
    /// Metrics of the joints, by name.
    pub joints: BTreeMap<String, JointMetrics>,
}

metric_table! {
    /// Metrics of one task; a metric that does not apply to the task is `None`.
    TaskMetrics {
        (
            /// Kind of the task, as in its file.
            kind: String
        );
        [
            /// Errors of the pose.
            pose: PoseErrors
        ];
        joint_rms_rad: f64, Smaller,
            None,
            "Error of a joint task, rms over time and revolute joints, rad.";
        (
            /// Errors of the joints of a joint task, or of the elements of a coordinate.
            elements: Vec<ElementError>
        );
        [
            /// Contact of the force axes.
            contact: Contact
        ];
        [
            /// Compliance of the compliant axes.
            compliance: Compliance
        ];
        [
            /// Response of the frame to external forces.
            response: ForceResponse
        ];
        [
            /// Acceleration that limits take from the task.
            slack: Slack
        ];
        (
            /// Errors along single motion axes of a Cartesian task or of the centre of mass, ranges of its motion along x, y and z, and its
            /// response to external forces, each by the name of the metric: `x_rms_m`, `rx_max_rad`, `x_range_m`, `x_stiffness_n_per_m`.
            /// Those that the task does not have are absent.
            #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
            axes: BTreeMap<String, f64>
        );
    }
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

/// Names of the response to external forces along an axis of translation: largest force, largest deflection, stiffness, hysteresis,
/// displacement that is left at the end, and the stiffness of the task's impedance.
pub(crate) fn response_names(axis: usize) -> [String; 6] {
    [
        "force_max_n",
        "deflection_max_m",
        "stiffness_n_per_m",
        "hysteresis_m",
        "return_m",
        "desired_stiffness_n_per_m",
    ]
    .map(|quantity| format!("{}_{quantity}", AXIS_NAMES[axis]))
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

metric_table! {
    /// Metrics of one joint; a metric that does not apply to the run is `None`. For a prismatic joint read N for Nm.
    JointMetrics {
        torque_error_rms_nm: f64, Smaller, None,
            "Error of the mean motor torque over each interface interval, rms, Nm.";
        torque_error_of_limit: f64, Smaller, None,
            "`torque_error_rms_nm` relative to the torque limit of the joint.";
        torque_error_of_desired: f64, Smaller, None,
            "`torque_error_rms_nm` relative to the rms of the desired torque of this joint.";
        torque_chatter_rms_nm: f64, Smaller, None,
            "Desired torque above 8 Hz, rms, Nm: mean spectrum of blocks of 4 s with a Hann window that overlap by half, the \
             last one by more, so that all samples count. Planned motion and friction compensation contribute, not only \
             chatter.";
        torque_chatter_hz: f64, Neither, None,
            "Frequency of the largest line of the desired torque above 8 Hz, Hz; `None` if its spectrum only falls from 8 \
             Hz on.";
        torque_saturated_fraction: f64, Smaller, None,
            "Fraction of interface cycles in which the desired torque was saturated.";
    }
}

metric_table! {
    /// Errors of a controlled frame over the motion axes of its task; `None` without such axes.
    #[derive(Copy)]
    PoseErrors {
        position_rms_m: f64, Smaller,
            Some(Column::new("position-rms", "position error rms", "mm", 1e3).needs(Needs::Pose).by_default()),
            "Distance from the reference over the motion axes, rms, m.";
        position_max_m: f64, Smaller,
            Some(Column::new("position-max", "position error max", "mm", 1e3).needs(Needs::Pose)),
            "Largest distance from the reference, m.";
        orientation_rms_rad: f64, Smaller,
            Some(Column::new("orientation-rms", "orientation error rms", "mrad", 1e3).needs(Needs::Pose)),
            "Angle from the reference over the motion axes, rms, rad.";
        orientation_max_rad: f64, Smaller,
            Some(Column::new("orientation-max", "orientation error max", "mrad", 1e3).needs(Needs::Pose)),
            "Largest angle from the reference, rad.";
        position_final_m: f64, Smaller, None,
            "Distance from the reference at the end of the run, m; `None` if the reference moves there. That of an impedance \
             includes its deflection.";
        orientation_final_rad: f64, Smaller, None,
            "Angle from the reference at the end of the run, rad; `None` if the reference moves there. That of an impedance \
             includes its deflection.";
    }
}

metric_table! {
    /// True contact force over the force axes of a task; `None` without such axes, or without a true state.
    #[derive(Copy)]
    Contact {
        force_rms_n: f64, Smaller,
            Some(Column::new("force-rms", "force error rms", "N", 1.0).needs(Needs::Frame).by_default()),
            "Error of the true contact force over the force axes, from `settle_s` after the task has begun to control it, rms, N; \
             `None` if the target is streamed and not logged. While the target ramps in, the error is that from the ramped \
             target; this holds for all errors of the force.";
        force_error_max_n: f64, Smaller,
            Some(Column::new("force-error-max", "force error max", "N", 1.0).needs(Needs::Frame)),
            "Largest error of the force in the time of `force_rms_n`, N.";
        force_hold_rms_n: f64, Smaller,
            Some(Column::new("force-hold", "force error rms at rest", "N", 1.0)),
            "Error of the force while the references of the motion axes rest, rms, N.";
        force_moving_rms_n: f64, Smaller,
            Some(Column::new("force-moving", "force error rms in motion", "N", 1.0)),
            "Error of the force while the references of the motion axes move, rms, N.";
        force_settle_s: f64, Smaller, None,
            "Time from the first contact until the beginning of the first half second in which the error stays below 1 N, s. \
             It tells how soon the force follows its ramp; add `ramp_s` for the time at which it has its last value.";
        force_final_n: f64, Smaller, None,
            "Error of the force in the last half second, if the task controls a force at the end, rms, N.";
        in_contact_fraction: f64, Larger,
            Some(Column::new("in-contact", "in contact", "%", 1e2).needs(Needs::Frame).by_default()),
            "Fraction of the time after settling with contact (more than 0.1 N).";
        contact_begin_s: f64, Neither, None,
            "Time from the start of control to the first contact, s.";
        contact_peak_n: f64, Smaller,
            Some(Column::new("contact-peak", "force max in first second of contact", "N", 1.0).needs(Needs::Frame)),
            "Largest force in the first second of contact, N. A soft surface may not have its largest force by then.";
        contact_losses: u64, Smaller, None,
            "Number of times that contact was lost.";
        late_contact_losses: u64, Smaller, None,
            "Number of times that contact was lost later than a second after the first contact.";
        sensed_contact_losses: u64, Smaller, None,
            "Number of times that contact was lost according to the sensor of the task.";
        passivity_active_s: f64, Neither, None,
            "Time for which the passivity control of the force feedback has reduced its gains, s.";
    }
}

metric_table! {
    /// Motion of a controlled frame over the compliant axes of its task; `None` without such axes.
    #[derive(Copy)]
    Compliance {
        compliant_motion_rms_m: f64, Neither,
            Some(Column::new("compliant-motion", "compliant motion rms", "mm", 1e3).needs(Needs::Frame)),
            "Displacement along the compliant axes, each from the position at which it became compliant, rms, m.";
        compliant_work_j: f64, Neither, None,
            "Work of the environment on the robot along the compliant axes after settling, J; `None` without an object \
             that acts on the frame.";
    }
}

metric_table! {
    /// Response of a frame to external forces, along that axis of its task on which the largest force acts; axes with a stiffness
    /// come first. `None` if nothing pushes the frame, and for tasks that control a force.
    #[derive(Copy)]
    ForceResponse {
        external_force_max_n: f64, Neither,
            Some(Column::new("external-force", "external force max", "N", 1.0).needs(Needs::Frame)),
            "Largest external force on the frame along the axis of the task on which the largest force acts, of the axes that have \
             a stiffness, or of all if none has one, N. The four metrics below are those of the same axis.";
        deflection_max_m: f64, Neither,
            Some(Column::new("deflection", "deflection max", "mm", 1e3).needs(Needs::Frame)),
            "Largest displacement of the frame along that axis since `settle_s`, m: of its deviation from the reference on a motion \
             axis, of its position on others.";
        stiffness_n_per_m: f64, Neither,
            Some(Column::new("stiffness", "stiffness", "N/m", 1.0).needs(Needs::Frame)),
            "Stiffness along that axis, N/m: the ratio of the standard deviations of force and displacement while a force \
             acts, so that friction and damping count as little as possible; `None` if the two are not correlated.";
        hysteresis_m: f64, Smaller,
            Some(Column::new("hysteresis", "hysteresis", "mm", 1e3).needs(Needs::Frame)),
            "Largest difference of the displacement at one force, while it rises and while it falls, m.";
        return_m: f64, Smaller,
            Some(Column::new("return", "displacement at the end", "mm", 1e3).needs(Needs::Frame)),
            "Displacement along that axis at the end of the run, m; `None` if a force acts there.";
    }
}

metric_table! {
    /// Acceleration that limits take from a task: that of the command without limits minus that of the command, norm over the
    /// axes or joints of one unit, and zero for axes that are not in the task; `None` without joints of the unit, and without torque
    /// control. Of a task of all joints, only the part in the null space of the other tasks counts.
    #[derive(Copy)]
    Slack {
        slack_rms_m_per_s2: f64, Neither,
            Some(Column::new("slack", "slack rms", "m/s²", 1.0).needs(Needs::Torque)),
            "Slack of translations and prismatic joints, rms, m/s².";
        slack_max_m_per_s2: f64, Neither, None,
            "Slack of translations and prismatic joints, largest, m/s².";
        slack_rms_rad_per_s2: f64, Neither,
            Some(Column::new("angular-slack", "angular slack rms", "rad/s²", 1.0).needs(Needs::Torque)),
            "Slack of rotations and revolute joints, rms, rad/s².";
        slack_max_rad_per_s2: f64, Neither, None,
            "Slack of rotations and revolute joints, largest, rad/s².";
    }
}

/// Reads a number that is written as `null` if it is not a number.
fn nan_if_null<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f64::NAN))
}

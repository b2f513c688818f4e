//! Names of the signals of a run, for those who write them and those who read them.
//!
//! Shapes and units are those of revolute joints; prismatic ones have m, m/s and N.

use crate::signal::SignalName;

/// Channel of the control loop: a row per interface cycle.
pub const TICK_CHANNEL: &str = "tick";
/// Channel of the true state of a simulation: a row per interface cycle.
pub const TRUTH_CHANNEL: &str = "truth";
/// Channel of the drives of a simulation: a row per servo tick.
pub const SERVO_CHANNEL: &str = "servo";
/// Channel of the external forces on a simulation: a row per interface cycle.
pub const EXTERNAL_CHANNEL: &str = "external";

/// Wall-clock duration of a step, ns. It differs from run to run.
pub const TICK_TIME: &str = "tick_time";
/// 1 in the cycle in which a stop was requested.
pub const STOP_REQUESTED: &str = "stop_requested";
/// 1 in the row of a device fault, which came in place of a sample.
pub const DEVICE_FAILED: &str = "device_failed";

/// Code of the phase of the control loop.
pub const PHASE: &str = "phase";
/// Code of the fault that stopped the run; 0 before.
pub const FAULT: &str = "fault";
/// Interface cycles missed before this one.
pub const MISSED_CYCLES: &str = "missed_cycles";
/// Joint positions (n; rad): measured ones, true ones in a simulation's state.
pub const Q: &str = "q";
/// Joint velocities (n; rad/s): estimated ones, true ones in a simulation's state.
pub const DQ: &str = "dq";
/// Joint velocities that the robot measures (n; rad/s).
pub const DQ_MEASURED: &str = "dq_measured";
/// Torques of the motors (n; Nm).
pub const MOTOR_TORQUE: &str = "motor_torque";
/// Torques that joint torque sensors measure (n; Nm).
pub const JOINT_TORQUE: &str = "joint_torque";
/// Status word of the robot.
pub const STATUS: &str = "status";
/// 1 if the robot limited the last command.
pub const DEVICE_LIMITED: &str = "device_limited";
/// Command of the controller (n; Nm, rad/s or rad).
pub const COMMAND: &str = "command";
/// Torques that the motors are to produce (n; Nm).
pub const TORQUE_DESIRED: &str = "torque_desired";
/// 1 for each joint whose desired torque was clamped (n).
pub const TORQUE_SATURATED: &str = "torque_saturated";
/// Setpoints of a position robot (n; rad).
pub const Q_DESIRED: &str = "q_desired";
/// Setpoints of a velocity robot (n; rad/s).
pub const DQ_DESIRED: &str = "dq_desired";
/// Rate of the setpoints of a position robot (n; rad/s).
pub const SETPOINT_SPEED: &str = "setpoint_speed";
/// Rate of the setpoints of a velocity robot (n; rad/s²).
pub const SETPOINT_ACCELERATION: &str = "setpoint_acceleration";
/// 1 for each joint whose setpoint was brought within reach (n).
pub const SETPOINT_CLAMPED: &str = "setpoint_clamped";
/// Limits that each joint is at (n).
pub const LIMITED: &str = "limited";
/// Code of the solver of the limits.
pub const LIMITS_SOLVER: &str = "limits_solver";
/// Number of the task set in force.
pub const TASK_SET: &str = "task_set";

/// Reading of a force sensor, its own axes (6; N, Nm).
pub const RAW: &str = "raw";
/// Tared reading of a force sensor, world axes (6; N, Nm).
pub const WRENCH: &str = "wrench";

/// Reference of a task: position (3; m), elements of a coordinate or joints.
pub const REFERENCE: &str = "reference";
/// Rate of the reference of a task.
pub const REFERENCE_VELOCITY: &str = "reference_velocity";
/// Orientation of the reference, unit quaternion w, x, y, z.
pub const REFERENCE_ORIENTATION: &str = "reference_orientation";
/// Position of the controlled frame (3; m).
pub const POSITION: &str = "position";
/// Velocity of the controlled frame (3; m/s), or of a coordinate.
pub const VELOCITY: &str = "velocity";
/// Orientation of the controlled frame, unit quaternion w, x, y, z.
pub const ORIENTATION: &str = "orientation";
/// Elements of a coordinate.
pub const VALUE: &str = "value";
/// Error of a task: reference minus state.
pub const ERROR: &str = "error";
/// Force of a task on its rows, or force at a contact.
pub const FORCE: &str = "force";
/// Force that a task senses (6; N, Nm).
pub const SENSED_FORCE: &str = "sensed_force";
/// Lowest gain of the damped inverse over the directions of a task; 1 is undamped.
pub const MIN_SINGULAR_GAIN: &str = "min_singular_gain";
/// Code of the mode of each axis of a task (6).
pub const MODES: &str = "modes";
/// 1 while the streamed target of a task is stale.
pub const TARGET_STALE: &str = "target_stale";
/// Age of the streamed target of a task, s.
pub const TARGET_AGE_S: &str = "target_age_s";

/// Name of a quantity of an owner: `hand.position`.
#[must_use]
pub fn of(owner: &str, quantity: &str) -> String {
    SignalName::from((owner, quantity)).to_string()
}

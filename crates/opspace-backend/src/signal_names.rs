//! Names of the signals of a run, shared by the code that records them and the code that reads them.
//!
//! The shapes and units below are those of revolute joints; for prismatic joints read m, m/s and N. n is the number of
//! joints.

use crate::signal::SignalName;

/// Channel of the control loop: a row per interface cycle.
pub const TICK_CHANNEL: &str = "tick";
/// Channel of the wall-clock times of the control loop: a row per computed interface cycle. All that differs between two
/// simulations of the same files, seed and binary is in this channel.
pub const TIMING_CHANNEL: &str = "timing";
/// Channel of the true state of a simulation: a row per interface cycle.
pub const TRUTH_CHANNEL: &str = "truth";
/// Channel of the drives of a simulation: a row per servo tick.
pub const SERVO_CHANNEL: &str = "servo";
/// Channel of the external forces on a simulation: a row per interface cycle.
pub const EXTERNAL_CHANNEL: &str = "external";

/// Wall-clock duration of a control cycle, ns. It differs from run to run.
pub const TICK_TIME: &str = "tick_time";
/// Wall-clock time between the arrivals of this sample and of the one before, ns; NaN in the first cycle.
pub const SAMPLE_INTERVAL: &str = "sample_interval";
/// Wall-clock time from the arrival of the sample until the command is written, ns.
pub const RESPONSE_TIME: &str = "response_time";
/// 1 in the cycle in which a stop was requested.
pub const STOP_REQUESTED: &str = "stop_requested";
/// 1 in the row of a device fault, which is recorded instead of a sample.
pub const DEVICE_FAILED: &str = "device_failed";

/// Code of the phase of the control loop.
pub const PHASE: &str = "phase";
/// Code of the fault that stopped the run; 0 before the fault.
pub const FAULT: &str = "fault";
/// Number of interface cycles missed before this one.
pub const MISSED_CYCLES: &str = "missed_cycles";
/// Joint positions (n; rad): measured; in the true state of a simulation, the true ones.
pub const Q: &str = "q";
/// Joint velocities (n; rad/s): estimated; in the true state of a simulation, the true ones.
pub const DQ: &str = "dq";
/// Joint velocities measured by the robot (n; rad/s).
pub const DQ_MEASURED: &str = "dq_measured";
/// Motor torques at the joints (n; Nm).
pub const MOTOR_TORQUE: &str = "motor_torque";
/// Torques measured by joint torque sensors (n; Nm).
pub const JOINT_TORQUE: &str = "joint_torque";
/// Status word of the robot.
pub const STATUS: &str = "status";
/// 1 if the robot limited the last command.
pub const DEVICE_LIMITED: &str = "device_limited";
/// Command of the controller (n; Nm, rad/s or rad).
pub const COMMAND: &str = "command";
/// Desired motor torques (n; Nm).
pub const TORQUE_DESIRED: &str = "torque_desired";
/// 1 for each joint whose desired torque was clamped (n).
pub const TORQUE_SATURATED: &str = "torque_saturated";
/// Torques of the friction observer (n; Nm).
pub const FRICTION_OBSERVER: &str = "friction_observer";
/// Torques that are compared with the thresholds of a collision (n; Nm).
pub const COLLISION_TORQUE: &str = "collision_torque";
/// Thresholds of a collision (n; Nm).
pub const COLLISION_THRESHOLD: &str = "collision_threshold";
/// Fast changes of the torques that are compared with the thresholds of a collision (n; Nm).
pub const COLLISION_CHANGE: &str = "collision_change";
/// Thresholds of the fast changes (n; Nm).
pub const COLLISION_CHANGE_THRESHOLD: &str = "collision_change_threshold";
/// 1 since a collision was detected.
pub const COLLISION_DETECTED: &str = "collision_detected";
/// Setpoints of a position-controlled robot (n; rad).
pub const Q_DESIRED: &str = "q_desired";
/// Setpoints of a velocity-controlled robot (n; rad/s).
pub const DQ_DESIRED: &str = "dq_desired";
/// Rate of the setpoints of a position-controlled robot (n; rad/s).
pub const SETPOINT_SPEED: &str = "setpoint_speed";
/// Rate of the setpoints of a velocity-controlled robot (n; rad/s²).
pub const SETPOINT_ACCELERATION: &str = "setpoint_acceleration";
/// 1 for each joint whose setpoint was clamped to the largest allowed distance from the measurement (n).
pub const SETPOINT_CLAMPED: &str = "setpoint_clamped";
/// 1 for each joint whose last setpoint was beyond a limit of its drive, which clamped or refused it (n).
pub const SETPOINT_LIMITED: &str = "setpoint_limited";
/// Code of the limits that are active at each joint (n): 1 acceleration, 2 torque, 3 both.
pub const LIMITED: &str = "limited";
/// Code of the solver that enforced the limits.
pub const LIMITS_SOLVER: &str = "limits_solver";
/// Smallest distance of all pairs of links, and of links and obstacles, that the controller keeps apart, m; at most the
/// distance beyond which it computes none.
pub const LEAST_DISTANCE: &str = "least_distance";
/// Number of the active task set.
pub const TASK_SET: &str = "task_set";

/// Raw reading of a force sensor, in its own axes (6; N, Nm).
pub const RAW: &str = "raw";
/// Tared reading of a force sensor, in world axes (6; N, Nm).
pub const WRENCH: &str = "wrench";
/// Estimated bias of a force sensor in its axes (6; N, Nm).
pub const BIAS: &str = "bias";
/// Estimated load beyond a force sensor: mass, and first moment in its axes (4; kg, kg m).
pub const LOAD: &str = "load";
/// Elements of a load.
pub const LOAD_ELEMENTS: [&str; 4] = ["m", "mx", "my", "mz"];
/// 1 while something touches beyond a force sensor, whose estimate then rests.
pub const TOUCHES: &str = "touches";
/// Components of a wrench.
pub const WRENCH_AXES: [&str; 6] = ["fx", "fy", "fz", "mx", "my", "mz"];
/// Torques that the motors, gravity and friction do not explain, from which a force is estimated (n; Nm).
pub const RESIDUAL: &str = "residual";

/// Reference of a task: position (3; m), coordinate, or joint positions.
pub const REFERENCE: &str = "reference";
/// Rate of change of the reference of a task.
pub const REFERENCE_VELOCITY: &str = "reference_velocity";
/// Orientation of the reference of a task, unit quaternion w, x, y, z.
pub const REFERENCE_ORIENTATION: &str = "reference_orientation";
/// Position of the controlled frame; true position of a mass of the environment, or of an object that hands hold (3; m).
pub const POSITION: &str = "position";
/// Velocity of the controlled frame (3; m/s) or of the task coordinate; true velocity of an object that hands hold.
pub const VELOCITY: &str = "velocity";
/// Orientation of the controlled frame, or true orientation of an object that hands hold, unit quaternion w, x, y, z.
pub const ORIENTATION: &str = "orientation";
/// Value of the task coordinate.
pub const VALUE: &str = "value";
/// Error of a task: reference minus state.
pub const ERROR: &str = "error";
/// Task force along the task's rows, or contact force.
pub const FORCE: &str = "force";
/// True moment of a hand's grip on an object, on the robot about the frame's origin, world axes (3; Nm).
pub const MOMENT: &str = "moment";
/// Work that a true contact force has done on the robot since the start of control, J.
pub const WORK: &str = "work";
/// True normal force of an environment object with friction, N.
pub const NORMAL_FORCE: &str = "normal_force";
/// Depth of a peg in a hole of the environment, m; 0 outside.
pub const DEPTH: &str = "depth";
/// Opening of a drawer of the environment, m.
pub const OPENING: &str = "opening";
/// True friction of an environment object on the robot, world axes (3; N).
pub const FRICTION_FORCE: &str = "friction_force";
/// Wrench sensed by a task, which acts ON the robot (6; N, Nm).
pub const SENSED_FORCE: &str = "sensed_force";
/// Target of a task's force axes, with ramps and profiles; 0 on other axes, and while an axis approaches (6; N, Nm).
pub const TARGET_FORCE: &str = "target_force";
/// Axes of a task that turn with a surface, as a quaternion in the coordinates of the controlled frame (4).
pub const AXES: &str = "axes";
/// Contact of a task's force axes: 1 made, 0 while the axis approaches, NaN on other axes (6).
pub const CONTACT: &str = "contact";
/// Energy that the force feedback has given to the motion within its window (6; J).
pub const FORCE_ENERGY: &str = "force_energy";
/// Share of the force gains that the passivity control leaves (6).
pub const FORCE_GAIN_SHARE: &str = "force_gain_share";
/// Time for which the passivity control has reduced the force gains (6; s).
pub const PASSIVITY_TIME: &str = "passivity_time";
/// Smallest gain of the damped inverse over all directions of a task; 1 without damping.
pub const MIN_SINGULAR_GAIN: &str = "min_singular_gain";
/// Acceleration of the fastest joint by which a task escapes from a singular pose, rad/s²; 0 if it does not.
pub const ESCAPE: &str = "escape";
/// Part of the demand of a task at rest that is taken off because its goal cannot be reached, from 0 to 1.
pub const STANDSTILL: &str = "standstill";
/// Acceleration that limits take from a task: that of the command without limits minus that of the command. One value for
/// each of its rows (m/s², rad/s²), or for each joint (n; rad/s²) in the null space of the tasks above.
pub const SLACK: &str = "slack";
/// Energy of the tank that limits the growth of a task's stiffness, J.
pub const TANK: &str = "tank";
/// Stiffness of a task's axes if it varies (6; N/m, Nm/rad).
pub const STIFFNESS: &str = "stiffness";
/// Displacement of a coupled task's rows since the start (rows; m, rad).
pub const DISPLACEMENT: &str = "displacement";
/// Number of the packet that a coupled task sends: its control cycles since the start.
pub const PORT_SEQUENCE: &str = "port_sequence";
/// 1 while a coupled task receives its partner and its clutch is closed.
pub const PORT_CLOSED: &str = "port_closed";
/// 1 while the passivity control of a coupled task reduces its force.
pub const PORT_LIMITED: &str = "port_limited";
/// Energy that has entered the coupling at a coupled task and that its partner may spend, J.
pub const PORT_ENERGY_IN: &str = "port_energy_in";
/// Energy that has left the coupling at a coupled task, J.
pub const PORT_ENERGY_OUT: &str = "port_energy_out";
/// Position that a coupled task sends, in the leader's coordinates (rows; m, rad).
pub const PORT_POSITION: &str = "port_position";
/// Velocity that a coupled task sends, in the leader's coordinates (rows; m/s, rad/s).
pub const PORT_VELOCITY: &str = "port_velocity";
/// Force that a coupled task sends (rows; N, Nm).
pub const PORT_FORCE: &str = "port_force";
/// Time at which a coupled task sends, on its robot's clock, s.
pub const PORT_TIME: &str = "port_time";
/// Time of sending of the newest packet that a coupled task has received, on the partner's clock, s.
pub const PORT_ECHO: &str = "port_echo";
/// Session of a coupled task: the time of its start on its robot's clock, s. NaN before the start.
pub const PORT_SESSION: &str = "port_session";
/// Session of the partner for which the energy and the echo of a coupled task are meant; NaN before the first packet.
pub const PORT_PARTNER_SESSION: &str = "port_partner_session";
/// Integral of the wave variable that a coupled task sends (rows).
pub const PORT_WAVE: &str = "port_wave";
/// Position of the path of a carried object (3; m), as a displacement.
pub const PORT_PATH: &str = "port_path";
/// Velocity of the path of a carried object (3; m/s).
pub const PORT_PATH_VELOCITY: &str = "port_path_velocity";
/// Acceleration of the path of a carried object (3; m/s²).
pub const PORT_PATH_ACCELERATION: &str = "port_path_acceleration";
/// Force with which two hands press on the object that they carry, N.
pub const INTERNAL_FORCE: &str = "internal_force";
/// Number of packets that did not arrive before a later one did.
pub const PACKETS_LOST: &str = "packets_lost";
/// Time since the last packet arrived, s.
pub const PACKET_AGE: &str = "packet_age";
/// Code of the control mode of each axis of a task (6).
pub const MODES: &str = "modes";
/// Cause of a hold that is requested from outside: 0 none, 1 requested, 2 + 2k robot k of the experiment is held or stopped,
/// 3 + 2k nothing arrives from robot k.
pub const TARGET_HOLD: &str = "target.hold";
/// 1 while the streamed target of a task is stale.
pub const TARGET_STALE: &str = "target_stale";
/// Age of the streamed target of a task, s.
pub const TARGET_AGE_S: &str = "target_age_s";

/// Returns the name of an owner's quantity: `hand.position`.
#[must_use]
pub fn of(owner: &str, quantity: &str) -> String {
    SignalName::from((owner, quantity)).to_string()
}

//! Inputs of a running task, as they come from messages. No input and no output.

use crate::frames::{FrameRef, Frames, placement};
use crate::messages::{Float64MultiArray, Header, PoseStamped, Stamp, Text, TwistStamped, WrenchStamped};
use opspace_control::{AXIS_NAMES, AxisMode};
use opspace_model::Placement;

/// Input of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Input {
    /// Pose of a task, in a frame.
    Pose(usize, FrameRef, Placement),
    /// Linear (m/s) and angular velocity (rad/s) of a task, in the axes of a frame.
    Twist(usize, FrameRef, [f64; 6]),
    /// Force (N) and moment (Nm) that the environment should exert ON the robot, in the axes of the task.
    Wrench(usize, [f64; 6]),
    /// Natural frequencies (rad/s) and damping ratios; NaN is as configured.
    Gains(usize, [f64; 6], [f64; 6]),
    /// Modes; `None` is as configured.
    Modes(usize, [Option<AxisMode>; 6]),
    /// Clutch of a task: true if it follows poses.
    Clutch(usize, bool),
    /// Request that the robot is held, or that control goes on.
    Hold(bool),
    /// Number of a task set.
    TaskSet(u32),
}

/// Reads a pose.
///
/// # Errors
/// An unknown frame, a message that is too old, or numbers that are no pose, in words.
pub fn pose(
    task: usize,
    message: &PoseStamped,
    frames: &Frames,
    now: Stamp,
    oldest_s: f64,
) -> Result<Input, String> {
    check_age(&message.header, now, oldest_s)?;
    let frame = frames.find(&message.header.frame_id)?;
    let pose = placement(message.pose.position, message.pose.orientation)
        .ok_or("a pose has a finite position and a quaternion of length 1")?;
    Ok(Input::Pose(task, frame, pose))
}

/// Reads velocities.
///
/// # Errors
/// An unknown frame, a message that is too old, or numbers that are not finite, in words.
pub fn twist(
    task: usize,
    message: &TwistStamped,
    frames: &Frames,
    now: Stamp,
    oldest_s: f64,
) -> Result<Input, String> {
    check_age(&message.header, now, oldest_s)?;
    let frame = frames.find(&message.header.frame_id)?;
    let twist = six(message.twist.linear.into(), message.twist.angular.into())?;
    Ok(Input::Twist(task, frame, twist))
}

/// Reads a force and a moment, which are in the axes of the task.
///
/// # Errors
/// Another frame than none, a message that is too old, or numbers that are not finite, in words.
pub fn wrench(task: usize, message: &WrenchStamped, now: Stamp, oldest_s: f64) -> Result<Input, String> {
    check_age(&message.header, now, oldest_s)?;
    let frame = &message.header.frame_id;
    if !frame.is_empty() {
        return Err(format!("a target wrench is in the axes of its task: its frame is empty, not '{frame}'"));
    }
    let wrench = six(message.wrench.force.into(), message.wrench.torque.into())?;
    Ok(Input::Wrench(task, wrench))
}

/// Reads natural frequencies and damping ratios: six of each; NaN is as configured.
///
/// # Errors
/// Another number of values, in words.
pub fn gains(task: usize, message: &Float64MultiArray) -> Result<Input, String> {
    let values: [f64; 12] = message.data.as_slice().try_into().map_err(|_| {
        format!("gains are 12 numbers, six frequencies and six damping ratios, not {}", message.data.len())
    })?;
    let half = |from: usize| std::array::from_fn(|axis| values[from + axis]);
    Ok(Input::Gains(task, half(0), half(6)))
}

/// Reads modes, for example `x=compliant z=force`; axes that are not named are as configured.
///
/// # Errors
/// An unknown axis or mode, in words.
pub fn modes(task: usize, message: &Text) -> Result<Input, String> {
    let mut modes = [None; 6];
    for part in message.data.split_whitespace() {
        let (axis, mode) = part.split_once('=').ok_or_else(|| format!("'{part}' is no AXIS=MODE"))?;
        let number = AXIS_NAMES.iter().position(|known| *known == axis);
        let number =
            number.ok_or_else(|| format!("unknown axis '{axis}'; the axes are {}", AXIS_NAMES.join(", ")))?;
        let known = AxisMode::IN_TASK.into_iter().find(|known| known.name() == mode);
        let all: Vec<&str> = AxisMode::IN_TASK.into_iter().map(AxisMode::name).collect();
        modes[number] =
            Some(known.ok_or_else(|| format!("unknown mode '{mode}'; the modes are {}", all.join(", ")))?);
    }
    Ok(Input::Modes(task, modes))
}

/// Refuses a message that is older than this, s. One without a stamp has no age.
fn check_age(header: &Header, now: Stamp, oldest_s: f64) -> Result<(), String> {
    let age_s = now.since_s(header.stamp);
    if header.stamp == Stamp::default() || age_s.abs() <= oldest_s {
        return Ok(());
    }
    Err(format!("its stamp is {age_s:.3} s old by this computer's clock, more than target_age_s allows"))
}

fn six(linear: [f64; 3], angular: [f64; 3]) -> Result<[f64; 6], String> {
    let values = std::array::from_fn(|axis| if axis < 3 { linear[axis] } else { angular[axis - 3] });
    match values.iter().all(|value| value.is_finite()) {
        true => Ok(values),
        false => Err("numbers that are not finite".to_owned()),
    }
}

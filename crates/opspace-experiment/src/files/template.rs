//! Templates of the files of a new robot. They list all required values and guess none.

use opspace_model::{Joint, JointKind, Model};
use std::fmt::Write as _;
use toml_edit::{Key, Value};

/// Returns a robot.toml for the joints of a URDF. Values that only the manufacturer knows are commented out.
#[must_use]
pub fn robot_toml(urdf: &str, model: &Model) -> String {
    let mut text = format!(
        r#"#:schema robot.schema.json
# Nominal parameters of {name}.
# A line such as `# gear_ratio =` marks a required value without a default: uncomment it and write the value.
# `opspace check` on this folder names the next missing value. Lines with `##` are notes and optional keys.
urdf = {urdf}
default_profile = "default"

# Interface of the robot.
[interface]
# command =                   # accepted command: "position", "velocity" or "torque"
setpoints = "held"            # commands of position or velocity servos: "held" until the next one, or "interpolated"
gears = "elastic"             # between motors and links: "rigid" only if known to be, "elastic" also if unknown
# gravity_compensated_by =    # "controller", or "robot" if the robot compensates gravity itself
## brakes = true              # if brakes hold a velocity robot without a controller
# measured =                  # ["position"], or ["position", "motor-current"]

## Optional force sensor: `frame` is the URDF link at whose origin and in whose axes it measures.
## [force_sensor.wrist]
## frame = "..."

## Optional tool: adds its mass and a frame of its name at its tip. `opspace schema robot` lists all keys.
## [tool.gripper]
## on = "..."                 # URDF link to which it is attached
## xyz_m = [0.0, 0.0, 0.1]    # position of the tip in the axes of that link
## mass_kg = 0.5
## com_m = [0.0, 0.0, 0.05]   # centre of mass in the axes of that link

# Drives of the joints.
"#,
        name = one_line(model.name()),
        urdf = Value::from(urdf),
    );
    for joint in model.joints() {
        text += &drive(joint);
    }
    text += r"
# Profile: a set of rates and servo parameters of the drives.
[profile.default]
# servo_hz =                  # rate of the servo loops, Hz
# servo_ticks_per_cycle =     # servo ticks per setpoint, a whole number; 5 is written 1:5 in reports
# delay_servo_ticks =         # delay from writing a setpoint until it acts, in servo ticks: a whole number
[profile.default.estimator]
# velocity_filter_hz =        # low-pass filter of velocities computed from measured positions, Hz

# Servos of the drives: torque = kv (kp (q_desired - q) - dq). A velocity robot has, instead or in addition,
# [profile.default.velocity_servo.JOINT] with kv_nms_per_rad, velocity_filter_hz and, if its velocity loop has an
# integral, ki_nm_per_rad: torque = kv (dq_desired - dq) + ki times the integral of that error.
";
    for joint in model.joints() {
        text += &servo(joint);
    }
    text += SIMULATED;
    text
}

/// Template of the parameters of a simulated plant; they apply to all joints.
const SIMULATED: &str = r"
# Simulated plant: parameters in addition to those above. Without this section the robot cannot be simulated.
[simulated]
# physics_hz =                # rate of the plant's integration steps, a whole multiple of servo_hz, Hz
# current_loop_hz =           # bandwidth of the motors' current loop, Hz
# torque_noise_nm =           # noise of the measured motor torque, rms, Nm (N)
[simulated.bristle]           # presliding friction (LuGre)
# stiffness_nm_per_rad =
# damping_nms_per_rad =
# damping_fade_velocity_rad_per_s =
[simulated.end_stop]          # mechanical end stops at the URDF's joint limits
# stiffness_nm_per_rad =
# damping_nms_per_rad =
[simulated.brake]             # brakes that hold a torque robot after a stop
# holding_torque_ratio =      # holding torque over each joint's torque limit
# stiffness_nm_per_rad =
# damping_nms_per_rad =
";

/// Units of a joint: torque, speed and viscous friction, and a description of the gear ratio.
struct Units {
    position: &'static str,
    torque: &'static str,
    speed: &'static str,
    viscous: &'static str,
    gear: &'static str,
}

fn units(joint: &Joint) -> Units {
    match joint.kind {
        JointKind::Revolute | JointKind::Continuous | JointKind::Floating => {
            let gear = "motor turns per joint turn";
            Units { position: "rad", torque: "Nm", speed: "rad/s", viscous: "Nms/rad", gear }
        }
        JointKind::Prismatic => {
            let gear = "motor radians per metre: this joint is prismatic, its values are in N and m";
            Units { position: "m", torque: "N", speed: "m/s", viscous: "Ns/m", gear }
        }
    }
}

fn drive(joint: &Joint) -> String {
    let name = Key::new(&joint.name);
    let Units { position, torque, speed, viscous, gear } = units(joint);
    let effort = joint.limits.effort;
    let lacks = if joint.limits.velocity.is_finite() && joint.limits.velocity > 0.0 {
        String::new()
    } else {
        format!(
            "## This joint has no velocity limit in the URDF: add velocity=\"...\" ({speed}) to its <limit>.\n"
        )
    };
    let said = if effort.is_finite() { format!("; effort in the URDF: {effort}") } else { String::new() };
    format!(
        r"
[joint.{name}]
# torque_limit_nm =           # torque limit of the drive, at the joint, {torque}{said}
[joint.{name}.rotor]
# inertia_kg_m2 =             # inertia of all parts rotating at motor speed, kg m²
# gear_ratio =                # {gear}
# encoder_counts_per_turn =   # encoder counts per motor turn
[joint.{name}.friction]
# coulomb_nm =                # Coulomb friction, {torque}
# static_nm =                 # static (breakaway) friction, at least coulomb_nm, {torque}
# stribeck_rad_per_s =        # Stribeck velocity, of the transition from static to Coulomb friction, {speed}
# viscous_nms_per_rad =       # viscous friction, {viscous}
# presliding_rad =            # displacement over which static friction builds up, {position}; 0.001 if absent
{lacks}"
    )
}

fn servo(joint: &Joint) -> String {
    let Units { viscous, .. } = units(joint);
    format!(
        r"
[profile.default.servo.{name}.cascaded]
# kp_per_s =                  # gain of the position loop, 1/s
# kv_nms_per_rad =            # gain of the velocity loop, {viscous}
# velocity_filter_hz =        # low-pass filter of the servo's velocity, Hz
",
        name = Key::new(&joint.name),
    )
}

/// Replaces the control characters of a name by spaces, so that the name stays on one comment line.
fn one_line(name: &str) -> String {
    name.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}

/// Returns a first task for the robot, which holds its posture with low gains.
#[must_use]
pub fn task_toml(model: &Model) -> String {
    let mut text = String::from(
        r#"#:schema task.schema.json
# Each joint holds its start position like a damped spring.
robot = "."
duration_s = 5.0
settle_s = 1.0
priority = ["posture"]

[task.posture.joint-posture]
frequency_rad_per_s = 6.0
damping_ratio = 1.0

# Start positions of a simulated robot, rad (m): the middle of each joint range, or 0 without limits.
[start_rad]
"#,
    );
    for joint in model.joints() {
        let limits = &joint.limits;
        let bounded = limits.lower.is_finite() && limits.upper.is_finite();
        let start = if bounded { 0.5 * (limits.lower + limits.upper) } else { 0.0 };
        let _ = writeln!(text, "{} = {start:?}", Key::new(&joint.name));
    }
    text
}

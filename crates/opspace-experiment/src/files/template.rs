//! Template files for a user's own robot: they list every value that must be known, and guess none.

use opspace_model::{Joint, JointKind, Model};
use std::fmt::Write as _;
use toml_edit::{Key, Value};

/// Returns a robot.toml for the joints of a URDF. Values that only the robot's maker knows are commented out.
#[must_use]
pub fn robot_toml(urdf: &str, model: &Model) -> String {
    let mut text = format!(
        r#"#:schema robot.schema.json
# {name}: what is believed of the robot.
# A line such as `# gear_ratio =` waits for a value that must be known and that nobody can guess: uncomment it and
# write the value. `opspace check` on this folder names the next one missing.
urdf = {urdf}
default_profile = "default"

# What the robot's interface offers.
[interface]
# command =                   # "position", "velocity" or "torque": what it takes
setpoints = "held"           # until the next one comes
on_missed_cycle = "hold-last"
# gravity_compensated_by =                # "controller", or "robot" if it carries its own weight
## brakes = true              # if brakes hold a velocity robot when no controller commands it
# measured =                  # ["position"], or ["position", "motor-current"]

## A force sensor, if there is one: the URDF link at whose origin and in whose axes it measures.
## [force_sensor.wrist]
## frame = "..."

## What is mounted on it, if anything: its frame has its name, its mass counts. `opspace schema robot` has the rest.
## [tool.gripper]
## on = "..."                 # the URDF link that carries it
## xyz_m = [0.0, 0.0, 0.1]    # its tip, in that link's axes
## mass_kg = 0.5
## com_m = [0.0, 0.0, 0.05]   # its centre of mass, in that link's axes

# The joints' drives.
"#,
        name = one_line(model.name()),
        urdf = Value::from(urdf),
    );
    for joint in model.joints() {
        text += &drive(joint);
    }
    text += r"
# The rates at which the drives are run.
[profile.default]
# servo_hz =                  # at which the drives close their loops, Hz
# ratio =                     # servo ticks per setpoint: a whole number
# delay_servo_ticks =         # from the tick at which a setpoint is written until it acts: a whole number
[profile.default.estimator]
# velocity_filter_hz =        # low-pass on the velocities that are computed from measured positions, Hz

# The drives' servos: torque = kv (kp (q_desired - q) - dq). A robot that takes velocities has, in place of them or beside
# them, [profile.default.velocity_servo.JOINT] with kv_nms_per_rad, velocity_filter_hz and, if its velocity loop has an
# integral, ki_nm_per_rad: torque = kv (dq_desired - dq) + ki times the integral of that error.
";
    for joint in model.joints() {
        text += &servo(joint);
    }
    text += SIMULATED;
    text
}

/// Parameters of a simulated plant. It has no values per joint: a stiffness here applies to all.
const SIMULATED: &str = r"
# The robot's simulation: what its plant is beyond what is believed above. Without it the robot can't be simulated.
[simulated]
# physics_hz =                # steps of the plant: a whole multiple of servo_hz, Hz
# current_loop_hz =           # bandwidth of the motors' current loop, Hz
# torque_noise_nm =           # of the measured motor torque, rms, Nm (N)
[simulated.bristle]           # how friction builds up before a joint slides (LuGre)
# stiffness_nm_per_rad =
# damping_nms_per_rad =
# damping_fade_velocity_rad_per_s =
[simulated.end_stop]          # beyond the URDF's joint limits
# stiffness_nm_per_rad =
# damping_nms_per_rad =
[simulated.brake]             # of a torque robot, when it stops
# holding_torque_ratio =    # as a multiple of each joint's torque limit
# stiffness_nm_per_rad =
# damping_nms_per_rad =
";

/// Units of a joint: of torque, speed, torque per speed, and the gear ratio in words.
struct Units {
    torque: &'static str,
    speed: &'static str,
    viscous: &'static str,
    gear: &'static str,
}

fn units(joint: &Joint) -> Units {
    match joint.kind {
        JointKind::Revolute | JointKind::Continuous | JointKind::Floating => {
            Units { torque: "Nm", speed: "rad/s", viscous: "Nms/rad", gear: "motor turns per joint turn" }
        }
        JointKind::Prismatic => {
            let gear = "motor radians per metre: this joint is prismatic, all is in N and m";
            Units { torque: "N", speed: "m/s", viscous: "Ns/m", gear }
        }
    }
}

fn drive(joint: &Joint) -> String {
    let name = Key::new(&joint.name);
    let Units { torque, speed, viscous, gear } = units(joint);
    let effort = joint.limits.effort;
    let lacks = if joint.limits.velocity.is_finite() && joint.limits.velocity > 0.0 {
        String::new()
    } else {
        format!(
            "## The URDF gives this joint no speed limit: add velocity=\"...\" ({speed}) to its <limit>.\n"
        )
    };
    let said = if effort.is_finite() { format!("; the URDF says effort {effort}") } else { String::new() };
    format!(
        r"
[joint.{name}]
# torque_limit_nm =           # of the drive, at the joint, {torque}{said}
[joint.{name}.rotor]
# inertia_kg_m2 =             # of all that turns at motor speed, kg m²
# gear_ratio =                # {gear}
# encoder_counts_per_turn =   # of the motor
[joint.{name}.friction]
# coulomb_nm =                # while it moves, {torque}
# static_nm =                 # at which it breaks away, {torque}
# stribeck_rad_per_s =        # speed over which the one becomes the other, {speed}
# viscous_nms_per_rad =       # {viscous}
{lacks}"
    )
}

fn servo(joint: &Joint) -> String {
    let Units { viscous, .. } = units(joint);
    format!(
        r"
[profile.default.servo.{name}.cascaded]
# kp_per_s =                  # 1/s
# kv_nms_per_rad =            # {viscous}
# velocity_filter_hz =        # of the servo's own velocity, Hz
",
        name = Key::new(&joint.name),
    )
}

/// Replaces the control characters of a name by spaces, so that it stays on the line of its comment.
fn one_line(name: &str) -> String {
    name.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}

/// Returns a first task for that robot: it holds its posture, softly.
#[must_use]
pub fn task_toml(model: &Model) -> String {
    let mut text = String::from(
        r#"#:schema task.schema.json
# The robot holds the posture in which it starts, as if each joint were on a spring.
robot = "."
duration_s = 5.0
settle_s = 1.0
priority = ["posture"]

[task.posture.joint-posture]
frequency_rad_per_s = 6.0
damping_ratio = 1.0

# Where a simulated robot starts, rad (m): the middle of each joint's range, or 0.
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

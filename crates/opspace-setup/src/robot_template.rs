//! robot.toml of a new robot: one that lists all required values and guesses none, and one with assumed values.

use crate::assumed_bodies::{AssumedBody, BodySource, DENSITIES, numbers};
use crate::assumed_drives::{
    ACCELERATION, AssumedDrive, COULOMB_SHARE, DriveKind, GEAR_RAD_PER_M, HOBBY_KG_M2_PER_NM,
    HOBBY_STEPS_PER_TURN, HOBBY_STIFFNESS_PER_M, HOBBY_STIFFNESS_PER_RAD, HOBBY_VISCOUS_S,
    HOBBY_VISCOUS_S_PER_M, KP_PER_S, LIMIT_OVER_NEED, NEIGHBOUR_SHARE, ROTOR_KG_M2_PER_NM, ROTOR_KG_PER_N,
    VELOCITY_LOOP_HZ, VISCOUS_SHARE, rounded,
};
use opspace_experiment::files::joint_layers::UrdfValue;
use opspace_experiment::files::mount::MountFile;
use opspace_experiment::files::required_keys::{self, Required};
use opspace_experiment::files::robot_part::UsedPart;
use opspace_model::{Joint, JointKind, Model};
use std::f64::consts::TAU;
use std::fmt::Write as _;
use toml_edit::{Key, Value};

/// Robot for which a robot.toml is written.
#[derive(Clone, Copy, Debug)]
pub struct NewRobot<'a> {
    /// File name of the URDF.
    pub urdf: &'a str,
    /// Part of the robot that is used, if not all of it.
    pub used: Option<&'a UsedPart>,
    /// Placement of the base in the world, if it is stated.
    pub mount: Option<&'a MountFile>,
    /// True if mimic joints move with the joints that they mimic.
    pub enforce_mimic: bool,
    /// Joints that are locked, each at a position (rad, m).
    pub locked_joints: &'a [(String, f64)],
    /// Joints that move.
    pub model: &'a Model,
    /// Values of the drives that the URDF states.
    pub stated: &'a [UrdfValue],
    /// Masses and inertias that are assumed.
    pub bodies: &'a [AssumedBody],
}

impl NewRobot<'_> {
    /// Keys about the URDF and the part of it that moves.
    pub(super) fn head(&self) -> String {
        let mut text = format!("urdf = {}\n", Value::from(self.urdf));
        if let Some(UsedPart { from, to }) = self.used {
            let (from, to) = (Value::from(from.as_str()), Value::from(to.as_str()));
            let _ = writeln!(text, "use = {{ from = {from}, to = {to} }}   # the other joints do not move");
        }
        if let Some(mount) = self.mount {
            let _ = writeln!(
                text,
                "mount = {}   # of the base in the world: gravity is along -z of the world",
                mount.toml()
            );
        }
        if !self.locked_joints.is_empty() {
            let joints = self.locked_joints.iter().map(|(name, at)| format!("{} = {at:?}", Key::new(name)));
            let _ = writeln!(text, "locked_joints = {{ {} }}", joints.collect::<Vec<_>>().join(", "));
        }
        if self.enforce_mimic {
            text += "enforce_mimic = true   # mimic joints move with the joints that they mimic\n";
        }
        text
    }

    /// True if the URDF states a value of a joint.
    fn states(&self, joint: &Joint, key: &str) -> bool {
        self.stated.iter().any(|value| value.joint == joint.name && value.key == key)
    }

    /// Notes about the values that the URDF states.
    fn notes(&self) -> String {
        let mut text = String::new();
        for joint in self.model.joints() {
            let of_joint = self.stated.iter().filter(|value| value.joint == joint.name);
            let values: Vec<String> =
                of_joint.map(|v| format!("{} = {:?} ({})", v.key, v.value, v.attribute)).collect();
            if !values.is_empty() {
                let _ = writeln!(text, "## {}: {}", one_line(&joint.name), values.join(", "));
            }
        }
        if text.is_empty() {
            text
        } else {
            format!("## From the URDF; values in this file replace them:\n{text}")
        }
    }
}

/// Returns a robot.toml that guesses nothing. Values that only the manufacturer knows are commented out.
#[must_use]
pub fn robot_toml(robot: &NewRobot<'_>) -> String {
    let joints = robot.model.joints();
    let needs = |key: &str| joints.iter().any(|joint| !robot.states(joint, key));
    let line = |key: &str| if needs(key) { required_line(key) } else { format!("#{}", required_line(key)) };
    let prismatic: Vec<String> = joints
        .iter()
        .filter(|joint| joint.kind == JointKind::Prismatic)
        .map(|joint| one_line(&joint.name))
        .collect();
    let mut text = format!(
        r#"#:schema robot.schema.json
# Nominal parameters of {name}.
# A line such as `# gear_ratio =` marks a required value without a default: uncomment it and write the value.
# `opspace check` on this folder lists all values that are missing. Lines with `##` are notes and optional keys.
{head}
# Interface of the robot.
[interface]
{command}setpoints = "held"            # commands of position or velocity servos: "held" until the next one, or "interpolated"
gears = "elastic"             # between motors and links: "rigid" only if known to be, "elastic" also if unknown
{gravity}## brakes = true              # if brakes hold a velocity robot without a controller
{measured}
## Optional force sensor: `frame` is the URDF link at whose origin and in whose axes it measures.
## [force_sensor.wrist]
## frame = "..."

## Optional tool: adds its mass and a frame of its name at its tip. `opspace schema robot` lists all keys.
## [tool.gripper]
## on = "..."                 # URDF link to which it is attached
## xyz_m = [0.0, 0.0, 0.1]    # position of the tip in the axes of that link
## mass_kg = 0.5
## com_m = [0.0, 0.0, 0.05]   # centre of mass in the axes of that link

# Drives of the joints. These values are those of all joints; [joint.NAME] with the same keys has those of one joint, and
# [group.NAME] with `joints = ["...", "..."]` those of several.
{notes}[joint_defaults]
{limit}{speed}[joint_defaults.rotor]
{inertia}{ratio}## encoder_counts_per_turn =  # encoder counts per motor turn; 16384 if absent
[joint_defaults.friction]
{coulomb}{viscous}## static_nm =                # static (breakaway) friction, Nm; coulomb_nm if absent
## stribeck_rad_per_s =       # velocity of the transition from static to Coulomb friction, rad/s; 0.06 if absent
## presliding_rad =           # displacement over which static friction builds up, rad; 0.001 if absent
"#,
        name = one_line(robot.model.name()),
        head = robot.head(),
        notes = robot.notes(),
        command = required_line("interface.command"),
        gravity = required_line("interface.gravity_compensated_by"),
        measured = required_line("interface.measured"),
        limit = line("torque_limit_nm"),
        speed = if joints.iter().all(has_speed) {
            String::new()
        } else {
            required_line("velocity_limit_rad_per_s")
        },
        inertia = required_line("rotor.inertia_kg_m2"),
        ratio = required_line("rotor.gear_ratio"),
        coulomb = line("friction.coulomb_nm"),
        viscous = line("friction.viscous_nms_per_rad"),
    );
    if !prismatic.is_empty() {
        let _ = write!(
            text,
            "\n## These joints are prismatic; their values are in N and m, and the gear ratio in motor radians per metre. Give\n\
             ## them tables of their own, or a group: {}\n",
            prismatic.join(", ")
        );
    }
    let _ = write!(
        text,
        r"
# Profile: a set of rates and servo parameters of the drives.
[profile.default]
{hz}{ticks}## delay_servo_ticks =        # delay from writing a setpoint until it acts, in servo ticks: a whole number; unknown if absent
[profile.default.estimator]
## velocity_filter_hz =       # low-pass filter of velocities computed from measured positions, Hz; 150 if absent

# Servos of the drives: torque = kv (kp (q_desired - q) - dq); a torque robot needs none. These values are those of all
# joints; [profile.default.servo.NAME.cascaded] has those of a joint or a group. A velocity robot has, instead or in
# addition, [profile.default.velocity_servo.joint_defaults] with kv_nms_per_rad, velocity_filter_hz and, if its velocity
# loop has an integral, ki_nm_per_rad: torque = kv (dq_desired - dq) + ki times the integral of that error.
[profile.default.servo.joint_defaults.cascaded]
{kp}{kv}{filter}
# Simulated plant: parameters in addition to those above. Without this section the robot cannot be simulated.
[simulated]
## physics_hz =               # rate of the plant's integration steps, a whole multiple of servo_hz, Hz
## current_loop_hz =          # bandwidth of the motors' current loop, Hz; no lag if absent
## torque_noise_nm =          # noise of the measured motor torque, rms, Nm (N); 0 if absent
",
        hz = required_line("servo_hz"),
        ticks = required_line("servo_ticks_per_cycle"),
        kp = required_line("cascaded.kp_per_s"),
        kv = required_line("cascaded.kv_nms_per_rad"),
        filter = required_line("cascaded.velocity_filter_hz"),
    );
    text
}

/// Line of a required key that still lacks its value, with the meaning of the key.
fn required_line(key: &str) -> String {
    let found = required_keys::all().find(|required| required.path.join(".") == key);
    found.map_or_else(String::new, Required::line)
}

/// Returns a robot.toml in which all values that the URDF does not state are assumed, and marked as such. `kv` has the gains
/// of the velocity loops (n; Nms/rad, Ns/m).
#[must_use]
pub fn assumed_robot_toml(
    robot: &NewRobot<'_>,
    drives: &[AssumedDrive],
    kv: &[f64],
    payload_kg: f64,
) -> String {
    let mut assumed = vec![vec!["interface".to_owned()]];
    assumed.extend(assumed_links(robot.bodies).map(|key| vec![key]));
    let mut tables = String::new();
    for (joint, drive) in robot.model.joints().iter().zip(drives) {
        let (table, keys) = assumed_joint(robot, joint, drive);
        tables += &table;
        assumed.push(keys);
    }
    assumed.push(vec!["profile.default".to_owned(), "simulated".to_owned()]);
    let mut list = String::new();
    for keys in &assumed {
        let keys: Vec<String> = keys.iter().map(|key| Value::from(key.as_str()).to_string()).collect();
        let _ = writeln!(list, "    {},", keys.join(", "));
    }
    let kind = drives.first().map_or(DriveKind::Industrial, |drive| drive.kind);
    let profile = match kind {
        DriveKind::HobbyServo => hobby_profile(robot, drives),
        DriveKind::Industrial => industrial_profile(robot, kv),
    };
    format!(
        r#"#:schema robot.schema.json
# Nominal parameters of {name}. Values marked [A] are assumed: they are computed from masses, inertias and efforts of the
# URDF, and are those of no particular drive. Results rest on them.
{head}
# Keys whose values are assumed; every table and page lists them. Remove an entry when you have replaced its value by one that
# you know: see `opspace identify` and data sheets.
assumed = [
{list}]

# [A] a position robot that measures positions only{kind}.
[interface]
command = "position"
setpoints = "held"            # or "interpolated"
gears = "elastic"             # "rigid" only if they are known to be
gravity_compensated_by = "controller"
measured = ["position"]       # or ["position", "motor-current"]

{bodies}# Drives of the joints. A joint needs the torque for its weight and for {acceleration} rad/s² (m/s²) with a payload of {payload:.3} kg
# at the tip, and for the friction of the URDF; not less than {neighbour} of what the joint before it needs. The torque limit is the
# effort of the URDF if that is 1 to 30 times the need. Rotor and friction follow from the torque limit.
{notes}{tables}
{profile}
# Choices of opspace, not properties of the arm: torques ramp in, and force sensors are tared, over these times.
[safety]
torque_ramp_s = 0.2
tare_s = 0.2

# [A] bristles of friction, end stops and brakes have their defaults: see `opspace schema robot`.
[simulated]
current_loop_hz = 1000.0
"#,
        name = one_line(robot.model.name()),
        head = robot.head(),
        acceleration = ACCELERATION,
        neighbour = NEIGHBOUR_SHARE,
        bodies = link_tables(robot.bodies),
        notes = robot.notes(),
        payload = payload_kg,
        kind = match kind {
            DriveKind::HobbyServo => ", with hobby servos: the arm has only a few kilograms and decimetres",
            DriveKind::Industrial => "",
        },
    )
}

/// Profile of drives with velocity loops of the gains `kv` (n; Nms/rad, Ns/m).
fn industrial_profile(robot: &NewRobot<'_>, kv: &[f64]) -> String {
    let mut text = format!(
        r"# [A] a servo at 5 kHz that gets a setpoint every fifth tick.
[profile.default]
servo_hz = 5000.0
servo_ticks_per_cycle = 5
delay_servo_ticks = 0
estimator = {{ velocity_filter_hz = 150.0 }}

# [A] velocity loops of {VELOCITY_LOOP_HZ} Hz for the inertia of each joint at the start of first-task.toml, with its rotor; position loops of
# {KP_PER_S} 1/s.
[profile.default.servo]
joint_defaults = {{ cascaded = {{ kp_per_s = {KP_PER_S:?}, velocity_filter_hz = 600.0 }} }}
"
    );
    for (joint, kv) in robot.model.joints().iter().zip(kv) {
        let name = Key::new(&joint.name);
        let _ = writeln!(text, "{name} = {{ cascaded = {{ kv_nms_per_rad = {kv:?} }} }}");
    }
    text
}

/// Profile of hobby servos.
fn hobby_profile(robot: &NewRobot<'_>, drives: &[AssumedDrive]) -> String {
    let mut text = format!(
        r"# [A] servos of 1 kHz on a serial bus that carries setpoints at 100 Hz.
[profile.default]
servo_hz = 1000.0
servo_ticks_per_cycle = 10
delay_servo_ticks = 0
estimator = {{ velocity_filter_hz = 20.0 }}

# [A] springs of {HOBBY_STIFFNESS_PER_RAD} 1/rad of the size of the drive, without a velocity loop: the motor itself damps them.
[profile.default.servo]
"
    );
    for (joint, drive) in robot.model.joints().iter().zip(drives) {
        let per_size = match joint.kind {
            JointKind::Prismatic => HOBBY_STIFFNESS_PER_M,
            _ => HOBBY_STIFFNESS_PER_RAD,
        };
        let stiffness = rounded(per_size * drive.size);
        let name = Key::new(&joint.name);
        let _ = writeln!(
            text,
            "{name} = {{ pid = {{ stiffness_nm_per_rad = {stiffness:?}, damping_nms_per_rad = 0.0 }} }}"
        );
    }
    text
}

/// Keys of the assumed values of links.
pub(super) fn assumed_links(bodies: &[AssumedBody]) -> impl Iterator<Item = String> + '_ {
    bodies.iter().map(|body| {
        let key = if body.source == BodySource::Floor { ".inertia_kg_m2" } else { "" };
        format!("link.{}{key}", Key::new(&body.link))
    })
}

/// Tables of the links with assumed masses and inertias.
pub(super) fn link_tables(bodies: &[AssumedBody]) -> String {
    if bodies.is_empty() {
        return String::new();
    }
    let mut text = format!(
        "# Masses and inertias of links that the URDF does not state, or that no body has. Meshes are filled with {}\n\
         # kg/m³, other shapes, which enclose links, with {}; links without shapes are those of a chain of cylinders\n\
         # that tapers.\n",
        DENSITIES.mesh_kg_per_m3, DENSITIES.primitive_kg_per_m3
    );
    for AssumedBody { link, inertia, source } in bodies {
        let (mass_kg, com_m, inertia_kg_m2) = numbers(inertia);
        let about = match source {
            BodySource::Shapes => "from the shapes of the link",
            BodySource::Chain => "from the length of the link",
            BodySource::Floor => {
                "the URDF's mass, and its inertia raised to that of a possible body of this mass"
            }
        };
        let _ = writeln!(
            text,
            "[link.{}]   # [A] {about}\nmass_kg = {mass_kg:?}\ncom_m = {com_m:?}\ninertia_kg_m2 = {inertia_kg_m2:?}",
            Key::new(link)
        );
    }
    text + "\n"
}

/// Returns the table of a joint with assumed values, and the keys of these values.
fn assumed_joint(robot: &NewRobot<'_>, joint: &Joint, drive: &AssumedDrive) -> (String, Vec<String>) {
    let name = Key::new(&joint.name).to_string();
    let slides = joint.kind == JointKind::Prismatic;
    let (torque, speed) = if slides { ("N", "m/s") } else { ("Nm", "rad/s") };
    let mut text = format!("\n[joint.{name}]\n");
    let mut keys = Vec::new();
    if let Some(limit) = drive.torque_limit {
        let effort = joint.limits.effort;
        let instead = match effort.is_finite() && effort > 0.0 {
            true => {
                format!("; the effort of the URDF, {effort}, is {:.2} times the need", effort / drive.need)
            }
            false => String::new(),
        };
        let _ = writeln!(
            text,
            "torque_limit_nm = {limit:?}   # [A] {LIMIT_OVER_NEED} times the torque that the joint needs, {torque}{instead}"
        );
        keys.push(format!("joint.{name}.torque_limit_nm"));
    }
    if let Some(limit) = drive.velocity_limit {
        let _ = writeln!(text, "velocity_limit_rad_per_s = {limit:?}   # [A] {speed}; the URDF has none");
        keys.push(format!("joint.{name}.velocity_limit_rad_per_s"));
    }
    let is_hobby = drive.kind == DriveKind::HobbyServo;
    let (per_size, unit, ratio) = match (slides, is_hobby) {
        (true, _) => (ROTOR_KG_PER_N, "kg/N", format!("; a spindle of {GEAR_RAD_PER_M} rad/m")),
        (false, true) => {
            (HOBBY_KG_M2_PER_NM, "kg m²/Nm", format!("; positions in {HOBBY_STEPS_PER_TURN} steps per turn"))
        }
        (false, false) => (ROTOR_KG_M2_PER_NM, "kg m²/Nm", String::new()),
    };
    let (size, inertia, gear) = (drive.size, drive.rotor_kg_m2, drive.gear_ratio);
    let counts = match is_hobby && !slides {
        true => format!(", encoder_counts_per_turn = {:.0}", (HOBBY_STEPS_PER_TURN / gear).round()),
        false => String::new(),
    };
    let _ = writeln!(
        text,
        "# [A] {per_size} {unit} of the size of the drive at the joint, {size:.3} {torque}{ratio}\n\
         rotor = {{ inertia_kg_m2 = {inertia:?}, gear_ratio = {gear:?}{counts} }}"
    );
    if is_hobby && !slides {
        let _ = writeln!(text, "setpoint_resolution_rad = {:?}", rounded(TAU / HOBBY_STEPS_PER_TURN));
        keys.push(format!("joint.{name}.setpoint_resolution_rad"));
    }
    keys.push(format!("joint.{name}.rotor"));
    let (mut friction, mut from) = (Vec::new(), Vec::new());
    if !robot.states(joint, "friction.coulomb_nm") {
        friction.push(format!("coulomb_nm = {:?}", drive.coulomb));
        from.push(format!("Coulomb friction: {} % of the size", 100.0 * COULOMB_SHARE));
    }
    if !robot.states(joint, "friction.viscous_nms_per_rad") {
        friction.push(format!("viscous_nms_per_rad = {:?}", drive.viscous));
        from.push(match is_hobby {
            true if slides => {
                format!(
                    "viscous friction, with the damping of the motor: {HOBBY_VISCOUS_S_PER_M} s/m of the size"
                )
            }
            true => format!(
                "viscous friction, with the damping of the motor: {HOBBY_VISCOUS_S} s/rad of the size"
            ),
            false => format!("viscous friction: {} % of the size at the speed limit", 100.0 * VISCOUS_SHARE),
        });
    }
    friction.push(format!("presliding_rad = {:?}", drive.presliding));
    from.push("presliding displacement: typical of gears".to_owned());
    let _ = writeln!(text, "# [A] {}\nfriction = {{ {} }}", from.join("; "), friction.join(", "));
    keys.push(format!("joint.{name}.friction"));
    (text, keys)
}

/// True if the URDF has a velocity limit of the joint.
fn has_speed(joint: &Joint) -> bool {
    joint.limits.velocity.is_finite() && joint.limits.velocity > 0.0
}

/// Replaces the control characters of a name by spaces, so that the name stays on one comment line.
fn one_line(name: &str) -> String {
    name.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}

//! Files of a new robot from its URDF.

use crate::arm_template::ArmTemplate;
use crate::assumed_bodies::{AssumedBody, BodySource, assumed_bodies, floored_bodies, numbers};
use crate::assumed_drives::{
    DriveKind, HOBBY_LENGTH_M, HOBBY_MASS_KG, PAYLOAD_SHARE, assumed_drives, servo_gains, velocity_gains,
};
use crate::first_motion::{Clearance, ControlledAxes, FirstMotion, first_motion};
use crate::first_task::first_task_toml;
use crate::robot_template::{NewRobot, assumed_robot_toml, robot_toml};
use nalgebra::{Matrix3, Vector3};
use opspace_backend::CommandKind;
use opspace_experiment::files::collision::{generated_capsules, link_inertias};
use opspace_experiment::files::joint_layers::urdf_values;
use opspace_experiment::files::mount::MountFile;
use opspace_experiment::files::robot::RobotDefinition;
use opspace_experiment::files::robot_part::{PartOf, UsedPart, load_part_of, urdf_error};
use opspace_experiment::files::source::{FileError, Source};
use opspace_experiment::files::task::TaskDefinition;
use opspace_experiment::postures::tip::{arms, joints_beyond, other_ends, tip};
use opspace_experiment::run::experiment::{Experiment, RunOptions};
use opspace_experiment::suggest::choices;
use opspace_model::collision::CapsuleWarning;
use opspace_model::{
    FrameId, Inertia, JointDynamics, Limits, Model, ParsedUrdf, UrdfJoint, UrdfWarning, urdf_joints,
};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Chain of links of a new robot that is used, all of it if both are `None`; and the mounting of the robot.
#[derive(Clone, Copy, Debug, Default)]
pub struct Part<'a> {
    /// First link; the root of the robot if absent.
    pub from: Option<&'a str>,
    /// Last link.
    pub to: Option<&'a str>,
    /// Placement of the base in the world; upright at the origin if absent.
    pub mount: Option<MountFile>,
}

/// Masses of a robot that are known beside its URDF.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct KnownMasses {
    /// Mass of the whole arm with its base, kg, if the URDF does not state it.
    pub arm_kg: Option<f64>,
    /// Payload that the drives can carry, kg; a tenth of the mass that moves if absent.
    pub payload_kg: Option<f64>,
}

/// Source of the values that the URDF does not state.
#[derive(Clone, Copy, Debug)]
pub enum DriveValues<'a> {
    /// None: the user writes them.
    Missing,
    /// Values that are computed from the URDF, and marked as assumed.
    Assumed(KnownMasses),
    /// Values of a common arm.
    Template(&'a ArmTemplate),
    /// Assumed values, with the interface and the rates of a common arm that has another geometry.
    InterfaceOf(&'a ArmTemplate),
}

/// Texts of the files of a new robot.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct NewFiles {
    /// Text of robot.toml.
    pub robot_toml: String,
    /// Text of the first task.
    pub task_toml: String,
    /// Description of the first task: the position of the tip, and its motion.
    pub motion: String,
    /// Commands that the robot accepts according to robot.toml; `None` if it does not say so yet.
    pub command: Option<CommandKind>,
    /// Joints that do not move, because the template has no values of them.
    pub unmatched_joints: Vec<String>,
    /// Warnings about the URDF.
    pub warnings: Vec<UrdfWarning>,
    /// Choices that the user may want to change, each with the remedy.
    pub notes: Vec<String>,
}

/// Part of a URDF of which a robot file is made.
struct SelectedPart<'a> {
    urdf: &'a Source,
    urdf_name: &'a str,
    used: Option<UsedPart>,
    mount: Option<MountFile>,
    /// Joints that are locked, each at a position (rad, m).
    locked_joints: BTreeMap<String, f64>,
    enforce_mimic: bool,
    parsed: ParsedUrdf,
    /// Masses and inertias that are assumed.
    bodies: Vec<AssumedBody>,
    /// Declared mass of the whole arm, kg.
    arm_kg: Option<f64>,
}

/// Returns the files of a new robot. `urdf_name` is the name of the URDF beside robot.toml; `values` says where the values come
/// from that the URDF does not state.
///
/// # Errors
/// Mistakes in the URDF; a link that it does not have; a robot without moving joints, or one that is not the arm of the template.
pub fn new_files(
    urdf: &Source,
    urdf_name: &str,
    part: Part<'_>,
    values: DriveValues<'_>,
) -> Result<NewFiles, FileError> {
    let files = match values {
        DriveValues::Template(template) => {
            like_template(load(urdf, urdf_name, part, Some(KnownMasses::default()))?, template)
        }
        DriveValues::Missing => computed(load(urdf, urdf_name, part, None)?, None, true),
        DriveValues::Assumed(known) => computed(load(urdf, urdf_name, part, Some(known))?, Some(known), true),
        DriveValues::InterfaceOf(template) => {
            let known = KnownMasses::default();
            let assumed = computed(load(urdf, urdf_name, part, Some(known))?, Some(known), false)?;
            let robot_toml = template.with_interface(&assumed.robot_toml);
            Ok(NewFiles { robot_toml, command: Some(template.command()), ..assumed })
        }
    }?;
    check(&files, urdf)?;
    Ok(files)
}

/// Checks that the files of a robot whose values are all known can be used: the first task as the robot that it is, and as a torque
/// robot.
fn check(files: &NewFiles, urdf: &Source) -> Result<(), FileError> {
    let Some(command) = files.command else { return Ok(()) };
    // Beside the URDF, as its copy will be, so that its meshes are found.
    let beside = |name: &str| Path::new(urdf.name()).with_file_name(name).display().to_string();
    let robot = RobotDefinition::from_sources(
        Source::new(beside("robot.toml"), files.robot_toml.as_str()),
        urdf.clone(),
    )?;
    let task = TaskDefinition::from_sources::<FileError>(
        Source::new(beside("first-task.toml"), files.task_toml.as_str()),
        |named| Source::read(&named.path),
    )?;
    for backend in [command, CommandKind::Torque] {
        let options = RunOptions { backend, ..RunOptions::default() };
        Experiment::new(robot.clone(), task.clone(), options, Vec::new())?;
    }
    Ok(())
}

/// Loads the part of a URDF. `known` has the masses that are known of a robot whose other ones are assumed.
fn load<'a>(
    urdf: &'a Source,
    urdf_name: &'a str,
    part: Part<'_>,
    known: Option<KnownMasses>,
) -> Result<SelectedPart<'a>, FileError> {
    let joints = urdf_joints(urdf.text()).map_err(|error| urdf_error(urdf, &error))?;
    let used = used_part(urdf, &joints, part)?;
    // A joint whose limits are equal cannot move; a robot of such joints alone has mistakes in its URDF.
    let moving = || joints.iter().filter(|joint| joint.kind.is_some());
    let is_stuck = |joint: &&UrdfJoint| joint.limits.lower == joint.limits.upper;
    let mut locked: BTreeMap<String, f64> =
        moving().filter(is_stuck).map(|joint| (joint.name.clone(), joint.limits.lower)).collect();
    if locked.len() == moving().count() {
        locked.clear();
    }
    let enforce_mimic = joints.iter().any(|joint| joint.mimics.is_some());
    let load = |bodies: &[AssumedBody]| {
        let part = PartOf { joints: &joints, used: used.as_ref(), locked_joints: &locked };
        let inertias = bodies.iter().map(|body| (body.link.clone(), written(&body.inertia))).collect();
        load_part_of(urdf, urdf, &part, enforce_mimic, inertias).map_err(|error| error.of_urdf(urdf))
    };
    let mut bodies = match known {
        Some(_) => floored_bodies(&link_inertias(urdf)?),
        None => Vec::new(),
    };
    let mut parsed = load(&bodies)?;
    if parsed.model.n() == 0 {
        return Err(FileError::of_file(urdf.name(), "the robot has no joints that can move", None));
    }
    let moves =
        |link: &str| parsed.model.frames().iter().any(|frame| frame.name == link && frame.body.is_some());
    bodies.retain(|body| moves(&body.link));
    if let Some(known) = known {
        if parsed.massless.is_empty()
            && let Some(arm_kg) = known.arm_kg
        {
            let message =
                format!("the URDF states the masses of all links: {arm_kg} kg cannot be divided among them");
            return Err(FileError::of_file(urdf.name(), message, Some("leave --mass out".to_owned())));
        }
        bodies.extend(assumed_bodies(&parsed.model, urdf, &parsed.massless, known.arm_kg)?);
        parsed = load(&bodies)?;
    }
    if let Some(mount) = &part.mount {
        parsed.model = parsed.model.with_base(mount.placement());
    }
    let mount = part.mount;
    let arm_kg = known.and_then(|known| known.arm_kg);
    Ok(SelectedPart {
        urdf,
        urdf_name,
        used,
        mount,
        locked_joints: locked,
        enforce_mimic,
        parsed,
        bodies,
        arm_kg,
    })
}

/// Inertia as a file states it: with a few digits.
fn written(inertia: &Inertia) -> Inertia {
    let (mass, com, [xx, xy, xz, yy, yz, zz]) = numbers(inertia);
    let rotational = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    Inertia { mass, com: Vector3::from(com), rotational }
}

/// Returns a first motion; `torque_limits` (n; Nm, N) are infinite where they are unknown.
fn motion_of(
    loaded: &SelectedPart<'_>,
    model: &Model,
    torque_limits: &[f64],
) -> Result<FirstMotion, FileError> {
    let tip = loaded.used.as_ref().map(|used| used.to.as_str());
    first_motion(model, loaded.urdf, tip, torque_limits)
        .ok_or_else(|| FileError::of_file(loaded.urdf.name(), "no frame of the robot moves", None))
}

/// Files of a robot whose values are assumed, or missing. With `own_interface`, the arm may have hobby servos.
fn computed(
    loaded: SelectedPart<'_>,
    assumed: Option<KnownMasses>,
    own_interface: bool,
) -> Result<NewFiles, FileError> {
    let (model, dynamics) = (&loaded.parsed.model, &loaded.parsed.dynamics);
    let assume = assumed.is_some();
    let payload_kg = assumed.and_then(|known| known.payload_kg).unwrap_or(PAYLOAD_SHARE * model.total_mass());
    // URDFs without masses are those of industrial robots.
    let has_masses = loaded.bodies.iter().all(|body| body.source == BodySource::Floor);
    let kind = if own_interface && has_masses { DriveKind::of(model) } else { DriveKind::Industrial };
    let drives = assumed_drives(model, dynamics, Some(payload_kg), kind);
    let limits: Vec<f64> = (model.joints().iter().zip(&drives))
        .map(|(joint, drive)| {
            let unknown = if assume { drive.torque_limit.unwrap_or(f64::INFINITY) } else { f64::INFINITY };
            if drive.torque_limit.is_some() { unknown } else { joint.limits.effort }
        })
        .collect();
    let mut limited = model.clone();
    for (i, drive) in drives.iter().enumerate() {
        if let Some(velocity) = drive.velocity_limit {
            limited.set_limits(i, Limits { velocity, ..model.joints()[i].limits });
        }
    }
    let motion = motion_of(&loaded, &limited, &limits)?;
    let mut stated = urdf_values(model, dynamics);
    let mut notes = notes(&loaded, model, &motion);
    if has_placeholder_friction(dynamics) {
        notes.insert(0, note_of_friction(assume));
        if assume {
            stated.retain(|value| !value.key.starts_with("friction."));
        }
    }
    if assume && kind == DriveKind::HobbyServo {
        notes.insert(0, note_of_hobby_servos());
    }
    if let [template, others @ ..] = ArmTemplate::fitting(loaded.urdf, model)?.as_slice() {
        notes.insert(0, note_of_template(template, others, model));
    }
    let locked: Vec<(String, f64)> = loaded.locked_joints.clone().into_iter().collect();
    let robot = NewRobot {
        urdf: loaded.urdf_name,
        used: loaded.used.as_ref(),
        mount: loaded.mount.as_ref(),
        enforce_mimic: loaded.enforce_mimic,
        locked_joints: &locked,
        model,
        stated: &stated,
        bodies: &loaded.bodies,
    };
    notes.extend(note_of_bodies(&loaded.bodies, loaded.arm_kg));
    let robot_toml = match assume {
        true => {
            let kv = velocity_gains(model, &drives, &motion.start);
            assumed_robot_toml(&robot, &drives, &kv, payload_kg)
        }
        false => robot_toml(&robot),
    };
    Ok(NewFiles {
        robot_toml,
        task_toml: first_task_toml(model, &motion),
        motion: description(&motion),
        command: assume.then_some(CommandKind::Position),
        unmatched_joints: Vec::new(),
        notes,
        warnings: loaded.parsed.warnings,
    })
}

/// Names the links whose masses or inertias are assumed.
fn note_of_bodies(bodies: &[AssumedBody], arm_kg: Option<f64>) -> Option<String> {
    if bodies.is_empty() {
        return None;
    }
    let body = |body: &AssumedBody| match body.source {
        BodySource::Floor => format!("{} (inertia only)", body.link),
        _ => format!("{} {:.3} kg", body.link, body.inertia.mass),
    };
    let listed: Vec<String> = bodies.iter().map(body).collect();
    let of_arm = match arm_kg {
        Some(arm_kg) => format!("They are shares of {arm_kg} kg, with those of links that do not move"),
        None => "If you know the mass of the arm from its data sheet, add `--mass` with it in kg".to_owned(),
    };
    Some(format!(
        "masses and inertias that the URDF does not state, or that no body has, are assumed: {}. {of_arm}; [link.NAME] of \
         robot.toml has the values",
        listed.join(", ")
    ))
}

/// True if all values of friction and damping in a URDF are zero, as exporters write them.
fn has_placeholder_friction(dynamics: &[JointDynamics]) -> bool {
    let mut stated = dynamics.iter().flat_map(|joint| [joint.friction, joint.damping]).flatten().peekable();
    stated.peek().is_some() && stated.all(|value| value == 0.0)
}

/// Says what is made of friction and damping that are zero in the URDF.
fn note_of_friction(assume: bool) -> String {
    let zero = "the URDF states zero friction or damping for its joints, and no other value, as exporters do that do not know \
                them";
    match assume {
        true => format!(
            "{zero}: robot.toml has typical values instead, marked [A]. If the joints have no friction, write 0 there"
        ),
        false => format!(
            "{zero}. They count as the friction of the arm; if it has another, write it under [joint_defaults.friction] in \
             robot.toml"
        ),
    }
}

/// Says which drives a small arm gets.
fn note_of_hobby_servos() -> String {
    format!(
        "this arm moves at most {HOBBY_MASS_KG} kg and is at most {HOBBY_LENGTH_M} m long, so hobby servos are assumed: springs without \
         a velocity loop, on a bus of 100 Hz. If it has industrial drives, write their values into robot.toml"
    )
}

/// Names a template that fits the URDF, and others that fit as well.
fn note_of_template(template: &ArmTemplate, others: &[ArmTemplate], model: &Model) -> String {
    let ArmTemplate { name, about, .. } = template;
    let names = match template.has_names_of(model) {
        true => "",
        false => ", though its joints have other names than those of the manufacturer",
    };
    let others: String =
        others.iter().map(|other| format!(", or `--like {}` ({})", other.name, other.about)).collect();
    format!(
        "this URDF has the axes, ranges and masses of template '{name}' ({about}){names}: if it is that arm, use `--like {name}`{others}, \
         which fills in its public values"
    )
}

/// Files of a robot with the values of a template. Joints that the template does not have are locked.
fn like_template(mut loaded: SelectedPart<'_>, template: &ArmTemplate) -> Result<NewFiles, FileError> {
    let urdf = loaded.urdf;
    let joints = template.joints_in(urdf, &loaded.parsed.model)?;
    let mut others = Vec::new();
    for joint in loaded.parsed.model.joints().iter().filter(|joint| !joints.contains(&joint.name)) {
        let at = 0.0_f64.clamp(joint.limits.lower, joint.limits.upper);
        loaded.locked_joints.insert(joint.name.clone(), at);
        others.push(joint.name.clone());
    }
    let locked: Vec<(String, f64)> = loaded.locked_joints.clone().into_iter().collect();
    let head = NewRobot {
        urdf: loaded.urdf_name,
        used: loaded.used.as_ref(),
        mount: loaded.mount.as_ref(),
        enforce_mimic: loaded.enforce_mimic,
        locked_joints: &locked,
        model: &loaded.parsed.model,
        stated: &[],
        bodies: &loaded.bodies,
    };
    let model = &loaded.parsed.model;
    let last = || tip(model).map(|frame| model.frame(frame).name.clone());
    let tip = loaded.used.as_ref().map(|used| used.to.clone()).or_else(last).unwrap_or_default();
    // The gains of the servos follow from the inertia at the start, which follows from the other values.
    let read = |kv: &[f64]| {
        let text = template.robot_toml(&head, &joints, &tip, kv);
        RobotDefinition::from_sources(Source::new("robot.toml", text), urdf.clone())
    };
    let mut robot = read(&vec![1.0; joints.len()])?;
    let motion = motion_of(&loaded, &robot.model, &robot.torque_limits())?;
    if let Some(loops) = template.loops {
        let gains = servo_gains(&robot.model, loops.velocity_loop_hz, &motion.start);
        let of_joint = |name: &String| robot.model.joint(name).ok().map(|joint| gains[joint]);
        robot = read(&joints.iter().filter_map(of_joint).collect::<Vec<f64>>())?;
    }
    Ok(NewFiles {
        robot_toml: robot.source.text().to_owned(),
        task_toml: first_task_toml(&robot.model, &motion),
        motion: description(&motion),
        command: Some(robot.file.interface.command),
        unmatched_joints: others,
        notes: notes(&loaded, &robot.model, &motion)
            .into_iter()
            .chain(note_of_bodies(&loaded.bodies, loaded.arm_kg))
            .collect(),
        warnings: robot.warnings,
    })
}

/// Returns the chain of links that is used, with the root of the robot as its default begin.
fn used_part(urdf: &Source, joints: &[UrdfJoint], part: Part<'_>) -> Result<Option<UsedPart>, FileError> {
    let Some(to) = part.to else { return Ok(None) };
    let links = || joints.iter().flat_map(|joint| [joint.parent.as_str(), joint.child.as_str()]);
    for link in [Some(to), part.from].into_iter().flatten() {
        if !links().any(|name| name == link) {
            let message = format!("the URDF has no link '{link}'");
            let known: BTreeSet<&str> = links().collect();
            return Err(FileError::of_file(urdf.name(), message, Some(choices(link, known))));
        }
    }
    let root = links().find(|link| joints.iter().all(|joint| joint.child != *link)).unwrap_or(to);
    Ok(Some(UsedPart { from: part.from.unwrap_or(root).to_owned(), to: to.to_owned() }))
}

/// Choices that the user may want to change.
fn notes(loaded: &SelectedPart<'_>, model: &Model, motion: &FirstMotion) -> Vec<String> {
    let mut notes = Vec::new();
    let frame = model.frame_id(&motion.frame).ok();
    let hand = frame.map_or_else(Vec::new, |frame| joints_beyond(model, frame));
    if loaded.used.is_none() && !hand.is_empty() {
        let joints: Vec<String> = hand.iter().map(|joint| format!("'{joint}'")).collect();
        let (joints, it) = match joints.as_slice() {
            [one] => (format!("joint {one} is taken for that of a gripper"), "it"),
            all => (format!("joints {} are taken for those of a gripper", all.join(", ")), "them"),
        };
        let tip = &motion.frame;
        notes.push(format!(
            "{joints}: the tip is '{tip}', before {it}. To leave {it} out of the robot, add `--to {tip}` to this command, which \
             writes `use` into robot.toml; if the arm ends elsewhere, add `--to` with its last link"
        ));
    }
    if loaded.used.is_none()
        && let Some(note) = frame.and_then(|frame| note_of_ends(model, frame))
    {
        notes.push(note);
    }
    notes.extend(note_of_arms(loaded, model));
    notes.extend(note_of_posture(motion));
    notes.push(format!(
        "collisions are not avoided: robot.toml has no [collision]. See the capsules of the links with `opspace model DIR \
         --capsules`; to use them, append `[collision]` and `margin_m = 0.02` to robot.toml. They are made from meshes (STL, \
         OBJ) if these are beside the URDF, otherwise from inertias, and may then be smaller than the links{}",
        unread_meshes(loaded.urdf)
    ));
    notes
}

/// Names the other links at the end of the arm.
fn note_of_ends(model: &Model, tip: FrameId) -> Option<String> {
    let others = other_ends(model, tip);
    if others.is_empty() {
        return None;
    }
    let names: Vec<String> = others.iter().map(|name| format!("'{name}'")).collect();
    Some(format!(
        "the tip is '{}'; other links are fixed to the end of the arm: {}. To take one of them, add `--to` with its name",
        model.frame(tip).name,
        names.join(", ")
    ))
}

/// Names the meshes of a URDF in formats that are not read; empty if there are none.
fn unread_meshes(urdf: &Source) -> String {
    let warnings = generated_capsules(urdf).map(|generated| generated.warnings).unwrap_or_default();
    let is_format = |warning: &&CapsuleWarning| matches!(warning, CapsuleWarning::MeshFormat { .. });
    let files: BTreeSet<&str> = warnings.iter().filter(is_format).filter_map(|w| w.file()).collect();
    match files.len() {
        0 => String::new(),
        1 => ". Its mesh is in another format: convert it, with its name in the URDF".to_owned(),
        count => format!(
            ". {count} of its meshes are in other formats: convert them, with their names in the URDF"
        ),
    }
}

/// Arms of a robot that is taken as a whole, with the options that would take one of them.
fn note_of_arms(loaded: &SelectedPart<'_>, model: &Model) -> Option<String> {
    let arms = arms(model);
    if loaded.used.is_some() || arms.len() < 2 {
        return None;
    }
    let options: Vec<String> = arms
        .iter()
        .map(|arm| format!("`--from {} --to {}` ({} joints)", arm.from, arm.to, arm.joints))
        .collect();
    Some(format!(
        "the robot has {} chains of joints, and all of its {} joints are taken. To take one chain, add {}",
        arms.len(),
        model.n(),
        options.join(", or ")
    ))
}

/// Conditions that the start of the first task does not keep.
fn note_of_posture(motion: &FirstMotion) -> Option<String> {
    let remedy = "compare it with the real arm before anything moves, and choose another [start_rad] in first-task.toml";
    let searched = "no posture was found in which";
    match (motion.clearance, &motion.contacts.links, &motion.contacts.with_floor) {
        (Clearance::Full, ..) => None,
        (_, Some([first, second]), _) => Some(format!(
            "{searched} the arm can move and its links do not touch: links '{first}' and '{second}' touch at the start, as far \
             as their capsules show; {remedy}"
        )),
        (_, None, Some(link)) => Some(format!(
            "{searched} the arm can move and no link is below its base: link '{link}' is below it at the start. If the arm \
             stands on a floor or a table, {remedy}"
        )),
        (Clearance::None, None, None) => Some(format!(
            "{searched} the arm can move with all links apart and with torques below 60 % of their limits: the arm may \
             touch itself, or be overloaded, during the first task; {remedy}"
        )),
        (Clearance::WithoutFloor, None, None) => Some(format!(
            "{searched} the arm can move above its base: it may be below it during the first task. If the arm stands on a \
             floor or a table, {remedy}"
        )),
    }
}

/// Describes the first motion.
fn description(motion: &FirstMotion) -> String {
    let [x, y, z] = motion.tip_m;
    let at = format!("The tip '{}' is at x = {x:.3}, y = {y:.3}, z = {z:.3} m at the start.", motion.frame);
    if motion.distance_m == 0.0 {
        return format!("{at} first-task.toml holds it.");
    }
    let axis = ["x", "y", "z"][motion.axis];
    let keeps = if motion.axes == ControlledAxes::Pose { ", keeps its orientation" } else { "" };
    format!(
        "{at} first-task.toml moves it by {:.2} m along {axis} in {:.1} s{keeps}, and back.",
        motion.distance_m, motion.duration_s
    )
}

//! Files of a new robot from its URDF.

use crate::files::joint_layers::urdf_values;
use crate::files::robot_part::{UsedPart, load_part_of, urdf_error};
use crate::files::source::{FileError, Source};
use crate::files::suggest::choices;
use crate::setup::assumed_drives::{assumed_drives, velocity_gains};
use crate::setup::first_motion::{ControlledAxes, FirstMotion, first_motion};
use crate::setup::first_task::first_task_toml;
use crate::setup::robot_template::{NewRobot, assumed_robot_toml, robot_toml};
use opspace_model::{Limits, UrdfJoint, UrdfWarning, urdf_joints};
use std::collections::{BTreeMap, BTreeSet};

/// Chain of links of a new robot that is used; all of it if both are `None`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Part<'a> {
    /// First link; the root of the robot if absent.
    pub from: Option<&'a str>,
    /// Last link.
    pub to: Option<&'a str>,
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
    /// Warnings about the URDF.
    pub warnings: Vec<UrdfWarning>,
}

/// Returns the files of a new robot. `urdf_name` is the name of the URDF beside robot.toml. With `assume`, values that the URDF
/// does not state are assumed, and marked.
///
/// # Errors
/// Mistakes in the URDF; a link that it does not have; a robot without moving joints.
pub fn new_files(
    urdf: &Source,
    urdf_name: &str,
    part: Part<'_>,
    assume: bool,
) -> Result<NewFiles, FileError> {
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
    let loaded = load_part_of(urdf, urdf, &joints, used.as_ref(), &locked, enforce_mimic)?;
    let model = loaded.model;
    if model.n() == 0 {
        return Err(FileError::of_file(urdf.name(), "the robot has no joints that can move", None));
    }
    let drives = assumed_drives(&model, &loaded.dynamics);
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
    let tip = used.as_ref().map(|used| used.to.as_str());
    let Some(motion) = first_motion(&limited, urdf, tip, &limits) else {
        let message = "no frame of the robot moves";
        return Err(FileError::of_file(urdf.name(), message, None));
    };
    let stated = urdf_values(&model, &loaded.dynamics);
    let locked: Vec<(String, f64)> = locked.into_iter().collect();
    let robot = NewRobot {
        urdf: urdf_name,
        used: used.as_ref(),
        enforce_mimic,
        locked_joints: &locked,
        model: &model,
        stated: &stated,
    };
    let robot_toml = match assume {
        true => assumed_robot_toml(&robot, &drives, &velocity_gains(&model, &drives, &motion.start)),
        false => robot_toml(&robot),
    };
    Ok(NewFiles {
        robot_toml,
        task_toml: first_task_toml(&model, &motion),
        motion: description(&motion),
        warnings: loaded.warnings,
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

//! Part of a robot that is used: locked joints, mimic joints, and one chain of a larger robot.

use crate::codes::Code;
use crate::files::link::{LinkFile, inertias};
use crate::files::source::{FileError, Source};
use crate::suggest::choices;
use opspace_model::{
    Inertia, Limits, Model, ParsedUrdf, UrdfChanges, UrdfError, UrdfErrorKind, UrdfJoint, UrdfOptions,
    urdf_joints,
};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

/// Chain of links of a robot.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct UsedPart {
    /// First link of the chain.
    pub from: String,
    /// Last link of the chain.
    pub to: String,
}

/// Keys of robot.toml that are needed before its other values: the URDF, and which of its joints move.
#[derive(Clone, Debug, Default, Deserialize)]
pub(crate) struct PartKeys {
    pub(crate) urdf: PathBuf,
    #[serde(default)]
    locked_joints: BTreeMap<String, f64>,
    #[serde(rename = "use")]
    used: Option<UsedPart>,
    #[serde(default)]
    enforce_mimic: bool,
    #[serde(default)]
    link: BTreeMap<String, LinkFile>,
}

/// Returns the model of the part of a URDF that a robot file uses.
///
/// # Errors
/// Mistakes in the URDF, and links or joints that it does not have.
pub(crate) fn load_part(source: &Source, urdf: &Source, keys: &PartKeys) -> Result<ParsedUrdf, FileError> {
    let joints = match keys.used.is_some() || !keys.locked_joints.is_empty() {
        true => urdf_joints(urdf.text()).map_err(|error| urdf_error(urdf, &error))?,
        false => Vec::new(),
    };
    let inertias = inertias(source, &keys.link)?;
    let part = PartOf { joints: &joints, used: keys.used.as_ref(), locked_joints: &keys.locked_joints };
    load_part_of(source, urdf, &part, keys.enforce_mimic, inertias).map_err(|error| match &error {
        UrdfOrFile::Urdf(urdf_error) => match urdf_error.kind() {
            UrdfErrorKind::UnknownInertia { link, known } => {
                let help = choices(link, known.iter().map(String::as_str));
                let message = format!("the URDF has no link '{link}'");
                FileError::at_key(source, ["link", link.as_str()], message, Some(help))
            }
            _ => error.of_urdf(urdf),
        },
        UrdfOrFile::File(_) => error.of_urdf(urdf),
    })
}

/// Part of a URDF.
pub struct PartOf<'a> {
    /// All joints of the URDF; not needed if all of it is used, and nothing is locked.
    pub joints: &'a [UrdfJoint],
    /// Part of the robot that is used; all of it if `None`.
    pub used: Option<&'a UsedPart>,
    /// Positions of the joints that do not move, rad or m, by name.
    pub locked_joints: &'a BTreeMap<String, f64>,
}

/// Error in a URDF, or in the file that chooses a part of it.
pub enum UrdfOrFile {
    /// The URDF is at fault.
    Urdf(UrdfError),
    /// The robot file is at fault.
    File(FileError),
}

impl UrdfOrFile {
    /// Error in the URDF at its line, or in the file.
    pub fn of_urdf(self, urdf: &Source) -> FileError {
        match self {
            Self::Urdf(error) => urdf_error(urdf, &error),
            Self::File(error) => error,
        }
    }
}

/// Returns the model of the part of a URDF that moves; it may have joints that move no mass. `inertias` replace those of links.
/// Mistakes in the choice are reported in `source`.
///
/// # Errors
/// A choice of links or joints that the URDF does not have, or that is no arm.
pub fn load_part_of(
    source: &Source,
    urdf: &Source,
    part: &PartOf<'_>,
    enforce_mimic: bool,
    inertias: Vec<(String, Inertia)>,
) -> Result<ParsedUrdf, UrdfOrFile> {
    let options = UrdfOptions { enforce_mimic, allow_massless: true, ..UrdfOptions::default() };
    let locked = locked_joints(source, part.joints, part.used, part.locked_joints, enforce_mimic)
        .map_err(UrdfOrFile::File)?;
    Model::from_urdf_changed(urdf.text(), options, &UrdfChanges { locked_joints: locked, inertias })
        .map_err(UrdfOrFile::Urdf)
}

/// Error in a URDF, at its line.
pub fn urdf_error(urdf: &Source, error: &UrdfError) -> FileError {
    let line = error.line().and_then(|line| usize::try_from(line).ok());
    let found = FileError::at_line(urdf, line, error.kind().to_string(), None);
    match error.kind() {
        UrdfErrorKind::NegativeInertia { .. } => found.coded(Code::NegativeInertia),
        UrdfErrorKind::Massless { .. } => found.coded(Code::MasslessLink),
        _ => found,
    }
}

/// Returns all joints that do not move, each with its position.
fn locked_joints(
    source: &Source,
    joints: &[UrdfJoint],
    used: Option<&UsedPart>,
    stated: &BTreeMap<String, f64>,
    enforce_mimic: bool,
) -> Result<Vec<(String, f64)>, FileError> {
    let moving = || joints.iter().filter(|joint| joint.kind.is_some());
    for (name, &position) in stated {
        let wrong = |message: String, help: Option<String>| {
            FileError::at_key(source, ["locked_joints", name.as_str()], message, help)
        };
        let Some(joint) = moving().find(|joint| joint.name == *name) else {
            let help = choices(name, moving().map(|joint| joint.name.as_str()));
            return Err(wrong(format!("the URDF has no moving joint '{name}'"), Some(help)));
        };
        let Limits { lower, upper, .. } = joint.limits;
        if !(lower..=upper).contains(&position) {
            let message = format!("joint '{name}' cannot be locked at {position}");
            return Err(wrong(message, Some(format!("its limits in the URDF are {lower} and {upper}"))));
        }
    }
    let mut locked: Vec<(String, f64)> =
        stated.iter().map(|(name, &position)| (name.clone(), position)).collect();
    let Some(used) = used else { return Ok(locked) };
    let mut kept = chain(source, joints, used)?;
    if enforce_mimic {
        // Joints that mimic a joint of the chain move with it; as many passes as there are joints reach all of them.
        for _ in joints {
            let follows =
                |joint: &&UrdfJoint| joint.mimics.as_deref().is_some_and(|leader| kept.contains(leader));
            let followers: Vec<&str> = moving().filter(follows).map(|joint| joint.name.as_str()).collect();
            kept.extend(followers);
        }
    }
    for joint in moving().filter(|joint| !kept.contains(joint.name.as_str())) {
        if !stated.contains_key(&joint.name) {
            // The position that is closest to zero.
            locked.push((joint.name.clone(), 0.0_f64.clamp(joint.limits.lower, joint.limits.upper)));
        }
    }
    Ok(locked)
}

/// Returns the moving joints between the two links of a chain.
fn chain<'a>(
    source: &Source,
    joints: &'a [UrdfJoint],
    used: &UsedPart,
) -> Result<BTreeSet<&'a str>, FileError> {
    let links: BTreeSet<&str> = joints.iter().flat_map(|j| [j.parent.as_str(), j.child.as_str()]).collect();
    for (key, link) in [("from", &used.from), ("to", &used.to)] {
        if !links.contains(link.as_str()) {
            let message = format!("the URDF has no link '{link}'");
            return Err(FileError::at_key(source, ["use", key], message, Some(choices(link, links))));
        }
    }
    let mut kept = BTreeSet::new();
    let mut link = used.to.as_str();
    while link != used.from {
        let Some(above) = joints.iter().find(|joint| joint.child == link) else {
            let message = format!("link '{}' is not above link '{}'", used.from, used.to);
            let help = "`from` is a link on the way from the root of the robot to `to`".to_owned();
            return Err(FileError::at_key(source, ["use", "from"], message, Some(help)));
        };
        kept.extend(above.kind.is_some().then_some(above.name.as_str()));
        link = &above.parent;
    }
    if kept.is_empty() {
        let message = format!("no joint moves between the links '{}' and '{}'", used.from, used.to);
        return Err(FileError::at_key(source, "use", message, None));
    }
    Ok(kept)
}

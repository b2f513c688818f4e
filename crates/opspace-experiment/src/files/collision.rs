//! Collision geometry in files: the capsules of a robot (`[collision]` of robot.toml) and the obstacles of a task
//! (`[obstacle.NAME.KIND]` of a task file).

use crate::files::source::{FileError, Source};
use crate::suggest::choices;
use nalgebra::Vector3;
use opspace_backend::quantity::{NonNegative, Positive, exactly};
use opspace_model::collision::{
    Capsule, CapsuleSource, CapsuleWarning, CollisionError, CollisionModel, CollisionShape, Densities,
    GeneratedCapsules, HalfSpace, LinkCapsule, MeshError, generate_capsules, solid_inertia,
};
use opspace_model::urdf::{LinkShapes, link_shapes};
use opspace_model::{Inertia, Model};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Distances that the controller keeps between the links of the robot, and between links and the obstacles of a task.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct CollisionFile {
    /// Smallest distance of two links, and of a link and an obstacle, m.
    #[serde(default = "default_margin")]
    pub margin_m: NonNegative,
    /// Pairs that are not kept apart, in addition to those that always collide and those that never meet: two names
    /// of links or capsules each.
    #[serde(default)]
    pub drop: Vec<[String; 2]>,
    /// Capsules that replace those generated from the URDF. A link that is named here has these capsules alone.
    #[serde(default)]
    pub capsule: Vec<CapsuleFile>,
}

/// Capsule of a link: all points within a radius of a line segment.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct CapsuleFile {
    /// Link or tool to which the capsule is fixed.
    pub link: String,
    /// First end of the axis in the frame of the link, m.
    #[serde(deserialize_with = "exactly")]
    pub start_m: [f64; 3],
    /// Second end of the axis in the frame of the link, m; equal to the first end for a sphere.
    #[serde(deserialize_with = "exactly")]
    pub end_m: [f64; 3],
    /// Radius, m.
    pub radius_m: Positive,
}

/// Obstacle that the controller avoids. It exerts no force in a simulation: see `environment`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum ObstacleFile {
    /// Sphere.
    Sphere(SphereObstacle),
    /// Capsule: all points within a radius of a line segment.
    Capsule(CapsuleObstacle),
    /// Half-space, for example the floor or a wall.
    HalfSpace(HalfSpaceObstacle),
}

/// Sphere that the links of the robot avoid.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct SphereObstacle {
    /// Centre in world coordinates, m.
    #[serde(deserialize_with = "exactly")]
    pub center_m: [f64; 3],
    /// Radius, m.
    pub radius_m: Positive,
    /// Links that may touch it.
    #[serde(default)]
    pub except: Vec<String>,
}

/// Capsule that the links of the robot avoid.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct CapsuleObstacle {
    /// First end of the axis in world coordinates, m.
    #[serde(deserialize_with = "exactly")]
    pub start_m: [f64; 3],
    /// Second end of the axis in world coordinates, m.
    #[serde(deserialize_with = "exactly")]
    pub end_m: [f64; 3],
    /// Radius, m.
    pub radius_m: Positive,
    /// Links that may touch it.
    #[serde(default)]
    pub except: Vec<String>,
}

/// Half-space that the links of the robot avoid.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct HalfSpaceObstacle {
    /// Point of its plane in world coordinates, m.
    #[serde(deserialize_with = "exactly")]
    pub point_m: [f64; 3],
    /// Outward normal in world axes; any length.
    #[serde(deserialize_with = "exactly")]
    pub normal: [f64; 3],
    /// Links that may touch it.
    #[serde(default)]
    pub except: Vec<String>,
}

const fn default_margin() -> NonNegative {
    NonNegative::literal(0.02)
}

impl ObstacleFile {
    /// Name of its kind.
    pub(crate) fn kind(&self) -> &'static str {
        match self {
            Self::Sphere(_) => "sphere",
            Self::Capsule(_) => "capsule",
            Self::HalfSpace(_) => "half-space",
        }
    }

    /// Links that may touch it.
    pub(crate) fn except(&self) -> &[String] {
        match self {
            Self::Sphere(sphere) => &sphere.except,
            Self::Capsule(capsule) => &capsule.except,
            Self::HalfSpace(half_space) => &half_space.except,
        }
    }

    /// Shape in world axes.
    pub(crate) fn shape(&self) -> CollisionShape {
        match self {
            Self::Sphere(SphereObstacle { center_m, radius_m, .. }) => {
                CollisionShape::Capsule(Capsule::sphere((*center_m).into(), radius_m.get()))
            }
            Self::Capsule(CapsuleObstacle { start_m, end_m, radius_m, .. }) => {
                let (start_m, end_m) = ((*start_m).into(), (*end_m).into());
                CollisionShape::Capsule(Capsule { start_m, end_m, radius_m: radius_m.get() })
            }
            Self::HalfSpace(HalfSpaceObstacle { point_m, normal, .. }) => {
                // The collision model normalises the normal, and refuses one without length.
                let (normal, point) = (Vector3::from(*normal), Vector3::from(*point_m));
                let unit = normal.try_normalize(0.0).unwrap_or(normal);
                CollisionShape::HalfSpace(HalfSpace { normal: unit, offset_m: unit.dot(&point) })
            }
        }
    }
}

/// Capsules of a robot.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RobotCapsules {
    /// Capsules of robot.toml, and generated ones of the other links.
    pub(crate) capsules: Vec<LinkCapsule>,
    /// Generated capsules of all links.
    pub(crate) generated: Vec<LinkCapsule>,
    /// Warnings about generated capsules that are in use.
    pub(crate) warnings: Vec<CapsuleWarning>,
    /// Links with capsules of robot.toml and the meshes of these links that were not found.
    pub(crate) absent_meshes: Vec<(String, String)>,
}

/// Generates the capsules of a URDF.
///
/// # Errors
/// A URDF that cannot be read; a mesh that exists and is damaged.
pub fn generated_capsules(urdf: &Source) -> Result<GeneratedCapsules, FileError> {
    generate_capsules(&shapes_of(urdf)?, Some(Path::new(urdf.name())))
        .map_err(|error| mesh_error(urdf, &error))
}

/// Returns the mass properties of the shapes of each link that has some, with these densities, in the frame of the link.
pub fn link_solids(urdf: &Source, densities: Densities) -> Result<Vec<(String, Inertia)>, FileError> {
    let mut solids = Vec::new();
    for link in shapes_of(urdf)? {
        let solid = solid_inertia(&link, Some(Path::new(urdf.name())), densities)
            .map_err(|error| mesh_error(urdf, &error))?;
        solids.extend(solid.map(|solid| (link.link, solid)));
    }
    Ok(solids)
}

/// Returns the inertias that a URDF states for its links, in their frames.
pub fn link_inertias(urdf: &Source) -> Result<Vec<(String, Inertia)>, FileError> {
    Ok(shapes_of(urdf)?.into_iter().filter_map(|link| Some((link.link, link.inertia?))).collect())
}

fn shapes_of(urdf: &Source) -> Result<Vec<LinkShapes>, FileError> {
    link_shapes(urdf.text()).map_err(|error| {
        let line = error.line().and_then(|line| usize::try_from(line).ok());
        FileError::at_line(urdf, line, error.kind().to_string(), None)
    })
}

fn mesh_error(urdf: &Source, error: &MeshError) -> FileError {
    let help = "repair the mesh, or remove it from the URDF".to_owned();
    FileError::of_file(urdf.name(), error.to_string(), Some(help))
}

/// Returns the capsules of a robot: those of its file, and for all other links those of `generated`, or those that are
/// generated from the URDF.
pub(crate) fn robot_capsules(
    source: &Source,
    model: &Model,
    file: &CollisionFile,
    urdf: &Source,
    generated: Option<Vec<LinkCapsule>>,
) -> Result<RobotCapsules, FileError> {
    let (generated, mut warnings) = match generated {
        Some(generated) => (generated, Vec::new()),
        None => {
            let GeneratedCapsules { capsules, warnings, .. } = generated_capsules(urdf)?;
            (capsules, warnings)
        }
    };
    let is_listed = |link: &str| file.capsule.iter().any(|capsule| capsule.link == link);
    let mut capsules: Vec<LinkCapsule> =
        generated.iter().filter(|capsule| !is_listed(&capsule.link)).cloned().collect();
    let absent = warnings.iter().filter_map(|warning| match warning {
        CapsuleWarning::MeshNotFound { link, file, .. } if is_listed(link) => {
            Some((link.clone(), file.clone()))
        }
        _ => None,
    });
    let absent_meshes = absent.collect();
    warnings.retain(|warning| !is_listed(warning.link()));
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for (number, capsule) in file.capsule.iter().enumerate() {
        if let Err(unknown) = model.frame_id(&capsule.link) {
            let key = ["collision", "capsule", &number.to_string(), "link"];
            let help = choices(&unknown.name, &unknown.known);
            let message = format!("the robot has no link or tool '{}'", unknown.name);
            return Err(FileError::at_key(source, key, message, Some(help)));
        }
        let count = counts.entry(&capsule.link).or_default();
        *count += 1;
        let several = file.capsule.iter().filter(|other| other.link == capsule.link).count() > 1;
        let name = if several { format!("{}.{count}", capsule.link) } else { capsule.link.clone() };
        let CapsuleFile { link, start_m, end_m, radius_m } = capsule;
        capsules.push(LinkCapsule {
            name,
            link: link.clone(),
            start_m: *start_m,
            end_m: *end_m,
            radius_m: radius_m.get(),
            source: CapsuleSource::User,
        });
        // Alone, so that an error has the place of its capsule.
        CollisionModel::new(model, &capsules[capsules.len() - 1..]).map_err(|error| {
            let key = ["collision", "capsule", &number.to_string()];
            FileError::at_key(source, key, error.to_string(), None)
        })?;
    }
    let capsules = RobotCapsules { capsules, generated, warnings, absent_meshes };
    geometry(source, model, file, &capsules.capsules)?;
    Ok(capsules)
}

/// Returns the geometry of a robot without obstacles, without the pairs that its file drops.
pub(crate) fn geometry(
    source: &Source,
    model: &Model,
    file: &CollisionFile,
    capsules: &[LinkCapsule],
) -> Result<CollisionModel, FileError> {
    let mut geometry = CollisionModel::new(model, capsules)
        .map_err(|error| FileError::at_key(source, "collision", error.to_string(), None))?;
    for (number, [first, second]) in file.drop.iter().enumerate() {
        geometry
            .drop_pairs(first, second)
            .map_err(|error| unknown_name(source, &["collision", "drop", &number.to_string()], error))?;
    }
    Ok(geometry)
}

/// Returns the error for a name that belongs to no capsule, or another error of the geometry.
pub(crate) fn unknown_name(source: &Source, key: &[&str], error: CollisionError) -> FileError {
    let key: Vec<String> = key.iter().map(|&part| part.to_owned()).collect();
    match error {
        CollisionError::UnknownName { name, known } => {
            let message = format!("there is no link with a capsule, and no capsule, of the name '{name}'");
            FileError::at_key(source, key, message, Some(choices(&name, &known)))
        }
        other => FileError::at_key(source, key, other.to_string(), None),
    }
}

/// Texts of warnings about capsules, each with its code: those of one kind about several links as one.
#[must_use]
pub fn capsule_warning_texts(warnings: &[CapsuleWarning]) -> Vec<(String, &'static str)> {
    let of_code = |code: &str| warnings.iter().filter(|w| w.code() == code).collect::<Vec<_>>();
    let text = |all: &[&CapsuleWarning]| match all {
        [one] => one.to_string(),
        all => {
            let links: BTreeSet<&str> = all.iter().map(|w| w.link()).collect();
            let links = links.into_iter().collect::<Vec<_>>().join(", ");
            let what = match all[0] {
                CapsuleWarning::MeshFormat { .. } => {
                    "have meshes that are neither STL nor OBJ, which are not read"
                }
                CapsuleWarning::MeshNotFound { .. } => "have meshes that were not found",
                _ => "have no collision shape",
            };
            format!(
                "links {links} {what}: their capsules are estimated from their inertias, and a link without inertia has none"
            )
        }
    };
    let of_kinds = CapsuleWarning::CODES.map(|code| (of_code(code), code)).into_iter();
    of_kinds.filter(|(all, _)| !all.is_empty()).map(|(all, code)| (text(&all), code)).collect()
}

/// Returns capsules in the form of robot.toml, each with its origin as a comment.
#[must_use]
pub fn capsules_as_toml(capsules: &[LinkCapsule]) -> String {
    let list = |numbers: [f64; 3]| {
        let [x, y, z] = numbers.map(|x| if x == 0.0 { 0.0 } else { x });
        format!("[{x:.6}, {y:.6}, {z:.6}]")
    };
    let one = |capsule: &LinkCapsule| {
        let origin = match capsule.source {
            CapsuleSource::Inertia => "estimated from the inertia of the link, which may be larger",
            CapsuleSource::Mesh => "around a mesh",
            CapsuleSource::Box => "around a box",
            CapsuleSource::Cylinder => "around a cylinder",
            CapsuleSource::Sphere | CapsuleSource::Capsule => "a shape of the URDF",
            CapsuleSource::User => "from robot.toml",
        };
        format!(
            "# {}: {origin}\n[[collision.capsule]]\nlink = {:?}\nstart_m = {}\nend_m = {}\nradius_m = {:.6}\n",
            capsule.name,
            capsule.link,
            list(capsule.start_m),
            list(capsule.end_m),
            capsule.radius_m
        )
    };
    capsules.iter().map(one).collect::<Vec<_>>().join("\n")
}

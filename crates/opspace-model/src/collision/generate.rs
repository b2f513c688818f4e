//! Capsules of the links, generated from the collision shapes of a URDF.

use super::capsule::{Capsule, CapsuleSource, LinkCapsule};
use super::enclose::{around_cylinder, around_inertia, enclosing_capsule};
use super::mesh::{MeshError, MeshFormat, find_mesh, read_mesh};
use crate::urdf::{Geometry, LinkShapes};
use nalgebra::Vector3;
use std::collections::BTreeSet;
use std::path::Path;
use thiserror::Error;

/// Generated capsules, with warnings about links whose shape is unknown.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct GeneratedCapsules {
    /// Capsules, in the order of the links.
    pub capsules: Vec<LinkCapsule>,
    /// Warnings, in the order of the links.
    pub warnings: Vec<CapsuleWarning>,
}

/// Link whose capsules do not come from its shapes alone.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum CapsuleWarning {
    /// Link with mass and without a shape.
    #[error("link '{link}' has no <collision>: its capsule is estimated from its inertia")]
    NoShape {
        /// Name of the link.
        link: String,
    },
    /// Mesh that was not found.
    #[error("link '{link}': mesh {file} was not found{}", remedy(*estimated))]
    MeshNotFound {
        /// Name of the link.
        link: String,
        /// Name of the file in the URDF.
        file: String,
        /// True if a capsule was estimated from the inertia of the link; otherwise the link has none for this mesh.
        estimated: bool,
    },
    /// Mesh in a format that is not read.
    #[error("link '{link}': mesh {file} is neither STL nor OBJ{}", remedy(*estimated))]
    MeshFormat {
        /// Name of the link.
        link: String,
        /// Name of the file in the URDF.
        file: String,
        /// True if a capsule was estimated from the inertia of the link; otherwise the link has none for this mesh.
        estimated: bool,
    },
}

impl CapsuleWarning {
    /// Codes of all kinds.
    pub const CODES: [&'static str; 3] = ["no-shape", "mesh-not-found", "mesh-format"];

    /// Name in the URDF of the mesh of which it warns, if any.
    #[must_use]
    pub fn file(&self) -> Option<&str> {
        match self {
            Self::NoShape { .. } => None,
            Self::MeshNotFound { file, .. } | Self::MeshFormat { file, .. } => Some(file),
        }
    }

    /// Name of the link of which it warns.
    #[must_use]
    pub fn link(&self) -> &str {
        let (Self::NoShape { link } | Self::MeshNotFound { link, .. } | Self::MeshFormat { link, .. }) = self;
        link
    }

    /// Returns the code of the kind, which remains the same when its text changes.
    #[must_use]
    pub fn code(&self) -> &'static str {
        let [shape, found, format] = Self::CODES;
        match self {
            Self::NoShape { .. } => shape,
            Self::MeshNotFound { .. } => found,
            Self::MeshFormat { .. } => format,
        }
    }
}

fn remedy(estimated: bool) -> &'static str {
    match estimated {
        true => ": a capsule is estimated from the inertia of the link",
        false => ", and the link has no inertia: give it a capsule",
    }
}

/// Returns capsules that enclose the collision shapes of the links: one for each shape. Allocates and reads files: call
/// it once after loading.
///
/// Cylinders and boxes get the capsule of least volume along their axis, or along their longest edge; meshes a capsule
/// that encloses all their vertices. A link with mass whose shape is missing, or is a mesh that is not found or neither
/// STL nor OBJ, gets one estimated from its inertia (source [`CapsuleSource::Inertia`]), with a warning.
///
/// `urdf` is the path of the URDF, to which names of meshes are relative; without it only `file://` URIs are found.
///
/// # Errors
/// [`MeshError`] if a mesh file exists and is unreadable, too large, incomplete or malformed.
pub fn generate_capsules(links: &[LinkShapes], urdf: Option<&Path>) -> Result<GeneratedCapsules, MeshError> {
    let mut generated = GeneratedCapsules { capsules: Vec::new(), warnings: Vec::new() };
    let mut names: BTreeSet<String> = links.iter().map(|link| link.link.clone()).collect();
    for link in links {
        let capsules = capsules_of(link, urdf, &mut generated.warnings)?;
        let several = capsules.len() > 1;
        for (number, (capsule, source)) in (1..).zip(capsules) {
            let mut name = link.link.clone();
            if several {
                name += &format!(".{number}");
                while !names.insert(name.clone()) {
                    name.push('\'');
                }
            }
            generated.capsules.push(LinkCapsule {
                name,
                link: link.link.clone(),
                start_m: capsule.start_m.into(),
                end_m: capsule.end_m.into(),
                radius_m: capsule.radius_m,
                source,
            });
        }
    }
    Ok(generated)
}

/// Returns the capsules of a link in its frame.
fn capsules_of(
    link: &LinkShapes,
    urdf: Option<&Path>,
    warnings: &mut Vec<CapsuleWarning>,
) -> Result<Vec<(Capsule, CapsuleSource)>, MeshError> {
    let from_inertia = link.inertia.as_ref().and_then(around_inertia);
    let estimated = from_inertia.is_some();
    let mut capsules = Vec::new();
    let mut unknown = link.shapes.is_empty();
    if unknown && estimated {
        warnings.push(CapsuleWarning::NoShape { link: link.link.clone() });
    }
    for shape in &link.shapes {
        let (link, place) = (link.link.clone(), &shape.placement);
        if let Geometry::Mesh { file, scale } = &shape.geometry {
            let (Some(format), Some(path)) = (MeshFormat::from_name(file), find_mesh(file, urdf)) else {
                let file = file.clone();
                warnings.push(match MeshFormat::from_name(&file) {
                    Some(_) => CapsuleWarning::MeshNotFound { link, file, estimated },
                    None => CapsuleWarning::MeshFormat { link, file, estimated },
                });
                unknown = true;
                continue;
            };
            let vertices = read_mesh(&path, format, scale).map_err(|kind| MeshError {
                link,
                file: file.clone(),
                kind,
            })?;
            let vertices: Vec<_> = vertices.iter().map(|vertex| place.act_point(vertex)).collect();
            capsules.extend(enclosing_capsule(&vertices).map(|capsule| (capsule, CapsuleSource::Mesh)));
        } else if let Some((capsule, source)) = primitive(&shape.geometry) {
            capsules.push((capsule.placed(place), source));
        }
    }
    if unknown {
        capsules.extend(from_inertia.map(|capsule| (capsule, CapsuleSource::Inertia)));
    }
    Ok(capsules)
}

/// Returns the capsule around a shape other than a mesh, in the frame of the shape.
fn primitive(geometry: &Geometry) -> Option<(Capsule, CapsuleSource)> {
    let along = |axis: Vector3<f64>, (half, radius_m): (f64, f64)| Capsule {
        start_m: -axis * half,
        end_m: axis * half,
        radius_m,
    };
    Some(match *geometry {
        Geometry::Sphere { radius_m } => (Capsule::sphere(Vector3::zeros(), radius_m), CapsuleSource::Sphere),
        Geometry::Cylinder { radius_m, length_m } => {
            (along(Vector3::z(), around_cylinder(0.5 * length_m, radius_m)), CapsuleSource::Cylinder)
        }
        Geometry::Capsule { radius_m, length_m } => {
            (along(Vector3::z(), (0.5 * length_m, radius_m)), CapsuleSource::Capsule)
        }
        Geometry::Box { size_m } => {
            let half = Vector3::from(size_m) * 0.5;
            let longest = half.imax();
            let across = half.remove_row(longest).norm();
            (along(Vector3::ith(longest, 1.0), around_cylinder(half[longest], across)), CapsuleSource::Box)
        }
        Geometry::Mesh { .. } => return None,
    })
}

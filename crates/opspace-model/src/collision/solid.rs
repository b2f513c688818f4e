//! Mass properties of shapes that are filled with a material.

use super::mesh::{MeshError, MeshFormat, find_mesh, read_triangles};
use crate::spatial::Inertia;
use crate::urdf::{Geometry, LinkShapes};
use nalgebra::{Matrix3, Vector3};
use std::collections::HashMap;
use std::f64::consts::PI;
use std::path::Path;

/// Densities with which shapes are filled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Densities {
    /// Density of meshes, kg/m³.
    pub mesh_kg_per_m3: f64,
    /// Density of spheres, cylinders, capsules and boxes, kg/m³: less than that of meshes if they enclose the link.
    pub primitive_kg_per_m3: f64,
}

/// Returns the mass properties of the shapes of a link with these densities, in the frame of the link; `None` without a shape
/// that can be read. Shapes that overlap count twice. `urdf` is the path of the URDF, to which names of meshes are relative.
///
/// # Errors
/// [`MeshError`] if a mesh file exists and is unreadable, too large, incomplete or malformed.
pub fn solid_inertia(
    link: &LinkShapes,
    urdf: Option<&Path>,
    densities: Densities,
) -> Result<Option<Inertia>, MeshError> {
    let mut sum: Option<Inertia> = None;
    for shape in &link.shapes {
        let (solid, density) = match &shape.geometry {
            Geometry::Mesh { file, scale } => {
                let (Some(format), Some(path)) = (MeshFormat::from_name(file), find_mesh(file, urdf)) else {
                    continue;
                };
                let triangles = read_triangles(&path, format, scale).map_err(|kind| MeshError {
                    link: link.link.clone(),
                    file: file.clone(),
                    kind,
                })?;
                (mesh_inertia(&triangles), densities.mesh_kg_per_m3)
            }
            primitive => (primitive_inertia(primitive), densities.primitive_kg_per_m3),
        };
        if solid.mass > 0.0 {
            let filled =
                Inertia { mass: density * solid.mass, rotational: density * solid.rotational, ..solid };
            let placed = shape.placement.act_inertia(&filled);
            sum = Some(sum.map_or(placed, |sum| sum + placed));
        }
    }
    Ok(sum)
}

/// Mass properties of a shape other than a mesh, with a density of 1 kg/m³.
fn primitive_inertia(geometry: &Geometry) -> Inertia {
    let diagonal = |mass: f64, x: f64, y: f64, z: f64| Inertia {
        mass,
        com: Vector3::zeros(),
        rotational: Matrix3::from_diagonal(&Vector3::new(x, y, z)),
    };
    match *geometry {
        Geometry::Sphere { radius_m: r } => {
            let mass = 4.0 / 3.0 * PI * r.powi(3);
            let moment = 0.4 * mass * r * r;
            diagonal(mass, moment, moment, moment)
        }
        Geometry::Cylinder { radius_m: r, length_m: l } => {
            let mass = PI * r * r * l;
            let across = mass * (3.0 * r * r + l * l) / 12.0;
            diagonal(mass, across, across, 0.5 * mass * r * r)
        }
        Geometry::Capsule { radius_m: r, length_m: l } => {
            let (tube, ends) = (PI * r * r * l, 4.0 / 3.0 * PI * r.powi(3));
            let across =
                tube * (3.0 * r * r + l * l) / 12.0 + ends * (0.4 * r * r + 0.25 * l * l + 0.375 * r * l);
            diagonal(tube + ends, across, across, 0.5 * tube * r * r + 0.4 * ends * r * r)
        }
        Geometry::Box { size_m: [x, y, z] } => {
            let mass = x * y * z;
            let [x, y, z] = [x, y, z].map(|size| mass * size * size / 12.0);
            diagonal(mass, y + z, x + z, x + y)
        }
        Geometry::Mesh { .. } => Inertia::zero(),
    }
}

/// Mass properties of a mesh with a density of 1 kg/m³, whichever side of its triangles is out. A mesh with holes is taken for a
/// body that is seen as a whole from the centre of its vertices.
#[must_use]
pub fn mesh_inertia(triangles: &[[Vector3<f64>; 3]]) -> Inertia {
    let corners = || triangles.iter().flatten();
    let count = corners().count().max(1) as f64;
    let centre = corners().sum::<Vector3<f64>>() / count;
    let is_closed = is_closed(triangles);
    let (mut volume, mut first, mut second) = (0.0, Vector3::zeros(), Matrix3::zeros());
    for triangle in triangles {
        let [a, b, c] = triangle.map(|corner| corner - centre);
        let signed = a.dot(&b.cross(&c)) / 6.0;
        let tetrahedron = if is_closed { signed } else { signed.abs() };
        let sum = a + b + c;
        volume += tetrahedron;
        first += sum * (0.25 * tetrahedron);
        let squares = a * a.transpose() + b * b.transpose() + c * c.transpose() + sum * sum.transpose();
        second += squares * (tetrahedron / 20.0);
    }
    if volume == 0.0 {
        return Inertia::zero();
    }
    // Inside out, all of it is negative.
    let sign = volume.signum();
    let com = first / volume;
    let about_com = (second - com * com.transpose() * volume) * sign;
    let rotational = Matrix3::identity() * about_com.trace() - about_com;
    Inertia { mass: volume.abs(), com: centre + com, rotational }
}

/// True if two triangles meet at each edge, in opposite directions.
fn is_closed(triangles: &[[Vector3<f64>; 3]]) -> bool {
    let key = |corner: &Vector3<f64>| [corner.x, corner.y, corner.z].map(|x| (x + 0.0).to_bits());
    let mut edges: HashMap<_, i32> = HashMap::new();
    for triangle in triangles {
        for (from, to) in [(0, 1), (1, 2), (2, 0)] {
            let (from, to) = (key(&triangle[from]), key(&triangle[to]));
            let (edge, direction) = if from < to { ((from, to), 1) } else { ((to, from), -1) };
            *edges.entry(edge).or_default() += direction;
        }
    }
    edges.values().all(|sum| *sum == 0)
}

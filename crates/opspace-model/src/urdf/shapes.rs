//! Collision shapes of the links of a URDF. A model does not need them, so that they are read on request only, and a
//! malformed shape does not prevent a model.

use super::check::{self, Checked, MAX_NUMBER, checked_origin};
use super::error::UrdfError;
use super::read::{self, Element, Node};
use crate::spatial::{Inertia, Placement};

/// Collision shapes and inertia of a link.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct LinkShapes {
    /// Name of the link.
    pub link: String,
    /// Inertia in the frame of the link; `None` if the link has none.
    pub inertia: Option<Inertia>,
    /// Shapes of all `<collision>` elements, in the order of the file.
    pub shapes: Vec<Shape>,
}

/// Collision shape of a link.
#[derive(Clone, Debug, PartialEq)]
pub struct Shape {
    /// Pose of the shape in the frame of the link.
    pub placement: Placement,
    /// Form and size.
    pub geometry: Geometry,
}

/// Form and size of a shape. The center of spheres, cylinders, capsules and boxes is the origin of the shape.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Geometry {
    /// Sphere.
    Sphere {
        /// Radius, m.
        radius_m: f64,
    },
    /// Cylinder along z.
    Cylinder {
        /// Radius, m.
        radius_m: f64,
        /// Length, m.
        length_m: f64,
    },
    /// Capsule along z.
    Capsule {
        /// Radius, m.
        radius_m: f64,
        /// Length of the axis, without the hemispheres at its ends, m.
        length_m: f64,
    },
    /// Box with edges along x, y and z.
    Box {
        /// Lengths of the edges, m.
        size_m: [f64; 3],
    },
    /// Triangles in a file.
    Mesh {
        /// Name of the file as in the URDF: a path or a URI.
        file: String,
        /// Factors of the coordinates in the file, which give m.
        scale: [f64; 3],
    },
}

/// Returns the collision shapes of all links of a URDF, in the order of the file.
///
/// # Errors
/// [`UrdfError`] if [`Model::from_urdf`](crate::Model::from_urdf) refuses an element, or if a `<collision>` has a
/// missing or malformed element.
pub fn link_shapes(text: &str) -> Result<Vec<LinkShapes>, UrdfError> {
    let (robot, shapes) = read::read_with(text, shapes_of_link)?;
    let Checked { description, .. } = check::check(robot, |_| false)?;
    let links = description.links.into_iter().zip(shapes);
    Ok(links.map(|(link, shapes)| LinkShapes { link: link.name, inertia: link.inertia, shapes }).collect())
}

fn shapes_of_link(link: &Element<'_>) -> Result<Vec<Shape>, UrdfError> {
    let collisions = link.node.children().filter(|node| node.has_tag_name("collision"));
    collisions.map(|collision| shape(link, collision)).collect()
}

fn shape<'a>(link: &Element<'a>, collision: Node<'a>) -> Result<Shape, UrdfError> {
    const GEOMETRY: &str = "write <geometry><sphere radius=\"...\"/></geometry>";
    let placement = checked_origin(&link.words, &link.origin(collision)?)?;
    let shapes = link.required(collision, "geometry", GEOMETRY)?;
    Ok(Shape { placement, geometry: geometry(link, shapes)? })
}

fn geometry<'a>(link: &Element<'a>, parent: Node<'a>) -> Result<Geometry, UrdfError> {
    const SHAPES: &str = "give one of <sphere>, <cylinder>, <capsule>, <box> and <mesh>";
    let number = |node, attribute| positive(link, node, attribute);
    if let Some(node) = link.child(parent, "sphere")? {
        return Ok(Geometry::Sphere { radius_m: number(node, "radius")? });
    }
    if let Some(node) = link.child(parent, "cylinder")? {
        return Ok(Geometry::Cylinder {
            radius_m: number(node, "radius")?,
            length_m: number(node, "length")?,
        });
    }
    if let Some(node) = link.child(parent, "capsule")? {
        return Ok(Geometry::Capsule {
            radius_m: number(node, "radius")?,
            length_m: number(node, "length")?,
        });
    }
    if let Some(node) = link.child(parent, "box")? {
        let size_m = factors(link, node, "size", |x| x >= 0.0, "three numbers from 0 to 1e9 (m)")?;
        return Ok(Geometry::Box { size_m });
    }
    if let Some(node) = link.child(parent, "mesh")? {
        const FILE: &str = "write <mesh filename=\"...\"/>";
        let file = link.attribute(node, "filename", FILE)?.to_owned();
        let scale = match node.has_attribute("scale") {
            true => {
                factors(link, node, "scale", |x| x != 0.0, "three numbers from -1e9 to 1e9 other than 0")?
            }
            false => [1.0; 3],
        };
        return Ok(Geometry::Mesh { file, scale });
    }
    Err(link.missing(parent, "shape in <geometry>".to_owned(), SHAPES))
}

/// Returns a length that is positive.
fn positive<'a>(link: &Element<'a>, node: Node<'a>, attribute: &str) -> Result<f64, UrdfError> {
    const LENGTH: &str = "give it in m";
    let value = link.number(node, attribute, LENGTH)?;
    if value > 0.0 && value <= MAX_NUMBER {
        return Ok(value);
    }
    let text = link.attribute(node, attribute, LENGTH)?;
    Err(link.bad_number(node, attribute, text, "one positive number up to 1e9 (m)"))
}

/// Returns three numbers that obey a condition.
fn factors<'a>(
    link: &Element<'a>,
    node: Node<'a>,
    attribute: &str,
    is_valid: impl Fn(f64) -> bool,
    wanted: &'static str,
) -> Result<[f64; 3], UrdfError> {
    let text = link.attribute(node, attribute, "give three numbers")?;
    let values = link.vector(node, attribute)?;
    let valid = values.iter().all(|&x| x.abs() <= MAX_NUMBER && is_valid(x));
    if valid { Ok(values) } else { Err(link.bad_number(node, attribute, text, wanted)) }
}

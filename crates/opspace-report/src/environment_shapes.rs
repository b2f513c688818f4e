//! Shapes of the objects in the environment of a simulated robot, and their outlines in a view.

use crate::polygon::{cut, hull, on, within};
use nalgebra::{Vector2, Vector3};
use opspace_experiment::run::experiment::Experiment;
use opspace_model::collision::HalfSpace;
use opspace_model::{Data, forward_kinematics, frame_placement};
use opspace_sim::EnvironmentObjectParameters;
use std::f64::consts::TAU;

/// Component of a normal across a view up to which its plane is seen edge-on.
const EDGE_ON: f64 = 1e-6;
/// Number of corners with which a circle is drawn.
const CORNERS: usize = 40;
/// Thickness of a wall that is in a view at least, m.
const WALL_M: f64 = 0.05;
/// Radius with which the slide of a drawer is drawn, m.
const SLIDE_RADIUS_M: f64 = 0.006;

/// Object of the environment in world axes.
#[derive(Clone, Debug)]
pub struct PlacedObject {
    /// Name in the task file.
    pub name: String,
    /// Shape in world axes.
    pub shape: EnvironmentShape,
}

/// Shape of an object of the environment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum EnvironmentShape {
    /// Plane, and the half-space in which it exists if it has an edge.
    Plane {
        /// Half-space below the plane.
        below: HalfSpace,
        /// Half-space that ends at the edge.
        edge: Option<HalfSpace>,
    },
    /// Cylinder without ends.
    Cylinder {
        /// Point of the axis, m.
        point_m: Vector3<f64>,
        /// Direction of the axis, of unit length.
        axis: Vector3<f64>,
        /// Radius, m.
        radius_m: f64,
    },
    /// Cylinder with flat ends: a hole, or the slide of a drawer.
    Rod {
        /// Centres of the ends, m.
        ends_m: [Vector3<f64>; 2],
        /// Radius, m.
        radius_m: f64,
    },
}

/// Returns the shapes of the environment of an experiment: walls, cylinders, holes, and the slides of drawers.
pub(crate) fn environment_shapes(experiment: &Experiment) -> Vec<PlacedObject> {
    let mut shapes = Vec::new();
    for (name, object) in &experiment.task().file.environment {
        let mut add = |shape| shapes.push(PlacedObject { name: name.clone(), shape });
        match object {
            EnvironmentObjectParameters::Wall(wall) => {
                let edge = wall.edge.map(|edge| HalfSpace {
                    normal: Vector3::from(edge.toward).normalize(),
                    offset_m: edge.at_m,
                });
                add(EnvironmentShape::Plane { below: half_space(wall.point_m, wall.normal), edge });
            }
            EnvironmentObjectParameters::Cylinder(cylinder) => add(EnvironmentShape::Cylinder {
                point_m: Vector3::from(cylinder.point_m),
                axis: Vector3::from(cylinder.axis).normalize(),
                radius_m: cylinder.radius_m.get(),
            }),
            EnvironmentObjectParameters::Hole(hole) => {
                let below = half_space(hole.point_m, hole.normal);
                let center = Vector3::from(hole.point_m);
                add(EnvironmentShape::Plane { below, edge: None });
                add(EnvironmentShape::Rod {
                    ends_m: [center, center - below.normal * hole.depth_m.get()],
                    radius_m: hole.radius_m.get(),
                });
            }
            EnvironmentObjectParameters::Drawer(drawer) => {
                let Some(handle) = start_of(experiment, &drawer.frame) else { continue };
                let direction = Vector3::from(drawer.direction).normalize();
                let [closed, open] =
                    [-drawer.opening_m.get(), drawer.travel_m.get() - drawer.opening_m.get()];
                add(EnvironmentShape::Rod {
                    ends_m: [handle + direction * closed, handle + direction * open],
                    radius_m: SLIDE_RADIUS_M,
                });
            }
            _ => {}
        }
    }
    shapes
}

/// Half-space below a plane through a point (m).
fn half_space(point_m: [f64; 3], normal: [f64; 3]) -> HalfSpace {
    let normal = Vector3::from(normal).normalize();
    HalfSpace { normal, offset_m: normal.dot(&Vector3::from(point_m)) }
}

/// Position of a frame at the start, m.
pub(crate) fn start_of(experiment: &Experiment, frame: &str) -> Option<Vector3<f64>> {
    let model = &experiment.robot().model;
    let frame = model.frame_id(frame).ok()?;
    let mut data = Data::new(model);
    forward_kinematics(model, &mut data, &experiment.start().ok()?);
    Some(frame_placement(model, &data, frame).translation)
}

impl EnvironmentShape {
    /// Corners of a box around the part of the shape that is nearest to a point (m).
    pub(crate) fn nearest_box(&self, point: &Vector3<f64>) -> [Vector3<f64>; 2] {
        match self {
            Self::Plane { below, .. } => {
                let above_m = below.normal.dot(point) - below.offset_m;
                let [near, far] = [0.0, WALL_M].map(|thickness| point - below.normal * (above_m + thickness));
                [near.inf(&far), near.sup(&far)]
            }
            Self::Cylinder { point_m, axis, radius_m } => {
                let center = point_m + axis * axis.dot(&(point - point_m));
                [center.add_scalar(-radius_m), center.add_scalar(*radius_m)]
            }
            Self::Rod { ends_m: [a, b], radius_m } => {
                [a.inf(b).add_scalar(-radius_m), a.sup(b).add_scalar(*radius_m)]
            }
        }
    }

    /// Outline within a view that shows the rectangle `frame` (m, counter-clockwise) on the axes `axes` along the axis
    /// `depth`: a convex polygon, without corners if the shape is not drawn.
    pub(crate) fn outline(
        &self,
        axes: [usize; 2],
        depth: usize,
        frame: &[Vector2<f64>; 4],
    ) -> Vec<Vector2<f64>> {
        let is_edge_on = |plane: &HalfSpace| plane.normal[depth].abs() < EDGE_ON;
        let cut_by = |polygon: &[Vector2<f64>], plane: &HalfSpace| {
            cut(polygon, &on(axes, &plane.normal), plane.offset_m)
        };
        match self {
            Self::Plane { below, edge } => {
                let seen = edge.as_ref().filter(|edge| is_edge_on(edge));
                match (is_edge_on(below), seen) {
                    (true, Some(edge)) => cut_by(&cut_by(frame, below), edge),
                    (true, None) => cut_by(frame, below),
                    // A plane that is seen from above has an outline only at its edge.
                    (false, Some(edge)) if below.normal[depth].abs() > 1.0 - EDGE_ON => cut_by(frame, edge),
                    (false, _) => Vec::new(),
                }
            }
            Self::Cylinder { point_m, axis, radius_m } => {
                let (center, along) = (on(axes, point_m), on(axes, axis));
                match along.try_normalize(EDGE_ON) {
                    Some(along) => {
                        let across = Vector2::new(-along.y, along.x);
                        let at = across.dot(&center);
                        cut(&cut(frame, &across, at + radius_m), &-across, radius_m - at)
                    }
                    None => within(circle(&center, *radius_m), frame),
                }
            }
            Self::Rod { ends_m, radius_m } => within(hull(rims(ends_m, *radius_m, axes)), frame),
        }
    }
}

/// Corners of a circle, counter-clockwise.
fn circle(center: &Vector2<f64>, radius_m: f64) -> Vec<Vector2<f64>> {
    let angle = |i: usize| TAU * i as f64 / CORNERS as f64;
    (0..CORNERS).map(|i| center + Vector2::new(angle(i).cos(), angle(i).sin()) * radius_m).collect()
}

/// Points of the rims of a cylinder's ends in a view.
fn rims(ends_m: &[Vector3<f64>; 2], radius_m: f64, axes: [usize; 2]) -> Vec<Vector2<f64>> {
    let axis = (ends_m[1] - ends_m[0]).try_normalize(0.0).unwrap_or_else(Vector3::z);
    let first = axis.cross(&Vector3::ith(axis.iamin(), 1.0)).normalize();
    let second = axis.cross(&first);
    let rim = |center: &Vector3<f64>| {
        circle(&Vector2::zeros(), radius_m)
            .iter()
            .map(|corner| on(axes, &(center + first * corner.x + second * corner.y)))
            .collect::<Vec<_>>()
    };
    ends_m.iter().flat_map(rim).collect()
}

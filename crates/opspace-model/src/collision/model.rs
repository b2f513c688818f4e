//! Collision model: capsules of the robot, obstacles, and the pairs whose distances are computed.

use super::capsule::{Capsule, CollisionShape, LinkCapsule, MAX_LENGTH_M};
use crate::data::Data;
use crate::model::Model;
use crate::name_list::name_list;
use crate::spatial::Placement;
use nalgebra::Vector3;
use thiserror::Error;

/// Part of the robot or of the world to which an object is fixed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Holder {
    /// Moving body, given by its index in [`Model::bodies`].
    Body(usize),
    /// Fixed base of the robot.
    Base,
    /// World.
    World,
}

impl Holder {
    /// Returns the index of the body; `None` for the base and the world.
    #[inline]
    #[must_use]
    pub fn body(self) -> Option<usize> {
        match self {
            Self::Body(body) => Some(body),
            Self::Base | Self::World => None,
        }
    }

    /// Returns the placement of the part in the world. Needs [`forward_kinematics`](crate::forward_kinematics).
    #[inline]
    #[must_use]
    pub fn placement(self, model: &Model, data: &Data) -> Placement {
        match self {
            Self::Body(body) => data.placement[body],
            Self::Base => model.base(),
            Self::World => Placement::identity(),
        }
    }
}

/// Capsule of the robot, or obstacle.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct CollisionObject {
    /// Unique name.
    pub name: String,
    /// Part to which the object is fixed.
    pub holder: Holder,
    /// Shape in the frame of the body or the base, or in world axes.
    pub shape: CollisionShape,
    /// Radius of the sphere around the middle of the axis that encloses a capsule, m.
    pub(crate) reach_m: f64,
}

/// Pair of objects whose distance is computed: their indices in [`CollisionModel::objects`]. The first one is a capsule
/// of the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct CollisionPair {
    /// Index of object a.
    pub a: usize,
    /// Index of object b.
    pub b: usize,
}

/// Collision geometry of a robot and its environment.
///
/// The capsules are fixed to the bodies of the model with which the collision model is created. Its frames may be moved
/// afterwards; the capsules stay where they are.
#[derive(Clone, Debug, PartialEq)]
pub struct CollisionModel {
    pub(crate) objects: Vec<CollisionObject>,
    pub(crate) pairs: Vec<CollisionPair>,
    /// Capsules of the robot; their objects have the same indices.
    capsules: Vec<LinkCapsule>,
}

/// Error in the capsules or obstacles of a collision model.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum CollisionError {
    /// Capsule on a link that the model does not have.
    #[error("capsule '{capsule}': no link '{link}'; the links are: {}", name_list(known, 100))]
    UnknownLink {
        /// Name of the capsule.
        capsule: String,
        /// Name of the link.
        link: String,
        /// Names of the links and frames of the model.
        known: Vec<String>,
    },
    /// Two objects with the same name.
    #[error("there are two capsules or obstacles '{name}': names must be unique")]
    DuplicateName {
        /// Name of both.
        name: String,
    },
    /// Number that is not finite or too large, a negative radius, or a normal without length.
    #[error(
        "'{name}': its ends, radius or offset must be finite and at most 1e9 m, its radius not negative, its normal \
         a direction"
    )]
    BadNumber {
        /// Name of the capsule or obstacle.
        name: String,
    },
    /// Name that belongs to no object and no link with a capsule.
    #[error("no capsule, link or obstacle '{name}'; there are: {}", name_list(known, 100))]
    UnknownName {
        /// Requested name.
        name: String,
        /// Names of all capsules and obstacles.
        known: Vec<String>,
    },
}

impl CollisionModel {
    /// Returns the collision model of a robot with these capsules, without obstacles. Its pairs are all pairs of
    /// capsules on different bodies that are not parent and child.
    ///
    /// # Errors
    /// [`CollisionError`] if a link is unknown, a name is used twice or a number is invalid.
    pub fn new(model: &Model, capsules: &[LinkCapsule]) -> Result<Self, CollisionError> {
        let mut collision = Self { objects: Vec::new(), pairs: Vec::new(), capsules: capsules.to_vec() };
        for definition in capsules {
            let (name, capsule) = (&definition.name, definition.capsule());
            let frame = model.frame_id(&definition.link).map_err(|unknown| CollisionError::UnknownLink {
                capsule: name.clone(),
                link: unknown.name,
                known: unknown.known,
            })?;
            let frame = model.frame(frame);
            let holder = frame.body.map_or(Holder::Base, Holder::Body);
            // Checked in the frame of the link, in which the numbers were given.
            checked(name, CollisionShape::Capsule(capsule))?;
            collision.push(name, holder, CollisionShape::Capsule(capsule.placed(&frame.placement)))?;
        }
        for (b, second) in collision.objects.iter().enumerate() {
            for (a, first) in collision.objects.iter().enumerate().take(b) {
                if !are_connected(model, first.holder, second.holder) {
                    collision.pairs.push(CollisionPair { a, b });
                }
            }
        }
        Ok(collision)
    }

    /// Adds an obstacle, in world axes, and its pairs with all capsules on moving bodies. The normal of a half-space is
    /// scaled to unit length. Returns the index of the obstacle.
    ///
    /// # Errors
    /// [`CollisionError`] if the name is used already or a number is invalid.
    pub fn add_obstacle(&mut self, name: &str, shape: CollisionShape) -> Result<usize, CollisionError> {
        let shape = checked(name, shape)?;
        let b = self.push(name, Holder::World, shape)?;
        let moving = self.objects.iter().enumerate().filter(|(_, object)| object.holder.body().is_some());
        self.pairs.extend(moving.map(|(a, _)| CollisionPair { a, b }));
        Ok(b)
    }

    /// Replaces the shape of an obstacle, in world axes. Does not allocate unless it fails.
    ///
    /// # Errors
    /// [`CollisionError`] if a number is invalid.
    ///
    /// # Panics
    /// If the object is not an obstacle.
    pub fn move_obstacle(&mut self, obstacle: usize, shape: CollisionShape) -> Result<(), CollisionError> {
        let object = &mut self.objects[obstacle];
        assert!(object.holder == Holder::World, "only obstacles are moved");
        object.shape = checked(&object.name, shape)?;
        object.reach_m = reach_m(&object.shape);
        Ok(())
    }

    /// Removes all pairs of two objects. Each is named by its own name, or by a link, for all capsules of the link.
    /// Returns the number of removed pairs.
    ///
    /// # Errors
    /// [`CollisionError::UnknownName`].
    pub fn drop_pairs(&mut self, first: &str, second: &str) -> Result<usize, CollisionError> {
        let (first, second) = (self.named(first)?, self.named(second)?);
        let before = self.pairs.len();
        self.pairs.retain(|pair| {
            let joins = |x: &[usize], y: &[usize]| x.contains(&pair.a) && y.contains(&pair.b);
            !joins(&first, &second) && !joins(&second, &first)
        });
        Ok(before - self.pairs.len())
    }

    /// Returns the objects: first the capsules of the robot, then the obstacles.
    #[must_use]
    pub fn objects(&self) -> &[CollisionObject] {
        &self.objects
    }

    /// Returns the pairs whose distances are computed.
    #[must_use]
    pub fn pairs(&self) -> &[CollisionPair] {
        &self.pairs
    }

    /// Returns the names of the objects of a pair.
    ///
    /// # Panics
    /// If there is no such pair.
    #[must_use]
    pub fn pair_names(&self, pair: usize) -> [&str; 2] {
        let CollisionPair { a, b } = self.pairs[pair];
        [&self.objects[a].name, &self.objects[b].name]
    }

    /// Returns the capsules of the robot in the frames of their links, as they were given: a list that can be written
    /// to a file, corrected and read again.
    #[must_use]
    pub fn capsules(&self) -> &[LinkCapsule] {
        &self.capsules
    }

    fn push(&mut self, name: &str, holder: Holder, shape: CollisionShape) -> Result<usize, CollisionError> {
        if self.objects.iter().any(|object| object.name == name) {
            return Err(CollisionError::DuplicateName { name: name.to_owned() });
        }
        self.objects.push(CollisionObject { name: name.to_owned(), holder, shape, reach_m: reach_m(&shape) });
        Ok(self.objects.len() - 1)
    }

    /// Returns the indices of the object with this name, or of the capsules of the link with this name.
    fn named(&self, name: &str) -> Result<Vec<usize>, CollisionError> {
        let is_named = |&i: &usize| {
            self.objects[i].name == name || self.capsules.get(i).is_some_and(|capsule| capsule.link == name)
        };
        let found: Vec<usize> = (0..self.objects.len()).filter(is_named).collect();
        if found.is_empty() {
            let known = self.objects.iter().map(|object| object.name.clone()).collect();
            return Err(CollisionError::UnknownName { name: name.to_owned(), known });
        }
        Ok(found)
    }
}

/// Returns true if two parts are the same, or parent and child.
fn are_connected(model: &Model, first: Holder, second: Holder) -> bool {
    let is_child = |child: Holder, parent: Holder| {
        child.body().is_some_and(|body| model.bodies()[body].parent == parent.body())
    };
    first == second || is_child(first, second) || is_child(second, first)
}

/// Returns a valid shape, with a unit normal.
fn checked(name: &str, shape: CollisionShape) -> Result<CollisionShape, CollisionError> {
    let valid = match shape {
        CollisionShape::Capsule(capsule) => capsule.is_valid().then_some(shape),
        CollisionShape::HalfSpace(mut plane) => {
            let largest = plane.normal.amax();
            let finite = plane.normal.iter().all(|x| x.is_finite()) && largest > 0.0;
            let valid = finite && plane.offset_m.abs() <= MAX_LENGTH_M;
            // Divided by the largest component first, because the square of a tiny or huge one under- or overflows.
            plane.normal = (plane.normal / largest).normalize();
            valid.then_some(CollisionShape::HalfSpace(plane))
        }
    };
    valid.ok_or_else(|| CollisionError::BadNumber { name: name.to_owned() })
}

/// Returns the radius of the sphere around the middle of a capsule that encloses it, m; 0 for a half-space.
fn reach_m(shape: &CollisionShape) -> f64 {
    match shape {
        CollisionShape::Capsule(Capsule { start_m, end_m, radius_m }) => {
            let half: Vector3<f64> = (end_m - start_m) * 0.5;
            half.norm() + radius_m
        }
        CollisionShape::HalfSpace(_) => 0.0,
    }
}

//! The robot: immutable once built, shared freely between threads.

use crate::spatial::{Inertia, Placement};
use nalgebra::{Matrix3, Unit, Vector3};
use thiserror::Error;

/// How a joint moves. Its axis is the z axis of its body's frame: see [`Model`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointKind {
    /// Turns about z between its limits; one coordinate, rad.
    Revolute,
    /// Turns about z without limits; one coordinate, rad (never a sine and a cosine).
    Continuous,
    /// Slides along z between its limits; one coordinate, m.
    Prismatic,
}

/// What a joint may do. Infinite where there is no limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Lowest position, rad or m.
    pub lower: f64,
    /// Highest position, rad or m.
    pub upper: f64,
    /// Highest speed, rad/s or m/s.
    pub velocity: f64,
    /// Highest torque or force, Nm or N.
    pub effort: f64,
}

/// A moving joint and the body it carries, with all that is fixed to that body.
#[derive(Clone, Debug)]
pub struct Joint {
    /// As in the URDF.
    pub name: String,
    /// How it moves.
    pub kind: JointKind,
    /// The joint whose body carries this one; `None` on the base. Always a lower index than its own.
    pub parent: Option<usize>,
    /// Pose of this body's frame in the parent body's frame (in the base frame without parent) at q = 0.
    pub origin: Placement,
    /// Inertia of the body and of everything fixed to it, in the body's frame.
    pub inertia: Inertia,
    /// What it may do.
    pub limits: Limits,
    /// Rotor inertia reflected to the joint (gear ratio squared times the rotor's), kg m² or kg.
    pub rotor_inertia: f64,
}

/// A named place on the robot: every link of the URDF is one.
#[derive(Clone, Debug)]
pub struct Frame {
    /// As in the URDF.
    pub name: String,
    /// The joint whose body carries it; `None` if it is fixed to the base.
    pub joint: Option<usize>,
    /// Its pose in that body's frame (in the base frame).
    pub placement: Placement,
}

/// Which [`Frame`] of a model: made by [`Model::frame`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct FrameId(pub(crate) usize);

/// A tree of joints from a fixed base, and the frames on it.
///
/// Bodies are numbered like the joints that carry them: parents before children, depth first, the
/// children of a link in the order of their joints' names (Pinocchio's order). Links joined by fixed
/// joints are one body; they remain as frames. Body frames are turned against the URDF's so that
/// every joint moves about or along its z axis: one code path, and the short one.
#[derive(Clone, Debug)]
pub struct Model {
    pub(crate) name: String,
    pub(crate) joints: Vec<Joint>,
    pub(crate) frames: Vec<Frame>,
    pub(crate) gravity: Vector3<f64>,
    pub(crate) base: Placement,
}

/// A frame that the model doesn't have.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("no frame '{name}'; the frames are: {}", known.join(", "))]
pub struct UnknownFrame {
    /// The name asked for.
    pub name: String,
    /// The names there are.
    pub known: Vec<String>,
}

/// A joint that the model doesn't have.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("no joint '{name}'; the joints are: {}", known.join(", "))]
pub struct UnknownJoint {
    /// The name asked for.
    pub name: String,
    /// The names there are.
    pub known: Vec<String>,
}

impl Model {
    /// A model from its parts, under standard gravity with its base at the world's origin.
    ///
    /// # Panics
    /// If a joint's parent doesn't come before it, or a frame's joint doesn't exist: the loader
    /// guarantees both.
    #[must_use]
    pub fn new(name: String, joints: Vec<Joint>, frames: Vec<Frame>) -> Self {
        assert!(joints.iter().enumerate().all(|(i, j)| j.parent.is_none_or(|p| p < i)));
        assert!(frames.iter().all(|f| f.joint.is_none_or(|j| j < joints.len())));
        Self { name, joints, frames, gravity: Vector3::new(0.0, 0.0, -9.81), base: Placement::identity() }
    }

    /// The same robot elsewhere: pose of the base frame in the world.
    #[must_use]
    pub fn with_base(mut self, base: Placement) -> Self {
        self.base = base;
        self
    }

    /// The same robot under another gravity, m/s² in world axes.
    #[must_use]
    pub fn with_gravity(mut self, gravity: Vector3<f64>) -> Self {
        self.gravity = gravity;
        self
    }

    /// The same robot with its rotors' reflected inertias, kg m² (kg for a prismatic joint), one a joint.
    ///
    /// # Panics
    /// If there is not one for each joint.
    #[must_use]
    pub fn with_rotor_inertia(mut self, inertia: &[f64]) -> Self {
        assert_eq!(inertia.len(), self.joints.len(), "one rotor inertia a joint");
        for (joint, &value) in self.joints.iter_mut().zip(inertia) {
            joint.rotor_inertia = value;
        }
        self
    }

    /// The same robot with every mass and rotational inertia multiplied by `factor` (rotors too).
    #[must_use]
    pub fn with_scaled_inertia(mut self, factor: f64) -> Self {
        for joint in &mut self.joints {
            joint.inertia.mass *= factor;
            joint.inertia.rotational *= factor;
            joint.rotor_inertia *= factor;
        }
        self
    }

    /// The robot's name in the URDF.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// How many joints move: the length of q, q̇ and τ.
    #[must_use]
    pub fn n(&self) -> usize {
        self.joints.len()
    }

    /// The joints, in the order of q.
    #[must_use]
    pub fn joints(&self) -> &[Joint] {
        &self.joints
    }

    /// The frames, in the order of the URDF's tree.
    #[must_use]
    pub fn frames(&self) -> &[Frame] {
        &self.frames
    }

    /// Gravity in world axes, m/s².
    #[must_use]
    pub fn gravity(&self) -> Vector3<f64> {
        self.gravity
    }

    /// Pose of the base frame in the world.
    #[must_use]
    pub fn base(&self) -> Placement {
        self.base
    }

    /// Mass of all moving bodies, kg.
    #[must_use]
    pub fn total_mass(&self) -> f64 {
        self.joints.iter().map(|j| j.inertia.mass).sum()
    }

    /// The frame of that name.
    ///
    /// # Errors
    /// [`UnknownFrame`], which lists the names there are.
    pub fn frame(&self, name: &str) -> Result<FrameId, UnknownFrame> {
        self.frames.iter().position(|f| f.name == name).map(FrameId).ok_or_else(|| UnknownFrame {
            name: name.to_owned(),
            known: self.frames.iter().map(|f| f.name.clone()).collect(),
        })
    }

    /// The index of the joint of that name.
    ///
    /// # Errors
    /// [`UnknownJoint`], which lists the names there are.
    pub fn joint(&self, name: &str) -> Result<usize, UnknownJoint> {
        self.joints.iter().position(|j| j.name == name).ok_or_else(|| UnknownJoint {
            name: name.to_owned(),
            known: self.joints.iter().map(|j| j.name.clone()).collect(),
        })
    }

    /// What is known of a frame.
    #[must_use]
    pub fn frame_info(&self, frame: FrameId) -> &Frame {
        &self.frames[frame.0]
    }

    /// The joint that carries a frame and all joints between it and the base, from the frame inwards.
    pub fn support(&self, frame: FrameId) -> impl Iterator<Item = usize> + '_ {
        std::iter::successors(self.frames[frame.0].joint, |&j| self.joints[j].parent)
    }
}

/// The rotation that turns the z axis onto `axis`, exact for the coordinate axes.
#[must_use]
pub fn z_onto(axis: &Unit<Vector3<f64>>) -> Matrix3<f64> {
    let z = axis.into_inner();
    // The coordinate axis least along z makes the best-conditioned frame.
    let helper = Vector3::ith(z.iamin(), 1.0);
    if z == Vector3::z() {
        return Matrix3::identity();
    }
    let x = helper.cross(&z).normalize();
    Matrix3::from_columns(&[x, z.cross(&x), z])
}

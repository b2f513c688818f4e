//! Model of a robot: its bodies, the coordinates that move them, and the frames on them.
//!
//! ```
//! use nalgebra::{Matrix3, Vector3};
//! use opspace_model::{Inertia, Joint, JointKind, Limits, Model, Placement};
//!
//! let rod = Inertia { mass: 1.0, com: Vector3::new(0.0, 0.5, 0.0), rotational: Matrix3::identity() * 0.01 };
//! let joint = Joint { name: "hinge".into(), kind: JointKind::Revolute, limits: Limits::NONE };
//! let mut model = Model::new("pendulum");
//! let body = model.add_body(None, Placement::identity(), joint, rod);
//! let tip = model.add_frame("tip", Some(body), Placement::from_rpy([0.0; 3], [0.0, 1.0, 0.0]));
//! model.set_payload(tip, Inertia { mass: 0.2, ..Inertia::zero() });
//! assert_eq!(model.total_mass(), 1.2);
//! ```

use crate::real::Real;
use crate::spatial::{Inertia, Placement};
use nalgebra::{Matrix3, Unit, Vector3};
use thiserror::Error;

/// Type of the joint between a body and its parent. Its axis is the z axis of the body's own frame: see [`Model`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointKind {
    /// Turns about z between its limits; one coordinate, rad.
    Revolute,
    /// Turns about z without limits; one coordinate, rad (never a sine and a cosine).
    Continuous,
    /// Slides along z between its limits; one coordinate, m.
    Prismatic,
    /// One of the six by which a floating base moves: see [`Model::floating`].
    Floating,
}

/// SI units of the quantities of all joints (n each): of revolute joints rad, rad/s, rad/s^2 and Nm, of prismatic ones
/// m, m/s, m/s^2 and N.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct JointUnits {
    /// Units of positions.
    pub position: Vec<&'static str>,
    /// Units of velocities.
    pub velocity: Vec<&'static str>,
    /// Units of accelerations.
    pub acceleration: Vec<&'static str>,
    /// Units of torques and forces.
    pub torque: Vec<&'static str>,
}

/// Limits of a joint, infinite where there is none.
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

impl Limits {
    /// Limits of a joint without any.
    pub const NONE: Self = Self {
        lower: f64::NEG_INFINITY,
        upper: f64::INFINITY,
        velocity: f64::INFINITY,
        effort: f64::INFINITY,
    };
}

/// Returns true if coordinate `i` of that kind is a length: the first three of a floating base are.
fn slides(kind: JointKind, i: usize) -> bool {
    kind == JointKind::Prismatic || (kind == JointKind::Floating && i < 3)
}

/// A coordinate of the robot: one entry of q̇, q̈ and τ.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// Name of the joint in the URDF.
    pub name: String,
    /// Type of the joint.
    pub kind: JointKind,
    /// Limits of position, speed and torque.
    pub limits: Limits,
}

/// Rigid body: a link with a joint of its own, and all that is fixed to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body<T = f64> {
    /// Index of the parent body, always lower than its own; `None` on the base.
    pub parent: Option<usize>,
    /// Pose of this body's frame in the parent body's frame (in the base frame without parent) at zero.
    pub origin: Placement<T>,
    /// Type of the joint that moves the body.
    pub kind: JointKind,
    /// Index of the joint that moves the body: the body's own index, unless joints have been folded.
    pub joint: usize,
    /// True if that is the joint of another body, which this one follows.
    pub follows: bool,
    /// Ratio of the body's joint position, `ratio` q + `offset`: 1 unless it follows another.
    pub ratio: T,
    /// Offset of the body's joint position, rad or m.
    pub offset: T,
    /// Inertia of the body and of everything fixed to it, payloads included, in the body's frame.
    pub inertia: Inertia<T>,
}

/// Named frame on the robot: every link of the URDF is one.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame<T = f64> {
    /// Name of the frame in the URDF.
    pub name: String,
    /// Index of the body that the frame is fixed to; `None` if it is fixed to the base.
    pub body: Option<usize>,
    /// Pose of the frame in that body's frame (in the base frame without body).
    pub placement: Placement<T>,
}

/// Handle of a [`Frame`] of a model, returned by [`Model::frame`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct FrameId(pub(crate) usize);

/// Tree of bodies on a fixed or floating base, and the frames on it.
///
/// Bodies are numbered parents before children, depth first, the children of a link in the order of their
/// joints' names (Pinocchio's order). Links joined by fixed joints are one body; they remain as frames.
/// Body frames are turned against the URDF's so that every joint moves about or along its z axis: one code
/// path, and the short one.
///
/// Inertias, payloads and frames may be changed between two evaluations, without allocation except for new
/// frames; the number of bodies and joints is constant.
#[derive(Clone, Debug)]
pub struct Model<T = f64> {
    pub(crate) name: String,
    pub(crate) joints: Vec<Joint>,
    pub(crate) bodies: Vec<Body<T>>,
    pub(crate) frames: Vec<Frame<T>>,
    pub(crate) rotor_inertia: Vec<T>,
    pub(crate) gravity: Vector3<T>,
    pub(crate) base: Placement<T>,
    pub(crate) floating: bool,
    /// Inertia of each body without payloads, and payload of each frame in that frame.
    pub(crate) own: Vec<Inertia>,
    pub(crate) payloads: Vec<Inertia>,
}

/// Frame that the model doesn't have.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("no frame '{name}'; the frames are: {}", known.join(", "))]
#[non_exhaustive]
pub struct UnknownFrame {
    /// Name asked for.
    pub name: String,
    /// Names of the model's frames.
    pub known: Vec<String>,
}

/// Joint that the model doesn't have.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("no joint '{name}'; the joints are: {}", known.join(", "))]
#[non_exhaustive]
pub struct UnknownJoint {
    /// Name asked for.
    pub name: String,
    /// Names of the model's joints.
    pub known: Vec<String>,
}

/// Names of the coordinates of a floating base, in their order.
pub(crate) const BASE_JOINTS: [&str; 6] =
    ["base.linear.x", "base.linear.y", "base.linear.z", "base.angular.x", "base.angular.y", "base.angular.z"];

/// Construction and modification.
impl Model {
    /// Returns a robot without bodies, its base fixed at the world's origin, under standard gravity.
    #[must_use]
    pub fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            joints: Vec::new(),
            bodies: Vec::new(),
            frames: Vec::new(),
            rotor_inertia: Vec::new(),
            gravity: Vector3::new(0.0, 0.0, -9.81),
            base: Placement::identity(),
            floating: false,
            own: Vec::new(),
            payloads: Vec::new(),
        }
    }

    /// Returns a robot whose root is free to move in space: a body of that inertia, and no other yet.
    ///
    /// Six coordinates come first in q̇: the root's linear and angular velocity, in its own axes. In q they are
    /// seven: its position in the world (m) and the unit quaternion x, y, z, w of its rotation. In the tree they
    /// are a chain of six bodies at one place, of which the last, number 5, has the inertia.
    #[must_use]
    pub fn floating(name: &str, root: Inertia) -> Self {
        let mut model = Self::new(name);
        model.floating = true;
        for (i, coordinate) in BASE_JOINTS.into_iter().enumerate() {
            let joint =
                Joint { name: coordinate.to_owned(), kind: JointKind::Floating, limits: Limits::NONE };
            let inertia = if i == 5 { root } else { Inertia::zero() };
            model.push(i.checked_sub(1), Placement::identity(), joint, inertia);
        }
        model
    }

    /// Adds a body that moves by a joint of its own, about or along z of its frame, whose pose at zero in the frame of
    /// `parent` (of the base) is `origin`. Returns its number.
    ///
    /// # Panics
    /// If there is no such parent, or the joint is of kind [`Floating`](JointKind::Floating).
    pub fn add_body(
        &mut self,
        parent: Option<usize>,
        origin: Placement,
        joint: Joint,
        inertia: Inertia,
    ) -> usize {
        assert!(joint.kind != JointKind::Floating, "only Model::floating makes a floating base");
        self.push(self.on_root(parent), origin, joint, inertia)
    }

    /// Parent of a body on the root: none on a fixed base, the last of the six bodies of a floating one.
    fn on_root(&self, parent: Option<usize>) -> Option<usize> {
        let parent = if self.floating { Some(parent.map_or(5, |p| p.max(5))) } else { parent };
        assert!(parent.is_none_or(|p| p < self.bodies.len()), "a parent comes before its children");
        parent
    }

    fn push(&mut self, parent: Option<usize>, origin: Placement, joint: Joint, inertia: Inertia) -> usize {
        let (kind, number) = (joint.kind, self.joints.len());
        self.joints.push(joint);
        self.rotor_inertia.push(0.0);
        self.bodies.push(Body {
            parent,
            origin,
            kind,
            joint: number,
            follows: false,
            ratio: 1.0,
            offset: 0.0,
            inertia,
        });
        self.own.push(inertia);
        self.bodies.len() - 1
    }

    /// Adds a frame at `placement` in the frame of `body` (of the base, which may float). Of two frames of one name
    /// [`Model::frame`] returns the first.
    ///
    /// # Panics
    /// If there is no such body.
    pub fn add_frame(&mut self, name: &str, body: Option<usize>, placement: Placement) -> FrameId {
        let body = self.on_root(body);
        self.frames.push(Frame { name: name.to_owned(), body, placement });
        self.payloads.push(Inertia::zero());
        FrameId(self.frames.len() - 1)
    }

    /// Adds a frame at a fixed offset from another: the tip of a tool, a point of contact.
    pub fn add_frame_on(&mut self, name: &str, on: FrameId, offset: Placement) -> FrameId {
        let &Frame { body, placement, .. } = &self.frames[on.0];
        self.add_frame(name, body, placement * offset)
    }

    /// Attaches a frame to the body of the frame `on`, with the placement `offset` in the axes of `on`.
    pub fn move_frame(&mut self, frame: FrameId, on: FrameId, offset: Placement) {
        let &Frame { body, placement, .. } = &self.frames[on.0];
        self.frames[frame.0].placement = placement * offset;
        let before = std::mem::replace(&mut self.frames[frame.0].body, body);
        self.update_body_inertia(before);
        self.update_body_inertia(body);
    }

    /// Sets the payload of a frame, in its axes: a tool, a load; no negative mass. It replaces the payload set before;
    /// zero removes it. A payload on the base is ignored.
    pub fn set_payload(&mut self, frame: FrameId, payload: Inertia) {
        self.payloads[frame.0] = payload;
        self.update_body_inertia(self.frames[frame.0].body);
    }

    /// Replaces the inertia of a body and all that is fixed to it, payloads apart, in the body's frame. That is turned
    /// against the URDF's: an inertia in the axes of a link is `frame(link).placement.act_inertia(&inertia)` here.
    ///
    /// # Panics
    /// If there is no such body, or it is one of the first five of a floating base, which are coordinates only.
    pub fn set_inertia(&mut self, body: usize, inertia: Inertia) {
        assert!(!self.floating || body >= 5, "body 5 is the floating base");
        self.own[body] = inertia;
        self.update_body_inertia(Some(body));
    }

    /// Computes a body's inertia from its own and its frames' payloads. Summed anew each time, so that a removed
    /// payload leaves no rounding error.
    pub(crate) fn update_body_inertia(&mut self, body: Option<usize>) {
        let Some(body) = body else { return };
        self.bodies[body].inertia = self.own[body];
        for (frame, payload) in self.frames.iter().zip(&self.payloads) {
            if frame.body == Some(body) && *payload != Inertia::zero() {
                let carried = frame.placement.act_inertia(payload);
                self.bodies[body].inertia = self.bodies[body].inertia + carried;
            }
        }
    }

    /// Sets the limits of a joint.
    ///
    /// # Panics
    /// If there is no such joint.
    pub fn set_limits(&mut self, joint: usize, limits: Limits) {
        self.joints[joint].limits = limits;
    }

    /// Returns the robot with its base frame at that pose in the world. The q of a floating base is
    /// relative to it.
    #[must_use]
    pub fn with_base(mut self, base: Placement) -> Self {
        self.base = base;
        self
    }

    /// Returns the robot under another gravity, m/s² in world axes.
    #[must_use]
    pub fn with_gravity(mut self, gravity: Vector3<f64>) -> Self {
        self.gravity = gravity;
        self
    }

    /// Returns the robot with these reflected inertias of its rotors, kg m² (kg for a prismatic joint), one per joint.
    ///
    /// # Panics
    /// If there is not one for each joint.
    #[must_use]
    pub fn with_rotor_inertia(mut self, inertia: &[f64]) -> Self {
        self.rotor_inertia.copy_from_slice(inertia);
        self
    }

    /// Returns the robot with every mass and rotational inertia multiplied by `factor` (rotors and payloads too).
    #[must_use]
    pub fn with_scaled_inertia(mut self, factor: f64) -> Self {
        let inertias = self.own.iter_mut().chain(&mut self.payloads);
        for inertia in inertias.chain(self.bodies.iter_mut().map(|b| &mut b.inertia)) {
            inertia.mass *= factor;
            inertia.rotational *= factor;
        }
        self.rotor_inertia.iter_mut().for_each(|rotor| *rotor *= factor);
        self
    }

    /// Returns the robot with its numbers in every lane: see the module `batch`, with feature `simd`.
    #[must_use]
    pub fn splat<T: Real>(&self) -> Model<T> {
        let body = |b: &Body| Body {
            parent: b.parent,
            origin: b.origin.splat(),
            kind: b.kind,
            joint: b.joint,
            follows: b.follows,
            ratio: T::splat(b.ratio),
            offset: T::splat(b.offset),
            inertia: b.inertia.splat(),
        };
        let frame = |f: &Frame| Frame { name: f.name.clone(), body: f.body, placement: f.placement.splat() };
        Model {
            name: self.name.clone(),
            joints: self.joints.clone(),
            bodies: self.bodies.iter().map(body).collect(),
            frames: self.frames.iter().map(frame).collect(),
            rotor_inertia: self.rotor_inertia.iter().map(|&r| T::splat(r)).collect(),
            gravity: self.gravity.map(T::splat),
            base: self.base.splat(),
            floating: self.floating,
            own: self.own.clone(),
            payloads: self.payloads.clone(),
        }
    }
}

impl<T: Real> Model<T> {
    /// Name of the robot in the URDF.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Number of degrees of freedom: the length of q̇, q̈ and τ. Pinocchio's `nv`.
    #[must_use]
    pub fn n(&self) -> usize {
        self.joints.len()
    }

    /// Length of q: one more than [`n`](Self::n) with a floating base, whose rotation is a quaternion.
    #[must_use]
    pub fn nq(&self) -> usize {
        self.n() + usize::from(self.floating)
    }

    /// True if the root is free to move.
    #[must_use]
    pub fn is_floating(&self) -> bool {
        self.floating
    }

    /// True if some body follows the joint of another.
    #[must_use]
    pub fn has_mimic_constraints(&self) -> bool {
        self.bodies.len() > self.joints.len()
    }

    /// Joints, in the order of q̇.
    #[must_use]
    pub fn joints(&self) -> &[Joint] {
        &self.joints
    }

    /// Units of the joints' quantities, in the order of q̇.
    #[must_use]
    pub fn joint_units(&self) -> JointUnits {
        let units = |linear, angular| {
            let unit = |(i, joint): (usize, &Joint)| if slides(joint.kind, i) { linear } else { angular };
            self.joints.iter().enumerate().map(unit).collect()
        };
        JointUnits {
            position: units("m", "rad"),
            velocity: units("m/s", "rad/s"),
            acceleration: units("m/s^2", "rad/s^2"),
            torque: units("N", "Nm"),
        }
    }

    /// Bodies, parents before children.
    #[must_use]
    pub fn bodies(&self) -> &[Body<T>] {
        &self.bodies
    }

    /// Inertia of the rotors reflected to each joint (gear ratio squared times the rotor's), kg m² or kg (n).
    #[must_use]
    pub fn rotor_inertia(&self) -> &[T] {
        &self.rotor_inertia
    }

    /// Frames, in the order of the URDF's tree.
    #[must_use]
    pub fn frames(&self) -> &[Frame<T>] {
        &self.frames
    }

    /// Gravity in world axes, m/s².
    #[must_use]
    pub fn gravity(&self) -> Vector3<T> {
        self.gravity
    }

    /// Pose of the base frame in the world.
    #[must_use]
    pub fn base(&self) -> Placement<T> {
        self.base
    }

    /// Mass of all moving bodies, kg.
    #[must_use]
    pub fn total_mass(&self) -> T {
        self.bodies.iter().fold(T::zero(), |sum, body| sum + body.inertia.mass)
    }

    /// Returns the frame of that name.
    ///
    /// # Errors
    /// [`UnknownFrame`], which lists the names of the model.
    pub fn frame_id(&self, name: &str) -> Result<FrameId, UnknownFrame> {
        self.frames.iter().position(|f| f.name == name).map(FrameId).ok_or_else(|| UnknownFrame {
            name: name.to_owned(),
            known: self.frames.iter().map(|f| f.name.clone()).collect(),
        })
    }

    /// Returns the index of the joint of that name.
    ///
    /// # Errors
    /// [`UnknownJoint`], which lists the names of the model.
    pub fn joint(&self, name: &str) -> Result<usize, UnknownJoint> {
        self.joints.iter().position(|j| j.name == name).ok_or_else(|| UnknownJoint {
            name: name.to_owned(),
            known: self.joints.iter().map(|j| j.name.clone()).collect(),
        })
    }

    /// Returns the name, body and placement of a frame.
    #[must_use]
    pub fn frame(&self, frame: FrameId) -> &Frame<T> {
        &self.frames[frame.0]
    }

    /// Index of the first body with a joint: the bodies before it are those of a floating base.
    pub(crate) fn first_jointed_body(&self) -> usize {
        if self.floating { 6 } else { 0 }
    }

    /// Returns the body of a frame and all its ancestors, from the frame towards the base.
    pub fn ancestors(&self, frame: FrameId) -> impl Iterator<Item = usize> + '_ {
        self.ancestry(self.frames[frame.0].body)
    }

    /// Returns a body and all its ancestors, from it towards the base.
    pub(crate) fn ancestry(&self, body: Option<usize>) -> impl Iterator<Item = usize> + '_ {
        std::iter::successors(body, |&b| self.bodies[b].parent)
    }
}

/// Rotation that turns the z axis onto `axis`, exact for the coordinate axes.
#[must_use]
pub fn rotation_z_to(axis: &Unit<Vector3<f64>>) -> Matrix3<f64> {
    let z = axis.into_inner();
    if z == Vector3::z() {
        return Matrix3::identity();
    }
    // The coordinate axis least along z makes the best-conditioned frame.
    let x = Vector3::ith(z.iamin(), 1.0).cross(&z).normalize();
    Matrix3::from_columns(&[x, z.cross(&x), z])
}

//! The robot: its bodies, the coordinates that move them, and the frames on them.
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

/// How a body moves against the one that carries it. Its axis is the z axis of its own frame: see [`Model`].
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

impl Limits {
    /// No limit at all.
    pub const NONE: Self = Self {
        lower: f64::NEG_INFINITY,
        upper: f64::INFINITY,
        velocity: f64::INFINITY,
        effort: f64::INFINITY,
    };
}

/// A coordinate of the robot: one entry of q̇, q̈ and τ.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// As in the URDF.
    pub name: String,
    /// How it moves.
    pub kind: JointKind,
    /// What it may do.
    pub limits: Limits,
}

/// What moves as one: a link with a joint of its own, and all that is fixed to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body<T = f64> {
    /// The body that carries this one; `None` on the base. Always a lower index than its own.
    pub parent: Option<usize>,
    /// Pose of this body's frame in the parent body's frame (in the base frame without parent) at zero.
    pub origin: Placement<T>,
    /// How it moves.
    pub kind: JointKind,
    /// The coordinate that moves it: body i is moved by joint i, unless joints have been folded.
    pub joint: usize,
    /// Whether that is the joint of another, which it follows.
    pub follows: bool,
    /// It moves to `ratio` q + `offset`: 1 but for one that follows.
    pub ratio: T,
    /// rad or m.
    pub offset: T,
    /// Inertia of the body and of everything fixed to it, payloads included, in the body's frame.
    pub inertia: Inertia<T>,
}

/// A named place on the robot: every link of the URDF is one.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame<T = f64> {
    /// As in the URDF.
    pub name: String,
    /// The body that carries it; `None` if it is fixed to the base.
    pub body: Option<usize>,
    /// Its pose in that body's frame (in the base frame).
    pub placement: Placement<T>,
}

/// Which [`Frame`] of a model: made by [`Model::frame`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct FrameId(pub(crate) usize);

/// A tree of bodies on a fixed or floating base, and the frames on it.
///
/// Bodies are numbered parents before children, depth first, the children of a link in the order of their
/// joints' names (Pinocchio's order). Links joined by fixed joints are one body; they remain as frames.
/// Body frames are turned against the URDF's so that every joint moves about or along its z axis: one code
/// path, and the short one.
///
/// Inertias, payloads and frames may be changed between two evaluations, without allocation but for new
/// frames; the number of bodies and joints stays.
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
    /// Each body's inertia without payloads, and each frame's payload in that frame.
    pub(crate) own: Vec<Inertia>,
    pub(crate) payloads: Vec<Inertia>,
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

/// The coordinates of a floating base, in their order.
pub(crate) const BASE_JOINTS: [&str; 6] =
    ["base.linear.x", "base.linear.y", "base.linear.z", "base.angular.x", "base.angular.y", "base.angular.z"];

/// Building and changing.
impl Model {
    /// A robot without bodies yet, its base fixed at the world's origin, under standard gravity.
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

    /// A robot whose root is free to move in space: a body of that inertia, and none on it yet.
    ///
    /// Six coordinates come first in q̇: the root's linear and angular velocity, in its own axes. In q they are
    /// seven: its position in the world (m) and the unit quaternion x, y, z, w of its rotation. In the tree they
    /// are six bodies in a row at one place, of which the last, number 5, carries the inertia.
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

    /// What has no parent stands on the root; a floating one is the last of its six bodies.
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

    /// Adds a frame at `placement` in the frame of `body` (of the base, which may float). Of two of one name the first is
    /// found.
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

    /// Moves a frame to another offset from `on`.
    pub fn move_frame(&mut self, frame: FrameId, on: FrameId, offset: Placement) {
        let &Frame { body, placement, .. } = &self.frames[on.0];
        self.frames[frame.0].placement = placement * offset;
        let before = std::mem::replace(&mut self.frames[frame.0].body, body);
        self.sum_up(before);
        self.sum_up(body);
    }

    /// What hangs on a frame, in its axes: a tool, a load; no negative mass. It replaces what hung there before; zero
    /// takes it off. Nothing hangs on the base.
    pub fn set_payload(&mut self, frame: FrameId, payload: Inertia) {
        self.payloads[frame.0] = payload;
        self.sum_up(self.frames[frame.0].body);
    }

    /// Another inertia for a body and all that is fixed to it, payloads apart, in its frame. That is turned against the
    /// URDF's: what is given in the axes of a link is `frame_info(link).placement.act_inertia(&inertia)` here.
    ///
    /// # Panics
    /// If there is no such body, or it is one of the first five of a floating base, which are nothing but coordinates.
    pub fn set_inertia(&mut self, body: usize, inertia: Inertia) {
        assert!(!self.floating || body >= 5, "body 5 is the floating base");
        self.own[body] = inertia;
        self.sum_up(Some(body));
    }

    /// A body's inertia from its own and its frames' payloads. From the beginning, so that what is taken
    /// off leaves no rounding.
    pub(crate) fn sum_up(&mut self, body: Option<usize>) {
        let Some(body) = body else { return };
        self.bodies[body].inertia = self.own[body];
        for (frame, payload) in self.frames.iter().zip(&self.payloads) {
            if frame.body == Some(body) && *payload != Inertia::zero() {
                let carried = frame.placement.act_inertia(payload);
                self.bodies[body].inertia = self.bodies[body].inertia + carried;
            }
        }
    }

    /// What a joint may do from now on.
    ///
    /// # Panics
    /// If there is no such joint.
    pub fn set_limits(&mut self, joint: usize, limits: Limits) {
        self.joints[joint].limits = limits;
    }

    /// The same robot elsewhere: pose of the base frame in the world. What q says of a floating base is
    /// relative to it.
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
        self.rotor_inertia.copy_from_slice(inertia);
        self
    }

    /// The same robot with every mass and rotational inertia multiplied by `factor` (rotors and payloads too).
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

    /// The same robot in every lane: see [`batch`](crate::batch).
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
    /// The robot's name in the URDF.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// How many coordinates move: the length of q̇, q̈ and τ. Pinocchio's `nv`.
    #[must_use]
    pub fn n(&self) -> usize {
        self.joints.len()
    }

    /// The length of q: one more than [`n`](Self::n) with a floating base, whose rotation is a quaternion.
    #[must_use]
    pub fn nq(&self) -> usize {
        self.n() + usize::from(self.floating)
    }

    /// Whether the root is free to move.
    #[must_use]
    pub fn is_floating(&self) -> bool {
        self.floating
    }

    /// Whether some body follows the joint of another.
    #[must_use]
    pub fn is_folded(&self) -> bool {
        self.bodies.len() > self.joints.len()
    }

    /// The joints, in the order of q̇.
    #[must_use]
    pub fn joints(&self) -> &[Joint] {
        &self.joints
    }

    /// The bodies, parents before children.
    #[must_use]
    pub fn bodies(&self) -> &[Body<T>] {
        &self.bodies
    }

    /// Inertia of the rotors reflected to each joint (gear ratio squared times the rotor's), kg m² or kg (n).
    #[must_use]
    pub fn rotor_inertia(&self) -> &[T] {
        &self.rotor_inertia
    }

    /// The frames, in the order of the URDF's tree.
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
    pub fn frame_info(&self, frame: FrameId) -> &Frame<T> {
        &self.frames[frame.0]
    }

    /// The bodies before it are those of a floating base.
    pub(crate) fn first_jointed_body(&self) -> usize {
        if self.floating { 6 } else { 0 }
    }

    /// The body that carries a frame and all bodies between it and the base, from the frame inwards.
    pub fn support(&self, frame: FrameId) -> impl Iterator<Item = usize> + '_ {
        self.ancestry(self.frames[frame.0].body)
    }

    /// A body and all that carry it, from it inwards.
    pub(crate) fn ancestry(&self, body: Option<usize>) -> impl Iterator<Item = usize> + '_ {
        std::iter::successors(body, |&b| self.bodies[b].parent)
    }
}

/// The rotation that turns the z axis onto `axis`, exact for the coordinate axes.
#[must_use]
pub fn z_onto(axis: &Unit<Vector3<f64>>) -> Matrix3<f64> {
    let z = axis.into_inner();
    if z == Vector3::z() {
        return Matrix3::identity();
    }
    // The coordinate axis least along z makes the best-conditioned frame.
    let x = Vector3::ith(z.iamin(), 1.0).cross(&z).normalize();
    Matrix3::from_columns(&[x, z.cross(&x), z])
}

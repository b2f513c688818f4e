//! Model of a robot: bodies, joints and frames.
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
use std::f64::consts::{PI, TAU};
use thiserror::Error;

/// Type of the joint between a body and its parent. The joint axis is the z axis of the body frame: see [`Model`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointKind {
    /// Rotates about z within position limits; one coordinate, rad.
    Revolute,
    /// Rotates about z without position limits; one coordinate, rad (not the pair of sine and cosine).
    Continuous,
    /// Translates along z within position limits; one coordinate, m.
    Prismatic,
    /// One of the six coordinates of a floating base: see [`Model::floating`].
    Floating,
}

impl JointKind {
    /// Returns the position that a joint of this kind cannot tell from `position` and that is nearest to `near` (rad). It
    /// differs from `position` by whole turns of a continuous joint; where it is no more than half a turn away, and for other
    /// joints, it is `position`.
    #[must_use]
    pub fn nearest_turn(self, position: f64, near: f64) -> f64 {
        let away = position - near;
        if self == Self::Continuous && away.abs() > PI {
            position - TAU * (away / TAU).round()
        } else {
            position
        }
    }
}

/// SI units of the quantities of all joints (n each): rad, rad/s, rad/s^2 and Nm for revolute joints; m, m/s, m/s^2 and
/// N for prismatic joints.
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

/// Limits of a joint; infinite for no limit.
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
    /// Limits of an unlimited joint.
    pub const NONE: Self = Self {
        lower: f64::NEG_INFINITY,
        upper: f64::INFINITY,
        velocity: f64::INFINITY,
        effort: f64::INFINITY,
    };

    /// Position range of a joint of this kind, rad or m; ±π rad or ±1 m where it has no limit, or twice that from a limit beyond it.
    #[must_use]
    pub fn range(&self, kind: JointKind) -> (f64, f64) {
        let far = if kind == JointKind::Prismatic { 1.0 } else { PI };
        let limited = kind != JointKind::Continuous;
        let or_far = |limit: f64, far: f64| if limited && limit.is_finite() { limit } else { far };
        let (lower, upper) = (or_far(self.lower, -far), or_far(self.upper, far));
        if lower <= upper {
            return (lower, upper);
        }
        // The only limit is beyond the range.
        if self.lower.is_finite() { (lower, lower + 2.0 * far) } else { (upper - 2.0 * far, upper) }
    }
}

/// Returns true if coordinate `i`, of that kind, is a length: a prismatic joint, or one of the first three coordinates
/// of a floating base.
fn slides(kind: JointKind, i: usize) -> bool {
    kind == JointKind::Prismatic || (kind == JointKind::Floating && i < 3)
}

/// Joint coordinate of the robot: one entry of q̇, q̈ and τ.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// Name of the joint in the URDF.
    pub name: String,
    /// Type of the joint.
    pub kind: JointKind,
    /// Limits of position, speed and torque.
    pub limits: Limits,
}

/// Rigid body: a link that is moved by a joint, with everything fixed to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body<T = f64> {
    /// Index of the parent body, which is always lower than the index of this body; `None` if the parent is the base.
    pub parent: Option<usize>,
    /// Pose of this body's frame in the frame of the parent body (of the base, if `parent` is `None`) at joint position
    /// zero.
    pub origin: Placement<T>,
    /// Type of the joint that moves the body.
    pub kind: JointKind,
    /// Index of the joint that moves the body. It equals the index of the body unless the model has mimic constraints.
    pub joint: usize,
    /// True if the body belongs to a mimic joint: `joint` is then the leader.
    pub follows: bool,
    /// Ratio in the position of the body's joint, `ratio` q + `offset`; 1 unless the body belongs to a mimic joint.
    pub ratio: T,
    /// Offset in the position of the body's joint, rad or m.
    pub offset: T,
    /// Inertia of the body and everything fixed to it, including payloads, in the body frame.
    pub inertia: Inertia<T>,
}

/// Named frame on the robot. Every link of the URDF has one.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame<T = f64> {
    /// Name of the link in the URDF, or of the added frame.
    pub name: String,
    /// Index of the body to which the frame is fixed; `None` for the base.
    pub body: Option<usize>,
    /// Pose of the frame in the frame of that body (of the base, if `body` is `None`).
    pub placement: Placement<T>,
}

/// Handle of a [`Frame`] of a model, returned by [`Model::frame_id`] and [`Model::add_frame`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct FrameId(pub(crate) usize);

/// Kinematic tree of bodies on a fixed or floating base, with its frames.
///
/// Bodies are numbered depth first, parents before children; the children of a link are in the order of their joint
/// names (Pinocchio's order). Links connected by fixed joints form one body; each link remains as a frame. Body frames
/// are rotated relative to the link frames of the URDF so that every joint moves about or along the z axis of its body.
/// One short formula then covers all axes.
///
/// Inertias, payloads and frames may be changed between two evaluations; only adding a frame allocates. The numbers of
/// bodies and joints must not change after [`Data`](crate::Data) is allocated for the model.
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
    /// Inertias of the bodies without payloads (`own`, in body axes) and payloads of the frames (`payloads`, in frame
    /// axes).
    pub(crate) own: Vec<Inertia>,
    pub(crate) payloads: Vec<Inertia>,
}

/// Error: the model has no frame with this name.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("no frame '{name}'; the frames are: {}", known.join(", "))]
#[non_exhaustive]
pub struct UnknownFrame {
    /// Requested name.
    pub name: String,
    /// Names of the model's frames.
    pub known: Vec<String>,
}

/// Error: the model has no joint with this name.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("no joint '{name}'; the joints are: {}", known.join(", "))]
#[non_exhaustive]
pub struct UnknownJoint {
    /// Requested name.
    pub name: String,
    /// Names of the model's joints.
    pub known: Vec<String>,
}

/// Names of the coordinates of a floating base, in the order of q̇.
pub(crate) const BASE_JOINTS: [&str; 6] =
    ["base.linear.x", "base.linear.y", "base.linear.z", "base.angular.x", "base.angular.y", "base.angular.z"];

/// Construction and modification.
impl Model {
    /// Returns a robot without bodies. Its base is fixed at the world origin, under standard gravity.
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

    /// Returns a robot that consists of a floating root body with the inertia `root`.
    ///
    /// The first six entries of q̇ are the linear and angular velocity of the root (m/s, rad/s), in its own axes. The
    /// first seven entries of q are the position of the root in the base frame (m) and its rotation as a unit
    /// quaternion x, y, z, w. In the tree, the root is a chain of six coincident bodies; only the last one, body 5, has
    /// inertia.
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

    /// Adds a body that `joint` moves about or along the z axis of the body frame. `origin` is the pose of the body
    /// frame in the frame of `parent` (of the base, for `None`) at joint position zero; `inertia` is in the body frame.
    /// Returns the index of the body.
    ///
    /// # Panics
    /// If the parent does not exist, or if the joint is of kind [`Floating`](JointKind::Floating).
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

    /// Returns `parent`. On a floating base, the base and its first five bodies are replaced by its last body, 5.
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

    /// Adds a frame at `placement` in the frame of `body` (`None`: of the base, which may float). If several frames
    /// have the same name, [`Model::frame_id`] returns the first one.
    ///
    /// # Panics
    /// If the body does not exist.
    pub fn add_frame(&mut self, name: &str, body: Option<usize>, placement: Placement) -> FrameId {
        let body = self.on_root(body);
        self.frames.push(Frame { name: name.to_owned(), body, placement });
        self.payloads.push(Inertia::zero());
        FrameId(self.frames.len() - 1)
    }

    /// Adds a frame at a fixed offset from the frame `on`, for example the tip of a tool or a contact point.
    pub fn add_frame_on(&mut self, name: &str, on: FrameId, offset: Placement) -> FrameId {
        let &Frame { body, placement, .. } = &self.frames[on.0];
        self.add_frame(name, body, placement * offset)
    }

    /// Moves a frame to the body of the frame `on`, at the placement `offset` relative to `on`. Its payload moves with
    /// it.
    pub fn move_frame(&mut self, frame: FrameId, on: FrameId, offset: Placement) {
        let &Frame { body, placement, .. } = &self.frames[on.0];
        self.frames[frame.0].placement = placement * offset;
        let before = std::mem::replace(&mut self.frames[frame.0].body, body);
        self.update_body_inertia(before);
        self.update_body_inertia(body);
    }

    /// Sets the payload of a frame, in the axes of the frame: a tool or a load. Its mass must not be negative. It
    /// replaces the previous payload of the frame; a zero inertia removes it. A payload on a fixed base is ignored.
    pub fn set_payload(&mut self, frame: FrameId, payload: Inertia) {
        self.payloads[frame.0] = payload;
        self.update_body_inertia(self.frames[frame.0].body);
    }

    /// Replaces the inertia of a body and everything fixed to it except payloads. The inertia is given in the body
    /// frame, which is rotated relative to the link frame of the URDF: convert an inertia from link axes by
    /// `frame(link).placement.act_inertia(&inertia)`.
    ///
    /// # Panics
    /// If the body does not exist, or is one of the first five bodies of a floating base, which have no inertia.
    pub fn set_inertia(&mut self, body: usize, inertia: Inertia) {
        assert!(!self.floating || body >= 5, "body 5 is the floating base");
        self.own[body] = inertia;
        self.update_body_inertia(Some(body));
    }

    /// Computes the inertia of a body from its own inertia and the payloads of its frames. The sum is recomputed every
    /// time, so that a removed payload leaves no rounding error.
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
    /// If the joint does not exist.
    pub fn set_limits(&mut self, joint: usize, limits: Limits) {
        self.joints[joint].limits = limits;
    }

    /// Returns the robot with its base frame at pose `base` in the world. The q of a floating base is relative to this
    /// pose.
    #[must_use]
    pub fn with_base(mut self, base: Placement) -> Self {
        self.base = base;
        self
    }

    /// Returns the robot with the gravitational acceleration `gravity` (m/s², world axes).
    #[must_use]
    pub fn with_gravity(mut self, gravity: Vector3<f64>) -> Self {
        self.gravity = gravity;
        self
    }

    /// Returns the robot with reflected rotor inertias (n; kg m², or kg for prismatic joints).
    ///
    /// # Panics
    /// If the number of inertias is not n.
    #[must_use]
    pub fn with_rotor_inertia(mut self, inertia: &[f64]) -> Self {
        self.rotor_inertia.copy_from_slice(inertia);
        self
    }

    /// Sets the reflected rotor inertia of a joint (kg m², or kg for a prismatic joint).
    ///
    /// # Panics
    /// If there is no joint with this index.
    pub fn set_rotor_inertia(&mut self, joint: usize, inertia: f64) {
        self.rotor_inertia[joint] = inertia;
    }

    /// Returns the robot with every mass and rotational inertia multiplied by `factor`, including rotors and payloads.
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

    /// Returns the model with its numbers copied to every lane: see the module `batch`, with feature `simd`.
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
    /// Returns the name of the robot in the URDF.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the number of degrees of freedom, which is the length of q̇, q̈ and τ. In Pinocchio `nv`.
    #[must_use]
    pub fn n(&self) -> usize {
        self.joints.len()
    }

    /// Returns the length of q: n, or n + 1 with a floating base, whose rotation is a quaternion. In Pinocchio `nq`.
    #[must_use]
    pub fn nq(&self) -> usize {
        self.n() + usize::from(self.floating)
    }

    /// Returns true if the base is floating.
    #[must_use]
    pub fn is_floating(&self) -> bool {
        self.floating
    }

    /// Returns true if the model has mimic constraints.
    #[must_use]
    pub fn has_mimic_constraints(&self) -> bool {
        self.bodies.len() > self.joints.len()
    }

    /// Returns the joints, in the order of q̇.
    #[must_use]
    pub fn joints(&self) -> &[Joint] {
        &self.joints
    }

    /// Returns the units of the joint quantities, in the order of q̇.
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

    /// Returns the bodies, parents before children.
    #[must_use]
    pub fn bodies(&self) -> &[Body<T>] {
        &self.bodies
    }

    /// Returns the rotor inertias reflected to the joints (gear ratio squared times rotor inertia), kg m² or kg (n).
    #[must_use]
    pub fn rotor_inertia(&self) -> &[T] {
        &self.rotor_inertia
    }

    /// Returns the frames, in depth-first order of the URDF tree, followed by added frames.
    #[must_use]
    pub fn frames(&self) -> &[Frame<T>] {
        &self.frames
    }

    /// Returns the gravitational acceleration in world axes, m/s².
    #[must_use]
    pub fn gravity(&self) -> Vector3<T> {
        self.gravity
    }

    /// Returns the pose of the base frame in the world.
    #[must_use]
    pub fn base(&self) -> Placement<T> {
        self.base
    }

    /// Returns the total mass of all moving bodies, kg.
    #[must_use]
    pub fn total_mass(&self) -> T {
        self.bodies.iter().fold(T::zero(), |sum, body| sum + body.inertia.mass)
    }

    /// Returns the handle of the frame with this name.
    ///
    /// # Errors
    /// [`UnknownFrame`], which lists the frames of the model.
    pub fn frame_id(&self, name: &str) -> Result<FrameId, UnknownFrame> {
        self.frames.iter().position(|f| f.name == name).map(FrameId).ok_or_else(|| UnknownFrame {
            name: name.to_owned(),
            known: self.frames.iter().map(|f| f.name.clone()).collect(),
        })
    }

    /// Returns the index of the joint with this name.
    ///
    /// # Errors
    /// [`UnknownJoint`], which lists the joints of the model.
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

    /// Returns the index of the first body after those of a floating base.
    pub(crate) fn first_jointed_body(&self) -> usize {
        if self.floating { 6 } else { 0 }
    }

    /// Returns the body of a frame and all its ancestors, from the frame towards the base.
    pub fn ancestors(&self, frame: FrameId) -> impl Iterator<Item = usize> + '_ {
        self.ancestry(self.frames[frame.0].body)
    }

    /// Returns a body and all its ancestors, from the body towards the base.
    pub(crate) fn ancestry(&self, body: Option<usize>) -> impl Iterator<Item = usize> + '_ {
        std::iter::successors(body, |&b| self.bodies[b].parent)
    }
}

/// Returns a rotation that maps the z axis to `axis`; exact if `axis` is a coordinate axis.
#[must_use]
pub fn rotation_z_to(axis: &Unit<Vector3<f64>>) -> Matrix3<f64> {
    let z = axis.into_inner();
    if z == Vector3::z() {
        return Matrix3::identity();
    }
    // The coordinate axis with the smallest component along z gives the best-conditioned cross product.
    let x = Vector3::ith(z.iamin(), 1.0).cross(&z).normalize();
    Matrix3::from_columns(&[x, z.cross(&x), z])
}

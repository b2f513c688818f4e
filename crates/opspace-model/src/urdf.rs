//! Conversion of a URDF to a [`Model`]: reading, checking, and reduction to moving bodies. The input is URDF text or,
//! with feature `urdf-rs`, a robot of that crate; both are checked by the same code.
//!
//! Everything needed by the dynamics must be in the file and be physically possible. A moving body without mass, a
//! joint without limits or a tree with two roots is an error with the element and its line; no default replaces a
//! missing value. Shapes, materials and transmissions are ignored; `<dynamics>` is reported, but no part of the model;
//! [`link_shapes`] reads the shapes for collisions.
//!
//! ```
//! let urdf = r#"
//! <robot name="pendulum">
//!   <link name="base"/>
//!   <link name="rod">
//!     <inertial>
//!       <origin xyz="0 0 -0.5"/>
//!       <mass value="1"/>
//!       <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.001"/>
//!     </inertial>
//!   </link>
//!   <joint name="pivot" type="continuous">
//!     <parent link="base"/>
//!     <child link="rod"/>
//!     <axis xyz="0 1 0"/>
//!   </joint>
//! </robot>"#;
//! let loaded = opspace_model::Model::from_urdf(urdf)?;
//! assert_eq!(loaded.model.n(), 1);
//! assert!(loaded.model.frame_id("rod").is_ok());
//! # Ok::<(), opspace_model::UrdfError>(())
//! ```

mod check;
mod elements;
mod error;
#[cfg(feature = "urdf-rs")]
mod from_urdf_rs;
mod read;
mod shapes;
mod tree;

pub use error::{UrdfError, UrdfErrorKind, UrdfWarning, UrdfWarningKind};
pub use shapes::{Geometry, LinkShapes, Shape, link_shapes};

use crate::model::{BASE_JOINTS, Joint, JointKind, Limits, Model, rotation_z_to};
use crate::reduce::{MimicConstraint, ReduceError};
use crate::spatial::{Inertia, Placement};
use check::{Checked, CheckedJoint, Description, Motion};
use elements::RobotElement;

/// Model read from a URDF, with warnings about the file.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct ParsedUrdf {
    /// Model of the robot.
    pub model: Model,
    /// Mass of the links that cannot move, kg. They are not part of the model.
    pub standing_kg: f64,
    /// Inertia of each link in its own axes, in the order of the model's frames; zero for a link without one.
    pub link_inertias: Vec<Inertia>,
    /// Friction of the joints according to their `<dynamics>`, in the model's joint order. It is no part of the model.
    pub dynamics: Vec<JointDynamics>,
    /// Joints that move no mass; empty unless [`UrdfOptions::allow_massless`] is set.
    pub massless: Vec<MasslessJoint>,
    /// Warnings about accepted but suspicious values, in the order of the file.
    pub warnings: Vec<UrdfWarning>,
}

/// Friction of a joint according to the `<dynamics>` of its URDF; `None` where the URDF has none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct JointDynamics {
    /// Viscous friction, Nms/rad (Ns/m).
    pub damping: Option<f64>,
    /// Coulomb friction, Nm (N).
    pub friction: Option<f64>,
}

/// Joint of a URDF with its two links.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct UrdfJoint {
    /// Name of the joint.
    pub name: String,
    /// Type of the joint; `None` for a fixed joint.
    pub kind: Option<JointKind>,
    /// Limits of the joint; infinite for a fixed joint.
    pub limits: Limits,
    /// Name of the parent link.
    pub parent: String,
    /// Name of the child link.
    pub child: String,
    /// Name of the joint that this joint mimics, if any.
    pub mimics: Option<String>,
}

/// Options for reading a URDF.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UrdfOptions {
    /// True if the root link is a floating base: see [`Model::floating`].
    pub floating_base: bool,
    /// True if mimic joints move with their leaders; otherwise they have independent coordinates. See
    /// [`Model::with_mimic_constraints`].
    pub enforce_mimic: bool,
    /// True if joints may move no mass: the kinematics need none. [`ParsedUrdf::massless`] lists them.
    pub allow_massless: bool,
}

/// Changes of a URDF that is read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UrdfChanges {
    /// Joints that do not move, each with its position, rad (m). A locked joint needs no limits.
    pub locked_joints: Vec<(String, f64)>,
    /// Inertias of links, in the frame of each link, in place of those that the URDF states.
    pub inertias: Vec<(String, Inertia)>,
}

/// Joint that moves no mass.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct MasslessJoint {
    /// Name of the joint.
    pub joint: String,
    /// Name of its child link.
    pub link: String,
    /// Line of the joint, from 1; `None` if the robot was not read from text.
    pub line: Option<u32>,
}

impl Model {
    /// Returns the robot described by a URDF, with its root link fixed to the world.
    ///
    /// Revolute, continuous, prismatic and fixed joints are supported. Bodies are merged across fixed joints and
    /// numbered as described at [`Model`]; every link becomes a [`Frame`](crate::Frame). The inertia of links that
    /// cannot move is dropped. Mimic joints become independent joints, with a warning.
    ///
    /// # Errors
    /// [`UrdfError`], with the line of the invalid element: see [`UrdfErrorKind`].
    pub fn from_urdf(text: &str) -> Result<ParsedUrdf, UrdfError> {
        Self::from_urdf_with(text, UrdfOptions::default())
    }

    /// Variant of [`from_urdf`](Self::from_urdf) with options: a floating base, enforced mimic joints.
    ///
    /// # Errors
    /// As [`from_urdf`](Self::from_urdf).
    pub fn from_urdf_with(text: &str, options: UrdfOptions) -> Result<ParsedUrdf, UrdfError> {
        Self::from_urdf_changed(text, options, &UrdfChanges::default())
    }

    /// Variant of [`from_urdf_with`](Self::from_urdf_with) with changes of the URDF. Locked joints are fixed joints at their
    /// positions, and so are joints that mimic them if mimic joints are enforced.
    ///
    /// # Errors
    /// As [`from_urdf`](Self::from_urdf); a locked joint that the URDF does not have, or that is fixed; an inertia of a link that
    /// it does not have.
    pub fn from_urdf_changed(
        text: &str,
        options: UrdfOptions,
        changes: &UrdfChanges,
    ) -> Result<ParsedUrdf, UrdfError> {
        let mut robot = read::read(text)?;
        let declared = std::mem::take(&mut robot.warnings);
        let mut parsed = load(robot, options, changes)?;
        parsed.warnings.splice(0..0, declared);
        Ok(parsed)
    }

    /// Returns a robot read by urdf-rs or built in code from its types. The checks are those of
    /// [`from_urdf`](Self::from_urdf); errors and warnings have no line.
    ///
    /// urdf-rs does not distinguish zero from a missing number. Therefore a link with zero mass and zero moments has no
    /// inertia; a revolute or prismatic joint with only default limits is refused as a joint without limits; and a zero
    /// velocity or effort limit next to other limits is a limit of zero, with a warning. A rotation given as a
    /// quaternion has already been converted to roll, pitch and yaw.
    ///
    /// # Errors
    /// As [`from_urdf`](Self::from_urdf).
    #[cfg(feature = "urdf-rs")]
    pub fn from_urdf_rs(robot: &urdf_rs::Robot, options: UrdfOptions) -> Result<ParsedUrdf, UrdfError> {
        load(from_urdf_rs::elements(robot)?, options, &UrdfChanges::default())
    }
}

impl MasslessJoint {
    /// Error of a URDF in which the joint may not be massless.
    #[must_use]
    pub fn error(&self) -> UrdfError {
        let (joint, link) = (self.joint.clone(), self.link.clone());
        UrdfError::at(self.line, UrdfErrorKind::Massless { joint, link })
    }
}

/// Returns the joints of a URDF, in the order of the file. Its links form one tree. A joint without `<limit>` has no limits.
///
/// # Errors
/// As [`Model::from_urdf`], but for missing limits, and masses and inertias of moving links.
pub fn urdf_joints(text: &str) -> Result<Vec<UrdfJoint>, UrdfError> {
    let Checked { description, .. } = check::check(read::read(text)?, |_| false)?;
    tree::depth_first(&description)?;
    let joint = |joint: CheckedJoint| {
        let (kind, limits, mimics) = match joint.motion {
            Motion::Fixed => (None, Limits::NONE, None),
            Motion::Moving { kind, limits, mimic, .. } => (Some(kind), limits, mimic.map(|m| m.leader)),
        };
        UrdfJoint { name: joint.name, kind, limits, parent: joint.parent, child: joint.child, mimics }
    };
    Ok(description.joints.into_iter().map(joint).collect())
}

/// Checks the elements of a robot and builds its model.
fn load(
    robot: RobotElement,
    options: UrdfOptions,
    UrdfChanges { locked_joints: locked, inertias }: &UrdfChanges,
) -> Result<ParsedUrdf, UrdfError> {
    let moves = |name: &str| locked.iter().all(|(locked, _)| locked != name);
    let Checked { mut description, mut warnings } = check::check(robot, moves)?;
    lock(&mut description, options, locked)?;
    replace_inertias(&mut description, inertias, &mut warnings)?;
    let order = tree::depth_first(&description)?;
    let Assembled { mut model, standing_kg, massless } =
        assemble(&description, &order, options, &mut warnings)?;
    let is_moving = |name: &str| description.joints.iter().any(|j| j.name == name && j.motion.is_moving());
    warnings.retain(|w| !matches!(w.kind(), UrdfWarningKind::Mimic { joint, .. } if !is_moving(joint)));
    if options.enforce_mimic {
        model = fold(&model, &description)?;
        warnings.retain(|w| !matches!(w.kind(), UrdfWarningKind::Mimic { .. }));
    }
    warnings.sort_by_key(UrdfWarning::line);
    let dynamics_of = |joint: &Joint| {
        let element = description.joints.iter().find(|element| element.name == joint.name);
        match element.map(|element| &element.motion) {
            Some(Motion::Moving { dynamics, .. }) => {
                JointDynamics { damping: dynamics.damping, friction: dynamics.friction }
            }
            _ => JointDynamics::default(),
        }
    };
    let dynamics = model.joints().iter().map(dynamics_of).collect();
    let inertia_of = |step: &tree::Step| description.links[step.link].inertia.unwrap_or_else(Inertia::zero);
    let link_inertias = order.iter().map(inertia_of).collect();
    Ok(ParsedUrdf { model, standing_kg, link_inertias, dynamics, massless, warnings })
}

/// Fixes the locked joints at their positions and, if mimic joints are enforced, those that mimic them.
fn lock(
    description: &mut Description,
    options: UrdfOptions,
    locked: &[(String, f64)],
) -> Result<(), UrdfError> {
    let mut positions: Vec<(String, f64)> = Vec::new();
    for (name, position) in locked {
        if !description.joints.iter().any(|j| j.name == *name && j.motion.is_moving()) {
            let moving = description.joints.iter().filter(|j| j.motion.is_moving());
            let known = moving.map(|j| j.name.clone()).collect();
            let kind = UrdfErrorKind::UnknownLocked { joint: name.clone(), known };
            return Err(UrdfError::whole_file(kind));
        }
        positions.push((name.clone(), *position));
    }
    let mut next = 0;
    while let Some((leader, position)) = positions.get(next).cloned() {
        next += 1;
        for joint in &mut description.joints {
            let follower = match &joint.motion {
                Motion::Moving { mimic: Some(mimic), .. }
                    if options.enforce_mimic && mimic.leader == leader && joint.name != leader =>
                {
                    Some(mimic.ratio * position + mimic.offset)
                }
                _ => None,
            };
            if let Some(position) = follower.filter(|_| positions.iter().all(|(name, _)| *name != joint.name))
            {
                positions.push((joint.name.clone(), position));
            }
            if let (true, Motion::Moving { kind, axis, .. }) = (joint.name == leader, &joint.motion) {
                let turned = Placement { rotation: rotation_z_to(axis), ..Placement::identity() };
                joint.origin =
                    kind.placement(&(joint.origin * turned), position, position.sin_cos()) * turned.inverse();
                joint.motion = Motion::Fixed;
            }
        }
    }
    Ok(())
}

/// Replaces the inertias of links.
fn replace_inertias(
    description: &mut Description,
    inertias: &[(String, Inertia)],
    warnings: &mut Vec<UrdfWarning>,
) -> Result<(), UrdfError> {
    for (name, inertia) in inertias {
        let Some(link) = description.links.iter_mut().find(|link| link.name == *name) else {
            let known = description.links.iter().map(|link| link.name.clone()).collect();
            return Err(UrdfError::whole_file(UrdfErrorKind::UnknownInertia { link: name.clone(), known }));
        };
        (link.inertia, link.indefinite) = (Some(*inertia), None);
        let is_replaced = |warning: &UrdfWarning| match warning.kind() {
            UrdfWarningKind::ImpossibleInertia { link, .. } => link == name,
            _ => false,
        };
        warnings.retain(|warning| !is_replaced(warning));
    }
    Ok(())
}

/// Placement of a link: its body, and its pose in the frame of that body.
#[derive(Clone, Copy)]
struct Place {
    body: Option<usize>,
    placement: Placement,
}

/// Model made of the links and joints of a URDF.
struct Assembled {
    model: Model,
    /// Mass of the links that cannot move, kg.
    standing_kg: f64,
    massless: Vec<MasslessJoint>,
}

fn assemble(
    description: &Description,
    order: &[tree::Step],
    options: UrdfOptions,
    warnings: &mut Vec<UrdfWarning>,
) -> Result<Assembled, UrdfError> {
    let floating = options.floating_base;
    let mut standing_kg = 0.0;
    let name = &description.name;
    let mut model = if floating { Model::floating(name, Inertia::zero()) } else { Model::new(name) };
    let root = Place { body: floating.then_some(5), placement: Placement::identity() };
    let mut places = vec![root; description.links.len()];
    let mut inertias = vec![Inertia::zero(); model.bodies().len()];
    // Joint that moves each body, for errors.
    let mut movers: Vec<&CheckedJoint> = Vec::new();
    for step in order {
        if let Some((joint, parent_link)) = step.from {
            let element = &description.joints[joint];
            let parent = places[parent_link];
            let at_zero = parent.placement * element.origin;
            places[step.link] = match &element.motion {
                Motion::Fixed => Place { body: parent.body, placement: at_zero },
                Motion::Moving { .. } if floating && BASE_JOINTS.contains(&element.name.as_str()) => {
                    let kind = UrdfErrorKind::ReservedName { joint: element.name.clone() };
                    return Err(UrdfError::at(element.line, kind));
                }
                Motion::Moving { kind, axis, limits, .. } => {
                    let turned = Placement { rotation: rotation_z_to(axis), ..Placement::identity() };
                    let joint = Joint { name: element.name.clone(), kind: *kind, limits: *limits };
                    movers.push(element);
                    inertias.push(Inertia::zero());
                    let body = model.add_body(parent.body, at_zero * turned, joint, Inertia::zero());
                    Place { body: Some(body), placement: turned.inverse() }
                }
            };
        }
        let (link, place) = (&description.links[step.link], places[step.link]);
        match (link.indefinite, place.body) {
            (Some((smallest, line)), Some(_)) => {
                let element = format!("link '{}'", link.name);
                return Err(UrdfError::at(line, UrdfErrorKind::NegativeInertia { element, smallest }));
            }
            (Some((smallest, line)), None) => {
                let kind = UrdfWarningKind::StandingInertia { link: link.name.clone(), smallest };
                warnings.push(UrdfWarning::at(line, kind));
            }
            (None, _) => {}
        }
        match (place.body, link.inertia) {
            (Some(body), Some(inertia)) => {
                inertias[body] = inertias[body] + place.placement.act_inertia(&inertia);
            }
            (None, Some(inertia)) => standing_kg += inertia.mass,
            (_, None) => {}
        }
        model.add_frame(&link.name, place.body, place.placement);
    }
    let jointed = model.first_jointed_body();
    let mut massless = Vec::new();
    for (inertia, element) in inertias.iter().skip(jointed).zip(movers) {
        if inertia.mass <= 0.0 {
            let (joint, link, line) = (element.name.clone(), element.child.clone(), element.line);
            massless.push(MasslessJoint { joint, link, line });
        }
    }
    if let Some(first) = massless.first().filter(|_| !options.allow_massless) {
        return Err(first.error());
    }
    for (body, inertia) in inertias.into_iter().enumerate().skip(root.body.unwrap_or(0)) {
        model.set_inertia(body, inertia);
    }
    // Each link has one frame; the root is the first.
    if let (true, Some(step)) = (floating, order.first()) {
        let link = &description.links[step.link];
        if model.total_mass() <= 0.0 {
            let kind = UrdfErrorKind::WeightlessBase { link: link.name.clone() };
            return Err(UrdfError::at(link.line, kind));
        }
    }
    Ok(Assembled { model, standing_kg, massless })
}

/// Couples every mimic joint to its leader.
fn fold(model: &Model, description: &Description) -> Result<Model, UrdfError> {
    let mut followers = Vec::new();
    let mut line = None;
    for element in &description.joints {
        let Motion::Moving { mimic: Some(mimic), .. } = &element.motion else {
            continue;
        };
        let jointed = |joint: &&Joint| joint.kind != JointKind::Floating;
        let leader =
            model.joint(&mimic.leader).ok().filter(|&j| jointed(&&model.joints()[j])).ok_or_else(|| {
                let kind = UrdfErrorKind::UnknownLeader {
                    joint: element.name.clone(),
                    leader: mimic.leader.clone(),
                    known: model.joints().iter().filter(jointed).map(|j| j.name.clone()).collect(),
                };
                UrdfError::at(mimic.line, kind)
            })?;
        let Ok(joint) = model.joint(&element.name) else { continue };
        line = mimic.line;
        followers.push((joint, MimicConstraint { leader, ratio: mimic.ratio, offset: mimic.offset }));
    }
    model.with_mimic_constraints(&followers).map_err(|error| match error {
        ReduceError::FollowsItself { joint } => {
            let line = description.joints.iter().find(|j| j.name == joint).map_or(line, |j| j.line);
            UrdfError::at(line, UrdfErrorKind::MimicsItself { joint })
        }
        other => UrdfError::at(line, UrdfErrorKind::Malformed { reason: other.to_string() }),
    })
}

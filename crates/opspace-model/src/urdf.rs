//! Conversion of a URDF to a [`Model`]: read, checked, and reduced to moving bodies. Text is read, and with feature
//! `urdf-rs` also a robot of that crate; both are checked by the same code.
//!
//! Everything that the dynamics need must be in the file and be physically possible: a moving body without mass,
//! a joint without limits or a tree with two roots is an error that names the element and its line, not a
//! default. Shapes, materials, transmissions and `<dynamics>` are ignored.
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
mod tree;

pub use error::{UrdfError, UrdfErrorKind, UrdfWarning, UrdfWarningKind};

use crate::model::{BASE_JOINTS, Joint, JointKind, Model, rotation_z_to};
use crate::reduce::{MimicConstraint, ReduceError};
use crate::spatial::{Inertia, Placement};
use check::{Checked, CheckedJoint, Description, Motion};
use elements::RobotElement;

/// Model read from a URDF, and the warnings about its file.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct ParsedUrdf {
    /// Model of the robot.
    pub model: Model,
    /// Mass of the links that can't move, which are not part of the model, kg.
    pub standing_kg: f64,
    /// Warnings about values that were accepted but look wrong, in the order of the file.
    pub warnings: Vec<UrdfWarning>,
}

/// Options of reading a URDF.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UrdfOptions {
    /// Root link free to move in space: see [`Model::floating`].
    pub floating_base: bool,
    /// Mimic joints move with their leader instead of having coordinates of their own: see
    /// [`Model::with_mimic_constraints`].
    pub enforce_mimic: bool,
}

impl Model {
    /// Returns the robot that a URDF describes, its root link fixed to the world.
    ///
    /// Revolute, continuous, prismatic and fixed joints are read. Bodies are merged across fixed joints and numbered as
    /// [`Model`] says; every link becomes a [`Frame`](crate::Frame). The inertia of links that can't move is dropped. A
    /// mimic joint is a joint of its own, with a warning.
    ///
    /// # Errors
    /// [`UrdfError`], with the line of the element at fault: see [`UrdfErrorKind`].
    pub fn from_urdf(text: &str) -> Result<ParsedUrdf, UrdfError> {
        Self::from_urdf_with(text, UrdfOptions::default())
    }

    /// Variant of [`from_urdf`](Self::from_urdf) with a floating base, or mimic joints folded.
    ///
    /// # Errors
    /// As [`from_urdf`](Self::from_urdf).
    pub fn from_urdf_with(text: &str, options: UrdfOptions) -> Result<ParsedUrdf, UrdfError> {
        load(read::read(text)?, options)
    }

    /// Returns the robot that urdf-rs has read, or that a program has put together. The checks are those of
    /// [`from_urdf`](Self::from_urdf); errors and warnings have no line.
    ///
    /// urdf-rs tells no zero from a number that is left out: a link whose mass and moments are all zero has no inertia,
    /// a revolute or prismatic joint whose limits all have their defaults is refused as one without limits, and a limit
    /// of speed or effort that is zero beside others is a limit of zero, with a warning. A rotation given as a quaternion
    /// has become roll, pitch and yaw.
    ///
    /// # Errors
    /// As [`from_urdf`](Self::from_urdf).
    #[cfg(feature = "urdf-rs")]
    pub fn from_urdf_rs(robot: &urdf_rs::Robot, options: UrdfOptions) -> Result<ParsedUrdf, UrdfError> {
        load(from_urdf_rs::elements(robot)?, options)
    }
}

/// Checks a robot's elements and makes its model.
fn load(robot: RobotElement, options: UrdfOptions) -> Result<ParsedUrdf, UrdfError> {
    let Checked { description, mut warnings } = check::check(robot)?;
    let order = tree::depth_first(&description)?;
    let (mut model, standing_kg) = assemble(&description, &order, options.floating_base)?;
    if options.enforce_mimic {
        model = fold(&model, &description)?;
        warnings.retain(|w| !matches!(w.kind(), UrdfWarningKind::Mimic { .. }));
    }
    warnings.sort_by_key(UrdfWarning::line);
    Ok(ParsedUrdf { model, standing_kg, warnings })
}

/// Placement of a link: its body, and its pose in that body's frame.
#[derive(Clone, Copy)]
struct Place {
    body: Option<usize>,
    placement: Placement,
}

/// Returns the model, and the mass of the links that can't move.
fn assemble(
    description: &Description,
    order: &[tree::Step],
    floating: bool,
) -> Result<(Model, f64), UrdfError> {
    let mut standing_kg = 0.0;
    let name = &description.name;
    let mut model = if floating { Model::floating(name, Inertia::zero()) } else { Model::new(name) };
    let root = Place { body: floating.then_some(5), placement: Placement::identity() };
    let mut places = vec![root; description.links.len()];
    let mut inertias = vec![Inertia::zero(); model.bodies().len()];
    // The joint that moves each body, and the line of each frame's link, for errors.
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
        match (place.body, link.inertia) {
            (Some(body), Some(inertia)) => {
                inertias[body] = inertias[body] + place.placement.act_inertia(&inertia);
            }
            (None, Some(inertia)) => standing_kg += inertia.mass,
            (_, None) => {}
        }
        if !is_finite(&place.placement) {
            let kind = UrdfErrorKind::Overflow { element: format!("link '{}'", link.name) };
            return Err(UrdfError::at(link.line, kind));
        }
        model.add_frame(&link.name, place.body, place.placement);
    }
    let jointed = model.first_jointed_body();
    for ((body, inertia), element) in inertias.iter().enumerate().skip(jointed).zip(movers) {
        if inertia.mass <= 0.0 {
            let kind = UrdfErrorKind::Massless { joint: element.name.clone(), link: element.child.clone() };
            return Err(UrdfError::at(element.line, kind));
        }
        if !is_finite_inertia(inertia) || !is_finite(&model.bodies()[body].origin) {
            let kind = UrdfErrorKind::Overflow { element: format!("joint '{}'", element.name) };
            return Err(UrdfError::at(element.line, kind));
        }
    }
    for (body, inertia) in inertias.into_iter().enumerate().skip(root.body.unwrap_or(0)) {
        model.set_inertia(body, inertia);
    }
    // One frame a link, the root first.
    if let (true, Some(step)) = (floating, order.first()) {
        let link = &description.links[step.link];
        if model.total_mass() <= 0.0 {
            let kind = UrdfErrorKind::WeightlessBase { link: link.name.clone() };
            return Err(UrdfError::at(link.line, kind));
        }
        if !is_finite_inertia(&model.bodies()[5].inertia) {
            let kind = UrdfErrorKind::Overflow { element: format!("link '{}'", link.name) };
            return Err(UrdfError::at(link.line, kind));
        }
    }
    Ok((model, standing_kg))
}

/// True if all entries are finite: finite numbers can still be too large for their products.
fn is_finite(placement: &Placement) -> bool {
    placement.rotation.iter().chain(&placement.translation).all(|x| x.is_finite())
}

fn is_finite_inertia(Inertia { mass, com, rotational }: &Inertia) -> bool {
    mass.is_finite() && com.iter().chain(rotational).all(|x| x.is_finite())
}

/// Folds every mimic joint into its leader.
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

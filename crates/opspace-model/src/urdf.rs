//! URDF text to [`Model`]: read, checked, and reduced to moving bodies.
//!
//! What the dynamics need must be in the file and be possible: a moving body without mass, a joint
//! without limits or a tree with two roots is an error that names the element and its line, not a
//! default. Shapes, materials, transmissions and `<dynamics>` are not looked at.

mod error;
mod read;
mod tree;

pub use error::{UrdfError, UrdfErrorKind, UrdfWarning, UrdfWarningKind};

use crate::model::{Frame, Joint, JointKind, Limits, Model, z_onto};
use crate::spatial::{Inertia, Placement};
use read::{Description, JointElement, Motion};

/// A model, and what in its file deserves a second look.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// The robot.
    pub model: Model,
    /// What was accepted but looks wrong, in the order of the file.
    pub warnings: Vec<UrdfWarning>,
}

impl Model {
    /// The robot that a URDF describes, its root link fixed to the world.
    ///
    /// Revolute, continuous, prismatic and fixed joints are read. Bodies are merged across fixed joints and
    /// numbered as [`Model`] says; every link becomes a [`Frame`]. The inertia of links that can't move is
    /// dropped. A mimic joint is a joint of its own, with a warning.
    ///
    /// ```
    /// let urdf = r#"
    /// <robot name="pendulum">
    ///   <link name="base"/>
    ///   <link name="rod">
    ///     <inertial>
    ///       <origin xyz="0 0 -0.5"/>
    ///       <mass value="1"/>
    ///       <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.001"/>
    ///     </inertial>
    ///   </link>
    ///   <joint name="pivot" type="continuous">
    ///     <parent link="base"/>
    ///     <child link="rod"/>
    ///     <axis xyz="0 1 0"/>
    ///   </joint>
    /// </robot>"#;
    /// let loaded = opspace_model::Model::from_urdf(urdf)?;
    /// assert_eq!(loaded.model.n(), 1);
    /// assert!(loaded.model.frame("rod").is_ok());
    /// # Ok::<(), opspace_model::UrdfError>(())
    /// ```
    ///
    /// # Errors
    /// [`UrdfError`], with the line of the element at fault: see [`UrdfErrorKind`].
    pub fn from_urdf(text: &str) -> Result<Loaded, UrdfError> {
        let read::Reading { description, mut warnings } = read::read(text)?;
        let order = tree::depth_first(&description)?;
        let model = assemble(&description, &order)?;
        warnings.sort_by_key(UrdfWarning::line);
        Ok(Loaded { model, warnings })
    }
}

/// Where a link is: the joint whose body it belongs to, and its pose in that body's frame.
#[derive(Clone, Copy)]
struct Place {
    body: Option<usize>,
    placement: Placement,
}

fn assemble(description: &Description, order: &[tree::Step]) -> Result<Model, UrdfError> {
    let mut joints: Vec<Joint> = Vec::new();
    let mut movers: Vec<&JointElement> = Vec::new();
    let mut frames = Vec::with_capacity(description.links.len());
    let mut places = vec![Place { body: None, placement: Placement::identity() }; description.links.len()];
    for step in order {
        if let Some((joint, parent_link)) = step.from {
            let element = &description.joints[joint];
            let parent = places[parent_link];
            let at_zero = parent.placement * element.origin;
            places[step.link] = match &element.motion {
                Motion::Fixed => Place { body: parent.body, placement: at_zero },
                Motion::Moving { kind, axis, limits } => {
                    let turned = Placement { rotation: z_onto(axis), ..Placement::identity() };
                    movers.push(element);
                    joints.push(moving(element, *kind, *limits, parent.body, at_zero * turned));
                    Place { body: Some(joints.len() - 1), placement: turned.inverse() }
                }
            };
        }
        let (link, place) = (&description.links[step.link], places[step.link]);
        if let (Some(body), Some(inertia)) = (place.body, link.inertia) {
            joints[body].inertia = joints[body].inertia + place.placement.act_inertia(&inertia);
        }
        frames.push(Frame { name: link.name.clone(), joint: place.body, placement: place.placement });
    }
    for (joint, element) in joints.iter().zip(movers) {
        if joint.inertia.mass <= 0.0 {
            let kind = UrdfErrorKind::Massless { joint: joint.name.clone(), link: element.child.clone() };
            return Err(UrdfError::at(element.line, kind));
        }
        let Inertia { mass, com, rotational } = &joint.inertia;
        let finite = mass.is_finite() && com.iter().chain(rotational).all(|x| x.is_finite());
        if !finite || !is_finite(&joint.origin) {
            let kind = UrdfErrorKind::Overflow { element: format!("joint '{}'", joint.name) };
            return Err(UrdfError::at(element.line, kind));
        }
    }
    // One frame a link, in the same order.
    for (frame, step) in frames.iter().zip(order) {
        if !is_finite(&frame.placement) {
            let kind = UrdfErrorKind::Overflow { element: format!("link '{}'", frame.name) };
            return Err(UrdfError::at(description.links[step.link].line, kind));
        }
    }
    Ok(Model::new(description.name.clone(), joints, frames))
}

/// Finite numbers can still be too large for their products.
fn is_finite(placement: &Placement) -> bool {
    placement.rotation.iter().chain(&placement.translation).all(|x| x.is_finite())
}

fn moving(
    element: &JointElement,
    kind: JointKind,
    limits: Limits,
    parent: Option<usize>,
    origin: Placement,
) -> Joint {
    Joint {
        name: element.name.clone(),
        kind,
        parent,
        origin,
        inertia: Inertia::zero(),
        limits,
        rotor_inertia: 0.0,
    }
}

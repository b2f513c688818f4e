//! Conversion of a robot read by urdf-rs, or built in code from its types, to URDF elements.
//!
//! urdf-rs replaces missing values by defaults. A link with zero mass and zero moments therefore has no `<inertial>`, a
//! joint with only default limits has no `<limit>`, and an infinite velocity or effort limit is no limit.

use super::check::joint_kind;
use super::elements::{
    AxisElement, DynamicsElement, InertialElement, JointElement, LimitElement, LinkElement, MimicElement,
    OriginElement, RobotElement,
};
use super::error::UrdfError;
use urdf_rs::{Inertial, Joint, JointLimit, JointType, Link, Pose, Robot};

pub(super) fn elements(robot: &Robot) -> Result<RobotElement, UrdfError> {
    let links = robot.links.iter().map(link).collect();
    let joints = robot.joints.iter().map(joint).collect::<Result<_, _>>()?;
    Ok(RobotElement { line: None, name: robot.name.clone(), links, joints, warnings: Vec::new() })
}

fn link(link: &Link) -> LinkElement {
    LinkElement { line: None, name: trimmed(&link.name), inertial: inertial(&link.inertial) }
}

fn inertial(given: &Inertial) -> Option<InertialElement> {
    let inertia = &given.inertia;
    let moments = [inertia.ixx, inertia.ixy, inertia.ixz, inertia.iyy, inertia.iyz, inertia.izz];
    if given.mass.value == 0.0 && moments == [0.0; 6] {
        return None;
    }
    let (origin, mass_kg) = (origin(&given.origin), given.mass.value);
    Some(InertialElement { origin, mass_line: None, mass_kg, inertia_line: None, moments })
}

fn joint(joint: &Joint) -> Result<JointElement, UrdfError> {
    let name = trimmed(&joint.name);
    Ok(JointElement {
        line: None,
        kind: joint_kind(&format!("joint '{name}'"), None, word(&joint.joint_type))?,
        parent: trimmed(&joint.parent.link),
        child: trimmed(&joint.child.link),
        origin: origin(&joint.origin),
        axis: Some(AxisElement { line: None, xyz: joint.axis.xyz.0 }),
        limit: limit(&joint.limit),
        dynamics: joint.dynamics.as_ref().map_or_else(DynamicsElement::default, |dynamics| DynamicsElement {
            line: None,
            damping: Some(dynamics.damping),
            friction: Some(dynamics.friction),
        }),
        mimic: joint.mimic.as_ref().map(|mimic| MimicElement {
            line: None,
            leader: trimmed(&mimic.joint),
            ratio: mimic.multiplier.unwrap_or(1.0),
            offset: mimic.offset.unwrap_or(0.0),
        }),
        name,
    })
}

fn limit(limit: &JointLimit) -> Option<LimitElement> {
    let bound = |value: f64| (value != f64::INFINITY).then_some(value);
    (*limit != JointLimit::default()).then(|| LimitElement {
        line: None,
        position: [limit.lower, limit.upper],
        velocity: bound(limit.velocity),
        effort: bound(limit.effort),
    })
}

fn origin(pose: &Pose) -> OriginElement {
    OriginElement { line: None, xyz_m: pose.xyz.0, rpy_rad: pose.rpy.0 }
}

fn word(kind: &JointType) -> &'static str {
    match kind {
        JointType::Revolute => "revolute",
        JointType::Continuous => "continuous",
        JointType::Prismatic => "prismatic",
        JointType::Fixed => "fixed",
        JointType::Floating => "floating",
        JointType::Planar => "planar",
        JointType::Spherical => "spherical",
    }
}

/// Returns the name without surrounding spaces, like the reader of URDF text.
fn trimmed(name: &str) -> String {
    name.trim().to_owned()
}

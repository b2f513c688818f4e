//! URDF elements that concern the dynamics, before any check. All readers produce this form, and `check` accepts or
//! refuses it.

use super::error::UrdfWarning;
use crate::model::JointKind;

/// Line of an element, from 1; `None` if the robot was not read from text.
pub(super) type Line = Option<u32>;

pub(super) struct RobotElement {
    pub line: Line,
    pub name: String,
    pub links: Vec<LinkElement>,
    pub joints: Vec<JointElement>,
    /// Warnings of the reader.
    pub warnings: Vec<UrdfWarning>,
}

pub(super) struct LinkElement {
    pub line: Line,
    pub name: String,
    pub inertial: Option<InertialElement>,
}

pub(super) struct InertialElement {
    pub origin: OriginElement,
    pub mass_line: Line,
    pub mass_kg: f64,
    pub inertia_line: Line,
    /// ixx, ixy, ixz, iyy, iyz, izz, kg m².
    pub moments: [f64; 6],
}

/// Pose of a joint or an inertia; zeros if there is none.
#[derive(Default)]
pub(super) struct OriginElement {
    pub line: Line,
    pub xyz_m: [f64; 3],
    pub rpy_rad: [f64; 3],
}

pub(super) struct JointElement {
    pub line: Line,
    pub name: String,
    /// `None` for a fixed joint.
    pub kind: Option<JointKind>,
    pub parent: String,
    pub child: String,
    pub origin: OriginElement,
    pub axis: Option<AxisElement>,
    pub limit: Option<LimitElement>,
    pub dynamics: DynamicsElement,
    pub mimic: Option<MimicElement>,
}

/// Friction of a joint; `None` where the file has none.
#[derive(Clone, Copy, Default)]
pub(super) struct DynamicsElement {
    pub line: Line,
    /// Viscous friction, Nms/rad or Ns/m.
    pub damping: Option<f64>,
    /// Coulomb friction, Nm or N.
    pub friction: Option<f64>,
}

pub(super) struct AxisElement {
    pub line: Line,
    pub xyz: [f64; 3],
}

pub(super) struct LimitElement {
    pub line: Line,
    /// Lower and upper position limit, rad or m; ignored for continuous joints.
    pub position: [f64; 2],
    /// Velocity limit, rad/s or m/s; `None` for no limit.
    pub velocity: Option<f64>,
    /// Effort limit, Nm or N; `None` for no limit.
    pub effort: Option<f64>,
}

/// Coupling of a joint to its leader.
pub(super) struct MimicElement {
    pub line: Line,
    pub leader: String,
    pub ratio: f64,
    pub offset: f64,
}

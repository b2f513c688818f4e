//! Checks of the individual elements of a robot, and their conversion to inertias, placements and limits.

use super::elements::{
    AxisElement, DynamicsElement, InertialElement, JointElement, LimitElement, Line, LinkElement,
    MimicElement, OriginElement, RobotElement,
};
use super::error::{UrdfError, UrdfErrorKind, UrdfWarning, UrdfWarningKind};
use crate::model::{JointKind, Limits};
use crate::spatial::{Inertia, Placement, principal_moments};
use nalgebra::{Matrix3, Unit, Vector3};
use std::collections::HashMap;

/// Tolerance of principal moments relative to the largest; files contain at least five digits.
const INERTIA_TOLERANCE: f64 = 1e-6;
/// Magnitude of principal moments that are rounding errors of zero, kg m²: those of a grain of 1 µg and 0.1 mm.
const ROUNDING_KG_M2: f64 = 1e-17;
/// Remedy in errors about a joint's limits.
pub(super) const LIMIT: &str = "write <limit lower=\"...\" upper=\"...\" velocity=\"...\" effort=\"...\"/>";
/// Attributes of `<inertia>`, in the order of [`InertialElement::moments`].
pub(super) const MOMENTS: [&str; 6] = ["ixx", "ixy", "ixz", "iyy", "iyz", "izz"];

/// Checked contents of a URDF that concern the robot's dynamics.
pub(super) struct Description {
    pub name: String,
    pub links: Vec<CheckedLink>,
    pub joints: Vec<CheckedJoint>,
}

/// Description with the warnings about it.
pub(super) struct Checked {
    pub description: Description,
    pub warnings: Vec<UrdfWarning>,
}

pub(super) struct CheckedLink {
    pub name: String,
    pub line: Line,
    /// Inertia in the frame of the link; `None` if the link has none.
    pub inertia: Option<Inertia>,
    /// Smallest principal moment (kg m²) and line of an inertia that is not positive semi-definite.
    pub indefinite: Option<(f64, Line)>,
}

pub(super) struct CheckedJoint {
    pub name: String,
    pub line: Line,
    pub parent: String,
    pub child: String,
    pub origin: Placement,
    pub motion: Motion,
}

pub(super) enum Motion {
    Fixed,
    Moving {
        kind: JointKind,
        axis: Unit<Vector3<f64>>,
        limits: Limits,
        dynamics: DynamicsElement,
        mimic: Option<MimicElement>,
    },
}

impl Motion {
    /// True unless the joint is fixed.
    pub fn is_moving(&self) -> bool {
        matches!(self, Self::Moving { .. })
    }
}

/// Checks every element of a robot and returns the contents. The connections between elements are checked by `tree`.
/// `moves` is true for a joint that moves: only these need limits.
pub(super) fn check(robot: RobotElement, moves: impl Fn(&str) -> bool) -> Result<Checked, UrdfError> {
    check_names("link", robot.links.iter().map(|link| (link.name.as_str(), link.line)))?;
    check_names("joint", robot.joints.iter().map(|joint| (joint.name.as_str(), joint.line)))?;
    if robot.links.is_empty() {
        return Err(UrdfError::at(robot.line, UrdfErrorKind::NoLinks));
    }
    let mut warnings = Vec::new();
    let links =
        robot.links.into_iter().map(|link| checked_link(link, &mut warnings)).collect::<Result<_, _>>()?;
    let joints = robot
        .joints
        .into_iter()
        .map(|joint| checked_joint(joint, &moves, &mut warnings))
        .collect::<Result<_, _>>()?;
    Ok(Checked { description: Description { name: robot.name, links, joints }, warnings })
}

/// Returns the joint kind for the URDF type `word`; `None` for a fixed joint. `element` names the joint in errors.
pub(super) fn joint_kind(element: &str, line: Line, word: &str) -> Result<Option<JointKind>, UrdfError> {
    match word {
        "revolute" => Ok(Some(JointKind::Revolute)),
        "continuous" => Ok(Some(JointKind::Continuous)),
        "prismatic" => Ok(Some(JointKind::Prismatic)),
        "fixed" => Ok(None),
        found => {
            let (element, found) = (element.to_owned(), found.to_owned());
            Err(UrdfError::at(line, UrdfErrorKind::JointType { element, found }))
        }
    }
}

/// Checks the `<origin>` of a shape. `words` name its link in errors.
pub(super) fn checked_origin(words: &str, origin: &OriginElement) -> Result<Placement, UrdfError> {
    Element { name: "", words: words.to_owned() }.origin(origin)
}

/// Checks that all elements with this tag have unique names.
fn check_names<'a>(
    tag: &'static str,
    elements: impl Iterator<Item = (&'a str, Line)>,
) -> Result<(), UrdfError> {
    let mut first_lines = HashMap::new();
    for (name, line) in elements {
        if name.is_empty() {
            return Err(UrdfError::at(line, UrdfErrorKind::Nameless { element: tag }));
        }
        if let Some(first_line) = first_lines.insert(name, line) {
            let kind = UrdfErrorKind::DuplicateName { element: format!("{tag} '{name}'"), first_line };
            return Err(UrdfError::at(line, kind));
        }
    }
    Ok(())
}

fn checked_link(link: LinkElement, warnings: &mut Vec<UrdfWarning>) -> Result<CheckedLink, UrdfError> {
    let element = Element { name: &link.name, words: format!("link '{}'", link.name) };
    let inertia = link.inertial.as_ref().map(|inertial| element.inertia(inertial, warnings)).transpose()?;
    let indefinite = link.inertial.as_ref().and_then(indefinite);
    Ok(CheckedLink { line: link.line, inertia, indefinite, name: link.name })
}

fn checked_joint(
    joint: JointElement,
    moves: impl Fn(&str) -> bool,
    warnings: &mut Vec<UrdfWarning>,
) -> Result<CheckedJoint, UrdfError> {
    let element = Element { name: &joint.name, words: format!("joint '{}'", joint.name) };
    let motion = match joint.kind {
        None => Motion::Fixed,
        Some(kind) => Motion::Moving {
            kind,
            axis: element.axis(joint.axis.as_ref())?,
            limits: match &joint.limit {
                None if !moves(&joint.name) => Limits::NONE,
                limit => element.limits(kind, joint.line, limit.as_ref(), warnings)?,
            },
            dynamics: element.dynamics(joint.dynamics)?,
            mimic: element.mimic(joint.mimic, warnings)?,
        },
    };
    let origin = element.origin(&joint.origin)?;
    Ok(CheckedJoint {
        line: joint.line,
        parent: joint.parent,
        child: joint.child,
        origin,
        motion,
        name: joint.name,
    })
}

fn rotational(moments: &[f64; 6]) -> Matrix3<f64> {
    let [xx, xy, xz, yy, yz, zz] = *moments;
    Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
}

fn moment_tolerance(moments: &[f64; 3]) -> f64 {
    (INERTIA_TOLERANCE * moments[2].max(-moments[0])).max(ROUNDING_KG_M2)
}

/// Returns the smallest principal moment (kg m²) and the line of an inertia that is not positive semi-definite.
fn indefinite(inertial: &InertialElement) -> Option<(f64, Line)> {
    let moments = principal_moments(&rotational(&inertial.moments));
    (moments[0] < -moment_tolerance(&moments)).then_some((moments[0], inertial.inertia_line))
}

/// Link or joint that is being checked.
struct Element<'a> {
    name: &'a str,
    /// Description of the element in errors: `joint 'elbow'`.
    words: String,
}

impl Element<'_> {
    fn inertia(
        &self,
        inertial: &InertialElement,
        warnings: &mut Vec<UrdfWarning>,
    ) -> Result<Inertia, UrdfError> {
        let origin = self.origin(&inertial.origin)?;
        let (mass, line) = (inertial.mass_kg, inertial.mass_line);
        self.bounded("<mass value>", line, &[mass])?;
        if mass < 0.0 {
            let kind = UrdfErrorKind::NegativeMass { element: self.words.clone(), mass };
            return Err(UrdfError::at(line, kind));
        }
        if mass > 0.0 && mass < SMALLEST_MASS_KG {
            return Err(self.bad_number("<mass value>", line, &[mass], MASS));
        }
        let line = inertial.inertia_line;
        for (attribute, moment) in MOMENTS.iter().zip(inertial.moments) {
            self.bounded(&format!("<inertia {attribute}>"), line, &[moment])?;
        }
        let rotational = rotational(&inertial.moments);
        let moments = principal_moments(&rotational);
        let tolerance = moment_tolerance(&moments);
        if moments[0] >= -tolerance && moments[0] + moments[1] < moments[2] - tolerance {
            let kind = UrdfWarningKind::ImpossibleInertia { link: self.name.to_owned(), moments };
            warnings.push(UrdfWarning::at(line, kind));
        }
        Ok(origin.act_inertia(&Inertia { mass, com: Vector3::zeros(), rotational }))
    }

    /// Checks the friction of a joint.
    fn dynamics(&self, dynamics: DynamicsElement) -> Result<DynamicsElement, UrdfError> {
        for (limit, value) in [("damping", dynamics.damping), ("friction", dynamics.friction)] {
            let Some(value) = value else { continue };
            self.bounded(&format!("<dynamics {limit}>"), dynamics.line, &[value])?;
            if value < 0.0 {
                let kind = UrdfErrorKind::NegativeFriction { element: self.words.clone(), limit, value };
                return Err(UrdfError::at(dynamics.line, kind));
            }
        }
        Ok(dynamics)
    }

    fn mimic(
        &self,
        mimic: Option<MimicElement>,
        warnings: &mut Vec<UrdfWarning>,
    ) -> Result<Option<MimicElement>, UrdfError> {
        let Some(mimic) = mimic else { return Ok(None) };
        self.bounded("<mimic multiplier>", mimic.line, &[mimic.ratio])?;
        self.bounded("<mimic offset>", mimic.line, &[mimic.offset])?;
        let kind = UrdfWarningKind::Mimic { joint: self.name.to_owned(), of: mimic.leader.clone() };
        warnings.push(UrdfWarning::at(mimic.line, kind));
        Ok(Some(mimic))
    }

    /// Returns the direction of the joint axis; without an `<axis>`, x, the URDF default.
    fn axis(&self, axis: Option<&AxisElement>) -> Result<Unit<Vector3<f64>>, UrdfError> {
        let Some(AxisElement { line, xyz }) = axis else {
            return Ok(Vector3::x_axis());
        };
        self.bounded("<axis xyz>", *line, xyz)?;
        let axis = Vector3::from(*xyz);
        if axis.amax() == 0.0 {
            return Err(UrdfError::at(*line, UrdfErrorKind::ZeroAxis { element: self.words.clone() }));
        }
        if axis.amax() < SMALLEST_AXIS {
            return Err(self.bad_number("<axis xyz>", *line, xyz, AXIS));
        }
        // Divided by the largest component first, because the square of a huge component overflows.
        Ok(Unit::new_normalize(axis / axis.amax()))
    }

    fn limits(
        &self,
        kind: JointKind,
        joint_line: Line,
        limit: Option<&LimitElement>,
        warnings: &mut Vec<UrdfWarning>,
    ) -> Result<Limits, UrdfError> {
        let bounded = kind != JointKind::Continuous;
        let limit = match limit {
            Some(limit) => limit,
            None if bounded => {
                let (element, missing) = (self.words.clone(), "<limit>".to_owned());
                let kind = UrdfErrorKind::Missing { element, missing, remedy: LIMIT };
                return Err(UrdfError::at(joint_line, kind));
            }
            None => return Ok(Limits::NONE),
        };
        let [lower, upper] = match bounded {
            true => [
                self.position_limit("lower", limit.line, limit.position[0], warnings)?,
                self.position_limit("upper", limit.line, limit.position[1], warnings)?,
            ],
            false => [Limits::NONE.lower, Limits::NONE.upper],
        };
        if lower > upper {
            let element = self.words.clone();
            return Err(UrdfError::at(limit.line, UrdfErrorKind::LimitsSwapped { element, lower, upper }));
        }
        if lower == upper {
            let kind = UrdfWarningKind::EqualLimits { joint: self.name.to_owned(), value: lower };
            warnings.push(UrdfWarning::at(limit.line, kind));
        }
        let velocity = self.magnitude("velocity", limit.line, limit.velocity, warnings)?;
        let effort = self.magnitude("effort", limit.line, limit.effort, warnings)?;
        Ok(Limits { lower, upper, velocity, effort })
    }

    /// Returns a position limit; infinite if it is further than a robot moves.
    fn position_limit(
        &self,
        limit: &'static str,
        line: Line,
        value: f64,
        warnings: &mut Vec<UrdfWarning>,
    ) -> Result<f64, UrdfError> {
        self.finite(&format!("<limit {limit}>"), line, &[value])?;
        if value.abs() <= FARTHEST_LIMIT {
            return Ok(value);
        }
        let joint = self.name.to_owned();
        warnings.push(UrdfWarning::at(line, UrdfWarningKind::FarLimit { joint, limit, value }));
        Ok(f64::INFINITY.copysign(value))
    }

    /// Returns a velocity or effort limit; infinite for no limit.
    fn magnitude(
        &self,
        limit: &'static str,
        line: Line,
        value: Option<f64>,
        warnings: &mut Vec<UrdfWarning>,
    ) -> Result<f64, UrdfError> {
        let Some(value) = value else { return Ok(f64::INFINITY) };
        self.finite(&format!("<limit {limit}>"), line, &[value])?;
        if value < 0.0 {
            let joint = self.name.to_owned();
            warnings.push(UrdfWarning::at(line, UrdfWarningKind::NegativeLimit { joint, limit, value }));
            return Ok(f64::INFINITY);
        }
        if value == 0.0 {
            let joint = self.name.to_owned();
            warnings.push(UrdfWarning::at(line, UrdfWarningKind::ZeroLimit { joint, limit }));
        }
        Ok(value)
    }

    /// Returns the placement of a joint or an inertia.
    fn origin(&self, origin: &OriginElement) -> Result<Placement, UrdfError> {
        self.bounded("<origin xyz>", origin.line, &origin.xyz_m)?;
        self.within(FARTHEST_ANGLE_RAD, [ANGLES, ANGLES], "<origin rpy>", origin.line, &origin.rpy_rad)?;
        Ok(Placement::from_rpy(origin.rpy_rad, origin.xyz_m))
    }

    /// Checks that the numbers of the attribute `place` are not larger than [`MAX_NUMBER`].
    fn bounded(&self, place: &str, line: Line, values: &[f64]) -> Result<(), UrdfError> {
        self.finite(place, line, values)?;
        self.within(MAX_NUMBER, [ONE_BOUNDED_NUMBER, THREE_BOUNDED_NUMBERS], place, line, values)
    }

    /// Checks that the numbers of the attribute `place` are finite.
    fn finite(&self, place: &str, line: Line, values: &[f64]) -> Result<(), UrdfError> {
        self.within(f64::MAX, [ONE_NUMBER, THREE_NUMBERS], place, line, values)
    }

    fn within(
        &self,
        max: f64,
        [one, three]: [&'static str; 2],
        place: &str,
        line: Line,
        values: &[f64],
    ) -> Result<(), UrdfError> {
        if values.iter().all(|value| value.abs() <= max) {
            return Ok(());
        }
        Err(self.bad_number(place, line, values, if values.len() == 1 { one } else { three }))
    }

    fn bad_number(&self, place: &str, line: Line, values: &[f64], wanted: &'static str) -> UrdfError {
        // As people write them: the digits of 1e-300 are 300.
        let value = values.iter().map(|value| format!("{value:?}")).collect::<Vec<_>>().join(" ");
        let (element, place) = (self.words.clone(), place.to_owned());
        UrdfError::at(line, UrdfErrorKind::BadNumber { element, place, value, wanted })
    }
}

/// Position limit beyond which a joint has none, rad or m.
const FARTHEST_LIMIT: f64 = 1e4;

/// Smallest mass other than 0, kg: that of a bacterium. Inertias of smaller ones are lost in rounding.
const SMALLEST_MASS_KG: f64 = 1e-15;
const MASS: &str = "0, or one number from 1e-15 to 1e9 kg";

/// Smallest largest number of an axis: a smaller one is a rounding error, whose direction means nothing.
const SMALLEST_AXIS: f64 = 1e-9;
const AXIS: &str = "a direction, e.g. xyz=\"0 0 1\", whose largest number is at least 1e-9";

/// Largest angle of a placement, rad: sines of larger ones lose digits, and no file means a thousand turns.
const FARTHEST_ANGLE_RAD: f64 = 1e4;
const ANGLES: &str = "three angles in rad, from -1e4 to 1e4";

/// Largest magnitude of a position, an axis, an angle, a mass or a moment of inertia (m, 1, rad, kg, kg m²): squares and
/// products of it are far from the largest number.
pub(super) const MAX_NUMBER: f64 = 1e9;
/// Description of a number in errors.
pub(super) const ONE_NUMBER: &str = "one finite number";
/// Description of a bounded number in errors.
const ONE_BOUNDED_NUMBER: &str = "one number from -1e9 to 1e9";
/// Description of a vector in errors.
pub(super) const THREE_NUMBERS: &str = "three finite numbers";
/// Description of a bounded vector in errors.
const THREE_BOUNDED_NUMBERS: &str = "three numbers from -1e9 to 1e9";

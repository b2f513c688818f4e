//! Errors and warnings of the URDF reader.

use crate::name_list::name_list;
use thiserror::Error;

/// Reason why a URDF is refused, with the line.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{}{kind}", prefix(*line))]
pub struct UrdfError {
    line: Option<u32>,
    kind: UrdfErrorKind,
}

impl UrdfError {
    pub(super) fn at(line: impl Into<Option<u32>>, kind: UrdfErrorKind) -> Self {
        Self { line: line.into(), kind }
    }

    pub(super) fn whole_file(kind: UrdfErrorKind) -> Self {
        Self { line: None, kind }
    }

    /// Returns the line of the invalid element, from 1; `None` if the error concerns the whole file or the robot was
    /// not read from text.
    #[must_use]
    pub fn line(&self) -> Option<u32> {
        self.line
    }

    /// Returns the kind of the error.
    #[must_use]
    pub fn kind(&self) -> &UrdfErrorKind {
        &self.kind
    }
}

fn prefix(line: Option<u32>) -> String {
    line.map(|l| format!("line {l}: ")).unwrap_or_default()
}

fn on_line(line: Option<u32>) -> String {
    line.map(|l| format!(", on line {l}")).unwrap_or_default()
}

/// Lists up to a hundred names in one line.
fn listed(names: &[String]) -> String {
    name_list(names, 100)
}

/// Reason why a URDF is refused. `element` names the element as in `joint 'elbow'`.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum UrdfErrorKind {
    /// File larger than the URDF of any robot.
    #[error("the file has {bytes} bytes; at most {limit} are read")]
    TooLarge {
        /// Size of the file, bytes.
        bytes: usize,
        /// Largest accepted size, bytes.
        limit: usize,
    },
    /// Elements nested deeper than in any URDF; an XML reader might overflow its call stack.
    #[error("elements are nested more than {limit} deep; a URDF needs five levels")]
    TooDeep {
        /// Largest accepted depth.
        limit: usize,
    },
    /// Element with more attributes than in any URDF; an XML reader might take hours.
    #[error("a tag has more than {limit} attributes; a URDF's have six at most")]
    TooManyAttributes {
        /// Largest accepted number of attributes.
        limit: usize,
    },
    /// Document type or entity: it can make a small file expand to a large one, or refer to other files.
    #[error("<!DOCTYPE> and entities are not read: delete the declaration")]
    Doctype,
    /// Empty file.
    #[error("the file is empty; a URDF is one <robot> element")]
    Empty,
    /// File that is not XML.
    #[error("this is not XML; a URDF is one <robot> element")]
    NotXml,
    /// File that ends before its elements are closed.
    #[error("the file ends before its elements are closed: is it truncated?")]
    Truncated,
    /// Malformed XML.
    #[error("not well-formed XML: {reason}")]
    Malformed {
        /// Message of the XML reader.
        reason: String,
    },
    /// SDF file instead of a URDF.
    #[error("this is SDF, not URDF: convert it, or load the URDF it was made from")]
    Sdf,
    /// XML with another root element.
    #[error("the root element is <{name}>; a URDF's is <robot>")]
    WrongRoot {
        /// Name of the root element.
        name: String,
    },
    /// xacro file that has not been expanded to a URDF.
    #[error("{found} is xacro, not URDF: expand it first, with `xacro FILE.xacro > FILE.urdf`")]
    Xacro {
        /// xacro element or expression in the file.
        found: String,
    },
    /// Link or joint without a name.
    #[error("a <{element}> has no name: give it name=\"...\"")]
    Nameless {
        /// Tag of the element: `link` or `joint`.
        element: &'static str,
    },
    /// Two elements with the same name.
    #[error("{element} is already defined{}: names must be unique", on_line(*first_line))]
    DuplicateName {
        /// Second of the two elements.
        element: String,
        /// Line of the first element; `None` if the robot was not read from text.
        first_line: Option<u32>,
    },
    /// Child element that occurs more than once.
    #[error("{element} has more than one <{child}>: keep one")]
    DuplicateElement {
        /// Element that the child belongs to.
        element: String,
        /// Tag of the child.
        child: &'static str,
    },
    /// Missing child or attribute.
    #[error("{element} has no {missing}; {remedy}")]
    Missing {
        /// Element in which it is missing.
        element: String,
        /// Missing tag or attribute.
        missing: String,
        /// Text to add.
        remedy: &'static str,
    },
    /// Value that is not finite, not a number, or has the wrong number of entries.
    #[error("{element}: {place} is \"{value}\"; give {wanted}")]
    BadNumber {
        /// Element that the value belongs to.
        element: String,
        /// Attribute, as `<tag attribute>`.
        place: String,
        /// Text of the attribute.
        value: String,
        /// Description of the expected value.
        wanted: &'static str,
    },
    /// Axis of zero length.
    #[error("{element}: axis is zero; give a direction, e.g. xyz=\"0 0 1\"")]
    ZeroAxis {
        /// Element that the axis belongs to.
        element: String,
    },
    /// Joint type that is not supported.
    #[error(
        "{element}: type \"{found}\" is not supported; the types are revolute, continuous, prismatic and fixed"
    )]
    JointType {
        /// Joint with this type.
        element: String,
        /// Given type.
        found: String,
    },
    /// Mimic joint whose leader does not exist or cannot move.
    #[error(
        "joint '{joint}' mimics '{leader}', which is not a moving joint; the moving joints are: {}",
        listed(known)
    )]
    UnknownLeader {
        /// Name of the mimic joint.
        joint: String,
        /// Name of the leader.
        leader: String,
        /// Names of the possible leaders.
        known: Vec<String>,
    },
    /// Mimic joints that form a cycle.
    #[error("joint '{joint}' mimics itself, directly or through other joints")]
    MimicsItself {
        /// Name of one joint of the cycle.
        joint: String,
    },
    /// Joint with the name of a coordinate of the floating base.
    #[error("joint '{joint}' has the name of a coordinate of the floating base; rename it")]
    ReservedName {
        /// Name of the joint.
        joint: String,
    },
    /// Robot without mass on a floating base.
    #[error("no body on the floating base '{link}' has mass; give its links <inertial>")]
    WeightlessBase {
        /// Name of the root link.
        link: String,
    },
    /// Attribute that is not supported and would change the robot.
    #[error("{element}: {attribute} is not supported; {remedy}")]
    Unsupported {
        /// Element that the attribute belongs to.
        element: String,
        /// Name of the attribute.
        attribute: &'static str,
        /// Text to write instead.
        remedy: &'static str,
    },
    /// Lower limit above the upper limit.
    #[error("{element}: lower limit {lower} is above upper limit {upper}; swap them?")]
    LimitsSwapped {
        /// Element that the limits belong to.
        element: String,
        /// Lower limit, rad or m.
        lower: f64,
        /// Upper limit, rad or m.
        upper: f64,
    },
    /// Friction below zero.
    #[error("{element}: <dynamics {limit}> is {value}; it must not be negative")]
    NegativeFriction {
        /// Element that the friction belongs to.
        element: String,
        /// Name of the attribute: `damping` or `friction`.
        limit: &'static str,
        /// Given value.
        value: f64,
    },
    /// Joint to be locked that the URDF does not have, or that cannot move.
    #[error("there is no moving joint '{joint}' to lock; the moving joints are: {}", listed(known))]
    UnknownLocked {
        /// Given name.
        joint: String,
        /// Names of the moving joints.
        known: Vec<String>,
    },
    /// Mass below zero.
    #[error("{element}: mass is {mass} kg; it must not be negative")]
    NegativeMass {
        /// Element that the mass belongs to.
        element: String,
        /// Mass, kg.
        mass: f64,
    },
    /// Rotational inertia that is not positive semi-definite: some rotation would have negative kinetic energy.
    #[error(
        "{element}: inertia is not positive semi-definite, its smallest principal moment is {smallest} kg m²; \
         check the signs of <inertia>"
    )]
    NegativeInertia {
        /// Element that the inertia belongs to.
        element: String,
        /// Smallest principal moment, kg m².
        smallest: f64,
    },
    /// Inertia for a link that does not exist.
    #[error("there is no link '{link}' to give an inertia; the links are: {}", listed(known))]
    UnknownInertia {
        /// Given name.
        link: String,
        /// Names of the existing links.
        known: Vec<String>,
    },
    /// Joint that moves no mass.
    #[error(
        "joint '{joint}' moves link '{link}', which has no mass, and neither has any link fixed to it: \
         give it an <inertial>, or make the joint fixed"
    )]
    Massless {
        /// Name of the joint.
        joint: String,
        /// Name of its child link.
        link: String,
    },
    /// Robot without links.
    #[error("the robot has no <link>")]
    NoLinks,
    /// Joint whose parent or child link does not exist.
    #[error("joint '{joint}': {role} link '{link}' doesn't exist; the links are: {}", listed(known))]
    UnknownLink {
        /// Name of the joint.
        joint: String,
        /// Role of the link: `parent` or `child`.
        role: &'static str,
        /// Given name.
        link: String,
        /// Names of the existing links.
        known: Vec<String>,
    },
    /// Link with two parent joints: a kinematic loop, which a URDF cannot express.
    #[error("link '{link}' is the child of two joints, '{first}' and '{second}': remove one")]
    TwoParents {
        /// Name of the link.
        link: String,
        /// First of the two joints in the file.
        first: String,
        /// Second of the two joints in the file.
        second: String,
    },
    /// More than one root link.
    #[error(
        "the links {} are not the child of any joint: a robot has one root; connect the others to it, e.g. by fixed joints",
        listed(links)
    )]
    SeveralRoots {
        /// Names of all root links.
        links: Vec<String>,
    },
    /// Links that form a cycle.
    #[error("the joints form a cycle: {}; one link must be the root", links.join(" → "))]
    Cycle {
        /// Names of the links of the cycle in order; the first one is repeated at the end.
        links: Vec<String>,
    },
}

/// Warning about a possible but unusual value in a URDF, with its line.
#[derive(Clone, Debug, PartialEq)]
pub struct UrdfWarning {
    line: Option<u32>,
    kind: UrdfWarningKind,
}

impl UrdfWarning {
    pub(super) fn at(line: Option<u32>, kind: UrdfWarningKind) -> Self {
        Self { line, kind }
    }

    /// Returns the line of the element, from 1; `None` if the robot was not read from text.
    #[must_use]
    pub fn line(&self) -> Option<u32> {
        self.line
    }

    /// Returns the kind of the warning.
    #[must_use]
    pub fn kind(&self) -> &UrdfWarningKind {
        &self.kind
    }
}

impl std::fmt::Display for UrdfWarning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}{}", prefix(self.line), self.kind)
    }
}

/// Kind of possible but unusual value.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum UrdfWarningKind {
    /// Principal moments that no mass distribution has.
    #[error(
        "link '{link}': principal moments {:.3e}, {:.3e}, {:.3e} kg m² violate the triangle inequality; \
         no physical body has such moments",
        moments[0], moments[1], moments[2]
    )]
    ImpossibleInertia {
        /// Name of the link.
        link: String,
        /// Principal moments, ascending, kg m².
        moments: [f64; 3],
    },
    /// Inertia that no body has, on a link that cannot move.
    #[error(
        "link '{link}': inertia is not positive semi-definite, its smallest principal moment is {smallest} kg m²; \
         the link cannot move, so that its inertia has no effect"
    )]
    StandingInertia {
        /// Name of the link.
        link: String,
        /// Smallest principal moment, kg m².
        smallest: f64,
    },
    /// Joint with equal position limits, which cannot move.
    #[error("joint '{joint}': lower and upper limits are both {value}: it cannot move; is it a fixed joint?")]
    EqualLimits {
        /// Name of the joint.
        joint: String,
        /// Value of both limits, rad or m.
        value: f64,
    },
    /// Joint with a velocity or effort limit below zero.
    #[error("joint '{joint}': {limit} limit {value} is below zero: it is read as no limit")]
    NegativeLimit {
        /// Name of the joint.
        joint: String,
        /// Name of the limit: `velocity` or `effort`.
        limit: &'static str,
        /// Value of the limit, rad/s or m/s, Nm or N.
        value: f64,
    },
    /// Joint with a position limit that is further than a robot moves.
    #[error("joint '{joint}': {limit} limit {value:?} is further than a robot moves: it is read as no limit")]
    FarLimit {
        /// Name of the joint.
        joint: String,
        /// Name of the limit: `lower` or `upper`.
        limit: &'static str,
        /// Value of the limit, rad or m.
        value: f64,
    },
    /// Prefix of a tag or attribute that the file does not declare.
    #[error("the XML prefix '{prefix}' is not declared, as XML requires: what it marks is ignored")]
    UndeclaredPrefix {
        /// The prefix.
        prefix: String,
    },
    /// Joint with a velocity or effort limit of zero.
    #[error("joint '{joint}': {limit} limit is 0: no {limit} is allowed; omit the attribute for no limit")]
    ZeroLimit {
        /// Name of the joint.
        joint: String,
        /// Name of the limit: `velocity` or `effort`.
        limit: &'static str,
    },
    /// Mimic joint whose coupling is ignored in the model.
    #[error("joint '{joint}' mimics '{of}': the coupling is ignored and the joint moves independently")]
    Mimic {
        /// Name of the joint.
        joint: String,
        /// Name of the leader.
        of: String,
    },
}

impl UrdfWarningKind {
    /// Codes of all kinds.
    pub const CODES: [&'static str; 8] = [
        "impossible-inertia",
        "fixed-link-inertia",
        "equal-limits",
        "zero-limit",
        "ignored-mimic",
        "negative-limit",
        "undeclared-prefix",
        "far-limit",
    ];

    /// Returns the code of the kind, which remains the same when its text changes.
    #[must_use]
    pub fn code(&self) -> &'static str {
        let [impossible, fixed, equal, zero, mimic, negative, prefix, far] = Self::CODES;
        match self {
            Self::ImpossibleInertia { .. } => impossible,
            Self::StandingInertia { .. } => fixed,
            Self::EqualLimits { .. } => equal,
            Self::ZeroLimit { .. } => zero,
            Self::Mimic { .. } => mimic,
            Self::NegativeLimit { .. } => negative,
            Self::UndeclaredPrefix { .. } => prefix,
            Self::FarLimit { .. } => far,
        }
    }
}

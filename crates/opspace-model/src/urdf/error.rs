//! What can be wrong with a URDF.

use thiserror::Error;

/// Why a URDF is refused, and where.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{}{kind}", prefix(*line))]
pub struct UrdfError {
    line: Option<u32>,
    kind: UrdfErrorKind,
}

impl UrdfError {
    pub(super) fn at(line: u32, kind: UrdfErrorKind) -> Self {
        Self { line: Some(line), kind }
    }

    pub(super) fn whole_file(kind: UrdfErrorKind) -> Self {
        Self { line: None, kind }
    }

    /// The line of the element at fault, from 1; `None` where it is the file as a whole.
    #[must_use]
    pub fn line(&self) -> Option<u32> {
        self.line
    }

    /// What is wrong.
    #[must_use]
    pub fn kind(&self) -> &UrdfErrorKind {
        &self.kind
    }
}

fn prefix(line: Option<u32>) -> String {
    line.map(|l| format!("line {l}: ")).unwrap_or_default()
}

/// Names, as many as can be taken in.
fn listed(names: &[String]) -> String {
    const MOST: usize = 100;
    let shown = names[..names.len().min(MOST)].join(", ");
    match names.len().saturating_sub(MOST) {
        0 => shown,
        more => format!("{shown} and {more} more"),
    }
}

/// Why a URDF is refused. `element` is the element as a person would say it: `joint 'elbow'`.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum UrdfErrorKind {
    /// Larger than any robot's.
    #[error("the file has {bytes} bytes; at most {limit} are read")]
    TooLarge {
        /// Its size.
        bytes: usize,
        /// The largest size read.
        limit: usize,
    },
    /// Nested deeper than any robot's: a reader might run out of stack.
    #[error("elements are nested more than {limit} deep; a URDF needs five levels")]
    TooDeep {
        /// The deepest nesting read.
        limit: usize,
    },
    /// More attributes than any element has: a reader might take hours.
    #[error("a tag has more than {limit} attributes; a URDF's have six at most")]
    TooManyAttributes {
        /// The most read.
        limit: usize,
    },
    /// Document types and entities can make a small file large or name other files.
    #[error("<!DOCTYPE> and entities are not read: delete the declaration")]
    Doctype,
    /// Nothing in it.
    #[error("the file is empty; a URDF is one <robot> element")]
    Empty,
    /// No XML at all.
    #[error("this is not XML; a URDF is one <robot> element")]
    NotXml,
    /// It stops in the middle.
    #[error("the file ends before its elements are closed: is it truncated?")]
    Truncated,
    /// Malformed XML.
    #[error("not well-formed XML: {reason}")]
    Malformed {
        /// The XML reader's words.
        reason: String,
    },
    /// A robot in another format.
    #[error("this is SDF, not URDF: convert it, or load the URDF it was made from")]
    Sdf,
    /// XML of some other kind.
    #[error("the root element is <{name}>; a URDF's is <robot>")]
    WrongRoot {
        /// The root element's name.
        name: String,
    },
    /// A URDF's source, not yet expanded.
    #[error("{found} is xacro, not URDF: expand it first, with `xacro FILE.xacro > FILE.urdf`")]
    Xacro {
        /// The element or expression found.
        found: String,
    },
    /// No name to speak of it by.
    #[error("a <{element}> has no name: give it name=\"...\"")]
    Nameless {
        /// `link` or `joint`.
        element: &'static str,
    },
    /// Two of one name.
    #[error("{element} is there already, on line {first_line}: names must be unique")]
    DuplicateName {
        /// The second.
        element: String,
        /// Where the first is.
        first_line: u32,
    },
    /// Something that may be said once is said twice.
    #[error("{element} has more than one <{child}>: leave one")]
    DuplicateElement {
        /// Whose.
        element: String,
        /// What.
        child: &'static str,
    },
    /// Something required isn't there.
    #[error("{element} has no {missing}; {remedy}")]
    Missing {
        /// Whose.
        element: String,
        /// What.
        missing: String,
        /// What to write.
        remedy: &'static str,
    },
    /// Not a number, too few or too many of them, or not finite.
    #[error("{element}: {place} is \"{value}\"; give {wanted}")]
    BadNumber {
        /// Whose.
        element: String,
        /// Which, as `<tag attribute>`.
        place: String,
        /// The text there.
        value: String,
        /// What should be there.
        wanted: &'static str,
    },
    /// A direction without length.
    #[error("{element}: axis is zero; give a direction, e.g. xyz=\"0 0 1\"")]
    ZeroAxis {
        /// Whose.
        element: String,
    },
    /// A joint of a type that the dynamics don't cover.
    #[error(
        "{element}: type \"{found}\" is not supported; the types are revolute, continuous, prismatic and fixed"
    )]
    JointType {
        /// Whose.
        element: String,
        /// The type given.
        found: String,
    },
    /// A mimic joint of a joint that isn't there, or that doesn't move.
    #[error("joint '{joint}' mimics '{leader}', which is no moving joint; those are: {}", listed(known))]
    UnknownLeader {
        /// The mimic joint.
        joint: String,
        /// What it names.
        leader: String,
        /// What it could name.
        known: Vec<String>,
    },
    /// Mimic joints in a circle.
    #[error("joint '{joint}' mimics itself, by way of other joints or at once")]
    MimicsItself {
        /// One of them.
        joint: String,
    },
    /// A joint that couldn't be told from a coordinate of the floating base.
    #[error("joint '{joint}' has the name of a coordinate of the floating base; rename it")]
    ReservedName {
        /// The joint.
        joint: String,
    },
    /// A floating robot without mass.
    #[error("nothing on the floating base '{link}' has mass; give its links <inertial>")]
    WeightlessBase {
        /// The root link.
        link: String,
    },
    /// An attribute that would change the robot and that isn't read.
    #[error("{element}: {attribute} is not read; {remedy}")]
    Unsupported {
        /// Whose.
        element: String,
        /// Which.
        attribute: &'static str,
        /// What to write instead.
        remedy: &'static str,
    },
    /// A lower limit above the upper.
    #[error("{element}: lower limit {lower} is above upper limit {upper}; swap them?")]
    LimitsSwapped {
        /// Whose.
        element: String,
        /// rad or m.
        lower: f64,
        /// rad or m.
        upper: f64,
    },
    /// A negative limit of speed or effort.
    #[error("{element}: {limit} limit {value} is negative; give its magnitude, or leave it out for none")]
    NegativeLimit {
        /// Whose.
        element: String,
        /// `velocity` or `effort`.
        limit: &'static str,
        /// As given.
        value: f64,
    },
    /// A mass below zero.
    #[error("{element}: mass is {mass} kg; it can't be negative")]
    NegativeMass {
        /// Whose.
        element: String,
        /// kg.
        mass: f64,
    },
    /// A rotational inertia that some rotation would give negative energy.
    #[error(
        "{element}: inertia is not positive semi-definite, its smallest principal moment is {smallest} kg m²; \
         check the signs of <inertia>"
    )]
    NegativeInertia {
        /// Whose.
        element: String,
        /// kg m².
        smallest: f64,
    },
    /// A joint that moves nothing.
    #[error(
        "joint '{joint}' moves link '{link}', which has no mass, nor has anything fixed to it: \
         give it an <inertial>, or make the joint fixed"
    )]
    Massless {
        /// The joint.
        joint: String,
        /// Its child link.
        link: String,
    },
    /// Numbers too large to be multiplied.
    #[error("{element}: its place or inertia overflows; check the magnitudes, SI units")]
    Overflow {
        /// A joint with its body, or a link.
        element: String,
    },
    /// A robot without links.
    #[error("the robot has no <link>")]
    NoLinks,
    /// A joint to or from nowhere.
    #[error("joint '{joint}': {role} link '{link}' doesn't exist; the links are: {}", listed(known))]
    UnknownLink {
        /// The joint.
        joint: String,
        /// `parent` or `child`.
        role: &'static str,
        /// The name given.
        link: String,
        /// The names there are.
        known: Vec<String>,
    },
    /// A loop, which a URDF can't express.
    #[error("link '{link}' is the child of two joints, '{first}' and '{second}': remove one")]
    TwoParents {
        /// The link.
        link: String,
        /// The joint that comes first in the file.
        first: String,
        /// The other.
        second: String,
    },
    /// More than one robot.
    #[error(
        "the links {} are no joint's child: a robot has one root; join the others to it, if only by fixed joints",
        listed(links)
    )]
    SeveralRoots {
        /// All roots.
        links: Vec<String>,
    },
    /// Links that are each other's descendants.
    #[error("the joints form a cycle: {}; one link must be the root", links.join(" → "))]
    Cycle {
        /// Its links in order, the first again at the end.
        links: Vec<String>,
    },
}

/// What a URDF says that can be, but seldom should, and where.
#[derive(Clone, Debug, PartialEq)]
pub struct UrdfWarning {
    line: u32,
    kind: UrdfWarningKind,
}

impl UrdfWarning {
    pub(super) fn at(line: u32, kind: UrdfWarningKind) -> Self {
        Self { line, kind }
    }

    /// The line of the element, from 1.
    #[must_use]
    pub fn line(&self) -> u32 {
        self.line
    }

    /// What looks wrong.
    #[must_use]
    pub fn kind(&self) -> &UrdfWarningKind {
        &self.kind
    }
}

impl std::fmt::Display for UrdfWarning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "line {}: {}", self.line, self.kind)
    }
}

/// What a URDF says that can be, but seldom should.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum UrdfWarningKind {
    /// No distribution of mass has such moments.
    #[error(
        "link '{link}': principal moments {:.3e}, {:.3e}, {:.3e} kg m² violate the triangle inequality; \
         no body has them",
        moments[0], moments[1], moments[2]
    )]
    ImpossibleInertia {
        /// The link.
        link: String,
        /// Ascending, kg m².
        moments: [f64; 3],
    },
    /// A joint that can't move.
    #[error("joint '{joint}': lower and upper limit are both {value}: it can't move; is it a fixed joint?")]
    EqualLimits {
        /// The joint.
        joint: String,
        /// rad or m.
        value: f64,
    },
    /// A joint that may not move.
    #[error("joint '{joint}': {limit} limit is 0: it may not be used; leave the attribute out for no limit")]
    ZeroLimit {
        /// The joint.
        joint: String,
        /// `velocity` or `effort`.
        limit: &'static str,
    },
    /// A coupling that the model leaves out.
    #[error("joint '{joint}' mimics '{of}': the coupling is ignored, it is a joint of its own here")]
    Mimic {
        /// The joint.
        joint: String,
        /// The joint it should follow.
        of: String,
    },
}

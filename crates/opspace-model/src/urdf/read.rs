//! Extraction from URDF text of the elements that the dynamics need, each checked on its own, with its line.

use super::error::{UrdfError, UrdfErrorKind, UrdfWarning, UrdfWarningKind};
use crate::model::{JointKind, Limits};
use crate::spatial::{Inertia, Placement, principal_moments};
use nalgebra::{Matrix3, Unit, Vector3};
use roxmltree::Document;
use std::collections::HashMap;

/// Largest size of a file, bytes: those of the largest robots have some hundred kilobytes.
const MAX_BYTES: usize = 16 << 20;
/// Deepest nesting: extensions (`<gazebo>`, `<transmission>`) nest deeper than URDF's own five levels, not this deep.
const MAX_DEPTH: usize = 64;
/// Most attributes of a tag: URDF's own have six at most; readers compare each with each.
const MAX_ATTRIBUTES: usize = 64;
/// Tolerance of principal moments relative to the largest; files print five digits and more.
const INERTIA_TOLERANCE: f64 = 1e-6;
/// Remedy in errors about a joint's limits.
const LIMIT: &str = "write <limit lower=\"...\" upper=\"...\" velocity=\"...\" effort=\"...\"/>";

/// Contents of a URDF that concern the robot's dynamics.
pub(super) struct Description {
    pub name: String,
    pub links: Vec<LinkElement>,
    pub joints: Vec<JointElement>,
}

/// Description, and the warnings about it.
pub(super) struct Reading {
    pub description: Description,
    pub warnings: Vec<UrdfWarning>,
}

pub(super) struct LinkElement {
    pub name: String,
    pub line: u32,
    /// Inertia in the link's frame.
    pub inertia: Option<Inertia>,
}

pub(super) struct JointElement {
    pub name: String,
    pub line: u32,
    pub parent: String,
    pub child: String,
    pub origin: Placement,
    pub motion: Motion,
}

pub(super) enum Motion {
    Fixed,
    Moving { kind: JointKind, axis: Unit<Vector3<f64>>, limits: Limits, mimic: Option<Mimic> },
}

/// Coupling of a joint to its leader.
pub(super) struct Mimic {
    pub line: u32,
    pub leader: String,
    pub ratio: f64,
    pub offset: f64,
}

pub(super) fn read(text: &str) -> Result<Reading, UrdfError> {
    guard(text)?;
    let document = Document::parse(text).map_err(|e| malformed(&e))?;
    let robot = document.root_element();
    let lines = Lines::of(text);
    expect_urdf(robot, &lines)?;
    let mut warnings = Vec::new();
    let mut links = Vec::new();
    for element in named_children(robot, "link", &lines)? {
        links.push(element.link(&mut warnings)?);
    }
    if links.is_empty() {
        return Err(UrdfError::at(lines.line(robot), UrdfErrorKind::NoLinks));
    }
    let mut joints = Vec::new();
    for element in named_children(robot, "joint", &lines)? {
        joints.push(element.joint(&mut warnings)?);
    }
    let name = robot.attribute("name").unwrap_or_default().to_owned();
    Ok(Reading { description: Description { name, links, joints }, warnings })
}

/// Refuses, in one pass without recursion, texts that are unsafe to pass to an XML reader.
fn guard(text: &str) -> Result<(), UrdfError> {
    if text.len() > MAX_BYTES {
        let kind = UrdfErrorKind::TooLarge { bytes: text.len(), limit: MAX_BYTES };
        return Err(UrdfError::whole_file(kind));
    }
    if text.trim_start_matches('\u{feff}').trim().is_empty() {
        return Err(UrdfError::whole_file(UrdfErrorKind::Empty));
    }
    let mut depth: usize = 0;
    let mut at = 0;
    while let Some(open) = text[at..].find('<').map(|i| at + i) {
        let refuse = |kind| Err(UrdfError::at(line_of(text, open), kind));
        let rest = &text[open..];
        let end = if rest.starts_with("<!--") {
            rest.find("-->")
        } else if rest.starts_with("<![CDATA[") {
            rest.find("]]>")
        } else if rest.starts_with("<?") {
            rest.find("?>")
        } else if rest.starts_with("<!") {
            return refuse(UrdfErrorKind::Doctype);
        } else {
            let tag = Tag::of(rest);
            depth = depth.saturating_add_signed(tag.nests);
            if depth > MAX_DEPTH {
                return refuse(UrdfErrorKind::TooDeep { limit: MAX_DEPTH });
            }
            if tag.attributes > MAX_ATTRIBUTES {
                return refuse(UrdfErrorKind::TooManyAttributes { limit: MAX_ATTRIBUTES });
            }
            tag.end
        };
        match end {
            Some(end) => at = open + end,
            // Unfinished: the XML reader says so, and reads no further either.
            None => return Ok(()),
        }
    }
    Ok(())
}

/// Extent and kind of a tag, without its contents.
struct Tag {
    /// Index of its `>`.
    end: Option<usize>,
    attributes: usize,
    /// 1 if it opens an element, −1 if it closes one, 0 if both.
    nests: isize,
}

impl Tag {
    /// Scans the tag at the beginning of `text`. Text between quotes is skipped.
    fn of(text: &str) -> Self {
        let mut quote = None;
        let mut attributes = 0;
        let mut before = b'<';
        for (i, byte) in text.bytes().enumerate() {
            match (quote, byte) {
                (Some(open), _) if byte == open => quote = None,
                (Some(_), _) => {}
                (None, b'"' | b'\'') => quote = Some(byte),
                (None, b'=') => attributes += 1,
                (None, b'>') => {
                    let nests = match (text.starts_with("</"), before) {
                        (true, _) => -1,
                        (false, b'/') => 0,
                        (false, _) => 1,
                    };
                    return Self { end: Some(i), attributes, nests };
                }
                (None, _) => {}
            }
            before = byte;
        }
        Self { end: None, attributes, nests: 0 }
    }
}

fn line_of(text: &str, position: usize) -> u32 {
    let newlines = text.as_bytes()[..position].iter().filter(|&&b| b == b'\n').count();
    u32::try_from(newlines + 1).unwrap_or(u32::MAX)
}

fn malformed(error: &roxmltree::Error) -> UrdfError {
    use roxmltree::Error;
    let line = error.pos().row;
    match error {
        Error::NoRootNode | Error::UnknownToken(_) if line == 1 => {
            UrdfError::whole_file(UrdfErrorKind::NotXml)
        }
        Error::UnclosedRootNode | Error::UnexpectedEndOfStream => {
            UrdfError::whole_file(UrdfErrorKind::Truncated)
        }
        Error::DtdDetected => UrdfError::whole_file(UrdfErrorKind::Doctype),
        Error::UnknownNamespace(prefix, _) if prefix == "xacro" => {
            UrdfError::at(line, UrdfErrorKind::Xacro { found: "a <xacro:...> element".to_owned() })
        }
        _ => UrdfError::at(line, UrdfErrorKind::Malformed { reason: error.to_string() }),
    }
}

/// Node of the document; both of roxmltree's lifetimes as one.
type Node<'a> = roxmltree::Node<'a, 'a>;

/// Start of each line but the first, as byte index.
struct Lines(Vec<usize>);

impl Lines {
    fn of(text: &str) -> Self {
        Self(text.match_indices('\n').map(|(i, _)| i + 1).collect())
    }

    /// Line on which a node begins, from 1.
    fn line(&self, node: Node<'_>) -> u32 {
        let before = self.0.partition_point(|&start| start <= node.range().start);
        u32::try_from(before + 1).unwrap_or(u32::MAX)
    }
}

fn expect_urdf(robot: Node<'_>, lines: &Lines) -> Result<(), UrdfError> {
    let wrong_root = match robot.tag_name().name() {
        "robot" => None,
        "sdf" => Some(UrdfErrorKind::Sdf),
        name => Some(UrdfErrorKind::WrongRoot { name: name.to_owned() }),
    };
    if let Some(kind) = wrong_root {
        return Err(UrdfError::at(lines.line(robot), kind));
    }
    // An expanded file often keeps the declaration `xmlns:xacro`, but nothing that uses it.
    for node in robot.descendants().filter(Node::is_element) {
        let name = node.tag_name();
        let expression =
            node.attributes().map(|a| a.value()).find(|value| value.contains("${") || value.contains("$("));
        let found = match expression {
            Some(value) => format!("\"{value}\""),
            None if name.namespace().is_some_and(|n| n.contains("xacro")) => {
                format!("<xacro:{}>", name.name())
            }
            None => continue,
        };
        return Err(UrdfError::at(lines.line(node), UrdfErrorKind::Xacro { found }));
    }
    Ok(())
}

/// Returns all children `tag` of the robot, which must have unique names.
fn named_children<'a>(
    robot: Node<'a>,
    tag: &'static str,
    lines: &'a Lines,
) -> Result<Vec<Element<'a>>, UrdfError> {
    let mut first_lines = HashMap::new();
    let mut all = Vec::new();
    for node in robot.children().filter(|n| n.has_tag_name(tag)) {
        let line = lines.line(node);
        let name = match node.attribute("name").map(str::trim) {
            None | Some("") => return Err(UrdfError::at(line, UrdfErrorKind::Nameless { element: tag })),
            Some(name) => name,
        };
        let element = Element { node, name, words: format!("{tag} '{name}'"), lines };
        if let Some(first_line) = first_lines.insert(name, line) {
            let kind = UrdfErrorKind::DuplicateName { element: element.words, first_line };
            return Err(UrdfError::at(line, kind));
        }
        all.push(element);
    }
    Ok(all)
}

/// Element `<link>` or `<joint>`. The nodes that its functions take are within it.
struct Element<'a> {
    node: Node<'a>,
    name: &'a str,
    /// Description of the element in errors: `joint 'elbow'`.
    words: String,
    lines: &'a Lines,
}

impl<'a> Element<'a> {
    fn link(&self, warnings: &mut Vec<UrdfWarning>) -> Result<LinkElement, UrdfError> {
        let inertial = self.child(self.node, "inertial")?;
        let inertia = inertial.map(|node| self.inertia(node, warnings)).transpose()?;
        Ok(LinkElement { name: self.name.to_owned(), line: self.lines.line(self.node), inertia })
    }

    fn inertia(&self, inertial: Node<'a>, warnings: &mut Vec<UrdfWarning>) -> Result<Inertia, UrdfError> {
        const MASS: &str = "write <mass value=\"...\"/> (kg)";
        const MOMENTS: &str = "<inertia> has six: ixx ixy ixz iyy iyz izz (kg m²)";
        let origin = self.origin(inertial)?;
        let node = self.required(inertial, "mass", MASS)?;
        let mass = self.number(node, "value", MASS)?;
        if mass < 0.0 {
            return Err(self.error(node, UrdfErrorKind::NegativeMass { element: self.words.clone(), mass }));
        }
        let node = self.required(inertial, "inertia", MOMENTS)?;
        let moment = |attribute| self.number(node, attribute, MOMENTS);
        let (xx, xy, xz) = (moment("ixx")?, moment("ixy")?, moment("ixz")?);
        let (yy, yz, zz) = (moment("iyy")?, moment("iyz")?, moment("izz")?);
        let rotational = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        let moments = principal_moments(&rotational);
        let tolerance = INERTIA_TOLERANCE * moments[2].max(-moments[0]);
        if moments[0] < -tolerance {
            let (element, smallest) = (self.words.clone(), moments[0]);
            return Err(self.error(node, UrdfErrorKind::NegativeInertia { element, smallest }));
        }
        if moments[0] + moments[1] < moments[2] - tolerance {
            let kind = UrdfWarningKind::ImpossibleInertia { link: self.name.to_owned(), moments };
            warnings.push(self.warning(node, kind));
        }
        Ok(origin.act_inertia(&Inertia { mass, com: Vector3::zeros(), rotational }))
    }

    fn joint(&self, warnings: &mut Vec<UrdfWarning>) -> Result<JointElement, UrdfError> {
        const TYPE: &str = "give type=\"...\": revolute, continuous, prismatic or fixed";
        let kind = match self.attribute(self.node, "type", TYPE)? {
            "revolute" => Some(JointKind::Revolute),
            "continuous" => Some(JointKind::Continuous),
            "prismatic" => Some(JointKind::Prismatic),
            "fixed" => None,
            found => {
                let (element, found) = (self.words.clone(), found.to_owned());
                return Err(self.error(self.node, UrdfErrorKind::JointType { element, found }));
            }
        };
        let motion = match kind {
            None => Motion::Fixed,
            Some(kind) => Motion::Moving {
                kind,
                axis: self.axis()?,
                limits: self.limits(kind, warnings)?,
                mimic: self.mimic(warnings)?,
            },
        };
        Ok(JointElement {
            name: self.name.to_owned(),
            line: self.lines.line(self.node),
            parent: self.linked("parent", "write <parent link=\"...\"/>")?,
            child: self.linked("child", "write <child link=\"...\"/>")?,
            origin: self.origin(self.node)?,
            motion,
        })
    }

    /// Returns its `<mimic>`, if it has one: the ratio is 1 and the offset 0 where they aren't given.
    fn mimic(&self, warnings: &mut Vec<UrdfWarning>) -> Result<Option<Mimic>, UrdfError> {
        const MIMIC: &str = "write <mimic joint=\"...\" multiplier=\"...\" offset=\"...\"/>";
        let Some(node) = self.child(self.node, "mimic")? else {
            return Ok(None);
        };
        let number = |attribute, none| match node.has_attribute(attribute) {
            true => self.number(node, attribute, MIMIC),
            false => Ok(none),
        };
        let (ratio, offset) = (number("multiplier", 1.0)?, number("offset", 0.0)?);
        let leader = self.attribute(node, "joint", MIMIC)?.to_owned();
        let kind = UrdfWarningKind::Mimic { joint: self.name.to_owned(), of: leader.clone() };
        warnings.push(self.warning(node, kind));
        Ok(Some(Mimic { line: self.lines.line(node), leader, ratio, offset }))
    }

    /// Name of the link in a joint's `<parent>` or `<child>`.
    fn linked(&self, tag: &'static str, remedy: &'static str) -> Result<String, UrdfError> {
        let node = self.required(self.node, tag, remedy)?;
        Ok(self.attribute(node, "link", remedy)?.to_owned())
    }

    /// Direction of the joint's axis; x where the file gives none, which is the default of the format.
    fn axis(&self) -> Result<Unit<Vector3<f64>>, UrdfError> {
        let Some(node) = self.child(self.node, "axis")? else {
            return Ok(Vector3::x_axis());
        };
        self.attribute(node, "xyz", "give a direction, e.g. xyz=\"0 0 1\"")?;
        let axis = Vector3::from(self.vector(node, "xyz")?);
        if axis.amax() == 0.0 {
            return Err(self.error(node, UrdfErrorKind::ZeroAxis { element: self.words.clone() }));
        }
        // By the largest component first: the square of a tiny or huge one is zero or infinite.
        Ok(Unit::new_normalize(axis / axis.amax()))
    }

    fn limits(&self, kind: JointKind, warnings: &mut Vec<UrdfWarning>) -> Result<Limits, UrdfError> {
        let bounded = kind != JointKind::Continuous;
        let node = match self.child(self.node, "limit")? {
            Some(node) => node,
            None if bounded => return Err(self.missing(self.node, "<limit>".to_owned(), LIMIT)),
            None => return Ok(Limits::NONE),
        };
        let (lower, upper) = match bounded {
            true => (self.number(node, "lower", LIMIT)?, self.number(node, "upper", LIMIT)?),
            false => (Limits::NONE.lower, Limits::NONE.upper),
        };
        if lower > upper {
            let element = self.words.clone();
            return Err(self.error(node, UrdfErrorKind::LimitsSwapped { element, lower, upper }));
        }
        if lower == upper {
            let joint = self.name.to_owned();
            warnings.push(self.warning(node, UrdfWarningKind::EqualLimits { joint, value: lower }));
        }
        let velocity = self.magnitude(node, "velocity", warnings)?;
        let effort = self.magnitude(node, "effort", warnings)?;
        Ok(Limits { lower, upper, velocity, effort })
    }

    /// Limit of speed or effort; infinite where the file gives none.
    fn magnitude(
        &self,
        node: Node<'a>,
        limit: &'static str,
        warnings: &mut Vec<UrdfWarning>,
    ) -> Result<f64, UrdfError> {
        if !node.has_attribute(limit) {
            return Ok(f64::INFINITY);
        }
        let value = self.number(node, limit, LIMIT)?;
        if value < 0.0 {
            let element = self.words.clone();
            return Err(self.error(node, UrdfErrorKind::NegativeLimit { element, limit, value }));
        }
        if value == 0.0 {
            let joint = self.name.to_owned();
            warnings.push(self.warning(node, UrdfWarningKind::ZeroLimit { joint, limit }));
        }
        Ok(value)
    }

    /// Placement of the `<origin>` of a joint or an inertia; the identity if there is none.
    fn origin(&self, parent: Node<'a>) -> Result<Placement, UrdfError> {
        let Some(node) = self.child(parent, "origin")? else {
            return Ok(Placement::identity());
        };
        if node.has_attribute("quat_xyzw") {
            let kind = UrdfErrorKind::Unsupported {
                element: self.words.clone(),
                attribute: "<origin quat_xyzw>",
                remedy: "give the rotation as rpy=\"roll pitch yaw\" (rad)",
            };
            return Err(self.error(node, kind));
        }
        Ok(Placement::from_rpy(self.vector(node, "rpy")?, self.vector(node, "xyz")?))
    }

    /// Returns the one child `tag` of `parent`, if there is one.
    fn child(&self, parent: Node<'a>, tag: &'static str) -> Result<Option<Node<'a>>, UrdfError> {
        let mut all = parent.children().filter(|n| n.has_tag_name(tag));
        let first = all.next();
        match all.next() {
            None => Ok(first),
            Some(second) => {
                let element = self.words.clone();
                Err(self.error(second, UrdfErrorKind::DuplicateElement { element, child: tag }))
            }
        }
    }

    fn required(
        &self,
        parent: Node<'a>,
        tag: &'static str,
        remedy: &'static str,
    ) -> Result<Node<'a>, UrdfError> {
        self.child(parent, tag)?.ok_or_else(|| self.missing(parent, format!("<{tag}>"), remedy))
    }

    fn attribute(&self, node: Node<'a>, attribute: &str, remedy: &'static str) -> Result<&'a str, UrdfError> {
        let value = node.attribute(attribute).map(str::trim);
        value.ok_or_else(|| self.missing(node, place(node, attribute), remedy))
    }

    fn number(&self, node: Node<'a>, attribute: &str, remedy: &'static str) -> Result<f64, UrdfError> {
        let value = self.attribute(node, attribute, remedy)?;
        finite(value).ok_or_else(|| self.bad_number(node, attribute, value, "one finite number"))
    }

    /// Three numbers of an attribute; zeros where it isn't there.
    fn vector(&self, node: Node<'a>, attribute: &str) -> Result<[f64; 3], UrdfError> {
        let Some(value) = node.attribute(attribute) else {
            return Ok([0.0; 3]);
        };
        let numbers: Option<Vec<f64>> = value.split_whitespace().map(finite).collect();
        match numbers.as_deref() {
            Some(&[x, y, z]) => Ok([x, y, z]),
            _ => Err(self.bad_number(node, attribute, value, "three finite numbers")),
        }
    }

    fn bad_number(&self, node: Node<'a>, attribute: &str, value: &str, wanted: &'static str) -> UrdfError {
        let (element, place) = (self.words.clone(), place(node, attribute));
        self.error(node, UrdfErrorKind::BadNumber { element, place, value: value.to_owned(), wanted })
    }

    fn missing(&self, node: Node<'a>, missing: String, remedy: &'static str) -> UrdfError {
        self.error(node, UrdfErrorKind::Missing { element: self.words.clone(), missing, remedy })
    }

    fn error(&self, node: Node<'a>, kind: UrdfErrorKind) -> UrdfError {
        UrdfError::at(self.lines.line(node), kind)
    }

    fn warning(&self, node: Node<'a>, kind: UrdfWarningKind) -> UrdfWarning {
        UrdfWarning::at(self.lines.line(node), kind)
    }
}

fn place(node: Node<'_>, attribute: &str) -> String {
    format!("<{} {attribute}>", node.tag_name().name())
}

fn finite(text: &str) -> Option<f64> {
    text.parse().ok().filter(|x: &f64| x.is_finite())
}

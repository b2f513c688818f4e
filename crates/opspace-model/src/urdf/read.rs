//! Reader of URDF text: extracts the elements needed by the dynamics, with their lines.

use super::check::{LIMIT, MOMENTS, ONE_NUMBER, THREE_NUMBERS, joint_kind};
use super::elements::{
    AxisElement, DynamicsElement, InertialElement, JointElement, LimitElement, Line, LinkElement,
    MimicElement, OriginElement, RobotElement,
};
use super::error::{UrdfError, UrdfErrorKind, UrdfWarning, UrdfWarningKind};
use crate::model::{JointKind, Limits};
use roxmltree::Document;
use std::borrow::Cow;

/// Largest file size, bytes; the files of the largest robots have some hundred kilobytes.
const MAX_BYTES: usize = 16 << 20;
/// Largest nesting depth: URDF itself has five levels; extensions (`<gazebo>`, `<transmission>`) are deeper, but far
/// less than this.
const MAX_DEPTH: usize = 64;
/// Largest number of attributes per tag: URDF itself has six at most. XML readers compare all pairs of attributes.
const MAX_ATTRIBUTES: usize = 64;

pub(super) fn read(text: &str) -> Result<RobotElement, UrdfError> {
    Ok(read_with(text, |_| Ok(()))?.0)
}

/// Reads the robot, and one value of each link by `of_link`, in the order of the links.
pub(super) fn read_with<S>(
    text: &str,
    of_link: impl Fn(&Element<'_>) -> Result<S, UrdfError>,
) -> Result<(RobotElement, Vec<S>), UrdfError> {
    guard(text)?;
    let (declared, prefixes) = with_declared_prefixes(text);
    let document = Document::parse(&declared).map_err(|e| malformed(&e))?;
    let text = declared.as_ref();
    let robot = document.root_element();
    let lines = Lines::of(text);
    expect_urdf(robot, &lines)?;
    let links = children(robot, "link", &lines).map(|element| element.link()).collect::<Result<_, _>>()?;
    let joints = children(robot, "joint", &lines).map(|element| element.joint()).collect::<Result<_, _>>()?;
    let of_links =
        children(robot, "link", &lines).map(|element| of_link(&element)).collect::<Result<_, _>>()?;
    let name = robot.attribute("name").unwrap_or_default().to_owned();
    let line = Some(lines.line(robot));
    let undeclared = |prefix| UrdfWarning::at(line, UrdfWarningKind::UndeclaredPrefix { prefix });
    let warnings = prefixes.into_iter().map(undeclared).collect();
    Ok((RobotElement { line, name, links, joints, warnings }, of_links))
}

/// Returns the text with the prefixes declared that it does not declare itself, but for that of xacro, and these prefixes. Lines
/// stay the same.
fn with_declared_prefixes(text: &str) -> (Cow<'_, str>, Vec<String>) {
    const MOST_PREFIXES: usize = 16;
    let (mut declared, mut prefixes) = (Cow::Borrowed(text), Vec::new());
    while prefixes.len() < MOST_PREFIXES {
        let Err(roxmltree::Error::UnknownNamespace(prefix, _)) = Document::parse(&declared) else { break };
        let root = declared.find("<robot").map(|at| at + "<robot".len());
        let Some(at) = root.filter(|_| prefix != "xacro" && !prefixes.contains(&prefix)) else { break };
        let mut text = declared.into_owned();
        text.insert_str(at, &format!(" xmlns:{prefix}=\"undeclared:{prefix}\""));
        declared = Cow::Owned(text);
        prefixes.push(prefix);
    }
    (declared, prefixes)
}

/// Refuses texts that are unsafe for an XML reader, in one pass without recursion.
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
            // The markup has no end: the XML reader stops here too and reports it.
            None => return Ok(()),
        }
    }
    Ok(())
}

/// End, nesting and number of attributes of a tag.
struct Tag {
    /// Index of the final `>`; `None` if it is missing.
    end: Option<usize>,
    attributes: usize,
    /// 1 for an opening tag, −1 for a closing tag, 0 for a self-closing tag.
    nests: isize,
}

impl Tag {
    /// Scans the tag at the beginning of `text`, skipping quoted text.
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

/// Node of the document, with both lifetimes of roxmltree merged.
pub(super) type Node<'a> = roxmltree::Node<'a, 'a>;

/// Byte index of the start of each line except the first.
pub(super) struct Lines(Vec<usize>);

impl Lines {
    fn of(text: &str) -> Self {
        Self(text.match_indices('\n').map(|(i, _)| i + 1).collect())
    }

    /// Returns the line on which a node begins, from 1.
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
    // An expanded file often still declares `xmlns:xacro` without using it.
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

/// Returns all children of the robot with tag `tag`.
fn children<'a>(robot: Node<'a>, tag: &'static str, lines: &'a Lines) -> impl Iterator<Item = Element<'a>> {
    robot.children().filter(move |node| node.has_tag_name(tag)).map(move |node| {
        let name = node.attribute("name").unwrap_or_default().trim();
        Element { node, name, words: format!("{tag} '{name}'"), lines }
    })
}

/// A `<link>` or `<joint>` element. The nodes passed to its functions are descendants of this element.
pub(super) struct Element<'a> {
    pub node: Node<'a>,
    name: &'a str,
    /// Description of the element in errors: `joint 'elbow'`.
    pub words: String,
    lines: &'a Lines,
}

impl<'a> Element<'a> {
    fn link(&self) -> Result<LinkElement, UrdfError> {
        let inertial = self.child(self.node, "inertial")?;
        let inertial = inertial.map(|node| self.inertial(node)).transpose()?;
        Ok(LinkElement { line: self.line(self.node), name: self.name.to_owned(), inertial })
    }

    fn inertial(&self, inertial: Node<'a>) -> Result<InertialElement, UrdfError> {
        const MASS: &str = "write <mass value=\"...\"/> (kg)";
        const INERTIA: &str = "<inertia> has six: ixx ixy ixz iyy iyz izz (kg m²)";
        let origin = self.origin(inertial)?;
        let mass = self.required(inertial, "mass", MASS)?;
        let mass_kg = self.number(mass, "value", MASS)?;
        let inertia = self.required(inertial, "inertia", INERTIA)?;
        let mut moments = [0.0; 6];
        for (moment, attribute) in moments.iter_mut().zip(MOMENTS) {
            *moment = self.number(inertia, attribute, INERTIA)?;
        }
        let (mass_line, inertia_line) = (self.line(mass), self.line(inertia));
        Ok(InertialElement { origin, mass_line, mass_kg, inertia_line, moments })
    }

    fn joint(&self) -> Result<JointElement, UrdfError> {
        const TYPE: &str = "give type=\"...\": revolute, continuous, prismatic or fixed";
        let line = self.line(self.node);
        let kind = joint_kind(&self.words, line, self.attribute(self.node, "type", TYPE)?)?;
        // Axis, limits, friction and mimic rule have no meaning for a fixed joint and are ignored.
        let (axis, limit, dynamics, mimic) = match kind {
            None => (None, None, DynamicsElement::default(), None),
            Some(kind) => (self.axis()?, self.limit(kind)?, self.dynamics()?, self.mimic()?),
        };
        Ok(JointElement {
            line,
            name: self.name.to_owned(),
            kind,
            parent: self.linked("parent", "write <parent link=\"...\"/>")?,
            child: self.linked("child", "write <child link=\"...\"/>")?,
            origin: self.origin(self.node)?,
            axis,
            limit,
            dynamics,
            mimic,
        })
    }

    /// Returns the `<dynamics>` of the joint.
    fn dynamics(&self) -> Result<DynamicsElement, UrdfError> {
        const DYNAMICS: &str = "write <dynamics damping=\"...\" friction=\"...\"/>";
        let Some(node) = self.child(self.node, "dynamics")? else {
            return Ok(DynamicsElement::default());
        };
        let number = |attribute| {
            node.has_attribute(attribute).then(|| self.number(node, attribute, DYNAMICS)).transpose()
        };
        Ok(DynamicsElement {
            line: self.line(node),
            damping: number("damping")?,
            friction: number("friction")?,
        })
    }

    /// Returns the `<mimic>` of the joint, if there is one. The default ratio is 1, the default offset 0.
    fn mimic(&self) -> Result<Option<MimicElement>, UrdfError> {
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
        Ok(Some(MimicElement { line: self.line(node), leader, ratio, offset }))
    }

    /// Returns the name of the link in the `<parent>` or `<child>` of the joint.
    fn linked(&self, tag: &'static str, remedy: &'static str) -> Result<String, UrdfError> {
        let node = self.required(self.node, tag, remedy)?;
        Ok(self.attribute(node, "link", remedy)?.to_owned())
    }

    fn axis(&self) -> Result<Option<AxisElement>, UrdfError> {
        let Some(node) = self.child(self.node, "axis")? else {
            return Ok(None);
        };
        self.attribute(node, "xyz", "give a direction, e.g. xyz=\"0 0 1\"")?;
        Ok(Some(AxisElement { line: self.line(node), xyz: self.vector(node, "xyz")? }))
    }

    fn limit(&self, kind: JointKind) -> Result<Option<LimitElement>, UrdfError> {
        let Some(node) = self.child(self.node, "limit")? else {
            return Ok(None);
        };
        let position = match kind {
            JointKind::Continuous => [Limits::NONE.lower, Limits::NONE.upper],
            _ => [self.number(node, "lower", LIMIT)?, self.number(node, "upper", LIMIT)?],
        };
        let magnitude =
            |limit| node.has_attribute(limit).then(|| self.number(node, limit, LIMIT)).transpose();
        let (velocity, effort) = (magnitude("velocity")?, magnitude("effort")?);
        Ok(Some(LimitElement { line: self.line(node), position, velocity, effort }))
    }

    /// Returns the `<origin>` of a joint, an inertia or a shape.
    pub fn origin(&self, parent: Node<'a>) -> Result<OriginElement, UrdfError> {
        let Some(node) = self.child(parent, "origin")? else {
            return Ok(OriginElement::default());
        };
        if node.has_attribute("quat_xyzw") {
            let kind = UrdfErrorKind::Unsupported {
                element: self.words.clone(),
                attribute: "<origin quat_xyzw>",
                remedy: "give the rotation as rpy=\"roll pitch yaw\" (rad)",
            };
            return Err(self.error(node, kind));
        }
        let (rpy_rad, xyz_m) = (self.vector(node, "rpy")?, self.vector(node, "xyz")?);
        Ok(OriginElement { line: self.line(node), xyz_m, rpy_rad })
    }

    /// Returns the child of `parent` with tag `tag`, if there is one. More than one child is an error.
    pub fn child(&self, parent: Node<'a>, tag: &'static str) -> Result<Option<Node<'a>>, UrdfError> {
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

    pub fn required(
        &self,
        parent: Node<'a>,
        tag: &'static str,
        remedy: &'static str,
    ) -> Result<Node<'a>, UrdfError> {
        self.child(parent, tag)?.ok_or_else(|| self.missing(parent, format!("<{tag}>"), remedy))
    }

    pub fn attribute(
        &self,
        node: Node<'a>,
        attribute: &str,
        remedy: &'static str,
    ) -> Result<&'a str, UrdfError> {
        let value = node.attribute(attribute).map(str::trim);
        value.ok_or_else(|| self.missing(node, place(node, attribute), remedy))
    }

    pub fn number(&self, node: Node<'a>, attribute: &str, remedy: &'static str) -> Result<f64, UrdfError> {
        let value = self.attribute(node, attribute, remedy)?;
        finite(value).ok_or_else(|| self.bad_number(node, attribute, value, ONE_NUMBER))
    }

    /// Returns the three numbers of an attribute; zeros if it is missing.
    pub fn vector(&self, node: Node<'a>, attribute: &str) -> Result<[f64; 3], UrdfError> {
        let Some(value) = node.attribute(attribute) else {
            return Ok([0.0; 3]);
        };
        let numbers: Option<Vec<f64>> = value.split_whitespace().map(finite).collect();
        match numbers.as_deref() {
            Some(&[x, y, z]) => Ok([x, y, z]),
            _ => Err(self.bad_number(node, attribute, value, THREE_NUMBERS)),
        }
    }

    pub fn bad_number(
        &self,
        node: Node<'a>,
        attribute: &str,
        value: &str,
        wanted: &'static str,
    ) -> UrdfError {
        let (element, place) = (self.words.clone(), place(node, attribute));
        self.error(node, UrdfErrorKind::BadNumber { element, place, value: value.to_owned(), wanted })
    }

    pub fn missing(&self, node: Node<'a>, missing: String, remedy: &'static str) -> UrdfError {
        self.error(node, UrdfErrorKind::Missing { element: self.words.clone(), missing, remedy })
    }

    fn error(&self, node: Node<'a>, kind: UrdfErrorKind) -> UrdfError {
        UrdfError::at(self.line(node), kind)
    }

    fn line(&self, node: Node<'a>) -> Line {
        Some(self.lines.line(node))
    }
}

fn place(node: Node<'_>, attribute: &str) -> String {
    format!("<{} {attribute}>", node.tag_name().name())
}

fn finite(text: &str) -> Option<f64> {
    text.parse().ok().filter(|x: &f64| x.is_finite())
}

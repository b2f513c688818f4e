//! Templates of common arms: the values of their drives, with sources, for a URDF of the user.
//!
//! A template is a robot.toml without a URDF and without servos, with a table `[template]` about it. Its joints have numbers
//! in place of names. Servos follow from the bandwidth of the template and the inertias of the URDF.

use crate::files::source::{FileError, Source, parse};
use crate::setup::tip::tip;
use crate::suggest::choices;
use nalgebra::Vector3;
use opspace_model::{JointKind, Model};
use serde::Deserialize;
use std::fmt::Write as _;
use toml_edit::{Array, DocumentMut, Item, Key, Value};

/// Name and text of each template.
const TEMPLATES: [(&str, &str); 7] = [
    ("ur3", include_str!("arm_templates/ur3.toml")),
    ("ur5", include_str!("arm_templates/ur5.toml")),
    ("ur10", include_str!("arm_templates/ur10.toml")),
    ("xarm7", include_str!("arm_templates/xarm7.toml")),
    ("panda", include_str!("arm_templates/panda.toml")),
    ("so101", include_str!("arm_templates/so101.toml")),
    ("j2s6s200", include_str!("arm_templates/j2s6s200.toml")),
];

/// Largest difference of the distances of axes from those of the template, as a fraction.
const LENGTH_TOLERANCE: f64 = 0.1;

/// Values of a common arm.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct ArmTemplate {
    /// Name on the command line.
    pub name: &'static str,
    /// Manufacturer and type.
    pub about: String,
    /// Names of the joints in the URDF of the manufacturer, from the base to the tip.
    pub joints: Vec<String>,
    /// Sum of the distances between the axes of successive joints, m.
    pub axis_distances_m: f64,
    /// Bandwidth of the velocity loops, Hz.
    pub velocity_loop_hz: f64,
    /// Gain of the position loops, 1/s.
    pub position_loop_per_s: f64,
    /// Filter of the velocity in the servos, Hz.
    pub velocity_filter_hz: f64,
    /// Keys whose values are assumed, with numbers in place of names of joints.
    assumed: Vec<String>,
    /// Text without the table `[template]`.
    values: DocumentMut,
}

#[derive(Deserialize)]
struct Head {
    template: About,
}

#[derive(Deserialize)]
struct About {
    about: String,
    joints: Vec<String>,
    axis_distances_m: f64,
    velocity_loop_hz: f64,
    position_loop_per_s: f64,
    velocity_filter_hz: f64,
    assumed: Vec<String>,
}

impl ArmTemplate {
    /// Returns all templates.
    ///
    /// # Errors
    /// A mistake in a template of this crate.
    pub fn all() -> Result<Vec<Self>, FileError> {
        TEMPLATES.into_iter().map(|(name, text)| Self::read(name, text)).collect()
    }

    /// Returns the template of this name.
    ///
    /// # Errors
    /// An unknown name; the error lists those that there are.
    pub fn named(name: &str) -> Result<Self, FileError> {
        match TEMPLATES.into_iter().find(|(known, _)| *known == name) {
            Some((name, text)) => Self::read(name, text),
            None => {
                let help = choices(name, TEMPLATES.map(|(name, _)| name));
                Err(FileError::of_file("--like", format!("there is no template '{name}'"), Some(help)))
            }
        }
    }

    fn read(name: &'static str, text: &str) -> Result<Self, FileError> {
        let source = Source::new(format!("template {name}"), text);
        let About {
            about,
            joints,
            axis_distances_m,
            velocity_loop_hz,
            position_loop_per_s,
            velocity_filter_hz,
            assumed,
        } = parse::<Head>(&source)?.template;
        let mut values: DocumentMut = text.parse().map_err(|error: toml_edit::TomlError| {
            FileError::of_file(source.name(), error.to_string(), None)
        })?;
        values.remove("template");
        Ok(Self {
            name,
            about,
            joints,
            axis_distances_m,
            velocity_loop_hz,
            position_loop_per_s,
            velocity_filter_hz,
            assumed,
            values,
        })
    }

    /// Returns the template of the arm that a URDF has, if there is one: first of the same names of joints, or else of the same
    /// number of joints and distances of axes.
    ///
    /// # Errors
    /// A mistake in a template of this crate.
    pub fn fitting(urdf: &Source, model: &Model) -> Result<Option<Self>, FileError> {
        let mut all: Vec<Self> = Self::all()?;
        all.retain(|template| template.joints_in(urdf, model).is_ok());
        let is_named = |template: &Self| template.joints.iter().all(|name| model.joint(name).is_ok());
        let named = all.iter().position(is_named).unwrap_or(0);
        Ok(all.into_iter().nth(named))
    }

    /// Returns the names of the joints of a robot that are those of the template, in its order: the joints of the same names,
    /// or else those from the base to the tip.
    ///
    /// # Errors
    /// A robot that is not the arm of the template; the error names both.
    pub fn joints_in(&self, urdf: &Source, model: &Model) -> Result<Vec<String>, FileError> {
        let wrong = |message: String, help: &str| {
            Err(FileError::of_file(urdf.name(), message, Some(help.to_owned())))
        };
        let chain = self.chain(model);
        let names = || chain.iter().map(|&body| joint_name(model, body));
        if chain.len() != self.joints.len() {
            let message = format!(
                "template '{}' is for an arm of {} joints in a chain ({}); the chain of this URDF has {}: {}",
                self.name,
                self.joints.len(),
                self.joints.join(", "),
                chain.len(),
                names().collect::<Vec<_>>().join(", ")
            );
            return wrong(
                message,
                "choose the arm by --from LINK and --to LINK, or use --assume for another arm",
            );
        }
        if let Some(&slides) = chain.iter().find(|body| model.bodies()[**body].kind == JointKind::Prismatic) {
            let message = format!(
                "template '{}' is for rotating joints; joint '{}' is prismatic",
                self.name,
                joint_name(model, slides)
            );
            return wrong(message, "use --assume for another arm");
        }
        let distances_m = axis_distances_m(model, &chain);
        if (distances_m - self.axis_distances_m).abs() > LENGTH_TOLERANCE * self.axis_distances_m {
            let message = format!(
                "template '{}' is for an arm whose successive axes are {} m apart in all; those of this URDF are {distances_m:.3} m \
                 apart",
                self.name, self.axis_distances_m
            );
            let help = match self.closest(distances_m)? {
                Some(name) => format!("template '{name}' fits, or use --assume for another arm"),
                None => "use --assume for another arm".to_owned(),
            };
            return wrong(message, &help);
        }
        Ok(names().map(str::to_owned).collect())
    }

    /// Bodies of the joints with the names of the template, or else those from the base to the tip.
    fn chain(&self, model: &Model) -> Vec<usize> {
        let body_of = |name: &String| {
            let joint = model.joint(name).ok()?;
            model.bodies().iter().position(|body| body.joint == joint && !body.follows)
        };
        let named: Option<Vec<usize>> = self.joints.iter().map(body_of).collect();
        named.unwrap_or_else(|| {
            let mut bodies: Vec<usize> =
                tip(model).map_or_else(Vec::new, |frame| model.ancestors(frame).collect());
            bodies.sort_unstable();
            bodies
        })
    }

    /// Name of another template with the same number of joints and these distances of axes.
    fn closest(&self, distances_m: f64) -> Result<Option<&'static str>, FileError> {
        let fits = |other: &Self| {
            other.joints.len() == self.joints.len()
                && (distances_m - other.axis_distances_m).abs() <= LENGTH_TOLERANCE * other.axis_distances_m
        };
        Ok(Self::all()?.into_iter().find(fits).map(|other| other.name))
    }

    /// Returns a robot.toml: `head`, then the values of the template for the joints with these names (n), and servos with these
    /// gains of the velocity loops (n; Nms/rad).
    #[must_use]
    pub fn robot_toml(&self, head: &str, joints: &[String], kv: &[f64]) -> String {
        let mut values = self.values.clone();
        name_joints(&mut values, joints);
        let assumed: Vec<String> = self.assumed.iter().map(|key| named_key(key, joints)).collect();
        let lines: String =
            assumed.iter().map(|key| format!("    {},\n", Value::from(key.as_str()))).collect();
        format!(
            "#:schema robot.schema.json\n\
             # {}: template '{}' of opspace. Public values [P] and assumed values [A]. Nothing here was measured on a real arm.\n\
             {head}\n\
             # Keys whose values are assumed; every table and page lists them. Remove an entry when you have replaced its value by\n\
             # one that you know: see `opspace identify` and data sheets.\n\
             assumed = [\n{lines}]\n\n{}{}",
            self.about,
            self.name,
            values.to_string().trim_start(),
            self.servos(joints, kv)
        )
    }

    /// Tables of the servos.
    fn servos(&self, joints: &[String], kv: &[f64]) -> String {
        let profile = self.profile();
        let (loop_hz, filter) = (self.velocity_loop_hz, self.velocity_filter_hz);
        let mut text = format!(
            "\n# [A] velocity loops of {loop_hz} Hz for the inertia of each joint at the start of first-task.toml, with its rotor"
        );
        if self.is_velocity_robot() {
            let _ = write!(text, ".\n[profile.{profile}.velocity_servo]\n");
            for (joint, kv) in joints.iter().zip(kv) {
                let name = Key::new(joint);
                let _ =
                    writeln!(text, "{name} = {{ kv_nms_per_rad = {kv:?}, velocity_filter_hz = {filter:?} }}");
            }
            return text;
        }
        let kp = self.position_loop_per_s;
        let _ = write!(
            text,
            "; position\n# loops of {kp} 1/s.\n[profile.{profile}.servo]\n\
             joint_defaults = {{ cascaded = {{ kp_per_s = {kp:?}, velocity_filter_hz = {filter:?} }} }}\n"
        );
        for (joint, kv) in joints.iter().zip(kv) {
            let _ = writeln!(text, "{} = {{ cascaded = {{ kv_nms_per_rad = {kv:?} }} }}", Key::new(joint));
        }
        text
    }

    /// Name of the profile.
    fn profile(&self) -> Key {
        let profiles = self.values.get("profile").and_then(Item::as_table_like);
        let name = profiles.and_then(|profiles| profiles.iter().next()).map_or("default", |(name, _)| name);
        Key::new(name)
    }

    fn is_velocity_robot(&self) -> bool {
        let interface = self.values.get("interface").and_then(|interface| interface.get("command"));
        interface.and_then(Item::as_str) == Some("velocity")
    }
}

fn joint_name(model: &Model, body: usize) -> &str {
    &model.joints()[model.bodies()[body].joint].name
}

/// Sum of the distances between the axes of successive joints, m: independent of the posture, and of the place of the
/// frames along the axes.
fn axis_distances_m(model: &Model, chain: &[usize]) -> f64 {
    let distance = |pair: &[usize]| {
        // The axis of each body is z of its frame.
        let placement = chain_placement(model, pair[0], pair[1]);
        let (point, axis) = (placement.translation, placement.rotation * Vector3::z());
        let normal = Vector3::z().cross(&axis);
        match normal.norm() {
            parallel if parallel < 1e-3 => point.xy().norm(),
            length => (point.dot(&normal) / length).abs(),
        }
    };
    chain.windows(2).map(distance).sum()
}

/// Pose of a body in the frame of an ancestor, at joint positions of zero.
fn chain_placement(model: &Model, ancestor: usize, body: usize) -> opspace_model::Placement {
    let mut placement = model.bodies()[body].origin;
    let mut parent = model.bodies()[body].parent;
    while let Some(above) = parent.filter(|&above| above != ancestor) {
        placement = model.bodies()[above].origin * placement;
        parent = model.bodies()[above].parent;
    }
    placement
}

/// Replaces the numbers of joints by their names: keys of `[joint]`, and the lists of groups.
fn name_joints(values: &mut DocumentMut, joints: &[String]) {
    if let Some(groups) = values.get_mut("group").and_then(Item::as_table_like_mut) {
        for (_, group) in groups.iter_mut() {
            let Some(list) = group.get_mut("joints").and_then(Item::as_array_mut) else { continue };
            let numbers = list.iter().filter_map(Value::as_integer);
            let named = numbers.filter_map(|number| name_of(number, joints)).collect::<Array>();
            *list = named;
        }
    }
    if let Some(tables) = values.get_mut("joint").and_then(Item::as_table_like_mut) {
        let numbered: Vec<(&String, Item)> = (joints.iter().enumerate())
            .filter_map(|(i, name)| Some((name, tables.remove(&(i + 1).to_string())?)))
            .collect();
        for (name, table) in numbered {
            tables.insert(name, table);
        }
    }
}

/// Key of robot.toml, with the name of a joint in place of its number.
fn named_key(key: &str, joints: &[String]) -> String {
    let name = |number: &str| Some(Key::new(name_of(number.parse().ok()?, joints)?).to_string());
    match key.split('.').collect::<Vec<_>>().as_slice() {
        ["joint", number, rest @ ..] => {
            let name = name(number).unwrap_or_else(|| (*number).to_owned());
            format!("joint.{name}.{}", rest.join("."))
        }
        _ => key.to_owned(),
    }
}

fn name_of(number: i64, joints: &[String]) -> Option<&str> {
    let index = usize::try_from(number).ok()?.checked_sub(1)?;
    joints.get(index).map(String::as_str)
}

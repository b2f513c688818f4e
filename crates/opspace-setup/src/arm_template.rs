//! Templates of common arms: the values of their drives, with sources, for a URDF of the user.
//!
//! A template is a robot.toml without a URDF, with a table `[template]` about it. Its joints have numbers in place of names. It
//! states its servos, or the bandwidth of their loops, from which they follow with the inertias of the URDF. A template of a robot
//! of this repository consists of what differs from the robot.toml of that robot.

use crate::arm_shape::ArmShape;
use crate::assumed_drives::{VELOCITY_LOOP_HZ, rounded};
use crate::robot_template::{NewRobot, assumed_links, link_tables};
use opspace_backend::CommandKind;
use opspace_experiment::files::source::{FileError, Source, parse};
use opspace_experiment::postures::tip::tip;
use opspace_experiment::suggest::choices;
use opspace_model::{JointKind, Model};
use serde::Deserialize;
use std::fmt::Write as _;
use toml_edit::{Array, DocumentMut, Item, Key, Table, Value};

/// Name and text of each template.
const TEMPLATES: [(&str, &str); 16] = [
    ("ur3", include_str!("arm_templates/ur3.toml")),
    ("ur5", include_str!("arm_templates/ur5.toml")),
    ("ur10", include_str!("arm_templates/ur10.toml")),
    ("ur3e", include_str!("arm_templates/ur3e.toml")),
    ("ur5e", include_str!("arm_templates/ur5e.toml")),
    ("ur10e", include_str!("arm_templates/ur10e.toml")),
    ("xarm6", include_str!("arm_templates/xarm6.toml")),
    ("xarm7", include_str!("arm_templates/xarm7.toml")),
    ("panda", include_str!("arm_templates/panda.toml")),
    ("fr3", include_str!("arm_templates/fr3.toml")),
    ("gen3", include_str!("arm_templates/gen3.toml")),
    ("j2s6s200", include_str!("arm_templates/j2s6s200.toml")),
    ("so101", include_str!("arm_templates/so101.toml")),
    ("so101-12v", include_str!("arm_templates/so101-12v.toml")),
    ("vx300s", include_str!("arm_templates/vx300s.toml")),
    ("asimo-arm", include_str!("arm_templates/asimo-arm.toml")),
];

/// Name and text of the robots of this repository that are templates.
const BASES: [(&str, &str); 3] = [
    ("robots/panda", include_str!("../embedded/robots/panda/robot.toml")),
    ("robots/ur5e", include_str!("../embedded/robots/ur5e/robot.toml")),
    ("robots/asimo-arm", include_str!("../embedded/robots/asimo-arm/robot.toml")),
];

/// Tables and keys of a robot.toml that are about its own URDF.
const OF_THE_URDF: [&str; 4] = ["template", "urdf", "collision", "tool"];

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
    /// Shape of the arm.
    pub shape: ArmShape,
    /// Loops of the servos; `None` if the template states the servos themselves.
    pub loops: Option<ServoLoops>,
    /// Keys whose values are assumed, with numbers in place of names of joints; `*` for each of them.
    assumed: Vec<String>,
    /// Text without the table `[template]`.
    values: DocumentMut,
}

/// Bandwidths from which the gains of the servos follow.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct ServoLoops {
    /// Bandwidth of the velocity loops, Hz.
    pub velocity_loop_hz: f64,
    /// Gain of the position loops, 1/s.
    pub position_loop_per_s: f64,
    /// Filter of the velocity in the servos, Hz.
    pub velocity_filter_hz: f64,
}

#[derive(Deserialize)]
struct Head {
    template: About,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct About {
    about: String,
    joints: Vec<String>,
    based_on: Option<String>,
    loops: Option<ServoLoops>,
    assumed: Vec<String>,
    shape: ArmShape,
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
        let About { about, joints, based_on, loops, assumed, shape } = parse::<Head>(&source)?.template;
        let own = document(&source)?;
        let mut values = match based_on {
            None => own,
            Some(base) => {
                let text = BASES.iter().find(|(known, _)| *known == base).map_or("", |(_, text)| text);
                let mut values = document(&Source::new(base, text))?;
                let names: Vec<String> = values
                    .get("joint")
                    .and_then(Item::as_table)
                    .into_iter()
                    .flatten()
                    .map(|(name, _)| name.to_owned())
                    .collect();
                rename_joints(&mut values, &names, &numbers(names.len()));
                merge(values.as_table_mut(), own.as_table());
                values
            }
        };
        for key in OF_THE_URDF {
            values.remove(key);
        }
        Ok(Self { name, about, joints, shape, loops, assumed, values })
    }

    /// Returns the templates of the arm that a URDF has, the most alike first: those whose shape it has and, of these, those with its
    /// names of joints, or else with the most similar ranges. Empty if there is none.
    ///
    /// # Errors
    /// A mistake in a template of this crate.
    pub fn fitting(urdf: &Source, model: &Model) -> Result<Vec<Self>, FileError> {
        let mut fitting: Vec<(bool, f64, Self)> = Vec::new();
        for template in Self::all()? {
            let chain = template.chain(model);
            if template.differences(urdf, model, &chain).is_empty() {
                let apart = template.shape.range_difference_rad(&ArmShape::of(urdf, model, &chain));
                fitting.push((!template.has_names_of(model), apart, template));
            }
        }
        fitting.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let best = fitting.first().map(|(other_names, apart, _)| (*other_names, *apart));
        fitting.retain(|(other_names, apart, _)| Some((*other_names, *apart)) == best);
        Ok(fitting.into_iter().map(|(.., template)| template).collect())
    }

    /// True if a robot has joints of all names of the template.
    #[must_use]
    pub fn has_names_of(&self, model: &Model) -> bool {
        self.joints.iter().all(|name| model.joint(name).is_ok())
    }

    /// Returns the names of the joints of a robot that are those of the template, in its order: the joints of the same names,
    /// or else those from the base to the tip.
    ///
    /// # Errors
    /// A robot that is not the arm of the template; the error lists what differs.
    pub fn joints_in(&self, urdf: &Source, model: &Model) -> Result<Vec<String>, FileError> {
        let chain = self.chain(model);
        let mut differences = self.differences(urdf, model, &chain);
        let fitting = Self::fitting(urdf, model)?;
        let other = fitting.iter().find(|other| other.name != self.name);
        // FR3 and Panda have the same lengths: of two templates that fit, names of joints decide.
        if let Some(other) = other.filter(|other| other.has_names_of(model) && !self.has_names_of(model)) {
            differences.push(format!("the joints have the names of '{}'", other.name));
        }
        if differences.is_empty() {
            return Ok(names(model, &chain).into_iter().map(str::to_owned).collect());
        }
        let (name, about) = (self.name, &self.about);
        let message =
            format!("this is not the arm of template '{name}' ({about}): {}", differences.join("; "));
        let help = match other {
            Some(other) => format!("template '{}' ({}) fits", other.name, other.about),
            None if differences.len() == 1 && chain.len() != self.joints.len() => {
                "choose the arm by --from LINK and --to LINK, or use --assume for another arm".to_owned()
            }
            None => format!(
                "use --assume for another arm, or `--like-anyway {name}`, which takes the interface and the rates only"
            ),
        };
        Err(FileError::of_file(urdf.name(), message, Some(help)))
    }

    /// Differences of a chain of joints from those of the template.
    fn differences(&self, urdf: &Source, model: &Model, chain: &[usize]) -> Vec<String> {
        let names = names(model, chain);
        let slides = |body: &&usize| model.bodies()[**body].kind == JointKind::Prismatic;
        if let Some(&body) = chain.iter().find(slides).filter(|_| chain.len() == self.joints.len()) {
            return vec![format!("joint '{}' is prismatic, not rotating", joint_name(model, body))];
        }
        self.shape.differences(&ArmShape::of(urdf, model, chain), &names)
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

    /// Returns the robot.toml of a robot: its part of the URDF, the values of the template for the joints with these names (n) and
    /// sensors at the frame `tip`, and its assumed bodies. Without servos of its own, the template gets some with velocity loops of these gains (n; Nms/rad).
    #[must_use]
    pub fn robot_toml(&self, robot: &NewRobot<'_>, joints: &[String], tip: &str, kv: &[f64]) -> String {
        let mut values = self.values.clone();
        rename_joints(&mut values, &numbers(joints.len()), joints);
        place_sensors(&mut values, tip);
        let assumed =
            self.assumed.iter().flat_map(|key| named_keys(key, joints)).chain(assumed_links(robot.bodies));
        let lines: String = assumed.map(|key| format!("    {},\n", Value::from(key.as_str()))).collect();
        let servos = self.loops.map(|loops| {
            let measures = "the inertia of each joint at the start of first-task.toml, with its rotor";
            loops.servos(&self.profile(), self.command(), measures, joints.iter().zip(kv.iter().copied()))
        });
        format!(
            "#:schema robot.schema.json\n\
             # {}: template '{}' of opspace. Public values [P] and assumed values [A]. Nothing here was measured on a real arm.\n\
             {}\n\
             # Keys whose values are assumed; every table and page lists them. Remove an entry when you have replaced its value by\n\
             # one that you know: see `opspace identify` and data sheets.\n\
             assumed = [\n{lines}]\n\n{}{}{}",
            self.about,
            self.name,
            robot.head(),
            values.to_string().trim_start(),
            servos.unwrap_or_default(),
            link_tables(robot.bodies)
        )
    }

    /// Returns a robot.toml of assumed values with the interface and the rates of this template in place of assumed ones: another arm
    /// may share these. They remain assumed.
    #[must_use]
    pub fn with_interface(&self, assumed_toml: &str) -> String {
        let Ok(mut robot) = assumed_toml.parse::<DocumentMut>() else { return assumed_toml.to_owned() };
        let Self { name, about, .. } = self;
        let from = format!("[A] as of another arm, {about} (template '{name}' of opspace)");
        if let Some(mut interface) = self.values.get("interface").and_then(Item::as_table).cloned() {
            interface.decor_mut().set_prefix(format!("\n# {from}.\n"));
            for (mut key, value) in interface.iter_mut() {
                key.leaf_decor_mut().set_prefix("");
                if let Some(value) = value.as_value_mut() {
                    value.decor_mut().set_suffix("");
                }
            }
            robot.insert("interface", Item::Table(interface));
        }
        let rates = self.values.get("profile").and_then(|profiles| profiles.get(self.profile()));
        let profile = robot.get_mut("profile").and_then(|profiles| profiles.get_mut("default"));
        let Some(profile) = profile.and_then(Item::as_table_mut) else { return robot.to_string() };
        profile.decor_mut().set_prefix(format!("\n# {from}.\n"));
        for key in ["servo_hz", "servo_ticks_per_cycle", "delay_servo_ticks", "estimator"] {
            if let Some(rate) = rates.and_then(|rates| rates.get(key)) {
                profile.insert(key, rate.clone());
            }
        }
        let Some(loops) = self.loops else { return robot.to_string() };
        let mut servos = Vec::new();
        if let Some(table) = profile.remove("servo").as_ref().and_then(Item::as_table) {
            for (joint, servo) in table {
                let kv = servo.get("cascaded").and_then(|cascade| cascade.get("kv_nms_per_rad"));
                if let Some(kv) = kv.and_then(Item::as_float) {
                    servos.push((joint.to_owned(), rounded(kv * loops.velocity_loop_hz / VELOCITY_LOOP_HZ)));
                }
            }
        }
        let measures = format!("the inertia of each joint, as of {about}");
        let servos = servos.iter().map(|(joint, kv)| (joint, *kv));
        format!("{}{}", robot, loops.servos("default", self.command(), &measures, servos))
    }

    /// Commands that the robot accepts.
    #[must_use]
    pub fn command(&self) -> CommandKind {
        let command = self.values.get("interface").and_then(|interface| interface.get("command"));
        match command.and_then(Item::as_str) {
            Some("velocity") => CommandKind::Velocity,
            Some("torque") => CommandKind::Torque,
            _ => CommandKind::Position,
        }
    }

    /// Name of the default profile.
    fn profile(&self) -> String {
        let stated = self.values.get("default_profile").and_then(Item::as_str);
        let profiles = self.values.get("profile").and_then(Item::as_table_like);
        let first = profiles.and_then(|profiles| profiles.iter().next()).map(|(name, _)| name);
        stated.or(first).unwrap_or("default").to_owned()
    }
}

impl ServoLoops {
    /// Tables of the servos of a profile, with the gains of the velocity loops of each joint (Nms/rad). `measures` says from what
    /// they follow.
    fn servos<'a>(
        self,
        profile: &str,
        command: CommandKind,
        measures: &str,
        kv: impl Iterator<Item = (&'a String, f64)>,
    ) -> String {
        let Self { velocity_loop_hz, position_loop_per_s: kp, velocity_filter_hz: filter } = self;
        let profile = Key::new(profile);
        let mut text = format!("\n# [A] velocity loops of {velocity_loop_hz} Hz for {measures}");
        if command == CommandKind::Velocity {
            let _ = write!(text, ".\n[profile.{profile}.velocity_servo]\n");
            for (joint, kv) in kv {
                let name = Key::new(joint);
                let _ =
                    writeln!(text, "{name} = {{ kv_nms_per_rad = {kv:?}, velocity_filter_hz = {filter:?} }}");
            }
            return text;
        }
        let _ = write!(
            text,
            "; position\n# loops of {kp} 1/s.\n[profile.{profile}.servo]\n\
             joint_defaults = {{ cascaded = {{ kp_per_s = {kp:?}, velocity_filter_hz = {filter:?} }} }}\n"
        );
        for (joint, kv) in kv {
            let _ = writeln!(text, "{} = {{ cascaded = {{ kv_nms_per_rad = {kv:?} }} }}", Key::new(joint));
        }
        text
    }
}

fn document(source: &Source) -> Result<DocumentMut, FileError> {
    let parsed = source.text().parse();
    parsed.map_err(|error: toml_edit::TomlError| FileError::of_file(source.name(), error.to_string(), None))
}

/// Numbers of joints, from 1.
fn numbers(joints: usize) -> Vec<String> {
    (1..=joints).map(|number| number.to_string()).collect()
}

fn joint_name(model: &Model, body: usize) -> &str {
    &model.joints()[model.bodies()[body].joint].name
}

fn names<'a>(model: &'a Model, chain: &[usize]) -> Vec<&'a str> {
    chain.iter().map(|&body| joint_name(model, body)).collect()
}

/// Adds the entries of `own` to a table, in place of those of the same keys, with their comments; tables are merged.
fn merge(into: &mut Table, own: &Table) {
    for (key, item) in own {
        match (into.get_mut(key).and_then(Item::as_table_mut), item.as_table()) {
            (Some(into), Some(own)) => merge(into, own),
            _ => {
                let mut item = item.clone();
                // Tables are printed in the order of their positions, which are those of another file.
                if let Some(table) = item.as_table_mut() {
                    table.set_position(None);
                }
                into.insert(key, item);
                if let (Some(mut to), Some(from)) = (into.key_mut(key), own.key(key)) {
                    *to.leaf_decor_mut() = from.leaf_decor().clone();
                }
            }
        }
    }
}

/// Replaces names of joints: keys of the tables of joints, and the lists of groups.
fn rename_joints(values: &mut DocumentMut, from: &[String], to: &[String]) {
    let renamed = |name: &str| from.iter().position(|from| from == name).and_then(|i| to.get(i));
    if let Some(groups) = values.get_mut("group").and_then(Item::as_table_like_mut) {
        for (_, group) in groups.iter_mut() {
            let Some(list) = group.get_mut("joints").and_then(Item::as_array_mut) else { continue };
            let name = |value: &Value| {
                value.as_integer().map_or_else(|| value.as_str().map(str::to_owned), |n| Some(n.to_string()))
            };
            let named = list.iter().filter_map(name).filter_map(|name| renamed(&name).map(String::as_str));
            *list = named.collect::<Array>();
        }
    }
    let rename = |table: &mut Table| {
        let keys: Vec<String> = table.iter().map(|(key, _)| key.to_owned()).collect();
        // All entries are taken out and put back, so that they keep their order.
        for key in keys {
            let Some((old, item)) = table.remove_entry(&key) else { continue };
            let key = renamed(&key).map_or_else(|| old.clone(), Key::new);
            table.insert_formatted(&key.with_leaf_decor(old.leaf_decor().clone()), item);
        }
    };
    let root = values.as_table_mut();
    for path in [&["joint"][..], &["simulated", "servo"], &["simulated", "velocity_servo"]] {
        table_at(root, path).into_iter().for_each(rename);
    }
    let Some(profiles) = table_at(root, &["profile"]) else { return };
    for (_, profile) in profiles.iter_mut() {
        let Some(profile) = profile.as_table_mut() else { continue };
        for path in [&["servo"][..], &["velocity_servo"], &["identified"], &["setpoint_limits", "joint"]] {
            table_at(profile, path).into_iter().for_each(rename);
        }
    }
}

/// Table at a path of tables below another one.
fn table_at<'a>(table: &'a mut Table, path: &[&str]) -> Option<&'a mut Table> {
    path.iter().try_fold(table, |table, key| table.get_mut(key)?.as_table_mut())
}

/// Places the force sensors at a frame: those of the template are at the tip of the arm.
fn place_sensors(values: &mut DocumentMut, tip: &str) {
    for kind in ["force_sensor", "estimated_force"] {
        let Some(sensors) = values.get_mut(kind).and_then(Item::as_table_like_mut) else { continue };
        for (_, sensor) in sensors.iter_mut() {
            sensor["frame"] = toml_edit::value(tip);
        }
    }
}

/// Keys of robot.toml, with the name of a joint in place of its number, and one key for each joint in place of `*`.
fn named_keys(key: &str, joints: &[String]) -> Vec<String> {
    match key.split('.').collect::<Vec<_>>().as_slice() {
        ["joint", number, rest @ ..] => {
            let is_meant = |i: usize| *number == "*" || number.parse() == Ok(i + 1);
            let meant = joints.iter().enumerate().filter(|(i, _)| is_meant(*i));
            meant.map(|(_, name)| format!("joint.{}.{}", Key::new(name), rest.join("."))).collect()
        }
        _ => vec![key.to_owned()],
    }
}

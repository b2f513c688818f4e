//! Values of several joints at once in robot.toml: `[joint_defaults]`, `[group.NAME]`, and what the URDF states.
//!
//! Each value of a joint is that of the first of these that states it: `[joint.NAME]`, the group of the joint,
//! `[joint_defaults]`, the URDF. The same holds for the servos of a profile, whose table has the names of joints and of
//! groups, and `joint_defaults`, as keys. A document is expanded to one with an entry for each joint before it is read;
//! values keep their places in the file.

use crate::files::layered_path::{DEFAULTS, SERVO_TABLES, inner};
use crate::files::source::{FileError, Source, explain};
use crate::files::strict::Strict;
use crate::suggest::{self, choices};
use opspace_model::{JointDynamics, Model};
use opspace_transformer::{JointParameters, ServoParameters, VelocityServo};
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use toml::Spanned;
use toml::de::{DeTable, DeValue};
use toml_edit::Key;

/// Tables of a joint whose values are merged one by one.
const INNER_TABLES: [&str; 2] = ["rotor", "friction"];

/// Groups of joints, by name; each joint is in one group at most.
pub(crate) type Groups = BTreeMap<String, Vec<String>>;

/// A value of a joint that its URDF states and the robot file does not.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct UrdfValue {
    /// Name of the joint.
    pub joint: String,
    /// Key of the value in the table of a joint: `torque_limit_nm`, `friction.coulomb_nm`.
    pub key: &'static str,
    /// Attribute of the URDF: `effort`.
    pub attribute: &'static str,
    /// Value, in the unit of the key.
    pub value: f64,
}

/// Returns the values of the drives that a URDF states: torque limits and friction.
pub fn urdf_values(model: &Model, dynamics: &[JointDynamics]) -> Vec<UrdfValue> {
    let mut values = Vec::new();
    for (joint, dynamics) in model.joints().iter().zip(dynamics) {
        let effort = Some(joint.limits.effort).filter(|effort| *effort > 0.0 && *effort <= LARGEST_EFFORT);
        for (key, attribute, value) in [
            ("torque_limit_nm", "effort", effort),
            ("friction.coulomb_nm", "friction", dynamics.friction),
            ("friction.viscous_nms_per_rad", "damping", dynamics.damping),
        ] {
            values.extend(value.map(|value| UrdfValue { joint: joint.name.clone(), key, attribute, value }));
        }
    }
    values
}

/// Largest effort that is a torque limit, Nm or N; a larger one stands for no limit.
const LARGEST_EFFORT: f64 = 1e6;

/// Returns the document of the values that a URDF states.
pub(crate) fn urdf_layer(values: &[UrdfValue]) -> String {
    let mut text = String::new();
    for UrdfValue { joint, key, value, .. } in values {
        let _ = writeln!(text, "joint.{}.{key} = {value:?}", Key::new(joint));
    }
    text
}

/// Reads the groups of a robot file.
///
/// # Errors
/// A group without joints, with an unknown joint, or with a joint of another group.
pub(crate) fn groups(source: &Source, document: &DeTable<'_>, model: &Model) -> Result<Groups, FileError> {
    let mut groups = Groups::new();
    let mut group_of: BTreeMap<String, String> = BTreeMap::new();
    let names = || model.joints().iter().map(|joint| joint.name.as_str());
    let Some(tables) = document.get("group") else { return Ok(groups) };
    let DeValue::Table(tables) = tables.get_ref() else {
        let help = "write [group.NAME] with `joints` and values of these joints".to_owned();
        return Err(FileError::at_key(source, "group", "expected a table of groups", Some(help)));
    };
    for (group, table) in tables {
        let group = group.get_ref().as_ref();
        let wrong = |last: &[&str], message: String, help: String| {
            FileError::at_key(source, [&["group", group], last].concat(), message, Some(help))
        };
        if group == DEFAULTS || names().any(|name| name == group) {
            let message = format!("'{group}' is not allowed as the name of a group");
            return Err(wrong(&[], message, "give it a name that no joint has".to_owned()));
        }
        let joints = match table.get_ref() {
            DeValue::Table(table) => table.get("joints"),
            _ => None,
        };
        let members: Option<Vec<String>> = joints.and_then(|joints| match joints.get_ref() {
            DeValue::Array(array) if !array.is_empty() => {
                array.iter().map(|name| name.get_ref().as_str().map(str::to_owned)).collect()
            }
            _ => None,
        });
        let Some(members) = members else {
            let help = format!("add joints = [...]; the joints are {}", suggest::list(names()));
            let place: &[&str] = if joints.is_some() { &["joints"] } else { &[] };
            return Err(wrong(place, format!("group '{group}' has no list of names of joints"), help));
        };
        for (index, joint) in members.iter().enumerate() {
            let index = index.to_string();
            if !names().any(|name| name == joint) {
                let message = format!("the URDF has no moving joint '{joint}'");
                return Err(wrong(&["joints", &index], message, choices(joint, names())));
            }
            if let Some(other) = group_of.insert(joint.clone(), group.to_owned()) {
                let message = match other == group {
                    true => format!("joint '{joint}' is named twice"),
                    false => format!("joint '{joint}' is also in group '{other}'"),
                };
                let help = "a joint is in one group at most: remove one of the two".to_owned();
                return Err(wrong(&["joints", &index], message, help));
            }
        }
        groups.insert(group.to_owned(), members);
    }
    Ok(groups)
}

/// Expands the layers of a document: afterwards it has one entry for each joint and for each servo.
pub(crate) fn expand<'a>(document: &mut DeTable<'a>, stated: &DeTable<'a>, groups: &Groups, model: &Model) {
    for joint in model.joints() {
        let mut layers: Vec<Spanned<DeValue<'a>>> = Vec::new();
        layers.extend(inner(document, &["joint", &joint.name]).cloned());
        for group in groups_of(groups, &joint.name) {
            let mut layer = inner(document, &["group", group]).cloned();
            if let Some(DeValue::Table(table)) = layer.as_mut().map(Spanned::get_mut) {
                table.remove("joints");
            }
            layers.extend(layer);
        }
        layers.extend(inner(document, &[DEFAULTS]).cloned());
        layers.extend(inner(stated, &["joint", &joint.name]).cloned());
        if let Some(mut merged) = merge(layers, Rule::Joint) {
            without_own_static_friction(&mut merged);
            put(document, "joint", &joint.name, merged);
        }
    }
    for (table, key) in [("", "default_profile"), ("interface", "setpoints"), ("simulated", "physics_hz")] {
        let path: Vec<&str> = [table, key].into_iter().filter(|word| !word.is_empty()).collect();
        let (Some(value), None) = (inner(stated, &path), inner(document, &path)) else { continue };
        let (name, value) = (Spanned::new(0..0, key.into()), value.clone());
        match (table, document.get_mut(table).map(Spanned::get_mut)) {
            ("", _) => drop(document.insert(name, value)),
            (_, Some(DeValue::Table(table))) => drop(table.insert(name, value)),
            _ => {}
        }
    }
    let Some(DeValue::Table(profiles)) = document.get_mut("profile").map(Spanned::get_mut) else { return };
    for (_, profile) in profiles.iter_mut() {
        let DeValue::Table(profile) = profile.get_mut() else { continue };
        for servos in SERVO_TABLES {
            expand_servos(profile, servos, groups, model);
        }
    }
}

/// Expands a table of servos, and removes the layers from it.
fn expand_servos(profile: &mut DeTable<'_>, servos: &str, groups: &Groups, model: &Model) {
    if !matches!(profile.get(servos).map(Spanned::get_ref), Some(DeValue::Table(_))) {
        return;
    }
    for joint in model.joints() {
        let names = [joint.name.as_str()].into_iter().chain(groups_of(groups, &joint.name)).chain([DEFAULTS]);
        let layers: Vec<_> = names.filter_map(|name| inner(profile, &[servos, name]).cloned()).collect();
        let rule = if servos == "servo" { Rule::Servo } else { Rule::Values };
        if let Some(merged) = merge(layers, rule) {
            put(profile, servos, &joint.name, merged);
        }
    }
    if let Some(DeValue::Table(table)) = profile.get_mut(servos).map(Spanned::get_mut) {
        table.remove(DEFAULTS);
        groups.keys().for_each(|group| {
            table.remove(group.as_str());
        });
    }
}

/// Names of the groups of a joint: one or none.
fn groups_of<'a>(groups: &'a Groups, joint: &'a str) -> impl Iterator<Item = &'a str> {
    groups
        .iter()
        .filter(move |(_, joints)| joints.iter().any(|name| name == joint))
        .map(|(name, _)| name.as_str())
}

/// Static friction is Coulomb friction unless the file states it.
fn without_own_static_friction(joint: &mut Spanned<DeValue<'_>>) {
    let DeValue::Table(joint) = joint.get_mut() else { return };
    let Some(DeValue::Table(friction)) = joint.get_mut("friction").map(Spanned::get_mut) else { return };
    if let (None, Some((key, coulomb))) = (friction.get("static_nm"), friction.get_key_value("coulomb_nm")) {
        let (span, coulomb) = (key.span(), coulomb.clone());
        friction.insert(Spanned::new(span, "static_nm".into()), coulomb);
    }
}

/// Inserts a value into a table of a document; the place of a new key is that of its value.
fn put<'a>(document: &mut DeTable<'a>, table: &str, key: &str, value: Spanned<DeValue<'a>>) {
    let span = value.span();
    if !document.contains_key(table) {
        let empty = Spanned::new(span.clone(), DeValue::Table(DeTable::new()));
        document.insert(Spanned::new(span.clone(), table.to_owned().into()), empty);
    }
    if let Some(DeValue::Table(table)) = document.get_mut(table).map(Spanned::get_mut) {
        match table.get_mut(key) {
            Some(old) => *old = value,
            None => {
                table.insert(Spanned::new(span, key.to_owned().into()), value);
            }
        }
    }
}

/// Rule by which the tables of layers are merged.
#[derive(Clone, Copy, PartialEq)]
enum Rule {
    /// Values of a joint: `rotor` and `friction` are merged value by value, others taken as a whole.
    Joint,
    /// Servos: values of one kind are merged; a layer with another kind is not used.
    Servo,
    /// Values are taken as a whole.
    Values,
}

/// Merges layers: the first that states a key is taken. A value that is not a table hides those after it.
fn merge<'a>(
    layers: impl IntoIterator<Item = Spanned<DeValue<'a>>>,
    rule: Rule,
) -> Option<Spanned<DeValue<'a>>> {
    let mut layers = layers.into_iter();
    let mut merged = layers.next()?;
    for layer in layers {
        let DeValue::Table(merged) = merged.get_mut() else { break };
        let DeValue::Table(layer) = layer.into_inner() else { continue };
        if rule == Rule::Servo && merged.keys().any(|kind| !layer.contains_key(kind.get_ref().as_ref())) {
            continue;
        }
        for (key, value) in layer {
            let has_values = match rule {
                Rule::Joint => INNER_TABLES.contains(&key.get_ref().as_ref()),
                Rule::Servo => true,
                Rule::Values => false,
            };
            match merged.get_mut(key.get_ref().as_ref()) {
                None => {
                    merged.insert(key, value);
                }
                Some(own) if has_values => *own = merge([own.clone(), value], Rule::Values)?,
                Some(_) => {}
            }
        }
    }
    Some(merged)
}

/// Checks that the values of each layer are valid, also those that no joint uses. `expanded` is complete.
///
/// # Errors
/// A value that is not allowed, with its place.
pub(crate) fn check_layers(
    source: &Source,
    document: &DeTable<'_>,
    expanded: &DeTable<'_>,
    groups: &Groups,
    model: &Model,
) -> Result<(), FileError> {
    check_names(source, expanded, model)?;
    let first = model.joints().first().map(|joint| (DEFAULTS, joint.name.as_str()));
    let members =
        groups.iter().filter_map(|(group, joints)| Some((group.as_str(), joints.first()?.as_str())));
    let layers: Vec<(&str, &str)> = first.into_iter().chain(members).collect();
    for (layer, joint) in &layers {
        let path: &[&str] = if *layer == DEFAULTS { &[DEFAULTS] } else { &["group", layer] };
        let merged = inner(expanded, &["joint", joint]);
        check_layer::<JointParameters>(source, document, inner(document, path), merged, Rule::Joint)?;
    }
    let Some(DeValue::Table(profiles)) = document.get("profile").map(Spanned::get_ref) else { return Ok(()) };
    for (profile, _) in profiles {
        let profile = profile.get_ref().as_ref();
        for (layer, joint) in &layers {
            let [position, velocity] = SERVO_TABLES.map(|table| {
                let of = |document, name| inner(document, &["profile", profile, table, name]);
                (of(document, layer), of(expanded, joint))
            });
            check_layer::<ServoParameters>(source, document, position.0, position.1, Rule::Servo)?;
            let joints = groups.get(*layer).cloned();
            check_kind(source, [profile, layer], position.0, expanded, joints.as_deref())?;
            check_layer::<VelocityServo>(source, document, velocity.0, velocity.1, Rule::Values)?;
        }
    }
    Ok(())
}

/// Checks that a layer of servos has the kind of one of its joints (all joints without a list), so that its values are used.
fn check_kind(
    source: &Source,
    [profile, name]: [&str; 2],
    layer: Option<&Spanned<DeValue<'_>>>,
    expanded: &DeTable<'_>,
    joints: Option<&[String]>,
) -> Result<(), FileError> {
    let kind = |servo: &Spanned<DeValue<'_>>| {
        let DeValue::Table(table) = servo.get_ref() else { return None };
        table.keys().map(|kind| kind.get_ref().to_string()).find(|kind| kind != "joints")
    };
    let servos = inner(expanded, &["profile", profile, "servo"]).map(Spanned::get_ref);
    let (Some(DeValue::Table(servos)), Some(own)) = (servos, layer.and_then(kind)) else { return Ok(()) };
    let applies = |joint: &str| joints.is_none_or(|joints| joints.iter().any(|name| name == joint));
    let kinds: Vec<String> = servos
        .iter()
        .filter(|(joint, _)| applies(joint.get_ref().as_ref()))
        .filter_map(|(_, servo)| kind(servo))
        .collect();
    match kinds.first() {
        Some(used) if !kinds.contains(&own) => {
            let message = format!("no servo of its joints is of kind `{own}`: these values have no effect");
            let help =
                Some(format!("the servos are of kind `{used}`: write `{name} = {{ {used} = {{ ... }} }}`"));
            Err(FileError::at_key(source, ["profile", profile, "servo", name], message, help))
        }
        _ => Ok(()),
    }
}

/// Checks that the entries of joints and servos have names of joints. `expanded` has no layers.
fn check_names(source: &Source, expanded: &DeTable<'_>, model: &Model) -> Result<(), FileError> {
    let mut tables = vec![vec!["joint"]];
    if let Some(DeValue::Table(profiles)) = inner(expanded, &["profile"]).map(Spanned::get_ref) {
        for profile in profiles.keys() {
            let profile = profile.get_ref().as_ref();
            tables.extend(SERVO_TABLES.map(|servos| vec!["profile", profile, servos]));
        }
    }
    for path in tables {
        let Some(DeValue::Table(table)) = inner(expanded, &path).map(Spanned::get_ref) else { continue };
        let mut names = table.keys().map(|name| name.get_ref().as_ref());
        if let Some(unknown) = names.find(|name| model.joint(name).is_err()) {
            let known = model.joints().iter().map(|joint| joint.name.as_str());
            let message = format!("the URDF has no moving joint '{unknown}'");
            let mut help = choices(unknown, known);
            if expanded.contains_key("use") || expanded.contains_key("locked_joints") {
                help += "; joints that `use` and `locked_joints` lock have no entries";
            }
            return Err(FileError::at_key(source, [&path[..], &[unknown]].concat(), message, Some(help)));
        }
    }
    Ok(())
}

/// Checks one layer, completed by the values of a joint that it applies to.
fn check_layer<'a, T: DeserializeOwned>(
    source: &Source,
    document: &DeTable<'a>,
    layer: Option<&Spanned<DeValue<'a>>>,
    joint: Option<&Spanned<DeValue<'a>>>,
    rule: Rule,
) -> Result<(), FileError> {
    let Some(mut layer) = layer.cloned() else { return Ok(()) };
    if let DeValue::Table(table) = layer.get_mut() {
        table.remove("joints");
    }
    let Some(merged) = merge([layer].into_iter().chain(joint.cloned()), rule) else { return Ok(()) };
    match T::deserialize(Strict(toml::de::ValueDeserializer::from(merged))) {
        // What one layer lacks, another one may state.
        Err(error) if !error.message().starts_with("missing field") => {
            Err(explain::<T>(source, document, &error))
        }
        _ => Ok(()),
    }
}

/// Describes the values that the URDF states, one line for each kind of value.
#[must_use]
pub fn urdf_values_text(values: &[UrdfValue]) -> String {
    let mut text = String::new();
    let mut keys: Vec<(&str, &str)> = values.iter().map(|value| (value.key, value.attribute)).collect();
    keys.sort_unstable();
    keys.dedup();
    for (key, attribute) in keys {
        let of_key = values.iter().filter(|value| value.key == key);
        let of_joints: Vec<String> = of_key.map(|value| format!("{} {}", value.joint, value.value)).collect();
        let _ = writeln!(text, "  {key} from {attribute} in the URDF: {}", of_joints.join(", "));
    }
    text
}

//! Values that a robot file lacks, all at once: each with its unit, its typical range, and where one finds it.

use crate::codes::Code;
use crate::files::explain::list;
use crate::files::layered_path::inner;
use crate::files::required_keys::{
    OF_FILE, OF_JOINT, OF_PROFILE, OF_SERVO, OF_VELOCITY_SERVO, Required, SETPOINTS, VELOCITY_LIMIT,
};
use crate::files::source::{FileError, Source};
use crate::files::toml_path::dotted;
use crate::suggest::choices;
use opspace_model::{JointKind, Model};
use std::fmt::Write as _;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Values of one kind that are missing.
struct Missing {
    of: &'static Required,
    /// Tables that lack it: paths from the root.
    tables: Vec<Vec<String>>,
    /// Table that states it for all joints, if it is one of a joint or a servo.
    defaults: Option<Vec<String>>,
}

/// Use of a robot file, which decides on the values that it needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Purpose {
    /// Control, or simulation.
    Control,
    /// Identification of the position servos and of friction: the file may lack both.
    Identification,
}

/// Checks that an expanded document has all values that a robot needs.
///
/// # Errors
/// One error that lists all values that are missing.
pub(crate) fn check_complete(
    source: &Source,
    document: &DeTable<'_>,
    model: &Model,
    purpose: Purpose,
) -> Result<(), FileError> {
    let missing = missing(document, model, purpose);
    let values: usize = missing.iter().map(|kind| kind.tables.len()).sum();
    match missing.as_slice() {
        [] => Ok(()),
        [only] if values == 1 => {
            let path: Vec<String> = only.tables[0].clone();
            let keys = [path.as_slice(), &words(only.of.path)].concat();
            let (within, key) = keys.split_at(keys.len() - 1);
            let message = format!("missing key `{}` in `{}`", dotted(key), dotted(within));
            Err(FileError::at_key(source, keys, message, Some(text_of(only, model)))
                .coded(Code::MissingValues))
        }
        _ => {
            let mut help = String::from("the file needs these values:\n");
            missing.iter().for_each(|kind| help += &text_of(kind, model));
            help += "`opspace new DIR --urdf FILE --like ARM` fills in those of a common arm, and `--assume` assumed ones, marked as such";
            let message = format!("{values} values are missing");
            match common_table(&missing) {
                [] => Err(FileError::of_file(source.name(), message, Some(help)).coded(Code::MissingValues)),
                table => {
                    // A name that the user has mistyped makes a profile of its own, with a value or two.
                    if let [first, name] = table
                        && first == "profile"
                    {
                        let profiles = document.get("profile").and_then(|table| table.get_ref().as_table());
                        let profiles = profiles.into_iter().flat_map(|table| table.keys());
                        let others: Vec<&str> = profiles
                            .map(|key| key.get_ref().as_ref())
                            .filter(|other| other != name)
                            .collect();
                        if !others.is_empty() {
                            help = format!("if it is no new profile: {}\n{help}", choices(name, others));
                        }
                    }
                    let joint = table.last().filter(|name| model.joint(name).is_ok());
                    let of = joint.map_or_else(String::new, |name| format!("joint '{name}': "));
                    let message = format!("{of}{message} in `{}`", dotted(table));
                    Err(FileError::at_key(source, table.to_vec(), message, Some(help))
                        .coded(Code::MissingValues))
                }
            }
        }
    }
}

/// Table in which all values are missing.
fn common_table(missing: &[Missing]) -> &[String] {
    let mut tables = missing.iter().flat_map(|kind| &kind.tables);
    let Some(first) = tables.next() else { return &[] };
    let shared = tables.map(|table| first.iter().zip(table).take_while(|(a, b)| a == b).count()).min();
    &first[..shared.unwrap_or(first.len())]
}

fn words(path: &[&str]) -> Vec<String> {
    path.iter().map(|&word| word.to_owned()).collect()
}

fn missing(document: &DeTable<'_>, model: &Model, purpose: Purpose) -> Vec<Missing> {
    let mut all = Vec::new();
    let of_file = OF_FILE.iter().chain([&SETPOINTS]);
    for of in of_file.filter(|of| lacks(document, &[], of.path)) {
        all.push(Missing { of, tables: vec![vec![]], defaults: None });
    }
    let names = || model.joints().iter().map(|joint| joint.name.as_str());
    for of in &OF_JOINT {
        let tables: Vec<Vec<String>> = names()
            .filter(|name| lacks(document, &["joint", name], of.path))
            .map(|name| words(&["joint", name]))
            .collect();
        all.push(Missing { of, tables, defaults: Some(words(&["joint_defaults"])) });
    }
    let unlimited = model.joints().iter().filter(|joint| {
        let velocity = joint.limits.velocity;
        !(velocity.is_finite() && velocity > 0.0)
            && lacks(document, &["joint", &joint.name], VELOCITY_LIMIT.path)
    });
    let tables = unlimited.map(|joint| words(&["joint", &joint.name])).collect();
    all.push(Missing { of: &VELOCITY_LIMIT, tables, defaults: Some(words(&["joint_defaults"])) });
    let command = inner(document, &["interface", "command"]).and_then(|command| command.get_ref().as_str());
    let profiles: Vec<&str> = match inner(document, &["profile"]).map(Spanned::get_ref) {
        Some(DeValue::Table(profiles)) => profiles.keys().map(|name| name.get_ref().as_ref()).collect(),
        Some(_) => return all.into_iter().filter(|kind| !kind.tables.is_empty()).collect(),
        None => vec!["default"],
    };
    for of in &OF_PROFILE {
        let lacking = profiles.iter().filter(|profile| lacks(document, &["profile", profile], of.path));
        let tables = lacking.map(|profile| words(&["profile", profile])).collect();
        all.push(Missing { of, tables, defaults: None });
    }
    let [is_position, is_velocity] = ["position", "velocity"].map(|kind| command == Some(kind));
    for profile in &profiles {
        let has = |table: &str| inner(document, &["profile", profile, table]).is_some();
        let of_tables: [(&str, bool, &'static [Required]); 2] = [
            (
                "servo",
                has("servo")
                    || purpose == Purpose::Control
                        && !has("velocity_servo")
                        && (is_position || command.is_none()),
                &OF_SERVO,
            ),
            ("velocity_servo", has("velocity_servo") || !has("servo") && is_velocity, &OF_VELOCITY_SERVO),
        ];
        for (table, _, kinds) in of_tables.into_iter().filter(|(_, needed, _)| *needed) {
            for of in kinds {
                let lacking = names().filter(|name| {
                    let path = ["profile", profile, table, name];
                    let other_kind = inner(document, &path).and_then(|servo| servo.get_ref().as_table());
                    let other_kind = table == "servo"
                        && other_kind
                            .is_some_and(|servo| !servo.is_empty() && !servo.contains_key("cascaded"));
                    !other_kind && lacks(document, &path, of.path)
                });
                let tables = lacking.map(|name| words(&["profile", profile, table, name])).collect();
                let defaults = Some(words(&["profile", profile, table, "joint_defaults"]));
                all.push(Missing { of, tables, defaults });
            }
        }
    }
    all.retain(|kind| !kind.tables.is_empty());
    all
}

/// True if a value is missing, and no value of another type is in its place.
fn lacks(document: &DeTable<'_>, table: &[&str], path: &[&str]) -> bool {
    let mut at = document;
    for key in table.iter().chain(path) {
        match at.get(*key).map(Spanned::get_ref) {
            None => return true,
            Some(DeValue::Table(table)) => at = table,
            Some(_) => return false,
        }
    }
    false
}

/// Describes the values of one kind that are missing.
fn text_of(missing: &Missing, model: &Model) -> String {
    let Missing { of, tables, defaults } = missing;
    let mut text = format!("- {}\n  source: {}\n", of.about(), of.found);
    // Table and line: keys of inner tables are dotted.
    let place = |table: &[String]| match table {
        [] => format!("[{}]", of.path[0]),
        _ => format!("[{}]", dotted(table)),
    };
    let line = match tables[0].as_slice() {
        [] => format!("{} = ...", dotted(&words(&of.path[1..]))),
        _ => format!("{} = ...", dotted(&words(of.path))),
    };
    let joints: Vec<&str> = tables.iter().filter_map(|table| table.last().map(String::as_str)).collect();
    match defaults {
        Some(defaults) if joints.len() == model.n() && joints.len() > 1 => {
            let (all, first) = (place(defaults), place(&tables[0]));
            let _ = writeln!(text, "  write:  {line}   in {all}, or in {first} and the other joints");
        }
        Some(_) if joints.len() > 1 => {
            let first = place(&tables[0]);
            let _ = writeln!(text, "  write:  {line}   in {first}, and for the other of these joints");
            let _ = writeln!(text, "  joints: {}", list(&joints));
        }
        _ => tables.iter().for_each(|table| {
            let _ = writeln!(text, "  write:  {line}   in {}", place(table));
        }),
    }
    let is_prismatic =
        |name: &&str| model.joint(name).is_ok_and(|joint| model.joints()[joint].kind == JointKind::Prismatic);
    let prismatic: Vec<&str> = joints.iter().copied().filter(is_prismatic).collect();
    if defaults.is_some() && !prismatic.is_empty() {
        let _ = writeln!(text, "  prismatic, in N and m: {}", list(&prismatic));
    }
    text
}

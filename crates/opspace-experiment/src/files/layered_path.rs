//! Places of the values of joints in robot.toml: their own tables, those of their groups, and those of all joints.

use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Key of the values of all joints, in the file and in a table of servos.
pub(crate) const DEFAULTS: &str = "joint_defaults";

/// Tables of servos of a profile.
pub(crate) const SERVO_TABLES: [&str; 2] = ["servo", "velocity_servo"];

/// Value below a path of tables.
pub(crate) fn inner<'t, 'a>(table: &'t DeTable<'a>, path: &[&str]) -> Option<&'t Spanned<DeValue<'a>>> {
    let (first, rest) = path.split_first()?;
    let value = table.get(*first)?;
    match (rest, value.get_ref()) {
        ([], _) => Some(value),
        (_, DeValue::Table(table)) => inner(table, rest),
        _ => None,
    }
}

/// Path at which a document states a value of a joint or of its servo that is not in its own table; `None` if it is, or
/// nowhere.
pub(crate) fn stated_path(document: &DeTable<'_>, path: &[String]) -> Option<Vec<String>> {
    let words: Vec<&str> = path.iter().map(String::as_str).collect();
    let (joint, servos, rest): (&str, &[&str], &[&str]) = match words[..] {
        ["joint", joint, ..] => (joint, &[], &words[2..]),
        ["profile", _, table, joint, ..] if SERVO_TABLES.contains(&table) => {
            (joint, &words[..3], &words[4..])
        }
        _ => return None,
    };
    if inner(document, &words).is_some() {
        return None;
    }
    let groups = match inner(document, &["group"]).map(Spanned::get_ref) {
        Some(DeValue::Table(groups)) => groups.keys().map(|name| name.get_ref().as_ref()).collect(),
        _ => Vec::new(),
    };
    let has_joint = |group: &&str| {
        let joints = inner(document, &["group", group, "joints"]);
        let joints = joints.and_then(|joints| joints.get_ref().as_array());
        joints.is_some_and(|joints| joints.iter().any(|name| name.get_ref().as_str() == Some(joint)))
    };
    let head = if servos.is_empty() { &["group"][..] } else { servos };
    let of_groups = groups.into_iter().filter(has_joint).map(|group| [head, &[group], rest].concat());
    let mut paths = of_groups.chain([[servos, &[DEFAULTS], rest].concat()]);
    let found = paths.find(|path| inner(document, path).is_some())?;
    Some(found.into_iter().map(str::to_owned).collect())
}

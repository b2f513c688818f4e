//! Table of runs as CSV, for notebooks and spreadsheets.

use opspace_experiment::evaluate::run_summary::RunSummary;
use serde_json::{Map, Value};
use std::collections::HashMap;

/// First columns, which every table of single robots has.
const FIRST: [&str; 5] = ["task", "robot", "backend", "controller", "transformer"];

/// First columns, which every table of several robots has.
const FIRST_OF_SEVERAL: [&str; 3] = ["experiment", "label", "seed"];

/// Formats runs as CSV (RFC 4180, with LF): one row per run, one column per key and metric.
///
/// The columns are those of `summary.json`, with the unit in the name: the keys of the run, one column for each setting
/// (`robot.profile.a-med.servo_ticks_per_cycle`), its metrics and timing, then the metrics of each task
/// (`task.hand.position_rms_m`) and each joint (`joint.elbow.torque_error_rms_nm`). A cell is empty where a run has no
/// value; texts of a list are separated by `; `.
///
/// Runs of several robots have the keys of the run, its settings, then the metrics of each coupling (`coupling.hands.drift_m`),
/// and profile, kind and fault of each robot (`robot.leader.profile`).
#[must_use]
pub fn csv(summaries: &[RunSummary]) -> String {
    if summaries.iter().all(|summary| summary.single().is_some()) {
        table(summaries, &FIRST, &[keys, settings, metrics, tasks, joints])
    } else {
        table(summaries, &FIRST_OF_SEVERAL, &[keys_of_several, settings, couplings, robots])
    }
}

fn table(summaries: &[RunSummary], first: &[&str], parts: &[fn(&Value, Add<'_>)]) -> String {
    let mut columns: Vec<String> = first.iter().map(|name| (*name).to_owned()).collect();
    let mut places: HashMap<String, usize> = columns.iter().cloned().zip(0..).collect();
    // Columns of one part stand together, whichever run has them first.
    let mut rows: Vec<HashMap<usize, String>> = vec![HashMap::new(); summaries.len()];
    let values: Vec<Value> =
        summaries.iter().map(|summary| serde_json::to_value(summary).unwrap_or_default()).collect();
    for part in parts {
        for (row, value) in rows.iter_mut().zip(&values) {
            let mut add = |name: String, cell: String| {
                let place = *places.entry(name.clone()).or_insert_with(|| {
                    columns.push(name);
                    columns.len() - 1
                });
                row.insert(place, cell);
            };
            part(value, &mut add);
        }
    }
    let mut writer = csv::Writer::from_writer(Vec::new());
    let mut lines = vec![columns.iter().map(|name| harmless(name)).collect::<Vec<_>>()];
    lines.extend(rows.iter().map(|row| {
        let text = |place| row.get(&place).map_or("", String::as_str);
        (0..columns.len()).map(|place| harmless(text(place))).collect()
    }));
    // Writing to memory cannot fail, and every line has as many cells as there are columns.
    lines.iter().for_each(|line| drop(writer.write_record(line)));
    writer.into_inner().ok().and_then(|bytes| String::from_utf8(bytes).ok()).unwrap_or_default()
}

/// Text of a cell that no spreadsheet takes for a formula and no terminal for a command: a quote precedes what begins like
/// a formula, and control characters are escaped. Numbers stay as they are.
fn harmless(text: &str) -> String {
    if text.parse::<f64>().is_ok() {
        return text.to_owned();
    }
    let mut shown = if text.starts_with(['=', '+', '-', '@']) { "'".to_owned() } else { String::new() };
    for c in text.chars() {
        if c.is_control() { shown.extend(c.escape_unicode()) } else { shown.push(c) }
    }
    shown
}

/// Receiver of a column's name and the cell in it.
type Add<'a> = &'a mut dyn FnMut(String, String);

/// Values of the run itself.
fn keys(row: &Value, add: Add<'_>) {
    for (name, value) in
        entries(row).filter(|(_, value)| !value.is_object()).filter(|(n, _)| *n != "overrides")
    {
        add(name.clone(), cell(value));
    }
}

/// Values of a run of several robots itself: names and lists of texts.
fn keys_of_several(row: &Value, add: Add<'_>) {
    keys(row, &mut |name, cell| {
        // A hold is an object, which has no text.
        if name != "holds" {
            add(name, cell);
        }
    });
}

fn couplings(row: &Value, add: Add<'_>) {
    for (coupling, metrics) in entries(&row["couplings"]) {
        for (name, value) in entries(metrics).filter(|(_, value)| !value.is_array()) {
            add(format!("coupling.{coupling}.{name}"), cell(value));
        }
    }
}

fn robots(row: &Value, add: Add<'_>) {
    for (robot, summary) in entries(&row["robots"]) {
        for name in ["robot", "backend", "profile", "faulted", "fault_time_s"] {
            add(format!("robot.{robot}.{name}"), cell(&summary[name]));
        }
    }
}

/// Settings that were applied to the files, by key.
fn settings(row: &Value, add: Add<'_>) {
    for setting in row["overrides"].as_array().into_iter().flatten().filter_map(Value::as_str) {
        if let Some((name, value)) = setting.split_once('=') {
            add(name.trim().to_owned(), value.trim().trim_matches('"').to_owned());
        }
    }
}

fn metrics(row: &Value, add: Add<'_>) {
    for (name, value) in entries(&row["metrics"]).chain(entries(&row["timing"])) {
        add(name.clone(), cell(value));
    }
}

fn tasks(row: &Value, add: Add<'_>) {
    for (task, metrics) in entries(&row["tasks"]) {
        for (name, value) in
            entries(metrics).filter(|(name, _)| !["elements", "axes"].contains(&name.as_str()))
        {
            add(format!("task.{task}.{name}"), cell(value));
        }
        for (name, value) in entries(&metrics["axes"]) {
            add(format!("task.{task}.{name}"), cell(value));
        }
        for element in metrics["elements"].as_array().into_iter().flatten() {
            let (name, unit) = (cell(&element["name"]), cell(&element["unit"]));
            for quantity in ["rms", "max"] {
                add(format!("task.{task}.{name}.{quantity}_{unit}"), cell(&element[quantity]));
            }
        }
    }
}

fn joints(row: &Value, add: Add<'_>) {
    for (joint, metrics) in entries(&row["joints"]) {
        for (name, value) in entries(metrics) {
            add(format!("joint.{joint}.{name}"), cell(value));
        }
    }
}

fn entries(value: &Value) -> impl Iterator<Item = (&String, &Value)> {
    value.as_object().into_iter().flat_map(Map::iter)
}

fn cell(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        Value::Array(list) => list.iter().map(cell).collect::<Vec<_>>().join("; "),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::harmless;

    #[test]
    fn cells_are_no_formulas_and_no_commands() {
        for (text, shown) in [
            ("=1+1", "'=1+1"),
            ("+x", "'+x"),
            ("-a", "'-a"),
            ("@SUM(A1)", "'@SUM(A1)"),
            ("a\u{1b}[31m", "a\\u{1b}[31m"),
            ("\t=1", "\\u{9}=1"),
            ("-0.5", "-0.5"),
            ("+1e3", "+1e3"),
            ("emulation", "emulation"),
            ("", ""),
        ] {
            assert_eq!(harmless(text), shown);
        }
    }
}

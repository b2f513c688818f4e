//! Settings in which the runs of a suite differ, as numbers with names and units.

use crate::evaluate::summary::Summary;
use crate::evaluate::table::Cell;
use crate::files::source::KeyPath;

/// Unit at the end of a key, and the unit as printed.
const UNITS: [(&str, &str); 22] = [
    ("_nm_per_rad_per_s", "N·m·s/rad"),
    ("_nms_per_rad", "N·m·s/rad"),
    ("_nm_per_rad", "N·m/rad"),
    ("_ns_per_m", "N·s/m"),
    ("_n_per_m", "N/m"),
    ("_n_per_s", "N/s"),
    ("_rad_per_s2", "rad/s²"),
    ("_rad_per_s", "rad/s"),
    ("_m_per_s2", "m/s²"),
    ("_m_per_s", "m/s"),
    ("_per_s", "1/s"),
    ("_kg_m2", "kg·m²"),
    ("_kg", "kg"),
    ("_hz", "Hz"),
    ("_rad", "rad"),
    ("_nms", "N·m·s"),
    ("_nm", "N·m"),
    ("_ns", "N·s"),
    ("_ms", "ms"),
    ("_n", "N"),
    ("_m", "m"),
    ("_s", "s"),
];

/// Key of a setting, with a short name.
#[derive(Clone, Debug, PartialEq)]
pub struct GridKey {
    /// Key as in a setting.
    pub key: String,
    /// Words of the key that tell it from the others: `stiffness`.
    pub name: String,
    /// Unit as printed; empty if it has none.
    pub unit: &'static str,
}

impl GridKey {
    /// Keys in which these runs differ: those of grids, whose values are in the labels, and those of runs without a label.
    pub(crate) fn of<'a>(runs: impl Iterator<Item = &'a Summary> + Clone) -> Vec<Self> {
        let differs = |key: &str| {
            let value = |run: &'a Summary| settings(run).filter(|(own, _)| *own == key).last();
            let mut values = runs.clone().map(value);
            let first = values.next();
            values.any(|other| Some(other) != first)
        };
        let is_shown = |run: &Summary, key: &str, value: &str| match &run.label {
            Some(_) => part_of_label(run, key, value).is_some(),
            None => differs(key),
        };
        let mut keys: Vec<&str> = Vec::new();
        for run in runs.clone() {
            for (key, _) in settings(run).filter(|(key, value)| is_shown(run, key, value)) {
                if !keys.contains(&key) {
                    keys.push(key);
                }
            }
        }
        Self::named(&keys)
    }

    /// Gives keys the shortest names that tell them apart.
    pub fn named(keys: &[&str]) -> Vec<Self> {
        let all: Vec<Vec<String>> = keys.iter().map(|key| key.segments()).collect();
        let end = |key: &[String], length: usize| key[key.len().saturating_sub(length)..].join(" ");
        let named = |(key, segments): (&&str, &Vec<String>)| {
            let is_unique = |length: usize| {
                all.iter().filter(|other| end(other, length) == end(segments, length)).count() == 1
            };
            let length = (1..segments.len()).find(|length| is_unique(*length)).unwrap_or(segments.len());
            let (name, unit) = named(&end(segments, length));
            let is_factor = segments.iter().any(|segment| segment == "true_over_nominal");
            let unit = if is_factor && unit.is_empty() { "true/nominal" } else { unit };
            let name = name.replace("true over nominal ", "");
            Self { key: (*key).to_owned(), name, unit }
        };
        keys.iter().zip(&all).map(named).collect()
    }

    /// Value of the setting as text; `None` if the run does not set it.
    pub fn text<'a>(&self, run: &'a Summary) -> Option<&'a str> {
        settings(run).filter(|(key, _)| *key == self.key).last().map(|(_, value)| value)
    }

    /// Value of the setting; `None` if it is no number.
    pub fn number(&self, run: &Summary) -> Option<f64> {
        self.text(run)?.parse().ok().filter(|number: &f64| number.is_finite())
    }

    /// Values of the setting in a table; numbers have equal decimals.
    pub(crate) fn cells(&self, runs: &[&Summary]) -> Vec<Cell> {
        const MOST_DECIMALS: usize = 6;
        let decimals = |number: f64| number.to_string().split_once('.').map_or(0, |(_, digits)| digits.len());
        let numbers = runs.iter().filter_map(|run| self.number(run));
        let most = numbers.map(decimals).max().unwrap_or(0).min(MOST_DECIMALS);
        let cell = |run: &&Summary| match (self.number(run), self.text(run)) {
            (Some(number), _) => format!("{number:.most$}").into(),
            (None, Some(text)) => text.trim_matches('"').into(),
            (None, None) => Cell::Empty,
        };
        runs.iter().map(cell).collect()
    }

    /// Name and unit: `stiffness (N/m)`.
    pub fn title(&self) -> String {
        if self.unit.is_empty() { self.name.clone() } else { format!("{} ({})", self.name, self.unit) }
    }
}

/// Keys and values of the settings of a run; expectations do not change it.
pub fn settings(run: &Summary) -> impl Iterator<Item = (&str, &str)> {
    let pairs = run.overrides.iter().filter_map(|setting| setting.split_once('='));
    pairs.map(|(key, value)| (key.trim(), value.trim())).filter(|(key, _)| !key.starts_with("expect."))
}

/// Label of a run without the values of a grid.
pub fn own_label(run: &Summary) -> Option<String> {
    let of_grid: Vec<&str> =
        settings(run).filter_map(|(key, value)| part_of_label(run, key, value)).collect();
    let parts = run.label.as_deref()?.split(", ").filter(|part| !of_grid.contains(part));
    let own = parts.collect::<Vec<_>>().join(", ");
    (!own.is_empty()).then_some(own)
}

/// Part of the label of a run that states this setting: the end of its key, and its value.
fn part_of_label<'a>(run: &'a Summary, key: &str, value: &str) -> Option<&'a str> {
    let states = |part: &&str| {
        let Some((name, shown)) = part.split_once('=') else { return false };
        let key = key.segments().join(".");
        shown == value.trim_matches('"') && (key == name || key.ends_with(&format!(".{name}")))
    };
    run.label.as_deref()?.split(", ").find(states)
}

/// Words of a name without its unit, and the unit.
fn named(name: &str) -> (String, &'static str) {
    let unit = UNITS.iter().find(|(end, _)| name.len() > end.len() && name.ends_with(end));
    let (name, unit) = unit.map_or((name, ""), |(end, unit)| (&name[..name.len() - end.len()], *unit));
    (name.replace('_', " "), unit)
}

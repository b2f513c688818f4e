//! Grid of a suite: lists of values for settings, each combination of which is run.

use opspace_experiment::files::source::{FileError, KeyPath, Source};
use opspace_experiment::files::toml_path::dotted;
#[cfg(feature = "schema")]
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
#[cfg(feature = "schema")]
use std::borrow::Cow;
use toml::{Table, Value};

/// Lists of values by key. A key is that of a setting on the command line, in quotes or as nested tables.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
#[serde(transparent)]
pub struct Grid(Table);

/// Combination of the lists of a grid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum GridMode {
    /// Every value of each list with every value of all others.
    #[default]
    Cross,
    /// The first values of all lists, then the second ones, and so on; the lists have equal lengths.
    Zip,
}

/// Point of a grid: one value for each key.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct GridPoint {
    /// Settings, each with the place of its value in the suite file.
    pub(crate) settings: Vec<(String, Vec<String>)>,
    /// Values of the point, for a table.
    pub(crate) label: String,
}

/// List of values of one key.
struct Axis<'a> {
    /// Key as in a setting.
    key: String,
    /// Place of the list in the suite file.
    place: Vec<String>,
    values: &'a [Value],
}

impl Grid {
    /// Returns the points in the order of the file, the last key changing fastest. `place` is the key of the grid in
    /// `source`. `None` without any key.
    pub(crate) fn points(
        &self,
        mode: GridMode,
        source: &Source,
        place: &[String],
        most: usize,
    ) -> Result<Option<Vec<GridPoint>>, FileError> {
        let mut axes = Vec::new();
        collect(&self.0, None, source, place, &mut axes)?;
        let Some(first) = axes.first() else { return Ok(None) };
        let count = match mode {
            GridMode::Cross => axes.iter().fold(1, |n: usize, axis| n.saturating_mul(axis.values.len())),
            GridMode::Zip => {
                if let Some(other) = axes.iter().find(|axis| axis.values.len() != first.values.len()) {
                    let (n, m) = (other.values.len(), first.values.len());
                    let message = format!(
                        "{n} values, but `{}` has {m}: a zipped grid needs lists of equal lengths",
                        first.key
                    );
                    let help = Some("remove `grid_mode = \"zip\"` to cross the lists".to_owned());
                    return Err(FileError::at_key(source, &other.place, message, help));
                }
                first.values.len()
            }
        };
        if count > most {
            let message = format!("this grid has {count} points; at most {most} runs are allowed in a suite");
            return Err(FileError::at_key(source, place, message, None));
        }
        let names = short_names(&axes);
        let point = |number: usize| {
            let mut rest = number;
            let mut chosen = vec![number; axes.len()];
            if mode == GridMode::Cross {
                for (place, axis) in chosen.iter_mut().zip(&axes).rev() {
                    (*place, rest) = (rest % axis.values.len(), rest / axis.values.len());
                }
            }
            let (mut settings, mut label) = (Vec::new(), Vec::new());
            for ((axis, name), index) in axes.iter().zip(&names).zip(chosen) {
                let value = &axis.values[index];
                let place = axis.place.iter().cloned().chain([index.to_string()]).collect();
                settings.push((format!("{}={value}", axis.key), place));
                let shown = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
                label.push(format!("{name}={shown}"));
            }
            GridPoint { settings, label: label.join(", ") }
        };
        Ok(Some((0..count).map(point).collect()))
    }
}

/// Collects the lists of a table and of the tables in it.
fn collect<'a>(
    table: &'a Table,
    within: Option<&str>,
    source: &Source,
    place: &[String],
    axes: &mut Vec<Axis<'a>>,
) -> Result<(), FileError> {
    for (name, value) in table {
        // A key directly in the grid is written as in a setting, with its dots; one in a table has no dots to split at.
        let key = match within {
            None => name.clone(),
            Some(outer) => format!("{outer}.{}", dotted(std::slice::from_ref(name))),
        };
        let place: Vec<String> = place.iter().cloned().chain([name.clone()]).collect();
        let refuse = |message: &str| {
            let help = Some(format!("write a list: `\"{key}\" = [1, 2, 5]`"));
            Err(FileError::at_key(source, &place, message, help))
        };
        match value {
            Value::Array(values) if values.is_empty() => return refuse("this list of values is empty"),
            Value::Array(values) => axes.push(Axis { key, place, values }),
            Value::Table(inner) if inner.is_empty() => return refuse("a list of values is missing"),
            Value::Table(inner) => collect(inner, Some(&key), source, &place, axes)?,
            other => return refuse(&format!("expected a list of values, got {other}")),
        }
    }
    Ok(())
}

/// The shortest ends of the keys that tell them apart: `kp` for `robot.simulated.true_over_nominal.kp`.
fn short_names(axes: &[Axis<'_>]) -> Vec<String> {
    let all: Vec<Vec<String>> = axes.iter().map(|axis| axis.key.segments()).collect();
    let end = |key: &[String], length: usize| key[key.len().saturating_sub(length)..].to_vec();
    let name = |key: &Vec<String>| {
        let unique =
            |&length: &usize| all.iter().filter(|other| end(other, length) == end(key, length)).count() == 1;
        let length = (1..key.len()).find(unique).unwrap_or(key.len());
        end(key, length).join(".")
    };
    all.iter().map(name).collect()
}

#[cfg(feature = "schema")]
impl JsonSchema for Grid {
    fn schema_name() -> Cow<'static, str> {
        "Grid".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "Lists of values by key. A key is that of a setting on the command line, in quotes or as nested tables.",
            "type": "object",
            "additionalProperties": { "anyOf": [{ "type": "array", "minItems": 1 }, { "type": "object" }] },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::{Grid, GridMode};
    use opspace_experiment::files::source::Source;

    fn points(text: &str, mode: GridMode) -> Result<Vec<(Vec<String>, String)>, String> {
        let source = Source::new("suite.toml", format!("[grid]\n{text}"));
        let grid: Grid = toml::from_str(text).expect("TOML");
        let points = grid.points(mode, &source, &["grid".to_owned()], 100);
        points.map_err(|error| format!("{error} {:?}", error.help())).map(|points| {
            let each = points.unwrap_or_default().into_iter();
            each.map(|point| (point.settings.into_iter().map(|(set, _)| set).collect(), point.label))
                .collect()
        })
    }

    /// Compared: the points of a grid, and a list written by hand; quoted keys and nested tables are the same.
    #[test]
    fn grid_is_crossed_or_zipped() {
        let text = "\"robot.profile.a-med.servo_ticks_per_cycle\" = [1, 2]\n\
                    robot.simulated.true_over_nominal.kp = [0.5, 1.0]\n";
        let both = |ticks: i32, kp: &str| {
            (
                vec![
                    format!("robot.profile.a-med.servo_ticks_per_cycle={ticks}"),
                    format!("robot.simulated.true_over_nominal.kp={kp}"),
                ],
                format!("servo_ticks_per_cycle={ticks}, kp={kp}"),
            )
        };
        let crossed = points(text, GridMode::Cross);
        assert_eq!(crossed, Ok(vec![both(1, "0.5"), both(1, "1.0"), both(2, "0.5"), both(2, "1.0")]));
        assert_eq!(points(text, GridMode::Zip), Ok(vec![both(1, "0.5"), both(2, "1.0")]));
        assert_eq!(points("", GridMode::Cross), Ok(vec![]));
    }

    /// Checks names that differ only before their last part, a text, a list and a key that contains a dot.
    #[test]
    fn label_has_the_shortest_names_that_differ() {
        let text = "\"a.left.kp\" = [1]\n\"a.right.kp\" = [2]\nb.\"arm.1\" = [\"high\", [1, 2]]\n";
        let points = points(text, GridMode::Cross).expect("points");
        assert_eq!(points[0].1, "left.kp=1, right.kp=2, arm.1=high");
        assert_eq!(points[0].0[2], "b.\"arm.1\"=\"high\"");
        assert_eq!(points[1].0[2], "b.\"arm.1\"=[1, 2]");
    }

    #[test]
    fn mistakes_in_a_grid_have_their_line() {
        for (text, mode, words) in [
            ("a = [1, 2]\nb = [1]\n", GridMode::Zip, "suite.toml:3: 1 values, but `a` has 2"),
            ("a = [1]\nb = 1\n", GridMode::Cross, "suite.toml:3: expected a list of values, got 1"),
            ("a = []\n", GridMode::Cross, "suite.toml:2: this list of values is empty"),
            ("a = [1,2,3,4,5,6,7,8,9,10,11]\nb = [1,2,3,4,5,6,7,8,9,10]\n", GridMode::Cross, "110 points"),
        ] {
            let error = points(text, mode).expect_err(text);
            assert!(error.contains(words), "{error}");
        }
    }
}

//! Suites with one run for each entry, so that `opspace bench` keeps the log of every run.
//!
//! `opspace bench` keeps the log of the first run of each task file. Each entry of the rewritten suite therefore names its
//! task by a path of its own, through a link to the checkout. Each run keeps its first seed; the first run of a suite keeps more of
//! them, because `bench.json` has statistics over seeds. All other keys of a suite are passed on as they are.

use std::os::unix::fs::symlink;
use std::path::{Component, Path, PathBuf};
use toml::{Table, Value};

/// Suite as single runs.
#[derive(Clone, Debug)]
pub struct Suite {
    /// Keys of the suite beside its runs.
    head: Table,
    /// Runs, in the order of the suite.
    pub runs: Vec<Run>,
}

/// Single run of a suite.
#[derive(Clone, Debug)]
pub struct Run {
    /// Place of the run in the suite, by which the runs of two checkouts are paired: the numbers of the entry, and in it of
    /// the task, the variant, the point of the grid, the profile and the seed, each from 1.
    pub place: String,
    /// Task, variant, profile and seed as written in the suite.
    pub spelling: String,
    /// Entry with only this run.
    entry: Table,
}

/// Maximum number of seeds of the first run. With ten, an interval over seeds is not the range of all of them.
const MAX_SEEDS: usize = 10;

/// Keys with the files of an entry.
const FILES: [&str; 2] = ["tasks", "experiments"];

impl Suite {
    /// Parses the text of a suite.
    ///
    /// # Errors
    /// A text that is no suite.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut head: Table = toml::from_str(text).map_err(|e| e.to_string())?;
        let entries = head.remove("run").ok_or("has no runs")?;
        let of_suite = ["profiles", "grid", "grid_mode"].map(|key| (key, head.remove(key)));
        let mut runs = Vec::new();
        for (number, entry) in (1..).zip(entries.as_array().ok_or("has no list of runs")?) {
            let mut entry = entry.as_table().ok_or("has a run that is no table")?.clone();
            for (key, value) in &of_suite {
                if let (false, Some(value)) = (entry.contains_key(*key), value) {
                    entry.insert((*key).to_owned(), value.clone());
                }
            }
            runs.extend(single_runs(number, &entry));
        }
        Ok(Self { head, runs })
    }

    /// Keeps only the run at a place, without the suite's columns, for which one run may have no value.
    #[must_use]
    pub fn only(mut self, place: &str) -> Self {
        self.runs.retain(|run| run.place == place);
        self.head.remove("columns");
        self
    }

    /// Writes the suite to a file, with the links that it needs in folders beside it. `path` is that of the original in the
    /// checkout, `settings` are added behind those of each run.
    ///
    /// # Errors
    /// A file or link that cannot be written.
    pub fn write(
        &self,
        file: &Path,
        checkout: &Path,
        path: &Path,
        settings: &[String],
    ) -> Result<(), String> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut entries = Vec::new();
        for (number, run) in self.runs.iter().enumerate() {
            let link = file.with_file_name(number.to_string());
            symlink(checkout, &link).map_err(|e| format!("{}: {e}", link.display()))?;
            let moved = |value: &mut Value| {
                if let Value::String(path) = value {
                    *path = link.join(plain(&folder.join(&path))).display().to_string();
                }
            };
            let mut entry = run.entry.clone();
            for key in FILES {
                entry.get_mut(key).and_then(Value::as_array_mut).into_iter().flatten().for_each(moved);
            }
            entry.get_mut("robot").into_iter().for_each(moved);
            add_settings(&mut entry, settings);
            entries.push(Value::Table(entry));
        }
        let mut suite = self.head.clone();
        suite.insert("run".to_owned(), Value::Array(entries));
        std::fs::write(file, suite.to_string()).map_err(|e| format!("{}: {e}", file.display()))
    }
}

/// Expands an entry, in the order in which `opspace bench` does.
fn single_runs(number: usize, entry: &Table) -> Vec<Run> {
    let one = |key: &str, value: &Option<Value>| {
        value.clone().map(|value| (key.to_owned(), Value::Array(vec![value])))
    };
    let files_key = FILES.into_iter().find(|key| entry.contains_key(*key)).unwrap_or_default();
    let grid = entry.get("grid").and_then(Value::as_table).cloned().unwrap_or_default();
    let points = points(&grid, entry.get("grid_mode").and_then(Value::as_str) == Some("zip"));
    let seeds = seeds(entry);
    let mut rest = entry.clone();
    rest.retain(|key, _| ![files_key, "variant", "grid", "grid_mode", "profiles", "seeds"].contains(&key));
    let mut runs = Vec::new();
    for (file_number, file) in (1..).zip(or_none(entry, files_key)) {
        for (variant_number, variant) in (1..).zip(or_none(entry, "variant")) {
            for (point_number, point) in (1..).zip(&points) {
                for (profile_number, profile) in (1..).zip(or_none(entry, "profiles")) {
                    let is_first = number == 1 && runs.is_empty();
                    for (seed_number, seed) in (1..).zip(&seeds[..if is_first { seeds.len() } else { 1 }]) {
                        let mut single = rest.clone();
                        single.extend(one(files_key, &file));
                        single.extend(one("variant", &variant));
                        single.extend(point.clone().map(|point| ("grid".to_owned(), Value::Table(point))));
                        single.extend(one("profiles", &profile));
                        single.extend(one("seeds", seed));
                        let numbers =
                            [number, file_number, variant_number, point_number, profile_number, seed_number];
                        runs.push(Run {
                            place: numbers.map(|number: usize| number.to_string()).join("."),
                            spelling: spelling(&single),
                            entry: single,
                        });
                    }
                }
            }
        }
    }
    runs
}

/// First seeds of an entry, of a list or of a range; a single `None` without any.
fn seeds(entry: &Table) -> Vec<Option<Value>> {
    let number = |range: &Value, key: &str| range.get(key).and_then(Value::as_integer);
    let mut seeds = match entry.get("seeds") {
        Some(range @ Value::Table(_)) => match (number(range, "from"), number(range, "to")) {
            (Some(from), Some(to)) => (from..=to).take(MAX_SEEDS).map(|seed| Some(seed.into())).collect(),
            _ => vec![None],
        },
        _ => or_none(entry, "seeds"),
    };
    seeds.truncate(MAX_SEEDS);
    seeds
}

/// Values of a list, or a single `None` without any.
fn or_none(entry: &Table, key: &str) -> Vec<Option<Value>> {
    match entry.get(key).and_then(Value::as_array) {
        Some(list) if !list.is_empty() => list.iter().cloned().map(Some).collect(),
        _ => vec![None],
    }
}

/// Points of a grid, each a grid with lists of one value, the last key changing fastest; a single `None` without a grid.
fn points(grid: &Table, zip: bool) -> Vec<Option<Table>> {
    let lengths = lengths(grid);
    let Some(first) = lengths.first() else { return vec![None] };
    let count = if zip { *first } else { lengths.iter().product() };
    let point = |number: usize| {
        let mut rest = number;
        let mut chosen = vec![number; lengths.len()];
        for (index, length) in chosen.iter_mut().zip(&lengths).rev().filter(|_| !zip) {
            (*index, rest) = (rest % length, rest / length);
        }
        Some(at(grid, &mut chosen.into_iter()))
    };
    (0..count).map(point).collect()
}

/// Lengths of the lists of a grid and of the tables in it.
fn lengths(grid: &Table) -> Vec<usize> {
    let of_value = |value: &Value| match value {
        Value::Array(list) => vec![list.len()],
        Value::Table(inner) => lengths(inner),
        _ => Vec::new(),
    };
    grid.values().flat_map(of_value).collect()
}

/// Grid with only the chosen value of each list.
fn at(grid: &Table, chosen: &mut impl Iterator<Item = usize>) -> Table {
    let mut point = grid.clone();
    for (_, value) in &mut point {
        match value {
            Value::Array(list) => {
                *list = chosen.next().and_then(|index| list.get(index)).cloned().into_iter().collect()
            }
            Value::Table(inner) => *inner = at(inner, chosen),
            _ => {}
        }
    }
    point
}

fn spelling(entry: &Table) -> String {
    let first = |key: &str| entry.get(key)?.as_array()?.first().cloned();
    let file = FILES.into_iter().find_map(first);
    let stem = |path: &str| Path::new(path).file_stem().map(|stem| stem.to_string_lossy().into_owned());
    let label =
        first("variant").and_then(|variant| variant.get("label").cloned()).or(entry.get("label").cloned());
    let text = |value: &Value| value.as_str().map(str::to_owned);
    let words = [
        file.and_then(|path| stem(path.as_str()?)),
        label.as_ref().and_then(text),
        entry.get("grid").map(ToString::to_string),
        first("profiles").as_ref().and_then(text),
        first("seeds").map(|seed| format!("seed {seed}")),
    ];
    words.into_iter().flatten().collect::<Vec<_>>().join(", ")
}

/// Adds settings behind all others.
fn add_settings(entry: &mut Table, settings: &[String]) {
    let variant = entry.get_mut("variant").and_then(|list| list.get_mut(0)).and_then(Value::as_table_mut);
    let last = if let Some(variant) = variant { variant } else { entry };
    let list = last.entry("override").or_insert_with(|| Value::Array(Vec::new()));
    if let Value::Array(list) = list {
        list.extend(settings.iter().map(|setting| setting.as_str().into()));
    }
}

/// Path without `..` and `.`; a link in it is not followed.
fn plain(path: &Path) -> PathBuf {
    let mut plain = PathBuf::new();
    for part in path.components() {
        match part {
            Component::CurDir => {}
            Component::ParentDir => {
                plain.pop();
            }
            other => plain.push(other),
        }
    }
    plain
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test")]
mod tests {
    use super::Suite;
    use crate::shipped::shipped;
    use opspace_experiment::Files;
    use std::os::unix::fs::symlink;
    use std::path::{Path, PathBuf};

    fn places(suite: &str) -> Vec<(String, String)> {
        let runs = Suite::parse(suite).unwrap().runs;
        runs.into_iter().map(|run| (run.place, run.spelling)).collect()
    }

    /// Compared: the entry of a suite, and the single runs that it means.
    #[test]
    fn entries_are_expanded() {
        let suite = r#"
            title = "a"
            profiles = ["p"]
            grid = { "x" = [1, 2], y = { z = ["b"] } }
            [[run]]
            tasks = ["../a.toml", "b.toml"]
            seeds = { from = 3, to = 4 }
            [[run]]
            experiments = ["c.toml"]
            profiles = []
            grid = { u = [1, 2], v = [3, 4] }
            grid_mode = "zip"
            seeds = [7, 8]
            variant = [{ label = "one", override = [] }, { label = "two", override = [] }]
        "#;
        let expected = [
            ("1.1.1.1.1.1", "a, { x = [1], y = { z = [\"b\"] } }, p, seed 3"),
            ("1.1.1.1.1.2", "a, { x = [1], y = { z = [\"b\"] } }, p, seed 4"),
            ("1.1.1.2.1.1", ""),
            ("1.2.1.1.1.1", "b, { x = [1], y = { z = [\"b\"] } }, p, seed 3"),
            ("1.2.1.2.1.1", ""),
            ("2.1.1.1.1.1", "c, one, { u = [1], v = [3] }, seed 7"),
            ("2.1.1.2.1.1", "c, one, { u = [2], v = [4] }, seed 7"),
            ("2.1.2.1.1.1", ""),
            ("2.1.2.2.1.1", "c, two, { u = [2], v = [4] }, seed 7"),
        ];
        let places = places(suite);
        assert_eq!(places.len(), expected.len());
        for ((place, spelling), expected) in places.iter().zip(expected) {
            assert_eq!(place, expected.0);
            assert!(expected.1.is_empty() || spelling == expected.1, "{spelling:?}");
        }
        for wrong in ["title = 1", "run = 1", "run = [1]"] {
            assert!(Suite::parse(wrong).is_err(), "{wrong}");
        }
    }

    /// Settings of the runs of a suite, in order; and whether each run has a file of its own.
    fn settings(path: &Path) -> (Vec<String>, bool) {
        let suite = opspace_suite::Suite::load(Files::Disk, path).unwrap();
        let runs = suite.runs.iter().map(|run| {
            let text = match run.single() {
                Some(experiment) => format!(
                    "{:?} {:?} {} {}",
                    experiment.options(),
                    experiment.settings(),
                    experiment.task().source.text(),
                    experiment.robot().source.text()
                ),
                None => format!("{:?} {:?} {}", run.label, run.settings, run.source.text()),
            };
            (text, run.source.name().to_owned())
        });
        let (settings, mut files): (Vec<_>, Vec<_>) = runs.unzip();
        files.sort();
        (settings, files.windows(2).all(|pair| pair[0] != pair[1]))
    }

    /// Checks that the runs of bench of a suite of the checkout are those of its single runs.
    fn assert_same_runs(checkout: &Path, path: &Path) {
        let suite = Suite::parse(&std::fs::read_to_string(checkout.join(path)).unwrap()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let single = folder.path().join("single.toml");
        suite.write(&single, checkout, path, &[]).unwrap();
        let (single, are_apart) = settings(&single);
        assert!(are_apart, "{}: `opspace bench` keeps the log of one run of each file", path.display());
        let (all, _) = settings(&checkout.join(path));
        // In the same order; those with further seeds are left out.
        let mut rest = all.iter();
        assert!(single.iter().all(|run| rest.any(|other| other == run)), "{}", path.display());
        assert_eq!(single.len(), suite.runs.len());
    }

    fn project() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().unwrap()
    }

    /// Compared: the runs that `opspace bench` makes of a suite, and those that it makes of the single runs. Suites with
    /// many runs are left out, which take long to read.
    #[test]
    fn single_runs_are_those_of_bench() {
        let files = shipped(&project()).unwrap();
        for name in ["collisions.toml", "features.toml", "limits.toml"] {
            assert_same_runs(&project(), &files.iter().find(|file| file.name == name).unwrap().path);
        }
    }

    /// Compared: the same of suites with every key.
    #[test]
    fn single_runs_of_grids_are_those_of_bench() {
        let checkout = tempfile::tempdir().unwrap();
        for folder in ["tasks", "robots"] {
            symlink(project().join(folder), checkout.path().join(folder)).unwrap();
        }
        let files = shipped(&project()).unwrap();
        let file = |name: &str| {
            let path = &files.iter().find(|file| file.name == name).unwrap().path;
            path.display().to_string().replace("robot.toml", "")
        };
        let tasks = format!(
            r#"
            title = "a"
            profiles = ["a-med", "b-soft"]
            grid = {{ "robot.simulated.true_over_nominal.kp" = [1.0, 1.1], "settle_s" = [0.5, 0.6] }}
            [[run]]
            tasks = ["./{0}"]
            backend = "torque"
            controller = "osc"
            seeds = {{ from = 2, to = 4 }}
            variant = [{{ label = "p", override = ["duration_s=2.0"] }}, {{ label = "q", override = [] }}]
            [[run]]
            tasks = ["{0}", "{1}"]
            robot = "{2}"
            backend = "position"
            transformer = "emulation"
            profiles = ["b-soft"]
            seeds = [5, 6]
            label = "more"
            override = ["robot.profile.{{profile}}.delay_servo_ticks=1"]
            grid = {{ settle_s = [0.5, 0.6], robot = {{ simulated = {{ true_over_nominal = {{ kp = [1.0, 1.2] }} }} }} }}
            grid_mode = "zip"
            "#,
            file("cartesian-tracking.toml"),
            file("joint-tracking.toml"),
            file("asimo-arm/robot.toml"),
        );
        let robots = format!(
            r#"
            title = "a"
            [[run]]
            experiments = ["{0}"]
            profiles = ["b-soft"]
            grid = {{ "robots.leader.backend" = ["position", "torque"] }}
            variant = [{{ label = "p", override = ["duration_s=2.0"] }}]
            "#,
            file("teleop-free.toml"),
        );
        for (name, suite) in [("tasks.toml", tasks), ("robots.toml", robots)] {
            std::fs::write(checkout.path().join(name), suite).unwrap();
            assert_same_runs(checkout.path(), Path::new(name));
        }
    }
}

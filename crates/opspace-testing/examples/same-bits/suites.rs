//! Runs of a suite, with the arguments of `opspace run` for each of them.
//!
//! A separate parser reads the suites, so that files of older checkouts can be read as well. It rejects unknown keys,
//! because an ignored setting could mean that a run is not compared.

use serde::Deserialize;
use serde::de::IgnoredAny;
use std::path::{Path, PathBuf};

/// Suites by file name in `tasks/suites/`.
pub const SUITES: [&str; 12] = [
    "paper",
    "features",
    "servos-matrix",
    "limits",
    "singularity",
    "force",
    "rest",
    "collisions",
    "transformer",
    "stiffness",
    "robustness",
    "servos",
];

const FOLDER: &str = "tasks/suites";

/// Run of a suite, with the first of its seeds.
#[derive(Clone, Debug)]
pub struct Run {
    /// Name of the suite.
    pub suite: String,
    /// Place of the run in the suite, by which the runs of two checkouts are matched: the number of the entry, then
    /// the numbers of task, variant and profile in it, each from 1.
    pub place: String,
    /// Task, variant, profile and seed as written in the suite.
    pub spelling: String,
    /// Arguments of `opspace run`, relative to the checkout's folder.
    pub arguments: Vec<String>,
    /// Number of seeds of the run in the suite.
    #[cfg_attr(not(test), expect(dead_code, reason = "only the test counts the runs of a suite"))]
    pub seeds: usize,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SuiteFile {
    #[serde(rename = "title")]
    _title: IgnoredAny,
    #[serde(default, rename = "columns")]
    _columns: IgnoredAny,
    #[serde(default)]
    profiles: Vec<String>,
    run: Vec<Entry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    tasks: Vec<PathBuf>,
    robot: Option<PathBuf>,
    backend: String,
    controller: String,
    transformer: Option<String>,
    profiles: Option<Vec<String>>,
    #[serde(default)]
    seeds: Vec<u64>,
    #[serde(default, rename = "override", alias = "set")]
    overrides: Vec<String>,
    label: Option<String>,
    #[serde(default, alias = "case")]
    variant: Vec<Variant>,
}

#[derive(Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Variant {
    label: String,
    #[serde(rename = "override", alias = "set")]
    overrides: Vec<String>,
}

/// Lists the runs of a suite of a checkout, in the order of the suite.
///
/// # Errors
/// A suite file that cannot be read, or that has unknown keys.
pub fn runs(checkout: &Path, suite: &str) -> Result<Vec<Run>, String> {
    let path = checkout.join(FOLDER).join(suite).with_extension("toml");
    let wrong = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
    let text = std::fs::read_to_string(&path).map_err(|e| wrong(&e))?;
    let file: SuiteFile = toml::from_str(&text).map_err(|e| wrong(&e))?;
    let mut runs = Vec::new();
    for (number, entry) in (1..).zip(&file.run) {
        let profiles = or_none(entry.profiles.as_ref().unwrap_or(&file.profiles));
        for (task_number, task) in (1..).zip(&entry.tasks) {
            for (variant_number, variant) in (1..).zip(or_none(&entry.variant)) {
                for (profile_number, profile) in (1..).zip(&profiles) {
                    let (variant, profile) = (variant.as_ref(), profile.as_deref());
                    runs.push(Run {
                        suite: suite.to_owned(),
                        place: format!("{number}.{task_number}.{variant_number}.{profile_number}"),
                        spelling: entry.spelling(task, variant, profile),
                        arguments: entry.arguments(task, variant, profile),
                        seeds: entry.seeds.len().max(1),
                    });
                }
            }
        }
    }
    Ok(runs)
}

impl Entry {
    fn spelling(&self, task: &Path, variant: Option<&Variant>, profile: Option<&str>) -> String {
        let task = task.file_stem().map(|stem| stem.to_string_lossy().into_owned());
        let label = variant.map(|variant| &variant.label).or(self.label.as_ref()).cloned();
        let seed = self.seeds.first().map(|seed| format!("seed {seed}"));
        let words = [task, label, profile.map(str::to_owned), seed];
        words.into_iter().flatten().collect::<Vec<_>>().join(", ")
    }

    fn arguments(&self, task: &Path, variant: Option<&Variant>, profile: Option<&str>) -> Vec<String> {
        let mut arguments = vec![from_root(task)];
        let seed = self.seeds.first().map(u64::to_string);
        let given = [
            ("--robot", self.robot.as_deref().map(from_root)),
            ("--backend", Some(self.backend.clone())),
            ("--controller", Some(self.controller.clone())),
            ("--transformer", self.transformer.clone()),
            ("--profile", profile.map(str::to_owned)),
            ("--seed", seed),
        ];
        for (flag, value) in given {
            arguments.extend(value.into_iter().flat_map(|value| [flag.to_owned(), value]));
        }
        for setting in self.overrides.iter().chain(variant.iter().flat_map(|variant| &variant.overrides)) {
            let setting = setting.replace("{profile}", profile.unwrap_or("{profile}"));
            arguments.extend(["--set".to_owned(), setting]);
        }
        arguments
    }
}

/// Converts a path relative to the suite file into a path relative to the checkout.
fn from_root(path: &Path) -> String {
    Path::new(FOLDER).join(path).display().to_string()
}

/// Returns the items of the list, or a single `None` if it is empty.
fn or_none<T: Clone>(list: &[T]) -> Vec<Option<T>> {
    if list.is_empty() { vec![None] } else { list.iter().cloned().map(Some).collect() }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test")]
mod tests {
    use super::{SUITES, runs};
    use opspace_experiment::{Experiment, Files, Suite};
    use std::path::{Path, PathBuf};

    fn checkout() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
    }

    /// Values of a flag in the arguments.
    fn values<'a>(arguments: &'a [String], flag: &str) -> Vec<&'a str> {
        let pairs = arguments[1..].chunks_exact(2);
        pairs.filter(|pair| pair[0] == flag).map(|pair| pair[1].as_str()).collect()
    }

    fn assert_same(arguments: &[String], experiment: &Experiment, robot: Option<&str>) {
        let options = experiment.options();
        let seed = options.seed.map(|seed| seed.to_string());
        let task = checkout().join(&arguments[0]).canonicalize().unwrap();
        assert_eq!(task, Path::new(experiment.task().source.name()).canonicalize().unwrap());
        assert_eq!(values(arguments, "--robot").first().copied(), robot);
        assert_eq!(values(arguments, "--backend"), [options.backend.name()]);
        assert_eq!(values(arguments, "--controller"), [options.controller.name()]);
        let one = |flag| values(arguments, flag).first().copied();
        assert_eq!(one("--transformer"), options.transformer.map(|kind| kind.name()));
        assert_eq!(one("--profile"), options.profile.as_deref());
        assert_eq!(one("--seed"), seed.as_deref());
        assert_eq!(values(arguments, "--set"), experiment.settings());
    }

    /// Suites of experiments with several robots, whose runs have a log for each robot: they are not compared here.
    const OF_SEVERAL_ROBOTS: [&str; 2] = ["teleop", "teleop-matrix"];

    /// The suites with the most runs are left out.
    #[test]
    fn runs_match_those_of_bench() {
        for suite in SUITES
            .into_iter()
            .filter(|suite| !["paper", "transformer", "robustness", "servos-matrix"].contains(suite))
        {
            let runs = runs(&checkout(), suite).unwrap();
            let path = checkout().join("tasks/suites").join(suite).with_extension("toml");
            let bench = Suite::load(Files::Disk, &path).unwrap().experiments;
            assert_eq!(runs.iter().map(|run| run.seeds).sum::<usize>(), bench.len(), "{suite}");
            let mut at = 0;
            for run in &runs {
                assert_same(&run.arguments, &bench[at], None);
                at += run.seeds;
            }
        }
    }

    #[test]
    fn every_suite_of_the_project_is_listed() {
        let mut names: Vec<String> = std::fs::read_dir(checkout().join("tasks/suites"))
            .unwrap()
            .map(|entry| entry.unwrap().path().file_stem().unwrap().to_string_lossy().into_owned())
            .collect();
        let mut known = [&SUITES[..], &OF_SEVERAL_ROBOTS[..]].concat();
        names.sort();
        known.sort_unstable();
        assert_eq!(names, known);
    }
}

//! Suites: lists of tasks with the robots and controllers that execute them, or of experiments with several robots.

use crate::grid::{Grid, GridMode, GridPoint};
use crate::seeds;
use opspace_backend::CommandKind;
use opspace_experiment::codes::Code;
use opspace_experiment::evaluate::results::is_possible;
use opspace_experiment::extensions::Extensions;
use opspace_experiment::files::controller_kind::ControllerKind;
use opspace_experiment::files::explain::did_you_mean;
use opspace_experiment::files::origin::{Files, Kind, beside};
use opspace_experiment::files::source::{FileError, Source, parse};
use opspace_experiment::metrics::columns::{ColumnName, columns_named, default_columns, with_columns};
use opspace_experiment::metrics::metric::Metric;
use opspace_experiment::run::experiment::{Experiment, RunOptions};
use opspace_experiment::run::physics::OWN_PLANT;
use opspace_experiment::run::scenario::Scenario;
use opspace_experiment::transformers::check_name;
use opspace_sim::PhysicsEngine;
use opspace_transformer::TransformerName;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Maximum number of runs of a suite: more are probably a grid that is crossed by mistake.
pub(crate) const MAX_RUNS: usize = 100_000;

/// Contents of a suite file.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct SuiteFile {
    /// Subject of the suite, in one line.
    pub title: String,
    /// Robot profiles with which each run is executed; the default profile if empty.
    #[serde(default)]
    pub profiles: Vec<String>,
    /// Columns of the suite's table. It is an error if no run has a value for one.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "the usual columns")))]
    pub columns: Option<Vec<ColumnName>>,
    /// Values of settings with which each run is executed: `"robot.profile.a-med.servo_ticks_per_cycle" = [1, 2, 5]`.
    #[serde(default)]
    pub grid: Grid,
    /// Combination of the grid's lists: `cross` (all with all) or `zip` (first with first).
    #[serde(default)]
    pub grid_mode: GridMode,
    /// Runs of the suite.
    pub run: Vec<SuiteRun>,
}

/// Runs of a suite that share robot, controller and settings.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct SuiteRun {
    /// Task files; the paths are relative to the suite file. All runs of a suite have tasks, or all have `experiments`.
    #[serde(default)]
    pub tasks: Vec<PathBuf>,
    /// Files of experiments with several robots; the paths are relative to the suite file. Robot, backend, controller and
    /// transformer of each robot are settings: `robots.leader.backend=torque`. `profiles` are those of all robots.
    #[serde(default)]
    pub experiments: Vec<PathBuf>,
    /// Robot that replaces those of the tasks; the path is relative to the suite file.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the task")))]
    pub robot: Option<PathBuf>,
    /// Kind of robot: `position`, `velocity` or `torque`.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of robot.toml")))]
    pub backend: Option<CommandKind>,
    /// Controller: `osc`, `ik` or `ik-lead`.
    #[cfg_attr(feature = "schema", schemars(extend("default" = ControllerKind::Osc)))]
    pub controller: Option<ControllerKind>,
    /// Transformer that replaces the one of the profile.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the profile")))]
    pub transformer: Option<TransformerName>,
    /// Profiles that replace those of the suite.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "those of the suite")))]
    pub profiles: Option<Vec<String>>,
    /// Seeds: each run is executed with each of them; with the seed of its task if empty. A list, or a range that includes
    /// both ends: `{ from = 1, to = 20 }`.
    #[serde(default, deserialize_with = "seeds::seeds")]
    #[cfg_attr(feature = "schema", schemars(schema_with = "seeds::schema"))]
    pub seeds: Vec<u64>,
    /// Grid that replaces the one of the suite.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the suite")))]
    pub grid: Option<Grid>,
    /// Combination of the grid's lists that replaces the one of the suite.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the suite")))]
    pub grid_mode: Option<GridMode>,
    /// Settings as on the command line: those that begin with `robot.` change the robot file, all others the task
    /// file. For experiments, those that begin with the name of a robot are settings of this robot, and all others change
    /// the file of the experiment. `{profile}` is replaced by the name of the profile.
    #[serde(default, rename = "override")]
    pub overrides: Vec<String>,
    /// Name of these settings in the table.
    pub label: Option<String>,
    /// Variants of the runs, each with additional settings; if there are none, the runs are executed without change.
    #[serde(default)]
    pub variant: Vec<SuiteVariant>,
}

/// Additional settings for the runs of a suite.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct SuiteVariant {
    /// Name of the settings in the table.
    pub label: String,
    /// Settings, in the same notation as those of the run.
    #[serde(rename = "override")]
    pub overrides: Vec<String>,
}

/// Suite, read from its files, with all its experiments checked.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Suite {
    /// Text of the suite's file.
    pub source: Source,
    /// Subject of the suite.
    pub title: String,
    /// Columns of the suite's table.
    pub columns: Vec<Metric>,
    /// True if the file lists the columns; false for the default ones.
    pub columns_required: bool,
    /// Runs, in the order of the file: tasks or experiments, then variants, points of the grid, profiles, seeds. All have one
    /// robot, or all have several.
    pub runs: Vec<Scenario>,
}

impl Suite {
    /// Reads a suite and all files that it names.
    ///
    /// # Errors
    /// Mistakes in any of the files, each with its place.
    pub fn load(files: Files, path: &Path) -> Result<Self, FileError> {
        Self::load_with(&Extensions::default(), files, path)
    }

    /// Reads a suite like [`load`](Self::load), with tasks defined by the user.
    ///
    /// # Errors
    /// As [`load`](Self::load).
    pub fn load_with(extensions: &Extensions, files: Files, path: &Path) -> Result<Self, FileError> {
        Self::load_allowing(extensions, files, path, &[])
    }

    /// Reads a suite like [`load_with`](Self::load_with), and allows refusals with these codes in all runs.
    ///
    /// # Errors
    /// As [`load`](Self::load).
    pub fn load_allowing(
        extensions: &Extensions,
        files: Files,
        path: &Path,
        allow: &[Code],
    ) -> Result<Self, FileError> {
        let source = files.read(path)?;
        Kind::Suite.require(&source)?;
        let file: SuiteFile = parse(&source)?;
        check_kinds(&file, &source)?;
        let added = extensions.added::<Metric>();
        let columns_required = file.columns.is_some();
        let columns = match &file.columns {
            Some(names) => columns(names, added, &source)?,
            None => default_columns(added),
        };
        let mut runs = Vec::new();
        for (number, run) in file.run.iter().enumerate() {
            if let Some(name) = &run.transformer {
                let key = ["run", &number.to_string(), "transformer"];
                check_name(extensions, name, &source, key)?;
            }
            runs.extend(run.settings(&file, &source, number, MAX_RUNS - runs.len())?);
        }
        if runs.is_empty() {
            let help = Some("add a [[run]] with tasks or experiments".to_owned());
            return Err(FileError::of_file(source.name(), "this suite has no runs", help));
        }
        let mut scenarios = Vec::new();
        let mut read = HashSet::new();
        for mut run in runs {
            run.options.allow = allow.to_vec();
            let entry = &file.run[run.number];
            let (key, files_of_run) = entry.files();
            let named = beside(path, &files_of_run[run.file]);
            if read.insert((run.number, run.file)) {
                let key = ["run", &run.number.to_string(), key, &run.file.to_string()];
                files.read_named(&named, &source, key)?;
            }
            let robot = entry.robot.as_ref().map(|robot| beside(path, robot));
            let set: Vec<String> = run.settings.iter().map(|(set, _)| set.clone()).collect();
            let has_several = !entry.experiments.is_empty();
            let (paths, options) = ((&*named, robot.as_deref()), run.options.clone());
            let scenario =
                Scenario::load_as(has_several, (extensions, files), paths, run.backend, options, &set);
            scenarios.push(scenario.map_err(|error| run.placed(error, &source))?);
        }
        let suite = Self { source, title: file.title, columns, columns_required, runs: scenarios };
        suite.check_columns()?;
        Ok(suite)
    }

    /// Returns the suite with each run on each of the plants, one after the other; `None` is the library's own plant.
    ///
    /// # Errors
    /// A robot or a scene that an engine cannot simulate.
    pub fn on_plants(self, plants: &[Option<Arc<dyn PhysicsEngine>>]) -> Result<Self, FileError> {
        let pairs = self.runs.iter().flat_map(|run| plants.iter().map(move |plant| (run.clone(), plant)));
        let runs = pairs.map(|(run, plant)| match plant {
            None => Ok(run),
            Some(engine) => run.on_engine(engine),
        });
        Ok(Self { runs: runs.collect::<Result<_, _>>()?, ..self })
    }

    /// True if the runs have several robots.
    #[must_use]
    pub fn has_several_robots(&self) -> bool {
        self.runs.iter().any(|run| run.single().is_none())
    }

    /// Experiments of all robots of all runs, in the order of the file.
    pub fn of_robots(&self) -> impl Iterator<Item = &Experiment> {
        self.runs.iter().flat_map(Scenario::experiments)
    }

    /// SHA-256 of the texts of the suite and of all files that it names, as hexadecimal digits: two suites with equal
    /// fingerprints consist of the same runs. Names of files do not matter.
    #[must_use]
    pub fn fingerprint(&self) -> String {
        let mut hash = hmac_sha256::Hash::new();
        let mut seen = HashSet::new();
        let mut add = |text: &str| {
            if seen.insert(text.to_owned()) {
                hash.update((text.len() as u64).to_le_bytes());
                hash.update(text.as_bytes());
            }
        };
        add(self.source.text());
        let several = self.runs.iter().filter(|run| run.single().is_none());
        several.for_each(|run| add(run.source.text()));
        for experiment in self.of_robots() {
            let (robot, task) = (experiment.robot(), experiment.task());
            for source in
                [&task.source, &robot.source, &robot.urdf].into_iter().chain(task.recordings.values())
            {
                add(source.text());
            }
            if let Some(scene) = experiment.scene() {
                add(&scene.text);
            }
        }
        for refusal in self.of_robots().flat_map(Experiment::allowed) {
            add(&refusal.to_string());
        }
        let plants: Vec<String> = self.of_robots().map(Experiment::plant).collect();
        if plants.iter().any(|plant| plant != OWN_PLANT) {
            add(&plants.join("\n"));
        }
        hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// Refuses a column for which no run can have a value.
    fn check_columns(&self) -> Result<(), FileError> {
        let listed = self.columns.iter().filter(|_| self.columns_required).enumerate();
        for (place, column) in listed.filter_map(|(place, metric)| Some((place, metric.column?))) {
            if let Some(needed) = column.needs.text()
                && !self.of_robots().any(|experiment| is_possible(column.needs, experiment))
            {
                let message = format!("no run of this suite has a value for `{}`", column.name);
                let help = Some(format!("this column needs {needed}"));
                let key = ["columns", &place.to_string()];
                return Err(FileError::at_key(&self.source, key, message, help));
            }
        }
        Ok(())
    }
}

/// Metrics of the columns that a suite lists.
fn columns(names: &[ColumnName], added: &[Metric], source: &Source) -> Result<Vec<Metric>, FileError> {
    columns_named(names.iter().map(|name| name.0.as_str()), added).map_err(|place| {
        let (name, key) = (names[place].0.as_str(), ["columns", &place.to_string()]);
        let known: Vec<&str> = with_columns(added).map(|(_, column)| column.name).collect();
        let help = did_you_mean(name, &known);
        FileError::at_key(source, key, format!("unknown value `{name}`"), Some(help))
    })
}

/// Run of a suite with one value for each choice.
struct SingleRun {
    /// Number of its entry in the file, from 0.
    number: usize,
    /// Number of its task or experiment in this entry, from 0.
    file: usize,
    /// Command interface; that of robot.toml if absent.
    backend: Option<CommandKind>,
    options: RunOptions,
    /// Settings, each with its place in the suite file.
    settings: Vec<(String, Vec<String>)>,
}

impl SuiteRun {
    /// Expands an entry of a suite into at most `most` single runs.
    fn settings(
        &self,
        file: &SuiteFile,
        source: &Source,
        number: usize,
        most: usize,
    ) -> Result<Vec<SingleRun>, FileError> {
        let own = |keys: &[&str]| {
            ["run", &number.to_string()].iter().chain(keys).map(|key| (*key).to_owned()).collect::<Vec<_>>()
        };
        let (grid, place) = match &self.grid {
            Some(grid) => (grid, own(&["grid"])),
            None => (&file.grid, vec!["grid".to_owned()]),
        };
        let points = grid.points(self.grid_mode.unwrap_or(file.grid_mode), source, &place, MAX_RUNS)?;
        let points = or_default(&points.unwrap_or_default());
        let (variants, seeds) = (or_default(&self.variant), or_default(&self.seeds));
        let profiles = or_default(self.profiles.as_ref().unwrap_or(&file.profiles));
        let (_, files) = self.files();
        let counts = [files.len(), variants.len(), points.len(), profiles.len(), seeds.len()];
        if counts.into_iter().fold(1, usize::saturating_mul) > most {
            let message = format!("a suite has at most {MAX_RUNS} runs; with these it has more");
            return Err(FileError::at_key(source, own(&[]), message, None));
        }
        let placed = |set: &[String], keys: &[&str]| {
            let place =
                |k: usize| own(keys).into_iter().chain(["override".to_owned(), k.to_string()]).collect();
            set.iter().enumerate().map(|(k, set)| (set.clone(), place(k))).collect::<Vec<_>>()
        };
        let mut runs = Vec::new();
        for number_of_file in 0..files.len() {
            for (number_of_variant, variant) in variants.iter().enumerate() {
                let further = variant.as_ref().map_or_else(Vec::new, |variant| {
                    placed(&variant.overrides, &["variant", &number_of_variant.to_string()])
                });
                for point in &points {
                    let of_grid = point.iter().flat_map(|point| point.settings.clone());
                    let settings: Vec<_> = placed(&self.overrides, &[])
                        .into_iter()
                        .chain(further.clone())
                        .chain(of_grid)
                        .collect();
                    let label = self.label_of(variant.as_ref(), point.as_ref());
                    for (profile, seed) in
                        profiles.iter().flat_map(|profile| seeds.iter().map(move |seed| (profile, *seed)))
                    {
                        let name = profile.as_deref().unwrap_or("{profile}");
                        let filled = |(set, place): &(String, Vec<String>)| {
                            (set.replace("{profile}", name), place.clone())
                        };
                        let options = RunOptions {
                            controller: self.controller.unwrap_or(ControllerKind::Osc),
                            transformer: self.transformer.clone(),
                            profile: profile.clone(),
                            seed,
                            label: label.clone(),
                            ..RunOptions::default()
                        };
                        let settings = settings.iter().map(filled).collect();
                        let (file, backend) = (number_of_file, self.backend);
                        runs.push(SingleRun { number, file, backend, options, settings });
                    }
                }
            }
        }
        Ok(runs)
    }

    /// Key and paths of the files of this entry.
    fn files(&self) -> (&'static str, &[PathBuf]) {
        if self.experiments.is_empty() { ("tasks", &self.tasks) } else { (EXPERIMENTS, &self.experiments) }
    }

    /// Name of the settings in the table: of the variant or the run, and of the point of the grid.
    fn label_of(&self, variant: Option<&SuiteVariant>, point: Option<&GridPoint>) -> Option<String> {
        let own = variant.map(|variant| variant.label.clone()).or_else(|| self.label.clone());
        let parts: Vec<String> = own.into_iter().chain(point.map(|point| point.label.clone())).collect();
        (!parts.is_empty()).then(|| parts.join(", "))
    }
}

impl SingleRun {
    /// Places an error about a setting at its line in the suite file.
    fn placed(&self, error: FileError, suite: &Source) -> FileError {
        // A setting of a robot of several is read without the name of the robot.
        let of_robot = |text: &str| {
            let end = format!(".{text}");
            self.settings.iter().rfind(|(set, _)| set.ends_with(&end))
        };
        let of_setting =
            |text: &str| self.settings.iter().rfind(|(set, _)| set == text).or_else(|| of_robot(text));
        match error.excerpt().filter(|_| error.line().is_none()).and_then(|(text, _)| of_setting(text)) {
            Some((set, place)) => {
                let message = format!("`{set}`: {}", error.message());
                FileError::at_key(suite, place, message, error.help().map(str::to_owned))
            }
            None => error,
        }
    }
}

/// Key of the experiments with several robots of a run.
const EXPERIMENTS: &str = "experiments";

/// Checks that all runs have tasks or all have experiments with several robots, and that the latter have no keys of the former.
fn check_kinds(file: &SuiteFile, source: &Source) -> Result<(), FileError> {
    let has_several = file.run.first().is_some_and(|run| !run.experiments.is_empty());
    if has_several && file.columns.is_some() {
        let help = Some("remove it: the table of experiments has columns of its own".to_owned());
        let message = "these columns are for suites of tasks, but this one has experiments";
        return Err(FileError::at_key(source, "columns", message, help));
    }
    for (number, run) in file.run.iter().enumerate() {
        let refuse = |key: Option<&str>, message: &str, help: String| {
            let key = ["run".to_owned(), number.to_string()].into_iter().chain(key.map(str::to_owned));
            Err(FileError::at_key(source, key.collect::<Vec<_>>(), message, Some(help)))
        };
        let (tasks, experiments) = (!run.tasks.is_empty(), !run.experiments.is_empty());
        if !tasks && !experiments {
            let help = "add `tasks = [\"TASK.toml\"]` or `experiments = [\"EXPERIMENT.toml\"]`";
            return refuse(None, "this run has neither tasks nor experiments", help.to_owned());
        }
        if tasks && experiments || experiments != has_several {
            let help = "write two suite files, one with `tasks` and one with `experiments`";
            let key = if experiments { EXPERIMENTS } else { "tasks" };
            return refuse(Some(key), "a suite has either tasks or experiments, not both", help.to_owned());
        }
        let of_one_robot = [
            ("robot", run.robot.is_some()),
            ("backend", run.backend.is_some()),
            ("controller", run.controller.is_some()),
            ("transformer", run.transformer.is_some()),
        ];
        if let Some((key, _)) = of_one_robot.into_iter().find(|(_, is_given)| *is_given && experiments) {
            let message = format!("`{key}` is for tasks of one robot, but this run has experiments");
            let help = format!("state it for each robot: `override = [\"robots.NAME.{key}=...\"]`");
            return refuse(Some(key), &message, help);
        }
    }
    Ok(())
}

/// Returns the items of the list, or a single `None` if it is empty.
fn or_default<T: Clone>(list: &[T]) -> Vec<Option<T>> {
    if list.is_empty() { vec![None] } else { list.iter().cloned().map(Some).collect() }
}

#[cfg(test)]
mod tests {
    use super::SuiteFile;
    use opspace_experiment::files::source::{Source, parse};

    #[test]
    fn old_key_error_names_new_key() {
        for (old, new) in [("case", "variant"), ("set", "override")] {
            let source = Source::new("old.toml", format!("[[run]]\n{old} = []\n"));
            let error = parse::<SuiteFile>(&source).map(|_| ()).expect_err("an old key").to_string();
            assert!(error.contains(&format!("unknown key `{old}`: it was renamed to `{new}`")), "{error}");
        }
    }
}

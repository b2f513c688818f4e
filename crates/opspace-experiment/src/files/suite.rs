//! Suites: lists of tasks with the robots and controllers that execute them.

use crate::evaluate::results::{MEASURES, Measure};
use crate::extensions::Extensions;
use crate::files::grid::{Grid, GridMode, GridPoint};
use crate::files::origin::{Files, Kind, beside};
use crate::files::seeds;
use crate::files::source::{FileError, Source, parse};
use crate::run::experiment::{ControllerKind, Experiment, RunOptions};
use crate::run::physics::OWN_PLANT;
use opspace_backend::CommandKind;
use opspace_sim::PhysicsEngine;
use opspace_transformer::TransformerKind;
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
    /// Robot profiles with which each run is executed; the default profile if absent.
    #[serde(default)]
    pub profiles: Vec<String>,
    /// Columns of the suite's table; the default columns if absent. It is an error if no run has a value for one.
    #[serde(default)]
    pub columns: Option<Vec<Measure>>,
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
    /// Task files; the paths are relative to the suite file.
    pub tasks: Vec<PathBuf>,
    /// Robot that replaces those of the tasks; the path is relative to the suite file.
    #[serde(default)]
    pub robot: Option<PathBuf>,
    /// Kind of robot: `position`, `velocity` or `torque`; that of robot.toml if absent.
    #[serde(default)]
    pub backend: Option<CommandKind>,
    /// Controller: `osc`, `ik` or `ik-lead`; `osc` if absent.
    #[serde(default)]
    pub controller: Option<ControllerKind>,
    /// Transformer that replaces the one of the profile.
    #[serde(default)]
    pub transformer: Option<TransformerKind>,
    /// Profiles that replace those of the suite.
    #[serde(default)]
    pub profiles: Option<Vec<String>>,
    /// Seeds: each run is executed with each of them; with the seed of its task if absent. A list, or a range that
    /// includes both ends: `{ from = 1, to = 20 }`.
    #[serde(default, deserialize_with = "seeds::seeds")]
    #[cfg_attr(feature = "schema", schemars(schema_with = "seeds::schema"))]
    pub seeds: Vec<u64>,
    /// Grid that replaces the one of the suite.
    #[serde(default)]
    pub grid: Option<Grid>,
    /// Combination of the grid's lists that replaces the one of the suite.
    #[serde(default)]
    pub grid_mode: Option<GridMode>,
    /// Settings as on the command line: those that begin with `robot.` change the robot file, all others the task
    /// file. `{profile}` is replaced by the name of the profile.
    #[serde(default, rename = "override")]
    pub overrides: Vec<String>,
    /// Name of these settings in the table.
    #[serde(default)]
    pub label: Option<String>,
    /// Variants of the runs, each with additional settings; if absent, the runs are executed without change.
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
    pub columns: Vec<Measure>,
    /// True if the file lists the columns; false for the default ones.
    pub columns_required: bool,
    /// Experiments, in the order of the file: tasks, then variants, points of the grid, profiles, seeds.
    pub experiments: Vec<Experiment>,
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
        let source = files.read(path)?;
        Kind::Suite.require(&source)?;
        let file: SuiteFile = parse(&source)?;
        let mut runs = Vec::new();
        for (number, run) in file.run.iter().enumerate() {
            runs.extend(run.settings(&file, &source, number, MAX_RUNS - runs.len())?);
        }
        if runs.is_empty() {
            let help = Some("add a [[run]] with tasks".to_owned());
            return Err(FileError::of_file(source.name(), "this suite has no runs", help));
        }
        let mut experiments = Vec::with_capacity(runs.len());
        let mut read = HashSet::new();
        for run in runs {
            let SuiteRun { tasks, robot, .. } = &file.run[run.number];
            if read.insert((run.number, run.task)) {
                let key = ["run", &run.number.to_string(), "tasks", &run.task.to_string()];
                files.read_named(&beside(path, &tasks[run.task]), &source, key)?;
            }
            let robot = robot.as_ref().map(|robot| beside(path, robot));
            let experiment = run.load(extensions, files, &beside(path, &tasks[run.task]), robot.as_deref());
            experiments.push(experiment.map_err(|error| run.placed(error, &source))?);
        }
        let columns_required = file.columns.is_some();
        let suite = Self {
            source,
            title: file.title,
            columns: file.columns.unwrap_or_else(|| MEASURES.to_vec()),
            columns_required,
            experiments,
        };
        suite.check_columns()?;
        Ok(suite)
    }

    /// Returns the suite with each experiment on each of the plants, one after the other; `None` is the library's own
    /// plant.
    ///
    /// # Errors
    /// A robot or a scene that an engine cannot simulate.
    pub fn on_plants(self, plants: &[Option<Arc<dyn PhysicsEngine>>]) -> Result<Self, FileError> {
        let mut experiments = Vec::with_capacity(self.experiments.len() * plants.len());
        for experiment in &self.experiments {
            for plant in plants {
                experiments.push(match plant {
                    None => experiment.clone(),
                    Some(engine) => experiment.clone().on_engine(Arc::clone(engine))?,
                });
            }
        }
        Ok(Self { experiments, ..self })
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
        for experiment in &self.experiments {
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
        let plants: Vec<String> = self.experiments.iter().map(Experiment::plant).collect();
        if plants.iter().any(|plant| plant != OWN_PLANT) {
            add(&plants.join("\n"));
        }
        hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// Refuses a column for which no run can have a value.
    fn check_columns(&self) -> Result<(), FileError> {
        for (place, measure) in self.columns.iter().enumerate().filter(|_| self.columns_required) {
            if let Some(needed) = measure.needed()
                && !self.experiments.iter().any(|experiment| measure.is_possible(experiment))
            {
                let message = format!("no run of this suite has a value for `{}`", measure.name());
                let help = Some(format!("this column needs {needed}"));
                let key = ["columns", &place.to_string()];
                return Err(FileError::at_key(&self.source, key, message, help));
            }
        }
        Ok(())
    }
}

/// Run of a suite with one value for each choice.
struct SingleRun {
    /// Number of its entry in the file, from 0.
    number: usize,
    /// Number of its task in this entry, from 0.
    task: usize,
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
        let counts = [self.tasks.len(), variants.len(), points.len(), profiles.len(), seeds.len()];
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
        for task in 0..self.tasks.len() {
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
                            transformer: self.transformer,
                            profile: profile.clone(),
                            seed,
                            label: label.clone(),
                            ..RunOptions::default()
                        };
                        let settings = settings.iter().map(filled).collect();
                        runs.push(SingleRun { number, task, backend: self.backend, options, settings });
                    }
                }
            }
        }
        Ok(runs)
    }

    /// Name of the settings in the table: of the variant or the run, and of the point of the grid.
    fn label_of(&self, variant: Option<&SuiteVariant>, point: Option<&GridPoint>) -> Option<String> {
        let own = variant.map(|variant| variant.label.clone()).or_else(|| self.label.clone());
        let parts: Vec<String> = own.into_iter().chain(point.map(|point| point.label.clone())).collect();
        (!parts.is_empty()).then(|| parts.join(", "))
    }
}

impl SingleRun {
    fn load(
        &self,
        extensions: &Extensions,
        files: Files,
        task: &Path,
        robot: Option<&Path>,
    ) -> Result<Experiment, FileError> {
        let set: Vec<String> = self.settings.iter().map(|(set, _)| set.clone()).collect();
        let backend = match self.backend {
            Some(backend) => backend,
            None => Experiment::declared_command(extensions, files, task, robot, &set)?,
        };
        let options = RunOptions { backend, ..self.options.clone() };
        Experiment::load_with(extensions, files, task, robot, options, &set)
    }

    /// Places an error about a setting at its line in the suite file.
    fn placed(&self, error: FileError, suite: &Source) -> FileError {
        let of_setting = |text: &str| self.settings.iter().rfind(|(set, _)| set == text);
        match error.excerpt().filter(|_| error.line().is_none()).and_then(|(text, _)| of_setting(text)) {
            Some((set, place)) => {
                let message = format!("`{set}`: {}", error.message());
                FileError::at_key(suite, place, message, error.help().map(str::to_owned))
            }
            None => error,
        }
    }
}

/// Returns the items of the list, or a single `None` if it is empty.
fn or_default<T: Clone>(list: &[T]) -> Vec<Option<T>> {
    if list.is_empty() { vec![None] } else { list.iter().cloned().map(Some).collect() }
}

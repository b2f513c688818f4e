//! Suites: lists of tasks with the robots and controllers that execute them.

use crate::evaluate::results::{MEASURES, Measure};
use crate::extensions::Extensions;
use crate::files::origin::{Files, Kind, beside};
use crate::files::source::{FileError, Source, parse};
use crate::run::experiment::{ControllerKind, Experiment, RunOptions};
use opspace_backend::CommandKind;
use opspace_transformer::TransformerKind;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::path::{Path, PathBuf};

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
    /// Columns of the suite's table; the default columns if absent.
    #[serde(default = "every_table")]
    pub columns: Vec<Measure>,
    /// Runs of the suite.
    pub run: Vec<SuiteRun>,
}

fn every_table() -> Vec<Measure> {
    MEASURES.to_vec()
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
    /// Kind of robot: `position`, `velocity` or `torque`.
    pub backend: CommandKind,
    /// Controller: `osc`, `ik` or `ik-lead`.
    pub controller: ControllerKind,
    /// Transformer that replaces the one of the profile.
    #[serde(default)]
    pub transformer: Option<TransformerKind>,
    /// Profiles that replace those of the suite.
    #[serde(default)]
    pub profiles: Option<Vec<String>>,
    /// Seeds: each run is executed with each of them; with the seed of its task if absent.
    #[serde(default)]
    pub seeds: Vec<u64>,
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
    /// Experiments, in the order of the file: tasks, then variants, profiles, seeds.
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
        let mut experiments = Vec::new();
        for (number, run) in file.run.iter().enumerate() {
            let profiles = run.profiles.as_ref().unwrap_or(&file.profiles);
            for (place, task) in run.tasks.iter().enumerate() {
                let key = ["run", &number.to_string(), "tasks", &place.to_string()];
                files.read_named(&beside(path, task), &source, key)?;
                for variant in or_default(&run.variant) {
                    for profile in or_default(profiles) {
                        for seed in or_default(&run.seeds) {
                            let options = run.options(variant.as_ref(), profile.clone(), seed);
                            experiments.push(run.experiment(
                                extensions,
                                files,
                                path,
                                task,
                                variant.as_ref(),
                                options,
                            )?);
                        }
                    }
                }
            }
        }
        if experiments.is_empty() {
            let help = Some("add a [[run]] with tasks".to_owned());
            return Err(FileError::of_file(source.name(), "this suite has no runs", help));
        }
        Ok(Self { source, title: file.title, columns: file.columns, experiments })
    }
}

impl SuiteRun {
    fn options(
        &self,
        variant: Option<&SuiteVariant>,
        profile: Option<String>,
        seed: Option<u64>,
    ) -> RunOptions {
        RunOptions {
            backend: self.backend,
            controller: self.controller,
            transformer: self.transformer,
            profile,
            seed,
            duration_s: None,
            label: variant.map(|variant| variant.label.clone()).or_else(|| self.label.clone()),
        }
    }

    fn experiment(
        &self,
        extensions: &Extensions,
        files: Files,
        suite: &Path,
        task: &Path,
        variant: Option<&SuiteVariant>,
        options: RunOptions,
    ) -> Result<Experiment, FileError> {
        let robot = self.robot.as_ref().map(|robot| beside(suite, robot));
        let further = variant.map_or(&[][..], |variant| &variant.overrides);
        let profile = options.profile.as_deref().unwrap_or("{profile}");
        let set: Vec<String> =
            self.overrides.iter().chain(further).map(|set| set.replace("{profile}", profile)).collect();
        Experiment::load_with(extensions, files, &beside(suite, task), robot.as_deref(), options, &set)
    }
}

/// Returns the items of the list, or a single `None` if it is empty.
fn or_default<T: Clone>(list: &[T]) -> Vec<Option<T>> {
    if list.is_empty() { vec![None] } else { list.iter().cloned().map(Some).collect() }
}

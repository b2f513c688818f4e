//! Suites: lists of tasks, with the robots and controllers on which they run.

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

/// A suite file, as it is written.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct SuiteFile {
    /// Subject of the suite, in one line.
    pub title: String,
    /// Profiles of the robot for each run; its default one if absent.
    #[serde(default)]
    pub profiles: Vec<String>,
    /// Columns of the suite's table; those of every table if absent.
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
    /// Robot in place of the tasks' own; the path is relative to the suite file.
    #[serde(default)]
    pub robot: Option<PathBuf>,
    /// Kind of robot: `position`, `velocity` or `torque`.
    pub backend: CommandKind,
    /// Controller: `osc`, `ik` or `ik-lead`.
    pub controller: ControllerKind,
    /// Transformer in place of the profile's.
    #[serde(default)]
    pub transformer: Option<TransformerKind>,
    /// Profiles in place of the suite's.
    #[serde(default)]
    pub profiles: Option<Vec<String>>,
    /// Seeds, one run for each; the tasks' own if absent.
    #[serde(default)]
    pub seeds: Vec<u64>,
    /// Settings as on the command line: those that begin with `robot.` change the robot file, others the task.
    /// `{profile}` in them stands for the profile's name.
    #[serde(default, rename = "override")]
    pub overrides: Vec<String>,
    /// Name of these settings in the table.
    #[serde(default)]
    pub label: Option<String>,
    /// Variants of the runs, each with further settings; the runs unchanged if absent.
    #[serde(default)]
    pub variant: Vec<SuiteVariant>,
}

/// Further settings for the runs of a suite.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct SuiteVariant {
    /// Name of the settings in the table.
    pub label: String,
    /// Settings, written as those of the run.
    #[serde(rename = "override")]
    pub overrides: Vec<String>,
}

/// A suite, read, with every experiment in it checked.
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

    /// As [`load`](Self::load), with tasks of a user's own.
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

/// Returns each item of the list, or one `None` if it is empty.
fn or_default<T: Clone>(list: &[T]) -> Vec<Option<T>> {
    if list.is_empty() { vec![None] } else { list.iter().cloned().map(Some).collect() }
}

//! Cases of remedies: a task file with settings, its findings, and numbers in printed text.

pub use crate::task_texts::{HAND, TIP};
use opspace_backend::CommandKind;
use opspace_experiment::{Code, Experiment, Files, Finding, Progress, RunOptions, Summary};
use opspace_log::Recording;
use opspace_preflight::diagnostics;
use opspace_transformer::TransformerName;
use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A joint that moves, without findings.
pub const JOINTS: &str = r#"
robot = "ROBOTS/asimo-arm"
duration_s = 2.0
settle_s = 0.5
priority = ["joints"]
start_rad = { elbow = -1.35 }

[task.joints.joint-tracking]
gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }
reference.point-to-point = { goal = { offset_rad = { elbow = 1.0 } }, duration_s = 1.0 }
"#;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Task file with settings and options.
#[derive(Clone)]
pub struct TaskCase {
    text: String,
    settings: Vec<String>,
    options: RunOptions,
}

impl TaskCase {
    /// Returns the case of a text, in which `ROBOTS` is the folder of the robots.
    pub fn of(text: &str) -> Self {
        let text = text.replace("ROBOTS", root().join("robots").to_str().unwrap());
        Self { text, settings: Vec::new(), options: RunOptions::default() }
    }

    /// Returns the case of a task of the project.
    pub fn project(name: &str) -> Self {
        let text = fs::read_to_string(root().join(format!("tasks/{name}.toml"))).unwrap();
        Self::of(&text.replace("../robots", "ROBOTS"))
    }

    /// Returns the case with a setting, `key=value`.
    pub fn set(mut self, setting: impl AsRef<str>) -> Self {
        self.settings.push(setting.as_ref().to_owned());
        self
    }

    /// Returns the case with another part of its text.
    pub fn replace(mut self, old: &str, new: &str) -> Self {
        assert!(self.text.contains(old), "`{old}` is there to be replaced");
        self.text = self.text.replace(old, new);
        self
    }

    /// Returns the case with lines at the end of its text.
    pub fn add(mut self, lines: &str) -> Self {
        self.text = format!("{}\n{lines}\n", self.text);
        self
    }

    pub fn options(mut self, change: impl FnOnce(&mut RunOptions)) -> Self {
        change(&mut self.options);
        self
    }

    pub fn backend(self, backend: CommandKind) -> Self {
        self.options(|options| options.backend = backend)
    }

    pub fn transformer(self, name: &str) -> Self {
        self.options(|options| options.transformer = Some(TransformerName::from(name.to_owned())))
    }

    pub fn experiment(&self) -> Experiment {
        let folder = TempDir::new().unwrap();
        let file = folder.path().join("task.toml");
        fs::write(&file, &self.text).unwrap();
        let experiment = Experiment::load(Files::Disk, &file, None, self.options.clone(), &self.settings);
        experiment.unwrap_or_else(|error| panic!("{error}: {:?}\n{:?}", error.help(), self.settings))
    }

    pub fn found(&self) -> Vec<Finding> {
        diagnostics(&self.experiment())
    }

    /// Returns the only finding with a code.
    pub fn only(&self, code: Code) -> Finding {
        only(code, &self.found())
    }

    /// Checks that each of these cases has neither a finding with the code of this one, nor with another code that this one does
    /// not have.
    pub fn is_helped(&self, code: Code, remedied: &[Self]) {
        let before: Vec<Code> = self.found().iter().map(|finding| finding.code).collect();
        assert!(before.contains(&code), "{code}: {before:?}");
        for (alternative, case) in remedied.iter().enumerate() {
            let after = case.found();
            let is_new = |finding: &&Finding| finding.code == code || !before.contains(&finding.code);
            let new: Vec<&Finding> = after.iter().filter(is_new).collect();
            assert!(new.is_empty(), "{code}, alternative {alternative}: {new:#?}");
        }
    }

    /// Runs the case in simulation.
    pub fn run(&self) -> Summary {
        let experiment = self.experiment();
        let result = experiment.run(Cursor::new(Vec::new()), &Progress::default()).unwrap();
        let recording = Recording::from_bytes(&result.sink.into_inner()).unwrap();
        experiment.summary(&recording, &result.record, None)
    }
}

/// Returns the only finding with a code.
pub fn only(code: Code, found: &[Finding]) -> Finding {
    let coded: Vec<&Finding> = found.iter().filter(|finding| finding.code == code).collect();
    assert_eq!(coded.len(), 1, "{code}: {found:#?}");
    coded[0].clone()
}

/// Text of the value after some words.
pub fn after<'a>(text: &'a str, words: &str) -> &'a str {
    let rest = text.split(words).nth(1).unwrap_or_else(|| panic!("`{words}` in {text}"));
    let end = rest.find([' ', ',', ';', '`', ')', '°']).unwrap_or(rest.len());
    rest[..end].trim_end_matches('.')
}

/// Number after some words.
pub fn number_after(text: &str, words: &str) -> f64 {
    after(text, words).parse().unwrap_or_else(|_| panic!("a number after `{words}` in {text}"))
}

/// Number before some words.
pub fn number_before(text: &str, words: &str) -> f64 {
    let before = text.split(words).next().unwrap();
    before
        .split(' ')
        .next_back()
        .unwrap()
        .parse()
        .unwrap_or_else(|_| panic!("a number before `{words}` in {text}"))
}

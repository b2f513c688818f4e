//! Files and settings stored in a log, from which the experiment can be rebuilt.

use crate::codes::AllowedRefusal;
use crate::extensions::Extensions;
use crate::files::controller_kind::ControllerKind;
use crate::files::overrides;
use crate::files::robot::RobotDefinition;
use crate::files::source::Source;
use crate::files::task::TaskDefinition;
use crate::run::error::RunError;
use crate::run::experiment::{Experiment, RunOptions};
use crate::run::logged_capsules::{read_capsules, write_capsules};
use crate::run::membership::Membership;
use crate::run::physics::{Physics, ReplayedLog};
use opspace_backend::quantity::Positive;
use opspace_backend::{CommandKind, World};
use opspace_log::{Attachment, Header, LOG, Recording};
use opspace_transformer::TransformerName;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Name of the metadata record with the origin of a log.
pub const RUN: &str = "opspace.run";
/// Key of the metadata record for the world of the run: real or simulated.
const WORLD: &str = "world";
/// Entry that states whether the transformer was an option of the run.
pub const ASKED_FOR: &str = "transformer_asked_for";
/// Entry with the refusals that the user has allowed, as JSON; logs of earlier versions have none.
const ALLOWED: &str = "allowed";
/// Entry with the settings of the experiment with several robots.
const EXPERIMENT_OVERRIDES: &str = "experiment_overrides";
const REAL: &str = "real";
const ROBOT_FILE: &str = "robot.toml";
const TASK_FILE: &str = "task.toml";
const URDF_FILE: &str = "robot.urdf";
/// Attachment with the scene of the physics engine.
pub const SCENE_FILE: &str = "scene.xml";
/// File of the experiment with several robots to which the robot belongs, with settings applied.
const EXPERIMENT_FILE: &str = "experiment.toml";
/// Key of the path of that file.
const EXPERIMENT: &str = "experiment";
/// Key of the robot's name in that file.
const EXPERIMENT_ROBOT: &str = "experiment_robot";
/// Generated capsules, because a log does not contain the meshes.
const CAPSULES_FILE: &str = "capsules.json";

/// True if the log was recorded on a real robot.
pub(crate) fn is_real(recording: &Recording) -> bool {
    recording.metadata(RUN).and_then(|entries| entries.get(WORLD)).is_some_and(|world| world == REAL)
}

/// Name of the log attachment with a recorded path; `file` is the path as written in the task file.
fn recording_file(file: &Path) -> String {
    format!("recorded/{}", file.display())
}

impl Experiment {
    /// Returns the experiment on a log in place of a robot; `path` is that of the log. Run it by
    /// [`run_on_log`](Self::run_on_log).
    #[must_use]
    pub fn on_log(mut self, path: impl Into<String>, recording: &Recording) -> Self {
        let real = is_real(recording);
        self.physics = Physics::Replay(ReplayedLog { path: path.into(), real });
        self
    }

    /// Builds the header of a log of this experiment: files, settings and versions.
    pub(crate) fn header(&self, world: World) -> Header {
        let options = self.options();
        let is_real = world == World::Real || matches!(&self.physics, Physics::Replay(log) if log.real);
        let mut entries = BTreeMap::from([
            ("opspace_version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
            ("task".to_owned(), self.task().source.name().to_owned()),
            ("robot".to_owned(), self.robot().source.name().to_owned()),
            (WORLD.to_owned(), if is_real { REAL } else { "simulated" }.to_owned()),
            ("backend".to_owned(), options.backend.name().to_owned()),
            ("controller".to_owned(), options.controller.name().to_owned()),
            ("profile".to_owned(), self.profile().0.to_owned()),
            ("seed".to_owned(), self.seed().to_string()),
            ("duration_s".to_owned(), self.duration_s().to_string()),
            ("servo_hz".to_owned(), self.profile().1.servo_hz.get().to_string()),
            ("interface_hz".to_owned(), (1.0 / self.profile().1.period_s()).to_string()),
            ("overrides".to_owned(), self.settings().join("\n")),
            (ALLOWED.to_owned(), serde_json::to_string(&self.allowed).unwrap_or_default()),
        ]);
        if world == World::Simulated {
            entries.extend(self.physics.entries());
        }
        let transformer = self.chosen_transformer().0.to_string();
        entries.insert("transformer".to_owned(), transformer);
        entries.insert("transformer_reason".to_owned(), self.transformer_reason().unwrap_or_default());
        let asked_for = if options.transformer.is_some() { "yes" } else { "no" };
        entries.insert(ASKED_FOR.to_owned(), asked_for.to_owned());
        let mut files = vec![
            (ROBOT_FILE.to_owned(), "application/toml", &self.robot().source),
            (TASK_FILE.to_owned(), "application/toml", &self.task().source),
            (URDF_FILE.to_owned(), "application/xml", &self.robot().urdf),
        ];
        let recordings = self.task().recordings.iter();
        files.extend(recordings.map(|(file, source)| (recording_file(file), "text/csv", source)));
        let scene =
            self.scene().map(|scene| Source::new(scene.path.display().to_string(), scene.text.clone()));
        files.extend(scene.iter().map(|scene| (SCENE_FILE.to_owned(), "application/xml", scene)));
        if let Some(Membership { robot, experiment, settings }) = self.membership() {
            entries.insert(EXPERIMENT_OVERRIDES.to_owned(), settings.join("\n"));
            entries.insert(EXPERIMENT.to_owned(), experiment.name().to_owned());
            entries.insert(EXPERIMENT_ROBOT.to_owned(), robot.clone());
            files.push((EXPERIMENT_FILE.to_owned(), "application/toml", experiment));
        }
        for (name, _, source) in &files {
            entries.insert(format!("{name}.sha256"), hex(&hmac_sha256::Hash::hash(source.text().as_bytes())));
        }
        let attached = |(name, media, source): (String, &str, &Source)| {
            Attachment::new(name, media, source.text().as_bytes())
        };
        let capsules = self.robot().capsules.as_ref().and_then(|c| write_capsules(&c.generated).ok());
        let capsules = capsules.map(|text| Attachment::new(CAPSULES_FILE, "application/json", text));
        Header {
            metadata: vec![(RUN.to_owned(), entries)],
            attachments: files.into_iter().map(attached).chain(capsules).collect(),
            model: Some(Arc::new(self.robot().model.clone())),
            scene: self.viewer_scene(),
        }
    }

    /// Rebuilds the experiment of a log.
    ///
    /// # Errors
    /// A log that lacks the robot file or the task file, or files that this version of the program rejects.
    pub fn of_log(recording: &Recording) -> Result<Self, RunError> {
        Self::of_log_with(&Extensions::default(), recording)
    }

    /// Rebuilds the experiment of a log like [`of_log`](Self::of_log), with tasks defined by the user.
    ///
    /// # Errors
    /// As [`of_log`](Self::of_log).
    pub fn of_log_with(extensions: &Extensions, recording: &Recording) -> Result<Self, RunError> {
        Self::of_log_changed(extensions, recording, &[])
    }

    /// Rebuilds the experiment of a log like [`of_log_with`](Self::of_log_with), with changes of its files: settings as on
    /// the command line of a run.
    ///
    /// # Errors
    /// As [`of_log`](Self::of_log), and mistakes in `changes`.
    pub fn of_log_changed(
        extensions: &Extensions,
        recording: &Recording,
        changes: &[String],
    ) -> Result<Self, RunError> {
        let (robot_changes, task_changes) = overrides::split(changes, "robot");
        let is_changed = |key: &str| {
            task_changes.iter().any(|change| change.split('=').next().is_some_and(|name| name.trim() == key))
        };
        let entries = recording
            .metadata(RUN)
            .ok_or_else(|| RunError::Incomplete { what: format!("the metadata '{RUN}'") })?;
        check_version(recording)?;
        let entry = |key: &str| {
            entries
                .get(key)
                .map(String::as_str)
                .ok_or_else(|| RunError::Incomplete { what: format!("'{key}' in the metadata '{RUN}'") })
        };
        let generated = match recording.attachment(CAPSULES_FILE) {
            Some(file) => Some(
                read_capsules(&file.data)
                    .map_err(|_| RunError::Incomplete { what: format!("a readable {CAPSULES_FILE}") })?,
            ),
            None => None,
        };
        let robot = RobotDefinition::from_sources_with(
            overrides::apply_below(
                &attached(recording, ROBOT_FILE, entry("robot")?)?,
                "robot",
                &robot_changes,
            )?,
            attached(recording, URDF_FILE, URDF_FILE)?,
            generated,
        )?;
        let task = TaskDefinition::from_sources_with(
            extensions,
            overrides::apply(&attached(recording, TASK_FILE, entry("task")?)?, &task_changes)?,
            |named| attached(recording, &recording_file(named.file), &named.path.display().to_string()),
        )?;
        let allowed = match entries.get(ALLOWED) {
            Some(list) => serde_json::from_str::<Vec<AllowedRefusal>>(list)
                .map_err(|_| RunError::Incomplete { what: format!("a readable '{ALLOWED}'") })?,
            None => Vec::new(),
        };
        let unknown = |key: &str| RunError::Incomplete { what: format!("a known '{key}'") };
        let transformer = TransformerName::from(entry("transformer")?.to_owned());
        let mut options = RunOptions {
            backend: CommandKind::ALL
                .into_iter()
                .find(|kind| entry("backend").is_ok_and(|name| name == kind.name()))
                .ok_or_else(|| unknown("backend"))?,
            controller: ControllerKind::ALL
                .into_iter()
                .find(|kind| entry("controller").is_ok_and(|name| name == kind.name()))
                .ok_or_else(|| unknown("controller"))?,
            transformer: (!entry(ASKED_FOR).is_ok_and(|asked| asked == "no")).then(|| transformer.clone()),
            profile: Some(entry("profile")?.to_owned()),
            seed: Some(entry("seed")?.parse().map_err(|_| unknown("seed"))?),
            label: None,
            allow: allowed.iter().filter_map(|refusal| refusal.code.parse().ok()).collect(),
            duration_s: Some(duration_s(entry("duration_s")?).ok_or_else(|| unknown("duration_s"))?),
        };
        // The options of the run take precedence over the files, except over a change.
        options.seed = options.seed.filter(|_| !is_changed("seed"));
        options.duration_s = options.duration_s.filter(|_| !is_changed("duration_s"));
        let settings: Vec<String> =
            entry("overrides")?.lines().map(str::to_owned).chain(changes.iter().cloned()).collect();
        let mut chosen = Self::new(robot.clone(), task.clone(), options.clone(), settings.clone())?;
        let (physics, membership) =
            (Physics::of_entries(entries, is_real(recording)), Membership::of_log(recording)?);
        chosen.physics = physics.clone();
        chosen.membership = membership.clone();
        chosen.allowed = allowed.clone();
        if !changes.is_empty() || chosen.chosen_transformer().0 == transformer {
            return Ok(chosen);
        }
        // This version would choose another transformer: use the one that was in use when the log was written.
        let options = RunOptions { transformer: Some(transformer), ..options };
        let mut chosen = Self::new(robot, task, options, settings)?;
        (chosen.physics, chosen.membership, chosen.allowed) = (physics, membership, allowed);
        Ok(chosen)
    }
}

impl Membership {
    /// Reads from a log to which experiment with several robots it belongs; `None` if it is the log of a task.
    ///
    /// # Errors
    /// A log that lacks the file of its experiment.
    pub fn of_log(recording: &Recording) -> Result<Option<Self>, RunError> {
        let entry = |key: &str| recording.metadata(RUN).and_then(|entries| entries.get(key));
        let Some((experiment, robot)) = entry(EXPERIMENT).zip(entry(EXPERIMENT_ROBOT)) else {
            return Ok(None);
        };
        let experiment = attached(recording, EXPERIMENT_FILE, experiment)?;
        let settings =
            entry(EXPERIMENT_OVERRIDES).map_or("", String::as_str).lines().map(str::to_owned).collect();
        Ok(Some(Self { robot: robot.clone(), experiment, settings }))
    }
}

/// Reads a duration as a task file does: a finite number above 0, s.
fn duration_s(text: &str) -> Option<f64> {
    text.parse().ok().and_then(|duration_s: f64| Positive::try_from(duration_s).ok()).map(Positive::get)
}

/// Extracts a file from a log, under its original name.
fn attached(recording: &Recording, file: &str, name: &str) -> Result<Source, RunError> {
    let missing = || RunError::Incomplete { what: format!("the attached {file}") };
    let attachment = recording.attachment(file).ok_or_else(missing)?;
    let text = String::from_utf8(attachment.data.clone()).map_err(|_| missing())?;
    Ok(Source::new(name, text))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

/// Rejects a log of another minor version, because the meaning of its rows or files may differ.
fn check_version(recording: &Recording) -> Result<(), RunError> {
    let own = env!("CARGO_PKG_VERSION");
    let minor = |version: &str| version.rsplit_once('.').map(|(minor, _)| minor.to_owned());
    let written = recording.metadata(LOG).and_then(|log| log.get("version")).map_or("", String::as_str);
    if minor(written) == minor(own) {
        return Ok(());
    }
    Err(RunError::Version { written: written.to_owned(), own })
}

//! A run of an experiment into a log, and what is said of it.

use crate::evaluate::metrics::{Metrics, Timing, metrics, timing};
use crate::files::robot::Robot;
use crate::files::source::{FileError, Source};
use crate::files::task::Task;
use crate::run::experiment::{BackendKind, Choice, ControllerKind, Experiment};
use opspace_backend::Sink;
use opspace_log::{
    Attachment, Channel, Header, LogError, Pace, Recorder, Recording, Writer, Written, record,
};
use opspace_loop::{Ending, Phase};
use opspace_transformer::TransformerKind;
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Instant;
use thiserror::Error;

/// Name of the metadata record in which a log keeps how it was made.
pub const RUN: &str = "opspace.run";
const ROBOT_FILE: &str = "robot.toml";
const TASK_FILE: &str = "task.toml";
const URDF_FILE: &str = "robot.urdf";

/// The attachment in which a log keeps a recorded path, by the path as the task file gives it.
fn recording_file(file: &Path) -> String {
    format!("recorded/{}", file.display())
}

/// What can go wrong with a run.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RunError {
    /// The files.
    #[error(transparent)]
    File(#[from] FileError),
    /// The log.
    #[error(transparent)]
    Log(#[from] LogError),
    /// A log that opspace didn't write, or not all of whose beginning is there.
    #[error("this log lacks {what}, without which its run can't be put together again")]
    Incomplete {
        /// What is missing or can't be understood.
        what: String,
    },
}

/// What is said of a run: a row of a table, and `summary.json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// The task's name.
    pub task: String,
    /// The robot's name.
    pub robot: String,
    /// `position` or `torque`.
    pub backend: String,
    /// `osc`, `ik` or `ik-lead`.
    pub controller: String,
    /// The transformer; `None` where there is none.
    pub transformer: Option<String>,
    /// Why it is that one.
    pub transformer_reason: Option<String>,
    /// The robot's profile.
    pub profile: String,
    /// Servo ticks per interface tick.
    pub ratio: u32,
    /// Of everything random.
    pub seed: u64,
    /// How long the controller was to run, s.
    pub duration_s: f64,
    /// The settings that changed the files.
    pub overrides: Vec<String>,
    /// What a suite calls these settings.
    pub label: Option<String>,
    /// The cause of a stop.
    pub faulted: Option<String>,
    /// When it stopped, s.
    pub fault_time_s: Option<f64>,
    /// Whether it was asked to stop.
    pub interrupted: bool,
    /// Rows lost on the way to the log.
    pub rows_lost: u64,
    /// Interface cycles in which no sample came.
    pub missed_cycles: u64,
    /// How often control was resumed after a dropout.
    pub resumed: u64,
    /// How well it went.
    pub metrics: Metrics,
    /// How long things took: not reproducible.
    pub timing: Timing,
}

/// A finished run.
pub struct Finished<W> {
    /// How it ended.
    pub ending: Ending,
    /// What became of the rows.
    pub written: Written,
    /// The log.
    pub sink: W,
    /// Simulated time over wall time.
    pub realtime_factor: f64,
}

/// What the outside sees of a run, and can do to it, while it goes on.
#[derive(Debug, Default)]
pub struct Watch {
    /// Set to stop the run safely.
    pub interrupt: AtomicBool,
    /// How many ticks are done.
    pub ticks: AtomicU64,
}

/// Rows into a recorder.
struct IntoLog<'a> {
    recorder: Recorder,
    watched: &'a AtomicU64,
    ticks: u64,
}

impl Sink for IntoLog<'_> {
    fn row(&mut self, channel: usize, time_s: f64, row: &[f64]) {
        self.recorder.push(channel, time_s, row);
    }

    fn between_ticks(&mut self) {
        self.ticks += 1;
        self.watched.fetch_add(1, Ordering::Relaxed);
        self.recorder.wait_for_room();
    }
}

impl Experiment {
    /// Runs the experiment in simulation, with its log into `sink`.
    ///
    /// # Errors
    /// A robot that can't be simulated; a log that can't be written.
    pub fn run<W: Write + Send + 'static>(&self, sink: W, watch: &Watch) -> Result<Finished<W>, RunError> {
        let mut backend = self.simulated_backend()?;
        let mut controller = self.controller()?;
        let mut control = self.control_loop(&mut *backend, &mut *controller);
        let profile = self.profile().1;
        let rates = [1.0 / profile.period_s(), 1.0 / profile.period_s(), profile.servo_hz.get()];
        let channels = (control.layouts().into_iter().zip(rates))
            .map(|(layout, rate_hz)| Channel { layout, rate_hz })
            .collect();
        let (recorder, writer): (Recorder, Writer<W>) =
            record(sink, self.header(), channels, Pace::Simulated)?;
        let mut into_log = IntoLog { recorder, watched: &watch.ticks, ticks: 0 };
        let began = Instant::now();
        let ending = control.run(self.duration_s(), &watch.interrupt, &mut into_log);
        let simulated_s = into_log.ticks as f64 * profile.period_s();
        let realtime_factor = simulated_s / began.elapsed().as_secs_f64();
        drop(into_log);
        let (written, sink) = writer.finish()?;
        Ok(Finished { ending, written, sink, realtime_factor })
    }

    /// How many ticks a run has that isn't stopped, those at rest before the start included.
    #[must_use]
    pub fn ticks(&self) -> u64 {
        let total_s = self.duration_s() + self.robot().file.safety.tare_s.get();
        (total_s / self.profile().1.period_s()).round() as u64
    }

    /// What is said of a run of this experiment with that log.
    #[must_use]
    pub fn summary(&self, recording: &Recording, ending: &Ending, realtime_factor: Option<f64>) -> Summary {
        let (missed_cycles, resumed) = continuity(recording);
        let (faulted, fault_time_s) = match ending {
            Ending::Faulted { fault, time_s } => (Some(fault.describe(&self.robot().model)), Some(*time_s)),
            _ => (None, None),
        };
        Summary {
            task: self.task().name(),
            robot: self.robot().name(),
            backend: self.choice().backend.name().to_owned(),
            controller: self.choice().controller.name().to_owned(),
            transformer: self.transformer_kind().map(|kind| kind.name().to_owned()),
            transformer_reason: self.transformer_reason(),
            profile: self.profile().0.to_owned(),
            ratio: self.profile().1.ratio.get(),
            seed: self.seed(),
            duration_s: self.duration_s(),
            overrides: self.settings().to_vec(),
            label: self.choice().label.clone(),
            faulted,
            fault_time_s,
            interrupted: matches!(ending, Ending::Interrupted { .. }),
            rows_lost: recording.dropped(),
            missed_cycles,
            resumed,
            metrics: metrics(self, recording),
            timing: timing(recording, realtime_factor),
        }
    }

    /// What a log of this experiment says before its first row.
    fn header(&self) -> Header {
        let choice = self.choice();
        let mut entries = BTreeMap::from([
            ("opspace_version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
            ("task".to_owned(), self.task().source.name().to_owned()),
            ("robot".to_owned(), self.robot().source.name().to_owned()),
            ("backend".to_owned(), choice.backend.name().to_owned()),
            ("controller".to_owned(), choice.controller.name().to_owned()),
            ("profile".to_owned(), self.profile().0.to_owned()),
            ("seed".to_owned(), self.seed().to_string()),
            ("duration_s".to_owned(), self.duration_s().to_string()),
            ("servo_hz".to_owned(), self.profile().1.servo_hz.get().to_string()),
            ("interface_hz".to_owned(), (1.0 / self.profile().1.period_s()).to_string()),
            ("overrides".to_owned(), self.settings().join("\n")),
        ]);
        let transformer = self.chosen_transformer().0.name().to_owned();
        entries.insert("transformer".to_owned(), transformer);
        entries.insert("transformer_reason".to_owned(), self.transformer_reason().unwrap_or_default());
        let asked_for = if choice.transformer.is_some() { "yes" } else { "no" };
        entries.insert("transformer_asked_for".to_owned(), asked_for.to_owned());
        let mut files = vec![
            (ROBOT_FILE.to_owned(), "application/toml", &self.robot().source),
            (TASK_FILE.to_owned(), "application/toml", &self.task().source),
            (URDF_FILE.to_owned(), "application/xml", &self.robot().urdf),
        ];
        let recordings = self.task().recordings.iter();
        files.extend(recordings.map(|(file, source)| (recording_file(file), "text/csv", source)));
        for (name, _, source) in &files {
            entries.insert(format!("{name}.sha256"), hex(&Sha256::digest(source.text())));
        }
        Header {
            metadata: vec![(RUN.to_owned(), entries)],
            attachments: files
                .into_iter()
                .map(|(name, media, source)| Attachment::new(name, media, source.text().as_bytes()))
                .collect(),
            model: Some(Arc::new(self.robot().model.clone())),
        }
    }

    /// Puts together again the experiment whose log this is.
    ///
    /// # Errors
    /// A log without the files it was made from, or files that today's program refuses.
    pub fn of_log(recording: &Recording) -> Result<Self, RunError> {
        let entries = recording
            .metadata(RUN)
            .ok_or_else(|| RunError::Incomplete { what: format!("the metadata '{RUN}'") })?;
        let entry = |key: &str| {
            entries
                .get(key)
                .map(String::as_str)
                .ok_or_else(|| RunError::Incomplete { what: format!("'{key}' in the metadata '{RUN}'") })
        };
        let robot = Robot::from_sources(
            attached(recording, ROBOT_FILE, entry("robot")?)?,
            attached(recording, URDF_FILE, URDF_FILE)?,
        )?;
        let task = Task::from_sources(attached(recording, TASK_FILE, entry("task")?)?, |named| {
            attached(recording, &recording_file(named.file), &named.path.display().to_string())
        })?;
        let unknown = |key: &str| RunError::Incomplete { what: format!("a '{key}' that is known") };
        let transformer =
            TransformerKind::named(entry("transformer")?).ok_or_else(|| unknown("transformer"))?;
        let choice = Choice {
            backend: [BackendKind::Position, BackendKind::Torque]
                .into_iter()
                .find(|kind| entry("backend").is_ok_and(|name| name == kind.name()))
                .ok_or_else(|| unknown("backend"))?,
            controller: [ControllerKind::Osc, ControllerKind::Ik, ControllerKind::IkLead]
                .into_iter()
                .find(|kind| entry("controller").is_ok_and(|name| name == kind.name()))
                .ok_or_else(|| unknown("controller"))?,
            transformer: (!entry("transformer_asked_for").is_ok_and(|asked| asked == "no"))
                .then_some(transformer),
            profile: Some(entry("profile")?.to_owned()),
            seed: Some(entry("seed")?.parse().map_err(|_| unknown("seed"))?),
            label: None,
            duration_s: Some(entry("duration_s")?.parse().map_err(|_| unknown("duration_s"))?),
        };
        let settings: Vec<String> = entry("overrides")?.lines().map(str::to_owned).collect();
        let chosen = Self::new(robot.clone(), task.clone(), choice.clone(), settings.clone())?;
        if chosen.chosen_transformer().0 == transformer {
            return Ok(chosen);
        }
        // It was the best one to who wrote the log.
        Ok(Self::new(robot, task, Choice { transformer: Some(transformer), ..choice }, settings)?)
    }
}

/// How many cycles a log says were missed, and how often control was resumed.
fn continuity(recording: &Recording) -> (u64, u64) {
    let Some(tick) = recording.channel("tick") else { return (0, 0) };
    let missed = tick.signal("missed_cycles").map_or(0.0, |missed| missed.rows().map(|row| row[0]).sum());
    let resuming = Phase::Resuming.code();
    let resumed = tick.signal("phase").map_or(0, |phase| {
        (1..phase.len()).filter(|&k| phase.row(k)[0] == resuming && phase.row(k - 1)[0] != resuming).count()
    });
    (missed as u64, resumed as u64)
}

/// A file out of a log, under the name it had.
fn attached(recording: &Recording, file: &str, name: &str) -> Result<Source, RunError> {
    let missing = || RunError::Incomplete { what: format!("the attached {file}") };
    let attachment = recording.attachment(file).ok_or_else(missing)?;
    let text = String::from_utf8(attachment.data.clone()).map_err(|_| missing())?;
    Ok(Source::new(name, text))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

//! Section of a page about one run.

pub use crate::collision_moments::{ClosestPair, CollisionMoment, PlacedShape};
use crate::figure::Figure;
use crate::kinds::label_or_settings;
use crate::run_figures::{RunDrawings, RunFigures};
use crate::run_pictures::RunPictures;
use opspace_experiment::evaluate::headline::{headline, operator};
use opspace_experiment::evaluate::notes::final_notes;
use opspace_experiment::evaluate::response_sentences::response_sentences;
use opspace_experiment::evaluate::summary::Summary;
use opspace_experiment::run::error::RunError;
use opspace_experiment::run::experiment::Experiment;
use opspace_experiment::run::log_header;
use opspace_experiment::run::physics::OWN_PLANT;
use opspace_experiment::text::capitalised;
use opspace_log::{LogFile, RECOVERED, Recording};
use opspace_sim::{EnvironmentObjectParameters, WorldAxis};
use opspace_transformer::VelocitySource;

/// Section of a page about one run, with all its figures.
#[derive(Clone, Debug)]
pub struct RunSection {
    /// Title of the run among others, in one line: task, robot, controller, transformer, profile and seed.
    pub title: String,
    /// Title of a page about this run alone: a sentence.
    pub sentence: String,
    /// Sentences about the result of the run.
    pub story: Vec<String>,
    /// Summary of the run.
    pub summary: Summary,
    /// Figures of the run.
    pub figures: Vec<Figure>,
    /// Links of the arm at the start, where they are farthest from it, and at the end; `None` if the log has no control cycle.
    pub arm: Option<CollisionMoment>,
    /// Collision geometry at the start, at the least distance and at the end; empty if the experiment keeps no distances.
    pub collisions: Vec<CollisionMoment>,
    /// Moving picture, for a page about this run alone; `None` if nothing can be shown.
    pub(crate) pictures: Option<RunPictures>,
    /// Start of the statistics, s after the start of control.
    pub(crate) settle_s: f64,
    /// Names of the tasks by priority, then of the joints as in the robot.
    pub(crate) order: Vec<String>,
    /// World axes over which the operator reports force and motion; empty without an operator.
    pub(crate) operator_axes: String,
    /// Warnings about the log: damage, lost rows.
    pub warnings: Vec<String>,
    /// Origin of the run: files, seed, versions.
    pub facts: Vec<(String, String)>,
}

impl RunSection {
    /// Creates the section of a run from its log.
    #[must_use]
    pub fn new(experiment: &Experiment, recording: &Recording, summary: Summary) -> Self {
        let mut figures = RunFigures::new(experiment);
        figures.add(recording, true);
        Self::with_figures(experiment, recording, figures.finish(), summary)
    }

    /// Creates the section of a run from its log, which is read in segments.
    ///
    /// # Errors
    /// If the log can no longer be read.
    pub fn of_file(experiment: &Experiment, log: &LogFile, summary: Summary) -> Result<Self, RunError> {
        let mut figures = RunFigures::new(experiment);
        log.for_each_segment(&mut |segment, is_last| figures.add(segment, is_last))?;
        Ok(Self::with_figures(experiment, log.recording(), figures.finish(), summary))
    }

    fn with_figures(
        experiment: &Experiment,
        recording: &Recording,
        RunDrawings { figures, arm, collisions, pictures }: RunDrawings,
        summary: Summary,
    ) -> Self {
        let mut warnings = Vec::new();
        if let Some(damage) = &recording.damage {
            let shown = if damage.rows_lost { "; only the readable part is shown" } else { "" };
            warnings.push(format!("The log is damaged{shown}: {damage}."));
        }
        if recording.dropped() > 0 {
            warnings.push(format!("{} rows were dropped and are not in the log.", recording.dropped()));
        }
        if recording.metadata(RECOVERED).is_some() {
            warnings.push("The log was recovered from a damaged one: the run may have gone on.".to_owned());
        }
        if let Some(fault) = &summary.faulted {
            let time = summary.fault_time_s.unwrap_or(f64::NAN);
            warnings.push(format!(
                "The run was stopped at {time:.3} s: {fault}. Tables and figures show what was until the stop."
            ));
        }
        warnings.extend(summary.findings.failures().map(|failure| format!("Failure: {failure}.")));
        warnings.extend(
            summary.missed_expectations.iter().map(|missed| format!("Expectation missed: {missed}.")),
        );
        warnings.extend(summary.findings.notes().map(|finding| format!("Note: {finding}.")));
        warnings.extend(final_notes(&summary).iter().map(|note| format!("Note: {note}.")));
        // Entries for a replay; a robot without a transformer has none to be shown.
        let has_transformer = summary.transformer.is_some();
        let is_shown =
            |key: &str| key != log_header::ASKED_FOR && (has_transformer || !key.starts_with("transformer"));
        let metadata = recording.metadata(log_header::RUN).into_iter().flatten();
        let facts = metadata.filter(|(key, value)| is_shown(key) && !value.is_empty());
        let logged = facts.map(|(key, value)| (key.clone(), value.clone()));
        let sentences = summary.real_time.iter().flat_map(|real_time| real_time.sentences());
        let real_time: Vec<(String, String)> =
            ["late commands", "times"].map(str::to_owned).into_iter().zip(sentences).collect();
        let tasks = experiment.task().tasks_of_the_run().into_iter().map(|(name, _)| name.to_owned());
        let joints = experiment.robot().model.joints().iter().map(|joint| joint.name.clone());
        Self {
            title: title(&summary),
            sentence: sentence(&summary),
            story: story(&summary),
            settle_s: experiment.task().file.settle_s.get(),
            order: tasks.chain(joints).collect(),
            operator_axes: operator_axes(experiment),
            figures,
            arm,
            collisions,
            pictures,
            summary,
            warnings,
            facts: logged.chain(real_time).chain(facts_of(experiment)).collect(),
        }
    }
}

/// Facts about an experiment that explain its tables and figures.
fn facts_of(experiment: &Experiment) -> Vec<(String, String)> {
    let file = &experiment.task().file;
    let mut facts = vec![("settle_s".to_owned(), file.settle_s.get().to_string())];
    facts.extend(file.event.iter().map(|event| {
        let contact = event.contact.as_ref().map_or_else(String::new, |contact| {
            format!(", or earlier when the contact of '{}' is {}", contact.task, contact.is.name())
        });
        (format!("event at {} s{contact}", event.time_s.get()), event.set.join("\n"))
    }));
    let velocities = if experiment.velocity_source() == VelocitySource::Observer {
        "estimated by an observer with the model of the arm"
    } else {
        "measured, or filtered differences of measured positions"
    };
    facts.push(("joint velocities".to_owned(), velocities.to_owned()));
    facts
}

/// World axes over which the first operator of an experiment reports force and motion; empty without an operator.
fn operator_axes(experiment: &Experiment) -> String {
    let mut objects = experiment.task().file.environment.values();
    let operator = objects.find_map(|object| match object {
        EnvironmentObjectParameters::Spring(spring) => Some(spring),
        _ => None,
    });
    let name = |axis: &WorldAxis| match axis {
        WorldAxis::X => "x",
        WorldAxis::Y => "y",
        WorldAxis::Z => "z",
    };
    operator
        .map_or_else(String::new, |spring| spring.report.iter().map(name).collect::<Vec<&str>>().join(", "))
}

/// Sentences about the result of a run: the response to forces if there was one, otherwise the first lines of the terminal.
fn story(summary: &Summary) -> Vec<String> {
    let mut response = response_sentences(summary);
    response.extend(operator(summary).map(|text| format!("{}.", capitalised(&text))));
    if !response.is_empty() {
        return response;
    }
    let lines = headline(summary).join(" ").replace("  ", " ");
    vec![format!("{}.", capitalised(&lines))]
}

fn sentence(summary: &Summary) -> String {
    let by = summary.transformer.as_ref().map_or_else(String::new, |t| format!(" through '{t}'"));
    let with = label_or_settings(summary).map_or_else(String::new, |settings| format!(", {settings}"));
    format!(
        "{} robot '{}' runs '{}' with {}{by}{with}",
        capitalised(&summary.backend),
        summary.robot,
        summary.task,
        summary.controller
    )
}

fn title(summary: &Summary) -> String {
    let by = summary.transformer.as_ref().map_or_else(String::new, |t| format!(" through '{t}'"));
    let plant = summary.plant.as_ref().filter(|plant| *plant != OWN_PLANT);
    let plant = plant.map_or_else(String::new, |plant| format!(" on {plant}"));
    let with = label_or_settings(summary).map_or_else(String::new, |settings| format!(", {settings}"));
    format!(
        "{}: {} robot{plant}, {}{by}{with}, {} 1:{}, seed {}",
        summary.task, summary.backend, summary.controller, summary.profile, summary.ratio, summary.seed
    )
}

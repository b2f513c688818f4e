//! Summary of a run: one row of a table, and `summary.json`.

use crate::codes::AllowedRefusal;
use crate::codes::Code;
use crate::evaluate::findings::Findings;
use crate::evaluate::metrics::real_time::RealTimeStatistics;
use crate::evaluate::metrics::{Evaluated, Evaluator, JointMetrics, Metrics, TaskMetrics, Timing};
use crate::files::controller_kind::ControllerKind;
use crate::finding::{Finding, Place};
use crate::run::compliance::compliance;
use crate::run::error::RunError;
use crate::run::expectations;
use crate::run::experiment::Experiment;
use crate::run::log_header::is_real;
use opspace_control::TaskParameters;
use opspace_log::{LogFile, OutcomeRecord, Recording, ReplayedCommands};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The summary of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Summary {
    /// Name of the task.
    pub task: String,
    /// Name of the robot.
    pub robot: String,
    /// Kind of robot: `position`, `velocity` or `torque`.
    pub backend: String,
    /// Controller: `osc`, `ik` or `ik-lead`.
    pub controller: String,
    /// Transformer; `None` if none is used.
    pub transformer: Option<String>,
    /// Reason for the choice of the transformer.
    pub transformer_reason: Option<String>,
    /// Profile of the robot.
    pub profile: String,
    /// Number of servo ticks per interface cycle.
    pub ratio: u32,
    /// Seed of all random numbers.
    pub seed: u64,
    /// True if the robot was simulated.
    pub simulated: bool,
    /// Plant of the simulation: `own`, or name and version of another physics engine, with its scene; `None` if the robot
    /// was real, and in files of earlier versions.
    pub plant: Option<String>,
    /// Keys of robot.toml whose values are assumed: the results rest on them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub assumed: Vec<String>,
    /// Refusals that the user has allowed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub allowed: Vec<AllowedRefusal>,
    /// Intended duration of control, s.
    pub duration_s: f64,
    /// Settings that were applied to the files.
    pub overrides: Vec<String>,
    /// Name of the settings in the table of a suite.
    pub label: Option<String>,
    /// Comparison of the commands with those of the log on which the experiment ran; `None` for any other robot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub replay: Option<Replay>,
    /// Fault that stopped the run; `None` if there was none.
    pub faulted: Option<String>,
    /// Time of the fault, s.
    pub fault_time_s: Option<f64>,
    /// True if a requested stop ended the run.
    pub interrupted: bool,
    /// Time of the stop request, s.
    pub interrupted_time_s: Option<f64>,
    /// Number of rows that were lost before they were written to the log.
    pub rows_lost: u64,
    /// Files that could not be written completely, each with the cause.
    pub not_saved: Vec<String>,
    /// Number of interface cycles without a sample.
    pub missed_cycles: u64,
    /// Number of control cycles in which a streamed target was stale.
    pub stale_target_cycles: u64,
    /// Number of times that control was resumed after a dropout.
    pub resumed: u64,
    /// Expectations of the task file that the run missed.
    pub missed_expectations: Vec<String>,
    /// Findings of the run: failures that no single metric shows, goals that tasks did not reach, moving references that they did
    /// not follow, escapes from singular poses and damping near them, compliant axes that drifted, saturated torques, compliance
    /// that the controller ignores, and damping that the transformer leaves.
    #[serde(flatten)]
    pub findings: Findings,
    /// Metrics of the run.
    pub metrics: Metrics,
    /// Metrics of the tasks that have a priority at the start, by name.
    pub tasks: BTreeMap<String, TaskMetrics>,
    /// Response to external forces of frames that no Cartesian task controls, by the name of the frame: metrics along the axes of
    /// the world by their names, `x_force_max_n`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub frames: BTreeMap<String, BTreeMap<String, f64>>,
    /// Metrics of the joints, by name.
    pub joints: BTreeMap<String, JointMetrics>,
    /// Names of the tasks by priority at the start; empty in files of earlier versions.
    #[serde(default)]
    pub task_order: Vec<String>,
    /// Names of the joints as in the robot; empty in files of earlier versions.
    #[serde(default)]
    pub joint_order: Vec<String>,
    /// Computing times of the run; they are not reproducible.
    pub timing: Timing,
    /// Period, jitter and late cycles of a run on a real robot; they are not reproducible.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub real_time: Option<RealTimeStatistics>,
}

/// Commands of a run on a log, compared with those of the log.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Replay {
    /// Time of the first command that differs from the log in any bit, s after the first sample of the log; `None` if
    /// all are equal. From then on the measurements are not those that the commands would have caused.
    pub commands_part_after_s: Option<f64>,
}

impl Replay {
    /// States what the comparison means, in one sentence.
    #[must_use]
    pub fn text(&self) -> String {
        match self.commands_part_after_s {
            None => "All commands are those of the log, bit for bit.".to_owned(),
            Some(after_s) => format!(
                "Commands differ from those of the log after {after_s:.3} s: from then on this is only a what-if, \
                 because the measurements are those of the log."
            ),
        }
    }
}

impl Summary {
    /// Tasks by priority, with their metrics.
    pub fn ordered_tasks(&self) -> impl Iterator<Item = (&String, &TaskMetrics)> {
        in_order(&self.tasks, &self.task_order)
    }

    /// Joints as in the robot, with their metrics.
    pub fn ordered_joints(&self) -> impl Iterator<Item = (&String, &JointMetrics)> {
        in_order(&self.joints, &self.joint_order)
    }

    /// True if a fault stopped the run, an expectation was missed, or a finding makes it a failure.
    #[must_use]
    pub fn has_failed(&self) -> bool {
        self.faulted.is_some()
            || !self.missed_expectations.is_empty()
            || self.findings.failures().next().is_some()
    }
}

/// Entries in an order of their names; those without a place come last.
fn in_order<'a, T>(
    entries: &'a BTreeMap<String, T>,
    order: &[String],
) -> impl Iterator<Item = (&'a String, &'a T)> {
    let mut entries: Vec<_> = entries.iter().collect();
    entries.sort_by_key(|(name, _)| order.iter().position(|other| other == *name).unwrap_or(order.len()));
    entries.into_iter()
}

impl From<ReplayedCommands> for Replay {
    fn from(commands: ReplayedCommands) -> Self {
        let commands_part_after_s = match commands {
            ReplayedCommands::Equal => None,
            ReplayedCommands::PartAfter(after_s) => Some(after_s),
        };
        Self { commands_part_after_s }
    }
}

impl Experiment {
    /// Computes the summary of a run of this experiment from its log.
    #[must_use]
    pub fn summary(
        &self,
        recording: &Recording,
        outcome: &OutcomeRecord,
        realtime_factor: Option<f64>,
    ) -> Summary {
        let mut evaluator = Evaluator::new(self);
        evaluator.add(recording, true);
        self.summary_of(recording, evaluator.finish(), outcome, realtime_factor)
    }

    /// Computes the summary of a run of this experiment from its log, which is read in segments.
    ///
    /// # Errors
    /// If the log can no longer be read.
    pub fn summary_of_file(
        &self,
        log: &LogFile,
        outcome: &OutcomeRecord,
        realtime_factor: Option<f64>,
    ) -> Result<Summary, RunError> {
        let mut evaluator = Evaluator::new(self);
        log.for_each_segment(&mut |segment, is_last| evaluator.add(segment, is_last))?;
        Ok(self.summary_of(log.recording(), evaluator.finish(), outcome, realtime_factor))
    }

    /// Describes the tasks of the run whose compliance the controller ignores.
    fn ignored_compliance(&self) -> Vec<Finding> {
        let controller = self.options().controller;
        if controller == ControllerKind::Osc {
            return Vec::new();
        }
        let tasks = self.task().tasks_of_the_run().into_iter();
        let text = |(name, task): (&str, &TaskParameters)| {
            let (what, _) = compliance(task)?;
            let controller = controller.name();
            let message = format!("task '{name}': {what} has no effect with controller '{controller}'");
            Some(Finding::of(Code::IgnoredCompliance, Place::Task(name.to_owned()), message))
        };
        tasks.filter_map(|(name, task)| text((name, task))).collect()
    }

    /// Summary of a run from its metrics; `recording` needs no rows.
    pub(crate) fn summary_of(
        &self,
        recording: &Recording,
        evaluated: Evaluated,
        outcome: &OutcomeRecord,
        realtime_factor: Option<f64>,
    ) -> Summary {
        let Evaluated { evaluation, mut findings, interruptions, times, real_time } = evaluated;
        let is_driven = is_real(recording) && !self.is_on_log();
        findings.extend(self.ignored_compliance());
        findings.extend(self.damped_by_servos());
        findings.extend(self.deflected_springs(&evaluation.tasks, outcome));
        if is_real(recording) {
            findings.help_owner();
        }
        Summary {
            task: self.task().name(),
            robot: self.robot().name(),
            backend: self.options().backend.name().to_owned(),
            controller: self.options().controller.name().to_owned(),
            transformer: self.transformer_name().map(|name| name.to_string()),
            transformer_reason: self.transformer_reason(),
            profile: self.profile().0.to_owned(),
            ratio: self.profile().1.servo_ticks_per_cycle.get(),
            seed: self.seed(),
            simulated: !is_real(recording),
            plant: (self.is_on_log() || !is_real(recording)).then(|| self.plant()),
            assumed: self.robot().file.assumed.clone(),
            allowed: self.allowed().to_vec(),
            duration_s: self.duration_s(),
            overrides: self.settings().to_vec(),
            label: self.options().label.clone(),
            replay: outcome.replay.map(Replay::from),
            faulted: outcome.fault.clone(),
            fault_time_s: outcome.time_s.filter(|_| outcome.fault.is_some()),
            interrupted: outcome.interrupted,
            interrupted_time_s: outcome.time_s.filter(|_| outcome.interrupted),
            rows_lost: recording.dropped(),
            not_saved: Vec::new(),
            missed_cycles: interruptions.missed_cycles(),
            stale_target_cycles: interruptions.stale_target_cycles,
            resumed: interruptions.resumed,
            missed_expectations: expectations::missed(self.task(), &evaluation),
            findings,
            metrics: evaluation.metrics,
            tasks: evaluation.tasks,
            frames: evaluation.frames,
            joints: evaluation.joints,
            task_order: self.task().tasks_of_the_run().into_iter().map(|(name, _)| name.to_owned()).collect(),
            joint_order: self.robot().model.joints().iter().map(|joint| joint.name.clone()).collect(),
            timing: times.timing(realtime_factor),
            real_time: real_time.statistics(outcome.real_time.as_ref()).filter(|_| is_driven),
        }
    }
}

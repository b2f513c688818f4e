//! Summary of a run: of one robot, or of several with their couplings.

use crate::evaluate::coupling::CouplingEvaluator;
use crate::evaluate::notes::final_notes;
use crate::evaluate::summary::Summary;
use crate::metrics::coupling_metrics::CouplingMetrics;
use crate::run::coupling_expectations::missed;
use crate::run::scenario::Scenario;
use opspace_backend::signal_names::{TARGET_HOLD, TICK_CHANNEL};
use opspace_control::HoldCause;
use opspace_log::Recording;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};
use serde_json::Value;
use std::collections::BTreeMap;

/// Summary of a run of one robot or several. In JSON, that of one robot is the [`Summary`] of the robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(remote = "Self")]
#[non_exhaustive]
pub struct RunSummary {
    /// Name of the scenario: of one robot, that of its task.
    pub experiment: String,
    /// Name of its settings in the table of a suite.
    pub label: Option<String>,
    /// Settings that were applied to the files; with several robots, without that of the seed.
    #[serde(default)]
    pub overrides: Vec<String>,
    /// Seed of the scenario.
    pub seed: u64,
    /// Metrics of the couplings, by name.
    pub couplings: BTreeMap<String, CouplingMetrics>,
    /// Holds of robots because of others, in order of time.
    pub holds: Vec<RobotHold>,
    /// Expectations of the couplings that the run missed.
    pub missed_expectations: Vec<String>,
    /// Summaries of the robots, by name.
    pub robots: BTreeMap<String, Summary>,
    /// Files about several robots that could not be written completely, each with the cause.
    pub not_saved: Vec<String>,
}

impl From<Summary> for RunSummary {
    fn from(summary: Summary) -> Self {
        Self {
            experiment: summary.task.clone(),
            label: summary.label.clone(),
            overrides: summary.overrides.clone(),
            seed: summary.seed,
            couplings: BTreeMap::new(),
            holds: Vec::new(),
            missed_expectations: Vec::new(),
            robots: BTreeMap::from([(summary.robot.clone(), summary)]),
            not_saved: Vec::new(),
        }
    }
}

impl Serialize for RunSummary {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.single() {
            Some(summary) => summary.serialize(serializer),
            None => Self::serialize(self, serializer),
        }
    }
}

impl<'de> Deserialize<'de> for RunSummary {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = Value::deserialize(deserializer)?;
        let summary = match value.get("robots") {
            Some(_) => Self::deserialize(value),
            None => Summary::deserialize(value).map(Self::from),
        };
        summary.map_err(D::Error::custom)
    }
}

/// Hold of a robot because of another one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct RobotHold {
    /// Robot that was held.
    pub robot: String,
    /// Beginning on the common clock, s.
    pub from_s: f64,
    /// End, s; `None` if it lasted to the end of the run.
    pub until_s: Option<f64>,
    /// Reason: which other robot is held or stopped, or is not heard.
    pub reason: String,
}

impl RunSummary {
    /// Summary of the robot, if there is only one.
    #[must_use]
    pub fn single(&self) -> Option<&Summary> {
        self.robots.values().next().filter(|_| self.robots.len() == 1)
    }

    /// Summaries of the robots of those runs that have only one.
    #[must_use]
    pub fn of_single_robots(runs: &[Self]) -> Vec<Summary> {
        runs.iter().filter_map(Self::single).cloned().collect()
    }

    /// Name of the run in a list: experiment, settings, profiles and seed.
    #[must_use]
    pub fn title(&self) -> String {
        let mut parts = vec![self.experiment.clone()];
        parts.extend(self.label.clone());
        let mut profiles: Vec<String> = self.robots.values().map(|robot| robot.profile.clone()).collect();
        profiles.dedup();
        parts.extend(profiles);
        parts.push(format!("seed {}", self.seed));
        parts.join(", ")
    }

    /// True if a requested stop ended the run.
    #[must_use]
    pub fn is_interrupted(&self) -> bool {
        self.robots.values().any(|robot| robot.interrupted)
    }

    /// Plant of the simulation.
    #[must_use]
    pub fn plant(&self) -> &str {
        self.robots.values().find_map(|robot| robot.plant.as_deref()).unwrap_or_default()
    }

    /// True if both differ only in the seed and in the results.
    #[must_use]
    pub fn is_of_same_settings(&self, other: &Self) -> bool {
        self.experiment == other.experiment
            && self.label == other.label
            && self.overrides == other.overrides
            && self.plant() == other.plant()
    }

    /// Holds that lasted to the end of the run.
    fn held_to_the_end(&self) -> impl Iterator<Item = &RobotHold> {
        self.holds.iter().filter(|hold| hold.until_s.is_none())
    }

    /// True if the run of a robot failed or a robot was held to the end, or an expectation of the experiment was missed.
    #[must_use]
    pub fn has_failed(&self) -> bool {
        !self.missed_expectations.is_empty()
            || self.robots.values().any(Summary::has_failed)
            || self.held_to_the_end().next().is_some()
    }

    /// Faults, failures, holds to the end and missed expectations, each with the name of its robot.
    #[must_use]
    pub fn failures(&self) -> Vec<String> {
        let mut failures = self.missed_expectations.clone();
        failures.extend(self.held_to_the_end().map(|hold| {
            format!("{} was held from {:.3} s to the end: {}", hold.robot, hold.from_s, hold.reason)
        }));
        for (name, robot) in &self.robots {
            if let Some(fault) = &robot.faulted {
                let time_s = robot.fault_time_s.unwrap_or(f64::NAN);
                failures.push(format!("{name} was stopped at {time_s:.3} s: {fault}"));
            }
            failures.extend(robot.findings.failures().map(|failure| format!("{name}: {failure}")));
            failures.extend(robot.missed_expectations.iter().map(|missed| format!("{name}: {missed}")));
        }
        failures
    }

    /// Findings of the robots that are no failures, and their errors at the end, each with the name of its robot.
    #[must_use]
    pub fn notes(&self) -> Vec<String> {
        let of_robot = |(name, robot): (&String, &Summary)| {
            let findings = robot.findings.notes().map(ToString::to_string);
            let all: Vec<String> = findings.chain(final_notes(robot)).collect();
            all.into_iter().map(|note| format!("{name}: {note}")).collect::<Vec<String>>()
        };
        self.robots.iter().flat_map(of_robot).collect()
    }
}

/// Evaluates a scenario while segments of its robots' logs arrive.
pub struct CouplingsEvaluator<'a> {
    scenario: &'a Scenario,
    /// Evaluators of the couplings, in the order of the scenario.
    pub couplings: Vec<CouplingEvaluator<'a>>,
    holds: Vec<RobotHold>,
    /// Cause of the present hold of each robot.
    held: Vec<Option<HoldCause>>,
}

impl<'a> CouplingsEvaluator<'a> {
    /// Creates the evaluator of a scenario, without any segment.
    #[must_use]
    pub fn new(scenario: &'a Scenario) -> Self {
        Self {
            scenario,
            couplings: scenario.couplings.iter().map(|c| CouplingEvaluator::new(scenario, c)).collect(),
            holds: Vec::new(),
            held: vec![None; scenario.members.len()],
        }
    }

    /// Adds the next segment of the log of a robot.
    pub fn add(&mut self, member: usize, recording: &Recording, is_last: bool) {
        self.couplings.iter_mut().for_each(|coupling| coupling.add(member, recording, is_last));
        self.add_holds(member, recording);
    }

    fn add_holds(&mut self, member: usize, recording: &Recording) {
        let Some(tick) = recording.channel(TICK_CHANNEL) else { return };
        let Some(hold) = tick.signal(TARGET_HOLD) else { return };
        let name =
            |robot: usize| self.scenario.members.get(robot).map_or("another robot", |m| m.name.as_str());
        for k in 0..tick.len() {
            let cause = HoldCause::from_code(hold.row(k)[0]);
            if cause == self.held[member] {
                continue;
            }
            let own = name(member);
            if self.held[member].is_some()
                && let Some(last) = self.holds.iter_mut().rfind(|hold| hold.robot == own)
            {
                last.until_s = Some(tick.time_s[k]);
            }
            self.held[member] = cause;
            let reason = match cause {
                None => continue,
                Some(HoldCause::RobotHeld(robot)) => format!("{} is held or stopped", name(robot)),
                Some(HoldCause::RobotSilent(robot)) => format!("nothing arrives from {}", name(robot)),
                Some(_) => "requested".to_owned(),
            };
            self.holds.push(RobotHold {
                robot: own.to_owned(),
                from_s: tick.time_s[k],
                until_s: None,
                reason,
            });
        }
    }

    /// Returns the summary; `robots` are those of the robots, in their order.
    pub fn finish(mut self, robots: Vec<Summary>) -> RunSummary {
        self.holds.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
        let scenario = self.scenario;
        let names = scenario.couplings.iter().map(|coupling| coupling.name.clone());
        let couplings: BTreeMap<_, _> =
            names.zip(self.couplings.iter().map(CouplingEvaluator::finish)).collect();
        RunSummary {
            experiment: scenario.name(),
            label: scenario.label.clone(),
            overrides: scenario.settings.clone(),
            seed: scenario.seed,
            missed_expectations: missed(&scenario.expect, &couplings),
            couplings,
            holds: self.holds,
            robots: scenario.members.iter().map(|member| member.name.clone()).zip(robots).collect(),
            not_saved: Vec::new(),
        }
    }
}

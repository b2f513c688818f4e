//! Metrics of a run, computed only from its log, segment by segment.
//!
//! Statistics cover the time from `settle_s` after the first control cycle to the last control cycle, without the time in which
//! the robot is held and the torque ramp after it; the start of the robot's clock does not matter. Positions are the true ones if the log contains them (simulation), otherwise
//! the measured ones.

mod axis_metrics;
mod chatter;
mod cycles;
mod damped_directions;
mod drifts;
mod escapes;
mod estimates;
pub mod frame_responses;
mod hand;
mod hold_counts;
mod holds;
mod interface_findings;
mod interruptions;
mod joints;
mod limited_references;
mod near_pairs;
mod objects;
pub mod real_time;
pub mod response;
mod ripple;
pub mod run_log;
mod saturated_torques;
pub mod slack;
pub mod task_axes;
pub mod tasks;
pub mod times;
mod torque_errors;
mod unreached_goals;

pub use crate::metrics::metric_tables::{
    Compliance, Contact, ElementError, Evaluation, ForceResponse, JointMetrics, Metrics, PoseErrors, Slack,
    TaskMetrics, Timing,
};

use crate::evaluate::failures::{HeldJoints, failures};
use crate::evaluate::findings::Findings;
use crate::finding::Finding;
use crate::metrics::metric::{LogMetric, Metric};
use crate::run::experiment::Experiment;
use cycles::Cycles;
use damped_directions::DampedDirections;
use escapes::Escapes;
use estimates::Estimates;
use frame_responses::FrameResponses;
use hand::Hand;
use interface_findings::interface_findings;
use interruptions::Interruptions;
use joints::JointTorques;
use limited_references::LimitedReferences;
use objects::Objects;
use opspace_log::Recording;
use real_time::RealTimeCycles;
use run_log::{Control, Run};
use saturated_torques::saturated_torques;
use tasks::Tasks;
use times::CycleTimes;
use torque_errors::TorqueErrors;
use unreached_goals::UnreachedGoals;

/// Computes all metrics of a run from its log.
#[must_use]
pub fn evaluate(experiment: &Experiment, recording: &Recording) -> Evaluation {
    let mut evaluator = Evaluator::new(experiment);
    evaluator.add(recording, true);
    evaluator.finish().evaluation
}

/// Computes the metrics of a run as a whole from its log.
#[must_use]
pub fn metrics(experiment: &Experiment, recording: &Recording) -> Metrics {
    evaluate(experiment, recording).metrics
}

/// Computes the statistics of the control cycles' durations from a log.
#[must_use]
pub fn timing(recording: &Recording, realtime_factor: Option<f64>) -> Timing {
    let mut times = CycleTimes::default();
    times.add(recording);
    times.timing(realtime_factor)
}

/// Metrics of a run while segments of its log arrive.
pub(crate) struct Evaluator<'a> {
    experiment: &'a Experiment,
    control: Control,
    tasks: Tasks,
    torque_errors: TorqueErrors,
    joint_torques: JointTorques,
    cycles: Cycles,
    hand: Option<Hand>,
    frames: FrameResponses<'a>,
    objects: Objects,
    estimates: Estimates,
    held_joints: HeldJoints,
    unreached: UnreachedGoals<'a>,
    limited: LimitedReferences<'a>,
    escapes: Escapes,
    damped: DampedDirections<'a>,
    interruptions: Interruptions,
    times: CycleTimes,
    real_time: RealTimeCycles,
    added: Vec<(&'static str, Box<dyn LogMetric>)>,
}

/// Result of an [`Evaluator`].
pub(crate) struct Evaluated {
    pub(crate) evaluation: Evaluation,
    pub(crate) findings: Findings,
    pub(crate) interruptions: Interruptions,
    pub(crate) times: CycleTimes,
    pub(crate) real_time: RealTimeCycles,
}

impl<'a> Evaluator<'a> {
    pub(crate) fn new(experiment: &'a Experiment) -> Self {
        let added = experiment.task().tables.added::<Metric>().iter();
        Self {
            experiment,
            control: Control::default(),
            tasks: Tasks::new(experiment),
            torque_errors: TorqueErrors::new(experiment),
            joint_torques: JointTorques::new(experiment),
            cycles: Cycles::new(experiment),
            hand: Hand::new(experiment),
            frames: FrameResponses::new(experiment),
            objects: Objects::new(experiment),
            estimates: Estimates::new(experiment),
            held_joints: HeldJoints::new(experiment),
            unreached: UnreachedGoals::new(experiment),
            limited: LimitedReferences::new(experiment),
            escapes: Escapes::default(),
            damped: DampedDirections::new(experiment),
            interruptions: Interruptions::default(),
            times: CycleTimes::default(),
            real_time: RealTimeCycles::new(experiment.profile().1.period_s()),
            added: added.filter_map(|metric| Some((metric.key, metric.start()?))).collect(),
        }
    }

    /// Adds the next segment of the log.
    pub(crate) fn add(&mut self, segment: &Recording, is_last: bool) {
        self.held_joints.add(segment);
        self.interruptions.add(segment);
        self.times.add(segment);
        self.real_time.add(segment);
        let Some(run) = Run::new(self.experiment, segment, &mut self.control, is_last) else {
            self.torque_errors.skip(segment);
            return;
        };
        self.tasks.add(&run);
        self.torque_errors.add(&run);
        self.joint_torques.add(&run);
        self.cycles.add(&run);
        self.unreached.add(&run);
        self.limited.add(&run);
        self.escapes.add(&run);
        self.damped.add(&run);
        self.estimates.add(&run);
        self.objects.add(&run);
        self.frames.add(&run);
        self.added.iter_mut().for_each(|(_, metric)| metric.add(segment, run.settled_ticks()));
        if let Some(hand) = &mut self.hand {
            hand.add(&run);
        }
    }

    /// Returns the metrics; none of them has a value if the log has no control cycle.
    pub(crate) fn finish(mut self) -> Evaluated {
        let mut evaluation = Evaluation::default();
        let untouched = self.tasks.untouched();
        let drifts = self.tasks.drifts(self.experiment);
        if self.control.start_s.is_some() {
            let Evaluation { metrics, tasks, frames, joints } = &mut evaluation;
            let intervals = self.torque_errors.finish(metrics);
            *tasks = self.tasks.finish();
            *joints = self.joint_torques.finish(self.experiment, &intervals);
            let by_priority = self.experiment.task().tasks_of_the_run().into_iter();
            by_priority.filter_map(|(name, _)| tasks.get(name)).for_each(|task| metrics.add_task(task));
            joints.values().for_each(|joint| metrics.add_joint(joint));
            let response;
            (*frames, response) = self.frames.finish();
            if metrics.response == ForceResponse::default() {
                metrics.response = response;
            }
            self.cycles.finish(metrics);
            self.estimates.finish(metrics);
            self.objects.finish(metrics);
            if let Some(hand) = self.hand {
                hand.finish(metrics);
            }
            let added = self.added.into_iter().map(|(key, metric)| (key.to_owned(), metric.finish()));
            metrics.added = added.collect();
        }
        let unreached = self.unreached.finish();
        let failures = failures(&evaluation, untouched, &self.held_joints, &unreached);
        // A task that rests while a slow reference moves is already listed as one that does not reach its goal.
        let is_listed = |limited: &Finding| {
            let covers = |goal: &Finding| {
                let end_s = goal.number("end_s").unwrap_or(f64::INFINITY);
                goal.number("begin_s") <= limited.number("largest_s")
                    && limited.number("largest_s") <= Some(end_s)
            };
            unreached.iter().any(|goal| goal.place == limited.place && covers(goal))
        };
        let mut limited = self.limited.finish();
        limited.retain(|limited| !is_listed(limited));
        let mut findings = Findings::default();
        let interface = interface_findings(&self.interruptions, &evaluation.metrics);
        let saturated = saturated_torques(&evaluation.joints);
        for found in [failures, interface, unreached, limited, self.escapes.finish(), drifts] {
            findings.extend(found);
        }
        findings.extend(saturated);
        // What is said of a task that is held along the same direction is said already.
        let is_said = |damped: &Finding| {
            findings.iter().any(|other| other.place == damped.place && other.causes.singular_along.is_some())
        };
        let mut damped = self.damped.finish();
        damped.retain(|damped| !is_said(damped));
        findings.extend(damped);
        let Self { interruptions, times, real_time, .. } = self;
        Evaluated { evaluation, findings, interruptions, times, real_time }
    }
}

impl Metrics {
    /// Takes the errors of a task where no task of higher priority has any.
    fn add_task(&mut self, task: &TaskMetrics) {
        if self.pose == PoseErrors::default() {
            self.pose = task.pose;
        }
        if self.contact == Contact::default() {
            self.contact = task.contact;
        }
        if self.compliance == Compliance::default() {
            self.compliance = task.compliance;
        }
        if self.response == ForceResponse::default() {
            self.response = task.response;
        }
        if self.slack == Slack::default() {
            self.slack = task.slack;
        }
        self.joint_rms_rad = self.joint_rms_rad.or(task.joint_rms_rad);
    }

    /// Takes the numbers of a joint where they exceed those of all joints before it.
    fn add_joint(&mut self, joint: &JointMetrics) {
        if joint.torque_chatter_rms_nm > self.torque_chatter_rms_nm {
            self.torque_chatter_rms_nm = joint.torque_chatter_rms_nm;
            self.torque_chatter_hz = joint.torque_chatter_hz;
        }
        if joint.torque_error_of_limit > self.torque_error_of_limit_max {
            self.torque_error_of_limit_max = joint.torque_error_of_limit;
        }
    }
}

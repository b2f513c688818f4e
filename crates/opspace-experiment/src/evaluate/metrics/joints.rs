//! Metrics of single joints: a joint with small torques does not disappear beside one with large torques.

use super::chatter::Chatter;
use super::run_log::{Relative, Run, mean};
use crate::evaluate::metric_tables::JointMetrics;
use opspace_backend::signal_names::{TORQUE_DESIRED, TORQUE_SATURATED};
use realfft::RealFftPlanner;
use std::collections::BTreeMap;

/// Largest fraction of missing samples of a spectrum: lost cycles shift its lines.
const MAX_MISSING: f64 = 0.01;

impl Run<'_> {
    /// Computes the metrics of all joints by name, from the torque errors of the interface intervals and from the
    /// desired torques.
    pub(super) fn joints(&self, intervals: &[Relative]) -> BTreeMap<String, JointMetrics> {
        let model = &self.experiment.robot().model;
        let limits = self.experiment.robot().torque_limits();
        let ticks = self.settled(&self.tick.time_s);
        let desired = self.tick.signal(TORQUE_DESIRED);
        let saturated = self.tick.signal(TORQUE_SATURATED);
        let rate_hz = 1.0 / self.experiment.profile().1.period_s();
        let times = &self.tick.time_s[ticks.clone()];
        let duration_s = times.last().zip(times.first()).map_or(0.0, |(last, first)| last - first);
        let is_complete = times.len() as f64 >= (1.0 - MAX_MISSING) * duration_s * rate_hz;
        let mut planner = RealFftPlanner::new();
        let mut all = BTreeMap::new();
        for (j, joint) in model.joints().iter().enumerate() {
            let mut metrics = JointMetrics::default();
            if let Some(interval) = intervals.get(j) {
                let rms = interval.rms();
                metrics.torque_error_rms_nm = rms;
                metrics.torque_error_of_limit =
                    rms.zip(limits.get(j).filter(|limit| limit.is_finite())).map(|(rms, limit)| rms / limit);
                metrics.torque_error_of_desired = interval.get();
            }
            if let Some(desired) = desired.filter(|desired| is_complete && j < desired.elements().len()) {
                let torques: Vec<f64> = ticks.clone().map(|k| desired.row(k)[j]).collect();
                let chatter = Chatter::of(&torques, rate_hz, &mut planner);
                metrics.torque_chatter_rms_nm = chatter.as_ref().map(|chatter| chatter.rms);
                metrics.torque_chatter_hz = chatter.as_ref().map(|chatter| chatter.largest_hz);
            }
            if let Some(saturated) = saturated.filter(|saturated| j < saturated.elements().len()) {
                metrics.torque_saturated_fraction =
                    mean(ticks.clone().map(|k| saturated.row(k)[j]).filter(|value| value.is_finite()));
            }
            all.insert(joint.name.clone(), metrics);
        }
        all
    }
}

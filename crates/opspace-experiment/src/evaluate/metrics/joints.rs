//! Metrics of single joints: a joint with small torques does not disappear beside one with large torques.

use super::chatter::{BLOCK_S, Chatter};
use super::run_log::{Mean, Relative, Run};
use crate::evaluate::spectrum::Welch;
use crate::metrics::metric_tables::JointMetrics;
use crate::run::experiment::Experiment;
use opspace_backend::signal_names::{TORQUE_DESIRED, TORQUE_SATURATED};
use realfft::RealFftPlanner;
use std::collections::BTreeMap;

/// Largest fraction of missing samples of a spectrum: lost cycles shift its lines.
const MAX_MISSING: f64 = 0.01;

/// Desired torques of the joints, over the control cycles.
pub(super) struct JointTorques {
    rate_hz: f64,
    /// Number of control cycles, and the times of the first and the last one, s.
    cycles: u64,
    span_s: Option<[f64; 2]>,
    /// Spectrum of each desired torque.
    spectra: Vec<Welch>,
    /// Fraction of the cycles in which each torque was saturated.
    saturated: Vec<Mean>,
}

impl JointTorques {
    pub(super) fn new(experiment: &Experiment) -> Self {
        let rate_hz = 1.0 / experiment.profile().1.period_s();
        let n = experiment.robot().model.joints().len();
        let mut planner = RealFftPlanner::new();
        let block = (BLOCK_S * rate_hz).round() as usize;
        Self {
            rate_hz,
            cycles: 0,
            span_s: None,
            spectra: (0..n).map(|_| Welch::new(block, &mut planner)).collect(),
            saturated: vec![Mean::default(); n],
        }
    }

    pub(super) fn add(&mut self, run: &Run<'_>) {
        let desired = run.tick.signal(TORQUE_DESIRED);
        let saturated = run.tick.signal(TORQUE_SATURATED);
        for k in run.counted_ticks() {
            let time_s = run.tick.time_s[k];
            self.cycles += 1;
            self.span_s = Some([self.span_s.map_or(time_s, |[first, _]| first), time_s]);
            if let Some(desired) = desired {
                self.spectra
                    .iter_mut()
                    .zip(desired.row(k))
                    .for_each(|(spectrum, torque)| spectrum.add(*torque));
            }
            if let Some(saturated) = saturated {
                let values = self.saturated.iter_mut().zip(saturated.row(k));
                values.filter(|(_, value)| value.is_finite()).for_each(|(mean, value)| mean.add(*value));
            }
        }
    }

    /// Returns the metrics of all joints by name; `intervals` are the torque errors over the interface intervals.
    pub(super) fn finish(
        self,
        experiment: &Experiment,
        intervals: &[Relative],
    ) -> BTreeMap<String, JointMetrics> {
        let limits = experiment.robot().torque_limits();
        let duration_s = self.span_s.map_or(0.0, |[first, last]| last - first);
        let is_complete = self.cycles as f64 >= (1.0 - MAX_MISSING) * duration_s * self.rate_hz;
        let mut all = BTreeMap::new();
        let joints = experiment.robot().model.joints().iter().zip(self.spectra).zip(self.saturated);
        for (j, ((joint, spectrum), saturated)) in joints.enumerate() {
            let mut metrics = JointMetrics::default();
            if let Some(interval) = intervals.get(j) {
                let rms = interval.rms();
                metrics.torque_error_rms_nm = rms;
                metrics.torque_error_of_limit =
                    rms.zip(limits.get(j).filter(|limit| limit.is_finite())).map(|(rms, limit)| rms / limit);
                metrics.torque_error_of_desired = interval.get();
            }
            if let Some(spectrum) = spectrum.finish().filter(|_| is_complete) {
                let chatter = Chatter::of(&spectrum, self.rate_hz);
                metrics.torque_chatter_rms_nm = Some(chatter.rms);
                metrics.torque_chatter_hz = chatter.largest_hz;
            }
            metrics.torque_saturated_fraction = saturated.get();
            all.insert(joint.name.clone(), metrics);
        }
        all
    }
}

//! State of the first hole and the first drawer of the environment.

use super::run_log::Run;
use crate::metrics::metric_tables::Metrics;
use crate::run::experiment::Experiment;
use opspace_backend::signal_names::{self, DEPTH, OPENING, TRUTH_CHANNEL};

/// Objects of an experiment that have a state, with what they went through.
pub(super) struct Objects {
    /// Names of the signals of the hole's depth and the drawer's opening.
    depth: Option<String>,
    opening: Option<String>,
    last_depth_m: Option<f64>,
    largest_opening_m: Option<f64>,
}

impl Objects {
    pub(super) fn new(experiment: &Experiment) -> Self {
        let signal = |kind: &str, signal: &'static str| {
            let mut objects = experiment.task().file.environment.iter();
            let (name, _) = objects.find(|(_, object)| object.kind() == kind)?;
            Some(signal_names::of(name, signal))
        };
        Self {
            depth: signal("hole", DEPTH),
            opening: signal("drawer", OPENING),
            last_depth_m: None,
            largest_opening_m: None,
        }
    }

    pub(super) fn add(&mut self, run: &Run<'_>) {
        let Some(truth) = run.recording.channel(TRUTH_CHANNEL) else { return };
        let last = truth.time_s.len().checked_sub(1);
        if let (Some(depth), Some(last)) = (self.depth.as_ref().and_then(|name| truth.signal(name)), last) {
            self.last_depth_m = Some(depth.row(last)[0]);
        }
        if let Some(opening) = self.opening.as_ref().and_then(|name| truth.signal(name)) {
            for k in 0..truth.time_s.len() {
                let opening_m = opening.row(k)[0];
                self.largest_opening_m = Some(self.largest_opening_m.map_or(opening_m, |x| x.max(opening_m)));
            }
        }
    }

    pub(super) fn finish(self, metrics: &mut Metrics) {
        metrics.hole_depth_m = self.last_depth_m;
        metrics.drawer_opening_max_m = self.largest_opening_m;
    }
}

//! Errors of the estimated forces.

use super::run_log::{RmsMax, Run};
use super::tasks::total;
use crate::metrics::metric_tables::Metrics;
use crate::run::experiment::Experiment;
use nalgebra::Vector3;
use opspace_backend::signal_names::{self, WRENCH};

/// Errors of all estimated forces of a robot.
pub(super) struct Estimates {
    forces: Vec<Estimate>,
}

/// Error of one estimated force.
struct Estimate {
    signal: String,
    frame: String,
    error_n: RmsMax,
}

impl Estimates {
    pub(super) fn new(experiment: &Experiment) -> Self {
        let forces = experiment.robot().file.estimated_force.iter().map(|(name, force)| Estimate {
            signal: signal_names::of(name, WRENCH),
            frame: force.frame.clone(),
            error_n: RmsMax::default(),
        });
        Self { forces: forces.collect() }
    }

    pub(super) fn add(&mut self, run: &Run<'_>) {
        for Estimate { signal, frame, error_n } in &mut self.forces {
            let (Some(forces), Some(estimate)) = (run.forces_on(frame), run.tick.signal(signal)) else {
                continue;
            };
            for k in run.counted(run.joints.0) {
                if let Some(row) = run.tick_of(k).map(|tick| estimate.row(tick)) {
                    error_n.add((Vector3::from_column_slice(&row[..3]) - total(&forces, k)).norm());
                }
            }
        }
    }

    /// Sets the metric to that of the least accurate force.
    pub(super) fn finish(self, metrics: &mut Metrics) {
        let errors = self.forces.into_iter().filter_map(|force| force.error_n.rms());
        metrics.estimate_rms_n = errors.max_by(f64::total_cmp);
    }
}

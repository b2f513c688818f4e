//! Acceleration that limits take from a task, over its translations and over its rotations.

use super::run_log::{RmsMax, Run};
use crate::metrics::metric_tables::Slack;
use opspace_backend::signal_names;
use opspace_log::Column;

/// Units of the slack of translations and of rotations.
pub const UNITS: [&str; 2] = ["m/s²", "rad/s²"];

/// Slack of a task while segments of the log arrive: of its translations and of its rotations.
#[derive(Default)]
pub(super) struct SlackOfTask([RmsMax; 2]);

impl SlackOfTask {
    /// Adds the counted cycles in which the task has a priority.
    pub(super) fn add(&mut self, run: &Run<'_>, name: &str) {
        let Some(slack) = run.tick.signal(&signal_names::of(name, signal_names::SLACK)) else { return };
        for (sums, unit) in self.0.iter_mut().zip(UNITS) {
            if has(&slack, unit) {
                let sizes = run.counted_ticks().map(|k| size(&slack, k, unit));
                sizes.filter(|size| size.is_finite()).for_each(|size| sums.add(size));
            }
        }
    }

    pub(super) fn finish(self) -> Slack {
        let [linear, angular] = self.0;
        Slack {
            slack_rms_m_per_s2: linear.rms(),
            slack_max_m_per_s2: linear.max(),
            slack_rms_rad_per_s2: angular.rms(),
            slack_max_rad_per_s2: angular.max(),
        }
    }
}

/// Returns true if elements of a signal have a unit.
pub fn has(slack: &Column<'_>, unit: &str) -> bool {
    slack.units().iter().any(|own| own == unit)
}

/// Norm over the elements of a row that have a unit.
pub fn size(slack: &Column<'_>, k: usize, unit: &str) -> f64 {
    let of_unit = slack.row(k).iter().zip(slack.units()).filter(|(_, own)| *own == unit);
    of_unit.map(|(value, _)| value * value).sum::<f64>().sqrt()
}

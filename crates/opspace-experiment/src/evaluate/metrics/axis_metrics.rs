//! Metrics of single axes of a Cartesian task: errors along its motion axes, and ranges of its motion.

use super::run_log::RmsMax;
use super::task_axes::TaskRow;
use crate::metrics::metric_tables::{error_names, range_name};
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// Metrics of the axes of one task while segments of the log arrive.
#[derive(Default)]
pub(super) struct AxisMetrics {
    /// Errors of the motion axes x, y, z (m), rx, ry, rz (rad).
    errors: [RmsMax; 6],
    /// Position at the first row, m.
    start: Option<Vector3<f64>>,
    /// Least and greatest displacement from there along each axis, m.
    displacements: [Option<(f64, f64)>; 3],
}

impl AxisMetrics {
    /// Adds the errors along the motion axes: those of the position (m) if `first` is 0, of the orientation (rad) if it is 3.
    pub(super) fn add_errors(&mut self, first: usize, error: &Vector3<f64>, motion: &[bool; 6]) {
        for (axis, error) in error.iter().enumerate().filter(|(axis, _)| motion[first + axis]) {
            self.errors[first + axis].add(error.abs());
        }
    }

    /// Adds the position of the controlled frame, in the axes that the task has at this row.
    pub(super) fn add_position(&mut self, row: &TaskRow) {
        let position = row.pose.translation;
        let displacement = row.rotation.tr_mul(&(position - *self.start.get_or_insert(position)));
        for (extent, along) in self.displacements.iter_mut().zip(&displacement) {
            let (least, greatest) = extent.unwrap_or((*along, *along));
            *extent = Some((least.min(*along), greatest.max(*along)));
        }
    }

    /// Returns the metrics by name; those of axes without a value are absent.
    pub(super) fn finish(self) -> BTreeMap<String, f64> {
        let mut metrics = BTreeMap::new();
        for (axis, errors) in self.errors.iter().enumerate() {
            let values = [errors.rms(), errors.max()];
            for (name, value) in error_names(axis).into_iter().zip(values) {
                metrics.extend(value.map(|value| (name, value)));
            }
        }
        for (axis, extent) in self.displacements.into_iter().enumerate() {
            metrics.extend(extent.map(|(least, greatest)| (range_name(axis), greatest - least)));
        }
        metrics
    }
}

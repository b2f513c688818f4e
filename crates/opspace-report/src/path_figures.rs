//! Figures of the path of each Cartesian task in its plane, with the deviation over time.

use crate::figure::{Figure, Panel, Series, Style};
use crate::lines::{COLUMNS, time_panel};
use nalgebra::Vector3;
use opspace_backend::signal_names::{self, REFERENCE};
use opspace_control::{AXIS_NAMES, TaskParameters};
use opspace_experiment::evaluate::metrics::response::keep_every_second;
use opspace_experiment::evaluate::metrics::run_log::{Run, masked_norm};
use opspace_experiment::evaluate::metrics::task_axes::AxesOfTask;
use opspace_experiment::run::experiment::Experiment;
use opspace_experiment::text::format_short;

/// Smallest extent of a path along two axes that is drawn in a plane, m.
const EXTENT_M: f64 = 5e-3;

/// Largest number of samples that are kept.
const MAX_SAMPLES: usize = 4 * COLUMNS;

/// Paths of the Cartesian tasks of a run while segments of its log arrive.
pub(crate) struct PathFigures<'a> {
    paths: Vec<(AxesOfTask, Path<'a>)>,
}

struct Path<'a> {
    name: &'a str,
    samples: Vec<Sample>,
    /// One of so many rows is kept.
    stride: usize,
    rows: usize,
    /// True if all axes of translation follow the reference whenever the task has a priority.
    follows: bool,
}

/// Positions of reference and frame at one time, m.
#[derive(Clone, Copy)]
struct Sample {
    time_s: f64,
    reference: Vector3<f64>,
    position: Vector3<f64>,
    deviation_m: f64,
}

impl<'a> PathFigures<'a> {
    pub(crate) fn new(experiment: &'a Experiment) -> Self {
        let paths = experiment.task().tasks_of_the_run().into_iter().filter_map(|(name, task)| {
            let TaskParameters::Cartesian(task) = task else { return None };
            let controlled = task.controlled_frame(&experiment.robot().model).ok()?;
            let axes = AxesOfTask::new(experiment, name, controlled);
            Some((axes, Path { name, samples: Vec::new(), stride: 1, rows: 0, follows: true }))
        });
        Self { paths: paths.collect() }
    }

    /// Adds the next segment of the log.
    pub(crate) fn add(&mut self, run: &Run<'_>) {
        for (axes, path) in &mut self.paths {
            let Some(reference) = run.tick.signal(&signal_names::of(path.name, REFERENCE)) else { continue };
            for row in axes.rows(run) {
                let (Some(axes), Some(tick)) = (row.axes, run.tick_of(row.k)) else { continue };
                let reference = Vector3::from_column_slice(reference.row(tick));
                if !reference.iter().all(|x| x.is_finite()) {
                    continue;
                }
                let position = row.pose.translation;
                let deviation = row.rotation.tr_mul(&(position - reference));
                path.follows &= axes.motion[..3].iter().filter(|follows| **follows).count() >= 2;
                path.keep(Sample {
                    time_s: run.joints.0[row.k] - run.start_s,
                    reference,
                    position,
                    deviation_m: masked_norm(&deviation, &axes.motion[..3]),
                });
            }
        }
    }

    /// Returns the figure of each task whose reference moves in a plane.
    pub(crate) fn finish(self) -> Vec<Figure> {
        self.paths.iter().filter_map(|(_, path)| path.figure()).collect()
    }
}

impl Path<'_> {
    /// Keeps a sample; of many, every second one is dropped.
    fn keep(&mut self, sample: Sample) {
        self.rows += 1;
        if !(self.rows - 1).is_multiple_of(self.stride) {
            return;
        }
        self.samples.push(sample);
        if self.samples.len() > MAX_SAMPLES {
            keep_every_second(&mut self.samples);
            self.stride *= 2;
        }
    }

    /// Axes of space along which the reference moves most, in their order; `None` if it moves along a line at most.
    fn plane(&self) -> Option<[usize; 2]> {
        let mut axes: Vec<(usize, f64)> = (0..3).map(|axis| (axis, self.extent_m(axis))).collect();
        axes.sort_by(|a, b| b.1.total_cmp(&a.1));
        let mut plane = [axes[0].0, axes[1].0];
        plane.sort_unstable();
        (axes[1].1 >= EXTENT_M && !self.is_straight(plane)).then_some(plane)
    }

    /// Range of the reference along an axis, m.
    fn extent_m(&self, axis: usize) -> f64 {
        let along = || self.samples.iter().map(|sample| sample.reference[axis]);
        along().fold(f64::NEG_INFINITY, f64::max) - along().fold(f64::INFINITY, f64::min)
    }

    /// True if the reference stays on a line of the plane.
    fn is_straight(&self, [a, b]: [usize; 2]) -> bool {
        let Some(first) = self.samples.first() else { return true };
        let from_first = |sample: &Sample| {
            let moved = sample.reference - first.reference;
            [moved[a], moved[b]]
        };
        let length = |[x, y]: [f64; 2]| x.hypot(y);
        let Some(farthest) =
            self.samples.iter().map(from_first).max_by(|one, other| length(*one).total_cmp(&length(*other)))
        else {
            return true;
        };
        let [x, y] = farthest.map(|part| part / length(farthest));
        self.samples.iter().map(from_first).all(|moved| (moved[0] * y - moved[1] * x).abs() < EXTENT_M)
    }

    fn figure(&self) -> Option<Figure> {
        let [a, b] = self.plane().filter(|_| self.follows)?;
        let start = self.samples.first()?.reference;
        let line = |label: &str, style: Style, of: fn(&Sample) -> Vector3<f64>| {
            let mm = |axis: usize| self.samples.iter().map(|s| 1e3 * (of(s) - start)[axis]).collect();
            Series::new(label, mm(a), mm(b)).style(style)
        };
        let path = Panel {
            title: "path".to_owned(),
            x_label: format!("{} (mm)", AXIS_NAMES[a]),
            y_label: format!("{} (mm)", AXIS_NAMES[b]),
            series: vec![
                line("path", Style::Solid, |sample| sample.position),
                line("reference", Style::Desired, |sample| sample.reference),
            ],
            has_equal_scales: true,
            ..Panel::default()
        };
        let time_s = self.samples.iter().map(|sample| sample.time_s).collect();
        let deviation_mm = self.samples.iter().map(|sample| 1e3 * sample.deviation_m).collect();
        let deviation = Series::new("path", time_s, deviation_mm);
        let third =
            (0..3).find(|axis| ![a, b].contains(axis)).filter(|axis| self.extent_m(*axis) >= EXTENT_M);
        let third = third.map_or_else(String::new, |axis| {
            let extent = format_short(1e3 * self.extent_m(axis));
            format!(" It extends over {extent} mm along {}.", AXIS_NAMES[axis])
        });
        Some(Figure {
            title: format!("Path of task '{}'", self.name),
            caption: format!(
                "Path of the frame in the {}-{} plane from its start, and its distance from the reference over the motion axes at each time.{third}",
                AXIS_NAMES[a], AXIS_NAMES[b]
            ),
            panels: vec![path, time_panel("deviation", "distance (mm)", vec![deviation])],
            columns: Some(2),
            overlays: true,
            ..Figure::default()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::{EXTENT_M, Path, Sample};
    use nalgebra::Vector3;

    fn path(reference: impl Fn(f64) -> Vector3<f64>) -> Path<'static> {
        let mut path = Path { name: "hand", samples: Vec::new(), stride: 1, rows: 0, follows: true };
        for k in 0..100_000 {
            let time_s = 1e-4 * f64::from(k);
            let reference = reference(time_s);
            path.keep(Sample { time_s, reference, position: reference, deviation_m: 0.0 });
        }
        path
    }

    /// Checks which references are drawn in a plane, and that few samples of a long run are kept.
    #[test]
    fn references_in_a_plane_have_a_figure() {
        let circle = path(|t| Vector3::new(0.1 * t.cos(), 1e-4 * t, 0.1 * t.sin()));
        assert_eq!(circle.plane(), Some([0, 2]));
        assert!(circle.samples.len() <= super::MAX_SAMPLES && circle.samples.len() > super::MAX_SAMPLES / 4);
        let figure = circle.figure().unwrap_or_default();
        assert_eq!(figure.panels[0].x_label, "x (mm)");
        assert!(path(|t| Vector3::new(0.1, 0.2, 0.1 * t)).figure().is_none(), "along an axis");
        assert!(path(|t| Vector3::new(0.1 * t, -0.2 * t, 0.1)).figure().is_none(), "along a line");
        let small = 0.4 * EXTENT_M;
        assert!(path(|t| small * Vector3::new(t.cos(), t.sin(), 0.0)).figure().is_none(), "small");
    }
}

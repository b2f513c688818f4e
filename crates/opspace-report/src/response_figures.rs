//! Figures of the response to external forces: force over displacement, and both over time.

use crate::figure::{Figure, Panel, Series, Style};
use crate::lines::{COLUMNS, time_panel};
use nalgebra::Vector3;
use opspace_backend::signal_names::{self, REFERENCE};
use opspace_control::{AXIS_NAMES, TaskParameters};
use opspace_experiment::evaluate::metrics::frame_responses::{self, FreeFrame, free_frames};
use opspace_experiment::evaluate::metrics::response::{AxisNumbers, Response, ResponseSample, line};
use opspace_experiment::evaluate::metrics::run_log::Run;
use opspace_experiment::evaluate::metrics::task_axes::AxesOfTask;
use opspace_experiment::evaluate::metrics::tasks::total;
use opspace_experiment::run::experiment::Experiment;
use opspace_experiment::text::format_short;

/// Force along an axis from which on the axis has a panel, relative to the largest of all axes.
const DRAWN: f64 = 0.1;

/// Responses of the Cartesian tasks of a run, and of frames that no task controls, while segments of its log arrive.
pub(crate) struct ResponseFigures<'a> {
    tasks: Vec<TaskResponse<'a>>,
    frames: Vec<(FreeFrame<'a>, Response)>,
}

struct TaskResponse<'a> {
    name: &'a str,
    frame: &'a str,
    axes: AxesOfTask,
    response: Response,
}

impl<'a> ResponseFigures<'a> {
    pub(crate) fn new(experiment: &'a Experiment) -> Self {
        let tasks = experiment.task().tasks_of_the_run().into_iter().filter_map(|(name, task)| {
            let TaskParameters::Cartesian(task) = task else { return None };
            let controlled = task.controlled_frame(&experiment.robot().model).ok()?;
            let axes = AxesOfTask::new(experiment, name, controlled);
            Some(TaskResponse { name, frame: &task.frame, axes, response: Response::default() })
        });
        let frames = free_frames(experiment).into_iter().map(|frame| (frame, Response::default()));
        Self { tasks: tasks.collect(), frames: frames.collect() }
    }

    /// Adds the next segment of the log.
    pub(crate) fn add(&mut self, run: &Run<'_>) {
        self.frames.iter_mut().for_each(|(frame, response)| frame_responses::add(run, frame, response));
        for TaskResponse { name, frame, axes, response } in &mut self.tasks {
            let Some(forces) = run.forces_on(frame).filter(|forces| !forces.is_empty()) else {
                continue;
            };
            let reference = run.tick.signal(&signal_names::of(name, REFERENCE));
            let counted = run.settled(run.joints.0);
            for row in axes.rows(run) {
                let time_s = run.joints.0[row.k];
                let (true, Some(axes)) = (counted.contains(&row.k) && !run.is_held(time_s), row.axes) else {
                    continue;
                };
                let force_n = row.in_world.tr_mul(&total(&forces, row.k));
                let at_row = reference.and_then(|reference| Some(reference.row(run.tick_of(row.k)?)));
                let error_m = at_row.filter(|row| row.iter().all(|x| x.is_finite())).map(|reference| {
                    row.rotation.tr_mul(&(row.pose.translation - Vector3::from_column_slice(reference)))
                });
                response.add(time_s - run.start_s, &row, &axes, &force_n, error_m.as_ref());
            }
        }
    }

    /// Returns the figures of each task whose frame was pushed: force over displacement, and both over time; the one that shows a
    /// stiffness first.
    pub(crate) fn finish(self) -> Vec<Figure> {
        let frames = self.frames.iter().filter_map(|(FreeFrame { frame, .. }, response)| {
            let title = format!("Response of '{frame}' to forces");
            Some([Some(over_time(title, response, &response.numbers()?)), None])
        });
        let figures = self.tasks.iter().filter_map(|task| {
            let numbers = task.response.numbers()?;
            let title = format!("Response of task '{}' to forces", task.name);
            let figures =
                [task.force_over_displacement(&numbers), Some(over_time(title, &task.response, &numbers))];
            let has_stiffness = numbers.iter().any(|axis| axis.stiffness_n_per_m.is_some());
            let [first, second] = figures;
            Some(if has_stiffness { [first, second] } else { [second, first] })
        });
        figures.chain(frames).flatten().flatten().collect()
    }
}

impl TaskResponse<'_> {
    /// Force over displacement of the axes that follow a reference; `None` if no considerable force acts along them.
    fn force_over_displacement(&self, numbers: &[AxisNumbers; 3]) -> Option<Figure> {
        let largest_n = numbers.iter().map(|axis| axis.force_max_n).fold(0.0, f64::max);
        let is_drawn =
            |axis: &usize| numbers[*axis].deflects && numbers[*axis].force_max_n >= DRAWN * largest_n;
        let drawn: Vec<usize> = (0..3).filter(is_drawn).collect();
        let remarks = drawn.iter().map(|&axis| self.remark(axis, &numbers[axis]));
        let panels: Vec<Panel> = drawn.iter().map(|&axis| self.panel(axis, &numbers[axis])).collect();
        (!panels.is_empty()).then(|| Figure {
            title: format!("Force over displacement of task '{}'", self.name),
            caption: "External force on the frame over its deviation from the reference, along the axes of the task. In the colour of the text: the desired stiffness. Thin: the line with the stiffness measured. Hysteresis: largest \
                      difference of the displacement at one force, while it rises and while it falls; friction and, under fast pushes, damping cause it."
                .to_owned(),
            remark: remarks.collect::<Vec<_>>().join(" "),
            columns: Some(panels.len()),
            panels,
            overlays: true,
        })
    }

    /// Describes the stiffness of an axis, or states why there is none.
    fn remark(&self, axis: usize, numbers: &AxisNumbers) -> String {
        let Some(measured) = numbers.stiffness_n_per_m.map(format_short) else {
            return format!(
                "{}: no stiffness, because force and displacement are not proportional: friction, or the damping of a fast push, is \
                 too large.",
                AXIS_NAMES[axis]
            );
        };
        let desired = numbers.desired_n_per_m;
        let desired =
            desired.map_or_else(String::new, |desired| format!(", {} N/m desired", format_short(desired)));
        let hysteresis = numbers.hysteresis_m.map_or_else(String::new, |hysteresis_m| {
            format!(", hysteresis {} mm", format_short(1e3 * hysteresis_m))
        });
        format!("{}: {measured} N/m measured{desired}{hysteresis}.", AXIS_NAMES[axis])
    }

    fn panel(&self, axis: usize, numbers: &AxisNumbers) -> Panel {
        let points = self.response.points(axis);
        let stride = points.len().div_ceil(COLUMNS).max(1);
        let shown = || points.iter().step_by(stride).chain(points.last());
        let measured = Series::new(
            "measured",
            shown().map(|(_, moved)| 1e3 * moved).collect(),
            shown().map(|(force, _)| *force).collect(),
        );
        let (least, greatest) = points
            .iter()
            .fold((0.0_f64, 0.0_f64), |(low, high), (force, _)| (low.min(*force), high.max(*force)));
        // A line over the range of the forces: displacement without force, and compliance.
        let over_forces = |label: &str, style: Style, (offset_m, compliance): (f64, f64)| {
            let x = [least, greatest].map(|force| 1e3 * (offset_m + compliance * force));
            Series::new(label, x.to_vec(), vec![least, greatest]).style(style)
        };
        let mut series = vec![measured];
        if let Some(stiffness) = numbers.desired_n_per_m {
            series.push(over_forces("desired stiffness", Style::Desired, (0.0, 1.0 / stiffness)));
        }
        if let Some(fitted) = line(&points).filter(|_| numbers.stiffness_n_per_m.is_some()) {
            series.push(over_forces("measured stiffness", Style::Thin, fitted));
        }
        let name = AXIS_NAMES[axis];
        Panel {
            title: name.to_owned(),
            x_label: format!("displacement along {name} (mm)"),
            y_label: "force (N)".to_owned(),
            series,
            ..Panel::default()
        }
    }
}

/// Force and displacement of each axis along which something acts or moves, over time.
fn over_time(title: String, response: &Response, numbers: &[AxisNumbers; 3]) -> Figure {
    let considerable = |of: fn(&AxisNumbers) -> f64| {
        let largest = numbers.iter().map(of).fold(0.0, f64::max);
        numbers.each_ref().map(|axis| of(axis) > DRAWN * largest)
    };
    let (pushed, moved) = (considerable(|axis| axis.force_max_n), considerable(|axis| axis.deflection_max_m));
    let samples = response.samples();
    let panel = |title: String, label: &str, value: &dyn Fn(&ResponseSample) -> f64| {
        let x = samples.iter().map(|sample| sample.time_s).collect();
        let y = samples.iter().map(value).collect();
        time_panel(&title, label, vec![Series::new("measured", x, y).thinned(COLUMNS)])
    };
    let force = |axis: usize| {
        let title = format!("force along {}", AXIS_NAMES[axis]);
        panel(title, "force (N)", &|sample| sample.force_n[axis])
    };
    let displacement = |axis: usize| {
        let title = format!("displacement along {}", AXIS_NAMES[axis]);
        panel(title, "displacement (mm)", &|sample| 1e3 * sample.moved_m[axis])
    };
    let forces = (0..3).filter(|&axis| pushed[axis]).map(force);
    let displacements = (0..3).filter(|&axis| pushed[axis] || moved[axis]).map(displacement);
    Figure {
        title,
        caption: "External force on the frame, and displacement of the frame since settle_s, along the axes of the task that are \
                  pushed or move."
            .to_owned(),
        panels: forces.chain(displacements).collect(),
        columns: Some(2),
        overlays: true,
        ..Figure::default()
    }
}

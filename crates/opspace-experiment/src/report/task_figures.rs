//! Figures of the tasks of a run: path and errors of Cartesian tasks, contact forces, joint positions.

use crate::evaluate::metrics::run_log::{Run, masked_norm};
use crate::evaluate::metrics::task_axes::{AxesOfTask, TaskAxes, TaskRow};
use crate::evaluate::metrics::tasks::{orientation, total};
use crate::report::figure::{Figure, Panel, Series, Style};
use crate::report::lines::{element, joint_figure, label_of, line, time_panel};
use nalgebra::Vector3;
use opspace_backend::signal_names::{
    self, ERROR, Q, REFERENCE, REFERENCE_ORIENTATION, TRUTH_CHANNEL, WRENCH,
};
use opspace_control::orientation::log;
use opspace_control::{CartesianParameters, ControlledFrame, TaskParameters};
use opspace_log::Column;

/// Names of the axes of space.
const AXES: [&str; 3] = ["x", "y", "z"];

/// Creates the figures of the tasks that have a priority at some time of the run, in the order of priority.
pub(super) fn task_figures(run: &Run<'_>) -> Vec<Figure> {
    let mut figures = Vec::new();
    for (name, task) in run.experiment.task().tasks_of_the_run() {
        match task {
            TaskParameters::Cartesian(task) => {
                let Ok(controlled) = task.controlled_frame(&run.experiment.robot().model) else { continue };
                let shown = CartesianFigures::new(run, name, format!("'{}'", task.frame), controlled);
                figures.extend([shown.position(), shown.orientation(), shown.errors()]);
                figures.extend(shown.forces(task));
            }
            TaskParameters::CenterOfMass(_) => {
                let of_mass = "the centre of mass".to_owned();
                let shown = CartesianFigures::new(run, name, of_mass, ControlledFrame::CenterOfMass);
                figures.extend([shown.position(), shown.errors()]);
            }
            TaskParameters::JointTracking(task) => {
                figures.extend(joints(run, name, task.joints.as_deref()));
            }
            _ => figures.extend(logged_errors(run, name)),
        }
    }
    figures
}

/// Figure of the errors that a task has logged.
fn logged_errors(run: &Run<'_>, task: &str) -> Option<Figure> {
    let error = run.tick.signal(&signal_names::of(task, ERROR))?;
    let panel = |(j, name): (usize, &String)| {
        let line = element(run, "error", &run.tick.time_s, &error, j, Style::Solid);
        time_panel(name, &label_of("error", &error, j), vec![line])
    };
    Some(Figure {
        title: format!("Error of task '{task}'"),
        caption: "Deviation from the reference, as the controller measured it.".to_owned(),
        panels: error.elements().iter().enumerate().map(panel).collect(),
        overlays: true,
        ..Figure::default()
    })
}

/// Figure of the positions of the joints of a task: of all, or of some. The log has references of all.
fn joints(run: &Run<'_>, task: &str, of: Option<&[String]>) -> Option<Figure> {
    let reference = run.tick.signal(&signal_names::of(task, REFERENCE))?;
    let truth = run.recording.channel(TRUTH_CHANNEL).unwrap_or(run.tick);
    let caption = "True positions and references. Position limits are drawn where the joints come near them.";
    let actual = (truth, Q, "true");
    let mut figure = joint_figure(run, "Joint positions", caption, "position", actual, &reference)?;
    figure.panels.retain(|panel| of.is_none_or(|of| of.contains(&panel.title)));
    Some(figure)
}

/// Cartesian task of a run, with the poses of its frame.
struct CartesianFigures<'a> {
    run: &'a Run<'a>,
    name: &'a str,
    /// Controlled frame, as in a title.
    frame: String,
    rows: Vec<TaskRow>,
    /// Axes of the task if events and streamed modes leave them as they are.
    constant: Option<TaskAxes>,
    reference: Option<Column<'a>>,
    reference_orientation: Option<Column<'a>>,
}

impl<'a> CartesianFigures<'a> {
    fn new(run: &'a Run<'a>, name: &'a str, frame: String, controlled: ControlledFrame) -> Self {
        let axes = AxesOfTask::new(run.experiment, name, controlled);
        Self {
            run,
            name,
            frame,
            rows: axes.rows(run),
            constant: axes.constant(run),
            reference: run.tick.signal(&signal_names::of(name, REFERENCE)),
            reference_orientation: run.tick.signal(&signal_names::of(name, REFERENCE_ORIENTATION)),
        }
    }

    /// Line of a number that is computed for each row; it is interrupted where there is none.
    fn line(&self, label: &str, style: Style, value: impl Fn(&TaskRow) -> Option<f64>) -> Series {
        let samples = self.rows.iter().map(|row| (self.run.joints.0[row.k], value(row).unwrap_or(f64::NAN)));
        line(self.run, label, samples, style)
    }

    /// Panels of the three axes.
    fn panels(&self, y_label: &str, series: impl Fn(usize) -> Vec<Series>) -> Vec<Panel> {
        (0..3).map(|axis| time_panel(AXES[axis], y_label, series(axis))).collect()
    }

    /// Position in world axes. An axis has a reference while it is a motion axis.
    fn position(&self) -> Figure {
        let panels = self.panels("position (m)", |axis| {
            let reference = self.reference.map(|reference| {
                self.line("reference", Style::Desired, |row| {
                    let follows = row.axes.is_some_and(|axes| follows(&axes, axis));
                    Some(reference.row(self.run.tick_of(row.k).filter(|_| follows)?)[axis])
                })
            });
            let truth = self.line("true", Style::Solid, |row| Some(row.pose.translation[axis]));
            [Some(truth), reference].into_iter().flatten().collect()
        });
        let caption = match self.constant {
            Some(axes) => {
                let followed: Vec<&str> =
                    (0..3).filter(|&axis| follows(&axes, axis)).map(|axis| AXES[axis]).collect();
                match followed.len() {
                    3 => "World axes.".to_owned(),
                    0 => "World axes. No axis of the world alone follows a reference.".to_owned(),
                    1 => {
                        format!(
                            "World axes. Only {} follows a reference; the other axes are free.",
                            followed[0]
                        )
                    }
                    _ => {
                        format!(
                            "World axes. {} follow a reference; the other axis is free.",
                            followed.join(" and ")
                        )
                    }
                }
            }
            None => "World axes. A reference is drawn while the axis follows it.".to_owned(),
        };
        Figure {
            title: format!("Position of {}", self.frame),
            caption,
            panels,
            overlays: true,
            ..Figure::default()
        }
    }

    /// Rotation vector (rad) from the reference to the true orientation at a row, in the axes of the task; `None` while
    /// no axis follows it.
    fn rotation_error(&self, row: &TaskRow) -> Option<(TaskAxes, Vector3<f64>)> {
        let axes = row.axes.filter(|axes| axes.motion[3..].contains(&true))?;
        let reference = orientation(self.reference_orientation?.row(self.run.tick_of(row.k)?));
        Some((axes, row.rotation.tr_mul(&log(&(row.pose.rotation * reference.transpose())))))
    }

    /// Deviation of the orientation from its reference, about the motion axes of the task.
    fn orientation(&self) -> Figure {
        let panels = self.panels("rotation (mrad)", |axis| {
            vec![self.line("true relative to the reference", Style::Solid, |row| {
                let (axes, error) = self.rotation_error(row)?;
                axes.motion[3 + axis].then(|| 1e3 * error[axis])
            })]
        });
        Figure {
            title: format!("Orientation of {}", self.frame),
            caption: "Rotation vector from the reference to the true orientation, in the axes of the task; axes that follow \
                      no reference are omitted."
                .to_owned(),
            panels,
            overlays: true,
            ..Figure::default()
        }
    }

    /// Distance and angle from the reference over the motion axes.
    fn errors(&self) -> Figure {
        let position = self.line("error", Style::Solid, |row| {
            let axes = row.axes.filter(|axes| axes.motion[..3].contains(&true))?;
            let reference = self.reference?.row(self.run.tick_of(row.k)?);
            let error = row.pose.translation - Vector3::from_column_slice(reference);
            Some(1e3 * masked_norm(&row.rotation.tr_mul(&error), &axes.motion[..3]))
        });
        let angle = self.line("error", Style::Solid, |row| {
            let (axes, error) = self.rotation_error(row)?;
            Some(1e3 * masked_norm(&error, &axes.motion[3..]))
        });
        let panels = [("position", "distance (mm)", position), ("orientation", "angle (mrad)", angle)];
        let panels = panels.map(|(title, label, series)| {
            let mut panel = time_panel(title, label, vec![series]);
            panel.marks.push((self.run.experiment.task().file.settle_s.get(), "settle_s".to_owned()));
            panel
        });
        Figure {
            title: format!("Error of task '{}'", self.name),
            caption: "Distance or angle from the reference over the motion axes of the task. The values of the tables \
                      begin at settle_s."
                .to_owned(),
            panels: panels.to_vec(),
            overlays: true,
            ..Figure::default()
        }
    }

    /// Force on the frame: true, sensed, and the target of the force axes.
    fn forces(&self, task: &CartesianParameters) -> Option<Figure> {
        let sensor = task.force.as_ref().map(|force| force.sensor.as_str());
        let sensed = sensor.and_then(|sensor| self.run.tick.signal(&signal_names::of(sensor, WRENCH)));
        let truth = self.run.forces_on(&task.frame).filter(|forces| !forces.is_empty());
        let has_force_axes = self.constant.is_none_or(|axes| axes.force.contains(&true));
        if sensed.is_none() && (truth.is_none() || !has_force_axes) {
            return None;
        }
        let panels = self.panels("force (N)", |axis| {
            let true_force = truth.as_ref().map(|forces| {
                self.line("true", Style::Solid, |row| Some(row.in_world.tr_mul(&total(forces, row.k))[axis]))
            });
            let sensed = sensed.map(|sensed| {
                self.line("sensed", Style::Thin, |row| {
                    let force = Vector3::from_column_slice(&sensed.row(self.run.tick_of(row.k)?)[..3]);
                    Some(row.in_world.tr_mul(&force)[axis])
                })
            });
            let target = self.line("target", Style::Desired, |row| {
                let axes = row.axes.filter(|axes| axes.force[axis])?;
                Some(axes.target?[axis])
            });
            [true_force, sensed, Some(target)].into_iter().flatten().collect()
        });
        let of_sensor = if sensed.is_some() { "; the sensor is tared at the start" } else { "" };
        let of_target = match self.constant {
            Some(axes) if axes.force.contains(&true) && axes.target.is_some() => " Force axes have a target.",
            None => " A target is drawn while the axis is a force axis.",
            Some(_) => "",
        };
        Some(Figure {
            title: format!("Contact force of task '{}'", self.name),
            caption: format!("Force on the robot in the axes of the task{of_sensor}.{of_target}"),
            panels,
            overlays: true,
            ..Figure::default()
        })
    }
}

/// True if an axis of the world follows the reference of a task. In axes of the task's own, each axis of the world may mix
/// motion axes and others.
fn follows(axes: &TaskAxes, axis: usize) -> bool {
    if axes.are_those_of_the_pose() { axes.motion[axis] } else { axes.motion[..3] == [true; 3] }
}

//! Figures of the tasks of a run: path and errors of Cartesian tasks, contact forces, joint positions.

use crate::figure::{Figure, Panel, Series, Style};
use crate::lines::{error_panel, joint_figure, line, tables_begin, time_panel};
use nalgebra::Vector3;
use opspace_backend::signal_names::{
    self, CONTACT, ERROR, Q, REFERENCE, REFERENCE_ORIENTATION, TARGET_FORCE, TRUTH_CHANNEL, WRENCH,
};
use opspace_control::orientation::log;
use opspace_control::{CartesianParameters, CartesianReference, ControlledFrame, TaskParameters};
use opspace_experiment::evaluate::metrics::run_log::{Run, masked_norm};
use opspace_experiment::evaluate::metrics::task_axes::{AxesOfTask, TaskAxes, TaskRow, orientation};
use opspace_experiment::evaluate::metrics::tasks::{force_target, total};
use opspace_experiment::evaluate::table::shown_unit;
use opspace_experiment::text::listed;
use opspace_log::Column;

/// Beginning of the titles of figures of a force that has a target.
pub(crate) const FORCE: &str = "Force on";

/// Names of the axes of space.
const AXES: [&str; 3] = ["x", "y", "z"];

/// Creates the figures of the tasks that have a priority at some time of the run, in the order of priority.
pub(crate) fn task_figures(run: &Run<'_>) -> Vec<Figure> {
    let mut figures = Vec::new();
    for (name, task) in run.experiment.task().tasks_of_the_run() {
        match task {
            TaskParameters::Cartesian(task) => {
                let Ok(controlled) = task.controlled_frame(&run.experiment.robot().model) else { continue };
                let mut frame = format!("'{}'", task.frame);
                if let Some(other) = &task.relative_to {
                    frame += &format!(" relative to '{other}'");
                }
                let shown = CartesianFigures {
                    relative_to: task.relative_to.as_deref(),
                    ..CartesianFigures::new(run, name, frame, controlled)
                };
                // The force is what a task with force axes is about.
                let forces = shown.forces(task);
                let has_target = forces.as_ref().is_some_and(Figure::has_desired_lines);
                let (first, last) = if has_target { (forces, None) } else { (None, forces) };
                figures.extend(first);
                figures.extend([shown.position(), shown.errors(), shown.orientation()]);
                figures.extend(last);
            }
            TaskParameters::CenterOfMass(_) => {
                let of_mass = "the centre of mass".to_owned();
                let shown = CartesianFigures::new(run, name, of_mass, ControlledFrame::CenterOfMass);
                figures.extend([shown.position(), shown.errors()]);
            }
            TaskParameters::JointTracking(task) => {
                figures.extend(joints(run, name, task.joints.as_deref()).into_iter().flatten());
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
        let (factor, unit) = shown_unit(&error.units()[j]);
        let values = error.rows().map(|row| factor * row[j]);
        let samples = run.tick.time_s.iter().copied().zip(values);
        let error = line(run, "error", samples, Style::Solid);
        error_panel(run, name, &format!("error ({})", unit.replace("Nm", "N·m")), error)
    };
    Some(Figure {
        title: format!("Error of task '{task}'"),
        caption: format!(
            "Deviation from the reference, as the controller measured it. {}",
            tables_begin(run)
        ),
        panels: error.elements().iter().enumerate().map(panel).collect(),
        overlays: true,
        ..Figure::default()
    })
}

/// Name of the positions in a log: true or measured.
fn known(run: &Run<'_>) -> &'static str {
    if run.recording.channel(TRUTH_CHANNEL).is_some() { "true" } else { "measured" }
}

/// Figures of the positions of the joints of a task, and of their errors: of all joints, or of some. The log has references
/// of all.
fn joints(run: &Run<'_>, task: &str, of: Option<&[String]>) -> Option<[Figure; 2]> {
    let reference = run.tick.signal(&signal_names::of(task, REFERENCE))?;
    let positions = run.recording.channel(TRUTH_CHANNEL).unwrap_or(run.tick);
    let (title, known) = (format!("Joint positions of task '{task}'"), known(run));
    let caption = format!("References and {known} positions.");
    let actual = (positions, Q, known);
    let desired = (&reference, "reference");
    let mut figure = joint_figure(run, &title, &caption, "position", actual, desired)?;
    figure.panels.retain(|panel| of.is_none_or(|of| of.contains(&panel.title)));
    let (times, q) = run.joints;
    let error = |panel: &Panel| {
        let j = q.elements().iter().position(|joint| *joint == panel.title)?;
        let place = reference.elements().iter().position(|joint| *joint == panel.title)?;
        let (factor, unit) = shown_unit(&q.units()[j]);
        let rows = run.controlled().filter_map(|k| Some((k, run.tick_of(k)?)));
        let samples = rows.map(|(k, tick)| (times[k], factor * (q.row(k)[j] - reference.row(tick)[place])));
        let error = line(run, "error", samples, Style::Solid);
        Some(error_panel(run, &panel.title, &format!("error ({unit})"), error))
    };
    let errors = Figure {
        title: format!("Error of task '{task}'"),
        caption: format!("Deviation of the {known} position from the reference. {}", tables_begin(run)),
        panels: figure.panels.iter().filter_map(error).collect(),
        overlays: true,
        ..Figure::default()
    };
    Some([figure, errors])
}

/// Cartesian task of a run, with the poses of its frame.
struct CartesianFigures<'a> {
    run: &'a Run<'a>,
    name: &'a str,
    /// Controlled frame, as in a title.
    frame: String,
    /// Frame in whose coordinates the pose is given; the world if `None`.
    relative_to: Option<&'a str>,
    rows: Vec<TaskRow>,
    /// Axes of the task if events and streamed modes leave them as they are.
    constant: Option<TaskAxes>,
    /// Axes whose force the task controls at some time.
    force_axes: [bool; 3],
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
            relative_to: None,
            rows: axes.rows(run),
            constant: axes.constant(run),
            force_axes: axes.force_axes(),
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

    /// Position in the world, or relative to another frame in its axes. An axis has a reference while it is a motion axis.
    fn position(&self) -> Figure {
        let mut panels = self.panels("displacement (mm)", |axis| {
            let line = |label, style, is_drawn: fn(&TaskAxes, usize) -> bool| {
                let reference = self.reference?;
                Some(self.line(label, style, |row| {
                    let is_drawn = row.axes.is_some_and(|axes| is_drawn(&axes, axis));
                    Some(reference.row(self.run.tick_of(row.k).filter(|_| is_drawn)?)[axis])
                }))
            };
            let truth = self.line(known(self.run), Style::Solid, |row| Some(row.pose.translation[axis]));
            let reference = line("reference", Style::Desired, follows);
            let in_other_axes =
                line("reference in other axes", Style::Thin, |axes, _| follows_in_other_axes(axes));
            [Some(truth), reference, in_other_axes].into_iter().flatten().collect()
        });
        panels.iter_mut().for_each(|panel| panel.is_from_start = true);
        let coordinates = match self.relative_to {
            Some(frame) => format!("relative to '{frame}', in its axes"),
            None => "in world axes".to_owned(),
        };
        let followed = match &self.constant {
            Some(axes) if follows_in_other_axes(axes) => format!(
                "In the axes of the task (axes_frame), {}. The axes drawn are others: the position need not meet the thin \
                 reference along them.",
                by_mode(axes)
            ),
            Some(axes) if axes.are_those_of_the_pose() => format!("{}.", by_mode(axes)),
            Some(axes) => format!("In the axes of the task (axes_frame), {}.", by_mode(axes)),
            None => "A reference is drawn while the axis follows it.".to_owned(),
        };
        Figure {
            title: format!("Position of {}", self.frame),
            caption: format!(
                "Position ({}) from that at the start, {coordinates}. {followed}",
                known(self.run)
            ),
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
            vec![self.line("rotation", Style::Solid, |row| {
                let (axes, error) = self.rotation_error(row)?;
                axes.motion[3 + axis].then(|| 1e3 * error[axis])
            })]
        });
        Figure {
            title: format!("Orientation of {}", self.frame),
            caption: format!(
                "Rotation vector from the reference to the {} orientation, in the axes of the task; axes that follow no \
                 reference are omitted.",
                known(self.run)
            ),
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
        let panels = panels.map(|(title, label, series)| error_panel(self.run, title, label, series));
        let axes = match self.constant {
            Some(_) => "the motion axes of the task",
            None => "the axes that are motion axes of the task at each moment",
        };
        Figure {
            title: format!("Error of task '{}'", self.name),
            caption: format!("Deviation from the reference over {axes}. {}", tables_begin(self.run)),
            panels: panels.to_vec(),
            overlays: true,
            ..Figure::default()
        }
    }

    /// Force on the frame: true, sensed, and the target of the axes with force feedback.
    fn forces(&self, task: &CartesianParameters) -> Option<Figure> {
        let has_target =
            |axes: &TaskAxes, axis: usize| axes.force[axis] || (axes.compliant[axis] && task.force.is_some());
        let sensor = task.force.as_ref().map(|force| force.sensor.as_str());
        let sensed = sensor.and_then(|sensor| self.run.tick.signal(&signal_names::of(sensor, WRENCH)));
        let truth = self.run.forces_on(&task.frame).filter(|forces| !forces.is_empty());
        let has_force_axes = self.constant.is_none_or(|axes| axes.force.contains(&true));
        if sensed.is_none() && (truth.is_none() || !has_force_axes) {
            return None;
        }
        // With ramps and profiles.
        let logged = self.run.tick.signal(&signal_names::of(self.name, TARGET_FORCE));
        let panels = self.panels("force (N)", |axis| {
            let true_force = truth.as_ref().map(|forces| {
                self.line(known(self.run), Style::Solid, |row| {
                    Some(row.in_world.tr_mul(&total(forces, row.k))[axis])
                })
            });
            let sensed = sensed.map(|sensed| {
                self.line("sensed", Style::Thin, |row| {
                    let force = Vector3::from_column_slice(&sensed.row(self.run.tick_of(row.k)?)[..3]);
                    Some(row.in_world.tr_mul(&force)[axis])
                })
            });
            let target = self.line("target", Style::Desired, |row| {
                let axes = row.axes.filter(|axes| has_target(axes, axis))?;
                match &logged {
                    Some(logged) if axes.force[axis] => Some(logged.row(self.run.tick_of(row.k)?)[axis]),
                    _ => Some(axes.target?[axis]),
                }
            });
            [true_force, sensed, Some(target)].into_iter().flatten().collect()
        });
        // The axes whose force has a target come first.
        let mut order = [0, 1, 2];
        order.sort_by_key(|axis| !self.force_axes[*axis]);
        let mut panels: Vec<Panel> = order.map(|axis| panels[axis].clone()).to_vec();
        if let (Some(truth), true) = (&truth, self.force_axes.contains(&true)) {
            let made = self.run.tick.signal(&signal_names::of(self.name, CONTACT));
            let error = self.line("error", Style::Solid, |row| {
                let axes = row.axes.filter(|axes| axes.force.contains(&true))?;
                let tick = self.run.tick_up_to(row.k)?;
                let at_tick = |column: &Option<Column<'a>>| column.map(|column| column.row(tick));
                let target = force_target(&axes, at_tick(&logged), at_tick(&made))?;
                let force = row.in_world.tr_mul(&total(truth, row.k));
                Some(masked_norm(&(force - target), &axes.force))
            });
            panels.insert(1, error_panel(self.run, "error over the force axes", "force error (N)", error));
        }
        let of_sensor = sensor.filter(|_| sensed.is_some()).map_or_else(String::new, |sensor| {
            format!(" Sensed: reading of sensor '{sensor}', tared at the start and unfiltered.")
        });
        let of_target = match self.constant {
            Some(axes) if axes.target.is_some() => {
                match listed(&chosen_axes(|axis| has_target(&axes, axis))).as_str() {
                    "" => String::new(),
                    names => format!(" The target is that of {names}."),
                }
            }
            // The target of a streamed task comes from outside and is not in the log.
            None if !matches!(task.reference, CartesianReference::Streamed(_)) => {
                " A target is drawn while the axis has one.".to_owned()
            }
            _ => String::new(),
        };
        Some(Figure {
            title: format!("{FORCE} the frame of task '{}'", self.name),
            caption: format!("Force on the robot in the axes of the task.{of_sensor}{of_target}"),
            panels,
            overlays: true,
            ..Figure::default()
        })
    }
}

/// True if an axis of the coordinates of the pose follows the reference of a task. In axes of the task's own, each of these
/// axes may mix motion axes and others.
fn follows(axes: &TaskAxes, axis: usize) -> bool {
    if axes.are_those_of_the_pose() { axes.motion[axis] } else { axes.motion[..3] == [true; 3] }
}

/// True if some axes of the task's own follow its reference, so that no axis of the coordinates of the pose does.
fn follows_in_other_axes(axes: &TaskAxes) -> bool {
    axes.motion[..3].contains(&true) && !(0..3).any(|axis| follows(axes, axis))
}

/// Names of the axes of space that are chosen.
fn chosen_axes(is_chosen: impl Fn(usize) -> bool) -> Vec<String> {
    (0..3).filter(|axis| is_chosen(*axis)).map(|axis| AXES[axis].to_owned()).collect()
}

/// Describes the axes of space of a task by their modes: `y and z follow a reference; x is compliant`.
fn by_mode(axes: &TaskAxes) -> String {
    let is_free = |axis: usize| !(axes.motion[axis] || axes.compliant[axis] || axes.force[axis]);
    let modes = [
        (chosen_axes(|axis| axes.motion[axis]), ["follows a reference", "follow a reference"]),
        (chosen_axes(|axis| axes.compliant[axis]), ["is compliant", "are compliant"]),
        (chosen_axes(|axis| axes.force[axis]), ["controls the force", "control the force"]),
        (chosen_axes(is_free), ["is not controlled by this task", "are not controlled by this task"]),
    ];
    let modes = modes.iter().filter(|(names, _)| !names.is_empty());
    let texts = modes.map(|(names, [one, many])| {
        format!("{} {}", listed(names), if names.len() == 1 { one } else { many })
    });
    texts.collect::<Vec<String>>().join("; ")
}

//! Figures of the tasks of a run: path and errors of Cartesian tasks, contact forces, joint positions.

use crate::evaluate::metrics::run_log::{Run, masked_norm};
use crate::evaluate::metrics::tasks::{orientation, total};
use crate::report::figure::{Figure, Panel, Series, Style};
use crate::report::lines::{element, joint_figure, line, time_panel};
use nalgebra::{Matrix3, Vector3};
use opspace_backend::signal_names::{self, Q, REFERENCE, REFERENCE_ORIENTATION, TRUTH_CHANNEL, WRENCH};
use opspace_control::orientation::log;
use opspace_control::{
    AxesFrame, AxisMode, CartesianParameters, CartesianReference, ControlledFrame, TaskParameters,
};
use opspace_log::Column;
use opspace_model::Placement;

/// Names of the axes of space.
const AXES: [&str; 3] = ["x", "y", "z"];

/// Creates the figures of the tasks that have a priority at the start, in the order of priority.
pub(super) fn task_figures(run: &Run<'_>) -> Vec<Figure> {
    let file = &run.experiment.task().file;
    let mut figures = Vec::new();
    for name in &file.priority {
        match file.task.get(name) {
            Some(TaskParameters::Cartesian(task)) => {
                if let Some(shown) = CartesianFigures::new(run, name, task) {
                    figures.extend(shown.position());
                    figures.extend(shown.orientation());
                    figures.extend(shown.errors());
                    figures.extend(shown.forces());
                }
            }
            Some(TaskParameters::JointTracking(_)) => figures.extend(joints(run, name)),
            _ => {}
        }
    }
    figures
}

/// Figure of the positions of the joints of a task.
fn joints(run: &Run<'_>, task: &str) -> Option<Figure> {
    let reference = run.tick.signal(&signal_names::of(task, REFERENCE))?;
    let truth = run.recording.channel(TRUTH_CHANNEL).unwrap_or(run.tick);
    let caption = "True positions and references. Position limits are drawn where the joints come near them.";
    joint_figure(run, "Joint positions", caption, "position", (truth, Q, "true"), &reference)
}

/// Cartesian task of a run, with the poses of its frame.
struct CartesianFigures<'a> {
    run: &'a Run<'a>,
    name: &'a str,
    task: &'a CartesianParameters,
    directions: AxesFrame,
    /// Row of the joints, pose and axes of the task.
    poses: Vec<(usize, Placement, Matrix3<f64>)>,
    reference: Option<Column<'a>>,
    reference_orientation: Option<Column<'a>>,
}

impl<'a> CartesianFigures<'a> {
    fn new(run: &'a Run<'a>, name: &'a str, task: &'a CartesianParameters) -> Option<Self> {
        let model = &run.experiment.robot().model;
        let controlled: ControlledFrame = task.controlled_frame(model).ok()?;
        let directions = task.axes_frame.resolve(model, controlled).ok()?;
        Some(Self {
            run,
            name,
            task,
            directions,
            poses: run.poses(controlled, |_| directions).collect(),
            reference: run.tick.signal(&signal_names::of(name, REFERENCE)),
            reference_orientation: run.tick.signal(&signal_names::of(name, REFERENCE_ORIENTATION)),
        })
    }

    /// True if the axes of the task are those of the world.
    fn is_in_world(&self) -> bool {
        self.directions == AxesFrame::Fixed(Matrix3::identity())
    }

    /// Time of a row of the joints on the robot's clock, s.
    fn time_s(&self, row: usize) -> f64 {
        self.run.joints.0[row]
    }

    /// Line of a number that is computed for each pose; it is interrupted where there is none.
    fn line(
        &self,
        label: &str,
        style: Style,
        value: impl Fn(usize, &Placement, &Matrix3<f64>) -> Option<f64>,
    ) -> Series {
        let samples = self
            .poses
            .iter()
            .map(|(k, pose, axes)| (self.time_s(*k), value(*k, pose, axes).unwrap_or(f64::NAN)));
        line(self.run, label, samples, style)
    }

    /// Panels of the three axes.
    fn panels(&self, y_label: &str, series: impl Fn(usize) -> Vec<Series>) -> Vec<Panel> {
        (0..3).map(|axis| time_panel(AXES[axis], y_label, series(axis))).collect()
    }

    /// Position in world axes. An axis that is not a motion axis follows no reference, and has none in the figure.
    fn position(&self) -> Option<Figure> {
        let motion = self.task.motion_axes();
        // In axes of the task's own, each axis of the world may mix motion axes and others.
        let follows = |axis: usize| if self.is_in_world() { motion[axis] } else { motion[..3] == [true; 3] };
        let panels = self.panels("position (m)", |axis| {
            let reference = self.reference.filter(|_| follows(axis));
            let mut series = vec![self.line("true", Style::Solid, |_, pose, _| Some(pose.translation[axis]))];
            series
                .extend(reference.map(|r| {
                    element(self.run, "reference", &self.run.tick.time_s, &r, axis, Style::Desired)
                }));
            series
        });
        let followed: Vec<&str> = (0..3).filter(|&axis| follows(axis)).map(|axis| AXES[axis]).collect();
        let caption = match followed.len() {
            3 => "World axes.".to_owned(),
            0 => "World axes. No axis of the world alone follows a reference.".to_owned(),
            1 => format!("World axes. Only {} follows a reference; the other axes are free.", followed[0]),
            _ => {
                format!("World axes. {} follow a reference; the other axis is free.", followed.join(" and "))
            }
        };
        Some(Figure {
            title: format!("Position of '{}'", self.task.frame),
            caption,
            panels,
            overlays: true,
            ..Figure::default()
        })
    }

    /// Deviation of the orientation from its reference, about the motion axes of the task.
    fn orientation(&self) -> Option<Figure> {
        let motion = self.task.motion_axes();
        let reference = self.reference_orientation.filter(|_| motion[3..].contains(&true))?;
        let panels = self.panels("rotation (mrad)", |axis| {
            vec![self.line("true relative to the reference", Style::Solid, |k, pose, axes| {
                let reference = orientation(reference.row(self.run.tick_of(k)?));
                Some(1e3 * axes.tr_mul(&log(&(pose.rotation * reference.transpose())))[axis])
            })]
        });
        let panels: Vec<Panel> = panels
            .into_iter()
            .enumerate()
            .filter(|(axis, _)| motion[3 + axis])
            .map(|(_, panel)| panel)
            .collect();
        Some(Figure {
            title: format!("Orientation of '{}'", self.task.frame),
            caption: "Rotation vector from the reference to the true orientation, in the axes of the task; axes that follow \
                      no reference are omitted."
                .to_owned(),
            panels,
            overlays: true,
            ..Figure::default()
        })
    }

    /// Distance and angle from the reference over the motion axes.
    fn errors(&self) -> Option<Figure> {
        let motion = self.task.motion_axes();
        let position = self.reference.filter(|_| motion[..3].contains(&true)).map(|reference| {
            self.line("error", Style::Solid, |k, pose, axes| {
                let error =
                    pose.translation - Vector3::from_column_slice(reference.row(self.run.tick_of(k)?));
                Some(1e3 * masked_norm(&axes.tr_mul(&error), &motion[..3]))
            })
        });
        let angle = self.reference_orientation.filter(|_| motion[3..].contains(&true)).map(|reference| {
            self.line("error", Style::Solid, |k, pose, axes| {
                let reference = orientation(reference.row(self.run.tick_of(k)?));
                let error = log(&(pose.rotation * reference.transpose()));
                Some(1e3 * masked_norm(&axes.tr_mul(&error), &motion[3..]))
            })
        });
        let panels: Vec<Panel> =
            [("position", "distance (mm)", position), ("orientation", "angle (mrad)", angle)]
                .into_iter()
                .filter_map(|(title, label, series)| {
                    let mut panel = time_panel(title, label, vec![series?]);
                    panel.marks.push((self.run.experiment.task().file.settle_s.get(), "settle_s".to_owned()));
                    Some(panel)
                })
                .collect();
        let shown = match (motion[..3].contains(&true), motion[3..].contains(&true)) {
            (true, true) => "Distance and angle",
            (true, false) => "Distance",
            (false, _) => "Angle",
        };
        (!panels.is_empty()).then(|| Figure {
            title: format!("Error of task '{}'", self.name),
            caption: format!(
                "{shown} from the reference over the motion axes of the task. The values of the tables begin at settle_s."
            ),
            panels,
            overlays: true,
            ..Figure::default()
        })
    }

    /// Force on the frame: true, sensed, and the target of the force axes.
    fn forces(&self) -> Option<Figure> {
        let on_force = self.task.axes.with_mode(AxisMode::Force);
        let sensor = self.task.force.as_ref().map(|force| force.sensor.as_str());
        let sensed = sensor.and_then(|sensor| self.run.tick.signal(&signal_names::of(sensor, WRENCH)));
        let truth = self.run.forces_on(&self.task.frame).filter(|forces| !forces.is_empty());
        if sensed.is_none() && (truth.is_none() || !on_force[..3].contains(&true)) {
            return None;
        }
        let target = self.task.target_force();
        let is_filed = !matches!(self.task.reference, CartesianReference::Streamed(_));
        let panels = self.panels("force (N)", |axis| {
            let true_force = truth.as_ref().map(|forces| {
                self.line("true", Style::Solid, |k, _, axes| Some(axes.tr_mul(&total(forces, k))[axis]))
            });
            let sensed = sensed.map(|sensed| {
                self.line("sensed", Style::Thin, |k, _, axes| {
                    let force = Vector3::from_column_slice(&sensed.row(self.run.tick_of(k)?)[..3]);
                    Some(axes.tr_mul(&force)[axis])
                })
            });
            let target = (is_filed && on_force[axis])
                .then(|| self.line("target", Style::Desired, |_, _, _| Some(target[axis])));
            [true_force, sensed, target].into_iter().flatten().collect()
        });
        let of_sensor = if sensed.is_some() { "; the sensor is tared at the start" } else { "" };
        let of_target =
            if on_force[..3].contains(&true) && is_filed { " Force axes have a target." } else { "" };
        Some(Figure {
            title: format!("Contact force of task '{}'", self.name),
            caption: format!("Force on the robot in the axes of the task{of_sensor}.{of_target}"),
            panels,
            overlays: true,
            ..Figure::default()
        })
    }
}

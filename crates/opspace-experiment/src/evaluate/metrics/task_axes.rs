//! Axes of a Cartesian task at each moment of a run: events and streamed modes change them.

use super::run_log::{CONTACT_N, Run};
use crate::run::experiment::Experiment;
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use opspace_backend::signal_names::{self, AXES, MODES, TASK_SET};
use opspace_control::{
    AxesFrame, AxisMode, CartesianParameters, CartesianReference, ControlledFrame, ForceProfiles,
    TaskParameters,
};
use opspace_model::{FrameId, Model, Placement};

/// Axes of a task by mode, their frame, and the target of the force axes.
#[derive(Clone, Copy, PartialEq)]
pub struct TaskAxes {
    pub(crate) directions: AxesFrame,
    /// Axes that follow a reference: x, y, z, and the rotations about them.
    pub motion: [bool; 6],
    /// Compliant axes of translation.
    pub compliant: [bool; 3],
    pub(crate) compliant_rotations: [bool; 3],
    /// Axes of translation whose force is controlled.
    pub force: [bool; 3],
    /// Target force, N; `None` for a streamed task, which gets its target from outside.
    pub target: Option<Vector3<f64>>,
    /// True if the target is not zero, or unknown: the task is to touch something.
    pub(crate) presses: bool,
    /// Stiffness of the impedance along the motion axes, N/m; `None` without a constant one.
    pub(crate) stiffness_n_per_m: [Option<f64>; 3],
}

impl TaskAxes {
    fn new(model: &Model, task: &CartesianParameters, controlled: ControlledFrame) -> Option<Self> {
        let translation = |mode: AxisMode| {
            let [x, y, z, ..] = task.axes.with_mode(mode);
            [x, y, z]
        };
        let is_streamed = matches!(task.reference, CartesianReference::Streamed(_));
        let target = task.target_force().fixed_rows::<3>(0).into_owned();
        let follows_profile =
            task.force.as_ref().is_some_and(|force| force.profile_n != ForceProfiles::default());
        Some(Self {
            directions: task.axes_frame.resolve(model, controlled).ok()?,
            motion: task.motion_axes(),
            compliant: translation(AxisMode::Compliant),
            compliant_rotations: {
                let [.., rx, ry, rz] = task.axes.with_mode(AxisMode::Compliant);
                [rx, ry, rz]
            },
            force: translation(AxisMode::Force),
            target: (!is_streamed).then_some(target),
            presses: is_streamed || follows_profile || target.amax() > CONTACT_N,
            stiffness_n_per_m: [0, 1, 2].map(|axis| stiffness_n_per_m(task, axis)),
        })
    }

    /// Axes with the modes of a row of the log: those of a streamed task.
    fn with_modes(self, modes: &[f64]) -> Self {
        let has = |mode: AxisMode| move |axis: usize| modes.get(axis) == Some(&mode.code());
        let translation = |mode: AxisMode| [0, 1, 2].map(has(mode));
        Self {
            motion: [0, 1, 2, 3, 4, 5].map(has(AxisMode::Motion)),
            compliant: translation(AxisMode::Compliant),
            compliant_rotations: [3, 4, 5].map(has(AxisMode::Compliant)),
            force: translation(AxisMode::Force),
            ..self
        }
    }

    /// Axes with the directions of a row of the log: those of a task that turns with a surface.
    fn with_directions(self, quaternion: &[f64]) -> Self {
        Self { directions: AxesFrame::Fixed(orientation(quaternion)), ..self }
    }

    /// True if the axes are those of the coordinates of the pose: of the world, or of the frame that the task is relative to.
    pub fn are_those_of_the_pose(&self) -> bool {
        self.directions == AxesFrame::Fixed(Matrix3::identity())
    }
}

/// Stiffness of the impedance of a task along a motion axis, N/m; `None` without a constant one.
fn stiffness_n_per_m(task: &CartesianParameters, axis: usize) -> Option<f64> {
    let impedance = task.impedance.as_ref().filter(|impedance| impedance.profile.is_none())?;
    let stiffness = impedance.stiffness_n_per_m.as_ref()?.get(axis)?.get();
    (task.motion_axes()[axis] && stiffness > 0.0).then_some(stiffness)
}

/// Row of the joints during control, with the pose of a task's controlled frame and the task's axes.
#[derive(Clone, Copy)]
pub struct TaskRow {
    /// Index of the row.
    pub k: usize,
    /// Pose in the world, or in the coordinates of the frame that the task is relative to.
    pub pose: Placement,
    /// Axes of the task in the coordinates of the pose, one per column; the identity where the task has no priority.
    pub rotation: Matrix3<f64>,
    /// Axes of the task in the world, one per column.
    pub in_world: Matrix3<f64>,
    /// `None` where the task has no priority.
    pub axes: Option<TaskAxes>,
}

/// Axes of a task in each task set of an experiment: that at the start, and those after each event.
pub struct AxesOfTask {
    name: String,
    controlled: ControlledFrame,
    /// Axes in each set; `None` where the task has no priority.
    sets: Vec<Option<TaskAxes>>,
}

impl AxesOfTask {
    /// Collects the axes of a Cartesian task, or of the centre of mass, in each task set.
    #[must_use]
    pub fn new(experiment: &Experiment, name: &str, controlled: ControlledFrame) -> Self {
        let (file, model) = (&experiment.task().file, &experiment.robot().model);
        let events = experiment.task().events.iter().map(|event| (&event.priority, &event.task));
        let sets = std::iter::once((&file.priority, &file.task)).chain(events);
        let axes = sets.map(|(priority, tasks)| {
            match tasks.get(name).filter(|_| priority.iter().any(|other| other == name))? {
                TaskParameters::Cartesian(task) => TaskAxes::new(model, task, controlled),
                // Nothing touches a centre of mass.
                TaskParameters::CenterOfMass(task) => {
                    let axes = TaskAxes::new(model, &task.as_cartesian(), controlled)?;
                    Some(TaskAxes {
                        compliant: [false; 3],
                        compliant_rotations: [false; 3],
                        force: [false; 3],
                        ..axes
                    })
                }
                _ => None,
            }
        });
        Self { name: name.to_owned(), controlled, sets: axes.collect() }
    }

    /// Axes of the world of a frame that no task controls.
    pub(crate) fn of_frame(experiment: &Experiment, frame: FrameId) -> Self {
        let axes = TaskAxes {
            directions: AxesFrame::Fixed(Matrix3::identity()),
            motion: [false; 6],
            compliant: [false; 3],
            compliant_rotations: [false; 3],
            force: [false; 3],
            target: None,
            presses: false,
            stiffness_n_per_m: [None; 3],
        };
        let sets = vec![Some(axes); 1 + experiment.task().events.len()];
        Self { name: String::new(), controlled: ControlledFrame::Frame(frame), sets }
    }

    /// Axes whose force the task controls in some task set.
    pub fn force_axes(&self) -> [bool; 3] {
        [0, 1, 2].map(|axis| self.sets.iter().flatten().any(|axes| axes.force[axis]))
    }

    /// Axes of the task if they are the same during the whole run.
    pub fn constant(&self, run: &Run<'_>) -> Option<TaskAxes> {
        let first = (*self.sets.first()?)?;
        let is_logged =
            [MODES, AXES].iter().any(|name| run.tick.signal(&signal_names::of(&self.name, name)).is_some());
        (!is_logged && self.sets.iter().all(|axes| *axes == Some(first))).then_some(first)
    }

    /// Rows of the joints during control.
    pub fn rows(&self, run: &Run<'_>) -> Vec<TaskRow> {
        let signal = |name: &str| run.tick.signal(&signal_names::of(&self.name, name));
        let (set_in_force, modes, turned) = (run.tick.signal(TASK_SET), signal(MODES), signal(AXES));
        let axes_at = |k: usize| {
            let set = match &set_in_force {
                // The number is logged if a program can change it too.
                Some(set) => set.row(run.tick_up_to(k)?)[0] as usize,
                None => {
                    let since_start_s = run.joints.0[k] - run.start_s + run.same_s;
                    run.experiment.task().events.iter().filter(|e| e.time_s <= since_start_s).count()
                }
            };
            let mut axes = self.sets.get(set).copied().flatten()?;
            // They stay as they are through missed cycles.
            let tick = run.tick_up_to(k);
            if let Some((modes, tick)) = modes.zip(tick) {
                axes = axes.with_modes(modes.row(tick));
            }
            if let Some((turned, tick)) = turned.zip(tick) {
                axes = axes.with_directions(turned.row(tick));
            }
            Some(axes)
        };
        let world = AxesFrame::Fixed(Matrix3::identity());
        let directions = |k: usize| axes_at(k).map_or(world, |axes| axes.directions);
        let poses = run.poses(self.controlled, directions);
        let row = |(k, pose, [rotation, coordinates]): (usize, Placement, [Matrix3<f64>; 2])| TaskRow {
            k,
            pose,
            rotation,
            in_world: coordinates * rotation,
            axes: axes_at(k),
        };
        poses.map(row).collect()
    }
}

/// Converts a logged orientation: a quaternion, real part first.
pub fn orientation(wxyz: &[f64]) -> Matrix3<f64> {
    let quaternion = Quaternion::new(wxyz[0], wxyz[1], wxyz[2], wxyz[3]);
    UnitQuaternion::from_quaternion(quaternion).to_rotation_matrix().into_inner()
}

//! Response of frames that no Cartesian task controls to external forces, along the axes of the world.

use super::response::Response;
use super::run_log::Run;
use super::task_axes::AxesOfTask;
use super::tasks::total;
use crate::metrics::metric_tables::ForceResponse;
use crate::run::experiment::Experiment;
use opspace_control::TaskParameters;
use opspace_coupling::CoupledParameters;
use std::collections::BTreeMap;

/// Frame on which objects of the environment act, although no task controls it.
pub struct FreeFrame<'a> {
    /// Name of the frame.
    pub frame: &'a str,
    /// Axes of the world, in each task set.
    pub axes: AxesOfTask,
}

/// Frames on which objects of the environment act, although neither a Cartesian nor a coupled task controls them, in the order of the objects.
pub fn free_frames(experiment: &Experiment) -> Vec<FreeFrame<'_>> {
    let tasks = experiment.task().tasks_of_the_run();
    let is_controlled = |frame: &str| {
        tasks.iter().any(|(_, task)| match task {
            TaskParameters::Cartesian(task) => task.frame == frame,
            TaskParameters::Registered(task) => {
                let coupled = task.parameters::<CoupledParameters>();
                coupled.is_some_and(|task| task.frame.as_deref() == Some(frame))
            }
            _ => false,
        })
    };
    let mut frames: Vec<FreeFrame<'_>> = Vec::new();
    for object in experiment.task().file.environment.values() {
        let frame = object.frame();
        let is_known = frames.iter().any(|other| other.frame == frame);
        let id = experiment.robot().model.frame_id(frame).ok();
        if let Some(id) = id.filter(|_| !is_known && !is_controlled(frame)) {
            frames.push(FreeFrame { frame, axes: AxesOfTask::of_frame(experiment, id) });
        }
    }
    frames
}

/// Adds the rows of a segment of a log to the response of a frame.
pub fn add(run: &Run<'_>, FreeFrame { frame, axes }: &FreeFrame<'_>, response: &mut Response) {
    let Some(forces) = run.forces_on(frame).filter(|forces| !forces.is_empty()) else { return };
    let counted = run.settled(run.joints.0);
    for row in axes.rows(run) {
        let time_s = run.joints.0[row.k];
        if let (true, Some(axes)) = (counted.contains(&row.k) && !run.is_held(time_s), row.axes) {
            let force_n = row.in_world.tr_mul(&total(&forces, row.k));
            response.add(time_s - run.start_s, &row, &axes, &force_n, None);
        }
    }
}

/// Responses of such frames while segments of a log arrive.
pub(super) struct FrameResponses<'a> {
    frames: Vec<(FreeFrame<'a>, Response)>,
}

impl<'a> FrameResponses<'a> {
    pub(super) fn new(experiment: &'a Experiment) -> Self {
        Self {
            frames: free_frames(experiment).into_iter().map(|frame| (frame, Response::default())).collect(),
        }
    }

    pub(super) fn add(&mut self, run: &Run<'_>) {
        self.frames.iter_mut().for_each(|(frame, response)| add(run, frame, response));
    }

    /// Returns the metrics of each frame along each axis, by the name of the frame, and the response of the first frame.
    pub(super) fn finish(self) -> (BTreeMap<String, BTreeMap<String, f64>>, ForceResponse) {
        let (mut frames, mut first) = (BTreeMap::new(), ForceResponse::default());
        for (FreeFrame { frame, .. }, response) in self.frames {
            let mut axes = BTreeMap::new();
            let own = response.finish(&mut axes);
            if !axes.is_empty() {
                frames.insert(frame.to_owned(), axes);
            }
            if first == ForceResponse::default() {
                first = own;
            }
        }
        (frames, first)
    }
}

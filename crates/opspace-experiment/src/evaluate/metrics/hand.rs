//! Force and motion of the first simulated hand.

use super::run_log::{RmsMax, Run, masked_norm};
use crate::metrics::metric_tables::Metrics;
use crate::run::experiment::Experiment;
use nalgebra::{Matrix3, Vector3};
use opspace_backend::signal_names::{self, FORCE, TRUTH_CHANNEL};
use opspace_control::{AxesFrame, ControlledFrame};
use opspace_model::{FrameId, Placement};
use opspace_sim::{EnvironmentObjectParameters, WorldAxis};

/// Hand of an experiment, over the axes that it reports.
pub(super) struct Hand {
    /// Name of the signal of its force.
    force: String,
    axes: [bool; 3],
    frame: Option<FrameId>,
    /// Pose of its frame at the start of control.
    home: Option<Placement>,
    force_n: RmsMax,
    motion_m: RmsMax,
}

impl Hand {
    /// Returns `None` if the environment has no hand.
    pub(super) fn new(experiment: &Experiment) -> Option<Self> {
        let (name, spring) =
            experiment.task().file.environment.iter().find_map(|(name, object)| match object {
                EnvironmentObjectParameters::Spring(spring) => Some((name, spring)),
                _ => None,
            })?;
        Some(Self {
            force: signal_names::of(name, FORCE),
            axes: [WorldAxis::X, WorldAxis::Y, WorldAxis::Z].map(|axis| spring.report.contains(&axis)),
            frame: experiment.robot().model.frame_id(&spring.frame).ok(),
            home: None,
            force_n: RmsMax::default(),
            motion_m: RmsMax::default(),
        })
    }

    pub(super) fn add(&mut self, run: &Run<'_>) {
        if let Some(truth) = run.recording.channel(TRUTH_CHANNEL)
            && let Some(force) = truth.signal(&self.force)
        {
            for k in run.counted(&truth.time_s) {
                self.force_n.add(masked_norm(&Vector3::from_column_slice(force.row(k)), &self.axes));
            }
        }
        let Some(frame) = self.frame else { return };
        self.home = self.home.or_else(|| run.first_pose(frame));
        let Some(home) = self.home else { return };
        let world = AxesFrame::Fixed(Matrix3::identity());
        let settled = run.settled(run.joints.0);
        for (k, pose, _) in run.poses(ControlledFrame::Frame(frame), |_| world) {
            if !settled.contains(&k) || run.is_held(run.joints.0[k]) {
                continue;
            }
            self.motion_m.add(masked_norm(&(pose.translation - home.translation), &self.axes));
        }
    }

    pub(super) fn finish(self, metrics: &mut Metrics) {
        metrics.hand_force_rms_n = self.force_n.rms();
        metrics.hand_motion_rms_m = self.motion_m.rms();
    }
}

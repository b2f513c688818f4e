//! The log that is evaluated: its rows after settling, and poses at them.

use crate::run::experiment::Experiment;
use nalgebra::{Matrix3, Vector3};
use opspace_backend::signal_names::{PHASE, Q, TICK_CHANNEL, TRUTH_CHANNEL};
use opspace_control::{AxesFrame, ControlledFrame};
use opspace_log::{ChannelData, Column, Recording};
use opspace_loop::Phase;
use opspace_model::{Data, FrameId, Placement, frame_placement, kinematics};

/// Log that is evaluated, with its experiment.
pub(crate) struct Run<'a> {
    pub(crate) experiment: &'a Experiment,
    pub(crate) recording: &'a Recording,
    pub(crate) tick: &'a ChannelData,
    /// Times (s) and positions (n; rad or m) of the joints: true ones if the log contains them, otherwise measured
    /// ones.
    pub(crate) joints: (&'a [f64], Column<'a>),
    /// Time of the first cycle of control on the robot's clock, s.
    pub(crate) start_s: f64,
    pub(crate) from_s: f64,
    pub(crate) to_s: f64,
    /// Tolerance within which two times are equal, s: times are rounded multiples of a servo period.
    pub(crate) same_s: f64,
}

impl<'a> Run<'a> {
    pub(crate) fn new(experiment: &'a Experiment, recording: &'a Recording) -> Option<Self> {
        let tick = recording.channel(TICK_CHANNEL)?;
        let phase = tick.signal(PHASE)?;
        let idle = [Phase::Rest, Phase::Stopped].map(Phase::code);
        let mut controlled = (0..tick.len()).filter(|&k| !idle.contains(&phase.row(k)[0]));
        let first = controlled.next()?;
        let last = controlled.next_back().unwrap_or(first);
        let positions = recording.channel(TRUTH_CHANNEL).unwrap_or(tick);
        Some(Self {
            experiment,
            recording,
            tick,
            joints: (&positions.time_s, positions.signal(Q)?),
            start_s: tick.time_s[first],
            from_s: tick.time_s[first] + experiment.task().file.settle_s.get(),
            to_s: tick.time_s[last],
            same_s: 0.25 * experiment.profile().1.servo_period_s(),
        })
    }

    /// Indices of the times in the evaluated interval: after settling, up to the last control cycle.
    pub(crate) fn settled(&self, times: &'a [f64]) -> std::ops::Range<usize> {
        let begin = times.partition_point(|&t| t < self.from_s - self.same_s);
        let end = times.partition_point(|&t| t <= self.to_s + self.same_s);
        begin..end.max(begin)
    }

    /// Index of the interface cycle at row `k` of the joints; `None` if the cycle was missed.
    pub(crate) fn tick_of(&self, k: usize) -> Option<usize> {
        let (times, _) = self.joints;
        let ticks = &self.tick.time_s;
        let tick = ticks.partition_point(|&t| t < times[k] - self.same_s);
        ticks.get(tick).is_some_and(|&t| t <= times[k] + self.same_s).then_some(tick)
    }

    /// Indices of the rows of the joints from the first control cycle to the last.
    pub(crate) fn controlled(&self) -> std::ops::Range<usize> {
        let times = self.joints.0;
        let begin = times.partition_point(|&t| t < self.start_s - self.same_s);
        begin..self.settled(times).end.max(begin)
    }

    /// Pose of a task's controlled frame and the task's axes at each evaluated row of the joints, with the row index.
    pub(crate) fn poses(
        &self,
        subject: ControlledFrame,
        directions: AxesFrame,
    ) -> impl Iterator<Item = (usize, Placement, Matrix3<f64>)> {
        self.poses_of(self.settled(self.joints.0), subject, directions)
    }

    /// Pose of a task's controlled frame and the task's axes at some rows of the joints, with the row index.
    pub(crate) fn poses_of(
        &self,
        rows: std::ops::Range<usize>,
        subject: ControlledFrame,
        directions: AxesFrame,
    ) -> impl Iterator<Item = (usize, Placement, Matrix3<f64>)> {
        let model = &self.experiment.robot().model;
        let mut data = Data::new(model);
        let rest = vec![0.0; model.n()];
        let (_, q) = self.joints;
        rows.map(move |k| {
            kinematics(model, &mut data, q.row(k), &rest);
            let axes = directions.rotation(model, &data, subject);
            (k, subject.placement(model, &data), axes)
        })
    }

    /// Pose of a frame at the start of control.
    pub(crate) fn start_pose(&self, frame: FrameId) -> Option<Placement> {
        let model = &self.experiment.robot().model;
        let (times, q) = self.joints;
        let k = times.iter().position(|&t| t >= self.start_s - self.same_s)?;
        let mut data = Data::new(model);
        kinematics(model, &mut data, q.row(k), &vec![0.0; model.n()]);
        Some(frame_placement(model, &data, frame))
    }
}

/// Sums of the squares of an error and of the quantity to which it is relative.
#[derive(Clone, Default)]
pub(crate) struct Relative {
    error: f64,
    size: f64,
    count: u64,
}

impl Relative {
    pub(crate) fn add(&mut self, desired: f64, actual: f64) {
        self.error += (actual - desired).powi(2);
        self.size += desired.powi(2);
        self.count += 1;
    }

    pub(crate) fn get(&self) -> Option<f64> {
        finite((self.error / self.size).sqrt())
    }

    pub(crate) fn mean_square(&self) -> f64 {
        self.error / self.count as f64
    }

    /// Rms of the error.
    pub(crate) fn rms(&self) -> Option<f64> {
        finite(self.mean_square().sqrt())
    }
}

pub(crate) fn finite(number: f64) -> Option<f64> {
    number.is_finite().then_some(number)
}

/// Norm over the selected elements.
pub(crate) fn masked_norm(v: &Vector3<f64>, counted: &[bool]) -> f64 {
    v.iter().zip(counted).filter(|(_, counted)| **counted).map(|(x, _)| x * x).sum::<f64>().sqrt()
}

pub(crate) fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (count, sum) = values.fold((0_u64, 0.0), |(count, sum), v| (count + 1, sum + v));
    (count > 0).then(|| sum / count as f64)
}

pub(crate) fn rms_and_max(values: impl Iterator<Item = f64>) -> (Option<f64>, Option<f64>) {
    let mut max = None;
    let squares = values.map(|v| {
        max = Some(max.map_or(v, |m: f64| m.max(v)));
        v * v
    });
    let rms = mean(squares).map(f64::sqrt);
    (rms, max)
}

//! The log that is evaluated, segment by segment: its rows after settling, and poses at them.

use crate::run::experiment::Experiment;
use nalgebra::{Matrix3, Vector3};
use opspace_backend::signal_names::{PHASE, Q, TICK_CHANNEL, TRUTH_CHANNEL};
use opspace_control::{AxesFrame, ControlledFrame};
use opspace_log::{ChannelData, Column, Recording};
use opspace_loop::Phase;
use opspace_model::{Data, FrameId, Placement, frame_placement, kinematics};
use std::ops::Range;

/// Smallest true contact force that counts as contact, N.
pub(crate) const CONTACT_N: f64 = 0.1;

/// Beginning and end of control, as far as a log was read.
#[derive(Clone, Copy, Debug, Default)]
pub struct Control {
    /// Time of the first cycle of control on the robot's clock, s.
    pub start_s: Option<f64>,
    /// True after the robot was stopped.
    pub(crate) is_over: bool,
}

/// Segment of a log that is evaluated, with its experiment.
pub struct Run<'a> {
    /// Experiment of the run.
    pub experiment: &'a Experiment,
    /// All rows of the segment.
    pub recording: &'a Recording,
    /// Rows of the control cycles.
    pub tick: &'a ChannelData,
    /// Times (s) and positions (n; rad or m) of the joints: true ones if the log contains them, otherwise measured
    /// ones.
    pub joints: (&'a [f64], Column<'a>),
    /// Time of the first cycle of control on the robot's clock, s.
    pub start_s: f64,
    pub(crate) from_s: f64,
    /// Time of the last cycle of control on the robot's clock, s; infinite while the log goes on.
    pub to_s: f64,
    /// Intervals in which the robot is held, or its torques ramp in after a hold, s.
    held_s: Vec<[f64; 2]>,
    /// Tolerance within which two times are equal, s: times are rounded multiples of a servo period.
    pub same_s: f64,
}

impl<'a> Run<'a> {
    /// Returns the segment `recording`, which follows those with which `control` was called before. `None` before
    /// control begins.
    pub fn new(
        experiment: &'a Experiment,
        recording: &'a Recording,
        control: &mut Control,
        is_last: bool,
    ) -> Option<Self> {
        let tick = recording.channel(TICK_CHANNEL)?;
        let phase = tick.signal(PHASE)?;
        let is_idle = |code: f64| code == Phase::Rest.code() || Phase::is_after_stop(code);
        let is_controlled = |k: &usize| !is_idle(phase.row(*k)[0]);
        let first = (0..tick.len()).find(is_controlled);
        let start_s = match control.start_s {
            Some(start_s) => start_s,
            None => *control.start_s.insert(tick.time_s[first?]),
        };
        let same_s = 0.25 * experiment.profile().1.servo_period_s();
        let begin = first.unwrap_or(0);
        let stopped = (begin..tick.len()).find(|k| Phase::is_after_stop(phase.row(*k)[0]));
        let was_over = control.is_over;
        control.is_over |= stopped.is_some();
        let to_s = match stopped {
            _ if was_over => f64::NEG_INFINITY,
            Some(stopped) => tick.time_s[stopped] - 2.0 * same_s,
            None if is_last => (begin..tick.len()).rfind(is_controlled).map_or(start_s, |k| tick.time_s[k]),
            None => f64::INFINITY,
        };
        let positions = recording.channel(TRUTH_CHANNEL).unwrap_or(tick);
        Some(Self {
            experiment,
            recording,
            tick,
            joints: (&positions.time_s, positions.signal(Q)?),
            start_s,
            from_s: start_s + experiment.task().file.settle_s.get(),
            to_s,
            held_s: held_s(tick, &phase),
            same_s,
        })
    }

    /// Indices of the times in the evaluated interval: after settling, up to the last control cycle.
    pub fn settled(&self, times: &[f64]) -> Range<usize> {
        let begin = times.partition_point(|&t| t < self.from_s - self.same_s);
        let end = times.partition_point(|&t| t <= self.to_s + self.same_s);
        begin..end.max(begin)
    }

    /// Indices of the times in the evaluated interval at which the controller acts as it should: not those of a hold, nor of the
    /// torque ramp after it.
    pub(crate) fn counted<'b>(&'b self, times: &'b [f64]) -> impl Iterator<Item = usize> + Clone + 'b {
        self.settled(times).filter(move |&k| !self.is_held(times[k]))
    }

    /// True at a time in a hold, or in the torque ramp after it.
    pub fn is_held(&self, time_s: f64) -> bool {
        let begun = self.held_s.partition_point(|[begin_s, _]| *begin_s <= time_s + self.same_s);
        self.held_s[..begun].last().is_some_and(|[_, end_s]| time_s <= end_s + self.same_s)
    }

    /// Indices of the counted control cycles.
    pub(crate) fn counted_ticks(&self) -> impl Iterator<Item = usize> + Clone + '_ {
        self.counted(&self.tick.time_s)
    }

    /// Indices of the control cycles in the evaluated interval.
    pub(crate) fn settled_ticks(&self) -> Range<usize> {
        self.settled(&self.tick.time_s)
    }

    /// Index of the interface cycle at row `k` of the joints; `None` if the cycle was missed.
    pub fn tick_of(&self, k: usize) -> Option<usize> {
        let (times, _) = self.joints;
        let ticks = &self.tick.time_s;
        let tick = ticks.partition_point(|&t| t < times[k] - self.same_s);
        ticks.get(tick).is_some_and(|&t| t <= times[k] + self.same_s).then_some(tick)
    }

    /// Index of the last cycle that was not missed, at row `k` of the joints or before; the first one of the segment if
    /// there is none.
    pub fn tick_up_to(&self, k: usize) -> Option<usize> {
        let ticks = &self.tick.time_s;
        let after = ticks.partition_point(|&t| t <= self.joints.0[k] + self.same_s);
        (!ticks.is_empty()).then(|| after.saturating_sub(1))
    }

    /// Indices of the rows of the joints from the first control cycle to the last.
    pub fn controlled(&self) -> Range<usize> {
        let times = self.joints.0;
        let begin = times.partition_point(|&t| t < self.start_s - self.same_s);
        begin..self.settled(times).end.max(begin)
    }

    /// Pose of a task's controlled frame, the task's axes, whose frame `directions` returns for a row, and the coordinates
    /// of both in the world, at each row of the joints during control, with the row index.
    pub(crate) fn poses(
        &self,
        subject: ControlledFrame,
        mut directions: impl FnMut(usize) -> AxesFrame,
    ) -> impl Iterator<Item = (usize, Placement, [Matrix3<f64>; 2])> {
        let model = &self.experiment.robot().model;
        let mut data = Data::new(model);
        let rest = vec![0.0; model.n()];
        let (_, q) = self.joints;
        self.controlled().map(move |k| {
            kinematics(model, &mut data, q.row(k), &rest);
            let axes = directions(k).rotation(model, &data, subject);
            (k, subject.placement(model, &data), [axes, subject.coordinates(model, &data)])
        })
    }

    /// Pose of a frame at the first row of control.
    pub(crate) fn first_pose(&self, frame: FrameId) -> Option<Placement> {
        let model = &self.experiment.robot().model;
        let k = Some(self.controlled()).filter(|rows| !rows.is_empty())?.start;
        let mut data = Data::new(model);
        kinematics(model, &mut data, self.joints.1.row(k), &vec![0.0; model.n()]);
        Some(frame_placement(model, &data, frame))
    }
}

/// Intervals of the cycles in which the robot is held, or its torques ramp in after a hold, s.
fn held_s(tick: &ChannelData, phase: &Column<'_>) -> Vec<[f64; 2]> {
    let is_held = |k: usize| Phase::is_interrupted(phase.row(k)[0]);
    let mut intervals: Vec<[f64; 2]> = Vec::new();
    for k in (0..tick.len()).filter(|&k| is_held(k)) {
        match intervals.last_mut().filter(|_| k > 0 && is_held(k - 1)) {
            Some([_, end_s]) => *end_s = tick.time_s[k],
            None => intervals.push([tick.time_s[k]; 2]),
        }
    }
    intervals
}

/// Mean of numbers that arrive one by one.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Mean {
    sum: f64,
    count: u64,
}

impl Mean {
    pub(crate) fn add(&mut self, value: f64) {
        self.sum += value;
        self.count += 1;
    }

    pub(crate) fn get(self) -> Option<f64> {
        (self.count > 0).then(|| self.sum / self.count as f64)
    }
}

/// Rms and largest of numbers that arrive one by one.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct RmsMax {
    squares: Mean,
    max: Option<f64>,
}

impl RmsMax {
    pub(crate) fn add(&mut self, value: f64) {
        self.squares.add(value * value);
        self.max = Some(self.max.map_or(value, |max| max.max(value)));
    }

    pub(crate) fn rms(self) -> Option<f64> {
        self.squares.get().map(f64::sqrt)
    }

    pub(crate) fn max(self) -> Option<f64> {
        self.max
    }
}

/// Sums of the squares of an error and of the quantity to which it is relative.
#[derive(Clone, Debug, Default)]
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
pub fn masked_norm(v: &Vector3<f64>, counted: &[bool]) -> f64 {
    v.iter().zip(counted).filter(|(_, counted)| **counted).map(|(x, _)| x * x).sum::<f64>().sqrt()
}

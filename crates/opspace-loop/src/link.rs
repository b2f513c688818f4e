//! Links between robots: a link sends signals of one robot's row to the targets of another robot, through a channel
//! with delay, jitter, loss and reordering.
//!
//! A link uses the integer clock of a [`Timeline`]. Received values are inputs of the receiving robot and are recorded
//! in its log, so that each robot's log can be replayed alone.

use crate::phase::Phase;
use crate::timeline::Timeline;
use opspace_backend::Layout;
use opspace_backend::signal_names::PHASE;
use opspace_control::{InputHandle, TargetError, Targets, TaskHandle};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::ops::Range;
use thiserror::Error;

/// Properties of a channel. All random numbers come from the seed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ChannelParameters {
    /// Constant delay of a packet, s.
    pub delay_s: f64,
    /// Largest additional delay, uniformly distributed, s.
    pub jitter_s: f64,
    /// Probability that a packet is lost.
    pub loss: f64,
    /// True if a packet may arrive after one that was sent later.
    pub reordering: bool,
    /// Seed of the random numbers.
    pub seed: u64,
}

/// Reason why a link can't be created.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum LinkError {
    /// Signal that the sending robot does not record.
    #[error("the sending robot does not record the signal '{0}'")]
    Signal(String),
    /// Unknown task or input of the receiving robot, or an input of another length.
    #[error(transparent)]
    Target(#[from] TargetError),
    /// Channel parameters out of range.
    #[error("delay_s and jitter_s must be finite and not negative, and loss between 0 and 1")]
    Parameters,
}

/// Link from one robot to a task of another.
pub struct Link {
    from: usize,
    to: usize,
    task: TaskHandle,
    /// Columns of the sender's row, and the inputs to which they are copied.
    copies: Vec<(Range<usize>, InputHandle)>,
    /// Column of the sender's phase in its row.
    phase: usize,
    channel: Channel,
    /// Values of a packet: the sender's phase, then the copies.
    values: Vec<f64>,
}

impl Link {
    /// Returns a link from the robot `from`, whose rows have the layout `row`, to the task `task` of the robot `to`.
    /// `copies` are pairs of a signal of the row and an input of the task.
    ///
    /// # Errors
    /// If a name is unknown, lengths differ, or parameters are out of range.
    pub fn new(
        timeline: &Timeline,
        (from, row): (usize, &Layout),
        (to, targets, task): (usize, &Targets, &str),
        copies: &[(&str, &str)],
        parameters: ChannelParameters,
    ) -> Result<Self, LinkError> {
        let task = targets.task(task)?;
        let mut found = Vec::new();
        for &(signal, input) in copies {
            let (range, input) = (columns(row, signal)?, targets.input(&task, input)?);
            if range.len() != input.len() {
                return Err(TargetError::Length { expected: input.len(), found: range.len() }.into());
            }
            found.push((range, input));
        }
        let width = 1 + found.iter().map(|(range, _)| range.len()).sum::<usize>();
        Ok(Self {
            from,
            to,
            task,
            copies: found,
            phase: columns(row, PHASE)?.start,
            channel: Channel::new(timeline, parameters, width)?,
            values: vec![0.0; width],
        })
    }

    /// Number of the sending robot.
    #[must_use]
    pub fn from(&self) -> usize {
        self.from
    }

    /// Number of the receiving robot.
    #[must_use]
    pub fn to(&self) -> usize {
        self.to
    }

    /// Sends the sender's row at `tick`. Allocates nothing.
    pub fn send(&mut self, tick: u64, row: &[f64]) {
        self.values[0] = row[self.phase];
        let mut at = 1;
        for (range, _) in &self.copies {
            self.values[at..at + range.len()].copy_from_slice(&row[range.clone()]);
            at += range.len();
        }
        self.channel.send(tick, &self.values);
    }

    /// Writes the packets that arrived by `tick` to the receiver's targets, stamped with its clock `clock_s` (s). If
    /// the sender is held or stopped, the receiver is held. Allocates nothing.
    pub fn deliver(&mut self, tick: u64, clock_s: f64, targets: &mut Targets) {
        while let Some(values) = self.channel.receive(tick) {
            targets.hold([Phase::Held, Phase::Stopped].map(Phase::code).contains(&values[0]));
            let mut at = 1;
            for (range, input) in &self.copies {
                let copied = &values[at..at + range.len()];
                at += range.len();
                // A NaN signal is not written: the last value remains.
                let _ = targets.write(&self.task, clock_s, &[(input, copied)]);
            }
        }
    }
}

/// Columns of a signal in a row.
fn columns(layout: &Layout, name: &str) -> Result<Range<usize>, LinkError> {
    layout.columns(name).ok_or_else(|| LinkError::Signal(name.to_owned()))
}

/// Channel with its packets in transit.
struct Channel {
    delay: u64,
    jitter: u64,
    loss: f64,
    reordering: bool,
    random: ChaCha8Rng,
    last_arrival: u64,
    /// Slots for packets; the arrival of a free slot is `None`.
    packets: Vec<Packet>,
    sent: u64,
    out: Vec<f64>,
}

#[derive(Clone)]
struct Packet {
    arrives: Option<u64>,
    number: u64,
    values: Vec<f64>,
}

impl Channel {
    fn new(timeline: &Timeline, parameters: ChannelParameters, width: usize) -> Result<Self, LinkError> {
        let ChannelParameters { delay_s, jitter_s, loss, reordering, seed } = parameters;
        let is_duration = |s: f64| s.is_finite() && s >= 0.0;
        if !is_duration(delay_s) || !is_duration(jitter_s) || !(0.0..=1.0).contains(&loss) {
            return Err(LinkError::Parameters);
        }
        let (delay, jitter) = (timeline.ticks(delay_s), timeline.ticks(jitter_s));
        // At most one packet is sent per tick.
        let slots = usize::try_from(delay + jitter).unwrap_or(usize::MAX).saturating_add(2);
        let packet = Packet { arrives: None, number: 0, values: vec![0.0; width] };
        Ok(Self {
            delay,
            jitter,
            loss,
            reordering,
            random: ChaCha8Rng::seed_from_u64(seed),
            last_arrival: 0,
            packets: vec![packet; slots],
            sent: 0,
            out: vec![0.0; width],
        })
    }

    fn send(&mut self, tick: u64, values: &[f64]) {
        // Both numbers are drawn for every packet, so that loss and jitter don't affect each other.
        let lost = self.random.random_range(0.0..1.0) < self.loss;
        let late = self.random.random_range(0..=self.jitter);
        self.sent += 1;
        let slot = self.packets.iter_mut().find(|packet| packet.arrives.is_none());
        let Some(packet) = slot.filter(|_| !lost) else { return };
        let arrives = tick + self.delay + late;
        let arrives = if self.reordering { arrives } else { arrives.max(self.last_arrival) };
        self.last_arrival = arrives;
        packet.arrives = Some(arrives);
        packet.number = self.sent;
        packet.values.copy_from_slice(values);
    }

    /// Returns the next packet that arrived by `tick`, in the order of arrival, then of sending.
    fn receive(&mut self, tick: u64) -> Option<&[f64]> {
        let arrived = self.packets.iter_mut().filter(|p| p.arrives.is_some_and(|at| at <= tick));
        let packet = arrived.min_by_key(|packet| (packet.arrives, packet.number))?;
        packet.arrives = None;
        self.out.copy_from_slice(&packet.values);
        Some(&self.out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn channel(parameters: ChannelParameters) -> Channel {
        Channel::new(&Timeline::new(&[1000]).expect("a good clock"), parameters, 1).expect("a good clock")
    }

    /// Sends a packet at each of 1000 ticks, with the tick's number; returns ticks of arrival and numbers.
    fn arrivals(mut channel: Channel) -> Vec<(u64, f64)> {
        let mut arrivals = Vec::new();
        for tick in 0..1100 {
            if tick < 1000 {
                channel.send(tick, &[tick as f64]);
            }
            while let Some(values) = channel.receive(tick) {
                arrivals.push((tick, values[0]));
            }
        }
        arrivals
    }

    /// Compared: arrival times, and sending times plus the delay.
    #[test]
    fn constant_delay_shifts_every_packet() {
        let arrived = arrivals(channel(ChannelParameters { delay_s: 0.02, ..Default::default() }));
        let expected: Vec<(u64, f64)> = (0..1000).map(|tick| (tick + 20, tick as f64)).collect();
        assert_eq!(arrived, expected);
    }

    /// Compared: the order of arrival with and without reordering, and the order of sending.
    #[test]
    fn jitter_reorders_only_if_allowed() {
        for reordering in [false, true] {
            let parameters =
                ChannelParameters { delay_s: 0.005, jitter_s: 0.01, reordering, ..Default::default() };
            let arrived = arrivals(channel(parameters));
            assert_eq!(arrived.len(), 1000);
            let in_order = arrived.windows(2).all(|pair| pair[0].1 < pair[1].1);
            assert_eq!(in_order, !reordering);
            let late = |&(at, sent): &(u64, f64)| at as f64 - sent;
            assert!(arrived.iter().map(late).all(|late| late >= 5.0));
            assert!(arrived.iter().map(late).any(|late| late > 12.0));
        }
    }

    /// Compared: the fraction of lost packets and its probability; arrivals of two channels with the same seed, and
    /// with different seeds.
    #[test]
    fn loss_is_random_and_seeded() {
        let lossy = |seed| arrivals(channel(ChannelParameters { loss: 0.3, seed, ..Default::default() }));
        let arrived = lossy(1).len();
        // 1000 draws have a standard deviation of 14.5; tolerance: five of them.
        assert!((628..=772).contains(&arrived), "{arrived} of 1000 at a loss of 0.3");
        assert_eq!(lossy(1), lossy(1));
        assert_ne!(lossy(1), lossy(2));
    }
}

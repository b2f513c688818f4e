//! Links between robots: a link sends signals of one robot's row to the targets of another robot, through a channel
//! with delay, jitter, loss and reordering.
//!
//! A link uses the integer clock of a [`Timeline`]. Received values are inputs of the receiving robot and are recorded
//! in its log, so that each robot's log can be replayed alone.

use crate::phase::Phase;
use crate::timeline::Timeline;
use opspace_backend::Layout;
use opspace_backend::signal_names::{PHASE, TARGET_HOLD};
use opspace_control::{HoldCause, InputHandle, TargetError, Targets, TaskHandle};
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
    /// Time without a packet after which the receiver is held, s; `None`: never.
    pub hold_after_s: Option<f64>,
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
    #[error("delay_s, jitter_s and hold_after_s must be finite and not negative, and loss between 0 and 1")]
    Parameters,
}

/// Link from one robot to another: it holds the other one while the sender is held or stopped, and may copy signals to a
/// task.
pub struct Link {
    from: usize,
    to: usize,
    task: Option<TaskHandle>,
    /// Columns of the sender's row, and the inputs to which they are copied.
    copies: Vec<(Range<usize>, InputHandle)>,
    /// Columns of the sender's phase and of the hold that is requested of it, in its row.
    phase: usize,
    hold: Option<usize>,
    channel: Channel,
    /// Values of a packet: 1 if the sender is held or stopped by itself, then the copies.
    values: Vec<f64>,
    /// True while the sender is in a hold that another robot caused, until it has resumed.
    is_hold_of_other: bool,
    /// True while the sender is held or stopped by itself, as far as the receiver knows.
    is_held: bool,
    /// Tick at which the last packet arrived, and the ticks after which the sender is silent.
    heard: u64,
    silent_after: Option<u64>,
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
        let mut link = Self::status(timeline, (from, row), to, parameters)?;
        let task = targets.task(task)?;
        for &(signal, input) in copies {
            let (range, input) = (columns(row, signal)?, targets.input(&task, input)?);
            if range.len() != input.len() {
                return Err(TargetError::Length { expected: input.len(), found: range.len() }.into());
            }
            link.copies.push((range, input));
        }
        let width = 1 + link.copies.iter().map(|(range, _)| range.len()).sum::<usize>();
        link.task = Some(task);
        link.channel = Channel::new(timeline, parameters, width)?;
        link.values = vec![0.0; width];
        Ok(link)
    }

    /// Returns a link from the robot `from`, whose rows have the layout `row`, to the robot `to`, that copies no signals.
    ///
    /// # Errors
    /// If the rows have no phase, or parameters are out of range.
    pub fn status(
        timeline: &Timeline,
        (from, row): (usize, &Layout),
        to: usize,
        parameters: ChannelParameters,
    ) -> Result<Self, LinkError> {
        Ok(Self {
            from,
            to,
            task: None,
            copies: Vec::new(),
            phase: columns(row, PHASE)?.start,
            hold: columns(row, TARGET_HOLD).ok().map(|range| range.start),
            channel: Channel::new(timeline, parameters, 1)?,
            values: vec![0.0],
            is_hold_of_other: false,
            is_held: false,
            heard: 0,
            silent_after: parameters.hold_after_s.map(|s| timeline.ticks(s)),
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
        self.values[0] = f64::from(u8::from(self.is_held_by_itself(row)));
        let mut at = 1;
        for (range, _) in &self.copies {
            self.values[at..at + range.len()].copy_from_slice(&row[range.clone()]);
            at += range.len();
        }
        self.channel.send(tick, &self.values);
    }

    /// True if the sender is stopped, or held for a reason that is not another robot: two robots that hold because of each
    /// other would never go on. A hold that another robot caused lasts beyond its cause, until the sender stands still.
    fn is_held_by_itself(&mut self, row: &[f64]) -> bool {
        let is_held = row[self.phase] == Phase::Held.code();
        let cause = self.hold.and_then(|column| HoldCause::from_code(row[column]));
        let is_of_other = matches!(cause, Some(HoldCause::RobotHeld(_) | HoldCause::RobotSilent(_)));
        self.is_hold_of_other = is_held && (self.is_hold_of_other || is_of_other);
        Phase::is_after_stop(row[self.phase]) || (is_held && !self.is_hold_of_other)
    }

    /// Writes the newest packet that arrived by `tick` to the receiver's targets, stamped with its clock `clock_s` (s).
    /// Returns the cause for which the receiver must hold, for [`Targets::hold_because`]. Allocates nothing.
    pub fn deliver(&mut self, tick: u64, clock_s: f64, targets: &mut Targets) -> Option<HoldCause> {
        if let Some(values) = self.channel.receive_newest(tick) {
            self.heard = tick;
            self.is_held = values[0] == 1.0;
            let mut at = 1;
            for (range, input) in &self.copies {
                let copied = &values[at..at + range.len()];
                at += range.len();
                if let Some(task) = &self.task {
                    // A signal that is infinite is not written: the last value remains.
                    let _ = targets.write(task, clock_s, &[(input, copied)]);
                }
            }
        }
        if self.is_held {
            Some(HoldCause::RobotHeld(self.from))
        } else if self.silent_after.is_some_and(|after| tick - self.heard > after) {
            Some(HoldCause::RobotSilent(self.from))
        } else {
            None
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
    /// Number of the newest packet that was received.
    newest: u64,
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
        let ChannelParameters { delay_s, jitter_s, loss, reordering, seed, hold_after_s } = parameters;
        let is_duration = |s: f64| s.is_finite() && s >= 0.0;
        if !is_duration(delay_s)
            || !is_duration(jitter_s)
            || !hold_after_s.is_none_or(is_duration)
            || !(0.0..=1.0).contains(&loss)
        {
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
            newest: 0,
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
        let slot = match self.packets.iter().position(|packet| packet.arrives.is_none()) {
            Some(free) => Some(free),
            None => self.oldest_arrived(tick),
        };
        let Some(packet) = slot.filter(|_| !lost).map(|slot| &mut self.packets[slot]) else { return };
        let arrives = tick + self.delay + late;
        let arrives = if self.reordering { arrives } else { arrives.max(self.last_arrival) };
        self.last_arrival = arrives;
        packet.arrives = Some(arrives);
        packet.number = self.sent;
        packet.values.copy_from_slice(values);
    }

    /// Slot of the oldest packet that arrived by `tick`. A receiver that is slower than the sender, or whose bus loses
    /// cycles, lets packets lie; only the newest one counts.
    fn oldest_arrived(&self, tick: u64) -> Option<usize> {
        let arrived = self.packets.iter().enumerate().filter(|(_, p)| p.arrives.is_some_and(|at| at <= tick));
        arrived.min_by_key(|(_, packet)| packet.number).map(|(slot, _)| slot)
    }

    /// Returns the newest packet that arrived by `tick`, unless a newer one was received before.
    fn receive_newest(&mut self, tick: u64) -> Option<&[f64]> {
        let mut found = false;
        for packet in self.packets.iter_mut().filter(|p| p.arrives.is_some_and(|at| at <= tick)) {
            packet.arrives = None;
            if packet.number > self.newest {
                (self.newest, found) = (packet.number, true);
                self.out.copy_from_slice(&packet.values);
            }
        }
        found.then_some(&self.out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use opspace_backend::Signal;

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
            if let Some(values) = channel.receive_newest(tick) {
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

    /// Compared: the order of the packets that are received, and that of sending; the delays of packets, and the stated ones.
    /// Packets that a later one overtakes, or that arrive together with it, are not received.
    #[test]
    fn packets_that_are_overtaken_are_not_received() {
        for reordering in [false, true] {
            let parameters =
                ChannelParameters { delay_s: 0.005, jitter_s: 0.01, reordering, ..Default::default() };
            let arrived = arrivals(channel(parameters));
            assert!(arrived.windows(2).all(|pair| pair[0].1 < pair[1].1));
            let late = |&(at, sent): &(u64, f64)| at as f64 - sent;
            assert!(arrived.iter().map(late).all(|late| (5.0..=15.0).contains(&late)));
            assert!(arrived.iter().map(late).any(|late| late > 10.0));
            // A packet is received at some 100 of 1000 ticks at least: after 10 ms, all are newer.
            assert!((100..1000).contains(&arrived.len()), "{}", arrived.len());
        }
    }

    /// Compared: what a receiver that looks at every tenth tick gets, and the newest packet that has arrived by then.
    #[test]
    fn slow_receiver_gets_the_newest_packet() {
        for delay_s in [0.0, 0.003, 0.02] {
            let mut channel = channel(ChannelParameters { delay_s, ..Default::default() });
            let delay = (delay_s * 1e3) as u64;
            for tick in 0..1000 {
                channel.send(tick, &[tick as f64]);
                if tick % 10 == 9 && tick >= delay {
                    let newest = channel.receive_newest(tick).map(|values| values[0]);
                    assert_eq!(newest, Some((tick - delay) as f64), "after {delay_s} s");
                }
            }
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

    /// Compared: what a link reports about a sender that is held for each cause, and the causes that a receiver may answer
    /// with a hold of its own; the tick from which a sender is silent.
    #[test]
    fn holds_are_not_sent_back() {
        let timeline = Timeline::new(&[1000]).expect("a good clock");
        let layout = Layout {
            channel: "tick".to_owned(),
            signals: vec![Signal::scalar(PHASE, "1"), Signal::scalar(TARGET_HOLD, "1")],
        };
        let parameters = ChannelParameters { hold_after_s: Some(0.01), ..Default::default() };
        let mut targets = Targets::none();
        let (held, none) = (Phase::Held.code(), f64::NAN);
        let because = Some(HoldCause::RobotHeld(4));
        for (phase, hold, expected) in [
            (Phase::Control.code(), none, None),
            (held, none, because),
            (held, HoldCause::Requested.code(), because),
            (held, HoldCause::RobotHeld(1).code(), None),
            (held, HoldCause::RobotSilent(1).code(), None),
            (Phase::Stopped.code(), HoldCause::RobotHeld(1).code(), because),
        ] {
            let mut link = Link::status(&timeline, (4, &layout), 1, parameters).expect("a phase");
            link.send(3, &[phase, hold]);
            assert_eq!(link.deliver(3, 0.003, &mut targets), expected, "{phase} {hold}");
        }
        // The cause has ended, the sender does not stand still yet; then it resumes, and is held again by itself.
        let mut link = Link::status(&timeline, (4, &layout), 1, parameters).expect("a phase");
        let phases = [held, held, Phase::Resuming.code(), held];
        let holds = [HoldCause::RobotHeld(1).code(), none, none, none];
        let sent = (0..).zip(phases.into_iter().zip(holds)).map(|(tick, (phase, hold))| {
            link.send(tick, &[phase, hold]);
            link.deliver(tick, 0.0, &mut targets)
        });
        assert_eq!(sent.collect::<Vec<_>>(), [None, None, None, because]);
        let mut link = Link::status(&timeline, (4, &layout), 1, parameters).expect("a phase");
        link.send(0, &[Phase::Control.code(), none]);
        let silent = (0..20).find(|&tick| link.deliver(tick, 0.0, &mut targets).is_some());
        assert_eq!(silent, Some(11), "10 ms after the packet of tick 0");
    }
}

//! A log as a robot: it gives the measurements that were logged, and what comes out is compared with what
//! came out then.

use crate::error::LogError;
use crate::recording::{ChannelData, Column, Recording};
use opspace_backend::Layout;
use opspace_backend::{Sample, Sink, TICK};
use opspace_loop::{Facts, Fault, Phase, PositionRobot, Robot, TorqueRobot};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// The signal that is never the same twice: how long a tick took.
const WALL_CLOCK: &str = "tick_time";

/// Gives the logged measurements, tick by tick, and takes any command.
#[derive(Debug)]
pub struct ReplayRobot {
    facts: Facts,
    ticks: Vec<Tick>,
    next: usize,
    interrupt: Arc<AtomicBool>,
}

#[derive(Debug)]
struct Tick {
    time_s: f64,
    q: Vec<f64>,
    motor_torque: Option<Vec<f64>>,
    wrenches: Vec<[f64; 6]>,
    /// A fault that the robot itself had here.
    fault: Option<Fault>,
    /// The run was asked to stop after this tick.
    interrupted: bool,
}

impl ReplayRobot {
    /// For a log of a robot of `n` joints that declared `facts`. `interrupt` is set where the logged run was
    /// interrupted.
    ///
    /// # Errors
    /// A log without one of the measurements that the robot declares.
    pub fn new(
        recording: &Recording,
        n: usize,
        facts: Facts,
        interrupt: Arc<AtomicBool>,
    ) -> Result<Self, LogError> {
        let tick = tick_channel(recording)?;
        let signal = |name: &str, length: usize| {
            let found = tick.signal(name).filter(|column| column.elements().len() == length);
            found.ok_or_else(|| LogError::NoSignal { name: name.to_owned() })
        };
        let q = signal("q", n)?;
        let (phase, fault) = (signal("phase", 1)?, signal("fault", 1)?);
        let motor_torque = if facts.motor_torque { Some(signal("motor_torque", n)?) } else { None };
        let mut sensors = Vec::new();
        for sensor in &facts.sensors {
            sensors.push(signal(&format!("{}.raw", sensor.name), 6)?);
        }
        let stopped = Phase::Stopped.code();
        let ticks = (0..tick.len())
            .map(|k| {
                let stops_next =
                    k + 1 < tick.len() && phase.row(k)[0] != stopped && phase.row(k + 1)[0] == stopped;
                let faulted = fault.row(k)[0] != 0.0;
                let first = k == 0 || fault.row(k - 1)[0] == 0.0;
                Tick {
                    time_s: tick.time_s[k],
                    q: q.row(k).to_vec(),
                    motor_torque: motor_torque.map(|torque| torque.row(k).to_vec()),
                    wrenches: sensors.iter().map(|sensor| wrench(sensor, k)).collect(),
                    fault: (faulted && first).then(|| Fault::of_robot(fault.row(k)[0])).flatten(),
                    interrupted: stops_next && !faulted,
                }
            })
            .collect();
        Ok(Self { facts, ticks, next: 0, interrupt })
    }
}

fn wrench(column: &Column<'_>, k: usize) -> [f64; 6] {
    std::array::from_fn(|i| column.row(k)[i])
}

fn tick_channel(recording: &Recording) -> Result<&ChannelData, LogError> {
    recording.channel("tick").ok_or_else(|| LogError::NoSignal { name: "tick".to_owned() })
}

impl Robot for ReplayRobot {
    fn facts(&self) -> &Facts {
        &self.facts
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), Fault> {
        let tick = self.ticks.get(self.next).ok_or(Fault::EndOfLog)?;
        self.next += 1;
        if let Some(fault) = tick.fault {
            return Err(fault);
        }
        sample.time_s = tick.time_s;
        sample.q.copy_from_slice(&tick.q);
        if let (Some(to), Some(from)) = (&mut sample.motor_torque, &tick.motor_torque) {
            to.copy_from_slice(from);
        }
        sample.wrenches.copy_from_slice(&tick.wrenches);
        if tick.interrupted {
            self.interrupt.store(true, Ordering::Relaxed);
        }
        Ok(())
    }
}

impl PositionRobot for ReplayRobot {
    fn set_positions(&mut self, _q_desired: &[f64]) -> Result<(), Fault> {
        Ok(())
    }
}

impl TorqueRobot for ReplayRobot {
    fn set_torques(&mut self, _tau: &[f64]) -> Result<(), Fault> {
        Ok(())
    }

    fn brake(&mut self) {}
}

/// Where a replay first came to another number than the log.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// Which tick, from 0.
    pub tick: usize,
    /// Its time on the robot's clock, s.
    pub time_s: f64,
    /// Which signal.
    pub signal: String,
    /// Which element of it: a joint, an axis.
    pub element: String,
    /// What the log says.
    pub logged: f64,
    /// What came out now.
    pub recomputed: f64,
}

/// Compares the ticks of a replay with those of the log, bit for bit, signal by signal of the same name.
#[derive(Debug)]
pub struct Comparer<'a> {
    logged: &'a ChannelData,
    /// Where the elements that are compared stand: in the log's rows and in the replay's.
    slots: Vec<(usize, usize)>,
    /// Sums of squared differences, one a slot.
    squares: Vec<f64>,
    unmatched: Vec<String>,
    next: usize,
    differing: u64,
    first: Option<(usize, usize, f64)>,
}

impl<'a> Comparer<'a> {
    /// For the ticks of a log, and a replay with rows of that layout.
    ///
    /// # Errors
    /// A log without ticks.
    pub fn new(recording: &'a Recording, replay: &Layout) -> Result<Self, LogError> {
        let logged = tick_channel(recording)?;
        let mut slots = Vec::new();
        for (name, from, length) in offsets(&logged.layout) {
            let there =
                offsets(replay).find(|(other, _, other_length)| *other == name && *other_length == length);
            if let Some((_, to, _)) = there
                && name != WALL_CLOCK
            {
                slots.extend((0..length).map(|i| (from + i, to + i)));
            }
        }
        let squares = vec![0.0; slots.len()];
        let names = |layout| offsets(layout).map(|(name, _, length)| (name.to_owned(), length));
        let (then, now): (BTreeSet<_>, BTreeSet<_>) =
            (names(&logged.layout).collect(), names(replay).collect());
        let unmatched = then.symmetric_difference(&now).map(|(name, _)| name.clone()).collect();
        Ok(Self { logged, slots, squares, unmatched, next: 0, differing: 0, first: None })
    }

    /// How many ticks were compared.
    #[must_use]
    pub fn compared(&self) -> usize {
        self.next.min(self.logged.len())
    }

    /// Signals that only the log or only the replay has, or that differ in length.
    #[must_use]
    pub fn unmatched(&self) -> &[String] {
        &self.unmatched
    }

    /// How many ticks the log has.
    #[must_use]
    pub fn logged(&self) -> usize {
        self.logged.len()
    }

    /// How many ticks differ.
    #[must_use]
    pub fn differing(&self) -> u64 {
        self.differing
    }

    /// The first number that differs.
    #[must_use]
    pub fn first_difference(&self) -> Option<Difference> {
        let (tick, slot, recomputed) = self.first?;
        let (at, _) = self.slots[slot];
        let (signal, element) = name_of(&self.logged.layout, at);
        Some(Difference {
            tick,
            time_s: self.logged.time_s[tick],
            signal,
            element,
            logged: self.logged.row(tick)[at],
            recomputed,
        })
    }

    /// Root mean square of the difference of each element of a signal, with its name.
    #[must_use]
    pub fn rms_difference(&self, signal: &str) -> Vec<(String, f64)> {
        let count = self.compared().max(1) as f64;
        (self.slots.iter().zip(&self.squares))
            .filter_map(|(&(at, _), square)| {
                let (name, element) = name_of(&self.logged.layout, at);
                (name == signal).then(|| (element, (square / count).sqrt()))
            })
            .collect()
    }
}

impl Sink for Comparer<'_> {
    fn row(&mut self, channel: usize, _time_s: f64, row: &[f64]) {
        if channel != TICK || self.next >= self.logged.len() {
            return;
        }
        let logged = self.logged.row(self.next);
        let mut differs = false;
        for (slot, (&(from, to), square)) in self.slots.iter().zip(&mut self.squares).enumerate() {
            let (was, is) = (logged[from], row[to]);
            if was.to_bits() == is.to_bits() {
                continue;
            }
            differs = true;
            if self.first.is_none() {
                self.first = Some((self.next, slot, is));
            }
            let difference = is - was;
            if difference.is_finite() {
                *square += difference * difference;
            }
        }
        self.differing += u64::from(differs);
        self.next += 1;
    }
}

/// Name, offset and length of each signal of a row.
fn offsets(layout: &Layout) -> impl Iterator<Item = (&str, usize, usize)> {
    layout.signals.iter().scan(0, |at, signal| {
        let offset = *at;
        *at += signal.len();
        Some((signal.name.as_str(), offset, signal.len()))
    })
}

/// Signal and element of a number of a row.
fn name_of(layout: &Layout, at: usize) -> (String, String) {
    let mut found = (String::new(), String::new());
    for ((name, offset, length), signal) in offsets(layout).zip(&layout.signals) {
        if (offset..offset + length).contains(&at) {
            found = (name.to_owned(), signal.elements[at - offset].clone());
        }
    }
    found
}

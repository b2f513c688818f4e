//! Comparison of a replay's rows with those of a log.

use crate::error::LogError;
use crate::recording::{ChannelData, Recording};
use opspace_backend::{Layout, Sink, TICK, TICK_TIME};
use std::collections::BTreeSet;

/// First value of a replay that differs from the log.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Difference {
    /// Number of the control cycle, from 0.
    pub tick: usize,
    /// Time of the control cycle on the robot's clock, s.
    pub time_s: f64,
    /// Name of the signal.
    pub signal: String,
    /// Name of the signal's element: a joint or an axis.
    pub element: String,
    /// Value in the log.
    pub logged: f64,
    /// Value of the replay.
    pub recomputed: f64,
}

/// Comparison of the control cycles of a replay and of the log, bit for bit. Signals with the same name are compared.
#[derive(Debug)]
pub struct Comparer<'a> {
    logged: &'a ChannelData,
    /// Indices of the compared elements, in the log's rows and in the replay's rows.
    slots: Vec<(usize, usize)>,
    /// Sum of squared differences of each slot.
    squares: Vec<f64>,
    unmatched: Vec<String>,
    next: usize,
    differing: u64,
    first: Option<(usize, usize, f64)>,
}

impl<'a> Comparer<'a> {
    /// Returns the comparison of a log's control cycles with a replay whose rows have the layout `replay`.
    ///
    /// # Errors
    /// If the log has no control cycles.
    pub fn new(recording: &'a Recording, replay: &Layout) -> Result<Self, LogError> {
        let logged = recording.tick()?;
        let mut slots = Vec::new();
        for (name, from, length) in offsets(&logged.layout) {
            let there =
                offsets(replay).find(|(other, _, other_length)| *other == name && *other_length == length);
            if let Some((_, to, _)) = there
                && name != TICK_TIME
            {
                slots.extend((0..length).map(|i| (from + i, to + i)));
            }
        }
        let squares = vec![0.0; slots.len()];
        // Logs written before the channel `timing` have the signal among the others.
        let names = |layout| {
            offsets(layout)
                .filter(|(name, ..)| *name != TICK_TIME)
                .map(|(name, _, length)| (name.to_owned(), length))
        };
        let (then, now): (BTreeSet<_>, BTreeSet<_>) =
            (names(&logged.layout).collect(), names(replay).collect());
        let unmatched = then.symmetric_difference(&now).map(|(name, _)| name.clone()).collect();
        Ok(Self { logged, slots, squares, unmatched, next: 0, differing: 0, first: None })
    }

    /// Number of control cycles compared.
    #[must_use]
    pub fn compared(&self) -> usize {
        self.next.min(self.logged.len())
    }

    /// Signals that only the log or only the replay has, or that differ in length.
    #[must_use]
    pub fn unmatched(&self) -> &[String] {
        &self.unmatched
    }

    /// Number of control cycles in the log.
    #[must_use]
    pub fn logged(&self) -> usize {
        self.logged.len()
    }

    /// Number of control cycles that differ.
    #[must_use]
    pub fn differing(&self) -> u64 {
        self.differing
    }

    /// First value that differs.
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

    /// Rms difference of each element of a signal, with the element's name.
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

/// Names of the signal and of the element at an index of a row.
fn name_of(layout: &Layout, at: usize) -> (String, String) {
    let mut found = (String::new(), String::new());
    for ((name, offset, length), signal) in offsets(layout).zip(&layout.signals) {
        if (offset..offset + length).contains(&at) {
            found = (name.to_owned(), signal.elements[at - offset].clone());
        }
    }
    found
}

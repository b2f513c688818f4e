//! Comparison of a replay's rows with those of a log.

use opspace_backend::{Layout, Sink, TICK, TICK_TIME};
use std::collections::{BTreeSet, VecDeque};

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
///
/// Rows of both arrive in any order, the log's by [`logged_row`](Self::logged_row) and the replay's as those of a [`Sink`].
/// A row waits in memory for its counterpart only.
#[derive(Debug)]
pub struct Comparer {
    layout: Layout,
    /// Indices of the compared elements, in the log's rows and in the replay's rows.
    slots: Vec<(usize, usize)>,
    /// Sum of squared differences of each slot.
    squares: Vec<f64>,
    unmatched: Vec<String>,
    /// Rows that wait for their counterpart; one of the two is empty.
    waiting_logged: VecDeque<(f64, Vec<f64>)>,
    waiting_replayed: VecDeque<Vec<f64>>,
    logged: usize,
    compared: usize,
    differing: u64,
    first: Option<Difference>,
}

impl Comparer {
    /// Returns the comparison of a log, whose control cycles have the layout `logged`, with a replay whose rows have the
    /// layout `replay`.
    #[must_use]
    pub fn new(logged: &Layout, replay: &Layout) -> Self {
        let mut slots = Vec::new();
        for (name, from, length) in offsets(logged) {
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
        let (then, now): (BTreeSet<_>, BTreeSet<_>) = (names(logged).collect(), names(replay).collect());
        let unmatched = then.symmetric_difference(&now).map(|(name, _)| name.clone()).collect();
        Self {
            layout: logged.clone(),
            slots,
            squares,
            unmatched,
            waiting_logged: VecDeque::new(),
            waiting_replayed: VecDeque::new(),
            logged: 0,
            compared: 0,
            differing: 0,
            first: None,
        }
    }

    /// Takes the next control cycle of the log; `time_s` is that of the robot's clock.
    pub fn logged_row(&mut self, time_s: f64, row: &[f64]) {
        self.logged += 1;
        match self.waiting_replayed.pop_front() {
            Some(replayed) => self.compare(time_s, row, &replayed),
            None => self.waiting_logged.push_back((time_s, row.to_vec())),
        }
    }

    /// Counts control cycles of the log with which the replay has nothing to compare.
    pub fn logged_rows_without_replay(&mut self, count: usize) {
        self.logged += count;
    }

    /// Number of control cycles compared.
    #[must_use]
    pub fn compared(&self) -> usize {
        self.compared
    }

    /// Signals that only the log or only the replay has, or that differ in length.
    #[must_use]
    pub fn unmatched(&self) -> &[String] {
        &self.unmatched
    }

    /// Number of control cycles in the log.
    #[must_use]
    pub fn logged(&self) -> usize {
        self.logged
    }

    /// Number of control cycles that differ.
    #[must_use]
    pub fn differing(&self) -> u64 {
        self.differing
    }

    /// First value that differs.
    #[must_use]
    pub fn first_difference(&self) -> Option<Difference> {
        self.first.clone()
    }

    /// Rms difference of each element of a signal, with the element's name.
    #[must_use]
    pub fn rms_difference(&self, signal: &str) -> Vec<(String, f64)> {
        let count = self.compared.max(1) as f64;
        (self.slots.iter().zip(&self.squares))
            .filter_map(|(&(at, _), square)| {
                let (name, element) = name_of(&self.layout, at);
                (name == signal).then(|| (element, (square / count).sqrt()))
            })
            .collect()
    }

    fn compare(&mut self, time_s: f64, logged: &[f64], replayed: &[f64]) {
        let mut differs = false;
        for (&(from, to), square) in self.slots.iter().zip(&mut self.squares) {
            let (was, is) = (logged[from], replayed[to]);
            if was.to_bits() == is.to_bits() {
                continue;
            }
            differs = true;
            let (layout, tick) = (&self.layout, self.compared);
            self.first.get_or_insert_with(|| {
                let (signal, element) = name_of(layout, from);
                Difference { tick, time_s, signal, element, logged: was, recomputed: is }
            });
            let difference = is - was;
            if difference.is_finite() {
                *square += difference * difference;
            }
        }
        self.differing += u64::from(differs);
        self.compared += 1;
    }
}

impl Sink for Comparer {
    fn row(&mut self, channel: usize, _time_s: f64, row: &[f64]) {
        if channel != TICK {
            return;
        }
        match self.waiting_logged.pop_front() {
            Some((time_s, logged)) => self.compare(time_s, &logged, row),
            None => self.waiting_replayed.push_back(row.to_vec()),
        }
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

//! Signals: the named quantities of a run, sampled every cycle into one row of numbers.
//!
//! The layout of a row is fixed before the run, so that sampling only copies numbers.

use std::borrow::Cow;
use std::ops::Range;

/// One named quantity of a row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Signal {
    /// Name, with the quantity's owner before a dot where it has one: `q`, `hand.position`.
    pub name: String,
    /// SI unit (`rad`, `m`, `Nm`, `N`, `s`, `1`), mixed ones separated by a comma.
    pub unit: Cow<'static, str>,
    /// Labels of the elements: joint names or axes; one label per element.
    pub elements: Vec<String>,
}

impl Signal {
    /// A signal with one element per label.
    #[must_use]
    pub fn new<S: AsRef<str>>(
        name: impl Into<String>,
        unit: impl Into<Cow<'static, str>>,
        elements: &[S],
    ) -> Self {
        let elements = elements.iter().map(|e| e.as_ref().to_owned()).collect();
        Self { name: name.into(), unit: unit.into(), elements }
    }

    /// A single number.
    #[must_use]
    pub fn scalar(name: impl Into<String>, unit: impl Into<Cow<'static, str>>) -> Self {
        Self::new(name, unit, &["value"])
    }

    /// Number of elements.
    #[must_use]
    pub fn len(&self) -> usize {
        self.elements.len()
    }

    /// Returns true if it has no elements (a robot without joints).
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.elements.is_empty()
    }
}

/// Layout of the rows of one channel: its signals, in their order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Layout {
    /// The channel's name.
    pub channel: String,
    /// Signals, in the order of the row.
    pub signals: Vec<Signal>,
}

impl Layout {
    /// Number of values in a row.
    #[must_use]
    pub fn width(&self) -> usize {
        self.signals.iter().map(Signal::len).sum()
    }

    /// Columns of a signal in a row; `None` if there is no signal of that name.
    #[must_use]
    pub fn columns(&self, signal: &str) -> Option<Range<usize>> {
        let place = self.signals.iter().position(|known| known.name == signal)?;
        let start = self.signals[..place].iter().map(Signal::len).sum();
        Some(start..start + self.signals[place].len())
    }
}

/// A row being filled: values are put in the order of the signals.
#[derive(Debug)]
pub struct Row<'a> {
    free: &'a mut [f64],
}

impl<'a> Row<'a> {
    /// An empty row on top of `slots`.
    #[must_use]
    pub fn new(slots: &'a mut [f64]) -> Self {
        Self { free: slots }
    }

    /// Puts the next values.
    ///
    /// # Panics
    /// If the row is full: the values put don't match the signals described.
    pub fn put(&mut self, values: &[f64]) {
        let (now, later) = std::mem::take(&mut self.free).split_at_mut(values.len());
        now.copy_from_slice(values);
        self.free = later;
    }

    /// Puts one value.
    ///
    /// # Panics
    /// As [`put`](Self::put).
    pub fn put_one(&mut self, value: f64) {
        self.put(&[value]);
    }

    /// Puts NaN in place of `count` values that are left out.
    ///
    /// # Panics
    /// As [`put`](Self::put).
    pub fn skip(&mut self, count: usize) {
        for _ in 0..count {
            self.put_one(f64::NAN);
        }
    }

    /// Number of values still to be put.
    #[must_use]
    pub fn remaining(&self) -> usize {
        self.free.len()
    }
}

/// A part whose signals can be recorded.
pub trait Observable {
    /// Signals whose values [`sample`](Self::sample) puts, in its order. Called once, before the run.
    fn signals(&self) -> Vec<Signal>;

    /// Puts the values of this cycle. Allocates nothing.
    fn sample(&self, row: &mut Row<'_>);
}

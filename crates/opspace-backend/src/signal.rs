//! What can be seen of a run: named signals, sampled every tick into one row of numbers.
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
    /// What each element is: joint names, axes; one label an element.
    pub elements: Vec<String>,
}

impl Signal {
    /// A signal with one element a label.
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

    /// How many numbers it is.
    #[must_use]
    pub fn len(&self) -> usize {
        self.elements.len()
    }

    /// Whether it has no elements (a robot without joints).
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.elements.is_empty()
    }
}

/// The rows of one channel: which signals stand in them, in which order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Layout {
    /// The channel's name.
    pub channel: String,
    /// In the order of the row.
    pub signals: Vec<Signal>,
}

impl Layout {
    /// How many numbers a row holds.
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

    /// Leaves out values: they are not a number.
    ///
    /// # Panics
    /// As [`put`](Self::put).
    pub fn skip(&mut self, count: usize) {
        for _ in 0..count {
            self.put_one(f64::NAN);
        }
    }

    /// How many values are still to come.
    #[must_use]
    pub fn remaining(&self) -> usize {
        self.free.len()
    }
}

/// Something whose inside can be recorded.
pub trait Observable {
    /// What [`sample`](Self::sample) will put, in its order. Called once, before the run.
    fn signals(&self) -> Vec<Signal>;

    /// Puts this tick's values: allocates nothing.
    fn sample(&self, row: &mut Row<'_>);
}

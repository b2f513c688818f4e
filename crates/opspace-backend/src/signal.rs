//! Signals: the named quantities of a run, sampled every cycle into one row of numbers.
//!
//! A component declares each of its signals once: name, units, elements and values. The same declaration describes the
//! row before the run and fills it in each cycle, so that description and values cannot disagree:
//!
//! ```
//! use opspace_backend::{Observable, Signal, SignalRecorder};
//!
//! struct Gripper {
//!     name: String,
//!     position_m: [f64; 2],
//! }
//!
//! impl Observable for Gripper {
//!     fn record(&self, out: &mut SignalRecorder<'_>) {
//!         out.signal((&self.name, "position"), "m", &["left", "right"], &self.position_m);
//!         out.scalar((&self.name, "closed"), "1", f64::from(u8::from(self.position_m == [0.0; 2])));
//!     }
//! }
//!
//! let gripper = Gripper { name: "gripper".to_owned(), position_m: [0.01, 0.02] };
//! assert_eq!(gripper.signals()[0], Signal::new("gripper.position", "m", &["left", "right"]));
//! let mut row = [0.0; 3];
//! gripper.sample(&mut row);
//! assert_eq!(row, [0.01, 0.02, 0.0]);
//! ```

use std::fmt;
use std::ops::Range;

/// One named quantity of a row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Signal {
    /// Name, preceded by its owner and a dot if it has one: `q`, `hand.position`.
    pub name: String,
    /// SI unit of each element (`rad`, `m`, `Nm`, `N`, `s`, `1`).
    pub units: Vec<String>,
    /// Labels of the elements, one per element: joint names or axes.
    pub elements: Vec<String>,
}

impl Signal {
    /// Returns a signal with one element per label.
    ///
    /// # Panics
    /// If `unit` is a list with a length other than the number of elements.
    #[must_use]
    pub fn new<S: AsRef<str>>(name: impl Into<String>, unit: &(impl Units + ?Sized), elements: &[S]) -> Self {
        let (name, units) = (name.into(), unit.of_elements(elements.len()));
        assert_eq!(units.len(), elements.len(), "signal {name}: one unit per element");
        Self { name, units, elements: elements.iter().map(|e| e.as_ref().to_owned()).collect() }
    }

    /// Returns a signal with a single element.
    #[must_use]
    pub fn scalar(name: impl Into<String>, unit: &str) -> Self {
        Self::new(name, unit, &SCALAR)
    }

    /// Number of elements.
    #[must_use]
    pub fn len(&self) -> usize {
        self.elements.len()
    }

    /// Returns true if the signal has no elements (a robot without joints).
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.elements.is_empty()
    }

    /// Returns the units as a text, separated by commas: one unit if all elements have the same; one unit per block of
    /// elements if [`Units`] reads that text as the same units again; otherwise one unit per element.
    #[must_use]
    pub fn unit(&self) -> String {
        let mut blocks = self.units.clone();
        blocks.dedup();
        let short = blocks.join(",");
        if short.of_elements(self.len()) == self.units { short } else { self.units.join(",") }
    }
}

/// Label of the element of a scalar signal.
const SCALAR: [&str; 1] = ["value"];

/// SI units of the elements of a signal: a list with one unit per element, or a text.
///
/// The text is one unit for all elements, or several units separated by commas. Each of several units applies to one
/// block of elements; the blocks have equal lengths, and the last unit also applies to the remaining elements. Example:
/// `N,Nm` for six elements means N for the first three and Nm for the last three.
pub trait Units {
    /// Returns the units of `count` elements.
    fn of_elements(&self, count: usize) -> Vec<String>;
}

impl Units for str {
    fn of_elements(&self, count: usize) -> Vec<String> {
        let units: Vec<&str> = self.split(',').map(str::trim).collect();
        let (last, block) = (units.len() - 1, (count / units.len()).max(1));
        (0..count).map(|element| units[(element / block).min(last)].to_owned()).collect()
    }
}

impl<S: AsRef<str>> Units for [S] {
    fn of_elements(&self, _count: usize) -> Vec<String> {
        self.iter().map(|unit| unit.as_ref().to_owned()).collect()
    }
}

impl<S: AsRef<str>, const N: usize> Units for [S; N] {
    fn of_elements(&self, count: usize) -> Vec<String> {
        self.as_slice().of_elements(count)
    }
}

impl<S: AsRef<str>> Units for Vec<S> {
    fn of_elements(&self, count: usize) -> Vec<String> {
        self.as_slice().of_elements(count)
    }
}

impl Units for String {
    fn of_elements(&self, count: usize) -> Vec<String> {
        self.as_str().of_elements(count)
    }
}

/// Name of a signal: a quantity (`q`) or the quantity of an owner (`hand.position`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SignalName<'a> {
    /// Name of the task, force sensor or contact.
    pub owner: Option<&'a str>,
    /// Name of the quantity.
    pub quantity: &'a str,
}

impl<'a> From<&'a str> for SignalName<'a> {
    fn from(quantity: &'a str) -> Self {
        Self { owner: None, quantity }
    }
}

impl<'a, S: AsRef<str> + ?Sized> From<(&'a S, &'a str)> for SignalName<'a> {
    fn from((owner, quantity): (&'a S, &'a str)) -> Self {
        Self { owner: Some(owner.as_ref()), quantity }
    }
}

impl fmt::Display for SignalName<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.owner {
            Some(owner) => write!(f, "{owner}.{}", self.quantity),
            None => f.write_str(self.quantity),
        }
    }
}

/// Layout of the rows of one channel: the sequence of its signals.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Name of the channel.
    pub channel: String,
    /// Signals, in the order of the row.
    pub signals: Vec<Signal>,
}

impl Layout {
    /// Returns the number of values in a row.
    #[must_use]
    pub fn width(&self) -> usize {
        width(&self.signals)
    }

    /// Returns the columns of a signal in a row; `None` if there is no signal of that name.
    #[must_use]
    pub fn columns(&self, signal: &str) -> Option<Range<usize>> {
        let place = self.signals.iter().position(|known| known.name == signal)?;
        let start = width(&self.signals[..place]);
        Some(start..start + self.signals[place].len())
    }
}

fn width(signals: &[Signal]) -> usize {
    signals.iter().map(Signal::len).sum()
}

/// A pass over all signals. Before the run it describes the signals; in each cycle it writes their values into a row,
/// without allocation or formatting.
#[derive(Debug)]
pub struct SignalRecorder<'a> {
    pass: Pass<'a>,
    recorded: usize,
}

#[derive(Debug)]
enum Pass<'a> {
    Describe(Vec<Signal>),
    /// Part of the row that is not yet filled.
    Sample(&'a mut [f64]),
}

impl<'a> SignalRecorder<'a> {
    /// Returns the descriptions of all signals that `record` records.
    #[must_use]
    pub fn describe(record: impl FnOnce(&mut SignalRecorder<'_>)) -> Vec<Signal> {
        let mut recorder = SignalRecorder { pass: Pass::Describe(Vec::new()), recorded: 0 };
        record(&mut recorder);
        match recorder.pass {
            Pass::Describe(signals) => signals,
            Pass::Sample(_) => Vec::new(),
        }
    }

    /// Returns a recorder that fills a row, starting at its first value.
    #[must_use]
    pub fn sampling(row: &'a mut [f64]) -> Self {
        Self { pass: Pass::Sample(row), recorded: 0 }
    }

    /// Records a signal with one value per element. An empty `values` records NaN for all elements.
    ///
    /// # Panics
    /// If `values` is neither empty nor has one value per element, or if the row is full.
    #[inline]
    pub fn signal<'n, S: AsRef<str>>(
        &mut self,
        name: impl Into<SignalName<'n>>,
        unit: &(impl Units + ?Sized),
        elements: &[S],
        values: &[f64],
    ) {
        self.recorded += elements.len();
        match &mut self.pass {
            Pass::Describe(signals) => {
                let signal = Signal::new(name.into().to_string(), unit, elements);
                describe(signals, signal, values);
            }
            Pass::Sample(free) => fill(free, elements.len(), values),
        }
    }

    /// Records a scalar signal.
    ///
    /// # Panics
    /// If the row is full.
    #[inline]
    pub fn scalar<'n>(&mut self, name: impl Into<SignalName<'n>>, unit: &str, value: f64) {
        self.signal(name, unit, &SCALAR, &[value]);
    }

    /// Records a signal whose description needs an allocation: `signal` is called only before the run.
    ///
    /// # Panics
    /// If the number of values differs from the number of elements, or if the row is full.
    #[inline]
    pub fn signal_with(&mut self, signal: impl FnOnce() -> Signal, values: &[f64]) {
        self.recorded += values.len();
        match &mut self.pass {
            Pass::Describe(signals) => describe(signals, signal(), values),
            Pass::Sample(free) => fill(free, values.len(), values),
        }
    }

    /// Records already described signals, with all their values in one slice. An empty `values` records NaN for all
    /// elements.
    ///
    /// # Panics
    /// If `values` is neither empty nor has one value per element, or if the row is full.
    pub fn block(&mut self, known: &[Signal], values: &[f64]) {
        self.recorded += width(known);
        match &mut self.pass {
            Pass::Describe(signals) => signals.extend_from_slice(known),
            Pass::Sample(free) => fill(free, width(known), values),
        }
    }

    /// Returns the number of elements recorded so far.
    #[must_use]
    pub fn recorded(&self) -> usize {
        self.recorded
    }
}

fn describe(signals: &mut Vec<Signal>, signal: Signal, values: &[f64]) {
    let matches = values.is_empty() || values.len() == signal.len();
    assert!(matches, "signal {}: {} values for {} elements", signal.name, values.len(), signal.len());
    signals.push(signal);
}

/// Fills the next `count` values of the row, with NaN if `values` is empty.
#[inline]
fn fill(free: &mut &mut [f64], count: usize, values: &[f64]) {
    let (now, later) = std::mem::take(free).split_at_mut(count);
    if values.is_empty() {
        now.fill(f64::NAN);
    } else {
        now.copy_from_slice(values);
    }
    *free = later;
}

/// A component whose signals can be recorded.
pub trait Observable {
    /// Records the signals, in every call the same signals in the same order. Must not allocate while values are
    /// sampled.
    fn record(&self, out: &mut SignalRecorder<'_>);

    /// Returns the descriptions of the signals. Called before the run.
    fn signals(&self) -> Vec<Signal> {
        SignalRecorder::describe(|out| self.record(out))
    }

    /// Writes the values of this cycle into a row. Does not allocate.
    ///
    /// # Panics
    /// If the row has fewer values than the signals; in debug builds also if it has more.
    fn sample(&self, row: &mut [f64]) {
        let width = row.len();
        let mut out = SignalRecorder::sampling(row);
        self.record(&mut out);
        debug_assert_eq!(out.recorded(), width, "every value of the row is recorded");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AXES: [&str; 6] = ["x", "y", "z", "rx", "ry", "rz"];

    /// Compared: units read from a text, and the expected units of each element.
    #[test]
    fn units_of_a_text_belong_to_blocks_of_elements() {
        let units = |text: &str, count| text.of_elements(count).join(" ");
        assert_eq!(units("rad", 3), "rad rad rad");
        assert_eq!(units("N,Nm", 6), "N N N Nm Nm Nm");
        assert_eq!(units("m,1", 7), "m m m 1 1 1 1");
        assert_eq!(units("rad,m,rad", 3), "rad m rad");
        assert_eq!(units("N,Nm", 1), "N");
        assert_eq!(units("rad", 0), "");
    }

    /// Compared: a signal, and the signal built from its unit text.
    #[test]
    fn unit_text_keeps_the_unit_of_each_element() {
        let cases = [
            (vec!["rad"; 6], "rad"),
            (vec!["m", "m", "m", "rad", "rad", "rad"], "m,rad"),
            (vec!["rad", "m", "rad", "rad", "rad", "rad"], "rad,m,rad,rad,rad,rad"),
            (vec!["m", "rad", "rad", "rad", "rad", "rad"], "m,rad,rad,rad,rad,rad"),
        ];
        for (units, text) in cases {
            let signal = Signal::new("s", &units, &AXES);
            assert_eq!(signal.unit(), text);
            assert_eq!(Signal::new("s", text, &AXES), signal);
        }
    }

    struct Part;

    impl Observable for Part {
        fn record(&self, out: &mut SignalRecorder<'_>) {
            out.scalar("count", "1", 4.0);
            out.signal(("hand", "error"), "m,rad", &AXES, &[]);
            out.signal_with(|| Signal::new("late", "N", &["a", "b"]), &[1.0, 2.0]);
            out.block(&[Signal::scalar("known", "s")], &[3.0]);
        }
    }

    /// Compared: the row, and the expected values; the described width, and the number of recorded elements.
    #[test]
    fn row_has_the_values_in_the_order_of_the_signals() {
        let layout = Layout { channel: "c".to_owned(), signals: Part.signals() };
        let names: Vec<&str> = layout.signals.iter().map(|signal| signal.name.as_str()).collect();
        assert_eq!(names, ["count", "hand.error", "late", "known"]);
        let mut row = vec![0.0; layout.width()];
        let mut out = SignalRecorder::sampling(&mut row);
        Part.record(&mut out);
        assert_eq!(out.recorded(), layout.width());
        assert!(row[1..7].iter().all(|value| value.is_nan()), "{row:?}");
        assert_eq!((row[0], &row[7..]), (4.0, &[1.0, 2.0, 3.0][..]));
    }

    /// Compared: the numbers of values and elements, while signals are described.
    #[test]
    #[should_panic(expected = "signal q: 1 values for 2 elements")]
    fn description_refuses_a_wrong_number_of_values() {
        let _ = SignalRecorder::describe(|out| out.signal("q", "rad", &["a", "b"], &[1.0]));
    }
}

//! Table of results as data; the terminal and the report render it differently.

use crate::text::{NOISE, format_number};

/// Table: column heads and rows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Heads of the columns, left to right.
    pub columns: Vec<Column>,
    /// Rows, top to bottom; a row shorter than the head ends in empty cells.
    pub rows: Vec<Vec<Cell>>,
    /// Number of columns at the left that name a row, beside the first one.
    pub further_names: usize,
    /// True if the numbers of a row share their decimals, otherwise those of a column do.
    pub decimals_by_row: bool,
}

/// Head of a column.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Column {
    /// Quantity in the column.
    pub title: String,
    /// Unit of the quantity as printed (`N·m`); empty if it has none.
    pub unit: String,
}

/// Content of a table's cell.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// A name or a remark.
    Text(String),
    /// A measured or computed value.
    Number(f64),
    /// A median, and the ends of its interval: `5.61 ±0.43`. The distance is that of the farther end.
    Spread {
        /// Median.
        median: f64,
        /// Lower end of the interval.
        low: f64,
        /// Upper end of the interval.
        high: f64,
    },
    /// An integer, shown in full: a seed or a count.
    Count(u64),
    /// A criterion that is met, with a short text.
    Pass(String),
    /// A criterion that is not met or a fault, with a short text.
    Fail(String),
    /// A quantity that does not exist in this row.
    Empty,
}

impl Table {
    /// Creates a table without rows; `columns` contains (title, unit).
    #[must_use]
    pub fn new(columns: &[(&str, &str)]) -> Self {
        let column =
            |&(title, unit): &(&str, &str)| Column { title: title.to_owned(), unit: unit.to_owned() };
        Self { columns: columns.iter().map(column).collect(), ..Self::default() }
    }

    /// Texts of all cells; numbers below the noise of their unit are zero, and the numbers of a column, or of a row, have the same
    /// number of decimals. Numbers without an interval end in blanks where others of their column have one, so that all decimal
    /// points are below each other.
    #[must_use]
    pub fn texts(&self) -> Vec<Vec<String>> {
        let rows: Vec<Vec<Cell>> = self.rows.iter().map(|row| self.without_noise(row)).collect();
        let width = rows.iter().map(Vec::len).max().unwrap_or(0);
        let columns: Vec<Option<usize>> =
            (0..width).map(|place| decimals(rows.iter().filter_map(|row| row.get(place)))).collect();
        let decimals_of = |row: &Vec<Cell>, place: usize| match self.decimals_by_row {
            true => decimals(row.iter()),
            false => columns[place],
        };
        let ends = |place: usize| {
            let cells = rows.iter().filter_map(move |row| Some((row, row.get(place)?)));
            cells.map(move |(row, cell)| interval(cell, decimals_of(row, place)).chars().count())
        };
        let widest: Vec<usize> = (0..width).map(|place| ends(place).max().unwrap_or(0)).collect();
        let text = |(place, cell): (usize, &Cell), row: &Vec<Cell>| {
            let decimals = decimals_of(row, place);
            let number = match (cell, decimals) {
                (Cell::Number(number) | Cell::Spread { median: number, .. }, Some(decimals))
                    if number.is_finite() =>
                {
                    format!("{:.decimals$}", number + 0.0)
                }
                _ => cell.text(),
            };
            match cell {
                Cell::Number(_) | Cell::Spread { .. } | Cell::Empty => {
                    format!("{number}{:<1$}", interval(cell, decimals), widest[place])
                }
                _ => number,
            }
        };
        let texts = |row: &Vec<Cell>| row.iter().enumerate().map(|cell| text(cell, row)).collect();
        rows.iter().map(texts).collect()
    }

    /// Returns the cells of a row with zeros in place of noise.
    fn without_noise(&self, row: &[Cell]) -> Vec<Cell> {
        // A table of several quantities has their units in its last column.
        let of_row = match row.last() {
            Some(Cell::Text(unit)) if self.decimals_by_row => unit.as_str(),
            _ => "",
        };
        let unit = |place: usize| {
            let column = self.columns.get(place).map_or("", |column| column.unit.as_str());
            if column.is_empty() { of_row } else { column }
        };
        let cell = |(place, cell): (usize, &Cell)| match cell {
            Cell::Number(number) | Cell::Spread { median: number, .. }
                if number.abs() < noise(unit(place)) =>
            {
                Cell::Number(0.0)
            }
            other => other.clone(),
        };
        row.iter().enumerate().map(cell).collect()
    }

    /// Adds a row at the bottom.
    pub fn push(&mut self, row: Vec<Cell>) {
        self.rows.push(row);
    }
}

/// Interval of a spread as text, ` ±0.43`; empty if it is narrower than the last decimal.
fn interval(cell: &Cell, decimals: Option<usize>) -> String {
    let Cell::Spread { median, low, high } = cell else { return String::new() };
    let distance = (high - median).max(median - low);
    match decimals {
        Some(decimals) if distance.is_finite() => {
            let text = format!("{distance:.decimals$}");
            let is_zero = text.chars().all(|digit| matches!(digit, '0' | '.'));
            if is_zero { String::new() } else { format!(" ±{text}") }
        }
        _ if distance > 0.0 => format!(" ±{}", format_number(distance)),
        _ => String::new(),
    }
}

/// Number of decimals that shows four digits of the largest number, three beside intervals, and two of the smallest; `None` if
/// their ratio is too large for that.
fn decimals<'a>(cells: impl Iterator<Item = &'a Cell>) -> Option<usize> {
    let mut digits: f64 = 4.0;
    let numbers: Vec<f64> = cells
        .filter_map(|cell| match cell {
            Cell::Spread { median, .. } => {
                digits = 3.0;
                Some(median)
            }
            Cell::Number(number) => Some(number),
            _ => None,
        })
        .filter(|number| number.is_finite() && **number != 0.0)
        .map(|number| number.abs())
        .collect();
    let (smallest, largest) =
        numbers.iter().fold((f64::MAX, 0.0), |(low, high), n: &f64| (n.min(low), n.max(high)));
    if largest == 0.0 {
        return Some(0);
    }
    let decimals = (digits - 1.0 - largest.log10().floor()).max(1.0 - smallest.log10().floor()).max(0.0);
    (decimals <= 7.0 && largest < 1e6).then_some(decimals as usize)
}

impl Column {
    /// `title (unit)`.
    #[must_use]
    pub fn column_title(&self) -> String {
        if self.unit.is_empty() { self.title.clone() } else { format!("{} ({})", self.title, self.unit) }
    }
}

impl Cell {
    /// Text of the cell independent of its column; numbers have four significant digits.
    #[must_use]
    pub fn text(&self) -> String {
        match self {
            Self::Text(text) | Self::Pass(text) | Self::Fail(text) => text.clone(),
            Self::Number(number) | Self::Spread { median: number, .. } => format_number(*number),
            Self::Count(count) => count.to_string(),
            Self::Empty => "–".to_owned(),
        }
    }

    /// True if the cell is aligned as a number.
    #[must_use]
    pub fn is_numeric(&self) -> bool {
        match self {
            Self::Number(_) | Self::Spread { .. } | Self::Count(_) | Self::Empty => true,
            // The value of a setting is a number with decimals of its own.
            Self::Text(text) => {
                text.is_empty()
                    || text.starts_with(|c: char| c.is_ascii_digit()) && text.parse::<f64>().is_ok()
            }
            Self::Pass(_) | Self::Fail(_) => false,
        }
    }
}

impl From<f64> for Cell {
    fn from(number: f64) -> Self {
        Self::Number(number)
    }
}

impl From<u64> for Cell {
    fn from(count: u64) -> Self {
        Self::Count(count)
    }
}

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<String> for Cell {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl<T: Into<Cell>> From<Option<T>> for Cell {
    fn from(value: Option<T>) -> Self {
        value.map_or(Self::Empty, Into::into)
    }
}

/// Largest number that is only rounding, in a unit as printed.
fn noise(unit: &str) -> f64 {
    match unit {
        "mm" | "mrad" => 1e3 * NOISE,
        "%" => 1e2 * NOISE,
        "µs" => 1e6 * NOISE,
        // Links of a gram have such inertias.
        "kg·m²" | "kg m²" => 1e-3 * NOISE,
        _ => NOISE,
    }
}

/// Factor from a unit to the one that is shown in a report, and its name: millimetres and milliradians.
pub fn shown_unit(unit: &str) -> (f64, &str) {
    match unit {
        "m" => (1e3, "mm"),
        "rad" => (1e3, "mrad"),
        other => (1.0, other),
    }
}

#[cfg(test)]
mod tests {
    use super::{Cell, Table};

    /// Checks numbers below and above the noise, whose unit is in the head of the column or at the end of the row.
    #[test]
    fn noise_is_zero() {
        let mut table = Table::new(&[("joint", ""), ("torque", "N·m"), ("error", "mm")]);
        table.push(vec!["a".into(), 1.7e-12.into(), 3e-14.into()]);
        table.push(vec!["b".into(), 2.5.into(), 2e-6.into()]);
        assert_eq!(table.texts(), [["a", "0.000", "0"], ["b", "2.500", "2.000e-6"]]);
        let mut table = Table::new(&[("task", ""), ("rms", ""), ("unit", "")]);
        table.decimals_by_row = true;
        table.push(vec!["hand".into(), 5e-7.into(), "mm".into()]);
        table.push(vec!["hand".into(), Cell::Number(5e-7), "N".into()]);
        assert_eq!(table.texts(), [["hand", "0", "mm"], ["hand", "5.000e-7", "N"]]);
    }
}

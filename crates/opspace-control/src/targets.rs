//! Targets streamed to a controller, as one row of numbers.

use opspace_backend::Layout;

/// A row of streamed targets; its layout is fixed when the controller is built.
#[derive(Clone, Debug, PartialEq)]
pub struct Targets {
    layout: Layout,
    row: Vec<f64>,
}

impl Targets {
    /// No target: a row of width 0.
    #[must_use]
    pub fn none() -> Self {
        Self { layout: Layout { channel: "targets".to_owned(), signals: Vec::new() }, row: Vec::new() }
    }

    /// Signals of the row, in its order.
    #[must_use]
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Values of the row.
    #[must_use]
    pub fn row(&self) -> &[f64] {
        &self.row
    }

    /// Replaces all values at once, as when a log is replayed. Allocates nothing.
    ///
    /// # Panics
    /// If the number of values differs from the layout's width.
    pub fn set_row(&mut self, row: &[f64]) {
        assert_eq!(row.len(), self.row.len(), "one value for each element of the layout");
        self.row.copy_from_slice(row);
    }
}

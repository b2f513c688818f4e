//! Bounds on a quantity of each joint.

use nalgebra::DVector;

/// One interval per joint.
#[derive(Clone, Debug)]
pub(crate) struct Interval {
    pub lower: DVector<f64>,
    pub upper: DVector<f64>,
}

impl Interval {
    pub(crate) fn new(n: usize) -> Self {
        Self {
            lower: DVector::from_element(n, f64::NEG_INFINITY),
            upper: DVector::from_element(n, f64::INFINITY),
        }
    }

    pub(crate) fn contains(&self, i: usize, value: f64) -> bool {
        value >= self.lower[i] && value <= self.upper[i]
    }

    /// Widens the interval of a joint to include `value`.
    pub(crate) fn include(&mut self, i: usize, value: f64) {
        self.lower[i] = self.lower[i].min(value);
        self.upper[i] = self.upper[i].max(value);
    }
}

//! Absence of the interior-point method: the feature `clarabel` is off.

use crate::qp::quadratic_program::{QpError, QuadraticProgram};

/// Solver that does not exist.
#[derive(Debug)]
pub enum InteriorPoint {}

impl InteriorPoint {
    /// Fails: the feature `clarabel` is off.
    ///
    /// # Errors
    /// [`QpError::Unsolved`] always.
    pub fn new(_variables: usize, _constraints: usize) -> Result<Self, QpError> {
        Err(QpError::Unsolved("opspace-control was built without its feature 'clarabel'"))
    }

    /// Unreachable, as no value of this type exists.
    ///
    /// # Errors
    /// None.
    pub fn solve(&mut self, _program: &QuadraticProgram) -> Result<(), QpError> {
        match *self {}
    }

    /// Unreachable, as no value of this type exists.
    #[must_use]
    pub fn x(&self) -> &[f64] {
        match *self {}
    }
}

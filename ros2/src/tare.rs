//! Request to tare force sensors, from the node of a task to the driver.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Number of requests so far, which the nodes of a program share.
#[derive(Clone, Debug, Default)]
pub struct Tare(Arc<AtomicU64>);

impl Tare {
    /// Asks for a tare.
    pub fn ask(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    /// Number of requests so far.
    #[must_use]
    pub fn requests(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

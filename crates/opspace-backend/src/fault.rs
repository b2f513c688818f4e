//! Faults reported by a robot or its driver.

use std::borrow::Cow;
use std::error::Error;
use std::fmt;

/// A fault reported by the robot or its driver: its code and text, as they appear in the summary, the log and error
/// messages.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct DeviceFault {
    /// Fault code of the device.
    pub code: u32,
    /// Cause, a sentence without a full stop. For faults that may occur in the control cycle, use a borrowed string,
    /// which needs no allocation.
    pub words: Cow<'static, str>,
}

impl DeviceFault {
    /// Returns a fault.
    #[must_use]
    pub fn new(code: u32, words: impl Into<Cow<'static, str>>) -> Self {
        Self { code, words: words.into() }
    }
}

impl fmt::Display for DeviceFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} (code {})", self.words, self.code)
    }
}

impl Error for DeviceFault {}

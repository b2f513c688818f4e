//! Faults that a robot reports itself.

use std::borrow::Cow;
use std::error::Error;
use std::fmt;

/// A fault that the robot or its driver reports: the code and the words of the device, as they are to appear in
/// summary, log and error messages.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct DeviceFault {
    /// The device's own number of the fault.
    pub code: u32,
    /// The cause, a sentence without a full stop. A fault that may occur in the control cycle uses borrowed text, so
    /// that nothing is allocated.
    pub words: Cow<'static, str>,
}

impl DeviceFault {
    /// A fault.
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

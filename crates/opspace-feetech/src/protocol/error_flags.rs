//! Error flags of a servo.

use std::fmt;
use std::ops::BitOr;

/// Error flags in an answer of a servo, and in its register Status.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct ErrorFlags(u8);

impl ErrorFlags {
    /// No error.
    pub const NONE: Self = Self(0);
    /// The supply voltage is outside the limits of the servo.
    pub const VOLTAGE: Self = Self(1);
    /// The position sensor is disturbed.
    pub const SENSOR: Self = Self(2);
    /// The servo is too hot.
    pub const OVERHEAT: Self = Self(4);
    /// The motor current is too large.
    pub const OVERCURRENT: Self = Self(8);
    /// The load is too large for too long: the servo has reduced its torque.
    pub const OVERLOAD: Self = Self(32);

    /// Flags with a meaning, with their names.
    pub const NAMED: [(Self, &'static str); 5] = [
        (Self::VOLTAGE, "voltage"),
        (Self::SENSOR, "position sensor"),
        (Self::OVERHEAT, "overheat"),
        (Self::OVERCURRENT, "overcurrent"),
        (Self::OVERLOAD, "overload"),
    ];

    /// Returns flags with these bits.
    #[must_use]
    pub const fn from_bits(bits: u8) -> Self {
        Self(bits)
    }

    /// Bits of the flags.
    #[must_use]
    pub const fn bits(self) -> u8 {
        self.0
    }

    /// Returns true if no flag is set.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Returns true if all of these flags are set.
    #[must_use]
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

impl BitOr for ErrorFlags {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl fmt::Display for ErrorFlags {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut separator = "";
        for (flag, name) in Self::NAMED {
            if self.contains(flag) {
                write!(f, "{separator}{name}")?;
                separator = ", ";
            }
        }
        let known = Self::NAMED.iter().fold(0, |bits, (flag, _)| bits | flag.0);
        match self.0 & !known {
            0 if self.0 == 0 => f.write_str("no error"),
            0 => Ok(()),
            other => write!(f, "{separator}unknown bits {other:#04x}"),
        }
    }
}

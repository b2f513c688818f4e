//! Faults of a servo bus, each with its code, name and text.

use crate::protocol::ErrorFlags;
use opspace_backend::DeviceFault;

/// Fault of a servo bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum BusFault {
    /// A command that a servo cannot follow.
    WrongCommand,
    /// The serial port is gone: its cable was pulled, or its adapter has failed.
    PortGone,
    /// No servo answers: no power, or no connection.
    Silent,
    /// One servo does not answer, others do.
    ServoMissing,
    /// A servo sends other answers than are asked for.
    WrongAnswer,
    /// The answers of a servo have wrong checksums.
    Checksum,
    /// Answers arrive later than the rate allows.
    TooSlow,
    /// A servo reports a supply voltage outside its limits.
    Voltage,
    /// A servo reports a disturbed position sensor.
    Sensor,
    /// A servo reports overheat.
    Overheat,
    /// A servo reports overcurrent.
    Overcurrent,
    /// A servo reports overload, and has reduced its torque.
    Overload,
}

impl BusFault {
    /// All faults.
    pub const ALL: [Self; 12] = [
        Self::WrongCommand,
        Self::PortGone,
        Self::Silent,
        Self::ServoMissing,
        Self::WrongAnswer,
        Self::Checksum,
        Self::TooSlow,
        Self::Voltage,
        Self::Sensor,
        Self::Overheat,
        Self::Overcurrent,
        Self::Overload,
    ];

    /// Code of the [`DeviceFault`].
    #[must_use]
    pub const fn code(self) -> u32 {
        match self {
            Self::WrongCommand => 1,
            Self::PortGone => 10,
            Self::Silent => 11,
            Self::ServoMissing => 12,
            Self::WrongAnswer => 13,
            Self::Checksum => 14,
            Self::TooSlow => 15,
            Self::Voltage => 20,
            Self::Sensor => 21,
            Self::Overheat => 22,
            Self::Overcurrent => 23,
            Self::Overload => 24,
        }
    }

    /// Name in files and tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::WrongCommand => "wrong-command",
            Self::PortGone => "port-gone",
            Self::Silent => "silent",
            Self::ServoMissing => "servo-missing",
            Self::WrongAnswer => "wrong-answer",
            Self::Checksum => "checksum",
            Self::TooSlow => "too-slow",
            Self::Voltage => "voltage",
            Self::Sensor => "position-sensor",
            Self::Overheat => "overheat",
            Self::Overcurrent => "overcurrent",
            Self::Overload => "overload",
        }
    }

    /// Text of a fault that concerns no single servo, without a full stop.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::WrongCommand => "the servos accept only finite joint positions",
            Self::PortGone => "the serial port is gone: its cable was pulled, or its adapter has failed",
            Self::Silent => "no servo answers: check the power supply and the cable of the bus",
            Self::ServoMissing => "a servo does not answer",
            Self::WrongAnswer => "a servo sends other answers than are asked for; two may have the same id",
            Self::Checksum => "answers have wrong checksums: check the cable of the bus",
            Self::TooSlow => "answers arrive later than the rate allows",
            Self::Voltage => "a servo reports a supply voltage outside its limits",
            Self::Sensor => "a servo reports a disturbed position sensor",
            Self::Overheat => "a servo reports overheat",
            Self::Overcurrent => "a servo reports overcurrent",
            Self::Overload => "a servo reports overload, and has reduced its torque",
        }
    }

    /// Text of a fault of one servo, without a full stop.
    #[must_use]
    pub fn text_of(self, id: u8, joint: &str) -> String {
        let what = match self {
            Self::ServoMissing => "does not answer, others do: check its cable and id",
            Self::WrongAnswer => "sends other answers than are asked for; two may have the same id",
            Self::Checksum => "sends answers with wrong checksums: check its cable",
            Self::TooSlow => "answers later than the rate allows",
            Self::Voltage => "reports a supply voltage outside its limits",
            Self::Sensor => "reports a disturbed position sensor",
            Self::Overheat => "reports overheat",
            Self::Overcurrent => "reports overcurrent",
            Self::Overload => "reports overload, and has reduced its torque",
            Self::WrongCommand | Self::PortGone | Self::Silent => return self.text().to_owned(),
        };
        format!("servo {id} ({joint}) {what}")
    }

    /// Returns the gravest of the faults that flags report; `None` if there is none.
    #[must_use]
    pub fn of_flags(flags: ErrorFlags) -> Option<Self> {
        [
            (ErrorFlags::OVERLOAD, Self::Overload),
            (ErrorFlags::OVERHEAT, Self::Overheat),
            (ErrorFlags::OVERCURRENT, Self::Overcurrent),
            (ErrorFlags::SENSOR, Self::Sensor),
            (ErrorFlags::VOLTAGE, Self::Voltage),
        ]
        .into_iter()
        .find_map(|(flag, fault)| flags.contains(flag).then_some(fault))
    }
}

impl From<BusFault> for DeviceFault {
    fn from(fault: BusFault) -> Self {
        Self::new(fault.code(), fault.text())
    }
}

/// Texts of the faults of each servo, written before a run, because nothing is allocated in a control cycle.
#[derive(Clone, Debug)]
pub(crate) struct FaultTexts {
    texts: Vec<[String; BusFault::ALL.len()]>,
}

impl FaultTexts {
    /// Writes the texts of servos with these identifiers and joints, and what else may cause silence.
    pub fn new<'a>(servos: impl Iterator<Item = (u8, &'a str)>, other_cause_of_silence: &str) -> Self {
        let of = |(id, joint): (u8, &str)| {
            BusFault::ALL.map(|fault| match fault {
                BusFault::Silent | BusFault::ServoMissing => {
                    fault.text_of(id, joint) + other_cause_of_silence
                }
                _ => fault.text_of(id, joint),
            })
        };
        Self { texts: servos.map(of).collect() }
    }

    /// Returns the fault of a servo. Its text is taken, so that the second fault of the same kind has the general one.
    pub fn take(&mut self, fault: BusFault, servo: usize) -> DeviceFault {
        let place = BusFault::ALL.iter().position(|other| *other == fault);
        let text = place.and_then(|place| self.texts.get_mut(servo)?.get_mut(place)).map(std::mem::take);
        match text {
            Some(text) if !text.is_empty() => DeviceFault::new(fault.code(), text),
            _ => fault.into(),
        }
    }
}

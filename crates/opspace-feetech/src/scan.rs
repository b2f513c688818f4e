//! Ports of the computer, and servos on a bus.

use crate::bus::{Bus, BusError};
use crate::protocol::{ErrorFlags, MAX_ID, Register};
use crate::transport::Transport;
use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

/// Time within which a servo must answer while a bus is scanned: an adapter for USB may collect bytes for 16 ms.
const ANSWER_WITHIN: Duration = Duration::from_millis(20);

/// Baud rates of the servos, by the content of register Baud_Rate (Feetech's table, as LeRobot has it).
pub const BAUD_RATES_HZ: [u32; 8] = [1_000_000, 500_000, 250_000, 128_000, 115_200, 57_600, 38_400, 19_200];

/// Models of servos with the registers of this crate: number, name.
pub const MODELS: [(i32, &str); 3] = [(777, "STS3215"), (2825, "STS3250"), (11272, "SM8512BL")];

/// A servo that a scan has found.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct FoundServo {
    /// Identifier.
    pub id: u8,
    /// Number of its model.
    pub model: i32,
    /// Version of its firmware.
    pub firmware: (i32, i32),
    /// Supply voltage, V.
    pub voltage_v: f64,
    /// Temperature, °C.
    pub temperature_c: i32,
    /// Position, counts.
    pub position: i32,
    /// True if its torque is on.
    pub is_torque_on: bool,
    /// Error flags.
    pub flags: ErrorFlags,
}

impl FoundServo {
    /// Name of the model; `None` if this crate does not know it.
    #[must_use]
    pub fn model_name(&self) -> Option<&'static str> {
        MODELS.iter().find(|(number, _)| *number == self.model).map(|(_, name)| *name)
    }
}

impl fmt::Display for FoundServo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { id, model, firmware: (major, minor), voltage_v, temperature_c, position, .. } = self;
        write!(f, "servo {id}: ")?;
        match self.model_name() {
            Some(name) => write!(f, "{name}")?,
            None => write!(f, "model {model}, which this driver does not know")?,
        }
        let torque = if self.is_torque_on { "on" } else { "off" };
        write!(
            f,
            ", firmware {major}.{minor}, {voltage_v:.1} V, {temperature_c} °C, at {position} counts, torque {torque}"
        )?;
        let names = ErrorFlags::NAMED.iter().filter(|(flag, _)| self.flags.bits() & flag.bits() != 0);
        names.into_iter().try_for_each(|(_, name)| write!(f, ", reports {name}"))
    }
}

/// Asks the identifiers up to `last` one after the other, and reads what the servos say about themselves. Nothing is
/// written. An identifier that does not answer takes 20 ms.
///
/// # Errors
/// If the connection is gone. A servo that does not answer all questions is left out.
pub fn scan<T: Transport>(bus: &mut Bus<T>, last: u8) -> Result<Vec<FoundServo>, BusError> {
    let mut found = Vec::new();
    for id in 0..=last.min(MAX_ID) {
        if !bus.answers(id, ANSWER_WITHIN)? {
            continue;
        }
        match describe(bus, id) {
            Ok(servo) => found.push(servo),
            Err(BusError::Port(error)) => return Err(error.into()),
            Err(_) => {}
        }
    }
    Ok(found)
}

fn describe<T: Transport>(bus: &mut Bus<T>, id: u8) -> Result<FoundServo, BusError> {
    let flags = bus.ping(id)?;
    let mut read = |register| bus.read(id, register);
    Ok(FoundServo {
        id,
        model: read(Register::MODEL_NUMBER)?,
        firmware: (read(Register::FIRMWARE_MAJOR_VERSION)?, read(Register::FIRMWARE_MINOR_VERSION)?),
        voltage_v: f64::from(read(Register::PRESENT_VOLTAGE)?) / 10.0,
        temperature_c: read(Register::PRESENT_TEMPERATURE)?,
        position: read(Register::PRESENT_POSITION)?,
        is_torque_on: read(Register::TORQUE_ENABLE)? == 1,
        flags,
    })
}

/// Serial ports of USB adapters, sorted: `/dev/ttyACM…` and `/dev/ttyUSB…`. Empty on systems that have no such files.
#[must_use]
pub fn ports() -> Vec<PathBuf> {
    let entries = std::fs::read_dir("/dev").into_iter().flatten().flatten();
    let is_port = |name: &str| name.starts_with("ttyACM") || name.starts_with("ttyUSB");
    let mut ports: Vec<PathBuf> = entries
        .filter(|entry| entry.file_name().to_str().is_some_and(is_port))
        .map(|entry| entry.path())
        .collect();
    ports.sort();
    ports
}

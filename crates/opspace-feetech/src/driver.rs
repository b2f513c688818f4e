//! The driver `feetech` of `[driver]` in robot.toml.

use crate::arm::{FeetechArm, capabilities, least_bytes};
use crate::arm_config::{ArmConfig, AtEnd, KEYS, doubts_of_gains};
#[cfg(target_os = "linux")]
use crate::bus::Bus;
#[cfg(target_os = "linux")]
use crate::protocol::MAX_ID;
#[cfg(target_os = "linux")]
use crate::scan::{self, FoundServo};
#[cfg(target_os = "linux")]
use crate::simulated::{PseudoTerminal, bus_with_arm};
use crate::start::ANSWER_SHARE;
use crate::transport::Transport;
use opspace_backend::{Backend, Capabilities, Driver, DriverError, DriverKey, DriverWarning, Settings};
#[cfg(target_os = "linux")]
use opspace_backend::{FoundDevice, Observed, ObservedTorque, ServedDevices, SimulatedDevices};
use std::path::Path;

/// Baud rate of the servos' factory settings.
const DEFAULT_BAUD_HZ: f64 = 1e6;

/// Driver of arms on Feetech's servo bus. Its keys are [`KEYS`].
#[derive(Clone, Copy, Debug, Default)]
pub struct FeetechDriver;

impl Driver for FeetechDriver {
    fn name(&self) -> &str {
        "feetech"
    }

    fn keys(&self) -> &[DriverKey] {
        &KEYS
    }

    /// A calibration or a port that is not there is a warning: an arm may be calibrated and connected later.
    fn check(&self, settings: &Settings) -> Result<Vec<DriverWarning>, DriverError> {
        let port = port_of(settings)?;
        let mut warnings = doubts_of_gains(settings)?;
        if let Err(error) = ArmConfig::from_settings(settings) {
            if !is_calibration_absent(settings, &error) {
                return Err(error);
            }
            warnings.push(DriverWarning::at("calibration", error.words));
        }
        expect_fast_enough(&port, settings)?;
        if !Path::new(port.path).exists() {
            let words =
                format!("{} does not exist: connect the adapter, or see `opspace driver scan`", port.path);
            warnings.push(DriverWarning::at("port", words));
        }
        Ok(warnings)
    }

    /// Returns the capabilities of the arm; `None` while its calibration does not exist.
    fn capabilities(&self, settings: &Settings) -> Result<Option<Capabilities>, DriverError> {
        match ArmConfig::from_settings(settings) {
            Ok(config) => Ok(Some(capabilities(&config))),
            Err(error) if is_calibration_absent(settings, &error) => Ok(None),
            Err(error) => Err(error),
        }
    }

    fn with(&self, settings: &Settings, run: &mut dyn FnMut(&mut dyn Backend)) -> Result<(), DriverError> {
        let port = port_of(settings)?;
        let config = ArmConfig::from_settings(settings)?;
        #[cfg(target_os = "linux")]
        return with_transport(open_port(port.path, port.baud_hz)?, config, run);
        #[cfg(not(target_os = "linux"))]
        {
            let _ = (port.baud_hz, config, run);
            Err(DriverError::new("serial ports are supported on Linux only so far"))
        }
    }

    fn state_after_run(&self, settings: &Settings) -> Option<String> {
        let is_lowered = settings.text("at_end").is_ok_and(|at_end| at_end == "lower");
        let state = if is_lowered {
            "the arm was lowered, and its torque is off"
        } else {
            "torque stays on, and the arm holds its last position: `opspace driver read ROBOT --release` lowers it and switches torque \
             off"
        };
        Some(state.to_owned())
    }

    #[cfg(target_os = "linux")]
    fn observe(
        &self,
        settings: &Settings,
        torque: ObservedTorque,
        observe: &mut dyn FnMut(&mut dyn Observed),
    ) -> Result<(), DriverError> {
        let port = port_of(settings)?;
        let config = ArmConfig::from_settings(settings)?;
        let mut arm = FeetechArm::observe(open_port(port.path, port.baud_hz)?, config, torque)?;
        observe(&mut arm);
        Ok(())
    }

    /// Searches a port, or all serial ports of USB adapters, at all baud rates: some 5 s for each of them without servos.
    #[cfg(target_os = "linux")]
    fn scan(&self, place: Option<&str>) -> Result<Vec<FoundDevice>, DriverError> {
        let ports = place.map_or_else(scan::ports, |place| vec![place.into()]);
        if ports.is_empty() {
            return Err(DriverError::new(
                "there is no /dev/ttyACM* and no /dev/ttyUSB*: connect the adapter, or name its port",
            ));
        }
        let mut found = Vec::new();
        for port in ports {
            let path = port.display().to_string();
            for baud_hz in scan::BAUD_RATES_HZ {
                let mut bus = Bus::new(open_port(&path, baud_hz)?);
                let servos = scan::scan(&mut bus, MAX_ID);
                let servos = servos.map_err(|error| DriverError::new(format!("{path}: {error}")))?;
                if servos.is_empty() {
                    continue;
                }
                let place = format!("port = \"{path}\", baud_hz = {baud_hz}");
                let device =
                    |servo: FoundServo| FoundDevice { place: place.clone(), description: servo.to_string() };
                found.extend(servos.into_iter().map(device));
                // The servos of a bus have one baud rate.
                break;
            }
        }
        Ok(found)
    }

    /// Serves the servos of the arm behind a pseudo-terminal, in real time. Options are
    /// [`OPTIONS`](crate::simulated::devices::OPTIONS).
    #[cfg(target_os = "linux")]
    fn simulate(
        &self,
        settings: &Settings,
        devices: SimulatedDevices,
        serve: &mut dyn FnMut(&ServedDevices),
    ) -> Result<String, DriverError> {
        let link = devices.link.clone();
        let calibration = settings.path("calibration")?;
        let is_absent = !calibration.exists();
        let bus = bus_with_arm(settings, devices)?;
        let failed = |error: std::io::Error| DriverError::new(format!("no pseudo-terminal: {error}"));
        let mut terminal = PseudoTerminal::open(bus).map_err(failed)?;
        if let Some(link) = &link {
            let failed = |error| DriverError::new(format!("{}: {error}", link.display()));
            terminal = terminal.with_link(link).map_err(failed)?;
        }
        let mut served = ServedDevices::new(link.as_deref().unwrap_or(terminal.path()).display().to_string());
        if is_absent {
            served.written.push((
                calibration,
                "the calibration of the simulated arm; a real arm needs that of LeRobot",
            ));
        }
        serve(&served);
        let pause_ms = terminal.longest_pause().as_secs_f64() * 1e3;
        let late = match terminal.late_requests() {
            0 => String::new(),
            count => format!(
                "; requests found after a pause of more than 5 ms: {count}. Their answers were late because this computer was busy: the \
                 other program may have taken servos for silent or slow"
            ),
        };
        let failure = terminal.bus().joints().failure().map(str::to_owned);
        match failure {
            Some(failure) => Err(DriverError::new(format!("the simulated arm has failed: {failure}"))),
            None => Ok(format!("longest pause of the simulation: {pause_ms:.1} ms{late}")),
        }
    }
}

/// Starts an arm on a connection, runs it, and ends its use as the configuration declares.
///
/// # Errors
/// If the arm cannot be started, or does not lie when it was to be lowered.
pub fn with_transport<T: Transport>(
    transport: T,
    config: ArmConfig,
    run: &mut dyn FnMut(&mut dyn Backend),
) -> Result<(), DriverError> {
    let is_lowered = matches!(config.at_end, AtEnd::Lower { .. });
    let mut arm = FeetechArm::start(transport, config)?;
    run(&mut arm);
    let is_released = arm.finish().map_err(|fault| {
        DriverError::new(format!("the arm could not be lowered, and is held if its bus has power: {fault}"))
    })?;
    if is_lowered && !is_released {
        let words = "the arm did not come to lie within lowering_s: it is held, with torque on";
        return Err(DriverError::at("lowering_s", words));
    }
    Ok(())
}

/// Port that `[driver]` states.
struct StatedPort<'a> {
    path: &'a str,
    baud_hz: u32,
}

/// Reads the keys of the port, after the keys of all else are known to be there.
fn port_of(settings: &Settings) -> Result<StatedPort<'_>, DriverError> {
    settings.expect(&KEYS)?;
    let path = settings.text("port")?;
    let baud_hz = if settings.contains("baud_hz") { settings.number("baud_hz")? } else { DEFAULT_BAUD_HZ };
    if baud_hz.fract() != 0.0 || !(1200.0..=4e6).contains(&baud_hz) {
        let words = format!("'baud_hz' must be a whole number of 1200 to 4000000, not {baud_hz}");
        return Err(DriverError::at("baud_hz", words));
    }
    Ok(StatedPort { path, baud_hz: baud_hz as u32 })
}

/// True if the error is that the file of the calibration does not exist.
fn is_calibration_absent(settings: &Settings, error: &DriverError) -> bool {
    error.key.as_deref() == Some("calibration")
        && settings.path("calibration").is_ok_and(|path| !path.exists())
}

/// Refuses a baud rate at which the bytes of a cycle alone need longer than the answers may. The start measures the bus.
fn expect_fast_enough(port: &StatedPort<'_>, settings: &Settings) -> Result<(), DriverError> {
    let bytes = least_bytes(settings.joints.len());
    let needed_s = 10.0 * bytes as f64 / f64::from(port.baud_hz);
    let allowed_s = ANSWER_SHARE * settings.period_s;
    if needed_s <= allowed_s {
        return Ok(());
    }
    let words = format!(
        "bus slower than the rate asked: {bytes} bytes need {:.1} ms at {} baud; at {:.0} Hz they may need {:.1} ms. Lower the rate, or \
         raise baud_hz",
        needed_s * 1e3,
        port.baud_hz,
        1.0 / settings.period_s,
        allowed_s * 1e3
    );
    Err(DriverError::at("baud_hz", words))
}

#[cfg(target_os = "linux")]
fn open_port(path: &str, baud_hz: u32) -> Result<crate::serial_port::SerialPort, DriverError> {
    use crate::serial_port::{PortError, SerialPort};

    SerialPort::open(path.as_ref(), baud_hz).map_err(|error| match error {
        PortError::Baud { .. } => DriverError::at("baud_hz", format!("{path}: {error}")),
        _ => DriverError::at("port", format!("{path}: {error}{}", remedy(&error))),
    })
}

#[cfg(target_os = "linux")]
fn remedy(error: &crate::serial_port::PortError) -> &'static str {
    use crate::serial_port::PortError::{Open, Used};
    use std::io::ErrorKind::{NotFound, PermissionDenied};

    match error {
        Open(error) if error.kind() == PermissionDenied => {
            "; add yourself to the group of the file (dialout), and log in again"
        }
        Used { .. } => "; end it first",
        Open(error) if error.kind() == NotFound => {
            "; ports of USB adapters are /dev/ttyACM0, /dev/ttyUSB0 and so on"
        }
        _ => "",
    }
}

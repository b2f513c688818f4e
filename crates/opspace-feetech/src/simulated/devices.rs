//! The simulated bus of an arm of opspace: its servos, as robot.toml and the calibration describe them, on its joints.

use crate::arm_config::ArmConfig;
use crate::calibration::Calibration;
use crate::protocol::Register;
use crate::simulated::arm_joints::ArmJoints;
use crate::simulated::bus::{BusOptions, SimulatedBus};
use crate::simulated::joints::JointModel;
use crate::simulated::servo::{ServoOptions, SimulatedServo};
use opspace_backend::{DriverError, Settings, SimulatedDevices};
use std::path::Path;
use std::time::Duration;

/// Options of the simulation.
pub const OPTIONS: [&str; 13] = [
    "latency_ms",
    "lost_share",
    "damaged_share",
    "seed",
    "dead_zone_counts",
    "stiffness_at_32_nm_per_rad",
    "damping_at_32_nms_per_rad",
    "integral_at_32_nm_per_rad_s",
    "stall_torque_nm",
    "torque_per_current_nm_per_a",
    "voltage_v",
    "max_voltage_v",
    "supply_resistance_ohm",
];

/// Returns a bus of the servos that `[driver]` describes, which hold the arm at its start until the first goal. Without a calibration file, one of the
/// simulated arm is written where `calibration` states it.
///
/// # Errors
/// If settings or options are wrong, the calibration cannot be written, or the arm cannot be simulated.
pub fn bus_with_arm(settings: &Settings, devices: SimulatedDevices) -> Result<SimulatedBus, DriverError> {
    let Options { bus: bus_options, servo: servo_options, dead_zone, max_voltage_v } =
        Options::read(&devices.options, devices.arm.capabilities().period_s)
            .map_err(|error| DriverError::new(format!("option of the simulation: {error}")))?;
    if settings.contains("calibration") {
        write_missing_calibration(settings, &devices)?;
    }
    let config = ArmConfig::from_settings(settings)?;
    let SimulatedDevices { arm, holding_torque_nm, .. } = devices;
    let joints = ArmJoints::new(arm)?;
    let start = joints.q().to_vec();
    let servos = config.servos.iter().zip(&start).enumerate().map(|(index, (servo_config, q))| {
        let mut servo = SimulatedServo::calibrated(servo_config, servo_options);
        servo.set(Register::P_COEFFICIENT, config.gains.p.into());
        servo.set(Register::I_COEFFICIENT, config.gains.i.into());
        servo.set(Register::D_COEFFICIENT, config.gains.d.into());
        servo.set(Register::CW_DEAD_ZONE, dead_zone);
        servo.set(Register::CCW_DEAD_ZONE, dead_zone);
        if let Some(limit_v) = max_voltage_v {
            servo.set(Register::MAX_VOLTAGE_LIMIT, (10.0 * limit_v).round() as i32);
        }
        servo.hold(*q, holding_torque_nm.get(index).copied().unwrap_or(0.0));
        servo
    });
    let servos = servos.collect();
    Ok(SimulatedBus::new(servos, Box::new(joints), bus_options))
}

/// Writes the calibration of the simulated arm if its file does not exist.
fn write_missing_calibration(settings: &Settings, devices: &SimulatedDevices) -> Result<(), DriverError> {
    let path = settings.path("calibration")?;
    if path.exists() {
        return Ok(());
    }
    let failed = |words: String| DriverError::at("calibration", format!("{}: {words}", path.display()));
    let motors = settings.texts_by_joint("motors")?;
    let motors = motors.into_iter().zip(&settings.joints).map(|(motor, joint)| motor.unwrap_or(joint));
    let ranges = devices.position_ranges_rad.iter().copied();
    let calibration =
        Calibration::of_simulation(motors.zip(ranges)).map_err(|error| failed(error.to_string()))?;
    let text = calibration.to_json().map_err(|error| failed(error.to_string()))?;
    write_new(&path, &text).map_err(|error| failed(error.to_string()))
}

/// Writes a file that does not exist.
fn write_new(path: &Path, text: &str) -> std::io::Result<()> {
    use std::io::Write;

    let mut file = std::fs::File::create_new(path)?;
    file.write_all(text.as_bytes())
}

/// Options of the simulation.
struct Options {
    bus: BusOptions,
    servo: ServoOptions,
    /// Contents of the registers CW_Dead_Zone and CCW_Dead_Zone.
    dead_zone: i32,
    /// Content of register Max_Voltage_Limit; `None` is that of the factory, 8 V.
    max_voltage_v: Option<f64>,
}

impl Options {
    fn read(options: &Settings, period_s: f64) -> Result<Self, DriverError> {
        options.expect_only(&OPTIONS)?;
        let (bus, servo) = (BusOptions::default(), ServoOptions::default());
        let or = |key, default| Ok::<f64, DriverError>(positive(options, key)?.unwrap_or(default));
        let bus = BusOptions {
            servo_period: Duration::from_secs_f64(period_s),
            latency: Duration::from_secs_f64(or("latency_ms", 0.0)?.min(1e4) / 1e3),
            lost_share: share(options, "lost_share")?,
            damaged_share: share(options, "damaged_share")?,
            seed: or("seed", 1.0)? as u64,
            supply_resistance_ohm: or("supply_resistance_ohm", 0.0)?,
            waits_for_goal: true,
            ..bus
        };
        let servo = ServoOptions {
            stiffness_at_32_nm_per_rad: or("stiffness_at_32_nm_per_rad", servo.stiffness_at_32_nm_per_rad)?,
            damping_at_32_nms_per_rad: or("damping_at_32_nms_per_rad", servo.damping_at_32_nms_per_rad)?,
            integral_at_32_nm_per_rad_s: or(
                "integral_at_32_nm_per_rad_s",
                servo.integral_at_32_nm_per_rad_s,
            )?,
            stall_torque_nm: or("stall_torque_nm", servo.stall_torque_nm)?,
            torque_per_current_nm_per_a: or(
                "torque_per_current_nm_per_a",
                servo.torque_per_current_nm_per_a,
            )?,
            voltage_v: or("voltage_v", servo.voltage_v)?,
            ..servo
        };
        let dead_zone = or("dead_zone_counts", 1.0)?.round() as i32;
        Ok(Self { bus, servo, dead_zone, max_voltage_v: positive(options, "max_voltage_v")? })
    }
}

/// Returns a number of at least zero, if the option is stated.
fn positive(options: &Settings, key: &str) -> Result<Option<f64>, DriverError> {
    if !options.contains(key) {
        return Ok(None);
    }
    let number = options.number(key)?;
    if number.is_finite() && number >= 0.0 {
        return Ok(Some(number));
    }
    Err(DriverError::at(key, format!("'{key}' must be at least 0, not {number}")))
}

fn share(options: &Settings, key: &str) -> Result<f64, DriverError> {
    match positive(options, key)?.unwrap_or(0.0) {
        share if share <= 1.0 => Ok(share),
        share => Err(DriverError::at(key, format!("'{key}' must be 0 to 1, not {share}"))),
    }
}

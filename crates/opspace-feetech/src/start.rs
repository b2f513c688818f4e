//! Start of an arm: what is compared, written and read back before a run.

use crate::arm_config::{ArmConfig, ServoConfig, TorqueSource, acceleration_of, profile_value};
use crate::bus::{Answer, Bus, BusError};
use crate::counts::RAD_PER_COUNT;
use crate::fault::BusFault;
use crate::protocol::{ErrorFlags, Register};
use crate::scan::MODELS;
use crate::transport::Transport;
use opspace_backend::DriverError;
use std::time::Duration;

/// Share of a period within which the answers must be there; the rest is for the command.
pub(crate) const ANSWER_SHARE: f64 = 0.7;

/// Number of rounds by which the bus is measured.
const ROUNDS: usize = 20;

/// Time within which a round must be complete while the bus is measured.
const ROUND_WITHIN: Duration = Duration::from_millis(100);

/// Properties of the servos that the start has found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Found {
    /// Velocity of one unit of velocity registers, counts/s.
    pub velocity_unit: f64,
    /// Median duration of a request to all servos with its answers.
    pub round: Duration,
}

/// Compares the servos with their configuration, and writes their profiles; torque is switched on where it is off, with the
/// present positions as goals. Returns the goals (counts).
///
/// Nothing is written before all comparisons are made. What is written is lost when power is switched off, because the
/// registers are locked first.
pub(crate) fn start<T: Transport>(
    bus: &mut Bus<T>,
    config: &ArmConfig,
    first_address: u8,
    length: usize,
) -> Result<(Found, Vec<i32>), DriverError> {
    for servo in &config.servos {
        check_servo(bus, servo, config)?;
    }
    let velocity_unit = velocity_unit(bus, config)?;
    let round = measure_round(bus, config, first_address, length)?;
    for servo in &config.servos {
        write_profile(bus, servo, config, velocity_unit)?;
    }
    let goals = switch_on(bus, config)?;
    Ok((Found { velocity_unit, round }, goals))
}

/// Compares the servos with their configuration, and writes nothing. Returns their goals (counts), and for each of them whether its
/// torque is on; the goal of a servo without torque is its position.
pub(crate) fn observe<T: Transport>(
    bus: &mut Bus<T>,
    config: &ArmConfig,
) -> Result<(Found, Vec<i32>, Vec<bool>), DriverError> {
    let (mut goals, mut torque_on) = (Vec::new(), Vec::new());
    for servo in &config.servos {
        check_servo(bus, servo, config)?;
        let mut read =
            |register| bus.read(servo.calibration.id, register).map_err(|error| not_reached(servo, error));
        let is_on = read(Register::TORQUE_ENABLE)? == 1;
        goals.push(read(if is_on { Register::GOAL_POSITION } else { Register::PRESENT_POSITION })?);
        torque_on.push(is_on);
    }
    let velocity_unit = velocity_unit(bus, config)?;
    Ok((Found { velocity_unit, round: Duration::ZERO }, goals, torque_on))
}

/// Compares one servo with its configuration.
fn check_servo<T: Transport>(
    bus: &mut Bus<T>,
    servo: &ServoConfig,
    config: &ArmConfig,
) -> Result<(), DriverError> {
    let id = servo.calibration.id;
    let flags = bus.ping(id).map_err(|error| not_reached(servo, error))?;
    let mut read = |register| bus.read(id, register).map_err(|error| not_reached(servo, error));
    check_flags(servo, flags, &mut read)?;

    let model = read(Register::MODEL_NUMBER)?;
    if !MODELS.iter().any(|(number, _)| *number == model) {
        let known = MODELS.map(|(number, name)| format!("{number} ({name})")).join(", ");
        return Err(of_servo(servo, format!("is of model {model}; the models are: {known}")));
    }
    let mode = read(Register::OPERATING_MODE)?;
    if mode != 0 {
        return Err(of_servo(servo, format!("has Operating_Mode {mode}; it must be 0, position")));
    }
    if read(Register::RESPONSE_STATUS_LEVEL)? != 1 {
        return Err(of_servo(
            servo,
            "has Response_Status_Level 0; it must be 1, all requests are answered".into(),
        ));
    }
    if matches!(config.motor_torque, Some(TorqueSource::Current(_))) && read(Register::PHASE)? & 32 != 0 {
        return Err(of_servo(
            servo,
            "measures no current (bit 5 of register Phase): leave out torque_per_current_nm_per_a".into(),
        ));
    }
    let expected = servo.calibration;
    for (register, value, key) in [
        (Register::HOMING_OFFSET, expected.homing_offset, "homing_offset"),
        (Register::MIN_POSITION_LIMIT, expected.range_min, "range_min"),
        (Register::MAX_POSITION_LIMIT, expected.range_max, "range_max"),
    ] {
        let found = read(register)?;
        if found != value {
            let words = format!(
                "servo {id} ({}) has {} {found}, but the calibration has {key} {value}: it belongs to another arm, or the arm was \
                 calibrated again",
                servo.joint, register.name
            );
            return Err(DriverError::at("calibration", words));
        }
    }
    let position = read(Register::PRESENT_POSITION)?;
    if !(0..=4095).contains(&position) {
        return Err(of_servo(servo, format!("is at {position} counts, outside of one turn, 0 to 4095")));
    }
    Ok(())
}

/// Returns the error of a servo that reports an error already.
fn check_flags(
    servo: &ServoConfig,
    flags: ErrorFlags,
    read: &mut impl FnMut(Register) -> Result<i32, DriverError>,
) -> Result<(), DriverError> {
    let Some(fault) = BusFault::of_flags(flags) else { return Ok(()) };
    let numbers = match fault {
        BusFault::Voltage => format!(
            ": {:.1} V, of {:.1} to {:.1} V",
            f64::from(read(Register::PRESENT_VOLTAGE)?) / 10.0,
            f64::from(read(Register::MIN_VOLTAGE_LIMIT)?) / 10.0,
            f64::from(read(Register::MAX_VOLTAGE_LIMIT)?) / 10.0
        ),
        BusFault::Overheat => format!(
            ": {} °C, of at most {} °C",
            read(Register::PRESENT_TEMPERATURE)?,
            read(Register::MAX_TEMPERATURE_LIMIT)?
        ),
        _ => String::new(),
    };
    Err(fault_at_start(fault, servo, &numbers))
}

/// Returns the velocity (counts/s) of one unit of velocity registers.
fn velocity_unit<T: Transport>(bus: &mut Bus<T>, config: &ArmConfig) -> Result<f64, DriverError> {
    let mut unit = None;
    for servo in &config.servos {
        let phase =
            bus.read(servo.calibration.id, Register::PHASE).map_err(|error| not_reached(servo, error))?;
        let of_servo_ = if phase & 4 == 0 { 50.0 } else { 1.0 };
        if unit.is_some_and(|unit| unit != of_servo_) {
            return Err(of_servo(
                servo,
                "has another unit of velocities than the others (bit 2 of Phase)".into(),
            ));
        }
        if config.goal_speed_rad_per_s.is_none() && phase & 8 == 0 {
            let words = "stops at a goal velocity of 0 (bit 3 of Phase): state goal_speed_rad_per_s".into();
            return Err(of_servo(servo, words));
        }
        unit = Some(of_servo_);
    }
    Ok(unit.unwrap_or(1.0))
}

/// Measures the duration of a request to all servos with its answers, and compares it with the rate.
fn measure_round<T: Transport>(
    bus: &mut Bus<T>,
    config: &ArmConfig,
    address: u8,
    length: usize,
) -> Result<Duration, DriverError> {
    let ids: Vec<u8> = config.servos.iter().map(|servo| servo.calibration.id).collect();
    let mut answers = vec![Answer::default(); ids.len()];
    let mut durations = Vec::with_capacity(ROUNDS);
    for _ in 0..ROUNDS {
        let begun = bus.transport().now();
        let round = bus.sync_read(&ids, address, length, begun + ROUND_WITHIN, &mut answers);
        if round
            .map_err(|error| match error {
                BusError::Port(error) => DriverError::new(format!("{}: {error}", BusFault::PortGone.text())),
                other => DriverError::new(other.to_string()),
            })?
            .complete
            == ids.len()
        {
            durations.push(bus.transport().now() - begun);
        }
    }
    durations.sort();
    let allowed = Duration::from_secs_f64(ANSWER_SHARE * config.period_s);
    match durations.get(durations.len() / 2) {
        Some(median) if 2 * durations.len() > ROUNDS && *median <= allowed => Ok(*median),
        Some(median) if 2 * durations.len() > ROUNDS => Err(DriverError::new(format!(
            "bus slower than the rate asked: {} servos answer within {:.1} ms (median of {}); at {:.0} Hz it may be {:.1} ms. Lower the \
             rate, raise baud_hz, write 0 to Return_Delay_Time, or set the latency timer of the USB adapter to 1 ms (code {})",
            ids.len(),
            median.as_secs_f64() * 1e3,
            durations.len(),
            1.0 / config.period_s,
            allowed.as_secs_f64() * 1e3,
            BusFault::TooSlow.code(),
        ))),
        _ => Err(DriverError::new(format!(
            "of {ROUNDS} requests to all servos {} were answered completely within {} ms: check the cable of the bus",
            durations.len(),
            ROUND_WITHIN.as_millis()
        ))),
    }
}

/// Writes the registers of one servo's profile, and reads them back.
fn write_profile<T: Transport>(
    bus: &mut Bus<T>,
    servo: &ServoConfig,
    config: &ArmConfig,
    velocity_unit: f64,
) -> Result<(), DriverError> {
    let gains = config.gains;
    let unit = velocity_unit * RAD_PER_COUNT;
    let speed = profile_value("goal_speed_rad_per_s", config.goal_speed_rad_per_s, unit, 32767)?;
    let acceleration = acceleration_of(config.acceleration_rad_per_s2)?;
    let id = servo.calibration.id;
    for (register, value, key) in [
        // Locked first: what follows is not stored.
        (Register::LOCK, 1, None),
        (Register::P_COEFFICIENT, i32::from(gains.p), Some("p")),
        (Register::I_COEFFICIENT, i32::from(gains.i), Some("i")),
        (Register::D_COEFFICIENT, i32::from(gains.d), Some("d")),
        (Register::ACCELERATION, acceleration, Some("acceleration_rad_per_s2")),
        (Register::GOAL_VELOCITY, speed, Some("goal_speed_rad_per_s")),
    ] {
        bus.write(id, register, value).map_err(|error| not_reached(servo, error))?;
        let found = bus.read(id, register).map_err(|error| not_reached(servo, error))?;
        if found != value {
            let words = format!(
                "servo {id} ({}) has {} {found} after {value} was written: robot.toml and the servo do not agree",
                servo.joint, register.name
            );
            return Err(key.map_or_else(|| DriverError::new(&words), |key| DriverError::at(key, &words)));
        }
    }
    Ok(())
}

/// Switches torque on, so that the arm sags as little as can be: a servo that holds already keeps its goal; another one gets
/// its present position as goal immediately before, and once more afterwards if it has not taken it.
fn switch_on<T: Transport>(bus: &mut Bus<T>, config: &ArmConfig) -> Result<Vec<i32>, DriverError> {
    let mut goals = Vec::with_capacity(config.servos.len());
    for servo in &config.servos {
        let id = servo.calibration.id;
        let reached = |error| not_reached(servo, error);
        let is_on = bus.read(id, Register::TORQUE_ENABLE).map_err(reached)? == 1;
        let register = if is_on { Register::GOAL_POSITION } else { Register::PRESENT_POSITION };
        let goal = bus.read(id, register).map_err(reached)?;
        if !is_on {
            bus.write(id, Register::GOAL_POSITION, goal).map_err(reached)?;
            bus.write(id, Register::TORQUE_ENABLE, 1).map_err(reached)?;
        }
        if bus.read(id, Register::TORQUE_ENABLE).map_err(reached)? != 1 {
            return Err(of_servo(servo, "does not switch its torque on".into()));
        }
        if bus.read(id, Register::GOAL_POSITION).map_err(reached)? != goal {
            bus.write(id, Register::GOAL_POSITION, goal).map_err(reached)?;
            let found = bus.read(id, Register::GOAL_POSITION).map_err(reached)?;
            if found != goal {
                return Err(of_servo(servo, format!("has goal {found} after {goal} was written")));
            }
        }
        goals.push(goal);
    }
    Ok(goals)
}

fn of_servo(servo: &ServoConfig, what: String) -> DriverError {
    DriverError::new(format!("servo {} ({}) {what}", servo.calibration.id, servo.joint))
}

fn not_reached(servo: &ServoConfig, error: BusError) -> DriverError {
    match error {
        BusError::NoAnswer { .. } => fault_at_start(
            BusFault::ServoMissing,
            servo,
            "; without power none answers, and baud_hz must be that of register Baud_Rate",
        ),
        BusError::Late { .. } => fault_at_start(
            BusFault::TooSlow,
            servo,
            "; its adapter or this computer is busy, and a simulated bus needs its share of the computer",
        ),
        BusError::Checksum { .. } => fault_at_start(BusFault::Checksum, servo, ""),
        BusError::WrongAnswer { .. } => fault_at_start(BusFault::WrongAnswer, servo, ""),
        BusError::Port(error) => DriverError::new(format!(
            "{}: {error} (code {})",
            BusFault::PortGone.text(),
            BusFault::PortGone.code()
        )),
        other => of_servo(servo, format!("could not be asked: {other}")),
    }
}

fn fault_at_start(fault: BusFault, servo: &ServoConfig, more: &str) -> DriverError {
    let text = match fault {
        BusFault::ServoMissing => format!("servo {} ({}) does not answer", servo.calibration.id, servo.joint),
        BusFault::TooSlow => format!(
            "servo {} ({}) answers more than {} ms after a request",
            servo.calibration.id,
            servo.joint,
            BusError::LATE.as_millis()
        ),
        _ => fault.text_of(servo.calibration.id, &servo.joint),
    };
    DriverError::new(format!("{text}{more} (code {})", fault.code()))
}

//! A simulated servo: its registers, and the law between them and the motor.

use crate::arm_config::ServoConfig;
use crate::counts::COUNTS_PER_TURN;
use crate::protocol::{Access, ErrorFlags, REGISTERS, Register};
use std::f64::consts::TAU;

/// Number of addresses.
const ADDRESSES: usize = 96;

/// Properties of a simulated servo. Defaults are published values of the STS3215 at 7.4 V; what a servo does with D and
/// I is not published, and both are without effect by default.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ServoOptions {
    /// Stiffness at P = 32, Nm/rad (SO-ARM100, joints_properties.xml); it is proportional to P.
    pub stiffness_at_32_nm_per_rad: f64,
    /// Damping at D = 32, Nms/rad.
    pub damping_at_32_nms_per_rad: f64,
    /// Integral gain at I = 32, Nm/(rad s).
    pub integral_at_32_nm_per_rad_s: f64,
    /// Largest torque at a torque limit of 1000, Nm (stall torque of the data sheet).
    pub stall_torque_nm: f64,
    /// Motor torque per motor current, Nm/A (`bam`).
    pub torque_per_current_nm_per_a: f64,
    /// Supply voltage at which stiffness, damping and torque are as above, V: they are proportional to it.
    pub voltage_v: f64,
    /// Temperature, °C.
    pub temperature_c: f64,
    /// Count of the sensor at q = 0.
    pub sensor_zero: f64,
    /// True if the servo's positions decrease where q increases.
    pub inverted: bool,
}

impl Default for ServoOptions {
    fn default() -> Self {
        Self {
            stiffness_at_32_nm_per_rad: 17.8,
            damping_at_32_nms_per_rad: 0.0,
            integral_at_32_nm_per_rad_s: 0.0,
            stall_torque_nm: 1.91,
            torque_per_current_nm_per_a: 1.21,
            voltage_v: 7.4,
            temperature_c: 30.0,
            sensor_zero: 2048.0,
            inverted: false,
        }
    }
}

/// A simulated servo of model 777 (STS3215).
#[derive(Clone, Debug)]
pub struct SimulatedServo {
    /// Properties.
    pub options: ServoOptions,
    /// Error flags that a test sets, in addition to those of voltage and temperature.
    pub flags: ErrorFlags,
    /// True if goals are ignored while torque is off.
    pub ignores_goals_without_torque: bool,
    /// Register that keeps its value when it is written, by address: a defect that a test sets.
    pub stuck: Option<u8>,
    /// Supply voltage, V. A bus sets it, whose servos share a supply.
    pub supply_v: f64,
    registers: [u8; ADDRESSES],
    /// Setpoint of the profile to the goal, counts, and its velocity, counts/s.
    setpoint: f64,
    setpoint_velocity: f64,
    integral_nm: f64,
    torque_nm: f64,
    /// Duration of an overload so far, s, and true if the torque is reduced because of one.
    overload_s: f64,
    is_reduced: bool,
}

impl SimulatedServo {
    /// Returns a servo as it comes from the factory, with an identifier.
    #[must_use]
    pub fn new(id: u8, options: ServoOptions) -> Self {
        let mut servo = Self {
            options,
            flags: ErrorFlags::NONE,
            ignores_goals_without_torque: false,
            stuck: None,
            supply_v: options.voltage_v,
            registers: [0; ADDRESSES],
            setpoint: 0.0,
            setpoint_velocity: 0.0,
            integral_nm: 0.0,
            torque_nm: 0.0,
            overload_s: 0.0,
            is_reduced: false,
        };
        for (register, value) in [
            (Register::FIRMWARE_MAJOR_VERSION, 3),
            (Register::FIRMWARE_MINOR_VERSION, 10),
            (Register::MODEL_NUMBER, 777),
            (Register::ID, i32::from(id)),
            (Register::RETURN_DELAY_TIME, 250),
            (Register::RESPONSE_STATUS_LEVEL, 1),
            (Register::MAX_POSITION_LIMIT, 4095),
            (Register::MAX_TEMPERATURE_LIMIT, 70),
            (Register::MAX_VOLTAGE_LIMIT, 80),
            (Register::MIN_VOLTAGE_LIMIT, 40),
            (Register::MAX_TORQUE_LIMIT, 1000),
            (Register::PHASE, 12),
            (Register::P_COEFFICIENT, 32),
            (Register::D_COEFFICIENT, 32),
            (Register::CW_DEAD_ZONE, 1),
            (Register::CCW_DEAD_ZONE, 1),
            (Register::PROTECTION_CURRENT, 500),
            (Register::ANGULAR_RESOLUTION, 1),
            (Register::PROTECTIVE_TORQUE, 20),
            (Register::PROTECTION_TIME, 200),
            (Register::OVERLOAD_TORQUE, 80),
            (Register::TORQUE_LIMIT, 1000),
            (Register::LOCK, 1),
            (Register::GOAL_POSITION, 2048),
        ] {
            servo.set(register, value);
        }
        servo
    }

    /// Returns the servo for a joint of an arm's configuration: its identifier and calibration, and its zero and direction, so that
    /// positions of the simulated joint are those of the arm. It is set as the arm's start expects it.
    #[must_use]
    pub fn calibrated(config: &ServoConfig, options: ServoOptions) -> Self {
        let (calibration, scale) = (config.calibration, config.scale);
        let options = ServoOptions {
            sensor_zero: scale.zero + f64::from(calibration.homing_offset),
            inverted: scale.sign < 0.0,
            ..options
        };
        let mut servo = Self::new(calibration.id, options);
        servo.set(Register::HOMING_OFFSET, calibration.homing_offset);
        servo.set(Register::MIN_POSITION_LIMIT, calibration.range_min);
        servo.set(Register::MAX_POSITION_LIMIT, calibration.range_max);
        servo.set(Register::RETURN_DELAY_TIME, 0);
        servo
    }

    /// Identifier.
    #[must_use]
    pub fn id(&self) -> u8 {
        self.registers[usize::from(Register::ID.address)]
    }

    /// Value of a register.
    #[must_use]
    pub fn get(&self, register: Register) -> i32 {
        register.decode(&self.registers[usize::from(register.address)..]).unwrap_or(0)
    }

    /// Sets a register, also one that is only read; a value out of its range becomes the nearest one.
    pub fn set(&mut self, register: Register, value: i32) {
        let (min, max) = register.range();
        let bytes = register.encode(value.clamp(min, max)).unwrap_or_default();
        let (at, width) = (usize::from(register.address), usize::from(register.width));
        self.registers[at..at + width].copy_from_slice(&bytes[..width]);
    }

    /// Contents of `length` registers from an address on; registers that do not exist are 0.
    pub fn read(&self, address: u8, length: u8) -> impl Iterator<Item = u8> {
        (usize::from(address)..usize::from(address) + usize::from(length))
            .map(|at| self.registers.get(at).copied().unwrap_or(0))
    }

    /// Writes registers from an address on, as a request does: those that are only read keep their values.
    pub fn write(&mut self, address: u8, data: &[u8]) {
        let torque_was_on = self.is_torque_on();
        for (at, byte) in (usize::from(address)..).zip(data) {
            let is_stuck = self.stuck.is_some_and(|stuck| usize::from(stuck) == at);
            let is_goal = at == usize::from(Register::GOAL_POSITION.address)
                || at == usize::from(Register::GOAL_POSITION.address) + 1;
            let is_ignored = is_goal && self.ignores_goals_without_torque && !torque_was_on;
            if is_written(at) && !is_stuck && !is_ignored {
                self.registers[at] = *byte;
            }
        }
        if !torque_was_on && self.is_torque_on() {
            self.switch_on();
        }
    }

    /// Begins to control the motor: the profile begins at the present position.
    fn switch_on(&mut self) {
        self.setpoint = f64::from(self.get(Register::PRESENT_POSITION));
        self.setpoint_velocity = 0.0;
        self.integral_nm = 0.0;
        self.overload_s = 0.0;
        self.is_reduced = false;
    }

    /// Lets the servo hold its joint at `q` (rad) under a torque of the motor (Nm) from the first period on: torque is on,
    /// and the goal is as far from the position as the gain P asks for.
    pub fn hold(&mut self, q: f64, torque_nm: f64) {
        let share = f64::from(self.get(Register::P_COEFFICIENT)) / 32.0;
        let stiffness = share * self.options.stiffness_at_32_nm_per_rad;
        let sign = if self.options.inverted { -1.0 } else { 1.0 };
        let counts_per_rad = f64::from(COUNTS_PER_TURN) / TAU;
        let homing = f64::from(self.get(Register::HOMING_OFFSET));
        let at = |q: f64| {
            let sensor = self.options.sensor_zero + sign * q * counts_per_rad;
            (sensor - homing).round() as i32
        };
        let deflection = if stiffness > 0.0 { torque_nm / stiffness } else { 0.0 };
        let (position, goal) = (at(q), at(q + deflection));
        self.set(Register::PRESENT_POSITION, position);
        self.set(Register::GOAL_POSITION, goal);
        self.set(Register::TORQUE_ENABLE, 1);
        self.switch_on();
        self.setpoint = f64::from(goal);
    }

    /// Current that the servo draws from its supply, A: motor current times duty cycle.
    #[must_use]
    pub fn supply_current_a(&self) -> f64 {
        let torque = self.torque_nm.abs();
        torque / self.options.torque_per_current_nm_per_a * torque / self.options.stall_torque_nm
    }

    /// Returns true if the motor is controlled.
    #[must_use]
    pub fn is_torque_on(&self) -> bool {
        self.get(Register::TORQUE_ENABLE) == 1
    }

    /// Error flags.
    #[must_use]
    pub fn error_flags(&self) -> ErrorFlags {
        let voltage = self.get(Register::PRESENT_VOLTAGE);
        let mut flags = self.flags;
        if self.is_reduced {
            flags = flags | ErrorFlags::OVERLOAD;
        }
        if voltage > self.get(Register::MAX_VOLTAGE_LIMIT) || voltage < self.get(Register::MIN_VOLTAGE_LIMIT)
        {
            flags = flags | ErrorFlags::VOLTAGE;
        }
        if self.get(Register::PRESENT_TEMPERATURE) > self.get(Register::MAX_TEMPERATURE_LIMIT) {
            flags = flags | ErrorFlags::OVERHEAT;
        }
        flags
    }

    /// Measures the joint (rad, rad/s), and computes the motor torque at the joint (Nm) for the next `duration_s` (s).
    pub fn control(&mut self, q: f64, dq: f64, duration_s: f64) -> f64 {
        let sign = if self.options.inverted { -1.0 } else { 1.0 };
        let counts_per_rad = f64::from(COUNTS_PER_TURN) / TAU;
        let homing = f64::from(self.get(Register::HOMING_OFFSET));
        let sensor = (self.options.sensor_zero + sign * q * counts_per_rad).round();
        let present = (sensor - homing).rem_euclid(f64::from(COUNTS_PER_TURN));
        let velocity = (sign * dq * counts_per_rad).round();
        self.advance_setpoint(duration_s);

        let dead_zone = f64::from(self.get(Register::CW_DEAD_ZONE).max(self.get(Register::CCW_DEAD_ZONE)));
        let distance = self.setpoint - present;
        let error_rad = if distance.abs() <= dead_zone { 0.0 } else { distance / counts_per_rad };
        let options = self.options;
        // The law computes the duty cycle of the motor voltage.
        let supply = self.supply_v / options.voltage_v;
        let share = |servo: &Self, register| supply * f64::from(servo.get(register)) / 32.0;
        let reduced =
            if self.is_reduced { f64::from(self.get(Register::PROTECTIVE_TORQUE)) / 100.0 } else { 1.0 };
        let limit = supply
            * options.stall_torque_nm
            * reduced.min(f64::from(self.get(Register::TORQUE_LIMIT)) / 1000.0);
        let integral = self.integral_nm
            + share(self, Register::I_COEFFICIENT)
                * options.integral_at_32_nm_per_rad_s
                * error_rad
                * duration_s;
        self.integral_nm = integral.clamp(-limit, limit);
        let torque = share(self, Register::P_COEFFICIENT) * options.stiffness_at_32_nm_per_rad * error_rad
            - share(self, Register::D_COEFFICIENT) * options.damping_at_32_nms_per_rad * sign * dq
            + self.integral_nm;
        let is_on = self.is_torque_on() && self.get(Register::OPERATING_MODE) == 0;
        self.torque_nm = if is_on { torque.clamp(-limit, limit) } else { 0.0 };
        self.watch_overload(duration_s);

        let current_a = self.torque_nm / options.torque_per_current_nm_per_a;
        let unit = if self.get(Register::PHASE) & 4 == 0 { 50.0 } else { 1.0 };
        for (register, value) in [
            (Register::PRESENT_POSITION, present),
            (Register::PRESENT_VELOCITY, velocity / unit),
            (Register::PRESENT_LOAD, 1000.0 * self.torque_nm / (supply * options.stall_torque_nm)),
            (Register::PRESENT_CURRENT, current_a / 0.0065),
            (Register::PRESENT_VOLTAGE, 10.0 * self.supply_v),
            (Register::PRESENT_TEMPERATURE, options.temperature_c),
        ] {
            self.set(register, value.round() as i32);
        }
        self.set(Register::STATUS, self.error_flags().bits().into());
        self.set(Register::MOVING, i32::from(velocity != 0.0));
        sign * self.torque_nm
    }

    /// Reduces the torque after a load above Overload_Torque for Protection_Time, until torque is switched on again.
    fn watch_overload(&mut self, duration_s: f64) {
        let load =
            self.torque_nm.abs() / (self.supply_v / self.options.voltage_v * self.options.stall_torque_nm);
        let is_overload = 100.0 * load > f64::from(self.get(Register::OVERLOAD_TORQUE));
        self.overload_s = if is_overload { self.overload_s + duration_s } else { 0.0 };
        self.is_reduced |= self.overload_s > 0.01 * f64::from(self.get(Register::PROTECTION_TIME));
    }

    /// Advances the profile to the goal, which lies within the limits of positions.
    fn advance_setpoint(&mut self, duration_s: f64) {
        let (lower, upper) = (self.get(Register::MIN_POSITION_LIMIT), self.get(Register::MAX_POSITION_LIMIT));
        let goal = f64::from(self.get(Register::GOAL_POSITION).clamp(lower, upper.max(lower)));
        self.set(Register::GOAL_POSITION_2, goal as i32);
        if !self.is_torque_on() {
            return;
        }
        let phase = self.get(Register::PHASE);
        let unit = if phase & 4 == 0 { 50.0 } else { 1.0 };
        let goal_velocity = f64::from(self.get(Register::GOAL_VELOCITY).abs()) * unit;
        let is_unlimited = goal_velocity == 0.0 && phase & 8 != 0;
        let velocity_limit = if is_unlimited { f64::INFINITY } else { goal_velocity };
        let acceleration = f64::from(self.get(Register::ACCELERATION)) * 100.0;
        let distance = goal - self.setpoint;
        let mut velocity = distance / duration_s;
        if acceleration > 0.0 {
            // The velocity from which it can still stop at the goal.
            let braking = (2.0 * acceleration * distance.abs()).sqrt();
            let change = acceleration * duration_s;
            velocity = velocity
                .clamp(-braking, braking)
                .clamp(self.setpoint_velocity - change, self.setpoint_velocity + change);
        }
        velocity = velocity.clamp(-velocity_limit, velocity_limit);
        self.setpoint_velocity = velocity;
        self.setpoint += velocity * duration_s;
    }
}

/// Returns true if a request changes the byte at this address.
fn is_written(address: usize) -> bool {
    REGISTERS.iter().any(|register| {
        let first = usize::from(register.address);
        (first..first + usize::from(register.width)).contains(&address) && register.access != Access::Read
    })
}

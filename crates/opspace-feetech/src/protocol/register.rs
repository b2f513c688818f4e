//! Registers of servos of the series STS and SMS, such as the STS3215.
//!
//! Names and addresses are those of LeRobot's table; units are those of Feetech's tables of registers. Negative numbers are
//! stored as a magnitude with a sign bit, whose place differs between registers.

/// A register of one or two bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Register {
    /// Name, as in LeRobot's table.
    pub name: &'static str,
    /// Address of the low byte.
    pub address: u8,
    /// Width: 1 or 2 bytes.
    pub width: u8,
    /// Number of the bit that is set if the value is negative; `None` if the register has no sign.
    pub sign_bit: Option<u8>,
    /// Access.
    pub access: Access,
    /// Unit of the value; empty if it has none.
    pub unit: &'static str,
}

/// Access to a register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Only read.
    Read,
    /// Read and written; lost when power is switched off.
    Volatile,
    /// Read and written; stored, unless register Lock is 1.
    Stored,
}

/// A value that a register cannot contain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("register {} takes {min} to {max}, not {value}", register.name)]
pub struct OutOfRange {
    /// Register.
    pub register: Register,
    /// Smallest value.
    pub min: i32,
    /// Largest value.
    pub max: i32,
    /// Value that was to be written.
    pub value: i32,
}

impl Register {
    /// Returns the value in the first bytes of a slice; `None` if it is shorter than the register.
    #[must_use]
    pub fn decode(&self, bytes: &[u8]) -> Option<i32> {
        let raw = match (self.width, bytes) {
            (1, [low, ..]) => i32::from(*low),
            (2, [low, high, ..]) => i32::from(u16::from_le_bytes([*low, *high])),
            _ => return None,
        };
        Some(match self.sign_bit {
            Some(bit) => {
                let magnitude = raw & ((1 << bit) - 1);
                if raw >> bit & 1 == 1 { -magnitude } else { magnitude }
            }
            None => raw,
        })
    }

    /// Returns the value in bytes that were read from an address on; `None` if they do not contain the register.
    #[must_use]
    pub fn decode_in(&self, bytes: &[u8], address: u8) -> Option<i32> {
        let offset = self.address.checked_sub(address)?;
        self.decode(bytes.get(usize::from(offset)..)?)
    }

    /// Smallest and largest value.
    #[must_use]
    pub fn range(&self) -> (i32, i32) {
        match self.sign_bit {
            Some(bit) => (1 - (1 << bit), (1 << bit) - 1),
            None => (0, if self.width == 1 { 0xFF } else { 0xFFFF }),
        }
    }

    /// Returns the bytes of a value; of a register of one byte the first is used.
    ///
    /// # Errors
    /// If the register cannot contain the value.
    pub fn encode(&self, value: i32) -> Result<[u8; 2], OutOfRange> {
        let (min, max) = self.range();
        if value < min || value > max {
            return Err(OutOfRange { register: *self, min, max, value });
        }
        let sign = self.sign_bit.map_or(0, |bit| u16::from(value < 0) << bit);
        // Within 16 bits: it is in the range.
        let magnitude = u16::try_from(value.unsigned_abs()).unwrap_or(u16::MAX);
        Ok((magnitude | sign).to_le_bytes())
    }

    /// Returns the register with this name.
    #[must_use]
    pub fn named(name: &str) -> Option<&'static Self> {
        REGISTERS.iter().find(|register| register.name == name)
    }
}

/// Defines the registers as constants, and their table.
macro_rules! registers {
    ($($(#[$doc:meta])* $constant:ident = $name:literal, $address:literal, $width:literal, $sign:expr, $access:ident, $unit:literal;)*) => {
        impl Register {
            $($(#[$doc])* pub const $constant: Self = Self {
                name: $name, address: $address, width: $width, sign_bit: $sign, access: Access::$access, unit: $unit,
            };)*
        }

        /// All registers, by address.
        pub const REGISTERS: &[Register] = &[$(Register::$constant),*];
    };
}

registers! {
    /// Major number of the firmware's version.
    FIRMWARE_MAJOR_VERSION = "Firmware_Major_Version", 0, 1, None, Read, "";
    /// Minor number of the firmware's version.
    FIRMWARE_MINOR_VERSION = "Firmware_Minor_Version", 1, 1, None, Read, "";
    /// Number of the servo model; 777 is the STS3215.
    MODEL_NUMBER = "Model_Number", 3, 2, None, Read, "";
    /// Identifier on the bus.
    ID = "ID", 5, 1, None, Stored, "";
    /// Code of the baud rate; 0 is 1 MHz.
    BAUD_RATE = "Baud_Rate", 6, 1, None, Stored, "";
    /// Delay of answers.
    RETURN_DELAY_TIME = "Return_Delay_Time", 7, 1, None, Stored, "2 µs";
    /// Requests that are answered: 0, reads and pings; 1, all to one servo.
    RESPONSE_STATUS_LEVEL = "Response_Status_Level", 8, 1, None, Stored, "";
    /// Smallest goal position.
    MIN_POSITION_LIMIT = "Min_Position_Limit", 9, 2, None, Stored, "count";
    /// Largest goal position.
    MAX_POSITION_LIMIT = "Max_Position_Limit", 11, 2, None, Stored, "count";
    /// Temperature above which the overheat flag is set.
    MAX_TEMPERATURE_LIMIT = "Max_Temperature_Limit", 13, 1, None, Stored, "°C";
    /// Supply voltage above which the voltage flag is set.
    MAX_VOLTAGE_LIMIT = "Max_Voltage_Limit", 14, 1, None, Stored, "0.1 V";
    /// Supply voltage below which the voltage flag is set.
    MIN_VOLTAGE_LIMIT = "Min_Voltage_Limit", 15, 1, None, Stored, "0.1 V";
    /// Torque limit after power is switched on.
    MAX_TORQUE_LIMIT = "Max_Torque_Limit", 16, 2, None, Stored, "0.1 %";
    /// Bits: 2, unit of velocities (0: 50 counts/s, 1: 1 count/s); 3, meaning of the goal velocity 0 (0: stop, 1: no limit); 5, no current feedback.
    PHASE = "Phase", 18, 1, None, Stored, "";
    /// Errors at which the servo reduces or switches off its torque.
    UNLOADING_CONDITION = "Unloading_Condition", 19, 1, None, Stored, "";
    /// Errors at which the light flashes.
    LED_ALARM_CONDITION = "LED_Alarm_Condition", 20, 1, None, Stored, "";
    /// Proportional gain of the position servo.
    P_COEFFICIENT = "P_Coefficient", 21, 1, None, Stored, "";
    /// Derivative gain of the position servo.
    D_COEFFICIENT = "D_Coefficient", 22, 1, None, Stored, "";
    /// Integral gain of the position servo.
    I_COEFFICIENT = "I_Coefficient", 23, 1, None, Stored, "";
    /// Smallest output of the position servo.
    MINIMUM_STARTUP_FORCE = "Minimum_Startup_Force", 24, 2, None, Stored, "0.1 %";
    /// Dead zone clockwise.
    CW_DEAD_ZONE = "CW_Dead_Zone", 26, 1, None, Stored, "count";
    /// Dead zone counter-clockwise.
    CCW_DEAD_ZONE = "CCW_Dead_Zone", 27, 1, None, Stored, "count";
    /// Current above which the overcurrent flag is set.
    PROTECTION_CURRENT = "Protection_Current", 28, 2, None, Stored, "6.5 mA";
    /// Factor of the resolution of positions.
    ANGULAR_RESOLUTION = "Angular_Resolution", 30, 1, None, Stored, "";
    /// Present position of the sensor at which the servo's position is 0.
    HOMING_OFFSET = "Homing_Offset", 31, 2, Some(11), Stored, "count";
    /// 0: position; 1: velocity; 2: PWM; 3: steps.
    OPERATING_MODE = "Operating_Mode", 33, 1, None, Stored, "";
    /// Torque limit after an overload.
    PROTECTIVE_TORQUE = "Protective_Torque", 34, 1, None, Stored, "1 %";
    /// Duration after which an overload is found.
    PROTECTION_TIME = "Protection_Time", 35, 1, None, Stored, "10 ms";
    /// Load that is an overload.
    OVERLOAD_TORQUE = "Overload_Torque", 36, 1, None, Stored, "1 %";
    /// Proportional gain of the velocity servo.
    VELOCITY_P_COEFFICIENT = "Velocity_closed_loop_P_proportional_coefficient", 37, 1, None, Stored, "";
    /// Duration after which an overcurrent is found.
    OVER_CURRENT_PROTECTION_TIME = "Over_Current_Protection_Time", 38, 1, None, Stored, "10 ms";
    /// Integral gain of the velocity servo.
    VELOCITY_I_COEFFICIENT = "Velocity_closed_loop_I_integral_coefficient", 39, 1, None, Stored, "";
    /// 0: torque off; 1: torque on.
    TORQUE_ENABLE = "Torque_Enable", 40, 1, None, Volatile, "";
    /// Acceleration of the profile to the goal position; 0 is no limit.
    ACCELERATION = "Acceleration", 41, 1, None, Volatile, "100 count/s²";
    /// Goal position.
    GOAL_POSITION = "Goal_Position", 42, 2, Some(15), Volatile, "count";
    /// Duration of the motion; not used by position servos of this series.
    GOAL_TIME = "Goal_Time", 44, 2, None, Volatile, "";
    /// Velocity of the profile to the goal position, in the unit that Phase declares.
    GOAL_VELOCITY = "Goal_Velocity", 46, 2, Some(15), Volatile, "count/s";
    /// Torque limit.
    TORQUE_LIMIT = "Torque_Limit", 48, 2, None, Volatile, "0.1 %";
    /// 1: values written to stored registers act until power is switched off; 0: they are stored.
    LOCK = "Lock", 55, 1, None, Volatile, "";
    /// Position: that of the sensor less Homing_Offset.
    PRESENT_POSITION = "Present_Position", 56, 2, Some(15), Read, "count";
    /// Velocity, in the unit that Phase declares.
    PRESENT_VELOCITY = "Present_Velocity", 58, 2, Some(15), Read, "count/s";
    /// Duty cycle of the motor voltage.
    PRESENT_LOAD = "Present_Load", 60, 2, Some(10), Read, "0.1 %";
    /// Supply voltage.
    PRESENT_VOLTAGE = "Present_Voltage", 62, 1, None, Read, "0.1 V";
    /// Temperature.
    PRESENT_TEMPERATURE = "Present_Temperature", 63, 1, None, Read, "°C";
    /// Error flags.
    STATUS = "Status", 65, 1, None, Read, "";
    /// 1 while the servo moves to its goal.
    MOVING = "Moving", 66, 1, None, Read, "";
    /// Motor current.
    PRESENT_CURRENT = "Present_Current", 69, 2, Some(15), Read, "6.5 mA";
    /// Goal position in effect.
    GOAL_POSITION_2 = "Goal_Position_2", 71, 2, None, Read, "count";
    /// Velocity above which Moving is 1.
    MOVING_VELOCITY_THRESHOLD = "Moving_Velocity_Threshold", 80, 1, None, Stored, "";
    /// Largest goal velocity.
    MAXIMUM_VELOCITY_LIMIT = "Maximum_Velocity_Limit", 84, 1, None, Stored, "50 count/s";
    /// Largest acceleration.
    MAXIMUM_ACCELERATION = "Maximum_Acceleration", 85, 1, None, Stored, "100 count/s²";
}

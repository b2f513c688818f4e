//! Nominal position and velocity servos of drives, which a transformer inverts.
//!
//! A [`ServoLaw`](crate::servo_law::ServoLaw) computes the torque of each servo at every servo tick.

use crate::polynomial::value;
use nalgebra::Complex;
use opspace_backend::CommandKind;
use opspace_backend::quantity::{Fraction, NonNegative, Positive};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Servo of a joint.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
#[non_exhaustive]
pub enum ServoParameters {
    /// Position loop around a velocity loop.
    Cascaded(CascadedServo),
    /// Single loop: proportional, derivative, and optionally integral.
    Pid(PidServo),
    /// Any other linear servo: torque over position error.
    TransferFunction(TransferFunctionServo),
    /// Velocity loop, for a robot that accepts velocities.
    Velocity(VelocityServo),
}

/// Equation (K9) of the paper: `τ = kv [kp (q_desired − q) − q̇]`; optionally with an integral in the velocity loop.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(transform = crate::optional_keys::with_optional_keys))]
#[serde(deny_unknown_fields)]
pub struct CascadedServo {
    /// Gain of the outer position loop, 1/s.
    pub kp_per_s: Positive,
    /// Gain of the inner velocity loop, Nms/rad (Ns/m).
    pub kv_nms_per_rad: Positive,
    /// Cut-off frequency of the servo's low-pass filter on its finite-difference velocity, Hz.
    pub velocity_filter_hz: Positive,
    /// Integral time of the velocity loop, s; no integral if absent.
    pub velocity_integral_time_s: Option<Positive>,
    /// Fraction of the setpoint's velocity that is fed forward to the velocity loop: `velocity_feed_forward (q_desired −
    /// q_desired₋)/Ts` is added to its setpoint, with q_desired₋ of the servo tick before.
    #[serde(default)]
    pub velocity_feed_forward: Fraction,
    /// Torque fed forward per acceleration of the setpoint (its second difference divided by Ts²), kg m² (kg).
    #[serde(default)]
    pub acceleration_feed_forward_kg_m2: NonNegative,
    /// Filter of the setpoint at servo rate, before the loop and the feed-forward; none if absent.
    pub setpoint_filter: Option<SetpointFilter>,
}

/// `τ = K e + D ė + Ki ∫ e`, with e = q_desired − q, and ė or −q̇ from a filtered finite difference.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(transform = crate::optional_keys::with_optional_keys))]
#[serde(deny_unknown_fields)]
pub struct PidServo {
    /// Stiffness K, Nm/rad (N/m).
    pub stiffness_nm_per_rad: Positive,
    /// Damping D, Nms/rad (Ns/m).
    pub damping_nms_per_rad: NonNegative,
    /// Cut-off frequency of the low-pass filter on the finite difference, Hz.
    pub derivative_filter_hz: Positive,
    /// Differentiated quantity.
    #[serde(default)]
    pub derivative_of: DerivativeOf,
    /// Integral gain Ki, Nm/(rad s) (N/(m s)).
    #[serde(default)]
    pub integral_nm_per_rad_s: NonNegative,
    /// Fraction of the setpoint's velocity that is fed forward: the torque `D velocity_feed_forward (q_desired −
    /// q_desired₋)/Ts` is added, with q_desired₋ of the servo tick before. Zero with the derivative of the error.
    #[serde(default)]
    pub velocity_feed_forward: Fraction,
    /// Torque fed forward per acceleration of the setpoint (its second difference divided by Ts²), kg m² (kg).
    #[serde(default)]
    pub acceleration_feed_forward_kg_m2: NonNegative,
    /// Filter of the setpoint at servo rate, before the loop and the feed-forward; none if absent.
    pub setpoint_filter: Option<SetpointFilter>,
}

/// Filter of a drive's setpoint. Low-pass filters are exact for setpoints that are constant over each servo period; their output
/// at a servo tick is the value at the end of the period that begins there.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
#[non_exhaustive]
pub enum SetpointFilter {
    /// `ω/(s + ω)`, with ω = 2π `cutoff_hz`.
    FirstOrder {
        /// Cut-off frequency (−3 dB), Hz.
        cutoff_hz: Positive,
    },
    /// `ω²/(s² + 2 ζ ω s + ω²)`, with ω = 2π `natural_frequency_hz` and ζ = `damping_ratio`.
    SecondOrder {
        /// Natural frequency, Hz.
        natural_frequency_hz: Positive,
        /// Damping ratio; 1 is critical.
        damping_ratio: Positive,
    },
    /// Mean of the setpoints of the last `time_s`, and of these means over `second_time_s`: what drives call jerk time or
    /// smoothing time. A step of the setpoint's velocity becomes an acceleration that is constant for `time_s`, or, with a second
    /// average, one that rises and falls with a bounded jerk. Both times are rounded to servo periods, at least one.
    MovingAverage {
        /// Time over which setpoints are averaged, s.
        time_s: Positive,
        /// Time over which the averages are averaged again, s; once only if absent.
        second_time_s: Option<Positive>,
    },
}

impl SetpointFilter {
    /// Time by which the output lags behind a setpoint of constant velocity, s.
    fn lag_s(&self) -> f64 {
        match self {
            Self::FirstOrder { cutoff_hz } => 1.0 / (TAU * cutoff_hz.get()),
            Self::SecondOrder { natural_frequency_hz, damping_ratio } => {
                2.0 * damping_ratio.get() / (TAU * natural_frequency_hz.get())
            }
            Self::MovingAverage { time_s, second_time_s } => {
                0.5 * (time_s.get() + second_time_s.map_or(0.0, Positive::get))
            }
        }
    }

    /// True if the filter's output is no state of the servo's law: a moving average, which precedes it.
    pub(crate) fn precedes_law(&self) -> bool {
        matches!(self, Self::MovingAverage { .. })
    }
}

/// `τ = kv (q̇_desired − q̇) + ki ∫ (q̇_desired − q̇)`, with q̇ from a filtered finite difference.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(transform = crate::optional_keys::with_optional_keys))]
#[serde(deny_unknown_fields)]
pub struct VelocityServo {
    /// Gain kv on the velocity error, Nms/rad (Ns/m).
    pub kv_nms_per_rad: Positive,
    /// Gain ki on the integral of the velocity error, Nm/rad (N/m).
    #[serde(default)]
    pub ki_nm_per_rad: NonNegative,
    /// Cut-off frequency of the low-pass filter on the finite difference, Hz.
    pub velocity_filter_hz: Positive,
}

/// Differentiated quantity of a PID servo.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum DerivativeOf {
    /// Measured position: a step of the setpoint causes no derivative kick.
    #[default]
    Position,
    /// Position error.
    Error,
}

/// Torque (Nm, N) over position error (rad, m) at servo rate:
/// `(b₀ + b₁ z⁻¹ + …)/(a₀ + a₁ z⁻¹ + …)`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct TransferFunctionServo {
    /// b₀, b₁, …
    pub numerator: Vec<f64>,
    /// a₀, a₁, …
    pub denominator: Vec<f64>,
}

/// Equivalent gains of a servo; integral, filters and delays are neglected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ServoGains {
    /// Torque per position error, Nm/rad (N/m): `kv kp` of a cascade. Zero for a velocity servo, which has no position
    /// setpoint; check [`ServoParameters::takes`] before dividing by it.
    pub stiffness: f64,
    /// Torque per velocity, opposing it, Nms/rad (Ns/m): `kv` of a cascade and of a velocity servo.
    pub damping: f64,
}

impl ServoGains {
    /// Gain of the position loop around the velocity loop, 1/s: `kp` of a cascade, zero for a velocity servo.
    #[must_use]
    pub fn position_loop(&self) -> f64 {
        self.stiffness / self.damping
    }
}

impl CascadedServo {
    /// Returns a cascade without an integral, feed-forward or setpoint filter.
    #[must_use]
    pub const fn new(kp_per_s: Positive, kv_nms_per_rad: Positive, velocity_filter_hz: Positive) -> Self {
        Self {
            kp_per_s,
            kv_nms_per_rad,
            velocity_filter_hz,
            velocity_integral_time_s: None,
            velocity_feed_forward: Fraction::literal(0.0),
            acceleration_feed_forward_kg_m2: NonNegative::literal(0.0),
            setpoint_filter: None,
        }
    }
}

/// Frequency, as a fraction of the servo rate, at which the gains of a transfer function are evaluated: above most
/// integrals, below most filters.
const GAINS_AT: f64 = 0.01;

impl ServoParameters {
    /// Quantity of its setpoint: position, or velocity.
    #[must_use]
    pub fn takes(&self) -> CommandKind {
        match self {
            Self::Cascaded(_) | Self::Pid(_) | Self::TransferFunction(_) => CommandKind::Position,
            Self::Velocity(_) => CommandKind::Velocity,
        }
    }

    /// Equivalent gains of a servo that runs every `period_s` (s). Those of a transfer function are evaluated at a
    /// hundredth of the servo rate. The stiffness of a velocity servo is zero.
    #[must_use]
    pub fn gains(&self, period_s: f64) -> ServoGains {
        match self {
            Self::Cascaded(servo) => {
                let damping = servo.kv_nms_per_rad.get();
                ServoGains { stiffness: damping * servo.kp_per_s.get(), damping }
            }
            Self::Pid(servo) => ServoGains {
                stiffness: servo.stiffness_nm_per_rad.get(),
                damping: servo.damping_nms_per_rad.get(),
            },
            Self::TransferFunction(servo) => {
                let delay = Complex::from_polar(1.0, -TAU * GAINS_AT);
                let value = servo.at(delay);
                ServoGains {
                    stiffness: value.re.abs(),
                    damping: (value.im * period_s / (TAU * GAINS_AT)).abs(),
                }
            }
            Self::Velocity(servo) => ServoGains { stiffness: 0.0, damping: servo.kv_nms_per_rad.get() },
        }
    }

    /// True if the servo consists of these two gains only: stiffness on the position error, and damping on the filtered
    /// velocity, or on its difference from a fraction of the setpoint's velocity. The setpoint may be a moving average.
    #[must_use]
    pub fn has_two_gains(&self) -> bool {
        match self {
            Self::Cascaded(servo) => {
                servo.velocity_integral_time_s.is_none()
                    && servo.acceleration_feed_forward_kg_m2.get() == 0.0
                    && !self.filters_within_law()
            }
            Self::Pid(servo) => {
                servo.integral_nm_per_rad_s.get() == 0.0
                    && servo.derivative_of == DerivativeOf::Position
                    && servo.damping_nms_per_rad.get() > 0.0
                    && servo.acceleration_feed_forward_kg_m2.get() == 0.0
                    && !self.filters_within_law()
            }
            Self::TransferFunction(_) | Self::Velocity(_) => false,
        }
    }

    fn filters_within_law(&self) -> bool {
        self.setpoint_filter().is_some_and(|filter| !filter.precedes_law())
    }

    /// Fraction of the setpoint's velocity that is fed forward; 0 for a transfer function and a velocity servo.
    #[must_use]
    pub fn velocity_feed_forward(&self) -> f64 {
        match self {
            Self::Cascaded(servo) => servo.velocity_feed_forward.get(),
            Self::Pid(servo) => servo.velocity_feed_forward.get(),
            Self::TransferFunction(_) | Self::Velocity(_) => 0.0,
        }
    }

    /// Torque fed forward per acceleration of the setpoint, kg m² (kg); 0 for a transfer function and a velocity servo.
    #[must_use]
    pub fn acceleration_feed_forward_kg_m2(&self) -> f64 {
        match self {
            Self::Cascaded(servo) => servo.acceleration_feed_forward_kg_m2.get(),
            Self::Pid(servo) => servo.acceleration_feed_forward_kg_m2.get(),
            Self::TransferFunction(_) | Self::Velocity(_) => 0.0,
        }
    }

    /// Filter of the setpoint, if any.
    #[must_use]
    pub fn setpoint_filter(&self) -> Option<SetpointFilter> {
        match self {
            Self::Cascaded(servo) => servo.setpoint_filter,
            Self::Pid(servo) => servo.setpoint_filter,
            Self::TransferFunction(_) | Self::Velocity(_) => None,
        }
    }

    /// Time by which the setpoint for a constant torque leads a joint of constant velocity, s: `1/kp` of a cascade, less what
    /// is fed forward, and the lag of the setpoint's filter. Zero for a transfer function and a velocity servo.
    #[must_use]
    pub fn setpoint_lead_s(&self) -> f64 {
        let of_velocity_s = match self {
            Self::Cascaded(servo) => 1.0 / servo.kp_per_s.get(),
            Self::Pid(servo) if servo.derivative_of == DerivativeOf::Position => {
                servo.damping_nms_per_rad.get() / servo.stiffness_nm_per_rad.get()
            }
            Self::Pid(_) | Self::TransferFunction(_) | Self::Velocity(_) => 0.0,
        };
        let lag_s = self.setpoint_filter().map_or(0.0, |filter| filter.lag_s());
        (1.0 - self.velocity_feed_forward()) * of_velocity_s + lag_s
    }

    /// True if the setpoint acts on the position error only, and unfiltered: no feed-forward and no setpoint filter.
    #[must_use]
    pub fn has_plain_setpoint(&self) -> bool {
        self.velocity_feed_forward() == 0.0
            && self.acceleration_feed_forward_kg_m2() == 0.0
            && self.setpoint_filter().is_none()
    }

    /// Returns this servo with the gain of its position loop multiplied by `kp` and the gain of the whole servo
    /// multiplied by `kv`. A velocity servo has no position loop and ignores `kp`. The acceleration feed-forward is
    /// unchanged.
    #[must_use]
    pub fn scaled(&self, kp: f64, kv: f64) -> Self {
        let times = |value: Positive, scale: f64| Positive::try_from(value.get() * scale).unwrap_or(value);
        let or_zero =
            |value: NonNegative, scale: f64| NonNegative::try_from(value.get() * scale).unwrap_or(value);
        match self {
            Self::Cascaded(servo) => Self::Cascaded(CascadedServo {
                kp_per_s: times(servo.kp_per_s, kp),
                kv_nms_per_rad: times(servo.kv_nms_per_rad, kv),
                ..*servo
            }),
            Self::Pid(servo) => Self::Pid(PidServo {
                stiffness_nm_per_rad: times(servo.stiffness_nm_per_rad, kp * kv),
                damping_nms_per_rad: or_zero(servo.damping_nms_per_rad, kv),
                integral_nm_per_rad_s: or_zero(servo.integral_nm_per_rad_s, kp * kv),
                ..*servo
            }),
            Self::TransferFunction(servo) => Self::TransferFunction(TransferFunctionServo {
                numerator: servo.numerator.iter().map(|b| b * kp * kv).collect(),
                denominator: servo.denominator.clone(),
            }),
            Self::Velocity(servo) => Self::Velocity(VelocityServo {
                kv_nms_per_rad: times(servo.kv_nms_per_rad, kv),
                ki_nm_per_rad: or_zero(servo.ki_nm_per_rad, kv),
                ..*servo
            }),
        }
    }
}

impl TransferFunctionServo {
    /// Value of the transfer function for `delay` = z⁻¹.
    fn at(&self, delay: Complex<f64>) -> Complex<f64> {
        value(&self.numerator, delay) / value(&self.denominator, delay)
    }
}

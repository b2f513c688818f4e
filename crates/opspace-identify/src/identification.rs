//! Result of an identification, and its parameters.

use crate::background::Background;
use crate::confidence::ServoIntervals;
use crate::friction::{ConstantVelocityRun, Friction};
use crate::gains;
use crate::gains::PathComparison;
use crate::interval::{Drive, Interval, Rates, Responses, SetpointFilterModel};
use crate::load::Gear;
use crate::response::{Distortion, Point};
use crate::session::AbortReason;
use crate::static_identification::{Evaluation, StaticServo};
use crate::transfer_function::DelayedTransferFunction;
use nalgebra::Complex;
use opspace_backend::Setpoints;
use serde::Serialize;
use std::f64::consts::TAU;
use thiserror::Error;

/// Parameters of a joint that are known before its identification.
#[derive(Clone, Debug)]
pub struct KnownParameters {
    /// Index of the joint in the robot's order.
    pub joint: usize,
    /// Time between two servo ticks, s.
    pub servo_period_s: f64,
    /// Servo ticks per interface cycle.
    pub servo_ticks_per_cycle: u32,
    /// Behaviour of the drive between two setpoints: hold or interpolate.
    pub setpoints: Setpoints,
    /// Lower position limit, rad (m).
    pub lower: f64,
    /// Upper position limit, rad (m).
    pub upper: f64,
    /// Speed limit, rad/s (m/s).
    pub speed_limit: f64,
    /// Torque limit, Nm (N).
    pub torque_limit: f64,
    /// Resolution of the joint position, one encoder count, rad (m).
    pub resolution: f64,
    /// Inertia in the initial position from URDF and rotor, kg m² (kg), with the other joints free and with them held;
    /// `None` if the rotor inertia is unknown.
    pub inertia: Option<[f64; 2]>,
    /// Viscous friction, Nms/rad (Ns/m); 0 if unknown. It is used if motor torque is not measured, because motion does not
    /// distinguish it from the gain kv.
    pub viscous_friction: f64,
}

impl KnownParameters {
    pub(crate) fn rates(&self, delay: u32) -> Rates {
        let Self { servo_period_s, servo_ticks_per_cycle: ratio, setpoints, .. } = *self;
        Rates { servo_period_s, servo_ticks_per_cycle: ratio, delay, setpoints }
    }
}

/// Parameters of the excitation of a joint.
#[derive(Clone, Debug)]
pub struct ExcitationPlan {
    /// Period of the multisines, s: the inverse of the distance between two lines.
    pub period_s: f64,
    /// Number of periods evaluated in each realisation; one more precedes them, in which the response settles.
    pub periods: usize,
    /// Number of realisations at each amplitude, each with its own phases.
    pub realisations: usize,
    /// Amplitudes as fractions of the largest safe one.
    pub amplitudes: Vec<f64>,
    /// Number of lines per decade.
    pub lines_per_decade: f64,
    /// Number of speeds at which friction is measured.
    pub speeds: usize,
    /// Largest number of times that as many speeds are added, if they do not separate Coulomb and viscous friction.
    pub extra_rounds: u32,
    /// Seed of the phases.
    pub seed: u64,
}

impl Default for ExcitationPlan {
    fn default() -> Self {
        Self {
            period_s: 2.0,
            periods: 2,
            realisations: 2,
            amplitudes: vec![1.0, 0.4],
            lines_per_decade: 14.0,
            speeds: 8,
            extra_rounds: 2,
            seed: 1,
        }
    }
}

/// Smallest coherence and largest relative error of a frequency within the bandwidth of the fit.
pub(crate) const COHERENT: f64 = 0.95;
const CLOSE: f64 = 0.10;

/// Source of the scale of torque.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum TorqueScale {
    /// Motor current.
    MotorCurrent,
    /// Inertia from URDF and rotor.
    Urdf,
    /// Gravity with the masses of the URDF.
    Gravity,
    /// None: kv, inertia and friction are only known as ratios to the inertia.
    Unknown,
}

/// Reason why the servo of a joint cannot be inverted. The subject of each message is the joint.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum IdentificationFailure {
    /// Largest motion within the limits that the encoder resolves too coarsely.
    #[error(
        "within the limits of its speed, torque and range it can be excited by only {reached:.2e} rad (m) rms; its encoder \
         needs {least:.2e} rad (m), twenty times its resolution"
    )]
    NoRoom {
        /// Amplitude reached, rms, rad (m).
        reached: f64,
        /// Smallest amplitude that the encoder resolves finely enough, rad (m).
        least: f64,
    },
    /// Joint that does not follow its setpoints.
    #[error(
        "it does not follow its setpoints: at {hz:.1} Hz the ratio of position to setpoint is {gain:.2}; is it locked, braked or in contact?"
    )]
    DoesNotFollow {
        /// Frequency, Hz.
        hz: f64,
        /// Gain |T| at that frequency.
        gain: f64,
    },
    /// Response without a dominant linear part.
    #[error("{:.0} % of its response to the setpoints is nonlinear", 100.0 * distortion)]
    NotLinear {
        /// Ratio of the rms outside the excited lines to the rms at them.
        distortion: f64,
    },
    /// Responses that no gains fit.
    #[error("no cascaded servo fits its response: the best fit has an error of {:.1} % (allowed: {:.1} %)", 100.0 * error, 100.0 * allowed)]
    NotExplained {
        /// Relative rms error of the fit.
        error: f64,
        /// Largest allowed relative rms error.
        allowed: f64,
    },
    /// Inertia identified with the motor current that is not that of URDF and rotor.
    #[error(
        "the inertia that its motor current and its motion show is {ratio:.2} times that of URDF and rotor: the torque \
         constant of the current, the inertia of its links, or the rotor inertia is wrong, and gains and friction may be \
         wrong by the same factor"
    )]
    WrongScale {
        /// Identified inertia over the nearest one between that with the other joints free and held.
        ratio: f64,
    },
    /// Responses that do not determine the gains.
    #[error("its responses do not identify a servo; check that torque and position are synchronised")]
    Undetermined,
    /// Motion that was aborted.
    #[error("its motion was aborted: {0}")]
    Stopped(AbortReason),
}

/// Fit quality of an identified servo.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct FitQuality {
    /// Highest frequency up to which coherence and fit are good, Hz: the fit of the torque if it was measured,
    /// otherwise of T.
    pub bandwidth_hz: f64,
    /// Relative rms error of the modelled T.
    pub position_residual: f64,
    /// Relative rms error of the modelled torque; `None` if torque was not measured.
    pub torque_residual: Option<f64>,
    /// Relative standard deviations of kp and kv.
    pub deviation: [f64; 2],
    /// Comparison of the paths of the setpoint that were tried.
    pub setpoint_paths: Vec<PathComparison>,
    /// Ratio of the cost with the second-best delay to the cost with the best one.
    pub delay_margin: f64,
    /// Ratio of identified inertia to that of URDF and rotor; `None` if one of them is missing.
    pub inertia_over_urdf: Option<f64>,
}

/// Identified servo of a joint. If the scale of torque is unknown, torques are divided by the inertia.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct Servo {
    /// Position gain, 1/s.
    pub kp: f64,
    /// Velocity gain, Nms/rad (Ns/m), or 1/s if divided by the inertia.
    pub kv: f64,
    /// Cut-off of the velocity filter, Hz.
    pub velocity_filter_hz: f64,
    /// Delay of setpoints, servo ticks.
    pub delay: u32,
    /// Bandwidth of the current loop, Hz; `None` if torque was not measured.
    pub current_loop_hz: Option<f64>,
    /// Inertia that the drive moves, including the rotor, kg m² (kg), or 1 if the scale of torque is unknown.
    pub inertia: f64,
    /// Fraction of the setpoint's velocity that the servo feeds forward; 0 if the responses show none.
    pub velocity_feed_forward: f64,
    /// Filter of the setpoint, if the responses show one.
    pub setpoint_filter: SetpointFilterModel,
    /// Elastic gear, if motor current is measured and shows one.
    pub gear: Option<Gear>,
    /// Friction of the joint, Nm (N), or rad/s² (m/s²) if divided by the inertia.
    pub friction: Option<Friction>,
    /// 95 % intervals of these estimates.
    pub intervals: ServoIntervals,
    /// Runs from which friction is identified.
    pub passes: Vec<ConstantVelocityRun>,
}

/// Measurements at one amplitude.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct Measured {
    /// Rms of the setpoint's offset, rad (m).
    pub rms: f64,
    /// Rms of the joint's velocity, rad/s (m/s).
    pub speed: f64,
    /// Response T of position to setpoint.
    pub position: Vec<Point>,
    /// Response of mean torque to setpoint, Nm/rad (N/m), if measured.
    pub torque: Option<Vec<Point>>,
    /// Distortion of the position.
    pub distortion: Distortion,
    /// Responses at the lines that are not excited, if torque is measured.
    #[serde(skip)]
    pub(crate) background: Option<Background>,
}

/// Result of the identification of a joint, successful or not.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct Identification {
    /// Source of the scale of torque.
    pub scale: TorqueScale,
    /// Measurements at each amplitude, the largest first.
    pub measured: Vec<Measured>,
    /// Identified servo; for information only if [`refused`](Self::refused) gives a reason.
    pub servo: Option<Servo>,
    /// Servo that was identified statically, for information only if [`refused`](Self::refused) gives a reason; `None` with
    /// the other method.
    pub static_servo: Option<StaticServo>,
    /// Viscous friction equivalent to the joint's friction at the largest amplitude, in the servo's units.
    pub equivalent_friction: f64,
    /// T as a rational function in series with hold and delay.
    pub rational: Option<DelayedTransferFunction>,
    /// Relative rms error of the rational model.
    pub rational_residual: Option<f64>,
    /// Fit quality of the servo.
    #[serde(rename = "trust")]
    pub fit_quality: Option<FitQuality>,
    /// Reason why the servo cannot be inverted, if any.
    pub refused: Option<String>,
    /// Reasons to doubt the results; empty if there are none.
    pub doubts: Vec<String>,
}

impl Identification {
    /// Returns the result of a static identification.
    #[must_use]
    pub fn from_static(evaluation: Evaluation) -> Self {
        let Evaluation { servo, refused, doubts } = evaluation;
        Self {
            static_servo: servo,
            refused: refused.map(|reason| reason.to_string()),
            doubts,
            ..Self::empty(TorqueScale::Gravity)
        }
    }

    /// Returns a result without measurements.
    pub(crate) fn empty(scale: TorqueScale) -> Self {
        Self {
            scale,
            measured: Vec::new(),
            servo: None,
            static_servo: None,
            equivalent_friction: 0.0,
            rational: None,
            rational_residual: None,
            fit_quality: None,
            refused: None,
            doubts: Vec::new(),
        }
    }

    /// Returns the reason why the joint cannot be controlled by torques; `None` if it can.
    #[must_use]
    pub fn no_torque_mode(&self) -> Option<String> {
        let ratios = "the scale of torque is unknown: only ratios to the inertia are identified. Measure motor \
                      current, or give the rotor inertia";
        self.refused.clone().or((self.scale == TorqueScale::Unknown).then(|| ratios.to_owned()))
    }

    /// Effective servo D* = T/(G* (1 − T)), equation (K6) of the paper, at the frequency `hz` (Hz) and T = `position`;
    /// G* has the identified inertia and viscous friction.
    #[must_use]
    pub fn effective_servo(&self, hz: f64, position: Complex<f64>) -> Option<Complex<f64>> {
        let servo = self.servo.as_ref()?;
        let s = Complex::new(0.0, TAU * hz);
        let viscous = servo.friction.map_or(0.0, |f| f.viscous);
        let inverse_joint = s * (s * servo.inertia + viscous);
        Some(position * inverse_joint / (Complex::new(1.0, 0.0) - position))
    }

    /// Response T of the identified servo at the frequency `hz` (Hz).
    #[must_use]
    pub fn model(&self, told: &KnownParameters, hz: f64) -> Option<Complex<f64>> {
        let servo = self.servo.as_ref()?;
        let omega = TAU * hz;
        let beyond_rotor = servo.gear.map_or(Complex::new(0.0, 0.0), |gear| {
            (gear.inertia_share(omega) - gear.rotor_share) * (servo.inertia * omega * omega)
        });
        let force = beyond_rotor - Complex::new(0.0, omega * self.equivalent_friction);
        Some(self.responses(told, hz)?.position_with_load(force))
    }

    fn responses(&self, told: &KnownParameters, hz: f64) -> Option<Responses> {
        let servo = self.servo.as_ref()?;
        let drive = Drive {
            kp: servo.kp,
            kv: servo.kv,
            velocity_filter_hz: servo.velocity_filter_hz,
            current_loop_hz: servo.current_loop_hz.unwrap_or(gains::CURRENT_LOOP_HZ),
            inertia: servo.inertia * servo.gear.map_or(1.0, |gear| gear.rotor_share),
            velocity_feed_forward: servo.velocity_feed_forward,
            setpoint_filter: servo.setpoint_filter,
        };
        Interval::new(&drive, told.rates(servo.delay)).responses(hz)
    }

    /// Returns true if the model explains the response at this line, at the largest amplitude, and its coherence is
    /// high. The response is that of torque if it was measured, which a transformer needs, otherwise that of position.
    pub(crate) fn explains(&self, told: &KnownParameters, line: usize) -> bool {
        let Some(largest) = self.measured.first() else { return false };
        let position = largest.position[line];
        let (model, measured) = match &largest.torque {
            Some(torque) => {
                let responses = self.responses(told, position.hz);
                (responses.map(|r| r.torque(position.value)), torque[line].value)
            }
            None => (self.model(told, position.hz), position.value),
        };
        let close = model.is_some_and(|m| (m - measured).norm() < CLOSE * measured.norm());
        close && position.coherence > COHERENT
    }
}

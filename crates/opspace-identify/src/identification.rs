//! Result of an identification, and the parameters that it needs.

use crate::friction::{ConstantVelocityRun, Friction};
use crate::gains;
use crate::interval::{Drive, Interval, Rates, Responses};
use crate::response::{Distortion, Point};
use crate::session::AbortReason;
use crate::transfer_function::DelayedTransferFunction;
use nalgebra::Complex;
use opspace_backend::Setpoints;
use serde::Serialize;
use std::f64::consts::TAU;
use thiserror::Error;

/// Parameters of a joint known before its identification.
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
    /// Resolution, one encoder count at the joint, rad (m).
    pub resolution: f64,
    /// Inertia in the initial position from URDF and rotor, with the other joints free and with them held, kg m² (kg);
    /// `None` where the rotor's is not known.
    pub inertia: Option<[f64; 2]>,
}

impl KnownParameters {
    pub(crate) fn rates(&self, delay: u32) -> Rates {
        let Self { servo_period_s, servo_ticks_per_cycle: ratio, setpoints, .. } = *self;
        Rates { servo_period_s, servo_ticks_per_cycle: ratio, delay, setpoints }
    }
}

/// Parameters of the excitation of a joint. Times are in seconds.
#[derive(Clone, Debug)]
pub struct ExcitationPlan {
    /// Period of the multisines: one over the distance of two lines.
    pub period_s: f64,
    /// Number of periods kept of each realisation; one more precedes them until the response has settled.
    pub periods: usize,
    /// Number of realisations, each with phases of its own, at each amplitude.
    pub realisations: usize,
    /// Amplitudes as shares of the largest safe one.
    pub amplitudes: Vec<f64>,
    /// Number of lines in a decade.
    pub lines_per_decade: f64,
    /// Number of speeds at which friction is measured.
    pub speeds: usize,
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
            seed: 1,
        }
    }
}

/// Coherence and error up to which a frequency is within the bandwidth of the fit.
pub(crate) const COHERENT: f64 = 0.95;
const CLOSE: f64 = 0.10;

/// Source of the scale of torque.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum TorqueScale {
    /// Motor current.
    MotorCurrent,
    /// Inertia given by URDF and rotor.
    Urdf,
    /// None: kv, inertia and friction are known as ratios to the inertia only.
    Unknown,
}

/// Reason why the servo of a joint cannot be inverted. Each message is about the joint.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum IdentificationFailure {
    /// Motion within the limits that is too small for the encoder.
    #[error(
        "within the limits it can be excited by only {reached:.2e} rad (m) rms, below the {least:.2e} rad (m) that its \
         encoder resolves"
    )]
    NoRoom {
        /// Amplitude reached, rms, rad (m).
        reached: f64,
        /// Smallest amplitude that the encoder shows, rad (m).
        least: f64,
    },
    /// Joint that does not follow its setpoints.
    #[error(
        "it does not follow its setpoints: at {hz:.1} Hz the ratio of position to setpoint is {gain:.2}; is it locked, braked or in contact?"
    )]
    DoesNotFollow {
        /// Frequency, Hz.
        hz: f64,
        /// Gain |T| there.
        gain: f64,
    },
    /// Response without a dominant linear part.
    #[error("{:.0} % of its response to the setpoints is nonlinear", 100.0 * distortion)]
    NotLinear {
        /// Rms outside the excited lines over rms at them.
        distortion: f64,
    },
    /// Responses that no gains explain.
    #[error("no cascaded servo fits its response: the best fit has an error of {:.0} % (allowed: {:.0} %)", 100.0 * error, 100.0 * allowed)]
    NotExplained {
        /// Relative error of the fit, rms.
        error: f64,
        /// Largest relative error allowed, rms.
        allowed: f64,
    },
    /// Responses that determine no gains.
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
    /// Highest frequency up to which coherence and fit are good, Hz: fit of the torque where it was measured, else of
    /// T.
    pub bandwidth_hz: f64,
    /// Relative error of the modelled T, rms.
    pub position_residual: f64,
    /// Relative error of the modelled torque, rms; `None` where torque was not measured.
    pub torque_residual: Option<f64>,
    /// Relative standard deviations of kp and kv.
    pub deviation: [f64; 2],
    /// Ratio of the costs of the next best delay and of the best.
    pub delay_margin: f64,
    /// Identified inertia over that given by URDF and rotor; `None` where either is missing.
    pub inertia_over_urdf: Option<f64>,
}

/// Servo of a joint, in Nm, or over the inertia where the scale of torque is not known.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct Servo {
    /// Position gain, 1/s.
    pub kp: f64,
    /// Velocity gain, Nms/rad (Ns/m), or 1/s.
    pub kv: f64,
    /// Cut-off of the velocity filter, Hz.
    pub velocity_filter_hz: f64,
    /// Delay of setpoints, servo ticks.
    pub delay: u32,
    /// Bandwidth of the current loop, Hz; `None` where torque was not measured.
    pub current_loop_hz: Option<f64>,
    /// Inertia that the drive moves, rotor included, kg m² (kg), or 1.
    pub inertia: f64,
    /// Friction of the joint, Nm (N), or rad/s².
    pub friction: Option<Friction>,
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
    /// Closed-loop response T.
    pub position: Vec<Point>,
    /// Mean torque over setpoint, Nm/rad.
    pub torque: Option<Vec<Point>>,
    /// Distortion of the position.
    pub distortion: Distortion,
}

/// Result for a joint, identified or not.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct Identification {
    /// Source of the scale of torque.
    pub scale: TorqueScale,
    /// Measurements at each amplitude, the largest first.
    pub measured: Vec<Measured>,
    /// Identified servo; for information only if [`refused`](Self::refused) gives a reason.
    pub servo: Option<Servo>,
    /// Viscous friction equivalent to the joint's resistance at the largest amplitude, in the servo's units.
    pub equivalent_friction: f64,
    /// T as a rational function behind hold and delay.
    pub rational: Option<DelayedTransferFunction>,
    /// Relative error of the rational model, rms.
    pub rational_residual: Option<f64>,
    /// Fit quality of the servo.
    #[serde(rename = "trust")]
    pub fit_quality: Option<FitQuality>,
    /// Reason why it can't be inverted.
    pub refused: Option<String>,
}

impl Identification {
    /// Reason why the joint can't be driven by torques; `None` if it can.
    #[must_use]
    pub fn no_torque_mode(&self) -> Option<String> {
        let ratios = "the scale of torque is unknown: only ratios to the inertia are identified. Measure motor \
                      current, or give the rotor inertia";
        self.refused.clone().or((self.scale == TorqueScale::Unknown).then(|| ratios.to_owned()))
    }

    /// Effective servo D* = T/(G* (1 − T)) of equation (K6) of the paper, at a frequency and a T, with G* of the
    /// identified inertia and viscous friction.
    #[must_use]
    pub fn effective_servo(&self, hz: f64, position: Complex<f64>) -> Option<Complex<f64>> {
        let servo = self.servo.as_ref()?;
        let s = Complex::new(0.0, TAU * hz);
        let viscous = servo.friction.map_or(0.0, |f| f.viscous);
        let inverse_joint = s * (s * servo.inertia + viscous);
        Some(position * inverse_joint / (Complex::new(1.0, 0.0) - position))
    }

    /// Response T of the identified servo at a frequency, Hz.
    #[must_use]
    pub fn model(&self, told: &KnownParameters, hz: f64) -> Option<Complex<f64>> {
        Some(self.responses(told, hz)?.position_with_friction(self.equivalent_friction, TAU * hz))
    }

    fn responses(&self, told: &KnownParameters, hz: f64) -> Option<Responses> {
        let servo = self.servo.as_ref()?;
        let drive = Drive {
            kp: servo.kp,
            kv: servo.kv,
            velocity_filter_hz: servo.velocity_filter_hz,
            current_loop_hz: servo.current_loop_hz.unwrap_or(gains::CURRENT_LOOP_HZ),
            inertia: servo.inertia,
        };
        Interval::new(&drive, told.rates(servo.delay)).responses(hz)
    }

    /// True if the response at one of the lines at the largest amplitude is well measured and well explained: the
    /// torque's where it was measured, which is what a transformer needs, else the position's.
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

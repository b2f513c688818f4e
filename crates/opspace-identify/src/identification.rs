//! The result of an identification, and what it needs to know beforehand.

use crate::friction::{ConstantVelocityRun, Friction};
use crate::gains;
use crate::interval::{Drive, Interval, Rates, Responses};
use crate::rational::Rational;
use crate::response::{Distortion, Point};
use crate::session::AbortReason;
use nalgebra::Complex;
use opspace_backend::Setpoints;
use serde::Serialize;
use std::f64::consts::TAU;
use thiserror::Error;

/// What is known of a joint beforehand.
#[derive(Clone, Debug)]
pub struct KnownParameters {
    /// Its place in the robot's order.
    pub joint: usize,
    /// Time between two servo ticks, s.
    pub servo_period_s: f64,
    /// Servo ticks per interface tick.
    pub ratio: u32,
    /// What the drive does with set-points until the next one comes.
    pub set_points: Setpoints,
    /// Position limits, rad (m).
    pub lower: f64,
    /// Upper end of them.
    pub upper: f64,
    /// Rad/s (m/s).
    pub speed_limit: f64,
    /// Nm (N).
    pub torque_limit: f64,
    /// One encoder count at the joint, rad (m).
    pub resolution: f64,
    /// Its inertia where it stands from URDF and rotor, with the other joints free and with them held, kg m² (kg); `None`
    /// where the rotor's is not known.
    pub inertia: Option<[f64; 2]>,
}

impl KnownParameters {
    pub(crate) fn rates(&self, delay: u32) -> Rates {
        let Self { servo_period_s, ratio, set_points, .. } = *self;
        Rates { servo_period_s, ratio, delay, set_points }
    }
}

/// How a joint is excited. Times are in seconds.
#[derive(Clone, Debug)]
pub struct ExcitationPlan {
    /// Period of the multisines: one over the distance of two lines.
    pub period_s: f64,
    /// Periods that are kept of each realisation; one more is waited for until it has settled.
    pub periods: usize,
    /// Realisations, each with phases of its own, at each amplitude.
    pub realisations: usize,
    /// Amplitudes as shares of the largest safe one.
    pub amplitudes: Vec<f64>,
    /// Lines in a decade.
    pub lines_per_decade: f64,
    /// Speeds at which friction is measured.
    pub speeds: usize,
    /// Of the phases.
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

/// Coherence and error up to which a frequency counts to the range in which the fit is trusted.
pub(crate) const COHERENT: f64 = 0.95;
const CLOSE: f64 = 0.10;

/// Where the scale of torque comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum TorqueScale {
    /// The motors' current.
    MotorCurrent,
    /// The inertia that URDF and rotor give.
    Urdf,
    /// Nowhere: kv, inertia and friction are known as ratios to the inertia only.
    Unknown,
}

/// Why a joint can't be inverted.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum IdentificationFailure {
    /// Nothing can be seen within its limits.
    #[error(
        "within its limits it can be moved by {reached:.2e} rad (m) rms only, and its encoder shows {least:.2e}"
    )]
    NoRoom {
        /// Rad (m).
        reached: f64,
        /// Rad (m).
        least: f64,
    },
    /// It stays where it is.
    #[error(
        "it does not follow its set-points: at {hz:.1} Hz it moves by {gain:.2} of what is asked; is it locked, braked or in contact?"
    )]
    DoesNotFollow {
        /// Hz.
        hz: f64,
        /// |T|.
        gain: f64,
    },
    /// There is no linear part to speak of.
    #[error("{:.0} % of its motion is not linear in its set-points", 100.0 * distortion)]
    NotLinear {
        /// Rms outside the excited lines over rms at them.
        distortion: f64,
    },
    /// No gains explain it.
    #[error("no cascaded servo explains its motion: the best is off by {:.0} % (allowed: {:.0} %)", 100.0 * error, 100.0 * allowed)]
    NotExplained {
        /// Relative, rms.
        error: f64,
        /// Relative, rms.
        allowed: f64,
    },
    /// The responses determine no gains.
    #[error("its responses determine no servo: torque and motion don't belong together")]
    Undetermined,
    /// The motion had to be broken off.
    #[error("its motion was broken off: {0}")]
    Stopped(AbortReason),
}

/// How far an identified servo can be trusted.
#[derive(Clone, Debug, Serialize)]
pub struct FitQuality {
    /// Up to where coherence is good, and so is the fit: of the torque where it was measured, else of T; Hz.
    pub bandwidth_hz: f64,
    /// Relative error of the modelled T, rms.
    pub position_residual: f64,
    /// Relative error of the modelled torque, rms; `None` where torque was not measured.
    pub torque_residual: Option<f64>,
    /// Relative standard deviations of kp and kv.
    pub deviation: [f64; 2],
    /// How many times worse the next best delay explains the responses.
    pub delay_margin: f64,
    /// Inertia as identified over what URDF and rotor give; `None` where either is missing.
    pub inertia_over_urdf: Option<f64>,
}

/// The servo of a joint, in Nm, or over the inertia where the scale of torque is not known.
#[derive(Clone, Debug, Serialize)]
pub struct Servo {
    /// 1/s.
    pub kp: f64,
    /// Nms/rad (Ns/m), or 1/s.
    pub kv: f64,
    /// Hz.
    pub velocity_filter_hz: f64,
    /// Servo ticks.
    pub delay: u32,
    /// Hz; `None` where torque was not measured.
    pub current_loop_hz: Option<f64>,
    /// What the drive moves, rotor included, kg m² (kg), or 1.
    pub inertia: f64,
    /// Nm (N), or rad/s².
    pub friction: Option<Friction>,
    /// The passes from which friction comes.
    pub passes: Vec<ConstantVelocityRun>,
}

/// What was measured at one amplitude.
#[derive(Clone, Debug, Serialize)]
pub struct Measured {
    /// Rms of the set-point's offset, rad (m).
    pub rms: f64,
    /// Rms of the joint's velocity, rad/s (m/s).
    pub speed: f64,
    /// T.
    pub position: Vec<Point>,
    /// Mean torque over set-point, Nm/rad.
    pub torque: Option<Vec<Point>>,
    /// Of the position.
    pub distortion: Distortion,
}

/// A joint, identified or not.
#[derive(Clone, Debug, Serialize)]
pub struct Identification {
    /// Where the scale of torque comes from.
    pub scale: TorqueScale,
    /// Amplitude by amplitude, the largest first.
    pub measured: Vec<Measured>,
    /// The servo; with a reason not to use it below, for information only.
    pub servo: Option<Servo>,
    /// Viscous friction that amounts to what held the joint back at the largest amplitude, in the servo's units.
    pub equivalent_friction: f64,
    /// T as a rational function behind hold and delay.
    pub rational: Option<Rational>,
    /// Of the rational model, relative, rms.
    pub rational_residual: Option<f64>,
    /// How far it can be trusted.
    pub trust: Option<FitQuality>,
    /// Why it can't be inverted.
    pub refused: Option<String>,
}

impl Identification {
    /// Why the joint can't be driven by torques; `None` if it can.
    #[must_use]
    pub fn no_torque_mode(&self) -> Option<String> {
        let ratios = "the scale of torque is not known: only ratios to the inertia are. Measure the motor's current, or \
                      give the rotor's inertia";
        self.refused.clone().or((self.scale == TorqueScale::Unknown).then(|| ratios.to_owned()))
    }

    /// D* = T/(G* (1 − T)) of equation (6) of the paper, at a frequency and a T, with G* of the identified inertia and
    /// viscous friction.
    #[must_use]
    pub fn effective_servo(&self, hz: f64, position: Complex<f64>) -> Option<Complex<f64>> {
        let servo = self.servo.as_ref()?;
        let s = Complex::new(0.0, TAU * hz);
        let viscous = servo.friction.map_or(0.0, |f| f.viscous);
        let inverse_joint = s * (s * servo.inertia + viscous);
        Some(position * inverse_joint / (Complex::new(1.0, 0.0) - position))
    }

    /// T of the identified servo at a frequency, Hz, as its drive makes it.
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

    /// Whether the response at one of the lines at the largest amplitude is well measured and well explained: the torque's
    /// where it was measured, which is what a transformer needs, else the position's.
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

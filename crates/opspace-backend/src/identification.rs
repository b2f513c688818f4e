//! What a position servo is, found by moving the joint: kp, kv, velocity filter, delay, inertia and friction.
//!
//! A joint is excited about where it stands by odd random-phase [multisines](excitation) at two amplitudes, small enough for
//! its limits and for its motor; the other joints hold. From set-points, positions and, where it is measured, motor torque
//! come the [frequency responses](response), from these the [gains] of the servo through the exact model of what happens
//! [between two interface ticks](interval), and a [rational] model of T = y/q_desired. Slow passes in both directions give
//! [friction]. What is told beforehand is the structure of the servo, τ = kv [kp (q_desired − y) − w], its rates, and the
//! limits; gains, filter, delay and friction are not.
//!
//! T stays as it is when inertia, friction and kv are scaled together: the scale of torque comes from the motor's current, or
//! from the inertia that URDF and rotor give, or is not known; [`TorqueScale`] says which.

pub mod excitation;
pub mod friction;
pub mod gains;
pub mod interval;
pub mod least_squares;
pub mod rational;
pub mod response;
pub mod session;

use crate::identification::excitation::{Multisine, odd_lines};
use crate::identification::friction::{Friction, Pass};
use crate::identification::gains::{Gains, Level};
use crate::identification::interval::{Drive, Interval, Rates, Responses};
use crate::identification::rational::{Rational, Target, relative};
use crate::identification::response::{Distortion, Realisation, distortion, frequency_response};
use crate::identification::session::{Bounds, Record, Session, Stop};
use crate::interface::SetPoints;
use nalgebra::Complex;
use serde::Serialize;
use std::f64::consts::TAU;
use thiserror::Error;

/// What is known of a joint beforehand.
#[derive(Clone, Debug)]
pub struct Told {
    /// Its place in the robot's order.
    pub joint: usize,
    /// Time between two servo ticks, s.
    pub servo_period_s: f64,
    /// Servo ticks per interface tick.
    pub ratio: u32,
    /// What the drive does with set-points until the next one comes.
    pub set_points: SetPoints,
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

impl Told {
    fn rates(&self, delay: u32) -> Rates {
        let Self { servo_period_s, ratio, set_points, .. } = *self;
        Rates { servo_period_s, ratio, delay, set_points }
    }
}

/// How a joint is excited. Times are in seconds.
#[derive(Clone, Debug)]
pub struct Plan {
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

impl Default for Plan {
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

/// Highest excited frequency over the interface rate: beyond, aliases and the model's own limits prevail.
const BAND: f64 = 0.4;

/// What of a limit is used: of the way to the nearest position limit, of the speed limit, and of the torque that is left
/// beside what holds the joint.
const TRAVEL_USED: f64 = 0.3;
const SPEED_USED: f64 = 0.3;
const TORQUE_USED: f64 = 0.5;

/// At which of it a motion is broken off.
const TRAVEL_AT_MOST: f64 = 0.8;
const SPEED_AT_MOST: f64 = 0.9;
const TORQUE_AT_MOST: f64 = 0.95;

/// Furthest that a joint is moved from where it stands, rad (m): inertia and gravity should stay what they are.
const FURTHEST: f64 = 0.35;

/// The first, careful amplitude, in encoder counts (rms), and what must be reached for the encoder to show it.
const FIRST_COUNTS: f64 = 10.0;
const LEAST_COUNTS: f64 = 20.0;

/// Speed is a difference over so long, s.
const SPEED_OVER_S: f64 = 2e-3;

/// Most trials until an amplitude is found, and how often it may be halved when it was too large after all.
const TRIALS: usize = 20;
const HALVED_AT_MOST: usize = 3;

/// How long an amplitude is tried, and how long a motion fades in and out, s.
const TRIAL_S: f64 = 0.5;
const FADE_S: f64 = 0.2;

/// A servo that follows has |T| near 1 at low frequencies: less than this is none that does.
const FOLLOWS: f64 = 0.5;

/// A joint that turns needs so many times what its friction keeps it behind its set-point until it moves steadily.
const TURNS_WITHIN: f64 = 8.0;

/// Relative errors of torque and position beyond which the servo is not of the structure that it is said to have. Without
/// measured torque a joint that others couple with strongly fails it too: its gains would be wrong.
const TORQUE_EXPLAINED: f64 = 0.10;
const POSITION_EXPLAINED: f64 = 0.10;

/// Coherence and error up to which a frequency counts to the range in which the fit is trusted.
const COHERENT: f64 = 0.95;
const CLOSE: f64 = 0.10;

/// Power outside the excited lines beyond which no linear servo is left to be inverted.
const LINEAR: f64 = 0.5;

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
pub enum Refusal {
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
    Stopped(Stop),
}

/// How far an identified servo can be trusted.
#[derive(Clone, Debug, Serialize)]
pub struct Trust {
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
    pub passes: Vec<Pass>,
}

/// What was measured at one amplitude.
#[derive(Clone, Debug, Serialize)]
pub struct Measured {
    /// Rms of the set-point's offset, rad (m).
    pub rms: f64,
    /// Rms of the joint's velocity, rad/s (m/s).
    pub speed: f64,
    /// T.
    pub position: Vec<response::Point>,
    /// Mean torque over set-point, Nm/rad.
    pub torque: Option<Vec<response::Point>>,
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
    pub trust: Option<Trust>,
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
    pub fn model(&self, told: &Told, hz: f64) -> Option<Complex<f64>> {
        Some(self.responses(told, hz)?.position_with_friction(self.equivalent_friction, TAU * hz))
    }

    fn responses(&self, told: &Told, hz: f64) -> Option<Responses> {
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
    fn explains(&self, told: &Told, line: usize) -> bool {
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

/// Identifies one joint of a robot that holds itself.
///
/// # Errors
/// A fault of the robot, or an interruption. A joint that can't be inverted is no error: its identification says why.
pub fn identify(session: &mut Session<'_>, told: &Told, plan: &Plan) -> Result<Identification, Stop> {
    let scale = match (session.measures_torque(), told.inertia) {
        (true, _) => TorqueScale::MotorCurrent,
        (false, Some(_)) => TorqueScale::Urdf,
        (false, None) => TorqueScale::Unknown,
    };
    let mut found = Identification {
        scale,
        measured: Vec::new(),
        servo: None,
        equivalent_friction: 0.0,
        rational: None,
        rational_residual: None,
        trust: None,
        refused: None,
    };
    match (Joint { session, told, plan }).identify(&mut found) {
        Ok(()) => Ok(found),
        Err(Refusal::Stopped(stop)) if stop.is_final() => Err(stop),
        Err(refusal) => {
            found.refused = Some(refusal.to_string());
            Ok(found)
        }
    }
}

struct Joint<'a, 'b> {
    session: &'a mut Session<'b>,
    told: &'a Told,
    plan: &'a Plan,
}

impl From<Stop> for Refusal {
    fn from(stop: Stop) -> Self {
        Self::Stopped(stop)
    }
}

impl Joint<'_, '_> {
    fn identify(&mut self, found: &mut Identification) -> Result<(), Refusal> {
        self.measure_levels(found)?;
        self.check_following(found)?;

        let levels: Vec<Level> = (found.measured.iter())
            .map(|m| Level { speed: m.speed, position: m.position.clone(), torque: m.torque.clone() })
            .collect();
        let rates = self.told.rates(0);
        let rough = gains::fit(&levels, rates, 0.0).ok_or(Refusal::Undetermined)?;
        let sweeps = self.sweeps(&rough)?;
        let lag = self.lag(&sweeps);
        let gains = match self.session.measures_torque() {
            true => rough,
            false => gains::fit(&levels, rates, lag.at_rest).ok_or(Refusal::Undetermined)?,
        };
        self.rational(found, gains.delay);
        let scale = match (found.scale, self.told.inertia) {
            // The joints beside neither quite hold nor quite give way.
            (TorqueScale::Urdf, Some([free, held])) => 0.5 * (free + held),
            _ => 1.0,
        };
        let passes: Vec<Pass> = (sweeps.iter())
            .filter_map(|sweep| sweep.friction(&gains, lag, self.session.period_s()))
            .map(|p| Pass { torque: scale * p.torque, ..p })
            .collect();
        found.equivalent_friction = scale * gains.friction[0];
        let drive = gains.drive;
        found.servo = Some(Servo {
            kp: drive.kp,
            kv: scale * drive.kv,
            velocity_filter_hz: drive.velocity_filter_hz,
            delay: gains.delay,
            current_loop_hz: self.session.measures_torque().then_some(drive.current_loop_hz),
            inertia: scale * drive.inertia,
            friction: friction::fit(&passes),
            passes,
        });
        let trust = self.trust(found, &gains);
        let explained = check_explained(&trust);
        found.trust = Some(trust);
        explained
    }

    fn bounds(&self) -> Bounds {
        let told = self.told;
        Bounds {
            travel: TRAVEL_AT_MOST * self.room(),
            speed: SPEED_AT_MOST * told.speed_limit,
            torque: TORQUE_AT_MOST * told.torque_limit,
        }
    }

    /// To the nearest limit, rad (m).
    fn room(&self) -> f64 {
        let at = self.session.posture(self.told.joint);
        (at - self.told.lower).min(self.told.upper - at).max(0.0)
    }

    /// How far the joint is moved for its identification, rad (m).
    fn travel(&self) -> f64 {
        (TRAVEL_USED * self.room()).min(FURTHEST)
    }

    /// Torque beside what holds the joint, Nm (N).
    fn spare_torque(&self) -> f64 {
        let holds = self.session.torque(self.told.joint).unwrap_or(0.0).abs();
        TORQUE_USED * (self.told.torque_limit - holds).max(0.0)
    }

    /// The largest safe amplitude (rms): from a careful one on, each tried for a moment and made larger by what limits leave.
    fn amplitude(&mut self, excitation: &Multisine) -> Result<f64, Refusal> {
        let most = self.travel() / excitation.crest();
        let least = LEAST_COUNTS * self.told.resolution;
        let mut rms = (FIRST_COUNTS * self.told.resolution).max(1e-6).min(most);
        let mut ceiling = most;
        for _ in 0..TRIALS {
            let factor = match self.trial(excitation, rms) {
                Ok(factor) => factor,
                Err(stop) if stop.is_final() => return Err(stop.into()),
                Err(_) => {
                    ceiling = 0.5 * rms;
                    0.3
                }
            };
            let next = (rms * factor.min(4.0)).min(ceiling);
            if next < least && factor < 1.0 || ceiling < least {
                return Err(Refusal::NoRoom { reached: next, least });
            }
            if next < 1.2 * rms && factor > 0.4 {
                return Ok(next);
            }
            rms = next;
        }
        Ok(rms)
    }

    /// All amplitudes, the largest first; one that turns out to be too large is halved.
    fn measure_levels(&mut self, found: &mut Identification) -> Result<(), Refusal> {
        let samples = (self.plan.period_s / self.session.period_s()).round() as usize;
        let lines = odd_lines(1, (BAND * samples as f64) as usize, self.plan.lines_per_decade);
        let excitations: Vec<Multisine> = (0..self.plan.realisations as u64)
            .map(|k| {
                let seed = self.plan.seed.wrapping_mul(1000) + 100 * self.told.joint as u64 + k;
                Multisine::new(&lines, samples, seed)
            })
            .collect();
        let mut largest = self.amplitude(&excitations[0])?;
        let mut halved = 0;
        while found.measured.len() < self.plan.amplitudes.len() {
            let share = self.plan.amplitudes[found.measured.len()];
            match self.measure(&excitations, share * largest, &lines) {
                Ok(measured) => found.measured.push(measured),
                Err(stop) if stop.is_final() || halved == HALVED_AT_MOST => return Err(stop.into()),
                Err(_) => {
                    halved += 1;
                    largest *= 0.5;
                    found.measured.clear();
                }
            }
        }
        Ok(())
    }

    /// By how much an amplitude could be larger.
    fn trial(&mut self, excitation: &Multisine, rms: f64) -> Result<f64, Stop> {
        let period_s = self.session.period_s();
        let holds = self.session.torque(self.told.joint).unwrap_or(0.0);
        let ticks = (TRIAL_S / period_s) as usize;
        let (record, body) = self.play(excitation, rms, ticks)?;
        let position = &record.position[body.clone()];
        let over = ((SPEED_OVER_S / period_s).round() as usize).max(1);
        let span = over as f64 * period_s;
        let speed: Vec<f64> = position.windows(over + 1).map(|w| (w[over] - w[0]) / span).collect();
        let torque: Vec<f64> = match self.told.inertia {
            _ if !record.torque.is_empty() => record.torque[body].iter().map(|t| t - holds).collect(),
            // What the motion needs, at least.
            Some([_, held]) => speed.windows(over + 1).map(|w| held * (w[over] - w[0]) / span).collect(),
            None => Vec::new(),
        };
        let share = |limit: f64, values: &[f64]| limit / Record::peak(values).max(1e-12);
        Ok(share(SPEED_USED * self.told.speed_limit, &speed).min(share(self.spare_torque(), &torque)))
    }

    /// An excitation for some ticks, faded in before and out after; the ticks between.
    fn play(
        &mut self,
        excitation: &Multisine,
        rms: f64,
        ticks: usize,
    ) -> Result<(Record, std::ops::Range<usize>), Stop> {
        let fade = (FADE_S / self.session.period_s()).ceil() as usize;
        let total = fade + ticks + fade;
        let bounds = self.bounds();
        let window = move |k: usize| smooth(k.min(total - 1 - k) as f64 / fade as f64);
        let offsets = (0..total).map(|k| rms * window(k) * excitation.at(k));
        let record = self.session.play(self.told.joint, offsets, &bounds)?;
        self.session.rest(0.1)?;
        Ok((record, fade..fade + ticks))
    }

    /// All realisations at one amplitude.
    fn measure(&mut self, excitations: &[Multisine], rms: f64, lines: &[usize]) -> Result<Measured, Stop> {
        let period_s = self.session.period_s();
        let (mut position, mut torque) = (Vec::new(), Vec::new());
        for excitation in excitations {
            let samples = excitation.samples.len();
            let (record, body) = self.play(excitation, rms, (1 + self.plan.periods) * samples)?;
            // The first period settles.
            let settled = body.start + samples..body.end;
            let input = record.asked[settled.start..settled.start + samples].to_vec();
            let of = |values: &[f64]| Realisation {
                input: input.clone(),
                periods: values[settled.clone()].chunks_exact(samples).map(<[f64]>::to_vec).collect(),
            };
            position.push(of(&record.position));
            if !record.torque.is_empty() {
                torque.push(of(&record.torque));
            }
        }
        Ok(Measured {
            rms,
            speed: speed(&position, period_s),
            position: frequency_response(&position, lines, period_s),
            torque: (!torque.is_empty()).then(|| frequency_response(&torque, lines, period_s)),
            distortion: distortion(&position, lines),
        })
    }

    fn check_following(&self, found: &Identification) -> Result<(), Refusal> {
        let Some(largest) = found.measured.first() else { return Err(Refusal::Undetermined) };
        for point in largest.position.iter().take(3) {
            let gain = point.value.norm();
            if gain < FOLLOWS {
                return Err(Refusal::DoesNotFollow { hz: point.hz, gain });
            }
        }
        let distortion = largest.distortion.total();
        if distortion > LINEAR { Err(Refusal::NotLinear { distortion }) } else { Ok(()) }
    }

    /// A rational model of T at the largest amplitude: of the lowest order beyond which little is gained.
    fn rational(&self, found: &mut Identification, delay: u32) {
        let Some(largest) = found.measured.first() else { return };
        let weight = |p: &response::Point| 1.0 / f64::hypot(p.noise, 0.01 * p.value.norm());
        let targets: Vec<Target> = (largest.position.iter())
            .filter(|p| p.coherence > COHERENT)
            .map(|p| Target { hz: p.hz, value: p.value, weight: weight(p) })
            .collect();
        let delay_s = f64::from(delay) * self.told.servo_period_s;
        for degrees in [(0, 2), (1, 3), (2, 4), (3, 5)] {
            if targets.len() < 2 * (degrees.0 + degrees.1) {
                break;
            }
            let fitted = rational::fit(&targets, degrees, self.session.period_s(), delay_s);
            let Some(model) = fitted.filter(Rational::is_stable) else { continue };
            let residual = model.residual(&targets);
            if found.rational_residual.is_none_or(|before| residual < 0.8 * before) {
                found.rational = Some(model);
                found.rational_residual = Some(residual);
            }
        }
    }

    /// To and fro at constant speeds, fast to slow: the slower, the longer it takes a joint to turn against its friction.
    fn sweeps(&mut self, gains: &Gains) -> Result<Vec<Sweep>, Refusal> {
        let period_s = self.session.period_s();
        let told = self.told;
        let drive = gains.drive;
        let settle_s = f64::max(0.15, 5.0 / drive.kp);
        let window_s = 0.25;
        let mut speed = (0.15 * told.speed_limit).min(2.0 * self.travel() / (settle_s + window_s));
        let mut sweeps: Vec<Sweep> = Vec::new();
        while sweeps.len() < self.plan.speeds && speed * window_s > LEAST_COUNTS * told.resolution {
            let friction = sweeps.last().and_then(|s| s.friction(gains, self.lag(&sweeps), period_s));
            let behind = friction.map_or(0.0, |p| p.torque.max(0.0)) / (drive.kv * drive.kp);
            let turned_s = TURNS_WITHIN * behind / speed;
            let seconds = settle_s + turned_s.min(2.0) + window_s;
            match self.sweep(speed, 0.5 * speed * seconds, gains) {
                Ok(record) => sweeps.push(Sweep { speed, half: 0.5 * speed * window_s, record }),
                // What is too fast for it is left out.
                Err(stop) if !stop.is_final() => {}
                Err(stop) => return Err(stop.into()),
            }
            speed *= 0.55;
        }
        Ok(sweeps)
    }

    /// The straight line through the faster half of the sweeps, where static friction has no part.
    fn lag(&self, sweeps: &[Sweep]) -> Lag {
        let period_s = self.session.period_s();
        let lags: Vec<(f64, f64)> = (sweeps.iter().take(sweeps.len().div_ceil(2)))
            .filter_map(|s| Some((s.speed, s.lag(period_s)?)))
            .collect();
        let n = lags.len() as f64;
        let (sum_v, sum_e) = lags.iter().fold((0.0, 0.0), |(v, e), l| (v + l.0, e + l.1));
        let (mean_v, mean_e) = (sum_v / n, sum_e / n);
        let (mut vv, mut ve) = (0.0, 0.0);
        for (v, e) in &lags {
            vv += (v - mean_v) * (v - mean_v);
            ve += (v - mean_v) * (e - mean_e);
        }
        let line = Lag { at_rest: mean_e - ve / vv * mean_v, per_speed: ve / vv };
        if line.at_rest > 0.0 && line.per_speed.is_finite() { line } else { Lag::default() }
    }

    /// Twice to and fro at a speed, turning gently, and back.
    fn sweep(&mut self, speed: f64, reach: f64, gains: &Gains) -> Result<Record, Stop> {
        let period_s = self.session.period_s();
        // Turning takes some of the spare torque; where its scale isn't known, 50 ms.
        let slew = match self.session.measures_torque() {
            true => 0.3 * self.spare_torque() / gains.drive.inertia,
            false => 2.0 * speed / 0.05,
        };
        let (mut offsets, mut at, mut velocity) = (Vec::new(), 0.0, 0.0f64);
        for end in [reach, -reach, reach, -reach, 0.0] {
            let direction = f64::signum(end - at);
            while (end - at) * direction > 0.0 {
                velocity += (direction * speed - velocity).clamp(-slew * period_s, slew * period_s);
                at += velocity * period_s;
                offsets.push(at);
            }
        }
        while velocity != 0.0 {
            velocity -= velocity.clamp(-slew * period_s, slew * period_s);
            at += velocity * period_s;
            offsets.push(at);
        }
        let fade = (FADE_S / period_s).ceil() as usize;
        offsets.extend((0..fade).map(|k| at * (1.0 - smooth((k + 1) as f64 / fade as f64))));
        let bounds = self.bounds();
        let record = self.session.play(self.told.joint, offsets.into_iter(), &bounds)?;
        self.session.rest(0.1)?;
        Ok(record)
    }

    /// Relative error of the modelled T at the largest amplitude, rms over coherent lines.
    fn position_residual(&self, found: &Identification) -> f64 {
        let points = found.measured.first().map_or(&[][..], |m| &m.position);
        let coherent = points.iter().filter(|p| p.coherence > COHERENT);
        relative(coherent.filter_map(|p| Some((found.model(self.told, p.hz)?, p.value))))
    }

    fn trust(&self, found: &Identification, gains: &Gains) -> Trust {
        let points = found.measured.first().map_or(&[][..], |m| &m.position);
        let explained = (0..points.len()).take_while(|&line| found.explains(self.told, line)).last();
        let identified = match found.scale {
            TorqueScale::MotorCurrent => Some(gains.drive.inertia),
            _ => None,
        };
        Trust {
            bandwidth_hz: explained.map_or(0.0, |line| points[line].hz),
            position_residual: self.position_residual(found),
            torque_residual: gains.torque_residual,
            deviation: gains.deviation,
            delay_margin: gains.delay_margin,
            inertia_over_urdf: identified
                .zip(self.told.inertia)
                .map(|(i, [free, held])| i / (0.5 * (free + held))),
        }
    }
}

/// Rms velocity of what was measured, rad/s (m/s), as far as the encoder shows it.
fn speed(realisations: &[Realisation], period_s: f64) -> f64 {
    let over = ((SPEED_OVER_S / period_s).round() as usize).max(1);
    let (mut power, mut count) = (0.0, 0.0);
    for w in realisations.iter().flat_map(|r| &r.periods).flat_map(|p| p.windows(over + 1)) {
        power += ((w[over] - w[0]) / (over as f64 * period_s)).powi(2);
        count += 1.0;
    }
    f64::sqrt(power / f64::max(count, 1.0)).max(f64::MIN_POSITIVE)
}

/// A joint's way to and fro at a constant speed.
struct Sweep {
    /// Rad/s (m/s).
    speed: f64,
    /// How far from the middle the joint has long been at that speed, rad (m).
    half: f64,
    record: Record,
}

impl Sweep {
    /// Half the difference of a quantity between both directions, over the same positions.
    fn half_difference(&self, quantity: impl Fn(&Record, usize) -> f64, period_s: f64) -> Option<f64> {
        let record = &self.record;
        let mut sums = [(0.0, 0.0); 2];
        // The first leg only leads to where the others begin.
        let turned = record.asked.windows(2).position(|w| w[1] < w[0])?;
        for k in turned..record.asked.len() - 1 {
            let v = (record.asked[k + 1] - record.asked[k]) / period_s;
            if record.position[k].abs() < self.half && (v.abs() - self.speed).abs() < 1e-6 * self.speed {
                let (sum, count) = &mut sums[usize::from(v > 0.0)];
                *sum += quantity(record, k);
                *count += 1.0;
            }
        }
        let [(back, m), (forth, n)] = sums;
        (m > 0.0 && n > 0.0).then(|| 0.5 * (forth / n - back / m))
    }

    /// How far the joint is behind its set-point, rad (m).
    fn lag(&self, period_s: f64) -> Option<f64> {
        self.half_difference(|record, k| record.asked[k] - record.position[k], period_s)
    }

    /// Friction at this speed: of the measured torque, else of how far the joint lags beyond what grows with speed.
    fn friction(&self, gains: &Gains, lag: Lag, period_s: f64) -> Option<Pass> {
        let torque = if self.record.torque.is_empty() {
            gains.drive.kv * gains.drive.kp * (self.lag(period_s)? - lag.per_speed * self.speed)
        } else {
            self.half_difference(|record, k| record.torque[k], period_s)?
        };
        Some(Pass { speed: self.speed, torque })
    }
}

/// How far a joint is behind its set-point at constant speed: a part that Coulomb friction makes, and one that grows with
/// speed, which the servo makes and in which viscous friction can't be told apart.
#[derive(Clone, Copy, Debug, Default)]
struct Lag {
    /// Rad (m).
    at_rest: f64,
    /// s.
    per_speed: f64,
}

/// From 0 to 1 with velocity and acceleration that begin and end at 0.
fn smooth(u: f64) -> f64 {
    let u = u.clamp(0.0, 1.0);
    u * u * u * (10.0 + u * (6.0 * u - 15.0))
}

fn check_explained(trust: &Trust) -> Result<(), Refusal> {
    let (error, allowed) = match trust.torque_residual {
        Some(error) => (error, TORQUE_EXPLAINED),
        None => (trust.position_residual, POSITION_EXPLAINED),
    };
    if error <= allowed { Ok(()) } else { Err(Refusal::NotExplained { error, allowed }) }
}

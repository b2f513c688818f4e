//! Identification of the servo from frequency responses: the exact multirate model is fitted to the measurements.
//!
//! With measured motor current, input and output of the drive are known: setpoint and position, and torque. Its gains
//! are then determined for any motion of the joint (see [`interval`](crate::interval)). Without measured current the
//! only known quantity is T = y/q_d,
//!
//! ```text
//! T ≈ kv kp / (I s² + (kv + b) s + kv kp)
//! ```
//!
//! so that only kv kp/I and (kv + b)/I are determined. Coulomb friction is known from the joint's lag at constant
//! speed. It is modelled as the viscous friction √(2/π) Fc/σ, which dissipates the same power for a Gaussian velocity
//! of standard deviation σ. The lag at constant speed also gives (kv + b)/(kv kp), much more accurately. Viscous friction
//! b must be known: if it is taken as zero, the identified kv is too high by b, and the identified kp is too low
//! accordingly, by some percent.
//!
//! With measured current, the setpoint may reach the loop directly, with its velocity fed forward, or through a filter: the [paths](SetpointPath)
//! are compared, and the simplest is selected that no other one explains the responses clearly better than.

use crate::amplitude_level::AmplitudeLevel;
use crate::confidence::Interval95;
use crate::interval::{Drive, Interval, Rates, SetpointFilterModel};
use crate::least_squares::{Minimum, minimise};
use crate::load;
use crate::load::{CORRELATED_OVER, Gear};
use crate::response::Point;
use crate::transfer_function::MAX_ITERATIONS;
use crate::transfer_function::relative;
use nalgebra::{Complex, DMatrix, DVector};
use opspace_backend::{MAX_DELAY_CYCLES, Setpoints};
use serde::Serialize;
use std::f64::consts::TAU;
use std::ops::RangeInclusive;

/// Relative error of the model assumed in the weights, in addition to noise.
const MODEL_ERROR: f64 = 0.01;

/// Range of the relative error of the model that the errors show, and number of halvings of its logarithm.
const MODEL_ERRORS: [f64; 2] = [1e-4, 0.1];
const HALVINGS: usize = 20;

/// Relative error of the position error per speed assumed in the weights: that of slow motion is known much better than
/// the responses.
const SLOW_ERROR: f64 = 1e-4;

/// Prior values of a drive's filter and current loop, used if the data don't determine them, each with its tolerance
/// factor: a filter at an eighth of the servo rate, a current loop of 1 kHz.
const FILTER_OF_RATE: f64 = 0.125;
const FILTER_WITHIN: f64 = 10.0;
pub(super) const CURRENT_LOOP_HZ: f64 = 1000.0;
const CURRENT_LOOP_WITHIN: f64 = 4.0;

/// Tolerance factors of the cut-off of a setpoint filter about the servo's own bandwidth, and of its damping ratio
/// about 1.
const CUTOFF_WITHIN: f64 = 30.0;
const DAMPING_WITHIN: f64 = 5.0;

/// Number of alternating fits of gains and of inertia.
const TURNS: usize = 2;

/// Ratio of the cost of a simpler path of the setpoint to that of the best one from which on the best one is clear, and
/// smallest ratio for which a path is tried with all delays.
const CLEARLY: f64 = 1.5;
const TRIED: f64 = 1.2;

/// Ratio of the costs of a delay and of the best one, after one turn, up to which a delay is fitted in all turns.
const REFINED: f64 = 4.0;

/// Number of whole cycles beyond the best delay after which no longer one is tried.
const WORSE_CYCLES: u32 = 2;

/// Smallest fraction of fed-forward velocity that is reported.
const LEAST_FEED_FORWARD: f64 = 0.03;

/// Largest noise of a torque over its value of lines whose errors are those of the model.
const HEARD: f64 = 0.03;

/// Largest error that is taken as noise, in standard deviations of the noise.
const NOISE_AT_MOST: f64 = 3.0;

/// Ratio of the costs of a delay and of the best one below which the delay is in its interval.
const LIKELY_DELAY: f64 = 1.1;

/// Lag of a joint behind its setpoint at constant speed.
#[derive(Clone, Copy, Debug, Default)]
#[non_exhaustive]
pub struct Lag {
    /// Part due to Coulomb friction, rad (m).
    pub at_rest: f64,
    /// Part per unit of speed, s, due to the servo, viscous friction and sampling; 0 if unknown.
    pub per_speed: f64,
}

impl Lag {
    /// Mean position error of the servo per unit of speed, s: the lag between position and setpoint of a sample is longer.
    fn error_per_speed(self, rates: Rates) -> Option<f64> {
        let half = 0.5 * f64::from(rates.servo_ticks_per_cycle - 1);
        let late = match rates.setpoints {
            Setpoints::Held => half,
            Setpoints::Interpolated => 2.0 * half,
        };
        let error = self.per_speed - rates.servo_period_s * (f64::from(rates.delay) + late);
        (self.per_speed > 0.0).then_some(error)
    }
}

/// Path of the setpoint to the position loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum SetpointPath {
    /// The setpoint acts on the position error only.
    Direct,
    /// Its velocity is fed forward as well.
    FeedForward,
    /// It passes a filter of first order.
    FilterOfFirstOrder,
    /// It passes a filter of second order.
    FilterOfSecondOrder,
    /// It passes a filter of first order, after which its velocity is fed forward as well.
    FilterAndFeedForward,
}

impl SetpointPath {
    /// All paths, the simplest first.
    pub const ALL: [Self; 5] = [
        Self::Direct,
        Self::FeedForward,
        Self::FilterOfFirstOrder,
        Self::FilterOfSecondOrder,
        Self::FilterAndFeedForward,
    ];

    /// Parameters from which a fit starts, of a servo with the gain `kp` (1/s).
    fn start(self, kp: f64) -> Vec<f64> {
        let cutoff = (2.0 * kp / TAU).ln();
        match self {
            Self::Direct => vec![],
            Self::FeedForward => vec![0.5],
            Self::FilterOfFirstOrder => vec![cutoff],
            Self::FilterOfSecondOrder => vec![cutoff, 0.0],
            Self::FilterAndFeedForward => vec![cutoff, 0.5],
        }
    }

    /// Drive with this path.
    fn of(self, x: &[f64], drive: Drive) -> Drive {
        let first = |x: f64| SetpointFilterModel::FirstOrder { cutoff_hz: x.exp() };
        match self {
            Self::Direct => drive,
            Self::FeedForward => Drive { velocity_feed_forward: x[0], ..drive },
            Self::FilterOfFirstOrder => Drive { setpoint_filter: first(x[0]), ..drive },
            Self::FilterOfSecondOrder => Drive {
                setpoint_filter: SetpointFilterModel::SecondOrder {
                    natural_frequency_hz: x[0].exp(),
                    damping_ratio: x[1].exp(),
                },
                ..drive
            },
            Self::FilterAndFeedForward => {
                Drive { setpoint_filter: first(x[0]), velocity_feed_forward: x[1], ..drive }
            }
        }
    }

    /// Residuals of weak priors, which keep parameters within their range if the data don't determine them.
    fn priors(self, x: &[f64], kp: f64) -> Vec<f64> {
        let cutoff = |x: f64| beyond(x, kp / TAU, CUTOFF_WITHIN);
        match self {
            Self::Direct => vec![],
            Self::FeedForward => vec![0.1 * x[0]],
            Self::FilterOfFirstOrder => vec![cutoff(x[0])],
            Self::FilterOfSecondOrder => vec![cutoff(x[0]), beyond(x[1], 1.0, DAMPING_WITHIN)],
            Self::FilterAndFeedForward => vec![cutoff(x[0]), 0.1 * x[1]],
        }
    }
}

/// Comparison of a path of the setpoint with the selected one.
#[derive(Clone, Copy, Debug, Serialize)]
#[non_exhaustive]
pub struct PathComparison {
    /// The path.
    pub path: SetpointPath,
    /// Its sum of squared errors over that of the best path.
    pub cost_over_best: f64,
}

/// Fitted servo.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Gains {
    /// Drive and joint. If torque was not measured, the inertia is 1 and kv is divided by the inertia.
    pub drive: Drive,
    /// Delay until a setpoint acts, in servo ticks.
    pub delay: u32,
    /// Least and largest delay that explain the responses about as well.
    pub delays: [u32; 2],
    /// Relative standard deviations of kp and kv.
    pub deviation: [f64; 2],
    /// 95 % intervals of kp, of kv and of the cut-off of the velocity filter (Hz).
    pub intervals: [Interval95; 3],
    /// Path of the setpoint.
    pub path: SetpointPath,
    /// 95 % intervals of the parameters of the path: cut-off or natural frequency (Hz), damping ratio, feed-forward.
    pub path_intervals: Vec<Interval95>,
    /// Comparison of the paths that were tried.
    pub comparisons: Vec<PathComparison>,
    /// Viscous friction equivalent to the joint's friction, for each level, Nms/rad (Ns/m), or 1/s if torque was not
    /// measured.
    pub friction: Vec<f64>,
    /// Relative standard deviation of the inertia, if torque was measured.
    pub inertia_deviation: Option<f64>,
    /// Elastic gear, if torque was measured and shows one.
    pub gear: Option<Gear>,
    /// Relative rms error of the modelled torque, if torque was measured.
    pub torque_residual: Option<f64>,
    /// Ratio of the cost with the second-best delay to the cost with the best one.
    pub delay_margin: f64,
}

/// Fit of a path and a delay.
#[derive(Clone)]
struct Candidate {
    path: SetpointPath,
    rates: Rates,
    drive: Drive,
    minimum: Minimum,
    /// Equivalent friction at each level, without measured torque.
    friction: Vec<f64>,
}

impl Candidate {
    fn cost(&self) -> f64 {
        self.minimum.cost
    }

    /// True if the parameters of its path are those of a path: a feed-forward from zero to about one.
    fn is_plausible(&self) -> bool {
        let forward = self.drive.velocity_feed_forward;
        let feeds = matches!(self.path, SetpointPath::FeedForward | SetpointPath::FilterAndFeedForward);
        !feeds || (LEAST_FEED_FORWARD..1.2).contains(&forward)
    }
}

/// Fits the servo and its delay, which replaces that of `rates`. The `lag` of the joint behind its setpoint, and its `viscous`
/// friction divided by its inertia (1/s), are used if torque is not measured. Returns `None` if the responses don't
/// determine the servo.
#[must_use]
pub fn fit(levels: &[AmplitudeLevel], rates: Rates, lag: Lag, viscous: f64) -> Option<Gains> {
    let mut responses = Measurement { levels, lag, viscous, weights: None };
    let least = |all: &[Candidate]| all.iter().map(Candidate::cost).fold(f64::INFINITY, f64::min);
    let ratio = rates.servo_ticks_per_cycle;
    let with_delay = |path: SetpointPath, delay: u32, start: Option<&Candidate>| {
        Measurement::candidate(&responses, path, Rates { delay, ..rates }, start)
    };
    let cycles = whole_cycles(|cycles| with_delay(SetpointPath::Direct, cycles * ratio, None))?;
    let mut direct: Vec<Candidate> = within_a_cycle(cycles * ratio, ratio)
        .filter_map(|delay| with_delay(SetpointPath::Direct, delay, None))
        .collect();
    let best_of = |all: &[Candidate]| all.iter().min_by(|a, b| a.cost().total_cmp(&b.cost())).cloned();
    let mut first = best_of(&direct)?;
    if responses.measures_torque() {
        // The motion within an interval depends on the inertia, which the first fit gives.
        for _ in 0..TURNS {
            first.drive.inertia = load::fit(levels, &first.drive, first.rates)?.fast_inertia;
            first = responses.candidate(SetpointPath::Direct, first.rates, Some(&first))?;
        }
        let bound = REFINED * first.cost();
        let near = direct.iter().filter(|c| c.cost() <= bound || c.rates == first.rates);
        direct =
            near.filter_map(|c| responses.candidate(SetpointPath::Direct, c.rates, Some(&first))).collect();
        first = best_of(&direct)?;
    }
    let mut paths = vec![direct];
    // Without torque, errors of the model of friction look like other paths.
    let others = if responses.measures_torque() { &SetpointPath::ALL[1..] } else { &[] };
    for &path in others {
        // The lag of a filter looks like a longer delay.
        let delays = (0..first.rates.delay / ratio).map(|cycles| cycles * ratio).chain([first.rates.delay]);
        let trials: Vec<Candidate> =
            delays.filter_map(|delay| with_delay(path, delay, Some(&first))).collect();
        let Some(trial) = best_of(&trials) else { continue };
        if TRIED * trial.cost() < first.cost() {
            let delays = within_a_cycle(trial.rates.delay, ratio);
            let fitted = delays.filter_map(|delay| with_delay(path, delay, Some(&first)));
            paths.push(fitted.filter(Candidate::is_plausible).collect());
        }
    }
    paths.retain(|fitted| !fitted.is_empty());
    let best = paths.iter().map(|fitted| least(fitted)).fold(f64::INFINITY, f64::min);
    let comparisons = paths
        .iter()
        .map(|fitted| PathComparison { path: fitted[0].path, cost_over_best: least(fitted) / best });
    let comparisons: Vec<PathComparison> = comparisons.collect();
    let mut selected = paths.into_iter().find(|fitted| least(fitted) < CLEARLY * best)?;
    if responses.measures_torque() {
        // The weights are those of the selected path. Paths are compared without them: small errors of the model, with weights
        // that are sharper than these errors, look like another path.
        let mut best = best_of(&selected)?;
        for _ in 0..TURNS {
            best.drive.inertia = load::fit(levels, &best.drive, best.rates)?.fast_inertia;
            responses.weigh(&best);
            best = responses.candidate(best.path, best.rates, Some(&best))?;
        }
        selected =
            selected.iter().filter_map(|c| responses.candidate(c.path, c.rates, Some(&best))).collect();
    }
    selected.sort_by(|a, b| a.cost().total_cmp(&b.cost()));
    let mut gains = responses.gains(&selected)?;
    gains.comparisons = comparisons;
    Some(gains)
}

/// Returns the delay in whole interface cycles with the least cost: they are tried from none on, until longer ones fit worse.
fn whole_cycles(fitted: impl Fn(u32) -> Option<Candidate>) -> Option<u32> {
    let mut best: Option<(u32, f64)> = None;
    for cycles in 0..=MAX_DELAY_CYCLES {
        let cost = fitted(cycles).map_or(f64::INFINITY, |candidate| candidate.cost());
        match best {
            Some((least, lowest)) if cost >= lowest => {
                if cycles - least >= WORSE_CYCLES {
                    break;
                }
            }
            _ => best = cost.is_finite().then_some((cycles, cost)).or(best),
        }
    }
    Some(best?.0)
}

/// Delays up to one interface cycle of `ratio` servo ticks about a delay, in servo ticks; all of the first cycle.
fn within_a_cycle(delay: u32, ratio: u32) -> RangeInclusive<u32> {
    delay.saturating_sub(ratio)..=ratio.max(delay + ratio - 1).min(MAX_DELAY_CYCLES * ratio)
}

/// Measurements to which a servo is fitted.
struct Measurement<'a> {
    levels: &'a [AmplitudeLevel],
    lag: Lag,
    viscous: f64,
    /// Weights of the lines of [`pairs`], from a fit without them.
    weights: Option<Vec<Weight>>,
}

/// Weight of a line, and its position response without the noise of its error.
///
/// The error of the torque is `d = C + (D/B) (y − A) − τ̄`. Noise of y is part of d and of the derivatives of d, so that the
/// minimum of the sum of |d|² has too small a D/B: a filter that is too low. With the regression of y on d subtracted, the
/// derivatives have no part that is correlated with d.
#[derive(Clone, Copy, Debug)]
struct Weight {
    /// Standard deviation of the error of the torque.
    size: f64,
    /// Position response without the regression on the error.
    position: Complex<f64>,
    /// Torque of the difference to the measured position response.
    torque: Complex<f64>,
    /// Standard deviation of the noise alone.
    noise: f64,
}

impl Measurement<'_> {
    /// Sets the weights from the responses at the lines that are not excited: with no setpoint there, the torque that the
    /// servo of `fitted` does not explain is noise. They stay as they are if a level has no such lines.
    fn weigh(&mut self, fitted: &Candidate) {
        if let Some(weights) = self.weights_of(fitted) {
            self.weights = Some(weights);
        }
    }

    fn weights_of(&self, fitted: &Candidate) -> Option<Vec<Weight>> {
        let interval = Interval::new(&fitted.drive, fitted.rates);
        let mut weights = Vec::new();
        let mut errors = Vec::new();
        for level in self.levels {
            let per_position = |hz: f64| {
                let r = interval.responses(hz)?;
                Some([r.torque_of_force / r.position_of_force, Complex::new(-1.0, 0.0)])
            };
            let covariances = level.background.as_ref()?.covariances(per_position)?;
            let torque = level.torque.as_ref()?;
            for ((position, torque), of) in level.position.iter().zip(torque).zip(covariances) {
                let r = interval.responses(position.hz)?;
                let error = r.torque(position.value) - torque.value;
                let noise = of.error.sqrt();
                // The part of the error that can be noise.
                let share = (NOISE_AT_MOST * noise / error.norm().max(f64::MIN_POSITIVE)).min(1.0);
                let shift = of.position_error * error * (share / of.error.max(f64::MIN_POSITIVE));
                errors.push([error.norm(), torque.value.norm()]);
                weights.push(Weight {
                    size: noise,
                    position: position.value - shift,
                    torque: r.torque_of_force / r.position_of_force * shift,
                    noise,
                });
            }
        }
        let of_model = model_error(&weights, &errors);
        for (weight, [_, torque]) in weights.iter_mut().zip(errors) {
            weight.size = weight.size.hypot(of_model * torque);
        }
        Some(weights)
    }

    /// Estimates and intervals from fits of one path with several delays, the best one first.
    fn gains(&self, fitted: &[Candidate]) -> Option<Gains> {
        let mut best = fitted.first()?.clone();
        let load = match self.measures_torque() {
            true => Some(load::fit(self.levels, &best.drive, best.rates)?),
            false => None,
        };
        if let Some(load) = &load {
            best.drive.inertia = load.fast_inertia;
        }
        let likely = |c: &&Candidate| c.cost() < LIKELY_DELAY * best.cost();
        let measured = load.is_some();
        let logarithms = if measured { 4 } else { 3 };
        let mut all: Option<Vec<Interval95>> = None;
        let mut deviation = None;
        for candidate in fitted.iter().filter(likely) {
            let deviations = candidate.minimum.deviations(&self.places(), CORRELATED_OVER)?;
            deviation.get_or_insert([deviations[0], deviations[1]]);
            let of = |(i, (x, d)): (usize, (&f64, &f64))| {
                let is_forward = i >= logarithms
                    && candidate.drive.velocity_feed_forward != 0.0
                    && i + 1 == candidate.minimum.x.len();
                if is_forward { Interval95::of(*x, *d) } else { Interval95::of_logarithm(x.exp(), *d) }
            };
            let intervals: Vec<Interval95> =
                candidate.minimum.x.iter().zip(&deviations).enumerate().map(of).collect();
            all = Some(match all {
                None => intervals,
                Some(before) => before.iter().zip(&intervals).map(|(a, b)| a.union(b)).collect(),
            });
        }
        let all = all?;
        let delays = || fitted.iter().filter(likely).map(|c| c.rates.delay);
        let second = fitted.get(1).map_or(f64::INFINITY, Candidate::cost);
        let interval = Interval::new(&best.drive, best.rates);
        let noise = |at: usize, torque: &Point| {
            self.weights.as_ref().and_then(|weights| weights.get(at)).map_or(torque.noise, |w| w.noise)
        };
        let torque = pairs(self.levels)
            .enumerate()
            .filter(|(at, (_, torque))| noise(*at, torque) < HEARD * torque.value.norm())
            .filter_map(|(_, (p, t))| Some((interval.responses(p.hz)?.torque(p.value), t.value)))
            .collect::<Vec<_>>();
        let load = load.as_ref();
        Some(Gains {
            drive: Drive { inertia: load.map_or(1.0, |load| load.inertia), ..best.drive },
            delay: best.rates.delay,
            delays: [delays().min()?, delays().max()?],
            deviation: deviation?,
            intervals: [all[0], all[1], all[2]],
            path: best.path,
            path_intervals: all[logarithms..].to_vec(),
            comparisons: Vec::new(),
            friction: load.map_or_else(|| best.friction.clone(), |load| load.friction.clone()),
            inertia_deviation: load.map(|load| load.deviation),
            gear: load.and_then(|load| load.gear),
            torque_residual: measured.then(|| relative(torque.into_iter())),
            delay_margin: second / best.cost(),
        })
    }

    /// Places of the residuals of the responses: the logarithm of the frequency.
    fn places(&self) -> Vec<f64> {
        let points = self.levels.iter().flat_map(|level| &level.position);
        points.flat_map(|point| [point.hz.ln(); 2]).collect()
    }

    fn measures_torque(&self) -> bool {
        self.levels.iter().all(|level| level.torque.is_some())
    }

    /// Fits a path and a delay, from the parameters of another fit if there is one.
    fn candidate(&self, path: SetpointPath, rates: Rates, from: Option<&Candidate>) -> Option<Candidate> {
        match self.measures_torque() {
            true => self.with_torque(path, rates, from),
            false => self.without_torque(path, rates, from),
        }
    }

    /// Fits a path and a delay to measured torques. The gains do not depend on the load, apart from the motion within an
    /// interval, for which the inertia is that of the drive.
    fn with_torque(&self, path: SetpointPath, rates: Rates, from: Option<&Candidate>) -> Option<Candidate> {
        let levels = self.levels;
        let drive = match from {
            Some(from) => from.drive,
            None => rough(levels, &rates)?,
        };
        let drive_of = |x: &[f64]| {
            let direct = Drive {
                kp: x[0].exp(),
                kv: x[1].exp(),
                velocity_filter_hz: x[2].exp(),
                current_loop_hz: x[3].exp(),
                inertia: drive.inertia,
                velocity_feed_forward: 0.0,
                setpoint_filter: SetpointFilterModel::None,
            };
            path.of(&x[4..], direct)
        };
        let mut start =
            vec![drive.kp.ln(), drive.kv.ln(), drive.velocity_filter_hz.ln(), drive.current_loop_hz.ln()];
        match from.filter(|from| from.path == path) {
            Some(from) => start.extend(&from.minimum.x[4..]),
            None => start.extend(path.start(drive.kp)),
        }
        let minimum = minimise(&start, |x| {
            let interval = Interval::new(&drive_of(x), rates);
            let mut residuals = Vec::new();
            for (at, (position, torque)) in pairs(levels).enumerate() {
                let r = interval.responses(position.hz)?;
                let weight = self.weights.as_ref().and_then(|weights| weights.get(at));
                let error = match weight {
                    Some(weight) => (r.torque(weight.position) + weight.torque - torque.value) / weight.size,
                    None => {
                        let through = (r.torque_of_force / r.position_of_force).norm() * position.noise;
                        let size = f64::hypot(torque.noise + through, MODEL_ERROR * torque.value.norm());
                        (r.torque(position.value) - torque.value) / size
                    }
                };
                residuals.extend([error.re, error.im]);
            }
            residuals.push(beyond(x[2], FILTER_OF_RATE / rates.servo_period_s, FILTER_WITHIN));
            residuals.push(beyond(x[3], CURRENT_LOOP_HZ, CURRENT_LOOP_WITHIN));
            residuals.extend(path.priors(&x[4..], drive.kp));
            Some(residuals)
        })?;
        let drive = drive_of(&minimum.x);
        Some(Candidate { path, rates, drive, minimum, friction: Vec::new() })
    }

    /// Fits a path and a delay to positions alone: kv is divided by the inertia.
    fn without_torque(
        &self,
        path: SetpointPath,
        rates: Rates,
        from: Option<&Candidate>,
    ) -> Option<Candidate> {
        let Self { levels, lag, viscous, .. } = *self;
        let ticks_beyond = rates.delay.saturating_sub(rates.servo_ticks_per_cycle);
        let corner = corner_hz(&levels.first()?.position, f64::from(ticks_beyond) * rates.servo_period_s)?;
        let drive_of = |x: &[f64]| {
            let direct = Drive {
                kp: x[0].exp(),
                kv: x[1].exp(),
                velocity_filter_hz: x[2].exp(),
                current_loop_hz: CURRENT_LOOP_HZ,
                inertia: 1.0,
                velocity_feed_forward: 0.0,
                setpoint_filter: SetpointFilterModel::None,
            };
            path.of(&x[3..], direct)
        };
        let friction_of = |x: &[f64], level: &AmplitudeLevel| {
            viscous + (2.0 / std::f64::consts::PI).sqrt() * lag.at_rest * (x[0] + x[1]).exp() / level.speed
        };
        let error_per_speed = lag.error_per_speed(rates);
        let filter_hz = FILTER_OF_RATE / rates.servo_period_s;
        let start_kp = TAU * corner;
        let residuals = |x: &[f64]| {
            let drive = drive_of(x);
            let interval = Interval::new(&drive, rates);
            let mut residuals = Vec::new();
            for level in levels {
                let b = friction_of(x, level);
                for point in &level.position {
                    let model = interval.responses(point.hz)?.position_with_friction(b, TAU * point.hz);
                    let size = f64::hypot(point.noise, MODEL_ERROR * point.value.norm());
                    let error = (model - point.value) / size;
                    residuals.extend([error.re, error.im]);
                }
            }
            residuals.push(beyond(x[2], filter_hz, FILTER_WITHIN));
            if let Some(measured) = error_per_speed {
                let Drive { kp, kv, velocity_feed_forward: forward, .. } = drive;
                let model = ((1.0 - forward) * kv + viscous) / (kp * kv) + drive.setpoint_filter.lag_s();
                residuals.push((model - measured) * kp / SLOW_ERROR);
            }
            residuals.extend(path.priors(&x[3..], start_kp));
            Some(residuals)
        };
        let start = |kp: f64, kv: f64, filter_hz: f64| {
            let direct = [kp.ln(), kv.ln(), filter_hz.ln()];
            minimise(&[&direct[..], &path.start(kp)].concat(), residuals)
        };
        let minimum = match from {
            Some(from) if from.path == path => minimise(&from.minimum.x, residuals)?,
            Some(from) => start(from.drive.kp, from.drive.kv, from.drive.velocity_filter_hz)?,
            None => {
                let starts = [2.0, 5.0].into_iter();
                let found = starts.filter_map(|stiffer| start(start_kp, stiffer * start_kp, filter_hz));
                found.min_by(|a, b| a.cost.total_cmp(&b.cost))?
            }
        };
        let friction = levels.iter().map(|level| friction_of(&minimum.x, level)).collect();
        let drive = drive_of(&minimum.x);
        Some(Candidate { path, rates, drive, minimum, friction })
    }
}

/// Relative error of the model with which the sum of the squares of the weighted `errors` (absolute, and torque) is their
/// number.
fn model_error(weights: &[Weight], errors: &[[f64; 2]]) -> f64 {
    let is_too_small = |of_model: f64| {
        let square = |(weight, [error, torque]): (&Weight, &[f64; 2])| {
            (error / weight.noise.hypot(of_model * torque)).powi(2)
        };
        weights.iter().zip(errors).map(square).sum::<f64>() > weights.len() as f64
    };
    let [mut low, mut high] = MODEL_ERRORS.map(f64::ln);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        if is_too_small(middle.exp()) {
            low = middle;
        } else {
            high = middle;
        }
    }
    high.exp()
}

/// Frequency at which the phase reaches −45°, near the corner of the position loop, Hz. The phase does not count that of a
/// delay beyond one interface cycle (`beyond_s`, s).
#[must_use]
fn corner_hz(position: &[Point], beyond_s: f64) -> Option<f64> {
    let phase = |p: &&Point| (p.value * Complex::from_polar(1.0, TAU * p.hz * beyond_s)).arg();
    Some(position.iter().find(|p| phase(p) < -TAU / 8.0).or(position.last())?.hz)
}

/// Residual of a prior on a logarithm: its distance from the logarithm of the `likely` value, divided by the logarithm
/// of the tolerance factor `within`.
fn beyond(logarithm: f64, likely: f64, within: f64) -> f64 {
    (logarithm - likely.ln()) / within.ln()
}

/// Returns pairs of position and torque responses at all excited frequencies of all amplitude levels; empty without
/// measured torque.
fn pairs(levels: &[AmplitudeLevel]) -> impl Iterator<Item = (&Point, &Point)> {
    levels.iter().flat_map(|level| level.position.iter().zip(level.torque.iter().flatten()))
}

/// Returns initial gains from a continuous-time model, with h the delay of the setpoint plus half an interval:
/// `τ = K (h q_d − y) − kv jω y`, `τ = −I ω² y + b jω y`.
fn rough(levels: &[AmplitudeLevel], rates: &Rates) -> Option<Drive> {
    let low = |hz: f64| hz * rates.period_s() < 0.15;
    let late = (f64::from(rates.delay) + 0.5 * f64::from(rates.servo_ticks_per_cycle)) * rates.servo_period_s;
    let mut rows = Vec::new();
    let mut moves = Vec::new();
    for (position, torque) in pairs(levels).filter(|(p, _)| low(p.hz)) {
        let (t, s) = (position.value, torque.value);
        let jw = Complex::new(0.0, TAU * position.hz);
        rows.push(([Complex::from_polar(1.0, -TAU * position.hz * late) - t, -jw * t], s));
        moves.push(([jw * jw * t, jw * t], s));
    }
    let [stiffness, kv] = linear(&rows)?;
    let [inertia, _] = linear(&moves)?;
    let usable = stiffness > 0.0 && kv > 0.0 && inertia > 0.0;
    usable.then(|| Drive {
        kp: stiffness / kv,
        kv,
        velocity_filter_hz: FILTER_OF_RATE / rates.servo_period_s,
        current_loop_hz: CURRENT_LOOP_HZ,
        inertia,
        velocity_feed_forward: 0.0,
        setpoint_filter: SetpointFilterModel::None,
    })
}

/// Solves for two real coefficients of complex columns, by least squares.
fn linear(rows: &[([Complex<f64>; 2], Complex<f64>)]) -> Option<[f64; 2]> {
    let mut matrix = DMatrix::zeros(2 * rows.len(), 2);
    let mut right = DVector::zeros(2 * rows.len());
    for (k, (columns, value)) in rows.iter().enumerate() {
        for (c, column) in columns.iter().enumerate() {
            matrix[(2 * k, c)] = column.re;
            matrix[(2 * k + 1, c)] = column.im;
        }
        right[2 * k] = value.re;
        right[2 * k + 1] = value.im;
    }
    let solved = matrix.try_svd(true, true, f64::EPSILON, MAX_ITERATIONS)?.solve(&right, 1e-14).ok()?;
    solved.iter().all(|v| v.is_finite()).then(|| [solved[0], solved[1]])
}

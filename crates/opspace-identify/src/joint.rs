//! Identification of one joint, which moves about its initial position: amplitudes within its limits, multisines, slow
//! runs.

use crate::amplitude_level::AmplitudeLevel;
use crate::background::Background;
use crate::confidence::{Interval95, ServoIntervals};
use crate::excitation::{Multisine, odd_lines};
use crate::friction;
use crate::friction::ConstantVelocityRun;
use crate::gains;
use crate::gains::{Gains, Lag, SetpointPath};
use crate::identification::{
    COHERENT, ExcitationPlan, FitQuality, Identification, IdentificationFailure, KnownParameters, Measured,
    Servo, TorqueScale,
};
use crate::response;
use crate::response::{Realisation, distortion, frequency_response};
use crate::session::{AbortReason, Bounds, ExcitationSession, Record};
use crate::sweep::Sweep;
use crate::transfer_function;
use crate::transfer_function::{DelayedTransferFunction, Target, relative};
use opspace_control::ramp::minimum_jerk;

/// Identifies one joint of a robot that holds itself.
///
/// # Errors
/// If the robot fails, or the run is interrupted. For a joint that can't be inverted no error is returned: its
/// identification has the reason.
pub fn identify(
    session: &mut ExcitationSession<'_>,
    told: &KnownParameters,
    plan: &ExcitationPlan,
) -> Result<Identification, AbortReason> {
    let scale = match (session.measures_torque(), told.inertia) {
        (true, _) => TorqueScale::MotorCurrent,
        (false, Some(_)) => TorqueScale::Urdf,
        (false, None) => TorqueScale::Unknown,
    };
    let mut found = Identification::empty(scale);
    match (Joint { session, known: told, plan }).identify(&mut found) {
        Ok(()) => Ok(found),
        Err(IdentificationFailure::Stopped(stop)) if stop.is_final() => Err(stop),
        Err(refusal) => {
            found.refused = Some(refusal.to_string());
            Ok(found)
        }
    }
}

/// Highest excited frequency, as a fraction of the interface rate; above it, aliases and errors of the model dominate.
const BAND: f64 = 0.4;

/// Fractions of the limits that are used: of the distance to the nearest position limit, of the speed limit, and of the
/// torque that remains in addition to the holding torque.
const TRAVEL_USED: f64 = 0.3;
const SPEED_USED: f64 = 0.3;
const TORQUE_USED: f64 = 0.5;

/// Fractions of the limits at which a motion is aborted.
const TRAVEL_AT_MOST: f64 = 0.8;
const SPEED_AT_MOST: f64 = 0.9;
const TORQUE_AT_MOST: f64 = 0.95;

/// Largest distance of a joint from its initial position, rad (m), so that inertia and gravity are nearly constant.
const FURTHEST: f64 = 0.35;

/// First, small amplitude, and smallest amplitude that the encoder resolves, in encoder counts (rms).
const FIRST_COUNTS: f64 = 10.0;
const MIN_COUNTS: f64 = 20.0;

/// Time over which speed is computed as a difference, s.
const SPEED_OVER_S: f64 = 2e-3;

/// Largest number of trials to find an amplitude, and of halvings of an amplitude that is too large in the measurement.
const TRIALS: usize = 20;
const HALVED_AT_MOST: usize = 3;

/// Duration of the trial of an amplitude, and of the fade-in and fade-out of a motion, s.
const TRIAL_S: f64 = 0.5;
const FADE_S: f64 = 0.2;

/// Smallest |T| at low frequencies at which a servo follows its setpoints; it is normally near 1.
const FOLLOWS: f64 = 0.5;

/// Travel of the setpoint after a reversal, as a multiple of the lag due to friction, after which the joint moves
/// steadily.
const TURNS_WITHIN: f64 = 8.0;

/// Relative errors of torque and position above which the servo does not have the assumed structure. Without measured
/// torque, strong coupling with other joints also exceeds them: the gains would be wrong.
const TORQUE_EXPLAINED: f64 = 0.10;
const POSITION_EXPLAINED: f64 = 0.10;

/// Relative error of the torque above which the structure of the servo is doubtful.
const TORQUE_DOUBTED: f64 = 0.03;

/// Time in which a motion at constant speed settles, in time constants of the position loop, and the longest such time, s.
const SETTLES_IN: f64 = 6.0;
const SETTLES_AT_LAST_S: f64 = 3.0;

/// Displacement over which friction builds up after a reversal, at least, rad (m), and the longest time for it, s.
const PRESLIDING: f64 = 0.5e-3;
const TURNED_AT_LAST_S: f64 = 3.0;

/// Ratio of a speed to the next larger one.
const BETWEEN: f64 = 0.55;

/// Largest half-width of Coulomb friction, and of viscous friction at the highest speed, over the friction at that speed, at
/// which the two are separated.
const SEPARATED: f64 = 0.15;

/// Half-width of friction over the torque limit that is negligible: a joint without friction has no fraction of it.
const NEGLIGIBLE: f64 = 0.001;

/// Speed that the fastest run exceeds, rad/s (m/s): below it, the Stribeck effect hides viscous friction.
const ABOVE_STRIBECK: f64 = 0.1;

/// Errors of declared values that intervals without motor current include: of the viscous friction and of the inertia.
const VISCOUS_WITHIN: f64 = 0.5;
const INERTIA_WITHIN: f64 = 0.02;

/// Error of kp without motor current that the joints of an arm cause, of which the fit knows nothing: other joints give way, and
/// inertia and weight change over the motion.
const ARM_WITHIN: f64 = 0.002;

/// Errors of intervals without motor current that the friction before sliding causes, which is not in the fit: of kv and Coulomb
/// friction, and of the delay in servo ticks. Over simulated joints with random parameters, such intervals hold the truth in 90 %.
const PRESLIDING_WITHIN: f64 = 0.05;
const PRESLIDING_WITHIN_TICKS: f64 = 1.0;

/// Factors between the inertias from motor current and from URDF and rotor: from which on, by the nearer end of the interval,
/// the results are refused, and, by the farther end, doubted: below the factors 1.25 and 1/0.75, which an interval that holds
/// the inertia then always reaches.
const SCALE_REFUSED: f64 = 1.15;
const SCALE_DOUBTED: f64 = 1.18;

/// Distortion (rms outside the excited lines over rms at them) above which no linear servo can be inverted.
const LINEAR: f64 = 0.5;

/// Duration of a reversal if torque is not measured, and longest time to brake from the speed to rest, s.
const TURNS_IN_S: f64 = 0.05;
const TURNS_AT_LAST_S: f64 = 1.0;

struct Joint<'a, 'b> {
    pub session: &'a mut ExcitationSession<'b>,
    pub known: &'a KnownParameters,
    pub plan: &'a ExcitationPlan,
}

impl From<AbortReason> for IdentificationFailure {
    fn from(stop: AbortReason) -> Self {
        Self::Stopped(stop)
    }
}

impl Joint<'_, '_> {
    pub fn identify(&mut self, found: &mut Identification) -> Result<(), IdentificationFailure> {
        self.measure_levels(found)?;
        self.check_following(found)?;

        let levels: Vec<AmplitudeLevel> = (found.measured.iter())
            .map(|m| AmplitudeLevel {
                speed: m.speed,
                position: m.position.clone(),
                torque: m.torque.clone(),
                background: m.background.clone(),
            })
            .collect();
        let rates = self.known.rates(0);
        let scale = match (found.scale, self.known.inertia) {
            // Above the bandwidth of their servos, the other joints are free.
            (TorqueScale::Urdf, Some([free, _])) => free,
            _ => 1.0,
        };
        let viscous = match found.scale {
            TorqueScale::Urdf => self.known.viscous_friction,
            _ => 0.0,
        };
        let fit = |lag: Lag| {
            gains::fit(&levels, rates, lag, viscous / scale).ok_or(IdentificationFailure::Undetermined)
        };
        let rough = fit(Lag::default())?;
        let mut sweeps = self.sweeps(&rough, 1.0)?;
        let runs = |joint: &Self, sweeps: &[Sweep], gains: &Gains| -> Vec<ConstantVelocityRun> {
            let lag = joint.lag(sweeps);
            (sweeps.iter())
                .filter_map(|sweep| sweep.friction(gains, lag, joint.session.period_s()))
                .map(|p| ConstantVelocityRun { torque: scale * p.torque + viscous * p.speed, ..p })
                .collect()
        };
        // The motion is made longer until it separates Coulomb and viscous friction: runs at speeds between the others.
        for round in 1..=self.plan.extra_rounds {
            if self.is_separated(&runs(self, &sweeps, &rough)) {
                break;
            }
            let between = BETWEEN.powf(f64::from(round) / f64::from(self.plan.extra_rounds + 1));
            sweeps.extend(self.sweeps(&rough, between)?);
            sweeps.sort_by(|a, b| b.speed.total_cmp(&a.speed));
        }
        let lag = self.lag(&sweeps);
        let gains = match self.session.measures_torque() {
            true => rough,
            false => fit(lag)?,
        };
        self.rational(found, gains.delay);
        let passes = runs(self, &sweeps, &gains);
        found.equivalent_friction = scale * gains.friction[0];
        let drive = gains.drive;
        found.servo = Some(Servo {
            kp: drive.kp,
            kv: scale * drive.kv,
            velocity_filter_hz: drive.velocity_filter_hz,
            delay: gains.delay,
            current_loop_hz: self.session.measures_torque().then_some(drive.current_loop_hz),
            inertia: scale * drive.inertia,
            velocity_feed_forward: drive.velocity_feed_forward,
            setpoint_filter: drive.setpoint_filter,
            gear: gains.gear,
            friction: match found.scale {
                TorqueScale::MotorCurrent => friction::fit(&passes),
                TorqueScale::Urdf | TorqueScale::Gravity | TorqueScale::Unknown => {
                    friction::fit_with_viscous(&passes, viscous)
                }
            },
            intervals: self.intervals(found.scale, &gains, scale, &passes),
            passes,
        });
        if !self.is_separated(found.servo.as_ref().map_or(&[][..], |s| &s.passes)) {
            found.doubts.push(
                "its motion does not separate Coulomb and viscous friction: their speeds are too few or too close".to_owned(),
            );
        }
        let trust = self.fit_quality(found, &gains);
        let explained = check_explained(&trust);
        found.fit_quality = Some(trust);
        explained?;
        doubt_model(found, gains.path, gains.torque_residual);
        self.check_scale(found)
    }

    /// Returns the 95 % intervals of the estimates.
    fn intervals(
        &self,
        source: TorqueScale,
        gains: &Gains,
        scale: f64,
        passes: &[ConstantVelocityRun],
    ) -> ServoIntervals {
        let [kp, kv, velocity_filter_hz] = gains.intervals;
        let [least, most] = gains.delays.map(f64::from);
        let friction = friction::intervals(passes).filter(|_| self.is_separated(passes));
        let inertia = gains.inertia_deviation.map(|d| Interval95::of_logarithm(gains.drive.inertia, d));
        let mut all = ServoIntervals {
            kp: Some(kp),
            kv: Some(kv.scaled(scale)),
            velocity_filter_hz: Some(velocity_filter_hz),
            delay: Some(Interval95 { lower: least, upper: most }),
            inertia,
            coulomb: friction.map(|[coulomb, _]| coulomb),
            viscous: friction.map(|[_, viscous]| viscous),
        };
        if source == TorqueScale::Urdf {
            self.add_declared(&mut all, gains, scale);
        }
        all
    }

    /// Adds the errors of declared values to intervals without motor current: of the inertia, between that with the other
    /// joints free and held, and of the viscous friction, which is not estimated; and those of the friction before sliding.
    fn add_declared(&self, all: &mut ServoIntervals, gains: &Gains, scale: f64) {
        let Some([free, held]) = self.known.inertia else { return };
        let viscous = VISCOUS_WITHIN * self.known.viscous_friction / (scale * gains.drive.kv);
        let inertia = INERTIA_WITHIN + (held / free - 1.0).abs();
        let widen = |interval: Option<Interval95>, by: f64| {
            interval.map(|i| Interval95 { lower: i.lower / (1.0 + by), upper: i.upper * (1.0 + by) })
        };
        all.kp = widen(all.kp, viscous + ARM_WITHIN);
        all.kv = widen(all.kv, viscous + inertia + PRESLIDING_WITHIN);
        all.delay = all.delay.map(|delay| Interval95 {
            lower: (delay.lower - PRESLIDING_WITHIN_TICKS).max(0.0),
            upper: delay.upper + PRESLIDING_WITHIN_TICKS,
        });
        // Friction is a lag times kp kv. Errors of the two gains have opposite signs: taken as independent, they are an upper
        // bound.
        let relative =
            |interval: Interval95| interval.half_width() / (0.5 * (interval.lower + interval.upper));
        let [kp, kv, _] = gains.intervals.map(relative);
        all.coulomb = widen(all.coulomb, kp.hypot(kv) + inertia + PRESLIDING_WITHIN);
        // Errors of the model of friction look like another filter.
        all.velocity_filter_hz = None;
        all.viscous = None;
        all.inertia = None;
    }

    /// Compares the scale of torque of the motor current with that of the inertia.
    fn check_scale(&self, found: &mut Identification) -> Result<(), IdentificationFailure> {
        match (found.scale, self.known.inertia) {
            (TorqueScale::Unknown | TorqueScale::Gravity, _) => Ok(()),
            (TorqueScale::Urdf, _) => {
                found.doubts.push(
                    "without motor current nothing checks the inertia of URDF and rotor: an error of it is the same \
                     relative error of kv and friction"
                        .to_owned(),
                );
                Ok(())
            }
            (TorqueScale::MotorCurrent, None) => {
                found.doubts.push(
                    "without a rotor inertia nothing checks the torque constant of the motor current"
                        .to_owned(),
                );
                Ok(())
            }
            (TorqueScale::MotorCurrent, Some(range)) => {
                let Some(servo) = &found.servo else { return Ok(()) };
                let Some(interval) = servo.intervals.inertia else { return Ok(()) };
                let ratio =
                    |inertia: f64| inertia / inertia.clamp(range[0].min(range[1]), range[1].max(range[0]));
                let distance = |inertia: f64| ratio(inertia).ln().abs();
                let [near, far] = {
                    let [a, b] = [distance(interval.lower), distance(interval.upper)];
                    let spans = interval.lower < range[1] && interval.upper > range[0];
                    [if spans { 0.0 } else { a.min(b) }, a.max(b)]
                };
                if near > SCALE_REFUSED.ln() {
                    return Err(IdentificationFailure::WrongScale { ratio: ratio(servo.inertia) });
                }
                if far > SCALE_DOUBTED.ln() {
                    let percent = |x: f64| 100.0 * (ratio(x) - 1.0);
                    found.doubts.push(format!(
                        "the torque constant of the motor current is not confirmed: the identified inertia is {:+.0} to {:+.0} % \
                         from that of URDF and rotor",
                        percent(interval.lower),
                        percent(interval.upper)
                    ));
                }
                Ok(())
            }
        }
    }

    fn bounds(&self) -> Bounds {
        let told = self.known;
        Bounds {
            travel: TRAVEL_AT_MOST * self.room(),
            speed: SPEED_AT_MOST * told.speed_limit,
            torque: TORQUE_AT_MOST * told.torque_limit,
        }
    }

    /// Distance to the nearest position limit, rad (m).
    fn room(&self) -> f64 {
        let at = self.session.posture(self.known.joint);
        (at - self.known.lower).min(self.known.upper - at).max(0.0)
    }

    /// Largest distance that the joint moves for its identification, rad (m).
    fn travel(&self) -> f64 {
        (TRAVEL_USED * self.room()).min(FURTHEST)
    }

    /// Largest torque used for a motion, in addition to the holding torque, Nm (N).
    fn spare_torque(&self) -> f64 {
        let holds = self.session.torque(self.known.joint).unwrap_or(0.0).abs();
        TORQUE_USED * (self.known.torque_limit - holds).max(0.0)
    }

    /// Returns the largest safe amplitude (rms; rad, m): starting from a small one, amplitudes are tried briefly and
    /// raised as the limits allow.
    fn amplitude(&mut self, excitation: &Multisine) -> Result<f64, IdentificationFailure> {
        let most = self.travel() / excitation.crest();
        let least = MIN_COUNTS * self.known.resolution;
        let mut rms = (FIRST_COUNTS * self.known.resolution).max(1e-6).min(most);
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
                return Err(IdentificationFailure::NoRoom { reached: next, least });
            }
            if next < 1.2 * rms && factor > 0.4 {
                return Ok(next);
            }
            rms = next;
        }
        Ok(rms)
    }

    /// Measures all amplitudes, the largest first; if a measurement exceeds the bounds, all amplitudes are halved.
    fn measure_levels(&mut self, found: &mut Identification) -> Result<(), IdentificationFailure> {
        let samples = (self.plan.period_s / self.session.period_s()).round() as usize;
        let lines = odd_lines(1, (BAND * samples as f64) as usize, self.plan.lines_per_decade);
        let excitations: Vec<Multisine> = (0..self.plan.realisations as u64)
            .map(|k| {
                let seed = self.plan.seed.wrapping_mul(1000) + 100 * self.known.joint as u64 + k;
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

    /// Tries an amplitude `rms` (rad, m) and returns the factor by which it could be larger.
    fn trial(&mut self, excitation: &Multisine, rms: f64) -> Result<f64, AbortReason> {
        let period_s = self.session.period_s();
        let holds = self.session.torque(self.known.joint).unwrap_or(0.0);
        let ticks = (TRIAL_S / period_s) as usize;
        let (record, body) = self.excite(excitation, rms, ticks)?;
        let position = &record.position[body.clone()];
        let over = ((SPEED_OVER_S / period_s).round() as usize).max(1);
        let span = over as f64 * period_s;
        let speed: Vec<f64> = position.windows(over + 1).map(|w| (w[over] - w[0]) / span).collect();
        let torque: Vec<f64> = match self.known.inertia {
            _ if !record.torque.is_empty() => record.torque[body].iter().map(|t| t - holds).collect(),
            // Smallest torque that the motion needs.
            Some([_, held]) => speed.windows(over + 1).map(|w| held * (w[over] - w[0]) / span).collect(),
            None => Vec::new(),
        };
        let share = |limit: f64, values: &[f64]| limit / Record::peak(values).max(1e-12);
        Ok(share(SPEED_USED * self.known.speed_limit, &speed).min(share(self.spare_torque(), &torque)))
    }

    /// Runs an excitation with amplitude `rms` (rad, m) for `ticks` interface cycles, with a fade-in before and a
    /// fade-out after them. Returns the record, and the range of these cycles in it.
    fn excite(
        &mut self,
        excitation: &Multisine,
        rms: f64,
        ticks: usize,
    ) -> Result<(Record, std::ops::Range<usize>), AbortReason> {
        let fade = (FADE_S / self.session.period_s()).ceil() as usize;
        let total = fade + ticks + fade;
        let bounds = self.bounds();
        let window = move |k: usize| minimum_jerk(k.min(total - 1 - k) as f64, fade as f64)[0];
        let offsets = (0..total).map(|k| rms * window(k) * excitation.at(k));
        let record = self.session.run_trajectory(self.known.joint, offsets, &bounds)?;
        self.session.rest(0.1)?;
        Ok((record, fade..fade + ticks))
    }

    /// Measures all realisations at one amplitude.
    fn measure(
        &mut self,
        excitations: &[Multisine],
        rms: f64,
        lines: &[usize],
    ) -> Result<Measured, AbortReason> {
        let period_s = self.session.period_s();
        let (mut position, mut torque) = (Vec::new(), Vec::new());
        for excitation in excitations {
            let samples = excitation.samples.len();
            let (record, body) = self.excite(excitation, rms, (1 + self.plan.periods) * samples)?;
            // The response settles in the first period.
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
            background: Background::new(&position, &torque, lines, period_s),
        })
    }

    fn check_following(&self, found: &Identification) -> Result<(), IdentificationFailure> {
        let Some(largest) = found.measured.first() else { return Err(IdentificationFailure::Undetermined) };
        // Far below the bandwidth of any position loop.
        let gain = largest.position.first().map_or(0.0, |point| point.value.norm());
        if gain < FOLLOWS {
            let hz = largest.position.first().map_or(0.0, |point| point.hz);
            return Err(IdentificationFailure::DoesNotFollow { hz, gain });
        }
        let distortion = largest.distortion.total();
        if distortion > LINEAR { Err(IdentificationFailure::NotLinear { distortion }) } else { Ok(()) }
    }

    /// Fits a rational model of T at the largest amplitude, with the lowest order above which the residual decreases
    /// little.
    fn rational(&self, found: &mut Identification, delay: u32) {
        let Some(largest) = found.measured.first() else { return };
        let weight = |p: &response::Point| 1.0 / f64::hypot(p.noise, 0.01 * p.value.norm());
        let targets: Vec<Target> = (largest.position.iter())
            .filter(|p| p.coherence > COHERENT)
            .map(|p| Target { hz: p.hz, value: p.value, weight: weight(p) })
            .collect();
        let delay_s = f64::from(delay) * self.known.servo_period_s;
        for degrees in [(0, 2), (1, 3), (2, 4), (3, 5)] {
            if targets.len() < 2 * (degrees.0 + degrees.1) {
                break;
            }
            let fitted = transfer_function::fit(&targets, degrees, self.session.period_s(), delay_s);
            let Some(model) = fitted.filter(DelayedTransferFunction::is_stable) else { continue };
            let residual = model.residual(&targets);
            if found.rational_residual.is_none_or(|before| residual < 0.8 * before) {
                found.rational = Some(model);
                found.rational_residual = Some(residual);
            }
        }
    }

    /// Moves back and forth at constant speeds, from fast to slow, `slower` times the largest one first. At a slower speed,
    /// friction makes a reversal take longer.
    fn sweeps(&mut self, gains: &Gains, slower: f64) -> Result<Vec<Sweep>, IdentificationFailure> {
        let period_s = self.session.period_s();
        let told = self.known;
        let drive = gains.drive;
        let settle_s = (SETTLES_IN / drive.kp).clamp(0.15, SETTLES_AT_LAST_S);
        let window_s = 0.25;
        let fastest = (0.15 * told.speed_limit).min(self.travel() / (settle_s + 0.5 * window_s));
        let mut speed = slower * fastest;
        let mut sweeps: Vec<Sweep> = Vec::new();
        while sweeps.len() < self.plan.speeds && speed * window_s > MIN_COUNTS * told.resolution {
            let friction = sweeps.last().and_then(|s| s.friction(gains, self.lag(&sweeps), period_s));
            let behind = friction.map_or(0.0, |p| p.torque.max(0.0)) / (drive.kv * drive.kp);
            let turned_s = (TURNS_WITHIN * behind.max(PRESLIDING)) / speed;
            // Slower, a reversal would not be over, and friction too small.
            if turned_s > TURNED_AT_LAST_S {
                break;
            }
            let seconds = settle_s.max(turned_s) + 0.5 * window_s;
            match self.sweep(speed, speed * seconds, gains) {
                Ok(record) => sweeps.push(Sweep { speed, half: 0.5 * speed * window_s, record }),
                // Speeds that are too high are skipped.
                Err(stop) if !stop.is_final() => {}
                Err(stop) => return Err(stop.into()),
            }
            speed *= BETWEEN;
        }
        Ok(sweeps)
    }

    /// Fits a line of lag over speed to the faster half of the sweeps, where static friction has no effect. Without
    /// friction the line passes through the origin: noise would give it a negative lag at rest.
    fn lag(&self, sweeps: &[Sweep]) -> Lag {
        let period_s = self.session.period_s();
        let lags: Vec<(f64, f64)> = (sweeps.iter().take(sweeps.len().div_ceil(2)))
            .filter_map(|s| Some((s.measured_speed(period_s)?, s.lag(period_s)?)))
            .collect();
        line_of_lags(&lags)
    }

    /// True if runs at constant speeds separate Coulomb and viscous friction.
    fn is_separated(&self, passes: &[ConstantVelocityRun]) -> bool {
        let Some([coulomb, viscous]) = friction::intervals(passes) else { return false };
        let (mut fastest, mut largest) = (0.0, 0.0);
        for pass in passes {
            fastest = f64::max(fastest, pass.speed);
            largest = f64::max(largest, pass.torque);
        }
        if fastest < ABOVE_STRIBECK {
            return false;
        }
        // Without a scale of torque, that of the torque limit is another one.
        let has_scale = self.session.measures_torque() || self.known.inertia.is_some();
        let negligible = if has_scale { NEGLIGIBLE * self.known.torque_limit } else { 0.0 };
        let widest = f64::max(coulomb.half_width(), fastest * viscous.half_width());
        widest < f64::max(SEPARATED * largest, negligible)
    }

    /// Moves back and forth twice at a speed, with gentle reversals, and returns to the start.
    fn sweep(&mut self, speed: f64, reach: f64, gains: &Gains) -> Result<Record, AbortReason> {
        let period_s = self.session.period_s();
        // A reversal uses a part of the available torque.
        let slew = match self.session.measures_torque() {
            true => 0.3 * self.spare_torque() / gains.drive.inertia,
            false => 2.0 * speed / TURNS_IN_S,
        };
        // Lower bound, even with little available torque: a joint that never reverses would never return.
        let slew = slew.max(speed / TURNS_AT_LAST_S);
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
        offsets.extend((0..fade).map(|k| at * (1.0 - minimum_jerk((k + 1) as f64, fade as f64)[0])));
        let bounds = self.bounds();
        let record = self.session.run_trajectory(self.known.joint, offsets.into_iter(), &bounds)?;
        self.session.rest(0.1)?;
        Ok(record)
    }

    /// Relative rms error of the modelled T at the largest amplitude, over coherent lines.
    fn position_residual(&self, found: &Identification) -> f64 {
        let points = found.measured.first().map_or(&[][..], |m| &m.position);
        let coherent = points.iter().filter(|p| p.coherence > COHERENT);
        relative(coherent.filter_map(|p| Some((found.model(self.known, p.hz)?, p.value))))
    }

    fn fit_quality(&self, found: &Identification, gains: &Gains) -> FitQuality {
        let points = found.measured.first().map_or(&[][..], |m| &m.position);
        let explained = (0..points.len()).take_while(|&line| found.explains(self.known, line)).last();
        let identified = match found.scale {
            TorqueScale::MotorCurrent => Some(gains.drive.inertia),
            _ => None,
        };
        FitQuality {
            bandwidth_hz: explained.map_or(0.0, |line| points[line].hz),
            position_residual: self.position_residual(found),
            torque_residual: gains.torque_residual,
            deviation: gains.deviation,
            setpoint_paths: gains.comparisons.clone(),
            delay_margin: gains.delay_margin,
            inertia_over_urdf: identified
                .zip(self.known.inertia)
                .map(|(i, [free, held])| i / (0.5 * (free + held))),
        }
    }
}

/// Line through lags (rad, m) over speeds (rad/s, m/s): through the origin if it would have a negative lag at rest.
fn line_of_lags(lags: &[(f64, f64)]) -> Lag {
    let n = lags.len() as f64;
    let sum = |of: fn(&(f64, f64)) -> f64| lags.iter().map(of).sum::<f64>();
    let (v, e, vv, ve) = (sum(|l| l.0), sum(|l| l.1), sum(|l| l.0 * l.0), sum(|l| l.0 * l.1));
    let per_speed = (n * ve - v * e) / (n * vv - v * v);
    let line = Lag { at_rest: (e - per_speed * v) / n, per_speed };
    let line = if line.at_rest > 0.0 { line } else { Lag { at_rest: 0.0, per_speed: ve / vv } };
    if line.per_speed.is_finite() && line.per_speed > 0.0 { line } else { Lag::default() }
}

/// Rms of the measured velocity, rad/s (m/s), limited by the encoder's resolution.
fn speed(realisations: &[Realisation], period_s: f64) -> f64 {
    let over = ((SPEED_OVER_S / period_s).round() as usize).max(1);
    let (mut power, mut count) = (0.0, 0.0);
    for w in realisations.iter().flat_map(|r| &r.periods).flat_map(|p| p.windows(over + 1)) {
        power += ((w[over] - w[0]) / (over as f64 * period_s)).powi(2);
        count += 1.0;
    }
    f64::sqrt(power / f64::max(count, 1.0)).max(f64::MIN_POSITIVE)
}

/// Adds doubts about the structure of the servo.
fn doubt_model(found: &mut Identification, path: SetpointPath, torque_residual: Option<f64>) {
    if path != SetpointPath::Direct {
        let words = "its responses show feed-forward or a filter of the setpoint, which may stand for another structure: \
                     compare it with the settings of the drive";
        found.doubts.push(words.to_owned());
    }
    if let Some(error) = torque_residual.filter(|error| *error > TORQUE_DOUBTED) {
        found.doubts.push(format!(
            "the servo explains its torque only within {:.1} %, and its intervals may be too narrow",
            100.0 * error
        ));
    }
}

fn check_explained(trust: &FitQuality) -> Result<(), IdentificationFailure> {
    let (error, allowed) = match trust.torque_residual {
        Some(error) => (error, TORQUE_EXPLAINED),
        None => (trust.position_residual, POSITION_EXPLAINED),
    };
    if error <= allowed { Ok(()) } else { Err(IdentificationFailure::NotExplained { error, allowed }) }
}

//! Conversion of torques to positions or velocities with each joint extrapolated at its velocity up to the next setpoint.
//!
//! The transformer matches the mean motor torque of the interval in which the setpoint acts, like the
//! [emulation](crate::servo_model_transformer), but for joints that go on at the velocity that they have. It needs no
//! model of the arm: no inertia, gravity, friction or gear. For a cascade of gains kp and kv that holds its setpoints for
//! R servo ticks of period T_s, d ticks after they are sent, and whose velocity filter has settled:
//!
//! ```text
//! q_d = τ/(kv kp) + q + v (1/kp + t̄)        t̄ = (d + (R − 1)/2) T_s
//! ```
//!
//! This is equation (K10) of the paper with the position half of the interval ahead. For any other servo, the drive's law is
//! evaluated at each servo tick of the interval: Y₀ is its mean torque for a setpoint at the joint, Y₁ the mean torque per
//! unit of setpoint, and
//!
//! ```text
//! q_d = q + (τ − δ − Y₀)/Y₁
//! ```
//!
//! holds for filters, integrals, interpolation, delay and feed-forward alike. The memory of the law follows from the
//! setpoints that were sent and the positions that were measured. If the setpoints for the mean torque of one interval would
//! grow, oscillate or be large, as behind a setpoint filter, the mean torque of several intervals is matched, in which the
//! setpoint moves on with the joint.
//!
//! # Stability
//!
//! With τ = 0 the drive and the transformer act on the joint like a passive mechanism if the real part of their impedance
//! is not negative at any frequency ([`impedance`](crate::impedance)). Extrapolation takes away the damping kv of the servo,
//! and leaves an added inertia of kv times the lag of v, which does no harm. To take that inertia away too, as the
//! emulation does with a model of the arm, makes the real part negative above some ten hertz; only a rigid joint with
//! enough inertia of its own bears that.
//!
//! # Correction by current
//!
//! δ is the mean torque in excess of the desired one, low-passed at [`SETTLED_HZ`]. The servo's two gains, and the fraction
//! of the setpoint's velocity that it feeds forward, are estimated from the same measurements ([`gain_adaptation`](crate::gain_adaptation)). While their uncertainty matters for the torque, δ is
//! low-passed at up to [`UNSETTLED_HZ`] instead.
//!
//! # Twist of gears
//!
//! A drive that closes its loops on the motor does not see the positions q that the interface reports if they are those of the
//! links: the difference is the twist of the gear. Setpoints that follow q are then a feedback over the spring of the gear, and
//! with few setpoints per second its resonance grows. The measured torque shows the motor: what it exceeds the torque by that
//! the law computes from q, ε, is the effect of the twist. With ε low-passed,
//!
//! ```text
//! q_d = q + (τ − δ − ε − Y₀)/Y₁
//! ```
//!
//! follows the motor above the bandwidth of δ. Where positions are those of the motor, ε is the effect of all else that the law
//! does not know, as a setpoint filter that is not declared. Gears that are declared rigid have no twist, and ε is left out.

use crate::active_setpoints::ActiveSetpoints;
use crate::drive_timing::DriveTiming;
use crate::estimator::EstimatorParameters;
use crate::gain_adaptation::{GainAdaptation, GainAdaptationParameters};
use crate::motion_estimator::{MotionEstimator, MotionGains};
use crate::reference::Reference;
use crate::remaining_damping::RemainingDamping;
use crate::servo::ServoParameters;
use crate::servo_gains::ServoGains;
use crate::servo_inversion::{EmulationError, quiet_horizon};
use crate::servo_law::{MAX_ORDER, ServoLaw, ServoState};
use crate::setpoint_average::SetpointAverage;
use crate::transformer::{Gears, Transformer};
use nalgebra::DVector;
use opspace_backend::low_pass::{self, LowPass};
use opspace_backend::{CommandDelay, CommandKind, CommandsInForce, GravityCompensation, Sample};
use opspace_model::Data;

/// Cut-off frequency of the correction by current with known gains, Hz: a quarter of the antiresonance of a soft gear.
pub const SETTLED_HZ: f64 = 4.0;

/// Cut-off frequency of the correction by current with unknown gains, Hz.
pub const UNSETTLED_HZ: f64 = 16.0;

/// Interface period at which the cut-off frequency of ε is the interface rate, s; it is proportional to the period. Long periods
/// bring the rate near the resonances of gears. With short ones a slow ε suffices, which reacts less to the noise of rounded
/// positions, to a late current and to delays in the drive.
const TWIST_PERIOD_S: f64 = 10e-3;

/// Largest cut-off frequency of the correction by current, as a fraction of the lowest antiresonance.
const OF_ANTIRESONANCE: f64 = 0.25;

/// Cut-off frequency of the torques from which gains are estimated, Hz: below the resonance of gears.
const ESTIMATION_HZ: f64 = 8.0;

/// Uncertainty of the mean torque, as a fraction of the torque limit, at which the correction is half-way to
/// [`UNSETTLED_HZ`].
const UNSETTLED: f64 = 0.01;

/// Largest number of intervals whose mean torque is matched.
const LONGEST_HORIZON: u32 = 16;

/// Largest number of intervals without a sample over which the drives are followed: more is forgotten by them anyway.
const LONGEST_GAP: u32 = 100;

/// Fraction of the acceleration limit that the noise of a setpoint may have, rms.
const OF_ACCELERATION: f64 = 0.08;

/// Fraction of the jerk limit that this noise may have if it changes within one cycle. A rounding error changes by √12 times its rms
/// value at most: by 55 % of the limit.
const OF_JERK: f64 = 0.16;

/// Cycles after which an estimate of a constant acceleration has settled.
const SETTLING_CYCLES: u32 = 2000;

/// Fraction of the torque limit above which a drive counts as saturated.
const SATURATED: f64 = 0.97;

/// Bound on δ, as a multiple of the torque limit.
const LIMIT: f64 = 3.0;

/// Parameters of the extrapolation: servos and timing of the robot.
#[derive(Clone, Debug)]
pub struct ExtrapolationSetup {
    /// Servos (n): either all position servos or all velocity servos.
    pub servos: Vec<ServoParameters>,
    /// Torque limit of each drive (n; Nm, N).
    pub torque_limits: Vec<f64>,
    /// Timing of the drives.
    pub timing: DriveTiming,
    /// Estimate of the velocities.
    pub estimator: EstimatorParameters,
    /// Side that compensates gravity: the robot or the controller.
    pub gravity_compensated_by: GravityCompensation,
    /// True if brakes hold a velocity robot, with motors off, until its first setpoint acts. Ignored for a position
    /// robot, which its servos hold.
    pub has_brakes: bool,
    /// Gears between the motors and the links.
    pub gears: Gears,
    /// Lowest frequency at which a link swings on its gear, Hz, if the stiffness of gears is known: the correction by current
    /// remains below a quarter of it.
    pub antiresonance_hz: Option<f64>,
    /// Limits of the noise of setpoints (n); `None`, or empty, for joints whose drives do not limit the acceleration of
    /// setpoints.
    pub setpoint_noise: Vec<Option<SetpointNoise>>,
    /// Damping that is left to each joint (n), because the true gains are not known exactly.
    pub remaining_damping: Vec<RemainingDamping>,
    /// Estimation of gains from measured motor torques and correction by them, if motor torques are measured.
    pub current: Option<GainAdaptationParameters>,
}

/// Noise of measured positions that must not reach the acceleration and the jerk of setpoints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SetpointNoise {
    /// Rms noise of measured positions, rad (m).
    pub position_noise: f64,
    /// Largest acceleration of setpoints, rad/s² (m/s²).
    pub acceleration_limit: f64,
    /// Largest jerk of setpoints, rad/s³ (m/s³), if it is limited.
    pub jerk_limit: Option<f64>,
}

impl SetpointNoise {
    /// Rms noise that the acceleration of setpoints may have, rad/s² (m/s²), with a setpoint every `period_s` (s). More noise
    /// meets the limits, and delays setpoints more than a slower filter would.
    fn allowed(&self, period_s: f64) -> f64 {
        let of_jerk = self.jerk_limit.map_or(f64::INFINITY, |limit| OF_JERK * limit * period_s);
        of_jerk.min(OF_ACCELERATION * self.acceleration_limit)
    }
}

/// Transformer that extrapolates each joint: see the [module](self).
#[derive(Clone, Debug)]
pub struct ExtrapolatingTransformer {
    takes: CommandKind,
    joints: Vec<Joint>,
    /// Inertia that each drive adds to its joint (n; kg m², kg).
    added_inertia: Vec<f64>,
    ticks: DriveTiming,
    /// Time between two interface cycles, s.
    period_s: f64,
    gravity_compensated_by: GravityCompensation,
    has_brakes: bool,
    active: ActiveSetpoints,
    /// Setpoints sent at the last interface cycle, if `was_sent` (n; rad, m or rad/s, m/s).
    sent: DVector<f64>,
    was_sent: bool,
    /// Velocities at the last sample (n; rad/s, m/s).
    velocity: DVector<f64>,
    /// True if the controller is to use these velocities.
    filters_positions: bool,
    /// Interface cycles since the last sample.
    elapsed: u32,
    /// True after the first setpoint was sent; before, the robot holds itself.
    begun: bool,
    /// Setpoints of the last call of `transform`.
    given: DVector<f64>,
    /// Number of consecutive setpoints that were sent unchanged.
    known: u32,
    /// Desired torque minus δ of the setpoints of the present cycle, and those of the setpoints that act (n; Nm, N).
    asked: DVector<f64>,
    in_force: CommandsInForce,
}

/// One joint: its drive, and the correction.
#[derive(Clone, Debug)]
struct Joint {
    law: ServoLaw,
    motion: MotionEstimator,
    reference: Reference,
    /// Memory of the drive at the last sample.
    memory: ServoState,
    /// Moving averages of the drive's setpoint at the last sample, and those of the ticks that are extrapolated.
    average: SetpointAverage,
    ahead: SetpointAverage,
    /// Setpoint at the servo tick before the last sample, averaged.
    setpoint: f64,
    /// Number of intervals whose mean torque is matched.
    horizon: u32,
    /// Time by which setpoints lead a joint of constant velocity, s.
    lead_s: f64,
    /// Sum of the torques of these intervals per unit of setpoint.
    response: f64,
    /// Damping that is left to the joint.
    remaining_damping: RemainingDamping,
    torque_limit: f64,
    current: Option<Correction>,
}

/// Correction of a joint by measured motor torque.
#[derive(Clone, Debug)]
struct Correction {
    /// Excess torque δ, Nm (N).
    excess: f64,
    /// Excess torque ε over that of the law at the measured positions, Nm (N), and its gain per interval.
    twist: f64,
    twist_gain: f64,
    /// Gain of δ per interval, from settled to unsettled.
    gains: [f64; 2],
    estimation: Option<Estimation>,
}

/// Estimation of a servo's two gains and of its feed-forward.
#[derive(Clone, Debug)]
struct Estimation {
    adaptation: GainAdaptation,
    nominal: ServoGains,
    now: ServoGains,
    /// Nominal torque per velocity of the setpoint, Nms/rad (Ns/m); 0 without feed-forward.
    feed_forward: f64,
    /// Estimated excess over it.
    excess_feed_forward: f64,
    /// Responses per unit of stiffness, of damping and of excess feed-forward.
    responses: [f64; 3],
    /// Measured torque, and torques of the nominal stiffness, damping and feed-forward.
    low_pass: LowPass<4>,
}

/// Means over the time since the last sample.
#[derive(Clone, Copy, Debug, Default)]
struct Interval {
    torque: f64,
    /// Torque beyond the torque limit of the drive.
    clipped: f64,
    /// Difference of setpoint and position.
    error: f64,
    /// Velocity of the setpoint.
    setpoint_velocity: f64,
}

impl Joint {
    fn new(setup: &ExtrapolationSetup, i: usize, ticks: DriveTiming) -> Result<Self, EmulationError> {
        let servo = &setup.servos[i];
        let law = ServoLaw::new(servo, ticks.servo_period_s)?;
        let period_s = ticks.period_s();
        let gains = match setup.setpoint_noise.get(i) {
            Some(Some(noise)) => {
                MotionGains::of_limited(noise.position_noise, noise.allowed(period_s), period_s)
            }
            _ => MotionGains::Difference {
                gain: low_pass::gain(setup.estimator.velocity_filter_hz.get(), period_s),
            },
        };
        let ServoGains { stiffness, damping } = servo.gains(ticks.servo_period_s);
        let static_response = if servo.takes() == CommandKind::Velocity { damping } else { stiffness };
        let horizon = quiet_horizon(&law, ticks, static_response, LONGEST_HORIZON)?;
        Ok(Self {
            motion: MotionEstimator::new(gains, period_s),
            reference: Reference::new(gains, period_s),
            horizon,
            lead_s: servo.setpoint_lead_s(),
            response: response(&law, ticks, horizon),
            memory: [0.0; MAX_ORDER],
            average: law.setpoint_average(),
            ahead: law.setpoint_average(),
            setpoint: 0.0,
            remaining_damping: setup.remaining_damping[i],
            torque_limit: setup.torque_limits[i],
            current: setup.current.map(|parameters| Correction::new(setup, i, &law, horizon, &parameters)),
            law,
        })
    }

    fn excess(&self) -> f64 {
        self.current.as_ref().map_or(0.0, |current| current.excess)
    }

    fn twist(&self) -> f64 {
        self.current.as_ref().map_or(0.0, |current| current.twist)
    }

    /// Corrects the joint with the `measured` mean torque of the last interval. `asked` is the torque that was asked for, if
    /// the setpoints were those of this transformer; the torque of others is emulated.
    fn correct(&mut self, servo_period_s: f64, measured: f64, interval: Interval, asked: Option<f64>) {
        let Some(current) = &mut self.current else { return };
        // A drive at its torque limit shows no longer what it would produce: its law does.
        let is_saturated = measured * interval.clipped.signum() > SATURATED * self.torque_limit;
        let measured = if is_saturated { measured + interval.clipped } else { measured };
        let mut unsettled = 0.0;
        if let Some(estimation) = &mut current.estimation {
            unsettled = estimation.update(&mut self.law, measured, interval, servo_period_s)
                / (UNSETTLED * self.torque_limit);
            self.response = estimation.response();
        }
        let expected = asked.unwrap_or(interval.torque);
        let [settled, fastest] = current.gains;
        let gain = settled + (fastest - settled) * unsettled / (1.0 + unsettled);
        let excess = current.excess + gain * (measured - expected - current.excess);
        let limit = LIMIT * self.torque_limit;
        current.excess = excess.clamp(-limit, limit);
        let twist = current.twist + current.twist_gain * (measured - interval.torque - current.twist);
        current.twist = twist.clamp(-limit, limit);
    }
}

impl Correction {
    fn new(
        setup: &ExtrapolationSetup,
        joint: usize,
        law: &ServoLaw,
        horizon: u32,
        parameters: &GainAdaptationParameters,
    ) -> Self {
        let period_s = setup.timing.period_s();
        let servo = &setup.servos[joint];
        let fastest_hz = setup.antiresonance_hz.map_or(f64::INFINITY, |hz| OF_ANTIRESONANCE * hz);
        let estimation =
            servo.has_two_gains().then(|| Estimation::new(setup, joint, law, horizon, parameters));
        Self {
            excess: 0.0,
            twist: 0.0,
            twist_gain: match setup.gears {
                Gears::Rigid => 0.0,
                Gears::Elastic => low_pass::gain(period_s / (TWIST_PERIOD_S * TWIST_PERIOD_S), period_s),
            },
            gains: [SETTLED_HZ, UNSETTLED_HZ].map(|hz| low_pass::gain(hz.min(fastest_hz), period_s)),
            estimation,
        }
    }
}

impl Estimation {
    fn new(
        setup: &ExtrapolationSetup,
        joint: usize,
        law: &ServoLaw,
        horizon: u32,
        parameters: &GainAdaptationParameters,
    ) -> Self {
        let period_s = setup.timing.period_s();
        let servo = &setup.servos[joint];
        let nominal = servo.gains(setup.timing.servo_period_s);
        let feed_forward = servo.velocity_feed_forward() * nominal.damping;
        let adaptation =
            GainAdaptation::of_filtered(parameters, setup.torque_limits[joint], period_s, ESTIMATION_HZ);
        Self {
            adaptation: if feed_forward > 0.0 { adaptation.with_feed_forward() } else { adaptation },
            nominal,
            now: nominal,
            feed_forward,
            excess_feed_forward: 0.0,
            responses: responses(law, nominal, setup.timing, horizon),
            low_pass: LowPass::new(ESTIMATION_HZ, period_s),
        }
    }

    /// Updates the gains of the law, and returns the uncertainty of the mean torque that is due to them, Nm (N).
    fn update(&mut self, law: &mut ServoLaw, measured: f64, interval: Interval, servo_period_s: f64) -> f64 {
        let fed_forward = self.excess_feed_forward * interval.setpoint_velocity;
        let velocity =
            (self.now.stiffness * interval.error + fed_forward - interval.torque) / self.now.damping;
        let nominal = self.nominal;
        let torques = [
            measured,
            nominal.stiffness * interval.error,
            nominal.damping * velocity,
            self.feed_forward * interval.setpoint_velocity,
        ];
        let [measured, regressors @ ..] = self.low_pass.update(&torques);
        let (before, excess_before) = (self.now, self.excess_feed_forward);
        let [stiffness, damping, excess] = self.adaptation.update(measured, regressors);
        self.now =
            ServoGains { stiffness: stiffness * nominal.stiffness, damping: damping * nominal.damping };
        if self.feed_forward > 0.0 {
            self.excess_feed_forward = excess * self.feed_forward;
            law.add_feed_forward(-excess_before, servo_period_s);
            law.retune(before, self.now);
            law.add_feed_forward(self.excess_feed_forward, servo_period_s);
        } else {
            law.retune(before, self.now);
        }
        self.adaptation.uncertainty(regressors)
    }

    /// Response with the present gains, in which it is linear.
    fn response(&self) -> f64 {
        let [of_stiffness, of_damping, of_feed_forward] = self.responses;
        of_stiffness * self.now.stiffness
            + of_damping * self.now.damping
            + of_feed_forward * self.excess_feed_forward
    }
}

/// Inertia that the drive adds to a joint of constant acceleration, whose position and velocity the estimate knows late, and
/// whose acceleration it does not know.
fn added_inertia(joint: &Joint, ticks: DriveTiming) -> f64 {
    let period_s = ticks.period_s();
    let mut estimate = joint.motion;
    estimate.start(0.0, 0.0);
    for cycle in 1..=SETTLING_CYCLES {
        let t = f64::from(cycle) * period_s;
        estimate.update(1, 0.5 * t * t);
    }
    let t = f64::from(SETTLING_CYCLES) * period_s;
    let (behind, slower) = (0.5 * t * t - estimate.position, t - estimate.velocity);
    let mut memory = [0.0; MAX_ORDER];
    let mut torque = 0.0;
    for tick in 0..ticks.delay + ticks.servo_ticks_per_cycle {
        let t = f64::from(tick) * ticks.servo_period_s;
        let now = joint.law.step(&mut memory, 0.0, behind + t * (slower + 0.5 * t));
        torque += if tick < ticks.delay { 0.0 } else { now };
    }
    (-torque / f64::from(ticks.servo_ticks_per_cycle)).max(0.0)
}

/// Sum of the torques of `horizon` intervals per unit of setpoint.
fn response(law: &ServoLaw, timing: DriveTiming, horizon: u32) -> f64 {
    let ratio = timing.servo_ticks_per_cycle;
    let (mut memory, mut average) = ([0.0; MAX_ORDER], law.setpoint_average());
    let mut unit = |tick| average.step(timing.setpoints.at(0.0, 1.0, tick, ratio));
    (0..horizon * ratio).map(|tick| law.step(&mut memory, unit(tick), 0.0)).sum()
}

/// Responses per unit of stiffness and of damping, of a law with these two gains, and per unit of feed-forward that is added.
fn responses(law: &ServoLaw, gains: ServoGains, timing: DriveTiming, horizon: u32) -> [f64; 3] {
    let mut stiffer = *law;
    stiffer.retune(gains, ServoGains { stiffness: 2.0 * gains.stiffness, ..gains });
    let mut fed_forward = *law;
    fed_forward.add_feed_forward(1.0, timing.servo_period_s);
    let whole = response(law, timing, horizon);
    let of_stiffness = response(&stiffer, timing, horizon) - whole;
    [
        of_stiffness / gains.stiffness,
        (whole - of_stiffness) / gains.damping,
        response(&fed_forward, timing, horizon) - whole,
    ]
}

impl ExtrapolatingTransformer {
    /// Returns the transformer for a robot at rest.
    ///
    /// # Errors
    /// Index of the first joint whose servo cannot be inverted, and the reason.
    pub fn new(setup: &ExtrapolationSetup) -> Result<Self, (usize, EmulationError)> {
        let n = setup.servos.len();
        let ticks = setup.timing;
        let takes = setup.servos.first().map_or(CommandKind::Position, ServoParameters::takes);
        let joint = |i: usize| {
            let kind = setup.servos[i].takes();
            if kind != takes {
                return Err((i, EmulationError::Mixed { takes: kind, others: takes }));
            }
            Joint::new(setup, i, ticks).map_err(|error| (i, error))
        };
        let period_s = setup.timing.period_s();
        let zero = DVector::zeros(n);
        let joints = (0..n).map(joint).collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            takes,
            added_inertia: joints.iter().map(|joint| added_inertia(joint, ticks)).collect(),
            joints,
            ticks,
            period_s,
            gravity_compensated_by: setup.gravity_compensated_by,
            has_brakes: setup.has_brakes && takes == CommandKind::Velocity,
            active: ActiveSetpoints::new(n, ticks),
            sent: zero.clone(),
            was_sent: false,
            velocity: zero.clone(),
            filters_positions: setup.setpoint_noise.iter().any(Option::is_some),
            elapsed: 1,
            begun: false,
            in_force: CommandsInForce::new(
                n,
                CommandDelay::of_ticks(ticks.delay, ticks.servo_ticks_per_cycle),
            ),
            asked: zero.clone(),
            given: zero,
            known: 0,
        })
    }

    /// Estimates the motion of all joints, and follows the drives from the last sample to this one: their memory, and the
    /// means of the interval.
    fn follow(&mut self, sample: &Sample) {
        let ticks = self.ticks;
        let measured = sample.motor_torque.as_ref().filter(|_| self.elapsed == 1);
        let intervals = self.elapsed.min(LONGEST_GAP);
        let all_ticks = intervals * ticks.servo_ticks_per_cycle;
        let share = 1.0 / f64::from(all_ticks);
        let was_asked = self.known >= self.in_force.kept();
        for (i, joint) in self.joints.iter_mut().enumerate() {
            let estimated = joint.motion.position;
            joint.motion.update(u64::from(self.elapsed), sample.q[i]);
            if !self.begun {
                continue;
            }
            let from = joint.motion.before(self.elapsed, estimated);
            let step = (joint.motion.position - from) * share;
            let mut mean = Interval::default();
            let setpoint_before = joint.setpoint;
            for tick in 0..all_ticks {
                let new = self.was_sent.then_some(self.sent.as_slice());
                let setpoint = joint.average.step(self.active.during(ticks, i, tick, new));
                let position = from + step * f64::from(tick);
                let torque = joint.law.step(&mut joint.memory, setpoint, position);
                mean.torque += share * torque;
                mean.clipped += share * (torque - torque.clamp(-joint.torque_limit, joint.torque_limit));
                mean.error += share * (setpoint - position);
                joint.setpoint = setpoint;
            }
            mean.setpoint_velocity = (joint.setpoint - setpoint_before) * share / ticks.servo_period_s;
            if let Some(measured) = measured {
                let asked = was_asked.then(|| self.in_force.mean(i));
                joint.correct(ticks.servo_period_s, measured[i], mean, asked);
            }
        }
        for _ in 0..if self.begun { intervals } else { 0 } {
            let new = std::mem::take(&mut self.was_sent).then_some(self.sent.as_slice());
            self.active.advance(ticks, new);
        }
    }

    /// Sets all drives to rest at the measured position: the robot holds itself.
    fn hold(&mut self, data: &Data) {
        for (i, joint) in self.joints.iter_mut().enumerate() {
            let is_loaded =
                !self.has_brakes && self.gravity_compensated_by == GravityCompensation::Controller;
            let load = if is_loaded { data.gravity[i] } else { 0.0 };
            let (memory, setpoint) = joint.law.rest(joint.motion.position, load);
            joint.memory = memory;
            joint.average.rest(setpoint);
            joint.setpoint = setpoint;
            self.active.hold(i, setpoint);
        }
    }
}

impl Transformer for ExtrapolatingTransformer {
    fn takes(&self) -> CommandKind {
        self.takes
    }

    fn observe(&mut self, sample: &Sample) -> Option<&[f64]> {
        self.follow(sample);
        self.elapsed = 1;
        for (velocity, joint) in self.velocity.iter_mut().zip(&self.joints) {
            *velocity = joint.motion.velocity;
        }
        self.filters_positions.then_some(self.velocity.as_slice())
    }

    fn added_inertia(&self) -> &[f64] {
        &self.added_inertia
    }

    fn uses_reference_motion(&self) -> bool {
        true
    }

    fn set_reference_motion(&mut self, velocity: &[f64], acceleration: &[f64]) {
        for (joint, (&v, &a)) in self.joints.iter_mut().zip(velocity.iter().zip(acceleration)) {
            joint.reference.velocity = v;
            joint.reference.advance(a, self.period_s);
        }
    }

    fn is_damped(&self) -> bool {
        self.joints.iter().any(|joint| joint.remaining_damping.damping > 0.0)
    }

    fn damping_torque(&self, velocity: &[f64], torques: &mut [[f64; 2]]) {
        for (torques, (joint, v)) in torques.iter_mut().zip(self.joints.iter().zip(velocity)) {
            *torques = joint.remaining_damping.torques(*v, joint.reference.velocity);
        }
    }

    fn transform(&mut self, data: &Data, tau: &[f64], q_desired: &mut [f64]) {
        if !self.begun {
            self.hold(data);
        }
        let ticks = self.ticks;
        let ratio = ticks.servo_ticks_per_cycle;
        for (i, joint) in self.joints.iter_mut().enumerate() {
            let (q, reference) = (joint.motion.position, &joint.reference);
            let v = joint.motion.velocity + reference.anticipated;
            let torque = tau[i] - joint.excess() - joint.remaining_damping.torque(v, reference.velocity);
            let acceleration = reference.acceleration;
            let position = |tick: u32| {
                let t = f64::from(tick) * ticks.servo_period_s;
                q + t * (v + 0.5 * t * acceleration)
            };
            let mut memory = joint.memory;
            joint.ahead.copy_from(&joint.average);
            for tick in 0..ticks.delay {
                let setpoint = joint.ahead.step(self.active.at(ticks, i, tick));
                joint.law.step(&mut memory, setpoint, position(tick));
            }
            // Y₀ is computed with the measured position or velocity as setpoint, so that the solution is a small
            // difference with little rounding.
            let about = if self.takes == CommandKind::Velocity { v } else { q };
            // Later setpoints move with the joint, and lead it by what its velocity takes.
            let period_s = self.period_s;
            let lead_s = joint.lead_s + f64::from(ticks.delay) * ticks.servo_period_s + 0.5 * period_s;
            let (mut rate, rate_change) = match self.takes {
                CommandKind::Velocity => (acceleration, 0.0),
                _ => (v + acceleration * lead_s, acceleration * period_s),
            };
            let mut missing = f64::from(joint.horizon * ratio) * (torque - joint.twist());
            let (mut from, mut to) = (self.active.left(ticks, i), about);
            for interval in 0..joint.horizon {
                for tick in 0..ratio {
                    let setpoint = joint.ahead.step(ticks.setpoints.at(from, to, tick, ratio));
                    let at = ticks.delay + interval * ratio + tick;
                    missing -= joint.law.step(&mut memory, setpoint, position(at));
                }
                (from, to) = (to, to + rate * period_s);
                rate += rate_change;
            }
            q_desired[i] = about + missing / joint.response;
            self.asked[i] = torque;
        }
        self.in_force.push(self.asked.as_slice());
        self.given.copy_from_slice(q_desired);
    }

    fn sent(&mut self, data: &Data, q_desired: &[f64]) {
        if !self.begun {
            self.hold(data);
            self.begun = true;
        }
        self.sent.copy_from_slice(q_desired);
        self.was_sent = true;
        self.known = if self.given.as_slice() == q_desired { self.known.saturating_add(1) } else { 0 };
    }

    fn missed(&mut self, periods: u64) {
        self.known = 0;
        self.joints.iter_mut().for_each(|joint| joint.reference.end());
        self.elapsed = self.elapsed.saturating_add(u32::try_from(periods).unwrap_or(u32::MAX));
    }

    fn reset(&mut self) {
        self.begun = false;
        self.known = 0;
        self.was_sent = false;
        self.elapsed = 1;
        for joint in &mut self.joints {
            joint.motion.reset();
            joint.reference.end();
        }
        self.active.settle(self.ticks);
        for current in self.joints.iter_mut().filter_map(|joint| joint.current.as_mut()) {
            (current.excess, current.twist) = (0.0, 0.0);
        }
    }
}

//! Discrete-time law of a servo, linear for every servo structure.
//!
//! ```text
//! τ = c x + d_r q_d + d_y y        x ← A x + b_r q_d + b_y y
//! ```
//!
//! y is the position that the servo reads at the servo tick, x is its memory. For a velocity servo, the setpoint is a
//! velocity instead of q_d. A servo that [averages](crate::setpoint_average) its setpoints has their mean in place of
//! q_d. The simulated drives run this law, and the emulating transformer predicts with it.

use crate::servo_gains::ServoGains;
use crate::setpoint_average::{self, AverageTicks, MAX_TICKS, SetpointAverage};
use crate::setpoint_filter::SetpointFilter;
use nalgebra::{Complex, DMatrix, DVector};
use opspace_backend::low_pass;
use opspace_backend::quantity::Positive;
use std::f64::consts::TAU;
use std::ops::{Add, Mul, Sub};
use thiserror::Error;

/// Largest number of memory entries: the largest order of a transfer function, and that of a cascade with an integral, a
/// filter of second order and acceleration feed-forward.
pub const MAX_ORDER: usize = 6;

/// Bound on memory and setpoint at rest: larger values are rounding errors of a singular system without a solution.
const LARGEST: f64 = 1e12;

/// Memory entry of the setpoint of the servo tick before, of a servo without an integral.
pub(crate) const SETPOINT_BEFORE: usize = 2;

/// Memory of a servo from one servo tick to the next.
pub type ServoState = [f64; MAX_ORDER];

/// Reason why a servo is invalid.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum ServoError {
    /// Order higher than [`MAX_ORDER`].
    #[error("the transfer function has order {order}; at most {MAX_ORDER} is supported")]
    Order {
        /// Order of the longer polynomial.
        order: usize,
    },
    /// Improper transfer function: its torque would depend on future errors.
    #[error("denominator[0] is zero or missing: the torque would depend on future errors")]
    Improper,
    /// Transfer function that is zero: no error produces a torque.
    #[error("the numerator is zero: no position error would produce a torque")]
    NoTorque,
    /// Setpoint velocity that is fed forward twice.
    #[error(
        "derivative_of = \"error\" differentiates the setpoint already: velocity_feed_forward must be 0 or absent"
    )]
    FeedForwardTwice,
    /// Derivative without a filter.
    #[error(
        "damping_nms_per_rad multiplies a filtered finite difference: derivative_filter_hz is required, unless the damping is zero"
    )]
    UnfilteredDerivative,
    /// Moving average over more servo ticks than [`MAX_TICKS`].
    #[error("a moving average of the setpoint over {ticks} servo ticks; at most {MAX_TICKS} are supported")]
    Average {
        /// Number of servo ticks.
        ticks: f64,
    },
    /// Servo that has no setpoint for a constant torque at rest.
    #[error("this servo cannot hold a torque at rest: no constant position error produces one")]
    HoldsNothing,
}

/// Law of a servo, evaluated once per servo tick.
#[derive(Clone, Copy, Debug)]
pub struct ServoLaw {
    order: usize,
    next: [Form; MAX_ORDER],
    torque: Form,
    average: AverageTicks,
    /// Memory and setpoint at rest: at position 1 with torque 0, and at position 0 with torque 1.
    rest: [(ServoState, f64); 2],
}

/// Weighted sum of a servo's memory and inputs.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Form {
    memory: ServoState,
    setpoint: f64,
    position: f64,
}

impl Form {
    pub const SET_POINT: Self = Self { memory: [0.0; MAX_ORDER], setpoint: 1.0, position: 0.0 };
    pub const POSITION: Self = Self { memory: [0.0; MAX_ORDER], setpoint: 0.0, position: 1.0 };

    /// Entry of the memory.
    pub fn memory(i: usize) -> Self {
        let mut form = Self::default();
        form.memory[i] = 1.0;
        form
    }

    fn value(&self, memory: &[f64], setpoint: f64, position: f64) -> f64 {
        let given = self.setpoint * setpoint + self.position * position;
        self.memory.iter().zip(memory).fold(given, |sum, (weight, value)| sum + weight * value)
    }
}

impl Add for Form {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            memory: std::array::from_fn(|i| self.memory[i] + other.memory[i]),
            setpoint: self.setpoint + other.setpoint,
            position: self.position + other.position,
        }
    }
}

impl Sub for Form {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        self + other * -1.0
    }
}

impl Mul<f64> for Form {
    type Output = Self;

    fn mul(self, scale: f64) -> Self {
        Self {
            memory: self.memory.map(|weight| scale * weight),
            setpoint: scale * self.setpoint,
            position: scale * self.position,
        }
    }
}

impl ServoLaw {
    /// Returns the law of a loop with what it needs at rest, and the averages of its setpoint.
    ///
    /// # Errors
    /// If the loop cannot hold a torque at rest, or an average is too long.
    pub(crate) fn completed(self, filter: Option<SetpointFilter>, period_s: f64) -> Result<Self, ServoError> {
        let rest = [self.solve_rest(1.0, 0.0)?, self.solve_rest(0.0, 1.0)?];
        Ok(Self { rest, average: average_ticks(filter, period_s)?, ..self })
    }

    /// Returns the law of a loop with the next values of its memory, and its torque.
    pub(crate) fn of(next: &[Form], torque: Form) -> Self {
        let mut all = [Form::default(); MAX_ORDER];
        all[..next.len()].copy_from_slice(next);
        let rest = [([0.0; MAX_ORDER], 0.0); 2];
        Self { order: next.len(), next: all, torque, average: [1; 2], rest }
    }

    /// Returns the law of a loop behind a setpoint path, whose memory follows that of the loop.
    pub(crate) fn with_path(next: &[Form], torque: Form, path: &SetpointPath) -> Self {
        let next: Vec<Form> = next.iter().chain(&path.next).copied().collect();
        Self::of(&next, path.add_acceleration(torque))
    }

    /// Solves for the memory and the setpoint at rest, at `position` with `torque`: linear equations.
    fn solve_rest(&self, position: f64, torque: f64) -> Result<(ServoState, f64), ServoError> {
        let n = self.order;
        let mut a = DMatrix::zeros(n + 1, n + 1);
        let mut b = DVector::zeros(n + 1);
        for (i, form) in self.next[..n].iter().chain([&self.torque]).enumerate() {
            for j in 0..n {
                a[(i, j)] = -form.memory[j];
            }
            a[(i, n)] = -form.setpoint;
            b[i] = form.position * position;
        }
        for i in 0..n {
            a[(i, i)] += 1.0;
        }
        b[n] -= torque;
        let solved = a.lu().solve(&b).filter(|x| x.iter().all(|v| v.abs() < LARGEST));
        let solution = solved.ok_or(ServoError::HoldsNothing)?;
        Ok((std::array::from_fn(|i| if i < n { solution[i] } else { 0.0 }), solution[n]))
    }

    /// Returns the moving averages of the servo's setpoint, with setpoints of zero; the setpoint itself if it has none.
    #[must_use]
    pub fn setpoint_average(&self) -> SetpointAverage {
        SetpointAverage::new(self.average)
    }

    /// Number of servo ticks until a setpoint no longer counts in the averages.
    pub(crate) fn average_ticks(&self) -> u32 {
        let [first, second] = self.average;
        first + second - 2
    }

    /// Number of memory entries.
    #[must_use]
    pub fn order(&self) -> usize {
        self.order
    }

    /// Sets the stiffness and the damping to `to` in place of `from`, for a servo that
    /// [has two gains](crate::ServoParameters::has_two_gains). Allocates nothing.
    pub fn retune(&mut self, from: ServoGains, to: ServoGains) {
        let error = Form::SET_POINT - Form::POSITION;
        // The torque without K e is the damping torque.
        let damped = self.torque - error * from.stiffness;
        self.torque = error * to.stiffness + damped * (to.damping / from.damping);
        // At rest with torque 1, the setpoint and its memory are one over the stiffness.
        let (memory, setpoint) = &mut self.rest[1];
        let scale = from.stiffness / to.stiffness;
        memory.iter_mut().for_each(|value| *value *= scale);
        *setpoint = 1.0 / to.stiffness;
    }

    /// Adds the torque `gain` (Nms/rad) times the setpoint's velocity, for a servo that feeds velocity forward and
    /// [has two gains](crate::ServoParameters::has_two_gains), and runs every `period_s` (s). Allocates nothing.
    pub fn add_feed_forward(&mut self, gain: f64, period_s: f64) {
        let change = Form::SET_POINT - Form::memory(SETPOINT_BEFORE);
        self.torque = self.torque + change * (gain / period_s);
    }

    /// Advances `memory` by one servo tick and returns the torque (Nm or N). `setpoint` is in rad or m (rad/s or m/s
    /// for a velocity servo), after the [averages](Self::setpoint_average) if the servo has some; `position` is the encoder reading of this tick (rad or m).
    pub fn step(&self, memory: &mut ServoState, setpoint: f64, position: f64) -> f64 {
        let now = *memory;
        let now = &now[..self.order];
        for (value, form) in memory.iter_mut().zip(&self.next[..self.order]) {
            *value = form.value(now, setpoint, position);
        }
        self.torque.value(now, setpoint, position)
    }

    /// Memory and setpoint (rad, m; rad/s, m/s for a velocity servo) of the servo at rest at `position` (rad, m) with
    /// this torque (Nm, N).
    ///
    /// A velocity servo with an integral rests under a load at a velocity setpoint of 0: its integral holds the load. A
    /// velocity servo without an integral rests only at the setpoint τ/kv (rad/s, m/s); at the setpoint 0 the load
    /// moves the joint at −τ/kv.
    #[must_use]
    pub fn rest(&self, position: f64, torque: f64) -> (ServoState, f64) {
        let [(displaced, there), (pushing, further)] = &self.rest;
        let memory = std::array::from_fn(|i| position * displaced[i] + torque * pushing[i]);
        (memory, position * there + torque * further)
    }

    /// Frequency response: torque per unit of setpoint, before averages, and torque per unit of position, for z =
    /// exp(jωTs).
    #[must_use]
    pub fn response(&self, z: Complex<f64>) -> [Complex<f64>; 2] {
        let n = self.order;
        let mut a = DMatrix::from_fn(n, n, |i, j| Complex::from(-self.next[i].memory[j]));
        for i in 0..n {
            a[(i, i)] += z;
        }
        let solve = a.lu();
        let of = |given: fn(&Form) -> f64| {
            let b = DVector::from_fn(n, |i, _| Complex::from(given(&self.next[i])));
            // At an eigenvalue of the servo the response is unbounded.
            let memory = solve.solve(&b).unwrap_or_else(|| DVector::repeat(n, Complex::from(f64::INFINITY)));
            let remembered = memory.iter().zip(self.torque.memory).map(|(x, weight)| x * weight);
            remembered.sum::<Complex<f64>>() + given(&self.torque)
        };
        [of(|form| form.setpoint) * setpoint_average::response(self.average, z), of(|form| form.position)]
    }
}

/// Numbers of servo ticks of the moving averages of a servo's setpoint.
fn average_ticks(filter: Option<SetpointFilter>, period_s: f64) -> Result<AverageTicks, ServoError> {
    let Some(SetpointFilter::MovingAverage { time_s, second_time_s }) = filter else {
        return Ok([1; 2]);
    };
    let ticks = |time_s: Positive| {
        let ticks = (time_s.get() / period_s).round().max(1.0);
        if ticks <= f64::from(MAX_TICKS) { Ok(ticks as u32) } else { Err(ServoError::Average { ticks }) }
    };
    Ok([ticks(time_s)?, second_time_s.map_or(Ok(1), ticks)?])
}

/// Filter and feed-forward of a servo's setpoint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SetpointParameters {
    /// Filter of the setpoint, if any.
    pub filter: Option<SetpointFilter>,
    /// Fraction of the setpoint's velocity that is fed forward.
    pub velocity_feed_forward: f64,
    /// Torque fed forward per acceleration of the setpoint, kg m² (kg).
    pub acceleration_feed_forward_kg_m2: f64,
}

/// Path of a setpoint to the loop: filter and feed-forward.
pub(crate) struct SetpointPath {
    /// Filtered setpoint.
    pub setpoint: Form,
    /// Velocity fed forward.
    velocity: Option<Form>,
    /// Torque fed forward for the acceleration.
    acceleration: Option<Form>,
    /// Next values of its memory.
    next: Vec<Form>,
}

impl SetpointPath {
    /// Returns the path whose memory begins at the entry `first`. Its first entry is the filtered setpoint of the servo
    /// tick before, which the differences of the feed-forward need too.
    pub fn new(parameters: SetpointParameters, first: usize, period_s: f64) -> Self {
        let SetpointParameters { filter, velocity_feed_forward, acceleration_feed_forward_kg_m2 } =
            parameters;
        let acceleration_feed_forward = acceleration_feed_forward_kg_m2;
        let before = Form::memory(first);
        let mut next = match filter {
            None | Some(SetpointFilter::MovingAverage { .. }) => vec![Form::SET_POINT],
            Some(SetpointFilter::FirstOrder { cutoff_hz }) => {
                vec![before + (Form::SET_POINT - before) * low_pass::gain(cutoff_hz.get(), period_s)]
            }
            Some(SetpointFilter::SecondOrder { natural_frequency_hz, damping_ratio }) => {
                let natural = TAU * natural_frequency_hz.get();
                let [[to_q, q_of_dq], [to_dq, dq_of_dq]] =
                    second_order(natural, damping_ratio.get(), period_s);
                // The distance from the setpoint decays.
                let (gap, rate) = (before - Form::SET_POINT, Form::memory(first + 1));
                vec![Form::SET_POINT + gap * to_q + rate * q_of_dq, gap * to_dq + rate * dq_of_dq]
            }
        };
        let setpoint = next[0];
        let rate = (setpoint - before) * (1.0 / period_s);
        let velocity = (velocity_feed_forward > 0.0).then(|| rate * velocity_feed_forward);
        let acceleration = (acceleration_feed_forward > 0.0).then(|| {
            let change = rate - Form::memory(first + next.len());
            next.push(rate);
            change * (acceleration_feed_forward / period_s)
        });
        if filter.is_none_or(|filter| filter.precedes_law()) && velocity.is_none() && acceleration.is_none() {
            next.clear();
        }
        Self { setpoint, velocity, acceleration, next }
    }

    /// Adds the velocity fed forward, times `gain`.
    pub fn add_velocity(&self, to: Form, gain: f64) -> Form {
        self.velocity.map_or(to, |velocity| to + velocity * gain)
    }

    /// Adds the torque fed forward for the acceleration.
    fn add_acceleration(&self, torque: Form) -> Form {
        self.acceleration.map_or(torque, |acceleration| torque + acceleration)
    }
}

/// Transition matrix of position and velocity over `time_s` (s) of `ẍ = −2 ζ ω ẋ − ω² x`, with ω = `natural` (rad/s) and
/// ζ = `damping_ratio`.
fn second_order(natural: f64, damping_ratio: f64, time_s: f64) -> [[f64; 2]; 2] {
    let decay = damping_ratio * natural;
    let split = natural * (1.0 - damping_ratio * damping_ratio).abs().sqrt();
    // exp(−ζ ω t) times the cosine, and times the sine over its frequency; hyperbolic if overdamped.
    let (cosine, sine) = if damping_ratio < 1.0 {
        let fading = (-decay * time_s).exp();
        (fading * (split * time_s).cos(), fading * (split * time_s).sin() / split)
    } else if split == 0.0 {
        let fading = (-decay * time_s).exp();
        (fading, fading * time_s)
    } else {
        // The slower pole, ζ ω − split, without cancellation.
        let slow = (-natural * natural / (decay + split) * time_s).exp();
        let ratio_less_one = (-2.0 * split * time_s).exp_m1();
        (slow * (1.0 + 0.5 * ratio_less_one), -slow * ratio_less_one / (2.0 * split))
    };
    [[cosine + decay * sine, sine], [-natural * natural * sine, cosine - decay * sine]]
}

/// Filtered finite difference of a quantity that changed by `change` since the last servo tick; `rate` is its previous
/// value.
pub(crate) fn filtered_rate(rate: Form, change: Form, filter_hz: f64, period_s: f64) -> Form {
    let gain = low_pass::gain(filter_hz, period_s);
    rate * (1.0 - gain) + change * (gain / period_s)
}

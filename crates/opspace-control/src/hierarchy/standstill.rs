//! Standstill of a task at a goal that it cannot reach.
//!
//! Limits, near singularities and tasks of higher priority can keep a task from its goal. Its demand a* then remains, and
//! with it a force that pulls the arm along flat directions for ever, or round a limit cycle. The demand that cannot be met is
//! therefore taken off once it is of no more use, so that the task holds the pose that it has reached:
//!
//! ```text
//! a* ← a* − s a_lost        s: 0 → 1
//! ```
//!
//! This is a reference governor without a model: as long as the reference is constant, the task is given the reachable goal
//! at which it is (Garone, Di Cairano and Kolmanovsky, *Reference and command governors for systems with constraints: A
//! survey on theory and applications*, Automatica 75, 2017). A task comes to a standstill if all of this is true:
//!
//! - its reference and those of the tasks above do not move;
//! - on the average, less than half of the acceleration that it demands is commanded; what an obstacle holds, or friction, is
//!   commanded and does not count;
//! - for 0.7 s its error has not become smaller than before by more than a stated speed, or by two hundredths per second if
//!   the motion fades.
//!
//! While s rises, a_lost follows a* with a lag of 0.1 s: the task is a damper, and the arm loses its energy. Then a_lost is
//! constant, and the task is as stiff as at a goal that it reaches. The demand returns when the reference moves, or when the
//! error differs from that at the standstill.

use nalgebra::Vector6;

/// Time without progress after which the task is brought to a standstill, s.
const STALL_S: f64 = 0.7;

/// Decrease of the error, relative to the error, that is progress of an arm whose motion fades, 1/s: what it could still
/// gain is a few hundredths of the error.
const MIN_PROGRESS_PER_S: f64 = 0.02;

/// Speed of the joints below which the motion fades, relative to the highest one: an arm that limits slow down does not.
const FADED: f64 = 0.05;

/// Time over which the average demand and the average commanded acceleration are taken, s.
const AVERAGE_S: f64 = 0.2;

/// Lag with which the error is smoothed, and with which a_lost follows the demand, s.
const SMOOTHING_S: f64 = 0.1;

/// Time over which s rises and falls, s.
const RAMP_S: f64 = 0.3;

/// Time from the begin of a standstill until a_lost is constant, s.
const BRAKING_S: f64 = 1.0;

/// Average demand below which a task is at its goal, m/s².
const MIN_DEMAND_M_PER_S2: f64 = 0.1;

/// Average norm of the joint velocities up to which the arm rests without a standstill, rad/s.
const REST_RAD_PER_S: f64 = 5e-4;

/// Part of the time in which a task must be held back, so that it is observed.
const MIN_HELD: f64 = 0.05;

/// Change of the error, relative to that at the standstill, after which the task tries again; and its least value, m.
const CHANGE: f64 = 0.1;
const MIN_CHANGE_M: f64 = 1e-3;

/// Change of the error within one period, beyond that by the arm's velocity, that is one of the reference: the distance of
/// this acceleration over the period, m/s², and at least this, m.
const JUMP_M_PER_S2: f64 = 100.0;
const MIN_JUMP_M: f64 = 1e-4;

/// Demand and command of a level in a cycle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Outcome {
    /// True if the references of the task and of those above do not move.
    pub is_constant: bool,
    /// True if limits or the damping of a near singularity change the task's acceleration.
    pub is_held_back: bool,
    /// Demanded acceleration a* of the rows, m/s².
    pub demand: Vector6<f64>,
    /// Commanded acceleration of the rows, m/s².
    pub commanded: Vector6<f64>,
    /// Velocity of the rows, m/s.
    pub velocity: Vector6<f64>,
    /// Norm of the joint velocities, rad/s.
    pub speed: f64,
}

/// Standstill of one level. All rows are scaled to displacements.
#[derive(Clone, Debug)]
pub(crate) struct Standstill {
    /// Part of the time in which the level was held back.
    held: f64,
    /// Averages of the demanded and of the commanded acceleration, m/s².
    demand: Vector6<f64>,
    commanded: Vector6<f64>,
    /// Error of the last cycle, m.
    error: Vector6<f64>,
    /// Smoothed size of the error, and its size at the last progress, m.
    size: f64,
    mark: f64,
    /// Average norm of the joint velocities, and the highest one, rad/s.
    speed: f64,
    fastest: f64,
    /// Time since the last progress, s.
    since_s: f64,
    /// Time since the standstill began; `None` if the task is not at a standstill.
    standing_s: Option<f64>,
    /// s.
    share: f64,
    /// a_lost, m/s².
    lost: Vector6<f64>,
    /// Error at the standstill, m.
    at: Vector6<f64>,
}

impl Standstill {
    pub(crate) fn new() -> Self {
        let zero = Vector6::zeros();
        Self {
            held: 0.0,
            demand: zero,
            commanded: zero,
            error: zero,
            size: f64::INFINITY,
            mark: f64::INFINITY,
            speed: 0.0,
            fastest: 0.0,
            since_s: 0.0,
            standing_s: None,
            share: 0.0,
            lost: zero,
            at: zero,
        }
    }

    /// Part s a_lost of the demand that is taken off, m/s².
    pub(crate) fn taken(&self) -> Vector6<f64> {
        self.lost * self.share
    }

    /// Share s of the lost demand that is taken off, from 0 to 1.
    pub(crate) fn share(&self) -> f64 {
        self.share
    }

    /// Returns true while the arm is braked and a_lost follows the demand.
    pub(crate) fn is_braking(&self) -> bool {
        self.standing_s.is_some_and(|standing_s| standing_s < BRAKING_S)
    }

    /// Returns true if part of the demand is taken off.
    pub(crate) fn acts(&self) -> bool {
        self.share > 0.0
    }

    /// Returns true if nothing is observed in a cycle in which the level is not held back.
    pub(crate) fn is_idle(&self) -> bool {
        self.held == 0.0 && !self.acts()
    }

    /// Ends the standstill and all observations.
    pub(crate) fn release(&mut self) {
        *self = Self { share: self.share, lost: self.lost, ..Self::new() };
    }

    /// Follows a cycle of `period_s` (s) with this `error` (m). Progress is a decrease of the error by more than
    /// `least_m_per_s` (m/s); with zero, no task comes to a standstill.
    pub(crate) fn follow(
        &mut self,
        error: &Vector6<f64>,
        cycle: &Outcome,
        least_m_per_s: f64,
        period_s: f64,
    ) {
        if !cycle.is_constant || least_m_per_s <= 0.0 || self.jumps(error, cycle, period_s) {
            self.release();
        }
        self.error = *error;
        match self.standing_s {
            Some(standing_s) => self.stand(error, cycle, standing_s, period_s),
            None => self.observe(error, cycle, least_m_per_s, period_s),
        }
    }

    /// Returns true if the reference moved since the last cycle.
    fn jumps(&self, error: &Vector6<f64>, cycle: &Outcome, period_s: f64) -> bool {
        let largest = (JUMP_M_PER_S2 * period_s * period_s).max(MIN_JUMP_M);
        self.size < f64::INFINITY && (error - self.error + cycle.velocity * period_s).norm() > largest
    }

    fn observe(&mut self, error: &Vector6<f64>, cycle: &Outcome, least_m_per_s: f64, period_s: f64) {
        self.share = (self.share - period_s / RAMP_S).max(0.0);
        self.held += (period_s / AVERAGE_S).min(1.0) * (f64::from(u8::from(cycle.is_held_back)) - self.held);
        if self.held < MIN_HELD && !cycle.is_held_back {
            self.release();
            return;
        }
        let average = (period_s / AVERAGE_S).min(1.0);
        self.demand += (cycle.demand - self.demand) * average;
        self.commanded += (cycle.commanded - self.commanded) * average;
        let size = error.norm();
        if self.size == f64::INFINITY {
            (self.size, self.mark) = (size, size);
        }
        self.size += (period_s / SMOOTHING_S).min(1.0) * (size - self.size);
        self.speed += (cycle.speed - self.speed) * average;
        self.since_s += period_s;
        self.fastest = self.fastest.max(self.speed);
        let fades = self.speed < FADED * self.fastest;
        let least_m_per_s = least_m_per_s.max(if fades { MIN_PROGRESS_PER_S * self.mark } else { 0.0 });
        if self.size < self.mark - least_m_per_s * STALL_S {
            (self.mark, self.since_s) = (self.size, 0.0);
        }
        let demand = self.demand.norm();
        if self.since_s >= STALL_S
            && self.speed > REST_RAD_PER_S
            && demand > MIN_DEMAND_M_PER_S2
            && self.commanded.norm() < 0.5 * demand
            && self.held > 0.5
        {
            self.lost = self.demand;
            self.standing_s = Some(0.0);
        }
    }

    fn stand(&mut self, error: &Vector6<f64>, cycle: &Outcome, standing_s: f64, period_s: f64) {
        self.standing_s = Some(standing_s + period_s);
        self.share = (self.share + period_s / RAMP_S).min(1.0);
        if standing_s < BRAKING_S {
            self.lost += (cycle.demand - self.lost) * (period_s / SMOOTHING_S).min(1.0);
            self.at = *error;
        } else if (error - self.at).norm() > CHANGE * self.at.norm() + MIN_CHANGE_M {
            self.release();
        }
    }
}

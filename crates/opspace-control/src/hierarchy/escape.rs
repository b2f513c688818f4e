//! Escape of a task from a singular pose in which it rests away from its goal.
//!
//! Along a lost direction u, an eigenvector of Λ⁻¹ with an eigenvalue of nearly zero, a task's demand a causes no torque:
//! J_pᵀ u = 0. If its error has a [saddle](crate::hierarchy::saddle) there, motion s of the joints in the null space leads
//! nearer to the goal, in either direction at first. The law does not take it, because nothing demands it. As an option, it
//! does: while a task escapes, its lost row is replaced by one that moves the joints along s,
//!
//! ```text
//! J_p ← J_p + f κ u sᵀM        uᵀa ← (uᵀJ_p s + f κ sᵀMs) a_s        κ² sᵀMs = λ_typical
//! a_s = k² ∫ (v_d − v) dt + 2k (v_d − v), bounded        v = sᵀM q̇/sᵀMs        v_d = v_max min(1, uᵀa/a₀) min(1, t/0.2 s)
//! ```
//!
//! with the mobility that is typical of the task. All that follows from J_p applies to it: the other rows of the task are
//! exact, the tasks above are not affected (M s is in the range of Nᵀ), those below cannot affect it, and limits count its
//! deviations like those of the task. The weight f falls from 1 at λ = 0 to 0 at the highest threshold of the task's damping,
//! from which on the task controls u itself. Several directions with such a λ count with their weights f in u.
//!
//! An escape is prepared if arm and reference have been at rest for 0.1 s, with a demand along a lost direction, and if the
//! pose is a saddle. A demand along a lost direction is suspended while an arm that was at rest waits for its reference: at a
//! saddle, a large force would set it on in a random direction. The [preview](crate::hierarchy::preview) of both directions of
//! s selects the one that ends nearer to the goal; if neither does, the arm stays. s is scaled to a speed of 1 of the fastest
//! joint, and follows the null space.
//!
//! The escape ends if λ exceeds the threshold or if the demand along lost directions vanishes; the reference then blends from
//! the pose of the arm, as after a hold. It is given up after 10 s, or if the arm moves away from the goal; the arm then rests
//! as without the option until it is demanded elsewhere.

use crate::algebra::{dot, multiply, product};
use crate::context::ControlContext;
use crate::hierarchy::displaced_task::{DisplacedTask, error};
use crate::hierarchy::mobility_spectrum::MobilitySpectrum;
use crate::hierarchy::preview::{Preview, STEPS};
use crate::hierarchy::saddle::{LostPose, Saddle};
use crate::nullspace::{Nullspace, ProjectedTask};
use crate::tasks::task::{Task, clear_free_rows};
use nalgebra::{DVector, Matrix6xX, Vector6};
use opspace_model::{Data, Model};

/// Mobility relative to the typical one below which a direction is lost. The elbow of a straight arm is then bent by less
/// than some 30 mrad, with which friction may hold it: the gain of the damped inverse for the full demand is 0.03.
const LOST: f64 = 0.01;

/// Smallest demand along lost directions, m/s²: an error of about 1 mm at 20 rad/s. Sensor noise demands less in the mean.
const DEMAND_M_PER_S2: f64 = 0.5;

/// Demand with which an escape has its full speed, m/s²: that with which the default damping is full.
const FULL_DEMAND_M_PER_S2: f64 = 4.0;

/// Highest speed of a joint at rest, rad/s or m/s. The compensation of friction shakes a simulated arm that is stuck at half
/// of it.
const REST_PER_S: f64 = 0.2;

/// Time at rest before an escape, s: much longer than a task needs to pass a singular pose, or its velocity to turn.
const REST_S: f64 = 0.1;

/// Longest time for which an arm that is stuck waits for its reference to come to rest, s.
const PATIENCE_S: f64 = 3.0;

/// Highest speed of a reference at rest, m/s or rad/s.
const REFERENCE_REST_PER_S: f64 = 1e-3;

/// Time between two searches for a way out, s.
const RETRY_S: f64 = 0.5;

/// Largest error after an escape, relative to the present one.
const NEARER: f64 = 0.95;

/// Difference of the errors after an escape in both directions that matters, relative to the present error.
const DIFFERS: f64 = 0.05;

/// Largest eigenvalue of a saddle relative to the typical mobility above which it is one. Rounding errors are 1e-8.
const SADDLE: f64 = 1e-6;

/// Speed of the fastest joint, rad/s or m/s: a wrist rotates by 90° in 3 s, as slowly as a person can watch.
const SPEED_PER_S: f64 = 0.5;

/// Time in which an escape reaches its speed, s.
const BEGINS_S: f64 = 0.2;

/// Frequency k of the control of the speed, rad/s: half of that of a usual task.
const FREQUENCY_PER_S: f64 = 10.0;

/// Largest lag ∫ (v_d − v) dt, rad or m. The integral overcomes friction.
const LAG: f64 = 0.1;

/// Largest acceleration of the fastest joint, rad/s² or m/s²: half of gravity at the end of a link of 0.5 m.
const ACCELERATION_PER_S2: f64 = 10.0;

/// Longest escape, s.
const LONGEST_S: f64 = 10.0;

/// Part of the direction s that remains in the null space from one cycle to the next, below which it is lost.
const REMAINS: f64 = 0.5;

/// Share of the threshold that the root of λ may have on the far side of the singular pose, away from the goal.
const AWAY: f64 = 0.3;

/// Escape of one priority level.
pub(crate) struct Escape {
    phase: Phase,
    row: Option<Row>,
    /// Direction s, with a largest element of 1 (n).
    direction: DVector<f64>,
    /// M s (n).
    momentum: DVector<f64>,
    spectrum: MobilitySpectrum,
    displaced: DisplacedTask,
    saddle: Saddle,
    preview: Preview,
    /// Position limits, rad or m (n each).
    lower: Vec<f64>,
    upper: Vec<f64>,
    /// Time of the last update, s.
    updated_s: f64,
    /// Smallest gain of the task's damped inverse without the escape.
    pub min_singular_gain: f64,
}

/// Phase of an escape.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// No reason to escape.
    Controlled,
    /// The arm is stuck since a time, and will be examined at another one, s. Its lost demand is suspended if `is_held`.
    Stuck { since_s: f64, examined_s: f64, is_held: bool },
    /// Number of computed steps of the previews, and the errors at the ends of those against s and along it.
    Previewed { steps: usize, errors: [f64; 2], is_held: bool },
    /// The arm escapes since a time, s; the unit vector u of the last cycle, and the lag.
    Escaping { since_s: f64, along: Vector6<f64>, lag: f64 },
    /// The escape has just ended.
    Ended,
    /// An escape failed; the arm rests.
    GivenUp,
}

/// Effect of an escape on its level in a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Effect {
    None,
    /// A row of J_p is replaced.
    Replaced,
    /// The escape has ended: the reference must begin at the pose of the arm.
    Ended,
}

/// Row that replaces the lost one.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Row {
    /// u.
    along: Vector6<f64>,
    /// f.
    weight: f64,
    /// (uᵀJ_p s + f κ sᵀMs) a_s.
    demand: f64,
    /// κ.
    scale: f64,
    /// a_s of the fastest joint, rad/s² or m/s².
    acceleration: f64,
}

/// State of a level before its escape.
pub(crate) struct EscapeInput<'a> {
    pub model: &'a Model,
    pub data: &'a Data,
    pub time_s: f64,
    pub task: &'a dyn Task,
    /// Desired acceleration of the rows.
    pub desired: Vector6<f64>,
    /// Null space of the tasks above.
    pub above: &'a Nullspace,
    /// Typical mobility of the task, 1/kg.
    pub typical: f64,
}

impl EscapeInput<'_> {
    /// Mobility from which on the task controls a direction itself, 1/kg.
    fn threshold(&self) -> f64 {
        self.task.inversion().threshold() * self.typical
    }

    fn reference_is_at_rest(&self) -> bool {
        let mut speeds = self.task.reference_speeds().into_iter().flatten();
        speeds.all(|speed| speed < REFERENCE_REST_PER_S)
    }

    /// Phase of an arm without a way out.
    fn hopeless(&self) -> Phase {
        Phase::Stuck { since_s: self.time_s, examined_s: self.time_s + RETRY_S, is_held: false }
    }
}

impl Escape {
    /// Creates the escape of a task below `above` tasks.
    pub(crate) fn new(model: &Model, context: &ControlContext, above: usize) -> Self {
        let n = model.n();
        Self {
            phase: Phase::Controlled,
            row: None,
            direction: DVector::zeros(n),
            momentum: DVector::zeros(n),
            spectrum: MobilitySpectrum::new(n),
            displaced: DisplacedTask::new(model, above),
            saddle: Saddle::new(n),
            preview: Preview::new(n),
            lower: context.limits.lower.clone(),
            upper: context.limits.upper.clone(),
            updated_s: f64::NEG_INFINITY,
            min_singular_gain: 1.0,
        }
    }

    /// Returns true if it replaces or suspends a row of the task.
    pub(crate) fn acts(&self) -> bool {
        self.row.is_some()
    }

    /// Ends an escape.
    pub(crate) fn reset(&mut self) {
        self.phase = Phase::Controlled;
        self.row = None;
    }

    /// Updates the escape and replaces the lost row of J_p (6 × n) in `projected`, which has the Λ of the task without it.
    /// `tasks_above` are the tasks above with their typical mobilities.
    pub(crate) fn update<'a>(
        &mut self,
        input: &EscapeInput<'_>,
        tasks_above: impl Iterator<Item = (&'a dyn Task, f64)> + Clone,
        projected: &mut ProjectedTask,
    ) -> Effect {
        let period_s = (input.time_s - self.updated_s).clamp(0.0, REST_S);
        self.updated_s = input.time_s;
        self.min_singular_gain = projected.space.min_singular_gain;
        self.row = None;
        let factor = &input.data.mass_matrix_factor;
        let is_singular = self.min_singular_gain < 1.0
            && input.task.inversion().is_for_control()
            && self.spectrum.update(factor, &projected.jacobian, input.task.rows());
        let was = self.phase;
        self.phase = match was {
            Phase::Escaping { .. } if !is_singular => Phase::Ended,
            _ if !is_singular => Phase::Controlled,
            Phase::Escaping { since_s, along, lag } => {
                let demand = demand(input, projected);
                self.follow(input, &projected.jacobian, &demand, period_s, (since_s, along, lag))
            }
            _ => self.wait(input, tasks_above, &projected.jacobian, &demand(input, projected)),
        };
        let Some(row) = self.row else {
            return if self.phase == Phase::Ended { Effect::Ended } else { Effect::None };
        };
        if row.weight == 0.0 {
            return Effect::None;
        }
        for (mut column, momentum) in projected.jacobian.column_iter_mut().zip(&self.momentum) {
            column += row.along * (row.weight * row.scale * momentum);
        }
        Effect::Replaced
    }

    /// Examines whether the arm is stuck, and begins an escape.
    fn wait<'a>(
        &mut self,
        input: &EscapeInput<'_>,
        tasks_above: impl Iterator<Item = (&'a dyn Task, f64)> + Clone,
        jacobian: &Matrix6xX<f64>,
        demand: &Vector6<f64>,
    ) -> Phase {
        if self.phase == Phase::GivenUp {
            let threshold = input.threshold();
            let stays = self.spectrum.part(demand, |value| fade(value / threshold)).norm() >= DEMAND_M_PER_S2;
            return if stays { Phase::GivenUp } else { Phase::Controlled };
        }
        let lost = LOST * input.typical;
        let part = self.spectrum.part(demand, |value| f64::from(u8::from(value < lost)));
        if part.norm() < DEMAND_M_PER_S2 {
            return Phase::Controlled;
        }
        let (now_s, is_at_rest) = (input.time_s, input.data.dq.amax() < REST_PER_S);
        let examined = match self.phase {
            Phase::Previewed { steps, errors, is_held } if is_at_rest => {
                self.look_ahead(input, tasks_above, &part, (steps, errors, is_held))
            }
            Phase::Stuck { since_s, examined_s, is_held } if is_at_rest => {
                let is_late = now_s > since_s + PATIENCE_S;
                if now_s >= examined_s && (is_late || input.reference_is_at_rest()) {
                    self.examine(input, tasks_above, jacobian, is_held)
                } else {
                    self.phase
                }
            }
            Phase::Stuck { since_s, is_held, .. } => {
                let is_late = now_s > since_s + PATIENCE_S;
                Phase::Stuck { since_s, examined_s: now_s + REST_S, is_held: is_held && !is_late }
            }
            _ => Phase::Stuck { since_s: now_s, examined_s: now_s + REST_S, is_held: is_at_rest },
        };
        if let Phase::Stuck { is_held: true, .. } | Phase::Previewed { is_held: true, .. } = examined {
            let along = part.normalize();
            self.row = Some(Row { along, weight: 0.0, demand: 0.0, scale: 0.0, acceleration: 0.0 });
        }
        examined
    }

    /// Searches for a way out of the pose.
    fn examine<'a>(
        &mut self,
        input: &EscapeInput<'_>,
        tasks_above: impl Iterator<Item = (&'a dyn Task, f64)> + Clone,
        jacobian: &Matrix6xX<f64>,
        is_held: bool,
    ) -> Phase {
        let EscapeInput { model, data, task, above, typical, .. } = *input;
        let (spectrum, lost) = (&self.spectrum, LOST * typical);
        let pose = LostPose { model, data, task, jacobian, above, spectrum, typical, lost };
        let direction = self.direction.as_mut_slice();
        let largest = self.saddle.steepest(&mut self.displaced, &pose, tasks_above, direction);
        let size = self.direction.amax();
        if largest < SADDLE * typical || size <= 0.0 {
            return input.hopeless();
        }
        self.direction /= size;
        self.preview.begin(&data.q, &self.direction, -1.0);
        Phase::Previewed { steps: 0, errors: [f64::INFINITY; 2], is_held }
    }

    /// Computes a step of the previews, and begins the escape after the last one.
    fn look_ahead<'a>(
        &mut self,
        input: &EscapeInput<'_>,
        tasks_above: impl Iterator<Item = (&'a dyn Task, f64)>,
        part: &Vector6<f64>,
        (steps, mut errors, is_held): (usize, [f64; 2], bool),
    ) -> Phase {
        let EscapeInput { model, data, task, .. } = *input;
        let threshold = input.threshold();
        let weight = |value: f64| fade(value / threshold);
        let limits = (self.lower.as_slice(), self.upper.as_slice());
        let error_then = self.preview.step(&mut self.displaced, (model, task), tasks_above, weight, limits);
        errors[steps / STEPS] = error_then.unwrap_or(f64::INFINITY);
        let steps = if error_then.is_some() { steps + 1 } else { (steps / STEPS + 1) * STEPS };
        if steps == STEPS {
            self.preview.begin(&data.q, &self.direction, 1.0);
        }
        if steps < 2 * STEPS {
            return Phase::Previewed { steps, errors, is_held };
        }
        let present = error(model, data, task).norm();
        let [back, forth] = errors;
        let nearest = back.min(forth);
        let goes_back = if (back - forth).abs() > DIFFERS * present {
            back < forth
        } else {
            self.room(input, -1.0) > self.room(input, 1.0)
        };
        if nearest.is_nan() || nearest > NEARER * present {
            return input.hopeless();
        }
        if goes_back {
            self.direction.neg_mut();
        }
        Phase::Escaping { since_s: input.time_s, along: part.normalize(), lag: 0.0 }
    }

    /// Way of the fastest joint to the first position limit along s (`sign` 1) or against it, rad or m.
    fn room(&self, input: &EscapeInput<'_>, sign: f64) -> f64 {
        let limits = self.lower.iter().zip(&self.upper);
        let rooms = self.direction.iter().zip(limits).zip(&input.data.q).map(|((s, (lower, upper)), q)| {
            let s = sign * s;
            let limit = if s > 0.0 { upper - q } else { q - lower };
            // A joint that hardly moves has no limit.
            if s.abs() < 1e-3 { f64::INFINITY } else { limit.max(0.0) / s.abs() }
        });
        rooms.fold(f64::INFINITY, f64::min)
    }

    /// Continues an escape: computes the row that replaces the lost one.
    fn follow(
        &mut self,
        input: &EscapeInput<'_>,
        jacobian: &Matrix6xX<f64>,
        demand: &Vector6<f64>,
        period_s: f64,
        (since_s, before, lag): (f64, Vector6<f64>, f64),
    ) -> Phase {
        let threshold = input.threshold();
        let weight = |value: f64| fade(value / threshold);
        let part = self.spectrum.part(demand, weight);
        let size = part.norm();
        let along = part / size.max(f64::MIN_POSITIVE);
        if size < 0.5 * DEMAND_M_PER_S2 || along.dot(&before) <= 0.0 {
            return Phase::Ended;
        }
        let s = self.direction.as_mut_slice();
        input.above.project_velocity(s);
        // Not of u itself, along which s moves more and more.
        self.spectrum.remove(jacobian, |value| f64::from(u8::from(value >= threshold)), s);
        let largest = self.direction.amax();
        if largest.is_nan() || largest < REMAINS || input.time_s - since_s > LONGEST_S {
            return Phase::GivenUp;
        }
        self.direction /= largest;
        let (s, momentum) = (self.direction.as_slice(), self.momentum.as_mut_slice());
        multiply(&input.data.mass_matrix, s, momentum);
        let mass = dot(s, momentum);
        let root = along.dot(&product(jacobian, s)) / mass.sqrt();
        if root < -AWAY * threshold.sqrt() {
            return Phase::GivenUp;
        }
        let velocity = dot(momentum, input.data.dq.as_slice()) / mass;
        let begun = ((input.time_s - since_s) / BEGINS_S).min(1.0);
        let behind = SPEED_PER_S * begun * (size / FULL_DEMAND_M_PER_S2).min(1.0) - velocity;
        let lag = (lag + period_s * behind).clamp(-LAG, LAG);
        let acceleration = FREQUENCY_PER_S * (FREQUENCY_PER_S * lag + 2.0 * behind);
        let acceleration = acceleration.clamp(-ACCELERATION_PER_S2, ACCELERATION_PER_S2);
        let scale = (input.typical / mass).sqrt();
        let weight = weight(self.spectrum.part(&along, |value| value).dot(&along));
        let demand = (root * mass.sqrt() + weight * scale * mass) * acceleration;
        self.row = Some(Row { along, weight, demand, scale, acceleration });
        Phase::Escaping { since_s, along, lag }
    }

    /// Replaces the lost row of the desired accelerations.
    pub(crate) fn replace_demand(&self, desired: &mut Vector6<f64>) {
        if let Some(row) = &self.row {
            *desired += row.along * (row.demand - row.along.dot(desired));
        }
    }

    /// Removes the lost row of a force.
    pub(crate) fn remove_force(&self, force: &mut Vector6<f64>) {
        if let Some(row) = &self.row {
            *force -= row.along * row.along.dot(force);
        }
    }

    /// Acceleration of the fastest joint, rad/s² or m/s²; 0 if the task does not escape.
    pub(crate) fn acceleration(&self) -> f64 {
        self.row.map_or(0.0, |row| row.acceleration)
    }
}

/// Returns the acceleration that the task demands of the rows that follow a reference, also by a force.
fn demand(input: &EscapeInput<'_>, projected: &ProjectedTask) -> Vector6<f64> {
    let mut demand = input.desired;
    if let Some(force) = input.task.force(&projected.space.task_inertia) {
        demand += force * input.typical;
    }
    clear_free_rows(input.task, &mut demand);
    demand
}

/// Returns a weight that falls from 1 at 0 to 0 at 1 and above, (1 − x²)².
fn fade(ratio: f64) -> f64 {
    let ratio = ratio.clamp(0.0, 1.0);
    (1.0 - ratio * ratio).powi(2)
}

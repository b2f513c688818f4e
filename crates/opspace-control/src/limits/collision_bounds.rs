//! Bounds on joint accelerations that keep links apart from each other and from obstacles.
//!
//! The distance d of a pair is limited as the position of a joint is (see [`bounds`](super::bounds)): after a horizon h,
//! its links must not approach each other faster than they can stop, with the braking acceleration b, at the margin m.
//! With the gradient g of d, which gives ḋ = gᵀ q̇ and d̈ = gᵀ q̈ + c:
//!
//! ```text
//! −(ḋ + d̈ h) ≤ √((b h)² + 2 b (d + ḋ h − m)) − b h
//! ```
//!
//! A pair that is closer than its margin moves apart at a bounded speed. The bound is a row −gᵀ α ≤ upper of the same
//! programs as the bounds on joints and on speeds of tasks.
//!
//! * **b** is half of Σ |g_i| b_i, the sum of what the joints' braking accelerations b_i contribute. The other half is
//!   left to joints that cannot contribute because they brake for limits of their own, and to the change of g.
//! * **c**, the acceleration of the distance for q̈ = 0, has no bound of its own: it is limited to ±b.
//! * **Ends.** Close to the margin, the ends of capsules have bounds of their own: between parallel capsules the closest
//!   points jump from end to end, and the torques would follow.
//! * **Rows that no motion of the arm can reach** are left out: those of pairs that could stop even if all joints
//!   approached at their highest speeds.
//!
//! If bounds contradict each other, those on torques and their rates take precedence; those that brake joints or pairs
//! are then widened together, as little as possible.

use crate::hierarchy::products::dot;
use crate::limits::bounds::{Bounds, JointState};
use crate::limits::collision_limits::CollisionLimits;
use crate::qp::lexicographic::SpeedBound;
use nalgebra::DVector;
use opspace_model::collision::{
    CollisionData, CollisionModel, Proximity, collision_distances, distance_bias_acceleration,
    distance_gradient, end_proximities,
};
use opspace_model::{Data, Model, Postures, kinematics};

/// Fraction of the joints' braking accelerations that brakes a pair.
const BRAKING_FRACTION: f64 = 0.5;

/// Distance beyond the margin within which the ends of capsules have bounds of their own, m.
const ENDS_WITHIN_M: f64 = 0.05;

/// Largest number of bounds in a control cycle. If there are more, the ones that allow most are left out.
const MAX_ROWS: usize = 48;

/// Smallest change of a distance with all joints, m/rad: below it, no motion changes the distance.
const IMMOVABLE: f64 = 1e-6;

/// Number of postures sampled for the distance at which a pair can no longer stop in time.
const SAMPLES: usize = 64;

/// Factor of that distance which covers what lies between the postures.
const BETWEEN_SAMPLES: f64 = 1.5;

/// Bounds of the near pairs in a control cycle.
pub(crate) struct CollisionBounds {
    geometry: CollisionModel,
    margin_m: f64,
    /// Distance beyond which no bound is needed, m.
    within_m: f64,
    horizon_s: f64,
    /// Braking acceleration of each joint, rad/s² or m/s² (n).
    braking: Vec<f64>,
    /// Highest speed of each joint, rad/s or m/s (n).
    velocity: Vec<f64>,
    near: CollisionData,
    gradient: Vec<f64>,
    /// Bounds; only the first `count` entries are in use.
    rows: Vec<SpeedBound>,
    count: usize,
    /// Smallest distance of all pairs, at most `within_m`, m.
    least_m: f64,
}

impl CollisionBounds {
    /// Creates the bounds for limits of a robot whose joints have `bounds`.
    pub(crate) fn new(model: &Model, limits: &CollisionLimits, bounds: &Bounds) -> Self {
        let geometry = limits.geometry.clone();
        // A pair has a bound for its closest points and for at most four ends.
        let rows = (5 * geometry.pairs().len()).min(MAX_ROWS);
        let row = SpeedBound { row: DVector::zeros(model.n()), upper: f64::INFINITY };
        let mut new = Self {
            margin_m: limits.margin_m,
            within_m: f64::INFINITY,
            horizon_s: bounds.horizon_s(),
            braking: bounds.braking().to_vec(),
            velocity: bounds.velocity().to_vec(),
            near: CollisionData::new(&geometry),
            gradient: vec![0.0; model.n()],
            rows: vec![row; rows],
            count: 0,
            least_m: f64::INFINITY,
            geometry,
        };
        new.within_m = new.margin_m + BETWEEN_SAMPLES * new.longest_stop_m(model);
        new
    }

    /// Largest number of bounds.
    pub(crate) fn capacity(&self) -> usize {
        self.rows.len()
    }

    /// Returns the longest way that a pair needs to stop, in many postures, m.
    fn longest_stop_m(&mut self, model: &Model) -> f64 {
        let (mut data, still) = (Data::new(model), vec![0.0; model.n()]);
        let postures = Postures::new(model, 1.0);
        let mut longest = 0.0_f64;
        for sample in 0..SAMPLES {
            kinematics(model, &mut data, &postures.posture(sample), &still);
            collision_distances(&self.geometry, model, &data, f64::INFINITY, &mut self.near);
            for (pair, proximity) in self.near.near() {
                distance_gradient(&self.geometry, model, &data, pair, proximity, &mut self.gradient);
                longest = longest.max(self.reach(&self.gradient).map_or(0.0, |reach| reach.stop_m));
            }
        }
        longest
    }

    /// Computes the bounds of a state, for α: joint accelerations without `bias_acceleration` (n). `push` are accelerations
    /// by external forces (n).
    pub(crate) fn update(
        &mut self,
        model: &Model,
        data: &Data,
        bias_acceleration: &DVector<f64>,
        push: &[f64],
    ) {
        self.count = 0;
        self.least_m = self.within_m;
        collision_distances(&self.geometry, model, data, self.within_m, &mut self.near);
        for pair in 0..self.near.proximity.len() {
            let Some(closest) = self.near.proximity[pair] else { continue };
            self.least_m = self.least_m.min(closest.distance_m);
            self.add(model, data, bias_acceleration, push, pair, &closest);
            if closest.distance_m < self.margin_m + ENDS_WITHIN_M {
                let mut ends = [None; 4];
                let proximities = end_proximities(&self.geometry, &self.near, pair, &closest);
                ends.iter_mut().zip(proximities).for_each(|(end, proximity)| *end = Some(proximity));
                for end in ends.iter().flatten() {
                    self.add(model, data, bias_acceleration, push, pair, end);
                }
            }
        }
    }

    /// Adds the bound of two points of a pair, if a motion of the arm can reach it.
    fn add(
        &mut self,
        model: &Model,
        data: &Data,
        bias_acceleration: &DVector<f64>,
        push: &[f64],
        pair: usize,
        proximity: &Proximity,
    ) {
        distance_gradient(&self.geometry, model, data, pair, proximity, &mut self.gradient);
        let Some(Reach { velocity, braking, stop_m }) = self.reach(&self.gradient) else { return };
        let rate = dot(&self.gradient, data.dq.as_slice());
        let left = proximity.distance_m - self.margin_m;
        // Not for a distance or a rate that is not a number.
        if left > stop_m && -rate <= velocity {
            return;
        }
        let state = JointState {
            q: -proximity.distance_m,
            dq: -rate,
            push: -dot(&self.gradient, push),
            velocity,
            braking,
            horizon_s: self.horizon_s,
        };
        let bias = distance_bias_acceleration(&self.geometry, data, pair, proximity);
        let bias = bias.max(-braking).min(braking) + dot(&self.gradient, bias_acceleration.as_slice());
        let upper = state.highest(-self.margin_m) + bias;
        let Some(place) = self.place(upper) else { return };
        let bound = &mut self.rows[place];
        bound.upper = upper;
        bound.row.iter_mut().zip(&self.gradient).for_each(|(row, gradient)| *row = -gradient);
    }

    /// Returns the place for a bound: the next one, or, if there is none, that of the bound that allows most.
    fn place(&mut self, upper: f64) -> Option<usize> {
        if self.count < self.rows.len() {
            self.count += 1;
            return Some(self.count - 1);
        }
        let widest = self.rows.iter().enumerate().max_by(|(_, a), (_, b)| a.upper.total_cmp(&b.upper));
        widest.filter(|(_, row)| row.upper > upper).map(|(place, _)| place)
    }

    /// Returns what the joints contribute to a distance with this gradient; `None` if they cannot change it.
    fn reach(&self, gradient: &[f64]) -> Option<Reach> {
        let (mut length, mut velocity, mut braking) = (0.0, 0.0, 0.0);
        for ((g, v), b) in gradient.iter().zip(&self.velocity).zip(&self.braking) {
            // A joint without a velocity limit that does not change the distance contributes nothing.
            if *g != 0.0 {
                length += g.abs();
                velocity += g.abs() * v;
                braking += BRAKING_FRACTION * g.abs() * b;
            }
        }
        if length <= IMMOVABLE {
            return None;
        }
        // The pair approaches for a horizon before it brakes, and brakes in steps of a horizon.
        let stop_m = 2.0 * velocity * self.horizon_s + 0.5 * velocity * velocity / braking;
        Some(Reach { velocity, braking, stop_m })
    }

    /// Bounds of the cycle.
    pub(crate) fn rows(&self) -> &[SpeedBound] {
        &self.rows[..self.count]
    }

    /// Smallest distance of all pairs, m; at most the distance beyond which no bound is needed.
    pub(crate) fn least_m(&self) -> f64 {
        self.least_m
    }
}

/// Contribution of all joints to a distance.
struct Reach {
    /// Highest approach speed, m/s.
    velocity: f64,
    /// Braking acceleration of the approach, m/s².
    braking: f64,
    /// Way from the highest speed to rest, m.
    stop_m: f64,
}

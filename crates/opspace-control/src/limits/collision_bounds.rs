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
//! * **Pairs that cannot have come near** are not looked at. How much each joint changes a distance is bounded for all
//!   postures. A pair that needed no row is looked at again when the joints may have moved it by a quarter of what it was
//!   apart beyond its way to stop; the rest is left to the change of that way.
//!
//! If bounds contradict each other, those on torques and their rates take precedence; those that brake joints or pairs
//! are then widened together, as little as possible.

use crate::algebra::dot;
use crate::limits::bounds::Bounds;
use crate::limits::collision_limits::CollisionLimits;
use crate::limits::joint_bound::{JointState, Uncommanded};
use crate::qp::lexicographic::SpeedBound;
use crate::qp::quadratic_program::axpy;
use nalgebra::DVector;
use opspace_model::collision::{
    CollisionData, CollisionModel, Proximity, collision_distances, distance_bias_acceleration,
    distance_gradient, end_proximities, pair_proximity, place_capsules,
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

/// Fraction of what a pair is apart beyond its way to stop by which it may come nearer before it is looked at again. With
/// 0.5, bounds of random arms come late twice as often.
const SPARE_FRACTION: f64 = 0.25;

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
    states: Vec<PairState>,
    /// Upper bounds of the change of each pair's distance with each joint, m/rad (pairs × n, joint by joint).
    change_bounds: Vec<f64>,
    /// Bound of the motion of each pair since the last cycle, m.
    pair_moved_m: Vec<f64>,
    /// Joint positions of the last cycle, rad or m (nq).
    last_q: DVector<f64>,
    /// Motion of each joint since the last cycle, rad or m (n).
    moved: Vec<f64>,
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
        let (pairs, mut of_pair) = (geometry.pairs().len(), vec![0.0; model.n()]);
        let mut change_bounds = vec![0.0; pairs * model.n()];
        for pair in 0..pairs {
            geometry.distance_change_bound(model, pair, &mut of_pair);
            let bounds = change_bounds[pair..].iter_mut().step_by(pairs);
            bounds.zip(&of_pair).for_each(|(bound, of_pair)| *bound = *of_pair);
        }
        let mut new = Self {
            margin_m: limits.margin_m,
            within_m: f64::INFINITY,
            horizon_s: bounds.horizon_s(),
            braking: bounds.braking().to_vec(),
            velocity: bounds.velocity().to_vec(),
            near: CollisionData::new(&geometry),
            states: vec![PairState::DUE; geometry.pairs().len()],
            change_bounds,
            pair_moved_m: vec![0.0; pairs],
            last_q: DVector::zeros(model.nq()),
            moved: vec![0.0; model.n()],
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

    /// Forgets the motion before a start: all pairs are looked at.
    pub(crate) fn start(&mut self) {
        self.states.fill(PairState::DUE);
    }

    /// Computes the bounds of a state, for α: joint accelerations without `bias_acceleration` (n).
    pub(crate) fn update(
        &mut self,
        model: &Model,
        data: &Data,
        bias_acceleration: &DVector<f64>,
        uncommanded: Uncommanded<'_>,
    ) {
        self.count = 0;
        let longest_m = self.follow(&data.q);
        let least_at_most_m = self.within_m.min(self.least_m + longest_m);
        self.least_m = self.within_m;
        place_capsules(&self.geometry, model, data, &mut self.near);
        for pair in 0..self.states.len() {
            let state = &self.states[pair];
            // What is not a number is neither.
            let (has_spare, is_not_nearest) = (state.spare_m > 0.0, state.at_least_m > least_at_most_m);
            if has_spare && is_not_nearest {
                continue;
            }
            let closest = pair_proximity(&self.geometry, &self.near, pair);
            self.least_m = self.least_m.min(closest.distance_m);
            self.states[pair].at_least_m = closest.distance_m;
            if !has_spare {
                self.states[pair].spare_m =
                    self.bound(model, data, bias_acceleration, uncommanded, pair, &closest);
            }
        }
    }

    /// Follows the motion since the last cycle to the joint positions `q`; returns the longest motion of a pair, m.
    fn follow(&mut self, q: &DVector<f64>) -> f64 {
        for (moved, (q, last)) in self.moved.iter_mut().zip(q.iter().zip(self.last_q.iter_mut())) {
            *moved = (q - *last).abs();
            *last = *q;
        }
        self.pair_moved_m.fill(0.0);
        let bounds = self.change_bounds.chunks_exact(self.states.len().max(1));
        for (bound, moved) in bounds.zip(&self.moved) {
            axpy(*moved, bound, &mut self.pair_moved_m);
        }
        let mut longest_m = 0.0_f64;
        for (state, &moved_m) in self.states.iter_mut().zip(&self.pair_moved_m) {
            state.at_least_m -= moved_m;
            state.spare_m -= moved_m;
            longest_m = longest_m.max(moved_m);
        }
        longest_m
    }

    /// Adds the bounds of a pair with these closest points. Returns the motion up to which it needs none, m; not positive if
    /// it needs one now.
    fn bound(
        &mut self,
        model: &Model,
        data: &Data,
        bias_acceleration: &DVector<f64>,
        uncommanded: Uncommanded<'_>,
        pair: usize,
        closest: &Proximity,
    ) -> f64 {
        if closest.distance_m > self.within_m {
            return closest.distance_m - self.within_m;
        }
        let spare_m = self.add(model, data, bias_acceleration, uncommanded, pair, closest);
        let to_ends_m = closest.distance_m - self.margin_m - ENDS_WITHIN_M;
        if to_ends_m < 0.0 {
            let mut ends = [None; 4];
            let proximities = end_proximities(&self.geometry, &self.near, pair, closest);
            ends.iter_mut().zip(proximities).for_each(|(end, proximity)| *end = Some(proximity));
            for end in ends.iter().flatten() {
                self.add(model, data, bias_acceleration, uncommanded, pair, end);
            }
        }
        spare_m.min(to_ends_m)
    }

    /// Adds the bound of two points of a pair, if a motion of the arm can reach it. Returns the motion up to which none can,
    /// m; 0 if one can now.
    fn add(
        &mut self,
        model: &Model,
        data: &Data,
        bias_acceleration: &DVector<f64>,
        uncommanded: Uncommanded<'_>,
        pair: usize,
        proximity: &Proximity,
    ) -> f64 {
        let left = proximity.distance_m - self.margin_m;
        distance_gradient(&self.geometry, model, data, pair, proximity, &mut self.gradient);
        let Some(Reach { velocity, braking, stop_m }) = self.reach(&self.gradient) else {
            return SPARE_FRACTION * left;
        };
        let rate = dot(&self.gradient, data.dq.as_slice());
        // Not for a distance or a rate that is not a number.
        if left > stop_m && -rate <= velocity {
            return SPARE_FRACTION * (left - stop_m);
        }
        let [low, high] = uncommanded.drag.along(&self.gradient);
        let state = JointState {
            q: -proximity.distance_m,
            dq: -rate,
            push: -dot(&self.gradient, uncommanded.push),
            drag: [-high, -low],
            velocity,
            braking,
            horizon_s: self.horizon_s,
        };
        let bias = distance_bias_acceleration(&self.geometry, data, pair, proximity);
        let bias = bias.max(-braking).min(braking) + dot(&self.gradient, bias_acceleration.as_slice());
        let upper = state.highest(-self.margin_m) + bias;
        if let Some(place) = self.place(upper) {
            let bound = &mut self.rows[place];
            bound.upper = upper;
            bound.row.iter_mut().zip(&self.gradient).for_each(|(row, gradient)| *row = -gradient);
        }
        0.0
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

/// State of a pair since its distance was last computed.
#[derive(Clone, Copy, Debug)]
struct PairState {
    /// Lower bound of its distance, m.
    at_least_m: f64,
    /// Motion until the pair is looked at, m; not positive if it is due.
    spare_m: f64,
}

impl PairState {
    /// A pair that is looked at in the next cycle.
    const DUE: Self = Self { at_least_m: f64::NEG_INFINITY, spare_m: f64::NEG_INFINITY };
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::drag::Drag;
    use crate::limits::joint_limits::JointLimits;
    use nalgebra::{Matrix3, Vector3};
    use opspace_model::collision::{CapsuleSource, CollisionShape, HalfSpace, LinkCapsule};
    use opspace_model::{Inertia, Joint, JointKind, Limits, Placement};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const JOINTS: usize = 6;
    const PERIOD_S: f64 = 1e-3;

    /// A random arm on a floor, with a capsule along each link.
    fn arm(rng: &mut ChaCha8Rng) -> (Model, CollisionLimits) {
        let mut model = Model::new("arm");
        let mut capsules = Vec::new();
        for i in 0..JOINTS {
            let length = rng.random_range(0.1..0.4);
            let turn = if i % 2 == 0 { 1.5 } else { rng.random_range(-1.5..1.5) };
            let origin = Placement::from_rpy([turn, 0.0, 0.0], [0.0, 0.0, length]);
            let limits = Limits { lower: -2.5, upper: 2.5, velocity: 3.0, effort: 100.0 };
            let joint = Joint { name: format!("j{i}"), kind: JointKind::Revolute, limits };
            let com = Vector3::new(0.0, 0.0, 0.1);
            let inertia = Inertia { mass: 2.0, com, rotational: Matrix3::identity() * 0.02 };
            let body = model.add_body(i.checked_sub(1), origin, joint, inertia);
            let link = format!("l{i}");
            model.add_frame(&link, Some(body), Placement::identity());
            capsules.push(LinkCapsule {
                name: link.clone(),
                link,
                start_m: [0.0; 3],
                end_m: [0.0, 0.0, rng.random_range(0.1..0.4)],
                radius_m: 0.04,
                source: CapsuleSource::User,
            });
        }
        let mut geometry = CollisionModel::new(&model, &capsules).expect("links of the model");
        let floor = HalfSpace { normal: Vector3::z(), offset_m: -0.3 };
        geometry.add_obstacle("floor", CollisionShape::HalfSpace(floor)).expect("a plane");
        (model, CollisionLimits { geometry, margin_m: 0.02 })
    }

    /// Compared: the bounds and the least distance of a controller that leaves out pairs which cannot have come near, with
    /// those of one that looks at all pairs in each cycle; during random motions up to the highest speeds of the joints, with
    /// jumps and positions that are not numbers. The least distance is the same; a bound that comes late, because the way to
    /// stop grew faster than expected, is far from being reached.
    #[test]
    fn pairs_left_out_need_no_bound() {
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let (mut with_rows, mut late, mut left_out, mut pairs) = (0, 0, 0, 0);
        for _ in 0..20 {
            let (model, limits) = arm(&mut rng);
            let bounds = Bounds::new(&model, JointLimits::of(&model), PERIOD_S, 0.02);
            let [mut selective, mut all] = [(); 2].map(|()| CollisionBounds::new(&model, &limits, &bounds));
            let (mut data, still) = (Data::new(&model), DVector::zeros(JOINTS));
            let mut amplitude = [0.0; JOINTS];
            let mut phase = [0.0; JOINTS];
            let mut rate = [0.0; JOINTS];
            for cycle in 0..1000 {
                if cycle % 250 == 0 {
                    amplitude = [(); JOINTS].map(|()| rng.random_range(0.0..2.5));
                    phase = [(); JOINTS].map(|()| rng.random_range(0.0..6.0));
                    // At most 3 rad/s.
                    rate = amplitude.map(|a| rng.random_range(0.0..3.0) / f64::max(a, 0.1));
                }
                let t = PERIOD_S * f64::from(cycle);
                let no_drag = Drag::new(still.len());
                let undisturbed = Uncommanded { push: still.as_slice(), drag: &no_drag };
                let mut q: Vec<f64> =
                    (0..JOINTS).map(|i| amplitude[i] * (rate[i] * t + phase[i]).sin()).collect();
                if cycle == 600 {
                    q[2] = f64::NAN;
                }
                let dq: Vec<f64> =
                    (0..JOINTS).map(|i| amplitude[i] * rate[i] * (rate[i] * t + phase[i]).cos()).collect();
                kinematics(&model, &mut data, &q, &dq);
                selective.update(&model, &data, &still, undisturbed);
                all.start();
                all.update(&model, &data, &still, undisturbed);
                assert_eq!(selective.least_m().to_bits(), all.least_m().to_bits(), "cycle {cycle}");
                // Rows of what is not a number are equal to nothing.
                let missing = all.rows().iter().filter(|row| cycle != 600 && !selective.rows().contains(row));
                for row in missing {
                    let all_joints: f64 =
                        row.row.iter().zip(bounds.braking()).map(|(row, braking)| row.abs() * braking).sum();
                    assert!(row.upper > 0.3 * all_joints, "cycle {cycle}: {row:?} of {all_joints}");
                    late += 1;
                }
                with_rows += usize::from(!all.rows().is_empty());
                left_out += selective.states.iter().filter(|state| state.spare_m > 0.0).count();
                pairs += selective.states.len();
            }
        }
        assert!(with_rows > 1000 && late * 500 < with_rows, "{late} of {with_rows}");
        assert!(left_out > pairs / 4, "{left_out} of {pairs}");
    }
}

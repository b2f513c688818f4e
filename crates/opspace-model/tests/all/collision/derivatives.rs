//! Derivatives of distances, compared with differences of the distances along motions.
#![expect(clippy::unwrap_used, reason = "a test")]

use super::{collision_model, robot};
use crate::common::DIFFERENCE;
use nalgebra::Vector3;
use opspace_model::collision::{
    Capsule, CollisionData, CollisionModel, CollisionShape, HalfSpace, collision_distances,
    distance_bias_acceleration, distance_gradient,
};
use opspace_model::{Data, Model, Placement, UrdfOptions, integrate, kinematics, neutral};
use opspace_testing::oracle::urdf;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Step of first differences, s.
const STEP_S: f64 = 1e-5;
/// Step of second differences, s: the error of truncation is of order STEP², that of rounding of order ε/STEP².
const SECOND_STEP_S: f64 = 1e-4;
/// Relative tolerance of second differences.
const SECOND_DIFFERENCE: f64 = 1e-5;

/// Adds a floor, a post and a ball beside the robot.
fn with_obstacles(mut collision: CollisionModel) -> CollisionModel {
    let floor = HalfSpace { normal: Vector3::new(0.1, -0.2, 2.0), offset_m: -0.1 };
    let post =
        Capsule { start_m: Vector3::new(0.5, 0.4, -0.5), end_m: Vector3::new(0.6, 0.3, 1.5), radius_m: 0.05 };
    let ball = Capsule::sphere(Vector3::new(-0.4, 0.5, 0.6), 0.1);
    collision.add_obstacle("floor", CollisionShape::HalfSpace(floor)).unwrap();
    collision.add_obstacle("post", CollisionShape::Capsule(post)).unwrap();
    collision.add_obstacle("ball", CollisionShape::Capsule(ball)).unwrap();
    collision
}

/// Distances of all pairs after a motion with constant q̇, and the derivatives of one pair.
struct Motion<'a> {
    model: &'a Model,
    collision: &'a CollisionModel,
    q: Vec<f64>,
    dq: Vec<f64>,
    data: Data,
    near: CollisionData,
}

impl<'a> Motion<'a> {
    fn new(model: &'a Model, collision: &'a CollisionModel, q: Vec<f64>, dq: Vec<f64>) -> Self {
        Self { model, collision, q, dq, data: Data::new(model), near: CollisionData::new(collision) }
    }

    /// Distances after `time` (s).
    fn distances(&mut self, time: f64) -> Vec<f64> {
        let step: Vec<f64> = self.dq.iter().map(|v| v * time).collect();
        let mut q = self.q.clone();
        integrate(self.model, &self.q, &step, &mut q);
        kinematics(self.model, &mut self.data, &q, &self.dq);
        collision_distances(self.collision, self.model, &self.data, f64::INFINITY, &mut self.near);
        self.near.proximity.iter().map(|row| row.as_ref().unwrap().distance_m).collect()
    }

    /// Gradientᵀ q̇ and bias acceleration of each pair at time 0.
    fn derivatives(&mut self) -> Vec<[f64; 2]> {
        self.distances(0.0);
        let mut gradient = vec![f64::NAN; self.model.n()];
        let rows = self.near.near().map(|(pair, proximity)| {
            distance_gradient(self.collision, self.model, &self.data, pair, proximity, &mut gradient);
            let rate = gradient.iter().zip(&self.dq).map(|(g, v)| g * v).sum();
            [rate, distance_bias_acceleration(self.collision, &self.data, pair, proximity)]
        });
        rows.collect()
    }
}

/// Numbers of pairs whose derivatives agree, and of those at which the distance has a kink within the step.
#[derive(Debug, Default)]
struct Agreement {
    smooth: usize,
    kinks: usize,
}

/// Compares the derivatives of all pairs with central differences along the motion. The distance has a kink where a
/// closest point reaches an end: the second differences of two steps then disagree with each other.
fn compare(motion: &mut Motion<'_>, agreement: &mut Agreement) {
    let derivatives = motion.derivatives();
    let now = motion.distances(0.0);
    let (ahead, behind) = (motion.distances(STEP_S), motion.distances(-STEP_S));
    let mut second = |step: f64| -> Vec<f64> {
        let (ahead, behind) = (motion.distances(step), motion.distances(-step));
        (0..now.len()).map(|i| (ahead[i] + behind[i] - 2.0 * now[i]) / (step * step)).collect()
    };
    let (one, two) = (second(SECOND_STEP_S), second(2.0 * SECOND_STEP_S));
    for (pair, &[rate, bias]) in derivatives.iter().enumerate() {
        let names = motion.collision.pair_names(pair);
        let measured = (ahead[pair] - behind[pair]) / (2.0 * STEP_S);
        // Of Richardson's extrapolation, whose correction is the error of truncation.
        let (extrapolated, spread) = ((4.0 * one[pair] - two[pair]) / 3.0, (one[pair] - two[pair]).abs());
        let tolerance = SECOND_DIFFERENCE * bias.abs().max(1.0);
        if spread > 1e-3 * bias.abs().max(1.0) {
            agreement.kinks += 1;
            continue;
        }
        agreement.smooth += 1;
        assert!((rate - measured).abs() < DIFFERENCE * 10.0, "{names:?}: {rate} {measured}");
        assert!(
            (bias - extrapolated).abs() < tolerance + spread,
            "{names:?}: {bias} {extrapolated} {spread:e}"
        );
    }
}

/// A state within the limits of the joints; the pose of a floating base is arbitrary.
fn random_state(model: &Model, rng: &mut ChaCha8Rng) -> (Vec<f64>, Vec<f64>) {
    let first = if model.is_floating() { 6 } else { 0 };
    let base: Vec<f64> = (0..first).map(|_| rng.random_range(-1.0..1.0)).collect();
    let joints = model.joints()[first..].iter().map(|joint| {
        let (lower, upper) = (joint.limits.lower.max(-3.0), joint.limits.upper.min(3.0));
        rng.random_range(lower..upper)
    });
    let step: Vec<f64> = base.into_iter().chain(joints).collect();
    let mut q = neutral(model);
    integrate(model, &neutral(model), &step, &mut q);
    (q, (0..model.n()).map(|_| rng.random_range(-1.5..1.5)).collect())
}

/// Compares the derivatives in random states.
fn compare_states(name: &str, model: &Model, collision: &CollisionModel, states: usize) {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut agreement = Agreement::default();
    for _ in 0..states {
        let (q, dq) = random_state(model, &mut rng);
        compare(&mut Motion::new(model, collision, q, dq), &mut agreement);
    }
    assert!(agreement.smooth > 1000 && agreement.smooth > 100 * agreement.kinks, "{name}: {agreement:?}");
}

/// Compared: gradient and bias acceleration of all pairs, and differences of the distances along random motions.
#[test]
fn derivatives_agree_with_differences() {
    for name in ["panda", "ur5e"] {
        let (model, collision) = robot(name);
        compare_states(name, &model, &with_obstacles(collision), 300);
    }
}

/// Compared: the same, with a floating base, with a mimic joint, and with a base that is away from the world's origin.
#[test]
fn derivatives_agree_with_differences_on_other_bases() {
    let plain = UrdfOptions::default();
    let floating = UrdfOptions { floating_base: true, ..plain };
    let mimic = UrdfOptions { enforce_mimic: true, ..plain };
    for (name, options) in [("anymal_c", floating), ("panda", mimic), ("ur5", plain)] {
        let (model, collision) = collision_model(&urdf(name), options);
        let model = model.with_base(Placement::from_rpy([0.3, -0.2, 0.5], [0.2, 0.1, -0.3]));
        let collision = with_obstacles(collision);
        compare_states(name, &model, &collision, 40);
    }
}

/// Compared: the derivatives in states with parallel and intersecting axes, and finite numbers.
#[test]
fn derivatives_are_finite_in_singular_states() {
    let (model, collision) = robot("ur5e");
    let mut collision = collision;
    let [start_m, end_m] =
        [collision.capsules()[2].start_m, collision.capsules()[2].end_m].map(Vector3::from);
    collision
        .add_obstacle("here", CollisionShape::Capsule(Capsule { start_m, end_m, radius_m: 0.1 }))
        .unwrap();
    let mut motion = Motion::new(&model, &collision, vec![0.0; 6], vec![1.0; 6]);
    let derivatives = motion.derivatives();
    assert!(derivatives.iter().flatten().all(|x| x.is_finite()), "{derivatives:?}");
}

//! Pairs of links or obstacles at the distance that the controller keeps, at one state of a run.
//!
//! A log has the least distance of all pairs, and the joints at a bound, but not the pair that bounds them. It follows
//! from the positions of the joints: the pair is at its margin, and the task pushes the joints against the gradient of its
//! distance.

use crate::run::experiment::Experiment;
use nalgebra::DVector;
use opspace_model::collision::{CollisionData, CollisionModel, collision_distances, distance_gradient};
use opspace_model::{Data, Model};

/// Distance beyond the margin within which a pair counts, m: pairs that approach brake before the margin.
const NEAR_M: f64 = 5e-3;

/// Least cosine of the angle between a push and the direction in which a pair approaches: other limits act at the same time.
const LEAST_COSINE: f64 = 0.3;

/// Least change of a distance by a joint, relative to the joint that changes it most.
const LEAST_CHANGE: f64 = 0.1;

/// Pairs at the distance that the controller of an experiment keeps.
pub(super) struct NearPairs<'a> {
    geometry: &'a CollisionModel,
    margin_m: f64,
    data: CollisionData,
    /// Pairs, each with the gradient of its distance (n; m/rad or 1).
    near: Vec<(usize, DVector<f64>)>,
}

impl<'a> NearPairs<'a> {
    /// Returns `None` if the controller keeps no distances.
    pub(super) fn new(experiment: &'a Experiment) -> Option<Self> {
        let kept = experiment.kept_distances().filter(|_| experiment.task().file.limits.enforce)?;
        let geometry = &kept.limits.geometry;
        let (margin_m, data) = (kept.limits.margin_m, CollisionData::new(geometry));
        Some(Self { geometry, margin_m, data, near: Vec::new() })
    }

    /// Finds the pairs at a state with kinematics.
    pub(super) fn update(&mut self, model: &Model, data: &Data) {
        self.near.clear();
        collision_distances(self.geometry, model, data, self.margin_m + NEAR_M, &mut self.data);
        for (pair, proximity) in self.data.near() {
            let mut gradient = DVector::zeros(model.n());
            distance_gradient(self.geometry, model, data, pair, proximity, gradient.as_mut_slice());
            self.near.push((pair, gradient));
        }
    }

    /// Pairs that `push` (n) would bring together.
    pub(super) fn holding(&self, push: &DVector<f64>) -> impl Iterator<Item = usize> {
        self.near.iter().filter(|(_, gradient)| cosine(gradient, push) > LEAST_COSINE).map(|(pair, _)| *pair)
    }

    /// Returns the pair that holds a joint against `push` (n), if any.
    pub(super) fn against(&self, joint: usize, push: &DVector<f64>) -> Option<usize> {
        let holds = |gradient: &DVector<f64>| {
            gradient[joint] * push[joint] < 0.0 && gradient[joint].abs() > LEAST_CHANGE * gradient.amax()
        };
        let pairs = self.near.iter().filter(|(_, gradient)| holds(gradient));
        let pairs = pairs.map(|(pair, gradient)| (*pair, cosine(gradient, push)));
        let strongest = pairs.max_by(|a, b| a.1.total_cmp(&b.1));
        strongest.filter(|(_, cosine)| *cosine > LEAST_COSINE).map(|(pair, _)| pair)
    }
}

/// Cosine of the angle between a push and the direction in which a pair with this gradient approaches.
fn cosine(gradient: &DVector<f64>, push: &DVector<f64>) -> f64 {
    -gradient.dot(push) / (gradient.norm() * push.norm())
}

/// Names of pairs of an experiment.
pub(super) fn pair_names(experiment: &Experiment, pairs: &[usize]) -> Vec<[String; 2]> {
    let Some(kept) = experiment.kept_distances() else { return Vec::new() };
    pairs.iter().map(|&pair| kept.limits.geometry.pair_names(pair).map(str::to_owned)).collect()
}

//! Choice of the pairs that can be kept apart, by sampling of postures.

use super::distances::{CollisionData, collision_distances};
use super::model::{CollisionModel, Holder};
use crate::data::Data;
use crate::kinematics::forward_kinematics;
use crate::model::Model;
use crate::postures::Postures;

/// Parameters of [`CollisionModel::drop_unneeded_pairs`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairSampling {
    /// Number of postures over the whole ranges of the joints; 5000 by default.
    pub postures: usize,
    /// Distance within which a pair must come in a posture to be kept, m; 0.05 by default. It covers what lies between
    /// the postures.
    pub margin_m: f64,
    /// Distance up to which a pair collides, m; 0 by default. Limits that keep pairs farther apart need that distance.
    pub colliding_m: f64,
    /// Number of postures around the middle of the ranges; 200 by default.
    pub middle_postures: usize,
    /// Fraction of each range in which they lie; 0.2 by default.
    pub middle_fraction: f64,
}

impl Default for PairSampling {
    fn default() -> Self {
        Self { postures: 5000, margin_m: 0.05, colliding_m: 0.0, middle_postures: 200, middle_fraction: 0.2 }
    }
}

/// Pair that was dropped.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct DroppedPair {
    /// Names of the two objects.
    pub names: [String; 2],
    /// Reason.
    pub reason: DropReason,
}

/// Reason for which a pair is dropped.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum DropReason {
    /// The objects penetrate each other in all postures around the middle of the joint ranges; with an obstacle, in all
    /// postures of the whole ranges.
    AlwaysColliding,
    /// The objects are farther apart than the margin in all postures.
    NeverNear,
}

impl CollisionModel {
    /// Drops the pairs of links that penetrate each other in all postures around the middle of the joint ranges, the
    /// pairs of a link and an obstacle that do so in all postures within the joint limits, and the pairs that come
    /// within a margin in no posture within the joint limits. Returns the dropped pairs. Allocates: call it once after
    /// loading.
    ///
    /// The postures are a deterministic sequence that fills the ranges evenly; joints without limits have ±π rad or ±1
    /// m. A narrow part of the ranges in which a pair comes near may be missed. A limit keeps no pair apart that is
    /// dropped: check the list of pairs that always collide, which are usually capsules that are larger than their
    /// links. Pairs of a floating base's robot with obstacles are kept.
    pub fn drop_unneeded_pairs(&mut self, model: &Model, sampling: &PairSampling) -> Vec<DroppedPair> {
        let count = self.pairs.len();
        let kept = |i: usize| model.is_floating() && self.objects[self.pairs[i].b].holder == Holder::World;
        let mut always = vec![sampling.middle_postures > 0; count];
        let middle = Postures::new(model, sampling.middle_fraction);
        self.sample(model, &middle, sampling.middle_postures, sampling.colliding_m, |pair, distance_m| {
            always[pair] &= distance_m.is_some();
        });
        let mut never = vec![sampling.postures > 0; count];
        let whole = Postures::new(model, 1.0);
        // An obstacle may be where the arm is in the middle of its ranges.
        let with_obstacle = |pair: usize| self.objects[self.pairs[pair].b].holder == Holder::World;
        self.sample(model, &whole, sampling.postures, sampling.margin_m, |pair, distance_m| {
            never[pair] &= distance_m.is_none();
            let collides = distance_m.is_some_and(|distance_m| distance_m <= sampling.colliding_m);
            always[pair] &= collides || !with_obstacle(pair);
        });
        let reason = |pair: usize| match (kept(pair), always[pair], never[pair]) {
            (false, true, _) => Some(DropReason::AlwaysColliding),
            (false, false, true) => Some(DropReason::NeverNear),
            _ => None,
        };
        let reasons: Vec<Option<DropReason>> = (0..count).map(reason).collect();
        let dropped = reasons.iter().enumerate().filter_map(|(pair, reason)| {
            Some(DroppedPair { names: self.pair_names(pair).map(str::to_owned), reason: (*reason)? })
        });
        let dropped = dropped.collect();
        let mut each = reasons.iter();
        self.pairs.retain(|_| each.next().is_some_and(Option::is_none));
        dropped
    }

    /// Passes to `each`, for every posture and pair, the index of the pair and its distance (m) if it is within
    /// `within_m`.
    fn sample(
        &self,
        model: &Model,
        postures: &Postures<'_>,
        count: usize,
        within_m: f64,
        mut each: impl FnMut(usize, Option<f64>),
    ) {
        let (mut data, mut near) = (Data::new(model), CollisionData::new(self));
        for number in 0..count {
            forward_kinematics(model, &mut data, &postures.posture(number));
            collision_distances(self, model, &data, within_m, &mut near);
            for (pair, row) in near.proximity.iter().enumerate() {
                each(pair, row.map(|row| row.distance_m));
            }
        }
    }
}

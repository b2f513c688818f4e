//! Start postures and references at which links are closer to each other, or to an obstacle, than the margin.

use super::case::PreflightCase;
use super::diagnostic::short;
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_experiment::run::collision::KeptDistances;
use opspace_experiment::run::rollout::{Instant, Rollout};
use opspace_model::collision::{CollisionData, collision_distances};
use opspace_model::{Data, Model, forward_kinematics};

/// Rounding error of a distance, m.
const ROUNDING_M: f64 = 1e-9;

/// Finds a start that is closer to a collision than the margin.
pub(crate) fn at_start(case: &PreflightCase<'_>) -> Option<Finding> {
    let distances =
        case.experiment.kept_distances().filter(|_| case.experiment.task().file.limits.enforce)?;
    let found = Closest::new(case, distances).within_margin(&case.start)?;
    let message = format!("in the start posture, {found}: they move apart as soon as control starts");
    let help = "choose another start, or correct the capsules (`opspace model ROBOT --capsules`)".to_owned();
    Some(Finding::new(Code::StartInCollision, &["start_rad"], message, help))
}

/// Finds a posture on the references that is closer to a collision than the margin, unless the start is. The posture is the
/// one in which the joints follow the references; a redundant arm may have others.
pub(crate) fn on_the_way(case: &PreflightCase<'_>, followed: &Rollout) -> Vec<Finding> {
    let limits = &case.experiment.task().file.limits;
    let Some(distances) = case.experiment.kept_distances().filter(|_| limits.enforce) else {
        return Vec::new();
    };
    let mut closest = Closest::new(case, distances);
    if closest.within_margin(&case.start).is_some() {
        return Vec::new();
    }
    let near = |instant: &Instant, closest: &mut Closest<'_>| closest.within_margin(&instant.q);
    let last = followed.instants.last().filter(|_| followed.to_the_end);
    let goal = last.and_then(|instant| Some((instant, near(instant, &mut closest)?, "")));
    let first = || {
        let mut instants = followed.instants.iter();
        instants.find_map(|instant| Some((instant, near(instant, &mut closest)?, " first")))
    };
    let Some((instant, found, when)) = goal.or_else(first) else { return Vec::new() };
    let priority = case.task_sets[instant.task_set].priority;
    let key = match priority.first() {
        Some(name) => case.reference_key(instant.task_set, name),
        None => vec!["priority".to_owned()],
    };
    let message = format!(
        "at {} s{when}, the posture that follows the references is in collision: {found}",
        short(instant.time_s)
    );
    let help = if when.is_empty() {
        "the arm stops before it, unless another posture reaches the goal: move the goal or the obstacle"
    } else {
        "the arm passes the place if it can, with errors of its tasks: give the path more distance"
    };
    vec![Finding::new(Code::ReferenceInCollision, &key, message, help.to_owned())]
}

/// Search for the closest pair of a posture.
struct Closest<'a> {
    model: &'a Model,
    distances: &'a KeptDistances,
    data: Data,
    near: CollisionData,
}

impl<'a> Closest<'a> {
    fn new(case: &PreflightCase<'a>, distances: &'a KeptDistances) -> Self {
        let (data, near) = (case.data.clone(), CollisionData::new(&distances.limits.geometry));
        Self { model: case.model, distances, data, near }
    }

    /// Describes the closest pair if it is within the margin.
    fn within_margin(&mut self, q: &[f64]) -> Option<String> {
        let (geometry, margin_m) = (&self.distances.limits.geometry, self.distances.limits.margin_m);
        forward_kinematics(self.model, &mut self.data, q);
        let within_m = margin_m - ROUNDING_M;
        collision_distances(geometry, self.model, &self.data, within_m, &mut self.near);
        let (pair, proximity) =
            self.near.near().min_by(|(_, a), (_, b)| a.distance_m.total_cmp(&b.distance_m))?;
        let ([a, b], distance_m) = (geometry.pair_names(pair), proximity.distance_m);
        Some(if distance_m < 0.0 {
            format!("'{a}' is {} m deep in '{b}'", short(-distance_m))
        } else {
            format!(
                "'{a}' and '{b}' are {} m apart, less than margin_m = {}",
                short(distance_m),
                short(margin_m)
            )
        })
    }
}

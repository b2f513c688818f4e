//! Collision geometry of an experiment: the capsules of its robot, the obstacles of its task, and the pairs that the
//! controller keeps apart.

use crate::files::collision::{geometry, unknown_name};
use crate::files::robot::RobotDefinition;
use crate::files::source::FileError;
use crate::files::task::TaskDefinition;
use opspace_control::CollisionLimits;
use opspace_model::collision::{DroppedPair, PairSampling};

/// Distance beyond the margin within which a pair must come in a sampled posture to be kept, m.
const NEAR_M: f64 = 0.03;

/// Distances that the controller of an experiment keeps.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct KeptDistances {
    /// Capsules, obstacles, and the pairs that are kept apart.
    pub limits: CollisionLimits,
    /// Pairs that are not kept apart, because they always collide or never meet.
    pub dropped: Vec<DroppedPair>,
}

/// Returns the distances that are kept; `None` if the robot has no collision geometry.
pub(super) fn kept_distances(
    robot: &RobotDefinition,
    task: &TaskDefinition,
) -> Result<Option<KeptDistances>, FileError> {
    let (Some(file), Some(capsules)) = (&robot.file.collision, &robot.capsules) else {
        let Some(name) = task.file.obstacle.keys().next() else { return Ok(None) };
        let message = format!(
            "the robot '{}' has no collision geometry with which it can avoid obstacles",
            robot.name()
        );
        let help = format!(
            "add [collision] to {}, and check the capsules: `opspace model {} --capsules`",
            robot.source.name(),
            robot.source.name()
        );
        return Err(FileError::at_key(&task.source, ["obstacle", name], message, Some(help)));
    };
    let margin_m = file.margin_m.get();
    let mut geometry = geometry(&robot.source, &robot.model, file, &capsules.capsules)?;
    for (name, obstacle) in &task.file.obstacle {
        geometry
            .add_obstacle(name, obstacle.shape())
            .map_err(|error| FileError::at_key(&task.source, ["obstacle", name], error.to_string(), None))?;
        for (number, link) in obstacle.except().iter().enumerate() {
            geometry.drop_pairs(link, name).map_err(|error| {
                let key = ["obstacle", name, obstacle.kind(), "except", &number.to_string()];
                unknown_name(&task.source, &key, error)
            })?;
        }
    }
    let sampling = PairSampling {
        margin_m: PairSampling::default().margin_m.max(margin_m + NEAR_M),
        colliding_m: margin_m,
        ..PairSampling::default()
    };
    let dropped = geometry.drop_unneeded_pairs(&robot.model, &sampling);
    Ok(Some(KeptDistances { limits: CollisionLimits { geometry, margin_m }, dropped }))
}

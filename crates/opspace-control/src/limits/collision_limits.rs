//! Distances that the controller keeps between the links of a robot, and between links and obstacles.

use opspace_model::collision::CollisionModel;

/// Distances that a controller keeps.
#[derive(Clone, Debug, PartialEq)]
pub struct CollisionLimits {
    /// Capsules of the robot, obstacles, and the pairs that are kept apart.
    pub geometry: CollisionModel,
    /// Smallest distance of each pair, m.
    pub margin_m: f64,
}

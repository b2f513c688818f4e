//! Collision geometry: distances, their derivatives, enclosing capsules, meshes, and the choice of pairs.

mod distance;

//! Collision geometry: distances, enclosing capsules, and meshes.

mod capsules;
mod distance;
mod meshes;

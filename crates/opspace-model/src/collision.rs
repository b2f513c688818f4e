//! Distances between the links of a robot, and between links and obstacles.

mod capsule;
mod enclose;
mod generate;
mod mesh;
mod proximity;
mod segment;

pub use capsule::{Capsule, CapsuleSource, CollisionShape, HalfSpace, LinkCapsule};
pub use enclose::enclosing_capsule;
pub use generate::{CapsuleWarning, GeneratedCapsules, generate_capsules};
pub use mesh::{MAX_MESH_BYTES, MeshError, MeshErrorKind, MeshFormat, mesh_vertices};
pub use proximity::Proximity;

//! Collision geometry: distances between the links of a robot, and between links and obstacles, with their derivatives.
//!
//! Links are enclosed by [`Capsule`]s, because the distance of two capsules has a closed form and a gradient almost
//! everywhere. The [`CollisionModel`] is a second model beside [`Model`](crate::Model): it has the capsules of the
//! robot, obstacles in the world, and the pairs whose distances are of interest; [`CollisionData`] has their distances
//! in one state. Limits that keep pairs apart are not part of this crate: they are rows gradientᵀ q̈ +
//! [`distance_bias_acceleration`] ≥ lower bound, of the closest points and of the [`end_proximities`].
//!
//! ```
//! # let urdf = include_str!("../urdf/ur5e.urdf");
//! use nalgebra::Vector3;
//! use opspace_model::collision::{
//!     CollisionData, CollisionModel, CollisionShape, HalfSpace, PairSampling, collision_distances,
//!     distance_bias_acceleration, distance_gradient, generate_capsules,
//! };
//! use opspace_model::{Data, Model, kinematics, urdf::link_shapes};
//!
//! // After loading: capsules from shapes, meshes or inertias; the floor; pairs that can be kept apart.
//! let model = Model::from_urdf(urdf)?.model;
//! let generated = generate_capsules(&link_shapes(urdf)?, None).expect("no damaged mesh");
//! let mut collision = CollisionModel::new(&model, &generated.capsules).expect("links of the model");
//! let floor = HalfSpace { normal: Vector3::z(), offset_m: 0.0 };
//! collision.add_obstacle("floor", CollisionShape::HalfSpace(floor)).expect("a valid plane");
//! collision.drop_unneeded_pairs(&model, &PairSampling::default());
//!
//! // In each control cycle, without allocation.
//! let (mut data, mut near) = (Data::new(&model), CollisionData::new(&collision));
//! let mut gradient = vec![0.0; model.n()];
//! kinematics(&model, &mut data, &[0.1, -1.0, 1.5, 0.2, 0.3, 0.4], &[0.5; 6]);
//! collision_distances(&collision, &model, &data, 0.1, &mut near);
//! for (pair, proximity) in near.near() {
//!     distance_gradient(&collision, &model, &data, pair, proximity, &mut gradient);
//!     let bias = distance_bias_acceleration(&collision, &data, pair, proximity);
//!     println!("{:?}: {:.3} m, {bias:.3} m/s²", collision.pair_names(pair), proximity.distance_m);
//! }
//! # Ok::<(), opspace_model::UrdfError>(())
//! ```

mod capsule;
mod distances;
mod enclose;
mod ends;
mod generate;
mod gradient;
mod mesh;
mod model;
mod pairs;
mod proximity;
mod segment;
mod solid;
mod travel;

pub use capsule::{Capsule, CapsuleSource, CollisionShape, HalfSpace, LinkCapsule};
pub use distances::{CollisionData, collision_distances, pair_proximity, place_capsules};
pub use enclose::enclosing_capsule;
pub use ends::end_proximities;
pub use generate::{CapsuleWarning, GeneratedCapsules, generate_capsules};
pub use gradient::{distance_bias_acceleration, distance_gradient};
pub use mesh::{
    MAX_MESH_BYTES, MeshError, MeshErrorKind, MeshFormat, find_mesh, mesh_triangles, mesh_vertices,
};
pub use model::{CollisionError, CollisionModel, CollisionObject, CollisionPair, Holder};
pub use pairs::{DropReason, DroppedPair, PairSampling};
pub use proximity::Proximity;
pub use solid::{Densities, mesh_inertia, solid_inertia};

//! Collision geometry: distances, their derivatives, enclosing capsules, meshes, and the choice of pairs.

mod capsules;
mod derivatives;
mod distance;
mod meshes;
mod pairs;
mod solid;

use opspace_model::collision::{CollisionModel, generate_capsules};
use opspace_model::urdf::link_shapes;
use opspace_model::{Model, UrdfOptions};
use opspace_testing::oracle::urdf;
use std::path::Path;

/// Robot of the project with capsules for all its links.
pub fn robot(name: &str) -> (Model, CollisionModel) {
    let project = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let path = project.join(format!("robots/{name}/{name}.urdf"));
    let text = std::fs::read_to_string(&path).expect("a robot of the project");
    collision_model(&text, UrdfOptions::default())
}

/// Robot of Pinocchio's set, whose meshes are not found.
fn oracle(name: &str) -> (Model, CollisionModel) {
    collision_model(&urdf(name), UrdfOptions::default())
}

fn collision_model(text: &str, options: UrdfOptions) -> (Model, CollisionModel) {
    let model = Model::from_urdf_with(text, options).expect("a URDF").model;
    let generated = generate_capsules(&link_shapes(text).expect("a URDF"), None).expect("no mesh");
    let collision = CollisionModel::new(&model, &generated.capsules).expect("links of the model");
    (model, collision)
}

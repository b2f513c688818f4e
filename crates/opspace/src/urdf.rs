//! Robots in the types of the crate [`urdf_rs`], which visualisers and planners share.
//!
//! Text is always read by the reader of [`opspace_model`], which reports mistakes that `urdf_rs` accepts.
//! [`Model::from_urdf_rs`](opspace_model::Model::from_urdf_rs) is the way back: it checks a robot of these types as strictly.
//!
//! ```no_run
//! use opspace::experiment::{Files, RobotDefinition};
//! use opspace::model::{Model, UrdfOptions};
//!
//! let robot = RobotDefinition::load(Files::Disk, "robots/panda".as_ref(), &[])?;
//! let mut urdf = opspace::urdf::robot_of(&robot)?;
//! urdf.name = "panda-of-my-lab".to_owned();
//! let model = Model::from_urdf_rs(&urdf, UrdfOptions::default())?.model;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use opspace_experiment::RobotDefinition;

pub use urdf_rs;

/// Returns the URDF of a robot folder in the types of `urdf_rs`, as it is in the file: without the tools, payloads and
/// rotors of robot.toml.
///
/// # Errors
/// Text that `urdf_rs` refuses although it is a URDF: `<limit>` without a velocity, for example.
pub fn robot_of(robot: &RobotDefinition) -> Result<urdf_rs::Robot, urdf_rs::UrdfError> {
    urdf_rs::read_from_string(robot.urdf.text())
}

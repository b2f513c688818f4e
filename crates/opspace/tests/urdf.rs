//! Robots of folders in the types of urdf-rs.
#![cfg(feature = "urdf-rs")]
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use opspace::experiment::{Files, RobotDefinition};
use opspace::model::{Data, Model, UrdfOptions, crba, kinematics};
use std::path::Path;

/// Mass matrix of a model in a general posture, as text with all digits.
fn mass_matrix(model: &Model) -> String {
    let (mut data, n) = (Data::new(model), model.n());
    let q: Vec<f64> = (0..n).map(|i| 0.3 + 0.17 * i as f64).collect();
    kinematics(model, &mut data, &q, &vec![0.0; n]);
    crba(model, &mut data);
    format!("{:?}", data.mass_matrix)
}

/// Compared: the mass matrices of models that were read by opspace, and by urdf-rs from the same robot folder.
#[test]
fn robots_of_folders_are_the_same_in_types_of_urdf_rs() {
    let robots = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../robots");
    for name in ["planar-2-link", "panda", "ur5e", "asimo-arm"] {
        let robot = RobotDefinition::load(Files::Disk, &robots.join(name), &[]).unwrap();
        let of_types =
            Model::from_urdf_rs(&opspace::urdf::robot_of(&robot).unwrap(), UrdfOptions::default()).unwrap();
        let of_text = Model::from_urdf(robot.urdf.text()).unwrap();
        assert_eq!(mass_matrix(&of_types.model), mass_matrix(&of_text.model), "{name}");
        assert!(mass_matrix(&of_text.model).len() > 40, "{name}");
    }
}

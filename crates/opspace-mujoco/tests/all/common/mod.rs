//! Robots of the project, and the library of MuJoCo.

use opspace_experiment::{Files, RobotDefinition};
use opspace_mujoco::{Mujoco, VARIABLE};
use std::fs;
use std::path::{Path, PathBuf};

/// Path in the project.
pub fn project(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(path)
}

/// All robots of the project.
pub fn robots() -> Vec<RobotDefinition> {
    let entries =
        fs::read_dir(project("robots")).expect("robots").map(|entry| entry.expect("an entry").path());
    let mut folders: Vec<PathBuf> = entries.filter(|path| path.is_dir()).collect();
    folders.sort();
    folders.iter().map(|folder| RobotDefinition::load(Files::Disk, folder, &[]).expect("a robot")).collect()
}

/// Opens MuJoCo. Without the library, says that the test is skipped; fails if the environment names a library that does
/// not work.
pub fn mujoco(scene: Option<&Path>) -> Option<Mujoco> {
    match Mujoco::find(scene) {
        Ok(mujoco) => Some(mujoco),
        Err(error) if std::env::var_os(VARIABLE).is_some() => panic!("{error}"),
        Err(error) => {
            println!("SKIPPED, a test with MuJoCo: {error}");
            None
        }
    }
}

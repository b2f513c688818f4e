//! Plants that simulate the robots of a command.

use crate::console::{Exit, Failure};
use opspace_experiment::run::physics::OWN_PLANT;
use opspace_mujoco::Mujoco;
use opspace_sim::PhysicsEngine;
use std::path::PathBuf;
use std::sync::Arc;

/// Plant on the command line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PlantChoice {
    /// The library's own plant.
    Own,
    /// MuJoCo, with the scene in a file if one is given.
    Mujoco(Option<PathBuf>),
}

/// Parses a plant.
pub fn plant_choice(text: &str) -> Result<PlantChoice, String> {
    match text.split_once(':') {
        None if text == OWN_PLANT => Ok(PlantChoice::Own),
        None if text == "mujoco" => Ok(PlantChoice::Mujoco(None)),
        Some(("mujoco", scene)) if !scene.is_empty() => Ok(PlantChoice::Mujoco(Some(scene.into()))),
        _ => Err("expected own, mujoco or mujoco:SCENE.xml".to_owned()),
    }
}

impl PlantChoice {
    /// Opens the physics engine; `None` for the own plant.
    pub fn open(&self) -> Result<Option<Arc<dyn PhysicsEngine>>, Failure> {
        match self {
            Self::Own => Ok(None),
            Self::Mujoco(scene) => match Mujoco::find(scene.as_deref()) {
                Ok(mujoco) => Ok(Some(Arc::new(mujoco))),
                Err(error) => Err(Failure::Other(error.to_string(), Exit::Bad)),
            },
        }
    }
}

/// Opens the plants of a suite. Each may be listed once.
pub fn open_plants(choices: &[PlantChoice]) -> Result<Vec<Option<Arc<dyn PhysicsEngine>>>, Failure> {
    if let Some(twice) = (1..choices.len()).find(|&index| choices[..index].contains(&choices[index])) {
        let text = format!("--plants: plant {} is listed twice", twice + 1);
        return Err(Failure::Other(text, Exit::Bad));
    }
    choices.iter().map(PlantChoice::open).collect()
}

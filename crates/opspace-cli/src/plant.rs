//! Plants that simulate the robots of a command.

use crate::console::{Exit, Failure};
use opspace_experiment::Extensions;
use opspace_experiment::plants::PlantEntry;
use opspace_experiment::run::physics::OWN_PLANT;
use opspace_mujoco::Mujoco;
use opspace_sim::PhysicsEngine;
use std::sync::Arc;

/// Plant on the command line: the name of a plant of the program, and the argument behind its colon.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlantChoice {
    name: String,
    argument: Option<String>,
}

/// MuJoCo in the table of plants.
pub fn mujoco() -> PlantEntry {
    let description = "MuJoCo, with a scene of your own if one is given; it needs `pip install mujoco`";
    let open = |scene: Option<&str>| Ok(Arc::new(Mujoco::find(scene.map(str::as_ref))?) as _);
    PlantEntry::new("mujoco", description, open).with_argument("SCENE.xml")
}

/// Forms of all plants of a program, each with the description of its plant.
pub fn plant_forms(extensions: &Extensions) -> Vec<(String, &'static str)> {
    let of = |entry: &PlantEntry| {
        let description = entry.description();
        entry.forms().into_iter().map(move |form| (form, description)).collect::<Vec<_>>()
    };
    extensions.all::<PlantEntry>().flat_map(of).collect()
}

/// Parses a plant in one of these forms, whose arguments stand for any text.
pub fn plant_choice(text: &str, forms: &[String]) -> Result<PlantChoice, String> {
    let (name, argument) = match text.split_once(':') {
        Some((name, argument)) => (name, Some(argument)),
        None => (text, None),
    };
    let fits = |form: &String| match (form.split_once(':'), argument) {
        (Some((of, _)), Some(argument)) => of == name && !argument.is_empty(),
        (None, None) => form == name,
        _ => false,
    };
    if forms.iter().any(fits) {
        return Ok(PlantChoice { name: name.to_owned(), argument: argument.map(str::to_owned) });
    }
    match forms {
        [one] => Err(format!("expected {one}")),
        [others @ .., last] => Err(format!("expected {} or {last}", others.join(", "))),
        [] => Err("this program has no plants".to_owned()),
    }
}

impl PlantChoice {
    /// Plant of this name, with the path of its scene if it has one.
    pub fn named(name: &str, scene: Option<String>) -> Self {
        Self { name: name.to_owned(), argument: scene }
    }

    /// True for the library's own plant.
    pub fn is_own(&self) -> bool {
        self.name == OWN_PLANT
    }

    /// End of the names of folders with results: empty for the own plant, otherwise a hyphen and the name.
    pub fn suffix(&self) -> String {
        if self.is_own() { String::new() } else { format!("-{}", self.name) }
    }

    /// Opens the physics engine; `None` for the own plant.
    pub fn open(&self, extensions: &Extensions) -> Result<Option<Arc<dyn PhysicsEngine>>, Failure> {
        if self.is_own() {
            return Ok(None);
        }
        let bad = |text: String| Failure::Other(text, Exit::Bad);
        let entry = extensions.find::<PlantEntry>(&self.name).map_err(|e| bad(format!("{e}: {}", e.help)))?;
        let engine = entry.open(self.argument.as_deref()).map_err(|e| bad(e.to_string()))?;
        Ok((engine.name() != OWN_PLANT).then_some(engine))
    }
}

/// Opens the plants of a suite. Each may be listed once.
pub fn open_plants(
    choices: &[PlantChoice],
    extensions: &Extensions,
) -> Result<Vec<Option<Arc<dyn PhysicsEngine>>>, Failure> {
    if let Some(twice) = (1..choices.len()).find(|&index| choices[..index].contains(&choices[index])) {
        let text = format!("--plants: plant {} is listed twice", twice + 1);
        return Err(Failure::Other(text, Exit::Bad));
    }
    choices.iter().map(|choice| choice.open(extensions)).collect()
}

//! Plant of a simulation: the library's own, or another physics engine.

use opspace_sim::{PhysicsEngine, RigidEngine, Scene};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Name of the library's own plant in results, logs and on the command line.
pub const OWN_PLANT: &str = RigidEngine::NAME;

/// Entries of a log's metadata.
const PLANT: &str = "plant";
const VERSION: &str = "plant_version";
const SCENE: &str = "plant_scene";
/// Name of a log in place of a plant, and entry with its path.
const LOG_PLANT: &str = "log";
const LOG_PATH: &str = "plant_log";

/// Plant of an experiment's simulation.
#[derive(Clone, Debug, Default)]
pub(crate) enum Physics {
    /// The library's own plant.
    #[default]
    Own,
    /// Another physics engine.
    Engine(Arc<dyn PhysicsEngine>),
    /// Physics engine of a log, which is not available.
    Logged(EngineName),
    /// A log in place of a plant: its measurements are given, and commands do not change them.
    Replay(ReplayedLog),
}

impl Physics {
    /// Plant that an engine simulates.
    pub fn of_engine(engine: Arc<dyn PhysicsEngine>) -> Self {
        if engine.name() == OWN_PLANT { Self::Own } else { Self::Engine(engine) }
    }

    /// Name in results: `own`, `mujoco 3.2.7` with the file name of the scene, or `log` with its path.
    pub fn label(&self) -> String {
        if let Self::Replay(log) = self {
            return format!("{LOG_PLANT} {}", log.path);
        }
        self.engine_name().map_or_else(|| OWN_PLANT.to_owned(), |name| name.label())
    }

    /// Scene of the engine, if it has one.
    pub fn scene(&self) -> Option<&Scene> {
        match self {
            Self::Engine(engine) => engine.scene(),
            Self::Own | Self::Logged(_) | Self::Replay(_) => None,
        }
    }

    /// Path of the scene, also of an engine that is not available.
    pub fn scene_path(&self) -> Option<String> {
        self.engine_name().and_then(|name| name.scene)
    }

    /// Entries of a log's metadata.
    pub fn entries(&self) -> Vec<(String, String)> {
        if let Self::Replay(log) = self {
            return vec![(PLANT.to_owned(), LOG_PLANT.to_owned()), (LOG_PATH.to_owned(), log.path.clone())];
        }
        let Some(name) = self.engine_name() else { return vec![(PLANT.to_owned(), OWN_PLANT.to_owned())] };
        let scene = name.scene.map(|scene| (SCENE.to_owned(), scene));
        [(PLANT.to_owned(), name.name), (VERSION.to_owned(), name.version)].into_iter().chain(scene).collect()
    }

    /// Plant of a log with these entries, which was recorded on a real robot or not.
    pub fn of_entries(entries: &BTreeMap<String, String>, real: bool) -> Self {
        let Some(name) = entries.get(PLANT).filter(|name| *name != OWN_PLANT) else { return Self::Own };
        if name == LOG_PLANT {
            let path = entries.get(LOG_PATH).cloned().unwrap_or_default();
            return Self::Replay(ReplayedLog { path, real });
        }
        let version = entries.get(VERSION).cloned().unwrap_or_default();
        Self::Logged(EngineName { name: name.clone(), version, scene: entries.get(SCENE).cloned() })
    }

    fn engine_name(&self) -> Option<EngineName> {
        match self {
            Self::Own | Self::Replay(_) => None,
            Self::Engine(engine) => Some(EngineName::of(&**engine)),
            Self::Logged(name) => Some(name.clone()),
        }
    }
}

/// Log in place of a plant.
#[derive(Clone, Debug)]
pub(crate) struct ReplayedLog {
    /// Path of the log.
    pub path: String,
    /// True if it was recorded on a real robot.
    pub real: bool,
}

/// Name, version and scene of a physics engine.
#[derive(Clone, Debug)]
pub(crate) struct EngineName {
    name: String,
    version: String,
    /// Path of the scene, if any.
    scene: Option<String>,
}

impl EngineName {
    fn of(engine: &dyn PhysicsEngine) -> Self {
        Self {
            name: engine.name().to_owned(),
            version: engine.version().to_owned(),
            scene: engine.scene().map(|scene| scene.path.display().to_string()),
        }
    }

    fn label(&self) -> String {
        let file = self.scene.as_deref().and_then(|scene| Path::new(scene).file_name());
        let scene = file.map_or_else(String::new, |file| format!(" with {}", file.to_string_lossy()));
        format!("{} {}{scene}", self.name, self.version)
    }
}

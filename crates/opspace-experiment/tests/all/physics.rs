//! Experiments and suites on another physics engine: one that is the library's own plant under another name.

use opspace_experiment::run::log_header::RUN;
use opspace_experiment::run::replay::replay;
use opspace_experiment::{Experiment, Files, Progress, RunOptions};
use opspace_log::{OutcomeRecord, Recording};
use opspace_sim::{PhysicsEngine, Plant, PlantConfig, PlantError, RigidPlant, Scene};
use opspace_suite::Suite;
use std::io::Cursor;
use std::path::Path;
use std::sync::Arc;

/// Physics step of the ASIMO-like arm, and its rounding error, s.
const STEP_S: f64 = 5e-5;
const ROUNDING_S: f64 = 1e-12;

/// Engine with a scene that it ignores.
#[derive(Debug)]
struct OtherEngine {
    scene: Scene,
    refuses: bool,
}

impl OtherEngine {
    fn shared() -> Arc<dyn PhysicsEngine> {
        let scene = Scene { path: "folder/table.xml".into(), text: "<table/>".to_owned() };
        Arc::new(Self { scene, refuses: false })
    }
}

impl PhysicsEngine for OtherEngine {
    fn name(&self) -> &str {
        "other"
    }

    fn version(&self) -> &str {
        "1.2"
    }

    fn scene(&self) -> Option<&Scene> {
        Some(&self.scene)
    }

    fn build(&self, parts: PlantConfig) -> Result<Box<dyn Plant>, PlantError> {
        if self.refuses {
            let message = "the table is too small".to_owned();
            return Err(PlantError { message, file: Some(self.scene.path.clone()) });
        }
        assert!((parts.step_s - STEP_S).abs() < ROUNDING_S);
        Ok(Box::new(RigidPlant::new(parts)))
    }
}

fn experiment(task: &str) -> Experiment {
    let options = RunOptions { duration_s: Some(1.0), ..RunOptions::default() };
    let settings = ["settle_s=0.2".to_owned()];
    Experiment::load(Files::Embedded, Path::new(task), None, options, &settings).expect("an experiment")
}

/// Compared: name, scene and version of the engine, and those of the log, of its summary and of the experiment that is built
/// from the log; and the rows of the log and those of a replay without the engine.
#[test]
fn log_names_its_engine() {
    let experiment =
        experiment("tasks/joint-tracking.toml").on_engine(OtherEngine::shared()).expect("a plant");
    assert!(experiment.input_paths().contains(&"folder/table.xml".into()));
    let run = experiment.run(Cursor::new(Vec::new()), &Progress::default()).expect("a run");
    let log = Recording::from_bytes(&run.sink.into_inner()).expect("a log");
    let entries = log.metadata(RUN).expect("a header");
    let entry = |key: &str| entries[key].as_str();
    assert_eq!(
        [entry("plant"), entry("plant_version"), entry("plant_scene")],
        ["other", "1.2", "folder/table.xml"]
    );
    assert_eq!(log.attachment("scene.xml").expect("the scene").data, b"<table/>");
    let logged = Experiment::of_log(&log).expect("an experiment");
    let label = "other 1.2 with table.xml";
    assert_eq!([experiment.plant(), logged.plant()], [label, label]);
    assert_eq!(logged.summary(&log, &OutcomeRecord::default(), None).plant.as_deref(), Some(label));
    let replayed = replay(&logged, &log).expect("a replay");
    assert_eq!((replayed.differing, replayed.compared), (0, replayed.logged));
    let error = logged.simulated_arm().err().expect("no engine").to_string();
    assert!(error.contains("was simulated by other 1.2"), "{error}");
}

/// Checks the place and the words of an engine's refusal.
#[test]
fn refusal_of_an_engine_names_its_file() {
    let scene = Scene { path: "folder/table.xml".into(), text: String::new() };
    let engine = Arc::new(OtherEngine { scene, refuses: true });
    let error = experiment("tasks/joint-tracking.toml").on_engine(engine).expect_err("refused");
    assert_eq!(error.to_string(), "folder/table.xml: the table is too small");
}

/// Compared: experiments and fingerprints of a suite on one plant, and on two.
#[test]
fn suite_has_each_run_on_each_plant() {
    let suite = || Suite::load(Files::Embedded, Path::new("tasks/suites/paper.toml")).expect("a suite");
    let one = suite().on_plants(&[None]).expect("plants");
    assert_eq!(one.fingerprint(), suite().fingerprint());
    let two = suite().on_plants(&[None, Some(OtherEngine::shared())]).expect("plants");
    assert_eq!(two.runs.len(), 2 * one.runs.len());
    for (pair, own) in two.runs.chunks(2).zip(one.of_robots()) {
        assert_eq!([pair[0].plant().as_str(), pair[1].plant().as_str()], ["own", "other 1.2 with table.xml"]);
        let seeds = [&pair[0], &pair[1]].map(|run| run.single().map(Experiment::seed));
        assert_eq!(seeds, [Some(own.seed()), Some(own.seed())]);
    }
    let other = suite().on_plants(&[Some(OtherEngine::shared())]).expect("plants");
    let prints = [one.fingerprint(), two.fingerprint(), other.fingerprint()];
    assert!(prints[0] != prints[1] && prints[1] != prints[2] && prints[0] != prints[2]);
}

//! Experiments on MuJoCo's plant: motion, log and replay.

use crate::common::{mujoco, project};
use opspace_backend::CommandKind;
use opspace_backend::signal_names::{Q, TRUTH_CHANNEL};
use opspace_experiment::run::log_header::RUN;
use opspace_experiment::run::replay::replay;
use opspace_experiment::{Companion, Experiment, Files, Progress, RunOptions, Scenario};
use opspace_log::{LogFile, Recording, ViewerReceiver, compare_logs};
use opspace_loop::Run;
use opspace_sim::{ExternalForceHandle, Pull};
use std::io::Cursor;
use std::sync::Arc;

/// Settings of an arm without friction, noise and quantisation.
const FRICTIONLESS: [&str; 4] = [
    "robot.simulated.true_over_nominal.friction=0.0",
    "robot.simulated.torque_noise_nm=0.0",
    "robot.simulated.encoder_quantisation=false",
    "friction_compensation.gain=0.0",
];

fn experiment(task: &str, backend: CommandKind, duration_s: f64, settings: &[&str]) -> Experiment {
    let options = RunOptions { backend, duration_s: Some(duration_s), ..RunOptions::default() };
    let settings: Vec<String> = settings.iter().map(|&setting| setting.to_owned()).collect();
    Experiment::load(Files::Disk, &project(task), None, options, &settings).expect("an experiment")
}

fn recorded(experiment: &Experiment) -> Recording {
    let run = experiment.run(Cursor::new(Vec::new()), &Progress::default()).expect("a run");
    assert_eq!(run.record.fault, None);
    Recording::from_bytes(&run.sink.into_inner()).expect("a log")
}

/// Returns the largest difference of true joint positions over two runs, and the largest travel in the first, rad.
fn largest_difference(a: &Recording, b: &Recording) -> (f64, f64) {
    let rows = |log: &Recording| -> Vec<Vec<f64>> {
        let truth = log.channel(TRUTH_CHANNEL).expect("truth");
        truth.signal(Q).expect("positions").rows().map(<[f64]>::to_vec).collect()
    };
    let (a, b) = (rows(a), rows(b));
    assert_eq!(a.len(), b.len());
    let largest =
        |pairs: &mut dyn Iterator<Item = (&f64, &f64)>| pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let travel = largest(&mut a.iter().flat_map(|row| row.iter().zip(&a[0])));
    (largest(&mut a.iter().zip(&b).flat_map(|(a, b)| a.iter().zip(b))), travel)
}

/// Compared: true joint positions of the Panda as a torque robot without friction, from the brakes' release on, and those on
/// the library's own plant.
#[test]
fn frictionless_torque_robot_moves_as_on_the_own_plant() {
    const TOLERANCE_RAD: f64 = 1e-4;
    let Some(mujoco) = mujoco(None) else { return };
    let own = experiment("tasks/panda-reach.toml", CommandKind::Torque, 2.0, &FRICTIONLESS);
    let other = own.clone().on_engine(Arc::new(mujoco)).expect("a plant");
    let (difference, travel) = largest_difference(&recorded(&own), &recorded(&other));
    println!("torque robot without friction: {difference:.1e} rad apart, travel {travel:.2} rad");
    assert!(travel > 0.3 && difference < TOLERANCE_RAD, "{difference:e} rad");
}

/// Compared: as above, for a position robot with friction, noise and quantised encoders, which amplify rounding errors.
#[test]
fn position_robot_with_friction_moves_as_on_the_own_plant() {
    const TOLERANCE_RAD: f64 = 1e-4;
    /// The arm moves along the wall.
    const LEAST_TRAVEL_RAD: f64 = 0.02;
    let Some(mujoco) = mujoco(None) else { return };
    let own = experiment("tasks/press-wall.toml", CommandKind::Position, 3.0, &[]);
    let other = own.clone().on_engine(Arc::new(mujoco)).expect("a plant");
    let (difference, travel) = largest_difference(&recorded(&own), &recorded(&other));
    println!("position robot with friction at a wall: {difference:.1e} rad apart, travel {travel:.2} rad");
    assert!(travel > LEAST_TRAVEL_RAD && difference < TOLERANCE_RAD, "{difference:e} rad");
}

/// Checks that a log names its plant, can be replayed without MuJoCo, and is not simulated again by another plant.
#[test]
fn log_names_its_plant_and_is_replayed() {
    let scene = project("tests/mujoco/free-box.xml");
    let Some(mujoco) = mujoco(Some(&scene)) else { return };
    let version = opspace_sim::PhysicsEngine::version(&mujoco).to_owned();
    let experiment = experiment("tasks/panda-reach.toml", CommandKind::Torque, 1.0, &[]);
    assert_eq!(experiment.plant(), "own");
    let experiment = experiment.on_engine(Arc::new(mujoco)).expect("a plant");
    let label = format!("mujoco {version} with free-box.xml");
    assert_eq!(experiment.plant(), label);
    let log = recorded(&experiment);
    let entries = log.metadata(RUN).expect("a header");
    assert_eq!((&*entries["plant"], &*entries["plant_version"]), ("mujoco", &*version));
    assert_eq!(entries["plant_scene"], scene.display().to_string());
    let attached = &log.attachment("scene.xml").expect("the scene").data;
    assert_eq!(*attached, std::fs::read(&scene).expect("the scene"));
    let logged = Experiment::of_log(&log).expect("an experiment");
    assert_eq!(logged.plant(), label);
    let summary = logged.summary(&log, &opspace_log::OutcomeRecord::default(), None);
    assert_eq!(summary.plant, Some(label));
    let replayed = replay(&logged, &log).expect("a replay");
    assert_eq!((replayed.differing, replayed.compared), (0, replayed.logged));
    let error = logged.simulated_arm().err().expect("no engine");
    assert!(error.to_string().contains("was simulated by mujoco"), "{error}");
}

/// Hand that drags the flange for a part of the run.
struct Hand {
    handle: ExternalForceHandle,
    frame: opspace_model::FrameId,
    /// Largest excursion of its target, m.
    amplitude_m: f64,
}

impl Companion for Hand {
    fn receivers(&mut self, _robot: usize) -> Vec<Box<dyn ViewerReceiver>> {
        Vec::new()
    }

    fn before_cycle(&mut self, _robot: usize, time_s: f64, _run: &mut Run<'_>) -> bool {
        let target_m = nalgebra::Vector3::new(0.5 + self.amplitude_m * (9.0 * time_s).sin(), 0.05, 0.55);
        let pull = Pull::Drag {
            point_m: nalgebra::Vector3::new(0.01, 0.02, 0.03),
            target_m,
            stiffness_n_per_m: 300.0,
            damping_ns_per_m: 10.0,
            largest_force_n: 30.0,
        };
        match (0.3..0.9).contains(&time_s) {
            true => self.handle.apply(self.frame, pull),
            false => self.handle.release(),
        }
        true
    }
}

/// Compared: every signal of ten runs that a hand drags, and of their replays; every message, and those of simulations of their logs.
#[test]
fn dragged_runs_are_replayed_and_simulated_again() {
    let Some(mujoco) = mujoco(None) else { return };
    let mujoco = Arc::new(mujoco);
    for number in 0..10 {
        let backend = if number % 2 == 0 { CommandKind::Torque } else { CommandKind::Position };
        let amplitude_m = 0.05 + 0.01 * f64::from(number);
        let settings = ["settle_s=0.1", "environment={}"];
        let own = experiment("tasks/panda-compliant.toml", backend, 1.2, &settings);
        let dragged = own.on_engine(Arc::clone(&mujoco) as _).expect("a plant");
        let scenario = Scenario::from(dragged.clone());
        let progress = Progress::default();
        let mut arms = scenario.pushable_arms().expect("arms");
        let handle = arms[0].external_force().expect("it may be pushed");
        let frame = dragged.robot().model.frame_id("flange").expect("the flange");
        let mut robots: Vec<&mut dyn opspace_backend::Backend> =
            arms.iter_mut().map(|arm| arm as &mut dyn opspace_backend::Backend).collect();
        let open = |_, capabilities: &_, truth, receivers| {
            dragged.open_with(capabilities, truth, Cursor::new(Vec::new()), &progress, receivers)
        };
        let driven = scenario.drive_robots_with(
            &mut robots,
            &progress,
            &mut Hand { handle, frame, amplitude_m },
            open,
        );
        let (log, outcome) = driven.expect("a run").remove(0);
        let bytes = log.close(&dragged, outcome).expect("a log").sink.into_inner();
        let log = Recording::from_bytes(&bytes).expect("a log");
        let force = log.channel("external").and_then(|rows| rows.signal("force")).expect("forces");
        assert!(force.rows().any(|row| row[0].abs() > 5.0));
        let of_log = Experiment::of_log(&log)
            .expect("an experiment")
            .on_engine(Arc::clone(&mujoco) as _)
            .expect("a plant");
        assert_eq!(replay(&of_log, &log).expect("a replay").differing, 0);
        let again = of_log.repeat(&log, Cursor::new(Vec::new()), &Progress::default()).expect("a simulation");
        let logs = [bytes, again.sink.into_inner()].map(|bytes| LogFile::from_bytes(bytes).expect("a log"));
        let comparison = compare_logs(&logs[0], &logs[1]).expect("readable logs");
        assert!(!comparison.differs(), "{:?}", comparison.parts);
    }
}

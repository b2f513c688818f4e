//! Experiments on a robot that is not known to be simulated: a simulated arm that declares itself real and whose
//! clock can start at any time.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use crate::coupled_common::{LOWERED, NEAR_TABLE, load, project, run};
use opspace_backend::{
    Backend, Capabilities, Command, CommandKind, DeviceFault, Driver, DriverError, GroundTruth, Sample,
    Settings, TruthLayouts, TruthRow, World,
};
use opspace_experiment::run::replay::replay;
use opspace_experiment::run::result_files::ResultFolder;
use opspace_experiment::{Experiment, Extensions, Files, Metrics, Progress, RunError, RunOptions};
use opspace_log::{OutcomeRecord, Recording};
use opspace_report::move_to_start;
use opspace_report::run_on_drivers;
use opspace_sim::SimulatedArm;
use std::cell::RefCell;
use std::io::Cursor;
use std::path::Path;
use std::rc::Rc;

/// Simulated arm with other capabilities and another clock.
struct Disguised {
    arm: SimulatedArm,
    capabilities: Capabilities,
    clock_start_s: f64,
}

impl Disguised {
    fn new(arm: SimulatedArm, world: World, clock_start_s: f64) -> Self {
        let mut capabilities = arm.capabilities().clone();
        capabilities.world = world;
        Self { arm, capabilities, clock_start_s }
    }
}

impl Backend for Disguised {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        self.arm.read(sample)?;
        sample.time_s += self.clock_start_s;
        Ok(())
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        self.arm.write(command)
    }

    fn stop(&mut self) {
        self.arm.stop();
    }

    fn ground_truth(&self) -> Option<&dyn GroundTruth> {
        (self.capabilities.world == World::Simulated).then_some(self)
    }
}

impl GroundTruth for Disguised {
    fn layouts(&self) -> TruthLayouts {
        self.arm.layouts()
    }

    fn visit(&self, visit: &mut dyn FnMut(TruthRow<'_>)) {
        self.arm.visit(&mut |mut row| {
            match &mut row {
                TruthRow::State { time_s, .. }
                | TruthRow::Servo { time_s, .. }
                | TruthRow::External { time_s, .. } => {
                    *time_s += self.clock_start_s;
                }
                _ => {}
            }
            visit(row);
        });
    }
}

/// Driver that opens the same arm each time.
struct OneArm(Rc<RefCell<Disguised>>);

impl Driver for OneArm {
    fn name(&self) -> &str {
        "one-arm"
    }

    fn with(&self, settings: &Settings, run: &mut dyn FnMut(&mut dyn Backend)) -> Result<(), DriverError> {
        settings.expect_only(&[])?;
        run(&mut *self.0.borrow_mut());
        Ok(())
    }
}

/// Settings that select the driver. Its arm is simulated and never waits: as a real-time thread, the control thread would keep the one
/// that writes the log from its work.
const ONE_ARM: [&str; 2] = ["robot.driver.name=one-arm", "robot.driver.real_time=off"];

const ROBOT: &str = "robots/asimo-arm/robot.toml";
const BACKENDS: [CommandKind; 3] = [CommandKind::Position, CommandKind::Velocity, CommandKind::Torque];

fn experiment(task: &str, backend: CommandKind, settings: &[&str]) -> Experiment {
    let options = RunOptions { backend, duration_s: Some(2.0), ..RunOptions::default() };
    let settings: Vec<String> = settings.iter().map(|&setting| setting.to_owned()).collect();
    Experiment::load(Files::Embedded, Path::new(task), None, options, &settings).unwrap()
}

/// Metrics of a simulated run with a clock that starts at `clock_start_s`, and number of missed cycles.
fn measured(experiment: &Experiment, clock_start_s: f64) -> (Metrics, u64) {
    let mut arm = Disguised::new(experiment.simulated_arm().unwrap(), World::Simulated, clock_start_s);
    let result = experiment.run_on(&mut arm, Cursor::new(Vec::new()), &Progress::default()).unwrap();
    let recording = Recording::from_bytes(&result.sink.into_inner()).unwrap();
    let summary = experiment.summary(&recording, &result.record, None);
    assert_eq!(summary.faulted, None);
    (summary.metrics, summary.missed_cycles)
}

/// Compared: all metrics of runs with clocks that start at 1000 s and at -5 s, and those of the same run with a clock
/// that starts at 0. They differ at most by the rounding of time stamps, with and without lost cycles.
#[test]
fn clock_start_changes_no_metric() {
    /// The rounding error of a time stamp of 1000 s, relative to a period of 1 ms, is 1e-10; the motion amplifies it.
    const RELATIVE: f64 = 1e-6;
    let lossy = "robot.simulated.bus.lost_cycles_share=0.01";
    for (backend, settings) in
        [(CommandKind::Position, vec![lossy]), (CommandKind::Velocity, vec![]), (CommandKind::Torque, vec![])]
    {
        let experiment = experiment("tasks/compliant-x.toml", backend, &settings);
        let (zero, missed) = measured(&experiment, 0.0);
        let zero = serde_json::to_value(zero).unwrap();
        assert_eq!(missed > 0, !settings.is_empty());
        for clock_start_s in [1000.0, -5.0] {
            let (shifted, shifted_missed) = measured(&experiment, clock_start_s);
            assert_eq!(shifted_missed, missed);
            let shifted = serde_json::to_value(shifted).unwrap();
            let mut numbers = 0;
            for (key, value) in zero.as_object().unwrap() {
                let (a, b) = (value.as_f64(), shifted[key].as_f64());
                assert_eq!(a.is_some(), b.is_some(), "{key}");
                let Some((a, b)) = a.zip(b) else { continue };
                assert!(
                    (a - b).abs() <= RELATIVE * a.abs(),
                    "{backend:?} from {clock_start_s} s: {key} {b}, not {a}"
                );
                numbers += 1;
            }
            assert!(numbers >= 5, "{numbers} metrics");
        }
    }
}

/// Creates an arm at a distance from the start position of the task, rad, and a driver for it.
fn arm_away_from_start(experiment: &Experiment, offset_rad: f64) -> (Rc<RefCell<Disguised>>, Extensions) {
    let mut config = experiment.arm_config().unwrap();
    config.start.iter_mut().for_each(|q| *q += offset_rad);
    let arm = Rc::new(RefCell::new(Disguised::new(SimulatedArm::new(config).unwrap(), World::Real, 30.0)));
    let extensions = Extensions::default().with_driver(OneArm(Rc::clone(&arm)));
    (arm, extensions)
}

/// Compared: the refusal of an arm that is not at the start position, its distance after the motion, its highest
/// speed and the documented limit, and the run afterwards.
#[test]
fn real_robot_moves_slowly_to_start_first() {
    /// The limit of the reference is 0.2 rad/s; a joint that is first held by friction moves faster to catch up.
    const SPEED_RAD_PER_S: f64 = 1.5 * 0.2;
    /// Number of rows over which a speed is averaged, enough to suppress the encoder noise.
    const WINDOW: usize = 50;
    const WINDOW_S: f64 = 0.05;
    const AT_START_RAD: f64 = 0.02;
    for backend in BACKENDS {
        let experiment = experiment("tasks/joint-tracking.toml", backend, &ONE_ARM);
        let start = experiment.arm_config().unwrap().start;
        let (arm, extensions) = arm_away_from_start(&experiment, 0.3);
        let progress = Progress::default();
        let run = || experiment.run_on_driver(&extensions, Cursor::new(Vec::new()), &progress);

        let refused = run().map(|_| ()).unwrap_err();
        assert!(matches!(refused, RunError::AwayFromStart { .. }), "{refused}");
        assert!(refused.to_string().contains("--move-to-start"), "{refused}");

        let folder = tempfile::tempdir().unwrap();
        let moved = move_to_start(&experiment, &extensions, folder.path(), &progress, (&|_| {}, &|_| {}))
            .unwrap()
            .unwrap();
        assert_eq!(moved.faulted, None, "{backend:?}");
        let recording = Recording::read(folder.path().join("run.mcap")).unwrap();
        let q: Vec<&[f64]> = recording.tick().unwrap().signal("q").unwrap().rows().collect();
        let passed = q.windows(WINDOW + 1).flat_map(|rows| rows[0].iter().zip(rows[WINDOW]));
        let fastest = passed.fold(0.0_f64, |most, (from, to)| most.max((to - from).abs())) / WINDOW_S;
        assert!((0.1..SPEED_RAD_PER_S).contains(&fastest), "{backend:?}: {fastest} rad/s");
        for (q, start) in arm.borrow().arm.true_q().iter().zip(&start) {
            assert!((q - start).abs() < AT_START_RAD, "{backend:?}: {q} and {start}");
        }
        assert_eq!(
            move_to_start(&experiment, &extensions, folder.path(), &progress, (&|_| {}, &|_| {})).unwrap(),
            None
        );
        assert_eq!(run().unwrap().record.fault, None, "{backend:?}");
    }
}

/// Options that a program without comparisons refuses, and one with them allows in simulation, not on a real robot.
#[test]
fn comparison_options_are_refused_on_real_robot() {
    for singularities in ["plain", "least-squares", "clamped"] {
        let setting = format!("task.hand.cartesian.singularities={singularities}");
        let settings = [setting, "robot.driver.name=one-arm".to_owned()];
        let options = RunOptions { duration_s: Some(2.0), ..RunOptions::default() };
        let read = |extensions: &Extensions| {
            let task = Path::new("tasks/cartesian-tracking.toml");
            Experiment::load_with(extensions, Files::Embedded, task, None, options.clone(), &settings)
        };
        let words = read(&Extensions::default()).unwrap_err().to_string();
        assert!(words.contains("which this program does not have"), "{words}");
        let experiment = read(&Extensions::default().with_comparisons()).unwrap();
        let (_, extensions) = arm_away_from_start(&experiment, 0.0);
        let progress = Progress::default();
        let refused = experiment.run_on_driver(&extensions, Cursor::new(Vec::new()), &progress);
        let words = refused.map(|_| ()).unwrap_err().to_string();
        assert!(words.contains("not for a real robot") && words.contains("singularities"), "{words}");
        assert!(experiment.run(Cursor::new(Vec::new()), &progress).is_ok(), "it is allowed in simulation");
    }
}

/// Error message for a robot without a driver.
#[test]
fn robot_without_driver_cannot_move_to_start() {
    let experiment = experiment("tasks/joint-tracking.toml", CommandKind::Position, &[]);
    let folder = tempfile::tempdir().unwrap();
    let refused = move_to_start(
        &experiment,
        &Extensions::default(),
        folder.path(),
        &Progress::default(),
        (&|_| {}, &|_| {}),
    );
    let words = refused.map(|_| ()).unwrap_err().to_string();
    assert!(words.contains(ROBOT) && words.contains("no [driver]"), "{words}");
}

/// Compared: displacements of two coupled robots in simulation, and with one of them opened by a driver, which is read once before
/// the run; the log of each, and its replay. The real robot has to be at its start, and objects are refused.
#[test]
fn one_of_coupled_robots_is_real() {
    /// Distance of two runs with other noise and with samples that are a cycle apart, at 0.2 m/s.
    const OTHER_NOISE_M: f64 = 5e-4;
    let load = |name: &str, settings: &[&str]| {
        let own = ["expect={}", "settle_s=0.1", "duration_s=1.0", NEAR_TABLE, LOWERED];
        let settings = if name == "teleop-wall" { [&own[..], settings].concat() } else { settings.to_vec() };
        load(&project(&format!("tasks/experiments/{name}.toml")), &settings)
    };
    let driver = ["leader.robot.driver.name=one-arm", "leader.robot.driver.real_time=off"];
    let experiment = load("teleop-wall", &driver);
    assert_eq!(experiment.real_robots(), ["leader"]);
    let simulated = run(&experiment);
    let folder = tempfile::tempdir().unwrap();
    let on_drivers = |offset_rad: f64| {
        let leader = &experiment.members[1].experiment;
        let (arm, extensions) = arm_away_from_start(leader, offset_rad);
        arm.borrow_mut().clock_start_s = 0.0;
        let results = ResultFolder::open(folder.path()).unwrap();
        run_on_drivers(&experiment, &extensions, &results, &Progress::default(), &|_| {})
    };
    let away = on_drivers(0.3).unwrap_err().to_string();
    assert!(away.contains("start"), "{away}");
    let summary = on_drivers(0.0).unwrap();
    assert!(!summary.has_failed(), "{:?}", summary.failures());
    for name in ["leader", "follower"] {
        let log = Recording::read(folder.path().join(name).join("run.mcap")).unwrap();
        let replayed = replay(&Experiment::of_log(&log).unwrap(), &log).unwrap();
        assert!(replayed.differing == 0 && replayed.compared > 1000, "{name}: {replayed:?}");
        let displacement = |log: &Recording, k: usize| -> Vec<f64> {
            log.tick().unwrap().signal("hand.displacement").unwrap().row(k).to_vec()
        };
        for k in 0..log.tick().unwrap().len() {
            let pair = displacement(&log, k).into_iter().zip(displacement(&simulated.logs[name], k));
            let apart = pair.fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()));
            assert!(apart < OTHER_NOISE_M, "{name}: {apart} m in row {k}");
        }
    }
    // The real robot has no true state.
    let leader = Recording::read(folder.path().join("leader/run.mcap")).unwrap();
    assert!(leader.channel("truth").is_none());
    let carry = load("two-arms-carry", &["left.robot.driver.name=one-arm"]);
    let results = ResultFolder::open(folder.path()).unwrap();
    let refused =
        run_on_drivers(&carry, &Extensions::default(), &results, &Progress::default(), &|_| {}).unwrap_err();
    assert!(refused.to_string().contains("robot 'left' is real"), "{refused}");
}

/// Compared: the scheduling that the outcome states with what this machine allows; the statistics in the summary of a run on a real
/// robot, with those of its log; and a simulation, which has none.
#[test]
fn only_a_real_robot_is_driven_in_real_time() {
    // Relative rounding of times in a summary, and that of the nanoseconds in a log.
    const ROUNDED: f64 = 1e-3;
    const ROUNDED_MS: f64 = 1e-6;
    for (mode, says) in [("auto", "memory"), ("off", "real-time scheduling is off")] {
        let mode = format!("robot.driver.real_time=\"{mode}\"");
        let settings = ["robot.driver.name=one-arm", &mode, "robot.driver.real_time_priority=5"];
        let experiment = experiment("tasks/joint-tracking.toml", CommandKind::Position, &settings);
        let (_, extensions) = arm_away_from_start(&experiment, 0.0);
        let progress = Progress::default();
        let result = experiment.run_on_driver(&extensions, Cursor::new(Vec::new()), &progress).unwrap();
        let recording = Recording::from_bytes(&result.sink.into_inner()).unwrap();
        let logged = OutcomeRecord::of(&recording);
        assert!(logged.real_time.as_ref().is_some_and(|text| text.contains(says)), "{logged:?}");
        let statistics = experiment.summary(&recording, &logged, None).real_time.unwrap();
        assert_eq!(
            (statistics.scheduling, result.record.real_time),
            (logged.real_time.clone(), logged.real_time)
        );
        let rows = recording.channel("timing").unwrap().signal("response_time").unwrap();
        assert_eq!(statistics.cycles, rows.rows().count() as u64);
        let longest_ms = rows.rows().fold(0.0_f64, |longest, row| longest.max(1e-6 * row[0]));
        assert!((statistics.response_ms.max - longest_ms).abs() <= ROUNDED * longest_ms + ROUNDED_MS);
        let simulated = experiment.run(Cursor::new(Vec::new()), &progress).unwrap();
        assert_eq!(simulated.record.real_time, None);
        let recording = Recording::from_bytes(&simulated.sink.into_inner()).unwrap();
        assert_eq!(experiment.summary(&recording, &simulated.record, None).real_time, None);
    }
}

#[test]
fn wrong_scheduling_of_a_driver_is_refused_with_the_choices() {
    for (setting, says) in [
        ("robot.driver.real_time=\"always\"", "auto, off, required"),
        ("robot.driver.real_time=true", "\"required\""),
        ("robot.driver.real_time_priority=0", "1 to 99"),
        ("robot.driver.real_time_priority=1.5", "1 to 99"),
        ("robot.driver.real_time_priority=100", "1 to 99"),
    ] {
        let settings = ["robot.driver.name=one-arm", setting];
        let experiment = experiment("tasks/joint-tracking.toml", CommandKind::Position, &settings);
        let (_, extensions) = arm_away_from_start(&experiment, 0.0);
        let refused = experiment.run_on_driver(&extensions, Cursor::new(Vec::new()), &Progress::default());
        let RunError::File(error) = refused.map(|_| ()).unwrap_err() else { panic!("{setting}") };
        let words = format!("{error} {}", error.help().unwrap_or_default());
        assert!(words.contains(says), "{words}");
    }
}

/// Compared: what this machine allows, and whether a robot that requires real-time scheduling is driven.
#[test]
fn required_scheduling_is_granted_or_refused_before_the_robot_is_opened() {
    let settings = ["robot.driver.name=one-arm", "robot.driver.real_time=\"required\""];
    let experiment = experiment("tasks/joint-tracking.toml", CommandKind::Position, &settings);
    let missing = experiment.robot().missing_real_time().unwrap();
    let (_, extensions) = arm_away_from_start(&experiment, 0.0);
    let driven = experiment.run_on_driver(&extensions, Cursor::new(Vec::new()), &Progress::default());
    match (driven, missing) {
        (Ok(result), None) => assert_eq!(result.record.fault, None),
        (Err(RunError::NotRealTime { words }), Some(missing)) => assert_eq!(words, missing),
        (Ok(_), Some(missing)) => panic!("it is driven without {missing}"),
        (Err(error), _) => panic!("{error}"),
    }
}

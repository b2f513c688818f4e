//! Tasks of an SO-101 on its simulated servo bus: the driver, the protocol, registers and counts are between controller and arm.
//!
//! Time is simulated, so that runs are repeated exactly on any machine. `.ci/run feetech` runs one in real time, behind a
//! pseudo-terminal.
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a test that prints a table")]

use crate::cli_common::{opspace, project, read_json, scratch};
use opspace_backend::{
    Backend, Capabilities, Command, DeviceFault, Driver, DriverError, Sample, Setting, Settings, TruthRow,
};
use opspace_experiment::run::replay::replay;
use opspace_experiment::{
    ControllerKind, Experiment, Extensions, Files, Progress, RunError, RunOptions, Summary,
};
use opspace_feetech::driver::with_transport;
use opspace_feetech::protocol::ErrorFlags;
use opspace_feetech::simulated::{SimulatedBus, SimulatedTransport, bus_with_arm};
use opspace_feetech::transport::Transport;
use opspace_feetech::{ArmConfig, BusFault, FeetechArm};
use opspace_log::Recording;
use opspace_loop::RunOutcome;
use opspace_mujoco::Mujoco;
use opspace_report::move_to_start;
use opspace_setup::identify::{IdentificationJob, Request};
use std::cell::RefCell;
use std::io;
use std::path::Path;
use std::rc::Rc;
use std::sync::{Arc, Mutex};
use std::time::Duration;

const TASKS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/so101");

/// True states of an arm at each servo tick, and the number of ticks before each command.
#[derive(Default)]
struct Truth {
    /// Motor torques, Nm.
    torque_nm: Vec<Vec<f64>>,
    /// Times of the samples before the commands, s, and the numbers of ticks before them.
    commands: Vec<(f64, usize)>,
    /// Number of ticks so far, and the force of the environment on the arm at each of them, world axes, N.
    force_n: Vec<[f64; 3]>,
}

/// Arm whose true states are collected, and whose commands are counted if it is the one that the controller commands.
struct Watched<B> {
    inner: B,
    truth: Arc<Mutex<Truth>>,
    is_commanded: bool,
    time_s: f64,
    /// Place of the force of the first object of the environment in the rows of the true state.
    force: Option<usize>,
}

impl<B: Backend> Watched<B> {
    fn new(inner: B, truth: &Arc<Mutex<Truth>>, is_commanded: bool) -> Self {
        let force = inner.ground_truth().and_then(|arm| {
            let signals = arm.layouts().truth.signals;
            let index = signals.iter().position(|signal| signal.name.ends_with(".force"))?;
            Some(signals[..index].iter().map(|signal| signal.len()).sum())
        });
        Self { inner, truth: Arc::clone(truth), is_commanded, time_s: 0.0, force }
    }
}

impl<B: Backend> Backend for Watched<B> {
    fn capabilities(&self) -> &Capabilities {
        self.inner.capabilities()
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        self.inner.read(sample)?;
        self.time_s = sample.time_s;
        let mut truth = self.truth.lock().unwrap();
        if let Some(arm) = self.inner.ground_truth() {
            arm.visit(&mut |row| match row {
                TruthRow::Servo { row, .. } => truth.torque_nm.push(row.to_vec()),
                TruthRow::State { row, .. } => {
                    if let Some(at) = self.force {
                        let force = [row[at], row[at + 1], row[at + 2]];
                        let ticks = truth.torque_nm.len();
                        truth.force_n.resize(ticks, force);
                    }
                }
                _ => {}
            });
        }
        Ok(())
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        let is_setpoint = matches!(command, Command::Position(_));
        let written = self.inner.write(command);
        if self.is_commanded && is_setpoint {
            let mut truth = self.truth.lock().unwrap();
            let ticks = truth.torque_nm.len();
            truth.commands.push((self.time_s, ticks));
        }
        written
    }

    fn stop(&mut self) {
        self.inner.stop();
    }
}

/// Results of a run, after `settle_s`.
struct Results {
    recording: Recording,
    /// Rms error of the tip along y and z, mm.
    yz_mm: f64,
    /// Rms motion of the tip along x about its mean, mm.
    moved_mm: f64,
    /// Rms force of the environment along x, N.
    force_n: f64,
    /// Mean force of the environment along z, and its standard deviation, N.
    force_z_n: (f64, f64),
    /// Rms torque error of the interval means of each joint, Nm, and rms desired torque of each joint, Nm.
    torque_nm: Vec<(f64, f64)>,
}

impl Results {
    /// Torque error of interval means, all joints.
    fn torque_error(&self) -> f64 {
        let sum = |part: fn(&(f64, f64)) -> f64| {
            self.torque_nm.iter().map(|joint| part(joint).powi(2)).sum::<f64>()
        };
        (sum(|joint| joint.0) / sum(|joint| joint.1)).sqrt()
    }
}

fn experiment(task: &str, options: RunOptions, settings: &[&str]) -> Experiment {
    let path = Path::new(TASKS).join(format!("{task}.toml"));
    // In simulated time a thread never waits: as a real-time thread it would keep the one that writes the log from its work.
    let settings = [settings, &["robot.driver.real_time=\"off\""]].concat();
    let settings: Vec<String> = settings.into_iter().map(str::to_owned).collect();
    Experiment::load(Files::Disk, &path, None, options, &settings).unwrap_or_else(|error| panic!("{error}"))
}

/// Bus with the arm of an experiment, and the configuration of its driver.
fn bus(
    experiment: &Experiment,
    truth: &Arc<Mutex<Truth>>,
    options: &[(&str, f64)],
) -> (SimulatedBus, ArmConfig) {
    let folder = tempfile::tempdir().unwrap();
    let calibration = folder.path().join("calibration.json").display().to_string();
    let settings: Settings = experiment.driver_settings().with("calibration", Setting::Text(calibration));
    let mut devices = experiment.simulated_devices().unwrap();
    let arm = experiment.motor_arm().unwrap();
    devices.arm = Box::new(Watched::new(arm, truth, false));
    for (key, value) in options {
        devices.options = devices.options.with(*key, Setting::Number(*value));
    }
    let bus = bus_with_arm(&settings, devices).unwrap_or_else(|error| panic!("{error}"));
    (bus, ArmConfig::from_settings(&settings).unwrap())
}

/// Runs an experiment over the bus.
fn over_bus(experiment: &Experiment, options: &[(&str, f64)]) -> Results {
    let truth = Arc::new(Mutex::new(Truth::default()));
    let (bus, config) = bus(experiment, &truth, options);
    let arm =
        FeetechArm::start(SimulatedTransport::new(bus), config).unwrap_or_else(|error| panic!("{error}"));
    let mut arm = Watched::new(arm, &truth, true);
    run(experiment, &mut arm, &truth)
}

/// Runs an experiment on the simulated robot without the bus.
fn directly(experiment: &Experiment) -> Results {
    let truth = Arc::new(Mutex::new(Truth::default()));
    let mut arm = Watched::new(experiment.simulated_arm().unwrap(), &truth, true);
    run(experiment, &mut arm, &truth)
}

fn run(experiment: &Experiment, arm: &mut dyn Backend, truth: &Arc<Mutex<Truth>>) -> Results {
    let done = experiment.run_on(arm, Vec::new(), &Progress::default());
    let done = done.unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(done.outcome, RunOutcome::Completed, "{:?}", done.record);
    let recording = Recording::from_bytes(&done.sink).unwrap();
    results(experiment, recording, &truth.lock().unwrap())
}

fn results(experiment: &Experiment, recording: Recording, truth: &Truth) -> Results {
    let settle_s = experiment.task().file.settle_s.get();
    let n = experiment.robot().model.n();
    let tick = recording.tick().unwrap();
    let (position, reference, desired) = (
        tick.signal("hand.position").or_else(|| tick.signal("tip.position")),
        tick.signal("hand.reference").or_else(|| tick.signal("tip.reference")),
        tick.signal("torque_desired").unwrap(),
    );
    let times = &tick.time_s;
    let settled: Vec<usize> =
        (0..times.len()).filter(|row| times[*row] - times[0] > settle_s + 0.5).collect();
    let count = settled.len() as f64;
    let (mut yz, mut x, mut x2) = (0.0, 0.0, 0.0);
    if let (Some(position), Some(reference)) = (position, reference) {
        for row in &settled {
            let (p, r) = (position.row(*row), reference.row(*row));
            yz += (p[1] - r[1]).powi(2) + (p[2] - r[2]).powi(2);
            x += p[0] / count;
            x2 += p[0] * p[0] / count;
        }
    }
    // The first command after the rest, and so the first tick of the environment.
    let mut torque_nm = vec![(0.0, 0.0); n];
    let (mut force2, mut z, mut z2, mut ticks) = (0.0, 0.0, 0.0, 0.0);
    for pair in truth.commands.windows(2) {
        let ((time_s, from), (_, to)) = (pair[0], pair[1]);
        let Some(row) = settled.iter().find(|row| (times[**row] - time_s).abs() < 1e-9) else { continue };
        for (joint, (error2, desired2)) in torque_nm.iter_mut().enumerate() {
            let mean =
                truth.torque_nm[from..to].iter().map(|row| row[joint]).sum::<f64>() / (to - from) as f64;
            let wanted = desired.row(*row)[joint];
            *error2 += (mean - wanted).powi(2) / count;
            *desired2 += wanted.powi(2) / count;
        }
        for force in truth.force_n.iter().take(to).skip(from) {
            force2 += force[0] * force[0];
            z += force[2];
            z2 += force[2] * force[2];
            ticks += 1.0;
        }
    }
    let torque_nm =
        torque_nm.into_iter().map(|(error2, desired2): (f64, f64)| (error2.sqrt(), desired2.sqrt()));
    let (force2, yz, z, z2, ticks): (f64, f64, f64, f64, f64) = (force2, yz, z, z2, f64::max(ticks, 1.0));
    Results {
        yz_mm: 1e3 * (yz / count).sqrt(),
        moved_mm: 1e3 * (x2 - x * x).max(0.0).sqrt(),
        force_n: (force2 / ticks).sqrt(),
        force_z_n: (z / ticks, (z2 / ticks - (z / ticks).powi(2)).max(0.0).sqrt()),
        torque_nm: torque_nm.collect(),
        recording,
    }
}

fn print(name: &str, results: &Results) {
    let joints: Vec<String> =
        results.torque_nm.iter().map(|(error, desired)| format!("{error:.4}/{desired:.3}")).collect();
    println!(
        "{name:32} y, z {:5.2} mm, x {:6.2} mm, force x {:6.3} N, z {:6.3?} N, torque error {:5.2} %; Nm: {}",
        results.yz_mm,
        results.moved_mm,
        results.force_n,
        results.force_z_n,
        1e2 * results.torque_error(),
        joints.join(" ")
    );
}

/// Compared: the compliant motion over the bus, with a latency of 1 ms and one answer in 500 lost, and without the bus, at
/// three rates: errors, force and torque error are at most 1.5 times as large, and motion not that much smaller.
#[test]
fn bus_keeps_the_compliance_of_the_direct_simulation() {
    for (hz, ticks) in [(50, 20), (100, 10), (200, 5)] {
        let rate = format!("robot.profile.bus-100hz.servo_ticks_per_cycle={ticks}");
        let experiment = experiment("compliant-x", RunOptions::default(), &[&rate]);
        let direct = directly(&experiment);
        let bus = over_bus(&experiment, &[("latency_ms", 1.0), ("lost_share", 0.002)]);
        print(&format!("{hz} Hz, direct"), &direct);
        print(&format!("{hz} Hz, bus"), &bus);
        for (name, of_bus, of_direct) in [
            ("error in y, z", bus.yz_mm, direct.yz_mm),
            ("force", bus.force_n, direct.force_n),
            ("motion", direct.moved_mm, bus.moved_mm),
            ("torque error", bus.torque_error(), direct.torque_error()),
        ] {
            assert!(of_bus < 1.5 * of_direct, "{hz} Hz: {name}: {of_bus} and {of_direct}");
        }
    }
}

/// Compared: torques from the log of a run over the bus, and those recomputed from its measurements.
#[test]
fn run_over_the_bus_replays() {
    let experiment = experiment("hold-and-yield", RunOptions::default(), &["duration_s=3.0"]);
    let run = over_bus(&experiment, &[("latency_ms", 1.0), ("lost_share", 0.01), ("damaged_share", 0.01)]);
    let report = replay(&experiment, &run.recording).unwrap();
    assert_eq!((report.differing, report.unmatched.len()), (0, 0), "{:?}", report.first_difference);
    assert!(report.compared > 250, "{}", report.compared);
}

/// Tasks of owners, each over the bus with every defect at once: USB latency, lost answers, a supply that sags, backlash, and friction
/// that grows with the load. By hand: 30 mm of a spring of 100 N/m are 3 N, if the gears have no backlash. Held by inverse kinematics the arm does not yield along x,
/// and sags along z.
#[test]
fn tasks_of_owners_run_over_the_bus() {
    let options = [("latency_ms", 1.0), ("lost_share", 0.005), ("supply_resistance_ohm", 0.2)];
    let joints = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"];
    let gear = "{ stiffness_nm_per_rad = 2000.0, damping_nms_per_rad = 1.0, backlash_rad = 0.00873 }";
    let gears: Vec<String> =
        joints.iter().map(|joint| format!("robot.simulated.gear.{joint}={gear}")).collect();
    let mut settings: Vec<&str> = gears.iter().map(String::as_str).collect();
    settings.push("robot.simulated.friction_per_load=0.1");
    for task in ["gravity-compensation", "compliant-x", "hold-and-yield", "leader", "press"] {
        let duration_s = if task == "press" { None } else { Some(4.0) };
        let run = RunOptions { duration_s, ..RunOptions::default() };
        let results = over_bus(&experiment(task, run, &settings), &options);
        print(task, &results);
    }
    let press = over_bus(&experiment("press", RunOptions::default(), &[]), &options);
    print("press, without backlash", &press);
    let (z, deviation) = press.force_z_n;
    assert!((z - 3.0).abs() < 0.3, "{z} {deviation}");
    let stiff = RunOptions { controller: ControllerKind::Ik, ..RunOptions::default() };
    let stiff = over_bus(&experiment("compliant-x", stiff, &[]), &[]);
    print("compliant-x, ik", &stiff);
    let soft = over_bus(&experiment("compliant-x", RunOptions::default(), &[]), &[]);
    assert!(stiff.moved_mm < 0.5 * soft.moved_mm, "{} {}", stiff.moved_mm, soft.moved_mm);
    assert!(soft.yz_mm < 0.5 * stiff.yz_mm, "{} {}", soft.yz_mm, stiff.yz_mm);
}

/// Compared: MuJoCo and the own plant behind the bus. Skipped aloud without MuJoCo.
#[test]
fn mujoco_is_behind_the_bus() {
    let own = experiment("compliant-x", RunOptions::default(), &["duration_s=5.0"]);
    let mujoco = match Mujoco::find(None) {
        Ok(mujoco) => own.clone().on_engine(Arc::new(mujoco)).unwrap_or_else(|error| panic!("{error}")),
        Err(error) => {
            println!("SKIPPED, a test with MuJoCo: {error}");
            return;
        }
    };
    let [own, mujoco] = [own, mujoco].map(|experiment| over_bus(&experiment, &[("latency_ms", 1.0)]));
    print("own plant", &own);
    print("MuJoCo", &mujoco);
    // Two integrators of the same bodies differ in the last digits.
    assert_ne!(own.force_n.to_bits(), mujoco.force_n.to_bits());
    assert!((own.moved_mm / mujoco.moved_mm - 1.0).abs() < 0.1);
    assert!((own.force_n / mujoco.force_n - 1.0).abs() < 0.1);
}

/// Arm on a bus that gets a defect after a second.
struct Breaking {
    arm: FeetechArm<SimulatedTransport>,
    defect: fn(&mut SimulatedBus),
    cycles: u32,
    /// Time of the defect on the clock of the bus.
    since: Option<Duration>,
}

impl Backend for Breaking {
    fn capabilities(&self) -> &Capabilities {
        self.arm.capabilities()
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        self.cycles += 1;
        if self.cycles == 120 {
            let bus = &mut self.arm.transport_mut().bus;
            self.since = Some(bus.now());
            (self.defect)(bus);
        }
        self.arm.read(sample)
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        self.arm.write(command)
    }

    fn stop(&mut self) {
        self.arm.stop();
    }
}

/// Defects in a whole run, one by one: each ends it with its name and code in the log, within the declared silence of 0.2 s and two
/// cycles or at once, with torque on in all servos; and what was logged replays.
#[test]
fn defects_end_a_run_by_their_names() {
    const SILENCE_S: f64 = 0.2;
    let experiment = experiment("hold-and-yield", RunOptions::default(), &["duration_s=3.0"]);
    type Defect = (BusFault, f64, fn(&mut SimulatedBus));
    let defects: [Defect; 11] = [
        (BusFault::PortGone, 0.0, |bus| bus.options.gone = true),
        (BusFault::Silent, SILENCE_S, |bus| bus.options.silent = true),
        (BusFault::ServoMissing, SILENCE_S, |bus| bus.options.silent_ids = vec![3]),
        (BusFault::WrongAnswer, SILENCE_S, |bus| bus.options.shortened = Some(4)),
        (BusFault::Checksum, SILENCE_S, |bus| bus.options.wrong_checksum = Some(2)),
        (BusFault::TooSlow, SILENCE_S, |bus| bus.options.latency = Duration::from_millis(12)),
        (BusFault::Overload, 0.0, |bus| flag(bus, ErrorFlags::OVERLOAD)),
        (BusFault::Overheat, 0.0, |bus| flag(bus, ErrorFlags::OVERHEAT)),
        (BusFault::Overcurrent, 0.0, |bus| flag(bus, ErrorFlags::OVERCURRENT)),
        (BusFault::Sensor, 0.0, |bus| flag(bus, ErrorFlags::SENSOR)),
        (BusFault::Voltage, 0.0, |bus| flag(bus, ErrorFlags::VOLTAGE)),
    ];
    for (expected, after_s, defect) in defects {
        let truth = Arc::new(Mutex::new(Truth::default()));
        let (bus, config) = bus(&experiment, &truth, &[("latency_ms", 1.0)]);
        let arm = FeetechArm::start(SimulatedTransport::new(bus), config).unwrap();
        let mut arm = Breaking { arm, defect, cycles: 0, since: None };
        let done = experiment.run_on(&mut arm, Vec::new(), &Progress::default()).unwrap();
        let reported =
            done.record.device_fault.as_ref().unwrap_or_else(|| panic!("{expected:?}: {:?}", done.record));
        assert_eq!(reported.code, expected.code(), "{expected:?}: {reported:?}");
        let bus = &arm.arm.transport_mut().bus;
        let lasted_s = (bus.now() - arm.since.unwrap()).as_secs_f64();
        assert!(lasted_s <= after_s + 0.03, "{expected:?}: {lasted_s} s");
        assert!(bus.servos().iter().all(|servo| servo.is_torque_on()), "{expected:?}");
        let recording = Recording::from_bytes(&done.sink).unwrap();
        let report = replay(&experiment, &recording).unwrap();
        assert_eq!((report.differing, report.unmatched.len()), (0, 0), "{expected:?}");
        println!("{}: {lasted_s:.3} s, {reported}", expected.name());
    }
}

fn flag(bus: &mut SimulatedBus, flags: ErrorFlags) {
    if let Some(servo) = bus.servo_mut(3) {
        servo.flags = flags;
    }
}

/// Compared: the stiffness that is identified over the bus from the weight of the arm, and that of the simulated servo at P = 16,
/// 8.9 Nm/rad; and its friction, 0.052 Nm.
#[test]
fn servo_is_identified_over_the_bus() {
    let experiment = experiment("press", RunOptions::default(), &["environment={}"]);
    let truth = Arc::new(Mutex::new(Truth::default()));
    let (bus, config) = bus(&experiment, &truth, &[("latency_ms", 1.0)]);
    let mut arm = FeetechArm::start(SimulatedTransport::new(bus), config).unwrap();
    let names = experiment.robot().model.joints().iter().map(|joint| joint.name.clone());
    let start_rad = names.zip(experiment.start().unwrap()).collect();
    let joint = Some("shoulder_lift".to_owned());
    let request = Request { joint, start_rad, ..Request::default() };
    let job =
        IdentificationJob::new(experiment.robot().clone(), request).unwrap_or_else(|error| panic!("{error}"));
    let planned_s = job.planned_s();
    let results = job.run(&mut arm, &Progress::default(), |_| {}).unwrap();
    println!("{planned_s:.0} s planned, {:.0} s of robot time", results.robot_s);
    assert!((planned_s / results.robot_s - 1.0).abs() < 0.2, "{planned_s} {}", results.robot_s);
    let found = &results.joints[0].found;
    assert!(found.refused.is_none(), "{:?}", found.refused);
    let servo = found.static_servo.as_ref().unwrap();
    println!("{:.3} Nm/rad, {:?}; {:.4} Nm", servo.stiffness, servo.stiffness_interval, servo.coulomb);
    assert!((servo.stiffness / 8.9 - 1.0).abs() < 0.02, "{}", servo.stiffness);
    let interval = servo.stiffness_interval;
    assert!((interval.lower..interval.upper).contains(&8.9), "{interval:?}");
    assert!((servo.coulomb / 0.052 - 1.0).abs() < 0.1, "{}", servo.coulomb);
}

/// Compared: what a simulated run of a real robot says that a person would feel, and separate runs of the same robot, of a torque robot,
/// and without friction compensation. Not said of a robot without a driver.
#[test]
fn simulated_run_says_what_a_person_would_feel() {
    let folder = scratch();
    let task = project("examples/so101/gravity-compensation.toml");
    let run = |name: &str, options: &[&str]| {
        let arguments = [&["run", &task, "--simulate", "--duration-s", "4", "--out", name], options].concat();
        let ran = opspace(folder.path(), &arguments).exits(0);
        let summary = read_json(folder.path().join(name).join("summary.json"));
        (ran.stderr, summary["metrics"]["hand_force_rms_n"].as_f64().unwrap())
    };
    let (said, force_n) = run("position", &[]);
    let said_n = |begin: &str| {
        let line = said
            .lines()
            .find(|line| line.trim().starts_with(begin))
            .unwrap_or_else(|| panic!("{begin}: {said}"));
        let number = line.split(" rms with ").nth(1).and_then(|rest| rest.split(" N").next());
        number.unwrap_or_else(|| panic!("{line}")).parse::<f64>().unwrap()
    };
    let (_, torque_n) = run("torque", &["--backend", "torque"]);
    let (_, friction_n) = run("friction", &["--set", "friction_compensation.gain=0.0"]);
    for (begin, expected_n) in
        [("by hand:", force_n), ("torque robot:", torque_n), ("without friction compensation:", friction_n)]
    {
        let of_note = said_n(begin);
        assert!((of_note / expected_n - 1.0).abs() < 0.01, "{begin} {of_note} and {expected_n}");
    }
    assert!(friction_n > 1.2 * force_n, "{friction_n} {force_n}");
    let arguments = ["run", &project("tasks/compliant-x.toml"), "--duration-s", "2", "--out", "other"];
    assert!(!opspace(folder.path(), &arguments).exits(0).stderr.contains("by hand:"));
}

/// Connection to a simulated bus that is opened several times.
struct Reopened(Rc<RefCell<SimulatedTransport>>);

impl Transport for Reopened {
    fn now(&self) -> Duration {
        self.0.borrow().now()
    }

    fn wait_until(&mut self, time: Duration) {
        self.0.borrow_mut().wait_until(time);
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.0.borrow_mut().send(bytes)
    }

    fn receive(&mut self, buffer: &mut [u8], deadline: Duration) -> io::Result<usize> {
        self.0.borrow_mut().receive(buffer, deadline)
    }
}

/// Driver of the bus in simulated time, in place of the one of the program.
struct InSimulatedTime(Rc<RefCell<SimulatedTransport>>);

impl Driver for InSimulatedTime {
    fn name(&self) -> &str {
        "feetech"
    }

    fn with(&self, settings: &Settings, run: &mut dyn FnMut(&mut dyn Backend)) -> Result<(), DriverError> {
        with_transport(Reopened(Rc::clone(&self.0)), ArmConfig::from_settings(settings)?, run)
    }
}

/// Moves the arm of one task to the start of another one, 0.3 rad away; returns the outcome and the bus.
fn moved(
    from: &str,
    settings: &[&str],
) -> (Result<Option<Summary>, RunError>, Rc<RefCell<SimulatedTransport>>) {
    let folder = tempfile::tempdir().unwrap();
    let calibration =
        format!("robot.driver.calibration={:?}", folder.path().join("so101.json").display().to_string());
    let settings = [settings, &[&calibration, "start_rad.shoulder_pan=0.3"]].concat();
    let task = experiment("hold-and-yield", RunOptions::default(), &settings);
    let devices = experiment(from, RunOptions::default(), &[]).simulated_devices().unwrap();
    let bus = bus_with_arm(&task.driver_settings(), devices).unwrap_or_else(|error| panic!("{error}"));
    let bus = Rc::new(RefCell::new(SimulatedTransport::new(bus)));
    let extensions = Extensions::default().with_driver(InSimulatedTime(Rc::clone(&bus)));
    let results = folder.path().join("moved");
    (move_to_start(&task, &extensions, &results, &Progress::default(), (&|_| {}, &|_| {})), bus)
}

/// An arm that is lowered after runs is held between the motion to the start and the task.
#[test]
fn arm_is_held_between_motion_and_task() {
    let (moved, bus) = moved("press", &["robot.driver.at_end=\"lower\""]);
    assert_eq!(moved.unwrap().unwrap().faulted, None);
    let bus = &bus.borrow().bus;
    assert!(bus.servos().iter().all(|servo| servo.is_torque_on()));
    assert!((bus.joints().q()[0] - 0.3).abs() < 0.02, "{:?}", bus.joints().q());
    assert!(bus.joints().q()[1].abs() < 0.4, "{:?}", bus.joints().q());
}

/// A person who pulls the arm away from the start is named as a possible cause, not the option that was given.
#[test]
fn start_that_is_not_reached_is_said() {
    let (moved, _) = moved("compliant-x", &[]);
    let words = moved.map(|_| ()).unwrap_err().to_string();
    assert!(
        words.contains("joint 'shoulder_pan'") && words.contains("something holds or pulls it"),
        "{words}"
    );
    assert!(!words.contains("--move-to-start"), "{words}");
}

/// Compared: the verdict of tasks with pushes, and the summaries of its run and of a torque robot. Motion and force are those of the same
/// axis, for each axis that is pushed. Of a table on which the arm presses, no person feels anything.
#[test]
fn verdict_of_pushes_has_motion_and_force_of_each_axis() {
    // Three digits are printed.
    const PRINTED: f64 = 0.01;
    let folder = scratch();
    let run = |task: &str, options: &[&str]| {
        let file = project(&format!("examples/so101/{task}.toml"));
        let arguments = [&["run", &file, "--simulate", "--out", "out", "--force"], options].concat();
        let ran = opspace(folder.path(), &arguments).exits(0);
        (ran.stderr, read_json(folder.path().join("out/summary.json"))["frames"]["tip"].clone())
    };
    let (said, of_position) = run("leader", &[]);
    let (_, of_torque) = run("leader", &["--backend", "torque"]);
    for (begin, expected) in [("by hand:", of_position), ("torque robot:", of_torque)] {
        let line =
            said.lines().find(|line| line.trim().starts_with(begin)).unwrap_or_else(|| panic!("{said}"));
        for axis in ["x", "y", "z"] {
            let (moved, force) = line.split_once(&format!(" mm along {axis} (pushed by up to ")).unwrap();
            let moved_mm: f64 = moved.rsplit(' ').next().unwrap().parse().unwrap();
            let force_n: f64 = force.split(' ').next().unwrap().parse().unwrap();
            let of_summary = |key: &str| expected[format!("{axis}_{key}")].as_f64().unwrap();
            assert!(
                (moved_mm / of_summary("deflection_max_m") / 1e3 - 1.0).abs() < PRINTED,
                "{line} {expected}"
            );
            assert!((force_n / of_summary("force_max_n") - 1.0).abs() < PRINTED, "{line} {expected}");
        }
    }
    let (said, _) = run("hold-and-yield", &[]);
    let lines: Vec<&str> = said.lines().filter(|line| line.contains(": tip yields by up to ")).collect();
    let has_all =
        |line: &&str| ["x", "y", "z"].iter().all(|axis| line.contains(&format!(" along {axis} (pushed")));
    assert!(lines.len() == 3 && lines.iter().all(has_all), "{said}");
    assert!(!run("press", &[]).0.contains("by hand:"));
}

//! Allocations in a control cycle: there must be none in any experiment of any suite, on any robot and controller,
//! with tasks defined by the user and with streamed targets; during the run, at a stop after a fault of the loop or
//! of the device, and at an interruption.
//!
//! Compared: the counts of the allocator after two successive cycles. It counts only this thread, on which the whole
//! loop runs, including plant, drives and sensors of the simulated robot.

use crate::common::{self, ik, load, osc, positions, torque, torques};
use nalgebra::{Matrix6xX, Vector6};
use opspace_backend::quantity::NonNegative;
use opspace_backend::{Backend, Capabilities, Command, CommandKind, DeviceFault, Sample, Sink, TICK};
use opspace_control::{CartesianTarget, Controller, Coordinate, CoordinateGains, CoordinateTask};
use opspace_experiment::files::task::NamedRecording;
use opspace_experiment::{
    ControllerKind, Experiment, Extensions, FileError, Files, Progress, RunOptions, Scenario, Source,
    TaskDefinition, TaskKind, TransformerEntry,
};
use opspace_loop::{Fault, Phase, Run, RunOutcome, TargetSender, drive, target_stream};
use opspace_model::{Data, Model};
use opspace_sim::SimulatedArm;
use opspace_suite::Suite;
use opspace_testing::allocation::{allocations, allocations_so_far, most_held};
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

/// Phase of each cycle, with the allocation count at its end.
type Counts = Vec<(f64, usize)>;

/// Sink that counts allocations and interrupts the run after some cycles.
struct Counter<'a> {
    counts: Counts,
    interrupt_after: Option<usize>,
    interrupt: &'a AtomicBool,
}

impl Sink for Counter<'_> {
    fn row(&mut self, channel: usize, _time_s: f64, row: &[f64]) {
        if channel == TICK {
            assert!(self.counts.len() < self.counts.capacity(), "the sink itself must not allocate");
            self.counts.push((row[PHASE], allocations_so_far()));
            if self.interrupt_after == Some(self.counts.len()) {
                self.interrupt.store(true, Ordering::Relaxed);
            }
        }
    }
}

/// Index of the signal `phase` in a tick row.
const PHASE: usize = 2;

fn count(
    experiment: &Experiment,
    controller: Box<dyn Controller>,
    interrupt_after: Option<usize>,
) -> (Counts, RunOutcome) {
    let mut arm = experiment.simulated_arm().unwrap_or_else(|e| panic!("{e}"));
    count_on(&mut arm, experiment, controller, interrupt_after, |_| ())
}

/// Runs a controller on `robot` and counts the allocations; `prepare` is called with the run before its first cycle.
fn count_on(
    robot: &mut dyn Backend,
    experiment: &Experiment,
    controller: Box<dyn Controller>,
    interrupt_after: Option<usize>,
    prepare: impl FnOnce(&mut Run<'_>),
) -> (Counts, RunOutcome) {
    let interrupt = AtomicBool::new(false);
    let mut sink = Counter { counts: Vec::with_capacity(1 << 16), interrupt_after, interrupt: &interrupt };
    let control = common::control_loop(experiment, controller);
    let mut run = Run::new(control, experiment.duration_s(), &mut sink).with_stop_request(&interrupt);
    prepare(&mut run);
    drive(robot, &mut run);
    let outcome = run.finish();
    (sink.counts, outcome)
}

/// Builds the controller of the experiment.
fn experiment_controller(experiment: &Experiment) -> Box<dyn Controller> {
    experiment.controller().unwrap_or_else(|e| panic!("{e}"))
}

/// Checks every cycle except the first: only the start of the controller may allocate.
fn check(counts: &Counts, name: &str) {
    const CONTROL: f64 = 1.0;
    assert!(counts.iter().filter(|(phase, _)| *phase == CONTROL).count() > 50, "{name}");
    for (k, pair) in counts.windows(2).enumerate() {
        let ((before, count), (phase, next)) = (pair[0], pair[1]);
        let starts = phase == CONTROL && before != CONTROL;
        assert!(starts || next == count, "{name}: {} allocations in tick {}", next - count, k + 1);
    }
}

/// Shortens an experiment to `duration_s`, without settling time.
fn short(experiment: &Experiment, duration_s: f64) -> Experiment {
    let mut task = experiment.task().clone();
    task.file.settle_s = NonNegative::default();
    let options = RunOptions { duration_s: Some(duration_s), ..experiment.options().clone() };
    common::experiment(experiment.robot().clone(), task, options)
}

#[test]
fn allocation_counter_counts() {
    assert_eq!(allocations(|| drop(std::hint::black_box(vec![0_u8; 16]))), 1);
}

/// Runs each experiment of a suite with one seed until after its last event. Returns the number of experiments.
fn no_cycle_allocates_in(suite: &str) -> usize {
    /// Duration longer than the torque ramp, s, and a number of cycles larger than the length of any delay line.
    const SHORT_S: f64 = 0.3;
    const CYCLES: f64 = 80.0;
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/suites").join(suite).with_extension("toml");
    let extensions = Extensions::default().with_comparisons();
    let suite = Suite::load_with(&extensions, Files::Disk, &path).unwrap_or_else(|e| panic!("{e}"));
    let mut seen = BTreeSet::new();
    for experiment in suite.of_robots() {
        let options = RunOptions { seed: None, ..experiment.options().clone() };
        let name = format!("{} {options:?} {:?}", experiment.task().name(), experiment.settings());
        if !seen.insert(name.clone()) {
            continue;
        }
        let last_event_s = experiment.task().events.last().map_or(0.0, |event| event.time_s);
        let counted_s = SHORT_S.max(CYCLES * experiment.profile().1.period_s());
        let experiment = short(experiment, last_event_s + counted_s);
        let (counts, _) = count(&experiment, experiment_controller(&experiment), None);
        check(&counts, &name);
    }
    seen.len()
}

#[test]
fn no_cycle_of_paper_suite_allocates() {
    assert!(no_cycle_allocates_in("paper") >= 25);
}

#[test]
fn no_cycle_of_features_suite_allocates() {
    assert!(no_cycle_allocates_in("features") >= 10);
}

#[test]
fn no_cycle_of_limits_suite_allocates() {
    assert!(no_cycle_allocates_in("limits") >= 5);
}

#[test]
fn no_cycle_of_singularity_suite_allocates() {
    assert!(no_cycle_allocates_in("singularity") >= 5);
}

#[test]
fn no_cycle_of_stiffness_suite_allocates() {
    assert!(no_cycle_allocates_in("stiffness") >= 10);
}

#[test]
fn no_cycle_of_transformer_suite_allocates() {
    assert!(no_cycle_allocates_in("transformer") >= 50);
}

#[test]
fn no_cycle_of_robustness_suite_allocates() {
    assert!(no_cycle_allocates_in("robustness") >= 50);
}

#[test]
fn no_cycle_of_force_suite_allocates() {
    assert!(no_cycle_allocates_in("force") >= 25);
}

#[test]
fn no_cycle_of_servos_suite_allocates() {
    assert!(no_cycle_allocates_in("servos") >= 50);
}

/// Coordinate of the user: the sum of two joint positions, rad.
struct Sum;

impl Coordinate for Sum {
    fn rows(&self) -> usize {
        1
    }

    fn value(&self, _model: &Model, data: &Data) -> Vector6<f64> {
        Vector6::x() * (data.q[0] + data.q[3])
    }

    fn jacobian(&self, _model: &Model, _data: &Data, rows: &mut Matrix6xX<f64>) {
        rows.fill(0.0);
        rows[(0, 0)] = 1.0;
        rows[(0, 3)] = 1.0;
    }

    fn bias(&self, _model: &Model, _data: &Data) -> Vector6<f64> {
        Vector6::zeros()
    }

    fn element(&self, _row: usize) -> (&'static str, &'static str) {
        ("sum", "rad")
    }
}

/// A task of the user above a hand task whose targets come from another thread, with pauses in which they become
/// stale, on all three kinds of robot; the device fails when it is read, or when it is written.
#[test]
fn no_cycle_with_user_task_and_streamed_targets_allocates() {
    const TASK: &str = r#"
        robot = "asimo-arm"
        duration_s = 1.5
        priority = ["sum", "hand", "rest"]
        start_rad = { shoulder_pitch = -0.45, shoulder_roll = -0.35, shoulder_yaw = 0.25, elbow = -1.35 }
        [task.sum.sum]
        gains = { frequency_rad_per_s = 10.0, damping_ratio = 1.0 }
        [task.hand.cartesian]
        frame = "hand"
        axes = { y = "motion", z = "motion" }
        reference.streamed = { timeout_s = 0.02 }
        gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }
        [task.rest.joint-damping]
        damping_nms_per_rad = 1.0
    "#;
    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct SumParameters {
        gains: CoordinateGains,
    }
    let built = |p: &SumParameters, name: &str, _: &Model, _: &_| {
        Ok(Box::new(CoordinateTask::new(name, Sum, p.gains)) as Box<_>)
    };
    let extensions = Extensions::default().with(TaskKind::new("sum", built));
    let named = |_: NamedRecording<'_>| -> Result<Source, FileError> { unreachable!("no path is recorded") };
    for backend in CommandKind::ALL {
        for (reads, writes) in [(usize::MAX, usize::MAX), (900, usize::MAX), (usize::MAX, 900)] {
            let source = Source::new("streamed.toml", TASK);
            let task = TaskDefinition::from_sources_with(&extensions, source, named)
                .unwrap_or_else(|e| panic!("{e}"));
            let options = RunOptions { backend, ..RunOptions::default() };
            let experiment = common::experiment(common::robot(&[]), task, options);
            let arm = experiment.simulated_arm().unwrap_or_else(|e| panic!("{e}"));
            let mut robot = Failing { arm, reads, writes };
            let mut sending = None;
            let controller = experiment_controller(&experiment);
            let (counts, ending) = count_on(&mut robot, &experiment, controller, None, |run| {
                let (sender, receiver) = target_stream(run.targets());
                run.set_target_stream(receiver);
                sending = Some(thread::spawn(move || stream(sender)));
            });
            let sent = sending.and_then(|thread| thread.join().ok()).unwrap_or_default();
            let name = format!("{backend:?}, {reads} reads, {writes} writes, {sent} targets");
            let device = matches!(ending, RunOutcome::Faulted { fault: Fault::Device(_), .. });
            assert_eq!(device, reads.min(writes) < usize::MAX, "{name}: {ending:?}");
            assert!(sent > 10, "{name}");
            check(&counts, &name);
        }
    }
}

/// Streams targets until the run has ended, with a pause after every fifth target.
fn stream(mut sender: TargetSender) -> usize {
    let mut hand = CartesianTarget::of(sender.targets(), "hand").expect("the hand is streamed");
    let mut sent = 0;
    while !sender.is_closed() {
        hand.twist([0.0, 0.05, 0.02, 0.0, 0.0, 0.0]).expect("finite");
        sent += usize::from(sender.send(hand.task(), &hand.inputs()).expect("good values"));
        thread::sleep(Duration::from_micros(if sent % 5 == 0 { 2000 } else { 50 }));
    }
    sent
}

/// Simulated arm that fails after a number of reads or writes.
struct Failing {
    arm: SimulatedArm,
    reads: usize,
    writes: usize,
}

/// Decrements a counter; returns a fault if it is zero.
fn take_one(left: &mut usize) -> Result<(), DeviceFault> {
    *left = left.checked_sub(1).ok_or(DeviceFault::new(17, "the cable was pulled"))?;
    Ok(())
}

impl Backend for Failing {
    fn capabilities(&self) -> &Capabilities {
        self.arm.capabilities()
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        take_one(&mut self.reads).and_then(|()| self.arm.read(sample))
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        take_one(&mut self.writes).and_then(|()| self.arm.write(command))
    }

    fn stop(&mut self) {
        self.arm.stop();
    }
}

/// Stops and interruptions: the stop cycle and the following cycles do not allocate either.
#[test]
fn no_cycle_of_faulting_or_interrupted_run_allocates() {
    for options in [osc("a-med"), torque("a-med")] {
        let experiment = short(&load("compliant-x", options, &[]), 1.0);
        let nan = Box::new(torques(|data, measurement, tau| {
            let broken = if measurement.time_s > 0.3 { f64::NAN } else { 0.0 };
            tau.iter_mut().zip(&data.gravity).for_each(|(tau, g)| *tau = g + broken);
        }));
        let (counts, ending) = count(&experiment, nan, None);
        assert!(matches!(ending, RunOutcome::Faulted { .. }), "{ending:?}");
        check(&counts, "a fault");
        assert!(counts.last().is_some_and(|(phase, _)| *phase == 2.0), "the stop was seen");

        let controller = experiment_controller(&experiment);
        let (counts, ending) = count(&experiment, controller, Some(500));
        assert!(matches!(ending, RunOutcome::Interrupted { .. }), "{ending:?}");
        check(&counts, "an interrupt");
        assert!(counts.len() > 500, "the stop was seen");
    }
    let experiment = short(&load("compliant-x", osc("a-med"), &[]), 1.0);
    let jump = Box::new(positions(|_, measurement, q| {
        let far = if measurement.time_s > 0.3 { 1.0 } else { 0.0 };
        q.iter_mut().zip(&measurement.q).for_each(|(q, measured)| *q = measured + far);
    }));
    let (counts, ending) = count(&experiment, jump, None);
    assert!(matches!(ending, RunOutcome::Faulted { .. }), "{ending:?}");
    check(&counts, "a jump");
}

/// Tolerated missed cycles, a dropout after which the run resumes, and a dropout that is too long.
#[test]
fn no_cycle_of_run_with_missed_cycles_allocates() {
    let dropouts =
        "robot.simulated.bus.dropouts=[{ at_s = 0.2, duration_s = 0.1 }, { at_s = 1.0, duration_s = 1.5 }]";
    let settings = [dropouts, "robot.simulated.bus.lost_cycles_share=0.05"];
    for (task, options) in [
        ("compliant-x", osc("a-med")),
        ("compliant-x", torque("a-med")),
        ("joint-tracking", osc("b-soft")),
        ("cartesian-tracking", ik("b-soft", ControllerKind::IkLead)),
    ] {
        let experiment = short(&load(task, options, &settings), 3.0);
        let controller = experiment_controller(&experiment);
        let (counts, ending) = count(&experiment, controller, None);
        assert!(matches!(ending, RunOutcome::Faulted { fault: Fault::Dropout { .. }, .. }), "{ending:?}");
        let phase = |phase: Phase| counts.iter().filter(|(p, _)| *p == phase.code()).count();
        assert!(phase(Phase::Held) > 9 && phase(Phase::Resuming) > 30, "{task}: it was held, and resumed");
        // After the ramp, the run is in control again without a new start, and only a start may allocate.
        let start = counts.iter().position(|(p, _)| *p == Phase::Control.code()).expect("control");
        let after = &counts[start..];
        let allocated = after.last().map_or(0, |last| last.1) - after[0].1;
        assert_eq!(allocated, 0, "{task}");
    }
}

/// All transformers of the program.
#[test]
fn no_cycle_of_any_transformer_allocates() {
    let closed_loop = "closed_loop={numerator=[1.0],denominator=[1.0,0.02,6.6e-5]}";
    let joint = format!(
        "{{{closed_loop},open_loop={{numerator=[1.0],denominator=[0.0,2.0,0.3]}},from_hz=0.5,to_hz=50.0}}"
    );
    let joints =
        ["shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow"].map(|name| format!("{name}={joint}"));
    let identified = format!("robot.profile.a-med.identified={{{}}}", joints.join(","));
    for entry in Extensions::default().all::<TransformerEntry>() {
        let transformer = entry.transformer_name();
        let options = RunOptions { transformer: Some(transformer.clone()), ..RunOptions::default() };
        let path = Path::new("tasks/compliant-x.toml");
        let mut settings = vec![identified.clone()];
        if transformer.method() == "interpolating" {
            settings.push("robot.interface.setpoints=\"interpolated\"".to_owned());
        }
        if transformer.as_str() == "emulation+current" {
            settings.push("robot.profile.a-med.adapt_gains={time_s=1.0,max_relative_change=0.3}".to_owned());
        }
        let experiment = Experiment::load(Files::Embedded, path, None, options, &settings);
        let experiment = short(&experiment.unwrap_or_else(|e| panic!("{e}")), 0.5);
        let controller = experiment_controller(&experiment);
        let (counts, ending) = count(&experiment, controller, None);
        assert_eq!(ending, RunOutcome::Completed, "{transformer:?}");
        check(&counts, transformer.as_str());
    }
}

/// Memory of a loop with each limit and a distance to keep: 1000 loops that a program steps together take 0.6 GB.
#[test]
fn control_loop_holds_at_most_600_kb() {
    let task = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/panda-goals.toml");
    let options = RunOptions::default();
    let experiment = Experiment::load(Files::Disk, &task, None, options, &[]).expect("a task of the project");
    let build = || experiment.control_loop().expect("a loop");
    drop(build());
    let (_loops, most_bytes) = most_held(|| [0; 4].map(|_| build()));
    assert!(most_bytes < 4 * 600_000, "{most_bytes}");
}

/// Sink of one of several robots: it writes to the counts of all, in the order of their cycles.
struct OneOfSeveral<'a> {
    robot: usize,
    counts: &'a Mutex<Vec<(usize, f64, usize)>>,
}

impl Sink for OneOfSeveral<'_> {
    fn row(&mut self, channel: usize, _time_s: f64, row: &[f64]) {
        if channel == TICK {
            let mut counts = self.counts.lock().expect("no panic before");
            assert!(counts.len() < counts.capacity(), "the sink itself must not allocate");
            counts.push((self.robot, row[PHASE], allocations_so_far()));
        }
    }
}

/// Two robots with links that have delay, jitter, loss and reordering, with a clutch that opens and closes, and with holds and
/// resumes after dropouts of either; with every quantity that can be reflected. Only the start of each controller allocates.
#[test]
fn no_cycle_of_coupled_robots_allocates() {
    let harsh = "channels.net={ delay_s = 0.01, jitter_s = 0.01, loss = 0.1, reordering = true }";
    let constant = "channels.net={ delay_s = 0.01 }";
    let dropout = |robot: &str, at_s: f64| {
        format!("{robot}.robot.simulated.bus.dropouts=[{{ at_s = {at_s}, duration_s = 0.1 }}]")
    };
    for (reflect, channel) in [
        ("\"measured-force\"", harsh),
        ("\"position\"", harsh),
        ("\"controller-force\"", harsh),
        ("{ waves = { impedance_ns_per_m = 100.0 } }", constant),
    ] {
        let settings = [
            "expect={}".to_owned(),
            "settle_s=0.1".to_owned(),
            "duration_s=1.8".to_owned(),
            "follower.environment.table.point_m=[0.36, 0.0, -0.16]".to_owned(),
            channel.to_owned(),
            "couplings.hands.channel=\"net\"".to_owned(),
            format!("couplings.hands.teleoperation.reflect={reflect}"),
            "couplings.hands.teleoperation.clutch_open_s=[[0.4, 0.5]]".to_owned(),
            dropout("follower", 0.6),
            dropout("leader", 1.1),
        ];
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/experiments/teleop-wall.toml");
        let experiment = Scenario::load_robots(&Extensions::default(), Files::Disk, &path, &settings, &[]);
        let experiment = experiment.unwrap_or_else(|e| panic!("{e}"));
        let counts = Mutex::new(Vec::with_capacity(1 << 16));
        let driven = experiment.drive(&Progress::default(), |robot, _, _| {
            let control = experiment.members[robot].experiment.control_loop()?;
            Ok((control, OneOfSeveral { robot, counts: &counts }))
        });
        let driven = driven.unwrap_or_else(|e| panic!("{e}"));
        assert!(driven.iter().all(|(_, outcome)| *outcome == RunOutcome::Completed), "{reflect}");
        drop(driven);
        let counts = counts.into_inner().expect("no panic before");
        let mut before = [f64::NAN; 2];
        let mut starts = 0;
        for (k, pair) in counts.windows(2).enumerate() {
            let ((robot, phase, count), (next, next_phase, next_count)) = (pair[0], pair[1]);
            before[robot] = phase;
            // The start of a controller; afterwards no phase before control comes again.
            let is_start = next_phase == Phase::Control.code() && before[next] == Phase::Rest.code();
            starts += usize::from(is_start);
            let more = next_count - count;
            assert!(is_start || more == 0, "{reflect}: {more} allocations in cycle {}", k + 1);
        }
        assert_eq!(starts, 2, "{reflect}");
        for robot in 0..2 {
            let of_phase = |wanted: Phase| {
                counts.iter().filter(|(of, phase, _)| *of == robot && *phase == wanted.code()).count()
            };
            assert!(
                of_phase(Phase::Held) > 40 && of_phase(Phase::Resuming) > 150,
                "{reflect}, robot {robot}"
            );
        }
    }
}

//! No tick allocates: every experiment of the paper's suite on every robot and controller, while it runs, when
//! it is stopped by a fault and when it is interrupted.
//!
//! Compared: the allocator's own count at two successive ticks. It counts this thread only, and the whole
//! loop runs on it: plant, drives and sensors of the simulated robot included.

mod common;
#[path = "../crates/opspace-log/tests/counting/mod.rs"]
mod counting;

use common::{ik, load, osc, positions, torque, torques};
use counting::{allocations, allocations_so_far};
use opspace_backend::quantity::NonNegative;
use opspace_backend::{Sink, TICK};
use opspace_control::Controller;
use opspace_experiment::files::origin::PAPER_SUITE;
use opspace_experiment::{Choice, ControllerKind, Experiment, Files, Suite};
use opspace_loop::{Fault, Phase, Run, RunOutcome, drive};
use opspace_transformer::{Method, TransformerKind};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// The phase of each tick, with the allocator's count at its end.
type Counts = Vec<(f64, usize)>;

/// Counts, and interrupts after some ticks.
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

/// Place of the signal `phase` in a row of the loop.
const PHASE: usize = 3;

fn count(
    experiment: &Experiment,
    controller: Box<dyn Controller>,
    interrupt_after: Option<usize>,
) -> (Counts, RunOutcome) {
    let interrupt = AtomicBool::new(false);
    let mut sink = Counter { counts: Vec::with_capacity(1 << 16), interrupt_after, interrupt: &interrupt };
    let mut arm = experiment.simulated_arm().unwrap_or_else(|e| panic!("{e}"));
    let control = common::control_loop(experiment, controller);
    let mut run = Run::new(control, experiment.duration_s(), &mut sink).with_stop_request(&interrupt);
    drive(&mut arm, &mut run);
    let outcome = run.finish();
    (sink.counts, outcome)
}

/// Checks every tick but the first: only the controller's start may allocate.
fn check(counts: &Counts, name: &str) {
    const CONTROL: f64 = 1.0;
    assert!(counts.iter().filter(|(phase, _)| *phase == CONTROL).count() > 50, "{name}");
    for (k, pair) in counts.windows(2).enumerate() {
        let ((before, count), (phase, next)) = (pair[0], pair[1]);
        let starts = phase == CONTROL && before != CONTROL;
        assert!(starts || next == count, "{name}: {} allocations in tick {}", next - count, k + 1);
    }
}

/// A run of half a second: longer than the torque's ramp and several periods of all filters.
fn short(experiment: &Experiment, duration_s: f64) -> Experiment {
    let mut task = experiment.task().clone();
    task.file.settle_s = NonNegative::default();
    let choice = Choice { duration_s: Some(duration_s), ..experiment.choice().clone() };
    common::experiment(experiment.robot().clone(), task, choice)
}

#[test]
fn the_counter_counts() {
    assert_eq!(allocations(|| drop(std::hint::black_box(vec![0_u8; 16]))), 1);
}

#[test]
fn no_tick_of_the_paper_suite_allocates() {
    let suite = Suite::load(Files::Embedded, Path::new(PAPER_SUITE)).unwrap_or_else(|e| panic!("{e}"));
    let mut seen = Vec::new();
    for experiment in &suite.experiments {
        let choice = Choice { seed: None, ..experiment.choice().clone() };
        let name = format!("{} {choice:?} {:?}", experiment.task().name(), experiment.settings());
        if seen.contains(&name) {
            continue;
        }
        let experiment = short(experiment, 0.5);
        let controller = experiment.controller().unwrap_or_else(|e| panic!("{e}"));
        let (counts, ending) = count(&experiment, controller, None);
        assert_eq!(ending, RunOutcome::Completed, "{name}");
        check(&counts, &name);
        seen.push(name);
    }
    assert!(seen.len() >= 25, "only {}", seen.len());
}

/// The stop and what follows it are ticks as well.
#[test]
fn no_tick_of_a_faulting_or_interrupted_run_allocates() {
    for choice in [osc("a-med"), torque("a-med")] {
        let experiment = short(&load("compliant-x", choice, &[]), 1.0);
        let nan = Box::new(torques(|data, measurement, tau| {
            let broken = if measurement.time_s > 0.3 { f64::NAN } else { 0.0 };
            tau.iter_mut().zip(&data.gravity).for_each(|(tau, g)| *tau = g + broken);
        }));
        let (counts, ending) = count(&experiment, nan, None);
        assert!(matches!(ending, RunOutcome::Faulted { .. }), "{ending:?}");
        check(&counts, "a fault");
        assert!(counts.last().is_some_and(|(phase, _)| *phase == 2.0), "the stop was seen");

        let controller = experiment.controller().unwrap_or_else(|e| panic!("{e}"));
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

/// Cycles that are bridged, a dropout from which it resumes, and one that is too long.
#[test]
fn no_tick_of_a_run_with_missed_cycles_allocates() {
    let dropouts =
        "robot.simulated.bus.dropouts=[{ at_s = 0.2, duration_s = 0.1 }, { at_s = 1.0, duration_s = 1.5 }]";
    let settings = [dropouts, "robot.simulated.bus.lost_cycles_share=0.05"];
    for (task, choice) in [
        ("compliant-x", osc("a-med")),
        ("compliant-x", torque("a-med")),
        ("joint-tracking", osc("b-soft")),
        ("cartesian-tracking", ik("b-soft", ControllerKind::IkLead)),
    ] {
        let experiment = short(&load(task, choice, &settings), 3.0);
        let controller = experiment.controller().unwrap_or_else(|e| panic!("{e}"));
        let (counts, ending) = count(&experiment, controller, None);
        assert!(matches!(ending, RunOutcome::Faulted { fault: Fault::Dropout { .. }, .. }), "{ending:?}");
        let phase = |phase: Phase| counts.iter().filter(|(p, _)| *p == phase.code()).count();
        assert!(phase(Phase::Held) > 9 && phase(Phase::Resuming) > 30, "{task}: it was held, and resumed");
        // After the ramp it is in control again: no start, which alone may allocate.
        let start = counts.iter().position(|(p, _)| *p == Phase::Control.code()).expect("control");
        let after = &counts[start..];
        let allocated = after.last().map_or(0, |last| last.1) - after[0].1;
        assert_eq!(allocated, 0, "{task}");
    }
}

/// Every transformer that an arm can have; the literal ones are for a single joint, and refused.
#[test]
fn no_tick_of_any_transformer_allocates() {
    let closed_loop = "closed_loop={numerator=[1.0],denominator=[1.0,0.02,6.6e-5]}";
    let joint = format!(
        "{{{closed_loop},open_loop={{numerator=[1.0],denominator=[0.0,2.0,0.3]}},from_hz=0.5,to_hz=50.0}}"
    );
    let joints =
        ["shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow"].map(|name| format!("{name}={joint}"));
    let identified = format!("robot.profile.a-med.identified={{{}}}", joints.join(","));
    for transformer in TransformerKind::ALL {
        let choice = Choice { transformer: Some(transformer), ..Choice::default() };
        let path = Path::new("tasks/compliant-x.toml");
        let mut settings = vec![identified.clone()];
        match transformer.method {
            Method::Interpolating => settings.push("robot.interface.set_points=\"interpolated\"".to_owned()),
            Method::Emulation if transformer.current => {
                settings.push("robot.profile.a-med.refine={time_s=1.0,within=0.3}".to_owned());
            }
            _ => {}
        }
        let experiment = Experiment::load(Files::Embedded, path, None, choice, &settings);
        if matches!(transformer.method, Method::IdentifiedLiteral | Method::IdentifiedOpenLoop) {
            let refused = experiment.err().map(|e| e.to_string()).unwrap_or_default();
            assert!(refused.contains("one joint alone"), "{transformer:?}: {refused}");
            continue;
        }
        let experiment = short(&experiment.unwrap_or_else(|e| panic!("{e}")), 0.5);
        let controller = experiment.controller().unwrap_or_else(|e| panic!("{e}"));
        let (counts, ending) = count(&experiment, controller, None);
        assert_eq!(ending, RunOutcome::Completed, "{transformer:?}");
        check(&counts, transformer.name());
    }
}

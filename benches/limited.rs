//! Duration of a control cycle with and without limits in force: `cargo bench --bench limited`.
//!
//! The suites of motions beyond the limits and through singular poses are simulated, and their samples recorded. The
//! control loop then computes every run from its samples again, five times; the duration of a cycle is the least of its
//! five. Cycles in which a limit changes the command are listed apart from the others.
//!
//! If `benches/tsid/build target/tsid` has built it, TSID is measured in the same run and by the same method: single
//! cycles on the arm of the suites, within limits of torque, velocity and acceleration, at states that are nearly always at
//! one of them. Position limits would change its bounds, but not the size of its QP.

#![expect(clippy::expect_used, clippy::print_stdout, reason = "a bench")]

use opspace::backend::signal_names::LIMITS_SOLVER;
use opspace::backend::{Backend, Capabilities, Command, DeviceFault, Sample};
use opspace::control_loop::{Phase, Run, drive};
use opspace::experiment::{Experiment, Extensions, Files};
use opspace::sim::SimulatedArm;
use opspace::suite::Suite;
use std::path::Path;
use std::time::Instant;

#[path = "common/timing.rs"]
#[expect(dead_code, reason = "only the peer is called here")]
mod timing;

const SUITES: [&str; 2] = ["tasks/suites/limits.toml", "tasks/suites/singularity.toml"];

/// Arm of the suites, and its controlled frame.
const ARM: [&str; 2] = ["robots/panda/panda.urdf", "flange"];

/// Number of computations of each cycle, the fastest of which counts.
const REPETITIONS: usize = 5;

fn main() {
    let testing = std::env::args().any(|argument| argument == "--test");
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    println!("duration of a control cycle, µs");
    println!("{:12}{:>10}{:>10}{:>12}{:>10}{:>10}", "", "free", "", "limited", "", "");
    println!("{:12}{:>10}{:>10}{:>12}{:>10}{:>10}", "", "median", "worst", "median", "worst", "cycles");
    let (mut all, extensions) = (Vec::new(), Extensions::default().with_comparisons());
    for path in SUITES {
        let suite = Suite::load_with(&extensions, Files::Disk, &root.join(path)).expect("is a good suite");
        println!("{path}");
        let mut whole = Durations::default();
        for experiment in suite.of_robots().take(if testing { 1 } else { usize::MAX }) {
            let durations = Durations::of(experiment, if testing { 1 } else { REPETITIONS });
            let options = experiment.options();
            println!(
                "{} {} {} {}",
                durations.row(),
                experiment.task().name(),
                options.backend.name(),
                options.label.as_deref().unwrap_or_default()
            );
            whole.free.extend(durations.free);
            whole.limited.extend(durations.limited);
        }
        println!("{} all", whole.row());
        all.extend(whole.limited);
    }
    let peer = root.join("target/tsid/peer");
    if testing || !peer.exists() {
        return;
    }
    let [urdf, tip] = ARM;
    let theirs = timing::measure_peer(&peer, &root.join(urdf), tip);
    let (median, worst) = median_and_worst(&all);
    for (name, ours, theirs) in
        [("median", median, theirs["single_median"]), ("worst", worst, theirs["single_worst"])]
    {
        let theirs = 1e-3 * theirs;
        println!("limited, {name}: {ours:.2} µs, TSID {theirs:.2} µs, ours over theirs {:.2}", ours / theirs);
    }
}

/// Durations of the control cycles of a run, µs.
#[derive(Default)]
struct Durations {
    free: Vec<f64>,
    limited: Vec<f64>,
}

impl Durations {
    fn of(experiment: &Experiment, repetitions: usize) -> Self {
        let samples = record(experiment);
        let mut least = vec![f64::INFINITY; samples.len()];
        let mut kind = vec![None; samples.len()];
        for _ in 0..repetitions {
            let mut control = experiment.control_loop().expect("was checked");
            let targets = control.targets();
            let before = control.layout().signals.iter().take_while(|signal| signal.name != LIMITS_SOLVER);
            let solver: usize = before.map(|signal| signal.len()).sum();
            for ((sample, least), kind) in samples.iter().zip(&mut least).zip(&mut kind) {
                let start = Instant::now();
                let phase = control.step(sample, &targets).phase;
                *least = least.min(start.elapsed().as_secs_f64() * 1e6);
                *kind = (phase == Phase::Control).then(|| control.row()[solver] > 0.0);
            }
        }
        let of = |limited: bool| {
            let cycles = least.iter().zip(&kind).filter(|(_, kind)| **kind == Some(limited));
            cycles.map(|(least, _)| *least).collect()
        };
        Self { free: of(false), limited: of(true) }
    }

    fn row(&self) -> String {
        let [(free, slowest_free), (limited, slowest)] =
            [&self.free, &self.limited].map(|durations| median_and_worst(durations));
        let cycles = self.limited.len();
        format!("{:12}{free:10.2}{slowest_free:10.2}{limited:12.2}{slowest:10.2}{cycles:10}", "")
    }
}

/// Returns zeros if there are no durations.
fn median_and_worst(durations: &[f64]) -> (f64, f64) {
    let mut sorted = durations.to_owned();
    sorted.sort_by(f64::total_cmp);
    (sorted.get(sorted.len() / 2).copied().unwrap_or(0.0), sorted.last().copied().unwrap_or(0.0))
}

/// Simulates a run and returns its samples.
fn record(experiment: &Experiment) -> Vec<Sample> {
    let arm = experiment.simulated_arm().expect("can be simulated");
    let mut recorded = Recorded { arm, samples: Vec::new() };
    let control = experiment.control_loop().expect("was checked");
    let mut sink = ();
    let mut run = Run::new(control, experiment.duration_s(), &mut sink);
    drive(&mut recorded, &mut run);
    recorded.samples
}

/// A simulated arm whose samples are recorded.
struct Recorded {
    arm: SimulatedArm,
    samples: Vec<Sample>,
}

impl Backend for Recorded {
    fn capabilities(&self) -> &Capabilities {
        self.arm.capabilities()
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        self.arm.read(sample)?;
        self.samples.push(sample.clone());
        Ok(())
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        self.arm.write(command)
    }

    fn stop(&mut self) {
        self.arm.stop();
    }
}

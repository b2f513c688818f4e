//! A task that panics: the robot is stopped, the log is complete, and the outcome says so.
//!
//! `cargo run --release -p opspace --example panic_in_a_task`

#![expect(clippy::print_stdout, reason = "an example shows what it did")]

use opspace::backend::{CommandKind, Observable, Row, Signal};
use opspace::control::{ControlInput, Controller};
use opspace::control_loop::{ControlLoop, Fault, LoopConfig, Run, RunOutcome, drive};
use opspace::experiment::{Experiment, Files};

/// Holds the arm's weight, until it meets an error of its author's.
struct Faulty;

impl Controller for Faulty {
    fn command_kind(&self) -> CommandKind {
        CommandKind::Torque
    }

    fn start(&mut self, _input: &ControlInput<'_>) {}

    fn update(&mut self, input: &ControlInput<'_>, command: &mut [f64]) {
        assert!(input.measurement.time_s < 1.0, "a controller of one's own has an error");
        command.copy_from_slice(input.data.gravity.as_slice());
    }
}

impl Observable for Faulty {
    fn signals(&self) -> Vec<Signal> {
        Vec::new()
    }

    fn sample(&self, _row: &mut Row<'_>) {}
}

/// Counts the rows.
struct Rows(u64);

impl opspace::backend::Sink for Rows {
    fn row(&mut self, channel: usize, _time_s: f64, _row: &[f64]) {
        self.0 += u64::from(channel == opspace::backend::TICK);
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let task = "tasks/gravity-compensation.toml".as_ref();
    let experiment = Experiment::load(Files::Disk, task, None, Default::default(), &[])?;
    let mut arm = experiment.simulated_arm()?;
    let config = experiment.loop_config()?;
    let control = ControlLoop::new(LoopConfig { controller: Box::new(Faulty), ..config })?;
    let mut rows = Rows(0);
    let mut run = Run::new(control, 8.0, &mut rows);
    drive(&mut arm, &mut run);
    let outcome = run.finish();
    assert!(matches!(outcome, RunOutcome::Faulted { fault: Fault::Panicked, .. }), "{outcome:?}");
    println!("stopped after {} rows: {outcome:?}", rows.0);
    Ok(())
}

//! Comparison of transformers on arms with random drives, beside the torque robot: what they stop, and their torque errors.
//!
//! ```text
//! cargo run --release -p opspace-testing --example transformers -- [current] [mujoco] ARMS SEED [WIDTH]
//! ```
//!
//! Rates of 50 Hz to 1 kHz, delays up to a cycle, kp and kv wrong by up to 20 % (or WIDTH, a fraction), friction of half to twice the
//! declared one, encoders of 12 to 20 bit, rigid and elastic gears, each unknown to the transformer; tracking, pressing with
//! 20 N, gravity compensation and compliance with an operator. With `current`, the robots measure motor current. Runs count
//! in which the torque robot is not stopped. The program fails if the default transformer is stopped in two more runs than another one.

//!
//! ```text
//! cargo run --release -p opspace-testing --example transformers -- figure FILE.svg [mujoco] ARMS SEED
//! ```
//!
//! draws what the hand feels over the width of the gains' interval: see [`intervals`].

#![expect(clippy::print_stdout, reason = "a program for the terminal")]

#[path = "../rest/arms.rs"]
mod arms;
mod draw;
mod intervals;
#[path = "../../../../examples/common/plot.rs"]
mod plot;

use draw::Draw;
use opspace_backend::CommandKind;
use opspace_experiment::{
    Experiment, FileError, Progress, RobotDefinition, RunOptions, Source, TaskDefinition,
};
use opspace_log::Recording;
use opspace_mujoco::Mujoco;
use opspace_sim::PhysicsEngine;
use opspace_transformer::TransformerName;
use std::io::Cursor;
use std::process::ExitCode;
use std::sync::Arc;

/// Result of a run that was not stopped: torque errors, and motion of the hand and its force.
#[derive(Clone, Copy)]
struct Completed {
    /// Error of interval means, relative to the desired torque.
    torque_error: f64,
    /// Largest rms error of a joint, relative to its torque limit.
    of_limit: f64,
    /// Motion of the hand, rms, m, and its force, rms, N; `NaN` without a hand.
    hand_m: f64,
    hand_n: f64,
}

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let has = |word: &str| words.iter().any(|given| given == word);
    let numbers: Vec<f64> = words.iter().filter_map(|word| word.parse().ok()).collect();
    let (arms, seed) = (numbers.first().map_or(20, |n| *n as usize), numbers.get(1).map_or(1, |n| *n as u64));
    let engine =
        has("mujoco").then(|| Arc::new(Mujoco::find(None).expect("MuJoCo")) as Arc<dyn PhysicsEngine>);
    if has("figure") {
        let path = words.iter().find(|word| word.ends_with(".svg")).expect("a file that ends with .svg");
        intervals::draw_figure(path, arms, seed, engine);
        return ExitCode::SUCCESS;
    }
    let current = has("current");
    let names = ["extrapolation", "paper", "emulation"]
        .map(|name| TransformerName::literal(name).with_current(current));
    let mut results: Vec<[Vec<Option<Completed>>; 3]> = Vec::new();
    let mut of_torque: Vec<Vec<Option<Completed>>> = Vec::new();
    let mut tasks: Vec<&str> = Vec::new();
    for number in 0..arms {
        let draw = Draw::new(number, seed, current, numbers.get(2).copied());
        println!("{number:3} {}", draw.name);
        let robot = draw.robot();
        for (k, (task, text)) in draw.tasks(seed).into_iter().enumerate() {
            if tasks.len() == k {
                tasks.push(task);
                results.push([const { Vec::new() }; 3]);
                of_torque.push(Vec::new());
            }
            let mut line = format!("    {task:20}");
            let torque = run(&robot, &text, CommandKind::Torque, None, engine.clone());
            line += &format!(" torque: {}", described(&torque));
            for (place, name) in names.iter().enumerate() {
                let outcome = run(&robot, &text, CommandKind::Position, Some(name.clone()), engine.clone());
                line += &format!(" | {name}: {}", described(&outcome));
                results[k][place].push(outcome.ok());
            }
            println!("{line}");
            of_torque[k].push(torque.ok());
        }
    }
    let mut stops = [0; 3];
    println!(
        "\n| task | transformer | stopped | worst joint, % of its torque limit | torque error, %: median | largest | hand, mm; N (torque robot) |"
    );
    println!("|---|---|---|---|---|---|---|");
    for ((task, of_task), torque) in tasks.iter().zip(&results).zip(&of_torque) {
        for ((name, outcomes), stops) in names.iter().zip(of_task).zip(&mut stops) {
            let counted: Vec<_> =
                outcomes.iter().zip(torque).filter(|(_, torque)| torque.is_some()).collect();
            let stopped = counted.iter().filter(|(one, _)| one.is_none()).count();
            *stops += stopped;
            let value = |of: fn(&Completed) -> f64| {
                sorted(counted.iter().filter_map(|(one, _)| one.as_ref().map(of)))
            };
            let of_torque = |of: fn(&Completed) -> f64| {
                median(&sorted(counted.iter().filter_map(|(_, torque)| torque.as_ref().map(of))))
            };
            let (errors, of_limit) = (value(|one| one.torque_error), value(|one| one.of_limit));
            let of_hand: [fn(&Completed) -> f64; 2] = [|one| 1e3 * one.hand_m, |one| one.hand_n];
            let [[mm, n], [mm_torque, n_torque]] =
                [of_hand.map(|of| median(&value(of))), of_hand.map(of_torque)];
            let hand = match mm.is_nan() {
                true => "–".to_owned(),
                false => format!("{mm:.0}; {n:.1} ({mm_torque:.0}; {n_torque:.1})"),
            };
            println!(
                "| {task} | `{name}` | {stopped} of {} | {:.1} | {:.1} | {:.1} | {hand} |",
                counted.len(),
                100.0 * of_limit.last().copied().unwrap_or(f64::NAN),
                100.0 * median(&errors),
                100.0 * errors.last().copied().unwrap_or(f64::NAN),
            );
        }
    }
    println!(
        "stopped in all: {}",
        names.iter().zip(stops).map(|(n, s)| format!("{n} {s}")).collect::<Vec<_>>().join(", ")
    );
    if stops[0] <= stops[1].min(stops[2]) + 1 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn described(outcome: &Result<Completed, String>) -> String {
    match outcome {
        Err(fault) => format!("STOPPED {fault}"),
        Ok(one) if one.hand_m.is_nan() => format!("{:.1} %", 100.0 * one.torque_error),
        Ok(one) => {
            format!("{:.1} %, {:.0} mm, {:.1} N", 100.0 * one.torque_error, 1e3 * one.hand_m, one.hand_n)
        }
    }
}

fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values
}

fn median(sorted: &[f64]) -> f64 {
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Runs a task; the fault of a run that was stopped.
fn run(
    robot: &RobotDefinition,
    task: &str,
    backend: CommandKind,
    transformer: Option<TransformerName>,
    engine: Option<Arc<dyn PhysicsEngine>>,
) -> Result<Completed, String> {
    let source = Source::new("drawn.toml", task.to_owned());
    let task = TaskDefinition::from_sources(source, |_| -> Result<_, FileError> {
        unreachable!("the task has no path")
    })
    .unwrap_or_else(|error| panic!("{error}"));
    let options = RunOptions { backend, transformer, ..RunOptions::default() };
    let experiment =
        Experiment::new(robot.clone(), task, options, Vec::new()).unwrap_or_else(|error| panic!("{error}"));
    let experiment = match engine {
        Some(engine) => experiment.on_engine(engine).unwrap_or_else(|error| panic!("{error}")),
        None => experiment,
    };
    let finished = experiment.run(Cursor::new(Vec::new()), &Progress::default()).expect("a run");
    if let Some(fault) = finished.record.fault {
        return Err(fault);
    }
    let log = Recording::from_bytes(finished.sink.get_ref()).expect("a log");
    let metrics = experiment.summary(&log, &finished.record, None).metrics;
    let number = |key: &str| metrics.get(key).unwrap_or(f64::NAN);
    Ok(Completed {
        torque_error: number("torque_error_interval"),
        of_limit: number("torque_error_of_limit_max"),
        hand_m: number("hand_motion_rms_m"),
        hand_n: number("hand_force_rms_n"),
    })
}

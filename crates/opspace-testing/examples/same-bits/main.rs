//! Comparison of the numbers that two builds of opspace compute, bit by bit. `tests/same-bits/run` performs all steps.
//!
//! It executes all runs of the suites with each build ([`suites`], [`side`]), computes a hash of every signal of
//! every run ([`hashes`]), and compares two lists of hashes ([`compare`](mod@compare)) with a table of renamed
//! signals ([`signals`]).

#![forbid(unsafe_code)]
#![expect(clippy::print_stdout, clippy::print_stderr, reason = "a program for the terminal")]

mod compare;
mod hashes;
mod locate;
mod side;
mod signals;
mod suites;

use crate::compare::{compare, lines};
use crate::locate::differences;
use crate::side::Side;
use crate::signals::Table;
use crate::suites::{Run, SUITES};
use clap::{Args, Parser};
use opspace_log::Recording;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Compare the numbers that two builds of opspace compute, bit by bit.
#[derive(Parser)]
enum Cli {
    /// Execute all runs of the suites, with one seed each, and write a hash of every signal.
    Hash(HashArgs),
    /// Compare the hashes of an old build with those of a new build; exit code 1 if a difference is not explained.
    Compare(CompareArgs),
    /// Execute one run with both builds and print the first differences; exit code 1 if any is not explained.
    Locate(LocateArgs),
}

#[derive(Args)]
struct HashArgs {
    /// The `opspace` program.
    #[arg(long)]
    program: PathBuf,

    /// The checkout with the suites, tasks and robots to run.
    #[arg(long)]
    checkout: PathBuf,

    /// Only this suite. Can be repeated.
    #[arg(long = "suite", default_values = SUITES)]
    suites: Vec<String>,

    /// Number of simultaneous runs.
    #[arg(long, default_value_t = 2)]
    jobs: usize,

    /// Duration of every run instead of that of its task, s.
    #[arg(long, value_name = "S")]
    duration_s: Option<f64>,

    /// Keep the folders of the runs in this folder, which must not contain them yet.
    #[arg(long, value_name = "DIR")]
    keep: Option<PathBuf>,

    /// Write the hashes to this file.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

#[derive(Args)]
struct CompareArgs {
    /// The hashes of the old build.
    old: PathBuf,

    /// The hashes of the new build.
    new: PathBuf,

    /// The table of renamed signals.
    #[arg(long, value_name = "FILE")]
    signals: Option<PathBuf>,
}

#[derive(Args)]
struct LocateArgs {
    /// The suite.
    suite: String,

    /// The place of the run in the suite, for example 3.1.2.1.
    run: String,

    /// The `opspace` program of the old build.
    #[arg(long)]
    old_program: PathBuf,

    /// The checkout of the old build.
    #[arg(long)]
    old_checkout: PathBuf,

    /// The `opspace` program of the new build.
    #[arg(long)]
    new_program: PathBuf,

    /// The checkout of the new build.
    #[arg(long)]
    new_checkout: PathBuf,

    /// Duration instead of that of the task, s.
    #[arg(long, value_name = "S")]
    duration_s: Option<f64>,

    /// The table of renamed signals.
    #[arg(long, value_name = "FILE")]
    signals: Option<PathBuf>,
}

fn main() -> ExitCode {
    let same = match Cli::parse() {
        Cli::Hash(args) => hash(&args),
        Cli::Compare(args) => compare_files(&args),
        Cli::Locate(args) => locate(&args),
    };
    match same {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(1),
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}

/// Hashes all runs; returns true if every run produced a complete log.
fn hash(args: &HashArgs) -> Result<bool, String> {
    let side = Side::new(&args.program, &args.checkout, args.duration_s)?;
    let runs = side.runs(&args.suites)?;
    let scratch = tempfile::tempdir().map_err(|e| e.to_string())?;
    let folder = match &args.keep {
        Some(folder) => std::path::absolute(folder).map_err(|e| e.to_string())?,
        None => scratch.path().to_owned(),
    };
    let texts = hash_all(&side, &runs, &folder, args)?;
    std::fs::write(&args.out, texts.concat()).map_err(|e| format!("{}: {e}", args.out.display()))?;
    let signals: usize = texts.iter().map(|text| text.lines().filter(|l| !l.contains("\t-\t")).count()).sum();
    let without = texts.iter().filter(|text| text.lines().all(|l| l.contains("\t-\t"))).count();
    eprintln!("{} runs, {signals} signals hashed, {without} runs without a log", runs.len());
    Ok(without == 0)
}

/// Hash lines of every run, in the order of the runs.
fn hash_all(side: &Side, runs: &[Run], folder: &Path, args: &HashArgs) -> Result<Vec<String>, String> {
    let next = AtomicUsize::new(0);
    let done = Mutex::new(vec![Ok(String::new()); runs.len()]);
    std::thread::scope(|scope| {
        for _ in 0..args.jobs.clamp(1, runs.len().max(1)) {
            scope.spawn(|| {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let Some(run) = runs.get(index) else { return };
                    let text = hash_one(side, run, folder, args.keep.is_some());
                    eprintln!("{}/{}\t{} {} {}", index + 1, runs.len(), run.suite, run.place, run.spelling);
                    if let Ok(mut done) = done.lock() {
                        done[index] = text;
                    }
                }
            });
        }
    });
    done.into_inner().map_err(|e| e.to_string())?.into_iter().collect()
}

fn hash_one(side: &Side, run: &Run, folder: &Path, keep: bool) -> Result<String, String> {
    let made = side.make(run, &folder.join(format!("{}-{}", run.suite, run.place)), keep)?;
    if let Err(why) = &made.recording {
        eprintln!(
            "no log of {} {} {}: opspace run {:?}: {why}",
            run.suite, run.place, run.spelling, run.arguments
        );
    }
    Ok(lines(run, &made.hashes()))
}

/// Compares two lists of hashes; returns true if all are equal or explained.
fn compare_files(args: &CompareArgs) -> Result<bool, String> {
    let report = compare(&text(&args.old)?, &text(&args.new)?, &table(args.signals.as_deref())?)?;
    println!("{report}");
    Ok(report.is_clean())
}

/// Compares one run of both builds; returns true if it is equal or its differences are explained.
fn locate(args: &LocateArgs) -> Result<bool, String> {
    let table = table(args.signals.as_deref())?;
    let (old_lines, old) = record(args, "old", &args.old_program, &args.old_checkout)?;
    let (new_lines, new) = record(args, "new", &args.new_program, &args.new_checkout)?;
    for d in differences(&old, &new, &table) {
        println!("{}: row {}, {} s: {:?} -> {:?}", d.name, d.row, d.time_s, d.old, d.new);
    }
    let report = compare(&old_lines, &new_lines, &table)?;
    println!("{report}");
    Ok(report.is_clean())
}

/// Executes the run with one of the builds.
fn record(
    args: &LocateArgs,
    name: &str,
    program: &Path,
    checkout: &Path,
) -> Result<(String, Recording), String> {
    let scratch = tempfile::tempdir().map_err(|e| e.to_string())?;
    let side = Side::new(program, checkout, args.duration_s)?;
    let runs = side.runs(std::slice::from_ref(&args.suite))?;
    let run = runs.iter().find(|run| run.place == args.run);
    let run = run.ok_or_else(|| format!("{} has no run {}", args.suite, args.run))?;
    println!("{name}: opspace run {}", run.arguments.join(" "));
    let made = side.make(run, &scratch.path().join(name), false)?;
    Ok((lines(run, &made.hashes()), made.recording?))
}

fn text(path: &Path) -> Result<String, String> {
    std::fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))
}

fn table(path: Option<&Path>) -> Result<Table, String> {
    path.map_or_else(|| Ok(Table::default()), |path| Table::parse(&text(path)?))
}

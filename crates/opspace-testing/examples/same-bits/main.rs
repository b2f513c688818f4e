//! Comparison of the results of two builds of opspace, bit by bit. `tests/same-bits/run` performs all steps.
//!
//! The results of a build have parts: each suite is one, with a run for each of its entries ([`suites`]); `files` are the runs
//! of every task and experiment alone, and `check` is what `opspace check` prints about every file ([`shipped`]). Of each
//! run, a hash of every signal ([`hashes`]) and the values of its summary ([`keys`]) are listed, of each suite also the
//! direction of its metrics ([`baseline`]). Two lists are compared ([`compare`](mod@compare)) with a table of accepted
//! differences ([`accepted`]).

#![forbid(unsafe_code)]
#![expect(clippy::print_stdout, clippy::print_stderr, reason = "a program for the terminal")]

mod accepted;
mod baseline;
mod collect;
mod compare;
mod entries;
mod hashes;
mod keys;
mod locate;
mod shipped;
mod side;
mod suites;

use crate::accepted::Table;
use crate::collect::{collect, is_default, units};
use crate::compare::{Results, compare};
use crate::locate::differences;
use crate::side::{Log, Side, with_signals};
use clap::{Args, Parser};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Compare the results of two builds of opspace, bit by bit.
#[derive(Parser)]
enum Cli {
    /// Execute all runs and checks with one build, and list their results in a folder, with a file for each part.
    Collect(CollectArgs),
    /// Compare the results of an old build with those of a new build; exit code 1 if a difference is not explained.
    Compare(CompareArgs),
    /// Execute one run with both builds and print the first differences; exit code 1 if any is not explained.
    Locate(LocateArgs),
}

#[derive(Args)]
struct CollectArgs {
    /// The `opspace` program.
    #[arg(long)]
    program: PathBuf,

    /// The program for the suites that use what exists only for comparisons [default: the same].
    #[arg(long)]
    comparisons: Option<PathBuf>,

    /// The checkout with the files to run.
    #[arg(long)]
    checkout: PathBuf,

    /// Only this part: the name of a suite, `files` or `check`. Can be repeated.
    #[arg(long = "part")]
    parts: Vec<String>,

    /// Number of simultaneous runs.
    #[arg(long, default_value_t = 2)]
    jobs: usize,

    /// Duration of every run instead of that of its task, s.
    #[arg(long, value_name = "S")]
    duration_s: Option<f64>,

    /// Write the results into this folder; parts that it contains are not repeated.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

#[derive(Args)]
struct CompareArgs {
    /// The folder with the results of the old build.
    old: PathBuf,

    /// The folder with the results of the new build.
    new: PathBuf,

    /// Only this part. Can be repeated.
    #[arg(long = "part")]
    parts: Vec<String>,

    /// The table of accepted differences.
    #[arg(long, value_name = "FILE")]
    accepted: Option<PathBuf>,
}

#[derive(Args)]
struct LocateArgs {
    /// The suite, or `files`.
    part: String,

    /// The place of the run in the suite, for example 3.1.2.1.1.1, or the name of the file.
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

    /// The program of the new build for the suites that use what exists only for comparisons [default: the same].
    #[arg(long)]
    new_comparisons: Option<PathBuf>,

    /// The checkout of the new build.
    #[arg(long)]
    new_checkout: PathBuf,

    /// Duration instead of that of the task, s.
    #[arg(long, value_name = "S")]
    duration_s: Option<f64>,

    /// The table of accepted differences.
    #[arg(long, value_name = "FILE")]
    accepted: Option<PathBuf>,
}

fn main() -> ExitCode {
    let same = match Cli::parse() {
        Cli::Collect(args) => collect_all(&args).map(|()| true),
        Cli::Compare(args) => compare_folders(&args),
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

fn collect_all(args: &CollectArgs) -> Result<(), String> {
    let side = Side::new(&args.program, &args.checkout, args.duration_s)?;
    let side = side.with_comparisons(args.comparisons.as_deref())?;
    std::fs::create_dir_all(&args.out).map_err(|e| format!("{}: {e}", args.out.display()))?;
    let mut units = units(&side, &args.parts)?;
    units.retain(|unit| !file_of(&args.out, &unit.part).exists());
    collect(&side, &units, args.jobs, &|part, text| {
        // Written aside and renamed, so that a part is there as a whole or not at all.
        let (file, aside) = (file_of(&args.out, part), args.out.join(format!("{part}.partial")));
        std::fs::write(&aside, text)
            .and_then(|()| std::fs::rename(&aside, &file))
            .map_err(|e| format!("{}: {e}", file.display()))
    })
}

fn file_of(folder: &Path, part: &str) -> PathBuf {
    folder.join(format!("{part}.txt"))
}

/// Compares the results in two folders; returns true if all are equal or explained.
fn compare_folders(args: &CompareArgs) -> Result<bool, String> {
    let read = |folder: &Path| -> Result<Results, String> {
        let mut results = Results::default();
        let parts =
            if args.parts.is_empty() { parts_in(folder)? } else { args.parts.iter().cloned().collect() };
        for part in parts {
            results.add(&part, &text(&file_of(folder, &part))?)?;
        }
        Ok(results)
    };
    let report = compare(&read(&args.old)?, &read(&args.new)?, &table(args.accepted.as_deref())?);
    println!("{report}");
    Ok(report.is_clean())
}

/// Names of the parts whose results are in a folder, without those that are only compared if they are named.
fn parts_in(folder: &Path) -> Result<BTreeSet<String>, String> {
    let wrong = |e: std::io::Error| format!("{}: {e}", folder.display());
    let files: Vec<PathBuf> = std::fs::read_dir(folder)
        .map_err(wrong)?
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<Result<_, _>>()
        .map_err(wrong)?;
    let parts = files.iter().filter(|path| path.extension().is_some_and(|end| end == "txt"));
    let names = parts.filter_map(|path| Some(path.file_stem()?.to_string_lossy().into_owned()));
    Ok(names.filter(|part| is_default(part)).collect())
}

/// Compares one run of both builds; returns true if it is equal or its differences are explained.
fn locate(args: &LocateArgs) -> Result<bool, String> {
    let table = table(args.accepted.as_deref())?;
    let (old_results, old) =
        record(args, &Side::new(&args.old_program, &args.old_checkout, args.duration_s)?)?;
    let new_side = Side::new(&args.new_program, &args.new_checkout, args.duration_s)?;
    let new_side = new_side.with_comparisons(args.new_comparisons.as_deref())?;
    let (new_results, new) = record(args, &new_side)?;
    for old in &old {
        let Some(new) = new.iter().find(|new| new.robot == old.robot) else { continue };
        if let (Ok(old_rows), Ok(new_rows)) = (&old.recording, &new.recording) {
            let robot = old.robot.as_ref().map(|robot| format!("{robot}: ")).unwrap_or_default();
            for d in differences(old_rows, new_rows, &table) {
                println!("{robot}{}: row {}, {} s: {:?} -> {:?}", d.name, d.row, d.time_s, d.old, d.new);
            }
        }
    }
    let report = compare(&old_results, &new_results, &table);
    println!("{report}");
    Ok(report.is_clean())
}

/// Executes the run with one of the builds.
fn record(args: &LocateArgs, side: &Side) -> Result<(Results, Vec<Log>), String> {
    let scratch = tempfile::tempdir().map_err(|e| e.to_string())?;
    let units = units(side, std::slice::from_ref(&args.part))?;
    let mut found = Vec::new();
    for unit in &units {
        found.extend(unit.run_alone(side, &args.run, scratch.path())?);
    }
    let [(item, logs)] = <[_; 1]>::try_from(found)
        .map_err(|found| format!("{} has {} runs {}", args.part, found.len(), args.run))?;
    let mut results = Results::default();
    results.add(&args.part, &entries::text(&with_signals(item, &logs)))?;
    Ok((results, logs))
}

fn text(path: &Path) -> Result<String, String> {
    std::fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))
}

fn table(path: Option<&Path>) -> Result<Table, String> {
    path.map_or_else(|| Ok(Table::default()), |path| Table::parse(&text(path)?))
}

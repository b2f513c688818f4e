//! Trial of hostile inputs: files, logs and folders of results with mistakes, signals, full disks and faulty drivers.
//!
//! ```text
//! hostile-inputs [--seed SEED] [--share PART] [--program PROGRAM] [--kind KIND [--only NUMBER]] [--keep FOLDER]
//! ```
//!
//! Each kind draws its inputs from the seed. The library reads them, and the program gets a part of them. `--share 0.1` tries
//! a tenth of the inputs. No input may cause a panic, the end by a signal, an exit code that `docs/reference/exit-codes.md` does not list, more
//! than [`LONGEST`](program::LONGEST) or more than [`MOST_KILOBYTES`](program::MOST_KILOBYTES). The kinds have further rules: see
//! their files.
//!
//! A line for each kind counts the inputs: those that were refused, accepted without a run, and run, and those that failed.
//! The program fails if any did. `--kind KIND --only NUMBER` repeats one, and `--keep FOLDER` keeps its files.

#![expect(clippy::print_stdout, clippy::print_stderr, reason = "a program for the terminal")]

mod byte_changes;
mod drivers;
#[path = "../../tests/fuzz/edits.rs"]
#[expect(dead_code, reason = "the fuzz targets use all of it")]
mod edits;
#[path = "../../../../tests/all/driver_faults/faulty_driver.rs"]
mod faulty_driver;
mod full_disks;
mod inputs;
mod kills;
mod library;
mod logs;
mod program;
mod results;
mod robots;
mod suites;
mod tasks;
mod toml_changes;

use inputs::Inputs;
use opspace_testing::random::Random;
use program::Program;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;
use std::{env, fs, thread};

/// Number of inputs that are tried at once.
const THREADS: usize = 2;

/// Outcome of one input.
pub enum Outcome {
    /// An error with a reason.
    Refused,
    /// Accepted by a reader, without a run.
    Accepted,
    /// Accepted, and used by the program.
    Ran,
    /// Something that must not happen, in words.
    Failed(String),
}

/// Kind of inputs.
struct Kind {
    name: &'static str,
    /// Number of inputs of the whole trial.
    count: usize,
    /// Tries one input, with a folder for its files.
    judge: fn(&Inputs, &mut Random, &Path) -> Outcome,
}

/// All kinds; those that wait for time more than they compute come last.
const KINDS: &[Kind] = &[
    Kind { name: "tasks", count: 6000, judge: tasks::task },
    Kind { name: "experiments", count: 2400, judge: tasks::experiment },
    Kind { name: "robots", count: 5000, judge: robots::robot },
    Kind { name: "urdfs", count: 4000, judge: robots::urdf },
    Kind { name: "suites", count: 1500, judge: suites::suite },
    Kind { name: "logs", count: 2000, judge: logs::log },
    Kind { name: "results", count: 400, judge: results::result },
    Kind { name: "disks", count: 60, judge: full_disks::disk },
    Kind { name: "drivers", count: 60, judge: drivers::driver },
    Kind { name: "kills", count: 20, judge: kills::kill },
];

struct Options {
    seed: u64,
    share: f64,
    program: Option<PathBuf>,
    kind: Option<String>,
    only: Option<usize>,
    keep: Option<PathBuf>,
}

fn options() -> Result<Options, String> {
    let mut options = Options { seed: 1, share: 1.0, program: None, kind: None, only: None, keep: None };
    let mut arguments = env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let value = arguments.next().ok_or(format!("{argument} needs a value"))?;
        let not_a_number = || format!("'{value}' is no number");
        match argument.as_str() {
            "--seed" => options.seed = value.parse().map_err(|_| not_a_number())?,
            "--share" => options.share = value.parse().map_err(|_| not_a_number())?,
            "--only" => options.only = Some(value.parse().map_err(|_| not_a_number())?),
            "--program" => options.program = Some(value.into()),
            "--kind" => options.kind = Some(value),
            "--keep" => options.keep = Some(value.into()),
            _ => return Err(format!("unknown option '{argument}'")),
        }
    }
    Ok(options)
}

/// Tries the inputs of a kind, and prints its line. Returns true if none failed.
fn try_kind(kind: &Kind, options: &Options, inputs: &Inputs, work: &Path) -> bool {
    let begun = Instant::now();
    let count = ((kind.count as f64 * options.share).ceil() as usize).max(1);
    let numbers: Vec<usize> = options.only.map_or_else(|| (0..count).collect(), |number| vec![number]);
    let next = AtomicUsize::new(0);
    let counts = Mutex::new([0; 4]);
    thread::scope(|scope| {
        for _ in 0..THREADS {
            scope.spawn(|| {
                while let Some(number) = numbers.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let place = match try_input(kind, options, inputs, work, *number) {
                        Outcome::Refused => 0,
                        Outcome::Accepted => 1,
                        Outcome::Ran => 2,
                        Outcome::Failed(words) => {
                            println!("{} {number} FAILED: {words}", kind.name);
                            println!(
                                "  repeat: --seed {} --kind {} --only {number}",
                                options.seed, kind.name
                            );
                            3
                        }
                    };
                    counts.lock().unwrap_or_else(PoisonError::into_inner)[place] += 1;
                }
            });
        }
    });
    let [refused, accepted, ran, failed] = counts.into_inner().unwrap_or_else(PoisonError::into_inner);
    println!(
        "{:12} {:5} tried, {refused:5} refused, {accepted:5} accepted, {ran:5} ran, {failed:3} failed, {:4.0} s",
        kind.name,
        numbers.len(),
        begun.elapsed().as_secs_f64()
    );
    failed == 0
}

/// Tries one input in a folder of its own.
fn try_input(kind: &Kind, options: &Options, inputs: &Inputs, work: &Path, number: usize) -> Outcome {
    let of_kind = kind.name.bytes().fold(options.seed, |sum, byte| sum.wrapping_mul(31) + u64::from(byte));
    let mut random = Random(of_kind.wrapping_mul(7919).wrapping_add(number as u64 * 104_729));
    let folder = work.join(format!("{}-{number}", kind.name));
    // What is left from an earlier try must not count.
    drop(fs::remove_dir_all(&folder));
    if let Err(error) = fs::create_dir_all(&folder) {
        return Outcome::Failed(format!("{}: {error}", folder.display()));
    }
    let outcome = (kind.judge)(inputs, &mut random, &folder);
    if options.keep.is_none() {
        // What cannot be removed is in the folder for temporary files.
        drop(fs::remove_dir_all(&folder));
    }
    outcome
}

fn judge(options: &Options) -> Result<bool, String> {
    let kinds: Vec<&Kind> =
        KINDS.iter().filter(|kind| options.kind.as_deref().is_none_or(|name| name == kind.name)).collect();
    if kinds.is_empty() {
        let names: Vec<&str> = KINDS.iter().map(|kind| kind.name).collect();
        return Err(format!("unknown kind; one of {}", names.join(", ")));
    }
    let beside = env::current_exe().ok().and_then(|path| Some(path.parent()?.parent()?.join("opspace")));
    let program = options.program.clone().or(beside).unwrap_or_else(|| "opspace".into());
    let program = fs::canonicalize(&program).map_err(|error| format!("{}: {error}", program.display()))?;
    let work = options
        .keep
        .clone()
        .unwrap_or_else(|| env::temp_dir().join(format!("hostile-inputs-{}", std::process::id())));
    fs::create_dir_all(&work).map_err(|error| format!("{}: {error}", work.display()))?;
    let work = fs::canonicalize(&work).map_err(|error| format!("{}: {error}", work.display()))?;
    library::watch();
    let inputs = Inputs::new(Program::new(program), &work)?;
    let passed: Vec<bool> = kinds.iter().map(|kind| try_kind(kind, options, &inputs, &work)).collect();
    if options.keep.is_none() {
        drop(fs::remove_dir_all(&work));
    }
    Ok(passed.iter().all(|passed| *passed))
}

fn main() -> ExitCode {
    // The program with a faulty driver, which a case of `drivers` starts.
    if let Ok(arguments) = env::var(drivers::ARGUMENTS) {
        let extensions = opspace_cli::Extensions::default().with_driver(faulty_driver::FaultyDriver);
        return opspace_cli::main_with_args(extensions, arguments.lines());
    }
    match options().and_then(|options| judge(&options)) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::from(2)
        }
    }
}

//! Trial of URDFs of arms of which nothing else is known: for each, `opspace new --assume`, `check`, and `run` of the first
//! task as a position robot and as a torque robot; then both runs with a payload that the model does not know.
//!
//! ```text
//! cargo run --release -p opspace-testing --example any-arm -- FOLDER [--least N] [--least-loaded N] [--program PROGRAM]
//!     [--plant PLANT] [--drawn N --seed SEED] [--keep FOLDER]
//! ```
//!
//! `FOLDER` has the URDFs. Alternatively `--generate N --seed SEED` draws N URDFs: see [`generate`]. A line for each tells what
//! failed. The program fails if fewer than `--least` arms pass all four commands and end within 10 mm of the goal, or if fewer than
//! `--least-loaded` do so with the payload: neither run is stopped, both end within 2 mm of each other, and no further from the goal
//! than 1.5 times the payload's weight over the stiffness of the task.
//!
//! `--mutate N --seed SEED` changes N generated URDFs at random: `new` must refuse each of them with an error and without a folder, or write
//! a robot that `check` accepts.

#![expect(clippy::print_stdout, clippy::print_stderr, reason = "a program for the terminal")]

mod arm;
mod generate;
mod mutate;

use arm::{Judge, Outcome};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::{env, fs, thread};

/// Number of arms that are tried at once.
const THREADS: usize = 2;

#[derive(Default)]
struct Options {
    folder: Option<PathBuf>,
    generate: usize,
    mutate: usize,
    seed: u64,
    drawn: Option<usize>,
    least: usize,
    least_loaded: usize,
    program: Option<PathBuf>,
    plant: Option<String>,
    keep: Option<PathBuf>,
}

fn options() -> Result<Options, String> {
    let mut options = Options { seed: 1, ..Options::default() };
    let mut arguments = env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or(format!("{argument} needs a value"));
        let number = |text: String| text.parse::<usize>().map_err(|_| format!("'{text}' is no number"));
        match argument.as_str() {
            "--generate" => options.generate = number(value()?)?,
            "--mutate" => options.mutate = number(value()?)?,
            "--seed" => options.seed = number(value()?)? as u64,
            "--drawn" => options.drawn = Some(number(value()?)?),
            "--least" => options.least = number(value()?)?,
            "--least-loaded" => options.least_loaded = number(value()?)?,
            "--program" => options.program = Some(value()?.into()),
            "--plant" => options.plant = Some(value()?),
            "--keep" => options.keep = Some(value()?.into()),
            _ if argument.starts_with('-') => return Err(format!("unknown option '{argument}'")),
            folder => options.folder = Some(folder.into()),
        }
    }
    Ok(options)
}

/// URDFs of a folder, or generated ones in a folder of their own.
fn urdfs(options: &Options, work: &Path) -> Result<Vec<PathBuf>, String> {
    let explain = |path: &Path, error: std::io::Error| format!("{}: {error}", path.display());
    let Some(folder) = &options.folder else {
        let folder = work.join("generated");
        fs::create_dir_all(&folder).map_err(|error| explain(&folder, error))?;
        return (0..options.generate.max(options.mutate))
            .map(|number| {
                let path = folder.join(format!("{number:03}-{}.urdf", generate::kind(number)));
                let text = if options.mutate > 0 { mutate::urdf } else { generate::urdf };
                fs::write(&path, text(number, options.seed)).map_err(|error| explain(&path, error))?;
                Ok(path)
            })
            .collect();
    };
    let entries = fs::read_dir(folder).map_err(|error| explain(folder, error))?;
    let mut found: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    found.retain(|path| path.extension().is_some_and(|extension| extension == "urdf"));
    found.sort();
    if let Some(count) = options.drawn {
        let mut random = opspace_testing::random::Random(options.seed);
        while found.len() > count {
            found.remove(random.below(found.len()));
        }
    }
    Ok(found)
}

/// Calls `judge` with each URDF and a folder for it, and prints the line that it returns with a result. Returns the results.
fn try_all<T: Send>(
    urdfs: &[PathBuf],
    work: &Path,
    judge: impl Fn(&Path, &Path, &str) -> (T, String) + Sync,
) -> Vec<T> {
    let (next, outcomes) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    thread::scope(|scope| {
        for _ in 0..THREADS {
            scope.spawn(|| {
                while let Some(urdf) = urdfs.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let name = urdf.file_stem().unwrap_or_default().to_string_lossy().into_owned();
                    let (outcome, line) = judge(urdf, &work.join(&name), &name);
                    if !line.is_empty() {
                        println!("{line}");
                    }
                    outcomes.lock().unwrap_or_else(PoisonError::into_inner).push(outcome);
                }
            });
        }
    });
    outcomes.into_inner().unwrap_or_else(PoisonError::into_inner)
}

fn judge(options: &Options) -> Result<bool, String> {
    let work = options
        .keep
        .clone()
        .unwrap_or_else(|| env::temp_dir().join(format!("any-arm-{}", std::process::id())));
    let urdfs = urdfs(options, &work)?;
    let beside = env::current_exe().ok().and_then(|path| Some(path.parent()?.parent()?.join("opspace")));
    let program = options.program.clone().or(beside).unwrap_or_else(|| "opspace".into());
    let judge = Judge { program, plant: options.plant.clone() };
    let passes = if options.mutate > 0 {
        judge_mistakes(&judge, &urdfs, &work)
    } else {
        judge_arms(options, &judge, &urdfs, &work)
    };
    if options.keep.is_none() {
        // What cannot be removed is in the folder for temporary files.
        drop(fs::remove_dir_all(&work));
    }
    Ok(passes)
}

fn judge_arms(options: &Options, judge: &Judge, urdfs: &[PathBuf], work: &Path) -> bool {
    let outcomes = try_all(urdfs, work, |urdf, folder, name| {
        let outcome = judge.try_arm(urdf, folder);
        let line = outcome.line(name);
        (outcome, line)
    });
    let passed = outcomes.iter().filter(|outcome| outcome.passed()).count();
    let loaded = outcomes.iter().filter(|outcome| outcome.passed_loaded()).count();
    println!("{passed} of {} pass, {loaded} also with an unknown payload", outcomes.len());
    for step in Outcome::STEPS {
        let failed = outcomes.iter().filter(|outcome| outcome.failed_at(step)).count();
        println!("{failed:4}  {step}");
    }
    !outcomes.is_empty() && passed >= options.least && loaded >= options.least_loaded
}

/// Least share of the mutated files that is written, and that is refused: otherwise the trial shows little.
const LEAST_SHARE: f64 = 0.1;

fn judge_mistakes(judge: &Judge, urdfs: &[PathBuf], work: &Path) -> bool {
    let outcomes = try_all(urdfs, work, |urdf, folder, name| {
        let outcome = mutate::try_file(judge, urdf, folder);
        let line = match &outcome {
            mutate::Outcome::Wrong(words) => format!("{name:36} FAILED {words}"),
            _ => String::new(),
        };
        (outcome, line)
    });
    let count = |is: fn(&mutate::Outcome) -> bool| outcomes.iter().filter(|outcome| is(outcome)).count();
    let written = count(|outcome| matches!(outcome, mutate::Outcome::Accepted));
    let refused = count(|outcome| matches!(outcome, mutate::Outcome::Refused));
    println!(
        "of {} changed files, {written} give a robot that `check` accepts, and {refused} are refused",
        outcomes.len()
    );
    let least = LEAST_SHARE * outcomes.len() as f64;
    written + refused == outcomes.len() && written.min(refused) as f64 >= least
}

fn main() -> ExitCode {
    match options().and_then(|options| judge(&options)) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::from(2)
        }
    }
}

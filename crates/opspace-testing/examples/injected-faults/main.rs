//! Judgement of `opspace check`: good tasks with injected faults, whose codes it must name, and good tasks, which it must not accuse.
//!
//! ```text
//! cargo run --release -p opspace-testing --example injected-faults -- FAULTS PAIRS GOOD SEED [FALSE] [PROGRAM]
//! ```
//!
//! FAULTS tasks have one fault each, of the kinds of [`fault::KINDS`] in turn; PAIRS have two, and GOOD have none. Each task is drawn, run
//! in simulation, and used only if its runs are good: completed, without a failure or a note, also if the gains of the drives are a
//! tenth higher than stated. The diagnostics are those of the library, with that of the gain margin, or those that `PROGRAM check` prints:
//! it simulates elastic gears and impedances, too, and takes some seconds a task. A fault counts as named if a diagnostic has the code that [`fault::Kind::code`] states. The program fails if less than 93 % of the faults are named, less than 72 % of one kind, or if
//! more than FALSE good tasks (2 % if it is not given) have a diagnostic.

#![expect(clippy::print_stdout, reason = "a program for the terminal")]

mod arms;
mod fault;
mod good;

use fault::{KINDS, Kind};
use good::Drawn;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

/// Share of the faults, and of those of one kind, that must be named.
const NAMED: f64 = 0.93;
const NAMED_OF_KIND: f64 = 0.72;

/// Share of the good tasks that may be accused.
const ACCUSED: f64 = 0.02;

/// Number of tasks that are drawn until one is good.
const DRAWS: u64 = 20;

/// Judged task.
struct Case {
    /// Number of the case, and the kinds of its faults.
    number: usize,
    kinds: Vec<Kind>,
    /// Description of the task, codes of its diagnostics, and number of tasks that were drawn.
    name: String,
    codes: Vec<String>,
    draws: u64,
}

impl Case {
    fn new(number: usize, seed: u64, kinds: Vec<Kind>, program: Option<&Path>) -> Self {
        for draws in 1..=DRAWS {
            let mixed = seed.wrapping_mul(0x9e37_79b9).wrapping_add(1000 * number as u64 + draws);
            let random = &mut ChaCha8Rng::seed_from_u64(mixed);
            let base = kinds.first().and_then(|kind| kind.base());
            let mut drawn = Drawn::new(base, random);
            if !drawn.runs_well() {
                continue;
            }
            for kind in &kinds {
                kind.inject(&mut drawn, random);
            }
            // Some arms bear a slow interface.
            if kinds.contains(&Kind::SlowInterface) && drawn.runs_well() {
                continue;
            }
            if let Ok(folder) = std::env::var("FAULTS_LOG") {
                drawn.write(&folder, number);
            }
            let codes = program.map_or_else(|| drawn.codes(), |program| drawn.codes_of(program));
            return Self { number, kinds, name: drawn.name(), codes, draws };
        }
        panic!("case {number}: {DRAWS} tasks were drawn, and none runs well");
    }

    fn names(&self, kind: Kind) -> bool {
        self.codes.iter().any(|code| code == kind.code().name())
    }

    fn line(&self) -> String {
        let kinds: Vec<String> = self.kinds.iter().map(|kind| format!("{kind:?}")).collect();
        let result = match self.kinds.iter().filter(|kind| self.names(**kind)).count() {
            0 if self.kinds.is_empty() && self.codes.is_empty() => "good   ",
            0 if self.kinds.is_empty() => "ACCUSED",
            named if named == self.kinds.len() => "named  ",
            _ => "MISSED ",
        };
        format!(
            "{:3} {result} {:34} {:44} {}",
            self.number,
            kinds.join(" + "),
            self.name,
            self.codes.join(", ")
        )
    }
}

/// Cases, computed on all cores, in their order.
fn judged(kinds: &[Vec<Kind>], seed: u64, program: Option<&Path>) -> Vec<Case> {
    let next = AtomicUsize::new(0);
    let work = || {
        let mut found = Vec::new();
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            let Some(kinds) = kinds.get(number) else { return found };
            found.push(Case::new(number, seed, kinds.clone(), program));
        }
    };
    let threads = thread::available_parallelism().map_or(1, usize::from);
    let mut cases: Vec<Case> = thread::scope(|scope| {
        let running: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        running.into_iter().flat_map(|thread| thread.join().expect("a thread")).collect()
    });
    cases.sort_by_key(|case| case.number);
    cases
}

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let numbers: Vec<u64> = words.iter().filter_map(|word| word.parse().ok()).collect();
    let [faults, pairs, good, seed, ..] = numbers[..] else {
        panic!("FAULTS PAIRS GOOD SEED [FALSE] [PROGRAM]")
    };
    let program = words.iter().find(|word| word.parse::<u64>().is_err()).map(PathBuf::from);
    let random = &mut ChaCha8Rng::seed_from_u64(seed);
    let single = (0..faults as usize).map(|number| vec![KINDS[number % KINDS.len()]]);
    let pair = |number: usize| {
        let first = KINDS[number % KINDS.len()];
        let others = first.companions();
        vec![first, others[random.random_range(0..others.len())]]
    };
    let mut all: Vec<Vec<Kind>> = single.collect();
    all.extend((0..pairs as usize).map(pair));
    all.extend((0..good).map(|_| Vec::new()));
    let cases = judged(&all, seed, program.as_deref());
    cases.iter().for_each(|case| println!("{}", case.line()));

    let of = |faults: usize| cases.iter().filter(move |case| case.kinds.len() == faults);
    let mut counts: BTreeMap<Kind, [usize; 2]> = BTreeMap::new();
    for case in of(1) {
        let count = counts.entry(case.kinds[0]).or_default();
        count[0] += usize::from(case.names(case.kinds[0]));
        count[1] += 1;
    }
    println!("\nkind                 named  of  code");
    for (kind, [named, of]) in &counts {
        println!("{:20} {named:5} {of:3}  {}", format!("{kind:?}"), kind.code());
    }
    let named = counts.values().map(|count| count[0]).sum::<usize>();
    let pair_names = |least: usize| {
        of(2).filter(|case| case.kinds.iter().filter(|kind| case.names(**kind)).count() >= least).count()
    };
    let accused = of(0).filter(|case| !case.codes.is_empty()).count();
    let others =
        of(1).filter(|case| case.codes.iter().any(|code| code != case.kinds[0].code().name())).count();
    println!(
        "seed {seed}: {named} of {faults} faults are named, {others} tasks have other codes too; of {pairs} pairs, {} have both named, {} one; \
         {accused} of {good} good tasks are accused; {} tasks were drawn for {}",
        pair_names(2),
        pair_names(1) - pair_names(2),
        cases.iter().map(|case| case.draws).sum::<u64>(),
        cases.len(),
    );
    let allowed = numbers.get(4).map_or(ACCUSED * good as f64, |allowed| *allowed as f64);
    let each = counts.values().all(|[named, of]| *named as f64 >= NAMED_OF_KIND * *of as f64);
    let passes = each && named as f64 >= NAMED * faults as f64 && accused as f64 <= allowed;
    if passes { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

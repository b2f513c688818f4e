//! Identifications of single joints with random truths: how many 95 % intervals hold the truth, and how wide they are.
//!
//! ```text
//! cargo run --release -p opspace-identify --example random-joints -- [CASES [SEED [KIND]]]
//! ```
//!
//! (the seed is drawn and printed if it is absent) prints a line per case and a line per quantity. KIND is `current`
//! (default), `no-current`, `late` and `late-no-current` with delays of up to eight interface cycles, or an error of the declaration: `torque-scale-high`, `torque-scale-low`, `inertia`,
//! `short-motion`; or a structure: `feed-forward`, `setpoint-filter`.

#![expect(clippy::print_stdout, reason = "a program for the terminal")]

mod cases;
mod tally;

use cases::{Case, Deceit, Kind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::{SystemTime, UNIX_EPOCH};
use tally::{Outcome, summary};

/// Longest delay of setpoints of the late kinds, interface cycles.
const LONGEST_DELAY_CYCLES: u32 = 8;

fn kind(name: &str) -> Kind {
    let of = |deceit: Deceit| Kind { deceit, ..Kind::default() };
    match name {
        "current" => Kind::default(),
        "late" => Kind { longest_delay_cycles: Some(LONGEST_DELAY_CYCLES), ..Kind::default() },
        "late-no-current" => Kind {
            without_current: true,
            longest_delay_cycles: Some(LONGEST_DELAY_CYCLES),
            ..Kind::default()
        },
        "no-current" => Kind { without_current: true, ..Kind::default() },
        "torque-scale-high" => of(Deceit { current_scale: Some(1.25), ..Deceit::default() }),
        "torque-scale-low" => of(Deceit { current_scale: Some(0.75), ..Deceit::default() }),
        "inertia" => of(Deceit { inertia: Some(0.5), ..Deceit::default() }),
        "short-motion" => of(Deceit { speed_limit: Some(0.1), ..Deceit::default() }),
        "feed-forward" => of(Deceit { feed_forward: Some(0.7), ..Deceit::default() }),
        "setpoint-filter" => of(Deceit { setpoint_filter_hz: Some(20.0), ..Deceit::default() }),
        other => panic!("no kind '{other}'"),
    }
}

fn outcomes(cases: usize, seed: u64, kind: Kind) -> Vec<Outcome> {
    let next = AtomicUsize::new(0);
    let work = || {
        let mut found = Vec::new();
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= cases {
                return found;
            }
            let case = Case::new(number, seed, kind);
            found.push(Outcome::new(number, &case, &case.identify()));
        }
    };
    let threads = thread::available_parallelism().map_or(1, usize::from);
    let mut all: Vec<Outcome> = thread::scope(|scope| {
        let running: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        running.into_iter().flat_map(|thread| thread.join().expect("a thread")).collect()
    });
    all.sort_by_key(|outcome| outcome.number);
    all
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |at: usize| arguments.get(at).map(|text| text.parse::<u64>().expect("a number"));
    let cases = number(0).unwrap_or(100) as usize;
    let seed = number(1).unwrap_or_else(|| {
        u64::from(SystemTime::now().duration_since(UNIX_EPOCH).expect("a clock").subsec_micros())
    });
    let name = arguments.get(2).map_or("current", String::as_str);
    let all = outcomes(cases, seed, kind(name));
    all.iter().for_each(|outcome| println!("{outcome}"));
    println!("\n{cases} cases, seed {seed}, {name}");
    println!("{}", summary(&all));
}

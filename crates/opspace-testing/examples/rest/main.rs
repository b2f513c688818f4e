//! Motion of arms at goals that they cannot reach, after they had time to come to rest.
//!
//! ```text
//! cargo run --release -p opspace-testing --example rest -- [CASES [SEED [ALLOWED [CASE ...]]]]
//! ```
//!
//! (the seed is drawn and printed if it is absent; with numbers of cases, only these run) prints a line per case: true speed and mean torque rate at the end at an unreachable goal, the remaining error with
//! what a descent from there still gains, and speed and torque rate of the same arm at a reachable goal. A case counts
//! as restless if its speed is above 1e-3 rad/s and above twice that at the reachable goal, or likewise for the torque
//! rate and 1 % of the torque limit per second. Noise causes torques in proportion to the inertia, which depends on the
//! pose: for a restless case, a second line compares it with the same arm whose goal is where it ended. If more than ALLOWED cases are restless, or one stops with a fault, the
//! program fails.
//!
//! With `brisk` before the numbers, it compares brisk motion of position robots on elastic gears with that of torque
//! robots: see [`brisk`]. With `brisk uncertain`, the position robots do not measure current, and their gains are wrong by as much as
//! their files state.

#![expect(clippy::print_stdout, reason = "a program for the terminal")]

mod arms;
mod brisk;
mod cases;
mod outcome;
mod search;

use brisk::Compared;
use cases::{Case, GoalKind};
use outcome::Outcome;
use std::process::ExitCode;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::{SystemTime, UNIX_EPOCH};

/// A case and its outcomes.
struct Line {
    number: usize,
    name: String,
    far: Outcome,
    near: Outcome,
    /// With the pose at the end of `far` as the goal, if it is restless.
    there: Option<Outcome>,
}

impl Line {
    fn of(number: usize, seed: u64) -> Self {
        let case = Case::new(number, seed);
        let far = Outcome::of(&case, &GoalKind::Unreachable);
        let near = Outcome::of(&case, &GoalKind::Reachable);
        let there = (!far.rests(&near)).then(|| Outcome::of(&case, &GoalKind::At(far.end.clone())));
        Self { number, name: case.describe(), far, near, there }
    }
}

/// Results of all cases, computed on all cores, in their order.
fn outcomes<T: Send>(cases: &[usize], of: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let next = AtomicUsize::new(0);
    let work = || {
        let mut found = Vec::new();
        loop {
            let place = next.fetch_add(1, Ordering::Relaxed);
            let Some(&number) = cases.get(place) else { return found };
            found.push((place, of(number)));
        }
    };
    let threads = thread::available_parallelism().map_or(1, usize::from);
    let mut results: Vec<(usize, T)> = thread::scope(|scope| {
        let running: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        running.into_iter().flat_map(|thread| thread.join().expect("a thread")).collect()
    });
    results.sort_by_key(|(place, _)| *place);
    results.into_iter().map(|(_, result)| result).collect()
}

/// Compares brisk motion of position robots on elastic gears with that of torque robots.
///
/// Fails if one is stopped or exceeds a limit that the torque robot keeps, or if more than `allowed` do not come to rest.
fn brisk(cases: &[usize], seed: u64, allowed: usize, is_uncertain: bool) -> ExitCode {
    let all = outcomes(cases, |number| Compared::of(number, seed, is_uncertain));
    all.iter().for_each(|goal| println!("{}", goal.line));
    let count = |is: fn(&Compared) -> bool| all.iter().filter(|goal| is(goal)).count();
    let (stopped, crosses) = (count(|goal| goal.is_stopped), count(|goal| goal.crosses));
    let moves = count(|goal| goal.moves);
    println!(
        "seed {seed}: of {} goals, where the torque robot does not, {stopped} are stopped, {crosses} cross a limit, \
         {moves} do not come to rest",
        all.len()
    );
    if stopped + crosses == 0 && moves <= allowed { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1).peekable();
    let is_brisk = arguments.next_if_eq("brisk").is_some();
    let is_uncertain = arguments.next_if_eq("uncertain").is_some();
    let mut arguments = arguments.map(|argument| argument.parse::<u64>().expect("a number"));
    let cases = arguments.next().unwrap_or(60) as usize;
    let seed = arguments.next().unwrap_or_else(|| {
        u64::from(SystemTime::now().duration_since(UNIX_EPOCH).expect("a clock").subsec_micros())
    });
    let allowed = arguments.next().map_or(cases, |allowed| allowed as usize);
    println!("seed {seed}");
    let chosen: Vec<usize> = arguments.map(|number| number as usize).collect();
    let all: Vec<usize> = (0..cases).collect();
    let chosen = if chosen.is_empty() { &all } else { &chosen };
    if is_brisk {
        return brisk(chosen, seed, allowed, is_uncertain);
    }
    let lines = outcomes(chosen, |number| Line::of(number, seed));
    let (mut restless, mut still, mut faults) = (0, 0, 0);
    for Line { number, name, far, near, there } in &lines {
        faults += usize::from(far.fault.is_some() || near.fault.is_some());
        println!("{number:3} {} {name:50} {far} | {near}", if there.is_none() { "rests" } else { "MOVES" });
        if let Some(there) = there {
            restless += 1;
            still += usize::from(far.rests(there));
            println!(
                "    {} as at a goal where it ended: {there}",
                if far.rests(there) { "rests" } else { "MOVES" }
            );
        }
    }
    println!(
        "seed {seed}: {restless} of {} do not come to rest ({still} do as at a goal where they ended), {faults} stop",
        lines.len()
    );
    if restless > allowed || faults > 0 { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}

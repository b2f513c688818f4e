//! Timing of the benches that are compared with peers, by the same method as the peers.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

/// Number of random states that a bench cycles over.
pub const STATES: usize = 1024;
/// Number of repetitions, of which the median counts.
pub const REPETITIONS: usize = 15;
/// Number of calls in each repetition.
pub const CALLS: usize = 10_000;

/// Median over the repetitions of the mean duration of a call, ns.
pub fn time(calls: usize, mut call: impl FnMut(usize)) -> f64 {
    let mut means: Vec<f64> = (0..=REPETITIONS)
        .map(|_| {
            let start = Instant::now();
            (0..calls).for_each(|i| call(i % STATES));
            start.elapsed().as_secs_f64() * 1e9 / calls as f64
        })
        // The first warms up.
        .skip(1)
        .collect();
    means.sort_by(f64::total_cmp);
    means[REPETITIONS / 2]
}

/// Runs a peer and returns the rows that it prints: `name number`.
pub fn measure_peer(peer: &Path, urdf: &Path, tip: &str) -> BTreeMap<String, f64> {
    let out = Command::new(peer).arg(urdf).arg(tip).output().expect("the peer runs");
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let text = String::from_utf8(out.stdout).expect("it prints text");
    let line = |line: &str| {
        let (name, ns) = line.split_once(' ')?;
        Some((name.to_owned(), ns.trim().parse().ok()?))
    };
    text.lines().filter_map(line).collect()
}

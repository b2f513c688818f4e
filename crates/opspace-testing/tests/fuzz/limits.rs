//! Limits of one input, which hold for every target: no panic, a duration and an amount of memory.

use opspace_testing::allocation::most_held;
use std::fs;
use std::io::Write;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{LazyLock, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Longest duration of one input: many times that of the slowest one, because other programs may run.
const LONGEST: Duration = Duration::from_secs(60);

/// Target with the counts of its inputs.
pub struct Target {
    name: &'static str,
    /// Most memory that one input may need, bytes.
    most_bytes: usize,
    begun: Instant,
    inputs: AtomicU64,
    accepted: AtomicU64,
    slowest_us: AtomicU64,
    held_bytes: AtomicU64,
}

impl Target {
    /// Returns a target; one input may need `most_bytes` of memory.
    pub fn new(name: &'static str, most_bytes: usize) -> Self {
        Self {
            name,
            most_bytes,
            begun: Instant::now(),
            inputs: AtomicU64::new(0),
            accepted: AtomicU64::new(0),
            slowest_us: AtomicU64::new(0),
            held_bytes: AtomicU64::new(0),
        }
    }

    /// Runs the checks of an input, which return true if the reader accepts it. If they fail, or do not end, the input
    /// is written to the folder of temporary files. A seed without edits must be accepted.
    pub fn check(&self, input: &[u8], is_seed: bool, checks: impl FnOnce() -> bool) {
        let job = Job::begin(self.name, input);
        let begun = Instant::now();
        let (accepted, held) = most_held(checks);
        let duration = begun.elapsed();
        assert!(accepted || !is_seed, "a seed is refused");
        assert!(held <= self.most_bytes, "{held} bytes of memory for an input of {} bytes", input.len());
        drop(job);
        self.inputs.fetch_add(1, Ordering::Relaxed);
        self.accepted.fetch_add(accepted.into(), Ordering::Relaxed);
        self.slowest_us.fetch_max(duration.as_micros().try_into().unwrap_or(u64::MAX), Ordering::Relaxed);
        self.held_bytes.fetch_max(held as u64, Ordering::Relaxed);
    }
}

impl Drop for Target {
    /// Prints the counts.
    fn drop(&mut self) {
        let get = |count: &AtomicU64| count.load(Ordering::Relaxed);
        let (inputs, accepted) = (get(&self.inputs), get(&self.accepted));
        let _ = writeln!(
            std::io::stderr(),
            "fuzz {}: {inputs} inputs in {:.0} s, {} % accepted; slowest {:.1} ms, most memory {:.1} MB",
            self.name,
            self.begun.elapsed().as_secs_f64(),
            100 * accepted / inputs.max(1),
            get(&self.slowest_us) as f64 * 1e-3,
            get(&self.held_bytes) as f64 * 1e-6,
        );
    }
}

/// Inputs that are being checked.
static RUNNING: Mutex<Vec<Running>> = Mutex::new(Vec::new());

struct Running {
    number: u64,
    name: &'static str,
    input: Vec<u8>,
    begun: Instant,
}

/// Entry of an input in [`RUNNING`].
struct Job(u64);

impl Job {
    fn begin(name: &'static str, input: &[u8]) -> Self {
        static WATCH: LazyLock<()> = LazyLock::new(|| {
            std::thread::spawn(watch);
        });
        static NUMBER: AtomicU64 = AtomicU64::new(0);
        LazyLock::force(&WATCH);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let running = Running { number, name, input: input.to_vec(), begun: Instant::now() };
        RUNNING.lock().unwrap_or_else(PoisonError::into_inner).push(running);
        Self(number)
    }
}

impl Drop for Job {
    fn drop(&mut self) {
        let mut all = RUNNING.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(place) = all.iter().position(|running| running.number == self.0) {
            let running = all.swap_remove(place);
            if std::thread::panicking() {
                running.save();
            }
        }
    }
}

impl Running {
    fn save(&self) -> PathBuf {
        let path = std::env::temp_dir().join(format!("opspace-fuzz-{}.input", self.name));
        let _ = fs::write(&path, &self.input);
        path
    }
}

/// Ends the process if an input takes too long: an endless loop cannot be ended otherwise.
fn watch() {
    loop {
        std::thread::sleep(Duration::from_secs(1));
        let all = RUNNING.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(running) = all.iter().find(|running| running.begun.elapsed() > LONGEST) {
            let (name, path) = (running.name, running.save());
            let text = format!("fuzz {name}: no end after {LONGEST:?}; the input is in {}\n", path.display());
            let _ = std::io::stderr().write_all(text.as_bytes());
            std::process::abort();
        }
    }
}

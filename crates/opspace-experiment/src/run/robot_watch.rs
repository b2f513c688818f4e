//! Watch on real robots that are driven, in a thread of its own: a call of a driver that does not return.

use crate::run::execute::Progress;
use crate::run::experiment::Experiment;
use crate::run::scenario::Scenario;
use opspace_backend::{Backend, RemoteStop, World};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Time without a cycle, beyond the period, after which a robot whose stop was requested is stopped from here, s.
const GRACE_S: f64 = 0.1;
/// Further time without a cycle after which the blocked call is left behind, s: a robot that answers before is still stopped
/// by its driver.
const GIVE_UP_S: f64 = 3.0;
/// Time between two looks: a tenth of [`GRACE_S`].
const LOOK: Duration = Duration::from_millis(10);

/// Watch on the robots of a scenario.
pub struct RobotWatch<'a> {
    progress: &'a Progress,
    stops: Vec<RemoteStop>,
    period_s: f64,
    /// Longest time without a sample that is tolerated, s.
    max_dropout_s: f64,
}

impl<'a> RobotWatch<'a> {
    /// Returns the watch on these robots of the scenario, in their order; `None` if all are simulated.
    pub fn new(scenario: &Scenario, robots: &[&mut dyn Backend], progress: &'a Progress) -> Option<Self> {
        if robots.iter().all(|robot| robot.capabilities().world == World::Simulated) {
            return None;
        }
        let longest = |value: fn(&Experiment) -> f64| scenario.experiments().map(value).fold(0.0, f64::max);
        Some(Self {
            progress,
            stops: robots.iter().filter_map(|robot| robot.remote_stop()).collect(),
            period_s: longest(|experiment| experiment.profile().1.period_s()),
            max_dropout_s: longest(|experiment| experiment.robot().file.safety.max_dropout_s.get()),
        })
    }

    /// Watches the robots until they are `done`, and calls their remote stops if no cycle is completed: for longer than the
    /// longest dropout that robot.toml tolerates, or than 0.1 s if a stop was requested. Returns the time without a cycle, s,
    /// if that does not help.
    pub fn watch(mut self, done: &AtomicBool) -> Option<f64> {
        let (mut ticks, mut since) = (self.ticks(), Instant::now());
        let mut is_silent = false;
        while !done.load(Ordering::Acquire) {
            thread::park_timeout(LOOK);
            if self.ticks() != ticks {
                (ticks, since) = (self.ticks(), Instant::now());
                continue;
            }
            let beyond_s = since.elapsed().as_secs_f64() - self.longest_silence_s();
            if beyond_s > 0.0 && !is_silent {
                is_silent = true;
                self.stop();
            }
            let aborts = self.progress.abort.load(Ordering::Relaxed);
            if beyond_s > if aborts { GRACE_S } else { GIVE_UP_S } {
                return Some(since.elapsed().as_secs_f64()).filter(|_| !done.load(Ordering::Acquire));
            }
        }
        None
    }

    fn ticks(&self) -> u64 {
        self.progress.ticks.load(Ordering::Relaxed)
    }

    /// Longest time without a cycle after which nothing is done, s.
    fn longest_silence_s(&self) -> f64 {
        let stops = self.progress.interrupt.load(Ordering::Relaxed);
        self.period_s + GRACE_S + if stops { 0.0 } else { self.max_dropout_s }
    }

    /// Calls the remote stops. A panic of one of them does not keep the others from being called.
    fn stop(&mut self) {
        for stop in &mut self.stops {
            // Whether it helped shows in the cycles.
            let _ = catch_unwind(AssertUnwindSafe(stop));
        }
    }
}

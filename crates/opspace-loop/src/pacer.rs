//! Execution of cycles in real time, for a simulation that somebody watches or a robot whose driver does not wait.
//!
//! A [`Pacer`] sleeps between two cycles until the next one is due on a steady clock; [`PaceControl`] sets speed and pause from another
//! thread. Call [`Pacer::wait`] in the function `before` of [`drive_with`](crate::drive_with).

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Delay after which lost time is not caught up, s: the cycles continue from there at their rate.
const LONGEST_CATCH_UP_S: f64 = 0.1;

/// Longest sleep before speed, pause and the end are read again, s.
const LONGEST_SLEEP_S: f64 = 2e-3;

/// Clock that never goes back.
pub trait SteadyClock {
    /// Returns the time since some moment, s.
    fn now_s(&mut self) -> f64;

    /// Sleeps for a duration (s), or somewhat longer.
    fn sleep(&mut self, duration_s: f64);
}

/// Steady clock of the computer.
#[derive(Clone, Copy, Debug)]
pub struct SystemClock(Instant);

impl Default for SystemClock {
    fn default() -> Self {
        Self(Instant::now())
    }
}

impl SteadyClock for SystemClock {
    fn now_s(&mut self) -> f64 {
        self.0.elapsed().as_secs_f64()
    }

    fn sleep(&mut self, duration_s: f64) {
        thread::sleep(Duration::from_secs_f64(duration_s));
    }
}

/// Speed and pause of cycles, set from any thread, and the count of late ones.
#[derive(Debug)]
pub struct PaceControl {
    is_paused: AtomicBool,
    /// Bits of the speed.
    speed: AtomicU64,
    steps: AtomicU32,
    late: AtomicU64,
}

impl Default for PaceControl {
    fn default() -> Self {
        Self {
            is_paused: AtomicBool::new(false),
            speed: AtomicU64::new(1.0_f64.to_bits()),
            steps: AtomicU32::new(0),
            late: AtomicU64::new(0),
        }
    }
}

impl PaceControl {
    /// Pauses or continues.
    pub fn set_paused(&self, is_paused: bool) {
        self.is_paused.store(is_paused, Ordering::Relaxed);
    }

    /// True while paused.
    #[must_use]
    pub fn is_paused(&self) -> bool {
        self.is_paused.load(Ordering::Relaxed)
    }

    /// Sets the ratio of robot time to time. Values that are not positive and finite are ignored.
    pub fn set_speed(&self, speed: f64) {
        if speed > 0.0 && speed.is_finite() {
            self.speed.store(speed.to_bits(), Ordering::Relaxed);
        }
    }

    /// Ratio of robot time to time.
    #[must_use]
    pub fn speed(&self) -> f64 {
        f64::from_bits(self.speed.load(Ordering::Relaxed))
    }

    /// Lets the cycles of one more time pass while paused.
    pub fn step(&self) {
        if self.is_paused() {
            self.steps.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Number of cycles so far that began later than they should by more than a period.
    #[must_use]
    pub fn late_cycles(&self) -> u64 {
        self.late.load(Ordering::Relaxed)
    }

    /// Takes one of the requested steps, if there is one.
    fn take_step(&self) -> bool {
        let less = |steps: u32| steps.checked_sub(1);
        self.steps.try_update(Ordering::Relaxed, Ordering::Relaxed, less).is_ok()
    }
}

/// Delays cycles until they are due.
#[derive(Debug)]
pub struct Pacer<C = SystemClock> {
    clock: C,
    control: Arc<PaceControl>,
    period_s: f64,
    start: Option<Start>,
    /// Time of the cycles that a step lets pass, s.
    stepped_s: f64,
    late_s: f64,
}

/// Moment from which the times of cycles are counted.
#[derive(Clone, Copy, Debug)]
struct Start {
    clock_s: f64,
    robot_s: f64,
    speed: f64,
}

impl Pacer {
    /// Returns a pacer of cycles with a period (s), of several robots the shortest one.
    #[must_use]
    pub fn new(control: Arc<PaceControl>, period_s: f64) -> Self {
        Self::with_clock(SystemClock::default(), control, period_s)
    }
}

impl<C: SteadyClock> Pacer<C> {
    /// Returns a pacer as [`new`](Pacer::new) does, on this clock.
    #[must_use]
    pub fn with_clock(clock: C, control: Arc<PaceControl>, period_s: f64) -> Self {
        Self { clock, control, period_s, start: None, stepped_s: f64::NEG_INFINITY, late_s: 0.0 }
    }

    /// Waits until the cycle at `time_s` (s, on the clock of the robots) is due. `is_over` is called every few milliseconds meanwhile;
    /// returns false once it is true.
    pub fn wait(&mut self, time_s: f64, is_over: &mut dyn FnMut() -> bool) -> bool {
        loop {
            if is_over() {
                return false;
            }
            if self.control.is_paused() {
                self.start = None;
                if time_s <= self.stepped_s {
                    return true;
                }
                if self.control.take_step() {
                    self.stepped_s = time_s;
                    return true;
                }
                self.clock.sleep(LONGEST_SLEEP_S);
                continue;
            }
            let left_s = self.left_s(time_s);
            if left_s <= 0.0 {
                self.count(-left_s, time_s);
                return true;
            }
            self.clock.sleep(left_s.min(LONGEST_SLEEP_S));
        }
    }

    /// Time by which the last cycle began later than it should, s.
    #[must_use]
    pub fn late_s(&self) -> f64 {
        self.late_s
    }

    /// Counts time from the next cycle on, whatever its time: for cycles that jump to another time.
    pub fn restart(&mut self) {
        self.start = None;
        self.stepped_s = f64::NEG_INFINITY;
    }

    /// Time until a cycle is due, s; negative if it is late.
    fn left_s(&mut self, time_s: f64) -> f64 {
        let (clock_s, speed) = (self.clock.now_s(), self.control.speed());
        let now = Start { clock_s, robot_s: time_s, speed };
        let start = self.start.filter(|start| start.speed == speed).unwrap_or(now);
        self.start = Some(start);
        start.clock_s + (time_s - start.robot_s) / speed - clock_s
    }

    /// Counts a cycle that is late by `late_s` (s), and gives up time that would take too long to catch up.
    fn count(&mut self, late_s: f64, time_s: f64) {
        self.late_s = late_s;
        if late_s > self.period_s / self.control.speed() {
            self.control.late.fetch_add(1, Ordering::Relaxed);
        }
        if late_s > LONGEST_CATCH_UP_S {
            let (clock_s, speed) = (self.clock.now_s(), self.control.speed());
            self.start = Some(Start { clock_s, robot_s: time_s, speed });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;
    use std::rc::Rc;

    /// Clock that only sleeps, and stalls, advance.
    #[derive(Clone, Debug, Default)]
    struct Simulated(Rc<Cell<f64>>);

    impl SteadyClock for Simulated {
        fn now_s(&mut self) -> f64 {
            self.0.get()
        }

        fn sleep(&mut self, duration_s: f64) {
            self.0.set(self.0.get() + duration_s);
        }
    }

    fn pacer() -> (Pacer<Simulated>, Simulated, Arc<PaceControl>) {
        let (clock, control) = (Simulated::default(), Arc::new(PaceControl::default()));
        clock.0.set(100.0);
        (Pacer::with_clock(clock.clone(), Arc::clone(&control), 1e-3), clock, control)
    }

    fn never() -> bool {
        false
    }

    /// Compared: the times at which cycles begin, and their times on the robots' clock divided by the speed.
    #[test]
    fn cycles_begin_when_they_are_due() {
        let (mut pacer, clock, control) = pacer();
        let at = |seconds: f64| (clock.0.get() - 100.0 - seconds).abs() < 1e-9;
        for cycle in 0..=1000 {
            assert!(pacer.wait(f64::from(cycle) * 1e-3, &mut never));
            assert!(at(f64::from(cycle) * 1e-3));
        }
        control.set_speed(0.25);
        for cycle in 1001..=1101 {
            assert!(pacer.wait(f64::from(cycle) * 1e-3, &mut never));
            assert!(at(1.0 + f64::from(cycle - 1001) * 4e-3));
        }
        assert_eq!(control.late_cycles(), 0);
        for speed in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            control.set_speed(speed);
        }
        assert_eq!(control.speed(), 0.25);
    }

    /// Compared: the cycles after a short stall, which catch up, and after a long one, which continue at their rate.
    #[test]
    fn only_short_stalls_are_caught_up() {
        let (mut pacer, mut clock, control) = pacer();
        assert!(pacer.wait(0.0, &mut never));
        clock.sleep(0.01);
        for cycle in 1..=20 {
            assert!(pacer.wait(f64::from(cycle) * 1e-3, &mut never));
        }
        assert!((clock.0.get() - 100.02).abs() < 1e-9);
        // Those due 9 to 2 ms before the stall ends; the next one is late by a period, and not by more.
        let late = control.late_cycles();
        assert!((8..=9).contains(&late), "{late}");
        clock.sleep(5.0);
        for cycle in 21..=41 {
            assert!(pacer.wait(f64::from(cycle) * 1e-3, &mut never));
        }
        assert!((clock.0.get() - 105.04).abs() < 1e-9);
        assert_eq!(control.late_cycles(), late + 1);
    }

    /// While paused, a step lets the cycles of one time pass, of all robots; the end is seen.
    #[test]
    fn pause_steps_and_ends() {
        let (mut pacer, clock, control) = pacer();
        control.set_paused(true);
        control.step();
        assert!(pacer.wait(0.0, &mut never) && pacer.wait(0.0, &mut never));
        let mut calls = 0;
        let mut is_over = || {
            calls += 1;
            calls > 3
        };
        assert!(!pacer.wait(1e-3, &mut is_over));
        control.set_paused(false);
        control.step();
        let resumed = clock.0.get();
        assert!(pacer.wait(1e-3, &mut never) && pacer.wait(2e-3, &mut never));
        assert!((clock.0.get() - resumed - 1e-3).abs() < 1e-9);
        assert_eq!(control.late_cycles(), 0);
    }
}

//! Clocks of a simulation: physics steps, ticks of the simulation, servo ticks and interface cycles.

use crate::error::SimulationError;

/// Largest number of physics steps per tick of the simulation; more indicates a wrong rate and would take too long.
const MAX_STEPS: f64 = 10_000.0;

/// Timing of one arm: periods, delays and counters since the start.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Timing {
    pub servo_period_s: f64,
    /// Servo ticks per interface cycle.
    pub servo_ticks_per_cycle: u32,
    /// Delay from the cycle at which a command is written until it acts, in servo ticks.
    pub delay: u32,
    /// Number of servo ticks until the controller starts.
    pub rest_ticks: f64,
    /// Number of servo ticks begun so far.
    pub servo_tick: u64,
    /// Number of interface cycles begun so far.
    pub cycles: u64,
    /// Ticks of the simulation per servo tick.
    pub ticks_per_servo: u64,
    /// Physics steps per servo tick.
    pub steps_per_servo: u32,
}

impl Timing {
    /// Largest number of commands that do not act yet, if each acts up to `jitter` servo ticks later than the delay, less than a
    /// cycle.
    pub fn most_pending(&self, jitter: u32) -> usize {
        ((self.delay + jitter) / self.servo_ticks_per_cycle + 1) as usize
    }

    /// Time of a servo tick on the robot's clock, s; the controller starts at 0.
    pub fn time_s(&self, servo_tick: u64) -> f64 {
        (servo_tick as f64 - self.rest_ticks) * self.servo_period_s
    }

    /// Time of an interface cycle on the robot's clock, s.
    pub fn cycle_time_s(&self, cycle: u64) -> f64 {
        self.time_s(cycle * u64::from(self.servo_ticks_per_cycle))
    }

    /// Tick of the simulation at which the next interface cycle begins.
    pub fn next_cycle(&self) -> u64 {
        self.cycles * u64::from(self.servo_ticks_per_cycle) * self.ticks_per_servo
    }

    /// True if a servo tick begins at this tick of the simulation.
    pub fn is_servo_tick(&self, tick: u64) -> bool {
        tick.is_multiple_of(self.ticks_per_servo)
    }
}

/// Clock that all arms of a simulation share. Every servo tick of every arm falls on a tick of the clock.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Clock {
    /// Tick rate, Hz: the least common multiple of the servo rates.
    pub rate_hz: f64,
    /// Physics rate, Hz.
    pub physics_hz: f64,
    /// Physics steps per tick.
    pub steps_per_tick: u32,
}

impl Clock {
    /// Duration of a physics step, s.
    pub fn step_s(&self) -> f64 {
        1.0 / self.rate_hz / f64::from(self.steps_per_tick)
    }

    /// Returns the clock of arms with these pairs of servo and physics rates (Hz). Physics runs at the highest physics
    /// rate.
    pub fn new(rates_hz: impl Iterator<Item = (f64, f64)>) -> Result<Self, SimulationError> {
        let (mut rate_hz, mut physics_hz) = (0.0, 0.0_f64);
        for (servo_hz, physics) in rates_hz {
            rate_hz = common_rate(rate_hz, servo_hz)?;
            physics_hz = physics_hz.max(physics);
        }
        let steps = physics_hz / rate_hz;
        if !(1.0..=MAX_STEPS).contains(&steps) || (steps - steps.round()).abs() > 1e-9 * steps {
            return Err(SimulationError::PhysicsRate { physics_hz, servo_hz: rate_hz });
        }
        Ok(Self { rate_hz, physics_hz, steps_per_tick: steps.round() as u32 })
    }

    /// Number of clock ticks per servo tick of an arm with this servo rate (Hz).
    pub fn ticks_per_servo(&self, servo_hz: f64) -> u64 {
        (self.rate_hz / servo_hz).round() as u64
    }
}

/// Returns the least common multiple of two rates (Hz); if `first_hz` is 0, returns `second_hz`.
fn common_rate(first_hz: f64, second_hz: f64) -> Result<f64, SimulationError> {
    if first_hz == 0.0 || first_hz == second_hz {
        return Ok(second_hz);
    }
    if first_hz.fract() != 0.0 || second_hz.fract() != 0.0 {
        return Err(SimulationError::ServoRates { first_hz, second_hz });
    }
    let (mut a, mut b) = (first_hz as u64, second_hz as u64);
    while b != 0 {
        (a, b) = (b, a % b);
    }
    Ok(first_hz / a as f64 * second_hz)
}

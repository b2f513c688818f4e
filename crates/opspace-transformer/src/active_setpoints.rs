//! Setpoints that act in the drives, from one interface cycle to the next.

use crate::drive_timing::DriveTiming;
use nalgebra::DVector;
use opspace_backend::CommandDelay;

/// Setpoints of the drives at the start of an interface cycle (n; rad, m or rad/s, m/s).
#[derive(Clone, Debug)]
pub(crate) struct ActiveSetpoints {
    before: DVector<f64>,
    last: DVector<f64>,
    /// Servo ticks since the last setpoint took effect.
    age: u32,
    /// Setpoints that were sent and do not act yet, the oldest first: one for each of the last cycles.
    waiting: Vec<Waiting>,
    /// Servo ticks until the oldest one acts, counted from the interface cycle; the others follow a cycle apart.
    first_acts_at: u32,
}

/// Setpoints that do not act yet.
#[derive(Clone, Debug)]
struct Waiting {
    /// False if no setpoints were sent at that cycle.
    was_sent: bool,
    setpoints: DVector<f64>,
}

impl ActiveSetpoints {
    /// Returns setpoints of zero for n joints.
    pub(crate) fn new(n: usize, ticks: DriveTiming) -> Self {
        let ratio = ticks.servo_ticks_per_cycle;
        let cycles = CommandDelay::of_ticks(ticks.delay, ratio).waiting_cycles;
        let waiting = Waiting { was_sent: false, setpoints: DVector::zeros(n) };
        Self {
            before: DVector::zeros(n),
            last: DVector::zeros(n),
            age: ratio,
            waiting: vec![waiting; cycles as usize],
            first_acts_at: ticks.delay - cycles * ratio,
        }
    }

    /// Setpoint of a joint's drive at servo tick `tick`, counted from the interface cycle, if no new one is sent.
    pub(crate) fn at(&self, ticks: DriveTiming, joint: usize, tick: u32) -> f64 {
        let ratio = ticks.servo_ticks_per_cycle;
        let at = |from: f64, to: f64, age: u32| ticks.setpoints.at(from, to, age, ratio);
        let (mut from, mut to, mut acts_at) = (self.before[joint], self.last[joint], None);
        let age = |acts_at: Option<u32>, tick: u32| match acts_at {
            Some(acts_at) => tick - acts_at,
            None => self.age.saturating_add(tick),
        };
        let mut next = self.first_acts_at;
        for waiting in &self.waiting {
            if tick < next {
                break;
            }
            if waiting.was_sent {
                // A setpoint that waits acts after one servo tick at the earliest.
                from = at(from, to, age(acts_at, next - 1));
                (to, acts_at) = (waiting.setpoints[joint], Some(next));
            }
            next += ratio;
        }
        at(from, to, age(acts_at, tick))
    }

    /// Setpoint of a joint's drive at servo tick `tick` if `new` setpoints (n) are sent at the interface cycle.
    pub(crate) fn during(&self, ticks: DriveTiming, joint: usize, tick: u32, new: Option<&[f64]>) -> f64 {
        match new {
            Some(new) if tick >= ticks.delay => ticks.setpoints.at(
                self.left(ticks, joint),
                new[joint],
                tick - ticks.delay,
                ticks.servo_ticks_per_cycle,
            ),
            _ => self.at(ticks, joint, tick),
        }
    }

    /// Setpoint from which a drive interpolates to a new one, which takes effect `delay` servo ticks after the
    /// interface cycle.
    pub(crate) fn left(&self, ticks: DriveTiming, joint: usize) -> f64 {
        self.just_before(ticks, joint, ticks.delay)
    }

    /// Setpoint at the servo tick before `tick`, of those that are sent already.
    fn just_before(&self, ticks: DriveTiming, joint: usize, tick: u32) -> f64 {
        match tick.checked_sub(1) {
            Some(tick) => self.at(ticks, joint, tick),
            None => match self.age.checked_sub(1) {
                Some(age) => {
                    let (before, last) = (self.before[joint], self.last[joint]);
                    ticks.setpoints.at(before, last, age, ticks.servo_ticks_per_cycle)
                }
                None => self.before[joint],
            },
        }
    }

    /// Advances to the next interface cycle, after `new` setpoints (n) or none were sent at this one.
    pub(crate) fn advance(&mut self, ticks: DriveTiming, new: Option<&[f64]>) {
        let acting = self.waiting.first().map_or(new.is_some(), |oldest| oldest.was_sent);
        if acting {
            for i in 0..self.last.len() {
                self.before[i] = self.just_before(ticks, i, self.first_acts_at);
            }
            match (self.waiting.first(), new) {
                (Some(oldest), _) => self.last.copy_from(&oldest.setpoints),
                (None, Some(new)) => self.last.copy_from_slice(new),
                (None, None) => {}
            }
            self.age = ticks.servo_ticks_per_cycle - self.first_acts_at;
        } else {
            self.age = self.age.saturating_add(ticks.servo_ticks_per_cycle);
        }
        if !self.waiting.is_empty() {
            self.waiting.rotate_left(1);
        }
        if let Some(latest) = self.waiting.last_mut() {
            latest.was_sent = new.is_some();
            if let Some(new) = new {
                latest.setpoints.copy_from_slice(new);
            }
        }
    }

    /// Sets the setpoint of a joint that a drive holds.
    pub(crate) fn hold(&mut self, joint: usize, setpoint: f64) {
        self.before[joint] = setpoint;
        self.last[joint] = setpoint;
    }

    /// Ends all interpolation, and drops the setpoints that do not act yet.
    pub(crate) fn settle(&mut self, ticks: DriveTiming) {
        self.age = ticks.servo_ticks_per_cycle;
        self.waiting.iter_mut().for_each(|waiting| waiting.was_sent = false);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use opspace_backend::Setpoints;

    const RATIO: u32 = 4;

    /// Setpoint of a drive at each servo tick: written cycle by cycle, some cycles without one.
    fn drive(setpoints: Setpoints, delay: u32, sent: &[Option<f64>]) -> Vec<f64> {
        let (mut from, mut to, mut acted_at, mut now) = (0.0, 0.0, None, 0.0);
        (0..sent.len() as u32 * RATIO)
            .map(|tick| {
                if let Some(since) = tick.checked_sub(delay).filter(|since| since % RATIO == 0)
                    && let Some(new) = sent[(since / RATIO) as usize]
                {
                    (from, to, acted_at) = (now, new, Some(tick));
                }
                now = acted_at.map_or(0.0, |at| setpoints.at(from, to, tick - at, RATIO));
                now
            })
            .collect()
    }

    /// Compared: setpoints that the class follows or predicts, and those of a drive written tick by tick; delays from none to three
    /// cycles, held and interpolated setpoints, cycles without a setpoint.
    #[test]
    fn setpoints_act_after_their_delay() {
        let sent: Vec<Option<f64>> = [3, 1, 0, 4, 0, 0, 0, 5, 9, 2, 6, 0, 5, 3, 5, 8]
            .map(|value| (value != 0).then_some(f64::from(value)))
            .to_vec();
        for setpoints in [Setpoints::Held, Setpoints::Interpolated] {
            for delay in 0..=3 * RATIO {
                let ticks =
                    DriveTiming { servo_period_s: 1e-3, servo_ticks_per_cycle: RATIO, delay, setpoints };
                let truth = drive(setpoints, delay, &sent);
                let mut active = ActiveSetpoints::new(1, ticks);
                for (cycle, new) in sent.iter().enumerate() {
                    let new = new.as_ref().map(std::slice::from_ref);
                    // Beyond the delay and one cycle, later setpoints would act.
                    for tick in 0..delay + RATIO {
                        let at = cycle * RATIO as usize + tick as usize;
                        let found = active.during(ticks, 0, tick, new);
                        if let Some(&expected) = truth.get(at) {
                            assert!(
                                (found - expected).abs() < 1e-12,
                                "{setpoints:?}, delay {delay}, cycle {cycle}, tick {tick}: {found} for {expected}"
                            );
                        }
                    }
                    active.advance(ticks, new);
                }
            }
        }
    }
}

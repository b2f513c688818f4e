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
    /// Setpoints from which a drive interpolates to these (n).
    before: DVector<f64>,
    setpoints: DVector<f64>,
}

impl ActiveSetpoints {
    /// Returns setpoints of zero for n joints.
    pub(crate) fn new(n: usize, ticks: DriveTiming) -> Self {
        let ratio = ticks.servo_ticks_per_cycle;
        let cycles = CommandDelay::of_ticks(ticks.delay, ratio).waiting_cycles;
        let zero = DVector::zeros(n);
        let waiting = Waiting { was_sent: false, before: zero.clone(), setpoints: zero.clone() };
        Self {
            before: zero.clone(),
            last: zero,
            age: ratio,
            waiting: vec![waiting; cycles as usize],
            first_acts_at: ticks.delay - cycles * ratio,
        }
    }

    /// Setpoint of a joint's drive at servo tick `tick`, counted from the interface cycle, if no new one is sent.
    pub(crate) fn at(&self, ticks: DriveTiming, joint: usize, tick: u32) -> f64 {
        let ratio = ticks.servo_ticks_per_cycle;
        let acting = tick.checked_sub(self.first_acts_at).map_or(0, |since| (since / ratio + 1) as usize);
        let acting = &self.waiting[..acting.min(self.waiting.len())];
        if let Some(cycle) = acting.iter().rposition(|waiting| waiting.was_sent) {
            let (latest, age) = (&acting[cycle], tick - self.first_acts_at - cycle as u32 * ratio);
            return ticks.setpoints.at(latest.before[joint], latest.setpoints[joint], age, ratio);
        }
        ticks.setpoints.at(self.before[joint], self.last[joint], self.age.saturating_add(tick), ratio)
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
        match (ticks.delay.checked_sub(1), self.age.checked_sub(1)) {
            (Some(tick), _) => self.at(ticks, joint, tick),
            (None, Some(age)) => {
                ticks.setpoints.at(self.before[joint], self.last[joint], age, ticks.servo_ticks_per_cycle)
            }
            (None, None) => self.before[joint],
        }
    }

    /// Advances to the next interface cycle, after `new` setpoints (n) or none were sent at this one.
    pub(crate) fn advance(&mut self, ticks: DriveTiming, new: Option<&[f64]>) {
        let ratio = ticks.servo_ticks_per_cycle;
        if self.waiting.is_empty() {
            self.age = match new {
                Some(new) => {
                    for (i, &setpoint) in new.iter().enumerate() {
                        self.before[i] = self.left(ticks, i);
                        self.last[i] = setpoint;
                    }
                    ratio - ticks.delay
                }
                None => self.age.saturating_add(ratio),
            };
            return;
        }
        let oldest = &mut self.waiting[0];
        if std::mem::take(&mut oldest.was_sent) {
            std::mem::swap(&mut self.before, &mut oldest.before);
            std::mem::swap(&mut self.last, &mut oldest.setpoints);
            self.age = ratio - self.first_acts_at;
        } else {
            self.age = self.age.saturating_add(ratio);
        }
        // The slot of the oldest one is that of the new one.
        self.waiting.rotate_left(1);
        let Some(new) = new else { return };
        let newest = self.waiting.len() - 1;
        for (i, &setpoint) in new.iter().enumerate() {
            self.waiting[newest].before[i] = self.at(ticks, i, ticks.delay - ratio - 1);
            self.waiting[newest].setpoints[i] = setpoint;
        }
        self.waiting[newest].was_sent = true;
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

//! Commands that act some time after they are sent.

/// Largest delay until a command acts, in interface cycles. A longer one is no control but a plan, and a mistake in a unit.
pub const MAX_DELAY_CYCLES: u32 = 32;

/// Delay until a command acts: whole cycles during which it waits, and the part of the next cycle during which the command before
/// it still acts.
///
/// A delay of d cycles waits during ⌈d⌉ − 1 cycles (none if d is 0), and then during d − (⌈d⌉ − 1) of a cycle, at most one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CommandDelay {
    /// Cycles during which the command waits.
    pub waiting_cycles: u32,
    /// Part of the next cycle at which it acts: from 0, for a command without delay, to 1.
    pub part: f64,
}

impl CommandDelay {
    /// Returns a delay of `delay` servo ticks with `ratio` servo ticks per interface cycle.
    #[must_use]
    pub fn of_ticks(delay: u32, ratio: u32) -> Self {
        let waiting_cycles = delay.div_ceil(ratio).saturating_sub(1);
        Self { waiting_cycles, part: f64::from(delay - waiting_cycles * ratio) / f64::from(ratio) }
    }

    /// Returns a delay of `delay_s` with an interface period of `period_s` (s), at most [`MAX_DELAY_CYCLES`] periods.
    #[must_use]
    pub fn of_time(delay_s: f64, period_s: f64) -> Self {
        let cycles = (delay_s / period_s).clamp(0.0, f64::from(MAX_DELAY_CYCLES));
        // A delay of whole cycles, but for rounding, is one of whole cycles.
        let whole = cycles.round();
        let cycles = if (cycles - whole).abs() < 1e-9 { whole } else { cycles };
        let waiting_cycles = (cycles.ceil() as u32).saturating_sub(1);
        Self { waiting_cycles, part: cycles - f64::from(waiting_cycles) }
    }
}

/// The last commands of n joints, from which follow those that act in the present cycle.
#[derive(Clone, Debug)]
pub struct CommandsInForce {
    delay: CommandDelay,
    /// Commands from the latest on, in the order of a ring that begins at `latest`.
    commands: Vec<Vec<f64>>,
    latest: usize,
    is_empty: bool,
}

impl CommandsInForce {
    /// Returns the commands of `n` joints: none yet, so that they are not numbers.
    #[must_use]
    pub fn new(n: usize, delay: CommandDelay) -> Self {
        let kept = delay.waiting_cycles as usize + 2;
        Self { delay, commands: vec![vec![f64::NAN; n]; kept], latest: 0, is_empty: true }
    }

    /// Forgets all commands, which are not numbers until the next one.
    pub fn clear(&mut self) {
        self.is_empty = true;
        self.commands.iter_mut().for_each(|command| command.fill(f64::NAN));
    }

    /// Adds the command (n) of the present cycle. The first one counts as that of all cycles before.
    pub fn push(&mut self, command: &[f64]) {
        let kept = self.commands.len();
        self.latest = (self.latest + kept - 1) % kept;
        self.commands[self.latest].copy_from_slice(command);
        if std::mem::take(&mut self.is_empty) {
            self.commands.iter_mut().for_each(|other| other.copy_from_slice(command));
        }
    }

    /// Adds the latest command again, which stays in force where none is sent.
    pub fn repeat(&mut self) {
        let (latest, kept) = (self.latest, self.commands.len());
        self.latest = (latest + kept - 1) % kept;
        if let Ok([to, from]) = self.commands.get_disjoint_mut([self.latest, latest]) {
            to.copy_from_slice(from);
        }
    }

    /// Number of commands that have to be known for those in force to be known.
    #[must_use]
    pub fn kept(&self) -> u32 {
        self.delay.waiting_cycles + 2
    }

    /// Commands (n) that act from the next cycle on until the command of that cycle acts, in this order, and the interface cycles
    /// during which each does.
    pub fn until_next(&self) -> impl Iterator<Item = (&[f64], f64)> {
        let kept = self.commands.len();
        (1..kept).rev().map(move |back| {
            let command = self.commands[(self.latest + back - 1) % kept].as_slice();
            (command, if back + 1 == kept { self.delay.part } else { 1.0 })
        })
    }

    /// Command (n) that begins to act in the present cycle.
    #[must_use]
    pub fn after(&self) -> &[f64] {
        &self.commands[(self.latest + self.commands.len() - 2) % self.commands.len()]
    }

    /// Command (n) that acts at the beginning of the present cycle.
    #[must_use]
    pub fn before(&self) -> &[f64] {
        &self.commands[(self.latest + self.commands.len() - 1) % self.commands.len()]
    }

    /// Mean command of a joint over the present cycle, if each is held until the next one acts.
    #[must_use]
    pub fn mean(&self, joint: usize) -> f64 {
        let (before, after) = (self.before()[joint], self.after()[joint]);
        after + self.delay.part * (before - after)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compared: the mean of held commands, and their sum tick by tick.
    #[test]
    fn mean_of_held_commands_is_that_of_all_ticks() {
        let ratio = 4;
        for delay in 0..=3 * ratio + 1 {
            let split = CommandDelay::of_ticks(delay, ratio);
            assert_eq!(split, CommandDelay::of_time(f64::from(delay) * 0.002, f64::from(ratio) * 0.002));
            let mut commands = CommandsInForce::new(1, split);
            let value = |cycle: u32| f64::from((7 * cycle) % 11);
            for cycle in 0..20 {
                commands.push(&[value(cycle)]);
                let cycles = commands.until_next().map(|(_, cycles)| cycles).sum::<f64>();
                assert!(
                    (cycles - f64::from(delay) / f64::from(ratio)).abs() < 1e-12,
                    "delay {delay}: {cycles} cycles"
                );
                // At the next cycle, before its command is sent: the commands of all ticks until it acts.
                let until: f64 = commands.until_next().map(|(command, cycles)| command[0] * cycles).sum();
                let ticks = (cycle + 1) * ratio..(cycle + 1) * ratio + delay;
                let sum: f64 = ticks.map(|tick| value(tick.saturating_sub(delay) / ratio)).sum();
                assert!(
                    (until - sum / f64::from(ratio)).abs() < 1e-12,
                    "delay {delay}, cycle {cycle}: {until}"
                );
                let ticks = cycle * ratio..(cycle + 1) * ratio;
                let sum: f64 = ticks.map(|tick| value(tick.saturating_sub(delay) / ratio)).sum();
                let mean = commands.mean(0);
                assert!(
                    (mean - sum / f64::from(ratio)).abs() < 1e-12,
                    "delay {delay}, cycle {cycle}: {mean}"
                );
            }
        }
    }

    /// Compared: commands in force after a clear, and the next command.
    #[test]
    fn first_command_counts_as_all_before() {
        let mut commands = CommandsInForce::new(2, CommandDelay::of_ticks(7, 2));
        commands.push(&[1.0, 2.0]);
        commands.clear();
        assert!(commands.mean(0).is_nan(), "no command acts");
        commands.push(&[3.0, 4.0]);
        assert_eq!([commands.mean(0), commands.mean(1)], [3.0, 4.0]);
    }
}

//! Missed cycles, resumed control and stale targets, over a whole log.

use opspace_backend::signal_names::{self, MISSED_CYCLES, PHASE, TARGET_STALE, TICK_CHANNEL};
use opspace_log::{Column, Recording};
use opspace_loop::Phase;

/// Interruptions of control so far.
#[derive(Clone, Debug, Default)]
pub(crate) struct Interruptions {
    missed: f64,
    /// Number of times that control was resumed.
    pub(crate) resumed: u64,
    /// Number of control cycles in which a streamed target of any task was stale.
    pub(crate) stale_target_cycles: u64,
    /// Number of times that the robot was held.
    pub(crate) holds: u64,
    /// Time for which the robot was held or its torques ramped in after a hold, s.
    pub(crate) interrupted_s: f64,
    /// Phase and time (s) of the cycle before.
    before: Option<[f64; 2]>,
}

impl Interruptions {
    pub(crate) fn add(&mut self, segment: &Recording) {
        let Some(tick) = segment.channel(TICK_CHANNEL) else { return };
        if let Some(missed) = tick.signal(MISSED_CYCLES) {
            self.missed += missed.rows().map(|row| row[0]).sum::<f64>();
        }
        for (phase, &time_s) in tick.signal(PHASE).into_iter().flat_map(Column::rows).zip(&tick.time_s) {
            let [before, before_s] = self.before.unwrap_or([Phase::Rest.code(), time_s]);
            let begins = |kind: Phase| u64::from(phase[0] == kind.code() && before != kind.code());
            self.resumed += begins(Phase::Resuming);
            self.holds += begins(Phase::Held);
            if Phase::is_interrupted(before) {
                self.interrupted_s += time_s - before_s;
            }
            self.before = Some([phase[0], time_s]);
        }
        let stale_of = signal_names::of("", TARGET_STALE);
        let names = tick.layout.signals.iter().map(|signal| signal.name.as_str());
        let stale: Vec<_> =
            names.filter(|name| name.ends_with(&stale_of)).filter_map(|n| tick.signal(n)).collect();
        let is_stale = |k: &usize| stale.iter().any(|stale| stale.row(*k)[0] == 1.0);
        self.stale_target_cycles += (0..tick.len()).filter(is_stale).count() as u64;
    }

    pub(crate) fn missed_cycles(&self) -> u64 {
        self.missed as u64
    }
}

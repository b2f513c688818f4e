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
    was_resuming: bool,
}

impl Interruptions {
    pub(crate) fn add(&mut self, segment: &Recording) {
        let Some(tick) = segment.channel(TICK_CHANNEL) else { return };
        if let Some(missed) = tick.signal(MISSED_CYCLES) {
            self.missed += missed.rows().map(|row| row[0]).sum::<f64>();
        }
        for phase in tick.signal(PHASE).into_iter().flat_map(Column::rows) {
            let is_resuming = phase[0] == Phase::Resuming.code();
            self.resumed += u64::from(is_resuming && !self.was_resuming);
            self.was_resuming = is_resuming;
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

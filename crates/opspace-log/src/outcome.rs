//! Outcome of a run, recorded at the end of its log.

use crate::recording::Recording;
use opspace_backend::DeviceFault;
use opspace_backend::signal_names::FAULT;
use std::collections::BTreeMap;

/// Name of the metadata record of the outcome.
pub const OUTCOME: &str = "opspace.outcome";
/// Entry with the time from which on the commands of a run on a log differ from those of the log, or [`EQUAL`].
const REPLAY: &str = "replay_commands_part_after_s";
const EQUAL: &str = "never";

/// Outcome of a run as a record of text entries.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OutcomeRecord {
    /// Cause of a fault; `None` if there was none.
    pub fault: Option<String>,
    /// True if the run was stopped on request, or finished early.
    pub interrupted: bool,
    /// Time of a fault or interruption since the start of control, s.
    pub time_s: Option<f64>,
    /// Fault as the robot reported it.
    pub device_fault: Option<DeviceFault>,
    /// Commands of a run on a log, compared with those of the log; `None` for any other robot.
    pub replay: Option<ReplayedCommands>,
    /// Scheduling of the thread that drove a real robot, and what the machine does not allow.
    pub real_time: Option<String>,
}

/// Commands of a run on a log, compared with those of the log.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ReplayedCommands {
    /// All commands are those of the log, bit for bit.
    Equal,
    /// They differ from this time on, s after the first sample of the log.
    PartAfter(f64),
}

impl OutcomeRecord {
    /// Returns the outcome in a log. A truncated log has only the fault in its last row, if there is one.
    #[must_use]
    pub fn of(recording: &Recording) -> Self {
        recording.metadata(OUTCOME).map_or_else(|| Self::of_last_row(recording), Self::of_entries)
    }

    fn of_entries(entries: &BTreeMap<String, String>) -> Self {
        let entry = |key: &str| entries.get(key);
        let device_fault = entry("device_code")
            .and_then(|code| code.parse().ok())
            .map(|code: u32| DeviceFault::new(code, entry("device_words").cloned().unwrap_or_default()));
        Self {
            fault: entry("fault").cloned(),
            interrupted: entry("outcome").is_some_and(|outcome| outcome == "interrupted"),
            time_s: entry("time_s").and_then(|time| time.parse().ok()),
            device_fault,
            replay: entry(REPLAY).and_then(|text| match text.as_str() {
                EQUAL => Some(ReplayedCommands::Equal),
                after_s => after_s.parse().ok().map(ReplayedCommands::PartAfter),
            }),
            real_time: entry("real_time").cloned(),
        }
    }

    fn of_last_row(recording: &Recording) -> Self {
        let fault = recording.channel("tick").and_then(|tick| tick.signal(FAULT));
        let last = fault.and_then(|fault| fault.rows().last());
        let code = last.and_then(|row| row.first()).copied().unwrap_or(0.0);
        let words = format!("fault {code}; the log was cut short before its cause");
        Self { fault: (code != 0.0).then_some(words), ..Self::default() }
    }

    /// Entries of the metadata record.
    pub(crate) fn entries(&self) -> BTreeMap<String, String> {
        let outcome = match (&self.fault, self.interrupted) {
            (Some(_), _) => "faulted",
            (None, true) => "interrupted",
            (None, false) => "completed",
        };
        let mut entries = BTreeMap::from([("outcome".to_owned(), outcome.to_owned())]);
        let mut put = |key: &str, value: Option<String>| {
            entries.extend(value.map(|value| (key.to_owned(), value)));
        };
        put("fault", self.fault.clone());
        put("real_time", self.real_time.clone());
        put("time_s", self.time_s.map(|time| time.to_string()));
        put("device_code", self.device_fault.as_ref().map(|fault| fault.code.to_string()));
        put("device_words", self.device_fault.as_ref().map(|fault| fault.words.to_string()));
        put(
            REPLAY,
            self.replay.map(|commands| match commands {
                ReplayedCommands::Equal => EQUAL.to_owned(),
                ReplayedCommands::PartAfter(after_s) => after_s.to_string(),
            }),
        );
        entries
    }
}

#[cfg(test)]
mod tests {
    use super::{FAULT, OutcomeRecord};
    use crate::recording::{ChannelData, Recording};
    use opspace_backend::{Layout, Signal};

    /// Checks the last row of a log without an outcome: with a fault, without one, and with a signal that has no element.
    #[test]
    fn outcome_of_a_cut_log_is_the_fault_of_its_last_row() {
        let outcome = |elements: &[&str], rows: Vec<f64>| {
            let layout =
                Layout { channel: "tick".to_owned(), signals: vec![Signal::new(FAULT, "1", elements)] };
            let tick = ChannelData { layout, time_s: vec![0.0, 0.1], rows };
            OutcomeRecord::of(&Recording { channels: vec![tick], ..Recording::default() }).fault
        };
        assert!(outcome(&["value"], vec![0.0, 3.0]).is_some_and(|fault| fault.contains("fault 3")));
        assert_eq!(outcome(&["value"], vec![3.0, 0.0]), None);
        assert_eq!(outcome(&[], vec![]), None);
    }
}

//! Findings about the interface to the robot: cycles without samples, holds, stale targets, and setpoints that were not sent or
//! not accepted as they were.

use super::interruptions::Interruptions;
use crate::codes::Code;
use crate::finding::{Finding, Place};
use crate::metrics::metric_tables::Metrics;

/// Findings about the interface in a run.
pub(super) fn interface_findings(interruptions: &Interruptions, metrics: &Metrics) -> Vec<Finding> {
    let stale = interruptions.stale_target_cycles;
    let setpoints = [
        (Code::SetpointsClamped, metrics.setpoints_clamped, "the control loop clamped"),
        (Code::SetpointsLimited, metrics.setpoints_limited, "the drives clamped or refused"),
    ];
    let of_run = |code: Code, message: String| Finding::of(code, Place::Run(()), message);
    let setpoints = setpoints.into_iter().filter_map(|(code, count, subject)| {
        let count = count.filter(|count| *count > 0)?;
        let finding = of_run(code, format!("{subject} {}", counted(count, "setpoint")));
        Some(finding.with("setpoints", Some(count as f64)))
    });
    let stale = (stale > 0).then(|| {
        let message = format!("a streamed target was stale in {}", counted(stale, "control cycle"));
        of_run(Code::StaleTargets, message).with("cycles", Some(stale as f64))
    });
    interrupted(interruptions).into_iter().chain(stale).chain(setpoints).collect()
}

fn interrupted(interruptions: &Interruptions) -> Option<Finding> {
    let (missed, holds) = (interruptions.missed_cycles(), interruptions.holds);
    let held_s = interruptions.interrupted_s;
    let cycles = (missed > 0).then(|| format!("{} had no sample", counted(missed, "interface cycle")));
    let held = (holds > 0).then(|| {
        format!(
            "the robot was held {}, for {held_s:.2} s with the torque ramps: no error of this time is in the metrics",
            counted(holds, "time")
        )
    });
    let causes: Vec<String> = cycles.into_iter().chain(held).collect();
    (!causes.is_empty()).then(|| {
        Finding::of(Code::ControlInterrupted, Place::Run(()), causes.join("; "))
            .with("missed_cycles", Some(missed as f64))
            .with("holds", Some(holds as f64))
            .with("held_s", Some(held_s))
    })
}

/// Number with its noun: `1 cycle`, `2 cycles`.
fn counted(count: u64, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

//! `opspace doctor`: what this machine lacks for real-time control, and the commands that mend it.

use crate::cli::DoctorArgs;
use crate::console::{Console, Exit, Outcome};
#[cfg(target_os = "linux")]
use crate::output::pretty;
#[cfg(target_os = "linux")]
use opspace_loop::RealTimeMode;
#[cfg(target_os = "linux")]
use opspace_setup::machine::wake_up::{self, WakeUps};
#[cfg(target_os = "linux")]
use opspace_setup::machine::{MachineFinding, examine, is_lacking};
#[cfg(target_os = "linux")]
use std::path::Path;

#[cfg(target_os = "linux")]
pub fn doctor(args: &DoctorArgs, console: Console) -> Outcome {
    let mut findings = examine(args.root.as_deref().unwrap_or(Path::new("/")));
    let mut wake_ups = Vec::new();
    if args.duration_s > 0.0 {
        console.note(&format!("measuring wake-ups for 2 × {} s", args.duration_s));
        let measure = |mode| wake_up::measure(args.duration_s, mode);
        wake_ups.extend([RealTimeMode::Off, RealTimeMode::Auto].map(measure));
        findings.extend(wake_ups.iter().map(WakeUps::finding));
    }
    let lacking = is_lacking(&findings);
    let json =
        || pretty(&serde_json::json!({ "lacking": lacking, "findings": findings, "wake_ups": wake_ups }));
    args.json.print(json, || findings.iter().map(text).collect())?;
    let verdict = if lacking { "this machine lacks what is marked `missing`" } else { "nothing is missing" };
    console.note(verdict);
    Ok(if lacking { Exit::Failed } else { Exit::Done })
}

/// Renders a finding: its verdict, and the commands below.
#[cfg(target_os = "linux")]
fn text(finding: &MachineFinding) -> String {
    let commands: String = finding.commands.iter().map(|command| format!("           {command}\n")).collect();
    format!("{:<8} {}: {}\n{commands}", finding.level.name(), finding.item, finding.text)
}

#[cfg(not(target_os = "linux"))]
pub fn doctor(_args: &DoctorArgs, _console: Console) -> Outcome {
    let text = "opspace asks for real-time scheduling on Linux only, and examines no other system".to_owned();
    Err(crate::console::Failure::Other(text, Exit::Bad))
}

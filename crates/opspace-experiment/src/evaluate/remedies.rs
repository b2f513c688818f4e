//! Remedies of findings of a run: the key or the command to try.

use crate::codes::Code;
use crate::finding::Finding;

/// Remedy of a finding of a run; empty for one that has its own.
pub(crate) fn remedy(finding: &Finding) -> &'static str {
    match finding.code {
        Code::NeverTouched => {
            "start closer to the surface or approach it for longer; `opspace check TASK` names a wrong sign of `force.target_n` and \
             objects out of reach"
        }
        Code::ContactLost => {
            "approach more slowly, or raise `force.damping_per_s`; a smaller `settle_s` shows the contact that there was"
        }
        Code::ControlInterrupted if is_requested(finding) => REQUESTED_HOLD,
        Code::CyclesMissed | Code::ControlInterrupted => {
            "`missed_cycles` in the log shows when (`opspace log export`); in simulation, `simulated.bus` of the robot loses them"
        }
        Code::JointsHeld => {
            "release the brake, raise the gains, or compensate the friction: `opspace identify ROBOT` measures it for \
             `friction_compensation.gain`"
        }
        Code::StaleTargets => "send targets more often, or raise `timeout_s` of the streamed reference",
        Code::SetpointsClamped => {
            "look for steps in the measured positions; without any, `opspace identify ROBOT` measures the gains of the servos"
        }
        Code::SetpointsLimited => {
            "declare the limits of the drives in robot.toml, so that the loop keeps to them: `setpoint_limits` of the profile"
        }
        Code::GoalNotReached | Code::ReferenceLimited => of_causes(finding),
        Code::EscapedSingularity => {
            "unless this motion is acceptable, start elsewhere (`start_rad`): `opspace check TASK` counts singular postures"
        }
        Code::DampedDirection => {
            "start elsewhere (`start_rad`), or make the axis `free`: `opspace check TASK` counts singular postures"
        }
        Code::CompliantAxesMoved => {
            "hold the axis: `motion` in place of `compliant`, with an `impedance` if it shall yield"
        }
        Code::TorquesSaturated => {
            "make the motion slower, the gains smaller or the load lighter; `torque_limit_nm` of the joint, if the robot has more"
        }
        Code::IgnoredCompliance => "`--controller osc` has it",
        _ => "",
    }
}

/// Remedy on a real robot, where it is another one.
pub(crate) fn owner_remedy(finding: &Finding) -> Option<&'static str> {
    match finding.code {
        Code::ControlInterrupted if is_requested(finding) => Some(REQUESTED_HOLD),
        Code::CyclesMissed | Code::ControlInterrupted => Some(
            "end other programs on this computer, check the cable, or lower the rate (`servo_ticks_per_cycle` of the profile); with an \
             adapter for USB, set its latency timer to 1 ms; `missed_cycles` in the log shows when (`opspace log export`)",
        ),
        _ => None,
    }
}

const REQUESTED_HOLD: &str =
    "nothing, if the hold was asked for: no sample was missing, and control resumed with the torque ramps";

/// True if the robot was held although no sample was missing.
fn is_requested(finding: &Finding) -> bool {
    finding.number("missed_cycles") == Some(0.0)
}

/// Remedy for the first cause that keeps a task from its reference.
fn of_causes(finding: &Finding) -> &'static str {
    let causes = &finding.causes;
    if finding.number("torque_ramp_s").is_some() {
        "let the reference rest during the ramp, or shorten `safety.torque_ramp_s`"
    } else if causes.singular_along.is_some() {
        "move the goal closer, free this axis, or start elsewhere: `opspace model ROBOT --at` finds `start_rad`"
    } else if !causes.position_limits.is_empty() {
        "move the goal, or start elsewhere: `opspace model ROBOT --at` finds `start_rad`"
    } else if !causes.kept_distances.is_empty() {
        "move the goal or the obstacle, or keep less distance: `collision.margin_m`"
    } else if !causes.torque_limits.is_empty() {
        "make the motion slower or the load lighter; `torque_limit_nm` of the joint, if the robot has more"
    } else if !causes.speed_limits.is_empty() {
        "make the motion longer or smaller, or raise `limits.velocity_fraction`: `opspace check TASK` states by how much"
    } else {
        "reorder `priority`, or make an axis of the task above `free`"
    }
}

#[cfg(test)]
mod tests {
    use super::{owner_remedy, remedy};
    use crate::codes::{Code, Effect};
    use crate::evaluate::findings::Findings;
    use crate::finding::{Finding, Place};
    use std::path::Path;

    /// Checks that each finding of a run names a key or a command.
    #[test]
    fn findings_name_a_key_or_a_command() {
        let of_run = |code: &&Code| matches!(code.effect(), Effect::Noted | Effect::Failed);
        // It computes its own from the spring.
        for code in Code::ALL.iter().filter(of_run).filter(|code| **code != Code::SpringDeflected) {
            let mut findings = Findings::default();
            findings.extend([Finding::of(*code, Place::Run(()), String::new())]);
            let help = &findings.of(*code).next().expect("the finding").help;
            assert!(help.contains('`'), "{code}: {help}");
        }
    }

    /// Checks that each key in remedies and notes is one of the files, or a metric.
    #[test]
    fn remedies_name_keys_that_exist() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let files = ["tasks/task.schema.json", "robots/robot.schema.json", "docs/reference/metrics.md"];
        let known: String =
            files.iter().filter_map(|file| std::fs::read_to_string(root.join(file)).ok()).collect();
        let sources = [include_str!("remedies.rs"), include_str!("notes.rs")];
        let code = sources.map(|text| text.split("#[cfg(test)]").next().unwrap_or_default());
        let lines = code.iter().flat_map(|text| text.lines()).filter(|line| !line.trim().starts_with("//"));
        let quoted = lines.flat_map(|line| line.split('`').skip(1).step_by(2));
        let is_key = |word: &&str| {
            word.contains('_') && word.chars().all(|c| c.is_ascii_lowercase() || matches!(c, '_' | '.'))
        };
        let keys: Vec<&str> = quoted.filter(is_key).collect();
        assert!(keys.len() > 12, "{keys:?}");
        for key in keys {
            let last = key.rsplit('.').next().unwrap_or_default();
            let is_known =
                [format!("\"{last}\""), format!("`{last}`")].iter().any(|text| known.contains(text));
            assert!(is_known, "`{key}` is no key");
        }
    }

    /// Compared: the remedies of a hold that was asked for, and of one after missing samples.
    #[test]
    fn requested_hold_needs_no_remedy() {
        let held = |missed: f64| {
            let finding = Finding::of(Code::ControlInterrupted, Place::Run(()), "held".to_owned());
            finding.with("missed_cycles", Some(missed))
        };
        for (missed, is_requested) in [(0.0, true), (3.0, false)] {
            let finding = held(missed);
            for remedy in [remedy(&finding), owner_remedy(&finding).expect("a remedy")] {
                assert_eq!(remedy.starts_with("nothing, if"), is_requested, "{missed}: {remedy}");
            }
        }
    }
}

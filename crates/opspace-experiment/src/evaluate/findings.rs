//! Findings of a run in its summary.
//!
//! In JSON, the key `findings` has all of them. The keys `failures`, `unreached_goals`, `limited_references`, `escapes` and
//! `ignored_compliance` have those of some codes in forms of their own, which older scripts read.

use crate::codes::{Code, Effect};
use crate::evaluate::remedies::{owner_remedy, remedy};
use crate::finding::{Causes, Finding, errors};
use serde::ser::SerializeMap;
use serde::{Deserialize, Serialize, Serializer};
use serde_json::{Value, json};

/// Findings of a run, in the order in which they are listed.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub struct Findings {
    #[serde(default)]
    findings: Vec<Finding>,
}

impl Findings {
    /// Adds findings, with a remedy for those that have none.
    pub fn extend(&mut self, findings: impl IntoIterator<Item = Finding>) {
        let with_help = |finding: Finding| match finding.help.as_str() {
            "" => Finding { help: remedy(&finding).to_owned(), ..finding },
            _ => finding,
        };
        self.findings.extend(findings.into_iter().map(with_help));
    }

    /// Replaces remedies of simulations by those of a real robot.
    pub(crate) fn help_owner(&mut self) {
        for finding in &mut self.findings {
            if let Some(remedy) = owner_remedy(finding) {
                finding.help = remedy.to_owned();
            }
        }
    }

    /// All findings.
    pub fn iter(&self) -> std::slice::Iter<'_, Finding> {
        self.findings.iter()
    }

    /// Findings with a code.
    pub fn of(&self, code: Code) -> impl Iterator<Item = &Finding> {
        self.iter().filter(move |finding| finding.code == code)
    }

    /// Findings that make the run a failure.
    pub fn failures(&self) -> impl Iterator<Item = &Finding> {
        self.iter().filter(|finding| finding.code.effect() == Effect::Failed)
    }

    /// Findings that do not make the run a failure.
    pub fn notes(&self) -> impl Iterator<Item = &Finding> {
        self.iter().filter(|finding| finding.code.effect() != Effect::Failed)
    }
}

impl Serialize for Findings {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let messages = |findings: &mut dyn Iterator<Item = &Finding>| -> Vec<String> {
            findings.map(ToString::to_string).collect()
        };
        let values =
            |code: Code, value: fn(&Finding) -> Value| -> Vec<Value> { self.of(code).map(value).collect() };
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("failures", &messages(&mut self.failures()))?;
        map.serialize_entry("unreached_goals", &values(Code::GoalNotReached, goal))?;
        map.serialize_entry("limited_references", &values(Code::ReferenceLimited, reference))?;
        map.serialize_entry("escapes", &values(Code::EscapedSingularity, escape))?;
        let ignored = messages(&mut self.of(Code::IgnoredCompliance));
        if !ignored.is_empty() {
            map.serialize_entry("ignored_compliance", &ignored)?;
        }
        map.serialize_entry("findings", &self.findings)?;
        map.end()
    }
}

fn goal(finding: &Finding) -> Value {
    let Causes {
        position_limits,
        speed_limits,
        torque_limits,
        kept_distances,
        singular_along,
        overridden_by,
        friction: _,
    } = &finding.causes;
    json!({
        "task": finding.task(),
        "begin_s": finding.number("begin_s"),
        "end_s": finding.number("end_s"),
        "position_m": finding.number("position_m"),
        "orientation_rad": finding.number("orientation_rad"),
        "position_limits": position_limits,
        "speed_limits": speed_limits,
        "torque_limits": torque_limits,
        "kept_distances": kept_distances,
        "singular_along": singular_along,
        "overridden_by": overridden_by,
    })
}

fn reference(finding: &Finding) -> Value {
    let Causes { position_limits, speed_limits, torque_limits, kept_distances, singular_along, .. } =
        &finding.causes;
    json!({
        "task": finding.task(),
        "begin_s": finding.number("begin_s"),
        "share": finding.number("share"),
        "position_m": finding.number("position_m"),
        "orientation_rad": finding.number("orientation_rad"),
        "largest_s": finding.number("largest_s"),
        "position_limits": position_limits,
        "speed_limits": speed_limits,
        "torque_limits": torque_limits,
        "kept_distances": kept_distances,
        "torque_ramp_s": finding.number("torque_ramp_s"),
        "settle_s": finding.number("settle_s"),
        "singular_along": singular_along,
    })
}

fn escape(finding: &Finding) -> Value {
    json!({
        "task": finding.task(),
        "begin_s": finding.number("begin_s"),
        "duration_s": finding.number("duration_s"),
    })
}

/// Sentence about a goal that a task did not reach: its numbers are `begin_s` and `end_s` (absent until the end of the run), s
/// after the start of control, and the largest errors `position_m` and `orientation_rad`.
pub(crate) fn goal_not_reached(finding: Finding) -> Finding {
    let number = |name: &str| finding.number(name);
    let missed =
        if finding.causes.is_only_overridden() { "not reached" } else { "not reachable within limits" };
    let begin_s = number("begin_s").unwrap_or(0.0);
    let span = match number("end_s") {
        Some(end_s) => format!("from {begin_s:.2} s to {end_s:.2} s"),
        None => format!("from {begin_s:.2} s on"),
    };
    let message = format!(
        "task '{}': goal {missed}, {span}, {} away: {}",
        finding.task().unwrap_or_default(),
        errors(number("position_m"), number("orientation_rad")),
        finding.causes.texts().join("; ")
    );
    Finding { message, ..finding }
}

/// Sentence about a moving reference that a task did not follow: its numbers are `begin_s` and `share` (of the time of control),
/// the largest errors `position_m` and `orientation_rad` and their time `largest_s`, and `torque_ramp_s` and `settle_s` if
/// that time is before the end of the ramp, or before the statistics begin.
pub(crate) fn reference_limited(finding: Finding) -> Finding {
    let number = |name: &str| finding.number(name);
    let ramp = number("torque_ramp_s")
        .map(|ramp_s| format!("the torque ramps in over the first {ramp_s} s (safety.torque_ramp_s)"));
    let causes: Vec<String> = ramp.into_iter().chain(finding.causes.texts()).collect();
    let message = format!(
        "task '{}': moving reference not followed within limits, from {:.2} s on in {:.0} % of the time, up to {} away (at {:.2} \
         s{}): {}",
        finding.task().unwrap_or_default(),
        number("begin_s").unwrap_or(0.0),
        100.0 * number("share").unwrap_or(0.0),
        errors(number("position_m"), number("orientation_rad")),
        number("largest_s").unwrap_or(0.0),
        number("settle_s").map_or_else(String::new, |settle_s| {
            format!(", before the tables below begin: settle_s = {settle_s}")
        }),
        causes.join("; ")
    );
    let deviations: Vec<String> = finding.deviations.keys().cloned().collect();
    let message = if deviations.len() > 1 {
        format!("{message}; joints that deviate: {}", deviations.join(", "))
    } else {
        message
    };
    Finding { message, ..finding }
}

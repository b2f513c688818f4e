//! Sentences about runs of inverse kinematics: which part of their error is sag, and which runs are a fair comparison.

use crate::evaluate::summary::Summary;
use crate::files::controller_kind::ControllerKind;
use crate::text::format_short;

/// Sentences about the runs of inverse kinematics among several runs, or of one.
#[must_use]
pub fn position_control_notes(summaries: &[Summary]) -> Vec<String> {
    let plain = |run: &&Summary| run.controller == ControllerKind::Ik.name();
    let mut notes: Vec<String> = Vec::new();
    for run in summaries.iter().filter(plain) {
        // The first of several seeds.
        let is_known = |note: &String| note.starts_with(&format!("'{}' with ik", run.task));
        if !notes.iter().any(is_known) {
            notes.extend(sag(run));
        }
    }
    let has = |what: fn(&Summary) -> bool| summaries.iter().any(what);
    if summaries.len() > 1 && summaries.iter().any(|run| plain(&run)) {
        let fair = [
            (has(|run| run.backend == "torque"), "the torque robot"),
            (has(|run| run.controller == ControllerKind::IkLead.name()), "ik-lead"),
        ];
        let missing: Vec<&str> =
            fair.iter().filter(|(is_there, _)| !is_there).map(|(_, name)| *name).collect();
        let words = "Fair baselines are the torque robot and ik-lead: ik compensates neither weight nor the delay of its servos.";
        notes.push(match missing.is_empty() {
            true => words.to_owned(),
            false => format!("{words} Missing here: {}.", missing.join(" and ")),
        });
    }
    notes
}

/// Divides the position error of a run into sag and lag: the distance that remains where the reference rests at the end, and what
/// the rms error has beside it.
fn sag(run: &Summary) -> Option<String> {
    let rms_m = run.metrics.pose.position_rms_m?;
    // A force moves the arm too.
    if run.metrics.response.external_force_max_n.is_some() {
        return None;
    }
    let with = run.label.as_ref().map_or_else(String::new, |label| format!(" ({label})"));
    let head = format!("'{}' with ik{with}", run.task);
    let mm = |value_m: f64| format_short(1e3 * value_m);
    let Some(sag_m) = run.metrics.pose.position_final_m else {
        let text = "mm rms is sag and lag together, because the reference moves at the end";
        return Some(format!("{head}: the position error of {} {text}.", mm(rms_m)));
    };
    if sag_m >= rms_m {
        let text = "mm rms is sag: the error at rest at the end is";
        return Some(format!("{head}: the position error of {} {text} {} mm.", mm(rms_m), mm(sag_m)));
    }
    let lag_m = lag_m(rms_m, sag_m);
    Some(format!(
        "{head}: of the position error of {} mm rms, {} mm is sag (the error at rest at the end) and {} mm is lag \
         (√(rms² − sag²)).",
        mm(rms_m),
        mm(sag_m),
        mm(lag_m)
    ))
}

/// Part of an rms error (m) beside a constant sag (m), if the two are not correlated; zero if the sag is the larger one.
pub(crate) fn lag_m(rms_m: f64, sag_m: f64) -> f64 {
    (rms_m.powi(2) - sag_m.powi(2)).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::position_control_notes;
    use crate::evaluate::results::tests::summary;
    use crate::evaluate::summary::Summary;

    fn ik(rms_m: f64, final_m: Option<f64>) -> Summary {
        let mut run = Summary { controller: "ik".to_owned(), ..summary("a", "p", 1, rms_m) };
        run.metrics.pose.position_final_m = final_m;
        run
    }

    /// Compared: the parts of an error of 5 mm, 3 mm of which remain, and a right triangle of 3, 4 and 5.
    #[test]
    fn error_is_divided_into_sag_and_lag() {
        let words = |run: Summary| position_control_notes(&[run]).concat();
        let divided = words(ik(0.005, Some(0.003)));
        assert!(divided.contains("3 mm is sag") && divided.contains("4 mm is lag"), "{divided}");
        assert!(words(ik(0.005, Some(0.006))).contains("5 mm rms is sag"));
        assert!(words(ik(0.005, None)).contains("sag and lag together"));
        assert_eq!(words(summary("a", "p", 1, 0.005)), "");
    }

    /// Checks which fair baselines are missing among several runs.
    #[test]
    fn missing_baselines_are_named() {
        let torque = Summary { backend: "torque".to_owned(), ..summary("a", "p", 1, 0.001) };
        let notes = position_control_notes(&[ik(0.005, None), torque.clone()]);
        assert!(notes[1].ends_with("Missing here: ik-lead."), "{notes:?}");
        let lead = Summary { controller: "ik-lead".to_owned(), ..summary("a", "p", 1, 0.001) };
        let notes = position_control_notes(&[ik(0.005, None), torque, lead]);
        assert!(!notes[1].contains("Missing"), "{notes:?}");
    }
}

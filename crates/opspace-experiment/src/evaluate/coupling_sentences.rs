//! Sentences about the couplings of a run of several robots.

use crate::evaluate::run_summary::RunSummary;
use crate::metrics::coupling_metrics::CouplingMetrics;
use crate::text::{format_short, listed, without_noise};

/// Names the experiment of a run and its robots: a title.
#[must_use]
pub fn coupling_title(summary: &RunSummary) -> String {
    let robots: Vec<String> = summary.robots.keys().map(|robot| format!("'{robot}'")).collect();
    format!("Experiment '{}' couples {}", summary.experiment, listed(&robots))
}

/// Describes for each coupling how well its robots follow each other or an object's path, and what an operator feels.
#[must_use]
pub fn coupling_sentences(summary: &RunSummary) -> Vec<String> {
    summary.couplings.iter().flat_map(|(name, metrics)| sentences(name, metrics)).collect()
}

fn sentences(name: &str, metrics: &CouplingMetrics) -> Vec<String> {
    let number = |value: f64, factor: f64| format_short(factor * without_noise(value));
    let at_most = |max: Option<f64>, unit: &str, factor: f64| {
        max.map_or_else(String::new, |max| format!(", at most {} {unit}", number(max, factor)))
    };
    let mut sentences = Vec::new();
    if let Some(rms_m) = metrics.tracking_rms_m {
        let end = metrics.drift_m.map_or_else(String::new, |drift_m| {
            format!(", {} mm in the last half second", number(drift_m, 1e3))
        });
        sentences.push(format!(
            "The robots coupled by '{name}' are {} mm (rms) apart{}{end}.",
            number(rms_m, 1e3),
            at_most(metrics.tracking_max_m, "mm", 1e3)
        ));
    }
    if let Some(rms_m) = metrics.path_rms_m {
        sentences.push(format!(
            "The object of '{name}' is {} mm (rms) from its path{}.",
            number(rms_m, 1e3),
            at_most(metrics.path_max_m, "mm", 1e3)
        ));
    }
    if let Some(rms_n) = metrics.internal_force_rms_n {
        sentences.push(format!(
            "The internal force is {} N (rms) from its target{}.",
            number(rms_n, 1.0),
            at_most(metrics.internal_force_max_n, "N", 1.0)
        ));
    }
    if let Some(rms_n) = metrics.hand_force_rms_n {
        sentences.push(format!("The operator needs {} N (rms).", number(rms_n, 1.0)));
    }
    if let Some((least, largest)) = metrics.felt_least_n_per_m.zip(metrics.felt_largest_n_per_m) {
        sentences.push(format!(
            "The operator feels {} to {} kN/m between 0.5 and 2 Hz.",
            number(least, 1e-3),
            number(largest, 1e-3)
        ));
    }
    if let Some(lost_s) = metrics.contact_lost_s.filter(|lost_s| *lost_s > 0.0) {
        sentences.push(format!("The follower lost contact for {} s.", number(lost_s, 1.0)));
    }
    sentences
}

#[cfg(test)]
mod tests {
    use super::sentences;
    use crate::metrics::coupling_metrics::CouplingMetrics;

    /// Checks that numbers have their units, and that those which do not exist have no sentence.
    #[test]
    fn coupling_is_described_by_its_numbers() {
        assert!(sentences("arms", &CouplingMetrics::default()).is_empty());
        let metrics = CouplingMetrics {
            tracking_rms_m: Some(2.34e-3),
            tracking_max_m: Some(9e-3),
            drift_m: Some(1e-15),
            felt_least_n_per_m: Some(800.0),
            felt_largest_n_per_m: Some(1250.0),
            contact_lost_s: Some(0.0),
            ..CouplingMetrics::default()
        };
        let expected = [
            "The robots coupled by 'arms' are 2.34 mm (rms) apart, at most 9 mm, 0 mm in the last half second.",
            "The operator feels 0.8 to 1.25 kN/m between 0.5 and 2 Hz.",
        ];
        assert_eq!(sentences("arms", &metrics), expected);
    }
}

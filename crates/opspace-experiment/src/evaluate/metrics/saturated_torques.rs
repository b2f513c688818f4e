//! Joints whose torque limits cut off desired torques.

use crate::codes::Code;
use crate::finding::{Finding, Place};
use crate::metrics::metric_tables::JointMetrics;
use std::collections::BTreeMap;

/// Finding about the joints whose desired torques were saturated.
pub(super) fn saturated_torques(joints: &BTreeMap<String, JointMetrics>) -> Option<Finding> {
    let fraction = |joint: &JointMetrics| joint.torque_saturated_fraction.filter(|fraction| *fraction > 0.0);
    let saturated: Vec<(&String, f64)> =
        joints.iter().filter_map(|(name, joint)| Some((name, fraction(joint)?))).collect();
    let largest = saturated.iter().map(|(_, fraction)| *fraction).reduce(f64::max)?;
    let texts =
        saturated.iter().map(|(name, fraction)| format!("'{name}' in {} of the time", percent(*fraction)));
    let message = format!(
        "desired torques were cut off at the torque limits: joint {}",
        texts.collect::<Vec<_>>().join(", ")
    );
    let names = saturated.iter().map(|(name, _)| (*name).clone()).collect();
    let finding = Finding::of(Code::TorquesSaturated, Place::Joints(names), message);
    Some(finding.with("largest_fraction", Some(largest)))
}

fn percent(fraction: f64) -> String {
    if fraction < 1e-3 { "less than 0.1 %".to_owned() } else { format!("{:.1} %", 100.0 * fraction) }
}

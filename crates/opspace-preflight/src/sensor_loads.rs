//! Force sensors whose load does not follow from what is beyond them.

use super::case::PreflightCase;
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_experiment::suggest::list;

/// Diagnostics of all sensors without a load and an estimate of it.
pub(crate) fn unknown(case: &PreflightCase<'_>) -> Vec<Finding> {
    let robot = case.experiment.robot();
    let unknown = robot.unknown_loads.iter();
    let is_estimated =
        |name: &String| robot.file.force_sensor.get(name).is_some_and(|sensor| sensor.estimate.is_some());
    let found = unknown.filter(|(name, _)| !is_estimated(name)).map(|(name, beyond)| {
        let message = format!(
            "sensor '{name}' has no `load`, but bears {}, which joints move: their weight counts as force when the hand turns",
            list(beyond.iter().map(String::as_str))
        );
        let help = format!("state `load` in [force_sensor.{name}], or lock these joints (`locked_joints`)");
        Finding::new(Code::UnknownSensorLoad, &["force_sensor", name], message, help).of_robot()
    });
    found.collect()
}

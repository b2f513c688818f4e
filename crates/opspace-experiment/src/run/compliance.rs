//! Impedances and compliant axes of tasks, by name.

use opspace_control::{AXIS_NAMES, AxisMode, TaskParameters};

/// Names the compliance of a task, with its key; `None` if it has none.
pub fn compliance(parameters: &TaskParameters) -> Option<(String, &'static str)> {
    let TaskParameters::Cartesian(task) = parameters else { return None };
    if task.impedance.is_some() {
        return Some(("its impedance".to_owned(), "impedance"));
    }
    let compliant = task.axes.with_mode(AxisMode::Compliant);
    let axes: Vec<&str> =
        AXIS_NAMES.into_iter().zip(compliant).filter(|(_, is)| *is).map(|(axis, _)| axis).collect();
    (!axes.is_empty()).then(|| (format!("its compliance along {}", axes.join(", ")), "axes"))
}

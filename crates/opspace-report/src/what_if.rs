//! Figure of a replay with other files: logged and recomputed torques.

use crate::figure::{Figure, Panel, Series, Style};
use opspace_backend::signal_names::TORQUE_DESIRED;
use opspace_experiment::run::error::RunError;
use opspace_log::Recording;

/// Returns the figure of logged torques, torques of a run on the log, and their difference, with a panel for each joint.
/// `None` if one of the two has no desired torques of the same joints.
///
/// # Errors
/// A log without control cycles.
pub fn torque_difference(logged: &Recording, run: &Recording) -> Result<Option<Figure>, RunError> {
    let (tick, rerun) = (logged.tick()?, run.tick()?);
    let (Some(logged), Some(recomputed)) = (tick.signal(TORQUE_DESIRED), rerun.signal(TORQUE_DESIRED)) else {
        return Ok(None);
    };
    if recomputed.elements() != logged.elements() {
        return Ok(None);
    }
    let panel = |(j, joint): (usize, &String)| {
        let both = || logged.rows().map(|row| row[j]).zip(recomputed.rows().map(|row| row[j]));
        let series = |label: &str, y: Vec<f64>, style| {
            Series::new(label, tick.time_s[..y.len()].to_vec(), y).style(style)
        };
        Panel {
            title: joint.clone(),
            x_label: "time (s)".to_owned(),
            y_label: format!("torque ({})", logged.units()[j].replace("Nm", "N·m")),
            series: vec![
                series("recomputed", both().map(|(_, is)| is).collect(), Style::Solid),
                series("recomputed − logged", both().map(|(was, is)| is - was).collect(), Style::Thin),
                series("logged", both().map(|(was, _)| was).collect(), Style::Desired),
            ],
            ..Panel::default()
        }
    };
    Ok(Some(Figure {
        title: "Logged and recomputed torque".to_owned(),
        caption: "Desired torque in the log, desired torque computed from the same measurements by the other files, \
                  and their difference. The motion is the logged one."
            .to_owned(),
        panels: logged.elements().iter().enumerate().map(panel).collect(),
        ..Figure::default()
    }))
}

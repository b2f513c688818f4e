//! Figure of a replay with other files: logged and recomputed torques.

use crate::report::figure::{Figure, Panel, Series, Style};
use crate::run::error::RunError;
use crate::run::experiment::Experiment;
use crate::run::replay::replay_into;
use opspace_backend::signal_names::TORQUE_DESIRED;
use opspace_backend::{Sink, TICK};
use opspace_log::Recording;
use opspace_loop::Run;
use std::ops::Range;

/// Desired torques of a replay, cycle by cycle.
struct Torques {
    columns: Range<usize>,
    rows: Vec<Vec<f64>>,
}

impl Sink for Torques {
    fn row(&mut self, channel: usize, _time_s: f64, row: &[f64]) {
        if channel == TICK {
            self.rows.push(row[self.columns.clone()].to_vec());
        }
    }
}

/// Replays a log with an experiment, and returns the figure of logged torques, recomputed torques and their difference,
/// with a panel for each joint. `None` if the log or the experiment has no desired torques of the same joints.
///
/// # Errors
/// A log without one of the inputs.
pub fn torque_difference(experiment: &Experiment, recording: &Recording) -> Result<Option<Figure>, RunError> {
    let layouts = Run::layouts(&experiment.control_loop()?, None);
    let tick = recording.tick()?;
    let (Some(columns), Some(logged)) = (layouts[TICK].columns(TORQUE_DESIRED), tick.signal(TORQUE_DESIRED))
    else {
        return Ok(None);
    };
    if columns.len() != logged.elements().len() {
        return Ok(None);
    }
    let mut recomputed = Torques { columns, rows: Vec::new() };
    replay_into(experiment, recording, &mut recomputed)?;
    let panel = |(j, joint): (usize, &String)| {
        let both = || logged.rows().map(|row| row[j]).zip(recomputed.rows.iter().map(|row| row[j]));
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

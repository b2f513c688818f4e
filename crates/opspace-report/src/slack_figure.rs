//! Figure of the acceleration that limits take from the tasks of a run.

use crate::figure::{Figure, Style};
use crate::lines::{line, time_panel};
use opspace_backend::signal_names::{self, SLACK};
use opspace_experiment::evaluate::metrics::run_log::Run;
use opspace_experiment::evaluate::metrics::slack::{UNITS, has, size};

/// Creates the figure, with a panel for the translations and one for the rotations of each task. A line is absent while
/// limits take nothing; a panel without a line is removed by [`complete`](crate::lines::complete).
pub(crate) fn slack_figure(run: &Run<'_>) -> Option<Figure> {
    let mut panels = Vec::new();
    for (name, _) in run.experiment.task().tasks_of_the_run() {
        let Some(slack) = run.tick.signal(&signal_names::of(name, SLACK)) else { continue };
        for unit in UNITS.into_iter().filter(|unit| has(&slack, unit)) {
            let taken = |k: usize| Some(size(&slack, k, unit)).filter(|size| *size > 0.0);
            let samples =
                run.tick.time_s.iter().enumerate().map(|(k, &time_s)| (time_s, taken(k).unwrap_or(f64::NAN)));
            let line = line(run, "slack", samples, Style::Solid);
            panels.push(time_panel(&format!("task '{name}'"), &format!("acceleration ({unit})"), vec![line]));
        }
    }
    (!panels.is_empty()).then(|| Figure {
        title: "Acceleration that limits take from the tasks".to_owned(),
        caption: "Slack of each task: acceleration of the command without limits minus that of the command, norm over its \
                  translations or rotations; of a task of all joints, the part that the tasks above leave. No line is drawn \
                  while limits take nothing."
            .to_owned(),
        panels,
        overlays: true,
        ..Figure::default()
    })
}

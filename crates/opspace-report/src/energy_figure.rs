//! Figure of the energies that keep force control and varying stiffness passive.

use crate::figure::{Figure, Panel, Series, Style};
use crate::lines::{line, time_panel};
use opspace_backend::signal_names::{self, CONTACT, FORCE_ENERGY, FORCE_GAIN_SHARE, TANK};
use opspace_control::{AXIS_NAMES, TaskParameters};
use opspace_experiment::evaluate::metrics::run_log::Run;

/// Creates the figure of the tasks with force axes or energy tanks; `None` without such a task. A panel without a line is
/// removed by [`complete`](crate::lines::complete).
pub(crate) fn energy_figure(run: &Run<'_>) -> Option<Figure> {
    let tasks = run.experiment.task().tasks_of_the_run();
    let panels: Vec<Panel> = tasks.into_iter().flat_map(|(name, task)| panels(run, name, task)).collect();
    (!panels.is_empty()).then(|| Figure {
        title: "Energies of force control".to_owned(),
        caption: "Energy that the feedback of a force axis gives to fast motion: its gains are reduced when it exceeds the store. \
                  No share is drawn while they are not. The tank pays for stiffness that grows."
            .to_owned(),
        panels,
        overlays: true,
        ..Figure::default()
    })
}

fn panels(run: &Run<'_>, name: &str, task: &TaskParameters) -> Vec<Panel> {
    let signal = |signal: &str| run.tick.signal(&signal_names::of(name, signal));
    let series = |label: &str, style: Style, value: &dyn Fn(usize) -> f64| -> Series {
        line(run, label, run.tick.time_s.iter().enumerate().map(|(k, &time_s)| (time_s, value(k))), style)
    };
    let mut panels = Vec::new();
    if let (Some(energy), Some(share), Some(contact), TaskParameters::Cartesian(task)) =
        (signal(FORCE_ENERGY), signal(FORCE_GAIN_SHARE), signal(CONTACT), task)
    {
        let store_j = task.force.as_ref().map_or(f64::NAN, |force| force.passivity.store_j.get());
        for (axis, axis_name) in AXIS_NAMES.iter().enumerate() {
            // An axis has a contact, made or not, while it is in force control.
            let if_controlled =
                |k: usize, value: f64| if contact.row(k)[axis].is_nan() { f64::NAN } else { value };
            let title = format!("task '{name}', {axis_name}");
            let of_axis = series("energy", Style::Solid, &|k| if_controlled(k, 1e3 * energy.row(k)[axis]));
            let store = series("store", Style::Desired, &|k| if_controlled(k, 1e3 * store_j));
            panels.push(time_panel(&title, "energy (mJ)", vec![of_axis, store]));
            let reduced = |k: usize| Some(share.row(k)[axis]).filter(|share| *share < 1.0);
            let of_gains = series("share", Style::Solid, &|k| reduced(k).unwrap_or(f64::NAN));
            panels.push(time_panel(&title, "share of the gains", vec![of_gains]));
        }
    }
    if let Some(tank) = signal(TANK) {
        let level = series("tank", Style::Solid, &|k| tank.row(k)[0]);
        panels.push(time_panel(&format!("task '{name}', tank"), "energy (J)", vec![level]));
    }
    panels
}

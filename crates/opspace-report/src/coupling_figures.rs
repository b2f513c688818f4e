//! Figures of a coupling: both robots on one time axis.

use crate::figure::{Figure, Panel, Series, Style};
use crate::lines::{COLUMNS, time_panel};
use opspace_experiment::evaluate::coupling::{CouplingEvaluator, Ticks, Track};

/// Figures of a coupling, from the logs of both robots.
pub(crate) fn coupling_figures(evaluator: &CouplingEvaluator<'_>) -> Vec<Figure> {
    let name = &evaluator.coupling.name;
    let panels = motion_panels(evaluator);
    if panels.is_empty() {
        return Vec::new();
    }
    vec![
        Figure {
            title: format!("Motion and force of the coupling '{name}'"),
            caption: "Positions in the leader's coordinates. The force is that which the leader applies to the hand, and \
                      that which the follower senses or commands."
                .to_owned(),
            panels,
            columns: Some(2),
            ..Figure::default()
        },
        Figure {
            title: format!("Energy and packets of the coupling '{name}'"),
            caption: "Energy that has entered the coupling at each robot and that the other may spend, energy that has left it, and the work of the environment on both: \
                      below zero, the pair has given energy away. Time for which the passivity control changed a force or a \
                      reference, and packets that were lost or overtaken."
                .to_owned(),
            panels: energy_panels(evaluator),
            columns: Some(2),
            ..Figure::default()
        },
    ]
}

fn series(label: &str, time_s: &[f64], value: impl Fn(usize) -> f64, style: Style) -> Series {
    Series::new(label, time_s.to_vec(), (0..time_s.len()).map(value).collect()).style(style).thinned(COLUMNS)
}

fn motion_panels(evaluator: &CouplingEvaluator<'_>) -> Vec<Panel> {
    let [leader, follower] = &evaluator.tracks;
    let mut panels = Vec::new();
    for (row, (name, unit)) in evaluator.rows().into_iter().enumerate() {
        let (length, force) =
            if unit == "m" { ("position (m)", "force (N)") } else { ("angle (rad)", "moment (N·m)") };
        let position = |track: &Track<'_>, label: &str, style| {
            series(label, &track.ticks.time_s, |k| track.ticks.sent[k][row], style)
        };
        let forces = |track: &Track<'_>, label: &str, style| {
            series(label, &track.ticks.time_s, |k| track.ticks.force[k][row], style)
        };
        let positions =
            vec![position(leader, "leader", Style::Desired), position(follower, "follower", Style::Solid)];
        panels.push(time_panel(&name, length, positions));
        let both = vec![forces(leader, "leader", Style::Desired), forces(follower, "follower", Style::Solid)];
        panels.push(time_panel(&name, force, both));
    }
    panels
}

fn energy_panels(evaluator: &CouplingEvaluator<'_>) -> Vec<Panel> {
    let [leader, follower] = &evaluator.tracks;
    let mut panels = Vec::new();
    for (label, track) in [("leader", leader), ("follower", follower)] {
        let time_s = &track.ticks.time_s;
        let energy =
            |name: &str, which: usize, style| series(name, time_s, |k| track.ticks.energy_j[k][which], style);
        let lines = vec![energy("in", 0, Style::Solid), energy("out", 1, Style::Desired)];
        panels.push(time_panel(label, "energy (J)", lines));
    }
    let work = vec![series("both robots", &leader.time_s, |k| evaluator.work_at(k), Style::Solid)];
    panels.push(time_panel("work of operator and environment", "energy (J)", work));
    let of_both = |value: fn(&Ticks, usize) -> f64| {
        [("leader", leader), ("follower", follower)]
            .map(|(label, track)| {
                series(label, &track.ticks.time_s, |k| value(&track.ticks, k), Style::Solid)
            })
            .to_vec()
    };
    panels.push(time_panel("passivity control", "active (s)", of_both(|ticks, k| ticks.passivity_s[k])));
    panels.push(time_panel("packets", "lost or overtaken", of_both(|ticks, k| ticks.packets_lost[k])));
    panels
}

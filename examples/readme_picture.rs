//! Pictures of the documentation: a hand that an operator pushes, and a hand that presses on a table.
//!
//! `cargo run --release -p opspace --example readme_picture -- [FOLDER]` draws `compliant-x.svg` and `press-table.svg` in
//! `runs/readme_picture`, or in FOLDER; README and docs show the copies in `docs/`.

#![expect(clippy::print_stdout, reason = "an example shows what it did")]

#[path = "common/mod.rs"]
mod common;

use opspace::experiment::{Experiment, Files, Progress};
use opspace::log::Recording;
use plotters::coord::Shift;
use plotters::prelude::*;
use std::error::Error;
use std::ops::Range;

type Canvas<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// A line of a panel: label, colour, width in pixels, and points over time (s).
type Line = (&'static str, RGBColor, u32, Vec<(f64, f64)>);

/// Width and height of the canvas, in pixels: twice the displayed size, because coordinates are rounded to pixels.
const SIZE: (u32, u32) = (1440, 1300);
/// Joint whose torques are shown.
const JOINT: usize = 3;

const BLUE: RGBColor = RGBColor(0, 114, 178);
const ORANGE: RGBColor = RGBColor(230, 120, 0);
const GREEN: RGBColor = RGBColor(0, 140, 100);
const GREY: RGBColor = RGBColor(70, 70, 70);

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).unwrap_or("runs/readme_picture".to_owned());
    std::fs::create_dir_all(&folder)?;
    pushed_hand(&format!("{folder}/compliant-x.svg"))?;
    pressing_hand(&format!("{folder}/press-table.svg"))
}

/// Runs a task, with settings, and returns its log.
fn log_of(task: &str, settings: &[&str]) -> Result<Recording, Box<dyn Error>> {
    let settings: Vec<String> = settings.iter().map(|&setting| setting.to_owned()).collect();
    let path = format!("tasks/{task}.toml");
    let experiment = Experiment::load(Files::Disk, path.as_ref(), None, Default::default(), &settings)?;
    let folder = format!("readme_picture/{task}");
    common::record(&folder, &experiment, |log| experiment.run(log, &Progress::default()))?;
    Ok(Recording::read(format!("runs/{folder}/run.mcap"))?)
}

/// Samples of an element of a signal in part of a log (s), relative to an origin and scaled.
fn curve(
    recording: &Recording,
    shown_s: &Range<f64>,
    (signal, element): (&str, usize),
    (origin, scale): (f64, f64),
) -> Result<Vec<(f64, f64)>, Box<dyn Error>> {
    let tick = recording.tick()?;
    let column = tick.signal(signal).ok_or(format!("no signal {signal}"))?;
    let shown = tick.time_s.iter().zip(column.rows()).filter(|(t, _)| shown_s.contains(t));
    Ok(shown.step_by(5).map(|(t, row)| (*t, scale * (row[element] - origin))).collect())
}

/// Draws desired and motor torque of a joint, and motion of a hand that an operator pushes.
fn pushed_hand(path: &str) -> Result<(), Box<dyn Error>> {
    let (recording, shown_s) = (log_of("compliant-x", &[])?, 2.0..8.0);
    let tick = recording.tick()?;
    let reference = tick.signal("hand.reference").ok_or("no reference")?;
    let held = reference.row(reference.len() - 1);
    let joint = &tick.signal("torque_desired").ok_or("no torque")?.elements()[JOINT];
    let torque = |signal| curve(&recording, &shown_s, (signal, JOINT), (0.0, 1.0));
    let moved = |axis| curve(&recording, &shown_s, ("hand.position", axis), (held[axis], 1e3));
    let torques: [Line; 2] = [
        ("motor torque", ORANGE, 8, torque("motor_torque")?),
        ("desired torque", BLUE, 4, torque("torque_desired")?),
    ];
    let motions: [Line; 3] = [
        ("x: compliant", ORANGE, 6, moved(0)?),
        ("y: held", BLUE, 4, moved(1)?),
        ("z: held", GREEN, 4, moved(2)?),
    ];
    let title = format!("Torque of the {}", joint.replace('_', " "));
    draw(
        path,
        &shown_s,
        [
            (&title, "torque (Nm)", &torques),
            ("Motion of the hand while an operator pushes it", "displacement (mm)", &motions),
        ],
    )
}

/// Draws force and target of a hand on a hard, nearly undamped table, and the energy of its force feedback.
fn pressing_hand(path: &str) -> Result<(), Box<dyn Error>> {
    let table =
        ["environment.board.wall.stiffness_n_per_m=50000.0", "environment.board.wall.damping_ns_per_m=5.0"];
    let (recording, shown_s) = (log_of("press-table", &table)?, 0.0..7.0);
    let z = |signal, scale| curve(&recording, &shown_s, (signal, 2), (0.0, scale));
    let forces: [Line; 2] = [
        ("sensed", ORANGE, 6, z("hand.sensed_force", 1.0)?),
        ("target", BLUE, 4, z("hand.target_force", 1.0)?),
    ];
    let energies: [Line; 1] = [("energy", GREEN, 5, z("hand.force_energy", 1e3)?)];
    draw(
        path,
        &shown_s,
        [
            ("Force on a table of 50 kN/m: at rest, and from 4 s along a circle", "force (N)", &forces),
            ("Energy that the force feedback gives to fast motion", "energy (mJ)", &energies),
        ],
    )
}

/// Draws two panels, each with title, label and lines, over part of a run (s).
fn draw(path: &str, shown_s: &Range<f64>, panels: [(&str, &str, &[Line]); 2]) -> Result<(), Box<dyn Error>> {
    let canvas = SVGBackend::new(path, SIZE).into_drawing_area();
    canvas.fill(&WHITE)?;
    let (upper, lower) = canvas.split_vertically(50.percent_height());
    for (part, (title, label, lines)) in [upper, lower].iter().zip(panels) {
        panel(part, shown_s, title, label, lines)?;
    }
    Ok(canvas.present()?)
}

/// Draws lines over time with a title, axes and a legend.
fn panel(
    canvas: &Canvas<'_>,
    shown_s: &Range<f64>,
    title: &str,
    y_label: &str,
    lines: &[Line],
) -> Result<(), Box<dyn Error>> {
    let values = || lines.iter().flat_map(|line| line.3.iter().map(|point| point.1));
    let (low, high) = (values().fold(f64::MAX, f64::min), values().fold(f64::MIN, f64::max));
    let margin = 0.08 * (high - low);
    let text = |size: u32| ("sans-serif", size).into_font().color(&GREY);
    let mut chart = ChartBuilder::on(canvas)
        .caption(title, text(46))
        .margin(20)
        .margin_right(40)
        .x_label_area_size(90)
        .y_label_area_size(130)
        .build_cartesian_2d(shown_s.clone(), low - margin..high + 4.0 * margin)?;
    let mesh = &mut chart.configure_mesh();
    mesh.x_desc("time (s)").y_desc(y_label).x_labels(7).y_labels(6).axis_desc_style(text(38));
    mesh.x_label_formatter(&|x| format!("{x:.0}")).y_label_formatter(&|y| format!("{y:.0}"));
    mesh.label_style(text(36)).light_line_style(TRANSPARENT).bold_line_style(GREY.mix(0.2)).draw()?;
    for (label, color, width, points) in lines {
        let style = color.stroke_width(*width);
        let series = chart.draw_series(LineSeries::new(points.iter().copied(), style))?.label(*label);
        series.legend(move |(x, y)| PathElement::new([(x, y), (x + 40, y)], style.stroke_width(8)));
    }
    let legend = &mut chart.configure_series_labels();
    legend.position(SeriesLabelPosition::UpperRight).legend_area_size(60).margin(8);
    legend.label_font(text(38)).background_style(WHITE.mix(0.85)).draw()?;
    Ok(())
}

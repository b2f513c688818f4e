//! Picture of the README: desired and motor torque of a joint, and motion of a hand that an operator pushes.
//!
//! `cargo run --release -p opspace --example readme_picture -- [SVG]` draws `runs/readme_picture/compliant-x.svg`, or
//! the file SVG; the README shows the copy in `docs/`.

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

/// A line of a panel: label, colour, width in pixels, and points (s; Nm or mm).
type Line = (&'static str, RGBColor, u32, Vec<(f64, f64)>);

/// Width and height of the canvas, in pixels: twice the displayed size, because coordinates are rounded to pixels.
const SIZE: (u32, u32) = (1440, 1300);
/// Part of the run that is shown, s.
const SHOWN_S: Range<f64> = 2.0..8.0;
/// Joint whose torques are shown.
const JOINT: usize = 3;

const BLUE: RGBColor = RGBColor(0, 114, 178);
const ORANGE: RGBColor = RGBColor(230, 120, 0);
const GREEN: RGBColor = RGBColor(0, 140, 100);
const GREY: RGBColor = RGBColor(70, 70, 70);

fn main() -> Result<(), Box<dyn Error>> {
    let task = "tasks/compliant-x.toml".as_ref();
    let experiment = Experiment::load(Files::Disk, task, None, Default::default(), &[])?;
    common::record("readme_picture", &experiment, |log| experiment.run(log, &Progress::default()))?;
    let recording = Recording::read("runs/readme_picture/run.mcap")?;
    let tick = recording.tick()?;
    let column = |signal: &str| tick.signal(signal).ok_or(format!("no signal {signal}"));
    // Samples of a signal's element, relative to an origin and scaled.
    let curve = |signal: &str, element: usize, origin: f64, scale: f64| -> Result<Vec<_>, String> {
        let column = column(signal)?;
        let shown = tick.time_s.iter().zip(column.rows()).filter(|(t, _)| SHOWN_S.contains(t));
        Ok(shown.step_by(5).map(|(t, row)| (*t, scale * (row[element] - origin))).collect())
    };
    let reference = column("hand.reference")?;
    let held = reference.row(reference.len() - 1);
    let joint = &column("torque_desired")?.elements()[JOINT];
    let torques: [Line; 2] = [
        ("motor torque", ORANGE, 8, curve("motor_torque", JOINT, 0.0, 1.0)?),
        ("desired torque", BLUE, 4, curve("torque_desired", JOINT, 0.0, 1.0)?),
    ];
    let motions: [Line; 3] = [
        ("x: compliant", ORANGE, 6, curve("hand.position", 0, held[0], 1e3)?),
        ("y: held", BLUE, 4, curve("hand.position", 1, held[1], 1e3)?),
        ("z: held", GREEN, 4, curve("hand.position", 2, held[2], 1e3)?),
    ];

    let path = std::env::args().nth(1).unwrap_or("runs/readme_picture/compliant-x.svg".to_owned());
    let canvas = SVGBackend::new(&path, SIZE).into_drawing_area();
    canvas.fill(&WHITE)?;
    let (upper, lower) = canvas.split_vertically(50.percent_height());
    panel(&upper, &format!("Torque of the {}", joint.replace('_', " ")), "torque (Nm)", &torques)?;
    panel(&lower, "Motion of the hand while an operator pushes it", "displacement (mm)", &motions)?;
    Ok(canvas.present()?)
}

/// Draws lines over time with a title, axes and a legend.
fn panel(canvas: &Canvas<'_>, title: &str, y_label: &str, lines: &[Line]) -> Result<(), Box<dyn Error>> {
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
        .build_cartesian_2d(SHOWN_S, low - margin..high + 4.0 * margin)?;
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

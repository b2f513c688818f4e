//! Figures of the documentation: panels with lines, drawn as SVG.

use plotters::coord::Shift;
use plotters::prelude::*;
use std::error::Error;
use std::ops::Range;

type Canvas<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Width and height of a panel, in pixels: twice the displayed size, because coordinates are rounded to pixels.
const PANEL: (u32, u32) = (1440, 650);

pub const BLUE: RGBColor = RGBColor(0, 114, 178);
pub const ORANGE: RGBColor = RGBColor(230, 120, 0);
pub const GREEN: RGBColor = RGBColor(0, 140, 100);
const GREY: RGBColor = RGBColor(70, 70, 70);

/// A line of a panel.
pub struct Line {
    pub label: String,
    pub color: RGBColor,
    /// Width in pixels.
    pub width: u32,
    /// Points; the line is interrupted where one is NaN.
    pub points: Vec<(f64, f64)>,
}

impl Line {
    pub fn new(label: &str, color: RGBColor, width: u32, points: Vec<(f64, f64)>) -> Self {
        Self { label: label.to_owned(), color, width, points }
    }
}

/// A diagram with a title, axes and a legend.
pub struct Panel {
    pub title: String,
    pub x_label: String,
    pub y_label: String,
    /// Range of the horizontal axis; that of the lines if absent.
    pub x_range: Option<Range<f64>>,
    pub lines: Vec<Line>,
}

impl Panel {
    /// Panel of lines over time, s.
    pub fn over_time(title: &str, y_label: &str, lines: Vec<Line>) -> Self {
        Self {
            title: title.to_owned(),
            x_label: "time (s)".to_owned(),
            y_label: y_label.to_owned(),
            x_range: None,
            lines,
        }
    }
}

/// Size of the text of panels in several columns, over that of a single column: they are shown at a smaller scale.
const ZOOM_OF_COLUMNS: f64 = 1.6;

/// Draws panels in columns.
pub fn draw(path: &str, columns: usize, panels: &[Panel]) -> Result<(), Box<dyn Error>> {
    let rows = panels.len().div_ceil(columns);
    let size = (PANEL.0 * columns as u32, PANEL.1 * rows as u32);
    let canvas = SVGBackend::new(path, size).into_drawing_area();
    canvas.fill(&WHITE)?;
    let zoom = if columns > 1 { ZOOM_OF_COLUMNS } else { 1.0 };
    for (part, panel) in canvas.split_evenly((rows, columns)).iter().zip(panels) {
        draw_panel(part, panel, zoom)?;
    }
    Ok(canvas.present()?)
}

fn draw_panel(canvas: &Canvas<'_>, panel: &Panel, zoom: f64) -> Result<(), Box<dyn Error>> {
    let points = || panel.lines.iter().flat_map(|line| &line.points);
    let range = |of: fn(&(f64, f64)) -> f64| {
        let values = || points().map(of);
        (values().fold(f64::MAX, f64::min), values().fold(f64::MIN, f64::max))
    };
    let (low, high) = range(|point| point.1);
    let margin = 0.08 * (high - low);
    // Space for the legend.
    let above = zoom.powf(1.5) * if panel.lines.len() > 3 { 7.0 } else { 4.0 };
    let (begin, end) = range(|point| point.0);
    let shown = panel.x_range.clone().unwrap_or(begin..end);
    let zoomed = |size: u32| (f64::from(size) * zoom) as u32;
    let text = |size: u32| ("sans-serif", zoomed(size)).into_font().color(&GREY);
    let mut chart = ChartBuilder::on(canvas)
        .caption(&panel.title, text(46))
        .margin(20)
        .margin_right(40)
        .x_label_area_size(zoomed(90))
        .y_label_area_size(zoomed(130))
        .build_cartesian_2d(shown.clone(), low - margin..high + above * margin)?;
    let mesh = &mut chart.configure_mesh();
    mesh.x_desc(&panel.x_label).y_desc(&panel.y_label).x_labels(7).y_labels(6).axis_desc_style(text(38));
    let (x_digits, y_digits) = (digits(shown.end - shown.start), digits(high - low));
    let x_text = |x: &f64| number(*x, x_digits);
    let y_text = |y: &f64| number(*y, y_digits);
    mesh.x_label_formatter(&x_text).y_label_formatter(&y_text);
    mesh.label_style(text(36)).light_line_style(TRANSPARENT).bold_line_style(GREY.mix(0.2)).draw()?;
    for line in &panel.lines {
        let style = line.color.stroke_width(line.width);
        let parts = line.points.split(|(x, y)| !x.is_finite() || !y.is_finite());
        for (k, part) in parts.filter(|part| !part.is_empty()).enumerate() {
            let series = chart.draw_series(LineSeries::new(part.iter().copied(), style))?;
            if k == 0 {
                series.label(&line.label);
                series.legend(move |(x, y)| PathElement::new([(x, y), (x + 40, y)], style.stroke_width(8)));
            }
        }
    }
    let legend = &mut chart.configure_series_labels();
    legend.position(SeriesLabelPosition::UpperRight).legend_area_size(60).margin(8);
    legend.label_font(text(38)).background_style(WHITE.mix(0.85)).draw()?;
    Ok(())
}

/// Decimals of the labels of an axis of this length, with some six labels.
fn digits(length: f64) -> usize {
    if length >= 3.8 { 0 } else { (0.8 - length.log10()).ceil().max(0.0) as usize }
}

fn number(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    if text.trim_matches(['-', '0', '.']).is_empty() { "0".to_owned() } else { text }
}

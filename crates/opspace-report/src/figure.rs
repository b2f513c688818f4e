//! Figures as inline SVG: signals over time in a grid of panels, and dot charts that compare runs.
//!
//! They are drawn by `plotters`, which panics if a range is empty or NaN, rounds coordinates to integers, and draws
//! all samples. Therefore ranges are checked, the canvas has a higher resolution than the page, and lines are reduced
//! to the samples that are visible on a screen. Values that are not finite are not drawn; a panel without data
//! contains a remark.

use opspace_experiment::evaluate::spread::Spread;
use opspace_experiment::text::format_short;
use std::ops::Range;

use plotters::coord::Shift;
use plotters::coord::ranged1d::{BoldPoints, DefaultFormatting, KeyPointHint, Ranged};
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Figure: panels with one caption.
#[derive(Clone, Debug, Default)]
pub struct Figure {
    /// Title: the quantity shown, in a few words.
    pub title: String,
    /// Caption: explanation of the figure.
    pub caption: String,
    /// Statement about this run alone, at the end of the caption; a figure of several runs lacks it.
    pub remark: String,
    /// Panels, in reading order.
    pub panels: Vec<Panel>,
    /// Number of panels side by side, at most four; `None` arranges up to three in one column, and more in two.
    pub columns: Option<usize>,
    /// True if a page with several runs of one task draws this figure of all runs over each other, too.
    pub overlays: bool,
}

/// Panel of a figure: one pair of axes.
#[derive(Clone, Debug, Default)]
pub struct Panel {
    /// Name of the joint or the axis.
    pub title: String,
    /// Quantity and unit of the abscissa: `time (s)`.
    pub x_label: String,
    /// Quantity and unit of the ordinate: `torque (N·m)`.
    pub y_label: String,
    /// Lines in the order of drawing; thin lines are drawn first and desired quantities last. A label has the same colour
    /// in the whole figure.
    pub series: Vec<Series>,
    /// Vertical lines behind the others, with labels: (x, label). An empty label is not drawn.
    pub marks: Vec<(f64, String)>,
    /// Abscissa from which on values determine the range of the ordinate; values before it are cut off where they exceed
    /// this range. All values if `None`.
    pub range_from_x: Option<f64>,
    /// Scale of the abscissa: linear or logarithmic.
    pub x_scale: Scale,
    /// Scale of the ordinate: linear or logarithmic.
    pub y_scale: Scale,
    /// True if lengths in m are drawn in mm from the first value of the first line.
    pub is_from_start: bool,
    /// Limits of the quantity: lines are added where a run comes near them.
    pub limits: Option<Range<f64>>,
    /// Values of the abscissa that have ticks; none for usual ticks.
    pub x_ticks: Vec<f64>,
    /// Range that the ordinate includes, whatever the values; that of the values if `None`.
    pub y_range: Option<Range<f64>>,
    /// True if a unit has the same length on both axes: a path in a plane.
    pub has_equal_scales: bool,
}

/// A line: `y` over `x`, of equal lengths; a value that is not finite interrupts it.
#[derive(Clone, Debug, Default)]
pub struct Series {
    /// Name in the legend.
    pub label: String,
    /// Values on the abscissa.
    pub x: Vec<f64>,
    /// Values on the ordinate.
    pub y: Vec<f64>,
    /// Style of the line.
    pub style: Style,
    /// Place of its colour in the palette; by the order of first appearance if `None`.
    pub color: Option<usize>,
}

/// Style of a line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Style {
    /// A measured quantity.
    #[default]
    Solid,
    /// A desired quantity: thin and dark, so that it is visible on the wide, bright line of the measured quantity.
    Desired,
    /// A quantity in the background: raw signals, bounds.
    Thin,
    /// Samples without a connecting line: points of a measured frequency response.
    Dots,
    /// A line with a dot at each sample: few values over a setting.
    Marked,
    /// A shaded area with this outline, in the colour of the line of the same label: an interval.
    Band,
}

/// Dot chart with one scale: a row for each compared item, a colour for each series.
#[derive(Clone, Debug, Default)]
pub struct Comparison {
    /// Title: the quantity compared, in a few words.
    pub title: String,
    /// Caption: explanation of the comparison.
    pub caption: String,
    /// Quantity and unit of the scale.
    pub x_label: String,
    /// Names in the legend, one for each value of a row.
    pub series: Vec<String>,
    /// Rows, top to bottom.
    pub rows: Vec<ComparisonRow>,
    /// Scale of the horizontal axis.
    pub scale: Scale,
}

/// Row of a [`Comparison`].
#[derive(Clone, Debug, Default)]
pub struct ComparisonRow {
    /// Name of the task or the metric.
    pub label: String,
    /// Values with their intervals, one per series; `None` if missing.
    pub values: Vec<Option<Spread>>,
}

/// Scale of an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scale {
    /// Linear; in a comparison the axis includes zero.
    #[default]
    Linear,
    /// Logarithmic (base 10); only positive values can be shown.
    Log,
}

impl Scale {
    /// Coordinates of values on the axis: on a logarithmic scale their logarithms, NaN for values that are not
    /// positive.
    fn of(self, values: &[f64]) -> Vec<f64> {
        match self {
            Self::Linear => values.to_vec(),
            Self::Log => values.iter().map(|v| if *v > 0.0 { v.log10() } else { f64::NAN }).collect(),
        }
    }
}

impl Series {
    /// Creates a solid line.
    pub fn new(label: impl Into<String>, x: Vec<f64>, y: Vec<f64>) -> Self {
        Self { label: label.into(), x, y, style: Style::Solid, color: None }
    }

    /// Returns the line with only the samples that differ on a screen of `columns` columns: its memory does not grow with
    /// the duration of a run.
    #[must_use]
    pub fn thinned(self, columns: usize) -> Self {
        let Some(range) = range(self.x.iter().copied()).filter(|range| range.end > range.start) else {
            return self;
        };
        if self.x.len() <= 4 * columns {
            return self;
        }
        let (mut x, mut y) = (Vec::new(), Vec::new());
        for stretch in decimate(&self.x, &self.y, (range.start, range.end), columns) {
            if !x.is_empty() {
                // A value that is not finite interrupts the line.
                x.push(f64::NAN);
                y.push(f64::NAN);
            }
            x.extend(stretch.iter().map(|(x, _)| *x));
            y.extend(stretch.iter().map(|(_, y)| *y));
        }
        Self { x, y, ..self }
    }

    /// Returns the line with a colour of the palette.
    #[must_use]
    pub(crate) fn color(self, place: usize) -> Self {
        Self { color: Some(place), ..self }
    }

    /// Returns the line with another style.
    #[must_use]
    pub fn style(self, style: Style) -> Self {
        Self { style, ..self }
    }
}

/// Colour of text, axes and desired quantities; the dark scheme of the page replaces it by a light colour.
pub(crate) const INK: RGBColor = RGBColor(0x1c, 0x20, 0x24);

/// Palette of Okabe and Ito (2008), which is suitable for colour-blind readers. It begins with the colours on which a
/// thin dark line is clearly visible. Each colour has a replacement for the dark scheme of the page.
pub(crate) const PALETTE: [(RGBColor, &str); 6] = [
    (RGBColor(0x56, 0xb4, 0xe9), "#2b87c4"),
    (RGBColor(0xe6, 0x9f, 0x00), "#c27a12"),
    (RGBColor(0x00, 0x9e, 0x73), "#1d9a75"),
    (RGBColor(0xcc, 0x79, 0xa7), "#b5628f"),
    (RGBColor(0xd5, 0x5e, 0x00), "#d8631f"),
    (RGBColor(0x00, 0x72, 0xb2), "#5fa8e6"),
];

/// Canvas units per pixel of the page.
const FINENESS: i32 = 4;
pub(crate) const WIDTH: i32 = px(960);
pub(crate) const LEGEND_ROW: i32 = px(24);
/// Length of a line in the legend.
pub(crate) const SAMPLE: i32 = px(28);
/// Height of the label of a mark.
const LABEL_ROW: i32 = px(15);
/// Height of the label of a mark, relative to that of the lines in a low panel.
const LABEL_SHARE: f64 = 0.14;
/// Radius of a measured point.
const DOT: i32 = px(3);

pub(crate) const fn px(pixels: i32) -> i32 {
    pixels * FINENESS
}

pub(crate) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
pub(crate) type Chart<'a> = ChartContext<'a, SVGBackend<'a>, Cartesian2d<Coordinate, Coordinate>>;
pub(crate) type Drawn<T = ()> = Result<T, DrawingAreaErrorKind<std::io::Error>>;

impl Figure {
    /// Draws the figure as one `<svg>` element with the width of its parent element.
    #[must_use]
    pub fn svg(&self) -> String {
        let count = self.panels.len().max(1);
        let columns = self.columns.unwrap_or(if count <= 3 { 1 } else { 2 }).clamp(1, count.min(4));
        let rows = count.div_ceil(columns);
        let entries = self.legend();
        // A single line needs no name beside the title.
        let named = if entries.len() > 1 { &entries[..] } else { &[] };
        let labels: Vec<&str> = named.iter().map(|entry| entry.0).collect();
        let top = legend_height(&labels);
        let is_plane = self.panels.iter().any(|panel| panel.has_equal_scales);
        let row = match (columns, rows) {
            _ if is_plane => 360,
            (1, 2..) => 205,
            _ => 245,
        };
        let height = top + rows as i32 * px(row);
        canvas(&self.title, &self.caption, (WIDTH, height), |root| {
            let (strip, grid) = root.split_vertically(top);
            draw_legend(&strip, &labels, |area, place| {
                let (label, style) = entries[place];
                if self.has_style(label, Style::Marked) {
                    area.draw(&Circle::new((SAMPLE / 2, LEGEND_ROW / 2), DOT, style.filled()))?;
                }
                if self.has_style(label, Style::Dots) {
                    return area.draw(&Circle::new((SAMPLE / 2, LEGEND_ROW / 2), DOT, style.filled()));
                }
                let line = vec![(0, LEGEND_ROW / 2), (SAMPLE, LEGEND_ROW / 2)];
                area.draw(&PathElement::new(line, style))
            })?;
            if self.panels.is_empty() {
                say(&grid, "no data")?;
            }
            let areas = grid.split_evenly((rows, columns));
            self.panels.iter().zip(&areas).try_for_each(|(panel, area)| panel.draw(area, &entries))
        })
    }

    /// True if a line shows a desired quantity.
    pub(crate) fn has_desired_lines(&self) -> bool {
        let is_desired = |line: &Series| line.style == Style::Desired && line.y.iter().any(|y| y.is_finite());
        self.panels.iter().flat_map(|panel| &panel.series).any(is_desired)
    }

    fn has_style(&self, label: &str, style: Style) -> bool {
        let mut series = self.panels.iter().flat_map(|panel| &panel.series);
        series.any(|series| series.label == label && series.style == style)
    }

    /// Labels in order of first appearance, with the style that each has in the whole figure.
    fn legend(&self) -> Vec<(&str, ShapeStyle)> {
        let mut legend: Vec<(&str, ShapeStyle)> = Vec::new();
        let (mut desired, mut others) = (0, 0);
        for series in self.panels.iter().flat_map(|panel| &panel.series) {
            if legend.iter().any(|(label, _)| *label == series.label) {
                continue;
            }
            let (place, width, opacity) = match series.style {
                Style::Solid | Style::Dots | Style::Marked | Style::Band => (&mut others, 10, 1.0),
                Style::Desired => (&mut desired, 5, 1.0),
                Style::Thin => (&mut others, 5, 0.9),
            };
            // Further desired lines get different colours, from the end of the palette.
            let color = match (series.style, *place) {
                (Style::Desired, 0) => INK,
                (Style::Desired, place) => PALETTE[5 * place % 6].0,
                (_, place) => PALETTE[series.color.unwrap_or(place) % 6].0,
            };
            *place += 1;
            legend.push((&series.label, color.mix(opacity).stroke_width(width)));
        }
        legend
    }
}

impl Panel {
    fn draw(&self, area: &Area<'_>, legend: &[(&str, ShapeStyle)]) -> Drawn {
        // On logarithmic axes, all values are replaced by their logarithms.
        let scaled = Self {
            series: (self.series.iter())
                .map(|s| Series { x: self.x_scale.of(&s.x), y: self.y_scale.of(&s.y), ..s.clone() })
                .collect(),
            y_range: self
                .y_range
                .as_ref()
                .and_then(|y| range(self.y_scale.of(&[y.start, y.end]).into_iter())),
            ..self.clone()
        };
        scaled.draw_scaled(area, legend)
    }

    fn draw_scaled(&self, area: &Area<'_>, legend: &[(&str, ShapeStyle)]) -> Drawn {
        let samples = || {
            let samples = self.series.iter().flat_map(|series| series.x.iter().zip(&series.y));
            samples.filter(|(x, y)| x.is_finite() && y.is_finite())
        };
        let all = range(samples().map(|(_, y)| *y));
        let shown = samples().filter(|(x, _)| self.range_from_x.is_none_or(|from| **x >= from));
        // With zero, so that a line which begins there is not cut off at its other end.
        let with_zero = |y: Range<f64>| match self.range_from_x {
            Some(_) => y.start.min(0.0)..y.end.max(0.0),
            None => y,
        };
        let included = self.y_range.iter().flat_map(|y| [&y.start, &y.end]);
        let y = range(shown.map(|(_, y)| y).chain(included).copied()).map(with_zero).or_else(|| all.clone());
        let mut remarks = self.remarks();
        if let (Some(all), Some(y), Some(from)) = (&all, &y, self.range_from_x) {
            let largest = |range: &Range<f64>| range.start.abs().max(range.end.abs());
            if largest(all) > largest(y) {
                remarks.push(format!(
                    "cut off before {} s: up to {}",
                    format_short(from),
                    format_short(largest(all))
                ));
            }
        }
        let title = match remarks.join("; ") {
            none if none.is_empty() => self.title.clone(),
            remarks => format!("{} ({remarks})", self.title),
        };
        let (Some(x), Some(y)) = (range(samples().map(|(x, _)| *x)), y) else {
            return say(area, &title);
        };
        let (x, y) = if self.has_equal_scales { equal_scales(area, x, y) } else { (x, y) };
        let mut y = match self.y_scale {
            Scale::Linear => Axis::linear(y, 0.06, &self.y_label, 7),
            Scale::Log => Axis::decades(y, &self.y_label),
        };
        // Panels in a column have the same left edge, unless one has long tick labels.
        let left = px(72).max(px(28) + y.widest());
        let x = match self.x_scale {
            Scale::Linear => {
                Axis::linear(x, 0.005, &self.x_label, (area.dim_in_pixel().0 as i32 - left) / px(70))
            }
            Scale::Log => Axis::decades(x, &self.x_label),
        };
        let width = area.dim_in_pixel().0 as i32 - left - px(20);
        let x = if self.x_ticks.is_empty() { x } else { x.at(&self.x_ticks, self.x_scale, width) };
        let drawn = y.range.clone();
        let mut marks: Vec<(f64, &str)> = self
            .marks
            .iter()
            .map(|(at, label)| (x.place(self.x_scale.of(&[*at])[0]), label.as_str()))
            .collect();
        marks.retain(|(at, _)| x.range.contains(at));
        // Labels are above the lines, each below the one before.
        let labels = marks.iter().filter(|(_, label)| !label.is_empty()).count();
        y.range.end += LABEL_SHARE * labels as f64 * (drawn.end - drawn.start);
        let mut chart = chart(area, &title, left, &x, &y)?;
        let mut row = 0;
        for (at, label) in marks {
            // An event does not cross the labels.
            let high = if label.is_empty() { drawn.end } else { y.range.end };
            Self::mark(&mut chart, (at, y.range.start..high), label, row)?;
            row += i32::from(!label.is_empty());
        }
        let mut series: Vec<&Series> = self.series.iter().collect();
        series.sort_by_key(|series| match series.style {
            Style::Band => 0,
            Style::Thin => 1,
            Style::Solid | Style::Dots | Style::Marked => 2,
            Style::Desired => 3,
        });
        for series in series {
            let style = legend.iter().find(|(label, _)| *label == series.label).map(|(_, style)| *style);
            let style = style.unwrap_or(INK.into());
            match self.range_from_x {
                None => series.draw(&mut chart, &x, &y, style)?,
                Some(_) => {
                    let shown = |value: &f64| drawn.contains(&y.place(*value));
                    let y_values = series.y.iter().map(|v| if shown(v) { *v } else { f64::NAN }).collect();
                    Series { y: y_values, ..series.clone() }.draw(&mut chart, &x, &y, style)?;
                }
            }
        }
        Ok(())
    }

    /// Remarks on series that cannot be shown; none if all can be shown.
    fn remarks(&self) -> Vec<String> {
        let known: Vec<_> = self.series.iter().map(Series::range).collect();
        if known.iter().all(Result::is_err) {
            let empty = known.iter().all(|range| *range == Err("no data"));
            return vec![if empty { "no data" } else { "no finite value" }.to_owned()];
        }
        let named = self.series.iter().zip(&known);
        let mut remarks: Vec<String> = named
            .filter_map(|(series, range)| Some(format!("{}: {}", series.label, range.as_ref().err()?)))
            .collect();
        if known.iter().flatten().all(is_point) {
            remarks.push("constant".to_owned());
        }
        remarks
    }

    /// Draws a vertical line with a label in the given row of labels.
    fn mark(chart: &mut Chart<'_>, (x, y): (f64, Range<f64>), label: &str, row: i32) -> Drawn {
        let visible = chart.x_range();
        let (low, high) = (y.start, y.end);
        let line = INK.mix(0.55).stroke_width(4);
        chart.draw_series([PathElement::new(vec![(x, low), (x, high)], line)])?;
        if label.is_empty() {
            return Ok(());
        }
        let left_half = x < (visible.start + visible.end) / 2.0;
        let (anchor, offset) = if left_half { (HPos::Left, px(5)) } else { (HPos::Right, px(-5)) };
        let style = text(12, FontStyle::Italic).pos(Pos::new(anchor, VPos::Top));
        let word = EmptyElement::at((x, high))
            + Text::new(printable(label), (offset, px(2) + row * LABEL_ROW), style);
        chart.draw_series([word])?;
        Ok(())
    }
}

impl Series {
    /// Range of the values that can be drawn; the reason if there are none.
    fn range(&self) -> Result<Range<f64>, &'static str> {
        let samples = self.x.iter().zip(&self.y).filter(|(x, _)| x.is_finite());
        range(samples.map(|(_, y)| *y)).ok_or(if self.x.is_empty() || self.y.is_empty() {
            "no data"
        } else {
            "no finite value"
        })
    }

    fn draw(&self, chart: &mut Chart<'_>, x: &Axis<'_>, y: &Axis<'_>, style: ShapeStyle) -> Drawn {
        let columns = chart.plotting_area().dim_in_pixel().0 / FINENESS as u32;
        let placed_x: Vec<f64> = self.x.iter().map(|value| x.place(*value)).collect();
        let placed_y: Vec<f64> = self.y.iter().map(|value| y.place(*value)).collect();
        if self.style == Style::Dots {
            let dots = placed_x.into_iter().zip(placed_y).filter(|(x, y)| x.is_finite() && y.is_finite());
            chart.draw_series(dots.map(|at| Circle::new(at, DOT, style.filled())))?;
            return Ok(());
        }
        if self.style == Style::Band {
            let outline: Vec<(f64, f64)> = placed_x.into_iter().zip(placed_y).collect();
            if outline.iter().all(|(x, y)| x.is_finite() && y.is_finite()) {
                chart.draw_series([Polygon::new(outline, style.color.mix(0.22).filled())])?;
            }
            return Ok(());
        }
        if self.style == Style::Marked {
            let all = placed_x.iter().copied().zip(placed_y.iter().copied());
            let dots = all.filter(|(x, y)| x.is_finite() && y.is_finite());
            chart.draw_series(dots.map(|at| Circle::new(at, DOT, style.filled())))?;
        }
        for stretch in decimate(&placed_x, &placed_y, (x.range.start, x.range.end), columns as usize) {
            // A single sample between two gaps is not part of a line.
            if let [alone] = stretch[..] {
                chart.draw_series([Circle::new(alone, px(3), style.filled())])?;
            } else {
                chart.draw_series(LineSeries::new(stretch, style))?;
            }
        }
        Ok(())
    }
}

impl Comparison {
    /// Draws the comparison as one `<svg>` element with the width of its parent element.
    #[must_use]
    pub fn svg(&self) -> String {
        let scaled = |value: f64| if self.scale == Scale::Log { value.log10() } else { value };
        let spreads = || self.rows.iter().flat_map(|row| row.values.iter().flatten());
        let hidden = spreads().filter(|spread| !scaled(spread.median).is_finite()).count();
        let ends = spreads().flat_map(|spread| [spread.low, spread.median, spread.high].map(scaled));
        let labels: Vec<&str> = self.series.iter().map(String::as_str).collect();
        let top = legend_height(&labels);
        // Values have lines of their own within a row.
        let count = |row: &ComparisonRow| row.values.iter().flatten().count();
        let lines = self.rows.iter().map(count).max().unwrap_or(0).max(1);
        let height = px(71 + 24.max(12 * lines as i32 + 12) * self.rows.len() as i32);
        canvas(&self.title, &self.caption, (WIDTH, top + height), |root| {
            let (strip, area) = root.split_vertically(top);
            draw_legend(&strip, &labels, |area, place| dot(area, (SAMPLE / 2, LEGEND_ROW / 2), place))?;
            let Some(range) = range(ends) else { return say(&area, "no data") };
            let x = match self.scale {
                Scale::Linear => {
                    Axis::linear(range.start.min(0.0)..range.end.max(0.0), 0.02, &self.x_label, 8)
                }
                Scale::Log => Axis::decades(range, &self.x_label),
            };
            let y = Axis::rows(&self.rows);
            let note = match hidden {
                0 => String::new(),
                count => format!("{count} not shown: not finite, or not above 0"),
            };
            let left = px(24) + y.widest().min(WIDTH * 2 / 5);
            let chart = chart(&area, &note, left, &x, &y)?;
            for (row, line) in self.rows.iter().enumerate() {
                let own =
                    line.values.iter().enumerate().filter_map(|(place, value)| Some((place, (*value)?)));
                for (rank, (place, spread)) in own.enumerate() {
                    let at = |value: f64| {
                        let placed = Some(x.place(scaled(value))).filter(|value| value.is_finite());
                        let line = (rank as f64 + 1.0) / (count(line) as f64 + 1.0) - 0.5;
                        placed.map(|value| chart.backend_coord(&(value, row as f64 + line)))
                    };
                    if let (Some(low), Some(high)) = (at(spread.low), at(spread.high)) {
                        let color = PALETTE[place % PALETTE.len()].0;
                        root.draw(&PathElement::new(vec![low, high], color.stroke_width(6)))?;
                    }
                    if let Some(at) = at(spread.median) {
                        dot(root, at, place)?;
                    }
                }
            }
            Ok(())
        })
    }
}

/// Draws a dot of a series. Series differ in colour and in shape: discs, rings, triangles.
fn dot(area: &Area<'_>, at: (i32, i32), place: usize) -> Drawn {
    let color = PALETTE[place % PALETTE.len()].0;
    // A seventh series has the first colour and another shape.
    match (place + place / PALETTE.len()) % 3 {
        0 => area.draw(&Circle::new(at, px(6), color.filled())),
        1 => area.draw(&Circle::new(at, px(5), color.stroke_width(11))),
        _ => area.draw(&TriangleMarker::new(at, px(8), color.filled())),
    }
}

/// Reduces a line to the samples that a screen can show: for each of `columns` equal parts of `range`, the first,
/// lowest, highest and last sample of each pass through it. Each inner vector is a section without a gap; a gap
/// between samples in the same part is too narrow to be visible and is ignored.
#[must_use]
pub fn decimate(x: &[f64], y: &[f64], range: (f64, f64), columns: usize) -> Vec<Vec<(f64, f64)>> {
    let per_column = columns as f64 / (range.1 - range.0);
    let column = |x: f64| ((x - range.0) * per_column).floor();
    let mut stretches = Vec::new();
    let mut stretch: Vec<(f64, f64)> = Vec::new();
    let mut run: Vec<(f64, f64)> = Vec::new();
    let mut gap = false;
    for (&x, &y) in x.iter().zip(y) {
        if !(x.is_finite() && y.is_finite()) {
            gap = true;
            continue;
        }
        if run.last().is_some_and(|&(last, _)| column(last) != column(x)) {
            keep_extremes(&mut run, &mut stretch);
            if gap {
                stretches.push(std::mem::take(&mut stretch));
            }
        }
        run.push((x, y));
        gap = false;
    }
    keep_extremes(&mut run, &mut stretch);
    if !stretch.is_empty() {
        stretches.push(stretch);
    }
    stretches
}

/// Moves the first, lowest, highest and last sample of a run to `kept`, in order.
fn keep_extremes(run: &mut Vec<(f64, f64)>, kept: &mut Vec<(f64, f64)>) {
    let by_height = |a: &(usize, f64), b: &(usize, f64)| a.1.total_cmp(&b.1);
    let heights = || run.iter().map(|&(_, y)| y).enumerate();
    if let (Some((low, _)), Some((high, _))) = (heights().min_by(by_height), heights().max_by(by_height)) {
        let mut indices = [0, low.min(high), low.max(high), run.len() - 1];
        indices.sort_unstable();
        let mut last = None;
        for index in indices {
            if last != Some(index) {
                kept.push(run[index]);
            }
            last = Some(index);
        }
    }
    run.clear();
}

/// Range of the finite values; `None` if there are none.
pub(crate) fn range(values: impl Iterator<Item = f64>) -> Option<Range<f64>> {
    values.filter(|value| value.is_finite()).fold(None, |range: Option<Range<f64>>, value| {
        let range = range.unwrap_or(value..value);
        Some(range.start.min(value)..range.end.max(value))
    })
}

/// Extends one of two ranges of a panel, so that a unit has the same length on both axes.
fn equal_scales(area: &Area<'_>, x: Range<f64>, y: Range<f64>) -> (Range<f64>, Range<f64>) {
    let (width, height) = area.dim_in_pixel();
    // Without labels and ticks, and the margins of the ordinate.
    let width = f64::from(width as i32 - px(92)).max(1.0);
    let height = (f64::from(height as i32 - px(74)) / 1.12).max(1.0);
    let unit = ((x.end - x.start) / width).max((y.end - y.start) / height);
    let around = |range: Range<f64>, size: f64| {
        let (middle, half) = (0.5 * (range.start + range.end), 0.5 * unit * size);
        range.start.min(middle - half)..range.end.max(middle + half)
    };
    (around(x, width), around(y, height))
}

/// True if the ends of a range are too close to be distinguished on an axis in f64.
fn is_point(range: &Range<f64>) -> bool {
    range.end / 2.0 - range.start / 2.0 <= 1e-12 * range.start.abs().max(range.end.abs())
}

/// Axis in units of a power of ten, so that ranges of any magnitude can be drawn.
pub(crate) struct Axis<'a> {
    range: Range<f64>,
    exponent: i32,
    label: String,
    /// Ticks, in units of `range`.
    ticks: Vec<f64>,
    text: Box<dyn Fn(&f64) -> String + 'a>,
}

impl<'a> Axis<'a> {
    /// Creates a linear axis that extends beyond `range` by the fraction `share` at each end, with at most so many ticks.
    pub(crate) fn linear(range: Range<f64>, share: f64, label: &str, ticks: i32) -> Self {
        let largest = range.start.abs().max(range.end.abs());
        let exponent = match largest {
            0.0 | 1e-3..1e5 => 0,
            _ => ((largest.log10() / 3.0).floor() * 3.0).clamp(-300.0, 306.0) as i32,
        };
        let unit = 10f64.powi(exponent);
        let (low, high) = (range.start / unit, range.end / unit);
        let pad = match is_point(&range) {
            false => share * (high - low),
            true if largest == 0.0 => 1.0,
            true => largest / unit / 2.0,
        };
        let range = low - pad..high + pad;
        // Twelve significant digits: further digits would show rounding errors.
        let digits = 11 - range.end.abs().max(range.start.abs()).log10().floor() as i32;
        let fine = 10f64.powi(digits);
        Self {
            exponent,
            label: match exponent {
                0 => label.to_owned(),
                _ => format!("{label} × {}", power_of_ten(exponent)),
            },
            ticks: RangedCoordf64::from(range.clone()).key_points(BoldPoints(ticks.max(2) as usize)),
            range,
            // `+ 0.0` turns −0 into 0.
            text: Box::new(move |tick| ((tick * fine).round() / fine + 0.0).to_string().replace('-', "−")),
        }
    }

    /// Creates a logarithmic axis for a range of decimal logarithms, extended to whole powers of ten, and below if the least
    /// value is one.
    pub(crate) fn decades(range: Range<f64>, label: &str) -> Self {
        const BELOW: f64 = 0.3;
        let low = range.start.floor();
        let high = range.end.ceil().max(low + 1.0);
        let step = ((high - low) / 8.0).ceil() as usize;
        let ticks: Vec<f64> = (low as i32..=high as i32).step_by(step).map(f64::from).collect();
        let is_short = ticks.iter().all(|tick| tick.abs() <= SHORT_POWER);
        Self {
            range: if range.start > low { low } else { low - BELOW }..high,
            exponent: 0,
            label: label.to_owned(),
            ticks,
            text: Box::new(move |tick| match is_short {
                true => power_of_ten(tick.round() as i32),
                false => raised_power_of_ten(tick.round() as i32),
            }),
        }
    }

    /// Replaces the ticks by these values, as far as their texts have room in `width`, and leaves some space beside them.
    fn at(self, values: &[f64], scale: Scale, width: i32) -> Axis<'static> {
        const BESIDE: f64 = 0.06;
        let places = scale.of(values);
        let Some(placed) = range(places.iter().copied()) else {
            return Axis {
                range: self.range,
                exponent: 0,
                label: self.label,
                ticks: Vec::new(),
                text: Box::new(|_| String::new()),
            };
        };
        let span = if is_point(&placed) { 1.0 } else { placed.end - placed.start };
        let range = placed.start - BESIDE * span..placed.end + BESIDE * span;
        let per_unit = f64::from(width) / (range.end - range.start);
        let mut named: Vec<(f64, String)> = Vec::new();
        let mut free = f64::NEG_INFINITY;
        for (place, value) in places.iter().zip(values) {
            let text = value.to_string().replace('-', "−");
            let half = f64::from(text_width(&text)) / 2.0;
            if place.is_finite() && per_unit * place - half > free {
                free = per_unit * place + half;
                named.push((*place, text));
            }
        }
        Axis {
            range,
            exponent: 0,
            label: self.label,
            ticks: named.iter().map(|(place, _)| *place).collect(),
            text: Box::new(move |tick| {
                let nearest = named.iter().min_by(|a, b| (a.0 - tick).abs().total_cmp(&(b.0 - tick).abs()));
                nearest.map_or_else(String::new, |(_, text)| text.clone())
            }),
        }
    }

    /// Creates an axis with one tick per row, top to bottom.
    pub(crate) fn rows(rows: &'a [ComparisonRow]) -> Self {
        Self {
            range: rows.len() as f64 - 0.5..-0.5,
            exponent: 0,
            label: String::new(),
            ticks: (0..rows.len()).map(|row| row as f64).collect(),
            text: Box::new(|row| rows.get(row.round() as usize).map_or("", |row| &row.label).to_owned()),
        }
    }

    /// Returns the axis without texts at its ticks.
    pub(crate) fn without_texts(self) -> Self {
        Self { text: Box::new(|_| String::new()), ..self }
    }

    /// Estimated width of the longest tick text.
    pub(crate) fn widest(&self) -> i32 {
        self.ticks.iter().map(|tick| text_width(&(self.text)(tick))).max().unwrap_or(0)
    }

    fn coordinate(&self) -> Coordinate {
        Coordinate { linear: self.range.clone().into(), ticks: self.ticks.clone() }
    }

    /// Coordinate of a value on the axis, in units of `range`.
    pub(crate) fn place(&self, value: f64) -> f64 {
        value / 10f64.powi(self.exponent)
    }
}

/// Largest magnitude of an exponent whose power of ten is written in full.
const SHORT_POWER: f64 = 4.0;

fn power_of_ten(exponent: i32) -> String {
    match f64::from(exponent).abs() <= SHORT_POWER {
        true => format!("{:.*}", (-exponent).max(0) as usize, 10f64.powi(exponent)),
        false => raised_power_of_ten(exponent),
    }
}

fn raised_power_of_ten(exponent: i32) -> String {
    let raised = |c: char| match c.to_digit(10) {
        Some(digit) => ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'][digit as usize],
        None => '⁻',
    };
    format!("10{}", exponent.to_string().chars().map(raised).collect::<String>())
}

/// Linear coordinate with given ticks.
pub(crate) struct Coordinate {
    linear: RangedCoordf64,
    ticks: Vec<f64>,
}

impl Ranged for Coordinate {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        self.linear.map(value, limit)
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        if hint.weight().allow_light_points() { Vec::new() } else { self.ticks.clone() }
    }

    fn range(&self) -> Range<f64> {
        self.linear.range()
    }
}

/// Draws axes and their labels, and returns the chart into which the values are drawn.
pub(crate) fn chart<'a>(
    area: &Area<'a>,
    title: &str,
    left: i32,
    x: &Axis<'_>,
    y: &Axis<'_>,
) -> Drawn<Chart<'a>> {
    area.draw_text(&printable(title), &text(13, FontStyle::Bold), (left, px(8)))?;
    let mut chart = ChartBuilder::on(area)
        .margin_top(px(28))
        .margin_right(px(20))
        .x_label_area_size(px(43))
        .y_label_area_size(left)
        .build_cartesian_2d(x.coordinate(), y.coordinate())?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(INK.mix(0.12).stroke_width(4))
        .axis_style(INK.mix(0.55).stroke_width(4))
        .set_all_tick_mark_size(px(4))
        .label_style(text(12, FontStyle::Normal))
        .axis_desc_style(text(13, FontStyle::Normal))
        .x_label_formatter(&|tick| printable(&(x.text)(tick)))
        .y_label_formatter(&|tick| printable(&(y.text)(tick)))
        .x_desc(printable(&x.label))
        .y_desc(printable(&y.label))
        .draw()?;
    Ok(chart)
}

pub(crate) fn text<'a>(size: i32, style: FontStyle) -> TextStyle<'a> {
    // plotters draws text at 1/1.24 of the requested size.
    (FontFamily::SansSerif, px(size) * 124 / 100, style, &INK).into_text_style(&(0, 0))
}

/// Upper estimate of the width of a text; no font metrics are available.
pub(crate) fn text_width(text: &str) -> i32 {
    text.chars().count() as i32 * px(13) * 56 / 100
}

/// Draws a text in the middle of an otherwise empty area.
fn say(area: &Area<'_>, what: &str) -> Drawn {
    let (width, height) = area.dim_in_pixel();
    let style = text(13, FontStyle::Italic).pos(Pos::new(HPos::Center, VPos::Center));
    area.draw_text(&printable(what), &style, (width as i32 / 2, height as i32 / 2))
}

/// Number of columns of the legend, and their width.
fn legend_columns(labels: &[&str]) -> (usize, i32) {
    let widest = labels.iter().map(|label| text_width(label)).max().unwrap_or(0);
    let width = SAMPLE + widest + px(32);
    ((WIDTH / width).max(1) as usize, width)
}

pub(crate) fn legend_height(labels: &[&str]) -> i32 {
    labels.len().div_ceil(legend_columns(labels).0) as i32 * LEGEND_ROW
}

pub(crate) fn draw_legend(
    strip: &Area<'_>,
    labels: &[&str],
    sample: impl Fn(&Area<'_>, usize) -> Drawn,
) -> Drawn {
    let (columns, width) = legend_columns(labels);
    let style = text(13, FontStyle::Normal).pos(Pos::new(HPos::Left, VPos::Center));
    for (place, label) in labels.iter().enumerate() {
        let corner = ((place % columns) as i32 * width, (place / columns) as i32 * LEGEND_ROW);
        let area = strip.clone().shrink(corner, (width, LEGEND_ROW));
        sample(&area, place)?;
        area.draw_text(&printable(label), &style, (SAMPLE + px(8), LEGEND_ROW / 2))?;
    }
    Ok(())
}

/// Wraps a drawing into a scalable `<svg>` element with title and description for screen readers.
pub(crate) fn canvas(
    title: &str,
    caption: &str,
    (width, height): (i32, i32),
    draw: impl FnOnce(&Area<'_>) -> Drawn,
) -> String {
    let mut svg = String::new();
    let drawn = {
        let root = SVGBackend::with_string(&mut svg, (width as u32, height as u32)).into_drawing_area();
        draw(&root).and_then(|()| root.present())
    };
    let failure = drawn.err().map_or_else(String::new, |error| format!(" (incomplete: {error})"));
    // The first line is the `<svg>` tag of plotters, which has a fixed size.
    let body = svg.split_once('\n').map_or("", |(_, body)| body);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" role=\"img\" viewBox=\"0 0 {width} {height}\" \
         stroke-linejoin=\"round\" stroke-linecap=\"round\"><title>{}{failure}</title><desc>{}</desc>\n{body}",
        escape(title),
        escape(caption)
    )
}

/// Replaces the characters that XML forbids.
pub(crate) fn printable(text: &str) -> String {
    let forbidden =
        |c: char| c.is_control() && !matches!(c, '\t' | '\n') || matches!(c, '\u{fffe}' | '\u{ffff}');
    text.replace(forbidden, "\u{fffd}")
}

/// Escapes text for HTML and XML.
pub(crate) fn escape(text: &str) -> String {
    let text = printable(text).replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    text.replace('"', "&quot;").replace('\'', "&#39;")
}

//! Figures as inline SVG: signals over time in a grid of panels, and dots that compare runs.
//!
//! The SVG is written here rather than by a plotting library because its colours must follow the page's light
//! or dark scheme, desired values are dashed, and a line's peaks must survive its reduction to the screen.
//! Text is laid out from an estimate of its width, so no font is needed. Nothing is drawn for a value that
//! is not finite; a panel without data says so.

use std::fmt::Write as _;

/// Panels under one caption.
#[derive(Clone, Debug, Default)]
pub struct Figure {
    /// What is shown, in a few words.
    pub title: String,
    /// What to see in it.
    pub caption: String,
    /// In reading order.
    pub panels: Vec<Panel>,
    /// Panels side by side; `None` stacks up to three, and sets more in two columns.
    pub columns: Option<usize>,
}

/// One pair of axes.
#[derive(Clone, Debug, Default)]
pub struct Panel {
    /// The joint or the axis.
    pub title: String,
    /// Quantity and unit of the abscissa: `time (s)`.
    pub x_label: String,
    /// Quantity and unit of the ordinate: `torque (N·m)`.
    pub y_label: String,
    /// Drawn in this order; a label has one colour throughout a figure.
    pub series: Vec<Series>,
    /// Instants worth a vertical line, with a word: (x, `fault`).
    pub marks: Vec<(f64, String)>,
}

/// A line: `y` over `x`, of equal lengths; a value that is not finite interrupts it.
#[derive(Clone, Debug, Default)]
pub struct Series {
    /// As the legend calls it.
    pub label: String,
    /// Abscissae.
    pub x: Vec<f64>,
    /// Ordinates.
    pub y: Vec<f64>,
    /// How the line looks.
    pub style: Style,
}

/// How a line looks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Style {
    /// What was measured.
    #[default]
    Solid,
    /// What was desired.
    Dashed,
    /// What stands behind: raw signals, bounds.
    Thin,
}

/// Dots on one scale: a row for each thing compared, a colour for each way of doing it.
#[derive(Clone, Debug, Default)]
pub struct Comparison {
    /// What is shown, in a few words.
    pub title: String,
    /// What to see in it.
    pub caption: String,
    /// Quantity and unit of the scale.
    pub x_label: String,
    /// The legend: one name for each value of a row.
    pub series: Vec<String>,
    /// Top to bottom.
    pub rows: Vec<ComparisonRow>,
    /// How values are spread over the width.
    pub scale: Scale,
}

/// One line of a [`Comparison`].
#[derive(Clone, Debug, Default)]
pub struct ComparisonRow {
    /// The task or the metric.
    pub label: String,
    /// One for each series; `None` where there is none.
    pub values: Vec<Option<f64>>,
}

/// How values are spread over an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scale {
    /// Evenly, from zero.
    #[default]
    Linear,
    /// By their decimal logarithm; only positive values can be shown.
    Log,
}

impl Series {
    /// A solid line.
    pub fn new(label: impl Into<String>, x: Vec<f64>, y: Vec<f64>) -> Self {
        Self { label: label.into(), x, y, style: Style::Solid }
    }

    /// The same line in another style.
    #[must_use]
    pub fn style(self, style: Style) -> Self {
        Self { style, ..self }
    }
}

/// Okabe and Ito's palette (2008), legible to all forms of colour vision; the page brightens it where dark.
pub(crate) const PALETTE: [(&str, &str); 6] = [
    ("#0072b2", "#4aa8e8"),
    ("#d55e00", "#ff8a3d"),
    ("#009e73", "#2cc59a"),
    ("#b25a8e", "#e29ac4"),
    ("#a67200", "#e8b83a"),
    ("#555555", "#bbbbbb"),
];

const WIDTH: f64 = 960.0;
const FONT: f64 = 13.0;
/// Mean advance of a proportional font, over its size; on the safe side.
const ADVANCE: f64 = 0.56;
const LEGEND_ROW: f64 = 24.0;

fn text_width(text: &str) -> f64 {
    text.chars().count() as f64 * FONT * ADVANCE
}

impl Figure {
    /// The figure as one `<svg>` element, 960 units wide.
    #[must_use]
    pub fn svg(&self) -> String {
        let legend = self.legend();
        let count = self.panels.len().max(1);
        let columns = self.columns.unwrap_or(if count <= 3 { 1 } else { 2 }).clamp(1, count);
        let rows = count.div_ceil(columns);
        let axes: Vec<Axes> = self.panels.iter().map(Axes::of).collect();
        let tick_width = axes.iter().map(|axes| axes.y.widest_label()).fold(0.0, f64::max);
        let left = 30.0 + tick_width;
        let cell = WIDTH / columns as f64;
        let plot = (cell - left - 14.0, if columns == 1 && rows > 1 { 150.0 } else { 190.0 });
        let mut svg = Svg::default();
        let mut top = svg.legend(&legend, left);
        for row in 0..rows {
            let panels = row * columns..((row + 1) * columns).min(self.panels.len());
            let x_labelled = panels.clone().any(|index| self.shows_x_label(index, columns));
            for index in panels {
                let origin = ((index % columns) as f64 * cell + left, top + 28.0);
                let panel = &self.panels[index];
                svg.panel(panel, &axes[index], origin, plot, &legend);
                if self.shows_y_label(index, columns) {
                    let (x, y) = (origin.0 - left + 14.0, origin.1 + plot.1 / 2.0);
                    let turn = format!(r#" text-anchor="middle" transform="rotate(-90 {x:.1} {y:.1})""#);
                    svg.text((x, y), &turn, &axes[index].y.label(&panel.y_label));
                }
                if self.shows_x_label(index, columns) {
                    let at = (origin.0 + plot.0 / 2.0, origin.1 + plot.1 + 38.0);
                    svg.text(at, r#" text-anchor="middle""#, &axes[index].x.label(&panel.x_label));
                }
            }
            top += 28.0 + plot.1 + if x_labelled { 50.0 } else { 28.0 };
        }
        if self.panels.is_empty() {
            svg.text((WIDTH / 2.0, top + 40.0), r#" text-anchor="middle" class="note""#, "no data");
            top += 80.0;
        }
        svg.finish(&self.title, &self.caption, top)
    }

    /// The legend, in the order in which labels appear. What is desired has the same colours in every figure.
    fn legend(&self) -> Vec<Entry<'_>> {
        let mut legend: Vec<Entry<'_>> = Vec::new();
        for series in self.panels.iter().flat_map(|panel| &panel.series) {
            if legend.iter().any(|entry| entry.label == series.label) {
                continue;
            }
            let desired = series.style == Style::Dashed;
            let before = legend.iter().filter(|entry| (entry.style == Style::Dashed) == desired).count();
            let colors = if desired { [1, 3, 5, 4, 2, 0] } else { [0, 2, 4, 5, 3, 1] };
            legend.push(Entry { label: &series.label, style: series.style, color: colors[before % 6] });
        }
        legend
    }

    /// A panel above one that says the same needs no label.
    fn shows_x_label(&self, index: usize, columns: usize) -> bool {
        self.panels.get(index + columns).is_none_or(|below| below.x_label != self.panels[index].x_label)
    }

    /// Nor does one to the right of one that says the same, in the same power of ten.
    fn shows_y_label(&self, index: usize, columns: usize) -> bool {
        let panel = &self.panels[index];
        let label = |panel: &Panel| Axes::of(panel).y.label(&panel.y_label);
        index.is_multiple_of(columns) || label(&self.panels[index - 1]) != label(panel)
    }
}

/// A name in the legend.
#[derive(Clone, Copy, Debug)]
struct Entry<'a> {
    label: &'a str,
    style: Style,
    /// Place in the palette.
    color: usize,
}

impl Comparison {
    /// The comparison as one `<svg>` element, 960 units wide.
    #[must_use]
    pub fn svg(&self) -> String {
        const ROW: f64 = 30.0;
        let shown = |value: f64| value.is_finite() && (self.scale == Scale::Linear || value > 0.0);
        let placed = |value: f64| if self.scale == Scale::Log { value.log10() } else { value };
        let values = self.rows.iter().flat_map(|row| row.values.iter().flatten().copied());
        let (kept, dropped): (Vec<f64>, Vec<f64>) = values.partition(|&value| shown(value));
        let mut range = Range::of(kept.iter().map(|&value| placed(value)));
        let entries = self.series.iter().enumerate();
        let legend: Vec<Entry<'_>> =
            entries.map(|(color, label)| Entry { label, style: Style::Solid, color }).collect();
        let widest = self.rows.iter().map(|row| text_width(&row.label)).fold(0.0, f64::max);
        let left = 24.0 + widest.min(WIDTH * 0.4);
        let width = WIDTH - left - 40.0;
        let mut svg = Svg::default();
        let top = svg.dot_legend(&legend, left) + 12.0;
        let bottom = top + ROW * self.rows.len() as f64;
        if let Some(range) = &mut range {
            match self.scale {
                Scale::Linear => *range = Range { low: range.low.min(0.0), high: range.high.max(0.0) },
                Scale::Log => *range = Range { low: range.low.floor(), high: range.high.ceil() },
            }
        }
        let axis = match self.scale {
            Scale::Linear => Axis::linear(range),
            Scale::Log => Axis::decades(range),
        };
        for (place, text) in axis.ticks() {
            let x = left + place * width;
            svg.line((x, top), (x, bottom), "grid");
            svg.text((x, bottom + 18.0), r#" text-anchor="middle" class="tick""#, &text);
        }
        for (index, row) in self.rows.iter().enumerate() {
            let y = top + ROW * (index as f64 + 0.5);
            svg.text((left - 12.0, y + 4.5), r#" text-anchor="end""#, &row.label);
            svg.line((left, y), (left + width, y), "grid");
            for (series, value) in row.values.iter().enumerate() {
                if let Some(value) = value.filter(|&value| shown(value)) {
                    svg.dot((left + axis.place(placed(value)) * width, y), series);
                }
            }
        }
        svg.text((left + width / 2.0, bottom + 40.0), r#" text-anchor="middle""#, &axis.label(&self.x_label));
        if kept.is_empty() {
            svg.text((left + width / 2.0, bottom + 18.0), r#" text-anchor="middle" class="note""#, "no data");
        } else if !dropped.is_empty() {
            let note = format!("{} not shown: not finite, or not above 0", dropped.len());
            svg.text((left + width, bottom + 40.0), r#" text-anchor="end" class="note""#, &note);
        }
        svg.finish(&self.title, &self.caption, bottom + 52.0)
    }
}

/// A line reduced to what a screen can show: for each of `columns` equal parts of `range`, the first, lowest,
/// highest and last sample of each passage through it. Each inner vector is a stretch without a gap; a gap
/// between samples of one column is too narrow to be seen, and left out.
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

/// Moves the first, lowest, highest and last of a run over, in their order.
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

// ---- axes ----

#[derive(Clone, Copy, Debug)]
struct Range {
    low: f64,
    high: f64,
}

impl Range {
    /// Of the finite values.
    fn of(values: impl Iterator<Item = f64>) -> Option<Self> {
        values.filter(|value| value.is_finite()).fold(None, |range: Option<Self>, value| match range {
            None => Some(Self { low: value, high: value }),
            Some(range) => Some(Self { low: range.low.min(value), high: range.high.max(value) }),
        })
    }

    /// Too narrow for f64 to tell its ends apart on an axis.
    fn is_point(self) -> bool {
        self.high / 2.0 - self.low / 2.0 <= 1e-12 * self.low.abs().max(self.high.abs())
    }

    fn padded(self, share: f64) -> Self {
        if self.is_point() {
            let pad = if self.low == 0.0 { 1.0 } else { self.low.abs() * 0.5 };
            return Self { low: self.low - pad, high: self.high + pad };
        }
        let pad = share * (self.high - self.low);
        Self { low: self.low - pad, high: self.high + pad }
    }
}

/// A scale in units of a power of ten, so that no range is too wide or too fine to be written down.
#[derive(Clone, Copy, Debug)]
struct Axis {
    range: Range,
    step: f64,
    exponent: i32,
    log: bool,
}

impl Axis {
    fn linear(range: Option<Range>) -> Self {
        Self::with_padding(range, 0.0, 6.0)
    }

    fn with_padding(range: Option<Range>, share: f64, target: f64) -> Self {
        let range = range.unwrap_or(Range { low: 0.0, high: 1.0 });
        let largest = range.low.abs().max(range.high.abs());
        let exponent = if largest == 0.0 || (1e-3..1e5).contains(&largest) {
            0
        } else {
            ((largest.log10() / 3.0).floor() * 3.0).clamp(-300.0, 306.0) as i32
        };
        let unit = 10f64.powi(exponent);
        let mut range = Range { low: range.low / unit, high: range.high / unit }.padded(share);
        let step = nice((range.high - range.low) / target);
        // A run of 8 s ends a sample before 8 s: the axis still ends at its tick.
        let next = (range.high / step).ceil() * step;
        if next - range.high < 0.01 * (range.high - range.low) {
            range.high = next;
        }
        Self { range, step, exponent, log: false }
    }

    /// Of logarithms: a tick at each power of ten.
    fn decades(range: Option<Range>) -> Self {
        let mut range = range.unwrap_or(Range { low: 0.0, high: 1.0 });
        if range.is_point() {
            range.high = range.low + 1.0;
        }
        let step = ((range.high - range.low) / 8.0).ceil().max(1.0);
        Self { range, step, exponent: 0, log: true }
    }

    /// From data to 0..1 along the axis.
    fn place(&self, value: f64) -> f64 {
        self.place_scaled(value / 10f64.powi(self.exponent))
    }

    fn place_scaled(&self, value: f64) -> f64 {
        (value - self.range.low) / (self.range.high - self.range.low)
    }

    /// Places along the axis, 0..1, and their texts.
    fn ticks(&self) -> Vec<(f64, String)> {
        // A rounding error must not lose a tick at an end.
        let first = (self.range.low / self.step - 1e-9).ceil() as i64;
        let last = (self.range.high / self.step + 1e-9).floor() as i64;
        let decimals = (-self.step.log10().floor()).clamp(0.0, 15.0) as usize;
        let text = |tick: f64| {
            if self.log {
                power_of_ten(tick as i32)
            } else {
                format!("{tick:.decimals$}").replace('-', "−")
            }
        };
        // `+ 0.0` turns −0 into 0.
        let ticks = (first..=last.min(first + 20)).map(|index| index as f64 * self.step + 0.0);
        ticks.map(|tick| (self.place_scaled(tick), text(tick))).collect()
    }

    fn widest_label(&self) -> f64 {
        self.ticks().iter().map(|(_, text)| text_width(text)).fold(0.0, f64::max)
    }

    /// The axis title, with the power of ten.
    fn label(&self, title: &str) -> String {
        if self.exponent == 0 {
            title.to_owned()
        } else {
            format!("{title} × {}", power_of_ten(self.exponent))
        }
    }
}

/// 1, 2 or 5 times a power of ten, near `rough`.
fn nice(rough: f64) -> f64 {
    let power = 10f64.powf(rough.log10().floor());
    match rough / power {
        mantissa if mantissa < 1.5 => power,
        mantissa if mantissa < 3.5 => 2.0 * power,
        mantissa if mantissa < 7.5 => 5.0 * power,
        _ => 10.0 * power,
    }
}

fn power_of_ten(exponent: i32) -> String {
    let raised = |c: char| match c {
        '-' => '⁻',
        digit => ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'][digit.to_digit(10).unwrap_or(0) as usize],
    };
    match exponent {
        0 => "1".to_owned(),
        1..=4 => format!("1{}", "0".repeat(exponent as usize)),
        -4..=-1 => format!("0.{}1", "0".repeat((-1 - exponent) as usize)),
        _ => format!("10{}", exponent.to_string().chars().map(raised).collect::<String>()),
    }
}

#[derive(Clone, Copy, Debug)]
struct Axes {
    x: Axis,
    y: Axis,
}

impl Axes {
    fn of(panel: &Panel) -> Self {
        // A sample is drawn if both its coordinates are finite.
        let drawn = || {
            let samples = panel.series.iter().flat_map(|series| series.x.iter().zip(&series.y));
            samples.filter(|(x, y)| x.is_finite() && y.is_finite())
        };
        let x = Axis::with_padding(Range::of(drawn().map(|(x, _)| *x)), 0.0, 7.0);
        let y = Axis::with_padding(Range::of(drawn().map(|(_, y)| *y)), 0.06, 5.0);
        Self { x, y }
    }
}

/// What a panel cannot show, in words.
fn remark(panel: &Panel) -> Option<String> {
    let range = |series: &Series| {
        let samples = series.x.iter().zip(&series.y).filter(|(x, _)| x.is_finite());
        Range::of(samples.map(|(_, y)| *y))
    };
    let ranges: Vec<_> = panel.series.iter().map(range).collect();
    if ranges.iter().all(Option::is_none) {
        let empty = panel.series.iter().all(|series| series.x.is_empty() || series.y.is_empty());
        return Some(if empty { "no data" } else { "no finite value" }.to_owned());
    }
    let named = |(series, range): (&Series, &Option<Range>)| {
        let why = if series.x.is_empty() || series.y.is_empty() { "no data" } else { "no finite value" };
        range.is_none().then(|| format!("{}: {why}", series.label))
    };
    let mut remarks: Vec<String> = panel.series.iter().zip(&ranges).filter_map(named).collect();
    if ranges.iter().flatten().all(|range| range.is_point()) {
        remarks.push("constant".to_owned());
    }
    (!remarks.is_empty()).then(|| remarks.join("; "))
}

// ---- drawing ----

#[derive(Default)]
struct Svg {
    body: String,
}

/// Escapes text for HTML and XML; characters that XML forbids are replaced.
pub(crate) fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            '\t' | '\n' => escaped.push(c),
            c if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') => escaped.push('\u{fffd}'),
            c => escaped.push(c),
        }
    }
    escaped
}

/// Class and colour of the series in place `index`.
fn paint(index: usize) -> (usize, &'static str) {
    let index = index % PALETTE.len();
    (index, PALETTE[index].0)
}

impl Svg {
    fn finish(self, title: &str, caption: &str, height: f64) -> String {
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" role=\"img\" viewBox=\"0 0 {WIDTH} {height:.0}\" \
             font-family=\"system-ui, sans-serif\" font-size=\"{FONT}\" fill=\"currentColor\">\
             <title>{}</title><desc>{}</desc>\n{}</svg>",
            escape(title),
            escape(caption),
            self.body
        )
    }

    // Writing to a String cannot fail.

    fn text(&mut self, (x, y): (f64, f64), attributes: &str, text: &str) {
        let _ = writeln!(self.body, r#"<text x="{x:.1}" y="{y:.1}"{attributes}>{}</text>"#, escape(text));
    }

    fn line(&mut self, from: (f64, f64), to: (f64, f64), class: &str) {
        let opacity = if class == "grid" { 0.13 } else { 0.55 };
        let _ = writeln!(
            self.body,
            r#"<path class="{class}" d="M{:.1} {:.1}L{:.1} {:.1}" stroke="currentColor" stroke-opacity="{opacity}"/>"#,
            from.0, from.1, to.0, to.1
        );
    }

    fn dot(&mut self, (x, y): (f64, f64), series: usize) {
        let (class, color) = paint(series);
        // Told apart without colour too: discs, rings, squares.
        let _ = match series % 3 {
            0 => writeln!(
                self.body,
                r#"<circle class="f{class}" cx="{x:.1}" cy="{y:.1}" r="6" fill="{color}"/>"#
            ),
            1 => writeln!(
                self.body,
                r#"<circle class="s{class}" cx="{x:.1}" cy="{y:.1}" r="5" fill="none" stroke="{color}" stroke-width="2.6"/>"#
            ),
            _ => writeln!(
                self.body,
                r#"<rect class="f{class}" x="{:.1}" y="{:.1}" width="10" height="10" fill="{color}"/>"#,
                x - 5.0,
                y - 5.0
            ),
        };
    }

    fn path(&mut self, d: &str, series: usize, style: Style) {
        let (class, color) = paint(series);
        let look = match style {
            Style::Solid => r#"stroke-width="1.8" stroke-linecap="round""#,
            Style::Dashed => r#"stroke-width="1.8" stroke-dasharray="7 4""#,
            Style::Thin => r#"stroke-width="0.9" stroke-opacity="0.7" stroke-linecap="round""#,
        };
        let _ = writeln!(
            self.body,
            r#"<path class="s{class}" d="{d}" fill="none" stroke="{color}" stroke-linejoin="round" {look}/>"#
        );
    }

    fn legend(&mut self, entries: &[Entry<'_>], left: f64) -> f64 {
        self.legend_of(entries, left, |svg, (x, y), entry| {
            svg.path(&format!("M{x:.1} {y:.1}h28"), entry.color, entry.style);
        })
    }

    fn dot_legend(&mut self, entries: &[Entry<'_>], left: f64) -> f64 {
        self.legend_of(entries, left, |svg, (x, y), entry| svg.dot((x + 18.0, y), entry.color))
    }

    /// Draws samples and names from the top left; where it ends below.
    fn legend_of(
        &mut self,
        entries: &[Entry<'_>],
        left: f64,
        sample: impl Fn(&mut Self, (f64, f64), &Entry<'_>),
    ) -> f64 {
        if entries.is_empty() {
            return 0.0;
        }
        let (mut x, mut y) = (left, 16.0);
        for entry in entries {
            let width = 36.0 + text_width(entry.label) + 28.0;
            if x > left && x + width > WIDTH {
                (x, y) = (left, y + LEGEND_ROW);
            }
            sample(self, (x, y), entry);
            self.text((x + 36.0, y + 4.5), "", entry.label);
            x += width;
        }
        y + 10.0
    }

    fn panel(
        &mut self,
        panel: &Panel,
        axes: &Axes,
        (left, top): (f64, f64),
        (width, height): (f64, f64),
        legend: &[Entry<'_>],
    ) {
        let at = |x: f64, y: f64| (left + axes.x.place(x) * width, top + (1.0 - axes.y.place(y)) * height);
        self.text((left, top - 9.0), r#" font-weight="600""#, &panel.title);
        let remark = remark(panel);
        let drawn = !matches!(remark.as_deref(), Some("no data" | "no finite value"));
        if drawn {
            for (place, text) in axes.y.ticks() {
                let y = top + (1.0 - place) * height;
                self.line((left, y), (left + width, y), "grid");
                self.text((left - 7.0, y + 4.5), r#" text-anchor="end" class="tick""#, &text);
            }
            for (place, text) in axes.x.ticks() {
                let x = left + place * width;
                self.line((x, top + height), (x, top + height + 5.0), "axis");
                self.text((x, top + height + 19.0), r#" text-anchor="middle" class="tick""#, &text);
            }
        }
        self.line((left, top + height), (left + width, top + height), "axis");
        for series in &panel.series {
            let entry = legend.iter().find(|entry| entry.label == series.label);
            self.series(series, axes, entry.map_or(0, |entry| entry.color), at, width);
        }
        for (x, label) in &panel.marks {
            if !drawn || !(0.0..=1.0).contains(&axes.x.place(*x)) {
                continue;
            }
            let x = left + axes.x.place(*x) * width;
            self.line((x, top), (x, top + height), "axis");
            let fits = x + 6.0 + text_width(label) < left + width;
            let (x, anchor) = if fits { (x + 5.0, "start") } else { (x - 5.0, "end") };
            self.text((x, top + 10.0), &format!(r#" text-anchor="{anchor}" class="note""#), label);
        }
        match remark {
            Some(remark) if !drawn => {
                let middle = (left + width / 2.0, top + height / 2.0);
                self.text(middle, r#" text-anchor="middle" class="note""#, &remark);
            }
            Some(remark) => {
                self.text((left + width, top - 9.0), r#" text-anchor="end" class="note""#, &remark)
            }
            None => {}
        }
    }

    fn series(
        &mut self,
        series: &Series,
        axes: &Axes,
        color: usize,
        at: impl Fn(f64, f64) -> (f64, f64),
        width: f64,
    ) {
        let scale = 10f64.powi(axes.x.exponent);
        let range = (axes.x.range.low * scale, axes.x.range.high * scale);
        let mut d = String::new();
        for stretch in decimate(&series.x, &series.y, range, width as usize) {
            if let [(x, y)] = stretch[..] {
                self.sample(at(x, y), color);
                continue;
            }
            for (place, &(x, y)) in stretch.iter().enumerate() {
                let (x, y) = at(x, y);
                let _ = write!(d, "{}{x:.1} {y:.1}", if place == 0 { 'M' } else { 'L' });
            }
        }
        if !d.is_empty() {
            self.path(&d, color, series.style);
        }
    }

    /// A sample between gaps, which no line leads to.
    fn sample(&mut self, (x, y): (f64, f64), color: usize) {
        let (class, color) = paint(color);
        let _ =
            writeln!(self.body, r#"<circle class="f{class}" cx="{x:.1}" cy="{y:.1}" r="2" fill="{color}"/>"#);
    }
}

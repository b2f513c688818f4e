//! Chart of runs side by side: a row per run or kind of control, and a column with a scale of its own per quantity.

use crate::figure::{
    Area, Axis, ComparisonRow, Drawn, INK, LEGEND_ROW, PALETTE, SAMPLE, WIDTH, canvas, chart, draw_legend,
    legend_height, printable, px, range, text,
};
use opspace_experiment::evaluate::spread::Spread;
use opspace_experiment::text::format_short;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Ratio of the largest to the smallest value of a column from which on its scale is logarithmic.
pub(crate) const WIDE: f64 = 20.0;

/// Chart with a row per run or kind of control. Rows differ in colour, marks of a row in shape.
#[derive(Clone, Debug, Default)]
pub(crate) struct DotColumns {
    /// Title: what is compared.
    pub(crate) title: String,
    /// Caption: explanation.
    pub(crate) caption: String,
    /// Names of the rows, top to bottom.
    pub(crate) rows: Vec<String>,
    /// Names of the marks that each row has in each column; one without a name needs no legend.
    pub(crate) marks: Vec<String>,
    /// Quantities, left to right.
    pub(crate) columns: Vec<DotColumn>,
}

/// Quantity of a [`DotColumns`].
#[derive(Clone, Debug, Default)]
pub(crate) struct DotColumn {
    /// Quantity and unit.
    pub(crate) label: String,
    /// Values by row and mark.
    pub(crate) values: Vec<Vec<Option<Spread>>>,
}

impl DotColumns {
    pub(crate) fn title(&self) -> &str {
        &self.title
    }

    pub(crate) fn caption(&self) -> &str {
        &self.caption
    }

    /// Draws the chart as one `<svg>` element with the width of its parent element.
    pub(crate) fn svg(&self) -> String {
        let marks: Vec<&str> =
            self.marks.iter().map(String::as_str).filter(|mark| !mark.is_empty()).collect();
        let top = if marks.len() > 1 { legend_height(&marks) } else { 0 };
        let row = px(22 * self.marks.len().max(1) as i32 + 12);
        let height = top + px(71) + row * self.rows.len() as i32;
        canvas(&self.title, &self.caption, (WIDTH, height), |root| {
            let (strip, area) = root.split_vertically(top);
            if top > 0 {
                draw_legend(&strip, &marks, |area, place| {
                    shape(area, (SAMPLE / 2, LEGEND_ROW / 2), place, INK)
                })?;
            }
            let rows: Vec<ComparisonRow> = self
                .rows
                .iter()
                .map(|label| ComparisonRow { label: label.clone(), values: Vec::new() })
                .collect();
            let names = px(12) + Axis::rows(&rows).widest().min(WIDTH / 3);
            let width = (WIDTH - names) / self.columns.len().max(1) as i32;
            let mut rest = area;
            for (place, column) in self.columns.iter().enumerate() {
                let left = if place == 0 { names } else { px(4) };
                let (own, other) = rest.split_horizontally(width + if place == 0 { names } else { 0 });
                self.draw(root, &own, column, (left, &rows), place == 0)?;
                rest = other;
            }
            Ok(())
        })
    }

    fn draw(
        &self,
        root: &Area<'_>,
        area: &Area<'_>,
        column: &DotColumn,
        (left, rows): (i32, &[ComparisonRow]),
        is_first: bool,
    ) -> Drawn {
        let all = || column.values.iter().flatten().flatten();
        let Some(ends) = range(all().flat_map(|spread| [spread.low, spread.median, spread.high])) else {
            return Ok(());
        };
        // Room for a number beside the largest value.
        const ROOM: f64 = 0.3;
        let is_wide = ends.start > 0.0 && ends.end > WIDE * ends.start;
        let scaled = |value: f64| if is_wide { value.log10() } else { value };
        let x = match is_wide {
            true => {
                let [low, high] = [ends.start, ends.end].map(f64::log10);
                Axis::decades(low..high + ROOM * (high - low), &column.label)
            }
            false => {
                Axis::linear(ends.start.min(0.0)..ends.end.max(0.0) * (1.0 + ROOM), 0.02, &column.label, 4)
            }
        };
        let mut y = Axis::rows(rows);
        if !is_first {
            y = y.without_texts();
        }
        let drawn = chart(area, "", left, &x, &y)?;
        let lines = self.marks.len().max(1) as f64;
        for (row, values) in column.values.iter().enumerate() {
            let color = PALETTE[row % PALETTE.len()].0;
            for (mark, value) in values.iter().enumerate() {
                let Some(spread) = value else { continue };
                let line = row as f64 + (mark as f64 + 1.0) / (lines + 1.0) - 0.5;
                let at = |value: f64| drawn.backend_coord(&(x.place(scaled(value)), line));
                root.draw(&PathElement::new(vec![at(spread.low), at(spread.high)], color.stroke_width(8)))?;
                shape(root, at(spread.median), mark, color)?;
                let style = text(12, FontStyle::Normal).pos(Pos::new(HPos::Left, VPos::Center));
                let (right, middle) = at(spread.high.max(spread.median));
                let number = format_short(spread.median);
                root.draw_text(&printable(&number), &style, (right + px(10), middle))?;
            }
        }
        Ok(())
    }
}

/// Draws a mark: disc, ring, triangle.
fn shape(area: &Area<'_>, at: (i32, i32), place: usize, color: RGBColor) -> Drawn {
    match place % 3 {
        0 => area.draw(&Circle::new(at, px(6), color.filled())),
        1 => area.draw(&Circle::new(at, px(5), color.stroke_width(11))),
        _ => area.draw(&TriangleMarker::new(at, px(8), color.filled())),
    }
}

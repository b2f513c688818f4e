//! Table of the response of a run to external forces.

use crate::evaluate::response_sentences::pushed_axes;
use crate::evaluate::results::drop_empty_columns;
use crate::evaluate::summary::Summary;
use crate::evaluate::table::{Cell, Table};
use crate::metrics::metric_tables::response_names;
use opspace_control::AXIS_NAMES;

/// Table with a row per task, or frame that no task controls, and axis along which a considerable force pushes its frame; without rows if nothing does.
#[must_use]
pub fn response_table(summary: &Summary) -> Table {
    let mut table = Table::new(&[
        ("task or frame", ""),
        ("axis", ""),
        ("external force max", "N"),
        ("deflection max", "mm"),
        ("stiffness", "N/m"),
        ("desired stiffness", "N/m"),
        ("hysteresis", "mm"),
        ("displacement at the end", "mm"),
    ]);
    let tasks = summary.ordered_tasks().map(|(name, task)| (name, &task.axes));
    for (name, axes) in tasks.chain(&summary.frames) {
        for axis in pushed_axes(axes) {
            let [force, deflection, stiffness, hysteresis, left, desired] =
                response_names(axis).map(|name| axes.get(&name).copied());
            let mm = |value: Option<f64>| Cell::from(value.map(|value| 1e3 * value));
            table.push(vec![
                name.as_str().into(),
                AXIS_NAMES[axis].into(),
                force.into(),
                mm(deflection),
                stiffness.into(),
                desired.into(),
                mm(hysteresis),
                mm(left),
            ]);
        }
    }
    drop_empty_columns(&mut table);
    table
}

/// Meanings of the columns of [`response_table`], by the beginning of their titles.
const MEANINGS: [(&str, &str); 4] = [
    ("deflection max", "deflection max is the largest displacement along the axis after settle_s"),
    ("stiffness", "stiffness is force over displacement, – where these are not related"),
    (
        "hysteresis",
        "hysteresis is the largest difference of the displacements at one force while it rises and while it falls",
    ),
    (
        "displacement at the end",
        "displacement at the end is that of the end of the run, where no force acts then",
    ),
];

/// Note under [`response_table`] about the columns that it shows; none without rows.
#[must_use]
pub(crate) fn response_note(summary: &Summary) -> Option<String> {
    let table = response_table(summary);
    let titles: Vec<String> = table.columns.iter().map(|column| column.column_title()).collect();
    let is_shown = |begin: &str| titles.iter().any(|title| title.starts_with(begin));
    let meanings = MEANINGS.iter().filter(|(begin, _)| is_shown(begin)).map(|(_, meaning)| *meaning);
    (!table.rows.is_empty())
        .then(|| format!("Response to forces: {}.", meanings.collect::<Vec<_>>().join("; ")))
}

#[cfg(test)]
mod tests {
    use super::{response_note, response_table};
    use crate::evaluate::results::tests::summary;
    use crate::metrics::metric_tables::{TaskMetrics, response_names};

    /// Checks the row of the axis that is pushed, that one with hardly any force has none, and that empty columns are left out.
    #[test]
    fn pushed_axes_have_rows() {
        let mut run = summary("a", "p", 1, 0.1);
        assert!(response_table(&run).rows.is_empty() && response_note(&run).is_none());
        let mut task = TaskMetrics::default();
        for (axis, values) in [(2, [20.0, 0.0476, 417.26, 0.009]), (0, [0.3, 0.001, 300.0, 0.0])] {
            task.axes.extend(response_names(axis).into_iter().zip(values));
        }
        run.tasks.insert("flange".to_owned(), task);
        let table = response_table(&run);
        let titles: Vec<String> = table.columns.iter().map(|column| column.column_title()).collect();
        let expected = [
            "task or frame",
            "axis",
            "external force max (N)",
            "deflection max (mm)",
            "stiffness (N/m)",
            "hysteresis (mm)",
        ];
        assert_eq!(titles, expected);
        assert_eq!(table.texts(), [["flange", "z", "20.00", "47.60", "417.3", "9.000"]]);
        let note = response_note(&run).expect("a note");
        assert!(note.contains("; hysteresis is ") && !note.contains("at the end"), "{note}");
    }
}

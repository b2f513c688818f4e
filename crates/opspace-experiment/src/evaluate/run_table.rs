//! Table of a single run: its metrics without the names that a table of several runs needs.

use crate::evaluate::results::{control, profile, value};
use crate::evaluate::summary::Summary;
use crate::evaluate::table::{Cell, Table};
use crate::metrics::metric::Metric;

/// Names a run in one line: task, kind of robot, control and profile, and whether the robot was simulated.
#[must_use]
pub fn run_title(summary: &Summary) -> String {
    let world = match &summary.replay {
        Some(_) => "from a log",
        None if summary.simulated => "simulated",
        None => "on the real robot",
    };
    let (task, backend) = (&summary.task, &summary.backend);
    format!("{task}: {backend} {}, {}, {world}", control(summary), profile(summary))
}

/// Table of those of these metrics that have a column and that the run has: one row.
#[must_use]
pub fn run_table(summary: &Summary, metrics: &[Metric]) -> Table {
    let shown = metrics.iter().filter_map(|metric| Some((metric.column?, value(summary, metric)?)));
    let (heads, row): (Vec<(&str, &str)>, Vec<Cell>) =
        shown.map(|(column, value)| ((column.title, column.unit), Cell::from(column.factor * value))).unzip();
    let mut table = Table::new(&heads);
    if !row.is_empty() {
        table.push(row);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::{run_table, run_title};
    use crate::evaluate::results::tests::summary;
    use crate::metrics::columns::default_columns;

    /// Checks the metrics of a run that has one, and its name.
    #[test]
    fn table_of_a_run_has_its_metrics_alone() {
        let mut run = summary("a", "p", 1, 0.1);
        run.timing.tick_ns_median = 6e3;
        assert_eq!(run_title(&run), "a: position osc, p 1:5, simulated");
        let table = run_table(&run, &default_columns(&[]));
        let titles: Vec<String> = table.columns.iter().map(|column| column.column_title()).collect();
        assert_eq!(titles, ["position error rms (mm)", "cycle time (µs)"]);
        assert_eq!(table.texts(), [["100.0", "6.000"]]);
    }
}

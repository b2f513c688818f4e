//! Robot and task files, experiments assembled from them, suites, metrics and reports.

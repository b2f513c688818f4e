//! Tests of the header of a log, from which its experiment is rebuilt.

use opspace_experiment::run::log_header::RUN;
use opspace_experiment::{Experiment, Files, Progress, RunError, RunOptions};
use opspace_log::Recording;
use std::io::Cursor;

/// Checks that a duration that no task file can have is refused, as no run would end with it.
#[test]
fn log_without_a_possible_duration_is_refused() {
    let options = RunOptions { duration_s: Some(0.02), ..RunOptions::default() };
    let task = "tasks/gravity-compensation.toml".as_ref();
    let settings = ["settle_s=0".to_owned()];
    let experiment = Experiment::load(Files::Embedded, task, None, options, &settings).expect("a task");
    let log = experiment.run(Cursor::new(Vec::new()), &Progress::default()).expect("a run").sink;
    let whole = Recording::from_bytes(log.get_ref()).expect("a log");
    assert_eq!(Experiment::of_log(&whole).expect("an experiment").duration_s(), 0.02);
    for duration_s in ["NaN", "inf", "1e400", "-1", "0", "", "one"] {
        let mut recording = whole.clone();
        for (name, entries) in &mut recording.metadata {
            if name == RUN {
                entries.insert("duration_s".to_owned(), duration_s.to_owned());
            }
        }
        let error = Experiment::of_log(&recording).expect_err(duration_s);
        assert!(matches!(&error, RunError::Incomplete { what } if what.contains("duration_s")), "{error}");
    }
}

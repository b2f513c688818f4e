//! Common parts of the examples: recording of a run to a folder, its replay, and a summary line.

use opspace::experiment::run::replay::replay;
use opspace::experiment::{Experiment, RunError, RunResult};
use opspace::log::Recording;
use opspace::report::folder::in_folder;
use std::error::Error;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::Path;

/// Runs an experiment with log, summary and report in `runs/NAME`, and replays the log.
pub fn record(
    name: &str,
    experiment: &Experiment,
    run: impl FnOnce(BufWriter<File>) -> Result<RunResult<BufWriter<File>>, RunError>,
) -> Result<(), Box<dyn Error>> {
    let folder = Path::new("runs").join(name);
    if folder.exists() {
        fs::remove_dir_all(&folder)?;
    }
    let summary = in_folder(experiment, &folder, run)?;
    let replayed = replay(experiment, &Recording::read(folder.join("run.mcap"))?)?;
    assert_eq!(replayed.differing, 0, "{:?}", replayed.first_difference);
    assert!(replayed.compared > 0 && replayed.unmatched.is_empty(), "{:?}", replayed.unmatched);
    let error =
        summary.metrics.pose.position_rms_m.map(|e| format!("; position error {:.2} mm rms", 1e3 * e));
    println!(
        "{name}: {}{}; {} cycles replayed bit for bit; see {}",
        summary.faulted.as_deref().unwrap_or("completed"),
        error.unwrap_or_default(),
        replayed.compared,
        folder.join("report.html").display(),
    );
    Ok(())
}

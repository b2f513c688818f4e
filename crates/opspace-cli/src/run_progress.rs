//! Progress and exit code of a run.

use crate::console::{Console, Exit};
use indicatif::{ProgressBar, ProgressStyle};
use opspace_experiment::{Progress, RunSummary, Summary};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Exit code of a robot's run; 1 takes precedence over 130, and 130 over 3.
pub fn exit_code_of_robot(summary: &Summary) -> Exit {
    if summary.has_failed() {
        Exit::Failed
    } else if summary.interrupted {
        Exit::Interrupted
    } else if summary.rows_lost > 0 || !summary.not_saved.is_empty() {
        Exit::DataLost
    } else {
        Exit::Done
    }
}

/// Exit code of a run: the worst of its robots, and 1 if it failed.
pub fn exit_code(summary: &RunSummary) -> Exit {
    if summary.has_failed() {
        return Exit::Failed;
    }
    let of_robots = summary.robots.values().map(exit_code_of_robot);
    match of_robots.into_iter().find(|exit| *exit != Exit::Done) {
        None if !summary.not_saved.is_empty() => Exit::DataLost,
        exit => exit.unwrap_or(Exit::Done),
    }
}

/// Shows the progress of a run with a name and a number of cycles.
pub fn with_bar<T>(
    (name, ticks): (&str, u64),
    watch: &Arc<Progress>,
    console: Console,
    work: impl FnOnce() -> T,
) -> T {
    if !console.shows_progress() {
        return work();
    }
    let bar = ProgressBar::new(ticks);
    bar.set_style(style("{msg} {wide_bar} {percent:>3} %"));
    bar.set_message(name.to_owned());
    let done = AtomicBool::new(false);
    let result = std::thread::scope(|scope| {
        scope.spawn(|| {
            while !done.load(Ordering::Relaxed) {
                bar.set_position(watch.ticks.load(Ordering::Relaxed));
                std::thread::sleep(Duration::from_millis(50));
            }
        });
        let result = work();
        done.store(true, Ordering::Relaxed);
        result
    });
    bar.finish_and_clear();
    result
}

/// Style of a progress bar; the default style if the template is invalid.
pub fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar())
}

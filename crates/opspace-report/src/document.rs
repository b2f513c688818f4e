//! Reports: pages with a table of runs, charts that compare them, and the figures of each run.

use crate::comparisons::{columns, compliance, overlays, side_by_side, suite_story};
pub use crate::environment_shapes::{EnvironmentShape, PlacedObject};
use crate::html::Page;
use crate::kinds::run_names;
use crate::run_pictures::RunPictures;
pub use crate::run_section::{ClosestPair, CollisionMoment, PlacedShape, RunSection};
use opspace_experiment::evaluate::notes::{
    allowed_notes, assumed_counts, assumed_notes, joint_notes, notes, task_notes,
};
use opspace_experiment::evaluate::position_control::position_control_notes;
use opspace_experiment::evaluate::response_table::response_table;
use opspace_experiment::evaluate::results::{failures, group, joint_table, table, task_table};
use opspace_experiment::evaluate::summary::Summary;
use opspace_experiment::evaluate::table::Table;
use opspace_experiment::metrics::metric::Metric;
use opspace_experiment::text::{capitalised, listed};

/// Largest number of compared runs of which the page states what happened.
const MOST_STORIES: usize = 4;

/// Builds a page about runs: one table, then a section for each run in `shown`.
#[must_use]
pub fn page(
    title: &str,
    lead: &str,
    summaries: &[Summary],
    metrics: &[Metric],
    shown: &[RunSection],
) -> String {
    let mut all_notes = notes(summaries, metrics);
    if let ([run], [_]) = (shown, summaries)
        && !run.operator_axes.is_empty()
    {
        all_notes.push(format!("Axes of the operator force and of the hand motion: {}.", run.operator_axes));
    }
    let with_table = |page: Page| {
        page.table(&caption(summaries, shown), &table(summaries, metrics), &borrowed(&all_notes))
    };
    // What happened comes first where there is one run.
    if let ([run], [_]) = (shown, summaries) {
        let head = Page::new(&run.sentence).story(&run.story).lead(&format!("{lead} {}.", run.title));
        let pictures: Vec<_> = run.pictures.iter().map(|pictures| ("", pictures)).collect();
        let head = run_head(with_assumed(head, summaries).player(&pictures, false), run);
        let page = run_body(with_table(head.section("Results")), run);
        return with_assumed_lists(page, summaries).render();
    }
    let is_comparison = summaries.len() > 1 && shown.len() == summaries.len();
    let story = if is_comparison { Vec::new() } else { suite_story(summaries, metrics) };
    let mut page = with_assumed(Page::new(title).story(&story).lead(lead), summaries);
    if summaries.len() > 1 {
        page = failures(summaries)
            .iter()
            .fold(page, |page, failure| page.warning(&format!("Failed: {failure}.")));
    }
    let position_control = position_control_notes(summaries);
    let first = if is_comparison { side_by_side(summaries) } else { compliance(summaries, metrics) };
    if let Some(chart) = &first {
        page = page.dot_columns(chart);
    }
    if is_comparison && shown.len() <= MOST_STORIES {
        let names = run_names(&summaries.iter().collect::<Vec<_>>());
        page = page.player(&pictures(names.iter().zip(shown)), true);
        let stories = names.iter().zip(shown).map(|(name, run)| format!("{name}: {}", run.story.join(" ")));
        page = stories.fold(page, |page, story| page.paragraph(&story));
    }
    page = position_control.iter().fold(page, |page, note| page.paragraph(note));
    page = page.section("Results");
    // Figures of a suite come before its table, which may be long.
    let is_suite = summaries.len() > 1 && !is_comparison;
    if !is_suite || first.is_some() {
        page = with_table(page);
    }
    if is_suite || (summaries.len() > 1 && first.is_none()) {
        let (figures, charts) = columns(summaries, metrics);
        page = figures.iter().fold(page, |page, figure| page.figure(figure));
        page = charts.iter().fold(page, |page, chart| page.comparison(chart));
    }
    if is_suite && first.is_none() {
        page = with_table(page);
    }
    if summaries.len() > 1 {
        page = overlays(shown).iter().fold(page, |page, figure| page.figure(figure));
    }
    for run in shown {
        page = run_blocks(page, &run.title, run);
    }
    with_assumed_lists(page, summaries).render()
}

/// Moving pictures of runs, with their names.
pub(crate) fn pictures<'a>(
    runs: impl IntoIterator<Item = (&'a String, &'a RunSection)>,
) -> Vec<(&'a str, &'a RunPictures)> {
    runs.into_iter().filter_map(|(name, run)| Some((name.as_str(), run.pictures.as_ref()?))).collect()
}

/// Title of a page about these runs: a sentence that names what differs between them.
#[must_use]
pub fn title_of_runs(shown: &[RunSection]) -> String {
    const MOST: usize = 4;
    let runs: Vec<&Summary> = shown.iter().map(|run| &run.summary).collect();
    let task = match runs.as_slice() {
        [] => return "No runs".to_owned(),
        [_] => return shown[0].title.clone(),
        [first, ..] if runs.iter().all(|run| run.task == first.task) => format!("of {}", first.task),
        _ => "of several tasks".to_owned(),
    };
    let names = run_names(&runs);
    let compared = if names.len() > MOST { String::new() } else { format!(": {}", listed(&names)) };
    format!("{} runs {task} are compared{compared}", runs.len())
}

/// Adds the number of assumed values, on which results rest, and refusals that the user has allowed.
pub(crate) fn with_assumed<'a>(page: Page, summaries: impl IntoIterator<Item = &'a Summary> + Clone) -> Page {
    let allowed = allowed_notes(summaries.clone()).into_iter().map(|note| format!("Allowed: {note}."));
    let counts = assumed_counts(summaries).into_iter();
    let notes = counts.map(|count| format!("Note: {count}. The end of this page lists them.")).chain(allowed);
    notes.fold(page, |page, note| page.warning(&note))
}

/// Adds the lists of assumed values.
pub(crate) fn with_assumed_lists<'a>(page: Page, summaries: impl IntoIterator<Item = &'a Summary>) -> Page {
    assumed_notes(summaries)
        .iter()
        .fold(page, |page, note| page.paragraph(&format!("{}.", capitalised(note))))
}

/// Adds the section of one run to a page.
pub(crate) fn run_blocks(page: Page, heading: &str, run: &RunSection) -> Page {
    run_body(run_head(page.section(heading).story(&run.story), run), run)
}

/// Adds what is wrong with a run, the figure that it is about, and the arm.
fn run_head(mut page: Page, run: &RunSection) -> Page {
    for warning in &run.warnings {
        page = page.warning(warning);
    }
    if let Some(first) = run.figures.first() {
        page = page.figure(first);
    }
    page.collisions(run.arm.as_slice())
}

/// Adds the tables of a run and its other figures.
fn run_body(mut page: Page, run: &RunSection) -> Page {
    let (tasks, joints) = (in_order(task_table(&run.summary), run), in_order(joint_table(&run.summary), run));
    let task_notes = task_notes(&run.summary);
    if tasks.rows.is_empty() {
        for note in &task_notes {
            page = page.paragraph(note);
        }
    } else {
        let caption = format!("Errors, forces and motions of the tasks {}", after(run.settle_s));
        page = page.table(&caption, &tasks, &borrowed(&task_notes));
    }
    let responses = response_table(&run.summary);
    if !responses.rows.is_empty() {
        let caption = format!("Response of the tasks to external forces {}", after(run.settle_s));
        page = page.table(&caption, &responses, &[]);
    }
    if !joints.rows.is_empty() {
        let caption = format!("Torques of the joints {}", after(run.settle_s));
        page = page.table(&caption, &joints, &borrowed(&joint_notes(&run.summary)));
    }
    page = page.collisions(&run.collisions);
    for figure in run.figures.iter().skip(1) {
        page = page.figure(figure);
    }
    page = page.facts(run.facts.iter().map(|(term, text)| (term.as_str(), text.as_str())));
    page
}

fn borrowed(texts: &[String]) -> Vec<&str> {
    texts.iter().map(String::as_str).collect()
}

/// Caption of the table of runs.
fn caption(summaries: &[Summary], shown: &[RunSection]) -> String {
    match shown {
        [one] if summaries.len() == 1 => format!("Values {}", after(one.settle_s)),
        _ if group(summaries).iter().all(|group| group.runs.len() == 1) => {
            "Values after the first seconds of control, settle_s of each task file".to_owned()
        }
        _ => "Medians over the seeds of each row, and their intervals; values after the first seconds of control, settle_s of \
              each task file"
            .to_owned(),
    }
}

/// Names the time that statistics cover.
fn after(settle_s: f64) -> String {
    format!("after the first {settle_s} s (settle_s)")
}

/// Orders the rows of a table by the tasks' priority, or as the joints of the robot.
fn in_order(mut table: Table, run: &RunSection) -> Table {
    table.rows.sort_by_key(|row| run.order.iter().position(|name| row[0] == name.as_str().into()));
    table
}

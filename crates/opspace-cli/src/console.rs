//! Output: results to stdout, everything else to stderr. A closed pipe ends the program without a message.

use annotate_snippets::renderer::DecorStyle;
use annotate_snippets::{AnnotationKind, Group, Level, Renderer, Snippet};
use comfy_table::{CellAlignment, ContentArrangement, LineStyle, TableStyle};
use opspace_experiment::Metric;
use opspace_experiment::evaluate::headline::headline;
use opspace_experiment::evaluate::notes::{
    allowed_notes, assumed_counts, assumed_notes, final_notes, joint_notes, notes, replay_notes, task_notes,
};
use opspace_experiment::evaluate::position_control::position_control_notes;
use opspace_experiment::evaluate::response_table::response_table;
use opspace_experiment::evaluate::results::{failures, joint_table, table, task_table};
use opspace_experiment::evaluate::run_table::{run_table, run_title};
use opspace_experiment::evaluate::table::{Cell, Table};
use opspace_experiment::{FileError, Finding, RunError, RunSummary, Summary};
use opspace_log::LogError;
use std::borrow::Cow;
use std::io::{self, IsTerminal, Write};
use std::path::Path;
use std::process::ExitCode;

/// Reason why a command failed.
#[derive(Debug)]
pub enum Failure {
    /// A mistake in a file.
    File(FileError),
    /// An error without a place in a file: message and exit code.
    Other(String, Exit),
    /// The reader of the output has closed the pipe.
    ClosedPipe,
}

/// Exit status of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// Success.
    Done,
    /// The run failed: a fault, divergence or difference; or a strict check found a problem.
    Failed,
    /// Invalid arguments, or an invalid file.
    Bad,
    /// Success, but data was lost or a log is damaged.
    DataLost,
    /// Interrupted; the log was closed.
    Interrupted,
}

impl Exit {
    /// The status as a number.
    pub fn code(self) -> u8 {
        match self {
            Self::Done => 0,
            Self::Failed => 1,
            Self::Bad => 2,
            Self::DataLost => 3,
            Self::Interrupted => 130,
        }
    }
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit.code())
    }
}

pub type Outcome = Result<Exit, Failure>;

impl From<FileError> for Failure {
    fn from(error: FileError) -> Self {
        Self::File(error)
    }
}

impl From<RunError> for Failure {
    fn from(error: RunError) -> Self {
        match error {
            RunError::File(error) => Self::File(error),
            RunError::Incomplete { .. } | RunError::Locked { .. } => {
                Self::Other(error.to_string(), Exit::Bad)
            }
            RunError::Write { source: ref cause, .. }
            | RunError::Log(LogError::Write(ref cause))
            | RunError::LogCutShort { source: LogError::Write(ref cause), .. } => {
                Self::Other(error.to_string(), Exit::of_io(cause, Exit::Bad))
            }
            other => Self::Other(other.to_string(), Exit::Failed),
        }
    }
}

impl Failure {
    /// Creates an error about a file that cannot be read, written or created, with the message of the operating
    /// system.
    pub fn io(what: &str, path: &std::path::Path, error: &io::Error) -> Self {
        Self::Other(format!("{}: {what}: {error}", path.display()), Exit::of_io(error, Exit::Bad))
    }

    /// Creates an error about results that cannot be printed.
    pub fn stdout(error: &io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::BrokenPipe => Self::ClosedPipe,
            _ => Self::Other(
                format!("cannot write to standard output: {error}"),
                Exit::of_io(error, Exit::Failed),
            ),
        }
    }
}

impl Exit {
    /// Exit status after an error of the operating system. A full disk loses results, whatever was written to it.
    pub fn of_io(error: &io::Error, otherwise: Self) -> Self {
        match error.kind() {
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded | io::ErrorKind::FileTooLarge => {
                Self::DataLost
            }
            _ => otherwise,
        }
    }
}

/// Verbosity of the messages to stderr.
#[derive(Clone, Copy, Debug)]
pub struct Console {
    pub verbose: bool,
    pub quiet: bool,
}

impl Console {
    /// Prints a progress message to stderr, unless quiet.
    pub fn note(self, text: &str) {
        if !self.quiet {
            let _ = writeln!(io::stderr(), "{}", escaped(text));
        }
    }

    /// Prints to stderr what the user must know to go on, also if quiet.
    pub fn tell(self, text: &str) {
        let _ = writeln!(io::stderr(), "{}", escaped(text));
    }

    /// Prints a detail to stderr, if verbose.
    pub fn detail(self, text: &str) {
        if self.verbose {
            let _ = writeln!(io::stderr(), "{}", escaped(text));
        }
    }

    /// True if a progress bar can be shown: not quiet, and stderr is a terminal.
    pub fn shows_progress(self) -> bool {
        !self.quiet && io::stderr().is_terminal()
    }
}

/// Escapes characters that would move the cursor, change colours or reverse the direction of the text: names in files
/// are not to be trusted. Line ends and tabs stay.
pub fn escaped(text: &str) -> Cow<'_, str> {
    let is_harmful = |c: char| {
        c.is_control() && !matches!(c, '\n' | '\t')
            // Marks and overrides of bidirectional text.
            || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
    };
    if !text.contains(is_harmful) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len());
    for c in text.chars() {
        if is_harmful(c) { shown.extend(c.escape_unicode()) } else { shown.push(c) }
    }
    Cow::Owned(shown)
}

/// Prints text to stdout, for a reader.
pub fn print(text: &str) -> Result<(), Failure> {
    print_exactly(&escaped(text))
}

/// Prints text to stdout, for a program.
pub fn print_exactly(text: &str) -> Result<(), Failure> {
    let mut out = io::stdout().lock();
    out.write_all(text.as_bytes()).and_then(|()| out.flush()).map_err(|error| Failure::stdout(&error))
}

/// Renders results as a table with its notes.
pub fn results(console: Console, summaries: &[Summary], metrics: &[Metric]) -> String {
    if summaries.is_empty() {
        return "no runs\n".to_owned();
    }
    if let [one] = summaries {
        return result(console, one, metrics);
    }
    let mut text: String = failures(summaries).iter().map(|failure| format!("FAILED {failure}\n")).collect();
    text += &premises(console, summaries);
    position_control_notes(summaries).iter().for_each(|note| text += &format!("NOTE {note}\n"));
    text += &render(&table(summaries, metrics));
    replay_notes(summaries).iter().for_each(|note| text += &format!("\n{}\n", wrap(note, shown_width())));
    with_notes(console, text, &notes(summaries, metrics))
}

/// Renders what failed in a run, a line each, and the folder of its results.
pub fn failures_and_folder(run: &RunSummary, folder: &Path) -> String {
    let failed = match run.single() {
        Some(robot) => {
            let fault = robot.faulted.as_ref();
            let time_s = robot.fault_time_s.unwrap_or(f64::NAN);
            let fault = fault.map(|fault| format!("STOPPED at {time_s:.3} s: {fault}"));
            let failed = failures(std::slice::from_ref(robot));
            fault.into_iter().chain(failed.iter().map(|failure| format!("FAILED {failure}"))).collect()
        }
        None => run.failures().iter().map(|failure| format!("FAILED {failure}")).collect::<Vec<_>>(),
    };
    let folder = folder.display().to_string();
    failed.into_iter().chain([folder]).map(|line| line + "\n").collect()
}

/// Renders the result of a run on a real robot: what became of it and its notes, without tables. `cycles` is their intended number.
pub fn owner_result(console: Console, run: &Summary, cycles: u64) -> String {
    let mut text = verdict(console, run);
    text += &format!("missed cycles: {} of {cycles}\n", run.missed_cycles);
    if run.metrics.torque_error_interval.is_some() {
        text += &format!("\n{}", render(&joint_table(run)));
    }
    text += "`-v` prints the tables of all metrics, which the page has, too\n";
    text
}

/// Renders the fault that stopped a run.
fn stop(run: &Summary) -> Option<String> {
    let fault = run.faulted.as_ref()?;
    let time_s = run.fault_time_s.unwrap_or(f64::NAN);
    Some(format!("STOPPED at {time_s:.3} s: {fault}. All values below are those until the stop.\n"))
}

/// Longest list of failures above the result of a run.
const FIRST_FAILURES: usize = 2;

/// Renders what became of a run, and its notes.
fn verdict(console: Console, run: &Summary) -> String {
    let runs = std::slice::from_ref(run);
    let mut text = stop(run).unwrap_or_default();
    let failures = failures(runs);
    let (first, more) = failures.split_at(failures.len().min(FIRST_FAILURES - text.lines().count()));
    first.iter().for_each(|failure| text += &format!("FAILED {failure}\n"));
    headline(run).iter().for_each(|line| text += &format!("{line}\n"));
    more.iter().for_each(|failure| text += &format!("FAILED {failure}\n"));
    run.findings.failures().for_each(|finding| text += &help(finding));
    text += &premises(console, runs);
    run.findings.notes().for_each(|finding| text += &note(finding));
    final_notes(run).iter().for_each(|note| text += &format!("NOTE {note}\n"));
    replay_notes(runs).iter().for_each(|note| text += &format!("NOTE {note}\n"));
    let real_time = run.real_time.iter().flat_map(|real_time| real_time.sentences());
    real_time.for_each(|sentence| text += &wrapped(&sentence));
    text
}

/// Renders the result of one run: what became of it, its notes and its tables.
fn result(console: Console, run: &Summary, metrics: &[Metric]) -> String {
    let runs = std::slice::from_ref(run);
    let mut text = verdict(console, run);
    text += &format!("\n{}\n", run_title(run));
    let tables = [run_table(run, metrics), task_table(run), response_table(run), joint_table(run)];
    let drawn: Vec<String> = tables.iter().filter(|table| !table.rows.is_empty()).map(render).collect();
    text += &drawn.join("\n");
    let footnotes: Vec<String> =
        notes(runs, metrics).into_iter().chain(task_notes(run)).chain(joint_notes(run)).collect();
    with_notes(console, text, &footnotes)
}

/// End of a count of assumed values.
pub const LISTED: &str = "; `-v` lists them";

/// Lists what the results rest on: assumed values, by number unless verbose, and refusals that were allowed.
pub fn premises<'a>(
    console: Console,
    summaries: impl IntoIterator<Item = &'a Summary, IntoIter: Clone>,
) -> String {
    let summaries = summaries.into_iter();
    let assumed: Vec<String> = match console.verbose {
        true => assumed_notes(summaries.clone()),
        false => assumed_counts(summaries.clone()).iter().map(|count| format!("{count}{LISTED}")).collect(),
    };
    let assumed = assumed.into_iter().map(|note| format!("ASSUMED {note}\n"));
    assumed.chain(allowed_notes(summaries).into_iter().map(|note| format!("ALLOWED {note}\n"))).collect()
}

/// Renders a finding with its code and its remedy.
pub fn note(finding: &Finding) -> String {
    format!("NOTE {finding} [{}]\n{}", finding.code, help(finding))
}

/// Renders the remedy of a finding; without one, the command that explains its code.
fn help(finding: &Finding) -> String {
    match finding.help.as_str() {
        "" => format!("    help: `opspace explain {}`\n", finding.code),
        help => format!("    help: {help}\n"),
    }
}

/// Appends notes to a text if verbose, otherwise how to get them, unless only results are wanted.
pub fn with_notes(console: Console, mut text: String, notes: &[String]) -> String {
    if console.verbose {
        notes.iter().for_each(|note| text += &format!("\n{}\n", wrap(note, shown_width())));
    } else if !console.quiet && !notes.is_empty() {
        text += "\n`-v` explains the columns and what the values are based on\n";
    }
    text
}

/// Width of the output in columns.
fn shown_width() -> usize {
    usize::from(width().unwrap_or(100))
}

/// Renders a table as text. Columns that do not fit into the width of the terminal, or into 100 columns without one, follow below,
/// after the repeated columns that name a row.
pub fn render(table: &Table) -> String {
    let texts = table.texts();
    let heads: Vec<String> = (0..table.columns.len()).map(|place| head(table, place)).collect();
    let widths: Vec<usize> = (0..heads.len())
        .map(|place| {
            let cells = texts.iter().filter_map(|row| row.get(place)).map(String::as_str);
            cells.chain(heads[place].lines()).map(|line| line.chars().count() + PADDING).max().unwrap_or(0)
        })
        .collect();
    let blocks = blocks(&widths, table.further_names, shown_width());
    let drawn: Vec<String> = blocks.iter().map(|block| draw(table, &texts, &heads, block)).collect();
    drawn.join("\n")
}

/// Most lines of the head of a column.
const HEAD_LINES: usize = 3;

/// Renders the head of a column. Above numbers it has few lines that are as short as possible, because these columns are narrow.
fn head(table: &Table, place: usize) -> String {
    let column = &table.columns[place];
    let unit = if column.unit.is_empty() { String::new() } else { format!("({})", column.unit) };
    if !is_numeric(table, place) {
        return format!("{}{}{unit}", column.title, if unit.is_empty() { "" } else { "\n" });
    }
    let words: Vec<&str> = column.title.split(' ').collect();
    let most = HEAD_LINES - usize::from(!unit.is_empty());
    let longest = words.iter().map(|word| word.chars().count()).max().unwrap_or(0);
    // One line holds all words at the latest.
    let title =
        (longest..).map(|width| wrap(&column.title, width)).find(|title| title.lines().count() <= most);
    [title.unwrap_or_default(), unit].join("\n").trim_end().to_owned()
}

fn is_numeric(table: &Table, place: usize) -> bool {
    table.rows.iter().filter_map(|row| row.get(place)).all(Cell::is_numeric)
}

/// Style of a table: a line below the heads, and spaces between columns.
const STYLE: TableStyle = TableStyle::new().header_separator(LineStyle::none().fill('─'));

/// Padding of a cell: one space on each side.
const PADDING: usize = 2;

/// Groups of columns that fit side by side; each group begins with the columns that name its rows: the first one, and further ones
/// if they leave a third of the width.
fn blocks(widths: &[usize], further_names: usize, most: usize) -> Vec<Vec<usize>> {
    let width_of = |count: usize| widths.iter().take(count).sum::<usize>();
    let names = match 1 + further_names {
        all if width_of(all) <= most * 2 / 3 => all,
        _ => 1,
    };
    let (mut blocks, mut used) = (vec![(0..names).collect::<Vec<usize>>()], width_of(names));
    for (place, &width) in widths.iter().enumerate().skip(names) {
        let last = blocks.len() - 1;
        if used + width > most && blocks[last].len() > names {
            blocks.push((0..names).chain([place]).collect());
            used = width_of(names) + width;
        } else {
            blocks[last].push(place);
            used += width;
        }
    }
    blocks
}

fn draw(table: &Table, texts: &[Vec<String>], heads: &[String], places: &[usize]) -> String {
    let mut drawn = comfy_table::Table::new();
    drawn.load_style(STYLE);
    drawn.set_content_arrangement(ContentArrangement::Disabled);
    let aligned = |text: &str, right: bool| {
        let alignment = if right { CellAlignment::Right } else { CellAlignment::Left };
        comfy_table::Cell::new(text).set_alignment(alignment)
    };
    drawn.set_header(places.iter().map(|&place| aligned(&heads[place], is_numeric(table, place))));
    for (cells, texts) in table.rows.iter().zip(texts) {
        drawn.add_row(places.iter().map(|&place| match cells.get(place) {
            Some(cell) => aligned(&texts[place], cell.is_numeric()),
            None => aligned("", false),
        }));
    }
    drawn.lines().map(|line| line.trim_end().to_owned() + "\n").collect()
}

/// Prints an error to stderr: one line, then its place in the file and the suggested correction.
pub fn report(failure: &Failure) -> Exit {
    let mut err = io::stderr().lock();
    match failure {
        Failure::ClosedPipe => Exit::Done,
        Failure::Other(message, exit) => {
            let _ = writeln!(err, "error: {}", escaped(message));
            *exit
        }
        Failure::File(error) => {
            let _ = writeln!(err, "error: {}", escaped(&error.to_string()));
            let _ = match excerpt(error, colours(&io::stderr())) {
                Some(text) => writeln!(err, "{text}"),
                None => error.help().map_or(Ok(()), |help| {
                    writeln!(err, "  help: {}", escaped(&help.replace('\n', "\n        ")))
                }),
            };
            Exit::Bad
        }
    }
}

/// Renders the line of a mistake in a file, underlined, and the suggested correction; `None` if the mistake has no
/// line.
fn excerpt(error: &FileError, colours: bool) -> Option<String> {
    let (text, span) = error.excerpt().filter(|_| error.line().is_some())?;
    let line =
        Snippet::source(text).path(escaped(error.path())).annotation(AnnotationKind::Primary.span(span));
    let place = Group::with_level(Level::ERROR).element(line);
    let width = usize::from(width().unwrap_or(100));
    let group = match error.help() {
        Some(help) => {
            let lines: Vec<String> =
                help.lines().map(|line| wrap(line, width.saturating_sub(HELP_INDENT))).collect();
            place.element(Level::HELP.message(lines.join("\n")))
        }
        None => place,
    };
    let renderer = if colours { Renderer::styled() } else { Renderer::plain() };
    Some(renderer.decor_style(DecorStyle::Unicode).term_width(width).render(&[group]))
}

/// Columns to the left of a help text: a line number of up to four digits, and `help: `.
const HELP_INDENT: usize = 12;

/// True if a stream supports colours.
fn colours(stream: &impl IsTerminal) -> bool {
    stream.is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty())
}

/// Width of the terminal in columns; `None` without a terminal.
fn width() -> Option<u16> {
    io::stdout().is_terminal().then(|| terminal_size::terminal_size().map(|(width, _)| width.0)).flatten()
}

/// Wraps a paragraph to the width of the terminal, with a line end.
pub fn wrapped(text: &str) -> String {
    wrap(text, usize::from(width().unwrap_or(100))) + "\n"
}

/// Wraps text into lines no longer than `width`.
fn wrap(text: &str, width: usize) -> String {
    let mut lines: Vec<String> = vec![String::new()];
    for word in text.split_whitespace() {
        let last = lines.len() - 1;
        if !lines[last].is_empty() && lines[last].chars().count() + 1 + word.chars().count() > width {
            lines.push(word.to_owned());
        } else {
            if !lines[last].is_empty() {
                lines[last].push(' ');
            }
            lines[last].push_str(word);
        }
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::{blocks, escaped, excerpt, head, render};
    use opspace_experiment::evaluate::table::{Cell, Table};
    use opspace_experiment::{FileError, Source};
    use std::borrow::Cow;

    /// Checks that the line, its place and the help are shown, that the underline is below the mistake, and that
    /// there are no escape sequences without colours.
    #[test]
    fn a_mistake_is_shown_underlined_in_its_line() {
        let source = Source::new("tasks/x.toml", "robot = 1\n\tname = \"\u{e9}lan\" # two\n");
        let error = FileError::at_key(&source, "name", "is wrong", Some("write another".to_owned()));
        let text = excerpt(&error, false).expect("a line");
        assert!(text.contains("tasks/x.toml:2:"), "{text}");
        assert!(text.contains("help: write another") && !text.contains('\u{1b}'), "{text}");
        let lines: Vec<&str> = text.lines().collect();
        let at = lines.iter().position(|line| line.contains("# two")).expect("the line");
        let column = |line: &str, part: char| line.chars().position(|c| c == part);
        assert_eq!(column(lines[at], '"'), column(lines[at + 1], '\u{2501}'), "{text}");
        assert_eq!(lines[at + 1].matches('\u{2501}').count(), "\"\u{e9}lan\"".chars().count(), "{text}");
        assert!(excerpt(&error, true).is_some_and(|text| text.contains('\u{1b}')));
        assert_eq!(excerpt(&FileError::of_file("x.toml", "is missing", None), false), None);
    }

    /// Checks a name with an escape sequence, a carriage return and an override of the direction of text.
    #[test]
    fn control_and_bidirectional_characters_are_escaped() {
        assert_eq!(escaped("a\u{1b}[31mb\r\u{202e}c\td\n"), "a\\u{1b}[31mb\\u{d}\\u{202e}c\td\n");
        let plain = "Größe µs – 1 °\n";
        assert!(matches!(escaped(plain), Cow::Borrowed(text) if text == plain));
    }

    #[test]
    fn wide_tables_continue_below_with_first_column() {
        assert_eq!(blocks(&[10, 5, 5, 5], 0, 25), [vec![0, 1, 2, 3]]);
        assert_eq!(blocks(&[10, 5, 5, 5], 0, 24), [vec![0, 1, 2], vec![0, 3]]);
        assert_eq!(blocks(&[10, 5, 5, 5], 0, 3), [vec![0, 1], vec![0, 2], vec![0, 3]], "never none at all");
        assert_eq!(blocks(&[10, 5, 5, 5], 1, 23), [vec![0, 1, 2], vec![0, 1, 3]], "rows have two names");
        assert_eq!(blocks(&[10, 9, 5, 5], 1, 24), [vec![0, 1, 2], vec![0, 3]], "long names");
    }

    /// Checks the head of a column of eight words, and that no line of a table without a terminal has more than 100 columns.
    #[test]
    fn heads_have_three_lines_and_tables_a_hundred_columns() {
        let titles = [("joint", ""), ("desired torque above 8 Hz, rms", "N·m")];
        let columns = [&titles[..1], &[titles[1]; 12]].concat();
        let mut table = Table::new(&columns);
        table.push(std::iter::once("shoulder_pitch".into()).chain(vec![Cell::Number(0.1); 12]).collect());
        assert_eq!(head(&table, 1), "desired torque\nabove 8 Hz, rms\n(N·m)");
        let text = render(&table);
        assert!(text.lines().all(|line| line.chars().count() <= 100), "{text}");
        assert_eq!(text.matches("0.1000").count(), 12, "{text}");
    }
}

//! Report as one self-contained HTML page: without network access or fonts. Its scripts save figures as files, and play a run.
//!
//! The page is valid XML and HTML, has a light and a dark colour scheme, and can be printed.

use std::fmt::Write as _;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use hmac_sha256::Hash;
use plotters::style::RGBColor;

use crate::collision_moments::CollisionMoment;
use crate::collision_views::{caption, title, views};
use crate::dot_columns::DotColumns;
use crate::figure::{Comparison, Figure, INK, PALETTE, escape};
use crate::player::{CODE_HASH, LOADER, PLACE, scripts};
use crate::run_pictures::RunPictures;
use opspace_experiment::evaluate::table::{Cell, Table};

/// Page under construction; blocks appear in the order in which they are added.
#[derive(Clone, Debug)]
#[must_use]
pub struct Page {
    title: String,
    body: String,
    tables: usize,
    figures: usize,
    /// Elements of the player at the end of the page; empty without one.
    player: String,
}

impl Page {
    /// Creates an empty page.
    pub fn new(title: impl Into<String>) -> Self {
        Self { title: title.into(), body: String::new(), tables: 0, figures: 0, player: String::new() }
    }

    /// Sets the summary at the top of the page: one or two sentences.
    pub fn lead(self, text: &str) -> Self {
        self.block(&format!("<p class=\"lead\">{}</p>", escape(text)))
    }

    /// Adds a heading; the blocks that follow belong to it.
    pub fn section(self, heading: &str) -> Self {
        self.block(&format!("<h2>{}</h2>", escape(heading)))
    }

    /// Adds a paragraph of text.
    pub fn paragraph(self, text: &str) -> Self {
        self.block(&format!("<p>{}</p>", escape(text)))
    }

    /// Adds a highlighted warning, for example about a failed run or lost data; a text that begins with `Note: ` is a note.
    pub fn warning(self, text: &str) -> Self {
        let (kind, text) = text.strip_prefix("Note: ").map_or(("Warning", text), |text| ("Note", text));
        self.block(&format!(
            "<p class=\"warning\" role=\"note\"><strong>{kind}.</strong> {}</p>",
            escape(text)
        ))
    }

    /// Adds what happened in a run, in a few sentences.
    pub fn story(self, sentences: &[String]) -> Self {
        if sentences.is_empty() {
            self
        } else {
            self.block(&format!("<p class=\"story\">{}</p>", escape(&sentences.join(" "))))
        }
    }

    /// Adds a list of terms and their values: seeds, versions, files.
    pub fn facts<T: AsRef<str>, D: AsRef<str>>(self, facts: impl IntoIterator<Item = (T, D)>) -> Self {
        let fact = |(term, text): (T, D)| {
            format!("<div><dt>{}</dt><dd>{}</dd></div>\n", escape(term.as_ref()), escape(text.as_ref()))
        };
        let list: String = facts.into_iter().map(fact).collect();
        self.block(&format!("<dl>\n{list}</dl>"))
    }

    /// Adds a numbered table with notes below it.
    pub fn table(mut self, caption: &str, table: &Table, notes: &[&str]) -> Self {
        self.tables += 1;
        let number = self.tables;
        let mut html = format!(
            "<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Table {number}\"><table>\n\
             <caption><b>Table {number}.</b> {}</caption>\n<thead><tr>",
            escape(caption)
        );
        for (place, column) in table.columns.iter().enumerate() {
            let numeric = table.rows.iter().filter_map(|row| row.get(place)).all(Cell::is_numeric);
            let class = if numeric && !table.rows.is_empty() { " class=\"number\"" } else { "" };
            let unit = match column.unit.as_str() {
                "" => String::new(),
                unit => format!(" <span class=\"unit\">{}</span>", escape(unit)),
            };
            // Writing to a String cannot fail.
            let _ = write!(html, "<th scope=\"col\"{class}>{}{unit}</th>", escape(&column.title));
        }
        html.push_str("</tr></thead>\n<tbody>\n");
        let width = table.rows.iter().map(Vec::len).chain([table.columns.len()]).max().unwrap_or(0);
        for (row, texts) in table.rows.iter().zip(table.texts()) {
            html.push_str("<tr>");
            // A row of one cell is a heading of the rows below it.
            if let ([_], [text], 2..) = (&row[..], &texts[..], width) {
                let _ =
                    writeln!(html, "<th scope=\"rowgroup\" colspan=\"{width}\">{}</th></tr>", escape(text));
                continue;
            }
            for place in 0..width {
                html.push_str(&cell(row.get(place), texts.get(place), place));
            }
            html.push_str("</tr>\n");
        }
        if table.rows.is_empty() {
            let _ = writeln!(html, "<tr><td colspan=\"{}\">no rows</td></tr>", width.max(1));
        }
        html.push_str("</tbody></table></div>");
        for note in notes {
            let _ = write!(html, "\n<p class=\"note\">{}</p>", escape(note));
        }
        self.block(&html)
    }

    /// Adds a numbered figure.
    pub fn figure(self, figure: &Figure) -> Self {
        let caption = format!("{} {}", figure.caption, figure.remark);
        self.drawing(&figure.svg(), &figure.title, caption.trim_end())
    }

    /// Adds a comparison; it is numbered like a figure.
    pub fn comparison(self, comparison: &Comparison) -> Self {
        self.drawing(&comparison.svg(), &comparison.title, &comparison.caption)
    }

    /// Adds runs side by side; they are numbered like a figure.
    pub(crate) fn dot_columns(self, chart: &DotColumns) -> Self {
        self.drawing(&chart.svg(), chart.title(), chart.caption())
    }

    /// Adds arm, collision geometry and environment at some moments of a run as one numbered figure; nothing if there are none.
    pub fn collisions(mut self, moments: &[CollisionMoment]) -> Self {
        if moments.is_empty() {
            return self;
        }
        self.figures += 1;
        let html = format!(
            "<figure class=\"views\" id=\"figure-{number}\">\n{}<figcaption><b>Figure {number}. {}.</b> {}{SAVE}</figcaption>\n</figure>",
            views(moments),
            title(moments),
            escape(&caption(moments)),
            number = self.figures,
        );
        self.block(&html)
    }

    /// Adds the player of a run, of which a page has one, with all its robots and their names; nothing without pictures.
    /// `are_compared`: all robots have the same task.
    pub(crate) fn player(mut self, robots: &[(&str, &RunPictures)], are_compared: bool) -> Self {
        if robots.is_empty() {
            return self;
        }
        self.player = scripts(robots, are_compared);
        self.block(PLACE)
    }

    /// Returns the whole page.
    #[must_use]
    pub fn render(&self) -> String {
        let title = escape(&self.title);
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n\
             <meta name=\"color-scheme\" content=\"light dark\"/>\n<title>{title}</title>\n\
             <meta http-equiv=\"Content-Security-Policy\" content=\"{}\"/>\n\
             <style>\n{STYLE}{}</style>\n</head>\n<body>\n<main>\n<h1>{}</h1>\n{}</main>\n<script>{SCRIPT}</script>\n{}</body>\n</html>\n",
            policy(!self.player.is_empty()),
            dark_figures(),
            unbroken(&title),
            self.body,
            self.player
        )
    }

    fn drawing(mut self, svg: &str, title: &str, caption: &str) -> Self {
        self.figures += 1;
        let number = self.figures;
        let html = format!(
            "<figure id=\"figure-{number}\">\n<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Figure {number}\">{svg}</div>\n\
             <figcaption><b>Figure {number}. {}.</b> {}{SAVE}</figcaption>\n</figure>",
            escape(title.trim_end_matches('.')),
            escape(caption)
        );
        self.block(&html)
    }

    fn block(mut self, html: &str) -> Self {
        self.body.push_str(html);
        self.body.push('\n');
        self
    }
}

/// Marks the words with a hyphen in escaped text, at which a browser would break a line.
fn unbroken(text: &str) -> String {
    let word = |word: &str| match word.contains('-') {
        true => format!("<span class=\"word\">{word}</span>"),
        false => word.to_owned(),
    };
    text.split(' ').map(word).collect::<Vec<String>>().join(" ")
}

/// Blanks as wide as an interval of so many characters, ` ±0.43`, of which the space and the point are narrower than digits.
fn wide_blanks(count: usize) -> String {
    let narrow = match count {
        0 => 0,
        1..5 => 1,
        _ => 2,
    };
    ["\u{a0}", "\u{2008}"][..narrow].concat() + &"\u{2007}".repeat(count - narrow)
}

/// Formats a cell; the first cell of a row is the head of the row.
fn cell(cell: Option<&Cell>, text: Option<&String>, place: usize) -> String {
    // A browser drops blanks at the end: those of a number are as wide as digits.
    let blank = |text: &String| {
        let number = text.trim_end();
        escape(number) + &wide_blanks(text.len() - number.len())
    };
    let text = text.map_or_else(String::new, blank);
    let class = match cell {
        Some(Cell::Pass(_)) => " class=\"pass\"",
        Some(Cell::Fail(_)) => " class=\"fail\"",
        Some(cell) if cell.is_numeric() => " class=\"number\"",
        _ => "",
    };
    match place {
        0 => format!("<th scope=\"row\"{class}>{text}</th>"),
        _ => format!("<td{class}>{text}</td>"),
    }
}

/// Style rules that replace the figures' colours in the dark scheme; they match the attributes that `plotters` writes.
fn dark_figures() -> String {
    let rule = |(RGBColor(r, g, b), dark): (RGBColor, &str)| {
        format!(
            "svg [stroke='#{r:02X}{g:02X}{b:02X}'] {{ stroke: {dark} }} \
             svg [fill='#{r:02X}{g:02X}{b:02X}'] {{ fill: {dark} }}\n"
        )
    };
    let rules: String = PALETTE.into_iter().chain([(INK, "var(--ink)")]).map(rule).collect();
    format!("@media screen and (prefers-color-scheme: dark) {{\n{rules}}}\n")
}

/// Permissions of the page in a browser: its own styles, its own scripts by their hashes, and the images that they draw; nothing
/// else, should a name ever become code.
fn policy(has_player: bool) -> String {
    let hash = |script: &str| format!(" 'sha256-{}'", STANDARD.encode(Hash::hash(script.as_bytes())));
    let player = if has_player { format!("{} 'sha256-{CODE_HASH}'", hash(LOADER)) } else { String::new() };
    format!(
        "default-src 'none'; style-src 'unsafe-inline'; img-src blob:; script-src{}{player}",
        hash(SCRIPT)
    )
}

/// Script that saves figures. The page is valid XML, so that it has neither `<` nor `&`.
const SCRIPT: &str = include_str!("save_figure.js");

/// Buttons that save a figure; without the script they are hidden.
const SAVE: &str = " <span class=\"save\" hidden=\"\">Save as <button type=\"button\" data-save=\"svg\">SVG</button> \
    <button type=\"button\" data-save=\"png\">PNG</button></span>";

const STYLE: &str = "\
:root { color-scheme: light dark; --ink: #1c2024; --soft: #5b636b; --line: #d6dade; --back: #ffffff; --stripe: #1c20240a;
  --shade: #1c202466;
  --pass: #00704f; --fail: #b03a00; --warn: #fff3e4 }
@media screen and (prefers-color-scheme: dark) {
  :root { --ink: #e6e8ea; --soft: #a2abb3; --line: #3a4147; --back: #15181b; --stripe: #e6e8ea0a;
    --shade: #e6e8ea66;
    --pass: #4fd0a5; --fail: #ff9a5c; --warn: #3a2a18 }
}
* { box-sizing: border-box }
body { margin: 0; background: var(--back); color: var(--ink); font: 16px/1.55 system-ui, sans-serif }
main { max-width: 70rem; margin: 0 auto; padding: 2.5rem 1.25rem 4rem }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 0.75rem }
h2 { font-size: 1.3rem; margin: 2.75rem 0 0.75rem; padding-top: 0.9rem; border-top: 1px solid var(--line) }
p { max-width: 46rem }
.lead { font-size: 1.12rem; color: var(--soft); margin: 0 0 1.75rem }
.story { font-size: 1.12rem; margin: 0 0 1.25rem }
.warning { background: var(--warn); border-left: 4px solid var(--fail); padding: 0.6rem 0.9rem }
.word { display: inline-block }
/* A shadow at each edge beyond which there is more: it stays in place, and the covers of it move with the content. */
.scroll { overflow-x: auto; padding-bottom: 0.5rem; background: linear-gradient(to right, var(--back) 1rem, transparent) left,
  linear-gradient(to left, var(--back) 1rem, transparent) right, linear-gradient(to right, var(--shade), transparent) left,
  linear-gradient(to left, var(--shade), transparent) right; background-size: 2.5rem 100%, 2.5rem 100%, 0.9rem calc(100% - 4px), 0.9rem calc(100% - 4px);
  background-repeat: no-repeat; background-attachment: local, local, scroll, scroll }
table { border-collapse: collapse; width: 100%; font-size: 0.85rem; margin: 1rem 0 0.4rem }
caption { text-align: left; padding-bottom: 0.5rem; color: var(--ink) }
th, td { padding: 0.35rem 0.5rem; text-align: left; vertical-align: baseline; border-bottom: 1px solid var(--line) }
thead th { border-bottom: 2px solid var(--ink); font-weight: 600; vertical-align: bottom }
thead th.number { white-space: normal }
tbody th { font-weight: 500; white-space: pre }
tbody td { white-space: nowrap }
tbody tr:nth-child(even) { background: var(--stripe) }
.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap }
.unit { font-weight: 400; color: var(--soft); white-space: nowrap }
.pass { color: var(--pass) } .pass::before { content: '\u{2713} ' }
.fail { color: var(--fail); font-weight: 600; min-width: 12rem } .fail::before { content: '\u{2717} ' }
p.note { font-size: 0.86rem; color: var(--soft); margin: 0.2rem 0 }
figure { margin: 1.75rem 0 2.25rem; break-inside: avoid }
/* At this width, the texts of a figure have 12 px. */
figure svg { display: block; width: 100%; min-width: 61rem; height: auto }
figcaption { font-size: 0.92rem; max-width: 50rem; margin-top: 0.6rem; color: var(--soft) }
.save { white-space: nowrap; margin-left: 0.4rem } .save[hidden] { display: none }
.save button { font: inherit; color: inherit; background: none; border: 0; padding: 0 0.15rem; text-decoration: underline; cursor: pointer }
@media (pointer: coarse) { .save button { min-width: 40px; height: 40px } }
figcaption b { color: var(--ink) }
figure text { font-family: system-ui, sans-serif; font-variant-numeric: tabular-nums }
/* The views of a moment are side by side, or below each other on a narrow screen. */
figure.views { break-inside: auto }
.views .row { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(19rem, 100%), 1fr)); gap: 0.5rem 1rem; break-inside: avoid }
.views svg { min-width: 0 }
.views .legend { display: flex; flex-wrap: wrap; gap: 0.2rem 1.2rem; font-size: 0.92rem; margin: 0 }
.views .legend svg { display: inline; width: 1.75rem; vertical-align: -0.1rem }
.views .moment { font-weight: 600; margin: 1.1rem 0 0.2rem; break-after: avoid }
dl { display: grid; grid-template-columns: repeat(auto-fill, minmax(17rem, 1fr)); gap: 0.5rem 1.5rem; font-size: 0.92rem }
dl div { border-left: 3px solid var(--line); padding-left: 0.7rem }
dt { color: var(--soft); font-size: 0.84rem } dd { margin: 0; overflow-wrap: anywhere; white-space: pre-line }
@media screen and (max-width: 40rem) { main { padding: 1.5rem 0.75rem 3rem } h1 { font-size: 1.4rem }
  table { font-size: 0.75rem } th, td { padding: 0.3rem 0.25rem } tbody th { white-space: pre-wrap } }
@media screen and (max-width: 63.5rem) {
  figure:not(.views)::before { content: 'Scroll the figure sideways to see all of it.'; font-size: 0.86rem; color: var(--soft) } }
@media print { .save { display: none } main { max-width: none; padding: 0 } figure svg { min-width: 0 } .scroll { overflow: visible }
  h2 { break-after: avoid } tr { break-inside: avoid } }
";

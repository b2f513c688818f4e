//! Pages of codes and of the command line: generated from what the program prints.

use super::assert_page;
use crate::cli_common::{ROOT, opspace, project, read};
use std::fmt::Write;
use std::path::Path;

/// Beginning of the page of codes.
const CODES: &str = "\
# Codes

Generated from the pages of `opspace explain`. Each diagnostic of `opspace check`, each refusal of a run, each note about a run and each warning
about a model has a code in brackets, such as `[gear-oscillation]`. A code remains the same when its text changes. A mistake in a file, an unknown
key for example, has none.

`--allow CODE` (of `run`, `check` and `bench`, also of experiments; can be repeated) turns a refusal into a warning, which terminal, summary, page and log
carry. Refusals without which results would be false, or a robot in danger, cannot be allowed.

| code | effect | problem |
|---|---|---|
";

/// Beginning of the page of the command line.
const COMMANDS: &str = "\
# Command line

Generated from the help of the program. [Exit codes](exit-codes.md) has the exit code of each cause.
";

/// Compared: the committed page, and the codes that the program explains.
#[test]
fn code_pages_match_the_program() {
    let listed = opspace(Path::new(ROOT), &["explain"]).exits(0).stdout;
    let mut page = CODES.to_owned();
    let mut count = 0;
    for line in listed.lines().filter(|line| line.starts_with(|c: char| c.is_ascii_lowercase())) {
        let (code, rest) = line.split_once(' ').expect("a code");
        let (effect, problem) = rest.trim_start().split_once("  ").expect("an effect and a problem");
        writeln!(page, "| [`{code}`](#{code}) | {effect} | {} |", problem.trim()).expect("a text");
        count += 1;
    }
    assert!(count > 50, "{count} codes");
    let pages = read(project("crates/opspace-experiment/src/codes.md"));
    let (_, sections) = pages.split_once("\n## ").expect("a section for each code");
    assert_eq!(sections.matches("\n## ").count() + 1, count);
    assert_page("docs/reference/codes.md", &format!("{page}\n## {sections}"));
}

/// Compared: the committed page, and the help of all commands.
#[test]
fn command_pages_match_the_program() {
    let mut page = COMMANDS.to_owned();
    help(&mut page, &[]);
    assert!(page.matches("\n## ").count() > 15, "{page}");
    assert_page("docs/reference/command-line.md", &page);
}

/// Appends the help of a command and of its subcommands.
fn help(page: &mut String, command: &[&str]) {
    let said = opspace(Path::new(ROOT), &[command, &["--help"]].concat()).exits(0).stdout;
    let lines: Vec<&str> = said.lines().map(str::trim_end).collect();
    let name = [&["opspace"], command].concat().join(" ");
    write!(page, "\n## `{name}`\n\n```text\n{}\n```\n", lines.join("\n").trim_end()).expect("a text");
    let commands = lines.iter().skip_while(|line| **line != "Commands:").skip(1);
    for line in commands.take_while(|line| !line.is_empty()) {
        // A name is indented by two spaces, the continuation of its description by more.
        let name = line.strip_prefix("  ").filter(|rest| !rest.starts_with(' '));
        let Some(name) = name.and_then(|rest| rest.split_whitespace().next()) else { continue };
        if name != "help" {
            help(page, &[command, &[name]].concat());
        }
    }
}

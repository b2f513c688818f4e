//! Commands within sentences and tables, and those in the help of the program: their options and targets exist.

use super::pages::blocks;
use super::{SHORTENED, clone, docs, in_shell, show, stands_for};
use crate::cli_common::{project, read};
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

/// Page of the help.
const HELP: &str = "docs/reference/command-line.md";

/// Words in commands that stand for numbers or settings.
const PLACEHOLDERS: [(&str, &str); 5] = [
    ("explain CODE", "explain"),
    ("x,y,z,roll,pitch,yaw", "0,0,0,0,0,0"),
    ("x,y,z", "0,0,0"),
    ("X.toml --set", "X.toml --set seed=1"),
    ("…", ""),
];

/// Examples of the help that no test of this page runs, with the reason. `…` at the end of a command stands for any rest.
const NOT_RUN: [(&str, &str); 8] = [
    ("opspace bench", "takes minutes; the step acceptance of .ci/run runs it"),
    ("opspace bench --baseline …", "compares with earlier results; suites.rs has such a comparison"),
    ("opspace bench tasks/suites/limits.toml --shard …", "a third of a suite; suites.rs runs shards"),
    ("opspace bench tasks/suites/limits.toml --plants …", "needs MuJoCo: howto/mujoco.md has it"),
    ("opspace run tasks/panda-reach.toml --plant mujoco", "needs MuJoCo: howto/mujoco.md has it"),
    ("opspace check tasks/*.toml …", "takes minutes"),
    ("opspace identify …", "takes a minute or needs the arm; the step acceptance of .ci/run runs it"),
    ("opspace new …", "URDFs of the reader"),
];

/// Compared: each command `opspace …` in a sentence or table, and the options that the program knows.
#[test]
fn commands_in_sentences_have_options_that_exist() {
    let folder = clone();
    let mut count = 0;
    for (place, span) in spans().iter().collect::<BTreeSet<_>>() {
        let Some(rest) = span.strip_prefix("opspace ") else { continue };
        if !rest.starts_with(|c: char| c.is_ascii_lowercase()) {
            continue;
        }
        let replaced = |text: String, (from, to): &(&str, &str)| text.replace(from, to);
        let command = PLACEHOLDERS.iter().fold(span.clone(), replaced);
        let output = in_shell(folder.path(), &format!("{} --help", command.replace("...", "")));
        assert!(output.status.success(), "{place}: `{span}`: {}", String::from_utf8_lossy(&output.stderr));
        count += 1;
    }
    assert!(count > 60, "{count} commands");
}

/// Compared: each option in a sentence or table, and those of the help.
#[test]
fn options_in_sentences_exist() {
    let help = read(project(HELP));
    let known: BTreeSet<&str> = options(&help).collect();
    assert!(known.len() > 50, "{known:?}");
    let mut count = 0;
    for (place, span) in spans() {
        // Commands of other programs, and a part of one.
        let others =
            ["cargo ", "target/", "pip ", "npm ", "xcode-select ", "BOLERO_", "--workspace", "--test "];
        if others.iter().any(|other| span.starts_with(other)) {
            continue;
        }
        for option in options(&span) {
            assert!(known.contains(option), "{place}: `{span}`: no option {option}");
            count += 1;
        }
    }
    assert!(count > 120, "{count} options");
}

/// Compared: the targets and filters of `cargo` commands, and the files of the project.
#[test]
fn cargo_commands_name_targets_that_exist() {
    let mut sources = BTreeSet::new();
    ["crates", "examples", "tests", "benches"]
        .iter()
        .for_each(|folder| collect(Path::new(&project(folder)), &mut sources));
    let targets = read(project("Cargo.toml")) + &read(project("crates/opspace-testing/Cargo.toml"));
    let mut names: BTreeSet<String> = BTreeSet::new();
    for source in &sources {
        names.extend(
            read(source).lines().filter_map(|line| line.trim().strip_prefix("fn ")).map(str::to_owned),
        );
        names.extend(source.rsplit_once('/').map(|(_, name)| name.trim_end_matches(".rs").to_owned()));
    }
    let is_file = |folder: &str, name: &str| {
        let ends = [format!("/{folder}/{name}.rs"), format!("/{folder}/{name}/main.rs")];
        sources.iter().any(|source| ends.iter().any(|end| source.ends_with(end)))
    };
    let mut count = 0;
    for (place, command) in spans().into_iter().chain(console_commands()) {
        let Some((_, rest)) = command.split_once("cargo ") else { continue };
        let mut words = rest.split([' ', '\n']).take_while(|word| !["--", "&&", "|", "…"].contains(word));
        let (is_test, mut after_target) = (words.next() == Some("test"), false);
        while let Some(word) = words.next() {
            let folder = match word {
                "--example" => "examples",
                "--bench" => "benches",
                "--test" => "tests",
                "-p" | "--features" => {
                    words.next();
                    continue;
                }
                filter if is_test && after_target && !filter.starts_with('-') => {
                    assert!(
                        names.iter().any(|name| name.contains(filter)),
                        "{place}: `{command}`: no test {filter}"
                    );
                    continue;
                }
                _ => continue,
            };
            let name = words.next().unwrap_or_else(|| panic!("{place}: `{command}`: no name"));
            let is_declared = targets.contains(&format!("name = \"{name}\""));
            assert!(is_declared || is_file(folder, name), "{place}: `{command}`: no {word} {name}");
            after_target = folder == "tests";
            count += 1;
        }
    }
    assert!(count > 25, "{count} targets");
}

/// Examples and first steps of the help are run.
#[test]
fn examples_of_the_help_are_run() {
    let folder = clone();
    fs::copy(project("robots/ur5e/ur5e.urdf"), folder.path().join("my-arm.urdf")).unwrap();
    let mut examples: Vec<String> = Vec::new();
    for block in blocks(&read(project(HELP))) {
        let lines = block.text.lines().skip_while(|line| !["Examples:", "First steps:"].contains(line));
        for line in lines.skip(1).take_while(|line| line.starts_with("  ")) {
            // A description follows after two spaces; a long command continues in the next line.
            let text = line.trim_start().split("  ").next().unwrap();
            match examples.last_mut() {
                Some(last) if !text.starts_with("opspace ") => *last = format!("{last} {text}"),
                _ => examples.push(text.to_owned()),
            }
        }
    }
    assert!(examples.len() > 15, "{examples:?}");
    for (pattern, _) in NOT_RUN {
        assert!(examples.iter().any(|example| stands_for(pattern, example)), "{pattern}: no such example");
    }
    for text in examples {
        if NOT_RUN.iter().any(|(pattern, _)| stands_for(pattern, &text)) {
            continue;
        }
        if text.contains(" --view") {
            show(folder.path(), &text, HELP);
            continue;
        }
        let shortened = SHORTENED.iter().find(|(pattern, _)| stands_for(pattern, &text));
        let output = in_shell(
            folder.path(),
            &shortened.map_or(text.clone(), |(_, options)| format!("{text} {options}")),
        );
        assert!(output.status.success(), "{text}: {}", String::from_utf8_lossy(&output.stderr));
    }
}

/// Code spans outside of blocks, each with its page.
fn spans() -> Vec<(String, String)> {
    let mut spans = Vec::new();
    for page in pages() {
        let (mut text, mut is_code) = (String::new(), false);
        for line in read(project(&page)).lines() {
            is_code ^= line.trim_start().starts_with("```");
            text += if is_code || line.trim_start().starts_with("```") { "" } else { line };
            text.push(' ');
        }
        let inside = text.split('`').skip(1).step_by(2);
        spans
            .extend(inside.map(|span| (page.clone(), span.split_whitespace().collect::<Vec<_>>().join(" "))));
    }
    spans
}

/// Commands of `console` blocks, each with its page.
fn console_commands() -> Vec<(String, String)> {
    let mut commands = Vec::new();
    for page in pages() {
        for block in blocks(&read(project(&page))).iter().filter(|block| block.language == "console") {
            commands.extend(
                super::pages::commands(block).into_iter().map(|command| (page.clone(), command.text)),
            );
        }
    }
    commands
}

/// Pages with commands: those below `docs` but the help, and those of the project and its crates.
fn pages() -> Vec<String> {
    let own = ["README.md", "CONTRIBUTING.md", "python/README.md"].map(str::to_owned);
    let mut pages: Vec<String> =
        docs().into_iter().filter(|page| !page.ends_with("command-line.md")).chain(own).collect();
    for entry in fs::read_dir(project("crates")).unwrap() {
        let page = format!("crates/{}/README.md", entry.unwrap().file_name().into_string().unwrap());
        pages.extend(Some(page).filter(|page| Path::new(&project(page)).exists()));
    }
    pages
}

/// Options in a text, such as `--out`.
fn options(text: &str) -> impl Iterator<Item = &str> {
    let words = text.split(|c: char| !(c.is_ascii_lowercase() || c == '-'));
    words.filter(|word| {
        word.strip_prefix("--").is_some_and(|name| name.starts_with(|c: char| c.is_ascii_lowercase()))
    })
}

/// Sources below a folder.
fn collect(folder: &Path, sources: &mut BTreeSet<String>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() && !path.ends_with("target") && !path.ends_with("node_modules") {
            collect(&path, sources);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            sources.insert(path.display().to_string());
        }
    }
}

//! URDFs of arms with mistakes: numbers, attributes, names and lines of a generated file are changed.

use crate::arm::Judge;
use crate::generate;
use opspace_testing::random::Random;
use std::fs;
use std::path::Path;

/// Numbers in place of others.
const NUMBERS: [&str; 16] = [
    "0", "-1", "1e-300", "1e300", "nan", "inf", "-inf", "", "1,5", "0x10", "abc", "1e-12", "1e6", "-0.0",
    "3.15", "1 2",
];

/// Words in place of names and types.
const WORDS: [&str; 14] = [
    "",
    "fixed",
    "revolute",
    "continuous",
    "prismatic",
    "floating",
    "planar",
    "base_link",
    "tool0",
    "j1",
    "link 1",
    "ä",
    "a.b",
    "world",
];

/// Largest number of changes of a file.
const MOST_CHANGES: usize = 3;

/// Returns a generated URDF with one to three changes.
pub fn urdf(number: usize, seed: u64) -> String {
    let mut random = Random(seed.wrapping_mul(7919).wrapping_add(number as u64));
    let mut text = generate::urdf(number, seed);
    for _ in 0..=random.below(MOST_CHANGES) {
        text = match random.below(8) {
            5.. => with_scaled_number(&text, &mut random),
            0 => with_value(&text, &NUMBERS, |value| value.parse::<f64>().is_ok(), &mut random),
            1 => with_number(&text, &mut random),
            2 => with_value(&text, &WORDS, |value| value.parse::<f64>().is_err(), &mut random),
            3 => without_attribute(&text, &mut random),
            _ => with_other_line(&text, &mut random),
        };
    }
    text
}

/// Ranges of the values in quotation marks that pass a test.
fn values(text: &str, passes: impl Fn(&str) -> bool) -> Vec<(usize, usize)> {
    let quotes: Vec<usize> = text.match_indices('"').map(|(at, _)| at).collect();
    let ranges = quotes.chunks_exact(2).map(|pair| (pair[0] + 1, pair[1]));
    ranges.filter(|&(from, to)| passes(&text[from..to])).collect()
}

/// Replaces a value that passes a test.
fn with_value(text: &str, others: &[&str], passes: impl Fn(&str) -> bool, random: &mut Random) -> String {
    let found = values(text, passes);
    if found.is_empty() {
        return text.to_owned();
    }
    let (from, to) = found[random.below(found.len())];
    text[..from].to_owned() + others[random.below(others.len())] + &text[to..]
}

/// Replaces one of the numbers of a vector.
fn with_number(text: &str, random: &mut Random) -> String {
    let other = NUMBERS[random.below(NUMBERS.len())];
    with_changed_number(text, 2, random, |_| other.to_owned())
}

/// Multiplies a number by a power of ten, or changes its sign.
fn with_scaled_number(text: &str, random: &mut Random) -> String {
    let factor = [-1.0, 0.0, 1e-9, 1e-3, 0.1, 10.0, 1e3, 1e9][random.below(8)];
    with_changed_number(text, 1, random, |number| format!("{}", number * factor))
}

/// Changes one of at least `least` numbers of a value.
fn with_changed_number(
    text: &str,
    least: usize,
    random: &mut Random,
    change: impl Fn(f64) -> String,
) -> String {
    let count = |value: &str| value.split_whitespace().filter(|number| number.parse::<f64>().is_ok()).count();
    let found = values(text, |value| count(value) >= least);
    if found.is_empty() {
        return text.to_owned();
    }
    let (from, to) = found[random.below(found.len())];
    let mut words: Vec<String> = text[from..to].split_whitespace().map(str::to_owned).collect();
    let at = random.below(words.len());
    if let Ok(number) = words[at].parse() {
        words[at] = change(number);
    }
    text[..from].to_owned() + &words.join(" ") + &text[to..]
}

/// Removes an attribute.
fn without_attribute(text: &str, random: &mut Random) -> String {
    let found = values(text, |_| true);
    let (from, to) = found[random.below(found.len())];
    let begin = text[..from].rfind(' ').unwrap_or(from);
    text[..begin].to_owned() + &text[to + 1..]
}

/// Removes or repeats a line, or moves it to another place.
fn with_other_line(text: &str, random: &mut Random) -> String {
    let mut lines: Vec<&str> = text.lines().collect();
    let at = random.below(lines.len());
    let other = random.below(lines.len());
    match random.below(3) {
        0 => drop(lines.remove(at)),
        1 => lines.insert(at, lines[at]),
        _ => lines.swap(at, other),
    }
    lines.join("\n")
}

/// Outcome of the trial of a file.
pub enum Outcome {
    /// `new` wrote a robot that `check` accepts.
    Accepted,
    /// `new` refused the file, said why, and wrote nothing.
    Refused,
    Wrong(String),
}

/// Tries a file in a folder, which is removed before.
pub fn try_file(judge: &Judge, urdf: &Path, folder: &Path) -> Outcome {
    // What is left from an earlier try must not count.
    drop(fs::remove_dir_all(folder));
    let robot = folder.join("robot");
    let task = robot.join("first-task.toml");
    let text = |path: &Path| path.display().to_string();
    match judge.run("new", &[&text(&robot), "--urdf", &text(urdf), "--assume"]) {
        Err(words) if robot.exists() => Outcome::Wrong(format!("refused, but wrote a robot: {words}")),
        Err(words) if words.contains("error") && words.ends_with("exit code 2") => Outcome::Refused,
        Err(words) => Outcome::Wrong(format!("new: {words}")),
        Ok(()) => match judge.run("check", &[&text(&robot), &text(&task)]) {
            Ok(()) => Outcome::Accepted,
            Err(words) => Outcome::Wrong(format!("check refuses it: {words}")),
        },
    }
}

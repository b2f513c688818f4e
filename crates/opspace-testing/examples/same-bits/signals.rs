//! Table of signals whose names differ between two builds.
//!
//! Each line contains one rule; the first matching rule applies. Names consist of channel and signal,
//! `tick/hand.force`. One `*` matches any text; in the new name it stands for the same text. Text after `#` is a
//! comment.
//!
//! ```text
//! *.weakest_share -> *.min_singular_gain
//! tick/spare -> (gone) nothing read it
//! (new) servo/temperature measured since
//! (text) is not a finite number -> is no number
//! ```
//!
//! The last kind of rule replaces words in the text of a fault.

use std::collections::BTreeSet;

/// Table of renamed signals.
#[derive(Clone, Debug, Default)]
pub struct Table {
    rules: Vec<Rule>,
}

#[derive(Clone, Debug)]
struct Rule {
    text: String,
    kind: Kind,
    old: String,
    new: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Renamed,
    Gone,
    New,
    Text,
}

/// Fate of a signal in the new build.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fate {
    /// The signal exists under this name.
    Called(String),
    /// The signal no longer exists.
    Gone,
}

impl Table {
    /// Parses a table.
    ///
    /// # Errors
    /// A line that is not a valid rule.
    pub fn parse(text: &str) -> Result<Self, String> {
        let lines = text.lines().map(|line| line.split('#').next().unwrap_or_default().trim());
        let rules = lines.filter(|line| !line.is_empty()).map(rule).collect::<Result<_, _>>()?;
        Ok(Self { rules })
    }

    /// Returns the fate of a signal of the old build.
    #[must_use]
    pub fn fate(&self, old: &str) -> Fate {
        for rule in &self.rules {
            match (rule.kind, matched(&rule.old, old)) {
                (Kind::Gone, Some(_)) => return Fate::Gone,
                (Kind::Renamed, Some(text)) => return Fate::Called(rule.new.replacen('*', text, 1)),
                _ => {}
            }
        }
        Fate::Called(old.to_owned())
    }

    /// True if the table lists a signal of the new build as new.
    #[must_use]
    pub fn is_new(&self, new: &str) -> bool {
        self.rules.iter().any(|rule| rule.kind == Kind::New && matched(&rule.new, new).is_some())
    }

    /// Replaces the words of the old build in a text by those of the new build.
    #[must_use]
    pub fn reworded(&self, old: &str) -> String {
        let rules = self.rules.iter().filter(|rule| rule.kind == Kind::Text);
        rules.fold(old.to_owned(), |text, rule| text.replace(&rule.old, &rule.new))
    }

    /// Returns the lines that match no name of the old or new build.
    #[must_use]
    pub fn idle(&self, old: &BTreeSet<String>, new: &BTreeSet<String>) -> Vec<&str> {
        let fits = |rule: &&Rule| match rule.kind {
            Kind::New => new.iter().any(|name| matched(&rule.new, name).is_some()),
            Kind::Text => true,
            Kind::Renamed | Kind::Gone => old.iter().any(|name| matched(&rule.old, name).is_some()),
        };
        self.rules.iter().filter(|rule| !fits(rule)).map(|rule| rule.text.as_str()).collect()
    }
}

fn rule(line: &str) -> Result<Rule, String> {
    let made = |kind, old: &str, new: &str| Rule {
        text: line.to_owned(),
        kind,
        old: old.trim().to_owned(),
        new: new.trim().to_owned(),
    };
    if let Some(text) = line.strip_prefix("(text) ") {
        let (old, new) = text.split_once(" -> ").ok_or_else(|| format!("'{line}' has no ' -> '"))?;
        return Ok(made(Kind::Text, old, new));
    }
    let rule = if let Some(new) = line.strip_prefix("(new) ") {
        let lacking = || format!("'{line}' lacks a reason");
        let (name, _) = new.trim().split_once(' ').ok_or_else(lacking)?;
        made(Kind::New, "", name)
    } else {
        let (old, new) = line.split_once(" -> ").ok_or_else(|| format!("'{line}' has no ' -> '"))?;
        match new.trim().strip_prefix("(gone)") {
            Some(reason) if reason.trim().is_empty() => return Err(format!("'{line}' lacks a reason")),
            Some(_) => made(Kind::Gone, old, ""),
            None => made(Kind::Renamed, old, new),
        }
    };
    let stars = |name: &str| name.matches('*').count();
    let lost = rule.kind == Kind::Renamed && stars(&rule.old) != stars(&rule.new);
    if lost || stars(&rule.old).max(stars(&rule.new)) > 1 {
        return Err(format!("'{line}': one '*' at most, and on both sides or none"));
    }
    let blank = |name: &str| name.contains(char::is_whitespace);
    if blank(&rule.old) || blank(&rule.new) {
        return Err(format!("'{line}': a name has no blanks"));
    }
    Ok(rule)
}

/// Text that the `*` of the pattern matches in a name, empty without a `*`; `None` if the name does not match.
fn matched<'a>(pattern: &str, name: &'a str) -> Option<&'a str> {
    match pattern.split_once('*') {
        Some((before, after)) => name.strip_prefix(before)?.strip_suffix(after),
        None => (pattern == name).then_some(""),
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test")]
mod tests {
    use super::{Fate, Table};

    fn new_name(table: &str, old: &str) -> String {
        match Table::parse(table).unwrap().fate(old) {
            Fate::Called(new) => new,
            Fate::Gone => "(gone)".to_owned(),
        }
    }

    #[test]
    fn first_matching_rule_applies() {
        let table = "# names\n tick/a -> tick/b # as it was\n*.share -> *.gain\ntick/x.* -> (gone) spare";
        assert_eq!(new_name(table, "tick/a"), "tick/b");
        assert_eq!(new_name(table, "tick/aa"), "tick/aa");
        assert_eq!(new_name(table, "servo/a"), "servo/a");
        assert_eq!(new_name(table, "tick/hand.share"), "tick/hand.gain");
        assert_eq!(new_name(table, "tick/x.share"), "tick/x.gain");
        assert_eq!(new_name(table, "tick/x.shares"), "(gone)");
        assert_eq!(new_name("tick/* -> loop/*", "tick/q*"), "loop/q*");
        assert_eq!(new_name("", "tick/q"), "tick/q");
    }

    #[test]
    fn wildcard_parts_do_not_overlap() {
        assert_eq!(new_name("aba*aba -> b*", "aba"), "aba");
        assert_eq!(new_name("aba*aba -> b*", "abaaba"), "b");
    }

    #[test]
    fn new_signals_are_not_renamed() {
        let table = Table::parse("(new) *.gain measured since").unwrap();
        assert!(table.is_new("tick/hand.gain") && !table.is_new("tick/hand.gains"));
        assert_eq!(table.fate("tick/hand.gain"), Fate::Called("tick/hand.gain".to_owned()));
    }

    #[test]
    fn text_rules_do_not_change_names() {
        let table = Table::parse("(text) is not -> is no").unwrap();
        assert_eq!(table.reworded("q is not 7"), "q is no 7");
        assert_eq!(table.fate("is not"), Fate::Called("is not".to_owned()));
    }

    #[test]
    fn unused_rules_are_reported() {
        let table = Table::parse("a -> b\nc -> (gone) spare\n(new) d why\n(new) e why").unwrap();
        let names = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        assert_eq!(table.idle(&names(&["a", "d"]), &names(&["e"])), ["c -> (gone) spare", "(new) d why"]);
    }

    #[test]
    fn malformed_rules_are_refused() {
        for line in
            ["a", "a -> *", "* -> b", "*a* -> *b*", "a -> (gone)", "(new) a", "a -> b why", "(new) *a* why"]
        {
            assert!(Table::parse(line).is_err(), "{line}");
        }
    }
}

//! Table of accepted differences between two builds.
//!
//! Each line contains one rule and its reason; the first matching rule applies.
//!
//! ```text
//! signal *.weakest_share -> *.min_singular_gain # another name
//! signal (new) -> servo/temperature # measured since
//! key metrics.spare_m -> (gone) # nothing read it
//! key groups[].metrics.force_settle_s.* -> (differs) # counted from the first contact
//! text is not finite -> is no number # other words
//! ```
//!
//! `signal` rules are about channel and signal, and `key` rules about keys, with `[]` for every place in a list. One `*`
//! matches any text; in the new name it stands for the same text. `text` rules replace a part of each line and of each text
//! in a key. With `(gone)` or `(new)`, they remove the lines that contain the other part.

use crate::entries::Kind;
use std::collections::BTreeSet;

/// Table of accepted differences.
#[derive(Clone, Debug, Default)]
pub struct Table {
    rules: Vec<Rule>,
}

#[derive(Clone, Debug)]
struct Rule {
    text: String,
    /// Kind of entries; [`Kind::Line`] for texts.
    kind: Kind,
    change: Change,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Change {
    Renamed { old: String, new: String },
    Gone { old: String },
    New { new: String },
    Differs { old: String },
}

/// Fate of an entry in the new build.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fate {
    /// The entry exists under this name, with the same value.
    Called(String),
    /// The entry exists, with another value.
    Differs,
    /// The entry no longer exists.
    Gone,
}

impl Table {
    /// Parses a table.
    ///
    /// # Errors
    /// A line that is not a valid rule.
    pub fn parse(text: &str) -> Result<Self, String> {
        let lines = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
        Ok(Self { rules: lines.map(Rule::parse).collect::<Result<_, _>>()? })
    }

    /// Returns the fate of a signal or key of the old build.
    #[must_use]
    pub fn fate(&self, kind: Kind, old_name: &str) -> Fate {
        let (name, places) = without_places(old_name);
        for rule in self.rules.iter().filter(|rule| rule.kind == kind) {
            match &rule.change {
                Change::Renamed { old, new } => {
                    if let Some(text) = matched(old, &name) {
                        return Fate::Called(with_places(&new.replacen('*', text, 1), &places));
                    }
                }
                Change::Gone { old } if matched(old, &name).is_some() => return Fate::Gone,
                Change::Differs { old } if matched(old, &name).is_some() => return Fate::Differs,
                _ => {}
            }
        }
        Fate::Called(old_name.to_owned())
    }

    /// True if the table lists a signal or key of the new build as new.
    #[must_use]
    pub fn is_new(&self, kind: Kind, name: &str) -> bool {
        let (name, _) = without_places(name);
        let mut rules = self.rules.iter().filter(|rule| rule.kind == kind);
        rules.any(|rule| matches!(&rule.change, Change::New { new } if matched(new, &name).is_some()))
    }

    /// Replaces the words of the old build in a text by those of the new build.
    #[must_use]
    pub fn reworded(&self, text: &str) -> String {
        self.of_texts().fold(text.to_owned(), |text, change| match change {
            Change::Renamed { old, new } => text.replace(old, new),
            _ => text,
        })
    }

    /// True if a line of the old build is no longer expected.
    #[must_use]
    pub fn is_gone_line(&self, line: &str) -> bool {
        self.of_texts().any(|change| matches!(change, Change::Gone { old } if line.contains(old)))
    }

    /// True if a line of the new build is expected to be new.
    #[must_use]
    pub fn is_new_line(&self, line: &str) -> bool {
        self.of_texts().any(|change| matches!(change, Change::New { new } if line.contains(new)))
    }

    fn of_texts(&self) -> impl Iterator<Item = &Change> {
        self.rules.iter().filter(|rule| rule.kind == Kind::Line).map(|rule| &rule.change)
    }

    /// Returns the rules that match nothing of the old or new build: names of entries by kind, and texts as lines.
    #[must_use]
    pub fn idle(&self, old: &BTreeSet<(Kind, String)>, new: &BTreeSet<(Kind, String)>) -> Vec<&str> {
        let is_in = |list: &BTreeSet<(Kind, String)>, kind: Kind, own: &str| {
            list.iter().filter(|(of, _)| *of == kind).any(|(_, text)| match kind {
                Kind::Line => text.contains(own),
                _ => matched(own, &without_places(text).0).is_some(),
            })
        };
        let is_used = |rule: &&Rule| match &rule.change {
            Change::New { new: own } => is_in(new, rule.kind, own),
            Change::Renamed { old: own, .. } | Change::Gone { old: own } | Change::Differs { old: own } => {
                is_in(old, rule.kind, own)
            }
        };
        self.rules.iter().filter(|rule| !is_used(rule)).map(|rule| rule.text.as_str()).collect()
    }
}

impl Rule {
    fn parse(line: &str) -> Result<Self, String> {
        let wrong = |what: &str| Err(format!("'{line}' {what}"));
        let Some((rule, reason)) = line.rsplit_once(" # ") else { return wrong("lacks ' # ' and a reason") };
        if reason.trim().is_empty() {
            return wrong("lacks a reason");
        }
        let (word, rule) = rule.split_once(' ').unwrap_or_default();
        let kind = match word {
            "signal" => Kind::Signal,
            "key" => Kind::Key,
            "text" => Kind::Line,
            _ => return wrong("begins with none of: signal, key, text"),
        };
        let Some((old, new)) = rule.split_once(" -> ") else { return wrong("has no ' -> '") };
        let (old, new) = (old.trim().to_owned(), new.trim().to_owned());
        let change = match (old.as_str(), new.as_str()) {
            ("" | "(new)", "" | "(gone)" | "(differs)") | (_, "") | ("", _) => return wrong("lacks a name"),
            ("(new)", _) => Change::New { new },
            (_, "(gone)") => Change::Gone { old },
            (_, "(differs)") if kind == Kind::Line => return wrong("lacks the words of the new build"),
            (_, "(differs)") => Change::Differs { old },
            _ => Change::Renamed { old, new },
        };
        let rule = Self { text: line.to_owned(), kind, change };
        if kind != Kind::Line {
            rule.check_names()?;
        }
        Ok(rule)
    }

    fn check_names(&self) -> Result<(), String> {
        let names = match &self.change {
            Change::Renamed { old, new } => vec![old, new],
            Change::Gone { old: name } | Change::Differs { old: name } | Change::New { new: name } => {
                vec![name]
            }
        };
        let stars: Vec<usize> = names.iter().map(|name| name.matches('*').count()).collect();
        let text = &self.text;
        if stars.iter().any(|count| *count > 1 || *count != stars[0]) {
            return Err(format!("'{text}': one '*' at most, and on both sides or none"));
        }
        let places: Vec<usize> = names.iter().map(|name| name.matches("[]").count()).collect();
        if places.iter().any(|count| *count != places[0]) {
            return Err(format!("'{text}': as many '[]' on both sides"));
        }
        if names.iter().any(|name| name.contains(char::is_whitespace)) {
            return Err(format!("'{text}': a name has no blanks"));
        }
        Ok(())
    }
}

/// Text that the `*` of the pattern matches in a name, empty without a `*`; `None` if the name does not match.
fn matched<'a>(pattern: &str, name: &'a str) -> Option<&'a str> {
    match pattern.split_once('*') {
        Some((before, after)) => name.strip_prefix(before)?.strip_suffix(after),
        None => (pattern == name).then_some(""),
    }
}

/// Name with `[]` for each place in a list, and these places.
#[must_use]
pub fn without_places(name: &str) -> (String, Vec<&str>) {
    let (mut general, mut places) = (String::new(), Vec::new());
    let mut rest = name;
    while let Some((before, after)) = rest.split_once('[') {
        general += before;
        match after.split_once(']').filter(|(place, _)| place.parse::<usize>().is_ok()) {
            Some((place, after)) => {
                general += "[]";
                places.push(place);
                rest = after;
            }
            None => {
                general += "[";
                rest = after;
            }
        }
    }
    (general + rest, places)
}

fn with_places(general: &str, places: &[&str]) -> String {
    places.iter().fold(general.to_owned(), |name, place| name.replacen("[]", &format!("[{place}]"), 1))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test")]
mod tests {
    use super::{Fate, Table, without_places};
    use crate::entries::Kind;

    fn new_name(table: &str, kind: Kind, old: &str) -> String {
        match Table::parse(table).unwrap().fate(kind, old) {
            Fate::Called(new) => new,
            Fate::Gone => "(gone)".to_owned(),
            Fate::Differs => "(differs)".to_owned(),
        }
    }

    #[test]
    fn first_matching_rule_applies() {
        let table = "# names\n signal tick/a -> tick/b # as it was\nsignal *.share -> *.gain # b\n\
                     signal tick/x.* -> (gone) # spare\nkey tick/q -> tick/p # a key\nsignal tick/t -> (differs) # c";
        let new_name = |old| new_name(table, Kind::Signal, old);
        assert_eq!(new_name("tick/a"), "tick/b");
        assert_eq!(new_name("tick/aa"), "tick/aa");
        assert_eq!(new_name("servo/a"), "servo/a");
        assert_eq!(new_name("tick/hand.share"), "tick/hand.gain");
        assert_eq!(new_name("tick/x.share"), "tick/x.gain");
        assert_eq!(new_name("tick/x.shares"), "(gone)");
        assert_eq!(new_name("tick/q"), "tick/q");
        assert_eq!(new_name("tick/t"), "(differs)");
    }

    #[test]
    fn wildcard_parts_do_not_overlap() {
        assert_eq!(new_name("key aba*aba -> b* # c", Kind::Key, "aba"), "aba");
        assert_eq!(new_name("key aba*aba -> b* # c", Kind::Key, "abaaba"), "b");
        assert_eq!(new_name("key a* -> b* # c", Kind::Key, "a.q*"), "b.q*");
    }

    /// Compared: names with places in lists, and the same places in the new names.
    #[test]
    fn places_in_lists_are_kept() {
        let table = "key rows[].at[].* -> runs[].of[].* # c";
        assert_eq!(new_name(table, Kind::Key, "rows[7].at[12].x[3]"), "runs[7].of[12].x[3]");
        assert_eq!(new_name(table, Kind::Key, "rows[7].at[12].x"), "runs[7].of[12].x");
        assert_eq!(new_name("key a[] -> (gone) # c", Kind::Key, "a[5]"), "(gone)");
        assert_eq!(without_places("a[5].b[6]"), ("a[].b[]".to_owned(), vec!["5", "6"]));
        for text in ["a[b", "a [b]", "a[]", "[[", "a: b [singular-start] []"] {
            assert_eq!(without_places(text), (text.to_owned(), vec![]), "the code of a problem is no place");
        }
    }

    #[test]
    fn new_signals_are_not_renamed() {
        let table = Table::parse("signal (new) -> *.gain # measured since").unwrap();
        assert!(
            table.is_new(Kind::Signal, "tick/hand.gain") && !table.is_new(Kind::Signal, "tick/hand.gains")
        );
        assert!(!table.is_new(Kind::Key, "tick/hand.gain"));
        assert_eq!(table.fate(Kind::Signal, "tick/hand.gain"), Fate::Called("tick/hand.gain".to_owned()));
    }

    #[test]
    fn text_rules_do_not_change_names() {
        let table = "text is not -> is no # b\ntext (new) -> [hint] # c\ntext note: -> (gone) # d";
        let table = Table::parse(table).unwrap();
        assert_eq!(table.reworded("q is not 7"), "q is no 7");
        assert_eq!(table.fate(Kind::Key, "is not"), Fate::Called("is not".to_owned()));
        assert!(table.is_new_line("a [hint]") && !table.is_new_line("note: a"));
        assert!(table.is_gone_line("note: a") && !table.is_gone_line("a [hint]"));
    }

    #[test]
    fn unused_rules_are_reported() {
        let table = "key a[] -> b[] # d\nkey c -> (gone) # spare\nsignal (new) -> d # why\nsignal (new) -> e # why\n\
                     text x -> y # z\ntext w -> y # z";
        let table = Table::parse(table).unwrap();
        let names =
            |names: &[(Kind, &str)]| names.iter().map(|(kind, name)| (*kind, (*name).to_owned())).collect();
        let old = names(&[(Kind::Key, "a[3]"), (Kind::Signal, "c"), (Kind::Line, "xx")]);
        let idle = ["key c -> (gone) # spare", "signal (new) -> d # why", "text w -> y # z"];
        assert_eq!(table.idle(&old, &names(&[(Kind::Signal, "e")])), idle);
    }

    #[test]
    fn malformed_rules_are_refused() {
        for rule in [
            "a -> b",
            "key a",
            "key a -> * # c",
            "key * -> b # c",
            "key *a* -> *b* # c",
            "key a -> (gone)",
            "key a -> b # ",
            "key a -> b",
            "key (new) -> a b # c",
            "key (new) -> (gone) # c",
            "text a -> (differs) # c",
            "key a[] -> b # c",
            "line a -> b # c",
            "key (new) -> *a* # c",
            "text  -> b # c",
        ] {
            assert!(Table::parse(rule).is_err(), "{rule}");
        }
    }
}

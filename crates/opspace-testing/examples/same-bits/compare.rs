//! Comparison of the results of two builds.

use crate::accepted::{Fate, Table, without_places};
use crate::entries::{Kind, NOT_COMPARED, read};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::{self, Display};

/// Maximum number of places that are listed for a difference.
const NAMED: usize = 4;

/// Part and place of an item, for example a suite and the place of a run in it.
type Place = (String, String);

/// Results of a build, by place.
#[derive(Clone, Debug, Default)]
pub struct Results(BTreeMap<Place, Values>);

/// Values of an item.
#[derive(Clone, Debug, Default)]
struct Values {
    /// Values of signals and keys by name.
    named: BTreeMap<(Kind, String), String>,
    /// Lines of the program's outputs.
    outputs: BTreeMap<String, Vec<String>>,
}

/// Result of a comparison.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Places with a difference and its description, by kind of difference and name.
    findings: BTreeMap<(&'static str, String), Vec<String>>,
    /// Rules of the table that match nothing.
    idle: Vec<String>,
    compared: BTreeMap<Kind, usize>,
    items: usize,
    explained: usize,
}

impl Results {
    /// Adds the lines of a part.
    ///
    /// # Errors
    /// A text that is none of results, or contains a value twice.
    pub fn add(&mut self, part: &str, text: &str) -> Result<(), String> {
        for line in text.lines() {
            let (place, entry) = read(line)?;
            let values = self.0.entry((part.to_owned(), place.to_owned())).or_default();
            if entry.kind == Kind::Line {
                values.outputs.entry(entry.name).or_default().push(entry.value);
            } else if values.named.insert((entry.kind, entry.name), entry.value).is_some() {
                return Err(format!("'{line}' is there twice"));
            }
        }
        Ok(())
    }

    /// Names of all entries, and all texts as lines.
    fn names(&self) -> BTreeSet<(Kind, String)> {
        let named = self.0.values().flat_map(|values| values.named.keys().cloned());
        let of_keys = self.0.values().flat_map(|values| values.named.values());
        let of_outputs = self.0.values().flat_map(|values| values.outputs.values().flatten());
        let texts = of_keys.filter(|value| value.starts_with('"')).chain(of_outputs);
        named.chain(texts.map(|text| (Kind::Line, text.clone()))).collect()
    }
}

/// Compares the results of an old build with those of a new build.
#[must_use]
pub fn compare(old: &Results, new: &Results, table: &Table) -> Report {
    let idle = table.idle(&old.names(), &new.names()).into_iter().map(str::to_owned).collect();
    let mut report = Report { idle, ..Report::default() };
    for place in old.0.keys().chain(new.0.keys()).collect::<BTreeSet<_>>() {
        match (old.0.get(place), new.0.get(place)) {
            (Some(old), Some(new)) => report.item(place, old, new, table),
            (Some(_), None) => report.find("missing", "the whole item", place, ""),
            _ => report.find("new", "the whole item", place, ""),
        }
    }
    report
}

impl Report {
    /// True if all values are equal or explained, and at least one was compared.
    #[must_use]
    pub fn is_clean(&self) -> bool {
        self.findings.is_empty() && !self.compared.is_empty()
    }

    fn item(&mut self, place: &Place, old: &Values, new: &Values, table: &Table) {
        self.items += 1;
        let mut rest: BTreeSet<&(Kind, String)> = new.named.keys().collect();
        for ((kind, name), value) in &old.named {
            let same = (*kind, name.clone());
            match table.fate(*kind, name) {
                Fate::Gone if rest.remove(&same) => self.find("not gone", name, place, ""),
                Fate::Differs if !rest.remove(&same) => self.find("missing", name, place, ""),
                Fate::Gone | Fate::Differs => self.explained += 1,
                Fate::Called(called) => {
                    let called = (*kind, called);
                    if rest.remove(&called) {
                        self.value(*kind, name, place, [value, &new.named[&called]], table);
                    } else {
                        self.find("missing", &called.1, place, value);
                    }
                }
            }
        }
        for (kind, name) in rest {
            if table.is_new(*kind, name) {
                self.explained += 1;
            } else {
                self.find("new", name, place, &new.named[&(*kind, name.clone())]);
            }
        }
        let streams: BTreeSet<&String> = old.outputs.keys().chain(new.outputs.keys()).collect();
        for stream in streams {
            let lines = |values: &Values| values.outputs.get(stream).cloned().unwrap_or_default();
            self.lines(stream, place, &lines(old), &lines(new), table);
        }
    }

    fn value(&mut self, kind: Kind, name: &str, place: &Place, [old, new]: [&String; 2], table: &Table) {
        if name == NOT_COMPARED {
            return self.find("not compared", "the item", place, new);
        }
        *self.compared.entry(kind).or_default() += 1;
        let is_text = kind == Kind::Key && old.starts_with('"');
        let old = if is_text { table.reworded(old) } else { old.clone() };
        if old != *new {
            self.find("differs", name, place, &format!("{old} -> {new}"));
        }
    }

    /// Compares the lines of an output: none may be missing or new, and their order must be the same.
    fn lines(&mut self, stream: &str, place: &Place, old: &[String], new: &[String], table: &Table) {
        let (gone, old): (Vec<_>, Vec<_>) = old.iter().partition(|line| table.is_gone_line(line));
        let (added, new): (Vec<_>, Vec<_>) = new.iter().partition(|line| table.is_new_line(line));
        let old: Vec<String> = old.iter().map(|line| table.reworded(line)).collect();
        self.explained += gone.len() + added.len();
        *self.compared.entry(Kind::Line).or_default() += old.len();
        let (mut missing, mut more) = (old.clone(), Vec::new());
        for line in &new {
            match missing.iter().position(|old| old == *line) {
                Some(place) => drop(missing.remove(place)),
                None => more.push(*line),
            }
        }
        if missing.is_empty() && more.is_empty() && !old.iter().eq(new) {
            self.find("in another order", &format!("lines of {stream}"), place, "");
        }
        for line in &missing {
            self.find("missing", &format!("{stream}: {line}"), place, "");
        }
        for line in more {
            self.find("new", &format!("{stream}: {line}"), place, "");
        }
    }

    fn find(&mut self, kind: &'static str, name: &str, (part, place): &Place, how: &str) {
        let (general, places) = without_places(name);
        let at = if places.is_empty() { String::new() } else { format!(" [{}]", places.join(", ")) };
        let how = if how.is_empty() { String::new() } else { format!(" ({how})") };
        self.findings.entry((kind, general)).or_default().push(format!("{part} {place}{at}{how}"));
    }
}

impl Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for ((kind, name), places) in &self.findings {
            let named = places.iter().take(NAMED).cloned().collect::<Vec<_>>().join(", ");
            let more = if places.len() > NAMED { ", ..." } else { "" };
            writeln!(f, "{kind}\t{name}\t{} times: {named}{more}", places.len())?;
        }
        for rule in &self.idle {
            writeln!(f, "note: nothing fits '{rule}'")?;
        }
        let compared = |kind: Kind| self.compared.get(&kind).copied().unwrap_or_default();
        let total: usize = self.findings.values().map(Vec::len).sum();
        write!(f, "{} runs and files, ", self.items)?;
        for kind in [Kind::Signal, Kind::Key, Kind::Line] {
            write!(f, "{} {}s, ", compared(kind), kind.name())?;
        }
        write!(f, "compared: {total} differences, {} explained", self.explained)
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test")]
mod tests {
    use super::{Report, Results, compare};
    use crate::accepted::Table;

    const OLD: &str = "1.1.1.1 a\tkey\tfaulted\t\"it is not finite\"\n\
                       1.1.1.1 a\tkey\tat[0].x\t0.1\n\
                       1.1.1.1 a\tsignal\ttick/q\t9x2 aa\n\
                       1.1.1.1 a\tsignal\ttick/hand.share\t9x1 bb\n\
                       1.1.1.1 a\tline\tstdout\tone\n\
                       1.1.1.1 a\tline\tstdout\ttwo\n\
                       1.1.1.1 a\tline\tstdout\tone\n";

    fn results(text: &str) -> Results {
        let mut results = Results::default();
        results.add("s", text).unwrap();
        results
    }

    fn compared(new: &str, table: &str) -> Report {
        compare(&results(OLD), &results(new), &Table::parse(table).unwrap())
    }

    /// Returns the kinds and names of the findings.
    fn found(new: &str, table: &str) -> Vec<String> {
        compared(new, table).findings.keys().map(|(kind, name)| format!("{kind} {name}")).collect()
    }

    #[test]
    fn equal_results_give_a_clean_report() {
        let report = compared(&OLD.replace("1.1.1.1 a", "1.1.1.1 spelt anew"), "");
        assert!(report.is_clean());
        let last = "1 runs and files, 2 signals, 2 keys, 3 lines, compared: 0 differences, 0 explained";
        assert_eq!(report.to_string(), last);
    }

    #[test]
    fn each_field_is_compared() {
        assert_eq!(found(&OLD.replace("aa", "ab"), ""), ["differs tick/q"]);
        assert_eq!(found(&OLD.replace("9x2", "8x2"), ""), ["differs tick/q"]);
        assert_eq!(found(&OLD.replace("0.1", "0.2"), ""), ["differs at[].x"]);
        assert_eq!(found(&OLD.replace("[0]", "[1]"), ""), ["missing at[].x", "new at[].x"]);
        assert_eq!(found(&OLD.replace("1.1.1.1", "1.1.1.2"), "").len(), 2);
        assert_eq!(found(&OLD.replace("key\tat", "signal\tat"), ""), ["missing at[].x", "new at[].x"]);
        let report = compared(&OLD.replace("0.1", "0.2"), "").to_string();
        assert!(report.contains("s 1.1.1.1 [0] (0.1 -> 0.2)"), "{report}");
    }

    #[test]
    fn texts_are_compared_word_by_word() {
        let new = OLD.replace("is not finite", "is no number");
        assert_eq!(found(&new, ""), ["differs faulted"]);
        assert!(compared(&new, "text is not finite -> is no number # clearer").is_clean());
        assert!(compared(&new, "key faulted -> (differs) # clearer").is_clean());
        assert_eq!(found(&OLD.replace("0.1", "0.2"), "text 0.1 -> 0.2 # a number"), ["differs at[].x"]);
    }

    #[test]
    fn lines_are_compared_one_by_one() {
        let (one, two) = ("1.1.1.1 a\tline\tstdout\tone\n", "1.1.1.1 a\tline\tstdout\ttwo\n");
        assert_eq!(found(&OLD.replace("two", "three"), ""), ["missing stdout: two", "new stdout: three"]);
        assert!(found(&OLD.replace("two", "three"), "text two -> three # another number").is_empty());
        assert_eq!(found(&(OLD.to_owned() + two), ""), ["new stdout: two"]);
        assert_eq!(found(&OLD.replacen(one, "", 1), ""), ["missing stdout: one"]);
        assert_eq!(found(&OLD.replace(two, ""), ""), ["missing stdout: two"]);
        assert!(found(&OLD.replace(two, ""), "text tw -> (gone) # not needed").is_empty());
        assert!(
            found(&(OLD.to_owned() + "1.1.1.1 a\tline\tstderr\tmore\n"), "text (new) -> more # b").is_empty()
        );
        let swapped = OLD.replace(two, "").replacen(one, &(two.to_owned() + one), 1);
        assert_eq!(found(&swapped, ""), ["in another order lines of stdout"]);
    }

    #[test]
    fn renamed_entry_must_be_in_the_table() {
        let new = OLD.replace("hand.share", "hand.gain");
        let table = "signal *.share -> *.gain # another name";
        assert_eq!(found(&new, ""), ["missing tick/hand.share", "new tick/hand.gain"]);
        assert!(compared(&new, table).is_clean());
        assert_eq!(found(&new.replace("bb", "bc"), table), ["differs tick/hand.share"]);
        assert_eq!(found(OLD, table), ["missing tick/hand.gain", "new tick/hand.share"]);
        assert!(compared(&OLD.replace("at[0].x", "of[0].x"), "key at[].* -> of[].* # b").is_clean());
    }

    #[test]
    fn removed_and_new_entries_must_be_in_the_table() {
        let new = OLD.replace("hand.share\t9x1 bb", "speed\t9x1 dd");
        let table = "signal *.share -> (gone) # nobody read it\nsignal (new) -> tick/speed # wanted since";
        let report = compared(&new, table);
        assert!(report.is_clean() && report.explained == 2);
        assert_eq!(found(OLD, table), ["not gone tick/hand.share"]);
        assert_eq!(
            found(&new, "signal *.share -> (differs) # b"),
            ["missing tick/hand.share", "new tick/speed"]
        );
    }

    #[test]
    fn run_without_log_is_not_compared() {
        let less = OLD.to_owned() + "2.1.1.1 b\tkey\t(not compared)\tno log\n";
        let report = compare(&results(&less), &results(&less), &Table::default());
        assert_eq!(report.findings.len(), 1);
        assert!(!compare(&results(""), &results(""), &Table::default()).is_clean());
    }
}

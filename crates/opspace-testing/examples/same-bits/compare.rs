//! Comparison of two lists of hashes.

use crate::hashes::{FACT, Hash};
use crate::signals::{Fate, Table};
use crate::suites::Run;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::{self, Display};

/// Maximum number of runs that are listed for a signal that differs.
const NAMED: usize = 6;

/// Suite of a run, and the place of the run in the suite.
type Key = (String, String);
type Signals = BTreeMap<String, Hash>;

/// Result of a comparison.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Runs with a difference and its description, by kind of difference and signal.
    findings: BTreeMap<(&'static str, String), Vec<String>>,
    /// Lines of the table that match no signal.
    idle: Vec<String>,
    runs: usize,
    compared: usize,
    explained: usize,
}

/// Formats the lines of a run in a list of hashes.
#[must_use]
pub fn lines(run: &Run, hashes: &[Hash]) -> String {
    let head = format!("{}\t{} {}", run.suite, run.place, run.spelling);
    let line =
        |h: &Hash| format!("{head}\t{}\t{}\t{}\t{}\t{}\n", h.channel, h.signal, h.elements, h.rows, h.hash);
    hashes.iter().map(line).collect()
}

/// Compares the list of an old build with the list of a new build.
///
/// # Errors
/// A text that is not a list of hashes.
pub fn compare(old: &str, new: &str, table: &Table) -> Result<Report, String> {
    let (old, new) = (read(old)?, read(new)?);
    let names = |list: &BTreeMap<Key, Signals>| list.values().flat_map(|run| run.keys().cloned()).collect();
    let (old_names, new_names): (BTreeSet<String>, BTreeSet<String>) = (names(&old), names(&new));
    let idle = table.idle(&old_names, &new_names).into_iter().map(str::to_owned).collect();
    let mut report = Report { idle, ..Report::default() };
    for key in old.keys().chain(new.keys()).collect::<BTreeSet<_>>() {
        match (old.get(key), new.get(key)) {
            (Some(old), Some(new)) => report.run(key, old, new, table),
            (Some(_), None) => report.find("missing", "the whole run", key, ""),
            _ => report.find("new", "the whole run", key, ""),
        }
    }
    Ok(report)
}

fn read(list: &str) -> Result<BTreeMap<Key, Signals>, String> {
    let mut runs: BTreeMap<Key, Signals> = BTreeMap::new();
    for line in list.lines() {
        let wrong = || format!("'{line}' is no line of a list of hashes");
        let fields: Vec<&str> = line.split('\t').collect();
        let [suite, run, channel, signal, elements, rows, hash] = fields[..] else { return Err(wrong()) };
        let place = run.split(' ').next().unwrap_or_default();
        let read = Hash {
            channel: channel.to_owned(),
            signal: signal.to_owned(),
            elements: elements.parse().map_err(|_| wrong())?,
            rows: rows.parse().map_err(|_| wrong())?,
            hash: hash.to_owned(),
        };
        let signals = runs.entry((suite.to_owned(), place.to_owned())).or_default();
        if signals.insert(format!("{channel}/{signal}"), read).is_some() {
            return Err(format!("'{line}' is there twice"));
        }
    }
    Ok(runs)
}

impl Report {
    /// True if all signals are equal or explained, and at least one was compared.
    #[must_use]
    pub fn is_clean(&self) -> bool {
        self.findings.is_empty() && self.compared > 0
    }

    fn run(&mut self, key: &Key, old: &Signals, new: &Signals, table: &Table) {
        self.runs += 1;
        let mut rest: BTreeSet<&String> = new.keys().collect();
        for (name, hash) in old {
            match table.fate(name) {
                Fate::Gone if rest.remove(name) => self.find("not gone", name, key, ""),
                Fate::Gone => self.explained += 1,
                Fate::Called(called) if rest.remove(&called) => {
                    self.signal(name, key, hash, &new[&called], table);
                }
                Fate::Called(called) => self.find("missing", &called, key, ""),
            }
        }
        for name in rest {
            if table.is_new(name) {
                self.explained += 1;
            } else {
                self.find("new", name, key, "");
            }
        }
        if old.values().chain(new.values()).all(|hash| hash.channel == FACT) {
            self.find("not compared", "the whole run, which left no log", key, "");
        }
    }

    fn signal(&mut self, name: &str, key: &Key, old: &Hash, new: &Hash, table: &Table) {
        let is_fact = old.channel == FACT;
        self.compared += usize::from(!is_fact);
        let hash = if is_fact { table.reworded(&old.hash) } else { old.hash.clone() };
        if (old.elements, old.rows) != (new.elements, new.rows) {
            let shapes = format!("{}x{} -> {}x{}", old.rows, old.elements, new.rows, new.elements);
            self.find("differs", name, key, &shapes);
        } else if hash != new.hash {
            let how = if is_fact { format!("{hash} -> {}", new.hash) } else { String::new() };
            self.find("differs", name, key, &how);
        }
    }

    fn find(&mut self, kind: &'static str, signal: &str, (suite, place): &Key, how: &str) {
        let how = if how.is_empty() { String::new() } else { format!(" ({how})") };
        self.findings.entry((kind, signal.to_owned())).or_default().push(format!("{suite} {place}{how}"));
    }

    fn count(&self, kind: &str) -> usize {
        self.findings.iter().filter(|((k, _), _)| *k == kind).map(|(_, runs)| runs.len()).sum()
    }
}

impl Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for ((kind, signal), runs) in &self.findings {
            let named = runs.iter().take(NAMED).cloned().collect::<Vec<_>>().join(", ");
            let more = if runs.len() > NAMED { ", ..." } else { "" };
            writeln!(f, "{kind}\t{signal}\tin {} runs: {named}{more}", runs.len())?;
        }
        for line in &self.idle {
            writeln!(f, "note: no signal fits '{line}'")?;
        }
        let total: usize = self.findings.values().map(Vec::len).sum();
        let differing = self.count("differs");
        write!(f, "{} runs, {} signals compared: ", self.runs, self.compared)?;
        write!(f, "{differing} differing, {} missing, new or not compared, ", total - differing)?;
        write!(f, "{} explained", self.explained)
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test")]
mod tests {
    use super::{Report, compare};
    use crate::signals::Table;

    const OLD: &str = "s\t1.1.1.1 a\t-\texit\t0\t0\t0\n\
                       s\t1.1.1.1 a\ttick\tq\t2\t9\taa\n\
                       s\t1.1.1.1 a\ttick\thand.share\t1\t9\tbb\n";

    fn compared(new: &str, table: &str) -> Report {
        compare(OLD, new, &Table::parse(table).unwrap()).unwrap()
    }

    /// Returns the kinds and signals of the findings.
    fn found(new: &str, table: &str) -> Vec<String> {
        compared(new, table).findings.keys().map(|(kind, signal)| format!("{kind} {signal}")).collect()
    }

    #[test]
    fn equal_lists_give_a_clean_report() {
        let report = compared(&OLD.replace("1.1.1.1 a", "1.1.1.1 spelt anew"), "");
        assert!(report.is_clean());
        let last = "1 runs, 2 signals compared: 0 differing, 0 missing, new or not compared, 0 explained";
        assert_eq!(report.to_string(), last);
    }

    #[test]
    fn each_field_is_compared() {
        assert_eq!(found(&OLD.replace("aa", "ab"), ""), ["differs tick/q"]);
        assert_eq!(found(&OLD.replace("2\t9", "2\t8"), ""), ["differs tick/q"]);
        assert_eq!(found(&OLD.replace("2\t9", "3\t9"), ""), ["differs tick/q"]);
        assert_eq!(found(&OLD.replace("0\t0\t0", "0\t0\t1"), ""), ["differs -/exit"]);
        assert!(found(&OLD.replace("0\t0\t0", "0\t0\t1"), "(text) 0 -> 1").is_empty());
        assert_eq!(found(&OLD.replace("1.1.1.1", "1.1.1.2"), "").len(), 2);
    }

    #[test]
    fn renamed_signal_must_be_in_the_table() {
        let new = OLD.replace("hand.share", "hand.gain");
        assert_eq!(found(&new, ""), ["missing tick/hand.share", "new tick/hand.gain"]);
        assert!(compared(&new, "*.share -> *.gain").is_clean());
        assert_eq!(found(&new.replace("bb", "bc"), "*.share -> *.gain"), ["differs tick/hand.share"]);
        assert_eq!(found(OLD, "*.share -> *.gain"), ["missing tick/hand.gain", "new tick/hand.share"]);
    }

    #[test]
    fn removed_and_new_signals_must_be_in_the_table() {
        let new = OLD.replace("hand.share\t1\t9\tbb", "speed\t1\t9\tdd");
        let table = "*.share -> (gone) nobody read it\n(new) tick/speed wanted since";
        let report = compared(&new, table);
        assert!(report.is_clean() && report.explained == 2);
        assert_eq!(found(OLD, table), ["not gone tick/hand.share"]);
    }

    #[test]
    fn run_without_log_is_not_compared() {
        let less = "s\t2.1.1.1 b\t-\texit\t0\t0\t2\n";
        let report = compare(&(OLD.to_owned() + less), &(OLD.to_owned() + less), &Table::default()).unwrap();
        assert_eq!(report.findings.len(), 1);
        assert!(!compare("", "", &Table::default()).unwrap().is_clean());
    }
}

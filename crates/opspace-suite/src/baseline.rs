//! Comparison of a suite's results with earlier ones, run by run.
//!
//! Runs are paired that have the same task, robot, backend, plant, controller, transformer, profile, settings and seed. For each
//! metric of the pairs that differ only in the seed, the mean difference d (new minus old) and its 95 % confidence
//! interval d ± t s/√n are computed, with the standard deviation s of the n differences and Student's t for n − 1 degrees
//! of freedom. A metric is better or worse if the interval does not contain zero and |d| exceeds [`TOLERANCE`] times
//! the mean magnitude of the old values. A single pair has no interval, and only the tolerance counts. The intervals
//! are not corrected for the number of metrics.

use opspace_experiment::evaluate::summary::Summary;
use opspace_experiment::evaluate::table::{Cell, Table};
use opspace_experiment::extensions::Entry;
use opspace_experiment::metrics::metric::{Better, Metric};
use opspace_experiment::run::experiment::Experiment;
use opspace_experiment::run::physics::OWN_PLANT;
use serde::Serialize;
use serde_json::Value;
use std::collections::{HashMap, HashSet};
use std::fmt;

/// Fraction of the old value below which a difference does not count.
pub const TOLERANCE: f64 = 0.01;

/// Identity of a run among those of a suite.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize)]
#[non_exhaustive]
pub struct RunKey {
    /// Name of the task.
    pub task: String,
    /// Name of the robot.
    pub robot: String,
    /// Kind of robot.
    pub backend: String,
    /// Plant of the simulation.
    pub plant: String,
    /// Controller.
    pub controller: String,
    /// Transformer; `None` if none is used.
    pub transformer: Option<String>,
    /// Profile of the robot.
    pub profile: String,
    /// Settings that were applied to the files.
    pub overrides: Vec<String>,
    /// Seed of all random numbers; `None` for all runs that differ only in the seed.
    pub seed: Option<u64>,
}

impl RunKey {
    /// Returns the key of a run before it is executed.
    #[must_use]
    pub fn of_experiment(experiment: &Experiment) -> Self {
        Self {
            task: experiment.task().name(),
            robot: experiment.robot().name(),
            backend: experiment.options().backend.name().to_owned(),
            plant: experiment.plant(),
            controller: experiment.options().controller.name().to_owned(),
            transformer: experiment.transformer_name().map(|name| name.to_string()),
            profile: experiment.profile().0.to_owned(),
            overrides: experiment.settings().to_vec(),
            seed: Some(experiment.seed()),
        }
    }

    /// Reads the key of a row; `None` if it lacks a part.
    fn of_row(row: &Value) -> Option<Self> {
        let text = |key: &str| row[key].as_str().map(str::to_owned);
        let overrides = row["overrides"].as_array()?.iter().map(|set| set.as_str().map(str::to_owned));
        Some(Self {
            task: text("task")?,
            robot: text("robot")?,
            backend: text("backend")?,
            plant: text("plant").unwrap_or_else(|| OWN_PLANT.to_owned()),
            controller: text("controller")?,
            transformer: text("transformer"),
            profile: text("profile")?,
            overrides: overrides.collect::<Option<_>>()?,
            seed: Some(row["seed"].as_u64()?),
        })
    }

    fn without_seed(&self) -> Self {
        Self { seed: None, ..self.clone() }
    }
}

impl fmt::Display for RunKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} on {}, {} robot, {}", self.task, self.robot, self.backend, self.controller)?;
        if let Some(transformer) = &self.transformer {
            write!(f, " + {transformer}")?;
        }
        if self.plant != OWN_PLANT {
            write!(f, ", {}", self.plant)?;
        }
        write!(f, ", {}", self.profile)?;
        for set in &self.overrides {
            write!(f, ", {set}")?;
        }
        self.seed.map_or(Ok(()), |seed| write!(f, ", seed {seed}"))
    }
}

/// Run as far as it is compared.
#[derive(Clone, Debug)]
struct ComparedRun {
    key: RunKey,
    metrics: Vec<(String, f64)>,
    failed: bool,
}

impl ComparedRun {
    fn new(row: &Value) -> Option<Self> {
        let metrics = row["metrics"].as_object()?.iter();
        let any = |key: &str| row[key].as_array().is_some_and(|list| !list.is_empty());
        Some(Self {
            key: RunKey::of_row(row)?,
            metrics: metrics.filter_map(|(name, value)| Some((name.clone(), value.as_f64()?))).collect(),
            failed: !row["faulted"].is_null() || any("failures") || any("missed_expectations"),
        })
    }

    fn metric(&self, name: &str) -> Option<f64> {
        self.metrics.iter().find(|(own, _)| own == name).map(|(_, value)| *value)
    }
}

/// Earlier results of a suite.
#[derive(Clone, Debug)]
pub struct Baseline {
    runs: Vec<ComparedRun>,
}

impl Baseline {
    /// Reads a file that `opspace bench` wrote, of this or an earlier version.
    ///
    /// # Errors
    /// A description of what the file lacks.
    pub fn parse(text: &str) -> Result<Self, String> {
        let file: Value = serde_json::from_str(text).map_err(|error| format!("is not JSON: {error}"))?;
        if file["schema"] != "opspace.bench/1" {
            return Err(
                "is not a file of `opspace bench` (its `schema` is not \"opspace.bench/1\")".to_owned()
            );
        }
        let rows = file["rows"].as_array().ok_or("has no `rows`")?;
        let runs = rows.iter().enumerate().map(|(place, row)| {
            ComparedRun::new(row)
                .ok_or_else(|| format!("rows[{place}] lacks a key of a run, such as `task` or `seed`"))
        });
        Ok(Self { runs: runs.collect::<Result<_, _>>()? })
    }

    /// True if it has any of the runs.
    #[must_use]
    pub fn has_any<'a>(&self, keys: impl IntoIterator<Item = &'a RunKey>) -> bool {
        let own: HashSet<&RunKey> = self.runs.iter().map(|run| &run.key).collect();
        keys.into_iter().any(|key| own.contains(key))
    }

    /// Compares new results with this baseline. `added` are the metrics that are not built in.
    #[must_use]
    pub fn compare(&self, summaries: &[Summary], added: &[Metric]) -> BaselineComparison {
        let new: Vec<ComparedRun> = summaries
            .iter()
            .filter_map(|summary| ComparedRun::new(&serde_json::to_value(summary).unwrap_or_default()))
            .collect();
        // Runs of one key, in their order: a suite may list a run twice.
        let mut old: HashMap<&RunKey, Vec<&ComparedRun>> = HashMap::new();
        self.runs.iter().rev().for_each(|run| old.entry(&run.key).or_default().push(run));
        let mut comparison = BaselineComparison::default();
        let mut groups: Vec<(RunKey, Vec<(&ComparedRun, &ComparedRun)>)> = Vec::new();
        let mut places: HashMap<RunKey, usize> = HashMap::new();
        for run in &new {
            let Some(before) = old.get_mut(&run.key).and_then(Vec::pop) else {
                comparison.only_new.push(run.key.to_string());
                continue;
            };
            if run.failed && !before.failed {
                comparison.newly_failed.push(run.key.to_string());
            }
            let place = *places.entry(run.key.without_seed()).or_insert_with(|| {
                groups.push((run.key.without_seed(), Vec::new()));
                groups.len() - 1
            });
            groups[place].1.push((before, run));
        }
        let unmatched: HashMap<&RunKey, usize> = old.iter().map(|(key, runs)| (*key, runs.len())).collect();
        let mut listed = HashSet::new();
        for run in &self.runs {
            let count = unmatched.get(&run.key).copied().unwrap_or(0);
            if count > 0 && listed.insert(&run.key) {
                comparison.only_baseline.extend(std::iter::repeat_n(run.key.to_string(), count));
            }
        }
        for (key, pairs) in groups {
            comparison.add(&key, &pairs, added);
        }
        comparison
    }
}

/// Result of the comparison of one metric.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Verdict {
    /// The new values are better.
    Better,
    /// The new values are worse.
    Worse,
    /// No difference that counts.
    Same,
    /// A difference of a metric that is neither better nor worse.
    Changed,
}

impl Verdict {
    /// Name of the verdict in tables and in JSON.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Better => "better",
            Self::Worse => "worse",
            Self::Same => "same",
            Self::Changed => "changed",
        }
    }
}

/// Comparison of one metric over the pairs of runs that differ only in the seed.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct MetricComparison {
    /// The runs.
    pub run: RunKey,
    /// Key of the metric, with its unit.
    pub metric: String,
    /// Number of pairs.
    pub pairs: usize,
    /// Mean of the old values.
    pub baseline: f64,
    /// Mean of the new values.
    pub new: f64,
    /// Mean difference, new minus old.
    pub difference: f64,
    /// Half of the width of its 95 % confidence interval; `None` for a single pair.
    pub half_width: Option<f64>,
    /// Result.
    pub verdict: Verdict,
}

/// Comparison of results with a baseline.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct BaselineComparison {
    /// Comparisons of all metrics.
    pub metrics: Vec<MetricComparison>,
    /// Runs that fail and did not fail in the baseline.
    pub newly_failed: Vec<String>,
    /// Values that the baseline has and the new results lack, although their run is in both.
    pub lost: Vec<String>,
    /// Runs of the baseline that the new results lack.
    pub only_baseline: Vec<String>,
    /// Runs that the baseline lacks.
    pub only_new: Vec<String>,
}

impl BaselineComparison {
    /// Compares all metrics of pairs of an old and a new run.
    fn add(&mut self, key: &RunKey, pairs: &[(&ComparedRun, &ComparedRun)], added: &[Metric]) {
        let mut names: Vec<&str> = Vec::new();
        for (old, _) in pairs {
            for (name, _) in &old.metrics {
                if !names.contains(&name.as_str()) {
                    names.push(name);
                }
            }
        }
        for name in names {
            let both = pairs.iter().filter_map(|(old, new)| Some((old.metric(name)?, new.metric(name)?)));
            let values: Vec<(f64, f64)> = both.collect();
            if pairs.iter().any(|(old, new)| old.metric(name).is_some() && new.metric(name).is_none()) {
                self.lost.push(format!("{key}: {name}"));
            }
            if !values.is_empty() {
                self.metrics.push(compare(key, name, better(name, added), &values));
            }
        }
    }

    /// Number of comparisons with this result.
    #[must_use]
    pub fn count(&self, verdict: Verdict) -> usize {
        self.metrics.iter().filter(|metric| metric.verdict == verdict).count()
    }

    /// True if a metric is worse, or a run fails or lacks a value that the baseline has.
    #[must_use]
    pub fn is_worse(&self) -> bool {
        self.count(Verdict::Worse) > 0 || !self.newly_failed.is_empty() || !self.lost.is_empty()
    }

    /// Table of the metrics that are not the same.
    #[must_use]
    pub fn table(&self) -> Table {
        let heads = ["run", "metric", "baseline", "new", "difference", "±", "pairs", "result"];
        let mut table = Table::new(&heads.map(|head| (head, "")));
        for metric in self.metrics.iter().filter(|metric| metric.verdict != Verdict::Same) {
            // The magnitudes of different metrics are not comparable: each number has its own digits.
            let number = |value: f64| Cell::Text(opspace_experiment::text::format_number(value));
            table.push(vec![
                metric.run.to_string().into(),
                metric.metric.as_str().into(),
                number(metric.baseline),
                number(metric.new),
                number(metric.difference),
                metric.half_width.map_or(Cell::Empty, number),
                (metric.pairs as u64).into(),
                match metric.verdict {
                    Verdict::Worse => Cell::Fail(metric.verdict.name().to_owned()),
                    other => other.name().into(),
                },
            ]);
        }
        table
    }
}

/// Values of a metric that are better.
fn better(name: &str, added: &[Metric]) -> Better {
    let metric = Metric::built_in().iter().chain(added).find(|metric| metric.key == name);
    metric.map_or(Better::Neither, |metric| metric.better)
}

fn compare(key: &RunKey, name: &str, better: Better, values: &[(f64, f64)]) -> MetricComparison {
    let n = values.len() as f64;
    let mean = |value: &dyn Fn(&(f64, f64)) -> f64| values.iter().map(value).sum::<f64>() / n;
    let difference = mean(&|(old, new)| new - old);
    let half_width = (values.len() > 1).then(|| {
        let variance =
            values.iter().map(|(old, new)| (new - old - difference).powi(2)).sum::<f64>() / (n - 1.0);
        student_95(values.len() - 1) * (variance / n).sqrt()
    });
    let counts = difference.abs() > TOLERANCE * mean(&|(old, _)| old.abs());
    // Values so large that their interval overflows differ.
    let is_certain = half_width.is_none_or(|half| difference.abs() > half || !half.is_finite());
    let verdict = match better {
        _ if !(counts && is_certain) => Verdict::Same,
        Better::Neither => Verdict::Changed,
        Better::Smaller if difference < 0.0 => Verdict::Better,
        Better::Larger if difference >= 0.0 => Verdict::Better,
        _ => Verdict::Worse,
    };
    MetricComparison {
        run: key.clone(),
        metric: name.to_owned(),
        pairs: values.len(),
        baseline: mean(&|(old, _)| *old),
        new: mean(&|(_, new)| *new),
        difference,
        half_width,
        verdict,
    }
}

/// Quantile of Student's t distribution at 97.5 %, by degrees of freedom.
fn student_95(degrees: usize) -> f64 {
    const TABLE: [f64; 10] =
        [12.7062, 4.302_65, 3.182_45, 2.776_45, 2.570_58, 2.446_91, 2.364_62, 2.306_00, 2.262_16, 2.228_14];
    match degrees {
        0 => f64::INFINITY,
        1..=10 => TABLE[degrees - 1],
        // Expansion in 1/degrees (Abramowitz and Stegun, 26.7.5).
        _ => {
            let (z, v) = (1.959_963_984_540_054_f64, degrees as f64);
            let z2 = z * z;
            z + z * (z2 + 1.0) / (4.0 * v)
                + z * ((5.0 * z2 + 16.0) * z2 + 3.0) / (96.0 * v * v)
                + z * (((3.0 * z2 + 19.0) * z2 + 17.0) * z2 - 15.0) / (384.0 * v.powi(3))
                + z * ((((79.0 * z2 + 776.0) * z2 + 1482.0) * z2 - 1920.0) * z2 - 945.0)
                    / (92160.0 * v.powi(4))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Baseline, RunKey, Verdict, better, compare, student_95};
    use serde_json::{Value, json};

    fn key() -> RunKey {
        let row = json!({
            "task": "a", "robot": "r", "backend": "torque", "controller": "osc", "transformer": null,
            "profile": "p", "overrides": ["x=1"], "seed": 1, "metrics": {},
        });
        RunKey::of_row(&row).expect("a key")
    }

    /// Error of the series for Student's quantiles.
    const SERIES: f64 = 1e-4;

    /// Compared: quantiles of Student's t, and those of SciPy's `t.ppf(0.975, n)`.
    #[test]
    fn quantiles_of_student_match_scipy() {
        for (degrees, expected) in [
            (1, 12.706_205),
            (4, 2.776_445),
            (9, 2.262_157),
            (11, 2.200_985),
            (19, 2.093_024),
            (99, 1.984_217),
        ] {
            assert!((student_95(degrees) - expected).abs() < SERIES, "{degrees}: {}", student_95(degrees));
        }
    }

    /// Checks differences within the interval, within the tolerance, beyond both, and of a single pair.
    #[test]
    fn difference_counts_beyond_interval_and_tolerance() {
        let verdict =
            |name: &str, values: &[(f64, f64)]| compare(&key(), name, better(name, &[]), values).verdict;
        let error = "position_rms_m";
        assert_eq!(
            verdict(error, &[(1.0, 1.2), (1.0, 0.9), (1.0, 1.1)]),
            Verdict::Same,
            "within the interval"
        );
        assert_eq!(verdict(error, &[(1.0, 1.001), (1.0, 1.001)]), Verdict::Same, "within the tolerance");
        assert_eq!(verdict(error, &[(1.0, 1.1), (2.0, 2.1), (3.0, 3.1)]), Verdict::Worse);
        assert_eq!(verdict(error, &[(1.0, 0.9), (2.0, 1.9), (3.0, 2.9)]), Verdict::Better);
        assert_eq!(verdict("in_contact_fraction", &[(0.5, 0.4)]), Verdict::Worse);
        assert_eq!(verdict("speed_max_rad_per_s", &[(0.5, 0.4)]), Verdict::Changed);
        assert_eq!(verdict(error, &[(1.0, 1.009)]), Verdict::Same);
        assert_eq!(verdict(error, &[(1.0, 1.011)]), Verdict::Worse);
        assert_eq!(verdict(error, &[(0.5, 1e308), (0.5, 0.5)]), Verdict::Worse);
        assert_eq!(verdict(error, &[(0.0, 0.0)]), Verdict::Same);
        assert_eq!(verdict(error, &[(0.0, 1e-9)]), Verdict::Worse);
    }

    #[test]
    fn file_that_is_no_result_is_no_baseline() {
        let row = json!({"task": "a"});
        for (file, words) in [
            (Value::Null, "schema"),
            (json!({"schema": "opspace.bench/1"}), "no `rows`"),
            (json!({"schema": "opspace.bench/1", "rows": [row]}), "rows[0]"),
        ] {
            assert!(Baseline::parse(&file.to_string()).is_err_and(|error| error.contains(words)), "{file}");
        }
        assert!(Baseline::parse("{").is_err_and(|error| error.contains("not JSON")));
    }
}

//! Direction of each metric: whether smaller or larger values are better.
//!
//! It shows only in a comparison with a baseline. The results of a suite are therefore compared with themselves, where all
//! metrics of the baseline are larger.

use crate::entries::{Entry, Kind, NOT_COMPARED};
use crate::keys;
use crate::side::{Side, read_json};
use serde_json::{Map, Value, json};
use std::path::Path;

/// Compares the results of a suite, in a folder, with larger ones; no entries for results of experiments with several
/// robots, which cannot be compared with a baseline.
///
/// # Errors
/// A program that cannot be started, or a file that cannot be written.
pub fn comparison(side: &Side, bench: &Value, results: &Path) -> Result<Vec<Entry>, String> {
    let Some(baseline) = with_larger_metrics(bench) else { return Ok(Vec::new()) };
    let (file, out) = (results.with_file_name("baseline.json"), results.with_file_name("compared"));
    std::fs::write(&file, baseline.to_string()).map_err(|e| format!("{}: {e}", file.display()))?;
    // The results are joined with nothing else, which repeats no run.
    let output = side.run([
        "--quiet".as_ref(),
        "merge".as_ref(),
        results.as_os_str(),
        "--baseline".as_ref(),
        file.as_os_str(),
        "--out".as_ref(),
        out.as_os_str(),
    ])?;
    let compared = read_json(&out.join("bench.json"))
        .and_then(|mut bench| by_metric(bench.get_mut("comparison")?.take()));
    Ok(match compared {
        Some(compared) => keys::of("comparison", &compared),
        None => {
            let why = format!("no comparison with a baseline: {}", String::from_utf8_lossy(&output.stderr));
            vec![Entry::new(Kind::Key, NOT_COMPARED, &why)]
        }
    })
}

/// Comparison with a list for each metric in place of one for all, in which a new metric would move all others; `None` if
/// nothing was compared.
fn by_metric(mut comparison: Value) -> Option<Value> {
    let list = comparison.get_mut("metrics").filter(|list| **list != json!([]))?.take();
    let mut metrics = Map::new();
    for item in list.as_array()? {
        let of_metric = metrics.entry(item["metric"].as_str()?).or_insert_with(|| json!([]));
        of_metric.as_array_mut()?.push(item.clone());
    }
    comparison["metrics"] = metrics.into();
    Some(comparison)
}

/// Results in which every metric of every run is larger; `None` if no run has any.
fn with_larger_metrics(bench: &Value) -> Option<Value> {
    let mut bench = bench.clone();
    let rows = bench.get_mut("rows")?.as_array_mut()?;
    let metrics = rows.iter_mut().filter_map(|row| row.get_mut("metrics")?.as_object_mut());
    let mut count = 0;
    for value in metrics.flat_map(|metrics| metrics.values_mut()) {
        if let Some(number) = value.as_f64() {
            *value = (number + number.abs() + 1.0).into();
            count += 1;
        }
    }
    (count > 0).then_some(bench)
}

#[cfg(test)]
mod tests {
    use super::{by_metric, with_larger_metrics};
    use serde_json::{Value, json};

    /// Compared: metrics, and those of the baseline.
    #[test]
    fn every_metric_is_larger() {
        let bench = json!({ "rows": [{ "seed": 1, "metrics": { "a": 2.0, "b": 0, "c": -3.0, "d": null } }] });
        let larger =
            json!({ "rows": [{ "seed": 1, "metrics": { "a": 5.0, "b": 1.0, "c": 1.0, "d": null } }] });
        assert_eq!(with_larger_metrics(&bench), Some(larger));
        for none in [json!({ "rows": [{ "robots": {} }] }), json!({ "rows": [] }), Value::Null] {
            assert_eq!(with_larger_metrics(&none), None);
        }
    }

    /// Compared: a list of comparisons, and one with another metric in the middle of it.
    #[test]
    fn another_metric_moves_no_other() {
        let item = |metric: &str, verdict: &str| json!({ "metric": metric, "verdict": verdict });
        let items = [item("a", "better"), item("c", "worse"), item("b", "worse"), item("a", "same")];
        let compared =
            |items: &[Value]| by_metric(json!({ "lost": [], "metrics": items })).unwrap_or_default();
        let all = compared(&items);
        assert_eq!(all["metrics"]["a"], json!([items[0], items[3]]));
        assert_eq!(all["lost"], json!([]));
        let less = compared(&[&items[..1], &items[2..]].concat());
        assert!(less["metrics"]["c"].is_null() && less["metrics"]["b"] == all["metrics"]["b"]);
        assert_eq!(by_metric(json!({ "metrics": [] })), None);
        assert_eq!(by_metric(json!({})), None);
    }
}

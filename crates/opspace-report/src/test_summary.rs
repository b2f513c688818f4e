//! Summary of a run for tests.

use opspace_experiment::Summary;
use serde_json::json;

/// Summary of a completed run of a position robot with an rms error of its position, m.
pub(crate) fn summary(task: &str, profile: &str, seed: u64, position_rms_m: f64) -> Summary {
    let json = json!({
        "task": task, "robot": "arm", "backend": "position", "controller": "osc", "transformer": null,
        "transformer_reason": null, "profile": profile, "ratio": 5, "seed": seed, "simulated": true, "plant": "own",
        "duration_s": 1.0, "overrides": [], "label": null, "faulted": null, "fault_time_s": null, "interrupted": false,
        "interrupted_time_s": null, "rows_lost": 0, "not_saved": [], "missed_cycles": 0, "stale_target_cycles": 0,
        "resumed": 0, "missed_expectations": [], "findings": [], "tasks": {}, "joints": {},
        "metrics": { "position_rms_m": position_rms_m },
        "timing": { "tick_ns_median": 0.0, "tick_ns_p99": 0.0, "tick_ns_max": 0.0, "realtime_factor": null },
    });
    serde_json::from_value(json).unwrap_or_else(|error| panic!("{error}"))
}

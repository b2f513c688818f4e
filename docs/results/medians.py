"""Medians over the seeds of `opspace bench --json FILE`: python3 docs/results/medians.py FILE."""

import json
import statistics
import sys

RUN = ["task", "profile", "ratio", "backend", "controller", "transformer", "overrides"]
METRICS = {"position_rms_m": 1e3, "joint_rms_rad": 1e3, "hand_force_rms_n": 1, "hand_motion_rms_m": 1e3,
           "torque_error_interval": 100, "torque_error_servo": 100}

groups = {}
for row in json.load(open(sys.argv[1]))["rows"]:
    groups.setdefault(tuple(str(row[key]) for key in RUN), []).append(row)
print("run", "seeds", "position mm", "joint mrad", "force N", "motion mm", "interval %", "servo %", "cycle us", sep="\t")
for run, rows in groups.items():
    values = [[scale * row["metrics"][key] for row in rows if row["metrics"][key] is not None] for key, scale in METRICS.items()]
    values.append([1e-3 * row["timing"]["tick_ns_median"] for row in rows])
    medians = [f"{statistics.median(v):.3g}" if v else "-" for v in values]
    print(" ".join(run), len(rows), *medians, sep="\t")

"""Table of the bounds on a teleoperation, worst values over all runs of `opspace bench tasks/suites/teleop-matrix.toml --json FILE`:
python3 docs/results/teleoperation_table.py FILE... A suite that was cut off has a `rows.jsonl` in place of FILE."""

import json
import re
import sys

WALLS = {"free": "free", "1": "1 kN/m", "50": "50 kN/m"}


class Run:
    def __init__(self, row):
        self.metrics = row["couplings"]["hands"]
        self.seed, self.missed, self.holds = row["seed"], row["missed_expectations"], row["holds"]
        self.faults = [f"{name}: {robot['faulted']}" for name, robot in row["robots"].items() if robot["faulted"]]
        self.plant = row["robots"]["leader"].get("plant") or "own"
        self.profile = row["robots"]["leader"]["profile"]
        settings = dict(setting.split("=", 1) for setting in row["overrides"])
        self.leader = settings.get("robots.leader.backend", "position").strip('"')
        self.follower = settings.get("robots.follower.backend", "position").strip('"')
        number = lambda key, default: float(settings.get(key, default))
        self.delay_ms = round(1e3 * number("channels.link.delay_s", 0.0))
        self.jitter = number("channels.link.jitter_s", 0.0) > 0.0
        self.g = number("couplings.hands.teleoperation.handle_feedback", 0.0)
        self.friction = number("leader.robot.simulated.true_over_nominal.friction", 1.0)
        free = number("leader.environment.operator.motion.scripted.probe.rms_m", 0.01) == 0.0
        wall = number("follower.environment.table.stiffness_n_per_m", 1000.0)
        self.wall = "free" if free else f"{wall / 1e3:g}"
        self.combination = (self.profile, self.leader, self.follower, self.delay_ms, self.jitter, self.friction, self.wall, self.g)

    def __str__(self):
        jitter, g = " jitter+loss" * self.jitter, f" g {self.g:g}" if self.g else ""
        return (f"{self.leader}-{self.follower} {self.profile} friction x {self.friction:g} {WALLS[self.wall]} "
                f"{self.delay_ms} ms{jitter}{g} seed {self.seed}")


def worst(runs, key, least=False):
    """Worst value of a metric, and the run that has it."""
    found = [(run.metrics[key], run) for run in runs if run.metrics.get(key) is not None]
    if not found:
        return None
    return (min if least else max)(found, key=lambda pair: pair[0])


def say(what, must, want, key, runs, unit=1.0, least=False):
    runs = list(runs)
    found = worst(runs, key, least)
    if found is None:
        return
    value, run = found
    values = sorted(run.metrics[key] for run in runs if run.metrics.get(key) is not None)
    median = values[len(values) // 2]
    is_over = lambda bound, v: bound is not None and (v < bound if least else v > bound)
    misses = sum(is_over(must, unit * v) for v in values)
    wants = "-" if want is None else f"{sum(is_over(want, unit * v) for v in values)}"
    print(f"| {what} | {'-' if must is None else must} | {'-' if want is None else want} | {unit * value:.3g} | {unit * median:.3g} "
          f"| {'-' if must is None else misses} / {wants} of {len(values)} | {run} |")


def ratios(runs, key):
    """Largest ratio, in either direction, of a position leader's metric to a torque leader's, each the mean over the same seeds."""
    groups = {}
    for run in runs:
        value = run.metrics.get(key)
        if value is not None:
            name = (run.follower,) + run.combination[3:] + (run.profile,)
            groups.setdefault(name, {}).setdefault(run.leader, []).append(value)
    found = []
    for name, group in groups.items():
        if len(group) == 2:
            mean = {leader: sum(values) / len(values) for leader, values in group.items()}
            found.append((mean["position"] / mean["torque"], name))
    return sorted(found, key=lambda pair: pair[0])


def rows(path):
    if path.endswith(".jsonl"):
        return [json.loads(line)["row"] for line in list(open(path))[1:]]
    return json.load(open(path))["rows"]


def main():
    runs = [Run(row) for path in sys.argv[1:] for row in rows(path)]
    runs = [run for run in runs if {run.leader, run.follower} <= {"position", "torque"}]
    print(f"{len(runs)} runs, {len({run.combination for run in runs})} combinations, seeds "
          f"{sorted({run.seed for run in runs})}, plants {sorted({run.plant for run in runs})}\n")
    print("| what | must | want | worst | median | beyond must / want | worst run |\n|---|---|---|---|---|---|---|")
    plain = [run for run in runs if run.g == 0.0]
    walls = [run for run in plain if run.wall != "free"]
    say("velocity above 20 Hz, mm/s", 10, None, "fast_velocity_m_per_s", runs, 1e3)
    say("contact lost, s", 2, 0, "contact_lost_s", runs)
    say("energy extracted, J", 0.05, 0.01, "energy_extracted_j", runs)
    for delay_ms, must, want in [(0, 2, 0.5), (20, 3, 2.2), (100, 8, 6)]:
        for jitter in [False, True]:
            free = [run for run in runs if run.wall == "free" and run.delay_ms == delay_ms and run.jitter == jitter]
            name = ", jitter and loss" if jitter else ""
            say(f"tracking in free motion, {delay_ms} ms{name}, mm", must, want, "tracking_rms_m", free, 1e3)
    say("drift at the end, mm", 5, 1, "drift_m", runs, 1e3)
    for wall, g, least, largest in [("1", 1.0, 0.9, 1.3), ("50", 0.0, 0.8, 1.5)]:
        cell = [r for r in runs if r.wall == wall and r.g == g and r.delay_ms == 0 and not r.jitter]
        name = f"felt over series, {WALLS[wall]}, g {g:g}"
        say(f"{name}, least", least, 0.95, "felt_over_series_least", cell, least=True)
        say(f"{name}, largest", largest, 1.1, "felt_over_series_largest", cell)
    for wall, delay_ms in [("1", 20), ("50", 20), ("1", 100), ("50", 100)]:
        cell = [r for r in walls if r.wall == wall and r.delay_ms == delay_ms]
        name = f"felt, {WALLS[wall]}, {delay_ms} ms, kN/m"
        say(f"{name}, least", None, None, "felt_least_n_per_m", cell, 1e-3, least=True)
        say(f"{name}, largest", None, None, "felt_largest_n_per_m", cell, 1e-3)
    for g, must, want in [(0.0, 4, None), (1.0, 1.5, 0.6)]:
        free = [r for r in runs if r.wall == "free" and r.g == g and r.delay_ms == 0 and not r.jitter]
        say(f"force of the free hand, g {g:g}, N", must, want, "hand_force_rms_n", free)
    say("passivity control active, s", None, None, "passivity_time_s", runs)

    print("\nPosition leader over torque leader, same follower, channel, wall and friction; means over the seeds:")
    for key, cells in [
        ("tracking_rms_m", [r for r in runs if r.wall == "free"]),
        ("felt_least_n_per_m", [r for r in runs if r.delay_ms == 0 and r.wall != "free"]),
        ("felt_largest_n_per_m", [r for r in runs if r.delay_ms == 0 and r.wall != "free"]),
    ]:
        found = ratios(cells, key)
        if found:
            values = [ratio for ratio, _ in found]
            beyond = sum(not 0.8 <= ratio <= 1.25 for ratio in values)
            print(f"- {key}: {values[0]:.3f} to {values[-1]:.3f} over {len(values)} pairs; {beyond} beyond 1.25; "
                  f"least {found[0][1]}, largest {found[-1][1]}")

    failed = [run for run in runs if run.missed or run.faults or any(hold["until_s"] is None for hold in run.holds)]
    print(f"\n{len(failed)} of {len(runs)} runs miss a bound; {sum(bool(run.faults) for run in runs)} were stopped:")
    for run in failed:
        print(f"- {run}: {'; '.join(re.sub('hands.', '', text) for text in run.missed + run.faults)}")


main()

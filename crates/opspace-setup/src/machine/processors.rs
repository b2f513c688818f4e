//! Frequency, idle states and isolation of the processors.

use super::finding::MachineFinding;
use super::process::Process;
use super::root::Root;
use std::collections::{BTreeMap, BTreeSet};

const GOVERNOR: &str = "governor";
const IDLE_STATES: &str = "idle-states";
const ISOLATED: &str = "isolated-processors";

/// Time to leave an idle state above which a cycle is delayed noticeably, µs.
const LONG_US: i64 = 100;

pub(super) fn governor(root: &Root<'_>) -> MachineFinding {
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for processor in root.processors() {
        if let Some(governor) = root.text(&format!("{processor}/cpufreq/scaling_governor")) {
            let governor = governor.chars().take(40).collect();
            *counts.entry(governor).or_default() += 1;
        }
    }
    if counts.is_empty() {
        return MachineFinding::note(
            GOVERNOR,
            "no processor lets its frequency be seen, as in virtual machines",
        );
    }
    let others: Vec<String> = counts
        .iter()
        .filter(|(governor, _)| *governor != "performance")
        .map(|(governor, count)| format!("{governor} on {count}"))
        .collect();
    if others.is_empty() {
        return MachineFinding::ok(GOVERNOR, "the governor of all processors is performance");
    }
    let text = format!(
        "processors change their frequency ({}): after a pause, a cycle takes longer",
        others.join(", ")
    );
    MachineFinding::missing(GOVERNOR, text)
        .mended_by("echo performance | sudo tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor")
}

pub(super) fn idle_states(root: &Root<'_>, process: &Process) -> MachineFinding {
    let (mut longest_us, mut long, mut is_seen) = (0, BTreeSet::new(), false);
    for processor in root.processors() {
        let folder = format!("{processor}/cpuidle");
        for state in root.names(&folder, "state") {
            let number = |file: &str| root.number(&format!("{folder}/{state}/{file}"));
            let Some(latency_us) = number("latency") else { continue };
            is_seen = true;
            if number("disable") != Some(1) && latency_us > LONG_US && state[5..].parse::<u32>().is_ok() {
                longest_us = longest_us.max(latency_us);
                long.insert(state);
            }
        }
    }
    if !is_seen {
        return MachineFinding::note(
            IDLE_STATES,
            "no processor lets its idle states be seen, as in virtual machines",
        );
    }
    if long.is_empty() {
        let text = format!("all idle states are left within {LONG_US} µs");
        return MachineFinding::ok(IDLE_STATES, text);
    }
    const LATENCY: &str = "dev/cpu_dma_latency";
    let is_open = root.metadata(LATENCY).is_some_and(|file| process.may_use(&file));
    let hint = if is_open { "; this user may also hold /dev/cpu_dma_latency open with a 0" } else { "" };
    let text = format!("processors fall into idle states that take up to {longest_us} µs to leave{hint}");
    let found = MachineFinding::missing(IDLE_STATES, text);
    long.iter().fold(found, |found, state| {
        found.mended_by(format!("echo 1 | sudo tee /sys/devices/system/cpu/cpu*/cpuidle/{state}/disable"))
    })
}

pub(super) fn isolated(root: &Root<'_>) -> MachineFinding {
    match root.text("sys/devices/system/cpu/isolated") {
        None => MachineFinding::note(ISOLATED, "it is not known whether processors are isolated"),
        Some(list) if list.is_empty() => MachineFinding::note(
            ISOLATED,
            "no processor is kept free of other programs (`isolcpus=`), which few arms need",
        ),
        Some(list) => {
            let list: String =
                list.chars().filter(|c| c.is_ascii_digit() || [',', '-'].contains(c)).collect();
            let text = format!(
                "processors {list} are isolated: start opspace there by `taskset -c {list} opspace ...`"
            );
            MachineFinding::note(ISOLATED, text)
        }
    }
}

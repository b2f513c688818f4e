//! Permissions for real-time scheduling and locked memory.

use super::finding::MachineFinding;
use super::process::{CAP_IPC_LOCK, CAP_SYS_NICE, Limit, Process};
use super::root::Root;
use opspace_loop::real_time::PRIORITY;

const PRIORITY_LIMIT: &str = "priority-limit";
const MEMORY_LIMIT: &str = "memory-limit";
const THROTTLING: &str = "throttling";

/// Memory that a run with a log and a live view needs, bytes.
const ENOUGH_BYTES: u64 = 1 << 30;

pub(super) fn priority_limit(root: &Root<'_>, process: &Process) -> MachineFinding {
    if process.has_capability(CAP_SYS_NICE) {
        return MachineFinding::ok(PRIORITY_LIMIT, "SCHED_FIFO is allowed by CAP_SYS_NICE");
    }
    match process.priority {
        None => MachineFinding::note(PRIORITY_LIMIT, "/proc/self/limits does not tell the limit"),
        Some(Limit::Value(0)) => {
            let text = "SCHED_FIFO is not allowed: the limit of real-time priorities is 0";
            mended(root, MachineFinding::missing(PRIORITY_LIMIT, text))
        }
        Some(Limit::Value(limit)) if limit < u64::from(PRIORITY) => {
            let text = format!(
                "SCHED_FIFO is allowed up to priority {limit} only; opspace asks for {PRIORITY}, which is above interrupts"
            );
            mended(root, MachineFinding::missing(PRIORITY_LIMIT, text))
        }
        Some(Limit::Value(limit)) => {
            MachineFinding::ok(PRIORITY_LIMIT, format!("SCHED_FIFO is allowed up to priority {limit}"))
        }
        Some(Limit::Unlimited) => MachineFinding::ok(PRIORITY_LIMIT, "SCHED_FIFO is allowed"),
    }
}

pub(super) fn memory_limit(root: &Root<'_>, process: &Process) -> MachineFinding {
    let item = MEMORY_LIMIT;
    match process.locked_memory {
        Some(Limit::Unlimited) => MachineFinding::ok(item, "memory can be locked without a limit"),
        Some(Limit::Value(bytes)) if bytes >= ENOUGH_BYTES => {
            MachineFinding::ok(item, format!("up to {} MB of memory can be locked", bytes >> 20))
        }
        _ if process.has_capability(CAP_IPC_LOCK) => {
            MachineFinding::ok(item, "memory can be locked by CAP_IPC_LOCK")
        }
        Some(Limit::Value(bytes)) => {
            let text = format!("only {} kB of memory can be locked, which no run fits into", bytes >> 10);
            mended(root, MachineFinding::missing(item, text))
        }
        None => MachineFinding::note(item, "/proc/self/limits does not tell the limit"),
    }
}

/// Adds the commands that raise both limits.
fn mended(root: &Root<'_>, finding: MachineFinding) -> MachineFinding {
    if root.is_container() {
        return finding.mended_by("docker run --cap-add SYS_NICE --ulimit rtprio=99 --ulimit memlock=-1 ...");
    }
    finding
        .mended_by("sudo groupadd -f realtime && sudo usermod -aG realtime \"$USER\"")
        .mended_by(
            "printf '@realtime - rtprio 99\\n@realtime - memlock unlimited\\n' | sudo tee /etc/security/limits.d/99-realtime.conf",
        )
        .mended_by("logout   # limits and groups count from the next login on")
}

/// Share of the time that the kernel leaves to real-time threads.
pub(super) fn throttling(root: &Root<'_>) -> MachineFinding {
    let period_us = root.number("proc/sys/kernel/sched_rt_period_us").filter(|period_us| *period_us > 0);
    match root.number("proc/sys/kernel/sched_rt_runtime_us") {
        None => MachineFinding::note(
            THROTTLING,
            "the kernel does not tell whether it throttles real-time threads",
        ),
        Some(0) => MachineFinding::missing(THROTTLING, "the kernel gives real-time threads no time at all")
            .mended_by("sudo sysctl -w kernel.sched_rt_runtime_us=950000"),
        Some(runtime_us) if runtime_us < 0 => {
            MachineFinding::ok(THROTTLING, "the kernel does not throttle real-time threads")
        }
        Some(runtime_us) => {
            let percent = 100.0 * runtime_us as f64 / period_us.unwrap_or(1_000_000) as f64;
            let text =
                format!("real-time threads may use {percent:.0} % of the time, far more than a control loop");
            MachineFinding::ok(THROTTLING, text)
        }
    }
}

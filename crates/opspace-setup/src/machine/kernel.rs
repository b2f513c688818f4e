//! Kernel, clock, swap, and hints of a virtual machine or a container.

use super::finding::MachineFinding;
use super::root::Root;

const KERNEL: &str = "kernel";
const CLOCK_SOURCE: &str = "clock-source";
const SWAP: &str = "swap";
const MACHINE: &str = "machine";

/// Clocks that are read without a call of the kernel or a slow device.
const GOOD_CLOCKS: [&str; 6] =
    ["tsc", "arch_sys_counter", "riscv_clocksource", "timebase", "kvm-clock", "hyperv_clocksource_tsc_page"];

pub(super) fn kernel(root: &Root<'_>) -> MachineFinding {
    let version = root.text("proc/sys/kernel/version").or_else(|| root.text("proc/version"));
    let Some(version) = version else {
        return MachineFinding::note(KERNEL, "the version of the kernel is not known");
    };
    if root.number("sys/kernel/realtime") == Some(1) || version.contains("PREEMPT_RT") {
        return MachineFinding::ok(KERNEL, "the kernel is a real-time kernel (PREEMPT_RT)");
    }
    let found = MachineFinding::missing(
        KERNEL,
        "the kernel is no real-time kernel (PREEMPT_RT): other programs and interrupts can delay a cycle by milliseconds. At \
         100 Hz and less this is rarely felt",
    );
    if root.is_container() {
        return MachineFinding { text: format!("{}; the kernel is that of the host", found.text), ..found };
    }
    let distributions = root.distributions();
    let is = |name: &str| distributions.iter().any(|distribution| distribution == name);
    match () {
        () if is("ubuntu") => found.mended_by("sudo pro enable realtime-kernel   # after `sudo pro attach`"),
        () if is("debian") => found.mended_by("sudo apt install linux-image-rt-$(dpkg --print-architecture)"),
        () if is("arch") => found.mended_by("sudo pacman -S linux-rt"),
        () if is("rhel") => found.mended_by("sudo dnf install kernel-rt"),
        () => found.mended_by(
            "uname -v   # install the package of your distribution whose kernel shows PREEMPT_RT here",
        ),
    }
}

pub(super) fn clock_source(root: &Root<'_>) -> MachineFinding {
    const FOLDER: &str = "sys/devices/system/clocksource/clocksource0";
    let Some(clock) = root.text(&format!("{FOLDER}/current_clocksource")).filter(|clock| !clock.is_empty())
    else {
        return MachineFinding::note(CLOCK_SOURCE, "the clock source is not known");
    };
    let clock = clock.chars().take(40).collect::<String>();
    if GOOD_CLOCKS.contains(&clock.as_str()) {
        return MachineFinding::ok(CLOCK_SOURCE, format!("the clock source is {clock}"));
    }
    let found = MachineFinding::missing(
        CLOCK_SOURCE,
        format!("the clock source is {clock}, which takes long to read"),
    );
    let available = root.text(&format!("{FOLDER}/available_clocksource")).unwrap_or_default();
    match available.split_whitespace().find(|other| GOOD_CLOCKS.contains(other)) {
        Some(better) => found.mended_by(format!("echo {better} | sudo tee /{FOLDER}/current_clocksource")),
        None => found.mended_by("sudo dmesg | grep -i -e tsc -e clocksource   # why the kernel rejected tsc"),
    }
}

pub(super) fn swap(root: &Root<'_>) -> MachineFinding {
    match root.text("proc/swaps").map(|text| text.lines().skip(1).count()) {
        None => MachineFinding::note(SWAP, "it is not known whether memory is swapped"),
        Some(0) => MachineFinding::ok(SWAP, "memory is not swapped"),
        Some(_) => MachineFinding::note(SWAP, "swap is on: only memory that is locked is safe from it"),
    }
}

pub(super) fn machine(root: &Root<'_>) -> MachineFinding {
    let processors = root.text("proc/cpuinfo").unwrap_or_default();
    let flags = processors.lines().find(|line| line.starts_with("flags")).unwrap_or_default();
    let is_virtual = flags.split_whitespace().any(|flag| flag == "hypervisor");
    let text = match (root.is_container(), is_virtual) {
        (false, false) => {
            return MachineFinding::ok(MACHINE, "neither a container nor a virtual machine is seen");
        }
        (true, false) => {
            "this is a container: limits, priorities and devices are those that it was started with"
        }
        (false, true) => {
            "this is a virtual machine: its host may pause it at any time, which nothing here can prevent"
        }
        (true, true) => "this is a container in a virtual machine, whose host may pause it at any time",
    };
    MachineFinding::note(MACHINE, text)
}

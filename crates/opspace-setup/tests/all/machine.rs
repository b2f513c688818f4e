//! Findings about made-up machines: trees of files as Linux has them.
#![cfg(target_os = "linux")]

use opspace_loop::RealTimeMode;
use opspace_setup::machine::{Level, MachineFinding, examine, is_lacking, wake_up};
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// Files of a machine that lacks nothing, of an unprivileged user.
const GOOD: [(&str, &str); 17] = [
    (
        "proc/self/limits",
        "Limit  Soft Limit  Hard Limit  Units\nMax locked memory  unlimited  unlimited  bytes\nMax realtime priority  99  99\n",
    ),
    (
        "proc/self/status",
        "Name:\topspace\nUid:\t1000\t1000\t1000\t1000\nGid:\t1000\t1000\t1000\t1000\nGroups:\t20 1000\nCapEff:\t0000000000000000\n",
    ),
    ("proc/sys/kernel/version", "#1 SMP PREEMPT_RT Debian 6.12.9-1"),
    ("proc/sys/kernel/sched_rt_runtime_us", "950000\n"),
    ("proc/sys/kernel/sched_rt_period_us", "1000000\n"),
    ("sys/devices/system/clocksource/clocksource0/current_clocksource", "tsc\n"),
    ("sys/devices/system/clocksource/clocksource0/available_clocksource", "tsc hpet acpi_pm\n"),
    ("sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "performance\n"),
    ("sys/devices/system/cpu/cpu1/cpufreq/scaling_governor", "performance\n"),
    ("sys/devices/system/cpu/cpu0/cpuidle/state1/latency", "2\n"),
    ("sys/devices/system/cpu/cpu0/cpuidle/state3/latency", "350\n"),
    ("sys/devices/system/cpu/cpu0/cpuidle/state3/disable", "1\n"),
    ("sys/devices/system/cpu/isolated", "2-3\n"),
    ("proc/swaps", "Filename Type Size Used Priority\n"),
    ("proc/cpuinfo", "processor : 0\nflags : fpu tsc\n"),
    ("etc/group", "root:x:0:\ndialout:x:20:\n"),
    ("sys/bus/usb-serial/devices/ttyUSB0/latency_timer", "1\n"),
];

/// Paths of files with their texts.
type Files<'a> = &'a [(&'a str, &'a str)];

/// Machine with these files; later ones replace earlier ones.
fn machine(files: &[(&str, &str)]) -> TempDir {
    let root = tempfile::tempdir().expect("a folder");
    for (path, text) in files {
        write(root.path(), path, text.as_bytes());
    }
    root
}

fn write(root: &Path, path: &str, bytes: &[u8]) {
    let path = root.join(path);
    fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
    fs::write(path, bytes).expect("a file");
}

fn find<'a>(findings: &'a [MachineFinding], item: &str) -> &'a MachineFinding {
    findings.iter().find(|finding| finding.item == item).expect("the item is examined")
}

/// Finding about the good machine with some other files.
fn changed(item: &str, files: &[(&str, &str)]) -> MachineFinding {
    let root = machine(&[&GOOD, files].concat());
    find(&examine(root.path()), item).clone()
}

#[test]
fn a_good_machine_lacks_nothing() {
    let root = machine(&GOOD);
    let findings = examine(root.path());
    assert!(!is_lacking(&findings), "{findings:#?}");
    for item in [
        "priority-limit",
        "memory-limit",
        "throttling",
        "kernel",
        "clock-source",
        "governor",
        "idle-states",
        "swap",
        "machine",
        "latency-timer",
    ] {
        assert_eq!(find(&findings, item).level, Level::Ok, "{item}");
    }
    assert!(find(&findings, "isolated-processors").text.contains("taskset -c 2-3"));
}

/// Checks for each item the change that makes it missing, and the command that mends it.
#[test]
fn each_lack_is_named_with_its_command() {
    const LIMITS: &str = "proc/self/limits";
    const CLOCK: &str = "sys/devices/system/clocksource/clocksource0/current_clocksource";
    const KERNEL: &str = "proc/sys/kernel/version";
    let table: [(&str, Files<'_>, &str); 11] = [
        ("priority-limit", &[(LIMITS, "Max realtime priority  0  0\n")], "rtprio 99"),
        ("priority-limit", &[(LIMITS, "Max realtime priority  20  20\n")], "usermod -aG realtime"),
        ("memory-limit", &[(LIMITS, "Max locked memory  8388608  8388608  bytes\n")], "memlock unlimited"),
        (
            "memory-limit",
            &[(LIMITS, "Max locked memory  65536  65536  bytes\n"), (".dockerenv", "")],
            "--ulimit memlock=-1",
        ),
        (
            "throttling",
            &[("proc/sys/kernel/sched_rt_runtime_us", "0\n")],
            "sysctl -w kernel.sched_rt_runtime_us",
        ),
        (
            "kernel",
            &[(KERNEL, "#1 SMP PREEMPT_DYNAMIC"), ("etc/os-release", "ID=debian\n")],
            "linux-image-rt",
        ),
        (
            "kernel",
            &[(KERNEL, "#1 SMP"), ("etc/os-release", "ID=mint\nID_LIKE=\"ubuntu debian\"\n")],
            "sudo pro enable",
        ),
        ("clock-source", &[(CLOCK, "hpet\n")], "echo tsc | sudo tee /sys/devices/system/clocksource"),
        (
            "governor",
            &[("sys/devices/system/cpu/cpu1/cpufreq/scaling_governor", "powersave\n")],
            "echo performance | sudo tee",
        ),
        (
            "idle-states",
            &[("sys/devices/system/cpu/cpu0/cpuidle/state3/disable", "0\n")],
            "cpuidle/state3/disable",
        ),
        (
            "latency-timer",
            &[("sys/bus/usb-serial/devices/ttyUSB0/latency_timer", "16\n")],
            "echo 1 | sudo tee /sys/bus/usb-serial/devices/ttyUSB0/latency_timer",
        ),
    ];
    for (item, files, command) in table {
        let finding = changed(item, files);
        assert_eq!(finding.level, Level::Missing, "{item} {files:?}: {finding:?}");
        assert!(finding.commands.iter().any(|other| other.contains(command)), "{finding:?}");
        assert!(is_lacking(&[finding]));
    }
    assert!(
        changed("governor", &[("sys/devices/system/cpu/cpu1/cpufreq/scaling_governor", "powersave\n")])
            .text
            .contains("powersave on 1")
    );
}

#[test]
fn capabilities_replace_limits() {
    let limits =
        ("proc/self/limits", "Max locked memory  65536  65536  bytes\nMax realtime priority  0  0\n");
    // CAP_IPC_LOCK and CAP_SYS_NICE are the bits 14 and 23.
    let capable = ("proc/self/status", "CapEff:\t0000000000804000\n");
    for item in ["priority-limit", "memory-limit"] {
        assert_eq!(changed(item, &[limits]).level, Level::Missing);
        assert_eq!(changed(item, &[limits, capable]).level, Level::Ok, "{item}");
    }
}

/// Compared: what the permissions of a file that belongs to whoever runs the test say, for that user and for another one.
#[test]
fn a_port_that_cannot_be_opened_is_named_with_its_group() {
    use std::os::unix::fs::{MetadataExt, PermissionsExt};
    let root = machine(&GOOD);
    let port = root.path().join("dev/ttyACM0");
    write(root.path(), "dev/ttyACM0", b"");
    let (user, group) = (fs::metadata(&port).expect("it").uid(), fs::metadata(&port).expect("it").gid());
    let look = |mode: u32, user: u32, group: u32| {
        fs::set_permissions(&port, fs::Permissions::from_mode(mode)).expect("it is ours");
        let status = format!(
            "Uid:\t{user}\t{user}\t{user}\t{user}\nGid:\t{group}\t{group}\t{group}\t{group}\nGroups:\t{group}\nCapEff:\t0\n"
        );
        write(root.path(), "proc/self/status", status.as_bytes());
        find(&examine(root.path()), "serial-ports").clone()
    };
    let (other_user, other_group) = (user + 1, group + 1);
    assert_eq!(look(0o600, user, other_group).level, Level::Ok);
    assert_eq!(look(0o660, other_user, group).level, Level::Ok);
    assert_eq!(look(0o666, other_user, other_group).level, Level::Ok);
    for mode in [0o660, 0o640, 0o664] {
        let refused = look(mode, other_user, other_group);
        assert_eq!(refused.level, Level::Missing, "{mode:o}");
        assert!(
            refused.text.contains("/dev/ttyACM0") && refused.commands[0].starts_with("sudo usermod -aG "),
            "{refused:?}"
        );
    }
    // Who owns a file is judged by the permissions of the owner alone.
    assert_eq!(look(0o066, user, group).level, Level::Missing);
}

#[test]
fn without_a_port_the_group_is_named() {
    let alone = ("proc/self/status", "Uid:\t1000\t1000\t1000\t1000\nGroups:\t1000\nCapEff:\t0\n");
    let finding = changed("serial-ports", &[alone]);
    assert_eq!(
        (finding.level, finding.commands[0].as_str()),
        (Level::Note, "sudo usermod -aG dialout \"$USER\"")
    );
    assert!(changed("serial-ports", &[]).commands.is_empty(), "a member of dialout");
}

#[test]
fn a_container_without_the_files_lacks_nothing_that_is_known() {
    let root = machine(&[("run/.containerenv", "")]);
    let findings = examine(root.path());
    assert!(
        findings.iter().all(|finding| finding.level == Level::Note || finding.item == "machine"),
        "{findings:#?}"
    );
    assert!(find(&findings, "machine").text.contains("container"));
    assert!(!is_lacking(&examine(&root.path().join("no-such-folder"))));
}

#[test]
fn a_virtual_machine_is_a_hint() {
    let finding = changed("machine", &[("proc/cpuinfo", "flags : fpu hypervisor\n")]);
    assert_eq!(finding.level, Level::Note);
    assert!(finding.text.contains("virtual machine"));
    assert_eq!(changed("swap", &[("proc/swaps", "Filename\n/swap file 1 0 -2\n")]).level, Level::Note);
}

/// Gives every file contents that no kernel writes.
#[test]
fn garbage_is_no_panic() {
    let deep = "9".repeat(400);
    let garbage: [&[u8]; 8] = [
        b"",
        b"\0\0\0",
        b"\xff\xfe\xfd",
        b"-9223372036854775809\n",
        b"NaN",
        deep.as_bytes(),
        b"'; rm -rf ~; '",
        b"\n\n\n:::\n",
    ];
    for bytes in garbage {
        let root = tempfile::tempdir().expect("a folder");
        for (path, _) in GOOD {
            write(root.path(), path, bytes);
        }
        for path in [
            "dev/ttyUSB0",
            "sys/devices/system/cpu/cpux/cpufreq/scaling_governor",
            "sys/kernel/realtime",
            "etc/os-release",
        ] {
            write(root.path(), path, bytes);
        }
        // A folder in place of a file.
        fs::create_dir_all(root.path().join("sys/devices/system/cpu/cpu2/cpufreq/scaling_governor"))
            .expect("a folder");
        fs::create_dir_all(root.path().join("sys/devices/system/cpu/cpu0/cpuidle/state/latency"))
            .expect("a folder");
        let findings = examine(root.path());
        assert!(findings.len() >= 10);
        let commands = findings.iter().flat_map(|finding| &finding.commands);
        assert!(commands.clone().all(|command| !command.contains("rm -rf")), "{findings:#?}");
    }
}

/// Checks the counts of a measurement, whatever the machine does; no time is compared with a bound.
#[test]
fn wake_ups_are_measured_with_and_without_real_time_scheduling() {
    for mode in [RealTimeMode::Off, RealTimeMode::Auto] {
        let found = wake_up::measure(0.05, mode);
        assert_eq!(found.cycles, 50);
        assert!(found.late_cycles <= 50 && found.p50_us <= found.p99_us && found.p99_us <= found.max_us);
        assert_eq!(found.is_real_time, mode == RealTimeMode::Auto);
        assert_eq!(found.finding().level == Level::Note, mode == RealTimeMode::Off);
    }
}

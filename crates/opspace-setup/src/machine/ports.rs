//! Serial ports of servo buses.

use super::finding::MachineFinding;
use super::process::{CAP_DAC_OVERRIDE, Process};
use super::root::{Root, is_plain};
use std::os::unix::fs::MetadataExt;

const SERIAL_PORTS: &str = "serial-ports";
const LATENCY_TIMER: &str = "latency-timer";

/// Groups that own serial ports: on Debian and its relatives, and on Arch.
const GROUPS: [&str; 2] = ["dialout", "uucp"];

/// One finding for each serial port, or one if there is none.
pub(super) fn serial_ports(root: &Root<'_>, process: &Process) -> Vec<MachineFinding> {
    let ports = ["ttyACM", "ttyUSB"].into_iter().flat_map(|beginning| root.names("dev", beginning));
    let found: Vec<MachineFinding> = ports.filter_map(|port| serial_port(root, process, &port)).collect();
    if found.is_empty() { vec![without_ports(root, process)] } else { found }
}

fn serial_port(root: &Root<'_>, process: &Process, port: &str) -> Option<MachineFinding> {
    let file = root.metadata(&format!("dev/{port}"))?;
    if process.may_use(&file) {
        return Some(MachineFinding::ok(SERIAL_PORTS, format!("/dev/{port} can be opened")));
    }
    let owner = groups(root).into_iter().find(|(_, group)| *group == file.gid() && *group != 0);
    let group = owner.map_or_else(|| usual_group(root), |(name, _)| name);
    let text = format!(
        "/dev/{port} cannot be opened: this user is not in group {group}, or has not logged in since it is"
    );
    Some(MachineFinding::missing(SERIAL_PORTS, text).mended_by(membership(&group)).mended_by(LOGIN))
}

fn without_ports(root: &Root<'_>, process: &Process) -> MachineFinding {
    const TEXT: &str = "no serial port (/dev/ttyACM*, /dev/ttyUSB*) is plugged in";
    let group = usual_group(root);
    let number = groups(root).into_iter().find(|(name, _)| *name == group);
    match number {
        Some((_, number)) if !process.is_in_group(number) && !process.has_capability(CAP_DAC_OVERRIDE) => {
            let text = format!("{TEXT}; this user is not in group {group}, which may open one");
            MachineFinding::note(SERIAL_PORTS, text).mended_by(membership(&group)).mended_by(LOGIN)
        }
        _ => MachineFinding::note(SERIAL_PORTS, TEXT),
    }
}

const LOGIN: &str = "logout   # groups count from the next login on";

fn membership(group: &str) -> String {
    format!("sudo usermod -aG {group} \"$USER\"")
}

/// Names and numbers of the groups; names that a shell would not take literally are left out.
fn groups(root: &Root<'_>) -> Vec<(String, u32)> {
    let text = root.text("etc/group").unwrap_or_default();
    let group = |line: &str| {
        let mut fields = line.split(':');
        let name = fields.next()?.to_owned();
        let number = fields.nth(1)?.parse().ok()?;
        is_plain(&name).then_some((name, number))
    };
    text.lines().filter_map(group).collect()
}

/// Group that usually owns serial ports.
fn usual_group(root: &Root<'_>) -> String {
    let known = groups(root);
    let usual = GROUPS.into_iter().find(|name| known.iter().any(|(other, _)| other == name));
    usual.unwrap_or(GROUPS[0]).to_owned()
}

/// One finding for each adapter that waits before it passes on what it has received.
pub(super) fn latency_timers(root: &Root<'_>) -> Vec<MachineFinding> {
    const FOLDER: &str = "sys/bus/usb-serial/devices";
    let timer = |port: String| {
        let wait_ms = root.number(&format!("{FOLDER}/{port}/latency_timer"))?;
        if wait_ms <= 1 {
            return Some(MachineFinding::ok(
                LATENCY_TIMER,
                format!("/dev/{port} passes on what it has received after {wait_ms} ms"),
            ));
        }
        let text = format!(
            "/dev/{port} passes on what it has received only after {wait_ms} ms: a servo bus becomes slow"
        );
        let command = format!("echo 1 | sudo tee /{FOLDER}/{port}/latency_timer");
        Some(MachineFinding::missing(LATENCY_TIMER, text).mended_by(command))
    };
    root.names(FOLDER, "tty").into_iter().filter_map(timer).collect()
}

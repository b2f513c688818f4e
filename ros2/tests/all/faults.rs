//! Codes, names and texts of the faults.

use opspace_ros2::RosFault;
use std::collections::BTreeSet;

#[test]
fn codes_and_names_are_unique_and_in_the_readme() {
    let codes: BTreeSet<u32> = RosFault::ALL.iter().map(|fault| fault.code()).collect();
    let names: BTreeSet<&str> = RosFault::ALL.iter().map(|fault| fault.name()).collect();
    assert_eq!((codes.len(), names.len()), (RosFault::ALL.len(), RosFault::ALL.len()));
    let readme = include_str!("../../README.md");
    for fault in RosFault::ALL {
        let row = format!("| {} | `{}` |", fault.code(), fault.name());
        assert!(readme.contains(&row), "the README lacks: {row}");
    }
}

#[test]
fn a_device_fault_begins_with_its_name() {
    let fault = RosFault::ClockJumped.device_fault("by +3600 s");
    assert_eq!(fault.code, 14);
    assert_eq!(fault.words, "clock-jumped: the clock of the joint states jumped: by +3600 s");
}

//! Codes, names and texts of the faults.

use opspace_ros2::RosFault;
use opspace_ros2::link::Refusals;
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

#[test]
fn a_client_that_takes_no_commands_has_failed_and_one_that_misses_some_has_not() {
    let mut refusals = Refusals::default();
    for number in 0..1000 {
        refusals.count(number % 40 == 0).unwrap();
    }
    let (fault, details) = (0..50).find_map(|_| refusals.count(false).err()).unwrap();
    assert_eq!(fault, RosFault::ClientFailed);
    assert_eq!(details, "it did not take 50 commands in a row");
}

//! The complete command line of opspace for robots behind ROS 2 topics.

use opspace_cli::{Extensions, main_with};
use opspace_ros2::Ros2Driver;
use opspace_ros2::node::Participants;
use opspace_ros2::reports::Reports;
use std::process::ExitCode;

#[expect(clippy::print_stderr, reason = "a program says how its runs were")]
fn main() -> ExitCode {
    let (participants, reports) = (Participants::default(), Reports::default());
    let driver = Ros2Driver::new(participants.clone(), reports.clone());
    let exit = main_with(Extensions::default().with_driver(driver));
    for text in reports.take() {
        eprintln!("ros2: {text}");
    }
    participants.clear();
    exit
}

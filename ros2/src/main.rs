//! The complete command line of opspace for robots behind ROS 2 topics.

use opspace_backend::{CommandKind, DriverError, Setting, Settings};
use opspace_cli::clap::{self, Arg, ArgMatches};
use opspace_cli::{Command, Extensions, main_with};
use opspace_ros2::config::NodePlace;
use opspace_ros2::{Program, description, extend};
use std::process::ExitCode;
use std::time::Duration;

/// Longest time to wait for a description.
const LONGEST: Duration = Duration::from_secs(10);

#[expect(clippy::print_stderr, reason = "a program says how its runs were")]
fn main() -> ExitCode {
    let program = Program::default();
    let exit = main_with(extend(Extensions::default(), &program).with(description_command(&program)));
    for text in program.reports.take() {
        eprintln!("ros2: {text}");
    }
    program.participants.clear();
    exit
}

/// Command that writes the URDF of a robot to a file.
#[expect(clippy::print_stderr, reason = "a command says what failed")]
fn description_command(program: &Program) -> Command {
    let option = |name: &'static str, value: &'static str| Arg::new(name).long(name).value_name(value);
    let arguments = clap::Command::new("description")
        .about("Write the URDF that a robot publishes to a file, for `new`")
        .arg(Arg::new("file").value_name("FILE.urdf").required(true).help("The file; it must not exist"))
        .arg(option("topic", "NAME").default_value("/robot_description").help("Topic of the description"))
        .arg(option("domain", "NUMBER").help("Domain; without it that of ROS_DOMAIN_ID, or 0"));
    let program = program.clone();
    Command::new("description", arguments, move |matches, _| match write_description(&program, matches) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    })
}

fn write_description(program: &Program, matches: &ArgMatches) -> Result<(), DriverError> {
    let text = |name: &str| matches.get_one::<String>(name);
    let mut settings = Settings::new(CommandKind::Position, Vec::new(), 0.0);
    if let Some(domain) = text("domain") {
        let number =
            domain.parse().map_err(|_| DriverError::new(format!("--domain is a number, not '{domain}'")))?;
        settings = settings.with("domain", Setting::Number(number));
    }
    let place = NodePlace::from_settings(&settings)?;
    let (Some(file), Some(topic)) = (text("file"), text("topic")) else {
        return Err(DriverError::new("a file and a topic are needed"));
    };
    let urdf = description::receive(&program.participants, &place, topic, LONGEST)?;
    let mut created =
        std::fs::File::create_new(file).map_err(|error| DriverError::new(format!("{file}: {error}")))?;
    std::io::Write::write_all(&mut created, urdf.as_bytes())
        .map_err(|error| DriverError::new(format!("{file}: {error}")))
}

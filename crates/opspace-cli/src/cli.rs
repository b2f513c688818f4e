//! Command-line arguments.

use crate::browser;
use crate::console::Console;
use crate::plant::{PlantChoice, plant_choice, plant_forms};
use crate::shard::{ShardChoice, shard_choice};
use crate::view_address::{Side, ViewAddress, side, view_address};
use clap::builder::{PossibleValue, PossibleValuesParser, StyledStr, TypedValueParser};
use clap::error::{ContextKind, ContextValue};
use clap::{Arg, Args, Parser, Subcommand, ValueEnum};
use clap_complete::Shell;
use opspace_backend::CommandKind;
use opspace_backend::quantity::Positive;
use opspace_experiment::codes::{COMPARISONS, allowed_code};
use opspace_experiment::run::physics::OWN_PLANT;
use opspace_experiment::{Code, ControllerKind, Extensions, RunOptions, TransformerEntry};
use opspace_transformer::TransformerName;
use std::convert::Infallible;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Operational-space control for robots that accept torques, and for robots that accept only positions.
#[derive(Debug, Parser)]
#[command(
    name = "opspace",
    version,
    propagate_version = true,
    subcommand_required = true,
    arg_required_else_help = true,
    after_help = AFTER_HELP
)]
pub struct Cli {
    /// Print more: warnings about the files, and reasons for choices.
    #[arg(short, long, global = true, conflicts_with = "quiet", display_order = 100)]
    pub verbose: bool,

    /// Print less: only results and errors.
    #[arg(short, long, global = true, display_order = 101)]
    pub quiet: bool,
}

const AFTER_HELP: &str = "\
First steps:
  opspace bench                           the experiments of the paper
  opspace run tasks/compliant-x.toml      one of them, with log and report
  opspace new my-arm --urdf my-arm.urdf   a folder for your own robot

Terms:
  position robot   accepts joint positions (velocity robot: velocities; torque robot: torques)
  setpoint         command of a position or velocity servo
  transformer      converts desired joint torques into setpoints
  profile          servo parameters and rates in robot.toml; 1:5 is a setpoint every 5 servo ticks
  osc              operational-space control: joint torques
  ik               inverse kinematics, streamed as joint positions, without torque control
  ik-lead          ik with velocity lead and compensation of gravity sag
  operator         simulated person who pulls the hand by a spring

Exit codes:
  0    done
  1    the run failed: STOPPED or FAILED, or the robot could not be reached; or a replay differs, or
       `check --strict` found a problem, or `doctor` found that something is missing
  2    invalid arguments or an invalid file
  3    done, but data was lost or a log is damaged; or a disk is full
  130  interrupted by a signal, log closed";

/// List the drivers of this program, search for arms, or simulate one behind its protocol.
#[derive(Debug, Parser)]
#[command(name = "driver", subcommand_required = true, arg_required_else_help = true)]
pub struct DriverArgs {
    #[command(subcommand)]
    pub command: DriverCommand,
}

#[derive(Debug, Subcommand)]
pub enum DriverCommand {
    /// List the drivers: names for `[driver]` of robot.toml.
    List,

    /// Search for devices, and print what they are. Nothing is written to them, and no arm moves.
    Scan(DriverScanArgs),

    /// Print the angles of the joints while a person moves the arm, to check signs, zeros and limits. Nothing is commanded.
    #[command(after_help = "\
Ten times a second, each joint has its angle, what its device reports, and a mark if it is outside its limits of the URDF. Move \
one joint after the other: its angle must rise in the direction of its axis in the URDF, and be 0 where the URDF has its zero. An arm \
whose torque is on cannot be moved: --release lowers it and switches its torque off.

Example:
  opspace driver read my-so101")]
    Read(DriverReadArgs),

    /// Simulate the devices of a robot's driver, with the simulated arm of a task behind them, until a signal.
    #[command(after_help = "\
The arm, its friction and the environment of the task are simulated in real time; the devices have registers and answer \
requests as real ones do. Programs of others can use them, too. If the calibration that robot.toml states does not exist, one of \
the simulated arm is written there. Option names that a driver does not know are refused with a list of those that it knows.

Example:
  opspace driver simulate examples/so101/hold-and-yield.toml --link /tmp/so101 --option latency_ms=1
  opspace run examples/so101/hold-and-yield.toml       in another terminal, with port = \"/tmp/so101\" in [driver]")]
    Simulate(DriverSimulateArgs),
}

/// Examine what this machine lacks for real-time control, and print the commands that mend it.
#[derive(Debug, Parser)]
#[command(
    name = "doctor",
    after_help = "\
Examines limits, kernel, clock, processors and serial ports, and measures how late a thread wakes up, without and with real-time \
scheduling. Changes nothing. Items are `ok`, `missing` or, for information, `note`. Only on Linux.

Exit code 0 if nothing is missing, 1 otherwise.

Example: opspace doctor --duration-s 10"
)]
pub struct DoctorArgs {
    /// Duration of each of the two measurements, s; 0 measures nothing.
    #[arg(long, value_name = "S", value_parser = measured_s, default_value = "2", allow_negative_numbers = true)]
    pub duration_s: f64,

    /// Root of the file system to examine, for tests.
    #[arg(long, value_name = "FOLDER", hide = true)]
    pub root: Option<PathBuf>,

    #[command(flatten)]
    pub json: JsonArgs,
}

/// Parses the duration of a measurement.
fn measured_s(text: &str) -> Result<f64, String> {
    const LONGEST_S: f64 = 600.0;
    match text.parse::<f64>() {
        Ok(value) if (0.0..=LONGEST_S).contains(&value) => Ok(value),
        _ => Err(format!("expected a number of seconds from 0 to {LONGEST_S}")),
    }
}

#[derive(Debug, Args)]
pub struct DriverScanArgs {
    /// Port to search, for example /dev/ttyACM0. Without it, all ports are searched.
    pub port: Option<String>,

    /// Search by this driver only.
    #[arg(long, value_name = "NAME")]
    pub driver: Option<String>,
}

#[derive(Debug, Args)]
pub struct DriverReadArgs {
    /// Robot, as its folder or its robot.toml, or a task file.
    pub file: PathBuf,

    /// Robot to use instead of the task's: its folder or its robot.toml.
    #[arg(long)]
    pub robot: Option<PathBuf>,

    /// Lower the arm slowly if its torque is on, and switch its torque off.
    #[arg(long)]
    pub release: bool,

    /// Duration, s [default: until a signal].
    #[arg(long, value_name = "S", value_parser = positive, allow_negative_numbers = true)]
    pub duration_s: Option<f64>,

    /// Override a value of the robot file, or, with a task file, of the task file; with the prefix `robot.`, of its robot file. Can
    /// be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

#[derive(Debug, Args)]
pub struct DriverSimulateArgs {
    /// Task file with the start and the environment of the arm.
    pub task: PathBuf,

    /// Robot to use instead of the task's: its folder or its robot.toml.
    #[arg(long)]
    pub robot: Option<PathBuf>,

    /// Link to the simulated port, which is made at the start and removed at the end.
    #[arg(long, value_name = "PATH")]
    pub link: Option<PathBuf>,

    /// Property or defect of the simulated devices. Can be repeated.
    #[arg(long, value_name = "KEY=VALUE", value_parser = device_option)]
    pub option: Vec<(String, f64)>,

    /// Duration, s [default: until a signal].
    #[arg(long, value_name = "S", value_parser = positive, allow_negative_numbers = true)]
    pub duration_s: Option<f64>,

    /// Seed of all random numbers of the arm, instead of the task's.
    #[arg(long)]
    pub seed: Option<u64>,

    /// Override a value of the task file, or, with the prefix `robot.`, of the robot file. Can be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,

    /// Plant of the simulation, its rigid bodies and contacts.
    #[arg(long, value_name = "PLANT", value_parser = unlisted_plant, default_value = OWN_PLANT)]
    pub plant: PlantChoice,
}

fn device_option(text: &str) -> Result<(String, f64), String> {
    let parsed = text.split_once('=').and_then(|(key, value)| Some((key, value.parse::<f64>().ok()?)));
    match parsed {
        Some((key, value)) if value.is_finite() => Ok((key.to_owned(), value)),
        _ => Err("expected KEY=NUMBER".to_owned()),
    }
}

/// Show what is in a log, recover a damaged one, export one as CSV, or compare two.
#[derive(Debug, Parser)]
#[command(name = "log", subcommand_required = true, arg_required_else_help = true)]
pub struct LogArgs {
    #[command(subcommand)]
    pub command: LogCommand,
}

#[derive(Debug, Subcommand)]
pub enum LogCommand {
    /// List the contents of a log: its run, channels, attachments and metadata, and where damage begins.
    Info(LogInfoArgs),

    /// Write the good part of a damaged log as a complete log.
    #[command(after_help = "\
The good part is everything before the first damage of the rows, and all attachments and metadata that are intact. \
An existing file is never replaced. Exit code 0 if the log was whole, 3 if data was lost.")]
    Recover(LogRecoverArgs),

    /// Write the rows of a channel as a CSV file.
    #[command(after_help = "\
The first line has the names of the columns: time_s, then SIGNAL.ELEMENT_UNIT, for example \
torque_desired.elbow_nm. A signal that does not apply is an empty field.")]
    Export(LogExportArgs),

    /// Compare two logs: every message of every channel, attachments and metadata. Prints the first difference of each.
    #[command(after_help = "\
Exit code 0 if the logs are equal, 1 if they differ. Wall-clock times are in the channel /opspace/timing \
(computing times), differ from run to run, and do not count: two simulations of the same files and seed are \
equal. A damaged log is compared up to the damage, without the attachments that it lost; the exit code is 3 if no \
difference is found.")]
    Diff(LogDiffArgs),
}

#[derive(Debug, Args)]
pub struct LogInfoArgs {
    /// A log (run.mcap) or the folder of a run.
    pub log: PathBuf,

    #[command(flatten)]
    pub json: JsonArgs,
}

#[derive(Debug, Args)]
pub struct LogRecoverArgs {
    /// A log (run.mcap) or the folder of a run.
    pub log: PathBuf,

    /// The new log.
    #[arg(short, long, value_name = "NEW.mcap")]
    pub out: PathBuf,

    #[command(flatten)]
    pub json: JsonArgs,
}

#[derive(Debug, Args)]
pub struct LogExportArgs {
    /// A log (run.mcap) or the folder of a run.
    pub log: PathBuf,

    /// The CSV file; `-` prints the rows.
    #[arg(short, long, value_name = "FILE.csv")]
    pub out: PathBuf,

    /// Name of the channel.
    #[arg(long, value_name = "NAME", default_value = "tick", conflicts_with = "path")]
    pub channel: String,

    /// Export the measured path of this task's frame in place of a channel, in the form of `reference.recorded`.
    #[arg(long, value_name = "TASK")]
    pub path: Option<String>,

    /// Time between two samples of the path, s.
    #[arg(long, value_name = "S", default_value_t = 0.05, requires = "path")]
    pub every_s: f64,

    /// Replace an existing CSV file.
    #[arg(long)]
    pub force: bool,
}

#[derive(Debug, Args)]
pub struct LogDiffArgs {
    /// A log (run.mcap) or the folder of a run.
    pub first: PathBuf,

    /// Another one.
    pub second: PathBuf,

    #[command(flatten)]
    pub json: JsonArgs,
}

/// Output of results for other programs.
#[derive(Debug, Args)]
pub struct JsonArgs {
    /// Write the results as JSON to this file; `-` prints JSON instead of the text.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Display of the report.
#[derive(Debug, Args)]
pub struct OpenArgs {
    /// Open the report in a browser when it is written.
    #[arg(long)]
    pub open: bool,
}

impl OpenArgs {
    /// Opens the page, if requested and written.
    pub fn show(&self, page: &Path, console: Console) {
        if self.open && page.is_file() {
            browser::open(page, console);
        }
    }
}

/// Live view of a run.
#[derive(Debug, Args)]
pub struct ViewArgs {
    /// Show the run in a browser while it takes place, in real time, and pull a simulated robot by hand. The page is at ADDRESS: a port,
    /// or HOST:PORT [default: 127.0.0.1:8765]. Only this computer reaches the page, unless the host is another one; the page then has a
    /// token. The run begins when a page connects. The view remains until Ctrl-C, or until no page is connected.
    #[arg(
        long,
        value_name = "ADDRESS",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "",
        value_parser = view_address,
        conflicts_with = "log"
    )]
    pub view: Option<ViewAddress>,

    /// With --view: pages of this other origin may connect and pull the robot too, for example https://app.foxglove.dev. Can be repeated.
    #[arg(long, value_name = "ORIGIN", requires = "view")]
    pub view_origin: Vec<String>,
}

/// Show a log in a browser, as a run is shown with `opspace run --view`: play it, go to any time, slow it down.
#[derive(Debug, Parser)]
#[command(
    name = "view",
    after_help = "\
In the folder of an experiment with several robots, shows all of them. The view remains until Ctrl-C."
)]
pub struct ViewLogArgs {
    /// A log (run.mcap) or the folder of a run, or that of several robots.
    pub log: PathBuf,

    /// Address of the page: a port, or HOST:PORT [default: 127.0.0.1:8765]. Only this computer reaches the page, unless the host is
    /// another one; the page then has a token.
    #[arg(long, value_name = "ADDRESS", value_parser = view_address)]
    pub at: Option<ViewAddress>,

    /// Pages of this other origin may connect too, for example https://app.foxglove.dev. Can be repeated.
    #[arg(long, value_name = "ORIGIN")]
    pub view_origin: Vec<String>,
}

/// Refusals that the user allows.
#[derive(Debug, Args)]
pub struct AllowArgs {
    /// Turn a refusal with this code into a warning, which all results carry. Can be repeated. `opspace explain` lists the
    /// codes.
    #[arg(long, value_name = "CODE", value_parser = allowed_code)]
    pub allow: Vec<Code>,
}

/// Output folder of results, and their JSON.
#[derive(Debug, Args)]
pub struct OutputArgs {
    #[command(flatten)]
    pub json: JsonArgs,

    /// Write into this folder.
    #[arg(short, long, value_name = "DIR")]
    pub out: Option<PathBuf>,

    /// Replace an existing run in the folder given with --out.
    #[arg(long)]
    pub force: bool,
}

/// Robot of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BackendChoice {
    /// A robot with this interface, simulated unless robot.toml names a driver.
    Interface(CommandKind),
    /// The robot of a log.
    Replay,
}

/// Interface and controller of the robot of a task.
#[derive(Debug, Args)]
pub struct ControlArgs {
    /// Robot interface to simulate [default: the one stated in robot.toml].
    #[arg(long, value_parser = commands())]
    pub backend: Option<CommandKind>,

    /// Controller of the robot.
    #[arg(long, value_parser = controllers(), default_value = ControllerKind::Osc.name())]
    pub controller: ControllerKind,
}

/// Run one task on a robot and report its metrics.
#[derive(Debug, Parser)]
#[command(
    name = "run",
    after_help = "\
Examples:
  opspace run tasks/compliant-x.toml
  opspace run tasks/compliant-x.toml --backend torque
  opspace run tasks/cartesian-tracking.toml --controller ik-lead --profile b-soft
  opspace run tasks/compliant-x.toml --set task.hand.cartesian.gains.damping_ratio=0.7
  opspace run tasks/compliant-x.toml --set robot.simulated.true_over_nominal.kp=1.02
  opspace run tasks/gravity-compensation.toml --backend replay --log runs/compliant-x-asimo-arm-position
  opspace run tasks/panda-reach.toml --plant mujoco
  opspace run tasks/panda-reach.toml --open
  opspace run tasks/compliant-x.toml --view
  opspace run tasks/compliant-x.toml --view --beside torque --beside ik
  opspace run tasks/experiments/teleop-wall.toml --set leader.task.hand.coupled.damping_ns_per_m=8

Writes run.mcap (all signals; opens in Foxglove and PlotJuggler), report.html and summary.json into \
runs/TASK-ROBOT-BACKEND. An existing run is renamed to NAME.previous, the next one to NAME.previous-2, and so on.

An experiment with several robots writes report.html and summary.json, and a folder for each robot, into \
runs/EXPERIMENT."
)]
pub struct RunArgs {
    /// The task file, or the file of an experiment with several robots.
    pub task: PathBuf,

    /// Robot to use instead of the task's: its folder or its robot.toml.
    #[arg(long)]
    pub robot: Option<PathBuf>,

    /// Robot interface to simulate, or the robot of a log [default: the interface stated in robot.toml].
    #[arg(long, value_parser = backends())]
    pub backend: Option<BackendChoice>,

    /// With `--backend replay`: the log (run.mcap) or the folder of a run. The task gets its measurements, and the robot and
    /// its interface are those of the log.
    #[arg(long, value_name = "LOG", conflicts_with_all = ["plant", "simulate", "move_to_start"])]
    pub log: Option<PathBuf>,

    /// Controller of the robot.
    #[arg(long, value_parser = controllers(), default_value = ControllerKind::Osc.name())]
    pub controller: ControllerKind,

    /// Transformer, which converts desired torques into setpoints [default: that of the profile, otherwise the best one
    /// for the declared interface].
    #[arg(long, value_parser = unlisted)]
    pub transformer: Option<TransformerName>,

    /// Profile of the robot in place of its default one.
    #[arg(long)]
    pub profile: Option<String>,

    /// Seed of all random numbers, instead of the task's.
    #[arg(long)]
    pub seed: Option<u64>,

    /// Duration, s, instead of the task's.
    #[arg(long, value_name = "S", value_parser = positive, allow_negative_numbers = true)]
    pub duration_s: Option<f64>,

    /// Override a value of the task file, or, with the prefix `robot.`, of the robot file. Can be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,

    /// Simulate the robot although its file names a driver.
    #[arg(long)]
    pub simulate: bool,

    /// Plant of the simulation, its rigid bodies and contacts.
    #[arg(long, value_name = "PLANT", value_parser = unlisted_plant, default_value = OWN_PLANT, conflicts_with = "move_to_start")]
    pub plant: PlantChoice,

    #[command(flatten)]
    pub view: ViewArgs,

    /// With --view: the same task also on a robot with this interface, or with this controller, in the same view: position, velocity,
    /// torque, ik or ik-lead. The hand pulls all of them. Can be repeated.
    #[arg(long, value_name = "ROBOT", value_parser = side, requires = "view", conflicts_with = "log")]
    pub beside: Vec<Side>,

    #[command(flatten)]
    pub allow: AllowArgs,

    #[command(flatten)]
    pub open: OpenArgs,

    /// First move a real robot to the task's start_rad, along a straight line in joint space at up to 0.2 rad/s.
    /// Obstacles are not avoided: keep the workspace clear.
    #[arg(long, conflicts_with = "simulate")]
    pub move_to_start: bool,

    #[command(flatten)]
    pub output: OutputArgs,
}

impl RunArgs {
    /// Options of the run except for the command interface.
    pub fn options(&self) -> RunOptions {
        RunOptions {
            controller: self.controller,
            transformer: self.transformer.clone(),
            profile: self.profile.clone(),
            seed: self.seed,
            duration_s: self.duration_s,
            allow: self.allow.allow.clone(),
            ..RunOptions::default()
        }
    }
}

fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("expected a number of seconds above 0".to_owned()),
    }
}

/// Run every task of a suite on each robot and controller that it names, and print one table.
#[derive(Debug, Parser)]
#[command(
    name = "bench",
    after_help = "\
Without SUITE, runs the experiments of the paper, which are built into the program. The table lists medians \
over the seeds of a row; --json and --csv list every run. Writes report.html, bench.json, rows.jsonl (one line per \
run, as soon as it is complete) and the log of the first run of each task into runs/bench-SUITE. The same command \
continues a suite that was cut off, and repeats only the runs that were cut.

With --baseline, each metric is compared with that of the same runs in an earlier bench.json: it is worse (exit \
code 1) if the 95 % confidence interval of the mean difference over the seeds (Student's t) excludes zero and the \
mean differs by more than 1 %. With one seed, only the 1 % counts.

With --shard I/N, every Nth run is executed, beginning with the Ith, into the folder shard-I-of-N of --out; \
`opspace merge` joins the folders. `auto` reads the part from a Slurm array; `auto/N`, with indices from 0, from \
Slurm or a Kubernetes job. A part that is complete is not run again.

Examples:
  opspace bench tasks/suites/limits.toml --csv limits.csv
  opspace bench --baseline runs/bench.previous/bench.json
  opspace bench tasks/suites/limits.toml --plants own,mujoco
  opspace bench tasks/suites/limits.toml --shard 1/3 --out runs/limits"
)]
pub struct BenchArgs {
    /// The suite file [default: the experiments of the paper].
    pub suite: Option<PathBuf>,

    /// Number of simultaneous runs [default: one per processor].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub jobs: Option<u16>,

    /// Plants on which each run is executed, separated by commas.
    #[arg(long, value_name = "PLANTS", value_parser = unlisted_plant, value_delimiter = ',', default_value = OWN_PLANT)]
    pub plants: Vec<PlantChoice>,

    /// Run only one part of the suite: I/N, `auto` or `auto/N`.
    #[arg(long, value_name = "I/N", value_parser = shard_choice)]
    pub shard: Option<ShardChoice>,

    #[command(flatten)]
    pub allow: AllowArgs,

    #[command(flatten)]
    pub open: OpenArgs,

    #[command(flatten)]
    pub results: SuiteOutputArgs,
}

/// Output of the results of a suite.
#[derive(Debug, Args)]
pub struct SuiteOutputArgs {
    #[command(flatten)]
    pub output: OutputArgs,

    /// Write the results as CSV to this file, one row per run; `-` prints CSV instead of the text.
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,

    /// Compare with these results of an earlier `opspace bench`; exit code 1 if a metric is worse.
    #[arg(long, value_name = "FILE")]
    pub baseline: Option<PathBuf>,
}

/// Join the results of all shards of a suite to those of the whole suite.
#[derive(Debug, Parser)]
#[command(
    name = "merge",
    after_help = "\
SHARD is a folder that `opspace bench --shard` wrote, or a folder of such folders. The results equal those of the \
whole suite in one process, except for computing times. Shards of different suites or versions are refused; missing \
runs are listed (exit code 3).

Example:
  opspace merge runs/limits --json limits.json"
)]
pub struct MergeArgs {
    /// Folders of shards, or folders of such folders.
    #[arg(required = true)]
    pub shards: Vec<PathBuf>,

    #[command(flatten)]
    pub results: SuiteOutputArgs,
}

/// Recompute every command of a log from its measurements and compare it with what was logged.
#[derive(Debug, Parser)]
#[command(
    name = "replay",
    after_help = "\
If any bit differs, prints the first tick and joint with both values (exit code 1). A damaged log is compared up \
to the damage (exit code 3 if that part is equal). With --task or --set, computes the commands of other files \
from the same measurements, and says where and why this ends; it is open loop, since the motion of the robot is the \
logged one. --report plots the torques.

In the folder of an experiment with several robots, the log of each robot is compared alone."
)]
pub struct ReplayArgs {
    /// A log (run.mcap) or the folder of a run, or that of an experiment with several robots.
    pub log: PathBuf,

    /// Another task, run on the same measurements: a run with log, summary and page.
    #[arg(long, value_name = "FILE")]
    pub task: Option<PathBuf>,

    /// Another controller, run on the same measurements.
    #[arg(long, value_parser = controllers())]
    pub controller: Option<ControllerKind>,

    /// Another transformer, run on the same measurements.
    #[arg(long, value_parser = unlisted)]
    pub transformer: Option<TransformerName>,

    /// Override a value of the task file, or, with the prefix `robot.`, of the robot file. Can be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,

    /// Simulate the run of the log again, from its files and seed, its targets and the external forces on the robot, and compare every
    /// message of the two logs.
    #[arg(long, conflicts_with_all = ["task", "controller", "transformer", "set", "report"])]
    pub simulate: bool,

    /// With one of these: also write a page with the logged and the recomputed torques and their difference.
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,

    #[command(flatten)]
    pub open: OpenArgs,

    #[command(flatten)]
    pub output: OutputArgs,
}

/// Make one HTML page with the figures and the table of one or more logs.
#[derive(Debug, Parser)]
#[command(
    name = "report",
    after_help = "\
In the folder of an experiment with several robots, makes the page about all of them."
)]
pub struct ReportArgs {
    /// Logs (run.mcap) or folders of runs, or the folder of an experiment with several robots.
    #[arg(required = true)]
    pub logs: Vec<PathBuf>,

    /// Write the page to this file [default: report.html in the folder of the first log].
    #[arg(short, long, value_name = "FILE")]
    pub out: Option<PathBuf>,

    #[command(flatten)]
    pub open: OpenArgs,

    #[command(flatten)]
    pub json: JsonArgs,
}

/// Check robot, task and suite files, against each other too, without running anything.
#[derive(Debug, Parser)]
#[command(
    name = "check",
    after_help = "\
A mistake in a file is an error (exit code 2). Predicted problems of a run are diagnostics, not errors; each has \
its place, numbers and a remedy: goals out of reach, speeds beyond the joint limits, gains too high for the rate and the \
servo, contradictory limits, a singular start, degrees of freedom without a task, a run that is too short. They are printed \
to standard output below the line of their file; --json lists them as `findings`, and warnings about models as `warnings`. \
With --strict, any of them gives exit code 1. The code in brackets has a page: `opspace explain CODE`.

--backend and --controller are those of `opspace run`, for task files. The runs of a suite and the robots of an experiment \
state their own.

The file of an experiment with several robots is checked with all files that it names.

Examples:
  opspace check tasks/compliant-x.toml
  opspace check tasks/compliant-x.toml --controller ik
  opspace check tasks/*.toml --strict > problems.txt"
)]
pub struct CheckArgs {
    /// Robot folders, and robot, task, suite, experiment and URDF files.
    #[arg(required = true)]
    pub files: Vec<PathBuf>,

    /// Robot to use instead of the task's: its folder or its robot.toml.
    #[arg(long)]
    pub robot: Option<PathBuf>,

    #[command(flatten)]
    pub control: ControlArgs,

    /// Transformer, which converts desired torques into setpoints [default: that of `run`].
    #[arg(long, value_parser = unlisted)]
    pub transformer: Option<TransformerName>,

    /// Override a value of task and experiment files, or, with the prefix `robot.`, of the robot file. Can be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,

    /// Check a simulation, like `run --simulate`: leave `[driver]` of robot.toml out.
    #[arg(long)]
    pub simulate: bool,

    /// End with exit code 1 if a problem is found in a valid file.
    #[arg(long)]
    pub strict: bool,

    #[command(flatten)]
    pub allow: AllowArgs,

    #[command(flatten)]
    pub json: JsonArgs,
}

/// Explain a code that `check`, `run` or a warning prints.
#[derive(Debug, Parser)]
#[command(
    name = "explain",
    after_help = "\
The page of a code says what it means, why it matters and what to do, with an example. Without CODE, lists all codes.

Example: opspace explain singular-start"
)]
pub struct ExplainArgs {
    /// The code, as printed in brackets.
    #[arg(value_parser = Code::from_str)]
    pub code: Option<Code>,
}

/// Identify a robot's servos by moving its joints: gains, filter, delay, inertia, friction.
#[derive(Debug, Parser)]
#[command(
    name = "identify",
    after_help = "\
Excites one joint at a time about its current position, while the others are held. Inputs are the structure of the \
servo, the rates, limits, URDF and rotor inertias; gains, filter, delay and friction are estimated. The scale of torque \
comes from motor current if the robot measures it, otherwise from URDF and rotor inertia. With neither, only ratios are \
written and torque control is refused (exit code 1), as for a joint whose servo cannot be inverted.

PID servos without damping, or without measured motor current, are identified statically: each joint moves slowly through its \
range, and its offsets under the weight of the arm show stiffness and friction. The motions are printed beforehand.

Writes servo.toml (the identified keys of robot.toml), robot.toml with a copy of the URDF (a complete robot with these \
keys), identification.json and report.html (figures) into runs/identify-ROBOT.

Examples:
  opspace identify robots/asimo-arm
  opspace identify robots/asimo-arm --profile b-soft --joint elbow --start-rad elbow=-1.35
  opspace identify so101 --hang tip=0.15"
)]
pub struct IdentifyArgs {
    /// The robot's folder or its robot.toml.
    pub robot: PathBuf,

    /// Identify only this joint.
    #[arg(long)]
    pub joint: Option<String>,

    /// Profile of the robot in place of its default one.
    #[arg(long)]
    pub profile: Option<String>,

    /// Joint positions during the identification of a simulated robot, rad or m [default: the start of first-task.toml beside
    /// robot.toml, or the middle of each range]. A real robot begins where it is.
    #[arg(long, value_name = "JOINT=VALUE", value_delimiter = ',', value_parser = joint_value)]
    pub start_rad: Vec<(String, f64)>,

    /// Repeat the identification of servos without a velocity loop with a weight of this mass (kg) on a link or tool, and compare.
    #[arg(long, value_name = "FRAME=KG", value_parser = hung_weight)]
    pub hang: Option<(String, Positive)>,

    /// Identify a simulated robot although its file names a driver.
    #[arg(long)]
    pub simulate: bool,

    /// Seed of the excitation's phases and of all random numbers in the simulation.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,

    /// Override a value of the robot file: `robot.key=value`. Can be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,

    #[command(flatten)]
    pub output: OutputArgs,
}

fn hung_weight(text: &str) -> Result<(String, Positive), String> {
    let wrong = || "expected a link or tool and a mass above zero in kg, for example tip=0.2".to_owned();
    let (frame, mass_kg) = text.split_once('=').ok_or_else(wrong)?;
    let mass_kg: f64 = mass_kg.trim().parse().map_err(|_| wrong())?;
    Ok((frame.trim().to_owned(), Positive::try_from(mass_kg).map_err(|_| wrong())?))
}

fn joint_value(text: &str) -> Result<(String, f64), String> {
    let wrong = || "expected a joint name and a number, for example elbow=-1.35".to_owned();
    let (name, value) = text.split_once('=').ok_or_else(wrong)?;
    let value: f64 = value.trim().parse().map_err(|_| wrong())?;
    if value.is_finite() { Ok((name.trim().to_owned(), value)) } else { Err(wrong()) }
}

/// Print a robot's joints and frames, or compute its kinematics and dynamics at given states.
#[derive(Debug, Parser)]
#[command(
    name = "model",
    after_help = "\
Prints joints, bodies and frames, and for one posture: the poses of all frames, the condition of the Jacobian of a frame, \
the torques that hold the weight, and the effective masses of the frame.

Each line of the samples is one state:
  {\"q\":[..],\"dq\":[..],\"ddq\":[..],\"tau_in\":[..],\"f_tip\":[fx,fy,fz,mx,my,mz]}

Each line of the output holds tip_R, tip_p, tip_vel, J, Jdot_dq, M, g, nle, C, tau_rnea, ddq_aba, \
tau_rnea_fext, ddq_aba_fext, com, kinetic_energy, potential_energy, Lambda, Jbar, N: in world axes at the tip, \
linear rows first; matrices row by row; joints in the order of the table. With \"task_rows\":[0,1,2], Lambda, \
Jbar and N are those of these rows; they are null if the task is rank-deficient.

Examples:
  opspace model robots/panda
  opspace model robots/panda --q joint4=-1.2 --frame flange
  opspace model robots/planar-2-link --q 0.6,1.2"
)]
pub struct ModelArgs {
    /// A robot folder, its robot.toml, or a URDF file.
    pub robot: PathBuf,

    /// Frame for which the samples are computed.
    #[arg(long, value_name = "FRAME", requires = "samples")]
    pub tip: Option<String>,

    /// States as JSON lines; `-` reads standard input.
    #[arg(long, value_name = "FILE", requires = "tip")]
    pub samples: Option<PathBuf>,

    /// Print the capsules with which the robot avoids collisions, in the form of robot.toml; those that are generated if
    /// it lists none.
    #[arg(long, conflicts_with_all = ["samples", "json"])]
    pub capsules: bool,

    /// Joint positions, rad or m, of the posture for which frames, Jacobian, weight and effective masses are printed: all in the
    /// order of the table, or by name (`elbow=1.2,wrist=0.5`) [default: the start of first-task.toml beside robot.toml, or the middle of
    /// each range].
    #[arg(long, value_name = "VALUES", value_delimiter = ',', allow_hyphen_values = true, conflicts_with_all = ["samples", "capsules"])]
    pub q: Vec<String>,

    /// Find a posture in which the frame is at this place of the world: x, y, z (m), or x, y, z, roll, pitch, yaw (m, rad). It is
    /// printed as `start_rad` of a task.
    #[arg(long, value_name = "POSE", value_delimiter = ',', allow_hyphen_values = true, conflicts_with_all = ["samples", "capsules", "q", "floating"])]
    pub at: Vec<f64>,

    /// Frame for which Jacobian and effective masses are printed, and which --at places [default: the tip].
    #[arg(long, value_name = "FRAME", conflicts_with_all = ["samples", "capsules"])]
    pub frame: Option<String>,

    /// Add a floating base: q begins with its position and quaternion x, y, z, w. Only for a URDF.
    #[arg(long)]
    pub floating: bool,

    /// Enforce the constraints of mimic joints, which otherwise move independently. Only for a URDF.
    #[arg(long)]
    pub enforce_mimic: bool,

    #[command(flatten)]
    pub json: JsonArgs,
}

/// Make a robot folder for your own robot from its URDF.
#[derive(Debug, Parser)]
#[command(
    name = "new",
    after_help = "\
The new robot.toml lists every required value as a comment with its meaning; no value is guessed unless --assume is given. \
`opspace check DIR` lists all missing values. The folder also contains a first task, first-task.toml: the tip moves some \
centimetres and returns.

A template has the values of a common arm, each with its source; joints that it does not have, those of a gripper for example, \
are locked. It is for a URDF with the axes, ranges and masses of that arm. `opspace new --like` lists the templates.

Examples:
  opspace new my-ur5 --urdf ur5.urdf --like ur5
  opspace new left-arm --urdf robot.urdf --from torso --to left_gripper --assume"
)]
pub struct NewArgs {
    /// The folder to create.
    #[arg(required_unless_present = "like", requires = "urdf")]
    pub dir: Option<PathBuf>,

    /// The robot's URDF; it is copied into the folder.
    #[arg(long, value_name = "FILE", requires = "dir")]
    pub urdf: Option<PathBuf>,

    /// Fill in the values of a common arm, each with its source: the robot can be simulated at once. Without a name, list the
    /// templates.
    #[arg(long, value_name = "ARM", num_args = 0..=1, conflicts_with = "assume")]
    pub like: Option<Option<String>>,

    /// As --assume, with the interface and the rates of a common arm, for another arm with the same controller. All values are marked as
    /// assumed.
    #[arg(long, value_name = "ARM", conflicts_with_all = ["assume", "like"])]
    pub like_anyway: Option<String>,

    /// Fill in assumed values of the drives, computed from the URDF and marked as assumed, and of the masses that it does not state:
    /// the robot can be simulated at once.
    #[arg(long)]
    pub assume: bool,

    /// Mass of the whole arm with its base, kg, if the URDF does not state the masses of its links.
    #[arg(long, value_name = "KG", value_parser = positive, allow_negative_numbers = true, requires = "assume")]
    pub mass: Option<f64>,

    /// Payload that the assumed drives can carry, kg; a tenth of the mass that moves if not given.
    #[arg(long, value_name = "KG", value_parser = positive, allow_negative_numbers = true, requires = "assume")]
    pub payload: Option<f64>,

    /// First link of the chain that is used; joints elsewhere do not move. The root link if only --to is given.
    #[arg(long, value_name = "LINK", requires = "to")]
    pub from: Option<String>,

    /// Last link of the chain that is used: the tip of the first task.
    #[arg(long, value_name = "LINK")]
    pub to: Option<String>,

    /// Place of the base in the world: x, y, z (m), or x, y, z, roll, pitch, yaw (m, rad): 0,0,0,3.141593,0,0 hangs the arm from a
    /// ceiling, 0,0,0,0,1.570796,0 mounts it on a wall, with its z axis along x of the world.
    #[arg(long, value_name = "POSE", value_delimiter = ',', allow_hyphen_values = true, requires = "dir")]
    pub mount: Vec<f64>,
}

/// Print the JSON Schema of a kind of file, for editors, or a page with all its keys.
#[derive(Debug, Parser)]
#[command(name = "schema")]
pub struct SchemaArgs {
    /// Kind of file.
    #[arg(value_enum)]
    pub kind: SchemaKind,

    /// Print a Markdown page with all keys instead.
    #[arg(long)]
    pub markdown: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum SchemaKind {
    /// A robot file (robot.toml).
    Robot,
    /// A task file.
    Task,
    /// A suite file.
    Suite,
    /// The file of an experiment with several robots.
    Experiment,
}

/// Adds the names of transformers and plants to the arguments of a program with these extensions.
pub fn with_names(program: clap::Command, extensions: &Extensions) -> clap::Command {
    let transformers = Transformers::of(extensions);
    let command = ["run", "replay", "check"].into_iter().fold(program, |command, name| {
        command.mut_subcommand(name, |command| {
            command.mut_arg("transformer", |argument| argument.value_parser(transformers.clone()))
        })
    });
    let plants = plant_forms(extensions);
    let with_plants = |command: clap::Command, argument: &str| {
        let list = plants.iter().map(|(form, description)| format!("\n- {form}: {description}"));
        let list: String = list.collect();
        let forms: Vec<String> = plants.iter().map(|(form, _)| form.clone()).collect();
        command.mut_arg(argument, |argument| {
            let help = format!("{}:{list}", argument.get_help().unwrap_or(&StyledStr::new()));
            argument.help(help).value_parser(move |text: &str| plant_choice(text, &forms))
        })
    };
    command
        .mut_subcommand("run", |command| with_plants(command, "plant"))
        .mut_subcommand("bench", |command| with_plants(command, "plants"))
        .mut_subcommand("driver", |command| {
            command.mut_subcommand("simulate", |command| with_plants(command, "plant"))
        })
}

/// Parser of names whose table only the program knows: [`with_names`] replaces it.
fn unlisted(name: &str) -> Result<TransformerName, Infallible> {
    Ok(name.to_owned().into())
}

/// Parser of plants before [`with_names`] replaces it.
fn unlisted_plant(text: &str) -> Result<PlantChoice, String> {
    plant_choice(text, &[OWN_PLANT.to_owned()])
}

/// Parser of the names of a program's transformers.
#[derive(Clone)]
struct Transformers(PossibleValuesParser);

impl Transformers {
    fn of(extensions: &Extensions) -> Self {
        let value = |entry: &TransformerEntry| {
            PossibleValue::new(entry.transformer_name().to_string()).help(entry.description())
        };
        Self(PossibleValuesParser::new(extensions.all::<TransformerEntry>().map(value)))
    }
}

impl TypedValueParser for Transformers {
    type Value = TransformerName;

    fn parse_ref(
        &self,
        command: &clap::Command,
        argument: Option<&Arg>,
        value: &OsStr,
    ) -> Result<TransformerName, clap::Error> {
        let unknown = |mut error: clap::Error| {
            let place = format!("transformers for comparisons {COMPARISONS}").into();
            error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![place]));
            error
        };
        self.0.parse_ref(command, argument, value).map(TransformerName::from).map_err(unknown)
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        self.0.possible_values()
    }
}

/// Command interfaces with their descriptions.
fn interfaces() -> impl Iterator<Item = PossibleValue> {
    CommandKind::ALL.into_iter().map(|kind| {
        PossibleValue::new(kind.name()).help(match kind {
            CommandKind::Position => {
                "Robot that accepts joint positions; the transformer converts torques into them"
            }
            CommandKind::Velocity => {
                "Robot that accepts joint velocities; the transformer converts torques into them"
            }
            CommandKind::Torque => "Robot that accepts joint torques",
        })
    })
}

fn interface(name: &str) -> Option<CommandKind> {
    CommandKind::ALL.into_iter().find(|kind| kind.name() == name)
}

/// Parser of command interfaces.
fn commands() -> impl TypedValueParser<Value = CommandKind> {
    PossibleValuesParser::new(interfaces()).try_map(|name| interface(&name).ok_or("unknown"))
}

/// Parser of the robot of a run.
fn backends() -> impl TypedValueParser<Value = BackendChoice> {
    const REPLAY: &str = "replay";
    let replay = PossibleValue::new(REPLAY).help("Robot of a log (--log): its measurements are given");
    let named = |name: String| match interface(&name) {
        Some(kind) => Ok(BackendChoice::Interface(kind)),
        None if name == REPLAY => Ok(BackendChoice::Replay),
        None => Err("unknown"),
    };
    PossibleValuesParser::new(interfaces().chain([replay])).try_map(named)
}

/// Parser of controller names.
fn controllers() -> impl TypedValueParser<Value = ControllerKind> {
    let values = ControllerKind::ALL.map(|kind| PossibleValue::new(kind.name()).help(kind.description()));
    let named =
        |name: String| ControllerKind::ALL.into_iter().find(|kind| kind.name() == name).ok_or("unknown");
    PossibleValuesParser::new(values).try_map(named)
}

/// Print the completion script of a shell.
#[derive(Debug, Parser)]
#[command(
    name = "completion",
    after_help = "For bash:  opspace completion bash > ~/.local/share/bash-completion/completions/opspace"
)]
pub struct CompletionArgs {
    /// Shell of the script.
    pub shell: Shell,
}

//! The command-line arguments, and nothing else.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, Parser, Subcommand, ValueEnum};
use clap_complete::Shell;
use opspace_experiment::{BackendKind, ControllerKind, RunOptions};
use opspace_transformer::TransformerKind;
use std::path::PathBuf;

/// Operational-space control for robots that take torques, and for robots that take only positions.
#[derive(Debug, Parser)]
#[command(version, propagate_version = true, after_help = AFTER_HELP)]
pub struct Cli {
    #[command(subcommand)]
    pub command: Command,

    /// Say more: warnings about the files.
    #[arg(short, long, global = true, conflicts_with = "quiet")]
    pub verbose: bool,

    /// Say less: results and errors only.
    #[arg(short, long, global = true)]
    pub quiet: bool,
}

const AFTER_HELP: &str = "\
Begin with:
  opspace bench                           the paper's experiments
  opspace run tasks/compliant-x.toml      one of them, with its log and report
  opspace new my-arm --urdf my-arm.urdf   a folder for your own robot

Exit codes:
  0    done
  1    the run failed: a fault, a divergence, a difference found
  2    bad arguments or a bad file
  3    done, but data was lost or a log is damaged
  130  interrupted, log closed";

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run one task on a robot and report its metrics.
    #[command(after_help = "\
Examples:
  opspace run tasks/compliant-x.toml
  opspace run tasks/compliant-x.toml --backend torque
  opspace run tasks/cartesian-tracking.toml --controller ik-lead --profile b-soft
  opspace run tasks/compliant-x.toml --set task.hand.gains.damping_ratio=0.7
  opspace run tasks/compliant-x.toml --set robot.simulated.true_over_nominal.kp=1.02

Writes run.mcap (every signal; opens in Foxglove and PlotJuggler), report.html and summary.json into \
runs/TASK-BACKEND. A run that is there already is moved aside.")]
    Run(RunArgs),

    /// Run every task of a suite on every robot and controller it names, and print one table.
    #[command(after_help = "\
Without SUITE the experiments of the paper are run; they are part of the program. The table gives medians \
over the seeds of a row; --json gives every run. Writes report.html, bench.json and the log of each task's \
first run into runs/bench.")]
    Bench(BenchArgs),

    /// Recompute every command of a log from its measurements and compare it with what was logged.
    #[command(after_help = "\
Says the first tick, joint and both values if any bit differs (exit code 1). A damaged log is compared as far \
as it is good (exit code 3 if that is equal). With --task another task is computed on the same measurements: \
what it would have commanded, open loop, since the robot's motion is the logged one.")]
    Replay(ReplayArgs),

    /// Make one HTML page with the figures and the table of one or more logs.
    Report(ReportArgs),

    /// Check robot, task and suite files, against each other too, without running anything.
    #[command(after_help = "\
What is wrong in a file is an error (exit code 2). What will go wrong when a task runs is said with its line, its \
numbers and a remedy, and is no error: goals and speeds beyond the arm, gains beyond the rate and the servo, limits \
that contradict each other, a singular start, freedom that nothing damps, a run that is too short. --json has it as \
`findings`.")]
    Check(CheckArgs),

    /// Identify a robot's servos by moving its joints: gains, filter, delay, inertia, friction.
    #[command(after_help = "\
Inputs are the structure of the servo, the rates, limits, URDF and rotors; gains, filter, delay and friction are estimated. \
The scale of torque comes from the motors' current where the robot measures it, else from URDF and rotor inertia; without \
either only ratios are written and torque mode is refused (exit code 1), as it is for a joint that can't be inverted.

Writes servo.toml (the keys of robot.toml that were found), robot.toml with a copy of the URDF (the whole robot with \
them), identification.json and report.html (Bode plots) into runs/identify-ROBOT.

Examples:
  opspace identify robots/asimo-arm
  opspace identify robots/asimo-arm --profile b-soft --joint elbow --start-rad elbow=-1.35")]
    Identify(IdentifyArgs),

    /// Print a robot's joints and frames, or compute its kinematics and dynamics at given states.
    #[command(after_help = "\
Each line of the samples is a state:
  {\"q\":[..],\"dq\":[..],\"ddq\":[..],\"tau_in\":[..],\"f_tip\":[fx,fy,fz,mx,my,mz]}

Each line of the output holds tip_R, tip_p, tip_vel, J, Jdot_dq, M, g, nle, C, tau_rnea, ddq_aba, \
tau_rnea_fext, ddq_aba_fext, com, kinetic_energy, potential_energy, Lambda, Jbar, N. World axes at the tip, \
linear rows first; matrices row by row; joints in the order of the table. With \"task_rows\":[0,1,2] Lambda, \
Jbar and N are of those rows; they are null where the task is rank-deficient.")]
    Model(ModelArgs),

    /// Make a robot folder for your own robot from its URDF.
    #[command(after_help = "\
The new robot.toml lists every value that must be known, commented out with what it means: none is guessed. \
`opspace check DIR` names the next one missing. A first task, hold.toml, is beside it.")]
    New(NewArgs),

    /// Print the JSON Schema of a kind of file, for editors.
    Schema(SchemaArgs),

    /// Print the completion script of a shell.
    #[command(
        after_help = "For bash:  opspace completion bash > ~/.local/share/bash-completion/completions/opspace"
    )]
    Completion {
        /// Shell of the script.
        shell: Shell,
    },
}

/// Output of results for other programs.
#[derive(Debug, Args)]
pub struct JsonArgs {
    /// Write the results as JSON to this file; `-` prints them instead of the text.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Output folder of results, and their JSON.
#[derive(Debug, Args)]
pub struct OutputArgs {
    #[command(flatten)]
    pub json: JsonArgs,

    /// Write into this folder.
    #[arg(short, long, value_name = "DIR")]
    pub out: Option<PathBuf>,

    /// Replace the run that the folder given with --out holds.
    #[arg(long)]
    pub force: bool,
}

#[derive(Debug, Args)]
pub struct RunArgs {
    /// The task file.
    pub task: PathBuf,

    /// Robot in place of the task's: its folder or its robot.toml.
    #[arg(long)]
    pub robot: Option<PathBuf>,

    /// Robot interface to simulate; the one that robot.toml states if absent.
    #[arg(long, value_enum)]
    pub backend: Option<BackendArg>,

    /// Controller that commands the robot.
    #[arg(long, value_enum, default_value_t = ControllerArg::Osc)]
    pub controller: ControllerArg,

    /// Transformer from torques to setpoints, in place of the profile's or of the best for what the robot declares.
    #[arg(long, value_parser = transformers())]
    pub transformer: Option<TransformerKind>,

    /// Profile of the robot in place of its default one.
    #[arg(long)]
    pub profile: Option<String>,

    /// Seed in place of the task's.
    #[arg(long)]
    pub seed: Option<u64>,

    /// Duration in place of the task's, s.
    #[arg(long, value_name = "S", value_parser = positive, allow_negative_numbers = true)]
    pub duration_s: Option<f64>,

    /// Change a value of the task file, or with `robot.` of the robot file. Can be given again.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,

    /// Simulate a robot whose file names a driver.
    #[arg(long)]
    pub simulate: bool,

    /// Move a real robot to the task's start_rad first, along a straight line in joint space at 0.2 rad/s at most. It
    /// knows no obstacles: clear the way.
    #[arg(long, conflicts_with = "simulate")]
    pub move_to_start: bool,

    #[command(flatten)]
    pub output: OutputArgs,
}

impl RunArgs {
    pub fn options(&self, default: BackendKind) -> RunOptions {
        RunOptions {
            backend: self.backend.map_or(default, BackendKind::from),
            controller: self.controller.into(),
            transformer: self.transformer,
            profile: self.profile.clone(),
            seed: self.seed,
            duration_s: self.duration_s,
            label: None,
        }
    }
}

fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("expected a number of seconds above 0".to_owned()),
    }
}

#[derive(Debug, Args)]
pub struct BenchArgs {
    /// The suite file; the paper's experiments if absent.
    pub suite: Option<PathBuf>,

    /// Number of simultaneous runs; one for each processor if absent.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub jobs: Option<u16>,

    #[command(flatten)]
    pub output: OutputArgs,
}

#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// A log (run.mcap), or the folder of a run.
    pub log: PathBuf,

    /// Another task, computed on the same measurements.
    #[arg(long, value_name = "FILE")]
    pub task: Option<PathBuf>,

    #[command(flatten)]
    pub json: JsonArgs,
}

#[derive(Debug, Args)]
pub struct ReportArgs {
    /// Logs (run.mcap), or folders of runs.
    #[arg(required = true)]
    pub logs: Vec<PathBuf>,

    /// Write the page to this file; report.html beside the first log if absent.
    #[arg(short, long, value_name = "FILE")]
    pub out: Option<PathBuf>,

    #[command(flatten)]
    pub json: JsonArgs,
}

#[derive(Debug, Args)]
pub struct CheckArgs {
    /// Robot folders, and robot, task, suite and URDF files.
    #[arg(required = true)]
    pub files: Vec<PathBuf>,

    #[command(flatten)]
    pub json: JsonArgs,
}

#[derive(Debug, Args)]
pub struct IdentifyArgs {
    /// The robot's folder or its robot.toml.
    pub robot: PathBuf,

    /// Identify this joint alone.
    #[arg(long)]
    pub joint: Option<String>,

    /// Profile of the robot in place of its default one.
    #[arg(long)]
    pub profile: Option<String>,

    /// Joint positions during the identification, rad or m; the middle of the range for the other joints.
    #[arg(long, value_name = "JOINT=VALUE", value_delimiter = ',', value_parser = joint_value)]
    pub start_rad: Vec<(String, f64)>,

    /// Seed of the excitation's phases, and of all random numbers in the simulation.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,

    /// Change a value of the robot file: `robot.key=value`. Can be given again.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,

    #[command(flatten)]
    pub output: OutputArgs,
}

fn joint_value(text: &str) -> Result<(String, f64), String> {
    let wrong = || "expected the name of a joint and a number: elbow=-1.35".to_owned();
    let (name, value) = text.split_once('=').ok_or_else(wrong)?;
    let value: f64 = value.trim().parse().map_err(|_| wrong())?;
    if value.is_finite() { Ok((name.trim().to_owned(), value)) } else { Err(wrong()) }
}

#[derive(Debug, Args)]
pub struct ModelArgs {
    /// A robot folder, its robot.toml, or a URDF file.
    pub robot: PathBuf,

    /// Frame for which the samples are computed.
    #[arg(long, value_name = "FRAME", requires = "samples")]
    pub tip: Option<String>,

    /// States as JSON lines; `-` reads standard input.
    #[arg(long, value_name = "FILE", requires = "tip")]
    pub samples: Option<PathBuf>,

    /// Let the root link move in space: q begins with its position and quaternion x, y, z, w. For a URDF.
    #[arg(long)]
    pub floating: bool,

    /// Let mimic joints follow the joint that they name, instead of moving on their own. For a URDF.
    #[arg(long)]
    pub enforce_mimic: bool,

    #[command(flatten)]
    pub json: JsonArgs,
}

#[derive(Debug, Args)]
pub struct NewArgs {
    /// The folder to create.
    pub dir: PathBuf,

    /// The robot's URDF; it is copied into the folder.
    #[arg(long, value_name = "FILE")]
    pub urdf: PathBuf,
}

#[derive(Debug, Args)]
pub struct SchemaArgs {
    /// Kind of file.
    #[arg(value_enum)]
    pub kind: SchemaKind,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum SchemaKind {
    /// A robot file (robot.toml).
    Robot,
    /// A task file.
    Task,
    /// A suite file.
    Suite,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum BackendArg {
    /// Robot that takes joint positions; torques pass through the transformer.
    Position,
    /// Robot that takes joint velocities; torques pass through the transformer.
    Velocity,
    /// Robot that takes joint torques.
    Torque,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum ControllerArg {
    /// Operational-space control: torques.
    Osc,
    /// Inverse kinematics, streamed as positions.
    Ik,
    /// Inverse kinematics with velocity lead and compensation of the gravity sag, streamed as positions.
    IkLead,
}

impl From<BackendArg> for BackendKind {
    fn from(arg: BackendArg) -> Self {
        match arg {
            BackendArg::Position => Self::Position,
            BackendArg::Velocity => Self::Velocity,
            BackendArg::Torque => Self::Torque,
        }
    }
}

impl From<ControllerArg> for ControllerKind {
    fn from(arg: ControllerArg) -> Self {
        match arg {
            ControllerArg::Osc => Self::Osc,
            ControllerArg::Ik => Self::Ik,
            ControllerArg::IkLead => Self::IkLead,
        }
    }
}

/// Parser of the transformers' names.
fn transformers() -> impl TypedValueParser<Value = TransformerKind> {
    let values = TransformerKind::ALL.map(|kind| PossibleValue::new(kind.name()).help(kind.description()));
    PossibleValuesParser::new(values).try_map(|name| TransformerKind::named(&name).ok_or("unknown"))
}

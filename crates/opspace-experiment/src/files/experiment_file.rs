//! Files of experiments with several robots: robots with their tasks, couplings between tasks, and channels.

use crate::files::controller_kind::ControllerKind;
use crate::files::expectation::Expectation;
#[cfg(feature = "schema")]
use crate::files::task::LONGEST_RUN_S;
use crate::files::task::default_seed;
use opspace_backend::CommandKind;
use opspace_backend::quantity::{Fraction, NonNegative, Positive, exactly};
use opspace_coupling::{CarryParameters, TeleoperationParameters};
use opspace_sim::HeldObjectParameters;
use opspace_transformer::TransformerName;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Contents of the file of an experiment with several robots.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct ExperimentFile {
    /// Duration of control, s; it replaces those of the tasks.
    #[cfg_attr(feature = "schema", schemars(extend("maximum" = LONGEST_RUN_S)))]
    pub duration_s: Positive,
    /// Start of the statistics, s after the start of control; it replaces those of the tasks.
    #[serde(default)]
    pub settle_s: NonNegative,
    /// Seed of all random numbers in a simulation; each robot and each channel gets one of its own from it.
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// Robots, by name. Of cycles at the same time, that of the robot whose name comes first in the alphabet is first.
    #[cfg_attr(feature = "schema", schemars(extend("minProperties" = 2)))]
    pub robots: BTreeMap<String, ExperimentRobot>,
    /// Couplings between tasks of two robots, by name.
    pub couplings: BTreeMap<String, CouplingFile>,
    /// Channels, by name.
    #[serde(default)]
    pub channels: BTreeMap<String, ChannelFile>,
    /// Objects that hands of the robots hold, by name; all robots are then in one plant.
    #[serde(default)]
    pub objects: BTreeMap<String, HeldObjectParameters>,
    /// Bounds on metrics of the couplings, `COUPLING.metric`; a run that misses one ends with exit code 1. Bounds on metrics
    /// of a single robot belong in its task file.
    #[serde(default)]
    pub expect: BTreeMap<String, Expectation>,
}

/// A robot of an experiment.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct ExperimentRobot {
    /// Task file; the path is relative to this file.
    pub task: PathBuf,
    /// Robot that replaces that of the task: its folder or its robot.toml, relative to this file.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the task")))]
    pub robot: Option<PathBuf>,
    /// Kind of robot: `position`, `velocity` or `torque`.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of robot.toml")))]
    pub backend: Option<CommandKind>,
    /// Controller.
    #[cfg_attr(feature = "schema", schemars(extend("default" = ControllerKind::Osc)))]
    pub controller: Option<ControllerKind>,
    /// Transformer that replaces the one of the profile.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the profile")))]
    pub transformer: Option<TransformerName>,
    /// Profile that replaces the default profile of the robot.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "the default one of the robot")))]
    pub profile: Option<String>,
    /// Settings as on the command line: those that begin with `robot.` change the robot file, all others the task file.
    #[serde(default)]
    pub set: Vec<String>,
    /// Position of the robot's base in the world that the robots share, m, in place of `mount` in robot.toml.
    #[serde(default, deserialize_with = "exactly")]
    pub base_m: [f64; 3],
    /// Orientation of the base in that world: roll, pitch and yaw (fixed axes, in that order), rad.
    #[serde(default, deserialize_with = "exactly")]
    pub base_rpy_rad: [f64; 3],
}

/// A coupling between `coupled` tasks of two robots.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct CouplingFile {
    /// Robot that the operator moves, or that knows the path of a carried object, and its task.
    pub leader: CouplingEnd,
    /// The other robot, and its task.
    pub follower: CouplingEnd,
    /// Channel between the two, in both directions; without delay or loss if absent.
    pub channel: Option<String>,
    /// Law of a haptic teleoperation; either this or `carry`.
    pub teleoperation: Option<TeleoperationParameters>,
    /// Law of two robots that carry an object; either this or `teleoperation`.
    pub carry: Option<CarryParameters>,
}

/// A task of a robot.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct CouplingEnd {
    /// Name of the robot in this file.
    pub robot: String,
    /// Name of its task, of kind `coupled`.
    pub task: String,
}

/// A channel between two robots.
#[derive(Clone, Copy, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
#[non_exhaustive]
pub struct ChannelFile {
    /// Constant delay, s.
    pub delay_s: NonNegative,
    /// Largest additional delay, uniformly distributed, s.
    pub jitter_s: NonNegative,
    /// Probability that a packet is lost.
    pub loss: Fraction,
    /// True if a packet may arrive after one that was sent later; it is then not used.
    pub reordering: bool,
    /// Time without a packet after which the receiver is held, s.
    pub hold_after_s: Positive,
}

impl Default for ChannelFile {
    fn default() -> Self {
        Self {
            delay_s: NonNegative::default(),
            jitter_s: NonNegative::default(),
            loss: Fraction::default(),
            reordering: false,
            hold_after_s: Positive::literal(0.5),
        }
    }
}

//! Membership of a robot in an experiment with several robots.

use crate::files::source::Source;

/// Experiment with several robots to which a robot belongs.
#[derive(Clone, Debug)]
pub struct Membership {
    /// Name of the robot in the file of the experiment.
    pub robot: String,
    /// File of the experiment, with settings applied.
    pub experiment: Source,
    /// Settings that were applied to the experiment.
    pub settings: Vec<String>,
}

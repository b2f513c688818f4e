//! Robot of a scenario.

use crate::files::source::{FileError, Source};
use crate::run::experiment::Experiment;
use opspace_backend::quantity::Positive;

/// Distance of a rate from a whole number of hertz that is rounding, relative.
const ROUNDING: f64 = 1e-9;

/// Message for a robot that no clock can order.
const NOT_WHOLE: &str = "the rate of this robot is not a whole number of hertz";

/// Robot of a scenario, with its experiment.
#[derive(Clone, Debug)]
pub struct Member {
    /// Name of the robot in the file of the scenario; of a single robot, its own name.
    pub name: String,
    /// Task on the robot.
    pub experiment: Experiment,
    /// Rate at which the clock of all robots orders its cycles, Hz.
    pub(super) rate_hz: u32,
}

impl Member {
    /// Returns a robot that is alone. A clock of one robot orders nothing, so that its rate is any.
    pub(super) fn alone(experiment: Experiment) -> Self {
        Self { name: experiment.robot().name(), experiment, rate_hz: 1 }
    }

    /// Returns one of several robots of the scenario in `source`.
    ///
    /// # Errors
    /// A robot whose rate is not a whole number of hertz.
    pub(super) fn new(name: &str, experiment: Experiment, source: &Source) -> Result<Self, FileError> {
        let rate_hz = rate_hz(&experiment)
            .ok_or_else(|| FileError::at_key(source, ["robots", name], NOT_WHOLE, None))?;
        Ok(Self { name: name.to_owned(), experiment, rate_hz })
    }
}

/// Rate of a robot's interface, if it is a whole number of hertz.
fn rate_hz(experiment: &Experiment) -> Option<u32> {
    let rate = Positive::try_from(1.0 / experiment.profile().1.period_s()).ok()?.get();
    let whole = rate.round();
    ((rate - whole).abs() <= ROUNDING * rate && whole >= 1.0 && whole <= f64::from(u32::MAX))
        .then_some(whole as u32)
}

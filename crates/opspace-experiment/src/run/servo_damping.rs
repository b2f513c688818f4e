//! Damping of the servos that the transformer leaves to the joints.

use crate::codes::Code;
use crate::files::source::FileError;
use crate::finding::{Finding, Place};
use crate::run::experiment::Experiment;
use crate::transformers::gain_interval::{GainInterval, IntervalSource};
use opspace_backend::CommandKind;
use std::fmt;

/// Share of a servo's damping from which a run says that it remains.
pub const SERVO_DAMPING_NOTED: f64 = 0.05;

/// Half-width of the interval of kp that an identification usually gives, as a fraction of kp.
const IDENTIFIED: f64 = 0.03;

/// Largest share of a servo's damping that the transformer leaves, because the gains of the servo are not known exactly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ServoDamping {
    /// Share of the damping of the servo.
    pub share: f64,
    /// Interval of the servo's gains.
    pub interval: GainInterval,
}

impl fmt::Display for ServoDamping {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let percent = |share: f64| (1e3 * share).round() / 10.0;
        let GainInterval { half_width, source } = self.interval;
        let known = match source {
            IntervalSource::Stated => "known to",
            IntervalSource::Declared => "declared without an interval, which counts as",
            IntervalSource::Assumed => "assumed, which counts as",
        };
        write!(
            f,
            "{} % of the servos' damping is left to the joints, because their gains are {known} ±{} %",
            percent(self.share),
            percent(half_width)
        )
    }
}

/// Remedy of a damping that is left.
pub fn help_of_servo_damping(damping: &ServoDamping) -> String {
    let least = 100.0 * IDENTIFIED / (1.0 + IDENTIFIED);
    let mut help = String::new();
    if damping.interval.half_width > IDENTIFIED {
        help += &format!(
            "`opspace identify` measures the gains and their intervals: ±{:.0} % leave {least:.0} %; ",
            100.0 * IDENTIFIED
        );
    }
    help + "measured motor current leaves none, with `+current`"
}

impl Experiment {
    /// Damping that the transformer leaves to the joints of a position robot; `None` if it leaves none for its gains' sake.
    ///
    /// # Errors
    /// A profile without servos.
    pub fn servo_damping(&self) -> Result<Option<ServoDamping>, FileError> {
        let Some(name) = self.transformer_name() else { return Ok(None) };
        let traits = self.traits_of(&name);
        if self.command_kind() != CommandKind::Position || traits.needs_current || !traits.evaluates_servo_law
        {
            return Ok(None);
        }
        let setup = self.setup(&name)?;
        let left = setup.remaining_damping(false)?;
        let shares = left.iter().zip(setup.servo_gains()?).map(|(left, gains)| match gains.damping {
            0.0 => 0.0,
            damping => left.damping / damping,
        });
        let all =
            shares.zip(setup.gain_intervals()?).map(|(share, interval)| ServoDamping { share, interval });
        Ok(all.filter(|one| one.share > 0.0).max_by(|a, b| a.share.total_cmp(&b.share)))
    }

    /// Describes the damping that is left in the run, from a share that a hand feels.
    pub(crate) fn damped_by_servos(&self) -> Option<Finding> {
        let damping = self.servo_damping().ok()?.filter(|damping| damping.share >= SERVO_DAMPING_NOTED)?;
        let message = format!(
            "{damping}: compliant axes yield more slowly than those of a torque robot, and moving references are followed less \
             closely; {}",
            help_of_servo_damping(&damping)
        );
        Some(Finding::of(Code::DampedCompliance, Place::Run(()), message))
    }
}

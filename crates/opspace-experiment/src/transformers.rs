//! Transformers that a program knows by name: the built-in ones, and those of the user.

pub mod entry;
pub mod gain_interval;
pub mod setup;

use crate::codes::COMPARISONS;
use crate::extensions::{Entry, Tables, UnknownName};
use crate::files::robot::RobotDefinition;
use crate::files::source::{FileError, KeyPath, Source};
use crate::transformers::entry::{Built, TransformerEntry, TransformerTraits};
use crate::transformers::gain_interval::GainInterval;
use crate::transformers::setup::TransformerSetup;
use opspace_backend::{CommandKind, Setpoints};
use opspace_transformer::{
    ClosedLoopModel, EmulatingTransformer, ExtrapolatingTransformer, PaperTransformer, ServoGains,
    TorqueObjective, TransformerName, VelocityTransformer,
};
use std::sync::LazyLock;

/// Description of a transformer whose method is in the table without the correction too.
const CORRECTED: &str = "the same method, corrected by measured motor current";

/// Transformers of every program.
fn built_in() -> Vec<TransformerEntry> {
    use TorqueObjective::{IntervalMean, PerTick};
    type Name = TransformerName;
    let emulation = "emulates the servo up to the next setpoint and matches the mean torque";
    let interpolating =
        "emulates the servo of drives that interpolate setpoints and matches the torque of each servo tick";
    let extrapolation =
        "extrapolates each joint at its velocity up to the next setpoint and matches the mean torque";
    let identified = "equation (K10) with gains from a measured closed loop";

    let paper = TransformerEntry::new(Name::PAPER, "equation (K10) of the paper", paper);
    let identified = TransformerEntry::new(Name::IDENTIFIED, identified, from_closed_loops)
        .with_traits(TransformerTraits { needs_closed_loops: true, ..TransformerTraits::default() });
    let emulates = TransformerTraits {
        needs_delay: true,
        evaluates_servo_law: true,
        estimates_velocity: true,
        ..TransformerTraits::default()
    };
    let extrapolates = TransformerTraits { estimates_velocity: false, ..emulates };
    let corrected = |of| TransformerTraits { needs_current: true, adapts_gains: true, ..of };
    let evaluating = |name: Name, description, traits, build: fn(&TransformerSetup<'_>) -> Built| {
        TransformerEntry::new(name, description, build).with_traits(traits)
    };
    let with = |name: Name| name.with_current(true);
    vec![
        paper.clone(),
        paper.with_current_feedback(CORRECTED),
        evaluating(Name::EMULATION, emulation, emulates, |s| emulating(s, IntervalMean, false)),
        evaluating(with(Name::EMULATION), CORRECTED, corrected(emulates), |s| {
            emulating(s, IntervalMean, true)
        }),
        evaluating(Name::INTERPOLATING, interpolating, emulates, |s| emulating(s, PerTick, false)),
        evaluating(with(Name::INTERPOLATING), CORRECTED, corrected(emulates), |s| {
            emulating(s, PerTick, true)
        }),
        evaluating(Name::EXTRAPOLATION, extrapolation, extrapolates, |s| extrapolating(s, false)),
        evaluating(with(Name::EXTRAPOLATION), CORRECTED, corrected(extrapolates), |s| extrapolating(s, true)),
        identified.clone(),
        identified.with_current_feedback(CORRECTED),
    ]
}

impl Entry for TransformerEntry {
    const KIND: &'static str = "transformer";

    fn built_in() -> &'static [Self] {
        static ENTRIES: LazyLock<Vec<TransformerEntry>> = LazyLock::new(built_in);
        &ENTRIES
    }

    fn name(&self) -> &str {
        self.transformer_name().as_str()
    }
}

fn paper(setup: &TransformerSetup<'_>) -> Built {
    if setup.takes != CommandKind::Velocity {
        return direct(setup, setup.servo_gains()?, &setup.gain_intervals()?);
    }
    if let Some(joint) = setup.joint_with_velocity_integral() {
        let message = format!(
            "transformer '{}' inverts only kv; the integral of the velocity servo of joint '{joint}' would add to every \
             desired torque",
            setup.name
        );
        let help = "use 'emulation' or 'interpolating', which model the integral";
        return Err(setup.refused_at(&["velocity_servo", joint], message, help));
    }
    Ok(Box::new(VelocityTransformer::new(setup.servo_gains()?)))
}

fn direct(setup: &TransformerSetup<'_>, gains: Vec<ServoGains>, intervals: &[GainInterval]) -> Built {
    let uncertain: Vec<f64> = intervals.iter().map(|interval| interval.half_width).collect();
    Ok(Box::new(PaperTransformer::new(gains).acting_after(setup.setpoints_act_after_s(), &uncertain)))
}

fn from_closed_loops(setup: &TransformerSetup<'_>) -> Built {
    let split = |(joint, of): (usize, &ClosedLoopModel)| {
        of.split().map_err(|error| setup.joint_error("identified", joint, &error))
    };
    let gains: Result<Vec<ServoGains>, FileError> =
        setup.closed_loops().iter().enumerate().map(split).collect();
    let intervals = vec![GainInterval::DECLARED; setup.robot.model.n()];
    direct(setup, gains?, &intervals)
}

fn emulating(setup: &TransformerSetup<'_>, matching: TorqueObjective, current: bool) -> Built {
    let interface = &setup.robot.file.interface;
    if matching == TorqueObjective::PerTick && interface.setpoints == Setpoints::Held {
        let name = setup.name;
        let message = format!(
            "transformer '{name}' is for drives that interpolate setpoints, but these drives hold them"
        );
        let help =
            "use 'emulation', or set setpoints = \"interpolated\" if the drives interpolate".to_owned();
        return Err(FileError::at_key(&setup.robot.source, "interface.setpoints", message, Some(help)));
    }
    let emulating = EmulatingTransformer::new(&setup.emulation(matching, current)?);
    let wrong = |(joint, error)| setup.joint_error(setup.servo_table(), joint, &error);
    Ok(Box::new(emulating.map_err(wrong)?))
}

fn extrapolating(setup: &TransformerSetup<'_>, current: bool) -> Built {
    let extrapolating = ExtrapolatingTransformer::new(&setup.extrapolation(current)?);
    let wrong = |(joint, error)| setup.joint_error(setup.servo_table(), joint, &error);
    Ok(Box::new(extrapolating.map_err(wrong)?))
}

/// Checks that a transformer which a file names is in the table.
///
/// # Errors
/// An unknown name, at its key.
pub fn check_name(
    tables: &Tables,
    name: &TransformerName,
    source: &Source,
    key: impl KeyPath,
) -> Result<(), FileError> {
    let Err(unknown) = tables.find::<TransformerEntry>(name.as_str()) else { return Ok(()) };
    Err(FileError::at_key(source, key, unknown.to_string(), Some(help_of(&unknown))))
}

/// Names that there are, and where others may be.
pub(crate) fn help_of(unknown: &UnknownName) -> String {
    format!("{}; those for comparisons {COMPARISONS}", unknown.help)
}

/// Checks the transformers that a robot file names.
///
/// # Errors
/// As [`check_name`].
pub fn check_robot(tables: &Tables, robot: &RobotDefinition) -> Result<(), FileError> {
    for (profile, parameters) in &robot.file.profile {
        let Some(name) = &parameters.transformer else { continue };
        check_name(tables, name, &robot.source, ["profile", profile, "transformer"])?;
    }
    Ok(())
}

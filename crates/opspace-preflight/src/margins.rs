//! Margins of an arm with its transformer: the range of true over nominal values in which it is stable.
//!
//! All joints are varied together, and one quantity at a time. The [simulation](super::nudge) is that of the gain margin.

use super::boundary::{Boundary, boundary};
use super::diagnostic::{at_least, at_most, short};
use super::gears::{GearMargin, examine};
use super::nudge::{Nudge, NudgedArm};
use super::variation::{Variation, delayed};
use opspace_backend::{CommandKind, MAX_DELAY_CYCLES, Setpoints};
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_experiment::run::experiment::Experiment;
use opspace_transformer::TransformerName;
use std::fmt;

/// Largest excess that is examined: three times and a third of the nominal value.
const MOST_EXCESS: f64 = 2.0;

/// Resolution of a bound: absolute, and relative to the excess.
const RESOLUTION: f64 = 0.001;
const RELATIVE: f64 = 0.02;

/// Margins of an arm with a transformer.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Margins {
    /// Transformer.
    pub transformer: TransformerName,
    /// Joint that gets the most power if the arm is unstable with its nominal values; there are no ranges then.
    pub unstable: Option<String>,
    /// Ranges of the varied values, in the order of the table.
    pub ranges: Vec<StableRange>,
    /// Elastic gears; `None` if no rotor has an inertia.
    pub gears: Option<GearMargin>,
}

/// Range of a value in which an arm is stable.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct StableRange {
    /// Varied quantity.
    pub quantity: Quantity,
    /// Lower and upper end.
    pub ends: [RangeEnd; 2],
}

/// Quantity of a range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Quantity {
    /// True over nominal value.
    Factor(Variation),
    /// Delay until a setpoint acts, in servo ticks.
    Delay,
}

impl Quantity {
    /// Name in tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Factor(variation) => variation.name(),
            Self::Delay => "delay of setpoints",
        }
    }
}

/// End of a range.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct RangeEnd {
    /// Last stable value: true over nominal value, or servo ticks.
    pub value: f64,
    /// Joint that becomes unstable beyond it; `None` if nothing beyond it was examined.
    pub joint: Option<String>,
}

impl Margins {
    /// Returns a diagnostic if a true value of the simulated robot is outside the range in which the arm is stable.
    #[must_use]
    pub fn finding(&self, experiment: &Experiment) -> Option<Finding> {
        let scale = &experiment.robot().file.simulated.as_ref()?.true_over_nominal;
        self.ranges.iter().find_map(|range| {
            let (key, value) = match range.quantity {
                Quantity::Factor(Variation::PositionGain) => ("kp", scale.kp.get()),
                Quantity::Factor(Variation::VelocityGain) => ("kv", scale.kv.get()),
                Quantity::Factor(Variation::Inertia) => ("inertia", scale.inertia.get()),
                _ => return None,
            };
            let [least, most] = &range.ends;
            let (joint, bound, allowed) = match (&least.joint, &most.joint) {
                (Some(joint), _) if value < least.value => (joint, least.value, at_least(least.value)),
                (_, Some(joint)) if value > most.value => (joint, most.value, at_most(most.value)),
                _ => return None,
            };
            let side = if value < bound { "at least" } else { "at most" };
            let message = format!(
                "the simulated robot has {} times the nominal {}, with which it is unstable in the start posture: joint \
                 '{joint}' oscillates first; stable with {side} {allowed}",
                short(value),
                range.quantity.name(),
            );
            let help = format!(
                "{key} = {allowed} or nearer to 1, or correct the nominal values to those of the simulated robot"
            );
            let key = ["simulated", "true_over_nominal", key];
            Some(Finding::new(Code::UnstableSimulation, &key, message, help).of_robot())
        })
    }
}

/// True if a value of the simulated robot that a [`Margins::finding`] may be about is not the nominal one.
pub(super) fn is_varied(experiment: &Experiment) -> bool {
    experiment.robot().file.simulated.as_ref().is_some_and(|simulated| {
        let scale = &simulated.true_over_nominal;
        [scale.kp, scale.kv, scale.inertia].iter().any(|factor| factor.get() != 1.0)
    })
}

/// Computes the margins of an experiment with its transformer, and also without and with correction by current, if
/// current is measured. The transformer in use is the first. Empty if commands pass without a transformer.
#[must_use]
pub fn margins(experiment: &Experiment) -> Vec<Margins> {
    let Some(used) = experiment.transformer_name() else { return Vec::new() };
    let other = used.with_current(!used.has_current());
    let others = Some(other).filter(|_| experiment.measures_current());
    std::iter::once(used).chain(others).filter_map(|name| margins_with(experiment, &name)).collect()
}

/// Computes the margins of an experiment with the transformers that it does not use, if none is requested: they are the evidence
/// for the choice. Empty if a transformer is requested, or if commands pass without one.
#[must_use]
pub fn alternatives(experiment: &Experiment) -> Vec<Margins> {
    let Some(used) = experiment.transformer_name().filter(|_| experiment.chooses_transformer()) else {
        return Vec::new();
    };
    let emulation = match experiment.robot().file.interface.setpoints {
        Setpoints::Held => TransformerName::EMULATION,
        Setpoints::Interpolated => TransformerName::INTERPOLATING,
    };
    let all = [TransformerName::EXTRAPOLATION, emulation, TransformerName::PAPER];
    let others =
        all.map(|name| name.with_current(used.has_current())).into_iter().filter(|name| *name != used);
    others.filter_map(|name| margins_with(experiment, &name)).collect()
}

impl Margins {
    /// Describes the margins of the first gain and of elastic gears, a line each.
    #[must_use]
    pub fn in_short(&self) -> Vec<String> {
        let line = |name: &str, value: &dyn fmt::Display| format!("{name}: {value}");
        let unstable =
            self.unstable.iter().map(|joint| format!("unstable with its nominal values ({joint})"));
        let gain = self.ranges.iter().take(1).map(|range| line(range.quantity.name(), range));
        let gears = self.gears.iter().map(|gears| line("elastic gears", gears));
        unstable.chain(gain).chain(gears).collect()
    }
}

/// Computes the margins of an experiment with another transformer than its own; `None` if it cannot be run with it.
#[must_use]
pub fn margins_with(experiment: &Experiment, transformer: &TransformerName) -> Option<Margins> {
    let nudged = NudgedArm::new(experiment, transformer)?;
    let factors: &[Variation] = match experiment.command_kind() {
        CommandKind::Position => {
            &[Variation::PositionGain, Variation::VelocityGain, Variation::VelocityFilter, Variation::Inertia]
        }
        _ => &[Variation::VelocityGain, Variation::VelocityFilter, Variation::Inertia],
    };
    let gears = examine(&nudged);
    if let Nudge::Grows(joint) = nudged.nudge(nudged.nominal())? {
        let unstable = Some(name(&nudged, joint));
        return Some(Margins { transformer: transformer.clone(), unstable, ranges: Vec::new(), gears });
    }
    let mut ranges: Vec<StableRange> =
        factors.iter().filter_map(|&variation| factor_range(&nudged, variation)).collect();
    ranges.extend(delay_range(&nudged));
    Some(Margins { transformer: transformer.clone(), unstable: None, ranges, gears })
}

impl fmt::Display for Margins {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = &self.transformer;
        match &self.unstable {
            Some(joint) => {
                write!(
                    f,
                    "with transformer '{name}' the arm is unstable with its nominal values ('{joint}'):"
                )?;
            }
            None => {
                write!(
                    f,
                    "true over nominal values, stable at rest at the start, with transformer '{name}':"
                )?;
            }
        }
        for range in &self.ranges {
            write!(f, "\n  {:<25} {range}", range.quantity.name())?;
        }
        match &self.gears {
            Some(gears) => write!(f, "\n  {:<25} {gears}", "elastic gears"),
            None => Ok(()),
        }
    }
}

impl fmt::Display for StableRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [least, most] = [0, 1].map(|end| {
            let RangeEnd { value, joint } = &self.ends[end];
            let value = format!("{value:.3}").trim_end_matches('0').trim_end_matches('.').to_owned();
            match (joint, self.quantity) {
                (Some(joint), _) => format!("{value} ({joint})"),
                (None, Quantity::Delay) => value,
                (None, Quantity::Factor(_)) => value + [" or less", " or more"][end],
            }
        });
        let unit = if self.quantity == Quantity::Delay { " servo ticks" } else { "" };
        write!(f, "{least} to {most}{unit}")
    }
}

fn factor_range(nudged: &NudgedArm, variation: Variation) -> Option<StableRange> {
    let end = |factor: fn(f64) -> f64| {
        let varied = |excess: f64| variation.of(nudged.nominal(), factor(excess));
        let found = boundary(nudged, MOST_EXCESS, RESOLUTION, RELATIVE, varied)?;
        Some(match found {
            None => RangeEnd { value: factor(MOST_EXCESS), joint: None },
            Some(Boundary { last_stable, joint }) => {
                RangeEnd { value: factor(last_stable), joint: Some(name(nudged, joint)) }
            }
        })
    };
    let ends = [end(|excess| 1.0 / (1.0 + excess))?, end(|excess| 1.0 + excess)?];
    Some(StableRange { quantity: Quantity::Factor(variation), ends })
}

fn delay_range(nudged: &NudgedArm) -> Option<StableRange> {
    let profile = nudged.experiment().profile().1;
    let nominal = profile.delay();
    let end = |ticks: &mut dyn Iterator<Item = u32>| {
        let mut last = nominal;
        for ticks in ticks {
            if let Nudge::Grows(joint) = nudged.nudge(&delayed(nudged.nominal(), ticks))? {
                return Some(RangeEnd { value: f64::from(last), joint: Some(name(nudged, joint)) });
            }
            last = ticks;
        }
        Some(RangeEnd { value: f64::from(last), joint: None })
    };
    // A cycle to both sides.
    let ratio = profile.servo_ticks_per_cycle.get();
    let least = end(&mut (nominal.saturating_sub(ratio)..nominal).rev())?;
    let most = end(&mut (nominal + 1..=(nominal + ratio).min(MAX_DELAY_CYCLES * ratio)))?;
    Some(StableRange { quantity: Quantity::Delay, ends: [least, most] })
}

fn name(nudged: &NudgedArm, joint: usize) -> String {
    nudged.experiment().robot().model.joints()[joint].name.clone()
}

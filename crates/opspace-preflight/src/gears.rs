//! Elastic gears of an arm, from soft to stiff, with which it is checked for oscillation.
//!
//! Multiples of the declared stiffness are examined; if none is declared, gears so soft that each link has a given
//! antiresonance f on its gear, with its rotor and all other joints held:
//!
//! ```text
//! K = (2π f)² (M − B)
//! ```
//!
//! where M is the joint's diagonal element of the mass matrix at the start and B the reflected inertia of its rotor. The
//! rotor is not held; rotor and link resonate at f √(1 + (M − B)/B). The gears have no damping of their own. On stiff
//! ones, drives with constant setpoints may oscillate: that is no matter of the transformer and not reported.

use super::changed;
use super::diagnostic::short;
use super::gear_remedies;
use super::nudge::{Nudge, NudgedArm};
use super::variation::Variation;
use opspace_backend::quantity::Positive;
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_experiment::run::experiment::Experiment;
use opspace_model::{Data, update};
use opspace_sim::ArmConfig;
use opspace_transformer::Gears;
use std::f64::consts::TAU;
use std::fmt;

/// Antiresonances that are examined if no stiffness is declared, Hz: from soft gears to practically rigid ones.
const ANTIRESONANCES_HZ: [f64; 8] = [10.0, 15.0, 20.0, 30.0, 40.0, 60.0, 80.0, 120.0];

/// Least antiresonance that gears of unknown stiffness are taken to have, Hz. Softer ones have to be declared.
const SOFTEST_HZ: f64 = 20.0;

/// Highest examined antiresonance as a fraction of the interface rate: beyond it, sampling makes any transformer active.
const HIGHEST: f64 = 0.25;

/// Multiples of the declared stiffness that are examined.
const MULTIPLES: [f64; 7] = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0];

/// Quantity by which the examined gears are described.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GearScale {
    /// Antiresonance of each link on its gear, Hz.
    AntiresonanceHz,
    /// Multiple of the declared stiffness.
    DeclaredStiffness,
}

/// Gears with which an arm was examined, and those with which it oscillates.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct GearMargin {
    /// Quantity of the values.
    pub scale: GearScale,
    /// Examined values, in ascending order.
    pub examined: Vec<f64>,
    /// Values with which the arm oscillates, in ascending order, and the joint that oscillates first.
    pub oscillates: Vec<(f64, String)>,
}

impl GearMargin {
    /// Values that the gears may have: from half to twice the declared stiffness, and antiresonances from 20 Hz on if
    /// none is declared.
    fn is_possible(&self, value: f64) -> bool {
        match self.scale {
            GearScale::AntiresonanceHz => value >= SOFTEST_HZ,
            GearScale::DeclaredStiffness => (0.5..=2.0).contains(&value),
        }
    }

    /// Returns a diagnostic if the arm oscillates with gears that it may have.
    #[must_use]
    pub fn finding(&self, experiment: &Experiment) -> Option<Finding> {
        let transformer = experiment.transformer_name()?;
        if experiment.robot().gears() == Gears::Rigid
            || !self.oscillates.iter().any(|(value, _)| self.is_possible(*value))
        {
            return None;
        }
        let message = format!("with transformer '{transformer}' the arm on elastic gears {self}");
        let tried = gear_remedies::that_help(experiment, &is_stable);
        let tried = if tried.is_empty() {
            "no transformer, and no friction compensation or lower gains of the tasks, helps here".to_owned()
        } else {
            changed::alternatives(&tried)
        };
        let of_gears = match self.scale {
            GearScale::AntiresonanceHz => {
                "if the stiffness of the gears is known, declare `joint.NAME.gear_stiffness_nm_per_rad`, or `gears = \"rigid\"` in \
                 [interface] if they are rigid"
            }
            GearScale::DeclaredStiffness => "correct `gear_stiffness_nm_per_rad` if the stiffness is another",
        };
        let help = format!("{tried}; {of_gears}");
        let profile = experiment.profile().0;
        Some(
            Finding::new(Code::GearOscillation, &["profile", profile, "transformer"], message, help)
                .of_robot(),
        )
    }
}

impl fmt::Display for GearMargin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let list = |values: &[f64]| {
            let values = values.iter().map(|value| short(*value)).collect::<Vec<_>>().join(", ");
            match self.scale {
                GearScale::AntiresonanceHz => format!("antiresonances of {values} Hz"),
                GearScale::DeclaredStiffness => format!("{values} times the declared stiffness"),
            }
        };
        let Some((_, joint)) = self.oscillates.first() else {
            return write!(f, "stable at {}", list(&self.examined));
        };
        let values: Vec<f64> = self.oscillates.iter().map(|(value, _)| *value).collect();
        write!(f, "oscillates at {} ({joint})", list(&values))
    }
}

/// Examines the arm of an experiment with elastic gears; `None` if it cannot be simulated with them, or if commands pass
/// without a transformer.
#[must_use]
pub fn gear_margin(experiment: &Experiment) -> Option<GearMargin> {
    examine(&NudgedArm::new(experiment, &experiment.transformer_name()?)?)
}

/// Examines an arm with elastic gears; `None` if it cannot be simulated with them.
pub(super) fn examine(nudged: &NudgedArm) -> Option<GearMargin> {
    let mut margin = GearMargin::unknown(nudged.nominal());
    for value in margin.examined.clone() {
        margin.oscillates.extend(oscillation(nudged, margin.scale, value)?);
    }
    Some(margin)
}

/// Examines an arm with the elastic gears that it may have, up to the first with which it oscillates; `None` if it cannot
/// be simulated with them.
pub(super) fn first_oscillation(nudged: &NudgedArm) -> Option<GearMargin> {
    let mut margin = GearMargin::unknown(nudged.nominal());
    for value in margin.examined.clone().into_iter().filter(|value| margin.is_possible(*value)) {
        if let Some(found) = oscillation(nudged, margin.scale, value)? {
            margin.oscillates.push(found);
            break;
        }
    }
    Some(margin)
}

/// True if the arm is stable with a fraction of the damping of its tasks.
fn is_stable(experiment: &Experiment, gains: f64) -> bool {
    let nudged = experiment.transformer_name().and_then(|name| NudgedArm::new(experiment, &name));
    let margin = nudged.and_then(|nudged| first_oscillation(&nudged.with_gains(gains)));
    margin.is_some_and(|margin| margin.oscillates.is_empty())
}

impl GearMargin {
    /// Values to be examined.
    fn unknown(nominal: &ArmConfig) -> Self {
        let is_declared = nominal.joints.iter().any(|joint| joint.gear_stiffness_nm_per_rad.is_some());
        let highest_hz = HIGHEST / nominal.profile.period_s();
        let (scale, examined) = match is_declared {
            true => (GearScale::DeclaredStiffness, MULTIPLES.to_vec()),
            false => {
                let within = ANTIRESONANCES_HZ.into_iter().filter(|hz| *hz <= highest_hz);
                (GearScale::AntiresonanceHz, within.collect())
            }
        };
        Self { scale, examined, oscillates: Vec::new() }
    }
}

/// Returns the value and the first joint if the arm oscillates with these gears and its drives alone do not; outer `None`
/// if it cannot be simulated.
fn oscillation(nudged: &NudgedArm, scale: GearScale, value: f64) -> Option<Option<(f64, String)>> {
    let nominal = nudged.nominal();
    let varied = match scale {
        GearScale::DeclaredStiffness => Variation::GearStiffness.of(nominal, value)?,
        GearScale::AntiresonanceHz => with_antiresonance(nominal, value)?,
    };
    let Nudge::Grows(joint) = nudged.nudge(&varied)? else { return Some(None) };
    Some(match nudged.nudge_drives_alone(&varied)? {
        Nudge::Grows(_) => None,
        Nudge::DiesOut => Some((value, nominal.model.joints()[joint].name.clone())),
    })
}

/// Returns the arm with gears on which each link has this antiresonance, Hz; `None` if no rotor has an inertia.
fn with_antiresonance(nominal: &ArmConfig, hz: f64) -> Option<ArmConfig> {
    let (mut arm, n) = (nominal.clone(), nominal.model.n());
    let mut data = Data::new(&nominal.model);
    update(&nominal.model, &mut data, &nominal.start, &vec![0.0; n]).then_some(())?;
    let rotors = nominal.model.rotor_inertia();
    for (i, joint) in arm.joints.iter_mut().enumerate().filter(|(i, _)| rotors[*i] > 0.0) {
        let link = data.mass_matrix[(i, i)] - rotors[i];
        joint.gear_stiffness_nm_per_rad = Positive::try_from((TAU * hz).powi(2) * link).ok();
    }
    arm.joints.iter().any(|joint| joint.gear_stiffness_nm_per_rad.is_some()).then_some(arm)
}

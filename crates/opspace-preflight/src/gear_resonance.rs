//! Frequencies of rotor and link on the gears whose stiffness the robot file declares.

use super::case::PreflightCase;
use super::diagnostic::short;
use std::f64::consts::TAU;
use std::fmt;

/// Frequencies of a joint with an elastic gear of stiffness K at the start, with the other joints held: rotor inertia B,
/// link inertia J, the diagonal element of the mass matrix without the rotor.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct GearResonance {
    /// Name of the joint.
    pub joint: String,
    /// Declared stiffness K, Nm/rad (N/m).
    pub stiffness_nm_per_rad: f64,
    /// Frequency √(K/J)/2π of the link with its rotor held, at which the motor cannot move the rotor, Hz.
    pub antiresonance_hz: f64,
    /// Frequency √(K (1/J + 1/B))/2π of link and rotor, Hz; `None` if the rotor has no inertia.
    pub resonance_hz: Option<f64>,
}

impl GearResonance {
    /// Returns the frequencies for the inertias of link and rotor at the joint, kg m² (kg).
    #[must_use]
    pub fn new(joint: &str, stiffness_nm_per_rad: f64, link: f64, rotor: f64) -> Self {
        let hz = |squared: f64| (stiffness_nm_per_rad * squared).sqrt() / TAU;
        Self {
            joint: joint.to_owned(),
            stiffness_nm_per_rad,
            antiresonance_hz: hz(1.0 / link),
            resonance_hz: (rotor > 0.0).then(|| hz(1.0 / link + 1.0 / rotor)),
        }
    }
}

impl fmt::Display for GearResonance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { joint, antiresonance_hz, resonance_hz, .. } = self;
        write!(f, "gear of joint '{joint}': antiresonance at {} Hz", short(*antiresonance_hz))?;
        match resonance_hz {
            Some(hz) => write!(f, ", resonance at {} Hz, at the start", short(*hz)),
            None => f.write_str(" at the start"),
        }
    }
}

/// Computes the frequencies of all joints with a declared gear stiffness.
pub(super) fn gear_resonances_of(case: &PreflightCase<'_>) -> Vec<GearResonance> {
    let drives = &case.experiment.robot().file.joint;
    let joints = case.model.joints().iter().zip(case.model.rotor_inertia()).enumerate();
    joints
        .filter_map(|(i, (joint, &rotor))| {
            let stiffness = drives.get(&joint.name)?.gear_stiffness_nm_per_rad?;
            let link = case.data.mass_matrix[(i, i)] - rotor;
            Some(GearResonance::new(&joint.name, stiffness.get(), link, rotor))
        })
        .collect()
}

//! Gains of an impedance that vary with time, and the energy tank that limits the growth of the stiffness.

use crate::error::{ControlError, Reason};
use crate::references::ramp::minimum_jerk;
use crate::references::target::BLEND_S;
use crate::tasks::axes::AXIS_NAMES;
use crate::tasks::energy_tank::{EnergyTank, TankParameters};
use crate::tasks::gain_profile::{AxisProfiles, GainProfile};
use nalgebra::Vector6;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Gains of an impedance as functions of time, in seconds since the task was started or its impedance was changed. Axes
/// that are not named keep their constant gain.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct ImpedanceProfile {
    /// Stiffness along motion axes, N/m.
    pub stiffness_n_per_m: Option<AxisProfiles>,
    /// Stiffness about motion axes, Nm/rad.
    pub stiffness_nm_per_rad: Option<AxisProfiles>,
    /// Damping ratio of every mode.
    pub damping_ratio: Option<GainProfile>,
    /// Damping along motion axes, Ns/m; needs the constant `damping_ns_per_m` of the impedance.
    pub damping_ns_per_m: Option<AxisProfiles>,
    /// Damping about motion axes, Nms/rad; needs the constant `damping_nms_per_rad` of the impedance.
    pub damping_nms_per_rad: Option<AxisProfiles>,
}

impl ImpedanceProfile {
    /// Checks that each profile belongs to a motion axis of its kind, and that the damping is of the kind of the constant
    /// one: a ratio or values of the axes.
    pub(crate) fn check(&self, motion: [bool; 6], has_ratio: bool, key: &str) -> Result<(), ControlError> {
        for (place, profiles, kind) in [
            ("stiffness_n_per_m", &self.stiffness_n_per_m, 0..3),
            ("stiffness_nm_per_rad", &self.stiffness_nm_per_rad, 3..6),
            ("damping_ns_per_m", &self.damping_ns_per_m, 0..3),
            ("damping_nms_per_rad", &self.damping_nms_per_rad, 3..6),
        ] {
            let Some(profiles) = profiles else { continue };
            if let Some(axis) = profiles.named().find(|axis| !kind.contains(axis) || !motion[*axis]) {
                let reason = Reason::GainProfileAxis { axis: AXIS_NAMES[axis] };
                return Err(ControlError::new(format!("{key}.{place}"), reason));
            }
        }
        let mismatched = if has_ratio {
            [("damping_ns_per_m", &self.damping_ns_per_m), ("damping_nms_per_rad", &self.damping_nms_per_rad)]
                .into_iter()
                .find_map(|(place, profile)| profile.as_ref().map(|_| place))
        } else {
            self.damping_ratio.as_ref().map(|_| "damping_ratio")
        };
        match mismatched {
            Some(place) => Err(ControlError::new(format!("{key}.{place}"), Reason::DampingTwice)),
            None => Ok(()),
        }
    }

    /// Stiffness of an axis at a time, if it has a profile.
    fn stiffness(&self, axis: usize, time_s: f64) -> Option<f64> {
        let profiles = if axis < 3 { &self.stiffness_n_per_m } else { &self.stiffness_nm_per_rad };
        profiles.as_ref()?.get(axis).map(|profile| profile.at(time_s))
    }

    /// Damping of an axis at a time, if it has a profile.
    fn damping(&self, axis: usize, time_s: f64) -> Option<f64> {
        let profiles = if axis < 3 { &self.damping_ns_per_m } else { &self.damping_nms_per_rad };
        profiles.as_ref()?.get(axis).map(|profile| profile.at(time_s))
    }
}

/// Varying gains of a task, with their state.
#[derive(Clone, Debug)]
pub(crate) struct VaryingGains {
    profile: ImpedanceProfile,
    motion: [bool; 6],
    /// Stiffness of the axes without a profile.
    constant: Vector6<f64>,
    tank: EnergyTank,
    /// Time at which the profile starts, s.
    start_s: f64,
    /// Stiffness from which the profile is blended in, and the time at which the blend starts, s; `None` without a blend.
    blend: Option<(Vector6<f64>, f64)>,
}

impl VaryingGains {
    pub(crate) fn new(
        profile: ImpedanceProfile,
        tank: &TankParameters,
        motion: [bool; 6],
        constant: Vector6<f64>,
    ) -> Self {
        let tank = EnergyTank::new(tank, constant);
        Self { profile, motion, constant, tank, start_s: 0.0, blend: None }
    }

    /// Starts the profile with a full stiffness and the initial energy.
    pub(crate) fn start(&mut self, time_s: f64) {
        (self.start_s, self.blend) = (time_s, None);
        self.tank.start(self.desired_stiffness(time_s));
    }

    /// Continues from the stiffness of the impedance before, `stiffness`, and from its varying gains: an equal profile goes
    /// on, a different one starts and is blended in.
    pub(crate) fn continue_from(&mut self, before: Option<&Self>, stiffness: Vector6<f64>, time_s: f64) {
        match before {
            Some(before) if before.profile == self.profile && before.constant == self.constant => {
                (self.start_s, self.blend) = (before.start_s, before.blend);
            }
            _ => (self.start_s, self.blend) = (time_s, Some((stiffness, time_s))),
        }
        self.tank.continue_from(before.map(|before| &before.tank), stiffness);
    }

    /// Stiffness at a time without the tank.
    fn desired_stiffness(&self, time_s: f64) -> Vector6<f64> {
        let since_s = time_s - self.start_s;
        let mut desired = self.constant;
        for axis in (0..6).filter(|&axis| self.motion[axis]) {
            desired[axis] = self.profile.stiffness(axis, since_s).unwrap_or(desired[axis]);
        }
        match &self.blend {
            Some((from, from_s)) if time_s < from_s + BLEND_S => {
                from + (desired - from) * minimum_jerk(time_s - from_s, BLEND_S)[0]
            }
            _ => desired,
        }
    }

    /// Updates the tank for the errors of this cycle, which must be zero on axes without a spring, and returns the stiffness
    /// that it allows.
    pub(crate) fn update(&mut self, time_s: f64, error: &Vector6<f64>) -> Vector6<f64> {
        let desired = self.desired_stiffness(time_s);
        self.tank.update(&desired, error);
        *self.tank.stiffness()
    }

    /// Damping ratio at a time, s, if it has a profile.
    pub(crate) fn damping_ratio(&self, time_s: f64) -> Option<f64> {
        self.profile.damping_ratio.as_ref().map(|profile| profile.at(time_s - self.start_s))
    }

    /// Replaces the damping of the axes that have a profile by its value at a time, s.
    pub(crate) fn replace_damping(&self, time_s: f64, damping: &mut Vector6<f64>) {
        for axis in (0..6).filter(|&axis| self.motion[axis]) {
            damping[axis] = self.profile.damping(axis, time_s - self.start_s).unwrap_or(damping[axis]);
        }
    }

    pub(crate) fn tank(&self) -> &EnergyTank {
        &self.tank
    }

    pub(crate) fn tank_mut(&mut self) -> &mut EnergyTank {
        &mut self.tank
    }
}

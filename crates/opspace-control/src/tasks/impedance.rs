//! Impedance: a spring and a damper in N/m and Ns/m, instead of the unit mass of [`AxisGains`].
//!
//! With the arm's own inertia Λ, the hand responds to an external force f by
//!
//! ```text
//! Λ (ẍ − ẍ_d) + D (ẋ − ẋ_d) + K (x − x_d) = f
//! ```
//!
//! In every control cycle, a damping ratio ζ is converted to a matrix D by double diagonalisation. With Λ = Q Qᵀ and
//! K = Q diag(ω²) Qᵀ, D = 2ζ Q diag(ω) Qᵀ gives every mode of the coupled springs the same damping ratio
//! (Albu-Schäffer, Ott, Frese and Hirzinger, *Cartesian impedance control of redundant robots*, ICRA 2003). A desired
//! inertia m needs a force sensor: m (ẍ − ẍ_d) + d (ẋ − ẋ_d) + k (x − x_d) = f.
//!
//! Gains can be [functions of time](ImpedanceProfile); an [energy tank](crate::tasks::energy_tank) keeps the robot passive.
//!
//! [`AxisGains`]: crate::tasks::gains::AxisGains

use crate::error::{ControlError, Reason};
use crate::tasks::axes::{PerAxis, required};
use crate::tasks::energy_tank::TankParameters;
use crate::tasks::varying_gains::{ImpedanceProfile, VaryingGains};
use nalgebra::{Matrix6, SymmetricEigen, Vector6};
use opspace_backend::quantity::{NonNegative, Positive};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// A spring and a damper on each motion axis.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct ImpedanceParameters {
    /// Stiffness along motion axes, N/m.
    pub stiffness_n_per_m: Option<PerAxis<NonNegative>>,
    /// Stiffness about motion axes, Nm/rad.
    pub stiffness_nm_per_rad: Option<PerAxis<NonNegative>>,
    /// Damping ratio of every mode.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = format!("`{DAMPING_RATIO}` without a damping"))))]
    pub damping_ratio: Option<NonNegative>,
    /// Damping along motion axes, Ns/m; instead of a ratio.
    pub damping_ns_per_m: Option<PerAxis<NonNegative>>,
    /// Damping about motion axes, Nms/rad; instead of a ratio.
    pub damping_nms_per_rad: Option<PerAxis<NonNegative>>,
    /// Apparent mass of the axes, kg. Needs `force`.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "the arm's own")))]
    pub inertia_kg: Option<PerAxis<Positive>>,
    /// Apparent moment of inertia of the axes, kg m². Needs `force`.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "the arm's own")))]
    pub inertia_kg_m2: Option<PerAxis<Positive>>,
    /// Gains as functions of the time since the task was started or its impedance was changed; they replace the constant
    /// ones. The tank keeps the robot passive.
    pub profile: Option<Box<ImpedanceProfile>>,
    /// Energy tank that limits the growth of the stiffness, by a profile or an event. Without it and a profile, an event
    /// changes the stiffness at once.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "`{}` with a profile")))]
    pub tank: Option<TankParameters>,
}

/// Damping ratio of every mode if the file gives neither a ratio nor a damping.
const DAMPING_RATIO: f64 = 0.7;

/// Impedance of one task; zero on axes that are not in motion.
#[derive(Clone, Debug)]
pub(crate) struct Impedance {
    pub stiffness: Vector6<f64>,
    damping: Damping,
    /// Desired inertia (kg, kg m²); `None` for the arm's own.
    pub inertia: Option<Vector6<f64>>,
    /// Variation of stiffness and damping with time, if there is one.
    varying: Option<Box<VaryingGains>>,
}

#[derive(Clone, Debug)]
enum Damping {
    /// Damping ratio of every mode.
    Ratio(f64),
    /// Damping of each axis, Ns/m or Nms/rad.
    Axes(Vector6<f64>),
}

impl Impedance {
    pub(crate) fn new(
        parameters: &ImpedanceParameters,
        motion: [bool; 6],
        sensed: bool,
        key: &str,
    ) -> Result<Self, ControlError> {
        let p = parameters;
        // Returns one value per motion axis, from the key for linear or angular axes.
        let values = |linear: &Option<PerAxis<f64>>, angular: &Option<PerAxis<f64>>, keys: [&str; 2]| {
            let mut out = Vector6::zeros();
            for axis in (0..6).filter(|&axis| motion[axis]) {
                let (values, place) = if axis < 3 { (linear, keys[0]) } else { (angular, keys[1]) };
                let at = |reason| ControlError::new(format!("{key}.{place}"), reason);
                let missing = || at(Reason::ImpedanceMissing { key: place.to_owned() });
                let values = values.as_ref().ok_or_else(missing)?;
                out[axis] = required(values, axis).map_err(at)?;
            }
            Ok::<_, ControlError>(out)
        };
        let plain = |v: &Option<PerAxis<NonNegative>>| v.map(|v| v.map(NonNegative::get));
        let positive = |v: &Option<PerAxis<Positive>>| v.map(|v| v.map(Positive::get));
        let stiffness = values(
            &plain(&p.stiffness_n_per_m),
            &plain(&p.stiffness_nm_per_rad),
            ["stiffness_n_per_m", "stiffness_nm_per_rad"],
        )?;
        let given = p.damping_ns_per_m.is_some() || p.damping_nms_per_rad.is_some();
        let damping = if given {
            if p.damping_ratio.is_some() {
                return Err(ControlError::new(format!("{key}.damping_ratio"), Reason::DampingTwice));
            }
            let keys = ["damping_ns_per_m", "damping_nms_per_rad"];
            Damping::Axes(values(&plain(&p.damping_ns_per_m), &plain(&p.damping_nms_per_rad), keys)?)
        } else {
            Damping::Ratio(p.damping_ratio.map_or(DAMPING_RATIO, NonNegative::get))
        };
        let shaped = p.inertia_kg.is_some() || p.inertia_kg_m2.is_some();
        let inertia = if shaped {
            if !sensed {
                return Err(ControlError::new(key, Reason::ShapedInertiaUnsensed));
            }
            let keys = ["inertia_kg", "inertia_kg_m2"];
            let mut inertia = values(&positive(&p.inertia_kg), &positive(&p.inertia_kg_m2), keys)?;
            // Axes that are not in motion need no value in the file; 1 avoids a division by zero.
            inertia.iter_mut().filter(|m| **m == 0.0).for_each(|m| *m = 1.0);
            Some(inertia)
        } else {
            None
        };
        let varies = p.profile.is_some() || p.tank.is_some();
        if varies && shaped {
            return Err(ControlError::new(key, Reason::VaryingShapedInertia));
        }
        let profile = p.profile.as_deref().cloned().unwrap_or_default();
        profile.check(motion, matches!(damping, Damping::Ratio(_)), &format!("{key}.profile"))?;
        let tank = p.tank.unwrap_or_default();
        if tank.initial_j.get() > tank.capacity_j.get() {
            let message =
                format!("{} J is above the capacity of {} J", tank.initial_j.get(), tank.capacity_j.get());
            return Err(ControlError::value(&format!("{key}.tank.initial_j"), message));
        }
        let varying = varies.then(|| Box::new(VaryingGains::new(profile, &tank, motion, stiffness)));
        Ok(Self { stiffness, damping, inertia, varying })
    }

    /// Varying gains, if there are any.
    pub(crate) fn varying(&self) -> Option<&VaryingGains> {
        self.varying.as_deref()
    }

    /// Varying gains, if there are any.
    pub(crate) fn varying_mut(&mut self) -> Option<&mut VaryingGains> {
        self.varying.as_deref_mut()
    }

    /// Continues from the impedance of another task set, if the gains vary.
    pub(crate) fn continue_from(&mut self, before: Option<&Self>, time_s: f64) {
        let Some(varying) = &mut self.varying else { return };
        match before {
            Some(before) => varying.continue_from(before.varying(), before.stiffness, time_s),
            None => varying.start(time_s),
        }
    }

    /// Sets the gains of this cycle if they vary, for the errors of the axes (m, rad; 0 on axes that are not in motion).
    pub(crate) fn vary(&mut self, time_s: f64, error: &Vector6<f64>) {
        let Some(varying) = &mut self.varying else { return };
        self.stiffness = varying.update(time_s, error);
        match &mut self.damping {
            Damping::Ratio(ratio) => *ratio = varying.damping_ratio(time_s).unwrap_or(*ratio),
            Damping::Axes(damping) => varying.replace_damping(time_s, damping),
        }
    }

    /// Damping of each axis for a desired inertia, Ns/m or Nms/rad.
    pub(crate) fn shaped_damping(&self, inertia: &Vector6<f64>) -> Vector6<f64> {
        match &self.damping {
            Damping::Axes(damping) => *damping,
            Damping::Ratio(ratio) => {
                Vector6::from_fn(|i, _| 2.0 * ratio * (self.stiffness[i] * inertia[i]).sqrt())
            }
        }
    }

    /// Returns the damping force D ẋ on the task's rows for a velocity error `velocity`. Row i belongs to the axis
    /// `axes[i]` and is multiplied by the axis's entry in `scale`; `task_inertia` is Λ of these rows.
    pub(crate) fn damping_force(
        &self,
        task_inertia: &Matrix6<f64>,
        axes: &[usize],
        scale: &[f64; 6],
        velocity: &Vector6<f64>,
    ) -> Vector6<f64> {
        match &self.damping {
            Damping::Axes(damping) => {
                let mut force = Vector6::zeros();
                for (row, &axis) in axes.iter().enumerate() {
                    force[row] = damping[axis] * velocity[row] / (scale[axis] * scale[axis]);
                }
                force
            }
            Damping::Ratio(ratio) => {
                let mut stiffness = Matrix6::zeros();
                for (row, &axis) in axes.iter().enumerate() {
                    stiffness[(row, row)] = self.stiffness[axis] / (scale[axis] * scale[axis]);
                }
                designed_damping(task_inertia, &stiffness, *ratio) * velocity
            }
        }
    }
}

/// Largest number of iterations of a decomposition: finite matrices of our sizes need some ten per row.
const MAX_ITERATIONS: usize = 1000;

/// Returns the damping matrix D of a damping ratio, by double diagonalisation. Directions in which Λ is singular
/// (eigenvalue 0) are not damped, and none is if a matrix is not finite.
#[must_use]
pub fn designed_damping(inertia: &Matrix6<f64>, stiffness: &Matrix6<f64>, ratio: f64) -> Matrix6<f64> {
    let eigen = |matrix| SymmetricEigen::try_new(matrix, f64::EPSILON, MAX_ITERATIONS);
    let Some(spectrum) = eigen(*inertia) else { return Matrix6::zeros() };
    let largest = spectrum.eigenvalues.max();
    if !(largest > 0.0 && largest.is_finite()) {
        return Matrix6::zeros();
    }
    let (mut root, mut inverse_root) = (spectrum.eigenvectors, spectrum.eigenvectors);
    for (i, &value) in spectrum.eigenvalues.iter().enumerate() {
        let size = value.max(0.0).sqrt();
        let kept = value > f64::EPSILON * largest;
        root.column_mut(i).scale_mut(size);
        inverse_root.column_mut(i).scale_mut(if kept { 1.0 / size } else { 0.0 });
    }
    // In the modes of Λ with unit mass, the stiffness is inverse_rootᵀ K inverse_root.
    let Some(springs) = eigen(inverse_root.transpose() * stiffness * inverse_root) else {
        return Matrix6::zeros();
    };
    let modes = root * springs.eigenvectors;
    let mut damped = modes;
    for (i, &value) in springs.eigenvalues.iter().enumerate() {
        damped.column_mut(i).scale_mut(2.0 * ratio * value.max(0.0).sqrt());
    }
    damped * modes.transpose()
}

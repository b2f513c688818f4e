//! Feedback law of a Cartesian task: stiffness, damping and integral of each axis.

use crate::axis_mode::AxisMode;
use crate::error::{ControlError, Reason};
use crate::references::reference::CartesianReference;
use crate::tasks::axes::required;
use crate::tasks::cartesian_parameters::{COMPLIANT_DAMPING_PER_S, CartesianParameters};
use crate::tasks::cartesian_target::AxisSettings;
use crate::tasks::force_parameters::default_force_damping;
use crate::tasks::gains::AxisGains;
use crate::tasks::impedance::Impedance;
use nalgebra::Vector6;
use opspace_backend::quantity::NonNegative;

impl MotionGains {
    fn new(gains: &AxisGains, axis: usize, period_s: f64) -> Option<Self> {
        let frequency_rad_per_s = gains.frequency_rad_per_s.get(axis)?.get();
        let damping_ratio = gains.damping_ratio.get(axis)?.get();
        let integral_per_s = gains.integral_per_s.get(axis).map_or(0.0, NonNegative::get);
        let integral_step = integral_per_s * period_s;
        let limits = if axis < 3 { &gains.integral_limit_m } else { &gains.integral_limit_rad };
        let limit = limits.get(axis).filter(|_| integral_step > 0.0);
        let integral_limit = limit.map_or(0.0, NonNegative::get);
        Some(Self { frequency_rad_per_s, damping_ratio, integral_per_s, integral_step, integral_limit })
    }
}

/// Feedback of a task's axes.
#[derive(Clone, Debug)]
pub(crate) struct AxisFeedback {
    /// Stiffness of the axes, 1/s².
    pub stiffness: Vector6<f64>,
    /// Damping of the axes, 1/s.
    pub damping: Vector6<f64>,
    pub impedance: Option<Impedance>,
    /// Fraction of the error that is added to the integral per control period.
    pub integral_step: Vector6<f64>,
    /// Upper bound of the integral, m or rad.
    pub integral_limit: Vector6<f64>,
    pub integral: Vector6<f64>,
    /// Integral gain, 1/s.
    pub integral_per_s: Vector6<f64>,
    /// Motion gains of the axes that have them.
    motion: [Option<MotionGains>; 6],
    /// Damping of an axis that is compliant, 1/s.
    compliant_damping: Vector6<f64>,
    /// Damping of an axis in force control, 1/s.
    force_damping: Vector6<f64>,
}

/// Gains of a motion axis.
#[derive(Clone, Copy, Debug)]
struct MotionGains {
    frequency_rad_per_s: f64,
    damping_ratio: f64,
    integral_per_s: f64,
    integral_step: f64,
    integral_limit: f64,
}

impl AxisFeedback {
    pub(crate) fn new(
        parameters: &CartesianParameters,
        period_s: f64,
        key: &str,
    ) -> Result<Self, ControlError> {
        let at = |place: &'static str| move |reason| ControlError::new(format!("{key}.{place}"), reason);
        let zero = Vector6::zeros();
        let mut feedback = Self {
            stiffness: zero,
            damping: zero,
            impedance: None,
            integral_step: zero,
            integral_limit: zero,
            integral: zero,
            integral_per_s: zero,
            motion: [0, 1, 2, 3, 4, 5].map(|axis| {
                parameters.gains.as_ref().and_then(|gains| MotionGains::new(gains, axis, period_s))
            }),
            compliant_damping: zero,
            force_damping: zero,
        };
        let modes = parameters.axes.modes();
        let compliant = modes.map(|mode| mode == AxisMode::Compliant);
        let damping = parameters.compliant_damping_per_s;
        let is_streamed = matches!(parameters.reference, CartesianReference::Streamed(_));
        if damping.is_some() && !compliant.contains(&true) && !is_streamed {
            return Err(at("compliant_damping_per_s")(Reason::NothingDamped));
        }
        for (axis, mode) in modes.into_iter().enumerate() {
            let given = damping.and_then(|damping| damping.get(axis)).map(NonNegative::get);
            feedback.compliant_damping[axis] = given.unwrap_or(COMPLIANT_DAMPING_PER_S);
            let force = parameters.force.as_ref();
            feedback.force_damping[axis] =
                force.map_or_else(|| default_force_damping(period_s), |force| force.damping(axis, period_s));
            feedback.damping[axis] = feedback.damping_without_reference(axis, mode);
            if let (true, Some(damping)) = (compliant[axis], &damping) {
                required(damping, axis).map_err(at("compliant_damping_per_s"))?;
            }
        }
        let (motion, sensed) = (parameters.motion_axes(), parameters.force.is_some());
        match (&parameters.gains, &parameters.impedance) {
            (Some(_), Some(_)) => return Err(at("impedance")(Reason::GainsTwice)),
            (None, None) if motion.contains(&true) => {
                return Err(ControlError::new(key, Reason::NoGains));
            }
            (None, None) => {}
            (None, Some(impedance)) => {
                feedback.impedance =
                    Some(Impedance::new(impedance, motion, sensed, &format!("{key}.impedance"))?);
            }
            (Some(gains), None) => {
                for axis in (0..6).filter(|&axis| motion[axis]) {
                    feedback.follow(axis, gains, period_s, key)?;
                }
            }
        }
        Ok(feedback)
    }

    /// Damping of an axis that follows no reference, 1/s.
    fn damping_without_reference(&self, axis: usize, mode: AxisMode) -> f64 {
        match mode {
            AxisMode::Compliant => self.compliant_damping[axis],
            AxisMode::Force => self.force_damping[axis],
            AxisMode::Motion | AxisMode::Free => 0.0,
        }
    }

    /// Returns true if the axis has motion gains.
    pub(crate) fn can_follow(&self, axis: usize) -> bool {
        self.motion[axis].is_some()
    }

    /// Sets the gains of an axis for a mode; streamed gains replace the configured ones. Resets the integral of an axis
    /// that is not in motion.
    pub(crate) fn set(&mut self, axis: usize, mode: AxisMode, streamed: &AxisSettings) {
        let motion = self.motion[axis].filter(|_| mode == AxisMode::Motion);
        let [stiffness, damping] = match (&motion, mode) {
            (Some(gains), _) => {
                let omega = streamed.frequency_rad_per_s.unwrap_or(gains.frequency_rad_per_s);
                let zeta = streamed.damping_ratio.unwrap_or(gains.damping_ratio);
                [omega * omega, 2.0 * zeta * omega]
            }
            (None, mode) => [0.0, self.damping_without_reference(axis, mode)],
        };
        self.stiffness[axis] = stiffness;
        self.damping[axis] = damping;
        self.integral_per_s[axis] = motion.map_or(0.0, |gains| gains.integral_per_s);
        self.integral_step[axis] = motion.map_or(0.0, |gains| gains.integral_step);
        self.integral_limit[axis] = motion.map_or(0.0, |gains| gains.integral_limit);
        if mode != AxisMode::Motion {
            self.integral[axis] = 0.0;
        }
    }

    fn follow(
        &mut self,
        axis: usize,
        gains: &AxisGains,
        period_s: f64,
        key: &str,
    ) -> Result<(), ControlError> {
        let at =
            |place: &'static str| move |reason| ControlError::new(format!("{key}.gains.{place}"), reason);
        let omega = required(&gains.frequency_rad_per_s, axis).map_err(at("frequency_rad_per_s"))?.get();
        let zeta = required(&gains.damping_ratio, axis).map_err(at("damping_ratio"))?.get();
        self.stiffness[axis] = omega * omega;
        self.damping[axis] = 2.0 * zeta * omega;
        // An axis that is not named has no integral gain.
        self.integral_per_s[axis] = gains.integral_per_s.get(axis).map_or(0.0, NonNegative::get);
        self.integral_step[axis] = self.integral_per_s[axis] * period_s;
        if self.integral_step[axis] > 0.0 {
            let (limits, place) = if axis < 3 {
                (&gains.integral_limit_m, "integral_limit_m")
            } else {
                (&gains.integral_limit_rad, "integral_limit_rad")
            };
            self.integral_limit[axis] = required(limits, axis).map_err(at(place))?.get();
        }
        Ok(())
    }
}

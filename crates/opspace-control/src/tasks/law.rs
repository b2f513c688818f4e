//! The law of a Cartesian task: how hard an error and a velocity are answered, axis by axis.

use crate::error::{ControlError, Reason};
use crate::tasks::axes::required;
use crate::tasks::cartesian_parameters::CartesianParameters;
use crate::tasks::gains::AxisGains;
use crate::tasks::impedance::Impedance;
use nalgebra::Vector6;
use opspace_backend::quantity::NonNegative;

/// How a task follows.
#[derive(Clone, Debug)]
pub(crate) struct Law {
    /// Of the error (1/s²) and of the velocity (1/s), in the order of the axes.
    pub stiffness: Vector6<f64>,
    pub damping: Vector6<f64>,
    pub impedance: Option<Impedance>,
    /// What of the error is added in a period, and at most.
    pub integral_step: Vector6<f64>,
    pub integral_limit: Vector6<f64>,
    pub integral: Vector6<f64>,
}

impl Law {
    pub(crate) fn new(
        parameters: &CartesianParameters,
        period_s: f64,
        key: &str,
    ) -> Result<Self, ControlError> {
        let at = |place: &'static str| move |reason| ControlError::new(format!("{key}.{place}"), reason);
        let zero = Vector6::zeros();
        let mut law = Self {
            stiffness: zero,
            damping: zero,
            impedance: None,
            integral_step: zero,
            integral_limit: zero,
            integral: zero,
        };
        for (axis, _) in parameters.held_to_force().iter().enumerate().filter(|(_, held)| **held) {
            let c = required(&parameters.compliant_damping_per_s, axis);
            law.damping[axis] = c.map_err(at("compliant_damping_per_s"))?.get();
        }
        let (motion, sensed) = (parameters.motion_axes(), parameters.force.is_some());
        match (&parameters.gains, &parameters.impedance) {
            (Some(_), Some(_)) => return Err(at("impedance")(Reason::GainsTwice)),
            (None, None) if motion.contains(&true) => {
                return Err(ControlError::new(key, Reason::NoGains));
            }
            (None, None) => {}
            (None, Some(impedance)) => {
                law.impedance = Some(Impedance::new(impedance, motion, sensed, &format!("{key}.impedance"))?);
            }
            (Some(gains), None) => {
                for axis in (0..6).filter(|&axis| motion[axis]) {
                    law.follow(axis, gains, period_s, key)?;
                }
            }
        }
        Ok(law)
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
        // An axis that isn't named has none.
        self.integral_step[axis] = gains.integral_per_s.get(axis).map_or(0.0, NonNegative::get) * period_s;
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

//! What a measured state must satisfy for a run to go on.

use crate::fault::Fault;
use crate::parameters::SafetyParameters;
use crate::robot::Sample;
use opspace_control::Measurement;
use opspace_model::Model;

/// Checks every tick; allocates nothing.
#[derive(Clone, Debug)]
pub struct Supervisor {
    joints: Vec<Bounds>,
    last_time_s: f64,
}

#[derive(Clone, Copy, Debug)]
struct Bounds {
    lower: f64,
    upper: f64,
    velocity: f64,
}

impl Supervisor {
    /// For the limits in the URDF, widened by the margin.
    #[must_use]
    pub fn new(model: &Model, safety: &SafetyParameters) -> Self {
        let margin = safety.limit_margin_rad.get();
        let joints = (model.joints().iter())
            .map(|j| Bounds {
                lower: j.limits.lower - margin,
                upper: j.limits.upper + margin,
                velocity: j.limits.velocity,
            })
            .collect();
        Self { joints, last_time_s: f64::NEG_INFINITY }
    }

    /// Checks what the robot reported, before anything is computed from it.
    ///
    /// # Errors
    /// Numbers that are not finite; a clock that didn't move on.
    pub fn check_sample(&mut self, sample: &Sample) -> Result<(), Fault> {
        let not_finite = |v: &f64| !v.is_finite();
        if let Some(joint) = sample.q.iter().position(not_finite) {
            return Err(Fault::MeasurementNotFinite { joint });
        }
        if let Some(joint) = sample.motor_torque.iter().flatten().position(not_finite) {
            return Err(Fault::MeasurementNotFinite { joint });
        }
        let broken = sample.wrenches.iter().position(|w| w.linear.iter().chain(&w.angular).any(not_finite));
        if let Some(sensor) = broken {
            return Err(Fault::SensorNotFinite { sensor });
        }
        let before_s = std::mem::replace(&mut self.last_time_s, sample.time_s);
        if sample.time_s > before_s { Ok(()) } else { Err(Fault::Clock { before_s, now_s: sample.time_s }) }
    }

    /// Checks the state against the robot's limits.
    ///
    /// # Errors
    /// The first joint beyond a limit.
    pub fn check_state(&self, measurement: &Measurement) -> Result<(), Fault> {
        for (joint, bounds) in self.joints.iter().enumerate() {
            let (q, dq) = (measurement.q[joint], measurement.dq[joint]);
            if q < bounds.lower || q > bounds.upper {
                return Err(Fault::JointLimit { joint, q, lower: bounds.lower, upper: bounds.upper });
            }
            if dq.abs() > bounds.velocity {
                return Err(Fault::Speed { joint, dq, limit: bounds.velocity });
            }
        }
        Ok(())
    }
}

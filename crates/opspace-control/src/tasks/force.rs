//! Force feedback of a Cartesian task: the force that is added on compliant and force axes.

use crate::context::ControlContext;
use crate::error::{ControlError, Reason};
use crate::measurement::Measurement;
use crate::tasks::axes::{AXIS_NAMES, Axes, AxisMode, PerAxis, required};
use crate::tasks::gains::integrate;
use nalgebra::{Matrix3, Vector3, Vector6};
use opspace_backend::LowPass;
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_model::{Data, FrameId, Model, frame_placement};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Feedback of a force sensor to the compliant and force axes.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct ForceParameters {
    /// Name of the robot's force sensor.
    pub sensor: String,
    /// Force that the environment should exert ON the robot along these axes, N; 0 if absent.
    #[serde(default = "no_target")]
    pub target_n: PerAxis<f64>,
    /// Moment that the environment should exert ON the robot about these axes, Nm; 0 if absent.
    #[serde(default = "no_target")]
    pub target_nm: PerAxis<f64>,
    /// Gain of the force error; 2 if absent.
    #[serde(default = "default_force_gain")]
    pub gain: PerAxis<NonNegative>,
    /// Integral gain of a force axis, 1/s: fraction of the force error that is added to the force per second; 5 if
    /// absent.
    #[serde(default)]
    pub integral_per_s: Option<PerAxis<NonNegative>>,
    /// Upper bound of the integral of a force axis, which prevents windup without contact, N or Nm; the magnitude of
    /// the target if absent.
    #[serde(default)]
    pub integral_limit: Option<PerAxis<NonNegative>>,
    /// −3 dB frequency of the low-pass filter of the sensed force, Hz; 100 if absent.
    #[serde(default = "default_filter_hz")]
    pub filter_hz: Positive,
}

fn no_target() -> PerAxis<f64> {
    PerAxis::All(0.0)
}

fn default_force_gain() -> PerAxis<NonNegative> {
    PerAxis::All(NonNegative::literal(FORCE_GAIN))
}

fn default_filter_hz() -> Positive {
    Positive::literal(100.0)
}

impl ForceParameters {
    /// Returns the feedback of a sensor, by name, without a target force and with the other defaults of files.
    #[must_use]
    pub fn new(sensor: impl Into<String>) -> Self {
        Self {
            sensor: sensor.into(),
            target_n: no_target(),
            target_nm: no_target(),
            gain: default_force_gain(),
            integral_per_s: None,
            integral_limit: None,
            filter_hz: default_filter_hz(),
        }
    }

    /// Force (N) and moment (Nm) that the environment should exert ON the robot, in the task axes; 0 on axes that are
    /// neither compliant nor in force control.
    #[must_use]
    pub fn target(&self, axes: &Axes) -> Vector6<f64> {
        let held = axes.force_axes();
        Vector6::from_fn(|axis, _| {
            let targets = if axis < 3 { &self.target_n } else { &self.target_nm };
            if held[axis] { targets.get(axis).unwrap_or(0.0) } else { 0.0 }
        })
    }
}

/// Default force gain.
const FORCE_GAIN: f64 = 2.0;

/// Default integral gain of force axes, 1/s.
const INTEGRAL_PER_S: f64 = 5.0;

/// Settings of an axis that is compliant or in force control.
#[derive(Clone, Copy, Debug)]
struct AxisForce {
    target: f64,
    gain: f64,
    integral_step: f64,
    /// Upper bound of the force integral, N or Nm; `None` for the magnitude of the target.
    integral_limit: Option<f64>,
}

impl AxisForce {
    fn new(force: &ForceParameters, axis: usize, period_s: f64) -> Self {
        let targets = if axis < 3 { &force.target_n } else { &force.target_nm };
        let per_s = force.integral_per_s.and_then(|gains| gains.get(axis));
        Self {
            target: targets.get(axis).unwrap_or(0.0),
            gain: force.gain.get(axis).unwrap_or(NonNegative::literal(FORCE_GAIN)).get(),
            integral_step: per_s.map_or(INTEGRAL_PER_S, NonNegative::get) * period_s,
            integral_limit: force.integral_limit.and_then(|limits| limits.get(axis)).map(NonNegative::get),
        }
    }
}

/// Force feedback of a task, with its state.
#[derive(Clone, Debug)]
pub(crate) struct ForceFeedback {
    sensor: usize,
    frame: FrameId,
    target: Vector6<f64>,
    /// Force gain; 0 on axes that are not compliant or force axes.
    gain: Vector6<f64>,
    held: [bool; 6],
    /// Fraction of the error that is added to the integral per control period; 0 except on force axes.
    integral_step: Vector6<f64>,
    /// Upper bound of the integral, N or Nm; 0 except on force axes.
    integral_limit: Vector6<f64>,
    integral: Vector6<f64>,
    filter: LowPass<6>,
    /// Settings of each axis, for any mode.
    axes: [AxisForce; 6],
    /// Sensed force at the task frame's origin, in the task axes (N, Nm).
    pub(crate) sensed: Vector6<f64>,
}

impl ForceFeedback {
    pub(crate) fn new(
        force: &ForceParameters,
        axes: &Axes,
        shapes_inertia: bool,
        context: &ControlContext,
        key: &str,
    ) -> Result<Self, ControlError> {
        let at = |place: &str, reason: Reason| ControlError::new(format!("{key}.{place}"), reason);
        let known = || context.sensors.iter().map(|(name, _)| name.clone()).collect();
        let Some(sensor) = context.sensors.iter().position(|(name, _)| *name == force.sensor) else {
            return Err(at("sensor", Reason::Sensor { name: force.sensor.clone(), known: known() }));
        };
        let held = axes.force_axes();
        if !held.contains(&true) && !shapes_inertia {
            return Err(ControlError::new(key, Reason::NothingCompliant));
        }
        for (place, targets, kind, what) in [
            ("target_n", &force.target_n, 0..3, "force (N)"),
            ("target_nm", &force.target_nm, 3..6, "moment (Nm)"),
        ] {
            if let Some(axis) = targets.named().find(|axis| !kind.contains(axis) || !held[*axis]) {
                return Err(at(place, Reason::TargetAxis { axis: AXIS_NAMES[axis], what }));
            }
        }
        let target = force.target(axes);
        let [mut gain, mut integral_step, mut integral_limit] = [Vector6::zeros(); 3];
        for axis in (0..6).filter(|&axis| held[axis]) {
            gain[axis] = required(&force.gain, axis).map_err(|reason| at("gain", reason))?.get();
        }
        let in_force_control = axes.with_mode(AxisMode::Force);
        for (place, given) in [
            ("integral_per_s", force.integral_per_s.is_some()),
            ("integral_limit", force.integral_limit.is_some()),
        ] {
            if given && !in_force_control.contains(&true) {
                return Err(at(place, Reason::NothingIntegrates));
            }
        }
        for axis in (0..6).filter(|&axis| in_force_control[axis]) {
            let per_s = match &force.integral_per_s {
                None => INTEGRAL_PER_S,
                Some(gains) => required(gains, axis).map_err(|reason| at("integral_per_s", reason))?.get(),
            };
            integral_step[axis] = per_s * context.period_s;
            integral_limit[axis] = match &force.integral_limit {
                None => target[axis].abs(),
                Some(limits) => required(limits, axis).map_err(|reason| at("integral_limit", reason))?.get(),
            };
        }
        let axes = std::array::from_fn(|axis| AxisForce::new(force, axis, context.period_s));
        Ok(Self {
            sensor,
            frame: context.sensors[sensor].1,
            target,
            gain,
            held,
            integral_step,
            integral_limit,
            integral: Vector6::zeros(),
            filter: LowPass::new(force.filter_hz.get(), context.period_s),
            axes,
            sensed: Vector6::zeros(),
        })
    }

    /// Sets the settings of an axis for a mode; a streamed target force (N, Nm) replaces the configured one. Resets the
    /// integral of an axis that is not in force control.
    pub(crate) fn set(&mut self, axis: usize, mode: AxisMode, target: Option<f64>) {
        let configured = &self.axes[axis];
        let held = matches!(mode, AxisMode::Compliant | AxisMode::Force);
        let integrates = mode == AxisMode::Force;
        self.held[axis] = held;
        self.target[axis] = if held { target.unwrap_or(configured.target) } else { 0.0 };
        self.gain[axis] = if held { configured.gain } else { 0.0 };
        self.integral_step[axis] = if integrates { configured.integral_step } else { 0.0 };
        let limit = configured.integral_limit.unwrap_or(self.target[axis].abs());
        self.integral_limit[axis] = if integrates { limit } else { 0.0 };
        if !integrates {
            self.integral[axis] = 0.0;
        }
    }

    /// Initialises the filter with the current measurement and resets the integrals.
    pub(crate) fn start(&mut self, measurement: &Measurement) {
        let raw = self.raw(measurement);
        self.filter.reset(&raw);
        self.integral.fill(0.0);
    }

    /// Continues from the force feedback of another task set: takes over the filter state if the sensor is the same,
    /// and the integral on axes that remain in force control.
    pub(crate) fn inherit_state(&mut self, before: &Self, measurement: &Measurement) {
        self.start(measurement);
        if self.sensor == before.sensor {
            self.filter.reset(before.filter.output());
        }
        for axis in (0..6).filter(|&axis| self.integral_step[axis] > 0.0) {
            self.integral[axis] =
                before.integral[axis].clamp(-self.integral_limit[axis], self.integral_limit[axis]);
        }
    }

    fn raw(&self, measurement: &Measurement) -> [f64; 6] {
        let f = &measurement.wrenches[self.sensor];
        [f.linear.x, f.linear.y, f.linear.z, f.angular.x, f.angular.y, f.angular.z]
    }

    /// Updates the sensed force at `point` (m, world), in `axes` (world). The integrals do not change while `hold` is
    /// true.
    pub(crate) fn update(
        &mut self,
        model: &Model,
        data: &Data,
        measurement: &Measurement,
        axes: &Matrix3<f64>,
        point: &Vector3<f64>,
        hold: bool,
    ) {
        let raw = self.raw(measurement);
        let [fx, fy, fz, mx, my, mz] = self.filter.update(&raw);
        let force = Vector3::new(fx, fy, fz);
        let lever = frame_placement(model, data, self.frame).translation - point;
        let (linear, angular) =
            (axes.tr_mul(&force), axes.tr_mul(&(Vector3::new(mx, my, mz) + lever.cross(&force))));
        self.sensed = Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z);
        if hold {
            return;
        }
        let error = self.sensed - self.target;
        integrate(&mut self.integral, &error, &self.integral_step, &self.integral_limit);
    }

    /// Returns the force that is added to the task force (N, Nm; task axes).
    pub(crate) fn added(&self) -> Vector6<f64> {
        Vector6::from_fn(|i, _| {
            if !self.held[i] {
                return 0.0;
            }
            self.gain[i] * (self.sensed[i] - self.target[i]) + self.integral[i] - self.target[i]
        })
    }
}

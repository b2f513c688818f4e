//! Force feedback of a Cartesian task: the force that is added on compliant and force axes, and on motion axes that
//! compensate the sensed force.
//!
//! ```text
//! compliant   F = −f_d + k (f − f_d)
//! force       F = −γ f_d + s k (f − f_d) + ∫ s i (f − f_d) dt        (force_axis)
//! motion      F = −share f
//! ```

use crate::axis_mode::AxisMode;
use crate::context::ControlContext;
use crate::error::{ControlError, Reason};
use crate::measurement::Measurement;
use crate::tasks::axes::{AXIS_NAMES, Axes, required};
use crate::tasks::force_axis::{AxisMotion, ForceAxis};
use crate::tasks::force_parameters::ForceParameters;
use crate::tasks::sensed_force::SensedForce;
use nalgebra::{Matrix3, Vector3, Vector6};
use opspace_backend::SignalRecorder;
use opspace_backend::signal_names::{
    CONTACT, FORCE_ENERGY, FORCE_GAIN_SHARE, PASSIVITY_TIME, SENSED_FORCE, TARGET_FORCE,
};
use opspace_model::{Data, Model};

/// Force feedback of a task, with its state.
#[derive(Clone, Debug)]
pub(crate) struct ForceFeedback {
    sensor: SensedForce,
    axes: [ForceAxis; 6],
    /// True if an axis can be in force control, so that its signals are recorded.
    pub(crate) records_control: bool,
    /// Time of the measurement at which the task began, s.
    start_s: f64,
    /// Time since then, s.
    time_s: f64,
    period_s: f64,
    /// Point of the last cycle, m.
    point: Vector3<f64>,
    /// Sensed force at the task frame's origin, in the task axes (N, Nm).
    pub(crate) sensed: Vector6<f64>,
}

/// Robot and controlled frame in a cycle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ForceInput<'a> {
    pub model: &'a Model,
    pub data: &'a Data,
    pub measurement: &'a Measurement,
    /// Task axes in the world, one per column.
    pub rotation: Matrix3<f64>,
    /// Origin of the controlled frame in the world, m.
    pub point: Vector3<f64>,
    /// Velocity of the frame in the task axes (m/s, rad/s).
    pub velocity: Vector6<f64>,
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
        if let Some(gain) = &force.gain {
            for axis in (0..6).filter(|&axis| held[axis]) {
                required(gain, axis).map_err(|reason| at("gain", reason))?;
            }
        }
        let in_force_control = axes.with_mode(AxisMode::Force);
        force.check_profiles(in_force_control, key)?;
        for (place, given) in [
            ("integral_per_s", &force.integral_per_s),
            ("integral_limit", &force.integral_limit),
            ("damping_per_s", &force.damping_per_s),
        ] {
            let Some(given) = given else { continue };
            if !in_force_control.contains(&true) {
                return Err(at(place, Reason::NothingIntegrates));
            }
            for axis in (0..6).filter(|&axis| in_force_control[axis]) {
                required(given, axis).map_err(|reason| at(place, reason))?;
            }
        }
        let modes = axes.modes();
        Ok(Self {
            sensor: SensedForce::new(
                sensor,
                context.sensors[sensor].1,
                force.filter_hz.get(),
                context.period_s,
            ),
            axes: std::array::from_fn(|axis| ForceAxis::new(force, axis, modes[axis], context.period_s)),
            records_control: in_force_control.contains(&true),
            start_s: 0.0,
            time_s: 0.0,
            period_s: context.period_s,
            point: Vector3::zeros(),
            sensed: Vector6::zeros(),
        })
    }

    /// Sets the mode of an axis; a streamed target force (N, Nm) replaces the configured one. Resets the integral of an axis
    /// that is not in force control.
    pub(crate) fn set(&mut self, axis: usize, mode: AxisMode, target: Option<f64>) {
        self.axes[axis].set(mode, target);
    }

    /// Initialises the filter with the current measurement and resets the integrals.
    pub(crate) fn start(&mut self, input: &ForceInput<'_>) {
        self.start_s = input.measurement.time_s;
        self.time_s = 0.0;
        self.point = input.point;
        let raw = self.sensor.start(input.measurement);
        self.sensed = self.sensed_at(input, &raw);
        for (axis, &sensed) in self.axes.iter_mut().zip(&self.sensed) {
            axis.start(sensed);
        }
    }

    /// Continues from the force feedback of another task set, after [`start`](Self::start): takes over the filter state if the
    /// sensor is the same, and the state of axes that remain in force control.
    pub(crate) fn inherit_state(&mut self, before: &Self) {
        self.sensor.inherit_state(&before.sensor);
        for (axis, before) in self.axes.iter_mut().zip(&before.axes) {
            axis.inherit_state(before);
        }
    }

    /// Converts a reading of the sensor (N, Nm; world axes) to force and moment at the task frame's origin, in the task axes.
    fn sensed_at(&self, input: &ForceInput<'_>, reading: &[f64; 6]) -> Vector6<f64> {
        let ForceInput { model, data, rotation, point, .. } = input;
        self.sensor.at((model, data), reading, point, rotation)
    }

    /// Updates the sensed force and the axes. The feedback does not change while `hold` is true.
    pub(crate) fn update(&mut self, input: &ForceInput<'_>, hold: bool) {
        let moved = input.rotation.tr_mul(&(input.point - self.point));
        self.sense(input);
        if hold {
            return;
        }
        for (i, axis) in self.axes.iter_mut().enumerate() {
            let velocity = input.velocity[i];
            let displacement = if i < 3 { moved[i] } else { velocity * self.period_s };
            axis.update(self.sensed[i], AxisMotion { velocity, displacement }, self.time_s);
        }
    }

    /// Updates the sensed force as [`update`](Self::update) does, and the targets and contacts, but no feedback.
    pub(crate) fn update_targets(&mut self, input: &ForceInput<'_>) {
        self.sense(input);
        for (i, axis) in self.axes.iter_mut().enumerate() {
            axis.update_target(self.sensed[i], input.velocity[i], self.time_s);
        }
    }

    fn sense(&mut self, input: &ForceInput<'_>) {
        self.time_s = input.measurement.time_s - self.start_s;
        self.point = input.point;
        let filtered = self.sensor.update(input.measurement);
        self.sensed = self.sensed_at(input, &filtered);
    }

    /// Sensed force of an axis minus its target, N or Nm.
    pub(crate) fn error(&self, axis: usize) -> f64 {
        self.sensed[axis] - self.axes[axis].target
    }

    /// True if all axes that approach until they touch are in contact; `None` if there is no such axis.
    pub(crate) fn contact_made(&self) -> Option<bool> {
        let mut made = self.axes.iter().filter_map(ForceAxis::contact_made).peekable();
        made.peek()?;
        Some(made.all(|made| made))
    }

    /// Velocity of an axis while it approaches, m/s; `None` in contact.
    pub(crate) fn approach_velocity(&self, axis: usize) -> Option<f64> {
        let axis = &self.axes[axis];
        axis.approaches().then(|| axis.approach_speed(self.time_s))
    }

    /// Acceleration that is added to the damping (1/s) of an axis while it approaches, m/s².
    pub(crate) fn approach_acceleration(&self, axis: usize, damping: f64) -> f64 {
        self.axes[axis].approach_acceleration(damping, self.time_s)
    }

    /// Returns the force that is added to the task force (N, Nm; task axes).
    pub(crate) fn added(&self) -> Vector6<f64> {
        Vector6::from_fn(|i, _| self.axes[i].added(self.sensed[i]))
    }

    /// Records the signals of the task `name`.
    pub(crate) fn record(&self, name: &str, out: &mut SignalRecorder<'_>) {
        out.signal((name, SENSED_FORCE), "N,Nm", &AXIS_NAMES, self.sensed.as_slice());
        if !self.records_control {
            return;
        }
        let mut of_axes = |signal: &'static str, unit: &str, value: fn(&ForceAxis) -> f64| {
            out.signal((name, signal), unit, &AXIS_NAMES, &self.axes.each_ref().map(value));
        };
        of_axes(TARGET_FORCE, "N,Nm", |axis| axis.target);
        of_axes(CONTACT, "1", ForceAxis::contact_code);
        of_axes(FORCE_ENERGY, "J", |axis| axis.passivity.energy_j());
        of_axes(FORCE_GAIN_SHARE, "1", |axis| axis.passivity.share());
        of_axes(PASSIVITY_TIME, "s", |axis| axis.passivity.active_s());
    }
}

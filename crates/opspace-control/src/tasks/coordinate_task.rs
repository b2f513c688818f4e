//! Task of a [`Coordinate`]: up to six functions of the joint positions follow references.
//!
//! ```text
//! a* = ẍ_d + 2ζω (ẋ_d − ẋ) + ω² (x_d − x + ∫ integral gain (x_d − x) dt, bounded)
//! ```
//!
//! A speed limit bounds the desired speed and keeps its direction, as in a Cartesian task.

use crate::controller::ControlInput;
use crate::error::ControlError;
use crate::references::scalar_reference::{ScalarReference, ScalarTrajectory};
use crate::tasks::coordinate::Coordinate;
use crate::tasks::damping_zone::DampingZone;
use crate::tasks::task::{DEFAULT_INVERSION, RowGains, SpeedLimit, Task, TaskInput, TaskSignals};
use nalgebra::{Matrix6xX, Vector6};
use opspace_backend::SignalRecorder;
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_backend::signal_names::{ERROR, REFERENCE, REFERENCE_VELOCITY, VALUE, VELOCITY};
use opspace_model::{Data, Inversion, Model};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::any::Any;

/// Feedback of a coordinate: a unit mass with a spring and a damper, independent of the arm's inertia.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct CoordinateGains {
    /// Natural frequency ω of the error, rad/s: the stiffness is ω² (1/s²).
    pub frequency_rad_per_s: Positive,
    /// Damping ratio ζ of the error: the damping is 2ζω (1/s).
    pub damping_ratio: NonNegative,
    /// Integral gain, 1/s: fraction of the error that is added to the integral per second.
    #[serde(default)]
    pub integral_per_s: NonNegative,
    /// Upper bound of the integral, rad (m for a length).
    #[serde(default = "default_integral_limit")]
    pub integral_limit_rad: NonNegative,
}

fn default_integral_limit() -> NonNegative {
    NonNegative::literal(0.2)
}

impl CoordinateGains {
    /// Creates gains with a natural frequency (rad/s) and a damping ratio, without integral.
    ///
    /// # Errors
    /// A frequency that is not positive, a negative ratio.
    pub fn new(frequency_rad_per_s: f64, damping_ratio: f64) -> Result<Self, ControlError> {
        let frequency = Positive::try_from(frequency_rad_per_s);
        let ratio = NonNegative::try_from(damping_ratio);
        Ok(Self {
            frequency_rad_per_s: frequency
                .map_err(|message| ControlError::value("frequency_rad_per_s", message))?,
            damping_ratio: ratio.map_err(|message| ControlError::value("damping_ratio", message))?,
            integral_per_s: NonNegative::default(),
            integral_limit_rad: default_integral_limit(),
        })
    }
}

/// A task whose rows are the elements of a coordinate.
pub struct CoordinateTask<C> {
    name: String,
    rows_key: String,
    coordinate: C,
    /// Names of the elements; the next two fields are the units of the elements and of their derivatives.
    elements: Vec<&'static str>,
    units: Vec<&'static str>,
    rate_units: Vec<String>,
    references: Vec<ScalarReference>,
    trajectories: Vec<ScalarTrajectory>,
    gains: CoordinateGains,
    /// Speed limit, rad/s or m/s; infinite if there is none.
    speed_limit: f64,
    inversion: Inversion,
    /// Start time of the trajectories, s.
    start_s: f64,
    /// Values at the start of the run.
    home: Vector6<f64>,
    /// Time of the last update, s.
    updated_s: f64,
    value: Vector6<f64>,
    velocity: Vector6<f64>,
    /// Target and its first two derivatives.
    target: [Vector6<f64>; 3],
    /// References without blending, and their derivatives.
    path: [Vector6<f64>; 2],
    error: Vector6<f64>,
    integral: Vector6<f64>,
    jacobian: Matrix6xX<f64>,
}

impl<C: Coordinate> CoordinateTask<C> {
    /// Creates a task that holds the coordinate at its start value.
    #[must_use]
    pub fn new(name: impl Into<String>, coordinate: C, gains: CoordinateGains) -> Self {
        let rows = coordinate.rows();
        let (name, zero) = (name.into(), Vector6::zeros());
        let references = vec![ScalarReference::Hold; rows];
        let (elements, units): (Vec<_>, Vec<_>) = (0..rows).map(|row| coordinate.element(row)).unzip();
        Self {
            rows_key: format!("task.{name}"),
            name,
            trajectories: references.iter().map(ScalarTrajectory::new).collect(),
            references,
            coordinate,
            elements,
            rate_units: units.iter().map(|unit| format!("{unit}/s")).collect(),
            units,
            gains,
            speed_limit: f64::INFINITY,
            inversion: DEFAULT_INVERSION,
            start_s: 0.0,
            home: zero,
            updated_s: 0.0,
            value: zero,
            velocity: zero,
            target: [zero; 3],
            path: [zero; 2],
            error: zero,
            integral: zero,
            jacobian: Matrix6xX::zeros(0),
        }
    }

    /// Sets one reference per element, in order; elements without a reference hold their start value.
    #[must_use]
    pub fn with_references(mut self, references: impl IntoIterator<Item = ScalarReference>) -> Self {
        self.references = references.into_iter().take(self.coordinate.rows()).collect();
        self.references.resize(self.coordinate.rows(), ScalarReference::Hold);
        self.trajectories = self.references.iter().map(ScalarTrajectory::new).collect();
        self
    }

    /// Sets the limit of the norm of the elements' velocities, rad/s (m/s).
    #[must_use]
    pub fn with_speed_limit(self, speed_limit: Positive) -> Self {
        Self { speed_limit: speed_limit.get(), ..self }
    }

    /// Sets a fixed threshold below which directions are damped, relative to the typical mobility.
    #[must_use]
    pub fn with_singularity_threshold(self, threshold: Positive) -> Self {
        Self { inversion: Inversion::Damped(threshold.get()), ..self }
    }

    /// Sets the zone below which directions are damped, which grows with the demand.
    ///
    /// # Errors
    /// Thresholds that are not in order.
    pub fn with_damping_zone(self, zone: &DampingZone) -> Result<Self, ControlError> {
        zone.check(self.inversion != DEFAULT_INVERSION, &self.rows_key)?;
        Ok(Self { inversion: zone.inversion(), ..self })
    }

    /// Sets the key of the task's table in a file, for errors.
    #[must_use]
    pub(crate) fn with_rows_key(self, rows_key: String) -> Self {
        Self { rows_key, ..self }
    }

    fn begin(&mut self, from: [Vector6<f64>; 3], time_s: f64) {
        self.start_s = time_s;
        for (row, trajectory) in self.trajectories.iter_mut().enumerate() {
            let difference = |to: f64, from: f64| self.coordinate.difference(row, to, from);
            trajectory.start(self.home[row], from.map(|part| part[row]), difference);
        }
    }

    fn observe_state(&mut self, input: &ControlInput<'_>) {
        self.update_state(input);
        self.updated_s = input.measurement.time_s;
    }

    /// Updates value, velocity and target.
    fn update_state(&mut self, input: &ControlInput<'_>) {
        let ControlInput { model, data, measurement, .. } = *input;
        self.value = self.coordinate.value(model, data);
        if self.jacobian.ncols() == model.n() {
            self.coordinate.jacobian(model, data, &mut self.jacobian);
            self.velocity = Vector6::zeros();
            for (column, &dq) in self.jacobian.column_iter().zip(&data.dq) {
                self.velocity += column * dq;
            }
        }
        let time_s = measurement.time_s - self.start_s;
        for (row, trajectory) in self.trajectories.iter().enumerate() {
            let [x, v, _] = trajectory.reference_at(time_s);
            (self.path[0][row], self.path[1][row]) = (x, v);
            for (part, value) in self.target.iter_mut().zip(trajectory.at(time_s)) {
                part[row] = value;
            }
            self.error[row] = self.coordinate.difference(row, self.target[0][row], self.value[row]);
        }
    }

    /// Returns `speed` as the angular speed if the first element is an angle, otherwise as the linear speed.
    fn linear_or_angular<T>(&self, speed: Option<T>) -> [Option<T>; 2] {
        if self.coordinate.element(0).1 == "rad" { [None, speed] } else { [speed, None] }
    }

    fn stiffness(&self) -> f64 {
        let omega = self.gains.frequency_rad_per_s.get();
        omega * omega
    }

    fn damping(&self) -> f64 {
        2.0 * self.gains.damping_ratio.get() * self.gains.frequency_rad_per_s.get()
    }
}

impl<C: Coordinate> Task for CoordinateTask<C> {
    fn name(&self) -> &str {
        &self.name
    }

    fn rows(&self) -> usize {
        self.coordinate.rows()
    }

    fn jacobian(&self, model: &Model, data: &Data, rows: &mut Matrix6xX<f64>) {
        self.coordinate.jacobian(model, data, rows);
    }

    fn update(&mut self, input: &TaskInput<'_>) {
        self.update_state(&input.control);
        let time_s = input.control.measurement.time_s;
        let step = self.gains.integral_per_s.get() * (time_s - self.updated_s).max(0.0);
        self.updated_s = time_s;
        let limit = self.gains.integral_limit_rad.get();
        for row in 0..self.rows() {
            if !input.limited && step > 0.0 && self.error[row].is_finite() {
                self.integral[row] = (self.integral[row] + step * self.error[row]).clamp(-limit, limit);
            }
        }
    }

    fn bias(&self, model: &Model, data: &Data) -> Vector6<f64> {
        self.coordinate.bias(model, data)
    }

    fn kinematic_target(&self, model: &Model, data: &Data, gain_per_s: f64) -> Vector6<f64> {
        let value = self.coordinate.value(model, data);
        let mut velocity = self.target[1];
        for row in 0..self.rows() {
            velocity[row] += gain_per_s * self.coordinate.difference(row, self.target[0][row], value[row]);
        }
        velocity
    }

    fn acceleration(&self) -> Vector6<f64> {
        let [_, velocity, acceleration] = &self.target;
        let (stiffness, damping) = (self.stiffness(), self.damping());
        if self.speed_limit < f64::INFINITY && damping > 0.0 {
            let asked = velocity + (self.error + self.integral) * (stiffness / damping);
            let speed = asked.norm();
            if speed > self.speed_limit {
                return (asked * (self.speed_limit / speed) - self.velocity) * damping;
            }
        }
        acceleration + (velocity - self.velocity) * damping + (self.error + self.integral) * stiffness
    }

    fn reference_acceleration(&self) -> Vector6<f64> {
        self.target[2]
    }

    fn start(&mut self, input: &ControlInput<'_>) {
        self.jacobian = Matrix6xX::zeros(input.model.n());
        self.home = self.coordinate.value(input.model, input.data);
        self.integral.fill(0.0);
        self.updated_s = input.measurement.time_s;
        self.begin([self.home, Vector6::zeros(), Vector6::zeros()], input.measurement.time_s);
        self.update_state(input);
    }

    fn observe(&mut self, input: &TaskInput<'_>) {
        self.observe_state(&input.control);
    }

    /// Replans goals from the current value at rest, blends into other references, and resets the integrals.
    fn resume(&mut self, input: &ControlInput<'_>) {
        let value = self.coordinate.value(input.model, input.data);
        let time_s = input.measurement.time_s;
        self.integral.fill(0.0);
        self.updated_s = time_s;
        for (row, trajectory) in self.trajectories.iter_mut().enumerate() {
            let away = |target: f64| self.coordinate.difference(row, value[row], target);
            let elapsed_s = time_s - self.start_s;
            let reference = trajectory.reference_at(elapsed_s)[0];
            trajectory.join(elapsed_s, away(reference));
        }
        if self.trajectories.iter().any(ScalarTrajectory::is_online) {
            self.begin([value, Vector6::zeros(), Vector6::zeros()], time_s);
        }
        self.update_state(input);
    }

    /// Unchanged references continue; different ones start at the previous targets.
    fn inherit(&mut self, before: &mut dyn Task, input: &ControlInput<'_>) {
        let same_rows = before.rows() == self.rows();
        let Some(before) = (before as &mut dyn Any).downcast_mut::<Self>().filter(|_| same_rows) else {
            return self.start(input);
        };
        before.observe_state(input);
        std::mem::swap(&mut self.jacobian, &mut before.jacobian);
        self.home = before.home;
        self.updated_s = before.updated_s;
        let limit = self.gains.integral_limit_rad.get();
        self.integral = before.integral.map(|value| value.clamp(-limit, limit));
        if self.references == before.references {
            std::mem::swap(&mut self.trajectories, &mut before.trajectories);
            self.start_s = before.start_s;
        } else {
            self.begin(before.target, input.measurement.time_s);
        }
        self.update_state(input);
    }

    fn inversion(&self) -> Inversion {
        self.inversion
    }

    fn speed_limits(&self) -> [Option<SpeedLimit>; 2] {
        let limit = self.speed_limit;
        let speed = self.velocity.norm();
        let bound = SpeedLimit { speed, limit, weights: self.velocity / speed };
        self.linear_or_angular((limit < f64::INFINITY).then_some(bound))
    }

    fn rows_key(&self) -> String {
        self.rows_key.clone()
    }

    fn kind(&self) -> &'static str {
        "coordinate"
    }

    fn row_names(&self) -> Vec<String> {
        (0..self.rows()).map(|row| self.coordinate.element(row).0.to_owned()).collect()
    }

    fn row_unit(&self, row: usize) -> (&'static str, f64) {
        (self.coordinate.element(row).1, 1.0)
    }

    fn reference_speeds(&self) -> [Option<f64>; 2] {
        self.linear_or_angular(Some(self.target[1].norm()))
    }

    fn gains(&self, _row: usize) -> Option<RowGains> {
        Some(RowGains {
            stiffness_per_s2: self.stiffness(),
            damping_per_s: self.damping(),
            integral_per_s: self.gains.integral_per_s.get(),
        })
    }

    fn record(&self, signals: TaskSignals<'_>, out: &mut SignalRecorder<'_>) {
        let TaskSignals::Motion = signals else { return self.record_force_of_rows(signals, out) };
        let Self { name, elements, units, rate_units, .. } = self;
        let rows = elements.len();
        out.signal((name, REFERENCE), units, elements, &self.path[0].as_slice()[..rows]);
        out.signal((name, VALUE), units, elements, &self.value.as_slice()[..rows]);
        out.signal((name, REFERENCE_VELOCITY), rate_units, elements, &self.path[1].as_slice()[..rows]);
        out.signal((name, VELOCITY), rate_units, elements, &self.velocity.as_slice()[..rows]);
        out.signal((name, ERROR), units, elements, &self.error.as_slice()[..rows]);
    }
}

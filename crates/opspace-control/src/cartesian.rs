//! The Cartesian task: a frame that follows a reference on some axes and gives way on others.
//!
//! On its task axes, with x the frame's pose and v its velocity (Khatib 1987, with unit-mass gains):
//!
//! ```text
//! motion     a* = ẍ_d + 2ζω (ẋ_d − v) + ω² (x_d − x)
//! compliant  a* = −c v                                 and the force  −f_target + gain (f − f_target)
//! force      a* = −c v                                 the same, and  ∫ integral gain (f − f_target) dt, bounded
//! ```
//!
//! f is the sensed force ON the robot: with gain 0 the axis pushes with the target open loop, and the
//! gain makes the hand feel 1 + gain times lighter. Moments on rotation axes likewise.

use crate::axes::{AXIS_NAMES, Axes, AxesIn, AxisMode, PerAxis};
use crate::error::{ControlError, Reason};
use crate::filter::LowPass;
use crate::joint_reference::check_times;
use crate::measurement::Measurement;
use crate::orientation;
use crate::quantity::{NonNegative, Positive};
use crate::rank::reach;
use crate::reference::{CartesianReference, Target, Trajectory};
use crate::signal::{Row, Signal};
use crate::task::RobotFacts;
use crate::task_axes::TaskAxes;
use nalgebra::{Matrix3, Matrix6xX, Vector3, Vector6};
use opspace_model::{
    Data, FrameId, Model, Placement, frame_bias_acceleration, frame_jacobian, frame_placement, frame_velocity,
};
use schemars::JsonSchema;
use serde::Deserialize;

/// A frame that follows a reference on some axes and gives way on others.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CartesianParameters {
    /// The frame that is led: a link of the URDF.
    pub frame: String,
    /// What the task does with each axis; axes that are left out are free.
    pub axes: Axes,
    /// In which directions the axes lie: `"world"`, or `{ rpy_rad = [...] }` against the world.
    #[serde(default)]
    pub axes_in: AxesIn,
    /// Where the frame should be.
    pub reference: CartesianReference,
    /// How stiffly axes in motion follow the reference.
    pub gains: AxisGains,
    /// Force feedback of the compliant and force axes; without it the compliant ones' force is zero, open loop.
    #[serde(default)]
    pub force: Option<ForceParameters>,
    /// Damping of the compliant and force axes, as acceleration over velocity, 1/s; 2 if absent.
    #[serde(default = "default_compliant_damping")]
    pub compliant_damping_per_s: PerAxis<NonNegative>,
    /// Directions whose mobility (eigenvalue of Λ⁻¹) is below this share of the largest are damped; 0.001
    /// if absent.
    #[serde(default = "default_singularity_threshold")]
    pub singularity_threshold: Positive,
    /// The length by which rotations are weighed against displacements when singular directions are
    /// sought, m; the arm's reach if absent.
    #[serde(default)]
    pub characteristic_length_m: Option<Positive>,
}

/// How an axis follows: as a unit mass on a spring and a damper, whatever the arm's inertia.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AxisGains {
    /// Natural frequency ω of the error, rad/s: the stiffness is ω² (1/s²).
    pub frequency_rad_per_s: PerAxis<Positive>,
    /// Damping ratio ζ of the error: the damping is 2ζω (1/s).
    pub damping_ratio: PerAxis<NonNegative>,
}

/// Feedback of a force sensor to the compliant and force axes.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ForceParameters {
    /// The robot's sensor, by name.
    pub sensor: String,
    /// The force that the surroundings should exert ON the robot along these axes, N; 0 if absent.
    #[serde(default = "no_target")]
    pub target_n: PerAxis<f64>,
    /// The moment that the surroundings should exert ON the robot about these axes, Nm; 0 if absent.
    #[serde(default = "no_target")]
    pub target_nm: PerAxis<f64>,
    /// How much of the force error is added to the task's force; 2 if absent.
    #[serde(default = "default_force_gain")]
    pub gain: PerAxis<NonNegative>,
    /// How much of the force error a force axis adds to its force each second, 1/s; 5 if absent.
    #[serde(default)]
    pub integral_per_s: Option<PerAxis<NonNegative>>,
    /// How much a force axis adds at most, so that a missing wall doesn't wind it up, N or Nm; as much as the
    /// target if absent.
    #[serde(default)]
    pub integral_limit: Option<PerAxis<NonNegative>>,
    /// −3 dB point of the low-pass on the sensed force, Hz; 100 if absent.
    #[serde(default = "default_filter_hz")]
    pub filter_hz: Positive,
}

fn no_target() -> PerAxis<f64> {
    PerAxis::All(0.0)
}

fn default_force_gain() -> PerAxis<NonNegative> {
    PerAxis::All(NonNegative::from(Positive::literal(2.0)))
}

fn default_compliant_damping() -> PerAxis<NonNegative> {
    PerAxis::All(NonNegative::from(Positive::literal(2.0)))
}

fn default_singularity_threshold() -> Positive {
    Positive::literal(1e-3)
}

fn default_filter_hz() -> Positive {
    Positive::literal(100.0)
}

impl CartesianParameters {
    /// Which axes follow the reference, in the order of [`AXIS_NAMES`].
    #[must_use]
    pub fn motion_axes(&self) -> [bool; 6] {
        self.axes.with_mode(AxisMode::Motion)
    }

    /// Which axes are held to a force: those that are compliant, and those in force control.
    #[must_use]
    pub fn held_to_force(&self) -> [bool; 6] {
        self.axes.modes().map(|mode| matches!(mode, AxisMode::Compliant | AxisMode::Force))
    }

    /// The task's axes in world coordinates, one a column.
    #[must_use]
    pub fn rotation(&self) -> Matrix3<f64> {
        self.axes_in.rotation()
    }

    /// The force (N) and moment (Nm) that the surroundings should exert ON the robot, in the task's axes:
    /// 0 on axes that are not held to a force or without force feedback.
    #[must_use]
    pub fn target_force(&self) -> Vector6<f64> {
        let held = self.held_to_force();
        Vector6::from_fn(|axis, _| {
            let targets = self.force.as_ref().map(|f| if axis < 3 { &f.target_n } else { &f.target_nm });
            targets.filter(|_| held[axis]).and_then(|t| t.get(axis)).unwrap_or(0.0)
        })
    }
}

/// Of force axes whose file gives no other, 1/s.
const INTEGRAL_PER_S: f64 = 5.0;

/// A Cartesian task of one robot, and what it saw last.
#[derive(Clone, Debug)]
pub(crate) struct CartesianTask {
    pub name: String,
    pub axes: TaskAxes,
    pub singularity_threshold: f64,
    modes: [AxisMode; 6],
    /// Of the error (1/s²) and of the velocity (1/s), in the order of the axes.
    stiffness: Vector6<f64>,
    damping: Vector6<f64>,
    force: Option<ForceFeedback>,
    trajectory: Trajectory,
    world_jacobian: Matrix6xX<f64>,
    /// Rows of the task, scaled.
    pub jacobian: Matrix6xX<f64>,
    /// World axes.
    pub target: Target,
    placement: Placement,
    /// Of the frame's origin, world axes, m/s.
    linear_velocity: Vector3<f64>,
    /// Task axes, m and rad. Displacements on all three axes; turns only about those in motion, since the
    /// others would mix into them.
    error: Vector6<f64>,
}

#[derive(Clone, Debug)]
struct ForceFeedback {
    sensor: usize,
    frame: FrameId,
    target: Vector6<f64>,
    /// 0 on axes that are not held to a force.
    gain: Vector6<f64>,
    held: [bool; 6],
    /// What of the error is added in a period, and at most: 0 but on force axes.
    integral_step: Vector6<f64>,
    integral_limit: Vector6<f64>,
    integral: Vector6<f64>,
    filter: LowPass<6>,
    /// At the task frame's origin, task axes.
    sensed: Vector6<f64>,
}

impl CartesianTask {
    pub(crate) fn new(
        name: &str,
        parameters: &CartesianParameters,
        model: &Model,
        robot: &RobotFacts,
    ) -> Result<Self, ControlError> {
        let key = format!("task.{name}.cartesian");
        let at = |place: &str, reason: Reason| ControlError::new(format!("{key}.{place}"), reason);
        let frame = model.frame(&parameters.frame).map_err(|e| at("frame", e.into()))?;
        let in_task = parameters.axes.in_task();
        if !in_task.contains(&true) {
            return Err(at("axes", Reason::NoAxis));
        }
        check_reference(parameters, &format!("{key}.reference"))?;
        let length_m = parameters.characteristic_length_m.map_or_else(|| reach(model, frame), Positive::get);
        let (stiffness, damping) = gains(parameters, &key)?;
        let force = match &parameters.force {
            None if parameters.axes.modes().contains(&AxisMode::Force) => {
                return Err(at("force", Reason::ForceAxisUnsensed));
            }
            None => None,
            Some(force) => Some(ForceFeedback::new(force, parameters, robot, &format!("{key}.force"))?),
        };
        let origin = Target::at_rest(Placement::identity());
        Ok(Self {
            name: name.to_owned(),
            axes: TaskAxes::new(frame, parameters.rotation(), in_task, length_m),
            singularity_threshold: parameters.singularity_threshold.get(),
            modes: parameters.axes.modes(),
            stiffness,
            damping,
            force,
            trajectory: Trajectory::new(&parameters.reference, parameters.rotation()),
            world_jacobian: Matrix6xX::zeros(model.n()),
            jacobian: Matrix6xX::zeros(model.n()),
            target: origin,
            placement: origin.placement,
            linear_velocity: Vector3::zeros(),
            error: Vector6::zeros(),
        })
    }

    pub(crate) fn start(&mut self, model: &Model, data: &Data, measurement: &Measurement) {
        self.trajectory.start(frame_placement(model, data, self.axes.frame));
        if let Some(force) = &mut self.force {
            force.filter.reset(&force.raw(measurement));
            force.integral.fill(0.0);
        }
        self.observe(model, data, 0.0);
    }

    /// Takes in where the frame is and where it should be.
    pub(crate) fn observe(&mut self, model: &Model, data: &Data, time_s: f64) {
        self.target = self.trajectory.at(time_s);
        self.placement = frame_placement(model, data, self.axes.frame);
        self.linear_velocity = frame_velocity(model, data, self.axes.frame).linear;
        self.error = self.error_at(&self.placement, self.modes.map(|m| m == AxisMode::Motion));
    }

    /// Takes in the sensed force. After [`observe`](Self::observe).
    pub(crate) fn sense(&mut self, model: &Model, data: &Data, measurement: &Measurement) {
        if let Some(force) = &mut self.force {
            force.update(model, data, measurement, &self.axes.rotation, &self.placement);
        }
    }

    /// By how far the target is from `placement` (m, rad; task axes). Rotations count about the axes of
    /// `counted` only.
    pub(crate) fn error_at(&self, placement: &Placement, counted: [bool; 6]) -> Vector6<f64> {
        let axes = &self.axes.rotation;
        let linear = axes.tr_mul(&(self.target.placement.translation - placement.translation));
        let turn = self.target.placement.rotation * placement.rotation.transpose();
        let angular =
            orientation::log_about(&(axes.transpose() * turn * axes), [counted[3], counted[4], counted[5]]);
        Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
    }

    /// The task's rows at the state of `data`, into [`jacobian`](Self::jacobian).
    pub(crate) fn update_jacobian(&mut self, model: &Model, data: &Data) {
        frame_jacobian(model, data, self.axes.frame, &mut self.world_jacobian);
        self.axes.select(&self.world_jacobian, &mut self.jacobian);
    }

    /// a* − J̇ q̇ on the task's axes (m/s², rad/s²), not scaled. After [`observe`](Self::observe).
    pub(crate) fn acceleration(&self, model: &Model, data: &Data) -> Vector6<f64> {
        let velocity = self.axes.of_motion(&frame_velocity(model, data, self.axes.frame));
        let bias = self.axes.of_motion(&frame_bias_acceleration(model, data, self.axes.frame));
        let wanted_velocity = self.axes.of_motion(&self.target.velocity);
        let wanted = self.axes.of_motion(&self.target.acceleration);
        Vector6::from_fn(|i, _| match self.modes[i] {
            AxisMode::Free => 0.0,
            AxisMode::Compliant | AxisMode::Force => -self.damping[i] * velocity[i] - bias[i],
            AxisMode::Motion => {
                wanted[i]
                    + self.damping[i] * (wanted_velocity[i] - velocity[i])
                    + self.stiffness[i] * self.error[i]
                    - bias[i]
            }
        })
    }

    /// The force that is added to Λ's on axes held to a force (N, Nm; task axes). After
    /// [`sense`](Self::sense).
    pub(crate) fn added_force(&self) -> Vector6<f64> {
        self.force.as_ref().map_or_else(Vector6::zeros, ForceFeedback::added)
    }

    /// Signals of the motion, and their values in the same order.
    pub(crate) fn motion_signals(&self) -> Vec<Signal> {
        let named = |quantity: &str| format!("{}.{quantity}", self.name);
        let xyz = &AXIS_NAMES[..3];
        let wxyz = ["w", "x", "y", "z"];
        vec![
            Signal::new(named("reference"), "m", xyz),
            Signal::new(named("position"), "m", xyz),
            Signal::new(named("reference_velocity"), "m/s", xyz),
            Signal::new(named("velocity"), "m/s", xyz),
            Signal::new(named("reference_orientation"), "1", &wxyz),
            Signal::new(named("orientation"), "1", &wxyz),
            Signal::new(named("error"), "m,rad", &AXIS_NAMES),
        ]
    }

    pub(crate) fn sample_motion(&self, row: &mut Row<'_>) {
        row.put(self.target.placement.translation.as_slice());
        row.put(self.placement.translation.as_slice());
        row.put(self.target.velocity.linear.as_slice());
        row.put(self.linear_velocity.as_slice());
        for rotation in [&self.target.placement.rotation, &self.placement.rotation] {
            let q = orientation::quaternion(rotation);
            row.put(&[q.w, q.i, q.j, q.k]);
        }
        row.put(self.error.as_slice());
    }

    /// The signal of the sensed force, if there is a sensor.
    pub(crate) fn sensed_signal(&self) -> Option<Signal> {
        let name = format!("{}.sensed_force", self.name);
        self.force.as_ref().map(|_| Signal::new(name, "N,Nm", &AXIS_NAMES))
    }

    pub(crate) fn sample_sensed(&self, row: &mut Row<'_>) {
        if let Some(force) = &self.force {
            row.put(force.sensed.as_slice());
        }
    }
}

impl ForceFeedback {
    fn new(
        force: &ForceParameters,
        task: &CartesianParameters,
        robot: &RobotFacts,
        key: &str,
    ) -> Result<Self, ControlError> {
        let at = |place: &str, reason: Reason| ControlError::new(format!("{key}.{place}"), reason);
        let known = || robot.sensors.iter().map(|(name, _)| name.clone()).collect();
        let Some(sensor) = robot.sensors.iter().position(|(name, _)| *name == force.sensor) else {
            return Err(at("sensor", Reason::Sensor { name: force.sensor.clone(), known: known() }));
        };
        let held = task.held_to_force();
        if !held.contains(&true) {
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
        let target = task.target_force();
        let [mut gain, mut integral_step, mut integral_limit] = [Vector6::zeros(); 3];
        for axis in (0..6).filter(|&axis| held[axis]) {
            gain[axis] = required(&force.gain, axis).map_err(|reason| at("gain", reason))?.get();
        }
        let in_force_control = task.axes.with_mode(AxisMode::Force);
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
            integral_step[axis] = per_s * robot.period_s;
            integral_limit[axis] = match &force.integral_limit {
                None => target[axis].abs(),
                Some(limits) => required(limits, axis).map_err(|reason| at("integral_limit", reason))?.get(),
            };
        }
        Ok(Self {
            sensor,
            frame: robot.sensors[sensor].1,
            target,
            gain,
            held,
            integral_step,
            integral_limit,
            integral: Vector6::zeros(),
            filter: LowPass::new(force.filter_hz.get(), robot.period_s),
            sensed: Vector6::zeros(),
        })
    }

    fn raw(&self, measurement: &Measurement) -> [f64; 6] {
        let f = &measurement.wrenches[self.sensor];
        [f.linear.x, f.linear.y, f.linear.z, f.angular.x, f.angular.y, f.angular.z]
    }

    fn update(
        &mut self,
        model: &Model,
        data: &Data,
        measurement: &Measurement,
        axes: &Matrix3<f64>,
        placement: &Placement,
    ) {
        let raw = self.raw(measurement);
        let [fx, fy, fz, mx, my, mz] = *self.filter.update(&raw);
        let force = Vector3::new(fx, fy, fz);
        let lever = frame_placement(model, data, self.frame).translation - placement.translation;
        let (linear, angular) =
            (axes.tr_mul(&force), axes.tr_mul(&(Vector3::new(mx, my, mz) + lever.cross(&force))));
        self.sensed = Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z);
        for i in 0..6 {
            let sum = self.integral[i] + self.integral_step[i] * (self.sensed[i] - self.target[i]);
            self.integral[i] = sum.clamp(-self.integral_limit[i], self.integral_limit[i]);
        }
    }

    fn added(&self) -> Vector6<f64> {
        Vector6::from_fn(|i, _| {
            if !self.held[i] {
                return 0.0;
            }
            self.gain[i] * (self.sensed[i] - self.target[i]) + self.integral[i] - self.target[i]
        })
    }
}

fn required<T: Copy>(values: &PerAxis<T>, axis: usize) -> Result<T, Reason> {
    values.get(axis).ok_or(Reason::MissingAxis { axis: AXIS_NAMES[axis] })
}

/// Stiffness (1/s²) and damping (1/s) of each axis: ω² and 2ζω in motion, 0 and c where held to a force.
fn gains(parameters: &CartesianParameters, key: &str) -> Result<(Vector6<f64>, Vector6<f64>), ControlError> {
    let at = |place: &'static str| move |reason| ControlError::new(format!("{key}.{place}"), reason);
    let (mut stiffness, mut damping) = (Vector6::zeros(), Vector6::zeros());
    for (axis, mode) in parameters.axes.modes().into_iter().enumerate() {
        match mode {
            AxisMode::Free => {}
            AxisMode::Compliant | AxisMode::Force => {
                let c = required(&parameters.compliant_damping_per_s, axis);
                damping[axis] = c.map_err(at("compliant_damping_per_s"))?.get();
            }
            AxisMode::Motion => {
                let omega = required(&parameters.gains.frequency_rad_per_s, axis)
                    .map_err(at("gains.frequency_rad_per_s"))?
                    .get();
                let zeta =
                    required(&parameters.gains.damping_ratio, axis).map_err(at("gains.damping_ratio"))?.get();
                stiffness[axis] = omega * omega;
                damping[axis] = 2.0 * zeta * omega;
            }
        }
    }
    Ok((stiffness, damping))
}

fn check_reference(parameters: &CartesianParameters, key: &str) -> Result<(), ControlError> {
    match &parameters.reference {
        CartesianReference::Hold | CartesianReference::Sinusoid(_) => {}
        CartesianReference::PointToPoint(p) => {
            if p.position.is_none() && p.orientation.is_none() {
                return Err(ControlError::new(format!("{key}.point-to-point"), Reason::NoGoal));
            }
        }
        CartesianReference::Waypoints(list) => {
            let key = format!("{key}.waypoints");
            check_times(list.iter().map(|w| w.time_s.get()), &key)?;
            if list.iter().any(|w| w.position.is_none() && w.orientation.is_none()) {
                return Err(ControlError::new(key, Reason::NoGoal));
            }
        }
    }
    let turnable = parameters.axes.in_task()[3..].contains(&true);
    if parameters.reference.turns() && !turnable {
        return Err(ControlError::new(key, Reason::OrientationOfFreeAxes));
    }
    Ok(())
}

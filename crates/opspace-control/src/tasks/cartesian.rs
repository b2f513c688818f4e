//! The Cartesian task: a frame that follows a reference on some axes and is compliant on others.
//!
//! On the task axes, with x the frame's pose and v its velocity (Khatib 1987, with unit-mass gains):
//!
//! ```text
//! motion     a* = ẍ_d + 2ζω (ẋ_d − v) + ω² (x_d − x + ∫ integral gain (x_d − x) dt, bounded)
//! compliant  a* = −c v                                 and the force  −f_target + gain (f − f_target)
//! force      a* = −c v                                 the same, and  ∫ integral gain (f − f_target) dt, bounded
//! ```
//!
//! f is the sensed force ON the robot. With gain 0, the axis pushes with the target force in open loop; the gain makes
//! the hand appear 1 + gain times lighter. The same holds for moments on rotation axes. Contact, ramps and passivity of force
//! axes are described in the file `force_axis.rs`. An
//! [`impedance`](crate::tasks::impedance) in N/m and Ns/m can replace the unit mass.
//!
//! A speed limit ẋ_max bounds the desired speed and keeps its direction (Khatib 1987, §VI): with the damping 2ζω
//! factored out, a* = 2ζω (ν ẋ* − v) with ẋ* = ẋ_d + ω/(2ζ) (x_d − x) and ν = min(1, ẋ_max/|ẋ*|).

use crate::axis_mode::AxisMode;
use crate::context::ControlContext;
use crate::controller::ControlInput;
use crate::error::{ControlError, Reason};
use crate::orientation;
use crate::references::path_bounds::PathPlace;
use crate::references::reference::{CartesianReference, Trajectory};
use crate::references::streamed_pose::StreamedPose;
use crate::references::target::Target;
use crate::targets::AllowedInputs;
use crate::tasks::admittance::Admittance;
use crate::tasks::axes::{AXIS_NAMES, AxesFrame};
use crate::tasks::axis_feedback::AxisFeedback;
use crate::tasks::build_task::{BuildTask, BuiltTask, TaskReference};
use crate::tasks::cartesian_parameters::{
    CartesianParameters, CenterOfMassParameters, Decoupling, check_reference,
};
use crate::tasks::cartesian_target::{AxisSettings, CartesianInputs};
use crate::tasks::characteristic_length::characteristic_length;
use crate::tasks::controlled_frame::ControlledFrame;
use crate::tasks::force::{ForceFeedback, ForceInput};
use crate::tasks::gains::integrate;
use crate::tasks::impedance::Impedance;
use crate::tasks::singular_escape::SingularEscape;
use crate::tasks::surface_axes::{SurfaceAxes, surface_axes};
use crate::tasks::task::{RowGains, SpeedLimit, Task, TaskInput, TaskSignals};
use crate::tasks::task_axes::TaskAxes;
use crate::tasks::varying_gains::VaryingGains;
use crate::tasks::when_limited::{WhenLimited, axis_weights};
use nalgebra::{Matrix3, Matrix6, Matrix6xX, Vector3, Vector6};
use opspace_backend::quantity::Positive;
use opspace_backend::signal_names::{
    AXES, ERROR, FORCE, MODES, ORIENTATION, POSITION, REFERENCE, REFERENCE_ORIENTATION, REFERENCE_VELOCITY,
    SLACK, STIFFNESS, TANK, VELOCITY,
};
use opspace_backend::{Signal, SignalRecorder, signal_names};
use opspace_model::{Data, Inversion, Model, Placement};
use std::any::Any;

/// A task of a frame, or of the centre of mass, that follows a reference on some axes and is compliant on others: see
/// [`CartesianParameters`].
#[derive(Clone, Debug)]
pub struct CartesianTask {
    name: String,
    rows_key: String,
    axes: TaskAxes,
    inversion: Inversion,
    escape: SingularEscape,
    decoupling: Decoupling,
    weights: Option<Vector6<f64>>,
    when_limited: WhenLimited,
    axes_frame: AxesFrame,
    /// Axes that turn with a surface, instead of those of `axes_frame`.
    surface: Option<SurfaceAxes>,
    modes: [AxisMode; 6],
    feedback: AxisFeedback,
    /// Speed limits, m/s and rad/s; infinite if there is none.
    speed_limits: [f64; 2],
    force: Option<ForceFeedback>,
    /// Admittance of the compliant and force axes, for inverse kinematics.
    admittance: Option<Admittance>,
    reference: CartesianReference,
    trajectory: Trajectory,
    /// Streamed reference, used instead of the trajectory.
    streamed: Option<Box<StreamedPose>>,
    /// Inputs that a program can change.
    inputs: Option<CartesianInputs>,
    /// Time stamp of the current streamed settings, s.
    settings_s: Option<f64>,
    configured_modes: [AxisMode; 6],
    /// Streamed target force (N, Nm) on compliant axes of a task without a sensor.
    streamed_force: Vector6<f64>,
    /// Start time of the trajectory, s.
    start_s: f64,
    /// Pose at the start of the run.
    home: Placement,
    /// Target in the coordinates of the controlled frame.
    target: Target,
    /// Reference without blending.
    path: Target,
    placement: Placement,
    /// Velocity of the controlled frame in the task axes (m/s, rad/s).
    velocity: Vector6<f64>,
    /// Velocity of the controlled frame's origin in its coordinates, m/s.
    linear_velocity: Vector3<f64>,
    /// Error in the task axes, m and rad: displacements along all three axes, but rotations only about the motion axes,
    /// because a rotation about another axis would affect the error about these.
    error: Vector6<f64>,
}

impl CartesianTask {
    /// Creates a task of a frame from its parameters.
    ///
    /// # Errors
    /// Unknown names, missing or contradicting values.
    pub fn new(
        name: &str,
        parameters: &CartesianParameters,
        model: &Model,
        context: &ControlContext,
    ) -> Result<Self, ControlError> {
        let key = format!("task.{name}.cartesian");
        let controlled = parameters.controlled_frame(model).map_err(|e| e.below(&key))?;
        Self::of_controlled(name, &key, parameters, controlled, model, context)
    }

    /// Creates a task of the centre of mass from its parameters.
    ///
    /// # Errors
    /// The errors of [`new`](Self::new); a rotation axis that is not free.
    pub fn of_center_of_mass(
        name: &str,
        parameters: &CenterOfMassParameters,
        model: &Model,
        context: &ControlContext,
    ) -> Result<Self, ControlError> {
        let key = format!("task.{name}.center-of-mass");
        if parameters.axes.active_axes()[3..].contains(&true) {
            return Err(ControlError::new(format!("{key}.axes"), Reason::CenterOfMassTurns));
        }
        Self::of_controlled(
            name,
            &key,
            &parameters.as_cartesian(),
            ControlledFrame::CenterOfMass,
            model,
            context,
        )
    }

    fn of_controlled(
        name: &str,
        key: &str,
        parameters: &CartesianParameters,
        controlled: ControlledFrame,
        model: &Model,
        context: &ControlContext,
    ) -> Result<Self, ControlError> {
        let at = |place: &str, reason: Reason| ControlError::new(format!("{key}.{place}"), reason);
        let axes_frame =
            parameters.axes_frame.resolve(model, controlled).map_err(|e| at("axes_frame", e.into()))?;
        let active = parameters.axes.active_axes();
        if !active.contains(&true) {
            return Err(at("axes", Reason::NoAxis));
        }
        check_reference(parameters, &format!("{key}.reference"))?;
        let length_m = parameters
            .characteristic_length_m
            .map_or_else(|| characteristic_length(model, controlled), Positive::get);
        let feedback = AxisFeedback::new(parameters, context.period_s, key)?;
        let force = match &parameters.force {
            None if parameters.axes.modes().contains(&AxisMode::Force) => {
                return Err(at("force", Reason::ForceAxisUnsensed));
            }
            None => None,
            Some(force) => {
                let (axes, shaped) = (&parameters.axes, parameters.shapes_inertia());
                let mut feedback = ForceFeedback::new(force, axes, shaped, context, &format!("{key}.force"))?;
                feedback.records_control |= matches!(parameters.reference, CartesianReference::Streamed(_));
                Some(feedback)
            }
        };
        let admittance = match &parameters.force {
            Some(force) => Admittance::new(
                [&force.admittance_ns_per_m, &force.admittance_nms_per_rad],
                &force.admittance_limits,
                parameters.force_axes(),
                context.period_s,
                &format!("{key}.force"),
            )?,
            None => None,
        };
        let limit = |limit: Option<Positive>| limit.map_or(f64::INFINITY, Positive::get);
        let origin = Target::at_rest(Placement::identity());
        let axes = TaskAxes::new(controlled, axes_frame.at_rest(), active, length_m);
        Ok(Self {
            name: name.to_owned(),
            rows_key: format!("{key}.axes"),
            weights: axis_weights(&parameters.weight, axes.axes(), &format!("{key}.weight"))?,
            when_limited: parameters.when_limited,
            axes,
            inversion: parameters.inversion(key)?,
            escape: parameters.escape,
            decoupling: parameters.decoupling,
            surface: surface_axes(parameters, &axes_frame, context.period_s)
                .map_err(|reason| at("axes_frame", reason))?,
            axes_frame,
            modes: parameters.axes.modes(),
            feedback,
            speed_limits: [limit(parameters.speed_limit_m_per_s), limit(parameters.speed_limit_rad_per_s)],
            force,
            admittance,
            reference: parameters.reference.clone(),
            trajectory: Trajectory::new(&parameters.reference),
            streamed: match &parameters.reference {
                CartesianReference::Streamed(reference) => Some(Box::new(StreamedPose::new(reference))),
                _ => None,
            },
            inputs: match &parameters.reference {
                CartesianReference::Streamed(_) => Some(CartesianInputs::All),
                _ => parameters.tunable.then_some(CartesianInputs::Settings),
            },
            settings_s: None,
            configured_modes: parameters.axes.modes(),
            streamed_force: Vector6::zeros(),
            start_s: 0.0,
            home: origin.placement,
            target: origin,
            path: origin,
            placement: origin.placement,
            velocity: Vector6::zeros(),
            linear_velocity: Vector3::zeros(),
            error: Vector6::zeros(),
        })
    }

    /// Returns the target, replaced by the frame's position at rest along the `axes` for which `began` is true, and by
    /// the frame's orientation at rest if `began` is true for any rotation.
    fn target_at_rest_along(&self, axes: &Matrix3<f64>, began: impl Fn(usize) -> bool) -> Target {
        let mut target = self.target;
        for axis in (0..3).filter(|&axis| began(axis)) {
            let direction = axes.column(axis).into_owned();
            let away = direction.dot(&(self.placement.translation - target.placement.translation));
            target.placement.translation += direction * away;
            for part in [&mut target.velocity.linear, &mut target.acceleration.linear] {
                *part -= direction * direction.dot(part);
            }
        }
        if (3..6).any(began) {
            target.placement.rotation = self.placement.rotation;
            target.velocity.angular = Vector3::zeros();
            target.acceleration.angular = Vector3::zeros();
        }
        target
    }

    /// Returns the error of the target relative to `placement` (m, rad; task axes). Only rotations about the axes in
    /// `counted` are included.
    fn error_at(&self, axes: &Matrix3<f64>, placement: &Placement, counted: [bool; 6]) -> Vector6<f64> {
        let linear = axes.tr_mul(&(self.target.placement.translation - placement.translation));
        let counted = [counted[3], counted[4], counted[5]];
        if counted == [false; 3] {
            return Vector6::new(linear.x, linear.y, linear.z, 0.0, 0.0, 0.0);
        }
        let turn = self.target.placement.rotation * placement.rotation.transpose();
        let angular = orientation::log_about(&(axes.transpose() * turn * axes), counted);
        Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
    }

    /// Reduces a* of the motion axes such that the desired speed respects the limit.
    fn saturate_speed(&self, a: &mut Vector6<f64>, wanted_velocity: &Vector6<f64>) {
        let feedback = &self.feedback;
        for (kind, &limit) in self.speed_limits.iter().enumerate() {
            let in_motion = |i: &usize| self.modes[*i] == AxisMode::Motion && feedback.damping[*i] > 0.0;
            let axes = (3 * kind..3 * kind + 3).filter(in_motion);
            let asked = |i: usize| {
                wanted_velocity[i]
                    + feedback.stiffness[i] / feedback.damping[i] * (self.error[i] + feedback.integral[i])
            };
            let speed = axes.clone().map(|i| asked(i) * asked(i)).sum::<f64>().sqrt();
            if speed > limit {
                for i in axes {
                    a[i] = feedback.damping[i] * (asked(i) * (limit / speed) - self.velocity[i]);
                }
            }
        }
    }

    /// Continues from a task of the same controlled frame.
    fn continue_from(&mut self, before: &mut Self, input: &ControlInput<'_>) {
        let ControlInput { model, data, .. } = *input;
        before.follow(input);
        self.home = before.home;
        self.inherit_modes(before);
        let (modes, old) = (self.modes, before.modes);
        let began = |axis: usize| modes[axis] == AxisMode::Motion && old[axis] != AxisMode::Motion;
        let same = self.reference == before.reference && self.axes_frame == before.axes_frame;
        if same && !(0..6).any(began) {
            std::mem::swap(&mut self.trajectory, &mut before.trajectory);
            std::mem::swap(&mut self.streamed, &mut before.streamed);
            self.start_s = before.start_s;
        } else {
            let axes = self.directions(model, data);
            let from = before.target_at_rest_along(&axes, began);
            self.begin(&from, &axes, input);
        }
        for axis in (0..6).filter(|&axis| !began(axis)) {
            let limit = self.feedback.integral_limit[axis];
            self.feedback.integral[axis] = before.feedback.integral[axis].clamp(-limit, limit);
        }
        if let (Some(surface), Some(before)) = (&mut self.surface, &before.surface) {
            surface.inherit_state(before);
        }
        self.start_force(input);
        if let (Some(force), Some(before)) = (&mut self.force, &before.force) {
            force.inherit_state(before);
        }
        if let Some(impedance) = &mut self.feedback.impedance {
            impedance.continue_from(before.feedback.impedance.as_ref(), input.measurement.time_s);
        }
        self.follow(input);
    }

    /// Starts the force feedback at the present state.
    fn start_force(&mut self, input: &ControlInput<'_>) {
        let rotation = self.directions(input.model, input.data);
        let input = self.force_input(input, &rotation);
        if let Some(force) = &mut self.force {
            force.start(&input);
        }
    }

    /// Input of the force feedback; `rotation` are the task axes in the coordinates of the controlled frame.
    fn force_input<'a>(&self, input: &ControlInput<'a>, rotation: &Matrix3<f64>) -> ForceInput<'a> {
        let ControlInput { model, data, measurement, .. } = *input;
        let controlled = self.axes.controlled;
        ForceInput {
            model,
            data,
            measurement,
            rotation: controlled.coordinates(model, data) * rotation,
            point: controlled.point(model, data),
            velocity: self.velocity,
        }
    }

    /// Starts the reference at `from`, with the current task axes.
    fn begin(&mut self, from: &Target, axes: &Matrix3<f64>, input: &ControlInput<'_>) {
        self.trajectory.start(&self.home, from, axes);
        self.start_s = input.measurement.time_s;
        if let Some(streamed) = &mut self.streamed {
            streamed.begin(from, input.clock_s);
        }
    }

    /// Returns the values that can be streamed, including the modes for which each axis is configured.
    fn allowed(&self) -> AllowedInputs {
        let unit_mass = self.feedback.impedance.is_none();
        let mut allowed = AllowedInputs { gains: unit_mass, ..AllowedInputs::default() };
        for &axis in self.axes.axes() {
            let was_in_motion = self.configured_modes[axis] == AxisMode::Motion;
            let motion = was_in_motion || (unit_mass && self.feedback.can_follow(axis));
            allowed.modes[axis] = [motion, true, self.force.is_some()];
        }
        allowed
    }

    /// Sets the mode of an axis; streamed values replace the configured ones.
    fn set_axis(&mut self, axis: usize, mode: AxisMode, settings: &AxisSettings) {
        self.modes[axis] = mode;
        self.feedback.set(axis, mode, settings);
        let held = matches!(mode, AxisMode::Compliant | AxisMode::Force);
        match &mut self.force {
            Some(force) => force.set(axis, mode, settings.force),
            None => self.streamed_force[axis] = settings.force.filter(|_| held).unwrap_or(0.0),
        }
    }

    /// Resets all axes to their configured settings.
    fn reset_settings(&mut self) {
        if self.inputs.is_none() {
            return;
        }
        self.settings_s = None;
        for place in 0..self.axes.rows() {
            let axis = self.axes.axes()[place];
            self.set_axis(axis, self.configured_modes[axis], &AxisSettings::default());
        }
    }

    /// Takes over the modes of the previous task if a program can change those of both.
    fn inherit_modes(&mut self, before: &Self) {
        self.reset_settings();
        if self.inputs.is_none() || before.inputs.is_none() {
            return;
        }
        let allowed = self.allowed();
        for axis in 0..6 {
            let mode = before.modes[axis];
            if allowed.admits(axis, mode) {
                self.set_axis(axis, mode, &AxisSettings::default());
            }
        }
    }

    /// Processes the inputs of a cycle: first modes, gains and forces, then the streamed reference.
    fn take_target(&mut self, input: &TaskInput<'_>) {
        let Some(inputs) = self.inputs else { return };
        if input.target.stamp_s.is_some() && input.target.stamp_s != self.settings_s {
            self.settings_s = input.target.stamp_s;
            self.apply(&inputs.settings(input.target.values), &input.control);
        }
        if let Some(streamed) = &mut self.streamed {
            streamed.update(&input.target);
        }
    }

    /// Changes modes, gains and forces. On axes that become motion axes, the reference restarts at the frame's pose.
    fn apply(&mut self, settings: &[AxisSettings; 6], input: &ControlInput<'_>) {
        let (before, allowed) = (self.modes, self.allowed());
        for place in 0..self.axes.rows() {
            let axis = self.axes.axes()[place];
            let possible = |mode: &AxisMode| {
                AxisMode::IN_TASK
                    .into_iter()
                    .zip(allowed.modes[axis])
                    .any(|(m, allowed)| allowed && m == *mode)
            };
            let mode = settings[axis].mode.filter(possible).unwrap_or(self.configured_modes[axis]);
            self.set_axis(axis, mode, &settings[axis]);
        }
        let modes = self.modes;
        if modes != before
            && let Some(varying) = self.varying_mut()
        {
            varying.tank_mut().interrupt();
        }
        let began = |axis: usize| modes[axis] == AxisMode::Motion && before[axis] != AxisMode::Motion;
        if (0..6).any(began) {
            self.follow(input);
            let from = self.target_at_rest_along(&self.axes.rotation, began);
            let axes = self.axes.rotation;
            self.begin(&from, &axes, input);
        }
    }

    /// Updates the state and the reference.
    fn follow(&mut self, input: &ControlInput<'_>) {
        let ControlInput { model, data, measurement, .. } = *input;
        let controlled = self.axes.controlled;
        self.axes.rotation = self.directions(model, data);
        let time_s = measurement.time_s - self.start_s;
        if let Some(streamed) = &self.streamed {
            self.path = streamed.at(input.clock_s);
            self.target = self.path;
        } else {
            self.path = self.trajectory.reference_at(time_s);
            self.target = self.trajectory.blended(&self.path, time_s);
        }
        self.placement = controlled.placement(model, data);
        let velocity = controlled.velocity(model, data);
        self.linear_velocity = velocity.linear;
        self.velocity = self.axes.of_motion(&velocity);
        self.error =
            self.error_at(&self.axes.rotation, &self.placement, self.modes.map(|m| m == AxisMode::Motion));
    }

    /// Directions of the task axes in the coordinates of the controlled frame at the state of `data`, one per column.
    fn directions(&self, model: &Model, data: &Data) -> Matrix3<f64> {
        match &self.surface {
            Some(surface) => surface.rotation(),
            None => self.axes_frame.rotation(model, data, self.axes.controlled),
        }
    }

    /// Turns the axes of the next cycle with the surface, after the sensed force was updated.
    fn turn_with_surface(&mut self) {
        let (Some(surface), Some(force)) = (&mut self.surface, &self.force) else { return };
        if self.modes[surface.axis()] == AxisMode::Force {
            let sensed = self.axes.rotation * force.sensed.fixed_rows::<3>(0);
            surface.update(&sensed, &self.linear_velocity);
        }
    }

    /// Returns the axes and rows at the state of `data`.
    fn axes_at(&self, model: &Model, data: &Data) -> TaskAxes {
        let rotation = self.directions(model, data);
        self.axes.with_rotation(rotation)
    }

    /// Updates the sensed force, and the integrals unless `hold` is true. Call it after [`observe`](Task::observe).
    fn sense(&mut self, input: &ControlInput<'_>, hold: bool) {
        if !hold {
            let feedback = &mut self.feedback;
            integrate(&mut feedback.integral, &self.error, &feedback.integral_step, &feedback.integral_limit);
        }
        if self.force.is_none() {
            return;
        }
        let input = self.force_input(input, &self.axes.rotation);
        if let Some(force) = &mut self.force {
            force.update(&input, hold);
        }
        self.turn_with_surface();
    }

    fn varying_mut(&mut self) -> Option<&mut VaryingGains> {
        self.feedback.impedance.as_mut()?.varying_mut()
    }

    /// Sets the gains of this cycle, if they vary.
    fn vary_gains(&mut self, time_s: f64) {
        let Some(impedance) = &mut self.feedback.impedance else { return };
        let in_motion = |axis: usize| self.modes[axis] == AxisMode::Motion;
        impedance.vary(time_s, &Vector6::from_fn(|i, _| if in_motion(i) { self.error[i] } else { 0.0 }));
    }

    /// Returns the admittance and the force feedback of an axis that inverse kinematics moves with the force.
    fn admitted(&self, axis: usize) -> Option<(&Admittance, &ForceFeedback)> {
        let held = matches!(self.modes[axis], AxisMode::Compliant | AxisMode::Force);
        let admittance = self.admittance.as_ref().filter(|admittance| held && admittance.is_given(axis))?;
        Some((admittance, self.force.as_ref()?))
    }

    /// Returns the displacement of the pose `placement` from the measured one (m, rad; task axes).
    fn lead(&self, axes: &Matrix3<f64>, placement: &Placement) -> Vector6<f64> {
        let linear = axes.tr_mul(&(placement.translation - self.placement.translation));
        let angular =
            axes.tr_mul(&orientation::log(&(placement.rotation * self.placement.rotation.transpose())));
        Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
    }

    /// Returns the speed along (`kind` 0) or about (`kind` 1) the motion axes, with its limit.
    fn speed_limit(&self, kind: usize, limit: f64) -> SpeedLimit {
        let counts = |axis: usize| axis / 3 == kind && self.modes[axis] == AxisMode::Motion;
        let speed =
            (0..6).filter(|&i| counts(i)).map(|i| self.velocity[i] * self.velocity[i]).sum::<f64>().sqrt();
        let mut weights = Vector6::zeros();
        for (r, &axis) in self.axes.axes().iter().enumerate().filter(|(_, axis)| counts(**axis)) {
            weights[r] = self.velocity[axis] / (speed * self.axes.scale[axis]);
        }
        SpeedLimit { speed, limit, weights }
    }

    /// Returns the force that is added to Λ (a* − J̇ q̇), on the task's scaled rows. `task_inertia` is Λ of these rows.
    fn added_force(&self, task_inertia: &Matrix6<f64>) -> Vector6<f64> {
        let mut force =
            self.force.as_ref().map_or_else(|| Vector6::zeros() - self.streamed_force, ForceFeedback::added);
        let Some(impedance) = &self.feedback.impedance else {
            return self.axes.rows_of_force(&force);
        };
        let in_motion = |i: usize| self.modes[i] == AxisMode::Motion;
        if impedance.inertia.is_some() {
            // The desired inertia already responds to the sensed force: it must not act twice.
            if let Some(sensed) = self.force.as_ref().map(|f| f.sensed) {
                (0..6).filter(|&i| in_motion(i)).for_each(|i| force[i] -= sensed[i]);
            }
            return self.axes.rows_of_force(&force);
        }
        let mut velocity = self.axes.of_motion(&self.target.velocity) - self.velocity;
        for i in 0..6 {
            if in_motion(i) {
                force[i] += impedance.stiffness[i] * self.error[i];
            } else {
                velocity[i] = 0.0;
            }
        }
        let velocity = self.axes.rows_of(&velocity);
        self.axes.rows_of_force(&force)
            + impedance.damping_force(task_inertia, self.axes.axes(), &self.axes.scale, &velocity)
    }
}

impl BuildTask for CenterOfMassParameters {
    fn build(&self, name: &str, model: &Model, context: &ControlContext) -> Result<BuiltTask, ControlError> {
        Ok(BuiltTask::rows(CartesianTask::of_center_of_mass(name, self, model, context)?))
    }

    fn reference(&self) -> Option<TaskReference<'_>> {
        Some(TaskReference::Cartesian(&self.reference))
    }
}

impl BuildTask for CartesianParameters {
    fn build(&self, name: &str, model: &Model, context: &ControlContext) -> Result<BuiltTask, ControlError> {
        Ok(BuiltTask::rows(CartesianTask::new(name, self, model, context)?))
    }

    fn reference(&self) -> Option<TaskReference<'_>> {
        Some(TaskReference::Cartesian(&self.reference))
    }
}

impl CartesianTask {
    /// Records reference, motion, error and axes.
    fn record_motion(&self, out: &mut SignalRecorder<'_>) {
        let (name, xyz, wxyz) = (&self.name, &AXIS_NAMES[..3], &["w", "x", "y", "z"]);
        let quaternion = |rotation| {
            let q = orientation::quaternion(rotation);
            [q.w, q.i, q.j, q.k]
        };
        let (path, placement) = (&self.path, &self.placement);
        out.signal((name, REFERENCE), "m", xyz, path.placement.translation.as_slice());
        out.signal((name, POSITION), "m", xyz, placement.translation.as_slice());
        out.signal((name, REFERENCE_VELOCITY), "m/s", xyz, path.velocity.linear.as_slice());
        out.signal((name, VELOCITY), "m/s", xyz, self.linear_velocity.as_slice());
        out.signal((name, REFERENCE_ORIENTATION), "1", wxyz, &quaternion(&path.placement.rotation));
        out.signal((name, ORIENTATION), "1", wxyz, &quaternion(&placement.rotation));
        out.signal((name, ERROR), "m,rad", &AXIS_NAMES, self.error.as_slice());
        if self.surface.is_some() {
            out.signal((name, AXES), "1", wxyz, &quaternion(&self.axes.rotation));
        }
    }
}

impl Task for CartesianTask {
    fn name(&self) -> &str {
        &self.name
    }

    fn rows(&self) -> usize {
        self.axes.rows()
    }

    fn jacobian(&self, model: &Model, data: &Data, rows: &mut Matrix6xX<f64>) {
        self.axes.controlled.jacobian(model, data, rows);
        self.axes_at(model, data).select_in_place(rows);
    }

    fn update(&mut self, input: &TaskInput<'_>) {
        self.observe(input);
        self.sense(&input.control, input.limited);
        self.vary_gains(input.control.measurement.time_s);
    }

    fn bias(&self, model: &Model, data: &Data) -> Vector6<f64> {
        let axes = self.axes_at(model, data);
        axes.rows_of(&axes.of_motion(&axes.controlled.bias_acceleration(model, data)))
    }

    /// All axes of the task count as motion axes.
    fn kinematic_target(&self, model: &Model, data: &Data, gain_per_s: f64) -> Vector6<f64> {
        let axes = self.axes_at(model, data);
        let velocity = axes.of_motion(&self.target.velocity);
        if gain_per_s == 0.0 {
            return axes.rows_of(&velocity);
        }
        let mut active = [false; 6];
        axes.axes().iter().for_each(|&axis| active[axis] = true);
        let error = self.error_at(&axes.rotation, &axes.controlled.placement(model, data), active);
        axes.rows_of(&(velocity + error * gain_per_s))
    }

    /// Axes with an admittance move with the force error; all others follow the reference.
    fn kinematic_command(&self, model: &Model, data: &Data, gain_per_s: f64) -> Vector6<f64> {
        if self.admittance.is_none() {
            return self.kinematic_target(model, data, gain_per_s);
        }
        let axes = self.axes_at(model, data);
        let placement = axes.controlled.placement(model, data);
        let mut follows = [false; 6];
        axes.axes().iter().for_each(|&axis| follows[axis] = self.admitted(axis).is_none());
        let error = self.error_at(&axes.rotation, &placement, follows);
        let mut velocity = axes.of_motion(&self.target.velocity) + error * gain_per_s;
        let lead = self.lead(&axes.rotation, &placement);
        for &axis in axes.axes() {
            if let Some((admittance, force)) = self.admitted(axis) {
                velocity[axis] = match force.approach_velocity(axis) {
                    Some(approach) => admittance.bounded(axis, approach, lead[axis]),
                    None => admittance.velocity(axis, force.error(axis), lead[axis]),
                };
            }
        }
        axes.rows_of(&velocity)
    }

    fn kinematic_infeasibility(&self) -> Option<ControlError> {
        let in_force = |axis: &usize| self.modes[*axis] == AxisMode::Force && self.admitted(*axis).is_none();
        let axis = (0..6).find(in_force)?;
        let key = if axis < 3 { "admittance_ns_per_m" } else { "admittance_nms_per_rad" };
        let task = self.rows_key.strip_suffix(".axes").unwrap_or(&self.rows_key);
        let reason = Reason::AdmittanceMissing { axis: AXIS_NAMES[axis], key };
        Some(ControlError::new(format!("{task}.force.{key}"), reason))
    }

    fn acceleration(&self) -> Vector6<f64> {
        let wanted_velocity = self.axes.of_motion(&self.target.velocity);
        let wanted = self.axes.of_motion(&self.target.acceleration);
        let feedback = &self.feedback;
        let mut a = Vector6::zeros();
        for (i, mode) in self.modes.iter().enumerate() {
            a[i] = match mode {
                AxisMode::Free => 0.0,
                AxisMode::Compliant => -feedback.damping[i] * self.velocity[i],
                AxisMode::Force => {
                    let damping = feedback.damping[i];
                    let approach = self.force.as_ref().map_or(0.0, |f| f.approach_acceleration(i, damping));
                    approach - damping * self.velocity[i]
                }
                AxisMode::Motion => match &feedback.impedance {
                    None => {
                        wanted[i]
                            + feedback.damping[i] * (wanted_velocity[i] - self.velocity[i])
                            + feedback.stiffness[i] * (self.error[i] + feedback.integral[i])
                    }
                    Some(impedance) => {
                        let mut a = wanted[i];
                        if let (Some(inertia), Some(force)) = (&impedance.inertia, &self.force) {
                            let spring = impedance.stiffness[i] * self.error[i];
                            let damper = impedance.shaped_damping(inertia)[i]
                                * (wanted_velocity[i] - self.velocity[i]);
                            a += (spring + damper + force.sensed[i]) / inertia[i];
                        }
                        a
                    }
                },
            };
        }
        if feedback.impedance.is_none() && self.speed_limits != [f64::INFINITY; 2] {
            self.saturate_speed(&mut a, &wanted_velocity);
        }
        self.axes.rows_of(&a)
    }

    /// That of the reference; all of it where a sensed force is shaped.
    fn reference_acceleration(&self) -> Vector6<f64> {
        if self.feedback.impedance.as_ref().is_some_and(|impedance| impedance.inertia.is_some()) {
            return self.acceleration();
        }
        let mut a = self.axes.of_motion(&self.target.acceleration);
        for (a, _) in a.iter_mut().zip(self.modes).filter(|(_, mode)| *mode != AxisMode::Motion) {
            *a = 0.0;
        }
        self.axes.rows_of(&a)
    }

    fn yields_to_force(&self, row: usize) -> bool {
        self.axes.axes().get(row).is_some_and(|&axis| match self.modes[axis] {
            AxisMode::Compliant | AxisMode::Force => true,
            AxisMode::Motion => self.feedback.impedance.is_some(),
            AxisMode::Free => false,
        })
    }

    fn start(&mut self, input: &ControlInput<'_>) {
        let ControlInput { model, data, .. } = *input;
        let controlled = self.axes.controlled;
        self.home = controlled.placement(model, data);
        self.reset_settings();
        self.feedback.integral.fill(0.0);
        let axes = self.directions(model, data);
        self.begin(&Target::at_rest(self.home), &axes, input);
        self.start_force(input);
        if let Some(varying) = self.varying_mut() {
            varying.start(input.measurement.time_s);
        }
        self.follow(input);
    }

    fn observe(&mut self, input: &TaskInput<'_>) {
        self.take_target(input);
        self.follow(&input.control);
    }

    fn observe_with_forces(&mut self, input: &TaskInput<'_>) {
        self.observe(input);
        let input = self.force_input(&input.control, &self.axes.rotation);
        if let Some(force) = &mut self.force {
            force.update_targets(&input);
        }
        self.turn_with_surface();
    }

    /// Replans a goal or streamed reference from the current pose at rest, blends from there into any other reference,
    /// and resets the integrals.
    fn resume(&mut self, input: &ControlInput<'_>) {
        let ControlInput { model, data, measurement, .. } = *input;
        let controlled = self.axes.controlled;
        let from = Target::at_rest(controlled.placement(model, data));
        if let CartesianReference::Goal(_) | CartesianReference::Streamed(_) = self.reference {
            let axes = self.directions(model, data);
            self.begin(&from, &axes, input);
        } else {
            self.trajectory.join(measurement.time_s - self.start_s, &from);
        }
        self.feedback.integral.fill(0.0);
        self.start_force(input);
        if let Some(varying) = self.varying_mut() {
            varying.tank_mut().interrupt();
        }
        self.follow(input);
    }

    /// An unchanged reference continues. A different one starts at the previous target; on axes that were not motion
    /// axes, it starts at the frame's pose.
    fn inherit(&mut self, before: &mut dyn Task, input: &ControlInput<'_>) {
        match (before as &mut dyn Any).downcast_mut::<Self>() {
            Some(before) if before.axes.controlled == self.axes.controlled => {
                self.continue_from(before, input)
            }
            _ => self.start(input),
        }
    }

    /// Returns the forces of an impedance's springs and dampers, and the force feedback of compliant and force axes.
    fn force(&self, task_inertia: &Matrix6<f64>) -> Option<Vector6<f64>> {
        let adds_force = self.force.is_some()
            || self.feedback.impedance.is_some()
            || self.streamed_force != Vector6::zeros();
        adds_force.then(|| self.added_force(task_inertia))
    }

    fn set_added_force(&mut self, force: &Vector6<f64>) {
        let force = self.axes.force_of_rows(force);
        if let Some(varying) = self.varying_mut() {
            varying.tank_mut().set_force(&force);
        }
    }

    fn inputs(&self) -> Vec<Signal> {
        self.inputs.map_or_else(Vec::new, CartesianInputs::signals)
    }

    fn allowed_inputs(&self) -> AllowedInputs {
        self.allowed()
    }

    fn stop_for_age_s(&self) -> Option<f64> {
        self.streamed.as_ref().and_then(|streamed| streamed.freshness().stop_for_age_s())
    }

    fn contact_made(&self) -> Option<bool> {
        self.force.as_ref()?.contact_made()
    }

    fn inversion(&self) -> Inversion {
        self.inversion
    }

    fn escape(&self) -> SingularEscape {
        self.escape
    }

    fn weights(&self) -> Option<Vector6<f64>> {
        self.weights
    }

    fn when_limited(&self) -> WhenLimited {
        self.when_limited
    }

    fn inertia_floor_kg_m2(&self) -> Option<f64> {
        match self.decoupling {
            Decoupling::Full => None,
            Decoupling::Bounded { inertia_floor_kg_m2 } => Some(inertia_floor_kg_m2.get()),
        }
    }

    fn speed_limits(&self) -> [Option<SpeedLimit>; 2] {
        [0, 1].map(|kind| {
            let limit = self.speed_limits[kind];
            (limit < f64::INFINITY).then(|| self.speed_limit(kind, limit))
        })
    }

    fn sampled_jacobian(&self, model: &Model, data: &Data, rows: &mut Matrix6xX<f64>) {
        self.axes.controlled.jacobian(model, data, rows);
        self.axes.with_rotation(self.axes_frame.at_rest()).select_in_place(rows);
    }

    fn rows_key(&self) -> String {
        self.rows_key.clone()
    }

    fn kind(&self) -> &'static str {
        "cartesian or center-of-mass"
    }

    fn row_names(&self) -> Vec<String> {
        self.axes.axes().iter().map(|&axis| AXIS_NAMES[axis].to_owned()).collect()
    }

    fn follows_reference(&self, row: usize) -> bool {
        self.axes.axes().get(row).is_some_and(|&axis| self.modes[axis] == AxisMode::Motion)
    }

    fn row_unit(&self, row: usize) -> (&'static str, f64) {
        let axis = self.axes.axes().get(row).copied().unwrap_or(0);
        (if axis < 3 { "m" } else { "rad" }, self.axes.scale[axis])
    }

    fn reference_speeds(&self) -> [Option<f64>; 2] {
        let velocity = self.axes.of_motion(&self.target.velocity);
        [0, 3].map(|first| {
            let axes = (first..first + 3).filter(|&axis| self.modes[axis] == AxisMode::Motion);
            axes.map(|axis| velocity[axis] * velocity[axis]).reduce(|a, b| a + b).map(f64::sqrt)
        })
    }

    fn path_place(&self, time_s: f64) -> Option<PathPlace> {
        self.trajectory.place_at(time_s - self.start_s)
    }

    fn gains(&self, row: usize) -> Option<RowGains> {
        let &axis = self.axes.axes().get(row)?;
        let feedback = &self.feedback;
        if self.modes[axis] == AxisMode::Motion && feedback.impedance.is_some() {
            return None;
        }
        Some(RowGains {
            stiffness_per_s2: feedback.stiffness[axis],
            damping_per_s: feedback.damping[axis],
            integral_per_s: feedback.integral_per_s[axis],
        })
    }

    fn slack_signal(&self) -> Signal {
        Signal::new(signal_names::of(&self.name, SLACK), "m/s²,rad/s²", &AXIS_NAMES)
    }

    fn spread_slack(&self, rows: &Vector6<f64>, values: &mut [f64]) {
        values.fill(0.0);
        for (x, &axis) in rows.iter().zip(self.axes.axes()) {
            values[axis] = x / self.axes.scale[axis];
        }
    }

    fn record(&self, signals: TaskSignals<'_>, out: &mut SignalRecorder<'_>) {
        let name = &self.name;
        match signals {
            TaskSignals::Motion => self.record_motion(out),
            TaskSignals::Force(force) => {
                let force = self.axes.force_of_rows(force);
                out.signal((name, FORCE), "N,Nm", &AXIS_NAMES, force.as_slice());
            }
            TaskSignals::Gains => {
                let impedance = self.feedback.impedance.as_ref();
                if let Some(tank) = impedance.and_then(Impedance::varying).map(VaryingGains::tank) {
                    out.scalar((name, TANK), "J", tank.level_j());
                    out.signal((name, STIFFNESS), "N/m,Nm/rad", &AXIS_NAMES, tank.stiffness().as_slice());
                }
            }
            TaskSignals::Sensed => self.force.iter().for_each(|force| force.record(name, out)),
            TaskSignals::Target => {
                if let Some(streamed) = &self.streamed {
                    streamed.freshness().record(name, out);
                }
                if self.inputs.is_some() {
                    out.signal((name, MODES), "1", &AXIS_NAMES, &self.modes.map(AxisMode::code));
                }
            }
        }
    }
}

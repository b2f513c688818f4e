//! The Cartesian task: a frame that follows a reference on some axes and gives way on others.
//!
//! On its task axes, with x the frame's pose and v its velocity (Khatib 1987, with unit-mass gains):
//!
//! ```text
//! motion     a* = ẍ_d + 2ζω (ẋ_d − v) + ω² (x_d − x + ∫ integral gain (x_d − x) dt, bounded)
//! compliant  a* = −c v                                 and the force  −f_target + gain (f − f_target)
//! force      a* = −c v                                 the same, and  ∫ integral gain (f − f_target) dt, bounded
//! ```
//!
//! f is the sensed force ON the robot: with gain 0 the axis pushes with the target open loop, and the
//! gain makes the hand feel 1 + gain times lighter. Moments on rotation axes likewise. In place of the unit
//! mass an [`impedance`](crate::tasks::impedance) may be given, in newtons and metres.
//!
//! A speed limit ẋ_max bounds the speed that is asked for, and keeps its direction (Khatib 1987, §VI): with the
//! damping 2ζω taken out, a* = 2ζω (ν ẋ* − v) with ẋ* = ẋ_d + ω/(2ζ) (x_d − x) and ν = min(1, ẋ_max/|ẋ*|).

use crate::context::ControlContext;
use crate::error::{ControlError, Reason};
use crate::hierarchy::rank::characteristic_length;
use crate::limits::bounds::HORIZON_S;
use crate::measurement::Measurement;
use crate::orientation;
use crate::references::reference::{CartesianReference, Trajectory};
use crate::references::target::Target;
use crate::tasks::axes::{AXIS_NAMES, AxisMode, Directions};
use crate::tasks::cartesian_parameters::{
    CartesianParameters, CenterOfMassParameters, Decoupling, check_reference,
};
use crate::tasks::force::ForceFeedback;
use crate::tasks::gains::integrate;
use crate::tasks::law::Law;
use crate::tasks::subject::Subject;
use crate::tasks::task_axes::TaskAxes;
use nalgebra::{Matrix6, Matrix6xX, Vector3, Vector6};
use opspace_backend::quantity::Positive;
use opspace_backend::{Row, Signal};
use opspace_model::{Data, Inversion, Model, Placement};

/// A Cartesian task of one robot, and what it saw last.
#[derive(Clone, Debug)]
pub(crate) struct CartesianTask {
    pub name: String,
    pub axes: TaskAxes,
    pub inversion: Inversion,
    pub decoupling: Decoupling,
    directions: Directions,
    modes: [AxisMode; 6],
    law: Law,
    /// m/s and rad/s; infinite where there is none.
    pub speed_limits: [f64; 2],
    force: Option<ForceFeedback>,
    reference: CartesianReference,
    trajectory: Trajectory,
    /// When the trajectory began, s, and where the run began.
    start_s: f64,
    home: Placement,
    world_jacobian: Matrix6xX<f64>,
    /// Rows of the task, scaled.
    pub jacobian: Matrix6xX<f64>,
    /// Coordinates of the subject.
    pub target: Target,
    /// Where the file's reference is, whether or not the target has joined it.
    path: Target,
    placement: Placement,
    /// Of the subject, in the task's axes (m/s, rad/s).
    pub velocity: Vector6<f64>,
    /// Of the subject's origin, in its coordinates, m/s.
    linear_velocity: Vector3<f64>,
    /// Task axes, m and rad. Displacements on all three axes; turns only about those in motion, since the
    /// others would mix into them.
    error: Vector6<f64>,
}

impl CartesianTask {
    pub(crate) fn new(
        name: &str,
        parameters: &CartesianParameters,
        model: &Model,
        context: &ControlContext,
    ) -> Result<Self, ControlError> {
        let key = format!("task.{name}.cartesian");
        let subject = parameters.subject(model).map_err(|e| e.below(&key))?;
        Self::of_subject(name, &key, parameters, subject, model, context)
    }

    /// The task of the centre of mass.
    pub(crate) fn of_center_of_mass(
        name: &str,
        parameters: &CenterOfMassParameters,
        model: &Model,
        context: &ControlContext,
    ) -> Result<Self, ControlError> {
        let key = format!("task.{name}.center-of-mass");
        if parameters.axes.in_task()[3..].contains(&true) {
            return Err(ControlError::new(format!("{key}.axes"), Reason::CenterOfMassTurns));
        }
        Self::of_subject(name, &key, &parameters.as_cartesian(), Subject::CenterOfMass, model, context)
    }

    fn of_subject(
        name: &str,
        key: &str,
        parameters: &CartesianParameters,
        subject: Subject,
        model: &Model,
        context: &ControlContext,
    ) -> Result<Self, ControlError> {
        let at = |place: &str, reason: Reason| ControlError::new(format!("{key}.{place}"), reason);
        let directions = parameters.axes_in.resolve(model, subject).map_err(|e| at("axes_in", e.into()))?;
        let in_task = parameters.axes.in_task();
        if !in_task.contains(&true) {
            return Err(at("axes", Reason::NoAxis));
        }
        check_reference(parameters, &format!("{key}.reference"))?;
        let length_m = parameters
            .characteristic_length_m
            .map_or_else(|| characteristic_length(model, subject), Positive::get);
        let law = Law::new(parameters, context.period_s, key)?;
        let force = match &parameters.force {
            None if parameters.axes.modes().contains(&AxisMode::Force) => {
                return Err(at("force", Reason::ForceAxisUnsensed));
            }
            None => None,
            Some(force) => {
                let (axes, shaped) = (&parameters.axes, parameters.shapes_inertia());
                Some(ForceFeedback::new(force, axes, shaped, context, &format!("{key}.force"))?)
            }
        };
        let limit = |limit: Option<Positive>| limit.map_or(f64::INFINITY, Positive::get);
        let origin = Target::at_rest(Placement::identity());
        Ok(Self {
            name: name.to_owned(),
            axes: TaskAxes::new(subject, directions.at_rest(), in_task, length_m),
            inversion: parameters.singularities.inversion(parameters.singularity_threshold.get()),
            decoupling: parameters.decoupling,
            directions,
            modes: parameters.axes.modes(),
            law,
            speed_limits: [limit(parameters.speed_limit_m_per_s), limit(parameters.speed_limit_rad_per_s)],
            force,
            reference: parameters.reference.clone(),
            trajectory: Trajectory::new(&parameters.reference),
            start_s: 0.0,
            home: origin.placement,
            world_jacobian: Matrix6xX::zeros(model.n()),
            jacobian: Matrix6xX::zeros(model.n()),
            target: origin,
            path: origin,
            placement: origin.placement,
            velocity: Vector6::zeros(),
            linear_velocity: Vector3::zeros(),
            error: Vector6::zeros(),
        })
    }

    /// Begins where the robot is.
    pub(crate) fn start(&mut self, model: &Model, data: &Data, measurement: &Measurement) {
        let subject = self.axes.subject;
        self.home = subject.placement(model, data);
        self.start_s = measurement.time_s;
        self.law.integral.fill(0.0);
        let axes = self.directions.rotation(model, data, subject);
        self.trajectory.start(&self.home, &Target::at_rest(self.home), &axes);
        if let Some(force) = &mut self.force {
            force.start(measurement);
        }
        self.observe(model, data, measurement.time_s);
    }

    /// Joins its reference from the state of `data`, at rest; a goal is set out for anew. What was integrated is forgotten.
    pub(crate) fn resume(&mut self, model: &Model, data: &Data, measurement: &Measurement) {
        let subject = self.axes.subject;
        let from = Target::at_rest(subject.placement(model, data));
        if let CartesianReference::Goal(_) = self.reference {
            let axes = self.directions.rotation(model, data, subject);
            self.trajectory.start(&self.home, &from, &axes);
            self.start_s = measurement.time_s;
        } else {
            self.trajectory.join(measurement.time_s - self.start_s, &from);
        }
        self.law.integral.fill(0.0);
        if let Some(force) = &mut self.force {
            force.start(measurement);
        }
        self.observe(model, data, measurement.time_s);
    }

    /// Goes on from where a task of the same name in another stack stands: a reference that is the same goes on,
    /// another one begins where that one was, and where the frame is on axes that weren't in motion.
    pub(crate) fn take_over(
        &mut self,
        before: &mut Self,
        model: &Model,
        data: &Data,
        measurement: &Measurement,
    ) {
        if before.axes.subject != self.axes.subject {
            return self.start(model, data, measurement);
        }
        before.observe(model, data, measurement.time_s);
        self.home = before.home;
        let began =
            |axis: usize| self.modes[axis] == AxisMode::Motion && before.modes[axis] != AxisMode::Motion;
        let same = self.reference == before.reference && self.directions == before.directions;
        if same && !(0..6).any(began) {
            std::mem::swap(&mut self.trajectory, &mut before.trajectory);
            self.start_s = before.start_s;
        } else {
            let axes = self.directions.rotation(model, data, self.axes.subject);
            let from = before.joined(&axes, began);
            self.trajectory.start(&self.home, &from, &axes);
            self.start_s = measurement.time_s;
        }
        for axis in (0..6).filter(|&axis| !began(axis)) {
            let limit = self.law.integral_limit[axis];
            self.law.integral[axis] = before.law.integral[axis].clamp(-limit, limit);
        }
        match (&mut self.force, &before.force) {
            (Some(force), Some(before)) => force.take_over(before, measurement),
            (Some(force), None) => force.start(measurement),
            (None, _) => {}
        }
        self.observe(model, data, measurement.time_s);
    }

    /// The target, with where the frame is, at rest, in place of it along those `axes` that `began`; the frame's own
    /// orientation if any turn began.
    fn joined(&self, axes: &nalgebra::Matrix3<f64>, began: impl Fn(usize) -> bool) -> Target {
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

    /// Takes in where the frame is and where it should be.
    pub(crate) fn observe(&mut self, model: &Model, data: &Data, time_s: f64) {
        let subject = self.axes.subject;
        self.axes.rotation = self.directions.rotation(model, data, subject);
        let time_s = time_s - self.start_s;
        self.path = self.trajectory.reference_at(time_s);
        self.target = self.trajectory.joined(&self.path, time_s);
        self.placement = subject.placement(model, data);
        let velocity = subject.velocity(model, data);
        self.linear_velocity = velocity.linear;
        self.velocity = self.axes.of_motion(&velocity);
        self.error = self.error_at(&self.placement, self.modes.map(|m| m == AxisMode::Motion));
    }

    /// Takes in the sensed force, and lets integrals grow unless `hold`. After [`observe`](Self::observe).
    pub(crate) fn sense(&mut self, model: &Model, data: &Data, measurement: &Measurement, hold: bool) {
        if !hold {
            let law = &mut self.law;
            integrate(&mut law.integral, &self.error, &law.integral_step, &law.integral_limit);
        }
        if let Some(force) = &mut self.force {
            let subject = self.axes.subject;
            let axes = subject.coordinates(model, data) * self.axes.rotation;
            force.update(model, data, measurement, &axes, &subject.point(model, data), hold);
        }
    }

    /// By how far the target is from `placement` (m, rad; task axes). Rotations count about the axes of
    /// `counted` only.
    pub(crate) fn error_at(&self, placement: &Placement, counted: [bool; 6]) -> Vector6<f64> {
        let axes = &self.axes.rotation;
        let linear = axes.tr_mul(&(self.target.placement.translation - placement.translation));
        let counted = [counted[3], counted[4], counted[5]];
        if counted == [false; 3] {
            return Vector6::new(linear.x, linear.y, linear.z, 0.0, 0.0, 0.0);
        }
        let turn = self.target.placement.rotation * placement.rotation.transpose();
        let angular = orientation::log_about(&(axes.transpose() * turn * axes), counted);
        Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
    }

    /// The task's rows at the state of `data`, into [`jacobian`](Self::jacobian).
    pub(crate) fn update_jacobian(&mut self, model: &Model, data: &Data) {
        self.axes.rotation = self.directions.rotation(model, data, self.axes.subject);
        self.axes.subject.jacobian(model, data, &mut self.world_jacobian);
        self.axes.select(&self.world_jacobian, &mut self.jacobian);
    }

    /// J̇ q̇ on the task's rows, scaled.
    pub(crate) fn bias_acceleration(&self, model: &Model, data: &Data) -> Vector6<f64> {
        self.axes.rows_of(&self.axes.of_motion(&self.axes.subject.bias_acceleration(model, data)))
    }

    /// a* on the task's rows, scaled. After [`sense`](Self::sense).
    pub(crate) fn acceleration(&self) -> Vector6<f64> {
        let wanted_velocity = self.axes.of_motion(&self.target.velocity);
        let wanted = self.axes.of_motion(&self.target.acceleration);
        let law = &self.law;
        let mut a = Vector6::zeros();
        for (i, mode) in self.modes.iter().enumerate() {
            a[i] = match mode {
                AxisMode::Free => 0.0,
                AxisMode::Compliant | AxisMode::Force => -law.damping[i] * self.velocity[i],
                AxisMode::Motion => match &law.impedance {
                    None => {
                        wanted[i]
                            + law.damping[i] * (wanted_velocity[i] - self.velocity[i])
                            + law.stiffness[i] * (self.error[i] + law.integral[i])
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
        if law.impedance.is_none() && self.speed_limits != [f64::INFINITY; 2] {
            self.saturate_speed(&mut a, &wanted_velocity);
        }
        self.axes.rows_of(&a)
    }

    /// Takes from a* of the axes in motion what asks for more speed than is allowed.
    fn saturate_speed(&self, a: &mut Vector6<f64>, wanted_velocity: &Vector6<f64>) {
        let law = &self.law;
        for (kind, &limit) in self.speed_limits.iter().enumerate() {
            let in_motion = |i: &usize| self.modes[*i] == AxisMode::Motion && law.damping[*i] > 0.0;
            let axes = (3 * kind..3 * kind + 3).filter(in_motion);
            let asked = |i: usize| {
                wanted_velocity[i] + law.stiffness[i] / law.damping[i] * (self.error[i] + law.integral[i])
            };
            let speed = axes.clone().map(|i| asked(i) * asked(i)).sum::<f64>().sqrt();
            if speed > limit {
                for i in axes {
                    a[i] = law.damping[i] * (asked(i) * (limit / speed) - self.velocity[i]);
                }
            }
        }
    }

    /// ẋ* of the task's rows, scaled, at the state of `data`, with the error worked off at `gain` (1/s): every axis of
    /// the task as if it were in motion. After [`update_jacobian`](Self::update_jacobian).
    pub(crate) fn velocity_at(&self, model: &Model, data: &Data, gain: f64) -> Vector6<f64> {
        let mut in_task = [false; 6];
        self.axes.axes().iter().for_each(|&axis| in_task[axis] = true);
        let error = self.error_at(&self.axes.subject.placement(model, data), in_task);
        self.axes.rows_of(&(self.axes.of_motion(&self.target.velocity) + error * gain))
    }

    /// The bound that keeps the speed along (`kind` 0) or about (1) the axes in motion within its limit, where it comes
    /// near it: `row` (n) α ≤ the value, with α the joint accelerations and `bias` J̇ q̇ of the task's rows, scaled.
    pub(crate) fn speed_bound(&self, kind: usize, bias: &Vector6<f64>, row: &mut [f64]) -> Option<f64> {
        let limit = self.speed_limits[kind];
        let counts = |axis: usize| axis / 3 == kind && self.modes[axis] == AxisMode::Motion;
        let speed =
            (0..6).filter(|&i| counts(i)).map(|i| self.velocity[i] * self.velocity[i]).sum::<f64>().sqrt();
        // Far below its limit a speed has hardly a direction, and no need of a bound.
        if speed.is_nan() || speed <= 0.5 * limit {
            return None;
        }
        row.fill(0.0);
        let mut upper = (limit - speed) / HORIZON_S;
        for (r, &axis) in self.axes.axes().iter().enumerate().filter(|(_, axis)| counts(**axis)) {
            let share = self.velocity[axis] / (speed * self.axes.scale[axis]);
            upper -= share * bias[r];
            row.iter_mut().zip(self.jacobian.row(r).iter()).for_each(|(x, j)| *x += share * j);
        }
        Some(upper)
    }

    /// Whether there is anything to be added to the force of the inertia.
    pub(crate) fn adds_force(&self) -> bool {
        self.force.is_some() || self.law.impedance.is_some()
    }

    /// The force that is added to that of the inertia (on the task's rows, scaled): springs and dampers of an
    /// impedance, and what axes held to a force add. `task_inertia` is Λ of these rows. After
    /// [`sense`](Self::sense).
    pub(crate) fn added_force(&self, task_inertia: &Matrix6<f64>) -> Vector6<f64> {
        let mut force = self.force.as_ref().map_or_else(Vector6::zeros, ForceFeedback::added);
        let Some(impedance) = &self.law.impedance else {
            return self.axes.rows_of_force(&force);
        };
        let in_motion = |i: usize| self.modes[i] == AxisMode::Motion;
        if impedance.inertia.is_some() {
            // What the shaped inertia answers to must not act twice.
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
        row.put(self.path.placement.translation.as_slice());
        row.put(self.placement.translation.as_slice());
        row.put(self.path.velocity.linear.as_slice());
        row.put(self.linear_velocity.as_slice());
        for rotation in [&self.path.placement.rotation, &self.placement.rotation] {
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
        match &self.force {
            Some(force) => row.put(force.sensed.as_slice()),
            None => row.skip(6),
        }
    }
}

//! The torque controller: tasks in strict priority, dynamically decoupled.
//!
//! ```text
//! F_i = Λ_p (a* − J̇ q̇ − J_i M⁻¹ τ_above) + F_compliant        τ = Σ J_pᵀ F_i + τ_joint + C q̇ + g
//! ```
//!
//! J_p = J_i N is the task within the freedom N that the tasks above leave it. Khatib 1987 for one task;
//! Sentis and Khatib, *Synthesis of whole-body behaviors through hierarchical control of behavioral
//! primitives*, Int. J. Humanoid Robotics 2(4), 2005, for the levels.

use crate::axes::AXIS_NAMES;
use crate::controller::{CommandKind, Controller};
use crate::error::ControlError;
use crate::hierarchy::{Nullspace, ProjectedTask};
use crate::measurement::Measurement;
use crate::signal::{Observable, Row, Signal};
use crate::task::{Compensation, Levels, RobotFacts, Stack};
use nalgebra::{DVector, Vector6};
use opspace_model::{Data, Model};

/// Tasks to torques.
#[derive(Clone, Debug)]
pub struct OperationalSpaceController {
    levels: Levels,
    projected: Vec<ProjectedTask>,
    /// F_i in the task's axes, N and Nm.
    force: Vec<Vector6<f64>>,
    nullspace: Nullspace,
    compensation: Compensation,
    gravity_by_robot: bool,
    torque: DVector<f64>,
    joint_torque: DVector<f64>,
    scratch: DVector<f64>,
    joint_signals: Vec<Signal>,
}

impl OperationalSpaceController {
    /// The tasks of `stack` for a robot.
    ///
    /// # Errors
    /// Names that the robot doesn't have, axes that it can't move, gains that are missing: see
    /// [`Reason`](crate::error::Reason).
    pub fn new(model: &Model, stack: &Stack<'_>, robot: &RobotFacts) -> Result<Self, ControlError> {
        let levels = Levels::new(model, stack, robot)?;
        let n = model.n();
        let zero = DVector::zeros(n);
        Ok(Self {
            projected: vec![ProjectedTask::new(n); levels.cartesian.len()],
            force: vec![Vector6::zeros(); levels.cartesian.len()],
            nullspace: Nullspace::new(n, levels.cartesian.len()),
            compensation: stack.compensation,
            gravity_by_robot: robot.gravity_by_robot,
            torque: zero.clone(),
            joint_torque: zero.clone(),
            scratch: zero,
            joint_signals: levels.joint.as_ref().map_or_else(Vec::new, |task| task.signals(model)),
            levels,
        })
    }

    /// Adds the torques of the `level`-th Cartesian task and takes its freedom from those below.
    fn add_cartesian(&mut self, level: usize, model: &Model, data: &Data, measurement: &Measurement) {
        let task = &mut self.levels.cartesian[level];
        task.observe(model, data, measurement.time_s);
        task.sense(model, data, measurement);
        task.update_jacobian(model, data);
        let projected = &mut self.projected[level];
        let rows = task.axes.rows();
        projected.update(
            &data.mass_matrix_factor,
            &self.nullspace,
            &task.jacobian,
            rows,
            task.singularity_threshold,
        );

        // M⁻¹ τ_above.
        self.scratch.copy_from(&self.torque);
        data.mass_matrix_factor.solve(self.scratch.as_mut_slice());
        let acceleration = task.acceleration(model, data);
        let mut wanted = Vector6::zeros();
        for (row, &axis) in task.axes.axes().iter().enumerate() {
            let caused: f64 =
                task.jacobian.row(row).iter().zip(self.scratch.iter()).map(|(j, a)| j * a).sum();
            wanted[row] = acceleration[axis] * task.axes.scale[axis] - caused;
        }
        let mut force = projected.space.task_inertia * wanted;
        let added = task.added_force();
        self.force[level] = Vector6::zeros();
        for (row, &axis) in task.axes.axes().iter().enumerate() {
            // A row that is multiplied by a length belongs to a force that is divided by it.
            force[row] += added[axis] / task.axes.scale[axis];
            self.force[level][axis] = force[row] * task.axes.scale[axis];
        }
        for (t, column) in self.torque.iter_mut().zip(projected.jacobian.column_iter()) {
            for row in 0..rows {
                *t += column[row] * force[row];
            }
        }
        self.nullspace.narrow(projected);
    }

    /// The torque of the arm's own forces at joint `i` that the controller takes away.
    fn compensated(&self, data: &Data, i: usize) -> f64 {
        let own = match self.compensation {
            Compensation::Bias => data.bias[i],
            Compensation::Gravity => data.gravity[i],
        };
        if self.gravity_by_robot { own - data.gravity[i] } else { own }
    }
}

impl Controller for OperationalSpaceController {
    fn command_kind(&self) -> CommandKind {
        CommandKind::Torque
    }

    fn start(&mut self, model: &Model, data: &Data, measurement: &Measurement) {
        for task in &mut self.levels.cartesian {
            task.start(model, data, measurement);
        }
        if let Some(task) = &mut self.levels.joint {
            task.start(&measurement.q);
        }
    }

    fn update(&mut self, model: &Model, data: &Data, measurement: &Measurement, command: &mut [f64]) {
        self.torque.fill(0.0);
        self.nullspace.reset();
        for level in 0..self.levels.cartesian.len() {
            self.add_cartesian(level, model, data, measurement);
        }
        if let Some(task) = &mut self.levels.joint {
            let (scratch, torque) = (self.scratch.as_mut_slice(), self.joint_torque.as_mut_slice());
            task.torque(data, measurement.time_s, scratch, torque);
            self.nullspace.project_torque(torque);
            self.torque += &self.joint_torque;
        }
        for (i, out) in command.iter_mut().enumerate() {
            *out = self.torque[i] + self.compensated(data, i);
        }
    }
}

impl Observable for OperationalSpaceController {
    fn signals(&self) -> Vec<Signal> {
        let mut signals = Vec::new();
        for task in &self.levels.cartesian {
            signals.extend(task.motion_signals());
            signals.push(Signal::new(format!("{}.force", task.name), "N,Nm", &AXIS_NAMES));
            signals.extend(task.sensed_signal());
            signals.push(Signal::scalar(format!("{}.weakest_share", task.name), "1"));
        }
        signals.extend(self.joint_signals.iter().cloned());
        signals
    }

    fn sample(&self, row: &mut Row<'_>) {
        for ((task, projected), force) in self.levels.cartesian.iter().zip(&self.projected).zip(&self.force) {
            task.sample_motion(row);
            row.put(force.as_slice());
            task.sample_sensed(row);
            row.put_one(projected.space.weakest_share);
        }
        if let Some(task) = &self.levels.joint {
            task.sample(row);
        }
    }
}

//! The tasks of a robot in the order of their priority.

use crate::algebra::multiply;
use crate::controller::{ControlInput, StaleTarget};
use crate::hierarchy::joint_standstill::JointStandstill;
use crate::hierarchy::priority_level::PriorityLevel;
use crate::hierarchy::task_parameters::UNUSED_DAMPING_PER_S;
use crate::nullspace::Nullspace;
use crate::qp::level_cost::Reducible;
use crate::qp::lexicographic::Residual;
use crate::targets::{AllowedInputs, TargetPlace, Targets};
use crate::tasks::joint_task::JointTask;
use crate::tasks::task::{Task, TaskInput};
use crate::tasks::when_limited::WhenLimited;
use opspace_backend::signal_names::SLACK;
use opspace_backend::{Signal, SignalRecorder};
use opspace_model::{Data, Model};

/// Tasks of at most six rows in order of priority, and at most one task of all joints below them.
pub(crate) struct TaskHierarchy {
    pub levels: Vec<PriorityLevel>,
    pub joint: Option<Box<dyn JointTask>>,
    pub nullspace: Nullspace,
    /// Standstill of the task of all joints.
    pub joint_standstill: JointStandstill,
    /// Damping of the motion that the tasks leave, if there is no task of all joints (deceleration per velocity), 1/s.
    pub unused_damping_per_s: f64,
    /// Joint accelerations that limits took from the task of all joints (n).
    joint_slack: Vec<f64>,
    joint_names: Vec<String>,
    /// Units of joint accelerations (n).
    acceleration_units: Vec<String>,
    /// Positions of the joint task's streamed inputs in the row of targets.
    joint_target: TargetPlace,
}

impl TaskHierarchy {
    /// Creates an empty hierarchy for a robot.
    pub(crate) fn new(model: &Model) -> Self {
        let n = model.n();
        Self {
            levels: Vec::new(),
            joint: None,
            nullspace: Nullspace::new(n, 0),
            joint_standstill: JointStandstill::new(n),
            unused_damping_per_s: UNUSED_DAMPING_PER_S.get(),
            joint_slack: vec![0.0; n],
            joint_names: model.joints().iter().map(|joint| joint.name.clone()).collect(),
            acceleration_units: model
                .joint_units()
                .position
                .iter()
                .map(|unit| format!("{unit}/s²"))
                .collect(),
            joint_target: TargetPlace::default(),
        }
    }

    /// Tasks of at most six rows, the highest priority first.
    pub(crate) fn tasks(&self) -> impl Iterator<Item = &dyn Task> {
        self.levels.iter().map(|level| &*level.task)
    }

    /// Returns true if the levels leave some motion of `n` joints: degrees of freedom, or a damped direction. The
    /// damping of inversions for comparisons does not count: it is compared as published, without a brake.
    pub(crate) fn leaves_freedom(&self, n: usize) -> bool {
        let rows: usize = self.levels.iter().map(|level| level.task.rows()).sum();
        rows < n || self.levels.iter().any(PriorityLevel::is_damped)
    }

    /// Restrains the joint accelerations `acceleration` (n) and the torques `torque` (n) of the task of all joints where the
    /// tasks above cannot reach their goals, as otherwise they would draw the arm away from there: at a standstill, and
    /// along damped directions. `scratch` (n) is overwritten.
    pub(crate) fn restrain_joints(
        &mut self,
        data: &Data,
        period_s: f64,
        acceleration: &mut [f64],
        torque: &mut [f64],
        scratch: &mut [f64],
    ) {
        let standstills = self.levels.iter().map(|level| level.held_back.standstill());
        if self.joint_standstill.take(standstills, acceleration, period_s) {
            multiply(&data.mass_matrix, acceleration, torque);
        }
        for level in &self.levels {
            if level.is_damped() {
                level.brake_damped(data, self.unused_damping_per_s, acceleration, torque, scratch);
            }
        }
    }

    /// Residual of the last level, given the joint accelerations `ddq` (n) that all levels demand. `velocity` (n) is
    /// overwritten.
    pub(crate) fn joint_residual<'a>(
        &'a self,
        data: &Data,
        ddq: &[f64],
        horizon_s: f64,
        velocity: &'a mut [f64],
    ) -> Residual<'a> {
        let weights = self.joint.as_ref().and_then(|task| task.weights());
        let scaled = self.joint.as_ref().is_some_and(|task| task.when_limited() == WhenLimited::Scaled);
        if weights.is_none() && !scaled {
            return Residual::Joints;
        }
        velocity.iter_mut().zip(&data.dq).zip(ddq).for_each(|((v, dq), ddq)| *v = dq + horizon_s * ddq);
        self.nullspace.project_velocity(velocity);
        let velocity: &'a [f64] = velocity;
        let reducible = scaled.then_some(Reducible { velocity, horizon_s });
        Residual::WeightedJoints { weights, reducible }
    }

    /// Returns true if each joint deviates on its own at a bound of its acceleration: no task above couples the joints, they need
    /// not keep a direction, and no weights distribute their deviations.
    pub(crate) fn clips_joints(&self) -> bool {
        let is_plain =
            |task: &dyn JointTask| task.when_limited() != WhenLimited::Scaled && task.weights().is_none();
        self.levels.is_empty() && self.joint.as_deref().is_none_or(is_plain)
    }

    /// Adds the last level to the null space, which the unlimited command does not need.
    pub(crate) fn complete_nullspace(&mut self, data: &Data) {
        if let Some(level) = self.levels.last_mut() {
            level.projected.compute_jbar(&data.mass_matrix_factor);
            self.nullspace.push(&level.projected);
        }
    }

    /// Stores in each level what limits took from it, given the joint accelerations `taken` (n) that they took, which are
    /// overwritten.
    pub(crate) fn set_slack(&mut self, taken: &mut [f64]) {
        self.levels.iter_mut().for_each(|level| level.set_slack(taken));
        if self.joint.is_some() {
            self.nullspace.truncate(self.levels.len());
            self.nullspace.project_velocity(taken);
            self.joint_slack.copy_from_slice(taken);
        }
    }

    /// Lets the standstill of each level follow a cycle: see [`PriorityLevel::follow_standstill`].
    pub(crate) fn follow_standstills(
        &mut self,
        input: &ControlInput<'_>,
        alpha: &[f64],
        least_m_per_s: f64,
        period_s: f64,
    ) {
        let mut is_constant = true;
        for level in &mut self.levels {
            is_constant &= level.holds_reference();
            if level.is_observed() {
                level.follow_standstill(input, alpha, is_constant, least_m_per_s, period_s);
            }
        }
    }

    /// Resets what limits took from the levels if `was_limited`.
    pub(crate) fn clear_slack(&mut self, was_limited: bool) {
        if was_limited || self.levels.iter().any(|level| level.held_back.standstill().acts()) {
            self.levels.iter_mut().for_each(PriorityLevel::clear_slack);
            self.joint_slack.fill(0.0);
        }
    }

    /// Writes the joint velocities that the references ask for, by the priority of their tasks, into `velocity` (n; rad/s or
    /// m/s). Rows without a reference are at rest, and so is what no task controls.
    pub(crate) fn reference_velocity(
        &self,
        input: &ControlInput<'_>,
        velocity: &mut [f64],
        scratch: &mut [f64],
    ) {
        match self.joint.as_ref().and_then(|task| task.reference()) {
            Some((_, reference)) => {
                velocity.copy_from_slice(reference);
                self.nullspace.project_velocity(velocity);
            }
            None => velocity.fill(0.0),
        }
        for level in &self.levels {
            level.add_reference_velocity(input, velocity, scratch);
        }
    }

    /// Records what limits took from the task of all joints, with its name.
    pub(crate) fn record_joint_slack(&self, name: &str, out: &mut SignalRecorder<'_>) {
        out.signal((name, SLACK), &self.acceleration_units, &self.joint_names, &self.joint_slack);
    }

    /// Starts all tasks at the robot's present state.
    pub(crate) fn start(&mut self, input: &ControlInput<'_>) {
        self.levels.iter_mut().for_each(|level| level.start(input));
        if let Some(task) = &mut self.joint {
            task.start(input);
        }
    }

    /// Updates states and references in a cycle without torque command.
    pub(crate) fn observe(&mut self, input: &ControlInput<'_>) {
        self.levels.iter_mut().for_each(|level| level.observe(input));
        self.observe_joints(input);
    }

    /// Updates states and references to the time of the measurement, after an update with a predicted state.
    pub(crate) fn observe_measurement(&mut self, input: &ControlInput<'_>) {
        self.levels.iter_mut().for_each(|level| level.observe_measurement(input));
        self.observe_joints(input);
    }

    /// Updates states, references and sensed forces in a cycle of inverse kinematics.
    pub(crate) fn observe_with_forces(&mut self, input: &ControlInput<'_>) {
        self.levels.iter_mut().for_each(|level| level.observe_with_forces(input));
        self.observe_joints(input);
    }

    /// Updates state and reference of the task of all joints, which senses no forces.
    fn observe_joints(&mut self, input: &ControlInput<'_>) {
        let input = self.joint_input(input);
        if let Some(task) = &mut self.joint {
            task.observe(&input);
        }
    }

    /// Input of the task of all joints.
    pub(crate) fn joint_input<'a>(&self, control: &ControlInput<'a>) -> TaskInput<'a> {
        let target = self.joint_target.of(control.targets, control.clock_s);
        TaskInput { control: *control, limited: false, target }
    }

    /// Looks up the positions of the tasks' inputs in the row of targets. Allocates nothing.
    pub(crate) fn bind(&mut self, targets: &Targets) {
        for level in &mut self.levels {
            level.target = targets.place(level.task.name());
        }
        if let Some(task) = &self.joint {
            self.joint_target = targets.place(task.name());
        }
    }

    /// Name and inputs of each task that has inputs.
    pub(crate) fn inputs(&self) -> impl Iterator<Item = (&str, Vec<Signal>, AllowedInputs)> {
        let tasks = self.tasks().map(|task| (task.name(), task.inputs(), task.allowed_inputs()));
        let joint = self.joint.iter().map(|task| (task.name(), task.inputs(), AllowedInputs::default()));
        tasks.chain(joint).filter(|(_, inputs, _)| !inputs.is_empty())
    }

    /// Returns the first stale target that requires the robot to stop.
    pub(crate) fn stale_target(&self) -> Option<StaleTarget> {
        let ages = self.tasks().map(Task::stop_for_age_s);
        let mut ages = ages.chain(self.joint.iter().map(|task| task.stop_for_age_s())).enumerate();
        ages.find_map(|(task, age_s)| age_s.map(|age_s| StaleTarget { task, age_s }))
    }

    /// Blends from the state of `input.data`, at rest, into the references. Allocates nothing.
    pub(crate) fn resume(&mut self, input: &ControlInput<'_>) {
        self.levels.iter_mut().for_each(|level| level.resume(input));
        if let Some(task) = &mut self.joint {
            task.resume(input);
        }
    }

    /// Continues from another hierarchy: each task continues from the task of the same name in `before`; a task without
    /// one starts at the robot's present state. Allocates nothing.
    pub(crate) fn inherit(&mut self, before: &mut Self, input: &ControlInput<'_>) {
        for level in &mut self.levels {
            match before.levels.iter_mut().find(|other| other.name() == level.name()) {
                Some(before) => level.inherit(before, input),
                None => level.start(input),
            }
        }
        if let Some(task) = &mut self.joint {
            match before.joint.as_mut().filter(|other| other.name() == task.name()) {
                Some(before) => task.inherit(&mut **before, input),
                None => task.start(input),
            }
        }
    }
}

//! The trait of a task of up to six rows at a priority level.

use crate::controller::ControlInput;
use crate::error::ControlError;
use crate::references::path_bounds::PathPlace;
use crate::targets::{AllowedInputs, TaskTarget};
use crate::tasks::singular_escape::SingularEscape;
use crate::tasks::when_limited::WhenLimited;
use nalgebra::{Matrix6, Matrix6xX, Vector6};
use opspace_backend::{Signal, SignalRecorder, signal_names};
use opspace_model::{Data, Inversion, Model};
use std::any::Any;

/// Threshold of the [default inversion](DEFAULT_INVERSION) at rest, relative to the typical mobility.
pub const THRESHOLD_AT_REST: f64 = 0.005;

/// Highest threshold of the default inversion, relative to the typical mobility.
pub const LARGEST_THRESHOLD: f64 = 0.3;

/// Demand with which the default inversion reaches its highest threshold, m/s².
pub const FULL_DEMAND_M_PER_S2: f64 = 4.0;

/// Default [`inversion`](Task::inversion): the threshold grows with the demand to 0.3 of the typical mobility.
pub const DEFAULT_INVERSION: Inversion = Inversion::Adaptive {
    least: THRESHOLD_AT_REST,
    most: LARGEST_THRESHOLD,
    full_demand: FULL_DEMAND_M_PER_S2,
};

/// Input of a task in one cycle.
#[derive(Clone, Copy, Debug)]
pub struct TaskInput<'a> {
    /// Input of the controller.
    pub control: ControlInput<'a>,
    /// True if a limit prevented the task's desired acceleration in the last cycle: the integrators must stop.
    pub limited: bool,
    /// Streamed inputs of the task.
    pub target: TaskTarget<'a>,
}

/// Linearised feedback gains of one row: ẍ* = … + k (e + i ∫ e dt) + d ė.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowGains {
    /// Stiffness k, 1/s².
    pub stiffness_per_s2: f64,
    /// Damping d, 1/s.
    pub damping_per_s: f64,
    /// Integral gain i, 1/s.
    pub integral_per_s: f64,
}

/// Speed of some of a task's rows, and its limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedLimit {
    /// Current speed v, m/s or rad/s.
    pub speed: f64,
    /// Highest speed, in the unit of `speed`.
    pub limit: f64,
    /// Weights w of the rows: the speed is w · (J q̇).
    pub weights: Vector6<f64>,
}

/// A task of up to six rows: ẍ = J q̈ + J̇ q̇ follows a desired acceleration in the null space of the tasks above.
///
/// The number of rows is fixed. [`start`](Self::start) is called once before the first cycle; then, in every cycle,
/// [`update`](Self::update) is called before [`acceleration`](Self::acceleration) and [`force`](Self::force). Methods
/// with a state (`model` and `data`) must be valid at any state, and may depend otherwise only on the last update.
/// Methods that are called in every cycle must not allocate.
pub trait Task: Any + Send {
    /// Name of the task, unique in the task set.
    fn name(&self) -> &str;

    /// Number of rows, from 1 to 6.
    fn rows(&self) -> usize;

    /// Computes J (6 × n) at the state of `data`: the task's rows come first, the other rows are zero.
    fn jacobian(&self, model: &Model, data: &Data, rows: &mut Matrix6xX<f64>);

    /// Updates state, reference and sensed forces of this cycle.
    fn update(&mut self, input: &TaskInput<'_>);

    /// J̇ q̇ of the rows at the state of `data`.
    fn bias(&self, model: &Model, data: &Data) -> Vector6<f64>;

    /// Velocity ẋ_d + gain (x_d − x) of the rows, with x at the state of `data` and x_d as of the last update.
    fn kinematic_target(&self, model: &Model, data: &Data, gain_per_s: f64) -> Vector6<f64>;

    /// Velocity of the rows that inverse kinematics commands, with x at the state of `data`, which is that of the command:
    /// [`kinematic_target`](Self::kinematic_target), except for rows that move with a sensed force.
    fn kinematic_command(&self, model: &Model, data: &Data, gain_per_s: f64) -> Vector6<f64> {
        self.kinematic_target(model, data, gain_per_s)
    }

    /// Returns an error if inverse kinematics cannot execute the task.
    fn kinematic_infeasibility(&self) -> Option<ControlError> {
        None
    }

    /// Desired acceleration a* of the rows, computed by the last update.
    fn acceleration(&self) -> Vector6<f64>;

    /// Part of [`acceleration`](Self::acceleration) that the task intends, without what it does about deviations: usually
    /// ẍ_d of the rows that follow a reference, and 0 on the others. Rows of lower tasks that
    /// [yield to forces](Self::yields_to_force) are decoupled from this part only. All of it if this is not known.
    fn reference_acceleration(&self) -> Vector6<f64> {
        self.acceleration()
    }

    /// Returns true if a row is to respond to external forces in a stated way, such as an impedance, a compliant axis or a
    /// force axis. It then does not take part in what the tasks above do about their deviations, as an external force is
    /// mostly why they do it.
    fn yields_to_force(&self, _row: usize) -> bool {
        false
    }

    /// Starts at the robot's present state. May allocate.
    fn start(&mut self, _input: &ControlInput<'_>) {}

    /// Updates state and reference, but neither sensed forces nor integrals, in a cycle without torque command;
    /// `input.limited` is true.
    fn observe(&mut self, input: &TaskInput<'_>) {
        self.update(input);
    }

    /// Updates state and reference to the time of the measurement, for what is recorded, in a cycle in which
    /// [`update`](Self::update) has seen the state that is predicted for a late command; `input.limited` is true.
    fn observe_measurement(&mut self, input: &TaskInput<'_>) {
        self.observe(input);
    }

    /// Updates state, reference and sensed forces in a cycle of inverse kinematics; `input.limited` is true.
    fn observe_with_forces(&mut self, input: &TaskInput<'_>) {
        self.observe(input);
    }

    /// Inputs that can be streamed to the task; their names do not contain the task's name. They are constant, and
    /// equal in all task sets in which a task of this name has inputs.
    fn inputs(&self) -> Vec<Signal> {
        Vec::new()
    }

    /// Streamed values that the task accepts; used only by the handle of a Cartesian task.
    fn allowed_inputs(&self) -> AllowedInputs {
        AllowedInputs::default()
    }

    /// Age of a stale target, s, if the target requires the robot to stop.
    fn stop_for_age_s(&self) -> Option<f64> {
        None
    }

    /// True if all force axes that approach until they touch are in contact, false if one of them approaches; `None` for a
    /// task without such axes.
    fn contact_made(&self) -> Option<bool> {
        None
    }

    /// Blends from the state of `input.data`, at rest, into the reference after a hold. Allocates nothing.
    fn resume(&mut self, input: &ControlInput<'_>) {
        self.start(input);
    }

    /// Continues from the task of the same name in the previous task set; `(before as &mut dyn Any).downcast_mut()`
    /// gives it if it has the same type. Allocates nothing.
    fn inherit(&mut self, _before: &mut dyn Task, input: &ControlInput<'_>) {
        self.start(input);
    }

    /// Returns a force on the rows that is added to Λ (a* − J̇ q̇); `task_inertia` is Λ.
    fn force(&self, _task_inertia: &Matrix6<f64>) -> Option<Vector6<f64>> {
        None
    }

    /// Receives the force that is added to Λ (a* − J̇ q̇) in this cycle: that of [`force`](Self::force), without what an
    /// escape from a singular pose removes. Limits may still reduce it.
    fn set_added_force(&mut self, _force: &Vector6<f64>) {}

    /// Receives the force that limits take from the rows in this cycle. It is called after [`force`](Self::force), and only in cycles
    /// in which limits change the command.
    fn set_force_taken(&mut self, _force: &Vector6<f64>) {}

    /// Method for the inversion of Λ⁻¹ near singularities; its thresholds are relative to the typical mobility.
    fn inversion(&self) -> Inversion {
        DEFAULT_INVERSION
    }

    /// Behaviour of the task if it rests in a singular pose, away from its goal; only for torque control. It is constant.
    fn escape(&self) -> SingularEscape {
        SingularEscape::None
    }

    /// Lower bound of M's diagonal in the Λ that converts accelerations to forces, kg m²; `None` for the arm's own M.
    fn inertia_floor_kg_m2(&self) -> Option<f64> {
        None
    }

    /// Weights of the rows' deviations when limits are in force, each above zero; `None` if they are equal. They are
    /// constant.
    fn weights(&self) -> Option<Vector6<f64>> {
        None
    }

    /// Change of the desired acceleration that limits do not allow. It is constant.
    fn when_limited(&self) -> WhenLimited {
        WhenLimited::LeastSquares
    }

    /// Linear and angular speed, if they are limited.
    fn speed_limits(&self) -> [Option<SpeedLimit>; 2] {
        [None; 2]
    }

    /// Computes J in axes that do not rotate with the robot, for the sampling of rank and typical mobility.
    fn sampled_jacobian(&self, model: &Model, data: &Data, rows: &mut Matrix6xX<f64>) {
        self.jacobian(model, data, rows);
    }

    /// Key of the rows in a task file, for error messages.
    fn rows_key(&self) -> String {
        format!("task.{}", self.name())
    }

    /// Kind of the task, for error messages. It must be the same in all task sets.
    fn kind(&self) -> &'static str {
        "task"
    }

    /// Name of each row, for error messages and signals.
    fn row_names(&self) -> Vec<String> {
        (0..self.rows()).map(|row| format!("row{row}")).collect()
    }

    /// Returns true if a row follows a reference; false for a compliant or force row.
    fn follows_reference(&self, _row: usize) -> bool {
        true
    }

    /// Unit of a row's coordinate, and the factor by which the row is multiplied.
    fn row_unit(&self, _row: usize) -> (&'static str, f64) {
        ("1", 1.0)
    }

    /// Linear (m/s) and angular (rad/s) speed of the reference at the last update, over the rows that follow it; `None`
    /// if there are no such rows.
    fn reference_speeds(&self) -> [Option<f64>; 2] {
        [None; 2]
    }

    /// Place on a path reference at `time_s`, on the clock of the measurements; `None` for other references.
    fn path_place(&self, _time_s: f64) -> Option<PathPlace> {
        None
    }

    /// Linearised gains of a row; `None` if they are unknown.
    fn gains(&self, _row: usize) -> Option<RowGains> {
        None
    }

    /// Records a group of signals, each with its name, unit, elements and values. The signals of a group must be the same in
    /// every cycle. Groups that a task does not have are left to [`record_force_of_rows`](Self::record_force_of_rows).
    ///
    /// ```
    /// # use opspace_backend::SignalRecorder;
    /// # use opspace_control::{Task, TaskSignals};
    /// # fn record(task: &dyn Task, depth_m: f64, signals: TaskSignals<'_>, out: &mut SignalRecorder<'_>) {
    /// match signals {
    ///     TaskSignals::Motion => out.signal((task.name(), "depth"), "m", &["depth"], &[depth_m]),
    ///     other => task.record_force_of_rows(other, out),
    /// }
    /// # }
    /// ```
    fn record(&self, signals: TaskSignals<'_>, out: &mut SignalRecorder<'_>) {
        self.record_force_of_rows(signals, out);
    }

    /// Records the force on the rows, if the group is that of the force.
    fn record_force_of_rows(&self, signals: TaskSignals<'_>, out: &mut SignalRecorder<'_>) {
        let TaskSignals::Force(force) = signals else { return };
        let signal = || {
            let units: Vec<&str> = (0..self.rows()).map(|row| force_unit(self.row_unit(row).0)).collect();
            Signal::new(signal_names::of(self.name(), signal_names::FORCE), &units, &self.row_names())
        };
        out.signal_with(signal, &force.as_slice()[..self.rows()]);
    }

    /// Signal of the acceleration that limits take from the rows; only for torque control. It is equal in all task sets in
    /// which a task of this name occurs.
    fn slack_signal(&self) -> Signal {
        let units: Vec<String> = (0..self.rows()).map(|row| format!("{}/s²", self.row_unit(row).0)).collect();
        Signal::new(signal_names::of(self.name(), signal_names::SLACK), &units, &self.row_names())
    }

    /// Writes the acceleration that limits take from the `rows` into the values of
    /// [`slack_signal`](Self::slack_signal).
    fn spread_slack(&self, rows: &Vector6<f64>, values: &mut [f64]) {
        for (row, (value, x)) in values.iter_mut().zip(rows).enumerate() {
            *value = x / self.row_unit(row).1;
        }
    }
}

/// Groups of signals that a task records, in the order of a row.
#[derive(Clone, Copy, Debug)]
pub enum TaskSignals<'a> {
    /// Reference and motion.
    Motion,
    /// Force on the rows, with its values (rows first; N, Nm or N per unit of the coordinate); only for torque control.
    Force(&'a Vector6<f64>),
    /// Gains that vary; only for torque control. Unlike other signals, a task may have these in some task sets only.
    Gains,
    /// Quantities that the task senses.
    Sensed,
    /// Streamed target.
    Target,
}

/// Sets the values of the rows of a task that do not follow a reference to zero.
pub(crate) fn clear_free_rows(task: &dyn Task, values: &mut Vector6<f64>) {
    for row in (0..task.rows()).filter(|row| !task.follows_reference(*row)) {
        values[row] = 0.0;
    }
}

/// Unit of the force that is conjugate to a coordinate.
fn force_unit(coordinate: &str) -> &'static str {
    if coordinate == "m" { "N" } else { "Nm" }
}

//! The trait of a task of up to six rows at a place in the priority.

use crate::controller::ControlInput;
use crate::error::ControlError;
use crate::targets::{AllowedInputs, TaskTarget};
use nalgebra::{Matrix6, Matrix6xX, Vector6};
use opspace_backend::{Signal, SignalRecorder, signal_names};
use opspace_model::{Data, Inversion, Model};
use std::any::Any;

/// Threshold of the default [`inversion`](Task::inversion): 0.3 of the typical mobility.
pub const SINGULARITY_THRESHOLD: f64 = 0.3;

/// Input of a task in one cycle.
#[derive(Clone, Copy, Debug)]
pub struct TaskInput<'a> {
    /// Input of the controller.
    pub control: ControlInput<'a>,
    /// A limit kept the task from its acceleration in the last cycle: integrals stand still.
    pub limited: bool,
    /// Streamed inputs of the task.
    pub target: TaskTarget<'a>,
}

/// Feedback gains of one row, linearised: ẍ* = … + k (e + i ∫ e dt) + d ė.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowGains {
    /// Stiffness k, 1/s².
    pub stiffness_per_s2: f64,
    /// Damping d, 1/s.
    pub damping_per_s: f64,
    /// Integral gain i, 1/s.
    pub integral_per_s: f64,
}

/// Speed of some rows of a task, and its limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedLimit {
    /// Present speed v, in the unit of the limit.
    pub speed: f64,
    /// Highest speed.
    pub limit: f64,
    /// Weights w of the rows: w · (J q̇) is the speed.
    pub weights: Vector6<f64>,
}

/// A task of up to six rows: ẍ = J q̈ + J̇ q̇ follows a desired acceleration within the freedom that the tasks above
/// leave.
///
/// The number of rows is fixed. [`start`](Self::start) is called once before the first cycle; then, in every cycle,
/// [`update`](Self::update) before [`acceleration`](Self::acceleration) and [`force`](Self::force). Methods that take
/// a state (`model` and `data`) hold at any state, and use of the task only what the last update left.
/// Nothing called per cycle may allocate.
pub trait Task: Any + Send {
    /// Name in the priority; unique among the tasks.
    fn name(&self) -> &str;

    /// Number of rows, from 1 to 6.
    fn rows(&self) -> usize;

    /// Computes J (6 × n) at the state of `data`: the task's rows come first.
    fn jacobian(&self, model: &Model, data: &Data, rows: &mut Matrix6xX<f64>);

    /// Takes in the state, the reference and sensed forces of this cycle.
    fn update(&mut self, input: &TaskInput<'_>);

    /// J̇ q̇ of the rows at the state of `data`.
    fn bias(&self, model: &Model, data: &Data) -> Vector6<f64>;

    /// Velocity ẋ_d + gain (x_d − x) of the rows, with x at the state of `data` and x_d as of the last update.
    fn kinematic_target(&self, model: &Model, data: &Data, gain_per_s: f64) -> Vector6<f64>;

    /// Desired acceleration a* of the rows, as of the last update.
    fn acceleration(&self) -> Vector6<f64>;

    /// Begins at the robot's present state. May allocate.
    fn start(&mut self, _input: &ControlInput<'_>) {}

    /// Takes in the state and the reference, but neither sensed forces nor integrals: for cycles without torques, in
    /// which `input.limited` is true.
    fn observe(&mut self, input: &TaskInput<'_>) {
        self.update(input);
    }

    /// Inputs that can be streamed to the task, their names without the task's. Fixed; the same in all task sets in
    /// which a task of this name has inputs.
    fn inputs(&self) -> Vec<Signal> {
        Vec::new()
    }

    /// Streamed values that the task takes; only a Cartesian task's handle asks for them.
    fn allowed_inputs(&self) -> AllowedInputs {
        AllowedInputs::default()
    }

    /// Age of a stale target, s, if the robot is to be stopped for it.
    fn stop_for_age_s(&self) -> Option<f64> {
        None
    }

    /// Records the signals of the streamed target.
    fn record_target(&self, _out: &mut SignalRecorder<'_>) {}

    /// Joins the reference from the state of `input.data`, at rest, after the robot was held. Allocates nothing.
    fn resume(&mut self, input: &ControlInput<'_>) {
        self.start(input);
    }

    /// Continues from the task of this name in the task set before; `(before as &mut dyn Any).downcast_mut()` finds one
    /// of the same type. Allocates nothing.
    fn inherit(&mut self, _before: &mut dyn Task, input: &ControlInput<'_>) {
        self.start(input);
    }

    /// Force on the rows that is added to Λ (a* − J̇ q̇), given Λ.
    fn force(&self, _task_inertia: &Matrix6<f64>) -> Option<Vector6<f64>> {
        None
    }

    /// Inversion of Λ⁻¹ near singularities; thresholds are relative to the typical mobility.
    fn inversion(&self) -> Inversion {
        Inversion::Damped(SINGULARITY_THRESHOLD)
    }

    /// Least inertia on the diagonal of M with which accelerations become forces, kg m²; the arm's own M if `None`.
    fn inertia_floor_kg_m2(&self) -> Option<f64> {
        None
    }

    /// Linear and angular speed, where they have a limit.
    fn speed_limits(&self) -> [Option<SpeedLimit>; 2] {
        [None; 2]
    }

    /// J in axes that don't turn with the robot, from which rank and typical mobility are sampled.
    fn sampled_jacobian(&self, model: &Model, data: &Data, rows: &mut Matrix6xX<f64>) {
        self.jacobian(model, data, rows);
    }

    /// An error if the rows can't be independent on this robot, whatever the state, and the task knows why.
    fn infeasibility(&self, _model: &Model) -> Option<ControlError> {
        None
    }

    /// Key of the rows in a task file, for errors.
    fn rows_key(&self) -> String {
        format!("task.{}", self.name())
    }

    /// Kind of the task, for errors. A task keeps its kind when task sets are switched.
    fn kind(&self) -> &'static str {
        "task"
    }

    /// Name of each row, for messages and signals.
    fn row_names(&self) -> Vec<String> {
        (0..self.rows()).map(|row| format!("row{row}")).collect()
    }

    /// Returns true if a row follows a reference; a compliant or force row doesn't.
    fn follows_reference(&self, _row: usize) -> bool {
        true
    }

    /// Unit of a row's coordinate, and the factor by which the row is multiplied.
    fn row_unit(&self, _row: usize) -> (&'static str, f64) {
        ("1", 1.0)
    }

    /// Linear (m/s) and angular (rad/s) speed of the reference as of the last update, over the rows that follow it;
    /// `None` where there are no such rows.
    fn reference_speeds(&self) -> [Option<f64>; 2] {
        [None; 2]
    }

    /// Linearised gains of a row; `None` if the task doesn't tell.
    fn gains(&self, _row: usize) -> Option<RowGains> {
        None
    }

    /// Records the signals of reference and motion, always the same ones: each with its name, unit, elements and values.
    ///
    /// ```
    /// # use opspace_backend::SignalRecorder;
    /// # struct Press { name: String, depth_m: f64 }
    /// # impl Press {
    /// fn record(&self, out: &mut SignalRecorder<'_>) {
    ///     out.signal((&self.name, "depth"), "m", &["depth"], &[self.depth_m]);
    /// }
    /// # }
    /// ```
    fn record(&self, _out: &mut SignalRecorder<'_>) {}

    /// Records the signal of the force on the rows, where torques are commanded.
    fn record_force(&self, force: &Vector6<f64>, out: &mut SignalRecorder<'_>) {
        let signal = || {
            let units: Vec<&str> = (0..self.rows()).map(|row| force_unit(self.row_unit(row).0)).collect();
            Signal::new(signal_names::of(self.name(), signal_names::FORCE), &units, &self.row_names())
        };
        out.signal_with(signal, &force.as_slice()[..self.rows()]);
    }

    /// Records the signal of what the task senses, where torques are commanded.
    fn record_sensed(&self, _out: &mut SignalRecorder<'_>) {}
}

/// Unit of the force that does work on a coordinate.
fn force_unit(coordinate: &str) -> &'static str {
    if coordinate == "m" { "N" } else { "Nm" }
}

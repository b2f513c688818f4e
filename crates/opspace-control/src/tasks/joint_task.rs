//! The trait of a task of all joints, in the freedom that the other tasks leave.

use crate::controller::ControlInput;
use crate::tasks::task::{RowGains, TaskInput};
use opspace_backend::{Signal, SignalRecorder};
use std::any::Any;

/// A task of all n joints, last in the priority.
///
/// Nothing called per cycle may allocate.
pub trait JointTask: Any + Send {
    /// Name in the priority; unique among the tasks.
    fn name(&self) -> &str;

    /// Computes joint accelerations (n) and the torques (n; Nm, N) that cause them, before projection.
    fn update(&mut self, input: &TaskInput<'_>, acceleration: &mut [f64], torque: &mut [f64]);

    /// Computes the joint velocities (n) that return to the target from `q` (n); `false` if the task asks for none. A
    /// [reference](Self::reference) is approached with `gain_per_s`, a posture with `posture_gain_per_s`.
    fn kinematic_target(
        &self,
        q: &[f64],
        gain_per_s: f64,
        posture_gain_per_s: f64,
        velocity: &mut [f64],
    ) -> bool;

    /// Begins at the robot's present state. May allocate.
    fn start(&mut self, _input: &ControlInput<'_>) {}

    /// Takes in the state and the reference, in cycles without torques.
    fn observe(&mut self, _input: &TaskInput<'_>) {}

    /// Inputs that can be streamed to the task, their names without the task's. Fixed; the same in all task sets in
    /// which a task of this name has inputs.
    fn inputs(&self) -> Vec<Signal> {
        Vec::new()
    }

    /// Age of a stale target, s, if the robot is to be stopped for it.
    fn stop_for_age_s(&self) -> Option<f64> {
        None
    }

    /// Records the signals of the streamed target.
    fn record_target(&self, _out: &mut SignalRecorder<'_>) {}

    /// Joins the reference from the state of `input.data`, at rest, after the robot was held. Allocates nothing.
    fn resume(&mut self, _input: &ControlInput<'_>) {}

    /// Continues from the task of this name in the task set before; `(before as &mut dyn Any).downcast_mut()` finds one
    /// of the same type. Allocates nothing.
    fn inherit(&mut self, _before: &mut dyn JointTask, input: &ControlInput<'_>) {
        self.start(input);
    }

    /// Reference position and velocity of the joints (n each), if the task follows a motion.
    fn reference(&self) -> Option<(&[f64], &[f64])> {
        None
    }

    /// Linearised gains of a joint whose inertia with its drive is `inertia` (kg m² or kg); `None` if the task doesn't
    /// tell.
    fn gains(&self, _joint: usize, _inertia: f64) -> Option<RowGains> {
        None
    }

    /// Kind of the task, for errors. A task keeps its kind when task sets are switched.
    fn kind(&self) -> &'static str {
        "task of all joints"
    }

    /// Records the signals of reference and motion, always the same ones.
    fn record(&self, _out: &mut SignalRecorder<'_>) {}
}

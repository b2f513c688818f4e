//! The trait of a task of all joints, in the null space of the other tasks.
//!
//! ```text
//! τ = Nᵀ τ_joint
//! ```

use crate::controller::ControlInput;
use crate::tasks::task::{RowGains, TaskInput, TaskSignals};
use crate::tasks::when_limited::WhenLimited;
use opspace_backend::{Signal, SignalRecorder};
use std::any::Any;

/// A task of all n joints, the last one in the priority order.
///
/// Methods that are called in every cycle must not allocate.
pub trait JointTask: Any + Send {
    /// Name of the task, unique in the task set.
    fn name(&self) -> &str;

    /// Computes joint accelerations (n; rad/s² or m/s²) and the torques (n; Nm or N) that cause them, before
    /// projection.
    fn update(&mut self, input: &TaskInput<'_>, acceleration: &mut [f64], torque: &mut [f64]);

    /// Computes the joint velocities (n; rad/s or m/s) from `q` (n) to the target; returns `false` if the task has
    /// none. The gain is `gain_per_s` for a [reference](Self::reference) and `posture_gain_per_s` for a posture.
    fn kinematic_target(
        &self,
        q: &[f64],
        gain_per_s: f64,
        posture_gain_per_s: f64,
        velocity: &mut [f64],
    ) -> bool;

    /// Weights of the joints' deviations when limits are in force (n), each above zero; `None` if they are equal. They
    /// are constant.
    fn weights(&self) -> Option<&[f64]> {
        None
    }

    /// Change of the desired acceleration that limits do not allow. It is constant.
    fn when_limited(&self) -> WhenLimited {
        WhenLimited::LeastSquares
    }

    /// Starts at the robot's present state. May allocate.
    fn start(&mut self, _input: &ControlInput<'_>) {}

    /// Updates state and reference in a cycle without torque command.
    fn observe(&mut self, _input: &TaskInput<'_>) {}

    /// Inputs that can be streamed to the task; their names do not contain the task's name. They are constant, and
    /// equal in all task sets in which a task of this name has inputs.
    fn inputs(&self) -> Vec<Signal> {
        Vec::new()
    }

    /// Age of a stale target, s, if the target requires the robot to stop.
    fn stop_for_age_s(&self) -> Option<f64> {
        None
    }

    /// Blends from the state of `input.data`, at rest, into the reference after a hold. Allocates nothing.
    fn resume(&mut self, _input: &ControlInput<'_>) {}

    /// Continues from the task of the same name in the previous task set; `(before as &mut dyn Any).downcast_mut()`
    /// gives it if it has the same type. Allocates nothing.
    fn inherit(&mut self, _before: &mut dyn JointTask, input: &ControlInput<'_>) {
        self.start(input);
    }

    /// Reference position (rad or m) and velocity of the joints (n each), if the task follows a motion.
    fn reference(&self) -> Option<(&[f64], &[f64])> {
        None
    }

    /// Linearised gains of a joint with the inertia `inertia`, including its drive (kg m² or kg); `None` if they are
    /// unknown.
    fn gains(&self, _joint: usize, _inertia: f64) -> Option<RowGains> {
        None
    }

    /// Kind of the task, for error messages. It must be the same in all task sets.
    fn kind(&self) -> &'static str {
        "task of all joints"
    }

    /// Records a group of signals: [`TaskSignals::Motion`] or [`TaskSignals::Target`]. The signals of a group must be the same in
    /// every cycle.
    fn record(&self, _signals: TaskSignals<'_>, _out: &mut SignalRecorder<'_>) {}
}

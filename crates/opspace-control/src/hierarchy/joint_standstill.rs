//! Standstill of the task of all joints, below a task that is at a [standstill](crate::hierarchy::standstill).
//!
//! A task that cannot reach its goal is often at a singular pose, where its rows constrain the joints only to second
//! order. Without the pull to the goal, a posture then draws the arm away from there. Its demand is therefore taken off in
//! the same way, so that it holds the joints where they are: s a_lost, with the share s of the task above, where a_lost
//! follows the demand while the arm is braked, and is constant afterwards. A reference that moves still moves the joints.

use crate::hierarchy::standstill::Standstill;
use nalgebra::DVector;

/// Lag with which a_lost follows the demand, s.
const SMOOTHING_S: f64 = 0.1;

/// Standstill of a task of n joints.
#[derive(Clone, Debug)]
pub(crate) struct JointStandstill {
    /// True if the last cycle was part of a standstill.
    acts: bool,
    /// a_lost, rad/s² or m/s² (n).
    lost: DVector<f64>,
}

impl JointStandstill {
    pub(crate) fn new(n: usize) -> Self {
        Self { acts: false, lost: DVector::zeros(n) }
    }

    /// Takes s a_lost off the joint accelerations `demand` (n) of the task, below levels with these standstills. Returns
    /// false if nothing is taken.
    pub(crate) fn take<'a>(
        &mut self,
        above: impl Iterator<Item = &'a Standstill>,
        demand: &mut [f64],
        period_s: f64,
    ) -> bool {
        let largest = above.filter(|standstill| standstill.acts());
        let Some(standstill) = largest.max_by(|a, b| a.share().total_cmp(&b.share())) else {
            self.acts = false;
            return false;
        };
        let begins = !std::mem::replace(&mut self.acts, true);
        let follows = match (begins, standstill.is_braking()) {
            (true, _) => 1.0,
            (false, true) => (period_s / SMOOTHING_S).min(1.0),
            (false, false) => 0.0,
        };
        for (demand, lost) in demand.iter_mut().zip(self.lost.iter_mut()) {
            *lost += follows * (*demand - *lost);
            *demand -= standstill.share() * *lost;
        }
        true
    }
}

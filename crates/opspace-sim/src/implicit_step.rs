//! Implicit steps of an arm: integration of brakes, end stops, friction and gears that are too stiff for the step of the plant.
//!
//! The elements of a joint give a torque F(v) on its link, which depends on the velocity v of the link at the end of the step
//! of h: backward Euler, with the positions that follow from v. With the mass matrix M in the middle of the step, and the velocities
//! v₀ without these elements, the end of the step is the root of
//!
//! ```text
//! M (v − v₀) / h = F(v)        F(v) ≈ F(v*) − (G/h) (v − v*)        G = −h F'(v*) ≥ 0
//! ```
//!
//! The plant solves it with F linearised about some v* for all joints at once, as if G were the inertia of a rotor. F is linearised again
//! at the end to which that leads, until it is exact there.
//!
//! F_i depends on v_i alone and does not increase (but for friction's negative slope): the root is the minimum of a convex potential, and a
//! linearisation leads downhill from v*. Where F bends or jumps, as teeth meet or a stop is reached, its end lies beyond the lowest point
//! of the way. The way is then followed to that point only, which takes no more of the plant: the torques under which the joints have
//! a velocity on the way are those between the torques of its ends. The search ends with the lowest point that it has found;
//! tests/all/stability.rs has ten thousand arms with stiffness, damping and inertia over many orders of magnitude.
//!
//! The elements of an elastic gear with the inertia B of its rotor add at most B: as the gear gets stiffer, the joint becomes one with a
//! rigid gear. The error of such a step is of first order, as that of an explicit step, but it dissipates energy: it damps a
//! vibration that is too fast for the step.

use crate::drivetrain::Drivetrain;
use crate::plant::JointTorque;
use crate::stiff_joint::root_between;

/// Largest number of linearisations in a step. More are needed only where rounding is larger than the tolerance.
const MOST_COUNT: u32 = 30;

/// Search for the end of a step of one arm.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ImplicitStep {
    /// Number of ends that linearisations have led to in the present step.
    count: u32,
}

impl ImplicitStep {
    /// Revises what acts on the links (n) in a step of `h` (s), which leads to the velocities `dq` (n; rad/s, m/s) at its end. Returns true
    /// if something changes.
    pub fn revise(
        &mut self,
        joints: &mut [Drivetrain],
        dq: &[f64],
        h: f64,
        torques: &mut [JointTorque],
    ) -> bool {
        if self.count > MOST_COUNT {
            return false;
        }
        let mut is_exact = true;
        for (joint, &dq) in joints.iter_mut().zip(dq).filter(|(joint, _)| joint.is_implicit()) {
            is_exact &= joint.lead_to(dq, h);
        }
        if is_exact {
            return false;
        }
        self.count += 1;
        let share = if self.count == 1 { 1.0 } else { lowest_share(joints, h) };
        for (joint, torque) in joints.iter_mut().zip(torques).filter(|(joint, _)| joint.is_implicit()) {
            *torque = if self.count > MOST_COUNT { joint.settle(h) } else { joint.advance(share, h) };
        }
        true
    }
}

/// Share of the way to the new end at which the potential is lowest.
fn lowest_share(joints: &[Drivetrain], h: f64) -> f64 {
    let slope = |share: f64| -> f64 {
        joints.iter().filter(|joint| joint.is_implicit()).map(|joint| joint.gap(share, h)).sum()
    };
    let (first, last) = (slope(0.0), slope(1.0));
    if first >= 0.0 || last <= 0.0 || !last.is_finite() {
        return 1.0;
    }
    root_between((0.0, first), (1.0, last), slope)
}

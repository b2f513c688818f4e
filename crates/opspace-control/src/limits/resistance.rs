//! Resistance of an arm whose task is held back by limits: it comes to rest at a goal beyond them.
//!
//! With joints at their limits, the least-squares solution of a level is a Gauss-Newton step of the free joints. If F is
//! the force that remains of the task, a small motion of the free joints changes their torques by F ∂J/∂q, which the step
//! divides by what lever they have left: the closer they are to a singularity of their own, the higher the frequency at
//! which they are driven, with unchanged damping. Between limits this is a limit cycle.
//!
//! Therefore the joints of such a level are drawn towards the accelerations of a passive arm, which a bounded force pulls
//! to the goal and a viscous torque brakes:
//!
//! ```text
//! min |W J_p δ|²_Λ + ρ |α − α_passive|²_M        α_passive = M⁻¹ J_pᵀ m a* − k q̇
//! ```
//!
//! Within bounds on α, this last term alone is a viscously braked arm against inelastic stops, which loses energy until it
//! rests if m is constant and Coriolis forces are small (Moreau, *Unilateral contact and dry friction in finite freedom
//! dynamics*, Nonsmooth Mechanics and Applications, 1988). The inertia is m = ((h Λ)⁻¹ + λ_typical/0.1)⁻¹ with h = 20 ms
//! over the control period: at most a tenth of the typical inertia, so that a heavy direction close to a singularity does
//! not hide the others, and less in directions so light that they would not be stable at this period. ρ grows with the
//! torques f of the bounds, which balance the gradient of the cost:
//!
//! ```text
//! ρ = |f| / a₀ (1 + ρ)        |f|² = fᵀ M⁻¹ f λ_typical
//! ```
//!
//! Without active bounds it falls to zero within 0.2 s, and the level is exact. At a
//! [standstill](crate::hierarchy::standstill) it stays at 1 at least and the arm is only braked (m = 0): joints that rest at
//! their bounds, and unused degrees of freedom, would otherwise oscillate.

use crate::algebra::add_transposed;
use crate::nullspace::ProjectedTask;
use nalgebra::{DVector, Matrix6, Vector6};
use opspace_model::Data;

/// Force of the bounds per typical task inertia at which the passive arm has as much weight as the task, m/s².
const FULL_M_PER_S2: f64 = 10.0;

/// Largest inertia m with which the goal pulls the passive arm, relative to the typical inertia of the task.
const PULL: f64 = 0.1;

/// Bound on m in light directions: m is at most Λ times this time over the control period, s. With task damping of 40/s, a
/// velocity then changes by less than itself in a period.
const STEP_S: f64 = 0.02;

/// Largest acceleration that the passive arm follows, m/s².
const MAX_PULL_M_PER_S2: f64 = 200.0;

/// Damping k of the passive arm, 1/s.
const DAMPING_PER_S: f64 = 10.0;

/// Time constant with which ρ follows the bounds, s.
const RISE_S: f64 = 0.02;

/// Weight ρ below which it has no effect on the command.
const NEGLIGIBLE: f64 = 1e-4;

/// Resistance of one priority level.
#[derive(Clone, Debug)]
pub(crate) struct Resistance {
    /// ρ.
    weight: f64,
    /// α_passive, rad/s² or m/s² (n).
    passive: DVector<f64>,
}

impl Resistance {
    /// Creates the resistance of a level of `n` joints, without effect until bounds hold it back.
    pub(crate) fn new(n: usize) -> Self {
        Self { weight: 0.0, passive: DVector::zeros(n) }
    }

    /// Returns true if the level can be solved without it.
    pub(crate) fn is_negligible(&self) -> bool {
        self.weight < NEGLIGIBLE
    }

    /// Removes the resistance.
    pub(crate) fn release(&mut self) {
        self.weight = 0.0;
    }

    /// Weight ρ, and α_passive (n).
    pub(crate) fn of_joints(&self) -> (f64, &[f64]) {
        (self.weight, self.passive.as_slice())
    }

    /// Computes α_passive in the state of `data`, for the acceleration `demand` of the task's rows, whose typical mobility
    /// is `typical` (1/kg). `period_s` is the control period.
    pub(crate) fn update(
        &mut self,
        data: &Data,
        task: &ProjectedTask,
        demand: &Vector6<f64>,
        typical: f64,
        period_s: f64,
    ) {
        let size = demand.norm();
        let bounded = if size > MAX_PULL_M_PER_S2 { MAX_PULL_M_PER_S2 / size } else { 1.0 };
        // ((Λ h)⁻¹ + λ_typical/PULL)⁻¹, also for a singular Λ.
        let steady = task.space.task_inertia * (STEP_S / period_s);
        let parallel = Matrix6::identity() + steady * (typical / PULL);
        let force =
            parallel.cholesky().map_or(Vector6::zeros(), |factor| factor.solve(&(steady * demand * bounded)));
        self.passive.fill(0.0);
        add_transposed(&task.jacobian, &force, self.passive.as_mut_slice());
        data.mass_matrix_factor.solve(self.passive.as_mut_slice());
        self.passive.iter_mut().zip(&data.dq).for_each(|(a, v)| *a -= DAMPING_PER_S * v);
    }

    /// Lets ρ follow the size of the bounds' torques, `held` (square root of fᵀ M⁻¹ f), over a control period (s). It is at
    /// least `standstill`, the share of the task's demand that its standstill takes off.
    pub(crate) fn follow(&mut self, held: f64, typical: f64, standstill: f64, period_s: f64) {
        let force = held * typical.max(0.0).sqrt() / (1.0 + self.weight);
        let force = if force.is_finite() { force } else { 0.0 };
        let target = (force / FULL_M_PER_S2).max(standstill);
        self.weight += (period_s / RISE_S).min(1.0) * (target - self.weight);
    }
}

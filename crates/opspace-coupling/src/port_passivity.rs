//! Time-domain passivity control of one port of a delayed network (Ryu, Kwon and Hannaford, *Stable teleoperation with
//! time-domain passivity control*, IEEE Transactions on Robotics and Automation 20(2), 2004; Ryu, Artigas and Preusche, *A
//! passive bilateral control scheme for a teleoperator with time-varying communication delay*, Mechatronics 20(7), 2010).
//!
//! # Bound
//!
//! W is the net energy that has flowed into the network at a port. Each side sends the energy E_in that its partner may spend,
//! which never falls, and keeps
//!
//! ```text
//! budget = E_in(received from the partner) + store/2 + W − E_in ≥ 0      i.e.   W ≥ E_in − E_in(received) − store/2
//! ```
//!
//! The sum for both sides is W₁ + W₂ ≥ (E_in,1 − E_in,1(received by 2)) + (E_in,2 − E_in,2(received by 1)) − store. Whatever
//! was received, at any time and in any order, is at most E_in now, so that both brackets are not negative: **the energy out
//! is at most the energy in plus the store**.
//!
//! E_in grows with the energy that flows in, as counted by the play ([`EnergyPlay`]), so that noise does not move the budget of one
//! side to the other. The budget falls only by the energy that flows out and by what is sent.
//!
//! A spring between the positions of the two sides stores energy in the network. If all that flows in were sent, a side that
//! compresses the spring could not get its energy back: the partner has it and can't know that it is not needed.
//! Therefore each side of such a spring keeps what has flowed in, up to the energy of the spring and until its half of the
//! store is whole again, as a *reserve* ([`PortPassivity::set_reserve`]), and sends it when the spring relaxes and it was
//! not spent. The bound does not depend on the reserve.
//!
//! A side that turns back gives out energy before that of its partner arrives, one round trip later. It can therefore
//! [keep](PortPassivity::keep) a share of what flows in, beyond its half of the store.
//!
//! # Force into the handle (impedance)
//!
//! The force F of a cycle acts until the next one, in a displacement Δx that is not known yet. It is bounded by
//! |Δx − v T| ≤ r, r = a T², with the velocity v and the stated largest acceleration a. (A velocity that is the difference of
//! the last two positions over T is covered.) The energy out is at most F·v T + r |F|. The force that is returned is the
//! nearest one, to that which is wanted, for which this does not exceed the budget:
//!
//! ```text
//! F′ = (1 − μ / |G|) G     G = F − (μ / r²) v T     |·| in units of r F     with the least μ ≥ 0 that is enough
//! ```
//!
//! In motion with |v| T ≫ r this takes off the component along v that gives energy out; at rest it scales the force. A force
//! that is certain to take energy from the robot is not changed. No damping is injected: the least change of the force
//! is also that which the operator feels least, and dissipation beyond the budget would be energy that is missing at the
//! other port. Each axis has its own r, so that metres and radians can be in one port.
//!
//! If the motion breaks the bound (an impact, a missed cycle), the budget can become negative by |F| times the
//! displacement beyond the bound: a *debt*. While there is a debt, only force is allowed that takes energy in every
//! displacement within the bound; this energy, and that which the partner sends, pays it. The energy out is then at most the energy in plus the store plus the largest debt
//! ([`PortPassivity::largest_debt_j`]) of each side.
//!
//! # Displacement of a reference (admittance)
//!
//! The force is known when the displacement is chosen. If F·Δx exceeds the budget, the component along F that is too much is
//! removed. What was removed is the *gap*; it is added again with a time constant and at a limited speed, through the same
//! valve. The bound then holds without any condition on the motion.
//!
//! The robot may be elsewhere than its reference: at an impact it gives out the energy of its motion, and friction takes energy
//! that the reference gets back. Therefore the energy that flows in where the robot *is* can be
//! [observed](PortPassivity::observe_physical) too. Then the partner is sent only what has flowed in there, beyond what was
//! received, and the reference gives out nothing while that sum and the store are spent.
//!
//! # Holds
//!
//! The sums outlive a hold of the robot: [`PortPassivity::restart`] forgets only the gap. Motion during a hold is not counted. The partner need not know of it, and the bound holds over any number of holds of either side.
//!
//! # Restarts
//!
//! A side whose program was restarted has lost its sums. It begins a new session, and its partner [begins](PortPassivity::rebase)
//! one with it. Only energies that were sent in the present sessions of both sides are received. A side that went on running keeps its
//! budget. Each start of a program grants half of the store: the energy out is at most the energy in plus half of the
//! store times the number of starts of both programs.

use crate::energy_play::EnergyPlay;
use nalgebra::Vector6;
use opspace_backend::quantity::{NonNegative, Positive};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Passivity control of the ports of a coupling.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct PortPassivityParameters {
    /// Energy that both ports together may deliver beyond what has flowed in, J. Each port may spend half.
    pub store_j: NonNegative,
    /// Change of the energy of a port that is not counted as flow, J.
    pub hysteresis_j: NonNegative,
    /// Largest acceleration of a port along linear axes, m/s².
    pub acceleration_at_most_m_per_s2: Positive,
    /// Largest acceleration of a port about angular axes, rad/s².
    pub acceleration_at_most_rad_per_s2: Positive,
    /// Time constant with which a gap of the reference is closed, s.
    pub repair_s: Positive,
    /// Largest speed with which a gap is closed along linear axes, m/s.
    pub repair_at_most_m_per_s: Positive,
    /// Largest speed with which a gap is closed about angular axes, rad/s.
    pub repair_at_most_rad_per_s: Positive,
}

impl Default for PortPassivityParameters {
    fn default() -> Self {
        Self {
            store_j: NonNegative::literal(0.05),
            hysteresis_j: NonNegative::literal(0.002),
            acceleration_at_most_m_per_s2: Positive::literal(25.0),
            acceleration_at_most_rad_per_s2: Positive::literal(125.0),
            repair_s: Positive::literal(0.2),
            repair_at_most_m_per_s: Positive::literal(0.1),
            repair_at_most_rad_per_s: Positive::literal(0.5),
        }
    }
}

/// Passivity observer and controller of one port, with their state. Units: J; N or Nm and m or rad per axis.
///
/// A port with a force as its output (impedance) calls in each cycle [`receive`](Self::receive) for each packet,
/// [`observe`](Self::observe), then [`limit_force`](Self::limit_force); a port with a reference as its output (admittance)
/// calls [`receive`](Self::receive) and [`limit_displacement`](Self::limit_displacement). It sends
/// [`energy_in_j`](Self::energy_in_j) with each packet.
#[derive(Clone, Debug)]
pub struct PortPassivity {
    period_s: f64,
    half_store_j: f64,
    /// Largest deviation of the displacement in a cycle from velocity times period, per axis.
    uncertainty: Vector6<f64>,
    /// Fraction of the gap that is repaired in a cycle, and the largest repair in a cycle.
    repair_share: f64,
    repair_at_most: Vector6<f64>,
    flow: EnergyPlay,
    received_j: f64,
    /// Energy that was received in earlier sessions, minus that which was sent in them.
    base_j: f64,
    /// Energy that the partner may spend.
    sent_j: f64,
    /// Energy that has flowed in, and is neither spent nor sent.
    unsent_j: f64,
    reserve_j: f64,
    /// Energy beyond the own half of the store that is not sent.
    kept_j: f64,
    gap: Vector6<f64>,
    is_repair_paused: bool,
    largest_debt_j: f64,
    active_s: f64,
    /// Net energy that has flowed in where the robot is, J; `None` if it is not observed.
    physical_j: Option<f64>,
}

impl PortPassivity {
    /// Returns the passivity control of a port whose cycles last `period_s` (s, above zero). `angular` marks the rows that
    /// are in rad and Nm instead of m and N.
    #[must_use]
    pub fn new(parameters: &PortPassivityParameters, angular: &[bool; 6], period_s: f64) -> Self {
        let per_axis = |linear: Positive, other: Positive| {
            Vector6::from_fn(|i, _| if angular[i] { other.get() } else { linear.get() })
        };
        let p = parameters;
        let acceleration = per_axis(p.acceleration_at_most_m_per_s2, p.acceleration_at_most_rad_per_s2);
        Self {
            period_s,
            half_store_j: 0.5 * p.store_j.get(),
            uncertainty: acceleration * (period_s * period_s),
            repair_share: (period_s / p.repair_s.get()).min(1.0),
            repair_at_most: per_axis(p.repair_at_most_m_per_s, p.repair_at_most_rad_per_s) * period_s,
            flow: EnergyPlay::new(p.hysteresis_j.get()),
            received_j: 0.0,
            base_j: 0.0,
            sent_j: 0.0,
            unsent_j: 0.0,
            reserve_j: 0.0,
            kept_j: 0.0,
            gap: Vector6::zeros(),
            is_repair_paused: false,
            largest_debt_j: 0.0,
            active_s: 0.0,
            physical_j: None,
        }
    }

    /// Notes the energy (J) that the partner has sent as its [`energy_in_j`](Self::energy_in_j). The largest counts: older
    /// packets change nothing.
    pub fn receive(&mut self, energy_in_j: f64) {
        if energy_in_j.is_finite() {
            self.received_j = self.received_j.max(energy_in_j);
        }
    }

    /// Sets the energy (J, not negative) that has flowed in and is not sent to the partner, because this side may have to
    /// give it back: the energy that a spring between the two positions stores now. Zero at first.
    pub fn set_reserve(&mut self, energy_j: f64) {
        if energy_j.is_finite() {
            self.reserve_j = energy_j.max(0.0);
            self.send();
        }
    }

    /// Keeps a tenth of what flows in until the budget is `energy_j` (J, not negative) above the own half of the store; zero at
    /// first: then only the half is restored. For a side without a [reserve](Self::set_reserve).
    pub fn keep(&mut self, energy_j: f64) {
        if energy_j.is_finite() {
            self.kept_j = energy_j.max(0.0);
        }
    }

    /// Counts the work of the force (N, Nm) that was applied from the last cycle until this one, in the displacement (m, rad)
    /// since the last cycle. Not for ports that call [`limit_displacement`](Self::limit_displacement). Work that is not finite
    /// is not counted.
    pub fn observe(&mut self, force: &Vector6<f64>, displacement: &Vector6<f64>) {
        let out_j = force.dot(displacement);
        if out_j.is_finite() {
            self.count(out_j);
        }
    }

    /// Counts energy (J) that has flowed in where the robot is, beside that which [`limit_displacement`](Self::limit_displacement)
    /// counts at the reference. From the first call on, the budget is the smaller one of both. Energy that is not finite is not
    /// counted.
    pub fn observe_physical(&mut self, in_j: f64) {
        if in_j.is_finite() {
            self.physical_j = Some(self.physical_j.unwrap_or(self.flow.net_j()) + in_j);
        }
    }

    /// Returns the force (N, Nm) nearest to `force` that delivers at most the budget until the next cycle, in every
    /// displacement that differs from `velocity` (m/s, rad/s) times the period by at most the stated acceleration times the
    /// period squared. Zero if an input is not finite.
    #[must_use]
    pub fn limit_force(&mut self, velocity: &Vector6<f64>, force: &Vector6<f64>) -> Vector6<f64> {
        let budget_j = self.budget_j().max(0.0);
        // In these units the bound on the displacement is a ball of radius 1.
        let scaled_force = force.component_mul(&self.uncertainty);
        let scaled_displacement = velocity.component_div(&self.uncertainty) * self.period_s;
        let most_j = most_work(&scaled_force, &scaled_displacement);
        if most_j.is_finite() && most_j <= budget_j {
            return *force;
        }
        self.active_s += self.period_s;
        if !most_j.is_finite() {
            return Vector6::zeros();
        }
        nearest_force(&scaled_force, &scaled_displacement, budget_j).component_div(&self.uncertainty)
    }

    /// Returns the displacement (m, rad) of the reference in this cycle, and counts its work: `displacement` and a part of the
    /// gap, without the component along `force` (N, Nm) that would deliver more than the budget. Zero if an input is not
    /// finite.
    #[must_use]
    pub fn limit_displacement(&mut self, displacement: &Vector6<f64>, force: &Vector6<f64>) -> Vector6<f64> {
        let wanted = displacement + self.repair();
        let out_j = force.dot(&wanted);
        if !out_j.is_finite() || !wanted.iter().chain(force).all(|x| x.is_finite()) {
            self.active_s += self.period_s;
            return Vector6::zeros();
        }
        let budget_j = self.budget_j().max(0.0);
        let mut allowed = wanted;
        if out_j > budget_j {
            // Least change in units of the axes' uncertainty.
            let along = force.component_mul(&self.uncertainty).component_mul(&self.uncertainty);
            // A second time for the rounding of the first, which is relative to what is wanted and would be spent in each
            // cycle.
            for _ in 0..2 {
                let excess_j = force.dot(&allowed) - budget_j;
                allowed -= along * (excess_j.max(0.0) / along.dot(force));
            }
            self.active_s += self.period_s;
        }
        self.gap += displacement - allowed;
        self.count(force.dot(&allowed));
        allowed
    }

    /// Pauses the repair of the gap, or goes on with it.
    pub fn pause_repair(&mut self, paused: bool) {
        self.is_repair_paused = paused;
    }

    /// Adds to the gap (m, rad): a displacement that the caller has taken off the reference, to be repaired like one that was
    /// not allowed.
    pub fn add_gap(&mut self, displacement: &Vector6<f64>) {
        self.gap += displacement;
    }

    /// Forgets the gap, for references that begin anew after a hold. The energies stay: no agreement with the partner is
    /// needed.
    pub fn restart(&mut self) {
        self.gap = Vector6::zeros();
    }

    /// Begins a session, in which the energies that are sent and received begin at zero. The budget does not change. Both sides
    /// must begin the session: energies that the partner sent before must not be [received](Self::receive) after it.
    pub fn rebase(&mut self) {
        self.base_j += self.received_j - self.sent_j;
        (self.received_j, self.sent_j) = (0.0, 0.0);
    }

    /// Continues from the port of the previous task set.
    pub fn inherit_state(&mut self, before: &Self) {
        self.flow.inherit_state(&before.flow);
        (self.received_j, self.sent_j, self.gap) = (before.received_j, before.sent_j, before.gap);
        (self.unsent_j, self.reserve_j, self.base_j) = (before.unsent_j, before.reserve_j, before.base_j);
        (self.largest_debt_j, self.active_s) = (before.largest_debt_j, before.active_s);
        self.physical_j = before.physical_j;
    }

    /// Energy that has flowed in at this port and that the partner may spend, J, to be sent with each packet. Never falls within
    /// a [session](Self::rebase).
    #[must_use]
    pub fn energy_in_j(&self) -> f64 {
        self.sent_j
    }

    /// Energy that has flowed out at this port, J. Never falls.
    #[must_use]
    pub fn energy_out_j(&self) -> f64 {
        self.flow.out_j()
    }

    /// Largest energy that the partner has sent, J.
    #[must_use]
    pub fn energy_received_j(&self) -> f64 {
        self.received_j
    }

    /// Energy that has flowed in and out at this port.
    #[must_use]
    pub fn flow(&self) -> &EnergyPlay {
        &self.flow
    }

    /// Energy that may flow out now, J. Negative: a debt.
    #[must_use]
    pub fn budget_j(&self) -> f64 {
        self.half_store_j + self.beyond_store_j().min(self.physical_beyond_store_j())
    }

    /// Largest debt so far, J, not negative.
    #[must_use]
    pub fn largest_debt_j(&self) -> f64 {
        self.largest_debt_j
    }

    /// Displacement (m, rad) that was wanted and has not been allowed yet. Zero for ports with a force as their output.
    #[must_use]
    pub fn gap(&self) -> &Vector6<f64> {
        &self.gap
    }

    /// Time of the cycles in which a force or displacement was changed, s. A repair of the gap alone does not count.
    #[must_use]
    pub fn active_s(&self) -> f64 {
        self.active_s
    }

    /// Budget beyond this side's half of the store, J. Negative if the store was spent.
    fn beyond_store_j(&self) -> f64 {
        self.received_j + (self.base_j + self.flow.net_j() - self.sent_j)
    }

    /// Energy beyond the own half of the store where the robot is, J; infinite if that is not observed.
    fn physical_beyond_store_j(&self) -> f64 {
        self.physical_j
            .map_or(f64::INFINITY, |physical_j| self.received_j + (self.base_j + physical_j - self.sent_j))
    }

    /// Counts energy that has flowed out (J), or in.
    fn count(&mut self, out_j: f64) {
        let before = self.flow;
        self.flow.add(-out_j);
        let (gained_j, spent_j) = (self.flow.in_j() - before.in_j(), self.flow.out_j() - before.out_j());
        if self.reserve_j == 0.0 {
            // Without a spring, what flows in is the partner's, except what pays a debt and a share that restores the own half
            // of the store and what is kept: a side that keeps more starves the other one.
            let flowed_in_j = gained_j + std::mem::take(&mut self.unsent_j);
            let beyond_store_j = self.beyond_store_j();
            let after_debt_j = flowed_in_j.min((self.half_store_j + beyond_store_j).max(0.0));
            let lacking_j = (self.kept_j + after_debt_j - beyond_store_j).max(0.0);
            let due_j = after_debt_j - (KEPT_SHARE * after_debt_j).min(lacking_j);
            let sent_j = due_j.min(self.physical_beyond_store_j().max(0.0));
            self.sent_j += sent_j;
            self.unsent_j = (due_j - sent_j - spent_j).max(0.0);
        } else {
            self.unsent_j = (self.unsent_j + gained_j - spent_j).clamp(0.0, self.beyond_store_j().max(0.0));
            self.send();
        }
        self.largest_debt_j = self.largest_debt_j.max(-self.budget_j());
    }

    /// Credits the partner with energy that has flowed in, but not with the store and the reserve.
    fn send(&mut self) {
        let sent_j = self.unsent_j.min(self.beyond_store_j() - self.reserve_j).max(0.0);
        self.unsent_j -= sent_j;
        self.sent_j += sent_j;
    }

    /// Part of the gap to be closed in this cycle.
    fn repair(&self) -> Vector6<f64> {
        if self.is_repair_paused {
            return Vector6::zeros();
        }
        let step = self.gap * self.repair_share;
        let over = |(s, most): (&f64, &f64)| s.abs() / most;
        let over = step.iter().zip(&self.repair_at_most).map(over).fold(1.0, f64::max);
        step / over
    }
}

/// Most work (J) of a force (J) in the displacements that differ from `displacement` by at most 1.
fn most_work(force: &Vector6<f64>, displacement: &Vector6<f64>) -> f64 {
    force.dot(displacement) + force.norm()
}

/// Force nearest to `force` whose most work is `budget_j` (J, not negative). `force` must be able to do more.
fn nearest_force(force: &Vector6<f64>, displacement: &Vector6<f64>, budget_j: f64) -> Vector6<f64> {
    let length = displacement.norm();
    let direction = if length > 0.0 { displacement / length } else { Vector6::zeros() };
    let along = force.dot(&direction);
    let across = (force - direction * along).norm();
    // The conditions of the minimum give the force as a function of their multiplier μ, whose work falls with μ: the share
    // that is left of G = F − μ d.
    let share = |multiplier: f64| (1.0 - multiplier / (along - multiplier * length).hypot(across)).max(0.0);
    let is_enough = |multiplier: f64| {
        let along = along - multiplier * length;
        let share = share(multiplier);
        share == 0.0 || share * (along * length + along.hypot(across)) <= budget_j
    };
    let (mut low, mut high) = (0.0, force.norm());
    for _ in 0..DOUBLINGS {
        if is_enough(high) {
            break;
        }
        (low, high) = (high, 2.0 * high);
    }
    if !is_enough(high) {
        return Vector6::zeros();
    }
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (low + high);
        if is_enough(middle) { high = middle } else { low = middle }
    }
    (force - displacement * high) * share(high)
}

/// Share of the energy that flows in which restores the own half of the store, if some of it was spent, and what is kept.
const KEPT_SHARE: f64 = 0.1;

/// Doublings of the bracket: enough for all but motion at exactly the radius of the bound.
const DOUBLINGS: usize = 40;

/// Bisections of the bracket: the precision of an f64.
const BISECTIONS: usize = 54;

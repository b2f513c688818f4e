//! Joints whose brake, end stop, friction or gear is too stiff for the step of the plant: implicit integration of these
//! elements.
//!
//! The elements of a joint give a torque F(v) on its link, which depends on the velocity v of the link at the end of the step
//! of h: backward Euler, with the positions that follow from v. F is linearised about the velocity v* that the joint has
//! alone, with its inertia I and the other torques of the last step:
//!
//! ```text
//! I (v* − q̇) / h = F(v*) + others        torque on the link: τ − G q̈        G = −h F'(v*) ≥ 0        τ = F(v*) + (G/h) (v* − q̇)
//! ```
//!
//! That is exact where F is linear. Where it is not, and the joints together lead to another velocity, F is linearised there again.
//!
//! The plant solves `(M + G) q̈ = τ − C q̇ − g` for all joints at once, as if G were the inertia of a rotor. Where F is linear, G ≥ 0 makes a
//! step stable for any stiffness, damping and inertia; where it bends sharply for several joints at once, a few random arms in a thousand still
//! gain energy (tests/all/stability.rs). The elements of an elastic gear with
//! the inertia B of its rotor add at most B: as the gear gets stiffer, the joint becomes one with a rigid gear.
//!
//! The error of such a step is of first order, as that of an explicit step, but it dissipates energy: it damps a vibration that
//! is too fast for the step.

use crate::plant::JointTorque;

/// Largest number of evaluations that find an end of the search for a velocity, or the velocity.
const EVALUATIONS: usize = 100;

/// Joint that is integrated implicitly.
#[derive(Clone, Debug)]
pub(crate) struct StiffJoint {
    /// Inertia of the link that moves, with the other joints free, kg m² (kg).
    inertia: f64,
    /// Torque of all but the elements of the joint, in the last step, Nm (N).
    others: f64,
    /// Velocity before the present step, rad/s (m/s), and what acts in it.
    step: (f64, JointTorque),
    /// Velocity about which that is linearised, rad/s (m/s).
    end: f64,
    /// Number of linearisations in the present step.
    count: u32,
}

/// Number of linearisations in a step after which they approach each other: what meets or leaves a stop may go back and forth.
const FREE_COUNT: u32 = 4;

/// Largest number of linearisations in a step.
const MOST_COUNT: u32 = 30;

/// Difference between the linearised and the true torque that is enough, over their magnitudes.
const TOLERANCE: f64 = 1e-6;

impl StiffJoint {
    /// Returns a joint at rest whose link has this inertia (kg m², kg).
    pub fn new(inertia: f64) -> Self {
        Self { inertia, others: 0.0, step: (0.0, JointTorque::default()), end: 0.0, count: 0 }
    }

    /// Linearises the torque of the elements (Nm, N) in a step of `h` (s) from the velocity `dq` (rad/s, m/s). `torque` and
    /// `slope` get the velocity of the link at the end of the step.
    pub fn begin(
        &mut self,
        dq: f64,
        h: f64,
        torque: impl Fn(f64) -> f64,
        slope: impl Fn(f64) -> f64,
    ) -> JointTorque {
        let end = end_velocity(self.inertia / h, dq, |v| torque(v) + self.others);
        self.step.0 = dq;
        self.count = 0;
        self.linearise(end, h, torque, slope)
    }

    fn linearise(
        &mut self,
        end: f64,
        h: f64,
        torque: impl Fn(f64) -> f64,
        slope: impl Fn(f64) -> f64,
    ) -> JointTorque {
        let inertia = h * slope(end);
        let linearised = JointTorque { torque: torque(end) + inertia / h * (end - self.step.0), inertia };
        self.step.1 = linearised;
        self.end = end;
        self.count += 1;
        linearised
    }

    /// Linearises the torque about the velocity `dq` (rad/s, m/s) to which the present linearisation leads; `None` if that is the
    /// torque there.
    pub fn revise(
        &mut self,
        dq: f64,
        h: f64,
        torque: impl Fn(f64) -> f64,
        slope: impl Fn(f64) -> f64,
    ) -> Option<JointTorque> {
        let (before, JointTorque { torque: constant, inertia }) = self.step;
        let (applied, actual) = (constant - inertia * (dq - before) / h, torque(dq));
        let is_close = (applied - actual).abs() <= TOLERANCE * (applied.abs() + actual.abs());
        if is_close || !actual.is_finite() || self.count >= MOST_COUNT {
            return None;
        }
        let end = if self.count < FREE_COUNT { dq } else { 0.5 * (dq + self.end) };
        Some(self.linearise(end, h, torque, slope))
    }

    /// Ends a step of `h` (s) with the velocity `dq` (rad/s, m/s). Returns the torque of the elements in the step (Nm, N).
    pub fn end(&mut self, dq: f64, h: f64) -> f64 {
        let (before, JointTorque { torque, inertia }) = self.step;
        let acceleration = (dq - before) / h;
        let torque = torque - inertia * acceleration;
        self.others = self.inertia * acceleration - torque;
        torque
    }
}

/// Returns the velocity v with `rate (v − before) = torque(v)`: `rate` is an inertia over the step (Nms/rad, Ns/m), and
/// `torque` (Nm, N) does not increase with v, but for rounding and the negative slope of friction.
pub(crate) fn end_velocity(rate: f64, before: f64, torque: impl Fn(f64) -> f64) -> f64 {
    let gap = |v: f64| rate * (v - before) - torque(v);
    let first = gap(before);
    if first == 0.0 || !first.is_finite() {
        return before;
    }
    // A torque that does not increase has its root between the velocity before and that under the first torque.
    let (mut near, mut near_gap) = (before, first);
    let mut width = -first / rate;
    let (mut far, mut far_gap) = (before + width, gap(before + width));
    for _ in 0..EVALUATIONS {
        if far_gap == 0.0 || (far_gap > 0.0) != (first > 0.0) {
            break;
        }
        (near, near_gap) = (far, far_gap);
        width *= 2.0;
        far += width;
        far_gap = gap(far);
    }
    // Regula falsi with Illinois weights, and halving where that is slow.
    for count in 0..EVALUATIONS {
        if far_gap == 0.0 || !far_gap.is_finite() || (far - near).abs() <= 1e-13 * (near.abs() + far.abs()) {
            break;
        }
        let secant = far - far_gap * (far - near) / (far_gap - near_gap);
        let middle = 0.5 * (near + far);
        let is_between = (secant - near) * (secant - far) < 0.0;
        let next = if is_between && count % 3 != 2 { secant } else { middle };
        let next_gap = gap(next);
        if (next_gap > 0.0) == (far_gap > 0.0) {
            near_gap *= 0.5;
        } else {
            (near, near_gap) = (far, far_gap);
        }
        (far, far_gap) = (next, next_gap);
    }
    far
}

/// Largest of the slopes to both sides by which `torque` decreases at the velocity `v`, not below zero.
pub(crate) fn decrease(v: f64, torque: impl Fn(f64) -> f64) -> f64 {
    let step = 1e-6 * v.abs() + 1e-9;
    let at = torque(v);
    ((torque(v - step) - at) / step).max((at - torque(v + step)) / step).max(0.0)
}

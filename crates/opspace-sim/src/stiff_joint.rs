//! Joint whose brake, end stop, friction or gear is too stiff for the step of the plant: its part of an
//! [implicit step](crate::implicit_step).

use crate::plant::JointTorque;

/// Largest number of evaluations that find an end of the search for a root, or the root.
const EVALUATIONS: usize = 100;

/// Joint that is integrated implicitly.
#[derive(Clone, Debug)]
pub(crate) struct StiffJoint {
    /// Inertia of the link that moves, with the other joints free, kg m² (kg).
    inertia: f64,
    /// Torque of all but the elements of the joint, in the last step, Nm (N).
    others: f64,
    /// Velocity before the present step, rad/s (m/s).
    before: f64,
    /// Torque and inertia in the present step.
    linearised: JointTorque,
    /// Best end of the step that is known.
    best: End,
    /// End to which the present linearisation leads.
    led: End,
}

/// End of a step.
#[derive(Clone, Copy, Debug, Default)]
struct End {
    /// Velocity of the link, rad/s (m/s).
    velocity: f64,
    /// Torque of the elements under which the joints have it, Nm (N).
    torque: f64,
}

/// Difference between the linearised and the true torque that is enough, over their magnitudes.
const TOLERANCE: f64 = 1e-6;

impl StiffJoint {
    /// Returns a joint at rest whose link has this inertia (kg m², kg).
    pub fn new(inertia: f64) -> Self {
        let (linearised, best, led) = (JointTorque::default(), End::default(), End::default());
        Self { inertia, others: 0.0, before: 0.0, linearised, best, led }
    }

    /// Forgets the torque of all but the elements: the joint was not integrated implicitly.
    pub fn forget(&mut self) {
        self.others = 0.0;
    }

    /// Begins a step of `h` (s) from the velocity `dq` (rad/s, m/s), and linearises the torque of the elements. `torque` (Nm, N) and
    /// `slope` (Nms/rad, Ns/m) get the velocity of the link at the end of the step.
    pub fn begin(
        &mut self,
        dq: f64,
        h: f64,
        torque: impl Fn(f64) -> f64,
        slope: impl Fn(f64, Side) -> f64,
    ) -> JointTorque {
        let end = end_velocity(self.inertia / h, dq, |v| torque(v) + self.others);
        self.before = dq;
        self.linearise(End { velocity: end, torque: torque(end) }, h, slope(end, Side::Both))
    }

    /// Returns a torque that leads to `end` if the other joints do not change, and decreases by `slope` about it.
    fn linearise(&mut self, end: End, h: f64, slope: f64) -> JointTorque {
        let inertia = h * slope;
        let torque = end.torque + inertia / h * (end.velocity - self.before);
        self.linearised = JointTorque { torque, inertia };
        self.linearised
    }

    /// Notes that the present linearisation leads to the velocity `dq` (rad/s, m/s). True if the torque there is the linearised one.
    pub fn lead_to(&mut self, dq: f64, h: f64, torque: impl Fn(f64) -> f64) -> bool {
        let JointTorque { torque: constant, inertia } = self.linearised;
        self.led = End { velocity: dq, torque: constant - inertia * (dq - self.before) / h };
        let (applied, actual) = (self.led.torque, torque(dq));
        if !actual.is_finite() || (applied - actual).abs() <= TOLERANCE * (applied.abs() + actual.abs()) {
            return true;
        }
        // At a jump, each torque between those of the two sides is exact.
        let (below, above) = (torque(dq - width(dq)), torque(dq + width(dq)));
        (below.min(above)..=below.max(above)).contains(&applied)
    }

    /// End of the step at a share of the way from the best one to that of the linearisation.
    fn between(&self, share: f64) -> End {
        let part = |from: f64, to: f64| if share == 1.0 { to } else { from + share * (to - from) };
        End {
            velocity: part(self.best.velocity, self.led.velocity),
            torque: part(self.best.torque, self.led.torque),
        }
    }

    /// Power (W) that the torque lacks at a share of the way, for the way that is left.
    pub fn gap(&self, share: f64, torque: impl Fn(f64) -> f64) -> f64 {
        let end = self.between(share);
        (self.led.velocity - self.best.velocity) * (end.torque - torque(end.velocity))
    }

    /// Moves the best end by a share of the way, and linearises the torque there.
    pub fn advance(
        &mut self,
        share: f64,
        h: f64,
        torque: impl Fn(f64) -> f64,
        slope: impl Fn(f64, Side) -> f64,
    ) -> JointTorque {
        self.best = self.between(share);
        let velocity = self.best.velocity;
        let actual = torque(velocity);
        // At a jump of the torque, the side to which the joint goes decides.
        let side = if actual > self.best.torque { Side::Above } else { Side::Below };
        self.linearise(End { velocity, torque: actual }, h, slope(velocity, side))
    }

    /// Returns a torque that leads to the best end that is known.
    pub fn settle(&mut self, h: f64, slope: impl Fn(f64, Side) -> f64) -> JointTorque {
        self.linearise(self.best, h, slope(self.best.velocity, Side::Both))
    }

    /// Ends a step of `h` (s) with the velocity `dq` (rad/s, m/s). Returns the torque of the elements in the step (Nm, N).
    pub fn end(&mut self, dq: f64, h: f64) -> f64 {
        let JointTorque { torque, inertia } = self.linearised;
        let acceleration = (dq - self.before) / h;
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
    root_between((near, near_gap), (far, far_gap), gap)
}

/// Returns a root of `gap` between two arguments with their values, which have different signs.
pub(crate) fn root_between(
    (mut near, mut near_gap): (f64, f64),
    (mut far, mut far_gap): (f64, f64),
    gap: impl Fn(f64) -> f64,
) -> f64 {
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

/// Sides of a velocity on which the slope of a torque is computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Side {
    Below,
    Above,
    /// The side with the larger slope.
    Both,
}

/// Width (rad/s, m/s) of a jump of the torque at the velocity `v`.
fn width(v: f64) -> f64 {
    1e-6 * v.abs() + 1e-9
}

/// Slope by which `torque` decreases at the velocity `v`, not below zero.
pub(crate) fn decrease(v: f64, side: Side, torque: impl Fn(f64) -> f64) -> f64 {
    let (step, at) = (width(v), torque(v));
    let below = if side == Side::Above { 0.0 } else { (torque(v - step) - at) / step };
    let above = if side == Side::Below { 0.0 } else { (at - torque(v + step)) / step };
    below.max(above).max(0.0)
}

//! Search for the boundary of stability along a variation of an arm.

use super::nudge::{Nudge, NudgedArm};
use opspace_sim::ArmConfig;

/// Width below which the intervals of the search are divided in the middle. Most boundaries are near zero, so that wider
/// intervals are divided near their lower end.
const NARROW: f64 = 0.2;

/// Boundary of stability along a variation.
pub(super) struct Boundary {
    /// Largest variation at which the arm is stable; 0 if it is not stable with the nominal values.
    pub(super) last_stable: f64,
    /// Joint that becomes unstable first.
    pub(super) joint: usize,
}

/// Searches from 0 to `most` for the boundary of stability of the arms `varied`: `Some(None)` if the arm is stable at
/// `most`, and `None` if it cannot be simulated. The resolution is absolute, or `relative` to the boundary if that is
/// more.
pub(super) fn boundary(
    nudged: &NudgedArm,
    most: f64,
    resolution: f64,
    relative: f64,
    varied: impl Fn(f64) -> Option<ArmConfig>,
) -> Option<Option<Boundary>> {
    let nudge = |variation: f64| nudged.nudge(&varied(variation)?);
    let (mut low, mut high) = (0.0, most);
    let Nudge::Grows(mut first) = nudge(high)? else { return Some(None) };
    while high - low > resolution.max(relative * low) {
        let share = if high > NARROW { 0.25 } else { 0.5 };
        let middle = low + share * (high - low);
        match nudge(middle)? {
            Nudge::DiesOut => low = middle,
            Nudge::Grows(joint) => (high, first) = (middle, joint),
        }
    }
    Some(Some(Boundary { last_stable: low, joint: first }))
}

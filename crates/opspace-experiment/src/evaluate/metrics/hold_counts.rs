//! Causes that hold a task, counted over cycles.

use super::holds::Hold;
use std::collections::BTreeMap;

/// Smallest fraction of the cycles in which a cause that is reported acts.
const MIN_SHARE: f64 = 0.2;

/// Number of cycles in which each cause acts.
#[derive(Default)]
pub(super) struct HoldCounts {
    /// Number of all cycles.
    pub(super) cycles: usize,
    position: BTreeMap<usize, usize>,
    speed: BTreeMap<usize, usize>,
    torque: BTreeMap<usize, usize>,
    distances: BTreeMap<usize, usize>,
    singular: usize,
    singular_along: String,
}

impl HoldCounts {
    /// Adds a cycle; `grows` is true if its error is the largest so far, whose direction is kept.
    pub(super) fn add(&mut self, hold: &Hold, grows: bool) {
        self.cycles += 1;
        let counts = [
            (&mut self.position, &hold.position),
            (&mut self.speed, &hold.speed),
            (&mut self.torque, &hold.torque),
            (&mut self.distances, &hold.distances),
        ];
        for (counts, joints) in counts {
            joints.iter().for_each(|joint| *counts.entry(*joint).or_default() += 1);
        }
        if let Some(along) = &hold.singular_along {
            self.singular += 1;
            if grows || self.singular == 1 {
                self.singular_along.clone_from(along);
            }
        }
    }

    /// True if a cause that acts in `count` cycles is reported.
    pub(super) fn is_often(&self, count: usize) -> bool {
        count as f64 >= MIN_SHARE * self.cycles as f64
    }

    /// Names of the joints whose limits of position, of speed or acceleration, and of torque act.
    pub(super) fn limits(&self, joints: &[&str]) -> [Vec<String>; 3] {
        [&self.position, &self.speed, &self.torque].map(|counts| {
            let often = counts.iter().filter(|(_, count)| self.is_often(**count));
            often.map(|(joint, _)| joints[*joint].to_owned()).collect()
        })
    }

    /// Pairs whose kept distances act.
    pub(super) fn pairs(&self) -> Vec<usize> {
        let often = self.distances.iter().filter(|(_, count)| self.is_often(**count));
        often.map(|(pair, _)| *pair).collect()
    }

    /// Direction of the error, if the arm is nearly singular along it.
    pub(super) fn singular_along(&self) -> Option<String> {
        (self.singular > 0 && self.is_often(self.singular)).then(|| self.singular_along.clone())
    }
}

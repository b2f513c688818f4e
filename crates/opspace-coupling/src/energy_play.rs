//! Energy that flows into a port and out of it, each as a sum that never falls.
//!
//! Splitting by the sign of the instantaneous power rectifies noise: a flow of ±e in alternate cycles adds e to both sums per
//! pair of cycles, without end. Here the net energy W passes through a play (backlash) of width h first:
//!
//! ```text
//! E_in − E_out = W − s        −h/2 ≤ s ≤ h/2
//! ```
//!
//! The slack s follows W until it reaches an end of the play; only what goes on beyond that end is added to a sum. Motion of
//! the energy to and fro by less than h is not counted as flow.

/// Energies that have flowed into and out of a port, J, for a net energy that passes through a play.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnergyPlay {
    /// Half of the width of the play.
    half_width_j: f64,
    in_j: f64,
    out_j: f64,
    slack_j: f64,
}

impl EnergyPlay {
    /// Returns a play of the width `hysteresis_j` (J, not negative), without any flow yet, in the middle of its slack.
    #[must_use]
    pub fn new(hysteresis_j: f64) -> Self {
        Self { half_width_j: 0.5 * hysteresis_j, in_j: 0.0, out_j: 0.0, slack_j: 0.0 }
    }

    /// Adds energy that has flowed in (J); negative if it has flowed out.
    pub fn add(&mut self, energy_j: f64) {
        let slack_j = self.slack_j + energy_j;
        self.in_j += (slack_j - self.half_width_j).max(0.0);
        self.out_j += (-self.half_width_j - slack_j).max(0.0);
        self.slack_j = slack_j.clamp(-self.half_width_j, self.half_width_j);
    }

    /// Energy that has flowed in, J. Never falls.
    #[must_use]
    pub fn in_j(&self) -> f64 {
        self.in_j
    }

    /// Energy that has flowed out, J. Never falls.
    #[must_use]
    pub fn out_j(&self) -> f64 {
        self.out_j
    }

    /// Part of the net energy that is not counted as flow, J, at most half of the width in magnitude.
    #[must_use]
    pub fn slack_j(&self) -> f64 {
        self.slack_j
    }

    /// Net energy that has flowed in, J: the sum of all that was added.
    #[must_use]
    pub fn net_j(&self) -> f64 {
        self.in_j - self.out_j + self.slack_j
    }

    /// Continues with the flows of another play. A slack beyond the width of this play is counted as flow.
    pub fn inherit_state(&mut self, before: &Self) {
        (self.in_j, self.out_j, self.slack_j) = (before.in_j, before.out_j, before.slack_j);
        self.add(0.0);
    }
}

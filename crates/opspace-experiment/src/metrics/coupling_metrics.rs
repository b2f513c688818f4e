//! Metrics of a coupling between two robots.

use serde::{Deserialize, Serialize};

/// Metrics of a coupling. Positions and forces are those of the leader.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct CouplingMetrics {
    /// Rms distance of the two robots after `settle_s`, while the coupling is closed and the follower touches nothing, m (rad
    /// for joints).
    pub tracking_rms_m: Option<f64>,
    /// Largest such distance, m.
    pub tracking_max_m: Option<f64>,
    /// Mean distance in the last half second, m.
    pub drift_m: Option<f64>,
    /// Largest energy that the pair has given to operator and environment beyond what it had received, J.
    pub energy_extracted_j: Option<f64>,
    /// Rms force of the operator after `settle_s`, N.
    pub hand_force_rms_n: Option<f64>,
    /// Largest rms over 0.25 s of the velocity of one of the frames above 20 Hz, m/s: while the operator probes, or after
    /// `settle_s` without a probe.
    pub fast_velocity_m_per_s: Option<f64>,
    /// Time in which the follower did not touch anything while the operator probed, s.
    pub contact_lost_s: Option<f64>,
    /// Least stiffness that the operator felt at the lines of the probe between 0.5 and 2 Hz, N/m.
    pub felt_least_n_per_m: Option<f64>,
    /// Largest stiffness that the operator felt at these lines, N/m.
    pub felt_largest_n_per_m: Option<f64>,
    /// Least felt stiffness over that of the coupling's spring and the wall in series.
    pub felt_over_series_least: Option<f64>,
    /// Largest felt stiffness over that of the coupling's spring and the wall in series.
    pub felt_over_series_largest: Option<f64>,
    /// Felt stiffness at each line of the probe.
    pub felt: Vec<FeltLine>,
    /// Rms distance of a carried object from its path after `settle_s`, m.
    pub path_rms_m: Option<f64>,
    /// Largest such distance, m.
    pub path_max_m: Option<f64>,
    /// Rms error of the internal force on a carried object after `settle_s`, N: of the vector, across the line between the hands
    /// too.
    pub internal_force_rms_n: Option<f64>,
    /// Largest such error, N.
    pub internal_force_max_n: Option<f64>,
    /// Time for which the passivity control of either side changed something, s.
    pub passivity_time_s: Option<f64>,
    /// Packets that were lost or overtaken, of both directions.
    pub packets_lost: Option<f64>,
}

/// Felt impedance at a frequency.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FeltLine {
    /// Frequency, Hz.
    pub frequency_hz: f64,
    /// Amplitude of the operator's force over that of the leader's motion, N/m.
    pub stiffness_n_per_m: f64,
    /// Phase by which the force leads the motion, rad.
    pub phase_rad: f64,
}

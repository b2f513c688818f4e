//! Detector of a motor torque that oscillates about the desired torque.
//!
//! ```text
//! e = H(τ_motor − τ_desired)        r² = mean of e² over an interval        mean of min(r²/b², 1.5) over 5 intervals > 1
//! ```
//!
//! H is a high pass at 15 Hz, an interval 0.08 s, b the bound on the rms r of the deviation. Slower deviations belong to the other
//! watchdogs. They are large in brisk motion, hence the fourth order of H: of a deviation at 5 Hz it passes a hundredth.
//!
//! An oscillation is sustained, an impact is not. The five intervals after the one in which an oscillation begins end within
//! 0.48 s. Some may be below the bound: an oscillation near half the interface rate beats with the samples. An impact of 0.05 s
//! lasts 0.15 s with the time in which H settles, and touches three intervals at most. Since an interval counts 1.5 at
//! most, their mean is 0.9.
//!
//! An interface of 30 Hz or less samples no frequency above 15 Hz: there, nothing is detected.

use crate::fault::Fault;
use crate::high_pass::HighPass;
use nalgebra::DVector;

/// Frequency above which a deviation counts as oscillation, Hz: faster than the deviations in the motion of an arm, slower than
/// gears and sampled servos oscillate.
const CORNER_HZ: f64 = 15.0;

/// Duration of an interval, s: longer than a period at [`CORNER_HZ`].
const INTERVAL_S: f64 = 0.08;

/// Number of last intervals that are compared with the bound.
const INTERVALS: usize = 5;

/// Largest count of an interval: that of the three which an impact touches is below [`INTERVALS`].
const LARGEST_COUNT: f64 = 1.5;

/// Oscillation of a joint.
#[derive(Clone, Debug)]
struct Joint {
    high_pass: HighPass,
    /// Bound on the rms, Nm (N).
    limit: f64,
    /// Sum of e² in the present interval, Nm² (N²).
    sum: f64,
    /// Means of e² in the last intervals, over the square of the bound.
    means: [f64; INTERVALS],
}

/// Detector of oscillation, updated every cycle. Allocates only when it is created.
#[derive(Clone, Debug)]
pub(crate) struct OscillationDetector {
    /// Joints (n); none if the interface samples no frequency above [`CORNER_HZ`].
    joints: Vec<Joint>,
    /// Number of cycles in an interval.
    interval: u32,
    /// Number of cycles that passed in the present interval.
    passed: u32,
    /// Index of the present interval in the means.
    present: usize,
}

impl OscillationDetector {
    /// Returns a detector with the bound `share` on the rms, as a fraction of each torque limit (n; Nm, N), updated every
    /// `period_s` (s).
    pub(crate) fn new(share: f64, torque_limits: &[f64], period_s: f64) -> Self {
        let joint = |torque_limit: &f64| {
            let high_pass = HighPass::new(CORNER_HZ, period_s)?;
            Some(Joint { high_pass, limit: share * torque_limit, sum: 0.0, means: [0.0; INTERVALS] })
        };
        Self {
            joints: torque_limits.iter().filter_map(joint).collect(),
            interval: (INTERVAL_S / period_s).round().max(1.0) as u32,
            passed: 0,
            present: 0,
        }
    }

    /// Brings the filters to rest and clears the means.
    pub(crate) fn reset(&mut self) {
        self.passed = 0;
        for joint in &mut self.joints {
            joint.high_pass.reset();
            (joint.sum, joint.means) = (0.0, [0.0; INTERVALS]);
        }
    }

    /// Updates the means with the motor torques since the last cycle and the desired torques (each n; Nm, N).
    ///
    /// # Errors
    /// Fault of the first joint beyond the bound.
    pub(crate) fn check(&mut self, motor_torque: &DVector<f64>, desired: &DVector<f64>) -> Result<(), Fault> {
        for (i, joint) in self.joints.iter_mut().enumerate() {
            joint.sum += joint.high_pass.update(motor_torque[i] - desired[i]).powi(2);
        }
        self.passed += 1;
        if self.passed < self.interval { Ok(()) } else { self.end_interval() }
    }

    fn end_interval(&mut self) -> Result<(), Fault> {
        for joint in &mut self.joints {
            let mean = std::mem::take(&mut joint.sum) / f64::from(self.interval);
            joint.means[self.present] = mean / (joint.limit * joint.limit);
        }
        self.passed = 0;
        self.present = (self.present + 1) % INTERVALS;
        for (joint, Joint { limit, means, .. }) in self.joints.iter().enumerate() {
            let count: f64 = means.iter().map(|mean| mean.min(LARGEST_COUNT)).sum();
            if count > INTERVALS as f64 {
                let rms = limit * (means.iter().sum::<f64>() / INTERVALS as f64).sqrt();
                return Err(Fault::TorqueOscillation { joint, rms, limit: *limit });
            }
        }
        Ok(())
    }
}

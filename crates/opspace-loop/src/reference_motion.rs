//! Motion that the references ask of the joints, as friction compensation and transformer anticipate it.
//!
//! The acceleration is the difference of two velocities, but at most the one that is commanded: it lies between zero and the
//! commanded acceleration. Near a singular pose, reference velocities change with the measured position, and what is
//! anticipated would be a feedback that can destabilise the arm. While a limit changes the command, the joints do not follow
//! the references, and the acceleration is the commanded one.

use nalgebra::DVector;
use opspace_control::CommandedAcceleration;

/// Velocities and accelerations of the references.
pub(crate) struct ReferenceMotion {
    /// Velocities (n; rad/s, m/s).
    pub(crate) velocity: DVector<f64>,
    /// Accelerations since the last cycle (n; rad/s², m/s²).
    pub(crate) acceleration: DVector<f64>,
    /// True if there was a reference in the last cycle.
    is_continued: bool,
}

impl ReferenceMotion {
    pub(crate) fn new(n: usize) -> Self {
        Self { velocity: DVector::zeros(n), acceleration: DVector::zeros(n), is_continued: false }
    }

    /// Begins a cycle: `velocity` is to be overwritten.
    pub(crate) fn begin(&mut self) {
        self.acceleration.copy_from(&self.velocity);
    }

    /// Ends a cycle, `elapsed_s` (s) after the last one, with the accelerations that are commanded, if they are known. While
    /// torques ramp in, a `share` of them acts.
    pub(crate) fn finish(
        &mut self,
        elapsed_s: f64,
        commanded: Option<CommandedAcceleration<'_>>,
        share: f64,
    ) {
        if !std::mem::replace(&mut self.is_continued, true) {
            self.acceleration.fill(0.0);
            return;
        }
        for (a, v) in self.acceleration.iter_mut().zip(&self.velocity) {
            *a = (v - *a) / elapsed_s;
        }
        match commanded {
            None => {}
            Some(CommandedAcceleration { acceleration, is_limited: true }) => {
                self.acceleration.copy_from_slice(acceleration);
                self.acceleration *= share;
            }
            Some(CommandedAcceleration { acceleration, .. }) => {
                for (a, &commanded) in self.acceleration.iter_mut().zip(acceleration) {
                    let commanded = share * commanded;
                    *a = a.max(commanded.min(0.0)).min(commanded.max(0.0));
                }
            }
        }
    }

    /// Ends the references.
    pub(crate) fn end(&mut self) {
        self.velocity.fill(0.0);
        self.acceleration.fill(0.0);
        self.is_continued = false;
    }
}

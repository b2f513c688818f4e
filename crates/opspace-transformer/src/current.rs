//! Comparison of measured motor current with the expected one: a disturbance observer on interval means.
//!
//! δ is the excess of the motors' torque over the nominal one, through a wrong gain or a hold. A transformer asks
//! for δ less.

use crate::transformer::Transformer;
use nalgebra::DVector;
use opspace_backend::{CommandKind, Sample};
use opspace_model::Data;

/// Share of a new difference that is taken over: fast enough for a wrong gain, slow enough for the noise of the
/// current.
const GAIN: f64 = 0.35;

/// Bound on δ, in torque limits: it is an offset of a setpoint, not a torque of a motor, and at speed a wrong gain
/// asks for more than the motor's own torque.
const LIMIT: f64 = 3.0;

/// Observer of the excess torque δ of n joints, Nm (N).
#[derive(Clone, Debug)]
pub struct CurrentObserver {
    torque_disturbance: DVector<f64>,
    limits: Vec<f64>,
}

impl CurrentObserver {
    /// Returns the observer for drives with these torque limits (n; Nm, N).
    #[must_use]
    pub fn new(torque_limits: &[f64]) -> Self {
        let limits = torque_limits.iter().map(|limit| LIMIT * limit).collect();
        Self { torque_disturbance: DVector::zeros(torque_limits.len()), limits }
    }

    /// Excess torque δ (n; Nm, N).
    #[must_use]
    pub fn torque_disturbance(&self) -> &DVector<f64> {
        &self.torque_disturbance
    }

    /// Updates δ with the mean torques measured over an interval, and those `expected`.
    pub fn update(&mut self, measured: &[f64], expected: &DVector<f64>) {
        for i in 0..self.limits.len() {
            let more = measured[i] - expected[i];
            let surplus = self.torque_disturbance[i] + GAIN * (more - self.torque_disturbance[i]);
            self.torque_disturbance[i] = surplus.clamp(-self.limits[i], self.limits[i]);
        }
    }

    /// Resets δ to zero.
    pub fn reset(&mut self) {
        self.torque_disturbance.fill(0.0);
    }
}

/// Transformer corrected by measured current, for methods that predict no torque between two cycles: the expected mean
/// torque of an interval is that of the commands that acted in it, which are two where setpoints are delayed.
///
/// ```text
/// τ̄_k = ((R − d) (τ − δ)_k₋₁ + d (τ − δ)_k₋₂)/R
/// ```
pub struct CurrentFeedback {
    inner: Box<dyn Transformer>,
    observer: CurrentObserver,
    /// Share of an interval under the last command.
    share: f64,
    /// Torques asked of the last two commands, the later one first (n).
    asked: [DVector<f64>; 2],
    expected: DVector<f64>,
    given: DVector<f64>,
    /// Number of commands in a row that were sent as computed.
    known: u32,
}

impl CurrentFeedback {
    /// Returns the corrected transformer for drives with these torque limits (n; Nm, N), that run `ratio` times an
    /// interface cycle and take a setpoint `delay` of their ticks late.
    #[must_use]
    pub fn new(inner: Box<dyn Transformer>, torque_limits: &[f64], ratio: u32, delay: u32) -> Self {
        let zero = DVector::zeros(torque_limits.len());
        Self {
            inner,
            observer: CurrentObserver::new(torque_limits),
            share: f64::from(ratio - delay) / f64::from(ratio),
            asked: [zero.clone(), zero.clone()],
            expected: zero.clone(),
            given: zero,
            known: 0,
        }
    }
}

impl Transformer for CurrentFeedback {
    fn takes(&self) -> CommandKind {
        self.inner.takes()
    }

    fn observe(&mut self, sample: &Sample) -> Option<&[f64]> {
        // A setpoint that was changed on its way, or didn't come, says nothing of the drives.
        if let Some(measured) = sample.motor_torque.as_ref().filter(|_| self.known >= 2) {
            for (i, expected) in self.expected.iter_mut().enumerate() {
                *expected = self.share * self.asked[0][i] + (1.0 - self.share) * self.asked[1][i];
            }
            self.observer.update(measured, &self.expected);
        }
        self.inner.observe(sample)
    }

    fn transform(&mut self, data: &Data, tau: &[f64], q_desired: &mut [f64]) {
        self.asked.swap(0, 1);
        let asked = &mut self.asked[0];
        asked.copy_from_slice(tau);
        *asked -= self.observer.torque_disturbance();
        self.inner.transform(data, asked.as_slice(), q_desired);
        self.given.copy_from_slice(q_desired);
    }

    fn sent(&mut self, data: &Data, q_desired: &[f64]) {
        self.known = if self.given.as_slice() == q_desired { self.known.saturating_add(1) } else { 0 };
        self.inner.sent(data, q_desired);
    }

    fn missed(&mut self, periods: u64) {
        self.known = 0;
        self.inner.missed(periods);
    }

    fn reset(&mut self) {
        self.known = 0;
        self.observer.reset();
        self.inner.reset();
    }
}

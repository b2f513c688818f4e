//! Disturbance observer that compares measured motor current with the expected one, as means over interface intervals.
//!
//! δ is the motor torque in excess of the nominal one, caused for instance by a wrong gain or by a held setpoint. A
//! transformer subtracts δ from the desired torque.

use crate::transformer::Transformer;
use nalgebra::DVector;
use opspace_backend::{CommandDelay, CommandKind, CommandsInForce, Sample};
use opspace_model::Data;

/// Filter gain of δ per interval: large enough to follow a wrong gain, small enough to reject the noise of the current.
const GAIN: f64 = 0.35;

/// Bound on δ, as a multiple of the torque limit. It may exceed the torque limit because δ shifts a setpoint and is not
/// a torque of the motor: at high speed a wrong gain needs a large shift.
const LIMIT: f64 = 3.0;

/// Observer of the excess torque δ of n joints, Nm (N).
#[derive(Clone, Debug)]
pub struct CurrentObserver {
    torque_disturbance: DVector<f64>,
    limits: Vec<f64>,
}

impl CurrentObserver {
    /// Returns the observer for drives with these torque limits (n; Nm, N). δ is zero at first.
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

    /// Updates δ with the `measured` and `expected` mean torques of an interval (n; Nm, N). Where one of them is not a number,
    /// as after an emulation that overflowed, δ stays.
    pub fn update(&mut self, measured: &[f64], expected: &DVector<f64>) {
        for i in 0..self.limits.len() {
            let more = measured[i] - expected[i];
            let surplus = self.torque_disturbance[i] + GAIN * (more - self.torque_disturbance[i]);
            if !surplus.is_nan() {
                self.torque_disturbance[i] = surplus.clamp(-self.limits[i], self.limits[i]);
            }
        }
    }

    /// Resets δ to zero.
    pub fn reset(&mut self) {
        self.torque_disturbance.fill(0.0);
    }
}

/// Transformer corrected by measured current, for methods that predict no torque between two cycles. The expected mean
/// torque of an interval follows from the commands that act in it. They are two if setpoints are delayed by m interface cycles
/// and d of R servo ticks.
///
/// ```text
/// τ̄_k = ((R − d) (τ − δ)_k₋₁₋ₘ + d (τ − δ)_k₋₂₋ₘ)/R
/// ```
pub struct CurrentFeedback {
    inner: Box<dyn Transformer>,
    observer: CurrentObserver,
    /// Desired torque minus δ of the command of the present cycle (n; Nm, N).
    asked: DVector<f64>,
    /// Those of the commands that act (n; Nm, N).
    in_force: CommandsInForce,
    expected: DVector<f64>,
    given: DVector<f64>,
    /// Number of consecutive commands that were sent unchanged.
    known: u32,
}

impl CurrentFeedback {
    /// Returns the corrected transformer for drives with these torque limits (n; Nm, N). The drives run `ratio` servo
    /// ticks per interface cycle; a setpoint acts after `delay` servo ticks.
    #[must_use]
    pub fn new(inner: Box<dyn Transformer>, torque_limits: &[f64], ratio: u32, delay: u32) -> Self {
        let zero = DVector::zeros(torque_limits.len());
        Self {
            inner,
            observer: CurrentObserver::new(torque_limits),
            asked: zero.clone(),
            in_force: CommandsInForce::new(torque_limits.len(), CommandDelay::of_ticks(delay, ratio)),
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
        // A changed or missing setpoint gives no information about the drives.
        if let Some(measured) = sample.motor_torque.as_ref().filter(|_| self.known >= self.in_force.kept()) {
            for (i, expected) in self.expected.iter_mut().enumerate() {
                *expected = self.in_force.mean(i);
            }
            self.observer.update(measured, &self.expected);
        }
        self.inner.observe(sample)
    }

    fn added_inertia(&self) -> &[f64] {
        self.inner.added_inertia()
    }

    fn uses_reference_motion(&self) -> bool {
        self.inner.uses_reference_motion()
    }

    fn set_reference_motion(&mut self, velocity: &[f64], acceleration: &[f64]) {
        self.inner.set_reference_motion(velocity, acceleration);
    }

    fn transform(&mut self, data: &Data, tau: &[f64], q_desired: &mut [f64]) {
        self.asked.copy_from_slice(tau);
        self.asked -= self.observer.torque_disturbance();
        self.in_force.push(self.asked.as_slice());
        self.inner.transform(data, self.asked.as_slice(), q_desired);
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

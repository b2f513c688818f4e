//! Any transformer, with the velocity observer of the emulating one.

use crate::servo_model_transformer::EmulatingTransformer;
use crate::transformer::Transformer;
use opspace_backend::{CommandKind, Sample};
use opspace_model::Data;

/// Transformer that converts torques by one method, with velocities from the observer of the
/// [emulation](EmulatingTransformer). It shows what the observer contributes, and what the conversion.
pub struct ObservedTransformer {
    observer: EmulatingTransformer,
    inner: Box<dyn Transformer>,
}

impl ObservedTransformer {
    /// Returns a transformer that converts by `inner` and observes by `observer`.
    #[must_use]
    pub fn new(observer: EmulatingTransformer, inner: Box<dyn Transformer>) -> Self {
        Self { observer, inner }
    }
}

impl Transformer for ObservedTransformer {
    fn takes(&self) -> CommandKind {
        self.inner.takes()
    }

    fn observe(&mut self, sample: &Sample) -> Option<&[f64]> {
        self.inner.observe(sample);
        self.observer.observe(sample)
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

    fn is_damped(&self) -> bool {
        self.inner.is_damped()
    }

    fn damping_torque(&self, velocity: &[f64], torques: &mut [[f64; 2]]) {
        self.inner.damping_torque(velocity, torques);
    }

    fn transform(&mut self, data: &Data, torque: &[f64], command: &mut [f64]) {
        self.inner.transform(data, torque, command);
    }

    fn sent(&mut self, data: &Data, command: &[f64]) {
        self.inner.sent(data, command);
        self.observer.sent(data, command);
    }

    fn missed(&mut self, periods: u64) {
        self.inner.missed(periods);
        self.observer.missed(periods);
    }

    fn reset(&mut self) {
        self.inner.reset();
        self.observer.reset();
    }
}

//! Prediction of the state in which a late command acts.
//!
//! A command that is computed from a measurement and acts after a delay d meets another state. Until then the last command
//! acts, so that with τ its torques
//!
//! ```text
//! q̈ = M⁻¹ (τ − h)          q + q̇ d + q̈ d²/2          q̇ + q̈ d
//! ```
//!
//! Tasks and limits are evaluated there, at the time of that state. Friction and external forces are not predicted, which
//! costs accuracy: short delays are left to the horizon of the limits, which allows for them.

use crate::context::ControlContext;
use crate::controller::ControlInput;
use crate::measurement::Measurement;
use nalgebra::DVector;
use opspace_model::{Data, Model, update};

/// State of an arm when its next command acts.
pub(crate) struct Prediction {
    delay_s: f64,
    gravity_by_robot: bool,
    data: Data,
    measurement: Measurement,
    /// Joint acceleration until then, rad/s² or m/s² (n).
    acceleration: DVector<f64>,
}

impl Prediction {
    /// Returns `None` if no delay is known, or a short one.
    pub(crate) fn new(model: &Model, context: &ControlContext) -> Option<Self> {
        context.predicts_state().then(|| Self {
            delay_s: context.command_delay_s,
            gravity_by_robot: context.gravity_by_robot,
            data: Data::new(model),
            measurement: Measurement::new(model.n(), context.sensors.len(), false),
            acceleration: DVector::zeros(model.n()),
        })
    }

    /// Returns the input at the predicted state, without motor torques. `commanded` are the last commanded torques (n). `None` if the state is not
    /// finite.
    pub(crate) fn of<'a>(
        &'a mut self,
        input: &ControlInput<'a>,
        commanded: &DVector<f64>,
    ) -> Option<ControlInput<'a>> {
        let (data, d) = (input.data, self.delay_s);
        self.acceleration.copy_from(commanded);
        self.acceleration -= &data.bias;
        if self.gravity_by_robot {
            self.acceleration += &data.gravity;
        }
        data.mass_matrix_factor.solve(self.acceleration.as_mut_slice());
        let predicted = &mut self.measurement;
        predicted.q.copy_from(&input.measurement.q);
        predicted.dq.copy_from(&input.measurement.dq);
        predicted.wrenches.copy_from_slice(&input.measurement.wrenches);
        predicted.time_s = input.measurement.time_s + d;
        predicted.q.axpy(d, &input.measurement.dq, 1.0);
        predicted.q.axpy(0.5 * d * d, &self.acceleration, 1.0);
        predicted.dq.axpy(d, &self.acceleration, 1.0);
        let finite = predicted.q.iter().chain(predicted.dq.iter()).all(|x| x.is_finite());
        let valid =
            finite && update(input.model, &mut self.data, predicted.q.as_slice(), predicted.dq.as_slice());
        valid.then_some(ControlInput {
            data: &self.data,
            measurement: &self.measurement,
            clock_s: input.clock_s + d,
            ..*input
        })
    }
}

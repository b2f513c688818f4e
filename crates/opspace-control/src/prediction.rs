//! Prediction of the state in which a late command acts.
//!
//! A command that is computed from a measurement and acts after a delay d meets another state. Until then the last commands
//! act. With τ the torques of one of them, and d the time for which it acts,
//!
//! ```text
//! q̈ = M⁻¹ (τ − h)          q + q̇ d + q̈ d²/2          q̇ + q̈ d
//! ```
//!
//! M and h are those of the measured state. Tasks and limits are evaluated there, at the time of that state. Friction and external forces are not predicted, which
//! costs accuracy: short delays are left to the horizon of the limits, which allows for them.

use crate::context::ControlContext;
use crate::controller::ControlInput;
use crate::measurement::Measurement;
use nalgebra::DVector;
use opspace_backend::{CommandDelay, CommandsInForce, MAX_DELAY_CYCLES};
use opspace_model::{Data, Model, update};

/// State of an arm when its next command acts.
pub(crate) struct Prediction {
    delay_s: f64,
    period_s: f64,
    /// Last commanded torques (n; Nm, N), and the time of the last one, s.
    commands: CommandsInForce,
    clock_s: f64,
    gravity_by_robot: bool,
    data: Data,
    measurement: Measurement,
    /// Joint acceleration under one of them, rad/s² or m/s² (n).
    acceleration: DVector<f64>,
}

impl Prediction {
    /// Returns `None` if no delay is known, or a short one.
    pub(crate) fn new(model: &Model, context: &ControlContext) -> Option<Self> {
        context.predicts_state().then(|| Self {
            delay_s: context.command_delay_s,
            period_s: context.period_s,
            commands: CommandsInForce::new(
                model.n(),
                CommandDelay::of_time(context.command_delay_s, context.period_s),
            ),
            clock_s: f64::NAN,
            gravity_by_robot: context.gravity_by_robot,
            data: Data::new(model),
            measurement: Measurement::new(model.n(), context.sensors.len(), false),
            acceleration: DVector::zeros(model.n()),
        })
    }

    /// Forgets the commands: the arm was held until now.
    pub(crate) fn restart(&mut self) {
        self.commands.clear();
        self.clock_s = f64::NAN;
    }

    /// Adds the last commanded torques (n; Nm, N), once for each cycle since then.
    fn follow(&mut self, clock_s: f64, commanded: &DVector<f64>) {
        self.commands.push(commanded.as_slice());
        // Not a number at the start.
        let missed = ((clock_s - self.clock_s) / self.period_s).round() - 1.0;
        for _ in 0..missed.clamp(0.0, f64::from(MAX_DELAY_CYCLES)) as u32 {
            self.commands.repeat();
        }
        self.clock_s = clock_s;
    }

    /// Returns the input at the predicted state, without motor torques. `commanded` are the last commanded torques (n). `None` if the state is not
    /// finite.
    pub(crate) fn of<'a>(
        &'a mut self,
        input: &ControlInput<'a>,
        commanded: &DVector<f64>,
    ) -> Option<ControlInput<'a>> {
        self.follow(input.clock_s, commanded);
        let data = input.data;
        let predicted = &mut self.measurement;
        predicted.q.copy_from(&input.measurement.q);
        predicted.dq.copy_from(&input.measurement.dq);
        predicted.wrenches.copy_from_slice(&input.measurement.wrenches);
        predicted.time_s = input.measurement.time_s + self.delay_s;
        for (torques, cycles) in self.commands.until_next() {
            let d = cycles * self.period_s;
            self.acceleration.copy_from_slice(torques);
            self.acceleration -= &data.bias;
            if self.gravity_by_robot {
                self.acceleration += &data.gravity;
            }
            data.mass_matrix_factor.solve(self.acceleration.as_mut_slice());
            predicted.q.axpy(d, &predicted.dq, 1.0);
            predicted.q.axpy(0.5 * d * d, &self.acceleration, 1.0);
            predicted.dq.axpy(d, &self.acceleration, 1.0);
        }
        let finite = predicted.q.iter().chain(predicted.dq.iter()).all(|x| x.is_finite());
        let valid =
            finite && update(input.model, &mut self.data, predicted.q.as_slice(), predicted.dq.as_slice());
        valid.then_some(ControlInput {
            data: &self.data,
            measurement: &self.measurement,
            clock_s: input.clock_s + self.delay_s,
            ..*input
        })
    }
}

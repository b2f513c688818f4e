//! Prediction of the state in which a late command acts.
//!
//! A command that is computed from a measurement and acts after a delay d meets another state. Until then the last commands
//! act. With τ the torques of one of them, and d the time for which it acts,
//!
//! ```text
//! q̈ = M⁻¹ (τ − h + Σ Jᵀ f)          q + q̇ d + q̈ d²/2          q̇ + q̈ d
//! ```
//!
//! M, h, the Jacobians J of the force sensors and their wrenches f are those of the measurement. Without f an arm that presses on a
//! wall would be predicted within the wall. The torques of f pass a low-pass filter whose time constant is the delay: those of a
//! stiff wall change with the predicted motion, and, assumed constant, would drive the arm into it. Tasks and limits are evaluated at
//! the predicted state, at its time. Friction, and forces that no sensor measures, are not predicted, which costs accuracy: short
//! delays are left to the horizon of the limits, which allows for them.

use crate::context::{ControlContext, separate_sensors};
use crate::controller::ControlInput;
use crate::measurement::Measurement;
use nalgebra::{DVector, Matrix6xX, Vector6};
use opspace_backend::{CommandDelay, CommandsInForce, MAX_DELAY_CYCLES};
use opspace_model::{Data, Force, FrameId, Model, frame_jacobian, update};

/// State of an arm when its next command acts: see the [module](self). Allocates only when it is created.
pub struct Prediction {
    delay_s: f64,
    period_s: f64,
    /// Last commanded torques (n; Nm, N), and the time of the last one, s.
    commands: CommandsInForce,
    clock_s: f64,
    gravity_by_robot: bool,
    /// Index and frame of the force sensors that count.
    sensors: Vec<(usize, FrameId)>,
    jacobian: Matrix6xX<f64>,
    /// Torques of the measured wrenches (n; Nm, N), and their filtered ones.
    external: DVector<f64>,
    filtered: DVector<f64>,
    /// Share of a new torque in the filtered one.
    share: f64,
    data: Data,
    measurement: Measurement,
    /// Joint acceleration under one of them, rad/s² or m/s² (n).
    acceleration: DVector<f64>,
}

impl Prediction {
    /// Returns `None` if no delay is known, or one of at most [`UNPREDICTED_S`](crate::context::UNPREDICTED_S).
    #[must_use]
    pub fn new(model: &Model, context: &ControlContext) -> Option<Self> {
        context.predicts_state().then(|| Self {
            delay_s: context.command_delay_s,
            period_s: context.period_s,
            commands: CommandsInForce::new(
                model.n(),
                CommandDelay::of_time(context.command_delay_s, context.period_s),
            ),
            clock_s: f64::NAN,
            gravity_by_robot: context.gravity_by_robot,
            sensors: separate_sensors(model, context.sensors.iter().map(|(_, frame)| *frame)),
            jacobian: Matrix6xX::zeros(model.n()),
            external: DVector::zeros(model.n()),
            filtered: DVector::zeros(model.n()),
            share: 1.0 - (-context.period_s / context.command_delay_s).exp(),
            data: Data::new(model),
            measurement: Measurement::new(model.n(), context.sensors.len(), false),
            acceleration: DVector::zeros(model.n()),
        })
    }

    /// Forgets the commands: the arm was held until now.
    pub fn restart(&mut self) {
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

    /// Computes the torques of the measured wrenches; the filter starts with those of the first measurement.
    fn update_external(&mut self, input: &ControlInput<'_>) {
        self.external.fill(0.0);
        for (sensor, frame) in &self.sensors {
            frame_jacobian(input.model, input.data, *frame, &mut self.jacobian);
            let Force { linear: force, angular: moment } = input.measurement.wrenches[*sensor];
            let wrench = Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
            self.external.gemv_tr(1.0, &self.jacobian, &wrench, 1.0);
        }
        // Not a number at the start.
        if self.clock_s.is_nan() {
            self.filtered.copy_from(&self.external);
        }
        self.filtered.axpy(self.share, &self.external, 1.0 - self.share);
    }

    /// Returns the input at the predicted state, without motor torques. `commanded` are the last commanded torques (n).
    /// `None` if the state is not finite.
    pub fn of<'a>(
        &'a mut self,
        input: &ControlInput<'a>,
        commanded: &DVector<f64>,
    ) -> Option<ControlInput<'a>> {
        self.update_external(input);
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
            self.acceleration += &self.filtered;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::targets::Targets;
    use nalgebra::{Matrix3, Vector3};
    use opspace_model::{Inertia, Joint, JointKind, Limits, Placement};

    /// Compared: a mass at rest that presses with the force of its command, and its predicted state, from the first cycle on, also after a
    /// hold; and the state for a command that no force balances.
    #[test]
    fn pressing_mass_is_predicted_at_rest() {
        const DELAY_S: f64 = 0.02;
        // Of sums of some ten products, m/s.
        const ROUNDED: f64 = 1e-12;
        let mut model = Model::new("mass").with_gravity(Vector3::zeros());
        let joint = Joint { name: "slide".into(), kind: JointKind::Prismatic, limits: Limits::NONE };
        let inertia = Inertia { mass: 2.0, com: Vector3::zeros(), rotational: Matrix3::identity() };
        let body = model.add_body(None, Placement::identity(), joint, inertia);
        let frame = model.add_frame("tip", Some(body), Placement::identity());
        let context = ControlContext {
            command_delay_s: DELAY_S,
            sensors: vec![("tip".to_owned(), frame)],
            ..ControlContext::new(&model, 1e-3)
        };
        let mut data = Data::new(&model);
        assert!(update(&model, &mut data, &[0.0], &[0.0]));
        let mut jacobian = Matrix6xX::zeros(1);
        frame_jacobian(&model, &data, frame, &mut jacobian);
        let mut prediction = Prediction::new(&model, &context).expect("a long delay");
        let (targets, pressing) = (Targets::none(), DVector::from_element(1, 5.0));
        let mut velocity = |time_s: f64, force_n: f64, is_held: bool| {
            let mut measurement = Measurement::new(1, 1, false);
            measurement.time_s = time_s;
            measurement.wrenches[0].linear = -force_n * jacobian.fixed_view::<3, 1>(0, 0);
            if is_held {
                prediction.restart();
            }
            let input = ControlInput::new(&model, &data, &measurement, &[0.0], &targets);
            prediction.of(&input, &pressing).expect("finite").measurement.dq[0]
        };
        for (cycle, is_held) in [false, false, true, false].into_iter().enumerate() {
            assert!(velocity(1e-3 * cycle as f64, 5.0, is_held).abs() < ROUNDED, "cycle {cycle}");
        }
        let free = velocity(1.0, 0.0, true);
        assert!((free - 5.0 / 2.0 * DELAY_S).abs() < ROUNDED, "{free} m/s");
    }
}

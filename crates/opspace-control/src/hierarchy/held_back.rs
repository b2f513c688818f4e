//! States of a task that limits, damping or a singular pose hold back: its escape, its resistance and its standstill.
//!
//! A level owns one of them. They are three answers to one situation, a demand that the arm does not carry out: an
//! [`Escape`] moves the arm out of a singular pose, a [`Resistance`] replaces the least-squares solution at limits, which
//! would oscillate, and a [`Standstill`] lets a task rest that cannot reach its goal.

use crate::context::ControlContext;
use crate::hierarchy::escape::{Effect, Escape, EscapeInput};
use crate::hierarchy::standstill::{Outcome, Standstill};
use crate::limits::resistance::Resistance;
use crate::nullspace::ProjectedTask;
use crate::tasks::singular_escape::SingularEscape;
use crate::tasks::task::Task;
use nalgebra::Vector6;
use opspace_backend::SignalRecorder;
use opspace_backend::signal_names::{ESCAPE, MIN_SINGULAR_GAIN, STANDSTILL};
use opspace_model::{Data, Model};

/// Escape, resistance and standstill of one level.
pub(crate) struct HeldBack {
    /// Escape from singular poses, if the task has this option.
    escape: Option<Box<Escape>>,
    /// Resistance while limits hold the task back.
    resistance: Resistance,
    /// Standstill at a goal that the task cannot reach.
    standstill: Standstill,
}

impl HeldBack {
    /// Creates the states of `task`, with `above` levels above it.
    pub(crate) fn new(task: &dyn Task, model: &Model, context: &ControlContext, above: usize) -> Self {
        let escapes = task.escape() != SingularEscape::None;
        Self {
            escape: escapes.then(|| Box::new(Escape::new(model, context, above))),
            resistance: Resistance::new(model.n()),
            standstill: Standstill::new(),
        }
    }

    /// Forgets the cycles before.
    pub(crate) fn reset(&mut self) {
        self.resistance.release();
        self.standstill = Standstill::new();
        if let Some(escape) = &mut self.escape {
            escape.reset();
        }
    }

    /// Updates the escape, and returns its effect. `tasks_above` are the tasks above with their typical mobility.
    pub(crate) fn update_escape<'a>(
        &mut self,
        input: &EscapeInput<'_>,
        tasks_above: impl Iterator<Item = (&'a dyn Task, f64)> + Clone,
        projected: &mut ProjectedTask,
    ) -> Effect {
        let Some(escape) = &mut self.escape else { return Effect::None };
        let effect = escape.update(input, tasks_above, projected);
        if escape.acts() {
            self.standstill = Standstill::new();
        }
        effect
    }

    /// Returns true if the level has an escape.
    pub(crate) fn can_escape(&self) -> bool {
        self.escape.is_some()
    }

    /// Returns true while an escape moves the arm.
    pub(crate) fn is_escaping(&self) -> bool {
        self.escape.as_ref().is_some_and(|escape| escape.acts())
    }

    /// Replaces the demand of the rows along the direction of the escape.
    pub(crate) fn replace_demand(&self, demand: &mut Vector6<f64>) {
        if let Some(escape) = &self.escape {
            escape.replace_demand(demand);
        }
    }

    /// Removes the part of an added force along the direction of the escape.
    pub(crate) fn remove_force(&self, force: &mut Vector6<f64>) {
        if let Some(escape) = &self.escape {
            escape.remove_force(force);
        }
    }

    /// Returns true if the resistance does not change anything.
    pub(crate) fn does_not_resist(&self) -> bool {
        self.resistance.is_negligible()
    }

    /// Resistance of the joints ([`Resistance::of_joints`]), unless it is negligible.
    pub(crate) fn resistance(&self) -> Option<(f64, &[f64])> {
        (!self.resistance.is_negligible()).then(|| self.resistance.of_joints())
    }

    /// Computes the passive arm that resists the demand of the rows. At a standstill, it is only braked.
    pub(crate) fn update_resistance(
        &mut self,
        data: &Data,
        projected: &ProjectedTask,
        demand: Vector6<f64>,
        typical: f64,
        period_s: f64,
    ) {
        let demand = demand * (1.0 - self.standstill.share());
        self.resistance.update(data, projected, &demand, typical, period_s);
    }

    /// Lets the resistance follow a cycle within limits, which held the level back by `held`.
    pub(crate) fn follow_resistance(&mut self, held: f64, typical: f64, period_s: f64) {
        self.resistance.follow(held, typical, self.standstill.share(), period_s);
    }

    /// Ends the resistance.
    pub(crate) fn release_resistance(&mut self) {
        self.resistance.release();
    }

    /// Standstill of the level.
    pub(crate) fn standstill(&self) -> &Standstill {
        &self.standstill
    }

    /// Lets the standstill follow a cycle.
    pub(crate) fn follow_standstill(
        &mut self,
        error: &Vector6<f64>,
        outcome: &Outcome,
        least_m_per_s: f64,
        period_s: f64,
    ) {
        self.standstill.follow(error, outcome, least_m_per_s, period_s);
    }

    /// Records the acceleration of an escape from a singular pose, if the task has this option.
    pub(crate) fn record_escape(&self, task: &str, out: &mut SignalRecorder<'_>) {
        if let Some(escape) = &self.escape {
            out.scalar((task, ESCAPE), "rad/s²", escape.acceleration());
        }
    }

    /// Records the lowest gain of the damped inverse, `gain` without an escape, and the standstill.
    pub(crate) fn record(&self, task: &str, gain: f64, out: &mut SignalRecorder<'_>) {
        let gain = self.escape.as_ref().map_or(gain, |escape| escape.min_singular_gain);
        out.scalar((task, MIN_SINGULAR_GAIN), "1", gain);
        out.scalar((task, STANDSTILL), "1", self.standstill.share());
    }
}

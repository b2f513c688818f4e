//! Passivity observer and controller of the force feedback of one axis (Hannaford and Ryu, *Time-domain passivity control of
//! haptic interfaces*, IEEE Transactions on Robotics and Automation 18(1), 2002).
//!
//! Feedback of a force that is filtered and delayed by τ gives energy to a hand that oscillates on a stiff wall: with the
//! gain k and the stiffness K it is negative damping of about −k K τ. The observer sums the work of the feedback over each
//! cycle, in which the force of the last cycle acts, without the slow parts of force and motion, which do the work that the task
//! asks for:
//!
//! ```text
//! E ← max(0, E (1 − T/T_w) + (F₋ − F̄₋)(Δx − Δx̄))
//! ```
//!
//! F₋ is the feedback of the last cycle, Δx the displacement since then, T the period, and T_w the window. When E exceeds
//! a store, the gains are reduced in proportion to the excess. They return slowly.

use crate::tasks::force_parameters::PassivityParameters;
use opspace_backend::LowPass;

/// Frequency below which force and motion are those of the task, Hz.
const SLOW_HZ: f64 = 2.0;

/// Passivity observer and controller, with their state.
#[derive(Clone, Debug)]
pub(crate) struct ForcePassivity {
    is_enabled: bool,
    period_s: f64,
    store_j: f64,
    window_s: f64,
    /// Longest time over which gains return, and the present one, s.
    longest_recovery_s: f64,
    recovery_s: f64,
    /// Time since the store was exceeded, s.
    steady_s: f64,
    /// Slow parts of force (N, Nm) and displacement per cycle (m, rad).
    slow: LowPass<2>,
    /// Feedback of the last cycle, N or Nm.
    last: f64,
    energy_j: f64,
    share: f64,
    active_s: f64,
}

impl ForcePassivity {
    pub(crate) fn new(parameters: &PassivityParameters, period_s: f64) -> Self {
        Self {
            is_enabled: parameters.enabled,
            period_s,
            store_j: parameters.store_j.get(),
            window_s: parameters.window_s.get(),
            longest_recovery_s: parameters.recovery_s.get(),
            recovery_s: FIRST_RECOVERY * parameters.recovery_s.get(),
            steady_s: f64::INFINITY,
            slow: LowPass::new(SLOW_HZ, period_s),
            last: 0.0,
            energy_j: 0.0,
            share: 1.0,
            active_s: 0.0,
        }
    }

    /// Share of the gains that is in force, from 0 to 1.
    pub(crate) fn share(&self) -> f64 {
        self.share
    }

    /// Energy that the feedback has given to the motion, J.
    pub(crate) fn energy_j(&self) -> f64 {
        self.energy_j
    }

    /// Time for which gains have been reduced, s.
    pub(crate) fn active_s(&self) -> f64 {
        self.active_s
    }

    /// Forgets what was observed; reduced gains stay reduced.
    pub(crate) fn restart(&mut self) {
        (self.energy_j, self.last) = (0.0, 0.0);
        self.slow.reset(&[0.0; 2]);
    }

    /// Continues from the observer of the previous task set.
    pub(crate) fn inherit_state(&mut self, before: &Self) {
        self.slow.reset(before.slow.output());
        self.last = before.last;
        (self.energy_j, self.share, self.active_s) = (before.energy_j, before.share, before.active_s);
        (self.recovery_s, self.steady_s) = (before.recovery_s, before.steady_s);
        if !self.is_enabled {
            self.share = 1.0;
        }
    }

    /// Observes the displacement (m, rad) since the last cycle under its feedback, and reduces or restores the gains.
    pub(crate) fn update(&mut self, displacement: f64) {
        if !displacement.is_finite() {
            return;
        }
        let [slow_force, slow_displacement] = self.slow.update(&[self.last, displacement]);
        let work_j = (self.last - slow_force) * (displacement - slow_displacement);
        self.energy_j += work_j - self.period_s / self.window_s * self.energy_j;
        self.energy_j = self.energy_j.max(0.0);
        if !self.is_enabled {
            return;
        }
        let excess = self.energy_j / self.store_j - 1.0;
        if excess > 0.0 {
            match self.steady_s {
                ..SAME_IMPACT_S => {}
                ..OTHER_IMPACT_S => self.recovery_s = self.longest_recovery_s,
                _ => self.recovery_s = FIRST_RECOVERY * self.longest_recovery_s,
            }
            self.steady_s = 0.0;
        } else {
            self.steady_s += self.period_s;
        }
        let rate = if excess > 0.0 {
            -self.share * excess / self.window_s
        } else {
            (1.0 - self.share) / self.recovery_s
        };
        self.share = (self.share + self.period_s * rate).clamp(0.0, 1.0);
        if self.share < FULL {
            self.active_s += self.period_s;
        }
    }

    /// Sets the feedback of this cycle (N, Nm).
    pub(crate) fn set_feedback(&mut self, feedback: f64) {
        self.last = feedback;
    }
}

/// Time without excess below which an excess belongs to the same impact, and from which it is another one, s.
const SAME_IMPACT_S: f64 = 0.3;
const OTHER_IMPACT_S: f64 = 5.0;

/// Time over which gains return at first, as a fraction of the longest one.
const FIRST_RECOVERY: f64 = 0.05;

/// Share above which gains count as not reduced.
const FULL: f64 = 0.999;

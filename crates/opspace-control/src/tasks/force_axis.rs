//! Force control of one axis: target, approach until contact, feedback of the force error, and passivity control.
//!
//! With the sensed force f and the target f_d, both ON the robot, the force that is added to the task force is
//!
//! ```text
//! F = −γ f_d + s k (f − f_d) + ∫ s i (f − f_d) dt, bounded
//! ```
//!
//! with the feed-forward γ, the gain k, the integral gain i, and the share s of the [passivity control](ForcePassivity). The
//! target ramps in from the sensed force. The damping of the axis, an acceleration −c v, is part of the task.
//!
//! An axis that approaches moves at a constant speed v_a against the desired force, like a mass on a spring and a damper:
//! a* = c (v_a − v) + c²/16 ∫ (v_a − v) dt, with twice the critical damping.

use crate::axis_mode::AxisMode;
use crate::tasks::force_parameters::{COMPLIANT_GAIN, ContactParameters, ForceParameters};
use crate::tasks::force_passivity::ForcePassivity;
use crate::tasks::gain_profile::value_at;
use opspace_backend::quantity::{Fraction, NonNegative};

/// Distance by which the approach may lag behind, as a time at its speed, s: a bound of the force of a blocked approach.
const LARGEST_LAG_S: f64 = 0.2;

/// Force feedback of one axis, with its state.
#[derive(Clone, Debug)]
pub(crate) struct ForceAxis {
    settings: Settings,
    mode: AxisMode,
    period_s: f64,
    /// Target that is set from outside, N or Nm.
    streamed: Option<f64>,
    /// Force from which the target ramps in, N or Nm, and time since then, s.
    from: f64,
    ramped_s: f64,
    /// False from a change of mode to force control until its first cycle.
    is_begun: bool,
    /// Target of this cycle, N or Nm.
    pub target: f64,
    integral: f64,
    contact: Contact,
    pub passivity: ForcePassivity,
}

/// Configured values of an axis, for any mode.
#[derive(Clone, Debug)]
struct Settings {
    target: f64,
    /// Times (s) and forces (N).
    profile: Vec<[f64; 2]>,
    ramp_s: f64,
    feed_forward: f64,
    /// Gains of a compliant axis and of a force axis.
    gains: [f64; 2],
    integral_step: f64,
    /// Upper bound of the force integral, N or Nm; `None` for the magnitude of the target.
    integral_limit: Option<f64>,
    compensation: f64,
    approach: Option<ContactParameters>,
}

/// Contact of a force axis.
#[derive(Clone, Copy, Debug, Default)]
struct Contact {
    is_made: bool,
    /// Time for which the force has been too small, s.
    below_s: f64,
    /// Distance by which the approach lags behind, m.
    lag_m: f64,
}

/// Motion of an axis.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AxisMotion {
    /// Velocity, m/s or rad/s.
    pub velocity: f64,
    /// Displacement since the last cycle, m or rad.
    pub displacement: f64,
}

impl ForceAxis {
    /// Creates an axis; parameters that the mode requires are checked elsewhere.
    pub(crate) fn new(force: &ForceParameters, axis: usize, mode: AxisMode, period_s: f64) -> Self {
        let value = |values: &Option<crate::PerAxis<NonNegative>>| values.and_then(|values| values.get(axis));
        let gain = value(&force.gain).map(NonNegative::get);
        let compensation = force.sensed_compensation.and_then(|values| values.get(axis));
        let is_translation = axis < 3;
        let has_profile = !force.profile_n.of(axis).is_empty();
        let largest_of_profile = has_profile.then(|| force.largest_target(axis));
        let settings = Settings {
            target: force.target_of(axis),
            profile: force.profile_n.of(axis).to_vec(),
            ramp_s: force.ramp_s.get(),
            feed_forward: force.feed_forward.get(axis).map_or(1.0, Fraction::get),
            gains: [gain.unwrap_or(COMPLIANT_GAIN), force.force_gain(axis, period_s)],
            integral_step: force.integral(axis) * period_s,
            integral_limit: value(&force.integral_limit).map(NonNegative::get).or(largest_of_profile),
            compensation: compensation.map_or(0.0, Fraction::get),
            approach: force.contact.filter(|_| is_translation),
        };
        let mut new = Self {
            passivity: ForcePassivity::new(&force.passivity, period_s),
            settings,
            mode: AxisMode::Free,
            period_s,
            streamed: None,
            from: 0.0,
            ramped_s: 0.0,
            is_begun: false,
            target: 0.0,
            integral: 0.0,
            contact: Contact::default(),
        };
        new.set(mode, None);
        new
    }

    /// Sets the mode; a streamed target (N, Nm) replaces the configured one. Resets the integral unless the axis is in force
    /// control.
    pub(crate) fn set(&mut self, mode: AxisMode, streamed: Option<f64>) {
        if mode == AxisMode::Force && self.mode != AxisMode::Force {
            self.is_begun = false;
        }
        (self.mode, self.streamed) = (mode, streamed);
        if mode != AxisMode::Force {
            self.target = if mode == AxisMode::Compliant { self.final_target(0.0) } else { 0.0 };
            self.integral = 0.0;
        }
    }

    /// Starts at a sensed force (N, Nm).
    pub(crate) fn start(&mut self, sensed: f64) {
        self.integral = 0.0;
        self.passivity.restart();
        self.contact = Contact { is_made: self.touches(sensed, 0.0), ..Contact::default() };
        self.begin_ramp(sensed);
    }

    /// Continues from the axis of the previous task set.
    pub(crate) fn inherit_state(&mut self, before: &Self) {
        if self.mode != AxisMode::Force || before.mode != AxisMode::Force {
            return;
        }
        let limit = self.integral_limit(0.0);
        self.integral = before.integral.clamp(-limit, limit);
        self.contact = before.contact;
        self.passivity.inherit_state(&before.passivity);
        self.begin_ramp(before.target);
    }

    /// Target after the ramp, `time_s` (s) after the start of the task, N or Nm.
    fn final_target(&self, time_s: f64) -> f64 {
        let configured = || value_at(&self.settings.profile, time_s).unwrap_or(self.settings.target);
        self.streamed.unwrap_or_else(configured)
    }

    fn integral_limit(&self, time_s: f64) -> f64 {
        self.settings.integral_limit.unwrap_or_else(|| self.final_target(time_s).abs())
    }

    fn begin_ramp(&mut self, from: f64) {
        if self.mode == AxisMode::Force {
            (self.is_begun, self.from, self.ramped_s, self.target) = (true, from, 0.0, from);
        }
    }

    /// True if the sensed force is one of contact.
    fn touches(&self, sensed: f64, time_s: f64) -> bool {
        let above = self.settings.approach.map_or(f64::NEG_INFINITY, |contact| contact.made_above_n.get());
        sensed * self.final_target(time_s).signum() >= above
    }

    /// True if the axis moves until it touches something.
    pub(crate) fn approaches(&self) -> bool {
        self.settings.approach.is_some() && self.mode == AxisMode::Force && !self.contact.is_made
    }

    /// True if the axis is in contact; `None` if it does not approach without contact.
    pub(crate) fn contact_made(&self) -> Option<bool> {
        let approaches = self.settings.approach.is_some() && self.mode == AxisMode::Force;
        approaches.then_some(self.contact.is_made)
    }

    /// Contact of the axis for the log: 1 made, 0 approaching, NaN without force control.
    pub(crate) fn contact_code(&self) -> f64 {
        if self.mode == AxisMode::Force { f64::from(u8::from(!self.approaches())) } else { f64::NAN }
    }

    /// Updates target, contact and feedback with the sensed force (N, Nm) and the motion of the axis, `time_s` (s) after the
    /// start of the task.
    pub(crate) fn update(&mut self, sensed: f64, motion: AxisMotion, time_s: f64) {
        if !self.update_contact(sensed, motion.velocity, time_s) {
            return;
        }
        self.passivity.update(motion.displacement);
        if self.approaches() || !(sensed - self.target).is_finite() {
            self.passivity.set_feedback(0.0);
            return;
        }
        self.advance_ramp(time_s);
        let error = sensed - self.target;
        let share = self.passivity.share();
        let limit = self.integral_limit(time_s);
        self.integral = (self.integral + share * self.settings.integral_step * error).clamp(-limit, limit);
        self.passivity.set_feedback(share * self.settings.gains[1] * error + self.integral);
    }

    /// Updates target and contact, but no feedback, for inverse kinematics.
    pub(crate) fn update_target(&mut self, sensed: f64, velocity: f64, time_s: f64) {
        if self.update_contact(sensed, velocity, time_s) && !self.approaches() && sensed.is_finite() {
            self.advance_ramp(time_s);
        }
    }

    /// Updates the contact; returns false without force control.
    fn update_contact(&mut self, sensed: f64, velocity: f64, time_s: f64) -> bool {
        if self.mode == AxisMode::Force && !self.is_begun {
            self.start(sensed);
        }
        match self.mode {
            AxisMode::Force if self.final_target(time_s) != 0.0 => {
                self.follow_contact(sensed, velocity, time_s);
            }
            AxisMode::Force => self.contact.is_made = true,
            AxisMode::Motion | AxisMode::Compliant | AxisMode::Free => return false,
        }
        true
    }

    fn advance_ramp(&mut self, time_s: f64) {
        self.ramped_s += self.period_s;
        let share = (self.ramped_s / self.settings.ramp_s.max(self.period_s)).min(1.0);
        self.target = self.from + share * (self.final_target(time_s) - self.from);
    }

    fn follow_contact(&mut self, sensed: f64, velocity: f64, time_s: f64) {
        let Some(parameters) = self.settings.approach else { return };
        let toward = sensed * self.final_target(time_s).signum();
        if self.contact.is_made {
            let is_below = toward < parameters.lost_below_n.get();
            self.contact.below_s = if is_below { self.contact.below_s + self.period_s } else { 0.0 };
            if self.contact.below_s > parameters.lost_after_s.get() {
                self.contact = Contact::default();
                self.integral = 0.0;
            }
        } else if self.touches(sensed, time_s) {
            self.contact = Contact { is_made: true, ..Contact::default() };
            self.begin_ramp(sensed);
        } else {
            let longest = parameters.approach_m_per_s.get() * LARGEST_LAG_S;
            let lag = self.contact.lag_m + self.period_s * (self.approach_speed(time_s) - velocity);
            if lag.is_finite() {
                self.contact.lag_m = lag.clamp(-longest, longest);
            }
            self.target = 0.0;
        }
    }

    /// Velocity of the approach, m/s.
    pub(crate) fn approach_speed(&self, time_s: f64) -> f64 {
        let speed = self.settings.approach.map_or(0.0, |contact| contact.approach_m_per_s.get());
        -self.final_target(time_s).signum() * speed
    }

    /// Acceleration that is added to the damping −`damping` v (1/s) while the axis approaches, m/s²; `time_s` (s) after the
    /// start of the task.
    pub(crate) fn approach_acceleration(&self, damping: f64, time_s: f64) -> f64 {
        if !self.approaches() {
            return 0.0;
        }
        damping * (self.approach_speed(time_s) + damping / 16.0 * self.contact.lag_m)
    }

    /// Force that is added to the task force, N or Nm.
    pub(crate) fn added(&self, sensed: f64) -> f64 {
        let Settings { gains: [compliant, force], feed_forward, compensation, .. } = self.settings;
        match self.mode {
            AxisMode::Compliant => compliant * (sensed - self.target) - feed_forward * self.target,
            AxisMode::Force if self.approaches() => 0.0,
            AxisMode::Force => {
                let feedback = self.passivity.share() * force * (sensed - self.target) + self.integral;
                feedback - feed_forward * self.target
            }
            AxisMode::Motion => -compensation * sensed,
            AxisMode::Free => 0.0,
        }
    }
}

//! Motor: its current loop, which follows the command as a first-order lag, and its torques that depend on its angle.

use crate::parameters::{CoggingParameters, TorqueRippleParameters};
use std::f64::consts::TAU;

/// Torques of a motor that depend on its angle: `τ (1 + r sin(n θ)) + c sin(m θ)`, with the torque τ of its current.
#[derive(Clone, Copy, Debug, Default)]
pub struct AngleTorque {
    /// Amplitude c of the cogging, Nm (N), and its periods m per rad (m) of the joint.
    cogging: (f64, f64),
    /// Amplitude r of the ripple, and its periods n per rad (m) of the joint.
    ripple: (f64, f64),
}

impl AngleTorque {
    /// Returns the torques of a motor behind a gear of `gear_ratio`, at a joint with `torque_limit` (Nm, N).
    #[must_use]
    pub fn new(
        cogging: Option<&CoggingParameters>,
        ripple: Option<&TorqueRippleParameters>,
        gear_ratio: f64,
        torque_limit: f64,
    ) -> Self {
        let periods = |count: u32| f64::from(count) * gear_ratio;
        Self {
            cogging: cogging.map_or((0.0, 0.0), |c| {
                (c.amplitude_of_limit.get() * torque_limit, periods(c.periods_per_motor_turn.get()))
            }),
            ripple: ripple
                .map_or((0.0, 0.0), |r| (r.amplitude.get(), periods(r.periods_per_motor_turn.get()))),
        }
    }

    /// Returns the torque of the motor (Nm, N) whose current stands for `torque` (Nm, N), at the position `q` of the rotor
    /// (rad, m, at the joint).
    #[must_use]
    pub fn torque(&self, torque: f64, q: f64) -> f64 {
        let Self { cogging: (cogging, per_cogging), ripple: (ripple, per_ripple) } = *self;
        if cogging == 0.0 && ripple == 0.0 {
            return torque;
        }
        torque * (1.0 + ripple * (per_ripple * q).sin()) + cogging * (per_cogging * q).sin()
    }
}

/// Motor with a first-order lag, integrated exactly: the mean torque of each step acts on the arm.
#[derive(Clone, Debug)]
pub struct Motor {
    torque: f64,
    /// exp(−ω dt), and the mean of exp(−ω t) over a step.
    decay: f64,
    mean_decay: f64,
}

impl Motor {
    /// Returns a motor that initially produces `torque` (Nm), with steps of `dt` (s) and a lag of bandwidth
    /// `bandwidth_hz` (Hz); no lag if `None`.
    #[must_use]
    pub fn new(bandwidth_hz: Option<f64>, dt: f64, torque: f64) -> Self {
        let (decay, mean_decay) = match bandwidth_hz {
            None => (0.0, 0.0),
            Some(hz) => {
                let x = TAU * hz * dt;
                ((-x).exp(), (1.0 - (-x).exp()) / x)
            }
        };
        Self { torque, decay, mean_decay }
    }

    /// Returns the mean torque (Nm) over a step with the commanded torque `asked` (Nm).
    pub fn step(&mut self, asked: f64) -> f64 {
        let gap = self.torque - asked;
        self.torque = asked + gap * self.decay;
        asked + gap * self.mean_decay
    }
}

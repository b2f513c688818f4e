//! Current loop of a motor: the torque follows the command as a first-order lag.

use std::f64::consts::TAU;

/// Motor, exact over each step: the mean torque of the step moves the arm.
#[derive(Clone, Debug)]
pub struct Motor {
    torque: f64,
    /// exp(−ω dt), and the mean of exp(−ω t) over a step.
    decay: f64,
    mean_decay: f64,
}

impl Motor {
    /// Returns a motor that produces `torque` (Nm); `bandwidth_hz` `None` is without lag; steps of `dt` (s).
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

    /// Returns the mean torque (Nm) of a step during which `asked` (Nm) is commanded.
    pub fn step(&mut self, asked: f64) -> f64 {
        let gap = self.torque - asked;
        self.torque = asked + gap * self.decay;
        asked + gap * self.mean_decay
    }
}

//! Current loop of a motor: the torque follows the command as a first-order lag.

use std::f64::consts::TAU;

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

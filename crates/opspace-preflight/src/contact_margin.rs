//! Phase margin of a force axis in contact, for commands that act so late that the controller predicts the state.
//!
//! The model is the mass m on a surface of stiffness K and damping B, pressed by the force axis with the gain k, the integral gain i
//! and the damping c. An acceleration that the axis demands acts after the delay D, and is held for the period T:
//!
//! ```text
//! P(s) = exp(−s D) Z(T)/(s² + W)       W = (K + B s)/m       Z(T) = (1 − exp(−s T))/(s T)
//! ```
//!
//! The damping acts on the velocity at the time D later, which the [controller predicts](opspace_control::Prediction) from the
//! measured one, from the forces of the surface, assumed constant, through a low-pass filter G with the time constant D, and from the
//! commands until then. With the force filter F and the velocity estimate V, z = exp(s T),
//!
//! ```text
//! L(s) = c M₁ + P [c (V − D G W) + (k + i/s) F W]        M₁ = Σ_j (t_j − t_{j−1}) z^(−j)        t_j = min(j T, D)
//! ```
//!
//! L is opened at the controller's output, and has no unstable poles. Other axes, friction, the bandwidth of the sensor, and errors of
//! the transformer are not included.

use super::phase_margin::{Margin, filtered_difference, hold, nyquist_margin, of_commands_until};
use super::surfaces::Surface;
use nalgebra::Complex;

/// Gains of a force axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ForceGains {
    /// Gain k of the force error.
    pub(super) gain: f64,
    /// Integral gain i, 1/s.
    pub(super) integral_per_s: f64,
    /// Damping c, 1/s.
    pub(super) damping_per_s: f64,
}

impl ForceGains {
    /// Returns an eighth of gain and integral with the same damping. In simulations this ends oscillations that the damping bears;
    /// less damping made them worse.
    pub(super) fn reduced(self) -> Self {
        Self { gain: self.gain / 8.0, integral_per_s: self.integral_per_s / 8.0, ..self }
    }
}

/// Force axis in contact.
#[derive(Clone, Copy, Debug)]
pub(super) struct ContactLoop {
    /// Mass that the surface moves, kg.
    pub(super) mass: f64,
    pub(super) surface: Surface,
    /// Interface period T and delay D of the commands, s.
    pub(super) period_s: f64,
    pub(super) delay_s: f64,
    /// Cutoff frequencies of the force filter and of the velocity estimate, Hz.
    pub(super) filter_hz: f64,
    pub(super) velocity_filter_hz: f64,
}

impl ContactLoop {
    /// Smallest phase margin; `None` if the gain of the loop is below 1 everywhere.
    pub(super) fn margin(&self, gains: &ForceGains) -> Option<Margin> {
        // Far below the slowest motion: that of the integral, or of a mass that the damping slows down.
        let slowest = (self.surface.stiffness / self.mass).sqrt().min(gains.integral_per_s.max(0.1));
        nyquist_margin(1e-3 * slowest, self.period_s, |omega| self.open_loop(gains, omega))
    }

    /// Open-loop transfer function at an angular frequency, rad/s.
    fn open_loop(&self, gains: &ForceGains, omega: f64) -> Complex<f64> {
        let s = Complex::new(0.0, omega);
        let back = (-s * self.period_s).exp();
        let low_pass = |share: f64| share / (1.0 - (1.0 - share) * back);
        let share = |rate_per_s: f64| 1.0 - (-rate_per_s * self.period_s).exp();
        let wall = (self.surface.damping * s + self.surface.stiffness) / self.mass;
        let filter = low_pass(share(std::f64::consts::TAU * self.filter_hz));
        let predicted = low_pass(share(1.0 / self.delay_s));
        let velocity = filtered_difference(s, self.period_s, self.velocity_filter_hz);
        let plant = (-s * self.delay_s).exp() * hold(s, self.period_s) / (s * s + wall);
        let of_velocity = gains.damping_per_s * (velocity - self.delay_s * predicted * wall);
        let of_force = (gains.gain + gains.integral_per_s / s) * filter * wall;
        let [of_commands, _] = of_commands_until(self.delay_s, self.period_s, back);
        gains.damping_per_s * of_commands + plant * (of_velocity + of_force)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// Largest error of the force in the last quarter of a simulation, relative to that of the first one, cycle by cycle. The mass
    /// presses with 1 N at rest; then its target rises by 1 %.
    fn simulated(contact: &ContactLoop, gains: &ForceGains, duration_s: f64) -> f64 {
        const STEPS: usize = 40;
        let &ContactLoop { mass, surface, period_s, delay_s, .. } = contact;
        let step_s = period_s / STEPS as f64;
        let late = (delay_s / step_s).round() as usize;
        let share = |rate_per_s: f64| 1.0 - (-rate_per_s * period_s).exp();
        let shares = [TAU * contact.filter_hz, TAU * contact.velocity_filter_hz, 1.0 / delay_s].map(share);
        let target = 1.01;
        let (mut x, mut v, mut last) = (1.0 / surface.stiffness, 0.0, 1.0 / surface.stiffness);
        let (mut force, mut velocity, mut external, mut integral) = (1.0, 0.0, 1.0, 0.0);
        // The command of each cycle, N.
        let mut sent: Vec<f64> = Vec::new();
        let (mut first, mut end) = (0.0_f64, 0.0_f64);
        let steps = (duration_s / step_s) as usize;
        for step in 0..steps {
            let acting =
                |sent: &[f64], step: usize| step.checked_sub(late).map_or(1.0, |since| sent[since / STEPS]);
            if step % STEPS == 0 {
                let sensed = surface.stiffness * x + surface.damping * v;
                force += shares[0] * (sensed - force);
                velocity += shares[1] * ((x - last) / period_s - velocity);
                external += shares[2] * (sensed - external);
                last = x;
                let commanded = (step..step + late).map(|later| {
                    let within = later.checked_sub(late).map_or(1.0, |since| sent[since / STEPS]);
                    step_s * (within - external) / mass
                });
                let predicted = velocity + commanded.sum::<f64>();
                integral += gains.integral_per_s * period_s * (target - force);
                let feedback = target + gains.gain * (target - force) + integral;
                sent.push(feedback - gains.damping_per_s * mass * predicted);
            }
            let wall = surface.stiffness * x + surface.damping * v;
            v += step_s * (acting(&sent, step) - wall) / mass;
            x += step_s * v;
            let error = (surface.stiffness * x - target).abs();
            match 4 * step / steps {
                0 => first = first.max(error),
                3 => end = end.max(error),
                _ => {}
            }
            if error > 1e6 {
                return f64::INFINITY;
            }
        }
        end / first
    }

    /// Compared: the sign of the margin, and the behaviour of the sampled loop. Between −5° and 10° they may disagree: the formula
    /// ignores all dynamics above half the sampling rate.
    #[test]
    fn phase_margin_predicts_stability_of_contact() {
        let (mut stable, mut unstable) = (0, 0);
        for (period_s, cycles) in [(1e-3, 15), (2e-3, 10), (2e-3, 20), (5e-3, 4), (5e-3, 8)] {
            for (mass, stiffness) in [1.0, 5.0].into_iter().flat_map(|m| [1e3, 3e3, 1e4, 3e4].map(|k| (m, k)))
            {
                for (gain, damping_per_s) in
                    [0.1, 0.4, 1.0].into_iter().flat_map(|k| [120.0, 40.0, 10.0].map(|c| (k, c)))
                {
                    let contact = ContactLoop {
                        mass,
                        surface: Surface { stiffness, damping: 50.0 },
                        period_s,
                        delay_s: f64::from(cycles) * period_s,
                        filter_hz: 100.0,
                        velocity_filter_hz: 80.0,
                    };
                    let gains = ForceGains { gain, integral_per_s: 20.0 * gain, damping_per_s };
                    let margin = contact.margin(&gains).map_or(180.0, |margin| margin.degrees);
                    let left = simulated(&contact, &gains, 2.0);
                    if margin < -5.0 {
                        unstable += 1;
                        assert!(left > 1.0, "{margin:.1}° and {left} left: {contact:?} {gains:?}");
                    } else if margin > 10.0 {
                        stable += 1;
                        assert!(left < 1.0, "{margin:.1}° and {left} left: {contact:?} {gains:?}");
                    }
                }
            }
        }
        assert!(stable > 50 && unstable > 50, "both are tried: {stable} and {unstable}");
    }
}

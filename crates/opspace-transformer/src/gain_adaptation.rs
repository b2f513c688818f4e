//! Adaptation of a servo's gains during a run: recursive least squares on measured motor torque.
//!
//! A servo of stiffness K and damping D produces, over an interface interval, the mean torque
//!
//! ```text
//! τ̄ = K ē − D w̄ = a x₁ − b x₂        x₁ = K₀ ē, x₂ = D₀ w̄
//! ```
//!
//! with e the position error and w the servo's velocity, both emulated. a and b are the ratios of the gains to the
//! nominal gains K₀ and D₀. They follow a slow random walk, are bounded, and stay constant without excitation.
//!
//! A servo that feeds the fraction f of the setpoint's velocity v forward has w − f v in place of w. A fraction that differs
//! from the nominal one f₀ adds c x₃, with x₃ = f₀ D₀ v̄; c is estimated too, from 0.

use nalgebra::{Matrix3, Vector3};
use opspace_backend::quantity::Positive;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::f64::consts::PI;

/// Rms error of a mean torque that the model doesn't explain, as a fraction of the torque limit.
const NOISE: f64 = 0.01;

/// Initial relative rms uncertainty of the gains.
const UNCERTAIN: f64 = 0.1;

/// Adaptation of servo gains during a run.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct GainAdaptationParameters {
    /// Time over which the gains may change by a tenth, s. Older measurements count less.
    pub time_s: Positive,
    /// Largest relative deviation of the gains from the nominal ones, between 0 and 1.
    pub max_relative_change: Share,
}

impl GainAdaptationParameters {
    /// Returns the parameters of transformers that always adapt gains: a time of 2 s, and changes of up to a half.
    #[must_use]
    pub const fn usual() -> Self {
        Self { time_s: Positive::literal(2.0), max_relative_change: Share(0.5) }
    }
}

/// Fraction above 0 and below 1.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(extend("exclusiveMinimum" = 0, "exclusiveMaximum" = 1)))]
#[serde(try_from = "f64")]
pub struct Share(f64);

impl TryFrom<f64> for Share {
    type Error = String;

    fn try_from(value: f64) -> Result<Self, String> {
        if value > 0.0 && value < 1.0 {
            Ok(Self(value))
        } else {
            Err(format!("expected a fraction above 0 and below 1, got {value}"))
        }
    }
}

/// Estimator of the ratios of true to nominal stiffness and damping of one joint's servo, and of its feed-forward.
#[derive(Clone, Copy, Debug)]
pub struct GainAdaptation {
    /// Estimates of a, −b and c.
    scales: Vector3<f64>,
    covariance: Matrix3<f64>,
    /// Number of estimates: without feed-forward, c remains 0.
    estimated: usize,
    wander: f64,
    max_relative_change: f64,
    noise: f64,
}

impl GainAdaptation {
    /// Returns the adaptation for a drive without feed-forward, with this torque limit (Nm, N), measured every `period_s`
    /// (s).
    #[must_use]
    pub fn new(parameters: &GainAdaptationParameters, torque_limit: f64, period_s: f64) -> Self {
        let uncertain = UNCERTAIN * UNCERTAIN;
        Self {
            scales: Vector3::new(1.0, -1.0, 0.0),
            covariance: Matrix3::from_diagonal(&Vector3::new(uncertain, uncertain, 0.0)),
            estimated: 2,
            wander: uncertain * period_s / parameters.time_s.get(),
            max_relative_change: parameters.max_relative_change.0,
            noise: (NOISE * torque_limit).powi(2),
        }
    }

    /// Returns the adaptation of a drive that feeds velocity forward: c is estimated too.
    #[must_use]
    pub fn with_feed_forward(self) -> Self {
        let mut covariance = self.covariance;
        covariance[(2, 2)] = UNCERTAIN * UNCERTAIN;
        Self { covariance, estimated: 3, ..self }
    }

    /// Returns the adaptation for torques that are low-passed at `cutoff_hz` (Hz): successive ones are nearly equal, so that
    /// each counts less.
    #[must_use]
    pub fn of_filtered(
        parameters: &GainAdaptationParameters,
        torque_limit: f64,
        period_s: f64,
        cutoff_hz: f64,
    ) -> Self {
        let adaptation = Self::new(parameters, torque_limit, period_s);
        let samples = (1.0 / (PI * cutoff_hz * period_s)).max(1.0);
        Self { noise: adaptation.noise * samples, ..adaptation }
    }

    /// Rms error (Nm, N) of the torque of x₁, x₂ and x₃ that is due to the uncertainty of the scales.
    #[must_use]
    pub fn uncertainty(&self, regressors: [f64; 3]) -> f64 {
        let x = Vector3::from(regressors);
        x.dot(&(self.covariance * x)).max(0.0).sqrt()
    }

    /// Updates the estimates with the measured mean torque and with x₁, x₂ and x₃ (Nm, N); x₃ is 0 without feed-forward.
    /// Returns the scales a and b of stiffness and damping, and c.
    pub fn update(&mut self, measured: f64, regressors: [f64; 3]) -> [f64; 3] {
        let x = Vector3::from(regressors);
        let p = self.covariance * x;
        let gain = p / (self.noise + x.dot(&p));
        self.scales += gain * (measured - x.dot(&self.scales));
        for (scale, nominal) in self.scales.iter_mut().zip([1.0, -1.0, 0.0]) {
            *scale = scale.clamp(nominal - self.max_relative_change, nominal + self.max_relative_change);
        }
        self.covariance -= gain * p.transpose();
        // Without excitation the uncertainty grows up to its initial value.
        for i in 0..self.estimated {
            if self.covariance[(i, i)] < UNCERTAIN * UNCERTAIN {
                self.covariance[(i, i)] += self.wander;
            }
        }
        [self.scales.x, -self.scales.y, self.scales.z]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Error of the estimated gains caused by the random-walk model.
    const FOUND: f64 = 1e-3;

    fn adaptation(within: f64) -> GainAdaptation {
        let parameters = GainAdaptationParameters {
            time_s: Positive::literal(1.0),
            max_relative_change: Share::try_from(within).expect("a share"),
        };
        GainAdaptation::new(&parameters, 40.0, 1e-3)
    }

    /// Checks the scales estimated from torques of a servo with other gains than the nominal ones.
    #[test]
    fn gains_are_estimated_from_torques() {
        let mut adaptation = adaptation(0.5);
        let mut found = [0.0; 3];
        for k in 0..5000 {
            let t = f64::from(k) * 1e-3;
            let (x1, x2) = (30.0 * (3.0 * t).sin(), 20.0 * (5.0 * t).cos());
            found = adaptation.update(0.8 * x1 - 1.2 * x2, [x1, x2, 0.0]);
        }
        assert!((found[0] - 0.8).abs() < FOUND && (found[1] - 1.2).abs() < FOUND, "{found:?}");
        assert_eq!(found[2], 0.0);
    }

    /// Checks the scales of a servo with other gains and another feed-forward than the nominal ones; also while the setpoint
    /// has the servo's velocity, when only the sum of damping and feed-forward matters.
    #[test]
    fn feed_forward_is_estimated_from_torques() {
        let mut adaptation = adaptation(0.5).with_feed_forward();
        let mut found = [0.0; 3];
        for k in 0..5000 {
            let t = f64::from(k) * 1e-3;
            let (x1, x2, x3) = (30.0 * (3.0 * t).sin(), 20.0 * (5.0 * t).cos(), 25.0 * (4.0 * t).sin());
            found = adaptation.update(0.8 * x1 - 1.2 * x2 + 0.1 * x3, [x1, x2, x3]);
        }
        assert!(found.iter().zip([0.8, 1.2, 0.1]).all(|(found, of)| (found - of).abs() < FOUND), "{found:?}");
        let mut together = self::adaptation(0.5).with_feed_forward();
        for k in 0..5000 {
            let x = 25.0 * (4e-3 * f64::from(k)).sin();
            found = together.update(-0.9 * x, [0.0, x, x]);
        }
        assert!((found[1] - found[2] - 0.9).abs() < FOUND, "{found:?}");
    }

    /// Checks the scales of a servo whose deviation exceeds the bound, and of a servo without excitation.
    #[test]
    fn gain_scales_are_bounded_and_constant_at_rest() {
        let mut bounded = adaptation(0.3);
        let found = (0..5000).map(|k| {
            let x = 30.0 * (3e-3 * f64::from(k)).sin();
            bounded.update(2.0 * x, [x, 0.0, 0.0])
        });
        assert_eq!(found.last().expect("some")[0], 1.3);
        let mut still = adaptation(0.3);
        assert_eq!((0..5000).map(|_| still.update(0.5, [0.0; 3])).last(), Some([1.0, 1.0, 0.0]));
    }
}

//! Compliance of what a robot touches, from its force and its position.
//!
//! ```text
//! d = F/|F|      ΔF = d·(F − F̄)      Δx = d·(x − x̄)      c = −⟨ΔF Δx⟩ / (⟨ΔF²⟩ + F₀²)
//! ```
//!
//! F is the force on the robot, x its position. The bars are means over 0.5 s, so that the place of the surface need not be known; the
//! brackets are means over 3 s of contact. F₀ makes the estimate zero, which is a rigid surface, until the force has varied by more
//! than that. Noise of the force has the same effect.

use nalgebra::Vector6;

/// Force at which contact begins, and below which it is lost, N or Nm.
const BEGINS_N: f64 = 2.0;
const LOST_N: f64 = 1.0;

/// Time of the means of force and position, and of their products, s.
const MEAN_S: f64 = 0.5;
const MEMORY_S: f64 = 3.0;

/// Variation F₀ of the force from which on the estimate counts, N or Nm.
const VARIATION_N: f64 = 0.5;

/// Estimate of the compliance along the force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactCompliance {
    /// Shares of a new value in the means of values, and of products.
    share: f64,
    product_share: f64,
    touches: bool,
    force: Vector6<f64>,
    position: Vector6<f64>,
    /// −⟨ΔF Δx⟩ and ⟨ΔF²⟩.
    covariance: f64,
    variance: f64,
}

impl ContactCompliance {
    /// Returns an estimate without contact, for the period (s, above zero).
    #[must_use]
    pub fn new(period_s: f64) -> Self {
        let zero = Vector6::zeros();
        let [share, product_share] = [MEAN_S, MEMORY_S].map(|time_s| period_s / (time_s + period_s));
        Self {
            share,
            product_share,
            touches: false,
            force: zero,
            position: zero,
            covariance: 0.0,
            variance: 0.0,
        }
    }

    /// Forgets everything.
    pub fn restart(&mut self) {
        self.touches = false;
        (self.covariance, self.variance) = (0.0, 0.0);
    }

    /// Notes the force on the robot (N, Nm) and its position (m, rad) of a cycle; not finite ones are passed over.
    pub fn update(&mut self, force: &Vector6<f64>, position: &Vector6<f64>) {
        let magnitude = force.norm();
        if !magnitude.is_finite() || !position.iter().all(|x| x.is_finite()) {
            return;
        }
        if magnitude < LOST_N {
            self.restart();
        }
        if !self.touches {
            self.touches = magnitude > BEGINS_N;
            (self.force, self.position) = (*force, *position);
            return;
        }
        let direction = force / magnitude;
        let varied = direction.dot(&(force - self.force));
        let moved = direction.dot(&(position - self.position));
        self.covariance += self.product_share * (-varied * moved - self.covariance);
        self.variance += self.product_share * (varied * varied - self.variance);
        self.force += (force - self.force) * self.share;
        self.position += (position - self.position) * self.share;
    }

    /// Compliance, m/N or rad/Nm; zero if nothing is known.
    #[must_use]
    pub fn get(&self) -> f64 {
        (self.covariance / (self.variance + VARIATION_N * VARIATION_N)).max(0.0)
    }
}

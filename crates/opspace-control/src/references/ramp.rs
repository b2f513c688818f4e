//! The minimum-jerk ramp, the product rule that applies it to a reference, and the quintic polynomial from any state.
//!
//! ```text
//! s = 10u³ − 15u⁴ + 6u⁵        u = t/T        (s x)˙ = ṡ x + s ẋ        x = Σ_k c_k t^k, k = 0 … 5
//! ```
//!
//! A quantity and its first two time derivatives are stored as `[x, ẋ, ẍ]`.

/// Minimum-jerk ramp s = 10u³ − 15u⁴ + 6u⁵ with u = t/duration, and its derivatives (1/s, 1/s²): from 0 to 1, with zero
/// velocity and acceleration at both ends. `t` and `duration` in s.
#[must_use]
pub fn minimum_jerk(t: f64, duration: f64) -> [f64; 3] {
    if t <= 0.0 {
        return [0.0; 3];
    }
    if t >= duration {
        return [1.0, 0.0, 0.0];
    }
    let u = t / duration;
    [
        u * u * u * (10.0 + u * (-15.0 + 6.0 * u)),
        30.0 * u * u * (1.0 - u) * (1.0 - u) / duration,
        60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / (duration * duration),
    ]
}

/// Returns a b, (a b)˙ and (a b)¨.
#[must_use]
pub fn product(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] * b[0], a[1] * b[0] + a[0] * b[1], a[2] * b[0] + 2.0 * a[1] * b[1] + a[0] * b[2]]
}

/// Quintic polynomial between two states.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Quintic {
    /// Coefficients of t⁰ to t⁵.
    pub coefficients: [f64; 6],
}

impl Quintic {
    /// Creates the polynomial from `from` (position, velocity, acceleration) to rest at `goal` in `duration` (s).
    pub(crate) fn new(from: [f64; 3], goal: f64, duration: f64) -> Self {
        Self::between(from, [goal, 0.0, 0.0], duration)
    }

    /// Creates the polynomial from the state `from` to the state `to` in `duration` (s).
    pub(crate) fn between(from: [f64; 3], to: [f64; 3], duration: f64) -> Self {
        let [x, v, a] = from;
        let t = duration;
        // In u = t/duration: the distance, velocity and acceleration that remain if the initial state is extrapolated
        // to the end.
        let way = to[0] - x - v * t - 0.5 * a * t * t;
        let speed = (to[1] - (v + a * t)) * t;
        let bend = (to[2] - a) * t * t;
        let c3 = 10.0 * way - 4.0 * speed + 0.5 * bend;
        let c4 = -15.0 * way + 7.0 * speed - bend;
        let c5 = 6.0 * way - 3.0 * speed + 0.5 * bend;
        let cubed = t * t * t;
        Self { coefficients: [x, v, 0.5 * a, c3 / cubed, c4 / (cubed * t), c5 / (cubed * t * t)] }
    }

    /// Position, velocity and acceleration at `t` (s) after the start.
    pub(crate) fn at(&self, t: f64) -> [f64; 3] {
        let [c0, c1, c2, c3, c4, c5] = self.coefficients;
        [
            c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))),
            c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5))),
            2.0 * c2 + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5)),
        ]
    }
    /// The polynomial in t/`scale`.
    pub(crate) fn stretched(&self, scale: f64) -> Self {
        let mut power = 1.0;
        let coefficients = self.coefficients.map(|coefficient| {
            let stretched = coefficient * power;
            power *= scale;
            stretched
        });
        Self { coefficients }
    }

    /// Third derivative at `t` (s) after the start.
    pub(crate) fn jerk(&self, t: f64) -> f64 {
        let [_, _, _, c3, c4, c5] = self.coefficients;
        6.0 * c3 + t * (24.0 * c4 + t * 60.0 * c5)
    }
}

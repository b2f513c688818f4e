//! The minimum-jerk ramp, and the product rule that brings it into a reference.
//!
//! A quantity and its first and second time derivative stand together as `[x, ẋ, ẍ]`.

/// s = 10u³ − 15u⁴ + 6u⁵ with u = t/duration, and its derivatives (1/s, 1/s²): from 0 to 1, at rest and
/// without acceleration at both ends.
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

/// a b, (a b)˙, (a b)¨.
#[must_use]
pub fn product(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] * b[0], a[1] * b[0] + a[0] * b[1], a[2] * b[0] + 2.0 * a[1] * b[1] + a[0] * b[2]]
}

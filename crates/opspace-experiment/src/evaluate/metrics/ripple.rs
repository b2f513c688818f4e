//! Torque ripple of a servo that is caused by a held setpoint; no transformer can remove it.
//!
//! A servo with position stiffness k = kv kp that moves at speed v while the setpoint is held for R servo ticks
//! produces, in addition to the mean torque of the interval, the torque
//!
//! ```text
//! e_j = −k v T_s (j − (R−1)/2)        j = 0 .. R−1        rms  k |v| T_s √((R²−1)/12)
//! ```
//!
//! The current loop of the motor, a first-order lag with cutoff frequency f_c, changes it to x_{j+1} = e_j + ρ (x_j −
//! e_j) with ρ = exp(−2π f_c T_s). Its mean over a servo period is m_j = e_j + μ (x_j − e_j) with μ = (1 − ρ)/(2π f_c
//! T_s). The solution with period R is
//!
//! ```text
//! m_j = −k v T_s [j − (R−1)/2 − 1/(2π f_c T_s) + R μ ρʲ/(1 − ρᴿ)]
//! ```

use std::f64::consts::TAU;

/// Rms of the ripple over servo periods per stiffness (Nm/rad) and speed (rad/s), s: the rms of the bracket times T_s.
/// Without `current_loop_hz` the motor has no lag.
pub(super) fn of_held_setpoint(ratio: u32, servo_period_s: f64, current_loop_hz: Option<f64>) -> f64 {
    let (ticks, middle) = (f64::from(ratio), 0.5 * f64::from(ratio - 1));
    let lag = |tick: f64| {
        current_loop_hz.map_or(0.0, |hz| {
            let x = TAU * hz * servo_period_s;
            let (rho, all) = ((-x).exp(), -(-x * ticks).exp_m1());
            (ticks * (1.0 - rho) * (-x * tick).exp() / all - 1.0) / x
        })
    };
    let squares = (0..ratio).map(f64::from).map(|tick| (tick - middle + lag(tick)).powi(2));
    servo_period_s * (squares.sum::<f64>() / ticks).sqrt()
}

#[cfg(test)]
mod tests {
    use super::of_held_setpoint;
    use opspace_sim::motor::Motor;

    const SERVO_PERIOD_S: f64 = 2e-4;

    /// Compared: the closed form, and the motor of the simulation with ten steps per servo period, after its initial
    /// transient.
    #[test]
    fn current_loop_smooths_ripple() {
        const ROUNDING: f64 = 1e-12;
        for (ratio, hz) in [(2, 1000.0), (5, 1000.0), (5, 200.0), (10, 3000.0)] {
            let mut motor = Motor::new(Some(hz), SERVO_PERIOD_S / 10.0, 0.0);
            let mut rms = 0.0;
            for _ in 0..1000 {
                let asked = (0..ratio).map(|tick| f64::from(tick) - 0.5 * f64::from(ratio - 1));
                let means = asked.map(|asked| (0..10).map(|_| motor.step(asked)).sum::<f64>() / 10.0);
                rms = (means.map(|mean| mean * mean).sum::<f64>() / f64::from(ratio)).sqrt();
            }
            let ripple = of_held_setpoint(ratio, SERVO_PERIOD_S, Some(hz)) / SERVO_PERIOD_S;
            assert!((ripple - rms).abs() < ROUNDING, "{ratio} {hz}: {ripple} for {rms}");
        }
    }

    /// Compared: the closed form without a current loop, and the rms of R equidistant numbers; zero at R = 1.
    #[test]
    fn ripple_without_current_loop_is_sawtooth() {
        const ROUNDING: f64 = 1e-15;
        for ratio in [2_u32, 5, 10] {
            let sawtooth = SERVO_PERIOD_S * ((f64::from(ratio).powi(2) - 1.0) / 12.0).sqrt();
            assert!((of_held_setpoint(ratio, SERVO_PERIOD_S, None) - sawtooth).abs() < ROUNDING);
        }
        assert!(of_held_setpoint(1, SERVO_PERIOD_S, Some(1000.0)) < ROUNDING);
    }
}

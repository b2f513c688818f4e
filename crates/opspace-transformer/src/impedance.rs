//! Mechanical impedance of a drive with its transformer, as the joint feels it at a desired torque that is constant.
//!
//! A joint whose position oscillates with the angular frequency ω feels the torque −Z(iω) q̇ of its drive. If the real part
//! of Z is not negative at any frequency up to half the interface rate, the drive with its transformer is passive: it
//! cannot make any joint oscillate that is passive itself, whatever inertia, gear and contact it has (Colgate and Hogan,
//! *Robust control of dynamically interacting systems*, Int. J. Control 48(1), 1988). Viscous friction of the joint adds to
//! the real part.
//!
//! The impedance is measured: the transformer and the drive's law run with a sampled sine as the motor's position. It
//! includes everything that the transformer does, also the correction by current.

use crate::drive_timing::DriveTiming;
use crate::moving_joint::{MovingJoint, SampledDrive};
use crate::servo_law::ServoLaw;
use nalgebra::Complex;
use std::f64::consts::TAU;

/// Amplitude of the motion with which an impedance is measured, rad (m).
const AMPLITUDE: f64 = 1e-2;

/// Time until the transformer has settled, s.
const SETTLING_S: f64 = 0.6;

/// Time over which an impedance is measured, s.
const MEASURING_S: f64 = 0.5;

/// Returns the impedance Z (Nms/rad, Ns/m) of a joint's drive with its transformer, at frequencies (Hz) near the desired
/// ones that fit into the time of measurement: pairs of frequency and Z. `law` is the true law of the drive.
pub fn impedance<'a>(
    mut arm: impl FnMut() -> MovingJoint<'a>,
    law: ServoLaw,
    timing: DriveTiming,
    frequencies_hz: &[f64],
) -> Vec<(f64, Complex<f64>)> {
    frequencies_hz.iter().map(|hz| impedance_near(&mut arm(), law, timing, *hz)).collect()
}

/// Returns the frequency next to `hz` (Hz) that fits into the time of measurement, and the [`impedance`] there
/// (Nms/rad, Ns/m).
pub fn impedance_near(
    arm: &mut MovingJoint<'_>,
    law: ServoLaw,
    timing: DriveTiming,
    hz: f64,
) -> (f64, Complex<f64>) {
    let cycles = (MEASURING_S / timing.period_s()).round().max(8.0);
    let periods = (hz * cycles * timing.period_s()).round().clamp(1.0, 0.5 * cycles - 1.0);
    let hz = periods / (cycles * timing.period_s());
    (hz, impedance_at(arm, law, timing, cycles as u64, hz))
}

fn impedance_at(
    arm: &mut MovingJoint<'_>,
    law: ServoLaw,
    timing: DriveTiming,
    cycles: u64,
    hz: f64,
) -> Complex<f64> {
    let start = arm.position();
    let mut drive = SampledDrive::new(law, timing, start, arm.holding_torque());
    let settling = (SETTLING_S / timing.period_s()).ceil() as u64;
    let ratio = u64::from(timing.servo_ticks_per_cycle);
    let mut mean_torque = arm.holding_torque();
    let mut torque = Complex::ZERO;
    for cycle in 0..settling + cycles {
        let phase = |tick: u64| TAU * hz * timing.servo_period_s * (cycle * ratio + tick) as f64;
        let position = |tick: u64| start + AMPLITUDE * phase(tick).sin();
        let setpoint = arm.cycle(position(0), mean_torque, |_| 0.0);
        for tick in 0..ratio {
            let now = drive.step(setpoint, position(tick));
            if cycle >= settling {
                // The torque acts for a servo period, in the middle of which it counts.
                let middle = phase(tick) + 0.5 * TAU * hz * timing.servo_period_s;
                torque += now * Complex::from_polar(1.0, -middle);
            }
        }
        mean_torque = drive.end_cycle(setpoint);
    }
    // q = A sin(ωt) is −iA exp(iωt), and q̇ is ωA exp(iωt).
    let torque = torque * 2.0 / (cycles * ratio) as f64;
    -torque / (TAU * hz * AMPLITUDE)
}

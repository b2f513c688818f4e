//! Stability check of a servo's inverse: the setpoints for desired torques must be bounded.

use crate::drive_timing::DriveTiming;
use crate::polynomial::MAX_ITERATIONS;
use crate::servo_law::{MAX_ORDER, ServoError, ServoLaw, ServoState};
use nalgebra::{Complex, DMatrix, Schur};
use opspace_backend::CommandKind;
use thiserror::Error;

/// Largest spectral radius of the inverse, per interface cycle, that counts as stable.
const LARGEST_GROWTH: f64 = 1.0 - 1e-6;

/// Least response of quiet setpoints, relative to the static one.
const LEAST_RESPONSE: f64 = 0.2;

/// Largest oscillation of quiet setpoints from cycle to cycle.
const LARGEST_OSCILLATION: f64 = 0.5;

/// Torques of an interval that match the desired torque.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum TorqueObjective {
    /// Mean torque of the interval.
    IntervalMean,
    /// Torque of each servo tick, in the least-squares sense.
    PerTick,
}

/// Reason why a servo cannot be emulated or inverted.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum EmulationError {
    /// Invalid servo.
    #[error(transparent)]
    Servo(#[from] ServoError),
    /// Position and velocity servos on one robot.
    #[error("it accepts {} setpoints, but the servos of the joints before it accept {} setpoints", takes.name(), others.name())]
    Mixed {
        /// Quantity of this servo's setpoints.
        takes: CommandKind,
        /// Quantity of the others' setpoints.
        others: CommandKind,
    },
    /// Servo that produces no torque before the next setpoint acts.
    #[error("a setpoint produces no torque during the {ratio} servo ticks for which it acts")]
    NoTorque {
        /// Servo ticks per interface cycle.
        ratio: u32,
    },
    /// Unstable inverse: the setpoints for desired torques would grow without bound.
    #[error(
        "its inverse is unstable: setpoints for a torque would grow by a factor of {growth:.3} per cycle (zeros \
         outside the unit circle)"
    )]
    Unstable {
        /// Growth factor of the setpoints per interface cycle.
        growth: f64,
    },
}

/// Checks that the setpoints for a desired torque are bounded, for a joint that doesn't move.
pub(crate) fn check_inverse(
    law: &ServoLaw,
    ticks: DriveTiming,
    matching: TorqueObjective,
) -> Result<(), EmulationError> {
    let growth = inverse(law, ticks, matching, 1)?.growth;
    if growth > LARGEST_GROWTH { Err(EmulationError::Unstable { growth }) } else { Ok(()) }
}

/// Returns the least number of intervals over which a mean torque is matched with quiet setpoints: their response is at
/// least `LEAST_RESPONSE` times the static one, the `stiffness` (torque per unit of setpoint), and their oscillation from
/// cycle to cycle decays. If there is none up to `longest`, returns the largest number with bounded setpoints.
pub(crate) fn quiet_horizon(
    law: &ServoLaw,
    ticks: DriveTiming,
    stiffness: f64,
    longest: u32,
) -> Result<u32, EmulationError> {
    let mut bounded = Err(EmulationError::Unstable { growth: f64::INFINITY });
    for intervals in 1..=longest {
        let Inverse { growth, oscillation, response } =
            inverse(law, ticks, TorqueObjective::IntervalMean, intervals)?;
        if growth > LARGEST_GROWTH {
            continue;
        }
        if oscillation <= LARGEST_OSCILLATION && response >= LEAST_RESPONSE * stiffness {
            return Ok(intervals);
        }
        bounded = Ok(intervals);
    }
    bounded
}

/// Properties of the inverse of a servo.
struct Inverse {
    /// Growth of the setpoints per interface cycle.
    growth: f64,
    /// Growth of the setpoints that change sign from cycle to cycle.
    oscillation: f64,
    /// Mean torque per unit of setpoint over the matched intervals; only for that objective.
    response: f64,
}

/// Analyses the setpoints of which each matches the torques of the next `intervals`, for a joint that
/// doesn't move. The state is the servo's memory and the previous setpoint, or all previous setpoints that count in its
/// averages; each setpoint is chosen so that the torque is zero.
fn inverse(
    law: &ServoLaw,
    ticks: DriveTiming,
    matching: TorqueObjective,
    intervals: u32,
) -> Result<Inverse, EmulationError> {
    let ratio = ticks.servo_ticks_per_cycle;
    // Setpoints before these have left the averages; interpolation begins at the last one.
    let previous = 1 + law.average_ticks().div_ceil(ratio) as usize;
    // Torques after `before`, the previous setpoints from the latest on, and the servo's memory after them.
    let run = |memory: ServoState, before: &[f64], new: f64, intervals: u32| {
        let (mut memory, mut average) = (memory, law.setpoint_average());
        let mut from = 0.0;
        for &to in before.iter().rev() {
            (0..ratio).for_each(|tick| _ = average.step(ticks.setpoints.at(from, to, tick, ratio)));
            from = to;
        }
        let torques: Vec<f64> = (0..intervals * ratio)
            .map(|tick| {
                let setpoint = average.step(ticks.setpoints.at(before[0], new, tick, ratio));
                law.step(&mut memory, setpoint, 0.0)
            })
            .collect();
        (memory, torques)
    };
    let (_, unit) = run([0.0; MAX_ORDER], &vec![0.0; previous], 1.0, intervals);
    let weigh = |torques: &[f64]| -> f64 {
        match matching {
            TorqueObjective::IntervalMean => torques.iter().sum(),
            TorqueObjective::PerTick => torques.iter().zip(&unit).map(|(torque, unit)| torque * unit).sum(),
        }
    };
    let response = weigh(&unit);
    let largest = unit.iter().fold(0.0, |largest: f64, torque| largest.max(torque.abs()));
    if response.abs() <= f64::EPSILON * largest || largest == 0.0 {
        return Err(EmulationError::NoTorque { ratio });
    }
    // State: servo memory, then the previous setpoints.
    let order = law.order();
    let mut growth = DMatrix::zeros(order + previous, order + previous);
    for column in 0..order + previous {
        let (mut memory, mut before) = ([0.0; MAX_ORDER], vec![0.0; previous]);
        match column.checked_sub(order) {
            None => memory[column] = 1.0,
            Some(setpoint) => before[setpoint] = 1.0,
        }
        let (_, torques) = run(memory, &before, 0.0, intervals);
        let new = -weigh(&torques) / response;
        let (after, _) = run(memory, &before, new, 1);
        for (row, &value) in after[..order].iter().chain([&new]).chain(&before[..previous - 1]).enumerate() {
            growth[(row, column)] = value;
        }
    }
    let decomposed = Schur::try_new(growth, f64::EPSILON, MAX_ITERATIONS);
    // A matrix that is not finite grows without bound.
    let eigenvalues = decomposed.map(|decomposed| decomposed.complex_eigenvalues());
    let largest = |among: fn(&Complex<f64>) -> bool| {
        eigenvalues.as_ref().map_or(f64::INFINITY, |values| {
            values.iter().filter(|v| among(v)).map(|v| v.norm()).fold(0.0, f64::max)
        })
    };
    let all_ticks = f64::from(intervals * ticks.servo_ticks_per_cycle);
    Ok(Inverse {
        growth: largest(|_| true),
        oscillation: largest(|v| v.re < 0.0),
        response: response / all_ticks,
    })
}

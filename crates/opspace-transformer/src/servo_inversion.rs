//! Whether a servo can be inverted: whether set-points that give torques stay bounded.

use crate::servo_law::{MAX_ORDER, ServoError, ServoLaw, ServoMemory};
use nalgebra::DMatrix;
use opspace_backend::{CommandKind, Setpoints};
use thiserror::Error;

/// An inverse that grows by more than this from one interface tick to the next isn't used.
const LARGEST_GROWTH: f64 = 1.0 - 1e-6;

/// What of the torques under a set-point is to be as desired.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Matching {
    /// Their mean.
    Mean,
    /// Each, as well as can be.
    EachTick,
}

/// When a drive runs, and when its set-points act.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ticks {
    pub period_s: f64,
    pub ratio: u32,
    pub delay: u32,
    pub set_points: Setpoints,
}

/// A servo that can't be emulated, or not be inverted.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum EmulationError {
    /// It can't be run at all.
    #[error(transparent)]
    Servo(#[from] ServoError),
    /// Position and velocity servos on one robot.
    #[error("it takes {} setpoints, the servos before it take {}", takes.name(), others.name())]
    Mixed {
        /// Setpoints of this servo.
        takes: CommandKind,
        /// Setpoints of the others.
        others: CommandKind,
    },
    /// Torque comes later than the next set-point.
    #[error("a set-point makes no torque within the {ratio} servo ticks in which it acts")]
    NoTorque {
        /// Servo ticks per interface tick.
        ratio: u32,
    },
    /// Set-points that give the torques would grow without bound.
    #[error(
        "its inverse is unstable: set-points for a torque would grow {growth:.3} times from one to the next (zeros \
         outside the unit circle)"
    )]
    Unstable {
        /// From one interface tick to the next.
        growth: f64,
    },
}

/// Whether set-points that give a torque stay bounded, on a joint that is held: the growth of the servo's memory, and of
/// the set-point that an interpolating drive comes from, when each set-point is the one that gives none.
pub(crate) fn check_inverse(law: &ServoLaw, ticks: Ticks, matching: Matching) -> Result<(), EmulationError> {
    let run = |memory: ServoMemory, before: f64, new: f64| {
        let mut memory = memory;
        let torques: Vec<f64> = (0..ticks.ratio)
            .map(|tick| law.step(&mut memory, ticks.set_points.at(before, new, tick, ticks.ratio), 0.0))
            .collect();
        (memory, torques)
    };
    let (_, unit) = run([0.0; MAX_ORDER], 0.0, 1.0);
    let weigh = |torques: &[f64]| -> f64 {
        match matching {
            Matching::Mean => torques.iter().sum(),
            Matching::EachTick => torques.iter().zip(&unit).map(|(torque, unit)| torque * unit).sum(),
        }
    };
    let response = weigh(&unit);
    let largest = unit.iter().fold(0.0, |largest: f64, torque| largest.max(torque.abs()));
    if response.abs() <= f64::EPSILON * largest || largest == 0.0 {
        return Err(EmulationError::NoTorque { ratio: ticks.ratio });
    }
    // The memory, and the set-point before.
    let order = law.order();
    let mut growth = DMatrix::zeros(order + 1, order + 1);
    for column in 0..=order {
        let mut memory = [0.0; MAX_ORDER];
        let mut before = 0.0;
        *memory[..order].get_mut(column).unwrap_or(&mut before) = 1.0;
        let (_, torques) = run(memory, before, 0.0);
        let new = -weigh(&torques) / response;
        let (after, _) = run(memory, before, new);
        for (row, &value) in after[..order].iter().chain([&new]).enumerate() {
            growth[(row, column)] = value;
        }
    }
    let growth = growth.complex_eigenvalues().iter().map(|v| v.norm()).fold(0.0, f64::max);
    if growth > LARGEST_GROWTH { Err(EmulationError::Unstable { growth }) } else { Ok(()) }
}

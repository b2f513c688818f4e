//! Moving averages of a drive's setpoint, with which drives limit its acceleration and jerk.
//!
//! The mean of the setpoints of the last N servo ticks turns a step of the setpoint into a ramp of N ticks, and a step of its
//! velocity into a constant acceleration for N ticks. A second average after the first one limits the jerk likewise. Both
//! have a gain of 1 at rest, and a lag of (N − 1)/2 servo ticks each.
//!
//! They precede the [law](crate::servo_law) of the servo, whose setpoint is the averaged one.

use nalgebra::Complex;

/// Largest number of servo ticks of one average.
pub const MAX_TICKS: u32 = 2000;

/// Numbers of servo ticks of two successive averages, each at least 1; an average of one tick is none.
pub(crate) type AverageTicks = [u32; 2];

/// Setpoints of a drive that averages them, one per servo tick.
#[derive(Clone, Debug)]
pub struct SetpointAverage {
    stages: [Stage; 2],
}

/// One average: the last setpoints, in a ring.
#[derive(Clone, Debug)]
struct Stage {
    last: Vec<f64>,
    oldest: usize,
    sum: f64,
}

impl SetpointAverage {
    pub(crate) fn new(ticks: AverageTicks) -> Self {
        // An average of one tick needs no memory.
        let stage = |ticks: u32| {
            let length = if ticks > 1 { ticks as usize } else { 0 };
            Stage { last: vec![0.0; length], oldest: 0, sum: 0.0 }
        };
        Self { stages: ticks.map(stage) }
    }

    /// Advances by a servo tick with this setpoint, and returns the averaged one.
    pub fn step(&mut self, setpoint: f64) -> f64 {
        let [first, second] = &mut self.stages;
        second.step(first.step(setpoint))
    }

    /// Sets all past setpoints to this one.
    pub fn rest(&mut self, setpoint: f64) {
        for stage in &mut self.stages {
            stage.last.fill(setpoint);
            stage.sum = stage.last.iter().sum();
        }
    }

    /// Copies the setpoints of another average of the same servo. Allocates nothing.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        for (to, from) in self.stages.iter_mut().zip(&other.stages) {
            to.last.copy_from_slice(&from.last);
            (to.oldest, to.sum) = (from.oldest, from.sum);
        }
    }
}

impl Stage {
    fn step(&mut self, setpoint: f64) -> f64 {
        let length = self.last.len();
        let Some(oldest) = self.last.get_mut(self.oldest) else { return setpoint };
        self.sum += setpoint - std::mem::replace(oldest, setpoint);
        self.oldest += 1;
        if self.oldest == length {
            self.oldest = 0;
            // Rounding errors of the differences do not add up over more than one turn of the ring.
            self.sum = self.last.iter().sum();
        }
        self.sum / length as f64
    }
}

/// Frequency response of the averages, for z = exp(jωTs).
pub(crate) fn response(ticks: AverageTicks, z: Complex<f64>) -> Complex<f64> {
    let back = z.inv();
    // Horner's rule; the closed form of the sum is undefined at z = 1.
    let mean = |ticks: u32| {
        (0..ticks).fold(Complex::ZERO, |sum: Complex<f64>, _| sum * back + 1.0) / f64::from(ticks)
    };
    ticks.map(mean).into_iter().product()
}

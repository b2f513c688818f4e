//! Supervision of samples and measured states, and detection of missed cycles.

use crate::fault::Fault;
use crate::safety::SafetyParameters;
use crate::sample_rate::SampleRate;
use nalgebra::DVector;
use opspace_backend::Sample;
use opspace_control::Measurement;
use opspace_model::Model;

/// Supervisor that checks the samples and states of a run in every cycle. Allocates nothing.
#[derive(Clone, Debug)]
pub struct Supervisor {
    joints: Vec<Bounds>,
    period_s: f64,
    max_missed_cycles: u64,
    max_dropout_s: f64,
    last_time_s: f64,
    rate: SampleRate,
}

/// Gap between a sample and the previous one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleGap {
    /// Short gap, over which control continues: one interface cycle, or a few if cycles were missed.
    Tolerated {
        /// Number of cycles without a sample.
        missed: u64,
    },
    /// Long gap, after which the estimates are no longer valid.
    Lost {
        /// Number of cycles without a sample.
        missed: u64,
    },
}

impl SampleGap {
    /// Number of cycles without a sample.
    #[must_use]
    pub fn missed(self) -> u64 {
        match self {
            Self::Tolerated { missed } | Self::Lost { missed } => missed,
        }
    }
}

/// Longest gap on the robot's clock that is a gap of samples, s. Across a longer one, the clock was set.
const LONGEST_GAP_S: f64 = 3600.0;

/// Multiple of the motion at the speed limit above which a step of the measured position counts as a jump.
const SLIP: f64 = 2.0;

/// Further step of the measured position that is tolerated in addition to [`SLIP`], rad (m).
const SLIP_RAD: f64 = 1e-3;

#[derive(Clone, Copy, Debug)]
struct Bounds {
    lower: f64,
    upper: f64,
    velocity: f64,
}

impl Supervisor {
    /// Returns a supervisor for the URDF's limits, with position limits widened by the margin; the robot is read every
    /// `period_s` (s).
    #[must_use]
    pub fn new(model: &Model, safety: &SafetyParameters, period_s: f64) -> Self {
        let margin = safety.limit_margin_rad.get();
        let joints = (model.joints().iter())
            .map(|j| Bounds {
                lower: j.limits.lower - margin,
                upper: j.limits.upper + margin,
                velocity: j.limits.velocity,
            })
            .collect();
        Self {
            joints,
            period_s,
            max_missed_cycles: u64::from(safety.max_missed_cycles),
            max_dropout_s: safety.max_dropout_s.get(),
            last_time_s: f64::NEG_INFINITY,
            rate: SampleRate::new(period_s),
        }
    }

    /// Computes the number of missed cycles from the robot's clock, rounded: less than half a period is jitter.
    ///
    /// # Errors
    /// [`Fault::Clock`] if the clock did not advance, is not finite or is more than an hour ahead.
    pub fn check_clock(&mut self, sample: &Sample) -> Result<SampleGap, Fault> {
        let (before_s, now_s) = (self.last_time_s, sample.time_s);
        let is_first = before_s == f64::NEG_INFINITY;
        if !now_s.is_finite() || now_s <= before_s || (!is_first && now_s - before_s > LONGEST_GAP_S) {
            return Err(Fault::Clock { before_s, now_s });
        }
        self.last_time_s = now_s;
        if is_first {
            return Ok(SampleGap::Tolerated { missed: 0 });
        }
        let missed = (((now_s - before_s) / self.period_s).round() as u64).saturating_sub(1);
        let bridged = missed <= self.max_missed_cycles;
        Ok(if bridged { SampleGap::Tolerated { missed } } else { SampleGap::Lost { missed } })
    }

    /// Checks the rate of the samples, of which the last one came after this gap.
    ///
    /// # Errors
    /// [`Fault::SampleRate`] or [`Fault::LostCycles`].
    pub fn check_rate(&mut self, gap: SampleGap) -> Result<(), Fault> {
        self.rate.check(self.last_time_s, gap.missed(), matches!(gap, SampleGap::Tolerated { .. }))
    }

    /// Checks that the gap is not longer than `max_dropout_s`.
    ///
    /// # Errors
    /// [`Fault::Dropout`] if it is longer.
    pub fn check_dropout(&self, gap: SampleGap) -> Result<(), Fault> {
        let (silent_s, limit_s) = (gap.missed() as f64 * self.period_s, self.max_dropout_s);
        if silent_s > limit_s { Err(Fault::Dropout { silent_s, limit_s }) } else { Ok(()) }
    }

    /// Checks the raw sample, before it is used, against the previous positions `before` (n; rad, m; NaN if unknown).
    ///
    /// # Errors
    /// If a value is not finite, or a position jumped farther than the joint can move.
    pub fn check_sample(&self, sample: &Sample, before: &DVector<f64>, gap: SampleGap) -> Result<(), Fault> {
        let not_finite = |v: &f64| !v.is_finite();
        if let Some(joint) = sample.q.iter().position(not_finite) {
            return Err(Fault::MeasurementNotFinite { joint });
        }
        for measured in [&sample.dq, &sample.motor_torque, &sample.joint_torque].into_iter().flatten() {
            if let Some(joint) = measured.iter().position(not_finite) {
                return Err(Fault::MeasurementNotFinite { joint });
            }
        }
        let broken = sample.wrenches.iter().position(|w| w.iter().any(not_finite));
        if let Some(sensor) = broken {
            return Err(Fault::SensorNotFinite { sensor });
        }
        let elapsed_s = (gap.missed() + 1) as f64 * self.period_s;
        for (joint, bounds) in self.joints.iter().enumerate() {
            let step = (sample.q[joint] - before[joint]).abs();
            let limit = SLIP * bounds.velocity * elapsed_s + SLIP_RAD;
            // A NaN step passes: there is no previous position.
            if step > limit {
                return Err(Fault::PositionJump { joint, step, limit });
            }
        }
        Ok(())
    }

    /// Checks positions and velocities against the robot's limits.
    ///
    /// # Errors
    /// Fault of the first joint beyond a limit.
    pub fn check_state(&self, measurement: &Measurement) -> Result<(), Fault> {
        for (joint, bounds) in self.joints.iter().enumerate() {
            let (q, dq) = (measurement.q[joint], measurement.dq[joint]);
            if q < bounds.lower || q > bounds.upper {
                return Err(Fault::JointLimit { joint, q, lower: bounds.lower, upper: bounds.upper });
            }
            if dq.abs() > bounds.velocity {
                return Err(Fault::Speed { joint, dq, limit: bounds.velocity });
            }
        }
        Ok(())
    }
}

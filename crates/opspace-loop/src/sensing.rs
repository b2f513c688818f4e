//! From a raw sample to the measurement that controller and transformer share.

use crate::fault::Fault;
use crate::interface::Facts;
use crate::safety::SafetyParameters;
use crate::supervisor::{Continuity, Supervisor};
use nalgebra::Vector3;
use opspace_backend::Sample;
use opspace_backend::{Row, Signal};
use opspace_control::Measurement;
use opspace_model::{Data, Force, Model, frame_placement, update};
use opspace_transformer::estimator::{EstimatorParameters, VelocityEstimator};

const WRENCH: [&str; 6] = ["fx", "fy", "fz", "mx", "my", "mz"];

/// The part that every backend has: velocity estimate, model update, force sensors tared and turned into
/// world axes, and the checks of each.
pub struct Sensing {
    facts: Facts,
    safety: SafetyParameters,
    estimator: VelocityEstimator,
    supervisor: Supervisor,
    sample: Sample,
    measurement: Measurement,
    tare: Vec<Force>,
    tare_count: f64,
    start_s: Option<f64>,
    continuity: Continuity,
    /// Whether the measurement is that of the last sample.
    current: bool,
}

impl Sensing {
    /// For a robot that declares `facts`.
    #[must_use]
    pub fn new(
        model: &Model,
        facts: Facts,
        estimator: &EstimatorParameters,
        safety: &SafetyParameters,
    ) -> Self {
        let n = model.n();
        let mut measurement = Measurement::new(n, facts.sensors.len(), facts.motor_torque);
        // Nowhere, until it is read: a stop before that must send the robot nowhere.
        measurement.q.fill(f64::NAN);
        Self {
            estimator: VelocityEstimator::new(n, estimator, facts.period_s),
            supervisor: Supervisor::new(model, safety, facts.period_s),
            sample: Sample::new(n, facts.motor_torque, facts.sensors.len()),
            measurement,
            tare: vec![Force::zero(); facts.sensors.len()],
            tare_count: 0.0,
            start_s: None,
            continuity: Continuity::Bridged { missed: 0 },
            current: false,
            safety: safety.clone(),
            facts,
        }
    }

    /// What the robot declares.
    #[must_use]
    pub fn facts(&self) -> &Facts {
        &self.facts
    }

    /// What makes runs of this robot safe.
    #[must_use]
    pub fn safety(&self) -> &SafetyParameters {
        &self.safety
    }

    /// Where the robot is to be read into.
    pub fn sample_mut(&mut self) -> &mut Sample {
        &mut self.sample
    }

    /// The robot's clock at the last sample, s.
    #[must_use]
    pub fn clock_s(&self) -> f64 {
        self.sample.time_s
    }

    /// The measurement of the last [`observe`](Self::observe); before the first its positions are NaN.
    #[must_use]
    pub fn measurement(&self) -> &Measurement {
        &self.measurement
    }

    /// How the last sample followed the one before.
    #[must_use]
    pub fn continuity(&self) -> Continuity {
        self.continuity
    }

    /// Whether the measurement is too old to move a robot by: there was a dropout, and what came after it was refused.
    #[must_use]
    pub fn is_outdated(&self) -> bool {
        !self.current && matches!(self.continuity, Continuity::Broken { .. })
    }

    /// Takes the present reading of the force sensors as one of those at rest.
    pub fn tare(&mut self) {
        self.tare_count += 1.0;
        for (tare, raw) in self.tare.iter_mut().zip(&self.sample.wrenches) {
            *tare += (force(raw) - *tare) * (1.0 / self.tare_count);
        }
    }

    /// Lets time begin at the present sample.
    pub fn begin(&mut self) {
        self.start_s = Some(self.sample.time_s);
        self.measurement.time_s = 0.0;
    }

    /// Turns the sample into a measurement and brings `data` up to date with it.
    ///
    /// # Errors
    /// What the [`Supervisor`] finds, or a mass matrix that can't be factored.
    pub fn observe(&mut self, model: &Model, data: &mut Data) -> Result<(), Fault> {
        self.observe_with(model, data, |_, _| None)
    }

    /// The same, with the joint velocities from elsewhere if `velocities` has any.
    ///
    /// # Errors
    /// As [`observe`](Self::observe).
    pub fn observe_with<'a>(
        &mut self,
        model: &Model,
        data: &mut Data,
        velocities: impl FnOnce(&Sample, Continuity) -> Option<&'a [f64]>,
    ) -> Result<(), Fault> {
        let sample = &self.sample;
        let measurement = &mut self.measurement;
        self.current = false;
        self.continuity = self.supervisor.check_clock(sample)?;
        self.supervisor.check_sample(sample, &measurement.q, self.continuity)?;
        self.current = true;
        measurement.time_s = self.start_s.map_or(0.0, |start| sample.time_s - start);
        measurement.q.copy_from_slice(&sample.q);
        if let Continuity::Broken { .. } = self.continuity {
            self.estimator.reset();
        }
        let filtered = self.estimator.update_after(self.continuity.missed().saturating_add(1), &sample.q);
        measurement.dq.copy_from_slice(velocities(sample, self.continuity).unwrap_or(filtered));
        if let (Some(to), Some(from)) = (&mut measurement.motor_torque, &sample.motor_torque) {
            to.copy_from_slice(from);
        }
        if !update(model, data, measurement.q.as_slice(), measurement.dq.as_slice()) {
            return Err(Fault::MassMatrix);
        }
        for (s, sensor) in self.facts.sensors.iter().enumerate() {
            let axes = frame_placement(model, data, sensor.frame).rotation;
            let tared = force(&sample.wrenches[s]) - self.tare[s];
            measurement.wrenches[s] = Force { linear: axes * tared.linear, angular: axes * tared.angular };
        }
        self.supervisor.check_silence(self.continuity)?;
        self.supervisor.check_state(measurement)
    }

    /// What [`sample_row`](Self::sample_row) puts: first what the robot reported, then what was made of it.
    #[must_use]
    pub fn signals(&self, joints: &[String]) -> Vec<Signal> {
        let mut signals = vec![Signal::scalar("missed_cycles", "1"), Signal::new("q", "rad", joints)];
        if self.facts.motor_torque {
            signals.push(Signal::new("motor_torque", "Nm", joints));
        }
        for sensor in &self.facts.sensors {
            signals.push(Signal::new(format!("{}.raw", sensor.name), "N,Nm", &WRENCH));
        }
        signals.push(Signal::new("dq", "rad/s", joints));
        for sensor in &self.facts.sensors {
            signals.push(Signal::new(format!("{}.wrench", sensor.name), "N,Nm", &WRENCH));
        }
        signals
    }

    /// Puts the raw sample and the measurement.
    pub fn sample_row(&self, row: &mut Row<'_>) {
        let put_wrench = |row: &mut Row<'_>, w: &Force| {
            row.put(w.linear.as_slice());
            row.put(w.angular.as_slice());
        };
        row.put_one(self.continuity.missed() as f64);
        row.put(&self.sample.q);
        if let Some(torque) = &self.sample.motor_torque {
            row.put(torque);
        }
        self.sample.wrenches.iter().for_each(|w| row.put(w));
        row.put(self.measurement.dq.as_slice());
        self.measurement.wrenches.iter().for_each(|w| put_wrench(row, w));
    }
}

/// A force sensor's reading, in its own axes.
fn force(reading: &[f64; 6]) -> Force {
    let [fx, fy, fz, mx, my, mz] = *reading;
    Force { linear: Vector3::new(fx, fy, fz), angular: Vector3::new(mx, my, mz) }
}

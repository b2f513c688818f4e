//! State estimation: computes the measurement for controller and transformer from a raw sample.

use crate::fault::Fault;
use crate::safety::SafetyParameters;
use crate::sensor_compensation::{SensorCompensation, SensorMotion};
use crate::supervisor::{SampleGap, Supervisor};
use nalgebra::{Matrix3, Vector3};
use opspace_backend::signal_names::{
    BIAS, DEVICE_LIMITED, DQ, DQ_MEASURED, JOINT_TORQUE, LOAD, LOAD_ELEMENTS, MISSED_CYCLES, MOTOR_TORQUE, Q,
    RAW, STATUS, TOUCHES, WRENCH, WRENCH_AXES,
};
use opspace_backend::{Capabilities, Observable, Sample, SignalRecorder};
use opspace_control::Measurement;
use opspace_model::{
    Data, Force, FrameId, JointKind, JointUnits, Model, Motion, UnknownFrame, frame_placement,
    frame_velocity, update,
};
use opspace_transformer::{EstimatorParameters, Transformer, VelocityEstimator, VelocitySource};

/// State estimator: velocity estimate, model update, tared force sensors in world axes, and supervision.
pub(crate) struct StateEstimator {
    capabilities: Capabilities,
    units: JointUnits,
    sensor_frames: Vec<FrameId>,
    velocity: VelocityEstimator,
    /// True if the transformer's estimate of the velocities is not used.
    uses_filter: bool,
    supervisor: Supervisor,
    /// Joints without limits, whose encoders may count within one turn.
    continuous: Vec<usize>,
    sample: Sample,
    measurement: Measurement,
    /// Compensation of each sensor.
    sensors: Vec<SensorCompensation>,
    start_s: Option<f64>,
    gap: SampleGap,
    /// True if the measurement belongs to the last sample.
    current: bool,
}

impl StateEstimator {
    /// Returns an estimator for a robot with these capabilities, and one `compensation` for each of its force sensors. Its
    /// measurement has place for `estimated_forces` after the wrenches of the sensors.
    ///
    /// # Errors
    /// If a force sensor is on a frame that the model does not have.
    pub(crate) fn new(
        model: &Model,
        capabilities: &Capabilities,
        estimator: &EstimatorParameters,
        safety: &SafetyParameters,
        compensation: Vec<SensorCompensation>,
        estimated_forces: usize,
    ) -> Result<Self, UnknownFrame> {
        let n = model.n();
        let sensors = &capabilities.force_sensors;
        let mut measurement =
            Measurement::new(n, sensors.len() + estimated_forces, capabilities.measures_motor_torque);
        // Unknown until the first sample: a stop before it must not send a setpoint.
        measurement.q.fill(f64::NAN);
        let sensor_frames: Result<Vec<FrameId>, _> =
            sensors.iter().map(|s| model.frame_id(&s.frame)).collect();
        Ok(Self {
            units: model.joint_units(),
            sensor_frames: sensor_frames?,
            uses_filter: estimator.velocity == Some(VelocitySource::Filter),
            velocity: VelocityEstimator::new(n, estimator, capabilities.period_s),
            supervisor: Supervisor::new(model, safety, capabilities.period_s),
            continuous: (0..n).filter(|&i| model.joints()[i].kind == JointKind::Continuous).collect(),
            sample: Sample::new(capabilities),
            measurement,
            sensors: compensation,
            start_s: None,
            gap: SampleGap::Tolerated { missed: 0 },
            current: false,
            capabilities: capabilities.clone(),
        })
    }

    /// Time of the last sample on the robot's clock, s.
    pub(crate) fn clock_s(&self) -> f64 {
        self.sample.time_s
    }

    /// Measurement of the last [`observe`](Self::observe); before the first one its positions are NaN.
    pub(crate) fn measurement(&self) -> &Measurement {
        &self.measurement
    }

    /// Measurement of the last cycle, into which estimated forces are written.
    pub(crate) fn measurement_mut(&mut self) -> &mut Measurement {
        &mut self.measurement
    }

    /// Number of interface cycles missed before the last sample.
    pub(crate) fn missed(&self) -> u64 {
        self.gap.missed()
    }

    /// Returns true if more cycles were missed than tolerated, so that the estimates are no longer valid.
    pub(crate) fn is_lost(&self) -> bool {
        matches!(self.gap, SampleGap::Lost { .. })
    }

    /// Returns true if the last state is too old to compute a setpoint from it: the first sample after a dropout was
    /// rejected.
    pub(crate) fn is_outdated(&self) -> bool {
        !self.current && self.is_lost()
    }

    /// Returns true once a position was measured.
    pub(crate) fn is_known(&self) -> bool {
        self.measurement.q.iter().all(|q| q.is_finite())
    }

    /// Adds the present readings of the force sensors at rest, where nothing touches.
    pub(crate) fn rest(&mut self, model: &Model, data: &Data) {
        for (s, &frame) in self.sensor_frames.iter().enumerate() {
            let axes = frame_placement(model, data, frame).rotation;
            let estimates = self.sensors[s].estimate.is_some();
            let motion = sensor_motion(model, data, frame, &axes, estimates);
            self.sensors[s].rest(&force(&self.sample.wrenches[s]), &motion);
        }
    }

    /// Sets the measurement's time to zero at the last sample.
    pub(crate) fn begin(&mut self) {
        self.start_s = Some(self.sample.time_s);
        self.measurement.time_s = 0.0;
    }

    /// Adds whole turns to positions of continuous joints, so that they continue the last ones. Returns true if it added any.
    fn unwrap(&mut self) -> bool {
        let mut wraps = false;
        for &joint in &self.continuous {
            let q = &mut self.sample.q[joint];
            let continued = JointKind::Continuous.nearest_turn(*q, self.measurement.q[joint]);
            wraps |= (continued - *q).abs() > 0.0;
            *q = continued;
        }
        wraps
    }

    /// Computes the measurement from a sample and updates `data`. Joint velocities are those of the transformer if it
    /// estimates them and the filter is not asked for, otherwise the measured ones, otherwise filtered differences of positions. While the robot is
    /// `held`, the transformer's estimate is not used.
    ///
    /// # Errors
    /// A fault detected by the [`Supervisor`], or a mass matrix that cannot be factorized.
    pub(crate) fn observe(
        &mut self,
        sample: &Sample,
        model: &Model,
        data: &mut Data,
        transformer: &mut dyn Transformer,
        held: bool,
    ) -> Result<(), Fault> {
        self.sample.copy_from(sample);
        let sample = if self.unwrap() { &self.sample } else { sample };
        let measurement = &mut self.measurement;
        self.current = false;
        self.gap = self.supervisor.check_clock(sample)?;
        self.supervisor.check_sample(sample, &measurement.q, self.gap)?;
        self.current = true;
        measurement.time_s = self.start_s.map_or(0.0, |start| sample.time_s - start);
        measurement.q.copy_from_slice(&sample.q);
        if let SampleGap::Lost { .. } = self.gap {
            self.velocity.reset();
        }
        let filtered = self.velocity.update_after(self.gap.missed().saturating_add(1), &sample.q);
        let velocity = sample.dq.as_deref().unwrap_or(filtered);
        match self.gap {
            SampleGap::Tolerated { missed: 0 } => {}
            SampleGap::Tolerated { missed } => transformer.missed(missed),
            SampleGap::Lost { .. } => transformer.reset(),
        }
        let known = transformer.observe(sample).filter(|_| !held && !self.uses_filter);
        measurement.dq.copy_from_slice(known.unwrap_or(velocity));
        if let (Some(to), Some(from)) = (&mut measurement.motor_torque, &sample.motor_torque) {
            to.copy_from_slice(from);
        }
        if !update(model, data, measurement.q.as_slice(), measurement.dq.as_slice()) {
            return Err(Fault::MassMatrix);
        }
        for (s, &frame) in self.sensor_frames.iter().enumerate() {
            let axes = frame_placement(model, data, frame).rotation;
            let estimates = self.sensors[s].estimate.is_some();
            let motion = sensor_motion(model, data, frame, &axes, estimates);
            let reading = force(&sample.wrenches[s]);
            let contact = match self.start_s {
                Some(_) => self.sensors[s].update(&reading, &motion),
                None => self.sensors[s].contact(&reading, &motion.gravity),
            };
            measurement.wrenches[s] =
                Force { linear: axes * contact.linear, angular: axes * contact.angular };
        }
        self.supervisor.check_dropout(self.gap)?;
        self.supervisor.check_rate(self.gap)?;
        self.supervisor.check_state(measurement)
    }
}

impl Observable for StateEstimator {
    /// Records the sample, with positions of continuous joints that do not wrap, then the measurement.
    fn record(&self, out: &mut SignalRecorder<'_>) {
        let Self { capabilities, units, sample, measurement, .. } = self;
        let (joints, sensors) = (&capabilities.joints, &capabilities.force_sensors);
        out.scalar(MISSED_CYCLES, "1", self.gap.missed() as f64);
        out.signal(Q, &units.position, joints, &sample.q);
        if let Some(dq) = &sample.dq {
            out.signal(DQ_MEASURED, &units.velocity, joints, dq);
        }
        if let Some(torque) = &sample.motor_torque {
            out.signal(MOTOR_TORQUE, &units.torque, joints, torque);
        }
        if let Some(torque) = &sample.joint_torque {
            out.signal(JOINT_TORQUE, &units.torque, joints, torque);
        }
        for (sensor, wrench) in sensors.iter().zip(&sample.wrenches) {
            out.signal((&sensor.name, RAW), "N,Nm", &WRENCH_AXES, wrench);
        }
        if let Some(status) = &sample.status {
            out.scalar(STATUS, "1", f64::from(status.word));
            out.scalar(DEVICE_LIMITED, "1", f64::from(u8::from(status.command_limited)));
        }
        out.signal(DQ, &units.velocity, joints, measurement.dq.as_slice());
        for (sensor, Force { linear, angular }) in sensors.iter().zip(&measurement.wrenches) {
            let wrench = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z];
            out.signal((&sensor.name, WRENCH), "N,Nm", &WRENCH_AXES, &wrench);
        }
        for (sensor, compensation) in sensors.iter().zip(&self.sensors) {
            let Some(estimate) = &compensation.estimate else { continue };
            out.signal((&sensor.name, BIAS), "N,Nm", &WRENCH_AXES, &compensation.bias());
            out.signal((&sensor.name, LOAD), "kg,kg m", &LOAD_ELEMENTS, &compensation.load());
            out.scalar((&sensor.name, TOUCHES), "1", f64::from(u8::from(estimate.touches())));
        }
    }
}

/// Motion of a force sensor with these `axes`; without its velocity unless it is `needed`.
fn sensor_motion(
    model: &Model,
    data: &Data,
    frame: FrameId,
    axes: &Matrix3<f64>,
    needed: bool,
) -> SensorMotion {
    let Motion { linear, angular } = if needed { frame_velocity(model, data, frame) } else { Motion::zero() };
    let velocity = Motion { linear: axes.tr_mul(&linear), angular: axes.tr_mul(&angular) };
    SensorMotion { gravity: axes.tr_mul(&model.gravity()), velocity }
}

/// Converts a force sensor's reading (N, Nm) to a [`Force`] in the sensor's axes.
fn force(reading: &[f64; 6]) -> Force {
    let [fx, fy, fz, mx, my, mz] = *reading;
    Force { linear: Vector3::new(fx, fy, fz), angular: Vector3::new(mx, my, mz) }
}

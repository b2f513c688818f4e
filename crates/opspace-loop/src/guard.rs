//! The guard between transformer and robot: setpoints within reach of the servo, following error, and the watchdogs of
//! motor torque and power.
//!
//! A torque robot needs none: its torques were clamped before.

use crate::fault::Fault;
use crate::watchdog::{Watchdog, WatchdogParameters};
use nalgebra::DVector;
use opspace_backend::signal_names::{
    DQ_DESIRED, Q_DESIRED, SETPOINT_ACCELERATION, SETPOINT_CLAMPED, SETPOINT_SPEED,
};
use opspace_backend::{CommandKind, Observable, SignalRecorder};
use opspace_control::Measurement;
use opspace_model::{JointUnits, Model};
use opspace_transformer::ServoGains;

/// Guard of the setpoints of a position or velocity robot.
pub(crate) struct Guard {
    kind: CommandKind,
    joints: Vec<String>,
    units: JointUnits,
    /// Largest distance of a setpoint from the measured position or velocity, by joint.
    reach: DVector<f64>,
    /// Largest motion of a joint within a period at full speed.
    step: DVector<f64>,
    period_s: f64,
    /// Torque per velocity of each servo, Nms/rad or Ns/m.
    damping: Vec<f64>,
    setpoint: DVector<f64>,
    /// Rate of change of the setpoints, rad/s, m/s or rad/s², m/s² (n); within a cycle, the setpoints before.
    rate: DVector<f64>,
    clamped: DVector<f64>,
    /// True once there is a setpoint.
    is_set: bool,
    watchdog: Watchdog,
    /// Torques for which the setpoints in force were made, Nm or N (n).
    torque_desired: DVector<f64>,
    /// True if the setpoints in force were made for torques.
    watching: bool,
}

impl Guard {
    /// Guard for setpoints of that kind to servos with these gains, with torque limits (n; Nm, N). `None` for a torque
    /// robot.
    pub(crate) fn new(
        kind: CommandKind,
        model: &Model,
        gains: &[ServoGains],
        torque_limits: &[f64],
        parameters: &WatchdogParameters,
        period_s: f64,
    ) -> Option<Self> {
        let n = model.n();
        let speeds: Vec<f64> = model.joints().iter().map(|j| j.limits.velocity).collect();
        let reach: fn(&ServoGains, f64, f64) -> f64 = match kind {
            CommandKind::Torque => return None,
            // Equation (K9) solved for the distance at which the servo gives full torque at full speed.
            CommandKind::Position => {
                |gains, torque, speed| (torque + gains.damping * speed) / gains.stiffness
            }
            // Its inner loop alone, at which the servo gives full torque.
            CommandKind::Velocity => |gains, torque, _| torque / gains.damping,
        };
        Some(Self {
            kind,
            joints: model.joints().iter().map(|j| j.name.clone()).collect(),
            units: model.joint_units(),
            reach: DVector::from_fn(n, |i, _| reach(&gains[i], torque_limits[i], speeds[i])),
            step: DVector::from_fn(n, |i, _| speeds[i] * period_s),
            period_s,
            damping: gains.iter().map(|servo| servo.damping).collect(),
            setpoint: DVector::from_element(n, f64::NAN),
            rate: DVector::zeros(n),
            clamped: DVector::zeros(n),
            is_set: false,
            watchdog: Watchdog::new(parameters, torque_limits, &speeds, period_s),
            torque_desired: DVector::zeros(n),
            watching: false,
        })
    }

    /// The setpoints (rad, m or rad/s, m/s; n).
    pub(crate) fn setpoint(&self) -> &[f64] {
        self.setpoint.as_slice()
    }

    /// Setpoints to be overwritten (rad, m or rad/s, m/s; n).
    pub(crate) fn setpoint_mut(&mut self) -> &mut [f64] {
        self.setpoint.as_mut_slice()
    }

    /// Compares the motors' torques with the desired ones, where every sample came and the setpoints in force were made
    /// for torques.
    ///
    /// # Errors
    /// The first joint whose motor deviates by more than a bound.
    pub(crate) fn watch(&mut self, measurement: &Measurement, missed: u64) -> Result<(), Fault> {
        match &measurement.motor_torque {
            Some(torque) if self.watching && missed == 0 => {
                self.watchdog.check(torque, &self.torque_desired, &measurement.dq)
            }
            _ => Ok(()),
        }
    }

    /// Stops comparing torques, and clears the means.
    pub(crate) fn stop_watching(&mut self) {
        self.watching = false;
        self.watchdog.reset();
    }

    /// Checks that each joint of a position robot is as near to its setpoint as full torque at full speed explains:
    /// farther away it was stopped by something, or the setpoint jumped.
    ///
    /// # Errors
    /// The first joint that is farther away.
    pub(crate) fn check_following(&self, measurement: &Measurement, missed: u64) -> Result<(), Fault> {
        if self.is_set { self.check_distance(measurement, missed) } else { Ok(()) }
    }

    fn check_distance(&self, measurement: &Measurement, missed: u64) -> Result<(), Fault> {
        if self.kind != CommandKind::Position {
            return Ok(());
        }
        for joint in 0..self.setpoint.len() {
            let error = (self.setpoint[joint] - measurement.q[joint]).abs();
            let limit = self.reach[joint] + self.step[joint] * (missed + 1) as f64;
            if error > limit {
                return Err(Fault::FollowingError { joint, error, limit });
            }
        }
        Ok(())
    }

    /// Begins a cycle in which setpoints are computed: remembers those before, for the signal of their rate of
    /// change. The first ones count from the measured state.
    pub(crate) fn begin(&mut self, measurement: &Measurement) {
        let before = if self.is_set { &self.setpoint } else { measured(self.kind, measurement) };
        self.rate.copy_from(before);
    }

    /// Takes the torques for which setpoints are computed, Nm or N (n).
    pub(crate) fn expect_torque(&mut self, torque: &[f64]) {
        self.torque_desired.copy_from_slice(torque);
        self.watching = true;
    }

    /// Takes setpoints that no transformer made, rad or m (n); velocities, rad/s or m/s, are brought within reach.
    ///
    /// # Errors
    /// A following error.
    pub(crate) fn take(
        &mut self,
        setpoint: &[f64],
        measurement: &Measurement,
        missed: u64,
    ) -> Result<(), Fault> {
        self.watching = false;
        self.setpoint.copy_from_slice(setpoint);
        if self.kind == CommandKind::Velocity {
            self.keep_within_reach(measurement);
        }
        self.check_distance(measurement, missed)
    }

    /// Brings setpoints to where the servo gives full torque at full speed, if they are farther away.
    pub(crate) fn keep_within_reach(&mut self, measurement: &Measurement) {
        let measured = measured(self.kind, measurement);
        for (i, setpoint) in self.setpoint.iter_mut().enumerate() {
            let (at, reach) = (measured[i], self.reach[i]);
            let allowed = setpoint.clamp(at - reach, at + reach);
            self.clamped[i] = f64::from(u8::from(allowed != *setpoint));
            *setpoint = allowed;
        }
    }

    /// Ends a cycle in which setpoints were computed.
    pub(crate) fn finish(&mut self, missed: u64) {
        let elapsed_s = self.period_s * (missed + 1) as f64;
        for (rate, setpoint) in self.rate.iter_mut().zip(&self.setpoint) {
            *rate = (setpoint - *rate) / elapsed_s;
        }
        self.is_set = true;
    }

    /// A cycle in which the robot is held: the setpoints of a position robot stay, those of a velocity robot are zero.
    pub(crate) fn hold(&mut self) {
        self.stop_watching();
        self.rate.fill(0.0);
        if self.kind == CommandKind::Velocity {
            self.setpoint.fill(0.0);
        }
    }

    /// Sets setpoints of a velocity robot that brake it with the servo's damping and produce the torques `holding` (Nm
    /// or N; n).
    pub(crate) fn brake(&mut self, holding: &[f64]) {
        for (i, setpoint) in self.setpoint.iter_mut().enumerate() {
            *setpoint = holding[i] / self.damping[i];
        }
    }
}

/// The measured quantity that setpoints of that kind are compared with.
fn measured(kind: CommandKind, measurement: &Measurement) -> &DVector<f64> {
    match kind {
        CommandKind::Velocity => &measurement.dq,
        _ => &measurement.q,
    }
}

impl Observable for Guard {
    fn record(&self, out: &mut SignalRecorder<'_>) {
        let Self { joints, units, .. } = self;
        let [(setpoint, unit), (rate, rate_unit)] = match self.kind {
            CommandKind::Velocity => {
                [(DQ_DESIRED, &units.velocity), (SETPOINT_ACCELERATION, &units.acceleration)]
            }
            _ => [(Q_DESIRED, &units.position), (SETPOINT_SPEED, &units.velocity)],
        };
        out.signal(setpoint, unit, joints, self.setpoint.as_slice());
        out.signal(rate, rate_unit, joints, self.rate.as_slice());
        out.signal(SETPOINT_CLAMPED, "1", joints, self.clamped.as_slice());
    }
}

//! Guard between transformer and robot: clamps setpoints around the measured state, to the joints' speed limits and to the
//! limits of the drives, checks the following error, and runs the watchdogs of motor torque, power and oscillation.
//!
//! A torque robot needs no guard: its torques are clamped before.

use crate::fault::Fault;
use crate::watchdog::Watchdog;
use nalgebra::DVector;
use opspace_backend::quantity::Positive;
use opspace_backend::signal_names::{
    DQ_DESIRED, Q_DESIRED, SETPOINT_ACCELERATION, SETPOINT_CLAMPED, SETPOINT_SPEED,
};
use opspace_backend::{CommandKind, Observable, SignalRecorder};
use opspace_control::Measurement;
use opspace_model::{JointUnits, Model};
use opspace_transformer::ServoGains;
use opspace_transformer::setpoint_governor::GovernedSetpoint;
use opspace_transformer::setpoint_limits::JointSetpointLimits;

/// Guard of the setpoints of a position or velocity robot.
pub(crate) struct Guard {
    kind: CommandKind,
    joints: Vec<String>,
    units: JointUnits,
    /// Largest distance of a setpoint from the measured position or velocity (n; rad, m or rad/s, m/s).
    reach: DVector<f64>,
    /// Largest motion of a joint within a period, at its speed limit: no position setpoint steps further (n; rad, m).
    step: DVector<f64>,
    period_s: f64,
    /// Damping kv of each servo (n; Nms/rad, Ns/m).
    damping: Vec<f64>,
    /// Setpoints within the limits of the drives (n).
    governors: Vec<GovernedSetpoint>,
    /// Setpoints before the present ones, within the limits of the drives (n).
    governors_before: Vec<GovernedSetpoint>,
    setpoint: DVector<f64>,
    /// Rate of change of the setpoints (n; rad/s, m/s or rad/s², m/s²); while a cycle is computed, the previous
    /// setpoints.
    rate: DVector<f64>,
    clamped: DVector<f64>,
    /// Setpoints of a stop without limits (n).
    last: DVector<f64>,
    /// True once a setpoint was computed.
    is_set: bool,
    watchdog: Watchdog,
    /// Desired torques for which the present setpoints were computed (n; Nm, N).
    torque_desired: DVector<f64>,
    /// True if the present setpoints were computed from torques.
    watching: bool,
}

impl Guard {
    /// Returns a guard for setpoints of that kind, for servos with these gains and torque limits (n; Nm, N); `None` for
    /// a torque robot.
    pub(crate) fn new(
        kind: CommandKind,
        model: &Model,
        gains: &[ServoGains],
        torque_limits: &[f64],
        setpoint_limits: &[JointSetpointLimits],
        watchdog: Watchdog,
        period_s: f64,
    ) -> Option<Self> {
        let n = model.n();
        let speeds: Vec<f64> = model.joints().iter().map(|j| j.limits.velocity).collect();
        let reach: fn(&ServoGains, f64, f64) -> f64 = match kind {
            CommandKind::Torque => return None,
            // Equation (K9): setpoint distance at which the servo produces full torque at full speed.
            CommandKind::Position => {
                |gains, torque, speed| (torque + gains.damping * speed) / gains.stiffness
            }
            // Inner loop of (K9): velocity error at which the servo produces full torque.
            CommandKind::Velocity => |gains, torque, _| torque / gains.damping,
        };
        let governor = |(joint, &speed): (usize, &f64)| {
            let declared = setpoint_limits.get(joint).copied().unwrap_or_default();
            GovernedSetpoint::new(&within_speed(declared, kind, speed), kind, period_s)
        };
        let governors: Vec<_> = speeds.iter().enumerate().map(governor).collect();
        Some(Self {
            kind,
            joints: model.joints().iter().map(|j| j.name.clone()).collect(),
            units: model.joint_units(),
            reach: DVector::from_fn(n, |i, _| reach(&gains[i], torque_limits[i], speeds[i])),
            step: DVector::from_fn(n, |i, _| speeds[i] * period_s),
            period_s,
            damping: gains.iter().map(|servo| servo.damping).collect(),
            governors: governors.clone(),
            governors_before: governors,
            setpoint: DVector::from_element(n, f64::NAN),
            rate: DVector::zeros(n),
            clamped: DVector::zeros(n),
            last: DVector::zeros(n),
            is_set: false,
            watchdog,
            torque_desired: DVector::zeros(n),
            watching: false,
        })
    }

    /// Present setpoints (n; rad, m or rad/s, m/s).
    pub(crate) fn setpoint(&self) -> &[f64] {
        self.setpoint.as_slice()
    }

    /// Present setpoints, mutable (n; rad, m or rad/s, m/s).
    pub(crate) fn setpoint_mut(&mut self) -> &mut [f64] {
        self.setpoint.as_mut_slice()
    }

    /// Runs the watchdogs on motor torques and desired torques, if no cycle was missed and the present setpoints were
    /// computed from torques.
    ///
    /// # Errors
    /// Fault of the first joint beyond a bound.
    pub(crate) fn watch(&mut self, measurement: &Measurement, missed: u64) -> Result<(), Fault> {
        match &measurement.motor_torque {
            Some(torque) if self.watching && missed == 0 => {
                self.watchdog.check(torque, &self.torque_desired, &measurement.dq)
            }
            _ => Ok(()),
        }
    }

    /// Stops the watchdogs and clears their means.
    pub(crate) fn stop_watching(&mut self) {
        self.watching = false;
        self.watchdog.reset();
    }

    /// Checks that each joint of a position robot is within reach of its setpoint: the distance that full torque at
    /// full speed explains. At a larger distance an obstacle stopped the joint, or the setpoint jumped.
    ///
    /// # Errors
    /// Fault of the first joint beyond the distance.
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

    /// Begins a cycle in which setpoints are computed: saves the previous setpoints for their rate of change, or the
    /// measured state if there are none.
    pub(crate) fn begin(&mut self, measurement: &Measurement) {
        let before = if self.is_set { &self.setpoint } else { measured(self.kind, measurement) };
        self.rate.copy_from(before);
        self.clamped.fill(0.0);
        self.governors_before.copy_from_slice(&self.governors);
    }

    /// Takes back the setpoints of this cycle, which others replace.
    pub(crate) fn replace(&mut self) {
        self.governors.copy_from_slice(&self.governors_before);
    }

    /// Sets the desired torques from which setpoints are computed (n; Nm, N), and enables the watchdogs.
    pub(crate) fn expect_torque(&mut self, torque: &[f64]) {
        self.torque_desired.copy_from_slice(torque);
        self.watching = true;
    }

    /// Sets setpoints of the controller, which no transformer computed (n; rad, m or rad/s, m/s). Velocities are
    /// clamped to the reach.
    ///
    /// # Errors
    /// Following error of a position robot.
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

    /// Clamps setpoints to the reach around the measured positions or velocities.
    pub(crate) fn keep_within_reach(&mut self, measurement: &Measurement) {
        let measured = measured(self.kind, measurement);
        for (i, setpoint) in self.setpoint.iter_mut().enumerate() {
            let (at, reach) = (measured[i], self.reach[i]);
            let allowed = setpoint.clamp(at - reach, at + reach);
            self.clamped[i] = f64::from(u8::from(allowed != *setpoint));
            *setpoint = allowed;
        }
    }

    /// Keeps setpoints within the limits of the joints' speeds and of the drives, which have kept the last ones in `missed` cycles.
    pub(crate) fn keep_within_limits(&mut self, missed: u64) {
        for (i, (governor, setpoint)) in self.governors.iter_mut().zip(&mut self.setpoint).enumerate() {
            if self.kind == CommandKind::Position {
                let allowed = within_step(*setpoint, governor.last(), self.step[i]);
                if allowed != *setpoint {
                    self.clamped[i] = 1.0;
                }
                *setpoint = allowed;
            }
            if governor.is_limited() {
                if missed > 0 {
                    governor.keep();
                }
                *setpoint = governor.follow(*setpoint);
            }
        }
    }

    /// Returns true if the drives limit any setpoints.
    pub(crate) fn has_limits(&self) -> bool {
        self.governors.iter().any(GovernedSetpoint::is_limited)
    }

    /// Begins a stop: the present setpoints are those of joints whose setpoints are not limited, and those at which the joints of
    /// a velocity robot come to rest.
    pub(crate) fn begin_stop(&mut self) {
        self.last.copy_from(&self.setpoint);
    }

    /// Begins a stop in an unknown state, at the previous setpoints. Returns false if none were sent, or the drives keep them.
    pub(crate) fn begin_stop_at_previous(&mut self) -> bool {
        if !self.has_limits() {
            return false;
        }
        for (last, governor) in self.last.iter_mut().zip(&self.governors) {
            match (self.kind, governor.last()) {
                (_, None) => return false,
                (CommandKind::Velocity, _) => *last = 0.0,
                (_, Some(setpoint)) => *last = setpoint,
            }
        }
        true
    }

    /// Computes the next setpoints of a stop, which come to rest within the limits. Returns true if they are at rest.
    pub(crate) fn come_to_rest(&mut self, missed: u64) -> bool {
        let elapsed_s = self.period_s * (missed + 1) as f64;
        let mut is_at_rest = true;
        for (i, governor) in self.governors.iter_mut().enumerate() {
            if missed > 0 {
                governor.keep();
            }
            let (end, before) = (self.last[i], governor.last());
            let setpoint = match self.kind {
                CommandKind::Velocity => governor.follow(end),
                _ if governor.is_limited() => governor.brake(end),
                _ => within_step(end, before, self.step[i]),
            };
            governor.take(setpoint);
            self.setpoint[i] = setpoint;
            self.rate[i] = before.map_or(0.0, |before| (setpoint - before) / elapsed_s);
            is_at_rest &= if governor.is_limited() { governor.is_at_rest(end) } else { setpoint == end };
        }
        self.is_set = true;
        is_at_rest
    }

    /// Ends a cycle in which setpoints were computed.
    pub(crate) fn finish(&mut self, missed: u64) {
        let elapsed_s = self.period_s * (missed + 1) as f64;
        for (rate, setpoint) in self.rate.iter_mut().zip(&self.setpoint) {
            *rate = (setpoint - *rate) / elapsed_s;
        }
        self.governors.iter_mut().zip(&self.setpoint).for_each(|(governor, &sent)| governor.take(sent));
        self.is_set = true;
    }

    /// Updates the guard in a cycle in which the robot is held: a position robot keeps its setpoints, those of a
    /// velocity robot are zero.
    pub(crate) fn hold(&mut self) {
        self.stop_watching();
        self.rate.fill(0.0);
        if self.kind == CommandKind::Velocity {
            self.setpoint.fill(0.0);
            self.governors.iter_mut().for_each(GovernedSetpoint::restart);
        } else {
            self.governors.iter_mut().for_each(GovernedSetpoint::keep);
        }
    }

    /// Sets setpoints of a velocity robot: the servo's damping brakes the joints and adds the torques `holding` (n; Nm,
    /// N).
    pub(crate) fn brake(&mut self, holding: &[f64]) {
        for (i, setpoint) in self.setpoint.iter_mut().enumerate() {
            *setpoint = holding[i] / self.damping[i];
        }
    }
}

/// Limits of a drive whose position setpoints are not faster than the joint's own speed limit, rad/s (m/s). A drive without limits has
/// none.
fn within_speed(declared: JointSetpointLimits, kind: CommandKind, speed_limit: f64) -> JointSetpointLimits {
    let mut limits = declared;
    if kind == CommandKind::Position && declared != JointSetpointLimits::default() {
        let velocity = declared.velocity_rad_per_s.map_or(f64::INFINITY, Positive::get);
        limits.velocity_rad_per_s = Positive::try_from(velocity.min(speed_limit)).ok();
    }
    limits
}

/// Returns the position nearest to `setpoint` that is at most a step from the previous setpoint. The first one may be anywhere.
fn within_step(setpoint: f64, before: Option<f64>, step: f64) -> f64 {
    before.map_or(setpoint, |before| setpoint.clamp(before - step, before + step))
}

/// Returns the measured quantity to which setpoints of that kind are compared.
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

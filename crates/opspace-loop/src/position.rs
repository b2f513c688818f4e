//! The backend of position robots: torques pass through the transformer.

use crate::backend::{Backend, Command, check_finite};
use crate::fault::Fault;
use crate::robot::{PositionRobot, Trace, Traces};
use crate::sensing::Sensing;
use crate::supervisor::Continuity;
use crate::watchdog::Watchdog;
use nalgebra::DVector;
use opspace_backend::GravityBy;
use opspace_backend::{Observable, Row, Signal};
use opspace_model::{Data, Model};
use opspace_transformer::servo::ServoGains;
use opspace_transformer::transformer::Transformer;

/// A position robot behind a transformer.
pub struct PositionBackend<R> {
    robot: R,
    sensing: Sensing,
    transformer: Box<dyn Transformer>,
    joints: Vec<String>,
    /// Furthest that a set-point may be from the measured position, by joint.
    reach: DVector<f64>,
    /// What a joint can move within a period at full speed.
    step: DVector<f64>,
    q_desired: DVector<f64>,
    speed: DVector<f64>,
    clamped: DVector<f64>,
    commanded: bool,
    /// No controller commands: the set-points stay what they are.
    held: bool,
    watchdog: Watchdog,
    /// What the set-points in force were made for, Nm, N (n), and whether they were made for torques at all.
    torque_desired: DVector<f64>,
    watching: bool,
}

impl<R: PositionRobot> PositionBackend<R> {
    /// For a robot whose joints' servos amount to these gains, with torque limits (Nm, N).
    ///
    /// # Panics
    /// If there is not one servo and one limit a joint.
    #[must_use]
    pub fn new(
        robot: R,
        model: &Model,
        sensing: Sensing,
        transformer: Box<dyn Transformer>,
        gains: &[ServoGains],
        torque_limits: &[f64],
    ) -> Self {
        let n = model.n();
        assert!(gains.len() == n && torque_limits.len() == n, "one servo and one limit a joint");
        // Equation (9) solved for the distance at which the servo gives full torque at full speed.
        let reach = DVector::from_fn(n, |i, _| {
            let velocity = model.joints()[i].limits.velocity;
            (torque_limits[i] + gains[i].damping * velocity) / gains[i].stiffness
        });
        let period_s = sensing.facts().period_s;
        let speeds: Vec<f64> = model.joints().iter().map(|j| j.limits.velocity).collect();
        let watchdog = Watchdog::new(&sensing.safety().watchdog, torque_limits, &speeds, period_s);
        let step = DVector::from_fn(n, |i, _| model.joints()[i].limits.velocity * period_s);
        Self {
            robot,
            sensing,
            transformer,
            joints: model.joints().iter().map(|j| j.name.clone()).collect(),
            reach,
            step,
            q_desired: DVector::from_element(n, f64::NAN),
            speed: DVector::zeros(n),
            clamped: DVector::zeros(n),
            commanded: false,
            held: false,
            watchdog,
            torque_desired: DVector::zeros(n),
            watching: false,
        }
    }

    /// The robot itself.
    pub fn robot(&self) -> &R {
        &self.robot
    }

    /// A joint further from its set-point than full torque and full speed explain was stopped by
    /// something, or the set-point jumped.
    fn check_following(&self) -> Result<(), Fault> {
        let q = &self.sensing.measurement().q;
        for joint in 0..q.len() {
            let error = (self.q_desired[joint] - q[joint]).abs();
            let limit = self.reach[joint] + self.step[joint] * self.periods();
            if error > limit {
                return Err(Fault::FollowingError { joint, error, limit });
            }
        }
        Ok(())
    }

    /// How many interface periods went by since the last sample but one.
    fn periods(&self) -> f64 {
        (self.sensing.continuity().missed() + 1) as f64
    }

    /// Stops comparing what the motors give with what they were asked for.
    fn stop_watching(&mut self) {
        self.watching = false;
        self.watchdog.reset();
    }

    /// Compares them, where every sample came and the set-points in force were made for torques.
    fn watch(&mut self) -> Result<(), Fault> {
        let measurement = self.sensing.measurement();
        match &measurement.motor_torque {
            Some(torque) if self.watching && self.sensing.continuity().missed() == 0 => {
                self.watchdog.check(torque, &self.torque_desired, &measurement.dq)
            }
            _ => Ok(()),
        }
    }

    /// Set-points for `tau`, as far as they may go.
    fn transform(&mut self, data: &Data, tau: &[f64]) {
        self.transformer.transform(data, tau, self.q_desired.as_mut_slice());
        self.keep_within_reach();
    }

    /// No further from the measured position than full torque at full speed asks.
    fn keep_within_reach(&mut self) {
        let measurement = self.sensing.measurement();
        for (i, qd) in self.q_desired.iter_mut().enumerate() {
            let (q, reach) = (measurement.q[i], self.reach[i]);
            let allowed = qd.clamp(q - reach, q + reach);
            self.clamped[i] = f64::from(u8::from(allowed != *qd));
            *qd = allowed;
        }
    }
}

impl<R: PositionRobot> Backend for PositionBackend<R> {
    fn read(&mut self) -> Result<(), Fault> {
        self.robot.read(self.sensing.sample_mut())
    }

    fn sensing(&self) -> &Sensing {
        &self.sensing
    }

    fn sensing_mut(&mut self) -> &mut Sensing {
        &mut self.sensing
    }

    fn observe(&mut self, model: &Model, data: &mut Data) -> Result<(), Fault> {
        let Self { sensing, transformer, held, .. } = self;
        sensing.observe_with(model, data, |sample, continuity| {
            match continuity {
                Continuity::Bridged { missed: 0 } => {}
                Continuity::Bridged { missed } => transformer.missed(missed),
                Continuity::Broken { .. } => transformer.reset(),
            }
            // Of a robot that it doesn't command it believes that it stands still.
            transformer.observe(sample).filter(|_| !*held)
        })?;
        self.watch()
    }

    fn command(&mut self, data: &Data, command: Command<'_>) -> Result<(), Fault> {
        if self.commanded {
            self.check_following()?;
        }
        // The first set-point has nothing before it: its speed counts from where the robot stands.
        let n = self.q_desired.len();
        for i in 0..n {
            let before = if self.commanded { self.q_desired[i] } else { self.sensing.measurement().q[i] };
            self.speed[i] = before;
        }
        match command {
            Command::Torque(tau) => {
                check_finite(tau)?;
                self.torque_desired.copy_from_slice(tau);
                self.watching = true;
                self.transform(data, tau);
            }
            Command::Position(q_desired) => {
                check_finite(q_desired)?;
                self.watching = false;
                self.q_desired.copy_from_slice(q_desired);
                self.check_following()?;
            }
        }
        let elapsed_s = self.sensing.facts().period_s * self.periods();
        for i in 0..n {
            self.speed[i] = (self.q_desired[i] - self.speed[i]) / elapsed_s;
        }
        self.commanded = true;
        self.held = false;
        self.transformer.sent(data, self.q_desired.as_slice());
        self.robot.set_positions(self.q_desired.as_slice())
    }

    fn hold(&mut self) -> Result<(), Fault> {
        self.held = true;
        self.stop_watching();
        if !self.commanded {
            return Ok(());
        }
        self.check_following()?;
        self.speed.fill(0.0);
        self.robot.set_positions(self.q_desired.as_slice())
    }

    fn stop(&mut self, data: &Data) {
        self.stop_watching();
        // One last set-point that carries the weight and leads by v/kp, then frozen: the stiff servo stops the arm. A
        // state that can't be read, or that was long ago, leaves the last one: it is as good a place to hold.
        let readable = self.sensing.measurement().q.iter().all(|q| q.is_finite());
        if !readable || self.sensing.is_outdated() || data.q.iter().any(|q| !q.is_finite()) {
            return;
        }
        match self.sensing.facts().gravity_by {
            GravityBy::Controller => self.torque_desired.copy_from(&data.gravity),
            GravityBy::Robot => self.torque_desired.fill(0.0),
        }
        self.transformer.transform(data, self.torque_desired.as_slice(), self.q_desired.as_mut_slice());
        self.keep_within_reach();
        if check_finite(self.q_desired.as_slice()).is_ok() {
            self.transformer.sent(data, self.q_desired.as_slice());
            // A robot that refuses keeps its last set-point: on_missed_cycle says what that means.
            let _ = self.robot.set_positions(self.q_desired.as_slice());
        }
    }

    fn traces(&self) -> Option<Traces> {
        self.robot.traces()
    }

    fn visit_traces(&self, visit: &mut dyn FnMut(Trace<'_>)) {
        self.robot.visit_traces(visit);
    }
}

impl<R: PositionRobot> Observable for PositionBackend<R> {
    fn signals(&self) -> Vec<Signal> {
        vec![
            Signal::new("q_desired", "rad", &self.joints),
            Signal::new("set_point_speed", "rad/s", &self.joints),
            Signal::new("set_point_clamped", "1", &self.joints),
        ]
    }

    fn sample(&self, row: &mut Row<'_>) {
        row.put(self.q_desired.as_slice());
        row.put(self.speed.as_slice());
        row.put(self.clamped.as_slice());
    }
}

//! Stops of a control loop: what is sent, and what stops the robot.
//!
//! | stop | robots with `on_stop = "setpoints"` | others |
//! |---|---|---|
//! | planned end, request, fault | setpoints, one per cycle, until they rest; then the robot's own stop | the robot's own stop |
//! | the robot can't be read or refuses a command | the robot's own stop | the robot's own stop |
//! | second request | the robot's own stop | the robot's own stop |
//! | panic | the robot's own stop | the robot's own stop |
//!
//! Setpoints with declared limits of the drives come to rest within them. They go on in the direction of motion, also after a
//! collision: a robot whose own stop is faster declares `on_stop = "robot"`. A joint without such limits is braked by its servo: the
//! setpoint goes to where it balances the weight and is ahead of the measured position by v/kp, in steps of the joint's speed limit
//! times the period. That of a velocity robot balances the weight at once.
//!
//! While setpoints come to rest, the phase is [`Phase::Stopping`]: the controller commands nothing, and no further fault is found.

use super::{ControlLoop, Outgoing, Step, check_finite};
use crate::fault::Fault;
use crate::phase::Phase;
use opspace_backend::{CommandKind, DeviceFault, StopMethod};

/// Duration after which a stop ends at the latest, s: a robot that comes to rest more slowly has no useful limits.
const LONGEST_STOP_S: f64 = 10.0;

impl ControlLoop {
    /// Stops because the robot could not be read or rejected a command. The result has the last command if the state is
    /// known.
    pub fn fail(&mut self, fault: DeviceFault) -> Step<'_> {
        self.take_back();
        match self.phase {
            Phase::Stopped => {}
            // The fault or request that stopped the run remains its outcome.
            Phase::Stopping => self.abandon(),
            _ => return self.stop_for(Fault::Device(fault)),
        }
        self.result()
    }

    /// Stops without a command: the robot's own stop follows.
    pub(crate) fn abandon(&mut self) {
        self.phase = Phase::Stopped;
        self.outgoing = Outgoing::None;
        self.torque_desired.fill(f64::NAN);
        self.command.fill(f64::NAN);
    }

    /// Stops on request. The result has the first command of the stop, which replaces the command of this cycle.
    pub fn stop(&mut self) -> Step<'_> {
        self.take_back();
        if self.phase != Phase::Stopped && self.phase != Phase::Stopping {
            self.enter_stop();
        }
        self.result()
    }

    /// Takes back the command of this cycle, which another one replaces.
    fn take_back(&mut self) {
        if let Some(guard) = self.guard.as_mut().filter(|_| self.outgoing == Outgoing::Setpoint) {
            guard.replace();
        }
        self.outgoing = Outgoing::None;
    }

    /// Latches the fault, fills the row and stops.
    pub(super) fn stop_for(&mut self, fault: Fault) -> Step<'_> {
        self.fault = Some(fault);
        self.outgoing = Outgoing::None;
        self.fill_row();
        self.enter_stop();
        self.result()
    }

    fn enter_stop(&mut self) {
        self.phase = Phase::Stopped;
        if self.brakes_by_setpoints() && self.begin_stop() {
            self.come_to_rest();
        }
        self.torque_desired.fill(f64::NAN);
        self.command.fill(f64::NAN);
    }

    /// True unless the robot's own stop brakes it alone. After a fault of the device there may be no cycles in which setpoints come
    /// to rest.
    fn brakes_by_setpoints(&self) -> bool {
        let may_be_silent = matches!(self.fault, Some(Fault::Device(_)));
        self.capabilities.on_stop == StopMethod::Setpoints && !may_be_silent
    }

    /// Computes the next setpoints of a stop.
    pub(super) fn come_to_rest(&mut self) {
        let missed = self.state.estimator.missed();
        let Some(guard) = &mut self.guard else { return };
        self.stopping_s += self.capabilities.period_s;
        let is_last = guard.come_to_rest(missed) || self.stopping_s > LONGEST_STOP_S;
        self.phase = if is_last { Phase::Stopped } else { Phase::Stopping };
        if check_finite(guard.setpoint()).is_err() {
            return self.abandon();
        }
        self.transformer.sent(&self.state.data, guard.setpoint());
        self.outgoing = Outgoing::Setpoint;
    }

    /// Computes the setpoints at which joints without limits of the drives are stopped. For a position robot they balance the weight
    /// and are ahead of the measured positions by v/kp; the robot keeps them, and the stiff servos stop the arm. For a velocity robot the servos'
    /// damping brakes the arm. If the state is unknown or outdated, the previous setpoints remain. Returns false if no setpoint
    /// is to be sent.
    fn begin_stop(&mut self) -> bool {
        let estimator = &self.state.estimator;
        let unknown = !estimator.is_known() || self.state.data.q.iter().any(|q| !q.is_finite());
        for i in 0..self.torque_desired.len() {
            self.torque_desired[i] = self.holding_torque(i);
        }
        let estimator = &self.state.estimator;
        let Some(guard) = &mut self.guard else { return false };
        guard.stop_watching();
        if unknown || estimator.is_outdated() {
            return guard.begin_stop_at_previous();
        }
        let torque = self.torque_desired.as_slice();
        if self.capabilities.command == CommandKind::Velocity {
            guard.brake(torque);
        } else {
            self.transformer.transform(&self.state.data, torque, guard.setpoint_mut());
        }
        guard.keep_within_reach(estimator.measurement());
        guard.begin_stop();
        true
    }
}

//! Limits of the drives on the sequence of setpoints, and their reaction.

use crate::config::ArmConfig;
use crate::fault;
use opspace_backend::{CommandKind, DeviceFault};
use opspace_transformer::{SetpointLimit, SetpointReaction, SetpointStream};

/// Check of the setpoints of an arm at its interface.
pub(crate) struct SetpointCheck {
    reaction: SetpointReaction,
    streams: Vec<SetpointStream>,
    /// Setpoints that act, after the reaction (n).
    values: Vec<f64>,
    /// 1 for each joint whose last setpoint was beyond a limit (n).
    limited: Vec<f64>,
    /// Fault of each joint and limit, which is taken from here when it occurs.
    faults: Vec<[DeviceFault; 3]>,
    /// True if setpoints were written in this cycle.
    written: bool,
}

impl SetpointCheck {
    /// Returns the check of an arm whose profile has limits, before its first setpoint; a robot that takes torques has
    /// no setpoints.
    pub fn new(config: &ArmConfig) -> Option<Self> {
        let takes = config.capabilities.command;
        let parameters = config.profile.setpoint_limits.as_ref().filter(|_| takes != CommandKind::Torque)?;
        let n = config.model.n();
        let units = config.model.joint_units();
        let joint = |(i, name): (usize, &str)| {
            let limits = parameters.joint.get(name).copied().unwrap_or_default();
            let values = [limits.velocity_rad_per_s, limits.acceleration_rad_per_s2, limits.jerk_rad_per_s3];
            let position = units.position[i];
            let faults = [0, 1, 2].map(|k| {
                let limit = values[k].map_or(f64::INFINITY, |limit| limit.get());
                fault::setpoint_limit(name, SetpointLimit::ALL[k], limit, position)
            });
            (SetpointStream::new(&limits, takes, config.profile.period_s()), faults)
        };
        let names = config.model.joints().iter().map(|joint| joint.name.as_str());
        let (streams, faults) = names.enumerate().map(joint).unzip();
        Some(Self {
            reaction: parameters.reaction,
            streams,
            values: vec![0.0; n],
            limited: vec![0.0; n],
            faults,
            written: false,
        })
    }

    /// 1 for each joint whose setpoint of the last cycle was beyond a limit (n).
    pub fn limited(&self) -> &[f64] {
        &self.limited
    }

    /// Begins an interface cycle: without a setpoint in the last one, the drives have kept theirs.
    pub fn begin_cycle(&mut self) {
        if !self.written {
            self.streams.iter_mut().for_each(SetpointStream::keep);
        }
        self.written = false;
        self.limited.fill(0.0);
    }

    /// Forgets the setpoints: the robot holds itself.
    pub fn restart(&mut self) {
        self.streams.iter_mut().for_each(SetpointStream::restart);
        // A velocity robot holds itself with a velocity of zero; the first position is accepted anyway.
        self.values.fill(0.0);
    }

    /// Returns the setpoints (n; rad, m; rad/s, m/s) that act after those that were commanded.
    pub fn apply(&mut self, commanded: &[f64]) -> Result<&[f64], DeviceFault> {
        self.written = true;
        for (i, stream) in self.streams.iter_mut().enumerate() {
            let exceeded = stream.exceeds(commanded[i]);
            self.limited[i] = f64::from(u8::from(exceeded.is_some()));
            self.values[i] = match (exceeded, self.reaction) {
                (None, _) => commanded[i],
                (Some(_), SetpointReaction::Clamp) => stream.clamp(commanded[i]),
                (Some(_), SetpointReaction::Refuse) => {
                    stream.take(commanded[i]);
                    continue;
                }
                (Some(limit), _) => {
                    let index = SetpointLimit::ALL.iter().position(|other| *other == limit);
                    let fault = index.and_then(|index| self.faults[i].get_mut(index));
                    // Taken, not cloned: the control cycle allocates nothing.
                    return Err(
                        fault.map_or_else(fault::stopped, |fault| std::mem::replace(fault, fault::stopped()))
                    );
                }
            };
            stream.take(self.values[i]);
        }
        Ok(&self.values)
    }
}

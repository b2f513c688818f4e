//! A robot behind topics, as a robot of opspace.

use crate::config::{CommandType, EffortMeaning, RosConfig};
use crate::fault::RosFault;
use crate::following::FollowWatch;
use crate::link::{Link, RowLayout};
use crate::pace::Pace;
use opspace_backend::{
    Backend, Capabilities, Command, CommandKind, DeviceFault, Measured, Sample, Setpoints, Status,
};
use std::time::{Duration, Instant};

/// Number of times that the last command is sent after a run.
const LAST_COMMANDS: u32 = 5;

/// Time between two of them.
const LAST_COMMAND_INTERVAL: Duration = Duration::from_millis(20);

/// A robot behind topics.
///
/// [`read`](Backend::read) waits for the next state: the robot sets the pace. States that were overtaken by the next one are
/// skipped, which is a gap in the times of the samples. The status word of a sample is the time since the arrival of the state
/// before, in µs.
pub struct RosArm {
    link: Link,
    capabilities: Capabilities,
    layout: RowLayout,
    row: Vec<f64>,
    command: Vec<f64>,
    has_command: bool,
    has_stopped: bool,
    silence: Duration,
    silent: DeviceFault,
    not_following: DeviceFault,
    wrong_command: DeviceFault,
    not_sent: DeviceFault,
    following: Option<FollowWatch>,
    pace: Pace,
}

impl RosArm {
    /// Returns the robot on a connection.
    #[must_use]
    pub fn new(link: Link, config: &RosConfig) -> Self {
        let layout = RowLayout::of(config);
        let n = layout.joints;
        Self {
            link,
            capabilities: capabilities(config),
            layout,
            row: vec![0.0; layout.width()],
            command: vec![0.0; n],
            has_command: false,
            has_stopped: false,
            silence: config.silence,
            silent: RosFault::StatesSilent.device_fault(&format!("for {} s", config.silence.as_secs_f64())),
            not_following: RosFault::NotFollowing.device_fault(""),
            wrong_command: RosFault::WrongCommand.device_fault(""),
            not_sent: RosFault::ClientFailed.device_fault("commands were not sent in time"),
            following: config.not_following.map(|limit| FollowWatch::new(n, limit)),
            pace: Pace::new(config.period_s),
        }
    }

    /// Intervals of the states so far.
    #[must_use]
    pub fn pace(&self) -> &Pace {
        &self.pace
    }

    /// Ends the connection; the robot keeps its last command. After a run that has stopped it is sent several times, as one that is
    /// lost would not be sent again.
    pub fn close(mut self) {
        for _ in 0..LAST_COMMANDS {
            if self.has_stopped {
                self.send_last();
            }
            std::thread::sleep(LAST_COMMAND_INTERVAL);
        }
        self.link.close();
    }

    /// Sends the last command once more. A ring that is full has the last ones.
    fn send_last(&mut self) {
        let _ = self.link.send(&self.command);
    }

    /// Fills the sample from the last row.
    fn fill(&self, sample: &mut Sample) {
        let RowLayout { joints, velocities, efforts, .. } = self.layout;
        let (head, rest) = self.row.split_at(2);
        let (q, rest) = rest.split_at(joints);
        let (dq, rest) = rest.split_at(velocities);
        let (effort, wrenches) = rest.split_at(efforts);
        sample.time_s = head[0];
        sample.q.copy_from_slice(q);
        for (to, from) in
            [(&mut sample.dq, dq), (&mut sample.motor_torque, effort), (&mut sample.joint_torque, effort)]
        {
            if let Some(to) = to {
                to.copy_from_slice(from);
            }
        }
        for (to, from) in sample.wrenches.iter_mut().zip(wrenches.chunks_exact(6)) {
            to.copy_from_slice(from);
        }
        sample.status = Some(Status::new((1e6 * head[1]) as u32, false));
    }
}

impl Backend for RosArm {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        self.link.attach();
        let began = Instant::now();
        loop {
            if let Some(fault) = self.link.fault() {
                return Err(fault.clone());
            }
            let states = self.link.take_newest(&mut self.row);
            if states > 0 {
                self.pace.skipped += states as u64 - 1;
                break;
            }
            let waited = began.elapsed();
            if waited >= self.silence {
                return Err(self.silent.clone());
            }
            self.link.wait(self.silence - waited);
        }
        self.pace.add(self.row[1]);
        self.fill(sample);
        let is_left_behind = match &mut self.following {
            Some(watch) if self.has_command => watch.is_left_behind(sample.time_s, &sample.q, &self.command),
            _ => false,
        };
        if is_left_behind { Err(self.not_following.clone()) } else { Ok(()) }
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        let kind = self.capabilities.command;
        if let (Command::Hold, Some(watch)) = (command, &mut self.following) {
            watch.restart();
        }
        match command {
            // The controller keeps the last position.
            Command::Hold if kind == CommandKind::Position => return Ok(()),
            Command::Hold => self.command.fill(0.0),
            Command::Position(values) | Command::Velocity(values) | Command::Torque(values) => {
                if command.kind() != Some(kind) || values.iter().any(|value| !value.is_finite()) {
                    return Err(self.wrong_command.clone());
                }
                self.command.copy_from_slice(values);
            }
        }
        self.has_command = true;
        if self.link.send(&self.command) { Ok(()) } else { Err(self.not_sent.clone()) }
    }

    /// Sends the last position once more, or velocities or efforts of zero; nothing to a robot that was not commanded.
    fn stop(&mut self) {
        if !self.has_command {
            return;
        }
        if self.capabilities.command != CommandKind::Position {
            self.command.fill(0.0);
        }
        self.has_stopped = true;
        self.send_last();
    }
}

fn capabilities(config: &RosConfig) -> Capabilities {
    let mut measured = Vec::new();
    if config.measures_velocity {
        measured.push(Measured::Velocity);
    }
    match config.effort {
        Some(EffortMeaning::MotorTorque) => measured.push(Measured::MotorCurrent),
        Some(EffortMeaning::JointTorque) => measured.push(Measured::JointTorque),
        None => {}
    }
    let setpoints = match config.command_type {
        CommandType::Float64MultiArray => Setpoints::Held,
        // The controller moves to the point of a trajectory.
        CommandType::JointTrajectory(_) => Setpoints::Interpolated,
    };
    Capabilities::new(config.joints.clone(), config.command, config.period_s)
        .with_setpoints(setpoints)
        .with_gravity_compensated_by(config.gravity_compensated_by)
        .with_brakes(config.has_brakes)
        .measuring(&measured)
        .with_force_sensors(config.force_sensors.clone())
        .with_status()
}

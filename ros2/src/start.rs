//! Start: the robot is found, its states are read, and its rate is measured, before anything is commanded.

use crate::config::{ClockSource, CommandType, RosConfig};
use crate::messages::{Float64MultiArray, JointState, JointTrajectory, Named};
use crate::node::{Endpoints, RobotTopics, publisher_of};
use crate::states::{Failure, RobotState, StateReader};
use crate::tare::Tare;
use crate::wrenches::WrenchReader;
use opspace_backend::DriverError;
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Time for which states are read before the robot is used: others on its topics are discovered meanwhile.
const LOOK: Duration = Duration::from_millis(700);

/// Least number of states after which their rate is known.
const STATES: u64 = 20;

/// Time between two looks at the topics.
const POLL: Duration = Duration::from_millis(1);

/// Largest relative difference of the stated and the measured period.
const SAME_PERIOD: f64 = 0.1;

/// Robot that was found on its topics.
pub struct FoundRobot {
    /// Reader of its states.
    pub reader: StateReader,
    /// Reader of its force sensors.
    pub wrenches: WrenchReader,
    /// Zero of the times of arrival.
    pub began: Instant,
    /// Mean interval of its states, s.
    pub period_s: f64,
}

/// Waits until the robot is there: its states, a subscriber of its commands, and its force sensors.
///
/// # Errors
/// Topics that are missing when the time is over, with those that are there in their place; a fault of the states; another program
/// that publishes commands; states at another rate than the profile's.
pub fn find(topics: &RobotTopics, config: &RosConfig, tare: &Tare) -> Result<FoundRobot, DriverError> {
    let began = Instant::now();
    let mut search = Search::new(config, began, tare);
    let graph = topics.node.graph();
    let commands = config.whole_name(&config.commands);
    let mut next_look = began;
    let mut endpoints = Endpoints::default();
    loop {
        search.read(topics)?;
        let now = Instant::now();
        if now >= next_look {
            endpoints = graph.endpoints(&commands);
            check_commands(config, &commands, &endpoints)?;
            next_look = now + Duration::from_millis(50);
        }
        let missing = search.missing(config, &endpoints);
        if missing.is_empty() && search.is_long_enough(now) {
            break;
        }
        if now - began > config.discovery {
            let topics = graph.topics::<JointState>();
            return Err(DriverError::new(not_found(config, &missing, &topics)));
        }
        sleep(POLL);
    }
    let period_s = search.period_s(config.clock);
    // False for NaN.
    let is_same = (period_s / config.period_s - 1.0).abs() <= SAME_PERIOD;
    if !is_same {
        let words = format!(
            "{} comes every {:.2} ms, a cycle of the profile takes {:.2} ms: state servo_ticks_per_cycle and servo_hz for \
             {:.0} Hz, or let the driver publish at {:.0} Hz",
            config.whole_name(&config.states),
            1e3 * period_s,
            1e3 * config.period_s,
            1.0 / period_s,
            1.0 / config.period_s
        );
        return Err(DriverError::at("states", words));
    }
    let Search { reader, wrenches, .. } = search;
    Ok(FoundRobot { reader, wrenches, began, period_s })
}

/// Search for a robot.
struct Search {
    reader: StateReader,
    wrenches: WrenchReader,
    state: RobotState,
    began: Instant,
    first: Option<Instant>,
    last: Option<Instant>,
    /// Names of the joints of messages without a joint of the robot.
    other_joints: Vec<String>,
    has_wrench: Vec<bool>,
}

impl Search {
    fn new(config: &RosConfig, began: Instant, tare: &Tare) -> Self {
        Self {
            reader: StateReader::new(config),
            wrenches: WrenchReader::new(config, tare.clone()),
            state: RobotState::default(),
            began,
            first: None,
            last: None,
            other_joints: Vec::new(),
            has_wrench: vec![false; config.wrenches.len()],
        }
    }

    /// Reads what has arrived.
    fn read(&mut self, topics: &RobotTopics) -> Result<(), DriverError> {
        let failed =
            |error: ros2_client::ReadError| DriverError::new(format!("a message cannot be read: {error:?}"));
        while let Some((message, info)) = topics.states.take().map_err(failed)? {
            let now = Instant::now();
            let arrival_s = (now - self.began).as_secs_f64();
            let is_new = self.reader.read(&message, publisher_of(&info), arrival_s, &mut self.state);
            if is_new.map_err(at_start)? {
                self.first.get_or_insert(now);
                self.last = Some(now);
            } else if self.reader.counts().states == 0 {
                self.other_joints.clone_from(&message.name);
            }
        }
        for (sensor, wrenches) in topics.wrenches.iter().enumerate() {
            while let Some((message, _)) = wrenches.take().map_err(failed)? {
                let arrival_s = self.began.elapsed().as_secs_f64();
                self.wrenches.read(sensor, &message, arrival_s).map_err(at_start)?;
                self.has_wrench[sensor] = true;
            }
        }
        Ok(())
    }

    fn is_long_enough(&self, now: Instant) -> bool {
        self.reader.counts().states >= STATES && self.first.is_some_and(|first| now - first >= LOOK)
    }

    /// Mean interval of the states, s: on their own clock, which that of a simulator need not keep up with, or of arrivals.
    fn period_s(&self, clock: ClockSource) -> f64 {
        let (Some(first), Some(last)) = (self.first, self.last) else { return f64::NAN };
        let whole_s = match clock {
            // The first state is at zero.
            ClockSource::Stamp => self.state.time_s,
            ClockSource::Arrival => (last - first).as_secs_f64(),
        };
        whole_s / (self.reader.counts().states as f64 - 1.0)
    }

    /// Describes what is missing.
    fn missing(&self, config: &RosConfig, commands: &Endpoints) -> Vec<String> {
        let mut missing = Vec::new();
        if self.reader.counts().states == 0 {
            let states = config.whole_name(&config.states);
            missing.push(if self.other_joints.is_empty() {
                format!("no state comes on {states}")
            } else {
                format!(
                    "{states} has no joint of the robot: its joints are {}, those of robot.toml {}",
                    self.other_joints.join(", "),
                    config.joints.join(", ")
                )
            });
        }
        if commands.subscribers == 0 {
            missing.push(format!(
                "nothing subscribes to {}: its controller is not loaded",
                config.whole_name(&config.commands)
            ));
        }
        for (topic, _) in config.wrenches.iter().zip(&self.has_wrench).filter(|(_, is_there)| !**is_there) {
            missing.push(format!("no wrench comes on {}", config.whole_name(topic)));
        }
        missing
    }
}

/// Refuses a second commander, and subscribers of another type.
fn check_commands(config: &RosConfig, topic: &str, endpoints: &Endpoints) -> Result<(), DriverError> {
    if !endpoints.publishers.is_empty() {
        let words = format!(
            "{} other publishers on {topic}: end them first, as the controller would follow both",
            endpoints.publishers.len()
        );
        return Err(DriverError::at("commands", words));
    }
    let wanted = match config.command_type {
        CommandType::Float64MultiArray => Float64MultiArray::type_name(),
        CommandType::JointTrajectory(_) => JointTrajectory::type_name(),
    };
    match endpoints.types.iter().find(|type_name| **type_name != wanted.dds_msg_type()) {
        None => Ok(()),
        Some(other) => {
            let words = format!(
                "{topic} has type {other}, not {}/{}: state another topic, or command_type",
                wanted.package_name(),
                wanted.type_name()
            );
            Err(DriverError::at("commands", words))
        }
    }
}

fn not_found(config: &RosConfig, missing: &[String], topics: &[String]) -> String {
    let what = if missing.is_empty() { "too few states came".to_owned() } else { missing.join("; ") };
    let others = if topics.is_empty() { "none".to_owned() } else { topics.join(", ") };
    format!(
        "the robot was not found within {} s: {what}. Topics with joint states in domain {}: {others}",
        config.discovery.as_secs_f64(),
        config.place.domain
    )
}

fn at_start((fault, details): Failure) -> DriverError {
    DriverError::new(fault.device_fault(&details).to_string())
}

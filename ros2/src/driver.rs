//! The driver `ros2` of `[driver]` in robot.toml.

use crate::arm::RosArm;
use crate::config::{DRIVER, NodePlace, RosConfig};
use crate::link::Link;
use crate::messages::{Float64MultiArray, JointState, JointTrajectory, Text, WrenchStamped};
use crate::node::RobotTopics;
use crate::program::Program;
use crate::start;
use opspace_backend::{Backend, CommandKind, Driver, DriverError, DriverWarning, FoundDevice, Settings};
use std::time::{Duration, Instant};

/// Time for which `scan` looks for topics.
const SCAN: Duration = Duration::from_secs(3);

/// Driver of robots behind topics of ROS 2. Its keys are [`KEYS`](crate::config::KEYS).
#[derive(Clone, Default)]
pub struct Ros2Driver {
    program: Program,
}

impl Ros2Driver {
    /// Returns the driver of a program.
    #[must_use]
    pub fn new(program: Program) -> Self {
        Self { program }
    }
}

impl Driver for Ros2Driver {
    fn name(&self) -> &str {
        DRIVER
    }

    fn check(&self, settings: &Settings) -> Result<Vec<DriverWarning>, DriverError> {
        RosConfig::from_settings(settings).map(|_| Vec::new())
    }

    fn with(&self, settings: &Settings, run: &mut dyn FnMut(&mut dyn Backend)) -> Result<(), DriverError> {
        let config = RosConfig::from_settings(settings)?;
        let topics = RobotTopics::open(&self.program.participants, &config)?;
        let found = start::find(&topics, &config, &self.program.tare)?;
        let link = Link::start(topics, found, &config)?;
        let mut arm = RosArm::new(link, &config);
        run(&mut arm);
        if arm.pace().count() > 1 {
            self.program.reports.add(arm.pace().to_string());
        }
        arm.close();
        Ok(())
    }

    /// Lists the joint states, controllers and force sensors of a domain, `place`, or of that of the environment.
    fn scan(&self, place: Option<&str>) -> Result<Vec<FoundDevice>, DriverError> {
        let mut settings = Settings::new(CommandKind::Position, Vec::new(), 0.0);
        if let Some(place) = place {
            let number = place.parse().map_err(|_| {
                DriverError::new(format!("the place of a search is the number of a domain, not '{place}'"))
            })?;
            settings = settings.with("domain", opspace_backend::Setting::Number(number));
        }
        let place = NodePlace::from_settings(&settings)?;
        let mut node = self.program.participants.node(&place, "_scan")?;
        let graph = node.graph();
        let began = Instant::now();
        while began.elapsed() < SCAN {
            std::thread::sleep(Duration::from_millis(100));
        }
        let mut found = Vec::new();
        let mut list = |topics: Vec<String>, key: &str, what: &str| {
            found.extend(topics.into_iter().map(|topic| FoundDevice {
                place: format!("domain = {}, {key} = \"{topic}\"", place.domain),
                description: what.to_owned(),
            }));
        };
        list(
            graph.topics::<Float64MultiArray>(),
            "commands",
            "commands of a controller, an array of numbers",
        );
        list(
            graph.topics::<JointTrajectory>(),
            "command_type = \"joint-trajectory\", commands",
            "commands of a controller, trajectories",
        );
        list(graph.topics::<WrenchStamped>(), "wrenches", "wrenches, possibly of a force sensor");
        list(graph.topics::<Text>(), "description", "text, possibly a robot description");
        let states = graph.topics::<JointState>();
        for topic in states {
            let joints = joints_on(&mut node, &topic)?;
            let joints = if joints.is_empty() { "none so far".to_owned() } else { joints.join(", ") };
            found.push(FoundDevice {
                place: format!("domain = {}, states = \"{topic}\"", place.domain),
                description: format!("states of joints: {joints}"),
            });
        }
        Ok(found)
    }
}

/// Names of the joints of the first message of a topic.
fn joints_on(node: &mut crate::node::RosNode, topic: &str) -> Result<Vec<String>, DriverError> {
    let states = node.subscribe::<JointState>(topic, &crate::config::profile(false, 1))?;
    let began = Instant::now();
    while began.elapsed() < SCAN {
        if let Ok(Some((message, _))) = states.take() {
            return Ok(message.name);
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    Ok(Vec::new())
}

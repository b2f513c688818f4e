//! Configuration of a robot behind topics: the keys of `[driver]` in robot.toml.

use opspace_backend::{CommandKind, DriverError, ForceSensor, GravityCompensation, Measured, Settings};
use ros2_client::qos::{Durability, History, Reliability, WhenFull};
use ros2_client::{Name, NodeName, QosProfile};
use std::time::Duration;

/// Name of the driver.
pub const DRIVER: &str = "ros2";

/// Keys of `[driver]`.
pub const KEYS: [&str; 25] = [
    "domain",
    "namespace",
    "node",
    "states",
    "states_qos",
    "clock",
    "effort",
    "commands",
    "commands_qos",
    "command_type",
    "command_joints",
    "trajectory_s",
    "wrenches",
    "wrenches_inverted",
    "zero_effort_holds",
    "discovery_s",
    "silence_s",
    "clock_jump_s",
    "not_following_rad",
    "not_following_rad_per_s",
    "not_following_nm",
    "targets",
    "output_hz",
    "target_age_s",
    "service_mapping",
];

/// Largest number of a domain for which DDS has ports.
const MAX_DOMAIN: f64 = 232.0;

/// Configuration of a robot behind topics.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct RosConfig {
    /// Place of the node.
    pub place: NodePlace,
    /// Kind of the commands.
    pub command: CommandKind,
    /// Joint names, in the order of the model (n).
    pub joints: Vec<String>,
    /// Period of a cycle, s.
    pub period_s: f64,
    /// Topic of the states.
    pub states: String,
    /// True if lost states are sent again.
    pub states_reliable: bool,
    /// Clock of the samples.
    pub clock: ClockSource,
    /// True if samples contain the velocities of the states.
    pub measures_velocity: bool,
    /// Side that compensates gravity, as robot.toml states it: no topic tells.
    pub gravity_compensated_by: GravityCompensation,
    /// True if robot.toml states brakes.
    pub has_brakes: bool,
    /// Meaning of the efforts of the states; `None` if samples do not contain them.
    pub effort: Option<EffortMeaning>,
    /// Topic of the commands.
    pub commands: String,
    /// True if lost commands are sent again.
    pub commands_reliable: bool,
    /// Type of the commands.
    pub command_type: CommandType,
    /// For each element of a command, the number of its joint (n).
    pub command_order: Vec<usize>,
    /// Topics of the force sensors, in their order.
    pub wrenches: Vec<String>,
    /// Force sensors, in the order of the samples.
    pub force_sensors: Vec<ForceSensor>,
    /// True if the sensors report the force of the robot on its environment.
    pub wrenches_inverted: bool,
    /// Longest time to wait for the robot at the start.
    pub discovery: Duration,
    /// Time without states that is a fault.
    pub silence: Duration,
    /// Difference of the states' clock and that of the computer, between two states, that is a jump, s.
    pub clock_jump_s: f64,
    /// Change of a command that no joint follows and that is a fault, rad, rad/s or Nm (m, m/s, N); `None` is never.
    pub not_following: Option<f64>,
}

/// Place of a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodePlace {
    /// Number of the domain.
    pub domain: u16,
    /// Namespace, from the root on.
    pub namespace: String,
    /// Name.
    pub node: String,
}

/// Clock of the samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClockSource {
    /// The stamps of the states.
    Stamp,
    /// The computer's clock at the arrival of the states, smoothed.
    Arrival,
}

/// Meaning of the efforts of joint states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EffortMeaning {
    /// Motor torques at the joints.
    MotorTorque,
    /// Torques of sensors at the joints.
    JointTorque,
}

/// Type of the commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommandType {
    /// `std_msgs/Float64MultiArray`, for `forward_command_controller` and its kind.
    Float64MultiArray,
    /// `trajectory_msgs/JointTrajectory` of one point, which is to be reached after this time.
    JointTrajectory(Duration),
}

/// Options of the targets, outputs and services of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct InterfaceConfig {
    /// Rate of the outputs, Hz.
    pub output_hz: f64,
    /// Age beyond which a stamped target is dropped, s.
    pub target_age_s: f64,
    /// True if services are mapped to topics as Cyclone DDS maps them.
    pub cyclone_services: bool,
}

impl RosConfig {
    /// Reads the configuration from the keys of `[driver]`.
    ///
    /// # Errors
    /// If a key is missing, unknown or wrong.
    pub fn from_settings(settings: &Settings) -> Result<Self, DriverError> {
        settings.expect_only(&KEYS)?;
        InterfaceConfig::from_settings(settings)?;
        let place = NodePlace::from_settings(settings)?;
        let command_type = command_type(settings)?;
        if let (CommandType::JointTrajectory(_), CommandKind::Velocity | CommandKind::Torque) =
            (command_type, settings.command)
        {
            let words = format!(
                "a joint trajectory has positions, not the kind of command of this run, {}",
                settings.command.name()
            );
            return Err(DriverError::at("command_type", words));
        }
        if settings.command == CommandKind::Torque && !settings.flag("zero_effort_holds")? {
            let words = "at the end the node commands zero effort: state zero_effort_holds = true if brakes or the robot's \
                         own gravity compensation then hold the arm; an arm that would fall needs a position interface";
            return Err(DriverError::at("zero_effort_holds", words));
        }
        Ok(Self {
            place,
            command: settings.command,
            joints: settings.joints.clone(),
            period_s: settings.period_s,
            states: topic(settings, "states", "joint_states")?,
            states_reliable: is_reliable(settings, "states_qos", false)?,
            clock: choice(
                settings,
                "clock",
                &[("stamp", ClockSource::Stamp), ("arrival", ClockSource::Arrival)],
            )?
            .unwrap_or(ClockSource::Stamp),
            measures_velocity: settings.measured.contains(&Measured::Velocity),
            gravity_compensated_by: settings.gravity_compensated_by,
            has_brakes: settings.has_brakes,
            effort: effort(settings)?,
            commands: topic(settings, "commands", default_commands(settings.command, command_type))?,
            commands_reliable: is_reliable(settings, "commands_qos", true)?,
            command_type,
            command_order: command_order(settings)?,
            wrenches: wrenches(settings)?,
            force_sensors: settings.force_sensors.clone(),
            wrenches_inverted: settings.flag("wrenches_inverted")?,
            discovery: settings.seconds("discovery_s", 10.0)?,
            silence: settings.seconds("silence_s", 0.1)?,
            clock_jump_s: settings.seconds("clock_jump_s", 0.2)?.as_secs_f64(),
            not_following: not_following(settings)?,
        })
    }

    /// Resolves a topic of the configuration to its whole name.
    #[must_use]
    pub fn whole_name(&self, topic: &str) -> String {
        self.place.whole_name(topic)
    }

    /// Profile of the subscription to states and wrenches.
    #[must_use]
    pub fn states_profile(&self) -> QosProfile {
        profile(self.states_reliable, 1)
    }

    /// Profile of the publisher of commands.
    #[must_use]
    pub fn commands_profile(&self) -> QosProfile {
        profile(self.commands_reliable, 1)
    }
}

impl NodePlace {
    /// Reads the place of the node. Without a key, the domain is that of the environment variable ROS_DOMAIN_ID, or 0.
    ///
    /// # Errors
    /// A domain without ports, or a wrong name.
    pub fn from_settings(settings: &Settings) -> Result<Self, DriverError> {
        let text = |key: &str, default: &str| match settings.contains(key) {
            true => settings.text(key).map(str::to_owned),
            false => Ok(default.to_owned()),
        };
        let namespace = text("namespace", "/")?;
        let namespace = format!("/{}", namespace.trim_matches('/'));
        let node = text("node", "opspace")?;
        if let Err(error) = NodeName::new(&namespace, &node) {
            let words =
                format!("{namespace} and {node} are no namespace and name of a node of ROS 2: {error:?}");
            return Err(DriverError::at("node", words));
        }
        let from_environment =
            || std::env::var("ROS_DOMAIN_ID").ok().and_then(|text| text.trim().parse().ok());
        let domain = match settings.contains("domain") {
            true => settings.number("domain")?,
            false => from_environment().unwrap_or(0.0),
        };
        if domain.fract() != 0.0 || !(0.0..=MAX_DOMAIN).contains(&domain) {
            let words = format!("'domain' must be a whole number of 0 to {MAX_DOMAIN}, not {domain}");
            return Err(DriverError::at("domain", words));
        }
        Ok(Self { domain: domain as u16, namespace, node })
    }

    /// Resolves a topic to its whole name.
    #[must_use]
    pub fn whole_name(&self, topic: &str) -> String {
        match topic.strip_prefix('/') {
            Some(_) => topic.to_owned(),
            None if self.namespace == "/" => format!("/{topic}"),
            None => format!("{}/{topic}", self.namespace),
        }
    }
}

impl InterfaceConfig {
    /// Reads the options; `None` if a robot has no targets, outputs and services.
    ///
    /// # Errors
    /// A wrong key.
    pub fn from_settings(settings: &Settings) -> Result<Option<Self>, DriverError> {
        let output_hz = settings.positive("output_hz")?.unwrap_or(50.0);
        let target_age_s = settings.positive("target_age_s")?.unwrap_or(0.5);
        let mappings = [("enhanced", false), ("cyclone", true)];
        let cyclone_services = choice(settings, "service_mapping", &mappings)?.unwrap_or(false);
        let is_on = !settings.contains("targets") || settings.flag("targets")?;
        Ok(is_on.then_some(Self { output_hz, target_age_s, cyclone_services }))
    }
}

/// Returns a profile that keeps the last messages.
#[must_use]
pub fn profile(is_reliable: bool, depth: usize) -> QosProfile {
    let reliability = if is_reliable {
        Reliability::Reliable { when_full: WhenFull::Fail }
    } else {
        Reliability::BestEffort
    };
    QosProfile::subscription_default().reliability(reliability).history(History::KeepLast { depth })
}

/// Returns a reliable profile that also gives late subscribers the last message.
#[must_use]
pub fn latched(depth: usize) -> QosProfile {
    profile(true, depth).durability(Durability::TransientLocal)
}

fn command_type(settings: &Settings) -> Result<CommandType, DriverError> {
    let named =
        choice(settings, "command_type", &[("float64-multi-array", false), ("joint-trajectory", true)])?;
    if named == Some(true) {
        let time = settings.seconds("trajectory_s", settings.period_s)?;
        return Ok(CommandType::JointTrajectory(time));
    }
    if settings.contains("trajectory_s") {
        return Err(DriverError::at(
            "trajectory_s",
            "'trajectory_s' is for command_type = \"joint-trajectory\"",
        ));
    }
    Ok(CommandType::Float64MultiArray)
}

/// Meaning of the efforts, which is to be what robot.toml states as measured.
fn effort(settings: &Settings) -> Result<Option<EffortMeaning>, DriverError> {
    let meanings =
        [("motor-torque", EffortMeaning::MotorTorque), ("joint-torque", EffortMeaning::JointTorque)];
    let meaning = choice(settings, "effort", &meanings)?;
    let measured = [(Measured::MotorCurrent, "motor-current", 0), (Measured::JointTorque, "joint-torque", 1)];
    for (quantity, name, number) in measured {
        let (key, own) = meanings[number];
        let (is_measured, is_read) = (settings.measured.contains(&quantity), meaning == Some(own));
        if is_measured && !is_read {
            let words = format!(
                "'measured' of [interface] has {name}: state effort = \"{key}\" if the efforts of the states are that, or remove it \
                 from 'measured'"
            );
            return Err(DriverError::at("effort", words));
        }
        if is_read && !is_measured {
            let words = format!("effort = \"{key}\" needs \"{name}\" in 'measured' of [interface]");
            return Err(DriverError::at("effort", words));
        }
    }
    Ok(meaning)
}

/// Change of a command that no joint follows and that is a fault.
fn not_following(settings: &Settings) -> Result<Option<f64>, DriverError> {
    let (key, default) = match settings.command {
        CommandKind::Position => ("not_following_rad", 0.1),
        CommandKind::Velocity => ("not_following_rad_per_s", 0.3),
        CommandKind::Torque => ("not_following_nm", 20.0),
    };
    let value = if settings.contains(key) { settings.number(key)? } else { default };
    if !(value.is_finite() && value >= 0.0) {
        return Err(DriverError::at(key, format!("'{key}' must be above 0, or 0 for never")));
    }
    Ok((value > 0.0).then_some(value))
}

/// Topics of the usual controllers.
fn default_commands(command: CommandKind, command_type: CommandType) -> &'static str {
    match (command_type, command) {
        (CommandType::JointTrajectory(_), _) => "joint_trajectory_controller/joint_trajectory",
        (_, CommandKind::Position) => "forward_position_controller/commands",
        (_, CommandKind::Velocity) => "forward_velocity_controller/commands",
        (_, CommandKind::Torque) => "forward_effort_controller/commands",
    }
}

fn command_order(settings: &Settings) -> Result<Vec<usize>, DriverError> {
    let joints = &settings.joints;
    let Some(names) = settings.texts("command_joints")? else { return Ok((0..joints.len()).collect()) };
    let find = |name: &&str| {
        joints.iter().position(|joint| joint == name).ok_or_else(|| {
            let words = format!("unknown joint '{name}'; the joints are: {}", joints.join(", "));
            DriverError::at("command_joints", words)
        })
    };
    let order: Vec<usize> = names.iter().map(find).collect::<Result<_, _>>()?;
    let missing = (0..joints.len()).find(|joint| !order.contains(joint));
    if let Some(joint) = missing {
        let words =
            format!("joint '{}' is missing: the controller gets all joints of the robot", joints[joint]);
        return Err(DriverError::at("command_joints", words));
    }
    if order.len() != joints.len() {
        return Err(DriverError::at("command_joints", "a joint is named twice"));
    }
    Ok(order)
}

fn wrenches(settings: &Settings) -> Result<Vec<String>, DriverError> {
    let sensors = &settings.force_sensors;
    let topics = settings.texts("wrenches")?.unwrap_or_default();
    for topic in &topics {
        check_name("wrenches", topic)?;
    }
    if topics.len() == sensors.len() {
        return Ok(topics.into_iter().map(str::to_owned).collect());
    }
    let names: Vec<&str> = sensors.iter().map(|sensor| sensor.name.as_str()).collect();
    let words = format!(
        "'wrenches' has {} topics, robot.toml has {} force sensors: {}",
        topics.len(),
        sensors.len(),
        if names.is_empty() { "none".to_owned() } else { names.join(", ") }
    );
    Err(DriverError::at("wrenches", words))
}

fn topic(settings: &Settings, key: &str, default: &str) -> Result<String, DriverError> {
    if !settings.contains(key) {
        return Ok(default.to_owned());
    }
    let topic = settings.text(key)?;
    check_name(key, topic)?;
    Ok(topic.to_owned())
}

fn check_name(key: &str, topic: &str) -> Result<(), DriverError> {
    Name::parse(topic).map(|_| ()).map_err(|_| {
        let words = format!(
            "'{topic}' is no name of a topic of ROS 2: letters, digits, single underscores, and slashes between parts"
        );
        DriverError::at(key, words)
    })
}

fn is_reliable(settings: &Settings, key: &str, default: bool) -> Result<bool, DriverError> {
    let chosen = choice(settings, key, &[("reliable", true), ("best-effort", false)])?;
    Ok(chosen.unwrap_or(default))
}

/// Returns the value of a name, if the key exists.
fn choice<T: Copy>(settings: &Settings, key: &str, choices: &[(&str, T)]) -> Result<Option<T>, DriverError> {
    if !settings.contains(key) {
        return Ok(None);
    }
    let name = settings.text(key)?;
    let found = choices.iter().find(|(known, _)| *known == name);
    found.map(|(_, value)| Some(*value)).ok_or_else(|| {
        let known: Vec<String> = choices.iter().map(|(known, _)| format!("\"{known}\"")).collect();
        DriverError::at(key, format!("'{key}' must be {}, not \"{name}\"", known.join(" or ")))
    })
}

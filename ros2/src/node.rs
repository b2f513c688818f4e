//! Node of ROS 2 for a robot: its subscriptions and its publisher, and who else is on these topics.

use crate::commands::CommandMessage;
use crate::config::{CommandType, NodePlace, RosConfig};
use crate::messages::{Float64MultiArray, JointState, JointTrajectory, Named, WrenchStamped};
use crate::states::Publisher as PublisherId;
use opspace_backend::DriverError;
use ros2_client::dds::rustdds::RTPSEntity;
use ros2_client::{
    Context, ContextOptions, Message, Name, Node, NodeName, NodeOptions, Publisher, QosProfile, Subscription,
};
use std::collections::BTreeMap;
use std::fmt::Debug;
use std::sync::{Arc, Mutex, PoisonError};

/// Participants of the program, one for each domain, which its nodes share.
#[derive(Clone, Default)]
pub struct Participants(Arc<Mutex<BTreeMap<u16, Context>>>);

impl Participants {
    /// Returns the participant of a domain, and creates it first if there is none.
    ///
    /// # Errors
    /// A participant that cannot be created: no network interface, for example.
    pub fn of(&self, domain: u16) -> Result<Context, DriverError> {
        let mut contexts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(context) = contexts.get(&domain) {
            return Ok(context.clone());
        }
        let context = Context::with_options(ContextOptions::new().domain_id(domain)).map_err(|error| {
            DriverError::new(format!("no participant of DDS can be created in domain {domain}: {error:?}"))
        })?;
        contexts.insert(domain, context.clone());
        Ok(context)
    }

    /// Forgets all participants: they end with their last node.
    pub fn clear(&self) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }

    /// Creates a node.
    ///
    /// # Errors
    /// A participant or a node that cannot be created.
    pub fn node(&self, place: &NodePlace, suffix: &str) -> Result<RosNode, DriverError> {
        let context = self.of(place.domain)?;
        let name = format!("{}{suffix}", place.node);
        let name = NodeName::new(&place.namespace, &name).map_err(|error| failed("node", &name, &error))?;
        let options = NodeOptions::new().enable_rosout(false).start_parameter_services(false);
        let node = context.new_node(name, options).map_err(|error| failed("node", &place.node, &error))?;
        Ok(RosNode { place: place.clone(), context, node })
    }
}

/// Node with its place.
pub struct RosNode {
    /// Place of the node.
    pub place: NodePlace,
    context: Context,
    /// The node.
    pub node: Node,
}

/// Publishers and subscribers of a topic in other programs.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Endpoints {
    /// Identifiers of the publishers.
    pub publishers: Vec<PublisherId>,
    /// Number of the subscribers.
    pub subscribers: usize,
    /// Types of the publishers and subscribers, as DDS has them.
    pub types: Vec<String>,
}

impl RosNode {
    /// Subscribes to a topic.
    ///
    /// # Errors
    /// A topic or a subscription that cannot be created.
    pub fn subscribe<M: Named>(
        &mut self,
        topic: &str,
        profile: &QosProfile,
    ) -> Result<Subscription<M>, DriverError> {
        let whole = self.place.whole_name(topic);
        let created = self.topic::<M>(&whole, profile)?;
        self.node.create_subscription(&created, None).map_err(|error| failed("subscription", &whole, &error))
    }

    /// Creates the publisher of a topic.
    ///
    /// # Errors
    /// A topic or a publisher that cannot be created.
    pub fn publisher<M: Named>(
        &mut self,
        topic: &str,
        profile: &QosProfile,
    ) -> Result<Publisher<M>, DriverError> {
        let whole = self.place.whole_name(topic);
        let created = self.topic::<M>(&whole, profile)?;
        self.node.create_publisher(&created, None).map_err(|error| failed("publisher", &whole, &error))
    }

    fn topic<M: Named>(
        &self,
        whole: &str,
        profile: &QosProfile,
    ) -> Result<ros2_client::dds::rustdds::Topic, DriverError> {
        let name = Name::parse(whole).map_err(|error| failed("topic", whole, &error))?;
        self.node.create_topic(&name, M::type_name(), profile).map_err(|error| failed("topic", whole, &error))
    }

    /// Watch of the topics that other programs have.
    #[must_use]
    pub fn graph(&self) -> Graph {
        Graph { context: self.context.clone() }
    }
}

/// Topics that other programs have, as far as they are discovered.
#[derive(Clone)]
pub struct Graph {
    context: Context,
}

impl Graph {
    /// Publishers and subscribers of a topic, by its whole name, in other programs.
    #[must_use]
    pub fn endpoints(&self, topic: &str) -> Endpoints {
        let participant = self.context.domain_participant();
        let name = format!("rt{topic}");
        let own = participant.guid().prefix;
        let mut found = Endpoints::default();
        for writer in participant.discovered_writers() {
            let is_own = writer.writer_proxy.remote_writer_guid.prefix == own;
            if writer.publication_topic_data.topic_name == name && !is_own {
                found.publishers.push(writer.writer_proxy.remote_writer_guid.to_bytes());
                found.types.push(writer.publication_topic_data.type_name);
            }
        }
        for reader in participant.discovered_readers() {
            let is_own = reader.reader_proxy.remote_reader_guid.prefix == own;
            if reader.subscription_topic_data.topic_name() == &name && !is_own {
                found.subscribers += 1;
                found.types.push(reader.subscription_topic_data.type_name().clone());
            }
        }
        found
    }

    /// Whole names of the topics that other programs publish or subscribe to with this type.
    #[must_use]
    pub fn topics<M: Named>(&self) -> Vec<String> {
        let participant = self.context.domain_participant();
        let wanted = M::type_name().dds_msg_type();
        let own = participant.guid().prefix;
        let written = participant.discovered_writers().into_iter();
        let written =
            written.filter(|writer| writer.writer_proxy.remote_writer_guid.prefix != own).map(|writer| {
                (writer.publication_topic_data.topic_name, writer.publication_topic_data.type_name)
            });
        let read = participant.discovered_readers().into_iter();
        let read = read.filter(|reader| reader.reader_proxy.remote_reader_guid.prefix != own).map(|reader| {
            (
                reader.subscription_topic_data.topic_name().clone(),
                reader.subscription_topic_data.type_name().clone(),
            )
        });
        let mut names: Vec<String> = written
            .chain(read)
            .filter(|(_, type_name)| *type_name == wanted)
            .filter_map(|(name, _)| name.strip_prefix("rt").map(str::to_owned))
            .collect();
        names.sort();
        names.dedup();
        names
    }
}

/// Publisher of commands.
pub enum Commander {
    /// Publisher of arrays.
    Array(Publisher<Float64MultiArray>),
    /// Publisher of trajectories.
    Trajectory(Publisher<JointTrajectory>),
}

impl Commander {
    /// Publishes a command; returns false if the client of DDS does not take it.
    #[must_use]
    pub fn publish(&self, message: CommandMessage) -> bool {
        match (self, message) {
            (Self::Array(publisher), CommandMessage::Array(message)) => publisher.publish(message).is_ok(),
            (Self::Trajectory(publisher), CommandMessage::Trajectory(message)) => {
                publisher.publish(message).is_ok()
            }
            _ => false,
        }
    }
}

/// Topics of a robot.
pub struct RobotTopics {
    /// The node.
    pub node: RosNode,
    /// Joint states.
    pub states: Subscription<JointState>,
    /// Wrenches, in the order of the force sensors.
    pub wrenches: Vec<Subscription<WrenchStamped>>,
    /// Commands.
    pub commander: Commander,
}

impl RobotTopics {
    /// Creates a node with the topics of a robot.
    ///
    /// # Errors
    /// If one of them cannot be created.
    pub fn open(participants: &Participants, config: &RosConfig) -> Result<Self, DriverError> {
        let mut node = participants.node(&config.place, "_driver")?;
        let states = node.subscribe(&config.states, &config.states_profile())?;
        let wrenches = config.wrenches.iter().map(|topic| node.subscribe(topic, &config.states_profile()));
        let wrenches = wrenches.collect::<Result<_, _>>()?;
        let profile = config.commands_profile();
        let commander = match config.command_type {
            CommandType::Float64MultiArray => Commander::Array(node.publisher(&config.commands, &profile)?),
            CommandType::JointTrajectory(_) => {
                Commander::Trajectory(node.publisher(&config.commands, &profile)?)
            }
        };
        Ok(Self { node, states, wrenches, commander })
    }
}

fn failed(what: &str, name: &str, error: &dyn Debug) -> DriverError {
    DriverError::new(format!("the {what} {name} cannot be created: {error:?}"))
}

/// Identifier of the publisher of a message.
#[must_use]
pub fn publisher_of(info: &ros2_client::MessageInfo) -> PublisherId {
    info.publisher_gid().to_bytes16()
}

/// Returns true for a message type that the node knows.
#[must_use]
pub fn is_known<M: Named + Message>(type_name: &str) -> bool {
    M::type_name().dds_msg_type() == type_name
}

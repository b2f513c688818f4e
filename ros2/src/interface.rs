//! Node of a running task: targets and services, in a thread that hands them over to the control loop.

use crate::config::{InterfaceConfig, NodePlace, latched, profile};
use crate::frames::Frames;
use crate::inputs::{self, Input};
use crate::messages::{
    Flag, Float64MultiArray, Named, PoseStamped, Stamp, Text, TfMessage, TriggerRequest, TriggerResponse,
    TwistStamped, WrenchStamped,
};
use crate::node::{Participants, RosNode};
use crate::tare::Tare;
use crate::wake::{Wake, Wakes};
use futures::stream::{LocalBoxStream, StreamExt, select_all};
use opspace_backend::DriverError;
use ros2_client::{
    MessageInfo, Name, ReadError, RmwRequestId, Server, ServiceMapping, ServiceTypeName, Subscription,
};
use rtrb::Producer;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{Builder, JoinHandle};

/// Task whose targets are topics.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TaskTopics {
    /// Name.
    pub name: String,
    /// True if it follows streamed poses and velocities.
    pub is_streamed: bool,
}

/// Description of the robot and its task, for the node.
pub struct InterfacePlan {
    /// Place of the node.
    pub place: NodePlace,
    /// Options.
    pub config: InterfaceConfig,
    /// Tasks, in the order of the inputs' numbers.
    pub tasks: Vec<TaskTopics>,
    /// Number of task sets.
    pub task_sets: u32,
    /// Frames of targets.
    pub frames: Frames,
    /// Stop request of the run.
    pub interrupt: Arc<AtomicBool>,
    /// Tare of the force sensors.
    pub tare: Tare,
}

/// Counts of targets, which the thread of the control loop may change too.
#[derive(Debug, Default)]
pub struct TargetCounts {
    /// Targets that were handed over.
    pub accepted: AtomicU64,
    /// Targets that were refused.
    pub refused: AtomicU64,
    /// Reason of the last refusal.
    last: Mutex<String>,
    /// True once it is known that the run has no inputs: then it cannot be held.
    pub has_no_inputs: AtomicBool,
}

impl TargetCounts {
    fn refuse(&self, what: &str, reason: &str) {
        self.refused.fetch_add(1, Ordering::Relaxed);
        *self.last.lock().unwrap_or_else(PoisonError::into_inner) = format!("{what}: {reason}");
    }

    /// Reason of the last refusal; empty without one.
    #[must_use]
    pub fn last_refusal(&self) -> String {
        self.last.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// Running node of a task; it ends when it is dropped.
pub struct Interface {
    /// Counts of targets.
    pub counts: Arc<TargetCounts>,
    wake: Wake,
    is_closed: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// Name of a topic or a service of a task, from its name in the file: only letters, digits and single underscores.
#[must_use]
pub fn ros_name(name: &str) -> String {
    let plain: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    let parts: Vec<&str> = plain.split('_').filter(|part| !part.is_empty()).collect();
    let joined = parts.join("_");
    if joined.starts_with(|c: char| c.is_ascii_alphabetic()) { joined } else { format!("task_{joined}") }
}

/// Topic of a task.
#[must_use]
pub fn task_topic(place: &NodePlace, task: &str, topic: &str) -> String {
    format!("{}/{}/{topic}", place.node, ros_name(task))
}

/// Service that the node offers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Service {
    Start,
    Stop,
    Hold,
    Tare,
    TaskSet(u32),
}

impl Service {
    fn name(self) -> String {
        match self {
            Self::Start => "start".to_owned(),
            Self::Stop => "stop".to_owned(),
            Self::Hold => "hold".to_owned(),
            Self::Tare => "tare".to_owned(),
            Self::TaskSet(number) => format!("task_set_{number}"),
        }
    }
}

/// Message that has arrived.
enum Arrived {
    Input(&'static str, Result<Input, String>),
    Frames(Result<(TfMessage, MessageInfo), ReadError>),
    Request(usize, Result<(RmwRequestId, TriggerRequest), ReadError>),
    Wake,
}

/// Subscriptions of a task.
struct TaskSubscriptions {
    pose: Option<Subscription<PoseStamped>>,
    twist: Option<Subscription<TwistStamped>>,
    clutch: Option<Subscription<Flag>>,
    wrench: Subscription<WrenchStamped>,
    gains: Subscription<Float64MultiArray>,
    modes: Subscription<Text>,
}

impl Interface {
    /// Creates the node and starts its thread, which writes inputs into the ring.
    ///
    /// # Errors
    /// A node, a topic or a service that cannot be created.
    pub fn start(
        participants: &Participants,
        plan: InterfacePlan,
        inputs: Producer<Input>,
    ) -> Result<Self, DriverError> {
        let mut node = participants.node(&plan.place, "")?;
        let subscriptions: Vec<TaskSubscriptions> = plan
            .tasks
            .iter()
            .map(|task| subscribe(&mut node, &plan.place, task))
            .collect::<Result<_, _>>()?;
        let static_frames = node.subscribe::<TfMessage>("/tf_static", &latched(100))?;
        let sets = (0..plan.task_sets).filter(|_| plan.task_sets > 1).map(Service::TaskSet);
        let services: Vec<Service> =
            [Service::Start, Service::Stop, Service::Hold, Service::Tare].into_iter().chain(sets).collect();
        let servers = services
            .iter()
            .map(|service| server(&mut node, &plan, *service))
            .collect::<Result<Vec<_>, _>>()?;
        let counts = Arc::new(TargetCounts::default());
        let (wake, is_closed) = (Wake::default(), Arc::new(AtomicBool::new(false)));
        let thread = Thread {
            plan,
            services,
            inputs,
            counts: Arc::clone(&counts),
            wake: wake.clone(),
            is_closed: Arc::clone(&is_closed),
        };
        let thread = Builder::new()
            .name("opspace-ros2-targets".to_owned())
            .spawn(move || thread.run(&node, &subscriptions, &static_frames, &servers));
        let thread =
            thread.map_err(|error| DriverError::new(format!("no thread can be started: {error}")))?;
        Ok(Self { counts, wake, is_closed, thread: Some(thread) })
    }
}

impl Drop for Interface {
    fn drop(&mut self) {
        self.is_closed.store(true, Ordering::Release);
        self.wake.wake();
        if let Some(thread) = self.thread.take() {
            // A panic was printed by its thread.
            let _ = thread.join();
        }
    }
}

fn subscribe(
    node: &mut RosNode,
    place: &NodePlace,
    task: &TaskTopics,
) -> Result<TaskSubscriptions, DriverError> {
    let topic = |name: &str| task_topic(place, &task.name, name);
    // Commands of a clutch and of settings are not lost; of poses only the newest counts.
    let (newest, every) = (profile(false, 1), profile(true, 10));
    Ok(TaskSubscriptions {
        pose: task.is_streamed.then(|| node.subscribe(&topic("pose"), &newest)).transpose()?,
        twist: task.is_streamed.then(|| node.subscribe(&topic("twist"), &newest)).transpose()?,
        clutch: task.is_streamed.then(|| node.subscribe(&topic("clutch"), &every)).transpose()?,
        wrench: node.subscribe(&topic("wrench"), &newest)?,
        gains: node.subscribe(&topic("gains"), &every)?,
        modes: node.subscribe(&topic("modes"), &every)?,
    })
}

fn server(
    node: &mut RosNode,
    plan: &InterfacePlan,
    service: Service,
) -> Result<Server<TriggerRequest, TriggerResponse>, DriverError> {
    let whole = plan.place.whole_name(&format!("{}/{}", plan.place.node, service.name()));
    let failed = |error: String| DriverError::new(format!("the service {whole} cannot be created: {error}"));
    let name = Name::parse(&whole).map_err(|error| failed(format!("{error:?}")))?;
    let mapping =
        if plan.config.cyclone_services { ServiceMapping::Cyclone } else { ServiceMapping::Enhanced };
    let kind = ServiceTypeName::new("std_srvs", "Trigger");
    let created = node.node.create_server(mapping, &name, &kind, profile(true, 10), profile(true, 10));
    created.map_err(|error| failed(format!("{error:?}")))
}

/// Thread of the targets.
struct Thread {
    plan: InterfacePlan,
    services: Vec<Service>,
    inputs: Producer<Input>,
    counts: Arc<TargetCounts>,
    wake: Wake,
    is_closed: Arc<AtomicBool>,
}

impl Thread {
    fn run(
        mut self,
        // The node lives as long as its topics.
        _node: &RosNode,
        subscriptions: &[TaskSubscriptions],
        static_frames: &Subscription<TfMessage>,
        servers: &[Server<TriggerRequest, TriggerResponse>],
    ) {
        let frames = Arc::new(Mutex::new(self.plan.frames.clone()));
        let oldest_s = self.plan.config.target_age_s;
        let mut streams: Vec<LocalBoxStream<'_, Arrived>> = Vec::new();
        for (task, subscription) in subscriptions.iter().enumerate() {
            let find = Arc::clone(&frames);
            streams.extend(subscription.pose.as_ref().map(|topic| {
                read(topic, "pose", move |message| {
                    inputs::pose(task, message, &locked(&find), Stamp::now(), oldest_s)
                })
            }));
            let find = Arc::clone(&frames);
            streams.extend(subscription.twist.as_ref().map(|topic| {
                read(topic, "twist", move |message| {
                    inputs::twist(task, message, &locked(&find), Stamp::now(), oldest_s)
                })
            }));
            streams.extend(subscription.clutch.as_ref().map(|topic| {
                read(topic, "clutch", move |message: &Flag| Ok(Input::Clutch(task, message.data)))
            }));
            streams.push(read(&subscription.wrench, "wrench", move |message| {
                inputs::wrench(task, message, Stamp::now(), oldest_s)
            }));
            streams.push(read(&subscription.gains, "gains", move |message| inputs::gains(task, message)));
            streams.push(read(&subscription.modes, "modes", move |message| inputs::modes(task, message)));
        }
        streams.push(static_frames.async_stream().map(Arrived::Frames).boxed_local());
        for (number, server) in servers.iter().enumerate() {
            let requests = server.receive_request_stream();
            streams.push(requests.map(move |request| Arrived::Request(number, request)).boxed_local());
        }
        streams.push(Wakes(self.wake.clone()).map(|()| Arrived::Wake).boxed_local());
        let mut arrived = select_all(streams);
        futures::executor::block_on(async {
            while !self.is_closed.load(Ordering::Acquire) {
                match arrived.next().await {
                    None => return,
                    Some(Arrived::Wake) => {}
                    Some(Arrived::Input(what, input)) => self.hand_over(what, input),
                    Some(Arrived::Frames(received)) => {
                        if let Ok((message, _)) = received {
                            locked(&frames).add(&message);
                        }
                    }
                    Some(Arrived::Request(number, request)) => {
                        if let Ok((id, _)) = request {
                            let response = self.serve(self.services[number]);
                            // A client that has left gets no answer.
                            let _ = servers[number].send_response(id, response);
                        }
                    }
                }
            }
        });
    }

    fn hand_over(&mut self, what: &str, input: Result<Input, String>) {
        let pushed = input.and_then(|input| {
            self.inputs.push(input).map_err(|_| "the control loop has not read the last ones".to_owned())
        });
        match pushed {
            Ok(()) => {
                self.counts.accepted.fetch_add(1, Ordering::Relaxed);
            }
            Err(reason) => self.counts.refuse(what, &reason),
        }
    }

    fn serve(&mut self, service: Service) -> TriggerResponse {
        let input = match service {
            Service::Stop => {
                self.plan.interrupt.store(true, Ordering::Relaxed);
                return done("the run is stopped");
            }
            Service::Tare => {
                self.plan.tare.ask();
                return done("the force sensors are tared: their mean of the next 0.2 s is their zero");
            }
            Service::Start => Input::Hold(false),
            Service::Hold => Input::Hold(true),
            Service::TaskSet(number) => Input::TaskSet(number),
        };
        if self.counts.has_no_inputs.load(Ordering::Relaxed) {
            let message = "this run has no inputs: give a task `tunable = true` or a streamed reference";
            return TriggerResponse { success: false, message: message.to_owned() };
        }
        match self.inputs.push(input) {
            Ok(()) => done(match service {
                Service::Hold => "the robot is held",
                Service::Start => "control goes on",
                _ => "the task set is chosen",
            }),
            Err(_) => {
                TriggerResponse { success: false, message: "the control loop is not running".to_owned() }
            }
        }
    }
}

fn done(message: &str) -> TriggerResponse {
    TriggerResponse { success: true, message: message.to_owned() }
}

/// Stream of the inputs of a topic.
fn read<'a, M: Named>(
    topic: &'a Subscription<M>,
    what: &'static str,
    input: impl Fn(&M) -> Result<Input, String> + 'a,
) -> LocalBoxStream<'a, Arrived> {
    let read = move |received: Result<(M, MessageInfo), ReadError>| match received {
        Ok((message, _)) => Arrived::Input(what, input(&message)),
        Err(error) => Arrived::Input(what, Err(format!("it cannot be read: {error:?}"))),
    };
    topic.async_stream().map(read).boxed_local()
}

fn locked(frames: &Mutex<Frames>) -> std::sync::MutexGuard<'_, Frames> {
    frames.lock().unwrap_or_else(PoisonError::into_inner)
}

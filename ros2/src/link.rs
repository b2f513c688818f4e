//! Connection of a robot with its node: threads that wait for messages, and rings that the control loop reads and writes without
//! locks.

use crate::commands::command_message;
use crate::config::RosConfig;
use crate::fault::RosFault;
use crate::node::{Commander, Endpoints, Graph, RobotTopics, publisher_of};
use crate::start::FoundRobot;
use crate::states::{Failure, Publisher, RobotState, StateReader};
use crate::wake::{Wake, Wakes};
use crate::wrenches::WrenchReader;
use futures::stream::{LocalBoxStream, StreamExt, select_all};
use opspace_backend::{DeviceFault, DriverError};
use ros2_client::MessageInfo;
use rtrb::{Consumer, Producer, RingBuffer};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::{Builder, JoinHandle, Thread};
use std::time::{Duration, Instant};

/// Capacity of the rings in rows: a control loop that falls behind by more skips states.
const ROWS: usize = 16;

/// Time between two looks at who else is on the topics.
const LOOK: Duration = Duration::from_millis(50);

/// Number of commands in a row that the client of DDS does not take, after which it has failed.
const REFUSED_COMMANDS: u32 = 50;

/// Time in which the last command is sent before the node ends.
const LINGER: Duration = Duration::from_millis(20);

/// Connection of a robot with its node.
pub struct Link {
    shared: Arc<Shared>,
    states: Consumer<f64>,
    commands: Producer<f64>,
    layout: RowLayout,
    threads: Vec<JoinHandle<()>>,
}

/// Numbers of values in a row of a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RowLayout {
    /// Number of joints.
    pub joints: usize,
    /// Number of velocities.
    pub velocities: usize,
    /// Number of efforts.
    pub efforts: usize,
    /// Number of force sensors.
    pub wrenches: usize,
}

/// End of the rings in the thread of the messages.
pub struct NodeEnd {
    states: Producer<f64>,
    commands: Consumer<f64>,
    layout: RowLayout,
    shared: Arc<Shared>,
}

struct Shared {
    /// First fault.
    fault: OnceLock<DeviceFault>,
    /// Thread of the control loop, which waits for states.
    control: OnceLock<Thread>,
    wake: Wake,
    is_closed: AtomicBool,
    /// True while the controller is to be there: after the start.
    is_driven: AtomicBool,
    /// Commands that the client of DDS did not take.
    refused: AtomicU64,
    /// States that the control loop did not take in time.
    overflowed: AtomicU64,
}

impl RowLayout {
    /// Layout of the rows of a robot.
    #[must_use]
    pub fn of(config: &RosConfig) -> Self {
        let n = config.joints.len();
        Self {
            joints: n,
            velocities: if config.measures_velocity { n } else { 0 },
            efforts: if config.effort.is_some() { n } else { 0 },
            wrenches: config.wrenches.len(),
        }
    }

    /// Number of values of a row: time, interval, positions, velocities, efforts, wrenches.
    #[must_use]
    pub fn width(&self) -> usize {
        2 + self.joints + self.velocities + self.efforts + 6 * self.wrenches
    }
}

impl Link {
    /// Returns both ends of the rings, without threads.
    #[must_use]
    pub fn rings(config: &RosConfig) -> (Self, NodeEnd) {
        let layout = RowLayout::of(config);
        let (states_in, states) = RingBuffer::new(ROWS * layout.width());
        let (commands, commands_out) = RingBuffer::new(ROWS * layout.joints);
        let shared = Arc::new(Shared {
            fault: OnceLock::new(),
            control: OnceLock::new(),
            wake: Wake::default(),
            is_closed: AtomicBool::new(false),
            is_driven: AtomicBool::new(true),
            refused: AtomicU64::new(0),
            overflowed: AtomicU64::new(0),
        });
        let end = NodeEnd { states: states_in, commands: commands_out, layout, shared: Arc::clone(&shared) };
        (Self { shared, states, commands, layout, threads: Vec::new() }, end)
    }

    /// Starts the threads of a robot that was found.
    ///
    /// # Errors
    /// A thread that cannot be started.
    pub fn start(topics: RobotTopics, found: FoundRobot, config: &RosConfig) -> Result<Self, DriverError> {
        let (mut link, end) = Self::rings(config);
        let FoundRobot { reader, wrenches, began, .. } = found;
        let watch = GraphWatch {
            graph: topics.node.graph(),
            commands: config.whole_name(&config.commands),
            states: config.whole_name(&config.states),
            source: reader.publisher(),
            shared: Arc::clone(&link.shared),
        };
        let messages = Messages {
            reader,
            wrenches,
            state: RobotState::default(),
            row: vec![0.0; config.joints.len()],
            refusals: Refusals::default(),
            config: config.clone(),
            began,
            end,
        };
        let not_started =
            |error: std::io::Error| DriverError::new(format!("no thread can be started: {error}"));
        let messages = Builder::new().name("opspace-ros2".to_owned()).spawn(move || messages.run(&topics));
        link.threads.push(messages.map_err(not_started)?);
        let watch = Builder::new().name("opspace-ros2-graph".to_owned()).spawn(move || watch.run());
        link.threads.push(watch.map_err(not_started)?);
        Ok(link)
    }

    /// Fault of the robot, once there is one.
    #[must_use]
    pub fn fault(&self) -> Option<&DeviceFault> {
        self.shared.fault.get()
    }

    /// Copies the newest state to `row` and returns the number of states since the last call. Allocates and locks nothing.
    pub fn take_newest(&mut self, row: &mut [f64]) -> usize {
        let width = self.layout.width();
        let rows = self.states.slots() / width;
        for _ in 0..rows {
            let Ok(chunk) = self.states.read_chunk(width) else { return 0 };
            for (slot, value) in row.iter_mut().zip(chunk) {
                *slot = value;
            }
        }
        rows
    }

    /// Says that this thread waits for states: called before the first look at them.
    pub fn attach(&self) {
        self.shared.control.get_or_init(std::thread::current);
    }

    /// Waits for a state, or until the time is over. It returns at once if a state came since the last look.
    pub fn wait(&self, longest: Duration) {
        std::thread::park_timeout(longest);
    }

    /// Sends a command of all joints; returns false if the node has not sent the last ones. Allocates and locks nothing.
    pub fn send(&mut self, values: &[f64]) -> bool {
        let Ok(chunk) = self.commands.write_chunk_uninit(values.len()) else { return false };
        chunk.fill_from_iter(values.iter().copied());
        self.shared.wake.wake();
        true
    }

    /// Numbers of commands that the client of DDS did not take, and of states that did not fit into the ring.
    #[must_use]
    pub fn lost(&self) -> [u64; 2] {
        [&self.shared.refused, &self.shared.overflowed].map(|count| count.load(Ordering::Relaxed))
    }

    /// Sends what is to be sent, and ends the node.
    pub fn close(mut self) {
        self.shared.is_driven.store(false, Ordering::Release);
        self.shared.wake.wake();
        std::thread::sleep(LINGER);
        self.shared.is_closed.store(true, Ordering::Release);
        self.shared.wake.wake();
        for thread in self.threads.drain(..) {
            // A panic was printed by its thread.
            let _ = thread.join();
        }
    }
}

impl Shared {
    /// Records a fault unless there is one already, and wakes the control loop.
    fn fail(&self, fault: RosFault, details: &str) {
        if self.is_driven.load(Ordering::Acquire) {
            let _ = self.fault.set(fault.device_fault(details));
            self.wake_control();
        }
    }

    fn wake_control(&self) {
        if let Some(thread) = self.control.get() {
            thread.unpark();
        }
    }
}

impl NodeEnd {
    /// Hands a state and the wrenches over to the control loop.
    pub fn push(&mut self, state: &RobotState, wrenches: &[[f64; 6]]) {
        let Ok(chunk) = self.states.write_chunk_uninit(self.layout.width()) else {
            self.shared.overflowed.fetch_add(1, Ordering::Relaxed);
            return;
        };
        let values = [state.time_s, state.interval_s]
            .into_iter()
            .chain(state.q.iter().copied())
            .chain(state.dq.iter().copied())
            .chain(state.effort.iter().copied())
            .chain(wrenches.iter().flatten().copied());
        chunk.fill_from_iter(values);
        self.shared.wake_control();
    }

    /// Copies the next command of the control loop; returns false if there is none.
    pub fn next_command(&mut self, values: &mut [f64]) -> bool {
        let Ok(chunk) = self.commands.read_chunk(values.len()) else { return false };
        for (slot, value) in values.iter_mut().zip(chunk) {
            *slot = value;
        }
        true
    }

    /// Records a fault unless there is one already, and wakes the control loop.
    pub fn fail(&self, fault: RosFault, details: &str) {
        self.shared.fail(fault, details);
    }
}

/// Number of commands in a row that the client of DDS has not taken.
#[derive(Clone, Copy, Debug, Default)]
pub struct Refusals(u32);

impl Refusals {
    /// Counts a command.
    ///
    /// # Errors
    /// The client has failed: it did not take too many commands in a row.
    pub fn count(&mut self, is_taken: bool) -> Result<(), Failure> {
        self.0 = if is_taken { 0 } else { self.0 + 1 };
        if self.0 < REFUSED_COMMANDS {
            return Ok(());
        }
        Err((RosFault::ClientFailed, format!("it did not take {REFUSED_COMMANDS} commands in a row")))
    }
}

/// Something that the thread of the messages waits for.
enum Event {
    State(Received<crate::messages::JointState>),
    Wrench(usize, Received<crate::messages::WrenchStamped>),
    Command,
}

type Received<M> = Result<(M, MessageInfo), String>;

/// Thread of the messages.
struct Messages {
    reader: StateReader,
    wrenches: WrenchReader,
    state: RobotState,
    row: Vec<f64>,
    refusals: Refusals,
    config: RosConfig,
    began: Instant,
    end: NodeEnd,
}

impl Messages {
    fn run(mut self, topics: &RobotTopics) {
        let states =
            topics.states.async_stream().map(|received| Event::State(received.map_err(|e| format!("{e:?}"))));
        let mut streams: Vec<LocalBoxStream<'_, Event>> = vec![states.boxed_local()];
        for (number, wrench) in topics.wrenches.iter().enumerate() {
            let wrenches = wrench.async_stream();
            let event = move |received: Result<_, ros2_client::ReadError>| {
                Event::Wrench(number, received.map_err(|e| format!("{e:?}")))
            };
            streams.push(wrenches.map(event).boxed_local());
        }
        streams.push(Wakes(self.end.shared.wake.clone()).map(|()| Event::Command).boxed_local());
        let mut events = select_all(streams);
        futures::executor::block_on(async {
            while !self.end.shared.is_closed.load(Ordering::Acquire) {
                let Some(event) = events.next().await else { return };
                if let Err((fault, details)) = self.handle(event, &topics.commander) {
                    self.end.fail(fault, &details);
                }
            }
        });
    }

    fn handle(&mut self, event: Event, commander: &Commander) -> Result<(), Failure> {
        let arrival_s = self.began.elapsed().as_secs_f64();
        match event {
            Event::Command => self.publish(commander),
            Event::State(Err(words)) | Event::Wrench(_, Err(words)) => Err((RosFault::ClientFailed, words)),
            Event::Wrench(sensor, Ok((message, _))) => self.wrenches.read(sensor, &message, arrival_s),
            Event::State(Ok((message, info))) => {
                if !self.reader.read(&message, publisher_of(&info), arrival_s, &mut self.state)? {
                    return Ok(());
                }
                self.wrenches.check_silence(arrival_s)?;
                self.end.push(&self.state, self.wrenches.values());
                Ok(())
            }
        }
    }

    /// Publishes the commands that the control loop has written.
    fn publish(&mut self, commander: &Commander) -> Result<(), Failure> {
        while self.end.next_command(&mut self.row) {
            let is_taken = commander.publish(command_message(&self.config, &self.row));
            self.end.shared.refused.fetch_add(u64::from(!is_taken), Ordering::Relaxed);
            self.refusals.count(is_taken)?;
        }
        Ok(())
    }
}

/// Thread that looks who else is on the topics.
struct GraphWatch {
    graph: Graph,
    commands: String,
    states: String,
    source: Option<Publisher>,
    shared: Arc<Shared>,
}

impl GraphWatch {
    fn run(self) {
        while !self.shared.is_closed.load(Ordering::Acquire) {
            let commands = self.graph.endpoints(&self.commands);
            let states = self.graph.endpoints(&self.states);
            if let Some(fault) = self.fault(&commands, &states) {
                self.shared.fail(fault, "");
            }
            std::thread::sleep(LOOK);
        }
    }

    fn fault(&self, commands: &Endpoints, states: &Endpoints) -> Option<RosFault> {
        if !commands.publishers.is_empty() {
            return Some(RosFault::SecondCommander);
        }
        // Driver and controller often end together: the driver is the cause.
        if self.source.is_some_and(|source| !states.publishers.contains(&source)) {
            return Some(RosFault::DriverGone);
        }
        (commands.subscribers == 0).then_some(RosFault::ControllerGone)
    }
}

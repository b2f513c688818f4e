//! State of a view: what its page shows, and what its page asks for.

use crate::feed::{FedState, Feed, Publish, json_channel};
use crate::held::{Hand, Pushable};
use crate::hub::Hub;
use crate::requests::{ControlMessage, Grasp, HandMessage};
use crate::server::{Address, Inputs, Server};
use crate::tunable::{Change, NewValue, ViewedTask, axis, mode};
use opspace_log::{TIME_ZERO_NS, ViewerReceiver};
use opspace_loop::PaceControl;
use opspace_model::{Model, Placement};
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Topic of the state of the view.
const VIEW: &str = "/view";

/// Time between two looks at the state, and the longest time between two messages of it.
const LOOK: Duration = Duration::from_millis(50);
const REPEAT: Duration = Duration::from_millis(500);

/// Largest number of changes that wait for the next cycle.
const MOST_CHANGES: usize = 64;

/// Kind of what is viewed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ViewKind {
    /// Run in progress.
    Run,
    /// Recorded log.
    Log,
}

/// Robot of a view.
#[derive(Clone, Debug)]
pub struct ViewedRobot {
    /// Beginning of its topics: none, or `/NAME`.
    pub prefix: String,
    /// Name.
    pub name: String,
    /// Description: interface and controller.
    pub label: String,
    /// Pose of its base in the world. Of robots with one base, those that are compared are shown as ghosts, and others side by side.
    pub base: Placement,
    /// True for a robot with the same task as others, beside which it runs.
    pub is_compared: bool,
    /// Model of a robot that can be pushed: only a simulation that accepts external forces has one.
    pub pushable: Option<Model>,
    /// Tasks.
    pub tasks: Vec<ViewedTask>,
}

/// Content of a view at present.
#[derive(Debug)]
struct Content {
    title: String,
    kind: ViewKind,
    duration_s: f64,
    is_over: bool,
    is_controlled: bool,
    outcome: Option<String>,
    robots: Vec<(ViewedRobot, Arc<FedState>)>,
}

/// State that the threads of connections, of logs and of the run share.
pub(crate) struct State {
    pub hub: Arc<Hub>,
    pub meshes: Arc<Mutex<Vec<PathBuf>>>,
    pub pace: Arc<PaceControl>,
    pub hand: Hand,
    content: Mutex<Content>,
    /// Bits of the time on the robots' clock, s.
    time_s: AtomicU64,
    changes: Mutex<VecDeque<Change>>,
    restart: AtomicBool,
    seek_s: Mutex<Option<f64>>,
    /// True until the first page connects: the run waits for it.
    waits: AtomicBool,
    channel: u32,
}

/// Live view of runs, or of a log: a server with its state. It serves until the program ends.
pub struct LiveView {
    pub(crate) state: Arc<State>,
    server: Server,
}

impl LiveView {
    /// Begins to serve on an address. Nothing moves until a page connects.
    ///
    /// # Errors
    /// An address that is taken, or not of this computer.
    pub fn start(socket: SocketAddr, title: &str, kind: ViewKind) -> io::Result<Self> {
        Self::start_for(socket, &[], title, kind)
    }

    /// Begins to serve as [`start`](Self::start) does; pages of these other origins may connect too.
    ///
    /// # Errors
    /// As [`start`](Self::start).
    pub fn start_for(
        socket: SocketAddr,
        origins: &[String],
        title: &str,
        kind: ViewKind,
    ) -> io::Result<Self> {
        let hub = Arc::<Hub>::default();
        let channel = hub.open(vec![json_channel(VIEW.to_owned(), "opspace.View")]).pop().unwrap_or_default();
        let content = Content {
            title: title.to_owned(),
            kind,
            duration_s: 0.0,
            is_over: false,
            is_controlled: false,
            outcome: None,
            robots: Vec::new(),
        };
        let state = Arc::new(State {
            hub: Arc::clone(&hub),
            meshes: Arc::default(),
            pace: Arc::default(),
            hand: Hand::default(),
            content: Mutex::new(content),
            time_s: AtomicU64::new(0.0_f64.to_bits()),
            changes: Mutex::default(),
            restart: AtomicBool::new(false),
            seek_s: Mutex::default(),
            waits: AtomicBool::new(true),
            channel,
        });
        state.pace.set_paused(true);
        let inputs = Arc::<State>::clone(&state);
        let server = Server::start((socket, origins), "opspace", hub, Arc::clone(&state.meshes), inputs)?;
        let told = Arc::clone(&state);
        thread::Builder::new().name("opspace-state".to_owned()).spawn(move || tell(&told))?;
        Ok(Self { state, server })
    }

    /// Address of the server.
    #[must_use]
    pub fn address(&self) -> &Address {
        self.server.address()
    }

    /// Shows these robots from now on, for a duration (s). A page controls speed and gains unless the robots are real.
    pub fn show(&self, robots: Vec<ViewedRobot>, duration_s: f64, is_controlled: bool) {
        let mut content = lock(&self.state.content);
        content.robots = robots.into_iter().map(|robot| (robot, Arc::default())).collect();
        (content.duration_s, content.is_over, content.outcome) = (duration_s, false, None);
        content.is_controlled = is_controlled;
        drop(content);
        lock(&self.state.changes).clear();
        self.state.restart.store(false, Ordering::Release);
        self.state.set_time(0.0);
    }

    /// Returns the receiver of the messages and rows of the robot with that number.
    #[must_use]
    pub fn receiver(&self, robot: usize) -> Option<Box<dyn ViewerReceiver>> {
        let content = lock(&self.state.content);
        let (viewed, shown) = content.robots.get(robot)?;
        let hub = Arc::clone(&self.state.hub);
        Some(Box::new(self.feed(Arc::clone(&hub), hub, viewed, shown)))
    }

    fn feed<P: Publish>(
        &self,
        publish: P,
        hub: Arc<Hub>,
        viewed: &ViewedRobot,
        shown: &Arc<FedState>,
    ) -> Feed<P> {
        Feed::new(publish, hub, Arc::clone(shown), Arc::clone(&self.state.meshes), viewed.prefix.clone())
    }

    /// Returns a receiver of a robot's messages, which passes them to `publish` in place of the pages.
    pub(crate) fn feed_to<P: Publish>(&self, publish: P, robot: usize) -> Option<Feed<P>> {
        let content = lock(&self.state.content);
        let (viewed, shown) = content.robots.get(robot)?;
        Some(self.feed(publish, Arc::clone(&self.state.hub), viewed, shown))
    }

    /// Removes the channels that the present robots do not have. Call it once their logs are open.
    pub fn remove_other_channels(&self) {
        self.state.remove_other_channels();
    }

    /// States that the run is over, with its outcome.
    pub fn end(&self, outcome: &str) {
        let mut content = lock(&self.state.content);
        (content.is_over, content.outcome) = (true, Some(outcome.to_owned()));
    }

    /// Number of connected pages and viewers.
    #[must_use]
    pub fn pages(&self) -> usize {
        self.state.hub.connections()
    }

    /// Number of cycles that began late.
    #[must_use]
    pub fn late_cycles(&self) -> u64 {
        self.state.pace.late_cycles()
    }

    /// Number of messages that slow pages have lost.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.state.hub.dropped()
    }

    /// Continues, whether a page has paused or none has connected yet.
    pub fn play(&self) {
        self.state.waits.store(false, Ordering::Relaxed);
        self.state.pace.set_paused(false);
    }

    /// Returns true once a page asks for a new run.
    #[must_use]
    pub fn wants_restart(&self) -> bool {
        self.state.wants_restart()
    }
}

impl State {
    pub fn wants_restart(&self) -> bool {
        self.restart.load(Ordering::Acquire)
    }

    /// Takes the time (s) to which a page wants to go.
    pub fn take_seek(&self) -> Option<f64> {
        lock(&self.seek_s).take()
    }

    pub fn wants_seek(&self) -> bool {
        lock(&self.seek_s).is_some()
    }

    /// Takes the request of a restart.
    pub fn take_restart(&self) -> bool {
        self.restart.swap(false, Ordering::AcqRel)
    }

    /// Sets the time on the robots' clock, s.
    pub fn set_time(&self, time_s: f64) {
        if time_s.is_finite() {
            self.time_s.store(time_s.to_bits(), Ordering::Relaxed);
        }
    }

    pub fn time_s(&self) -> f64 {
        f64::from_bits(self.time_s.load(Ordering::Relaxed))
    }

    /// Sets the duration of what is shown, s.
    pub fn set_duration(&self, duration_s: f64) {
        lock(&self.content).duration_s = duration_s;
    }

    /// Marks the end of what is shown, or its continuation.
    pub fn set_over(&self, is_over: bool) {
        lock(&self.content).is_over = is_over;
    }

    pub fn remove_other_channels(&self) {
        let content = lock(&self.content);
        let of_robots = content.robots.iter().flat_map(|(_, shown)| lock(&shown.channels).clone());
        let kept: Vec<u32> = of_robots.chain([self.channel]).collect();
        drop(content);
        self.hub.keep(&kept);
    }

    /// Calls `write` with the changes of a robot that wait, unless another thread adds one at the moment.
    pub fn take_changes(&self, robot: usize, write: &mut dyn FnMut(Change)) {
        let Ok(mut changes) = self.changes.try_lock() else { return };
        changes.retain(|change| {
            if change.robot == robot {
                write(*change);
            }
            change.robot != robot
        });
    }

    /// Enters which inputs the tasks of a robot have.
    pub fn set_tasks(&self, robot: usize, tasks: Vec<ViewedTask>) {
        if let Some((viewed, _)) = lock(&self.content).robots.get_mut(robot) {
            viewed.tasks = tasks;
        }
    }

    /// Tasks of a robot.
    pub fn tasks(&self, robot: usize) -> Vec<ViewedTask> {
        lock(&self.content).robots.get(robot).map_or_else(Vec::new, |(viewed, _)| viewed.tasks.clone())
    }

    /// Changes an axis of the task with this name, of all robots that have it.
    fn change(&self, task: &str, axis_name: &str, value: NewValue) -> Result<(), String> {
        let axis = axis(axis_name).ok_or_else(|| format!("there is no axis '{axis_name}'"))?;
        let mut content = lock(&self.content);
        let mut changes = Vec::new();
        for (robot, (viewed, _)) in content.robots.iter_mut().enumerate() {
            if let Some(number) = viewed.tasks.iter().position(|viewed| viewed.name == task) {
                viewed.tasks[number].change(axis, value)?;
                changes.push(Change { robot, task: number, axis, value });
            }
        }
        if changes.is_empty() {
            return Err(format!("there is no task '{task}'"));
        }
        drop(content);
        let mut waiting = lock(&self.changes);
        if waiting.len() + changes.len() > MOST_CHANGES {
            return Err("too many changes at once".to_owned());
        }
        waiting.extend(changes);
        Ok(())
    }

    /// State for the page.
    fn json(&self) -> Value {
        let content = lock(&self.content);
        let grasp = self.hand.grasp(Instant::now());
        let robot = |(number, (viewed, shown)): (usize, &(ViewedRobot, Arc<FedState>))| {
            let same_base = content.robots[..number].iter().find(|(other, _)| other.base == viewed.base);
            let is_held = |(_, held): &&(Grasp, Vec<bool>)| held.get(number) == Some(&true);
            let hand = grasp.as_ref().filter(is_held).map(|(grasp, _)| {
                json!({
                    "frame": grasp.frame,
                    "point_m": grasp.point_m,
                    "target_m": grasp.target_m,
                    "stiffness_n_per_m": grasp.stiffness_n_per_m,
                    "damping_ns_per_m": grasp.damping_ns_per_m,
                    "largest_force_n": grasp.largest_force_n,
                    "force_n": shown.force(),
                })
            });
            json!({
                "prefix": viewed.prefix,
                "name": viewed.name,
                "label": viewed.label,
                "is_compared": viewed.is_compared,
                "same_base_as": same_base.map(|(other, _)| &other.name),
                "can_push": viewed.pushable.is_some(),
                "units": *lock(&shown.units),
                "hand": hand,
                "tasks": viewed.tasks.iter().map(ViewedTask::json).collect::<Vec<_>>(),
            })
        };
        let is_closed = |(_, shown): &(_, Arc<FedState>)| shown.is_closed.load(Ordering::Relaxed);
        let is_over = content.is_over || (!content.robots.is_empty() && content.robots.iter().all(is_closed));
        let state = match (is_over, self.pace.is_paused() && content.is_controlled) {
            (true, _) => "ended",
            (false, true) => "paused",
            (false, false) => "playing",
        };
        json!({
            "title": content.title,
            "kind": match content.kind { ViewKind::Run => "run", ViewKind::Log => "log" },
            "time_s": self.time_s(),
            "duration_s": content.duration_s,
            "speed": self.pace.speed(),
            "state": state,
            "outcome": content.outcome,
            "late_cycles": self.pace.late_cycles(),
            "dropped_pictures": self.hub.dropped(),
            "robots": content.robots.iter().enumerate().map(robot).collect::<Vec<_>>(),
        })
    }
}

impl Inputs for State {
    fn hand(&self, connection: u64, message: HandMessage) -> Result<(), String> {
        let content = lock(&self.content);
        let robots = content
            .robots
            .iter()
            .map(|(robot, _)| -> Pushable<'_> { (&robot.name, robot.pushable.as_ref()) });
        self.hand.receive(connection, message, robots, Instant::now())
    }

    fn control(&self, message: ControlMessage) -> Result<(), String> {
        let content = lock(&self.content);
        let (kind, is_controlled) = (content.kind, content.is_controlled);
        drop(content);
        if !is_controlled {
            return Err("the robot is real, or not ready: the view only watches".to_owned());
        }
        match message {
            ControlMessage::Play {} => {
                self.waits.store(false, Ordering::Relaxed);
                self.pace.set_paused(false);
            }
            ControlMessage::Pause {} => {
                self.waits.store(false, Ordering::Relaxed);
                self.pace.set_paused(true);
            }
            ControlMessage::Step {} => self.pace.step(),
            ControlMessage::Speed { value } => self.pace.set_speed(value),
            ControlMessage::Restart {} => self.restart.store(true, Ordering::Release),
            ControlMessage::Seek { time_s } if kind == ViewKind::Log => *lock(&self.seek_s) = Some(time_s),
            ControlMessage::Seek { .. } => return Err("only a log has other times: seek".to_owned()),
            ControlMessage::Gains { task, axis, natural_frequency_rad_per_s, damping_ratio } => {
                let value = NewValue::Gains([natural_frequency_rad_per_s, damping_ratio]);
                self.change(&task, &axis, value)?;
            }
            ControlMessage::Mode { task, axis, mode: name } => {
                let mode = mode(&name).ok_or_else(|| format!("there is no mode '{name}'"))?;
                self.change(&task, &axis, NewValue::Mode(mode))?;
            }
        }
        Ok(())
    }

    fn connected(&self) {
        if self.waits.swap(false, Ordering::Relaxed) {
            self.pace.set_paused(false);
        }
    }

    fn lost(&self, connection: u64) {
        self.hand.release(connection);
    }
}

/// Publishes the state when it changes, and in between.
fn tell(state: &State) {
    let (mut last, mut at) = (Value::Null, None::<Instant>);
    loop {
        let now = state.json();
        let mut timeless = now.clone();
        timeless["time_s"] = Value::Null;
        if timeless != last || at.is_none_or(|at| at.elapsed() >= REPEAT) {
            let ns = TIME_ZERO_NS.saturating_add_signed((state.time_s() * 1e9) as i64);
            state.hub.publish(state.channel, ns, now.to_string().as_bytes());
            state.hub.tell_time(ns);
            (last, at) = (timeless, Some(Instant::now()));
        }
        thread::sleep(LOOK);
    }
}

fn lock<T>(value: &Mutex<T>) -> MutexGuard<'_, T> {
    value.lock().unwrap_or_else(PoisonError::into_inner)
}

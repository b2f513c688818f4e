//! Messages of a robot on their way from its log to the channels of a view.

use crate::hub::Hub;
use crate::meshes::served_message;
use crate::protocol::ServerChannel;
use crate::signals::Signals;
use opspace_backend::Layout;
use opspace_log::{TIME_ZERO_NS, ViewerReceiver, ViewerTopic};
use serde_json::{Map, Value};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Topic of the URDF, whose meshes the page loads from the server.
const ROBOT_DESCRIPTION: &str = "/robot_description";

/// Topic of the signals.
const SIGNALS: &str = "/signals";

/// Elements of the acting external force.
const FORCE: [&str; 3] = ["external.force.x", "external.force.y", "external.force.z"];

/// Facts about a robot that the view states, set by the thread that writes its log.
#[derive(Debug, Default)]
pub(crate) struct FedState {
    /// Units of the signals.
    pub units: Mutex<Map<String, Value>>,
    /// Bits of the acting external force, N.
    force: [AtomicU64; 3],
    /// Numbers of the robot's channels.
    pub channels: Mutex<Vec<u32>>,
    /// True once the log of the robot is closed.
    pub is_closed: AtomicBool,
}

impl FedState {
    /// Acting external force, N.
    pub fn force(&self) -> [f64; 3] {
        std::array::from_fn(|axis| f64::from_bits(self.force[axis].load(Ordering::Relaxed)))
    }
}

/// Receiver of the messages of channels.
pub(crate) trait Publish: Send {
    /// Receives a message of a channel of the hub, at a time of the log (ns).
    fn pass(&mut self, channel: u32, log_time_ns: u64, content: &[u8]);
}

impl Publish for Arc<Hub> {
    fn pass(&mut self, channel: u32, log_time_ns: u64, content: &[u8]) {
        Hub::publish(self, channel, log_time_ns, content);
    }
}

/// Receiver of a robot's messages and rows. It opens channels of the hub, and passes their messages to `publish`.
pub(crate) struct Feed<P = Arc<Hub>> {
    pub publish: P,
    hub: Arc<Hub>,
    shown: Arc<FedState>,
    meshes: Arc<Mutex<Vec<PathBuf>>>,
    prefix: String,
    /// Channel of each topic, and that of the signals.
    channels: Vec<u32>,
    signals_channel: u32,
    description: Option<usize>,
    signals: Signals,
    /// Time of the last message, ns: that of the last signals.
    last_ns: Option<u64>,
    text: String,
}

impl<P: Publish> Feed<P> {
    pub fn new(
        publish: P,
        hub: Arc<Hub>,
        shown: Arc<FedState>,
        meshes: Arc<Mutex<Vec<PathBuf>>>,
        prefix: String,
    ) -> Self {
        Self {
            publish,
            hub,
            shown,
            meshes,
            prefix,
            channels: Vec::new(),
            signals_channel: 0,
            description: None,
            signals: Signals::default(),
            last_ns: None,
            text: String::new(),
        }
    }

    /// States that more is shown of the robot than this feed passes on.
    pub fn keep_open(self) {
        let shown = Arc::clone(&self.shown);
        drop(self);
        shown.is_closed.store(false, Ordering::Relaxed);
    }

    /// Sends the signals of the last rows, once for each time of messages.
    fn send_signals(&mut self, log_time_ns: u64) {
        if self.last_ns.replace(log_time_ns) == Some(log_time_ns) {
            return;
        }
        let time_s = (log_time_ns as f64 - TIME_ZERO_NS as f64) * 1e-9;
        self.signals.write(time_s, &mut self.text);
        self.publish.pass(self.signals_channel, log_time_ns, self.text.as_bytes());
        for (name, force) in FORCE.iter().zip(&self.shown.force) {
            let value = self.signals.value(name).filter(|value| value.is_finite()).unwrap_or(0.0);
            force.store(value.to_bits(), Ordering::Relaxed);
        }
    }
}

impl<P> Drop for Feed<P> {
    fn drop(&mut self) {
        self.shown.is_closed.store(true, Ordering::Relaxed);
    }
}

/// Channel of JSON messages.
pub(crate) fn json_channel(topic: String, schema_name: &str) -> ServerChannel {
    ServerChannel {
        topic,
        encoding: "json".to_owned(),
        schema_name: schema_name.to_owned(),
        schema_encoding: "jsonschema".to_owned(),
        schema: br#"{"type":"object"}"#.to_vec(),
    }
}

impl<P: Publish> ViewerReceiver for Feed<P> {
    fn begin(&mut self, topics: &[ViewerTopic], rows: &[&Layout]) {
        let channel = |topic: &ViewerTopic| ServerChannel {
            topic: format!("{}{}", self.prefix, topic.topic),
            encoding: topic.encoding.clone(),
            schema_name: topic.schema_name.clone(),
            schema_encoding: topic.schema_encoding.clone(),
            schema: topic.schema.clone(),
        };
        let signals = json_channel(format!("{}{SIGNALS}", self.prefix), "opspace.Signals");
        let mut channels = self.hub.open(topics.iter().map(channel).chain([signals]).collect());
        *self.shown.channels.lock().unwrap_or_else(PoisonError::into_inner) = channels.clone();
        self.signals_channel = channels.pop().unwrap_or_default();
        self.channels = channels;
        self.description = topics.iter().position(|topic| topic.topic == ROBOT_DESCRIPTION);
        self.signals = Signals::new(rows);
        *self.shown.units.lock().unwrap_or_else(PoisonError::into_inner) = self.signals.units();
    }

    fn message(&mut self, topic: usize, log_time_ns: u64, data: &[u8]) {
        self.send_signals(log_time_ns);
        let served = self.description.filter(|description| *description == topic);
        let served = served.and_then(|_| served_message(data, &self.meshes));
        if let Some(channel) = self.channels.get(topic) {
            self.publish.pass(*channel, log_time_ns, served.as_deref().unwrap_or(data));
        }
    }

    fn row(&mut self, channel: usize, _time_s: f64, row: &[f64]) {
        self.signals.row(channel, row);
    }
}

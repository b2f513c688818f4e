//! Channels of a view, and the connections that have subscribed to them.

use crate::protocol::{self, ServerChannel};
use crate::queue::{Entry, Queue};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Channels and connections. Publishing waits for no connection.
#[derive(Debug, Default)]
pub struct Hub {
    state: Mutex<State>,
    dropped: AtomicU64,
}

#[derive(Debug, Default)]
struct State {
    channels: BTreeMap<u32, Published>,
    next_channel: u32,
    connections: BTreeMap<u64, Connection>,
}

/// Channel with its last message, for later subscriptions.
#[derive(Debug)]
struct Published {
    channel: ServerChannel,
    last: Option<(u64, Arc<[u8]>)>,
}

#[derive(Debug)]
struct Connection {
    queue: Arc<Queue>,
    /// Channel of each subscription.
    subscriptions: BTreeMap<u32, u32>,
}

impl Hub {
    /// Adds channels, and returns their numbers. A channel that exists already keeps its number and its subscriptions.
    pub fn open(&self, channels: Vec<ServerChannel>) -> Vec<u32> {
        let mut state = self.lock();
        let mut added = Vec::new();
        let mut numbers = Vec::new();
        for channel in channels {
            let same = state.channels.iter().find(|(_, published)| published.channel == channel);
            let number = same.map(|(number, _)| *number);
            numbers.push(number.unwrap_or(state.next_channel));
            if number.is_none() {
                let number = state.next_channel;
                state.next_channel += 1;
                added.push((number, channel.clone()));
                state.channels.insert(number, Published { channel, last: None });
            }
        }
        if !added.is_empty() {
            state.tell(&protocol::advertise(added.iter().map(|(number, channel)| (*number, channel))));
        }
        numbers
    }

    /// Removes all channels but these.
    pub fn keep(&self, numbers: &[u32]) {
        let mut state = self.lock();
        let removed: Vec<u32> =
            state.channels.keys().copied().filter(|number| !numbers.contains(number)).collect();
        if removed.is_empty() {
            return;
        }
        state.channels.retain(|number, _| numbers.contains(number));
        for connection in state.connections.values_mut() {
            connection.subscriptions.retain(|_, channel| numbers.contains(channel));
        }
        state.tell(&protocol::unadvertise(&removed));
    }

    /// Sends a message of a channel, at a time of the log (ns), to all who have subscribed, and keeps it for others.
    pub fn publish(&self, channel: u32, log_time_ns: u64, content: &[u8]) {
        let content: Arc<[u8]> = content.into();
        let mut state = self.lock();
        let State { channels, connections, .. } = &mut *state;
        let Some(published) = channels.get_mut(&channel) else { return };
        published.last = Some((log_time_ns, Arc::clone(&content)));
        let mut lost = 0;
        for Connection { queue, subscriptions } in connections.values() {
            for (subscription, _) in subscriptions.iter().filter(|(_, subscribed)| **subscribed == channel) {
                let content = Arc::clone(&content);
                lost += queue.push(Entry::Message { subscription: *subscription, log_time_ns, content });
            }
        }
        self.dropped.fetch_add(lost, Ordering::Relaxed);
    }

    /// Sends the time on the robot's clock, ns.
    pub fn tell_time(&self, ns: u64) {
        for connection in self.lock().connections.values() {
            connection.queue.push(Entry::Time(ns));
        }
    }

    /// Number of messages that slow connections have lost.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Number of connections.
    #[must_use]
    pub fn connections(&self) -> usize {
        self.lock().connections.len()
    }

    /// Adds a connection, which gets `first` and all channels.
    pub(crate) fn connect(&self, number: u64, first: String) -> Arc<Queue> {
        let queue = Arc::<Queue>::default();
        let mut state = self.lock();
        queue.push(Entry::Text(first.into()));
        let channels = state.channels.iter().map(|(number, published)| (*number, &published.channel));
        queue.push(Entry::Text(protocol::advertise(channels).into()));
        let connection = Connection { queue: Arc::clone(&queue), subscriptions: BTreeMap::new() };
        state.connections.insert(number, connection);
        queue
    }

    /// Subscribes a connection to a channel; it gets the channel's last message.
    ///
    /// # Errors
    /// A channel that does not exist, with a description.
    pub(crate) fn subscribe(&self, connection: u64, subscription: u32, channel: u32) -> Result<(), String> {
        let mut state = self.lock();
        let State { channels, connections, .. } = &mut *state;
        let published = channels.get(&channel).ok_or_else(|| format!("there is no channel {channel}"))?;
        let Some(Connection { queue, subscriptions }) = connections.get_mut(&connection) else {
            return Ok(());
        };
        subscriptions.insert(subscription, channel);
        if let Some((log_time_ns, content)) = published.last.clone() {
            queue.push(Entry::Message { subscription, log_time_ns, content });
        }
        Ok(())
    }

    /// Ends a subscription of a connection.
    pub(crate) fn unsubscribe(&self, connection: u64, subscription: u32) {
        if let Some(connection) = self.lock().connections.get_mut(&connection) {
            connection.subscriptions.remove(&subscription);
        }
    }

    /// Removes a connection.
    pub(crate) fn disconnect(&self, number: u64) {
        if let Some(connection) = self.lock().connections.remove(&number) {
            connection.queue.close();
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// Sends a text to all connections.
    fn tell(&self, text: &str) {
        let text: Arc<str> = text.into();
        for connection in self.connections.values() {
            connection.queue.push(Entry::Text(Arc::clone(&text)));
        }
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use std::time::Duration;

    fn channel(topic: &str) -> ServerChannel {
        ServerChannel {
            topic: topic.to_owned(),
            encoding: "json".to_owned(),
            schema_name: String::new(),
            schema_encoding: "jsonschema".to_owned(),
            schema: b"{}".to_vec(),
        }
    }

    fn messages(queue: &Queue) -> Vec<(u32, u64)> {
        let entries = queue.take(Duration::ZERO).unwrap().into_iter();
        let message = |entry| match entry {
            Entry::Message { subscription, log_time_ns, .. } => Some((subscription, log_time_ns)),
            _ => None,
        };
        entries.filter_map(message).collect()
    }

    /// A subscription gets the last message of its channel, and those that follow, until it ends.
    #[test]
    fn late_subscriptions_get_the_last_message() {
        let hub = Hub::default();
        let [tf, urdf] = hub.open(vec![channel("/tf"), channel("/robot_description")])[..] else { panic!() };
        hub.publish(urdf, 1, b"<robot/>");
        hub.publish(tf, 2, b"old");
        hub.publish(tf, 3, b"new");
        let queue = hub.connect(5, protocol::server_info("test", "1"));
        assert_eq!(messages(&queue), []);
        hub.subscribe(5, 10, urdf).unwrap();
        hub.subscribe(5, 11, tf).unwrap();
        assert!(hub.subscribe(5, 12, 99).is_err());
        hub.publish(tf, 4, b"next");
        assert_eq!(messages(&queue), [(10, 1), (11, 3), (11, 4)]);
        hub.unsubscribe(5, 11);
        hub.publish(tf, 5, b"unseen");
        assert_eq!(messages(&queue), []);
        assert_eq!(hub.open(vec![channel("/tf"), channel("/more")]), [tf, 2]);
        hub.keep(&[tf]);
        hub.publish(urdf, 6, b"gone");
        assert_eq!((messages(&queue), hub.connections(), hub.dropped()), (vec![], 1, 0));
        hub.disconnect(5);
        assert!(queue.take(Duration::ZERO).is_none());
    }
}

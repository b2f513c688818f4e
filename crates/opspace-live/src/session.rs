//! Session of one connection: its subscriptions and channels, and what its messages ask for. No socket is touched here.

use crate::frames::Message;
use crate::protocol::{ClientText, parse_binary, parse_text, quote};
use crate::requests::{CONTROL_TOPIC, ControlMessage, HAND_TOPIC, HandMessage, parse_control, parse_hand};
use std::collections::BTreeMap;

/// Largest number of subscriptions of a connection.
const MOST_SUBSCRIPTIONS: usize = 256;

/// Largest number of channels of a connection.
const MOST_CHANNELS: usize = 16;

/// Action that a message of a client asks for.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Sends the messages of the server's channel from now on.
    Subscribe {
        /// Number of the subscription.
        subscription: u32,
        /// Number of the channel.
        channel: u32,
    },
    /// Ends a subscription.
    Unsubscribe {
        /// Number of the subscription.
        subscription: u32,
    },
    /// Moves the hand.
    Hand(HandMessage),
    /// Changes speed, gains and so on.
    Control(ControlMessage),
    /// Answers with a warning: the message is not understood.
    Warn(String),
    /// Answers a ping.
    Pong(Vec<u8>),
    /// Closes the connection.
    Close,
}

/// Topic of a client's channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Topic {
    Hand,
    Control,
}

/// Session of one connection. What it keeps is bounded, whatever the client sends.
#[derive(Clone, Debug, Default)]
pub struct Session {
    subscriptions: BTreeMap<u32, u32>,
    channels: BTreeMap<u32, Topic>,
}

impl Session {
    /// Returns what a message asks for.
    pub fn receive(&mut self, message: &Message) -> Vec<Action> {
        match message {
            Message::Text(text) => match parse_text(text) {
                Ok(request) => self.request(request),
                Err(what) => vec![Action::Warn(what)],
            },
            Message::Binary(bytes) => vec![self.data(bytes).unwrap_or_else(Action::Warn)],
            Message::Ping(content) => vec![Action::Pong(content.clone())],
            Message::Close => vec![Action::Close],
        }
    }

    fn request(&mut self, request: ClientText) -> Vec<Action> {
        match request {
            ClientText::Subscribe { subscriptions } => {
                let subscribe = subscriptions.into_iter().take(MOST_SUBSCRIPTIONS + 1);
                subscribe.map(|one| self.subscribe(one.id, one.channel_id)).collect()
            }
            ClientText::Unsubscribe { subscription_ids } => {
                let known = subscription_ids.into_iter().filter(|id| self.subscriptions.remove(id).is_some());
                known.map(|subscription| Action::Unsubscribe { subscription }).collect()
            }
            ClientText::Advertise { channels } => {
                let mut actions = Vec::new();
                for channel in channels.into_iter().take(MOST_CHANNELS + 1) {
                    let topic = match channel.topic.as_str() {
                        HAND_TOPIC => Some(Topic::Hand),
                        CONTROL_TOPIC => Some(Topic::Control),
                        _ => None,
                    };
                    match topic.filter(|_| channel.encoding == "json" && self.channels.len() < MOST_CHANNELS) {
                        Some(topic) => drop(self.channels.insert(channel.id, topic)),
                        None => actions.push(Action::Warn(format!(
                            "channel {} is not read: a client has up to {MOST_CHANNELS} channels, {HAND_TOPIC} and \
                             {CONTROL_TOPIC} in JSON",
                            quote(&channel.topic)
                        ))),
                    }
                }
                actions
            }
            ClientText::Unadvertise { channel_ids } => {
                for id in channel_ids {
                    self.channels.remove(&id);
                }
                Vec::new()
            }
        }
    }

    fn subscribe(&mut self, subscription: u32, channel: u32) -> Action {
        let is_full = self.subscriptions.len() >= MOST_SUBSCRIPTIONS;
        if is_full || self.subscriptions.contains_key(&subscription) {
            return Action::Warn(format!(
                "subscription {subscription} is not possible: it exists, or there are {MOST_SUBSCRIPTIONS}"
            ));
        }
        self.subscriptions.insert(subscription, channel);
        Action::Subscribe { subscription, channel }
    }

    fn data(&self, bytes: &[u8]) -> Result<Action, String> {
        let (channel, content) = parse_binary(bytes)?;
        match self.channels.get(&channel) {
            Some(Topic::Hand) => parse_hand(content).map(Action::Hand),
            Some(Topic::Control) => parse_control(content).map(Action::Control),
            None => Err(format!("a message of channel {channel}, which was not announced")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(session: &mut Session, text: &str) -> Vec<Action> {
        session.receive(&Message::Text(text.to_owned()))
    }

    fn data(channel: u32, content: &str) -> Message {
        Message::Binary([&[1][..], &channel.to_le_bytes(), content.as_bytes()].concat())
    }

    /// Compared: the messages of a page from its first to its last, and what they ask for.
    #[test]
    fn page_subscribes_and_moves_the_hand() {
        let mut session = Session::default();
        assert_eq!(
            text(&mut session, r#"{"op": "subscribe", "subscriptions": [{"id": 7, "channelId": 3}]}"#),
            [Action::Subscribe { subscription: 7, channel: 3 }]
        );
        let advertise = r#"{"op": "advertise", "channels": [
            {"id": 1, "topic": "/hand", "encoding": "json", "schemaName": ""},
            {"id": 2, "topic": "/control", "encoding": "json", "schemaName": ""}]}"#;
        assert_eq!(text(&mut session, advertise), []);
        assert_eq!(session.receive(&data(1, r#"{"release": true}"#)), [Action::Hand(HandMessage::Release)]);
        assert_eq!(
            session.receive(&data(2, r#"{"op": "pause"}"#)),
            [Action::Control(ControlMessage::Pause {})]
        );
        assert_eq!(text(&mut session, r#"{"op": "unadvertise", "channelIds": [1]}"#), []);
        assert!(matches!(session.receive(&data(1, "{}"))[..], [Action::Warn(_)]));
        assert_eq!(
            text(&mut session, r#"{"op": "unsubscribe", "subscriptionIds": [7, 8]}"#),
            [Action::Unsubscribe { subscription: 7 }]
        );
    }

    /// Messages that are not understood are answered by a warning; subscriptions and channels are limited.
    #[test]
    fn other_messages_are_warned_of() {
        let mut session = Session::default();
        for bad in
            ["", "{}", r#"{"op": "getParameters"}"#, r#"{"op": "subscribe", "subscriptions": [{"id": -1}]}"#]
        {
            assert!(matches!(text(&mut session, bad)[..], [Action::Warn(_)]), "{bad}");
        }
        for bad in [&[][..], &[1], &[2, 0, 0, 0, 0], &[1, 0, 0, 0, 0]] {
            assert!(matches!(session.receive(&Message::Binary(bad.to_vec()))[..], [Action::Warn(_)]));
        }
        let other = r#"{"op": "advertise", "channels": [{"id": 1, "topic": "/tf", "encoding": "json"}]}"#;
        assert!(matches!(text(&mut session, other)[..], [Action::Warn(_)]));
        for id in 0..1000_u32 {
            let one = format!(r#"{{"op": "subscribe", "subscriptions": [{{"id": {id}, "channelId": 1}}]}}"#);
            text(&mut session, &one);
            let one = format!(
                r#"{{"op": "advertise", "channels": [{{"id": {id}, "topic": "/hand", "encoding": "json"}}]}}"#
            );
            text(&mut session, &one);
        }
        assert_eq!(
            (session.subscriptions.len(), session.channels.len()),
            (MOST_SUBSCRIPTIONS, MOST_CHANNELS)
        );
    }
}

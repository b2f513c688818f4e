//! Contents of a log: its channels with the numbers and sizes of their messages.

use crate::error::LogError;
use crate::recording::Recording;
use crate::records::Record;
use std::collections::BTreeMap;

/// Contents of a log, up to the damage if there is any.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Contents {
    /// The rows, attachments and metadata, and the damage.
    pub recording: Recording,
    /// All channels, in the order of their definition; those for viewers too.
    pub channels: Vec<ChannelContents>,
    /// Size of the file, bytes.
    pub file_bytes: u64,
}

/// Messages of a channel.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct ChannelContents {
    /// Topic of the channel: `/opspace/tick` for the channel `tick`.
    pub topic: String,
    /// Name of the messages' type; empty if the channel has no schema.
    pub schema: String,
    /// Number of messages.
    pub messages: u64,
    /// Size of the messages before compression, bytes.
    pub bytes: u64,
}

impl Contents {
    /// Reads a log from memory.
    ///
    /// # Errors
    /// As [`Recording::from_bytes`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, LogError> {
        let mut schemas: BTreeMap<u16, String> = BTreeMap::new();
        let mut places: BTreeMap<u16, usize> = BTreeMap::new();
        let mut channels: Vec<ChannelContents> = Vec::new();
        let (recording, _) = Recording::with_records(bytes, &mut |record, _| {
            match record {
                Record::Schema { id, name, .. } => {
                    schemas.insert(*id, name.clone());
                }
                Record::Channel(channel) if !places.contains_key(&channel.id) => {
                    places.insert(channel.id, channels.len());
                    channels.push(ChannelContents {
                        topic: channel.topic.clone(),
                        schema: schemas.get(&channel.schema).cloned().unwrap_or_default(),
                        messages: 0,
                        bytes: 0,
                    });
                }
                Record::Message(message) => {
                    if let Some(channel) = places.get(&message.channel).map(|&place| &mut channels[place]) {
                        channel.messages += 1;
                        channel.bytes += message.data.len() as u64;
                    }
                }
                _ => {}
            }
            Ok(())
        })?;
        Ok(Self { recording, channels, file_bytes: bytes.len() as u64 })
    }
}

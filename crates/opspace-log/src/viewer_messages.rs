//! Messages for viewers of a recorded log.

use crate::error::LogError;
use crate::log_file::LogFile;
use crate::recording::scan;
use crate::records::Record;
use crate::viewer_receiver::{ViewerReceiver, ViewerTopic};
use opspace_backend::Layout;
use std::collections::BTreeMap;

/// Beginning of the topics of rows.
const ROWS: &str = "/opspace/";

/// Topics of a log, as they are read.
#[derive(Default)]
struct Topics {
    /// Name, encoding and definition of each type.
    schemas: BTreeMap<u16, (String, String, Vec<u8>)>,
    shown: Vec<ViewerTopic>,
    /// Index of a channel's topic in `shown`; `None` for the channel of rows with that name.
    places: BTreeMap<u16, Result<usize, String>>,
    /// True once the receiver knows the topics: those that are defined later are left out.
    told: bool,
}

impl LogFile {
    /// Passes rows and messages for viewers to `receiver`, in the order of the log, up to the first damage. It gets what a receiver of
    /// the run would have got.
    ///
    /// # Errors
    /// If the file can no longer be read.
    pub fn send_to(&self, receiver: &mut dyn ViewerReceiver) -> Result<(), LogError> {
        let mut topics = Topics::default();
        let layouts: Vec<&Layout> = self.recording().channels.iter().map(|channel| &channel.layout).collect();
        scan(self.source(), &mut |recording, record, _| {
            match record {
                Record::Schema { id, name, encoding, data } => {
                    topics.schemas.insert(*id, (name.clone(), encoding.clone(), data.to_vec()));
                }
                Record::Channel(channel) if !topics.told => {
                    let place = match channel.topic.strip_prefix(ROWS) {
                        Some(rows) => Err(rows.to_owned()),
                        None => Ok(topics.shown.len()),
                    };
                    if place.is_ok() {
                        let schema = topics.schemas.get(&channel.schema).cloned().unwrap_or_default();
                        let (schema_name, schema_encoding, schema) = schema;
                        let (topic, encoding) = (channel.topic.clone(), channel.encoding.clone());
                        topics.shown.push(ViewerTopic {
                            topic,
                            encoding,
                            schema_name,
                            schema_encoding,
                            schema,
                        });
                    }
                    topics.places.entry(channel.id).or_insert(place);
                }
                Record::Message(message) => {
                    if !std::mem::replace(&mut topics.told, true) {
                        receiver.begin(&topics.shown, &layouts);
                    }
                    match topics.places.get(&message.channel) {
                        Some(Ok(topic)) => receiver.message(*topic, message.log_ns, message.data),
                        Some(Err(name)) => {
                            let place =
                                recording.channels.iter().position(|data| data.layout.channel == *name);
                            let row = place.map(|place| (place, &recording.channels[place]));
                            if let Some((place, rows)) = row.filter(|(_, rows)| !rows.is_empty()) {
                                receiver.row(place, rows.time_s[rows.len() - 1], rows.row(rows.len() - 1));
                            }
                        }
                        None => {}
                    }
                    recording.keep_last_rows();
                }
                _ => {}
            }
            Ok(())
        })?;
        Ok(())
    }
}

//! Receiver of the messages that a log has for viewers.

use opspace_backend::Layout;

/// Topic of messages for viewers, with the definition of their type.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct ViewerTopic {
    /// Name, for example `/tf`.
    pub topic: String,
    /// Encoding of the messages: `protobuf`, or `cdr` for texts.
    pub encoding: String,
    /// Full name of the messages' type, for example `foxglove.FrameTransforms`.
    pub schema_name: String,
    /// Encoding of the definition: `protobuf`, or `ros2msg` for texts.
    pub schema_encoding: String,
    /// Definition of the type: for protobuf a serialized `FileDescriptorSet`.
    pub schema: Vec<u8>,
}

/// Receiver of the messages for viewers: of a log that is being written ([`record_with`](crate::record_with)), in the thread that
/// writes it, or of one that was recorded ([`LogFile::send_to`](crate::LogFile::send_to)). It gets the bytes that the log has.
///
/// The writer's thread waits for a receiver, and a simulation waits for the writer when its ring is full: a receiver must not block.
pub trait ViewerReceiver: Send {
    /// Receives the topics of the messages and the layouts of the rows, once, before all messages and rows.
    fn begin(&mut self, topics: &[ViewerTopic], rows: &[&Layout]);

    /// Receives a message of the topic with that index, at a time of the log (ns).
    fn message(&mut self, topic: usize, log_time_ns: u64, data: &[u8]);

    /// Receives a row of the channel with that index, at `time_s` on the robot's clock (s). The messages that are made from it
    /// follow.
    fn row(&mut self, channel: usize, time_s: f64, row: &[f64]) {
        let _ = (channel, time_s, row);
    }
}

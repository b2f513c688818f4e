//! The URDF that a robot publishes.

use crate::config::{NodePlace, latched};
use crate::messages::Text;
use crate::node::Participants;
use opspace_backend::DriverError;
use std::time::{Duration, Instant};

/// Waits for the text of a topic such as `robot_description`, which its publisher keeps for late subscribers.
///
/// # Errors
/// A text that does not come in time, with the topics of texts that there are.
pub fn receive(
    participants: &Participants,
    place: &NodePlace,
    topic: &str,
    longest: Duration,
) -> Result<String, DriverError> {
    let mut node = participants.node(place, "_description")?;
    let texts = node.subscribe::<Text>(topic, &latched(1))?;
    let began = Instant::now();
    while began.elapsed() < longest {
        match texts.take() {
            Ok(Some((text, _))) => return Ok(text.data),
            Ok(None) => std::thread::sleep(Duration::from_millis(10)),
            Err(error) => return Err(DriverError::new(format!("a message cannot be read: {error:?}"))),
        }
    }
    let topics = node.graph().topics::<Text>();
    Err(DriverError::new(format!(
        "no text came on {} within {} s; topics with texts in domain {}: {}",
        place.whole_name(topic),
        longest.as_secs_f64(),
        place.domain,
        if topics.is_empty() { "none".to_owned() } else { topics.join(", ") }
    )))
}

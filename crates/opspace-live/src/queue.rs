//! Queue of what a connection is still to be sent. It is bounded: a slow page loses messages, and delays nobody.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Largest number of entries: some 0.3 s of three robots.
const MOST_ENTRIES: usize = 512;

/// Largest size of all entries, bytes: that of the largest descriptions of robots, several times.
const MOST_BYTES: usize = 16 << 20;

/// Entry of the queue.
#[derive(Clone, Debug)]
pub(crate) enum Entry {
    /// Message of a channel, for a subscription, at a time of the log (ns).
    Message { subscription: u32, log_time_ns: u64, content: Arc<[u8]> },
    /// Text of the protocol, which is never lost.
    Text(Arc<str>),
    /// Warning, which may be lost.
    Warning(String),
    /// Bytes of frames: a pong, which may be lost.
    Frames(Vec<u8>),
    /// Time on the robot's clock, ns.
    Time(u64),
}

impl Entry {
    fn bytes(&self) -> usize {
        match self {
            Self::Message { content, .. } => content.len(),
            Self::Text(text) => text.len(),
            Self::Warning(text) => text.len(),
            Self::Frames(bytes) => bytes.len(),
            Self::Time(_) => size_of::<u64>(),
        }
    }

    fn may_be_lost(&self) -> bool {
        !matches!(self, Self::Text(_))
    }
}

#[derive(Debug, Default)]
struct Entries {
    entries: VecDeque<Entry>,
    bytes: usize,
    is_closed: bool,
}

/// Queue of one connection.
#[derive(Debug, Default)]
pub(crate) struct Queue {
    entries: Mutex<Entries>,
    filled: Condvar,
}

impl Queue {
    /// Adds an entry, in place of the oldest ones if the queue is full. Returns the number of messages that are lost. A queue that
    /// is full of entries that may not be lost is closed.
    pub fn push(&self, entry: Entry) -> u64 {
        let mut queue = self.lock();
        if queue.is_closed {
            return 0;
        }
        let mut lost = 0;
        queue.bytes += entry.bytes();
        queue.entries.push_back(entry);
        while queue.entries.len() > MOST_ENTRIES || queue.bytes > MOST_BYTES {
            let oldest = queue.entries.iter().position(Entry::may_be_lost);
            let Some(entry) = oldest.and_then(|oldest| queue.entries.remove(oldest)) else {
                *queue = Entries { is_closed: true, ..Entries::default() };
                break;
            };
            queue.bytes -= entry.bytes();
            lost += u64::from(matches!(entry, Entry::Message { .. }));
        }
        drop(queue);
        self.filled.notify_one();
        lost
    }

    /// Takes all entries, or waits up to `timeout` for one; `None` once the queue is closed.
    pub fn take(&self, timeout: Duration) -> Option<VecDeque<Entry>> {
        let queue = self.lock();
        let wait = self
            .filled
            .wait_timeout_while(queue, timeout, |queue| queue.entries.is_empty() && !queue.is_closed);
        let (mut queue, _) = wait.unwrap_or_else(PoisonError::into_inner);
        if queue.is_closed {
            return None;
        }
        queue.bytes = 0;
        Some(std::mem::take(&mut queue.entries))
    }

    /// Removes the entries, and wakes the thread that waits for some.
    pub fn close(&self) {
        *self.lock() = Entries { is_closed: true, ..Entries::default() };
        self.filled.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, Entries> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;

    fn message(number: u64, bytes: usize) -> Entry {
        Entry::Message { subscription: 0, log_time_ns: number, content: vec![0; bytes].into() }
    }

    /// A queue that nobody reads keeps the newest messages and all texts, and counts what it loses; texts alone close it.
    #[test]
    fn full_queue_loses_its_oldest_messages() {
        let queue = Queue::default();
        queue.push(Entry::Text("first".into()));
        let lost: u64 = (0..1000).map(|number| queue.push(message(number, 10))).sum();
        assert_eq!(lost, 1000 - (MOST_ENTRIES as u64 - 1));
        let entries = queue.take(Duration::ZERO).unwrap();
        assert!(matches!(entries[0], Entry::Text(_)));
        assert!(matches!(entries.back(), Some(Entry::Message { log_time_ns: 999, .. })));
        assert!(queue.take(Duration::ZERO).unwrap().is_empty());
        let lost: u64 = (0..20).map(|number| queue.push(message(number, 1 << 20))).sum();
        assert_eq!(lost, 4);
        for _ in 0..=MOST_ENTRIES {
            queue.push(Entry::Text("text".into()));
        }
        assert!(queue.take(Duration::ZERO).is_none());
        assert_eq!(queue.push(message(0, 1)), 0);
    }
}

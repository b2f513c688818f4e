//! Player of recorded logs: the messages that a viewer of the run got, again.

use crate::feed::Publish;
use crate::view::LiveView;
use opspace_log::{LogError, LogFile, TIME_ZERO_NS};
use opspace_loop::Pacer;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Time between two messages of a topic, ns: that of the log.
const PERIOD_NS: u64 = 20_000_000;

/// Largest number of messages of a topic in memory; a longer log is thinned.
const MOST_PICTURES: u64 = 20_000;

/// Message of a channel.
struct Picture {
    log_time_ns: u64,
    channel: u32,
    content: Box<[u8]>,
}

/// Messages of logs, in the order of time.
#[derive(Default)]
pub struct Pictures {
    pictures: Vec<Picture>,
}

/// Collector of the messages of a log.
struct Collector {
    pictures: Vec<Picture>,
    /// Shortest time between two messages of a channel, ns.
    spacing_ns: u64,
    /// Time of the last message of each channel, ns.
    last_ns: BTreeMap<u32, u64>,
}

impl Publish for Collector {
    fn pass(&mut self, channel: u32, log_time_ns: u64, content: &[u8]) {
        let last = self.last_ns.get(&channel);
        if last.is_some_and(|last| log_time_ns.saturating_sub(*last) < self.spacing_ns) {
            return;
        }
        self.last_ns.insert(channel, log_time_ns);
        self.pictures.push(Picture { log_time_ns, channel, content: content.into() });
    }
}

impl Pictures {
    /// Reads the messages of the logs of the robots that `view` shows, in their order.
    ///
    /// # Errors
    /// A log that can no longer be read.
    pub fn read(view: &LiveView, logs: &[LogFile]) -> Result<Self, LogError> {
        let mut pictures = Vec::new();
        for (robot, log) in logs.iter().enumerate() {
            let span_s = log.rows(opspace_backend::signal_names::TICK_CHANNEL).1;
            let span_ns = span_s.map_or(0.0, |[first, last]| (last - first) * 1e9) as u64;
            // The messages of a log are a multiple of cycles apart, so that the shortest time is below the usual one.
            let spacing_ns = if span_ns / PERIOD_NS <= MOST_PICTURES { 0 } else { span_ns / MOST_PICTURES };
            let collector = Collector { pictures: Vec::new(), spacing_ns, last_ns: BTreeMap::new() };
            let Some(mut feed) = view.feed_to(collector, robot) else { continue };
            log.send_to(&mut feed)?;
            pictures.append(&mut feed.publish.pictures);
            feed.keep_open();
        }
        pictures.sort_by_key(|picture| picture.log_time_ns);
        view.remove_other_channels();
        let read = Self { pictures };
        view.state.set_duration(read.end_s());
        Ok(read)
    }

    /// Time of a message on the robots' clock, s.
    fn time_s(&self, index: usize) -> f64 {
        let ns = self.pictures[index].log_time_ns;
        (ns as f64 - TIME_ZERO_NS as f64) * 1e-9
    }

    /// Time of the last message on the robots' clock, s.
    #[must_use]
    pub fn end_s(&self) -> f64 {
        self.pictures.len().checked_sub(1).map_or(0.0, |last| self.time_s(last))
    }

    /// Plays the messages to the pages of `view`, as they ask for, until `interrupt`.
    pub fn play(&self, view: &LiveView, outcome: &str, interrupt: &AtomicBool) {
        let state = &view.state;
        let mut pacer = Pacer::new(Arc::clone(&state.pace), PERIOD_NS as f64 * 1e-9);
        let mut next = 0;
        while !interrupt.load(Ordering::Relaxed) {
            if state.take_restart() {
                next = 0;
                pacer.restart();
                state.set_over(false);
                state.pace.set_paused(false);
            }
            if let Some(time_s) = state.take_seek() {
                next = self.show_at(view, time_s);
                pacer.restart();
                state.set_over(false);
            }
            if next >= self.pictures.len() {
                view.end(outcome);
                state.pace.set_paused(true);
                self.wait_at_end(view, interrupt);
                next = if state.pace.is_paused() { next } else { 0 };
                pacer.restart();
                state.set_over(next > 0);
                continue;
            }
            let mut is_over =
                || interrupt.load(Ordering::Relaxed) || state.wants_restart() || state.wants_seek();
            if pacer.wait(self.time_s(next), &mut is_over) {
                let now = self.pictures[next].log_time_ns;
                while let Some(picture) = self.pictures.get(next).filter(|picture| picture.log_time_ns == now)
                {
                    state.hub.publish(picture.channel, picture.log_time_ns, &picture.content);
                    state.set_time(self.time_s(next));
                    next += 1;
                }
            }
        }
    }

    /// Shows the last messages up to a time (s), and returns the index of the next one.
    fn show_at(&self, view: &LiveView, time_s: f64) -> usize {
        let next = self
            .pictures
            .partition_point(|picture| (picture.log_time_ns as f64 - TIME_ZERO_NS as f64) * 1e-9 <= time_s);
        let mut last: BTreeMap<u32, &Picture> = BTreeMap::new();
        for picture in &self.pictures[..next] {
            last.insert(picture.channel, picture);
        }
        for picture in last.values() {
            view.state.hub.publish(picture.channel, picture.log_time_ns, &picture.content);
        }
        view.state.set_time(next.checked_sub(1).map_or(0.0, |index| self.time_s(index)));
        next
    }

    /// Waits at the end of the log until a page wants to see more.
    fn wait_at_end(&self, view: &LiveView, interrupt: &AtomicBool) {
        let state = &view.state;
        let is_at_end = || {
            state.pace.is_paused()
                && !(interrupt.load(Ordering::Relaxed) || state.wants_restart() || state.wants_seek())
        };
        while is_at_end() {
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
    }
}

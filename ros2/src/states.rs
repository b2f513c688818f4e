//! Joint states as they arrive: order of the joints, clock, and what is wrong with them. No input and no output.

use crate::config::{ClockSource, EffortMeaning, RosConfig};
use crate::fault::RosFault;
use crate::messages::{JointState, Stamp};

/// Identifier of a publisher.
pub type Publisher = [u8; 16];

/// Fault with details in words.
pub type Failure = (RosFault, String);

/// Share of the difference between arrival and prediction that enters the smoothed clock of arrivals.
const SMOOTHING: f64 = 0.02;

/// State of the robot in one cycle, in the order of its joints.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RobotState {
    /// Time on the clock of the samples, s.
    pub time_s: f64,
    /// Time since the arrival of the state before, s.
    pub interval_s: f64,
    /// Positions, rad or m (n).
    pub q: Vec<f64>,
    /// Velocities, rad/s or m/s (n); empty if not measured.
    pub dq: Vec<f64>,
    /// Efforts, Nm or N (n); empty if not measured.
    pub effort: Vec<f64>,
}

/// Numbers of states.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StateCounts {
    /// States of the robot.
    pub states: u64,
    /// Messages without a joint of the robot.
    pub foreign: u64,
    /// Repeated states.
    pub repeated: u64,
    /// States that came after a later one.
    pub late: u64,
}

/// Reader of joint states.
#[derive(Clone, Debug)]
pub struct StateReader {
    joints: Vec<String>,
    clock: ClockSource,
    clock_jump_s: f64,
    period_s: f64,
    /// Time within which two publishers are taken for running side by side, s.
    side_by_side_s: f64,
    effort: Option<EffortMeaning>,
    measures_velocity: bool,
    /// Names of the last message, and for each joint the place of its values in it.
    names: Vec<String>,
    places: Vec<usize>,
    publisher: Option<Publisher>,
    last: Option<Last>,
    counts: StateCounts,
}

/// Last state.
#[derive(Clone, Copy, Debug)]
struct Last {
    stamp: Stamp,
    arrival_s: f64,
    time_s: f64,
    /// Arrival of the first state, s.
    first_arrival_s: f64,
}

impl StateReader {
    /// Returns a reader without a state so far.
    #[must_use]
    pub fn new(config: &RosConfig) -> Self {
        Self {
            joints: config.joints.clone(),
            clock: config.clock,
            clock_jump_s: config.clock_jump_s,
            period_s: config.period_s,
            side_by_side_s: 0.5 * config.silence.as_secs_f64(),
            effort: config.effort,
            measures_velocity: config.measures_velocity,
            names: Vec::new(),
            places: Vec::new(),
            publisher: None,
            last: None,
            counts: StateCounts::default(),
        }
    }

    /// Publisher of the states; `None` before the first one.
    #[must_use]
    pub fn publisher(&self) -> Option<Publisher> {
        self.publisher
    }

    /// Numbers of states so far.
    #[must_use]
    pub fn counts(&self) -> StateCounts {
        self.counts
    }

    /// Reads a message that arrived at `arrival_s` on the computer's clock (s). Returns false if it is no new state of the
    /// robot: it has none of its joints, or repeats a state.
    ///
    /// # Errors
    /// A fault of the states.
    pub fn read(
        &mut self,
        message: &JointState,
        publisher: Publisher,
        arrival_s: f64,
        state: &mut RobotState,
    ) -> Result<bool, Failure> {
        if !self.find_joints(message)? {
            self.counts.foreign += 1;
            return self.check_renamed(message, publisher, arrival_s);
        }
        self.check_publisher(publisher, arrival_s)?;
        self.check_values(message)?;
        let Some(time_s) = self.time_s(message.header.stamp, arrival_s)? else { return Ok(false) };
        state.interval_s = self.last.map_or(0.0, |last| arrival_s - last.arrival_s);
        state.time_s = time_s;
        let first_arrival_s = self.last.map_or(arrival_s, |last| last.first_arrival_s);
        self.last = Some(Last { stamp: message.header.stamp, arrival_s, time_s, first_arrival_s });
        let copy = |to: &mut Vec<f64>, from: &[f64]| {
            to.clear();
            to.extend(self.places.iter().map(|place| from[*place]));
        };
        copy(&mut state.q, &message.position);
        if self.measures_velocity {
            copy(&mut state.dq, &message.velocity);
        }
        if self.effort.is_some() {
            copy(&mut state.effort, &message.effort);
        }
        self.counts.states += 1;
        Ok(true)
    }

    /// Finds the joints in a message; returns false if it has none of them.
    fn find_joints(&mut self, message: &JointState) -> Result<bool, Failure> {
        if !self.places.is_empty() && message.name == self.names {
            return Ok(true);
        }
        let find = |joint: &String| message.name.iter().position(|name| name == joint);
        let found: Vec<Option<usize>> = self.joints.iter().map(find).collect();
        if found.iter().all(Option::is_none) {
            return Ok(false);
        }
        let missing: Vec<&str> = self
            .joints
            .iter()
            .zip(&found)
            .filter(|(_, place)| place.is_none())
            .map(|(joint, _)| joint.as_str())
            .collect();
        if !missing.is_empty() {
            let details = format!("{} of {}", missing.join(", "), message.name.join(", "));
            return Err((RosFault::JointsMissing, details));
        }
        self.places = found.into_iter().flatten().collect();
        self.names.clone_from(&message.name);
        Ok(true)
    }

    /// Tells a message about other joints from one of the robot's own publisher that has no other ones any more.
    fn check_renamed(
        &self,
        message: &JointState,
        publisher: Publisher,
        arrival_s: f64,
    ) -> Result<bool, Failure> {
        let silent_s = self.last.map_or(0.0, |last| arrival_s - last.arrival_s);
        if self.publisher != Some(publisher) || silent_s < self.side_by_side_s {
            return Ok(false);
        }
        let details = format!("their publisher sends {} instead", message.name.join(", "));
        Err((RosFault::JointsMissing, details))
    }

    fn check_publisher(&mut self, publisher: Publisher, arrival_s: f64) -> Result<(), Failure> {
        let known = *self.publisher.get_or_insert(publisher);
        if known == publisher {
            return Ok(());
        }
        let silent_s = self.last.map_or(0.0, |last| arrival_s - last.arrival_s);
        let fault = if silent_s < self.side_by_side_s {
            RosFault::SecondStatePublisher
        } else {
            RosFault::DriverRestarted
        };
        Err((fault, String::new()))
    }

    fn check_values(&self, message: &JointState) -> Result<(), Failure> {
        let n = message.name.len();
        let needed = [
            ("positions", Some(&message.position)),
            ("velocities", self.measures_velocity.then_some(&message.velocity)),
            ("efforts", self.effort.map(|_| &message.effort)),
        ];
        for (what, values) in needed {
            let Some(values) = values else { continue };
            if values.len() != n {
                let details = format!("{n} names and {} {what}", values.len());
                return Err((RosFault::StateMalformed, details));
            }
            if let Some(joint) = (0..self.joints.len()).find(|j| !values[self.places[*j]].is_finite()) {
                let details = format!("joint '{}' has {what} that are not finite", self.joints[joint]);
                return Err((RosFault::StateMalformed, details));
            }
        }
        Ok(())
    }

    /// Time of a state on the clock of the samples, s; `None` if it is no new state.
    fn time_s(&mut self, stamp: Stamp, arrival_s: f64) -> Result<Option<f64>, Failure> {
        let Some(last) = self.last else { return Ok(Some(0.0)) };
        let interval_s = arrival_s - last.arrival_s;
        if self.clock == ClockSource::Arrival {
            return Ok(Some(self.smoothed(last, arrival_s)));
        }
        let advance_s = stamp.since_s(last.stamp);
        if advance_s == 0.0 {
            if stamp == Stamp::default() {
                let details = "states have no stamps: state clock = \"arrival\" in [driver]";
                return Err((RosFault::StateMalformed, details.to_owned()));
            }
            self.counts.repeated += 1;
            return Ok(None);
        }
        let jump_s = advance_s - interval_s;
        if advance_s < -self.clock_jump_s || jump_s > self.clock_jump_s {
            let details = format!("by {jump_s:+.3} s");
            return Err((RosFault::ClockJumped, details));
        }
        if advance_s < 0.0 {
            self.counts.late += 1;
            return Ok(None);
        }
        Ok(Some(last.time_s + advance_s))
    }

    /// Time of an arrival without its jitter: whole periods after the last state, which follow the arrivals slowly.
    fn smoothed(&self, last: Last, arrival_s: f64) -> f64 {
        let measured_s = arrival_s - last.first_arrival_s;
        let periods = ((measured_s - last.time_s) / self.period_s).round().max(1.0);
        let predicted_s = last.time_s + periods * self.period_s;
        predicted_s + SMOOTHING * (measured_s - predicted_s)
    }
}

//! Newest packet from the partner: what a side of a coupling knows of the other one.
//!
//! Nothing is extrapolated. Before the first packet there is no state of the partner, and therefore no force, instead of a
//! partner at position zero.

use nalgebra::Vector6;

/// State of one side of a coupling, as it is sent. Rows that are not used are zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Packet {
    /// Session of the sender: a number that differs at each start of its program. Its sequence numbers, its clock, its positions
    /// and its energies begin anew with it.
    pub session: f64,
    /// Session of the receiver for which `echo_s` and `energy_in_j` are meant: that of the newest packet that the sender had
    /// received. NaN if there was none.
    pub partner_session: f64,
    /// Number of the packet, which grows by one with each packet that is sent.
    pub sequence: u64,
    /// Time of sending on the sender's clock, s.
    pub sent_s: f64,
    /// Time of sending of the newest packet that the sender had received, on the receiver's clock, s; NaN if there was none.
    pub echo_s: f64,
    /// Position of the axes, m or rad.
    pub position: Vector6<f64>,
    /// Velocity of the axes, m/s or rad/s.
    pub velocity: Vector6<f64>,
    /// Force that the network is to exert at the partner's port, N or Nm.
    pub force: Vector6<f64>,
    /// Integral of the sent wave, √J·√s; zero without wave variables.
    pub wave: Vector6<f64>,
    /// Position, velocity and acceleration of the path of an object that both carry; zero for another coupling.
    pub reference: [Vector6<f64>; 3],
    /// Energy that has flowed in at the sender's port, J.
    pub energy_in_j: f64,
    /// True while the sender's coupling is closed: it receives its partner, and its clutch is closed.
    pub closed: bool,
    /// True while the passivity control of the sender reduces its force.
    pub limited: bool,
}

impl Packet {
    /// True if all numbers are finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        let Self {
            session,
            sent_s,
            position,
            velocity,
            force,
            wave,
            reference: [path, speed, acceleration],
            ..
        } = self;
        let energy_in_j = &self.energy_in_j;
        let vectors = [position, velocity, force, wave, path, speed, acceleration];
        let is_finite = |v: &Vector6<f64>| v.iter().all(|x| x.is_finite());
        [session, sent_s, energy_in_j].iter().all(|x| x.is_finite()) && vectors.into_iter().all(is_finite)
    }
}

/// Number of earlier sessions of the partner that are remembered.
const EARLIER: usize = 8;

/// Newest packet that has arrived from the partner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReceivedState {
    age_at_most_s: f64,
    /// Session of the sender, and earlier ones, of which no packet is accepted any more.
    session: Option<f64>,
    earlier: [Option<f64>; EARLIER],
    newest: Option<Packet>,
    /// Time at which the newest packet arrived, on the receiver's clock, s.
    arrived_s: f64,
    /// Smallest and largest sequence number of the packets of the session that arrived, and the number of those that were
    /// accepted.
    arrived: Option<[u64; 2]>,
    accepted: u64,
    /// Packets of earlier sessions that were accepted, and that were missing.
    accepted_before: u64,
    missing_before: u64,
    refused: u64,
}

impl ReceivedState {
    /// Returns the state before the first packet. A packet that arrived more than `age_at_most_s` (s) ago is stale.
    #[must_use]
    pub fn new(age_at_most_s: f64) -> Self {
        Self {
            age_at_most_s,
            session: None,
            earlier: [None; EARLIER],
            newest: None,
            arrived_s: 0.0,
            arrived: None,
            accepted: 0,
            accepted_before: 0,
            missing_before: 0,
            refused: 0,
        }
    }

    /// Forgets all packets.
    pub fn restart(&mut self) {
        *self = Self::new(self.age_at_most_s);
    }

    /// Accepts a packet that arrives at `now_s` (s, receiver's clock) if it was sent after the newest one so far and all its
    /// numbers are finite, and returns whether it did. The first packet of another session is accepted whatever its number is;
    /// packets of the eight sessions before are not.
    pub fn accept(&mut self, packet: &Packet, now_s: f64) -> bool {
        if !packet.is_finite() || !self.enter(packet.session) {
            self.refused += 1;
            return false;
        }
        if self.newest.is_some_and(|newest| packet.sequence <= newest.sequence) {
            self.refused += 1;
            return false;
        }
        self.note(packet.sequence);
        self.newest = Some(*packet);
        self.arrived_s = now_s;
        self.accepted += 1;
        true
    }

    /// True if a session is another one than that of the packets before.
    #[must_use]
    pub fn is_of_other_session(&self, session: f64) -> bool {
        self.session.is_some_and(|known| known != session)
    }

    /// Notes a packet that arrived without a value that the coupling needs: it counts as [missing](Self::missing).
    pub fn lose(&mut self, session: f64, sequence: u64) {
        self.refused += 1;
        if session.is_finite() && self.enter(session) {
            self.note(sequence);
        }
    }

    /// Enters the session of a packet; false if it is an earlier one.
    fn enter(&mut self, session: f64) -> bool {
        if self.session == Some(session) {
            return true;
        }
        if self.earlier.contains(&Some(session)) {
            return false;
        }
        if self.session.is_some() {
            self.earlier.rotate_right(1);
            self.earlier[0] = self.session;
            (self.accepted_before, self.missing_before) = (self.accepted(), self.missing());
            (self.newest, self.arrived, self.accepted) = (None, None, 0);
        }
        self.session = Some(session);
        true
    }

    fn note(&mut self, sequence: u64) {
        let [first, last] = self.arrived.unwrap_or([sequence; 2]);
        self.arrived = Some([first.min(sequence), last.max(sequence)]);
    }

    /// Newest packet, however old; `None` before the first one.
    #[must_use]
    pub fn newest(&self) -> Option<&Packet> {
        self.newest.as_ref()
    }

    /// Newest packet unless it is stale at the time `now_s` (s).
    #[must_use]
    pub fn fresh(&self, now_s: f64) -> Option<&Packet> {
        self.newest().filter(|_| !self.is_stale(now_s))
    }

    /// Time since the newest packet arrived, s. The clocks of sender and receiver need not agree.
    #[must_use]
    pub fn age_s(&self, now_s: f64) -> Option<f64> {
        self.newest().map(|_| now_s - self.arrived_s)
    }

    /// True if the newest packet is older than the limit. False before the first packet.
    #[must_use]
    pub fn is_stale(&self, now_s: f64) -> bool {
        self.age_s(now_s).is_some_and(|age_s| age_s > self.age_at_most_s)
    }

    /// Number of packets that were accepted.
    #[must_use]
    pub fn accepted(&self) -> u64 {
        self.accepted_before + self.accepted
    }

    /// Number of packets that arrived and were not accepted: late ones, copies, and ones with numbers that are not finite or
    /// absent.
    #[must_use]
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// Sequence numbers between the first and the last packet that were not accepted: packets lost, late, or without a value
    /// that the coupling needs.
    #[must_use]
    pub fn missing(&self) -> u64 {
        self.missing_before + self.arrived.map_or(0, |[first, last]| last - first + 1 - self.accepted)
    }
}

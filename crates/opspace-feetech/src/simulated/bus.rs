//! The simulated bus: requests in, answers out, in time.

use crate::protocol::{BROADCAST_ID, Decoded, Decoder, Encoder, Instruction, Packet, Register};
use crate::simulated::joints::JointModel;
use crate::simulated::servo::SimulatedServo;
use std::collections::VecDeque;
use std::time::Duration;

/// Bytes of answers that are kept; further ones are lost, as in the buffer of an adapter.
const MAX_QUEUED: usize = 4096;

/// Properties and defects of a simulated bus. By default it has neither delays beyond those of its bytes, nor losses.
#[derive(Clone, Debug, PartialEq)]
pub struct BusOptions {
    /// Baud rate, Hz; a byte takes ten bits.
    pub baud_hz: u32,
    /// Period of the servos' law.
    pub servo_period: Duration,
    /// Resistance of the supply that the servos share, with its cables, Ω.
    pub supply_resistance_ohm: f64,
    /// True if the joints keep their positions until the first goal is written: what moves them begins with the program that
    /// controls them.
    pub waits_for_goal: bool,
    /// Time from the end of a request until its answers arrive, in addition to that of their bytes and to the delays of
    /// the servos: that of USB.
    pub latency: Duration,
    /// Share of answers that are lost, each by itself; 0 to 1.
    pub lost_share: f64,
    /// Share of answers of which a byte is changed, each by itself; 0 to 1.
    pub damaged_share: f64,
    /// Seed of losses and damages.
    pub seed: u64,
    /// True if no servo answers, as without power.
    pub silent: bool,
    /// Identifiers of servos that do not answer.
    pub silent_ids: Vec<u8>,
    /// Identifier of a servo that answers with the identifier of another one, and that identifier.
    pub renamed: Option<(u8, u8)>,
    /// Identifier of a servo whose answers lack their last byte of contents.
    pub shortened: Option<u8>,
    /// Identifier of a servo whose answers have wrong checksums.
    pub wrong_checksum: Option<u8>,
    /// True if the port is gone, as without its cable.
    pub gone: bool,
}

impl Default for BusOptions {
    fn default() -> Self {
        Self {
            baud_hz: 1_000_000,
            servo_period: Duration::from_millis(1),
            supply_resistance_ohm: 0.0,
            waits_for_goal: false,
            latency: Duration::ZERO,
            lost_share: 0.0,
            damaged_share: 0.0,
            seed: 1,
            silent: false,
            silent_ids: Vec::new(),
            renamed: None,
            shortened: None,
            wrong_checksum: None,
            gone: false,
        }
    }
}

/// Servos on joints, on a bus. Its time is that of its caller: simulated, or real.
pub struct SimulatedBus {
    /// Properties and defects.
    pub options: BusOptions,
    servos: Vec<SimulatedServo>,
    joints: Box<dyn JointModel>,
    torque_nm: Vec<f64>,
    decoder: Decoder,
    encoder: Encoder,
    /// Bytes of answers, with the times at which they arrive.
    answers: VecDeque<(Duration, u8)>,
    /// Time until which the wire is busy.
    busy_until: Duration,
    now: Duration,
    /// Time of the first goal.
    begun: Option<Duration>,
    random: u64,
}

impl SimulatedBus {
    /// Returns a bus with one servo for each joint; surplus servos move nothing.
    #[must_use]
    pub fn new(servos: Vec<SimulatedServo>, joints: Box<dyn JointModel>, options: BusOptions) -> Self {
        let mut bus = Self {
            torque_nm: vec![0.0; joints.joints()],
            random: options.seed,
            options,
            servos,
            joints,
            decoder: Decoder::default(),
            encoder: Encoder::default(),
            answers: VecDeque::with_capacity(MAX_QUEUED),
            busy_until: Duration::ZERO,
            now: Duration::ZERO,
            begun: None,
        };
        bus.control();
        bus
    }

    /// Servos.
    #[must_use]
    pub fn servos(&self) -> &[SimulatedServo] {
        &self.servos
    }

    /// Servo with this identifier, to be changed.
    pub fn servo_mut(&mut self, id: u8) -> Option<&mut SimulatedServo> {
        self.servos.iter_mut().find(|servo| servo.id() == id)
    }

    /// Servo with this identifier.
    #[must_use]
    pub fn servo(&self, id: u8) -> Option<&SimulatedServo> {
        self.servos.iter().find(|servo| servo.id() == id)
    }

    /// Joints.
    #[must_use]
    pub fn joints(&self) -> &dyn JointModel {
        self.joints.as_ref()
    }

    /// Time until which the bus is simulated.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.now
    }

    /// Time at which the first goal was written; `None` before.
    #[must_use]
    pub fn first_goal(&self) -> Option<Duration> {
        self.begun
    }

    /// Simulates the servos and joints until a time.
    pub fn advance_to(&mut self, time: Duration) {
        let period = self.options.servo_period;
        while self.now + period <= time {
            self.now += period;
            if self.begun.is_some() || !self.options.waits_for_goal {
                self.joints.advance(&self.torque_nm, period.as_secs_f64());
                self.control();
            }
        }
    }

    /// Takes bytes of a program, which arrive at this time, and carries out the requests in them.
    pub fn receive(&mut self, bytes: &[u8], time: Duration) {
        self.advance_to(time);
        let mut rest = bytes;
        while !rest.is_empty() {
            let taken = self.decoder.push(rest);
            rest = &rest[taken..];
            self.busy_until = self.busy_until.max(time) + self.duration_of(taken);
            // The decoder is taken out, because its packets borrow it.
            let mut decoder = std::mem::take(&mut self.decoder);
            while let Some(decoded) = decoder.next_packet() {
                if let Decoded::Packet(packet) = decoded {
                    self.carry_out(packet);
                }
            }
            self.decoder = decoder;
        }
    }

    /// Returns the time at which the next byte of an answer arrives; `None` if there is none.
    #[must_use]
    pub fn next_arrival(&self) -> Option<Duration> {
        self.answers.front().map(|(time, _)| *time)
    }

    /// Passes the bytes that have arrived at a time, and returns their number.
    pub fn take(&mut self, buffer: &mut [u8], time: Duration) -> usize {
        let mut taken = 0;
        while taken < buffer.len()
            && let Some((arrival, byte)) = self.answers.front().copied()
            && arrival <= time
        {
            buffer[taken] = byte;
            taken += 1;
            self.answers.pop_front();
        }
        taken
    }

    fn control(&mut self) {
        let (q, dq) = (self.joints.q(), self.joints.dq());
        let current_a: f64 = self.servos.iter().map(SimulatedServo::supply_current_a).sum();
        let drop_v = self.options.supply_resistance_ohm * current_a;
        let period_s = self.options.servo_period.as_secs_f64();
        for (index, servo) in self.servos.iter_mut().enumerate() {
            let (q, dq) = (q.get(index).copied().unwrap_or(0.0), dq.get(index).copied().unwrap_or(0.0));
            servo.supply_v = (servo.options.voltage_v - drop_v).max(0.0);
            let torque = servo.control(q, dq, period_s);
            if let Some(of_joint) = self.torque_nm.get_mut(index) {
                *of_joint = torque;
            }
        }
    }

    fn carry_out(&mut self, packet: Packet<'_>) {
        let is_asked = |id| packet.id == id || packet.id == BROADCAST_ID;
        match (Instruction::from_code(packet.code), packet.parameters) {
            (Some(Instruction::Ping), []) => {
                for index in 0..self.servos.len() {
                    if is_asked(self.servos[index].id()) {
                        self.answer(index, 0, 0);
                    }
                }
            }
            (Some(Instruction::Read), [address, length]) if packet.id != BROADCAST_ID => {
                if let Some(index) = self.index_of(packet.id) {
                    self.answer(index, *address, *length);
                }
            }
            (Some(Instruction::Write), [address, data @ ..]) => {
                self.note_goal(*address, data.len());
                for index in 0..self.servos.len() {
                    if is_asked(self.servos[index].id()) {
                        self.servos[index].write(*address, data);
                    }
                }
                if packet.id != BROADCAST_ID
                    && let Some(index) = self.index_of(packet.id)
                {
                    self.answer(index, 0, 0);
                }
            }
            (Some(Instruction::SyncRead), [address, length, ids @ ..]) => {
                for id in ids {
                    if let Some(index) = self.index_of(*id) {
                        self.answer(index, *address, *length);
                    }
                }
            }
            (Some(Instruction::SyncWrite), [address, length, values @ ..]) => {
                self.note_goal(*address, usize::from(*length));
                for value in values.chunks_exact(1 + usize::from(*length)) {
                    if let Some(index) = self.index_of(value[0]) {
                        self.servos[index].write(*address, &value[1..]);
                    }
                }
            }
            _ => {}
        }
    }

    /// Notes the time of the first request that writes goals.
    fn note_goal(&mut self, address: u8, length: usize) {
        let goal = usize::from(Register::GOAL_POSITION.address);
        let from = usize::from(address);
        if (from..from + length).contains(&goal) && self.begun.is_none() {
            self.begun = Some(self.now);
        }
    }

    fn index_of(&self, id: u8) -> Option<usize> {
        self.servos.iter().position(|servo| servo.id() == id)
    }

    /// Queues the answer of a servo, with `length` bytes from an address on.
    fn answer(&mut self, index: usize, address: u8, length: u8) {
        let servo = &self.servos[index];
        let (id, flags) = (servo.id(), servo.error_flags());
        let is_silent = self.options.silent || self.options.silent_ids.contains(&id);
        let delay_us = 2 * u64::try_from(servo.get(Register::RETURN_DELAY_TIME)).unwrap_or(0);
        let (mut data, mut count) = ([0; 255], 0);
        for byte in servo.read(address, length) {
            data[count] = byte;
            count += 1;
        }
        if self.options.shortened == Some(id) {
            count = count.saturating_sub(1);
        }
        let shown = match self.options.renamed {
            Some((from, to)) if from == id => to,
            _ => id,
        };
        let (is_lost, is_damaged) =
            (self.chance() < self.options.lost_share, self.chance() < self.options.damaged_share);
        let damage = (self.chance() * 1e9) as usize;
        let Ok(bytes) = self.encoder.answer(shown, flags, &data[..count]) else { return };
        // A servo that does not answer lets the next one wait for as long.
        let begins = self.busy_until + Duration::from_micros(delay_us);
        let byte_time = Duration::from_secs_f64(10.0 / f64::from(self.options.baud_hz.max(1)));
        let size = bytes.len();
        if !is_silent && !is_lost {
            for (place, byte) in bytes.iter().enumerate() {
                let is_changed = (is_damaged && place == damage % size)
                    || (self.options.wrong_checksum == Some(id) && place + 1 == size);
                if self.answers.len() < MAX_QUEUED {
                    // An adapter passes an answer as a whole.
                    let arrival = begins + byte_time * size as u32 + self.options.latency;
                    self.answers.push_back((arrival, if is_changed { byte ^ 0x55 } else { *byte }));
                }
            }
        }
        self.busy_until = begins + byte_time * size as u32;
    }

    fn duration_of(&self, bytes: usize) -> Duration {
        Duration::from_secs_f64(10.0 * bytes as f64 / f64::from(self.options.baud_hz.max(1)))
    }

    /// Random number from 0 to 1 (SplitMix64).
    fn chance(&mut self) -> f64 {
        self.random = self.random.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.random;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }
}

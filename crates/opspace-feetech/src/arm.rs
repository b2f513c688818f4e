//! An arm of servos on a bus, as a robot of opspace.

use crate::arm_config::{ArmConfig, AtEnd, TorqueSource};
use crate::bus::{Answer, Bus, BusError, Outcome};
use crate::fault::{BusFault, FaultTexts};
use crate::protocol::{ErrorFlags, Register};
use crate::start::{self, ANSWER_SHARE};
use crate::transport::Transport;
use opspace_backend::{
    Backend, Capabilities, Command, CommandKind, DeviceFault, DeviceLimits, DriverError, Measured, Observed,
    ObservedTorque, Sample, Status,
};
use std::time::Duration;

/// First register that is read in each cycle.
const FIRST: u8 = Register::PRESENT_POSITION.address;

/// Number of lengths of requests, which follow one another.
///
/// An answer carries no number by which it could be told from one to an earlier request. Each request therefore reads one
/// byte more or less than the one before: an answer that comes late has the length of an earlier request, and is not taken
/// for a new one.
const LENGTHS: usize = 3;

/// Unit of register Present_Current, A.
const CURRENT_A: f64 = 0.0065;

/// Period of an arm that is observed, and its silence that is a fault: nothing depends on its answers.
const OBSERVED_PERIOD: Duration = Duration::from_millis(100);
const OBSERVED_SILENCE: Duration = Duration::from_secs(2);

/// Speed at which an arm is lowered, and the longest duration of it, unless the configuration states others.
const LOWERING: (f64, Duration) = (0.3, Duration::from_secs(20));

/// Counts of what happened on the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct BusCounts {
    /// Number of cycles with complete answers.
    pub cycles: u64,
    /// Number of cycles that were missed because an answer was missing or wrong.
    pub missed: u64,
    /// Number of cycles that were not asked for because the program was late.
    pub late: u64,
    /// Number of answers that came too late.
    pub late_answers: u64,
    /// Number of goals beyond the range of the calibration.
    pub clamped_goals: u64,
}

/// An arm of servos on a bus.
///
/// [`read`](Backend::read) sets the pace: it waits for the next multiple of the period, asks all servos at once, and returns
/// their answers. A cycle in which an answer is missing or wrong is missed: it is a gap in the times of the samples. If no
/// cycle is complete for [`ArmConfig::silence`], `read` returns the [`BusFault`] that most of these cycles had.
pub struct FeetechArm<T> {
    bus: Bus<T>,
    config: ArmConfig,
    capabilities: Capabilities,
    ids: Vec<u8>,
    answers: Vec<Answer>,
    goals: Vec<i32>,
    texts: FaultTexts,
    velocity_unit: f64,
    round: Duration,
    /// Number of bytes that the shortest request reads of each servo.
    length: usize,
    /// Index of the request, modulo [`LENGTHS`].
    request: usize,
    period: Duration,
    /// Time of the next cycle; `None` before the first one.
    next: Option<Duration>,
    misses: Misses,
    is_clamped: bool,
    counts: BusCounts,
    /// For each servo, true if its torque was on when the arm was opened or released.
    torque_on: Vec<bool>,
}

/// Cycles missed since the last complete one, by their causes.
#[derive(Clone, Debug, Default)]
struct Misses {
    /// Time of the first of them; `None` if the last cycle was complete.
    since: Option<Duration>,
    silent: u32,
    foreign: u32,
    late: u32,
    noisy: u32,
    /// For each servo: number of cycles in which it was missing, its answer was wrong, its checksum was wrong.
    of_servos: Vec<[u32; 3]>,
}

impl<T: Transport> FeetechArm<T> {
    /// Starts an arm: compares servos and calibration, measures the bus, writes the profile and reads it back, and switches
    /// torque on with the present positions as goals.
    ///
    /// # Errors
    /// If a servo is missing, reports an error or contradicts the configuration, or if the bus is too slow. Torque that is on
    /// already stays on.
    pub fn start(transport: T, config: ArmConfig) -> Result<Self, DriverError> {
        let mut bus = Bus::new(transport);
        let (found, goals) = start::start(&mut bus, &config, FIRST, length(&config))?;
        let torque_on = vec![true; config.servos.len()];
        Ok(Self::opened(bus, config, found, goals, torque_on))
    }

    /// Opens an arm that is to be read and not commanded: compares servos and calibration, and writes nothing. To release it, its
    /// joints are lowered first if torque is on.
    ///
    /// # Errors
    /// If a servo is missing, reports an error or contradicts the configuration, or if the arm does not come to lie.
    pub fn observe(transport: T, config: ArmConfig, torque: ObservedTorque) -> Result<Self, DriverError> {
        let mut bus = Bus::new(transport);
        let (found, goals, torque_on) = start::observe(&mut bus, &config)?;
        let mut arm = Self::opened(bus, config, found, goals, torque_on);
        if torque == ObservedTorque::Released && arm.torque_on.contains(&true) {
            let (speed_rad_per_s, duration) = match arm.config.at_end {
                AtEnd::Lower { speed_rad_per_s, duration } => (speed_rad_per_s, duration),
                AtEnd::Hold => LOWERING,
            };
            if !arm.lower(speed_rad_per_s, duration)? {
                return Err(DriverError::new("the arm did not come to lie: it is held, with torque on"));
            }
            arm.torque_on.fill(false);
        }
        (arm.period, arm.next) = (OBSERVED_PERIOD.max(arm.period), None);
        arm.config.silence = OBSERVED_SILENCE;
        Ok(arm)
    }

    fn opened(
        bus: Bus<T>,
        config: ArmConfig,
        found: start::Found,
        goals: Vec<i32>,
        torque_on: Vec<bool>,
    ) -> Self {
        let n = config.servos.len();
        let servos = config.servos.iter().map(|servo| (servo.calibration.id, servo.joint.as_str()));
        Self {
            texts: FaultTexts::new(servos, bus.transport().other_cause_of_silence()),
            capabilities: capabilities(&config),
            ids: config.servos.iter().map(|servo| servo.calibration.id).collect(),
            answers: vec![Answer::default(); n],
            goals,
            velocity_unit: found.velocity_unit,
            round: found.round,
            length: length(&config),
            request: 0,
            period: Duration::from_secs_f64(config.period_s),
            next: None,
            misses: Misses { of_servos: vec![[0; 3]; n], ..Misses::default() },
            is_clamped: false,
            counts: BusCounts::default(),
            torque_on,
            bus,
            config,
        }
    }

    /// Counts of what happened on the bus.
    #[must_use]
    pub fn counts(&self) -> BusCounts {
        self.counts
    }

    /// Median duration of a request to all servos with its answers, measured at the start.
    #[must_use]
    pub fn round(&self) -> Duration {
        self.round
    }

    /// Goals of the servos, counts (n).
    #[must_use]
    pub fn goals(&self) -> &[i32] {
        &self.goals
    }

    /// Connection to the bus, to be changed.
    pub fn transport_mut(&mut self) -> &mut T {
        self.bus.transport_mut()
    }

    /// Ends the use of the arm, as the configuration declares: it is held, or lowered and then released. Returns true if
    /// torque is off.
    ///
    /// # Errors
    /// If the bus fails while the arm is lowered. Servos keep their last setpoints then.
    pub fn finish(&mut self) -> Result<bool, DeviceFault> {
        match self.config.at_end {
            AtEnd::Hold => Ok(false),
            AtEnd::Lower { speed_rad_per_s, duration } => self.lower(speed_rad_per_s, duration),
        }
    }

    /// Lets the goals follow the positions at a speed. A joint that sags below its goal sinks at this speed, until something
    /// carries it; then its goal meets its position, and the motor carries nothing.
    fn lower(&mut self, speed_rad_per_s: f64, duration: Duration) -> Result<bool, DeviceFault> {
        // At most this far from their goals for half a second, the joints lie.
        const NEAR: f64 = 3.0;
        const LIES: Duration = Duration::from_millis(500);
        let step = speed_rad_per_s / crate::counts::RAD_PER_COUNT * self.config.period_s;
        let mut goals: Vec<f64> = self.goals.iter().map(|goal| f64::from(*goal)).collect();
        let mut before: Vec<f64> = Vec::new();
        let begun = self.bus.transport().now();
        let mut lies_since = None;
        loop {
            let now = self.wait_for_cycle();
            if now - begun > duration {
                return Ok(false);
            }
            if let Err(fault) = self.ask(now) {
                match fault {
                    Some(fault) => return Err(fault),
                    None => continue,
                }
            }
            let positions: Vec<f64> =
                self.answers.iter().map(|answer| self.value(answer, Register::PRESENT_POSITION)).collect();
            for (goal, position) in goals.iter_mut().zip(&positions) {
                *goal += (position - *goal).clamp(-step, step);
            }
            for (sent, goal) in self.goals.iter_mut().zip(&goals) {
                *sent = goal.round() as i32;
            }
            self.send_goals()?;
            let is_near =
                goals.iter().zip(&positions).all(|(goal, position)| (goal - position).abs() <= NEAR);
            let is_still = before.iter().zip(&positions).all(|(before, now)| (before - now).abs() <= 1.0);
            before = positions;
            match lies_since {
                Some(since) if is_near && is_still && now - since >= LIES => {
                    for id in &self.ids {
                        self.bus
                            .write(*id, Register::TORQUE_ENABLE, 0)
                            .map_err(|_| BusFault::ServoMissing)?;
                    }
                    return Ok(true);
                }
                Some(_) if is_near && is_still => {}
                _ => lies_since = (is_near && is_still).then_some(now),
            }
        }
    }

    /// Waits for the next multiple of the period, and returns its time.
    fn wait_for_cycle(&mut self) -> Duration {
        let now = self.bus.transport().now();
        let mut time = self.next.unwrap_or(now);
        while time + self.period < now {
            time += self.period;
            self.counts.late += 1;
        }
        self.bus.transport_mut().wait_until(time);
        self.next = Some(time + self.period);
        self.bus.transport().now()
    }

    /// Asks all servos. Returns an error without a fault if the cycle is missed.
    fn ask(&mut self, now: Duration) -> Result<(), Option<DeviceFault>> {
        self.request = (self.request + 1) % LENGTHS;
        let length = self.length + self.request;
        let deadline = now + self.period.mul_f64(ANSWER_SHARE);
        let asked = self.bus.sync_read(&self.ids, FIRST, length, deadline, &mut self.answers);
        let round = asked.map_err(|_| Some(BusFault::PortGone.into()))?;
        for index in 0..self.answers.len() {
            let answer = &self.answers[index];
            if answer.outcome == Outcome::Complete {
                let status = self.value(answer, Register::STATUS) as u8;
                let flags = answer.flags | ErrorFlags::from_bits(status);
                if let Some(fault) = BusFault::of_flags(flags) {
                    return Err(Some(self.texts.take(fault, index)));
                }
            }
        }
        if round.complete == self.ids.len() {
            self.misses.end();
            self.counts.cycles += 1;
            return Ok(());
        }
        self.counts.missed += 1;
        let is_silent = round.complete == 0 && round.foreign == 0 && round.damaged == 0;
        self.misses.since.get_or_insert(now);
        self.misses.foreign += u32::from(round.foreign > 0);
        let lengths = self.length..self.length + LENGTHS;
        let is_of_earlier_request = |answer: &&Answer| matches!(answer.outcome, Outcome::WrongLength { bytes } if lengths.contains(&bytes));
        let late = self.answers.iter().filter(is_of_earlier_request).count();
        self.counts.late_answers += late as u64;
        // Between two requests, late answers have at least six bytes and at most those of a round; others are noise.
        let of_round = self.ids.len() * (6 + self.length + LENGTHS);
        let is_noisy = round.discarded > of_round;
        let is_late = late > 0 || (round.discarded >= 6 && !is_noisy);
        self.misses.noisy += u32::from(is_noisy);
        for (answer, misses) in self.answers.iter().zip(&mut self.misses.of_servos) {
            match answer.outcome {
                Outcome::Complete => {}
                Outcome::Missing => misses[0] += u32::from(!is_late),
                Outcome::WrongLength { bytes } => misses[1] += u32::from(!lengths.contains(&bytes)),
                Outcome::Checksum => misses[2] += 1,
            }
        }
        self.misses.late += u32::from(is_late);
        self.misses.silent += u32::from(is_silent && !is_late);
        let silence = self.bus.transport().now() - self.misses.since.unwrap_or(now);
        Err(if silence >= self.config.silence { Some(self.cause_of_silence()) } else { None })
    }

    /// Returns the fault that most of the missed cycles had.
    fn cause_of_silence(&mut self) -> DeviceFault {
        let misses = &self.misses;
        let worst = |place: usize| {
            let number = |index: &usize| misses.of_servos[*index][place];
            (0..misses.of_servos.len())
                .max_by_key(number)
                .map(|index| (misses.of_servos[index][place], index))
        };
        let mut causes = [
            (misses.noisy, BusFault::Checksum, None),
            (misses.late, BusFault::TooSlow, None),
            // Its text is the same for all servos.
            (misses.silent, BusFault::Silent, Some(0)),
            (misses.foreign, BusFault::WrongAnswer, None),
            (0, BusFault::Checksum, None),
            (0, BusFault::WrongAnswer, None),
            (0, BusFault::ServoMissing, None),
        ];
        for (cause, place) in causes[4..].iter_mut().zip([2, 1, 0]) {
            if let Some((number, index)) = worst(place) {
                // Of answers that lack a byte, two of three have the length of a late one.
                let weight = if place == 1 { LENGTHS as u32 } else { 1 };
                (cause.0, cause.2) = (weight * number, Some(index));
            }
        }
        let mut gravest = causes[0];
        for cause in causes {
            if cause.0 > gravest.0 {
                gravest = cause;
            }
        }
        match gravest {
            (_, fault, Some(index)) => self.texts.take(fault, index),
            (_, fault, None) => fault.into(),
        }
    }

    /// Value of a register in an answer, converted to a number.
    fn value(&self, answer: &Answer, register: Register) -> f64 {
        f64::from(register.decode_in(&answer.data, FIRST).unwrap_or(0))
    }

    fn fill(&self, sample: &mut Sample, now: Duration) {
        sample.time_s = now.as_secs_f64();
        let mut status = [ErrorFlags::NONE.bits(), u8::MAX, 0];
        for (index, (answer, servo)) in self.answers.iter().zip(&self.config.servos).enumerate() {
            let scale = servo.scale;
            sample.q[index] = scale.angle(self.value(answer, Register::PRESENT_POSITION) as i32);
            if let Some(dq) = &mut sample.dq {
                dq[index] =
                    scale.velocity(self.value(answer, Register::PRESENT_VELOCITY) * self.velocity_unit);
            }
            if let (Some(torque), Some(source)) = (&mut sample.motor_torque, self.config.motor_torque) {
                torque[index] = scale.sign
                    * match source {
                        TorqueSource::Current(nm_per_a) => {
                            self.value(answer, Register::PRESENT_CURRENT) * CURRENT_A * nm_per_a
                        }
                        TorqueSource::Load(nm) => self.value(answer, Register::PRESENT_LOAD) / 1000.0 * nm,
                    };
            }
            status[0] |= answer.flags.bits();
            status[1] = status[1].min(self.value(answer, Register::PRESENT_VOLTAGE) as u8);
            status[2] = status[2].max(self.value(answer, Register::PRESENT_TEMPERATURE) as u8);
        }
        let word = u32::from_le_bytes([status[0], status[1], status[2], 0]);
        sample.status = sample.status.map(|_| Status::new(word, self.is_clamped));
    }

    fn send_goals(&mut self) -> Result<(), DeviceFault> {
        let values = self.ids.iter().zip(&self.goals).map(|(id, goal)| {
            // Within the range of the calibration, which is within that of the register.
            (*id, Register::GOAL_POSITION.encode(*goal).unwrap_or_default())
        });
        self.bus.sync_write(Register::GOAL_POSITION.address, values).map_err(|error| match error {
            BusError::Port(_) => BusFault::PortGone.into(),
            _ => BusFault::WrongCommand.into(),
        })
    }
}

impl Misses {
    fn end(&mut self) {
        self.since = None;
        (self.silent, self.foreign, self.late, self.noisy) = (0, 0, 0, 0);
        self.of_servos.fill([0; 3]);
    }
}

impl<T: Transport> Backend for FeetechArm<T> {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    /// Returns the answers of the next complete cycle. The time of a sample is that of its request, on the clock of the
    /// connection: the servos have none.
    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        loop {
            let now = self.wait_for_cycle();
            match self.ask(now) {
                Ok(()) => {
                    self.fill(sample, now);
                    return Ok(());
                }
                Err(Some(fault)) => return Err(fault),
                Err(None) => {}
            }
        }
    }

    /// Sends goals to all servos in one packet, which none answers. One that is lost is replaced in the next cycle.
    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        let q = match command {
            Command::Position(q) if q.len() == self.goals.len() => q,
            Command::Hold => return Ok(()),
            _ => return Err(BusFault::WrongCommand.into()),
        };
        if q.iter().any(|q| !q.is_finite()) {
            return Err(BusFault::WrongCommand.into());
        }
        self.is_clamped = false;
        for ((goal, q), servo) in self.goals.iter_mut().zip(q).zip(&self.config.servos) {
            if let Some((count, is_clamped)) = servo.scale.count(*q) {
                *goal = count;
                self.is_clamped |= is_clamped;
                self.counts.clamped_goals += u64::from(is_clamped);
            }
        }
        self.send_goals()
    }

    /// Sends the last goals once more, since the packet with them may have been lost. Torque stays on.
    fn stop(&mut self) {
        // A bus that is gone cannot be stopped: the servos keep their goals.
        let _ = self.send_goals();
    }
}

impl<T: Transport> Observed for FeetechArm<T> {
    fn raw(&self, joint: usize) -> Option<String> {
        let answer = self.answers.get(joint)?;
        Some(format!("{} counts", self.value(answer, Register::PRESENT_POSITION)))
    }

    /// Returns the lowest voltage, the highest temperature, and the joints whose torque was on when the arm was opened.
    fn state(&self) -> Option<String> {
        let values = |register| self.answers.iter().map(move |answer| self.value(answer, register));
        let volts = values(Register::PRESENT_VOLTAGE).fold(f64::INFINITY, f64::min) / 10.0;
        let celsius = values(Register::PRESENT_TEMPERATURE).fold(f64::NEG_INFINITY, f64::max);
        let on = self.config.servos.iter().zip(&self.torque_on).filter(|(_, is_on)| **is_on);
        let on: Vec<&str> = on.map(|(servo, _)| servo.joint.as_str()).collect();
        let torque = match on.len() {
            0 => "torque off".to_owned(),
            all if all == self.ids.len() => "torque on".to_owned(),
            _ => format!("torque on in {}", on.join(", ")),
        };
        Some(format!("{volts:.1} V, {celsius} °C, {torque}"))
    }
}

/// Number of bytes that the shortest request reads of each servo: up to Status, or up to Present_Current.
fn length(config: &ArmConfig) -> usize {
    let last = match config.motor_torque {
        Some(TorqueSource::Current(_)) => Register::PRESENT_CURRENT,
        _ => Register::STATUS,
    };
    usize::from(last.address + last.width - FIRST)
}

/// Number of bytes on the bus, from a request to the last of the answers of this many servos, at least.
pub(crate) fn least_bytes(servos: usize) -> usize {
    // Header, identifier, length, instruction, address, number of bytes and checksum; then one identifier each.
    let request = 8 + servos;
    // Header, identifier, length, flags and checksum.
    let answer = 6 + usize::from(Register::STATUS.address + Register::STATUS.width - FIRST);
    request + servos * answer
}

pub(crate) fn capabilities(config: &ArmConfig) -> Capabilities {
    let mut measured = vec![Measured::Position];
    if config.measures_velocity {
        measured.push(Measured::Velocity);
    }
    if config.motor_torque.is_some() {
        measured.push(Measured::MotorCurrent);
    }
    let joints = config.servos.iter().map(|servo| servo.joint.clone());
    let capabilities = Capabilities::new(joints, CommandKind::Position, config.period_s)
        .measuring(&measured)
        .with_status()
        .with_brakes(false);
    if config.goal_speed_rad_per_s.is_none() && config.acceleration_rad_per_s2.is_none() {
        return capabilities;
    }
    let limits = DeviceLimits {
        setpoint_velocity_rad_per_s: config.goal_speed_rad_per_s,
        setpoint_acceleration_rad_per_s2: config.acceleration_rad_per_s2,
        ..DeviceLimits::default()
    };
    capabilities.with_joint_limits(vec![limits; config.servos.len()])
}

//! Law of one side of a bilateral coupling.
//!
//! With p, v the displacement and velocity of a robot's rows, F the force sensed on it, s_p and s_f the scales, and a hat
//! for what was received:
//!
//! ```text
//! leader    r = s_f f̂                                    measured force, controller force
//!           r = s_f s_p [K (p̂ − p) + D (v̂ − v)]           position
//!           command (1 + g) r + g F − B v                g: handle feedback, B: damping of the task
//! follower  x follows s_p p̂ from where it was when the coupling closed
//!           f_c = K (x − p) + D (ẋ − v)                  command f_c − B v; f = F or f = −f_c is sent
//! ```
//!
//! The [passivity control](crate::port_passivity) limits r of the leader, with its damping, and the change of x, or f_c
//! of the follower if both positions are coupled. The follower sends its position in the leader's coordinates.
//!
//! The damping B takes energy from the operator like any other force of the command. In contact it belongs to the port. In
//! free motion it doesn't: the energy would be spent in the next impact.

use crate::contact_compliance::ContactCompliance;
use crate::coupled_parameters::{CouplingSide, Passivity, Reflected, TeleoperationParameters};
use crate::coupled_rows::RowState;
use crate::error::Mistake;
use crate::law::{CouplingLaw, Cycle};
use crate::packet_fields::{RowField, RowUnit};
use crate::port_passivity::{PortPassivity, PortPassivityParameters};
use crate::received::{Packet, ReceivedState};
use crate::steady_latency::SteadyLatency;
use crate::wave::WaveSide;
use nalgebra::Vector6;
use opspace_backend::quantity::NonNegative;
use opspace_backend::signal_names::{PASSIVITY_TIME, PORT_ENERGY_OUT, PORT_WAVE};
use opspace_backend::{LowPass, SignalRecorder};
use opspace_control::{ControlContext, ControlError};
use std::any::Any;
use std::f64::consts::TAU;

/// Integral of the sender's wave variable, which wave variables need.
pub(crate) const FURTHER: [RowField; 1] =
    [RowField { signal: PORT_WAVE, input: "wave", unit: RowUnit::All("J^0.5 s^0.5"), of: |p| &mut p.wave }];

/// Store of a passivity control that only observes, J.
const UNLIMITED_J: NonNegative = NonNegative::literal(1e9);

/// Force up to which the follower touches nothing: noise of its sensor and inertia of what it holds, N or Nm.
const FREE_N: f64 = 0.5;

/// Force above which the follower is in contact, N or Nm.
const CONTACT_N: f64 = 2.0;

/// Force that the leader lacks per velocity with which the follower retreats, Ns/m or Nms/rad: 10 N give 20 mm/s.
const RETREAT_NS_PER_M: f64 = 500.0;

/// Time over which the leader's force and the follower's motion fade in after the coupling closes, s.
const FADE_S: f64 = 0.1;

/// One side of a coupling, with its state.
#[derive(Clone, Debug)]
pub(crate) struct Teleoperation {
    side: CouplingSide,
    reflect: Reflected,
    /// Stiffness and damping of each row.
    spring: Vector6<f64>,
    damper: Vector6<f64>,
    position_scale: f64,
    force_scale: f64,
    /// True if the force is measured: an estimated one is late by the lag of its observer.
    is_measured: bool,
    /// Handle feedback of the leader; zero at the follower.
    handle_feedback: f64,
    /// Part of a cycle in which the command before still acts, and the one by which the state is predicted.
    lateness: f64,
    lead: f64,
    /// Factor of the damping that pays for the delay, lag without a channel (s), and largest damping.
    delay_damping_ratio: f64,
    lag_s: f64,
    delay_damping_at_most: f64,
    /// Compliance of what the follower touches, in the leader's coordinates.
    compliance: ContactCompliance,
    clutch_open_s: Vec<[f64; 2]>,
    period_s: f64,
    passivity: PortPassivity,
    /// Session of this side, and of the partner that it has met.
    session: f64,
    met: Option<f64>,
    wave: Option<WaveSide>,
    /// True if the coupling acted in the last cycle.
    closed: bool,
    /// True if the passivity control reduced the leader's force in the last cycle.
    limited: bool,
    latency: SteadyLatency,
    /// Latency of the round trip, in the same way.
    round_trip: SteadyLatency,
    /// Received force, smoothed over the jitter of the channel.
    received: Vector6<f64>,
    /// Share of the leader's force, or of the follower's motion, from 0 to 1.
    share: f64,
    /// Reference of the follower's rows, m or rad, and its velocity.
    reference: Vector6<f64>,
    reference_velocity: Vector6<f64>,
    /// Reference of the follower that belongs to displacement zero of the leader.
    offset: Vector6<f64>,
    /// Target of the follower in the last cycle.
    target: Vector6<f64>,
    /// Position of the last cycle.
    position: Vector6<f64>,
    /// Force that is sent: on the follower, or on the leader.
    force: Vector6<f64>,
    /// Force of the last command whose work the passivity control counts, and of the one before without what limits took.
    counted: Vector6<f64>,
    acting: Vector6<f64>,
    /// Force that limits of the robot took from the command in the last cycle.
    taken: Vector6<f64>,
    /// Filter of the follower's position, like that of its sensed force; position and force in the last cycle.
    port_filter: LowPass<6>,
    port: Option<[Vector6<f64>; 2]>,
}

impl Teleoperation {
    /// Returns a side of a coupling with `[stiffness, damping]` of each row. `angular` marks the
    /// rows in rad and Nm; `sensed` is true if the force is sensed, `measured` if it is not estimated; `lag_s` is the lag of the force sensor's filter.
    pub(crate) fn new(
        (side, p): (CouplingSide, &TeleoperationParameters),
        [spring, damper]: [Vector6<f64>; 2],
        (angular, sensed, measured): (&[bool; 6], bool, bool),
        (context, lag_s): (&ControlContext, f64),
        key: &str,
    ) -> Result<Self, ControlError> {
        let ControlContext { period_s, command_delay_s, .. } = *context;
        let unsensed = |what| ControlError::new(key, Mistake::Unsensed { what });
        if side == CouplingSide::Leader && p.handle_feedback.get() > 0.0 && !sensed {
            return Err(unsensed("`handle_feedback` of the leader"));
        }
        if side == CouplingSide::Follower && p.reflect == Reflected::MeasuredForce && !sensed {
            return Err(unsensed("`reflect = \"measured-force\"`"));
        }
        let mut last_s = 0.0;
        for &[from_s, until_s] in &p.clutch_open_s {
            let in_order = from_s >= last_s && until_s > from_s && until_s.is_finite();
            if !in_order {
                let reason = Mistake::ClutchTimes { from_s, until_s };
                return Err(ControlError::new(format!("{key}.clutch_open_s"), reason));
            }
            last_s = until_s;
        }
        let zero = Vector6::zeros();
        let limits = match &p.passivity {
            Passivity::On(limits) => *limits,
            // The energies are recorded, but the store is never empty.
            Passivity::Off => PortPassivityParameters { store_j: UNLIMITED_J, ..Default::default() },
        };
        let wave = match p.reflect {
            Reflected::Waves { impedance_ns_per_m } => {
                Some(WaveSide::new(impedance_ns_per_m.get(), period_s))
            }
            _ => None,
        };
        let part = (command_delay_s / period_s).min(1.0);
        let (lateness, lead) = if context.predicts_state() { (0.0, part) } else { (part, 0.0) };
        let mut passivity = PortPassivity::new(&limits, angular, period_s);
        if matches!(p.passivity, Passivity::On(_))
            && side == CouplingSide::Leader
            && p.reflect != Reflected::Position
        {
            // The leader returns before the follower, whose energy it gives out, can know of it.
            passivity.keep(limits.store_j.get());
        }
        Ok(Self {
            side,
            reflect: p.reflect,
            spring,
            damper,
            position_scale: p.scale.position.get(),
            force_scale: p.scale.force.get(),
            is_measured: measured,
            handle_feedback: if side == CouplingSide::Leader { p.handle_feedback.get() } else { 0.0 },
            delay_damping_ratio: p.delay_damping_ratio.get(),
            lateness,
            lead,
            lag_s: period_s + lag_s + command_delay_s + lateness * period_s,
            delay_damping_at_most: p.delay_damping_at_most_ns_per_m.get(),
            compliance: ContactCompliance::new(period_s),
            clutch_open_s: p.clutch_open_s.clone(),
            period_s,
            passivity,
            session: f64::NAN,
            met: None,
            wave,
            latency: SteadyLatency::new(period_s),
            round_trip: SteadyLatency::new(period_s),
            received: zero,
            closed: false,
            limited: false,
            share: 0.0,
            reference: zero,
            reference_velocity: zero,
            offset: zero,
            target: zero,
            position: zero,
            force: zero,
            counted: zero,
            acting: zero,
            taken: zero,
            port_filter: LowPass::new(1.0 / (TAU * lag_s), period_s),
            port: None,
        })
    }

    /// Notes the force of the last command, and returns the mean force since the last cycle: the command before that one still
    /// acted for the part `lateness`.
    fn acted(&mut self) -> Vector6<f64> {
        let last = self.counted - std::mem::take(&mut self.taken) / (1.0 + self.handle_feedback);
        let before = std::mem::replace(&mut self.acting, last);
        last + (before - last) * self.lateness
    }

    /// Counts the energy that the environment has given to the follower since the last cycle, in which it has moved by `moved`.
    /// The position passes the filter of the sensed force: a force that is late would seem to give energy when the follower
    /// bounces.
    fn observe_environment(&mut self, state: &RowState, moved: &Vector6<f64>) {
        // The force is that of the measurement.
        let position: [f64; 6] = (state.position - moved * self.lead).into();
        if self.port.is_none() {
            self.port_filter.reset(&position);
        }
        let now = [Vector6::from(self.port_filter.update(&position)), state.sensed];
        if let Some([position, force]) = self.port {
            let in_j = 0.5 * (force + now[1]).dot(&(now[0] - position));
            self.passivity.observe_physical(in_j * self.force_scale / self.position_scale);
        }
        self.port = Some(now);
    }

    /// Opens the coupling: the reference stays where it is, whatever the leader does.
    fn open(&mut self, partner: Option<&Packet>) {
        (self.closed, self.limited, self.share) = (false, false, 0.0);
        self.reference_velocity.fill(0.0);
        if let Some(packet) = partner {
            self.offset = self.reference - packet.position * self.position_scale;
        }
        self.target = self.reference;
        self.restart_wave();
    }

    /// Newest packet, its position continued and its force smoothed over the jitter of the channel.
    fn continued(&mut self, partner: &ReceivedState, clock_s: f64) -> Option<Packet> {
        let mut packet = *partner.newest()?;
        if self.met != Some(packet.session) {
            self.meet(&packet);
        }
        if packet.partner_session.is_finite() && packet.partner_session != self.session {
            // The partner has not met this session: it is coupled with an earlier one.
            (packet.closed, packet.limited) = (false, false);
            (packet.echo_s, packet.energy_in_j) = (f64::NAN, 0.0);
        }
        packet.position += packet.velocity * self.latency.update(clock_s - packet.sent_s);
        self.round_trip.update(clock_s - packet.echo_s);
        let share = self.period_s / (self.period_s + self.latency.jitter_s());
        self.received += (packet.force - self.received) * share;
        packet.force = self.received;
        Some(packet)
    }

    /// Begins a session of the partner, whose clock, displacement and energies are new: the coupling closes from where the
    /// robots are.
    fn meet(&mut self, packet: &Packet) {
        self.met = Some(packet.session);
        self.latency.restart();
        self.round_trip.restart();
        self.compliance.restart();
        self.passivity.restart();
        self.passivity.rebase();
        self.open(Some(packet));
    }

    /// Forgets the waves that arrived before: a coupling that closes again must not make up for the motion while it was open.
    fn restart_wave(&mut self) {
        if let Some(wave) = &mut self.wave {
            wave.restart();
        }
    }

    /// Force by which the delay is paid for (D1). A leader that moves at v into a stiffness K feels the force of a round trip T_r
    /// ago, which is K T_r v smaller than the present one: without this force, each push would give out energy. K is that of the
    /// coupling's spring and of what the follower touches, in series. The force is taken along the received one, in its measure, so that neither motion without contact nor
    /// sliding is braked.
    fn delay_damping(&self, packet: &Packet, velocity: &Vector6<f64>) -> Vector6<f64> {
        let force = packet.force.norm();
        let Some(round_trip_s) = self.round_trip.mean_s().filter(|_| force > 0.0) else {
            return Vector6::zeros();
        };
        let delay_s = self.delay_damping_ratio * (round_trip_s + self.lag_s);
        let direction = packet.force / force;
        let stiffness = self.spring.component_mul(&direction).dot(&direction) * self.position_scale;
        let series = stiffness / (1.0 + stiffness * self.compliance.get());
        let damping = (series * delay_s).min(self.delay_damping_at_most);
        direction * (damping * direction.dot(velocity) * contact(packet))
    }

    fn lead(&mut self, cycle: &Cycle<'_>, moved: &Vector6<f64>, packet: Option<&Packet>) -> Vector6<f64> {
        let Cycle { state, .. } = *cycle;
        let wanted = match packet {
            None => {
                self.share = 0.0;
                self.compliance.restart();
                self.restart_wave();
                Vector6::zeros()
            }
            Some(packet) => {
                self.share = (self.share + self.period_s / FADE_S).min(1.0);
                let force = match self.reflect {
                    Reflected::Position => {
                        let stretch = packet.position - state.position;
                        let speed = packet.velocity - state.velocity;
                        let pull = self.spring.component_mul(&stretch);
                        let scale = self.force_scale * self.position_scale;
                        self.passivity.set_reserve(0.5 * scale * pull.dot(&stretch));
                        (pull + self.damper.component_mul(&speed)) * scale
                    }
                    _ => match &mut self.wave {
                        Some(wave) => {
                            wave.receive(packet.sent_s, &packet.wave);
                            wave.lead(&state.velocity)
                        }
                        None => {
                            self.compliance.update(&packet.force, &packet.position);
                            let braked = packet.force - self.delay_damping(packet, &state.velocity);
                            braked * self.force_scale
                        }
                    },
                };
                force * self.share
            }
        };
        if let Some(packet) = packet {
            self.passivity.receive(packet.energy_in_j);
        }
        let acted = self.acted();
        self.passivity.observe(&acted, moved);
        // The handle feedback makes each other force of the command 1 + g times smaller to the operator.
        let g = self.handle_feedback;
        let damping = cycle.damping / (1.0 + g);
        let counted = damping * packet.map_or(0.0, contact);
        let wanted = wanted - counted;
        self.counted = self.passivity.limit_force(&state.velocity, &wanted);
        self.limited = self.counted != wanted;
        self.force = self.counted + counted;
        (self.force - damping) * (1.0 + g) + state.sensed * g
    }

    fn follow(
        &mut self,
        cycle: &Cycle<'_>,
        moved: &Vector6<f64>,
        packet: Option<&Packet>,
        newest: Option<&Packet>,
    ) -> Vector6<f64> {
        let Cycle { state, .. } = *cycle;
        let energy_scale = self.force_scale / self.position_scale;
        let effort = self.effort(state);
        if self.reflect == Reflected::MeasuredForce && self.is_measured {
            self.observe_environment(state, moved);
        }
        match packet {
            None => {
                let closed = self.closed;
                self.open(newest);
                self.closed = closed;
            }
            Some(packet) => {
                self.passivity.receive(packet.energy_in_j);
                let target = self.offset + packet.position * self.position_scale;
                let step = match &mut self.wave {
                    Some(wave) => {
                        wave.receive(packet.sent_s, &packet.wave);
                        let stretch = self.reference - state.position;
                        let at_rest =
                            self.spring.component_mul(&stretch) - self.damper.component_mul(&state.velocity);
                        let per_velocity = self.spring * self.period_s + self.damper;
                        let [sp, sf] = [self.position_scale, self.force_scale];
                        wave.follow(&(at_rest * sf), &(per_velocity * (sf * sp))) * sp
                    }
                    None => {
                        // What the leader moves while the follower fades in is as with the open clutch.
                        self.share = (self.share + self.period_s / FADE_S).min(1.0);
                        let slip = (target - self.target) * (1.0 - self.share);
                        self.offset -= slip;
                        target - slip - self.target
                    }
                };
                self.target += step;
                let allowed = match self.reflect {
                    Reflected::Position => step,
                    _ => {
                        let retreat = self.retreat(packet, &effort);
                        self.passivity.add_gap(&-retreat);
                        self.passivity.pause_repair(packet.limited);
                        self.passivity.limit_displacement(&(step + retreat), &(effort * -energy_scale))
                    }
                };
                self.reference += allowed;
                self.reference_velocity = if allowed == step && self.wave.is_none() {
                    packet.velocity * (self.position_scale * self.share)
                } else {
                    allowed / self.period_s
                };
            }
        }
        let stretch = self.reference - state.position;
        let speed = self.reference_velocity - state.velocity;
        let force = self.spring.component_mul(&stretch) + self.damper.component_mul(&speed);
        let force = match self.reflect {
            Reflected::Position => {
                let stored_j = 0.5 * self.spring.component_mul(&stretch).dot(&stretch);
                self.passivity.set_reserve(energy_scale * stored_j);
                let acted = self.acted();
                self.passivity.observe(&(acted * energy_scale), moved);
                self.counted =
                    self.passivity.limit_force(&state.velocity, &(force * energy_scale)) / energy_scale;
                self.counted
            }
            _ => force,
        };
        self.force = force;
        force - cycle.damping
    }

    /// Displacement (m, rad) by which the follower retreats while the leader cannot give back the energy of its push: the
    /// leader's force is then whatever keeps it at rest, so that it would never return, and the follower with it. A retreat
    /// along the force returns energy to the leader.
    fn retreat(&self, packet: &Packet, effort: &Vector6<f64>) -> Vector6<f64> {
        let force = effort.norm();
        if !packet.limited || force == 0.0 {
            return Vector6::zeros();
        }
        let direction = effort / force;
        let lacking = force - direction.dot(&packet.force) / self.force_scale;
        direction * (lacking.max(0.0) / RETREAT_NS_PER_M * self.period_s)
    }

    /// Force on the follower that is sent to the leader.
    fn effort(&self, state: &RowState) -> Vector6<f64> {
        match self.reflect {
            Reflected::MeasuredForce => state.sensed,
            _ => -self.force,
        }
    }
}

impl CouplingLaw for Teleoperation {
    fn side(&self) -> CouplingSide {
        self.side
    }

    fn further(&self) -> &'static [RowField] {
        &FURTHER
    }

    fn needed(&self) -> &'static [RowField] {
        if self.wave.is_some() { &FURTHER } else { &[] }
    }

    fn meets_other_sessions(&self) -> bool {
        true
    }

    /// Reference of the follower; the leader's is its own position.
    fn reference(&self) -> Vector6<f64> {
        match self.side {
            CouplingSide::Leader => self.position,
            CouplingSide::Follower => self.reference,
        }
    }

    fn sent(&self, state: &RowState) -> Packet {
        let (position, velocity, force) = match self.side {
            CouplingSide::Leader => (state.position, state.velocity, self.force),
            CouplingSide::Follower => (
                (state.position - self.offset) / self.position_scale,
                state.velocity / self.position_scale,
                self.effort(state),
            ),
        };
        let wave = self.wave.as_ref().map_or_else(Vector6::zeros, |wave| *wave.sent());
        let energy_in_j = self.passivity.energy_in_j();
        let (closed, limited) = (self.closed, self.limited);
        Packet { closed, limited, energy_in_j, position, velocity, force, wave, ..Packet::default() }
    }

    fn start(&mut self, clock_s: f64, _time_s: f64) {
        (self.session, self.met) = (clock_s, None);
        for vector in [
            &mut self.reference,
            &mut self.reference_velocity,
            &mut self.offset,
            &mut self.target,
            &mut self.position,
            &mut self.force,
            &mut self.counted,
            &mut self.acting,
            &mut self.received,
            &mut self.taken,
        ] {
            vector.fill(0.0);
        }
        self.port = None;
        (self.closed, self.share) = (false, 0.0);
        self.compliance.restart();
        self.latency.restart();
        self.round_trip.restart();
        self.passivity.restart();
        self.passivity.rebase();
    }

    fn inherit(&mut self, before: &dyn CouplingLaw) {
        let Some(before) = (before as &dyn Any).downcast_ref::<Self>() else { return };
        self.passivity.inherit_state(&before.passivity);
        (self.session, self.met) = (before.session, before.met);
        self.compliance = before.compliance;
        (self.latency, self.round_trip) = (before.latency, before.round_trip);
        (self.closed, self.share) = (before.closed, before.share);
        self.reference = before.reference;
        self.reference_velocity = before.reference_velocity;
        self.offset = before.offset;
        self.target = before.target;
        self.position = before.position;
        self.force = before.force;
        self.counted = before.counted;
        self.acting = before.acting;
        self.received = before.received;
        self.taken = before.taken;
        self.port_filter = before.port_filter.clone();
        self.port = before.port;
    }

    fn update(&mut self, cycle: &Cycle<'_>) -> (Vector6<f64>, Vector6<f64>) {
        let Cycle { state, partner, clutch_open, time_s, clock_s, .. } = *cycle;
        let scheduled = || self.clutch_open_s.iter().any(|[from, until]| (*from..*until).contains(&time_s));
        let is_open = clutch_open.unwrap_or_else(scheduled);
        let newest = self.continued(partner, clock_s);
        let moved = state.position - self.position;
        self.position = state.position;
        // A robot whose own clutch is open still sends what the other one needs to see that.
        self.closed = newest.is_some() && !partner.is_stale(clock_s) && !is_open;
        let packet = newest.as_ref().filter(|packet| self.closed && packet.closed);
        let force = match self.side {
            CouplingSide::Leader => self.lead(cycle, &moved, packet),
            CouplingSide::Follower => self.follow(cycle, &moved, packet, newest.as_ref()),
        };
        (force, Vector6::zeros())
    }

    /// The reference stays at the robot.
    fn rest(&mut self, state: &RowState, partner: &ReceivedState, clock_s: f64) {
        let partner = self.continued(partner, clock_s);
        self.position = state.position;
        self.reference = state.position;
        self.open(partner.as_ref());
        self.force.fill(0.0);
        self.counted.fill(0.0);
        self.acting.fill(0.0);
        self.taken.fill(0.0);
        self.port = None;
        self.passivity.restart();
    }

    fn take_force(&mut self, taken: &Vector6<f64>) {
        self.taken = *taken;
    }

    fn record(&self, name: &str, out: &mut SignalRecorder<'_>) {
        out.scalar((name, PORT_ENERGY_OUT), "J", self.passivity.energy_out_j());
        out.scalar((name, PASSIVITY_TIME), "s", self.passivity.active_s());
    }

    fn boxed(&self) -> Box<dyn CouplingLaw> {
        Box::new(self.clone())
    }
}

/// Share of contact, from 0 to 1: of the damping that acts, or counts, in contact only.
fn contact(packet: &Packet) -> f64 {
    ((packet.force.norm() - FREE_N) / (CONTACT_N - FREE_N)).clamp(0.0, 1.0)
}

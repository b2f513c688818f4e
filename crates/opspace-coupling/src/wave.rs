//! Wave variables (Niemeyer and Slotine, *Stable adaptive teleoperation*, IEEE Journal of Oceanic Engineering 16(1), 1991;
//! *Telemanipulation with time delays*, International Journal of Robotics Research 23(9), 2004), sent as integrals.
//!
//! With the impedance b (Ns/m), the velocity ẋ and the force F from leader to follower, the sides exchange
//!
//! ```text
//! u = (b ẋ + F) / √(2b)     leader to follower          w = (b ẋ − F) / √(2b)     follower to leader          F ẋ = (u² − w²)/2
//! leader:   F = b ẋ − √(2b) w      u = √(2b) ẋ − w          the force on the handle is −F
//! follower: ẋ = √(2/b) u − F/b     w = u − √(2/b) F         F is what the follower exerts on its environment
//! ```
//!
//! The channel stores the energy of the waves in transit, ∫(u² + w²)/2 over the delay, which is not negative: the pair is
//! passive for any *constant* delay. It is not passive with jitter or loss. The packets contain ∫u dt and ∫w dt, so that
//! the reference does not drift if a packet is lost: the next one makes up for it. The periods of both sides must be
//! equal, or one an integer multiple of the other: a received wave is held for the time between two packets.
//!
//! At zero delay the pair is rigid: the sum of the follower's velocities in two consecutive cycles is twice the leader's
//! (up to the change of F/b), a lag of half a cycle. An environment with F = b ẋ reflects nothing (w = 0): the leader feels b ẋ.
//! All else is reflected. The waves themselves have no damping: echoes between a prescribed velocity and a prescribed force
//! do not decay, at zero delay those at half the rate of the cycles. A follower whose force is sensed on the stiffness K (N/m)
//! is stable for K T < 2 b, and at a damper B (Ns/m) for B < b. The force of a spring and a damper at its reference depends on
//! the reference's velocity in the same cycle: solved together, any K and B are stable.
//!
//! The identity F ẋ = (u² − w²)/2 holds for the sampled force and velocity. The work of a force that is held until the next
//! cycle differs from it by at most |F| a T² per cycle at an acceleration of at most a.

use nalgebra::Vector6;

/// One side of a pair of wave variables.
#[derive(Clone, Debug)]
pub struct WaveSide {
    impedance_ns_per_m: f64,
    period_s: f64,
    received: HeldWave,
    sent: Vector6<f64>,
}

impl WaveSide {
    /// Returns a side at rest, with the impedance b (Ns/m, or Nms/rad; above zero) and the period (s, above zero).
    #[must_use]
    pub fn new(impedance_ns_per_m: f64, period_s: f64) -> Self {
        Self { impedance_ns_per_m, period_s, received: HeldWave::new(), sent: Vector6::zeros() }
    }

    /// Notes the integral of the wave in a packet (√J·√s), and the time when it was sent (s).
    pub fn receive(&mut self, sent_s: f64, integral: &Vector6<f64>) {
        self.received.receive(sent_s, integral);
    }

    /// Leader: returns the force on the handle (N, Nm) in this cycle for the handle's velocity (m/s, rad/s). Zero, without a
    /// wave, if the velocity is not finite.
    #[must_use]
    pub fn lead(&mut self, velocity: &Vector6<f64>) -> Vector6<f64> {
        let wave = self.received.advance(self.period_s);
        let root = (2.0 * self.impedance_ns_per_m).sqrt();
        if !velocity.iter().all(|v| v.is_finite()) {
            return Vector6::zeros();
        }
        self.sent += (velocity * root - wave) * self.period_s;
        wave * root - velocity * self.impedance_ns_per_m
    }

    /// Follower: returns the displacement ẋT of its reference (m, rad) in this cycle. The force that it exerts on its environment
    /// is F = `at_rest` + `per_velocity`·ẋ: `at_rest` (N, Nm) is the force if the reference does not move, `per_velocity`
    /// (Ns/m, Nms/rad; not negative) is K T + D of a spring and a damper at the reference, zero for a sensed force. Zero,
    /// without a wave, if the force is not finite.
    #[must_use]
    pub fn follow(&mut self, at_rest: &Vector6<f64>, per_velocity: &Vector6<f64>) -> Vector6<f64> {
        let wave = self.received.advance(self.period_s);
        let (b, root) = (self.impedance_ns_per_m, (2.0 / self.impedance_ns_per_m).sqrt());
        if !at_rest.iter().all(|f| f.is_finite()) {
            return Vector6::zeros();
        }
        // b ẋ = √(2b) u − F
        let velocity = (wave * (root * b) - at_rest).component_div(&per_velocity.add_scalar(b));
        let force = at_rest + per_velocity.component_mul(&velocity);
        self.sent += (wave - force * root) * self.period_s;
        velocity * self.period_s
    }

    /// Integral of the wave to be sent after [`lead`](Self::lead) or [`follow`](Self::follow), √J·√s.
    #[must_use]
    pub fn sent(&self) -> &Vector6<f64> {
        &self.sent
    }

    /// Forgets the wave that is received. The sent integral stays; the next packet is a new beginning.
    pub fn restart(&mut self) {
        self.received = HeldWave::new();
    }
}

/// Wave of the newest packet, held for the time between its sending and that of the one before.
#[derive(Clone, Debug)]
struct HeldWave {
    /// Time of sending of the newest packet, s; `None` before the first one.
    sent_s: Option<f64>,
    /// Integral of the wave in the newest packet, and the part of it that was used.
    integral: Vector6<f64>,
    used: Vector6<f64>,
    /// Time for which the rest is to be used, s.
    left_s: f64,
}

impl HeldWave {
    fn new() -> Self {
        Self { sent_s: None, integral: Vector6::zeros(), used: Vector6::zeros(), left_s: 0.0 }
    }

    fn receive(&mut self, sent_s: f64, integral: &Vector6<f64>) {
        if !sent_s.is_finite() || !integral.iter().all(|u| u.is_finite()) {
            return;
        }
        match self.sent_s {
            None => (self.used, self.left_s) = (*integral, 0.0),
            Some(before) if sent_s > before => self.left_s += sent_s - before,
            Some(_) => return,
        }
        (self.sent_s, self.integral) = (Some(sent_s), *integral);
    }

    /// Returns the mean wave (√W) of the next `period_s` (s), and uses it.
    fn advance(&mut self, period_s: f64) -> Vector6<f64> {
        let rest = self.integral - self.used;
        // A period that ends with the time that is left uses all, in spite of rounding.
        let taken =
            if self.left_s > period_s * (1.0 + ROUNDING) { rest * (period_s / self.left_s) } else { rest };
        self.used += taken;
        self.left_s = (self.left_s - period_s).max(0.0);
        taken / period_s
    }
}

/// Relative rounding of times.
const ROUNDING: f64 = 1e-6;

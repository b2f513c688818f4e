//! Elastic gear between the rotor of a motor and its link.
//!
//! With the position θ of the rotor at the joint, that of the link q, and the reflected inertia B of the rotor:
//!
//! ```text
//! B θ̈ = τ − τ_gear        τ_gear = K d(θ − q) + D (θ̇ − q̇)
//! ```
//!
//! τ is the torque of the motor, its friction and its brake. With backlash, d has a dead zone, in which the gear has no
//! torque, and outside of it the teeth only push.
//!
//! The gear is integrated as the plant integrates the link: position for half a step, velocity under the torque in the
//! middle, position for half a step. Both together are the position form of the Störmer-Verlet method, which is
//! symplectic: a spring without damping neither gains nor loses energy on average as long as ω h < 2, with the largest
//! angular frequency ω of rotor and link and the step h. A rotor that is fast for the step makes several steps within
//! it, while the link goes on at its velocity.

/// Largest product of the step and a rate of the rotor: its angular frequency with the link held, and its damping over
/// its inertia.
const LARGEST_STEP: f64 = 0.5;

/// Largest number of steps of a rotor in a step of the plant.
pub const MAX_STEPS: f64 = 1000.0;

/// Elastic gear of a joint, with the motion of the rotor as its state.
#[derive(Clone, Debug)]
pub struct ElasticGear {
    stiffness: f64,
    damping: f64,
    /// Half of the free play, rad (m).
    half_backlash: f64,
    inertia: f64,
    steps: u32,
    position: f64,
    velocity: f64,
}

/// Parameters of an [`ElasticGear`]. For a prismatic joint read N for Nm and m for rad.
#[derive(Clone, Copy, Debug)]
pub struct GearConfig {
    /// Stiffness K, Nm/rad.
    pub stiffness: f64,
    /// Damping D, Nms/rad.
    pub damping: f64,
    /// Free play from end to end, rad.
    pub backlash: f64,
    /// Inertia B of the rotor, reflected to the joint, kg m².
    pub inertia: f64,
}

impl GearConfig {
    /// Number of steps of the rotor in a step of the plant of `dt_s` (s). `stiffness` (Nm/rad) and `damping` (Nms/rad)
    /// act on the rotor in addition to those of the gear: friction and brake.
    #[must_use]
    pub fn steps(&self, dt_s: f64, stiffness: f64, damping: f64) -> f64 {
        (self.rate(stiffness, damping) * dt_s / LARGEST_STEP).ceil().max(1.0)
    }

    /// Least rate of steps of the plant at which the gear alone needs one step of the rotor, Hz.
    pub(crate) fn least_hz(&self) -> f64 {
        self.rate(0.0, 0.0) / LARGEST_STEP
    }

    /// Fastest rate of the rotor with the link held, and with this stiffness and damping beside the gear's, rad/s.
    fn rate(&self, stiffness: f64, damping: f64) -> f64 {
        let frequency = ((self.stiffness + stiffness) / self.inertia).sqrt();
        frequency.max((self.damping + damping) / self.inertia)
    }
}

impl ElasticGear {
    /// Returns a gear at rest that carries `torque` (Nm) to a link at `q` (rad), and makes `steps` steps in a step of the
    /// plant.
    #[must_use]
    pub fn new(config: &GearConfig, steps: f64, q: f64, torque: f64) -> Self {
        let half_backlash = 0.5 * config.backlash;
        let play = if torque == 0.0 { 0.0 } else { half_backlash.copysign(torque) };
        Self {
            stiffness: config.stiffness,
            damping: config.damping,
            half_backlash,
            inertia: config.inertia,
            steps: steps.clamp(1.0, MAX_STEPS) as u32,
            position: q + torque / config.stiffness + play,
            velocity: 0.0,
        }
    }

    /// Inertia of the rotor at the joint, kg m² (kg).
    pub(crate) fn inertia(&self) -> f64 {
        self.inertia
    }

    /// Torque on the link (Nm, N) at the end of a step of `h` (s), in which the link begins at `q` (rad, m), if link and rotor
    /// have these velocities (rad/s, m/s) at its end.
    pub(crate) fn end_torque(&self, q: f64, link: f64, rotor: f64, h: f64) -> f64 {
        self.torque(self.position - q + h * (rotor - link), rotor - link)
    }

    /// Ends a step of `h` (s) with this velocity of the rotor (rad/s, m/s).
    pub(crate) fn end_step(&mut self, velocity: f64, h: f64) {
        self.position += h * velocity;
        self.velocity = velocity;
    }

    /// Position of the rotor at the joint, rad (m).
    #[must_use]
    pub fn position(&self) -> f64 {
        self.position
    }

    /// Velocity of the rotor at the joint, rad/s (m/s).
    #[must_use]
    pub fn velocity(&self) -> f64 {
        self.velocity
    }

    /// Kinetic energy of the rotor and energy of the spring, J, with the link at `q` (rad, m).
    #[must_use]
    pub fn energy(&self, q: f64) -> f64 {
        let twist = self.twist(self.position - q);
        0.5 * self.inertia * self.velocity * self.velocity + 0.5 * self.stiffness * twist * twist
    }

    /// Twist of the spring for a displacement of the rotor from the link: outside of the dead zone.
    fn twist(&self, displacement: f64) -> f64 {
        displacement - displacement.clamp(-self.half_backlash, self.half_backlash)
    }

    /// Torque on the link for a displacement of the rotor from the link, and its rate.
    fn torque(&self, displacement: f64, rate: f64) -> f64 {
        if self.half_backlash == 0.0 {
            return self.stiffness * displacement + self.damping * rate;
        }
        let twist = self.twist(displacement);
        let torque = self.stiffness * twist + self.damping * rate;
        // Teeth push; they do not pull.
        if twist > 0.0 {
            torque.max(0.0)
        } else if twist < 0.0 {
            torque.min(0.0)
        } else {
            0.0
        }
    }

    /// Advances the rotor by a step of the plant of `dt_s` (s), in which the link begins at `q` (rad) with velocity `dq`
    /// (rad/s). `torque(θ, θ̇, h)` is the torque on the rotor (Nm) over a step of h (s). Returns the mean torque of the
    /// gear on the link (Nm).
    pub fn step(&mut self, q: f64, dq: f64, dt_s: f64, mut torque: impl FnMut(f64, f64, f64) -> f64) -> f64 {
        let h = dt_s / f64::from(self.steps);
        let mut sum = 0.0;
        for step in 0..self.steps {
            let link = q + dq * h * (f64::from(step) + 0.5);
            let middle = self.position + 0.5 * h * self.velocity;
            let gear = self.torque(middle - link, self.velocity - dq);
            let before = self.velocity;
            self.velocity += h / self.inertia * (torque(middle, before, h) - gear);
            self.position = middle + 0.5 * h * self.velocity;
            sum += gear;
        }
        sum / f64::from(self.steps)
    }
}

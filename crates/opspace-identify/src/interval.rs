//! Exact model of a drive and its joint within an interface interval: servo ticks, held or interpolated setpoint,
//! delay, current loop.
//!
//! The joint has inertia I, motor torque m and a smooth force F; its servo runs R times per setpoint:
//!
//! ```text
//! w += a ((y − y₋)/T_s − w)     u = kv [kp (r − y) + f (r − r₋)/T_s − w]     ṁ = (u − m)/T_m     I q̈ = m + F
//! ```
//!
//! r is the setpoint q_d after its filter, if the drive has one, and f the fraction of its velocity that is fed
//! forward.
//!
//! At a frequency of the setpoints both outputs, the position at the interface cycle and the mean torque over the
//! interval, are linear in setpoint and force, including aliases:
//!
//! ```text
//! y = A q_d + B F        τ̄ = C q_d + D F
//! ```
//!
//! Eliminating F gives the torque from commanded **and measured** values, for any force on the joint: friction,
//! gravity, other joints. I then affects only the motion within the interval.

use nalgebra::{Complex, Matrix2, SMatrix, SVector, Vector2};
use opspace_backend::{CommandDelay, Setpoints};
use serde::Serialize;
use std::f64::consts::TAU;

/// Rates and delay of a drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Time between two servo ticks, s.
    pub servo_period_s: f64,
    /// Servo ticks per interface cycle.
    pub servo_ticks_per_cycle: u32,
    /// Delay until a setpoint acts, in servo ticks.
    pub delay: u32,
    /// Behaviour of the drive between two setpoints: hold or interpolate.
    pub setpoints: Setpoints,
}

impl Rates {
    /// Time between two interface cycles, s.
    #[must_use]
    pub fn period_s(&self) -> f64 {
        f64::from(self.servo_ticks_per_cycle) * self.servo_period_s
    }

    /// Whole interface cycles of the delay, and these rates with the rest of it, at most one cycle.
    fn split(self) -> (u32, Self) {
        let ratio = self.servo_ticks_per_cycle;
        let waiting_cycles = CommandDelay::of_ticks(self.delay, ratio).waiting_cycles;
        (waiting_cycles, Self { delay: self.delay - waiting_cycles * ratio, ..self })
    }
}

/// Parameters of a drive and its joint.
#[derive(Clone, Copy, Debug)]
pub struct Drive {
    /// Position gain, 1/s.
    pub kp: f64,
    /// Velocity gain, Nms/rad (Ns/m).
    pub kv: f64,
    /// Cut-off of the velocity filter, Hz.
    pub velocity_filter_hz: f64,
    /// Bandwidth of the current loop, Hz; infinite if the motor follows without lag.
    pub current_loop_hz: f64,
    /// Inertia that the drive moves, kg m² (kg).
    pub inertia: f64,
    /// Fraction of the setpoint's velocity that is fed forward.
    pub velocity_feed_forward: f64,
    /// Filter of the setpoint.
    pub setpoint_filter: SetpointFilterModel,
}

/// Low-pass filter of the setpoint at servo rate, exact for setpoints that are constant over each servo period.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum SetpointFilterModel {
    /// No filter.
    #[default]
    None,
    /// `ω/(s + ω)`.
    FirstOrder {
        /// Cut-off frequency, Hz.
        cutoff_hz: f64,
    },
    /// `ω²/(s² + 2 ζ ω s + ω²)`.
    SecondOrder {
        /// Natural frequency, Hz.
        natural_frequency_hz: f64,
        /// Damping ratio ζ.
        damping_ratio: f64,
    },
}

impl SetpointFilterModel {
    /// Lag of its output behind a setpoint that moves at constant velocity, s.
    #[must_use]
    pub fn lag_s(self) -> f64 {
        match self {
            Self::None => 0.0,
            Self::FirstOrder { cutoff_hz } => 1.0 / (TAU * cutoff_hz),
            Self::SecondOrder { natural_frequency_hz, damping_ratio } => {
                2.0 * damping_ratio / (TAU * natural_frequency_hz)
            }
        }
    }

    /// Transition matrix, over a servo period, of the distance of the filter's output from the setpoint and its rate.
    fn transition(self, period_s: f64) -> [[f64; 2]; 2] {
        match self {
            Self::None => [[0.0; 2]; 2],
            Self::FirstOrder { cutoff_hz } => [[(-TAU * cutoff_hz * period_s).exp(), 0.0], [0.0; 2]],
            Self::SecondOrder { natural_frequency_hz, damping_ratio } => {
                let natural = TAU * natural_frequency_hz;
                let decay = damping_ratio * natural;
                // Imaginary below critical damping. The offset avoids the quotient 0/0 at critical damping.
                let split =
                    Complex::new(natural * natural * (damping_ratio * damping_ratio - 1.0) + 1e-9, 0.0)
                        .sqrt();
                let fading = (-decay * period_s).exp();
                let cosine = fading * (split * period_s).cosh().re;
                let sine = fading * ((split * period_s).sinh() / split).re;
                [[cosine + decay * sine, sine], [-natural * natural * sine, cosine - decay * sine]]
            }
        }
    }
}

/// Number of states of an interval: q, q̇, w, y₋, m.
const MEMORY: usize = 5;
type Memory = SVector<f64, MEMORY>;
type ComplexMatrix = SMatrix<Complex<f64>, MEMORY, MEMORY>;

/// Setpoint of an interval and the two before it.
type Setpoints3 = [f64; 3];

/// Output of the setpoint filter, and its rate.
type Path = [f64; 2];

/// Frequency responses of the interval at one frequency.
#[derive(Clone, Copy, Debug)]
pub struct Responses {
    /// A: position at the interface cycle per unit of position setpoint.
    pub position_of_setpoint: Complex<f64>,
    /// B: position at the interface cycle per unit of force, rad/Nm (m/N).
    pub position_of_force: Complex<f64>,
    /// C: mean torque per unit of setpoint, Nm/rad (N/m).
    pub torque_of_setpoint: Complex<f64>,
    /// D: mean torque per unit of force.
    pub torque_of_force: Complex<f64>,
}

impl Responses {
    /// Force per unit of setpoint that explains a measured position response, Nm/rad (N/m).
    #[must_use]
    pub fn force(&self, position: Complex<f64>) -> Complex<f64> {
        (position - self.position_of_setpoint) / self.position_of_force
    }

    /// Force per unit of setpoint that explains measured position and torque responses, Nm/rad (N/m). The setpoint is
    /// eliminated: the gains of the servo matter only for the course of the torque within the interval.
    #[must_use]
    pub fn force_of_torque(&self, position: Complex<f64>, torque: Complex<f64>) -> Complex<f64> {
        let position_of_torque = self.position_of_setpoint / self.torque_of_setpoint;
        (position - position_of_torque * torque)
            / (self.position_of_force - position_of_torque * self.torque_of_force)
    }

    /// Mean torque per unit of setpoint for a measured position response, Nm/rad (N/m).
    #[must_use]
    pub fn torque(&self, position: Complex<f64>) -> Complex<f64> {
        self.torque_of_setpoint + self.torque_of_force * self.force(position)
    }

    /// Position response if the force is `force_per_position` (Nm/rad, N/m) times the position.
    #[must_use]
    pub fn position_with_load(&self, force_per_position: Complex<f64>) -> Complex<f64> {
        let one = Complex::new(1.0, 0.0);
        self.position_of_setpoint / (one - self.position_of_force * force_per_position)
    }

    /// Position response if the only force is viscous friction `b` (Nms/rad), at the angular frequency `omega` (rad/s).
    #[must_use]
    pub fn position_with_friction(&self, b: f64, omega: f64) -> Complex<f64> {
        self.position_with_load(Complex::new(0.0, -b * omega))
    }
}

/// Linear map of an interface interval, for one drive and its rates.
#[derive(Clone, Debug)]
pub struct Interval {
    rates: Rates,
    /// Whole interface cycles during which a setpoint waits.
    waiting_cycles: u32,
    /// Maps from the state to the next state, and to the mean torque.
    memory: SMatrix<f64, MEMORY, MEMORY>,
    memory_torque: Memory,
    /// Maps from the filtered setpoint, its rate and the three setpoints, and to the mean torque.
    inputs: SMatrix<f64, MEMORY, 5>,
    inputs_torque: [f64; 5],
    /// Maps from the filtered setpoint, its rate and the three setpoints to the next filtered setpoint and its rate.
    path: SMatrix<f64, 2, 5>,
    /// Maps from a force that acts during one servo period, for each servo period.
    force: Vec<(Memory, f64)>,
}

impl Interval {
    /// Returns the map of a drive at these rates.
    #[must_use]
    pub fn new(drive: &Drive, rates: Rates) -> Self {
        let tick = Tick::new(drive, rates.servo_period_s);
        let (waiting_cycles, rates) = rates.split();
        let mut memory = SMatrix::<f64, MEMORY, MEMORY>::zeros();
        let mut memory_torque = Memory::zeros();
        for i in 0..MEMORY {
            let mut unit = Memory::zeros();
            unit[i] = 1.0;
            let end = tick.roll(unit, &rates, [0.0; 2], [0.0; 3], None);
            memory.set_column(i, &end.memory);
            memory_torque[i] = end.torque;
        }
        let mut inputs = SMatrix::<f64, MEMORY, 5>::zeros();
        let mut inputs_torque = [0.0; 5];
        let mut path = SMatrix::<f64, 2, 5>::zeros();
        for (i, input_torque) in inputs_torque.iter_mut().enumerate() {
            let unit: [f64; 5] = std::array::from_fn(|j| f64::from(u8::from(i == j)));
            let end =
                tick.roll(Memory::zeros(), &rates, [unit[0], unit[1]], [unit[2], unit[3], unit[4]], None);
            inputs.set_column(i, &end.memory);
            *input_torque = end.torque;
            path.set_column(i, &end.path.into());
        }
        let force = (0..rates.servo_ticks_per_cycle)
            .map(|j| tick.roll(Memory::zeros(), &rates, [0.0; 2], [0.0; 3], Some(j)))
            .map(|end| (end.memory, end.torque))
            .collect();
        Self { rates, waiting_cycles, memory, memory_torque, inputs, inputs_torque, path, force }
    }

    /// Returns the responses at the frequency `hz` (Hz); `None` if the map has a pole there.
    #[must_use]
    pub fn responses(&self, hz: f64) -> Option<Responses> {
        let omega = TAU * hz;
        let z = Complex::from_polar(1.0, omega * self.rates.period_s());
        let mut pencil: ComplexMatrix = self.memory.map(|v| Complex::new(-v, 0.0));
        for i in 0..MEMORY {
            pencil[(i, i)] += z;
        }
        let mut push = SVector::<Complex<f64>, MEMORY>::zeros();
        let mut push_torque = Complex::new(0.0, 0.0);
        for (j, (end, torque)) in self.force.iter().enumerate() {
            let phase = Complex::from_polar(1.0, omega * (j as f64 + 0.5) * self.rates.servo_period_s);
            push += end.map(|v| phase * v);
            push_torque += phase * *torque;
        }
        let inputs = self.inputs_at(z)?;
        let (mut drive, mut drive_torque) =
            (SVector::<Complex<f64>, MEMORY>::zeros(), Complex::new(0.0, 0.0));
        for (i, input) in inputs.iter().enumerate() {
            drive += self.inputs.column(i).map(|v| input * v);
            drive_torque += input * self.inputs_torque[i];
        }
        let factor = pencil.lu();
        let of_setpoint = factor.solve(&drive)?;
        let of_force = factor.solve(&push)?;
        let torque = |x: &SVector<Complex<f64>, MEMORY>| -> Complex<f64> {
            x.iter().zip(self.memory_torque.iter()).map(|(x, c)| x * *c).sum()
        };
        Some(Responses {
            position_of_setpoint: of_setpoint[0],
            position_of_force: of_force[0],
            torque_of_setpoint: torque(&of_setpoint) + drive_torque,
            torque_of_force: torque(&of_force) + push_torque,
        })
    }

    /// Filtered setpoint, its rate and the three setpoints per unit of setpoint, for z = exp(jωT).
    fn inputs_at(&self, z: Complex<f64>) -> Option<[Complex<f64>; 5]> {
        let back = z.conj();
        let latest = back.powu(self.waiting_cycles);
        let setpoints = [latest, latest * back, latest * back * back];
        let of = |row: usize| (0..3).map(|i| setpoints[i] * self.path[(row, 2 + i)]).sum::<Complex<f64>>();
        let pencil = Matrix2::new(
            z - self.path[(0, 0)],
            Complex::new(-self.path[(0, 1)], 0.0),
            Complex::new(-self.path[(1, 0)], 0.0),
            z - self.path[(1, 1)],
        );
        let path = pencil.try_inverse()? * Vector2::new(of(0), of(1));
        Some([path[0], path[1], setpoints[0], setpoints[1], setpoints[2]])
    }
}

/// State at the end of an interval, and the mean torque over it.
struct End {
    memory: Memory,
    path: Path,
    torque: f64,
}

/// Coefficients of one servo period.
#[derive(Clone, Copy, Debug)]
struct Tick {
    period_s: f64,
    kp: f64,
    kv: f64,
    filter: f64,
    inertia: f64,
    /// Decay of the motor's lag over a servo period, its time integral, and the integral of the latter.
    lag: f64,
    lag_s: f64,
    lag_s2: f64,
    feed_forward: f64,
    setpoint_filter: [[f64; 2]; 2],
}

impl Tick {
    fn new(drive: &Drive, period_s: f64) -> Self {
        let time_s = 1.0 / (TAU * drive.current_loop_hz);
        let lag = (-period_s / time_s).exp();
        let lag_s = time_s * (1.0 - lag);
        Self {
            period_s,
            kp: drive.kp,
            kv: drive.kv,
            filter: 1.0 - (-TAU * drive.velocity_filter_hz * period_s).exp(),
            inertia: drive.inertia,
            lag,
            lag_s,
            lag_s2: time_s * (period_s - lag_s),
            feed_forward: drive.velocity_feed_forward,
            setpoint_filter: drive.setpoint_filter.transition(period_s),
        }
    }

    /// Simulates an interval from the state `memory` and `path`, with its setpoint and the two before it, and a force of 1
    /// during the servo period `pushed`. The delay is at most one interval.
    fn roll(
        &self,
        memory: Memory,
        rates: &Rates,
        path: Path,
        setpoints: Setpoints3,
        pushed: Option<u32>,
    ) -> End {
        let [mut q, mut dq, mut w, mut last, mut motor] = memory.data.0[0];
        let [setpoint, before, earlier] = setpoints;
        let [mut path, mut path_rate] = path;
        let [[to_gap, gap_of_rate], [to_rate, rate_of_rate]] = self.setpoint_filter;
        let t = self.period_s;
        let mut sum = 0.0;
        for j in 0..rates.servo_ticks_per_cycle {
            let wanted = if j >= rates.delay {
                rates.setpoints.at(before, setpoint, j - rates.delay, rates.servo_ticks_per_cycle)
            } else {
                rates.setpoints.at(
                    earlier,
                    before,
                    rates.servo_ticks_per_cycle - rates.delay + j,
                    rates.servo_ticks_per_cycle,
                )
            };
            w += self.filter * ((q - last) / t - w);
            last = q;
            let (gap, path_before) = (path - wanted, path);
            path = wanted + to_gap * gap + gap_of_rate * path_rate;
            path_rate = to_rate * gap + rate_of_rate * path_rate;
            let forward = self.feed_forward * (path - path_before) / t;
            let asked = self.kv * (self.kp * (path - q) + forward - w);
            let gap = motor - asked;
            let force = if pushed == Some(j) { 1.0 } else { 0.0 };
            sum += asked + gap * self.lag_s / t;
            q += t * dq + (0.5 * t * t * (asked + force) + gap * self.lag_s2) / self.inertia;
            dq += (t * (asked + force) + gap * self.lag_s) / self.inertia;
            motor = asked + gap * self.lag;
        }
        let memory = Memory::from([q, dq, w, last, motor]);
        End { memory, path: [path, path_rate], torque: sum / f64::from(rates.servo_ticks_per_cycle) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATES: Rates =
        Rates { servo_period_s: 1e-3, servo_ticks_per_cycle: 5, delay: 2, setpoints: Setpoints::Held };

    fn drive() -> Drive {
        Drive {
            kp: 25.0,
            kv: 47.0,
            velocity_filter_hz: 200.0,
            current_loop_hz: 1000.0,
            inertia: 0.38,
            velocity_feed_forward: 0.6,
            setpoint_filter: SetpointFilterModel::SecondOrder {
                natural_frequency_hz: 30.0,
                damping_ratio: 0.8,
            },
        }
    }

    /// Compares the frequency response with the steady state of the same recursion, simulated in time under a sine.
    #[test]
    fn responses_match_steady_state_sine() {
        const TOLERANCE: f64 = 1e-6;
        let tick = Tick::new(&drive(), RATES.servo_period_s);
        let interval = Interval::new(&drive(), RATES);
        // Frequencies with a whole number of periods per second.
        for hz in [3.0, 11.0, 40.0] {
            let (mut memory, mut path, mut before) = (Memory::zeros(), [0.0; 2], [0.0; 2]);
            let (mut y, mut tau) = (Complex::<f64>::default(), Complex::<f64>::default());
            for k in 0..2000 {
                let back = Complex::from_polar(1.0, -TAU * hz * f64::from(k) * RATES.period_s());
                let setpoint = back.conj().re;
                let position = memory[0];
                let end = tick.roll(memory, &RATES, path, [setpoint, before[0], before[1]], None);
                (memory, path, before) = (end.memory, end.path, [setpoint, before[0]]);
                if k >= 1800 {
                    y += back * position * 2.0 / 200.0;
                    tau += back * end.torque * 2.0 / 200.0;
                }
            }
            let expected = interval.responses(hz).expect("no pole there");
            assert!((y - expected.position_of_setpoint).norm() < TOLERANCE, "{hz} Hz: {y}");
            let error = (tau - expected.torque_of_setpoint).norm();
            assert!(error < TOLERANCE * expected.torque_of_setpoint.norm().max(1.0), "{hz} Hz: {error}");
        }
    }

    /// Compares the torque computed from setpoint and position with the torque of the same drive, for different forces
    /// on its joint.
    #[test]
    fn torque_estimate_is_independent_of_other_forces() {
        const TOLERANCE: f64 = 1e-9;
        let interval = Interval::new(&drive(), RATES);
        for hz in [0.5, 7.0, 60.0] {
            let r = interval.responses(hz).expect("no pole there");
            for force in [Complex::new(0.0, 0.0), Complex::new(30.0, -12.0)] {
                let y = r.position_of_setpoint + r.position_of_force * force;
                let tau = r.torque_of_setpoint + r.torque_of_force * force;
                assert!((r.torque(y) - tau).norm() < TOLERANCE * tau.norm());
                assert!((r.force(y) - force).norm() < TOLERANCE * (1.0 + force.norm()));
            }
        }
    }

    #[test]
    fn lag_free_motor_is_limit_of_fast_motor() {
        const TOLERANCE: f64 = 1e-4;
        let at = |current_loop_hz| Interval::new(&Drive { current_loop_hz, ..drive() }, RATES).responses(9.0);
        let (fast, none) = (at(1e7).expect("no pole there"), at(f64::INFINITY).expect("no pole there"));
        assert!((fast.position_of_setpoint - none.position_of_setpoint).norm() < TOLERANCE);
    }
}

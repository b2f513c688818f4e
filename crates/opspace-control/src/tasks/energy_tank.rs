//! Energy tank: lets the stiffness of an impedance vary without making the robot active.
//!
//! A spring of stiffness k at the error e stores k e²/2. Letting k grow adds Δk e²/2, which an environment that moves the
//! robot could extract again and again. The tank pays for it with what the damper dissipates (Ferraguti, Secchi and Fantuzzi,
//! *A tank-based approach to impedance control with variable stiffness*, ICRA 2013; Schindlbeck and Haddadin, *Unified
//! passivity-based Cartesian force/impedance control for rigid and flexible joint robots via task-energy tanks*, ICRA 2015):
//!
//! ```text
//! tank ← min(capacity, tank + F·Δe − Σ k (e′² − e²)/2)      dissipated since the last cycle
//! tank ← min(capacity, tank + Σ |Δk| e′²/2)                 of axes that become softer
//! tank ← tank − share Σ Δk e′²/2                            of axes that become stiffer, by this share of Δk
//! ```
//!
//! F is the commanded force on the axes, Δe = e′ − e the change of the errors until the next cycle, in which F is constant.
//! F·Δe is therefore the exact energy that the controller received at this port, and for any motion and any stiffness over
//! time it delivers at most the tank at the start and the energy of the springs at the start. The sampled spring itself
//! delivers k Δe²/2 per cycle; if the damper does not dissipate it, the tank goes below zero by that amount, and no stiffness
//! grows until this is repaid: the *debt*, which a damping of at least k T/2 of the mean velocity in each cycle prevents.

use nalgebra::Vector6;
use opspace_backend::quantity::{NonNegative, Positive};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Energy tank of an impedance whose stiffness varies.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct TankParameters {
    /// Energy at the start, J, at most `capacity_j`. It is all that the growth of the stiffness can ever deliver.
    pub initial_j: NonNegative,
    /// Largest energy, J. Dissipation beyond it is lost.
    pub capacity_j: Positive,
}

impl Default for TankParameters {
    fn default() -> Self {
        Self { initial_j: NonNegative::literal(0.5), capacity_j: Positive::literal(2.0) }
    }
}

/// Energy tank and the stiffness that it allows. Units: J; N/m and m, or Nm/rad and rad.
#[derive(Clone, Debug)]
pub(crate) struct EnergyTank {
    initial_j: f64,
    capacity_j: f64,
    level_j: f64,
    /// Stiffness that is applied.
    stiffness: Vector6<f64>,
    /// Errors and force of the last cycle; `None` if the errors since then are not due to motion.
    last: Option<Port>,
}

/// Errors of the axes in a cycle, and the force on them until the next one.
#[derive(Clone, Copy, Debug)]
struct Port {
    error: Vector6<f64>,
    force: Option<Vector6<f64>>,
}

impl EnergyTank {
    pub(crate) fn new(parameters: &TankParameters, stiffness: Vector6<f64>) -> Self {
        let TankParameters { initial_j, capacity_j } = *parameters;
        let (initial_j, capacity_j) = (initial_j.get(), capacity_j.get());
        Self { initial_j, capacity_j, level_j: initial_j, stiffness, last: None }
    }

    /// Starts with the initial energy and a stiffness.
    pub(crate) fn start(&mut self, stiffness: Vector6<f64>) {
        (self.level_j, self.stiffness, self.last) = (self.initial_j, stiffness, None);
    }

    /// Continues with energy and stiffness of another tank, or with the stiffness of an impedance without a tank.
    pub(crate) fn continue_from(&mut self, before: Option<&Self>, stiffness: Vector6<f64>) {
        match before {
            Some(before) => {
                self.level_j = before.level_j.min(self.capacity_j);
                (self.stiffness, self.last) = (before.stiffness, before.last);
            }
            None => self.start(stiffness),
        }
    }

    /// Notes that the errors change without motion: what happens until the next cycle is not counted.
    pub(crate) fn interrupt(&mut self) {
        self.last = None;
    }

    /// Energy of the tank, J.
    pub(crate) fn level_j(&self) -> f64 {
        self.level_j
    }

    /// Stiffness that is applied.
    pub(crate) fn stiffness(&self) -> &Vector6<f64> {
        &self.stiffness
    }

    /// Lets the stiffness approach `desired` as far as the tank allows, at the errors of this cycle. A cycle with errors that
    /// are not finite changes nothing.
    pub(crate) fn update(&mut self, desired: &Vector6<f64>, error: &Vector6<f64>) {
        if !error.iter().all(|e| e.is_finite()) {
            self.last = None;
            return;
        }
        if let Some(Port { error: before, force: Some(force) }) = self.last {
            let spring = |i: usize| 0.5 * self.stiffness[i] * (error[i] * error[i] - before[i] * before[i]);
            let stored: f64 = (0..6).map(spring).sum();
            self.fill(force.dot(&(error - before)) - stored);
        }
        let (mut gained, mut needed) = (0.0, 0.0);
        for i in 0..6 {
            let energy = 0.5 * (desired[i] - self.stiffness[i]) * error[i] * error[i];
            if energy > 0.0 { needed += energy } else { gained -= energy }
        }
        self.fill(gained);
        let level_j = self.level_j.max(0.0);
        let share = if needed <= level_j { 1.0 } else { level_j / needed };
        for i in 0..6 {
            let change = desired[i] - self.stiffness[i];
            // Stiffness at an error of zero costs nothing.
            let allowed = if change <= 0.0 || share == 1.0 || error[i] == 0.0 { 1.0 } else { share };
            self.stiffness[i] =
                if allowed == 1.0 { desired[i] } else { self.stiffness[i] + allowed * change };
        }
        self.level_j -= (share * needed).min(level_j);
        self.last = Some(Port { error: *error, force: None });
    }

    /// Notes the force on the axes that is commanded in this cycle.
    pub(crate) fn set_force(&mut self, force: &Vector6<f64>) {
        if let Some(last) = &mut self.last {
            last.force = force.iter().all(|f| f.is_finite()).then_some(*force);
        }
    }

    fn fill(&mut self, energy_j: f64) {
        self.level_j = (self.level_j + energy_j).min(self.capacity_j);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_S: f64 = 1e-3;

    /// Rounding of the energies of a run, J, and of a stiffness, N/m.
    const ROUNDING: f64 = 1e-9;

    /// Rounding of a single energy, J.
    const ROUNDING_J: f64 = 1e-12;

    /// Reproducible pseudo-random numbers in [0, 1).
    struct Numbers(u64);

    impl Numbers {
        fn next(&mut self) -> f64 {
            self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (self.0 >> 11) as f64 / (1_u64 << 53) as f64
        }
    }

    fn tank(initial_j: f64, capacity_j: f64, stiffness: Vector6<f64>) -> EnergyTank {
        let parameters = TankParameters {
            initial_j: NonNegative::try_from(initial_j).expect("not negative"),
            capacity_j: Positive::try_from(capacity_j).expect("positive"),
        };
        EnergyTank::new(&parameters, stiffness)
    }

    /// Two axes of a port that moves as a sum of sines, and a stiffness that an adversary selects.
    struct Motion {
        amplitude: [f64; 2],
        rate: [f64; 2],
        phase: [f64; 2],
        stiff: f64,
        soft: f64,
        /// Each fraction of cycles in which the stiffness is random.
        random: f64,
    }

    impl Motion {
        fn new(numbers: &mut Numbers) -> Self {
            let mut two = |low: f64, high: f64| [0, 1].map(|_| low + (high - low) * numbers.next());
            let (amplitude, rate, phase) = (two(0.01, 0.1), two(2.0, 40.0), two(0.0, 6.0));
            let [soft, stiff] = [two(0.0, 500.0)[0], two(500.0, 4000.0)[0]];
            Self { amplitude, rate, phase, stiff, soft, random: numbers.next() * 0.5 }
        }

        fn error(&self, step: usize) -> Vector6<f64> {
            let t = PERIOD_S * step as f64;
            let at = |i: usize| self.amplitude[i] * (self.rate[i] * t + self.phase[i]).sin();
            Vector6::new(at(0), 0.0, 0.0, 0.0, at(1), 0.0)
        }

        /// Soft while the error grows, stiff while it shrinks: the spring returns more than it took.
        fn stiffness(&self, step: usize, numbers: &mut Numbers) -> Vector6<f64> {
            let (now, next) = (self.error(step), self.error(step + 1));
            Vector6::from_fn(|i, _| {
                if numbers.next() < self.random {
                    self.soft + (self.stiff - self.soft) * numbers.next()
                } else if next[i].abs() < now[i].abs() {
                    self.stiff
                } else {
                    self.soft
                }
            })
        }
    }

    /// Energy that the port delivered in a run, the energy of tank and springs at the start, the least level of the tank, and
    /// whether the tank held a stiffness back.
    struct Outcome {
        delivered_j: f64,
        initial_j: f64,
        least_level_j: f64,
        held_back: bool,
    }

    /// Moves the port for 4 s. `damping` gives the damping for the stiffest spring; without a tank, the desired stiffness
    /// is applied. Checks the balance of energy in every cycle.
    fn run(seed: u64, damping: impl Fn(f64) -> f64, with_tank: bool) -> Outcome {
        let mut numbers = Numbers(seed);
        let motion = Motion::new(&mut numbers);
        let soft = Vector6::repeat(motion.soft);
        let (initial, capacity) = (0.3 * numbers.next(), 0.3 + numbers.next());
        let mut tank = tank(initial, capacity, soft);
        let d = damping(motion.stiff);
        let energy = |k: &Vector6<f64>, e: &Vector6<f64>| 0.5 * k.component_mul(e).dot(e);
        let initial_j = initial + energy(&soft, &motion.error(0));
        let mut outcome = Outcome { delivered_j: 0.0, initial_j, least_level_j: initial, held_back: false };
        for step in 0..4000 {
            let (error, next) = (motion.error(step), motion.error(step + 1));
            let desired = motion.stiffness(step, &mut numbers);
            tank.update(&desired, &error);
            let stiffness = if with_tank { *tank.stiffness() } else { desired };
            outcome.held_back |= (desired - stiffness).max() > 1.0;
            let force = stiffness.component_mul(&error) + (next - error) * (d / PERIOD_S);
            tank.set_force(&force);
            if with_tank {
                let sum = outcome.delivered_j + energy(&stiffness, &error) + tank.level_j();
                assert!(sum <= initial_j + ROUNDING, "seed {seed}, step {step}: {sum} J of {initial_j} J");
                assert!(tank.level_j() <= capacity);
                let beyond = stiffness - desired;
                assert!(
                    beyond.max() <= ROUNDING,
                    "seed {seed}, step {step}: stiffer than desired by {beyond}"
                );
            }
            outcome.delivered_j -= force.dot(&(next - error));
            outcome.least_level_j = outcome.least_level_j.min(tank.level_j());
        }
        outcome
    }

    /// Whatever the stiffness over time and the motion: with a damping of k T/2 or more, the port never delivers more than the
    /// energy of the tank and the springs at the start. Without the tank, the same stiffness delivers more.
    #[test]
    fn port_delivers_at_most_the_initial_energy() {
        let (mut active, mut held_back) = (0, 0);
        for seed in 1..=60 {
            let damping = |stiff: f64| 0.5 * stiff * PERIOD_S * (1.0 + 4.0 * Numbers(seed).next());
            let outcome = run(seed, damping, true);
            assert!(outcome.delivered_j <= outcome.initial_j + ROUNDING, "seed {seed}");
            assert!(outcome.least_level_j >= -ROUNDING_J, "seed {seed}: {} J", outcome.least_level_j);
            held_back += usize::from(outcome.held_back);
            let without = run(seed, damping, false);
            active += usize::from(without.delivered_j > without.initial_j + 0.1);
        }
        assert!(
            active > 45 && held_back > 45,
            "the stiffness of {active} is active, {held_back} are held back"
        );
    }

    /// Without a damper, the sampled spring delivers k Δe²/2 per cycle: the tank goes below zero by no more than this sum, and
    /// the port delivers at most the initial energy and the debt.
    #[test]
    fn debt_is_the_energy_of_the_sampled_springs() {
        let mut in_debt = 0;
        for seed in 1..=30 {
            let outcome = run(seed, |_| 0.0, true);
            let mut numbers = Numbers(seed);
            let motion = Motion::new(&mut numbers);
            let steps = (0..4000).map(|step| (motion.error(step + 1) - motion.error(step)).norm_squared());
            let sampled: f64 = steps.map(|square| 0.5 * motion.stiff * square).sum();
            assert!(outcome.least_level_j >= -sampled, "seed {seed}: {} {sampled}", outcome.least_level_j);
            assert!(outcome.delivered_j <= outcome.initial_j + sampled, "seed {seed}");
            in_debt += usize::from(outcome.least_level_j < 0.0);
        }
        assert!(in_debt > 15, "{in_debt}");
    }

    /// An empty tank holds the stiffness except at an error of zero; a full one lets it grow at once.
    #[test]
    fn empty_tank_holds_the_stiffness() {
        let soft = Vector6::repeat(100.0);
        let mut empty = tank(0.0, 1.0, soft);
        let error = Vector6::new(0.1, 0.0, 0.0, 0.0, 0.0, 0.0);
        empty.update(&Vector6::repeat(300.0), &error);
        assert_eq!(*empty.stiffness(), Vector6::new(100.0, 300.0, 300.0, 300.0, 300.0, 300.0));
        let mut full = tank(2.0, 2.0, soft);
        full.update(&Vector6::repeat(300.0), &error);
        assert_eq!(*full.stiffness(), Vector6::repeat(300.0));
        assert!((full.level_j() - 1.0).abs() < ROUNDING_J);
        // What the spring loses goes back to the tank.
        full.update(&soft, &error);
        assert_eq!(*full.stiffness(), soft);
        assert!((full.level_j() - 2.0).abs() < ROUNDING_J);
    }
}

//! Operator who holds a frame of the robot by a spring: `[environment.NAME.spring]`.

use crate::environment::contact::direction;
use crate::environment::mistake::{Mistake, check_frequency, check_length};
use crate::sines::{SINES, Sines};
use nalgebra::Vector3;
use opspace_backend::quantity::{NonNegative, Positive, exactly};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize};
use std::f64::consts::TAU;

/// Spring and damper between frame and operator: `F = gain ∘ [K (x_operator − x) + B (ẋ_operator − ẋ)]`. The operator
/// starts at the frame's initial position.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct SpringParameters {
    /// Name of the frame that the operator holds.
    pub frame: String,
    /// Stiffness K, N/m.
    pub stiffness_n_per_m: NonNegative,
    /// Damping B, Ns/m.
    pub damping_ns_per_m: NonNegative,
    /// Factor on K and B in x, y and z of the world.
    #[serde(default = "everywhere", deserialize_with = "exactly")]
    pub gain: [NonNegative; 3],
    /// World axes for which its force and the frame's motion are reported.
    #[serde(default = "all_axes")]
    #[cfg_attr(feature = "schema", schemars(extend("minItems" = 1)))]
    pub report: Vec<WorldAxis>,
    /// Point at which the operator is at the start, in world coordinates, m.
    #[serde(default, deserialize_with = "point")]
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "the frame's initial position")))]
    pub point_m: Option<[f64; 3]>,
    /// Times during which the operator lets go of the frame. Without `point_m`, the operator then takes hold of it where it
    /// is; with `point_m`, its motion remains about that point.
    #[serde(default)]
    pub released: Vec<ReleaseParameters>,
    /// Motion of the operator.
    pub motion: OperatorMotion,
}

/// Time during which an operator does not hold the frame.
#[derive(Clone, Copy, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ReleaseParameters {
    /// Beginning, in s after the controller's start.
    pub at_s: NonNegative,
    /// End, in s after the controller's start; never if absent.
    pub until_s: Option<Positive>,
}

/// Reads an optional point.
fn point<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<[f64; 3]>, D::Error> {
    exactly(deserializer).map(Some)
}

const fn everywhere() -> [NonNegative; 3] {
    [NonNegative::literal(1.0); 3]
}

fn all_axes() -> Vec<WorldAxis> {
    vec![WorldAxis::X, WorldAxis::Y, WorldAxis::Z]
}

/// Axis of the world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum WorldAxis {
    /// Forward.
    X,
    /// Left.
    Y,
    /// Up.
    Z,
}

/// Motion of an operator.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
#[non_exhaustive]
pub enum OperatorMotion {
    /// No motion.
    Still {},
    /// Band-limited random motion: 24 sines per axis, of random frequency, phase and amplitude.
    Random(RandomMotion),
    /// Reaches at given times, tremor, and a probe.
    Scripted(ScriptedMotion),
}

/// Reaches at given times, with tremor and a probe.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ScriptedMotion {
    /// Minimum-jerk motions, which add up; the operator stays where they end.
    #[serde(default)]
    pub reach: Vec<ReachParameters>,
    /// Random motion in addition; none if absent.
    pub tremor: Option<RandomMotion>,
    /// Motion at given frequencies in addition; none if absent.
    pub probe: Option<ProbeMotion>,
}

/// Minimum-jerk motion from rest to rest.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ReachParameters {
    /// Beginning, in s after the controller's start.
    pub at_s: NonNegative,
    /// Duration, s.
    pub duration_s: Positive,
    /// Displacement in world axes, m.
    #[serde(deserialize_with = "exactly")]
    pub by_m: [f64; 3],
}

/// Band-limited random motion.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct RandomMotion {
    /// Rms amplitude of the motion along each axis, m.
    pub rms_m: NonNegative,
    /// Lowest frequency, Hz.
    pub from_hz: Positive,
    /// Highest frequency, Hz.
    pub to_hz: Positive,
    /// Time over which the motion ramps up, s.
    #[serde(default = "one_second")]
    pub ramp_s: Positive,
}

/// Sum of sines of given frequencies and equal amplitudes along a line, for the measurement of an impedance at each of these
/// frequencies. The phases are drawn from the seed: Schroeder's, which make the peak of many adjacent harmonics small, do
/// not do so for a few frequencies far apart.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ProbeMotion {
    /// Rms of the motion along the line, m.
    pub rms_m: NonNegative,
    /// Frequencies, in ascending order: 1 to 24, at most a twentieth of the physics rate, Hz.
    #[cfg_attr(feature = "schema", schemars(extend("minItems" = 1, "maxItems" = SINES)))]
    pub lines_hz: Vec<Positive>,
    /// Direction of the line in world axes; any length.
    #[serde(deserialize_with = "exactly")]
    pub axis: [f64; 3],
    /// Beginning, in s after the controller's start.
    pub from_s: NonNegative,
    /// Time over which the motion ramps up, and down, s.
    #[serde(default = "one_second")]
    pub ramp_s: Positive,
    /// End, in s after the controller's start, by when it has ramped down; never if absent.
    pub until_s: Option<Positive>,
}

const fn one_second() -> Positive {
    Positive::literal(1.0)
}

/// Operator with spring and damper, and the sines of its random motion.
#[derive(Clone, Debug)]
pub struct Spring {
    stiffness: Vector3<f64>,
    damping: Vector3<f64>,
    home: Vector3<f64>,
    ramp_s: f64,
    /// Random motion along each axis, m; no sines for an operator who does not move at random.
    sines: Box<[Sines; 3]>,
    reaches: Vec<ReachParameters>,
    probe: Option<Box<Probe>>,
    released: Vec<ReleaseParameters>,
    /// True if `home` is a given point.
    is_at_point: bool,
    /// True if the operator did not hold the frame in the last step.
    is_released: bool,
}

/// Probing motion, with the sines along its line (m).
#[derive(Clone, Debug)]
struct Probe {
    axis: Vector3<f64>,
    from_s: f64,
    /// Time from the beginning to the end, s; infinite if it does not end.
    duration_s: f64,
    ramp_s: f64,
    sines: Sines,
}

impl SpringParameters {
    pub(super) fn check(&self, physics_hz: f64) -> Result<(), Mistake> {
        let ends_early = |release: &ReleaseParameters| {
            release.until_s.is_some_and(|until| until.get() <= release.at_s.get())
        };
        if self.released.iter().any(ends_early) {
            return Err(Mistake::new("released", "until_s must be after at_s"));
        }
        let OperatorMotion::Scripted(ScriptedMotion { tremor, probe, .. }) = &self.motion else {
            return Ok(());
        };
        if tremor.as_ref().is_some_and(|tremor| tremor.to_hz < tremor.from_hz) {
            return Err(Mistake::new("motion.scripted.tremor", "to_hz is below from_hz"));
        }
        probe.as_ref().map_or(Ok(()), |probe| probe.check(physics_hz))
    }
}

impl ProbeMotion {
    fn check(&self, physics_hz: f64) -> Result<(), Mistake> {
        const LINES: &str = "motion.scripted.probe.lines_hz";
        check_length("motion.scripted.probe.axis", self.axis)?;
        let shortest_s = 2.0 * self.ramp_s.get();
        if self.until_s.is_some_and(|until| until.get() - self.from_s.get() < shortest_s) {
            let message = format!("until_s must be at least {shortest_s} s after from_s, two ramps");
            return Err(Mistake::new("motion.scripted.probe", message));
        }
        if self.lines_hz.is_empty() || self.lines_hz.len() > SINES {
            let found = self.lines_hz.len();
            return Err(Mistake::new(LINES, format!("{found} frequencies; 1 to {SINES} are possible")));
        }
        if let Some(pair) = self.lines_hz.windows(2).find(|pair| pair[0] >= pair[1]) {
            let [before, after] = [pair[0].get(), pair[1].get()];
            return Err(Mistake::new(
                LINES,
                format!(
                    "{after} Hz follows {before} Hz; the frequencies must be in ascending order, each once"
                ),
            ));
        }
        self.lines_hz.iter().try_for_each(|line| check_frequency(LINES, line.get(), physics_hz))
    }

    /// Draws the phases.
    fn draw(&self, random: &mut ChaCha8Rng) -> Probe {
        let amplitude = self.rms_m.get() * (2.0 / self.lines_hz.len() as f64).sqrt();
        let mut sines = [(0.0, 0.0, 0.0); SINES];
        for (sine, line) in sines.iter_mut().zip(&self.lines_hz) {
            *sine = (amplitude, TAU * line.get(), random.random_range(0.0..TAU));
        }
        Probe {
            axis: direction(self.axis),
            from_s: self.from_s.get(),
            duration_s: self.until_s.map_or(f64::INFINITY, |until| until.get() - self.from_s.get()),
            ramp_s: self.ramp_s.get(),
            sines: Sines::new(&sines),
        }
    }
}

impl Probe {
    /// Offset (m) and velocity (m/s) at a time (s) after the beginning.
    fn motion(&mut self, t: f64) -> (Vector3<f64>, Vector3<f64>) {
        let t = t - self.from_s;
        let (up, dup) = minimum_jerk(t, self.ramp_s);
        let (down, ddown) = minimum_jerk(self.duration_s - t, self.ramp_s);
        let (s, ds) = (up * down, dup * down - up * ddown);
        let (p, dp) = self.sines.at(t);
        (self.axis * (s * p), self.axis * (ds * p + s * dp))
    }
}

/// Returns the minimum-jerk ramp s = 10u³ − 15u⁴ + 6u⁵ with u = t/duration, from 0 to 1, and its rate (1/s).
fn minimum_jerk(t: f64, duration: f64) -> (f64, f64) {
    if t <= 0.0 {
        return (0.0, 0.0);
    }
    if t >= duration {
        return (1.0, 0.0);
    }
    let u = t / duration;
    let rate = 30.0 * u * u * (1.0 - u) * (1.0 - u) / duration;
    (u * u * u * (10.0 + u * (-15.0 + 6.0 * u)), rate)
}

impl Spring {
    pub(super) fn new(p: &SpringParameters, home: Vector3<f64>, mut random: ChaCha8Rng) -> Self {
        let gain = Vector3::from(p.gain.map(NonNegative::get));
        let (tremor, reaches, probe) = match &p.motion {
            OperatorMotion::Still {} => (None, Vec::new(), None),
            OperatorMotion::Random(motion) => (Some(motion), Vec::new(), None),
            OperatorMotion::Scripted(motion) => {
                (motion.tremor.as_ref(), motion.reach.clone(), motion.probe.as_ref())
            }
        };
        let (ramp_s, sines) = match tremor {
            None => (1.0, Default::default()),
            Some(motion) => {
                (motion.ramp_s.get(), Box::new(std::array::from_fn(|_| motion.draw(&mut random))))
            }
        };
        Self {
            stiffness: gain * p.stiffness_n_per_m.get(),
            damping: gain * p.damping_ns_per_m.get(),
            home: p.point_m.map_or(home, Vector3::from),
            ramp_s,
            sines,
            reaches,
            // Drawn last: a tremor is the same with and without a probe.
            probe: probe.map(|probe| Box::new(probe.draw(&mut random))),
            released: p.released.clone(),
            is_at_point: p.point_m.is_some(),
            is_released: false,
        }
    }

    pub(super) fn force(&mut self, t: f64, x: &Vector3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
        let (offset, speed) = self.motion(t);
        if self.released.iter().any(|release| release.contains(t)) {
            self.is_released = true;
            return Vector3::zeros();
        }
        if self.is_released && !self.is_at_point {
            self.home = x - offset;
        }
        self.is_released = false;
        self.stiffness.component_mul(&(self.home + offset - x)) + self.damping.component_mul(&(speed - v))
    }

    /// Offset from home and velocity of the operator (m, m/s), along the axes on which it acts.
    fn motion(&mut self, t: f64) -> (Vector3<f64>, Vector3<f64>) {
        let (s, ds) = minimum_jerk(t, self.ramp_s);
        let mut offset = Vector3::zeros();
        let mut speed = Vector3::zeros();
        for (axis, sines) in self.sines.iter_mut().enumerate() {
            if self.stiffness[axis] != 0.0 || self.damping[axis] != 0.0 {
                let (p, dp) = sines.at(t);
                offset[axis] = s * p;
                speed[axis] = ds * p + s * dp;
            }
        }
        for reach in &self.reaches {
            let (s, ds) = minimum_jerk(t - reach.at_s.get(), reach.duration_s.get());
            let by = Vector3::from(reach.by_m);
            offset += by * s;
            speed += by * ds;
        }
        if let Some(probe) = &mut self.probe
            && t > probe.from_s
        {
            let (p, dp) = probe.motion(t);
            offset += p;
            speed += dp;
        }
        (offset, speed)
    }
}

impl ReleaseParameters {
    fn contains(&self, t: f64) -> bool {
        t >= self.at_s.get() && self.until_s.is_none_or(|until| t < until.get())
    }
}

impl RandomMotion {
    /// Returns the sines of one axis; the rms of their sum is `rms_m`.
    fn draw(&self, random: &mut ChaCha8Rng) -> Sines {
        let (from, to) = (self.from_hz.get(), self.to_hz.get());
        let mut drawn: [(f64, f64, f64); SINES] = std::array::from_fn(|_| {
            let frequency = from + (to - from) * random.random_range(0.0..1.0);
            let phase = random.random_range(0.0..TAU);
            (random.random_range(0.3..=1.0), TAU * frequency, phase)
        });
        let rms = (drawn.iter().map(|s| s.0 * s.0 / 2.0).sum::<f64>()).sqrt();
        drawn.iter_mut().for_each(|s| s.0 *= self.rms_m.get() / rms);
        Sines::new(&drawn)
    }
}

//! Objects of the environment that exert forces on the robot: an operator with a spring, pushes, a wall.
//! `[environment.NAME.KIND]` in a task file.

use crate::sines::{SINES, Sines};
use nalgebra::Vector3;
use opspace_backend::quantity::{NonNegative, Positive, exactly};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::f64::consts::TAU;

/// Object that exerts a force on one frame of the robot.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
#[non_exhaustive]
pub enum EnvironmentObjectParameters {
    /// Operator who holds the frame by a spring and a damper.
    Spring(SpringParameters),
    /// Pushes at given times.
    Pushes(PushesParameters),
    /// Stiff plane.
    Wall(WallParameters),
}

impl EnvironmentObjectParameters {
    /// Name of its kind in a task file.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Spring(_) => "spring",
            Self::Pushes(_) => "pushes",
            Self::Wall(_) => "wall",
        }
    }

    /// Name of the frame on which it acts.
    #[must_use]
    pub fn frame(&self) -> &str {
        match self {
            Self::Spring(p) => &p.frame,
            Self::Pushes(p) => &p.frame,
            Self::Wall(p) => &p.frame,
        }
    }
}

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
    pub report: Vec<WorldAxis>,
    /// Motion of the operator.
    pub motion: OperatorMotion,
}

const fn everywhere() -> [NonNegative; 3] {
    [NonNegative::literal(1.0); 3]
}

fn all_axes() -> Vec<WorldAxis> {
    vec![WorldAxis::X, WorldAxis::Y, WorldAxis::Z]
}

/// Axis of the world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
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

const fn one_second() -> Positive {
    Positive::literal(1.0)
}

/// Pushes, each a half sine in time.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PushesParameters {
    /// Name of the frame that is pushed.
    pub frame: String,
    /// List of pushes.
    pub push: Vec<PushParameters>,
}

/// Single push, a half sine in time.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PushParameters {
    /// Beginning, in s after the controller's start.
    pub at_s: NonNegative,
    /// Duration, s.
    pub duration_s: Positive,
    /// Peak force in world axes, N.
    #[serde(deserialize_with = "exactly")]
    pub force_n: [f64; 3],
}

/// Elastic plane: `F = normal (K depth + B ḋepth)` while the frame is behind it; the force never pulls.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct WallParameters {
    /// Name of the frame that touches it.
    pub frame: String,
    /// Point of the plane in world coordinates, m.
    #[serde(deserialize_with = "exactly")]
    pub point_m: [f64; 3],
    /// Outward normal of the wall in world axes; any length.
    #[serde(deserialize_with = "exactly")]
    pub normal: [f64; 3],
    /// Stiffness K, N/m.
    pub stiffness_n_per_m: Positive,
    /// Damping B, Ns/m.
    pub damping_ns_per_m: NonNegative,
}

/// Environment object in a simulation.
#[derive(Clone, Debug)]
pub enum EnvironmentObject {
    /// See [`SpringParameters`].
    Spring(Spring),
    /// See [`PushesParameters`].
    Pushes(Vec<PushParameters>),
    /// See [`WallParameters`].
    Wall(Wall),
}

/// Operator with spring and damper, and the sines of its random motion.
#[derive(Clone, Debug)]
pub struct Spring {
    stiffness: Vector3<f64>,
    damping: Vector3<f64>,
    home: Vector3<f64>,
    ramp_s: f64,
    /// Random motion along each axis, m; no sines for an operator who does not move.
    sines: Box<[Sines; 3]>,
}

/// Elastic plane.
#[derive(Clone, Debug)]
pub struct Wall {
    point: Vector3<f64>,
    normal: Vector3<f64>,
    stiffness: f64,
    damping: f64,
}

impl EnvironmentObject {
    /// Returns an object at a frame that starts at `home` (world axes, m).
    #[must_use]
    pub fn new(parameters: &EnvironmentObjectParameters, home: Vector3<f64>, random: ChaCha8Rng) -> Self {
        match parameters {
            EnvironmentObjectParameters::Spring(p) => Self::Spring(Spring::new(p, home, random)),
            EnvironmentObjectParameters::Pushes(p) => Self::Pushes(p.push.clone()),
            EnvironmentObjectParameters::Wall(p) => Self::Wall(Wall {
                point: Vector3::from(p.point_m),
                normal: direction(p.normal),
                stiffness: p.stiffness_n_per_m.get(),
                damping: p.damping_ns_per_m.get(),
            }),
        }
    }

    /// Returns the force (world axes, N) on the frame at position `x` (m) with velocity `v` (m/s), at `t` seconds after
    /// the controller's start.
    #[must_use]
    pub fn force(&mut self, t: f64, x: &Vector3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
        match self {
            Self::Spring(spring) => spring.force(t, x, v),
            Self::Pushes(pushes) => pushes.iter().map(|push| push.force(t)).sum(),
            Self::Wall(wall) => wall.force(x, v),
        }
    }
}

/// Returns the unit vector of a vector of any length.
fn direction(vector: [f64; 3]) -> Vector3<f64> {
    let vector = Vector3::from(vector);
    (vector / vector.amax()).normalize()
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
    fn new(p: &SpringParameters, home: Vector3<f64>, mut random: ChaCha8Rng) -> Self {
        let gain = Vector3::from(p.gain.map(NonNegative::get));
        let (ramp_s, sines) = match &p.motion {
            OperatorMotion::Still {} => (1.0, Default::default()),
            OperatorMotion::Random(motion) => {
                (motion.ramp_s.get(), Box::new(std::array::from_fn(|_| motion.draw(&mut random))))
            }
        };
        Self {
            stiffness: gain * p.stiffness_n_per_m.get(),
            damping: gain * p.damping_ns_per_m.get(),
            home,
            ramp_s,
            sines,
        }
    }

    fn force(&mut self, t: f64, x: &Vector3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
        let (offset, speed) = self.motion(t);
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
        (offset, speed)
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

impl PushParameters {
    fn force(&self, t: f64) -> Vector3<f64> {
        let u = (t - self.at_s.get()) / self.duration_s.get();
        let share = if (0.0..=1.0).contains(&u) { (TAU / 2.0 * u).sin() } else { 0.0 };
        Vector3::from(self.force_n) * share
    }
}

impl Wall {
    fn force(&self, x: &Vector3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
        let depth = self.normal.dot(&(self.point - x));
        if depth <= 0.0 {
            return Vector3::zeros();
        }
        let push = self.stiffness * depth - self.damping * self.normal.dot(v);
        self.normal * push.max(0.0)
    }
}

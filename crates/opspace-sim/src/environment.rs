//! Objects of the environment that exert forces on the robot: an operator with a spring, pushes, a wall.
//! `[environment.NAME.KIND]` in a task file.
//!
//! An object that is in contact with the robot, or has a mass, has a state of its own. It advances with the steps of
//! the plant, whichever engine computes the robot.

mod contact;
mod mistake;
mod operator;
mod pushes;
mod wall;

pub use contact::SurfaceFrictionParameters;
pub use mistake::Mistake;
pub use operator::{OperatorMotion, RandomMotion, Spring, SpringParameters, WorldAxis};
pub use pushes::{PushParameters, PushesParameters};
pub use wall::{Wall, WallEdgeParameters, WallParameters};

use nalgebra::Vector3;
use opspace_backend::SignalRecorder;
use rand_chacha::ChaCha8Rng;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

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

    /// Checks parameters that depend on each other.
    pub(crate) fn check(&self) -> Result<(), Mistake> {
        match self {
            Self::Spring(_) | Self::Pushes(_) => Ok(()),
            Self::Wall(p) => p.check(),
        }
    }
}

/// Environment object in a simulation.
#[derive(Clone, Debug)]
pub enum EnvironmentObject {
    /// See [`SpringParameters`].
    Spring(Spring),
    /// See [`PushesParameters`].
    Pushes(Vec<PushParameters>),
    /// See [`WallParameters`].
    Wall(Box<Wall>),
}

impl EnvironmentObject {
    /// Returns an object at a frame that starts at `home` (world axes, m).
    #[must_use]
    pub fn new(parameters: &EnvironmentObjectParameters, home: Vector3<f64>, random: ChaCha8Rng) -> Self {
        match parameters {
            EnvironmentObjectParameters::Spring(p) => Self::Spring(Spring::new(p, home, random)),
            EnvironmentObjectParameters::Pushes(p) => Self::Pushes(p.push.clone()),
            EnvironmentObjectParameters::Wall(p) => Self::Wall(Box::new(Wall::new(p))),
        }
    }

    /// Advances by a step of `dt` (s, above zero) to `t` seconds after the controller's start, and returns the force
    /// (world axes, N) on the frame, then at position `x` (m) with velocity `v` (m/s).
    #[must_use]
    pub fn force(&mut self, t: f64, dt: f64, x: &Vector3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
        match self {
            Self::Spring(spring) => spring.force(t, x, v),
            Self::Pushes(pushes) => pushes.iter().map(|push| push.force(t)).sum(),
            Self::Wall(wall) => wall.force(dt, x, v),
        }
    }

    /// Records the state of the object in the last step, besides its force, in signals that begin with `name`.
    pub fn record(&self, name: &str, out: &mut SignalRecorder<'_>) {
        match self {
            Self::Spring(_) | Self::Pushes(_) => {}
            Self::Wall(wall) => wall.record(name, out),
        }
    }
}

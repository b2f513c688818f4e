//! Objects of the environment that exert forces on the robot: an operator with a spring, pushes, a wall,
//! a cylinder, a hole, a mass, a drawer.
//! `[environment.NAME.KIND]` in a task file.
//!
//! An object that is in contact with the robot, or has a mass, has a state of its own. It advances with the steps of
//! the plant, whichever engine computes the robot.

pub(crate) mod body;
mod contact;
mod cylinder;
mod drawer;
mod hole;
mod mass;
pub(crate) mod mistake;
mod operator;
mod pushes;
mod wall;

pub use contact::SurfaceFrictionParameters;
pub use cylinder::{Cylinder, CylinderParameters};
pub use drawer::{Drawer, DrawerParameters};
pub use hole::{Hole, HoleParameters};
pub use mass::{Mass, MassParameters};
pub use mistake::Mistake;
pub use operator::{
    OperatorMotion, ProbeMotion, RandomMotion, ReachParameters, ReleaseParameters, ScriptedMotion, Spring,
    SpringParameters, WorldAxis,
};
pub use pushes::{PushParameters, PushShape, PushesParameters, Staircase};
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
    /// Stiff cylinder, touched from outside.
    Cylinder(CylinderParameters),
    /// Hole in a stiff plane, for a peg.
    Hole(HoleParameters),
    /// Point mass that hangs at the frame.
    Mass(MassParameters),
    /// Drawer whose handle the frame holds.
    Drawer(DrawerParameters),
}

impl EnvironmentObjectParameters {
    /// Name of its kind in a task file.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Spring(_) => "spring",
            Self::Pushes(_) => "pushes",
            Self::Wall(_) => "wall",
            Self::Cylinder(_) => "cylinder",
            Self::Hole(_) => "hole",
            Self::Mass(_) => "mass",
            Self::Drawer(_) => "drawer",
        }
    }

    /// Name of the frame on which it acts.
    #[must_use]
    pub fn frame(&self) -> &str {
        match self {
            Self::Spring(p) => &p.frame,
            Self::Pushes(p) => &p.frame,
            Self::Wall(p) => &p.frame,
            Self::Cylinder(p) => &p.frame,
            Self::Hole(p) => &p.frame,
            Self::Mass(p) => &p.frame,
            Self::Drawer(p) => &p.frame,
        }
    }

    /// Checks parameters that depend on each other, and on the physics rate (Hz).
    pub(crate) fn check(&self, physics_hz: f64) -> Result<(), Mistake> {
        match self {
            Self::Spring(p) => p.check(physics_hz),
            Self::Pushes(_) => Ok(()),
            Self::Wall(p) => p.check(),
            Self::Cylinder(p) => p.check(),
            Self::Hole(p) => p.check(),
            Self::Mass(p) => p.check(physics_hz),
            Self::Drawer(p) => p.check(physics_hz),
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
    /// See [`CylinderParameters`].
    Cylinder(Box<Cylinder>),
    /// See [`HoleParameters`].
    Hole(Box<Hole>),
    /// See [`MassParameters`].
    Mass(Box<Mass>),
    /// See [`DrawerParameters`].
    Drawer(Box<Drawer>),
}

impl EnvironmentObject {
    /// Returns an object at a frame that starts at `home` (world axes, m), with the gravitational acceleration
    /// `gravity` (world axes, m/s²).
    #[must_use]
    pub fn new(
        parameters: &EnvironmentObjectParameters,
        home: Vector3<f64>,
        gravity: Vector3<f64>,
        random: ChaCha8Rng,
    ) -> Self {
        match parameters {
            EnvironmentObjectParameters::Spring(p) => Self::Spring(Spring::new(p, home, random)),
            EnvironmentObjectParameters::Pushes(p) => Self::Pushes(p.push.clone()),
            EnvironmentObjectParameters::Wall(p) => Self::Wall(Box::new(Wall::new(p))),
            EnvironmentObjectParameters::Cylinder(p) => Self::Cylinder(Box::new(Cylinder::new(p))),
            EnvironmentObjectParameters::Hole(p) => Self::Hole(Box::new(Hole::new(p))),
            EnvironmentObjectParameters::Mass(p) => Self::Mass(Box::new(Mass::new(p, gravity))),
            EnvironmentObjectParameters::Drawer(p) => Self::Drawer(Box::new(Drawer::new(p, home, gravity))),
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
            Self::Cylinder(cylinder) => cylinder.force(dt, x, v),
            Self::Hole(hole) => hole.force(dt, x, v),
            Self::Mass(mass) => mass.force(t, dt, x, v),
            Self::Drawer(drawer) => drawer.force(dt, x, v),
        }
    }

    /// Records the state of the object in the last step, besides its force, in signals that begin with `name`.
    pub fn record(&self, name: &str, out: &mut SignalRecorder<'_>) {
        match self {
            Self::Spring(_) | Self::Pushes(_) => {}
            Self::Wall(wall) => wall.record(name, out),
            Self::Cylinder(cylinder) => cylinder.record(name, out),
            Self::Hole(hole) => hole.record(name, out),
            Self::Mass(mass) => mass.record(name, out),
            Self::Drawer(drawer) => drawer.record(name, out),
        }
    }
}

//! Drawer that the robot holds by its handle: `[environment.NAME.drawer]`.
//!
//! The drawer is a mass on a straight slide, with a closing spring, viscous damping, dry friction and stops at both ends. A
//! stiff spring and a damper connect its handle to the frame in all three directions. It advances by the midpoint steps of
//! the plant.

use crate::environment::body::Body;
use crate::environment::contact::{Bristle, direction};
use crate::environment::mistake::{Mistake, check_length, highest_frequency};
use nalgebra::{Vector1, Vector3};
use opspace_backend::SignalRecorder;
use opspace_backend::quantity::{NonNegative, Positive, exactly};
use opspace_backend::signal_names::OPENING;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::f64::consts::TAU;

/// Stiffness of the stops, N/m.
const STOP_STIFFNESS: f64 = 2e4;
/// Stiffness of the bristle that holds a drawer that sticks, N/m.
const BRISTLE_STIFFNESS: f64 = 2e4;
/// Damping ratio of the drawer on its stops, and on its bristle.
const DAMPING_RATIO: f64 = 0.5;

/// Drawer on a straight slide, whose handle the frame holds from the start.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct DrawerParameters {
    /// Name of the frame that holds the handle, which is at its origin at the start.
    pub frame: String,
    /// Direction in which it opens, in world axes; any length.
    #[serde(deserialize_with = "exactly")]
    pub direction: [f64; 3],
    /// Mass, kg.
    pub mass_kg: Positive,
    /// Travel from closed to open, m.
    pub travel_m: Positive,
    /// Opening at the start, m; at most `travel_m`.
    #[serde(default)]
    pub opening_m: NonNegative,
    /// Dry friction of the slide, N.
    #[serde(default)]
    pub friction_n: NonNegative,
    /// Viscous damping of the slide, Ns/m.
    #[serde(default)]
    pub damping_ns_per_m: NonNegative,
    /// Stiffness of the closing spring, N/m.
    #[serde(default)]
    pub closing_stiffness_n_per_m: NonNegative,
    /// Force of the closing spring when the drawer is closed, N.
    #[serde(default)]
    pub closing_force_n: NonNegative,
    /// Stiffness of the grip on the handle, N/m.
    #[serde(default = "stiff")]
    pub grip_stiffness_n_per_m: Positive,
    /// Damping of the grip on the handle, Ns/m.
    #[serde(default = "damped")]
    pub grip_damping_ns_per_m: NonNegative,
}

const fn stiff() -> Positive {
    Positive::literal(10_000.0)
}

const fn damped() -> NonNegative {
    NonNegative::literal(50.0)
}

/// Drawer on a straight slide.
#[derive(Clone, Debug)]
pub struct Drawer {
    /// Place of the handle of the closed drawer, m.
    closed: Vector3<f64>,
    direction: Vector3<f64>,
    mass: f64,
    travel: f64,
    damping: f64,
    closing: [f64; 2],
    grip: [f64; 2],
    stop_damping: f64,
    friction: f64,
    bristle: Bristle,
    /// Component of gravity along the slide, m/s².
    gravity: f64,
    body: Body<1>,
}

impl DrawerParameters {
    pub(super) fn check(&self, physics_hz: f64) -> Result<(), Mistake> {
        check_length("direction", self.direction)?;
        let travel = self.travel_m.get();
        if self.opening_m.get() > travel {
            return Err(Mistake::new("opening_m", format!("at most the travel, {travel} m, is possible")));
        }
        let stiffness = self.grip_stiffness_n_per_m.get()
            + self.closing_stiffness_n_per_m.get()
            + BRISTLE_STIFFNESS
            + STOP_STIFFNESS;
        let omega = TAU * highest_frequency(physics_hz);
        if stiffness > self.mass_kg.get() * omega * omega {
            return Err(Mistake::new(
                "mass_kg",
                format!(
                    "with this physics rate and these springs the drawer needs at least {:.1e} kg",
                    stiffness / (omega * omega)
                ),
            ));
        }
        Ok(())
    }
}

impl Drawer {
    pub(super) fn new(p: &DrawerParameters, home: Vector3<f64>, gravity: Vector3<f64>) -> Self {
        let (direction, mass, opening) = (direction(p.direction), p.mass_kg.get(), p.opening_m.get());
        let damping = |stiffness: f64| 2.0 * DAMPING_RATIO * (stiffness * mass).sqrt();
        Self {
            closed: home - direction * opening,
            direction,
            mass,
            travel: p.travel_m.get(),
            damping: p.damping_ns_per_m.get(),
            closing: [p.closing_force_n.get(), p.closing_stiffness_n_per_m.get()],
            grip: [p.grip_stiffness_n_per_m.get(), p.grip_damping_ns_per_m.get()],
            stop_damping: damping(STOP_STIFFNESS),
            friction: p.friction_n.get(),
            bristle: Bristle::new(1.0, BRISTLE_STIFFNESS, damping(BRISTLE_STIFFNESS)),
            gravity: direction.dot(&gravity),
            body: Body::passing(Vector1::new(opening), Vector1::zeros(), 0.0),
        }
    }

    pub(super) fn force(&mut self, dt: f64, x: &Vector3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
        let (position, velocity) = self.body.middle(dt);
        let (opening, rate) = (position.x, velocity.x);
        let handle = self.direction * opening;
        let force = (self.closed + handle - x) * self.grip[0] + (self.direction * rate - v) * self.grip[1];
        let along = self.slide(opening, rate) + self.drag(dt, &handle) - self.direction.dot(&force);
        self.body.advance(Vector1::new(self.gravity + along / self.mass), dt);
        force
    }

    /// Force of closing spring, damping and stops along the slide, N.
    fn slide(&self, opening: f64, rate: f64) -> f64 {
        let stop = |depth: f64, into: f64| {
            if depth > 0.0 { (STOP_STIFFNESS * depth + self.stop_damping * into).max(0.0) } else { 0.0 }
        };
        stop(-opening, -rate)
            - stop(opening - self.travel, rate)
            - self.closing[0]
            - self.closing[1] * opening
            - self.damping * rate
    }

    /// Dry friction along the slide, N.
    fn drag(&mut self, dt: f64, handle: &Vector3<f64>) -> f64 {
        // Motion is along the slide alone; the bristle needs a normal across it.
        let across = self.direction.cross(&Vector3::ith(self.direction.iamin(), 1.0)).normalize();
        self.direction.dot(&self.bristle.drag(dt, handle, &across, self.friction))
    }

    /// Records the opening.
    pub(super) fn record(&self, name: &str, out: &mut SignalRecorder<'_>) {
        out.scalar((name, OPENING), "m", self.body.position().x);
    }
}

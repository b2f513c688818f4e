//! Point mass that hangs at a frame for some time: `[environment.NAME.mass]`.
//!
//! The mass has a state of its own, and a stiff spring and a damper connect it to the frame: the force depends on positions
//! and velocities alone, not on the acceleration of the robot. The mass advances by the midpoint steps of the plant, which
//! conserve energy without damping.

use crate::environment::body::Body;
use crate::environment::mistake::{Mistake, check_frequency};
use nalgebra::Vector3;
use opspace_backend::SignalRecorder;
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_backend::signal_names::POSITION;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::f64::consts::TAU;

/// Point mass that hangs at the origin of a frame, with its weight and its inertia.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct MassParameters {
    /// Name of the frame at which it hangs.
    pub frame: String,
    /// Mass, kg.
    pub mass_kg: Positive,
    /// Time at which it is put on, with the velocity of the frame, in s after the controller's start.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "the start of the simulation")))]
    pub put_on_s: Option<NonNegative>,
    /// Time at which it is taken off, in s after the controller's start; never if absent.
    pub taken_off_s: Option<Positive>,
    /// Frequency at which it vibrates on the spring that connects it to the frame, Hz; at most a twentieth of the physics
    /// rate. The weight acts on the robot within about a period.
    #[serde(default = "hundred")]
    pub frequency_hz: Positive,
    /// Damping ratio of this vibration.
    #[serde(default = "damped")]
    pub damping_ratio: NonNegative,
}

const fn hundred() -> Positive {
    Positive::literal(100.0)
}

const fn damped() -> NonNegative {
    NonNegative::literal(0.7)
}

/// Point mass on a spring.
#[derive(Clone, Debug)]
pub struct Mass {
    mass: f64,
    stiffness: f64,
    damping: f64,
    gravity: Vector3<f64>,
    /// Times from which and until which it hangs at the frame, s after the controller's start.
    times: [f64; 2],
    body: Option<Body<3>>,
}

impl MassParameters {
    pub(super) fn check(&self, physics_hz: f64) -> Result<(), Mistake> {
        check_frequency("frequency_hz", self.frequency_hz.get(), physics_hz)?;
        match (self.put_on_s, self.taken_off_s) {
            (Some(on), Some(off)) if off.get() <= on.get() => {
                Err(Mistake::new("taken_off_s", "the mass is taken off before it is put on"))
            }
            _ => Ok(()),
        }
    }
}

impl Mass {
    pub(super) fn new(p: &MassParameters, gravity: Vector3<f64>) -> Self {
        let (mass, omega) = (p.mass_kg.get(), TAU * p.frequency_hz.get());
        Self {
            mass,
            stiffness: mass * omega * omega,
            damping: 2.0 * p.damping_ratio.get() * mass * omega,
            gravity,
            times: [
                p.put_on_s.map_or(f64::NEG_INFINITY, NonNegative::get),
                p.taken_off_s.map_or(f64::INFINITY, Positive::get),
            ],
            body: None,
        }
    }

    pub(super) fn force(&mut self, t: f64, dt: f64, x: &Vector3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
        let [on, off] = self.times;
        if t < on || t >= off {
            self.body = None;
            return Vector3::zeros();
        }
        let body = self.body.get_or_insert_with(|| Body::passing(*x, *v, dt));
        let (position, velocity) = body.middle(dt);
        let force = (position - x) * self.stiffness + (velocity - v) * self.damping;
        body.advance(self.gravity - force / self.mass, dt);
        force
    }

    /// Records the position of the mass, which is not a number while it does not hang at the frame.
    pub(super) fn record(&self, name: &str, out: &mut SignalRecorder<'_>) {
        let position = self.body.as_ref().map_or(Vector3::repeat(f64::NAN), Body::position);
        out.signal((name, POSITION), "m", &["x", "y", "z"], position.as_slice());
    }
}

//! Contact of a point with a stiff surface: elastic normal force, and friction.
//!
//! Friction is that of a bristle: a spring and a damper in parallel, from the point to an anchor on the surface. The
//! anchor stays where it is while the bristle's force is within the cone of friction, and slides otherwise:
//!
//! ```text
//! s* = s₋ + Δx      f* = k s* + b Δx/h      f = f* min(1, μ N/|f*|)      s = (f + b s₋/h)/(k + b/h)
//! ```
//!
//! s is the deflection of the bristle, s₋ that of the step before, Δx the motion along the surface in a step of duration
//! h, and −f the force on the point. The step is implicit: whatever the path and the step, a contact returns at most the
//! energy ½ k s² that the bristle has stored.

use nalgebra::Vector3;
use opspace_backend::SignalRecorder;
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_backend::signal_names::{FRICTION_FORCE, NORMAL_FORCE};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Dry friction of a surface, with a bristle that holds the frame where it sticks.
#[derive(Clone, Copy, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct SurfaceFrictionParameters {
    /// Largest friction force relative to the normal force.
    pub coefficient: NonNegative,
    /// Stiffness of the bristle along the surface, N/m.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the surface")))]
    pub stiffness_n_per_m: Option<Positive>,
    /// Damping of the bristle along the surface, Ns/m.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the surface")))]
    pub damping_ns_per_m: Option<NonNegative>,
}

/// Returns the unit vector of a vector of any length except 0.
pub(super) fn direction(vector: [f64; 3]) -> Vector3<f64> {
    let vector = Vector3::from(vector);
    (vector / vector.amax()).normalize()
}

/// Contact of a point with one surface.
#[derive(Clone, Debug)]
pub(super) struct SurfaceContact {
    stiffness: f64,
    damping: f64,
    bristle: Option<Bristle>,
    /// Normal force of the last step, N.
    normal_force: f64,
}

/// Bristle between a point and its anchor on a surface.
#[derive(Clone, Debug)]
pub(super) struct Bristle {
    coefficient: f64,
    stiffness: f64,
    damping: f64,
    /// Deflection, and position of the point, in the last step (m); `None` without contact.
    last: Option<[Vector3<f64>; 2]>,
    /// Force on the point in the last step, N.
    force: Vector3<f64>,
}

impl SurfaceContact {
    pub fn new(
        stiffness: Positive,
        damping: NonNegative,
        friction: Option<&SurfaceFrictionParameters>,
    ) -> Self {
        Self {
            stiffness: stiffness.get(),
            damping: damping.get(),
            bristle: friction.map(|friction| {
                Bristle::new(
                    friction.coefficient.get(),
                    friction.stiffness_n_per_m.unwrap_or(stiffness).get(),
                    friction.damping_ns_per_m.unwrap_or(damping).get(),
                )
            }),
            normal_force: 0.0,
        }
    }

    /// Advances by a step of `dt` (s), and returns the force (N) on the point at `x` (m) with velocity `v` (m/s), which
    /// is `depth` (m) below the surface with the outward normal `normal`.
    pub fn force(
        &mut self,
        dt: f64,
        x: &Vector3<f64>,
        v: &Vector3<f64>,
        normal: &Vector3<f64>,
        depth: f64,
    ) -> Vector3<f64> {
        if depth <= 0.0 {
            return self.leave();
        }
        let push = (self.stiffness * depth - self.damping * normal.dot(v)).max(0.0);
        self.normal_force = push;
        match &mut self.bristle {
            Some(bristle) => normal * push + bristle.drag(dt, x, normal, push),
            None => normal * push,
        }
    }

    /// Ends the contact, and returns the force, which is zero.
    pub fn leave(&mut self) -> Vector3<f64> {
        self.normal_force = 0.0;
        if let Some(bristle) = &mut self.bristle {
            (bristle.last, bristle.force) = (None, Vector3::zeros());
        }
        Vector3::zeros()
    }

    /// True if the surface has friction.
    pub fn has_friction(&self) -> bool {
        self.bristle.is_some()
    }

    /// Normal force (N), and friction (world axes, N), of the last step.
    pub fn forces(&self) -> (f64, Vector3<f64>) {
        (self.normal_force, self.bristle.as_ref().map_or_else(Vector3::zeros, |bristle| bristle.force))
    }
}

impl Bristle {
    /// Returns the bristle of a point without contact: coefficient of friction, stiffness (N/m, above zero) and damping
    /// (Ns/m).
    pub fn new(coefficient: f64, stiffness: f64, damping: f64) -> Self {
        Self { coefficient, stiffness, damping, last: None, force: Vector3::zeros() }
    }

    /// Advances by a step of `dt` (s), and returns the friction on the point under the normal force `push` (N).
    pub fn drag(&mut self, dt: f64, x: &Vector3<f64>, normal: &Vector3<f64>, push: f64) -> Vector3<f64> {
        let along = |vector: Vector3<f64>| vector - normal * normal.dot(&vector);
        let [before, motion] = match self.last {
            Some([deflection, position]) => [along(deflection), along(x - position)],
            None => [Vector3::zeros(); 2],
        };
        let (stiffness, resistance) = (self.stiffness, self.damping / dt);
        let mut deflection = before + motion;
        let mut force = deflection * stiffness + motion * resistance;
        let (most, size) = (self.coefficient * push, force.norm());
        if size > most {
            force *= most / size;
            deflection = (force + before * resistance) / (stiffness + resistance);
        }
        self.last = Some([deflection, *x]);
        self.force = -force;
        self.force
    }
}

/// Records the sum of the normal forces and that of the friction of contacts.
pub(super) fn record<'a>(
    name: &str,
    contacts: impl Iterator<Item = &'a SurfaceContact>,
    out: &mut SignalRecorder<'_>,
) {
    let sum = |(n, t): (f64, Vector3<f64>), contact: &SurfaceContact| {
        let (normal, friction) = contact.forces();
        (n + normal, t + friction)
    };
    let (normal, friction) = contacts.fold((0.0, Vector3::zeros()), sum);
    out.scalar((name, NORMAL_FORCE), "N", normal);
    out.signal((name, FRICTION_FORCE), "N", &["x", "y", "z"], friction.as_slice());
}

//! Stiff cylinder, touched from outside: `[environment.NAME.cylinder]`.

use crate::environment::contact::{self, SurfaceContact, SurfaceFrictionParameters, direction};
use crate::environment::mistake::{Mistake, check_length};
use nalgebra::Vector3;
use opspace_backend::SignalRecorder;
use opspace_backend::quantity::{NonNegative, Positive, exactly};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Elastic cylinder without ends: `F = normal (K depth + B ḋepth)` while the frame is inside; the force never pulls.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct CylinderParameters {
    /// Name of the frame that touches it.
    pub frame: String,
    /// Point of the axis in world coordinates, m.
    #[serde(deserialize_with = "exactly")]
    pub point_m: [f64; 3],
    /// Direction of the axis in world axes; any length.
    #[serde(deserialize_with = "exactly")]
    pub axis: [f64; 3],
    /// Radius, m.
    pub radius_m: Positive,
    /// Stiffness K, N/m.
    pub stiffness_n_per_m: Positive,
    /// Damping B, Ns/m.
    pub damping_ns_per_m: NonNegative,
    /// Friction; none if absent.
    pub friction: Option<SurfaceFrictionParameters>,
}

/// Elastic cylinder.
#[derive(Clone, Debug)]
pub struct Cylinder {
    point: Vector3<f64>,
    axis: Vector3<f64>,
    radius: f64,
    surface: SurfaceContact,
}

impl CylinderParameters {
    pub(super) fn check(&self) -> Result<(), Mistake> {
        check_length("axis", self.axis)
    }
}

impl Cylinder {
    pub(super) fn new(p: &CylinderParameters) -> Self {
        Self {
            point: Vector3::from(p.point_m),
            axis: direction(p.axis),
            radius: p.radius_m.get(),
            surface: SurfaceContact::new(p.stiffness_n_per_m, p.damping_ns_per_m, p.friction.as_ref()),
        }
    }

    pub(super) fn force(&mut self, dt: f64, x: &Vector3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
        let from_axis = radial(&(x - self.point), &self.axis);
        // The axis itself has no outward direction, and is as deep as no contact is.
        match from_axis.try_normalize(0.0) {
            Some(normal) => self.surface.force(dt, x, v, &normal, self.radius - from_axis.norm()),
            None => self.surface.leave(),
        }
    }

    pub(super) fn record(&self, name: &str, out: &mut SignalRecorder<'_>) {
        contact::record(name, std::iter::once(&self.surface), out);
    }
}

/// Part of a vector across an axis of unit length.
pub(super) fn radial(vector: &Vector3<f64>, axis: &Vector3<f64>) -> Vector3<f64> {
    vector - axis * axis.dot(vector)
}

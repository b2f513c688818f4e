//! Stiff plane, which may end at an edge: `[environment.NAME.wall]`.

use crate::environment::contact::{self, SurfaceContact, SurfaceFrictionParameters, direction};
use crate::environment::mistake::{Mistake, check_length};
use nalgebra::Vector3;
use opspace_backend::SignalRecorder;
use opspace_backend::quantity::{NonNegative, Positive, exactly};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Smallest sine of the angle between a wall's normal and the direction to its edge.
const LEAST_SINE: f64 = 1e-3;

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
    /// Friction; none if absent.
    pub friction: Option<SurfaceFrictionParameters>,
    /// Edge at which the wall ends; it has none if absent.
    pub edge: Option<WallEdgeParameters>,
}

/// Straight edge at which a wall ends. Beyond it there is no wall; a frame that comes back below the surface touches the
/// side below the edge.
#[derive(Clone, Copy, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct WallEdgeParameters {
    /// Direction from the wall to the edge in world axes, not along the normal; any length.
    #[serde(deserialize_with = "exactly")]
    pub toward: [f64; 3],
    /// World coordinate of the edge along `toward`, m.
    pub at_m: f64,
}

/// Elastic plane, which may end at an edge.
#[derive(Clone, Debug)]
pub struct Wall {
    point: Vector3<f64>,
    normal: Vector3<f64>,
    surface: SurfaceContact,
    edge: Option<Edge>,
}

/// Edge of a wall, and the side below it.
#[derive(Clone, Debug)]
struct Edge {
    toward: Vector3<f64>,
    at: f64,
    side: SurfaceContact,
    /// True if the frame came below the surface from beyond the edge.
    is_below: bool,
}

impl WallParameters {
    pub(super) fn check(&self) -> Result<(), Mistake> {
        let Some(edge) = &self.edge else { return Ok(()) };
        check_length("edge.toward", edge.toward)?;
        if direction(edge.toward).cross(&direction(self.normal)).norm() < LEAST_SINE {
            return Err(Mistake::new(
                "edge.toward",
                "the edge cannot lie in the direction of the normal: give a direction along the wall",
            ));
        }
        Ok(())
    }
}

impl Wall {
    pub(super) fn new(p: &WallParameters) -> Self {
        let surface = SurfaceContact::new(p.stiffness_n_per_m, p.damping_ns_per_m, p.friction.as_ref());
        let edge = p.edge.map(|edge| Edge {
            toward: direction(edge.toward),
            at: edge.at_m,
            side: surface.clone(),
            is_below: false,
        });
        Self { point: Vector3::from(p.point_m), normal: direction(p.normal), surface, edge }
    }

    pub(super) fn force(&mut self, dt: f64, x: &Vector3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
        let depth = self.normal.dot(&(self.point - x));
        let Some(edge) = &mut self.edge else {
            return self.surface.force(dt, x, v, &self.normal, depth);
        };
        let behind_edge = edge.at - edge.toward.dot(x);
        // The face by which the frame entered pushes it out, so that no face appears with energy stored in it.
        if depth <= 0.0 {
            edge.is_below = false;
        } else if behind_edge <= 0.0 {
            edge.is_below = true;
        }
        if edge.is_below {
            self.surface.leave();
            edge.side.force(dt, x, v, &edge.toward, behind_edge)
        } else {
            edge.side.leave();
            self.surface.force(dt, x, v, &self.normal, depth)
        }
    }

    /// Records normal force and friction of a wall with friction.
    pub(super) fn record(&self, name: &str, out: &mut SignalRecorder<'_>) {
        if self.surface.has_friction() {
            let side = self.edge.iter().map(|edge| &edge.side);
            contact::record(name, std::iter::once(&self.surface).chain(side), out);
        }
    }
}

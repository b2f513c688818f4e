//! Hole in a stiff plane, for a peg whose tip is the frame: `[environment.NAME.hole]`.
//!
//! The peg is parallel to the hole: only the position of its tip counts, and a tilted peg does not jam. Relative to the
//! centre of the tip, the hole has the radius c of the clearance, so that the contact is that of a point. With e the
//! distance of the tip from the axis of the hole, d its depth below the plane and w the width of the chamfer:
//!
//! ```text
//! mouth    d, and with a chamfer at most (d + e − c − w)/√2
//! wall     e − c
//! bottom   d − depth
//! ```
//!
//! are the depths of the tip below the three surfaces. The mouth is touched from outside, wall and bottom from inside.
//! The tip is inside after it was below the chamfer within the clearance, and until it comes above it. Therefore the peg
//! rests on the plane until its axis is within the clearance, whatever its force, and no surface appears with energy
//! stored in it.

use crate::environment::contact::{self, SurfaceContact, SurfaceFrictionParameters, direction};
use crate::environment::cylinder::radial;
use crate::environment::mistake::{Mistake, check_length};
use nalgebra::Vector3;
use opspace_backend::SignalRecorder;
use opspace_backend::quantity::{NonNegative, Positive, exactly};
use opspace_backend::signal_names::DEPTH;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::f64::consts::FRAC_1_SQRT_2;

/// Elastic plane with a round hole. The frame is the tip of a peg that stays parallel to the axis of the hole: tilt is not
/// simulated.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct HoleParameters {
    /// Name of the frame in the centre of the peg's tip.
    pub frame: String,
    /// Centre of the hole in the plane, in world coordinates, m.
    #[serde(deserialize_with = "exactly")]
    pub point_m: [f64; 3],
    /// Outward normal of the plane in world axes, the axis of the hole; any length.
    #[serde(deserialize_with = "exactly")]
    pub normal: [f64; 3],
    /// Radius of the hole, m.
    pub radius_m: Positive,
    /// Radius of the hole minus that of the peg, m; below `radius_m`.
    pub clearance_m: Positive,
    /// Depth of the hole, m.
    pub depth_m: Positive,
    /// Width and depth of a chamfer of 45°, m; below `depth_m`.
    #[serde(default)]
    pub chamfer_m: NonNegative,
    /// Stiffness of plane, wall and bottom, N/m.
    pub stiffness_n_per_m: Positive,
    /// Damping of plane, wall and bottom, Ns/m.
    pub damping_ns_per_m: NonNegative,
    /// Friction of plane, wall and bottom; none if absent.
    pub friction: Option<SurfaceFrictionParameters>,
}

/// Elastic plane with a round hole.
#[derive(Clone, Debug)]
pub struct Hole {
    point: Vector3<f64>,
    normal: Vector3<f64>,
    clearance: f64,
    depth: f64,
    chamfer: f64,
    mouth: SurfaceContact,
    wall: SurfaceContact,
    bottom: SurfaceContact,
    /// Depth of the tip in the hole, m; `None` outside.
    inside: Option<f64>,
}

impl HoleParameters {
    pub(super) fn check(&self) -> Result<(), Mistake> {
        check_length("normal", self.normal)?;
        if self.clearance_m >= self.radius_m {
            let radius = self.radius_m.get();
            return Err(Mistake::new(
                "clearance_m",
                format!(
                    "the clearance must be below the radius of the hole, {radius} m, so that the peg has one"
                ),
            ));
        }
        if self.chamfer_m.get() >= self.depth_m.get() {
            let depth = self.depth_m.get();
            return Err(Mistake::new(
                "chamfer_m",
                format!("the chamfer must be below the depth of the hole, {depth} m"),
            ));
        }
        Ok(())
    }
}

impl Hole {
    pub(super) fn new(p: &HoleParameters) -> Self {
        let surface = SurfaceContact::new(p.stiffness_n_per_m, p.damping_ns_per_m, p.friction.as_ref());
        Self {
            point: Vector3::from(p.point_m),
            normal: direction(p.normal),
            clearance: p.clearance_m.get(),
            depth: p.depth_m.get(),
            chamfer: p.chamfer_m.get(),
            mouth: surface.clone(),
            wall: surface.clone(),
            bottom: surface,
            inside: None,
        }
    }

    pub(super) fn force(&mut self, dt: f64, x: &Vector3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
        let depth = self.normal.dot(&(self.point - x));
        let from_axis = radial(&(x - self.point), &self.normal);
        let offset = from_axis.norm();
        let is_below_chamfer = depth > self.chamfer;
        let is_inside = is_below_chamfer && (self.inside.is_some() || offset <= self.clearance);
        self.inside = is_inside.then_some(depth);
        let inward = from_axis.try_normalize(0.0).map_or_else(Vector3::zeros, |outward| -outward);
        if is_inside {
            self.mouth.leave();
            let wall = self.wall.force(dt, x, v, &inward, offset - self.clearance);
            return wall + self.bottom.force(dt, x, v, &self.normal, depth - self.depth);
        }
        self.wall.leave();
        self.bottom.leave();
        let below_chamfer = (depth + offset - self.clearance - self.chamfer) * FRAC_1_SQRT_2;
        if self.chamfer > 0.0 && below_chamfer < depth {
            let normal = (self.normal + inward) * FRAC_1_SQRT_2;
            return self.mouth.force(dt, x, v, &normal, below_chamfer);
        }
        self.mouth.force(dt, x, v, &self.normal, depth)
    }

    /// Records both parts of the force, and the depth of the tip in the hole.
    pub(super) fn record(&self, name: &str, out: &mut SignalRecorder<'_>) {
        contact::record(name, [&self.mouth, &self.wall, &self.bottom].into_iter(), out);
        out.scalar((name, DEPTH), "m", self.inside.unwrap_or(0.0));
    }
}

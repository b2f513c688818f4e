//! Checks for values that are possible in a model but unusual in a real robot: wrong units, frames and placeholders
//! that load without an error and spoil a simulation.
//!
//! Every rule is in this file, with its bound and its source. None needs the size of a link: a mass and its
//! principal moments suffice. Errors in the text of a URDF itself (impossible moments, limits that are zero or
//! equal) are reported as a [`UrdfWarning`](crate::UrdfWarning), with its line, and not repeated here.
//!
//! ```
//! use nalgebra::{Matrix3, Vector3};
//! use opspace_model::{Inertia, Joint, JointKind, Limits, Model, Placement, ModelWarning, model_warnings};
//! // Moments as they were in g mm².
//! let link = Inertia { mass: 1.0, com: Vector3::zeros(), rotational: Matrix3::identity() * 1e6 };
//! let limits = Limits { lower: -2.0, upper: 2.0, velocity: 3.0, effort: 40.0 };
//! let joint = Joint { name: "hinge".into(), kind: JointKind::Revolute, limits };
//! let mut model = Model::new("pendulum");
//! model.add_body(None, Placement::identity(), joint, link);
//! assert!(matches!(model_warnings(&model)[..], [ModelWarning::LargeInertia { .. }]));
//! ```

use crate::model::{Body, Joint, JointKind, Model};
use crate::name_list::name_list;
use crate::spatial::principal_moments;
use nalgebra::Vector3;
use std::f64::consts::PI;
use thiserror::Error;

/// Density of osmium: no matter is denser.
const DENSEST_KG_PER_M3: f64 = 22_590.0;

/// Density of expanded polystyrene. The lightest sound body of the robots in the tests has 52; the identity
/// matrix that stands in many files for an unknown inertia gives a body of 1 kg a density of 0.06.
const LIGHTEST_KG_PER_M3: f64 = 30.0;

/// Largest distance of the centre of mass from the frame, in radii of gyration. A uniform rod has √3 about its end; the
/// robots in the tests have 3.7 at most, where the Denavit-Hartenberg convention puts the frame outside the link.
const FARTHEST_IN_RADII: f64 = 6.0;

/// Largest mass ratio between a body and its parent. A camera on a torso comes to some hundreds; grams for kilograms,
/// and links put in only because a joint needs one, to thousands.
const LARGEST_MASS_RATIO: f64 = 1000.0;

/// Widest range of a revolute joint: cables end joints' ranges after two or three turns; limits in degrees come to
/// dozens.
const WIDEST_TURN_RAD: f64 = 10.0 * PI;

/// Widest range of a prismatic joint: longer than any axis but a gantry's; limits in millimetres come to hundreds.
const WIDEST_SLIDE_M: f64 = 20.0;

/// Unusual value in a model. `part` names a body as in `link 'elbow'`, after the link that its joint moves.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum ModelWarning {
    /// Centre of mass outside its body.
    #[error(
        "{part}: its centre of mass is {} m from its frame, {:.0} times its radius of gyration of {} m; \
         for real links it is at most 4 times: give it in the link's own frame, in m",
        short(*distance_m), distance_m / radius_m, short(*radius_m)
    )]
    FarCentre {
        /// Name of the body.
        part: String,
        /// Distance of the centre of mass from the origin of the body's frame, m.
        distance_m: f64,
        /// Largest radius of gyration of the body, m.
        radius_m: f64,
    },
    /// Body too compact for its mass.
    #[error(
        "{part}: its largest principal moment is {} kg m²; a solid osmium sphere of its mass, {} kg, has {}: \
         give moments in kg m², unless a point mass is intended",
        short(*moment), short(*mass), short(*least)
    )]
    SmallInertia {
        /// Name of the body.
        part: String,
        /// Mass of the body, kg.
        mass: f64,
        /// Largest principal moment of the body, kg m².
        moment: f64,
        /// Moment of a ball of this mass of the densest matter, kg m².
        least: f64,
    },
    /// Body too wide for its mass.
    #[error(
        "{part}: its principal moments {}, {}, {} kg m² with {} kg are those of a solid of {} kg/m³; real links \
         have at least 50 kg/m³: give moments about the centre of mass, in kg m², not placeholders",
        short(moments[0]), short(moments[1]), short(moments[2]), short(*mass), short(*density)
    )]
    LargeInertia {
        /// Name of the body.
        part: String,
        /// Mass of the body, kg.
        mass: f64,
        /// Principal moments, ascending, kg m².
        moments: [f64; 3],
        /// Density of the uniform ellipsoid that has this mass and these moments, kg/m³.
        density: f64,
    },
    /// Parent and child of very different mass.
    #[error(
        "{heavy} has {} kg and the adjacent {light} {} kg; mass ratios are usually below 1000: give both in kg, and \
         attach a placeholder link to a neighbour by a fixed joint",
        short(masses[1]), short(masses[0])
    )]
    UnequalMasses {
        /// Name of the lighter body.
        light: String,
        /// Name of the heavier body, its parent or child.
        heavy: String,
        /// Masses of the heavier and the lighter body, kg.
        masses: [f64; 2],
    },
    /// Joints without a limit of speed or effort.
    #[error(
        "{}: no {limit} limit, so any {limit} is accepted; give <limit {limit}=\"...\"> from the motor's data sheet",
        listed(joints)
    )]
    NoLimit {
        /// Names of the joints, in the model's order.
        joints: Vec<String>,
        /// Name of the limit: `velocity` or `effort`.
        limit: &'static str,
    },
    /// Position range wider than that of any joint.
    #[error("joint '{joint}': its range from {} to {} {}", short(*lower), short(*upper), widest(*kind))]
    WideRange {
        /// Name of the joint.
        joint: String,
        /// Type of the joint, which determines the unit.
        kind: JointKind,
        /// Lower limit, rad or m.
        lower: f64,
        /// Upper limit, rad or m.
        upper: f64,
    },
}

/// Rules about one body with mass.
const OF_BODIES: [fn(&Part<'_>) -> Option<ModelWarning>; 4] =
    [far_centre, small_inertia, large_inertia, unequal_masses];

/// Returns the unusual values of a model, bodies first, in their order; empty for most. Allocates: call it once after
/// loading.
#[must_use]
pub fn model_warnings(model: &Model) -> Vec<ModelWarning> {
    let heavy = (0..model.bodies().len()).filter(|&i| model.bodies()[i].inertia.mass > 0.0);
    let parts = heavy.map(|number| Part::new(model, number));
    let of_bodies = parts.flat_map(|part| OF_BODIES.iter().filter_map(move |rule| rule(&part)));
    let limits =
        [no_limit(model, "velocity", |j| j.limits.velocity), no_limit(model, "effort", |j| j.limits.effort)];
    let ranges = model.joints().iter().filter_map(wide_range);
    of_bodies.chain(limits.into_iter().flatten()).chain(ranges).collect()
}

/// Body and the properties that the rules need.
#[derive(Clone, Copy)]
struct Part<'a> {
    model: &'a Model,
    number: usize,
    mass: f64,
    moments: [f64; 3],
}

impl<'a> Part<'a> {
    fn new(model: &'a Model, number: usize) -> Self {
        let inertia = &model.bodies()[number].inertia;
        Self { model, number, mass: inertia.mass, moments: principal_moments(&inertia.rotational) }
    }

    fn body(&self) -> &Body {
        &self.model.bodies()[self.number]
    }

    /// Name of the first link on it, which is the one that its joint moves.
    fn name(&self) -> String {
        let mut links = self.model.frames().iter().filter(|f| f.body == Some(self.number));
        match (links.next(), links.next()) {
            (Some(link), None) => format!("link '{}'", link.name),
            (Some(link), Some(_)) => format!("link '{}' with the links fixed to it", link.name),
            (None, _) => format!("the body moved by joint '{}'", self.model.joints()[self.body().joint].name),
        }
    }

    /// Principal moment of a ball of the densest matter, kg m²: no body of that mass has a smaller largest one.
    fn least_moment(&self) -> f64 {
        let radius = (3.0 * self.mass / (4.0 * PI * DENSEST_KG_PER_M3)).cbrt();
        0.4 * self.mass * radius * radius
    }

    /// Largest known distance from the body's frame to a child joint or a fixed frame, or from the parent's frame to
    /// it, m.
    fn extent(&self) -> f64 {
        let (model, me) = (self.model, Some(self.number));
        let children = model.bodies().iter().filter(|b| b.parent == me).map(|b| b.origin.translation);
        let frames = model.frames().iter().filter(|f| f.body == me).map(|f| f.placement.translation);
        let points = children.chain(frames).chain([self.body().origin.translation]);
        points.map(|p: Vector3<f64>| p.norm()).fold(0.0, f64::max)
    }
}

/// Compares with both the radius of gyration and the extent: a bob at the end of a rod is far from its joint, but not
/// from the frames there.
fn far_centre(part: &Part<'_>) -> Option<ModelWarning> {
    let distance_m = part.body().inertia.com.norm();
    let radius_m = (part.moments[2].max(part.least_moment()) / part.mass).sqrt();
    (distance_m > FARTHEST_IN_RADII * radius_m && distance_m > part.extent())
        .then(|| ModelWarning::FarCentre { part: part.name(), distance_m, radius_m })
}

fn small_inertia(part: &Part<'_>) -> Option<ModelWarning> {
    let &Part { mass, moments: [.., moment], .. } = part;
    let least = part.least_moment();
    (moment < least).then(|| ModelWarning::SmallInertia { part: part.name(), mass, moment, least })
}

/// Compares the density of the uniform ellipsoid with the same mass and moments: its semi-axes are
/// a² = 5 (I₂ + I₃ − I₁) / 2m and so on.
fn large_inertia(part: &Part<'_>) -> Option<ModelWarning> {
    let &Part { mass, moments, .. } = part;
    let sum: f64 = moments.iter().sum();
    // None below zero: impossible moments are another's to say.
    let semi_axis = |moment: f64| (2.5 * (sum - 2.0 * moment).max(0.0) / mass).sqrt();
    let density = mass / (4.0 / 3.0 * PI * moments.map(semi_axis).iter().product::<f64>());
    (density < LIGHTEST_KG_PER_M3).then(|| ModelWarning::LargeInertia {
        part: part.name(),
        mass,
        moments,
        density,
    })
}

fn unequal_masses(part: &Part<'_>) -> Option<ModelWarning> {
    let parent = Part::new(part.model, part.body().parent?);
    let (light, heavy) = if part.mass < parent.mass { (part, &parent) } else { (&parent, part) };
    // A root without mass is a frame to count from.
    (light.mass > 0.0 && heavy.mass > LARGEST_MASS_RATIO * light.mass).then(|| ModelWarning::UnequalMasses {
        light: light.name(),
        heavy: heavy.name(),
        masses: [light.mass, heavy.mass],
    })
}

/// Reports all joints without the limit at once: a file that leaves out one limit leaves out most.
fn no_limit(model: &Model, limit: &'static str, of: fn(&Joint) -> f64) -> Option<ModelWarning> {
    let free = |joint: &&Joint| joint.kind != JointKind::Floating && of(joint) == f64::INFINITY;
    let joints: Vec<String> = model.joints().iter().filter(free).map(|j| j.name.clone()).collect();
    (!joints.is_empty()).then_some(ModelWarning::NoLimit { joints, limit })
}

/// Checks the range of a joint with limits: others are continuous, or were made in code without limits.
fn wide_range(joint: &Joint) -> Option<ModelWarning> {
    let (lower, upper) = (joint.limits.lower, joint.limits.upper);
    let most = match joint.kind {
        JointKind::Revolute => WIDEST_TURN_RAD,
        JointKind::Prismatic => WIDEST_SLIDE_M,
        JointKind::Continuous | JointKind::Floating => return None,
    };
    (lower.is_finite() && upper.is_finite() && upper - lower > most).then(|| ModelWarning::WideRange {
        joint: joint.name.clone(),
        kind: joint.kind,
        lower,
        upper,
    })
}

fn widest(kind: JointKind) -> &'static str {
    match kind {
        JointKind::Prismatic => "m is more than 20 m; give it in m, not in mm",
        _ => "rad is more than five turns; give it in rad, not in degrees, or make the joint continuous",
    }
}

/// Number with three digits: `8.35`, `-170`, `1.20e-9`.
fn short(number: f64) -> String {
    let text = format!("{number:.2e}");
    match text.split_once('e').map(|(digits, exponent)| (digits, exponent.parse::<i32>())) {
        Some(("0.00", _)) => "0".to_owned(),
        Some((_, Ok(exponent @ -4..=4))) => {
            format!("{number:.*}", usize::try_from(2 - exponent).unwrap_or(0))
        }
        _ => text,
    }
}

/// Names of joints in one line, up to eight.
fn listed(names: &[String]) -> String {
    let word = if names.len() == 1 { "joint" } else { "joints" };
    let quoted: Vec<String> = names.iter().map(|name| format!("'{name}'")).collect();
    format!("{word} {}", name_list(&quoted, 8))
}

//! Checks for values that are possible in a model but unusual in a real robot: wrong units, wrong frames and
//! placeholder values, which load without an error and make simulations wrong.
//!
//! All rules are in this file, with their bounds and the sources of these bounds. No rule needs the dimensions of a
//! link: mass and principal moments suffice. Errors in the URDF text itself (impossible moments, zero limits, equal
//! limits) are reported as [`UrdfWarning`](crate::UrdfWarning) with their line and not repeated here.
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

/// Density of osmium, the densest material.
const DENSEST_KG_PER_M3: f64 = 22_590.0;

/// Density of expanded polystyrene. The lightest valid body of the robots in the tests has 52 kg/m³; the identity
/// matrix, a placeholder for unknown inertia in many files, gives a body of 1 kg a density of 0.06 kg/m³.
const LIGHTEST_KG_PER_M3: f64 = 30.0;

/// Largest distance of the centre of mass from the frame origin, in radii of gyration. A uniform rod with the frame at
/// its end has √3; the robots in the tests have 3.7 at most, in links whose frame is outside the link by the
/// Denavit-Hartenberg convention.
const FARTHEST_IN_RADII: f64 = 6.0;

/// Largest mass ratio between a body and its parent. A camera on a torso has a ratio of some hundreds; masses in grams
/// instead of kilograms, and placeholder links, have ratios of some thousands.
const LARGEST_MASS_RATIO: f64 = 1000.0;

/// Widest range of a revolute joint: cables limit the range to two or three turns; limits in degrees give dozens of
/// turns.
const WIDEST_TURN_RAD: f64 = 10.0 * PI;

/// Widest range of a prismatic joint, longer than any axis except on gantries; limits in millimetres give hundreds of
/// metres.
const WIDEST_SLIDE_M: f64 = 20.0;

/// Unusual value in a model. `part` names a body by the link that its joint moves, as in `link 'elbow'`.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum ModelWarning {
    /// Centre of mass too far from the body frame.
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
    /// Moments too small for the mass of the body.
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
        /// Moment of an osmium sphere of the same mass, kg m².
        least: f64,
    },
    /// Moments too large for the mass of the body.
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
        /// Density of the uniform ellipsoid with this mass and these moments, kg/m³.
        density: f64,
    },
    /// Parent and child with very different masses.
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
        /// Masses of the lighter and the heavier body, in this order, kg.
        masses: [f64; 2],
    },
    /// Joints without a velocity or effort limit.
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
    /// Position range that is wider than on real robots.
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

impl ModelWarning {
    /// Codes of all kinds.
    pub const CODES: [&'static str; 6] =
        ["far-centre", "small-inertia", "large-inertia", "unequal-masses", "no-limit", "wide-range"];

    /// Returns the code of the kind, which remains the same when its text changes.
    #[must_use]
    pub fn code(&self) -> &'static str {
        let [far, small, large, unequal, none, wide] = Self::CODES;
        match self {
            Self::FarCentre { .. } => far,
            Self::SmallInertia { .. } => small,
            Self::LargeInertia { .. } => large,
            Self::UnequalMasses { .. } => unequal,
            Self::NoLimit { .. } => none,
            Self::WideRange { .. } => wide,
        }
    }
}

/// Rules for a single body with mass.
const OF_BODIES: [fn(&Part<'_>) -> Option<ModelWarning>; 4] =
    [far_centre, small_inertia, large_inertia, unequal_masses];

/// Returns the unusual values of a model: first those of bodies, then limits and ranges of joints. The list is empty
/// for most models. Allocates: call it once after loading.
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

/// Body with the properties that the rules need.
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

    /// Returns the name of the first link of the body, which is the link that its joint moves.
    fn name(&self) -> String {
        let mut links = self.model.frames().iter().filter(|f| f.body == Some(self.number));
        match (links.next(), links.next()) {
            (Some(link), None) => format!("link '{}'", link.name),
            (Some(link), Some(_)) => format!("link '{}' with the links fixed to it", link.name),
            (None, _) => format!("the body moved by joint '{}'", self.model.joints()[self.body().joint].name),
        }
    }

    /// Returns the principal moment of an osmium sphere with the mass of the body, kg m². The largest principal moment
    /// of any real body of this mass is at least as large.
    fn least_moment(&self) -> f64 {
        let radius = (3.0 * self.mass / (4.0 * PI * DENSEST_KG_PER_M3)).cbrt();
        0.4 * self.mass * radius * radius
    }

    /// Returns the extent of the body, m: the largest distance from the body frame to a child joint or a fixed frame,
    /// or from the parent frame to the body frame.
    fn extent(&self) -> f64 {
        let (model, me) = (self.model, Some(self.number));
        let children = model.bodies().iter().filter(|b| b.parent == me).map(|b| b.origin.translation);
        let frames = model.frames().iter().filter(|f| f.body == me).map(|f| f.placement.translation);
        let points = children.chain(frames).chain([self.body().origin.translation]);
        points.map(|p: Vector3<f64>| p.norm()).fold(0.0, f64::max)
    }
}

/// Compares the distance of the centre of mass with the radius of gyration and with the extent. The extent excludes a
/// bob at the end of a rod, which is far from its joint but close to another frame.
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

/// Compares the density of the uniform ellipsoid with the same mass and moments, whose semi-axes are a² = 5 (I₂ + I₃ −
/// I₁) / 2m and so on.
fn large_inertia(part: &Part<'_>) -> Option<ModelWarning> {
    let &Part { mass, moments, .. } = part;
    let sum: f64 = moments.iter().sum();
    // Clamped at zero: impossible moments are reported by the URDF reader.
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
    // A root without mass is only a reference frame.
    (light.mass > 0.0 && heavy.mass > LARGEST_MASS_RATIO * light.mass).then(|| ModelWarning::UnequalMasses {
        light: light.name(),
        heavy: heavy.name(),
        masses: [light.mass, heavy.mass],
    })
}

/// Reports all joints without the limit in one warning: a file that omits the limit of one joint usually omits it for
/// most.
fn no_limit(model: &Model, limit: &'static str, of: fn(&Joint) -> f64) -> Option<ModelWarning> {
    let free = |joint: &&Joint| joint.kind != JointKind::Floating && of(joint) == f64::INFINITY;
    let joints: Vec<String> = model.joints().iter().filter(free).map(|j| j.name.clone()).collect();
    (!joints.is_empty()).then_some(ModelWarning::NoLimit { joints, limit })
}

/// Checks the range of a joint with position limits. Other joints are continuous, or were created in code without
/// limits.
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

/// Formats a number with three digits: `8.35`, `-170`, `1.20e-9`.
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

/// Lists the names of up to eight joints in one line.
fn listed(names: &[String]) -> String {
    let word = if names.len() == 1 { "joint" } else { "joints" };
    let quoted: Vec<String> = names.iter().map(|name| format!("'{name}'")).collect();
    format!("{word} {}", name_list(&quoted, 8))
}

//! Assumed masses and inertias of links of which the URDF states none, or impossible ones.
//!
//! A link without mass gets that of its shapes, filled with materials of [`DENSITIES`]. Links without shapes are those of a
//! chain of solid cylinders from joint to joint that tapers from the base to the tip. Its mass is the one that is known of the
//! whole arm, or else follows from the masses that the URDF has, or else from the length of the chain: [`KG_PER_M3_OF_LENGTH`].
//!
//! No link beyond the second joint is heavier than the heaviest before it: a wrist is lighter than its shoulder.

use crate::assumed_drives::rounded;
use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use opspace_experiment::files::collision::link_solids;
use opspace_experiment::files::source::{FileError, Source};
use opspace_experiment::postures::tip::tip;
use opspace_model::collision::Densities;
use opspace_model::{Inertia, MasslessJoint, Model, Placement};

/// Densities of the shapes of links: motors, gears and aluminium with hollow space between. Spheres, cylinders, capsules and
/// boxes enclose links with space around them: those of the FR3 have 3.6 times its mass over the density of water.
pub const DENSITIES: Densities = Densities { mesh_kg_per_m3: 1000.0, primitive_kg_per_m3: 400.0 };

/// Moving mass of an arm over the third power of the length of its chain, kg/m³. With the masses of data sheets: Panda 9, UR5e 9,
/// M-16iB 12, UR3e 14, IRB 120 25, KR 120 28, LR Mate 37.
pub const KG_PER_M3_OF_LENGTH: f64 = 16.0;

/// Radius of a chain at its base over the reach.
const RADIUS_SHARE: f64 = 0.06;

/// Radius of a chain at its tip over that at its base.
const TAPER: f64 = 0.5;

/// Least length of a link over the reach: joints with axes that intersect have motors between them.
const LEAST_LENGTH_SHARE: f64 = 0.06;

/// Number of joints whose links may be heavier than those before them: the first axis of many arms only carries the second.
const SHOULDER_JOINTS: usize = 2;

/// Density of a sphere of the mass of a link, kg/m³: no link has less inertia than it. That of steel.
const DENSEST_KG_PER_M3: f64 = 8000.0;

/// Origin of an assumed inertia.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum BodySource {
    /// Shapes of the link.
    Shapes,
    /// Place of the link in a chain that tapers.
    Chain,
    /// Inertia of the URDF, with principal moments that are raised to those of a solid sphere.
    Floor,
}

/// Assumed mass and inertia of a link.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct AssumedBody {
    /// Name of the link.
    pub link: String,
    /// Inertia in the frame of the link.
    pub inertia: Inertia,
    /// Origin of the values.
    pub source: BodySource,
}

/// Returns the inertias of links that state a mass and have less inertia than a solid sphere of that mass, or moments that no body
/// has. `links` are names and inertias in the frames of the links.
#[must_use]
pub fn floored_bodies(links: &[(String, Inertia)]) -> Vec<AssumedBody> {
    let floored = |(link, inertia): &(String, Inertia)| {
        let inertia = floored(inertia)?;
        Some(AssumedBody { link: link.clone(), inertia, source: BodySource::Floor })
    };
    links.iter().filter_map(floored).collect()
}

/// Returns an inertia whose principal moments are possible, and not below those of a dense sphere; `None` if they are.
fn floored(inertia: &Inertia) -> Option<Inertia> {
    if inertia.mass <= 0.0 {
        return None;
    }
    let radius_m = (3.0 * inertia.mass / (4.0 * std::f64::consts::PI * DENSEST_KG_PER_M3)).cbrt();
    let floor = 0.4 * inertia.mass * radius_m * radius_m;
    let principal = SymmetricEigen::new(inertia.rotational);
    let mut moments = principal.eigenvalues;
    let (least, most) = (moments.min(), moments.max());
    let others = moments.sum() - most;
    // Exporters round; what is wrong by more than a thousandth is a mistake.
    let is_possible = others >= most * (1.0 - 1e-3);
    if least >= floor && is_possible {
        return None;
    }
    moments.iter_mut().for_each(|moment| *moment = moment.max(floor));
    let largest = moments.imax();
    let lacking = moments[largest] - (moments.sum() - moments[largest]);
    if lacking > 0.0 {
        moments.iter_mut().enumerate().filter(|(i, _)| *i != largest).for_each(|(_, m)| *m += 0.5 * lacking);
    }
    let axes = principal.eigenvectors;
    let rotational = axes * Matrix3::from_diagonal(&moments) * axes.transpose();
    Some(Inertia { rotational: 0.5 * (rotational + rotational.transpose()), ..*inertia })
}

/// Returns the masses and inertias of the links that joints move without mass. `total_kg` is the mass of the whole arm, with its
/// base, if it is known.
///
/// # Errors
/// A shape of the URDF that cannot be read; a total mass that the other links already have.
pub fn assumed_bodies(
    model: &Model,
    urdf: &Source,
    massless: &[MasslessJoint],
    total_kg: Option<f64>,
) -> Result<Vec<AssumedBody>, FileError> {
    let chain = Chain::of(model);
    let solids = link_solids(urdf, DENSITIES)?;
    let of_body = |body: usize| -> Vec<Inertia> {
        let frames = model.frames().iter().filter(|frame| frame.body == Some(body));
        frames
            .filter_map(|frame| {
                let (_, solid) = solids.iter().find(|(link, _)| *link == frame.name)?;
                Some(frame.placement.act_inertia(solid))
            })
            .collect()
    };
    let mut bodies: Vec<(usize, &MasslessJoint, Inertia, BodySource)> = Vec::new();
    for joint in massless {
        // A joint that mimics another is none of the model, so that the link tells the body.
        let frame = model.frames().iter().find(|frame| frame.name == joint.link);
        let Some(body) = frame.and_then(|frame| frame.body) else { continue };
        let shapes = of_body(body);
        let found = match shapes.is_empty() {
            false => (shapes.into_iter().fold(Inertia::zero(), |sum, shape| sum + shape), BodySource::Shapes),
            true => (chain.cylinder(body), BodySource::Chain),
        };
        bodies.push((body, joint, found.0, found.1));
    }
    scale(model, &chain, &mut bodies, total_kg, urdf)?;
    limit(model, &mut bodies);
    let body = |(body, joint, inertia, source): (usize, &MasslessJoint, Inertia, BodySource)| {
        let frame = model.frames().iter().find(|frame| frame.name == joint.link && frame.body == Some(body));
        let placement = frame.map_or_else(Placement::identity, |frame| frame.placement);
        let own = placement.inverse().act_inertia(&inertia);
        AssumedBody { link: joint.link.clone(), inertia: floored(&own).unwrap_or(own), source }
    };
    Ok(bodies.into_iter().map(body).collect())
}

/// Scales the masses: all to the known mass of the arm, or those of the chain to the other masses or the reach.
fn scale(
    model: &Model,
    chain: &Chain,
    bodies: &mut [(usize, &MasslessJoint, Inertia, BodySource)],
    total_kg: Option<f64>,
    urdf: &Source,
) -> Result<(), FileError> {
    let sum = |bodies: &[(usize, &MasslessJoint, Inertia, BodySource)]| -> f64 {
        bodies.iter().map(|(_, _, inertia, _)| inertia.mass).sum()
    };
    let known_kg = model.total_mass();
    if let Some(total_kg) = total_kg {
        let moving_kg = total_kg * chain.moving_share() - known_kg;
        if moving_kg <= 0.0 {
            let message = format!(
                "the links that state a mass have {known_kg:.3} kg already: {total_kg} kg is not the whole arm's"
            );
            return Err(FileError::of_file(
                urdf.name(),
                message,
                Some("give the mass of the whole arm".to_owned()),
            ));
        }
        let factor = moving_kg / sum(bodies);
        bodies.iter_mut().for_each(|(_, _, inertia, _)| *inertia = scaled(inertia, factor));
        return Ok(());
    }
    // The chain of the bodies whose mass is known has these masses in the same units.
    let is_massless = |body: usize| bodies.iter().any(|(massless, ..)| *massless == body);
    let others = (0..model.bodies().len()).filter(|&body| !is_massless(body));
    let same: f64 = others.map(|body| chain.cylinder(body).mass).sum();
    let factor = match same > 0.0 && known_kg > 0.0 {
        true => known_kg / same,
        false => KG_PER_M3_OF_LENGTH * chain.reach_m.powi(3) / chain.mass(),
    };
    for (_, _, inertia, source) in bodies {
        if *source == BodySource::Chain {
            *inertia = scaled(inertia, factor);
        }
    }
    Ok(())
}

/// Keeps links beyond the shoulder from being heavier than all before them.
fn limit(model: &Model, bodies: &mut [(usize, &MasslessJoint, Inertia, BodySource)]) {
    bodies.sort_by_key(|(body, ..)| *body);
    for index in 0..bodies.len() {
        let (body, _, inertia, _) = bodies[index];
        let before: Vec<usize> =
            std::iter::successors(model.bodies()[body].parent, |&body| model.bodies()[body].parent).collect();
        if before.len() < SHOULDER_JOINTS {
            continue;
        }
        let mass_of = |of: usize| match bodies.iter().find(|(body, ..)| *body == of) {
            Some((_, _, inertia, _)) => inertia.mass,
            None => model.bodies()[of].inertia.mass,
        };
        let most = before.into_iter().map(mass_of).fold(0.0, f64::max);
        if inertia.mass > most && most > 0.0 {
            bodies[index].2 = scaled(&inertia, most / inertia.mass);
        }
    }
}

/// Inertia of the same shape with another density.
fn scaled(inertia: &Inertia, factor: f64) -> Inertia {
    Inertia { mass: factor * inertia.mass, com: inertia.com, rotational: inertia.rotational * factor }
}

/// Arm as a chain of cylinders of density one.
struct Chain<'a> {
    model: &'a Model,
    /// Vector from each body's joint to the next joint, or to the end of the arm, in the axes of the body, m.
    links: Vec<Vector3<f64>>,
    /// Length of the chain before each body, m.
    before: Vec<f64>,
    /// Sum of the lengths from the base to the tip, m.
    reach_m: f64,
    /// Height of the first joint above the base, m.
    base_m: f64,
}

impl<'a> Chain<'a> {
    fn of(model: &'a Model) -> Self {
        let bodies = model.bodies();
        let tip = tip(model);
        let links: Vec<Vector3<f64>> = (0..bodies.len())
            .map(|body| {
                let next = bodies
                    .iter()
                    .filter(|next| next.parent == Some(body))
                    .map(|next| next.origin.translation);
                let ends = model
                    .frames()
                    .iter()
                    .filter(|frame| frame.body == Some(body))
                    .map(|frame| frame.placement.translation);
                let longest = |all: &mut dyn Iterator<Item = Vector3<f64>>| {
                    all.max_by(|a, b| a.norm().total_cmp(&b.norm()))
                };
                longest(&mut next.into_iter()).or_else(|| longest(&mut ends.into_iter())).unwrap_or_default()
            })
            .collect();
        let mut before: Vec<f64> = vec![0.0; bodies.len()];
        for body in 0..bodies.len() {
            if let Some(parent) = bodies[body].parent {
                before[body] = before[parent] + bodies[body].origin.translation.norm();
            }
        }
        let to_tip = tip.and_then(|tip| {
            model.frame(tip).body.map(|body| before[body] + model.frame(tip).placement.translation.norm())
        });
        let longest = (0..bodies.len()).map(|body| before[body] + links[body].norm()).fold(0.0, f64::max);
        let base_m = bodies.first().map_or(0.0, |body| body.origin.translation.norm());
        Self { model, links, before, reach_m: to_tip.unwrap_or(longest).max(0.5 * longest).max(1e-3), base_m }
    }

    /// Radius at a length from the base, m.
    fn radius_m(&self, at_m: f64) -> f64 {
        let share = (at_m / self.reach_m).clamp(0.0, 1.0);
        RADIUS_SHARE * self.reach_m * (1.0 - (1.0 - TAPER) * share)
    }

    /// Link of a body as a cylinder of density one, in the frame of the body.
    fn cylinder(&self, body: usize) -> Inertia {
        let link = self.links[body];
        let length_m = link.norm().max(LEAST_LENGTH_SHARE * self.reach_m);
        let radius_m = self.radius_m(self.before[body] + 0.5 * length_m);
        let axis = link.try_normalize(1e-9).unwrap_or_else(Vector3::z);
        cylinder(0.5 * link, &axis, length_m, radius_m)
    }

    /// Mass of all cylinders, kg at a density of one.
    fn mass(&self) -> f64 {
        (0..self.model.bodies().len()).map(|body| self.cylinder(body).mass).sum()
    }

    /// Share of the mass of an arm that moves: the base is a cylinder up to the first joint.
    fn moving_share(&self) -> f64 {
        let base_m = self.base_m.max(LEAST_LENGTH_SHARE * self.reach_m);
        let base = std::f64::consts::PI * self.radius_m(0.0).powi(2) * base_m;
        self.mass() / (self.mass() + base)
    }
}

/// Solid cylinder of density one.
fn cylinder(com: Vector3<f64>, axis: &Vector3<f64>, length_m: f64, radius_m: f64) -> Inertia {
    let mass = std::f64::consts::PI * radius_m * radius_m * length_m;
    let along = axis * axis.transpose();
    let across = Matrix3::identity() - along;
    let rotational = along * (0.5 * mass * radius_m * radius_m)
        + across * (mass * (3.0 * radius_m * radius_m + length_m * length_m) / 12.0);
    Inertia { mass, com, rotational }
}

/// Numbers of an inertia for a file: mass, centre of mass, and xx, xy, xz, yy, yz, zz, with three digits.
#[must_use]
pub fn numbers(inertia: &Inertia) -> (f64, [f64; 3], [f64; 6]) {
    let Inertia { mass, com, rotational: r } = inertia;
    let com = [com.x, com.y, com.z].map(|x| (x * 1e4).round() / 1e4 + 0.0);
    let moments = [r[(0, 0)], r[(0, 1)], r[(0, 2)], r[(1, 1)], r[(1, 2)], r[(2, 2)]];
    // Products of inertia that are rounding errors.
    let largest = moments.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
    (rounded(*mass), com, moments.map(|x| if x.abs() < 1e-6 * largest { 0.0 } else { precise(x) }))
}

/// Rounds to six digits, so that the moments of a thin body stay possible.
fn precise(value: f64) -> f64 {
    format!("{value:.5e}").parse().unwrap_or(value)
}

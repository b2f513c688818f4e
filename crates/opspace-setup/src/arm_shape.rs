//! Shape of an arm: what tells one type of arm from another, independent of the posture, of names, and of the places and signs of the
//! frames in its URDF.
//!
//! ```text
//! a, α     distance and angle of two successive axes
//! d        distance along an axis between its common normals with the axes before and after; of a group of parallel axes, along all
//! range    angle through which a joint turns
//! mass     of all links from the first joint on
//! ```

use nalgebra::Vector3;
use opspace_experiment::files::source::Source;
use opspace_model::urdf::link_shapes;
use opspace_model::{JointKind, Model, Placement};
use serde::{Deserialize, Deserializer};

/// Axes at a smaller angle are parallel, rad: calibrated URDFs state axes that are parallel by design with errors of a few mrad.
const PARALLEL_RAD: f64 = 0.05;
/// Largest difference of angles between axes, rad.
const TWIST_TOLERANCE_RAD: f64 = 0.05;
/// Largest difference of lengths, as a fraction: UR10 and UR10e differ by 6 % in one length, and by less than 1 % in the others.
const LENGTH_TOLERANCE: f64 = 0.01;
/// Largest difference of lengths that is always allowed, m.
const LENGTH_TOLERANCE_M: f64 = 0.005;
/// Angle by which a joint may turn further, rad. Many URDFs narrow ranges; FR3 and Panda, which have the same lengths, differ by 0.2 rad.
const RANGE_TOLERANCE_RAD: f64 = 0.17;
/// Largest factor between masses.
const MASS_FACTOR: f64 = 2.0;

/// Shape of an arm of rotating joints.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct ArmShape {
    /// Distances of successive axes, m.
    pub distances_m: Vec<f64>,
    /// Angles between successive axes, from 0 to π/2, rad.
    pub twists_rad: Vec<f64>,
    /// Distances along the axes between their common normals with those before and after, m.
    pub offsets_m: Vec<f64>,
    /// Angles through which the joints turn, rad; infinite without limits ("continuous" in a template).
    #[serde(deserialize_with = "ranges_rad")]
    pub ranges_rad: Vec<f64>,
    /// Mass of all links from the first joint on, kg; `None` if the URDF does not state the masses of all of them.
    pub mass_kg: Option<f64>,
}

impl ArmShape {
    /// Returns the shape of a chain of bodies of a model, with the masses that its URDF states.
    #[must_use]
    pub fn of(urdf: &Source, model: &Model, chain: &[usize]) -> Self {
        let axes = axes(model, chain);
        let pairs: Vec<AxisPair> = axes.windows(2).map(|pair| AxisPair::new(&pair[0], &pair[1])).collect();
        let range = |&body: &usize| {
            let limits = &model.joints()[model.bodies()[body].joint].limits;
            if model.bodies()[body].kind == JointKind::Continuous {
                f64::INFINITY
            } else {
                limits.upper - limits.lower
            }
        };
        Self {
            distances_m: pairs.iter().map(|pair| pair.distance_m).collect(),
            twists_rad: pairs.iter().map(|pair| pair.twist_rad).collect(),
            offsets_m: offsets_m(&axes, &pairs),
            ranges_rad: chain.iter().map(range).collect(),
            mass_kg: mass_kg(urdf, model, chain),
        }
    }

    /// Number of joints.
    #[must_use]
    pub fn joints(&self) -> usize {
        self.ranges_rad.len()
    }

    /// Returns the differences of another arm from this one, each as a sentence; none if it has this shape. `names` are those of
    /// its joints.
    #[must_use]
    pub fn differences(&self, other: &Self, names: &[&str]) -> Vec<String> {
        if other.joints() != self.joints() {
            return vec![format!(
                "{} joints in a chain ({}), not {}",
                other.joints(),
                names.join(", "),
                self.joints()
            )];
        }
        let mut found = Vec::new();
        for (i, pair) in names.windows(2).enumerate() {
            let axes = || format!("axes of '{}' and '{}'", pair[0], pair[1]);
            let (twist, expected) = (other.twists_rad[i], self.twists_rad[i]);
            if (twist - expected).abs() > TWIST_TOLERANCE_RAD {
                let [twist, expected] = [twist, expected].map(f64::to_degrees);
                found.push(format!("{} at an angle of {twist:.0}°, not {expected:.0}°", axes()));
            }
            let (distance, expected) = (other.distances_m[i], self.distances_m[i]);
            if !is_length(distance, expected) {
                found.push(format!("{} are {distance:.3} m apart, not {expected:.3} m", axes()));
            }
        }
        let inner = inner_groups(&self.twists_rad);
        // With other angles the lengths along the axes are those of other axes.
        if inner == inner_groups(&other.twists_rad) {
            for ((&joint, &offset), &expected) in inner.iter().zip(&other.offsets_m).zip(&self.offsets_m) {
                if !is_length(offset, expected) {
                    let name = names[joint];
                    found.push(format!("{offset:.3} m along the axis of '{name}', not {expected:.3} m"));
                }
            }
        }
        for ((name, &range), &expected) in names.iter().zip(&other.ranges_rad).zip(&self.ranges_rad) {
            if range.is_finite() && range > expected + RANGE_TOLERANCE_RAD {
                found.push(format!("'{name}' turns {range:.2} rad, not at most {expected:.2} rad"));
            }
        }
        if let (Some(mass), Some(expected)) = (other.mass_kg, self.mass_kg)
            && !(mass <= MASS_FACTOR * expected && expected <= MASS_FACTOR * mass)
        {
            found.push(format!("{mass:.1} kg from the first joint on, not {expected:.1} kg"));
        }
        found
    }

    /// Sum of the differences of the joints' ranges, rad: the smaller, the more alike. Joints without limits do not count.
    #[must_use]
    pub fn range_difference_rad(&self, other: &Self) -> f64 {
        let ranges = self.ranges_rad.iter().zip(&other.ranges_rad);
        ranges.map(|(a, b)| (a - b).abs()).filter(|difference| difference.is_finite()).sum()
    }
}

/// Range of a joint in a template.
#[derive(Deserialize)]
#[serde(untagged)]
enum Range {
    Rad(f64),
    Unlimited(Unlimited),
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Unlimited {
    Continuous,
}

fn ranges_rad<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f64>, D::Error> {
    let ranges = Vec::<Range>::deserialize(deserializer)?.into_iter();
    Ok(ranges
        .map(|range| match range {
            Range::Rad(rad) => rad,
            Range::Unlimited(Unlimited::Continuous) => f64::INFINITY,
        })
        .collect())
}

fn is_length(found: f64, expected: f64) -> bool {
    (found - expected).abs() <= LENGTH_TOLERANCE_M.max(LENGTH_TOLERANCE * expected)
}

/// Axis of a joint: a point, and the direction.
struct Axis {
    point: Vector3<f64>,
    direction: Vector3<f64>,
}

/// Axes of the joints of a chain at joint positions of zero, in the frame of the body that holds the first one.
fn axes(model: &Model, chain: &[usize]) -> Vec<Axis> {
    let mut placement = Placement::identity();
    let mut before = chain.first().and_then(|&body| model.bodies()[body].parent);
    let mut found = Vec::new();
    for &body in chain {
        placement = placement * placement_between(model, before, body);
        before = Some(body);
        // The axis of each body is z of its frame.
        found.push(Axis { point: placement.translation, direction: placement.rotation * Vector3::z() });
    }
    found
}

/// Pose of a body in the frame of an ancestor, at joint positions of zero.
fn placement_between(model: &Model, ancestor: Option<usize>, body: usize) -> Placement {
    let mut placement = model.bodies()[body].origin;
    let mut parent = model.bodies()[body].parent;
    while let Some(above) = parent.filter(|_| parent != ancestor) {
        placement = model.bodies()[above].origin * placement;
        parent = model.bodies()[above].parent;
    }
    placement
}

/// Two successive axes.
struct AxisPair {
    distance_m: f64,
    twist_rad: f64,
    /// Ends of the common normal: on the first axis, and on the second; `None` for parallel axes.
    feet: Option<[Vector3<f64>; 2]>,
}

impl AxisPair {
    fn new(a: &Axis, b: &Axis) -> Self {
        let between = b.point - a.point;
        let cosine = a.direction.dot(&b.direction);
        let normal = a.direction.cross(&b.direction);
        let sine = normal.norm();
        let twist_rad = sine.atan2(cosine.abs());
        if twist_rad < PARALLEL_RAD {
            let across = between - a.direction * between.dot(&a.direction);
            return Self { distance_m: across.norm(), twist_rad, feet: None };
        }
        let (along_a, along_b) = (between.dot(&a.direction), between.dot(&b.direction));
        let square = sine * sine;
        let on_a = a.point + a.direction * ((along_a - cosine * along_b) / square);
        let on_b = b.point + b.direction * ((cosine * along_a - along_b) / square);
        Self { distance_m: between.dot(&normal).abs() / sine, twist_rad, feet: Some([on_a, on_b]) }
    }
}

/// Distances along each axis, or group of parallel axes, between the first and the last of its common normals with others.
fn offsets_m(axes: &[Axis], pairs: &[AxisPair]) -> Vec<f64> {
    let mut found = Vec::new();
    let mut start: Option<(Vector3<f64>, Vector3<f64>)> = None;
    for (pair, next) in pairs.iter().zip(&axes[1..]) {
        let Some([on_this, on_next]) = pair.feet else { continue };
        if let Some((from, direction)) = start {
            found.push((on_this - from).dot(&direction).abs());
        }
        start = Some((on_next, next.direction));
    }
    found
}

/// First joint of each axis, or group of parallel axes, that has common normals with an axis before and with one after.
fn inner_groups(twists_rad: &[f64]) -> Vec<usize> {
    let mut starts: Vec<usize> =
        (0..twists_rad.len()).filter(|&i| twists_rad[i] >= PARALLEL_RAD).map(|i| i + 1).collect();
    starts.pop();
    starts
}

/// Mass of the links of a chain, kg; `None` if the URDF does not state that of every joint.
fn mass_kg(urdf: &Source, model: &Model, chain: &[usize]) -> Option<f64> {
    let links = link_shapes(urdf.text()).ok()?;
    let mass_of = |body: usize| -> f64 {
        let frames = model.frames().iter().filter(|frame| frame.body == Some(body));
        let link = |name: &String| links.iter().find(|link| link.link == *name);
        frames.filter_map(|frame| link(&frame.name)?.inertia.as_ref().map(|inertia| inertia.mass)).sum()
    };
    let masses: Vec<f64> = chain.iter().map(|&body| mass_of(body)).collect();
    masses.iter().all(|mass| *mass > 0.0).then(|| masses.iter().sum())
}

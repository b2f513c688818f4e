//! Parameters of held objects: `[objects.NAME]` in a file that describes several robots.

use crate::environment::Mistake;
use crate::environment::mistake::highest_frequency;
use crate::plant_object::{PlantFrame, PlantGrip, PlantObject};
use nalgebra::Vector3;
use opspace_backend::quantity::{NonNegative, Positive, exactly};
use opspace_model::{Data, Model, frame_placement, kinematics};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Deserializer};
use std::f64::consts::TAU;

/// Largest product of a physics step and the damping of all grips over mass and inertia: the steps are stable up to 1.
const LARGEST_DAMPING_STEP: f64 = 0.5;

/// Rigid object that hands of robots hold.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct HeldObjectParameters {
    /// Mass, kg.
    pub mass_kg: Positive,
    /// Principal moments of inertia about the centre of mass, kg m². The principal axes are those of the world at the start.
    #[serde(deserialize_with = "exactly")]
    pub inertia_kg_m2: [Positive; 3],
    /// Centre of mass at the start in world coordinates, m; by default the mean of the origins of the frames that hold the
    /// object from the start of the simulation.
    #[serde(default, deserialize_with = "point")]
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "computed")))]
    pub position_m: Option<[f64; 3]>,
    /// Time until which a support holds the object in place, in s after the controller's start; without support if absent.
    pub supported_until_s: Option<NonNegative>,
    /// Grips of hands on the object.
    #[cfg_attr(feature = "schema", schemars(extend("minItems" = 1)))]
    pub grip: Vec<GripParameters>,
}

/// Grip of a hand: springs and dampers between the object and a frame, relaxed where both are when the grip begins.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct GripParameters {
    /// Name of the robot.
    pub robot: String,
    /// Name of its frame.
    pub frame: String,
    /// Stiffness of the position in all directions, N/m.
    pub stiffness_n_per_m: Positive,
    /// Damping of the position, Ns/m.
    pub damping_ns_per_m: NonNegative,
    /// Stiffness of the orientation about all axes, Nm/rad; if it is 0, the object turns freely about the frame's origin.
    #[serde(default)]
    pub stiffness_nm_per_rad: NonNegative,
    /// Damping of the orientation, Nms/rad.
    #[serde(default)]
    pub damping_nms_per_rad: NonNegative,
    /// Beginning, in s after the controller's start.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "the start of the simulation")))]
    pub from_s: Option<NonNegative>,
    /// End, in s after the controller's start; never if absent.
    pub until_s: Option<Positive>,
}

/// Held object of a simulation.
#[derive(Clone, Debug, PartialEq)]
pub struct HeldObjectConfig {
    /// Name in the true rows of all arms that hold it.
    pub name: String,
    /// Names of all arms of the simulation in the order of their indices, by which grips name them.
    pub arms: Vec<String>,
    /// Object and grips.
    pub parameters: HeldObjectParameters,
}

/// Reads an optional point.
fn point<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<[f64; 3]>, D::Error> {
    exactly(deserializer).map(Some)
}

impl HeldObjectParameters {
    /// Checks parameters that depend on each other.
    fn check(&self) -> Result<(), Mistake> {
        if self.grip.is_empty() {
            return Err(Mistake::new("grip", "no hand ever holds the object: add a grip"));
        }
        let [x, y, z] = self.inertia_kg_m2.map(Positive::get);
        if x > y + z || y > z + x || z > x + y {
            return Err(Mistake::new(
                "inertia_kg_m2",
                "no body has these moments of inertia: each is at most the sum of the other two",
            ));
        }
        for (index, grip) in self.grip.iter().enumerate() {
            let from_s = grip.from_s.map_or(0.0, NonNegative::get);
            if grip.until_s.is_some_and(|until| until.get() <= from_s) {
                return Err(Mistake::new(format!("grip.{index}.until_s"), "the grip ends before it begins"));
            }
        }
        Ok(())
    }
}

impl HeldObjectConfig {
    /// Returns the object of a plant whose arms have these true models and start positions (n; rad or m), with the
    /// gravitational acceleration `gravity` (world axes, m/s²).
    pub(crate) fn placed(
        &self,
        arms: &[(&Model, &[f64])],
        gravity: Vector3<f64>,
        physics_hz: f64,
    ) -> Result<PlantObject, Mistake> {
        let p = &self.parameters;
        p.check()?;
        let frames = p
            .grip
            .iter()
            .enumerate()
            .map(|(index, grip)| self.frame(index, grip, arms))
            .collect::<Result<Vec<PlantFrame>, Mistake>>()?;
        let origins: Vec<Vector3<f64>> = frames.iter().map(|at| origin(*at, arms[at.arm])).collect();
        let position_m = match p.position_m {
            Some(position) => Vector3::from(position),
            None => self.mean_of_first_hands(&origins)?,
        };
        let grip = |(frame, grip): (&PlantFrame, &GripParameters)| PlantGrip {
            frame: *frame,
            stiffness_n_per_m: grip.stiffness_n_per_m.get(),
            damping_ns_per_m: grip.damping_ns_per_m.get(),
            stiffness_nm_per_rad: grip.stiffness_nm_per_rad.get(),
            damping_nms_per_rad: grip.damping_nms_per_rad.get(),
            from_s: grip.from_s.map_or(f64::NEG_INFINITY, NonNegative::get),
            until_s: grip.until_s.map_or(f64::INFINITY, Positive::get),
        };
        let object = PlantObject {
            mass_kg: p.mass_kg.get(),
            inertia_kg_m2: Vector3::from(p.inertia_kg_m2.map(Positive::get)),
            position_m,
            gravity_m_per_s2: gravity,
            supported_until_s: p.supported_until_s.map_or(f64::NEG_INFINITY, NonNegative::get),
            grips: frames.iter().zip(&p.grip).map(grip).collect(),
        };
        check_rates(&object, &origins, physics_hz)?;
        Ok(object)
    }

    /// Returns the frame of a grip.
    fn frame(
        &self,
        index: usize,
        grip: &GripParameters,
        arms: &[(&Model, &[f64])],
    ) -> Result<PlantFrame, Mistake> {
        let arm = self.arms.iter().position(|name| *name == grip.robot);
        let Some((arm, model)) = arm.and_then(|arm| Some((arm, arms.get(arm)?.0))) else {
            let robots = self.arms.join(", ");
            return Err(Mistake::new(
                format!("grip.{index}.robot"),
                format!("no robot '{}'; robots: {robots}", grip.robot),
            ));
        };
        let frame = model
            .frame_id(&grip.frame)
            .map_err(|source| Mistake::new(format!("grip.{index}.frame"), source.to_string()))?;
        Ok(PlantFrame { arm, frame })
    }

    /// Mean of the origins (m) of the grips that hold from the start of the simulation.
    fn mean_of_first_hands(&self, origins: &[Vector3<f64>]) -> Result<Vector3<f64>, Mistake> {
        let first = || {
            let grips = self.parameters.grip.iter().zip(origins);
            grips.filter(|(grip, _)| grip.from_s.is_none()).map(|(_, origin)| origin)
        };
        match first().count() {
            0 => Err(Mistake::new(
                "position_m",
                "missing: no grip holds the object from the start of the simulation (without from_s)",
            )),
            count => Ok(first().sum::<Vector3<f64>>() / count as f64),
        }
    }
}

/// Origin of a frame at the start of its arm, m.
fn origin(at: PlantFrame, (model, start): (&Model, &[f64])) -> Vector3<f64> {
    let mut data = Data::new(model);
    kinematics(model, &mut data, start, &vec![0.0; model.n()]);
    frame_placement(model, &data, at.frame).translation
}

/// Checks that the object does not vibrate on all its grips too fast for the physics rate, with the levers at the start.
fn check_rates(object: &PlantObject, origins: &[Vector3<f64>], physics_hz: f64) -> Result<(), Mistake> {
    let least_inertia = object.inertia_kg_m2.min();
    let (mut squared, mut rate) = (0.0, 0.0);
    for (grip, origin) in object.grips.iter().zip(origins) {
        let lever = (origin - object.position_m).norm_squared();
        let mobility = 1.0 / object.mass_kg + lever / least_inertia;
        squared += grip.stiffness_n_per_m * mobility + grip.stiffness_nm_per_rad / least_inertia;
        rate += grip.damping_ns_per_m * mobility + grip.damping_nms_per_rad / least_inertia;
    }
    let (frequency_hz, most_hz) = (squared.sqrt() / TAU, highest_frequency(physics_hz));
    if frequency_hz > most_hz {
        return Err(Mistake::new(
            "grip",
            format!(
                "on all its grips the object can vibrate with {frequency_hz:.0} Hz; at most a twentieth of the physics \
                 rate, {most_hz} Hz, can be simulated: the grips must be softer, or mass and inertia larger"
            ),
        ));
    }
    let needed_hz = rate / LARGEST_DAMPING_STEP;
    if needed_hz > physics_hz {
        return Err(Mistake::new(
            "grip",
            format!(
                "the grips have much damping for mass and inertia of the object: the physics rate is {physics_hz} Hz, at \
                 least {needed_hz:.0} Hz is needed, or less damping"
            ),
        ));
    }
    Ok(())
}

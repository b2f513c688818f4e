//! Robot of a compiled model of MuJoCo, read through the attributes of `mujoco.MjModel`.

use crate::arrays::flat;
use crate::errors::{argument, refused};
use crate::model::Model;
use nalgebra::{Matrix3, Quaternion, Unit, UnitQuaternion, Vector3};
use opspace_model::model::rotation_z_to;
use opspace_model::{Inertia, Joint, JointKind, Limits, MimicConstraint, Placement};
use pyo3::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Types of joints, as MuJoCo numbers them.
const SLIDE: usize = 2;
const HINGE: usize = 3;

/// Types of equalities, as MuJoCo numbers them.
const CONNECT: usize = 0;
const WELD: usize = 1;
const JOINT: usize = 2;

/// Arrays of a compiled model.
struct Compiled<'a, 'py>(&'a Bound<'py, PyAny>);

impl Compiled<'_, '_> {
    fn attribute(&self, name: &str) -> PyResult<Vec<f64>> {
        let array = self.0.getattr(name).map_err(|_| {
            argument("model", &format!("expected a mujoco.MjModel, which has the attribute '{name}'"))
        })?;
        flat(name, &array)
    }

    fn indices(&self, name: &str) -> PyResult<Vec<usize>> {
        Ok(self.attribute(name)?.into_iter().map(|number| number as usize).collect())
    }

    /// Name of element `index` of a kind: `body`, `joint`, `site`.
    fn name(&self, kind: &str, index: usize) -> PyResult<String> {
        let name: String = self.0.call_method1(kind, (index,))?.getattr("name")?.extract()?;
        Ok(if name.is_empty() { format!("{kind}{index}") } else { name })
    }
}

/// Three numbers of an array.
fn three(numbers: &[f64], index: usize) -> Vector3<f64> {
    Vector3::from_column_slice(&numbers[3 * index..3 * index + 3])
}

/// Rotation of quaternion `index`, w, x, y, z.
fn rotation(numbers: &[f64], index: usize) -> Matrix3<f64> {
    let [w, x, y, z] = [0, 1, 2, 3].map(|k| numbers[4 * index + k]);
    UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)).to_rotation_matrix().into_inner()
}

/// Joint of the robot: its number in the compiled model, and its position there in the reference posture.
struct Kept {
    number: usize,
    reference: f64,
}

/// Reads the robot with these joints, or with all.
///
/// # Errors
/// An object that is no compiled model; joints that it does not have, or that are free or balls; equalities that are not
/// linear in two joints.
pub(crate) fn read(compiled: &Bound<'_, PyAny>, joints: Option<&[String]>) -> PyResult<Model> {
    let compiled = Compiled(compiled);
    let types = compiled.indices("jnt_type")?;
    let names =
        (0..types.len()).map(|number| compiled.name("joint", number)).collect::<PyResult<Vec<_>>>()?;
    if let Some(unknown) = joints.into_iter().flatten().find(|name| !names.contains(name)) {
        return Err(argument(
            "joints",
            &format!("there is no joint '{unknown}'; there are: {}", names.join(", ")),
        ));
    }
    let is_kept = |number: usize| joints.is_none_or(|joints| joints.contains(&names[number]));
    if let Some(number) = (0..types.len()).find(|&number| is_kept(number) && types[number] < SLIDE) {
        let kind = if types[number] == 0 { "free" } else { "a ball" };
        return Err(argument(
            "joints",
            &format!("joint '{}' is {kind}: name the hinges and slides of the robot", names[number]),
        ));
    }
    let mut reader = Reader::new(&compiled, &names, types)?;
    reader.add_bodies(&is_kept)?;
    reader.add_sites()?;
    reader.finish()
}

/// Robot while it is read.
struct Reader<'a, 'b, 'py> {
    compiled: &'a Compiled<'b, 'py>,
    names: &'a [String],
    types: Vec<usize>,
    /// Positions of all joints in the reference posture.
    reference: Vec<f64>,
    model: opspace_model::Model,
    kept: Vec<Kept>,
    friction: Vec<f64>,
    damping: Vec<f64>,
    /// Body of the robot that contains a body of the compiled model, and the pose of the latter there.
    places: Vec<(Option<usize>, Placement)>,
}

impl<'a, 'b, 'py> Reader<'a, 'b, 'py> {
    fn new(compiled: &'a Compiled<'b, 'py>, names: &'a [String], types: Vec<usize>) -> PyResult<Self> {
        let positions = compiled.attribute("qpos0")?;
        let reference = compiled.indices("jnt_qposadr")?.into_iter().map(|place| positions[place]).collect();
        let options = compiled.0.getattr("opt")?;
        let gravity = flat("gravity", &options.getattr("gravity")?)?;
        let name = compiled.0.getattr("names").and_then(|names| names.extract::<Vec<u8>>());
        let name = name.ok().and_then(|names| names.split(|byte| *byte == 0).next().map(<[u8]>::to_vec));
        let name = name.map_or_else(String::new, |name| String::from_utf8_lossy(&name).into_owned());
        let model = opspace_model::Model::new(&name).with_gravity(three(&gravity, 0));
        let places = vec![(None, Placement::identity())];
        let (kept, friction, damping) = (Vec::new(), Vec::new(), Vec::new());
        Ok(Self { compiled, names, types, reference, model, kept, friction, damping, places })
    }

    fn add_bodies(&mut self, is_kept: &dyn Fn(usize) -> bool) -> PyResult<()> {
        let Self { compiled, .. } = *self;
        let (parents, first, count) = (
            compiled.indices("body_parentid")?,
            compiled.attribute("body_jntadr")?,
            compiled.indices("body_jntnum")?,
        );
        let (positions, turns) = (compiled.attribute("body_pos")?, compiled.attribute("body_quat")?);
        let (masses, moments) = (compiled.attribute("body_mass")?, compiled.attribute("body_inertia")?);
        let (centres, axes) = (compiled.attribute("body_ipos")?, compiled.attribute("body_iquat")?);
        let (anchors, directions) = (compiled.attribute("jnt_pos")?, compiled.attribute("jnt_axis")?);
        let dofs = compiled.indices("jnt_dofadr")?;
        let (armature, friction, damping) = (
            compiled.attribute("dof_armature")?,
            compiled.attribute("dof_frictionloss")?,
            compiled.attribute("dof_damping")?,
        );
        let limits = self.limits()?;
        self.model.add_frame(&compiled.name("body", 0)?, None, Placement::identity());
        for body in 1..parents.len() {
            let (mut parent, at_parent) = self.places[parents[body]];
            let own = Placement { rotation: rotation(&turns, body), translation: three(&positions, body) };
            let mut place = at_parent * own;
            let joints = (0..count[body]).map(|k| first[body] as usize + k).filter(|&number| is_kept(number));
            for number in joints {
                let axis = Unit::new_normalize(three(&directions, number));
                let anchor =
                    Placement { rotation: rotation_z_to(&axis), translation: three(&anchors, number) };
                let reference = self.reference[number];
                let is_slide = self.types[number] == SLIDE;
                // MuJoCo's joint is at the pose of the body where it has its reference position.
                let back = if is_slide {
                    Placement::from_rpy([0.0; 3], [0.0, 0.0, -reference])
                } else {
                    Placement::from_rpy([0.0, 0.0, -reference], [0.0; 3])
                };
                let (kind, limits) = limits[number];
                let joint = Joint { name: self.names[number].clone(), kind, limits };
                let added = self.model.add_body(parent, place * anchor * back, joint, Inertia::zero());
                self.model.set_rotor_inertia(self.kept.len(), armature[dofs[number]]);
                self.friction.push(friction[dofs[number]]);
                self.damping.push(damping[dofs[number]]);
                self.kept.push(Kept { number, reference });
                (parent, place) = (Some(added), anchor.inverse());
            }
            self.places.push((parent, place));
            self.model.add_frame(&compiled.name("body", body)?, parent, place);
            if let Some(moved) = parent {
                let turn = rotation(&axes, body);
                let rotational = turn * Matrix3::from_diagonal(&three(&moments, body)) * turn.transpose();
                let inertia = Inertia { mass: masses[body], com: three(&centres, body), rotational };
                let sum = self.model.bodies()[moved].inertia + place.act_inertia(&inertia);
                self.model.set_inertia(moved, sum);
            }
        }
        Ok(())
    }

    /// Kinds and limits of all joints.
    fn limits(&self) -> PyResult<Vec<(JointKind, Limits)>> {
        let (is_limited, ranges) =
            (self.compiled.indices("jnt_limited")?, self.compiled.attribute("jnt_range")?);
        let forces_limited = self.compiled.indices("jnt_actfrclimited")?;
        let forces = self.compiled.attribute("jnt_actfrcrange")?;
        let of = |number: usize| {
            let is_limited = is_limited[number] != 0;
            let (lower, upper) = if is_limited {
                (ranges[2 * number], ranges[2 * number + 1])
            } else {
                (f64::NEG_INFINITY, f64::INFINITY)
            };
            let effort = if forces_limited[number] != 0 {
                forces[2 * number].abs().max(forces[2 * number + 1].abs())
            } else {
                f64::INFINITY
            };
            let kind = match (self.types[number], is_limited) {
                (HINGE, true) => JointKind::Revolute,
                (HINGE, false) => JointKind::Continuous,
                _ => JointKind::Prismatic,
            };
            (kind, Limits { lower, upper, velocity: f64::INFINITY, effort })
        };
        Ok((0..self.types.len()).map(of).collect())
    }

    fn add_sites(&mut self) -> PyResult<()> {
        let bodies = self.compiled.indices("site_bodyid")?;
        let (positions, turns) =
            (self.compiled.attribute("site_pos")?, self.compiled.attribute("site_quat")?);
        for (site, body) in bodies.into_iter().enumerate() {
            let name = self.compiled.name("site", site)?;
            let (parent, place) = self.places[body];
            let own = Placement { rotation: rotation(&turns, site), translation: three(&positions, site) };
            // A body of the same name is the frame of that name.
            let name = if self.model.frame_id(&name).is_ok() { format!("{name} (site)") } else { name };
            self.model.add_frame(&name, parent, place * own);
        }
        Ok(())
    }

    /// Couples and locks joints as the equalities say.
    fn finish(self) -> PyResult<Model> {
        let (mut locked, mut followers) = (Vec::new(), BTreeMap::new());
        let (types, first, second) = (
            self.compiled.indices("eq_type")?,
            self.compiled.attribute("eq_obj1id")?,
            self.compiled.attribute("eq_obj2id")?,
        );
        let numbers = self.compiled.attribute("eq_data")?;
        // Versions of MuJoCo differ in the numbers of an equality.
        let width = numbers.len() / types.len().max(1);
        let is_active = self.compiled.indices("eq_active0")?;
        let objects = match types.iter().any(|kind| *kind == CONNECT || *kind == WELD) {
            true => self.compiled.indices("eq_objtype")?,
            false => Vec::new(),
        };
        let index = |number: f64| self.kept.iter().position(|kept| kept.number as f64 == number);
        for (place, kind) in types.iter().enumerate().filter(|(place, _)| is_active[*place] != 0) {
            match *kind {
                JOINT => {
                    let Some(follower) = index(first[place]) else { continue };
                    let at = &numbers[width * place..][..5];
                    let leader = index(second[place]);
                    if at[2..].iter().any(|coefficient| *coefficient != 0.0) && leader.is_some() {
                        let name = &self.names[self.kept[follower].number];
                        let message = format!("the equality of joint '{name}' is not linear");
                        return Err(refused(message, Some("deactivate it, or lock the joint by `joints`")));
                    }
                    let own = self.kept[follower].reference;
                    match leader {
                        Some(leader) => {
                            let offset = own + at[0] - at[1] * self.kept[leader].reference;
                            followers.insert(follower, MimicConstraint { leader, ratio: at[1], offset });
                        }
                        None => locked.push((follower, own + at[0])),
                    }
                }
                CONNECT | WELD => {
                    let sites = self.compiled.indices("site_bodyid")?;
                    // mjOBJ_SITE is 6.
                    let body = |id: f64| if objects[place] == 6 { sites[id as usize] } else { id as usize };
                    if self.places[body(first[place])].0 != self.places[body(second[place])].0 {
                        let message = "an equality closes a loop of bodies, which a tree of joints is not";
                        return Err(refused(message, Some("deactivate it, or lock its joints by `joints`")));
                    }
                }
                _ => {}
            }
        }
        let Self { mut model, mut friction, mut damping, .. } = self;
        let refuse = |error: opspace_model::ReduceError| refused(error.to_string(), None);
        let followers: Vec<_> = followers.into_iter().collect();
        let removed: Vec<usize> =
            locked.iter().map(|(joint, _)| *joint).chain(followers.iter().map(|(joint, _)| *joint)).collect();
        // Joints that lock or follow keep their numbers until all are coupled.
        let names: Vec<String> = model.joints().iter().map(|joint| joint.name.clone()).collect();
        if !followers.is_empty() {
            model = model.with_mimic_constraints(&followers).map_err(refuse)?;
        }
        let left = |joint: usize| model.joint(&names[joint]).ok();
        let locked: Vec<(usize, f64)> =
            locked.iter().filter_map(|(joint, at)| Some((left(*joint)?, *at))).collect();
        if !locked.is_empty() {
            model = model.with_locked_joints(&locked).map_err(refuse)?;
        }
        for values in [&mut friction, &mut damping] {
            let mut joint = 0..values.len();
            values.retain(|_| joint.next().is_some_and(|joint| !removed.contains(&joint)));
        }
        Ok(Model::new(Arc::new(model), friction, damping))
    }
}

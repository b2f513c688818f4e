//! Loads of force sensors that follow from the links and tools beyond them.
//!
//! Beyond a sensor are the links below its frame in the URDF, the tools on them, and the tools on the frame itself: a gripper
//! on the flange at which the sensor measures. The link of the frame is on the side of the arm.

use crate::files::robot::RobotFile;
use crate::files::robot_part::urdf_error;
use crate::files::source::{FileError, Source};
use crate::suggest::list;
use crate::text::format_short;
use nalgebra::Vector3;
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_loop::SensorLoadParameters;
use opspace_model::{FrameId, Inertia, Model, Placement, UrdfJoint, urdf_joints};
use opspace_sim::parameters::SensorLoadParameters as TrueLoad;
use std::collections::BTreeMap;

/// Differences up to which two loads are the same: files state few digits.
const MASS_TOLERANCE: f64 = 1e-3;
const CENTRE_TOLERANCE_M: f64 = 1e-4;

/// Links and tools with mass beyond a sensor.
struct Beyond {
    /// What they are, for messages.
    names: Vec<String>,
    /// Their mass and centre; `None` if a joint moves some of them.
    load: Option<(f64, Vector3<f64>)>,
}

/// Sets the loads that the file of a robot does not state: those of what is beyond the sensors, also of the simulated ones.
/// Returns, for each sensor without a stated load whose load does not follow, what joints move beyond it.
///
/// # Errors
/// A stated load that is not that of the links and tools beyond the sensor.
pub(crate) fn set_loads(
    (source, urdf): (&Source, &Source),
    model: &Model,
    link_inertias: &[Inertia],
    file: &mut RobotFile,
) -> Result<BTreeMap<String, Vec<String>>, FileError> {
    let mut unknown = BTreeMap::new();
    if file.force_sensor.is_empty() {
        return Ok(unknown);
    }
    let joints = urdf_joints(urdf.text()).map_err(|error| urdf_error(urdf, &error))?;
    let names: Vec<String> = file.force_sensor.keys().cloned().collect();
    for name in names {
        let beyond = beyond(model, link_inertias, &joints, file, &file.force_sensor[&name].frame);
        let stated = file.force_sensor[&name].load;
        let Some((mass, centre)) = beyond.load else {
            if stated.is_none() {
                unknown.insert(name, beyond.names);
            }
            continue;
        };
        let (Ok(mass_kg), Ok(positive)) = (NonNegative::try_from(mass), Positive::try_from(mass)) else {
            continue;
        };
        match stated {
            Some(stated) => check_stated(source, &name, &stated, (mass, &centre), &beyond.names)?,
            None => {
                let load = SensorLoadParameters { mass_kg, centre_m: centre.into() };
                file.force_sensor.entry(name.clone()).and_modify(|sensor| sensor.load = Some(load));
            }
        }
        let Some(simulated) = &mut file.simulated else { continue };
        let true_kg = Positive::try_from(positive.get() * simulated.true_over_nominal.inertia.get());
        if let (Some(sensor), Ok(mass_kg)) = (simulated.force_sensor.get_mut(&name), true_kg) {
            sensor.load.get_or_insert(TrueLoad { mass_kg, centre_m: centre.into() });
        }
    }
    Ok(unknown)
}

/// Refuses a stated load that differs from that of the links and tools beyond the sensor.
fn check_stated(
    source: &Source,
    name: &str,
    stated: &SensorLoadParameters,
    (mass, centre): (f64, &Vector3<f64>),
    beyond: &[String],
) -> Result<(), FileError> {
    let same_mass = (stated.mass_kg.get() - mass).abs() <= MASS_TOLERANCE * mass;
    if same_mass && (Vector3::from(stated.centre_m) - centre).amax() <= CENTRE_TOLERANCE_M {
        return Ok(());
    }
    let text = |mass: f64, centre: [f64; 3]| {
        format!("{} kg at [{}] m", format_short(mass), centre.map(format_short).join(", "))
    };
    let message = format!(
        "`force_sensor.{name}.load` is {}, but {} beyond the sensor {} {}, in its axes",
        text(stated.mass_kg.get(), stated.centre_m),
        list(beyond.iter().map(String::as_str)),
        if beyond.len() == 1 { "has" } else { "have" },
        text(mass, (*centre).into()),
    );
    let help = Some(
        "remove `load`, which is then that of the links and tools, or correct one of the two".to_owned(),
    );
    Err(FileError::at_key(source, ["force_sensor", name, "load"], message, help))
}

/// Finds the links and tools with mass beyond the frame of a sensor.
fn beyond(
    model: &Model,
    link_inertias: &[Inertia],
    joints: &[UrdfJoint],
    file: &RobotFile,
    sensor: &str,
) -> Beyond {
    let mut found = Beyond { names: Vec::new(), load: Some((0.0, Vector3::zeros())) };
    let Ok(sensor_frame) = model.frame_id(sensor) else { return found };
    let mut below = vec![sensor];
    let mut next = 0;
    let mut moment = Vector3::zeros();
    while let Some(&parent) = below.get(next) {
        next += 1;
        let links = joints.iter().filter(|joint| joint.parent == parent).map(|joint| joint.child.as_str());
        let tools = file.tool.iter().filter(|(_, tool)| tool.on == parent);
        // Tools have the inertia of a payload in the axes of the link on which they are.
        let tools =
            tools.map(|(name, tool)| (name.as_str(), parent, tool.inertia(), format!("tool '{name}'")));
        let links = links
            .map(|link| (link, link, link_inertia(model, link_inertias, link), format!("link '{link}'")));
        for (name, frame, inertia, description) in links.chain(tools) {
            below.push(name);
            let Ok(frame) = model.frame_id(frame) else { continue };
            if inertia.mass == 0.0 {
                continue;
            }
            found.names.push(description);
            found.load = match (found.load, pose_in(model, sensor_frame, frame)) {
                (Some((mass, _)), Some(pose)) => {
                    moment += pose.act_point(&inertia.com) * inertia.mass;
                    let mass = mass + inertia.mass;
                    Some((mass, moment / mass))
                }
                _ => None,
            };
        }
    }
    found
}

/// Inertia of a link in its own axes.
fn link_inertia(model: &Model, link_inertias: &[Inertia], link: &str) -> Inertia {
    let index = model.frames().iter().position(|frame| frame.name == link);
    index.and_then(|index| link_inertias.get(index)).copied().unwrap_or_else(Inertia::zero)
}

/// Pose of a frame in the axes of a sensor on the same body; `None` if a joint is between them.
fn pose_in(model: &Model, sensor: FrameId, frame: FrameId) -> Option<Placement> {
    let [sensor, frame] = [sensor, frame].map(|frame| model.frame(frame));
    (sensor.body == frame.body).then(|| sensor.placement.inverse() * frame.placement)
}

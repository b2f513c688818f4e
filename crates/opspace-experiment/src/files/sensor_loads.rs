//! Loads of force sensors that follow from the links and tools beyond them.
//!
//! Beyond a sensor are the links below its frame in the URDF, the tools on them, and the tools on the frame itself: a gripper
//! on the flange at which the sensor measures. The link of the frame is on the side of the arm.

use crate::files::robot_part::urdf_error;
use crate::files::source::{FileError, Source};
use crate::files::tool::ToolFile;
use crate::suggest::list;
use crate::text::format_short;
use nalgebra::Vector3;
use opspace_backend::quantity::NonNegative;
use opspace_loop::SensorLoadParameters;
use opspace_model::{FrameId, Inertia, Model, Placement, UrdfJoint, urdf_joints};
use std::collections::BTreeMap;

/// Differences up to which two loads are the same: files state few digits.
const MASS_TOLERANCE: f64 = 1e-3;
const CENTRE_TOLERANCE_M: f64 = 1e-4;

/// Links and tools with mass beyond a sensor.
struct Beyond {
    /// Descriptions for messages.
    names: Vec<String>,
    /// Their mass and centre; `None` if a joint moves some of them.
    load: Option<(f64, Vector3<f64>)>,
}

/// Force sensor of a robot file.
pub(crate) struct Sensor<'a> {
    pub(crate) name: &'a str,
    pub(crate) frame: &'a str,
    pub(crate) stated: Option<SensorLoadParameters>,
}

/// Loads of links and tools beyond force sensors, by the names of the sensors.
#[derive(Default)]
pub(crate) struct SensorLoads {
    /// Mass (kg) above zero and centre in the axes of the sensor (m).
    pub(crate) known: BTreeMap<String, SensorLoadParameters>,
    /// Links and tools beyond sensors without a stated load, some of which joints move.
    pub(crate) unknown: BTreeMap<String, Vec<String>>,
}

/// Finds what is beyond the sensors of a robot.
///
/// # Errors
/// A stated load that is not that of the links and tools beyond the sensor.
pub(crate) fn sensor_loads(
    (source, urdf): (&Source, &Source),
    (model, link_inertias): (&Model, &[Inertia]),
    tools: &BTreeMap<String, ToolFile>,
    sensors: &[Sensor<'_>],
) -> Result<SensorLoads, FileError> {
    let mut loads = SensorLoads::default();
    if sensors.is_empty() {
        return Ok(loads);
    }
    let joints = urdf_joints(urdf.text()).map_err(|error| urdf_error(urdf, &error))?;
    for Sensor { name, frame, stated } in sensors {
        let beyond = beyond((model, link_inertias), &joints, tools, frame);
        let Some((mass, centre)) = beyond.load else {
            if stated.is_none() {
                loads.unknown.insert((*name).to_owned(), beyond.names);
            }
            continue;
        };
        let Some(mass_kg) = NonNegative::try_from(mass).ok().filter(|mass| mass.get() > 0.0) else {
            continue;
        };
        if let Some(stated) = stated {
            check_stated(source, name, stated, (mass, &centre), &beyond.names)?;
        }
        loads.known.insert((*name).to_owned(), SensorLoadParameters { mass_kg, centre_m: centre.into() });
    }
    Ok(loads)
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
    (model, link_inertias): (&Model, &[Inertia]),
    joints: &[UrdfJoint],
    tools: &BTreeMap<String, ToolFile>,
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
        let on_it = tools.iter().filter(|(_, tool)| tool.on == parent);
        // Tools have the inertia of a payload in the axes of the link on which they are.
        let on_it =
            on_it.map(|(name, tool)| (name.as_str(), parent, tool.inertia(), format!("tool '{name}'")));
        let links = links
            .map(|link| (link, link, link_inertia(model, link_inertias, link), format!("link '{link}'")));
        for (name, frame, inertia, description) in links.chain(on_it) {
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

//! Tools and loads mounted on a robot: mass properties and the frame at the tip.

use crate::files::body::{BodyNumbers, check_body, check_numbers};
use crate::files::source::{FileError, Source};
use crate::suggest::choices;
use nalgebra::{Matrix3, Vector3};
use opspace_backend::quantity::{NonNegative, exactly};
use opspace_model::{Inertia, Model, Placement};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::BTreeMap;

/// Rigid body fixed to a link, with a frame of the same name that tasks can control.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct ToolFile {
    /// URDF link on which the tool is mounted.
    pub on: String,
    /// Origin of the tool's frame (its tip) in the axes of that link, m.
    #[serde(default, deserialize_with = "exactly")]
    pub xyz_m: [f64; 3],
    /// Orientation of the tool's frame relative to that link: roll, pitch and yaw as in a URDF, rad.
    #[serde(default, deserialize_with = "exactly")]
    pub rpy_rad: [f64; 3],
    /// Mass, kg; with zero the tool is only a frame.
    #[serde(default)]
    pub mass_kg: NonNegative,
    /// Centre of mass relative to the link's origin, in the link's axes, m.
    #[serde(default, deserialize_with = "exactly")]
    pub com_m: [f64; 3],
    /// Inertia xx, xy, xz, yy, yz, zz about the centre of mass, in the link's axes, kg m²; zeros are those of a point mass.
    #[serde(default, deserialize_with = "exactly")]
    pub inertia_kg_m2: [f64; 6],
}

impl ToolFile {
    /// Inertia in the axes of the link.
    pub(crate) fn inertia(&self) -> Inertia {
        let [xx, xy, xz, yy, yz, zz] = self.inertia_kg_m2;
        Inertia {
            mass: self.mass_kg.get(),
            com: Vector3::from(self.com_m),
            rotational: Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz),
        }
    }
}

/// Mounts all tools of a robot file: adds their inertia to the bodies of their links, and a frame for each tool.
pub(crate) fn mount(
    source: &Source,
    model: &mut Model,
    tools: &BTreeMap<String, ToolFile>,
) -> Result<(), FileError> {
    for (name, tool) in tools {
        let refuse = |key: &str, message: String, help: Option<String>| {
            Err(FileError::at_key(source, ["tool", name, key], message, help))
        };
        let parent = match model.frame_id(&tool.on) {
            Ok(frame) => frame,
            Err(unknown) => {
                let help = Some(choices(&unknown.name, &unknown.known));
                return refuse("on", format!("the URDF has no link '{}'", unknown.name), help);
            }
        };
        if model.frame_id(name).is_ok() {
            let message = format!("the robot already has a link or tool '{name}'");
            return Err(FileError::at_key(
                source,
                ["tool", name],
                message,
                Some("give it another name".to_owned()),
            ));
        }
        let path = ["tool", name.as_str()];
        check_numbers(source, path, &[("xyz_m", &tool.xyz_m), ("rpy_rad", &tool.rpy_rad)])?;
        let ToolFile { com_m, inertia_kg_m2, .. } = *tool;
        check_body(source, path, &BodyNumbers { mass_kg: tool.mass_kg.get(), com_m, inertia_kg_m2 })?;
        let offset = Placement::from_rpy(tool.rpy_rad, tool.xyz_m);
        let frame = model.add_frame_on(name, parent, offset);
        model.set_payload(frame, offset.inverse().act_inertia(&tool.inertia()));
    }
    Ok(())
}

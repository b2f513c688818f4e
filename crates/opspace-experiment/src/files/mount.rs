//! Mounting of a robot: the placement of its base in the world, for arms on a wall, a ceiling or a slope.

use crate::files::source::{FileError, Source};
use crate::text::format_short;
use opspace_backend::quantity::exactly;
use opspace_model::Placement;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::f64::consts::TAU;

/// Placement of the base of the robot in the world, whose gravity is along -z. Poses, walls, obstacles and forces of tasks
/// are in the world.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct MountFile {
    /// Position of the base (the root link of the URDF) in the world, m.
    #[serde(default, deserialize_with = "exactly")]
    pub xyz_m: [f64; 3],
    /// Orientation of the base in the world: roll, pitch and yaw as in a URDF, rad. `[3.14159265, 0, 0]` hangs an arm from the ceiling.
    #[serde(default, deserialize_with = "exactly")]
    pub rpy_rad: [f64; 3],
}

/// Largest coordinate, m; a larger one indicates a mistake in a unit.
const MAX_COORDINATE_M: f64 = 1e4;

impl MountFile {
    /// Returns a mounting with the base at `xyz_m` (m), rotated by `rpy_rad` (rad).
    #[must_use]
    pub const fn new(xyz_m: [f64; 3], rpy_rad: [f64; 3]) -> Self {
        Self { xyz_m, rpy_rad }
    }

    /// Pose of the base in the world.
    #[must_use]
    pub fn placement(&self) -> Placement {
        Placement::from_rpy(self.rpy_rad, self.xyz_m)
    }

    /// Mounting as an inline table of TOML.
    #[must_use]
    pub fn toml(&self) -> String {
        format!("{{ xyz_m = {:?}, rpy_rad = {:?} }}", self.xyz_m, self.rpy_rad)
    }

    /// Describes the placement, with the direction of gravity in the axes of the base.
    #[must_use]
    pub fn description(&self) -> String {
        let down = -self.placement().rotation.row(2).transpose();
        // Without the rounding of right angles.
        let rounded = |x: f64| (x * 1e4).round() / 1e4 + 0.0;
        let list = |numbers: [f64; 3]| numbers.map(format_short).join(", ");
        format!(
            "mounted with its base at [{}] m, rotated by [{}] rad: gravity is along [{}] in the axes of the base",
            list(self.xyz_m),
            list(self.rpy_rad),
            list(down.map(rounded).into())
        )
    }

    /// Checks the numbers of a robot file.
    pub(crate) fn check(&self, source: &Source) -> Result<(), FileError> {
        match self.mistake() {
            None => Ok(()),
            Some((key, message, help)) => {
                Err(FileError::at_key(source, ["mount", key], message, Some(help.to_owned())))
            }
        }
    }

    /// Key of a number that is not finite or indicates a mistake in a unit, with a message and a remedy.
    #[must_use]
    pub fn mistake(&self) -> Option<(&'static str, String, &'static str)> {
        if let Some(angle) = self.rpy_rad.iter().find(|angle| !(-TAU..=TAU).contains(*angle)) {
            let message = format!("an angle of {angle} rad is more than a turn");
            return Some(("rpy_rad", message, "give angles in rad: 90 degrees are 1.570796"));
        }
        let range = -MAX_COORDINATE_M..=MAX_COORDINATE_M;
        let coordinate = self.xyz_m.iter().find(|coordinate| !range.contains(*coordinate))?;
        let message = format!("{coordinate:e} m is too far from the origin of the world");
        Some(("xyz_m", message, "give metres"))
    }
}

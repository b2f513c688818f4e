//! Scene that viewers of a log show beside the links: URDF, walls, capsules and obstacles, forces, and the frames of tasks.

use crate::files::collision::{HalfSpaceObstacle, ObstacleFile};
use crate::run::experiment::Experiment;
use nalgebra::Vector3;
use opspace_backend::signal_names::{self, FORCE, TICK_CHANNEL, TRUTH_CHANNEL, WRENCH};
use opspace_control::TaskParameters;
use opspace_log::{ForceArrow, Scene, SceneCapsule, Wall};
use opspace_model::collision::{Capsule, CollisionShape, find_mesh};
use opspace_sim::EnvironmentObjectParameters;
use std::fs;
use std::path::Path;

impl Experiment {
    /// Returns the scene of a log of this experiment.
    pub(crate) fn viewer_scene(&self) -> Scene {
        let file = &self.task().file;
        let sets = self.task().events.iter().map(|event| &event.task);
        let relative = |(name, task): (&String, &TaskParameters)| match task {
            TaskParameters::Cartesian(task) => Some((name.clone(), task.relative_to.clone()?)),
            _ => None,
        };
        let wall = |(name, object): (&String, &EnvironmentObjectParameters)| match object {
            EnvironmentObjectParameters::Wall(wall) => {
                Some(Wall { name: name.clone(), point_m: wall.point_m, normal: wall.normal })
            }
            EnvironmentObjectParameters::Hole(hole) => {
                Some(Wall { name: name.clone(), point_m: hole.point_m, normal: hole.normal })
            }
            _ => None,
        };
        let links = self.robot().capsules().iter().map(|capsule| SceneCapsule {
            name: capsule.name.clone(),
            frame: Some(capsule.link.clone()),
            start_m: capsule.start_m,
            end_m: capsule.end_m,
            radius_m: capsule.radius_m,
        });
        // Half a metre of it to either side; it has no ends.
        let cylinder = |(name, object): (&String, &EnvironmentObjectParameters)| match object {
            EnvironmentObjectParameters::Cylinder(cylinder) => {
                let half = Vector3::from(cylinder.axis).normalize() * 0.5;
                let point = Vector3::from(cylinder.point_m);
                Some(SceneCapsule {
                    name: name.clone(),
                    frame: None,
                    start_m: (point - half).into(),
                    end_m: (point + half).into(),
                    radius_m: cylinder.radius_m.get(),
                })
            }
            _ => None,
        };
        let obstacle = |(name, obstacle): (&String, &ObstacleFile)| match obstacle.shape() {
            CollisionShape::Capsule(Capsule { start_m, end_m, radius_m }) => Some(SceneCapsule {
                name: name.clone(),
                frame: None,
                start_m: start_m.into(),
                end_m: end_m.into(),
                radius_m,
            }),
            CollisionShape::HalfSpace(_) => None,
        };
        let plane = |(name, obstacle): (&String, &ObstacleFile)| match obstacle {
            ObstacleFile::HalfSpace(HalfSpaceObstacle { point_m, normal, .. }) => {
                Some(Wall { name: name.clone(), point_m: *point_m, normal: *normal })
            }
            _ => None,
        };
        let contacts = file.environment.iter().map(|(name, object)| ForceArrow {
            channel: TRUTH_CHANNEL.to_owned(),
            signal: signal_names::of(name, FORCE),
            frame: object.frame().to_owned(),
        });
        let sensors = self.robot().file.force_sensor.iter().map(|(name, sensor)| ForceArrow {
            channel: TICK_CHANNEL.to_owned(),
            signal: signal_names::of(name, WRENCH),
            frame: sensor.frame.clone(),
        });
        let urdf = &self.robot().urdf;
        Scene {
            robot_description: Some(with_mesh_places(urdf.text(), Path::new(urdf.name()))),
            relative_to: std::iter::once(&file.task).chain(sets).flatten().filter_map(relative).collect(),
            walls: file
                .environment
                .iter()
                .filter_map(wall)
                .chain(file.obstacle.iter().filter_map(plane))
                .collect(),
            capsules: links
                .chain(file.environment.iter().filter_map(cylinder))
                .chain(file.obstacle.iter().filter_map(obstacle))
                .collect(),
            forces: contacts.chain(sensors).collect(),
        }
    }
}

/// Replaces the file names of meshes that are relative to the URDF, or to a package in whose folder the URDF is, by
/// `file://` and their absolute path, if there is such a file: a viewer does not know where the URDF was. The URDF that is
/// attached to the log stays as it is.
fn with_mesh_places(text: &str, urdf: &Path) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(mesh) = rest.find("<mesh") {
        let end = rest[mesh..].find('>').map_or(rest.len(), |end| mesh + end);
        let element = &rest[mesh..end];
        out += &rest[..mesh];
        out += &place_of_mesh(element, urdf).unwrap_or_else(|| element.to_owned());
        rest = &rest[end..];
    }
    out + rest
}

/// Returns the element with the place of its file; `None` if it stays as it is.
fn place_of_mesh(element: &str, urdf: &Path) -> Option<String> {
    let name = element.find("filename")?;
    let quote = name + element[name..].find(['"', '\''])?;
    let mark = element[quote..].chars().next()?;
    let length = element[quote + 1..].find(mark)?;
    let value = &element[quote + 1..quote + 1 + length];
    let path = fs::canonicalize(find_mesh(value, Some(urdf))?).ok()?;
    Some(format!("{}file://{}{}", &element[..=quote], path.display(), &element[quote + 1 + length..]))
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;

    /// Checks that relative names and those of a package become absolute, and that all other text stays.
    #[test]
    fn meshes_are_found_from_anywhere() {
        let folder = tempfile::tempdir().unwrap();
        let root = fs::canonicalize(folder.path()).unwrap();
        let package = root.join("my_arm");
        fs::create_dir_all(package.join("urdf")).unwrap();
        fs::write(package.join("hand.stl"), "solid").unwrap();
        let urdf = package.join("urdf/arm.urdf");
        let shown = |name: &str| {
            with_mesh_places(&format!("<a/><mesh scale='1 1 1' filename=\"{name}\"/><b/>"), &urdf)
        };
        let place =
            format!("<a/><mesh scale='1 1 1' filename=\"file://{}/hand.stl\"/><b/>", package.display());
        assert_eq!(shown("../hand.stl"), place);
        assert_eq!(shown("package://my_arm/hand.stl"), place);
        for kept in ["package://other/hand.stl", "missing.stl", "https://example.com/hand.stl"] {
            assert!(shown(kept).contains(&format!("\"{kept}\"")), "{}", shown(kept));
        }
        for text in ["<robot/>", "<mesh", "<mesh filename=\"a", "<mesh/>"] {
            assert_eq!(with_mesh_places(text, &urdf), text);
        }
    }
}

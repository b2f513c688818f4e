//! Scene that viewers of a log show beside the links: URDF, walls, capsules and obstacles, forces, and the frames of tasks.

use crate::files::collision::{HalfSpaceObstacle, ObstacleFile};
use crate::files::experiment_file::ExperimentFile;
use crate::files::source::parse;
use crate::run::experiment::Experiment;
use nalgebra::Vector3;
use opspace_backend::signal_names::{self, FORCE, TICK_CHANNEL, TRUTH_CHANNEL, WRENCH};
use opspace_control::TaskParameters;
use opspace_log::{ForceArrow, ObjectShape, Scene, SceneCapsule, SceneObject, Wall};
use opspace_model::collision::{Capsule, CollisionShape, find_mesh};
use opspace_sim::{EnvironmentObjectParameters, HeldObjectParameters};
use std::f64::consts::PI;
use std::fs;
use std::path::Path;

/// Density of a mass that hangs at the arm.
const STEEL_KG_PER_M3: f64 = 7800.0;

/// Least size of an object that is seen, m: that of a thin rod.
const THINNEST_M: f64 = 0.01;

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
            objects: self.scene_objects(),
        }
    }

    /// Objects that the robot holds: those of an experiment with several robots, as boxes with their mass and inertia, and
    /// masses that hang at it, as balls of steel.
    #[must_use]
    pub fn scene_objects(&self) -> Vec<SceneObject> {
        let file = self.membership().and_then(|member| parse::<ExperimentFile>(&member.experiment).ok());
        let robot = self.membership().map_or("", |member| member.robot.as_str());
        let held = file.into_iter().flat_map(|file| file.objects);
        let held = held.filter(|(_, object)| object.grip.iter().any(|grip| grip.robot == robot));
        let held = held.map(|(name, object)| SceneObject { name, shape: ObjectShape::Box(box_of(&object)) });
        let masses = self.task().file.environment.iter().filter_map(|(name, object)| match object {
            EnvironmentObjectParameters::Mass(mass) => {
                let volume_m3 = mass.mass_kg.get() / STEEL_KG_PER_M3;
                let shape = ObjectShape::Ball((6.0 * volume_m3 / PI).cbrt());
                Some(SceneObject { name: name.clone(), shape })
            }
            _ => None,
        });
        held.chain(masses).collect()
    }
}

/// Size of the box (m) with the mass and the moments of inertia of an object.
fn box_of(object: &HeldObjectParameters) -> [f64; 3] {
    let moments = object.inertia_kg_m2.map(opspace_backend::quantity::Positive::get);
    let sum: f64 = moments.iter().sum();
    // Each moment is that of the squares of the two other sides: m/12 (b² + c²).
    moments.map(|own| (6.0 * (sum - 2.0 * own) / object.mass_kg.get()).max(0.0).sqrt().max(THINNEST_M))
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

    /// Compared: the moments of inertia of the box, m/12 (b² + c²), and those of the object.
    #[test]
    fn box_has_the_inertia_of_its_object() {
        let text = "mass_kg = 1.5\ninertia_kg_m2 = [0.02, 0.015, 0.012]\ngrip = []";
        let object: HeldObjectParameters = toml::from_str(text).unwrap();
        let [a, b, c] = box_of(&object).map(|side| side * side * 1.5 / 12.0);
        for (computed, stated) in [(b + c, 0.02), (a + c, 0.015), (a + b, 0.012)] {
            assert!((computed - stated).abs() < 8.0 * f64::EPSILON * stated, "{computed} {stated}");
        }
        let rod = "mass_kg = 1.0\ninertia_kg_m2 = [0.014, 0.0001, 0.014]\ngrip = []";
        let [x, y, z] = box_of(&toml::from_str(rod).unwrap());
        assert!(y > 0.4 && x == z && x > THINNEST_M / 2.0);
    }

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

//! Robot files.

use crate::edits::{apply, edited};
use crate::inputs::for_each_input;
use crate::limits::Target;
use crate::messages::{check_error, check_model};
use crate::{CORPUS, files, text};
use opspace_experiment::files::origin::Kind;
use opspace_experiment::{RobotDefinition, Source};

/// Most memory for one file, bytes.
const MOST_BYTES: usize = 64 << 20;

/// Robots of the repository.
pub const ROBOTS: [&str; 4] = ["asimo-arm", "panda", "planar-2-link", "ur5e"];

/// An error names the robot file or the URDF. An accepted robot has a drive for each joint, with positive limits, and
/// as many servos as joints, or none.
#[test]
#[ignore = "a fuzz target, which runs for a minute or longer: .ci/run fuzz"]
fn robot() {
    let mut seeds: Vec<(String, String)> = Vec::new();
    for robot in ROBOTS {
        seeds.push((
            text(&format!("robots/{robot}/robot.toml")),
            text(&format!("robots/{robot}/{robot}.urdf")),
        ));
    }
    for path in files(CORPUS, ".robot.toml") {
        seeds.push((text(&path), text("robots/planar-2-link/planar-2-link.urdf")));
    }
    let texts: Vec<&str> = seeds.iter().map(|(robot, _)| robot.as_str()).collect();
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("robot.toml");
    let target = Target::new("robot", MOST_BYTES);
    for_each_input(edited(seeds.len()), 1000, |(seed, edits)| {
        let bytes = apply(&texts, *seed, edits);
        target.check(&bytes, edits.is_empty(), || {
            // Reading from the disk refuses what is not UTF-8.
            let source = if std::str::from_utf8(&bytes).is_ok() {
                Source::new("robot.toml", String::from_utf8_lossy(&bytes))
            } else {
                std::fs::write(&file, &bytes).expect("a temporary file");
                let error = Source::read(&file).expect_err("not UTF-8");
                check_error(&error, &[&file.display().to_string()]);
                return false;
            };
            let _ = Kind::of(source.text());
            let urdf = Source::new("robot.urdf", seeds[*seed].1.as_str());
            match RobotDefinition::from_sources(source, urdf) {
                Ok(robot) => {
                    check_robot(&robot);
                    true
                }
                Err(error) => {
                    check_error(&error, &["robot.toml", "robot.urdf"]);
                    false
                }
            }
        });
    });
}

fn check_robot(robot: &RobotDefinition) {
    check_model(&robot.model);
    let n = robot.model.n();
    assert_eq!(robot.joints().len(), n);
    assert!(robot.torque_limits().iter().all(|limit| limit.is_finite() && *limit > 0.0));
    let limits = robot.joint_limits();
    assert!(limits.torque_rate.iter().chain(&limits.acceleration).all(|limit| *limit > 0.0));
    let period_s = robot.profile(None).expect("a default profile").1.period_s();
    let capabilities = robot.capabilities(robot.file.interface.command, period_s);
    assert_eq!(capabilities.joints.len(), n);
    for (name, profile) in &robot.file.profile {
        let (found, _) = robot.profile(Some(name)).expect("a profile");
        assert_eq!(found, name);
        assert!(profile.period_s().is_finite() && profile.period_s() > 0.0, "{profile:?}");
        for count in [
            robot.servos(profile).len(),
            robot.velocity_servos(profile).len(),
            robot.identified(profile).len(),
        ] {
            assert!(count == n || count == 0, "{count} of {n} joints");
        }
    }
    assert_eq!(robot.sensors.len(), robot.file.force_sensor.len() + robot.file.estimated_force.len());
}

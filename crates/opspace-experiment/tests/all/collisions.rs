//! Capsules and obstacles in files: errors, diagnostics, logs without meshes, and runs.

use opspace_backend::CommandKind;
use opspace_experiment::postures::own_body::OwnBody;
use opspace_experiment::postures::posture_at::posture_at;
use opspace_experiment::run::replay::replay;
use opspace_experiment::{
    Code, Experiment, Extensions, FileError, Files, Finding, Progress, RobotDefinition, RunOptions,
};
use opspace_log::Recording;
use opspace_model::collision::{CollisionData, collision_distances};
use opspace_model::{Data, Postures, forward_kinematics, frame_placement};
use opspace_preflight::diagnostics;
use opspace_preflight::start_diagnostics;
use std::io::Cursor;
use std::path::{Path, PathBuf};

fn task(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../tasks/{name}.toml"))
}

fn load(name: &str, settings: &[&str]) -> Result<Experiment, FileError> {
    let settings: Vec<String> = settings.iter().map(|&setting| setting.to_owned()).collect();
    let options = RunOptions { backend: CommandKind::Torque, ..RunOptions::default() };
    Experiment::load(Files::Disk, &task(name), None, options, &settings)
}

/// Checks that mistakes are refused with the names that are allowed.
#[test]
fn mistakes_are_refused() {
    for (setting, wanted) in [
        ("robot.collision.drop=[[\"link5\", \"lnk7\"]]", "of the name 'lnk7'"),
        ("robot.collision.margin_m=-0.01", "not below 0"),
        ("robot.collision.capsule=[{link=\"hand\", start_m=[0,0,0], end_m=[0,0,0], radius_m=0.1}]", "'hand'"),
        (
            "robot.collision.capsule=[{link=\"link7\", start_m=[0,0], end_m=[0,0,0], radius_m=0.1}]",
            "3 values",
        ),
        (
            "robot.collision.capsule=[{link=\"link7\", start_m=[0,0,1e12], end_m=[0,0,0], radius_m=0.1}]",
            "1e9",
        ),
        ("obstacle.ball.sphere.radius_m=0.0", "above 0"),
        ("obstacle.ball.sphere.size_m=0.1", "size_m"),
        ("obstacle.ball.box={size_m=0.1}", "box"),
        ("obstacle.table.half-space.normal=[0,0,0]", "direction"),
        ("obstacle.table.half-space.except=[\"link9\"]", "of the name 'link9'"),
        ("obstacle.link3.sphere={center_m=[1,1,1], radius_m=0.1}", "two capsules or obstacles 'link3'"),
    ] {
        let error = load("panda-obstacles", &[setting]).expect_err(setting).to_string();
        assert!(error.contains(wanted), "{setting}: {error}");
    }
    let settings = ["obstacle.ball.sphere={center_m=[1,1,1], radius_m=0.1}"];
    let error = load("compliant-x", &settings).expect_err("no geometry");
    assert!(error.to_string().contains("has no collision geometry"), "{error}");
    assert!(error.help().is_some_and(|help| help.contains("[collision]")), "{error}");
}

/// Compared: pairs that are kept apart, with and without those that files drop.
#[test]
fn files_drop_pairs() {
    let names = |settings: &[&str]| -> Vec<[String; 2]> {
        let experiment = load("panda-obstacles", settings).unwrap_or_else(|error| panic!("{error}"));
        let geometry = &experiment.kept_distances().expect("[collision]").limits.geometry;
        (0..geometry.pairs().len()).map(|pair| geometry.pair_names(pair).map(str::to_owned)).collect()
    };
    let all = names(&[]);
    let is_of = |pair: &[String; 2], a: &str, b: &str| pair[0].starts_with(a) && pair[1].starts_with(b);
    assert!(all.iter().any(|pair| is_of(pair, "link2", "link7")), "{all:?}");
    assert!(all.iter().any(|pair| is_of(pair, "link7", "ball")), "{all:?}");
    assert!(!all.iter().any(|pair| is_of(pair, "link1", "table")), "{all:?}");
    let fewer =
        names(&["robot.collision.drop=[[\"link2\", \"link7\"]]", "obstacle.ball.sphere.except=[\"link7\"]"]);
    assert!(!fewer.iter().any(|pair| is_of(pair, "link2", "link7") || is_of(pair, "link7", "ball")));
}

/// Checks that a start, a goal and a path in collision are found, and that a free task has no finding.
#[test]
fn collisions_are_predicted() {
    let found = |settings: &[&str]| -> Vec<String> {
        let experiment = load("panda-obstacles", settings).unwrap_or_else(|error| panic!("{error}"));
        let all = diagnostics(&experiment).into_iter();
        all.map(|finding| format!("{}: {}", finding.key(), finding.message))
            .filter(|f| f.contains("apart") || f.contains("deep"))
            .collect()
    };
    let path = found(&[]);
    assert!(path.len() == 1 && path[0].contains(" s first, ") && path[0].contains("'ball'"), "{path:?}");
    let start = found(&["obstacle.ball.sphere.center_m=[0.35, 0.0, 0.55]"]);
    assert!(start.len() == 1 && start[0].starts_with("start_rad: in the start posture"), "{start:?}");
    let goal = found(&["obstacle.ball.sphere.center_m=[0.33, 0.35, 0.5]", "duration_s=2.0"]);
    assert!(goal.len() == 1 && goal[0].contains("at 2 s, "), "{goal:?}");
    assert_eq!(found(&["obstacle.ball.sphere.center_m=[2.0, 0.0, 0.5]"]), Vec::<String>::new());
    assert_eq!(found(&["limits.enforce=false"]), Vec::<String>::new());
}

/// Checks that the diagnostics before a run, which do not follow the references, contain a start in collision.
#[test]
fn start_in_collision_is_found_before_a_run() {
    let codes = |settings: &[&str]| -> Vec<Code> {
        let experiment = load("panda-obstacles", settings).unwrap_or_else(|error| panic!("{error}"));
        start_diagnostics(&Extensions::default(), &experiment).into_iter().map(|found| found.code).collect()
    };
    assert_eq!(codes(&["obstacle.ball.sphere.center_m=[0.35, 0.0, 0.55]"]), [Code::StartInCollision]);
    assert_eq!(codes(&[]), []);
}

/// Checks that a run whose goal is behind an obstacle names the obstacle as the cause, and not limits of joints.
#[test]
fn kept_distances_are_named_as_the_cause() {
    let experiment = load("panda-obstacles", &["obstacle.ball.sphere.center_m=[0.33, 0.35, 0.5]"])
        .unwrap_or_else(|error| panic!("{error}"));
    let result = experiment.run(Cursor::new(Vec::new()), &Progress::default()).expect("a simulation");
    let log = Recording::from_bytes(result.sink.get_ref()).expect("a log");
    let summary = experiment.summary(&log, &result.record, None);
    let all: Vec<&Finding> = summary.findings.iter().collect();
    let names_the_ball = |found: &&Finding| {
        let pairs = &found.causes.kept_distances;
        pairs.iter().any(|pair| pair[1] == "ball") && found.to_string().contains("distance kept between ")
    };
    assert!(all.iter().any(names_the_ball), "{all:?}");
}

/// Compared: the smallest distance of runs with the margin, and of the same runs without limits with zero; and a replay
/// with the run.
#[test]
fn runs_keep_the_margin() {
    for (name, closest) in [("panda-obstacles", 0.025), ("panda-folded", 0.05)] {
        let experiment = load(name, &[]).unwrap_or_else(|error| panic!("{error}"));
        let result = experiment.run(Cursor::new(Vec::new()), &Progress::default()).expect("a simulation");
        let log = Recording::from_bytes(result.sink.get_ref()).expect("a log");
        let summary = experiment.summary(&log, &result.record, None);
        let least = summary.metrics.least_distance_m.expect("a distance");
        assert!((0.018..closest).contains(&least), "{name}: {least} m");
        assert_eq!(summary.faulted, None, "{name}");
        assert!(log.attachment("capsules.json").is_some());
        let again = Experiment::of_log(&log).expect("a complete log");
        assert_eq!(again.kept_distances().map(|d| &d.limits), experiment.kept_distances().map(|d| &d.limits));
        assert_eq!(replay(&again, &log).expect("a replay").differing, 0, "{name}");
    }
}

/// A log has the capsules that were generated from meshes: an experiment that is rebuilt without the meshes has the same
/// ones.
#[test]
fn logs_do_not_need_meshes() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let robots = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../robots/planar-2-link");
    let read = |name: &str| std::fs::read_to_string(robots.join(name)).expect("a file of the project");
    let urdf = read("planar-2-link.urdf");
    let last = urdf.find("</link>").expect("a link with content");
    let mesh = "<collision><geometry><mesh filename=\"link.obj\"/></geometry></collision>";
    std::fs::write(at("planar-2-link.urdf"), format!("{}{mesh}{}", &urdf[..last], &urdf[last..]))
        .expect("written");
    std::fs::write(at("robot.toml"), read("robot.toml") + "\n[collision]\n").expect("written");
    std::fs::write(
        at("link.obj"),
        "v 0 0 0\nv 0.3 0 0\nv 0.3 0.05 0\nv 0 0.05 0.02\nf 1 2 3\nf 1 3 4\nf 1 2 4\n",
    )
    .expect("written");
    let options = RunOptions { backend: CommandKind::Torque, ..RunOptions::default() };
    let experiment = Experiment::load(
        Files::Disk,
        &task("planar-2-link-reach"),
        Some(&at("robot.toml")),
        options,
        &["duration_s=1.0".to_owned()],
    )
    .unwrap_or_else(|error| panic!("{error}"));
    let capsules = experiment.robot().capsules().to_vec();
    let result = experiment.run(Cursor::new(Vec::new()), &Progress::default()).expect("a simulation");
    let log = Recording::from_bytes(result.sink.get_ref()).expect("a log");
    std::fs::remove_file(at("link.obj")).expect("removed");
    let again = Experiment::of_log(&log).expect("a complete log");
    assert_eq!(again.robot().capsules(), capsules);
    // A link with capsules of its own does not need the mesh, which is named as missing.
    let link =
        urdf[..last].rsplit_once("<link name=\"").expect("a link").1.split('"').next().expect("a name");
    let capsule = format!(
        "\n[collision]\n[[collision.capsule]]\nlink = {link:?}\nstart_m = [0.0, 0.0, 0.0]\nend_m = [0.1, 0.0, 0.0]\nradius_m = 0.02\n"
    );
    std::fs::write(at("robot.toml"), read("robot.toml") + &capsule).expect("written");
    let robot = RobotDefinition::load(Files::Disk, folder.path(), &[]).expect("a valid robot");
    let missing =
        robot.capsule_warnings().iter().filter(|warning| warning.code() == "mesh-not-found").count();
    assert_eq!((missing, robot.absent_meshes()), (0, &[(link.to_owned(), "link.obj".to_owned())][..]));
    assert!(capsules.iter().any(|c| format!("{:?}", c.source) == "Mesh"), "{capsules:?}");
}

/// Compared: the least distance of the pairs that a controller keeps apart, in postures that `posture_at` finds without
/// contact, with the robot's margin. Without the margin, some of them are nearer.
#[test]
fn found_postures_keep_the_margin() {
    let experiment = load("panda-folded", &[]).unwrap_or_else(|error| panic!("{error}"));
    let (robot, kept) = (experiment.robot(), experiment.kept_distances().expect("[collision]"));
    let (model, limits) = (&robot.model, &kept.limits);
    let tip = model.frame_id("flange").expect("a link");
    let with_margin = OwnBody::of_robot(robot, 1.0).expect("links that can touch");
    let without = OwnBody::new(model, &robot.urdf, Some(robot.capsules()), 1.0, 0.0).expect("links");
    let (mut data, mut near) = (Data::new(model), CollisionData::new(&limits.geometry));
    let postures = Postures::new(model, 1.0);
    let start = [0.0, -0.8, 0.0, -2.4, 0.0, 1.6, 0.8];
    let mut nearer = [0, 0];
    for sample in 0..60 {
        forward_kinematics(model, &mut data, &postures.posture(sample));
        let goal_m = frame_placement(model, &data, tip).translation.into();
        for (own_body, nearer) in [&with_margin, &without].into_iter().zip(&mut nearer) {
            let mut own_body = own_body.clone();
            let found =
                posture_at(model, "flange", goal_m, None, &start, Some(&mut own_body)).expect("moves");
            if found.contact.is_some() {
                continue;
            }
            forward_kinematics(model, &mut data, &found.q);
            collision_distances(&limits.geometry, model, &data, limits.margin_m, &mut near);
            *nearer += near.near().count();
        }
    }
    assert_eq!(nearer[0], 0, "pairs nearer than the margin");
    assert!(nearer[1] > 0, "the margin changes a posture");
}

//! Player of a run: its data, as the page has them, beside the model and the log.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use crate::run_figures::{load, shown};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use opspace_backend::CommandKind;
use opspace_experiment::metrics::columns::default_columns;
use opspace_experiment::{Experiment, Progress};
use opspace_log::Recording;
use opspace_model::{Data, forward_kinematics, frame_placement};
use opspace_report::document::{RunSection, page};
use opspace_report::folder::in_folder;
use serde_json::Value;
use std::fs;

/// Largest distance between a frame in the player and in the model, m: positions have 16 bits.
const QUANTISATION_M: f64 = 0.5e-3;

/// Runs an experiment, and returns its page and its log.
fn page_of(experiment: &Experiment) -> (String, Recording) {
    let ((recording, _), section) = shown(experiment);
    let columns = default_columns(experiment.task().tables.added());
    let summary = section.summary.clone();
    (page("a run", "One run.", &[summary], &columns, &[section]), recording)
}

/// Returns the data of the player in a page.
fn robots_of(html: &str) -> Value {
    let begin = "<script type=\"application/json\" id=\"player-data\">";
    let text = html.split(begin).nth(1).unwrap().split("</script>").next().unwrap();
    serde_json::from_str(text).unwrap()
}

/// Data of the only robot of a page.
fn data_of(html: &str) -> Value {
    let mut data = robots_of(html);
    let robots = &mut data["robots"];
    assert_eq!(robots.as_array().unwrap().len(), 1);
    robots[0].take()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

fn placement(value: &Value) -> Isometry3<f64> {
    let [x, y, z, i, j, k, w] = numbers(value)[..] else { panic!("seven numbers: {value}") };
    Isometry3::from_parts(
        Translation3::new(x, y, z),
        UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k)),
    )
}

/// Joint positions of a picture.
fn picture(data: &Value, values: &[u8], joints: usize, k: usize) -> Vec<f64> {
    let columns = data["columns"].as_array().unwrap();
    let number = |column: usize| {
        let at = 2 * (k * columns.len() + column);
        let [low, step] = numbers(&columns[column])[..] else { panic!("two numbers") };
        low + step * f64::from(u16::from_le_bytes([values[at], values[at + 1]]))
    };
    (0..joints).map(number).collect()
}

/// Positions of all frames by the tree of joints in the data: a second implementation of what the page computes.
fn positions(data: &Value, q: &[f64]) -> Vec<(String, Vector3<f64>)> {
    let base = placement(&data["base"]);
    let mut bodies: Vec<Isometry3<f64>> = Vec::new();
    let at = |bodies: &[Isometry3<f64>], index: &Value| {
        usize::try_from(index.as_i64().unwrap()).map_or(base, |index| bodies[index])
    };
    for body in data["bodies"].as_array().unwrap() {
        let joint = q[body["joint"].as_u64().unwrap() as usize];
        let position = body["ratio"].as_f64().unwrap() * joint + body["offset"].as_f64().unwrap();
        let along = Vector3::z() * position;
        let motion = match body["slides"].as_bool().unwrap() {
            true => Isometry3::from_parts(along.into(), UnitQuaternion::identity()),
            false => Isometry3::from_parts(Translation3::identity(), UnitQuaternion::new(along)),
        };
        let placed = at(&bodies, &body["parent"]) * placement(&body["origin"]) * motion;
        bodies.push(placed);
    }
    let frames = data["frames"].as_array().unwrap().iter().map(|frame| {
        let placed = at(&bodies, &frame["body"]) * placement(&frame["placement"]);
        (frame["name"].as_str().unwrap().to_owned(), placed.translation.vector)
    });
    frames.collect()
}

/// Compares all frames of each robot with the forward kinematics of its model at the logged joint positions.
#[test]
fn player_shows_the_logged_motion() {
    for (task, backend) in [
        ("compliant-x", CommandKind::Position),
        ("panda-reach", CommandKind::Position),
        ("ur5e-reach", CommandKind::Position),
        ("planar-2-link-reach", CommandKind::Torque),
    ] {
        let experiment = load(task, backend, 1.5);
        let (html, recording) = page_of(&experiment);
        let data = data_of(&html);
        let values = STANDARD.decode(data["values"].as_str().unwrap()).unwrap();
        let model = &experiment.robot().model;
        let tick = recording.tick().unwrap();
        let logged = tick.signal("q").unwrap();
        let count = data["pictures"].as_u64().unwrap() as usize;
        assert!((70..=80).contains(&count), "{task}: {count} pictures of 1.5 s at 50 Hz");
        let period_s = data["period_s"].as_f64().unwrap();
        let start_s = data["start_s"].as_f64().unwrap();
        let first = tick.time_s.iter().position(|t| *t > -1e-9).unwrap();
        let mut state = Data::new(model);
        let mut moved_m = 0.0_f64;
        let mut start = Vec::new();
        for k in 0..count {
            let time_s = tick.time_s[first] + start_s + period_s * k as f64;
            let row = tick.time_s.partition_point(|t| *t < time_s - 1e-6);
            forward_kinematics(model, &mut state, logged.row(row));
            let shown = positions(&data, &picture(&data, &values, model.n(), k));
            for (name, position) in &shown {
                let frame = model.frame_id(name).unwrap();
                let error_m = (frame_placement(model, &state, frame).translation - position).norm();
                assert!(error_m < QUANTISATION_M, "{task}: '{name}' at {time_s} s is {error_m} m off");
            }
            let last = shown.last().unwrap().1;
            start.push(last);
            moved_m = moved_m.max((last - start[0]).norm());
        }
        assert_eq!(data["frames"].as_array().unwrap().len(), model.frames().len());
        assert!(moved_m > 2.0 * QUANTISATION_M, "{task}: it moves by {moved_m} m");
    }
}

/// Checks the sizes of code and data, of a short run and of one that has too many pictures.
#[test]
fn player_has_its_size() {
    let experiment = load("planar-2-link-reach", CommandKind::Torque, 50.0);
    let folder = tempfile::tempdir().unwrap();
    in_folder(&experiment, folder.path(), |log| experiment.run(log, &Progress::default())).unwrap();
    let html = fs::read_to_string(folder.path().join("report.html")).unwrap();
    let data = data_of(&html);
    let pictures = data["pictures"].as_u64().unwrap();
    assert!((1000..=2000).contains(&pictures), "{pictures} pictures");
    let covered_s = data["period_s"].as_f64().unwrap() * (pictures - 1) as f64;
    assert!((49.5..=50.0).contains(&covered_s), "{covered_s} s");
    assert!(data.to_string().len() < 150_000 && data["values"].as_str().unwrap().len() <= 100_000);
    let code = html.split("id=\"player-code\">").nth(1).unwrap().split("</script>").next().unwrap();
    assert!(code.len() < 200_000, "{} bytes of code", code.len());
}

/// Checks that runs which a page compares share a player and the size of its positions, and that a page of many runs has none.
#[test]
fn compared_runs_share_a_player() {
    let sections = [CommandKind::Position, CommandKind::Torque]
        .map(|backend| shown(&load("planar-2-link-reach", backend, 20.0)).1);
    let page_of = |sections: &[RunSection]| {
        let summaries: Vec<_> = sections.iter().map(|section| section.summary.clone()).collect();
        page("runs", "Some runs.", &summaries, &default_columns(&[]), sections)
    };
    let html = page_of(&sections);
    let data = robots_of(&html);
    assert_eq!(data["are_compared"], true);
    let robots = data["robots"].as_array().unwrap();
    let sizes: Vec<usize> = robots.iter().map(|robot| robot["values"].as_str().unwrap().len()).collect();
    assert!(sizes.len() == 2 && sizes.iter().sum::<usize>() <= 100_000, "{sizes:?}");
    // Half of the pictures of each remain, over the same time.
    for robot in robots {
        let (count, period_s) = (robot["pictures"].as_u64().unwrap(), robot["period_s"].as_f64().unwrap());
        assert!((19.5..=20.0).contains(&(period_s * (count - 1) as f64)), "{count} pictures");
        let values = STANDARD.decode(robot["values"].as_str().unwrap()).unwrap();
        assert_eq!(values.len(), 2 * count as usize * robot["columns"].as_array().unwrap().len());
    }
    let many = [&sections[..], &sections, &sections[..1]].concat();
    let html = page_of(&many);
    assert_eq!(html.matches("<script").count(), 1);
    assert!(!html.contains("class=\"player\""));
}

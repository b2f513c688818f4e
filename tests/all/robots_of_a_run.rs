//! Folders with the logs of several robots: of robots that ran side by side, also of a run that was cut off, and of an experiment.

#![expect(clippy::unwrap_used, reason = "a test")]

use crate::cli_common::{circle_folder, opspace, project, read, scratch};
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Largest sizes in a page: positions, and code of the player, bytes.
const MOST_POSITIONS: usize = 100_000;
const MOST_CODE: usize = 200_000;

/// Text of the element of a page with this identifier.
fn element(page: &str, id: &str) -> String {
    let begin = page.split_once(&format!("id=\"{id}\">")).unwrap().1;
    begin.split_once("</script>").unwrap().0.to_owned()
}

/// Data of the player of a page, whose sizes are within their limits.
fn player(page: &Path) -> Value {
    let page = read(page);
    let data: Value = serde_json::from_str(&element(&page, "player-data")).unwrap();
    let positions =
        data["robots"].as_array().unwrap().iter().map(|robot| robot["values"].as_str().unwrap().len());
    assert!(positions.sum::<usize>() <= MOST_POSITIONS);
    assert!(element(&page, "player-code").len() <= MOST_CODE);
    data
}

fn names(data: &Value) -> Vec<&str> {
    data["robots"].as_array().unwrap().iter().map(|robot| robot["name"].as_str().unwrap()).collect()
}

/// Compared: the cycles of two logs that end in the middle, as those of a run that was killed, and their replay from the folder of both. A
/// page compares them, and its player has both robots; a new run into the folder is refused as one into that of any run is.
#[test]
fn side_by_side_run_that_was_cut_off_is_read() {
    let folder = circle_folder("");
    for robot in ["position", "torque"] {
        let out = format!("out/{robot}");
        opspace(folder.path(), &["run", "circle.toml", "--backend", robot, "--out", &out, "--quiet"])
            .exits(0);
        let log = fs::read(folder.path().join(&out).join("run.mcap")).unwrap();
        for file in ["report.html", "summary.json"] {
            fs::remove_file(folder.path().join(&out).join(file)).unwrap();
        }
        fs::write(folder.path().join(&out).join("run.mcap"), &log[..log.len() / 2]).unwrap();
    }
    let replayed = opspace(folder.path(), &["replay", "out", "--json", "-"]).exits(3);
    replayed.says(&["out/position/run.mcap: damaged", "out/torque/run.mcap: damaged", "readable up to"]);
    let text = opspace(folder.path(), &["replay", "out"]).exits(3).stdout;
    assert_eq!(text.matches("ticks are equal, bit for bit").count(), 2, "{text}");
    opspace(folder.path(), &["replay", "--simulate", "out"]).exits(3);
    opspace(folder.path(), &["report", "out"]).exits(3);
    let data = player(&folder.path().join("out/report.html"));
    assert_eq!((&data["are_compared"], names(&data).len()), (&Value::Bool(true), 2));
    let again =
        ["run", "circle.toml", "--backend", "position", "--beside", "torque", "--view=0", "--out", "out"];
    opspace(folder.path(), &again).exits(2).says(&["out: already contains a run"]);
}

/// The page of an experiment plays all of its robots, on one clock, with the object that they carry as a box.
#[test]
fn page_of_an_experiment_plays_all_robots() {
    let folder = scratch();
    let experiment = project("tasks/experiments/two-arms-carry.toml");
    let short = ["--duration-s", "1", "--set", "settle_s=0.5", "--out", "out", "--quiet"];
    // A second of it need not meet its bounds.
    opspace(folder.path(), &[&["run", experiment.as_str()], &short[..]].concat());
    let data = player(&folder.path().join("out/report.html"));
    assert_eq!((&data["are_compared"], names(&data)), (&Value::Bool(false), vec!["left", "right"]));
    for robot in data["robots"].as_array().unwrap() {
        assert!(
            robot["start_s"].as_f64().unwrap().abs() < 0.1 && robot["pictures"].as_u64().unwrap() > 20,
            "{robot}"
        );
        let load = &robot["objects"][0];
        let [x, y, z] = [0, 1, 2].map(|axis| load["box_m"][axis].as_f64().unwrap());
        // A rod along y, between hands that are 0.4 m apart.
        assert!((0.39..0.42).contains(&y) && x < 0.1 && z < 0.1, "{load}");
    }
}

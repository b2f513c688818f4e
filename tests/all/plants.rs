//! Plants on the command line: `opspace run --plant`, `opspace bench --plants`.
//!
//! Tests with MuJoCo say that they are skipped if it is not installed, unless OPSPACE_MUJOCO names a library.

#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a test that says that it is skipped")]

use crate::cli_common::{Ran, circle_folder, command, opspace, project, read, read_json};
use serde_json::Value;
use std::fs;
use std::path::Path;

const SUITE: &str = r#"
title = "plants"
[[run]]
tasks = ["circle.toml"]
seeds = [1, 2]
"#;

/// Returns true if MuJoCo is installed; otherwise says that the test is skipped.
fn has_mujoco(folder: &Path) -> bool {
    let ran = opspace(folder, &["run", "circle.toml", "--plant", "mujoco:none.xml", "--quiet"]);
    let is_missing = ran.stderr.contains("MuJoCo is not installed");
    if is_missing {
        println!("SKIPPED, a test with MuJoCo: {}", ran.stderr.trim());
    }
    !is_missing
}

/// Checks the error without the library: the remedy, and exit code 2.
#[test]
fn missing_mujoco_is_an_error_with_the_remedy() {
    let folder = circle_folder(SUITE);
    for arguments in
        [["run", "circle.toml", "--plant", "mujoco"], ["bench", "suite.toml", "--plants", "own,mujoco"]]
    {
        let output = command(folder.path(), &arguments)
            .env_remove("OPSPACE_MUJOCO")
            .env("PATH", folder.path())
            .output()
            .unwrap();
        let errors = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{errors}");
        assert!(errors.contains("run `pip install mujoco`") && errors.lines().count() == 1, "{errors}");
        let output =
            command(folder.path(), &arguments).env("OPSPACE_MUJOCO", "libmissing.so").output().unwrap();
        let errors = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{errors}");
        assert!(errors.contains("libmissing.so") && errors.contains("pip install"), "{errors}");
    }
    assert!(!folder.path().join("runs").exists());
}

/// Checks plants that do not exist, a plant that is listed twice, and the own plant by name.
#[test]
fn unknown_plants_are_refused() {
    let folder = circle_folder(SUITE);
    opspace(folder.path(), &["run", "circle.toml", "--plant", "bullet"]).exits(2).says(&["mujoco:SCENE.xml"]);
    opspace(folder.path(), &["run", "circle.toml", "--plant", "mujoco:"])
        .exits(2)
        .says(&["mujoco:SCENE.xml"]);
    opspace(folder.path(), &["bench", "suite.toml", "--plants", "own,own"])
        .exits(2)
        .says(&["plant 2", "twice"]);
    opspace(folder.path(), &["run", "circle.toml", "--plant", "own", "--out", "a"]).exits(0);
    assert_eq!(read_json(folder.path().join("a/summary.json"))["plant"], "own");
}

/// Checks that a wrong scene is an error that names the file, and MuJoCo's reason with the line.
#[test]
fn wrong_scene_is_named() {
    let folder = circle_folder(SUITE);
    if !has_mujoco(folder.path()) {
        return;
    }
    let refused =
        |scene: &str| -> Ran { opspace(folder.path(), &["run", "circle.toml", "--plant", scene]).exits(2) };
    refused("mujoco:none.xml").says(&["none.xml: the scene cannot be read"]);
    fs::write(
        folder.path().join("bad.xml"),
        "<mujoco>\n<worldbody>\n<geom type='cube'/></worldbody></mujoco>",
    )
    .unwrap();
    refused("mujoco:bad.xml").says(&["bad.xml: MuJoCo refuses the scene", "cube", "line 3"]);
    assert!(!folder.path().join("runs").exists());
}

/// Compared: rows of a suite on both plants, which differ in nothing but the plant; the log of each plant and its replay; and a
/// second suite with other plants in the same folder.
#[test]
fn suite_runs_on_each_plant() {
    let folder = circle_folder(SUITE);
    if !has_mujoco(folder.path()) {
        return;
    }
    let bench = |plants: &str, more: &[&str]| {
        let arguments = ["bench", "suite.toml", "--out", "out", "--plants", plants];
        opspace(folder.path(), &[&arguments, more].concat())
    };
    let ran = bench("own,mujoco", &[]).exits(0);
    let json = read_json(folder.path().join("out/bench.json"));
    let rows = json["rows"].as_array().unwrap();
    let plants: Vec<&str> = rows.iter().map(|row| row["plant"].as_str().unwrap()).collect();
    assert!(plants.len() == 4 && plants[1].starts_with("mujoco "), "{plants:?}");
    assert_eq!([plants[0], plants[2], plants[3]], ["own", "own", plants[1]]);
    assert!(ran.stdout.contains(plants[1]), "{}", ran.stdout);
    assert!(read(folder.path().join("out/report.html")).contains(plants[1]));
    for pair in rows.chunks(2) {
        assert_eq!(pair[0]["seed"], pair[1]["seed"]);
        let error = |row: &Value| row["metrics"]["position_rms_m"].as_f64().unwrap();
        assert!(
            (error(&pair[0]) / error(&pair[1]) - 1.0).abs() < 0.01,
            "{} {}",
            error(&pair[0]),
            error(&pair[1])
        );
    }
    let logs: Vec<&str> = json["logs"].as_array().unwrap().iter().map(|log| log.as_str().unwrap()).collect();
    assert!(logs.len() == 2 && logs[1].contains("-mujoco-"), "{logs:?}");
    let log = format!("out/{}", logs[1]);
    // Without MuJoCo.
    let replayed = command(folder.path(), &["replay", &log]).env("PATH", folder.path()).output().unwrap();
    assert_eq!(replayed.status.code(), Some(0));
    let info = opspace(folder.path(), &["log", "info", &log]).exits(0).stdout;
    assert!(info.contains("plant_version") && info.contains(&plants[1]["mujoco ".len()..]), "{info}");
    bench("own", &[]).exits(2);
    let arguments =
        ["bench", "suite.toml", "--plants", "mujoco", "--baseline", "out/bench.json", "--out", "other"];
    let ran = opspace(folder.path(), &arguments).exits(0);
    assert!(ran.stdout.contains("0 worse, 0 better"), "{}", ran.stdout);
}

/// Compared: every message of a run in a scene of MuJoCo, and of a second simulation from its log. A scene that has changed is refused, and a
/// missing one is named.
#[test]
fn run_in_a_scene_is_simulated_again() {
    let folder = circle_folder(SUITE);
    if !has_mujoco(folder.path()) {
        return;
    }
    let scene = folder.path().join("box.xml");
    fs::copy(project("tests/mujoco/free-box.xml"), &scene).unwrap();
    opspace(folder.path(), &["run", "circle.toml", "--plant", "mujoco:box.xml", "--out", "out"]).exits(0);
    let again = || opspace(folder.path(), &["replay", "--simulate", "out"]);
    again().exits(0).prints(&["bit for bit"]);
    let text = read(&scene);
    fs::write(&scene, text.replace("</worldbody>", "<geom size='0.1'/></worldbody>")).unwrap();
    again().exits(2).says(&["box.xml has changed since the run", "'scene.xml'"]);
    fs::remove_file(&scene).unwrap();
    again().exits(2).says(&["box.xml: the scene cannot be read"]);
}

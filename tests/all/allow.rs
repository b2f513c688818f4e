//! Codes on the command line: `explain`, and refusals that `--allow` turns into warnings which all results carry.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use crate::cli_common::{circle_folder, opspace, read, read_json, scratch};
use opspace_experiment::Code;
use std::fs;

/// Code of the refusal of a friction observer on the planar arm, which has no force sensor.
const OBSERVER: &str = "friction-observer-without-sensor";

const SUITE: &str = "title = \"t\"\n[[run]]\ntasks = [\"circle.toml\"]\n";

/// Folder with a task that asks for a friction observer on an arm without a force sensor.
fn observer_folder() -> tempfile::TempDir {
    let folder = circle_folder(SUITE);
    let task = folder.path().join("circle.toml");
    let text = read(&task);
    fs::write(&task, text.replace("[task.tip", "friction_compensation.observer_rad_per_s = 20.0\n[task.tip"))
        .unwrap();
    folder
}

#[test]
fn explain_lists_codes_and_prints_pages() {
    let folder = scratch();
    let list = opspace(folder.path(), &["explain"]).exits(0).stdout;
    assert_eq!(list.lines().count(), Code::ALL.len());
    assert!(list.lines().all(|line| line.trim_end().len() > 60), "each has a summary: {list}");
    let page = opspace(folder.path(), &["explain", "compliant-drift"]).exits(0).stdout;
    for words in
        ["compliant-drift\n", "refuses no run", "Why it matters. ", "    impedance = { stiffness_n_per_m"]
    {
        assert!(page.contains(words), "{words} in {page}");
    }
    assert!(!page.contains("```") && !page.contains("**"), "{page}");
    let margin = opspace(folder.path(), &["explain", "small-gain-margin"]).exits(0).stdout;
    assert!(margin.contains("Refuses a run on a real robot, and is reported otherwise"), "{margin}");
    opspace(folder.path(), &["explain", "compliant-drif"])
        .exits(2)
        .says(&["did you mean 'compliant-drift'?"]);
}

#[test]
fn allowed_refusal_is_a_warning_in_all_results() {
    let folder = observer_folder();
    let at = |path: &str| folder.path().join(path);
    opspace(folder.path(), &["run", "circle.toml"]).exits(2).says(&[
        "the friction observer needs a force sensor",
        &format!("[{OBSERVER}]"),
        &format!("--allow {OBSERVER} runs it nevertheless"),
    ]);
    let allow = ["--allow", OBSERVER];
    let run = [&["run", "circle.toml", "--out", "out"], &allow[..]].concat();
    let ran = opspace(folder.path(), &run).exits(0).says(&["warning: ", &format!("[{OBSERVER}, allowed]")]);
    let line = ran.stdout.lines().find(|line| line.starts_with("ALLOWED ")).unwrap();
    assert!(line.contains("needs a force sensor") && line.contains(OBSERVER), "{line}");
    assert_eq!(read_json(at("out/summary.json"))["allowed"][0]["code"], OBSERVER);
    assert!(read(at("out/report.html")).contains(&format!("[{OBSERVER}, allowed]")));
    // The log says so too: it is replayed and reported without the option.
    opspace(folder.path(), &["replay", "out"]).exits(0);
    let again = opspace(folder.path(), &["report", "out", "-o", "again.html", "--json", "-"]).exits(0);
    assert_eq!(again.json()[0]["allowed"][0]["code"], OBSERVER);
    assert!(read(at("again.html")).contains(&format!("[{OBSERVER}, allowed]")));

    let checked =
        opspace(folder.path(), &["check", "circle.toml", "suite.toml", "--json", "-"]).exits(2).json();
    assert_eq!(checked["files"][0]["code"], OBSERVER);
    let check = [&["check", "circle.toml", "suite.toml", "--json", "-"], &allow[..]].concat();
    let checked = opspace(folder.path(), &check).exits(0).json();
    for file in 0..2 {
        assert_eq!(checked["files"][file]["allowed"][0]["code"], OBSERVER, "{file}");
    }

    opspace(folder.path(), &["bench", "suite.toml", "--out", "suite"]).exits(2).says(&[OBSERVER]);
    let bench = [&["bench", "suite.toml", "--out", "suite"], &allow[..]].concat();
    let ran = opspace(folder.path(), &bench).exits(0);
    assert!(ran.stdout.contains(&format!("[{OBSERVER}, allowed]")), "{}", ran.stdout);
    assert!(read(at("suite/report.html")).contains(&format!("[{OBSERVER}, allowed]")));
}

#[test]
fn codes_that_refuse_nothing_or_falsify_cannot_be_allowed() {
    let folder = circle_folder(SUITE);
    for (code, words) in [
        ("singular-start", "'singular-start' is only reported: it refuses no run"),
        ("massless-link", "'massless-link' cannot be allowed: it falsifies masses and torques"),
        ("comparison-only", "can damage a real robot"),
        ("gains-to-high", "did you mean 'gains-too-high'?"),
    ] {
        for command in ["run", "check"] {
            opspace(folder.path(), &[command, "circle.toml", "--allow", code]).exits(2).says(&[words]);
        }
    }
}

/// Findings and warnings carry their codes.
#[test]
fn findings_and_model_warnings_have_codes() {
    let folder = circle_folder(SUITE);
    let task = folder.path().join("circle.toml");
    fs::write(&task, read(&task).replace("elbow = 1.2", "elbow = 0.0")).unwrap();
    let checked = opspace(folder.path(), &["check", "circle.toml"]).exits(0);
    assert_eq!(checked.stderr, "");
    checked.prints(&["\n  circle.toml:", " [singular-start]\n    help: "]);
    let json = opspace(folder.path(), &["check", "circle.toml", "--json", "-"]).exits(0).json();
    assert_eq!(json["files"][0]["findings"][0]["code"], "singular-start");
    let urdf = "<robot name=\"r\"><link name=\"a\"/><joint name=\"j\" type=\"revolute\"><parent link=\"a\"/><child link=\"b\"/>\
                <limit lower=\"-180\" upper=\"180\" effort=\"1\" velocity=\"0\"/></joint><link name=\"b\"><inertial><mass value=\"1\"/>\
                <inertia ixx=\"1\" iyy=\"1\" izz=\"1\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial></link></robot>";
    fs::write(folder.path().join("r.urdf"), urdf).unwrap();
    let codes = ["[zero-limit]", "[large-inertia]", "[wide-range]"];
    opspace(folder.path(), &["check", "r.urdf"]).exits(0).prints(&codes);
    let json = opspace(folder.path(), &["check", "r.urdf", "--json", "-"]).exits(0).json();
    assert_eq!(json["files"][0]["warnings"].as_array().unwrap().len(), codes.len(), "{json}");
    opspace(folder.path(), &["model", "r.urdf"]).exits(0).says(&codes);
    let massless = urdf.replace("<mass value=\"1\"/>", "<mass value=\"0\"/>").replace("\"1\" i", "\"0\" i");
    fs::write(folder.path().join("r.urdf"), massless.replace("izz=\"1\"", "izz=\"0\"")).unwrap();
    opspace(folder.path(), &["check", "r.urdf"]).exits(2).says(&["[massless-link]"]);
}

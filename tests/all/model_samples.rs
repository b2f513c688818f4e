//! Compared: `opspace model --samples`, used as by a user who checks the model with another library, and values of
//! Pinocchio. See `tests/oracles/pinocchio/README.md`.

#![expect(clippy::unwrap_used, reason = "a test")]

use crate::cli_common::{self, Ran, command, opspace, scratch};
use opspace_testing::oracle::{Oracle, numbers, relative_error};
use serde_json::{Value, json};
use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::Stdio;

/// Largest error of an entry relative to max(1, largest reference value): ten times the largest measured one,
/// 5.1e-15.
const TOLERANCE: f64 = 5e-14;
/// Largest relative error of an entry that requires the inverse of the mass matrix or of the task's inertia: ten
/// times the largest measured one, 3.7e-11.
const INVERSE_TOLERANCE: f64 = 4e-10;

const INPUTS: [&str; 5] = ["q", "dq", "ddq", "tau_in", "f_tip"];
const INVERTED: [&str; 5] = ["ddq_aba", "ddq_aba_fext", "Lambda", "Jbar", "N"];

struct States {
    urdf: String,
    tip: String,
    samples: Vec<Value>,
    /// States as JSON lines.
    lines: String,
}

fn states(robot: &str) -> States {
    let Oracle { meta, samples, urdf_path, .. } = Oracle::read(&format!("pinocchio/{robot}.json"));
    let lines = samples.iter().map(|sample| {
        let mut input = json!({ "task_rows": meta["task_rows"] });
        INPUTS.iter().for_each(|key| input[key] = sample[key].clone());
        input.to_string() + "\n"
    });
    States {
        urdf: urdf_path,
        tip: meta["tip_frame"].as_str().unwrap().to_owned(),
        lines: lines.collect(),
        samples,
    }
}

fn agree(robot: &str) {
    let States { urdf, tip, samples, lines } = states(robot);
    let folder = scratch();
    fs::write(folder.path().join("states.jsonl"), lines).unwrap();
    let out =
        opspace(folder.path(), &["model", &urdf, "--tip", &tip, "--samples", "states.jsonl"]).exits(0).stdout;
    assert_eq!(out.lines().count(), samples.len());
    for (i, (line, reference)) in out.lines().zip(&samples).enumerate() {
        let ours: Value = serde_json::from_str(line).unwrap();
        let keys = reference.as_object().unwrap().keys().map(String::as_str);
        let outputs = keys.filter(|key| !INPUTS.contains(key) && *key != "lambda_inv_cond");
        let mut compared = 0;
        for key in outputs {
            compared += 1;
            let (a, b) = (numbers(&ours[key]), numbers(&reference[key]));
            let tolerance = if INVERTED.contains(&key) { INVERSE_TOLERANCE } else { TOLERANCE };
            let error = relative_error(&a, &b);
            assert!(error <= tolerance, "{robot}, sample {i}, {key}: off by {error:e}");
        }
        assert_eq!(compared, 19, "quantities");
    }
}

macro_rules! robots {
    ($($robot:ident),*) => { $(
        #[test]
        fn $robot() {
            agree(stringify!($robot));
        }
    )* };
}
robots!(double_pendulum, g1_29dof, kinova_j2s6s200, panda, panda_arm7, ur5);

fn from_stdin(folder: &Path, arguments: &[&str], input: &str) -> Ran {
    let mut child = command(folder, arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // The program may end before it has read the whole input.
    let _ = child.stdin.take().unwrap().write_all(input.as_bytes());
    let output = child.wait_with_output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    Ran { code: output.status.code().unwrap(), stdout: text(output.stdout), stderr: text(output.stderr) }
}

/// Compared: lines for states from a file and from standard input, and with results written to a file.
#[test]
fn states_come_from_file_or_stdin() {
    let States { urdf, tip, lines, .. } = states("ur5");
    let folder = scratch();
    fs::write(folder.path().join("states.jsonl"), &lines).unwrap();
    let arguments = |samples| ["model", urdf.as_str(), "--tip", tip.as_str(), "--samples", samples];
    let file = opspace(folder.path(), &arguments("states.jsonl")).exits(0).stdout;
    let piped = from_stdin(folder.path(), &arguments("-"), &lines).exits(0).stdout;
    assert_eq!(file, piped);
    let to_file = [&arguments("states.jsonl")[..], &["--json", "out.jsonl"]].concat();
    assert_eq!(opspace(folder.path(), &to_file).exits(0).stdout, "");
    assert_eq!(cli_common::read(folder.path().join("out.jsonl")), file);
}

#[test]
fn bad_line_is_named_after_earlier_results() {
    let States { urdf, tip, lines, samples } = states("double_pendulum");
    let first = lines.lines().next().unwrap();
    let zero = json!([0.0, 0.0]);
    let f_tip = json!([0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let state = |key: &str, value: Value| {
        let mut state = json!({ "q": zero, "dq": zero, "ddq": zero, "tau_in": zero, "f_tip": f_tip });
        state[key] = value;
        state.to_string()
    };
    let cases = [
        ("{".to_owned(), vec!["EOF"]),
        ("[]".to_owned(), vec![]),
        (state("q", json!([0.0])), vec!["q", "2"]),
        (state("f_tip", json!([0.0])), vec!["6"]),
        (state("q", json!(["a", "b"])), vec!["string"]),
        (state("task_rows", json!([0, 7])), vec!["7"]),
        (first.replace("\"dq\"", "\"dQ\""), vec!["dq"]),
    ];
    let arguments = ["model", &urdf, "--tip", &tip, "--samples", "-"];
    let folder = scratch();
    for (bad, words) in cases {
        let ran = from_stdin(folder.path(), &arguments, &format!("{first}\n\n{bad}\n{first}\n")).exits(2);
        let ran = ran.says(&["error: -:3: "]).says(&words);
        assert_eq!(ran.stdout.lines().count(), 1, "{bad}");
    }
    assert_eq!(samples.len(), 20);
}

#[test]
fn missing_frame_or_file_is_named() {
    let States { urdf, .. } = states("ur5");
    let folder = scratch();
    let at = |arguments: &[&str]| opspace(folder.path(), arguments).exits(2);
    at(&["model", &urdf, "--tip", "tol0", "--samples", "-"]).says(&["--tip tol0", "tool0"]);
    at(&["model", &urdf, "--tip", "tool0", "--samples", "none.jsonl"]).says(&["none.jsonl"]);
    at(&["model", "none.urdf"]).says(&["none.urdf: there is no such file"]);
    at(&["model", &urdf, "--tip", "tool0"]).says(&["--samples"]);
}

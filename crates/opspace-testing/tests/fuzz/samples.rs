//! States as JSON lines: `opspace model --samples`.

use crate::edits::{apply_to_text, edited};
use crate::inputs::for_each_input;
use crate::limits::Target;
use crate::states::{Quantities, Sample, evaluate};
use crate::{CORPUS, text};
use opspace_model::{Model, UrdfOptions};

/// Most memory for one file, bytes.
const MOST_BYTES: usize = 32 << 20;

/// Relative error of the torques of a motion that was computed from torques.
const TOLERANCE: f64 = 1e-6;

/// An error has a text. The quantities of an accepted state are finite, and the same when they are written and read
/// again; the inverse of the mass matrix is consistent with it: M q̈ + h gives the torques of which q̈ is the result.
#[test]
#[ignore = "a fuzz target, which runs for a minute or longer: .ci/run fuzz"]
fn samples() {
    let names = ["planar-2-link", "ur5e", "floating"];
    let seeds = names.map(|name| text(&format!("{CORPUS}/{name}.samples.jsonl")));
    // Of the robot that floats, the base has an inertia.
    let robot = |name: &str| text(&format!("robots/{name}/{name}.urdf"));
    let robots = [
        (robot("planar-2-link"), false),
        (robot("ur5e"), false),
        (opspace_testing::oracle::urdf("ur5"), true),
    ];
    let models = robots.map(|(urdf, floating_base)| {
        let options = UrdfOptions { floating_base, ..UrdfOptions::default() };
        Model::from_urdf_with(&urdf, options).expect("a robot").model
    });
    let target = Target::new("samples", MOST_BYTES);
    for_each_input(edited(seeds.len()), 2000, |(seed, edits)| {
        let text = apply_to_text(&seeds, *seed, edits);
        let model = &models[*seed];
        target.check(text.as_bytes(), edits.is_empty(), || {
            let lines = text.lines().filter(|line| !line.trim().is_empty());
            // Each line is read, whatever the others are.
            let accepted: Vec<bool> = lines.map(|line| check_line(model, line)).collect();
            accepted.iter().all(|accepted| *accepted)
        });
    });
}

fn check_line(model: &Model, line: &str) -> bool {
    let sample: Sample = match serde_json::from_str(line) {
        Ok(sample) => sample,
        Err(error) => {
            assert!(!error.to_string().is_empty());
            return false;
        }
    };
    let written = serde_json::to_string(&sample).expect("JSON");
    assert_eq!(serde_json::from_str::<Sample>(&written).expect("the same state"), sample);
    let tip =
        model.frames().last().map(|frame| model.frame_id(&frame.name)).expect("a frame").expect("a frame");
    let quantities = match evaluate(model, tip, &sample) {
        Ok(quantities) => quantities,
        Err(error) => {
            assert!(!error.to_string().trim().is_empty());
            return false;
        }
    };
    let json = serde_json::to_value(&quantities).expect("JSON");
    check_finite(&json, &mut Vec::new());
    let text = serde_json::to_string(&quantities).expect("JSON");
    assert_eq!(serde_json::from_str::<Quantities>(&text).expect("the same quantities"), quantities);
    let n = model.n();
    let at = |row: usize, column: usize| quantities.mass_matrix[row * n + column];
    let most = |list: &[f64]| list.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
    // Centrifugal torques cancel where a body is symmetric about its axis.
    let rates = most(&quantities.ddq_aba) + most(&sample.dq).powi(2);
    let scale =
        1.0 + (1.0 + most(&quantities.mass_matrix)) * rates + most(&quantities.bias) + most(&sample.tau_in);
    for row in 0..n {
        assert!(at(row, row) > 0.0, "{quantities:?}");
        let torque: f64 =
            (0..n).map(|k| at(row, k) * quantities.ddq_aba[k]).sum::<f64>() + quantities.bias[row];
        assert!((torque - sample.tau_in[row]).abs() <= TOLERANCE * scale, "{torque} {}", sample.tau_in[row]);
    }
    true
}

/// Checks that a value has no `null` but for absent lists: serde_json writes a number that is not finite as `null`.
fn check_finite(value: &serde_json::Value, path: &mut Vec<String>) {
    const MAY_BE_ABSENT: [&str; 4] = ["com", "Lambda", "Jbar", "N"];
    match value {
        serde_json::Value::Null => {
            assert!(
                matches!(&path[..], [key] if MAY_BE_ABSENT.contains(&key.as_str())),
                "{path:?} is not finite"
            );
        }
        serde_json::Value::Array(list) => {
            for (k, entry) in list.iter().enumerate() {
                path.push(k.to_string());
                check_finite(entry, path);
                path.pop();
            }
        }
        serde_json::Value::Object(table) => {
            for (key, entry) in table {
                path.push(key.clone());
                check_finite(entry, path);
                path.pop();
            }
        }
        _ => {}
    }
}

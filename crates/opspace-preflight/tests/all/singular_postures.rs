//! Fraction of the postures in which a task is nearly singular.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use opspace_control::{ControlInput, Measurement, Targets};
use opspace_experiment::{Experiment, Files, RunOptions};
use opspace_model::{Data, Postures, update};
use opspace_preflight::singular_postures;
use std::path::Path;

/// Gain of a damped inverse that counts as one without damping.
const WHOLE: f64 = 1.0 - 1e-9;

/// Compared: the number of nearly singular postures of two tasks with that in which the controller, started there with
/// references at rest, damps them.
#[test]
fn nearly_singular_postures_are_those_that_the_controller_damps() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/panda-goals.toml");
    let tasks = "task={ position = { cartesian = { frame = \"flange\", axes = { x = \"motion\", y = \"motion\", z = \
                 \"motion\" }, gains = { frequency_rad_per_s = 10.0, damping_ratio = 1.0 }, reference = \"hold\" } }, turn \
                 = { cartesian = { frame = \"flange\", axes = { rx = \"motion\", ry = \"motion\", rz = \"motion\" }, gains \
                 = { frequency_rad_per_s = 10.0, damping_ratio = 1.0 }, reference = \"hold\" } } }";
    let settings =
        ["event=[]", "priority=[\"position\", \"turn\"]", tasks, "limits.enforce=false"].map(str::to_owned);
    let experiment = Experiment::load(Files::Disk, &path, None, RunOptions::default(), &settings).unwrap();
    let counted = singular_postures(&experiment);
    let names: Vec<&str> = counted.iter().map(|count| count.task.as_str()).collect();
    assert_eq!(names, ["position", "turn"]);
    let model = &experiment.robot().model;
    let n = model.n();
    let (mut data, mut measurement) = (Data::new(model), Measurement::new(n, 0, false));
    let (targets, feedforward_torque) = (Targets::none(), vec![0.0; n]);
    let mut tau = vec![0.0; n];
    let mut damped = [0; 2];
    let mut controller = experiment.controller().unwrap();
    let signals = controller.signals();
    for number in 0..counted[0].sampled {
        let q = Postures::new(model, 1.0).posture(number);
        assert!(update(model, &mut data, &q, &feedforward_torque));
        measurement.q.copy_from_slice(&q);
        let input = ControlInput::new(model, &data, &measurement, &feedforward_torque, &targets);
        controller.start(&input);
        controller.update(&input, &mut tau);
        let mut row = vec![0.0; signals.iter().map(|signal| signal.len()).sum()];
        controller.sample(&mut row);
        for (count, task) in damped.iter_mut().zip(&counted) {
            let name = format!("{}.min_singular_gain", task.task);
            let before = signals.iter().take_while(|signal| signal.name != name);
            *count += usize::from(row[before.map(|signal| signal.len()).sum::<usize>()] < WHOLE);
        }
    }
    assert_eq!(counted.iter().map(|count| count.singular).collect::<Vec<_>>(), damped);
    assert!(damped[1] > 0 && damped[1] < 40, "{damped:?} of {}", counted[1].sampled);
    let text = counted[1].to_string();
    assert!(text.starts_with("task 'turn': nearly singular in ") && text.contains("400 sampled"), "{text}");
}

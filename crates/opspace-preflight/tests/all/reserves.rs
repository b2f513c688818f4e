//! Joints that reach a limit first: with a payload, with target forces, and with speed.

use opspace_experiment::{Code, Experiment, Files, RunOptions};
use opspace_model::{Data, frame_placement, kinematics, potential_energy};
use opspace_preflight::{Reserve, ReserveOf, diagnostics, reserves};
use std::path::Path;

fn experiment(task: &str, settings: &[&str]) -> Experiment {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../tasks/{task}.toml"));
    let settings: Vec<String> = settings.iter().map(|&setting| setting.to_owned()).collect();
    Experiment::load(Files::Disk, &path, None, RunOptions::default(), &settings).expect("a task")
}

fn reserve(experiment: &Experiment, is_of: impl Fn(&ReserveOf) -> bool) -> Reserve {
    reserves(experiment).into_iter().find(|reserve| is_of(&reserve.of)).expect("a reserve")
}

/// Codes of the diagnostics of torques above a limit, with their messages.
fn torques_above_limits(experiment: &Experiment) -> Vec<String> {
    let of_torque = [Code::TorqueAboveLimit, Code::WeightAboveLimit];
    let found = diagnostics(experiment).into_iter().filter(|finding| of_torque.contains(&finding.code));
    found.map(|finding| finding.message).collect()
}

/// Checks that the diagnostics of the same task with a tool of this mass find no torque above a limit up to the predicted mass,
/// and that of the predicted joint beyond it. Friction, which diagnostics do not count, is taken away.
#[test]
fn tool_of_the_predicted_mass_brings_the_joint_to_its_limit() {
    for (task, frame) in [("ur5e-reach", "flange"), ("panda-reach", "flange"), ("compliant-x", "hand")] {
        let plain = experiment(task, &[]);
        let joints: Vec<String> =
            plain.robot().model.joints().iter().map(|joint| joint.name.clone()).collect();
        let frictionless: Vec<String> = joints
            .iter()
            .map(|joint| format!("robot.joint.{joint}.friction={{ coulomb_nm = 0.0, static_nm = 0.0, stribeck_rad_per_s = 0.06, \
                     viscous_nms_per_rad = 0.0, presliding_rad = 1e-3 }}"))
            .collect();
        let frictionless: Vec<&str> = frictionless.iter().map(String::as_str).collect();
        let predicted = reserve(&experiment(task, &frictionless), |of| matches!(of, ReserveOf::Payload(_)));
        assert_eq!(predicted.of, ReserveOf::Payload(frame.to_owned()));
        for (share, is_above) in [(0.98, false), (1.08, true)] {
            let tool = format!(
                "robot.tool.load={{ on = \"{frame}\", mass_kg = {}, com_m = [0.0, 0.0, 0.0], inertia_kg_m2 = [0.0, 0.0, \
                 0.0, 0.0, 0.0, 0.0] }}",
                share * predicted.at
            );
            let above = torques_above_limits(&experiment(task, &[&frictionless[..], &[&tool]].concat()));
            assert_eq!(above.is_empty(), !is_above, "{task}, {share} of {predicted}: {above:?}");
            if is_above {
                let named = format!("joint '{}'", predicted.joint);
                assert!(above.iter().any(|text| text.contains(&named)), "{predicted}: {above:?}");
            }
        }
    }
}

/// Checks that the diagnostics of a task whose allowed speed is divided by the predicted multiple find no joint too fast, and the
/// predicted joint if it is divided by a little more.
#[test]
fn allowed_speed_over_the_predicted_multiple_is_that_of_the_joint() {
    let predicted = reserve(&experiment("joint-tracking", &[]), |of| *of == ReserveOf::Speed);
    let fraction = experiment("joint-tracking", &[]).task().file.limits.velocity_fraction.get();
    for (share, is_above) in [(0.98, false), (1.05, true)] {
        let setting = format!("limits.velocity_fraction={}", fraction / (share * predicted.at));
        let slower = experiment("joint-tracking", &[&setting]);
        let found = diagnostics(&slower).into_iter().find(|finding| finding.code == Code::JointTooFast);
        assert_eq!(found.is_some(), is_above, "{share} of {predicted}");
        let named = format!("joint '{}'", predicted.joint);
        assert!(found.is_none_or(|finding| finding.message.contains(&named)));
    }
}

/// Compared: the predicted multiple of the target force at the start of a pressing hand at rest, and the one from the
/// gradients of the hand's position by finite differences.
#[test]
fn target_force_follows_from_the_gradient_of_the_position() {
    /// Error of the finite differences, and of the references at rest.
    const DIFFERENCES: f64 = 1e-4;
    let hold = ["task.hand.cartesian.reference=\"hold\"", "settle_s=0.5", "duration_s=1.0"];
    let case = experiment("press-wall", &hold);
    let model = &case.robot().model;
    let predicted = reserve(&case, |of| *of == ReserveOf::TargetForces);
    let start = ["shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow"]
        .map(|joint| case.task().file.start_rad[joint]);
    let hand = model.frame_id("hand").expect("the hand");
    let mut data = Data::new(model);
    // x of the hand, m, and the energy of the weight, J.
    let mut at = |joint: usize, by: f64| {
        let mut q = start;
        q[joint] += by;
        kinematics(model, &mut data, &q, &[0.0; 4]);
        [frame_placement(model, &data, hand).translation.x, potential_energy(model, &data)]
    };
    let limits = case.robot().torque_limits();
    let share = case.task().file.limits.torque_fraction.get();
    let multiples: Vec<f64> = (0..4)
        .map(|joint| {
            let [ahead, behind] = [1e-5, -1e-5].map(|by| at(joint, by));
            let [x, weight] = [0, 1].map(|i| (ahead[i] - behind[i]) / 2e-5);
            // The hand exerts 10 N along x.
            let pressing = 10.0 * x;
            (share * limits[joint] - pressing.signum() * weight) / pressing.abs()
        })
        .collect();
    let least = multiples.iter().copied().fold(f64::INFINITY, f64::min);
    let joint = multiples.iter().position(|&multiple| multiple == least).expect("a joint");
    assert!((predicted.at - least).abs() < DIFFERENCES * least, "{predicted}, {multiples:?}");
    assert_eq!(predicted.joint, model.joints()[joint].name);
}

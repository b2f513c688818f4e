//! Remedies for limits that contradict each other, the start, the references or the weight.

use super::case::{HAND, JOINTS, TIP, TaskCase, number_after, number_before};
use opspace_experiment::{Code, Files, RobotDefinition};
use opspace_preflight::weak_joints;

pub fn fraction_above_one(code: Code) {
    for key in ["velocity_fraction", "torque_fraction"] {
        let above = TaskCase::of(HAND).set(format!("limits.{key}=1.5"));
        let fraction = number_after(&above.only(code).help, &format!("{key} = "));
        above.is_helped(code, &[above.clone().set(format!("limits.{key}={fraction:?}"))]);
    }
}

pub fn margin_above_range(code: Code) {
    let margin = |margin_rad: f64| {
        TaskCase::of(JOINTS)
            .set("start_rad.elbow=-1.134")
            .set("task.joints.reference=\"hold\"")
            .set(format!("limits.position_margin_rad={margin_rad:?}"))
    };
    let wide = margin(1.2);
    let half_ranges = wide.found().into_iter().filter(|finding| finding.code == code);
    let half_range =
        half_ranges.map(|finding| number_after(&finding.help, "well below ")).fold(f64::INFINITY, f64::min);
    wide.is_helped(code, &[margin(0.5 * half_range)]);
}

pub fn start_in_margin(code: Code) {
    let start = |elbow: f64| {
        TaskCase::of(JOINTS).set("task.joints.reference=\"hold\"").set(format!("start_rad.elbow={elbow:?}"))
    };
    let near = start(-0.004);
    let help = near.only(code).help;
    assert!(help.contains("a smaller margin"), "{help}");
    let smaller = near.clone().set("limits.position_margin_rad=0.003");
    near.is_helped(code, &[start(number_after(&help, "start it at ")), smaller]);
}

pub fn target_beyond_limits(code: Code) {
    let target = |elbow: f64| {
        TaskCase::of(JOINTS)
            .replace("offset_rad = { elbow = 1.0 }", &format!("absolute_rad = {{ elbow = {elbow:?} }}"))
    };
    let most = number_after(&target(0.15).only(code).help, "at most ");
    target(0.15).is_helped(code, &[target(most)]);
    let posture = |elbow: f64| TaskCase::of(HAND).set(format!("task.rest.posture_rad.elbow={elbow:?}"));
    let least = number_after(&posture(-2.5).only(code).help, "at least ");
    posture(-2.5).is_helped(code, &[posture(least)]);
}

pub fn limit_on_the_way(code: Code) {
    let folded = TaskCase::project("panda-folded");
    let help = folded.only(code).help;
    assert!(
        help.contains("make the motion smaller, or free an axis") && help.contains("opspace model "),
        "{help}"
    );
    // Half of the motion, and a free axis.
    let smaller = folded.clone().replace("[-0.2, 0.2, -0.35]", "[-0.1, 0.1, -0.175]");
    let free = folded.clone().set("task.flange.axes={ x = \"motion\", y = \"motion\", z = \"motion\" }");
    folded.is_helped(code, &[smaller, free]);
}

pub fn weight_above_limit(code: Code) {
    let weak = TaskCase::of(TIP).set("limits.torque_fraction=0.16");
    let fraction = number_after(&weak.only(code).help, "torque_fraction to at least ");
    let upright = weak.clone().set("start_rad={ shoulder = 1.3, elbow = 0.4 }");
    weak.is_helped(code, &[weak.clone().set(format!("limits.torque_fraction={fraction:?}")), upright]);
    let weaker = TaskCase::of(TIP).set("robot.joint.shoulder.torque_limit_nm=8.0");
    let help = weaker.only(code).help;
    assert!(
        help.contains("a posture with less gravity torque") && help.contains("check the limit"),
        "{help}"
    );
    let needed = number_after(&weaker.only(code).message, "needs ");
    let corrected = weaker.clone().set(format!("robot.joint.shoulder.torque_limit_nm={:?}", 1.05 * needed));
    weaker.is_helped(code, &[weaker.clone().set("start_rad={ shoulder = 1.3, elbow = 0.4 }"), corrected]);
    // A load of the environment that the elbow cannot hold.
    let loaded = |mass_kg: f64| {
        TaskCase::of(HAND)
            .add(&format!("[environment.load.mass]\nframe = \"hand\"\nmass_kg = {mass_kg:?}\nput_on_s = 0.5"))
    };
    let finding = loaded(40.0).only(code);
    assert!(finding.message.contains("with 'load' of 40 kg"), "{finding}");
    loaded(40.0).is_helped(code, &[loaded(number_after(&finding.help, "mass_kg = "))]);
}

pub fn weight_above_rate(code: Code) {
    let moving = |duration_s: f64, rate: f64| {
        let motion = format!(
            "reference.point-to-point = {{ position = {{ offset_m = [0.6, 0.0, 0.0] }}, duration_s = {duration_s:?} }}"
        );
        TaskCase::of(TIP)
            .replace("reference = \"hold\"", &motion)
            .set("duration_s=60.0")
            .set(format!("robot.joint.shoulder.torque_rate_limit_nm_per_s={rate:?}"))
    };
    let found = moving(1.5, 2.0).only(code);
    let times = number_before(&found.help, " times as long");
    // In another unit the limit is a thousand times as much: Nm per cycle of 1 ms.
    assert!(found.help.contains("unit of the limit"), "{}", found.help);
    moving(1.5, 2.0).is_helped(code, &[moving(1.5 * times, 2.0), moving(1.5, 2000.0)]);
}

pub fn unreachable_speed(code: Code) {
    let limit = |acceleration: f64| {
        TaskCase::of(HAND).set(format!("robot.joint.elbow.acceleration_limit_rad_per_s2={acceleration:?}"))
    };
    let least = number_after(&limit(10.0).only(code).help, "at least ");
    limit(10.0).is_helped(code, &[limit(least)]);
}

pub fn weak_joint(code: Code) {
    let shoulder = |values: &str| {
        let settings = values.split(' ').map(|value| format!("robot.joint.shoulder.{value}"));
        settings.fold(TaskCase::of(TIP), |case, setting| case.set(setting))
    };
    let right = TaskCase::of(TIP);
    let advice = code.page().split_once("**What to do.**").unwrap().1;
    for (wrong, words, remedy) in [
        ("torque_limit_nm=0.06", "Coulomb friction", "check `torque_limit_nm` and `friction.coulomb_nm`"),
        ("rotor.inertia_kg_m2=0.3", "to bring its rotor alone", "check `rotor.inertia_kg_m2`"),
        (
            "torque_limit_nm=0.06 friction.coulomb_nm=0.0 friction.static_nm=0.0 rotor.inertia_kg_m2=1e-8",
            "of the arm's weight",
            "check `torque_limit_nm`",
        ),
    ] {
        let weak = shoulder(wrong);
        let finding = weak.only(code);
        assert!(
            finding.message.contains(words) && finding.help.starts_with(remedy),
            "{finding}: {}",
            finding.help
        );
        weak.is_helped(code, std::slice::from_ref(&right));
    }
    assert!(advice.contains("the inertia of the rotor is that of the motor"));
}

/// No robot of the repository is called weak, with a margin of five: with a fifth of its torque limits.
#[test]
fn no_robot_of_the_repository_has_a_weak_joint() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut count = 0;
    for entry in std::fs::read_dir(root.join("robots")).unwrap() {
        let path = entry.unwrap().path();
        if !path.join("robot.toml").exists() {
            continue;
        }
        let robot = RobotDefinition::load(Files::Disk, &path, &[]).unwrap();
        let joints = robot.model.joints().iter().zip(robot.torque_limits());
        let fifth: Vec<String> = joints
            .map(|(joint, nm)| format!("robot.joint.{}.torque_limit_nm={:?}", joint.name, nm / 5.0))
            .collect();
        let weaker = RobotDefinition::load(Files::Disk, &path, &fifth).unwrap();
        assert_eq!(weak_joints(&weaker), [], "{}", path.display());
        let thousandth: Vec<String> = fifth.iter().map(|setting| format!("{setting}e-3")).collect();
        assert!(!weak_joints(&RobotDefinition::load(Files::Disk, &path, &thousandth).unwrap()).is_empty());
        count += 1;
    }
    assert!(count >= 4, "{count}");
}

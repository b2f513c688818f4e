//! Remedies for collisions, objects of the environment, and contact.

use super::case::{HAND, TIP, TaskCase, number_after, only};
use crate::project;
use crate::task_texts::{PRESS, table};
use opspace_backend::CommandKind;
use opspace_experiment::{Code, ControllerKind};
use opspace_preflight::not_checked;
use std::fs;
use tempfile::TempDir;

pub fn start_in_collision(code: Code) {
    let near = TaskCase::project("panda-obstacles").set("obstacle.ball.sphere.center_m=[0.35, 0.0, 0.55]");
    let help = near.only(code).help;
    assert!(help.contains("another start") && help.contains("capsules"), "{help}");
    let turned = near.clone().set("start_rad.joint1=1.5708").set("task.flange.reference=\"hold\"");
    near.is_helped(code, &[turned]);
}

pub fn reference_in_collision(code: Code) {
    let through = TaskCase::project("panda-obstacles");
    let help = through.only(code).help;
    assert!(help.contains("give the path more distance"), "{help}");
    through.is_helped(code, &[through.clone().replace("[0.32, 0.2, 0.44]", "[0.1, 0.6, 0.44]")]);
    let goal = TaskCase::project("panda-obstacles").set("duration_s=3.0").replace(
        "[[task.flange.cartesian.reference.waypoints]]\ntime_s = 4.5\nposition = { offset_m = [0.0, 0.0, 0.0] }\n",
        "",
    );
    let at_goal = goal.clone().replace("[0.32, 0.2, 0.44]", "[0.307, 0.35, 0.49]");
    let help = at_goal.only(code).help;
    assert!(help.contains("move the goal or the obstacle"), "{help}");
    at_goal.is_helped(
        code,
        &[
            goal.replace("[0.32, 0.2, 0.44]", "[0.1, 0.6, 0.44]"),
            at_goal.clone().replace("[0.0, 0.35, -0.1]", "[0.0, 0.1, 0.0]"),
        ],
    );
}

/// A wall below the tip of the planar arm, at a height.
fn wall(height_m: f64) -> TaskCase {
    TaskCase::of(TIP).add(&format!(
        "[environment.table.wall]\nframe = \"tip\"\npoint_m = [0.0, 0.0, {height_m:?}]\nnormal = [0.0, 0.0, 1.0]\n\
         stiffness_n_per_m = 10000.0\ndamping_ns_per_m = 50.0"
    ))
}

pub fn start_in_object(code: Code) {
    const HIGH_M: f64 = 1.6;
    let help = wall(HIGH_M).only(code).help;
    assert!(help.contains("or start elsewhere"), "{help}");
    let by_m = number_after(&help, "by ");
    wall(HIGH_M).is_helped(
        code,
        &[wall(HIGH_M - by_m), wall(HIGH_M).set("start_rad={ shoulder = 1.2, elbow = 0.3 }")],
    );
}

pub fn object_out_of_reach(code: Code) {
    const LOW_M: f64 = -2.5;
    let closer_m = number_after(&wall(LOW_M).only(code).help, "move 'table' ");
    wall(LOW_M).is_helped(code, &[wall(LOW_M + closer_m)]);
}

pub fn ignored_compliance(code: Code) {
    let gains = "gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }";
    let spring = "impedance = { stiffness_n_per_m = 500.0, damping_ratio = 0.7 }";
    let of = |controller| {
        TaskCase::of(HAND).replace(gains, spring).options(|options| options.controller = controller)
    };
    assert!(of(ControllerKind::Ik).only(code).help.contains("controller 'osc'"));
    of(ControllerKind::Ik).is_helped(code, &[of(ControllerKind::Osc)]);
}

pub fn damped_compliance(code: Code) {
    let compliant = TaskCase::of(HAND)
        .replace("x = \"motion\"", "x = \"compliant\"")
        .set("robot.interface.gears=\"elastic\"");
    let unknown = compliant
        .clone()
        .set("robot.interface.measured=[\"position\"]")
        .set("robot.profile.a-med.servo.elbow.cascaded.gain_uncertainty=0.3");
    let help = unknown.only(code).help;
    assert!(
        help.contains("--backend torque") && help.contains("measured motor current leaves none"),
        "{help}"
    );
    let known = unknown.clone().set(format!(
        "robot.profile.a-med.servo.elbow.cascaded.gain_uncertainty={:?}",
        0.01 * number_after(&help, "±")
    ));
    let current = unknown.clone().set("robot.interface.measured=[\"position\", \"motor-current\"]");
    unknown.is_helped(code, &[known, current, unknown.clone().backend(CommandKind::Torque)]);
}

/// The hand presses along x, with these values of its force.
fn pressing(values: &str) -> TaskCase {
    TaskCase::of(HAND).replace("x = \"motion\"", "x = \"force\"").replace(
        "frame = \"hand\"",
        &format!("frame = \"hand\"\nforce = {{ sensor = \"wrist\", target_n = {{ x = -20.0 }}, {values} }}"),
    )
}

pub fn contact_oscillation(code: Code) {
    let of = |gain: f64, more: &str| {
        pressing(&format!("gain = {gain:?}, surface = {{ stiffness_n_per_m = 50000.0 }}{more}"))
    };
    let help = of(20.0, "").only(code).help;
    let damping = format!(", damping_per_s = {:?}", number_after(&help, "`damping_per_s` to "));
    of(20.0, "").is_helped(code, &[of(number_after(&help, "at most "), ""), of(20.0, &damping)]);
}

pub fn contact_impact(code: Code) {
    let of = |speed: f64| {
        pressing(&format!(
            "contact = {{ approach_m_per_s = {speed:?} }}, surface = {{ stiffness_n_per_m = 100000.0, damping_ns_per_m = 500.0 }}"
        ))
    };
    let slower = number_after(&of(1.5).only(code).help, "approach_m_per_s = ");
    of(1.5).is_helped(code, &[of(slower)]);
}

fn pressing_down() -> TaskCase {
    let press = TaskCase::of(PRESS).replace("admittance_ns_per_m = 100.0", "admittance_ns_per_m = 50.0");
    press.options(|options| options.controller = ControllerKind::Ik)
}

pub fn unstable_admittance(code: Code) {
    let low = pressing_down().add(&table(50_000.0));
    let good = number_after(&low.only(code).help, "admittance_ns_per_m = ");
    low.is_helped(code, &[low.clone().set(format!("task.hand.force.admittance_ns_per_m={good:?}"))]);
}

pub fn unknown_contact(code: Code) {
    let unknown = |case: &TaskCase| not_checked(&case.experiment());
    let help = only(code, &unknown(&pressing_down())).help;
    assert!(help.contains("raise admittance_ns_per_m"), "{help}");
    assert_eq!(unknown(&pressing_down().set("task.hand.force.admittance_ns_per_m=100.0")), []);
    // The page names the environment, too: the contact is then checked.
    assert!(code.page().contains("Add the object to [environment]"));
    assert_eq!(unknown(&pressing_down().add(&table(500.0))), []);
}

pub fn unknown_sensor_load(code: Code) {
    // The elbow moves the forearm beyond this sensor.
    let sensor = TaskCase::of(HAND)
        .set("robot.force_sensor.arm={ frame = \"upper_arm\" }")
        .set("robot.simulated.force_sensor.arm={ bandwidth_hz = 500.0, noise_n = 0.05, noise_nm = 0.005, bias_n = 2.0, bias_nm = 0.1 }");
    let help = sensor.only(code).help;
    assert!(
        help.contains("state `load` in [force_sensor.arm]") && help.contains("`locked_joints`"),
        "{help}"
    );
    let stated =
        sensor.clone().set("robot.force_sensor.arm.load={ mass_kg = 1.0, centre_m = [0.0, 0.0, -0.1] }");
    // A joint that is locked has no entries in robot.toml. The task keeps the height free.
    let folder = TempDir::new().unwrap();
    let robot = fs::read_to_string(project("robots/asimo-arm/robot.toml")).unwrap();
    let (before, joint) = robot.split_once("[joint.elbow]\n").unwrap();
    let (_, rest) = joint.split_once("\n\n").unwrap();
    let without: String = rest.split_inclusive('\n').filter(|line| !line.starts_with("elbow = ")).collect();
    fs::write(
        folder.path().join("robot.toml"),
        format!("locked_joints = {{ elbow = -1.35 }}\n{before}{without}"),
    )
    .unwrap();
    fs::copy(project("robots/asimo-arm/asimo-arm.urdf"), folder.path().join("asimo-arm.urdf")).unwrap();
    let own = sensor.clone().replace(", elbow = -1.35", "");
    let own = own.replace(project("robots/asimo-arm").to_str().unwrap(), folder.path().to_str().unwrap());
    let locked = own.replace(", z = \"motion\" }", " }").set("task.hand.reference=\"hold\"");
    sensor.is_helped(code, &[stated, locked]);
}

/// The hand presses on a table that it reaches, with a target (N) along z.
fn pressing_with(target_n: &str) -> TaskCase {
    let on_table = TaskCase::of(PRESS).add(&table(2000.0)).backend(CommandKind::Position);
    on_table.replace("target_n = { z = 20.0 }", &format!("target_n = {{ {target_n} }}"))
}

pub fn presses_away(code: Code) {
    let away = pressing_with("z = -20.0");
    let finding = away.only(code);
    assert!(finding.message.contains("presses along +z, away from 'table'"), "{finding}");
    away.is_helped(code, &[pressing_with(&format!("z = {:?}", number_after(&finding.help, "try z = ")))]);
}

pub fn nothing_ahead(code: Code) {
    // A force along another axis, no object at all, and an approach that is too slow.
    let along_x = pressing_with("x = -20.0").replace(
        "axes = { x = \"motion\", y = \"motion\", z = \"force\" }",
        "axes = { x = \"force\", y = \"motion\", z = \"motion\" }",
    );
    assert!(along_x.only(code).help.contains("check the axis x"), "{:?}", along_x.found());
    along_x.is_helped(code, &[pressing_with("z = 20.0")]);
    let alone = TaskCase::of(PRESS);
    assert!(alone.only(code).message.contains("no surface for 'hand'"), "{:?}", alone.found());
    alone.is_helped(code, &[pressing_with("z = 20.0")]);
    let approaching = |m_per_s: f64| {
        pressing_with("z = 20.0").replace(
            "admittance_ns_per_m = 100.0",
            &format!("admittance_ns_per_m = 100.0, contact = {{ approach_m_per_s = {m_per_s:?} }}"),
        )
    };
    let fast = number_after(&approaching(1e-4).only(code).help, "approach_m_per_s = ");
    approaching(1e-4).is_helped(code, &[approaching(fast)]);
}

pub fn force_above_limit(code: Code) {
    const LARGE_N: f64 = 400.0;
    let large = pressing_with(&format!("z = {LARGE_N:?}"));
    let at_most = number_after(&large.only(code).help, "give at most ");
    assert!(at_most < LARGE_N && at_most > 0.1 * LARGE_N, "{at_most} N");
    large.is_helped(code, &[pressing_with(&format!("z = {at_most:?}"))]);
}
